"""Processes that are kept warm for what a page waits for: the server itself computes nothing, so it always answers."""

from __future__ import annotations

import asyncio
import hashlib
import json
import threading
import time
from collections import OrderedDict
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from turnwright.errors import InputError, TurnwrightError
from turnwright.progress import cores
from turnwright.studies import LocalPool, WorkerDied
from turnwright.web import jobs, seen

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["Busy", "Superseded", "TooLong", "Workers", "planners"]

LIMIT_S = 60.0
"""What a page waits for at most; the worker is then ended."""

KEPT = 64
"""Answers kept for an equal question."""

KEPT_BYTES = 256 * 2**20
"""And how large they may be together."""

PLANNERS = 2
"""Processes kept warm for what a page waits for."""

LATER_S = 8.0
"""Until the next process is started: the first page shall not share the processor with it. [s]"""

PATIENCE_S = 2.0
"""Or until a question has waited for so long behind another one. [s]"""

REST_S = 0.3
"""Silence after which a page is taken to be content: only then a process loads what may be asked for next. [s]"""

WAITING = 64
"""Questions that may wait; beyond these the server is overrun."""


class Superseded(TurnwrightError):  # noqa: N818 - it says what happened
    """A later question of the same page made this one idle."""


class TooLong(InputError):  # noqa: N818
    """The answer takes longer than a page waits, or more memory than a worker has."""


class Busy(TurnwrightError):  # noqa: N818
    """More questions wait than a server takes."""


class _Process:
    """One of them: it starts when it is due, and is lent to questions once it is warm."""

    def __init__(self, threads: int) -> None:
        self.pool = LocalPool(workers=1, threads=threads)
        self.due = threading.Event()
        self.warm: Future[None] = Future()


class Workers:
    """A few warm processes, each with one question at a time; the first starts at once.

    Parameters
    ----------
    count
        How many.
    threads
        How many threads each may use.
    warm
        Called in each before any question.
    then
        Called after that, one after the other, whenever nobody has asked anything for a moment.
    """

    def __init__(
        self, count: int, *, threads: int, warm: Callable[[], object], then: Sequence[Callable[[], object]] = ()
    ) -> None:
        self.threads, self.warm, self.then = threads, warm, then
        self._closing = threading.Event()
        self._open, self._asked = 0, -REST_S
        self._processes = [self._start(LATER_S * number) for number in range(count)]
        self._free: asyncio.PriorityQueue[int] | None = None
        self._latest: dict[str, asyncio.Event] = {}
        self._running: dict[str, asyncio.Task[Any]] = {}
        self._answers: OrderedDict[str, Any] = OrderedDict()
        self._waiting = 0

    async def ask(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        latest: str = "",
        keep: bool = False,
        limit_s: float = LIMIT_S,
    ) -> Any:
        """Return what a function of a module answers in one of the processes.

        Parameters
        ----------
        function
            Called there with the arguments; what it raises is raised here.
        arguments
            Plain data.
        latest
            Names a question of which only the last one counts: one that still waits gives way with `Superseded`.
        keep
            Whether an equal question is answered from memory: its arguments must be data as JSON has it.
        limit_s
            Until the process is ended and `TooLong` raised. [s]
        """
        key = ""
        if keep:
            text = json.dumps([f"{function.__module__}:{function.__qualname__}", arguments], sort_keys=True)
            key = hashlib.sha256(text.encode()).hexdigest()
            if key in self._answers:
                self._answers.move_to_end(key)
                return self._answers[key]
        if key and key in self._running:
            task = self._running[key]
        else:
            # A task of its own: who asked may go away, the process is then still at it.
            task = asyncio.create_task(self._answer(function, arguments, latest, limit_s))
            if key:
                self._running[key] = task
                task.add_done_callback(lambda done: self._keep(key, done))
            else:
                task.add_done_callback(lambda done: done.cancelled() or done.exception())
        return await asyncio.shield(task)

    def close(self) -> None:
        """End all processes, whatever they do."""
        self._closing.set()
        for one in self._processes:
            one.due.set()
            one.pool.kill()

    def _start(self, after_s: float = 0.0) -> _Process:
        """Return a process that is warmed up after a while."""
        one = _Process(self.threads)
        threading.Thread(target=self._warm_up, args=(one, after_s), daemon=True).start()
        return one

    def _warm_up(self, one: _Process, after_s: float) -> None:
        """Prepare a process; what stands against it, whoever asks it first will hear."""
        one.due.wait(after_s)
        with suppress(Exception):
            one.pool.submit(self.warm).result()
        one.warm.set_result(None)
        with suppress(Exception):
            for step in self.then:
                while (left := self._left()) > 0 and not self._closing.wait(left):
                    pass
                one.pool.submit(step).result()

    def _left(self) -> float:
        """Return for how long a page is not yet taken to be content, as far as that is known. [s]."""
        return REST_S if self._open else self._asked + REST_S - time.monotonic()

    def _lend(self, number: int, free: asyncio.PriorityQueue[int]) -> None:
        """Let a process be asked, as soon as it is warm."""
        loop = asyncio.get_running_loop()

        def lent(_: object) -> None:
            with suppress(RuntimeError):  # the server has ended meanwhile
                loop.call_soon_threadsafe(free.put_nowait, number)

        self._processes[number].warm.add_done_callback(lent)

    def _keep(self, key: str, task: asyncio.Task[Any]) -> None:
        self._running.pop(key, None)
        if task.cancelled() or task.exception() is not None:
            return
        self._answers[key] = task.result()
        while len(self._answers) > KEPT or sum(_size(one) for one in self._answers.values()) > KEPT_BYTES:
            self._answers.popitem(last=False)

    async def _answer(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], latest: str, limit_s: float
    ) -> Any:
        if self._free is None:
            self._free = asyncio.PriorityQueue()  # the first is the warmest
            for number in range(len(self._processes)):
                self._lend(number, self._free)
        if self._waiting >= WAITING:
            raise Busy(f"{self._waiting} questions wait already, the limit is {WAITING}: ask again in a moment")
        self._open += 1
        try:
            number = await self._turn(self._free, latest)
            try:
                return await self._in(number, function, arguments, limit_s)
            finally:
                self._lend(number, self._free)
        finally:
            self._open -= 1
            self._asked = time.monotonic()

    async def _turn(self, free: asyncio.PriorityQueue[int], latest: str) -> int:
        """Wait for a process; give way to a later question of the same name."""
        given_up = asyncio.Event()
        if latest:
            if latest in self._latest:
                self._latest[latest].set()
            self._latest[latest] = given_up
        got, gone = asyncio.create_task(free.get()), asyncio.create_task(given_up.wait())
        self._waiting += 1
        try:
            while not (await asyncio.wait({got, gone}, timeout=PATIENCE_S, return_when=asyncio.FIRST_COMPLETED))[0]:
                self._hurry()
            if got.done():
                return got.result()
            raise Superseded("a later question took the place of this one: its answer counts")
        finally:
            self._waiting -= 1
            gone.cancel()
            if not got.done():
                got.cancel()
            if self._latest.get(latest) is given_up:
                del self._latest[latest]

    def _hurry(self) -> None:
        """Start the processes that are not due yet, if those that are warm have their hands full."""
        if any(one.warm.done() for one in self._processes):
            for one in self._processes:
                one.due.set()

    async def _in(self, number: int, function: Callable[..., Any], arguments: tuple[Any, ...], limit_s: float) -> Any:
        if self._closing.is_set():
            raise Busy("the server is about to end: start it again, then ask again")
        future: Future[Any] = self._processes[number].pool.submit(function, *arguments)
        try:
            return await asyncio.wait_for(asyncio.wrap_future(future), limit_s)
        except TimeoutError:
            if self._closing.is_set():
                raise
            gone, self._processes[number] = self._processes[number], self._start()
            # Once it is gone nobody writes into what it worked on, and Windows, too, lets that be removed.
            await asyncio.to_thread(gone.pool.kill)
            raise TooLong(
                f"the answer takes more than {limit_s:g} s, the limit for what a page waits for: take fewer points or "
                "a simpler surface, or start it as a run"
            ) from None
        except (WorkerDied, CancelledError) as error:
            raise TooLong(f"the process that worked on it ended ({error}): take fewer points, then ask again") from None
        except MemoryError as error:
            raise TooLong(f"the memory is not enough ({error}): take fewer points") from None


def planners() -> Workers:
    """Start the processes that plan what a page describes: each has all cores, for one question at a time."""
    then = (seen.warm_compiler, seen.warm_surface, jobs.warm_kernels)
    return Workers(PLANNERS, threads=cores(), warm=jobs.warm, then=then)


def _size(answer: object) -> int:
    return len(answer) if isinstance(answer, bytes | str) else 4096
