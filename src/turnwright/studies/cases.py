"""Cases out, rows back: each computed once, none lost, whatever happens to workers and driver."""

from __future__ import annotations

import ctypes
import hashlib
import json
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version as version_of
from os import environ
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

from turnwright import _validate as validate
from turnwright._io import read_toml
from turnwright.errors import InputError, Stopped, StudyError, TurnwrightError
from turnwright.progress import THREADS, Progress, at_most, cores
from turnwright.studies.executors import (
    Cluster,
    LocalPool,
    WorkerDied,
    fitting,
    local,
    require_reach,
    share_of,
)
from turnwright.studies.store import FULL, Store

__all__ = ["Case", "Row", "Work", "case_key", "conduct", "finished", "line", "program_version"]

Row: TypeAlias = dict[str, Any]
"""Numbers, texts or None by name; a case that could not be carried out has only ``reason``, a sentence."""

Work: TypeAlias = Callable[[Mapping[str, Any], Mapping[str, Any], Store | None], Mapping[str, Any]]
"""A function of a module, called as ``work(data, shared, store)``."""

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")

DEATHS = 3
"""Workers that a case may take with it among others, before it is tried alone."""
_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1
"""What glibc's malloc.h calls its parameters."""
_LISTEN_S = 0.5
"""How long at most until a wish to stop is heard, and progress told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One thing to compute.

    Parameters
    ----------
    key
        What it is kept under: it must differ wherever the row may, see `case_key`.
    data
        What the work needs to know of it, as JSON could carry it.
    """

    key: str
    data: Mapping[str, Any]


def case_key(data: Mapping[str, Any]) -> str:
    """Return the name of a case: the digest of its data and of the program that computes it.

    Parameters
    ----------
    data
        Everything that the row depends on, what is shared by all cases included. A text that is the whole path of a
        file stands for the content of that file, and of those that it names if it is a TOML file.

    Raises
    ------
    InputError
        If the data cannot be written as JSON.

    >>> case_key({"a": 1, "b": 2.5}) == case_key({"b": 2.5, "a": 1})
    True
    """
    try:
        text = json.dumps([_stated(data), program_version()], sort_keys=True, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise InputError(f"a case must be plain data ({error}): use numbers, texts, lists and mappings") from None
    return hashlib.sha256(text.encode()).hexdigest()


def _stated(value: Any, folder: Path | None = None, above: frozenset[Path] = frozenset()) -> Any:
    """Return data with the files that it names replaced by what is in them."""
    if isinstance(value, Mapping):
        return {key: _stated(one, folder, above) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_stated(one, folder, above) for one in value]
    if not isinstance(value, str) or not (folder or value.startswith(("/", "\\")) or value[1:2] == ":"):
        return value
    file = Path(value) if folder is None else folder / value
    try:
        if not file.is_file() or file in above:
            return value
        state = file.stat()
        content: Any = _digest(file, state.st_mtime_ns, state.st_size)
    except (OSError, ValueError):  # no path after all
        return value
    if file.suffix == ".toml":
        with suppress(OSError, InputError):  # no TOML: its bytes are all there is
            table = read_toml(file.read_bytes(), f"the file {str(file)!r}")
            content = [content, _stated(table, file.parent, above | {file})]
    return {"file": content}


@lru_cache(maxsize=1024)
def _digest(file: Path, _changed_ns: int, _size: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


@cache
def program_version() -> str:
    """Return the version of this program with a digest of its own files, so that edited code is another program."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(file for kind in ("*.py", "*.toml") for file in root.rglob(kind)):
        digest.update(f"{file.relative_to(root).as_posix()}\0".encode())
        digest.update(file.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    return f"{version_of('turnwright')}+{digest.hexdigest()[:12]}"


def conduct(
    work: Work,
    cases: Sequence[Case],
    *,
    shared: Mapping[str, Any] | None = None,
    executor: Executor | None = None,
    store: Store | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Carry out cases, each once, and return their rows.

    The worker keeps the row of its case in the store before it says so; a driver that is killed and started again finds
    it there. A case that fails is a row with its reason; one whose reason lies with the machine (memory, disk, files)
    is not kept and so tried again the next time. A case whose worker dies is sent again; one that has taken
    `DEATHS` workers with it is tried alone when all else is done, and if it kills even then it is a row too.

    Parameters
    ----------
    work
        A function of a module, ``work(data, shared, store)``, that returns numbers, texts and None by name.
    cases
        What to compute; equal keys are computed once.
    shared
        What every case needs, as JSON could carry it; large arrays go through the store.
    executor
        Any `concurrent.futures.Executor`: `local`, `cluster`, or another whose workers can import the work. A local
        pool made for this call, if not given.
    store
        Where finished cases are kept and found.
    progress
        Called with (done, total), at least twice a second; raising in it stops the work.

    Returns
    -------
    list of dict
        One row for each case, in their order.

    Raises
    ------
    InputError
        If the store lies in the memory of this process and the workers are others.
    StudyError
        If the work cannot go on: the store takes nothing more, or the executor is broken. What is finished stays.
    """
    _require_kinds(work, cases, shared, executor, store)
    validate.listener(progress)
    if executor is None:
        workers = min(fitting(), max(1, len(cases)))
        with local(workers, threads=share_of(workers)) as pool:
            return conduct(work, cases, shared=shared, executor=pool, store=store, progress=progress)
    if store is not None:
        require_reach(store.place, executor)
    rows = {} if store is None else _kept(cases, store)
    todo = {case.key: case for case in cases if case.key not in rows}
    ours = isinstance(executor, LocalPool)  # its workers run these very files, and reach every folder
    threads = 1 if isinstance(executor, Cluster) else None  # Dask counts one thread for each of its own
    order = (work, shared or {}, store, None if ours else program_version(), threads)
    total = len(rows) + len(todo)

    def tell() -> None:
        if progress is not None:
            progress(len(rows), total)

    def lost(error: BaseException) -> StudyError:
        kept = "kept" if store is not None else "lost, for want of a store"
        return StudyError(
            f"the executor carries out no more cases ({type(error).__name__}: {line(error)}), the "
            f"{len(rows)} that are finished are {kept}: start again with another"
        )

    def send(case: Case) -> Future[tuple[Row, bool]]:
        return executor.submit(_carry_out, case.key, dict(case.data), *order)

    tell()
    with closing(finished(send, todo.values(), executor, lost=lost, listen=tell)) as done:
        for case, future, deaths in done:
            row, lasting = _row(future, deaths)
            if lasting and not ours and store is not None and store.row(case.key) is None:
                store.put_row(case.key, row)
            rows[case.key] = row
    return [rows[case.key] for case in cases]


def _kept(cases: Sequence[Case], store: Store) -> dict[str, Row]:
    """Return the rows of cases that are finished."""
    there = store.keys()
    rows = {case.key: store.row(case.key) for case in cases if case.key in there}
    return {key: row for key, row in rows.items() if row is not None}


def _require_kinds(work: object, cases: object, shared: object, executor: object, store: object) -> None:
    """Raise unless all is of the kind that `conduct` takes."""
    if not callable(work):
        raise InputError(f"the work is a {type(work).__name__}, it must be a function of a module: give one")
    if not isinstance(cases, Sequence) or not all(isinstance(one, Case) for one in cases):
        raise InputError(f"the cases are a {type(cases).__name__}, they must be a list of Case: make it so")
    for one in cases:
        if not isinstance(one.key, str) or not isinstance(one.data, Mapping):
            raise InputError(f"a case has the key {one.key!r}, it must be a text, and its data a mapping: use case_key")
    if shared is not None:
        validate.thing(shared, Mapping, "what the cases share")
    if executor is not None:
        validate.thing(executor, Executor, "the executor")
    if store is not None:
        validate.thing(store, Store, "the store")


def finished(
    submit: Callable[[_Task], Future[_Answer]],
    tasks: Iterable[_Task],
    executor: Executor,
    *,
    lost: Callable[[BaseException], StudyError],
    listen: Callable[[], None] = lambda: None,
) -> Generator[tuple[_Task, Future[_Answer], int], None, None]:
    """Yield tasks as they are done, each with its future; one given up, with how many workers it took with it, else 0.

    Few are in flight at a time, so that a stop is quick and a cluster's scheduler never full. A task whose worker dies
    is sent again; one that has taken `DEATHS` workers with it is tried alone when all else is done.

    Parameters
    ----------
    submit
        Sends a task to the executor.
    tasks
        What is to be done.
    executor
        Who does it.
    lost
        Makes the error to raise of what the executor says when it carries out nothing more.
    listen
        Called at least twice a second; raising in it stops the work.
    """
    waiting = _Waiting(enumerate(tasks))
    running: dict[Future[_Answer], tuple[int, _Task]] = {}
    usual = getattr(executor, "_max_workers", None) or cores()
    try:
        while True:
            # Each worker has one task in hand and one waiting; those of a cluster come and go.
            room = 2 * int(getattr(executor, "workers", usual))
            while len(running) < room and (one := waiting.take(alone=not running)) is not None:
                try:
                    running[submit(one[1])] = one
                except Exception as error:  # an executor of somebody else may end in any way
                    raise lost(error) from error
            if not running:
                return
            for future in wait(running, timeout=_LISTEN_S, return_when=FIRST_COMPLETED).done:
                one = running.pop(future)
                killed = _killed(future, lost)
                if not waiting.back(one, killed):
                    yield one[1], future, killed and waiting.deaths[one[0]]
            listen()
    finally:
        for future in running:
            future.cancel()


class _Waiting(Generic[_Task]):
    """Numbered tasks that are still to be sent, and what those that kill have killed."""

    def __init__(self, following: Iterator[tuple[int, _Task]]) -> None:
        self.following = following
        self.again: deque[tuple[int, _Task]] = deque()
        self.suspects: deque[tuple[int, _Task]] = deque()
        self.deaths: Counter[int] = Counter()

    def take(self, *, alone: bool) -> tuple[int, _Task] | None:
        """Return what is to be sent next, a suspect only where it is alone."""
        one = self.again.popleft() if self.again else next(self.following, None)
        return self.suspects.popleft() if one is None and alone and self.suspects else one

    def back(self, one: tuple[int, _Task], killed: int) -> bool:
        """Take back a task if it is to be sent again, and say so."""
        alone = self.deaths[one[0]] >= DEATHS
        self.deaths[one[0]] += killed
        if not killed or alone:
            return False
        if self.deaths[one[0]] < DEATHS:
            self.again.appendleft(one)
        else:
            self.suspects.append(one)
        return True


def _killed(future: Future[Any], lost: Callable[[BaseException], StudyError]) -> int:
    """Return how many workers a task took with it; raise if the executor is lost."""
    if future.cancelled():
        raise lost(ConnectionError("its cases were cancelled, as when a scheduler is gone"))
    error = future.exception()
    if isinstance(error, BrokenExecutor):
        raise lost(error) from error
    if type(error).__name__ == "KilledWorker":  # Dask has sent it again by itself, maybe beside the guilty one
        return int(getattr(error, "allowed_failures", DEATHS)) + 1
    return int(isinstance(error, WorkerDied))


def _row(future: Future[tuple[Row, bool]], deaths: int) -> tuple[Row, bool]:
    """Return the row of a case, and whether it would be the same another time."""
    try:
        return future.result()
    except (StudyError, Stopped):
        raise
    except Exception as error:
        if deaths:
            how = str(error) if isinstance(error, WorkerDied) else "as when the memory runs out"
            return {"reason": f"its worker died {deaths} times, the last time with nothing beside it ({how})"}, False
        raise StudyError(
            f"a case cannot travel to a worker and back ({type(error).__name__}: {line(error)}): the work must be "
            "a function of a module that the workers can import, its data plain"
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
    """Carry out a case in a worker; return its row, and whether it would be the same another time."""
    if version is not None and version != program_version():
        raise StudyError(
            f"a worker runs turnwright {program_version()}, this is {version}: install the same on all machines"
        )
    _keep_freed_memory()
    row = None if store is None else store.row(key)  # another driver may have been here
    if row is not None:
        return row, True
    with nullcontext() if threads is None or THREADS in environ else at_most(threads):
        row, lasting = _compute(work, data, shared, store)
    if store is not None and lasting:
        store.put_row(key, row)
    return row, lasting


@cache
def _keep_freed_memory() -> None:
    """Let this process keep what it frees, up to 64 MB, as glibc comes to by itself unless it is told otherwise.

    Dask tells it otherwise: a worker then gives every array back to the system and takes new pages for the next, which
    costs a case a third more time.
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
        return {"reason": f"the memory is not enough ({error}): use fewer workers or a coarser map"}, False
    except OSError as error:
        said = error.strerror or str(error)
        what = "the disk is full" if error.errno in FULL else "the system refuses"
        where = f" at {error.filename}" if error.filename else ""
        return {"reason": f"{what} ({said}){where}"}, False
    except ImportError as error:
        return {"reason": f"the worker lacks a package ({error})"}, False
    except Exception as error:  # noqa: BLE001 - one case is never the end of the others
        return {"reason": f"{type(error).__name__}: {line(error)} (a defect, please report it)"}, True
    return row, True


def line(error: BaseException) -> str:
    """Return what an error says, in one line."""
    return " ".join(str(error).split()) or "it gives no reason"


def _plain(value: Any) -> Any:
    """Turn a number of NumPy into one of Python."""
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:
        return value.item()
    raise TypeError(f"a row holds numbers, texts and None, not {type(value).__name__}")
