"""Report page of a parameter study."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.report import study_figures as figures
from turnwright.report.drawing import draw
from turnwright.report.page import Page, Section, Table, write_page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike
    from pathlib import Path as File

    from turnwright.report.page import Drawing
    from turnwright.studies import Column, Study

__all__ = ["write_study"]

MAX_BEST_CASES = 12

MAX_REASONS = 12
"""Reasons of failure that the page lists."""

MAX_LISTED_VALUES = 4
"""Values of a field that are listed individually; more are given as a range."""


def write_study(study: Study, path: str | PathLike[str]) -> File:
    """Write the page of a study, see `write_page`."""
    numbers = [one.name for one in study.measures if one.values.dtype.kind in "fi"]
    sections = [Section(text=_describe_design(study)), Section(title="Results", items=_pictures(study, numbers))]
    if numbers and (best := study.best(numbers[0], MAX_BEST_CASES)):
        columns = ["case", *(one.heading for one in study.columns)]
        table = Table(
            columns=columns,
            numeric=range(1, len(columns)),
            rows=[[str(number + 1), *(_format(one.values[number]) for one in study.columns)] for number in best],
            notes=["Valid cases, smallest value first. All cases are in study.csv, numbered from 0."],
            dense=True,
        )
        sections.append(Section(title=f"Best cases by {numbers[0]}", items=[table]))
    if reasons := _reasons(study):
        sections.append(Section(title="Failed cases", notes=reasons))
    return write_page(Page(kind="Study", job=study.job, sections=sections), path)


def _pictures(study: Study, numbers: Sequence[str]) -> list[Drawing]:
    """Return maps and profiles over two fields, lines over one, or scatter plots over more."""
    if not numbers or not study.fields:
        return []
    if len(study.fields) == 1:
        return [draw(figures.draw_line, study, name) for name in numbers]
    if len(study.fields) == 2 and study.is_grid and min(field.different.size for field in study.fields) > 1:
        return [draw(figure, study, name) for name in numbers for figure in (figures.draw_map, figures.profiles_of)]
    return [draw(figures.scatter, study, numbers)]


def _reasons(study: Study) -> list[str]:
    """Group the reasons of failed cases, ignoring numbers; return one example of each group."""
    kinds: dict[str, list[str]] = {}
    for reason in filter(None, study.reasons):
        kinds.setdefault(re.sub(r"[-+]?[0-9][0-9.e+-]*", "0", reason), []).append(reason)
    most = sorted(kinds.values(), key=len, reverse=True)[:MAX_REASONS]
    return [f"{'1 case' if len(alike) == 1 else f'{len(alike)} cases, for instance'}: {alike[0]}" for alike in most]


def _describe_design(study: Study) -> list[str]:
    varied = "; ".join(f"{field.heading}: {_values(field)}" for field in study.fields)
    ok = int(study.ok.sum())
    cases = f"{len(study)} cases, design: {study.design}"
    if ok < len(study):
        cases += f", {len(study) - ok} failed"
    seconds = study.seconds[np.isfinite(study.seconds)]
    if seconds.size:
        cases += f"; time per case: median {np.median(seconds):.3g} s, maximum {seconds.max():.3g} s"
    return [f"Varied: {varied}.", f"{cases}."]


def _values(one: Column) -> str:
    values = one.different
    if values.size <= MAX_LISTED_VALUES or values.dtype.kind in "Ub":
        return ", ".join(_format(value) for value in values)
    return f"{values.size} values from {_format(values[0])} to {_format(values[-1])}"


def _format(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return f"{float(value):.5g}"
    return str(value)
