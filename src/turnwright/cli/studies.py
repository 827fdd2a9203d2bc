"""Command for parameter studies, and the options that all studies share."""

from __future__ import annotations

import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import Folder, Force, JobFile, Session, app, new_folder, parse_option, show_progress
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Executor

    from turnwright.studies import Column, Study

__all__ = ["CaseStore", "Cluster", "Workers", "connect_cluster", "open_case_store"]

STEPS = (Step(stage="cases", work=100.0), Step(stage="report", work=3.0))

Workers = Annotated[
    int | None,
    typer.Option(min=1, help="Number of processes; by default one per core."),
]
Cluster = Annotated[str | None, typer.Option(metavar="URL", help='Running Dask scheduler, such as "tcp://head:8786".')]
CaseStore = Annotated[
    str | None,
    typer.Option(
        "--store",
        metavar="URL",
        help="Folder or fsspec URL where finished cases are kept for reuse; by default a temporary folder.",
    ),
]


@app.command()
def study(
    context: typer.Context,
    job: JobFile,
    out: Folder,
    measure: Annotated[
        list[str],
        typer.Option(
            metavar="NAME", help='Quantity to tabulate: "sq_nm", "minutes", "peak_acceleration@X" ...; repeatable.'
        ),
    ],
    vary: Annotated[
        list[str],
        typer.Option(
            metavar="FIELD=VALUES",
            help='Job field and its values: "tool.nose_radius=0.1..1 mm:10", "strategy.feed=2, 4, 8 um/rev", '
            '"actual.tool.offset[1]=normal(0, 2) um"; repeatable.',
        ),
    ],
    design: Annotated[
        str, typer.Option(help='"grid", or with --cases "random", "sobol", "halton", "latin hypercube".')
    ] = "grid",
    cases: Annotated[int | None, typer.Option(min=1, help="Number of random cases.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random cases.")] = 0,
    workers: Workers = None,
    cluster: Cluster = None,
    store: CaseStore = None,
    force: Force = False,
) -> None:
    """Vary job fields and tabulate the results."""
    session: Session = context.obj
    from turnwright.job import Job  # noqa: PLC0415 - costly
    from turnwright.studies import study as run_study  # noqa: PLC0415

    recipe, varied = Job.load(job), _parse_fields(vary)
    with (
        new_folder(out, session, force=force) as folder,
        open_case_store(out, store, session) as case_store,
        show_progress(session.stop, STEPS) as progress,
        connect_cluster(cluster) as executor,
    ):
        result = run_study(
            recipe, vary=varied, measure=measure, design=design, count=cases, seed=seed, executor=executor,
            store=case_store, workers=workers, progress=lambda done, total: progress("cases", done, total),
        )  # fmt: skip
        progress("report", 0, 1)
        from turnwright.report import write_study  # noqa: PLC0415 - imports matplotlib, needed only after success

        result.save(folder)
        with suppress(InputError):  # Parquet needs an optional dependency
            result.to_parquet(folder / "study.parquet")
        write_study(result, folder)
        progress("report", 1, 1)
    _print_result(session, result)
    session.echo(f"table: {out / 'study.csv'}")
    session.echo(f"report: {out / 'report.html'}")
    if not result.ok.any():
        raise InputError(f"all {len(result)} cases failed, the first one: {result.reasons[0]}")


def _parse_fields(options: list[str]) -> dict[str, str]:
    """Parse the ``FIELD=VALUES`` options."""
    fields: dict[str, str] = {}
    for option in options:
        name, values = parse_option("--vary", option, "FIELD=VALUES", "tool.nose_radius=0.1..1 mm:10")
        if name in fields:
            raise InputError(f"--vary must name a field once, got {name} twice")
        fields[name] = values
    return fields


@contextmanager
def connect_cluster(address: str | None) -> Iterator[Executor | None]:
    """Yield the executor of a Dask cluster; ``None`` for local processes."""
    if address is None:
        yield None
        return
    from turnwright.studies import cluster  # noqa: PLC0415

    with cluster(address) as executor:
        yield executor


@contextmanager
def open_case_store(out: Path, store: str | None, session: Session) -> Iterator[str]:
    """Yield the place of finished cases: ``store``, or a folder next to ``out`` that is removed on success."""
    place = store or str(out.absolute().with_name(f"{out.absolute().name}.cases"))
    session.partial = f"finished cases are in {place}: repeat the command to continue"
    yield place
    if store is None:
        for part in ("rows", "arrays"):
            shutil.rmtree(Path(place) / part, ignore_errors=True)
        with suppress(OSError):  # it is not empty
            Path(place).rmdir()


def _print_result(session: Session, result: Study) -> None:
    session.echo(f"{len(result)} cases, {int((~result.ok).sum())} failed")
    for measure in result.measures:
        session.echo(_describe_range(result, measure))
    reasons = list(dict.fromkeys(filter(None, result.reasons)))
    if reasons and result.ok.any():
        session.echo(f"first failure: {reasons[0]}")


def _describe_range(result: Study, measure: Column) -> str:
    """Describe the range of a measure and the case of its minimum."""
    values = measure.values
    if values.dtype.kind not in "fi":
        return f"{measure.heading}: {', '.join(sorted(set(values.tolist()) - {''}))}"
    best = result.best(measure.name, 1)
    if not best:
        return f"{measure.heading}: no case gives a number"
    finite = values[result.ok & (measure.values == measure.values)]
    case = ", ".join(f"{field.name} = {_format(field.values[best[0]])} {field.unit}".strip() for field in result.fields)
    return f"{measure.heading}: {_format(finite.min())} to {_format(finite.max())}, minimum at {case}"


def _format(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
