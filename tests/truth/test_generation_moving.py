"""Surfaces of tools that move across their plane, or stand off centre. Oracle: every pass by dense sampling.

`tests/proof/proof_generation.py` does the same for 10,000 points.
"""

import numpy as np
import pytest

import turnwright as tw
from moving_motions import CASES, DEG, MACHINE, random_maps, random_points, reach
from pass_oracle import Passes


def expect(passes, x, y, got):
    expected = np.array([passes.lowest(*point) for point in zip(x, y, strict=True)])
    reached = np.isfinite(expected)
    np.testing.assert_array_equal(np.isfinite(got), reached)
    np.testing.assert_allclose(got[reached], expected[reached], rtol=0, atol=1e-9)


PROOF = (
    "312 turns, 2 um, 12.3 a radian",
    "slow",
    "faster than the part",
    "wavy edge",
    "raked, wavy, fast",
    "off centre",
)
"""Cases that are like others, or take long."""


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.proof] * (one in PROOF)) for one in CASES])
def test_surface_of_a_moving_y_equals_every_pass(name):
    motion, edge = CASES[name]
    passes = Passes(motion, edge)
    random = np.random.default_rng(7)
    x, y = random_points(random, 400, reach(motion))
    got = tw.generate_points(motion, edge, x=x, y=y)  # many at once, so that the rings are narrow
    expect(passes, x[:8], y[:8], got[:8])
    for made in random_maps(random, motion, edge).values():
        x, y = (one.ravel() for one in made.points())
        some = random.choice(x.size, 2, replace=False)
        expect(passes, x[some], y[some], made.z.ravel()[some])


@pytest.mark.parametrize(
    ("amplitude", "rate", "turns", "feed"), [(0.05, 3.53, 33, 0.03), (0.002, 12.3, 312, 0.003)], ids=["fast", "long"]
)
def test_no_point_of_a_flat_stands_above_the_highest_cusp(amplitude, rate, turns, feed):
    """Where Y moves slower than the part the passes stand at most a feed and what Y differs by apart: closed form."""
    k = np.arange(turns * 120 + 1)
    c = 2 * np.pi * k / 120
    axes = {"C": c, "X": feed * (turns - k / 120), "Y": amplitude * np.sin(rate * c), "Z": np.zeros(k.size)}
    motion = tw.Motion(time=0.001 * k, axes=axes, machine=MACHINE)
    r = np.linspace(0.3, 0.9, 3000) * turns * feed
    x, y = r * np.cos(7 * k[: r.size]), r * np.sin(7 * k[: r.size])
    got = tw.generate_points(motion, tw.Tool(nose_radius=0.3, included=100 * DEG), x=x, y=y)
    # sqrt(r² - Y²) is the place along the plane: it differs by Y²/2r at most from turn to turn.
    apart = feed * (1 + 0.5 * amplitude * rate / r) + amplitude**2 / r
    assert (got <= 0.3 - np.sqrt(0.09 - (apart / 2) ** 2)).all()


OFF_CENTRE = {
    "raked, falling angle": (0.89289, 0.02, -1, False, (0.1, 100, -25, (0.00864, -0.03851)), 2.14637),
    "inside out": (0.59136, 0.05, 1, True, (0.1, 100, 0, (0.00917, 0.04257)), 1.44654),
    "raked": (0.94840, 0.05, 1, False, (0.1, 60, -25, (0.00138, 0.03260)), 2.45554),
}


@pytest.mark.parametrize("name", OFF_CENTRE)
def test_all_three_agree_beyond_the_outermost_turn(name):
    """The flanks of the edge run on, so a coarse map, a polar one and single points have the same heights out there."""
    radius, feed, sense, inside_out, (nose, included, rake, offset), size = OFF_CENTRE[name]
    edge = tw.Tool(nose_radius=nose, included=included * DEG, rake=rake * DEG, offset=(*offset, 0.0))
    k = np.arange(round(radius / feed * 37) + 1)
    c, x = sense * 2 * np.pi * k / 37, radius - feed * k / 37
    x = x[::-1].copy() if inside_out else x
    motion = tw.Motion(time=0.001 * k, axes={"C": c, "X": x, "Z": 0.03 * x**2}, machine=MACHINE)
    passes = Passes(motion, edge)
    axis = np.linspace(-size, size, 31)
    maps = [
        tw.generate(motion, edge, x=axis, y=axis),
        tw.generate_polar(motion, edge, radius=np.linspace(0, size, 31), angle=np.linspace(0, 6, 31)),
    ]
    random = np.random.default_rng(4)
    for made in maps:
        px, py = (one.ravel() for one in made.points())
        np.testing.assert_allclose(
            made.z.ravel(), tw.generate_points(motion, edge, x=px, y=py), rtol=0, atol=1e-12, equal_nan=True
        )
        some = random.choice(np.flatnonzero(np.hypot(px, py) > radius), 10, replace=False)
        expect(passes, px[some], py[some], made.z.ravel()[some])


@pytest.mark.parametrize("turns", [0.4, 1.0, 6.0])
def test_all_three_hold_nan_where_no_pass_comes(turns):
    """A motion cut short. Oracle: the azimuths and, from the other side of the axis, half a turn from them."""
    k = np.arange(round(turns * 100) + 1)
    axes = {"C": 2 * np.pi * k / 100, "X": 1.0 - 0.01 * k / 100, "Z": np.zeros(k.size)}
    motion = tw.Motion(time=0.001 * k, axes=axes, machine=MACHINE)
    edge = tw.Tool(nose_radius=0.3, included=100 * DEG)
    angle = 2 * np.pi * (np.arange(72) + 0.5) / 72
    ring = tw.generate_polar(motion, edge, radius=[0.9, 1.0], angle=angle)
    x, y = ring.points()
    points = tw.generate_points(motion, edge, x=x.ravel(), y=y.ravel()).reshape(x.shape)
    grid = [tw.generate(motion, edge, x=[one], y=[other]).z[0, 0] for one, other in zip(x[:, 1], y[:, 1], strict=True)]
    covered = (angle < 2 * np.pi * turns) | ((angle + np.pi) % (2 * np.pi) < 2 * np.pi * turns)
    for z in (ring.z[:, 1], points[:, 1], np.array(grid)):
        np.testing.assert_array_equal(np.isfinite(z), covered)
    np.testing.assert_allclose(ring.z, points, rtol=0, atol=1e-14)
