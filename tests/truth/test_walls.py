"""Placing along walls: lines that run along a step. Oracle: brute-force dilation on both sides of the line."""

import numpy as np
import pytest

import turnwright as tw
from cases import every_second, every_third
from turnwright.placing import touch

DEG = np.pi / 180
BESIDE_MM = 1e-9
UPRIGHT = tw.Tool(nose_radius=0.5, included=100 * DEG)
SHIFTED = tw.Tool(
    nose_radius=0.3, included=80 * DEG, radius_error=0.002, waviness=(1e-4, 0.002), offset=(0.01, 0, 0.003)
)
HIGH = tw.Tool(nose_radius=0.4, included=90 * DEG, offset=(0.0, 0.05, 0.0))
RAKED = tw.Tool(nose_radius=0.5, included=100 * DEG, rake=-25 * DEG)
LEANING = tw.Tool(nose_radius=0.3, included=100 * DEG, rake=10 * DEG, waviness=(0.0, 0.001))
TORIC = tw.Toroid(radius_x=4.0, radius_y=9.0)
ASIDE = tw.Sphere(radius=-5.0).placed(shift=(0.13, -0.21, 0.0))

SLOPING = TORIC + tw.Plane(slope=(0.02, -0.03))
SQUARE = tw.LensArray.square(pitch=0.8, rows=8, columns=8, lenslet=ASIDE)


def heights(surface, tool, angle, radius, sense, places, aside):
    """Return f - e at places on the edge, moved ``aside`` across the radial line."""
    u, v, e = tool.edge(places, sense)
    along, across = radius + u, v + aside
    x = along * np.cos(angle) - across * np.sin(angle)
    y = along * np.sin(angle) + across * np.cos(angle)
    return surface.evaluate(x, y, 0)[0] - e


def highest(surface, tool, angle, radius, sense, asides=(-BESIDE_MM, BESIDE_MM)):
    """Sample the arc every 20 nm or so on each side, and refine around every place that may be the highest."""
    best = -np.inf
    for aside in asides:
        places = np.linspace(*tool.arc, 40_001)
        z = heights(surface, tool, angle, radius, sense, places, aside)
        best = max(best, z.max())
        for i in np.flatnonzero((z[1:-1] >= z[:-2]) & (z[1:-1] >= z[2:]) & (z[1:-1] > best - 1e-5)) + 1:
            low, high = places[i - 1], places[i + 1]
            for _ in range(7):
                fine = np.linspace(low, high, 101)
                values = heights(surface, tool, angle, radius, sense, fine, aside)
                k = int(values.argmax())
                best = max(best, values[k])
                low, high = fine[max(k - 1, 0)], fine[min(k + 1, 100)]
    return best


WALLS = {
    "toric hexagons": (tw.LensArray.hexagonal(pitch=1.0, rings=4, lenslet=TORIC), (30, 90, 150, 210, 330)),
    "sloping hexagons": (tw.LensArray.hexagonal(pitch=0.7, rings=5, lenslet=SLOPING), (30, 150)),
    "turned hexagons": (
        tw.LensArray.hexagonal(pitch=1.0, rings=4, lenslet=TORIC).placed(rotation=17 * DEG), (47, 167),
    ),
    "squares": (SQUARE, (0, 90, 180, 270)),
    "sloping squares": (tw.LensArray.square(pitch=0.8, rows=8, columns=8, lenslet=SLOPING), (0, 90, 180, 270)),
    "squares on a bowl": (SQUARE + tw.Sphere(radius=40.0), (0, 90)),
}  # fmt: skip


def tips_along(azimuths, turns, random):
    """Return tips on some azimuths, a different number of revolutions from the start."""
    azimuth, turn = np.meshgrid(azimuths, turns)
    angle = np.sort(azimuth.ravel() * DEG + 2 * np.pi * turn.ravel())
    return angle, random.uniform(0.3, 2.2, angle.size)


EDGES = {"round": UPRIGHT, "wavy": SHIFTED, "raked": RAKED, "leaning wavy": LEANING}


@pytest.mark.parametrize(("name", "tool", "sense"), every_third(WALLS, ["round", "wavy"], [1, -1]))
def test_a_line_along_a_wall_touches_the_higher_side(name, tool, sense):
    (surface, azimuths), tool = WALLS[name], EDGES[tool]
    angle, radius = tips_along(azimuths, (0, 1, 7, 300), np.random.default_rng(len(name)))
    expected = [highest(surface, tool, a, r, sense) for a, r in zip(angle, radius, strict=True)]
    got = touch(surface, tool, angle=angle, radius=radius, sense=sense)
    np.testing.assert_allclose(got.z, expected, rtol=0, atol=1e-9)
    together = np.arange(12 * 9 + 1) * (np.pi / 6) + azimuths[0] * DEG
    shared = touch(surface, tool, angle=together, radius=np.linspace(2.2, 0.3, together.size), sense=sense)
    for i in range(0, together.size, 12):
        reference = highest(surface, tool, together[i], np.linspace(2.2, 0.3, together.size)[i], sense)
        assert shared.z[i] == pytest.approx(reference, abs=1e-9)


@pytest.mark.parametrize(("name", "tool", "sense"), every_third(WALLS, ["raked", "leaning wavy"], [1, -1]))
def test_the_tip_of_a_raked_edge_touches_the_higher_side_of_a_wall(name, tool, sense):
    """The edge leaves the radial line on one side of its lowest point: on the other it touches there or nowhere."""
    (surface, azimuths), tool = WALLS[name], EDGES[tool]
    angle, radius = tips_along(azimuths, (0, 1, 7), np.random.default_rng(len(name)))
    got = touch(surface, tool, angle=angle, radius=radius, sense=sense)
    places = np.linspace(-0.1, 0.1, 2_000_001)
    lowest = places[[tool.edge(places, sense)[2].argmin()]]
    for i, (a, r) in enumerate(zip(angle, radius, strict=True)):
        sides = [heights(surface, tool, a, r, sense, lowest, aside)[0] for aside in (-1e-11, 1e-11)]
        # On the wall itself rounding decides over a length of 0.1 um.
        expected = max(*sides, highest(surface, tool, a, r, sense, (0.0,)))
        assert got.z[i] == pytest.approx(expected, abs=3e-8)


def test_an_edge_above_centre_touches_the_higher_side_of_a_wall_beside_the_axis():
    surface = tw.LensArray.square(pitch=0.8, rows=8, columns=8, lenslet=ASIDE, offset=(0.0, 0.05))
    radius = np.linspace(0.1, 2.0, 7)
    got = touch(surface, HIGH, angle=np.zeros(7), radius=radius, sense=1)
    expected = [highest(surface, HIGH, 0.0, r, 1) for r in radius]
    np.testing.assert_allclose(got.z, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("part", [{"radius": 2.0}, {"outline": tw.Outline(rectangle=(3.0, 2.0))}], ids=["disc", "box"])
@pytest.mark.parametrize("turn", [1, -1])
def test_a_path_over_a_part_touches_the_higher_side_of_its_walls(part, turn):
    part = tw.Part(surface=SQUARE, **part)
    turned = turn * np.arange(24 * 25 + 1) * (np.pi / 12)
    spiral = tw.Spiral(angle=turned, radius=1.4 * (1 - np.abs(turned / turned[-1])))
    path = tw.place(spiral, part, UPRIGHT)
    for i in range(0, 24 * 25, 12):
        if path.radius[i] > 0.1 and part.covers(path.contact_x[[i]], path.contact_y[[i]])[0]:
            expected = highest(SQUARE, UPRIGHT, path.angle[i], path.radius[i], spiral.sense)
            assert path.z[i] == pytest.approx(expected, abs=1e-9)
    assert path.clearance.min() > -1e-9


@pytest.mark.parametrize(("rake", "deep"), every_second([-25, 10], [1e-4, 1e-5, 1e-6, 1e-8]))
def test_a_raked_edge_that_bulges_over_a_wall_between_samples_touches_it(rake, deep):
    """In plan a raked edge is a parabola: it crosses a wall by so little that no sample shows it."""
    surface = tw.LensArray.square(
        pitch=4.0, rows=2, columns=2, lenslet=tw.Sphere(radius=-30.0).placed(shift=(0.3, 0.5, 0))
    )
    tool = tw.Tool(nose_radius=0.5, included=100 * DEG, rake=rake * DEG)
    radius, y = np.linspace(0.8, 3.2, 7), np.copysign(deep, rake) * np.ones(7)
    for sense in (1, -1):
        got = touch(surface, tool, angle=np.zeros(7), radius=radius, y=sense * y, sense=sense)
        leaning = tw.Tool(nose_radius=0.5, included=100 * DEG, rake=rake * DEG, offset=(0.0, sense * y[0], 0.0))
        places = np.union1d(np.linspace(-0.05, 0.05, 100_001), np.linspace(-1e-3, 1e-3, 200_001))
        for z, r in zip(got.z, radius, strict=True):
            near = heights(surface, leaning, 0.0, r, sense, places, 0.0).max()
            assert z > near - 1e-9
            assert z < max(near, highest(surface, leaning, 0.0, r, sense, (0.0,))) + 1e-8


@pytest.mark.parametrize(("side", "rake"), every_second([1, -1], [0, -15]))
def test_a_contact_far_up_the_flank_of_a_sharp_nose_is_found(side, rake):
    """The ridge stands 25 nose radii beside the tip, in a trough deeper than the flank reaches there."""
    tool = tw.Tool(nose_radius=0.02, included=60 * DEG, rake=rake * DEG)
    surface = tw.Expression(f"0.6*exp(-((x-1-{side}*0.5)/0.1)**2)")
    got = touch(surface, tool, angle=[0.0, 0.1], radius=[1.0, 1.0], sense=1, rim=2.5)
    places = np.linspace(-60, 60, 1_200_001)
    for z, angle in zip(got.z, (0.0, 0.1), strict=True):
        assert z == pytest.approx(heights(surface, tool, angle, 1.0, 1, places, 0.0).max(), abs=1e-10)
    assert (side * got.sweep > 12.5).all()


@pytest.mark.parametrize("rake", [0, -15])
def test_a_raked_tip_on_the_axis_ignores_the_rounding_errors_there(rake):
    """Along y = 0 the formula is flat; its step is on the axis itself, which no edge cuts."""
    tool = tw.Tool(nose_radius=1.0, included=100 * DEG, rake=rake * DEG)
    got = touch(tw.Expression("0.1*sin(phi)"), tool, angle=[0.0, 2 * np.pi], radius=[0.0, 1.0], sense=1, rim=2.0)
    assert np.abs(got.z).max() < (1e-9 if rake == 0 else 0.06)
