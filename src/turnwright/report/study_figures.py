"""Pictures of studies: lines, maps and scatter plots over fields; distributions and sensitivities to set-up errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.report.figures import HEIGHTS, INK, LINE, PAPER, SERIES, _bar, _canvas, _legend_above
from turnwright.report.page import Picture

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from turnwright._arrays import Bools, Floats
    from turnwright.studies import Column, Sensitivity, Study

__all__ = ["draw_line", "draw_map", "histogram", "profiles_of", "scatter", "tornado"]

MIN_LOG_RATIO = 30.0
"""Ratio of largest to smallest value above which a logarithmic scale is used."""

MAX_CONTOURS = 9

MAX_BINS = 40

MAX_GROUPS = 12
"""Groups of errors shown in the picture; the table has all of them."""

REFUSED_TEXT = " Crosses: cases that a run would refuse."

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


def _positions(column: Column) -> Floats:
    """Return the axis positions of the field values of all cases."""
    places = np.searchsorted(column.different, column.values) if _is_text(column) else column.values
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
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: PLC0415 - costly to import

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


def draw_map(study: Study, measure: str) -> Picture:
    """Draw a map of a measure over the two fields of a grid; cases that `run` would refuse are hatched."""
    vertical, horizontal = study.fields[1], study.fields[0]
    grid = study.grid(measure, over=(vertical.name, horizontal.name))
    column = study.column(measure)
    x, y, z = _places(horizontal), _places(vertical), grid.values
    finite = z[np.isfinite(z)]
    caption = _describe_range(study, measure, f"{column.heading} over {horizontal.name} and {vertical.name}")
    caption += " Close contours mean a strong dependence."
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
        limits = axes.get_xlim(), axes.get_ylim()
        stated = (_job_value(field) for field in (horizontal, vertical))
        job_place = [at for at in stated if at is not None]
        if len(job_place) == 2 and all(
            min(ends) <= at <= max(ends) for at, ends in zip(job_place, limits, strict=True)
        ):
            dot: dict[str, Any] = {"color": PAPER, "markeredgecolor": INK, "markersize": 7}
            axes.plot(*[[at] for at in job_place], "o", clip_on=False, zorder=5, **dot)
            caption += " The dot marks the job."
        axes.set(xlim=limits[0], ylim=limits[1])
    if not grid.ok.all():
        caption += " Hatched: cases that a run would refuse, or without a value."
    return Picture(canvas.svg, caption)


def profiles_of(study: Study, measure: str) -> Picture:
    """Draw a measure over the first field of a grid at some values of the second."""
    across, along = study.fields
    grid = study.grid(measure, over=(along.name, across.name))
    column, x = study.column(measure), _places(across)
    picks = np.unique(np.linspace(0, grid.rows.size - 1, min(grid.rows.size, len(SERIES))).round().astype(int))
    with _canvas(4.6, 3.9) as canvas:
        axes = canvas.chart("", column.heading, tight=False)
        for pick, colour, line in zip(picks, SERIES, ("-", "--", "-."), strict=False):
            value = grid.rows[pick]
            label = f"{_short(value) if not _is_text(along) else value} {along.unit}".rstrip()
            _curve(axes, x, grid.values[pick], grid.ok[pick], colour=colour, line=line, label=label)
        if _needs_log_scale(grid.values[picks]):
            _logarithmic(axes, "y")
        _axis(axes, across, "x")
        _legend_above(axes, len(picks), title=along.name, handlelength=2.4)
    caption = (
        f"{column.heading} over {across.name} at {len(picks)} values of {along.name}: where the lines run in parallel, "
        "the two act independently."
    )
    return Picture(canvas.svg, caption + ("" if grid.ok[picks].all() else REFUSED_TEXT))


def _curve(axes: Axes, x: Floats, y: Floats, ok: Bools, *, colour: str, line: str = "-", label: str = "") -> None:
    """Draw a line through cases, with crosses at those that `run` would refuse."""
    axes.plot(x, y, line, color=colour, linewidth=1.3, label=label)
    axes.plot(x[ok], y[ok], "o", color=colour, markersize=3.2)
    axes.plot(x[~ok], y[~ok], "x", color=INK, markersize=5)


def _mark_job(axes: Axes, field: Column, at: Floats) -> None:
    """Draw a dashed line at the job's own value of a field, if it lies between the cases."""
    job_place = _job_value(field)
    if job_place is not None and at.min() <= job_place <= at.max():
        axes.axvline(job_place, color=SERIES[1], linestyle="--", linewidth=1.0)


def _levels(known: Floats, *, log: bool) -> Floats:
    """Return round contour levels."""
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415 - costly to import

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
    from matplotlib.patches import Rectangle  # noqa: PLC0415 - costly to import

    wide, high = _edges(x), _edges(y)
    if x.size > 1 and y.size > 1 and not _covers_cells(axes, wide, high):
        wide, high = np.clip(wide, x.min(), x.max()), np.clip(high, y.min(), y.max())
    for row, column in zip(*np.nonzero(~ok), strict=True):
        x0, x1, y0, y1 = wide[column], wide[column + 1], high[row], high[row + 1]
        style = "////" if known[row, column] else "xxxx"
        place: Any = (x0, y0), x1 - x0, y1 - y0
        axes.add_patch(Rectangle(*place, facecolor=PAPER, linewidth=0.0, alpha=0.45, zorder=3))
        axes.add_patch(Rectangle(*place, fill=False, hatch=style, edgecolor=INK, linewidth=0.0, alpha=0.6, zorder=3))


def _covers_cells(axes: Axes, wide: Floats, high: Floats) -> bool:
    """Whether the axes extend to the edges of the cells."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    return bool(min(x0, x1) <= wide.min() + 1e-12 and max(y0, y1) >= high.max() - 1e-12)


def draw_line(study: Study, measure: str) -> Picture:
    """Draw a measure over the only field of a study."""
    over, column = study.fields[0], study.column(measure)
    at = _positions(over)
    order = np.argsort(at, kind="stable")
    with _canvas(4.6, 2.9) as canvas:
        axes = canvas.chart("", column.heading, tight=False)
        _curve(axes, at[order], column.values[order], study.ok[order], colour=SERIES[0])
        if _needs_log_scale(column.values):
            _logarithmic(axes, "y")
        _axis(axes, over, "x")
        _mark_job(axes, over, at)
    caption = _describe_range(study, measure, f"{column.heading} over {over.name}")
    caption += " The dashed line marks the job." if _job_value(over) is not None else ""
    return Picture(canvas.svg, caption + ("" if study.ok.all() else REFUSED_TEXT))


def scatter(study: Study, measures: Sequence[str]) -> Picture:
    """Draw every measure against every field, with running medians."""
    width = len(study.fields)
    with _canvas(max(4.9, 2.3 * width), 0.7 + 1.9 * len(measures)) as canvas:
        panels = canvas.figure.subplots(len(measures), width, sharex="col", sharey="row", squeeze=False)
        for row, name in enumerate(measures):
            column = study.column(name)
            is_known = np.isfinite(column.values)
            good, bad = study.ok & is_known, ~study.ok & is_known
            for number, over in enumerate(study.fields):
                axes, at = panels[row, number], _positions(over)
                axes.plot(at[good], column.values[good], ".", color=SERIES[0], markersize=3.5, alpha=0.55)
                axes.plot(at[bad], column.values[bad], "x", color=INK, markersize=3.5, alpha=0.6)
                axes.plot(*_medians(at[good], column.values[good]), "-", color=SERIES[1], linewidth=1.6)
                if _needs_log_scale(column.values):
                    _logarithmic(axes, "y")
                _mark_job(axes, over, at)
                axes.grid(visible=True)
                if row == len(measures) - 1:
                    _axis(axes, over, "x")
                    axes.set_xlabel(over.heading.replace(" [", "\n["), fontsize=7.5)
                if number == 0:
                    axes.set_ylabel(column.heading)
    caption = (
        f"Every measure against every field, {int(study.ok.sum())} cases: a field matters where its running median "
        "rises or falls."
    )
    caption += " The dashed lines mark the job." if any(_job_value(one) is not None for one in study.fields) else ""
    return Picture(canvas.svg, caption + ("" if study.ok.all() else REFUSED_TEXT), span=6)


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


def histogram(values: Mapping[str, Floats], label: str, limit: float | None) -> Picture:
    """Draw the histograms of a measure, as planned and corrected, with its tolerance."""
    every = np.concatenate(list(values.values()))
    low, high = float(every.min()), float(np.quantile(every, 0.995))
    if limit is not None and limit < 3 * high:
        low, high = min(low, limit), max(high, limit)
    pad = 0.03 * (high - low) or 0.05 * abs(high) or 1.0
    bins: Any = np.linspace(low - pad, high + pad, min(MAX_BINS, max(10, round(2 * np.sqrt(every.size)))) + 1)
    with _canvas(4.6, 3.1) as canvas:
        axes = canvas.chart(f"{label} [nm]", "parts", tight=False)
        for colour, (name, one) in zip(SERIES, values.items(), strict=False):
            axes.hist(np.clip(one, bins[0], bins[-1]), bins=bins, color=colour, alpha=0.35)
            axes.hist(np.clip(one, bins[0], bins[-1]), bins=bins, histtype="step", color=colour, label=name)
        if limit is not None and limit <= bins[-1]:
            axes.axvline(limit, color=INK, linestyle="--", linewidth=1.0, label=f"tolerance {limit:.4g} nm")
        _legend_above(axes, 3)
        axes.grid(visible=False, axis="x")
    shown = "; ".join(f"{name}, median {np.median(one):.3g} nm" for name, one in values.items())
    goal = ""
    if limit is not None:
        goal = " Parts to the right of the tolerance miss it."
        if limit > bins[-1]:
            goal = f" The tolerance of {limit:.4g} nm is outside the range shown."
    more = f" The last bar includes all values above {bins[-1]:.3g} nm." if every.max() > bins[-1] else ""
    return Picture(canvas.svg, f"Histogram of {label}: {shown}.{goal}{more}")


def tornado(sensitivities: Sequence[Sensitivity], title: str) -> Picture:
    """Draw the first-order and total sensitivity of form error PV to each group of errors."""
    shown = sensitivities[:MAX_GROUPS]
    rows = np.arange(len(shown))
    with _canvas(4.6, max(1.6, 0.75 + 0.27 * len(shown))) as canvas:
        axes = canvas.chart("fraction of the variance of form error PV", "", tight=False)
        totals = [max((one.total.value if one.total else one.neighbour_index), 0.0) for one in shown]
        if shown[0].total is None:
            axes.barh(rows, totals, height=0.6, color=SERIES[0], label="first order, by neighbours")
        else:
            axes.barh(rows, totals, height=0.62, color=SERIES[1], alpha=0.45, label="total")
            firsts = [max(one.first.value, 0.0) if one.first else 0.0 for one in shown]
            axes.barh(rows, firsts, height=0.34, color=SERIES[0], label="first order")
            for row, one in zip(rows, shown, strict=True):
                if one.total is not None:
                    axes.plot([one.total.low, one.total.high], [row, row], color=INK, linewidth=0.9)
        axes.set_yticks(rows, [one.group for one in shown])
        axes.invert_yaxis()
        axes.set_xlim(0, max(1.0, *totals) * 1.02)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_color(LINE)
        _legend_above(axes, 2)
        axes.grid(visible=False, axis="y")
    best = ", ".join(f"{one.group} {max(value, 0.0):.0%}" for one, value in list(zip(shown, totals, strict=True))[:3])
    return Picture(
        canvas.svg,
        f"Sensitivities of the form error, {title}: {best}. Tighten the error with the longest bar first; lines are "
        "95 % confidence intervals.",
    )
