"""The compiled kernels: plain arrays in, plain arrays out.

numba's disk cache notices an edited function but not an edited callee in another module, and would silently serve the
old code. So the cache lives in a folder named after a hash of all kernel sources: any edit starts a fresh one.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import platformdirs

__all__ = ["jit", "jit_sums"]


def _cache_folder() -> Path:
    """Return the cache folder of exactly these sources, compiled by exactly this numba."""
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    base = os.environ.get("NUMBA_CACHE_DIR") or platformdirs.user_cache_dir("turnwright")
    return Path(base) / f"kernels-{digest.hexdigest()[:16]}"


numba.config.CACHE_DIR = str(_cache_folder())


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel: cached on disk, without the interpreter lock, fused multiply-adds, NumPy's error model."""
    compiled: Callable[..., Any] = numba.njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")(
        function
    )
    return compiled


def jit_sums(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel as `jit` does, for sums whose order does not matter: only then do their loops vectorise."""
    compiled: Callable[..., Any] = numba.njit(
        cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy"
    )(function)
    return compiled
