"""The page of a study."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.report.page import Page, page_file, set_page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike
    from pathlib import Path as File

    from turnwright.report.figures import Picture
    from turnwright.studies import Column, Study

__all__ = ["write_study"]

BEST = 12
"""Cases in the table of the best."""

MANY = 12
"""Reasons that the page names."""

SHOWN = 4
"""Values of a field that the page names one by one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Page(Page):
    """What the page says, ready to be set."""

    asked: Sequence[str]
    pictures: Sequence[Picture]
    wide: bool
    by: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    reasons: Sequence[tuple[int, str]]


def write_study(found: Study, path: str | PathLike[str]) -> File:
    """Write the page of a study.

    Parameters
    ----------
    found
        What became of every case.
    path
        Where to; in a folder that exists the page is called ``report.html``.

    Returns
    -------
    pathlib.Path
        The file written.
    """
    path = page_file(path)
    numbers = [one.name for one in found.measures if one.values.dtype.kind in "fi"]
    best = found.best(numbers[0], BEST) if numbers else []
    page = _Page(
        title=found.job.part.name or "Part",
        kind="Study",
        asked=_asked(found),
        pictures=_pictures(found, numbers),
        wide=len(found.fields) > 2 or (len(found.fields) == 2 and not found.is_grid),
        by=numbers[0] if numbers else "",
        columns=["case", *(one.heading for one in found.columns)],
        rows=[[str(number + 1), *(_shown(one.values[number]) for one in found.columns)] for number in best],
        reasons=_reasons(found),
        job=found.job.to_toml(),
    )
    return set_page("study.html.j2", page, path)


def _pictures(found: Study, numbers: Sequence[str]) -> list[Picture]:
    """Return maps over two fields with profiles, lines over one, and all against all otherwise."""
    from turnwright.report import study_figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    if not numbers or not found.fields:
        return []
    if len(found.fields) == 1:
        return [draw.line_over(found, name) for name in numbers]
    if len(found.fields) == 2 and found.is_grid and min(one.different.size for one in found.fields) > 1:
        return [picture(found, name) for name in numbers for picture in (draw.map_over, draw.profiles_of)]
    return [draw.scatter(found, numbers)]


def _reasons(found: Study) -> list[tuple[int, str]]:
    """Return how many cases are refused for reasons that differ in their numbers only, and one of each kind."""
    kinds: dict[str, list[str]] = {}
    for reason in filter(None, found.reasons):
        kinds.setdefault(re.sub(r"[-+]?[0-9][0-9.e+-]*", "0", reason), []).append(reason)
    most = sorted(kinds.values(), key=len, reverse=True)[:MANY]
    return [(len(alike), alike[0]) for alike in most]


def _asked(found: Study) -> list[str]:
    varied = "; ".join(f"{one.heading}: {_values(one)}" for one in found.fields)
    ok = int(found.ok.sum())
    cases = f"{len(found)} cases by the design {found.design}"
    if ok < len(found):
        cases += f", {len(found) - ok} of them refused"
    seconds = found.seconds[np.isfinite(found.seconds)]
    if seconds.size:
        cases += f"; a case took {np.median(seconds):.3g} s of one worker (median), the longest {seconds.max():.3g} s"
    return [f"Varied: {varied}.", f"{cases}."]


def _values(one: Column) -> str:
    values = one.different
    if values.size <= SHOWN or values.dtype.kind in "Ub":
        return ", ".join(_shown(value) for value in values)
    return f"{values.size} values from {_shown(values[0])} to {_shown(values[-1])}"


def _shown(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return f"{float(value):.5g}"
    return str(value)
