"""Uncut chip: thickness, width and area of the material that the edge removes.

In the plane of the edge, the chip lies above the current position of the edge and below both the stock and the
surface of earlier revolutions, including those on the other side of the axis. Its thickness is measured normal to the
edge. Formulas: docs/theory/cutting.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, only_read
from turnwright._kernels import chip as kernel, generation as generation_kernel
from turnwright._validate import check_angle, check_numbers, positive
from turnwright.errors import InputError
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from turnwright.machine import Machine
    from turnwright.material import Material
    from turnwright.part import Part
    from turnwright.path import Motion
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = ["ChipMap", "OrthogonalChip", "RoundChip", "chip_map", "expected_thickest", "relative_radius"]

CHUNK_POINTS = 4096
"""Points that a thread processes at a time."""

WINDOW_SAMPLES = 17
"""Samples of the blank across the window of a point; between them a cubic with the exact slopes."""

WINDOW_GROWTH = 1.5
"""Factor by which a window grows if the chip extends beyond it."""

MAX_WINDOWS = 16
"""Growth steps of a window before the chip counts as unbounded."""

COEFFICIENT_NODES = 4001
"""Chip thicknesses of the coefficient table: 230 per factor of e."""

REFERENCE_THICKNESS_MM = 1e-4
"""Thickness at which the factors of rake and azimuth are evaluated; they do not depend on it."""


NOTHING = np.empty(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrthogonalChip:
    """Chip of a straight edge: orthogonal or oblique cutting.

    Parameters
    ----------
    thickness
        Uncut chip thickness, normal to the edge and to the cutting direction. [mm]
    width
        Width of cut, across the cutting direction. [mm]
    inclination
        Inclination of the edge from the normal of the cutting direction; 0 for orthogonal cutting. [rad]

    Raises
    ------
    InputError
        If a length is not positive, or the inclination exceeds 85 deg.

    >>> round(OrthogonalChip(thickness=400e-6, width=0.2, inclination=np.deg2rad(60)).edge_length, 12)
    0.4
    """

    thickness: float
    width: float
    inclination: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.thickness, "the thickness of a chip", "mm")
        positive(self.width, "the width of a chip", "mm")
        check_angle(self.inclination, "the inclination of the edge", -np.deg2rad(85), np.deg2rad(85))

    @property
    def area(self) -> float:
        """Cross-sectional area. [mm²]."""
        return self.thickness * self.width

    @property
    def edge_length(self) -> float:
        """Engaged length of the edge. [mm]."""
        return float(self.width / np.cos(self.inclination))


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundChip:
    """Steady-state chip of a round-nose tool that faces a flat.

    Parameters
    ----------
    nose_radius
        Tool nose radius R. [mm]
    feed
        Feed f per revolution, or step between lines. [mm/rev]
    depth
        Depth of cut d, of the tip below the stock. [mm]

    Raises
    ------
    InputError
        If a length is not positive, the depth is not below the nose radius, or neighbouring revolutions do not meet
        below the stock.

    Examples
    --------
    >>> chip = RoundChip(nose_radius=1.5, feed=0.025, depth=0.025)
    >>> round(chip.thickest * 1e3, 2), round(chip.nominal_thickest * 1e3, 2)   # um
    (4.34, 4.55)
    """

    nose_radius: float
    feed: float
    depth: float

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("nose_radius", "feed", "depth"):
            positive(getattr(self, name), name, "mm")
        if self.depth >= self.nose_radius:
            raise InputError(f"depth must be below {self.nose_radius:g} mm (the nose_radius), got {self.depth:g} mm")
        if self.feed >= 2 * self._reach:
            raise InputError(
                f"feed must be below {2 * self._reach:.4g} mm (neighbouring revolutions must meet below the stock), "
                f"got {self.feed:g} mm: reduce it, or increase the depth of cut"
            )

    @property
    def _reach(self) -> float:
        """Distance from the tip at which the nose meets the stock. [mm]."""
        return float(np.sqrt(self.depth * (2 * self.nose_radius - self.depth)))

    @property
    def sweep(self) -> tuple[float, float]:
        """Ends of the engaged arc (low, high), positive toward the uncut side. [rad]."""
        low = -np.arcsin(self.feed / (2 * self.nose_radius))
        return float(low), float(np.arctan2(self._reach, self.nose_radius - self.depth))

    @property
    def corner(self) -> float:
        """Sweep at which the previous revolution meets the stock, where the chip is thickest. [rad]."""
        return float(np.arctan2(self._reach - self.feed, self.nose_radius - self.depth))

    @property
    def width(self) -> float:
        """Engaged length of the edge. [mm]."""
        low, high = self.sweep
        return self.nose_radius * (high - low)

    @property
    def thickest(self) -> float:
        """Maximum uncut chip thickness, exact. [mm]."""
        return self.nose_radius - float(np.hypot(self._reach - self.feed, self.nose_radius - self.depth))

    @property
    def nominal_thickest(self) -> float:
        """Maximum of the approximation f sin s, at the end of the engaged arc. [mm]."""
        return self.feed * self._reach / self.nose_radius

    @property
    def area(self) -> float:
        """Cross-sectional area, exact: feed times depth minus the area of the cusp. [mm²]."""
        radius, half = self.nose_radius, self.feed / 2
        cusp = 2 * half * radius - half * np.sqrt(radius**2 - half**2) - radius**2 * np.arcsin(half / radius)
        return float(self.feed * self.depth - cusp)

    def thickness(self, sweep: ArrayLike) -> Floats:
        """Return the uncut chip thickness normal to the edge, 0 outside the engaged arc. Any shape [mm]."""
        s = np.asarray(sweep, dtype=np.float64)
        radius, feed = self.nose_radius, self.feed
        # R - sqrt(R² - f²cos²s) without cancellation.
        square = (feed * np.cos(s)) ** 2
        turn = feed * np.sin(s) + square / (radius + np.sqrt(radius**2 - square))
        blank = radius - (radius - self.depth) / np.cos(s)
        return np.maximum(np.minimum(turn, blank), 0.0)

    def nominal(self, sweep: ArrayLike) -> Floats:
        """Return the approximation f sin s from the tip to the end of the engaged arc, else 0. Any shape [mm]."""
        s = np.asarray(sweep, dtype=np.float64)
        return np.where((s >= 0) & (s <= self.sweep[1]), self.feed * np.sin(s), 0.0)


def expected_thickest(tool: Tool, *, feed: float, depth: float, bend: ArrayLike) -> Floats:
    r"""Predict the maximum uncut chip thickness on a surface of given curvature.

    Relative to a surface of curvature :math:`\kappa` the nose acts as a circle of radius
    :math:`r = 1 / (1/R - \kappa)` on a flat, and the contact advances by :math:`f r / R`. The result is the maximum
    of `RoundChip` for that radius and feed.

    Parameters
    ----------
    tool
        Tool that cuts.
    feed, depth
        Feed and depth of cut. [mm/rev], [mm]
    bend
        Curvature of the surface along the radius, positive where it is concave. Any shape [1/mm]

    Returns
    -------
    Floats
        Maximum uncut chip thickness. Shape of ``bend`` [mm]
    """
    flat, radius = tool.actual_radius / np.cos(tool.rake), relative_radius(tool, bend)
    reach = np.sqrt(np.maximum(depth * (2 * radius - depth), 0.0))
    return np.asarray(radius - np.hypot(np.maximum(reach - feed * radius / flat, 0.0), radius - depth))


def relative_radius(tool: Tool, bend: ArrayLike) -> Floats:
    """Return the radius of the nose relative to a surface of some curvature. Any shape [1/mm] to [mm]."""
    flat = tool.actual_radius / np.cos(tool.rake)
    # Where the surface fits the nose, the chip is as thick as the depth of cut; a larger radius changes nothing.
    return np.asarray(1 / np.maximum(1 / flat - np.asarray(bend, dtype=np.float64), 1 / (1e3 * flat)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChipMap:
    """Uncut chip at the points of a motion.

    Parameters
    ----------
    points
        Indices of the points of the motion. (n,)
    angle, x, y
        Azimuth of the part under the tool [rad], and position of the contact in the part frame [mm]. Each (n,)
    inside
        Whether the contact is within the clear aperture and after the first revolution, during which the tool enters.
        (n,)
    thickness
        Maximum uncut chip thickness, normal to the edge. (n,) [mm]
    area
        Cross-sectional area of the chip in the plane through the axis. (n,) [mm²]
    depth
        Depth of the edge below the stock, at the contact. (n,) [mm]
    sweep_low, sweep_high
        Ends of the engaged arc on the nose; nan where nothing is cut. (n,) [rad]
    width
        Engaged length of the edge. (n,) [mm]
    rake
        Effective rake: tool rake minus the slope angle of the surface along the cut. (n,) [rad]
    fracture
        Depth of cracks below the surface that the pass leaves. A crack has the length ``fracture_ratio`` times the
        maximum chip thickness and begins at the lowest point of the edge that is not certainly ductile. (n,) [mm]
    axial, radial, cutting
        Forces on the tool: out of the part, away from the axis, and against the cutting direction; ``None`` if the
        material states no coefficients. Each (n,) [N]
    feed
        Mean feed of the motion. [mm/rev]
    """

    points: Ints
    angle: Floats
    x: Floats
    y: Floats
    inside: Bools
    thickness: Floats
    area: Floats
    depth: Floats
    sweep_low: Floats
    sweep_high: Floats
    width: Floats
    rake: Floats
    fracture: Floats
    feed: float
    axial: Floats | None = None
    radial: Floats | None = None
    cutting: Floats | None = None

    @property
    def thickest(self) -> float:
        """Maximum uncut chip thickness within the clear aperture, after the tool has entered. [mm]."""
        return float(self.thickness[self.inside].max(initial=0.0))

    @property
    def entering(self) -> float:
        """Maximum uncut chip thickness during entry: in the first revolution, and beyond the clear aperture. [mm]."""
        return float(self.thickness[~self.inside].max(initial=0.0))

    @property
    def where(self) -> tuple[float, float]:
        """Position (x, y) of the thickest chip within the clear aperture. [mm]."""
        at = int(np.argmax(np.where(self.inside, self.thickness, -1.0)))
        return float(self.x[at]), float(self.y[at])


class _TipAxes(NamedTuple):
    """Axes of the tool tip, as the kernel expects them."""

    c: Floats
    x: Floats
    z: Floats
    sense: int
    starts: Ints

    @classmethod
    def of(cls, motion: Motion, tool: Tool, machine: Machine | None) -> _TipAxes:
        machine = machine or motion.machine
        if "Y" in motion.axes and motion.axes["Y"].any():
            raise InputError(
                f"Y of the motion must be 0 mm (the chip is computed in the plane through the axis), got up to "
                f"{np.abs(motion.axes['Y']).max():.3g} mm: choose a strategy without Y"
            )
        c, x, z = (motion.axes[letter] for letter in "CXZ")
        dx, _, dz = tool.offset
        z = z + motion.axes.get("W", 0.0) + (machine.z_error(x) + dz)
        x = x + motion.axes.get("U", 0.0) + dx
        starts = np.empty(max(int(np.ceil(abs(c[-1] - c[0]) / (2 * np.pi) - 1e-12)), 1) + 1, dtype=np.int64)
        generation_kernel.turn_starts(c, motion.sense, starts)
        return cls(only_read(c), only_read(x), only_read(z), motion.sense, starts)

    def slope(self, at: Ints) -> Floats:
        """Return the radial slope of the machined surface, from the tips of neighbouring revolutions. (n,)."""
        along = self.c if self.sense > 0 else -self.c
        angle, turn = along[at], 2 * np.pi
        before = np.where(angle - turn >= along[0], angle - turn, angle + turn)
        x, z = np.interp(before, along, self.x) - self.x[at], np.interp(before, along, self.z) - self.z[at]
        usable = (before <= along[-1]) & (np.abs(x) > 1e-9)
        return np.where(usable, np.divide(z, x, where=usable, out=np.zeros_like(z)), 0.0)


def chip_map(
    motion: Motion,
    tool: Tool,
    part: Part,
    *,
    before: Motion | None = None,
    stock: float | None = None,
    material: Material | None = None,
    machine: Machine | None = None,
    points: ArrayLike | None = None,
    progress: Progress | None = None,
) -> ChipMap:
    r"""Compute the uncut chip along a motion, and the forces.

    In the plane through the axis, the chip lies above the edge and below the stock and all earlier revolutions,
    including those on the other side of the axis. The stock is the surface that the pass ``before`` left, with its
    cusps, or the finished surface raised by ``stock``; it ends at the clear aperture. A raked edge counts by its
    projection along the cutting direction. The small angle by which its higher points lead or lag is neglected, as is
    the tool height error.

    Parameters
    ----------
    motion
        Commanded axes, linear between the points.
    tool
        Actual tool, with waviness and radius error; also the tool of ``before``.
    part
        Surface, clear aperture and stock.
    before
        Commanded motion of the previous pass; ``None`` if there is none.
    stock
        Thickness of the blank above the finished surface; by default that of the part. [mm]
    material
        Material with its coefficients and critical thickness; ``None`` for the geometry alone.
    machine
        Actual machine; by default that of the motion.
    points
        Indices of the points of the motion to evaluate; all by default. (n,)
    progress
        Called with (done, total).

    Raises
    ------
    InputError
        If there is neither stock nor a previous pass, the motion moves Y, or the chip is unbounded.

    Sources
    -------
    [Troutman2016]_ ch. 2 takes f sin s. Oracles: dense brute force, circle geometry, removed volume.
    """
    moved = _TipAxes.of(motion, tool, machine)
    stock = part.stock if stock is None else float(stock)
    if before is None and not stock > 0:
        raise InputError("stock must be above 0 mm where there is no previous pass, got 0 mm: nothing would be cut")
    earlier = None if before is None else _TipAxes.of(before, tool, machine)
    at = np.arange(moved.c.size) if points is None else np.asarray(points, dtype=np.int64)
    if at.size and not (at.min() >= 0 and at.max() < moved.c.size):
        raise InputError(f"points must be 0 to {moved.c.size - 1} (those of the motion), got {at.min()} to {at.max()}")
    upright = float(np.cos(tool.rake))
    azimuth = moved.c[at]
    contact = moved.x[at] + tool.cutting_edge().base * np.sin(np.arctan(moved.slope(at) / upright))
    x, y = contact * np.cos(azimuth), contact * np.sin(azimuth)
    rake = tool.rake - _slope_angle(part, moved.sense, azimuth, contact)
    properties = _MaterialTable.of(material, rake, azimuth)
    rows = np.empty((at.size, kernel.ROWS))
    _fill_rows(moved, earlier, tool, part, stock, at, contact, properties, rows, progress)
    if rows[:, kernel.CUT_SHORT].any():
        raise InputError(
            f"the chip does not end at {np.count_nonzero(rows[:, kernel.CUT_SHORT])} points within "
            f"{MAX_WINDOWS} searched widths: check the stock and the nose radius"
        )
    column = [np.ascontiguousarray(rows[:, k]) for k in range(kernel.ROWS)]
    forces = {}
    if properties.cutting.size:
        forces = {"axial": column[kernel.AXIAL], "radial": column[kernel.RADIAL], "cutting": column[kernel.CUTTING]}
    return ChipMap(
        points=at, angle=azimuth, x=x, y=y,
        inside=part.covers(x, y) & (np.abs(azimuth - moved.c[0]) >= 2 * np.pi - 1e-9),
        thickness=column[kernel.THICKEST], area=column[kernel.AREA], depth=column[kernel.DEPTH],
        sweep_low=column[kernel.LOW], sweep_high=column[kernel.HIGH], width=column[kernel.WIDTH],
        rake=rake, fracture=column[kernel.FRACTURE], feed=motion.feed, **forces,
    )  # fmt: skip


class _MaterialTable(NamedTuple):
    """Properties of a material at every point, as the kernel expects them; empty where none are stated."""

    critical: Floats = NOTHING
    safe: float = 1.0  # fraction of the critical thickness that is certainly ductile
    plateau: Floats = NOTHING  # remaining fraction of cutting force and thrust beyond the critical thickness
    ratio: float = 0.0
    cutting: Floats = NOTHING  # coefficients over the logarithm of the thickness
    thrust: Floats = NOTHING
    first: float = 0.0
    step: float = 1.0
    factor: Floats = np.empty((0, 2))  # by rake and azimuth

    @classmethod
    def of(cls, material: Material | None, rake: Floats, angle: Floats) -> _MaterialTable:
        if material is None:
            return cls()
        critical = NOTHING if material.critical is None else material.critical.at(rake=rake, angle=angle)
        safe = 1.0 if material.critical is None else material.critical.safe
        ratio = material.fracture_ratio or 0.0
        if material.cutting is None or material.thrust is None:
            return cls(critical=critical, safe=safe, ratio=ratio)
        coefficients = (material.cutting, material.thrust)
        constant = all(coefficient.constant for coefficient in coefficients)
        logs = np.linspace(np.log(1e-7), 0.0, 1 if constant else COEFFICIENT_NODES)
        cutting, thrust = (coefficient.at(np.exp(logs)) for coefficient in coefficients)
        typical = REFERENCE_THICKNESS_MM
        factor = np.stack(
            [coefficient.at(typical, rake=rake, angle=angle) / coefficient.at(typical) for coefficient in coefficients],
            axis=1,
        )
        step = float(logs[1] - logs[0]) if logs.size > 1 else 1.0
        return cls(
            critical, safe, np.array(material.brittle_force if material.brittle_plateau else ()), ratio,
            cutting, thrust, float(logs[0]), step,
            np.ascontiguousarray(factor),
        )  # fmt: skip


def _fill_rows(
    moved: _TipAxes,
    earlier: _TipAxes | None,
    tool: Tool,
    part: Part,
    stock: float,
    at: Ints,
    contact: Floats,
    properties: _MaterialTable,
    rows: Floats,
    progress: Progress | None,
) -> None:
    """Fill ``rows`` with the chip at the given points; windows grow until they hold the chip."""
    edge = tool.cutting_edge()
    empty = only_read(NOTHING)
    past = earlier or _TipAxes(empty, empty, empty, 1, np.empty(0, dtype=np.int64))
    sides = _initial_windows(moved, tool, stock, at)

    def look(start: int, stop: int) -> None:
        todo = np.arange(start, stop)
        minus, plus = sides[0][todo], sides[1][todo]
        for _ in range(MAX_WINDOWS):
            where, middle = at[todo], contact[todo]
            table, first, step = NOTHING.reshape(0, 2, 0), NOTHING, NOTHING
            if earlier is None:
                table, first, step = _sample_blank(part, stock, moved.c[where], middle, minus, plus)
            out = np.empty((todo.size, kernel.ROWS))
            kernel.chips(
                *moved, where, middle, minus, plus, edge,
                *past, table, first, step, part.reach,
                properties.critical[todo] if properties.critical.size else NOTHING, properties.safe, properties.plateau,
                properties.ratio, properties.cutting, properties.thrust, properties.first, properties.step,
                properties.factor[todo] if properties.factor.size else properties.factor, out,
            )  # fmt: skip
            rows[todo] = out
            short = out[:, kernel.CUT_SHORT] > 0
            if not short.any():
                return
            todo, wider = todo[short], np.maximum(minus, plus)[short] * WINDOW_GROWTH
            minus = plus = wider

    run_chunks(look, at.size, CHUNK_POINTS, progress)


def _initial_windows(moved: _TipAxes, tool: Tool, stock: float, at: Ints) -> tuple[Floats, Floats]:
    """Return the initial widths of the windows toward -X and +X of the contact. Each (n,) [mm].

    They reach a little beyond the end of the stock on a flat; toward the previous revolution, a few feeds.
    """
    radius = tool.actual_radius / np.cos(tool.rake)
    wide = 1.1 * np.sqrt(2 * radius * min(max(stock, 1e-3 * radius), radius / 2))
    along = moved.c if moved.sense > 0 else -moved.c
    first = np.searchsorted(along, along[0] + 2 * np.pi)
    advance = (moved.x[-1] - moved.x[0]) / max(along[-1] - along[0], 1e-9) * 2 * np.pi
    minus, plus = np.full(at.size, wide), np.full(at.size, wide)
    (plus if advance < 0 else minus)[at >= first] = min(3 * abs(advance) + 0.02 * wide, wide)
    return minus, plus


def _slope_angle(part: Part, sense: int, angle: Floats, contact: Floats) -> Floats:
    """Return the slope angle of the surface along the cut; beyond the clear aperture that at its edge. [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    radius = np.clip(contact, -part.reach, part.reach)
    _, zx, zy = part.continuation.evaluate(radius * cosine, radius * sine, 1)
    return np.asarray(np.arctan(sense * (zy * cosine - zx * sine)))


def _sample_blank(
    part: Part, stock: float, angle: Floats, contact: Floats, minus: Floats, plus: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return heights and slopes of the blank along radial lines (n, 2, m), with the start and step of each line."""
    low, high = np.maximum(contact - minus, -part.reach), np.minimum(contact + plus, part.reach)
    high = np.maximum(high, low + 1e-9)
    step = (high - low) / (WINDOW_SAMPLES - 1)
    u = low[:, None] + step[:, None] * np.arange(WINDOW_SAMPLES)
    u = np.clip(u, -part.reach, part.reach)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    z, zx, zy = part.continuation.evaluate(u * cosine, u * sine, 1)
    table = np.empty((angle.size, 2, WINDOW_SAMPLES))
    table[:, 0] = z + stock
    table[:, 1] = zx * cosine + zy * sine
    return table, low, step
