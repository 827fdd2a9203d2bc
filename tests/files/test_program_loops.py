"""Loops in programs: written for the cuts of a repeated pass, and followed when read."""

import re
from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from turnwright.cli import main
from turnwright.errors import InputError, ProgramError
from turnwright.job import Pipeline, find_wrong_move
from turnwright.post import Dialect, ProgramWarning, read_moves

TABLE = {
    "part": {"surface": {"family": "sphere", "radius": "50 mm"}, "radius": "5 mm", "stock": "60 um"},
    "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
    "strategy": {"kind": "turning", "feed": "5 um/rev", "spindle_speed": "1500 rpm", "chord": "10 nm"},
    "passes": [
        {"name": "rough", "feed": "20 um/rev", "chord": "0.1 um", "allowance": "8 um", "depth": "18 um"},
        {"name": "finish"},
    ],
}


def lathe(dialect, **changes):
    return replace(tw.Machine.load("nanoform"), dialect=dialect, **changes)


def job_of(tmp_path, dialect, extra="", **changes):
    (tmp_path / "lathe.toml").write_text(f'base = "nanoform"\ndialect = "{dialect}"\n{extra}')
    return tw.Job.read({**TABLE, **changes, "machine": {"file": "lathe.toml"}}, folder=tmp_path)


@pytest.mark.parametrize(("inside_out", "z_sign"), every_second([False, True], [1, -1]))
def test_a_repeated_pass_is_a_loop_that_reads_as_its_cuts(tmp_path, z_sign, inside_out):
    """Oracle: the motions of the job, and the same program without loops."""
    strategy = {**TABLE["strategy"], "inside_out": inside_out}
    signs = f"[convention]\nz_sign = {z_sign}\n"
    line = Pipeline(job_of(tmp_path, "diffsys-2d", signs, strategy=strategy), out=tmp_path / "loops")
    file = line.program.files[0]
    text = file.read_text()
    assert text.count("WHILE [") == 1
    assert text.count("G52 Z#2") == 1
    assert text.count("\nM04 S1500\n") == 2  # in the loop and in the finish
    plain = Pipeline(job_of(tmp_path, "nanotech", signs, strategy=strategy), out=tmp_path / "plain").program
    assert len(text.splitlines()) < 0.7 * plain.lines
    for cut in line.cuts():
        again = tw.read_nc(file, line.job.machine, name=cut.name)
        assert again.sense == cut.motion.sense
        for letter in "XZ":
            off = again.axes[letter][again.blocks] - cut.motion.axes[letter][cut.motion.blocks]
            assert np.abs(off).max() < 1.6e-6  # half a decimal, and that of the step twice
        other = tw.read_nc(plain.files[0], lathe("nanotech", convention=line.job.machine.convention), name=cut.name)
        assert np.abs(other.axes["Z"] - again.axes["Z"]).max() < 2.1e-6
    assert find_wrong_move(line.job, file) == ""


def test_the_tool_comes_down_to_the_first_cut_of_a_loop_and_to_all_others(tmp_path):
    """Oracle: the highest material before each cut, 0.1 mm above which the slow plunge begins."""
    job = job_of(tmp_path, "diffsys-2d")
    line = Pipeline(job, out=tmp_path)
    entries = line.entries({cut.name: cut.motion for cut in line.cuts()})
    down = [one for one in read_moves(line.program.files[0], job.machine) if one.spindle_cut == 0 and not one.is_rapid]
    starts = [one.end[2] for one in down if one.end[2] < one.start[2] and one.start[2] - one.end[2] > 1]
    assert len(starts) == 4
    for start, entry in zip(starts, entries.values(), strict=True):
        assert start >= entry.approach.start["Z"] - 2e-6
        assert start <= entry.approach.start["Z"] + 0.03


def test_a_job_in_the_frame_runs_and_is_backplotted(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("turnwright.report.figures._print_svg", lambda _canvas: "<svg></svg>")
    job_of(tmp_path, "diffsys-2d").dump(tmp_path / "job.toml")
    assert main(["run", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]) == 0
    assert main(["backplot", str(tmp_path / "out" / "part.nc"), "--job", str(tmp_path / "job.toml")]) == 0
    capsys.readouterr()


def test_cuts_with_uneven_steps_are_written_out(tmp_path):
    passes = [{**TABLE["passes"][0], "name": f"rough {k}", "allowance": f"{a} um", "depth": "60 um"}
              for k, a in ((1, 40), (2, 25), (3, 8))]  # fmt: skip
    line = Pipeline(job_of(tmp_path, "diffsys-2d", passes=[*passes, {"name": "finish"}]), out=tmp_path)
    text = line.program.files[0].read_text()
    assert "WHILE [" not in text
    assert all(f"( PASS: rough {k} )" in text for k in (1, 2, 3))


def test_cuts_that_do_not_count_from_one_are_written_out(tmp_path):
    passes = [{**TABLE["passes"][0], "name": f"rough {k}", "allowance": f"{a} um", "depth": "60 um"}
              for k, a in ((5, 40), (6, 20))]  # fmt: skip
    line = Pipeline(job_of(tmp_path, "diffsys-2d", passes=[*passes, {"name": "finish"}]), out=tmp_path)
    assert "WHILE [" not in line.program.files[0].read_text()
    assert [tw.read_nc(line.program.files[0], line.job.machine, name=f"rough {k}").time.size > 1 for k in (5, 6)]


def test_a_foreign_loop_gives_one_cut_each_time(tmp_path):
    """Oracle: arithmetic. The origin is 0.3, 0.2 and 0.1 mm high, and 0 after the loop."""
    (tmp_path / "foreign.nc").write_text(
        "G71 G90\n#5 = 0.3\nWHILE [#5 GT 0.05] DO1\nG52 Z#5\nG94\nG0 Z5\nG0 X3\nM03 S1000\nG1 Z0.5 F50\n"
        "G1 X2 Z0.4 F20\nX1 Z0.3\nG0 Z5\nM05\n#5 = #5 - 0.1\nEND1\nG52 Z0\nG0 Z5\nG0 X3\nM03 S1000\nG1 Z0.5 F50\n"
        "G1 X2 Z0.4\nX1 Z0.25\nG0 Z5\nM05\nM30\n"
    )
    for number, height in enumerate((0.3, 0.2, 0.1), 1):
        cut = tw.read_nc(tmp_path / "foreign.nc", lathe("diffsys-2d"), name=f"cut {number}")
        assert cut.axes["Z"][cut.blocks] == pytest.approx(np.array([0.5, 0.4, 0.3]) + height, abs=1e-12)
        assert cut.axes["X"][cut.blocks].tolist() == [3.0, 2.0, 1.0]
    last = tw.read_nc(tmp_path / "foreign.nc", lathe("diffsys-2d"), name="cut 4")
    assert last.axes["Z"][last.blocks].tolist() == [0.5, 0.4, 0.25]
    with pytest.raises(ProgramError, match="line 4 shifts the origin"):
        tw.read_nc(tmp_path / "foreign.nc", lathe("nanotech"))


def test_loops_within_loops_and_with_c_as_an_axis(tmp_path):
    """Oracle: a table of 2 x 3 cuts; blocks that turn C are read in bulk each time."""
    (tmp_path / "nested.nc").write_text(
        "G71 G90\n#1 = 0\nWHILE [#1 LT 2] DO1\n#2 = 0\nWHILE [#2 LT 3] DO2\nG94\nG1 Z5 F100\nX3\nG0 C0\n"
        "G1 Z[1 + #1 + #2 / 10] F50\nG93\nC1 X2.9 F0.01\nC2 X2.8\nC3 X2.7\nG94\nG1 Z5 F100\n#2 = #2 + 1\nEND2\n"
        "#1 = #1 + 1\nEND1\nM30\n"
    )
    heights = []
    for number in range(1, 7):
        cut = tw.read_nc(tmp_path / "nested.nc", lathe("diffsys-2d"), name=f"cut {number}")
        assert cut.axes["X"].tolist() == [3.0, 2.9, 2.8, 2.7]
        heights.append(cut.axes["Z"][0])
    assert heights == pytest.approx([1.0, 1.1, 1.2, 2.0, 2.1, 2.2])


def test_half_a_loop_is_no_dialect():
    frame = Dialect.load("diffsys-2d")
    for field in ("loop_begin", "loop_end", "local_origin"):
        with pytest.raises(InputError, match="a loop needs all of them"):
            replace(frame, **{field: "" if field == "local_origin" else ()})


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        (r"#2 = #2 - 0.\d+", "#2 = #2 - 0.018", "rough 2"), (r"#2 = 0.\d+", "#2 = 0.045", "rough 1"),
        ("G52 Z0\n", "G52 Z-0.005\n", "finish"),
    ],
)  # fmt: skip
def test_an_edited_height_of_a_loop_is_noticed(tmp_path, old, new, name):
    line = Pipeline(job_of(tmp_path, "diffsys-2d"), out=tmp_path)
    file = line.program.files[0]
    text, count = re.subn(old, new, file.read_text(), count=1)
    assert count == 1
    file.write_text(text)
    with pytest.warns(ProgramWarning, match="edited or damaged"):
        tw.read_nc(file, line.job.machine, name=name)


def test_an_end_closes_a_loop_of_its_own_file(tmp_path):
    (tmp_path / "main.nc").write_text("G71 G90\n#1 = 0\nWHILE [#1 LT 2] DO1\n#1 = #1 + 1\nM98(sub.nc)\nEND1\nM30\n")
    (tmp_path / "sub.nc").write_text("G94\nG1 Z1 F20\nEND1\nM99\n")
    with pytest.raises(ProgramError, match="line 3 ends loop 1, no loop is open"):
        tw.read_nc(tmp_path / "main.nc", lathe("diffsys-2d"))


def test_deep_loops_are_refused(tmp_path):
    begin = "".join(f"#{k} = 0\nWHILE [#{k} LT 1] DO{k}\n" for k in range(1, 400))
    (tmp_path / "deep.nc").write_text(f"G71 G90\n{begin}M30\n")
    with pytest.raises(ProgramError, match="begins more than 20 loops within one another"):
        tw.read_nc(tmp_path / "deep.nc", lathe("diffsys-2d"))
