"""Report page of a tiled map of a whole part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from turnwright.report.page import Page, page_file, set_page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike
    from pathlib import Path as File

    from turnwright.job import Job
    from turnwright.metrology import Roughness, Spectrum
    from turnwright.report.figures import Picture
    from turnwright.studies import TiledMap

__all__ = ["write_tiled"]

MIN_PICTURE_PIXELS = 700
"""Pixels along the longer side of the picture of the whole part."""

WINDOW_PIXELS = 300
"""Side of a window that is shown at full resolution."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Page(Page):
    """Content of the page, passed to the template."""

    facts: Sequence[str]
    overview: Picture
    windows: Sequence[tuple[str, Picture]]
    spectrum: Picture
    rows: Sequence[tuple[str, str, str]]
    notes: Sequence[str]


def write_tiled(job: Job, made: TiledMap, rough: Roughness, spectrum: Spectrum, path: str | PathLike[str]) -> File:
    """Write the page of a tiled map of a whole part.

    Parameters
    ----------
    job, made, rough, spectrum
        Job, tiled map of its error, and roughness and spectrum of the map.
    path
        File, or an existing folder in which the page is named ``report.html``.

    Returns
    -------
    pathlib.Path
        The file written.
    """
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    path = page_file(path)
    part = job.part
    x_low, x_high, y_low, y_high = made.extent
    side = WINDOW_PIXELS * max(made.pixel) / 2
    middle = min(part.radius / 2, x_high - side)
    windows = []
    for name, x in (("the axis", 0.0), ("half the radius", middle)):
        window = made.window(x=(x - side, x + side), y=(-side, side), pixels=WINDOW_PIXELS)
        windows.append((f"At {name}, full resolution", draw.error_map(window)))
    rows, columns = made.shape
    size = (
        f"{columns:,} × {rows:,} pixels of {made.pixel[0] * 1e3:.4g} µm, {rough.valid:,} heights within a clear "
        f"aperture of {part.radius:.4g} mm semi-diameter."
    )
    levels = (
        f"The map is a Zarr version 3 group with {made.levels} resolution levels; each level halves the pixel count "
        "along each axis."
    )
    page = _Page(
        title=part.name or "Part",
        kind="Whole part",
        facts=[size, levels],
        overview=draw.error_map(made.window(x=(x_low, x_high), y=(y_low, y_high), pixels=MIN_PICTURE_PIXELS)),
        windows=windows,
        spectrum=draw.density(spectrum),
        rows=_rows(rough),
        notes=[f"{what}: {note}" for what, one in (("roughness", rough), ("spectrum", spectrum)) for note in one.notes],
        job=job.to_toml(),
    )
    return set_page("tiled.html.j2", page, path)


def _rows(rough: Roughness) -> list[tuple[str, str, str]]:
    return [
        ("Sa", f"{rough.sa_nm:.4g}", "nm"),
        ("Sq", f"{rough.sq_nm:.4g}", "nm"),
        ("Sp", f"{rough.sp_nm:.4g}", "nm"),
        ("Sv", f"{rough.sv_nm:.4g}", "nm"),
        ("Sz, PV", f"{rough.sz_nm:.4g}", "nm"),
        ("Ssk", f"{rough.ssk:.4g}", ""),
        ("Sku", f"{rough.sku:.4g}", ""),
        ("Sdq", f"{rough.sdq:.4g}", ""),
        ("Sdr", f"{rough.sdr:.4g}", "%"),
        ("Form removed", str(rough.form), ""),
        ("Heights counted", f"{rough.valid:,}", ""),
    ]
