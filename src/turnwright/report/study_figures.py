"""The pictures of a study: maps over two fields, lines over one, and every measure against every field of more."""

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

WIDE = 30.0
"""Largest over smallest value from which on colours and lines are even in the logarithm."""

LEVELS = 9
"""Contours of a map."""

EVEN = 1e-6
"""How even the steps of a field must be to count as even."""


def _text(column: Column) -> bool:
    return bool(column.values.dtype.kind in "Ub")


def _geometric(values: Floats) -> bool:
    """Say whether values are even in the logarithm and not otherwise."""
    if values.size < 3 or values.min() <= 0:
        return False
    ratio, step = values[1:] / values[:-1], np.diff(values)
    return bool(np.ptp(ratio) < 1e-2 * ratio.mean() and np.ptp(step) > EVEN * step.mean() and ratio.mean() > 1.05)


def _wide(values: Floats) -> bool:
    known = values[np.isfinite(values)]
    return bool(known.size and known.min() > 0 and known.max() > WIDE * known.min())


def _places(column: Column) -> Floats:
    """Return where on its axis a field's different values stand: texts in a row."""
    found: Any = np.arange(column.different.size) if _text(column) else column.different
    return np.asarray(found, dtype=np.float64)


def _axis(axes: Axes, column: Column, which: str) -> None:
    """Label an axis with a field, its unit, and the scale of its values."""
    getattr(axes, f"set_{which}label")(column.heading)
    if _text(column):
        getattr(axes, f"set_{which}ticks")(_places(column), [str(one) for one in column.different])
    elif _geometric(_places(column)):
        _logarithmic(axes, which)


def _logarithmic(axes: Axes, which: str) -> None:
    """Make an axis even in the logarithm, with numbers as people write them."""
    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))
    axis.set_minor_formatter(NullFormatter())


def _own(column: Column) -> float | None:
    """Return where the job itself stands on the axis of a field."""
    if column.own is None:
        return None
    if _text(column):
        found = np.flatnonzero(column.different == column.own)
        return float(found[0]) if found.size else None
    return float(column.own)


def map_over(study: Study, measure: str) -> Picture:
    """Draw a measure over the two fields of a study: colours and contours, what `run` would refuse hatched.

    Parameters
    ----------
    study
        A grid over two fields.
    measure
        Its name.
    """
    down, across = study.fields[1], study.fields[0]
    found = study.grid(measure, over=(down.name, across.name))
    column = study.column(measure)
    x, y, z = _places(across), _places(down), found.values
    known = z[np.isfinite(z)]
    said = _said(study, measure, f"{column.heading} over {across.name} and {down.name}")
    smooth = not _text(across) and not _text(down) and min(x.size, y.size) >= 3
    with _canvas(4.9, 3.9) as canvas:
        axes = canvas.figure.add_subplot()
        _axis(axes, across, "x")
        _axis(axes, down, "y")
        if known.size:
            log = _wide(known)
            levels = _levels(known, log=log)
            shared: dict[str, Any] = {"cmap": HEIGHTS, "norm": "log" if log else None}
            if smooth and levels.size > 1:
                ends = np.r_[min(levels[0], known.min()), levels, max(levels[-1], known.max())]
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
        _hatch(axes, x, y, found.ok, np.isfinite(z))
        mine = _own(across), _own(down)
        limits = axes.get_xlim(), axes.get_ylim()
        if mine[0] is not None and mine[1] is not None and _within(mine[0], limits[0]) and _within(mine[1], limits[1]):
            axes.plot(mine[0], mine[1], "o", color=PAPER, markeredgecolor=INK, markersize=7, clip_on=False, zorder=5)
            said += " The dot is the job itself."
        axes.set(xlim=limits[0], ylim=limits[1])
    if not found.ok.all():
        said += " Hatched: what run would refuse, or what gives no number."
    return Picture(canvas.svg, said)


def profiles_of(study: Study, measure: str) -> Picture:
    """Draw profiles through a map: a measure over the first field, at some values of the second.

    Parameters
    ----------
    study
        A grid over two fields.
    measure
        Its name.
    """
    across, along = study.fields
    found = study.grid(measure, over=(along.name, across.name))
    column, x = study.column(measure), _places(across)
    picks = np.unique(np.linspace(0, found.rows.size - 1, min(found.rows.size, len(SERIES))).round().astype(int))
    with _canvas(4.6, 3.9) as canvas:
        axes = canvas.figure.add_subplot()
        for pick, colour, line in zip(picks, SERIES, ("-", "--", "-."), strict=False):
            value = found.rows[pick]
            label = f"{_short(value) if not _text(along) else value} {along.unit}".rstrip()
            good = found.ok[pick]
            axes.plot(x, found.values[pick], line, color=colour, linewidth=1.3, label=label)
            axes.plot(x[good], found.values[pick][good], "o", color=colour, markersize=3.2)
            axes.plot(x[~good], found.values[pick][~good], "x", color=INK, markersize=5)
        if _wide(found.values[picks]):
            _logarithmic(axes, "y")
        axes.set_ylabel(column.heading)
        axes.grid(visible=True)
        _axis(axes, across, "x")
        axes.legend(title=along.name, ncols=len(picks), loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=2.4)
    said = f"{column.heading} over {across.name} at {len(picks)} values of {along.name}."
    return Picture(canvas.svg, said + ("" if found.ok[picks].all() else " Crosses: what run would refuse."))


def _within(value: float, limits: tuple[float, float]) -> bool:
    return bool(min(limits) <= value <= max(limits))


def _levels(known: Floats, *, log: bool) -> Floats:
    """Return round values for contours."""
    low, high = float(known.min()), float(known.max())
    if not high > low * (1 + 1e-9) + 1e-300:
        return np.array([low])
    if log:
        decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
        subs = (1.0, 2.0, 5.0) if high < 2e3 * low else (1.0, 3.0) if high < 1e5 * low else (1.0,)
        found = np.array([sub * 10.0**decade for decade in decades for sub in subs])
    else:
        found = np.asarray(MaxNLocator(LEVELS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    return np.asarray(found[(found > low) & (found < high)], dtype=np.float64)


def _short(value: float) -> str:
    return f"{value:.6g}"


def _edges(places: Floats) -> Floats:
    """Return the borders of cells about some places."""
    if places.size == 1:
        return np.array([places[0] - 0.5, places[0] + 0.5])
    middle = (places[1:] + places[:-1]) / 2
    return np.concatenate([[2 * places[0] - middle[0]], middle, [2 * places[-1] - middle[-1]]])


def _hatch(axes: Axes, x: Floats, y: Floats, ok: Bools, known: Bools) -> None:
    """Hatch the cells of cases that would be refused, and cross those that give no number."""
    if ok.all():
        return
    wide, high = _edges(x), _edges(y)
    left, right = x.min(), x.max()
    bottom, top = y.min(), y.max()
    from matplotlib.patches import Rectangle  # noqa: PLC0415 - for cells that would be refused

    inset = (left, right, bottom, top) if x.size > 1 and y.size > 1 and not _outside(axes, wide, high) else None
    for row, column in zip(*np.nonzero(~ok), strict=True):
        x0, x1, y0, y1 = wide[column], wide[column + 1], high[row], high[row + 1]
        if inset is not None:
            x0, x1 = np.clip((x0, x1), inset[0], inset[1])
            y0, y1 = np.clip((y0, y1), inset[2], inset[3])
        style = "////" if known[row, column] else "xxxx"
        place: Any = (x0, y0), x1 - x0, y1 - y0
        axes.add_patch(Rectangle(*place, facecolor=PAPER, linewidth=0.0, alpha=0.45, zorder=3))
        axes.add_patch(Rectangle(*place, fill=False, hatch=style, edgecolor=INK, linewidth=0.0, alpha=0.6, zorder=3))


def _outside(axes: Axes, wide: Floats, high: Floats) -> bool:
    """Say whether the axes reach as far as the cells do, as they do where cells are drawn."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    return bool(min(x0, x1) <= wide.min() + 1e-12 and max(y0, y1) >= high.max() - 1e-12)


def line_over(study: Study, measure: str) -> Picture:
    """Draw a measure over the one field of a study.

    Parameters
    ----------
    study
        Over one field.
    measure
        Its name.
    """
    over, column = study.fields[0], study.column(measure)
    at = np.searchsorted(over.different, over.values).astype(np.float64) if _text(over) else over.values
    order = np.argsort(at, kind="stable")
    good = study.ok[order]
    with _canvas(4.6, 2.9) as canvas:
        axes = canvas.figure.add_subplot()
        axes.plot(at[order], column.values[order], "-", color=SERIES[0], linewidth=1.3)
        axes.plot(at[order][good], column.values[order][good], "o", color=SERIES[0], markersize=3.6)
        axes.plot(at[order][~good], column.values[order][~good], "x", color=INK, markersize=6)
        if _wide(column.values):
            _logarithmic(axes, "y")
        axes.set_ylabel(column.heading)
        axes.grid(visible=True)
        _axis(axes, over, "x")
        mine = _own(over)
        if mine is not None and at.min() <= mine <= at.max():
            axes.axvline(mine, color=SERIES[1], linestyle="--", linewidth=1.0)
    said = _said(study, measure, f"{column.heading} over {over.name}")
    said += " The dashed line is the job itself." if mine is not None else ""
    return Picture(canvas.svg, said + ("" if study.ok.all() else " Crosses: what run would refuse."))


def scatter(study: Study, measures: Sequence[str]) -> Picture:
    """Draw every measure against every field, with the median over tenths of the cases.

    Parameters
    ----------
    study
        Over any number of fields.
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
                at = np.searchsorted(over.different, over.values).astype(float) if _text(over) else over.values
                good = study.ok & np.isfinite(column.values)
                bad = ~study.ok & np.isfinite(column.values)
                axes.plot(at[good], column.values[good], ".", color=SERIES[0], markersize=3.5, alpha=0.55)
                axes.plot(at[bad], column.values[bad], "x", color=INK, markersize=3.5, alpha=0.6)
                middles, medians = _medians(at[good], column.values[good])
                axes.plot(middles, medians, "-", color=SERIES[1], linewidth=1.6)
                if _wide(column.values):
                    _logarithmic(axes, "y")
                mine = _own(over)
                if mine is not None and at.min() <= mine <= at.max():
                    axes.axvline(mine, color=SERIES[1], linestyle="--", linewidth=1.0)
                axes.grid(visible=True)
                if row == len(measures) - 1:
                    _axis(axes, over, "x")
                    axes.set_xlabel(over.heading.replace(" [", "\n["), fontsize=7.5)
                if number == 0:
                    axes.set_ylabel(column.heading)
    said = f"Every measure against every field, {int(study.ok.sum())} cases, with the median of neighbours as a line."
    said += " The dashed lines are the job itself." if any(_own(one) is not None for one in study.fields) else ""
    return Picture(canvas.svg, said + ("" if study.ok.all() else " Crosses: what run would refuse."))


def _medians(at: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the medians of neighbouring cases: of those at the same place, or of tenths."""
    different = np.unique(at)
    if 1 < different.size <= 20 and different.size < at.size:
        return different, np.array([np.median(values[at == one]) for one in different])
    order = np.argsort(at, kind="stable")
    parts = [part for part in np.array_split(order, 10) if part.size]
    return np.array([at[part].mean() for part in parts]), np.array([np.median(values[part]) for part in parts])


def _said(study: Study, measure: str, what: str) -> str:
    values = study.column(measure).values
    known = values[np.isfinite(values)]
    if not known.size:
        return f"{what}: no case gives a number."
    return f"{what}: from {known.min():.4g} to {known.max():.4g}."
