"""Compilation of the kernels, and their cache on disk.

numba's disk cache notices an edited function but not an edited callee in another module, and would silently serve the
old code. So each module has a cache folder named after a hash of its source and of the kernels that it imports: an edit
starts new folders for that module and for those that call it, and keeps the others. The files are our own, not
numba's: numba runs whatever its files contain, and fails if one is truncated or the disk is full.

numba compiles one kernel at a time in a process. On a machine that has none yet, a second process can compile some
while the first one compiles others; the disk cache then brings what it has compiled.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import logging
import os
import pickle  # noqa: TID251 - of compiled code only, which numba writes so
import re
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import platformdirs
from numba.core import compiler, serialize
from numba.core.runtime.nrt import rtsys

__all__ = ["cache_folder", "compile_ahead", "compiled"]

_CALLED = re.compile(r"^from turnwright\._kernels\.(\w+) import", re.MULTILINE)

_LOG = logging.getLogger(__name__)

LONGEST_S = 120.0
"""Time after which a second process is no longer waited for."""

_ahead: dict[str, subprocess.Popen[bytes]] = {}
"""The process that compiles a kernel, by the name of the kernel."""

CHECKSUM = hashlib.sha256().digest_size
"""Bytes before the code in a file."""


def _digest(folder: Path, name: str) -> str:
    """Return a hash of the module ``name``, of all that it calls and of the numba that compiles it."""
    sources: dict[str, str] = {}
    waiting = {"__init__", "compiling", name}
    while waiting:
        one = waiting.pop()
        sources[one] = (folder / f"{one}.py").read_text(encoding="utf-8")
        waiting |= set(_CALLED.findall(sources[one])) - sources.keys()
    digest = hashlib.sha256(numba.__version__.encode())
    for one in sorted(sources):
        digest.update(f"{one}\n{sources[one]}".encode())
    return digest.hexdigest()[:16]


@functools.cache
def cache_folder(module: str) -> Path:
    """Return the cache folder of the kernels of a module, for this version of Python."""
    name = module.rpartition(".")[2]
    base = os.environ.get("NUMBA_CACHE_DIR") or platformdirs.user_cache_dir("turnwright")
    digest = _digest(Path(__file__).parent, name)
    return Path(base) / f"kernels-{name}-{digest}" / str(sys.implementation.cache_tag)


def compile_ahead(module: str, kernels: Iterable[str], code: str) -> None:
    """Start a process with Python code that compiles some kernels of a module, unless it has some on disk already."""
    folder = cache_folder(module)
    if not _ahead.keys().isdisjoint(kernels) or any(folder.glob("*.kernel")) or not sys.executable:
        return
    # The modules of this process, and none of the folder that the user is in.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONSAFEPATH": "1"}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        process = subprocess.Popen(  # noqa: S603 - this Python
            [sys.executable, "-c", code],
            env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError:  # each kernel is then compiled where it is called
        return
    _ahead.update(dict.fromkeys(kernels, process))
    atexit.register(process.kill)


def _was_compiled_ahead(kernel: str) -> bool:
    """Wait for the process that compiles a kernel; return whether there was one."""
    process = _ahead.pop(kernel, None)
    if process is None:
        return False
    try:
        process.wait(LONGEST_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    return True


class _Cache:
    """Compiled code on disk, a file for each kernel and signature, as numba's dispatcher asks for it.

    The code is executed as read, so each file begins with a checksum of the remainder. If a file is truncated, damaged
    or of another signature, or the disk is not writable, the kernel is compiled.
    """

    def __init__(self, function: Callable[..., Any], *, for_kernels: bool) -> None:
        self.cache_path = str(cache_folder(function.__module__))
        self._module = function.__module__.rpartition(".")[2]
        self._name = function.__qualname__ + ("-called" if for_kernels else "")

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the compiled code for a signature, or ``None`` if it must be compiled, which is logged."""
        rtsys.initialize(context)
        code = self._load(signature, context)
        if code is None:
            _LOG.info("compiling %s, once on this machine", self._module)
            if _was_compiled_ahead(self._name):
                code = self._load(signature, context)
        return code

    def _load(self, signature: Any, context: Any) -> Any:
        key = _key(signature, context.codegen())
        try:
            data = self._file(key).read_bytes()
            if hashlib.sha256(data[CHECKSUM:]).digest() == data[:CHECKSUM]:
                stored_key, code = pickle.loads(data[CHECKSUM:])  # noqa: S301 - written by this class: its checksum is right
                if stored_key == key:
                    return compiler.CompileResult._rebuild(context, *code)  # noqa: SLF001 - as numba does
        except Exception:  # noqa: BLE001, S110 - whatever is wrong with it, it can be compiled
            pass
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Write the compiled code for a signature, if the disk is writable."""
        key = _key(signature, compiled.codegen)
        *code, _ = compiled._reduce()  # noqa: SLF001 - as numba does
        # The environments of called functions hold Python objects, which no kernel uses; reading them imports numba's.
        body = serialize.dumps((key, (*code, ())))
        file = self._file(key)
        part = file.with_suffix(f".{uuid.uuid4().hex}")
        with suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
            try:
                part.write_bytes(hashlib.sha256(body).digest() + body)
                part.replace(file)
            finally:
                part.unlink(missing_ok=True)

    def flush(self) -> None:
        """Forget all signatures, as numba does when a function is compiled again."""
        for file in Path(self.cache_path).glob(f"{self._name}-*.kernel"):
            file.unlink(missing_ok=True)

    def _file(self, key: object) -> Path:
        return Path(self.cache_path) / f"{self._name}-{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.kernel"


def _key(signature: Any, codegen: Any) -> tuple[Any, ...]:
    """Return the key of compiled code, with the fields of named tuples, which the type does not include."""
    names = tuple(getattr(one, "fields", ()) for one in signature)
    return signature, names, codegen.magic_tuple()


def compiled(
    function: Callable[..., Any], fastmath: set[str], *, inline: bool = False, for_kernels: bool = False
) -> Callable[..., Any]:
    """Return a function that numba compiles for the types of its arguments, cached on disk.

    That for kernels has no wrapper for Python objects, which takes a sixth of the time of compiling.
    """
    # No kernel is called by its address; without the wrapper for that, compilation takes 10 % less time.
    decorate = numba.njit(
        nogil=True, fastmath=fastmath, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=for_kernels,
        forceinline=inline,
    )  # fmt: skip
    dispatcher: Callable[..., Any] = decorate(function)
    # Where numba's own cache would be.
    dispatcher._cache = _Cache(function, for_kernels=for_kernels)  # type: ignore[attr-defined] # noqa: SLF001
    return dispatcher
