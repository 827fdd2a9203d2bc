"""Queue of runs: each has its own folder and process, and a few run at a time.

``<folder>/runs/<id>/`` contains ``state.json`` (written by the server only), ``job.json`` (the job as data),
``job.toml`` (the job as text, if there is one), ``progress.jsonl`` and ``log.txt`` (written by the process) and, once
the run is done, ``out/``. A server takes over the runs of an earlier one and queues interrupted runs again.
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
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from pydantic import ConfigDict

from turnwright._io import write_atomic
from turnwright.errors import InputError
from turnwright.progress import THREADS, cores
from turnwright.web.limits import MAX_RUN_H, PARSE_BYTES, PARSE_S
from turnwright.web.models import RunState
from turnwright.web.references import JOB, text_in

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator, Mapping
    from pathlib import Path

__all__ = ["ENDED", "Run", "Runs"]

ENDED = frozenset({"done", "failed", "cancelled"})
MAX_QUEUED = 50
TERMINATION_S = 5.0
"""Time between SIGTERM and SIGKILL for a process. [s]"""

POLL_S = 0.2
"""Interval of progress events. [s]"""

HEARTBEAT_S = 15.0
"""Longest time without an event, so that a proxy does not close the stream. [s]"""

HEARTBEAT = ": still there\n\n"

TAIL_BYTES = 4096
RUN_ID = re.compile("[0-9a-f]{16}")


class Run(RunState):
    """A run as its folder records it."""

    model_config = ConfigDict(frozen=True)

    file: str = ""  # measured, by its name on disk
    called: str = ""  # original name of the measured file
    error_sources: tuple[str, ...] = ()  # error sources that a correction takes into account


class Runs:
    """All runs of a server; for the parameters see `turnwright.web.create_app`."""

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
        self._closed = self._is_ending = False
        self._changed = 0  # version of the list
        self._find()

    def _find(self) -> None:
        """Load the runs of an earlier server."""
        for entry in sorted(self.place.iterdir()):
            if entry.name.startswith("."):  # incomplete when the server ended
                shutil.rmtree(entry, ignore_errors=True)
                continue
            if not RUN_ID.fullmatch(entry.name) or entry.is_symlink():
                continue
            with suppress(OSError, ValueError):
                run = Run.model_validate_json((entry / "state.json").read_bytes())
                if run.id != entry.name:
                    continue
                if run.state == "running":
                    run = run.model_copy(update={"state": "queued", "started": None})
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
        """Yield a hidden folder for the input of a run; it is removed unless the run is added."""
        folder = self.place / f".{secrets.token_hex(8)}"
        folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def add(self, folder: Path, data: Mapping[str, Any], *, name: str, text: str = "", **more: Any) -> Run:
        """Queue a run whose input, besides the job, is in a folder from `new_folder`; ``more`` are fields of `Run`."""
        waiting = sum(run.state == "queued" for run in self._runs.values())
        if waiting >= MAX_QUEUED:
            raise InputError(f"at most {MAX_QUEUED} runs can wait, got {waiting}: cancel some, or try again later")
        run = Run(id=folder.name[1:], name=name[:120], created=_now(), **more)
        (folder / "job.json").write_text(json.dumps(data), encoding="utf-8")
        if text:
            (folder / JOB).write_bytes(text.encode())  # bytes: keep the line endings
        (folder / "state.json").write_text(run.model_dump_json(), encoding="utf-8")
        folder.rename(self.place / run.id)
        self._runs[run.id] = run
        self._changed += 1
        self.start()
        return run

    def data(self, run: Run) -> dict[str, Any]:
        """Return the job of a run as data."""
        job: dict[str, Any] = json.loads((self.place / run.id / "job.json").read_text(encoding="utf-8"))
        return job

    def text(self, run: Run) -> str:
        """Return the job of a run as text; empty if there is none."""
        return text_in(self.place / run.id)

    def start(self) -> None:
        """Start waiting runs, up to the number of parallel runs."""
        if self._closed:
            return
        room = self.at_a_time - sum(run.state == "running" for run in self._runs.values())
        waiting = [run for run in reversed(self.all()) if run.state == "queued"]
        for run in waiting[: max(room, 0)]:
            self._change(run, state="running", started=_now())
            self._tasks[run.id] = asyncio.create_task(self._carry_out(run.id))

    async def cancel(self, name: str) -> None:
        """Cancel a run that has not ended."""
        run = self._runs[name]
        if run.state == "queued":
            self._change(run, state="cancelled", ended=_now(), sentence="cancelled before it started")
        elif run.state == "running":
            self._cancelled.add(name)
            process = self._processes.get(name)
            if process is not None:
                await _end(process)
            await asyncio.wait({self._tasks[name]})

    async def remove(self, name: str) -> None:
        """Delete a run that has ended."""
        del self._runs[name]
        self._changed += 1
        self._tasks.pop(name, None)
        doomed = self.place / f".{name}-removed"
        with suppress(FileNotFoundError):  # deleted outside the workbench
            (self.place / name).rename(doomed)
        await asyncio.to_thread(shutil.rmtree, doomed, ignore_errors=True)

    async def close(self) -> None:
        """End all processes; interrupted runs are queued again at the next start."""
        self._closed = True
        await asyncio.gather(*(_end(process) for process in self._processes.values()))
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    def progress(self, name: str) -> dict[str, Any] | None:
        """Return the latest progress of a run."""
        with suppress(OSError, ValueError), (self.place / name / "progress.jsonl").open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(0, file.tell() - TAIL_BYTES))
            lines = file.read().split(b"\n")
            if len(lines) > 1:  # the last line may be incomplete
                progress: dict[str, Any] = json.loads(lines[-2])
                return progress
        return None

    def end_streams(self) -> None:
        """End all event streams, so that the server can shut down."""
        self._is_ending = True

    async def changes(self) -> AsyncIterator[str]:
        """Yield an event at once, and whenever a run is added, changes its state or is deleted."""
        sent = -1

        def news() -> list[str]:
            nonlocal sent
            if sent == self._changed:
                return []
            sent = self._changed
            return [_event("runs", {"changed": sent})]

        async for event in self._polled(news):
            yield event

    async def events(self, name: str) -> AsyncIterator[str]:
        """Yield the state and progress events of a run until it has ended."""
        sent: dict[str, dict[str, Any]] = {}

        def news() -> list[str] | None:
            run = self._runs.get(name)
            if run is None or sent.get("state", {}).get("state") in ENDED:
                return None
            latest = {"state": {"state": run.state, "sentence": run.sentence}}
            if run.state == "running" and (progress := self.progress(name)) is not None:
                latest["progress"] = progress
            changed = {kind: data for kind, data in latest.items() if data != sent.get(kind)}
            sent.update(changed)
            return [_event(kind, data) for kind, data in changed.items()]

        async for event in self._polled(news):
            yield event

    async def _polled(self, news: Callable[[], list[str] | None]) -> AsyncIterator[str]:
        """Yield new events, and heartbeats between them, until there are ``None`` or the server ends."""
        quiet = time.monotonic()
        while (events := news()) is not None:
            for event in events or ([HEARTBEAT] if time.monotonic() - quiet > HEARTBEAT_S else []):
                quiet = time.monotonic()
                yield event
            if self._closed or self._is_ending:
                return
            await asyncio.sleep(POLL_S)

    def _change(self, run: Run, **fields: Any) -> None:
        self._keep(run.model_copy(update=fields))

    def _keep(self, run: Run) -> None:
        self._runs[run.id] = run
        self._changed += 1
        with suppress(OSError):  # on a full disk the state is kept in memory
            write_atomic(self.place / run.id / "state.json", run.model_dump_json())

    def _clean(self, name: str) -> None:
        """Remove partial results of a run."""
        folder = self.place / name
        for entry in folder.glob(".out*"):
            shutil.rmtree(entry, ignore_errors=True)
        (folder / "progress.jsonl").unlink(missing_ok=True)

    async def _carry_out(self, name: str) -> None:
        state, sentence, missed = "failed", "no process could be started", False
        try:
            state, sentence, missed = await self._in_process(name)
        except OSError as error:
            sentence = f"no process could be started ({error.strerror})"
        finally:
            self._processes.pop(name, None)
            run = self._runs.get(name)
            if name in self._cancelled:
                self._cancelled.discard(name)
                state, sentence = "cancelled", "cancelled, no results were kept"
            if run is not None and not (self._closed and state != "done"):
                self._change(run, state=state, sentence=sentence, missed=missed, ended=_now())
            if state != "done":
                self._clean(name)
            self.start()

    async def _in_process(self, name: str) -> tuple[str, str, bool]:
        """Carry out a run in its own process; return state, outcome and whether a tolerance is missed."""
        if name in self._cancelled or self._closed:
            return "cancelled", "", False
        folder = self.place / name
        # The process ends itself when its standard input closes, that is, when this server ends.
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
            output = await asyncio.wait_for(process.stdout.read(), MAX_RUN_H * 3600)  # type: ignore[union-attr]
        except TimeoutError:
            await _end(process)
            return "failed", f"the run took more than {MAX_RUN_H} h, the limit: use the command line", False
        code = await process.wait()
        with suppress(ValueError, KeyError, IndexError):
            outcome = json.loads(output.decode().splitlines()[-1])
            return outcome["state"], outcome["sentence"], outcome["missed"]
        how = "out of memory, or killed" if code < 0 else f"exit code {code}, see log.txt of the run"
        return "failed", f"the process of the run ended early ({how})", False


async def _end(process: asyncio.subprocess.Process) -> None:
    """Terminate a process; kill it after `TERMINATION_S`."""
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), TERMINATION_S)
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.kill()


def _event(name: str, data: Mapping[str, Any]) -> str:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
