"""Reading a large map in pieces, several at a time, and handing on what comes of them in their order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from turnwright.progress import cores

__all__ = ["in_order"]

T = TypeVar("T")
R = TypeVar("R")


def in_order(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield what ``work`` makes of each item, in their order, on as many threads as there are cores and one to read."""
    waiting = iter(items)
    with ThreadPoolExecutor(cores() + 1) as pool:
        running: deque[Future[R]] = deque(pool.submit(work, item) for item in islice(waiting, cores() + 2))
        try:
            while running:
                found = running.popleft().result()
                running.extend(pool.submit(work, item) for item in islice(waiting, 1))
                yield found
        finally:
            for future in running:
                future.cancel()
