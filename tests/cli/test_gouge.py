"""A run refuses what its own prediction shows below the design; the path is lowered here by a known height."""

import re
from dataclasses import replace

import numpy as np
import pytest

from job_files import GONE, changed
from turnwright.errors import GougeError
from turnwright.job import Job, pass_plan, run

ONLY_WHOLE = ("simulation.patches", [])
ROUND = {"family": "sphere", "radius": "50 mm"}
WAVY = {"family": "expression", "units": "mm", "formula": "1e-3*x*y + 0.005*rho**2"}
STEEP = {"family": "expression", "units": "mm", "formula": "0.1*exp(-((x-0.1)**2+(y-0.2)**2)/0.03**2)"}
RING = {"family": "expression", "units": "mm", "formula": "-0.05*tanh((rho-0.3)/0.001)"}


@pytest.fixture
def lowered(monkeypatch):
    """Place four revolutions, those from radius 0.76 to 0.84 mm, 1 um too low."""

    def low(spiral, *args, **kwargs):
        path = placed(spiral, *args, **kwargs)
        turns = np.abs(path.angle - path.angle[0]) / (2 * np.pi)
        where = (path.radius < 0.84) & (path.radius > 0.76) & (turns > 1)
        return replace(path, z=path.z - 1e-3 * where)

    placed = pass_plan.place
    monkeypatch.setattr(pass_plan, "place", low)


@pytest.mark.parametrize("surface", [ROUND, WAVY], ids=["round", "wavy"])
@pytest.mark.parametrize("points", ["points_per_rev", "chord"])
@pytest.mark.usefixtures("lowered")
def test_a_path_too_low_is_refused_with_height_and_place(surface, points, tmp_path):
    changes = [ONLY_WHOLE, ("part.surface", surface)]
    if points == "chord":
        changes += [("strategy.points_per_rev", GONE), ("strategy.chord", "20 nm")]
    with pytest.raises(GougeError, match='accept = \\["gouge"\\]') as error:
        run(Job.read(changed(*changes)), out=tmp_path)
    found = re.match(r"the tool gouges by (\S+) (um|nm) at x = (\S+) mm, y = (\S+) mm, where", str(error.value))
    depth, x, y = (float(found[one]) for one in (1, 3, 4))
    assert 0.97 < depth / {"um": 1, "nm": 1000}[found[2]] < 1.03
    assert 0.75 < np.hypot(x, y) < 0.85
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("lowered")
def test_a_gouge_that_the_shop_accepts_is_a_warning():
    result = run(Job.read(changed(ONLY_WHOLE, ("accept", ["gouge"]))))
    assert [one for one in result.warnings if one.startswith("the tool gouges by ")]


@pytest.mark.usefixtures("lowered")
def test_a_tool_that_is_not_as_planned_may_cut_below_the_design():
    result = run(Job.read(changed(ONLY_WHOLE, ("actual.tool.radius_error", "10 nm"))))
    assert not [one for one in result.warnings if "gouges" in one]


@pytest.mark.parametrize(
    "surface", [pytest.param(STEEP, id="spike"), pytest.param(RING, id="ring wall", marks=pytest.mark.proof)]
)
def test_a_steep_surface_that_is_placed_right_is_not_refused(surface):
    sharp = [("tool.nose_radius", "0.1 mm"), ("part.radius", "0.4 mm"), ("strategy.points_per_rev", 360)]
    accept = ("accept", ["clearance", "valley", "included angle", "nose radius", "step"])
    result = run(Job.read(changed(ONLY_WHOLE, ("part.surface", surface), *sharp, accept)))
    assert not [one for one in result.warnings if "gouges" in one]
