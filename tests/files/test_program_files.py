"""Files: whole or not at all."""

import errno
import hashlib
import os
import signal
import struct
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from turnwright.errors import ProgramError
from turnwright.machine import Axis, Machine
from turnwright.path import Motion
from turnwright.post import ProgramHeader, inspect_nc, read_nc, write_nc


def machine(dialect="nanotech"):
    return Machine(
        name="lathe", axes={letter: Axis() for letter in "CXZ"}, spindle_rpm=1000, block_rate_hz=1000, dialect=dialect
    )


def motion(count=500, height=0.0):
    angle = np.arange(count) * 0.05
    axes = {"C": angle, "X": np.linspace(3, 0, count), "Z": height + 0.01 * np.cos(3 * angle)}
    return Motion(time=np.arange(count) * 0.01, axes=axes, machine=machine())


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
def test_inspection_reports_what_the_files_hold(tmp_path, dialect):
    passes = {"rough": motion(800, 0.1), "finish": motion(1000)}
    header = ProgramHeader(design="Lens (A.1)", tool="R1.5 + waviness", date="2026-01-02", notes="µm\nline " * 30)
    done = write_nc(passes, machine(dialect), tmp_path / "part.nc", header=header, max_lines=700, depth=None)
    names = ["part.nc", *(f"part.{name}.{k:03d}.nc" for name in passes for k in (1, 2))]
    assert [path.name for path in done.files] == names
    assert sorted(contents(tmp_path)) == sorted(names)
    assert max(path.read_text().count("\n") for path in done.files) <= 700
    main = done.files[0].read_text()
    calls = [line for line in main.splitlines() if line.startswith("M98")]
    call = "M98({})" if dialect == "nanotech" else "M98 <{}>"
    assert calls == [call.format(name) for name in names[1:]]
    report = inspect_nc(tmp_path / "part.nc")
    assert report.header.design == "Lens [A.1]"
    assert report.header.tool == "R1.5 + waviness"
    assert report.header.date == "2026-01-02"
    assert report.header.notes == " ".join(["?m", "line"] * 30)
    assert (report.machine, report.dialect) == ("lathe", dialect)
    assert f"( MINUTES: {done.minutes:.3f} )" in main


@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
def test_hash_is_the_one_that_its_definition_gives(tmp_path, dialect):
    """An independent reckoning from the words in the file, with hashlib and struct layout alone."""
    done = write_nc(motion(300), machine(dialect), tmp_path / "part.nc", depth=None)
    text = done.files[-1].read_text()
    rows, duration = [], 0.0
    position = {}
    for line in text.splitlines():
        if line.startswith("("):
            continue
        cut = "C" in line and "X" in line
        for word in line.split():
            if word[0] in "CXZ":
                position[word[0]] = int(word[1:].replace(".", ""))
            if word[0] == "F" and cut:
                duration = float(word[1:]) if dialect == "nanotech" else 60 / float(word[1:])
        order = "CXZ" if dialect == "nanotech" else "XZC"
        if cut:
            low, high = struct.unpack("<II", struct.pack("<d", duration))
            rows.append([*(position[letter] % 2**32 for letter in order), low ^ high])
        elif line.endswith("(ABOVE THE MATERIAL)"):
            rows.append([*(position[letter] % 2**32 for letter in order), 0])
    assert len(rows) == 300
    assert hashlib.sha256(b"".join(struct.pack("<4I", *row) for row in rows)).hexdigest() == done.passes[0].hash


@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
def test_a_shorter_program_leaves_no_old_part_behind(tmp_path, dialect):
    (tmp_path / "part.finish.009.nc").write_text("(SOMEBODY ELSE'S)\n")
    write_nc({"rough": motion(900), "finish": motion(900)}, machine(dialect), tmp_path / "part.nc", max_lines=400)
    write_nc(motion(100), machine(dialect), tmp_path / "part.nc", max_lines=400, depth=None)
    expected = ["part.finish.009.nc", "part.nc"] + (["part.finish.001.nc"] if dialect == "nanotech" else [])
    assert sorted(contents(tmp_path)) == sorted(expected)
    assert read_nc(tmp_path / "part.nc", machine(dialect)).time.size == 100


def stop(done, total):
    if done > total / 2:
        raise KeyboardInterrupt


@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
@pytest.mark.parametrize("there", [True, False])
def test_ctrl_c_leaves_everything_as_it_was(tmp_path, dialect, there):
    if there:
        write_nc(motion(900), machine(dialect), tmp_path / "part.nc", max_lines=400)
    before = contents(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        write_nc(motion(200_000), machine(dialect), tmp_path / "part.nc", progress=stop)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
@pytest.mark.parametrize("nth", range(8))
@pytest.mark.parametrize("stopped_by", [OSError(errno.EIO, "Input/output error"), KeyboardInterrupt()])
def test_a_failure_while_files_are_put_in_place_is_undone(tmp_path, monkeypatch, dialect, nth, stopped_by):
    write_nc(motion(900), machine(dialect), tmp_path / "part.nc", max_lines=400)
    before = contents(tmp_path)
    calls = []
    replace = Path.replace

    def failing(self, target):
        calls.append(target)
        if len(calls) == nth + 1:
            raise stopped_by
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", failing)
    kind = ProgramError if isinstance(stopped_by, OSError) else KeyboardInterrupt
    try:
        write_nc(motion(1000, 0.5), machine(dialect), tmp_path / "part.nc", max_lines=400)
    except kind:
        assert contents(tmp_path) == before
    else:
        assert len(calls) <= nth  # it was done before the nth move
        assert contents(tmp_path) != before


def test_full_disk_in_one_sentence(tmp_path, monkeypatch):
    write_nc(motion(900), machine(), tmp_path / "part.nc")
    before = contents(tmp_path)
    opened = Path.open

    class Full:
        """A file on a disk with little room left."""

        def __init__(self, file):
            self.file, self.room = file, 20_000

        def write(self, data):
            self.room -= len(data)
            if self.room < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return self.file.write(data)

        def __enter__(self):
            return self

        def __exit__(self, *args):
            self.file.close()

    def full(self, mode="r", *args, **kwargs):
        file = opened(self, mode, *args, **kwargs)
        return Full(file) if "w" in mode else file

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(
        ProgramError, match=r"^the disk is full while writing .*part.nc, nothing was changed there: free"
    ):
        write_nc(motion(5000), machine(), tmp_path / "part.nc")
    monkeypatch.undo()
    assert contents(tmp_path) == before


LIMITED = """
    import resource, signal, sys
    import numpy as np
    from pathlib import Path
    sys.path.insert(0, sys.argv[2])
    from test_program_files import machine, motion
    from turnwright.post import write_nc
    write_nc(motion(50), machine(), Path(sys.argv[1]) / "warm.nc")
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    sys.dont_write_bytecode = True  # it would be cut, and kept
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
    try:
        write_nc(motion(50_000), machine(), Path(sys.argv[1]) / "part.nc")
    except Exception as error:
        print(type(error).__name__, error)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="file size limits are a Unix matter")
def test_a_file_that_the_system_does_not_let_grow(tmp_path):
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(LIMITED), str(tmp_path), str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.startswith("ProgramError")
    assert "exceeds the largest size allowed here (File too large), nothing was changed" in run.stdout
    assert sorted(contents(tmp_path)) == ["warm.finish.001.nc", "warm.nc"]


@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
@pytest.mark.parametrize("lines", [100, 137, 400])
def test_a_plunge_is_split_like_its_cut(tmp_path, dialect, lines):
    passes = {"rough": motion(800, 0.1), "finish": motion(1000)}
    done = write_nc(passes, machine(dialect), tmp_path / "part.nc", max_lines=lines, depth=0.2)
    texts = [path.read_text() for path in done.files]
    assert max(text.count("\n") for text in texts) <= lines
    assert sum(text.count("\n") for text in texts) == done.lines
    assert sum(len(text) for text in texts) == done.bytes
    for name, whole in passes.items():
        again = read_nc(tmp_path / "part.nc", machine(dialect), name=name)
        assert again.time.size == whole.time.size
        assert again.axes["C"] == pytest.approx(whole.axes["C"], abs=1e-7)
        assert again.axes["Z"] == pytest.approx(whole.axes["Z"], abs=6e-7)


@pytest.mark.parametrize("place", ["gone/part.nc", "file.txt/part.nc"])
def test_folders_that_are_not_there(tmp_path, place):
    (tmp_path / "file.txt").write_text("")
    with pytest.raises(ProgramError, match="is not a folder"):
        write_nc(motion(), machine(), tmp_path / place)


def test_progress_ends_at_the_end(tmp_path):
    seen = []
    write_nc(
        {"rough": motion(70_000), "finish": motion(900)},
        machine(),
        tmp_path / "part.nc",
        progress=lambda *a: seen.append(a),
    )
    assert seen == sorted(seen)
    assert seen[-1] == (70_900, 70_900)
    seen.clear()
    read_nc(tmp_path / "part.nc", machine(), progress=lambda *a: seen.append(a))
    assert seen == sorted(seen)
    assert seen[-1][0] == seen[-1][1] == sum(path.stat().st_size for path in tmp_path.iterdir())


def test_ctrl_c_while_reading_passes_through(tmp_path):
    write_nc(motion(), machine(), tmp_path / "part.nc")

    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        read_nc(tmp_path / "part.nc", machine(), progress=interrupt)


def test_one_file_of_a_split_pass_can_be_read_alone(tmp_path):
    whole = motion(1000)
    done = write_nc(whole, machine(), tmp_path / "part.nc", max_lines=400, depth=None)
    second = read_nc(done.files[2], machine())
    where = slice(371, 741)  # points that begin and end its blocks; the first block only says where the tool is
    assert second.axes["X"] == pytest.approx(whole.axes["X"][where], abs=6e-7)
    assert second.time == pytest.approx(whole.time[where] - whole.time[371], abs=1e-9)


def test_nothing_heavy_is_imported_with_the_package():
    script = "import sys, turnwright.post; print('numba' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
