"""Printing of figures as SVG, for which matplotlib alone takes twice as long.

It keeps five artists for each tick, and measures and draws each on its own. It packs rasters at a slow level.
"""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Bbox, IdentityTransform
from PIL import Image

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

    from turnwright._arrays import Floats

__all__ = ["print_svg"]

ALIGNED = {
    "bottom": {"ha": "center", "va": "top"},
    "left": {"ha": "right", "va": "center_baseline"},
    "right": {"ha": "left", "va": "center_baseline"},
}
"""How the labels of ticks are aligned at each side of the axes."""

PNG_LEVEL = 1

STYLE: Any = mpl.rcParams

VIEW_TOL = 1e-6
"""Distance outside the ends of an axis at which a tick is still drawn. [pixel]"""


def print_svg(figure: Figure) -> str:
    """Lay out a figure, and return it as SVG; its axes are replaced by scales."""
    for axes in figure.axes:
        if axes.name == "rectilinear":
            _Scale(axes.xaxis)
            _Scale(axes.yaxis)
            for side in ("left", "right", "bottom", "top"):
                axes.spines[side].set_in_layout(False)  # they are where the axes end
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)  # before the resolution is reduced, for lengths of text are measured in whole pixels
        figure.set_layout_engine("none")
    dpi, (width, height) = figure.dpi, figure.get_size_inches()
    figure.dpi = 72  # the unit of SVG is the point
    text = io.StringIO()
    metadata = {"Date": None, "Creator": None}
    vector = _Renderer(72 * width, 72 * height, text, image_dpi=dpi, metadata=metadata)  # type: ignore[no-untyped-call]
    renderer: Any = MixedModeRenderer(figure, width, height, dpi, vector)  # type: ignore[no-untyped-call]
    figure.draw(renderer)
    renderer.finalize()
    return text.getvalue()


class _Renderer(RendererSVG):
    """Writes SVG whose rasters are packed in a third of the time of matplotlib's, and as small."""

    def draw_image(self, gc: Any, x: float, y: float, im: Any, transform: Any = None) -> None:  # noqa: ARG002
        """Write a raster, upwards from a point; it lies within its axes."""
        height, width = (72 * pixels / self.image_dpi for pixels in im.shape[:2])
        picture = io.BytesIO()
        Image.fromarray(im[::-1]).save(picture, format="png", compress_level=PNG_LEVEL)
        data = "data:image/png;base64," + base64.b64encode(picture.getvalue()).decode()
        place = {"x": x, "y": self.height - y - height, "width": width, "height": height}
        attributes = {name: f"{value:.6f}".rstrip("0").rstrip(".") for name, value in place.items()}
        self.writer.element("image", attrib={"xlink:href": data, **attributes})  # type: ignore[no-untyped-call]


class _Scale(Artist):
    """Draws a straight axis in its place, on the side of its label; ticks point outwards, their labels are level.

    Locators, formatters, limits, labels and tick parameters stay those of the axis.
    """

    def __init__(self, axis: Any) -> None:
        super().__init__()
        self.axis, self.name, self.side = axis, f"{axis.axis_name}tick", axis.get_label_position()
        self.along, self.end = int(axis.axis_name == "y"), int(self.side == "right")
        self.outwards = 2 * self.end - 1
        # One text is each label of the ticks in turn.
        self.tick_label = Text(fontsize=STYLE[f"{self.name}.labelsize"], color=STYLE[f"{self.name}.labelcolor"])
        self.tick_label.set(transform=IdentityTransform(), **ALIGNED[self.side])
        self.tick_label.set_figure(axis.axes.figure)
        self.boxes: dict[tuple[Text, str], Floats] = {}
        self.set_zorder(axis.get_zorder())
        axis.set_visible(False)
        axis.axes.add_artist(self)
        self.set_clip_on(False)

    def get_tightbbox(self, renderer: Any = None) -> Bbox:
        """Return the box around the axes and the texts; the label of the axis counts as if it had no length."""
        boxes: list[Any] = [self.axis.axes.bbox]
        for text in self._texts(renderer):
            ends = self._box(text, renderer).get_points()
            if text is self.axis.label:
                ends[:, self.along] = ends[:, self.along].mean()
            boxes.append(Bbox(ends))
        return Bbox.union(boxes)

    def _box(self, text: Text, renderer: Any) -> Bbox:
        """Return the box around a text, of which each is measured once."""
        dpi, place = self.axis.axes.figure.dpi, text.get_transform().transform(text.get_position())
        if (key := (text, text.get_text())) not in self.boxes:
            self.boxes[key] = (text.get_window_extent(renderer).get_points() - place) / dpi
        return Bbox(place + self.boxes[key] * dpi)

    def draw(self, renderer: Any) -> None:
        """Draw the grid and the ticks as one path each, then the texts."""
        edges = self._edges(1 - self.along)
        for group in ("major", "minor"):
            at, _ = self._ticks(group)
            params = self.axis.get_tick_params(group)
            if params.get("gridOn"):
                self._draw_lines(renderer, at, edges, "grid", "grid.linewidth", STYLE["grid.alpha"])
            if params.get(self.side) and (length := self._length(group)):
                edge = edges[self.end]
                ends = edge, edge + self.outwards * length
                self._draw_lines(renderer, at, ends, self.name, f"{self.name}.{group}.width")
        for text in self._texts(renderer):
            text.draw(renderer)

    def _edges(self, along: int) -> Floats:
        """Return the ends of the axes along x or y. (2,) [pixel]."""
        return np.asarray(self.axis.axes.bbox.get_points()[:, along])

    def _length(self, group: str) -> float:
        """Return the length of ticks. [pixel]."""
        return self._pixels(self.axis.get_tick_params(group).get("length", STYLE[f"{self.name}.{group}.size"]))

    def _pixels(self, points: float) -> float:
        return float(points * self.axis.axes.figure.dpi / 72)

    def _ticks(self, group: str) -> tuple[Floats, Sequence[str]]:
        """Return the positions of ticks along the axis [pixel] and their labels, for those within its ends."""
        places = np.asarray(self.axis.get_ticklocs(minor=group == "minor"), dtype=np.float64)
        if not places.size:
            return places, []
        formatter = self.axis.get_major_formatter() if group == "major" else self.axis.get_minor_formatter()
        labels = formatter.format_ticks(places)
        points = np.zeros((len(places), 2))
        points[:, self.along] = places
        transform = getattr(self.axis.axes, f"get_{self.axis.axis_name}axis_transform")()
        at = transform.transform(points)[:, self.along]
        low, high = self._edges(self.along)
        shown = np.flatnonzero((at >= low - VIEW_TOL) & (at <= high + VIEW_TOL))
        return at[shown], [labels[number] for number in shown]

    def _texts(self, renderer: Any) -> Iterator[Text]:
        """Yield the labels of the ticks, the offset and the label of the axis, each in its place."""
        across = 1 - self.along
        edge = self._edges(across)[self.end]
        ends = [edge + self.outwards * self._length("major")]  # of what the label of the axis keeps clear of
        for group in ("major", "minor"):
            if not self.axis.get_tick_params(group).get(f"label{self.side}"):
                continue
            pad = self._pixels(STYLE[f"{self.name}.{group}.pad"])
            place = edge + self.outwards * (self._length(group) + pad)
            for at, label in zip(*self._ticks(group), strict=True):
                if label:
                    self.tick_label.set_text(label)
                    self.tick_label.set_position((place, at) if self.along else (at, place))
                    ends.append(self._box(self.tick_label, renderer).get_points()[self.end, across])
                    yield self.tick_label
        far = self.outwards * max(self.outwards * one for one in ends)
        offset = self.axis.get_offset_text()
        offset.set_text(self.axis.get_major_formatter().get_offset())
        pad = self._pixels(self.axis.OFFSETTEXTPAD)
        axes = self.axis.axes
        top = axes.spines.get("outline", axes).get_window_extent().y1  # a colour bar may end in arrows
        self._move(offset, 1, top + pad if self.along else far - pad)
        self._move(self.axis.label, across, far + self.outwards * self._pixels(self.axis.labelpad))
        for text in (offset, self.axis.label):
            if text.get_visible() and text.get_text():
                yield text

    @staticmethod
    def _move(text: Text, coordinate: int, to: float) -> None:
        x, y = text.get_position()
        text.set_position((x, to) if coordinate else (to, y))

    def _draw_lines(
        self, renderer: Any, at: Floats, ends: Sequence[float] | Floats, name: str, width: str, alpha: float = 1.0
    ) -> None:
        """Draw lines across the axis at positions along it."""
        points = np.empty((at.size, 2, 2))
        points[..., self.along] = at[:, np.newaxis]
        points[..., 1 - self.along] = ends
        pen = renderer.new_gc()
        pen.set_foreground(STYLE[f"{name}.color"])
        pen.set_alpha(alpha)
        pen.set_linewidth(renderer.points_to_pixels(STYLE[width]))
        path = Path(points.reshape(-1, 2), np.tile([Path.MOVETO, Path.LINETO], at.size))
        renderer.draw_path(pen, path, IdentityTransform())
        pen.restore()
