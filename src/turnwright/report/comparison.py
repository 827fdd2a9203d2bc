"""Report page of a strategy comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from turnwright.report.page import Page, page_file, set_page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike
    from pathlib import Path as File

    from turnwright.job import Candidate, Comparison
    from turnwright.report.figures import Picture

__all__ = ["COLUMNS", "cells", "write_comparison"]

NM = 1e6

MIN_SHOWN = 1e-5
"""Smallest value that is not printed as 0, in the units of the page."""

COLUMNS = (
    "strategy", "revolutions", "points", "program [MB]", "spindle [rev/min]", "limited by", "minutes", "PV [nm]",
    "rms [nm]", "cusps [nm]", "chord [nm]", "decimals [nm]", "servos [nm]",
)  # fmt: skip
"""Columns of the table of strategies."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Page(Page):
    """Content of the page, passed to the template."""

    basis: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    axes: Sequence[str]
    motions: Sequence[Sequence[str]]
    refused: Sequence[tuple[str, str]]
    pictures: Sequence[Picture]
    maps: Sequence[tuple[str, Picture]]


def _shown(value: float) -> str:
    """Format a value with three digits; 0 below `MIN_SHOWN`."""
    return f"{value:.3g}" if value >= MIN_SHOWN else "0"


def cells(one: Candidate) -> tuple[str, ...]:
    """Return the table row of a strategy that can be used, see `COLUMNS`."""
    limits, contributions = one.limits, one.shares
    assert limits is not None  # noqa: S101 - it was not refused
    assert contributions is not None  # noqa: S101
    return (
        one.name, f"{one.turns:.0f}", f"{limits.points:,}", f"{one.size_bytes / 1e6:.3g}", f"{limits.spindle_rpm:.4g}",
        limits.binding, f"{limits.cycle_time_s / 60:.3g}", f"{contributions.pv_nm:.3g}", f"{contributions.rms_nm:.3g}",
        f"{contributions.cusp_nm:.3g}", f"{contributions.chord_nm:.3g}", f"{contributions.rounding_nm:.2g}",
        _shown(contributions.tracking_nm),
    )  # fmt: skip


def write_comparison(found: Comparison, path: str | PathLike[str]) -> File:
    """Write the page of a comparison.

    Parameters
    ----------
    found
        Comparison of the strategies.
    path
        File, or an existing folder in which the page is named ``report.html``.

    Returns
    -------
    pathlib.Path
        The file written.
    """
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    path = page_file(path)
    done = [one for one in found.candidates if not one.refused]
    letters = sorted({letter for one in done if one.limits for letter in one.limits.travel if letter != "C"})
    part = found.job.part
    page = _Page(
        title=part.name or "Part",
        kind="Strategy comparison",
        basis=f"Every strategy is planned for cusps of {found.scallop * NM:.3g} nm away from the axis and from valleys "
        f"narrower than the nose, and for chord errors of {found.chord * NM:.3g} nm, on {found.job.machine.name}.",
        columns=COLUMNS,
        rows=[cells(one) for one in done],
        axes=[
            "strategy",
            *(
                f"{letter} {what}"
                for letter in letters
                for what in ("stroke [mm]", "peak speed [mm/s]", "peak acceleration [mm/s²]")
            ),
        ],
        motions=[(one.name, *_motions(one, letters)) for one in done],
        refused=[(one.name, one.refused) for one in found.candidates if one.refused],
        pictures=[draw.minutes_and_errors(done), draw.shares_of(done)] if done else [],
        maps=[(one.name, draw.error_map(one.shares.error)) for one in done if one.shares],
        job=found.job.to_toml(),
    )
    return set_page("comparison.html.j2", page, path)


def _motions(candidate: Candidate, letters: Sequence[str]) -> list[str]:
    """Return stroke, peak speed and peak acceleration of each axis."""
    assert candidate.limits is not None  # noqa: S101 - it was not refused
    row = []
    for letter in letters:
        if letter not in candidate.limits.travel:
            row += ["", "", ""]
            continue
        low, high = candidate.limits.travel[letter]
        row += [
            *map(_shown, (high - low, candidate.limits.peak_speed[letter], candidate.limits.peak_acceleration[letter])),
        ]  # fmt: skip
    return row
