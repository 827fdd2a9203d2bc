"""Command that writes a map in the format of another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from turnwright.cli.shared import Session, Unit, app, require_unused

__all__: list[str] = []

MapFile = Annotated[
    Path, typer.Argument(metavar="MAP", help="Height map, in any supported format.", show_default=False)
]


@app.command("export")
def export_map(
    context: typer.Context,
    file: MapFile,
    out: Annotated[Path, typer.Option(metavar="FILE", help="File to write.", show_default=False)],
    map_format: Annotated[
        str | None,
        typer.Option(
            "--format", help='"npz", "x3p", "grid sag", "grid phase", "zygo" or "codev"; by default by the suffix.'
        ),
    ] = None,
    base: Annotated[
        Path | None,
        typer.Option(metavar="JOB.toml", help="Job whose nominal surface is subtracted.", show_default=False),
    ] = None,
    face: Annotated[
        str | None,
        typer.Option(help='"front" turns the map over, for a face with its material on the +z side of a lens file.'),
    ] = None,
    wavelength: Annotated[
        str | None, typer.Option(help='Wavelength of a grid phase, such as "632.8 nm".', show_default=False)
    ] = None,
    index: Annotated[
        float | None,
        typer.Option(help="Index of the part for a grid phase, unless it is a mirror.", show_default=False),
    ] = None,
    unit: Unit = None,
    pixel_size: Annotated[
        str | None, typer.Option(help='Pixel size if the file states none, such as "0.87 um".')
    ] = None,
) -> None:
    """Write a map in the format of another program."""
    session: Session = context.obj
    from turnwright.files import read_map, write_map  # noqa: PLC0415 - costly to import
    from turnwright.job import Job  # noqa: PLC0415
    from turnwright.units import parse  # noqa: PLC0415

    require_unused(out)
    heights = read_map(file, unit=unit, pixel_size=None if pixel_size is None else parse(pixel_size, "mm"))
    write_map(
        heights,
        out,
        format=map_format,  # type: ignore[arg-type] # any other name raises InputError
        base=None if base is None else Job.load(base).part.design.surface,
        face=face,  # type: ignore[arg-type]
        wavelength=None if wavelength is None else parse(wavelength, "mm"),
        index=index,
    )
    session.echo(f"map: {out}")
