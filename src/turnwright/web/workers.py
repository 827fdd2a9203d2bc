"""Persistent worker processes for interactive requests, so that the server stays responsive."""

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
from turnwright.web import jobs, previews

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["Busy", "Superseded", "TooLong", "Workers", "planners"]

LIMIT_S = 60.0
"""Time limit for an answer; the worker process is then ended. [s]"""

MAX_ANSWERS = 64
"""Cached answers."""

MAX_ANSWER_BYTES = 256 * 2**20
"""Total size of the cached answers. [byte]"""

PLANNERS = 2
"""Number of worker processes."""

START_DELAY_S = 8.0
"""Delay before the next process starts, so that it does not slow down the first page. [s]"""

MAX_WAIT_S = 2.0
"""Waiting time of a request after which the next process starts. [s]"""

IDLE_S = 0.3
"""Time without requests after which a process loads what later requests may need. [s]"""

MAX_WAITING = 64
"""Waiting requests above which new ones are refused."""


class Superseded(TurnwrightError):  # noqa: N818 - the name states what happened
    """A later request of the same page replaced this one."""


class TooLong(InputError):  # noqa: N818
    """The answer exceeds the time or memory limit of a worker."""


class Busy(TurnwrightError):  # noqa: N818
    """Too many requests are waiting."""


class _Process:
    """A worker process: it starts when ``due`` is set and takes requests when ``warm`` is done."""

    def __init__(self, threads: int) -> None:
        self.pool = LocalPool(workers=1, threads=threads)
        self.due = threading.Event()
        self.warm: Future[None] = Future()


class Workers:
    """A few worker processes, each with one request at a time; the first starts at once.

    Parameters
    ----------
    count
        Number of processes.
    threads
        Threads per process.
    warm
        Called in each process before any request.
    then
        Called afterwards, one after another, while no requests arrive.
    """

    def __init__(
        self, count: int, *, threads: int, warm: Callable[[], object], then: Sequence[Callable[[], object]] = ()
    ) -> None:
        self.threads, self.warm, self.then = threads, warm, then
        self._closing = threading.Event()
        self._open, self._asked = 0, -IDLE_S
        self._processes = [self._start(START_DELAY_S * number) for number in range(count)]
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
        """Call a function in one of the processes and return its result.

        Parameters
        ----------
        function
            Function of a module; its exceptions are raised here.
        arguments
            Plain data.
        latest
            Key of requests of which only the last one counts: an earlier one that still waits raises `Superseded`.
        keep
            Whether the result is cached; the arguments must then be JSON data.
        limit_s
            Time limit; the process is then ended and `TooLong` raised. [s]
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
            # A separate task: it continues if the client disconnects.
            task = asyncio.create_task(self._answer(function, arguments, latest, limit_s))
            if key:
                self._running[key] = task
                task.add_done_callback(lambda done: self._keep(key, done))
            else:
                task.add_done_callback(lambda done: done.cancelled() or done.exception())
        return await asyncio.shield(task)

    def close(self) -> None:
        """Kill all processes."""
        self._closing.set()
        for one in self._processes:
            one.due.set()
            one.pool.kill()

    def _start(self, after_s: float = 0.0) -> _Process:
        """Return a process that starts after a delay."""
        one = _Process(self.threads)
        threading.Thread(target=self._warm_up, args=(one, after_s), daemon=True).start()
        return one

    def _warm_up(self, process: _Process, after_s: float) -> None:
        """Prepare a process; an error is raised again by its first request."""
        process.due.wait(after_s)
        with suppress(Exception):
            process.pool.submit(self.warm).result()
        process.warm.set_result(None)
        with suppress(Exception):
            for step in self.then:
                while (delay := self._left()) > 0 and not self._closing.wait(delay):
                    pass
                process.pool.submit(step).result()

    def _left(self) -> float:
        """Return the remaining time until the server counts as idle. [s]."""
        return IDLE_S if self._open else self._asked + IDLE_S - time.monotonic()

    def _lend(self, number: int, free: asyncio.PriorityQueue[int]) -> None:
        """Make a process available as soon as it is warm."""
        loop = asyncio.get_running_loop()

        def lent(_: object) -> None:
            with suppress(RuntimeError):  # the server has ended
                loop.call_soon_threadsafe(free.put_nowait, number)

        self._processes[number].warm.add_done_callback(lent)

    def _keep(self, key: str, task: asyncio.Task[Any]) -> None:
        self._running.pop(key, None)
        if task.cancelled() or task.exception() is not None:
            return
        self._answers[key] = task.result()
        while len(self._answers) > MAX_ANSWERS or sum(_size(one) for one in self._answers.values()) > MAX_ANSWER_BYTES:
            self._answers.popitem(last=False)

    async def _answer(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], latest: str, limit_s: float
    ) -> Any:
        if self._free is None:
            self._free = asyncio.PriorityQueue()  # the first is the warmest
            for number in range(len(self._processes)):
                self._lend(number, self._free)
        if self._waiting >= MAX_WAITING:
            raise Busy(f"at most {MAX_WAITING} requests can wait, got {self._waiting}: try again later")
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
        """Wait for a process; raise `Superseded` if a later request has the same key."""
        superseded = asyncio.Event()
        if latest:
            if latest in self._latest:
                self._latest[latest].set()
            self._latest[latest] = superseded
        got, gone = asyncio.create_task(free.get()), asyncio.create_task(superseded.wait())
        self._waiting += 1
        try:
            while not (await asyncio.wait({got, gone}, timeout=MAX_WAIT_S, return_when=asyncio.FIRST_COMPLETED))[0]:
                self._hurry()
            if got.done():
                return got.result()
            raise Superseded("a later request replaced this one")
        finally:
            self._waiting -= 1
            gone.cancel()
            if not got.done():
                got.cancel()
            if self._latest.get(latest) is superseded:
                del self._latest[latest]

    def _hurry(self) -> None:
        """Start the remaining processes if the warm ones are busy."""
        if any(one.warm.done() for one in self._processes):
            for one in self._processes:
                one.due.set()

    async def _in(self, number: int, function: Callable[..., Any], arguments: tuple[Any, ...], limit_s: float) -> Any:
        if self._closing.is_set():
            raise Busy("the server is shutting down")
        future: Future[Any] = self._processes[number].pool.submit(function, *arguments)
        try:
            return await asyncio.wait_for(asyncio.wrap_future(future), limit_s)
        except TimeoutError:
            if self._closing.is_set():
                raise
            gone, self._processes[number] = self._processes[number], self._start()
            # Wait until it has ended, so that its files can be removed on Windows, too.
            await asyncio.to_thread(gone.pool.kill)
            raise TooLong(
                f"the answer takes more than {limit_s:g} s, the limit of the page: use fewer points or a simpler "
                "surface, or start a run"
            ) from None
        except (WorkerDied, CancelledError) as error:
            raise TooLong(f"the worker process ended ({error}): use fewer points") from None
        except MemoryError as error:
            raise TooLong(f"out of memory ({error}): use fewer points") from None


def planners() -> Workers:
    """Start the worker processes for planning; each may use all cores, for one request at a time."""
    then = (previews.warm_compiler, previews.warm_surface, jobs.warm_kernels)
    return Workers(PLANNERS, threads=cores(), warm=jobs.warm, then=then)


def _size(answer: object) -> int:
    return len(answer) if isinstance(answer, bytes | str) else 4096
