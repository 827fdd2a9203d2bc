"""What a caller gave, when it must be a number, a count, a span, a path, a thing of ours or who listens."""

from __future__ import annotations

import math
import numbers
import os
from collections.abc import Sequence
from typing import Any, TypeVar

from turnwright.errors import InputError, shown

__all__ = ["listener", "number", "path", "span", "thing", "whole"]

T = TypeVar("T")


def number(value: object, name: str) -> float:
    """Return a number as one of Python, which may be infinite or nan."""
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
