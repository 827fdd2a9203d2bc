"""Quadrature over circular pupils and their overlaps, and the optical path between the points of a map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Complexes, Floats, frozen, is_even
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.surface import Gridded

__all__ = ["Modulation", "Nodes", "PathMap", "disc_nodes", "overlap_nodes"]

MIRRORED = 6
"""Rings beyond the axis, and azimuths beyond a turn, by which a polar map is extended before interpolation."""


class Nodes(NamedTuple):
    """Nodes of a quadrature and their weights. Each (m, n) [mm, mm, mm²]."""

    x: Floats
    y: Floats
    weight: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Modulation:
    """Modulation transfer of an image along x and along y. See `Wavefront.mtf`.

    Parameters
    ----------
    frequency
        Spatial frequencies. (n,) [1/rad] or, with a focal length, [1/mm]
    x, y
        Modulation of gratings that vary along x, and along y. Each (n,)
    cutoff
        Frequency beyond which nothing is transmitted. [1/rad or 1/mm]
    """

    frequency: Floats
    x: Floats
    y: Floats
    cutoff: float


class PathMap:
    """Optical path differences between the points of a map, by bicubic splines.

    A polar map is continued through the axis and over a full turn. A point counts as measured if a corner of its cell
    is, so that single missing points are interpolated.
    """

    def __init__(self, opd: HeightMap) -> None:
        if opd.scattered:
            raise InputError(
                f"the map {opd.name!r} has {opd.z.size} scattered points, a wavefront needs a grid: resample it first"
            )
        if opd.polar:
            x, y, z = _continued(opd)
        else:
            assert opd.x is not None  # noqa: S101 - for the type checker
            assert opd.y is not None  # noqa: S101
            x, y, z = opd.x, opd.y, opd.z
        self.polar = opd.polar
        self.spline = Gridded(x=x, y=y, z=z)
        valid = ~np.isnan(z)
        self.cells = valid[:-1, :-1] | valid[1:, :-1] | valid[:-1, 1:] | valid[1:, 1:]

    def __call__(self, x: Floats, y: Floats) -> tuple[Floats, Bools]:
        """Return the path differences at points, and where they are measured. Shape of the points [mm]."""
        if self.polar:
            x, y = np.hypot(x, y), np.arctan2(y, x) % (2 * math.pi)
        (path,) = self.spline.evaluate(x, y, 0)
        measured = np.ones(x.shape, dtype=bool)
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
    start = radius.searchsorted(1e-9 * radius[-1])
    if count % 2 == 0 and start <= 1:
        across = np.roll(z, count // 2, axis=0)[:, start : start + MIRRORED]
        z = np.hstack([across[:, ::-1], z])
        radius = np.append(-radius[start : start + MIRRORED][::-1], radius)
    rows = np.arange(-MIRRORED, count + MIRRORED)
    return radius, angle[0] + step * rows, z[rows % count]


def disc_nodes(radius: float, count: int) -> Nodes:
    """Return nodes over a disc about the origin. Each (count, count)."""
    return overlap_nodes((radius, radius), 0.0, count)


def overlap_nodes(radii: tuple[float, float], shift: float, count: int) -> Nodes:
    """Return nodes over the overlap of two discs, the first shifted by half of ``-shift`` along x, the other by half.

    A sine maps the ends of each panel across the overlap, where the chords have roots, so that the rule of Gauss
    converges exponentially.
    """
    first, second = radii
    node, weight = np.polynomial.legendre.leggauss(count)
    x, y, weights = [], [], []
    for low, high in _panels(first, second, shift):
        angle = node * math.pi / 2
        across = (low + high) / 2 + (high - low) / 2 * np.sin(angle)
        along = weight * math.pi / 2 * (high - low) / 2 * np.cos(angle)
        chord, other = (np.sqrt(np.maximum(size * size - across * across, 0.0)) for size in radii)
        low_end = np.maximum(-shift / 2 - chord, shift / 2 - other)
        half = np.maximum(np.minimum(-shift / 2 + chord, shift / 2 + other) - low_end, 0.0) / 2
        x.append(low_end[:, None] + half[:, None] * (1 + node))
        y.append(np.broadcast_to(across[:, None], (count, count)))
        weights.append((along * half)[:, None] * weight)
    if not x:
        return Nodes(*(np.zeros((0, count)) for _ in range(3)))
    return Nodes(*(np.concatenate(one) for one in (x, y, weights)))


def _panels(first: float, second: float, shift: float) -> Iterator[tuple[float, float]]:
    """Yield the panels across the overlap of two discs: between their intersections, and next to them."""
    least = min(first, second)
    if shift >= first + second:
        return
    if shift <= abs(first - second):
        yield -least, least
        return
    foot = (shift * shift + first * first - second * second) / (2 * shift)
    reach = math.sqrt(max(first * first - foot * foot, 0.0))
    yield -reach, reach
    # Seen from the larger disc, the middle of the smaller one is inside: its flanks overlap too.
    if shift * shift < abs(first * first - second * second):
        yield -least, -reach
        yield reach, least


def phasors(path: Floats, wavelength: float) -> Complexes:
    """Return the phase factors of path differences."""
    return np.asarray(np.exp(2j * math.pi / wavelength * path))


def even_frequencies(cutoff: float, count: int) -> Floats:
    """Return frequencies from 0 to the cutoff."""
    return frozen(np.linspace(0.0, cutoff, count), "frequency")
