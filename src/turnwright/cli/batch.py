"""Batch of jobs: each runs in its own process and writes its own folder."""

from __future__ import annotations

import json
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from turnwright._io import write_atomic
from turnwright._signals import Stop
from turnwright.cli.shared import MISSED_CODE, Session, new_folder, show_progress
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from turnwright.job import Job, Result
    from turnwright.progress import StageProgress
    from turnwright.studies import Store

__all__ = ["run_batch", "run_into"]

DEFECT_SUFFIX = "(a defect, please report it)"
"""Ending of the reason of a job that failed by a defect, see `turnwright.studies.run_cases`."""

TYPICAL_JOB_S = 30.0

CASE_FILE = "case.json"
"""File in the folder of a job: the key of its job and program version, and the outcome in one line."""


def run_into(folder: Path, job: Job, progress: StageProgress) -> Result:
    """Run a job and write all its results to a folder."""
    from turnwright import job as recipe, report  # noqa: PLC0415 - costly

    result = recipe.run(job, progress=progress, out=folder, ready=report.draw_ahead(job))
    progress("report", 0, 1)
    page = report.compose_report(result, folder)
    report.archive_run(result, folder)
    report.write_page(page, folder)
    report.write_certificate(result, folder)
    progress("report", 1, 1)
    return result


def run_batch(jobs: Sequence[Path], out: Path, session: Session, *, force: bool, workers: int | None) -> None:
    """Run jobs in parallel and print the outcome of each.

    Raises
    ------
    InputError
        If two jobs have the same name, so that their folders would coincide.
    typer.Exit
        With the most severe code of all jobs: a defect, then bad input, then a missed tolerance.
    """
    from turnwright.studies import Case, count_threads, count_workers, local, run_cases  # noqa: PLC0415 - only for several jobs

    names = Counter(job.stem for job in jobs)
    duplicate = next((name for name, count in names.items() if count > 1), None)
    if duplicate is not None:
        raise InputError(f"{names[duplicate]} jobs are named {duplicate!r}: rename them, each needs its own folder")
    cases = [Case(key=job.stem, data={"name": job.stem, "job": str(job)}) for job in jobs]
    shared = {"out": str(out.absolute()), "force": force}
    new_folders = [folder for folder in (out.absolute(), *out.absolute().parents) if not folder.exists()]
    parallel = min(count_workers() if workers is None else workers, len(jobs))
    steps = [Step(stage="jobs", work=TYPICAL_JOB_S * len(jobs) / max(parallel, 1))]  # the pool refuses less
    out.mkdir(parents=True, exist_ok=True)
    session.partial = f"finished jobs are in {out}: repeat the command to continue"
    try:
        with show_progress(session.stop, steps) as progress, local(parallel, threads=count_threads(parallel)) as pool:
            rows = run_cases(
                _run_case, cases, shared=shared, executor=pool,
                progress=lambda done, total: progress("jobs", done, total),
            )  # fmt: skip
    finally:
        for folder in new_folders:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
    width = max(map(len, names))
    for case, row in zip(cases, rows, strict=True):
        outcome = f"failed: {'; '.join(row['reason'].splitlines())}" if "reason" in row else row["outcome"]
        session.echo(f"{case.key:<{width}}  {outcome} (exit code {_exit_code(row)})")
    failed = sum("reason" in row for row in rows)
    session.echo(f"{len(rows) - failed} of {len(rows)} jobs are done, their reports are in {out}/JOB/report.html")
    code = next((code for code in (1, 2, MISSED_CODE) if code in map(_exit_code, rows)), 0)
    if code:
        raise typer.Exit(code)


def _exit_code(row: Mapping[str, Any]) -> int:
    """Return the exit code that the job would have as a single run."""
    if "reason" in row:
        return 1 if row["reason"].endswith(DEFECT_SUFFIX) else 2
    return MISSED_CODE if row["missed"] else 0


def _run_case(data: Mapping[str, Any], shared: Mapping[str, Any], _store: Store | None) -> dict[str, Any]:
    """Run one job of a batch, unless its folder already holds the results of the same job and version."""
    from turnwright.job import Job  # noqa: PLC0415 - costly
    from turnwright.studies import case_key  # noqa: PLC0415

    job = Job.load(data["job"])
    key = case_key({"job": job.table(whole=True)})
    out = Path(shared["out"]) / data["name"]
    with suppress(OSError, ValueError, KeyError, TypeError):  # TypeError: valid JSON of another structure
        done = json.loads((out / CASE_FILE).read_text(encoding="utf-8"))
        if done["key"] == key:
            return {"outcome": f"already done: {done['outcome']}", "missed": done["missed"]}
    with Stop() as stop, new_folder(out, Session(stop), force=shared["force"]) as folder:
        result = run_into(folder, job, lambda *_: stop.check())
        done = {"outcome": _outcome(result), "missed": sum(verdict.is_kept is False for verdict in result.verdicts)}
        write_atomic(folder / CASE_FILE, json.dumps({"key": key, **done}) + "\n")
    return done


def _outcome(result: Result) -> str:
    minutes = sum(cut.limits.cycle_time_s for cut in result.passes) / 60
    clauses = [f"{minutes:.1f} min", f"{sum(cut.points for cut in result.passes)} points"]
    clauses += [f"{prediction.name} Sq {prediction.roughness.sq_nm:.3g} nm" for prediction in result.predictions]
    clauses += [f"missed: {verdict.sentence}" for verdict in result.verdicts if verdict.is_kept is False]
    if result.warnings:
        clauses.append(f"warnings in its report: {len(result.warnings)}")
    return ", ".join(clauses)
