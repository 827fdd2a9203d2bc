"""Report page of a tiled map of a whole part."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turnwright.report import figures
from turnwright.report.drawing import draw
from turnwright.report.page import Page, Section, Table, write_page
from turnwright.report.run import roughness_rows

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path as File

    from turnwright.job import Job
    from turnwright.metrology import Roughness, Spectrum
    from turnwright.studies import TiledMap

__all__ = ["write_tiled"]

MIN_PICTURE_PIXELS = 700
"""Pixels along the longer side of the picture of the whole part."""

WINDOW_PIXELS = 300
"""Side of a window that is shown at full resolution."""


def write_tiled(job: Job, tiled: TiledMap, rough: Roughness, spectrum: Spectrum, path: str | PathLike[str]) -> File:
    """Write the page of a tiled map of a whole part, see `write_page`."""
    part = job.part
    x_low, x_high, y_low, y_high = tiled.extent
    side = WINDOW_PIXELS * max(tiled.pixel) / 2
    middle = min(part.reach / 2, x_high - side)
    windows = []
    for name, x in (("the axis", 0.0), ("half the radius", middle)):
        window = tiled.window(x=(x - side, x + side), y=(-side, side), pixels=WINDOW_PIXELS)
        windows.append(draw(figures.error_map, window, title=f"At {name}, full resolution"))
    rows, columns = tiled.shape
    size = (
        f"{columns:,} × {rows:,} pixels of {tiled.pixel[0] * 1e3:.4g} µm, {rough.valid:,} heights within a clear "
        f"aperture of {part.reach:.4g} mm semi-diameter."
    )
    levels = (
        f"The map is a Zarr version 3 group with {tiled.levels} resolution levels; each level halves the pixel count "
        "along each axis."
    )
    overview = draw(
        figures.error_map,
        tiled.window(x=(x_low, x_high), y=(y_low, y_high), pixels=MIN_PICTURE_PIXELS),
        "Mean error in each pixel, so that finer structure is averaged out",
        title="The whole part",
    )
    maps = [overview, *windows, draw(figures.density, spectrum)]
    sections = [
        Section(text=[size, levels]),
        Section(title="Error maps", items=maps),
        Section(
            title="Roughness of the whole part",
            items=[Table(rows=roughness_rows([rough]), span=3)],
            notes=[
                f"{what}: {note}." for what, one in (("roughness", rough), ("spectrum", spectrum)) for note in one.notes
            ],
        ),
    ]
    return write_page(Page(kind="Whole part", job=job, sections=sections), path)
