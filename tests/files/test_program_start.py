"""Work offset, tool call, auxiliary functions and dry run of a program, by its lines and by reading it back."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.cli import main
from turnwright.errors import JobError
from turnwright.job import Pipeline

JOB = {
    "part": {"surface": {"family": "sphere", "radius": "50 mm"}, "radius": "2 mm", "stock": "20 um"},
    "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
    "machine": {"name": "nanoform"},
    "strategy": {"kind": "turning", "feed": "20 um/rev", "spindle_speed": "1000 rpm", "chord": "10 nm"},
}
START = {"work_offset": "G55", "tool_call": "T0303", "auxiliary": ["mist", "coolant"], "dry_run": "2 mm"}


def job_of(**program):
    return tw.Job.read({**JOB, "program": program})


def lines_of(file):
    return [line for line in file.read_text().splitlines() if not line.startswith("(")]


def test_a_program_selects_what_the_job_states(tmp_path):
    done = Pipeline(job_of(**START), out=tmp_path).program
    lines = lines_of(done.files[0])
    assert lines[1:5] == ["G55", "T0303", "M07", "M08"]
    assert lines[-2:] == ["M09", "M30"]
    assert "BEFORE THE START" not in done.files[0].read_text()
    plain = Pipeline(job_of(), out=tmp_path / "plain").program
    assert "( BEFORE THE START: SELECT WORK OFFSET AND TOOL )" in plain.files[0].read_text()
    again = tw.read_nc(done.files[0], tw.Machine.load("nanoform"))
    assert again == tw.read_nc(plain.files[0], tw.Machine.load("nanoform"))


@pytest.mark.parametrize("kind", ["turning", "slow tool servo"])
def test_a_dry_run_is_the_program_higher(tmp_path, kind):
    servo = JOB["strategy"]
    if kind != "turning":
        servo = {"kind": kind, "feed": "20 um/rev", "spindle_speed": "100 rpm", "points_per_rev": 60}
    job = tw.Job.read({**JOB, "strategy": servo, "program": {"dry_run": "2 mm"}})
    program, dry = Pipeline(job, out=tmp_path).program.files
    assert dry.name == "part-dry.nc"
    cut, air = (tw.read_nc(file, job.machine) for file in (program, dry))
    assert np.abs(air.axes["Z"] - cut.axes["Z"] - 2.0).max() < 1e-9
    for letter in "CX":
        assert np.abs(air.axes[letter] - cut.axes[letter]).max() < 1e-6
    low = min(float(word[1:]) for line in lines_of(dry) for word in line.split() if word.startswith("Z"))
    assert low == pytest.approx(2.0 + cut.axes["Z"].min(), abs=1e-6)


@pytest.mark.parametrize(
    ("program", "field"),
    [
        ({"work_offset": "G53"}, "work_offset"),
        ({"tool_call": "T0101\nM30"}, "tool_call"),
        ({"auxiliary": ["vacuum"]}, "auxiliary"),
        ({"dry_run": "0 mm"}, "dry_run"),
        ({"dry_run": "20 um"}, "part.stock"),
        ({"tool_call": "G0 X0 Z0"}, "tool_call"),
        ({"tool_call": "M03 S500"}, "tool_call"),
    ],
)
def test_a_wrong_start_is_refused(program, field):
    with pytest.raises(JobError, match=field):
        job_of(**program)


def test_a_run_with_a_dry_run_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("turnwright.report.figures._print_svg", lambda _canvas: "<svg></svg>")
    job_of(**START).dump(tmp_path / "job.toml")
    assert main(["run", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "part-dry.nc").exists()
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Retract in Z first" in page
    assert "set C by whole turns" not in page  # the spindle runs freely
