"""``python -m turnwright.web.worker RUN FOLDER NICE SECONDS BYTES``: carry out one run as the command line would.

Reading a measured file may take so many seconds and bytes.
It tells its progress in a file and ends when whoever started it is gone, which it hears by the end of its input.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
import time
import traceback
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from turnwright._signals import Stop
from turnwright.errors import InputError, TurnwrightError, shortened
from turnwright.progress import OverallProgress, Step
from turnwright.web.references import BUNDLE, CORRECTION, job_in, located, text_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from turnwright.job import Job, Measured
    from turnwright.progress import Overall

__all__ = ["main"]

READ = Step(stage="read the file", work=1.0)
INDEX = Step(stage="index of the program", work=1.0)

HEIGHT_BYTES = 8
"""Of a height in a file, usually."""

EVERY_S = 0.2
GRACE_S = 2.0


class _Teller:
    """Writes the progress of the whole run, not more often than anybody looks."""

    def __init__(self, file: Path, stop: Stop) -> None:
        self.file, self.stop = file, stop
        self.last, self.stage = 0.0, ""
        self.whole = OverallProgress((), self._write)

    def expect(self, steps: Sequence[Step]) -> None:
        """Say what the run will do, before the first of it."""
        self.whole = OverallProgress(steps, self._write)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Say how far a stage is."""
        self.stop.check()
        self.whole(stage, done, total)

    def _write(self, at: Overall) -> None:
        now = time.monotonic()
        if at.stage == self.stage and now - self.last < EVERY_S:
            return
        self.last, self.stage = now, at.stage
        line = {
            "stage": at.stage,
            "step": at.step,
            "steps": at.steps,
            "fraction": round(at.fraction, 4),
            "left_s": round(at.left_s, 1),
        }
        with self.file.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def main() -> int:
    """Carry out a run and say in one line how it ended."""
    run, server = Path(sys.argv[1]), Path(sys.argv[2])
    threading.Thread(target=_end_with_server, daemon=True).start()
    with suppress(AttributeError, OSError):
        os.nice(int(sys.argv[3]))
    state, sentence, missed = "failed", "", False
    with Stop(deaf=True) as stop:  # what it raises must be caught below
        try:
            stop.hear()
            tell = _Teller(run / "progress.jsonl", stop)
            record = json.loads((run / "state.json").read_text(encoding="utf-8"))
            with _new_folder(run) as out:
                sentence, missed = KINDS[record["kind"]](run, server, out, record, tell)
            state = "done"
        except KeyboardInterrupt:
            state, sentence = "cancelled", "it was stopped"
        except TurnwrightError as error:
            sentence = str(error)
        except MemoryError as error:
            sentence = f"the memory is not enough ({error}): take fewer points or a coarser map"
        except OSError as error:
            where = f" ({error.strerror})" if error.strerror else ""
            sentence = f"the disk or the system refuses{where}, nothing was kept: free some space, then try again"
        except Exception as error:  # noqa: BLE001 - this is where everything ends
            traceback.print_exc()
            sentence = f"this is a defect of Turnwright ({type(error).__name__}), the log of the run tells more"
        stop.deaf = True
        _say(state, " ".join(sentence.split()), missed=missed)
    return 0 if state == "done" else 1


def _say(state: str, sentence: str, *, missed: bool = False) -> None:
    with suppress(OSError):
        line = json.dumps({"state": state, "sentence": shortened(sentence), "missed": missed})
        print(line, flush=True)  # noqa: T201 - the server reads it


class Ended(NamedTuple):
    """How a run ended, and whether its part misses a stated tolerance."""

    sentence: str
    missed: bool = False


def _end_with_server() -> None:
    """End this process when the server is gone, however it went."""
    with suppress(OSError, ValueError):
        while os.read(0, 1024):  # not sys.stdin, whose lock this thread would hold at the end
            pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os._exit(1)


@contextmanager
def _new_folder(run: Path) -> Iterator[Path]:
    """Yield a folder that becomes ``out`` when all is well, and vanishes otherwise."""
    out = run / f".out-{os.getpid()}"
    out.mkdir()
    try:
        yield out
        out.rename(run / "out")
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _job(run: Path, server: Path) -> Job:
    from turnwright.web.jobs import require  # noqa: PLC0415 - costly, and who is told to stop shall be heard before

    return require(json.loads((run / "job.json").read_text(encoding="utf-8")), str(server))


def _pack(run: Path, server: Path, out: Path) -> None:
    """Keep the job with the files that it names, if it names any, as the command line takes them."""
    from turnwright.web.bundles import bundle  # noqa: PLC0415

    data = job_in(run, server)
    if located(data, server).references:
        (out / BUNDLE).write_bytes(bundle(data, str(server), text_in(run)))


def _run(run: Path, server: Path, out: Path, _record: dict[str, Any], tell: _Teller) -> Ended:
    """As ``turnwright run``."""
    from turnwright.job import steps_of_run  # noqa: PLC0415

    job = _job(run, server)
    tell.expect((*steps_of_run(job), INDEX))
    ended = _cut(job, out, tell)
    _pack(run, server, out)
    return ended


def _cut(job: Job, out: Path, tell: _Teller) -> Ended:
    from turnwright import job as recipe, report  # noqa: PLC0415
    from turnwright.web.program import index  # noqa: PLC0415

    result = recipe.run(job, progress=tell, out=out)
    tell("report", 0, 1)
    report.archive_run(result, out)
    report.write_report(result, out)
    tell(INDEX.stage, 0, 1)
    index(out, job.machine)
    minutes = sum(one.limits.cycle_time_s for one in result.passes) / 60
    points = sum(one.points for one in result.passes)
    missing = sum(one.kept is False for one in result.verdicts)
    clauses = [f"misses {missing} of {len(result.verdicts)} verdicts on its tolerances"] if missing else []
    clauses.append(f"{points} points, {minutes:.1f} min")
    if result.warnings:
        clauses.append(f"{len(result.warnings)} warnings")
    return Ended(", ".join(clauses), missing > 0)


def _compare(run: Path, server: Path, out: Path, _record: dict[str, Any], tell: _Teller) -> Ended:
    """As ``turnwright compare``."""
    from turnwright import report  # noqa: PLC0415
    from turnwright.job import compare, steps_of_comparison  # noqa: PLC0415

    job = _job(run, server)
    tell.expect(steps_of_comparison(job))
    found = compare(job, progress=tell)
    tell("report", 0, 1)
    report.archive_comparison(found, out)
    report.write_comparison(found, out)
    _pack(run, server, out)
    able = sum(not one.refused for one in found.candidates)
    return Ended(f"{able} of {len(found.candidates)} strategies can cut it")


def _measured(run: Path, server: Path, tell: _Teller, record: dict[str, Any]) -> Measured:
    """Read a measured file under limits, and register it."""
    from turnwright.job import measure, read_measurement  # noqa: PLC0415
    from turnwright.web.jobs import limit_memory  # noqa: PLC0415

    recipe, file = _job(run, server), run / record["file"]
    seconds, most = float(sys.argv[4]), int(sys.argv[5])
    tell.expect((READ, *_steps(recipe, file, record["kind"])))
    tell(READ.stage, 0, 1)
    with _deadline(seconds, f"the file is not read after {seconds:g} s, the limit: it is damaged, or too large"):
        limit_memory(most)
        try:
            heights = read_measurement(recipe, file)
        except InputError as error:
            called = record["called"] or file.name
            raise InputError(str(error).replace(str(file), file.name).replace(file.name, called)) from None
    tell(READ.stage, 1, 1)
    return measure(recipe, replace(heights, name=record["called"] or heights.name), progress=tell)


def _steps(job: Job, file: Path, kind: str) -> tuple[Step, ...]:
    """Return what follows when a measured file of a kind of run is read; a corrected job is much like the job."""
    from turnwright.job import steps_of_correction, steps_of_diagnosis, steps_of_run  # noqa: PLC0415

    heights = [file.stat().st_size / HEIGHT_BYTES]
    if kind == "measure":
        return steps_of_diagnosis(heights)
    *before, report = steps_of_correction(heights)
    return (*before, Step(stage="report of the correction", work=report.work), *steps_of_run(job), INDEX)


@contextmanager
def _deadline(seconds: float, sentence: str) -> Iterator[None]:
    """End the process with a sentence unless the block is done in time: compiled code hears nothing else."""

    def end() -> None:
        _say("failed", sentence)
        os._exit(1)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _diagnose(run: Path, server: Path, out: Path, record: dict[str, Any], tell: _Teller) -> Ended:
    """As ``turnwright diagnose``, and what the page shows of it."""
    from turnwright import report  # noqa: PLC0415
    from turnwright.job import diagnose, missed  # noqa: PLC0415
    from turnwright.web.shown import write_shown  # noqa: PLC0415

    measured = [_measured(run, server, tell, record)]
    found = diagnose(measured, progress=tell)
    tell("report", 0, 1)
    report.archive_measured(measured[0], out)
    report.archive_diagnosis(measured, found, out)
    report.write_diagnosis(measured, found, out)
    write_shown(measured[0], found, out)
    return Ended(found.summary, missed(measured[0].verdicts))


def _correct(run: Path, server: Path, out: Path, record: dict[str, Any], tell: _Teller) -> Ended:
    """As ``turnwright correct``, then as ``turnwright run`` of the job that it wrote."""
    from turnwright import report  # noqa: PLC0415
    from turnwright.job import Job, correct, diagnose, missed  # noqa: PLC0415
    from turnwright.web.shown import write_predicted  # noqa: PLC0415

    measured = [_measured(run, server, tell, record)]
    found = diagnose(measured, progress=tell)
    better_folder = run / CORRECTION
    shutil.rmtree(better_folder, ignore_errors=True)
    better_folder.mkdir()
    better = correct(measured[0].job, found, measured, out=better_folder, progress=tell)
    tell("report of the correction", 0, 1)
    report.archive_correction(measured, found, better, better_folder)
    report.write_correction(measured, found, better, better_folder)
    write_predicted(better, better_folder)
    _cut(Job.load(better.file), out, tell)
    _pack(run, server, out)
    pv, rms = better.numbers_nm["simulated" if better.predicted is None else "predicted"]
    return Ended(f"predicted after the correction: PV {pv:.4g} nm, rms {rms:.4g} nm", missed(better.verdicts))


KINDS: dict[str, Callable[[Path, Path, Path, dict[str, Any], _Teller], Ended]] = {
    "run": _run,
    "compare": _compare,
    "measure": _diagnose,
    "correct": _correct,
}

if __name__ == "__main__":
    sys.exit(main())
