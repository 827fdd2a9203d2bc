"""Cases out, rows back: each computed once, none lost, whatever happens to workers and driver."""

from __future__ import annotations

import ctypes
import hashlib
import json
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version as version_of
from os import environ
from pathlib import Path
from typing import Any, TypeAlias

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

__all__ = ["Case", "Row", "Work", "case_key", "conduct", "program_version"]

Row: TypeAlias = dict[str, Any]
"""Numbers, texts or None by name; a case that could not be carried out has only ``reason``, a sentence."""

Work: TypeAlias = Callable[[Mapping[str, Any], Mapping[str, Any], Store | None], Mapping[str, Any]]
"""A function of a module, called as ``work(data, shared, store)``."""

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
    kept = set() if store is None else store.keys()
    rows: dict[str, Row] = {}
    todo: dict[str, Case] = {}
    for case in cases:
        row = store.row(case.key) if store is not None and case.key in kept else None
        if row is not None:
            rows[case.key] = row
        else:
            todo[case.key] = case
    _Conductor(work, shared or {}, executor, store, rows, progress).carry_out(todo.values())
    return [rows[case.key] for case in cases]


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


class _Conductor:
    """Few cases in flight at a time, so that a stop is quick and a cluster's scheduler never full."""

    def __init__(
        self,
        work: Work,
        shared: Mapping[str, Any],
        executor: Executor,
        store: Store | None,
        rows: dict[str, Row],
        progress: Progress | None,
    ) -> None:
        self.executor = executor
        self.store = store
        self.rows = rows
        self.progress = progress
        ours = isinstance(executor, LocalPool)  # its workers run these very files
        threads = 1 if isinstance(executor, Cluster) else None  # Dask counts one thread for each of its own
        self.order = (work, shared, store, None if ours else program_version(), threads)
        self.running: dict[Future[tuple[Row, bool]], Case] = {}
        self.deaths: Counter[str] = Counter()

    def carry_out(self, cases: Collection[Case]) -> None:
        """Fill the rows."""
        total = len(self.rows) + len(cases)
        pending = deque(cases)
        suspects: deque[Case] = deque()
        try:
            self._tell(total)
            while pending or suspects or self.running:
                while pending and len(self.running) < self._room():
                    self._send(pending.popleft())
                if suspects and not self.running:
                    self._send(suspects.popleft())
                done, _ = wait(self.running, timeout=_LISTEN_S, return_when=FIRST_COMPLETED)
                for future in done:
                    case = self.running.pop(future)
                    row = self._judge(future, case)
                    if row is not None:
                        self.rows[case.key] = row
                    elif self.deaths[case.key] < DEATHS:
                        pending.appendleft(case)
                    else:
                        suspects.append(case)
                self._tell(total)
        finally:
            for future in self.running:
                future.cancel()

    def _tell(self, total: int) -> None:
        if self.progress is not None:
            self.progress(len(self.rows), total)

    def _room(self) -> int:
        """Return how many cases may be in flight, so that each worker has one in hand and one waiting."""
        workers = getattr(self.executor, "workers", None) or getattr(self.executor, "_max_workers", None) or cores()
        return 2 * int(workers)

    def _send(self, case: Case) -> None:
        try:
            future = self.executor.submit(_carry_out, case.key, dict(case.data), *self.order)
        except Exception as error:  # an executor of somebody else may end in any way
            raise self._lost(error) from error
        self.running[future] = case

    def _judge(self, future: Future[tuple[Row, bool]], case: Case) -> Row | None:
        """Return the row of a case, or None if it is to be tried again."""
        try:
            row, lasting = future.result()
        except WorkerDied as death:
            return self._died(case, str(death), 1)
        except (StudyError, Stopped):
            raise
        except BrokenExecutor as error:
            raise self._lost(error) from error
        except CancelledError:
            raise self._lost(ConnectionError("its cases were cancelled, as when a scheduler is gone")) from None
        except Exception as error:
            if type(error).__name__ == "KilledWorker":  # Dask has sent it again by itself, maybe beside the guilty one
                return self._died(case, "as when the memory runs out", getattr(error, "allowed_failures", DEATHS) + 1)
            raise StudyError(
                f"a case cannot travel to a worker and back ({type(error).__name__}: {_line(error)}): the work must be "
                "a function of a module that the workers can import, its data plain"
            ) from error
        foreign = not isinstance(self.executor, LocalPool)  # the folder of another machine may not be the one here
        if lasting and foreign and self.store is not None and self.store.row(case.key) is None:
            self.store.put_row(case.key, row)
        return row

    def _died(self, case: Case, how: str, deaths: int) -> Row | None:
        alone = self.deaths[case.key] >= DEATHS
        self.deaths[case.key] += deaths
        if not alone:
            return None
        return {
            "reason": f"its worker died {self.deaths[case.key]} times, the last time with nothing beside it ({how})"
        }

    def _lost(self, error: BaseException) -> StudyError:
        kept = "kept" if self.store is not None else "lost, for want of a store"
        return StudyError(
            f"the executor carries out no more cases ({type(error).__name__}: {_line(error)}), the "
            f"{len(self.rows)} that are finished are {kept}: start again with another"
        )


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
        return {"reason": f"{type(error).__name__}: {_line(error)} (a defect, please report it)"}, True
    return row, True


def _line(error: BaseException) -> str:
    """Return what an error says, in one line."""
    return " ".join(str(error).split()) or "it gives no reason"


def _plain(value: Any) -> Any:
    """Turn a number of NumPy into one of Python."""
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:
        return value.item()
    raise TypeError(f"a row holds numbers, texts and None, not {type(value).__name__}")
