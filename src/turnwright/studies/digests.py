"""Digests of values and user functions, so that a stored result is reused only for the same inputs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import partial, singledispatch
from types import BuiltinFunctionType, CodeType, EllipsisType, FunctionType, MethodType, ModuleType, NoneType
from typing import Any
from uuid import uuid4

import numpy as np

__all__ = ["digest_of"]


def digest_of(value: object) -> str:
    """Return a digest of a value or a function that is the same in all processes.

    The digest of a function covers its code, its defaults and closure, and the module values that it names: functions
    only of its own package. The digest of a dataclass covers its constructor arguments. An object whose contents
    cannot be read, such as an open file, has a new digest each time.
    """
    return _digest(value, {}).hex()


def _digest(value: Any, met: dict[int, tuple[Any, bytes]]) -> bytes:
    if id(value) in met:
        return met[id(value)][1]
    met[id(value)] = value, b"above"  # stops cycles; a reference to the value keeps its id unique
    digest = hashlib.sha256()
    for one in _parts(value):
        if isinstance(one, _Word):
            digest.update(f"{one}\n".encode())
        elif isinstance(one, memoryview):
            digest.update(one)
        else:
            digest.update(_digest(one, met))
    met[id(value)] = value, digest.digest()
    return digest.digest()


class _Word(str):
    """A text that enters the digest; other values that `_parts` yields, except bytes, are digested recursively."""

    __slots__ = ()


@singledispatch
def _parts(value: Any) -> Iterator[Any]:
    """Yield the words and values that identify a value."""
    kind = type(value)
    yield _Word(f"{kind.__module__}.{kind.__qualname__}")
    if is_dataclass(value):
        for one in fields(value):
            if one.init:
                yield from (_Word(one.name), getattr(value, one.name))
        return
    if not hasattr(value, "__dict__"):
        yield _Word(uuid4().hex)
        return
    yield vars(value)
    yield from (one for one in vars(kind).values() if isinstance(one, FunctionType))


@_parts.register(NoneType | bool | int | float | complex | str | bytes | EllipsisType | np.generic)
def _(value: Any) -> Iterator[Any]:
    yield _Word(repr(value))


@_parts.register(CodeType)
def _(value: CodeType) -> Iterator[Any]:
    yield _Word(f"code {value.co_code.hex()} {value.co_names} {value.co_varnames} {value.co_freevars}")
    yield value.co_consts


@_parts.register(FunctionType)
def _(value: FunctionType) -> Iterator[Any]:
    yield value.__code__
    yield [value.__defaults__, value.__kwdefaults__, *(one.cell_contents for one in value.__closure__ or ())]
    for name in _names(value.__code__):
        one = value.__globals__.get(name)
        if isinstance(one, FunctionType):
            is_input = one.__module__.partition(".")[0] == value.__module__.partition(".")[0]
        else:
            is_input = isinstance(one, int | float | str | list | tuple | dict | np.ndarray)
        if is_input:
            yield one


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _names(one)


@_parts.register(partial)
def _(value: partial[Any]) -> Iterator[Any]:
    yield from (value.func, value.args, value.keywords)


@_parts.register(MethodType)
def _(value: MethodType) -> Iterator[Any]:
    yield from (value.__func__, value.__self__)


@_parts.register(type | ModuleType | BuiltinFunctionType | np.ufunc)
def _(value: Any) -> Iterator[Any]:
    yield _Word(f"{getattr(value, '__module__', '')} {value.__name__}")


@_parts.register(Mapping)
def _(value: Mapping[Any, Any]) -> Iterator[Any]:
    yield _Word(f"{len(value)} pairs")
    for key, one in value.items():
        yield _Word(repr(key))
        yield one


@_parts.register(list | tuple)
def _(value: Any) -> Iterator[Any]:
    yield _Word(f"{len(value)} of")
    yield from value


@_parts.register(set | frozenset)
def _(value: Any) -> Iterator[Any]:
    yield _Word(f"set {sorted(map(repr, value))}")  # the order of a set differs from process to process


@_parts.register(np.ndarray)
def _(value: np.ndarray) -> Iterator[Any]:
    yield _Word(f"{value.dtype.str} {value.shape}")
    yield (
        np.ascontiguousarray(value).reshape(-1).view(np.uint8).data if value.dtype.kind in "biufcSU" else value.tolist()
    )
