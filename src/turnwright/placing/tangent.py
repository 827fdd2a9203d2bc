r"""The one tangent: where a surface curves up less than the edge everywhere, it touches at one place.

There f - e is strictly concave and has one maximum, the tangent solution, which Newton finds from the tip. The
condition is tested beforehand on a grid over the whole part and again at every point that Newton visits, that is at the
density of the program itself. A perfect nose in the radial plane is moved in the distance from its tip, any other edge
in its sweep.

Sources
-------
[Li2018]_ Eq. 8 takes the normal at the tip, exact only on a straight profile; [Troutman2016]_ ch. 6 has the tangent
solution and the error of a wavy edge. Oracles: closed forms on spheres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import dilation as kernel
from turnwright.edge import Edge
from turnwright.errors import GougeError
from turnwright.surface import Surface
from turnwright.tool import Tool

__all__ = [
    "CONCAVITY", "SAMPLES_PER_PERIOD", "Contact", "Tips", "Touch", "bend_limit", "find_tangents", "follow",
    "set_contact", "tangents_through",
]  # fmt: skip

CONCAVITY = 0.9
"""Largest share of the edge's own curvature that the surface may have where a single tangent is taken for granted."""
SAMPLES_PER_PERIOD = 4
"""Samples per feature size of the grid that settles whether there is one tangent."""
MOST_SAMPLES = 2_000_000
"""Samples of that grid at most."""
FINEST = 1e-4
"""Least feature that is looked for, as a share of the nose radius."""


class Tips(NamedTuple):
    """Commanded tips. Each (n,)."""

    angle: Floats  # of the rake plane [rad]
    radius: Floats  # along it [mm]
    aside: Floats  # across it, toward growing azimuth [mm]

    def some(self, which: Bools | Ints | slice) -> Tips:
        """Return some of them."""
        return Tips(self.angle[which], self.radius[which], self.aside[which])


class Touch(NamedTuple):
    """Where and how high the edge touches. Each (n,)."""

    z: Floats  # commanded tip [mm]
    sweep: Floats  # place on the nose [rad]
    x: Floats  # contact point in the part frame [mm]
    y: Floats
    surface_z: Floats

    def some(self, which: Bools | Ints | slice) -> Touch:
        """Return some of them; of a slice, to be filled."""
        return Touch(*(one[which] for one in self))


@dataclass(frozen=True, slots=True)
class Contact:
    """One surface and one edge, and how far a plan goes with them."""

    surface: Surface
    edge: Edge
    upright: bool  # whether the edge stays in the plane through the axis
    nearest: float  # least and greatest place of the real tip along the rake plane [mm]
    farthest: float
    rim: float  # from the axis, outside of which nothing counts; infinite if all does [mm]
    extent: float  # from the axis, that the plan covers [mm]
    feature: float  # least size of what is looked for on the surface [mm]

    @property
    def flank(self) -> float:
        """Slope of the less steep of the flanks, as height over distance."""
        return self.edge.rake_cos * self.edge.flank_slope

    def under_edge(self, tips: Tips, sweep: Floats) -> tuple[Floats, Floats]:
        """Return where on the part the places ``sweep`` of the edge stand. Each (n,) [mm]."""
        x, y = np.empty((2, sweep.size))
        kernel.under_edge(self.edge, *tips, np.ascontiguousarray(sweep), x, y)
        return x, y


def set_contact(surface: Surface, edge: Edge, tips: Tips, rim: float) -> Contact:
    """Return what is asked once for all tips of a plan."""
    outermost = float(np.hypot(tips.radius + edge.dx, tips.aside).max())
    rim = max(rim, outermost)
    return Contact(
        surface,
        edge,
        upright=edge.upright and not tips.aside.any(),
        nearest=float(tips.radius.min() + edge.dx),
        farthest=float(tips.radius.max() + edge.dx),
        rim=rim,
        extent=rim if rim < np.inf else outermost,
        # A curvature that vanishes may change by its own size over no distance at all; the nose does not feel it.
        feature=max(surface.feature_size, FINEST * edge.radius),
    )


def bend_limit(contact: Contact) -> float | None:
    """Return the curvature that the surface must stay below, or ``None`` if it does not on a grid over the part."""
    if not contact.edge.convex or contact.surface.in_pieces:
        return None
    limit = CONCAVITY * contact.edge.least_curvature()
    # The grid is finer than the surface's features; where that is too fine, the search is as quick.
    reach, fine = contact.extent + contact.edge.half_width, contact.feature / SAMPLES_PER_PERIOD
    rings = max(97, int(np.ceil(reach / fine))) if fine > 0 else MOST_SAMPLES
    spokes = max(120, int(np.ceil(2 * np.pi * reach / fine))) if fine > 0 else MOST_SAMPLES
    if rings * spokes > MOST_SAMPLES:
        return None
    ring = np.linspace(0, reach, rings)
    steepest, sharpest, change = 0.0, -np.inf, 0.0
    for angle in np.array_split(np.linspace(0, 2 * np.pi, spokes, endpoint=False), -(-rings * spokes // 65536)):
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        slope, bend = _steepness(contact, ring * c, ring * s, c, s)
        steepest = max(steepest, float(slope.max(initial=0.0)))
        sharpest = max(sharpest, float(bend.max(initial=-np.inf)))
        # Between the rings the curvature may be greater by about what it changes from ring to ring.
        with np.errstate(invalid="ignore"):
            steps = np.abs(np.diff(bend, axis=1))
        change = max(change, float(steps[np.isfinite(steps)].max(initial=0.0)))
    # On the flanks, which are straight, the surface may come up again unless it is nowhere as steep as they are.
    return limit if steepest < CONCAVITY * contact.flank and sharpest + change < limit else None


def _steepness(contact: Contact, x: Floats, y: Floats, c: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Return the greatest slope, and the curvature upward, that an edge at azimuth (c, s) may meet at (x, y)."""
    inside = contact.surface.inside(x, y)
    with np.errstate(all="ignore"):
        _, zx, zy, zxx, zxy, zyy = contact.surface.evaluate(x, y, 2)
    slope, bend = np.abs(zx * c + zy * s), zxx * c * c + 2 * zxy * c * s + zyy * s * s
    if not contact.upright:
        # Out of the radial plane any direction counts, and the slope across lifts a leaning edge.
        slope, lean = np.hypot(zx, zy), abs(contact.edge.rake_sin)
        mean, half = 0.5 * (zxx + zyy), np.hypot(0.5 * (zxx - zyy), zxy)
        bend = (mean + half) * (1 + lean) ** 2 + slope * lean / contact.edge.radius
        slope = slope * (1 + lean)
    there = np.isfinite(bend) & np.isfinite(slope)
    if inside is not None:
        there &= inside
    # With a rim there must be one tangent as far as the arc reaches, or all tips are searched for.
    elsewhere = np.inf if contact.rim < np.inf else -np.inf
    return np.where(there, slope, 0.0), np.where(there, bend, elsewhere)


def find_tangents(contact: Contact, limit: float, tips: Tips, out: Touch) -> bool:
    """Fill ``out`` with the tangent solution; return whether it is certain to be the only one, see `bend_limit`."""
    find = _round_tangents if contact.upright and contact.edge.perfect else _edge_tangents
    if not find(contact, limit, tips, out):
        return False
    inside = contact.surface.inside(out.x, out.y)
    # Nothing is said of the flanks beyond the arc.
    on_arc = (out.sweep >= contact.edge.low) & (out.sweep <= contact.edge.high)
    return bool(on_arc.all()) and (inside is None or bool(inside.all()))


def _round_tangents(contact: Contact, limit: float, tips: Tips, out: Touch) -> bool:
    """Newton for a perfect nose in the radial plane, with loops that vectorise."""
    edge, angle, radius = contact.edge, tips.angle, tips.radius
    cosine, sine = np.empty((2, angle.size))
    u = np.zeros(angle.size)
    kernel.round_start(edge, angle, radius, cosine, sine, out.x, out.y)
    for _ in range(12):
        with np.errstate(all="ignore"):
            jet = contact.surface.evaluate(out.x, out.y, 2)
        far, doubtful = kernel.round_step(edge, limit, cosine, sine, radius, u, *jet, out.z, out.x, out.y)
        if doubtful:
            return False
        if not far:
            break
    else:
        return False
    nose = edge.radius
    np.arcsin(u / nose, out=out.sweep)
    np.add(out.z, (nose + edge.dz) - np.sqrt(nose * nose - u * u), out=out.surface_z)
    return True


def _edge_tangents(contact: Contact, limit: float, tips: Tips, out: Touch) -> bool:
    """Newton for any convex edge, in the sweep; points that have arrived drop out."""
    sweep = np.zeros(tips.angle.size)
    active: Ints | slice = slice(None)
    left, s = tips, sweep
    for _ in range(12):
        x, y, value, first, top, step, bend = np.empty((7, s.size))
        kernel.under_edge(contact.edge, *left, s, x, y)
        with np.errstate(all="ignore"):
            jet = contact.surface.evaluate(x, y, 2)
        kernel.newton_step(contact.edge, left.angle, s, *jet, value, first, top, step, bend)
        if not (bend < limit).all():
            return False
        # Newton from the tip could leave the arc on a steep place: walk there.
        s = s + np.clip(step, -0.3, 0.3)
        out.z[active], sweep[active] = top, s
        far = (np.abs(step) > kernel.CLOSE) | (np.abs(top - value) > kernel.LITTLE)
        if not far.any():
            break
        if 2 * np.count_nonzero(far) < far.size:
            keep = np.flatnonzero(far)
            active = keep if isinstance(active, slice) else active[keep]
            left, s = left.some(keep), s[keep]
    else:
        return False
    out.sweep[:] = sweep
    out.x[:], out.y[:] = contact.under_edge(tips, sweep)
    out.surface_z[:] = out.z + contact.edge.points(sweep)[2]
    return True


def tangents_through(surface: Surface, edge: Edge, contacts: Tips) -> tuple[Floats, Floats, Floats, Floats]:
    """Return sweep, x, y and height where the edge's tangent is the surface's, at contacts along the rake plane.

    The tip stands as far aside of the plane as ``contacts`` say; along it, it is wherever it has to be.
    """
    cosine, sine = np.cos(contacts.angle), np.sin(contacts.angle)
    sweep = np.zeros(cosine.size)
    contact, across = contacts.radius, contacts.aside + edge.dy
    for _ in range(20):
        x, y = contact * cosine - across * sine, contact * sine + across * cosine
        surface_z = surface.sag(x, y)
        zx, zy = surface.gradient(x, y)
        kernel.tangent_sweep(edge, zx * cosine + zy * sine, zy * cosine - zx * sine, sweep)
        if not np.isfinite(sweep).all():
            k = int(np.argmin(np.isfinite(sweep)))
            low, high = np.rad2deg((edge.low, edge.high))
            raise GougeError(
                f"the surface slopes {np.rad2deg(np.arctan(np.hypot(zx[k], zy[k]))):.4g} deg at x = {x[k]:.6g} mm, "
                f"y = {y[k]:.6g} mm, the arc of the tool holds tangents from {low:.4g} to {high:.4g} deg: "
                "take a tool with a larger included angle"
            )
        moved = contacts.aside + edge.points(sweep)[1]
        # An upright edge stays in the radial plane; a leaning one moves aside with its place on the nose.
        if np.abs(moved - across).max() < 1e-15:
            break
        across = moved
    return sweep, x, y, surface_z


def follow(
    surface: Surface, tool: Tool, *, angle: Floats, radius: Floats, y: Floats, sweep: Floats, sense: int
) -> Touch:
    """Return the tangents near those places on the nose, whether or not the edge touches somewhere else: no search.

    Near a valley of the path two lenslets touch in turn; either one's own tangent is what it would be without the
    other. Heights are nan where Newton's method finds none. For the arguments see `touch`; ``sweep`` is where on the
    nose to start. (n,) [rad]
    """
    edge = tool.cutting_edge(sense)
    s, tilt = sweep.copy(), 0.5 * min(-edge.low, edge.high)
    lost = np.zeros(s.size, dtype=np.bool_)
    for _ in range(12):
        x, at_y, value, first, top, step, bend = np.empty((7, s.size))
        kernel.under_edge(edge, angle, radius, y, s, x, at_y)
        with np.errstate(all="ignore"):
            jet = surface.evaluate(x, at_y, 2)
        kernel.newton_step(edge, angle, s, *jet, value, first, top, step, bend)
        lost |= ~(np.abs(step) < tilt)
        s += np.where(lost, 0.0, step)
        far = ~lost & ((np.abs(step) > kernel.CLOSE) | (np.abs(top - value) > kernel.LITTLE))
        if not far.any():
            break
    lost |= far | (s < edge.low) | (s > edge.high)
    kernel.under_edge(edge, angle, radius, y, s, x, at_y)
    z = np.where(lost, np.nan, top)
    return Touch(z, s, x, at_y, z + edge.points(s)[2])
