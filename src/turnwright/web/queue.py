"""Runs on disk and those who carry them out: a folder each, a process each, a few at a time.

``<folder>/runs/<id>/`` holds ``state.json`` (this server alone writes it), ``job.json`` (the job as the page sent it),
``job.toml`` (as somebody wrote it, if anybody did), ``progress.jsonl`` (of the process), ``log.txt`` (what went wrong
in it) and, once all is done, ``out/``. A server that starts finds what an earlier one left; what was under way is
queued again.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import secrets
import shutil
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from turnwright._io import write_whole
from turnwright.errors import InputError
from turnwright.progress import THREADS, cores
from turnwright.web.limits import LONGEST_H, PARSE_BYTES, PARSE_S
from turnwright.web.references import JOB, text_in

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator, Mapping
    from pathlib import Path

__all__ = ["ENDED", "Run", "Runs"]

ENDED = frozenset({"done", "failed", "cancelled"})
MOST_QUEUED = 50
FAREWELL_S = 5.0
"""For a process that is told to end; then it is ended."""

LOOK_S = 0.2
"""How often somebody who listens is told of progress."""

BEAT_S = 15.0
"""After so long without news a listener is sent a sign of life, or a proxy would hang up."""

STILL = ": still there\n\n"

TAIL = 4096
ID = re.compile("[0-9a-f]{16}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """What is known of a run.

    Parameters
    ----------
    id
        16 hexadecimal digits, made by the server.
    kind
        "run", "compare", "measure" or "correct".
    name
        What the page calls it.
    state
        "queued", "running", "done", "failed" or "cancelled".
    created, started, ended
        Times in UTC as ISO 8601 writes them; ``None`` for what has not happened.
    sentence
        How it ended.
    missed
        Whether its part misses a stated tolerance.
    of
        The run that a measurement belongs to, or the measurement that a correction does.
    file
        The measured file, as the server has named it.
    called
        What it was called where it comes from.
    causes
        What a correction takes into account.
    """

    id: str
    kind: str
    name: str
    state: str = "queued"
    created: str = ""
    started: str | None = None
    ended: str | None = None
    sentence: str = ""
    missed: bool = False
    of: str = ""
    file: str = ""
    called: str = ""
    causes: tuple[str, ...] = ()


class Runs:
    """All runs of a server.

    Parameters
    ----------
    folder
        Of the server.
    at_a_time
        How many are carried out at a time.
    nice
        How far their processes stand back behind everything else.
    parse_s, parse_bytes
        How long reading a measured file may take, and how much memory. [s, byte]
    """

    def __init__(
        self,
        folder: Path,
        *,
        at_a_time: int,
        nice: int = 0,
        parse_s: float = PARSE_S,
        parse_bytes: int = PARSE_BYTES,
    ) -> None:
        self.folder, self.at_a_time = folder, at_a_time
        self._limits = (nice, parse_s, parse_bytes)
        self.place = folder / "runs"
        self.place.mkdir(parents=True, exist_ok=True)
        self._runs: dict[str, Run] = {}
        self._processes: dict[str, asyncio.subprocess.Process] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._cancelled: set[str] = set()
        self._closed = self._hushed = False
        self._changed = 0  # how often the list has
        self._find()

    def _find(self) -> None:
        """Take up what an earlier server left."""
        for entry in sorted(self.place.iterdir()):
            if entry.name.startswith("."):  # half-made when the server ended
                shutil.rmtree(entry, ignore_errors=True)
                continue
            if not ID.fullmatch(entry.name) or entry.is_symlink():
                continue
            with suppress(OSError, ValueError, TypeError, KeyError):
                told = json.loads((entry / "state.json").read_text(encoding="utf-8"))
                told["causes"] = tuple(told["causes"])
                run = Run(**told)
                if run.id != entry.name:
                    continue
                if run.state == "running":
                    run = replace(run, state="queued", started=None)
                    self._clean(run.id)
                self._keep(run)

    def folder_of(self, run: Run) -> Path:
        """Return the folder of a run."""
        return self.place / run.id

    def all(self) -> list[Run]:
        """Return all runs, the newest first."""
        return sorted(self._runs.values(), key=lambda run: (run.created, run.id), reverse=True)

    def get(self, name: str) -> Run | None:
        """Return a run by its id."""
        return self._runs.get(name)

    @contextmanager
    def new_folder(self) -> Iterator[Path]:
        """Yield an empty folder that nobody sees yet, for what a run begins with; it goes again if none is added."""
        folder = self.place / f".{secrets.token_hex(8)}"
        folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def add(self, folder: Path, data: Mapping[str, Any], *, kind: str, name: str, text: str = "", **more: Any) -> Run:
        """Queue a run.

        Parameters
        ----------
        folder
            From `new_folder`, with all that the run needs besides the job.
        data
            The job.
        kind, name, more
            See `Run`.
        text
            The job as somebody wrote it.

        Raises
        ------
        InputError
            If too many wait.
        """
        waiting = sum(run.state == "queued" for run in self._runs.values())
        if waiting >= MOST_QUEUED:
            raise InputError(
                f"{waiting} runs wait already, the limit is {MOST_QUEUED}: cancel some, or come back later"
            )
        run = Run(id=folder.name[1:], kind=kind, name=name[:120], created=_now(), **more)
        (folder / "job.json").write_text(json.dumps(data), encoding="utf-8")
        if text:
            (folder / JOB).write_bytes(text.encode())  # as it is: Windows would write other ends of lines
        (folder / "state.json").write_text(json.dumps(asdict(run)), encoding="utf-8")
        folder.rename(self.place / run.id)
        self._runs[run.id] = run
        self._changed += 1
        self.start()
        return run

    def data(self, run: Run) -> dict[str, Any]:
        """Return the job of a run, as the page sent it."""
        found: dict[str, Any] = json.loads((self.place / run.id / "job.json").read_text(encoding="utf-8"))
        return found

    def text(self, run: Run) -> str:
        """Return the job of a run as somebody wrote it; empty if nobody did."""
        return text_in(self.place / run.id)

    def start(self) -> None:
        """Begin as many of the runs that wait as there is room for."""
        if self._closed:
            return
        room = self.at_a_time - sum(run.state == "running" for run in self._runs.values())
        waiting = [run for run in reversed(self.all()) if run.state == "queued"]
        for run in waiting[: max(room, 0)]:
            self._keep(replace(run, state="running", started=_now()))
            self._tasks[run.id] = asyncio.create_task(self._carry_out(run.id))

    async def cancel(self, name: str) -> None:
        """End a run that has not ended."""
        run = self._runs[name]
        if run.state == "queued":
            self._keep(replace(run, state="cancelled", ended=_now(), sentence="it was cancelled before it began"))
        elif run.state == "running":
            self._cancelled.add(name)
            process = self._processes.get(name)
            if process is not None:
                await _end(process)
            await asyncio.wait({self._tasks[name]})

    async def remove(self, name: str) -> None:
        """Throw away a run that has ended."""
        del self._runs[name]
        self._changed += 1
        self._tasks.pop(name, None)
        doomed = self.place / f".{name}-removed"
        with suppress(FileNotFoundError):  # deleted outside the workbench
            (self.place / name).rename(doomed)
        await asyncio.to_thread(shutil.rmtree, doomed, ignore_errors=True)

    async def close(self) -> None:
        """End all processes; what was under way is queued again when a server starts."""
        self._closed = True
        await asyncio.gather(*(_end(process) for process in self._processes.values()))
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    def progress(self, name: str) -> dict[str, Any] | None:
        """Return what a run that is under way told last."""
        with suppress(OSError, ValueError), (self.place / name / "progress.jsonl").open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(0, file.tell() - TAIL))
            lines = file.read().split(b"\n")
            if len(lines) > 1:  # the last one may be half-written
                found: dict[str, Any] = json.loads(lines[-2])
                return found
        return None

    def hush(self) -> None:
        """Tell those who listen no more, for the server is about to end and waits for them."""
        self._hushed = True

    async def changes(self) -> AsyncIterator[str]:
        """Yield an event at once, and whenever a run is begun, goes on to another state or is thrown away."""
        told = -1
        quiet = time.monotonic()
        while not self._closed and not self._hushed:
            if told != self._changed:
                told = self._changed
                yield _event("runs", {"changed": told})
                quiet = time.monotonic()
            elif time.monotonic() - quiet > BEAT_S:
                quiet = time.monotonic()
                yield STILL
            await asyncio.sleep(LOOK_S)

    async def events(self, name: str) -> AsyncIterator[str]:
        """Yield what happens to a run as an event stream, beginning with its present state, until it has ended."""
        told: tuple[str, str] | None = None
        last: dict[str, Any] | None = None
        quiet = time.monotonic()
        while True:
            run = self._runs.get(name)
            if run is None:
                return
            if (run.state, run.sentence) != told:
                told = run.state, run.sentence
                yield _event("state", {"state": run.state, "sentence": run.sentence})
                quiet = time.monotonic()
            if run.state in ENDED or self._closed or self._hushed:
                return
            progress = self.progress(name) if run.state == "running" else None
            if progress is not None and progress != last:
                last = progress
                yield _event("progress", progress)
                quiet = time.monotonic()
            elif time.monotonic() - quiet > BEAT_S:
                quiet = time.monotonic()
                yield STILL
            await asyncio.sleep(LOOK_S)

    def _keep(self, run: Run) -> None:
        self._runs[run.id] = run
        self._changed += 1
        with suppress(OSError):  # a full disk: the state is at least known here
            write_whole(self.place / run.id / "state.json", json.dumps(asdict(run)))

    def _clean(self, name: str) -> None:
        """Remove what an interrupted run has left."""
        folder = self.place / name
        for entry in folder.glob(".out*"):
            shutil.rmtree(entry, ignore_errors=True)
        (folder / "progress.jsonl").unlink(missing_ok=True)

    async def _carry_out(self, name: str) -> None:
        state, sentence, missed = "failed", "the server could not start a process for it: try it again", False
        try:
            state, sentence, missed = await self._in_process(name)
        except OSError as error:
            sentence = f"no process can be started for it ({error.strerror}): try it again"
        finally:
            self._processes.pop(name, None)
            run = self._runs.get(name)
            if name in self._cancelled:
                self._cancelled.discard(name)
                state, sentence = "cancelled", "it was cancelled, nothing of it was kept"
            if run is not None and not (self._closed and state != "done"):
                self._keep(replace(run, state=state, sentence=sentence, missed=missed, ended=_now()))
            if state != "done":
                self._clean(name)
            self.start()

    async def _in_process(self, name: str) -> tuple[str, str, bool]:
        """Carry out a run in a process of its own; return its state, how it ended, and if it misses a tolerance."""
        if name in self._cancelled or self._closed:
            return "cancelled", "", False
        folder = self.place / name
        # Its standard input stays open as long as this server lives: when it closes, the process ends itself.
        with (folder / "log.txt").open("wb") as log:
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-P", "-m", "turnwright.web.worker", str(folder), str(self.folder),
                *map(str, self._limits),
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=log, limit=2**20,
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
                    THREADS: str(max(1, cores() // self.at_a_time)),
                },
            )  # fmt: skip
        self._processes[name] = process
        if name in self._cancelled or self._closed:
            await _end(process)
        try:
            output = await asyncio.wait_for(process.stdout.read(), LONGEST_H * 3600)  # type: ignore[union-attr]
        except TimeoutError:
            await _end(process)
            return "failed", f"it took more than {LONGEST_H} h, the limit: run the job by the command line", False
        code = await process.wait()
        with suppress(ValueError, KeyError, IndexError):
            outcome = json.loads(output.decode().splitlines()[-1])
            return outcome["state"], outcome["sentence"], outcome["missed"]
        how = "the memory ran out, or it was ended from outside" if code < 0 else f"code {code}, see its log.txt"
        return "failed", f"its process ended before it was done ({how}): make the job smaller, or try it again", False


async def _end(process: asyncio.subprocess.Process) -> None:
    """End a process, politely first."""
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), FAREWELL_S)
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.kill()


def _event(name: str, data: Mapping[str, Any]) -> str:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
