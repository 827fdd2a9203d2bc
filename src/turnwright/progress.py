"""Long computations in chunks: on all cores, with progress, and cancellable."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Condition, Thread
from typing import TypeAlias

from turnwright.errors import LimitError

Progress: TypeAlias = Callable[[int, int], None]
"""Called with (done, total); an exception raised in it stops the work cleanly."""

StageProgress: TypeAlias = Callable[[str, int, int], None]
"""Called with (stage, done, total); an exception raised in it stops the run cleanly."""

PRIOR_WORK_S, MAX_PRIOR_FRACTION = 2.0, 0.05
"""Weight of the estimate against the measured pace: so much work [s], and at most this fraction of all work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A stage of a run that is still to be carried out, and its estimated time on a typical computer. [s]."""

    stage: str
    work: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Overall:
    """Progress of a run over all its stages."""

    stage: str  # in progress
    step: int  # its number, counted from 1
    steps: int  # number of stages
    fraction: float  # of the work that is done; it never falls
    left_s: float  # estimated time remaining [s]


class OverallProgress:
    """A `StageProgress` that combines the progress of all stages into that of the run.

    A stage that is not among the steps adds nothing. A skipped step counts as done when a later one begins. The
    listener is called with every change; the clock returns the time since an arbitrary origin. [s]

    Examples
    --------
    >>> lines = []
    >>> steps = [Step(stage="place", work=3.0), Step(stage="simulate", work=1.0)]
    >>> overall = OverallProgress(steps, lambda run: lines.append(f"{run.step} of {run.steps}: {run.fraction:.0%}"))
    >>> overall("place", 1, 3)
    >>> overall("simulate", 0, 8)
    >>> overall.finish()
    >>> lines
    ['1 of 2: 25%', '2 of 2: 75%', '2 of 2: 100%']
    """

    def __init__(
        self, steps: Sequence[Step], listener: Callable[[Overall], None], *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._steps, self._listener, self._clock = tuple(steps), listener, clock
        self._work = sum(step.work for step in self._steps)
        self._prior = min(PRIOR_WORK_S, MAX_PRIOR_FRACTION * self._work)
        self._start = clock()
        self._at, self._done, self._step_fraction, self._fraction = 0, 0.0, 0.0, 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Record the progress of a stage."""
        self._go_to(stage, begins=done == 0)
        if self._at < len(self._steps) and self._steps[self._at].stage == stage:
            self._step_fraction = max(self._step_fraction, min(done / total, 1.0) if total > 0 else 0.0)
            self._fraction = max(self._fraction, self._finished_work() / self._work if self._work else 0.0)
        self._report(stage)

    def finish(self) -> None:
        """Report that the run is finished."""
        self._at, self._done, self._step_fraction, self._fraction = len(self._steps), self._work, 0.0, 1.0
        self._report(self._steps[-1].stage if self._steps else "")

    def _finished_work(self) -> float:
        return self._done + self._step_fraction * self._steps[self._at].work

    def _go_to(self, stage: str, *, begins: bool) -> None:
        """Advance to the next step of this name; a finished stage that begins again is a new step."""
        is_repeated = begins and self._step_fraction >= 1
        if self._at < len(self._steps) and self._steps[self._at].stage == stage and not is_repeated:
            return
        ahead = range(self._at + is_repeated, len(self._steps))
        following = next((n for n in ahead if self._steps[n].stage == stage), None)
        if following is not None:
            self._done += sum(step.work for step in self._steps[self._at : following])
            self._at, self._step_fraction = following, 0.0

    def _report(self, stage: str) -> None:
        finished = self._finished_work() if self._at < len(self._steps) else self._done
        # The measured pace, with the estimate as a prior while little is measured.
        pace = (self._clock() - self._start + self._prior) / (finished + self._prior) if self._work else 0.0
        remaining_s = pace * self._work * (1 - self._fraction)
        self._listener(
            Overall(
                stage=stage,
                step=min(self._at + 1, len(self._steps)),
                steps=len(self._steps),
                fraction=self._fraction,
                left_s=remaining_s,
            )
        )


THREADS = "TURNWRIGHT_THREADS"
"""Environment variable that limits the threads of a process."""

_thread_limit: ContextVar[int | None] = ContextVar("_thread_limit", default=None)


@contextmanager
def at_most(threads: int) -> Iterator[None]:
    """Limit `cores` to this number within the block, in this thread."""
    token = _thread_limit.set(threads)
    try:
        yield
    finally:
        _thread_limit.reset(token)


def cores() -> int:
    """Return the number of processors that this process may use: all, or the limit set for it.

    >>> with at_most(1):
    ...     cores()
    1
    """
    available = _count_cores()
    setting = os.environ.get(THREADS, "")
    limits = [int(setting) if setting.isdecimal() and int(setting) else available, _thread_limit.get() or available]
    return min(available, *limits)


def _count_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


class _Helpers:
    """Threads that help to carry out chunks; starting some for each call takes longer than many of them.

    They end with the process: it need not wait for one that is still at work after an interrupt.
    """

    def __init__(self) -> None:
        self.offered: SimpleQueue[_Chunks] = SimpleQueue()
        self.started = 0

    def offer(self, chunks: _Chunks, helpers: int) -> None:
        """Have so many threads, or all there are, carry out chunks as soon as they are free."""
        with suppress(RuntimeError):  # the system has no further thread
            while self.started < min(helpers, _count_cores()):
                Thread(target=self._help, name="chunks", daemon=True).start()
                self.started += 1
        for _ in range(min(helpers, self.started)):
            self.offered.put(chunks)

    def _help(self) -> None:
        while True:
            self.offered.get().help_out()


_helpers = _Helpers()


def _forget_helpers() -> None:
    """Start with no threads, of which a forked process has none."""
    global _helpers  # noqa: PLW0603 - they belong to the process
    _helpers = _Helpers()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_helpers)


class _Chunks:
    """Chunks of work that several threads carry out."""

    def __init__(self, work: Callable[[int, int], object], spans: Sequence[tuple[int, int]]) -> None:
        self.work, self.waiting, self.total = work, iter(spans), spans[-1][1]
        self.finished = self.reported = 0
        self.changed, self.is_stopped = Condition(), False
        self.helpers = 0  # at work
        self.error: BaseException | None = None  # of one of them

    def carry_out(self, progress: Progress | None = None) -> None:
        """Carry out one chunk after another until none is left, or the work is stopped."""
        limited = copy_context()
        limited.run(_thread_limit.set, 1)
        while (span := self._take()) is not None:
            limited.run(self.work, *span)
            with self.changed:
                self.finished += span[1] - span[0]
                done = self.finished
            if progress is not None:
                self.reported = done
                progress(done, self.total)

    def _take(self) -> tuple[int, int] | None:
        with self.changed:
            return None if self.is_stopped else next(self.waiting, None)

    def help_out(self) -> None:
        """Carry out chunks in another thread, and keep its error for the caller."""
        with self.changed:
            self.helpers += 1
        try:
            self.carry_out()
        except BaseException as error:  # noqa: BLE001 - it is raised in the caller's thread
            self.stop(error)
        with self.changed:
            self.helpers -= 1
            self.changed.notify_all()

    def stop(self, error: BaseException | None = None) -> None:
        """Begin no further chunk."""
        with self.changed:
            self.is_stopped, self.error = True, self.error or error

    def wait(self) -> None:
        """Wait until no other thread is at work."""
        with self.changed:
            self.changed.wait_for(lambda: not self.helpers)


def run_chunks(
    work: Callable[[int, int], object],
    total: int,
    chunk: int,
    progress: Progress | None = None,
    *,
    threads: int | None = None,
) -> None:
    """Call ``work(start, stop)`` over ``range(total)`` in chunks, on ``threads`` threads, one of them the caller's.

    The kernels release the interpreter lock, so threads use all cores; work within a chunk has one core. Progress is
    called in the caller's thread. An exception from it, or Ctrl-C, stops the work within the time of one chunk.

    >>> done = []
    >>> run_chunks(lambda start, stop: done.append((start, stop)), 10, 4, threads=1)
    >>> sorted(done)
    [(0, 4), (4, 8), (8, 10)]
    """
    spans = [(start, min(start + chunk, total)) for start in range(0, total, chunk)]
    threads = min(threads or cores(), len(spans))
    if threads <= 1:
        for start, stop in spans:
            work(start, stop)
            if progress is not None:
                progress(stop, total)
        return
    chunks = _Chunks(work, spans)
    try:
        _helpers.offer(chunks, threads - 1)
        chunks.carry_out(progress)
        chunks.wait()
    except BaseException:
        chunks.stop()
        chunks.wait()
        raise
    if chunks.error is not None:
        raise chunks.error
    if progress is not None and chunks.reported < total:
        progress(total, total)


def free_memory_gb(system: Path = Path("/")) -> float | None:
    """Return the memory that is available, within the limit of a container; None if unknown. [GB].

    The file cache of a container counts as available.
    """
    available = []
    with suppress(OSError, StopIteration, ValueError):
        lines = (system / "proc/meminfo").read_text(encoding="ascii").splitlines()
        available.append(int(next(line for line in lines if line.startswith("MemAvailable")).split()[1]) / 1e6)
    for group, limit, used, reclaimable in (
        ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
        ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        with suppress(OSError, ValueError, KeyError):  # "max" means no limit
            most, now = (int((system / group / file).read_text(encoding="ascii")) for file in (limit, used))
            lines = (system / group / "memory.stat").read_text(encoding="ascii").splitlines()
            cached = int(dict(line.split() for line in lines)[reclaimable])
            available.append((most - now + cached) / 1e9)
    with suppress(ImportError, OSError, ValueError):  # Windows has no resource module
        import resource  # noqa: PLC0415

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most != resource.RLIM_INFINITY:
            pages = int((system / "proc/self/statm").read_text(encoding="ascii").split()[0])
            available.append((most - pages * resource.getpagesize()) / 1e9)
    return min(available, default=None)


def require_memory(needed: float, what: str, remedy: str) -> None:
    """Raise `LimitError` unless as many bytes of memory are free, with what needs it and the remedy."""
    free = free_memory_gb()
    if free is not None and needed > free * 1e9:
        raise LimitError(
            f"{what} takes about {needed / 1e9:.3g} GB of memory, {max(free, 0.0):.3g} GB are free: {remedy}"
        )
