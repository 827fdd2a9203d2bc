"""Formulas against SymPy and mpmath, and on the axis against the same surface written without rho and phi."""

import contextlib
import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from surface_oracle import X, Y, computed, disc, error
from turnwright.errors import DomainError, InputError
from turnwright.surface import Expression, expression

RHO, PHI = sp.sqrt(X**2 + Y**2), sp.atan2(Y, X)
NAMES = {"x": X, "y": Y, "rho": RHO, "phi": PHI, "pi": sp.pi, "e": sp.E, "hypot": lambda a, b: sp.sqrt(a**2 + b**2)}

SMOOTH = [
    "1.5*x - y/3 + 0.25",
    "x**3*y**2/100 - (x - 2*y)**4/3000",
    "sin(2*x)*cos(y/2) + tan(x/10)",
    "asin(x/9) + acos(y/8) - atan(x*y/5)",
    "atan2(y + 8, x - 7)",
    "sinh(x/4)*cosh(y/3) - tanh(x - y)",
    "exp(-(x**2 + y**2)/8) + log(20 + x*y/3)",
    "sqrt(30 + x - y)*hypot(x + 7, 2*y - 12)",
    "2**(x/4) + (y + 9)**1.5 + (x + 9)**(y/9)",
    "(1 + x)/(7 - y) + x/(9 + y*x/4) + e*pi/(x + 11)",
    "-+-x**2 + 2**-x**2 - 3e-2*y",
    "0.1*rho**4*cos(3*phi) + sin(rho**2/4)",
    "rho**2/(10*(1 + sqrt(1 - rho**2/100)))",
    "(rho/5)**6*cos(6*phi + 0.3) + x*rho**3",
]


@pytest.mark.parametrize("formula", SMOOTH)
def test_value_and_derivatives_by_mpmath(formula):
    x, y = disc(5.0, count=30)
    x[:4], y[:4] = 0.3, 0.2  # the axis is looked at below
    assert (error(Expression(formula), sp.sympify(formula, NAMES), x, y) < [1e-14, 1e-13, 1e-12]).all()


@pytest.mark.parametrize("formula", ["0.2358*cos(3*phi)", "rho", "rho**2*cos(3*phi)", "phi - atan2(y, x) + exp(-rho)"])
def test_off_the_axis_what_is_not_smooth_on_it_by_sympy(formula):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0.1, 5, (2, 30)) * rng.choice([-1, 1], (2, 30))
    assert (error(Expression(formula), sp.sympify(formula, NAMES), x, y) < 1e-13).all()


@pytest.mark.parametrize(
    ("polar", "cartesian"),
    [
        ("rho**2", "x**2 + y**2"),
        ("3 + rho*cos(phi) - 2*rho*sin(phi)", "3 + x - 2*y"),
        ("rho**2*sin(2*phi)", "2*x*y"),
        ("rho**3*cos(3*phi)", "x**3 - 3*x*y**2"),
        ("rho**2/(10*(1 + sqrt(1 - rho**2/100)))", "(x**2 + y**2)/(10*(1 + sqrt(1 - (x**2 + y**2)/100)))"),
        ("cos(rho)", "1 - (x**2 + y**2)/2 + (x**2 + y**2)**2/24"),
        ("hypot(x, y)**2*cos(2*atan2(y, x))", "x**2 - y**2"),
        ("x*y*rho + rho**4*exp(rho)", "0*x"),
        ("x*exp(y)*cosh(rho)", "x + x*y"),
    ],
)
def test_limits_on_the_axis_are_those_of_the_cartesian_formula(polar, cartesian):
    x, y = np.array([0.0, -0.0, 1e-13, -5e-13]), np.array([0.0, 0.0, -1e-13, 0.0])
    found, truth = computed(Expression(polar), x, y), computed(Expression(cartesian), x, y)
    # A point a millionth of a nanometre off the axis is on it: its height and slope may differ by that much.
    np.testing.assert_allclose(found[:3], truth[:3], atol=3e-12)
    np.testing.assert_allclose(found[3:], truth[3:], atol=1e-11)
    np.testing.assert_allclose(found[:, 0], truth[:, 0], atol=4e-15)


@pytest.mark.parametrize(
    ("formula", "defined"),
    [("0.2358*cos(3*phi)", 0), ("1/rho", 0), ("rho", 1), ("x + 2*rho", 1), ("rho*cos(3*phi)", 1), ("rho**1.5", 2)],
)
def test_without_a_limit_the_axis_is_named(formula, defined):
    surface = Expression(formula)
    for order, method in enumerate((surface.sag, surface.gradient, surface.hessian)):
        if order < defined:
            assert np.isfinite(method(0.0, 0.0)).all()
        else:
            with pytest.raises(DomainError, match="axis"):
                method([1.0, 0.0], [1.0, 0.0])
    assert np.isfinite(computed(surface, 1.0, 1.0)).all()


def test_a_radial_wave_has_no_curvature_on_the_axis():
    surface = Expression("rho**2*cos(3*phi)")
    assert surface.gradient(0.0, 0.0) == (0.0, 0.0)
    with pytest.raises(DomainError, match="no curvature"):
        surface.hessian(0.0, 0.0)


def test_a_cone_is_two_pieces_on_every_line_through_its_tip():
    cone = Expression("-rho/10")
    angle = np.linspace(0, np.pi, 37)[:, None]
    along = np.array([-2.0, -1e-9, 1e-9, 2.0])
    piece = cone.piece(along * np.cos(angle), along * np.sin(angle))
    assert (piece[:, 0] == piece[:, 1]).all()
    assert (piece[:, 2] == piece[:, 3]).all()
    assert (piece[:, 1] != piece[:, 2]).all()
    assert Expression("rho**2").piece(along, along) is None


def test_the_domain_is_where_the_value_is_finite():
    bowl = Expression("sqrt(25 - rho**2)")
    np.testing.assert_array_equal(bowl.inside(np.array([0.0, 4.9, 5.1]), np.zeros(3)), [True, True, False])
    with pytest.raises(DomainError, match=r"not defined at x = 5\.1 mm"):
        bowl.sag([0.0, 5.1], 0.0)
    with pytest.raises(DomainError, match="no slope"):
        bowl.gradient(5.0, 0.0)
    with pytest.raises(DomainError, match="no curvature"):
        Expression("(x**2)**0.75").hessian(0.0, 1.0)


def test_a_pole_is_outside_the_domain_without_a_warning():
    ring = Expression("cos(phi)*rho/(rho - 25)")
    assert not ring.inside(np.array([-25.0]), np.zeros(1)).any()
    assert float(ring.sag(-24.0, 0.0)) == 24.0


def test_constants_are_numbers_by_name():
    formula = "rho**2/(R*(1 + sqrt(1 - (1 + k)*rho**2/R**2)))"
    x, y = disc(15.0)
    plain = Expression(formula.replace("R", "61.5").replace("k", "(-1.5)"))
    np.testing.assert_array_equal(
        computed(Expression(formula, constants={"R": 61.5, "k": -1.5}), x, y), computed(plain, x, y)
    )


def test_a_long_sum_is_as_good_as_a_short_one():
    x, y = disc(2.0)
    np.testing.assert_allclose(Expression("+".join(["x*y"] * 850)).sag(x, y), 850 * x * y, rtol=1e-12, atol=1e-300)


def test_line_ends_and_spaces_do_not_matter():
    assert float(Expression("\n   x**2\n   + 1\n").sag(2.0, 0.0)) == 5.0


def test_blocks_join_seamlessly():
    x = np.linspace(-3, 3, 20_001).reshape(3, -1)
    surface = Expression("x**2*sin(y) + rho")
    z = surface.sag(x, 0.5)
    assert z.shape == x.shape
    np.testing.assert_allclose(z, x**2 * np.sin(0.5) + np.hypot(x, 0.5), rtol=1e-14)


@pytest.mark.parametrize(
    ("formula", "size"),
    [
        ("0.001*sin(2*pi*x/0.4) + rho**2/50", 0.05),
        ("cos(2*pi*(x + y)/0.4)", 0.05 / np.sqrt(2)),
        ("0.1*sin(2*pi*rho/2)", 0.25),
        ("rho**2/50 - x**4/1e6", np.inf),
        ("0.2358*cos(3*phi)", np.inf),  # along a ray it does not change at all
    ],
)
def test_the_feature_size_of_a_wave_is_an_eighth_of_it(formula, size):
    assert Expression(formula).feature_size == pytest.approx(size, rel=1e-6)


def test_the_feature_size_of_a_bump_is_near_its_width():
    for formula in ("exp(-(x/0.5)**2)", "1/(1 + (x/0.5)**2)", "tanh(x/0.5)"):
        assert 0.05 < Expression(formula).feature_size < 0.5
    assert Expression("exp(-(x/0.5)**2)", feature_size=0.125).feature_size == 0.125


@pytest.mark.parametrize("width", [0.02, 0.3])
@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.01, 0.0), (3.0, 1.0), (10.0, 5.0), (-17.0, 3.3)])
def test_feature_size_of_a_bump_is_independent_of_position(x, y, width):
    """exp(-r²/w²) has the fourth derivative 12/w^4 and the second -2/w² at its crest, as a wave of k² = 6/w²."""
    formula = f"0.001*exp(-((x-{x})**2 + (y+{-y})**2)/{width}**2) + rho**2/100"
    assert Expression(formula).feature_size == pytest.approx(np.pi / 4 * width / np.sqrt(6), rel=1e-3)


def test_it_travels_between_processes():
    """A job may run in another process: what crosses over must be the same formula."""
    here, there = multiprocessing.Pipe()
    surface = Expression("a*rho**2", constants={"a": 0.1})
    here.send(surface)
    again = there.recv()
    assert again == surface
    assert float(again.sag(1.0, 1.0)) == pytest.approx(0.2)


def test_equal_crests_are_searched_once():
    """Oracle: the feature size of a single term; so many terms took 4 s."""
    one, many = (Expression("+".join(["exp(-(x-1)**2)"] * count)) for count in (1, 300))
    assert many.feature_size == one.feature_size


@pytest.mark.parametrize("name", ["hypot", "atan2"])
def test_a_long_sum_of_pairs_is_read(name):
    """It was walked by a function that calls itself. Oracle: NumPy."""
    x, y = disc(1.0)
    formula = "+".join([f"{name}(x+1.5,2)"] * 230) + f"+{name}(" + "+".join(["x"] * 300) + ",7)"
    oracle = getattr(np, {"hypot": "hypot", "atan2": "arctan2"}[name])
    np.testing.assert_allclose(Expression(formula).sag(x, y), 230 * oracle(x + 1.5, 2) + oracle(300 * x, 7), rtol=1e-12)


@pytest.mark.parametrize("formula", ["8196*exp((rho*x)**sqrt(phi))", "exp(0*x)", "exp(x**9)"])
def test_the_search_for_a_crest_ends(formula, monkeypatch):
    """Oracle: a count of the evaluations; the first formula climbed along the rim for minutes."""
    count = 0
    run = expression._run

    def counted(*args, **kwargs):
        nonlocal count
        count += 1
        return run(*args, **kwargs)

    monkeypatch.setattr(expression, "_run", counted)
    with contextlib.suppress(InputError):
        Expression(formula)
    assert count < 2000


def test_another_formula_has_a_feature_size_of_its_own():

    slow = Expression("0.001*sin(x)")
    fast = replace(slow, formula="0.001*sin(100*x)")
    assert fast.feature_size == Expression("0.001*sin(100*x)").feature_size < slow.feature_size / 50
    assert replace(Expression("x", feature_size=0.2), formula="sin(100*x)").feature_size == 0.2


def test_equal_formulas_are_one_key_and_surfaces_are_summed():
    one, same = (Expression("a*x", constants={"a": 0.1}) for _ in range(2))
    assert one == same
    assert {one: 1}[same] == 1
    assert sum([one, same]).sag(2.0, 0.0) == pytest.approx(0.4)
