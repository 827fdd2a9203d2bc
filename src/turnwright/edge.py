r"""The cutting edge of a tool, as one value that compiled kernels take whole.

In the rake plane the edge is a curve (u, w) over the *sweep* s: u the distance from its nominal tip toward +X, w the
height above it, an arc of one radius plus waviness with straight flanks beyond,

.. math:: u = (R + d) \sin s, \qquad w = R - (R + d) \cos s

and with the waviness d a polynomial of s in each of some pieces. Leaned by the rake and moved by the offset of the tip
it stands at (dx + u, dy + w sin, dz + w cos) from the commanded tip.

The same edge is known as a height over the distance, its *profile* w(u). A perfect nose is a circle inside the arc. A
wavy one is a table of cubic pieces there, over the tangent x of half the slope angle on the circle that is as steep as
the edge at both ends: over x an edge stays smooth however steep its walls are.

The profile is exact for a perfect nose. With waviness it is within 1e-12 mm of the curve per mm of nose radius where
the edge is less steep than 89.5 deg, for deviations of 0.1 um within 1e-10 mm up to 89.9 deg, and for those of 5 um
within 1e-8 mm up to vertical walls. A ragged certificate, whose third derivative jumps by up to J mm/rad³ from point to
point, adds up to J · 6e-13 mm on half a circle and a tenth of that within 100 deg, where scatter of 20 nm at every
degree makes it 1e-11 mm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Floats, only_read
from turnwright._kernels import edge as kernel

__all__ = ["Edge", "edge_of_arc"]

PIECES = 8192
"""Cubic pieces that the profile of a wavy edge has, or a few more."""
CURVATURES = 2001
"""Places on the arc at which its least curvature is looked for."""


class Edge(NamedTuple):
    """The edge of one tool, for one sense of the spindle. `Tool.cutting_edge` makes it.

    Its fields are plain numbers and arrays, so that numba takes it as one argument; its methods are for everyone else.
    """

    radius: float  # of the arc, without waviness [mm]
    low: float  # sweep at which the arc ends toward -X [rad]
    high: float  # and toward +X
    rake_cos: float  # of the rake angle
    rake_sin: float  # toward growing spindle angle per height in the rake plane
    dx: float  # offset of the tip [mm]
    dy: float
    dz: float
    breaks: Floats  # (m + 1,) sweep at the ends of the waviness pieces [rad]
    coefficients: Floats  # (k + 1, m) waviness polynomials, highest power first, in sweep - breaks[i] [mm/rad^k]
    base: float  # radius of the circle that the profile stands on [mm]
    low_u: float  # distance at which the arc ends toward -X, height and slope there [mm]
    low_w: float
    low_slope: float
    high_u: float  # and toward +X
    high_w: float
    high_slope: float
    pieces_per_x: float  # of the profile
    least_x: float  # at which they begin
    middle_u: float  # distance of the centre of the circle [mm]
    pieces: Floats  # (n, 4) coefficients of the pieces, lowest power first; (0, 0) for a perfect nose
    convex: bool  # whether the edge curves upward everywhere: then two placings of it cross at most once

    @property
    def perfect(self) -> bool:
        """Whether the arc is one of a circle, without waviness."""
        return self.pieces.size == 0

    @property
    def upright(self) -> bool:
        """Whether all of the edge stands in the plane through the axis, as long as the tool is not moved along Y."""
        return self.rake_sin == 0 and self.dy == 0

    @property
    def flank_slope(self) -> float:
        """Slope of the less steep of the flanks, in the rake plane."""
        return min(-self.low_slope, self.high_slope)

    @property
    def half_width(self) -> float:
        """Distance from the tip to the farther end of the arc. [mm]."""
        return max(-self.low_u, self.high_u)

    def points(self, sweep: ArrayLike) -> Floats:
        """Return (u, v, e) from the commanded tip: toward +X, toward growing spindle angle, and up. (3, ...) [mm]."""
        sweep = np.asarray(sweep, dtype=np.float64)
        out = np.empty((3, sweep.size))
        kernel.points(self, sweep.ravel(), out)
        return out.reshape(3, *sweep.shape)

    def profile(self, u: Floats) -> tuple[Floats, Floats]:
        """Return height and slope in the rake plane at distances from the nominal tip. Each (n,) [mm]."""
        out = np.empty((2, u.size))
        kernel.profile(self, np.ascontiguousarray(u), out)
        return out[0], out[1]

    def sweeps(self, u: Floats) -> Floats:
        """Return the sweep at which the edge stands at distances from the nominal tip. (n,) [rad]."""
        out = np.empty(u.size)
        kernel.sweeps_at(self, u, out)
        return out

    def least_curvature(self) -> float:
        """Return the least curvature anywhere on the arc, as height over distance. [1/mm]."""
        u, w, _, _ = self.trace(np.linspace(self.low, self.high, CURVATURES))
        slopes = np.diff(w) / np.diff(u)
        middles = 0.5 * (u[1:] + u[:-1])
        return float(self.rake_cos * (np.diff(slopes) / np.diff(middles)).min())

    def trace(self, sweep: ArrayLike) -> Floats:
        """Return (u, w, u', w') in the rake plane. (4, n)."""
        sweep = np.ascontiguousarray(sweep, dtype=np.float64)
        out = np.empty((4, sweep.size))
        kernel.trace(self, sweep, out)
        return out


def edge_of_arc(
    *, radius: float, arc: tuple[float, float], rake: float, offset: tuple[float, float, float],
    breaks: Floats, coefficients: Floats,
) -> Edge:  # fmt: skip
    """Return the edge of a tool under which the spindle angle grows.

    ``breaks`` and ``coefficients`` are its waviness, see `Edge`; several pieces are a certificate, held constant beyond
    its ends. ``arc`` are the sweeps at which the arc ends. [rad]
    """
    low, high = arc
    flat = dict.fromkeys(("base", "low_u", "low_w", "low_slope", "high_u", "high_w", "high_slope"), 0.0)
    edge = Edge(
        radius=float(radius), low=float(low), high=float(high), rake_cos=float(np.cos(rake)),
        rake_sin=float(-np.sin(rake)), dx=float(offset[0]), dy=float(offset[1]), dz=float(offset[2]),
        breaks=only_read(np.asarray(breaks, dtype=np.float64)),
        coefficients=only_read(np.asarray(coefficients, dtype=np.float64)),
        **flat, pieces_per_x=0.0, least_x=0.0, middle_u=0.0, pieces=only_read(np.empty((0, 0))), convex=True,
    )  # fmt: skip
    certified = edge.coefficients.shape[1] > 1
    perfect = not (certified or edge.coefficients.any())
    u, w, du, dw = edge.trace(arc)
    slope = dw / du
    sine = np.sin(np.arctan(slope))
    if sine[1] - sine[0] < np.sin(high):  # waves outweigh the arc: half of what it rises by
        sine = np.sin(arc)
    base = edge.radius if perfect else float((u[1] - u[0]) / (sine[1] - sine[0]))
    low_end, high_end = (tuple(float(one[k]) for one in (u, w, slope)) for k in (0, 1))
    edge = edge._replace(
        base=base, low_u=low_end[0], low_w=low_end[1], low_slope=low_end[2],
        high_u=high_end[0], high_w=high_end[1], high_slope=high_end[2],
    )  # fmt: skip
    if perfect:
        return edge
    jumps = edge.breaks[[0, -1]] if certified else np.empty(0)
    jumps = jumps[(jumps > low) & (jumps < high)]
    edge = _split_profile(edge, jumps, float(u[0] - base * sine[0]))
    return edge._replace(convex=_is_convex(edge, jumps))


def _split_profile(edge: Edge, jumps: Floats, centre: float) -> Edge:
    """Return the edge with its profile in cubic pieces; ``jumps`` is where a certificate ends inside the arc."""
    base, arc = edge.base, (edge.low, edge.high)
    # Nodes at equal steps of x, two of them where a certificate ends inside the arc: there the slope jumps.
    joints = np.concatenate([arc[:1], jumps, arc[1:]])
    across = edge.trace(joints)[0] - centre
    at = across / (base + np.sqrt(base * base - across * across))
    first = 1 if jumps.size == 2 else int(np.argmax(np.diff(at)))
    span = at[first + 1] - at[first]
    count = int(np.ceil(PIECES * span / (at[-1] - at[0])))
    step = span / count
    before, after = (int(np.ceil(length / step - 1e-3)) for length in (at[first] - at[0], at[-1] - at[first + 1]))
    x = at[first] + step * np.arange(-before, count + after + 1)
    node = np.clip(x, at[0], at[-1])
    sweep = edge.sweeps(centre + 2 * base * node / (1 + node * node))
    sweep[[before, before + count]] = joints[first : first + 2]
    sweep = np.clip(sweep, *arc)
    rate = 2 * base * (1 - node * node) / (1 + node * node) ** 2  # du/dx
    # Each piece from its own side of its nodes.
    _, a, du, dw = edge.trace(np.nextafter(sweep[:-1], np.inf))
    c = dw / du * rate[:-1] * np.diff(node)
    _, b, du, dw = edge.trace(np.nextafter(sweep[1:], -np.inf))
    d = dw / du * rate[1:] * np.diff(node)
    square, cube = 3 * (b - a) - 2 * c - d, 2 * (a - b) + c + d
    # The first and the last piece are cut off by the ends of the arc; all count their place in whole steps.
    scale, shift = step / np.diff(node), (x - node)[:-1] / np.diff(node)
    pieces = [
        a + shift * (c + shift * (square + shift * cube)),
        scale * (c + shift * (2 * square + shift * 3 * cube)),
        scale**2 * (square + shift * 3 * cube),
        scale**3 * cube,
    ]
    return edge._replace(
        pieces_per_x=float(1 / step), least_x=float(x[0]), middle_u=centre, pieces=only_read(np.transpose(pieces))
    )


def _is_convex(edge: Edge, jumps: Floats) -> bool:
    """Say whether the edge curves upward all along the arc, and does not turn down where a certificate ends."""
    _, _, du, dw = edge.trace(np.linspace(edge.low, edge.high, 4 * PIECES))
    if not ((du > 0).all() and (np.diff(dw / du) > 0).all()):
        return False
    (_, _, du, dw), (_, _, du_after, dw_after) = (edge.trace(np.nextafter(jumps, way)) for way in (-np.inf, np.inf))
    return bool((dw_after / du_after - dw / du > -1e-12).all())
