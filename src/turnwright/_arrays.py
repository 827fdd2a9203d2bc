"""Arrays at the border: float64, finite where they must be, read-only once stored."""

from __future__ import annotations

import copyreg
import dataclasses
import warnings
from collections.abc import Iterable, Mapping, Sequence
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


# Machines, motions and maps hold read-only mappings, which Python does not send to another process by itself.
copyreg.pickle(MappingProxyType, lambda one: (_read_only, (dict(one),)))


EVEN = 1e-6
"""Spread of even steps, over the step."""


def is_even(axis: Floats) -> bool:
    """Say whether two or more places that ascend stand in even steps."""
    steps = np.diff(axis)
    return bool(steps.size) and bool(np.ptp(steps) <= EVEN * steps.mean())


def frozen(values: ArrayLike, name: str, *, ndim: int | None = 1, finite: bool = True) -> Floats:
    """Return ``values`` as a read-only float64 array without copying where none is needed.

    The caller's own array stays writable; the view that is stored is not.

    Raises
    ------
    InputError
        If the values are not numbers, have the wrong number of dimensions, or must be finite and are not.
    """
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} holds something that is not a number: give plain numbers") from error
    if ndim is not None and np.ndim(values) != ndim:
        raise InputError(f"{name} has {np.ndim(values)} dimensions where {ndim} are needed: reshape it")
    if finite:
        require_finite(array, name)
    view = array.view()
    view.flags.writeable = False
    return view


class Compared:  # noqa: PLW1641 - of large arrays
    """A dataclass whose instances are equal where what they state is, nan like nan; too large to be hashed.

    What an instance works out from its fields itself is not compared.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        """Tell whether two instances state the same."""
        if self is other or type(self) is not type(other):
            return self is other or NotImplemented
        return all(same(mine, theirs) for mine, theirs in zip(_stated(self), _stated(other), strict=True))


class Value(Compared):
    """A dataclass that can be hashed, too: what a user states."""

    __slots__ = ()

    def __hash__(self) -> int:
        """Return a number that equal instances share."""
        return hash((type(self), *map(hashable, _stated(self))))


def _stated(one: Any) -> list[Any]:
    if not dataclasses.is_dataclass(one):  # a surface of a user's own may be any class
        return [id(one)]
    return [getattr(one, field.name) for field in dataclasses.fields(one) if field.init and field.compare]


def same(one: Any, other: Any) -> bool:
    """Say whether two values are equal, arrays element by element, nan like nan."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        numeric = np.asarray(one).dtype.kind in "fc" and np.asarray(other).dtype.kind in "fc"
        return np.array_equal(one, other, equal_nan=numeric)
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    return bool(one == other)


def hashable(one: Any) -> Any:
    """Return something that can be hashed, the same of all that `same` holds for equal."""
    if isinstance(one, np.ndarray):
        return one.shape, (np.nan_to_num(one) + 0.0).tobytes()  # which makes 0 of -0 too
    if isinstance(one, tuple | list):
        return tuple(map(hashable, one))
    if isinstance(one, Mapping):
        return frozenset((key, hashable(value)) for key, value in one.items())
    return one


NORMAL = 1.4826
"""Standard deviation of normal noise over the median of its size."""


def robust_scatter(off: Floats) -> float:
    """Return the standard deviation of what is off a centre, as the median of its size tells it."""
    return NORMAL * float(np.median(np.abs(off)))


def rounding(values: Floats) -> float:
    """Return by how much the difference of two cumulative values may be off, as rounding grows with the values."""
    return 4 * float(np.spacing(np.abs(values[[0, -1]]).max()))


def rows_of_numbers(lines: Iterable[str], separator: str, *, comments: str | None = None) -> Floats:
    """Return the numbers of lines of text, (rows, columns).

    Raises
    ------
    ValueError
        If there is no line, or they hold anything else or not as many numbers each; the reason in a few letters.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NumPy only warns of a table without a row
        try:
            return np.loadtxt(lines, delimiter=separator, ndmin=2, dtype=np.float64, comments=comments)
        except UserWarning:
            raise ValueError("it has no rows") from None
        except ValueError as error:
            raise ValueError(str(error).split(";")[0].rstrip(".")[:100]) from error


def only_read(values: Floats) -> Floats:
    """Return an array as a kernel takes what it only reads: contiguous and not to be written.

    A kernel is compiled anew for each mixture of arrays that may be written and that may not, which costs seconds.
    """
    view = np.ascontiguousarray(values).view()
    view.flags.writeable = False
    return view


def same_length(arrays: Iterable[tuple[str, Floats]]) -> None:
    """Raise unless all named arrays have one length."""
    sizes = {name: array.shape[0] for name, array in arrays}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise InputError(
            f"arrays that belong together differ in length ({listed}): give them all the same number of points"
        )


def freeze(owner: object, names: Sequence[str], optional: Sequence[str] = (), *, of: str = "") -> None:
    """Make arrays of one length of the fields of a frozen dataclass; those that are optional may be ``None``.

    What the fields are said to be ``of`` follows their names in errors.
    """
    given = [*names, *(name for name in optional if getattr(owner, name) is not None)]
    for name in given:
        object.__setattr__(owner, name, frozen(getattr(owner, name), f"{name}{of}"))
    same_length([(name, getattr(owner, name)) for name in given])
