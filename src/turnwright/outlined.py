"""A surface on an outline: continued outside it for the tool path, or bounded by it for measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.outline import Outline
from turnwright.surface import Surface

__all__ = ["OWN_BAND_MM", "Bounded", "Continued"]

OWN_BAND_MM = 5.0
"""Width of the band around the outline in which the surface is its own, where its prescription extends so far."""

BORDER_OFFSET_MM = 1e-7
"""Distance inside the border of the points from which the surface is continued, so that rounding keeps them inside."""

LEVELLING_MM = 20.0
"""Distance over which the slope of the continuation falls by a factor e, so that it is level far out."""

DIFFERENCE_STEP_MM = 1e-4
"""Step of the divided differences of the continuation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Outlined(Surface):
    """A surface and the outline of a part."""

    surface: Surface
    outline: Outline

    def within(self, margin: float, x: Floats, y: Floats) -> Bools:
        """Return where the surface is defined and at most a margin [mm] outside the outline."""
        near = np.asarray(self.outline.distance(x, y) <= margin)
        inside = self.surface.inside(x, y)
        return near if inside is None else near & inside

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the pieces of the surface. See `Surface.piece`."""
        return self.surface.piece(x, y)

    def border(self, first: Ints, second: Ints, x: Floats, y: Floats) -> Floats:
        """Return that of the surface. See `Surface.border`."""
        return self.surface.border(first, second, x, y)

    @property
    def convex_pieces(self) -> bool:
        """Whether the surface has convex pieces. See `Surface.convex_pieces`."""
        return self.surface.convex_pieces

    @property
    def feature_size(self) -> float:
        """Size of the finest structure of the surface. [mm]."""
        return self.surface.feature_size

    @property
    def cost(self) -> int:
        """Cost of the surface per point, in additions."""
        return self.surface.cost


@dataclass(frozen=True, slots=True, kw_only=True)
class Continued(_Outlined):
    """A surface as it is on an outline and within 5 mm around it, and level far outside.

    Where the prescription ends closer to the outline, the surface is continued from there. Polynomials, tables and
    conics end or grow without bound outside their aperture, while the tool moves there to approach and leave the part.
    The derivatives of the continuation are divided differences; nothing is measured there.
    """

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives. See `Surface.evaluate`."""
        away = np.flatnonzero(~self.within(OWN_BAND_MM, x, y).ravel())
        if not away.size:
            return self.surface.evaluate(x, y, order)
        with np.errstate(all="ignore"):
            made = tuple(np.array(one) for one in self.surface.evaluate(x, y, order))
        for values, one in zip(made, self._continue(x.ravel()[away], y.ravel()[away], order), strict=True):
            values.reshape(-1)[away] = one
        return made

    def _continue(self, x: Floats, y: Floats, order: int) -> list[Floats]:
        """Return height and derivatives where the surface is not its own. Each (n,)."""
        step = DIFFERENCE_STEP_MM
        offsets = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)][: (1, 5, 9)[order]]
        z = [self._height(x + i * step, y + j * step) for i, j in offsets]
        made = [z[0]]
        if order > 0:
            made += [(z[1] - z[2]) / (2 * step), (z[3] - z[4]) / (2 * step)]
        if order > 1:
            made += [
                (z[1] + z[2] - 2 * z[0]) / step**2, (z[5] + z[6] - z[7] - z[8]) / (4 * step**2),
                (z[3] + z[4] - 2 * z[0]) / step**2,
            ]  # fmt: skip
        return made

    def _height(self, x: Floats, y: Floats) -> Floats:
        """Return the height of the continuation. (n,) [mm]."""
        edge_x, edge_y = self.outline.nearest_border(x, y)
        dx, dy = x - edge_x, y - edge_y
        distance = np.hypot(dx, dy)
        scale = 1 / np.where(distance > 0, distance, 1.0)
        dx, dy = dx * scale, dy * scale
        # From the outside of the band, or from the border where the prescription ends before.
        start = np.minimum(OWN_BAND_MM, distance)
        inside = self.surface.inside(edge_x + start * dx, edge_y + start * dy)
        if inside is not None:
            start = np.where(inside, start, -BORDER_OFFSET_MM)
        with np.errstate(all="ignore"):
            z, zx, zy = self.surface.evaluate(edge_x + start * dx, edge_y + start * dy, 1)
            at_border = self.surface.evaluate(edge_x, edge_y, 0)[0]
        # Of a rippled surface, the mean slope over the band: that at its outside would raise the ripple far out.
        slope = np.where(start > 0, (z - at_border) / np.where(start > 0, start, 1.0), zx * dx + zy * dy)
        beyond = -np.expm1((start - distance) / LEVELLING_MM) * LEVELLING_MM
        return np.asarray(z + beyond * slope)

    def inside(self, x: Floats, y: Floats) -> Bools | None:  # noqa: ARG002
        """Return ``None``: it is defined everywhere."""
        return None

    @property
    def domain(self) -> str:
        """The domain of the surface itself."""
        return self.surface.domain

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return the poles of the surface on the outline. See `Surface.poles`."""
        at_x, at_y = self.surface.poles(x, y, reach)
        on = self.outline.covers(at_x, at_y)
        return at_x[on], at_y[on]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of the surface."""
        return self.surface.remarks


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounded(_Outlined):
    """A surface without heights farther outside an outline than a margin, so that no map is compared with it there."""

    margin: float

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives of the surface, nan outside. See `Surface.evaluate`."""
        outside = ~self.on_outline(x, y)
        with np.errstate(all="ignore"):
            made = tuple(np.array(one) for one in self.surface.evaluate(x, y, order))
        for values in made:
            values[outside] = np.nan
        return made

    def on_outline(self, x: Floats, y: Floats) -> Bools:
        """Return which points are within the margin of the outline."""
        return np.asarray(self.outline.distance(x, y) <= self.margin)

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where the surface is defined and within the margin."""
        return self.within(self.margin, x, y)

    @property
    def domain(self) -> str:
        """The outline in words."""
        return f"the {self.outline.words}"
