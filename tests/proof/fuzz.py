"""Thousands of mutated inputs: each is answered soon, in little memory, in a few letters, and never by a defect.

``python tests/proof/fuzz.py --inputs 20000 --seed 1`` prints a table and ends with 1 where an input failed. That input
is kept in a folder; ``python tests/proof/fuzz.py --again FOLDER`` gives it once more.

An answer is a refusal, the end of the work, or progress that announces how much there is to do, after the access to the
surface has been checked; then the work may go on for a while, and is stopped. Kernels are compiled, and libraries
imported, before the first input.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import faulthandler
import functools
import gc
import io
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from multiprocessing import get_context
from multiprocessing.connection import wait
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import tomli_w

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a fork keeps no threads
sys.path.insert(0, str(Path(__file__).parent))

import fuzz_inputs as inputs
import turnwright as tw
from fuzz_inputs import Case
from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

ANSWER_S = 10.0
"""Processor time until an answer."""

WORK_S = 2.0
"""Processor time that announced work is given before it is stopped, unless ``--work`` states another."""

DEADLINE_S = 40.0
"""Processor time after which an input is given up and its process ended."""

PATIENCE_S = 300.0
"""The same by the clock, for one that waits for something."""

PEAK = 1e9
"""Memory of the process, what it starts with included. [byte]"""

ROOM = 3 << 30
"""Address space beyond what a process starts with. [byte]"""

LINE = 400
"""Letters in a line of a message."""

LINES = 40
"""Lines of a message: more fill the screen."""

WEIGHTS = {"job": 40, "formula": 15, "program": 15, "file": 18, "upload": 12}
"""How many of a hundred inputs are of each kind."""

BAD_NUMBER = re.compile(r"(?<![\w'\"/.-])[-+]?(?:nan|inf)(?![\w'\"-])", re.IGNORECASE)
SLIPS = re.compile(r"warning: .*(?:encountered in|input contained|Warning|deprecat)|Traceback|defect of Turnwright")


class Announced(KeyboardInterrupt):
    """Raised in announced work that has been given its time."""


class Listener:
    """Hears progress as a command tells it."""

    work_s = WORK_S

    def __init__(self) -> None:
        self.start = _spent()
        self.answered: float | None = None
        self.peak = 0

    def __call__(self, stage: str, _done: int, total: int) -> None:
        """Note when the work is announced, and end it when it has had its time."""
        if total > 1 and stage != "access" and self.answered is None:
            self.answered, self.peak = _spent() - self.start, _peak()
        if self.answered is not None and _spent() - self.start > self.answered + self.work_s:
            raise Announced


def _spent() -> float:
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


def _peak() -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(re.search(r"VmHWM:\s*(\d+)", status)[1])


class Inline:
    """Answers the server's questions in this process."""

    async def ask(self, function: Callable[..., Any], *arguments: Any, **_options: Any) -> Any:
        return function(*arguments)

    def close(self) -> None:
        """Nothing is open."""


# --- what is done with an input: the text of the answer, and an exit code


def ask(case: Case, folder: Path, listener: Listener) -> tuple[int, str]:
    """Give an input, written to a folder, to its door."""
    output, code = io.StringIO(), 0
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            if case.door == "request":
                code, text = _request(case, folder)
                output.write(text)
            elif case.door in ("map", "run"):
                with warnings.catch_warnings():
                    warnings.simplefilter("always")
                    warnings.showwarning = lambda message, *_args, **_more: output.write(f"warning: {message}\n")
                    code = _by_name(case, folder, listener)
            else:
                code = _by_command(case, folder, listener)
        except InputError as error:
            code = 2
            output.write(f"{error}\n")
        except Announced:
            code = 0
    return code, output.getvalue()


def _by_name(case: Case, folder: Path, listener: Listener) -> int:
    if case.door == "map":
        found = tw.read_map(folder / case.options["map"])
        assert found.z.size
        return 0
    tw.run(tw.Job.load(folder / "job.toml"), progress=listener, out=folder)
    return 0


def _by_command(case: Case, folder: Path, listener: Listener) -> int:
    from turnwright import cli
    from turnwright.cli import cutting as _cutting, materials as _materials

    @contextlib.contextmanager
    def show_progress(_stop: object, _steps: object) -> Any:
        yield listener

    _cutting.show_progress = _materials.show_progress = show_progress
    commands = {
        "check": ["check", str(folder / "job.toml")],
        "backplot": ["backplot", str(folder / case.options.get("program", "")), "--job", str(folder / "job.toml")],
        "material": ["material", "show", str(folder / "material.toml")],
        "fit": ["material", "fit", str(folder / case.options.get("data", "")), "--out", str(folder / "fitted.toml")],
    }
    code = cli.main(commands[case.door])
    return 0 if code == cli.INTERRUPTED_CODE and listener.answered is not None else code


@functools.cache
def _server() -> Any:
    from turnwright.web import create_app

    return create_app(tempfile.mkdtemp(prefix="workbench-"), workers=Inline())  # type: ignore[arg-type]


def _request(case: Case, folder: Path) -> tuple[int, str]:
    """Return an exit code as the command line would, and what a page shows of the answer."""
    body = (folder / "body").read_bytes()
    method, path = case.options["method"], case.options["path"]
    query = urlencode(case.options["query"]).encode()
    size = str(len(body)).encode()
    kind = b"application/octet-stream" if path.startswith("/api/files") else b"application/json"
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method, "scheme": "http",
        "path": path, "raw_path": path.encode(), "root_path": "", "query_string": query,
        "headers": [(b"host", b"127.0.0.1:8765"), (b"content-type", kind), (b"content-length", size)],
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8765),
    }  # fmt: skip
    waiting = [{"type": "http.request", "body": body, "more_body": False}]
    answer: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return waiting.pop() if waiting else {"type": "http.disconnect"}

    async def send(message: dict[str, Any]) -> None:
        answer.append(message)

    async def asked() -> None:
        # Starlette answers a defect, then raises it for the server's log.
        with contextlib.suppress(Exception):
            await _server()(scope, receive, send)
        runs = _server().state.runs
        for run in runs.all():  # a job that was not damaged is cut: not here
            await runs.cancel(run.id)

    asyncio.run(asked())
    status = answer[0]["status"] if answer else 500
    sent = b"".join(one.get("body", b"") for one in answer[1:])
    try:
        report = json.loads(sent, parse_constant=lambda name: f"the number {name} ")
    except (ValueError, RecursionError):
        return (1 if status >= 500 else 0), ""
    report = report if isinstance(report, dict) else {}
    errors = report.get("errors") or []
    lines = [str(report.get("detail", "")), *(str(one["sentence"]) for one in errors if isinstance(one, dict))]
    if status == 500:
        lines.append(f"defect of Turnwright: {(_server().state.folder / 'defects.log').read_text()[-3000:]}")
    return (1 if status == 500 else 2 if status >= 400 or errors else 0), "\n".join(lines)


def faults(case: Case, code: int, text: str) -> list[str]:
    """Return what is wrong with an answer."""
    found = []
    if code not in (0, 2, 3, 4):
        found.append(f"exit code {code}")
    if slip := SLIPS.search(text):
        found.append(f"it lets out {slip[0][:60]!r}")
    lines = [line.removeprefix("turnwright: ").removeprefix("warning: ") for line in text.splitlines()]
    # What a material's file says of itself is shown as it is.
    longest = 0 if case.door == "material" and code == 0 else max(map(len, lines), default=0)
    if longest > LINE:
        found.append(f"a line of {longest} letters")
    if len(lines) > LINES:
        found.append(f"{len(lines)} lines")
    if "out of memory" in text:
        found.append("memory is asked for that is not there")
    given = b" ".join(case.files.values()).lower()
    if (bad := BAD_NUMBER.search(text)) and not (code == 2 and (b"nan" in given or b"inf" in given)):
        found.append(f"it prints {bad[0].strip()}")
    return found


def give(case: Case, folder: Path) -> dict[str, Any]:
    """Give one input to its door and judge the answer."""
    for name, data in case.files.items():
        (folder / name).write_bytes(data)
    gc.collect()
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins again
    listener, escape = Listener(), ""
    try:
        code, text = ask(case, folder, listener)
    except Exception:  # noqa: BLE001 - the judge sees everything
        code, text, escape = 1, "", traceback.format_exc()
    spent = _spent() - listener.start
    answered = spent if listener.answered is None else listener.answered
    peak = _peak() if listener.answered is None else listener.peak
    found = faults(case, code, text)
    if answered > ANSWER_S:
        found.append(f"answered after {answered:.1f} s")
    if peak > PEAK:
        found.append(f"{peak / 1e9:.2f} GB")
    if escape:
        found.append("it escapes as " + escape.strip().splitlines()[-1][:120])
    return {"code": code, "answered": answered, "spent": spent, "peak": peak, "faults": found, "text": text + escape}


# --- many inputs


@functools.cache
def makers() -> dict[str, Callable[[Random], Case]]:
    """Return what makes the cases of each kind; the good programs are written once."""
    maps = inputs.good_maps()
    return {
        "job": inputs.job_case,
        "formula": inputs.formula_case,
        "program": inputs.program_case(_programs()),
        "file": inputs.file_case(maps, inputs.experiment()),
        "upload": inputs.upload_case(maps),
    }


@functools.cache
def _programs() -> dict[str, dict[str, bytes]]:
    """Write a program in each dialect, one of a fast tool, and a table."""
    small = {"simulation": {"whole_part": {"radii": 12, "angles": 8}, "patches": []}, "part": {"radius": "0.3 mm"}}
    slow: dict[str, Any] = {"strategy": {"feed": "30 um/rev", "points_per_rev": 40}}
    fast = {
        "strategy": {"kind": "fast tool servo", "spindle_speed": "60 rpm", **slow["strategy"]},
        "machine": {"name": "nanoform-fts-70"},
        "program": {"fast_tool": "position"},
    }
    wanted: dict[str, dict[str, Any]] = {name: {**slow, "machine": one} for name, one in inputs.MACHINES.items()}
    wanted["fast"] = fast
    written: dict[str, dict[str, bytes]] = {}
    for name, changes in wanted.items():
        data = inputs.merged(json.loads(json.dumps(inputs.SMALL)), small)
        if "machine" in changes:
            data["machine"] = {}
        data = inputs.merged(data, changes)
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            (place / "pmac.toml").write_bytes(inputs.TABLES["pmac.toml"])
            result = tw.run(tw.Job.read(data, folder=folder), out=folder)
            files = {file.name: file.read_bytes() for file in place.iterdir() if file.is_file()}
        written[name] = {**files, "job.toml": tomli_w.dumps(data).encode()}
    c, x, z = (result.motion.axes[letter] for letter in "CXZ")
    rows = "\n".join(f"{one[0] * 57.29577951:.6f},{one[1]:.6f},{one[2]:.9f}" for one in zip(c, x, z, strict=True))
    written["table"] = {"part.csv": f"C_deg,X_mm,Z_mm\n{rows}\n".encode(), "job.toml": written["generic"]["job.toml"]}
    return written


def case_of(number: int, seed: int) -> tuple[str, Case]:
    """Return an input by its number and the seed of all."""
    random = Random(f"{seed}/{number}")  # noqa: S311 - repeatable
    kind = random.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
    return kind, makers()[kind](random)


def warm() -> None:
    """Compile and import what good inputs need, so that no mutated one pays for it."""
    makers()
    cases: list[Case] = []
    for surface in inputs.SURFACES:
        job = inputs.with_surface(surface)
        cases.append(Case("check", {"job.toml": tomli_w.dumps(job).encode(), **inputs.TABLES}))
    for strategy, machine, program in inputs.STRATEGIES:
        for extra in inputs.EXTRAS[: None if strategy is inputs.STRATEGIES[0][0] else 1]:
            job = {**json.loads(json.dumps(inputs.SMALL)), "strategy": strategy, "machine": {"name": machine}}
            job = inputs.merged({**job, "program": program} if program else job, extra)
            files = {"job.toml": tomli_w.dumps(job).encode(), **inputs.TABLES}
            cases += [Case("check", files), Case("run", files)]
    cases += [
        Case("backplot", files, {"program": "part.nc" if "part.nc" in files else "part.csv"})
        for files in _programs().values()
    ]
    for door in ("parse", "check", "write"):
        body = {"toml": tomli_w.dumps(inputs.SMALL), "data": inputs.SMALL}
        cases.append(inputs.request("POST", f"/api/job/{door}", json.dumps(body).encode()))
    cases += [Case("map", {name: data}, {"map": name}) for name, data in inputs.good_maps().items()]
    cases += [Case("fit", inputs.experiment(), {"data": name}) for name in ("averages.csv", "experiment.toml")]
    for case in cases:
        with tempfile.TemporaryDirectory() as folder:
            give(case, Path(folder))


def _work(counter: Any, most: int, seed: int, pipe: Any, kept: Path) -> None:
    """Take numbers from the counter until there are no more."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (pages + ROOM, pages + ROOM))
    parent = os.getppid()
    trace = (kept / f".trace-{os.getpid()}").open("w")
    faulthandler.register(signal.SIGPROF, trace, chain=True)  # the traceback, then the end
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    while True:
        with counter.get_lock():
            number = counter.value
            counter.value += 1
        if number >= most or os.getppid() != parent:
            return
        kind, case = case_of(number, seed)
        pipe.send((number, kind))
        signal.setitimer(signal.ITIMER_PROF, DEADLINE_S)
        signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
        with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
            answer = give(case, Path(folder))
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        pipe.send((number, kind, answer))


def keep(case: Case, answer: dict[str, Any], folder: Path) -> None:
    """Save a failing input with what came of it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, data in case.files.items():
        (folder / name).write_bytes(data)
    (folder / "case.json").write_text(
        json.dumps({"door": case.door, "files": list(case.files), "options": case.options}), encoding="utf-8"
    )
    (folder / "answer.txt").write_text(f"{answer['faults']}\n{answer['text']}", encoding="utf-8", errors="replace")


class Workers:
    """Forked processes that take the inputs one by one, and are started again where one of them dies."""

    def __init__(self, numbers: range, seed: int, kept: Path) -> None:
        self.numbers, self.seed, self.kept = numbers, seed, kept
        self.context = get_context("fork")
        self.counter = self.context.Value("l", numbers.start)
        self.started: dict[Any, tuple[Any, tuple[int, str] | None]] = {}
        self.results: list[tuple[str, dict[str, Any]]] = []
        signal.signal(signal.SIGTERM, self._stop)

    def _stop(self, *_signal: object) -> None:
        """Begin no more inputs."""
        self.counter.value = self.numbers.stop

    def start(self) -> None:
        """Start one more process."""
        ours, theirs = self.context.Pipe(duplex=False)
        arguments = (self.counter, self.numbers.stop, self.seed, theirs, self.kept)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of a fork with threads, which all sleep
            process = self.context.Process(target=_work, args=arguments, daemon=True)
            process.start()
        theirs.close()
        self.started[ours] = (process, None)

    def listen(self) -> None:
        """Take what the processes send until there is none."""
        while self.started:
            for pipe in wait(list(self.started)):
                try:
                    message = pipe.recv()
                except EOFError:
                    message = None
                process, doing = self.started[pipe]
                if message is None:
                    del self.started[pipe]
                    process.join()
                    if doing is not None:
                        self._note(*doing, self._death(process))
                        self.start()
                elif len(message) == 2:
                    self.started[pipe] = (process, message)
                else:
                    self.started[pipe] = (process, None)
                    self._note(*message)

    def _death(self, process: Any) -> dict[str, Any]:
        trace = self.kept / f".trace-{process.pid}"
        text = trace.read_text(encoding="utf-8") if trace.exists() else ""
        late = {-signal.SIGPROF: f"{DEADLINE_S:g} s of a processor", -signal.SIGALRM: f"{PATIENCE_S:g} s"}
        fault = f"its process ends with {process.exitcode}"
        if process.exitcode in late:
            fault = f"no answer after {late[process.exitcode]}"
        return {"code": 1, "answered": DEADLINE_S, "spent": DEADLINE_S, "peak": 0, "faults": [fault], "text": text}

    def _note(self, number: int, kind: str, answer: dict[str, Any]) -> None:
        self.results.append((kind, answer))
        if answer["faults"]:
            place = self.kept / f"{self.seed}-{number}"
            keep(case_of(number, self.seed)[1], answer, place)
            print(f"{kind} {number} (seed {self.seed}): {'; '.join(answer['faults'])}; kept in {place}", flush=True)


def main(
    cases: int = 300,
    seed: int = 1,
    *,
    workers: int = 2,
    kept: Path | None = None,
    first: int = 0,
    work_s: float = WORK_S,
) -> int:
    """Give so many inputs; return how many failed or were not given.

    Parameters
    ----------
    cases
        How many.
    seed
        Of all of them; an input depends on it and on its own number.
    workers
        Processes side by side.
    kept
        Where failing inputs are saved.
    first
        Number of the first input.
    work_s
        Processor time that announced work is given. [s]
    """
    kept = kept or Path(tempfile.gettempdir()) / "turnwright-fuzz"
    kept.mkdir(parents=True, exist_ok=True)
    warm()
    Listener.work_s = work_s
    begun = time.monotonic()
    all_workers = Workers(range(first, first + cases), seed, kept)
    for _ in range(workers):
        all_workers.start()
    all_workers.listen()
    for trace in kept.glob(".trace-*"):
        trace.unlink()
    _table(all_workers.results, time.monotonic() - begun, seed)
    unanswered = cases - len(all_workers.results)
    return unanswered + sum(bool(answer["faults"]) for _, answer in all_workers.results)


def _table(results: list[tuple[str, dict[str, Any]]], took: float, seed: int) -> None:
    print(
        f"{'kind':10}{'inputs':>8}{'refused':>9}{'slowest [s]':>13}{'all [s]':>9}{'peak [GB]':>11}{'longest line':>14}"
        f"{'failed':>8}"
    )
    for kind in (*WEIGHTS, "all"):
        answers = [answer for name, answer in results if kind in (name, "all")]
        refused = sum(answer["code"] == 2 for answer in answers)
        slowest = max((answer["answered"] for answer in answers), default=0.0)
        peak = max((answer["peak"] for answer in answers), default=0) / 1e9
        line = max((len(one) for answer in answers for one in answer["text"].splitlines()), default=0)
        failed = sum(bool(answer["faults"]) for answer in answers)
        spent = sum(answer["spent"] for answer in answers)
        print(f"{kind:10}{len(answers):8}{refused:9}{slowest:13.2f}{spent:9.0f}{peak:11.2f}{line:14}{failed:8}")
    codes = Counter(answer["code"] for _, answer in results)
    print(f"seed {seed}; exit codes {dict(sorted(codes.items()))}; {took:.0f} s")


def again(folder: Path) -> int:
    """Give a kept input once more."""
    stated = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    case = Case(stated["door"], {name: (folder / name).read_bytes() for name in stated["files"]}, stated["options"])
    warm()
    with tempfile.TemporaryDirectory() as place:
        answer = give(case, Path(place))
    print(answer.pop("text"))
    print(answer)
    return len(answer["faults"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--work", type=float, default=WORK_S, help="seconds of announced work")
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--again", type=Path)
    given = parser.parse_args()
    if given.again:
        sys.exit(min(again(given.again), 1))
    failed = main(
        given.inputs, given.seed, workers=given.workers, kept=given.kept, first=given.first, work_s=given.work
    )
    sys.exit(min(failed, 1))
