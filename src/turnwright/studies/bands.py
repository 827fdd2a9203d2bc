"""Process a large map in pieces on several threads, in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from turnwright.progress import cores

__all__ = ["map_in_order"]

T = TypeVar("T")
R = TypeVar("R")


def map_in_order(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield ``work(item)`` of each item in order, on one thread per core plus one that waits for the disk."""
    waiting = iter(items)
    with ThreadPoolExecutor(cores() + 1) as pool:
        running: deque[Future[R]] = deque(pool.submit(work, item) for item in islice(waiting, cores() + 2))
        try:
            while running:
                result = running.popleft().result()
                running.extend(pool.submit(work, item) for item in islice(waiting, 1))
                yield result
        finally:
            for future in running:
                future.cancel()
