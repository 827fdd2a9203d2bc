"""The page of a whole part in tiles."""

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

PIXELS = 700
"""Of a picture, along its longer side, at least."""

ZOOMS = 300
"""Pixels of the map along the side of a window at its own resolution."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Page(Page):
    """What the page says, ready to be set."""

    facts: Sequence[str]
    whole: Picture
    windows: Sequence[tuple[str, Picture]]
    spectrum: Picture
    rows: Sequence[tuple[str, str, str]]
    notes: Sequence[str]


def write_tiled(job: Job, made: TiledMap, rough: Roughness, spectrum: Spectrum, path: str | PathLike[str]) -> File:
    """Write the page of a whole part.

    Parameters
    ----------
    job, made, rough, spectrum
        What was asked for, the map of its error, and what was found in it.
    path
        Where to; in a folder that exists the page is called ``report.html``.

    Returns
    -------
    pathlib.Path
        The file written.
    """
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    path = page_file(path)
    part = job.part
    left, right, low, high = made.extent
    side = ZOOMS * max(made.pixel) / 2
    middle = min(part.radius / 2, right - side)
    windows = []
    for name, x in (("the axis", 0.0), ("half of the radius", middle)):
        seen = made.window(x=(x - side, x + side), y=(-side, side), pixels=ZOOMS)
        windows.append((f"At {name}, every pixel", draw.error_map(seen)))
    rows, columns = made.shape
    found = (
        f"{columns:,} × {rows:,} pixels of {made.pixel[0] * 1e3:.4g} µm, {rough.valid:,} heights within the clear "
        f"radius of {part.radius:.4g} mm."
    )
    kept = (
        f"The map is a zarr group of version 3 with {made.levels} resolutions, each with half of the pixels of the one "
        "before along each axis."
    )
    page = _Page(
        title=part.name or "Part",
        kind="Whole part",
        facts=[found, kept],
        whole=draw.error_map(made.window(x=(left, right), y=(low, high), pixels=PIXELS)),
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
