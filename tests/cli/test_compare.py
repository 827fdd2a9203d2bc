"""`turnwright compare`: every strategy that the machine can do, at one cusp and one chord."""

import contextlib
import io
import json
import math

import numpy as np
import pytest

import turnwright as tw
from job_files import written
from turnwright.cli import main
from turnwright.errors import Stopped
from turnwright.job import Job, compare, run

WAVES = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["0.5 mm", "0.5 mm"]}
CHANGES = [
    ("part.surface", WAVES),
    ("part.radius", "0.5 mm"),
    ("strategy", {"kind": "slow tool servo", "feed": "10 um/rev", "chord": "10 nm", "overrun": "2.5 um"}),
    ("simulation", {}),
]


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """The job compared by the command: what it has found, the folder that it has written, and what it has said."""
    folder, found, said = tmp_path_factory.mktemp("compared"), [], io.StringIO()

    def noted(*given, **named):
        found.append(compare(*given, **named))
        return found[0]

    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.setattr("turnwright.job.compare", noted)
        assert main(["compare", str(written(folder, *CHANGES)), "--out", str(folder / "out")]) == 0
    return found[0], folder / "out", said.getvalue()


@pytest.fixture
def errors_known(compared, monkeypatch):
    """Take the errors of a strategy as known, most of the time of a comparison, where a test is of something else."""
    monkeypatch.setattr(
        "turnwright.job.pipeline.break_down_error", lambda *_, **__: compared[0].candidates[0].breakdown
    )


def test_all_keep_what_the_job_keeps(compared):
    """Oracle: what was asked of them, simulated outside of the planners; the cusp of a flat in closed form."""
    found, *_ = compared
    assert found.chord == 1e-5
    flat = 0.5 - math.sqrt(0.5**2 - 0.01**2 / 4)
    assert flat < found.scallop < 1.1 * flat
    assert [one.name for one in found.candidates] == [
        "the current job", "slow, constant angle", "slow, points by chord", "adaptive points",
        "adaptive points and feed",
    ]  # fmt: skip
    for one in found.candidates:
        assert not one.refused
        assert one.limits.ok
        # Points stand within the chord of the path; where they do, the surface differs by as much but for slopes.
        assert one.breakdown.chord_nm < found.chord * 1e6 * 1.03
        assert one.breakdown.cusp_away_nm < found.scallop * 1e6 * 1.02
        assert one.breakdown.pv_nm < one.breakdown.cusp_nm + 2 * one.breakdown.chord_nm + 2 * one.breakdown.rounding_nm
    _, even, by_chord, steady, adaptive = found.candidates
    assert even.limits.points > by_chord.limits.points > steady.limits.points
    assert adaptive.turns < steady.turns


@pytest.mark.usefixtures("errors_known")
def test_lead_in_and_overrun_of_the_job_are_kept(tmp_path):
    """Oracle: what the job states, in every strategy of constant feed, and the ends of its spiral."""
    job = Job.load(written(tmp_path, *CHANGES, ("strategy.lead_in", "50 um")))
    found = compare(job)
    slow = [one for one in found.candidates if one.name.startswith("slow")]
    assert len(slow) == 2
    for one in slow:
        assert (one.servo.overrun, one.servo.lead_in) == (0.0025, 0.05)
        spiral = one.servo.spiral(job.part, job.tool)
        assert (spiral.radius.min(), spiral.radius.max()) == pytest.approx((-0.0025, 0.55), abs=1e-9)
        assert found.stated(one)["overrun"] == "2.5 um"


@pytest.mark.usefixtures("errors_known")
def test_the_job_as_it_stands_is_the_first(tmp_path):
    """Oracle: `run` on the same job, whose points, minutes and strategy these are."""
    own = {"kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 400, "along": "normal"}
    job = Job.load(written(tmp_path, *CHANGES, ("strategy", own), ("strategy.spindle_speed", "40 rpm")))
    found, done = compare(job), run(job)
    first = found.candidates[0]
    assert first.name == "the current job"
    assert first.limits.points == done.passes[-1].points
    assert first.limits.cycle_time_s == done.passes[-1].limits.cycle_time_s
    assert first.limits.peak_acceleration == done.passes[-1].limits.peak_acceleration  # places along the normal too
    assert found.stated(first) == {**own, "spindle_speed": "40 rpm"}


@pytest.mark.usefixtures("errors_known")
def test_fast_and_swinging_tools_join_where_the_machine_has_them(tmp_path):
    found = compare(Job.load(written(tmp_path, *CHANGES, ("machine.name", "nanoform-fts-70"))))
    fast = {one.name: one for one in found.candidates}
    assert {"fast", "hybrid"} <= set(fast)
    assert fast["fast"].limits.travel["Z"][0] == fast["fast"].limits.travel["Z"][1]
    assert fast["fast"].limits.cycle_time_s < fast["slow, constant angle"].limits.cycle_time_s


@pytest.mark.usefixtures("errors_known")
@pytest.mark.parametrize(
    ("machine", "strategy"),
    [
        ("nanoform-fts-70", {"spindle_speed": "60 rpm", "sense": -1}),
        ("generic", {"kind": "adaptive tool servo", "scallop": "20 nm", "chord": "9 nm", "inside_out": True}),
    ],
)
def test_a_job_file_can_state_each_strategy(tmp_path, machine, strategy):
    """Oracle: the strategies themselves, as `Job` sets them up from the tables."""
    base = {} if "kind" in strategy else dict(CHANGES[2][1])
    changes = [one for one in CHANGES if one[0] != "strategy"]
    file = written(tmp_path, *changes, ("machine.name", machine), ("strategy", base | strategy))
    found = compare(Job.load(file))
    others = found.candidates[1:]  # the first is the job itself, which may be one of them
    report = [found.stated(one) for one in others]
    assert len({str(one) for one in report}) == len(report) > 3
    for one, table in zip(others, report, strict=True):
        program = {"fast_tool": "position"} if table["kind"].startswith(("fast", "hybrid")) else {}
        job = Job.load(
            written(tmp_path, *changes, ("machine.name", machine), ("strategy", table), ("program", program))
        )
        again = job.servo(job.passes[-1])
        assert type(again) is type(one.servo)
        for mine, theirs in ((again, one.servo), (getattr(again, "plan", None), getattr(one.servo, "plan", None))):
            for name in (
                "feed",
                "points_per_rev",
                "chord",
                "scallop",
                "sense",
                "inside_out",
                "spindle_rpm",
                "x_motion",
            ):
                want = getattr(theirs, name, None)
                assert getattr(mine, name, None) == (
                    pytest.approx(want, rel=1e-12) if isinstance(want, float) else want
                )
        assert getattr(again, "blocks_per_rev", None) == getattr(one.servo, "blocks_per_rev", None)


@pytest.mark.usefixtures("errors_known")
def test_impossible_strategies_are_reported_and_others_go_on(tmp_path):
    """A tool that stands in a wave too deep for the stroke of its fast tool."""
    deep = {**WAVES, "amplitude": ["40 um", "40 um"], "period": ["2 mm", "2 mm"]}
    found = compare(Job.load(written(tmp_path, *CHANGES, ("part.surface", deep), ("machine.name", "nanoform-fts-70"))))
    report = {one.name: one for one in found.candidates}
    assert report["slow, points by chord"].limits.ok
    fast = report["fast"]
    assert fast.refused or any("W" in sentence for sentence in fast.limits.findings)


@pytest.mark.usefixtures("errors_known")
def test_a_defect_in_one_strategy_leaves_the_page_of_the_others(tmp_path, monkeypatch, capsys):
    def fail(*_, **__):
        raise IndexError("index -261 is out of bounds")

    monkeypatch.setattr(tw.AdaptiveToolServo, "spiral", fail)
    job = written(tmp_path, *CHANGES)
    assert main(["compare", str(job), "--out", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    candidates = json.loads((tmp_path / "out" / "comparison.json").read_text())["candidates"]
    refused = {one["name"]: one["refused"] for one in candidates}
    planned = [name for name, reason in refused.items() if not reason]
    assert planned == ["the current job", "slow, constant angle", "slow, points by chord"]
    assert "IndexError: index -261" in refused["adaptive points"]
    assert "IndexError: index" in (tmp_path / "out" / "report.html").read_text()


def test_the_page_and_the_numbers_say_the_same(compared):
    _, out, message = compared
    assert {file.name for file in out.iterdir()} == {"comparison.json", "job.toml", "report.html"}
    numbers = json.loads((out / "comparison.json").read_text())
    page = (out / "report.html").read_text()
    for one in numbers["candidates"]:
        assert f"{one['name']}: " in message
        assert f"{one['limits']['points']:,}" in page
        assert np.isfinite(one["breakdown"]["pv_nm"])
    assert "<script" not in page
    assert tw.__version__ in page


def test_a_machine_without_a_fast_tool_is_one_sentence(tmp_path, capsys):
    job = written(tmp_path, *CHANGES, ("strategy.kind", "hybrid tool servo"))
    assert main(["compare", str(job), "--out", str(tmp_path / "out")]) == 2
    assert "choose a machine with a fast tool" in capsys.readouterr().err.splitlines()[-1]


def test_a_stop_request_is_obeyed_within_a_strategy(tmp_path):
    """Oracle: what the progress raises comes out, as Ctrl-C does, and is not taken for the strategy's refusal."""
    report = []

    def stop(stage, done, total):
        report.append((stage, done, total))
        if stage == "adaptive points" and 0 < done < total:
            raise Stopped("enough")

    with pytest.raises(Stopped):
        compare(Job.load(written(tmp_path, *CHANGES)), progress=stop)
    assert report[-1][0] == "adaptive points"
