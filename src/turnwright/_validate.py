"""The rules for what a caller gives: numbers, angles, counts, spans, paths, objects of Turnwright and callbacks.

Every dataclass that a user states calls `check_numbers` first, so that the rest of it may rely on its numbers.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import os
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from turnwright.errors import InputError, shown
from turnwright.units import LEAST, MOST

__all__ = [
    "between",
    "check_angle",
    "check_azimuths",
    "check_cumulative",
    "check_numbers",
    "finite",
    "finite_tuple",
    "key_of",
    "listener",
    "number",
    "path",
    "plausible_sizes",
    "positive",
    "require_finite",
    "span",
    "thing",
    "whole",
]

T = TypeVar("T")

WHOLE = re.compile(r"(int|Count|Ints|Natural|tuple\[int, \.\.\.\])( \| None)?")
"""The types of fields that hold whole numbers."""

PLAIN = re.compile(
    r"(int|float|Angle|Count|Feed|Length|Natural|Number|Radius|Size|Slope|Speed|Step|Thickness)( \| None)?"
)
"""The types of fields that hold one number."""

LONGEST = 64
"""Entries of a list that are looked at one by one; a longer one is made an array first."""


def check_numbers(one: Any, *, inf: Collection[str] = (), nan: Collection[str] = ()) -> None:
    """Raise unless every number in the fields of a dataclass is finite, and whole where its type is that.

    Looks into arrays, tuples, lists and mappings; the keys of a mapping must be whole or no numbers at all. Fields that
    the class works out itself are left to it.

    Parameters
    ----------
    one
        A dataclass with its fields as the caller gave them.
    inf, nan
        Names of the fields that may hold infinity, and not a number.

    Raises
    ------
    InputError
        With the field and the number.
    """
    kind: Any = type(one)
    for name, plain, may_lack, whole in _fields_of(kind):
        value = getattr(one, name)
        if plain and not (value is None and may_lack):
            number(value, name)
        _Rule(whole=whole, inf=name in inf, nan=name in nan).check(value, name)


@cache
def _fields_of(kind: type) -> list[tuple[str, bool, bool, bool]]:
    """Return the fields that a caller gives: name, whether of one number, or of none, and whether whole."""
    return [
        (
            one.name,
            bool(PLAIN.fullmatch(stated)),
            one.default is None or "None" in stated,
            bool(WHOLE.fullmatch(stated)),
        )
        for one in dataclasses.fields(kind)
        if one.init
        for stated in [str(one.type)]
    ]


@dataclasses.dataclass(frozen=True, slots=True)
class _Rule:
    """What the numbers of a field must be."""

    whole: bool
    inf: bool = False
    nan: bool = False

    def check(self, value: object, name: str, verb: str = "is") -> None:
        if type(value) is float and not self.whole and math.isfinite(value):  # as most are
            return
        if isinstance(value, numbers.Real) and not isinstance(value, bool):
            self._check_number(value, f"{name} {verb}")
        elif isinstance(value, np.ndarray):
            self._check_array(value, name)
        elif isinstance(value, Mapping):
            for key, held in value.items():
                _Rule(whole=True).check(key, f"a key of {name}")
                self.check(held, f"{name}[{key!r}]")
        elif isinstance(value, tuple | list) and len(value) <= LONGEST:
            for held in value:
                self.check(held, name, "holds")
        elif isinstance(value, tuple | list):
            with suppress(TypeError, ValueError, OverflowError):  # where it is no table of numbers its class says so
                self._check_array(np.asarray(value, dtype=np.float64), name)

    def _check_number(self, value: numbers.Real, what: str) -> None:
        plain = number(value, what)
        if self.whole and not isinstance(value, numbers.Integral):
            raise InputError(f"{what} {shown(value)}, it must be a whole number: give one")
        if not math.isfinite(plain) and not (self.nan if math.isnan(plain) else self.inf):
            raise InputError(f"{what} {plain:g}, it must be finite{' or infinite' * self.inf}: correct it")

    def _check_array(self, values: NDArray[Any], name: str) -> None:
        if values.dtype.kind not in "fciu":
            return
        if self.whole and values.dtype.kind not in "iu":
            raise InputError(f"{name} holds numbers of the type {values.dtype}, they must be whole: give integers")
        if not self.nan:
            require_finite(values, name)
        elif count := int(np.count_nonzero(np.isinf(values))):
            raise InputError(f"{name} holds {count} infinite values, the limit is 0: mark what is missing with nan")


def require_finite(values: NDArray[Any], name: str) -> None:
    """Raise unless all of an array is finite."""
    if count := int(np.count_nonzero(~np.isfinite(values))):
        raise InputError(f"{name} holds {count} values that are not finite, the limit is 0: remove or replace them")


def finite(value: object, name: str) -> float:
    """Return a number as one of Python, which is finite."""
    plain = number(value, name)
    if not math.isfinite(plain):
        raise InputError(f"{name} is {plain:g}, it must be a finite number: correct it")
    return plain


def finite_tuple(values: Sequence[float], name: str, size: int) -> tuple[float, ...]:
    """Return so many finite numbers as a tuple."""
    if np.shape(values) != (size,):
        raise InputError(f"{name} is {shown(values)}, it must be {size} finite numbers: complete it")
    return tuple(finite(value, name) for value in values)


def positive(value: float, name: str, unit: str) -> float:
    """Return ``value`` if it is a number above zero, of a size that is none by a slip."""
    plain = number(value, name)
    if not math.isfinite(plain) or plain <= 0:
        raise InputError(f"{name} is {plain:g} {unit}, it must be finite and above 0 {unit}: give a positive value")
    if not LEAST <= plain <= MOST:
        raise InputError(
            f"{name} is {plain:g} {unit}, the limits are {LEAST:g} to {MOST:g} {unit}: check its exponent and its unit"
        )
    return plain


def key_of(name: str) -> str:
    """Return the key by which a file states the size of an error source."""
    return name.lower().replace(" ", "_")


def plausible_sizes(sizes: Mapping[str, float], units: Mapping[str, str]) -> Mapping[str, float]:
    """Return sizes of error sources, each one standard deviation, if each is positive and of a known source."""
    for name, size in sizes.items():
        if name not in units:
            raise InputError(f"plausible has {shown(str(name))}, it can have {', '.join(units)}: name one of them")
        positive(size, f"plausible {name}", units[name])
    return MappingProxyType(dict(sizes))


def between(value: float, name: str, low: float, high: float, unit: str) -> float:
    """Return ``value`` if it lies in the closed interval [low, high]."""
    if not low <= value <= high:
        raise InputError(f"{name} is {value:g} {unit}, the limits are {low:g} to {high:g} {unit}: give a value between")
    return float(value)


IN_RAD = "a plain number is in rad"
"""The remedy for an angle that is beyond its limits."""

COARSE_STEP = 0.5
"""Step of a spiral from which a whole part of 360 is taken for degrees: in radians, 12 points a turn. [rad]"""


def check_angle(
    value: float, name: str, low: float = -2 * math.pi, high: float = 2 * math.pi, remedy: str = IN_RAD
) -> float:
    """Return an angle of at most one turn either way, or within its own limits. [rad]."""
    plain = finite(value, name)
    if not low <= plain <= high:
        limits = f"{low:.4g} to {high:.4g} rad ({math.degrees(low):.4g} to {math.degrees(high):.4g} deg)"
        raise InputError(f"{name} is {plain:g} rad ({math.degrees(plain):.6g} deg), the limits are {limits}: {remedy}")
    return plain


def check_azimuths(values: NDArray[np.float64], name: str) -> None:
    """Raise if azimuths reach over more than a turn. (n,) [rad]."""
    span = float(np.ptp(values)) if values.size else 0.0
    if span > 2 * math.pi * (1 + 1e-9):
        raise InputError(f"{name} reaches over {span:.4g} rad, the limit is one turn, 6.283 rad: {IN_RAD}")


def check_cumulative(angle: NDArray[np.float64], name: str) -> None:
    """Raise if angles of many turns, in order, are counted in degrees. (n,) [rad].

    Coarse even steps of a whole part of 360, or a whole number of times 360 from end to end, are no chance.
    """
    span = abs(float(angle[-1] - angle[0]))
    step = span / (angle.size - 1)
    if span + step < 360 * (1 - 1e-9):
        return
    steps = np.abs(np.diff(angle))
    even = step >= COARSE_STEP and np.ptp(steps) < 1e-6 * step
    counts = [span / 360, 360 / step] if even else [span / 360]
    if any(abs(count - round(count)) <= 1e-12 * count for count in counts):
        raise InputError(
            f"{name} runs over {span:.10g} rad in steps of {step:.6g} rad, which are degrees, 360 to a turn: {IN_RAD}, "
            "multiply by pi/180"
        )


def number(value: object, name: str) -> float:
    """Return a number as one of Python, which may be infinite or nan."""
    if type(value) is float:  # as most are
        return value
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise InputError(f"{name} is beyond the range of numbers, about 1e308: give a smaller value") from None
    raise InputError(f"{name} is {shown(value)}, it must be a number: give one")


def whole(value: object, name: str, low: int, high: int | None = None) -> int:
    """Return a whole number within its limits."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        found = int(value)
        if found >= low and (high is None or found <= high):
            return found
    limit = f"at least {low}" if high is None else f"{low} to {high}"
    raise InputError(f"{name} is {shown(value)}, it must be a whole number, {limit}: give one")


def span(value: object, name: str) -> tuple[float, float]:
    """Return two finite numbers that ascend."""
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) != 2:
        raise InputError(f"{name} is {shown(value)}, it must be first and last: give two numbers")
    low, high = (number(one, name) for one in value)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"{name} is {low:g} to {high:g}, it must ascend: let both be finite, the smaller first")
    return low, high


def path(value: object, name: str) -> str:
    """Return the text of a path or a URL."""
    found = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(found, str) or not found or "\0" in found:
        raise InputError(f"{name} is {shown(value)}, it must be a path: give one")
    return found


def thing(value: T, kind: type[Any], name: str) -> T:
    """Return a value that must be of some kind."""
    if isinstance(value, kind):
        return value
    raise InputError(f"{name} is {shown(value)}, it must be a {kind.__name__}: give one")


def listener(progress: object) -> None:
    """Raise unless what is to be told of the progress can be called, or is None."""
    if progress is not None and not callable(progress):
        raise InputError(
            f"the progress is told to a {type(progress).__name__}, it must be a function of how many are done and all: "
            "give one, or none"
        )
