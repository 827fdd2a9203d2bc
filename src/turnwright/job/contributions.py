"""The error breakdown of a planned part: cusps, interpolation, rounding and servos, each by simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from turnwright._arrays import Floats, rounding, row_blocks
from turnwright.errors import InputError
from turnwright.generation import generate_polar
from turnwright.heightmap import HeightMap
from turnwright.job.extremes import find_extremes
from turnwright.job.interpolation import interpolate_motion
from turnwright.machine import Machine
from turnwright.metrology import area_rms
from turnwright.part import Part
from turnwright.path import Motion, Spiral
from turnwright.placing import place
from turnwright.progress import Progress
from turnwright.tool import Tool

__all__ = [
    "ErrorBreakdown",
    "break_down_error",
    "exact_cusps",
    "exact_motion",
    "finish_nm",
    "has_servos",
    "lines",
    "max_difference_nm",
    "pv_nm_of",
    "require_servos",
    "rms_nm_of",
    "without_servos",
]

TURN = 2 * math.pi
NM = 1e6

SAMPLES_PER_FEED = 12
"""Samples per feed: the top of a cusp is then within 1 % of its height."""

MOST_RADII = 24_000
FEWEST_ANGLES, MOST_ANGLES = 72, 720
"""Least and most azimuths of the lines; each line crosses all revolutions."""

RING_FEEDS = 12
"""Width of the rings whose finish is computed, in feeds."""

AZIMUTHS_PER_FEATURE = 4
"""Azimuths per feature size of the surface at the rim, within these limits."""

END_CLEARANCE_RAD = 1e-4
"""Shift of azimuths close to an end of a spiral; their least distance from both ends is half of it. [rad]"""

MIN_SHOWN_NM = 1e-4
"""Least height that is shown; smaller ones are rounding of the simulation."""

AXIS_FEEDS = 2
"""Distance of the tip from the axis, in feeds, within which an Archimedean spiral leaves its highest cusp."""

AXIS_SUBDIVISION = 16
"""Number of intervals between two azimuths on an exact path close to the axis."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorBreakdown:
    """What each error source adds to the form error, on radial lines across all revolutions.

    Parameters
    ----------
    cusp_nm
        Peak to valley after an exact path: cusps, and valleys that the nose cannot reach.
    cusp_away_nm
        The same on the lines at least two feeds from the axis, where the cusps of an Archimedean spiral are highest.
    chord_nm
        Largest change of the surface by the interpolation between the points of the program.
    rounding_nm
        Largest change of the surface by the decimals of the program.
    tracking_nm
        Largest change of the surface by the servo response.
    pv_nm
        Total: cut minus design, from the highest to the lowest point of the whole part.
    rms_nm
        Total: rms over the area, on the lines.
    sq_nm
        Total: finish, the largest Sq of a ring a few feeds wide, with straight lines across it removed.
    error
        Total: cut minus design. [mm]
    """

    cusp_nm: float
    cusp_away_nm: float
    chord_nm: float
    rounding_nm: float
    tracking_nm: float
    pv_nm: float
    rms_nm: float
    sq_nm: float
    error: HeightMap

    @property
    def sentence(self) -> str:
        """All contributions: cusps peak to valley, the others as the largest change."""
        return (
            f"cusps {_digits(self.cusp_nm)} nm, points ±{_digits(self.chord_nm)} nm, decimals "
            f"±{_digits(self.rounding_nm)} nm, servos ±{_digits(self.tracking_nm)} nm at most"
        )


def break_down_error(
    part: Part,
    tool: Tool,
    spiral: Spiral,
    motion: Motion,
    *,
    program_motion: Motion | None = None,
    nominal: Motion | None = None,
    pv_nm: float | None = None,
    progress: Progress | None = None,
) -> ErrorBreakdown:
    """Return the error breakdown of a plan.

    Parameters
    ----------
    part, tool
        Part and tool.
    spiral
        Planned spiral; its path is placed again, exactly at the azimuths of the lines.
    motion
        Commanded motion, with its machine.
    program_motion
        The motion read back from the program on disk; ``motion`` itself if not given.
    nominal
        Nominal motion, if ``motion`` is corrected for the servos: interpolation is then judged by the nominal motion,
        and servos by the difference of the actual surface from it, rounding included.
    pv_nm
        Peak to valley of the total, where it is known.
    progress
        Called with (surfaces done, surfaces in all).
    """
    machine, report = motion.machine, progress or (lambda _done, _total: None)
    feed = spiral.feed
    radius, angle = lines(part, feed, spiral.angle)

    def made(one: Motion, done: int) -> HeightMap:
        report(done, 6)
        return generate_polar(one, tool, radius=radius, angle=angle)

    report(0, 6)
    exact, finished, cusp_nm = _exact_surface(spiral, part, tool, machine, radius, angle)
    program_motion, ideal = program_motion or motion, without_servos(machine)
    steady = machine.controller.interpolation == "linear"
    sent = made(motion if steady else interpolate_motion(motion, ideal), 1)
    planned = sent if nominal is None else made(interpolate_motion(nominal, without_servos(machine, corrected=True)), 2)
    moved = program_motion if steady else interpolate_motion(program_motion, ideal)
    rounded = sent if program_motion is motion else made(moved, 3)
    real = rounded
    if has_servos(machine):
        moved = interpolate_motion(program_motion, machine)
        real = made(moved, 4)
    # The finished surface on all these lines costs more than one of the surfaces.
    is_known = all((np.isnan(real.z[rows]) | ~np.isnan(finished.z[rows])).all() for rows in row_blocks(real.z.shape))
    error = real.minus(finished) if is_known else part.form_error(real)
    report(5, 6)
    if pv_nm is None:
        form = find_extremes(moved, tool, part, known=error)
        pv_nm = math.nan if form is None else form.pv_nm
    report(6, 6)
    return ErrorBreakdown(
        cusp_nm=cusp_nm,
        cusp_away_nm=pv_nm_of(exact.minus(finished).z[:, np.searchsorted(radius, 2 * feed, side="right") :]),
        chord_nm=max_difference_nm(part.crop(planned), part.crop(exact)),
        rounding_nm=max_difference_nm(part.crop(rounded), part.crop(sent)),
        tracking_nm=max_difference_nm(part.crop(real), part.crop(rounded if nominal is None else planned)),
        pv_nm=pv_nm,
        rms_nm=rms_nm_of(error),
        sq_nm=finish_nm(error, feed),
        error=error,
    )


def exact_cusps(spiral: Spiral, part: Part, tool: Tool, machine: Machine) -> tuple[HeightMap, float]:
    """Return the error of an exact path on lines across all revolutions [mm], and its PV, the axis included. [nm]."""
    surface, finished, pv_nm = _exact_surface(spiral, part, tool, machine, *lines(part, spiral.feed, spiral.angle))
    return surface.minus(finished), pv_nm


def _exact_surface(
    spiral: Spiral, part: Part, tool: Tool, machine: Machine, radius: Floats, angle: Floats
) -> tuple[HeightMap, HeightMap, float]:
    """Return the surface of an exact path on lines and the finished surface [mm], and PV with the axis. [nm]."""
    zone, reach = _axis_zone(part, tool, spiral.feed)
    motion = exact_motion(spiral, part, tool, machine, angle, dense_to=reach)
    surface = generate_polar(motion, tool, radius=radius, angle=angle)
    extremes = find_extremes(motion, tool, replace(part, radius=zone, outline=None)) if zone else None
    finished = part.finished(surface)
    errors = surface.minus(finished).z.ravel()
    if extremes is not None:
        errors = np.append(errors, [extremes.highest.error, extremes.lowest.error])
    return surface, finished, pv_nm_of(errors)


def _axis_zone(part: Part, tool: Tool, feed: float) -> tuple[float, float]:
    """Return the radius of the zone whose cusps are cut next to the axis, and that of the passes around it. [mm].

    On a slope the contact is not at the tip, so that the cusp of the axis is next to the axis. Both are 0 for a part
    without the whole zone.
    """
    if part.outline is not None and part.border.distance(np.zeros(1), np.zeros(1))[0] > -2 * AXIS_FEEDS * feed:
        return 0.0, 0.0
    radius = np.linspace(0, min(AXIS_FEEDS * feed, part.reach), 5)[:, None]
    angle = np.linspace(0, TURN, FEWEST_ANGLES, endpoint=False)
    slope = float(np.hypot(*part.surface.gradient(radius * np.cos(angle), radius * np.sin(angle))).max())
    lateral = tool.actual_radius * slope / math.hypot(1, slope)
    if part.outline is not None:
        lateral = min(lateral, -float(part.border.distance(np.zeros(1), np.zeros(1))[0]) - AXIS_FEEDS * feed)
    return min(AXIS_FEEDS * feed + lateral, part.reach), 2 * (AXIS_FEEDS * feed + lateral)


def _digits(height_nm: float) -> str:
    return f"{height_nm:.3g}" if height_nm >= MIN_SHOWN_NM else "0"


def pv_nm_of(z: Floats) -> float:
    """Return the peak to valley of heights. [nm]."""
    return float(np.nanmax(z) - np.nanmin(z)) * NM


def rms_nm_of(heights: HeightMap) -> float:
    """Return the rms of a map over its area. [nm]."""
    return area_rms(heights) * NM


def lines(part: Part, feed: float, passed: Floats) -> tuple[Floats, Floats]:
    """Return the radii and azimuths of lines across all revolutions of a spiral with these angles.

    (n,) [mm], (m,) [rad]
    """
    fine = TURN * part.reach / part.surface.feature_size * AZIMUTHS_PER_FEATURE
    return (
        np.linspace(
            part.nearest,
            part.reach,
            min(math.ceil((part.reach - part.nearest) / feed * SAMPLES_PER_FEED), MOST_RADII) + 1,
        ),
        clear_azimuths(int(np.clip(math.ceil(fine), FEWEST_ANGLES, MOST_ANGLES)), passed),
    )


def clear_azimuths(count: int, passed: Floats) -> Floats:
    """Return evenly spaced azimuths away from both ends of a spiral, where rounding of C adds or removes a revolution.

    (count,) [rad]
    """
    step = TURN / count
    for shift in (0.0, END_CLEARANCE_RAD, 2 * END_CLEARANCE_RAD):
        away = np.mod(passed[[0, -1]] - shift + step / 2, step) - step / 2
        if np.abs(away).min() >= END_CLEARANCE_RAD / 2:
            break
    return np.asarray(shift + step * np.arange(count))


def finish_nm(error: HeightMap, feed: float) -> float:
    """Return the largest Sq of a ring a few feeds wide, with straight lines across it removed. [nm]."""
    assert error.radius is not None  # noqa: S101 - lines are polar
    step = float(error.radius[1] - error.radius[0])
    size = min(max(math.ceil(RING_FEEDS * feed / step), 3), error.radius.size)
    rings = error.radius.size // size
    weight = error.radius[: rings * size].reshape(rings, size)
    across = np.linspace(-1, 1, size)
    squares, count = np.zeros(rings), np.zeros(rings)
    for rows in row_blocks(error.z.shape):
        z = error.z[rows, : rings * size].reshape(-1, rings, size)
        level = z - z.mean(axis=2, keepdims=True)
        level -= across * ((level @ across) / (across @ across))[:, :, None]
        level *= level
        level *= weight
        square = level.mean(axis=2)
        # Where a ring crosses the outline of the part it is left out.
        there = ~np.isnan(square)
        squares += np.where(there, square, 0.0).sum(axis=0)
        count += there.sum(axis=0)
    return float(np.sqrt((squares / np.maximum(count, 1) / weight.mean(axis=1)).max())) * NM


def has_servos(machine: Machine) -> bool:
    """Whether the machine states the servo response of any axis."""
    return any(axis.response is not None or axis.dead_time for axis in machine.axes.values())


def require_servos(machine: Machine) -> None:
    """Raise if a machine states the servo response of no axis."""
    if not has_servos(machine):
        raise InputError(
            f"tracking needs a servo response, {machine.name} states it for 0 of {len(machine.axes)} axes: "
            "add [axes.Z.response] to a machine file and name that file in the job, or set tracking to false"
        )


def without_servos(machine: Machine, *, corrected: bool = False) -> Machine:
    """Return the machine with ideal axes, or, with ``corrected``, with axes that pass through the nominal points.

    A spline controller passes inside its points; the nominal motion passes through them.
    """
    axes = {letter: replace(axis, response=None, dead_time=None) for letter, axis in machine.axes.items()}
    controller = machine.controller
    if corrected and controller.interpolation in ("quadratic spline", "cubic spline"):
        controller = replace(controller, interpolation="hermite", other_interpolations={})
    return replace(machine, axes=axes, controller=controller)


def max_difference_nm(one: HeightMap, other: HeightMap) -> float:
    """Return the largest difference between two maps. [nm]."""
    largest = [np.fmax.reduce(np.abs(one.z[rows] - other.z[rows]), axis=None) for rows in row_blocks(one.z.shape)]
    return float(np.fmax.reduce(largest)) * NM


def exact_motion(
    spiral: Spiral, part: Part, tool: Tool, machine: Machine, angle: Floats, *, dense_to: float = 0.0
) -> Motion:
    """Return a motion that is exact at ascending azimuths of a revolution, at one radian per second.

    Where the tip is no farther from the axis than ``dense_to`` [mm], it is also exact at points between them.
    """
    first, last = sorted((float(spiral.angle[0]), float(spiral.angle[-1])))
    apart = 1e-11 + rounding(spiral.angle)  # so that no azimuth repeats one of the ends [rad]
    turns = np.arange(math.floor(first / TURN), math.floor(last / TURN) + 1)
    inner = (TURN * turns[:, None] + angle).ravel()
    inner = inner[(inner > first + apart) & (inner < last - apart)]
    nodes = np.concatenate(([first], inner, [last]))[:: spiral.sense]
    far = np.abs(_interpolate_plan(spiral, spiral.radius, spiral.radius_rate, nodes))
    parts = np.where(np.minimum(far[:-1], far[1:]) <= dense_to, AXIS_SUBDIVISION, 1)
    start = np.repeat(np.cumsum(parts) - parts, parts)
    within = (np.arange(start.size) - start) / np.repeat(parts, parts)
    nodes = np.append(np.repeat(nodes[:-1], parts) + within * np.repeat(np.diff(nodes), parts), nodes[-1])
    radius = _interpolate_plan(spiral, spiral.radius, spiral.radius_rate, nodes)
    y = None if spiral.y is None else _interpolate_plan(spiral, spiral.y, spiral.y_rate, nodes)
    path = place(Spiral(angle=nodes, radius=radius, y=y), part, tool)
    axes = {"C": path.angle, "X": path.radius, "Z": path.z - machine.z_error(path.radius)}
    if path.y is not None:
        axes["Y"] = path.y
    return Motion(time=np.abs(nodes - nodes[0]), axes=axes, machine=machine)


def _interpolate_plan(spiral: Spiral, values: Floats, rates: Floats | None, nodes: Floats) -> Floats:
    """Return values of the plan between its points: linear, or cubic where it states rates."""
    order, nodes_in_order = spiral.sense * spiral.angle, spiral.sense * nodes
    if rates is None:
        return np.interp(nodes_in_order, order, values)
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415 - costly to import

    return np.asarray(CubicHermiteSpline(order, values, spiral.sense * rates)(nodes_in_order))
