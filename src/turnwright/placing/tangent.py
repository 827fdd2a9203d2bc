"""The unique tangent: a surface that curves up less than the edge everywhere is touched at one place.

The curvature is checked beforehand on a grid over the whole part, and again at every point that Newton's method visits.
The unknown is the distance from the tip for a perfect nose, and the sweep for any other edge.

Sources
-------
[Li2018]_ Eq. 8 takes the normal at the tip, which is exact only on a straight profile; [Troutman2016]_ ch. 6 gives the
tangent solution and the error of a wavy edge. Reference solutions of the tests: closed forms on spheres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import dilation as kernel
from turnwright.edge import Edge
from turnwright.errors import GougeError
from turnwright.surface import Surface

__all__ = [
    "Contact",
    "SurfaceKey",
    "Tips",
    "Touch",
    "find_curvature_limit",
    "find_tangents",
    "find_tangents_through",
    "follow",
]

MAX_CURVATURE_RATIO = 0.9
"""A single tangent is assumed where the surface has at most this fraction of the edge's curvature."""
SAMPLES_PER_PERIOD = 4
"""Samples per feature size of the grid that decides whether there is a single tangent."""
MAX_GRID_SAMPLES = 2_000_000
"""Most samples of that grid."""
STEP_TOL_RAD, STEP_TOL_RATIO = 3e-5, 1e-3
"""Small steps of Newton's method, as an angle of the nose and as a fraction of the feature size."""
MIN_FEATURE_RATIO = 1e-4
"""Smallest feature size that the samples resolve, as a fraction of the nose radius."""


class Tips(NamedTuple):
    """Commanded tips. Each (n,)."""

    angle: Floats  # of the rake plane [rad]
    radius: Floats  # along it [mm]
    lateral: Floats  # across it, toward growing azimuth [mm]

    @classmethod
    def at(cls, angle: Floats, radius: Floats, y: Floats | None = None) -> Tips:
        """Return tips at azimuths and radii, in the plane through the axis if ``y`` is ``None``."""
        return cls(angle, radius, np.zeros(angle.size) if y is None else y)

    def outermost(self, dx: float = 0.0) -> float:
        """Return the greatest distance from the axis of the tips, moved by ``dx`` along their rake planes. [mm]."""
        if not self.radius.size:
            return 0.0
        if self.lateral.any():
            return float(np.hypot(self.radius + dx, self.lateral).max())
        return float(max(abs(self.radius.min() + dx), abs(self.radius.max() + dx)))

    def select(self, which: Bools | Ints | slice) -> Tips:
        """Return some of the tips."""
        return Tips(self.angle[which], self.radius[which], self.lateral[which])


class Touch(NamedTuple):
    """Contacts of an edge and a surface. Each (n,)."""

    z: Floats  # height of the commanded tip [mm]
    sweep: Floats  # place on the nose [rad]
    x: Floats  # contact point in the part frame [mm]
    y: Floats
    surface_z: Floats

    def select(self, which: Bools | Ints | slice) -> Touch:
        """Return some of the contacts; with a slice, views that can be filled."""
        return Touch(*(one[which] for one in self))

    def put(self, which: Ints | slice, values: Touch) -> None:
        """Overwrite some of the contacts."""
        for target, some in zip(self, values, strict=True):
            target[which] = some


@dataclass(frozen=True, slots=True)
class Contact:
    """One surface and one edge, and the range that a plan covers."""

    surface: Surface
    edge: Edge
    upright: bool  # whether the edge stays in the plane through the axis
    nearest: float  # least and greatest position of the real tip along the rake plane [mm]
    farthest: float
    rim: float  # radius outside of which the surface is ignored; infinite for none [mm]
    extent: float  # radius that the plan covers [mm]
    feature: float  # smallest feature size that the samples resolve [mm]

    @property
    def flank(self) -> float:
        """Slope of the less steep flank, height over distance."""
        return self.edge.rake_cos * self.edge.flank_slope

    @property
    def step_tol(self) -> float:
        """Newton step after which the top of the parabola is the contact: its error is of third order. [rad]."""
        return min(STEP_TOL_RAD, STEP_TOL_RATIO * self.feature / self.edge.radius)

    @classmethod
    def of(cls, surface: Surface, edge: Edge, tips: Tips, rim: float) -> Contact:
        """Return the data that all tips of a plan share."""
        outermost = tips.outermost(edge.dx)
        rim = max(rim, outermost)
        return cls(
            surface,
            edge,
            upright=edge.upright and not tips.lateral.any(),
            nearest=float(tips.radius.min(initial=np.inf) + edge.dx),
            farthest=float(tips.radius.max(initial=-np.inf) + edge.dx),
            rim=rim,
            extent=rim if rim < np.inf else outermost,
            # Where the curvature is zero the feature size may be zero too; features far below the nose radius have no
            # effect.
            feature=max(surface.feature_size, MIN_FEATURE_RATIO * edge.radius),
        )

    def at_distance(self, tips: Tips, u: Floats) -> tuple[Floats, Floats]:
        """Return x and y on the part of the edge at distances ``u`` from each tip. Each (rows, n) [mm]."""
        x, y = np.empty((2, *u.shape))
        kernel.places(self.edge, *tips, u, x, y)
        return x, y

    def under_edge(self, tips: Tips, sweep: Floats) -> tuple[Floats, Floats, Floats]:
        """Return x and y on the part, and the height above the tip, of the edge at ``sweep``. Each (n,) [mm]."""
        x, y, e = np.empty((3, sweep.size))
        kernel.under_edge(self.edge, *tips, np.ascontiguousarray(sweep), x, y, e)
        return x, y, e

    def touch(self, tips: Tips, z: Floats, sweep: Floats) -> Touch:
        """Return the contacts of tips at heights ``z`` that touch at ``sweep``."""
        x, y, e = self.under_edge(tips, sweep)
        return Touch(z, sweep, x, y, z + e)

    def newton_step(self, tips: Tips, sweep: Floats) -> tuple[Floats, ...]:
        """Return f - e, its slope, the height, the Newton step and the curvature at places on the nose. Each (n,)."""
        with np.errstate(all="ignore"):
            jet = self.surface.evaluate(*self.under_edge(tips, sweep)[:2], 2)
        value, first, top, step, bend = np.empty((5, sweep.size))
        kernel.newton_step(self.edge, tips.angle, sweep, *jet, value, first, top, step, bend)
        return value, first, top, step, bend


class SurfaceKey:
    """Key of a cache: a surface that is compared by identity, which is fast."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SurfaceKey) and self.surface is other.surface

    def __hash__(self) -> int:
        return id(self.surface)


def find_curvature_limit(contact: Contact) -> float | None:
    """Return the limit of the surface's curvature, or ``None`` if a grid over the part exceeds it."""
    edge = contact.edge
    if not edge.convex or contact.surface.in_pieces:
        return None
    limit = MAX_CURVATURE_RATIO * edge.least_curvature()
    reach, fine = contact.extent + edge.half_width, contact.feature / SAMPLES_PER_PERIOD
    lean = None if contact.upright else (abs(edge.rake_sin), edge.radius)
    greatest = _greatest_slope_and_curvature(
        SurfaceKey(contact.surface), reach, fine, lean, has_rim=contact.rim < np.inf
    )
    # The flanks are straight: the surface cannot reach them only if it is nowhere as steep as they are.
    unique = greatest is not None and greatest[0] < MAX_CURVATURE_RATIO * contact.flank and greatest[1] < limit
    return limit if unique else None


@lru_cache(maxsize=4)  # a run places on the same surface again and again
def _greatest_slope_and_curvature(
    same: SurfaceKey, reach: float, fine: float, lean: tuple[float, float] | None, *, has_rim: bool
) -> tuple[float, float] | None:
    """Return the greatest slope and upward curvature that count for an edge, on a grid; ``None`` if it is too fine.

    ``lean`` is the sine of the rake and the radius of an edge out of the radial plane.
    """
    # The grid resolves the surface's features; where that takes too many samples, the search is as fast.
    rings = max(97, int(np.ceil(reach / fine))) if fine > 0 else MAX_GRID_SAMPLES
    spokes = max(120, int(np.ceil(2 * np.pi * reach / fine))) if fine > 0 else MAX_GRID_SAMPLES
    if rings * spokes > MAX_GRID_SAMPLES:
        return None
    ring = np.linspace(0, reach, rings)
    # With a rim, the tangent must be unique as far as the arc reaches; otherwise every tip is searched for.
    elsewhere = np.inf if has_rim else -np.inf
    steepest, sharpest, change = 0.0, -np.inf, 0.0
    for angle in np.array_split(np.linspace(0, 2 * np.pi, spokes, endpoint=False), -(-rings * spokes // 65536)):
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        inside = same.surface.inside(ring * c, ring * s)
        with np.errstate(all="ignore"):
            slope, bend = _slope_and_curvature(same.surface, ring * c, ring * s, c, s, lean)
            valid = np.isfinite(bend) & np.isfinite(slope)
        if inside is not None:
            valid &= inside
        slope, bend = np.where(valid, slope, 0.0), np.where(valid, bend, elsewhere)
        steepest = max(steepest, float(slope.max(initial=0.0)))
        sharpest = max(sharpest, float(bend.max(initial=-np.inf)))
        # Between the rings the curvature may be greater by about its change from ring to ring.
        with np.errstate(invalid="ignore"):
            steps = np.abs(np.diff(bend, axis=1))
        change = max(change, float(steps[np.isfinite(steps)].max(initial=0.0)))
    return steepest, sharpest + change


def _slope_and_curvature(
    surface: Surface, x: Floats, y: Floats, c: Floats, s: Floats, lean: tuple[float, float] | None
) -> tuple[Floats, Floats]:
    _, zx, zy, zxx, zxy, zyy = surface.evaluate(x, y, 2)
    if lean is None:
        return np.abs(zx * c + zy * s), zxx * c * c + 2 * zxy * c * s + zyy * s * s
    # Out of the radial plane every direction counts, and the slope across the plane adds to that of a raked edge.
    slope, (rake_sin, radius) = np.hypot(zx, zy), lean
    mean, half = 0.5 * (zxx + zyy), np.hypot(0.5 * (zxx - zyy), zxy)
    return slope * (1 + rake_sin), (mean + half) * (1 + rake_sin) ** 2 + slope * rake_sin / radius


def find_tangents(contact: Contact, limit: float, tips: Tips, out: Touch) -> bool:
    """Fill ``out`` with the tangent solution; return whether it is certainly unique, see `find_curvature_limit`."""
    find = _solve_round_tangents if contact.edge.perfect else _solve_edge_tangents
    if not find(contact, limit, tips, out):
        return False
    inside = contact.surface.inside(out.x, out.y)
    # The condition holds on the arc only, not on the flanks.
    on_arc = (out.sweep >= contact.edge.low) & (out.sweep <= contact.edge.high)
    return bool(on_arc.all()) and (inside is None or bool(inside.all()))


def _solve_round_tangents(contact: Contact, limit: float, tips: Tips, out: Touch) -> bool:
    """Solve for a perfect nose by Newton's method, with loops that vectorise."""
    edge = contact.edge
    cosine, sine = np.empty((2, tips.angle.size))
    u = np.zeros(tips.angle.size)
    kernel.round_start(edge, *tips, cosine, sine, out.x, out.y)
    for _ in range(12):
        with np.errstate(all="ignore"):
            jet = contact.surface.evaluate(out.x, out.y, 2)
        far, doubtful = kernel.round_step(
            edge, limit, contact.step_tol, cosine, sine, tips.radius, tips.lateral, u, *jet, out.z, out.x, out.y
        )
        if doubtful:
            return False
        if not far:
            break
    else:
        return False
    nose = edge.radius
    np.arcsin(u / nose, out=out.sweep)
    np.add(out.z, edge.dz + edge.rake_cos * (nose - np.sqrt(nose * nose - u * u)), out=out.surface_z)
    return True


def _solve_edge_tangents(contact: Contact, limit: float, tips: Tips, out: Touch) -> bool:
    """Solve for any convex edge by Newton's method in the sweep; converged points drop out."""
    sweep = np.zeros(tips.angle.size)
    active: Ints | slice = slice(None)
    active_tips, s = tips, sweep
    for _ in range(12):
        value, _, top, step, bend = contact.newton_step(active_tips, s)
        if not (bend < limit).all():
            return False
        # On a steep surface a full step from the tip could leave the arc: the step is limited.
        s = s + np.clip(step, -0.3, 0.3)
        out.z[active], sweep[active] = top, s
        far = (np.abs(step) > contact.step_tol) | (np.abs(top - value) > kernel.RISE_TOL_MM)
        if not far.any():
            break
        if 2 * np.count_nonzero(far) < far.size:
            keep = np.flatnonzero(far)
            active = keep if isinstance(active, slice) else active[keep]
            active_tips, s = active_tips.select(keep), s[keep]
    else:
        return False
    out.put(slice(None), contact.touch(tips, out.z, sweep))
    return True


def find_tangents_through(surface: Surface, edge: Edge, contacts: Tips) -> tuple[Floats, Floats, Floats, Floats]:
    """Return sweep, x, y and height at which the edge is tangent to the surface, at given radii of the contacts.

    The distance of the tip from the rake plane is that of ``contacts``; its radius follows from the contact.
    """
    cosine, sine = np.cos(contacts.angle), np.sin(contacts.angle)
    sweep = np.zeros(cosine.size)
    contact, across = contacts.radius, contacts.lateral + edge.dy
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
                f"y = {y[k]:.6g} mm, the arc of the tool covers slopes from {low:.4g} to {high:.4g} deg: "
                "use a tool with a larger included angle"
            )
        moved = contacts.lateral + edge.points(sweep)[1]
        # An edge without rake stays in the radial plane; with rake, its lateral position depends on the sweep.
        if np.abs(moved - across).max() < 1e-15:
            break
        across = moved
    return sweep, x, y, surface_z


def follow(surface: Surface, edge: Edge, tips: Tips, sweep: Floats) -> Touch:
    """Return the tangent solutions near given places on the nose, without a search for other contacts.

    Next to a valley between two lenslets the edge touches one, then the other; this gives the contact with one of them
    as if the other were absent. Heights are nan where Newton's method does not converge. It starts from ``sweep``, the
    place on the nose. (n,) [rad]
    """
    contact = Contact.of(surface, edge, tips, np.inf)
    s, tilt = sweep.copy(), 0.5 * min(-edge.low, edge.high)
    lost = np.zeros(s.size, dtype=np.bool_)
    for _ in range(12):
        value, _, top, step, _ = contact.newton_step(tips, s)
        lost |= ~(np.abs(step) < tilt)
        s += np.where(lost, 0.0, step)
        far = ~lost & ((np.abs(step) > contact.step_tol) | (np.abs(top - value) > kernel.RISE_TOL_MM))
        if not far.any():
            break
    lost |= far | (s < edge.low) | (s > edge.high)
    z = np.where(lost, np.nan, top)
    return contact.touch(tips, z, s)
