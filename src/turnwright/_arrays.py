"""Arrays from callers: converted to float64, checked to be finite, read-only once stored."""

from __future__ import annotations

import copyreg
import dataclasses
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turnwright._validate import require_finite
from turnwright.errors import InputError

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Complexes: TypeAlias = NDArray[np.complex128]
Bools: TypeAlias = NDArray[np.bool_]


def _read_only(plain: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(plain)


# Machines, motions and maps hold read-only mappings, which Python cannot pickle without this.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))


STEP_TOL = 1e-6
"""Spread of the steps of an evenly spaced axis, relative to the step."""


def is_even(axis: Floats) -> bool:
    """Whether an ascending axis has two or more points and they are evenly spaced."""
    steps = np.diff(axis)
    return bool(steps.size) and bool(np.ptp(steps) <= STEP_TOL * steps.mean())


BLOCK_POINTS = 1 << 15
"""Points of a block of rows. Arrays of this size stay in the cache, and BLAS does not thread such small products."""


def block_rows(shape: tuple[int, ...]) -> int:
    """Return the number of rows in a block of an array."""
    return max(BLOCK_POINTS // max(math.prod(shape[1:]), 1), 1)


def row_blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    """Yield blocks of the rows of an array, for work on one block after another."""
    count = block_rows(shape)
    return (slice(start, start + count) for start in range(0, shape[0], count))


def frozen(values: ArrayLike, name: str, *, ndim: int | None = 1, finite: bool = True) -> Floats:
    """Return ``values`` as a read-only float64 array, copied only where needed.

    The caller's array stays writable; the returned view is not.

    Raises
    ------
    InputError
        If the values are not numbers, have the wrong number of dimensions, or must be finite and are not.
    """
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} holds a value that is not a number: give numbers only") from error
    if ndim is not None and np.ndim(values) != ndim:
        raise InputError(f"{name} has {np.ndim(values)} dimensions where {ndim} are needed: reshape it")
    if finite:
        require_finite(array, name)
    view = array.view()
    view.flags.writeable = False
    return view


class Compared:  # noqa: PLW1641 - of large arrays
    """A dataclass compared by its input fields, nan equal to nan; not hashable, as it holds large arrays.

    Fields that an instance derives are not compared.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        """Whether the input fields of two instances are equal."""
        if self is other or type(self) is not type(other):
            return self is other or NotImplemented
        return all(same(mine, theirs) for mine, theirs in zip(_stated(self), _stated(other), strict=True))


class Value(Compared):
    """A dataclass compared by its input fields, and hashable."""

    __slots__ = ()

    def __hash__(self) -> int:
        """Return the hash of the input fields."""
        return hash((type(self), *map(hashable, _stated(self))))


def _stated(instance: Any) -> list[Any]:
    if not dataclasses.is_dataclass(instance):  # a surface defined by the user may be any class
        return [id(instance)]
    return [getattr(instance, field.name) for field in dataclasses.fields(instance) if field.init and field.compare]


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal, arrays element by element, nan equal to nan."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        numeric = np.asarray(one).dtype.kind in "fc" and np.asarray(other).dtype.kind in "fc"
        return np.array_equal(one, other, equal_nan=numeric)
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    return bool(one == other)


def hashable(value: Any) -> Any:
    """Return a hashable equivalent of a value; values that `same` finds equal have equal equivalents."""
    if isinstance(value, np.ndarray):
        return value.shape, (np.nan_to_num(value) + 0.0).tobytes()  # + 0.0 turns -0 into 0
    if isinstance(value, tuple | list):
        return tuple(map(hashable, value))
    if isinstance(value, Mapping):
        return frozenset((key, hashable(entry)) for key, entry in value.items())
    return value


SIGMA_PER_MAD = 1.4826
"""Standard deviation of normal noise over its median absolute deviation."""


def robust_scatter(off: Floats) -> float:
    """Return the standard deviation of deviations from a centre by their median absolute value; 0 without any."""
    return SIGMA_PER_MAD * float(np.median(np.abs(off))) if off.size else 0.0


def rounding(values: Floats) -> float:
    """Return the rounding error of a difference of two cumulative values; it grows with the values."""
    return 4 * float(np.spacing(np.abs(values[[0, -1]]).max()))


def rows_of_numbers(lines: Iterable[str], separator: str, *, comments: str | None = None) -> Floats:
    """Return the numbers of lines of text, (rows, columns).

    Raises
    ------
    ValueError
        If there is no line, a cell is not a number, or the lines differ in their count; with a short reason.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NumPy only warns about a table without rows
        try:
            return np.loadtxt(lines, delimiter=separator, ndmin=2, dtype=np.float64, comments=comments)
        except UserWarning:
            raise ValueError("it has no rows") from None
        except ValueError as error:
            raise ValueError(str(error).split(";")[0].rstrip(".")[:100]) from error


def only_read(values: Floats) -> Floats:
    """Return a contiguous, read-only view of an array for a kernel.

    A kernel is compiled again, in seconds, for each combination of writable and read-only arrays.
    """
    view = np.ascontiguousarray(values).view()
    view.flags.writeable = False
    return view


@lru_cache(maxsize=256)
def gauss_rule(count: int) -> tuple[Floats, Floats]:
    """Return nodes and weights of Gauss's rule on [-1, 1]. Each (n,).

    Its eigenvalues cost more than most of the integrals that it serves.
    """
    node, weight = np.polynomial.legendre.leggauss(count)
    return only_read(node), only_read(weight)


def same_length(arrays: Iterable[tuple[str, Floats]]) -> None:
    """Raise unless all named arrays have one length."""
    sizes = {name: array.shape[0] for name, array in arrays}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise InputError(f"the lengths of arrays differ ({listed}): give them all the same number of points")


def freeze(owner: object, names: Sequence[str], optional: Sequence[str] = (), *, of: str = "") -> None:
    """Convert fields of a frozen dataclass to read-only arrays of one length; optional fields may be ``None``.

    In messages ``of`` follows the name of a field.
    """
    present = [*names, *(name for name in optional if getattr(owner, name) is not None)]
    for name in present:
        object.__setattr__(owner, name, frozen(getattr(owner, name), f"{name}{of}"))
    same_length([(name, getattr(owner, name)) for name in present])
