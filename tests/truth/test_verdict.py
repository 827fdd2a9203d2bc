"""What a part is judged by: the highest and the lowest place, one judge for all, and the cusps of a study."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from job_files import changed
from proof_verdict import judged, random_job
from tolerance_jobs import SERVO, job_of
from turnwright.generation import generate_polar
from turnwright.job import PassPlan, any_missed, finishing_motion, judge, judge_form, not_evaluated, plan, run
from turnwright.job.extremes import find_extremes
from turnwright.post import dialect_of
from turnwright.studies import ErrorBudget, Store
from turnwright.studies.draws import CaseContext, plan_cuts

DISH = {
    "part": {"name": "dish", "radius": "0.4 mm", "surface": {"family": "sphere", "radius": "20 mm"}},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 360, "spindle_speed": "60 rpm"},
    "simulation": {"whole_part": {"radii": 40, "angles": 36}},
}


def test_the_cusp_on_the_axis_counts_as_closed_form_has_it():
    """The middle of the last turn is a quarter of a feed off, its cusp 9/4 of f^2/(8 R (1 - R/radius))."""
    job = tw.Job.read(DISH | {"tolerances": {"form_pv": "40 nm"}})
    cusp = 0.01**2 / (8 * 0.5) * (1 - 0.5 / 20) ** -1 * 9 / 4 * 1e6
    exact = PassPlan(job).commanded
    assert find_extremes(exact, job.tool, job.part).pv_nm == pytest.approx(cusp, rel=2e-4)
    _, result = finishing_motion(job)
    whole = result.predictions[0]
    assert whole.pv_nm == pytest.approx(cusp, abs=2 * result.rounding_limit_nm)
    assert whole.roughness.pv_nm < 40 < whole.pv_nm
    assert not result.keeps_tolerances
    assert [one.is_kept for one in result.verdicts] == [False]
    assert any("form error PV is 5" in one for one in result.warnings)


def test_decimals_of_x_lift_the_tool_of_a_machine_that_is_not_square():
    """Oracle: half a decimal of Z, and half a decimal of X times the slope of the axis and of the cusps."""
    slope, feed = 0.099, 7.3e-3
    strategy = {"kind": "slow tool servo", "feed": f"{feed} mm/rev", "points_per_rev": 117}
    plane = ("part.surface", {"family": "plane"}), ("strategy", strategy)
    job = tw.Job.read(changed(*plane, ("machine.squareness", f"{slope * 1e3} mm/m")))
    result = run(job)
    decimals = dialect_of(job.machine).decimals
    half_x, half_z = (0.5 * 10.0 ** -decimals[letter] * 1e6 for letter in "XZ")
    assert result.rounding_nm <= result.rounding_limit_nm
    assert result.rounding_limit_nm >= half_z + half_x * slope
    assert result.rounding_limit_nm <= half_z + half_x * (slope + feed / (2 * 0.5)) * 1.2


def test_the_worst_of_many_scattered_points_is_found():
    """A flat: the lowest is the lowest point; the highest no less than any crossing of circles at a point's azimuth."""
    random = np.random.default_rng(3)
    feed, nose, turns, per_turn = 0.01, 0.5, 60, 47
    turned = np.arange(turns * per_turn + 1) * (2 * np.pi / per_turn)
    z = 4e-6 * random.standard_normal(turned.size)
    x = feed * (turns - turned / (2 * np.pi))
    machine, tool = tw.Machine.load("generic"), tw.Tool(nose_radius=nose, included=np.deg2rad(60), clearance=0.2)
    motion = tw.Motion(time=turned, axes={"C": turned, "X": x, "Z": z}, machine=machine)
    part = tw.Part(surface=tw.Plane(), radius=0.5)
    found = find_extremes(motion, tool, part)
    assert found.lowest.error == pytest.approx(z[x <= part.radius].min(), abs=1e-12)
    up = z[:-per_turn] - z[per_turn:]
    at = (x[:-per_turn] + x[per_turn:]) / 2 + up * np.sqrt(nose**2 / (feed**2 + up**2) - 0.25)
    there = (at > 0) & (at <= part.radius)
    at, angle = at[there], turned[:-per_turn][there]
    heights = tw.generate_points(motion, tool, x=at * np.cos(angle), y=at * np.sin(angle))
    assert found.highest.error >= heights.max() - 1e-12


@pytest.mark.parametrize("number", [1, pytest.param(3, marks=pytest.mark.proof), 8])
def test_no_grid_shows_more_than_the_stated_pv(number):
    rng = np.random.default_rng([1, number])
    found = judged(random_job(rng, largest=0.6), rng)
    assert found["beyond"] < 1e-6
    assert found["stated"] <= 1.01 * found["refined"] + 1e-3


def test_places_that_no_pass_cuts_keep_no_tolerance():
    table = DISH | {"tolerances": {"form_pv": "1 mm"}, "actual": {"tool": {"offset": ["0 um", "3 um", "0 um"]}}}
    _, result = finishing_motion(tw.Job.read(table))
    (verdict,) = result.verdicts
    assert verdict.is_kept is False
    assert "points are not cut" in verdict.sentence


def test_the_judge_says_what_is_not_judged():
    job = tw.Job.read(DISH | {"tolerances": {"form_pv": "40 nm", "sq": "8 nm"}})
    assert [one.is_kept for one in not_evaluated(job, "no surface")] == [None, None]
    form, sq = judge_form(job, 41.0, reason="a map of the form")
    assert (form.is_kept, sq.is_kept) == (False, None)
    assert "a map of the form" in sq.sentence
    assert any_missed((form, sq))
    assert not any_missed((sq,))
    assert [one.is_kept for one in judge(job, ())] == [None, None]


def test_a_job_without_patches_is_judged_by_its_roughest_ring():
    _, result = finishing_motion(tw.Job.read(DISH | {"tolerances": {"sq": "5 nm"}}))
    (verdict,) = result.verdicts
    cusp = 0.01**2 / (8 * 0.5 * (1 - 0.5 / 20)) * 1e6
    assert verdict.value == pytest.approx(cusp * np.sqrt(4 / 45), rel=0.1)
    assert verdict.is_kept is False


PATCH = {"name": "p", "centre": ["0.25 mm", "0 mm"], "size": ["60 um", "60 um"], "pixel": "1 um"}


def test_plan_judges_the_finish_as_run_does_form_included():
    table = DISH | {
        "tolerances": {"form_pv": "60 nm", "sq": "8 nm"},
        "roughness": {"form": "none"},
        "simulation": {"patches": [PATCH]},
    }
    chosen = plan(tw.Job.read(table))
    _, result = finishing_motion(chosen.job)
    assert result.keeps_tolerances
    for own, again in zip(chosen.verdicts, result.verdicts, strict=True):
        assert own.value == pytest.approx(again.value, rel=1e-6)


def test_a_plan_with_servos_is_run_with_servos(tmp_path):
    (tmp_path / "lathe.toml").write_text(SERVO, encoding="utf-8")
    table = DISH | {
        "machine": {"file": str(tmp_path / "lathe.toml")}, "tolerances": {"form_pv": "100 nm", "sq": "10 nm"},
    }  # fmt: skip
    chosen = plan(tw.Job.read(table))
    assert chosen.job.simulation.tracking
    _, result = finishing_motion(chosen.job)
    assert result.predictions[0].pv_nm == pytest.approx(chosen.breakdown.pv_nm, rel=1e-6)
    assert result.keeps_tolerances


@pytest.mark.parametrize("kind", ["mirror", "flat"])
def test_a_study_without_errors_finds_the_cusps_of_a_dense_map(kind, tmp_path):
    job = job_of(kind)
    job = tw.Job.read({**job.table(), "simulation": {}})
    shared = plan_cuts(job, ErrorBudget.typical(), Store.open(tmp_path / "store"), correction=False)
    bench = CaseContext.of(shared, Store.open(tmp_path / "store"))
    found, _ = bench.measure(bench.real({}))
    motion, result = finishing_motion(job)
    count = 2000
    radius = job.part.radius * np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False) + 0.01
    error = generate_polar(motion, job.tool, radius=radius, angle=angle).minus(job.part.surface)
    level = replace(error, z=error.z - error.z.mean())
    assert found["form_rms_nm"] == pytest.approx(np.sqrt(np.mean(level.z**2)) * 1e6, rel=0.01)
    assert found["form_pv_nm"] == pytest.approx(result.predictions[0].pv_nm, rel=0.01)
