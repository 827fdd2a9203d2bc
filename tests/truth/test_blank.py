"""Blanks with a top of their own: passes cut only where material is, and leave no more than their allowance."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import DomainError, InputError
from turnwright.generation import generate_polar
from turnwright.job import Pipeline, find_wrong_move, preview, run

FLAT = {"family": "expression", "formula": "0.26 + 0*x", "units": "mm"}
BOWL, DOME = ({"family": "sphere", "radius": f"{r} mm"} for r in (50, -50))
TURNING = {"kind": "turning", "feed": "10 um/rev", "spindle_speed": "2000 rpm", "chord": "10 nm"}
SLOW = {"kind": "slow tool servo", "feed": "20 um/rev", "spindle_speed": "100 rpm", "points_per_rev": 90}
ROUGH = {"name": "rough", "feed": "30 um/rev", "allowance": "10 um", "depth": "50 um"}


def job_of(surface=BOWL, top=FLAT, strategy=TURNING, stock="260 um", **part):
    rough = {**ROUGH, "chord": "0.1 um"} if strategy["kind"] == "turning" else ROUGH
    return tw.Job.read({
        "part": {
            "surface": surface, "radius": "5 mm", "stock": stock, "blank": {"radius": "5.2 mm", "surface": top}, **part,
        },
        "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
        "machine": {"name": "nanoform"}, "strategy": strategy, "passes": [rough, {"name": "finish"}],
    })  # fmt: skip


CASES = {
    "flat over a bowl": (BOWL, FLAT, TURNING, "260 um"),
    "flat over a bowl, slow tool servo": (BOWL, FLAT, SLOW, "260 um"),
    "flat over a dome": (DOME, {**FLAT, "formula": "0.02 + 0*x"}, TURNING, "280 um"),
    "sphere over a toroid": (
        {"family": "toroid", "radius_x": "40 mm", "radius_y": "60 mm"},
        {"family": "expression", "formula": "0.12 + (x**2 + y**2)/100", "units": "mm"}, SLOW, "180 um",
    ),
    "from the centre": (BOWL, FLAT, {**SLOW, "inside_out": True}, "260 um"),
}  # fmt: skip


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=[pytest.mark.proof] * (name == "flat over a bowl, slow tool servo"), id=name)
        for name, case in CASES.items()
    ],
)
def test_every_cut_leaves_no_more_than_its_allowance(tmp_path, case):
    """Oracle: the lower envelope of all cuts so far, simulated, under the blank; cusps by f²/8R."""
    surface, top, strategy, stock = case
    job = job_of(surface, top, strategy, stock)
    line = Pipeline(job, out=tmp_path)
    radius, angle = np.linspace(0, 4.999, 400), np.linspace(0, 2 * np.pi, 24, endpoint=False)
    x, y = radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]
    design, left = job.part.surface.sag(x, y), job.part.blank.surface.sag(x, y)
    full = np.ptp(line.motion.axes["X"])
    widths = []
    for cut in line.cuts():
        made = generate_polar(cut.motion, job.tool, radius=radius, angle=angle).z
        left = np.fmin(left, made)
        cusp = (0.03 if cut.name != "finish" else (strategy == SLOW and 0.02) or 0.01) ** 2 / (8 * 0.5)
        assert (left - design).max() < cut.allowance + 1.3 * cusp + 3e-4
        assert (left - design).min() > -2e-4  # the chords between 90 points a turn
        widths.append(np.ptp(cut.motion.axes["X"]) / full)
    assert widths[0] < 0.8
    assert widths[-1] == 1
    assert find_wrong_move(job, line.program.files[0]) == ""


def test_the_time_counts_only_what_is_cut():
    """Oracle: on a flat over a bowl, cut k meets the blank inside r = sqrt(2 R d)."""
    job, whole = job_of(), job_of().replace("part.blank.surface", None)
    cuts = {one.name: one.motion for one in Pipeline(job).cuts()}
    for number, depth in enumerate((0.05, 0.1, 0.15, 0.2), 1):
        edge = np.sqrt(2 * 50 * depth)
        first = cuts[f"rough {number}"].axes["X"][0]
        assert edge < first < edge + 0.9  # half the width of the edge, and a block, outside
    shares = preview(job).points["rough"] / preview(whole).points["rough"]
    assert shares == pytest.approx(
        np.mean([min(np.sqrt(2 * 50 * d) + 0.43, 5) / 5 for d in np.arange(1, 6) * 0.05]), rel=0.05
    )


@pytest.mark.parametrize(
    ("surface", "top", "stock", "radius"),
    [
        ({"family": "plane"}, "0.08 + 0.015*x", "160 um", "5 mm"),
        ({"family": "plane"}, "0.005 + 0.09*exp(-((x**2+y**2-9)/2)**2)", "100 um", "5 mm"),
        ({"family": "sphere", "radius": "-300 mm"}, "0.002 + 0*x", "60 um", "5 mm"),
        ({"family": "plane"}, "0.012 + 0.08*exp(-((x-21.5)**2+(y-0.1876)**2)/0.3**2)", "100 um", "25 mm"),
    ],
)
def test_no_cut_goes_deeper_than_it_is_planned_where_few_points_are_needed(surface, top, stock, radius):
    """Oracle: what each cut removes under the blank, simulated on a fine grid; a plane has two points a cut."""
    job = job_of(
        surface, {**FLAT, "formula": top}, stock=stock, radius=radius,
        blank={"radius": f"{float(radius[:-3]) + 0.2} mm", "surface": {**FLAT, "formula": top}},
    )  # fmt: skip
    edge = job.part.radius
    radii = np.linspace(0, edge * 0.9999, 700)
    angle = np.unique(np.append(np.linspace(0, 2 * np.pi, 90, endpoint=False), np.linspace(0.004, 0.014, 21)))
    x, y = radii * np.cos(angle)[:, None], radii * np.sin(angle)[:, None]
    left = job.part.blank.surface.sag(x, y)
    for cut in Pipeline(job).cuts():
        made = np.fmin(left, generate_polar(cut.motion, job.tool, radius=radii, angle=angle).z)
        assert (left - made).max() < cut.depth + 1e-3
        left = made


def test_cuts_above_the_blank_are_left_out(tmp_path):
    job = job_of(stock="400 um")
    result = run(job, out=tmp_path)
    names = [one.name for one in result.passes]
    assert names[0] == "rough 3"  # 400 um - 3 x 48.75 um is the first height below 260 um
    assert names[-1] == "finish"
    assert [one.name for one in result.program.passes] == names


def test_a_measured_blank_is_a_map(tmp_path):
    axis = np.linspace(-5.5, 5.5, 221)
    x, y = np.meshgrid(axis, axis)
    top = 0.26 - 0.004 * np.exp(-((x - 1) ** 2 + y**2))
    tw.write_map(tw.HeightMap(x=axis, y=axis, z=top), tmp_path / "blank.npz")
    job = job_of(top={"family": "gridded", "file": str(tmp_path / "blank.npz")})
    assert job.part.blank.surface.sag(1.0, 0.0) == pytest.approx(0.256, abs=1e-6)
    assert len(list(Pipeline(job).cuts())) == 6


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"top": {**FLAT, "formula": "0.2 + 0*x"}}, InputError, "below the finished surface"),
        ({"stock": "200 um"}, InputError, "the stock is 200 um: state the largest thickness"),
        ({"top": {"family": "sphere", "radius": "-5.1 mm"}}, DomainError, "blank"),
    ],
)
def test_impossible_blanks_are_refused(changes, kind, message):
    with pytest.raises(InputError, match=message):
        job_of(**changes)
    assert issubclass(kind, InputError)
