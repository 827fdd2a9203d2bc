"""Sampling grids on the part, and the points of a program that affect the surface there.

A program of ten million points is planned once. A sampling grid needs only the revolutions whose cut can reach its
places, with the errors of the actual tool. The selected points are points of the program, so the surface at these
places is the same to the last digits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from turnwright.access import check_access
from turnwright.generation import generate, generate_points, generate_polar
from turnwright.job import PassPlan, has_servos, without_servos
from turnwright.path import Motion
from turnwright.tracking import track

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats
    from turnwright.job import Job
    from turnwright.machine import Machine
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = [
    "ContactShift",
    "CutSurface",
    "PlannedMotion",
    "Scene",
    "add_drift",
    "drift_share",
    "make_lines",
    "make_scenes",
    "pack_motion",
    "plan_motion",
    "scene_motion",
    "select_points",
    "servos_respond",
]

TURN = 2 * math.pi

RING_RATIO = 2
"""Ratio of the radii of successive rings, where lines continue inward."""

CUSP_RING_FEEDS = 0.25
"""Distance of the highest central cusp from the axis, in feeds: the cuts on either side of it are half a revolution
apart, so that the middle between them is a quarter of a feed from the axis."""

CUSP_OVERSAMPLING = 12
"""Azimuthal oversampling of that cusp: it rises over half a revolution and drops at the end of the cut."""

GOLDEN_FRACTION = (math.sqrt(5) - 1) / 2
"""Azimuth of these places between lines, in steps: irrational, so that none is at the drop of the cusp, where a slight
rotation would change its height."""

RIM_RINGS = 4
"""Number of rings that sample the cusps at the rim; one ring meets each cusp once per revolution."""

PLACES_PER_FEATURE = 6
"""Places per feature of the surface, along the radius and around the rim."""

MIN_RADII, MAX_RADII = 40, 300
MIN_ANGLES, MAX_ANGLES = 48, 360

RIM_FRACTION = 1 - 1e-4
"""Radius of the ends of lines, relative to the clear semi-diameter: a tool height error moves places outward."""

MAX_PATCH_HEIGHTS = 8_000
"""Approximate number of heights of a patch from which its roughness is computed."""

MIN_PATCH_ROWS = 12
"""Least number of rows or columns of a patch along the cutting direction, in which the surface hardly varies."""

CORE_RATIO = 4.0
"""Radius of the uncut core, relative to the tool height error: farther out each place is cut from both sides."""

MARGIN_FEEDS = 5.0
"""Least distance from its contact within which a revolution is kept, in feeds."""

BLOCK_POINTS = 1 << 20
"""Points of a program that are processed together."""

GOUGE_TOL_MM = 1e-9
"""Negative clearance that counts as rounding. [mm]"""

SERVO_NODES = 5
"""Number of natural frequencies of an axis at which its motion is computed, for interpolation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactShift:
    """Largest shift of the contact by drawn errors."""

    along: float  # along the radius. [mm]
    across: float  # around the axis. [mm]
    servos: Mapping[str, float]  # largest relative deviation of the natural frequency of each axis, by letter


class CutSurface(NamedTuple):
    """Points of a cut surface, each (rows, columns) [mm], and the area weight of each column (columns,)."""

    x: Floats
    y: Floats
    z: Floats
    weight: Floats


class Scene(NamedTuple):
    """A sampling grid on the part: radial lines, or a patch.

    ``rows`` and ``columns`` are azimuths and radii of lines [rad, mm], or y and x of a patch [mm]. ``twist`` is the
    azimuth of the places of each column relative to their lines [rad]. ``weight`` is the area of a place of each
    column; for lines in a unit in which the whole disc has the square of its radius.
    """

    name: str
    polar: bool
    rows: Floats
    columns: Floats
    twist: Floats
    weight: Floats

    def generated(self, motion: Motion, tool: Tool, machine: Machine, near: float) -> CutSurface:
        """Return the surface that a motion generates on the grid.

        Within ``near`` [mm] of the axis, cuts from its other side matter. Lines end at the uncut core that a tool
        height error leaves; heights within it are nan. The last place inside its edge is moved to the edge, so that
        results change continuously with the core.
        """
        if not self.polar:
            made = generate(motion, tool, x=self.columns, y=self.rows, machine=machine)
            return CutSurface(*made.points(), made.z, self.weight)
        scene, there = self._beyond(min(CORE_RATIO * abs(tool.offset[1]), float(self.columns[-1]) / 2))
        x, y = scene.points()
        z = np.full(x.shape, np.nan)
        fine = there & (scene.twist > 0)
        if fine.any():
            close = self._inner(motion, near)
            ring = generate_points(close, tool, x=x[:, fine].ravel(), y=y[:, fine].ravel(), machine=machine)
            z[:, fine] = ring.reshape(scene.rows.size, -1)
        plain = there & ~fine
        x[:, plain], y[:, plain], z[:, plain] = self._along(scene.columns[plain], motion, tool, machine, near)
        return CutSurface(x, y, z, scene.weight)

    def _along(
        self, radius: Floats, motion: Motion, tool: Tool, machine: Machine, near: float
    ) -> tuple[Floats, Floats, Floats]:
        """Return places at some radii of the lines, and the surface there. Each (rows, radii) [mm]."""
        height = tool.offset[1]
        outer = radius > near
        if not height or tool.rake or "Y" in motion.axes or not outer.any():
            made = generate_polar(motion, tool, radius=radius, angle=self.rows, machine=machine)
            return *made.points(), made.z
        # With a tool height error the edge cuts the same profile at a slightly larger radius and another azimuth, so
        # that lines remain lines, which are fast to compute. Near the axis both sides overlap.
        level = replace(tool, offset=(tool.offset[0], 0.0, tool.offset[2]))
        r = radius[outer]
        made = generate_polar(motion, level, radius=r, angle=self.rows, machine=machine)
        x, y = made.points()
        turned = height / r
        parts = [(x - turned * y, y + turned * x, made.z)]
        if not outer.all():
            inner = self._inner(motion, near)
            close = generate_polar(inner, tool, radius=radius[~outer], angle=self.rows, machine=machine)
            parts.insert(0, (*close.points(), close.z))
        x, y, z = (np.concatenate(one, axis=1) for one in zip(*parts, strict=True))
        return x, y, z

    def _beyond(self, core: float) -> tuple[Scene, Bools]:
        """Return the lines outside a core, and which of their columns remain. (columns,)."""
        within = int(np.searchsorted(self.columns, core, side="right"))
        inmost = int(np.searchsorted(self.columns, self.columns[within - 1])) if within else 0
        there = np.arange(self.columns.size) >= inmost
        outside = np.cumsum(self.weight[::-1])[::-1]
        outside = np.minimum(outside, outside[0] - core**2)
        moved = np.where(there, np.maximum(self.columns, core), self.columns)
        return self._replace(columns=moved, weight=outside - np.append(outside[1:], 0.0)), there

    @staticmethod
    def _inner(motion: Motion, near: float) -> Motion:
        at = np.flatnonzero(np.abs(motion.axes["X"]) <= 3 * near)
        return motion.select(slice(max(int(at[0]) - 1, 0), int(at[-1]) + 2))

    def points(self) -> tuple[Floats, Floats]:
        """Return x and y of every place. Each (rows, columns) [mm]."""
        if self.polar:
            azimuth = self.rows[:, None] + self.twist
            return np.cos(azimuth) * self.columns, np.sin(azimuth) * self.columns
        x, y = np.meshgrid(self.columns, self.rows)
        return x, y


MAX_DENSER_LINES = 16
"""Largest ratio of the lines for an outline to those for the whole disc."""


def make_lines(job: Job, feed: float, *, even: bool = False) -> Scene:
    """Return radial lines over the whole part, with a density that depends on its features.

    They include the axis, the ring of the highest central cusp and the rim, where most errors are largest. These
    places have no area weight; the others share the whole area. ``even`` lines have places of the same area only, as a
    map of an instrument.
    """
    part = job.part
    places = PLACES_PER_FEATURE * part.reach / part.surface.feature_size
    radii = int(np.clip(math.ceil(places), MIN_RADII, MAX_RADII))
    angles = 2 * int(np.clip(math.ceil(TURN * places / 2), MIN_ANGLES // 2, MAX_ANGLES // 2))
    if part.outline is not None:  # more lines where few of them cross the part
        angles *= min(math.ceil(math.pi * part.reach**2 / part.outline.area), MAX_DENSER_LINES)
    share = (np.arange(radii) + 0.5) / radii
    azimuth = np.linspace(0, TURN, angles, endpoint=False)
    if even:
        radius, weight = np.sqrt(share), np.full(radii, 1 / radii)
        twist = np.zeros(radii)
    else:
        rings = [CUSP_RING_FEEDS * feed / part.reach]
        while RING_RATIO * rings[-1] < share[0]:
            rings.append(RING_RATIO * rings[-1])
        fine = (np.arange(CUSP_OVERSAMPLING) + GOLDEN_FRACTION) / CUSP_OVERSAMPLING * azimuth[1]
        # Rings a whole number of feeds apart would meet all cusps at the same phase, and a tilt would remove them.
        across, area = feed / part.reach, 2 * share / radii
        if across * radii < 1:
            share = (np.floor(share / across) + np.arange(1, radii + 1) * GOLDEN_FRACTION % 1) * across
            share = np.where(share > 1 - across, share - across, share)
        rim = RIM_FRACTION - np.arange(RIM_RINGS) / RIM_RINGS * across / angles
        radius = np.concatenate([[0.0], np.full(CUSP_OVERSAMPLING, rings[0]), rings[1:], share, rim])
        twist = np.zeros(radius.size)
        twist[1 : 1 + CUSP_OVERSAMPLING] = fine
        weight = np.zeros(radius.size)
        weight[-RIM_RINGS - radii : -RIM_RINGS] = area
        order = np.argsort(radius, kind="stable")
        radius, twist, weight = radius[order], twist[order], weight[order]
    on = part.reach * radius >= part.nearest
    radius, twist, weight = radius[on], twist[on], weight[on]
    return Scene(
        "whole part",
        polar=True,
        rows=azimuth,
        columns=part.reach * radius,
        twist=twist,
        weight=part.reach**2 * weight,
    )


def make_scenes(job: Job, feed: float) -> list[Scene]:
    """Return the lines for the form of a part, and its patches, thinned to what their roughness needs."""
    scenes = [make_lines(job, feed)]
    for patch in job.simulation.patches:
        x, y = patch.axes
        every = max(1.0, x.size * y.size / MAX_PATCH_HEIGHTS)
        over_axis = x[0] <= 0 <= x[-1] and y[0] <= 0 <= y[-1]
        if over_axis:
            steps = round(math.sqrt(every)), round(math.sqrt(every))
        elif abs(x.mean()) > abs(y.mean()):  # the cutting direction is along y
            steps = 1, max(1, min(round(every), y.size // MIN_PATCH_ROWS))
        else:
            steps = max(1, min(round(every), x.size // MIN_PATCH_ROWS)), 1
        x, y = (axis[step // 2 :: step] for axis, step in zip((x, y), steps, strict=True))
        one = np.ones(x.size)
        scenes.append(Scene(patch.name, polar=False, rows=y, columns=x, twist=0 * one, weight=one))
    return scenes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedMotion:
    """Motion of the axes in the finishing pass, and its contact points."""

    motion: Motion  # actual motion: the plan, or the response of the servos to it
    contact: Floats  # distance of the contact from the axis at each point. (n,) [mm]
    across: float  # planned lateral distance of the edge from the plane through the axis. [mm]
    edge: float  # distance from the tip within which the nose is used. [mm]
    blend: float  # distance between points of the nose that cut the same place of the part. [mm]
    core: float  # distance of the revolutions whose raked edge reaches the axis, per root of the height error. [mm^0.5]
    upright: bool  # whether the edge stays in one plane, as without rake and Y
    servos: Mapping[str, tuple[Floats, Floats]]  # frequency deviations (k,) of each axis, its positions (k, n)

    def near(self, reach: ContactShift) -> float:
        """Return the distance from the axis within which cuts from its other side matter. [mm].

        To reach farther, they would need more of the nose than is used.
        """
        beyond = max(-float(self.motion.axes["X"].min()), 0.0)
        return self.edge + beyond + self.blend + reach.along + MARGIN_FEEDS * self.motion.feed


def plan_motion(job: Job, reach: ContactShift, progress: Progress | None = None) -> PlannedMotion:
    """Plan the finishing pass of a job, once for all cases."""
    report = progress or (lambda _done, _total: None)
    tool, machine = job.tool, job.machine
    report(0, 2)
    plan = PassPlan(job)
    path, commanded, planned = plan.path, plan.commanded, plan.planned
    report(1, 2)
    real, actual = planned, job.actual_machine
    servos: dict[str, tuple[Floats, Floats]] = {}
    if job.simulation.tracking:
        real = track(commanded, actual)
        for letter, most in reach.servos.items():
            if letter in real.axes and letter in actual.axes and actual.axes[letter].response is not None:
                shares = most * np.cos(np.pi * (np.arange(SERVO_NODES) + 0.5) / SERVO_NODES)
                at = real.time + commanded.time[0]
                rows = [track(commanded, _raise_frequency(actual, letter, one), at=at).axes[letter] for one in shares]
                servos[letter] = shares, np.stack(rows)
    elif machine.controller.interpolation != "linear":
        real = track(planned, without_servos(actual, corrected=job.program.precorrect))
    contact = np.hypot(path.contact_x, path.contact_y)
    if real.time.size != contact.size:
        way = planned.sense
        contact = np.interp(way * real.axes["C"], way * path.angle, contact)
    low, high = float(path.sweep.min()), float(path.sweep.max())
    radius = tool.actual_radius
    edge = radius * math.sin(min(max(-low, high, 0.0), math.pi / 2))
    sine = abs(math.sin(tool.rake))
    lean = radius * (1 - math.cos(min(max(-low, high, 0.0), math.pi / 2))) * sine
    lateral = max((float(np.abs(axis).max()) for letter, axis in real.axes.items() if letter == "Y"), default=0.0)
    # Where the nose does not fit, a place is cut by revolutions whose contact is elsewhere.
    tight = job.part.aimed.surface.in_pieces or float(path.clearance.min()) < -GOUGE_TOL_MM or not _fits(job)
    report(2, 2)
    return PlannedMotion(
        motion=real, contact=contact, across=lean + lateral + abs(tool.offset[1]), edge=edge + abs(tool.offset[0]),
        blend=2 * edge if tight else 0.0, core=1.5 * math.sqrt(2 * radius / sine) if sine else 0.0,
        upright=not tool.rake and "Y" not in real.axes, servos=servos,
    )  # fmt: skip


def _fits(job: Job) -> bool:
    access = check_access(job.part.aimed, job.tool, sense=job.strategy.sense)
    return all(one.ok for one in access.findings if one.name in {"nose radius", "valley", "step"})


def _raise_frequency(machine: Machine, letter: str, share: float) -> Machine:
    axis = machine.axes[letter]
    assert axis.response is not None  # noqa: S101 - checked by the caller
    quick = replace(axis, response=axis.response.slower(1 / (1 + share)))
    return replace(machine, axes={**machine.axes, letter: quick})


def select_points(plan: PlannedMotion, scene: Scene, reach: ContactShift) -> Bools:
    """Return which points of a program a sampling grid needs.

    A revolution cuts at its planned contact, within the shift by tool errors, slide errors and cusps. It cuts at the
    azimuth of the spindle or on the other side of the axis, within the angle that follows from the lateral distance of
    the edge from the plane through the axis.
    """
    c, x = plan.motion.axes["C"], plan.motion.axes["X"]
    if scene.polar:
        nearest, farthest = float(scene.columns[0]), float(scene.columns[-1])
        middle, half, many = float(scene.rows[0]), 0.0, scene.rows.size
        if many % 2:
            raise AssertionError("lines come in pairs")
    else:
        corners = np.hypot(*np.meshgrid(scene.columns[[0, -1]], scene.rows[[0, -1]]))
        x0, y0 = (np.clip(0.0, axis[0], axis[-1]) for axis in (scene.columns, scene.rows))
        nearest, farthest = math.hypot(x0, y0), float(corners.max())
        middle = math.atan2(scene.rows.mean(), scene.columns.mean())
        places = np.arctan2(*(one.ravel() for one in np.meshgrid(scene.rows[[0, -1]], scene.columns[[0, -1]])))
        half = math.pi if nearest == 0 else float(np.abs((places - middle + math.pi) % TURN - math.pi).max())
        many = 1
    across = plan.across + reach.across
    along = plan.blend + plan.core * math.sqrt(across) + MARGIN_FEEDS * plan.motion.feed + reach.along
    near = np.flatnonzero((plan.contact >= nearest - along) & (plan.contact <= farthest + along))
    # Along lines a tool height error shifts the places, not the azimuth; see `Scene.generated`.
    level = plan.near(reach) + along if scene.polar and plan.upright else math.inf
    keep = np.zeros(c.size, dtype=np.bool_)
    if near.size == 0:
        return keep
    first, last = max(int(near[0]) - 1, 0), min(int(near[-1]) + 2, c.size)
    turns = many / TURN
    for start in range(first, last - 1, BLOCK_POINTS):
        stop = min(start + BLOCK_POINTS, last - 1)
        a = (c[start : stop + 1] - middle) * turns
        low, high = np.minimum(a[:-1], a[1:]), np.maximum(a[:-1], a[1:])
        served = np.maximum(plan.contact[start:stop] - along, max(nearest, 1e-9))
        lateral = np.where(plan.contact[start:stop] > level, plan.across, across)
        # The axis is met at every azimuth.
        window = half + np.where(
            served > np.maximum(lateral, 1e-9), np.arcsin(np.minimum(lateral / served, 1.0)), math.pi
        )
        wide = window * turns
        crosses = np.floor(high + wide) >= np.ceil(low - wide)
        if not scene.polar:
            behind = np.abs(x[start:stop]) <= plan.edge + along
            crosses |= behind & (np.floor(high + 0.5 + wide) >= np.ceil(low + 0.5 - wide))
        at = start + np.flatnonzero(crosses)
        keep[at] = True
        keep[at + 1] = True
    return keep


def pack_motion(plan: PlannedMotion, keep: Bools, reach: ContactShift) -> tuple[dict[str, Any], Floats]:
    """Return the selected points of a motion: a description of the rows, and the rows. (m, n)."""
    motion = plan.motion
    letters = list(motion.axes)
    rows = [motion.time[keep], *(motion.axes[letter][keep] for letter in letters)]
    nodes = {}
    for letter, (shares, positions) in plan.servos.items():
        nodes[letter] = shares.tolist()
        rows += list(positions[:, keep])
    head = {
        "letters": letters, "nodes": nodes, "duration": float(motion.time[-1] - motion.time[0]),
        "near": plan.near(reach),
    }  # fmt: skip
    return head, np.stack(rows)


def scene_motion(head: Mapping[str, Any], rows: Floats, machine: Machine, faster: Mapping[str, float]) -> Motion:
    """Return the motion on a sampling grid, for relative deviations of the natural frequencies by letter."""
    letters = head["letters"]
    axes = {letter: rows[1 + k] for k, letter in enumerate(letters)}
    after = 1 + len(letters)
    for letter, shares in head["nodes"].items():
        positions = rows[after : after + len(shares)]
        after += len(shares)
        axes[letter] = _lagrange(np.asarray(shares), faster.get(letter, 0.0)) @ positions
    return Motion(time=rows[0], axes=axes, machine=machine)


def _lagrange(nodes: Floats, at: float) -> Floats:
    """Return the Lagrange interpolation weights of the nodes at a point. (k,)."""
    apart = nodes[:, None] - nodes + np.eye(nodes.size)
    off = (at - nodes)[None, :] + np.zeros((nodes.size, 1))
    np.fill_diagonal(off, 1.0)
    return np.asarray((off / apart).prod(axis=1))


def drift_share(time: Floats, duration: float, settling: float | None) -> Floats:
    r"""Return the fraction of the final drift at each time, 1 at the end of the cut.

    .. math:: \frac{t}{T} \quad\text{or}\quad \frac{1 - e^{-t/\tau}}{1 - e^{-T/\tau}}
    """
    if settling is None:
        return time / duration
    return np.asarray(np.expm1(-time / settling) / math.expm1(-duration / settling))


def add_drift(motion: Motion, x: float, z: float, share: Floats) -> Motion:
    """Return a motion with a drift of ``x`` and ``z`` at the end of the cut [mm]; see `drift_share`."""
    if not x and not z:
        return motion
    return replace(motion, axes={**motion.axes, "X": motion.axes["X"] + x * share, "Z": motion.axes["Z"] + z * share})


def servos_respond(job: Job) -> bool:
    """Return whether the prediction of a job includes the servos."""
    return job.simulation.tracking and has_servos(job.actual_machine)
