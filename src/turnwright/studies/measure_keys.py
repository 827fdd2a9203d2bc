"""What a function of one's own depends on, so that a kept row of it is never taken for that of another."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial, singledispatch
from types import BuiltinFunctionType, CodeType, EllipsisType, FunctionType, MethodType, ModuleType, NoneType
from typing import Any
from uuid import uuid4

import numpy as np

__all__ = ["sign_of"]


def sign_of(function: Callable[..., Any]) -> str:
    """Return a digest of a function: of its code, what it holds and what it names, the same in every process.

    Of the functions that it names, those of its own package count; the others are taken as they are. One that holds
    what cannot be told, such as an open file, is another one each time.
    """
    parts: list[str] = []
    _add(parts, {}, function)
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _add(parts: list[str], met: dict[int, Any], value: Any) -> None:
    if not isinstance(value, str | bytes | int | float | NoneType):
        if id(value) in met:
            return
        met[id(value)] = value  # kept, so that nothing else gets its number
    for one in _told(value):
        if isinstance(one, _Said):
            parts.append(one)
        else:
            _add(parts, met, one)


class _Said(str):
    """A word for the digest; whatever else `_told` yields is told in turn."""

    __slots__ = ()


@singledispatch
def _told(value: Any) -> Iterator[Any]:
    """Yield words and further values that say what a value is."""
    kind = type(value)
    yield _Said(f"{kind.__module__}.{kind.__qualname__}")
    if not hasattr(value, "__dict__"):
        yield _Said(uuid4().hex)
        return
    yield vars(value)
    yield from (one for one in vars(kind).values() if isinstance(one, FunctionType))


@_told.register(NoneType | bool | int | float | complex | str | bytes | EllipsisType | np.generic)
def _(value: Any) -> Iterator[Any]:
    yield _Said(repr(value))


@_told.register(CodeType)
def _(value: CodeType) -> Iterator[Any]:
    yield _Said(f"code {value.co_code.hex()} {value.co_names} {value.co_varnames} {value.co_freevars}")
    yield value.co_consts


@_told.register(FunctionType)
def _(value: FunctionType) -> Iterator[Any]:
    yield value.__code__
    yield [value.__defaults__, value.__kwdefaults__, *(one.cell_contents for one in value.__closure__ or ())]
    for name in _names(value.__code__):
        one = value.__globals__.get(name)
        if isinstance(one, FunctionType):
            known = one.__module__.partition(".")[0] == value.__module__.partition(".")[0]
        else:
            known = isinstance(one, int | float | str | list | tuple | dict | np.ndarray)
        if known:
            yield one


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names that a function, or one within it, uses."""
    yield from code.co_names
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _names(one)


@_told.register(partial)
def _(value: partial[Any]) -> Iterator[Any]:
    yield from (value.func, value.args, value.keywords)


@_told.register(MethodType)
def _(value: MethodType) -> Iterator[Any]:
    yield from (value.__func__, value.__self__)


@_told.register(type | ModuleType | BuiltinFunctionType | np.ufunc)
def _(value: Any) -> Iterator[Any]:
    yield _Said(f"{getattr(value, '__module__', '')} {value.__name__}")


@_told.register(Mapping)
def _(value: Mapping[Any, Any]) -> Iterator[Any]:
    yield _Said(f"{len(value)} pairs")
    for key, one in value.items():
        yield _Said(repr(key))
        yield one


@_told.register(list | tuple)
def _(value: Any) -> Iterator[Any]:
    yield _Said(f"{len(value)} of")
    yield from value


@_told.register(set | frozenset)
def _(value: Any) -> Iterator[Any]:
    yield _Said(f"set {sorted(map(repr, value))}")  # the order of a set differs from process to process


@_told.register(np.ndarray)
def _(value: np.ndarray) -> Iterator[Any]:
    yield _Said(f"{value.dtype.str} {value.shape}")
    yield from ([_Said(value.tobytes().hex())] if value.dtype.kind in "biufcSU" else [value.tolist()])
