"""Figures of a page, drawn by other processes during the work and at the same time.

matplotlib draws one figure at a time in a process. So a run starts processes that import what drawing needs while it
works, and orders each figure from them as soon as it has computed what the figure shows.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, ParamSpec

from turnwright._processes import Recorded, start_worker
from turnwright.progress import cores
from turnwright.report.page import Drawing, Figure, Picture

__all__ = ["draw", "draw_apart"]

PROCESSES = 3
"""Most processes that draw at the same time as this one: a page has some fifteen figures."""

_P = ParamSpec("_P")


class _Apart:
    """Processes that draw, and what was ordered from them."""

    def __init__(self, processes: int) -> None:
        self.context = Recorded(needs_script=False)
        # A thread for each process: executors of processes report an error when one is killed.
        self.threads = ThreadPoolExecutor(processes)
        self.free: SimpleQueue[Connection] = SimpleQueue()
        self.ordered: dict[tuple[Any, ...], tuple[Future[Picture], tuple[Any, ...], dict[str, Any]]] = {}
        for _ in range(processes):
            ours, theirs = self.context.Pipe()
            self.context.Process(target=_draw_orders, args=(theirs,), daemon=True).start()
            theirs.close()
            self.free.put(ours)

    def order(self, function: Callable[..., Picture], *args: Any, **kwargs: Any) -> Future[Picture]:
        """Return the picture that is or will be drawn of these very objects."""
        key = (function, *map(_key, args), *((name, _key(value)) for name, value in kwargs.items()))
        if key not in self.ordered:
            future = self.threads.submit(self._draw, partial(_show, function, *args, **kwargs))
            self.ordered[key] = future, args, kwargs  # an object that is kept shares its id with no other
        return self.ordered[key][0]

    def _draw(self, show: Callable[[], Callable[[], Picture]]) -> Picture:
        """Return the picture from a free process; raise `EOFError` or `OSError` if it is dead."""
        order = show()
        process = self.free.get()
        try:
            process.send(order)
            answer: Picture | Exception = process.recv()
        finally:
            self.free.put(process)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def end(self) -> None:
        """End the processes at once."""
        self.threads.shutdown(wait=False, cancel_futures=True)
        for process in self.context.processes:
            process.kill()
        self.threads.shutdown()


def _show(function: Callable[_P, Picture], *args: _P.args, **kwargs: _P.kwargs) -> Callable[[], Picture]:
    """Find what a figure shows, and return the drawing of it for another process."""
    if isinstance(function, Figure):
        return partial(function.draw, function.show(*args, **kwargs))
    return partial(function, *args, **kwargs)


def _key(value: Any) -> Any:
    """Return a value that is equal for equal numbers, texts and outlines, and for the same arrays."""
    try:
        hash(value)
    except TypeError:
        return id(value)
    return value


_apart: list[_Apart] = []
"""The processes of the block that is carried out, if any."""


def draw(function: Callable[_P, Picture], *args: _P.args, **kwargs: _P.kwargs) -> Drawing:
    """Order a figure: from another process within `draw_apart`, else it is drawn when its page is written."""
    future = None
    if _apart:
        future = _apart[-1].order(function, *args, **kwargs)
    return Drawing(lambda: function(*args, **kwargs), future)


@contextmanager
def draw_apart() -> Iterator[None]:
    """Draw what is ordered within the block in other processes, which get ready at once, where there are two cores."""
    if cores() < 2:
        yield
        return
    try:
        _apart.append(_Apart(min(cores() - 1, PROCESSES)))
    except OSError:  # no process can be started
        yield
        return
    try:
        yield
    finally:
        _apart.pop().end()


def _draw_orders(orders: Connection) -> None:
    """Draw what another process orders until it closes the connection, or ends."""
    start_worker()
    warnings.simplefilter("ignore")  # none would say of which figure it is
    import matplotlib.artist  # noqa: PLC0415 - while there is no order yet

    matplotlib.artist.kwdoc = lambda artist: ""  # noqa: ARG005 - texts for help take a fifth of the import
    import matplotlib.figure  # noqa: PLC0415

    import turnwright.report.figures  # noqa: PLC0415
    import turnwright.report.printing  # noqa: F401, PLC0415

    with suppress(EOFError, OSError):
        while True:
            order = orders.recv()
            try:
                answer = order()
            except Exception as error:  # noqa: BLE001 - it is drawn again where it was ordered
                answer = RuntimeError(str(error))
            orders.send(answer)
