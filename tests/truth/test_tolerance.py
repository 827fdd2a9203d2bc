"""Tolerances: chances and shares against SciPy and closed forms, the thinned program against the whole, drift and mount
against closed forms, and the short way to a corrected part against the long one.

Oracles: scipy.stats, closed forms of linear and Ishigami functions, a sphere turned as a rigid body, and programs that
were planned, moved or tracked whole.
"""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import turnwright as tw
from tolerance_jobs import job_of
from turnwright.diagnosis import prove
from turnwright.errors import CorrectionError
from turnwright.generation import generate_points
from turnwright.job import correct
from turnwright.studies import ErrorBudget, Spread, Store, draws as draws_of
from turnwright.studies.scenes import (
    ContactShift,
    add_drift,
    drift_share,
    make_lines,
    make_scenes,
    pack_motion,
    plan_motion,
    scene_motion,
    select_points,
)
from turnwright.studies.sensitivity import (
    MapModel,
    binomial_interval,
    group_inputs,
    neighbour_indices,
    percentile,
    sobol_indices,
    unit_points,
)
from turnwright.studies.tolerancing import _SignatureAnalysis
from turnwright.tracking import track

NM = 1e6


@pytest.mark.parametrize(("good", "of"), [(0, 200), (1, 30), (150, 200), (200, 200)])
def test_the_interval_of_a_chance_is_that_of_scipy(good, of):
    exact = stats.binomtest(good, of).proportion_ci(0.95, "exact")
    assert binomial_interval(good, of) == pytest.approx((good / of, exact.low, exact.high), abs=1e-12)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_the_interval_of_a_percentile_holds(share):
    # Draws that are their own order: the end of an interval is the number of a draw.
    one = percentile(np.arange(1.0, 201.0), share)
    first = 0 if math.isinf(one.low) else int(one.low)
    last = 201 if math.isinf(one.high) else int(one.high)
    below = stats.binom(200, share)
    # The percentile lies beyond a draw where at most so many draws lie below it.
    misses = below.cdf(first - 1) + below.sf(last - 1)
    assert 0.02 < misses <= 0.05
    assert below.cdf(first) > 0.025  # and the next draw would not do
    assert below.sf(last - 2) > 0.025


def ishigami(x):
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_the_indices_of_ishigami():
    unit = np.pi * (2 * unit_points(6, 13, 0) - 1)
    found = sobol_indices(ishigami, [[0], [1], [2], [0, 2]], unit[:, :3], unit[:, 3:])
    variance = 7**2 / 8 + 0.1 * np.pi**4 / 5 + 0.1**2 * np.pi**8 / 18 + 0.5
    one, two = (1 + 0.1 * np.pi**4 / 5) ** 2 / 2 / variance, 7**2 / 8 / variance
    both = 0.1**2 * np.pi**8 * 8 / 225 / variance
    assert found.first == pytest.approx([one, two, 0.0, one + both], abs=0.006)
    assert found.total == pytest.approx([one + both, two, both, one + both], abs=0.006)
    other = stats.sobol_indices(
        func=lambda x: ishigami(x.T), n=8192, dists=3 * [stats.uniform(-np.pi, 2 * np.pi)], rng=1
    )
    assert found.first[:3] == pytest.approx(other.first_order, abs=0.01)
    assert found.total[:3] == pytest.approx(other.total_order, abs=0.01)


def test_the_indices_of_given_cases():
    x = np.random.default_rng(3).normal(size=(6000, 5))
    weights = np.array([3.0, 2.0, 1.0, 0.5, 0.0])
    truth = weights**2 / (weights @ weights)
    groups = [[0], [1], [2], [3], [4], [0, 2]]
    found = neighbour_indices(x, x @ weights, groups)
    assert found == pytest.approx([*truth, truth[0] + truth[2]], abs=0.04)
    # And of a result that grows neither way: the square of one input.
    assert neighbour_indices(x, x[:, 1] ** 2, [[1], [0]]) == pytest.approx([1.0, 0.0], abs=0.04)


def test_sums_of_marks_tell_the_chance_of_a_linear_problem():
    # Two heights whose difference is normal: PV is its magnitude.
    rng = np.random.default_rng(1)
    inputs = {"tool offset x": Spread.read("normal(2, 3) um", "mm", source="test"), "drift z": Spread.read(
        "normal(0, 5) um", "mm", source="test")}  # fmt: skip
    marks = np.array([[1.0, -2.0], [2.0, -0.5]])  # nm per deviation, of each height
    scaled = rng.normal(size=(400, 2))
    maps = np.array([0.2, 0.0]) + scaled @ marks.T
    model = MapModel.fit(scaled, maps, np.ones(2))
    assert model.explained_variance() == pytest.approx((1.0, 1.0), abs=1e-12)
    assert MapModel.fit(scaled[: MapModel.min_cases(2) - 1], maps[: MapModel.min_cases(2) - 1], np.ones(2)) is None
    groups = group_inputs(list(inputs), lambda name: name)
    pv = np.ptp(maps, axis=1)
    study = _SignatureAnalysis(inputs=inputs, groups=groups, scaled=scaled, maps=maps, weight=np.ones(2), pv=pv, seed=0)
    drawn = {name: one.mean + one.deviation * scaled[:, k] for k, (name, one) in enumerate(inputs.items())}
    apart = marks[0] - marks[1]

    def keeps(deviations, limit=2.0):
        spread = stats.norm(0.2, math.hypot(*(apart * deviations)))
        return spread.cdf(limit) - spread.cdf(-limit)

    before = keeps((1, 1))
    (first, _), (second, _) = study.halved(model, 2.0, drawn, np.ones(400, dtype=bool), before)
    assert first == pytest.approx(keeps((0.5, 1)), abs=2e-3)
    assert second == pytest.approx(keeps((1, 0.5)), abs=2e-3)
    # Finish that is lost beyond one deviation of the first: weights tell what half the spread does to it.
    fine = abs(scaled[:, 0]) < 1
    (first, _), (second, _) = study.halved(model, None, drawn, fine, float(fine.mean()))
    assert first == pytest.approx(stats.norm.cdf(2) - stats.norm.cdf(-2), abs=0.03)
    assert second == pytest.approx(fine.mean(), abs=0.03)


def test_half_a_spread_is_weighted_by_its_density():
    for text in ("normal(1, 2) um", "uniform(-1, 3) um", "triangular(-1, 0, 2) um", "truncated normal(0, 1, -1, 2) um"):
        spread = Spread.read(text, "mm", source="test")
        values = spread.quantile((np.arange(20_000) + 0.5) / 20_000)
        weight = spread.density_halved(values)
        assert weight.mean() == pytest.approx(1.0, abs=2e-3)  # a density again
        assert np.sqrt(weight @ (values - spread.mean) ** 2 / weight.sum()) == pytest.approx(
            spread.deviation / 2, rel=5e-3
        )


DEVIATIONS = [
    {},
    {"tool offset x": 0.004, "tool offset y": -0.006, "radius error": 0.003, "waviness P4": 2e-5, "squareness": 3e-6},
    {"tool offset x": -0.005, "tool offset y": 0.005, "waviness P7": 2e-5, "drift x": 3e-4, "drift z": -2e-4},
]


@pytest.mark.parametrize("kind", ["mirror", "lens array", pytest.param("raked over the axis", marks=pytest.mark.proof)])
def test_the_thinned_program_leaves_what_the_whole_one_leaves(kind):
    job = job_of(kind)
    reach = ContactShift(along=0.03, across=0.012, servos={})
    plan = plan_motion(job, reach)
    duration = float(plan.motion.time[-1])
    for scene in make_scenes(job, plan.motion.feed):
        keep = select_points(plan, scene, reach)
        # A coarse program is needed whole for its lines, never for a patch.
        assert keep.mean() < (0.9 if kind == "mirror" or not scene.polar else 1.01)
        head, rows = pack_motion(plan, keep, reach)
        assert head["duration"] == duration
        for draw in DEVIATIONS if kind == "mirror" else DEVIATIONS[1:]:
            real = draws_of.apply_draw(job.tool, job.machine, draw)
            few = scene_motion(head, rows, job.machine, {})
            few = add_drift(few, *real.drift, drift_share(few.time, duration, 5.0))
            left = scene.generated(few, real.tool, real.machine, head["near"])
            whole = add_drift(plan.motion, *real.drift, drift_share(plan.motion.time, duration, 5.0))
            z = generate_points(whole, real.tool, x=left.x.ravel(), y=left.y.ravel(), machine=real.machine)
            if scene.polar:  # lines end where a tool above or below centre leaves a core
                z[np.hypot(left.x, left.y).ravel() < 4 * abs(real.tool.offset[1]) - 1e-12] = np.nan
            assert np.array_equal(np.isnan(z), np.isnan(left.z.ravel()))
            assert np.nanmax(np.abs(z - left.z.ravel())) * NM < 1e-4


def test_few_lines_tell_the_form_of_many():
    job = job_of("mirror")
    budget = ErrorBudget.typical()
    real = draws_of.apply_draw(job.tool, job.machine, {"tool offset x": 0.003, "tool offset y": 0.002,
        "waviness P6": 2e-5})  # fmt: skip
    reach = draws_of.bound_shift(budget, job)
    plan = plan_motion(job, reach)
    few = make_lines(job, plan.motion.feed)
    ends = np.linspace(0.008, 3.0, 302)  # from the core on
    many = few._replace(
        columns=(ends[1:] + ends[:-1]) / 2, twist=np.zeros(301), weight=np.diff(ends**2),
        rows=np.linspace(0, 2 * np.pi, 180, endpoint=False),
    )  # fmt: skip
    numbers = []
    for scene in (few, many):
        left = scene.generated(plan.motion, real.tool, real.machine, 0.1)
        error = left.z - job.part.surface.sag(left.x.ravel(), left.y.ravel()).reshape(left.z.shape)
        form = draws_of.form_error(job, left, error)
        there = np.isfinite(form)
        rms = math.sqrt(np.average(form[there] ** 2, weights=np.broadcast_to(left.weight, form.shape)[there]))
        numbers.append((np.ptp(form[there]), rms))
    assert numbers[0] == pytest.approx(numbers[1], rel=0.04)


def left_by(job, plan, **offset):
    """The error at the lines of a job whose tool stands off, from its thinned program. [mm]"""
    tool = replace(job.tool, offset=(offset.get("x", 0.0), offset.get("y", 0.0), 0.0))
    scene, reach = make_lines(job, plan.motion.feed), ContactShift(along=0.02, across=0.01, servos={})
    head, rows = pack_motion(plan, select_points(plan, scene, reach), reach)
    left = scene.generated(scene_motion(head, rows, job.machine, {}), tool, job.machine, head["near"])
    return left, left.z - job.part.surface.sag(left.x.ravel(), left.y.ravel()).reshape(left.z.shape), tool


def test_lines_reach_the_tip_of_a_cone_on_the_axis():
    job = job_of("fine mirror")  # cusps of a nanometre
    plan = plan_motion(job, ContactShift(along=0.02, across=0.01, servos={}))
    size, rim, nose = 40.0, 3.0 * (1 - 1e-4), 0.5

    def sphere(r):
        return r**2 / (size + math.sqrt(size**2 - r**2))

    for off in (0.004, -0.004):
        left, error, tool = left_by(job, plan, x=off)
        assert (left.x[:, 0] == 0).all()
        # Closed form: the sphere stands off with the tool. Where it stops short of the axis the round nose leaves a
        # core, highest a quarter of a feed from the axis, between passes whose middle is three quarters of a feed more
        # than the offset away; where it passes by it has cut the axis from beyond.
        at_rim = sphere(rim - off) - sphere(rim)
        at_axis = nose - math.sqrt(nose**2 - off**2) if off > 0 else sphere(off)
        top = nose - math.sqrt(nose**2 - (off + 0.75 * 0.002) ** 2) if off > 0 else sphere(off)
        assert error[:, 0] == pytest.approx(at_axis, abs=0.01 / NM)
        assert error[:, -1] == pytest.approx(at_rim, abs=2.5 / NM)
        assert np.ptp(error) == pytest.approx(abs(at_rim - top), abs=2.5 / NM)
        # And the whole map of the whole program at many rings.
        rings = np.concatenate([np.linspace(0, 0.01, 81), np.linspace(0.02, rim, 400)])
        azimuth = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        whole = tw.generate_polar(plan.motion, tool, radius=rings, angle=azimuth).minus(job.part.surface).z
        assert np.ptp(error) == pytest.approx(np.ptp(whole), abs=2.5 / NM)


@pytest.mark.parametrize("overrun", [False, True])
def test_form_sees_the_highest_cusp_of_the_last_turn(overrun):
    table = tomllib.loads(job_of("flat").to_toml())
    feed, nose = 0.005, 0.5
    if overrun:
        table["strategy"]["overrun"] = "1.25 um"
    job = tw.Job.read(table)
    plan = plan_motion(job, ContactShift(along=0.02, across=0.01, servos={}))
    # Closed form: neighbouring passes leave a cusp of half a feed; half a turn apart on either side of the axis one of
    # three quarters, which a quarter of a feed more closes.
    half = feed / 2 if overrun else 0.75 * feed
    cusp = nose - math.sqrt(nose**2 - half**2)
    still = np.ptp(left_by(job, plan)[1])
    assert cusp * (0.98 if overrun else 1 - 4 / (48 * 4)) <= still < cusp * (1 + 1e-9)
    for y in (1e-9, -1e-9, 1e-6, -1e-6):  # a micrometre of a nanometre, and a nanometre
        aside = np.ptp(left_by(job, plan, y=y)[1])
        # A pass over a place y off its line comes so much earlier or later: it is off by feed y / (2 pi r).
        moved = half / nose * 2 * feed * abs(y) / (2 * math.pi * feed / 4)
        assert abs(aside - still) <= moved + 1e-6 / NM


def test_nothing_leaps_while_a_core_grows():
    job = job_of("fine mirror")
    plan = plan_motion(job, ContactShift(along=0.02, across=0.01, servos={}))
    scene, rim = make_lines(job, plan.motion.feed), 3.0
    close = tw.Motion(  # what cuts farther out is of no interest here
        time=plan.motion.time[-9000:], axes={letter: one[-9000:] for letter, one in plan.motion.axes.items()},
        machine=plan.motion.machine,
    )  # fmt: skip

    def seen(core):
        tool = replace(job.tool, offset=(0.0, core / 4, 0.0))
        left = scene.generated(close, tool, job.machine, 0.1)
        there = np.isfinite(left.z)
        return np.broadcast_to(left.weight, there.shape)[there], np.hypot(left.x, left.y)[there] ** 2

    for core in (*scene.columns[scene.columns > 0][:12], 0.075, 0.15):
        (few, inside), (many, outside) = (seen(core * (1 + share)) for share in (-1e-9, 1e-9))
        # Closed form: the ring from the core to the rim has so much area, and so much of its second moment.
        for weight, away in ((few, inside), (many, outside)):
            assert weight.sum() / 48 == pytest.approx(rim**2 - core**2, rel=1e-8)
            assert weight @ away / weight.sum() == pytest.approx((rim**2 + core**2) / 2, rel=1e-3)
        assert few @ inside == pytest.approx(many @ outside, rel=1e-7)


@pytest.mark.parametrize("kind", ["fine mirror", pytest.param("raked over the axis", marks=pytest.mark.proof)])
def test_lines_end_at_the_core_of_a_tool_off_centre(kind):
    job = job_of(kind)
    plan = plan_motion(job, ContactShift(along=0.02, across=0.01, servos={}))
    for aside in (0.003, -0.006):
        left, error, tool = left_by(job, plan, x=-0.004, y=aside)
        away = np.hypot(left.x, left.y)
        there = np.isfinite(error)
        assert away[there].min() == pytest.approx(4 * abs(aside), rel=1e-9)
        assert away[~there].max() < 4 * abs(aside)
        # Of a map of the whole program, the core left out, little is missed.
        rings = np.concatenate([np.geomspace(4 * abs(aside), 0.1, 40), np.linspace(0.11, 3.0 * (1 - 1e-4), 100)])
        azimuth = np.linspace(0, 2 * np.pi, 45, endpoint=False)
        whole = tw.generate_polar(plan.motion, tool, radius=rings, angle=azimuth).minus(job.part.surface).z
        assert np.ptp(error[there]) == pytest.approx(np.ptp(whole), rel=0.01 if kind == "fine mirror" else 0.1)


def test_a_core_is_never_more_than_half_of_a_part():
    job = job_of("fine mirror")
    left, error, _ = left_by(job, plan_motion(job, ContactShift(along=0.02, across=0.01, servos={})), y=0.9)
    there = np.isfinite(error)
    assert np.hypot(left.x, left.y)[there].min() == pytest.approx(math.hypot(1.5, 0.9), rel=1e-3)
    assert there.any(axis=0).sum() == 25  # the outer half of 40, the edge of the core, four rings at the rim


def test_form_is_that_of_the_whole_part_to_its_rim(tmp_path):
    job = job_of("fine mirror").replace("optics", {"wavelength": "633 nm"})  # cusps of a nanometre
    terms = {5: "r^2 cos(2 a)", 10: "r^3 cos(3 a)", 17: "r^4 cos(4 a)", 12: "(4 r^4 - 3 r^2) cos(2 a)"}
    budget = one_budget(**{f"mounting_Z{term}": "normal(0, 100) nm" for term in terms})
    bench = bench_of(job, budget, tmp_path)
    still, _ = bench.measure(bench.real({}))
    for term in terms:
        numbers, _ = bench.measure(bench.real({f"mounting Z{term}": 1e-3}))
        # Closed form: all four reach from -c to c at the rim, where the lines leave out 1e-4 of the radius; each
        # has its own root mean square. Of the rotation that measuring leaves free a sphere tells nothing.
        order = {5: 6, 10: 8, 17: 10, 12: 10}[term]
        assert -2 < numbers["form_pv_nm"] - 2000 < 2 * still["form_pv_nm"]
        assert numbers["form_rms_nm"] == pytest.approx(1000 / math.sqrt(order), rel=3e-3)
        assert numbers["wavefront_rms_nm"] == pytest.approx(2 * numbers["form_rms_nm"], rel=0.02)  # slopes up to 0.1


def bench_of(job, budget, folder, *, correction=False):
    store = Store.open(folder)
    return draws_of.CaseContext.of(draws_of.plan_cuts(job, budget, store, correction=correction), store)


def one_budget(settling=None, **spreads):
    errors = {name.replace("_", " "): Spread.read(text, "mm", source="test") for name, text in spreads.items()}
    return ErrorBudget(errors=errors, noise=1e-6, settling=settling)


@pytest.mark.parametrize("settling", [None, 20.0])
def test_drift_leaves_its_own_history(tmp_path, settling):
    job = job_of("flat")
    bench = bench_of(job, one_budget(settling, drift_z="normal(0, 100) nm"), tmp_path)
    cut = bench.cuts[""]
    still, drifting = (
        cut.simulate(cut.views[0], bench.real({"drift z": by}))[1] for by in (0.0, 5e-4)
    )  # fmt: skip
    # Passes come in at an even feed, and each radius is as low as the last pass over it.
    strategy, head = job.strategy, cut.views[0].head
    lead = head["duration"] * strategy.spindle_rpm / 60 * strategy.feed
    share = (lead - cut.views[0].scene.columns) / lead
    if settling is not None:
        share = (1 - np.exp(-share * head["duration"] / settling)) / (1 - math.exp(-head["duration"] / settling))
    # A height belongs to a pass within half a feed, or the time of half a turn.
    slack = 5e-4 * strategy.feed / lead * (1 if settling is None else head["duration"] / settling)
    assert np.abs(drifting - still - 5e-4 * share).max() < 1.05 * slack


def test_a_part_springs_back_and_stands_upright(tmp_path):
    job = job_of("mirror")
    bench = bench_of(job, one_budget(mounting_Z5="normal(0, 100) nm"), tmp_path)
    cut = bench.cuts[""]
    view, free = cut.views[0], bench.real({})
    left, straight = cut.simulate(view, free)
    bent = cut.simulate(view, bench.real({"mounting Z5": 2e-4, "mounting Z9": 1e-4}))[1]
    x, y = left.x / 3.0, left.y / 3.0
    q = x**2 + y**2
    expected = -2e-4 * (x**2 - y**2) - 1e-4 * (6 * q**2 - 6 * q + 1)
    assert np.abs(bent - straight - expected).max() < 1e-15
    # A sphere that leaned by two small angles stands upright again: its centre has turned about the vertex.
    about_x, about_y = 3e-5, -2e-5
    tilted = cut.simulate(view, bench.real({"chuck tilt x": about_x, "chuck tilt y": about_y}))
    size = 40.0
    centre = np.array(
        [-size * math.sin(about_y), size * math.sin(about_x), size * math.cos(math.hypot(about_x, about_y))]
    )
    turned = centre[2] - np.sqrt(size**2 - (left.x - centre[0]) ** 2 - (left.y - centre[1]) ** 2)
    upright = size - np.sqrt(size**2 - left.x**2 - left.y**2)
    assert np.abs(tilted[1] - straight - (turned - upright)).max() * NM < 0.01
    # What measuring leaves free takes it away.
    apart = draws_of.form_error(job, *tilted) - draws_of.form_error(job, left, straight)
    assert np.abs(apart).max() * NM < 0.01


def test_servos_between_the_nodes_are_tracked_ones(tmp_path):
    job = job_of("servo", tmp_path)
    reach = ContactShift(along=0.01, across=0.002, servos={"X": 0.2, "Z": 0.2, "C": 0.2})
    plan = plan_motion(job, reach)
    scene = make_lines(job, plan.motion.feed)
    head, rows = pack_motion(plan, select_points(plan, scene, reach), reach)
    assert set(head["nodes"]) == {"X", "Z"}
    machine = job.machine
    faster = {"Z": 0.13, "X": -0.17}
    axes = dict(machine.axes)
    for letter, share in faster.items():
        response = axes[letter].response
        quick = replace(response, frequency_hz=response.frequency_hz * (1 + share))
        axes[letter] = replace(axes[letter], response=quick)
    cut, tool = job.passes[-1], job.tool
    spiral = job.servo(cut).spiral(job.part.aimed, tool)
    motion = tw.drive(tw.place(spiral, job.part.aimed, tool), job.servo(cut), machine)
    whole = track(motion, replace(machine, axes=axes), chord=1e-7)
    left = scene.generated(scene_motion(head, rows, machine, faster), tool, machine, head["near"])
    slow = scene.generated(scene_motion(head, rows, machine, {}), tool, machine, head["near"])
    exact = generate_points(whole, tool, x=left.x.ravel(), y=left.y.ravel(), machine=machine).reshape(left.z.shape)
    assert np.abs(slow.z - exact).max() * NM > 2  # it matters
    assert np.abs(left.z - exact).max() * NM < 0.01 * np.abs(slow.z - exact).max() * NM + 0.01


@pytest.mark.parametrize("number", [0, *(pytest.param(one, marks=pytest.mark.proof) for one in (1, 2))])
def test_the_short_way_to_a_corrected_part_is_the_long_one(tmp_path, number):
    job = job_of("fine mirror")  # cusps that move with the tool are no error of either way
    budget = ErrorBudget.typical()
    (tmp_path / "one").mkdir()
    bench = bench_of(job, budget, tmp_path / "one", correction=True)
    drawn = budget.draw(3, seed=5, correction=True)
    draw = {name: float(values[number]) for name, values in drawn.items()}
    real = bench.real(draw)
    found = bench.diagnose_test_parts(draw, [5, number])
    planned_only, _ = bench.measure(real)
    short, _ = bench.measure(draws_of.residual_setup(real, job.tool, job.machine, found))
    # The long way: a job file with what was found, planned, placed and driven again, cut with the real tool.
    (tmp_path / "better").mkdir()
    draws = found.effects_on(job.part)
    if not prove(draws, np.zeros(draws.x.size)).ok:
        with pytest.raises(CorrectionError):
            correct(job, found, out=tmp_path / "better")
        return
    better = correct(job, found, out=tmp_path / "better").job
    assert better.tool.offset == found.likely_tool.offset
    again = bench_of(better, budget, tmp_path / "two")
    long, _ = again.measure(real)
    assert short["form_pv_nm"] == pytest.approx(long["form_pv_nm"], rel=0.025, abs=1.0)  # to the rim
    assert short["form_rms_nm"] == pytest.approx(long["form_rms_nm"], rel=0.02, abs=0.1)
    assert planned_only["form_rms_nm"] > 1.5 * long["form_rms_nm"]
    assert short["sq_nm@half-way out"] == pytest.approx(long["sq_nm@half-way out"], abs=0.02)
