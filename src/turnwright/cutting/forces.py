r"""Cutting forces, integrated over the elements of the edge.

An element that cuts the chip area :math:`dA = t\,(R - t/2)\,ds` takes the force Kc dA against the cutting direction and
Kt dA along its normal, in the plane of the edge. On a round nose the normal at the sweep s is inclined by s.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from turnwright._arrays import Floats, frozen, gauss_rule
from turnwright._tables import TableModel
from turnwright._validate import between, check_angle, check_numbers, positive, whole_number
from turnwright.cutting.chip import OrthogonalChip, RoundChip
from turnwright.errors import InputError
from turnwright.units import Angle, Count, Feed, Length

if TYPE_CHECKING:
    from turnwright.material import CuttingCoefficient, Material

__all__ = ["CuttingForces", "FlyCut", "ForceHistory", "SlotMill", "chip_forces"]

EDGE_NODES = 48
"""Gauss-Legendre nodes on each smooth piece of an edge in a steady cut."""

CORNER_NODES = 24
"""Gauss-Legendre nodes along a round corner, at every instant of an interrupted cut."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CuttingForces:
    """Forces on the tool in a steady cut.

    Parameters
    ----------
    axial
        Force out of the part, along the spindle axis in face turning. [N]
    feed
        Force against the feed, away from the uncut side. [N]
    cutting
        Force against the cutting direction. [N]
    axial_uncertainty, feed_uncertainty, cutting_uncertainty
        Standard uncertainties from those of the coefficients; ``None`` if the material states none. [N]
    """

    axial: float
    feed: float
    cutting: float
    axial_uncertainty: float | None = None
    feed_uncertainty: float | None = None
    cutting_uncertainty: float | None = None

    @property
    def resultant(self) -> float:
        """Magnitude of the force. [N]."""
        return float(np.sqrt(self.axial**2 + self.feed**2 + self.cutting**2))

    @property
    def direction(self) -> tuple[float, float]:
        """Angles of the resultant from the cutting direction, and of its thrust from the spindle axis. [rad]."""
        thrust = np.hypot(self.axial, self.feed)
        return float(np.arctan2(thrust, self.cutting)), float(np.arctan2(self.feed, self.axial))

    def power(self, speed: float) -> float:
        """Return the cutting power at a cutting speed [mm/s]. [mW]."""
        return self.cutting * positive(speed, "the cutting speed", "mm/s")


def chip_forces(
    chip: OrthogonalChip | RoundChip,
    material: Material,
    *,
    rake: float = 0.0,
    angle: float = 0.0,
    nominal: bool = False,
) -> CuttingForces:
    """Compute the forces of a steady cut.

    Parameters
    ----------
    chip
        Chip of a straight edge, whose thrust is entirely axial, or of a round nose.
    material
        Material with force coefficients, and a plateau beyond the critical thickness if it has one.
    rake, angle
        Effective rake and azimuth of the part, for a material that depends on them. [rad]
    nominal
        Whether to use the approximation f sin s of published models for a round chip, instead of the exact thickness.

    Raises
    ------
    InputError
        If the material states no coefficients.

    Sources
    -------
    [Troutman2016]_ ch. 2 for the nominal chip. Oracles: closed form, mpmath.

    >>> from turnwright.material import Material
    >>> chip = RoundChip(nose_radius=1.0, feed=0.002, depth=0.010)
    >>> forces = chip_forces(chip, Material.load("irg26"), nominal=True)
    >>> [round(1e3 * force, 2) for force in (forces.axial, forces.feed, forces.cutting)]   # mN
    [16.24, 1.54, 29.78]
    """
    if isinstance(chip, OrthogonalChip):
        cutting, thrust = material.coefficients(chip.thickness, rake=rake, angle=angle)
        return _with_uncertainty(material, float(thrust) * chip.area, 0.0, float(cutting) * chip.area)
    radius = chip.nose_radius
    low, high = chip.sweep
    ends = (0.0, high) if nominal else (low, chip.corner, high)
    limit = None if material.critical is None else float(material.critical.at(rake=rake, angle=angle))
    if material.brittle_plateau and limit is not None:
        ends = tuple(sorted((*ends, *_limit_sweeps(chip, limit, nominal))))
    total = np.zeros(3)
    for first, last in pairwise(ends):
        s, weight = _gauss_legendre(first, last)
        t = chip.nominal(s) if nominal else chip.thickness(s)
        area = t * radius if nominal else t * (radius - t / 2)
        cutting, thrust = material.coefficients(t, rake=rake, angle=angle)
        element = weight * area
        total += (thrust * np.cos(s)) @ element, (thrust * np.sin(s)) @ element, cutting @ element
    return _with_uncertainty(material, *(float(force) for force in total))


def _with_uncertainty(material: Material, axial: float, feed: float, cutting: float) -> CuttingForces:
    def uncertainty(coefficient: CuttingCoefficient | None, force: float) -> float | None:
        if coefficient is None or coefficient.uncertainty is None:
            return None
        return coefficient.uncertainty / coefficient.value * abs(force)

    return CuttingForces(
        axial=axial, feed=feed, cutting=cutting,
        axial_uncertainty=uncertainty(material.thrust, axial), feed_uncertainty=uncertainty(material.thrust, feed),
        cutting_uncertainty=uncertainty(material.cutting, cutting),
    )  # fmt: skip


def _gauss_legendre(first: float, last: float, nodes: int = EDGE_NODES) -> tuple[Floats, Floats]:
    x, weight = gauss_rule(nodes)
    half = (last - first) / 2
    return (first + last) / 2 + half * x, half * weight


def _limit_sweeps(chip: RoundChip, limit: float, nominal: bool) -> tuple[float, ...]:
    """Return the sweeps at which the chip is as thick as the limit: the forces have a slope discontinuity there."""
    from scipy.optimize import brentq  # noqa: PLC0415 - costly to import

    low, high = chip.sweep
    spans = ((0.0, high),) if nominal else ((low, chip.corner), (chip.corner, high))
    at = chip.nominal if nominal else chip.thickness

    def excess(sweep: float) -> float:
        return float(at(sweep)) - limit

    inside = [(first + 1e-12, last - 1e-12) for first, last in spans]
    crossing = [ends for ends in inside if (excess(ends[0]) > 0) != (excess(ends[1]) > 0)]
    return tuple(float(brentq(excess, *ends, xtol=1e-15, rtol=1e-15)) for ends in crossing)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceHistory:
    """Forces of an interrupted cut over time, as measured by a dynamometer under the part.

    Parameters
    ----------
    time
        Time since the entry of the first tooth. (n,) [s]
    angle
        Rotation of the cutter since then. (n,) [rad]
    x, y, z
        Force on the part across the feed, along the feed, and into the part. Each (n,) [N]
    thickness
        Maximum uncut chip thickness at each instant; 0 where no tooth cuts. (n,) [mm]
    torque
        Torque about the axis of the cutter. (n,) [N mm]
    speed
        Spindle speed. [rad/s]
    """

    time: Floats
    angle: Floats
    x: Floats
    y: Floats
    z: Floats
    thickness: Floats
    torque: Floats
    speed: float

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("time", "angle", "x", "y", "z", "thickness", "torque"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))

    @property
    def engaged(self) -> float:
        """Fraction of the time during which a tooth cuts."""
        return float((self.thickness > 0).mean())

    @property
    def power(self) -> Floats:
        """Cutting power at each instant. (n,) [mW]."""
        return np.asarray(self.torque * self.speed)


ForceColumns = tuple[Floats, Floats, Floats, Floats, Floats]
"""x, y, z, thickness and torque of a `ForceHistory`."""


class _InterruptedCut(TableModel):
    """Cut of a rotating tool, with the forces over its revolutions."""

    __slots__ = ()

    usual_samples: ClassVar[int]
    """Samples per revolution by default."""

    def forces(
        self, material: Material, *, spindle_rpm: float, turns: float = 1.0, samples: int | None = None
    ) -> ForceHistory:
        """Compute the forces on the part over time.

        Parameters
        ----------
        material
            Material with force coefficients.
        spindle_rpm
            Spindle speed. [rev/min]
        turns
            Revolutions to compute. At time 0 the first tooth enters a full slot; a fly-cutter is opposite the part.
        samples
            Samples per revolution; by default 3600, or 36000 in fly-cutting.
        """
        speed = positive(spindle_rpm, "spindle_rpm", "rev/min") * 2 * np.pi / 60
        samples = samples or self.usual_samples
        angle = 2 * np.pi * np.arange(max(int(positive(turns, "turns", "rev") * samples), 1) + 1) / samples
        x, y, z, thickness, torque = self._force_columns(material, angle)
        return ForceHistory(
            time=angle / speed, angle=angle, x=x, y=y, z=z, thickness=thickness, torque=torque, speed=speed
        )

    @abstractmethod
    def _force_columns(self, material: Material, turned: Floats) -> ForceColumns: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotMill(_InterruptedCut):
    r"""Milling about an axis normal to the part: a full slot, or any arc of engagement.

    The cutter is fed toward +y. A tooth at the angle :math:`\varphi` from the start of a full slot has the direction
    :math:`(-\cos\varphi, \sin\varphi)` from the cutter axis and cuts along :math:`(\sin\varphi, \cos\varphi)`. On the
    cylindrical wall its chip thickness is

    .. math:: t(\varphi) = R + f \sin\varphi - \sqrt{R^2 - f^2\cos^2\varphi} \approx f \sin\varphi

    and on a round corner, at the sweep s from the tip, t sin s. Each tooth presses on the part with Kc along its motion
    and Kt along its outward normal. On the wall the force across the feed is
    :math:`F_x = t w (K_c \sin\varphi - K_t \cos\varphi)`, with the maximum
    :math:`\tfrac12 f w (K_c + \sqrt{K_c^2 + K_t^2})`.

    Parameters
    ----------
    radius
        Radius R of the cutter. [mm]
    feed_per_tooth
        Feed per tooth f. [mm]
    depth
        Axial depth of cut w. [mm]
    teeth
        Number of equally spaced teeth.
    corner_radius
        Corner radius: 0 for a square end mill, up to ``radius`` for a ball end mill. [mm]
    entry, exit
        Angles at which a tooth enters and leaves the cut; 0 and 180 deg for a full slot. [rad]

    Raises
    ------
    InputError
        If a length is not positive, or the arc of engagement is not within 0 to 180 deg.
    """

    usual_samples: ClassVar[int] = 3600

    radius: Length
    feed_per_tooth: Length
    depth: Length
    teeth: Count = 1
    corner_radius: Length = 0.0
    entry: Angle = 0.0
    exit: Angle = np.pi

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("radius", "feed_per_tooth", "depth"):
            positive(getattr(self, name), name, "mm")
        between(self.corner_radius, "corner_radius", 0.0, self.radius, "mm")
        if self.feed_per_tooth >= self.radius:
            raise InputError(
                f"feed_per_tooth must be below {self.radius:g} mm (the radius), got {self.feed_per_tooth:g} mm"
            )
        object.__setattr__(self, "teeth", whole_number(self.teeth, "teeth", 1))
        for name in ("entry", "exit"):
            check_angle(getattr(self, name), name, 0.0, np.pi + 1e-12)
        if not self.entry < self.exit:
            raise InputError(
                f"entry must be before exit, got {np.rad2deg(self.entry):g} deg and {np.rad2deg(self.exit):g} deg"
            )

    def thickness(self, angle: Floats | float) -> Floats:
        """Return the uncut chip thickness on the wall at tooth angles; 0 where the tooth does not cut. [mm]."""
        phi = np.mod(np.asarray(angle, dtype=np.float64), 2 * np.pi)
        square = (self.feed_per_tooth * np.cos(phi)) ** 2
        t = self.feed_per_tooth * np.sin(phi) + square / (self.radius + np.sqrt(self.radius**2 - square))
        return np.where((phi >= self.entry) & (phi <= self.exit), np.maximum(t, 0.0), 0.0)

    def _force_columns(self, material: Material, turned: Floats) -> ForceColumns:
        arc = 0.0
        if self.corner_radius:
            arc = float(np.arccos(1 - min(self.depth / self.corner_radius, 1.0)))
        s, weight = _gauss_legendre(0.0, arc, CORNER_NODES) if arc else (np.empty(0), np.empty(0))
        wall = max(self.depth - self.corner_radius, 0.0)
        x, y, z, torque, thickest = (np.zeros(turned.size) for _ in range(5))
        for tooth in range(self.teeth):
            phi = np.mod(turned - tooth * 2 * np.pi / self.teeth, 2 * np.pi)
            t = self.thickness(phi)
            along, outward, down = _edge_forces(material, t, np.pi / 2, wall)
            for sweep, width in zip(s, weight * self.corner_radius, strict=True):
                strip = _edge_forces(material, t * np.sin(sweep), sweep, width)
                along, outward, down = along + strip[0], outward + strip[1], down + strip[2]
            x += along * np.sin(phi) - outward * np.cos(phi)
            y += along * np.cos(phi) + outward * np.sin(phi)
            z += down
            torque += along * self.radius
            thickest = np.maximum(thickest, t if wall else t * np.sin(arc))
        return x, y, z, thickest, torque


def _edge_forces(material: Material, t: Floats, sweep: float, width: float) -> tuple[Floats, Floats, Floats]:
    """Return the forces along the cut, outward and down of a strip of the edge at a sweep."""
    if width == 0:
        return np.zeros(t.shape), np.zeros(t.shape), np.zeros(t.shape)
    cutting, thrust = material.coefficients(t)
    area = t * width
    return cutting * area, thrust * area * np.sin(sweep), thrust * area * np.cos(sweep)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyCut(_InterruptedCut):
    r"""Fly-cutting (raster): a round-nose tool on a rotating arm, fed along the cut, in parallel lines.

    At the angle :math:`\varphi` past its lowest point the nose has risen by :math:`S (1 - \cos\varphi)`, so its depth
    below the stock is smaller than d by as much; the tool leaves the stock where that depth is 0. The chip is bounded
    by the previous revolution, shifted by :math:`f \sin\varphi` along the radius of the swing, and by the groove of the
    previous line, one step to the side and of full depth:

    .. math:: t(\varphi, s) = \min\bigl(t_\text{swing}, t_\text{line}\bigr), \qquad
        t_\text{swing} \approx f \sin\varphi \cos s .

    Parameters
    ----------
    swing
        Swing radius S, from the spindle axis to the tip. [mm]
    nose_radius
        Tool nose radius. [mm]
    feed
        Feed f along the cut. [mm/rev]
    step
        Distance between lines. [mm]
    depth
        Depth of cut d, of the lowest point below the stock. [mm]

    Raises
    ------
    InputError
        If a length is not positive, the depth is not below the swing radius, or lines do not meet below the stock.
    """

    usual_samples: ClassVar[int] = 36000

    swing: Length
    nose_radius: Length
    feed: Feed
    step: Length
    depth: Length

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("swing", "nose_radius", "feed", "step", "depth"):
            positive(getattr(self, name), name, "mm")
        _ = RoundChip(nose_radius=self.nose_radius, feed=self.step, depth=self.depth)
        if self.depth >= self.swing:
            raise InputError(f"depth must be below {self.swing:g} mm (the swing), got {self.depth:g} mm")

    @property
    def exit(self) -> float:
        """Angle past the lowest point at which the tool leaves the stock. [rad]."""
        return float(np.arccos(1 - self.depth / self.swing))

    def thickness(self, angle: Floats | float, sweep: Floats | float) -> Floats:
        """Return the uncut chip thickness at swing angles and sweeps (positive to the uncut side). Broadcast [mm]."""
        phi, s = np.broadcast_arrays(np.asarray(angle, dtype=np.float64), np.asarray(sweep, dtype=np.float64))
        radius = self.nose_radius
        below = self.depth - self.swing * (1 - np.cos(phi))
        # Thickness to the stock, the previous line and the previous revolution, each along a ray from the nose
        # centre. The previous line is a groove of full depth, so the nose is above it by its rise.
        risen = self.swing * (1 - np.cos(phi))
        blank = radius - (radius - below) / np.cos(s)
        along = risen * np.cos(s) - self.step * np.sin(s)
        line = radius - along - np.sqrt(np.maximum(radius**2 - self.step**2 - risen**2 + along**2, 0.0))
        swung = (self.feed * np.cos(phi)) ** 2
        up = self.feed * np.sin(phi) + swung / (self.swing + np.sqrt(self.swing**2 - swung))
        across = (up * np.sin(s)) ** 2
        turn = up * np.cos(s) + across / (radius + np.sqrt(radius**2 - across))
        thin = np.minimum(np.minimum(blank, line), turn)
        return np.where((np.abs(phi) <= self.exit) & (below > 0), np.maximum(thin, 0.0), 0.0)

    def _force_columns(self, material: Material, turned: Floats) -> ForceColumns:
        phi = np.mod(turned, 2 * np.pi) - np.pi
        low = -float(np.arcsin(self.step / (2 * self.nose_radius)))
        high = RoundChip(nose_radius=self.nose_radius, feed=self.step, depth=self.depth).sweep[1]
        s = np.linspace(low, high, 401)
        x, y, z, torque, thickest = (np.zeros(turned.size) for _ in range(5))
        cut = np.flatnonzero(np.abs(phi) <= self.exit)
        for start in range(0, cut.size, 2048):
            at = cut[start : start + 2048]
            t = self.thickness(phi[at, None], s)
            cutting, thrust = material.coefficients(t)
            area = t * (self.nose_radius - t / 2)
            along = np.trapezoid(cutting * area, s, axis=1)
            down = np.trapezoid(thrust * area * np.cos(s), s, axis=1)
            x[at] = np.trapezoid(thrust * area * np.sin(s), s, axis=1)
            y[at] = along * np.cos(phi[at]) + down * np.sin(phi[at])
            z[at] = down * np.cos(phi[at]) - along * np.sin(phi[at])
            torque[at] = along * self.swing
            thickest[at] = t.max(axis=1)
        return x, y, z, thickest, torque
