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
explains it. As an independent proof, the whole arc of the edge is compared with the finished surface at points of the
last revolution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import GougeError, LimitError
from turnwright.generation import generate_polar
from turnwright.job.schema import Job
from turnwright.machine import FAST, Axis
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.placing import tip_height
from turnwright.post import GAP, MOST_CLEARANCE, Approach, entry_path, entry_shares, plan_approach
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
            around = np.abs(np.diff(self.height, axis=0, append=self.height[:1]))
            rise = np.where(np.isfinite(around), around, 0.0) / np.maximum(self.radius * self.angle[1], 1e-3)
            low = low - float(rise.max(initial=0.0)) * lateral
        top = np.maximum(material[:, 1:], material[:, :-1]) - np.minimum(low[1:], low[:-1])
        highest = top.max(axis=1)
        # Between two azimuths the higher value counts.
        return np.asarray(np.maximum(np.maximum(highest, np.roll(highest, 1)), np.roll(highest, -1)) - dz)


def _contact_heights(part: Part, tool: Tool, motion: Motion, turned: Floats, axes: Mapping[str, Floats]) -> Floats:
    """Return the contact heights of the tip around the axis, at the radius where a pass begins. (n,) [mm]."""
    # The innermost and outermost tips of the pass are included, so that the rim is handled as for the whole pass.
    ends = [int(motion.axes["X"].argmin()), int(motion.axes["X"].argmax())]
    angle = np.append(motion.axes["C"][0] + motion.sense * turned, motion.axes["C"][ends])
    radius = np.append(sum(axes[one] for one in "XU" if one in axes), motion.axes["X"][ends])
    y = np.append(axes["Y"], motion.axes["Y"][ends]) if "Y" in axes else None
    z = tip_height(part.surface, tool, angle=angle, radius=radius, y=y, sense=motion.sense, rim=part.reach)[:-2]
    return np.append(z[:-1], z[0])


def _require_above(job: Job, name: str, plunge: Motion, start: float) -> None:
    """Raise if the edge gouges the finished surface in the last revolution of a plunge, deeper than its pass does.

    ``start`` is the depth below contact at which the pass begins, 0 if it begins in contact or above. [mm]
    """
    part, tool = job.part.aimed, job.tool
    turned = np.abs(plunge.axes["C"] - plunge.axes["C"][-1])
    last = np.flatnonzero(turned <= TURN + 1e-9)
    last = last[:: -(-last.size // PROOF_POINTS)]
    u, v, e = tool.edge(np.linspace(*tool.arc, PROOF_STEPS + 1), plunge.sense)
    along, across = plunge.axes["X"][last, None] + u, plunge.axes.get("Y", np.zeros(turned.size))[last, None] + v
    c, s = np.cos(plunge.axes["C"][last, None]), np.sin(plunge.axes["C"][last, None])
    x, y = along * c - across * s, along * s + across * c
    with np.errstate(all="ignore"):
        above = plunge.axes["Z"][last, None] + e - part.surface.evaluate(x, y, 0)[0]
    valid = np.isfinite(above) & (np.hypot(x, y) <= part.reach)
    inside = part.surface.inside(x, y)
    above = np.where(valid if inside is None else valid & inside, above, np.inf)
    k = np.unravel_index(int(above.argmin()), above.shape)
    if above[k] < -PLUNGE_DEPTH_TOL - start:
        raise GougeError(
            f"pass {name}: in the plunge the edge comes {say_length(-float(above[k]))} below the finished surface at "
            f"x = {x[k]:.4g} mm, y = {y[k]:.4g} mm, the limit is {say_length(PLUNGE_DEPTH_TOL + start)}: state "
            "part.blank, and a lead_in with which the pass begins outside the blank"
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
    heights = _contact_heights(part, tool, motion, turned, axes)
    if motion.spindle_mode is not None:  # the tool cannot follow the azimuth
        heights = np.full(heights.size, heights.max())
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
        under = float(np.interp(np.mod(motion.axes["C"][0], TURN), material.angle, contact, period=TURN))
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
    first = float(np.interp(np.mod(approach.start["C"], TURN), material.angle, contact, period=TURN))
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
    """Return the top of the blank on radial lines, with its radius enlarged by ``wider``. (n_angle, n_radius)."""
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    if (shaped := part.shaped_blank) is not None:
        z = shaped.top(radius * cosine, radius * sine)
        z[:, radius > shaped.reach + wider] = -np.inf
        return z
    rim = part.reach * (1 - 1e-12)
    inside = np.minimum(radius, rim)
    z = np.asarray(part.surface.sag(inside * cosine, inside * sine))
    zx, zy = part.surface.gradient(rim * cosine[:, 0], rim * sine[:, 0])
    slope = np.maximum(zx * cosine[:, 0] + zy * sine[:, 0], 0.0)
    z = z + part.stock + slope[:, None] * np.maximum(radius - rim, 0.0)
    if part.blank is not None:
        z[:, radius > part.blank.reach + wider] = -np.inf
    return np.asarray(z)


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
    height = blank_heights(part, radius, angle, wider)
    if before is not None:
        previous = generate_polar(*before, radius=radius, angle=angle).z
        height = np.minimum(height, np.where(np.isnan(previous), np.inf, previous))
    return _Material(radius, angle, height)


def _top(part: Part, x0: float) -> float:
    """Return the greatest height of the blank, out to its radius or to the tool. [mm]."""
    far = part.blank.reach if part.blank is not None else max(part.reach, x0)
    return float(blank_heights(part, np.linspace(0, far, 401), _azimuths(part, far), 0.0).max())
