"""The command of tolerances: how likely a part keeps them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import MISSED, Door, Folder, Force, JobFile, app, new_folder, progress_of
from turnwright.cli.studies import Cluster, KeptAt, Workers, kept_cases, over
from turnwright.progress import Step

if TYPE_CHECKING:
    from turnwright.studies import ToleranceStudy

__all__: list[str] = []

PLAN_S, CASE_S, SENSITIVITY_S, REPORT_S = 10.0, 0.5, 3.0, 5.0
"""Time that a plan, a case and the rest take, usually. [s]"""


@app.command()
def tolerance(
    context: typer.Context,
    job: JobFile,
    out: Folder,
    budget: Annotated[
        Path | None,
        typer.Option(metavar="BUDGET.toml", help="What cannot be set exactly; a typical lathe if not given."),
    ] = None,
    cases: Annotated[int, typer.Option(min=10, help="How many parts to draw.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Makes the same draws again.")] = 0,
    correction: Annotated[
        bool, typer.Option(help="Cut, measure and diagnose artefacts too, and cut the part as they tell.")
    ] = True,
    confirm: Annotated[
        bool, typer.Option("--confirm", help="Draw as many parts again with half the spread of what to tighten first.")
    ] = False,
    workers: Workers = None,
    cluster: Cluster = None,
    store: KeptAt = None,
    force: Force = False,
) -> None:
    """Say how likely a part keeps its tolerances, with and without artefacts, and what to set up better first."""
    door: Door = context.obj
    from turnwright.job import Job  # noqa: PLC0415 - costly
    from turnwright.studies import ErrorBudget, tolerance as carry_out  # noqa: PLC0415 - costly

    recipe = Job.load(job)
    errors = ErrorBudget.typical() if budget is None else ErrorBudget.load(budget)
    with (
        new_folder(out, door, force=force) as folder,
        kept_cases(out, store, door) as kept,
        progress_of(door.stop, _steps(cases, confirm=confirm)) as progress,
        over(cluster) as executor,
    ):
        found = carry_out(
            recipe, budget=errors, count=cases, seed=seed, correction=correction, confirm=confirm, executor=executor,
            workers=workers, store=kept, progress=progress,
        )  # fmt: skip
        progress("report", 0, 1)
        from turnwright.report import write_tolerance  # noqa: PLC0415 - matplotlib, only for a study that came so far

        found.to_csv(folder / "cases.csv")
        write_tolerance(found, folder)
        progress("report", 1, 1)
    _say(door, found)
    door.say(f"table: {out / 'cases.csv'}")
    door.say(f"report: {out / 'report.html'}")
    *_, last = found.outcomes.values()
    if last.probability.value < 1:
        door.say("done and written, but not all parts keep all tolerances")
        raise typer.Exit(MISSED)


def _steps(cases: int, *, confirm: bool) -> list[Step]:
    """Return what a study of tolerances does."""
    stages = {"plan": PLAN_S, "cases": CASE_S * cases, "sensitivity": SENSITIVITY_S}
    if confirm:
        stages["confirm"] = CASE_S * cases
    return [Step(stage=stage, work=work) for stage, work in (stages | {"report": REPORT_S}).items()]


def _say(door: Door, found: ToleranceStudy) -> None:
    for kind, one in found.outcomes.items():
        p = one.probability
        pv = found.percentiles("form_pv_nm" if kind == "as planned" else "corrected form_pv_nm")
        door.say(
            f"{kind}: {p.value:.1%} of {found.count} parts keep all tolerances ({p.low:.1%} to {p.high:.1%}); "
            f"form error PV {pv[0.5].value:.3g} nm (half of the parts), {pv[0.95].value:.3g} nm (95 of 100)"
        )
        door.say(f"{kind}: {one.advice}")
    if found.tightening is not None:
        t = found.tightening
        p = t.probability
        door.say(f"confirmed: {p.value:.1%} ({p.low:.1%} to {p.high:.1%}) with half the spread of {t.group}")
    if found.reasons:
        door.say(f"{len(found.reasons)} cases count as parts out of tolerance, for instance: {found.reasons[0]}")
