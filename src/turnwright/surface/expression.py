"""A surface given by a formula, read safely and differentiated exactly."""

# ruff: noqa: ARG001, ARG005 - the rules of differentiation have one shape, whether they use all of it or not

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import KW_ONLY, dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, NoReturn, TypeAlias

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._validate import check_numbers, positive
from turnwright.errors import DomainError, InputError
from turnwright.surface.base import COSTLIEST, Surface
from turnwright.units import Number, Size, Text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Expression"]

LONGEST = 10_000
"""Characters a formula may have."""

MOST = 2000
"""Signs + and -, or * and /, that a formula may have; the parser of the language follows a few more."""

DEEPEST = 50
"""Brackets a formula may have inside one another."""

NESTED = 20_000
"""Steps of the parts of a formula of which crests and poles are searched, one by one: so many take some seconds."""

AXIS = 1e-12
"""Points closer to the axis than this lie on it: no optic is finer, and polar terms cancel badly there. [mm]."""

HUGE = 1e3
"""No optic is as high; where a divisor vanishes, a pole is. [mm]."""

FAR = 25.0
"""How far from the axis the feature size is estimated. [mm]."""

CREST_TOL = 1e-12
"""How closely the crest of an exp is found. [mm]."""

CLIMBS = 1000
"""Steps toward a crest at most: some arguments of exp climb along a spiral without end."""

STRAY_TOL = 1e-7
"""Closer than this to a crest its height no longer tells where it is, by rounding. [mm]."""

BLOCK = 8192
"""Points worked on at once, so that all terms of a formula stay in the cache."""

Value: TypeAlias = Floats | float
Jet: TypeAlias = tuple[Value, ...]
"""A value with its derivatives, (z), (z, zx, zy) or (z, zx, zy, zxx, zxy, zyy); a plain 0.0 is known to vanish."""

Watched: TypeAlias = tuple[int, str, Jet, Jet]
"""At which step what was called, with its argument and its result."""

Step: TypeAlias = tuple[str, float | str]
"""One step of a formula in postfix order: ("number", 2.0), ("name", "x"), ("operator", "+") or ("call", "sin")."""

SECOND = ((3, 1, 1), (4, 1, 2), (5, 2, 2))
"""Where a jet keeps its second derivatives, and by which first ones they are."""

# Value, first and second derivative of each function: f(v), d(v, f), dd(v, f, d).
Rule: TypeAlias = tuple[
    Callable[[Value], Value], Callable[[Value, Value], Value], Callable[[Value, Value, Value], Value]
]
CALLS: dict[str, Rule] = {
    "sin": (np.sin, lambda v, f: np.cos(v), lambda v, f, d: -f),
    "cos": (np.cos, lambda v, f: -np.sin(v), lambda v, f, d: -f),
    "tan": (np.tan, lambda v, f: 1 + f * f, lambda v, f, d: 2 * f * d),
    "asin": (np.arcsin, lambda v, f: 1 / np.sqrt(1 - v * v), lambda v, f, d: v * d * d * d),
    "acos": (np.arccos, lambda v, f: -1 / np.sqrt(1 - v * v), lambda v, f, d: v * d * d * d),
    "atan": (np.arctan, lambda v, f: 1 / (1 + v * v), lambda v, f, d: -2 * v * d * d),
    "sinh": (np.sinh, lambda v, f: np.cosh(v), lambda v, f, d: f),
    "cosh": (np.cosh, lambda v, f: np.sinh(v), lambda v, f, d: f),
    "tanh": (np.tanh, lambda v, f: 1 - f * f, lambda v, f, d: -2 * f * d),
    "exp": (np.exp, lambda v, f: f, lambda v, f, d: f),
    "log": (np.log, lambda v, f: 1 / v, lambda v, f, d: -d * d),
    "sqrt": (np.sqrt, lambda v, f: 0.5 / f, lambda v, f, d: -0.5 * d / v),
}
PAIRS = ("atan2", "hypot")
POLAR: dict[tuple[str, ...], str] = {("hypot", "x", "y"): "rho", ("hypot", "y", "x"): "rho", ("atan2", "y", "x"): "phi"}
"""Calls that spell a variable with an exact treatment on the axis of its own."""
OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
VARIABLES = ("x", "y", "rho", "phi")
NUMBERS = {"pi": np.pi, "e": np.e}
ROUGH = ("abs", "fabs", "max", "min", "floor", "ceil", "round", "sign", "trunc", "mod", "fmod", "heaviside")
COSTS = {"*": 4, "/": 5, "**": 4, "hypot": 16, "atan2": 16, "sin": 8, "cos": 8} | dict.fromkeys(
    set(CALLS) - {"sin", "cos"}, 3
)
"""Of a step at a point, with both derivatives, in additions: measured, to about a factor of 2."""
VARYING_POWER = 20
"""Of a power whose exponent changes."""
SHARP = ("sin", "cos", "tan", "atan", "sinh", "cosh", "tanh", "exp")
"""Functions with a length of their own; the others only stretch that of their argument."""


class _Axis(NamedTuple):
    """What a formula in rho and phi does on the axis."""

    jet: tuple[float, ...]  # its six limits, or the mean over all directions where they differ
    order: int  # how many of them are limits: -1 none, 0 the height, 1 the slopes, 2 all


class _Estimate(float):
    """A feature size that the formula itself gives, and another formula another."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, eq=False)
class Expression(Surface):
    """A surface z = formula in x, y, rho and phi.

    The formula may hold numbers, brackets, ``+ - * / **``, the constants ``pi`` and ``e``, and the functions sin, cos,
    tan, asin, acos, atan, atan2, sinh, cosh, tanh, exp, log, sqrt and hypot. ``rho`` is the distance from the axis
    and ``phi`` the azimuth from -pi to pi. Lengths are in mm, angles in rad. It is read by a parser of its own, never
    executed. Slopes and curvatures are exact, by automatic differentiation.

    On the axis a formula in ``rho`` and ``phi`` has the limit of its values; where the limits from different
    directions differ, it is not defined there. Only smooth functions are allowed, so ``abs``, ``max`` and the like
    are not, nor is a step where ``phi`` jumps from pi to -pi. A formula is defined where its value is finite.

    Parameters
    ----------
    formula
        For instance ``"0.2358*cos(3*phi)"``. Spaces and line ends do not matter.
    constants
        Numbers that the formula names, for instance ``{"R": 61.5}``.
    feature_size
        Length over which the curvature changes noticeably. By default an eighth of the shortest wave or bend that the
        formula's functions and divisions make along rays out to 25 mm from the axis, or of the wave that fits the
        highest crest of each exp wherever it stands; state it where a formula has finer structure elsewhere. [mm]

    Raises
    ------
    InputError
        If the formula cannot be read, is not smooth, or names something unknown.

    Sources
    -------
    [Griewank2008]_ ch. 13, second-order forward differentiation.

    >>> spiral = Expression("0.002*sin(3*phi)*(rho/a)**4", constants={"a": 5.0})
    >>> [float(round(part.item(), 9)) for part in spiral.gradient(0.0, 5.0)]
    [0.0, -0.0016]
    """

    family = "expression"
    example = MappingProxyType({"formula": "1e-3 * sin(x) * cos(y)", "units": "mm"})
    formula_units = "mm"
    formula: Text
    _: KW_ONLY
    constants: Mapping[str, Number] = field(default_factory=dict)
    feature_size: Size = None  # type: ignore[assignment] # None asks for the estimate; a float ever after
    _steps: tuple[Step, ...] = field(init=False, repr=False, compare=False)
    _axis: _Axis | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self, inf=("feature_size",) if isinstance(self.feature_size, _Estimate) else ())
        constants = {name: _constant(name, value) for name, value in self.constants.items()}
        object.__setattr__(self, "constants", constants)
        object.__setattr__(self, "_steps", _read(self.formula, {**NUMBERS, **constants}))
        names = {name for kind, name in self._steps if kind == "name"}
        object.__setattr__(self, "_axis", self._on_axis() if names & {"rho", "phi"} else None)
        if "phi" in names:
            self._require_no_cut()
        if self.feature_size is None or isinstance(self.feature_size, _Estimate):
            size: float = _Estimate(self._estimate())
        else:
            size = positive(self.feature_size, "feature_size of an expression", "mm")
        object.__setattr__(self, "feature_size", size)

    @property
    def unstated(self) -> Collection[str]:
        """The feature size, where it is an estimate."""
        return ("feature_size",) if isinstance(self.feature_size, _Estimate) else ()

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives, nan outside the domain. See `Surface.evaluate`."""
        out = np.empty(((1, 3, 6)[order], x.size))
        flat_x, flat_y = x.ravel(), y.ravel()
        for start in range(0, x.size, BLOCK):
            block = slice(start, start + BLOCK)
            self._block(flat_x[block], flat_y[block], order, out[:, block])
        return tuple(part.reshape(x.shape) for part in out)

    def inside(self, x: Floats, y: Floats) -> Bools:
        """Return where the formula has a finite value."""
        finite = np.isfinite(self.evaluate(x, y, 0)[0])
        if self._axis is not None and self._axis.order < 0:
            finite &= (x != 0) | (y != 0)
        return finite

    @property
    def cost(self) -> int:
        """That of its steps. See `Surface.cost`."""
        return _cost(self._steps, _operands(self._steps))

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return poles near the points: zeros of whatever divides, found by Newton's method. See `Surface.poles`."""
        found_x, found_y = [np.empty(0)], [np.empty(0)]
        with np.errstate(all="ignore"):
            for divisor in _divisors(self._steps):
                value, by_x, by_y = _slopes(divisor, x, y)
                away = np.nan_to_num(np.abs(value) / np.hypot(by_x, by_y), nan=np.inf)
                close = np.flatnonzero(away.min(axis=1) < reach)
                if close.size:
                    near = np.argmin(away[close], axis=1)
                    zero_x, zero_y = _zeros(divisor, x[close, near], y[close, near])
                    found_x.append(zero_x)
                    found_y.append(zero_y)
        x, y = np.concatenate(found_x), np.concatenate(found_y)
        pole = ~(np.abs(self.evaluate(x, y, 0)[0]) < HUGE)
        return x[pole], y[pole]

    @property
    def domain(self) -> str:
        """Say in words where the formula is defined."""
        if self._axis is not None and self._axis.order < 0:
            return "where its formula is finite, which leaves out the axis: there it has no limit"
        return "where its formula is finite"

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return on which side of the axis a point is, if the formula is not smooth on the axis, as a cone is not."""
        if self._axis is None or self._axis.order == 2:
            return None
        side = ((x > 0) | ((x == 0) & (y > 0))).astype(np.int64)
        # An axis without a height belongs to neither side.
        return side if self._axis.order >= 0 else np.where((x == 0) & (y == 0), 2, side)

    def _checked(self, x: ArrayLike, y: ArrayLike, order: int) -> tuple[Floats, ...]:
        values = Surface._checked(self, x, y, order)  # noqa: SLF001 - super() fails in a class with slots
        smooth = np.isfinite(values).all(axis=0)
        x, y = np.broadcast_arrays(x, y)
        axis = np.hypot(x, y).reshape(smooth.shape) < AXIS
        if self._axis is not None and self._axis.order < order:
            smooth &= ~axis
        if not smooth.all():
            first = np.flatnonzero(~smooth)[0]
            place = "on the axis" if axis.ravel()[first] else "where a term of it ends"
            raise DomainError(
                f"Expression {_short(self.formula)!r} has no {('height', 'slope', 'curvature')[order]} at "
                f"x = {x.ravel()[first]:.6g} mm, y = {y.ravel()[first]:.6g} mm ({np.count_nonzero(~smooth)} of "
                f"{smooth.size} points), {place}: keep away from it, or write distances as rho and azimuths as phi"
            )
        return values

    def _block(self, x: Floats, y: Floats, order: int, out: Floats) -> None:
        """Fill ``out`` (1, 3 or 6, n)."""
        on_axis = None
        if self._axis is not None and self._axis.order >= 0:
            on_axis = np.flatnonzero((np.abs(x) < AXIS) & (np.hypot(x, y) < AXIS))
            if on_axis.size:
                x = x.copy()
                x[on_axis] = 1.0
        with np.errstate(all="ignore"):
            seeds = {"x": _jet(order, x, 1.0), "y": _jet(order, y, 0.0, 1.0)}
            if self._axis is not None:
                seeds |= _polar(x, y, order)
            for row, values in zip(out, _run(self._steps, seeds, order), strict=True):
                row[:] = values
        if self._axis is not None and on_axis is not None and on_axis.size:
            out[:, on_axis] = np.array(self._axis.jet[: out.shape[0]])[:, None]

    def _rays(self, radius: Floats, angle: Floats, order: int, watch: list[Watched] | None = None) -> Jet:
        """Return the jet along rays from the axis: its x-derivatives are those along the ray."""
        c, s = np.cos(angle), np.sin(angle)
        seeds = {
            "x": _jet(order, radius * c, c),
            "y": _jet(order, radius * s, s),
            "rho": _jet(order, radius, 1.0),
            "phi": _jet(order, np.broadcast_to(angle, np.shape(radius)), 0.0),
        }
        with np.errstate(all="ignore"):
            return _run(self._steps, seeds, order, watch)

    def _on_axis(self) -> _Axis:
        """Find the limits on the axis from the exact Taylor series along rays in many directions.

        Height, slope and curvature along a ray must be a constant, a cos + b sin and p cos² + 2 q cos sin + r sin² of
        its azimuth, else there is no limit. The diameters are in no ratio to each other, so that no wave hides.
        """
        half = np.mod(np.arange(32) * np.pi * (np.sqrt(5) - 1), np.pi)
        angle = np.concatenate([half, half - np.pi])
        values = [np.broadcast_to(self._rays(np.zeros(64), angle, 2)[k], 64) for k in (0, 1, 3)]
        c, s = np.cos(angle), np.sin(angle)
        shapes = [np.ones((64, 1)), np.stack([c, s], axis=1), np.stack([c * c, 2 * c * s, s * s], axis=1)]
        jet: list[float] = []
        order = -1
        for k, (value, shape) in enumerate(zip(values, shapes, strict=True)):
            if not np.isfinite(value).all():
                jet.extend([np.nan] * shape.shape[1])
                continue
            fit = np.linalg.lstsq(shape, value)[0]
            jet.extend(float(part) for part in fit)
            if order == k - 1 and np.abs(shape @ fit - value).max() <= 1e-12 + 1e-9 * np.abs(value).max():
                order = k
        return _Axis(jet=tuple(jet), order=order)

    def _require_no_cut(self) -> None:
        """Raise if height or slope step where phi jumps from pi to -pi."""
        radius = np.geomspace(1e-2, 25, 12)
        below, above = (
            np.array([np.broadcast_to(part, radius.shape) for part in self._rays(radius, side, 2)])
            for side in (np.full(12, -np.pi), np.full(12, np.pi))
        )
        # The azimuth's own derivative is not along the ray, so a full jet beside the cut is compared as well.
        full = [np.stack(self.evaluate(-radius, np.full(12, side), 1)) for side in (-0.0, 0.0)]
        for low, high in ((below, above), full):
            with np.errstate(all="ignore"):  # where the formula is not finite nothing can be compared
                step, size = np.abs(low - high), np.maximum(np.abs(low), np.abs(high))
                bad = np.flatnonzero(step.max(axis=0) > 1e-9 * (1e-3 + size.max(axis=0)))
            if bad.size:
                raise InputError(
                    f"formula {_short(self.formula)!r} steps by {step[:, bad[0]].max():.3g} where phi jumps from 180 "
                    "to -180 deg, the limit is 0: multiply phi by whole numbers, inside sin and cos"
                )

    def _estimate(self) -> float:
        """Estimate the feature size from how fast the arguments of the formula's functions change along rays.

        The argument of exp(a) changes ever faster down the flanks of a bump, while the bump vanishes, and a ray may
        miss a narrow one: it is measured at its crest, and elsewhere as far as it is felt.
        """
        radius, angle = _look_around()
        watch: list[Watched] = []
        self._rays(radius, angle, 1, watch)
        operands = _operands(self._steps)
        fastest = 0.0
        bumps: dict[tuple[Step, ...], tuple[Floats, Floats]] = {}
        for at, what, argument, result in watch:
            value, rate = (np.broadcast_to(part, radius.shape) for part in argument[:2])
            effect = np.broadcast_to(result[1], radius.shape)
            if what == "exp" and np.isfinite(value).any():
                bumps[self._steps[operands[at][0]]] = value, rate
                continue
            if what == "/":  # a divisor works through its relative change
                with np.errstate(all="ignore"):
                    rate, effect = rate / value, rate / value * result[0]
            rate, effect = np.abs(rate), np.abs(effect)
            known = np.isfinite(rate) & np.isfinite(effect)
            felt = known & (effect > 1e-3 * np.max(effect, where=known, initial=0.0))
            fastest = max(fastest, float(np.max(rate, where=felt, initial=0.0)))
        for argument_steps, (value, rate) in bumps.items():
            top, wave = _crest(argument_steps, value)
            with np.errstate(all="ignore"):
                felt_rate = np.abs(rate) * np.exp(np.minimum(value - top, 0.0) / 2)
            fastest = max(fastest, wave, float(np.max(felt_rate, where=np.isfinite(felt_rate), initial=0.0)))
        # A wave sin(k r) has k per mm; this makes it an eighth of its period.
        return np.pi / 4 / fastest if fastest else float("inf")


def _crest(argument: tuple[Step, ...], sampled: Floats) -> tuple[float, float]:
    """Return how high the argument a of an exp climbs from its samples, and the wave number there.

    At its crest exp(a) bends like a wave of a'^2 + 3 |a''| per mm²: its fourth derivative over its second.
    """
    radius, angle = _look_around()
    best = int(np.argmax(np.where(np.isfinite(sampled), sampled, -np.inf)))
    r, azimuth = radius.flat[best], angle.flat[best]
    # From ray to ray it is this far, and the crest may be in between.
    wide = r * (np.pi / 16) + FAR / 200
    x, y = r * np.cos(azimuth), r * np.sin(azimuth)
    across, along = (part.ravel() for part in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))
    with np.errstate(all="ignore"):
        for _ in range(CLIMBS):
            if wide <= CREST_TOL:
                break
            near_x, near_y = x + wide * across, y + wide * along
            heights = np.broadcast_to(_run(argument, _seeds(near_x, near_y, 0), 0)[0], near_x.shape)
            allowed = np.isfinite(heights) & (np.hypot(near_x, near_y) <= FAR)
            heights = np.where(allowed, heights, -np.inf)
            best = int(np.argmax(heights))
            if heights[best] == heights[across.size // 2]:  # places as high as this one are not gone through
                wide /= 2
            elif wide < STRAY_TOL:  # rounding alone moves it on
                break
            x, y = near_x[best], near_y[best]
        jet = _run(argument, _seeds(np.full(1, x), np.full(1, y), 2), 2)
        top, ax, ay, axx, axy, ayy = (float(np.broadcast_to(part, 1)[0]) for part in jet)
        bend = abs(axx + ayy) / 2 + np.hypot((axx - ayy) / 2, axy)
        wave = np.sqrt(ax**2 + ay**2 + 3 * bend)
    return top, float(np.nan_to_num(wave, posinf=0.0))


def _look_around() -> tuple[Floats, Floats]:
    """Return the places, radius and azimuth, from which the feature size is estimated. Each (16, 200)."""
    radius, angle = np.meshgrid(np.linspace(0, FAR, 201)[1:], np.arange(16) * np.pi / 8)
    return radius, angle


def _seeds(x: Floats, y: Floats, order: int) -> dict[str, Jet]:
    """Return the jets of the variables off the axis."""
    return {"x": _jet(order, x, 1.0), "y": _jet(order, y, 0.0, 1.0), **_polar(x, y, order)}


def _slopes(steps: tuple[Step, ...], x: Floats, y: Floats) -> tuple[Floats, ...]:
    """Return the value and the slopes of a part of a formula."""
    return tuple(np.broadcast_to(part, x.shape) for part in _run(steps, _seeds(x, y, 1), 1))


def _zeros(divisor: tuple[Step, ...], x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return where a divisor is zero, or Newton's method ends, starting from some points."""
    start = np.arctan2(y, x)
    for _ in range(60):  # a double zero is approached by half the way each time
        value, by_x, by_y = _slopes(divisor, x, y)
        share = value / (by_x**2 + by_y**2)
        step_x, step_y = (np.where(np.isfinite(share * by), share * by, 0) for by in (by_x, by_y))
        x, y = x - step_x, y - step_y
        if not (step_x.any() or step_y.any()):
            break
    # The axis alone may be missing: the formula is looked at beside it.
    axis = np.hypot(x, y) < 1e-9
    return np.where(axis, 1e-9 * np.cos(start), x), np.where(axis, 1e-9 * np.sin(start), y)


def _constant(name: str, value: float) -> float:
    """Return a named constant's value."""
    if not str(name).isidentifier() or name in (*VARIABLES, *NUMBERS, *CALLS, *PAIRS):
        raise InputError(f"constant {name!r} cannot be named so, it is no plain word or has a meaning: rename it")
    if not np.isfinite(value):
        raise InputError(f"constant {name} is {value}, it must be finite: give a number")
    return float(value)


def _read(formula: str, numbers: Mapping[str, float]) -> tuple[Step, ...]:
    """Return a formula in postfix order."""
    text = " ".join(formula.split())
    if not 0 < len(text) <= LONGEST:
        raise InputError(f"a formula has {len(text)} characters, the limits are 1 to {LONGEST}: shorten or give it")
    signs = max(len(re.findall(rf"(?<!\d[eE])(?<=[\w.)]) ?[{pair}]", text)) for pair in ("+-", "*/"))
    if signs > MOST:
        raise InputError(
            f"a formula has {signs} signs between its terms or factors, the limit is {MOST}: give it as a sum of "
            "several formulas"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as a number that runs into a word
            tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, Warning) as error:
        raise InputError(
            f"formula {_short(text)!r} cannot be read: write it as in 0.1*x**2 - sin(3*phi), every product with *"
        ) from error
    except (RecursionError, MemoryError) as error:
        raise InputError(
            f"a formula has brackets or terms nested too deep, the limit is {DEEPEST}: simplify it"
        ) from error
    appended: list[Step] = []
    _append(tree.body, text, numbers, appended, DEEPEST)
    steps = tuple(appended)
    _require_affordable(steps)
    return steps


def _cost(steps: tuple[Step, ...], operands: list[tuple[slice, ...]]) -> int:
    """Return the additions that a formula costs at a point."""
    return sum(
        VARYING_POWER if what == "**" and _varies(steps[spans[-1]]) else COSTS.get(str(what), 1) if spans else 0
        for (_, what), spans in zip(steps, operands, strict=True)
    )


def _require_affordable(steps: tuple[Step, ...]) -> None:
    """Raise if a formula costs too much at each point, or too much of it is searched for crests and poles."""
    operands = _operands(steps)
    if (cost := _cost(steps, operands)) > COSTLIEST:
        raise InputError(
            f"a formula costs {cost} additions at each point, the limit is {COSTLIEST}: simplify it, or give its "
            "heights as a table"
        )
    crests = {steps[spans[0]] for (_, what), spans in zip(steps, operands, strict=True) if what == "exp"}
    searched = sum(map(len, crests)) + sum(map(len, _divisors(steps)))
    if searched > NESTED:
        raise InputError(
            f"a formula has exp and divisors of {searched} steps together that are nested in each other, the limit is "
            f"{NESTED}: simplify it, or give its heights as a table"
        )


def _operands(steps: tuple[Step, ...]) -> list[tuple[slice, ...]]:
    """Return where the parts of the formula stand that each step takes: none, one or two."""
    starts: list[int] = []
    found: list[tuple[slice, ...]] = []
    for at, (kind, _) in enumerate(steps):
        count = {"call": 1, "operator": 2}.get(kind, 0)
        ends = [*starts[len(starts) - count + 1 :], at] if count else []
        begins = starts[len(starts) - count :] if count else []
        found.append(tuple(map(slice, begins, ends)))
        starts[len(starts) - count :] = [begins[0] if begins else at]
    return found


def _divisors(steps: tuple[Step, ...]) -> list[tuple[Step, ...]]:
    """Return the parts that a formula divides by, each once; constants are left out."""
    found: dict[tuple[Step, ...], None] = {}
    for (_, what), spans in zip(steps, _operands(steps), strict=True):
        divisor: tuple[Step, ...] = ()
        if what == "/":
            divisor = steps[spans[1]]
        elif what == "tan":
            divisor = (*steps[spans[0]], ("call", "cos"))
        elif what == "**" and not _varies(power := steps[spans[1]]) and _run(power, {}, 0)[0] < 0:
            divisor = steps[spans[0]]
        if _varies(divisor):
            found[divisor] = None
    return list(found)


def _varies(steps: tuple[Step, ...]) -> bool:
    return any(kind == "name" for kind, _ in steps)


def _append(node: ast.expr, text: str, numbers: Mapping[str, float], steps: list[Step], depth: int) -> None:
    """Append the steps of a part of the formula."""
    if depth == 0:
        raise InputError(f"a formula has brackets nested too deep, the limit is {DEEPEST}: simplify it")
    # A long sum is a deep chain to the left; it is unrolled, so that only brackets count as depth.
    chain: list[tuple[str, ast.expr]] = []
    while isinstance(node, ast.BinOp):
        operator = OPERATORS.get(type(node.op))
        if operator is None:
            _refuse(node, text)
        chain.append((operator, node.right))
        node = node.left
    _append_factor(node, text, numbers, steps, depth - 1)
    for operator, right in reversed(chain):
        _append(right, text, numbers, steps, depth - 1)
        steps.append(("operator", operator))


def _append_factor(node: ast.expr, text: str, numbers: Mapping[str, float], steps: list[Step], depth: int) -> None:
    """Append the steps of a number, a name, a sign or a call."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            steps.append(("number", _number(value, text)))
        case ast.Name(id=name) if name in VARIABLES:
            steps.append(("name", name))
        case ast.Name(id=name) if name in numbers:
            steps.append(("number", numbers[name]))
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            _append(operand, text, numbers, steps, depth)
            if isinstance(node.op, ast.USub):
                steps.append(("call", "negative"))
        case ast.Call(func=ast.Name(id="hypot" | "atan2" as name), args=[first, second], keywords=[]):
            polar = POLAR.get((name, *(one.id if isinstance(one, ast.Name) else "" for one in (first, second))))
            if polar is None:
                _append(first, text, numbers, steps, depth)
                _append(second, text, numbers, steps, depth)
            steps.append(("operator", name) if polar is None else ("name", polar))
        case ast.Call(func=ast.Name(id=name), args=[only], keywords=[]) if name in CALLS:
            _append(only, text, numbers, steps, depth)
            steps.append(("call", name))
        case _:
            _refuse(node, text)


def _refuse(node: ast.expr, text: str) -> NoReturn:
    """Raise because of a part that no smooth formula has."""
    part = ast.get_source_segment(text, node) or text
    match node:
        case ast.Name(id=name):
            what = f"the name {name!r}, which is unknown"
            remedy = f"use {', '.join((*VARIABLES, *NUMBERS))}, or give it in constants"
        case ast.Call(func=ast.Name(id=name)) if name in ROUGH:
            what, remedy = f"{name}(), which is not smooth", "write a smooth function, for instance sqrt(u**2 + w**2)"
        case ast.Call(func=ast.Name(id=name)) if name in (*CALLS, *PAIRS):
            what, remedy = f"{_short(part)!r}", f"give {name} {2 if name in PAIRS else 1} plain argument(s)"
        case ast.BinOp(op=ast.BitXor()):
            what, remedy = f"the sign ^ in {_short(part)!r}", "write ** for a power"
        case ast.Tuple():
            what, remedy = f"a comma in {_short(part)!r}", "write decimals with a point"
        case _:
            what, remedy = f"{_short(part)!r}", f"use + - * / ** and {', '.join((*CALLS, *PAIRS))} only"
    raise InputError(f"formula {_short(text)!r} has {what}: {remedy}")


def _number(value: float, text: str) -> float:
    """Return a literal as a float."""
    try:
        number = float(value)
    except OverflowError:
        number = np.inf
    if not np.isfinite(number):
        raise InputError(f"formula {_short(text)!r} has a number beyond 1.8e308, the limit: write a smaller one")
    return number


def _short(text: str) -> str:
    """Return the beginning of a long text."""
    return text if len(text) <= 60 else text[:57] + "..."


def _jet(order: int, value: Value, by_x: Value = 0.0, by_y: Value = 0.0) -> Jet:
    """Return a value that changes linearly."""
    return (value, by_x, by_y, 0.0, 0.0, 0.0)[: (1, 3, 6)[order]]


def _polar(x: Floats, y: Floats, order: int) -> dict[str, Jet]:
    """Return the jets of rho and phi off the axis."""
    rho = np.hypot(x, y)
    phi: Jet = (np.arctan2(y, x),)
    if order == 0:
        return {"rho": (rho,), "phi": phi}
    c, s = x / rho, y / rho
    radial: Jet = (rho, c, s)
    phi += (-s / rho, c / rho)
    if order == 2:
        radial += (s * s / rho, -s * c / rho, c * c / rho)
        twice, single = 2 * s * c / rho / rho, (s * s - c * c) / rho / rho
        phi += (twice, single, -twice)
    return {"rho": radial, "phi": phi}


def _run(steps: tuple[Step, ...], seeds: Mapping[str, Jet], order: int, watch: list[Watched] | None = None) -> Jet:
    """Work a formula through on a stack of jets; ``watch`` collects calls and divisions."""
    with np.errstate(all="ignore"):
        return _worked(steps, seeds, order, watch)


def _worked(steps: tuple[Step, ...], seeds: Mapping[str, Jet], order: int, watch: list[Watched] | None) -> Jet:
    stack: list[Jet] = []
    for at, (kind, what) in enumerate(steps):
        match kind, what:
            case "number", float():
                stack.append(_jet(order, np.float64(what)))
            case "name", str():
                stack.append(seeds[what])
            case "call", str():
                argument = stack.pop()
                stack.append(_call(what, argument, order))
                if watch is not None and what in SHARP:
                    watch.append((at, what, argument, stack[-1]))
            case _, str():
                second = stack.pop()
                first = stack.pop()
                stack.append(OPERATIONS[what](first, second, order))
                if watch is not None and what == "/":
                    watch.append((at, what, second, stack[-1]))
    return stack[0]


def _times(a: Value, b: Value) -> Value:
    """Multiply, where a plain 0.0 is truly nothing, even times infinity, and a plain 1.0 changes nothing."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, float):
            if one == 0.0:
                return 0.0
            if one == 1.0:
                return other
    return a * b


def _plus(*terms: Value) -> Value:
    """Add, leaving out plain zeros."""
    total: Value = 0.0
    for term in terms:
        if isinstance(total, float) and total == 0.0:
            total = term
        elif not (isinstance(term, float) and term == 0.0):
            total = total + term
    return total


def _sum(a: Jet, b: Jet, order: int) -> Jet:
    return tuple(_plus(p, q) for p, q in zip(a, b, strict=True))


def _difference(a: Jet, b: Jet, order: int) -> Jet:
    return tuple(_plus(p, -q) for p, q in zip(a, b, strict=True))


def _product(a: Jet, b: Jet, order: int) -> Jet:
    jet = [a[0] * b[0]]
    if order > 0:
        jet += [_plus(_times(a[i], b[0]), _times(a[0], b[i])) for i in (1, 2)]
    if order > 1:
        jet += [
            _plus(_times(a[k], b[0]), _times(a[i], b[j]), _times(a[j], b[i]), _times(a[0], b[k])) for k, i, j in SECOND
        ]
    return tuple(jet)


def _quotient(a: Jet, b: Jet, order: int) -> Jet:
    # From q b = a, differentiated: nothing cancels that need not.
    q: list[Value] = [a[0] / b[0]]
    if order > 0:
        q += [_over(_plus(a[i], -_times(q[0], b[i])), b[0]) for i in (1, 2)]
    if order > 1:
        q += [
            _over(_plus(a[k], -_times(q[i], b[j]), -_times(q[j], b[i]), -_times(q[0], b[k])), b[0])
            for k, i, j in SECOND
        ]
    return tuple(q)


def _over(a: Value, b: Value) -> Value:
    """Divide, where a plain 0.0 stays one."""
    return 0.0 if isinstance(a, float) and a == 0.0 else a / b


def _call(name: str, a: Jet, order: int) -> Jet:
    if name == "negative":
        return tuple(-part for part in a)
    value, first, second = CALLS[name]
    f = value(a[0])
    d = first(a[0], f) if order > 0 else 0.0
    dd = second(a[0], f, d) if order > 1 else 0.0
    return _chain(a, order, f, d, dd)


def _chain(a: Jet, order: int, f: Value, d: Value, dd: Value) -> Jet:
    """Return the jet of a function of a jet from the function's value and derivatives."""
    jet = [f]
    if order > 0:
        jet += [_times(d, a[i]) for i in (1, 2)]
    if order > 1:
        jet += [_plus(_times(d, a[k]), _times(dd, _times(a[i], a[j]))) for k, i, j in SECOND]
    return tuple(jet)


def _power(a: Jet, b: Jet, order: int) -> Jet:
    n = b[0]
    if not isinstance(n, float) or any(not isinstance(part, float) or part for part in b[1:]):
        # a ** b with a changing exponent is exp(b log a), for a positive base.
        return _call("exp", _product(b, _call("log", a, order), order), order)
    v = a[0]
    d = n * v ** (n - 1) if n not in (0, 1) else n
    dd = n * (n - 1) * v ** (n - 2) if n not in (0, 1, 2) else n * (n - 1)
    return _chain(a, order, v**n, d, dd)


def _hypot(a: Jet, b: Jet, order: int) -> Jet:
    jet: list[Value] = [np.hypot(a[0], b[0])]
    if order > 0:
        jet += [_over(_plus(_times(a[0], a[i]), _times(b[0], b[i])), jet[0]) for i in (1, 2)]
    if order > 1:
        jet += [
            _over(
                _plus(
                    _times(a[i], a[j]),
                    _times(a[0], a[k]),
                    _times(b[i], b[j]),
                    _times(b[0], b[k]),
                    -_times(jet[i], jet[j]),
                ),
                jet[0],
            )
            for k, i, j in SECOND
        ]
    return tuple(jet)


def _atan2(a: Jet, b: Jet, order: int) -> Jet:
    jet: list[Value] = [np.arctan2(a[0], b[0])]
    square = a[0] * a[0] + b[0] * b[0]
    if order > 0:
        jet += [_over(_plus(_times(b[0], a[i]), -_times(a[0], b[i])), square) for i in (1, 2)]
    if order > 1:
        half = [0.0, *(_plus(_times(a[0], a[i]), _times(b[0], b[i])) for i in (1, 2))]
        jet += [
            _over(
                _plus(
                    _times(b[0], a[k]),
                    -_times(a[0], b[k]),
                    _times(b[j], a[i]),
                    -_times(a[j], b[i]),
                    -2 * _times(jet[i], half[j]),
                ),
                square,
            )
            for k, i, j in SECOND
        ]
    return tuple(jet)


OPERATIONS: dict[str, Callable[[Jet, Jet, int], Jet]] = {
    "+": _sum,
    "-": _difference,
    "*": _product,
    "/": _quotient,
    "**": _power,
    "hypot": _hypot,
    "atan2": _atan2,
}
