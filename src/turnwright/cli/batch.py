"""Several jobs at once: each in a process and a folder of its own."""

from __future__ import annotations

import json
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from turnwright._io import write_whole
from turnwright._signals import Stop
from turnwright.cli.shared import MISSED, Door, new_folder, progress_of
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from turnwright.job import Job, Result
    from turnwright.progress import StageProgress
    from turnwright.studies import Store

__all__ = ["run_batch", "run_into"]

DEFECT = "(a defect, please report it)"
"""How the reason of a job ends that met a defect, see `turnwright.studies.conduct`."""

JOB_S = 30.0
"""That a job of a batch takes, usually. [s]"""

DONE = "case.json"
"""Says which job, and which program, a folder of a batch was made by, and in one line with what outcome."""


def run_into(folder: Path, job: Job, progress: StageProgress) -> Result:
    """Run a job and leave all that it promises in a folder."""
    from turnwright import job as recipe  # noqa: PLC0415 - costly

    result = recipe.run(job, progress=progress, out=folder)
    progress("report", 0, 1)
    from turnwright import report  # noqa: PLC0415 - matplotlib, only for a run that came so far

    report.archive_run(result, folder)
    report.write_report(result, folder)
    progress("report", 1, 1)
    return result


def run_batch(jobs: Sequence[Path], out: Path, door: Door, *, force: bool, workers: int | None) -> None:
    """Run jobs side by side and say how each ended.

    Raises
    ------
    InputError
        If two jobs would be put into the same folder.
    typer.Exit
        With the gravest code of a job: of a defect, then of bad input, then of a missed tolerance.
    """
    from turnwright.studies import Case, conduct, fitting, local, share_of  # noqa: PLC0415 - only for several jobs

    named = Counter(job.stem for job in jobs)
    twice = next((name for name, count in named.items() if count > 1), None)
    if twice is not None:
        raise InputError(
            f"{named[twice]} jobs are named {twice!r}, and so would be their folders: give them other names"
        )
    cases = [Case(key=job.stem, data={"name": job.stem, "job": str(job)}) for job in jobs]
    shared = {"out": str(out.absolute()), "force": force}
    made = [folder for folder in (out.absolute(), *out.absolute().parents) if not folder.exists()]
    side_by_side = min(fitting() if workers is None else workers, len(jobs))
    steps = [Step(stage="jobs", work=JOB_S * len(jobs) / max(side_by_side, 1))]  # the pool refuses less
    out.mkdir(parents=True, exist_ok=True)
    door.partly = f"what is finished stays in {out}: give the same command to go on"
    try:
        with progress_of(door.stop, steps) as progress, local(side_by_side, threads=share_of(side_by_side)) as pool:
            rows = conduct(
                _run_case, cases, shared=shared, executor=pool,
                progress=lambda done, total: progress("jobs", done, total),
            )  # fmt: skip
    finally:
        for folder in made:
            with suppress(OSError):  # something stays in it
                folder.rmdir()
    width = max(map(len, named))
    for case, row in zip(cases, rows, strict=True):
        outcome = f"failed: {'; '.join(row['reason'].splitlines())}" if "reason" in row else row["outcome"]
        door.say(f"{case.key:<{width}}  {outcome} (exit code {_code(row)})")
    failed = sum("reason" in row for row in rows)
    door.say(f"{len(rows) - failed} of {len(rows)} jobs are done, their reports in {out}/JOB/report.html")
    code = next((one for one in (1, 2, MISSED) if one in map(_code, rows)), 0)
    if code:
        raise typer.Exit(code)


def _code(row: Mapping[str, Any]) -> int:
    """Return the exit code that a job alone would end with."""
    if "reason" in row:
        return 1 if row["reason"].endswith(DEFECT) else 2
    return MISSED if row["missed"] else 0


def _run_case(data: Mapping[str, Any], shared: Mapping[str, Any], _store: Store | None) -> dict[str, Any]:
    """Run one job of a batch, unless its folder is there and made by the same job and program."""
    from turnwright.job import Job  # noqa: PLC0415 - costly
    from turnwright.studies import case_key  # noqa: PLC0415

    job = Job.load(data["job"])
    key = case_key({"job": job.table(whole=True)})
    out = Path(shared["out"]) / data["name"]
    with suppress(OSError, ValueError, KeyError, TypeError):  # TypeError: JSON, but of something else
        done = json.loads((out / DONE).read_text(encoding="utf-8"))
        if done["key"] == key:
            return {"outcome": f"as before: {done['outcome']}", "missed": done["missed"]}
    with Stop() as stop, new_folder(out, Door(stop), force=shared["force"]) as folder:
        result = run_into(folder, job, lambda *_: stop.check())
        done = {"outcome": _outcome(result), "missed": sum(one.kept is False for one in result.verdicts)}
        write_whole(folder / DONE, json.dumps({"key": key, **done}) + "\n")
    return done


def _outcome(result: Result) -> str:
    minutes = sum(cut.limits.cycle_time_s for cut in result.passes) / 60
    said = [f"{minutes:.1f} min", f"{sum(cut.points for cut in result.passes)} points"]
    said += [f"{one.name} Sq {one.roughness.sq_nm:.3g} nm" for one in result.predictions]
    said += [f"missed: {one.sentence}" for one in result.verdicts if one.kept is False]
    if result.warnings:
        said.append(f"warnings in its report: {len(result.warnings)}")
    return ", ".join(said)
