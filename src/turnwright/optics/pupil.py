"""Quadrature over circular pupils and their overlaps, and the optical path between the points of a map."""

from __future__ import annotations

import math
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Complexes, Floats, gauss_rule, is_even
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.surface import Gridded

__all__ = ["Nodes", "PathMap", "phasors", "pupil_nodes"]

MOST_HEIGHTS, FEWEST_NODES = 1_000_000, 24

EDGE = 1e-9
"""Share of a radius that is rounding."""

MIRRORED = 6
"""Rings beyond the axis, and azimuths beyond a turn, by which a polar map is extended before interpolation."""


class Nodes(NamedTuple):
    """Nodes of a quadrature and their weights. Each (m, n) [mm, mm, mm²]."""

    x: Floats
    y: Floats
    weight: Floats


class PathMap:
    """Optical path differences between the points of a map, by bicubic splines.

    A polar map is continued over a full turn, and through the axis if it begins there. A point of a rectangular map
    counts as measured if a corner of its cell is, so that single missing points are interpolated. Of a map of more than
    `MOST_HEIGHTS` every n-th row and column enters.
    """

    def __init__(self, opd: HeightMap) -> None:
        if opd.scattered:
            raise InputError(
                f"the map {opd.name!r} has {opd.z.size} scattered points, a wavefront needs a grid: resample it first"
            )
        if opd.polar:
            x, y, z = _continued(opd)
        else:
            thin = opd.thinned(MOST_HEIGHTS)
            assert thin.x is not None  # noqa: S101 - for the type checker
            assert thin.y is not None  # noqa: S101
            x, y, z = thin.x, thin.y, thin.z
        self.start = None if opd.angle is None else float(opd.angle[0])
        self.rings = None if opd.radius is None else (float(opd.radius[0]), float(opd.radius[-1]))
        self.spline = Gridded(x=x, y=y, z=z)
        valid = ~np.isnan(z)
        self.cells = valid[:-1, :-1] | valid[1:, :-1] | valid[:-1, 1:] | valid[1:, 1:]

    def __call__(self, x: Floats, y: Floats) -> tuple[Floats, Bools]:
        """Return the path differences at points, and where they are measured. Shape of the points [mm]."""
        measured = np.ones(x.shape, dtype=bool)
        if self.start is not None and self.rings is not None:
            x, y = np.hypot(x, y), self.start + (np.arctan2(y, x) - self.start) % (2 * math.pi)
            low, high = self.rings
            measured &= (x <= high * (1 + EDGE)) & ((x >= low * (1 - EDGE)) | (self.spline.x[0] < 0))
        (path,) = self.spline.evaluate(x, y, 0)
        places = []
        for at, axis in ((x, self.spline.x), (y, self.spline.y)):
            measured &= (at >= 2 * axis[0] - axis[1]) & (at <= 2 * axis[-1] - axis[-2])
            places.append(np.clip(np.searchsorted(axis, at, side="right") - 1, 0, axis.size - 2))
        return path, measured & self.cells[places[1], places[0]]


def _continued(opd: HeightMap) -> tuple[Floats, Floats, Floats]:
    """Return radii, azimuths and values of a polar map, continued through the axis and beyond a turn."""
    assert opd.radius is not None  # noqa: S101 - for the type checker
    assert opd.angle is not None  # noqa: S101
    radius, angle, z, count = opd.radius, opd.angle, opd.z, opd.angle.size
    step = 2 * math.pi / count
    if count < 2 * MIRRORED or not is_even(angle) or abs(angle[1] - angle[0] - step) > 1e-6 * step:
        raise InputError(
            f"the map {opd.name!r} has {count} azimuths from {angle[0]:.4g} to {angle[-1]:.4g} rad, a wavefront needs "
            f"at least {2 * MIRRORED} in even steps over a full turn: give all of them"
        )
    if count % 2 == 0 and radius[0] <= radius[1] - radius[0]:
        start = int(radius[0] <= 1e-9 * radius[-1])
        across = np.roll(z, count // 2, axis=0)[:, start : start + MIRRORED]
        z = np.hstack([across[:, ::-1], z])
        radius = np.append(-radius[start : start + MIRRORED][::-1], radius)
    rows = np.arange(-MIRRORED, count + MIRRORED)
    return radius, angle[0] + step * rows, z[rows % count]


def pupil_nodes(radii: tuple[float, float], shift: float, count: int) -> Nodes:
    """Return nodes over the overlap of two equal annuli, displaced along x by half of a shift to either side.

    The chords of the overlap end on circles. Between the ordinates at which circles begin, end or cross, a sine maps
    the panel, so that roots at its ends are smooth and the rule of Gauss converges exponentially.

    Parameters
    ----------
    radii
        Of the pupil and of its obscuration, 0 without one. [mm]
    shift
        Distance of the two pupils. [mm]
    count
        Nodes along a chord of the whole pupil.
    """
    outer, inner = radii
    x, y, weights = [], [], []
    for low, high in pairwise(_breaks(outer, inner, shift)):
        if math.hypot((low + high) / 2, shift / 2) >= outer:
            continue
        size = max(int(count * (high - low) / (2 * outer)), FEWEST_NODES)
        node, weight = gauss_rule(size)
        angle = node * math.pi / 2
        across = (low + high) / 2 + (high - low) / 2 * np.sin(angle)
        along = weight * math.pi / 2 * (high - low) / 2 * np.cos(angle)
        node, weight = gauss_rule(count if inner == 0 else max(count // 2, FEWEST_NODES))
        chord, gap = (np.sqrt(np.maximum(one * one - across * across, 0.0)) for one in radii)
        parts = [(-chord, chord)] if inner == 0 else [(-chord, -gap), (gap, chord)]
        for (low_1, high_1), (low_2, high_2) in product(parts, parts):
            start = np.maximum(low_1 - shift / 2, low_2 + shift / 2)
            half = np.maximum(np.minimum(high_1 - shift / 2, high_2 + shift / 2) - start, 0.0) / 2
            if half.any():
                x.append(start[:, None] + half[:, None] * (1 + node))
                y.append(np.broadcast_to(across[:, None], x[-1].shape))
                weights.append((along * half)[:, None] * weight)
    if not x:
        return Nodes(*(np.zeros((0, 1)) for _ in range(3)))
    return Nodes(*(np.concatenate(one) for one in (x, y, weights)))


def _breaks(outer: float, inner: float, shift: float) -> Floats:
    """Return the ordinates at which the circles of two displaced annuli begin, end or cross. (n,) [mm]."""
    sizes = [outer, inner] if inner else [outer]
    marks = list(sizes)
    for first, second in product(sizes, sizes):
        if abs(first - second) < shift < first + second:
            foot = (shift * shift + first * first - second * second) / (2 * shift)
            marks.append(math.sqrt(max(first * first - foot * foot, 0.0)))
    return np.unique([sign * mark for mark in marks for sign in (-1, 1)])


def phasors(path: Floats, wavelength: float) -> Complexes:
    """Return the phase factors of path differences."""
    return np.asarray(np.exp(2j * math.pi / wavelength * path))
