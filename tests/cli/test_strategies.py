"""Every way of cutting as a job: planned, written, read back, simulated."""

import numpy as np
import pytest

from cases import every_second
from job_files import changed, written
from turnwright.cli import main
from turnwright.errors import JobError
from turnwright.job import Job, run

WAVES = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["0.5 mm", "0.5 mm"]}
SPIRAL = {"feed": "20 um/rev", "points_per_rev": 180, "spindle_speed": "60 rpm", "lead_in": "0.3 mm"}
PART = [("part.surface", WAVES), ("part.radius", "0.5 mm"), ("simulation.patches", [])]
FAST = [("machine.name", "nanoform-fts-70")]
BLANK = ("part.blank", {"radius": "0.51 mm"})
"""A fast tool by time cannot plunge, so that the spiral begins outside the blank."""
ADAPTIVE = {"kind": "adaptive tool servo", "scallop": "80 nm", "chord": "10 nm", "spindle_speed": "60 rpm"}
SWINGING = {
    "kind": "quasi-elliptical tool servo",
    "feed": "5 um/rev",
    "points_per_rev": 360,
    "short": "skip",
    "shortest": "20 um",
}


def left(changes, tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    return run(Job.read(changed(*PART, *changes)), out=folder)


TABLES = {
    "by position": {"fast_tool": "position"},
    "by time": {"fast_tool": "time", "fast_tool_rate": "20 kHz"},
}


@pytest.mark.parametrize(("table", "kind"), every_second(TABLES, ["fast tool servo", "hybrid tool servo"]))
def test_a_fast_tool_leaves_what_the_slide_would(table, kind, tmp_path):
    slow = left([*FAST, ("strategy", {"kind": "slow tool servo", **SPIRAL})], tmp_path, "slow")
    program = ("program", TABLES[table])
    fast = left([*FAST, BLANK, ("strategy", {"kind": kind, **SPIRAL}), program], tmp_path, "fast")
    apart = fast.predictions[0].error.z - slow.predictions[0].error.z
    assert np.abs(apart).max() * 1e6 < slow.rounding_limit_nm + fast.rounding_limit_nm
    assert fast.rounding_nm <= fast.rounding_limit_nm < 2
    assert np.ptp(fast.motion.axes["W"]) > 1e-3, "the fast tool does the work"
    assert [file.name for file in fast.program.files][-1] == "part.fast.csv"
    assert fast.program.bytes == sum(file.stat().st_size for file in fast.program.files)


def test_a_fast_tool_is_back_plotted_with_its_table(tmp_path, capsys):
    job = written(
        tmp_path,
        *PART,
        *FAST,
        ("strategy", {"kind": "fast tool servo", **SPIRAL}),
        ("program", {"fast_tool": "position"}),
    )
    assert main(["run", str(job), "--out", str(tmp_path / "out")]) == 0
    report = capsys.readouterr().out
    assert main(["backplot", str(tmp_path / "out" / "part.nc"), "--job", str(job)]) == 0
    whole = next(line for line in report.splitlines() if line.startswith("whole part"))
    assert whole in capsys.readouterr().out


def test_an_adaptive_job_keeps_its_scallop(tmp_path):
    """Oracle: the cusp and chord that were asked for, found by simulation on a dense map."""
    found = left(
        [("strategy", ADAPTIVE), ("simulation.whole_part", {"radii": 1200, "angles": 72})], tmp_path, "adaptive"
    )
    z = found.predictions[0].error.z * 1e6
    assert 80 * 0.95 < z.max() < 80 + 10 + 2
    assert z.min() > -12


def test_a_two_axis_fast_tool_leaves_what_the_slides_would(tmp_path):
    (tmp_path / "two.toml").write_text('base = "nanoform-fts-70"\n[axes.U]\nlow = "-35 um"\nhigh = "35 um"\n')
    machine = [("machine", {"file": str(tmp_path / "two.toml")})]
    slow = left([*machine, ("strategy", ADAPTIVE)], tmp_path, "slow")
    split = [("strategy", {**ADAPTIVE, "x_motion": "split"}), ("program", {"fast_tool": "position"})]
    fast = left([*machine, *split], tmp_path, "fast")
    apart = fast.predictions[0].error.z - slow.predictions[0].error.z
    assert np.abs(apart).max() * 1e6 < slow.rounding_limit_nm + fast.rounding_limit_nm
    assert np.ptp(fast.motion.axes["U"]) > 1e-3, "the fast tool makes the fluctuation of X"
    assert fast.rounding_nm <= fast.rounding_limit_nm < 2


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ([("strategy.kind", "fast tool servo")], "fast_tool is not stated"),
        ([("program", {"fast_tool": "position"})], "any other strategy needs neither"),
        ([*FAST, ("strategy.kind", "fast tool servo"), ("program", {"fast_tool": "time"})], "a rate in Hz"),
        (
            [("strategy.kind", "hybrid tool servo"), ("program", {"fast_tool": "position"})],
            "choose a machine with a fast",
        ),
        ([("strategy.kind", "adaptive tool servo")], "strategy.feed is not a known key"),
        ([("strategy", {**ADAPTIVE, "along": "normal"})], "strategy.along is 'normal', it must be 'z'"),
        ([("strategy", {**SWINGING, "along": "normal"})], "strategy.along is 'normal', it must be 'z'"),
        (
            [*FAST, ("strategy", {"kind": "fast tool servo", **SPIRAL, "along": "normal"})],
            'must be "z" for the fast tool servo',
        ),
        ([("strategy", {**ADAPTIVE, "x_motion": "split"})], "fast_tool is not stated"),
        ([("strategy.kind", "quick tool servo")], "is not known"),
        (
            [
                (
                    "strategy",
                    {"kind": "quasi-elliptical tool servo", "feed": "5 um/rev", "points_per_rev": 360, "short": "skip"},
                )
            ],
            "shortest",
        ),
        (
            [
                ("strategy", {"kind": "adaptive tool servo", "scallop": "80 nm", "chord": "10 nm"}),
                ("passes", [{"name": "finish", "feed": "5 um/rev"}]),
            ],
            "feed is set, which the adaptive tool servo does not have",
        ),
        (
            [
                *FAST,
                ("strategy.kind", "fast tool servo"),
                ("program", {"fast_tool": "position"}),
                ("part.stock", "10 um"),
                ("passes", [{"name": "rough", "allowance": "2 um"}, {"name": "finish"}]),
            ],
            "must have 1 pass",
        ),
    ],
)
def test_what_does_not_fit_is_one_sentence(changes, sentence):
    with pytest.raises(JobError, match=sentence):
        Job.read(changed(*changes))


def test_a_stream_too_slow_for_the_motion_is_refused(tmp_path, capsys):
    program = {"fast_tool": "time", "fast_tool_rate": "1 Hz"}
    servo = {"kind": "fast tool servo", **SPIRAL}
    job = written(tmp_path, *PART, *FAST, BLANK, ("strategy", servo), ("program", program))
    assert main(["run", str(job), "--out", str(tmp_path / "out")]) == 2
    report = capsys.readouterr().err.splitlines()[-1]
    assert "at rate_hz 1 heights deviate by up to" in report
    assert "at up to 180 Hz" in report, "180 points a turn, 1 turn a second"
    assert not (tmp_path / "out").exists()


def test_spline_controller_is_judged_by_the_nominal_path(tmp_path):
    """A spline passes inside its points; corrected for, that is none of the servos' error, which fade when slow."""
    (tmp_path / "spline.toml").write_text(
        'base = "nanoform"\n[controller]\ninterpolation = "cubic spline"\n'
        "[axes.X.response]\nfrequency = '1000 Hz'\ndamping = 0.7\nvelocity_feedforward = 1.0\n"
        "[axes.Z.response]\nfrequency = '1000 Hz'\ndamping = 0.7\nvelocity_feedforward = 1.0\n"
    )
    found = left(
        [
            ("machine", {"file": str(tmp_path / "spline.toml")}),
            ("strategy", {"kind": "slow tool servo", **SPIRAL, "points_per_rev": 90}),
            ("simulation.tracking", True),
            ("program", {"precorrect": True}),
        ],
        tmp_path,
        "corrected",
    )
    added = found.predictions[0].tracking_nm
    assert added is not None
    assert added[1] < 1.0, "decimals and what a command of 90 points a second cannot correct; inside it would be 5 nm"


def test_the_page_shows_bandwidth_of_a_fast_tool(tmp_path):
    job = written(
        tmp_path, *PART, *FAST, ("strategy", {"kind": "fast tool servo", **SPIRAL}),
        ("program", {"fast_tool": "position"}),
    )  # fmt: skip
    assert main(["run", str(job), "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "W bandwidth" in page
    assert "700 Hz" in page.replace("\u202f", " ").replace("\u00a0", " ")


def test_a_plan_without_a_place_is_refused_before_it_is_made(tmp_path, capsys):
    job = written(tmp_path, *PART, ("tolerances", {"form_pv": "200 nm", "sq": "40 nm"}))
    assert main(["plan", str(job), "--out", str(tmp_path / "none" / "planned.toml")]) == 2
    (report,) = capsys.readouterr().err.splitlines()
    assert "the folder of" in report
    assert "does not exist" in report
