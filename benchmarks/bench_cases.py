"""What a case costs besides its work; the workers import this module, so it imports little."""

import tempfile
from concurrent.futures import ProcessPoolExecutor
from itertools import count
from multiprocessing import get_context
from time import perf_counter

from turnwright.execution import Case, Store, conduct, local

FRESH = count()


def empty(_data, _shared, _store):
    return {}


def nothing(_number):
    return {}


def overhead(cases, times=5):
    """Seconds per case of a local pool of two with a store, and of the standard library's pool without."""
    ours, theirs = [], []
    with (
        tempfile.TemporaryDirectory() as folder,
        local(2) as pool,
        ProcessPoolExecutor(2, mp_context=get_context("spawn")) as standard,
    ):
        for turn in range(times + 1):
            todo = [Case(key=f"case-{next(FRESH)}", data={}) for _ in range(cases)]
            start = perf_counter()
            conduct(empty, todo, executor=pool, store=Store.open(folder))
            middle = perf_counter()
            list(standard.map(nothing, range(cases)))
            if turn:
                ours.append((middle - start) / cases)
                theirs.append((perf_counter() - middle) / cases)
    return ours, theirs
