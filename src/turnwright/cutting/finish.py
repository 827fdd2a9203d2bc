"""Contributions to surface roughness other than the tool shape, as separate published models.

An edge that is not infinitely sharp does not cut a chip thinner than :math:`t_m` [Brammertz1961]_, [Son2005]_: it
slides over the material, which springs back. Vibration is added to the position of the tool. There are no default
values: all parameters must be stated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright._validate import between, check_angle, check_numbers, positive
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.progress import Progress, run_chunks

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from turnwright.machine import Machine
    from turnwright.path import Motion
    from turnwright.tool import Tool

__all__ = ["MinimumChip", "Vibration", "add_vibration", "cusp_height", "predict_uncut_height"]

POINTS_PER_CYCLE = 72
"""Points per vibration cycle; linear interpolation is then within 0.1 % of the amplitude."""

MAX_POINTS = 50_000_000

REACH_FEEDS = 6
"""Half width of the strip of each revolution that is evaluated, in feeds plus widths of the uncut strip."""

EDGE_NODES = 4001
"""Nodes of the spline through the edge."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Vibration:
    r"""Relative vibration of tool and work along z, :math:`a \sin(2\pi f t + \varphi)`.

    Parameters
    ----------
    amplitude
        Amplitude a, half of the peak-to-peak motion. [mm]
    frequency_hz
        Frequency f. [Hz]
    phase
        Phase φ at time 0 of the motion. [rad]

    Raises
    ------
    InputError
        If amplitude or frequency is not positive.
    """

    amplitude: float
    frequency_hz: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.amplitude, "the amplitude of a vibration", "mm")
        positive(self.frequency_hz, "the frequency of a vibration", "Hz")
        check_angle(self.phase, "the phase of a vibration")

    def at(self, time: ArrayLike) -> Floats:
        """Return the displacement of the tool along z. Any shape [s] to [mm]."""
        turns = self.frequency_hz * np.asarray(time, dtype=np.float64)
        return np.asarray(self.amplitude * np.sin(2 * np.pi * turns + self.phase))


@dataclass(frozen=True, slots=True, kw_only=True)
class MinimumChip:
    """Minimum chip thickness, and elastic recovery of the uncut material.

    Parameters
    ----------
    thickness
        Minimum chip thickness t_m; thinner chips are not cut. [mm]
    recovery
        Fraction of the uncut material that springs back behind the edge: 1 for purely elastic material, as in
        [Brammertz1961]_, 0 for purely plastic material. [1]

    Raises
    ------
    InputError
        If the thickness is not positive, or ``recovery`` is outside 0 to 1.
    """

    thickness: float
    recovery: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.thickness, "the minimum chip thickness", "mm")
        between(self.recovery, "recovery", 0.0, 1.0, "of the thickness")

    @classmethod
    def of_edge(cls, edge_radius: float, friction_angle: float, *, recovery: float = 1.0) -> MinimumChip:
        r"""Compute the minimum chip thickness of an edge of finite radius.

        .. math:: t_m = r \Bigl(1 - \cos\bigl(\tfrac{\pi}{4} - \tfrac{\beta}{2}\bigr)\Bigr)

        Parameters
        ----------
        edge_radius
            Cutting edge radius r, in the plane of chip flow (not the nose radius). [mm]
        friction_angle
            Friction angle β between tool and work, the arctangent of the friction coefficient. [rad]
        recovery
            As for the class. [1]

        Raises
        ------
        InputError
            If the radius is not positive, or the angle is outside 0 to 85 deg.

        Sources
        -------
        [Son2005]_, for ductile metals that form a continuous chip. Oracle: with β = 0 it is r (1 - 1/√2).

        >>> round(MinimumChip.of_edge(50e-6, 0.0).thickness * 1e6, 3)   # nm
        14.645
        """
        positive(edge_radius, "edge_radius", "mm")
        check_angle(friction_angle, "friction_angle", 0.0, np.deg2rad(85))
        return cls(thickness=float(edge_radius * (1 - np.cos(np.pi / 4 - friction_angle / 2))), recovery=recovery)


def cusp_height(feed: float, nose_radius: float, minimum_chip: float = 0.0, *, curvature: float = 0.0) -> float:
    r"""Compute the cusp height of a round nose, including the effect of a minimum chip thickness.

    On a flat

    .. math:: h = R - \sqrt{R^2 - x^2}, \quad x = \frac{f}{2} + \frac{t_m (2R - t_m)}{2f}

    which is :math:`f^2/8R` to first order, and with a minimum chip thickness the formula of Brammertz. On
    a profile of curvature κ the nose centres of neighbouring revolutions lie on an arc of radius 1/κ - R,
    so that without a minimum chip thickness

    .. math:: h = R - \sqrt{R^2 - f^2/4} + a - \mathrm{sgn}(a) \sqrt{a^2 - f^2/4}, \quad a = 1/\kappa - R

    which is :math:`f^2 / 8R(1 - \kappa R)` to first order.

    Parameters
    ----------
    feed
        Feed f of the tool tip, perpendicular to the surface normal. If the path is compensated along the normal and
        the contact advances by f, the tip advances by f (1 - κR). [mm/rev]
    nose_radius
        Tool nose radius R. [mm]
    minimum_chip
        Minimum chip thickness t_m. [mm]
    curvature
        Curvature κ of the profile along the feed, positive where it is concave; at most 0.999/R and 1/(R + f/2). [1/mm]

    Returns
    -------
    float
        Cusp height above the profile. [mm]

    Raises
    ------
    InputError
        If a length is out of range, the nose does not fit the profile, or t_m is so large that material stays for
        several revolutions.

    Sources
    -------
    [Brammertz1961]_ has the parabola. Oracle: the intersection of circles in 40 digits.

    >>> round(cusp_height(feed=0.010, nose_radius=0.514) * 1e6, 4)   # nm
    24.3196
    >>> round(cusp_height(feed=0.010, nose_radius=0.514, curvature=1 / 20) * 1e6, 4)
    24.9611
    >>> round(cusp_height(feed=0.010, nose_radius=0.5, minimum_chip=20e-6) * 1e6, 2)
    36.0
    """
    positive(feed, "feed", "mm per rev")
    positive(nose_radius, "nose_radius", "mm")
    if feed > nose_radius:
        raise InputError(f"feed must be at most {nose_radius:g} mm/rev (the nose radius), got {feed:g} mm/rev")
    # Convex: the circles of neighbouring revolutions must cross. Concave: the nose must fit, and the nose centres lie
    # on an arc of radius 1/curvature - R, which must be at least half a feed.
    highest = min(0.999 / nose_radius, 1 / (nose_radius + feed / 2))
    if not -1 / feed <= curvature <= highest:
        raise InputError(
            f"curvature must be {-1 / feed:g} to {highest:g} 1/mm (-1/feed to about 1/(nose_radius + feed/2)), got "
            f"{curvature:g} 1/mm: reduce the nose radius or the feed"
        )
    square = feed * feed
    # The uncut strip is at most half a feed wide.
    thickest = square / (nose_radius + np.sqrt(nose_radius**2 - square))
    between(minimum_chip, "minimum_chip", 0.0, thickest, "mm")
    uncut_half_width = minimum_chip * (2 * nose_radius - minimum_chip) / (2 * feed)
    reach = (feed / 2 + uncut_half_width) ** 2
    cusp = reach / (nose_radius + np.sqrt(nose_radius**2 - reach))
    fits = 1 - curvature * nose_radius
    lift = curvature * square / 4 / (fits + np.sqrt(max(0.0, fits**2 - curvature**2 * square / 4)))
    sag = curvature * uncut_half_width**2 / (1 + np.sqrt(1 - (curvature * uncut_half_width) ** 2))
    return float(cusp + lift - sag)


def add_vibration(motion: Motion, vibration: Vibration) -> Motion:
    """Add a vibration to the Z axis of a motion, with more points to resolve it.

    Parameters
    ----------
    motion
        Motion of the axes, linear between its points.
    vibration
        Vibration to add to Z.

    Raises
    ------
    InputError
        If the motion states velocities (track it first), or the result would have more than 50 million points.
    """
    if motion.velocity is not None:
        raise InputError(
            f"the motion must be linear between its points, but it states velocities at {motion.time.size} points: "
            "track it first, then add the vibration"
        )
    time = motion.time
    longest = 1 / (POINTS_PER_CYCLE * vibration.frequency_hz)
    parts = np.maximum(np.ceil(np.diff(time) / longest), 1.0)
    total = float(parts.sum()) + 1
    if total > MAX_POINTS:
        raise InputError(
            f"a vibration of {vibration.frequency_hz:g} Hz over {np.ptp(time):.4g} s needs {total:.3g} points, the "
            f"limit is {MAX_POINTS:g}: shorten the motion"
        )
    count = parts.astype(np.int64)
    first = np.repeat(np.arange(count.size), count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    place = np.append(first + within / count[first], time.size - 1.0)
    every = np.arange(time.size)
    dense = np.interp(place, every, time)
    axes = {letter: np.interp(place, every, values) for letter, values in motion.axes.items()}
    axes["Z"] = axes["Z"] + vibration.at(dense)
    return replace(motion, time=dense, axes=axes, stated_blocks=None)


def predict_uncut_height(
    motion: Motion,
    tool: Tool,
    chip: MinimumChip,
    *,
    radius: ArrayLike,
    angle: ArrayLike,
    machine: Machine | None = None,
    progress: Progress | None = None,
) -> HeightMap:
    """Compute the material left standing because chips below the minimum thickness are not cut.

    Revolution by revolution, material above the edge is removed where its thickness normal to the edge is at least the
    minimum chip thickness; otherwise it stays.

    Parameters
    ----------
    motion
        Motion of the axes.
    tool
        Tool, whose rake face must lie in a plane through the axis.
    chip
        Minimum chip thickness and recovery.
    radius, angle
        Polar grid. (n_radius,) [mm], (n_angle,) [rad]
    machine
        Machine with its geometric errors; by default that of the motion.
    progress
        Called with (done, total) rows.

    Returns
    -------
    HeightMap
        Height to add to the surface of `generate_polar`; at least 0. [mm]

    Raises
    ------
    InputError
        If the edge does not lie in a plane through the axis, or the grid is not ascending.

    Sources
    -------
    The model of [Brammertz1961]_, for any surface. Oracle: his formula on a flat.
    """
    radii, angles = frozen(radius, "radius"), frozen(angle, "angle")
    for name, values in (("radius", radii), ("angle", angles)):
        if not values.size or not (np.diff(values) > 0).all():
            raise InputError(f"{name} must be strictly ascending with at least 1 value, got {values.size} values")
    off_plane = np.abs(motion.axes["Y"]).max() if "Y" in motion.axes else 0.0
    if tool.rake != 0 or tool.offset[1] != 0 or off_plane > 0:
        raise InputError(
            "rake, tool height error and Y must be 0 for material left standing (the edge must lie in a plane through "
            f"the axis), got {np.rad2deg(tool.rake):g} deg, {tool.offset[1]:g} mm and {off_plane:g} mm"
        )
    revolutions = _Revolutions(motion, tool, machine, chip)
    extra = np.zeros((angles.size, radii.size))

    def work(start: int, stop: int) -> None:
        for row in range(start, stop):
            extra[row] = revolutions.excess_height(float(angles[row]), radii)

    run_chunks(work, angles.size, 1, progress)
    return HeightMap(z=extra, radius=radii, angle=angles, name="left standing")


class _Revolutions:
    """Revolutions of a motion, in their order at any azimuth."""

    def __init__(self, motion: Motion, tool: Tool, machine: Machine | None, chip: MinimumChip) -> None:
        x = motion.axes["X"]
        self.z = motion.axes["Z"] + (machine or motion.machine).z_error(x) + motion.axes.get("W", 0.0)
        self.x = x + motion.axes.get("U", 0.0)
        self.c = motion.axes["C"] * motion.sense
        self.sense, self.chip, self.edge = motion.sense, chip, _edge(tool)
        self.reach = REACH_FEEDS * (motion.feed + tool.nose_radius * chip.thickness / motion.feed)

    def excess_height(self, angle: float, radii: Floats) -> Floats:
        low, high, turn = self.c[0], self.c[-1], 2 * np.pi
        # Revolutions at this azimuth, and at the opposite one with the edge mirrored.
        bases = (angle * self.sense, angle * self.sense + np.pi)
        passes = [b + turn * np.arange(np.ceil((low - b) / turn), (high - b) / turn + 1e-12) for b in bases]
        at = np.concatenate(passes)
        side = np.repeat([1.0, -1.0], [one.size for one in passes])
        order = np.argsort(at, kind="stable")
        at, side = at[order], side[order]
        x, z = np.interp(at, self.c, self.x) * side, np.interp(at, self.c, self.z)
        cut = np.full(radii.size, np.inf)
        sharp = cut.copy()
        for place, height, way in zip(x, z, side, strict=True):
            first, last = np.searchsorted(radii, [place - self.reach, place + self.reach])
            if first == last:
                continue
            rise, upright = self.edge(way * (radii[first:last] - place))
            edge = height + rise
            sharp[first:last] = np.minimum(sharp[first:last], edge)
            stock = cut[first:last]
            over = stock - edge
            thin = over * upright < self.chip.thickness
            pressed = edge + self.chip.recovery * np.where(np.isfinite(over), over, 0.0)
            cut[first:last] = np.where(over <= 0, stock, np.where(thin, pressed, edge))
        with np.errstate(invalid="ignore"):
            return np.where(np.isfinite(cut), np.maximum(cut - sharp, 0.0), 0.0)


def _edge(tool: Tool) -> Callable[[Floats], tuple[Floats, Floats]]:
    """Return a function for the height of the edge and the cosine of its slope over the distance from the tip."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

    u, _, height = tool.edge(np.linspace(*tool.arc, EDGE_NODES))
    spline = CubicSpline(u, height)
    rate = spline.derivative()
    ends = u[[0, -1]]
    slopes = rate(ends)

    def edge(at: Floats) -> tuple[Floats, Floats]:
        inside = np.clip(at, *ends)
        beyond = at - inside
        flank = np.where(beyond < 0, slopes[0], slopes[1])
        slope = np.where(beyond == 0, rate(inside), flank)
        return np.asarray(spline(inside) + flank * beyond), np.asarray(1 / np.sqrt(1 + slope**2))

    return edge
