"""Executors for cases: processes of this machine, or a Dask cluster.

When one worker of a standard process pool is killed, the pool loses the cases of all its workers and does not report
which case was running. The local pool therefore has one standard pool of one process for each worker: a worker that
dies affects only its own case.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from typing import Any, ParamSpec, TypeVar
from urllib.parse import urlsplit

from turnwright import _validate as validate
from turnwright._processes import Recorded, start_worker
from turnwright.errors import InputError, StudyError
from turnwright.progress import THREADS, cores, free_memory_gb

__all__ = [
    "Cluster",
    "LocalPool",
    "WorkerDied",
    "cluster",
    "count_threads",
    "count_workers",
    "local",
    "require_reach",
]

MEMORY_GB = 2.0
"""Default memory of a worker: a complete run of the freeform infrared lens with its maps takes 1.6 GB."""
MAX_WORKERS = 1000
"""Largest number of processes of one machine: each needs a thread in this process."""
_CONNECT_TIMEOUT_S = 5.0
_TERMINATE_TIMEOUT_S = 5.0  # for a worker after SIGTERM
_REFRESH_S = 5.0
_LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_starting = threading.Lock()

_P = ParamSpec("_P")
_T = TypeVar("_T")


class WorkerDied(Exception):  # noqa: N818 - the case is not necessarily at fault
    """The worker process that ran a case has died, with this exit code or minus the number of a signal."""

    def __init__(self, exitcode: int | None) -> None:
        super().__init__(exitcode)
        self.exitcode = exitcode

    def __str__(self) -> str:
        code = self.exitcode
        if code is None or code >= 0:
            return f"exit code {code}"
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return f"{name}, perhaps out of memory" if name == "SIGKILL" else name


class LocalPool(Executor):
    """Processes of this machine, each started when it is first needed and restarted when it dies."""

    def __init__(self, *, workers: int, threads: int) -> None:
        self.workers = workers
        self.threads = threads
        self._lanes = ThreadPoolExecutor(workers)  # a thread for each worker
        self._lane = threading.local()
        self._running: set[_Worker] = set()
        self._ended = False

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Call a module-level function in a worker; if the worker dies, the future raises `WorkerDied`."""
        return self._lanes.submit(self._carry_out, partial(fn, *args, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers when all submitted calls are done."""
        self._lanes.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            for worker in tuple(self._running):
                worker.executor.shutdown()

    def kill(self) -> None:
        """Terminate the workers at once, with some seconds to clean up."""
        self._lanes.shutdown(wait=False, cancel_futures=True)
        with _starting:
            self._ended = True  # no worker starts after this
            processes = [worker.process for worker in self._running]
        for process in processes:
            process.terminate()
        until = time.monotonic() + _TERMINATE_TIMEOUT_S
        for process in processes:
            process.join(max(0.0, until - time.monotonic()))
            process.kill()
        self.shutdown()

    def _carry_out(self, call: Callable[[], _T]) -> _T:
        worker: _Worker | None = getattr(self._lane, "worker", None)
        if worker is None or not worker.process.is_alive():  # killed while idle, not by a case
            worker = self._lane.worker = self._start(worker)
        try:
            return worker.executor.submit(call).result()
        except BrokenProcessPool:
            raise WorkerDied(worker.exitcode()) from None

    def _start(self, dead: _Worker | None) -> _Worker:
        with _starting:
            self._running.discard(dead)
            if self._ended:
                raise WorkerDied(None)
            worker = _Worker(self.threads)
            self._running.add(worker)
        try:
            worker.ready.result()
        except BrokenProcessPool:
            raise _start_error(WorkerDied(worker.exitcode())) from None
        return worker


class _Worker:
    """A standard executor with one process."""

    def __init__(self, threads: int) -> None:
        context = Recorded()
        self.executor = ProcessPoolExecutor(1, mp_context=context, initializer=start_worker)
        # Libraries read these when they are loaded, before any code of Turnwright runs in the worker.
        names = (THREADS, *_LIBRARIES)
        before = {name: os.environ[name] for name in names if name in os.environ}
        os.environ.update(dict.fromkeys(names, str(threads)))
        try:
            self.ready = self.executor.submit(os.getpid)
        except (OSError, RuntimeError) as error:  # Python starts none while it reads a worker's copy of the script
            raise _start_error(error) from error
        finally:
            for name in names:
                del os.environ[name]
            os.environ.update(before)
        self.process = context.processes[0]

    def exitcode(self) -> int | None:
        self.executor.shutdown()  # it waits for the process
        return self.process.exitcode


def _start_error(error: Exception) -> StudyError:
    reason = str(error).split("\n\n")[0].strip()
    return StudyError(
        f"no worker process can be started ({' '.join(reason.split())}): start the work of a script below "
        'if __name__ == "__main__":, or use fewer workers'
    )


class Cluster(Executor):
    """The workers of a Dask scheduler, to which ``client`` is connected."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)  # equal cases are distinguished by their keys, not by Dask
        self._workers = 1
        self._asked = -_REFRESH_S

    @property
    def workers(self) -> int:
        """Number of cases that the cluster runs at a time, refreshed every few seconds."""
        if time.monotonic() - self._asked > _REFRESH_S:
            with suppress(OSError):  # a lost scheduler is reported by the cases that it had
                self._workers = max(1, sum(self._client.nthreads().values()))
            self._asked = time.monotonic()
        return self._workers

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Call a function on a worker."""
        future: Future[_T] = self._executor.submit(fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Release the submitted calls; the cluster continues to run."""
        self._executor.shutdown(wait=wait and not cancel_futures)


@contextmanager
def local(
    workers: int | None = None, memory_gb: float | None = None, *, threads: int | None = None
) -> Iterator[LocalPool]:
    """Yield a pool of processes of this machine, which ends with the block; at once if the block raises.

    Parameters
    ----------
    workers
        Number of processes; by default limited by cores and free memory.
    memory_gb
        Memory of one worker, 2 by default. [GB]
    threads
        Number of threads of each process. By default 1 if ``workers`` is given, else an equal part of all cores.

    Raises
    ------
    InputError
        If a number is not positive.
    """
    if workers is not None:
        workers = validate.whole_number(workers, "the number of workers", 1, MAX_WORKERS)
    if memory_gb is not None and not validate.number(memory_gb, "the memory of a worker") > 0:
        raise InputError(f"the memory of a worker is {memory_gb} GB, it must be above 0 GB: increase it")
    if threads is not None:
        threads = validate.whole_number(threads, "the number of threads", 1, MAX_WORKERS)
    if workers is None:
        workers = count_workers(memory_gb)
        threads = threads or count_threads(workers)
    pool = LocalPool(workers=workers, threads=threads or 1)
    try:
        yield pool
    except BaseException:
        pool.kill()
        raise
    pool.shutdown()


def require_reach(place: str, executor: Executor, *, arrays: bool = False) -> None:
    """Raise if a store is in the memory of this process and the workers are other processes.

    Rows from a cluster or a foreign executor are returned to this process; ``arrays`` that it has written are not sent
    to the workers.
    """
    processes = isinstance(executor, LocalPool | ProcessPoolExecutor)
    apart = not isinstance(executor, ThreadPoolExecutor) if arrays else processes
    if apart and place.rpartition("::")[2].startswith("memory:"):
        raise InputError(
            f"the store {place!r} is in the memory of this process, where its worker processes cannot write: "
            "name a folder, or use threads"
        )


def count_threads(workers: int) -> int:
    """Return the number of threads per worker that use all cores, at least one."""
    return max(1, cores() // max(workers, 1))


def count_workers(memory_gb: float | None = None) -> int:
    """Return the number of workers that cores and free memory allow, at least one."""
    free = free_memory_gb()
    return max(1, cores() if free is None else min(cores(), int(free / (memory_gb or MEMORY_GB))))


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Yield an executor over the workers of a running Dask scheduler.

    Parameters
    ----------
    address
        Address of the scheduler, such as "tcp://head:8786".

    Raises
    ------
    InputError
        If distributed is not installed, or the address is invalid.
    StudyError
        If no scheduler answers within five seconds.
    """
    try:
        distributed = import_module("distributed")  # of an extra
    except ImportError:
        raise InputError(
            "a cluster needs distributed, which is not installed: pip install 'turnwright[cluster]'"
        ) from None
    _require_scheduler(address)
    # These loggers print tracebacks when a scheduler is lost; Turnwright raises an error instead.
    with _silence("distributed"), _silence("distributed.client"):
        try:
            client = distributed.Client(address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise _scheduler_error(address, error) from None
        try:
            yield Cluster(client)
        finally:
            with suppress(OSError, TimeoutError):
                client.close()


def _require_scheduler(address: str) -> None:
    """Raise unless a scheduler answers: Dask's client hangs if another server listens at the address."""
    try:
        parts = urlsplit(str(address))
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise _scheduler_error(address, error) from None
    if parts.scheme not in {"tcp", "tls"} or not host or not port:
        raise InputError(
            f"{address!r} is not the address of a Dask scheduler: write tcp://host:port, or tls://host:port"
        )
    try:
        socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT_S).close()  # Dask retries a closed port
        with ThreadPoolExecutor(1) as thread:  # this thread may have an event loop, as in a notebook
            kind = thread.submit(asyncio.run, _kind_of(address)).result()
    except Exception as error:  # noqa: BLE001 - another server may answer anything
        raise _scheduler_error(address, error) from None
    if kind != "Scheduler":
        raise InputError(f"{address!r} is the address of a Dask {kind}, a scheduler is needed: give its address")


async def _kind_of(address: str) -> str:
    distributed = import_module("distributed")
    connection = distributed.Security().get_connection_args("client")
    async with asyncio.timeout(_CONNECT_TIMEOUT_S):
        there = distributed.rpc(address, connection_args=connection, timeout=_CONNECT_TIMEOUT_S)
        try:
            return str((await there.identity())["type"])
        finally:
            await there.close_rpc()


def _scheduler_error(address: str, error: Exception) -> StudyError:
    reason = getattr(error, "strerror", None) or " ".join(str(error).split()) or "no answer"
    return StudyError(
        f"no Dask scheduler answers at {address!r} ({reason}): start one with 'dask scheduler', or check the address"
    )


@contextmanager
def _silence(name: str) -> Iterator[None]:
    talker = logging.getLogger(name)
    level = talker.level
    talker.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        talker.setLevel(level)
