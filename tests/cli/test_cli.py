"""The command line and the run folder. Oracles: the library called by hand, plain readers of the files' formats."""

import hashlib
import json
import math
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import turnwright as tw
from job_files import written
from turnwright._signals import Stop
from turnwright.cli import main, shared as _shared
from turnwright.errors import InputError
from turnwright.job import Job
from turnwright.progress import Step
from turnwright.report import read_maps

WAVES = {"family": "sine grid", "amplitude": ["2 um", "2 um"], "period": ["1 mm", "1 mm"]}


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A small job, run by the command line."""
    folder = tmp_path_factory.mktemp("run")
    job = written(folder)
    assert main(["run", str(job), "--out", str(folder / "out")]) == 0
    return folder


def test_a_run_leaves_what_it_promises_and_nothing_else(done):
    assert sorted(entry.name for entry in done.iterdir()) == ["job.toml", "out"]
    names = {str(file.relative_to(done / "out")) for file in (done / "out").rglob("*") if file.is_file()}
    maps = {"whole-part": ("radius", "angle"), "patch": ("x", "y")}
    expected = {"report.html", "result.json", "run.h5", "job.toml", "part.nc"}
    expected |= {f"maps/{stem}{axis}.npy" for stem, axes in maps.items() for axis in ("", *(f".{a}" for a in axes))}
    assert expected <= names
    assert {name for name in names - expected if not re.fullmatch(r"part\..*\.nc", name)} == set()
    assert Job.load(done / "out" / "job.toml") == Job.load(done / "job.toml")


def test_the_numbers_are_those_of_the_library(done):
    """Oracle: the stages called by hand on the motion in memory; strict JSON without nan."""

    def refuse(constant):
        raise AssertionError(constant)

    reported = json.loads((done / "out" / "result.json").read_text(), parse_constant=refuse)
    job = Job.load(done / "job.toml")
    part, tool, machine = job.part, job.tool, job.machine
    servo = tw.SlowToolServo(feed=0.02, points_per_rev=120)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
    assert reported["schema"] == 1
    assert reported["turnwright"] == tw.__version__
    assert reported["ok"] is True
    assert reported["passes"][0]["limits"]["cycle_time_s"] == pytest.approx(
        tw.check_limits(motion, machine).cycle_time_s
    )
    assert reported["access"]["nose_radius_limit"] == pytest.approx(tw.check_access(part, tool).nose_radius_limit)
    (finish,) = tw.post.inspect_nc(done / "out" / "part.nc").passes
    assert reported["program"]["hash"] == hashlib.sha256(finish.hash.encode()).hexdigest()
    x, y = (np.load(done / "out" / reported["predictions"][1]["axes"][name]) for name in "xy")
    z = np.load(done / "out" / reported["predictions"][1]["file"])
    by_hand = tw.generate(motion, tool, x=x, y=y).minus(part.surface)
    np.testing.assert_allclose(z, by_hand.z, atol=2e-6)  # the decimals of the program
    assert reported["predictions"][1]["roughness"]["sq_nm"] == pytest.approx(tw.roughness(by_hand).sq_nm, rel=0.01)
    assert reported["predictions"][0]["roughness"]["sal"] is None  # not stated on a polar grid


def test_the_archive_holds_the_same_maps(done):
    maps = read_maps(done / "out" / "run.h5")
    assert list(maps) == ["patch", "whole part"]
    np.testing.assert_array_equal(maps["patch"].z, np.load(done / "out" / "maps" / "patch.npy"))
    np.testing.assert_array_equal(maps["whole part"].angle, np.load(done / "out" / "maps" / "whole-part.angle.npy"))
    with pytest.raises(InputError, match=r"run\.h5"):
        read_maps(done / "out" / "result.json")


def test_a_backplot_of_the_program_predicts_the_same(done, tmp_path, capsys):
    program, job = str(done / "out" / "part.nc"), str(done / "job.toml")
    assert main(["backplot", program, "--job", job, "--out", str(tmp_path / "maps")]) == 0
    message = capsys.readouterr().out
    reported = json.loads((done / "out" / "result.json").read_text())
    assert f"patch: Sq {reported['predictions'][1]['roughness']['sq_nm']:.3g} nm" in message
    np.testing.assert_array_equal(
        np.load(tmp_path / "maps" / "maps" / "patch.npy"), np.load(done / "out" / "maps" / "patch.npy")
    )
    assert main(["backplot", program, "--job", job, "--pass", "rough"]) == 2
    assert "rough" in capsys.readouterr().err


def test_a_backplot_takes_a_table_of_axis_positions(done, tmp_path, capsys):
    job = Job.load(done / "job.toml")
    motion = tw.read_nc(done / "out" / "part.nc", job.machine)
    columns = [np.rad2deg(motion.axes["C"]), motion.axes["X"], motion.axes["Z"]]
    table = tmp_path / "points.csv"
    np.savetxt(table, np.column_stack(columns), delimiter=",", header="C_deg,X_mm,Z_mm", comments="", fmt="%.9f")
    assert main(["backplot", str(table), "--job", str(done / "job.toml")]) == 0
    reported = json.loads((done / "out" / "result.json").read_text())
    assert f"patch: Sq {reported['predictions'][1]['roughness']['sq_nm']:.3g} nm" in capsys.readouterr().out
    assert main(["backplot", str(table), "--job", str(done / "job.toml"), "--pass", "finish"]) == 2
    assert "--pass 'finish'" in capsys.readouterr().err


def table_of(done, folder, rows):
    """The axis positions of some blocks of the program."""
    motion = tw.read_nc(done / "out" / "part.nc", Job.load(done / "job.toml").machine)
    columns = [np.rad2deg(motion.axes["C"]), motion.axes["X"], motion.axes["Z"]]
    table = folder / "points.csv"
    np.savetxt(table, np.column_stack(columns)[rows], delimiter=",", header="C_deg,X_mm,Z_mm", comments="", fmt="%.9f")
    return table, motion.axes["C"][rows]


def test_a_backplot_counts_the_points_that_are_not_cut(done, tmp_path, capsys):
    """A program cut short within its first turn. Oracle: the azimuths it passes, and those across the axis."""
    table, c = table_of(done, tmp_path, slice(0, 31))
    assert main(["backplot", str(table), "--job", str(done / "job.toml")]) == 0
    reported = capsys.readouterr()
    azimuth = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    low, high = np.sort(c[[0, -1]])
    covered = [any((a + half - low) % (2 * np.pi) <= high - low + 1e-9 for half in (0, np.pi)) for a in azimuth]
    missing = 40 * (24 - sum(covered))  # on the axis itself every pass counts
    assert 0 < missing < 960
    assert f"whole part: {missing} of 984 points are not cut: no pass reaches them" in reported.err
    assert not re.search(r"\b(inf|nan)\b", reported.out + reported.err), reported.out


def test_a_backplot_refuses_a_place_that_is_not_cut_at_all(done, tmp_path, capsys):
    table, _ = table_of(done, tmp_path, slice(20, 31))  # next to the patch, whose azimuth is 0
    assert main(["backplot", str(table), "--job", str(done / "job.toml")]) == 2
    reported = capsys.readouterr()
    assert "points of patch is cut" in reported.err
    assert "rev" in reported.err


def test_a_backplot_counts_what_stands_above_the_stock(done, tmp_path, capsys):
    """A program cut short after ten turns leaves the flank of its last one; the stock ends 5 um above the design."""
    table, _ = table_of(done, tmp_path, slice(0, 1200))
    job = written(tmp_path, ("part.stock", "5 um"))
    assert main(["backplot", str(table), "--job", str(job)]) == 0
    # The last turn is 0.8 mm from the axis or more: a nose of 0.5 mm is 5 um above the dish 75 um farther in.
    counted = int(re.search(r"whole part: (\d+) of 984 points are not cut", reported := capsys.readouterr().err)[1])
    radius = np.linspace(0, 1, 41)
    assert 24 * np.count_nonzero(radius < 0.7) <= counted <= 24 * np.count_nonzero(radius < 0.8)
    assert "or only above the stock" in reported


def test_check_says_what_the_part_asks_of_the_tool(done, tmp_path, capsys):
    assert main(["check", str(done / "job.toml")]) == 0
    message = capsys.readouterr().out
    assert message.count("ok: ") >= 4
    points, minutes = re.search(r"finish: (\d+) points, at least ([\d.]+) min", message).groups()
    assert int(points) > 6000
    assert float(minutes) > 0
    assert main(["check", str(written(tmp_path, ("part.surface", WAVES), ("tool.clearance", "0.1 deg")))]) == 2
    caught = capsys.readouterr()
    assert "NO: clearance needs" in caught.out
    assert "turnwright: clearance needs" in caught.err


def test_check_refuses_what_run_would(tmp_path, capsys):
    """Beyond the surface's end, and with the same words about what a job may accept."""
    end = ("part.surface", {"family": "sphere", "radius": "1.5 mm"}), ("strategy.lead_in", "1 mm")
    slow = ("part.surface", WAVES), ("tool.clearance", "0.1 deg")
    for changes, sentence in ((end, "Sphere is not defined"), (slow, 'accept = ["clearance"]')):
        job = str(written(tmp_path, *changes, ("tool.included", "120 deg"), ("tool.clearance", "60 deg"), *changes[1:]))
        assert main(["run", job, "--out", str(tmp_path / "out")]) == 2
        reported = [line for line in capsys.readouterr().err.splitlines() if line.startswith("turnwright: ")]
        assert sentence in reported[0]
        assert main(["check", job]) == 2
        assert sentence in capsys.readouterr().err


def test_the_decimals_are_judged_where_the_actual_tool_cuts(tmp_path):
    """A tool far from its planned place meets other slopes than the design has there."""
    tool = {"nose_radius": "0.5 mm", "included": "100 deg", "clearance": "40 deg"}
    offset = ("actual.tool.offset", ["0.3 mm", "0.4 mm", "0 mm"])
    where = ("part.surface", {"family": "sphere", "radius": "3 mm"}), ("tool", tool), ("simulation.patches", [])
    planned, result = (tw.run(Job.load(written(tmp_path, *where, *more))) for more in ((), (offset,)))
    assert result.rounding_limit_nm > 1.2 * planned.rounding_limit_nm
    assert result.rounding_nm <= result.rounding_limit_nm


def test_force_keeps_the_old_folder(done, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    again = ["backplot", str(done / "out" / "part.nc"), "--job", str(done / "job.toml"), "--out", str(out)]
    assert main(again) == 0  # an empty folder is free
    (out / "notes.txt").write_text("cut on Monday")
    assert main([*again, "--force"]) == 0
    assert (tmp_path / "out.old-1" / "notes.txt").read_text() == "cut on Monday"
    assert not (out / "notes.txt").exists()
    assert main([*again, "--force"]) == 0
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["out", "out.old-1", "out.old-2"]


def test_a_defect_is_distinguished_from_bad_input(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("turnwright.job.preview", lambda *_args, **_more: math.sqrt(-1))
    assert main(["check", str(written(tmp_path))]) == 1
    message = capsys.readouterr().err
    log = Path(re.search(r"the traceback is in (\S+):", message).group(1))
    assert "math.sqrt(-1)" in log.read_text()
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(28, "No space left on device", "/out/map.npy"), "the disk is full at /out/map.npy"),
        (OSError("Unable to write (file write failed: errno = 28, ...)"), "the disk is full"),
        (OSError("1000 requested and 12 written"), "the disk is full"),
        (PermissionError(13, "Permission denied", "/out"), r"operating system error at /out \(Permission denied\)"),
        (MemoryError("Unable to allocate 9 TiB"), "out of memory"),
    ],
)
def test_what_the_computer_refuses_is_one_sentence(error, sentence, monkeypatch, tmp_path, capsys):
    def refuse(*_args, **_more):
        raise error

    monkeypatch.setattr("turnwright.job.preview", refuse)
    assert main(["check", str(written(tmp_path))]) == 2
    assert re.fullmatch(f"turnwright: {sentence}.*: .*\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["frobnicate"], "No such command"),
        (["run", "job.toml"], "Missing option '--out'"),
        (["check"], "Missing argument"),
        (["check", "job.toml", "--fast"], "No such option"),
    ],
)
def test_a_wrong_command_line_is_one_sentence(arguments, sentence, capsys):
    assert main(arguments) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"turnwright: {sentence}")
    assert len(message.splitlines()) == 1


def test_help_and_version_import_nothing_heavy():
    code = (
        "import sys; from turnwright.cli import main; "
        "assert main(['--help']) == 0 == main(['--version']); "
        "print(sorted({'numpy', 'scipy', 'numba', 'matplotlib', 'h5py', 'jinja2'} & set(sys.modules)))"
    )
    message = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert message.splitlines()[-1] == "[]"
    assert f"turnwright {tw.__version__}" in message
    assert all(command in message for command in ("run", "check", "backplot"))


def shell(line, **more):
    """Run a line of shell, where {} is the command line."""
    line = line.replace("{}", f"{sys.executable} -m turnwright")
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False, **more)


def test_the_package_is_the_command_line():
    assert shell("{} --version").stdout == f"turnwright {tw.__version__}\n"


@pytest.mark.parametrize(
    ("where", "code", "message"),
    [(">/dev/full", 2, "cannot write to standard output (No space left on device)"), ("| true", 0, "")],
)
def test_results_are_kept_when_output_is_closed(where, code, message, done, tmp_path):
    reported = shell(
        f"set -o pipefail; {{}} backplot {done}/out/part.nc --job {done}/job.toml --out {tmp_path}/out {where}"
    )
    assert (tmp_path / "out" / "report.html").exists()
    assert reported.returncode == code
    assert "no results were written" not in reported.stderr
    assert message in reported.stderr
    assert "Traceback" not in reported.stderr


def test_a_process_without_error_output_works(done):
    reported = shell(f"{{}} check {done}/job.toml 2>&-")
    assert reported.returncode == 0
    assert "ok: " in reported.stdout
    assert shell("{} check no.toml 2>&- >&-").returncode == 2


def test_a_link_to_nowhere_is_followed(done, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "disk" / "out")
    again = [
        "backplot",
        str(done / "out" / "part.nc"),
        "--job",
        str(done / "job.toml"),
        "--out",
        str(tmp_path / "link"),
    ]
    assert main(again) == 0
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "disk" / "out" / "report.html").exists()


@pytest.mark.parametrize("kind", ["mount", "loop", "taken"])
def test_a_folder_that_cannot_be_is_refused_first(kind, done, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    if kind == "loop":
        out.symlink_to(out)
    else:
        out.mkdir()
    if kind == "mount":
        monkeypatch.setattr(Path, "is_mount", lambda self: self == out)
    if kind == "taken":
        (out / "notes.txt").write_text("cut on Monday")
    monkeypatch.setattr("turnwright.job.predict", lambda *_args, **_more: math.sqrt(-1))
    assert main(["backplot", str(done / "out" / "part.nc"), "--job", str(done / "job.toml"), "--out", str(out)]) == 2
    sentence = {"mount": "is a mount point", "loop": "points to itself", "taken": "already exists"}[kind]
    assert sentence in capsys.readouterr().err


def test_bars_are_drawn_on_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with _shared.show_progress(Stop(), [Step(stage="place", work=1.0), Step(stage="drive", work=1.0)]) as progress:
        progress("place", 0, 10)
        progress("place", 10, 10)
    assert "done" in capsys.readouterr().err


def test_block_delete_is_stated_for_a_backplot(done, tmp_path, capsys):
    program = tmp_path / "part.nc"
    text = (done / "out" / "part.nc").read_text()
    _, mark, rest = text.partition("( PASS: finish )\n")
    assert mark
    machine = Job.load(done / "job.toml").machine
    program.write_text("(somebody's)\n" + rest.replace("G93\n", "G93\n/M8\n", 1))
    command = ["backplot", str(program), "--job", str(done / "job.toml")]
    assert main(command) == 2
    assert "--block-delete or --no-block-delete" in capsys.readouterr().err
    assert main([*command, "--block-delete"]) == 0
    assert main([*command, "--no-block-delete"]) == 0
    assert tw.read_nc(program, machine, block_delete=True).time.size > 1000
