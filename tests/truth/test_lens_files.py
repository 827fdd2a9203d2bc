"""Sag of every type of surface in a lens file, and the frame of the part that is cut from it.

Oracle: the formulas that the programs publish, evaluated by mpmath at 40 digits in the unit of the file; for the frame,
a rigid rotation of the lens by a matrix of determinant +1.
"""

# ruff: noqa: ARG005 - all formulas have the same arguments

import math

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import turnwright as tw
from lens_files import EVEN, ODD, Q_DATA, ZERNIKE_DATA, ZERNIKES, K, R, block, grid_block, write_zmx
from turnwright.files import read_lens


def zmx(tmp_path, *surfaces, **how):
    return read_lens(write_zmx(tmp_path / "lens.zmx", *surfaces, **how))


def seq(tmp_path, *commands, unit="M"):
    path = tmp_path / "lens.seq"
    path.write_text("\n".join(["RDM;LEN", f"DIM {unit}", "WL 587.6", "SO 0 1e13", *commands, "SI 0 0", "GO"]))
    return read_lens(path)


def conic(r2, radius=R, k=K):
    c = 1 / mpmath.mpf(radius) if radius else mpmath.mpf(0)
    return c * r2 / (1 + mpmath.sqrt(1 - (1 + mpmath.mpf(k)) * c**2 * r2))


def largest_error(surface, formula, scale=1.0, reach=5.0, curve=True):
    """Return the largest difference of the sag from a formula in the unit of the file, the axis included. [mm]."""
    rng = np.random.default_rng(7)
    angle, distance = rng.uniform(-np.pi, np.pi, 40), reach * np.sqrt(rng.uniform(0, 1, 40))
    distance[:3] = 0.0, 1e-9, 1e-4
    x, y = distance * np.cos(angle), distance * np.sin(angle)
    with mpmath.workdps(40):
        unit = mpmath.mpf(scale)
        wanted = [float(unit * formula(mpmath.mpf(a) / unit, mpmath.mpf(b) / unit)) for a, b in zip(x, y, strict=True)]
    return float(np.abs(surface.sag(x, y) - wanted).max())


def power_sum(terms, r, step):
    return sum(mpmath.mpf(a) * r ** (step * i) for i, a in terms.items())


def even_asphere(x, y):
    return conic(x * x + y * y) + power_sum(EVEN, mpmath.hypot(x, y), 2)


NOLL = (  # Noll 1976, Table I, from j = 1
    lambda r, t: 1, lambda r, t: 2 * r * mpmath.cos(t), lambda r, t: 2 * r * mpmath.sin(t),
    lambda r, t: mpmath.sqrt(3) * (2 * r**2 - 1), lambda r, t: mpmath.sqrt(6) * r**2 * mpmath.sin(2 * t),
    lambda r, t: mpmath.sqrt(6) * r**2 * mpmath.cos(2 * t),
    lambda r, t: mpmath.sqrt(8) * (3 * r**3 - 2 * r) * mpmath.sin(t),
    lambda r, t: mpmath.sqrt(8) * (3 * r**3 - 2 * r) * mpmath.cos(t),
    lambda r, t: mpmath.sqrt(8) * r**3 * mpmath.sin(3 * t), lambda r, t: mpmath.sqrt(8) * r**3 * mpmath.cos(3 * t),
    lambda r, t: mpmath.sqrt(5) * (6 * r**4 - 6 * r**2 + 1),
)  # fmt: skip
FRINGE = (  # Wyant and Creath 1992, Table III, from 1
    lambda r, t: 1, lambda r, t: r * mpmath.cos(t), lambda r, t: r * mpmath.sin(t), lambda r, t: 2 * r**2 - 1,
    lambda r, t: r**2 * mpmath.cos(2 * t), lambda r, t: r**2 * mpmath.sin(2 * t),
    lambda r, t: (3 * r**3 - 2 * r) * mpmath.cos(t), lambda r, t: (3 * r**3 - 2 * r) * mpmath.sin(t),
    lambda r, t: 6 * r**4 - 6 * r**2 + 1, lambda r, t: r**3 * mpmath.cos(3 * t), lambda r, t: r**3 * mpmath.sin(3 * t),
)  # fmt: skip


def zernike(table, x, y, radius=6.0):
    r, t = mpmath.hypot(x, y) / mpmath.mpf(radius), mpmath.atan2(y, x)
    return sum(mpmath.mpf(ZERNIKES[place]) * one(r, t) for place, one in enumerate(table, 1))


def toroid(x, y, radius, terms):
    arc = conic(y * y) + sum(mpmath.mpf(a) * y ** (2 * i) for i, a in terms.items())
    if not radius:
        return arc
    turn = mpmath.mpf(radius)
    return turn - mpmath.sign(turn) * mpmath.sqrt((turn - arc) ** 2 - x * x)


POWERS = [(i, degree - i) for degree in range(1, 5) for i in range(degree, -1, -1)]
"""x, y, x^2, xy, y^2, x^3, ..."""
XY = {place: 1e-2 * (-1) ** place / (place + 2) for place in range(1, len(POWERS) + 1)}


def polynomial(x, y, radius):
    u, v = x / mpmath.mpf(radius), y / mpmath.mpf(radius)
    return sum(mpmath.mpf(XY[place]) * u**i * v**j for place, (i, j) in enumerate(POWERS, 1))


def q_bfs(x, y):  # Forbes 2007, Eq. 3.2 and Table
    c, u2 = 1 / mpmath.mpf(R), (x * x + y * y) / mpmath.mpf(6) ** 2
    q = (
        1, (13 - 16 * u2) / mpmath.sqrt(19), mpmath.sqrt(mpmath.mpf(2) / 95) * (29 - 4 * u2 * (25 - 19 * u2)),
        mpmath.sqrt(mpmath.mpf(2) / 2545) * (207 - 4 * u2 * (315 - u2 * (577 - 320 * u2))),
    )  # fmt: skip
    r2 = x * x + y * y
    total = sum(mpmath.mpf(a) * one for a, one in zip((1e-2, -2e-3, 3e-4, 1e-4), q, strict=True))
    return conic(r2, k=0) + u2 * (1 - u2) / mpmath.sqrt(1 - c * c * r2) * total


def q_con(x, y):  # Forbes 2007, Eq. 2.2 and Table
    u2 = (x * x + y * y) / mpmath.mpf(6) ** 2
    q = (1, -(5 - 6 * u2), 15 - 14 * u2 * (3 - 2 * u2), -(35 - 12 * u2 * (14 - u2 * (21 - 10 * u2))))
    total = sum(mpmath.mpf(a) * one for a, one in zip((1e-2, -2e-3, 3e-4, 1e-4), q, strict=True))
    return conic(x * x + y * y) + u2**2 * total


ARC = {1: 1e-4, 2: -2e-6, 3: 3e-8, 4: 1e-10, 5: -1e-12, 6: 1e-14, 7: 1e-16}

CASES = {
    "STANDARD": (block("STANDARD"), lambda x, y: conic(x * x + y * y)),
    "flat": (block("STANDARD", radius=0), lambda x, y: mpmath.mpf(0)),
    "EVENASPH": (block("EVENASPH", EVEN), even_asphere),
    "ODDASPHE": (block("ODDASPHE", ODD), lambda x, y: conic(x * x + y * y) + power_sum(ODD, mpmath.hypot(x, y), 1)),
    "XOSPHERE": (
        block("XOSPHERE", extra={1: 8, 2: 6.0} | {i + 2: 10 * a for i, a in ODD.items()}),
        lambda x, y: conic(x * x + y * y) + power_sum({i: 10 * a for i, a in ODD.items()}, mpmath.hypot(x, y) / 6, 1),
    ),
    "XASPHERE": (
        block("XASPHERE", extra={1: 8, 2: 6.0} | {i + 2: a for i, a in EVEN.items()}),
        lambda x, y: conic(x * x + y * y) + power_sum(EVEN, mpmath.hypot(x, y) / 6, 2),
    ),
    "newer version": (
        block("XASPHERE", {13: 8, 14: 6.0} | {i + 14: a for i, a in EVEN.items()}),
        lambda x, y: conic(x * x + y * y) + power_sum(EVEN, mpmath.hypot(x, y) / 6, 2),
    ),
    "BICONICX": (
        block("BICONICX", {1: -70.0, 2: 0.4}),
        lambda x, y: (y * y / R - x * x / 70)
        / (1 + mpmath.sqrt(1 - (1 + mpmath.mpf(K)) * y * y / R**2 - (1 + mpmath.mpf(0.4)) * x * x / 70**2)),
    ),
    "BICONICX, flat in x": (block("BICONICX", {1: 0.0}), lambda x, y: conic(y * y)),
    "TOROIDAL": (
        block("TOROIDAL", {1: -55.0} | {i + 1: a for i, a in ARC.items()}), lambda x, y: toroid(x, y, -55.0, ARC)
    ),
    "TOROIDAL, cylinder": (
        block("TOROIDAL", {1: 0.0} | {i + 1: a for i, a in ARC.items()}), lambda x, y: toroid(x, y, 0, ARC)
    ),
    "TOROIDAL with Zernike": (
        block("TOROIDAL", {0: 1.0, 1: 30.0}, ZERNIKE_DATA), lambda x, y: toroid(x, y, 30.0, {}) + zernike(NOLL, x, y)
    ),
    "XPOLYNOM": (
        block("XPOLYNOM", extra={1: len(XY), 2: 6.0} | {i + 2: a for i, a in XY.items()}),
        lambda x, y: conic(x * x + y * y) + polynomial(x, y, 6),
    ),
    "FZERNSAG": (
        block("FZERNSAG", {0: 1.0, 9: 0.3, 10: -0.2} | EVEN, ZERNIKE_DATA),
        lambda x, y: even_asphere(x, y) + zernike(FRINGE, x - mpmath.mpf(0.3), y + mpmath.mpf(0.2)),
    ),
    "SZERNSAG": (
        block("SZERNSAG", {0: 0.0} | EVEN, ZERNIKE_DATA), lambda x, y: even_asphere(x, y) + zernike(NOLL, x, y)
    ),
    "QED_TYPE, Q-bfs": (block("QED_TYPE", extra={1: 0, 2: 4, 3: 6.0} | Q_DATA, conic=0.0), q_bfs),
    "QED_TYPE, Q-con": (block("QED_TYPE", extra={1: 1, 2: 4, 3: 6.0} | Q_DATA), q_con),
    "QED_TYPE by parameter": (
        block("QED_TYPE", {0: 1}, {1: 4, 2: 6.0} | {i - 1: a for i, a in Q_DATA.items()}), q_con
    ),
    "QED_TYPE, an unused parameter": (block("QED_TYPE", {0: 0}, {1: 1, 2: 4, 3: 6.0} | Q_DATA), q_con),
    "BINARY_2": (block("BINARY_2", {0: 1} | EVEN, {1: 2, 2: 6.0, 3: -800.0, 4: 30.0}), even_asphere),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("unit", ["MM", "IN"])
def test_sag_of_a_zemax_type_is_its_formula(tmp_path, case, unit):
    lines, formula = CASES[case]
    scale = {"MM": 1.0, "IN": 25.4}[unit]
    surface = zmx(tmp_path, lines, unit=unit).surface(1).surface
    assert largest_error(surface, formula, scale, 5.0 * scale) < 1e-12


def test_irregular_surface_lies_on_its_tilted_formula(tmp_path):
    """Points of the surface, turned back by mpmath's rotation matrices, have the height of the formula."""
    parameters = {1: 0.3, 2: -0.2, 3: 2.0, 4: -1.5, 5: 1e-3, 6: 2e-3, 7: -1.5e-3, 8: 25.0}
    surface = zmx(tmp_path, block("IRREGULA", parameters)).surface(1).surface
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-3.5, 3.5, (2, 30))
    z = surface.sag(x, y)
    with mpmath.workdps(40):
        a, b, theta = (mpmath.radians(mpmath.mpf(parameters[place])) for place in (3, 4, 8))
        about_x = mpmath.matrix([[1, 0, 0], [0, mpmath.cos(a), -mpmath.sin(a)], [0, mpmath.sin(a), mpmath.cos(a)]])
        about_y = mpmath.matrix([[mpmath.cos(b), 0, mpmath.sin(b)], [0, 1, 0], [-mpmath.sin(b), 0, mpmath.cos(b)]])
        for point in zip(x, y, z, strict=True):
            moved = mpmath.matrix(point) - mpmath.matrix([mpmath.mpf(0.3), mpmath.mpf(-0.2), 0])
            u, v, w = (about_x * about_y).T * moved
            rho2, along = (u * u + v * v) / 25, (v * mpmath.cos(theta) - u * mpmath.sin(theta)) / 5
            wanted = (
                conic(u * u + v * v) + 1e-3 * rho2**2 + mpmath.mpf(2e-3) * along**2 - mpmath.mpf(1.5e-3) * rho2 * along
            )
            assert abs(w - wanted) < 1e-12


def test_grid_sag_passes_through_its_heights(tmp_path):
    """A bilinear table, which the spline reproduces, on an even asphere."""
    lines, x, y, z = grid_block()
    surface = zmx(tmp_path, lines).surface(1).surface
    px, py = (one.ravel() for one in np.meshgrid(x[1:-1], y[1:-1]))
    with mpmath.workdps(40):
        base = np.array([float(even_asphere(mpmath.mpf(a), mpmath.mpf(b))) for a, b in zip(px, py, strict=True)])
    assert np.abs(surface.sag(px, py) - base - z[1:-1, 1:-1].ravel()).max() < 1e-12


def test_phase_of_a_diffractive_surface(tmp_path):
    one = zmx(tmp_path, block("BINARY_2", {0: 2}, {1: 2, 2: 6.0, 3: -800.0, 4: 30.0}), unit="IN").surface(1)
    x, y = np.array([0.0, 30.0]), np.array([10.0, -40.0])
    p = np.hypot(x, y) / (6 * 25.4)
    assert one.phase.at(x, y) == pytest.approx(2 * (-800 * p**2 + 30 * p**4), rel=1e-14)


SEQ = {
    "SPH": (["S 40 3 NBK7_SCHOTT"], lambda x, y: conic(x * x + y * y, k=0)),
    "RDY": (["S 1 3 NBK7_SCHOTT", "RDY 40; CON; K -0.7"], lambda x, y: conic(x * x + y * y)),
    "CUY by number": (["S 1 3 NBK7_SCHOTT", "S 5 1", "CUY S1 0.025"], lambda x, y: conic(x * x + y * y, k=0)),
    "ASP": (
        ["S 40 3 NBK7_SCHOTT", "  ASP", "  K -0.7", "  A -2e-05; B 3e-07; C 1e-09; D &", "  -2e-11 ! r^10"],
        lambda x, y: conic(x * x + y * y) + power_sum({2: -2e-5, 3: 3e-7, 4: 1e-9, 5: -2e-11}, mpmath.hypot(x, y), 2),
    ),
    "XYP": (
        ["S 40 3 NBK7_SCHOTT", "SPS XYP", "SCO NRADIUS 6", "SCO K -0.7"]
        + [f"SCO C{place + 1} {value!r}; SCC C{place + 1} 100" for place, value in XY.items()],
        lambda x, y: conic(x * x + y * y) + polynomial(x, y, 6),
    ),
    "ZFR": (
        ["S 40 3 NBK7_SCHOTT", "SPS ZFR 6", "SCO C1 -0.7; SCO C3 6"]
        + [f"SCO C{place + 3} {value!r}" for place, value in ZERNIKES.items()],
        lambda x, y: conic(x * x + y * y) + zernike(FRINGE, x, y),
    ),
    "ODD": (
        ["S 40 3 NBK7_SCHOTT", "SPS ODD 0.0", "SCO K -0.7"]
        + [f"SCO AR{power} {value!r}" for power, value in ODD.items()],
        lambda x, y: conic(x * x + y * y) + power_sum(ODD, mpmath.hypot(x, y), 1),
    ),
    "ODD by number": (
        ["S 40 3 NBK7_SCHOTT", "SPS ODD 6.0", "SCO C1 -0.7"]
        + [f"SCO C{power + 1} {value!r}" for power, value in ODD.items()],
        lambda x, y: conic(x * x + y * y) + power_sum(ODD, mpmath.hypot(x, y) / 6, 1),
    ),
    "YTO": (
        ["S 40 3 NBK7_SCHOTT", "YTO; K -0.7; RDX -55; A -2e-6"], lambda x, y: toroid(x, y, -55.0, {2: -2e-6})
    ),
    "XTO": (["S -55 3 NBK7_SCHOTT", "XTO; K -0.7; CUX 0.025; A -2e-6"], lambda x, y: toroid(y, x, -55.0, {2: -2e-6})),
}  # fmt: skip


@pytest.mark.parametrize("case", SEQ)
@pytest.mark.parametrize("unit", ["M", "C"])
def test_sag_of_a_code_v_type_is_its_formula(tmp_path, case, unit):
    commands, formula = SEQ[case]
    scale = {"M": 1.0, "C": 10.0}[unit]
    surface = seq(tmp_path, *commands, unit=unit).surface(1).surface
    assert largest_error(surface, formula, scale, 5.0 * scale) < 1e-12


HALF_TURN = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
L_MARK = [
    block("XPOLYNOM", extra={1: 9, 2: 5.0, 3: 0.02, 4: -0.05, 6: 0.03, 8: 0.01, 10: -0.02, 11: 0.015}),
    block("FZERNSAG", {0: 1.0, 9: 0.4}, ZERNIKE_DATA),
    block("SZERNSAG", {0: 1.0}, ZERNIKE_DATA),
    block("IRREGULA", {1: 0.3, 2: -0.2, 3: 2.0, 4: -1.5, 5: 1e-3, 6: 2e-3, 7: -1.5e-3, 8: 25.0}, diameter=4.0),
    block("ODDASPHE", ODD), block("BICONICX", {1: 60.0}), block("TOROIDAL", {1: -55.0, 3: 1e-5}),
    block("QED_TYPE", extra={1: 1, 2: 4, 3: 6.0} | Q_DATA), grid_block()[0],
]  # fmt: skip


@pytest.mark.parametrize("mark", L_MARK, ids=lambda lines: lines[0])
def test_an_l_shaped_mark_keeps_its_hand_on_both_faces(tmp_path, mark):
    """The same surface as front and back of a lens: points of the solid lens, turned by hand, lie on the part."""
    assert np.linalg.det(HALF_TURN) == pytest.approx(1.0)
    back = [line.replace("GLAS N-BK7", "COAT AR") for line in mark]
    lens = zmx(tmp_path, mark, back)
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-2.5, 2.5, (2, 50))
    front, rear = lens.part(1), lens.part(2)
    assert lens.side(1).is_turned
    assert not lens.side(2).is_turned
    points = HALF_TURN @ np.stack([x, y, lens.surface(1).surface.sag(x, y)])
    assert front.surface.sag(points[0], points[1]) == pytest.approx(points[2], abs=1e-12)
    assert rear.surface.sag(x, y) == pytest.approx(lens.surface(2).surface.sag(x, y), abs=1e-15)
    mirror_image = front.surface.sag(-points[0], points[1]) - points[2]
    assert (
        mark[0] in ("TYPE ODDASPHE", "TYPE BICONICX", "TYPE TOROIDAL", "TYPE QED_TYPE") or np.ptp(mirror_image) > 1e-4
    )


def sphere(radius, thickness, glass):
    return block("STANDARD", radius=radius, conic=0.0, thickness=thickness, glass=glass, diameter=3.0)


def test_sides_of_a_cemented_lens_and_a_dummy(tmp_path):
    lens = zmx(
        tmp_path, sphere(50.0, 3.0, "N-BK7"), sphere(-40.0, 2.0, "SF5"), sphere(-90.0, 9.0, ""), sphere(0, 1.0, "")
    )
    with pytest.raises(tw.InputError, match="surface 2 has N-BK7 before and SF5 after it"):
        lens.part(2)
    before, after = lens.part(2, "before"), lens.part(2, "after")
    assert (before.surface.radius, after.surface.radius) == (-40.0, 40.0)
    assert (before.material_note, after.material_note) == ("N-BK7", "SF5")
    with pytest.raises(tw.InputError, match="surface 4 has air on both sides"):
        lens.part(4)
    assert lens.part(4, "before").radius == 3.0


def test_mirrors_turn_the_order_of_the_light(tmp_path):
    """A Mangin mirror and what follows it: light runs toward -z, so the glass after a surface is toward -z."""
    lens = zmx(
        tmp_path, sphere(-100.0, 5.0, "N-BK7"), sphere(-120.0, -5.0, "MIRROR"), sphere(-100.0, -20.0, ""),
        sphere(60.0, -2.0, "SF5"), sphere(30.0, -10.0, ""), sphere(-80.0, 10.0, "MIRROR"),
    )  # fmt: skip
    toward = {number: (lens.side(number).side, lens.side(number).toward) for number in range(1, 7)}
    assert toward == {
        1: ("after", 1), 2: ("before", -1), 3: ("before", 1), 4: ("after", -1), 5: ("before", 1), 6: ("after", -1),
    }  # fmt: skip
    assert lens.part(2).surface.radius == -120.0  # the glass of the mirror is convex behind
    assert lens.part(6).surface.radius == -80.0
    assert lens.part(2, "after").surface.radius == 120.0


def test_a_right_angle_tilt_leaves_the_side_to_the_user(tmp_path):
    tilt = ["TYPE COORDBRK", "CURV 0.0", "PARM 3 90", "PARM 6 0", "DISZ 0"]
    lens = zmx(tmp_path, sphere(0, 5.0, ""), tilt, sphere(-120.0, 0.0, "MIRROR"))
    with pytest.raises(tw.InputError, match="the direction of the light at surface 3 is not certain"):
        lens.part(3)
    assert lens.part(3, "+z").surface.radius == 120.0
    assert lens.part(3, "-z").surface.radius == -120.0
    with pytest.raises(tw.InputError, match="surface 2 is a coordinate break"):
        lens.surface(2).surface  # noqa: B018


@pytest.mark.parametrize(
    ("lines", "outline"),
    [
        (["CLAP 0 4"], None),
        (["CLAP 1 4"], tw.Outline(annulus=(4.0, 1.0))),
        (["CLAP 0 4", "OBDC 1.5 0.5"], tw.Outline(disc=4.0, centre=(-1.5, 0.5))),
        (["SQAP 3 2", "OBDC 1.5 0.5"], tw.Outline(rectangle=(6.0, 4.0), centre=(-1.5, 0.5))),
    ],
)
def test_aperture_of_a_front_is_turned_with_it(tmp_path, lines, outline):
    part = zmx(tmp_path, [*block("STANDARD"), *lines]).part(1)
    assert part.outline == outline
    assert outline is not None or part.radius == 4.0


def test_aperture_of_code_v_off_the_axis(tmp_path):
    lens = seq(tmp_path, "S -200 -100 REFL", "CON; K -1", "CIR 12.7; ADY 60", "S 0 0", "CIR EDG 3")
    assert lens.part(1).outline == tw.Outline(disc=12.7, centre=(0.0, 60.0))
    assert lens.surface(1).semi_diameter == 12.7
    assert lens.surface(2).semi_diameter == 3.0


@pytest.mark.parametrize(
    ("commands", "outline"),
    [
        ("CIR L'a' 9; CIR OBS L'b' 2; ADY L'b' 3", None),
        ("CIR L'a' 9; ADY L'a' 3", tw.Outline(disc=9.0, centre=(0.0, 3.0))),
        ("CIR 9; CIR EDG 12; ADX EDG 1; CIR OBS 2; ADX 0", None),
        ("CIR 9; CIR HOL 2", tw.Outline(annulus=(9.0, 2.0))),
        ("CIR 9; CIR HOL 2; ADX 1; ADX HOL 1", tw.Outline(annulus=(9.0, 2.0), centre=(1.0, 0.0))),
        ("REX EDG 5; REY EDG 4; ADX EDG 1", tw.Outline(rectangle=(10.0, 8.0), centre=(1.0, 0.0))),
    ],
)
def test_an_aperture_of_code_v_has_its_own_words(tmp_path, commands, outline):
    one = seq(tmp_path, "S 50 5 NBK7", *commands.split(";")).surface(1)
    assert (one.fault, one.aperture) == ("", outline)
    assert outline is None or outline.disc is None or one.semi_diameter == 9.0


@pytest.mark.parametrize(
    "commands",
    [
        "CIR 9; CIR HOL 2; ADX HOL 1", "CIR 9; CIR HOL 2; ADX 1", "CIR 9; REX HOL 2; REY HOL 2",
        "CIR 9; ELX HOL 2; ELY HOL 2", "REX 5; REY 4; CIR HOL 1", "REX EDG 5; REY EDG 4; ARO EDG 30", "CIR HOL 1",
        "CIR L'a' 9; CIR L'b' 4", "CIR L'a' 9; ADX L'b' 1", "CIR L'a' 9; ADX 1", "CIR EDG 9; ADX 1", "REX 5", "ADX 1",
        "CIR 9; REX 5; REY 4", "CIR 9; CIR HOL L'a' 1; CIR HOL L'b' 2",
    ],
)  # fmt: skip
def test_an_aperture_of_several_words_is_refused(tmp_path, commands):
    assert "its aperture of" in seq(tmp_path, "S 50 5 NBK7", *commands.split(";")).surface(1).fault


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_encodings_of_zemax_give_the_same_lens(tmp_path, encoding):
    lens = zmx(tmp_path, [*block("EVENASPH", EVEN), "COMM Ø 5 mm"], unit="CM", encoding=encoding)
    one = lens.surface(1)
    assert (lens.unit, lens.primary, lens.name, one.comment) == ("cm", 0.00055, "test lens", "Ø 5 mm")
    assert (one.after, one.radius, one.semi_diameter) == ("N-BK7", 400.0, 50.0)
    assert math.isinf(lens.surface(0).thickness)


def test_indices_are_those_that_a_file_states(tmp_path):
    lens = zmx(tmp_path, ["TYPE STANDARD", "CURV 0", "DISZ 1", "GLAS ___BLANK 1 0 1.489 57.4 0 0"], block("STANDARD"))
    assert (lens.surface(1).index, lens.surface(2).index) == (1.489, None)
    lens = seq(tmp_path, "S 40 3 517000.520000", "S 0 1 AIR", "S 10 1 1.5168:64.17", "S 0 2 REFL")
    assert [lens.surface(number).index for number in (1, 2, 3)] == [1.517, None, 1.5168]
    assert [one.is_mirror for one in lens.surfaces] == [False, False, False, False, True, False]


def coordinate_break(about_x=0.0, about_y=0.0, thickness=0.0, shift=0.0):
    return ["TYPE COORDBRK", "CURV 0.0", f"PARM 2 {shift}", f"PARM 3 {about_x}", f"PARM 4 {about_y}",
            f"DISZ {thickness}"]  # fmt: skip


DUMMY, MIRROR, LENS = sphere(0, 5.0, ""), sphere(-120.0, 0.0, "MIRROR"), sphere(50.0, 3.0, "N-BK7")
FOLD = sphere(0, 0.0, "MIRROR")


@pytest.mark.parametrize(
    ("surfaces", "toward"),
    [
        ([DUMMY, coordinate_break(60), coordinate_break(60), MIRROR], -1),  # 120 degrees to +z
        ([DUMMY, coordinate_break(60), coordinate_break(-60), MIRROR], 1),
        ([DUMMY, coordinate_break(80), coordinate_break(0, 0), coordinate_break(80), coordinate_break(-90), MIRROR], 1),
        ([DUMMY, coordinate_break(180), MIRROR], -1),
        ([DUMMY, coordinate_break(90), coordinate_break(90), MIRROR], -1),
        ([DUMMY, coordinate_break(45), FOLD, coordinate_break(45), MIRROR], -1),
        ([DUMMY, coordinate_break(45), FOLD, coordinate_break(-45), coordinate_break(-90), MIRROR], 1),
        ([DUMMY, coordinate_break(0, 60), FOLD, coordinate_break(0, 60), coordinate_break(30), MIRROR], -1),
        ([DUMMY, coordinate_break(88), MIRROR], 0),
        # Beside curved surfaces the real ray is not the axial one, so that both ways of reckoning must agree.
        ([LENS, sphere(-50.0, 9.0, ""), coordinate_break(45), FOLD, coordinate_break(45), MIRROR], -1),
        ([LENS, sphere(-50.0, 9.0, ""), coordinate_break(60), coordinate_break(60), MIRROR], 0),
        ([DUMMY, coordinate_break(shift=50), MIRROR, coordinate_break(90), coordinate_break(90), MIRROR], 0),
        # What is not read may have turned the frame or the light.
        ([DUMMY, [*DUMMY, "TWST 1"], MIRROR], 0),
        ([DUMMY, ["TYPE NONSEQCO", *DUMMY[1:]], MIRROR], 0),
        ([DUMMY, ["TYPE COORDBRK", "CURV 0.0", "PARM 3 a"], MIRROR], 0),
        ([DUMMY, ["TYPE USERSURF", *DUMMY[1:]], MIRROR], 0),
        ([DUMMY, [*DUMMY, "CONI a"], MIRROR], 1),
    ],
)
def test_a_mirror_has_its_substrate_behind_the_light(tmp_path, surfaces, toward):
    """Oracle: the light as a vector, reckoned by hand."""
    lens = zmx(tmp_path, *surfaces)
    number = len(surfaces)
    if toward:
        assert lens.side(number).toward == toward
    else:
        with pytest.raises(tw.InputError, match=r"direction of the light at surface \d is not certain"):
            lens.side(number)
        assert lens.side(number, "-z").toward == -1


CODE_V_TURNS = {
    "60 and 60 degrees": (["S 0 0; ADE 60", "S 0 0; ADE 60", "S -100 -50 REFL"], -1),
    "right angles": (["S 0 0; ADE 90", "S 0 0; BDE 90", "S -100 -50 REFL"], 0),
    "return": (["S 0 0; ADE 180", "S -100 -50 REFL; RET S1"], 1),
    "return, with its own number": (["S 0 0; ADE 180", "S -100 -50 REFL", "RET S3 S1"], 1),
    "return to a tilt": (["S 0 0; ADE 180", "S 0 0; ADE 30", "S -100 -50 REFL; RET S2"], 0),
    "tilt and return": (["S 0 0; ADE 180; DAR", "S -100 -50 REFL"], 0),
    "bend": (["S 0 -10 REFL; ADE 45; BEN", "S -100 -50 REFL"], -1),
    "return of a fold": (["S 0 -10 REFL; ADE 45; DAR", "S -100 -50 REFL"], 0),
    "reverse": (["S 0 10; ADE 30; REV", "S -100 -50 REFL"], 1),
    "glass that reflects": (["S 0 10 NBK7", "S 0 -10 NBK7 TIR; ADE 45; BEN", "S 0 -10", "S -100 50 REFL"], -1),
    "mode": (["S 0 10 NBK7", "S 0 -10 NBK7; RMD TIR; ADE 45; BEN", "S 0 -10", "S -100 50 REFL"], -1),
    "refraction": (["S 0 10 NBK7", "S 0 10; RMD REFR", "S -100 50 REFL"], 1),
    "an unknown mode": (["S 0 10 NBK7", "S 0 10 NBK7 DIF", "S -100 50 REFL"], 0),
    "global place": (["S 0 10; GLB S1", "S -100 50 REFL"], 0),
    "no number of a shape": (["S 0 10; K a", "S -100 50 REFL"], 1),
    "no number of a tilt": (["S 0 10; ADE a", "S -100 50 REFL"], 0),
    "not sequential": (["S 0 10; NSS", "S 0 10", "END", "S -100 50 REFL"], 0),
}


@pytest.mark.parametrize("case", CODE_V_TURNS)
def test_a_mirror_of_code_v_has_its_substrate_behind_it(tmp_path, case):
    commands, toward = CODE_V_TURNS[case]
    lens = seq(tmp_path, "S 0 10", *commands)
    number = len(lens.surfaces) - 2
    assert lens.surface(number).is_mirror
    if toward:
        assert lens.side(number).toward == toward
    else:
        with pytest.raises(tw.InputError, match=r"direction of the light at surface \d is not certain"):
            lens.side(number)


def test_a_face_that_reflects_in_glass_is_cut_into_it(tmp_path):
    lens = seq(tmp_path, "S 0 10 NBK7", "S 0 -10 NBK7 TIR; ADE 45; BEN", "S 0 -10")
    assert (lens.side(2).side, lens.side(2).toward, lens.side(2).material) == ("before", -1, "NBK7")


QUALIFIED = ["S 50 5 NBK7; SLB 'lab'", "S 30 5"]


@pytest.mark.parametrize(
    ("command", "radii"),
    [
        ("RDY S1..2 70", (70.0, 70.0)), ("RDY SA 70", (70.0, 70.0)), ("RDY S'lab' 70", (70.0, 30.0)),
        ('CUY S"LAB"..2 0.1', (10.0, 10.0)), ("RDY S1 S2 70", (70.0, 70.0)), ("RDY S2 70", (50.0, 70.0)),
        ("RDY S1 UMY 0.1", (50.0, 30.0)),
    ],
)  # fmt: skip
def test_a_qualifier_names_one_or_several_surfaces(tmp_path, command, radii):
    lens = seq(tmp_path, *QUALIFIED, command)
    assert tuple(one.surface.radius for one in lens.surfaces[1:3]) == pytest.approx(radii)


def test_a_qualifier_serves_every_command_of_a_surface(tmp_path):
    lens = seq(tmp_path, *QUALIFIED, "GLA S1..2 SI", "ASP S1..2; K SA -1; A S'lab' 1e-6", "THI S1..2 4")
    one, two = lens.surfaces[1:3]
    assert (one.after, two.after, one.thickness, two.thickness) == ("SI", "SI", 4.0, 4.0)
    assert one.surface == tw.EvenAsphere(radius=50.0, conic=-1.0, terms={4: 1e-6})
    assert two.surface == tw.Conic(radius=30.0, conic=-1.0)


@pytest.mark.parametrize(
    "command",
    ["REV S1..2 3", "ASP Z2", "GLA S1..2 NBK7 SF5", "RDY Z2 70", "RDY S1..2 WXY 70", "TWIST SA 2", "ZOO K S1..2 0 -1",
     "ZOO GLA S2 SF5 SF6", "CIR S1..2 L'a' 9; CIR S1..2 L'b' 4", "RET S1..2 S7"],
)  # fmt: skip
def test_a_command_that_is_not_read_refuses_what_it_names(tmp_path, command):
    with pytest.raises(tw.InputError):
        seq(tmp_path, *QUALIFIED, "STO S1..2", command, "S 0 1").surface(2).surface  # noqa: B018


@pytest.mark.parametrize(
    ("command", "named"),
    [
        ("SCA 2", "SCA"), ("FLY S1..2", "FLY"), ("K S1..7 1", "S1..7"), ("K S2..1 1", "S2..1"), ("K S'none' 1", "none"),
        ("K SI 1", "SI"), ("K S1+1 1", "S1"), ("S7 1 2", "S7"), ("PRV", "PRV"), ("S 50 5 NBK7 &", "cut short"),
    ],
)  # fmt: skip
def test_a_command_on_no_certain_surface_refuses_the_file(tmp_path, command, named):
    path = tmp_path / "lens.seq"
    path.write_text("\n".join(["RDM Y", "SO 0 1e13", *QUALIFIED, command]))
    with pytest.raises(tw.InputError, match=named):
        read_lens(path)


@pytest.mark.parametrize(
    ("lines", "aperture"),
    [
        (["DIAM 9", "OBSC 0 1 0", "OBDC 5 2"], None),
        (["DIAM 9", "SQOB 1 1", "OBDC 5 2"], None),
        (["DIAM 9", "OBDC 5 2"], None),
        (["DIAM 9", "CLAP 0 4", "OBDC 5 2"], tw.Outline(disc=4.0, centre=(5.0, 2.0))),
        (["DIAM 9", "CLAP 0 4", "OBSC 0 1", "OBDC 5 2"], "OBSC"),
        (["DIAM 9", "CLAP 0 4", "SQAP 3 2"], "SQAP"),
        (["DIAM 9", "CLAP 0 4", "CLAP 0 5"], "CLAP"),
    ],
)
def test_a_decentre_moves_only_a_clear_aperture(tmp_path, lines, aperture):
    one = zmx(tmp_path, ["TYPE STANDARD", "CURV 0.01", "DISZ 1", *lines]).surface(1)
    if isinstance(aperture, str):
        assert aperture in one.fault
    else:
        assert (one.fault, one.aperture, one.semi_diameter) == ("", aperture, 4.0 if aperture else 9.0)


ENDS_AT_6 = block("FZERNSAG", {0: 0.0}, ZERNIKE_DATA)
OFF_THE_AXIS = block("SZERNSAG", {0: 0.0, 10: 2.0}, ZERNIKE_DATA)


@pytest.mark.parametrize(
    ("lines", "radius", "is_inside"),
    [
        (ENDS_AT_6, None, True), (ENDS_AT_6, 6.0, True), (ENDS_AT_6, 6.1, False), (ENDS_AT_6, 9.0, False),
        ([*ENDS_AT_6, "CLAP 0 9 0"], None, False), ([*ENDS_AT_6, "SQAP 5 5"], None, False),
        ([*ENDS_AT_6, "CLAP 0 4", "OBDC 3 0"], None, False), ([*ENDS_AT_6, "CLAP 0 9 0"], 5.0, True),
        (block("FZERNSAG", {0: 1.0}, ZERNIKE_DATA), 9.0, True),
        (OFF_THE_AXIS, 4.0, True), (OFF_THE_AXIS, 4.1, False),
        (block("GRID_SAG", {0: 0.0}, ZERNIKE_DATA)[:-1] + grid_block()[0][11:], 6.1, False),
        (block("TOROIDAL", {0: 0.0, 1: -55.0}, ZERNIKE_DATA), 6.1, False),
    ],
)  # fmt: skip
def test_zernike_terms_end_at_their_radius_unless_they_go_on(tmp_path, lines, radius, is_inside):
    lens = zmx(tmp_path, lines)
    if is_inside:
        assert lens.part(1, "+z", radius=radius).radius is not None
    else:
        with pytest.raises(tw.InputError, match="Zernike terms that end"):
            lens.part(1, "+z", radius=radius)


def test_fringe_zernike_terms_are_37(tmp_path):
    extra = {1: 37, 2: 6.0} | {place + 2: 1e-4 for place in range(1, 38)}
    assert not zmx(tmp_path, block("FZERNSAG", {0: 1.0}, extra)).surface(1).fault
    assert "37" in zmx(tmp_path, block("FZERNSAG", {0: 1.0}, extra | {1: 45, 47: 1e-4})).surface(1).fault


@pytest.mark.parametrize("kind", ["XASPHERE", "XPOLYNOM", "SZERNSAG", "BINARY_2"])
def test_no_terms_need_no_normalisation_radius(tmp_path, kind):
    assert zmx(tmp_path, block(kind, extra={1: 0, 2: 6.0, 3: 9.0})).surface(1).surface == tw.Conic(radius=R, conic=K)


@pytest.mark.parametrize(
    "operand",
    ["CRVT 1 1 0.02", "APMX 1 1 4", "APDX 1 1 4", "CBDX 1 1 4", "CBTX 1 1 4", "GRDF 1 1 4", "PRXD 1 1 4", "SATP 1 1 0",
     "NEWW 1 1 4", "  CRVT 1 1 0.02"],
)  # fmt: skip
@pytest.mark.parametrize("lead", ["", "    "])
def test_an_operand_of_configurations_refuses_its_surface(tmp_path, operand, lead):
    path = write_zmx(tmp_path / "lens.zmx", sphere(50.0, 3.0, ""), sphere(50.0, 3.0, ""))
    path.write_text(path.read_text() + f"EFFL 1 2\n{lead}MNUM 2 1\nMOFF 1 1\nWAVE 1 1 0.5\nTHIC 2 1 3\n{operand}\n")
    lens = read_lens(path)
    assert "differs between the 2 configurations" in lens.surface(1).fault
    assert not any(one.fault for one in lens.surfaces[2:])


def test_an_unknown_word_that_is_not_indented_is_refused(tmp_path):
    path = write_zmx(tmp_path / "lens.zmx", [*block("STANDARD"), "TWST 1"], block("STANDARD"))
    path.write_text("\n".join(line.strip() for line in path.read_text().splitlines()) + "\nTOL TOFF 0 0\n")
    lens = read_lens(path)
    assert "'TWST'" in lens.surface(1).fault
    assert not any(lens.surface(number).fault for number in (0, 2, 3))


def test_light_through_flat_mirrors_goes_where_scipy_says(tmp_path):
    """Oracle: rotations of SciPy and the law of reflection."""
    rng = np.random.default_rng(0)
    certain = 0
    for _ in range(40):
        surfaces, frame, ray, cosines = [DUMMY], Rotation.identity(), np.array([0.0, 0.0, 1.0]), {}
        for _ in range(6):
            if rng.random() < 0.6:
                x, y, z = rng.uniform(-180, 180, 3)
                order = int(rng.integers(2))
                surfaces.append([*coordinate_break(x, y), f"PARM 5 {z}", f"PARM 6 {order}"])
                frame *= Rotation.from_euler(*(("ZYX", (z, y, x)) if order else ("XYZ", (x, y, z))), degrees=True)
            else:
                surfaces.append(FOLD)
                normal = frame.as_matrix()[:, 2]
                cosines[len(surfaces)] = ray @ normal
                ray = ray - 2 * (ray @ normal) * normal
        lens = zmx(tmp_path, *surfaces)
        for number, cosine in cosines.items():
            assert lens.surface(number).heading == (np.sign(cosine) if abs(cosine) >= 0.1 else 0)
            certain += abs(cosine) >= 0.1
    assert certain > 50


def test_a_glass_has_its_side_by_its_thickness(tmp_path):
    lens = zmx(tmp_path, LENS, [*sphere(-50.0, 20.0, ""), "TWST 1"], LENS, sphere(-50.0, 20.0, ""), MIRROR)
    assert [(lens.side(number).side, lens.side(number).toward) for number in (3, 4)] == [("after", 1), ("before", -1)]
    with pytest.raises(tw.InputError, match="not certain"):
        lens.side(5)


@pytest.mark.parametrize(
    "commands",
    [
        ["S 0 20 NBK7", "S 0 -2 REFL; ADE 45; DAR", "S 0 -20 REFL; YDE -20; ADE -45; DAR", "S 0 -10"],
        ["S 0 20 NBK7", "S 0 -2 REFL; ADE 45; DAR", "S 0 -10"],
        ["S 0 20 NBK7", "S -90 -20 REFL; ADE 10; BDE -60", "S 0 -10 REFL; ADE -45; BDE 60; BEN"],
    ],
)
def test_a_thickness_across_the_light_tells_no_side(tmp_path, commands):
    lens = seq(tmp_path, *commands)
    with pytest.raises(tw.InputError, match="not certain"):
        lens.side(3)


@pytest.mark.parametrize("line", ["CURV 0.1", "CONI 1", "DIAM 4", "TYPE EVENASPH", "GLAS MIRROR", "DISZ 9", "SQAP 1 2"])
def test_a_word_that_stands_twice_is_refused(tmp_path, line):
    lines = [*block("STANDARD"), "SQAP 2 2", line]
    assert f"{line[:4]} is stated twice" in zmx(tmp_path, lines).surface(1).fault


def test_mirrors_are_known_in_either_case_and_program(tmp_path):
    assert zmx(tmp_path, sphere(-50.0, -5.0, "Mirror")).surface(1).is_mirror
    lens = seq(tmp_path, "S -50 -5 MIRROR", "S 50 5; RMD REFL; GLA NBK7", "S 50 5 REFL; RMD REFR")
    assert lens.surface(1).is_mirror
    assert "reflect" in lens.surface(2).fault
    assert "reflect" in lens.surface(3).fault


def test_a_qualifier_may_follow_another_word(tmp_path):
    lens = seq(tmp_path, *QUALIFIED, "CIR EDG S1 4")
    assert [one.semi_diameter for one in lens.surfaces[1:3]] == [4.0, None]
    for command in ("ZOO CIR EDG S1 3 4", "ZOO CIR L'a' S1 5 6", "ZOO THI S1 4 -4"):
        lens = seq(tmp_path, *QUALIFIED, command)
        assert [bool(one.fault) for one in lens.surfaces[1:3]] == [True, False]
    assert not seq(tmp_path, *QUALIFIED, "ZOO THI S1 4 3").surface(1).fault


def test_two_names_of_one_coefficient_must_agree(tmp_path):
    lens = seq(tmp_path, "S 50 5 NBK7", "SPS ODD; SCO AR3 1e-3; SCO C4 2e-3")
    assert "'C4' has another value" in lens.surface(1).fault


def test_an_unknown_word_below_the_last_surface_is_refused(tmp_path):
    path = write_zmx(tmp_path / "lens.zmx", block("STANDARD"))
    text = path.read_text()
    path.write_text("\n".join(line.strip() for line in text.splitlines()) + "\nTWST 1\n")
    assert "'TWST'" in read_lens(path).surface(2).fault
    path.write_text(text + "EFFL 1\n")
    assert "'EFFL'" not in read_lens(path).surface(2).fault


def test_a_thickness_that_changes_its_sign_is_refused(tmp_path):
    path = write_zmx(tmp_path / "lens.zmx", sphere(50.0, 3.0, "N-BK7"), sphere(50.0, 3.0, ""))
    path.write_text(path.read_text() + "MNUM 2 1\nTHIC 1 1 3 0\nTHIC 1 2 -3 0\n")
    assert [bool(one.fault) for one in read_lens(path).surfaces] == [False, True, False, False]


PARABOLA = ["TYPE STANDARD", "CURV -0.005", "CONI -1", "GLAS MIRROR"]


@pytest.mark.parametrize(
    "surfaces",
    [
        [
            sphere(0, 100.0, ""),
            coordinate_break(shift=346.41),
            [*PARABOLA, "DISZ 0"],
            coordinate_break(60, thickness=50),
        ],
        [["TYPE STANDARD", "CURV -0.5", "CONI -1", "GLAS MIRROR", "DISZ 200", "CLAP 60 70"]],
        [[*PARABOLA, "DISZ 200"]],
        [[*PARABOLA, "DISZ -100", "CLAP 0 20", "OBDC 0 346"]],
        [[*PARABOLA, "DISZ -100", "CLAP 340 350"]],
    ],
)
def test_a_steep_mirror_may_not_turn_the_light_back(tmp_path, surfaces):
    """Where the slope is above 1, the ray goes on to the same side: 2 slope angles from where it came."""
    with pytest.raises(tw.InputError, match="not certain"):
        zmx(tmp_path, *surfaces, MIRROR).side(len(surfaces) + 1)


@pytest.mark.parametrize("aperture", ["DIAM 180", "CLAP 20 150", "SQAP 150 150"])
def test_a_mirror_below_45_degrees_turns_the_light_back(tmp_path, aperture):
    assert zmx(tmp_path, [*PARABOLA, "DISZ -100", aperture], MIRROR).side(2).toward == -1


def test_words_of_output_change_no_surface(tmp_path):
    lens = seq(tmp_path, "CA YES; UID 'a'", "S 50 5 NBK7; IC YES", "S 50 5", "S -90 -50 REFL", "SUR SA; LIS SA")
    assert lens.side(3).toward == 1
    assert not any(one.fault for one in lens.surfaces)


def test_a_small_table_of_heights_is_named(tmp_path):
    assert "GRID_SAG" in zmx(tmp_path, grid_block(columns=5)[0]).surface(1).fault
    assert not zmx(tmp_path, grid_block(columns=6, rows=6)[0]).surface(1).fault
