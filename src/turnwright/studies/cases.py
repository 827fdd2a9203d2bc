"""Run cases on workers: each is computed once, and none is lost if a worker or the driver process dies."""

from __future__ import annotations

import ctypes
import hashlib
import json
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version as version_of
from os import environ
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

from turnwright import _validate as validate
from turnwright.errors import InputError, Stopped, StudyError, TurnwrightError
from turnwright.progress import THREADS, Progress, at_most, cores
from turnwright.studies.executors import (
    Cluster,
    LocalPool,
    WorkerDied,
    count_threads,
    count_workers,
    local,
    require_reach,
)
from turnwright.studies.files import list_files, relocate_paths
from turnwright.studies.store import DISK_FULL, Store

__all__ = ["Case", "Row", "Work", "case_key", "iter_finished", "join_lines", "program_version", "run_cases"]

Row: TypeAlias = dict[str, Any]
"""Numbers, texts or None by name; a failed case has only ``reason``, a sentence."""

Work: TypeAlias = Callable[[Mapping[str, Any], Mapping[str, Any], Store | None], Mapping[str, Any]]
"""A module-level function, called as ``work(data, shared, store)``."""

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")

MAX_DEATHS = 3
"""Worker deaths after which a case is run with no other case in flight."""
_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1
"""Parameters M_MMAP_THRESHOLD and M_TRIM_THRESHOLD of glibc's malloc.h."""
_POLL_S = 0.5
"""Longest time between two checks for a stop request and two progress reports."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One case to compute.

    Parameters
    ----------
    key
        Key of its row in the store: cases whose rows may differ must have different keys, see `case_key`.
    data
        Input of the work function, as JSON data.
    """

    key: str
    data: Mapping[str, Any]


def case_key(data: Mapping[str, Any]) -> str:
    """Return the key of a case: the digest of its data and of the program version.

    Parameters
    ----------
    data
        Everything that the row depends on, including data shared by all cases. A text that is the absolute path of a
        file is replaced by the content of that file and, for a TOML file, of the files that it names.

    Raises
    ------
    InputError
        If the data cannot be written as JSON.

    >>> case_key({"a": 1, "b": 2.5}) == case_key({"b": 2.5, "a": 1})
    True
    """
    try:
        files = list_files(data)
        contents = [relocate_paths(data, files), sorted(files.values()), program_version()]
        text = json.dumps(contents, sort_keys=True, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise InputError(f"a case must be plain data ({error}): use numbers, texts, lists and mappings") from None
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def program_version() -> str:
    """Return the version of Turnwright with a digest of its files, so that edited code has a different version."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(file for kind in ("*.py", "*.toml") for file in root.rglob(kind)):
        digest.update(f"{file.relative_to(root).as_posix()}\0".encode())
        digest.update(file.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    return f"{version_of('turnwright')}+{digest.hexdigest()[:12]}"


def run_cases(
    work: Work,
    cases: Sequence[Case],
    *,
    shared: Mapping[str, Any] | None = None,
    executor: Executor | None = None,
    store: Store | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Run cases, each once, and return their rows.

    A worker writes the row of its case to the store before it returns it, so that a driver process that is killed and
    started again finds it there. The row of a failed case holds the reason. If the reason is a lack of memory, a full
    disk or a missing file, the row is not stored, and the case is run again next time. A case whose worker dies is sent
    again; after `MAX_DEATHS` deaths it is run alone when all others are done, and a further death becomes its reason.

    Parameters
    ----------
    work
        A module-level function ``work(data, shared, store)`` that returns numbers, texts and None by name.
    cases
        Cases to compute; equal keys are computed once.
    shared
        Input common to all cases, as JSON data; large arrays go through the store.
    executor
        Any `concurrent.futures.Executor`: `local`, `cluster`, or another whose workers can import ``work``. By
        default a local pool for this call.
    store
        Where finished cases are read and written.
    progress
        Called with (done, total) at least twice a second; an exception that it raises stops the study.

    Returns
    -------
    list of dict
        One row for each case, in the order of ``cases``.

    Raises
    ------
    InputError
        If the store is in the memory of this process and the workers are other processes.
    StudyError
        If the store is full or the executor broken. Finished cases are kept.
    """
    validate.listener(progress)
    if executor is None:
        workers = min(count_workers(), max(1, len(cases)))
        with local(workers, threads=count_threads(workers)) as pool:
            return run_cases(work, cases, shared=shared, executor=pool, store=store, progress=progress)
    if store is not None:
        require_reach(store.place, executor)
    rows = {} if store is None else _read_finished(cases, store)
    todo = {case.key: case for case in cases if case.key not in rows}
    ours = isinstance(executor, LocalPool)  # its workers run these very files, and reach every folder
    threads = 1 if isinstance(executor, Cluster) else None  # Dask counts one thread for each of its own
    order = (work, shared or {}, store, None if ours else program_version(), threads)
    total = len(rows) + len(todo)

    def update() -> None:
        if progress is not None:
            progress(len(rows), total)

    def lost(error: BaseException) -> StudyError:
        state = "kept" if store is not None else "lost, as no store was given"
        return StudyError(
            f"the executor runs no more cases ({type(error).__name__}: {join_lines(error)}), the "
            f"{len(rows)} finished cases are {state}: start again with another executor"
        )

    def send(case: Case) -> Future[tuple[Row, bool]]:
        return executor.submit(_carry_out, case.key, dict(case.data), *order)

    update()
    with closing(iter_finished(send, todo.values(), executor, lost=lost, listen=update)) as done:
        for case, future, deaths in done:
            row, lasting = _read_row(future, deaths)
            if lasting and not ours and store is not None and store.row(case.key) is None:
                store.put_row(case.key, row)
            rows[case.key] = row
    return [rows[case.key] for case in cases]


def _read_finished(cases: Sequence[Case], store: Store) -> dict[str, Row]:
    there = store.keys()
    rows = {case.key: store.row(case.key) for case in cases if case.key in there}
    return {key: row for key, row in rows.items() if row is not None}


def iter_finished(
    submit: Callable[[_Task], Future[_Answer]],
    tasks: Iterable[_Task],
    executor: Executor,
    *,
    lost: Callable[[BaseException], StudyError],
    listen: Callable[[], None] = lambda: None,
) -> Generator[tuple[_Task, Future[_Answer], int], None, None]:
    """Yield each task when it is done, with its future and, if it was given up, its number of worker deaths (else 0).

    Few tasks are in flight at a time, so that a stop takes effect soon and a cluster's scheduler is not flooded. A task
    whose worker dies is sent again; after `MAX_DEATHS` deaths it is run alone when all others are done. ``lost`` makes
    the error to raise from that of a broken executor; ``listen`` is called at least twice a second.
    """
    waiting = _TaskQueue(enumerate(tasks))
    running: dict[Future[_Answer], tuple[int, _Task]] = {}
    usual = getattr(executor, "_max_workers", None) or cores()
    try:
        while True:
            # Each worker has one running and one queued task; the number of workers of a cluster may change.
            room = 2 * int(getattr(executor, "workers", usual))
            while len(running) < room and (one := waiting.take(alone=not running)) is not None:
                try:
                    running[submit(one[1])] = one
                except Exception as error:  # a foreign executor may raise anything
                    raise lost(error) from error
            if not running:
                return
            for future in wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED).done:
                one = running.pop(future)
                killed = _count_deaths(future, lost)
                if not waiting.back(one, killed):
                    yield one[1], future, killed and waiting.deaths[one[0]]
            listen()
    finally:
        for future in running:
            future.cancel()


class _TaskQueue(Generic[_Task]):
    """Numbered tasks that are still to be sent, and the worker deaths of each."""

    def __init__(self, following: Iterator[tuple[int, _Task]]) -> None:
        self.following = following
        self.again: deque[tuple[int, _Task]] = deque()
        self.suspects: deque[tuple[int, _Task]] = deque()
        self.deaths: Counter[int] = Counter()

    def take(self, *, alone: bool) -> tuple[int, _Task] | None:
        """Return the next task; one with `MAX_DEATHS` deaths only if no other is in flight."""
        one = self.again.popleft() if self.again else next(self.following, None)
        return self.suspects.popleft() if one is None and alone and self.suspects else one

    def back(self, one: tuple[int, _Task], killed: int) -> bool:
        """Queue a task again if needed, and return whether it was."""
        alone = self.deaths[one[0]] >= MAX_DEATHS
        self.deaths[one[0]] += killed
        if not killed or alone:
            return False
        if self.deaths[one[0]] < MAX_DEATHS:
            self.again.appendleft(one)
        else:
            self.suspects.append(one)
        return True


def _count_deaths(future: Future[Any], lost: Callable[[BaseException], StudyError]) -> int:
    if future.cancelled():
        raise lost(ConnectionError("its cases were cancelled, perhaps as the scheduler stopped"))
    error = future.exception()
    if isinstance(error, BrokenExecutor):
        raise lost(error) from error
    if type(error).__name__ == "KilledWorker":  # Dask has sent it again by itself, maybe next to the case that kills
        return int(getattr(error, "allowed_failures", MAX_DEATHS)) + 1
    return int(isinstance(error, WorkerDied))


def _read_row(future: Future[tuple[Row, bool]], deaths: int) -> tuple[Row, bool]:
    try:
        return future.result()
    except (StudyError, Stopped):
        raise
    except Exception as error:
        if deaths:
            how = str(error) if isinstance(error, WorkerDied) else "perhaps out of memory"
            return {
                "reason": f"its worker died {deaths} times, the last time with no other case running ({how})"
            }, False
        raise StudyError(
            f"a case cannot be sent to a worker ({type(error).__name__}: {join_lines(error)}): its function must be "
            "in a module that the workers can import, its data numbers, texts, lists and mappings"
        ) from error


def _carry_out(
    key: str,
    data: dict[str, Any],
    work: Work,
    shared: Mapping[str, Any],
    store: Store | None,
    version: str | None,
    threads: int | None,
) -> tuple[Row, bool]:
    if version is not None and version != program_version():
        raise StudyError(
            f"a worker runs turnwright {program_version()}, this is {version}: install the same version on all machines"
        )
    _keep_freed_memory()
    row = None if store is None else store.row(key)  # another driver process may have computed it
    if row is not None:
        return row, True
    with nullcontext() if threads is None or THREADS in environ else at_most(threads):
        row, lasting = _compute(work, data, shared, store)
    if store is not None and lasting:
        store.put_row(key, row)
    return row, lasting


@cache
def _keep_freed_memory() -> None:
    """Let this process keep freed memory up to 64 MB, which is glibc's default.

    Dask changes the default: a worker then returns every array to the system and requests new pages for the next,
    which takes a third more time per case.
    """
    with suppress(OSError, AttributeError, TypeError):  # no glibc
        glibc = ctypes.CDLL(None)
        glibc.mallopt(_MMAP_THRESHOLD, 32 << 20)
        glibc.mallopt(_TRIM_THRESHOLD, 64 << 20)


def _compute(work: Work, data: dict[str, Any], shared: Mapping[str, Any], store: Store | None) -> tuple[Row, bool]:
    try:
        row = json.loads(json.dumps(dict(work(data, shared, store)), default=_plain))
    except (StudyError, Stopped):
        raise
    except TurnwrightError as error:
        return {"reason": str(error)}, True
    except MemoryError as error:
        return {"reason": f"out of memory ({error}): use fewer workers or a coarser map"}, False
    except OSError as error:
        reason = error.strerror or str(error)
        what = "the disk is full" if error.errno in DISK_FULL else "operating system error"
        where = f" at {error.filename}" if error.filename else ""
        return {"reason": f"{what} ({reason}){where}"}, False
    except ImportError as error:
        return {"reason": f"the worker lacks a package ({error})"}, False
    except Exception as error:  # noqa: BLE001 - one case is never the end of the others
        return {"reason": f"{type(error).__name__}: {join_lines(error)} (a defect, please report it)"}, True
    return row, True


def join_lines(error: BaseException) -> str:
    """Return the message of an error in one line."""
    return " ".join(str(error).split()) or "no reason given"


def _plain(value: Any) -> Any:
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:
        return value.item()
    raise TypeError(f"a row holds numbers, texts and None, not {type(value).__name__}")
