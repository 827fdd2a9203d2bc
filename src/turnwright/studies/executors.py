"""Who carries cases out: processes of this machine, or a Dask cluster.

The process pool of the standard library loses the cases of all its workers when one is killed, and cannot say whose
case killed it. So the pool of this machine has one of them for each worker: one that dies takes one case with it, and
the others do not notice.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
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
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, ParamSpec, TypeVar
from urllib.parse import urlsplit

from turnwright import _validate as validate
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
"""What a worker may need if nobody says: a whole run of the freeform infrared lens with its maps takes 1.6 GB."""
MAX_WORKERS = 1000
"""Processes of one machine: each has a thread of its own here."""
_CONNECT_TIMEOUT_S = 5.0
_GRACE_S = 0.7  # for a worker whose driver is gone: within a second so is it
_TERMINATE_TIMEOUT_S = 5.0  # for a worker that is told to stop; nearly all go at once
_REFRESH_S = 5.0
_LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_starting = threading.Lock()

_P = ParamSpec("_P")
_T = TypeVar("_T")


class WorkerDied(Exception):  # noqa: N818 - it says what happened to the worker, the case may be innocent
    """The process that had a case in hand is gone.

    Parameters
    ----------
    exitcode
        Minus the number of the signal that ended it, or its own exit code.
    """

    def __init__(self, exitcode: int | None) -> None:
        super().__init__(exitcode)
        self.exitcode = exitcode

    def __str__(self) -> str:
        code = self.exitcode
        if code is None or code >= 0:
            return f"exit code {code}"
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return f"{name}, as when the memory runs out" if name == "SIGKILL" else name


class LocalPool(Executor):
    """Processes of this machine, each started when it is first needed and again when it died.

    Parameters
    ----------
    workers
        How many.
    threads
        How many threads each may use.
    """

    def __init__(self, *, workers: int, threads: int) -> None:
        self.workers = workers
        self.threads = threads
        self._lanes = ThreadPoolExecutor(workers)  # a thread for each worker
        self._lane = threading.local()
        self._running: set[_Worker] = set()
        self._ended = False

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Have a function of a module called in a worker; a worker that dies over it ends it with `WorkerDied`."""
        return self._lanes.submit(self._carry_out, partial(fn, *args, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the workers end when nothing waits any more."""
        self._lanes.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            for worker in tuple(self._running):
                worker.executor.shutdown()

    def kill(self) -> None:
        """End the workers now; one that has something to clean up gets a moment for it."""
        self._lanes.shutdown(wait=False, cancel_futures=True)
        with _starting:
            self._ended = True  # from here on none starts
            processes = [worker.process for worker in self._running]
        for process in processes:
            process.terminate()
        until = time.monotonic() + _TERMINATE_TIMEOUT_S
        for process in processes:
            process.join(max(0.0, until - time.monotonic()))
            process.kill()
        self.shutdown()

    def _carry_out(self, call: Callable[[], _T]) -> _T:
        """Have a call answered by the worker of this thread."""
        worker: _Worker | None = getattr(self._lane, "worker", None)
        if worker is None or not worker.process.is_alive():  # killed while it waited: no case is to blame
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
            raise _none_starts(WorkerDied(worker.exitcode())) from None
        return worker


class _Worker(SpawnContext):
    """An executor of the standard library with one process, which it starts in this context."""

    process: SpawnProcess

    def __init__(self, threads: int) -> None:
        self.executor = ProcessPoolExecutor(1, mp_context=self, initializer=_begin)
        # Libraries read these when they are loaded, before a line of ours runs in the worker.
        names = (THREADS, *_LIBRARIES)
        before = {name: os.environ[name] for name in names if name in os.environ}
        os.environ.update(dict.fromkeys(names, str(threads)))
        try:
            self.ready = self.executor.submit(os.getpid)
        except (OSError, RuntimeError) as error:  # Python starts none while it reads a worker's copy of the script
            raise _none_starts(error) from error
        finally:
            for name in names:
                del os.environ[name]
            os.environ.update(before)

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802 - there a class
        """Make the process, and remember it: the executor tells nobody how it ended."""
        self.process = SpawnProcess(*args, **kwargs)
        return self.process

    def exitcode(self) -> int | None:
        """Return how a process that is gone has ended."""
        self.executor.shutdown()  # it waits for the process
        return self.process.exitcode


def _none_starts(error: Exception) -> StudyError:
    reason = str(error).split("\n\n")[0].strip()
    return StudyError(
        f"no worker process can be started ({' '.join(reason.split())}): start the work of a script below "
        'if __name__ == "__main__":, or use fewer workers'
    )


def _begin() -> None:
    """Prepare a worker, before it carries out anything."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the driver too, which knows what to do
    threading.Thread(target=_end_with_driver, daemon=True).start()


def _end_with_driver() -> None:
    """End this process when the one that started it is gone, however it went."""
    driver = multiprocessing.parent_process()
    if driver is None:
        return
    wait([driver.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)  # whoever has a half-written folder hears this and removes it
    time.sleep(_GRACE_S)
    os._exit(1)


class Cluster(Executor):
    """The workers of a Dask scheduler.

    Parameters
    ----------
    client
        Connected to it.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)  # equal cases are told apart by their keys, not by Dask
        self._workers = 1
        self._asked = -_REFRESH_S

    @property
    def workers(self) -> int:
        """Cases that the cluster carries out at a time; workers come and go, so it is asked now and then."""
        if time.monotonic() - self._asked > _REFRESH_S:
            with suppress(OSError):  # a lost scheduler is told of by the cases that it had
                self._workers = max(1, sum(self._client.nthreads().values()))
            self._asked = time.monotonic()
        return self._workers

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Have a function called on a worker."""
        future: Future[_T] = self._executor.submit(fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let go of what was submitted; the cluster goes on."""
        self._executor.shutdown(wait=wait and not cancel_futures)


@contextmanager
def local(
    workers: int | None = None, memory_gb: float | None = None, *, threads: int | None = None
) -> Iterator[LocalPool]:
    """Yield a pool of processes of this machine; it ends with the block, at once if that ends with an error.

    Parameters
    ----------
    workers
        How many; as many as there are cores and as there is memory for, if not given.
    memory_gb
        What one worker may need, 2 if not given. [GB]
    threads
        How many threads each may use. If not given, one each of the workers asked for, which thus use as many cores as
        they are; all cores together where memory has decided how many.

    Raises
    ------
    InputError
        If a number is not positive.
    """
    if workers is not None:
        workers = validate.whole(workers, "the number of workers", 1, MAX_WORKERS)
    if memory_gb is not None and not validate.number(memory_gb, "the memory of a worker") > 0:
        raise InputError(f"a worker cannot do with {memory_gb} GB of memory: use more than 0")
    if threads is not None:
        threads = validate.whole(threads, "the number of threads", 1, MAX_WORKERS)
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
    """Raise if a store lies in the memory of this process, and the workers are others.

    Parameters
    ----------
    place
        Of the store.
    executor
        Whose workers they are.
    arrays
        Whether the workers must find what this process has put there: rows of the workers of a cluster, or of an
        executor of somebody else, are brought here, but no array of ours goes there.

    Raises
    ------
    InputError
        Naming the store.
    """
    processes = isinstance(executor, LocalPool | ProcessPoolExecutor)
    apart = not isinstance(executor, ThreadPoolExecutor) if arrays else processes
    if apart and place.rpartition("::")[2].startswith("memory:"):
        raise InputError(
            f"the store {place!r} lies in the memory of this process, its workers are others and keep nothing there: "
            "name a folder, or use threads"
        )


def count_threads(workers: int) -> int:
    """Return how many threads each of so many workers can have of all cores, at least one."""
    return max(1, cores() // max(workers, 1))


def count_workers(memory_gb: float | None = None) -> int:
    """Return how many workers there are cores and memory for, at least one."""
    free = free_memory_gb()
    return max(1, cores() if free is None else min(cores(), int(free / (memory_gb or MEMORY_GB))))


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Yield an executor over the workers of a Dask scheduler that runs already.

    Parameters
    ----------
    address
        Where it listens, such as "tcp://head:8786".

    Raises
    ------
    InputError
        If distributed is not installed, or the address is none.
    StudyError
        If no scheduler answers within five seconds.
    """
    try:
        distributed = import_module("distributed")  # of an extra
    except ImportError:
        raise InputError(
            "a cluster needs distributed, which is not installed: pip install 'turnwright[cluster]'"
        ) from None
    if not isinstance(address, str):
        raise InputError(f"{address!r} is no address of a Dask scheduler: write tcp://host:port, or tls://host:port")
    _knock(address)
    # They tell of a lost scheduler by tracebacks, this by a sentence.
    with _quiet("distributed"), _quiet("distributed.client"):
        try:
            client = distributed.Client(address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise _no_scheduler(address, error) from None
        try:
            yield Cluster(client)
        finally:
            with suppress(OSError, TimeoutError):
                client.close()


def _knock(address: str) -> None:
    """Raise unless a scheduler answers: Dask's own client hangs where somebody listens who is none."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise _no_scheduler(address, error) from None
    if parts.scheme not in {"tcp", "tls"} or not host or not port:
        raise InputError(f"{address!r} is no address of a Dask scheduler: write tcp://host:port, or tls://host:port")
    try:
        socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT_S).close()  # Dask retries a closed port
        with ThreadPoolExecutor(1) as thread:  # a notebook has a loop of its own in this one
            kind = thread.submit(asyncio.run, _kind_of(address)).result()
    except Exception as error:  # noqa: BLE001 - who is no scheduler may answer anything
        raise _no_scheduler(address, error) from None
    if kind != "Scheduler":
        raise InputError(f"at {address!r} is a {kind} of Dask: give the address of its scheduler")


async def _kind_of(address: str) -> str:
    distributed = import_module("distributed")
    connection = distributed.Security().get_connection_args("client")
    async with asyncio.timeout(_CONNECT_TIMEOUT_S):
        there = distributed.rpc(address, connection_args=connection, timeout=_CONNECT_TIMEOUT_S)
        try:
            return str((await there.identity())["type"])
        finally:
            await there.close_rpc()


def _no_scheduler(address: str, error: Exception) -> StudyError:
    reason = getattr(error, "strerror", None) or " ".join(str(error).split()) or "no answer"
    return StudyError(
        f"no Dask scheduler answers at {address!r} ({reason}): start one with 'dask scheduler', or check the address"
    )


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Let a logger say nothing for a while."""
    talker = logging.getLogger(name)
    level = talker.level
    talker.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        talker.setLevel(level)
