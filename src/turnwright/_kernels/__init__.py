"""The compiled kernels: plain arrays in, plain arrays out.

numba's disk cache notices an edited function but not an edited callee in another module, and would silently serve the
old code. So each module has a cache folder named after a hash of its source and of the kernels that it imports: an edit
starts fresh ones for that module and for those that call it, and leaves the others.
"""

from __future__ import annotations

import functools
import hashlib
import os
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import platformdirs

__all__ = ["jit", "jit_sums"]

_CALLED = re.compile(r"^from turnwright\._kernels\.(\w+) import", re.MULTILINE)
_deciding = threading.Lock()


def _digest(folder: Path, name: str) -> str:
    """Return a hash of the module ``name``, of all that it calls and of the numba that compiles it."""
    sources: dict[str, str] = {}
    waiting = {"__init__", name}
    while waiting:
        one = waiting.pop()
        sources[one] = (folder / f"{one}.py").read_text(encoding="utf-8")
        waiting |= set(_CALLED.findall(sources[one])) - sources.keys()
    digest = hashlib.sha256(numba.__version__.encode())
    for one in sorted(sources):
        digest.update(f"{one}\n{sources[one]}".encode())
    return digest.hexdigest()[:16]


@functools.cache
def _cache_folder(module: str) -> str:
    """Return where the kernels of a module are kept once they are compiled."""
    name = module.rpartition(".")[2]
    base = os.environ.get("NUMBA_CACHE_DIR") or platformdirs.user_cache_dir("turnwright")
    return str(Path(base) / f"kernels-{name}-{_digest(Path(__file__).parent, name)}")


def _compiled(function: Callable[..., Any], fastmath: set[str]) -> Callable[..., Any]:
    # Nobody calls a kernel by its address: without the wrapper for that it compiles a tenth sooner.
    decorate = numba.njit(cache=True, nogil=True, fastmath=fastmath, error_model="numpy", no_cfunc_wrapper=True)
    with _deciding:
        # numba looks here when it is given a function, and only then.
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _cache_folder(function.__module__)
        try:
            compiled: Callable[..., Any] = decorate(function)
        finally:
            numba.config.CACHE_DIR = before
    return compiled


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel: cached on disk, without the interpreter lock, fused multiply-adds, NumPy's error model."""
    return _compiled(function, {"contract"})


def jit_sums(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel as `jit` does, for sums whose order does not matter: only then do their loops vectorise."""
    return _compiled(function, {"contract", "reassoc", "nsz"})
