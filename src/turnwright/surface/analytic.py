"""Common code of the closed-form families: terms, conic base, and calls of the kernels."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import numpy as np

from turnwright._arrays import frozen
from turnwright._kernels import quadrics
from turnwright._validate import check_numbers, finite, whole_number
from turnwright.errors import InputError, JobError
from turnwright.surface.base import Surface
from turnwright.units import LEAST, MOST, unit

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema

    from turnwright._arrays import Bools, Floats

__all__ = [
    "MAX_DEGREE",
    "Coefficients",
    "OnConic",
    "Radius",
    "Terms",
    "changing_length",
    "check_radius",
    "even_coefficients",
    "even_power",
    "farthest",
    "index_of",
    "indices_of",
    "read_terms",
    "summed",
    "whole_pair",
]

K = TypeVar("K")


class Coefficients:
    """Annotation of coefficients, whose keys and units are in `Surface.series`."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        return core_schema.any_schema()


Terms: TypeAlias = Annotated[Mapping[K, float] | Iterable[tuple[K, float]], Coefficients]
"""Coefficients by key; stored as sorted pairs, so that a prescription can be compared and pickled."""

MAX_DEGREE = 100
"""Largest degree of a polynomial, far beyond any prescription."""


class _Radius(unit):
    """A vertex radius: a length, or the word "flat" for an infinite one."""

    __slots__ = ()

    def read(self, text: object) -> float:
        """Return the radius. [mm]."""
        return float("inf") if text == "flat" else super().read(text)

    def within(self, value: float, given: object) -> float:
        """Return a radius within the limits, or an infinite one."""
        return value if value == float("inf") else super().within(value, given)

    def show(self, value: float | None) -> str | None:
        """Return text that `read` reads back to the same number."""
        return "flat" if value == float("inf") else super().show(value)


Radius: TypeAlias = Annotated[float, _Radius("mm")]

_DIGITS = "[0-9]{1,9}"
"""Pattern of an index."""


def index_of(key: str) -> int:
    """Return the index in a key of a job file."""
    if re.fullmatch(_DIGITS, key) is None:
        raise JobError(f"the key {key!r} is not a whole number: name each coefficient by its number")
    return int(key)


def indices_of(key: str) -> tuple[int, int]:
    """Return the two indices in a key of a job file, such as "2,0"."""
    match = re.fullmatch(rf"\s*({_DIGITS})\s*,\s*(-?{_DIGITS})\s*", key)
    if match is None:
        raise JobError(f"the key {key!r} is not two whole numbers: name each coefficient like '2,0'")
    return int(match.group(1)), int(match.group(2))


def whole_pair(key: object, what: str) -> tuple[int, int]:
    """Return ``key`` if it is two integers, of which the second may be negative."""
    if not isinstance(key, tuple | list) or len(key) != 2:
        raise InputError(f"{what} is {key!r}, it must be a pair of whole numbers: give two of them")
    return whole_number(key[0], what, 0), whole_number(key[1], what, -MAX_DEGREE)


def read_terms(terms: Terms[Any], what: str, key: Callable[[object], K]) -> tuple[tuple[K, float], ...]:
    """Return the terms as sorted (key, coefficient) pairs, each key checked by ``key``.

    Raises
    ------
    InputError
        If a coefficient is not finite or a key is repeated.
    """
    coefficients: dict[K, float] = {}
    for name, value in terms.items() if isinstance(terms, Mapping) else terms:
        place = key(name)
        if place in coefficients:
            raise InputError(f"{what} has the term {name!r} twice, only one is allowed: add the two coefficients")
        coefficients[place] = finite(value, f"the coefficient of term {name!r} of {what}")
    return tuple(sorted(coefficients.items()))


def even_power(what: str) -> Callable[[object], int]:
    """Return the check of a term's key that is an even power of at least 2, in ``what``."""

    def check(key: object) -> int:
        power = whole_number(key, f"the power of a term of {what}", 0)
        if power < 2 or power % 2 or power > MAX_DEGREE:
            raise InputError(
                f"the power of a term of {what} is {power}, it must be even and from 2 to {MAX_DEGREE}: name each term "
                "by its power, 4 for r^4"
            )
        return power

    return check


def even_coefficients(terms: Terms[int]) -> Floats:
    """Return the coefficients of the even powers 0, 2, ... as an array."""
    pairs = dict(terms)
    coefficients = np.zeros(1 + max(pairs, default=0) // 2)
    for power, value in pairs.items():
        coefficients[power // 2] = value
    return frozen(coefficients, "coefficients")


def check_radius(radius: float, what: str) -> None:
    """Raise unless a vertex radius is infinite, or of a size that a part can have."""
    if not (LEAST <= abs(radius) <= MOST or np.isinf(radius)):
        raise InputError(
            f"{what} is {radius:g} mm, it must not be 0, and its size is limited to {LEAST:g} to {MOST:g} mm: give it "
            "positive for concave, negative for convex, infinite for a flat"
        )


def summed(x: Floats, y: Floats, order: int, *steps: tuple[Any, ...]) -> tuple[Floats, ...]:
    """Return the sum of kernels; each step is a kernel and its parameters.

    A read-only array is copied first, as it has another type for numba, which would compile every kernel again.
    """
    px, py = (part.ravel() if part.flags.writeable else part.flatten() for part in (x, y))
    out = np.zeros(((1, 3, 6)[order], x.size))
    for kernel, *parameters in steps:
        kernel(px, py, *parameters, out)
    return tuple(row.reshape(x.shape) for row in out)


def farthest(values: Floats) -> float:
    """Return the largest magnitude of some values, nan if one is nan."""
    return max(float(values.max()), -float(values.min())) if values.size else 0.0


def changing_length(sizes: Mapping[int, float]) -> float:
    """Estimate the length over which the curvature of a polynomial changes by its own size.

    Parameters
    ----------
    sizes
        Size of the homogeneous part of each degree d, about its largest value at distance 1. [mm^(1-d)]

    Returns
    -------
    float
        The smallest ratio of second to third derivative over all distances at which degrees above the lowest matter,
        or ``inf`` if only one degree has curvature. [mm]
    """
    bending = np.array(sorted((d, d * (d - 1) * abs(size)) for d, size in sizes.items() if d >= 2 and size != 0))
    if len(bending) < 2:
        return float("inf")
    d, q = bending.T
    # In logarithms, as powers of a distance may overflow; second derivative / third is r sum(w) / sum((d - 2) w).
    log_q = np.log(q)
    first = np.min((log_q[0] - log_q[1:]) / (d[1:] - d[0]))
    last = np.max((log_q[:-1] - log_q[-1]) / (d[-1] - d[:-1]))
    log_r = np.linspace(first, max(first, last), 64)[:, None]
    weight = log_q + (d - 2) * log_r
    weight = np.exp(weight - weight.max(axis=1, keepdims=True))
    log_ratio = log_r[:, 0] + np.log(weight.sum(axis=1) / ((d - 2) * weight).sum(axis=1))
    return float(np.exp(min(log_ratio.min(), 700.0)))


class OnConic(Surface):
    """A surface based on a conic of revolution, defined where the conic is."""

    __slots__ = ()
    if TYPE_CHECKING:
        radius: Radius
        conic: float

    def __post_init__(self) -> None:
        check_numbers(self, inf=("radius",))
        check_radius(self.radius, f"the radius of a {self.family}")

    @property
    def base(self) -> tuple[float, float]:
        """Vertex curvature and conic constant. [1/mm, 1]."""
        return 1 / self.radius, float(self.conic)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height of the conic and its derivatives. See `Surface.evaluate`."""
        return summed(x, y, order, (quadrics.conic, self.base))

    @property
    def _squared(self) -> float:
        c, k = self.base
        return (1 + k) * c * c

    @property
    def reach(self) -> float:
        """Distance from the axis at which the conic is vertical. [mm]."""
        return self.conic_length if self._squared > 0 else float("inf")

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where the conic is defined."""
        if self._squared <= 0:
            return None
        far_x, far_y = farthest(x), farthest(y)
        if 1 - self._squared * (far_x * far_x + far_y * far_y) > 0:  # most points are far inside
            return np.ones(x.shape, dtype=np.bool_)
        with np.errstate(over="ignore"):
            return 1 - self._squared * (x * x + y * y) > 0

    @property
    def of_revolution(self) -> bool:
        """Whether the surface is known to be one of revolution about the axis."""
        return True

    @property
    def domain(self) -> str:
        """The domain of the surface in words."""
        return "the whole plane" if np.isinf(self.reach) else f"the disc of radius {self.reach:.6g} mm about its axis"

    @property
    def feature_size(self) -> float:
        """Length over which the curvature changes. [mm]."""
        return self.conic_length

    @property
    def conic_length(self) -> float:
        """Length over which the curvature of the conic changes. [mm]."""
        return float(1 / np.sqrt(abs(self._squared))) if self._squared else float("inf")
