"""The axis of turning. Oracle: the centre about which rings, spirals and defects are made, in closed form."""

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from proof_turning_centre import judge
from turnwright.metrology import turning_centre

CENTRE = (0.0173, -0.0121)


def spiral(feed, turns, pixel, *, noise=2e-6, half=1.5, centre=CENTRE, seed=0, nose=0.5):
    """Cusps of a spiral: arcs of the nose about passes that lie one feed apart in every direction."""
    rng = np.random.default_rng(seed)
    axis = np.arange(-half, half, pixel)
    x, y = np.meshgrid(axis, axis)
    u, v = x - centre[0], y - centre[1]
    along = np.hypot(u, v) / feed - turns * np.arctan2(v, u) / (2 * np.pi)
    off = (along - np.rint(along)) * feed
    form = 50e-6 * (x * x - y * y) + 30e-6 * x * y * y
    return tw.HeightMap(x=axis, y=axis, z=off**2 / (2 * nose) + form + rng.normal(0, noise, x.shape))


@pytest.mark.parametrize(("feed", "turns", "pixel"), [(0.04, 1, 0.01), (0.04, -1, 0.01), (0.03, 0, 0.008)])
def test_the_rings_of_a_spiral_tell_its_centre(feed, turns, pixel):
    found = turning_centre(spiral(feed, turns, pixel))
    assert found.source == "cusps"
    assert found.turns == turns
    assert found.feed == pytest.approx(feed, rel=1e-3)
    assert abs(found.x - CENTRE[0]) < max(4 * found.std[0], 1e-5)
    assert abs(found.y - CENTRE[1]) < max(4 * found.std[1], 1e-5)
    assert max(found.std) < 1e-3


@pytest.mark.parametrize(
    ("feed", "half", "centre"),
    [
        (0.03, 0.304, (0.0, 0.097)),
        pytest.param(0.03, 0.4, (0.123, -0.038), marks=pytest.mark.proof),
        (0.02, 0.25, (0.05, 0.03)),
    ],
)
def test_high_cusps_are_not_taken_for_their_harmonic(feed, half, centre):
    found = turning_centre(spiral(feed, 1, 2 * half / 501, half=half, centre=centre))
    assert found.feed == pytest.approx(feed, rel=1e-3)
    assert np.hypot(found.x - centre[0], found.y - centre[1]) < max(4 * np.hypot(*found.std), 1e-5)


def test_uncertainty_of_the_turning_centre_is_the_spread():
    """In noise that is twice the cusps."""
    off = []
    for seed in range(16):
        found = turning_centre(spiral(0.04, 1, 0.01, noise=0.2e-3, half=0.8, seed=seed), feed=0.04)
        off += [(found.x - CENTRE[0]) / found.std[0], (found.y - CENTRE[1]) / found.std[1]]
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.parametrize("turns", [1, -1])
def test_sense_of_the_spiral_is_right_in_noise_above_cusps(turns):
    """Noise of 30 nm on cusps of 25 nm: the wrong sense would put the centre half a feed off."""
    found = turning_centre(spiral(0.01, turns, 0.0012, noise=30e-6, half=0.2))
    assert found.turns == turns
    assert np.all(np.abs([found.x - CENTRE[0], found.y - CENTRE[1]]) < 3 * np.array(found.std))
    assert max(found.std) < 1e-4


@pytest.mark.parametrize("case", every_second(range(8)))
def test_the_stated_uncertainty_holds_the_axis_of_a_cut_spiral(case):
    """A share of tests/proof/proof_turning_centre.py: feeds of 2 to 40 um, 2.5 to 8 pixels, holes, noise, form."""
    wanted, answer, ratio, line = judge(np.random.default_rng([0, case]), side=200)
    assert wanted is None or (answer is not None) == wanted, line
    assert answer is None or ratio.max() < 4, line


def test_rings_whose_axis_is_outside_the_map_have_no_centre():
    """Whatever place is given; a wrong sense of the spiral would move it by half a feed."""
    centre = (0.5, 0.3)
    error = spiral(0.01, -1, 0.0012, noise=3e-6, half=0.24, centre=centre)
    for near in (centre, (0.0, 0.0)):
        assert turning_centre(error, near=near) is None


def test_map_that_does_not_resolve_cusps_has_no_turning_centre():
    """Pixels wider than half a feed show other rings; noise shows none."""
    assert turning_centre(spiral(0.02, 1, 0.0137), feed=0.02) is None
    assert turning_centre(spiral(0.02, 1, 0.0137)) is None
    axis = np.linspace(-1, 1, 151)
    noise = np.random.default_rng(0).normal(0, 5e-6, (151, 151))
    assert turning_centre(tw.HeightMap(x=axis, y=axis, z=noise)) is None


def test_the_defect_of_the_middle_tells_the_axis():
    """A cone that a tool beyond the axis leaves, on form."""
    axis = np.linspace(-1, 1, 201)
    x, y = np.meshgrid(axis, axis)
    away = np.hypot(x - CENTRE[0], y - CENTRE[1])
    z = 2e-3 * np.maximum(1 - away / 0.06, 0.0) + 50e-6 * x * y
    found = turning_centre(tw.HeightMap(x=axis, y=axis, z=z + np.random.default_rng(1).normal(0, 5e-6, x.shape)))
    assert found.source == "centre defect"
    assert abs(found.x - CENTRE[0]) < 4 * max(found.std[0], 1e-4)
    assert abs(found.y - CENTRE[1]) < 4 * max(found.std[1], 1e-4)


def defect_map(random, kind, *, noise=3e-6):
    """A defect of 0.03 to 0.3 um over 3 to 12 pixels of 10 um, its middle, and 0.1 um of low form where asked for."""
    pixel, middle = 0.01, random.uniform(-0.05, 0.05, 2)
    axis = pixel * (np.arange(161) - 80)
    x, y = np.meshgrid(axis, axis)
    away = np.hypot(x - middle[0], y - middle[1])
    width, size = random.uniform(4, 12) * pixel, random.uniform(60e-6, 300e-6) * random.choice([-1, 1])
    if kind == "rings":
        z = size * np.cos(4 * away / width) * np.exp(-away / width)
    else:
        z = size * np.maximum(1 - away / width, 0)
    if kind == "cone on form":
        z = z + 100e-6 * (x * x - y * y) + 60e-6 * (3 * x**3 - 2 * x) + 30e-6 * np.cos(6 * x)
    return tw.HeightMap(x=axis, y=axis, z=z + random.normal(0, noise, z.shape)), middle


@pytest.mark.parametrize(
    "kind", [*(pytest.param(one, marks=pytest.mark.proof) for one in ("cone", "rings")), "cone on form"]
)
def test_the_stated_uncertainty_of_a_defect_holds_its_middle(kind):
    random, off = np.random.default_rng(3), []
    for _ in range(10):
        error, middle = defect_map(random, kind)
        found = turning_centre(error)
        if found is not None:
            off.append((np.array([found.x, found.y]) - middle) / found.std)
    assert len(off) >= 5
    assert np.sqrt(np.mean(np.square(off))) < 1.4
    assert np.abs(off).max() < 4


@pytest.mark.parametrize("kind", every_second(["round", "oval", "pit", "flat-topped", "cone among grains", "two"]))
def test_a_grain_of_dust_is_not_taken_for_the_axis(kind):
    random = np.random.default_rng(4)
    for _ in range(3):
        pixel, (p, q) = 0.01, random.uniform(-0.05, 0.05, 2)
        axis = pixel * (np.arange(121) - 60)
        x, y = np.meshgrid(axis, axis)
        width, size = random.uniform(2, 5) * pixel, random.uniform(50e-6, 300e-6)
        square = ((x - p) ** 2 + ((y - q) * (1.4 if kind == "oval" else 1.0)) ** 2) / width**2
        z = size * np.exp(-(square**2 if kind == "flat-topped" else square)) * (-1 if kind == "pit" else 1)
        if kind == "two":
            z += 100e-6 * np.exp(-((x - p - 5 * pixel) ** 2 + (y - q + 3 * pixel) ** 2) / (2 * pixel) ** 2)
        if kind == "cone among grains":
            z = 200e-6 * np.maximum(1 - np.hypot(x - p, y - q) / (6 * pixel), 0)
            z += 250e-6 * np.exp(-((x - 0.5) ** 2 + (y + 0.4) ** 2) / (3 * pixel) ** 2)
        assert turning_centre(tw.HeightMap(x=axis, y=axis, z=z + random.normal(0, 3e-6, z.shape))) is None


def test_a_map_that_is_no_grid_is_refused():
    x = np.linspace(0, 1, 50)
    with pytest.raises(tw.InputError, match="needs a grid"):
        turning_centre(tw.HeightMap(x=x, y=x, z=x))
    polar = tw.HeightMap(radius=np.linspace(0, 1, 50), angle=np.linspace(0, 6, 60), z=np.zeros((60, 50)))
    with pytest.raises(tw.InputError, match="polar"):
        turning_centre(polar)


@pytest.mark.parametrize(
    "surface", [{"family": "sphere", "radius": "20 mm"}, {"family": "plane", "slope": [0.05, 0.0]}]
)
def test_a_part_that_nothing_else_places_is_put_about_its_axis(surface):
    """Decentred by 25 um in the map, where the middle of the map was taken for the axis."""
    centre, half, pixel, feed = (0.025, -0.018), 1.4, 0.01, 0.04
    job = {
        "part": {"name": "test part", "radius": "1.5 mm", "surface": surface},
        "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
        "machine": {"name": "generic"},
        "strategy": {"kind": "slow tool servo", "feed": "40 um/rev", "points_per_rev": 360},
    }
    recipe = tw.Job.read(job)
    cusps = spiral(feed, 1, pixel, half=half, centre=centre)
    x, y = cusps.points()
    inside = np.hypot(x - centre[0], y - centre[1]) < 1.35
    z = cusps.z - 50e-6 * (x * x - y * y) - 30e-6 * x * y * y
    z = np.where(inside, z + recipe.part.surface.sag(x - centre[0], y - centre[1]), np.nan)
    measured = tw.measure(recipe, tw.HeightMap(x=cusps.x, y=cusps.y, z=z))
    assert measured.axis.source == "cusps"
    at = measured.registration.pose.apply(*centre, 0.0)
    assert np.hypot(at[0], at[1]) < 0.5e-3
    assert not any("determined by the fit" in one for one in measured.open_questions)
