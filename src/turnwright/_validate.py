"""Checks of arguments: numbers, angles, counts, ranges, paths, objects of Turnwright and callbacks.

Every public dataclass calls `check_numbers` first in ``__post_init__``.
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

from turnwright.errors import InputError, quote
from turnwright.units import LEAST, MOST

__all__ = [
    "between",
    "check_angle",
    "check_azimuths",
    "check_cumulative",
    "check_index",
    "check_numbers",
    "check_obscuration",
    "check_wavelength",
    "finite",
    "finite_tuple",
    "has_finite_sum",
    "instance_of",
    "key_of",
    "listener",
    "number",
    "one_of",
    "path",
    "plausible_sizes",
    "positive",
    "require_finite",
    "span",
    "whole_number",
]

T = TypeVar("T")

INTEGER_TYPE = re.compile(r"(int|Count|Ints|Natural|tuple\[int, \.\.\.\])( \| None)?")

SCALAR_TYPE = re.compile(
    r"(int|float|Angle|Count|Feed|Length|Natural|Number|Radius|Size|Slope|Speed|Step|Thickness)( \| None)?"
)

SHORTEST_MM, LONGEST_MM = 1e-6, 1.0
"""Wavelengths of light; one beyond has a wrong unit."""

HIGHEST_INDEX = 10.0

MAX_SCALAR_CHECKS = 64
"""Entries of a list that are checked one by one; a longer list is converted to an array first."""


def check_numbers(instance: Any, *, inf: Collection[str] = (), nan: Collection[str] = ()) -> None:
    """Raise unless every number in the fields of a dataclass is finite, and an integer where its type is.

    Arrays, tuples, lists and mappings are searched too; numeric keys of a mapping must be integers. Derived fields
    (``init=False``) are not checked; the fields named in ``inf`` and ``nan`` may hold infinity or nan.
    """
    kind: Any = type(instance)
    for name, scalar, may_lack, integer in _fields_of(kind):
        value = getattr(instance, name)
        if scalar and not (value is None and may_lack):
            number(value, name)
        _Rule(integer=integer, inf=name in inf, nan=name in nan).check(value, name)


@cache
def _fields_of(kind: type) -> list[tuple[str, bool, bool, bool]]:
    """Return the fields that a caller gives: name, whether of one number, whether it may lack, whether an integer."""
    return [
        (
            field.name,
            bool(SCALAR_TYPE.fullmatch(stated)),
            field.default is None or "None" in stated,
            bool(INTEGER_TYPE.fullmatch(stated)),
        )
        for field in dataclasses.fields(kind)
        if field.init
        for stated in [str(field.type)]
    ]


@dataclasses.dataclass(frozen=True, slots=True)
class _Rule:
    """Which numbers a field may hold."""

    integer: bool
    inf: bool = False
    nan: bool = False

    def check(self, value: object, name: str, verb: str = "is") -> None:
        if type(value) is float and not self.integer and math.isfinite(value):  # as most are
            return
        if isinstance(value, numbers.Real) and not isinstance(value, bool):
            self._check_number(value, f"{name} {verb}")
        elif isinstance(value, np.ndarray):
            self._check_array(value, name)
        elif isinstance(value, Mapping):
            for key, entry in value.items():
                _Rule(integer=True).check(key, f"a key of {name}")
                self.check(entry, f"{name}[{key!r}]")
        elif isinstance(value, tuple | list) and len(value) <= MAX_SCALAR_CHECKS:
            for entry in value:
                self.check(entry, name, "holds")
        elif isinstance(value, tuple | list):
            with suppress(TypeError, ValueError, OverflowError):  # the class itself rejects what is no table of numbers
                self._check_array(np.asarray(value, dtype=np.float64), name)

    def _check_number(self, value: numbers.Real, what: str) -> None:
        plain = number(value, what)
        if self.integer and not isinstance(value, numbers.Integral):
            raise InputError(f"{what} {quote(value)}, it must be a whole number: give one")
        if not math.isfinite(plain) and not (self.nan if math.isnan(plain) else self.inf):
            raise InputError(f"{what} {plain:g}, it must be finite{' or infinite' * self.inf}: correct it")

    def _check_array(self, values: NDArray[Any], name: str) -> None:
        if values.dtype.kind not in "fciu":
            return
        if self.integer and values.dtype.kind not in "iu":
            raise InputError(f"{name} holds numbers of the type {values.dtype}, they must be whole: give integers")
        if not self.nan:
            require_finite(values, name)
        elif not has_finite_sum(values) and (count := int(np.count_nonzero(np.isinf(values)))):
            raise InputError(f"{name} holds {count} infinite values, the limit is 0: mark missing values with nan")


def require_finite(values: NDArray[Any], name: str) -> None:
    """Raise unless all values of an array are finite."""
    if not has_finite_sum(values) and (count := int(np.count_nonzero(~np.isfinite(values)))):
        raise InputError(f"{name} holds {count} values that are not finite, the limit is 0: remove or replace them")


def has_finite_sum(values: NDArray[Any]) -> bool:
    """Whether the sum of an array is finite, as it is only if all values are: a third of the time of a test of each."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.asarray(values).sum()))


def finite(value: object, name: str) -> float:
    """Return a finite number as a float."""
    plain = number(value, name)
    if not math.isfinite(plain):
        raise InputError(f"{name} is {plain:g}, it must be a finite number: correct it")
    return plain


def finite_tuple(values: Sequence[float], name: str, size: int) -> tuple[float, ...]:
    """Return ``size`` finite numbers as a tuple."""
    if np.shape(values) != (size,):
        raise InputError(f"{name} is {quote(values)}, it must be {size} finite numbers: complete it")
    return tuple(finite(value, name) for value in values)


def positive(value: float, name: str, unit: str) -> float:
    """Return ``value`` if it is a number above zero, from `LEAST` to `MOST`."""
    plain = number(value, name)
    if not math.isfinite(plain) or plain <= 0:
        raise InputError(f"{name} is {plain:g} {unit}, it must be finite and above 0 {unit}: give a positive value")
    if not LEAST <= plain <= MOST:
        raise InputError(
            f"{name} is {plain:g} {unit}, the limits are {LEAST:g} to {MOST:g} {unit}: check its exponent and its unit"
        )
    return plain


def check_wavelength(wavelength: float) -> float:
    """Return a wavelength of light, from soft X-rays to submillimetre waves. [mm]."""
    positive(wavelength, "the wavelength", "mm")
    return between(wavelength, "the wavelength", SHORTEST_MM, LONGEST_MM, "mm")


def check_obscuration(obscuration: float) -> float:
    """Return the radius of a central obscuration over that of the pupil."""
    if not 0 <= obscuration < 1:
        raise InputError(
            f"obscuration is {obscuration:g}, it must be 0 or more and below 1: give the ratio of the radii"
        )
    return obscuration


def check_index(index: float) -> float:
    """Return the refractive index of a material."""
    if not 1.0 < number(index, "index") <= HIGHEST_INDEX:
        raise InputError(
            f"index is {index:g}, it must be above 1 and at most {HIGHEST_INDEX:g}: give that of the material, or "
            "leave it out for a mirror"
        )
    return float(index)


def key_of(name: str) -> str:
    """Return the key of an error source in a file."""
    return name.lower().replace(" ", "_")


def plausible_sizes(sizes: Mapping[str, float], units: Mapping[str, str]) -> Mapping[str, float]:
    """Return sizes of error sources (standard deviations) if each is positive and of a known source."""
    for name, size in sizes.items():
        if name not in units:
            raise InputError(f"plausible has {quote(str(name))}, it can have {', '.join(units)}: name one of them")
        positive(size, f"plausible {name}", units[name])
    return MappingProxyType(dict(sizes))


def between(value: float, name: str, low: float, high: float, unit: str) -> float:
    """Return ``value`` if it lies in the closed interval [low, high]."""
    if not low <= value <= high:
        raise InputError(f"{name} is {value:g} {unit}, the limits are {low:g} to {high:g} {unit}: give a value between")
    return float(value)


def one_of(value: object, name: str, options: Collection[object]) -> None:
    """Raise unless a value is one of the options."""
    if value not in options:
        *others, last = (f'"{option}"' if isinstance(option, str) else str(option) for option in options)
        listed = f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{name} is {quote(value)}, it must be {listed}: choose one of them")


IN_RAD = "a plain number is in rad"

MIN_DEGREE_STEP = 0.5
"""Step of a spiral from which an even divisor of 360 is taken for degrees: in radians, 12 points per revolution."""


def check_angle(
    value: float, name: str, low: float = -2 * math.pi, high: float = 2 * math.pi, remedy: str = IN_RAD
) -> float:
    """Return an angle within its limits, by default one turn either way. [rad]."""
    plain = finite(value, name)
    if not low <= plain <= high:
        limits = f"{low:.4g} to {high:.4g} rad ({math.degrees(low):.4g} to {math.degrees(high):.4g} deg)"
        raise InputError(f"{name} is {plain:g} rad ({math.degrees(plain):.6g} deg), the limits are {limits}: {remedy}")
    return plain


def check_azimuths(values: NDArray[np.float64], name: str) -> None:
    """Raise if azimuths span more than one turn. (n,) [rad]."""
    span = float(np.ptp(values)) if values.size else 0.0
    if span > 2 * math.pi * (1 + 1e-9):
        raise InputError(f"{name} spans {span:.4g} rad, the limit is one turn, 6.283 rad: {IN_RAD}")


def check_cumulative(angle: NDArray[np.float64], name: str) -> None:
    """Raise if cumulative angles are evidently in degrees. (n,) [rad].

    Evidence is a coarse even step that divides 360, or a span that is a multiple of 360.
    """
    span = abs(float(angle[-1] - angle[0]))
    step = span / (angle.size - 1)
    if span + step < 360 * (1 - 1e-9):
        return
    is_coarse_and_even = step >= MIN_DEGREE_STEP and np.ptp(np.abs(np.diff(angle))) < 1e-6 * step
    counts = [span / 360, 360 / step] if is_coarse_and_even else [span / 360]
    if any(abs(count - round(count)) <= 1e-12 * count for count in counts):
        raise InputError(
            f"{name} spans {span:.10g} rad in steps of {step:.6g} rad, which look like degrees, 360 per turn: "
            f"{IN_RAD}, multiply by pi/180"
        )


def number(value: object, name: str) -> float:
    """Return a number as a float, which may be infinite or nan."""
    if type(value) is float:  # as most are
        return value
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise InputError(f"{name} is beyond the range of numbers, about 1e308: give a smaller value") from None
    raise InputError(f"{name} is {quote(value)}, it must be a number: give one")


def whole_number(value: object, name: str, low: int, high: int | None = None) -> int:
    """Return an integer within its limits."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        integer = int(value)
        if integer >= low and (high is None or integer <= high):
            return integer
    limit = f"at least {low}" if high is None else f"{low} to {high}"
    raise InputError(f"{name} is {quote(value)}, it must be a whole number, {limit}: give one")


def span(value: object, name: str) -> tuple[float, float]:
    """Return two finite numbers in ascending order."""
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) != 2:
        raise InputError(f"{name} is {quote(value)}, it must be first and last: give two numbers")
    low, high = (number(end, name) for end in value)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"{name} is {low:g} to {high:g}, it must ascend: give finite values, the smaller first")
    return low, high


def path(value: object, name: str) -> str:
    """Return the text of a path or a URL."""
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or not text or "\0" in text:
        raise InputError(f"{name} is {quote(value)}, it must be a path: give one")
    return text


def instance_of(value: T, kind: type[Any], name: str) -> T:
    """Return a value if it is an instance of a class."""
    if isinstance(value, kind):
        return value
    raise InputError(f"{name} is {quote(value)}, it must be a {kind.__name__}: give one")


def listener(progress: object) -> None:
    """Raise unless a progress callback can be called, or is None."""
    if progress is not None and not callable(progress):
        raise InputError(f"progress is a {type(progress).__name__}, it must be a function of (done, total): give one")
