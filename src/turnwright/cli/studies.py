"""The commands of many cases: studies of a job."""

from __future__ import annotations

import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import Door, Folder, Force, JobFile, app, new_folder, progress_of
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Executor

    from turnwright.studies import Column, Study

__all__ = ["Cluster", "KeptAt", "Workers", "kept_cases", "over"]

STEPS = (Step(stage="cases", work=100.0), Step(stage="report", work=3.0))

Workers = Annotated[
    int | None,
    typer.Option(min=1, help="Processes of this machine, a core each; as many as it has cores if not given."),
]
Cluster = Annotated[
    str | None, typer.Option(metavar="URL", help='A Dask scheduler that runs, such as "tcp://head:8786".')
]
KeptAt = Annotated[
    str | None,
    typer.Option(
        "--store",
        metavar="URL",
        help="Folder, or URL of fsspec, where finished cases stay for other studies; if not given, one beside the "
        "results that goes when all is done.",
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
            metavar="NAME", help='What to measure, such as "sq_nm", "minutes" or "peak_acceleration@X"; once for each.'
        ),
    ],
    vary: Annotated[
        list[str],
        typer.Option(
            metavar="FIELD=VALUES",
            help='A field of the job and its values: "tool.nose_radius=0.1..1 mm:10", "strategy.feed=2, 4, 8 um/rev", '
            '"actual.tool.offset[1]=normal(0, 2) um"; once for each field.',
        ),
    ],
    design: Annotated[
        str, typer.Option(help='"grid", or "random", "sobol", "halton", "latin hypercube" with --cases.')
    ] = "grid",
    cases: Annotated[int | None, typer.Option(min=1, help="How many cases to draw.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another one draws other cases.")] = 0,
    workers: Workers = None,
    cluster: Cluster = None,
    store: KeptAt = None,
    force: Force = False,
) -> None:
    """Vary fields of a job and measure what becomes of every case: a table, maps and a page."""
    door: Door = context.obj
    from turnwright.job import Job  # noqa: PLC0415 - costly
    from turnwright.studies import study as carry_out  # noqa: PLC0415

    recipe, varied = Job.load(job), _varied(vary)
    with (
        new_folder(out, door, force=force) as folder,
        kept_cases(out, store, door) as kept,
        progress_of(door.stop, STEPS) as progress,
        over(cluster) as executor,
    ):
        found = carry_out(
            recipe, vary=varied, measure=measure, design=design, count=cases, seed=seed, executor=executor, store=kept,
            workers=workers, progress=lambda done, total: progress("cases", done, total),
        )  # fmt: skip
        progress("report", 0, 1)
        from turnwright.report import write_study  # noqa: PLC0415 - matplotlib, only for a study that came so far

        found.save(folder)
        with suppress(InputError):  # Parquet is of an extra
            found.to_parquet(folder / "study.parquet")
        write_study(found, folder)
        progress("report", 1, 1)
    _say(door, found)
    door.say(f"table: {out / 'study.csv'}")
    door.say(f"report: {out / 'report.html'}")
    if not found.ok.any():
        raise InputError(f"all {len(found)} cases are refused, the first for this: {found.reasons[0]}")


def _varied(given: list[str]) -> dict[str, str]:
    """Return what is varied, of ``FIELD=VALUES``."""
    found: dict[str, str] = {}
    for one in given:
        name, equals, values = one.partition("=")
        if not equals or not name.strip() or not values.strip():
            raise InputError(
                f'--vary {one!r} names no field and values: write it such as "tool.nose_radius=0.1..1 mm:10"'
            )
        if name.strip() in found:
            raise InputError(f"{name.strip()} is varied 2 times, the limit is 1: keep one of them")
        found[name.strip()] = values.strip()
    return found


@contextmanager
def over(cluster: str | None) -> Iterator[Executor | None]:
    """Yield the executor of a cluster, or nothing for processes of this machine."""
    if cluster is None:
        yield None
        return
    from turnwright.studies import cluster as reach  # noqa: PLC0415

    with reach(cluster) as executor:
        yield executor


@contextmanager
def kept_cases(out: Path, store: str | None, door: Door) -> Iterator[str]:
    """Yield where finished cases are kept: as asked for, or beside the results until these are there."""
    place = store or str(out.absolute().with_name(f"{out.absolute().name}.cases"))
    door.partly = f"the finished cases stay in {place}: give the same command to go on"
    yield place
    if store is None:
        for part in ("rows", "arrays"):
            shutil.rmtree(Path(place) / part, ignore_errors=True)
        with suppress(OSError):  # somebody has put something else there
            Path(place).rmdir()


def _say(door: Door, found: Study) -> None:
    door.say(f"{len(found)} cases, {int((~found.ok).sum())} of them refused")
    for one in found.measures:
        door.say(_range(found, one))
    reasons = list(dict.fromkeys(filter(None, found.reasons)))
    if reasons and found.ok.any():
        door.say(f"refused, for instance: {reasons[0]}")


def _range(found: Study, one: Column) -> str:
    """Say how far a measure reaches, and where it is least."""
    if one.values.dtype.kind not in "fi":
        return f"{one.heading}: {', '.join(sorted(set(one.values.tolist()) - {''}))}"
    best = found.best(one.name, 1)
    if not best:
        return f"{one.heading}: no case gives a number"
    good = one.values[found.ok & (one.values == one.values)]
    at = ", ".join(f"{field.name} = {_shown(field.values[best[0]])} {field.unit}".strip() for field in found.fields)
    return f"{one.heading}: {_shown(good.min())} to {_shown(good.max())}, least at {at}"


def _shown(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
