"""Li et al. 2018 (Materials 11): the roughness its Table 5 simulates, and what an exact sum over all passes gives.

Table 5 states a simulated Sq of 6.7 nm for the sinusoidal grid and the lens array. Round cusps of nose R at feed f have
PV = R - sqrt(R² - f²/4) = 24.32 nm and Sq = PV sqrt(4/45) = 7.252 nm, times 1 / (1 - κR) where the profile along the
radius has the curvature κ: 7.21 nm on the crests of the grid and 7.30 nm in its troughs. The generated surface
converges to that. How the paper sampled it does not say; measured below is what can and what cannot explain its figure:

* Three passes are not the reason: at R sin(slope) = 3.6 um < 1.5 feed they are exact (on the second example they are
  not, and give 30 nm where 0.07 nm are left).
* Coarse samples taken as they are scatter about the converged value, because they meet the cusps in every phase.
* About six samples a cusp are the likely reason. Set half-way between the passes they miss the ridges and give
  Sq = PV sqrt(4/45 (1 - 1/n²) (1 - 4/n²)) = 6.74 nm for n = 6; joined by straight lines, as an interpolated map is,
  they give PV sqrt(4/45 - 8/9 n⁻² (1 - 1/n)²) = 6.69 nm for n = 7.
"""

import numpy as np
import pytest

from turnwright.generation import generate, generate_points, generate_polar
from turnwright.machine import Machine
from turnwright.metrology import roughness
from turnwright.motion import drive
from turnwright.part import Part
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.strategy import SlowToolServo
from turnwright.surface import LensArray, Plane, SineGrid, Sphere
from turnwright.tool import Tool

NOSE, FEED = 0.514, 0.010
PV = NOSE - np.sqrt(NOSE**2 - FEED**2 / 4)
SQ = PV * np.sqrt(4 / 45) * 1e6  # 7.252 nm
AMPLITUDE, PERIOD = 0.002, 2.5
BEND = AMPLITUDE * (2 * np.pi / PERIOD) ** 2  # curvature in the troughs of the grid
GRID = SineGrid(amplitude=(AMPLITUDE, AMPLITUDE), period=(PERIOD, PERIOD))
# Table 4's "aperture 2 mm" is a radius, so lenses stand 4 mm apart; their curvature is our choice.
ARRAY = LensArray.square(pitch=4.0, rows=2, columns=2, lenslet=Sphere(radius=250.0))


def cut(surface, tool, *, feed, points_per_rev, low, high):
    """The motion of a slow tool servo between two radii."""
    servo = SlowToolServo(feed=feed, points_per_rev=points_per_rev, spindle_rpm=50)
    part = Part(surface=surface, radius=high)
    whole = servo.spiral(part, tool)
    here = whole.radius >= low
    spiral = Spiral(angle=whole.angle[here], radius=whole.radius[here])
    return drive(place(spiral, part, tool), servo, Machine.load("generic"))


def cut_li(surface, low, high):
    tool = Tool(nose_radius=NOSE, included=np.deg2rad(60))
    return cut(surface, tool, feed=FEED, points_per_rev=1200, low=low, high=high), tool


def residual_sq(motion, tool, surface, corner, *, size=0.2, pixel=0.00025):
    steps = pixel * np.arange(round(size / pixel))
    made = generate(motion, tool, x=corner[0] + steps, y=corner[1] + steps)
    return roughness(made.minus(surface), form="mean").sq_nm


@pytest.fixture(scope="module")
def grid():
    return cut_li(GRID, 0.0, 2.7)


@pytest.mark.parametrize(
    "corner",
    [(1.1, 0.1), *(pytest.param(one, marks=pytest.mark.proof) for one in ((2.0, 1.0), (-1.25, 0.0))), (0.0, 2.3)],
)
def test_the_grid_of_table_5_converges_to_7_25(grid, corner):
    assert residual_sq(*grid, GRID, corner) == pytest.approx(7.25, abs=0.03)


@pytest.mark.parametrize(("middle", "bend"), [((0.625, 0.625), -BEND), ((-0.625, -0.625), BEND)])
def test_crests_and_troughs_follow_their_curvature(grid, middle, bend):
    # Small enough for the curvature to be that of the extreme to 0.3 %: 100 um of a period of 2.5 mm.
    corner = (middle[0] - 0.05, middle[1] - 0.05)
    assert residual_sq(*grid, GRID, corner, size=0.1) == pytest.approx(SQ / (1 - bend * NOSE), rel=1.5e-3)


@pytest.mark.parametrize(
    "corner", [*(pytest.param(one, marks=pytest.mark.proof) for one in ((1.9, 1.9), (0.5, -2.2))), (-1.4, 1.0)]
)
def test_the_array_of_table_5_converges_to_7_25(corner):
    away = np.hypot(*corner)
    motion, tool = cut_li(ARRAY, away - 0.35, away + 0.35)
    sq = residual_sq(motion, tool, ARRAY, corner)
    assert sq == pytest.approx(7.25, abs=0.03)
    assert sq == pytest.approx(SQ / (1 - NOSE / 250), rel=3e-3)


def three_passes(motion, tool, x, y):
    """Li's Eq. 10 by hand: the pass nearest in plan, the one before and the one after, and no other."""
    c, along, z = (np.asarray(motion.axes[letter]) for letter in "CXZ")
    azimuth, away = np.arctan2(y, x), np.hypot(x, y)
    turns = np.arange(np.ceil((c[0] + np.pi) / (2 * np.pi)), (c[-1] - np.pi) / (2 * np.pi))
    at = azimuth[:, None] + 2 * np.pi * turns
    inside = (at >= c[0]) & (at <= c[-1])
    rho = np.where(inside, np.interp(at, c, along), np.inf)
    height = np.interp(at, c, z)
    nearest = np.argmin(np.abs(away[:, None] - rho), axis=1)
    columns = np.clip(nearest[:, None] + [-1, 0, 1], 0, turns.size - 1)
    rows = np.arange(away.size)[:, None]
    u = away[:, None] - rho[rows, columns]
    return np.min(height[rows, columns] + tool.nose_radius - np.sqrt(tool.nose_radius**2 - u * u), axis=1)


def points_in(corner, size, count, seed):
    random = np.random.default_rng(seed)
    return corner[0] + size * random.random(count), corner[1] + size * random.random(count)


def test_three_passes_are_enough_for_table_5(grid):
    motion, tool = grid
    x, y = points_in((1.1, 0.1), 0.2, 4000, 1)
    assert np.abs(three_passes(motion, tool, x, y) - generate_points(motion, tool, x=x, y=y)).max() < 1e-10


def test_coarse_samples_scatter_about_the_converged_value(grid):
    coarse = [residual_sq(*grid, GRID, corner, pixel=0.005) for corner in [(-1.25, 0.0), (0.0, 2.3), (1.0, 0.0)]]
    assert max(coarse) > 7.75
    assert min(coarse) < 6.75


def radial_error(motion, tool, surface, radius, angle):
    made = generate_polar(motion, tool, radius=radius, angle=[angle])
    return (made.z - surface.sag(*made.points()))[0]


@pytest.mark.parametrize("count", [5, 6, 7, 200])
def test_samples_half_way_between_the_passes_lose_roughness(count):
    # On a flat the turns cross azimuth 0 at whole feeds from where the motion begins.
    surface = Plane()
    motion, tool = cut_li(surface, 0.5, 0.9)
    tip = motion.axes["X"][0] - 30 * FEED
    radius = tip + FEED * (np.arange(20 * count) + 0.5) / count - FEED / 2
    sq = 1e6 * np.std(radial_error(motion, tool, surface, radius, 0.0))
    n = float(count)
    assert sq == pytest.approx(SQ * np.sqrt((1 - 1 / n**2) * (1 - 4 / n**2)), rel=1e-4)
    if count == 6:
        assert sq == pytest.approx(6.74, abs=0.01)


def test_seven_samples_a_cusp_give_the_figure_of_the_paper(grid):
    motion, tool = grid
    coarse = np.arange(0.1, 2.6, FEED / 7.03)  # one period of the grid; not a whole number, so every phase is met
    fine = np.arange(coarse[0], coarse[-1], 2e-5)
    sampled = radial_error(motion, tool, GRID, coarse, 0.0)
    converged = 1e6 * np.std(radial_error(motion, tool, GRID, fine, 0.0))
    joined = 1e6 * np.std(np.interp(fine, coarse, sampled))
    assert converged == pytest.approx(7.25, abs=0.03)
    assert joined == pytest.approx(PV * 1e6 * np.sqrt(4 / 45 - 8 / 9 / 7.03**2 * (1 - 1 / 7.03) ** 2), rel=5e-3)
    assert joined == pytest.approx(6.7, abs=0.04)


def test_small_feed_and_large_nose_need_every_pass_that_reaches():
    # 0.2 mm/min (printed as 2 mm/r) at 150 rev/min. The edge touches up to 18 um from its tip, 13 passes away.
    surface = SineGrid(amplitude=(0.001, 0.001), period=(0.5, 0.5))
    feed, tool = 0.2 / 150, Tool(nose_radius=1.0, included=np.deg2rad(60))
    motion = cut(surface, tool, feed=feed, points_per_rev=5400, low=0.225, high=0.375)
    bend = 0.001 * (2 * np.pi / 0.5) ** 2
    flat = feed**2 / 8 * np.sqrt(4 / 45) * 1e6
    sq = residual_sq(motion, tool, surface, (0.27, -0.03), size=0.06)
    assert flat / (1 + bend) < sq < flat / (1 - bend)
    assert sq < 0.1
    # All round a ring the slopes are those of the whole grid.
    random = np.random.default_rng(2)
    away, azimuth = random.uniform(0.25, 0.35, 4000), random.uniform(0, 2 * np.pi, 4000)
    x, y = away * np.cos(azimuth), away * np.sin(azimuth)
    right = 1e6 * np.std(generate_points(motion, tool, x=x, y=y) - surface.sag(x, y))
    wrong = 1e6 * np.std(three_passes(motion, tool, x, y) - surface.sag(x, y))
    assert right < 0.1
    assert wrong == pytest.approx(30, abs=2)
