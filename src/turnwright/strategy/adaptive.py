"""The adaptive tool servo: feed as large as the scallop allows, points as far apart as the chord allows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import adaptive as kernel
from turnwright.edge import Edge
from turnwright.errors import GougeError, InputError
from turnwright.machine import Machine
from turnwright.part import Part
from turnwright.path import Path, Spiral
from turnwright.placing import Tips, touch_down
from turnwright.progress import Progress, run_chunks
from turnwright.speed_profile import Speeds
from turnwright.strategy.base import Strategy
from turnwright.strategy.fast import FastToolServo
from turnwright.strategy.sampling import (
    REFINEMENT_RATIO,
    TURN,
    WIDEST_STEP,
    check_count,
    check_interval,
    check_samples,
)
from turnwright.tool import Tool
from turnwright.units import Flag, Size, Speed

__all__ = ["AdaptiveToolServo"]

LENGTHS = "scallop and chord"
"""Fields whose wrong unit gives too many points."""

END_ANGLE_RAD = TURN / 24
"""After the last revolution the radius comes to rest within this angle, so that the outermost tip, which sets the rim
for all tips, is the last point of the program and not between two points. [rad]"""

CHUNK = 16384
"""Points whose slopes are computed together."""

SPOKES_PER_FEATURE = 4
MIN_SPOKES = 256
RINGS_PER_FEATURE = 8
MIN_RINGS = 256
RINGS_PER_NOSE = 16
"""Density of the grid on which steps are computed: spokes around the rim, and rings between which a cubic interpolates
the tip's height."""

SAMPLES_PER_FEATURE = 8
"""Samples of the path along the outermost revolution of a block, before refinement."""

BLOCK_SAMPLES = 1 << 21
"""Samples that are placed together."""

MIN_STEP_FRACTION = 0.1
"""Least step, as a fraction of that on a flat: in a valley too sharp for the nose, every step leaves a cusp."""

STEP_TOL = 1e-6
"""Newton's method ends at a step below this fraction of that on a flat; the error is then about the square of it."""

MAX_STEP_GROWTH = 4.0
"""A step grows at most by this factor from one revolution to the next."""

PIECE_OFFSET_MM = 1e-7
"""A contact with another piece of the surface within this distance on either side lies between two pieces. [mm]"""

LATERAL_FRACTION = 3e-3
"""Largest error of the controller's radius between the points, as a fraction of a step. Relative to its height, a cusp
changes by up to four times as much, since it lies between two passes."""

SCALLOP_FRACTION = 0.9925
"""Nominal height of the cusps, as a fraction of the scallop: with radius errors of both passes they are from 98 to
100.5 % of the scallop."""

BLEND_STEPS = 8.0
STOP_STEPS = 24.0
"""Outside the rim, the steps of a spoke blend into a constant step within the first number of steps, and this comes to
rest within the second number: so slowly that the jerk of X is hardly higher than inside the rim."""

SHORT_BLEND_STEPS = 1.0
SHORT_STOP_STEPS = 3.0
"""The same where the surface does not extend that far."""

MAX_CURVATURE_RATIO = 0.9
"""A surface extends outside the rim as far as its upward curvature is below this fraction of the nose's; with more
curvature, the contact may jump."""

IDLE_LATERAL_FRACTION = 0.1
"""A pass whose cusp with the previous pass is outside the rim cuts nothing inside it, so no cusp depends on it. Its
radius may be off by the distance of that cusp from the rim, up to this fraction of the step on a flat; the cusp moves
by half of that."""

SAMPLING_FACTOR = 200
"""The straight lines between samples, and the cubics that interpolate them, may each have an error of the chord over
this factor."""

RIDGE_SAMPLING_FACTOR = 40
"""The same for a surface with ridges and valleys, whose slope discontinuities take ever closer samples."""

RIM_SAMPLING_FACTOR = 8
RIM_INTERVAL_RAD = 2e-5
"""Close to the rim of a surface with ridges the height is accurate to some tenths of a nanometre only. In intervals of
at most this angle [rad] an error up to the chord over RIM_SAMPLING_FACTOR is therefore accepted."""

SAMPLES_PER_BLOCK = 16
"""Samples per cubic of a program: its largest error between them is within a hundredth of that at the samples."""

CUBIC_CHORD_FRACTION = 0.025
"""A cubic that leads from a flat into a structure has its largest error in its last few samples, and between two of
them up to this fraction of the chord more. The reserve costs half a percent more points."""

MIN_CHORD_MM = 1e-10
"""Least chord: heights are computed to about 1e-12 mm, and the path has to be far more accurate than the chord. [mm]"""

PREVIEW_REVS = 16
"""Revolutions from which the number of points is estimated, so that a wrong unit is detected at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptiveToolServo(Strategy):
    r"""Adaptive tool servo: every cusp as high as the scallop allows, as few points as the chord allows.

    Neighbouring edges meet exactly ``scallop`` above the surface, and each point is the furthest from the previous one
    for which the interpolation of the controller keeps within ``chord`` of the exact height of the tip *at its actual
    radius*. With linear interpolation the points may be off the path by the chord (`Path.lift`).

    The scallop is kept on surfaces without slope discontinuities. Where the contact changes from one piece of a lens
    array to another, the step of the previous piece is continued, so that cusps in a sharp valley or at a ridge are
    those of a constant feed of that step. The fields of every strategy are those of `Strategy`.

    Parameters
    ----------
    scallop
        Largest cusp height between neighbouring revolutions. Cusps are planned at 99.25 % of it. Radius errors from
        the interpolation between points change them to 98 to 100.5 %; the height error of the tip, up to the chord,
        comes on top. [mm]
    chord
        Largest height between the exact path and the interpolation of the controller. [mm]
    interpolation
        Interpolation of the controller: "linear" in the axes, or "hermite" (PVT), cubics through positions and
        velocities, which are those at constant spindle speed. In a job it is that of the machine's controller.
    off_path
        Whether the points of a linear program may be off the exact path. Cubics always pass through it.
    x_motion
        "servo": X follows the steps. "split": the same path, with X in steady motion and the difference on U, the
        second axis of a fast tool. "steady": the largest constant feed that keeps every cusp within the scallop; only
        the points adapt, and X needs no servo. `FastToolServo` takes either of the last two as its plan.

    Raises
    ------
    InputError
        If a length is not positive, or an option is not one of those above.

    Sources
    -------
    [ZhuTo2015]_. Errata: the two tolerances are printed swapped; a radial step from the curvature at one point is not
    that of the cusp; see the page of the paper. Points off the path: [ImaiIri1986]_ (polyline of fewest segments).

    >>> from turnwright.surface import Plane
    >>> from turnwright.part import Part
    >>> from turnwright.tool import Tool
    >>> servo = AdaptiveToolServo(scallop=50e-6, chord=10e-6, interpolation="hermite")
    >>> spiral = servo.spiral(Part(surface=Plane(), radius=1.0), Tool(nose_radius=0.1))
    >>> inner, outer = np.interp([-100 * TURN, -50 * TURN], spiral.angle - spiral.angle[-1], spiral.radius)
    >>> bool(np.isclose((inner - outer) / 50, np.sqrt(8 * 0.1 * SCALLOP_FRACTION * 50e-6), rtol=1e-3))
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
        self._check_fields()
        if self.chord < MIN_CHORD_MM:
            raise InputError(
                f"chord is {self.chord:g} mm, the limit is {MIN_CHORD_MM:g} mm, as heights are computed to 1e-12 mm: "
                "check its unit"
            )

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral for a part and a tool, see `Strategy`."""
        if self.interpolation is None:
            raise InputError('interpolation is not set, it must be "linear" or "hermite": set that of the controller')
        way = self.sense if self.inside_out else -self.sense
        steady = self.x_motion == "steady"
        edge = tool.cutting_edge(self.sense)
        steps = _Steps(part, edge, self.scallop if steady else SCALLOP_FRACTION * self.scallop, way)
        curve, end = steps.march(steady=steady, progress=progress)
        # From here on the rim is that of the outermost tip, for every tip, as when the path is placed. A smaller rim
        # would depend on which samples are placed together.
        steps.rim = max(part.reach, curve.outermost())
        turned, lift = _set_points(self, steps, curve, end, progress)
        radius, rate = curve.at(turned)
        radius = radius - edge.dx
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

    def adapted_to(self, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - as its siblings
        """Return the plan for the machine's interpolation; a two-axis fast tool makes the height of a split motion."""
        # An unsupported one raises an InputError.
        interpolation: Any = "linear" if machine.controller.is_straight else machine.controller.interpolation
        servo = replace(self, interpolation=self.interpolation or interpolation)
        return FastToolServo(plan=servo) if self.x_motion == "split" else servo

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: C the azimuth [rad], X the radius, Z the height [mm].

        With a split motion X advances steadily, and U is the difference between the tip and X. [mm]
        """
        axes = {"C": path.angle, "X": path.radius, "Z": path.z if path.lift is None else path.z + path.lift}
        if self.x_motion == "split":
            steady = _fit_steady_motion(path.angle, path.radius)
            axes |= {"X": steady, "U": path.radius - steady}
        return axes

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivatives by the angle of these axes, or ``None`` if the path has none."""
        rates = Strategy.rates(self, path)
        if rates is not None and self.x_motion == "split":
            ends = self.axes(path)["X"][[0, -1]]
            steady = (ends[1] - ends[0]) / (path.angle[-1] - path.angle[0])
            rates |= {"X": np.full(path.angle.size, steady), "U": rates["X"] - steady}
        return rates


def _fit_steady_motion(angle: Floats, radius: Floats) -> Floats:
    """Return the steady motion that gives a second axis the least stroke: the middle of the narrowest strip. (n,)."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - scipy is costly to import

    turned = angle - angle[0]
    mean = (radius[-1] - radius[0]) / turned[-1]
    # The width of the strip is convex in its slope.
    best = minimize_scalar(
        lambda part: float(np.ptp(radius - part * mean * turned)), bounds=(0.5, 1.5), method="bounded"
    )
    slope = float(best.x) * mean
    deviation = radius - slope * turned
    return np.asarray(slope * turned + (deviation.min() + deviation.max()) / 2)


def _ease(share: Floats) -> Floats:
    """Return 0 below 0, 1 above 1, and between them a blend with two continuous derivatives. (n,)."""
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
        kernel.spline_at(self.values, self.slopes, self.density, turned, radius, rate)
        return radius, rate

    def outermost(self) -> float:
        """Return the largest radius of the tip, and tighten the radius tolerance there. [mm]."""
        last = self.values.size - 1
        turned = np.clip(int(np.argmax(self.values)) + np.linspace(-2, 2, 4001), 0.0, last)
        farthest = float(self.at(turned / self.density)[0].max())
        room = (farthest - self.values) / (IDLE_LATERAL_FRACTION * self.usual)
        self.idle = np.minimum(self.idle, np.clip(room, 0.0, 1.0))
        return farthest

    def lateral_tolerance(self, turned: Floats) -> Floats:
        """Return the largest error of the controller's radius that is allowed. (n,) [mm]."""
        tolerance = np.empty(turned.size)
        kernel.lateral_tolerance(
            self.values, self.slopes, self.density, self.idle, self.usual, LATERAL_FRACTION, IDLE_LATERAL_FRACTION,
            turned, tolerance,
        )  # fmt: skip
        return tolerance


class _Steps:
    """Largest steps to the next revolution for one part and tool, on spokes that begin half a turn before azimuth 0.

    Radii are those of the real tip, not of X.
    """

    def __init__(self, part: Part, edge: Edge, scallop: float, way: int) -> None:
        self.ridges = part.surface.in_pieces
        self.miss = RIDGE_SAMPLING_FACTOR if self.ridges else SAMPLING_FACTOR
        self.part, self.edge, self.scallop, self.way = part, edge, scallop, way
        height = edge.points([edge.low, edge.high])[2] - edge.dz
        if scallop >= height.min():
            raise GougeError(
                f"scallop is {scallop:g} mm, the arc of the tool is only {height.min():.4g} mm high, so cuts do not "
                "overlap: set a smaller scallop, or use a tool with a larger nose_radius or included angle"
            )
        self.flat = math.sqrt(8 * edge.radius * scallop)
        self.width = edge.radius * (math.sin(edge.high) - math.sin(edge.low))
        feature = part.surface.feature_size
        self.spokes = 4 * math.ceil(max(MIN_SPOKES, SPOKES_PER_FEATURE * TURN * part.reach / feature) / 4)
        check_count(part.reach / self.flat * self.spokes, LENGTHS)
        azimuth = way * (TURN / self.spokes * np.arange(self.spokes) + math.pi)
        self.azimuth, self.cosine, self.sine = azimuth, np.cos(azimuth), np.sin(azimuth)
        self.every = np.arange(self.spokes)
        # When the path is placed, the surface ends at the outermost tip. This tip touches at the rim, at an offset that
        # depends on the slope there.
        with np.errstate(all="ignore"):
            _, zx, zy = part.surface.evaluate(part.reach * self.cosine, part.reach * self.sine, 1)
        slope = np.nan_to_num(zx * self.cosine + zy * self.sine, nan=0.0, posinf=0.0, neginf=0.0)
        rim_offset = edge.radius * float((slope / np.sqrt(1 + slope * slope)).min())
        self.blend_steps, self.stop_steps = BLEND_STEPS, STOP_STEPS
        self.rim = part.reach + max(-rim_offset, 0.0) + STOP_STEPS * self.flat / 2
        if not self._continues(self.rim + edge.radius * max(math.sin(edge.high), -math.sin(edge.low))):
            self.blend_steps, self.stop_steps = SHORT_BLEND_STEPS, SHORT_STOP_STEPS
            self.rim = max(part.reach, part.reach - rim_offset + SHORT_STOP_STEPS * self.flat / 2)
        # The tip's height on rings, from `first` on, as far as computed so far.
        self.placed_to = self.rim if self.stop_steps == STOP_STEPS else part.reach
        self.ring = min(feature / RINGS_PER_FEATURE, part.reach / MIN_RINGS, edge.radius / RINGS_PER_NOSE)
        self.first, self.inner, self.bend, self.lag = 0, 0.0, 0.0, 0.0
        self.height = np.empty((0, self.spokes))
        self.slope = np.empty((0, self.spokes))
        self.piece = np.empty((0, self.spokes), dtype=np.int64)

    def _continues(self, outermost: float) -> bool:
        """Return whether the surface extends to this radius outside the rim, with a unique tangent for the nose."""
        if self.ridges:
            return False
        surface = self.part.surface
        rings = math.ceil((outermost - self.part.reach) * RINGS_PER_FEATURE / surface.feature_size)
        radius = np.linspace(self.part.reach, outermost, min(max(rings, 8), 64))[:, None]
        x, y = (radius * self.cosine).ravel(), (radius * self.sine).ravel()
        inside = surface.inside(x, y)
        if inside is not None and not inside.all():
            return False
        with np.errstate(all="ignore"):
            *_, zxx, zxy, zyy = surface.evaluate(x, y, 2)
            bend = (zxx + zyy) / 2 + np.hypot((zxx - zyy) / 2, zxy)
        return bool(bend.max() < MAX_CURVATURE_RATIO / self.edge.radius)

    def place(self, angle: Floats, radius: Floats) -> tuple[Floats, Floats, Floats, Ints]:
        """Return the tip's height, its derivative by the angle at constant radius, and by the radius, and the piece.

        The piece is that of the surface that the edge touches, -1 between two pieces. Each (n,)
        """
        surface = self.part.surface
        at = touch_down(surface, self.edge, Tips.at(angle, radius - self.edge.dx), self.rim)
        around, outward = np.empty((2, angle.size))

        def work(start: int, stop: int) -> None:
            some = slice(start, stop)
            x, y = at.x[some], at.y[some]
            with np.errstate(all="ignore"):
                _, zx, zy = surface.evaluate(x, y, 1)
            kernel.tip_slopes(self.edge, angle[some], radius[some], x, y, zx, zy, around[some], outward[some])

        run_chunks(work, angle.size, CHUNK)
        if not self.ridges:
            return at.z, around, outward, np.zeros(angle.size, dtype=np.int64)
        hair = PIECE_OFFSET_MM * np.stack([np.cos(angle), np.sin(angle)])
        sides = [surface.piece(at.x + way * hair[0], at.y + way * hair[1]) for way in (-1, 1)]
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
            # Many rings together, but where the surface may end not further outside the rim than the tip goes.
            many = min(start + BLOCK_SAMPLES // 2 // self.spokes, int(self.placed_to / self.ring))
            rings = np.arange(start, max(high, many) + 1)
            # Each ring is placed as a revolution, so that points of one azimuth share their line.
            angle = self.azimuth + self.way * TURN * np.arange(rings.size)[:, None]
            radii = np.repeat(rings * self.ring, self.spokes)
            z, _, outward, piece = self.place(angle.ravel(), radii)
            keep = slice(max(low - self.first, 0), None)
            self.first += min(max(low - self.first, 0), self.height.shape[0])
            shape = (rings.size, self.spokes)
            self.height = np.concatenate([self.height[keep], z.reshape(shape)])
            self.slope = np.concatenate([self.slope[keep], outward.reshape(shape)])
            self.piece = np.concatenate([self.piece[keep], piece.reshape(shape)])
            # Half the second derivative: the height error per square of the radius error.
            self.bend = max(self.bend, float(np.abs(np.diff(self.slope, axis=0)).max()) / (2 * self.ring))
        tip, along = np.empty((2, radius.size))
        kernel.tips_at(self.first, self.ring, self.height, self.slope, self.every, radius, tip, along)
        return tip, along

    def _evaluate_under(self, radius: Floats, at: Floats) -> tuple[Floats, ...]:
        """Return height and slopes of the surface under the edges; where it is not defined, it counts as level."""
        x, y = np.empty((2, at.size))
        kernel.under(self.edge, self.cosine, self.sine, radius, at, x, y)
        with np.errstate(all="ignore"):
            f, fx, fy = self.part.surface.evaluate(x, y, 1)
        gone = ~(np.isfinite(f) & np.isfinite(fx) & np.isfinite(fy))
        if gone.any():
            f[gone], fx[gone], fy[gone] = self._tips(radius)[0][gone], 0.0, 0.0
        return f, fx, fy

    def find_step(self, radius: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Return on every spoke the largest step to the next tip, and the radius at which both edges meet.

        ``radius`` is that of the tip, ``step`` a first guess of the step. Each (m,) [mm]
        """
        ways = (self.cosine, self.sine)
        # Rings from this radius on are needed until the next revolution.
        self.inner = float(radius.min())
        tip, along = self._tips(radius)
        # The contact on the edge follows from the slope of the tip's height along the spoke.
        slope = along / self.edge.rake_cos
        low = radius + self.edge.radius * np.clip(
            slope / np.sqrt(1 + slope * slope), math.sin(self.edge.low), math.sin(self.edge.high)
        )
        crest, high = low + step / 2, low + self.width
        low = low.copy()
        for _ in range(60):
            under = self._evaluate_under(radius, crest)
            moved = kernel.crest_step(self.edge, *ways, self.scallop, radius, tip, *under, crest, low, high)
            if not moved > STEP_TOL * self.flat:
                break
        new = radius + 1.2 * step
        low, high = radius.copy(), radius + MAX_STEP_GROWTH * step
        upright = self.edge.rake_sin == 0
        goal = self._evaluate_under(radius, crest)[0] + self.scallop
        for _ in range(60):
            if not upright:  # with rake, the next edge meets the crest at another place across the rake plane
                goal = self._evaluate_under(new, crest)[0] + self.scallop
            moved = kernel.next_step(self.edge, goal, crest, *self._tips(new), new, low, high)
            if not moved > STEP_TOL * self.flat:
                break
        on_one_piece = self._lies_on_one_piece(radius, np.maximum(new, radius + step), crest)
        new_step = np.maximum(new - radius, MIN_STEP_FRACTION * self.flat)
        step = np.where(on_one_piece, new_step, step)
        if self.ridges:
            # Crests jump with the contacts from piece to piece: the largest inward shift so far is used for all.
            self.lag = min(self.lag, float((crest - radius - step / 2)[on_one_piece].min(initial=0.0)))
            crest = radius + step / 2 + self.lag
        return step, crest

    def _lies_on_one_piece(self, radius: Floats, new: Floats, crest: Floats) -> Bools:
        if not self.ridges:
            return np.ones(radius.size, dtype=np.bool_)
        self._tips(new)
        low, high = (np.floor(at / self.ring).astype(np.int64) - self.first for at in (radius, new))
        piece = self.piece[low, self.every]
        x, y = np.empty((2, crest.size))
        kernel.under(self.edge, self.cosine, self.sine, radius, crest, x, y)
        on_one_piece = (piece >= 0) & (self.part.surface.piece(x, y) == piece)
        for ring in range(1, int((high - low).max()) + 2):
            on_one_piece &= self.piece[np.minimum(low + ring, high + 1), self.every] == piece
        return on_one_piece

    def march(self, *, steady: bool, progress: Progress | None) -> tuple[_Curve, float]:
        """Return the radius over the angle turned from the axis, and the angle at which the cut is complete. [rad]."""
        rim = self.part.reach
        flat = np.full(self.spokes, self.flat)
        step = self.find_step(np.zeros(self.spokes), flat)[0]
        least = self._find_steady_feed() if steady else float(step.min())
        if steady:
            step = np.full(self.spokes, least)
        # Half a turn from rest on the axis to the steady advance.
        begin = 2 * np.arange(self.spokes // 2) / self.spokes
        parts = [least * begin**3 * (1 - begin / 2) / 2]
        idle = [np.zeros(begin.size)]
        # The first full revolution: Archimedean, plus a blend into the second one.
        share = np.arange(self.spokes) / self.spokes
        radius = least * (0.25 + share)
        if not steady:
            radius = radius + self._blend_first_turn(radius, step, share, least)
        total, short = parts[0].size, 0
        beyond = np.zeros(self.spokes)
        crest, taken = np.full(self.spokes, np.nan), step
        while True:
            new, met = self.find_step(radius, step)
            # Outside the rim there is no cusp to limit, and further out no surface: steps and crests blend into those
            # of the previous revolution, so that neighbouring spokes inside and outside the rim stay together.
            share = _ease(beyond / self.blend_steps)
            crest = np.where(share > 0, met + share * (crest + taken - met), met)
            new = new + share * (step - new)
            parts.append(radius)
            idle.append(np.clip(beyond / IDLE_LATERAL_FRACTION, 0.0, 1.0))
            beyond = (crest - rim) / step
            if not steady:
                step = new - (new - step) * _ease(beyond / self.blend_steps)
            inside = np.flatnonzero(crest < rim)
            if inside.size:
                short = total + int(inside[-1]) + 1
            total += self.spokes
            check_count(total, LENGTHS)
            # One revolution after the last crest inside the rim, every spoke has a pass that reaches the rim. The tip
            # comes to rest, and the samples continue for the step that passes the end.
            if total >= short + self.spokes * (1 + (END_ANGLE_RAD + WIDEST_STEP) / TURN) + 2:
                break
            if progress is not None:
                progress(round(500 * min(float(radius.min()) / rim, 1.0)), 1000)
            # A spoke whose crest is outside the rim comes to rest within some steps.
            taken = step if steady else step * (1 - _ease(beyond / self.stop_steps))
            radius = radius + taken
        values, done = np.concatenate(parts), short + self.spokes
        end = done * TURN / self.spokes
        if not steady:  # a steady X keeps its feed
            ahead = np.arange(0.5, values.size - 1 - done, dtype=np.float64)
            fading = 1 - _ease(ahead * (TURN / self.spokes / END_ANGLE_RAD))
            values[done + 1 :] = values[done] + np.cumsum(np.diff(values[done:]) * fading)
            end += END_ANGLE_RAD
        return _Curve(values, self.spokes, self.flat, np.concatenate(idle)), end

    def _blend_first_turn(self, radius: Floats, step: Floats, share: Floats, least: float) -> Floats:
        """Return what to add to the first revolution so that its radius joins the next with two derivatives."""
        ends = (radius + self.find_step(radius, step)[0])[:5]
        h = 1 / self.spokes
        value = ends[0] - 1.25 * least
        rate = ends @ [-25, 48, -36, 16, -3] / (12 * h) - least
        bend = ends @ [35, -104, 114, -56, 11] / (12 * h * h)
        return np.asarray(
            value * _ease(share)
            - rate * share**3 * (1 - share) * (4 - 3 * share)
            + bend * share**3 * (1 - share) ** 2 / 2
        )

    def _find_steady_feed(self) -> float:
        """Return the largest feed that keeps the scallop everywhere. [mm]."""
        step, least, radius = np.full(self.spokes, self.flat), math.inf, np.zeros(self.spokes)
        while True:
            step, crest = self.find_step(radius, step)
            inside = crest < self.part.reach
            if not inside.any():
                return least
            least = min(least, float(step[inside].min()))
            radius = radius + min(2 * self.ring, self.part.reach / MIN_RINGS)


def _set_points(
    servo: AdaptiveToolServo, steps: _Steps, curve: _Curve, end: float, progress: Progress | None
) -> tuple[Floats, Floats | None]:
    """Return the angles turned at which the points stand [rad], and their lift [mm] or ``None``. (n,)."""
    hermite = servo.interpolation == "hermite"
    off = servo.off_path and not hermite
    slack = servo.chord * (
        1 - 3 / steps.miss - (1 / RIM_SAMPLING_FACTOR if steps.ridges else 0) - (CUBIC_CHORD_FRACTION if hermite else 0)
    )
    if not hermite:
        check_count(_estimate_point_count(steps, curve, end, slack * (2 if off else 1)), LENGTHS)
    nodes, lifts = [np.zeros(1)], [np.zeros(1)]
    for low, high, per_turn in _split_into_blocks(steps, curve, end):
        # The block starts at the sample before the last node, so that block borders need no nodes.
        first = math.floor(min(low, nodes[-1][-1]) * per_turn / TURN)
        last = math.ceil(high * per_turn / TURN) + 1
        path, parts = _sample_path(
            steps, curve, np.arange(first, last + 1) * (TURN / per_turn), servo.chord, hermite=hermite
        )
        # Revolution by revolution, so that the samples between are in the processor's cache when they are searched.
        for stop in np.append(np.arange(low + TURN, high - 0.5 * TURN, TURN), high).tolist():
            # The last step may pass the end of the revolution.
            begin = float(nodes[-1][-1])
            ends = np.searchsorted(path[0], [begin, stop + WIDEST_STEP], side="right")
            some = slice(max(int(ends[0]) - 1, 0), int(ends[1]) + 1)
            fine = _refine(path[:, some], parts[some][: path[0, some].size - 1])
            at, lift = np.empty((2, fine.shape[1] + 1))
            limits = (min(end, stop), slack, steps.bend, WIDEST_STEP)
            if off:
                count = kernel.off_path(fine, begin, float(lifts[-1][-1]), *limits, at, lift)
            else:
                count = kernel.on_path(fine, begin, *limits, hermite, at)
            nodes.append(at[1:count].copy())
            lifts.append(lift[1:count].copy())
        check_count(sum(part.size for part in nodes), LENGTHS)
        if progress is not None:
            progress(round(500 * (1 + min(high / end, 1.0))), 1000)
    return np.concatenate(nodes), np.concatenate(lifts) if off else None


def _estimate_point_count(steps: _Steps, curve: _Curve, end: float, slack: float) -> float:
    """Return an estimate, rather low, of the number of points with linear interpolation, from some revolutions."""
    per_turn = math.ceil(
        max(MIN_SPOKES, SPOKES_PER_FEATURE * TURN * steps.part.reach / steps.part.surface.feature_size)
    )
    turned = end * (np.arange(PREVIEW_REVS)[:, None] + 0.5) / PREVIEW_REVS + TURN / per_turn * np.arange(per_turn)
    turned = np.minimum(turned, end)
    z = steps.place(steps.way * turned.ravel(), curve.at(turned.ravel())[0])[0].reshape(turned.shape)
    bend = np.abs(np.diff(z, 2, axis=1))
    return float(np.sqrt(bend / (8 * slack)).sum()) * end / TURN / PREVIEW_REVS


def _split_into_blocks(steps: _Steps, curve: _Curve, end: float) -> Iterator[tuple[float, float, int]]:
    """Yield begin and end of each block of the path as angles turned [rad], and its samples per revolution.

    Samples at the same azimuths in every revolution of a block are placed at a fraction of the cost of scattered ones.
    """
    turns = math.ceil(end / TURN)
    low = 0
    while low < turns:
        # A block covers at most twice its inner radius; otherwise the samples of its inner revolutions are too close.
        outer = np.arange(low + 1, turns + 1, dtype=np.float64)
        radius = curve.at(TURN * outer)[0]
        per_turn = np.maximum(MIN_SPOKES, SAMPLES_PER_FEATURE * TURN * radius / steps.part.surface.feature_size)
        fit = (per_turn <= 2 * per_turn[0] + 1024) & (per_turn * (outer - low) <= BLOCK_SAMPLES)
        high = low + max(int(np.count_nonzero(fit)), 1)
        count = 12 * math.ceil(per_turn[high - low - 1] / 12)
        # The last block continues for the step that passes the end.
        yield low * TURN, high * TURN if high < turns else end + WIDEST_STEP, count
        low = high


def _sample_path(steps: _Steps, curve: _Curve, turned: Floats, chord: float, *, hermite: bool) -> tuple[Floats, Ints]:
    """Sample a path until cubics between the samples have a negligible error.

    On a smooth path, the error of a cubic over two intervals at the sample between them is 16 times the error of the
    cubics over each interval; at a slope discontinuity it is at least as large as theirs. Returned are angle turned,
    height, its derivative, radius, its derivative, slope of the height along the radius, and the allowed error of the
    radius (7, n); and the pieces of each interval between whose ends straight lines have a negligible error (n - 1,).
    """

    def sample(turned: Floats) -> Floats:
        path = np.empty((7, turned.size))
        path[0] = turned
        kernel.spline_at(curve.values, curve.slopes, curve.density, turned, path[3], path[4])
        path[1], around, path[5], _ = steps.place(steps.way * turned, path[3])
        path[2] = steps.way * around + path[5] * path[4]
        return path

    path = sample(turned)
    while True:
        if steps.ridges:  # on a ridge the path has a slope, the surface has none
            path[2] = np.gradient(path[1], path[0], edge_order=2)
        doubt = np.empty(path.shape[1] - 1)
        kernel.sampling_error(path, doubt)
        wide = doubt > chord / steps.miss
        if steps.ridges:
            wide &= (doubt > chord / RIM_SAMPLING_FACTOR) | (np.diff(path[0]) > RIM_INTERVAL_RAD)
        coarse = np.flatnonzero(wide)
        if coarse.size == 0:
            break
        if path.shape[1] == turned.size and coarse.size > path.shape[1] // REFINEMENT_RATIO:
            # Twice as many even samples, at the same azimuths in every revolution, are faster than scattered ones.
            check_samples(2 * turned.size, chord)
            turned = np.linspace(turned[0], turned[-1], 2 * turned.size - 1)
            path = sample(turned)
            continue
        middle = (path[0, coarse] + path[0, coarse + 1]) / 2
        check_interval(path[0, coarse + 1] - path[0, coarse], middle, chord)
        check_samples(path.shape[1] + coarse.size, chord)
        path = np.insert(path, coarse + 1, sample(middle), axis=1)
    path[6] = curve.lateral_tolerance(path[0])
    if hermite:
        pieces = SAMPLES_PER_BLOCK / 2 * (doubt / chord) ** 0.25
    else:
        pieces = np.empty(doubt.size)
        kernel.bulge(path, pieces)
        pieces = np.sqrt(steps.miss / (8 * chord) * pieces)
    parts = np.maximum(np.ceil(pieces), 1).astype(np.int64)
    check_samples(int(parts.sum()), chord)
    return path, parts


def _refine(path: Floats, parts: Ints) -> Floats:
    """Return a path with samples between its own, ``parts`` (n - 1,) pieces to each interval. (7, m)."""
    out = np.empty((path.shape[0], int(parts.sum()) + 1))
    kernel.refine(path, parts, out)
    return out
