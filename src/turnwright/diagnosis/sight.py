"""A measured map as the estimate sees it: its points, where they were cut, and how the map may have been moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright.diagnosis.model import Cutting, Deviations, Sweeps, Swept
from turnwright.errors import InputError
from turnwright.pose import Pose

if TYPE_CHECKING:
    from turnwright.diagnosis.causes import Columns
    from turnwright.heightmap import HeightMap
    from turnwright.part import Part
    from turnwright.tool import Tool

__all__ = ["CENTRE", "FREE", "Sight", "mark", "sights_of", "valid"]

CENTRE = 0.05
"""Nearer to the axis than this the real tool may cut on the far side of it. [mm]"""

CUSP = 0.01
"""Half the arc of a nose that a feed uses on a plane, about: of the edge at least so much cuts. [rad]"""

FREE = ("piston", "tilt", "decentre", "clocking")
"""What registration leaves open, a little."""

NUDGE = (1e-6, 1e-6, 1e-7)
"""Slopes and curvature by which a sphere is changed to see what that does."""


@dataclass(slots=True, kw_only=True, eq=False)
class Sight:
    """One measured map as the fit sees it: its points, and where on the nose they were cut.

    ``x``, ``y``, ``z`` are the valid points; of a departure from a sphere, ``sphere`` has that of the design: slopes at
    the axis and curvature (p, q, k).
    """

    x: Floats
    y: Floats
    z: Floats
    swept: Swept
    sweeps: Sweeps
    added: dict[str, Floats]
    usable: Bools  # points that the planned tool cuts
    good: Bools  # those of them that the fit takes
    apart: Bools  # points that stand out of the rest by so much that the fit leaves them
    free: tuple[str, ...]
    reference: str
    where: Bools  # which points of the map these are
    sphere: Floats | None
    stands: Floats | None  # departure along the normal that the points should have, as far as the fit knows it [mm]
    cusp: float  # mean height of the cusps per curvature between the passes [mm²]
    pose: Floats  # shift x, y, z, rotation, tilts [mm, rad]; and (p, q, k) beyond those of the design's sphere
    begun: Floats  # where the pose began

    def moved(self) -> tuple[Floats, Floats, Floats]:
        """Return the points in the frame of the part, as far as the fit knows it."""
        x, y, z = self.x, self.y, self.z
        if self.sphere is not None:
            x, y, z = on_sphere(self.sphere + self.pose[6:], x, y, z, self.stands)
        shift, rotation, tilt = self.pose[:3], self.pose[3], self.pose[4:6]
        return Pose.within_a_turn(shift, rotation, tilt).apply(x, y, z)

    def cut(self, deviations: Deviations) -> tuple[Floats, Cutting]:
        """Return what is measured beyond the height that the deviations leave, and how the points were cut."""
        x, y, z = self.moved()
        # Where the last deviations left no contact, these may have one again.
        lost = self.usable & np.isnan(self.sweeps.cut)
        if lost.any():
            for own, again in zip(self.sweeps, self.swept.guess(x[lost], y[lost]), strict=True):
                own[lost] = again
        cutting = self.swept.heights(x, y, self.sweeps, deviations)
        residual = z - cutting.z - self.cusp * cutting.between
        if self.stands is not None:
            self.stands = self.z - np.nan_to_num(residual) / np.sqrt(1 + cutting.zx**2 + cutting.zy**2)
        return residual, cutting

    def nuisances(self, cutting: Cutting, by_angle: Floats) -> tuple[Floats, list[int]]:
        """Return the derivative of the residual by each free number of the pose (n, j), and which they are.

        ``by_angle`` is that of the lobes by the azimuth. (n,) [mm/rad]
        """
        x, y, z = cutting.x, cutting.y, cutting.z
        # Slopes of what was cut, errors and lobes included: they too show where the axis of turning is.
        away = np.maximum(x * x + y * y, CENTRE**2)
        zx, zy = cutting.zx - by_angle * y / away, cutting.zy + by_angle * x / away
        rows = {
            0: -zx, 1: -zy, 2: np.ones_like(x), 3: y * zx - x * zy,
            4: y + zy * z, 5: -x - zx * z,
        }  # fmt: skip
        names = {"piston": (2,), "tilt": (4, 5), "decentre": (0, 1), "clocking": (3,)}
        numbers = [number for name in FREE if name in self.free for number in names[name]]
        if self.sphere is not None and "sphere" in self.free:
            shape = self.sphere + self.pose[6:]
            off = self.z if self.stands is None else self.stands  # no noise in the marks
            for k in range(3):
                step = NUDGE[k] * np.eye(3)[k]
                ends = [on_sphere(shape + side * step, self.x, self.y, off, self.stands) for side in (1, -1)]
                by_x, by_y, by_z = ((high - low) / (2 * NUDGE[k]) for high, low in zip(*ends, strict=True))
                rows[6 + k] = by_z - zx * by_x - zy * by_y
            numbers += [6, 7, 8]
        return np.stack([rows[number] for number in numbers], axis=1) if numbers else np.zeros((x.size, 0)), numbers


def sphere_at(shape: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the root and the height of the sphere through the origin with slopes and curvature (p, q, k)."""
    p, q, k = shape
    squares = k / 2 * (x * x + y * y) + p * x + q * y
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1 - 2 * k * squares)
    return root, 2 * squares / (1 + root)


def on_sphere(shape: Floats, x: Floats, y: Floats, off: Floats, stands: Floats | None) -> tuple[Floats, Floats, Floats]:
    """Return the points that stand ``off`` a sphere: along z, or along its normal if it is said where they should.

    Along the normal a point moves aside with its height. It is moved by what it should have, and the rest, mostly
    noise, is taken along z: noise that moved points aside would be found again in the marks.
    """
    p, q, k = shape
    root, height = sphere_at(shape, x, y)
    if stands is None:
        return x, y, height + off
    zx, zy = (k * x + p) / root, (k * y + q) / root
    lean = np.sqrt(1 + zx * zx + zy * zy)
    return x - stands / lean * zx, y - stands / lean * zy, height + stands / lean + (off - stands) * lean


def sphere_of(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return slopes and curvature (p, q, k) of the sphere of best fit in z."""
    shape: Floats = np.zeros(3)
    size = float(np.hypot(x, y).max())
    for _ in range(50):
        root, height = sphere_at(shape, x, y)
        if np.isnan(root).any():
            shape = 0.5 * shape
            continue
        rows = np.stack([x / root, y / root, (x * x + y * y + height**2) / (2 * root), np.ones_like(x)], axis=1)
        units = np.array([size, size, size**2, 1.0])
        step = np.asarray(np.linalg.lstsq(rows / units, z - height, rcond=1e-12)[0] / units, dtype=np.float64)
        shape = shape + step[:3]
        if np.abs(step[:3] * [1, 1, size]).max() < 1e-13:
            break
    return shape


def sights_of(
    maps: Sequence[HeightMap], parts: Sequence[Part], tool: Tool, free: tuple[str, ...], reference: str, sense: int,
    feed: float,
) -> tuple[list[Sight], float]:  # fmt: skip
    """Return the maps as the fit sees them, and the largest sweep that cuts them, cusps included. [rad]."""
    sights, reach = [], 0.0
    for heights, part in zip(maps, parts, strict=True):
        sight = _sight(heights, part, tool, free, reference, sense, feed)
        if not sight.good.any():
            raise InputError(
                f"0 of {sight.x.size} points of the map {heights.name!r} lie where the planned tool cuts {part.name!r} "
                f"within {part.radius:g} mm: register the map first, and give the tool of the plan"
            )
        reach = max(reach, float(np.abs(sight.sweeps.cut[sight.good]).max()))
        sights.append(sight)
    return sights, max(reach, CUSP)


def _sight(
    heights: HeightMap, part: Part, tool: Tool, free: tuple[str, ...], reference: str, sense: int, feed: float
) -> Sight:
    """Return one map as the fit sees it."""
    where, x, y, z = valid(heights, part)
    swept = Swept(surface=part.surface, tool=tool, sense=sense, rim=part.radius)
    sphere, pose, opened = None, np.zeros(9), free
    if reference != "true form" and x.size > 4:
        design = part.surface.sag(x, y)
        sphere = sphere_of(x, y, design)
        pose[2] = float(np.mean(design - z - _sphere_height(sphere, x, y)))
        opened = (*dict.fromkeys((*free, "piston", "sphere")),)
    sight = Sight(
        x=x, y=y, z=z, swept=swept, sweeps=swept.start(x, y), added={},
        usable=np.ones(x.size, dtype=np.bool_), good=np.ones(x.size, dtype=np.bool_),
        apart=np.zeros(x.size, dtype=np.bool_), free=opened, reference=reference, sphere=sphere, where=where,
        stands=np.zeros(x.size) if reference.endswith("normal") else None,
        cusp=feed * feed / 24, pose=pose, begun=pose.copy(),
    )  # fmt: skip
    at = swept.heights(x, y, sight.sweeps, Deviations())
    with np.errstate(invalid="ignore"):
        sight.usable &= np.isfinite(at.z) & (at.tip_radius > min(CENTRE, 0.02 * part.radius))
    sight.good = sight.usable.copy()
    return sight


def mark(sight: Sight, columns: Columns) -> None:
    """Find the marks that add in proportion."""
    x, y, _ = sight.moved()
    sight.added = columns.added(x, y, lambda: sight.swept.heights(x, y, sight.sweeps, Deviations()))


def valid(heights: HeightMap, part: Part) -> tuple[Bools, Floats, Floats, Floats]:
    """Return which heights are valid and on the part, and those points. The shape of the map, and each (n,) [mm]."""
    x, y = heights.points()
    where = np.isfinite(heights.z) & (np.hypot(x, y) <= part.radius)
    inside = part.surface.inside(np.ascontiguousarray(x), np.ascontiguousarray(y))
    if inside is not None:
        where &= inside
    return where, x[where], y[where], heights.z[where]


def _sphere_height(sphere: Floats, x: Floats, y: Floats) -> Floats:
    return on_sphere(sphere, x, y, np.zeros_like(x), None)[2]
