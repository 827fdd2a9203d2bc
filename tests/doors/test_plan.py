"""`turnwright plan`: from tolerances to a job that keeps them."""

import pytest
from job_files import written

from turnwright.cli import main
from turnwright.errors import JobError
from turnwright.job import Job, plan, run

TOLERANCES = {"form_pv": "300 nm", "sq": "20 nm"}


def test_a_plan_is_a_job_that_keeps_its_tolerances(tmp_path, capsys):
    """Oracle: `run` on the planned job warns of no tolerance, on the job's own grids."""
    job = written(tmp_path, ("tolerances", TOLERANCES), ("strategy.overrun", "5 um"))
    assert main(["plan", str(job), "--out", str(tmp_path / "planned.toml")]) == 0
    said = capsys.readouterr().out
    planned, asked = Job.load(tmp_path / "planned.toml"), Job.load(job)
    assert planned.strategy.feed != asked.strategy.feed
    assert planned.strategy.points_per_rev is None
    assert (planned.part, planned.tool, planned.machine) == (asked.part, asked.tool, asked.machine)
    for word in ("cusps", "points", "decimals", "servos", "nearest to its limit"):
        assert word in said
    assert main(["run", str(tmp_path / "planned.toml"), "--out", str(tmp_path / "out")]) == 0
    assert "the tolerance is" not in capsys.readouterr().err


def test_what_is_there_is_kept(tmp_path, capsys):
    job = written(tmp_path, ("tolerances", TOLERANCES))
    before = job.read_bytes()
    assert main(["plan", str(job), "--out", str(job)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert job.read_bytes() == before


def test_a_plan_needs_tolerances(tmp_path, capsys):
    job = written(tmp_path)
    assert main(["plan", str(job), "--out", str(tmp_path / "planned.toml")]) == 2
    assert "needs both" in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["job.toml"]


def test_a_tolerance_that_no_plan_keeps_is_one_sentence(tmp_path, capsys):
    job = written(tmp_path, ("tolerances", {"form_pv": "2 nm", "sq": "0.5 nm"}))
    assert main(["plan", str(job), "--out", str(tmp_path / "planned.toml")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith("turnwright: ")
    assert "allow more" in said[-1] or "smaller nose_radius" in said[-1]


@pytest.mark.parametrize(
    "changes",
    [
        [("strategy", {"kind": "adaptive tool servo", "scallop": "1 um", "chord": "1 um"})],
        [
            ("machine.name", "nanoform-fts-70"),
            ("strategy", {"kind": "fast tool servo", "feed": "1 um/rev", "points_per_rev": 100}),
            ("program", {"fast_tool": "position"}),
        ],
    ],
    ids=["adaptive", "fast"],
)
def test_other_strategies_are_planned_too(changes, tmp_path):
    """Oracle: `run` on the planned job, by its own maps."""
    waves = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["0.5 mm", "0.5 mm"]}
    job = Job.load(written(tmp_path, ("tolerances", TOLERANCES), ("part.surface", waves), ("part.radius", "0.4 mm"),
                           ("simulation", {"whole_part": {"radii": 800, "angles": 60}}), *changes))  # fmt: skip
    chosen = plan(job)
    assert chosen.limits.ok
    assert 15 < chosen.shares.sq_nm <= 20
    assert run(chosen.job, out=tmp_path).predictions[0].roughness.pv_nm <= 300


def test_a_strategy_without_a_chord_is_one_sentence(tmp_path):
    swing = {
        "kind": "quasi-elliptical tool servo",
        "feed": "5 um/rev",
        "points_per_rev": 360,
        "short": "skip",
        "shortest": "1 um",
    }
    with pytest.raises(JobError, match="choose another kind"):
        plan(Job.load(written(tmp_path, ("tolerances", TOLERANCES), ("strategy", swing))))
