"""Command for tolerance studies: the probability that a part meets its tolerances."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import MISSED_CODE, Folder, Force, JobFile, Session, app, new_folder, show_progress
from turnwright.cli.studies import CaseStore, Cluster, Workers, connect_cluster, open_case_store
from turnwright.progress import Step

if TYPE_CHECKING:
    from turnwright.studies import ToleranceStudy

__all__: list[str] = []

PLAN_S, CASE_S, SENSITIVITY_S, REPORT_S = 10.0, 0.5, 3.0, 5.0
"""Typical times of the stages, for the progress estimate. [s]"""


@app.command()
def tolerance(
    context: typer.Context,
    job: JobFile,
    out: Folder,
    budget: Annotated[
        Path | None,
        typer.Option(metavar="BUDGET.toml", help="Spread of each set-up error; by default a typical lathe."),
    ] = None,
    cases: Annotated[int, typer.Option(min=10, help="Number of random parts.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random parts.")] = 0,
    correction: Annotated[
        bool, typer.Option(help="Also correct each part by test parts that are cut and measured first.")
    ] = True,
    confirm: Annotated[
        bool, typer.Option("--confirm", help="Repeat the study with half the spread of the most important error.")
    ] = False,
    workers: Workers = None,
    cluster: Cluster = None,
    store: CaseStore = None,
    force: Force = False,
) -> None:
    """Estimate yield against tolerances by Monte Carlo simulation."""
    session: Session = context.obj
    from turnwright.job import Job  # noqa: PLC0415 - costly
    from turnwright.studies import ErrorBudget, tolerance as run_study  # noqa: PLC0415 - costly

    recipe = Job.load(job)
    errors = ErrorBudget.typical() if budget is None else ErrorBudget.load(budget)
    with (
        new_folder(out, session, force=force) as folder,
        open_case_store(out, store, session) as case_store,
        show_progress(session.stop, _steps(cases, confirm=confirm)) as progress,
        connect_cluster(cluster) as executor,
    ):
        result = run_study(
            recipe, budget=errors, count=cases, seed=seed, correction=correction, confirm=confirm, executor=executor,
            workers=workers, store=case_store, progress=progress,
        )  # fmt: skip
        progress("report", 0, 1)
        from turnwright.report import write_tolerance  # noqa: PLC0415 - imports matplotlib, needed only after success

        result.to_csv(folder / "cases.csv")
        write_tolerance(result, folder)
        progress("report", 1, 1)
    _print_result(session, result)
    session.echo(f"table: {out / 'cases.csv'}")
    session.echo(f"report: {out / 'report.html'}")
    *_, last = result.outcomes.values()
    if last.probability.value < 1:
        session.echo("results are written, but some parts miss a tolerance")
        raise typer.Exit(MISSED_CODE)


def _steps(cases: int, *, confirm: bool) -> list[Step]:
    """Return the stages of a tolerance study."""
    stages = {"plan": PLAN_S, "cases": CASE_S * cases, "sensitivity": SENSITIVITY_S}
    if confirm:
        stages["confirm"] = CASE_S * cases
    return [Step(stage=stage, work=work) for stage, work in (stages | {"report": REPORT_S}).items()]


def _print_result(session: Session, result: ToleranceStudy) -> None:
    for kind, outcome in result.outcomes.items():
        p = outcome.probability
        pv = result.percentiles("form_pv_nm" if kind == "as planned" else "corrected form_pv_nm")
        session.echo(
            f"{kind}: {p.value:.1%} of {result.count} parts meet all tolerances ({p.low:.1%} to {p.high:.1%}); "
            f"form error PV {pv[0.5].value:.3g} nm (median), {pv[0.95].value:.3g} nm (95th percentile)"
        )
        session.echo(f"{kind}: {outcome.advice}")
    if result.tightening is not None:
        t = result.tightening
        p = t.probability
        session.echo(f"confirmed: {p.value:.1%} ({p.low:.1%} to {p.high:.1%}) with half the spread of {t.group}")
    for remark in result.remarks:
        session.echo(remark)
    if result.reasons:
        session.echo(
            f"{len(result.reasons)} failed cases count as parts out of tolerance, the first one: {result.reasons[0]}"
        )
