"""The adaptive tool servo: turns as far apart as the cusp allows, points as far apart as the chord allows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from turnwright._kernels import adaptive as kernel
from turnwright._validate import check_numbers, positive
from turnwright.errors import GougeError, InputError, LimitError
from turnwright.path import Spiral
from turnwright.placing import touch
from turnwright.speed_profile import Speeds
from turnwright.strategy.base import Strategy
from turnwright.strategy.fast import FastToolServo
from turnwright.units import Flag, Size, Speed

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats, Ints
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Path
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = ["AdaptiveToolServo"]

TURN = 2 * math.pi

MOST_POINTS = 300_000_000
"""Beyond this a spiral is a slip of the unit: no controller takes such a program, and no memory holds it."""

MOST_SAMPLES = 1 << 24
"""Samples of a block of a path, beyond which it is rougher than memory holds."""

WIDEST_STEP = TURN / 12
"""Largest angle between two points, so that no move of C is ambiguous. [rad]"""

LAST = TURN / 24
"""After the last turn the radius comes to rest in this angle, so that the outermost tip, where the surface ends for all
of them, is the last one of the program and not one that is between its points. [rad]"""

SPOKES_PER_FEATURE = 4
LEAST_SPOKES = 256
RINGS_PER_FEATURE = 8
LEAST_RINGS = 256
RINGS_PER_NOSE = 16
"""How densely the steps are found: spokes around the rim, and rings between which a cubic gives the tip's height."""

SAMPLES_PER_FEATURE = 8
"""Samples of the path along the outermost turn of a block; there are more wherever a cubic needs them."""

BLOCK = 1 << 21
"""Samples that are placed together."""

LEAST_STEP = 0.1
"""A step is at least this share of that on a flat: at a valley too sharp for the nose no step would leave no cusp."""

STEP_GROWTH = 4.0
"""A step grows at most by this factor from turn to turn."""

BESIDE = 1e-7
"""How far to either side of a contact another piece of the surface makes it one between two. [mm]"""

LATERAL_SHARE = 3e-3
"""Between the points the controller's radius may be aside by this share of a step: a cusp changes by up to four times
as much, since two passes make it."""

AIM = 0.9925
"""Share of the scallop at which cusps are aimed, so that with both passes aside they are from 98 to 100.5 % of it."""

GO_ON = 8.0
REST = 24.0
"""Steps outside the rim within which a spoke's own steps go over to a constant one, and within which that comes to
rest: so slowly that X is asked for next to no more jerk than inside, where the fastest spokes set it."""

GO_ON_AT_ONCE = 1.0
REST_AT_ONCE = 3.0
"""The same where the surface does not go on so far."""

LEVEL = 0.9
"""A surface goes on where it curves up by no more than this share of what the nose does: steeper, touches may jump."""

IDLE_LATERAL_SHARE = 0.1
"""A pass whose cusp with the last one is outside the rim cuts nothing inside it, so that no cusp depends on it: it may
be aside by as much as that cusp is outside, up to this share of the step on a flat; the cusp moves by half of that."""

MISS = 200
"""Straight lines between samples, and the cubics that fill them in, may each miss the path by the chord over this."""

MISS_AT_RIDGES = 40
"""The same for a surface with ridges and valleys, whose kinks take ever closer samples."""

ROUGH = 8
SHORT = 2e-5
"""Beside the rim of a surface with ridges the height is sure to some tenths of a nanometre only: over so short an angle
[rad] a miss of the chord over ROUGH is taken for that."""

FEW = 8
"""Where more than one in so many intervals of a path needs more samples, all its samples are set closer together."""

SAMPLES_PER_BLOCK = 16
"""Samples to each cubic of a program: its largest miss between them is within a hundredth of that at one of them."""

BETWEEN = 0.025
"""A cubic that goes from a flat into a structure misses most in its last few samples, and between two of them by up to
this share of the chord more; it costs half a percent of points."""

LEAST_CHORD = 1e-10
"""Heights are computed to about 1e-12 mm, rounding included, and a path has to be known far better than to the chord.
[mm]"""

GLANCES = 16
"""Turns from which the number of points is foreseen, so that a slip of the unit is refused at once."""

FINEST = 1e-9
"""A path that is not a cubic over this angle jumps. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptiveToolServo(Strategy):
    r"""Adaptive tool servo: every cusp as high as the scallop allows, as few points as the chord allows.

    *Across the turns.* On each of many spokes the next tip stands where its edge meets that of the last turn exactly
    ``scallop`` above the surface, the height measured along z over the real surface in between. A turn begins where the
    last one ends, so every step is taken from the spiral's own previous turn; a cubic spline in the cumulative angle
    through all of them has a radius with two continuous derivatives, over the seam of each turn as anywhere. The tip
    rests on the axis for a moment and takes half a turn to its steady advance, so that passes from both sides of the
    axis stand nowhere further apart than the others. The spiral ends with the turn after which no point inside the
    clear radius stands higher than the scallop; spokes that are there before the last one go over to a constant step,
    and come to rest, so slowly that X is asked for little more jerk than inside.

    *Along a turn.* Each point is the furthest from the last for which what the controller makes of the axes keeps
    within ``chord`` of the exact height of the tip *at the radius where it then is*. The points of straight lines may
    stand up to the chord above or below the path (`Path.lift`), so that lines pass on both sides of it: steps are
    longer by up to :math:`\sqrt 2`.

    The promise of the cusp is for surfaces without kinks: over those of a lens array no smooth radius can keep it.
    Where the edge goes over from one piece to another, steps go on as they were on the piece before, so that cusps in a
    sharp valley or at a ridge are those of a constant feed of that step; on the pieces themselves they are kept.

    Parameters
    ----------
    scallop
        Height of the cusps between neighbouring turns. They are aimed at 99.25 % of it; where the controller's radius
        between two points is aside they are from 98 to 100.5 %, for a tip at its exact height. What the height is off
        by, up to the chord, adds to them. [mm]
    chord
        Largest height between the exact path and what the controller makes of the points. [mm]
    interpolation
        What the controller makes of them: "linear" in the axes, or "hermite" (PVT), cubics through positions and
        velocities; those of a steady spindle. In a job it is what the machine's controller does.
    off_path
        Whether the points of a linear program may stand off the exact path. Cubics always pass through it.
    x_motion
        "servo": X follows the steps. "split": the same tip, X in steady motion and what is left for U, the second axis
        of a fast tool. "steady": the largest constant feed that keeps every cusp within the scallop; only the points
        adapt, and X needs no servo. `FastToolServo` takes either of the last two as its plan.
    spindle_rpm
        Spindle speed; ``None`` for the highest one that keeps every limit of the machine. [rev/min]
    spindle_speeds
        Spindle speed over the radius, in place of one speed: each with the radius at which it is reached.
    along
        The tool is placed along "z".
    inside_out
        Cut from the centre to the rim.
    sense
        +1 where the azimuth of the part under the tool grows, -1 where it falls.

    Raises
    ------
    InputError
        If a length is not positive, or a choice is none of those above.

    Sources
    -------
    [ZhuTo2015]_. Errata: the two tolerances are printed swapped; a radial step from the curvature at one point is not
    that of the cusp; see the page of the paper. Points off the path: [ImaiIri1986]_ (fewest links in a tunnel).

    >>> from turnwright.surface import Plane
    >>> from turnwright.part import Part
    >>> from turnwright.tool import Tool
    >>> servo = AdaptiveToolServo(scallop=50e-6, chord=10e-6, interpolation="hermite")
    >>> spiral = servo.spiral(Part(surface=Plane(), radius=1.0), Tool(nose_radius=0.1))
    >>> inner, outer = np.interp([-100 * TURN, -50 * TURN], spiral.angle - spiral.angle[-1], spiral.radius)
    >>> bool(np.isclose((inner - outer) / 50, np.sqrt(8 * 0.1 * AIM * 50e-6), rtol=1e-3))  # the step on a flat
    True
    """

    kind = "adaptive tool servo"
    example = MappingProxyType({"scallop": "10 nm", "chord": "10 nm"})
    hidden = ("interpolation",)
    scallop: Size
    chord: Size
    interpolation: Literal["linear", "hermite"] | None = None
    off_path: Flag = True
    x_motion: Literal["servo", "split", "steady"] = "servo"
    spindle_rpm: Speed | None = None
    spindle_speeds: Speeds | None = None
    inside_out: Flag = False
    sense: Literal[1, -1] = 1
    along: Literal["z"] = "z"

    def __post_init__(self) -> None:
        check_numbers(self)
        self._check_speed()
        for name, unit in (("scallop", "mm"), ("chord", "mm"), ("spindle_rpm", "rev/min")):
            value = getattr(self, name)
            if value is not None or name != "spindle_rpm":
                positive(value, name, unit)
        if self.chord < LEAST_CHORD:
            raise InputError(
                f"chord is {self.chord:g} mm, the limit is {LEAST_CHORD:g} mm, as heights are computed to 1e-12 mm: "
                "check its unit and make it larger"
            )
        for name, choices in (("interpolation", ("linear", "hermite")), ("x_motion", ("servo", "split", "steady"))):
            if getattr(self, name) not in (*choices, *([None] if name == "interpolation" else [])):
                listed = " or ".join(f'"{choice}"' for choice in choices)
                raise InputError(f"{name} is {getattr(self, name)!r}, it must be {listed}: choose one")
        if self.sense not in (-1, 1):
            raise InputError(f"sense is {self.sense!r}, it must be 1 or -1: give the way the azimuth runs")

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral for a part and a tool.

        Raises
        ------
        GougeError
            If the scallop is as high as the edge.
        InputError
            If the chord tolerance cannot be kept because the path jumps.
        LimitError
            If there are more points than any controller takes.
        """
        if self.interpolation is None:
            raise InputError(
                'interpolation is not stated, it must be "linear" or "hermite": state what the controller does'
            )
        way = self.sense if self.inside_out else -self.sense
        steady = self.x_motion == "steady"
        steps = _Steps(part, tool, self.scallop if steady else AIM * self.scallop, self.sense, way)
        curve, end = steps.march(steady=steady, progress=progress)
        # From here on the surface ends for every tip where it ends for the outermost, as when the path is placed: were
        # it nearer than any sample, samples that are placed together would end it elsewhere than others.
        steps.rim = max(part.radius, curve.outermost())
        turned, lift = _points(self, steps, curve, end, progress)
        radius, rate = curve.at(turned)
        radius = radius - tool.offset[0]
        angle = self.sense * turned
        if not self.inside_out:
            angle = self.sense * (math.ceil(turned[-1] / TURN) * TURN - turned[::-1])
            radius, rate, lift = radius[::-1], rate[::-1], None if lift is None else lift[::-1]
        linear = self.interpolation == "linear"
        return Spiral(angle=angle, radius=radius, radius_rate=None if linear else way * rate, lift=lift)

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool takes its own table: that of its two axes."""
        return self.x_motion == "split"

    def on(self, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - as its siblings
        """Return the plan for the machine's interpolation; a two-axis fast tool makes the height of a split motion."""
        interpolation: Any = machine.controller.interpolation  # one that it does not plan for is refused in words
        servo = replace(self, interpolation=self.interpolation or interpolation)
        return FastToolServo(plan=servo) if self.x_motion == "split" else servo

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: C the azimuth [rad], X the radius, Z the height [mm].

        With a split motion X advances steadily, and U adds what the tip is away from there. [mm]
        """
        axes = {"C": path.angle, "X": path.radius, "Z": path.z if path.lift is None else path.z + path.lift}
        if self.x_motion == "split":
            steady = _amid(path.angle, path.radius)
            axes |= {"X": steady, "U": path.radius - steady}
        return axes

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivatives by the angle of these axes, or ``None`` if the path states none."""
        rates = Strategy.rates(self, path)
        if rates is not None and self.x_motion == "split":
            ends = self.axes(path)["X"][[0, -1]]
            steady = (ends[1] - ends[0]) / (path.angle[-1] - path.angle[0])
            rates |= {"X": np.full(path.angle.size, steady), "U": rates["X"] - steady}
        return rates


def _amid(angle: Floats, radius: Floats) -> Floats:
    """Return the steady motion that leaves a second axis the least stroke: the line amid the narrowest strip. (n,)."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - scipy is costly to import

    turned = angle - angle[0]
    mean = (radius[-1] - radius[0]) / turned[-1]
    # The width of the strip is convex in its slope.
    best = minimize_scalar(
        lambda part: float(np.ptp(radius - part * mean * turned)), bounds=(0.5, 1.5), method="bounded"
    )
    slope = float(best.x) * mean
    rest = radius - slope * turned
    return np.asarray(slope * turned + (rest.min() + rest.max()) / 2)


def _eased(share: Floats) -> Floats:
    """Return 0 below 0, 1 above 1, and between them what has two continuous derivatives. (n,)."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share**3 * (10 - 15 * share + 6 * share**2))


class _Curve:
    """The real radius of the tip over the angle turned: a cubic spline, with two continuous derivatives."""

    def __init__(self, values: Floats, per_turn: int, usual: float, idle: Floats) -> None:
        from scipy.linalg import solve_banded  # noqa: PLC0415 - scipy is costly to import

        self.values, self.density, self.usual, self.idle = values, per_turn / TURN, usual, idle
        right = np.empty(values.size)
        right[1:-1] = 3 * (values[2:] - values[:-2])
        right[0] = 0.0  # it begins at rest
        right[-1] = (3 * values[-1] - 4 * values[-2] + values[-3]) / 2
        bands = np.ones((3, values.size))
        bands[1] = 4.0
        bands[1, [0, -1]], bands[0, 1], bands[2, -2] = 1.0, 0.0, 0.0
        self.slopes = solve_banded((1, 1), bands, right)

    def at(self, turned: Floats) -> tuple[Floats, Floats]:
        """Return radius and derivative. (n,) [mm], (n,) [mm/rad]."""
        radius, rate = np.empty((2, turned.size))
        kernel.spline_at(self.values, self.slopes, turned * self.density, radius, rate)
        return radius, rate * self.density

    def outermost(self) -> float:
        """Return how far from the axis the tip comes, and hold the radius closely there. [mm]."""
        last = self.values.size - 1
        turned = np.clip(int(np.argmax(self.values)) + np.linspace(-2, 2, 4001), 0.0, last)
        farthest = float(self.at(turned / self.density)[0].max())
        room = (farthest - self.values) / (IDLE_LATERAL_SHARE * self.usual)
        self.idle = np.minimum(self.idle, np.clip(room, 0.0, 1.0))
        return farthest

    def aside(self, turned: Floats) -> Floats:
        """Return by how much the controller's radius may differ. (n,) [mm]."""
        here = self.at(turned)[0]
        last = (self.values.size - 1) / self.density
        inner = np.where(turned >= TURN, here - self.at(np.maximum(turned - TURN, 0.0))[0], np.inf)
        outer = np.where(turned + TURN <= last, self.at(np.minimum(turned + TURN, last))[0] - here, np.inf)
        # The lesser of the steps to the turns inside and outside, but for where a spoke comes to rest.
        step = np.maximum(np.minimum(inner, outer), self.usual / 2)
        # Next to a knot that cuts every place counts as cutting.
        knot = np.minimum((turned * self.density).astype(np.int64), self.idle.size - 2)
        idle = np.minimum(self.idle[knot], self.idle[knot + 1])
        return np.asarray(LATERAL_SHARE * step + IDLE_LATERAL_SHARE * self.usual * idle)


class _Steps:
    """One part and one tool: how far the next turn may be, on spokes that begin half a turn behind azimuth 0.

    Radii are those of the real tip, wherever X has to be for it.
    """

    def __init__(self, part: Part, tool: Tool, scallop: float, sense: int, way: int) -> None:
        self.kernel = kernel
        self.ridges = part.surface.in_pieces
        self.miss = MISS_AT_RIDGES if self.ridges else MISS
        self.part, self.tool, self.scallop, self.sense, self.way = part, tool, scallop, sense, way
        self.edge = tool.cutting_edge(sense)
        low, high = tool.arc
        height = tool.edge(np.array([low, high]))[2] - self.edge.dz
        if scallop >= height.min():
            raise GougeError(
                f"scallop is {scallop:g} mm, the arc of the tool is only {height.min():.4g} mm high, so cuts would not "
                "overlap: give a smaller scallop, or take a tool with a larger nose_radius or included angle"
            )
        self.flat = math.sqrt(8 * tool.actual_radius * scallop)
        self.width = tool.actual_radius * (math.sin(high) - math.sin(low))
        feature = part.surface.feature_size
        self.spokes = 4 * math.ceil(max(LEAST_SPOKES, SPOKES_PER_FEATURE * TURN * part.radius / feature) / 4)
        _check_count(part.radius / self.flat * self.spokes)
        azimuth = way * (TURN / self.spokes * np.arange(self.spokes) + math.pi)
        self.azimuth, self.cosine, self.sine = azimuth, np.cos(azimuth), np.sin(azimuth)
        self.every = np.arange(self.spokes)
        # When the path is placed the surface ends where the outermost tip stands, which touches at the rim: beside it
        # by the slope there.
        with np.errstate(all="ignore"):
            _, zx, zy = part.surface.evaluate(part.radius * self.cosine, part.radius * self.sine, 1)
        slope = np.nan_to_num(zx * self.cosine + zy * self.sine, nan=0.0, posinf=0.0, neginf=0.0)
        beside = tool.actual_radius * float((slope / np.sqrt(1 + slope * slope)).min())
        self.go_on, self.rest = GO_ON, REST
        self.rim = part.radius + max(-beside, 0.0) + REST * self.flat / 2
        if not self._goes_on(self.rim + tool.actual_radius * max(math.sin(high), -math.sin(low))):
            self.go_on, self.rest = GO_ON_AT_ONCE, REST_AT_ONCE
            self.rim = max(part.radius, part.radius - beside + REST_AT_ONCE * self.flat / 2)
        # The tip's height on rings, from `first` on as far as was needed so far.
        self.ring = min(feature / RINGS_PER_FEATURE, part.radius / LEAST_RINGS, tool.actual_radius / RINGS_PER_NOSE)
        self.first, self.inner, self.bend, self.lag = 0, 0.0, 0.0, 0.0
        self.height = np.empty((0, self.spokes))
        self.slope = np.empty((0, self.spokes))
        self.piece = np.empty((0, self.spokes), dtype=np.int64)

    def _goes_on(self, outermost: float) -> bool:
        """Say whether the surface goes on outside the rim as far as this, with one tangent for the nose."""
        if self.ridges:
            return False
        surface = self.part.surface
        rings = math.ceil((outermost - self.part.radius) * RINGS_PER_FEATURE / surface.feature_size)
        radius = np.linspace(self.part.radius, outermost, min(max(rings, 8), 64))[:, None]
        x, y = (radius * self.cosine).ravel(), (radius * self.sine).ravel()
        inside = surface.inside(x, y)
        if inside is not None and not inside.all():
            return False
        with np.errstate(all="ignore"):
            *_, zxx, zxy, zyy = surface.evaluate(x, y, 2)
            bend = (zxx + zyy) / 2 + np.hypot((zxx - zyy) / 2, zxy)
        return bool(bend.max() < LEVEL / self.tool.actual_radius)

    def placed(self, angle: Floats, radius: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the tip's height, its derivative by the angle at constant radius, and by the radius. Each (n,)."""
        return self._placed(angle, radius)[:3]

    def _placed(self, angle: Floats, radius: Floats) -> tuple[Floats, Floats, Floats, Ints]:
        """Return that, and which piece of the surface the edge touches, -1 where it rests between two. Each (n,)."""
        surface, sense = self.part.surface, self.sense
        at = touch(surface, self.tool, angle=angle, radius=radius - self.edge.dx, sense=sense, rim=self.rim)
        with np.errstate(all="ignore"):
            _, zx, zy = surface.evaluate(at.x, at.y, 1)
        around = zy * at.x - zx * at.y
        outward = zx * np.cos(angle) + zy * np.sin(angle)
        if self.edge.rake_sin == 0:
            # Upright, the edge slopes as its own height does, also where it rests on a ridge, which has no slope.
            outward = self.edge.slopes(at.sweep)
        sides = [surface.piece(at.x + way * np.cos(angle), at.y + way * np.sin(angle)) for way in (-BESIDE, BESIDE)]
        if sides[0] is None or sides[1] is None:
            return at.z, around, outward, np.zeros(angle.size, dtype=np.int64)
        return at.z, around, outward, np.where(sides[0] == sides[1], sides[0], -1)

    def _tips(self, radius: Floats) -> tuple[Floats, Floats]:
        """Return height and slope along the spoke of a tip on every spoke. Each (m,)."""
        low, high = int(self.inner / self.ring), int(radius.max() / self.ring) + 2
        if low < self.first:  # a new march from the axis outwards
            self.first = low
            self.height, self.slope, self.piece = self.height[:0], self.slope[:0], self.piece[:0]
        while high >= self.first + self.height.shape[0]:
            start = self.first + self.height.shape[0]
            # Many at a time, but no further outside the rim than the tip goes: the surface may end there.
            many = min(start + BLOCK // 2 // self.spokes, int(self.part.radius / self.ring))
            rings = np.arange(start, max(high, many) + 1)
            # Every ring a turn, so that points of one azimuth share their line.
            angle = self.azimuth + self.way * TURN * np.arange(rings.size)[:, None]
            radii = np.repeat(rings * self.ring, self.spokes)
            z, _, outward, piece = self._placed(angle.ravel(), radii)
            keep = slice(max(low - self.first, 0), None)
            self.first += min(max(low - self.first, 0), self.height.shape[0])
            shape = (rings.size, self.spokes)
            self.height = np.concatenate([self.height[keep], z.reshape(shape)])
            self.slope = np.concatenate([self.slope[keep], outward.reshape(shape)])
            self.piece = np.concatenate([self.piece[keep], piece.reshape(shape)])
            # Half the second derivative: what a height is off by for the square of what its radius is.
            self.bend = max(self.bend, float(np.abs(np.diff(self.slope, axis=0)).max()) / (2 * self.ring))
        tip, along = np.empty((2, radius.size))
        self.kernel.tips_at(self.first, self.ring, self.height, self.slope, self.every, radius, tip, along)
        return tip, along

    def _under(self, radius: Floats, at: Floats) -> tuple[Floats, ...]:
        """Return height and slopes of the surface under the edges, as if it were level where it is not defined."""
        x, y = np.empty((2, at.size))
        self.kernel.under(self.edge, self.cosine, self.sine, radius, at, x, y)
        with np.errstate(all="ignore"):
            f, fx, fy = self.part.surface.evaluate(x, y, 1)
        gone = ~(np.isfinite(f) & np.isfinite(fx) & np.isfinite(fy))
        if gone.any():
            f[gone], fx[gone], fy[gone] = self._tips(radius)[0][gone], 0.0, 0.0
        return f, fx, fy

    def next(self, radius: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Return on every spoke how far the next tip may be, and where its edge meets that of this one.

        Parameters
        ----------
        radius
            Where the tip stands. (m,) [mm]
        step
            About how far the next one is. (m,) [mm]
        """
        ways = (self.cosine, self.sine)
        # Rings from here on are asked for until the next turn, by tips further out too.
        self.inner = float(radius.min())
        tip, along = self._tips(radius)
        # The edge touches where it slopes as its height does along the spoke.
        slope = along / self.edge.rake_cos
        low = radius + self.tool.actual_radius * np.clip(slope / np.sqrt(1 + slope * slope), *np.sin(self.tool.arc))
        crest, high = low + step / 2, low + self.width
        low = low.copy()
        for _ in range(60):
            under = self._under(radius, crest)
            moved = self.kernel.crest_step(self.edge, *ways, self.scallop, radius, tip, *under, crest, low, high)
            if not moved > 1e-9 * self.flat:
                break
        new = radius + 1.2 * step
        low, high = radius.copy(), radius + STEP_GROWTH * step
        upright = self.edge.rake_sin == 0
        goal = self._under(radius, crest)[0] + self.scallop
        for _ in range(60):
            if not upright:  # the edge of the next tip meets the crest at another place across the rake plane
                goal = self._under(new, crest)[0] + self.scallop
            moved = self.kernel.next_step(self.edge, goal, crest, *self._tips(new), new, low, high)
            if not moved > 1e-9 * self.flat:
                break
        whole = self._on_one_piece(radius, np.maximum(new, radius + step), crest)
        found = np.maximum(new - radius, LEAST_STEP * self.flat)
        step = np.where(whole, found, step)
        if self.ridges:
            # Crests jump with the contacts from piece to piece: each counts as far inside as any was found to be.
            self.lag = min(self.lag, float((crest - radius - step / 2)[whole].min(initial=0.0)))
            crest = radius + step / 2 + self.lag
        return step, crest

    def _on_one_piece(self, radius: Floats, new: Floats, crest: Floats) -> Bools:
        """Say where the edge touches one piece all the way, with the rings that heights are from, crest included."""
        if not self.ridges:
            return np.ones(radius.size, dtype=np.bool_)
        self._tips(new)
        low, high = (np.floor(at / self.ring).astype(np.int64) - self.first for at in (radius, new))
        piece = self.piece[low, self.every]
        x, y = np.empty((2, crest.size))
        self.kernel.under(self.edge, self.cosine, self.sine, radius, crest, x, y)
        whole = (piece >= 0) & (self.part.surface.piece(x, y) == piece)
        for ring in range(1, int((high - low).max()) + 2):
            whole &= self.piece[np.minimum(low + ring, high + 1), self.every] == piece
        return whole

    def march(self, *, steady: bool, progress: Progress | None) -> tuple[_Curve, float]:
        """Return the radius over the angle turned from the axis, and the angle at which the part is cut. [rad]."""
        rim = self.part.radius
        flat = np.full(self.spokes, self.flat)
        step = self.next(np.zeros(self.spokes), flat)[0]
        least = self._steady() if steady else float(step.min())
        if steady:
            step = np.full(self.spokes, least)
        # Half a turn from rest on the axis to the steady advance.
        begin = 2 * np.arange(self.spokes // 2) / self.spokes
        parts = [least * begin**3 * (1 - begin / 2) / 2]
        idle = [np.zeros(begin.size)]
        # The first whole turn: Archimedean, but for what joins it smoothly to the second.
        share = np.arange(self.spokes) / self.spokes
        radius = least * (0.25 + share)
        if not steady:
            radius = radius + self._joint(radius, step, share, least)
        total, short = parts[0].size, 0
        beyond = np.zeros(self.spokes)
        crest, taken = np.full(self.spokes, np.nan), step
        while True:
            new, met = self.next(radius, step)
            # Outside the rim there is no cusp to ask for, and soon no surface: steps and crests go over to going on as
            # before, so that a spoke just inside and its neighbour just outside stay side by side.
            share = _eased(beyond / self.go_on)
            crest = np.where(share > 0, met + share * (crest + taken - met), met)
            new = new + share * (step - new)
            parts.append(radius)
            idle.append(np.clip(beyond / IDLE_LATERAL_SHARE, 0.0, 1.0))
            beyond = (crest - rim) / step
            if not steady:
                step = new - (new - step) * _eased(beyond / self.go_on)
            inside = np.flatnonzero(crest < rim)
            if inside.size:
                short = total + int(inside[-1]) + 1
            total += self.spokes
            _check_count(total)
            # One turn after the last crest inside the rim every spoke has had a pass that reaches it; the tip comes to
            # rest, and samples go on for the step that passes the end.
            if total >= short + self.spokes * (1 + (LAST + WIDEST_STEP) / TURN) + 2:
                break
            if progress is not None:
                progress(round(500 * min(float(radius.min()) / rim, 1.0)), 1000)
            # A spoke whose crest is outside the rim comes to rest within some steps.
            taken = step if steady else step * (1 - _eased(beyond / self.rest))
            radius = radius + taken
        values, done = np.concatenate(parts), short + self.spokes
        end = done * TURN / self.spokes
        if not steady:  # whose X goes on
            ahead = np.arange(0.5, values.size - 1 - done, dtype=np.float64)
            fading = 1 - _eased(ahead * (TURN / self.spokes / LAST))
            values[done + 1 :] = values[done] + np.cumsum(np.diff(values[done:]) * fading)
            end += LAST
        return _Curve(values, self.spokes, self.flat, np.concatenate(idle)), end

    def _joint(self, radius: Floats, step: Floats, share: Floats, least: float) -> Floats:
        """Return what a first turn lacks for its radius and two derivatives to go over into the next turn's."""
        ends = (radius + self.next(radius, step)[0])[:5]
        h = 1 / self.spokes
        value = ends[0] - 1.25 * least
        rate = ends @ [-25, 48, -36, 16, -3] / (12 * h) - least
        bend = ends @ [35, -104, 114, -56, 11] / (12 * h * h)
        return np.asarray(
            value * _eased(share)
            - rate * share**3 * (1 - share) * (4 - 3 * share)
            + bend * share**3 * (1 - share) ** 2 / 2
        )

    def _steady(self) -> float:
        """Return the largest feed that keeps the scallop everywhere. [mm]."""
        step, least, radius = np.full(self.spokes, self.flat), math.inf, np.zeros(self.spokes)
        while True:
            step, crest = self.next(radius, step)
            inside = crest < self.part.radius
            if not inside.any():
                return least
            least = min(least, float(step[inside].min()))
            radius = radius + min(2 * self.ring, self.part.radius / LEAST_RINGS)


def _points(
    servo: AdaptiveToolServo, steps: _Steps, curve: _Curve, end: float, progress: Progress | None
) -> tuple[Floats, Floats | None]:
    """Return the angles turned at which the points stand [rad], and their lift [mm] or ``None``. (n,)."""
    hermite = servo.interpolation == "hermite"
    off = servo.off_path and not hermite
    slack = servo.chord * (1 - 3 / steps.miss - (1 / ROUGH if steps.ridges else 0) - (BETWEEN if hermite else 0))
    if not hermite:
        _check_count(_foreseen(steps, curve, end, slack * (2 if off else 1)))
    nodes, lifts = [np.zeros(1)], [np.zeros(1)]
    for low, high, per_turn in _blocks(steps, curve, end):
        # From the sample before the last node on, so that no node is there for the border's sake.
        first = math.floor(min(low, nodes[-1][-1]) * per_turn / TURN)
        last = math.ceil(high * per_turn / TURN) + 1
        path = _sampled(steps, curve, np.arange(first, last + 1) * (TURN / per_turn), servo.chord, hermite=hermite)
        # The first node stands within the first interval.
        path = np.ascontiguousarray(path[:, max(int(np.searchsorted(path[0], nodes[-1][-1], side="right")) - 1, 0) :])
        begin, stop = float(nodes[-1][-1]), min(end, high)
        at, lift = np.empty((2, path.shape[1] + 1))
        if off:
            count = kernel.off_path(path, begin, float(lifts[-1][-1]), stop, slack, steps.bend, WIDEST_STEP, at, lift)
        else:
            count = kernel.on_path(path, begin, stop, slack, steps.bend, WIDEST_STEP, hermite, at)
        nodes.append(at[1:count].copy())
        lifts.append(lift[1:count].copy())
        _check_count(sum(part.size for part in nodes))
        if progress is not None:
            progress(round(500 * (1 + min(high / end, 1.0))), 1000)
    return np.concatenate(nodes), np.concatenate(lifts) if off else None


def _foreseen(steps: _Steps, curve: _Curve, end: float, slack: float) -> float:
    """Return about how many points straight lines take, or fewer, from some turns of the path."""
    per_turn = math.ceil(
        max(LEAST_SPOKES, SPOKES_PER_FEATURE * TURN * steps.part.radius / steps.part.surface.feature_size)
    )
    turned = end * (np.arange(GLANCES)[:, None] + 0.5) / GLANCES + TURN / per_turn * np.arange(per_turn)
    turned = np.minimum(turned, end)
    z = steps.placed(steps.way * turned.ravel(), curve.at(turned.ravel())[0])[0].reshape(turned.shape)
    bend = np.abs(np.diff(z, 2, axis=1))
    return float(np.sqrt(bend / (8 * slack)).sum()) * end / TURN / GLANCES


def _blocks(steps: _Steps, curve: _Curve, end: float) -> Iterator[tuple[float, float, int]]:
    """Return angles turned where blocks of the path begin and end [rad], and how many samples a turn each is to have.

    The same azimuths in every turn of a block are placed at a fraction of the cost of as many scattered ones.
    """
    turns = math.ceil(end / TURN)
    low = 0
    while low < turns:
        # Twice as far out at most, as the samples of the inner turns would be too close together.
        outer = np.arange(low + 1, turns + 1, dtype=np.float64)
        radius = curve.at(TURN * outer)[0]
        per_turn = np.maximum(LEAST_SPOKES, SAMPLES_PER_FEATURE * TURN * radius / steps.part.surface.feature_size)
        fit = (per_turn <= 2 * per_turn[0] + 1024) & (per_turn * (outer - low) <= BLOCK)
        high = low + max(int(np.count_nonzero(fit)), 1)
        count = 12 * math.ceil(per_turn[high - low - 1] / 12)
        # The last one goes on for the step that passes the end.
        yield low * TURN, high * TURN if high < turns else end + WIDEST_STEP, count
        low = high


def _sampled(steps: _Steps, curve: _Curve, turned: Floats, chord: float, *, hermite: bool) -> Floats:
    """Sample a path until the cubics between the samples, and straight lines between those, miss next to nothing.

    A cubic over two intervals misses the sample between them by 16 times what those over each of them miss, if the path
    is smooth, and by no less if it has a kink.

    Returns
    -------
    ndarray
        Angle turned, height, its derivative, radius, its derivative, slope of the height along the radius, and
        how far the radius may be aside. (7, n)
    """

    def placed(turned: Floats) -> Floats:
        radius, rate = curve.at(turned)
        z, around, outward = steps.placed(steps.way * turned, radius)
        return np.stack([turned, z, steps.way * around + outward * rate, radius, rate, outward])

    path = placed(turned)
    while True:
        if steps.ridges:  # the surface has no slope where the edge rests on one; the path has
            path[2] = np.gradient(path[1], path[0], edge_order=2)
        doubt = _doubt(path)
        wide = doubt > chord / steps.miss
        if steps.ridges:
            wide &= (doubt > chord / ROUGH) | (np.diff(path[0]) > SHORT)
        coarse = np.flatnonzero(wide)
        if coarse.size == 0:
            break
        if path.shape[1] == turned.size and coarse.size > path.shape[1] // FEW:
            # Twice as many even samples, at the same azimuths in every turn, are placed sooner than those scattered.
            _check_samples(2 * turned.size, chord)
            turned = np.linspace(turned[0], turned[-1], 2 * turned.size - 1)
            path = placed(turned)
            continue
        middle = (path[0, coarse] + path[0, coarse + 1]) / 2
        narrow = path[0, coarse + 1] - path[0, coarse]
        if narrow.min() < FINEST:
            where = middle[np.argmin(narrow)] / TURN
            raise InputError(
                f"the path jumps {where:.3f} turns from the inner end, so no points keep it within the chord "
                f"{chord:g} mm: use a strategy with points_per_rev or arc_length, or a tool with a smaller included "
                "angle"
            )
        _check_samples(path.shape[1] + coarse.size, chord)
        path = np.insert(path, coarse + 1, placed(middle), axis=1)
    t, z, dz, x, dx, s = path
    if hermite:
        pieces = SAMPLES_PER_BLOCK / 2 * (doubt / chord) ** 0.25
    else:
        pieces = np.sqrt(steps.miss / (8 * chord) * (_bend(t, z, dz) + np.abs(s[:-1]) * _bend(t, x, dx)))
    parts = np.maximum(np.ceil(pieces), 1).astype(np.int64)
    _check_samples(int(parts.sum()), chord)
    out = np.empty((7, int(parts.sum()) + 1))
    kernel.refine(np.vstack([path, curve.aside(t)]), parts, out)
    return out


def _doubt(path: Floats) -> Floats:
    """Return how far cubics over each interval and either neighbour miss the sample between them. (n - 1,) [mm]."""
    t, z, dz, x, dx, s = path
    whole, part = t[2:] - t[:-2], (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])

    def miss_of(f: Floats, df: Floats) -> Floats:
        rise, a = f[2:] - f[:-2], whole * df[:-2]
        c = a + whole * df[2:] - 2 * rise
        return np.asarray(np.abs(f[:-2] + part * (a + part * (rise - a - c + part * c)) - f[1:-1]))

    miss = miss_of(z, dz) + np.abs(s[1:-1]) * miss_of(x, dx)
    return np.asarray(np.maximum(np.append(miss[:1], miss), np.append(miss, miss[-1:])))


def _bend(t: Floats, z: Floats, dz: Floats) -> Floats:
    """Return by how much straight lines would bulge, as second derivative times the squared interval. (n - 1,)."""
    h = np.diff(t)
    rise = np.diff(z)
    a, b = h * dz[:-1], h * dz[1:]
    return np.maximum(np.abs(6 * rise - 4 * a - 2 * b), np.abs(2 * a + 4 * b - 6 * rise))


def _check_samples(count: int, chord: float) -> None:
    """Raise if a path is so rough that no sampling of it fits into memory."""
    if count > MOST_SAMPLES:
        raise LimitError(
            f"a block of the path takes {count:.3g} samples to keep within the chord {chord:g} mm, the limit is "
            f"{MOST_SAMPLES:.3g}: allow a larger chord, or use a strategy with points_per_rev or arc_length"
        )


def _check_count(count: float) -> None:
    """Raise if a spiral has more points than any controller takes."""
    if count > MOST_POINTS:
        raise LimitError(
            f"the spiral takes {count:.3g} points or samples, the limit is {MOST_POINTS:.0e}: check the units of the "
            "scallop and of the chord, and make one larger"
        )
