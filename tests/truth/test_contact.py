"""Placing the edge. Oracles: closed form on planes and spheres, the tangent condition, brute-force dilation."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import turnwright as tw
from cases import every_second, every_third
from turnwright.placing import touch

DEG = np.pi / 180


def spiral(radius, feed, points, sense=1):
    k = np.arange(round(radius / feed) * points + 1)
    angle = sense * k * (2 * np.pi / points)
    return tw.Spiral(angle=angle, radius=radius - feed * np.abs(angle) / (2 * np.pi))


def brute_force(surface, tool, angle, radius, sense):
    """Dilate by all of the surface."""
    return brute_contact(surface, tool, angle, radius, sense, np.inf)[0]


@cache
def samples(tool, sense):
    """Return places on the edge every 10 nm or less, and where they are."""
    low, high = tool.arc
    s = np.linspace(low, high, int((high - low) * tool.nose_radius / 1e-5) + 1)
    return s, tool.edge(s, sense)


def brute_contact(surface, tool, angle, radius, sense, rim):
    """Dilate by the surface inside the rim: sample the edge every 10 nm or less, refine around every near maximum.

    Return the height, and how far from the axis the contact is.
    """

    def where(edge):
        u, v, e = edge
        along, c, n = radius + u, np.cos(angle), np.sin(angle)
        return along * c - v * n, along * n + v * c, e

    def lift(edge):
        x, y, e = where(edge)
        # Within rounding of the axis the azimuth is noise; a contact there is approached from next to it.
        counts = (np.hypot(x, y) >= 1e-9) & (np.hypot(x, y) <= rim * (1 + 1e-14))
        return np.where(counts, surface.evaluate(x, y, 0)[0], -np.inf) - e

    s, edge = samples(tool, sense)
    g = lift(edge)
    best, place = g.max(), s[g.argmax()]
    peaks = np.flatnonzero((g[1:-1] >= g[:-2]) & (g[1:-1] >= g[2:]) & (g[1:-1] > best - 1e-5)) + 1
    for i in peaks:
        a, b = s[i - 1], s[i + 1]
        for _ in range(9):
            fine = np.linspace(a, b, 101)
            values = lift(tool.edge(fine, sense))
            j = int(values.argmax())
            if values[j] > best:
                best, place = float(values[j]), fine[j]
            a, b = fine[max(j - 1, 0)], fine[min(j + 1, 100)]
    x, y, _ = where(tool.edge(np.array([place]), sense))
    return best, float(np.hypot(x, y)[0])


ROUND = tw.Tool(nose_radius=0.5, included=100 * DEG)
WAVY = tw.Tool(nose_radius=0.5, included=100 * DEG, waviness=(1e-4, 0.002, -0.003), radius_error=0.002)
LEANING = tw.Tool(nose_radius=0.5, included=100 * DEG, rake=-25 * DEG, offset=(0.01, -0.02, 0.003))
LEANING_WAVY = tw.Tool(
    nose_radius=0.3, included=100 * DEG, rake=10 * DEG, waviness=(0.0, 0.001), offset=(0.0, 0.01, 0.0)
)
TOOLS = {"round": ROUND, "wavy": WAVY, "leaning": LEANING, "leaning wavy": LEANING_WAVY}

SURFACES = {
    "smooth grid": tw.SineGrid(amplitude=(0.02, 0.03), period=(2.5, 1.9)),
    "several tangents": tw.SineGrid(amplitude=(0.02, 0.02), period=(0.5, 0.5), phase=(0.3, 1.0)),
    "asphere": tw.EvenAsphere(radius=8.0, conic=-1.2, terms={4: 1e-4, 6: -2e-5}),
    "dome": tw.Sphere(radius=-4.0),
    "bowls": tw.LensArray.square(pitch=0.6, rows=11, columns=11, lenslet=tw.Sphere(radius=1.0)),
    "domes": tw.LensArray.square(pitch=0.6, rows=11, columns=11, lenslet=tw.Sphere(radius=-1.0)),
    "bowls sharper than the nose": tw.LensArray.square(pitch=0.3, rows=21, columns=21, lenslet=tw.Sphere(radius=0.4)),
    "bowls close to the nose": tw.LensArray.square(pitch=0.6, rows=11, columns=11, lenslet=tw.Sphere(radius=0.56)),
    "hexagonal domes": tw.LensArray.hexagonal(pitch=0.35, within=4.0, lenslet=tw.Sphere(radius=-0.8)),
    "listed bowls": tw.LensArray(
        centres=np.random.default_rng(3).uniform(-3, 3, (60, 2)), lenslet=tw.Sphere(radius=2.5)
    ),
    "steps": tw.LensArray.square(
        pitch=0.7, rows=9, columns=9, lenslet=tw.Sphere(radius=1.5), aperture=0.25, surround=0.03
    ),
    "freeform": tw.Zernike(terms={4: 0.01, 6: 0.004, 11: 0.002, 17: 0.001}, radius=2.0, indexing="fringe"),
}


@pytest.mark.parametrize(("name", "tool"), every_third(SURFACES, TOOLS))
def test_placing_equals_brute_force_dilation(name, tool):
    surface, tool = SURFACES[name], TOOLS[tool]
    sense = 1 if len(name) % 2 else -1
    where = spiral(1.5, 0.05, 90, sense)
    path = tw.place(where, tw.Part(surface=surface, radius=1.5), tool)
    rim = 1.5 + tool.offset[0]
    continued = np.hypot(path.contact_x, path.contact_y).max() > rim + 1e-9
    for i in np.random.default_rng(len(name)).integers(0, where.angle.size, 8):
        # What lies outside the rim is continued or left out, the same for all, and never lifts a tip off the part.
        inside, place = brute_contact(surface, tool, where.angle[i], where.radius[i], sense, rim)
        expected = inside
        if place > rim - 1e-6 and continued:
            expected = brute_force(surface, tool, where.angle[i], where.radius[i], sense)
        assert path.z[i] == pytest.approx(expected, abs=1e-10), f"point {i}"
    # The contact point lies on the surface and on the edge. (On a step it lies on the higher side of a wall.)
    if name != "steps":
        np.testing.assert_allclose(surface.sag(path.contact_x, path.contact_y), path.contact_z, atol=2e-12)
    assert path.clearance.min() > -1e-12
    assert path.clearance.max() <= 0
    u, v, e = tool.edge(path.sweep, sense)
    np.testing.assert_allclose(path.z + e, path.contact_z, atol=1e-13)
    along = path.radius + u
    np.testing.assert_allclose(along * np.cos(path.angle) - v * np.sin(path.angle), path.contact_x, atol=1e-12)


def test_places_on_lens_valleys_equal_brute_force():
    surface, tool = SURFACES["domes"], ROUND
    rng = np.random.default_rng(7)
    # Places where the edge hangs over a valley between cells, the corners where four of them meet among them.
    edge = 0.3 + 0.6 * rng.integers(-3, 3, 150) + rng.normal(0, 0.02, 150)
    other = np.where(rng.random(150) < 0.2, 0.3 + rng.normal(0, 0.01, 150), rng.uniform(-1.5, 1.5, 150))
    angle, radius = np.arctan2(other, edge), np.hypot(edge, other)
    got = touch(surface, tool, angle=angle, radius=radius, sense=1)
    expected = [brute_force(surface, tool, a, r, 1) for a, r in zip(angle, radius, strict=True)]
    assert np.abs(got.z - expected).max() < 1e-10


LENSES = {
    "domes": tw.LensArray.hexagonal(pitch=0.25, rings=6, lenslet=tw.Sphere(radius=-0.7)),
    "bowls, moved and turned": tw.LensArray.square(pitch=0.3, rows=9, columns=9, lenslet=tw.Sphere(radius=0.9)).placed(
        shift=(0.04, -0.07, 0.5), rotation=0.3
    ),
    "listed bowls": SURFACES["listed bowls"],
    "flats": tw.LensArray.square(pitch=0.3, rows=9, columns=9, lenslet=tw.Sphere(radius=np.inf)),
    "one flat": tw.LensArray(centres=[[0.1, 0.2]], lenslet=tw.Sphere(radius=np.inf)),
    "one bowl": tw.LensArray(centres=[[0.1, 0.2]], lenslet=tw.Sphere(radius=4.0)),
    "paraboloids": tw.LensArray.square(pitch=0.3, rows=9, columns=9, lenslet=tw.Conic(radius=0.6, conic=-1.0)),
    "aspheric domes, moved and turned": tw.LensArray.hexagonal(
        pitch=0.5, rings=4, lenslet=tw.EvenAsphere(radius=-1.2, conic=-2.5, terms={2: 0.02, 4: -0.3, 6: 0.8})
    ).placed(shift=(0.1, 0.02, -0.3), rotation=-0.7),
    "hats": tw.LensArray.square(
        pitch=0.5, rows=7, columns=7, lenslet=tw.EvenAsphere(radius=np.inf, conic=0.0, terms={2: -0.3, 4: 2.0})
    ),
}


@pytest.mark.parametrize("name", LENSES)
def test_a_round_nose_on_lenslets_equals_brute_force(name):
    tool = tw.Tool(nose_radius=0.4, included=110 * DEG, radius_error=0.003, offset=(0.004, 0.0, -0.02))
    where = spiral(1.2, 0.05, 60, sense=-1)
    got = touch(LENSES[name], tool, angle=where.angle, radius=where.radius, sense=-1, rim=1.3)
    for i in np.random.default_rng(2).choice(where.angle.size, 40, replace=False):
        expected, _ = brute_contact(LENSES[name], tool, where.angle[i], where.radius[i], -1, 1.3)
        assert got.z[i] == pytest.approx(expected, abs=1e-14), f"point {i}"


ODD_LENSES = {
    "a term that flattens a sphere": (
        tw.EvenAsphere(radius=1.0, conic=0.0, terms={2: -0.4}),
        tw.Tool(nose_radius=2.0, included=150 * DEG),
        np.linspace(0.8, 0.0, 96),
        0.8,
    ),
    "a wall under half a circle": (
        tw.EvenAsphere(radius=np.inf, conic=0.0, terms={6: -450 / (6 * 1.5**5)}),
        tw.Tool(nose_radius=0.2),
        np.linspace(0.884, 0.84, 16),
        1.5,
    ),
    "a needle": (
        tw.Conic(radius=-1e-4, conic=-101.0),
        tw.Tool(nose_radius=10.0, included=170 * DEG),
        np.linspace(0.8, 0.0, 96),
        0.8,
    ),
}


@pytest.mark.parametrize("name", ODD_LENSES)
def test_a_lenslet_that_nobody_would_cut_equals_brute_force(name):
    lenslet, tool, radius, rim = ODD_LENSES[name]
    surface, angle = tw.LensArray(centres=[[0, 0]], lenslet=lenslet), np.arange(radius.size) * (2 * np.pi / 8)
    got = touch(surface, tool, angle=angle, radius=radius, sense=1, rim=rim)
    for i in range(0, radius.size, radius.size // 16):
        expected, _ = brute_contact(surface, tool, angle[i], radius[i], 1, rim)
        assert got.z[i] == pytest.approx(expected, abs=1e-12), f"point {i}"


@pytest.mark.parametrize("order", [np.arange(24)[::-1], np.random.default_rng(5).permutation(24)])
def test_turns_over_lenslets_may_come_in_any_order(order):
    lenses, where = LENSES["aspheric domes, moved and turned"], spiral(1.2, 0.05, 60)
    angle, radius = where.angle[:-1], where.radius[:-1]
    inward = touch(lenses, ROUND, angle=angle, radius=radius, sense=1)
    got = touch(lenses, ROUND, angle=angle, radius=radius.reshape(24, 60)[order].ravel(), sense=1)
    np.testing.assert_allclose(got.z, inward.z.reshape(24, 60)[order].ravel(), rtol=0, atol=1e-13)


def test_a_flank_touches_the_ridge_between_bowls_beyond_the_outermost_tip():
    tool = tw.Tool(nose_radius=5.0, included=20 * DEG)
    bowls = tw.LensArray.square(pitch=4.0, rows=3, columns=3, lenslet=tw.Sphere(radius=10.0))
    radius = np.linspace(0.8, 1.1, 40)
    z = [touch(bowls, tool, angle=[0.0, 2 * np.pi], radius=[0.3, at], sense=1).z[1] for at in radius]
    end = 10 * DEG
    flank = 5 * (1 - np.cos(end)) + (2 - radius - 5 * np.sin(end)) * np.tan(end)
    on_bowl = 5 - np.sqrt((10 - 5) ** 2 - radius**2)
    expected = np.maximum(10 - np.sqrt(10**2 - 2**2) - flank, np.where(radius < 5 * np.sin(end), on_bowl, -np.inf))
    np.testing.assert_allclose(z, expected, atol=1e-14)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("rake", [0.0, -25 * DEG])
def test_tilted_plane_in_closed_form(rake, sense):
    sx, sy = 0.12, -0.07
    tool = tw.Tool(nose_radius=0.4, included=120 * DEG, rake=rake, offset=(0.02, 0.01, -0.005))
    where = spiral(2.0, 0.1, 60, sense)
    path = tw.place(where, tw.Part(surface=tw.Plane(slope=(sx, sy)), radius=2.0), tool)
    c, s = np.cos(where.angle), np.sin(where.angle)
    along, across = sx * c + sy * s, sy * c - sx * s
    # Height of the plane over the rake plane's own axes: f - e = const + R (a sin t - b (1 - cos t)).
    b = np.cos(rake) + across * sense * np.sin(rake)
    expected = (where.radius + 0.02) * along + 0.01 * across + 0.005 + 0.4 * (np.hypot(along, b) - b)
    np.testing.assert_allclose(path.z, expected, atol=1e-14)


@pytest.mark.parametrize("radius", [5.0, -5.0])
def test_sphere_in_closed_form(radius):
    tool = tw.Tool(nose_radius=0.7, included=150 * DEG)
    where = spiral(3.0, 0.05, 48)
    path = tw.place(where, tw.Part(surface=tw.Sphere(radius=radius), radius=3.0), tool)
    # The centre of the nose runs on a sphere whose radius is less by the nose (for a dome: more).
    inner = abs(radius) - 0.7 if radius > 0 else abs(radius) + 0.7
    centre = np.sign(radius) * (abs(radius) - np.sqrt(inner**2 - where.radius**2))
    np.testing.assert_allclose(path.z, centre - 0.7, atol=1e-14)


@pytest.mark.parametrize("along", ["z", "normal"])
def test_tangent_solution_on_a_smooth_freeform(along):
    """At the contact the tangents agree, and the tip follows from it: the closed form of a round nose."""
    surface, tool = SURFACES["freeform"], ROUND
    where = spiral(1.8, 0.02, 72, -1)
    path = tw.place(where, tw.Part(surface=surface, radius=1.8), tool, along=along)
    zx, zy = surface.gradient(path.contact_x, path.contact_y)
    slope = zx * np.cos(path.angle) + zy * np.sin(path.angle)
    np.testing.assert_allclose(np.tan(path.sweep), slope, atol=1e-9)
    phi = np.arctan(slope)
    contact = np.hypot(path.contact_x, path.contact_y)
    np.testing.assert_allclose(path.radius + 0.5 * np.sin(phi), contact, atol=1e-9)
    tip = surface.sag(path.contact_x, path.contact_y) + 0.5 * np.cos(phi) - 0.5
    np.testing.assert_allclose(path.z, tip, atol=1e-11)
    if along == "normal":
        np.testing.assert_allclose(contact, where.radius, atol=1e-12)
        assert np.abs(path.clearance).max() < 1e-12


def test_normal_placement_reports_where_it_gouges():
    surface = tw.SineGrid(amplitude=(0.05, 0.0), period=(0.5, 1.0))
    where = spiral(1.0, 0.02, 60)
    path = tw.place(where, tw.Part(surface=surface, radius=1.0), ROUND, along="normal")
    worst = int(path.clearance.argmin())
    assert path.clearance[worst] < -1e-3
    expected = path.z[worst] - brute_force(surface, ROUND, path.angle[worst], path.radius[worst], 1)
    assert path.clearance[worst] == pytest.approx(expected, abs=1e-10)


def test_points_that_share_no_azimuth_agree_with_points_that_do():
    surface = SURFACES["hexagonal domes"]
    where = spiral(1.2, 0.05, 40)
    together = touch(surface, ROUND, angle=where.angle, radius=where.radius, sense=1)
    order = np.random.default_rng(0).permutation(where.angle.size)
    apart = touch(surface, ROUND, angle=where.angle[order], radius=where.radius[order], sense=1)
    np.testing.assert_allclose(apart.z, together.z[order], atol=1e-13)


def test_contact_on_the_flank_of_a_steep_surface():
    tool = tw.Tool(nose_radius=0.2, included=40 * DEG)
    surface = tw.Plane(slope=(0.2, 0.0)) + tw.SineGrid(amplitude=(0.3, 0.0), period=(3.0, 1.0))
    got = touch(surface, tool, angle=[0.0], radius=[0.4], sense=1)
    u = np.linspace(-2, 2, 4_000_001)
    end = 0.2 * np.sin(20 * DEG)
    e = np.where(
        np.abs(u) < end,
        0.2 - np.sqrt(0.2**2 - np.clip(u, -end, end) ** 2),
        0.2 * (1 - np.cos(20 * DEG)) + (np.abs(u) - end) * np.tan(20 * DEG),
    )
    assert got.z[0] == pytest.approx((surface.sag(0.4 + u, 0 * u) - e).max(), abs=1e-11)
    assert got.sweep[0] > tool.arc[1]


def test_a_surface_that_ends_under_the_edge_is_refused_by_name():
    surface = tw.Sphere(radius=2.0)
    with pytest.raises(tw.errors.DomainError, match="Sphere is not defined"):
        touch(surface, tw.Tool(nose_radius=0.5), angle=[0.0, 1.0], radius=[1.0, 2.5], sense=1)
    grid = np.linspace(-1, 1, 21)
    table = tw.Gridded(x=grid, y=grid, z=0.1 * (grid**2 + grid[:, None] ** 2))
    with pytest.raises(tw.errors.DomainError, match="Gridded"):
        touch(table, tw.Tool(nose_radius=0.5), angle=[0.0, 0.1], radius=[0.99, 0.98], sense=1)


@pytest.mark.parametrize("short", [1e-2, 3e-3, 1e-3, 1e-4, 1e-5])
def test_a_contact_close_to_the_equator_of_a_dome_is_found(short):
    """The centre of the nose stands on a sphere of the radii's sum; the search's step is 0.008 mm."""
    dome, nose = tw.Sphere(radius=-2.0), 0.5
    tip = (2.0 - short) * (2.0 + nose) / 2.0
    got = touch(dome, tw.Tool(nose_radius=nose), angle=[0.0, 0.3], radius=[tip, 1.0], sense=1)
    assert got.x[0] == pytest.approx(2.0 - short, abs=1e-9)
    assert got.z[0] == pytest.approx(np.sqrt((2.0 + nose) ** 2 - tip**2) - 2.0 - nose, abs=1e-12)


@pytest.mark.parametrize("short", [1e-2, 1e-3, 1e-5, 1e-7, 1e-10])
def test_a_contact_close_to_the_border_of_a_table_is_found(short):
    """z = 0.1 (x² + y²) has the slope 0.2 x; a surface in pieces is searched, not followed by Newton."""
    grid = np.linspace(-1, 1, 21)
    table = tw.Gridded(x=grid, y=grid, z=0.1 * (grid**2 + grid[:, None] ** 2))
    contact = 1 - short
    sweep = np.arctan(0.2 * contact)
    tip = contact - 0.5 * np.sin(sweep)
    surface = tw.LensArray(centres=[[0, 0]], lenslet=table)
    got = touch(surface, ROUND, angle=[0.0, 0.3], radius=[tip, 0.3], sense=1)
    assert got.x[0] == pytest.approx(contact, abs=1e-9)
    assert got.z[0] == pytest.approx(0.1 * contact**2 - 0.5 * (1 - np.cos(sweep)), abs=1e-14)


NARROW = tw.Tool(nose_radius=0.5, included=60 * DEG)


@pytest.mark.parametrize("tool", [ROUND, NARROW], ids=["round", "narrow"])
def test_a_wall_outside_the_rim_does_not_lift_the_tool(tool):
    """The part is a flat; a wall of 1 mm stands 0.05 mm outside it, under the overhang of the nose."""
    surface = tw.LensArray(centres=[[0, 0]], lenslet=tw.Plane(), aperture=2.05, surround=1.0)
    path = tw.place(spiral(2.0, 0.1, 60), tw.Part(surface=surface, radius=2.0), tool)
    np.testing.assert_allclose(path.z, 0.0, atol=1e-14)
    everything = touch(surface, tool, angle=path.angle, radius=path.radius, sense=1)
    assert everything.z.max() > 0.9


@pytest.mark.parametrize("formula", ["0.0005/(x-2.2)**2", "0.002*(x/2)**40", "0.01*sin(9*x) + 1e-9/(rho-2.1)**2"])
def test_a_formula_beyond_the_rim_does_not_matter(formula):
    surface = tw.Expression(formula, feature_size=0.05)
    where = spiral(2.0, 0.05, 60)
    path = tw.place(where, tw.Part(surface=surface, radius=2.0), NARROW)
    for i in [*range(0, 600, 37), *range(600, where.angle.size, 200)]:
        inside, place = brute_contact(surface, NARROW, where.angle[i], where.radius[i], 1, 2.0)
        if place < 2.0 - 1e-6:
            assert path.z[i] == pytest.approx(inside, abs=1e-10), f"point {i}"
        else:
            assert inside - 1e-10 < path.z[i] < inside + 0.01


def test_gentle_surface_is_continued_under_the_nose_overhang():
    """x^6 overtakes any flank in the end, but not under the arc."""
    surface = tw.Expression("1e-3*x**6")
    where = spiral(2.0, 0.1, 60)
    path = tw.place(where, tw.Part(surface=surface, radius=2.0), NARROW)
    for i in range(0, where.angle.size, 41):
        expected = brute_force(surface, NARROW, where.angle[i], where.radius[i], 1)
        assert path.z[i] == pytest.approx(expected, abs=1e-10)
    assert np.hypot(path.contact_x, path.contact_y).max() > 2.1


@pytest.mark.parametrize("name", ["domes", "several tangents", "freeform"])
def test_tip_height_does_not_depend_on_other_tips(name):
    where = spiral(1.5, 0.05, 90)
    together = touch(SURFACES[name], ROUND, angle=where.angle, radius=where.radius, sense=1, rim=1.5)
    some = np.random.default_rng(5).permutation(where.angle.size)[:300]
    few = touch(SURFACES[name], ROUND, angle=where.angle[some], radius=where.radius[some], sense=1, rim=1.5)
    np.testing.assert_allclose(few.z, together.z[some], atol=1e-12)


def test_a_table_no_larger_than_the_part_is_enough():
    """z = 0.05 r²: on the bowl while the tangent point is on the table, then on the table's rim."""
    grid = np.linspace(-2, 2, 41)
    table = tw.Gridded(x=grid, y=grid, z=0.05 * (grid**2 + grid[:, None] ** 2))
    where = spiral(2.0, 0.1, 60)
    path = tw.place(where, tw.Part(surface=table, radius=2.0), NARROW)
    last = 2.0 - 0.5 * np.sin(np.arctan(0.2))
    on_rim = where.radius > last
    u = 2.0 - where.radius[on_rim]
    np.testing.assert_allclose(path.z[on_rim], 0.2 - (0.5 - np.sqrt(0.25 - u**2)), atol=1e-13)
    on_bowl = np.flatnonzero(~on_rim)[::41]
    for i in on_bowl:
        expected, _ = brute_contact(table, NARROW, where.angle[i], where.radius[i], 1, 2.0)
        assert path.z[i] == pytest.approx(expected, abs=1e-10)
    with pytest.raises(tw.errors.DomainError, match="Gridded"):
        touch(table, NARROW, angle=where.angle, radius=where.radius, sense=1)


def test_a_part_steeper_than_the_flanks_is_refused():
    part = tw.Part(surface=tw.Plane(slope=(1.0, 0.0)), radius=2.0)
    with pytest.raises(tw.GougeError, match=r"a flank of the tool touches the rim .* larger included angle"):
        tw.place(spiral(2.0, 0.1, 60), part, NARROW)


def test_unknown_direction_and_slope_beyond_the_arc_are_refused():
    where = spiral(1.0, 0.1, 24)
    part = tw.Part(surface=tw.Plane(slope=(1.0, 0.0)), radius=1.0)
    with pytest.raises(tw.InputError, match='must be "z" or "normal"'):
        tw.place(where, part, ROUND, along="x")
    with pytest.raises(tw.GougeError, match="larger included angle"):
        tw.place(where, part, tw.Tool(nose_radius=0.5, included=60 * DEG), along="normal")


def test_progress_can_stop_the_work():
    where = spiral(5.0, 0.01, 200)
    part = tw.Part(surface=tw.Sphere(radius=50.0), radius=5.0)

    def stop(done, total):
        assert 0 < done <= total == where.angle.size
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tw.place(where, part, ROUND, progress=stop)


def test_a_formula_without_height_on_the_axis_is_cut_around_it():
    """Across the axis 0.05 cos(3 phi) steps by 0.1 mm: the edge touches the far rim of the step, or beyond it."""
    surface = tw.Expression("0.05*cos(3*phi)")
    where = spiral(1.0, 0.05, 36)
    path = tw.place(where, tw.Part(surface=surface, radius=1.0), ROUND)
    last = where.angle.size - 1
    for i in [*range(last - 40, last, 3), *np.random.default_rng(4).integers(0, last, 20)]:
        assert path.z[i] == pytest.approx(
            max(
                brute_force(surface, ROUND, where.angle[i], where.radius[i], 1),
                # The two heights next to the axis, which brute force only approaches.
                max(0.05 * np.cos(3 * where.angle[i]) * np.array([1, -1])) - rise_at(ROUND, where.radius[i]),
            ),
            abs=1e-10,
        )


def rise_at(tool, u):
    """Height of a perfect nose above its tip at the distance ``u``; infinite beyond its arc."""
    return tool.nose_radius - np.sqrt(tool.nose_radius**2 - u**2) if u < 0.38 else np.inf


def test_a_ridge_far_sharper_than_the_nose():
    """A smooth ridge of 0.5 um radius: concave all over, with one tangent, but a parabola fits the crest only."""
    surface = tw.Expression("-0.2*sqrt((x-1.1)**2+1e-8)")
    where = spiral(1.6, 0.05, 60)
    path = tw.place(where, tw.Part(surface=surface, radius=1.6), ROUND)
    for i in range(0, where.angle.size, 97):
        assert path.z[i] == pytest.approx(brute_force(surface, ROUND, where.angle[i], where.radius[i], 1), abs=1e-10)


@pytest.mark.parametrize(
    "formula",
    [
        "0.0005*exp(-((x-10)**2 + (y-5)**2)/0.02**2)",
        "0.003*exp(-((x-10)**2 + (y-5)**2)/0.1**2)",
        "0.002*exp(-((x-10)**2 + (y-5)**2)/0.3**2)*sin(2*pi*x/0.07)",
        "0.0005*sin(2*pi*x/0.06)*sin(2*pi*y/0.05) + rho**2/100",
        "0.004*exp(-((rho-11.2)/0.05)**2)*cos(3*phi)",
    ],
)
def test_the_features_of_a_formula_are_found_wherever_they_are(formula):
    rng = np.random.default_rng(8)
    x, y = 10 + rng.normal(0, 0.1, 20), 5 + rng.normal(0, 0.01, 20)
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    surface = tw.Expression(formula)
    got = touch(surface, ROUND, angle=angle, radius=radius, sense=1)
    expected = [brute_force(surface, ROUND, a, r, 1) for a, r in zip(angle, radius, strict=True)]
    np.testing.assert_allclose(got.z, expected, atol=1e-10)


def test_a_bump_between_the_tips_and_off_every_ray_is_found():
    """A bump of 3 um, 20 um wide, reaches under the edge from 50 um away, where the surface itself is still flat."""
    surface = tw.Expression("0.003*exp(-((x-10)**2 + (y-5)**2)/0.02**2)")
    aside = np.array([-0.052, -0.049, -0.046, 0.046, 0.049, 0.052])
    angle, radius = np.full(6, np.arctan2(5, 10)), np.hypot(10, 5) + aside
    got = touch(surface, ROUND, angle=angle, radius=radius, sense=1)
    expected = [brute_force(surface, ROUND, a, r, 1) for a, r in zip(angle, radius, strict=True)]
    assert min(expected) > 2e-4
    np.testing.assert_allclose(got.z, expected, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "tool"), every_second(["smooth grid", "several tangents", "domes", "hexagonal domes"], TOOLS)
)
def test_a_tip_across_the_rake_plane_equals_brute_force_dilation(name, tool):
    tool = TOOLS[tool]
    rng = np.random.default_rng(11)
    angle, radius, y = np.sort(rng.uniform(0, 9, 15)), rng.uniform(-0.1, 1.2, 15), rng.uniform(-0.4, 0.4, 15)
    got = touch(SURFACES[name], tool, angle=angle, radius=radius, y=y, sense=-1)
    # A tool is as far off centre as its tip is across: the oracle knows nothing of y.
    expected = [
        brute_force(SURFACES[name], replace(tool, offset=np.add(tool.offset, (0, aside, 0))), a, r, -1)
        for a, r, aside in zip(angle, radius, y, strict=True)
    ]
    np.testing.assert_allclose(got.z, expected, rtol=0, atol=1e-10)
    u, v, e = tool.edge(got.sweep, -1)
    np.testing.assert_allclose((radius + u) * np.cos(angle) - (y + v) * np.sin(angle), got.x, atol=1e-12)
    np.testing.assert_allclose((radius + u) * np.sin(angle) + (y + v) * np.cos(angle), got.y, atol=1e-12)
    np.testing.assert_allclose(got.z + e, SURFACES[name].sag(got.x, got.y), atol=2e-12)


@pytest.mark.parametrize("along", ["z", "normal"])
@pytest.mark.parametrize("radius", [5.0, -5.0])
def test_sphere_under_a_tip_across_the_rake_plane_in_closed_form(radius, along):
    """The plane at the distance y cuts a sphere in a circle; the nose touches that circle."""
    tool = tw.Tool(nose_radius=0.7, included=150 * DEG)
    where = spiral(3.0, 0.05, 48)
    y = 0.3 * np.sin(7 * where.angle)
    path = tw.place(
        tw.Spiral(angle=where.angle, radius=where.radius, y=y),
        tw.Part(surface=tw.Sphere(radius=radius), radius=3.0),
        tool,
        along=along,
    )
    cut = np.sqrt(radius**2 - y**2)
    inner = cut - 0.7 if radius > 0 else cut + 0.7
    tip = path.radius
    centre = np.sign(radius) * (abs(radius) - np.sqrt(inner**2 - tip**2))
    np.testing.assert_allclose(path.z, centre - 0.7, atol=1e-13)
    # The normal of the circle passes through both centres.
    contact = tip * cut / inner
    found = path.contact_x * np.cos(path.angle) + path.contact_y * np.sin(path.angle)
    np.testing.assert_allclose(found, contact, atol=1e-9)
    np.testing.assert_allclose(path.contact_y * np.cos(path.angle) - path.contact_x * np.sin(path.angle), y, atol=1e-12)
    np.testing.assert_array_equal(path.y, y)
    if along == "normal":
        np.testing.assert_allclose(found, where.radius, atol=1e-12)
        assert np.abs(path.clearance).max() < 1e-12


def test_a_path_along_the_normal_keeps_what_its_spiral_states():
    where = spiral(1.0, 0.1, 36)
    y, lift = 0.01 * np.sin(where.angle), 1e-5 * np.cos(where.angle)
    where = replace(where, y=y, y_rate=0.01 * np.cos(where.angle), lift=lift)
    path = tw.place(where, tw.Part(surface=tw.Sphere(radius=20.0), radius=1.0), ROUND, along="normal")
    np.testing.assert_array_equal(path.lift, lift)
    np.testing.assert_array_equal(path.y_rate, where.y_rate)


class Slices(tw.Surface):
    """A sphere, numbered by pieces across X whose borders are at ``cuts``, and keep them to the left of them or not."""

    __slots__ = ("cuts", "seen", "side")
    whole = tw.Sphere(radius=-1.8)

    def __init__(self, cuts, side):
        self.cuts, self.side, self.seen = cuts, side, []

    def evaluate(self, x, y, order):
        return self.whole.evaluate(x, y, order)

    def sample(self, x, y):
        self.seen.append(x)
        return super().sample(x, y)

    def piece(self, x, y):
        return np.searchsorted(self.cuts, x + 0 * y, self.side)


@pytest.mark.parametrize("side", ["left", "right"])
def test_borders_at_samples_hide_no_maximum(side):
    # A line sampled where its pieces meet: rounding decides whether the border is higher than the sample.
    radius = np.linspace(0.1, 0.9, 400)
    place = {"angle": 2 * np.pi * np.arange(400), "radius": radius, "sense": 1}
    plain = Slices(np.array([0.0123]), side)
    touch(plain, ROUND, **place)
    got = touch(Slices(plain.seen[0][0], side), ROUND, **place)
    centre = np.sqrt((1.8 + 0.5) ** 2 - radius**2) - 1.8
    np.testing.assert_allclose(got.z, centre - 0.5, atol=1e-13)
