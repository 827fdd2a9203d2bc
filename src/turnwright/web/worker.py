"""``python -m turnwright.web.worker RUN FOLDER NICE SECONDS BYTES``: carry out one run, like the command line.

SECONDS and BYTES limit the reading of a measured file. The process writes its progress to a file and ends when its
standard input is closed, that is, when the server has ended.
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
from turnwright.errors import InputError, TurnwrightError, shorten_message
from turnwright.progress import OverallProgress, Step
from turnwright.web.references import BUNDLE, CORRECTION, job_in, located, text_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from turnwright.job import Job, Measured
    from turnwright.progress import Overall

__all__ = ["main"]

READ_STEP = Step(stage="read the file", work=1.0)
INDEX_STEP = Step(stage="index of the program", work=1.0)

TYPICAL_HEIGHT_BYTES = 8
"""File size per measured height, for the progress estimate."""

PROGRESS_INTERVAL_S = 0.2
GRACE_S = 2.0


class _ProgressWriter:
    """Appends the progress of the whole run to a file, at most every `PROGRESS_INTERVAL_S`."""

    def __init__(self, file: Path, stop: Stop) -> None:
        self.file, self.stop = file, stop
        self.last, self.stage = 0.0, ""
        self.overall = OverallProgress((), self._write)

    def expect(self, steps: Sequence[Step]) -> None:
        """Set the stages of the run, before the first of them."""
        self.overall = OverallProgress(steps, self._write)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report the progress of a stage."""
        self.stop.check()
        self.overall(stage, done, total)

    def _write(self, at: Overall) -> None:
        now = time.monotonic()
        if at.stage == self.stage and now - self.last < PROGRESS_INTERVAL_S:
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
    """Carry out a run and print its outcome as one line of JSON."""
    run, server = Path(sys.argv[1]), Path(sys.argv[2])
    threading.Thread(target=_end_with_server, daemon=True).start()
    with suppress(AttributeError, OSError):
        os.nice(int(sys.argv[3]))
    state, sentence, missed = "failed", "", False
    with Stop(records_only=True) as stop:  # what it raises must be caught below
        try:
            stop.arm()
            progress = _ProgressWriter(run / "progress.jsonl", stop)
            record = json.loads((run / "state.json").read_text(encoding="utf-8"))
            with _new_folder(run) as out:
                sentence, missed = RUNNERS[record["kind"]](run, server, out, record, progress)
            state = "done"
        except KeyboardInterrupt:
            state, sentence = "cancelled", "stopped"
        except TurnwrightError as error:
            sentence = str(error)
        except MemoryError as error:
            sentence = f"out of memory ({error}): use fewer points or a coarser map"
        except OSError as error:
            where = f" ({error.strerror})" if error.strerror else ""
            sentence = f"disk or system error{where}, no results were written: free some space and try again"
        except Exception as error:  # noqa: BLE001 - the outermost handler
            traceback.print_exc()
            sentence = f"this is a defect of Turnwright ({type(error).__name__}), see the log of the run"
        stop.records_only = True
        _print_outcome(state, " ".join(sentence.split()), missed=missed)
    return 0 if state == "done" else 1


def _print_outcome(state: str, sentence: str, *, missed: bool = False) -> None:
    with suppress(OSError):
        line = json.dumps({"state": state, "sentence": shorten_message(sentence), "missed": missed})
        print(line, flush=True)  # noqa: T201 - the server reads it


class Ended(NamedTuple):
    """Outcome of a run, and whether the part misses a stated tolerance."""

    sentence: str
    missed: bool = False


def _end_with_server() -> None:
    """End this process when the server has ended, even by a crash."""
    with suppress(OSError, ValueError):
        while os.read(0, 1024):  # not sys.stdin: this thread would hold its lock at exit
            pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os._exit(1)


@contextmanager
def _new_folder(run: Path) -> Iterator[Path]:
    """Yield a temporary folder; it is renamed to ``out`` on success and removed otherwise."""
    out = run / f".out-{os.getpid()}"
    out.mkdir()
    try:
        yield out
        out.rename(run / "out")
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _job(run: Path, server: Path) -> Job:
    from turnwright.web.jobs import require  # noqa: PLC0415 - slow import, after signals are handled

    return require(json.loads((run / "job.json").read_text(encoding="utf-8")), str(server))


def _pack(run: Path, server: Path, out: Path) -> None:
    """If the job names files, write it with them as an archive for the command line."""
    from turnwright.web.bundles import bundle  # noqa: PLC0415

    data = job_in(run, server)
    if located(data, server).references:
        (out / BUNDLE).write_bytes(bundle(data, str(server), text_in(run)))


def _run(run: Path, server: Path, out: Path, _record: dict[str, Any], progress: _ProgressWriter) -> Ended:
    """Run ``turnwright run``."""
    from turnwright.job import steps_of_run  # noqa: PLC0415

    job = _job(run, server)
    progress.expect((*steps_of_run(job), INDEX_STEP))
    ended = _cut(job, out, progress)
    _pack(run, server, out)
    return ended


def _cut(job: Job, out: Path, progress: _ProgressWriter) -> Ended:
    from turnwright import job as recipe, report  # noqa: PLC0415
    from turnwright.web.program import index  # noqa: PLC0415

    result = recipe.run(job, progress=progress, out=out)
    progress("report", 0, 1)
    report.archive_run(result, out)
    report.write_report(result, out)
    report.write_certificate(result, out)
    progress(INDEX_STEP.stage, 0, 1)
    index(out, job.machine)
    minutes = sum(one.limits.cycle_time_s for one in result.passes) / 60
    points = sum(one.points for one in result.passes)
    missing = sum(one.is_kept is False for one in result.verdicts)
    clauses = [f"misses {missing} of {len(result.verdicts)} tolerances"] if missing else []
    clauses.append(f"{points} points, {minutes:.1f} min")
    if result.warnings:
        clauses.append(f"{len(result.warnings)} warnings")
    return Ended(", ".join(clauses), missing > 0)


def _compare(run: Path, server: Path, out: Path, _record: dict[str, Any], progress: _ProgressWriter) -> Ended:
    """Run ``turnwright compare``."""
    from turnwright import report  # noqa: PLC0415
    from turnwright.job import compare, steps_of_comparison  # noqa: PLC0415

    job = _job(run, server)
    progress.expect(steps_of_comparison(job))
    comparison = compare(job, progress=progress)
    progress("report", 0, 1)
    report.archive_comparison(comparison, out)
    report.write_comparison(comparison, out)
    _pack(run, server, out)
    able = sum(not one.refused for one in comparison.candidates)
    return Ended(f"{able} of {len(comparison.candidates)} strategies can cut the part")


def _measured(run: Path, server: Path, progress: _ProgressWriter, record: dict[str, Any]) -> Measured:
    """Read a measured file within the limits, and register it."""
    from turnwright.job import measure, read_measurement  # noqa: PLC0415
    from turnwright.web.jobs import limit_memory  # noqa: PLC0415

    recipe, file = _job(run, server), run / record["file"]
    seconds, max_bytes = float(sys.argv[4]), int(sys.argv[5])
    progress.expect((READ_STEP, *_steps(recipe, file, record["kind"])))
    progress(READ_STEP.stage, 0, 1)
    with _deadline(seconds, f"reading the file took more than {seconds:g} s, the limit: it is damaged or too large"):
        limit_memory(max_bytes)
        try:
            heights = read_measurement(recipe, file)
        except InputError as error:
            called = record["called"] or file.name
            raise InputError(str(error).replace(str(file), file.name).replace(file.name, called)) from None
    progress(READ_STEP.stage, 1, 1)
    return measure(recipe, replace(heights, name=record["called"] or heights.name), progress=progress)


def _steps(job: Job, file: Path, kind: str) -> tuple[Step, ...]:
    """Return the stages after reading a measured file; those of the corrected job are estimated by the job."""
    from turnwright.job import steps_of_correction, steps_of_diagnosis, steps_of_run  # noqa: PLC0415

    heights = [file.stat().st_size / TYPICAL_HEIGHT_BYTES]
    if kind == "measure":
        return steps_of_diagnosis(heights)
    *before, report = steps_of_correction(heights)
    return (*before, Step(stage="report of the correction", work=report.work), *steps_of_run(job), INDEX_STEP)


@contextmanager
def _deadline(seconds: float, sentence: str) -> Iterator[None]:
    """End the process with a message unless the block ends in time; compiled code cannot be interrupted otherwise."""

    def end() -> None:
        _print_outcome("failed", sentence)
        os._exit(1)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _diagnose(run: Path, server: Path, out: Path, record: dict[str, Any], progress: _ProgressWriter) -> Ended:
    """Run ``turnwright diagnose`` and write the data of the page."""
    from turnwright import report  # noqa: PLC0415
    from turnwright.job import any_missed, diagnose  # noqa: PLC0415
    from turnwright.web.measurement_data import write_page_data  # noqa: PLC0415

    measured = [_measured(run, server, progress, record)]
    diagnosis = diagnose(measured, progress=progress)
    progress("report", 0, 1)
    report.archive_measured(measured[0], out)
    report.archive_diagnosis(measured, diagnosis, out)
    report.write_diagnosis(measured, diagnosis, out)
    report.write_certificate(measured[0], out)
    write_page_data(measured[0], diagnosis, out)
    return Ended(diagnosis.summary, any_missed(measured[0].verdicts))


def _correct(run: Path, server: Path, out: Path, record: dict[str, Any], progress: _ProgressWriter) -> Ended:
    """Run ``turnwright correct``, then ``turnwright run`` of the corrected job."""
    from turnwright import report  # noqa: PLC0415
    from turnwright.job import Job, any_missed, correct, diagnose  # noqa: PLC0415
    from turnwright.web.measurement_data import write_predicted  # noqa: PLC0415

    measured = [_measured(run, server, progress, record)]
    diagnosis = diagnose(measured, progress=progress)
    correction_folder = run / CORRECTION
    shutil.rmtree(correction_folder, ignore_errors=True)
    correction_folder.mkdir()
    correction = correct(measured[0].job, diagnosis, measured, out=correction_folder, progress=progress)
    progress("report of the correction", 0, 1)
    report.archive_correction(measured, diagnosis, correction, correction_folder)
    report.write_correction(measured, diagnosis, correction, correction_folder)
    write_predicted(correction, correction_folder)
    _cut(Job.load(correction.file), out, progress)
    _pack(run, server, out)
    pv, rms = correction.numbers_nm["simulated" if correction.predicted is None else "predicted"]
    return Ended(f"predicted after correction: PV {pv:.4g} nm, rms {rms:.4g} nm", any_missed(correction.verdicts))


RUNNERS: dict[str, Callable[[Path, Path, Path, dict[str, Any], _ProgressWriter], Ended]] = {
    "run": _run,
    "compare": _compare,
    "measure": _diagnose,
    "correct": _correct,
}

if __name__ == "__main__":
    sys.exit(main())
