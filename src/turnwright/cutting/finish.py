r"""What roughness has beside the shape of the tool: terms that were published, each apart and by its name.

**Minimum chip.** An edge that is not infinitely sharp cuts no chip below some thickness :math:`t_m`: it slides over
such material, which springs back. Behind each cusp the chip begins at zero, so a strip of
:math:`d = R\,t_m / f` stays as the turn before has left it, and the cusps of a flat become as high as

.. math:: h = \frac{f^2}{8R} + \frac{t_m}{2} \Bigl(1 + \frac{R\,t_m}{f^2}\Bigr)

[Brammertz1961]_, which `left_standing` gives on any surface: nothing else is assumed there than that thinner chips are
not cut. It holds for :math:`d \le f/2`; beyond, material stays for several turns.

**Edge radius.** For an edge of radius r and a friction angle β between tool and work
:math:`t_m = r\,(1 - \cos(\pi/4 - \beta/2))` [Son2005]_, for ductile metals.

**Vibration** between tool and work adds to the position of the tool before any surface is made.

No number of these is known here: each is asked for.
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

__all__ = ["MinimumChip", "Vibration", "cusp_height", "left_standing", "vibrated"]

PER_CYCLE = 72
"""Points in each cycle of a vibration: between them it is straight, off by less than 0.1 % of the amplitude."""

MOST_POINTS = 50_000_000
"""Points of a motion beyond which its vibration is refused."""

FEEDS = 6
"""The strip of a turn that is followed reaches as many feeds to either side, and as many strips left standing."""

NODES = 4001
"""Places on the edge through which its spline goes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Vibration:
    r"""A relative vibration of tool and work along z, :math:`a \sin(2\pi f t + \varphi)`.

    Parameters
    ----------
    amplitude
        a, half of what it moves from end to end. [mm]
    frequency_hz
        f. [Hz]
    phase
        φ at the time 0 of the motion. [rad]

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
        """Return how far the tool is lifted at some times. Any shape [s] to [mm]."""
        turns = self.frequency_hz * np.asarray(time, dtype=np.float64)
        return np.asarray(self.amplitude * np.sin(2 * np.pi * turns + self.phase))


@dataclass(frozen=True, slots=True, kw_only=True)
class MinimumChip:
    """The thinnest chip that is cut, and what becomes of thinner ones.

    Parameters
    ----------
    thickness
        Below it nothing is cut. [mm]
    recovery
        Share of such material that springs back behind the edge: 1 for all of it, as in [Brammertz1961]_, 0 for
        material that is pressed down for good.

    Raises
    ------
    InputError
        If the thickness is not positive, or the share lies outside 0 to 1.
    """

    thickness: float
    recovery: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.thickness, "the minimum chip thickness", "mm")
        between(self.recovery, "recovery", 0.0, 1.0, "of the thickness")

    @classmethod
    def of_edge(cls, edge_radius: float, friction_angle: float, *, recovery: float = 1.0) -> MinimumChip:
        r"""Return what an edge of a finite radius leaves uncut.

        .. math:: t_m = r \Bigl(1 - \cos\bigl(\tfrac{\pi}{4} - \tfrac{\beta}{2}\bigr)\Bigr)

        Parameters
        ----------
        edge_radius
            r, of the cutting edge in the plane of the chip's flow; not the nose. [mm]
        friction_angle
            β between tool and work, the arc tangent of the friction coefficient. [rad]
        recovery
            See the class.

        Raises
        ------
        InputError
            If the radius is not positive, or the angle is not from 0 to 85 deg.

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
    r"""Height of the cusps of a round nose over the profile, with what a minimum chip thickness leaves standing.

    .. math:: h = R - \sqrt{R^2 - x^2}, \quad x = \frac{f}{2} + \frac{t_m (2R - t_m)}{2f}

    on a flat: :math:`f^2/8R` to the first order, and with a minimum chip the formula of Brammertz (see this module). On
    a profile of curvature κ the centres of two neighbouring passes stand on an arc of radius 1/κ - R, so that without a
    minimum chip

    .. math:: h = R - \sqrt{R^2 - f^2/4} + a - \mathrm{sgn}(a) \sqrt{a^2 - f^2/4}, \quad a = 1/\kappa - R

    which is :math:`f^2 / 8R(1 - \kappa R)` to the first order.

    Parameters
    ----------
    feed
        f, advance of the tip, square to the profile's normal. A path along the normal whose contact advances by f
        advances its tip by f (1 - κR). [mm/rev]
    nose_radius
        R. [mm]
    minimum_chip
        t_m. [mm]
    curvature
        κ of the profile along the feed, positive where it is concave, up to 0.999/R and 1/(R + f/2). [1/mm]

    Raises
    ------
    InputError
        If a length is out of range, the nose does not fit the profile, or t_m is so thick that material stays for
        several turns.

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
        raise InputError(f"feed is {feed:g} mm per rev, the limit is the nose radius, {nose_radius:g} mm: take less")
    # Where the nose fits the valley, and on a dome the circles of two passes still cross above it.
    # In a valley the centres of two passes stand on an arc of radius 1/curvature - R, which is half a feed or more.
    most = min(0.999 / nose_radius, 1 / (nose_radius + feed / 2))
    if not -1 / feed <= curvature <= most:
        raise InputError(
            f"curvature is {curvature:g} per mm, the limits are {-1 / feed:g} and {most:g} per mm, -1/feed and almost "
            "1/(nose_radius + feed/2): take a smaller nose or feed"
        )
    square = feed * feed
    # No longer than until the pass after the next: the strip is half a feed wide.
    thickest = square / (nose_radius + np.sqrt(nose_radius**2 - square))
    between(minimum_chip, "minimum_chip", 0.0, thickest, "mm")
    beside = minimum_chip * (2 * nose_radius - minimum_chip) / (2 * feed)
    reach = (feed / 2 + beside) ** 2
    cusp = reach / (nose_radius + np.sqrt(nose_radius**2 - reach))
    fits = 1 - curvature * nose_radius
    lift = curvature * square / 4 / (fits + np.sqrt(max(0.0, fits**2 - curvature**2 * square / 4)))
    sag = curvature * beside**2 / (1 + np.sqrt(1 - (curvature * beside) ** 2))
    return float(cusp + lift - sag)


def vibrated(motion: Motion, vibration: Vibration) -> Motion:
    """Return a motion whose Z vibrates, with as many more points as the vibration asks for.

    Parameters
    ----------
    motion
        As the axes move; between its points they move in straight lines.
    vibration
        What is added to Z.

    Raises
    ------
    InputError
        If the motion states velocities (track it first), or would need more than 50 million points.
    """
    if motion.velocity is not None:
        raise InputError(
            f"the motion states velocities at its {motion.time.size} points, so it is not straight between them: "
            "track it first, then let it vibrate"
        )
    time = motion.time
    longest = 1 / (PER_CYCLE * vibration.frequency_hz)
    parts = np.maximum(np.ceil(np.diff(time) / longest), 1.0)
    total = float(parts.sum()) + 1
    if total > MOST_POINTS:
        raise InputError(
            f"a vibration of {vibration.frequency_hz:g} Hz over {np.ptp(time):.4g} s needs {total:.3g} points, the "
            f"limit is {MOST_POINTS:g}: cut the motion to the stretch that matters"
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


def left_standing(
    motion: Motion,
    tool: Tool,
    chip: MinimumChip,
    *,
    radius: ArrayLike,
    angle: ArrayLike,
    machine: Machine | None = None,
    progress: Progress | None = None,
) -> HeightMap:
    """Return by how much the surface stands higher because thin chips are not cut.

    Every turn takes off what lies above the edge where that is as thick as the minimum chip or thicker, measured
    normal to the edge; the rest stays, in the order in which the turns come.

    Parameters
    ----------
    motion
        As the axes move.
    tool
        The edge; its plane must go through the axis.
    chip
        What is not cut.
    radius, angle
        The polar grid. (n_radius,) [mm], (n_angle,) [rad]
    machine
        Whose geometric errors act; that of the motion if not given.
    progress
        Called with (done, total) rows.

    Returns
    -------
    HeightMap
        What is to be added to the surface that `generate_polar` gives; never below 0.

    Raises
    ------
    InputError
        If the edge does not lie in a plane through the axis, or the grid does not ascend.

    Sources
    -------
    The model of [Brammertz1961]_, without its flat. Oracle: his formula.
    """
    radii, angles = frozen(radius, "radius"), frozen(angle, "angle")
    for name, values in (("radius", radii), ("angle", angles)):
        if not values.size or not (np.diff(values) > 0).all():
            raise InputError(f"{name} must ascend strictly and hold at least 1 value, it has {values.size}: sort it")
    off_plane = np.abs(motion.axes["Y"]).max() if "Y" in motion.axes else 0.0
    if tool.rake != 0 or tool.offset[1] != 0 or off_plane > 0:
        raise InputError(
            f"the edge does not lie in a plane through the axis (rake {np.rad2deg(tool.rake):g} deg, height error "
            f"{tool.offset[1]:g} mm, Y up to {off_plane:g} mm), the limit is 0 of each: what is left standing is known "
            "in that plane only"
        )
    turns = _Turns(motion, tool, machine, chip)
    extra = np.zeros((angles.size, radii.size))

    def work(start: int, stop: int) -> None:
        for row in range(start, stop):
            extra[row] = turns.above(float(angles[row]), radii)

    run_chunks(work, angles.size, 1, progress)
    return HeightMap(z=extra, radius=radii, angle=angles, name="left standing")


class _Turns:
    """The turns of a motion as they follow each other over any azimuth."""

    def __init__(self, motion: Motion, tool: Tool, machine: Machine | None, chip: MinimumChip) -> None:
        machine = machine or motion.machine
        x, z = motion.axes["X"], motion.axes["Z"]
        z = z + machine.z_error(x) + motion.axes.get("W", 0.0)
        x = x + motion.axes.get("U", 0.0)
        self.c = motion.axes["C"] * motion.sense
        self.sense = motion.sense
        self.x, self.z, self.chip = x, z, chip
        self.edge = _edge(tool)
        strip = tool.nose_radius * chip.thickness / motion.feed
        self.reach = FEEDS * (motion.feed + strip)

    def above(self, angle: float, radii: Floats) -> Floats:
        """Return how much higher the surface is along one azimuth for what is not cut. (n_radius,) [mm]."""
        base = angle * self.sense
        # Turns that pass this azimuth, and those that pass the one opposite with the edge turned round.
        low, high = self.c[0], self.c[-1]
        near = base + 2 * np.pi * np.arange(np.ceil((low - base) / (2 * np.pi)), (high - base) / (2 * np.pi) + 1e-12)
        start = np.ceil((low - base - np.pi) / (2 * np.pi))
        far = base + np.pi + 2 * np.pi * np.arange(start, (high - base - np.pi) / (2 * np.pi) + 1e-12)
        at = np.concatenate((near, far))
        side = np.concatenate((np.ones(near.size), -np.ones(far.size)))
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
    """Return the edge's height and the cosine of its slope, over the distance from the commanded tip."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

    u, _, height = tool.edge(np.linspace(*tool.arc, NODES))
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
