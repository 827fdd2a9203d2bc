"""Command that turns a surface of a lens file into a job."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright._io import write_atomic
from turnwright.cli.shared import Session, app, require_picture, require_unused, warn
from turnwright.errors import InputError, quote

if TYPE_CHECKING:
    from turnwright.files import LensFile
    from turnwright.heightmap import HeightMap
    from turnwright.outline import Outline
    from turnwright.part import Part

__all__: list[str] = []

File = Annotated[
    Path, typer.Argument(metavar="FILE", help="Lens file of Zemax (.zmx) or CODE V (.seq).", show_default=False)
]


@app.command("import")
def import_lens(
    context: typer.Context,
    file: File,
    surface: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Surface to cut; all are listed without.")
    ] = None,
    side: Annotated[
        str | None, typer.Option(help="Side of the material: before, after, +z or -z.", show_default=False)
    ] = None,
    radius: Annotated[
        str | None, typer.Option(help='Semi-diameter, such as "5 mm"; by default that of the file.', show_default=False)
    ] = None,
    radii: Annotated[
        bool | None,
        typer.Option("--radii/--curvatures", help="First values of a CODE V file without RDM.", show_default=False),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="JOB.toml", help="The job file.", show_default=False)] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture: .png, .svg or .pdf.", show_default=False),
    ] = None,
    strategy: Annotated[str, typer.Option(metavar="KIND", help="Cutting strategy.")] = "slow tool servo",
) -> None:
    """Turn a lens surface into a job."""
    session: Session = context.obj
    from turnwright.files import read_lens, write_map  # noqa: PLC0415 - costly
    from turnwright.units import parse  # noqa: PLC0415

    lens = read_lens(file, radii=radii)
    if surface is None:
        if side or radius or out or plot:
            raise InputError("--surface is missing: state the number of the surface to cut")
        _list(session, lens)
        return
    part = lens.part(surface, side, radius=None if radius is None else parse(radius, "mm"))  # type: ignore[arg-type]
    one, chosen = lens.surface(surface), lens.side(surface, side)  # type: ignore[arg-type]
    if plot is None and out is not None:
        plot = out.with_suffix(".png")
    if plot is not None:
        require_picture(plot)
    origin = f"From {quote(file.name)} ({lens.program})."
    notes = [origin, f"{chosen.sentence}.", *(f"{remark}." for remark in one.remarks)]
    job = None if out is None else _job(part, notes, strategy, out)
    if plot is not None:
        from turnwright.report import write_lens_picture  # noqa: PLC0415 - imports matplotlib

        write_lens_picture(part, one, chosen, plot)
    if out is not None and job is not None:
        text, tables = job
        for path, heights in tables.items():
            write_map(heights, path)
        write_atomic(out, text)
    session.echo(chosen.sentence)
    session.echo(f"aperture: {_aperture(part.outline, part.radius, ' mm')}")
    warn(one.remarks)
    for what, written in (("job", out), ("picture", plot)):
        if written is not None:
            session.echo(f"{what}: {written}")


def _list(session: Session, lens: LensFile) -> None:
    """Print a table of all surfaces."""
    primary = "" if lens.primary is None else f", {lens.primary * 1e6:g} nm"
    session.echo(f"{lens.name} ({lens.program}, {lens.unit}{primary})")
    rows = [("number", "type", "radius [mm]", "semi-diameter [mm]", "before", "after", "to cut")]
    for one in lens.surfaces:
        cut = one.fault
        if not cut:
            try:
                chosen = lens.side(one.number)
                cut = f"{chosen.side}, toward {'+z' if chosen.is_turned else '-z'}"
            except InputError:
                cut = "state --side" if one.before or one.after else ""
        flat = math.isinf(one.radius)
        rows.append(
            (f"{one.number}{' stop' * one.is_stop}", one.type, "flat" if flat else f"{one.radius:.6g}",
             _aperture(one.aperture, one.semi_diameter), one.before or "air", one.after or "air", cut)
        )  # fmt: skip
    widths = [max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1]]
    for *cells, last in rows:
        session.echo(
            "  ".join([*(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)), last]).rstrip()
        )


def _aperture(outline: Outline | None, radius: float | None, unit: str = "") -> str:
    if outline is None:
        return f"{radius:.6g}{unit}" if radius else "-"
    shape = next(name for name in ("disc", "annulus", "rectangle") if getattr(outline, name) is not None)
    sizes = getattr(outline, shape)
    stated = " x ".join(f"{size:g}" for size in (sizes if isinstance(sizes, tuple) else (sizes,)))
    place = f" at ({outline.centre[0]:g}, {outline.centre[1]:g}){unit}" if any(outline.centre) else ""
    return f"{shape} {stated}{unit}{place}"


def _job(part: Part, notes: list[str], strategy: str, out: Path) -> tuple[str, dict[Path, HeightMap]]:
    """Return the text of a job, and the table of heights of its part by the file next to it that the job names."""
    from turnwright.heightmap import HeightMap  # noqa: PLC0415 - costly
    from turnwright.job import HeightFile, part_template  # noqa: PLC0415
    from turnwright.surface import Gridded, Sum  # noqa: PLC0415

    require_unused(out)
    file = out.absolute().with_name(f"{out.stem}-heights.npz")
    named, tables = [], {}
    for term in part.surface.terms if isinstance(part.surface, Sum) else (part.surface,):
        if isinstance(term, Gridded):
            require_unused(file)
            tables[file] = HeightMap(x=term.x, y=term.y, z=term.z)
            term = replace(term, source=HeightFile(file=file))  # noqa: PLW2901
        named.append(term)
    if tables:
        part = replace(part, surface=Sum(terms=tuple(named)) if len(named) > 1 else named[0])
    return part_template(part, notes, strategy, folder=out.absolute().parent), tables
