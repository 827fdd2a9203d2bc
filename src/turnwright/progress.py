"""Long work in chunks: on all cores, with progress, and stoppable."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TypeAlias

from turnwright.errors import LimitError

Progress: TypeAlias = Callable[[int, int], None]
"""Called with (done, total); raising in it, as Ctrl-C does, stops the work cleanly."""

StageProgress: TypeAlias = Callable[[str, int, int], None]
"""Called with (stage, done, total); raising in it, as Ctrl-C does, stops the run cleanly."""

USUAL_S, USUAL_SHARE = 2.0, 0.05
"""Work, and share of it at most, after which the time it took says as much of the rest as the estimates do. [s]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A stage of a whole run, before it is carried out.

    Parameters
    ----------
    stage
        What the stage is called when it tells its progress.
    work
        Time that it takes on a usual computer, estimated. [s]
    """

    stage: str
    work: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Overall:
    """How far a whole run is.

    Parameters
    ----------
    stage
        What is carried out.
    step, steps
        Its number, counted from 1, and how many there are.
    fraction
        Of the work that is done; it never falls, and is 1 when all is done.
    left_s
        Time until then, estimated. [s]
    """

    stage: str
    step: int
    steps: int
    fraction: float
    left_s: float


class OverallProgress:
    """Makes the progress of a whole run out of that of its stages: it is a `StageProgress`.

    A stage that is not among the steps adds nothing. Steps that do not happen count as done when a later one begins.

    Parameters
    ----------
    steps
        What the run will do, in order.
    listener
        Called with every change.
    clock
        Seconds since any time.

    Examples
    --------
    >>> seen = []
    >>> both = [Step(stage="place", work=3.0), Step(stage="simulate", work=1.0)]
    >>> whole = OverallProgress(both, lambda one: seen.append(f"{one.step} of {one.steps}: {one.fraction:.0%}"))
    >>> whole("place", 1, 3)
    >>> whole("simulate", 0, 8)
    >>> whole.finish()
    >>> seen
    ['1 of 2: 25%', '2 of 2: 75%', '2 of 2: 100%']
    """

    def __init__(
        self, steps: Sequence[Step], listener: Callable[[Overall], None], *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._steps, self._listener, self._clock = tuple(steps), listener, clock
        self._work = sum(one.work for one in self._steps)
        self._usual = min(USUAL_S, USUAL_SHARE * self._work)
        self._start = clock()
        self._at, self._done, self._share, self._fraction = 0, 0.0, 0.0, 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Take the progress of a stage."""
        self._go_to(stage, begins=done == 0)
        if self._at < len(self._steps) and self._steps[self._at].stage == stage:
            self._share = max(self._share, min(done / total, 1.0) if total > 0 else 0.0)
            self._fraction = max(self._fraction, self._finished() / self._work if self._work else 0.0)
        self._tell(stage)

    def finish(self) -> None:
        """Say that all is done."""
        self._at, self._done, self._share, self._fraction = len(self._steps), self._work, 0.0, 1.0
        self._tell(self._steps[-1].stage if self._steps else "")

    def _finished(self) -> float:
        return self._done + self._share * self._steps[self._at].work

    def _go_to(self, stage: str, *, begins: bool) -> None:
        """Go on to the next step of this name; a stage that begins again when it is done is another one."""
        again = begins and self._share >= 1
        if self._at < len(self._steps) and self._steps[self._at].stage == stage and not again:
            return
        ahead = range(self._at + again, len(self._steps))
        following = next((n for n in ahead if self._steps[n].stage == stage), None)
        if following is not None:
            self._done += sum(one.work for one in self._steps[self._at : following])
            self._at, self._share = following, 0.0

    def _tell(self, stage: str) -> None:
        finished = self._finished() if self._at < len(self._steps) else self._done
        # What it took so far, and the estimates as far as that is little.
        pace = (self._clock() - self._start + self._usual) / (finished + self._usual) if self._work else 0.0
        left = pace * self._work * (1 - self._fraction)
        number = min(self._at + 1, len(self._steps))
        self._listener(Overall(stage=stage, step=number, steps=len(self._steps), fraction=self._fraction, left_s=left))


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
    """Call ``work(start, stop)`` over ``range(total)`` in chunks, on ``threads`` threads.

    A single thread is the caller's, and so is that of a single chunk. The kernels release the interpreter lock, so
    threads use all cores. Few chunks are in flight at a time, so a stop (an exception from ``progress``, or Ctrl-C)
    ends the work within the length of one chunk.

    >>> done = []
    >>> run_chunks(lambda start, stop: done.append((start, stop)), 10, 4, threads=1)
    >>> sorted(done)
    [(0, 4), (4, 8), (8, 10)]
    """
    spans = [(start, min(start + chunk, total)) for start in range(0, total, chunk)]
    threads = min(threads or cores(), len(spans))
    finished = 0
    if threads <= 1:  # new threads and their memory take a tenth of the time of a small case
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
