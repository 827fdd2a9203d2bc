"""Pictures of a parameter study: lines over one field, maps over two, scatter plots over more."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from turnwright.report.figures import HEIGHTS, INK, PAPER, SERIES, Picture, _bar, _canvas

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from turnwright._arrays import Bools, Floats
    from turnwright.studies import Column, Study

__all__ = ["line_over", "map_over", "profiles_of", "scatter"]

MIN_LOG_RATIO = 30.0
"""Ratio of largest to smallest value above which a logarithmic scale is used."""

MAX_CONTOURS = 9

STEP_TOL = 1e-6
"""Relative tolerance on equal steps of a field."""


def _is_text(column: Column) -> bool:
    return bool(column.values.dtype.kind in "Ub")


def _is_geometric(values: Floats) -> bool:
    """Whether values have equal ratios but not equal steps."""
    if values.size < 3 or values.min() <= 0:
        return False
    ratio, step = values[1:] / values[:-1], np.diff(values)
    return bool(np.ptp(ratio) < 1e-2 * ratio.mean() and np.ptp(step) > STEP_TOL * step.mean() and ratio.mean() > 1.05)


def _needs_log_scale(values: Floats) -> bool:
    finite = values[np.isfinite(values)]
    return bool(finite.size and finite.min() > 0 and finite.max() > MIN_LOG_RATIO * finite.min())


def _places(column: Column) -> Floats:
    """Return the axis positions of the distinct values of a field; texts are numbered."""
    places: Any = np.arange(column.different.size) if _is_text(column) else column.different
    return np.asarray(places, dtype=np.float64)


def _axis(axes: Axes, column: Column, which: str) -> None:
    """Label an axis with the heading of a field, and set its scale."""
    getattr(axes, f"set_{which}label")(column.heading)
    if _is_text(column):
        getattr(axes, f"set_{which}ticks")(_places(column), [str(one) for one in column.different])
    elif _is_geometric(_places(column)):
        _logarithmic(axes, which)


def _logarithmic(axes: Axes, which: str) -> None:
    """Make an axis logarithmic, with plain numbers as tick labels."""
    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))
    axis.set_minor_formatter(NullFormatter())


def _job_value(column: Column) -> float | None:
    """Return the axis position of the job's own value of a field."""
    if column.job_value is None:
        return None
    if _is_text(column):
        indices = np.flatnonzero(column.different == column.job_value)
        return float(indices[0]) if indices.size else None
    return float(column.job_value)


def map_over(study: Study, measure: str) -> Picture:
    """Draw a map of a measure over two fields; cases that `run` would refuse are hatched.

    Parameters
    ----------
    study
        A grid over two fields.
    measure
        Its name.
    """
    vertical, horizontal = study.fields[1], study.fields[0]
    grid = study.grid(measure, over=(vertical.name, horizontal.name))
    column = study.column(measure)
    x, y, z = _places(horizontal), _places(vertical), grid.values
    finite = z[np.isfinite(z)]
    caption = _describe_range(study, measure, f"{column.heading} over {horizontal.name} and {vertical.name}")
    smooth = not _is_text(horizontal) and not _is_text(vertical) and min(x.size, y.size) >= 3
    with _canvas(4.9, 3.9) as canvas:
        axes = canvas.figure.add_subplot()
        _axis(axes, horizontal, "x")
        _axis(axes, vertical, "y")
        if finite.size:
            log = _needs_log_scale(finite)
            levels = _levels(finite, log=log)
            shared: dict[str, Any] = {"cmap": HEIGHTS, "norm": "log" if log else None}
            if smooth and levels.size > 1:
                ends = np.r_[min(levels[0], finite.min()), levels, max(levels[-1], finite.max())]
                filled = np.unique(ends)
                image: Any = axes.contourf(x, y, z, levels=filled, **shared)
                lines = axes.contour(x, y, z, levels=levels, colors=PAPER, linewidths=0.8)
                axes.clabel(lines, fmt=_short, fontsize=7, inline_spacing=3)
            else:
                image = axes.pcolormesh(_edges(x), _edges(y), z, **shared)
            _bar(canvas, axes, image, column.heading)
            if log or smooth:
                canvas.figure.axes[-1].set_yticks(levels, [_short(one) for one in levels])
                canvas.figure.axes[-1].minorticks_off()
        _hatch(axes, x, y, grid.ok, np.isfinite(z))
        job_place = _job_value(horizontal), _job_value(vertical)
        limits = axes.get_xlim(), axes.get_ylim()
        if (
            job_place[0] is not None
            and job_place[1] is not None
            and _is_within(job_place[0], limits[0])
            and _is_within(job_place[1], limits[1])
        ):
            axes.plot(
                job_place[0], job_place[1], "o", color=PAPER, markeredgecolor=INK, markersize=7, clip_on=False, zorder=5
            )
            caption += " The dot marks the job."
        axes.set(xlim=limits[0], ylim=limits[1])
    if not grid.ok.all():
        caption += " Hatched: cases that run would refuse, or without a value."
    return Picture(canvas.svg, caption)


def profiles_of(study: Study, measure: str) -> Picture:
    """Draw a measure over the first field at some values of the second.

    Parameters
    ----------
    study
        A grid over two fields.
    measure
        Its name.
    """
    across, along = study.fields
    grid = study.grid(measure, over=(along.name, across.name))
    column, x = study.column(measure), _places(across)
    picks = np.unique(np.linspace(0, grid.rows.size - 1, min(grid.rows.size, len(SERIES))).round().astype(int))
    with _canvas(4.6, 3.9) as canvas:
        axes = canvas.figure.add_subplot()
        for pick, colour, line in zip(picks, SERIES, ("-", "--", "-."), strict=False):
            value = grid.rows[pick]
            label = f"{_short(value) if not _is_text(along) else value} {along.unit}".rstrip()
            good = grid.ok[pick]
            axes.plot(x, grid.values[pick], line, color=colour, linewidth=1.3, label=label)
            axes.plot(x[good], grid.values[pick][good], "o", color=colour, markersize=3.2)
            axes.plot(x[~good], grid.values[pick][~good], "x", color=INK, markersize=5)
        if _needs_log_scale(grid.values[picks]):
            _logarithmic(axes, "y")
        axes.set_ylabel(column.heading)
        axes.grid(visible=True)
        _axis(axes, across, "x")
        axes.legend(title=along.name, ncols=len(picks), loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=2.4)
    caption = f"{column.heading} over {across.name} at {len(picks)} values of {along.name}."
    return Picture(canvas.svg, caption + ("" if grid.ok[picks].all() else " Crosses: cases that run would refuse."))


def _is_within(value: float, limits: tuple[float, float]) -> bool:
    return bool(min(limits) <= value <= max(limits))


def _levels(known: Floats, *, log: bool) -> Floats:
    """Return round contour levels."""
    low, high = float(known.min()), float(known.max())
    if not high > low * (1 + 1e-9) + 1e-300:
        return np.array([low])
    if log:
        decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
        subs = (1.0, 2.0, 5.0) if high < 2e3 * low else (1.0, 3.0) if high < 1e5 * low else (1.0,)
        values = np.array([sub * 10.0**decade for decade in decades for sub in subs])
    else:
        values = np.asarray(MaxNLocator(MAX_CONTOURS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    return np.asarray(values[(values > low) & (values < high)], dtype=np.float64)


def _short(value: float) -> str:
    return f"{value:.6g}"


def _edges(places: Floats) -> Floats:
    """Return the edges of cells centred on positions."""
    if places.size == 1:
        return np.array([places[0] - 0.5, places[0] + 0.5])
    middle = (places[1:] + places[:-1]) / 2
    return np.concatenate([[2 * places[0] - middle[0]], middle, [2 * places[-1] - middle[-1]]])


def _hatch(axes: Axes, x: Floats, y: Floats, ok: Bools, known: Bools) -> None:
    """Hatch the cells of refused cases; cross-hatch those without a value."""
    if ok.all():
        return
    wide, high = _edges(x), _edges(y)
    x_min, x_max = x.min(), x.max()
    y_min, y_max = y.min(), y.max()
    from matplotlib.patches import Rectangle  # noqa: PLC0415 - needed only for refused cases

    inset = (x_min, x_max, y_min, y_max) if x.size > 1 and y.size > 1 and not _covers_cells(axes, wide, high) else None
    for row, column in zip(*np.nonzero(~ok), strict=True):
        x0, x1, y0, y1 = wide[column], wide[column + 1], high[row], high[row + 1]
        if inset is not None:
            x0, x1 = np.clip((x0, x1), inset[0], inset[1])
            y0, y1 = np.clip((y0, y1), inset[2], inset[3])
        style = "////" if known[row, column] else "xxxx"
        place: Any = (x0, y0), x1 - x0, y1 - y0
        axes.add_patch(Rectangle(*place, facecolor=PAPER, linewidth=0.0, alpha=0.45, zorder=3))
        axes.add_patch(Rectangle(*place, fill=False, hatch=style, edgecolor=INK, linewidth=0.0, alpha=0.6, zorder=3))


def _covers_cells(axes: Axes, wide: Floats, high: Floats) -> bool:
    """Whether the axes extend to the edges of the cells."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    return bool(min(x0, x1) <= wide.min() + 1e-12 and max(y0, y1) >= high.max() - 1e-12)


def line_over(study: Study, measure: str) -> Picture:
    """Draw a measure over the only field of a study.

    Parameters
    ----------
    study
        Over one field.
    measure
        Its name.
    """
    over, column = study.fields[0], study.column(measure)
    at = np.searchsorted(over.different, over.values).astype(np.float64) if _is_text(over) else over.values
    order = np.argsort(at, kind="stable")
    good = study.ok[order]
    with _canvas(4.6, 2.9) as canvas:
        axes = canvas.figure.add_subplot()
        axes.plot(at[order], column.values[order], "-", color=SERIES[0], linewidth=1.3)
        axes.plot(at[order][good], column.values[order][good], "o", color=SERIES[0], markersize=3.6)
        axes.plot(at[order][~good], column.values[order][~good], "x", color=INK, markersize=6)
        if _needs_log_scale(column.values):
            _logarithmic(axes, "y")
        axes.set_ylabel(column.heading)
        axes.grid(visible=True)
        _axis(axes, over, "x")
        job_place = _job_value(over)
        if job_place is not None and at.min() <= job_place <= at.max():
            axes.axvline(job_place, color=SERIES[1], linestyle="--", linewidth=1.0)
    caption = _describe_range(study, measure, f"{column.heading} over {over.name}")
    caption += " The dashed line marks the job." if job_place is not None else ""
    return Picture(canvas.svg, caption + ("" if study.ok.all() else " Crosses: cases that run would refuse."))


def scatter(study: Study, measures: Sequence[str]) -> Picture:
    """Draw every measure against every field, with running medians.

    Parameters
    ----------
    study
        Study over any number of fields.
    measures
        Their names.
    """
    width = len(study.fields)
    with _canvas(max(4.9, 2.3 * width), 0.7 + 1.9 * len(measures)) as canvas:
        panels = np.atleast_2d(canvas.figure.subplots(len(measures), width, sharex="col", sharey="row", squeeze=False))
        for row, name in enumerate(measures):
            column = study.column(name)
            for number, over in enumerate(study.fields):
                axes = panels[row, number]
                at = np.searchsorted(over.different, over.values).astype(float) if _is_text(over) else over.values
                good = study.ok & np.isfinite(column.values)
                bad = ~study.ok & np.isfinite(column.values)
                axes.plot(at[good], column.values[good], ".", color=SERIES[0], markersize=3.5, alpha=0.55)
                axes.plot(at[bad], column.values[bad], "x", color=INK, markersize=3.5, alpha=0.6)
                middles, medians = _medians(at[good], column.values[good])
                axes.plot(middles, medians, "-", color=SERIES[1], linewidth=1.6)
                if _needs_log_scale(column.values):
                    _logarithmic(axes, "y")
                job_place = _job_value(over)
                if job_place is not None and at.min() <= job_place <= at.max():
                    axes.axvline(job_place, color=SERIES[1], linestyle="--", linewidth=1.0)
                axes.grid(visible=True)
                if row == len(measures) - 1:
                    _axis(axes, over, "x")
                    axes.set_xlabel(over.heading.replace(" [", "\n["), fontsize=7.5)
                if number == 0:
                    axes.set_ylabel(column.heading)
    caption = f"Every measure against every field, {int(study.ok.sum())} cases, with running medians."
    caption += " The dashed lines mark the job." if any(_job_value(one) is not None for one in study.fields) else ""
    return Picture(canvas.svg, caption + ("" if study.ok.all() else " Crosses: cases that run would refuse."))


def _medians(at: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the medians at each distinct value, or over tenths of the cases if there are many."""
    different = np.unique(at)
    if 1 < different.size <= 20 and different.size < at.size:
        return different, np.array([np.median(values[at == one]) for one in different])
    order = np.argsort(at, kind="stable")
    parts = [part for part in np.array_split(order, 10) if part.size]
    return np.array([at[part].mean() for part in parts]), np.array([np.median(values[part]) for part in parts])


def _describe_range(study: Study, measure: str, what: str) -> str:
    values = study.column(measure).values
    finite = values[np.isfinite(values)]
    if not finite.size:
        return f"{what}: no case has a value."
    return f"{what}: from {finite.min():.4g} to {finite.max():.4g}."
