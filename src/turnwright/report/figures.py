"""Pictures of the report: vector axes around raster maps, in the colours of the page.

Every picture is an inline SVG whose ink, line and series colours are CSS variables, so one copy serves a light page, a
dark page and print. Data are thinned to some ten thousand points before plotting.

matplotlib is imported where it is used, since the figures of a run may be drawn by other processes.
"""

from __future__ import annotations

import io
import math
import re
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path as File
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from turnwright._io import write_atomic
from turnwright.metrology import area_rms
from turnwright.outline import Outline
from turnwright.profile import Profile
from turnwright.report.page import Figure, Picture

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from os import PathLike

    from matplotlib.axes import Axes

    from turnwright._arrays import Bools, Floats
    from turnwright.access import AccessFinding
    from turnwright.cutting import ChipMap, Experiment
    from turnwright.diagnosis import Move
    from turnwright.heightmap import HeightMap
    from turnwright.job import Candidate, Entry
    from turnwright.material import Material
    from turnwright.metrology import Lenslets, Spectrum
    from turnwright.optics import Modulation, PointSpread, Wavefront
    from turnwright.part import Part
    from turnwright.path import Motion, Path
    from turnwright.tool import Tool

__all__ = [
    "access_map",
    "approach_view",
    "axes_over_time",
    "breakdown_of",
    "chip_map",
    "contact",
    "density",
    "dislocation_map",
    "error_map",
    "minutes_and_errors",
    "modulation",
    "over_radius",
    "places_map",
    "point_spread",
    "profile",
    "rings",
    "sag_map",
    "spiral",
    "tool_moves",
    "view",
    "wavefront_map",
    "write_fit_picture",
    "write_picture",
    "z_over_turns",
]

TURN = 2 * math.pi
NM = 1e6

PIXELS = 480
"""Side of a map that is sampled from a function or a polar grid."""

MAX_PIXELS = 900
"""Longest side of a map that is drawn in full; longer ones are subsampled."""

GAP_TEXT = "0.1 mm"
"""Height above the material at which C begins to rotate."""

MIN_BOUNDED_FRACTION = 1e-3
"""Smallest fraction of the area that is outlined where a limit is exceeded."""

COLOUR_TEXT = "red is above the nominal surface, blue below, white is on it."

PATH_TEXT = "red where light is delayed, blue where it is early."

COLOUR_PERCENTILE = 99.9
"""Percentile of the absolute heights at which the colours of an error map saturate. [%]"""

INK, LINE, PAPER = "#010203", "#020304", "#030405"
SERIES = ("#040506", "#050607", "#060708")
VARIABLES = {INK: "ink", LINE: "line", PAPER: "panel", SERIES[0]: "one", SERIES[1]: "two", SERIES[2]: "three"}
"""Placeholder colours, and the CSS variables of the page that replace them."""

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "turnwright",
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": LINE,
    "axes.linewidth": 0.8,
    "xtick.color": LINE,
    "ytick.color": LINE,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "grid.color": LINE,
    "grid.linewidth": 0.5,
    "grid.alpha": 0.6,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.linewidth": 1.2,
    "legend.frameon": False,
}

PLAIN_STYLE = {key: value for key, value in STYLE.items() if not key.endswith(("color", "labelcolor"))}
PLAIN_STYLE |= {"figure.facecolor": "white", "savefig.facecolor": "white"}
"""Style of pictures in files of their own, in black on white."""

# A perceptually uniform map for heights, diverging maps for errors and angles; all are safe for colour-blind readers.
HEIGHTS, ERRORS, ANGLES = "viridis", "RdBu_r", "PuOr_r"


class _Canvas:
    """A figure, and its SVG once it is rendered."""

    def __init__(self, width: float, height: float, dpi: int) -> None:
        from matplotlib.figure import Figure  # noqa: PLC0415 - costly to import

        self.figure = Figure(figsize=(width, height), dpi=dpi, layout="compressed")
        self.svg = ""

    def chart(self, xlabel: str, ylabel: str, *, tight: bool = True) -> Axes:
        """Add axes with labels and a grid; ``tight`` without margins along x."""
        axes = self.figure.add_subplot()
        axes.set(xlabel=xlabel, ylabel=ylabel)
        axes.grid(visible=True)
        axes.set_axisbelow(True)
        if tight:
            axes.margins(x=0)
        return axes

    def write(self, file: File) -> None:
        """Write the figure in the format of the suffix, atomically."""
        kind = file.suffix.lower().removeprefix(".")
        picture = io.BytesIO()
        self.figure.savefig(picture, format=kind, metadata={"Date": None} if kind == "svg" else None)
        write_atomic(file, picture.getvalue())


def _styled(style: dict[Any, Any]) -> AbstractContextManager[None]:
    """Return a context in which figures have a style."""
    import matplotlib as mpl  # noqa: PLC0415 - costly to import

    return mpl.rc_context(style)


def _limit_ticks(axis: Any, **how: Any) -> None:
    """Place few ticks, at round values."""
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415

    axis.set_major_locator(MaxNLocator(**how))


@contextmanager
def _canvas(width: float = 4.6, height: float = 3.7, dpi: int = 130) -> Iterator[_Canvas]:
    """Yield a figure of a given size [in]; on exit its ``svg`` is set."""
    with _styled(STYLE):
        canvas = _Canvas(width, height, dpi)
        yield canvas
        canvas.svg = _print_svg(canvas)


def _print_svg(canvas: _Canvas) -> str:
    from turnwright.report.printing import print_svg  # noqa: PLC0415 - costly to import

    svg = print_svg(canvas.figure)
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' (?:id="[A-Za-z]+[\w.]*_\d+"|xmlns(?::\w+)?="[^"]*")', "", svg)
    for colour, variable in VARIABLES.items():
        svg = svg.replace(colour, f"var(--{variable})")
    return svg


def _length(extent: float) -> tuple[float, str]:
    """Return the factor and the display unit of a length in mm."""
    if extent >= 0.5:
        return 1.0, "mm"
    return (1e3, "µm") if extent >= 5e-4 else (1e6, "nm")


def _bar(canvas: _Canvas, axes: Axes, image: Any, label: str, extend: str = "neither") -> None:
    bar: Any = canvas.figure.colorbar(image, ax=axes, label=label, extend=extend, shrink=0.86, aspect=24)
    bar.outline.set_linewidth(0.6)
    bar.solids.set_rasterized(True)
    _limit_ticks(bar.ax.yaxis, nbins=6)


def _legend_above(axes: Axes, ncols: int, **how: Any) -> None:
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=ncols, **how)


def _hide_spines(axes: Axes, *sides: str) -> None:
    for side in sides:
        axes.spines[side].set_visible(False)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str, **how: Any) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.6, **how})


def _frame(border: Outline) -> tuple[float, float, float, float]:
    """Return the square around an outline: least and greatest x, least and greatest y. [mm]."""
    x_low, x_high, low, high = border.box
    half = max(x_high - x_low, high - low) / 2
    x, y = (x_low + x_high) / 2, (low + high) / 2
    return x - half, x + half, y - half, y + half


def _sides(border: Outline) -> tuple[Floats, Floats]:
    """Return the columns and rows of a square grid around an outline: x and y. Each (n,) [mm]."""
    x_low, x_high, low, high = _frame(border)
    return np.linspace(x_low, x_high, PIXELS), np.linspace(low, high, PIXELS)


def _square(border: Outline) -> tuple[Floats, Floats, Bools]:
    """Return x, y and the mask of the part on a square grid around it. Each (n, n) [mm]."""
    x, y = np.meshgrid(*_sides(border))
    return x, y, border.covers(x, y)


def _fill_image(values: Floats, on: Bools) -> Floats:
    """Return an array with the values where a mask is true and nan elsewhere."""
    square = np.full(on.shape, np.nan)
    square[on] = values
    return square


def _plan(axes: Axes, image: Floats, border: Outline, **how: Any) -> Any:
    """Draw a map of the whole part."""
    drawn = axes.imshow(image, origin="lower", extent=_frame(border), interpolation="nearest", **how)
    for x, y in border.curves(240):
        axes.plot(np.append(x, x[0]), np.append(y, y[0]), color=INK, linewidth=0.7)
    _hide_spines(axes, "top", "right")
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    return drawn


def _show_sag(part: Part) -> tuple[Outline, Floats]:
    """Return the border of a part, and the heights on a square around it, nan outside. (n, n) [mm]."""
    x, y, on = _square(part.border)
    return part.border, _fill_image(part.surface.sag(x[on], y[on]), on)


def _draw_sag(shown: tuple[Outline, Floats]) -> Picture:
    border, sag = shown
    factor, unit = _length(float(np.nanmax(sag) - np.nanmin(sag)))
    with _canvas() as canvas:
        axes = canvas.figure.add_subplot()
        image = _plan(axes, sag * factor, border, cmap=HEIGHTS)
        if np.nanmax(sag) > np.nanmin(sag):
            few = slice(None, None, 4)
            x, y = _sides(border)
            lines: dict[str, Any] = {"colors": "white", "linestyles": "solid", "linewidths": 0.5, "alpha": 0.55}
            axes.contour(x[few], y[few], sag[few, few] * factor, levels=9, **lines)
        _bar(canvas, axes, image, f"nominal height z [{unit}]")
    low, high = float(np.nanmin(sag)) * factor, float(np.nanmax(sag)) * factor
    extent = f"from {low:.4g} to {high:.4g} {unit}"
    return Picture(canvas.svg, f"Nominal height over the part, {extent}: check shape, sign and orientation.")


sag_map = Figure(_show_sag, _draw_sag)
"""Draw the nominal height map of a part."""


def _show_view(part: Part) -> tuple[Floats, Floats, Floats]:
    """Return points of the surface of a part: x, y, z. Each (n, m) [mm]."""
    if part.leaves_air:
        x_low, x_high, low, high = part.border.box
        x, y = np.meshgrid(np.linspace(x_low, x_high, 121), np.linspace(low, high, 121))
    else:
        radius, angle = np.meshgrid(np.linspace(part.nearest, part.reach, 91), np.linspace(0, TURN, 181))
        # The border of an annulus may be outside by rounding.
        radius = radius * (1 - 1e-12)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
    return x, y, part.heights(x, y)


def _draw_view(shown: tuple[Floats, Floats, Floats]) -> Picture:
    x, y, z = shown
    height = float(np.nanmax(z) - np.nanmin(z))
    factor, unit = _length(height)
    stretch = 0.7 * float(np.ptp(x)) / 2 / height if height > 0 else 1.0
    with _canvas(dpi=150) as canvas:
        canvas.figure.set_layout_engine("none")
        axes: Any = canvas.figure.add_axes((-0.06, -0.03, 1.04, 1.06), projection="3d")
        surface = axes.plot_surface(
            x, y, z * factor, cmap=HEIGHTS, rstride=1, cstride=1, linewidth=0, antialiased=False
        )
        surface.set_rasterized(True)
        axes.set_box_aspect((1, 1, 0.35), zoom=0.92)
        axes.view_init(elev=32, azim=-58)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_pane_color((0, 0, 0, 0))
            axis.line.set_color(LINE)
            axis._axinfo["grid"].update(color=LINE, linewidth=0.4)  # noqa: SLF001 - mplot3d offers no other way
            _limit_ticks(axis, nbins=4)
        axes.tick_params(pad=0)
        axes.set_xlabel("x [mm]", labelpad=0)
        axes.set_ylabel("y [mm]", labelpad=0)
        axes.set_zlabel(f"z [{unit}]", labelpad=2)
    return Picture(
        canvas.svg,
        f"Perspective view of the nominal surface, heights exaggerated about {stretch:.3g} times: check which regions "
        "are concave and which convex.",
    )


view = Figure(_show_view, _draw_view)
"""Draw the nominal surface of a part in perspective, heights exaggerated."""


class _AccessView(NamedTuple):
    border: Outline
    sweep: Floats  # contact angle on the tool nose, nan outside the part. (n, n) [rad]
    where: list[tuple[float, float] | None]


def _show_access(part: Part, findings: Sequence[AccessFinding]) -> _AccessView:
    x, y, on = _square(part.border)
    x, y = x[on], y[on]
    zx, zy = part.surface.gradient(x, y)
    sweep = np.arctan((x * zx + y * zy) / np.maximum(np.hypot(x, y), 1e-12))
    return _AccessView(part.border, _fill_image(sweep, on), [one.where for one in findings])


def _draw_access(shown: _AccessView) -> Picture:
    image = np.degrees(shown.sweep)
    limit = max(float(np.nanmax(np.abs(image))), 1e-6)
    with _canvas() as canvas:
        axes = canvas.figure.add_subplot()
        drawn = _plan(axes, image, shown.border, cmap=ANGLES, vmin=-limit, vmax=limit)
        places: dict[tuple[float, float], list[str]] = {}
        for number, point in enumerate(shown.where, 1):
            if point is not None:
                # Points closer than a marker share one.
                at = next((have for have in places if math.dist(have, point) < 0.09 * shown.border.reach), point)
                places.setdefault(at, []).append(str(number))
        for at, numbers in places.items():
            box = {"boxstyle": "round,pad=0.28", "facecolor": PAPER, "edgecolor": INK, "linewidth": 0.8}
            axes.text(*at, " ".join(numbers), ha="center", va="center", fontsize=7.5, bbox=box)
        _bar(canvas, axes, drawn, "contact angle on the tool nose [deg]")
    return Picture(
        canvas.svg,
        f"Contact angle on the tool nose over the part, within {limit:.3g} deg of the tip: the numbers of the table "
        "mark the points with the smallest margins.",
        span=2,
    )


access_map = Figure(_show_access, _draw_access)
"""Draw the contact angle on the tool nose, and number the critical points as in the access table."""


class _Approach(NamedTuple):
    """Radial section where a pass begins. [mm]."""

    name: str  # of the pass
    begins: tuple[float, float]  # X and Z of the tool where the pass begins
    top: float  # Z of the tool where the approach ends
    plunges: bool
    outward: bool
    width: float  # of what is shown next to the tool, about
    edge: tuple[Floats, Floats]  # u and e. Each (n,)
    radius: Floats  # distances from the axis, with the material before the pass and the finished surface. (m,)
    material: Floats  # (m,)
    finished: Floats  # (m,)


def _show_approach(name: str, entry: Entry, tool: Tool) -> _Approach:
    approach = entry.approach
    end = approach.start if approach.plunge is None else {k: float(v[-1]) for k, v in approach.plunge.axes.items()}
    depth = max(entry.depth or 0.0, 0.0)
    width = 2.2 * math.sqrt(2 * tool.actual_radius * max(depth, 0.02)) + 0.1
    u, _, e = tool.edge(np.linspace(-1.4, 1.4, 401))
    return _Approach(
        name, (end["X"], end["Z"]), approach.start["Z"], approach.plunge is not None, entry.outward, width, (u, e),
        entry.radius, entry.material, entry.finished,
    )  # fmt: skip


def _draw_approach(section: _Approach) -> Picture:
    (x, z), top, wide, (u, e) = section.begins, section.top, section.width, section.edge
    low, high = (x - wide, x + 1.6 * wide) if section.outward else (x - 1.6 * wide, x + wide)
    rim = section.radius[np.isfinite(section.finished)]
    if not section.plunges and rim.size:
        low = min(low, float(rim.max()) - 0.4 * wide)
    near = (section.radius >= low) & (section.radius <= high)
    radius, material, finished = section.radius[near], section.material[near], section.finished[near]
    heights = np.concatenate([material, finished, [z, top]])
    heights = heights[np.isfinite(heights)]
    span = float(np.ptp(heights))
    bottom, ceiling = float(heights.min()) - 0.35 * span, max(float(heights.max()), top) + 0.25 * span
    with _canvas(5.2, 4.2) as canvas:
        axes = canvas.figure.add_subplot()
        there = np.isfinite(material)
        axes.fill_between(
            radius, np.where(there, material, bottom), bottom, where=there, color=LINE, alpha=0.8, linewidth=0,
            label="material before the pass",
        )  # fmt: skip
        axes.plot(radius, finished, color=SERIES[1], linewidth=1.4, label="finished surface")
        for height, style, label in (
            (top, "--", "tool where the plunge begins"),
            (z, "-", "tool where the pass begins"),
        ):
            axes.plot(x + u, height + e, color=SERIES[0], linestyle=style, linewidth=1.2, label=label)
        down = top if section.plunges else z
        _arrow(axes, (x, ceiling), (x, down), INK, linewidth=0.9)
        if section.plunges:
            _arrow(axes, (x, top), (x, z), SERIES[2])
            axes.plot([], [], color=SERIES[2], linewidth=1.6, label="plunge, part rotating")
        _arrow(axes, (x, z), (x + (0.5 if section.outward else -0.5) * wide, z), SERIES[0])
        axes.set(xlim=(low, high), ylim=(bottom, ceiling), xlabel="distance from the axis [mm]", ylabel="z [mm]")
        axes.set_title(f"pass {section.name}")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, fontsize=7)
        axes.grid(visible=True)
    how = "plunges with the part rotating" if section.plunges else "begins clear of the material"
    return Picture(
        canvas.svg,
        f"Side view of the approach to pass {section.name}, which {how}: the dashed tool, where the plunge begins, "
        f"must be at least {GAP_TEXT} clear of the material.",
    )


approach_view = Figure(_show_approach, _draw_approach)
"""Draw the radial section where a pass begins: material before it, finished surface, tool and approach."""


def _turn_number(motion: Motion) -> Floats:
    return np.asarray(np.abs(motion.axes["C"] - motion.axes["C"][0]) / TURN)


def spiral(motion: Motion, turn: Motion, feed: float, border: Outline) -> Picture:
    """Draw the spiral in plan with the outline of the part, and an enlarged detail around a single revolution."""
    turns, x = _turn_number(motion), motion.axes["X"]
    count = float(turns[-1])
    every = max(1, math.ceil(count / 36))
    dense = np.linspace(0, TURN, 181)
    with _canvas(10.6, 4.2) as canvas:
        plan, zoom = canvas.figure.subplots(1, 2, width_ratios=(1, 1.25))
        for first in np.arange(0, count, every):
            at = first + dense / TURN
            at = at[at <= count]
            angle = motion.axes["C"][0] + motion.sense * at * TURN
            radius = np.interp(at, turns, x)
            plan.plot(radius * np.cos(angle), radius * np.sin(angle), color=SERIES[0], linewidth=0.5)
        for x_border, y_border in border.curves(240):
            plan.plot(np.append(x_border, x_border[0]), np.append(y_border, y_border[0]), color=INK, linewidth=0.9)
        plan.set_aspect("equal")
        plan.set(
            xlabel="x [mm]",
            ylabel="y [mm]",
            title=f"{count:.0f} revolutions" + (f", every {every}th drawn" if every > 1 else ""),
        )
        _hide_spines(plan, "top", "right")

        middle = turn.time.size // 2
        radius, azimuth = float(turn.axes["X"][middle]), float(turn.axes["C"][middle])
        spacing = abs(float(turn.axes["C"][middle] - turn.axes["C"][middle - 1])) * abs(radius) or feed
        reach, half = 6 * spacing, 4.5 * feed
        along = np.linspace(-reach, reach, 41)
        turn_number = abs(azimuth - motion.axes["C"][0]) / TURN
        factor, unit = _length(max(reach, half) / 4)
        for neighbour in range(-5, 6):
            at = turn_number + neighbour + motion.sense * along / max(abs(radius), 1e-12) / TURN
            shown = (at >= 0) & (at <= count)
            zoom.plot(
                (np.interp(at, turns, x)[shown] - radius) * 1e3, along[shown] * factor, color=SERIES[0], linewidth=0.9
            )
        arc = (turn.axes["C"] - azimuth) * radius
        near = np.abs(arc) <= reach
        zoom.plot((turn.axes["X"][near] - radius) * 1e3, arc[near] * factor, "o", color=SERIES[1], markersize=3.6)
        zoom.set(
            xlim=(-half * 1e3, half * 1e3), ylim=(-reach * factor, reach * factor), xlabel="radial [µm]",
            ylabel=f"tangential [{unit}]", title=f"revolutions at radius {abs(radius):.4g} mm, and points of one",
        )  # fmt: skip
        zoom.grid(visible=True)
    return Picture(
        canvas.svg,
        f"Plan view of the spiral of {count:.0f} revolutions, and a detail at radius {abs(radius):.4g} mm: compare the "
        f"point spacing of {spacing * 1e3:.3g} µm with the feed of {feed * 1e3:.4g} µm/rev.",
        span=6,
    )


def _band(axes: Axes, at: Floats, values: Floats, bins: int) -> None:
    """Draw the range of values in bins of a position."""
    edges = np.linspace(at.min(), at.max(), bins + 1)
    number = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bins - 1)
    low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
    np.minimum.at(low, number, values)
    np.maximum.at(high, number, values)
    filled = low <= high
    middle = (edges[1:] + edges[:-1])[filled] / 2
    axes.fill_between(
        middle, low[filled], high[filled], facecolor=SERIES[0], edgecolor=SERIES[0], linewidth=1.0, alpha=0.75
    )


def contact(path: Path) -> Picture:
    """Draw the range of the contact angle over the distance from the axis."""
    cuts = slice(None) if path.air_height is None else np.isnan(path.air_height)
    sweep = np.degrees(path.sweep[cuts])
    with _canvas(4.6, 2.9) as canvas:
        axes = canvas.chart("distance of the contact from the axis [mm]", "contact angle on the tool nose [deg]")
        axes.axhline(0, color=LINE, linewidth=0.8)
        _band(axes, np.hypot(path.contact_x[cuts], path.contact_y[cuts]), sweep, 200)
    return Picture(
        canvas.svg,
        f"Range of the contact angle on the tool nose over the distance from the axis, {sweep.min():.3g} to "
        f"{sweep.max():.3g} deg from the tip: it is the part of the nose that cuts and wears.",
    )


def chip_map(name: str, part: Part, chips: ChipMap, material: Material | None) -> Picture:
    """Draw the maximum uncut chip thickness over the part, with the critical contour."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - costly to import, and only chips need it

    inside = chips.inside
    factor, unit = _length(chips.thickest)
    thickness = chips.thickness[inside] * factor
    x, y, on = _square(part.border)
    _, nearest = cKDTree(np.column_stack((chips.x[inside], chips.y[inside]))).query(np.column_stack((x[on], y[on])))
    drawn = _fill_image(thickness[nearest], on)
    # Exclude the extremes at the axis and at the edge from the colour range.
    low, high = np.nanpercentile(drawn, (0.2, 99.8))
    caption = f"Maximum uncut chip thickness of pass {name}, up to {chips.thickest * factor:.3g} {unit}"
    with _canvas() as canvas:
        axes = canvas.figure.add_subplot()
        image = _plan(axes, drawn, part.border, cmap=HEIGHTS, vmin=low, vmax=high)
        if material is not None and material.critical is not None:
            limit = material.critical.at(rake=chips.rake, angle=chips.angle)[inside] * NM
            used = (chips.thickness[inside] * NM / limit)[nearest]
            beyond = float(np.mean(used > 1))
            critical = " to ".join(dict.fromkeys((f"{limit.min():.3g}", f"{limit.max():.3g}")))
            where = f"on {100 * beyond:.3g} % of the area" if beyond else "nowhere"
            caption += f"; the critical chip thickness is {critical} nm, exceeded {where}"
            if MIN_BOUNDED_FRACTION < beyond < 1 - MIN_BOUNDED_FRACTION:
                some = (slice(None, None, 4),) * 2
                line = _fill_image(used, on)[some]
                axes.contour(x[some], y[some], line, levels=[1.0], colors="white", linewidths=1.0)
                caption += " (white contour)"
        axes.plot(*chips.where, "o", color=INK, fillstyle="none", markersize=7, markeredgewidth=1.2, clip_on=False)
        axes.set(title=name)
        _bar(canvas, axes, image, f"uncut chip thickness [{unit}]", _colourbar_arrows(thickness, low, high))
    return Picture(canvas.svg, f"{caption}. The circle marks the maximum.")


def _colourbar_arrows(values: Floats, low: float, high: float) -> str:
    """Return which ends of a colour bar have an arrow."""
    below, above = bool((values < low).any()), bool((values > high).any())
    return "both" if below and above else "min" if below else "max" if above else "neither"


def z_over_turns(turns: Sequence[Motion]) -> Picture:
    """Draw the position and the speed of Z over single revolutions."""
    with _canvas(4.6, 3.9) as canvas:
        height, speed = canvas.figure.subplots(2, 1, sharex=True)
        # The fast tool servo moves on the slide.
        tips = [turn.axes["Z"] + turn.axes.get("W", 0.0) for turn in turns]
        name = "Z and W" if "W" in turns[0].axes else "Z"
        factor, unit = _length(max(float(np.ptp(tip)) for tip in tips))
        for turn, tip, colour, line in zip(turns, tips, SERIES, ("-", "--", "-."), strict=False):
            middle = float(tip.min() + tip.max()) / 2
            few = slice(None, None, max(1, math.ceil(turn.time.size / 1500)))
            angle = np.degrees(np.abs(turn.axes["C"] - turn.axes["C"][0]))
            label = f"r {abs(float(turn.axes['X'][turn.time.size // 2])):.3g} mm"
            height.plot(angle[few], (tip[few] - middle) * factor, line, color=colour, label=label)
            rate = np.gradient(tip, turn.time) if turn.time.size > 2 else np.zeros(turn.time.size)
            speed.plot(angle[few], rate[few], line, color=colour)
        height.set(ylabel=f"{name} about mid-stroke [{unit}]")
        _legend_above(height, 3, handlelength=2.4, columnspacing=1.2)
        speed.set(
            xlabel="spindle angle from the start of the revolution [deg]", ylabel=f"{name} speed [mm/s]", xlim=(0, 360)
        )
        _limit_ticks(speed.xaxis, steps=[1, 3, 6, 9])
        speed.set_xticks(np.arange(0, 361, 60))
        for axes in (height, speed):
            axes.grid(visible=True)
    return Picture(
        canvas.svg,
        f"Position and speed of {name} over one revolution at the edge, halfway and near the axis: look for steps in "
        "speed, which a servo cannot follow.",
    )


def axes_over_time(motion: Motion) -> Picture:
    """Draw the axis positions over time."""
    seconds = motion.time - motion.time[0]
    scale, unit = (1 / 60, "min") if seconds[-1] > 120 else (1.0, "s")
    letters = [letter for letter in motion.axes if letter != "C"]
    with _canvas(4.6, 1.9 + len(letters)) as canvas:
        panels = canvas.figure.subplots(len(letters), 1, sharex=True)
        for axes, letter in zip(panels, letters, strict=True):
            _band(axes, seconds * scale, motion.axes[letter], min(seconds.size, 400))
            axes.grid(visible=True)
            axes.margins(x=0)
            axes.set(ylabel=f"{letter} [mm]")
        panels[-1].set(xlabel=f"time [{unit}]")
    named = f"{', '.join(letters[:-1])} and {letters[-1]}"
    return Picture(
        canvas.svg,
        f"Range of {named} over the {seconds[-1] * scale:.4g} {unit} of the finishing pass: look for jumps and for "
        "unexpected strokes.",
    )


def _resampled(heights: HeightMap, border: Outline) -> Floats:
    """Resample a polar map to a square grid around an outline by nearest height. (n, n)."""
    assert heights.radius is not None  # noqa: S101 - the map is polar
    assert heights.angle is not None  # noqa: S101
    x, y, on = _square(border)
    column = np.searchsorted((heights.radius[1:] + heights.radius[:-1]) / 2, np.hypot(x, y))
    start = float(heights.angle[0])
    around = np.append(heights.angle, start + TURN)
    row = (
        np.searchsorted((around[1:] + around[:-1]) / 2, start + (np.arctan2(y, x) - start) % TURN) % heights.angle.size
    )
    return np.where(on, heights.z[row, column], np.nan)


class _MapView(NamedTuple):
    """What a figure of a map shows of its heights."""

    image: Floats  # heights in colours. [nm]
    colours: dict[str, Any]
    extend: str  # ends of their bar with an arrow
    border: Outline | None  # of a polar map, resampled to a square grid around it
    extent: Any = None  # of a grid
    places: tuple[Floats, Floats] | None = None  # of scattered points
    xlabel: str = ""
    ylabel: str = ""


def _view_of(heights: HeightMap, border: Outline | None = None) -> _MapView:
    """Return gridded or scattered heights, colours centred at zero."""
    colours, extend = _error_colours(heights.z * NM)
    if heights.radius is not None:
        border = border or Outline(disc=float(heights.radius[-1]))
        return _MapView(_resampled(heights, border) * NM, colours, extend, border)
    assert heights.x is not None  # noqa: S101 - a map that is not polar has x and y
    assert heights.y is not None  # noqa: S101
    x, y = heights.x, heights.y
    centre = (float(x.min() + x.max()) / 2, float(y.min() + y.max()) / 2)
    factor, unit = _length(float(max(np.ptp(x), np.ptp(y)))) if heights.calibrated else (1.0, "pixels")
    extent = places = None
    if heights.scattered:
        few = heights.thinned(PIXELS**2 // 8)
        across, along = few.points()
        image, places = few.z, ((across - centre[0]) * factor, (along - centre[1]) * factor)
    else:
        stride = math.ceil(max(heights.z.shape) / MAX_PIXELS)
        image = heights.z[::stride, ::stride]
        grown = [float(np.diff(axis[:2]).sum()) / 2 or 0.5 / factor for axis in (x, y)]
        extent = tuple(
            (end - middle) * factor
            for end, middle in (
                (x[0] - grown[0], centre[0]), (x[-1] + grown[0], centre[0]),
                (y[0] - grown[1], centre[1]), (y[-1] + grown[1], centre[1]),
            )
        )  # fmt: skip
    shift = " mm" if heights.calibrated else ""
    labels = [f"{name} from {round(at, 9) + 0.0:.6g}{shift} [{unit}]" for name, at in zip("xy", centre, strict=True)]
    return _MapView(image * NM, colours, extend, None, extent, places, *labels)


def _draw_map(canvas: _Canvas, view: _MapView, label: str) -> None:
    axes = canvas.figure.add_subplot()
    if view.border is not None:
        drawn = _plan(axes, view.image, view.border, **view.colours)
    else:
        if view.places is not None:
            drawn = axes.scatter(*view.places, c=view.image, s=2, rasterized=True, **view.colours)
            axes.set_aspect("equal")
        else:
            drawn = axes.imshow(
                view.image, origin="lower", extent=view.extent, interpolation="antialiased", **view.colours
            )
        axes.set(xlabel=view.xlabel, ylabel=view.ylabel)
    _bar(canvas, axes, drawn, label, view.extend)


def _error_colours(values: Floats) -> tuple[dict[str, Any], str]:
    """Return colours centred at zero for values in nm, and which ends of their bar have an arrow."""
    sizes = np.abs(values[np.isfinite(values)])
    limit = (float(np.percentile(sizes, COLOUR_PERCENTILE)) if sizes.size else 0.0) or 1e-3
    beyond = sizes.size and sizes.max() > limit * 1.001
    return {"cmap": ERRORS, "vmin": -limit, "vmax": limit}, "both" if beyond else "neither"


class _ErrorView(NamedTuple):
    view: _MapView
    text: str
    title: str


def _show_errors(
    heights: HeightMap, what: str = "Error (cut minus nominal)", *, title: str = "", border: Outline | None = None
) -> _ErrorView:
    finite = heights.z[np.isfinite(heights.z)] * NM
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    return _ErrorView(_view_of(heights, border), f"{what}, from {low:.4g} to {high:.4g} nm: {COLOUR_TEXT}", title)


def _draw_errors(shown: _ErrorView) -> Picture:
    with _canvas() as canvas:
        _draw_map(canvas, shown.view, "cut minus nominal [nm]")
    return Picture(canvas.svg, shown.text, shown.title)


error_map = Figure(_show_errors, _draw_errors)
"""Draw an error map, colours centred at zero; ``what`` begins the caption. A polar map may have a border."""


def write_fit_picture(experiment: Experiment, path: str | PathLike[str]) -> None:
    """Write a picture of measured and fitted cutting forces with their residuals."""
    fit, critical = experiment.learned.fit, experiment.learned.critical
    count, nm = len(fit.components), fit.thickness * NM
    with _styled(PLAIN_STYLE):
        canvas = _Canvas(4.2 * count, 5.6, 150)
        panels = canvas.figure.subplots(2, count, squeeze=False, sharex=True, height_ratios=(2, 1))
        for name, column, measured, fitted in zip(fit.components, panels.T, fit.measured.T, fit.fitted.T, strict=True):
            above, below = column
            above.plot(nm, measured * 1e3, ".", markersize=3, color="tab:blue", label="measured, without drift")
            above.plot(nm, fitted * 1e3, ".", markersize=2, color="k", label="fitted")
            below.plot(nm, (measured - fitted) * 1e3, ".", markersize=3, color="tab:blue")
            below.axhline(0, color="k", linewidth=0.8)
            above.set(title=name, ylabel="force [mN]")
            below.set(xlabel="maximum uncut chip thickness [nm]", ylabel="measured - fitted [mN]")
            if critical is not None:
                for axes in column:
                    low, high = critical.low * NM, critical.high * NM
                    axes.axvspan(low, high, color="tab:red", alpha=0.3, label="critical chip thickness")
            above.legend(fontsize=7)
        canvas.figure.suptitle(experiment.name)
        canvas.write(File(path))


def write_picture(shown: HeightMap | Profile, path: str | PathLike[str]) -> None:
    """Write a picture of a map or a profile as ``.png``, ``.svg`` or ``.pdf``, by the suffix of the file."""
    with _styled(PLAIN_STYLE):
        canvas = _Canvas(6.4, 3.2 if isinstance(shown, Profile) else 4.8, 160)
        if isinstance(shown, Profile):
            factor, unit = _length(float(np.ptp(shown.distance)))
            axes = canvas.chart(f"distance [{unit}]", "height [nm]")
            axes.plot(shown.distance * factor, shown.z * NM, linewidth=0.8)
        else:
            _draw_map(canvas, _view_of(shown), "height [nm]")
        canvas.write(File(path))


def places_map(
    heights: HeightMap, border: Outline, title: str, *, what: str = "", like: HeightMap | None = None
) -> Picture:
    """Draw scattered errors over the part as the mean in each pixel, colours centred at zero.

    The caption begins with ``what``, by default with the title. If the errors are the valid heights of the grid
    ``like``, the rms is weighted by area.
    """
    x, y = heights.points()
    z = heights.z * NM
    used = np.isfinite(z) & (border.distance(x, y) <= border.reach * 1e-9)
    x, y, z = x[used], y[used], z[used]
    # Pixels are no finer than the point spacing.
    side = int(np.clip(np.sqrt(max(z.size, 1)) * 0.8, 16, PIXELS))
    x_low, x_high, low, _ = _frame(border)
    column, row = (
        np.clip(((at - start) / (x_high - x_low) * side).astype(np.int64), 0, side - 1)
        for at, start in ((x, x_low), (y, low))
    )
    count = np.bincount(row * side + column, minlength=side * side)
    sums = np.bincount(row * side + column, weights=z, minlength=side * side)
    image = np.where(count > 0, sums / np.maximum(count, 1), np.nan).reshape(side, side)
    colours, extend = _error_colours(image)
    with _canvas() as canvas:
        axes = canvas.figure.add_subplot()
        _bar(canvas, axes, _plan(axes, image, border, **colours), "[nm]", extend)
    rms = area_rms(replace(heights, z=np.where(used, heights.z, np.nan)), like=like) * NM if z.size else 0.0
    low, high = (float(z.min()), float(z.max())) if z.size else (0.0, 0.0)
    extent = f"from {low:.4g} to {high:.4g} nm, {rms:.3g} nm rms"
    return Picture(canvas.svg, f"{what or title.capitalize()}, {extent}: {COLOUR_TEXT}", title)


def over_radius(heights: HeightMap, radius: float) -> Picture:
    """Draw the azimuthal mean of errors over the radius, with the 5th to 95th percentile."""
    x, y = heights.points()
    r, z = np.hypot(x, y), heights.z * NM
    used = np.isfinite(z) & (r <= radius)
    r, z = r[used], z[used]
    bins = int(np.clip(z.size / 200, 8, 120))
    number = np.minimum((r / radius * bins).astype(np.int64), bins - 1)
    order = np.argsort(number, kind="stable")
    groups = np.split(z[order], np.searchsorted(number[order], np.arange(1, bins)))
    filled = [k for k, group in enumerate(groups) if group.size]
    middle = (np.array(filled) + 0.5) / bins * radius
    mean, low, high = (
        np.array([function(groups[k]) for k in filled])
        for function in (np.mean, lambda group: np.percentile(group, 5), lambda group: np.percentile(group, 95))
    )
    return _draw_radial(middle, mean, (low, high), "5th to 95th percentile")._replace(title="around the axis")


def _show_rings(heights: HeightMap) -> tuple[Floats, ...]:
    """Return distances from the axis, with the mean and the ends of the range around it."""
    assert heights.radius is not None  # noqa: S101 - the map is polar
    filled = np.isfinite(heights.z).any(axis=0)
    radius, z = heights.radius[filled], heights.z[:, filled] * NM
    few = slice(None, None, max(1, math.ceil(radius.size / 600)))
    return (radius[few], *(end(z[:, few], axis=0) for end in (np.nanmean, np.nanmin, np.nanmax)))


def _draw_rings(shown: tuple[Floats, ...]) -> Picture:
    radius, mean, low, high = shown
    return _draw_radial(radius, mean, (low, high), "range")


rings = Figure(_show_rings, _draw_rings)
"""Draw the azimuthal mean and range of a polar error map over the radius."""


def _draw_radial(radius: Floats, mean: Floats, ends: tuple[Floats, Floats], band: str) -> Picture:
    """Draw an error over the distance from the axis: its mean around the axis, and a band."""
    with _canvas() as canvas:
        axes = canvas.chart("distance from the axis [mm]", "cut minus nominal [nm]")
        axes.axhline(0, color=LINE, linewidth=0.8)
        axes.fill_between(radius, *ends, color=SERIES[0], alpha=0.3, linewidth=0, label=f"azimuthal {band}")
        axes.plot(radius, mean, color=SERIES[0], label="azimuthal mean")
        _legend_above(axes, 2)
    return Picture(
        canvas.svg,
        f"Azimuthal mean and {band} of the error over the distance from the axis: a wide band means that the error "
        "varies with the spindle angle.",
    )


def tool_moves(moves: Sequence[Move]) -> Picture:
    """Draw the tool moves: X and Z seen from above, tool height seen along the spindle axis."""
    by: dict[str, float] = {move.axis: move.by for move in moves}
    largest = max(abs(one) for one in by.values())

    def arrow(axes: Axes, way: tuple[float, float], name: str) -> None:
        _arrow(axes, (0.0, 0.0), way, SERIES[1], arrowstyle="-|>", linewidth=2.0)
        offset = 0.18 * math.copysign(1.0, way[1] or 1.0)
        axes.text(way[0], way[1] + offset, f"{name} {by[name] * 1e3:+.3g} µm", ha="center", va="center")

    with _canvas(4.6, 2.6) as canvas:
        above, along = canvas.figure.subplots(1, 2)
        nose = np.linspace(-np.pi / 2, np.pi / 2, 61)
        above.plot(0.5 * np.sin(nose), 0.5 - 0.5 * np.cos(nose), color=INK, linewidth=1.0)
        above.axhline(0.0, color=LINE, linewidth=0.8)
        for name, way in (("X", (1.0, 0.0)), ("Z", (0.0, 1.0))):
            if name in by:
                size = 0.5 + 0.5 * abs(by[name]) / largest
                arrow(above, (way[0] * math.copysign(size, by[name]), way[1] * math.copysign(size, by[name])), name)
        above.set(title="from above")
        along.plot(np.cos(4 * nose), np.sin(4 * nose), color=LINE, linewidth=0.8)
        along.plot([0, 0.35], [0, 0], color=INK, linewidth=2.0)
        if "tool height" in by:
            arrow(along, (0.0, math.copysign(0.8, by["tool height"])), "tool height")
        along.set(title="along the spindle")
        for axes in (above, along):
            axes.set(xlim=(-1.9, 1.9), ylim=(-1.5, 1.5), aspect="equal", xticks=[], yticks=[])
            _hide_spines(axes, "top", "right", "bottom", "left")
    return Picture(
        canvas.svg,
        "Directions in which to move the tool: left from above, with X to the right and Z away from the part; right "
        "along the spindle, with the tool at +X and up the direction of increasing spindle angle under it.",
    )


class _Profile(NamedTuple):
    at: Floats  # [µm]
    error: Floats  # [nm]
    letter: str
    across: str
    where: float  # on the other axis [mm]
    feed: float


def _show_profile(heights: HeightMap, feed: float) -> _Profile:
    x, y = heights.x, heights.y
    assert x is not None  # noqa: S101 - the map is rectangular
    assert y is not None  # noqa: S101
    over_x = abs(x[0] + x[-1]) >= abs(y[0] + y[-1])
    along, other = (x, y) if over_x else (y, x)
    middle = other.size // 2
    z = (heights.z[middle] if over_x else heights.z[:, middle]) * NM
    at = (along - (along[0] + along[-1]) / 2) * 1e3
    shown = np.abs(at) <= 7500 * feed
    if np.count_nonzero(shown) < 20:
        shown = np.ones(at.shape, dtype=bool)
    few = slice(None, None, max(1, math.ceil(np.count_nonzero(shown) / 3000)))
    letter, across = ("x", "y") if over_x else ("y", "x")
    return _Profile(at[shown][few], z[shown][few], letter, across, float(other[middle]), feed)


def _draw_profile(one: _Profile) -> Picture:
    with _canvas() as canvas:
        xlabel = f"{one.letter} from the middle, at {one.across} = {one.where:.5g} mm [µm]"
        axes = canvas.chart(xlabel, "cut minus nominal [nm]")
        axes.axhline(0, color=LINE, linewidth=0.8)
        axes.plot(one.at, one.error, color=SERIES[0])
    return Picture(
        canvas.svg,
        f"Profile of the error along {one.letter}: cusps repeat every {one.feed * 1e3:.3g} µm, the feed; look for any "
        "other period.",
    )


profile = Figure(_show_profile, _draw_profile)
"""Draw a profile across the cusps through the middle of a rectangular map, made with a feed."""


def density(spectrum: Spectrum) -> Picture:
    """Draw a power spectral density over spatial frequency, both logarithmic."""
    positive = (spectrum.frequency > 0) & (spectrum.density > 0)
    with _canvas() as canvas:
        axes = canvas.chart("spatial frequency [1/mm]", f"power spectral density [{spectrum.unit}]")
        axes.loglog(spectrum.frequency[positive], spectrum.density[positive], color=SERIES[0])
    return Picture(
        canvas.svg,
        f"Power spectral density of the error up to {spectrum.frequency[-1]:.3g} per mm: peaks are periodic errors, "
        "such as cusps.",
        "Spectrum",
    )


def wavefront_map(light: Wavefront) -> Picture:
    """Draw a wavefront over the pupil, colours centred at zero."""
    with _canvas() as canvas:
        border = Outline(disc=light.radius, centre=light.centre) if light.opd.polar else None
        _draw_map(canvas, _view_of(light.opd, border), "optical path [nm]")
    return Picture(canvas.svg, f"Wavefront over the pupil, {light.rms * NM:.4g} nm rms: {PATH_TEXT}")


def point_spread(image: PointSpread, strehl: float, unit: str) -> Picture:
    """Draw the image of a point, logarithmic."""
    factor, name = _length(float(np.ptp(image.x))) if unit == "mm" else (1e6, "µrad")
    with _canvas() as canvas:
        axes = canvas.figure.add_subplot()
        x, y = image.x * factor, image.y * factor
        extent = (float(x[0]), float(x[-1]), float(y[0]), float(y[-1]))
        drawn = axes.imshow(
            np.log10(np.maximum(image.intensity, 1e-8)), origin="lower", extent=extent, cmap=HEIGHTS, vmin=-6, vmax=0
        )
        axes.set(xlabel=f"x [{name}]", ylabel=f"y [{name}]")
        _bar(canvas, axes, drawn, "log10 of the intensity", "min")
    return Picture(
        canvas.svg, f"Image of a point: its peak is {strehl:.4g} of that without errors (Strehl ratio), marks included."
    )


def modulation(transfer: Modulation, ideal: Modulation, unit: str) -> Picture:
    """Draw the modulation transfer along x and y, and that without errors."""
    scale = 1.0 if unit == "1/mm" else 1e-3
    with _canvas() as canvas:
        axes = canvas.chart(f"spatial frequency [{'1/mm' if unit == '1/mm' else '1/mrad'}]", "modulation")
        axes.plot(ideal.frequency * scale, ideal.x, color=LINE, label="without errors")
        axes.plot(transfer.frequency * scale, transfer.x, color=SERIES[0], label="along x")
        axes.plot(transfer.frequency * scale, transfer.y, "--", color=SERIES[1], label="along y")
        axes.set_ylim(0, 1.02)
        _legend_above(axes, 3)
    return Picture(canvas.svg, "Modulation transfer of form and marks together, and of a perfect surface.")


def _show_minutes(tried: Sequence[Candidate]) -> tuple[list[tuple[float, float]], str]:
    """Return minutes and errors, and the numbered names."""
    points = [(one.limits.cycle_time_s / 60, one.breakdown.pv_nm) for one in tried if one.limits and one.breakdown]
    return points, ", ".join(f"{number} {one.name}" for number, one in enumerate(tried, 1))


def _draw_minutes(shown: tuple[list[tuple[float, float]], str]) -> Picture:
    points, named = shown
    with _canvas() as canvas:
        axes = canvas.chart("minutes", "form error PV [nm]")
        # Pareto front: no other strategy is both faster and more accurate.
        best = sorted(p for p in points if not any(o != p and o[0] <= p[0] and o[1] <= p[1] for o in points))
        axes.plot(*zip(*best, strict=True), color=LINE, linewidth=0.8)
        gap = 0.04 * np.ptp(points, axis=0) + 1e-12
        labels: list[tuple[Any, Floats]] = []
        for number, (minutes, pv) in enumerate(points, 1):
            axes.plot(minutes, pv, "o", color=SERIES[0] if (minutes, pv) in best else LINE, markersize=5)
            # Overlapping points share the label of the first one.
            point = np.array([minutes, pv])
            near = next((label for label, other in labels if (np.abs(other - point) < gap).all()), None)
            if near is None:
                label = axes.annotate(str(number), (minutes, pv), (5, 4), textcoords="offset points")
                labels.append((label, point))
            else:
                near.set_text(f"{near.get_text()}, {number}")
        axes.margins(0.12)
    return Picture(
        canvas.svg,
        f"Form error over cutting time, {named}: the line (the Pareto front) joins the strategies that no other "
        "beats in both time and error.",
    )


minutes_and_errors = Figure(_show_minutes, _draw_minutes)
"""Draw form error PV over cutting time for each strategy."""


def _show_breakdown(tried: Sequence[Candidate]) -> dict[str, list[float]]:
    """Return the largest contributions of each source, by strategy."""
    sources = {"cusps": "cusp_nm", "chord": "chord_nm", "servos": "tracking_nm"}
    return {name: [getattr(one.breakdown, field) for one in tried] for name, field in sources.items()}


def _draw_breakdown(shown: dict[str, list[float]]) -> Picture:
    with _canvas() as canvas:
        axes = canvas.chart("largest contribution [nm]", "strategy", tight=False)
        rows = np.arange(len(shown["cusps"]))
        for k, ((error_source, sizes), colour) in enumerate(zip(shown.items(), SERIES, strict=True)):
            axes.barh(rows + (k - 1) * 0.26, sizes, height=0.24, color=colour, label=error_source)
        axes.set_yticks(rows, [str(number + 1) for number in rows])
        axes.invert_yaxis()
        _legend_above(axes, 3)
        axes.grid(visible=False, axis="y")
    return Picture(
        canvas.svg,
        "Error contributions of cusps, chord and servos for each strategy, numbered as in the table: the longest bar "
        "limits its accuracy.",
    )


breakdown_of = Figure(_show_breakdown, _draw_breakdown)
"""Draw the error contributions of each strategy."""


def dislocation_map(lenslets: Lenslets) -> Picture:
    """Draw the dislocations with their mean removed, and the residual after shift, rotation and scale.

    Each panel scales its arrows by its own root mean square, given in the title. A cross is a lenslet that could not
    be fitted.
    """
    design, is_measured = lenslets.design, lenslets.measured
    reach = float(np.ptp(design, axis=0).max()) or 1.0
    panels = [("mean removed", lenslets.centred)]
    if lenslets.alignment is not None:
        rotation, scale = lenslets.alignment.rotation * 1e6, lenslets.alignment.scale * 1e6
        panels.append((f"without rotation {rotation:.4g} µrad and scale {scale:.4g} ppm", lenslets.irregular))
    titles = []
    with _canvas(5.3 * len(panels), 4.6) as canvas:
        frames = np.atleast_1d(canvas.figure.subplots(1, len(panels)))
        for axes, (name, dislocation) in zip(frames, panels, strict=True):
            rms = float(np.sqrt(np.mean(np.sum(dislocation[is_measured] ** 2, axis=1)))) if is_measured.any() else 0.0
            length = 0.08 * reach / rms if rms > 0 else 0.0
            axes.plot(*design[is_measured].T, ".", color=LINE, markersize=3)
            axes.plot(*design[~is_measured].T, "x", color=SERIES[1], markersize=6)
            if length:
                axes.quiver(
                    *design[is_measured].T, *(dislocation[is_measured] * length).T,
                    angles="xy", scale_units="xy", scale=1, color=SERIES[0], width=0.004,
                )  # fmt: skip
            titles.append(f"{name}: {rms * 1e3:.3g} µm rms")
            axes.set_title(titles[-1], color=INK)
            axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
            axes.margins(0.12)
            _hide_spines(axes, "top", "right")
    lost = f"; {np.count_nonzero(~is_measured)} lenslets could not be fitted" if not is_measured.all() else ""
    return Picture(
        canvas.svg,
        f"Dislocations of {is_measured.size} lenslets from their nominal positions, {', '.join(titles)}{lost}: "
        "a common pattern of the arrows is an alignment error, the irregular rest is of single lenslets.",
        span=3 * len(panels),
    )
