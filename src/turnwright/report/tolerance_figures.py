"""Pictures of a tolerance study: distributions and sensitivities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.report.figures import INK, LINE, SERIES, Picture, _canvas

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from turnwright._arrays import Floats
    from turnwright.studies import Sensitivity

__all__ = ["histogram", "tornado"]

MAX_BINS = 40
MAX_GROUPS = 12
"""Groups shown in the picture; the table has all of them."""


def histogram(values: Mapping[str, Floats], label: str, limit: float | None) -> Picture:
    """Draw the histograms of a measure, as planned and corrected, with its tolerance."""
    every = np.concatenate(list(values.values()))
    low, high = float(every.min()), float(np.quantile(every, 0.995))
    if limit is not None and limit < 3 * high:
        low, high = min(low, limit), max(high, limit)
    pad = 0.03 * (high - low) or 0.05 * abs(high) or 1.0
    bins: Any = np.linspace(low - pad, high + pad, min(MAX_BINS, max(10, round(2 * np.sqrt(every.size)))) + 1)
    with _canvas(4.6, 3.1) as canvas:
        axes = canvas.figure.add_subplot()
        for colour, (name, one) in zip(SERIES, values.items(), strict=False):
            axes.hist(np.clip(one, bins[0], bins[-1]), bins=bins, color=colour, alpha=0.35)
            axes.hist(np.clip(one, bins[0], bins[-1]), bins=bins, histtype="step", color=colour, label=name)
        if limit is not None and limit <= bins[-1]:
            axes.axvline(limit, color=INK, linestyle="--", linewidth=1.0, label=f"tolerance {limit:.4g} nm")
        axes.set(xlabel=f"{label} [nm]", ylabel="parts")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        axes.grid(visible=True, axis="y")
        axes.set_axisbelow(True)
    shown = "; ".join(f"{name}, median {np.median(one):.3g} nm" for name, one in values.items())
    beyond = (
        "" if limit is None or limit <= bins[-1] else f" The tolerance of {limit:.4g} nm is outside the range shown."
    )
    more = f" The last bar includes all values above {bins[-1]:.3g} nm." if every.max() > bins[-1] else ""
    return Picture(canvas.svg, f"Histogram of {label}: {shown}.{beyond}{more}")


def tornado(sensitivities: Sequence[Sensitivity], title: str) -> Picture:
    """Draw the first-order and total sensitivity of form error PV to each group of errors."""
    shown = sensitivities[:MAX_GROUPS]
    rows = np.arange(len(shown))
    with _canvas(4.6, max(1.6, 0.75 + 0.27 * len(shown))) as canvas:
        axes = canvas.figure.add_subplot()
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
        axes.set(xlabel="fraction of the variance of form error PV")
        axes.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=2)
        axes.grid(visible=True, axis="x")
        axes.set_axisbelow(True)
    best = ", ".join(f"{one.group} {max(value, 0.0):.0%}" for one, value in list(zip(shown, totals, strict=True))[:3])
    return Picture(
        canvas.svg, f"Sensitivities of the form error, {title}: {best}. Lines are 95 % confidence intervals."
    )
