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
    """A function of plain arrays that numba compiles at its first call; other kernels may call it, but not itself."""

    def __init__(self, function: Callable[..., Any], fastmath: set[str], *, inline: bool = False) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._fastmath = fastmath
        self._inline = inline
        self._dispatchers: dict[bool, Any] = {}

    @property
    def dispatcher(self) -> Any:
        """The dispatcher of numba, with the compiled code."""
        return self._dispatcher(for_kernels=False)

    @property
    def _numba_type_(self) -> Any:
        """The type of this kernel where another one calls it."""
        return self._dispatcher(for_kernels=True)._numba_type_

    def _dispatcher(self, *, for_kernels: bool) -> Any:
        if for_kernels not in self._dispatchers:
            from turnwright._kernels.compiling import compiled  # noqa: PLC0415 - numba is costly to import

            with _LOCK:
                if for_kernels not in self._dispatchers:
                    self._dispatchers[for_kernels] = compiled(
                        self._function, self._fastmath, inline=self._inline, for_kernels=for_kernels
                    )
        return self._dispatchers[for_kernels]

    def __call__(self, *arguments: Any) -> Any:
        return self._dispatcher(for_kernels=False)(*arguments)


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
