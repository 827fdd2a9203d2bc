"""Report page of a strategy comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turnwright.report import figures
from turnwright.report.drawing import draw
from turnwright.report.page import Drawing, Page, Section, Table, write_page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike
    from pathlib import Path as File

    from turnwright.job import Candidate, Comparison, Job

__all__ = ["COLUMNS", "cells", "draw_candidate", "write_comparison"]

NM = 1e6

MIN_SHOWN = 1e-5
"""Smallest value that is not printed as 0, in the units of the page."""

COLUMNS = (
    "strategy", "revolutions", "points", "program [MB]", "spindle [rev/min]", "limited by", "minutes", "PV [nm]",
    "rms [nm]", "cusps [nm]", "chord [nm]", "decimals [nm]", "servos [nm]",
)  # fmt: skip
"""Columns of the table of strategies."""


TABLE_TEXT = (
    "PV and rms are of cut minus nominal surface, simulated from the program with the controller's interpolation and "
    "the servos. The error contributions are differences of simulated surfaces: cusps are the error of an exact path; "
    "chord, decimals and servos are the largest change that each causes."
)


def _format(value: float) -> str:
    """Format a value with three digits; 0 below `MIN_SHOWN`."""
    return f"{value:.3g}" if value >= MIN_SHOWN else "0"


def cells(one: Candidate) -> tuple[str, ...]:
    """Return the table row of a strategy that can be used, see `COLUMNS`."""
    limits, contributions = one.limits, one.breakdown
    assert limits is not None  # noqa: S101 - it was not refused
    assert contributions is not None  # noqa: S101
    return (
        one.name, f"{one.turns:.0f}", f"{limits.points:,}", f"{one.size_bytes / 1e6:.3g}", f"{limits.spindle_rpm:.4g}",
        limits.binding, f"{limits.cycle_time_s / 60:.3g}", f"{contributions.pv_nm:.3g}", f"{contributions.rms_nm:.3g}",
        f"{contributions.cusp_nm:.3g}", f"{contributions.chord_nm:.3g}", f"{contributions.rounding_nm:.2g}",
        _format(contributions.tracking_nm),
    )  # fmt: skip


def write_comparison(comparison: Comparison, path: str | PathLike[str]) -> File:
    """Write the page of a comparison, see `write_page`."""
    done = [one for one in comparison.candidates if not one.refused]
    letters = sorted({letter for one in done if one.limits for letter in one.limits.travel if letter != "C"})
    kinds = ("stroke [mm]", "peak speed [mm/s]", "peak acceleration [mm/s²]")
    motions = [f"{letter} {kind}" for letter in letters for kind in kinds]
    scallop, chord, machine = comparison.scallop * NM, comparison.chord * NM, comparison.job.machine.name
    basis = (
        f"Every strategy is planned for cusps of {scallop:.3g} nm away from the axis and from valleys narrower than "
        f"the nose, and for chord errors of {chord:.3g} nm, on {machine}."
    )
    sections = [
        Section(
            text=[basis],
            items=[_table(COLUMNS, [cells(one) for one in done], [TABLE_TEXT])],
            notes=[f"{one.name}: {one.refused}" for one in comparison.candidates if one.refused],
        ),
        Section(
            title="Cutting time and form error",
            items=[draw(figures.minutes_and_errors, done), draw(figures.breakdown_of, done)] if done else [],
        ),
        Section(
            title="Axes",
            items=[_table(["strategy", *motions], [(one.name, *_motions(one, letters)) for one in done])],
        ),
        Section(
            title="Error maps",
            items=[drawing for one in done for drawing in draw_candidate(comparison.job, one)],
        ),
    ]
    return write_page(Page(kind="Strategy comparison", job=comparison.job, sections=sections), path)


def draw_candidate(job: Job, candidate: Candidate) -> list[Drawing]:
    """Order the figures of a strategy of a comparison, if it was not refused."""
    if candidate.breakdown is None:
        return []
    return [draw(figures.error_map, candidate.breakdown.error, title=candidate.name, border=job.part.border)]


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str] = ()) -> Table:
    numeric = range(1, len(columns))
    return Table(columns=columns, numeric=numeric, rows=rows, notes=notes, numbered=True, dense=True)


def _motions(candidate: Candidate, letters: Sequence[str]) -> list[str]:
    """Return stroke, peak speed and peak acceleration of each axis."""
    assert candidate.limits is not None  # noqa: S101 - it was not refused
    row = []
    for letter in letters:
        if letter not in candidate.limits.travel:
            row += ["", "", ""]
            continue
        low, high = candidate.limits.travel[letter]
        row += map(
            _format, (high - low, candidate.limits.peak_speed[letter], candidate.limits.peak_acceleration[letter])
        )
    return row
