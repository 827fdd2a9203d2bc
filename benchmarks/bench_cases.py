"""What a case costs besides its work, and what a second worker is worth.

Workers import this module, so it imports little.
"""

import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from itertools import count
from multiprocessing import get_context
from time import perf_counter
from unittest.mock import patch

from turnwright.studies import Case, Store, cluster, local, run_cases

RARELY = {
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.memory.monitor-interval": "2s",
    "distributed.worker.profile.enabled": False,
}
"""What docs/howto/many_jobs.md advises for cases of seconds: Dask looks after itself once a second, not fifty times."""

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
            run_cases(empty, todo, executor=pool, store=Store.open(folder))
            middle = perf_counter()
            list(standard.map(nothing, range(cases)))
            if turn:
                ours.append((middle - start) / cases)
                theirs.append((perf_counter() - middle) / cases)
    return ours, theirs


@contextmanager
def dask(workers):
    """Yield an executor over a Dask cluster on loopback, of so many processes."""
    from dask import config  # noqa: PLC0415 - of an extra
    from distributed import LocalCluster  # noqa: PLC0415

    with (
        patch.dict(os.environ),  # starting workers changes how memory is given back, which would slow later commands
        config.set(RARELY),
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as there,
        cluster(there.scheduler_address) as executor,
    ):
        yield executor


def lens_cases(job, executors, cases, rounds):
    """Seconds that the cases of an error budget take each executor, in turns; all compute the same cases."""
    from turnwright.studies import tolerance  # noqa: PLC0415 - a worker of empty cases needs none of it

    taken = [[] for _ in executors]
    for turn in range(rounds):
        for executor, spent in zip(executors, taken, strict=True):
            told = []  # when the first case was sent, and when the last was there

            def tell(stage, done, total, told=told):
                if stage == "cases" and (not told or done == total):
                    told.append(perf_counter())

            with executor() as pool, tempfile.TemporaryDirectory() as folder:
                tolerance(job, count=cases, seed=turn, executor=pool, store=folder, progress=tell)
            spent.append(told[1] - told[0])
    return taken
