r"""Plan how the tool enters the material before each pass, and prove that it touches nothing while C stands still.

Before a pass the material reaches up to the blank, or to the surface of the previous pass where that is lower. The
tip moves down at the radius :math:`\rho`. At the azimuth :math:`\theta` the edge touches the material first when the
tip is at the height

.. math:: T(\theta) = \max_u \; [\, M(\rho + u, \theta) - e(u) \,].

On every step of a sampled radial line, the highest material is compared with the lowest point of the edge. The result
is on the safe side as long as no step hides a peak. Azimuths are spaced by an eighth of the feature size of the
surface, up to 1440 of them. The blank is unknown outside the clear aperture: it is assumed to continue at the slope of
the rim where that rises outward, and level where it falls.

A plunge stays at the radius where its pass begins, at heights that are exact around the axis; the theory of the program
explains it. On an outline or a chuck it follows the first revolution of the pass, air included, and is raised where the
edge would be below a part or its border, between two points too. As an independent proof, the whole arc of the edge is
compared with the finished surface at points of the last revolution, and the border with the surface that it leaves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from turnwright._arrays import Floats, block_rows
from turnwright.errors import GougeError, LimitError
from turnwright.generation import generate_polar
from turnwright.job.depths import depth_at_border, depth_at_points
from turnwright.job.schema import Job
from turnwright.machine import FAST, Axis
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.placing import tip_height
from turnwright.post import GAP, MOST_CLEARANCE, Approach, entry_path, entry_shares, plan_approach
from turnwright.progress import run_chunks
from turnwright.tool import Tool
from turnwright.units import say_length

__all__ = ["Entry", "blank_heights", "entries_of"]

TURN = 2 * math.pi
MIN_AZIMUTHS, MAX_AZIMUTHS = 180, 1440
RADIAL_STEPS = 3000
CLEAR_HEIGHT_MM = 5.0
PLUNGE_DEPTH_TOL = 1e-6
"""Largest depth of the edge below the finished surface in a plunge, if its pass does not begin lower. [mm]"""

PROOF_POINTS, PROOF_STEPS = 360, 1200
"""Most points of the last revolution where the edge is compared with the part, and steps along the arc of the edge."""

CHUCK_MARGIN_MM = 0.1
"""Distance from the outline of a part of a chuck up to which its stock reaches."""

WIDE_STEPS, FINE_STEP_RAD = 2.0, math.radians(0.5)
"""Step of C, over the median one, from which the heights of a plunge count between its points too, and how densely."""

RAISES, MIN_SHARE = 20, 0.05
"""Times that a plunge may be raised over the borders of the parts, and the least share of a block that is raised."""

MIN_GAP_MM = 0.01
"""Least gap along z for a pass to count as beginning outside the blank, with the blank 0.1 mm larger. [mm]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """How the tool enters the material in a pass, checked against the material before it.

    Parameters
    ----------
    approach
        Blocks of the approach, as in the program.
    clearance
        Height of the clear plane above the highest point of the pass. [mm]
    depth
        Height of the material above the path where the pass begins; ``None`` where it begins clear of the material.
        [mm]
    least_gap
        Smallest distance along Z between the tool and the material while C is at rest or in rapid. [mm]
    outward
        Whether the pass cuts from the axis outward.
    heights
        Contact heights of the tip around the axis where the pass begins, for `turnwright.write_nc` and
        `turnwright.post.write_fast_tool`. (n,) [mm]
    beyond_travel
        A message where a fast tool would exceed its travel in the plunge, else empty.
    radius, material, finished
        Radial section at the azimuth of the first point, for a plot: distances from the axis, negative beyond it, the
        material before the pass and the finished surface, nan where there is none. Each (n,) [mm]
    """

    approach: Approach
    clearance: float
    depth: float | None
    least_gap: float
    outward: bool
    heights: Floats
    beyond_travel: str
    radius: Floats
    material: Floats
    finished: Floats


def entries_of(job: Job, motions: Mapping[str, Motion]) -> dict[str, Entry]:
    """Plan how the tool enters the material in every pass, in the order of cutting.

    Raises `LimitError` if a pass can neither begin clear of the material nor plunge while C turns, and `GougeError` if
    the edge gouges the finished surface in a plunge, unless the job accepts that.
    """
    entries: dict[str, Entry] = {}
    before: tuple[Motion, Tool] | None = None
    cuts = job.cuts
    for name, motion in motions.items():
        one = job.for_pass(cuts[name]) if name in cuts else job
        entries[name] = _plan_entry(one, name, motion, before)
        before = motion, one.tool
    return entries


@dataclass(frozen=True, slots=True)
class _Material:
    """Heights of the material before a pass, on radial lines around the axis. (n_angle, n_radius), -inf outside."""

    radius: Floats
    angle: Floats
    height: Floats

    def near(self, heights: Floats, azimuth: float) -> float:
        """Return the height at an azimuth, of those at all; -inf next to one of -inf is that of the other."""
        place = math.fmod(azimuth, TURN) % TURN / float(self.angle[1])
        low, share = int(place) % heights.size, place % 1
        ends = heights[low], heights[(low + 1) % heights.size]
        return float(max(ends) if -math.inf in ends else ends[0] + share * (ends[1] - ends[0]))

    def contact_height(self, tool: Tool, sense: int, radius: float, y: float) -> Floats:
        """Return the tip height of first contact by azimuth, at a distance from the axis. (n_angle,)."""
        line = np.concatenate([-self.radius[:0:-1], self.radius])
        opposite = np.roll(self.height, -(self.angle.size // 2), axis=0)
        material = np.concatenate([opposite[:, :0:-1], self.height], axis=1)
        dx, dy, dz = tool.offset
        edge = tool.cutting_edge(sense)
        w = edge.profile(line - radius - dx)[0]
        low, lean = edge.rake_cos * w, edge.rake_sin * w
        lateral = np.abs(lean + y + dy)
        # An edge off the radial plane meets material next to it, which is higher by its slope around the axis.
        if lateral.max() > 0:
            with np.errstate(invalid="ignore"):  # where there is no material
                around = np.abs(np.diff(self.height, axis=0, append=self.height[:1]))
            rise = np.where(np.isfinite(around), around, 0.0) / np.maximum(self.radius * self.angle[1], 1e-3)
            low = low - float(rise.max(initial=0.0)) * lateral
        low = np.minimum(low[1:], low[:-1])
        # The first contact is not where the edge is so high above its tip that even the highest material is below it.
        tip = int(low.argmin())
        least = float(np.maximum(material[:, tip], material[:, tip + 1]).min())
        near = float(material.max()) - low >= least - low[tip]
        top = np.maximum(material[:, 1:][:, near], material[:, :-1][:, near]) - low[near]
        highest = top.max(axis=1)
        # Between two azimuths the higher value counts.
        return np.asarray(np.maximum(np.maximum(highest, np.roll(highest, 1)), np.roll(highest, -1)) - dz)


def _heights_around(part: Part, tool: Tool, motion: Motion, turned: Floats, axes: Mapping[str, Floats]) -> Floats:
    """Return the heights of the tip around the axis at the end of a plunge. (n,) [mm]."""
    if part.leaves_air and motion.spindle_mode is None:
        return _heights_over_parts(part, tool, motion)
    heights = _contact_heights(part, tool, motion, turned, axes)
    # In spindle mode the tool cannot follow the azimuth.
    return heights if motion.spindle_mode is None else np.full(heights.size, heights.max())


def _contact_heights(part: Part, tool: Tool, motion: Motion, turned: Floats, axes: Mapping[str, Floats]) -> Floats:
    """Return the contact heights of the tip around the axis, at the radius where a pass begins. (n,) [mm]."""
    # The innermost and outermost tips of the pass are included, so that the rim is handled as for the whole pass.
    ends = [int(motion.axes["X"].argmin()), int(motion.axes["X"].argmax())]
    angle = np.append(motion.axes["C"][0] + motion.sense * turned, motion.axes["C"][ends])
    radius = np.append(sum(axes[one] for one in "XU" if one in axes), motion.axes["X"][ends])
    y = np.append(axes["Y"], motion.axes["Y"][ends]) if "Y" in axes else None
    z = tip_height(part.surface, tool, angle=angle, radius=radius, y=y, sense=motion.sense, rim=part.reach)[:-2]
    return np.append(z[:-1], z[0])


def _heights_over_parts(part: Part, tool: Tool, motion: Motion) -> Floats:
    """Return heights of the tip around the axis above all parts, where a pass that crosses air begins. (n,) [mm].

    They are those of the first revolution of the pass, raised where the edge would be below a part, or below its border
    between two points.
    """
    turned, axes = entry_path(motion, most=1)
    heights = axes["Z"]
    c = motion.axes["C"][0] + motion.sense * turned
    around = {**{letter: axes[letter] for letter in motion.axes if letter != "C"}, "C": c}

    def circle(angle: Floats, z: Floats) -> Motion:
        values = {letter: np.interp(angle, turned, one) for letter, one in around.items()}
        return Motion(time=angle, axes={**values, "Z": z}, machine=motion.machine)

    # The ends are the first point of the pass, which is not moved.
    inner = slice(1, -1)
    at_points = depth_at_points(part, tool, circle(turned, heights), PROOF_STEPS).depth
    heights[inner] += np.maximum(at_points, 0.0)[inner]
    steps = np.diff(turned)
    wide = np.flatnonzero(steps > WIDE_STEPS * np.median(steps))
    between = [np.arange(turned[k], turned[k + 1], FINE_STEP_RAD)[1:] for k in wide.tolist()]
    edge = tool.cutting_edge(motion.sense)
    for _ in range(RAISES):
        border = depth_at_border(part, tool, circle(turned, heights))
        low = border.depth > 0.0
        x, y = border.x[low], border.y[low]
        u = np.hypot(x, y) - axes["X"][0]
        v = edge.points(edge.sweeps(u))[1] + (axes["Y"][0] if "Y" in axes else 0.0)
        azimuth = np.arctan2(y, x) - np.arctan2(v, u + axes["X"][0])
        place, depth = np.mod(motion.sense * (azimuth - c[0]), TURN), border.depth[low]
        if between:
            fine = np.concatenate(between)
            dips = depth_at_points(part, tool, circle(fine, np.interp(fine, turned, heights)), PROOF_STEPS).depth
            place, depth = np.append(place, fine[dips > 0]), np.append(depth, dips[dips > 0])
        if not depth.size:
            break
        block = np.clip(np.searchsorted(turned, place) - 1, 0, turned.size - 2)
        share = (place - turned[block]) / steps[block]
        rise = np.zeros(turned.size)
        # Next to the first point only the other end of the block rises.
        for end, weight in ((block, np.where(block + 2 == turned.size, 1 - share, 1.0)),
                            (block + 1, np.where(block == 0, share, 1.0))):  # fmt: skip
            np.maximum.at(rise, end, (depth + PLUNGE_DEPTH_TOL / 2) / np.maximum(weight, MIN_SHARE))
        heights[inner] += rise[inner]
    return heights


def _require_above(job: Job, name: str, plunge: Motion, start: float) -> None:
    """Raise if the edge gouges the finished surface in the last revolution of a plunge, deeper than its pass does.

    ``start`` is the depth below contact at which the pass begins, 0 if it begins in contact or above. [mm]
    """
    part, tool = job.part.aimed, job.tool
    turned = np.abs(plunge.axes["C"] - plunge.axes["C"][-1])
    last = np.flatnonzero(turned <= TURN + 1e-9)
    every = last[:: -(-last.size // PROOF_POINTS)]
    depth, x, y = depth_at_points(part, tool, plunge.select(every), PROOF_STEPS).deepest
    if part.leaves_air:
        depth, x, y = max((depth, x, y), depth_at_border(part, tool, plunge.select(last)).deepest)
    if depth > PLUNGE_DEPTH_TOL + start:
        raise GougeError(
            f"pass {name}: in the plunge the edge comes {say_length(depth)} below the finished surface at x = {x:.4g} "
            f"mm, y = {y:.4g} mm, the limit is {say_length(PLUNGE_DEPTH_TOL + start)}: state part.blank, and a lead_in "
            "with which the pass begins outside the blank"
        )


def _add_fast_tool(plunge: Motion, turned: Floats, fast: Mapping[str, Floats]) -> Motion:
    """Return the motion of the tip in a plunge: X and Z plus the strokes of the fast tool."""
    if not fast:
        return plunge
    around = np.abs(plunge.axes["C"] - plunge.axes["C"][-1])
    strokes = {FAST[one]: np.interp(np.mod(-around, TURN), turned, values) for one, values in fast.items()}
    axes = {letter: values + strokes.get(letter, 0.0) for letter, values in plunge.axes.items()}
    return replace(plunge, axes=axes)


def _beyond_travel(job: Job, name: str, fast: Mapping[str, Floats]) -> str:
    for letter, values in fast.items():
        axis = job.machine.axes.get(letter, Axis())
        low, high = (-math.inf if axis.low is None else axis.low), (math.inf if axis.high is None else axis.high)
        if values.min() < low or values.max() > high:
            return (
                f"pass {name}: in the plunge {letter} moves from {values.min():.5g} to {values.max():.5g} mm, its "
                f"travel is {low:g} to {high:g} mm: state part.blank, and a lead_in with which the pass begins outside "
                "the blank"
            )
    return ""


def _plan_entry(job: Job, name: str, motion: Motion, before: tuple[Motion, Tool] | None) -> Entry:
    part, tool = job.part.aimed, job.tool
    turned, axes = entry_path(motion)
    x0, y0 = float(motion.axes["X"][0]), float(motion.axes["Y"][0]) if "Y" in motion.axes else 0.0
    x0 += float(motion.axes["U"][0]) if "U" in motion.axes else 0.0
    heights = _heights_around(part, tool, motion, turned, axes)
    path = heights + (axes["Z"][0] + axes.get("W", np.zeros(1))[0] - heights[0])
    z, fast = entry_shares(motion, heights) if FAST.keys() & axes.keys() else (heights, {})
    w = fast.get("W", np.zeros(turned.size))
    material = _material_before(part, tool, before, x0, _azimuths(part, max(x0, 0.0)), 0.0)
    azimuth = np.mod(motion.axes["C"][0] + motion.sense * turned, TURN)
    lowest = _lowest(azimuth, path, material.angle)
    rest_stroke = float(min(w.min(), 0.0) - w[0]) if "W" in axes else 0.0
    contact = material.contact_height(tool, motion.sense, x0, y0)
    depth: float | None = float((contact - lowest).max()) - rest_stroke
    if part.leaves_air and motion.spindle_mode is None:
        # It begins in air, where only the material under the first point counts.
        under = material.near(contact, float(motion.axes["C"][0]))
        if under - float(motion.axes["Z"][0]) <= -MIN_GAP_MM:
            depth = None
    elif part.blank is not None:
        larger = _material_before(part, tool, before, x0, material.angle, GAP)
        if float((larger.contact_height(tool, motion.sense, x0, y0) - lowest).max()) - rest_stroke <= -MIN_GAP_MM:
            depth = None
    top = _top(part, x0)
    clearance = max(CLEAR_HEIGHT_MM + part.stock, top + CLEAR_HEIGHT_MM - float(motion.axes["Z"].max()))
    if part.blank is not None and clearance > MOST_CLEARANCE:
        raise LimitError(
            f"pass {name}: to clear a blank of radius {part.blank.radius:g} mm the tool would retract {clearance:.4g} "
            f"mm above the part, the limit is {MOST_CLEARANCE:g} mm: correct part.blank.radius"
        )
    if depth is not None and job.program.fast_tool == "time" and float(np.ptp(w)) > 1e-6:
        raise LimitError(
            f"pass {name}: a fast tool with a table by time cannot move in a plunge, so the pass must begin outside "
            'the blank: state part.blank and a longer lead_in, or fast_tool = "position"'
        )
    approach = plan_approach(
        motion.lathe(), clearance=clearance, depth=depth, plunge_feed=job.program.plunge_feed, name=name, heights=z
    )  # fmt: skip
    if approach.plunge is not None and "gouge" not in job.accept:
        plunge = _add_fast_tool(approach.plunge, turned, fast)
        _require_above(job, name, plunge, max(float(heights[0] - path[0]), 0.0))
    first = material.near(contact, float(approach.start["C"]))
    gap = min(approach.start["Z"] + float(w[0]) + rest_stroke - first, approach.clear + float(w.min()) - top)
    least = GAP / 2 if depth is not None else MIN_GAP_MM
    if not gap >= least:
        raise LimitError(
            f"pass {name}: the tool would come within {gap:.4g} mm of the material while C is at rest, the limit is "
            f"{least:g} mm: state part.blank and a longer lead_in"
        )
    return Entry(
        approach=approach, clearance=clearance, depth=depth, least_gap=gap,
        beyond_travel="" if approach.plunge is None else _beyond_travel(job, name, fast),
        outward=bool(motion.axes["X"][-1] > motion.axes["X"][0]), heights=heights,
        **_radial_section(part, material, float(motion.axes["C"][0])),
    )  # fmt: skip


def _radial_section(part: Part, material: _Material, azimuth: float) -> dict[str, Floats]:
    count = material.angle.size
    nearest = round(azimuth / TURN * count) % count
    line, height, finished = [], [], []
    for side, row in ((-1.0, (nearest + count // 2) % count), (1.0, nearest)):
        if side < 0 and material.radius[0] > 0:
            continue
        order = slice(None, None, -1) if side < 0 else slice(None)
        radius, angle = material.radius, float(material.angle[row])
        line.append((side * radius)[order])
        height.append(np.where(np.isfinite(material.height[row]), material.height[row], np.nan)[order])
        inside = np.minimum(radius, part.reach * (1 - 1e-12))
        on = (radius <= part.reach) & part.covers(inside * math.cos(angle), inside * math.sin(angle))
        finished.append(np.where(on, _sag(part, radius, angle), np.nan)[order])
    names = ("radius", "material", "finished")
    return {name: np.concatenate(parts) for name, parts in zip(names, (line, height, finished), strict=True)}


def _lowest(azimuth: Floats, path: Floats, angle: Floats) -> Floats:
    """Return the lowest height of a closed path near each of some evenly spaced azimuths. (n,)."""
    step = angle[1] - angle[0]
    place = np.rint(azimuth / step).astype(np.int64) % angle.size
    lowest = np.interp(angle, azimuth, path, period=TURN)
    np.minimum.at(lowest, place, path)
    return np.minimum(np.minimum(lowest, np.roll(lowest, 1)), np.roll(lowest, -1))


def _sag(part: Part, radius: Floats, angle: float) -> Floats:
    inside = np.minimum(radius, part.reach * (1 - 1e-12))
    return np.asarray(part.surface.sag(inside * math.cos(angle), inside * math.sin(angle)))


def blank_heights(part: Part, radius: Floats, angle: Floats, wider: float) -> Floats:
    """Return the top of the blank on lines of ascending radii, its radius enlarged by ``wider``. (n_angle, n_radius).

    Between the parts of a chuck, farther from each than `CHUCK_MARGIN_MM` and ``wider``, there is nothing: -inf.
    """
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    if (shaped := part.shaped_blank) is not None:
        z = shaped.top(radius * cosine, radius * sine)
        z[:, radius > shaped.reach + wider] = -np.inf
    else:
        rim = part.reach * (1 - 1e-12)
        count = int(np.searchsorted(radius, rim)) + 1  # beyond the rim the height is that of the rim
        within, z = np.minimum(radius[:count], rim), np.empty((angle.size, radius.size))
        z[:, :count] = part.surface.sag(within * cosine, within * sine)
        z[:, count:] = z[:, count - 1 : count]
        zx, zy = part.surface.gradient(rim * cosine[:, 0], rim * sine[:, 0])
        slope = np.maximum(zx * cosine[:, 0] + zy * sine[:, 0], 0.0)
        z += part.stock + slope[:, None] * np.maximum(radius - rim, 0.0)
        if part.blank is not None:
            z[:, radius > part.blank.reach + wider] = -np.inf
    if len(part.apart) > 1:
        z[part.border.distance(radius * cosine, radius * sine) > CHUCK_MARGIN_MM + wider] = -np.inf
    return z


def _azimuths(part: Part, radius: float) -> Floats:
    needed = 8 * TURN * radius / part.surface.feature_size if part.surface.feature_size > 0 else MAX_AZIMUTHS
    count = 2 * math.ceil(min(max(MIN_AZIMUTHS, needed), MAX_AZIMUTHS) / 2)
    return np.asarray(np.arange(count) * (TURN / count), dtype=np.float64)


def _material_before(
    part: Part, tool: Tool, before: tuple[Motion, Tool] | None, x0: float, angle: Floats, wider: float
) -> _Material:
    """Return the material before a pass, under the edge at its first point; ``before`` has its tool."""
    edge = tool.cutting_edge()
    flank = max(edge.flank_slope, 0.05)
    reach = 2 * edge.half_width + (part.stock + 4 * GAP) / flank
    low, high = (max(x0 - reach, 0.0), x0 + reach) if x0 - reach > 0 else (0.0, max(x0 + reach, reach - x0))
    radius = np.linspace(low, high, RADIAL_STEPS + 1)
    if part.blank is not None and low < part.blank.reach + wider < high:
        end = part.blank.reach + wider
        radius = np.union1d(radius, [end, np.nextafter(end, np.inf)])
    # On a chuck the material ends next to each part: at these distances from it none is missed between two lines.
    lateral = GAP + high * float(angle[1]) / 2 if len(part.apart) > 1 else 0.0
    height = np.empty((angle.size, radius.size))

    def fill(start: int, stop: int) -> None:
        height[start:stop] = blank_heights(part, radius, angle[start:stop], wider + lateral)

    run_chunks(fill, angle.size, block_rows(height.shape))
    if before is not None:
        previous = generate_polar(*before, radius=radius, angle=angle).z
        height = np.minimum(height, np.where(np.isnan(previous), np.inf, previous))
    return _Material(radius, angle, height)


def _top(part: Part, x0: float) -> float:
    """Return the greatest height of the blank, out to its radius or to the tool. [mm]."""
    far = part.blank.reach if part.blank is not None else max(part.reach, x0)
    angle = _azimuths(part, far)
    return float(blank_heights(part, np.linspace(0, far, 401), angle, far * float(angle[1])).max())
