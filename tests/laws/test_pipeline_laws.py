"""Laws of the whole way from surface to generated heights: scale, rotation, no gouge, monotony. Oracle: the laws."""

from dataclasses import replace

import numpy as np
from hypothesis import example, given, strategies as st

from laws import examples
from turnwright.generation import generate_points, generate_polar
from turnwright.machine import Machine
from turnwright.motion import drive
from turnwright.part import Part
from turnwright.path import Motion, Spiral
from turnwright.placing import place
from turnwright.strategy import SlowToolServo
from turnwright.surface import Conic, EvenAsphere, LensArray, Plane, SineGrid, Sphere, XYPolynomial
from turnwright.tool import Tool

MACHINE = Machine.load("generic")
RADIUS, FEED, POINTS = 0.5, 0.02, 48
quick = examples(25)


def unit(low, high):
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def polynomials(draw):
    """Freeform of degree 3, with curvatures up to 0.6 per mm, and nothing in it too small to see."""
    powers = [(i, j) for i in range(4) for j in range(4 - i) if i + j > 0]
    return {power: draw(st.integers(-20, 20)) / 200 for power in powers}


@st.composite
def tools(draw, *, upright=True):
    return Tool(
        nose_radius=draw(unit(0.1, 0.8)),
        included=np.deg2rad(draw(unit(100, 140))),
        rake=0.0 if upright else np.deg2rad(draw(unit(-25, 10))),
        waviness=tuple(draw(st.lists(unit(-1e-3, 1e-3), max_size=3))),
        radius_error=draw(unit(-1e-3, 1e-3)),
        offset=(draw(unit(-5e-3, 5e-3)), 0.0 if upright else draw(unit(-5e-3, 5e-3)), draw(unit(-5e-3, 5e-3))),
    )


@st.composite
def surfaces(draw):
    """Smooth or sharp, convex or concave."""
    bend = draw(st.sampled_from([-1, 1])) / draw(unit(1.5, 20))
    kind = draw(st.sampled_from(["sphere", "polynomial", "grid", "square", "hexagonal"]))
    if kind == "sphere":
        return Sphere(radius=1 / bend)
    if kind == "polynomial":
        return XYPolynomial(terms=draw(polynomials()))
    if kind == "grid":
        return SineGrid(amplitude=(0.002 * bend, 0.003), period=(0.3, 0.4))
    if kind == "square":
        return LensArray.square(pitch=0.3, rows=5, columns=5, lenslet=Sphere(radius=1 / bend))
    return LensArray.hexagonal(pitch=0.25, rings=3, lenslet=Sphere(radius=1 / bend))


def cut(surface, tool, *, k=1.0, sense=1, turned=0.0):
    """The motion over a surface, or over the same surface turned, with all azimuths turned alike."""
    servo = SlowToolServo(feed=k * FEED, points_per_rev=POINTS, spindle_rpm=50, sense=sense)
    part = Part(surface=surface, radius=k * RADIUS)
    spiral = servo.spiral(part, tool)
    if turned:
        part = replace(part, surface=surface.placed(rotation=turned))
        spiral = Spiral(angle=spiral.angle + turned, radius=spiral.radius)
    return drive(place(spiral, part, tool), servo, MACHINE)


def scatter(seed, count=300):
    random = np.random.default_rng(seed)
    away, azimuth = RADIUS * np.sqrt(random.random(count)), 2 * np.pi * random.random(count)
    return away * np.cos(azimuth), away * np.sin(azimuth)


def equal(found, expected, size):
    """Whether heights agree to rounding, with missing points, if any, in the same places."""
    return np.array_equal(np.isnan(found), np.isnan(expected)) and np.nanmax(np.abs(found - expected)) < 1e-11 * size


@quick
@given(terms=polynomials(), tool=tools(upright=False), k=unit(0.05, 20), sense=st.sampled_from([-1, 1]))
def test_scale_all_lengths_and_heights_scale(terms, tool, k, sense):
    scaled = {(i, j): a * k ** (1 - i - j) for (i, j), a in terms.items()}
    large = replace(
        tool,
        nose_radius=k * tool.nose_radius,
        waviness=tuple(k * c for c in tool.waviness),
        radius_error=k * tool.radius_error,
        offset=tuple(k * c for c in tool.offset),
    )
    x, y = scatter(1)
    one = generate_points(cut(XYPolynomial(terms=terms), tool, sense=sense), tool, x=x, y=y)
    other = generate_points(cut(XYPolynomial(terms=scaled), large, k=k, sense=sense), large, x=k * x, y=k * y)
    assert equal(other / k, one, 1)


@quick
@given(surface=surfaces(), tool=tools(upright=False), turned=unit(-4, 4), sense=st.sampled_from([-1, 1]))
def test_rotate_the_part_and_the_result_rotates(surface, tool, turned, sense):
    x, y = scatter(2)
    c, s = np.cos(turned), np.sin(turned)
    plain = generate_points(cut(surface, tool, sense=sense), tool, x=x, y=y)
    motion = cut(surface, tool, turned=turned, sense=sense)
    assert equal(generate_points(motion, tool, x=c * x - s * y, y=s * x + c * y), plain, 1)


@quick
@given(surface=surfaces(), tool=tools(), sense=st.sampled_from([-1, 1]))
def test_no_point_is_cut_below_the_design(surface, tool, sense):
    # On the azimuths of the program; between them a straight line may pass below a dome by the chord, and the axis
    # itself is passed on all azimuths.
    motion = cut(surface, tool, sense=sense)
    turn = np.sort(motion.axes["C"][:POINTS] % (2 * np.pi))
    made = generate_polar(motion, tool, radius=np.linspace(1e-3, RADIUS, 301), angle=turn)
    assert np.min(made.z - surface.sag(*made.points())) > -1e-10


@quick
@given(
    bend=unit(1 / 20, 2),
    way=st.sampled_from([-1, 1]),
    conic=st.one_of(st.sampled_from([0.0, -1.0]), unit(-3, 1)),
    terms=st.lists(unit(-0.02, 0.02), max_size=4),
    pitch=unit(0.05, 1.5),
    turned=st.one_of(st.sampled_from([0.0, np.pi / 6, np.pi / 4]), unit(-4, 4)),
    nose=unit(0.02, 0.8),
)
def test_lenslets_are_touched_as_searched_for(bend, way, conic, terms, pitch, turned, nose):
    # A flat added to them has no height, but a sum is searched.
    radius = way * max(1 / bend, pitch)
    lenslet = (
        EvenAsphere(radius=radius, conic=conic, terms={2 * k: a * pitch ** (1 - 2 * k) for k, a in enumerate(terms, 1)})
        if terms
        else Conic(radius=radius, conic=conic)
    )
    lenses = LensArray.hexagonal(pitch=pitch, within=1.5 + 2 * pitch, lenslet=lenslet)
    tool, feed = Tool(nose_radius=nose, included=np.deg2rad(110)), min(RADIUS / 8, nose)
    spiral = SlowToolServo(feed=feed, points_per_rev=24, spindle_rpm=50).spiral(
        Part(surface=lenses, radius=RADIUS), tool
    )
    direct, searched = (
        place(spiral, Part(surface=surface, radius=RADIUS), tool).z
        for surface in (lenses.placed(rotation=turned), lenses.placed(rotation=turned) + Plane())
    )
    np.testing.assert_allclose(direct, searched, rtol=0, atol=1e-13)


@quick
@example(terms={(3, 0): 0.0625}, nose=0.5)  # the spiral ends within a turn
@given(terms=polynomials(), nose=unit(0.1, 0.8))
def test_nothing_is_left_above_the_cusps(terms, nose):
    # Between two contacts on a profile of curvature κ the cusp is f²/(8R(1 - κR)) high, on a slope a little less.
    # Near the axis a turn meets its own other side, up to one and a half feeds away; the last feed before the rim is
    # met by one turn only.
    surface, tool = XYPolynomial(terms=terms), Tool(nose_radius=nose, included=np.deg2rad(120))
    motion = cut(surface, tool)
    turn = np.sort(motion.axes["C"][:POINTS] % (2 * np.pi))
    made = generate_polar(motion, tool, radius=np.linspace(1e-3, RADIUS - FEED, 301), angle=turn)
    x, y = made.points()
    zxx, zxy, zyy = surface.hessian(1.3 * x, 1.3 * y)
    bend = np.max(0.5 * (zxx + zyy) + np.hypot(0.5 * (zxx - zyy), zxy))
    assert np.max(made.z - surface.sag(x, y)) < 1.02 * (1.5 * FEED) ** 2 / (8 * nose * (1 - max(bend, 0) * nose))


@quick
@example(
    surface=XYPolynomial(terms={(0, 1): 0.02, (1, 0): 0.095, (3, 0): 0.005}),
    tool=Tool(nose_radius=0.125, included=1.9896753472735358, rake=-0.3490658503988659, waviness=(0.001,)),
    stop=0.75,
    down=0.0078125,
)
@given(surface=surfaces(), tool=tools(upright=False), stop=unit(0.3, 0.9), down=unit(1e-4, 1e-2))
def test_passes_never_raise_and_a_lower_tool_cuts_lower(surface, tool, stop, down):
    motion = cut(surface, tool)
    x, y = scatter(3)
    whole = generate_points(motion, tool, x=x, y=y)
    n = int(stop * motion.time.size)
    part = Motion(time=motion.time[:n], axes={a: p[:n] for a, p in motion.axes.items()}, machine=MACHINE)
    some = generate_points(part, tool, x=x, y=y)
    both = np.isfinite(some) & np.isfinite(whole)
    # A leaning edge meets a point at a root that is found to the last digit, not beyond it.
    assert (some[both] >= whole[both] - 1e-15).all()
    deeper = replace(tool, offset=(*tool.offset[:2], tool.offset[2] - down))
    assert equal(generate_points(motion, deeper, x=x, y=y), whole - down, 1)
