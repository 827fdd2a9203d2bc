r"""The uncut chip: what the edge takes off, as thick and wide as it is.

In the plane of the edge the chip is what lies above the edge where it stands now and below the stock and everything
that earlier passes of the edge have left. Its thickness is measured normal to the edge. For a round nose of radius R
that advances by f per turn over a flat at the depth d, with the sweep s counted toward the uncut side,

.. math::
    t(s) = \min\Bigl( R + f \sin s - \sqrt{R^2 - f^2 \cos^2 s}, \;\; R - \frac{R - d}{\cos s} \Bigr)

which is thickest where the last turn meets the stock,

.. math:: t_\max = R - \sqrt{\bigl(\sqrt{2Rd - d^2} - f\bigr)^2 + (R - d)^2}.

The usual t = f sin s is too thin by :math:`f^2 \cos^2 s / 2R` on the arc, picometres at fine feeds, and calls the chip
thickest where it really ends: too thick by :math:`f^2 (R - d)^2 / 2R^3`, 2 nm of 282 nm at 2 µm per turn on R 1 mm.

Along a freeform path the same is found in the plane through the axis, with every earlier turn that can matter, those
from beyond the axis included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

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

__all__ = ["ChipMap", "OrthogonalChip", "RoundChip", "chip_map"]

CHUNK = 4096
"""Points that one thread takes at a time."""

SAMPLES = 17
"""Heights of the blank over the window of one point; between them it is a cubic with the right slopes."""

WIDER = 1.5
"""What a window grows by when the chip goes on beyond it."""

WIDEST = 16
"""Times that a window may grow before the chip counts as endless."""

FINE = 4001
"""Thicknesses at which coefficients that depend on it are tabled, 230 in a factor of e."""

TYPICAL = 1e-4
"""Thickness at which the factors of rake and azimuth are taken; they do not depend on it. [mm]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrthogonalChip:
    """The chip of a straight edge.

    Parameters
    ----------
    thickness
        Normal to the edge and to the cutting direction. [mm]
    width
        Across the cutting direction. [mm]
    inclination
        Of the edge against the normal of the cutting direction; 0 cuts orthogonally, else obliquely. [rad]

    Raises
    ------
    InputError
        If a length is not positive, or the edge lies along the cutting direction.

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
        """Cross-section. [mm²]."""
        return self.thickness * self.width

    @property
    def edge_length(self) -> float:
        """Engaged length of the edge. [mm]."""
        return float(self.width / np.cos(self.inclination))


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundChip:
    """The chip of a round nose that has turned a flat for many turns.

    Parameters
    ----------
    nose_radius
        R. [mm]
    feed
        f, advance per turn (or step between lines). [mm/rev]
    depth
        d, of the tip below the stock. [mm]

    Raises
    ------
    InputError
        If a length is not positive, the depth is beyond the nose, or turns do not meet below the stock.

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
            raise InputError(
                f"depth is {self.depth:g} mm on a nose_radius of {self.nose_radius:g} mm: reduce it below the radius"
            )
        if self.feed >= 2 * self._reach:
            raise InputError(
                f"feed is {self.feed:g} mm, turns meet below the stock up to {2 * self._reach:.4g} mm: reduce it, or "
                "take more depth"
            )

    @property
    def _reach(self) -> float:
        """How far from the tip the nose meets the stock. [mm]."""
        return float(np.sqrt(self.depth * (2 * self.nose_radius - self.depth)))

    @property
    def sweep(self) -> tuple[float, float]:
        """The engaged arc (lo, hi), positive toward the uncut side. [rad]."""
        low = -np.arcsin(self.feed / (2 * self.nose_radius))
        return float(low), float(np.arctan2(self._reach, self.nose_radius - self.depth))

    @property
    def corner(self) -> float:
        """Sweep at which the last turn meets the stock, where the chip is thickest. [rad]."""
        return float(np.arctan2(self._reach - self.feed, self.nose_radius - self.depth))

    @property
    def width(self) -> float:
        """Engaged length of the edge. [mm]."""
        low, high = self.sweep
        return self.nose_radius * (high - low)

    @property
    def thickest(self) -> float:
        """Greatest thickness, exactly. [mm]."""
        return self.nose_radius - float(np.hypot(self._reach - self.feed, self.nose_radius - self.depth))

    @property
    def nominal_thickest(self) -> float:
        """Greatest thickness by f sin s, at the end of the engaged arc. [mm]."""
        return self.feed * self._reach / self.nose_radius

    @property
    def area(self) -> float:
        """Cross-section, exactly: feed times depth less the cusp that stays. [mm²]."""
        radius, half = self.nose_radius, self.feed / 2
        cusp = 2 * half * radius - half * np.sqrt(radius**2 - half**2) - radius**2 * np.arcsin(half / radius)
        return float(self.feed * self.depth - cusp)

    def thickness(self, sweep: ArrayLike) -> Floats:
        """Return the thickness normal to the edge, 0 outside the engaged arc. Any shape [mm]."""
        s = np.asarray(sweep, dtype=np.float64)
        radius, feed = self.nose_radius, self.feed
        # R - sqrt(R² - f²cos²s) without losing digits.
        square = (feed * np.cos(s)) ** 2
        turn = feed * np.sin(s) + square / (radius + np.sqrt(radius**2 - square))
        blank = radius - (radius - self.depth) / np.cos(s)
        return np.maximum(np.minimum(turn, blank), 0.0)

    def nominal(self, sweep: ArrayLike) -> Floats:
        """Return f sin s, from the tip to where the nose meets the stock. Any shape [mm]."""
        s = np.asarray(sweep, dtype=np.float64)
        return np.where((s >= 0) & (s <= self.sweep[1]), self.feed * np.sin(s), 0.0)


def expected_thickest(tool: Tool, *, feed: float, depth: float, bend: ArrayLike) -> Floats:
    r"""Return the thickest chip to expect on a surface of some curvature, before any path is known.

    Against a curved surface the nose is a circle of radius :math:`1 / (1/R - \kappa)` on a flat, and while the tip
    advances by the feed the contact does so by as much more as that circle is larger: `RoundChip` of both.

    Parameters
    ----------
    tool
        What cuts.
    feed, depth
        Of the pass. [mm/rev], [mm]
    bend
        Curvature along the radius, positive concave. Any shape [1/mm]
    """
    flat = tool.actual_radius / np.cos(tool.rake)
    # Where the surface is as hollow as the nose, the chip is as thick as the cut is deep and no wider curve matters.
    radius = 1 / np.maximum(1 / flat - np.asarray(bend, dtype=np.float64), 1 / (1e3 * flat))
    reach = np.sqrt(np.maximum(depth * (2 * radius - depth), 0.0))
    return np.asarray(radius - np.hypot(np.maximum(reach - feed * radius / flat, 0.0), radius - depth))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChipMap:
    """The uncut chip at the points of a motion.

    Parameters
    ----------
    points
        Numbers of the points of the motion that were looked at. (n,)
    angle, x, y
        Azimuth of the part under the tool [rad], and where in the part frame the edge touches what it leaves. Each (n,)
        [mm]
    inside
        Whether that is within the clear radius, and beyond the first turn: before, the tool only enters. (n,)
    thickness
        Thickest place of the chip, normal to the edge. (n,) [mm]
    area
        Cross-section in the plane through the axis. (n,) [mm²]
    depth
        Of the edge below the stock, at the contact. (n,) [mm]
    sweep_low, sweep_high
        Ends of the engaged arc on the nose; nan where nothing is cut. (n,) [rad]
    width
        Engaged length of the edge. (n,) [mm]
    rake
        Effective rake: that of the tool less the angle at which the surface climbs under it. (n,) [rad]
    fracture
        How deep cracks may reach below the surface that the pass leaves, if one as long as the material says of the
        thickest chip begins at the lowest place of the edge that is not ductile beyond doubt. (n,) [mm]
    axial, radial, cutting
        Force on the tool out of the part, away from the axis, and against its motion over the part; ``None`` where the
        material states no coefficients. Each (n,) [N]
    feed
        Mean advance per turn of the motion. [mm/rev]
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
        """Greatest thickness within the clear radius, once the tool has entered. [mm]."""
        return float(self.thickness[self.inside].max(initial=0.0))

    @property
    def entering(self) -> float:
        """Greatest thickness while the tool enters: on the first turn, which none bounds, and at the rim. [mm]."""
        return float(self.thickness[~self.inside].max(initial=0.0))

    @property
    def where(self) -> tuple[float, float]:
        """Where on the part the chip is thickest (x, y). [mm]."""
        at = int(np.argmax(np.where(self.inside, self.thickness, -1.0)))
        return float(self.x[at]), float(self.y[at])


@dataclass(frozen=True, slots=True)
class _Moved:
    """A motion as the kernel takes it."""

    c: Floats
    x: Floats
    z: Floats
    sense: int
    starts: Ints

    @classmethod
    def of(cls, motion: Motion, tool: Tool, machine: Machine | None) -> _Moved:
        machine = machine or motion.machine
        if "Y" in motion.axes and motion.axes["Y"].any():
            raise InputError(
                f"the tip moves up to {np.abs(motion.axes['Y']).max():.3g} mm in Y, the chip is found at 0 mm, in the "
                "plane through the axis: take a strategy without Y"
            )
        c, x, z = (motion.axes[letter] for letter in "CXZ")
        error = machine.z_error(x) if machine.squareness or machine.straightness is not None else None
        if "U" in motion.axes:
            x = x + motion.axes["U"]
        if "W" in motion.axes:
            z = z + motion.axes["W"]
        dx, _, dz = tool.offset
        starts = np.empty(max(int(np.ceil(abs(c[-1] - c[0]) / (2 * np.pi) - 1e-12)), 1) + 1, dtype=np.int64)
        generation_kernel.turn_starts(c, motion.sense, starts)
        if dx:
            x = x + dx
        if dz or error is not None:
            z = z + ((0.0 if error is None else error) + dz)
        return cls(only_read(c), only_read(x), only_read(z), motion.sense, starts)

    def slope(self, at: Ints) -> Floats:
        """Radial slope of what is left at some points: that between the tips of neighbouring turns. (n,)."""
        along = self.c if self.sense > 0 else -self.c
        here, turn = along[at], 2 * np.pi
        before = np.where(here - turn >= along[0], here - turn, here + turn)
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
    r"""Return the uncut chip along a motion, with the forces that act.

    In the plane through the axis the chip lies above the edge and below the stock, the turns before and those from
    beyond the axis. The stock is what the pass ``before`` left, cusp by cusp, or the finished surface raised by
    ``stock``; it ends at the clear radius of the part. A raked edge counts as it looks along the cutting direction; the
    small turn by which its higher places lead or lag is left out, as is a tip above or below centre.

    Parameters
    ----------
    motion
        Commanded axes, linear between the points.
    tool
        The actual tool, its waviness and radius error included; ``before`` is cut with the same.
    part
        Where the material ends, and what the blank is made of.
    before
        Motion of the pass before, as commanded; ``None`` if there was none.
    stock
        Thickness of the blank above the finished surface; that of the part if not given. [mm]
    material
        Whose coefficients and critical thickness are used; ``None`` for the geometry alone.
    machine
        The actual machine; by default the one the motion was made for.
    points
        Numbers of the points of the motion to look at; all if not given. (n,)
    progress
        Called with (done, total).

    Raises
    ------
    InputError
        If there is neither stock nor a pass before, the tip leaves the centre, or the chip has no end.

    Sources
    -------
    [Troutman2016]_ ch. 2 takes f sin s. Oracles: dense brute force, circle geometry, removed volume.
    """
    moved = _Moved.of(motion, tool, machine)
    stock = part.stock if stock is None else float(stock)
    if before is None and not stock > 0:
        raise InputError("the blank has a stock of 0 mm and there was no pass before, so nothing is cut: state one")
    earlier = None if before is None else _Moved.of(before, tool, machine)
    at = np.arange(moved.c.size) if points is None else np.asarray(points, dtype=np.int64)
    if at.size and not (at.min() >= 0 and at.max() < moved.c.size):
        raise InputError(f"points go from {at.min()} to {at.max()}, a motion has 0 to {moved.c.size - 1}: choose those")
    upright = float(np.cos(tool.rake))
    azimuth = moved.c[at]
    contact = moved.x[at] + tool.cutting_edge().base * np.sin(np.arctan(moved.slope(at) / upright))
    x, y = contact * np.cos(azimuth), contact * np.sin(azimuth)
    rake = tool.rake - _climb(part, moved.sense, azimuth, contact)
    said = _Said.of(material, rake, azimuth)
    rows = np.empty((at.size, kernel.ROWS))
    _look(moved, earlier, tool, part, stock, at, contact, said, rows, progress)
    if rows[:, kernel.CUT_SHORT].any():
        raise InputError(
            f"at {np.count_nonzero(rows[:, kernel.CUT_SHORT])} points the edge does not leave the stock within the "
            f"limit of {WIDEST} windows: check the stock and the nose radius"
        )
    column = [np.ascontiguousarray(rows[:, k]) for k in range(kernel.ROWS)]
    forces = {}
    if said.cutting.size:
        forces = {"axial": column[kernel.AXIAL], "radial": column[kernel.RADIAL], "cutting": column[kernel.CUTTING]}
    return ChipMap(
        points=at, angle=azimuth, x=x, y=y,
        inside=(np.abs(contact) <= part.radius) & (np.abs(azimuth - moved.c[0]) >= 2 * np.pi - 1e-9),
        thickness=column[kernel.THICKEST], area=column[kernel.AREA], depth=column[kernel.DEPTH],
        sweep_low=column[kernel.LOW], sweep_high=column[kernel.HIGH], width=column[kernel.WIDTH],
        rake=rake, fracture=column[kernel.FRACTURE], feed=motion.feed, **forces,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Said:
    """What a material says of every point, as the kernel takes it; empty where it says nothing."""

    critical: Floats
    safe: float  # share of the critical thickness that is ductile beyond doubt
    plateau: Floats  # shares of cutting force and thrust that remain beyond the critical thickness; empty for none
    ratio: float
    cutting: Floats  # both coefficients over the logarithm of the thickness
    thrust: Floats
    first: float
    step: float
    factor: Floats  # (n, 2) by rake and azimuth

    @classmethod
    def of(cls, material: Material | None, rake: Floats, angle: Floats) -> _Said:
        nothing = np.empty(0)
        if material is None:
            return cls(nothing, 1.0, nothing, 0.0, nothing, nothing, 0.0, 1.0, np.empty((0, 2)))
        critical = nothing if material.critical is None else material.critical.at(rake=rake, angle=angle)
        safe = 1.0 if material.critical is None else material.critical.safe
        ratio = material.fracture_ratio or 0.0
        if material.cutting is None or material.thrust is None:
            return cls(critical, safe, nothing, ratio, nothing, nothing, 0.0, 1.0, np.empty((0, 2)))
        both = (material.cutting, material.thrust)
        logs = np.linspace(np.log(1e-7), 0.0, 1 if all(one.constant for one in both) else FINE)
        cutting, thrust = (one.at(np.exp(logs)) for one in both)
        factor = np.stack([one.at(TYPICAL, rake=rake, angle=angle) / one.at(TYPICAL) for one in both], axis=1)
        step = float(logs[1] - logs[0]) if logs.size > 1 else 1.0
        return cls(
            critical, safe, np.array(material.brittle_force if material.brittle_plateau else ()), ratio,
            cutting, thrust, float(logs[0]), step,
            np.ascontiguousarray(factor),
        )  # fmt: skip


def _look(
    moved: _Moved,
    earlier: _Moved | None,
    tool: Tool,
    part: Part,
    stock: float,
    at: Ints,
    contact: Floats,
    said: _Said,
    rows: Floats,
    progress: Progress | None,
) -> None:
    """Fill ``rows`` with the chip at some points, widening the windows of those whose chip goes on beyond."""
    edge = tool.cutting_edge()
    nothing = np.empty(0)
    past = (only_read(nothing), only_read(nothing), only_read(nothing), 1, np.empty(0, dtype=np.int64))
    if earlier is not None:
        past = (earlier.c, earlier.x, earlier.z, earlier.sense, earlier.starts)
    sides = _windows(moved, tool, stock, at)

    def look(start: int, stop: int) -> None:
        todo = np.arange(start, stop)
        left, right = sides[0][todo], sides[1][todo]
        for _ in range(WIDEST):
            where, middle = at[todo], contact[todo]
            table, first, step = nothing.reshape(0, 2, 0), nothing, nothing
            if earlier is None:
                table, first, step = _blank(part, stock, moved.c[where], middle, left, right)
            out = np.empty((todo.size, kernel.ROWS))
            kernel.chips(
                moved.c, moved.x, moved.z, moved.sense, moved.starts, where, middle, left, right, edge,
                *past, table, first, step, part.radius, said.critical[todo] if said.critical.size else nothing,
                said.safe, said.plateau, said.ratio, said.cutting, said.thrust, said.first, said.step,
                said.factor[todo] if said.factor.size else said.factor, out,
            )  # fmt: skip
            rows[todo] = out
            short = out[:, kernel.CUT_SHORT] > 0
            if not short.any():
                return
            todo, wider = todo[short], np.maximum(left, right)[short] * WIDER
            left = right = wider

    run_chunks(look, at.size, CHUNK, progress)


def _windows(moved: _Moved, tool: Tool, stock: float, at: Ints) -> tuple[Floats, Floats]:
    """Return how far to begin with the chip is looked for toward -X and +X of the contact. Each (n,) [mm].

    That is where the stock ends on a flat, and a little more; toward the turn before, only a few feeds.
    """
    radius = tool.actual_radius / np.cos(tool.rake)
    wide = 1.1 * np.sqrt(2 * radius * min(max(stock, 1e-3 * radius), radius / 2))
    along = moved.c if moved.sense > 0 else -moved.c
    first = np.searchsorted(along, along[0] + 2 * np.pi)
    advance = (moved.x[-1] - moved.x[0]) / max(along[-1] - along[0], 1e-9) * 2 * np.pi
    left, right = np.full(at.size, wide), np.full(at.size, wide)
    (right if advance < 0 else left)[at >= first] = min(3 * abs(advance) + 0.02 * wide, wide)
    return left, right


def _climb(part: Part, sense: int, angle: Floats, contact: Floats) -> Floats:
    """Return the angle at which the surface climbs under the edge; beyond the clear radius that at its rim. [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    held = np.clip(contact, -part.radius, part.radius)
    _, zx, zy = part.surface.evaluate(held * cosine, held * sine, 1)
    return np.asarray(np.arctan(sense * (zy * cosine - zx * sine)))


def _blank(
    part: Part, stock: float, angle: Floats, contact: Floats, left: Floats, right: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return heights and slopes of the blank along radial lines, (n, 2, m), where each begins and its steps."""
    low, high = np.maximum(contact - left, -part.radius), np.minimum(contact + right, part.radius)
    high = np.maximum(high, low + 1e-9)
    step = (high - low) / (SAMPLES - 1)
    u = low[:, None] + step[:, None] * np.arange(SAMPLES)
    u = np.clip(u, -part.radius, part.radius)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    z, zx, zy = part.surface.evaluate(u * cosine, u * sine, 1)
    table = np.empty((angle.size, 2, SAMPLES))
    table[:, 0] = z + stock
    table[:, 1] = zx * cosine + zy * sine
    return table, low, step
