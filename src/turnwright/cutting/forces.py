r"""The forces of a chip: those of every element of the edge, added up along it.

An element of edge over the area dA of the uncut chip feels Kc dA against the cutting direction and Kt dA along its
normal, in the plane of the edge. On a round nose the normal at the sweep s leans by s, so that

.. math::
    F_c = \int K_c\,dA, \qquad F_a = \int K_t \cos s\,dA, \qquad F_f = \int K_t \sin s\,dA, \qquad
    dA = t\,(R - t/2)\,ds .

With the usual t = f sin s, dA = t R ds and constant coefficients, up to :math:`\cos S = 1 - d/R`,

.. math::
    F_c = K_c f d, \qquad F_a = \tfrac12 K_t R f \sin^2 S, \qquad
    F_f = \tfrac12 K_t R f\,(S - \sin S \cos S).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright._tables import Stated
from turnwright._validate import between, check_angle, check_numbers, positive, whole as whole_number
from turnwright.cutting.chip import OrthogonalChip, RoundChip
from turnwright.errors import InputError
from turnwright.units import Angle, Count, Feed, Length

if TYPE_CHECKING:
    from turnwright.material import Material

__all__ = ["CuttingForces", "FlyCut", "ForceHistory", "SlotMill", "chip_forces"]

NODES = 48
"""Gauss-Legendre nodes on each smooth piece of an edge."""

LINES = 24
"""The same along a round edge, at every instant of an interrupted cut."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CuttingForces:
    """The force on the tool in a steady cut.

    Parameters
    ----------
    axial
        Out of the part, along the axis of a face-turning lathe. [N]
    feed
        Against the feed, away from the uncut side. [N]
    cutting
        Against the motion of the tool over the part. [N]
    axial_uncertainty, feed_uncertainty, cutting_uncertainty
        Standard uncertainties from those of the coefficients; ``None`` where nobody states them. [N]
    """

    axial: float
    feed: float
    cutting: float
    axial_uncertainty: float | None = None
    feed_uncertainty: float | None = None
    cutting_uncertainty: float | None = None

    @property
    def resultant(self) -> float:
        """Magnitude. [N]."""
        return float(np.sqrt(self.axial**2 + self.feed**2 + self.cutting**2))

    @property
    def direction(self) -> tuple[float, float]:
        """Angle of the resultant above the cutting direction, and of its thrust against the axis. [rad]."""
        thrust = np.hypot(self.axial, self.feed)
        return float(np.arctan2(thrust, self.cutting)), float(np.arctan2(self.feed, self.axial))

    def power(self, speed: float) -> float:
        """Return what the cut takes at a cutting speed [mm/s]. [mW]."""
        return self.cutting * positive(speed, "the cutting speed", "mm/s")


def chip_forces(
    chip: OrthogonalChip | RoundChip,
    material: Material,
    *,
    rake: float = 0.0,
    angle: float = 0.0,
    nominal: bool = False,
) -> CuttingForces:
    """Return the forces of a steady chip.

    Parameters
    ----------
    chip
        Of a straight edge, whose thrust is all axial, or of a round nose.
    material
        Whose coefficients count, with the plateau beyond the critical thickness where it has one.
    rake, angle
        Effective rake and azimuth of the part, for a material that depends on them. [rad]
    nominal
        Whether a round chip counts as f sin s, as published models take it, and not as thick as it is.

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
        return _stated(material, float(thrust) * chip.area, 0.0, float(cutting) * chip.area)
    radius = chip.nose_radius
    low, high = chip.sweep
    ends = (0.0, high) if nominal else (low, chip.corner, high)
    limit = None if material.critical is None else float(material.critical.at(rake=rake, angle=angle))
    if material.brittle_plateau and limit is not None:
        ends = tuple(sorted((*ends, *_reaches(chip, limit, nominal))))
    total = np.zeros(3)
    for first, last in pairwise(ends):
        s, weight = _gauss(first, last)
        t = chip.nominal(s) if nominal else chip.thickness(s)
        area = t * radius if nominal else t * (radius - t / 2)
        cutting, thrust = material.coefficients(t, rake=rake, angle=angle)
        taken = weight * area
        total += (thrust * np.cos(s)) @ taken, (thrust * np.sin(s)) @ taken, cutting @ taken
    return _stated(material, *(float(one) for one in total))


def _stated(material: Material, axial: float, feed: float, cutting: float) -> CuttingForces:
    """Return forces with the uncertainty that the coefficients leave."""
    shares = [
        None if one is None or one.uncertainty is None else one.uncertainty / one.value
        for one in (material.thrust, material.thrust, material.cutting)
    ]
    values = (axial, feed, cutting)
    spread = [None if share is None else share * abs(value) for share, value in zip(shares, values, strict=True)]
    return CuttingForces(
        axial=axial, feed=feed, cutting=cutting,
        axial_uncertainty=spread[0], feed_uncertainty=spread[1], cutting_uncertainty=spread[2],
    )  # fmt: skip


def _gauss(first: float, last: float, nodes: int = NODES) -> tuple[Floats, Floats]:
    """Return nodes and weights between two places."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    half = (last - first) / 2
    return (first + last) / 2 + half * x, half * weight


def _reaches(chip: RoundChip, limit: float, nominal: bool) -> tuple[float, ...]:
    """Return where along the edge the chip becomes as thick as the limit, where forces have a bend."""
    low, high = chip.sweep
    spans = ((0.0, high),) if nominal else ((low, chip.corner), (chip.corner, high))
    at = chip.nominal if nominal else chip.thickness
    found = []
    for first, last in spans:
        over = [float(at(place)) > limit for place in (first + 1e-12, last - 1e-12)]
        if over[0] == over[1]:
            continue
        one, other = first, last
        for _ in range(80):
            middle = (one + other) / 2
            if (float(at(middle)) > limit) == over[0]:
                one = middle
            else:
                other = middle
        found.append((one + other) / 2)
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceHistory:
    """Forces of an interrupted cut over time, as a dynamometer under the part measures them.

    Parameters
    ----------
    time
        From the entry of the first tooth. (n,) [s]
    angle
        How far the cutter has turned since. (n,) [rad]
    x, y, z
        Force on the part across the feed, along the feed, and into the part. Each (n,) [N]
    thickness
        Thickest chip in cut at each instant; 0 where no tooth cuts. (n,) [mm]
    torque
        Around the axis of the cutter. (n,) [N mm]
    speed
        Of the spindle. [rad/s]
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
        """Share of the time that a tooth cuts."""
        return float((self.thickness > 0).mean())

    @property
    def power(self) -> Floats:
        """What the cut takes at each instant. (n,) [mW]."""
        return np.asarray(self.torque * self.speed)


Acting = tuple[Floats, Floats, Floats, Floats, Floats]
"""x, y, z, thickness and torque of a `ForceHistory`."""


def _turning(acting: Callable[[Floats], Acting], spindle_rpm: float, turns: float, samples: int) -> ForceHistory:
    """Return the forces of what acts at the angles of a steady spindle."""
    speed = positive(spindle_rpm, "spindle_rpm", "rev/min") * 2 * np.pi / 60
    turned = 2 * np.pi * np.arange(max(int(positive(turns, "turns", "rev") * samples), 1) + 1) / samples
    x, y, z, thickness, torque = acting(turned)
    return ForceHistory(
        time=turned / speed, angle=turned, x=x, y=y, z=z, thickness=thickness, torque=torque, speed=speed
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotMill(Stated):
    r"""Milling around an axis normal to the part: a slot of full width, or any arc of it.

    A tooth at the angle :math:`\varphi` from where the full slot begins stands at :math:`(-\cos\varphi, \sin\varphi)`
    of the cutter, fed toward +y; it cuts along :math:`(\sin\varphi, \cos\varphi)`, and its chip is

    .. math:: t(\varphi) = R + f \sin\varphi - \sqrt{R^2 - f^2\cos^2\varphi} \approx f \sin\varphi

    thick where the wall is upright; on a round corner at the sweep s from the tip that is times sin s. Each tooth
    presses on the part by Kc along its motion and Kt along its outward normal, so that on an upright wall
    :math:`F_x = t w (K_c \sin\varphi - K_t \cos\varphi)` across the feed, which peaks at
    :math:`\tfrac12 f w (K_c + \sqrt{K_c^2 + K_t^2})`.

    Parameters
    ----------
    radius
        Of the cutter. [mm]
    feed_per_tooth
        f. [mm]
    depth
        w, along the axis. [mm]
    teeth
        Equally spaced.
    corner_radius
        0 for a square cutter, up to the radius for a round one. [mm]
    entry, exit
        Angles at which a tooth begins and ends to cut; 0 and half a turn for a full slot. [rad]

    Raises
    ------
    InputError
        If a length is not positive, or the arc of engagement does not lie within half a turn.
    """

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
                f"feed_per_tooth is {self.feed_per_tooth:g} mm on a radius of {self.radius:g} mm: reduce it below that"
            )
        object.__setattr__(self, "teeth", whole_number(self.teeth, "teeth", 1))
        for name in ("entry", "exit"):
            check_angle(getattr(self, name), name, 0.0, np.pi + 1e-12)
        if not self.entry < self.exit:
            raise InputError(
                f"a tooth cuts from {np.rad2deg(self.entry):g} to {np.rad2deg(self.exit):g} deg: let entry be before "
                "exit"
            )

    def thickness(self, angle: Floats | float) -> Floats:
        """Return the chip on an upright wall where a tooth stands at some angles, 0 where it does not cut. [mm]."""
        phi = np.mod(np.asarray(angle, dtype=np.float64), 2 * np.pi)
        square = (self.feed_per_tooth * np.cos(phi)) ** 2
        t = self.feed_per_tooth * np.sin(phi) + square / (self.radius + np.sqrt(self.radius**2 - square))
        return np.where((phi >= self.entry) & (phi <= self.exit), np.maximum(t, 0.0), 0.0)

    def forces(
        self, material: Material, *, spindle_rpm: float, turns: float = 1.0, samples: int = 3600
    ) -> ForceHistory:
        """Return the forces on the part over time.

        Parameters
        ----------
        material
            Whose coefficients count.
        spindle_rpm
            [rev/min]
        turns
            How long to look; the first tooth enters a full slot at time 0.
        samples
            Per turn.
        """
        return _turning(partial(self._acting, material), spindle_rpm, turns, samples)

    def _acting(self, material: Material, turned: Floats) -> Acting:
        """Return what acts where the cutter has turned so far."""
        arc = 0.0
        if self.corner_radius:
            arc = float(np.arccos(1 - min(self.depth / self.corner_radius, 1.0)))
        s, weight = _gauss(0.0, arc, LINES) if arc else (np.empty(0), np.empty(0))
        wall = max(self.depth - self.corner_radius, 0.0)
        x, y, z, torque, most = (np.zeros(turned.size) for _ in range(5))
        for tooth in range(self.teeth):
            phi = np.mod(turned - tooth * 2 * np.pi / self.teeth, 2 * np.pi)
            t = self.thickness(phi)
            along, outward, down = _edge_forces(material, t, np.pi / 2, wall)
            for sweep, width in zip(s, weight * self.corner_radius, strict=True):
                more = _edge_forces(material, t * np.sin(sweep), sweep, width)
                along, outward, down = along + more[0], outward + more[1], down + more[2]
            x += along * np.sin(phi) - outward * np.cos(phi)
            y += along * np.cos(phi) + outward * np.sin(phi)
            z += down
            torque += along * self.radius
            most = np.maximum(most, t if wall else t * np.sin(arc))
        return x, y, z, most, torque


def _edge_forces(material: Material, t: Floats, sweep: float, width: float) -> tuple[Floats, Floats, Floats]:
    """Return force along the cut, outward and down of a strip of edge whose normal leans by the sweep."""
    if width == 0:
        return np.zeros(t.shape), np.zeros(t.shape), np.zeros(t.shape)
    cutting, thrust = material.coefficients(t)
    area = t * width
    return cutting * area, thrust * area * np.sin(sweep), thrust * area * np.cos(sweep)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyCut(Stated):
    r"""Fly-cutting: one round nose on a swing, fed along the cut, line by line beside each other.

    At the angle :math:`\varphi` of the swing past its lowest point the nose has risen by :math:`S (1 - \cos\varphi)`
    and stands that much less than d below the stock; it comes out where nothing is left. The chip there is what the
    swing before, shifted by :math:`f \sin\varphi` along the swing's radius, and the groove of the line before, a step
    beside and of full depth, have left:

    .. math:: t(\varphi, s) = \min\bigl(t_\text{swing}, t_\text{line}\bigr), \qquad
        t_\text{swing} \approx f \sin\varphi \cos s .

    Parameters
    ----------
    swing
        S, from the axis of the spindle to the tip. [mm]
    nose_radius
        Of the tool. [mm]
    feed
        f, along the cut per turn. [mm/rev]
    step
        From line to line. [mm]
    depth
        d, of the lowest point below the stock. [mm]

    Raises
    ------
    InputError
        If a length is not positive, or lines do not meet below the stock.
    """

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
            raise InputError(f"depth is {self.depth:g} mm on a swing of {self.swing:g} mm: reduce it below that")

    @property
    def exit(self) -> float:
        """Angle past the lowest point at which the tool comes out of the stock. [rad]."""
        return float(np.arccos(1 - self.depth / self.swing))

    def thickness(self, angle: Floats | float, sweep: Floats | float) -> Floats:
        """Return the chip at angles of the swing and sweeps on the nose, positive to the uncut side. Broadcast [mm]."""
        phi, s = np.broadcast_arrays(np.asarray(angle, dtype=np.float64), np.asarray(sweep, dtype=np.float64))
        radius = self.nose_radius
        below = self.depth - self.swing * (1 - np.cos(phi))
        # Out of the stock, the line before and the swing before, each along the ray from the centre of the nose. The
        # line before is a groove of full depth, so the nose stands above it by what it has risen.
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

    def forces(
        self, material: Material, *, spindle_rpm: float, turns: float = 1.0, samples: int = 36000
    ) -> ForceHistory:
        """Return the forces on the part over time: x across the lines, y along the cut, z into the part.

        Parameters
        ----------
        material
            Whose coefficients count.
        spindle_rpm
            [rev/min]
        turns
            How long to look; at time 0 the tool stands opposite the part.
        samples
            Per turn.
        """
        return _turning(partial(self._acting, material), spindle_rpm, turns, samples)

    def _acting(self, material: Material, turned: Floats) -> Acting:
        """Return what acts where the swing has turned so far."""
        phi = np.mod(turned, 2 * np.pi) - np.pi
        low = -float(np.arcsin(self.step / (2 * self.nose_radius)))
        high = RoundChip(nose_radius=self.nose_radius, feed=self.step, depth=self.depth).sweep[1]
        s = np.linspace(low, high, 401)
        x, y, z, torque, most = (np.zeros(turned.size) for _ in range(5))
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
            most[at] = t.max(axis=1)
        return x, y, z, most, torque
