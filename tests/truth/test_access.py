"""What a part asks of a tool, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from turnwright.access import check_access, check_bodies
from turnwright.part import Part
from turnwright.surface import Surface
from turnwright.tool import Tool

TOOL = Tool(nose_radius=0.5, included=np.deg2rad(100), clearance=np.deg2rad(10))


class Formula(Surface):
    """A surface from a SymPy formula in x and y: derivatives by SymPy, not by Turnwright."""

    __slots__ = ("functions", "size")

    def __init__(self, text, size=np.inf):
        import sympy

        x, y = sympy.symbols("x y")
        z = sympy.sympify(text)
        parts = [z, z.diff(x), z.diff(y), z.diff(x, x), z.diff(x, y), z.diff(y, y)]
        self.functions = sympy.lambdify((x, y), parts, "numpy")
        self.size = size

    @property
    def feature_size(self):
        return self.size

    def evaluate(self, x, y, order):
        parts = self.functions(x, y)[: (1, 3, 6)[order]]
        return tuple(np.array(np.broadcast_to(part, x.shape), dtype=float) for part in parts)


def look(text, radius, tool=TOOL, sense=1, size=np.inf):
    return check_access(Part(surface=Formula(text, size), radius=radius), tool, sense=sense)


def finding(access, name):
    return next(item for item in access.findings if item.name == name)


def test_concave_sphere():
    # R = 10 everywhere in every plane; slope at the rim asin(4/10).
    access = look("10 - sqrt(100 - x**2 - y**2)", 4)
    assert access.nose_radius_limit == pytest.approx(10, rel=1e-9)
    assert access.sweep == pytest.approx((0, np.arcsin(0.4)), rel=1e-9, abs=1e-9)
    assert access.included_needed == pytest.approx(2 * np.arcsin(0.4), rel=1e-9)
    assert access.clearance_needed == pytest.approx(0, abs=1e-9)
    assert access.rake_range == pytest.approx((0, 0), abs=1e-9)
    assert access.ok
    assert np.hypot(*finding(access, "included angle").where) == pytest.approx(4, rel=1e-9)
    assert finding(access, "nose radius").margin == pytest.approx(9.5)


def test_convex_sphere_takes_any_nose():
    access = look("sqrt(100 - x**2 - y**2) - 10", 4)
    assert access.nose_radius_limit == np.inf
    assert access.sweep == pytest.approx((-np.arcsin(0.4), 0), abs=1e-9)
    assert access.ok


def test_tilted_plane():
    # Slope t in every azimuth somewhere, along the radius and along the cut.
    access = look("0.15*x", 3)
    t = np.arctan(0.15)
    assert access.nose_radius_limit == np.inf
    assert access.sweep == pytest.approx((-t, t), rel=1e-9)
    assert access.clearance_needed == pytest.approx(t, rel=1e-9)
    assert access.rake_range == pytest.approx((-t, t), rel=1e-9)


def test_sine_grid():
    # Oracle: f_uu of A (sin kx + sin ky) is A k^2 (cos^2 + sin^2) at most, in troughs, where the slope is nought.
    a, p = 0.002, 2.5
    access = look(f"{a}*(sin(2*pi*x/{p}) + sin(2*pi*y/{p}))", 5, size=p / 6)
    k = 2 * np.pi / p
    assert access.nose_radius_limit == pytest.approx(1 / (a * k**2), rel=1e-9)
    # The steepest slope is A k sqrt(2), along diagonals where both cosines are +-1, e.g. at (0, 0).
    assert access.sweep[1] == pytest.approx(np.arctan(a * k * np.sqrt(2)), rel=1e-6)
    assert access.clearance_needed == pytest.approx(np.arctan(a * k * np.sqrt(2)), rel=1e-6)


def test_saddle():
    # z = c (x^2 - y^2): concave along x. On the x axis the limit is (1 + (2cx)^2)^1.5 / 2c, least at the centre.
    c = 0.05
    access = look(f"{c}*(x**2 - y**2)", 4)
    assert access.nose_radius_limit == pytest.approx(1 / (2 * c), rel=1e-9)
    assert np.hypot(*finding(access, "nose radius").where) < 1e-3
    # f_v / slope along the cut: -2 c rho sin(2 theta): both signs alike.
    assert access.clearance_needed == pytest.approx(np.arctan(2 * c * 4), rel=1e-9)
    assert access.sweep == pytest.approx((-np.arctan(2 * c * 4), np.arctan(2 * c * 4)), rel=1e-9)


def test_toroid():
    # Radius 20 along x and 8 along y about the axis of rotation of a tyre: at the vertex the curvatures are 1/20, 1/8.
    access = look("20 - sqrt((20 - 8 + sqrt(64 - y**2))**2 - x**2)", 2.5)
    # In the plane x = 0 the profile is a circle of 8.
    assert access.nose_radius_limit == pytest.approx(8, rel=1e-6)
    assert access.sweep[1] == pytest.approx(np.arcsin(2.5 / 8), rel=1e-6)


@pytest.mark.parametrize(("sense", "factor"), [(1, 1.125), (-1, 2.0)])
def test_clearance_knows_the_sense_of_rotation(sense, factor):
    # f = A y + B x y: f_v = A cos + B rho cos 2 theta. At the rim with B rho = A it goes from -1.125 A to 2 A.
    a, rim = 0.05, 2.0
    access = look(f"{a}*y + {a / rim}*x*y", rim, sense=sense)
    assert access.clearance_needed == pytest.approx(np.arctan(factor * a), rel=1e-9)
    # By hand: with the azimuth growing the cut runs uphill where f_v > 0, and there the rake turns negative.
    other = 3.125 - factor
    assert access.rake_range == pytest.approx((-np.arctan(other * a), np.arctan(factor * a)), rel=1e-9)


def test_rake_adds_to_the_effective_rake():
    tool = Tool(nose_radius=0.5, included=np.deg2rad(100), clearance=np.deg2rad(10), rake=np.deg2rad(-25))
    access = look("0.15*x", 3, tool=tool)
    t = np.arctan(0.15)
    assert access.rake_range == pytest.approx((np.deg2rad(-25) - t, np.deg2rad(-25) + t), rel=1e-9)


@pytest.mark.parametrize("rake", [-25, 30])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_raked_edge_meets_the_section_of_its_own_plane(rake, sense):
    # Oracle: a plane tilted by rake through the axis of a sphere of 10 (f = 10 - sqrt(..)) cuts it in a circle.
    # At the vertex of a bowl with curvature 1/10 the section has the curvature cos(rake)^-1 / 10 (Meusnier).
    tool = Tool(nose_radius=0.5, included=np.deg2rad(170), clearance=np.deg2rad(10), rake=np.deg2rad(rake))
    access = look("10 - sqrt(100 - x**2 - y**2)", 0.5, tool=tool, sense=sense)
    assert access.nose_radius_limit == pytest.approx(10 * np.cos(np.deg2rad(rake)), rel=2e-3)
    at_vertex = look("x**2/20 + y**2/20", 1e-5, tool=tool, sense=sense)
    assert at_vertex.nose_radius_limit == pytest.approx(10 * np.cos(np.deg2rad(rake)), rel=1e-5)


def test_extremes_equal_a_dense_search():
    # Oracle: 1.4 million places, on a freeform with many unequal extremes.
    text = "0.02*sin(1.7*x + 0.3) * cos(2.1*y) + 0.004*x**2 - 0.001*y**3 + 0.01*sin(3*x*y/4)"
    access = look(text, 3.0, size=0.3)
    r, a = np.meshgrid(np.linspace(0, 3, 1201), np.linspace(0, 2 * np.pi, 1200, endpoint=False))
    _, zx, zy, zxx, zxy, zyy = Formula(text).evaluate(r * np.cos(a), r * np.sin(a), 2)
    c, s = np.cos(a), np.sin(a)
    fu, fv = zx * c + zy * s, zy * c - zx * s
    kappa = (zxx * c * c + 2 * zxy * c * s + zyy * s * s) / (1 + fu**2) ** 1.5
    for mine, dense in (
        (1 / access.nose_radius_limit, kappa.max()),
        (access.sweep[1], np.arctan(fu.max())),
        (-access.sweep[0], -np.arctan(fu.min())),
        (access.clearance_needed, np.arctan(-fv.min())),
        (-access.rake_range[0], np.arctan(fv.max())),
    ):
        assert dense * (1 - 1e-12) <= mine <= dense * (1 + 2e-5)


class Roofs(Surface):
    """Facets |x| - folded: sharp valleys (depth > 0) or ridges at x = ... -2, 0, 2 ..., one piece per facet."""

    __slots__ = ("slope",)

    def __init__(self, slope):
        self.slope = slope

    def evaluate(self, x, y, order):
        rising = np.where(np.floor(x) % 2 == 0, 1.0, -1.0)
        z = self.slope * np.where(rising > 0, x - np.floor(x), 1 - x + np.floor(x))
        zero = 0 * (x + y)
        return (z, self.slope * rising, zero, zero, zero, zero)[: (1, 3, 6)[order]]

    def piece(self, x, y):
        return np.floor(x + 0 * y).astype(np.int64)


@pytest.mark.parametrize(("slope", "valley_at"), [(0.2, 0.0), (-0.2, 1.0)])
def test_a_sharp_valley_is_found_with_its_place_and_what_stays(slope, valley_at):
    # One sign has its valley through the centre and ridges next to it, the other the reverse.
    access = check_access(Part(surface=Roofs(slope), radius=1.9), TOOL)
    valley = finding(access, "valley")
    assert not access.ok
    assert valley.value == pytest.approx(2 * np.arctan(0.2), rel=1e-6)
    assert abs(valley.where[0]) == pytest.approx(valley_at, abs=1e-9)
    assert valley.where[1] == pytest.approx(0, abs=0.02)
    # The fillet of a nose of 0.5 mm in a V of 2 atan(0.2): R (sec - 1).
    assert f"{500 * (np.sqrt(1.04) - 1):.3g} um" in valley.sentence
    assert {"step"}.isdisjoint(item.name for item in access.findings)
    assert access.nose_radius_limit == np.inf


class Step(Roofs):
    def evaluate(self, x, y, order):
        z = np.where(np.floor(x + 0 * y) >= 1, 0.01, 0.0)
        return (z, *(np.zeros_like(x) for _ in range(5)))[: (1, 3, 6)[order]]


def test_a_step_is_found():
    access = check_access(Part(surface=Step(0), radius=1.9), TOOL)
    step = finding(access, "step")
    assert step.value == pytest.approx(0.01)
    assert step.where[0] == pytest.approx(1)
    assert not access.ok


def shank_of(part, tool, **how):
    (one,) = [one for one in tw.check_access(part, tool, **how).findings if one.name == "shank"]
    return one


@pytest.mark.parametrize(
    ("radius", "aperture", "wide", "height", "lead_in"),
    [(8.0, 4.0, 3.0, 0.6, 0.0), (8.0, 5.0, 2.0, 2.0, 0.0), (-6.0, 4.0, 3.0, 2.0, 0.0), (-6.0, 4.0, 3.0, 2.0, 1.0)],
)
def test_the_shank_stays_clear_of_spheres_by_the_closed_form(radius, aperture, wide, height, lead_in):
    """Oracle: circles of the tip's path and of the part in the radial plane, searched densely."""
    nose = 0.5
    tool = tw.Tool(
        nose_radius=nose, included=np.deg2rad(140), clearance=0.6, shank=tw.Shank(radius=wide, height=height)
    )
    beyond = 0.0 if radius > 0 else max(lead_in, nose * aperture / -radius)
    rho = np.linspace(0, aperture + beyond, 400_001)
    nearest = np.where(radius > 0, np.minimum(rho + wide, aperture), np.maximum(rho - wide, 0.0))
    tip = radius - nose - np.sign(radius) * np.sqrt((radius - nose) ** 2 - rho**2)
    gap = tip + height - (radius - np.sign(radius) * np.sqrt(radius**2 - nearest**2))
    one = shank_of(tw.Part(surface=tw.Sphere(radius=radius), radius=aperture), tool, lead_in=lead_in)
    assert one.value == pytest.approx(gap.min(), abs=1e-8)
    assert one.ok == (gap.min() >= 0.1)


def test_the_holder_next_to_the_tip_is_compared_with_what_is_under_it():
    """Oracle: brute force over tips and points of the cylinder, on a surface without symmetry, with stock."""
    surface = tw.Biconic(radius_x=6.0, radius_y=-9.0, conic_x=0.0, conic_y=0.0)
    body = tw.Shank(radius=1.5, height=1.0, offset=(0.8, -0.6))
    tool = tw.Tool(nose_radius=0.2, included=np.deg2rad(150), clearance=0.7, shank=body)
    one = shank_of(tw.Part(surface=surface, radius=3.0, stock=0.05), tool)
    rho, theta = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 3, 31), np.linspace(0, 2 * np.pi, 91)))
    u = np.linspace(-0.19, 0.19, 201)
    along = np.clip(rho[:, None] + u, -3, 3)
    tip = surface.sag(along * np.cos(theta)[:, None], along * np.sin(theta)[:, None])
    tip = (tip - (0.2 - np.sqrt(0.04 - (along - rho[:, None]) ** 2))).max(axis=1)
    out, turned = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1.5, 16), np.linspace(0, 2 * np.pi, 61)))
    along, across = rho[:, None] + 0.8 + out * np.cos(turned), -0.6 + out * np.sin(turned)
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    x, y = along * c - across * s, along * s + across * c
    inside = np.hypot(x, y) <= 3.0
    top = np.where(inside, surface.sag(np.where(inside, x, 0), np.where(inside, y, 0)) + 0.05, -np.inf)
    least = (tip[:, None] + 1.0 - top).min()
    assert least - 0.01 < one.value <= least + 1e-3


def test_the_shank_meets_the_taller_part_of_a_chuck():
    """Oracle: two flats, one 1 mm higher: the shank reaches over it from the lower one."""
    flat = tw.Plane(slope=(0.0, 0.0))
    parts = [
        tw.Mounted(name=name, surface=flat, outline=tw.Outline(disc=2.0), position=(x, 0.0), height=z)
        for name, x, z in (("low", -4.0, 0.0), ("tall", 4.0, 1.0))
    ]
    part = tw.Part(surface=tw.Chuck(parts=parts))
    tool = tw.Tool(nose_radius=0.5, included=2.0, clearance=0.2)
    clear = shank_of(part, replace(tool, shank=tw.Shank(radius=3.9, height=2.0)))
    assert clear.value == pytest.approx(2.0, abs=1e-9)
    low = shank_of(part, replace(tool, shank=tw.Shank(radius=4.2, height=1.05)))
    assert low.value == pytest.approx(0.05, abs=1e-9)
    assert not low.ok
    assert "begins 1.1 mm above the tip" in low.sentence


@pytest.mark.parametrize(
    ("x", "y"),
    [
        (10.6, -1.57),
        *(pytest.param(*one, marks=pytest.mark.proof) for one in ((12.44, 6.44), (16.18, -5.86), (8.3, 0), (6.0, 0.0))),
    ],
)
def test_the_holder_meets_a_small_post_far_from_the_tip(x, y):
    """Oracle: circles. The holder of 12 mm stands over a post of 0.3 mm if the tip comes within 12.3 mm of it."""
    lens = tw.Mounted(name="lens", surface=tw.Plane(), outline=tw.Outline(disc=1.0), position=(20.0, 0.0))
    post = tw.Mounted(name="post", surface=tw.Plane(), outline=tw.Outline(disc=0.3), position=(x, y), height=5.0)
    part = tw.Part(surface=tw.Chuck(parts=[lens, post]))
    tool = tw.Tool(nose_radius=0.5, included=2.0, clearance=0.2, shank=tw.Shank(radius=12.0, height=4.0))
    meets = np.hypot(x - 20, y) - 1 < 12.3
    one = shank_of(part, tool)
    assert one.value == pytest.approx(-1.0 if meets else 4.0, abs=1e-6)
    assert one.ok != meets


def test_the_holder_is_followed_through_the_air_between_parts():
    """Oracle: by hand. The tip passes at 0.2 mm, 8 mm from a post of 5 mm that no tip on a part comes near."""
    parts = [
        tw.Mounted(name=name, surface=tw.Plane(), outline=tw.Outline(disc=0.5), position=at, height=z)
        for name, at, z in (("low", (20.0, 0.0), 0.0), ("post", (-12.0, 0.0), 5.0))
    ]
    part = tw.Part(surface=tw.Chuck(parts=parts))
    machine, turned = tw.Machine.load("generic"), np.linspace(0, 2 * np.pi, 400)
    motion = tw.Motion(
        time=turned, axes={"C": turned, "X": 20 - 0.01 * turned, "Z": np.full(400, 0.2)}, machine=machine
    )
    tool = tw.Tool(nose_radius=0.5, included=2.0, clearance=0.2, shank=tw.Shank(radius=9.0, height=4.0))
    ((name, sentence),) = check_bodies(part, tool, motion)
    assert name == "shank"
    assert "the shank cuts 800 um into the part where the tip is at X 19.9" in sentence
    assert check_bodies(part, replace(tool, shank=tw.Shank(radius=7.0, height=4.0)), motion) == []
    assert check_bodies(part, replace(tool, shank=tw.Shank(radius=9.0, height=4.95)), motion) == []
    both = check_bodies(part, replace(tool, shank=None, holder=tool.shank), motion)
    assert [name for name, _ in both] == ["holder"]
