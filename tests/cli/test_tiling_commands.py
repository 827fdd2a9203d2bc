"""Whole parts through the doors: the command, a kill in the middle, a disk that is too small or becomes full."""

import errno
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import zarr

import turnwright as tw
from turnwright.cli import main, tiling as _tiling
from turnwright.studies import Cluster, LocalPool

JOB = """
[part]
name = "small flat"
radius = "0.4 mm"
surface = { family = "plane" }

[tool]
nose_radius = "0.5 mm"
included = "60 deg"
clearance = "10 deg"

[machine]
name = "generic"

[strategy]
kind = "slow tool servo"
feed = "10 um/rev"
points_per_rev = 90
spindle_speed = "100 rpm"
"""

FOLDERS = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

KILLED = """
import sys, time
sys.path[:0] = {folders!r}
from test_tiling_commands import made
made({store!r}, progress=lambda done, total: (print(done, total, flush=True), time.sleep(0.2)))
"""


def made(store, **more):
    k = np.arange(20 * 90 + 1)
    angle, x = 2 * np.pi * k / 90, 0.4 - 0.02 * k / 90
    machine = tw.Machine(
        name="test", axes={letter: tw.Axis() for letter in "CXZ"}, spindle_rpm=3000.0, block_rate_hz=1000.0
    )
    motion = tw.Motion(time=1e-3 * k, axes={"C": angle, "X": x, "Z": 0 * x}, machine=machine)
    tool = tw.Tool(nose_radius=0.2, included=np.deg2rad(100))
    return tw.studies.generate_tiled(motion, tool, pixel=0.0015, store=store, radius=0.35, tile=64, **more)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The map, made at once."""
    return made(tmp_path_factory.mktemp("whole") / "map")


@pytest.fixture
def job(tmp_path):
    file = tmp_path / "job.toml"
    file.write_text(JOB, encoding="utf-8")
    return file


def chunks(store):
    """Inode and time of every file of heights."""
    files = sorted(Path(store).glob("level_0/z/c/*/*"))
    return {file: (file.stat().st_ino, file.stat().st_mtime_ns) for file in files if not file.name.endswith(".partial")}


def test_command(job, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["tile", str(job), "--pixel", "2 um", "--out", str(out), "--tile", "128"]) == 0
    message = capsys.readouterr()
    assert "map: 401 x 401 pixels" in message.out
    assert "aliases cusps" not in message.err
    numbers = json.loads((out / "tiled.json").read_text(encoding="utf-8"))
    # Away from the axis and the rim a flat keeps the cusps of the closed form.
    sq = (0.5 - np.sqrt(0.25 - 0.01**2 / 4)) * np.sqrt(4 / 45) * 1e6
    assert numbers["roughness"]["sq_nm"] == pytest.approx(sq, rel=0.03)
    assert numbers["roughness"]["valid"] == pytest.approx(np.pi * 200**2, rel=1e-3)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 4
    assert "401 × 401 pixels" in page
    level = zarr.open_group(out / "map.zarr", mode="r")["level_1"]
    assert level["z"].metadata.dimension_names == ("y", "x")
    assert level["z"].attrs["units"] == "mm"
    before = chunks(out / "map.zarr")
    assert main(["tile", str(job), "--pixel", "2 um", "--out", str(out), "--tile", "128"]) == 0
    assert chunks(out / "map.zarr") == before
    capsys.readouterr()
    assert main(["tile", str(job), "--pixel", "4 um", "--out", str(tmp_path / "coarse")]) == 0
    assert "the pixel of 4 um aliases cusps at a feed of 10 um" in capsys.readouterr().err
    assert main(["tile", str(job), "--pixel", "3 um", "--out", str(out)]) == 2
    assert "holds the map of another motion, tool, surface or grid" in capsys.readouterr().err


def test_impossible_tiles_are_reported_before_planning(job, tmp_path, capsys, monkeypatch):
    from turnwright import job as recipe

    out = tmp_path / "out"
    command = ["tile", str(job), "--pixel", "4 um", "--out", str(out)]
    assert main([*command, "--tile", "128"]) == 0
    capsys.readouterr()

    def never(*_args, **_more):
        raise AssertionError("it was planned")

    monkeypatch.setattr(recipe, "finishing_motion", never)

    def refused(*words):
        assert main(list(words)) == 2
        message = capsys.readouterr().err
        assert len(message.splitlines()) == 1
        return message

    taken, file = tmp_path / "taken", tmp_path / "letter.txt"
    taken.mkdir()
    (taken / "report.html").write_text("mine", encoding="utf-8")
    file.write_text("mine", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    for words, message in (
        (
            [*command, "--tile", "8"],
            "the width of a tile in pixels is 8, it must be a whole number, 64 to 32768: give one",
        ),
        ([*command, "--tile", "256"], "holds the map of another job, tile size or version"),
        (
            [*command[:2], "--pixel", "3 um", *command[4:], "--tile", "128"],
            "holds the map of another motion, tool, sur",
        ),
        ([*command[:2], "--pixel", "1 m", "--out", str(tmp_path / "new")], "the map has 1 x 1 pixels"),
        ([*command[:5], str(taken)], "already exists and holds other files"),
        ([*command[:5], str(file)], "letter.txt' is not a folder"),
        ([*command[:5], str(file / "deep")], "letter.txt' is not a folder"),
        ([*command[:5], str(tmp_path / "new"), "--cluster", "tcp://127.0.0.1:9"], "no Dask scheduler answers at"),
    ):
        assert message in refused(*words)
    job.write_text(JOB.replace('feed = "10 um/rev"', 'feed = "9 um/rev"'), encoding="utf-8")
    assert "holds the map of another job, tile size or version" in refused(*command, "--tile", "128")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.usefixtures("signals_heard")
def test_an_interrupt_keeps_the_finished_tiles_and_says_so(job, tmp_path, capsys):
    out, ended = tmp_path / "out", threading.Event()

    def interrupt():
        while not ended.wait(0.05):
            if len(chunks(out / "map.zarr")) >= 5:
                os.kill(os.getpid(), signal.SIGINT)
                return

    hand = threading.Thread(target=interrupt)
    hand.start()
    code = main(["tile", str(job), "--pixel", "0.25 um", "--tile", "64", "--out", str(out)])
    ended.set()
    hand.join()
    assert code == 130
    assert capsys.readouterr().err.splitlines()[-1].startswith("turnwright: interrupted, finished tiles are in")
    with pytest.raises(tw.InputError, match=r"has \d+ of \d+ tiles: repeat the call"):
        tw.studies.TiledMap.open(out / "map.zarr")


def test_a_disk_too_small_is_refused_beforehand(job, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, "disk_usage", lambda _folder: SimpleNamespace(free=10**7))
    assert main(["tile", str(job), "--pixel", "0.5 um", "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "the map of 1601 x 1601 pixels needs 0.0" in message
    assert "has 0.01 GB: free some space" in message
    assert len(message.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_killed_run_goes_on_where_it_was(whole, tmp_path):
    store = tmp_path / "map"
    script = KILLED.format(folders=FOLDERS, store=str(store))
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            done, total = map(int, line.split())
            if done >= 5:
                break
        os.kill(process.pid, signal.SIGKILL)
    assert 5 <= done < total
    with pytest.raises(tw.InputError, match=rf"has \d+ of {total} tiles"):
        tw.studies.TiledMap.open(store)
    records = zarr.open_group(store, mode="r")["tiles"][:]
    finished = {(j, i) for j, i in np.argwhere(~np.isnan(records[:, :, 0])).tolist()}
    assert len(finished) >= 5
    before = {file: seen for file, seen in chunks(store).items() if place(file) in finished}
    assert len(before) == len(finished)
    # What a crash of the machine may leave of a tile that was not finished.
    middle = records.shape[1] // 2  # a column of tiles that are all of the part
    below = (store / f"level_0/z/c/{j}/{middle}" for j in range(records.shape[0]))
    torn = next(file for file in below if place(file) not in finished)
    torn.parent.mkdir(parents=True, exist_ok=True)
    torn.write_bytes(b"half of it")
    report = []
    found = made(store, progress=lambda done, total: report.append((done, total)))
    assert report[0] == (len(finished), total)
    assert {file: seen for file, seen in chunks(store).items() if file in before} == before
    assert np.array_equal(found.height_map().z, whole.height_map().z, equal_nan=True)
    assert tw.studies.TiledMap.open(store).valid == found.valid


def place(file):
    return int(file.parent.name), int(file.name)


def test_a_disk_that_becomes_full_keeps_what_is_finished(whole, tmp_path, monkeypatch):
    import zarr.storage._local as local

    real, written = local._put, []

    def put(path, value, **more):
        if "level_0/z/c" in str(path):
            written.append(path)
            if len(written) > 8:
                raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return real(path, value, **more)

    with monkeypatch.context() as patch:
        patch.setattr(local, "_put", put)
        with pytest.raises(tw.errors.StudyError, match=r"is full with \d+ of \d+ tiles finished and kept") as caught:
            made(tmp_path / "map")
    assert "\n" not in str(caught.value)
    kept = chunks(tmp_path / "map")
    assert kept
    found = made(tmp_path / "map")
    assert np.array_equal(found.height_map().z, whole.height_map().z, equal_nan=True)


def test_processes_make_the_same_map_despite_a_kill(whole, tmp_path):
    seen = []

    def report(done, _total):
        seen.append(done)
        if len(seen) == 4:
            os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)

    with tw.studies.local(2) as pool:
        found = made(tmp_path / "map", executor=pool, progress=report)
    assert np.array_equal(found.height_map().z, whole.height_map().z, equal_nan=True)
    assert seen == sorted(set(seen))


def test_a_map_killed_at_its_first_file_begins_again(tmp_path):
    (tmp_path / ".case.json.part").write_text('{"ke')
    _tiling._require_usable(tmp_path)
    (tmp_path / "thesis.txt").write_text("somebody's")
    with pytest.raises(tw.InputError, match="holds other files"):
        _tiling._require_usable(tmp_path)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"pixel": 0.0}, "the pixel along x is 0 mm"),
        ({"radius": None}, "the extent of the map is not stated"),
        ({"radius": None, "x": (0.0, 1.0)}, "the extent of the map is not stated"),
        ({"radius": None, "x": (1.0, 0.0), "y": (0.0, 1.0)}, "the extent of the map along x is 1 to 0, it must ascend"),
        ({"radius": 0.001, "pixel": 0.01}, "the map has 1 x 1 pixels"),
        ({"tile": 8}, "the width of a tile in pixels is 8"),
        ({"store": "memory://map", "executor": LocalPool(workers=1, threads=1)}, "is in the memory of this process"),
        (
            {"store": "memory://map", "executor": Cluster(SimpleNamespace(get_executor=lambda **_: None))},
            "is in the memory of this process",
        ),
        ({"store": "nosuch://there"}, "cannot be used as a store"),
    ],
)
def test_what_is_refused(tmp_path, asked, message):
    machine = tw.Machine(name="t", axes={letter: tw.Axis() for letter in "CXZ"}, spindle_rpm=1.0, block_rate_hz=1.0)
    c = np.linspace(0, 20.0, 50)
    motion = tw.Motion(time=c, axes={"C": c, "X": 0.02 - 1e-3 * c, "Z": 0 * c}, machine=machine)
    wanted = {"pixel": 0.001, "store": tmp_path / "map", "radius": 0.02, **asked}
    with pytest.raises(tw.InputError, match=message) as caught:
        tw.studies.generate_tiled(motion, tw.Tool(nose_radius=0.2, included=1.7), **wanted)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "map").exists()


def test_what_a_map_refuses(whole, tmp_path):
    found = whole
    for call, message in (
        (lambda: found.height_map(9), r"the level is 9, it must be a whole number, 0 to \d: give one"),
        (lambda: found.window(x=(1, 0), y=(0, 1)), "the window along x is 1 to 0, it must ascend"),
        (lambda: found.window(x=(0, 1), y=(0, 1), pixels=0), "the width of a window in pixels is 0"),
        (lambda: found.window(x=(5, 6), y=(0, 1)), "holds no pixel of the map"),
        (lambda: found.roughness(form="sphere"), "a map in tiles takes"),
        (lambda: found.area_psd(segment=2), "the width of a segment in pixels is 2, it must be"),
        (lambda: found.area_psd(segment=450), "no segment of 450 x 450 pixels is free of gaps"),
        (lambda: found.line_psd(along="radius", segment=64), "along is 'radius'"),
        (lambda: tw.studies.TiledMap.open(tmp_path), "holds no tiled map"),
    ):
        with pytest.raises(tw.InputError, match=message):
            call()
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "letter.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(tw.InputError, match="holds other files"):
        made(tmp_path / "taken")
    with pytest.raises(
        tw.errors.StudyError, match=r"letter.txt' cannot be used \((File exists|Not a directory)\), 0 of"
    ):
        made(tmp_path / "taken" / "letter.txt")
    assert (tmp_path / "taken" / "letter.txt").read_text(encoding="utf-8") == "mine"
