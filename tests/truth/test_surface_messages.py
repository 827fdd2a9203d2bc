"""Bad compound and numeric prescriptions are refused in one sentence that names the fault."""

import numpy as np
import pytest

from turnwright.errors import InputError
from turnwright.part import Part
from turnwright.surface import Expression, Gridded, LensArray, OffAxis, Placed, Plane, SineGrid, Sphere, Sum

COSTLY = Expression("+".join(["sin(x)"] * 450))

FLAT = Plane()
AXIS = np.linspace(-1, 1, 7)
HOLE = np.zeros((7, 7))
HOLE[3, 4] = np.nan


def square(**changes):
    return LensArray.square(**{"pitch": 1.0, "lenslet": FLAT, "rows": 2, "columns": 2, **changes})


BAD = {
    "empty sum": (lambda: Sum(terms=()), "0 terms"),
    "sum of numbers": (lambda: Sum(terms=(FLAT, 3.0)), "a term of a sum is 3.0, it must be a Surface"),
    "shift of two": (lambda: FLAT.placed(shift=(1.0, 2.0)), "3 finite numbers"),
    "shift nan": (lambda: FLAT.placed(shift=(1.0, 2.0, np.nan)), "shift holds nan, .* finite"),
    "rotation inf": (lambda: FLAT.placed(rotation=np.inf), "rotation is inf"),
    "upside down": (lambda: Placed(surface=FLAT, tilt=(np.pi, 0.0)), "by 180 deg, the limit is 89.9 deg"),
    "on edge": (lambda: Placed(surface=FLAT, tilt=(0.0, np.pi / 2)), "by 90 deg"),
    "amplitude of one": (lambda: SineGrid(amplitude=0.1, period=(1, 1)), "amplitude of a sine grid is 0.1"),
    "period zero": (lambda: SineGrid(amplitude=(1, 1), period=(1, 0)), "period of a sine grid along y is 0 mm"),
    "phase nan": (lambda: SineGrid(amplitude=(1, 1), period=(1, 1), phase=(0, np.nan)), "phase holds nan, .* finite"),
    "no centre": (lambda: LensArray(centres=np.empty((0, 2)), lenslet=FLAT), r"shape \(0, 2\)"),
    "centres in space": (lambda: LensArray(centres=np.zeros((2, 3)), lenslet=FLAT), r"shape \(2, 3\)"),
    "centre nan": (lambda: LensArray(centres=[[0, np.nan]], lenslet=FLAT), "centres holds nan, .* finite"),
    "twice the same": (lambda: LensArray(centres=[[1, 2], [0, 0], [1, 2]], lenslet=FLAT), r"\(1, 2\) mm.*remove one"),
    "no lenslet": (lambda: square(lenslet=1.0), "the lenslet is 1.0"),
    "aperture alone": (lambda: square(aperture=0.4), "aperture is 0.4 and surround is None"),
    "surround alone": (lambda: square(surround=0.0), "aperture is None and surround is 0.0"),
    "apertures overlap": (lambda: square(aperture=0.6, surround=0.0), "0.6 mm, the limit is half .* 0.5 mm"),
    "aperture negative": (lambda: square(aperture=-0.1, surround=0.0), "aperture of a lenslet is -0.1 mm"),
    "pitch zero": (lambda: square(pitch=0.0), "pitch of a lens array is 0 mm"),
    "no rows": (lambda: square(rows=0), "rows of a lens array is 0"),
    "rows and within": (lambda: square(within=3.0), "rows and columns, or within alone"),
    "rows only": (lambda: square(columns=None), "columns None"),
    "within too small": (lambda: square(rows=None, columns=None, within=0.4), "no lens of radius 0.5 mm"),
    "within negative": (lambda: square(rows=None, columns=None, within=-4.0), "is -4 mm"),
    "far too many": (lambda: square(rows=None, columns=None, within=1e6), "the limit is 1000000 lenses"),
    "offset of one": (lambda: square(offset=(1.0,)), r"offset of a lens array is \(1.0,\)"),
    "rings and within": (
        lambda: LensArray.hexagonal(pitch=1.0, lenslet=FLAT, rings=1, within=2.0),
        "only one of them is allowed",
    ),
    "rings negative": (lambda: LensArray.hexagonal(pitch=1.0, lenslet=FLAT, rings=-1), "rings of a lens array is -1"),
    "table with a hole": (
        lambda: Part(surface=Gridded(x=AXIS, y=AXIS, z=HOLE), radius=0.9 * AXIS[-1]),
        "has no height at 1 points",
    ),
    "table of infinities": (
        lambda: Gridded(x=AXIS, y=AXIS, z=np.full(HOLE.shape, np.inf)),
        "49 infinite values",
    ),
    "table without a cell": (lambda: Gridded(x=AXIS, y=AXIS, z=np.full(HOLE.shape, np.nan)), "no cell with heights"),
    "table too small": (lambda: Gridded(x=AXIS[:5], y=AXIS, z=HOLE[:, :5]), "has 5 points, it needs 6"),
    "table unsorted": (lambda: Gridded(x=AXIS, y=AXIS[::-1], z=HOLE), "y of a gridded surface does not ascend"),
    "table turned": (lambda: Gridded(x=AXIS, y=AXIS, z=np.zeros((7, 8))), r"\(7, 8\).* axes need \(7, 7\)"),
    "aperture beyond the table": (
        lambda: Part(surface=Gridded(x=AXIS, y=AXIS, z=np.zeros((7, 7))), radius=1.5),
        "clear aperture is 1.5 mm",
    ),
    "empty formula": (lambda: Expression("  "), "0 characters"),
    "endless formula": (lambda: Expression("x+" * 6000 + "x"), "12001 characters"),
    "half a formula": (lambda: Expression("x +"), "cannot be parsed"),
    "left-out product": (lambda: Expression("2x"), "every product with"),
    "number run into a word": (lambda: Expression("1or x"), "formula '1or x'"),
    "decimal comma": (lambda: Expression("0,5*x"), "decimals with a point"),
    "hat for power": (lambda: Expression("x^2"), r"write \*\* for a power"),
    "unknown name": (lambda: Expression("x + z"), "the name 'z', which is unknown"),
    "unknown function": (lambda: Expression("gamma(x)"), r"'gamma\(x\)'"),
    "not smooth": (lambda: Expression("abs(x)"), r"abs\(\), which is not smooth"),
    "not smooth either": (lambda: Expression("max(x, 0)"), r"max\(\), which is not smooth"),
    "wrong arguments": (lambda: Expression("sin(x, y)"), "give sin 1"),
    "too few arguments": (lambda: Expression("atan2(y)"), "give atan2 2"),
    "condition": (lambda: Expression("x if y > 0 else 0"), "use "),
    "modulo": (lambda: Expression("x % 2"), "use "),
    "complex": (lambda: Expression("x + 2j"), "'2j'"),
    "text": (lambda: Expression("'x'"), "use "),
    "truth": (lambda: Expression("True"), "'True'"),
    "beyond floats": (lambda: Expression("1e999*x"), "a number of a formula is"),
    "beyond floats, whole": (lambda: Expression("1" + "0" * 400 + "*x"), "a number of a formula is"),
    "nested too deep": (lambda: Expression("(1 - " * 60 + "x" + ")" * 60), "nested too deep"),
    "too many terms": (
        lambda: Expression("+".join(["x"] * 3000)),
        "has 2999 signs .* the limit is 2000",
    ),
    "too costly": (lambda: Expression("+".join(["sin(x)"] * 1000)), "costs 8999 additions .* the limit is 4500"),
    "a sum too costly": (
        lambda: sum([Sphere(radius=20.0).placed(tilt=(0.01 * k, 0.0)) for k in range(1, 41)], Plane(slope=(0.0, 0.0))),
        "a sum of 24 surfaces costs 4620 additions .* the limit is 4500",
    ),
    "a sum of costly lenslets": (
        lambda: sum([LensArray.square(pitch=1.0, lenslet=COSTLY, within=3.0)] * 2, Plane(slope=(0.0, 0.0))),
        "a sum of . surfaces costs .* the limit is 4500",
    ),
    "a sum of costly off-axis parts": (
        lambda: Plane(slope=(0.0, 0.0)) + OffAxis(parent=COSTLY, distance=1.0),
        "a sum of . surfaces costs .* the limit is 4500",
    ),
    "too much in divisors": (
        lambda: Expression("".join(f"1/(x+{'y+' * 95}{k}+" for k in range(20)) + "x" + ")" * 20),
        "exp and divisors with .* steps, the limit is 20000",
    ),
    "pole in a disc": (
        lambda: Expression("0.001/(x - 0.3)").require_disc(5.0, "it"),
        r"divides by 0 at x = 0.3 mm, y = 0",
    ),
    "pole on a line": (lambda: Expression("1/x").require_disc(5.0, "it"), r"divides by 0 at x = 0 mm, y = 0.078"),
    "pole on the axis": (lambda: Expression("1/rho").require_disc(5.0, "it"), r"divides by 0 at x = 0 mm, y = 0 mm"),
    "double pole": (lambda: Expression("1/(rho - 1.23)**2").require_disc(5.0, "it"), "divides by 0 at x = 1.2"),
    "pole of a power": (
        lambda: Expression("(y - 2.2)**-1").require_disc(5.0, "it"),
        "divides by 0 at x = 0 mm, y = 2.2",
    ),
    "pole of a tangent": (lambda: Expression("tan(x)").require_disc(5.0, "it"), "divides by 0 at x = [14]"),
    "pole in a sum": (lambda: (Expression("x") + Expression("1/x")).require_disc(5.0, "it"), "divides by 0 at x = 0"),
    "pole of a shifted formula": (
        lambda: Part(surface=Expression("0.001/(x - 0.3)").placed(shift=(1, 2, 0), rotation=np.pi / 2), radius=5.0),
        r"5 mm but Placed divides by 0 at x = \S+ mm, y = 2.3 mm",
    ),
    "pole in a shifted sum": (
        lambda: Part(surface=(FLAT + Expression("0.001/(x - 0.3)")).placed(shift=(1, 0, 0)), radius=5.0),
        "Placed divides by 0 at x = 1.3 mm",
    ),
    "pole of a lenslet": (
        lambda: Part(surface=square(lenslet=Expression("0.001/(x - 0.31)"), rows=3, columns=3), radius=1.2),
        r"LensArray divides by 0 at x = (-0\.69|0\.31) mm",
    ),
    "pole between lenslets": (
        lambda: Part(surface=square(aperture=0.4, surround=Expression("0.001/(x - 0.47)")), radius=1.2),
        "LensArray divides by 0 at x = 0.47 mm",
    ),
    "two lenses on a place": (
        lambda: LensArray(centres=[[0, 0], [1, 1], [2, 2], [1, 1]], lenslet=Sphere(radius=5.0)),
        r"lenses 2 and 4, counted from 1, .*at \(1, 1\) mm",
    ),
    "four lenses on a place": (
        lambda: LensArray(centres=[[1, 1]] * 4, lenslet=Sphere(radius=5.0)),
        "lenses 1 and 2, counted from 1,",
    ),
    "signs too deep": (lambda: Expression("-" * 3000 + "x"), "nested too deep"),
    "brackets beyond the parser": (lambda: Expression("(" * 3000 + "x" + ")" * 3000), "cannot be parsed|too deep"),
    "step at the cut": (lambda: Expression("x*sin(phi/2)"), "has a step of .* where phi jumps"),
    "kink at the cut": (lambda: Expression("rho*phi**2"), "has a step of .* where phi jumps"),
    "constant in the way": (lambda: Expression("rho", constants={"rho": 1.0}), "constant 'rho'"),
    "constant without a name": (lambda: Expression("x", constants={"a b": 1.0}), "constant 'a b'"),
    "constant nan": (lambda: Expression("a*x", constants={"a": np.nan}), "constants.*a.* is nan"),
    "feature size zero": (lambda: Expression("x", feature_size=0.0), "feature_size of an expression is 0 mm"),
    "height on the axis": (lambda: Expression("cos(3*phi)").sag(0.0, 0.0), "except on the axis"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_sentence(case):
    build, message = BAD[case]
    with pytest.raises(InputError, match=message) as caught:
        build()
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 400
    assert ": " in text  # what is wrong, then the remedy


@pytest.mark.parametrize(
    "formula",
    [
        "__import__('os').getcwd()",
        "x.__class__",
        "(lambda: x)()",
        "[x for x in (1, 2)]",
        "sin.__call__(x)",
        "x[0]",
        "exec('x')",
        "f'{x}'",
        "(y := x)",
        "sin(*[x])",
        "sin(x=1)",
        "open",
        "9**9**9**9 and x",
        "x < y",
        "not x",
        "x @ y",
        "x // y",
        "...",
        "x; y",
        "x = 1",
    ],
)
def test_a_formula_cannot_be_a_program(formula):
    with pytest.raises(InputError, match="formula"):
        Expression(formula)


@pytest.mark.parametrize("formula", ["sin(rho)/rho", "cos(3*phi)", "x/(x - 5.1)", "x/(1 + rho**2)", "rho*x/rho"])
def test_what_divides_without_a_pole_in_the_disc_is_allowed(formula):
    Expression(formula).require_disc(5.0, "it")


@pytest.mark.parametrize(
    "surface",
    [
        Expression("0.001/(x - 7)").placed(shift=(-1.0, 0.0, 0.0)),
        square(lenslet=Expression("0.001/(x - 0.6)"), rows=30, columns=30),
        square(lenslet=Expression("0.001/(x - 0.45)"), aperture=0.4, surround=0.0),
        square(lenslet=FLAT, rows=1, columns=1, aperture=0.4, surround=Expression("0.001/rho")),
    ],
    ids=["beside the disc", "in the cell of the neighbour", "between round lenslets", "under a lens"],
)
def test_a_pole_that_a_compound_surface_does_not_show_is_allowed(surface):
    Part(surface=surface, radius=5.0)


def test_a_tower_of_powers_costs_nothing():
    assert not Expression("9**9**9**9**9 * x").inside(np.ones(1), np.ones(1)).any()
