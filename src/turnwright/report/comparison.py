"""The page of a comparison: strategies side by side."""

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

FAINT = 1e-5
"""Below this a number is not worth its digits, in the units of the page."""

COLUMNS = (
    "strategy", "turns", "points", "program [MB]", "spindle [rev/min]", "bound by", "minutes", "PV [nm]", "rms [nm]",
    "cusps [nm]", "chord [nm]", "decimals [nm]", "servos [nm]",
)  # fmt: skip
"""What is said of each strategy."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Page(Page):
    """What the page says, ready to be set."""

    asked: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    axes: Sequence[str]
    motions: Sequence[Sequence[str]]
    refused: Sequence[tuple[str, str]]
    pictures: Sequence[Picture]
    maps: Sequence[tuple[str, Picture]]


def _shown(value: float) -> str:
    """Return three digits, or 0 for what is mere rounding."""
    return f"{value:.3g}" if value >= FAINT else "0"


def cells(one: Candidate) -> tuple[str, ...]:
    """Return what is said of a strategy that was not refused, see `COLUMNS`."""
    limits, found = one.limits, one.shares
    assert limits is not None  # noqa: S101 - it was not refused
    assert found is not None  # noqa: S101
    return (
        one.name, f"{one.turns:.0f}", f"{limits.points:,}", f"{one.size_bytes / 1e6:.3g}", f"{limits.spindle_rpm:.4g}",
        limits.binding, f"{limits.cycle_time_s / 60:.3g}", f"{found.pv_nm:.3g}", f"{found.rms_nm:.3g}",
        f"{found.cusp_nm:.3g}", f"{found.chord_nm:.3g}", f"{found.rounding_nm:.2g}",
        _shown(found.tracking_nm),
    )  # fmt: skip


def write_comparison(found: Comparison, path: str | PathLike[str]) -> File:
    """Write the page of a comparison.

    Parameters
    ----------
    found
        What the strategies make of a job.
    path
        Where to; in a folder that exists the page is called ``report.html``.

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
        kind="Strategies compared",
        asked=f"Every strategy is planned for cusps of {found.scallop * NM:.3g} nm away from the axis and the valleys "
        f"that no nose reaches, and for chords of {found.chord * NM:.3g} nm, on {found.job.machine.name}.",
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


def _motions(one: Candidate, letters: Sequence[str]) -> list[str]:
    """Return stroke, speed and acceleration of each axis."""
    assert one.limits is not None  # noqa: S101 - it was not refused
    told = []
    for letter in letters:
        if letter not in one.limits.travel:
            told += ["", "", ""]
            continue
        low, high = one.limits.travel[letter]
        told += [
            _shown(high - low), _shown(one.limits.peak_speed[letter]), _shown(one.limits.peak_acceleration[letter]),
        ]  # fmt: skip
    return told
