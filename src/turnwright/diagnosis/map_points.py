"""A measured map in the fit: its points, where they were cut, and its pose."""

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
    from turnwright.diagnosis.error_sources import Columns
    from turnwright.heightmap import HeightMap
    from turnwright.part import Part
    from turnwright.tool import Tool

__all__ = ["CENTRE_ZONE_MM", "FREE", "MapPoints", "add_signatures", "prepare_maps", "select_valid"]

CENTRE_ZONE_MM = 0.05
"""Closer to the axis than this, the real tool may cut on its far side."""

MIN_SWEEP_RAD = 0.01
"""Least sweep that cuts: about half the arc of a nose that a feed uses on a plane."""

FREE = ("piston", "tilt", "decentre", "clocking")
"""Degrees of freedom that registration determines only approximately."""

SPHERE_STEPS = (1e-6, 1e-6, 1e-7)
"""Steps in slopes and curvature of a sphere for numerical derivatives."""


@dataclass(slots=True, kw_only=True, eq=False)
class MapPoints:
    """One measured map in the fit: its points, and the places on the nose that cut them.

    ``x``, ``y``, ``z`` are the valid points. For a deviation from a sphere, ``sphere`` is that of the design: slopes at
    the axis and curvature (p, q, k).
    """

    x: Floats
    y: Floats
    z: Floats
    swept: Swept
    sweeps: Sweeps
    added: dict[str, Floats]
    usable: Bools  # points that the planned tool cuts
    good: Bools  # points in the fit
    outliers: Bools
    free: tuple[str, ...]
    reference: str
    where: Bools  # mask of these points in the map
    sphere: Floats | None
    along_normal: Floats | None  # current estimate of the deviation along the normal of the points [mm]
    cusp: float  # mean height of the cusps per curvature between the passes [mm²]
    pose: Floats  # shift x, y, z, rotation, tilts [mm, rad]; and (p, q, k) beyond those of the design's sphere
    start_pose: Floats

    @property
    def motion(self) -> Pose:
        """The rigid part of the current pose."""
        return Pose.within_a_turn(self.pose[:3].tolist(), self.pose[3], self.pose[4:6])

    def moved(self) -> tuple[Floats, Floats, Floats]:
        """Return the points in the frame of the part, by the current pose."""
        x, y, z = self.x, self.y, self.z
        if self.sphere is not None:
            x, y, z = put_on_sphere(self.sphere + self.pose[6:], x, y, z, self.along_normal)
        return self.motion.apply(x, y, z)

    def cut(self, deviations: Deviations) -> tuple[Floats, Cutting]:
        """Return the measured minus the predicted height for some deviations, and how the points were cut."""
        x, y, z = self.moved()
        # Points without a contact for the previous deviations may have one for these.
        lost = self.usable & np.isnan(self.sweeps.cut)
        if lost.any():
            for cached, again in zip(self.sweeps, self.swept.guess(x[lost], y[lost]), strict=True):
                cached[lost] = again
        cutting = self.swept.heights(x, y, self.sweeps, deviations)
        residual = z - cutting.z - self.cusp * cutting.between
        if self.along_normal is not None:
            self.along_normal = self.z - np.nan_to_num(residual) / np.sqrt(1 + cutting.zx**2 + cutting.zy**2)
        return residual, cutting

    def nuisances(self, cutting: Cutting, by_angle: Floats) -> tuple[Floats, list[int]]:
        """Return the derivative of the residual by each free unknown of the pose (n, j), and their indices.

        ``by_angle`` is that of the lobes by the azimuth. (n,) [mm/rad]
        """
        x, y, z = cutting.x, cutting.y, cutting.z
        # Slopes of the cut surface, errors and lobes included, as these too locate the axis of turning.
        away = np.maximum(x * x + y * y, CENTRE_ZONE_MM**2)
        zx, zy = cutting.zx - by_angle * y / away, cutting.zy + by_angle * x / away
        rows = {
            0: -zx, 1: -zy, 2: np.ones_like(x), 3: y * zx - x * zy,
            4: y + zy * z, 5: -x - zx * z,
        }  # fmt: skip
        names = {"piston": (2,), "tilt": (4, 5), "decentre": (0, 1), "clocking": (3,)}
        numbers = [number for name in FREE if name in self.free for number in names[name]]
        if self.sphere is not None and "sphere" in self.free:
            shape = self.sphere + self.pose[6:]
            off = self.z if self.along_normal is None else self.along_normal  # no noise in the signatures
            for k in range(3):
                step = SPHERE_STEPS[k] * np.eye(3)[k]
                ends = [put_on_sphere(shape + side * step, self.x, self.y, off, self.along_normal) for side in (1, -1)]
                by_x, by_y, by_z = ((high - low) / (2 * SPHERE_STEPS[k]) for high, low in zip(*ends, strict=True))
                rows[6 + k] = by_z - zx * by_x - zy * by_y
            numbers += [6, 7, 8]
        return np.stack([rows[number] for number in numbers], axis=1) if numbers else np.zeros((x.size, 0)), numbers


def evaluate_sphere(shape: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the root and the height of the sphere through the origin with slopes and curvature (p, q, k)."""
    p, q, k = shape
    squares = k / 2 * (x * x + y * y) + p * x + q * y
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1 - 2 * k * squares)
    return root, 2 * squares / (1 + root)


def put_on_sphere(
    shape: Floats, x: Floats, y: Floats, off: Floats, along_normal: Floats | None
) -> tuple[Floats, Floats, Floats]:
    """Return the points at the deviation ``off`` from a sphere: along z, or with ``along_normal`` along its normal.

    Along the normal, the lateral position of a point depends on its deviation. It is computed from the expected
    deviation ``along_normal``; the difference, mostly noise, is taken along z. Otherwise noise in the lateral position
    would bias the signatures.
    """
    p, q, k = shape
    root, height = evaluate_sphere(shape, x, y)
    if along_normal is None:
        return x, y, height + off
    zx, zy = (k * x + p) / root, (k * y + q) / root
    lean = np.sqrt(1 + zx * zx + zy * zy)
    out = along_normal / lean
    return x - out * zx, y - out * zy, height + out + (off - along_normal) * lean


def fit_sphere(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return slopes and curvature (p, q, k) of the sphere of best fit in z."""
    shape: Floats = np.zeros(3)
    size = float(np.hypot(x, y).max())
    for _ in range(50):
        root, height = evaluate_sphere(shape, x, y)
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


def prepare_maps(
    maps: Sequence[HeightMap], parts: Sequence[Part], tool: Tool, free: tuple[str, ...], reference: str, sense: int,
    feed: float,
) -> tuple[list[MapPoints], float]:  # fmt: skip
    """Return the maps prepared for the fit, and the largest sweep that cuts them, cusps included. [rad]."""
    all_points, reach = [], 0.0
    for heights, part in zip(maps, parts, strict=True):
        map_points = _prepare_map(heights, part, tool, free, reference, sense, feed)
        if not map_points.good.any():
            raise InputError(
                f"0 of {map_points.x.size} points of the map {heights.name!r} lie where the planned tool cuts "
                f"{part.name!r} within {part.reach:g} mm: register the map first, and use the tool of the plan"
            )
        reach = max(reach, float(np.abs(map_points.sweeps.cut[map_points.good]).max()))
        all_points.append(map_points)
    return all_points, max(reach, MIN_SWEEP_RAD)


def _prepare_map(
    heights: HeightMap, part: Part, tool: Tool, free: tuple[str, ...], reference: str, sense: int, feed: float
) -> MapPoints:
    where, x, y, z = select_valid(heights, part)
    swept = Swept(surface=part.continuation, tool=tool, sense=sense, rim=part.reach)
    sphere, pose, opened = None, np.zeros(9), free
    if reference != "true form" and x.size > 4:
        design = part.surface.sag(x, y)
        sphere = fit_sphere(x, y, design)
        pose[2] = float(np.mean(design - z - evaluate_sphere(sphere, x, y)[1]))
        opened = (*dict.fromkeys((*free, "piston", "sphere")),)
    map_points = MapPoints(
        x=x, y=y, z=z, swept=swept, sweeps=swept.start(x, y), added={},
        usable=np.ones(x.size, dtype=np.bool_), good=np.ones(x.size, dtype=np.bool_),
        outliers=np.zeros(x.size, dtype=np.bool_), free=opened, reference=reference, sphere=sphere, where=where,
        along_normal=np.zeros(x.size) if reference.endswith("normal") else None,
        cusp=feed * feed / 24, pose=pose, start_pose=pose.copy(),
    )  # fmt: skip
    at = swept.heights(x, y, map_points.sweeps, Deviations())
    with np.errstate(invalid="ignore"):
        map_points.usable &= np.isfinite(at.z) & (at.tip_radius > min(CENTRE_ZONE_MM, 0.02 * part.reach))
    map_points.good = map_points.usable.copy()
    return map_points


def add_signatures(map_points: MapPoints, columns: Columns) -> None:
    """Compute the signatures that add in proportion."""
    x, y, _ = map_points.moved()
    map_points.added = columns.added(x, y, lambda: map_points.swept.heights(x, y, map_points.sweeps, Deviations()))


def select_valid(heights: HeightMap, part: Part) -> tuple[Bools, Floats, Floats, Floats]:
    """Return the mask of heights that are valid and on the part (shape of the map), and those points. (n,) [mm]."""
    x, y = heights.points()
    where = np.isfinite(heights.z) & part.covers(x, y)
    inside = part.surface.inside(np.ascontiguousarray(x), np.ascontiguousarray(y))
    if inside is not None:
        where &= inside
    return where, x[where], y[where], heights.z[where]
