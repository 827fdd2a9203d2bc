"""The marks of errors. Oracles: the simulator, which knows nothing of the model; closed forms; SymPy."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import turnwright as tw
from cases import every_second
from turnwright.diagnosis.model import Deviations, Swept, raise_sweep

MACHINE = tw.Machine.load("generic")
FEED = 2e-4
"""Cusps of 0.005 nm, which the model does not know."""

NEAR = np.linspace(-0.005, 0.005, 21)
"""Azimuths next to the one that cuts, which a leaning edge needs."""

ROUGH = np.arange(0.1, 2 * np.pi, 0.2)


def simulated(surface, tool, real, machine, at, late=0.0):
    """Heights at the points of ``at``, each cut by a motion of its own, exact at the azimuth where its tip stood."""
    part = tw.Part(surface=surface, radius=6.0)
    heights = []
    for x, y, radius, angle in zip(at.x, at.y, at.tip_radius, at.tip_angle, strict=True):
        turn = np.sort(np.concatenate([NEAR, ROUGH])) + angle - late
        nodes = (np.arange(-30, 31)[:, None] * 2 * np.pi + turn).ravel()
        spiral = tw.Spiral(angle=nodes, radius=radius - FEED * (nodes - angle) / (2 * np.pi))
        path = tw.place(spiral, part, tool)
        axes = {"C": path.angle + late, "X": path.radius, "Z": path.z - MACHINE.z_error(path.radius)}
        motion = tw.Motion(time=path.angle - path.angle[0], axes=axes, machine=MACHINE)
        heights += tw.generate_points(motion, real, x=[x], y=[y], machine=machine).tolist()
    return np.array(heights)


def modelled(surface, tool, deviations, x, y):
    swept = Swept(surface=surface, tool=tool, sense=1, rim=6.0)
    sweeps = swept.start(x, y)
    return swept.heights(x, y, sweeps, deviations)


SURFACES = {
    "sphere": tw.Sphere(radius=10.0),
    "toroid": tw.Toroid(radius_x=10.0, radius_y=14.0),
    "convex": tw.Toroid(radius_x=-10.0, radius_y=-14.0),
    "freeform": tw.XYPolynomial(terms={(1, 0): 0.05, (2, 0): 0.03, (0, 2): 0.04, (3, 0): 0.001, (2, 2): 1e-4}),
}
CASES = {
    "as planned": Deviations(),
    "offset x": Deviations(offset=(0.005, 0.0, 0.0)),
    "offset y": Deviations(offset=(0.0, 0.02, 0.0)),
    "radius": Deviations(radius=0.01),
    "waviness": Deviations(powers=(1, 2, 3), waviness=np.array([1e-3, -5e-4, 2e-3])),
    "squareness": Deviations(squareness=5e-5),
    "all": Deviations(
        offset=(-0.004, 0.01, 0.002),
        radius=-0.006,
        powers=(1, 2, 3),
        waviness=np.array([1e-3, -5e-4, 2e-3]),
        squareness=-3e-5,
        knots=np.array([0.0, 2.5, 6.0]),
        straightness=np.array([0.0, 1e-4, 0.0]),
    ),
}


@pytest.mark.parametrize(("surface", "rake"), every_second(SURFACES, [0.0, -20.0]))
def test_the_marks_are_those_that_the_simulator_leaves(surface, rake):
    surface = SURFACES[surface]
    tool = tw.Tool(
        nose_radius=1.5, included=np.deg2rad(120), rake=np.deg2rad(rake), waviness=(1e-4, -2e-4, 3e-4),
        offset=(0.001, -0.002, 0.0),
    )  # fmt: skip
    rng = np.random.default_rng(2)
    radius, azimuth = rng.uniform(0.8, 4.5, 3), rng.uniform(0, 2 * np.pi, 3)
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    for name, errors in CASES.items():
        wave = np.zeros(3) if not errors.waviness.size else errors.waviness
        offset = tuple(np.add(tool.offset, errors.offset))
        real = replace(
            tool, offset=offset, radius_error=errors.radius, waviness=tuple(np.add(tool.waviness, wave).tolist())
        )  # fmt: skip
        straight = (errors.knots, errors.straightness) if errors.knots.size else None
        machine = replace(MACHINE, squareness=errors.squareness, straightness=straight)
        at = modelled(surface, tool, errors, x, y)
        off = (simulated(surface, tool, real, machine, at) - at.z) * 1e6
        assert np.abs(at.z - surface.sag(x, y)).max() * 1e6 > 10 or name == "as planned"
        # The cusps lie above; a chord of the program may lie a little below.
        assert off.min() > -0.001, name
        assert off.max() < 0.008, name


def test_a_height_that_comes_late():
    """Z later than C by an angle, on a surface that is not round."""
    surface, tool = SURFACES["freeform"], tw.Tool(nose_radius=1.5, included=np.deg2rad(120))
    x, y = np.array([2.0, -1.5, 0.7]), np.array([1.0, 2.5, -3.0])
    at = modelled(surface, tool, Deviations(late=1e-3), x, y)
    off = (simulated(surface, tool, tool, MACHINE, at, late=1e-3) - at.z) * 1e6
    assert np.abs(at.z - surface.sag(x, y)).max() > 1e-6
    assert -0.001 < off.min() < off.max() < 0.008


def test_an_offset_on_a_sphere_shifts_the_generating_circle():
    """The tip moved by dx cuts a torus: its circle, of the sphere's radius, turns dx off the axis."""
    x, y = np.linspace(0.5, 5, 20), np.linspace(0.2, -1, 20)
    tool = tw.Tool(nose_radius=1.5, included=np.deg2rad(120))
    at = modelled(tw.Sphere(radius=10.0), tool, Deviations(offset=(0.005, 0, 0)), x, y)
    ogive = 10 - np.sqrt(100 - (np.hypot(x, y) - 0.005) ** 2)
    assert at.z == pytest.approx(ogive, abs=1e-14)


def test_a_radius_error_on_a_sphere_leaves_another_sphere():
    """Parallel to the first, and as deep where the tip touches."""
    x = np.linspace(0.5, 5, 20)
    tool = tw.Tool(nose_radius=1.5, included=np.deg2rad(120))
    at = modelled(tw.Sphere(radius=10.0), tool, Deviations(radius=0.01), x, 0 * x)
    assert at.z == pytest.approx(10.01 - np.sqrt(10.01**2 - x**2), abs=1e-14)


def test_a_tilted_flat_tells_offsets_and_squareness():
    """A rake plane off the axis, on z = t x: dx and dy shift the flat along the azimuth, squareness makes a cone."""
    slope, dx, dy, skew = np.tan(np.deg2rad(3)), 0.004, 0.003, 4e-5
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0.5, 4, (2, 30)) * rng.choice([-1, 1], (2, 30))
    tool = tw.Tool(nose_radius=1.5, included=np.deg2rad(60))
    at = modelled(tw.Plane(slope=(slope, 0)), tool, Deviations(offset=(dx, dy, 0)), x, y)
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    # The tip that cuts stands at sqrt(r² - dy²) - dx in the plane of azimuth phi - asin(dy / r).
    theta = phi - np.arcsin(dy / r)
    assert at.z == pytest.approx(slope * (np.sqrt(r * r - dy * dy) - dx) * np.cos(theta), abs=1e-14)
    at = modelled(tw.Plane(slope=(slope, 0)), tool, Deviations(squareness=skew), x, y)
    # The nose touches off its centre, so that the slide stands R sin(sweep) further in, to first order in the skew.
    aside = 1.5 * np.sin(np.arctan(slope * np.cos(phi)))
    assert at.z - slope * x == pytest.approx(skew * (r - aside), abs=2e-9)


@pytest.mark.parametrize("rake", [0.0, 15.0])
def test_slopes_are_those_of_differences(rake):
    surface = SURFACES["freeform"]
    tool = tw.Tool(nose_radius=1.2, included=np.deg2rad(120), rake=np.deg2rad(rake), waviness=(0.0, 2e-4))
    x, y = np.array([2.0, -1.5, 0.7, 3.0]), np.array([1.0, 2.5, -3.0, -2.0])
    base = {"offset": (0.003, 0.004, 0.001), "radius": 0.002, "late": 1e-3}
    powers = (1, 2, 3, 5)
    wave = np.linspace(-1e-3, 1e-3, len(powers))
    base |= {"powers": powers, "waviness": wave, "squareness": 2e-5}

    def height(step=0.0, **changed):
        return modelled(surface, tool, Deviations(**(base | changed)), x + step, y).z

    at = modelled(surface, tool, Deviations(**base), x, y)
    h = 1e-5
    for axis in range(3):
        ends = [height(offset=tuple(np.add(base["offset"], side * h * np.eye(3)[axis]))) for side in (1, -1)]
        assert at.by_tip[axis] == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-8)
    assert at.by_radius == pytest.approx((height(radius=0.002 + h) - height(radius=0.002 - h)) / (2 * h), abs=1e-8)
    late = (height(late=1e-3 + h) - height(late=1e-3 - h)) / (2 * h)
    assert -at.by_azimuth == pytest.approx(late, abs=1e-7)
    for k in range(len(powers)):
        one = np.eye(len(powers))[k]
        ends = [height(waviness=wave + side * h * one) for side in (1, -1)]
        mark = raise_sweep(at.sweep, powers)[0, k] * at.by_edge
        assert mark == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-8)
    square = (height(squareness=2e-5 + h) - height(squareness=2e-5 - h)) / (2 * h)
    assert at.tip_radius == pytest.approx(square, abs=1e-4)  # the mark bends by R/2 times the squared squareness
    assert at.zx == pytest.approx((height(h) - height(-h)) / (2 * h), abs=1e-8)


def test_a_soft_servo_lacks_the_second_derivative_of_its_path():
    """On a surface of one harmonic n the tip's height has, to the first order in its slopes, -n² times itself."""
    surface = tw.Expression("1e-4*rho**3*cos(3*phi)")
    tool = tw.Tool(nose_radius=0.01, included=np.deg2rad(120))
    x, y = np.array([2.0, -1.5, 0.7]), np.array([1.0, 2.5, -3.0])
    at = modelled(surface, tool, Deviations(), x, y)
    assert at.bend == pytest.approx(-9 * surface.sag(x, y), abs=2e-5)
    step = 1e-4
    turned = [
        tw.place(tw.Spiral(angle=at.tip_angle[[k]] + [-step, 0, step], radius=np.full(3, at.tip_radius[k])),
                 tw.Part(surface=surface, radius=6.0), tool).z
        for k in range(3)
    ]  # fmt: skip
    assert at.bend == pytest.approx([(z[0] - 2 * z[1] + z[2]) / step**2 for z in turned], abs=1e-6)


def test_cusps_stand_as_high_as_the_curvature_says():
    surface, tool = tw.Sphere(radius=10.0), tw.Tool(nose_radius=0.5, included=np.deg2rad(120))
    feed = 0.01
    part = tw.Part(surface=surface, radius=3.0)
    nodes = np.arange(0, 60) * 2 * np.pi
    path = tw.place(tw.Spiral(angle=nodes, radius=2.3 - feed * np.arange(60)), part, tool)
    axes = {"C": path.angle, "X": path.radius, "Z": path.z}
    motion = tw.Motion(time=path.angle + 1.0, axes=axes, machine=MACHINE)
    x = np.linspace(2.1, 2.2, 4001)[:-1]  # ten passes
    made = tw.generate_points(motion, tool, x=x, y=0 * x) - surface.sag(x, 0)
    between = modelled(surface, tool, Deviations(), x[::40], 0 * x[::40]).between
    assert made.mean() == pytest.approx(feed**2 / 24 * between.mean(), rel=2e-3)


def test_cusps_grow_with_the_bend_of_a_wave():
    """Of w'' = (w″u′ - w′u″)/u′³ by r, r' and r'' of the nose (r sin s, R - r cos s), by SymPy."""
    s, r0, r1, r2, at = sp.symbols("s r0 r1 r2 at")
    r = r0 + r1 * (s - at) + r2 * (s - at) ** 2 / 2
    u, w = r * sp.sin(s), -r * sp.cos(s)
    bent = (sp.diff(w, s, 2) * sp.diff(u, s) - sp.diff(w, s) * sp.diff(u, s, 2)) / sp.diff(u, s) ** 3
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(120), rake=np.deg2rad(-10), waviness=(0.0, 1e-3, 2e-3))
    found = modelled(SURFACES["freeform"], tool, Deviations(), np.array([2.0, -1.5]), np.array([1.0, 2.5]))
    for k, sweep in enumerate(found.sweep):
        here = {s: sweep, at: sweep, r0: 0.5 + 1e-3 * sweep**2 + 2e-3 * sweep**3,
                r1: 2e-3 * sweep + 6e-3 * sweep**2, r2: 2e-3 + 12e-3 * sweep}  # fmt: skip
        report = [float(sp.diff(bent, one).subs(here)) * np.cos(tool.rake) for one in (r0, r1, r2)]
        assert found.between_by[:, k] == pytest.approx(report, rel=1e-10)
