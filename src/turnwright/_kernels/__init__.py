"""The compiled kernels: plain arrays in, plain arrays out.

A kernel is compiled at its first call. Until then nothing of numba is imported, which costs 0.35 s, so that the modules
of kernels are imported like any other.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any

__all__ = ["Kernel", "jit", "jit_exact", "jit_inline", "jit_sums"]

_LOCK = threading.RLock()


class Kernel:
    """A function of plain arrays that numba compiles at its first call; other kernels may call it."""

    def __init__(self, function: Callable[..., Any], fastmath: set[str], *, inline: bool = False) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._fastmath = fastmath
        self._inline = inline
        self._dispatcher: Any = None

    @property
    def dispatcher(self) -> Any:
        """The dispatcher of numba, with the compiled code."""
        if self._dispatcher is None:
            from turnwright._kernels.compiling import compiled  # noqa: PLC0415 - numba is costly to import

            with _LOCK:
                self._dispatcher = self._dispatcher or compiled(self._function, self._fastmath, inline=self._inline)
        return self._dispatcher

    @property
    def _numba_type_(self) -> Any:
        """The type of this kernel where another one calls it."""
        return self.dispatcher._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel: cached on disk, without the interpreter lock, fused multiply-adds, NumPy's error model."""
    return Kernel(function, {"contract"})


def jit_exact(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel as `jit` does, without fused multiply-adds: rounded as a program without them rounds."""
    return Kernel(function, set())


def jit_inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel as `jit` does, and inline it: for small ones, as passing an `Edge` on costs more."""
    return Kernel(function, {"contract"}, inline=True)


def jit_sums(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel as `jit` does, for sums whose order does not matter: only then do their loops vectorise."""
    return Kernel(function, {"contract", "reassoc", "nsz"})
