"""Processes that are kept warm for what a page waits for: the server itself computes nothing, so it always answers."""

from __future__ import annotations

import asyncio
import hashlib
import json
import threading
from collections import OrderedDict
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

from turnwright.errors import InputError, TurnwrightError
from turnwright.execution import LocalPool, WorkerDied

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Busy", "Superseded", "TooLong", "Workers"]

LIMIT_S = 60.0
"""What a page waits for at most; the worker is then ended."""

KEPT = 64
"""Answers kept for an equal question."""

KEPT_BYTES = 256 * 2**20
"""And how large they may be together."""

LATER_S = 8.0
"""Until the next process is warmed up: the first page shall not share the processor with it. [s]"""

WAITING = 64
"""Questions that may wait; beyond these the server is overrun."""


class Superseded(TurnwrightError):  # noqa: N818 - it says what happened
    """A later question of the same page made this one idle."""


class TooLong(InputError):  # noqa: N818
    """The answer takes longer than a page waits, or more memory than a worker has."""


class Busy(TurnwrightError):  # noqa: N818
    """More questions wait than a server takes."""


class Workers:
    """A few warm processes, each with one question at a time.

    Parameters
    ----------
    count
        How many.
    threads
        How many threads each may use.
    warm
        Called in each beforehand, so that the first question does not wait for imports.
    then
        Called after that, but not before a question that is asked meanwhile.
    """

    def __init__(self, count: int, *, threads: int, warm: Callable[[], object] | str, then: str = "") -> None:
        self.count, self.threads, self.warm, self.then = count, threads, warm, then
        self._pools: list[LocalPool] = [self._start(LATER_S * number) for number in range(count)]
        self._free: asyncio.LifoQueue[int] | None = None
        self._latest: dict[str, asyncio.Event] = {}
        self._running: dict[str, asyncio.Task[Any]] = {}
        self._answers: OrderedDict[str, Any] = OrderedDict()
        self._waiting = 0
        self._closed = False

    async def ask(
        self,
        function: Callable[..., Any] | str,
        *arguments: Any,
        latest: str = "",
        keep: bool = False,
        limit_s: float = LIMIT_S,
    ) -> Any:
        """Return what a function of a module answers in one of the processes.

        Parameters
        ----------
        function
            Called there with the arguments; what it raises is raised here. A name such as "_jobs:check", of a module of
            this package, spares the server its import.
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
            name = function if isinstance(function, str) else f"{function.__module__}:{function.__qualname__}"
            text = json.dumps([name, arguments], sort_keys=True)
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
        self._closed = True
        for pool in self._pools:
            pool.kill()

    def _start(self, after_s: float = 0.0) -> LocalPool:
        """Return a pool of one process, which is warmed up after a while."""
        pool = LocalPool(workers=1, threads=self.threads)
        timer = threading.Timer(after_s, self._warm, (pool,))
        timer.daemon = True
        timer.start()
        return pool

    def _warm(self, pool: LocalPool) -> None:
        def further(_: object) -> None:
            with suppress(RuntimeError):  # closed meanwhile
                pool.submit(_call, self.then, ())

        with suppress(RuntimeError):
            first = pool.submit(_call, self.warm, ())
            if self.then:
                first.add_done_callback(further)

    def _keep(self, key: str, task: asyncio.Task[Any]) -> None:
        self._running.pop(key, None)
        if task.cancelled() or task.exception() is not None:
            return
        self._answers[key] = task.result()
        while len(self._answers) > KEPT or sum(_size(one) for one in self._answers.values()) > KEPT_BYTES:
            self._answers.popitem(last=False)

    async def _answer(
        self, function: Callable[..., Any] | str, arguments: tuple[Any, ...], latest: str, limit_s: float
    ) -> Any:
        if self._free is None:
            self._free = asyncio.LifoQueue()  # the one used last is the warmest
            for number in reversed(range(self.count)):
                self._free.put_nowait(number)
        if self._waiting >= WAITING:
            raise Busy(f"{self._waiting} questions wait already, the limit is {WAITING}: ask again in a moment")
        number = await self._turn(self._free, latest)
        try:
            return await self._in(number, function, arguments, limit_s)
        finally:
            self._free.put_nowait(number)

    async def _turn(self, free: asyncio.LifoQueue[int], latest: str) -> int:
        """Wait for a process; give way to a later question of the same name."""
        given_up = asyncio.Event()
        if latest:
            if latest in self._latest:
                self._latest[latest].set()
            self._latest[latest] = given_up
        got, gone = asyncio.create_task(free.get()), asyncio.create_task(given_up.wait())
        self._waiting += 1
        try:
            await asyncio.wait({got, gone}, return_when=asyncio.FIRST_COMPLETED)
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

    async def _in(
        self, number: int, function: Callable[..., Any] | str, arguments: tuple[Any, ...], limit_s: float
    ) -> Any:
        future: Future[Any] = self._pools[number].submit(_call, function, arguments)
        try:
            return await asyncio.wait_for(asyncio.wrap_future(future), limit_s)
        except TimeoutError:
            if self._closed:
                raise
            pool, self._pools[number] = self._pools[number], self._start()
            asyncio.get_running_loop().run_in_executor(None, pool.kill)
            raise TooLong(
                f"the answer takes more than {limit_s:g} s, the limit for what a page waits for: take fewer points or "
                "a simpler surface, or start it as a run"
            ) from None
        except (WorkerDied, CancelledError) as error:
            raise TooLong(f"the process that worked on it ended ({error}): take fewer points, then ask again") from None
        except MemoryError as error:
            raise TooLong(f"the memory is not enough ({error}): take fewer points") from None


def _call(function: Callable[..., Any] | str, arguments: tuple[Any, ...]) -> Any:
    """Call a function in a worker."""
    if not isinstance(function, str):
        return function(*arguments)
    module, _, name = function.partition(":")
    return getattr(import_module(f"turnwright.web.{module}"), name)(*arguments)


def _size(answer: object) -> int:
    return len(answer) if isinstance(answer, bytes | str) else 4096
