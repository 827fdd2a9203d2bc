"""A surface defined by a formula, parsed safely and differentiated exactly."""

# ruff: noqa: ARG001, ARG005 - all differentiation rules have the same signature

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
from turnwright._validate import check_numbers, finite, positive
from turnwright.errors import DomainError, InputError, quote
from turnwright.surface.base import COSTLIEST, Surface
from turnwright.units import Number, Size, Text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Expression"]

MAX_CHARACTERS = 10_000

MAX_SIGNS = 2000
"""Signs + and -, or * and /, in a formula; Python's parser accepts a few more."""

MAX_NESTING = 50
"""Brackets inside one another."""

MAX_SEARCH_STEPS = 20_000
"""Steps of the parts of a formula whose crests and poles are searched; as many take some seconds."""

AXIS_RADIUS_MM = 1e-12
"""Points closer to the axis than this are treated as on it, as polar terms cancel there."""

MIN_POLE_HEIGHT_MM = 1e3
"""Height beyond which a zero of a divisor is a pole."""

MAX_ESTIMATE_RADIUS_MM = 25.0
"""Distance from the axis within which the feature size is estimated."""

CREST_TOL_MM = 1e-12
"""Accuracy of the position of the crest of an exp."""

MAX_CREST_STEPS = 1000
"""Steps toward a crest; some arguments of exp rise along a spiral without end."""

STRAY_TOL_MM = 1e-7
"""Distance from a crest below which rounding hides where it is."""

BLOCK_POINTS = 8192
"""Points evaluated at once, so that all terms of a formula stay in the cache."""

Value: TypeAlias = Floats | float
Jet: TypeAlias = tuple[Value, ...]
"""A value with its derivatives, (z), (z, zx, zy) or (z, zx, zy, zxx, zxy, zyy); a Python float 0.0 is exactly zero."""

Watched: TypeAlias = tuple[int, str, Jet, Jet]
"""Number and name of a step, its argument and its result."""

Step: TypeAlias = tuple[str, float | str]
"""One step of a formula in postfix order: ("number", 2.0), ("name", "x"), ("operator", "+") or ("call", "sin")."""

SECOND = ((3, 1, 1), (4, 1, 2), (5, 2, 2))
"""Indices of the second derivatives in a jet, with those of the two first derivatives that they belong to."""

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
"""Calls that mean rho or phi, which are treated exactly on the axis."""
OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
VARIABLES = ("x", "y", "rho", "phi")
NUMBERS = {"pi": np.pi, "e": np.e}
ROUGH = ("abs", "fabs", "max", "min", "floor", "ceil", "round", "sign", "trunc", "mod", "fmod", "heaviside")
COSTS = {"*": 4, "/": 5, "**": 4, "hypot": 16, "atan2": 16, "sin": 8, "cos": 8} | dict.fromkeys(
    set(CALLS) - {"sin", "cos"}, 3
)
"""Cost of a step per point with both derivatives, in additions: measured, to about a factor of 2."""
VARYING_POWER_COST = 20
"""Cost of a power with a varying exponent."""
SCALE_FUNCTIONS = ("sin", "cos", "tan", "atan", "sinh", "cosh", "tanh", "exp")
"""Functions that introduce a length scale; the others only stretch that of their argument."""


class _Axis(NamedTuple):
    """Behaviour of a formula in rho and phi on the axis."""

    jet: tuple[float, ...]  # the six limits, or the mean over all directions where they differ
    order: int  # highest derivative with a limit: -1 none, 0 the height, 1 the slopes, 2 the curvatures


class _Estimate(float):
    """A feature size estimated from the formula, which is estimated again for another formula."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, eq=False)
class Expression(Surface):
    """A surface z = formula in x, y, rho and phi.

    The formula may hold numbers, brackets, ``+ - * / **``, the constants ``pi`` and ``e``, and the functions sin, cos,
    tan, asin, acos, atan, atan2, sinh, cosh, tanh, exp, log, sqrt and hypot. ``rho`` is the distance from the axis
    and ``phi`` the azimuth from -pi to pi. Lengths are in mm, angles in rad. The formula is parsed, never executed as
    code. Slopes and curvatures are exact, by automatic differentiation.

    On the axis a formula in ``rho`` and ``phi`` has the limit of its values; where the limits from different
    directions differ, it is not defined there. Only smooth functions are allowed: no ``abs``, ``max`` and the like, and
    no step where ``phi`` jumps from pi to -pi. A formula is defined where its value is finite.

    Parameters
    ----------
    formula
        For instance ``"0.2358*cos(3*phi)"``. Spaces and line breaks are ignored.
    constants
        Values of further names in the formula, for instance ``{"R": 61.5}``.
    feature_size
        Length over which the curvature changes noticeably; state it if the formula has structure finer than the
        default, an eighth of the shortest period of its functions and divisions within 25 mm of the axis. [mm]

    Raises
    ------
    InputError
        If the formula cannot be parsed, is not smooth, or has an unknown name.

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
    feature_size: Size = None  # type: ignore[assignment] # None until it is estimated
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

    @property
    def of_revolution(self) -> bool:
        """Whether the surface is known to be one of revolution about the axis."""
        return not {name for kind, name in self._steps if kind == "name"} & {"x", "y", "phi"}

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives, nan outside the domain. See `Surface.evaluate`."""
        out = np.empty(((1, 3, 6)[order], x.size))
        flat_x, flat_y = x.ravel(), y.ravel()
        for start in range(0, x.size, BLOCK_POINTS):
            block = slice(start, start + BLOCK_POINTS)
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
        """Cost of all steps of the formula. See `Surface.cost`."""
        return _cost(self._steps, _operands(self._steps))

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return poles near the points: zeros of divisors, found by Newton's method. See `Surface.poles`."""
        poles_x, poles_y = [np.empty(0)], [np.empty(0)]
        with np.errstate(all="ignore"):
            for divisor in _divisors(self._steps):
                value, by_x, by_y = _slopes(divisor, x, y)
                distance = np.nan_to_num(np.abs(value) / np.hypot(by_x, by_y), nan=np.inf)
                close = np.flatnonzero(distance.min(axis=1) < reach)
                if close.size:
                    near = np.argmin(distance[close], axis=1)
                    zero_x, zero_y = _zeros(divisor, x[close, near], y[close, near])
                    poles_x.append(zero_x)
                    poles_y.append(zero_y)
        x, y = np.concatenate(poles_x), np.concatenate(poles_y)
        pole = ~(np.abs(self.evaluate(x, y, 0)[0]) < MIN_POLE_HEIGHT_MM)
        return x[pole], y[pole]

    @property
    def domain(self) -> str:
        """The domain of the formula in words."""
        if self._axis is not None and self._axis.order < 0:
            return "where its formula is finite, except on the axis, where it has no limit"
        return "where its formula is finite"

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the side of the axis on which a point is, if the formula is not smooth there, like a cone."""
        if self._axis is None or self._axis.order == 2:
            return None
        side = ((x > 0) | ((x == 0) & (y > 0))).astype(np.int64)
        # On an axis without a height, the axis is a piece of its own.
        return side if self._axis.order >= 0 else np.where((x == 0) & (y == 0), 2, side)

    def _checked(self, x: ArrayLike, y: ArrayLike, order: int) -> tuple[Floats, ...]:
        values = Surface._checked(self, x, y, order)  # noqa: SLF001 - super() fails in a class with slots
        smooth = np.isfinite(values).all(axis=0)
        x, y = np.broadcast_arrays(x, y)
        axis = np.hypot(x, y).reshape(smooth.shape) < AXIS_RADIUS_MM
        if self._axis is not None and self._axis.order < order:
            smooth &= ~axis
        if not smooth.all():
            first = np.flatnonzero(~smooth)[0]
            place = "on the axis" if axis.ravel()[first] else "at the limit of one of its terms"
            raise DomainError(
                f"Expression {quote(self.formula)} has no {('height', 'slope', 'curvature')[order]} at "
                f"x = {x.ravel()[first]:.6g} mm, y = {y.ravel()[first]:.6g} mm ({np.count_nonzero(~smooth)} of "
                f"{smooth.size} points), {place}: keep away from it, or write distances as rho and azimuths as phi"
            )
        return values

    def _block(self, x: Floats, y: Floats, order: int, out: Floats) -> None:
        """Fill ``out`` (1, 3 or 6, n)."""
        on_axis = None
        if self._axis is not None and self._axis.order >= 0:
            on_axis = np.flatnonzero((np.abs(x) < AXIS_RADIUS_MM) & (np.hypot(x, y) < AXIS_RADIUS_MM))
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
        """Return the limits on the axis from the exact Taylor series along rays in many directions.

        Height, slope and curvature along a ray must be a constant, a cos + b sin and p cos² + 2 q cos sin + r sin² of
        its azimuth, otherwise there is no limit. The azimuths are incommensurable, to avoid aliasing.
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
        """Raise if height or slope are discontinuous where phi jumps from pi to -pi."""
        radius = np.geomspace(1e-2, 25, 12)
        below, above = (
            np.array([np.broadcast_to(part, radius.shape) for part in self._rays(radius, side, 2)])
            for side in (np.full(12, -np.pi), np.full(12, np.pi))
        )
        # Derivatives along the ray do not include that by azimuth, so full jets on both sides are compared too.
        full = [np.stack(self.evaluate(-radius, np.full(12, side), 1)) for side in (-0.0, 0.0)]
        for low, high in ((below, above), full):
            with np.errstate(all="ignore"):  # the formula may not be finite
                step, size = np.abs(low - high), np.maximum(np.abs(low), np.abs(high))
                bad = np.flatnonzero(step.max(axis=0) > 1e-9 * (1e-3 + size.max(axis=0)))
            if bad.size:
                raise InputError(
                    f"formula {quote(self.formula)} has a step of {step[:, bad[0]].max():.3g} where phi jumps from "
                    "180 to -180 deg, it must be continuous: multiply phi by whole numbers, inside sin and cos"
                )

    def _estimate(self) -> float:
        """Estimate the feature size from the rate at which the arguments of the formula's functions change along rays.

        For a bump exp(a) this rate grows along the flanks while the bump vanishes, and rays may miss a narrow bump.
        Therefore it is taken at the crest, and elsewhere weighted by the height of the bump.
        """
        radius, angle = _sample_rays()
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
            if what == "/":  # for a divisor, the relative change counts
                with np.errstate(all="ignore"):
                    rate, effect = rate / value, rate / value * result[0]
            rate, effect = np.abs(rate), np.abs(effect)
            is_finite = np.isfinite(rate) & np.isfinite(effect)
            matters = is_finite & (effect > 1e-3 * np.max(effect, where=is_finite, initial=0.0))
            fastest = max(fastest, float(np.max(rate, where=matters, initial=0.0)))
        for argument_steps, (value, rate) in bumps.items():
            top, wave = _crest(argument_steps, value)
            with np.errstate(all="ignore"):
                weighted = np.abs(rate) * np.exp(np.minimum(value - top, 0.0) / 2)
            fastest = max(fastest, wave, float(np.max(weighted, where=np.isfinite(weighted), initial=0.0)))
        # A wave sin(k r) changes by k per mm; the result is an eighth of its period.
        return np.pi / 4 / fastest if fastest else float("inf")


def _crest(argument: tuple[Step, ...], sampled: Floats) -> tuple[float, float]:
    """Return the maximum of the argument a of an exp, searched from its samples, and the wave number there.

    At its crest exp(a) is like a wave with the squared wave number a'^2 + 3 |a''|: its fourth derivative over its
    second.
    """
    radius, angle = _sample_rays()
    best = int(np.argmax(np.where(np.isfinite(sampled), sampled, -np.inf)))
    r, azimuth = radius.flat[best], angle.flat[best]
    # The distance between samples: the crest may be in between.
    wide = r * (np.pi / 16) + MAX_ESTIMATE_RADIUS_MM / 200
    x, y = r * np.cos(azimuth), r * np.sin(azimuth)
    across, along = (part.ravel() for part in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))
    with np.errstate(all="ignore"):
        for _ in range(MAX_CREST_STEPS):
            if wide <= CREST_TOL_MM:
                break
            near_x, near_y = x + wide * across, y + wide * along
            heights = np.broadcast_to(_run(argument, _seeds(near_x, near_y, 0), 0)[0], near_x.shape)
            allowed = np.isfinite(heights) & (np.hypot(near_x, near_y) <= MAX_ESTIMATE_RADIUS_MM)
            heights = np.where(allowed, heights, -np.inf)
            best = int(np.argmax(heights))
            if heights[best] == heights[across.size // 2]:  # no neighbour is higher
                wide /= 2
            elif wide < STRAY_TOL_MM:  # the difference is rounding
                break
            x, y = near_x[best], near_y[best]
        jet = _run(argument, _seeds(np.full(1, x), np.full(1, y), 2), 2)
        top, ax, ay, axx, axy, ayy = (float(np.broadcast_to(part, 1)[0]) for part in jet)
        bend = abs(axx + ayy) / 2 + np.hypot((axx - ayy) / 2, axy)
        wave = np.sqrt(ax**2 + ay**2 + 3 * bend)
    return top, float(np.nan_to_num(wave, posinf=0.0))


def _sample_rays() -> tuple[Floats, Floats]:
    """Return radius and azimuth of the samples from which the feature size is estimated. Each (16, 200)."""
    radius, angle = np.meshgrid(np.linspace(0, MAX_ESTIMATE_RADIUS_MM, 201)[1:], np.arange(16) * np.pi / 8)
    return radius, angle


def _seeds(x: Floats, y: Floats, order: int) -> dict[str, Jet]:
    """Return the jets of the variables off the axis."""
    return {"x": _jet(order, x, 1.0), "y": _jet(order, y, 0.0, 1.0), **_polar(x, y, order)}


def _slopes(steps: tuple[Step, ...], x: Floats, y: Floats) -> tuple[Floats, ...]:
    """Return the value and the slopes of a part of a formula."""
    return tuple(np.broadcast_to(part, x.shape) for part in _run(steps, _seeds(x, y, 1), 1))


def _zeros(divisor: tuple[Step, ...], x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the zeros of a divisor, or the ends of Newton's method, starting from some points."""
    start = np.arctan2(y, x)
    for _ in range(60):  # at a double zero the distance is halved in each step
        value, by_x, by_y = _slopes(divisor, x, y)
        scale = value / (by_x**2 + by_y**2)
        step_x, step_y = (np.where(np.isfinite(scale * by), scale * by, 0) for by in (by_x, by_y))
        x, y = x - step_x, y - step_y
        if not (step_x.any() or step_y.any()):
            break
    # A formula may be undefined exactly on the axis: return a point next to it instead.
    axis = np.hypot(x, y) < 1e-9
    return np.where(axis, 1e-9 * np.cos(start), x), np.where(axis, 1e-9 * np.sin(start), y)


def _constant(name: str, value: float) -> float:
    if not str(name).isidentifier() or name in (*VARIABLES, *NUMBERS, *CALLS, *PAIRS):
        raise InputError(f"constant {name!r} is not an identifier, or is a name of the formula language: rename it")
    return float(value)


def _read(formula: str, numbers: Mapping[str, float]) -> tuple[Step, ...]:
    """Return the steps of a formula in postfix order."""
    text = " ".join(formula.split())
    if not 0 < len(text) <= MAX_CHARACTERS:
        raise InputError(f"a formula has {len(text)} characters, the limits are 1 to {MAX_CHARACTERS}: correct it")
    signs = max(len(re.findall(rf"(?<!\d[eE])(?<=[\w.)]) ?[{pair}]", text)) for pair in ("+-", "*/"))
    if signs > MAX_SIGNS:
        raise InputError(
            f"a formula has {signs} signs + and -, or * and /, the limit is {MAX_SIGNS}: split it into a sum of "
            "several formulas"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as for a number followed by a letter
            tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, Warning) as error:
        raise InputError(
            f"formula {quote(text)} cannot be parsed: write it as in 0.1*x**2 - sin(3*phi), every product with *"
        ) from error
    except (RecursionError, MemoryError) as error:
        raise InputError(
            f"a formula has brackets or terms nested too deeply, the limit is {MAX_NESTING}: simplify it"
        ) from error
    steps: list[Step] = []
    _append(tree.body, text, numbers, steps, MAX_NESTING)
    _require_affordable(tuple(steps))
    return tuple(steps)


def _cost(steps: tuple[Step, ...], operands: list[tuple[slice, ...]]) -> int:
    return sum(
        VARYING_POWER_COST if what == "**" and _varies(steps[spans[-1]]) else COSTS.get(str(what), 1) if spans else 0
        for (_, what), spans in zip(steps, operands, strict=True)
    )


def _require_affordable(steps: tuple[Step, ...]) -> None:
    """Raise if a formula costs too much per point, or if too much of it must be searched for crests and poles."""
    operands = _operands(steps)
    if (cost := _cost(steps, operands)) > COSTLIEST:
        raise InputError(
            f"a formula costs {cost} additions per point, the limit is {COSTLIEST}: simplify it, or give its heights "
            "as a table"
        )
    crests = {steps[spans[0]] for (_, what), spans in zip(steps, operands, strict=True) if what == "exp"}
    searched = sum(map(len, crests)) + sum(map(len, _divisors(steps)))
    if searched > MAX_SEARCH_STEPS:
        raise InputError(
            f"a formula has nested exp and divisors with {searched} steps, the limit is {MAX_SEARCH_STEPS}: simplify "
            "it, or give its heights as a table"
        )


def _operands(steps: tuple[Step, ...]) -> list[tuple[slice, ...]]:
    """Return the spans of the operands of each step: none, one or two."""
    starts: list[int] = []
    operands: list[tuple[slice, ...]] = []
    for at, (kind, _) in enumerate(steps):
        count = {"call": 1, "operator": 2}.get(kind, 0)
        ends = [*starts[len(starts) - count + 1 :], at] if count else []
        begins = starts[len(starts) - count :] if count else []
        operands.append(tuple(map(slice, begins, ends)))
        starts[len(starts) - count :] = [begins[0] if begins else at]
    return operands


def _divisors(steps: tuple[Step, ...]) -> list[tuple[Step, ...]]:
    """Return the divisors of a formula, each once, without constants."""
    divisors: dict[tuple[Step, ...], None] = {}
    for (_, what), spans in zip(steps, _operands(steps), strict=True):
        divisor: tuple[Step, ...] = ()
        if what == "/":
            divisor = steps[spans[1]]
        elif what == "tan":
            divisor = (*steps[spans[0]], ("call", "cos"))
        elif what == "**" and not _varies(power := steps[spans[1]]) and _run(power, {}, 0)[0] < 0:
            divisor = steps[spans[0]]
        if _varies(divisor):
            divisors[divisor] = None
    return list(divisors)


def _varies(steps: tuple[Step, ...]) -> bool:
    return any(kind == "name" for kind, _ in steps)


def _append(node: ast.expr, text: str, numbers: Mapping[str, float], steps: list[Step], depth: int) -> None:
    if depth == 0:
        raise InputError(f"a formula has brackets nested too deeply, the limit is {MAX_NESTING}: simplify it")
    # A long sum is a tree nested to the left; it is unrolled, so that only brackets count as nesting.
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
            steps.append(("number", finite(value, "a number of a formula")))
        case ast.Name(id=name) if name in VARIABLES:
            steps.append(("name", name))
        case ast.Name(id=name) if name in numbers:
            steps.append(("number", numbers[name]))
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            _append(operand, text, numbers, steps, depth)
            if isinstance(node.op, ast.USub):
                steps.append(("call", "negative"))
        case ast.Call(func=ast.Name(id="hypot" | "atan2" as name), args=[first, second], keywords=[]):
            names = (argument.id if isinstance(argument, ast.Name) else "" for argument in (first, second))
            polar = POLAR.get((name, *names))
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
    part = ast.get_source_segment(text, node) or text
    match node:
        case ast.Name(id=name):
            what = f"the name {name!r}, which is unknown"
            remedy = f"use {', '.join((*VARIABLES, *NUMBERS))}, or give it in constants"
        case ast.Call(func=ast.Name(id=name)) if name in ROUGH:
            what, remedy = f"{name}(), which is not smooth", "use a smooth function, for instance sqrt(u**2 + w**2)"
        case ast.Call(func=ast.Name(id=name)) if name in (*CALLS, *PAIRS):
            what, remedy = f"{quote(part)}", f"give {name} {2 if name in PAIRS else 1} plain argument(s)"
        case ast.BinOp(op=ast.BitXor()):
            what, remedy = f"the sign ^ in {quote(part)}", "write ** for a power"
        case ast.Tuple():
            what, remedy = f"a comma in {quote(part)}", "write decimals with a point"
        case _:
            what, remedy = f"{quote(part)}", f"use + - * / ** and {', '.join((*CALLS, *PAIRS))} only"
    raise InputError(f"formula {quote(text)} has {what}: {remedy}")


def _jet(order: int, value: Value, by_x: Value = 0.0, by_y: Value = 0.0) -> Jet:
    """Return the jet of a linear function."""
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
    """Evaluate a formula with a stack of jets; ``watch`` collects calls and divisions."""
    with np.errstate(all="ignore"):
        return _run_steps(steps, seeds, order, watch)


def _run_steps(steps: tuple[Step, ...], seeds: Mapping[str, Jet], order: int, watch: list[Watched] | None) -> Jet:
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
                if watch is not None and what in SCALE_FUNCTIONS:
                    watch.append((at, what, argument, stack[-1]))
            case _, str():
                second = stack.pop()
                first = stack.pop()
                stack.append(OPERATIONS[what](first, second, order))
                if watch is not None and what == "/":
                    watch.append((at, what, second, stack[-1]))
    return stack[0]


def _times(a: Value, b: Value) -> Value:
    """Multiply; a Python float 0.0 is exactly zero, even times infinity, and 1.0 leaves the other factor unchanged."""
    for factor, other in ((a, b), (b, a)):
        if isinstance(factor, float):
            if factor == 0.0:
                return 0.0
            if factor == 1.0:
                return other
    return a * b


def _plus(*terms: Value) -> Value:
    """Add, skipping exact zeros."""
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
    return _sum(a, tuple(-q for q in b), order)


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
    # From q b = a, differentiated, which avoids cancellation.
    q: list[Value] = [a[0] / b[0]]
    if order > 0:
        q += [_divide(_plus(a[i], -_times(q[0], b[i])), b[0]) for i in (1, 2)]
    if order > 1:
        q += [
            _divide(_plus(a[k], -_times(q[i], b[j]), -_times(q[j], b[i]), -_times(q[0], b[k])), b[0])
            for k, i, j in SECOND
        ]
    return tuple(q)


def _divide(a: Value, b: Value) -> Value:
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
        jet += [_divide(_plus(_times(a[0], a[i]), _times(b[0], b[i])), jet[0]) for i in (1, 2)]
    if order > 1:
        jet += [
            _divide(
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
        jet += [_divide(_plus(_times(b[0], a[i]), -_times(a[0], b[i])), square) for i in (1, 2)]
    if order > 1:
        half = [0.0, *(_plus(_times(a[0], a[i]), _times(b[0], b[i])) for i in (1, 2))]
        jet += [
            _divide(
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
