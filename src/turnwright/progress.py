"""Long work in chunks: on all cores, with progress, and stoppable."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import islice
from pathlib import Path
from typing import TypeAlias

from turnwright.errors import LimitError

Progress: TypeAlias = Callable[[int, int], None]
"""Called with (done, total); raising in it, as Ctrl-C does, stops the work cleanly."""


THREADS = "TURNWRIGHT_THREADS"
"""Variable of the environment: how many threads a process may use, for one that shares its machine with others."""

_share: ContextVar[int | None] = ContextVar("_share", default=None)


@contextmanager
def at_most(threads: int) -> Iterator[None]:
    """Let `cores` say no more than this within the block, in this thread."""
    token = _share.set(threads)
    try:
        yield
    finally:
        _share.reset(token)


def cores() -> int:
    """Number of processors this process may use: those there are, or the share it was given.

    >>> with at_most(1):
    ...     cores()
    1
    """
    there = _cores_there()
    told = os.environ.get(THREADS, "")
    shares = [int(told) if told.isdecimal() and int(told) else there, _share.get() or there]
    return min(there, *shares)


def _cores_there() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def run_chunks(
    work: Callable[[int, int], object],
    total: int,
    chunk: int,
    progress: Progress | None = None,
    *,
    threads: int | None = None,
) -> None:
    """Call ``work(start, stop)`` over ``range(total)`` in chunks, on ``threads`` threads; a single one is the caller's.

    The kernels release the interpreter lock, so threads use all cores. Few chunks are in flight at a time, so a stop
    (an exception from ``progress``, or Ctrl-C) ends the work within the length of one chunk.

    >>> done = []
    >>> run_chunks(lambda start, stop: done.append((start, stop)), 10, 4, threads=1)
    >>> sorted(done)
    [(0, 4), (4, 8), (8, 10)]
    """
    threads = threads or cores()
    spans = [(start, min(start + chunk, total)) for start in range(0, total, chunk)]
    finished = 0
    if threads == 1:  # a thread made anew for each call takes memory anew too: a tenth of the time of a case of a study
        for start, stop in spans:
            work(start, stop)
            if progress is not None:
                progress(stop, total)
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting = iter(spans)
        running = {pool.submit(work, *span): span for span in islice(waiting, 2 * threads)}
        try:
            while running:
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    future.result()
                    start, stop = running.pop(future)
                    finished += stop - start
                    following = next(waiting, None)
                    if following is not None:
                        running[pool.submit(work, *following)] = following
                if progress is not None:
                    progress(finished, total)
        except BaseException:
            for future in running:
                future.cancel()
            raise


def free_memory_gb(system: Path = Path("/")) -> float | None:
    """Memory that may be taken, the limit of a container included; None where the system does not say.

    In GB. What a container keeps of files that it has read counts as used, and is given back when it is needed.
    """
    found = []
    with suppress(OSError, StopIteration, ValueError):
        lines = (system / "proc/meminfo").read_text(encoding="ascii").splitlines()
        found.append(int(next(line for line in lines if line.startswith("MemAvailable")).split()[1]) / 1e6)
    for group, limit, used, given_back in (
        ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
        ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        with suppress(OSError, ValueError, KeyError):  # "max" is no number, and no limit
            most, now = (int((system / group / one).read_text(encoding="ascii")) for one in (limit, used))
            lines = (system / group / "memory.stat").read_text(encoding="ascii").splitlines()
            files = int(dict(line.split() for line in lines)[given_back])
            found.append((most - now + files) / 1e9)
    with suppress(ImportError, OSError, ValueError):  # there is none on Windows
        import resource  # noqa: PLC0415

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most != resource.RLIM_INFINITY:
            pages = int((system / "proc/self/statm").read_text(encoding="ascii").split()[0])
            found.append((most - pages * resource.getpagesize()) / 1e9)
    return min(found, default=None)


def require_memory(needed: float, what: str, remedy: str) -> None:
    """Raise unless as many bytes may be taken: to run out of memory on the way loses all that is done.

    Raises
    ------
    LimitError
        With what needs them, how many there are, and the remedy.
    """
    free = free_memory_gb()
    if free is not None and needed > free * 1e9:
        raise LimitError(
            f"{what} takes about {needed / 1e9:.3g} GB of memory, {max(free, 0.0):.3g} GB are free: {remedy}"
        )
