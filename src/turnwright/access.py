"""Tool access: whether a tool can cut a surface, with the margins and the tightest places."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.errors import DomainError, InputError
from turnwright.part import Part, evenly
from turnwright.path import Motion
from turnwright.placing import touch
from turnwright.progress import Progress
from turnwright.tool import Shank, Tool
from turnwright.units import say_length

__all__ = ["Access", "AccessFinding", "check_access", "check_bodies", "check_depths"]

TURN = 2 * math.pi
MAX_GRID_POINTS = 400_000
CHUNK_POINTS = 20_000
MAX_STARTS = 32
MAX_SLOPE = 1e6
"""Slope of a surface, in mm per mm; larger ones come from a wrong description."""

MAX_HEIGHT_MM = 1e6
"""Height of a surface; larger ones come from a wrong description, and heights beyond lose their nanometres."""

AXIS_RADIUS_MM = 1e-5
"""Distance from the axis within which `MAX_SLOPE` does not apply, as for formulas in the azimuth."""

DISCONTINUITY_TOL = 1e-6
"""A jump of the slope below this, or of the height below as many mm, is rounding."""

DEPTH_POINTS = 3000
"""Points at which the chip is compared with the edge before the search is refined."""

RING_POINTS = 180
"""Further points on the rim, and at the smallest radius."""

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""Azimuth step of a Fibonacci lattice, which leaves no gaps and no rows. [rad]"""

REFINEMENTS = 8
"""Refinements of the search, each to a third of the step."""

REFINEMENT_STEPS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
"""Steps from each point, in radial and circumferential direction, that a refinement tries."""

FLANK_POINTS = 120

BODY_GAP_MM = 0.1
"""Least distance along z between the part with its stock and the shank or holder of a tool."""
BODY_TIPS, BODY_POINTS, MOTION_TIPS = 1000, 3000, 8000
"""Positions of the tip and points of the part that are compared, and positions of a motion."""
BODY_STEPS, BODY_SHRINK = 40, 0.7
"""Refinements of the least gap, and what each leaves of the step."""
MAX_NOSE_RADIUS_MM = 20.0
"""Nose radius beyond which a unit error is likely."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AccessFinding:
    """One check of the tool against the part.

    Parameters
    ----------
    name
        "nose radius", "included angle", "clearance", "rake", "valley" or "step"; "shank" or "holder" if the tool states
        it; "depth of cut" of a pass.
    value
        The nose radius of the tool, the angle that the part requires, the size of a valley or step, the least distance
        of shank or holder from the part along z, or the depth of cut of a pass. [mm or rad]
    limit
        The nose radius that the part allows, the angle of the tool, the least distance that is allowed, or the largest
        depth of cut; ``None`` if there is no limit or it is not given.
    margin
        Distance to the limit, negative where it is exceeded; ``None`` without a limit.
    where
        The tightest place on the part (x, y); ``None`` if there is none. [mm]
    ok
        Whether the tool passes; it does not where an angle is required but not given.
    sentence
        The finding in words.
    """

    name: str
    value: float
    limit: float | None
    margin: float | None
    where: tuple[float, float] | None
    ok: bool
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Requirements of a part on a tool. See `check_access`.

    Parameters
    ----------
    nose_radius_limit
        Largest usable nose radius; infinite where the part is nowhere concave along the radius. [mm]
    sweep
        Lowest and highest angle on the nose that touches the part (lo, hi). [rad]
    included_needed
        Included angle, symmetric about the tip, that covers the sweep. [rad]
    clearance_needed
        Clearance angle that keeps the heel clear of the finished surface. [rad]
    rake_range
        Lowest and highest effective rake, relative to the surface as it climbs and falls under the edge (lo, hi). [rad]
    ok
        Whether every finding is ok.
    findings
        All checks, with margin and place.
    """

    nose_radius_limit: float
    sweep: tuple[float, float]
    included_needed: float
    clearance_needed: float
    rake_range: tuple[float, float]
    ok: bool
    findings: tuple[AccessFinding, ...]


class _Places(NamedTuple):
    """A polar grid of rings about the axis, with equal steps along and between the rings."""

    radius: Floats
    angle: Floats
    wide: Floats  # angle to the neighbours along the ring [rad]
    step: float  # distance to the next ring [mm]


class Reach(NamedTuple):
    """Requirements on a tool at single points of a part, see `check_access`. Each (n,)."""

    curvature: Floats  # in the rake plane, positive concave; limits the nose radius [1/mm]
    sweep: Floats  # angle on the nose where the edge touches [rad]
    climb: Floats  # slope angle along the cutting direction, positive uphill [rad]

    @property
    def clearance(self) -> Floats:
        """Required clearance angle; negative where the surface climbs along the cutting direction. (n,) [rad]."""
        return -self.climb


def check_access(
    part: Part, tool: Tool, *, sense: int = 1, lead_in: float = 0.0, progress: Progress | None = None
) -> Access:
    r"""Check whether a tool can cut a part: requirements, margins and the tightest places.

    At radius :math:`\rho` and azimuth :math:`\theta` let :math:`f_u = \partial f/\partial\rho` be the slope outward and
    :math:`f_v = \partial f/\rho\,\partial\theta` the slope along growing azimuth. The edge at rake :math:`\gamma` lies
    in a plane that leans back from the vertical, so a height :math:`w` along it is at :math:`v = kw, z = cw` with
    :math:`c = \cos\gamma, k = -s\sin\gamma` and :math:`s` the sense. There the surface has the slope and the curvature

    .. math::
        w' = \frac{f_u}{c - k f_v}, \qquad
        w'' = \frac{f_{uu} + 2 k w' f_{uv} + k^2 w'^2 f_{vv}}{c - k f_v}, \qquad
        \kappa = \frac{w''}{(1 + w'^2)^{3/2}}.

    Only concave places (:math:`\kappa > 0`) limit the nose, to :math:`1/\max\kappa`. The nose touches at the angle
    whose tangent is :math:`w'`. Collisions of the edge away from the contact do not follow from the curvature: placing
    the tool detects them exactly. Clearance, rake and valleys: see the theory of access. A required included or
    clearance angle that is not given fails. Shank and holder, if the tool states them, must stay clear of the part with
    its stock wherever the tip touches the part.

    Parameters
    ----------
    part, tool
        Part and tool; of the tool the actual nose radius and the nominal angles.
    sense
        +1 where the azimuth of the part under the tool grows, -1 where it falls.
    lead_in
        How far beyond the rim the tip begins; only shank and holder depend on it. [mm]
    progress
        Called with (done, total).

    Notes
    -----
    The surface is sampled on rings an eighth of its feature size apart (at most 400 000 points); the search is then
    refined around the best 32 points, on one piece of the surface at a time. A raked edge is taken at the azimuth of
    its tip.

    Sources
    -------
    [Troutman2016]_ chapter 6. Erratum to its Eq. 6.2: the absolute value of the curvature counts convex places too,
    which any nose reaches; [Li2018]_ has it likewise.

    >>> from turnwright.part import Part
    >>> from turnwright.surface import SineGrid
    >>> from turnwright.tool import Tool
    >>> grid = Part(surface=SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5)), radius=5.0)
    >>> tool = Tool(nose_radius=0.514, clearance=np.deg2rad(10), included=np.deg2rad(60))
    >>> access = check_access(grid, tool)
    >>> access.ok, round(access.nose_radius_limit, 2)
    (True, 79.16)
    >>> print(access.findings[1].sentence)
    included angle needs to be 0.815 deg at x = 0 mm, y = 0 mm, the tool has 60 deg
    """
    if sense not in (-1, 1):
        raise InputError(f"sense is {sense!r}, it must be 1 or -1: give the direction of the azimuth under the tool")

    part = part.continued

    def shape(radius: Floats, angle: Floats) -> Reach:
        reach = _reach(part, tool, sense, radius, angle)
        if part.outline is None:
            return reach
        on = part.covers(radius * np.cos(angle), radius * np.sin(angle))
        return Reach(*(np.where(on, one, np.nan) for one in reach))

    places, report = _places(part), progress or (lambda _done, _total: None)
    starts = range(0, places.radius.size, CHUNK_POINTS)
    total = len(starts) + 1
    parts = []
    for number, start in enumerate(starts):
        report(number, total)
        chunk = slice(start, start + CHUNK_POINTS)
        parts.append(shape(places.radius[chunk], places.angle[chunk]))
    sampled = Reach(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    report(total - 1, total)
    maxima = _find_maxima(shape, sampled, places, part.reach)
    (curvature, curved), (high, at_high), (minus_low, at_low), (steep, climbing), (minus_fall, falling) = maxima
    report(total, total)

    limit = 1 / curvature if curvature > 0 else math.inf
    needed, at_needed = (2 * high, at_high) if high >= minus_low else (2 * minus_low, at_low)
    clearance = max(minus_fall, 0.0)
    beyond = 0.0 if part.leaves_air else max(lead_in, tool.actual_radius * math.sin(max(minus_low, 0.0)))
    rakes = (tool.rake - steep, tool.rake + minus_fall)
    rake_words = (
        f"the rake relative to the surface ranges from {_deg(rakes[0])} {_position(climbing)} to {_deg(rakes[1])} "
        f"{_position(falling)}"
    )
    findings = [
        _nose(tool, limit, curved),
        _angle("included angle", "included", needed, tool.included, at_needed),
        _angle("clearance", "clearance", clearance, tool.clearance, falling),
        AccessFinding(
            name="rake", value=rakes[0], limit=None, margin=None, where=climbing, ok=True, sentence=rake_words
        ),
        *_borders(part, tool, places),
        *(_body(part, tool, name, sense, beyond) for name in tool.bodies),
    ]
    return Access(
        nose_radius_limit=limit,
        sweep=(-minus_low, high),
        included_needed=needed,
        clearance_needed=clearance,
        rake_range=rakes,
        ok=all(finding.ok for finding in findings),
        findings=tuple(findings),
    )


def check_depths(
    part: Part,
    tool: Tool,
    depths: Mapping[str, float],
    *,
    inside_out: bool = False,
    sense: int = 1,
    progress: Progress | None = None,
) -> tuple[AccessFinding, ...]:
    r"""Check for each pass with a depth of cut whether its chip stays on the cutting edge.

    A pass cuts with the leading side of the edge: toward the axis, or outward where it is cut inside out. There the
    edge is the height :math:`g(u) = Z + e(u) - f(\rho + u)` above the finished surface, and cuts wherever that is less
    than the depth of cut d. Beyond the end of the cutting edge, its arc and the ``edge_length`` of its flanks, it must
    not cut:

    .. math:: d \le \min_{\rho, \theta} \min_{u\text{ beyond the edge}} g(u) .

    On the trailing side the previous revolution has already cut, up to the cusp. Beyond the clear aperture the finished
    surface continues at the slope of the rim where that rises outward, and level where it falls.

    Parameters
    ----------
    part, tool, sense, progress
        See `check_access`.
    depths
        Depth of cut of each pass, along z, by name. [mm]
    inside_out
        Whether the passes run from the centre to the rim.

    >>> from turnwright.part import Part
    >>> from turnwright.surface import Plane
    >>> from turnwright.tool import Tool
    >>> tool = Tool(nose_radius=0.5, included=np.deg2rad(60), clearance=np.deg2rad(10))
    >>> flat = Part(surface=Plane(slope=(0.0, 0.0)), radius=5.0)
    >>> findings = check_depths(flat, tool, {"roughing": 0.05, "too deep": 0.5})
    >>> [(finding.ok, round(finding.limit, 3)) for finding in findings]
    [(True, 0.067), (False, 0.067)]
    """
    cuts = {name: depth for name, depth in depths.items() if depth > 0}
    if not cuts:
        return ()
    most, where = largest_depth(part, tool, side=1 if inside_out else -1, sense=sense, progress=progress)
    findings = []
    for name, depth in cuts.items():
        ok = depth <= most * (1 + 1e-9)
        words = f"pass {name} has a depth of cut of {say_length(depth)}, the edge allows {say_length(most)}"
        if not ok:
            words += (
                f" (nose_radius {tool.actual_radius:.4g} mm, arc from {_deg(tool.arc[0])} to {_deg(tool.arc[1])}), "
                f"tightest {_position(where)}: use a smaller depth, a tool with a larger nose_radius or included "
                "angle, or give the edge_length of its flanks"
            )
        findings.append(
            AccessFinding(
                name="depth of cut", value=depth, limit=most, margin=most - depth, where=where, ok=ok, sentence=words
            )
        )
    return tuple(findings)


def largest_depth(
    part: Part, tool: Tool, *, side: int, sense: int = 1, nearest: float = 0.0, progress: Progress | None = None
) -> tuple[float, tuple[float, float]]:
    """Return the largest depth of cut of one side of the edge everywhere on a part [mm], and the tightest place.

    ``side`` is +1 for the side away from the axis, -1 for that toward it; places closer to the axis than ``nearest``
    [mm] are ignored.
    """
    count = np.arange(DEPTH_POINTS)
    square = nearest**2 + (part.reach**2 - nearest**2) * (count + 0.5) / DEPTH_POINTS
    ring = np.linspace(0, TURN, RING_POINTS, endpoint=False)
    radius = np.concatenate([np.sqrt(square), np.full(RING_POINTS, part.reach), np.full(RING_POINTS, nearest)])
    angle = np.concatenate([count * GOLDEN_ANGLE, ring, ring])
    part = part.continued
    done, total = 0, radius.size + REFINEMENTS * MAX_STARTS * REFINEMENT_STEPS.size**2

    def measure(radius: Floats, angle: Floats) -> Floats:
        nonlocal done
        before = done
        report = None if progress is None else (lambda count, _all: progress(before + count, total))
        gap = _outer_gap(part, tool, side, sense, radius, angle, report)
        if part.outline is not None and nearest < part.reach:
            gap = np.where(part.covers(radius * np.cos(angle), radius * np.sin(angle)), gap, np.inf)
        done += radius.size
        return gap

    gap = measure(radius, angle)
    step = part.reach / math.sqrt(DEPTH_POINTS)
    for _ in range(REFINEMENTS):
        best = np.argsort(gap, kind="stable")[:MAX_STARTS]
        radius, angle, gap = radius[best], angle[best], gap[best]
        offsets = step * REFINEMENT_STEPS
        outward, along = (offset.ravel() for offset in np.meshgrid(offsets, offsets))
        near_radius = np.clip(np.add.outer(radius, outward), nearest, part.reach).ravel()
        near_angle = (angle[:, None] + along / np.maximum(radius, step)[:, None]).ravel()
        radius, angle = np.append(radius, near_radius), np.append(angle, near_angle)
        gap = np.append(gap, measure(near_radius, near_angle))
        step /= 3
    worst = int(np.argmin(gap))
    return float(gap[worst]), (
        float(radius[worst] * np.cos(angle[worst])),
        float(radius[worst] * np.sin(angle[worst])),
    )


def _outer_gap(
    part: Part, tool: Tool, side: int, sense: int, radius: Floats, angle: Floats, progress: Progress | None
) -> Floats:
    """Return the smallest gap between finished surface and edge beyond its cutting part. (n,) [mm]."""
    tip = touch(part.surface, tool, angle=angle, radius=radius, sense=sense, rim=part.reach, progress=progress).z
    end = tool.arc[1] if side > 0 else tool.arc[0]
    u, v, e = tool.edge(np.array([end, end + side]), sense)
    begin = (tool.edge_length or 0.0) / math.hypot(u[1] - u[0], v[1] - v[0], e[1] - e[0])
    # The flank is straight and is followed across the whole part.
    last = begin + 2 * part.reach / abs(u[1] - u[0])
    along = begin + (last - begin) * np.linspace(0, 1, FLANK_POINTS) ** 2
    out = radius[:, None] + u[0] + along * (u[1] - u[0])
    lateral = v[0] + along * (v[1] - v[0])
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    finished = _extended_surface(part, out * cosine - lateral * sine, out * sine + lateral * cosine)
    gap = tip[:, None] + e[0] + along * (e[1] - e[0]) - finished
    # Half a revolution earlier, the edge has cut the other side of the axis as far as it reaches.
    gap[out < abs(u[0] + begin * (u[1] - u[0])) - radius[:, None]] = np.inf
    gap[np.isnan(gap)] = np.inf
    return np.asarray(gap.min(axis=1))


def _extended_surface(part: Part, x: Floats, y: Floats) -> Floats:
    """Return the finished surface; beyond the clear aperture at the slope of the rim, level where it falls. [mm]."""
    distance = np.hypot(x, y)
    beyond = distance > part.reach
    shrink = np.where(beyond, part.reach * (1 - 1e-12) / np.where(beyond, distance, 1.0), 1.0)
    flat_x, flat_y = np.ascontiguousarray((x * shrink).ravel()), np.ascontiguousarray((y * shrink).ravel())
    with np.errstate(all="ignore"):
        z = part.surface.evaluate(flat_x, flat_y, 0)[0].reshape(x.shape)
        over = np.flatnonzero(beyond.ravel())
        _, zx, zy = part.surface.evaluate(flat_x[over], flat_y[over], 1)
    slope = (zx * flat_x[over] + zy * flat_y[over]) / part.reach
    z.ravel()[over] += np.maximum(slope, 0.0) * (distance.ravel()[over] - part.reach)
    return z


def _body(part: Part, tool: Tool, name: str, sense: int, beyond: float) -> AccessFinding:
    """Check that shank or holder stays clear of the part, wherever the tip touches it."""
    body = tool.bodies[name]
    gap, tip, where = _body_gap(part, tool, body, sense, beyond)
    ok = gap >= BODY_GAP_MM
    near = f"stays {say_length(gap)} above the part" if gap > 0 else f"cuts {say_length(-gap)} into the part"
    words = f"the {name} {near} along z {_position(where)}, with the tip {_position(tip)}"
    if math.isinf(gap):
        words, where = f"the {name} is nowhere above the part", (math.nan, math.nan)
    if not ok:
        more = BODY_GAP_MM - gap
        words += (
            f", the limit is {say_length(BODY_GAP_MM)}: use a slimmer {name}, or one that begins "
            f"{body.height + more:.4g} mm above the tip (now {body.height:.4g} mm)"
        )
    return AccessFinding(
        name=name, value=gap, limit=BODY_GAP_MM, margin=gap - BODY_GAP_MM, where=None if math.isinf(gap) else where,
        ok=ok, sentence=words,
    )  # fmt: skip


def _body_gap(
    part: Part, tool: Tool, body: Shank, sense: int, beyond: float
) -> tuple[float, tuple[float, float], tuple[float, float]]:
    """Return the least height of a cylinder above the part with its stock, and (x, y) of the tip and of that point."""
    reach = part.reach + beyond

    def gaps(radius: Floats, angle: Floats, out: Floats, turned: Floats, at: Ints) -> Floats:
        """Return the height of points of the cylinder above the part; ``at`` numbers their positions of the tip."""
        tip = touch(part.surface, tool, angle=angle, radius=radius, sense=sense, rim=part.reach).z
        if part.outline is not None:
            tip[~part.covers(radius * np.cos(angle), radius * np.sin(angle))] = np.inf
        along = radius[at] + body.offset[0] + out * np.cos(turned)
        across = body.offset[1] + out * np.sin(turned)
        c, s = np.cos(angle[at]), np.sin(angle[at])
        return np.asarray(tip[at] + body.height - _top_of_stock(part, along * c - across * s, along * s + across * c))

    places, least = _starts_of_body(part, tool, body, sense, reach)
    if not least.size:
        return math.inf, (math.nan, math.nan), (math.nan, math.nan)
    size = np.array([reach / math.sqrt(DEPTH_POINTS), 0.0, body.radius / 8, TURN / 24])
    low, high = np.array([part.nearest, -np.inf, 0.0, -np.inf]), np.array([reach, np.inf, body.radius, np.inf])
    nine = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0])).reshape(2, 1, 9)
    row, every = np.arange(least.size), np.repeat(np.arange(9 * least.size), 9)
    for _ in range(BODY_STEPS):
        size[1] = size[0] / max(part.reach / 8, 1e-9)
        # Nine positions of the tip around each of the best, and nine points of the cylinder for each of them.
        near = places[:, :, None] + size[:, None, None] * np.concatenate([nine, nine])
        near = np.clip(near, low[:, None, None], high[:, None, None])
        of_body = np.broadcast_to(near[2:, :, None, :], (2, least.size, 9, 9)).reshape(2, -1)
        values = gaps(near[0].ravel(), near[1].ravel(), of_body[0], of_body[1], every).reshape(least.size, 81)
        top = values.argmin(axis=1)
        better = values[row, top] < least
        tip, point = np.divmod(top, 9)
        moved = np.concatenate([near[:2, row, tip], near[2:, row, point]])
        places[:, better], least[better] = moved[:, better], values[row, top][better]
        size *= BODY_SHRINK
    worst = int(np.argmin(least))
    rho, theta, far, way = places[:, worst].tolist()
    along, across = rho + body.offset[0] + far * math.cos(way), body.offset[1] + far * math.sin(way)
    c, s = math.cos(theta), math.sin(theta)
    return float(least[worst]), (rho * c, rho * s), (along * c - across * s, along * s + across * c)


def _starts_of_body(part: Part, tool: Tool, body: Shank, sense: int, reach: float) -> tuple[Floats, Floats]:
    """Return starts of the search: radius and azimuth of the tip, and a point of the cylinder, polar; and the gaps.

    (4, n) and (n,). All parts of a chuck have their own positions of the tip, and their own points in the way.
    """
    x, y, top = _points_in_the_way(part)
    parts = part.apart
    places, least = [], []
    for one in parts:
        tip_x, tip_y = _spread_over(one, BODY_TIPS // len(parts), reach)
        radius, angle = np.hypot(tip_x, tip_y), np.arctan2(tip_y, tip_x)
        tip = touch(part.surface, tool, angle=angle, radius=radius, sense=sense, rim=part.reach).z
        gap, out, turned = _gaps_of_pairs(body, radius, angle, tip, x, y, top)
        count = min(8 * (MAX_STARTS // len(parts) + 1), gap.size)
        best = np.argpartition(gap, count - 1, axis=None)[:count]
        best = best[np.argsort(gap.ravel()[best], kind="stable")][::8]
        best = best[np.isfinite(gap.ravel()[best])]
        at = best // x.size
        places.append(np.stack([radius[at], angle[at], out.ravel()[best], turned.ravel()[best]]))
        least.append(gap.ravel()[best])
    return np.concatenate(places, axis=1), np.concatenate(least)


def _spread_over(part: Part, count: int, reach: float) -> tuple[Floats, Floats]:
    """Return points spread over a part and along its border; a disc as far as ``reach``. Each (n,) [mm]."""
    x, y = evenly(part, count)
    if part.outline is None:
        x, y = x * reach / part.reach, y * reach / part.reach
        ring = np.linspace(0, TURN, RING_POINTS, endpoint=False)
        for radius in (reach, part.reach):
            x, y = np.append(x, radius * np.cos(ring)), np.append(y, radius * np.sin(ring))
        return x, y
    edge_x, edge_y = part.border.border(RING_POINTS)
    return np.append(x, edge_x * (1 - 1e-9)), np.append(y, edge_y * (1 - 1e-9))


def _points_in_the_way(part: Part) -> tuple[Floats, Floats, Floats]:
    """Return points spread over the part or the blank, and their heights with the stock. Each (n,) [mm]."""
    parts, reach = part.apart, part.reach if part.blank is None else part.blank.reach
    points = [_spread_over(one, BODY_POINTS // len(parts), reach) for one in parts]
    x, y = (np.concatenate(columns) for columns in zip(*points, strict=True))
    return x, y, _top_of_stock(part, x, y)


def _gaps_of_pairs(
    body: Shank, radius: Floats, angle: Floats, tip: Floats, x: Floats, y: Floats, top: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the height of the cylinder at each position of the tip above each point, inf where it is not above it.

    And distance and direction of the point from its centre. Each (n, m)
    """
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = x * c + y * s - radius[:, None] - body.offset[0]
    across = y * c - x * s - body.offset[1]
    out = np.hypot(along, across)
    gap = np.where(out <= body.radius, tip[:, None] + body.height - top, np.inf)
    return gap, out, np.arctan2(across, along)


def check_bodies(part: Part, tool: Tool, motion: Motion) -> list[tuple[str, str]]:
    """Return "shank" or "holder", and a sentence, for each that comes too close to the part in a motion.

    It compares positions spread over the motion, in the air between parts too, with points spread over the part.
    """
    part, close = part.continued, []
    in_the_way = _points_in_the_way(part)
    at = np.unique(np.linspace(0, motion.time.size - 1, MOTION_TIPS).astype(np.int64))
    x, c, z = (motion.axes[letter][at] for letter in "XCZ")
    for name, body in tool.bodies.items():
        gap = np.concatenate([
            _gaps_of_pairs(body, x[some], c[some], z[some], *in_the_way)[0].min(axis=1)
            for some in (slice(start, start + BODY_TIPS) for start in range(0, at.size, BODY_TIPS))
        ])  # fmt: skip
        worst = int(gap.argmin())
        if gap[worst] >= BODY_GAP_MM:
            continue
        how = f"comes within {say_length(gap[worst])} of" if gap[worst] > 0 else f"cuts {say_length(-gap[worst])} into"
        sentence = (
            f"the {name} {how} the part where the tip is at X {x[worst]:.4g} mm, Z {z[worst]:.4g} mm, the limit is "
            f"{say_length(BODY_GAP_MM)}: use a slimmer {name}, or one that begins higher, or place the parts farther "
            "apart"
        )
        close.append((name, sentence))
    return close


def _top_of_stock(part: Part, x: Floats, y: Floats) -> Floats:
    """Return the finished surface plus stock, out to the blank if it is stated; -inf where there is no part. [mm]."""
    reach = part.reach if part.blank is None else part.blank.reach
    shaped = part.shaped_blank
    z = _extended_surface(part, x, y) + part.stock if shaped is None else shaped.top(x, y)
    on = np.hypot(x, y) <= reach
    if part.outline is not None and part.blank is None:
        on &= part.covers(x, y)
    return np.where(on & ~np.isnan(z), z, -np.inf)


def odd_sizes(part: Part, tool: Tool) -> tuple[str, ...]:
    """Return a warning for every size whose unit is probably wrong."""
    warnings = []
    if tool.nose_radius > MAX_NOSE_RADIUS_MM:
        warnings.append(
            f"nose_radius is {tool.nose_radius:g} mm, diamond tools have at most about {MAX_NOSE_RADIUS_MM:g} mm: "
            "check its unit"
        )
    if part.stock > tool.nose_radius:
        warnings.append(
            f"stock is {part.stock:g} mm, more than the nose_radius of {tool.nose_radius:g} mm: check its unit"
        )
    return tuple(warnings)


def reach_at(part: Part, tool: Tool, *, x: Floats, y: Floats, sense: int = 1) -> Reach:
    """Return the requirements of `check_access` at points off the axis. Each (n,) [mm]."""
    return _reach(part, tool, sense, np.hypot(x, y), np.arctan2(y, x))


def _reach(part: Part, tool: Tool, sense: int, radius: Floats, angle: Floats) -> Reach:
    c, s = np.cos(angle), np.sin(angle)
    z, zx, zy, zxx, zxy, zyy = part.surface.evaluate(radius * c, radius * s, 2)
    with np.errstate(all="ignore"):  # values that are not finite are refused below
        fu, fv = zx * c + zy * s, zy * c - zx * s
        fuu = zxx * c**2 + 2 * zxy * c * s + zyy * s**2
        fuv = (zyy - zxx) * c * s + zxy * (c**2 - s**2)
        fvv = zxx * s**2 - 2 * zxy * c * s + zyy * c**2
        bad = ~np.isfinite(fu + fv + fuu + fuv + fvv) & (radius > 1e-9)  # only on the axis may they be undefined
    if bad.any():
        x, y = float((radius * c)[bad][0]), float((radius * s)[bad][0])
        raise DomainError(
            f"the surface has no finite slope and curvature {_position((x, y))} ({np.count_nonzero(bad)} of {bad.size} "
            "points), they must exist everywhere but on the axis: keep the part clear of poles and of the limits of "
            "terms"
        )
    steepness = np.where(radius > AXIS_RADIUS_MM, np.hypot(fu, fv), 0.0)
    if steepness.max(initial=0.0) > MAX_SLOPE:
        worst = int(np.argmax(steepness))
        x, y = float((radius * c)[worst]), float((radius * s)[worst])
        raise DomainError(
            f"the surface has a slope of {steepness[worst]:.3g} mm per mm {_position((x, y))}, the limit is "
            f"{MAX_SLOPE:g}: check the units and the exponents of its terms"
        )
    if (highest := float(np.max(np.abs(z), where=np.isfinite(z), initial=0.0))) > MAX_HEIGHT_MM:
        raise DomainError(
            f"the surface has a height of {highest:.3g} mm, the limit is {MAX_HEIGHT_MM:g} mm: check the units and the "
            "exponents of its terms"
        )
    up, back = math.cos(tool.rake), -sense * math.sin(tool.rake)
    # Not positive where the surface climbs over the rake face: no edge cuts there, and the nose limit is zero.
    opening = np.maximum(up - back * fv, 1e-9)
    slope = fu / opening
    bend = (fuu + 2 * back * slope * fuv + (back * slope) ** 2 * fvv) / opening
    return Reach(bend / (1 + slope**2) ** 1.5, np.arctan(slope), np.arctan(sense * fv))


MEASURES: tuple[Callable[[Reach], Floats], ...] = (
    lambda shape: shape.curvature,
    lambda shape: shape.sweep,
    lambda shape: -shape.sweep,
    lambda shape: shape.climb,
    lambda shape: -shape.climb,
)
"""Quantities whose maxima on the part are searched."""


def _places(part: Part) -> _Places:
    finest = math.sqrt(math.pi / MAX_GRID_POINTS) * part.reach
    step = max(min(part.reach / 48, part.surface.feature_size / 8), finest)
    rings = np.linspace(0, part.reach, math.ceil(part.reach / step) + 1)
    counts = np.maximum(np.ceil(TURN * rings / step), 64).astype(np.int64)
    radius = np.repeat(rings, counts)
    rank = np.arange(radius.size) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = TURN / np.repeat(counts, counts)
    return _Places(radius, rank * wide, wide, float(rings[1]))


def _find_maxima(
    shape: Callable[[Floats, Floats], Reach], sampled: Reach, places: _Places, rim: float
) -> list[tuple[float, tuple[float, float]]]:
    """Return the largest value of each measure on the part, and its place (x, y).

    Around each of the best grid points, five by five neighbours are tried; where the middle one is best, the step is
    halved. All measures are searched together, as the cost of a surface per point falls with the number of points.
    """
    starts = [_starts(measure(sampled), places) for measure in MEASURES]
    of = np.repeat(np.arange(len(MEASURES)), [chosen.size for chosen, _ in starts])
    chosen, value = (np.concatenate(columns) for columns in zip(*starts, strict=True))
    radius, angle = places.radius[chosen], places.angle[chosen]
    wide, step = places.wide[chosen], np.full(chosen.size, places.step)
    across, along = (offsets.ravel() for offsets in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))
    for _ in range(100):
        rows = np.flatnonzero(step >= 1e-9 * rim)
        if not rows.size:
            break
        radii = np.clip(radius[rows, None] + step[rows, None] * across, 0, rim)
        angles = angle[rows, None] + wide[rows, None] * along
        near = shape(radii.ravel(), angles.ravel())
        values = np.choose(of[rows, None], [measure(near).reshape(radii.shape) for measure in MEASURES])
        values = np.where(np.isnan(values), -np.inf, values)
        top = (np.arange(rows.size), np.argmax(values, axis=1))
        better = values[top] > value[rows]
        moved = rows[better]
        radius[moved], angle[moved], value[moved] = (array[top][better] for array in (radii, angles, values))
        closer = rows[~better]
        step[closer], wide[closer] = step[closer] / 2, wide[closer] / 2
    maxima = []
    for number in range(len(MEASURES)):
        rows = np.flatnonzero(of == number)
        winner = rows[np.argmax(value[rows])]
        r, a = float(radius[winner]), float(angle[winner])
        maxima.append((float(value[winner]), (r * math.cos(a), r * math.sin(a))))
    return maxima


def _starts(values: Floats, places: _Places) -> tuple[Ints, Floats]:
    """Return the best grid points that are not next to each other, and the values there."""
    values = np.where(np.isnan(values), -np.inf, values)  # undefined on the axis
    best = np.argsort(values)[::-1][: 32 * MAX_STARTS]
    x, y = places.radius[best] * np.cos(places.angle[best]), places.radius[best] * np.sin(places.angle[best])
    starts: list[int] = []
    free = np.ones(best.size, bool)
    while len(starts) < MAX_STARTS and free.any():
        i = int(np.argmax(free))
        starts.append(i)
        free &= np.hypot(x - x[i], y - y[i]) >= 3 * places.step
        free[i] = False
    return best[starts], values[best[starts]]


def _position(where: tuple[float, float]) -> str:
    x, y = (round(value, 6) + 0.0 for value in where)  # + 0.0 turns -0 into 0
    return f"at x = {x:.4g} mm, y = {y:.4g} mm"


def _deg(angle: float) -> str:
    return f"{round(math.degrees(angle), 6) + 0.0:.3g} deg"


def _nose(tool: Tool, limit: float, where: tuple[float, float]) -> AccessFinding:
    radius, name = tool.actual_radius, "nose radius"
    if math.isinf(limit):
        words = f"nose_radius is {radius:.4g} mm; the part is nowhere concave along the radius, so any nose_radius fits"
        return AccessFinding(name=name, value=radius, limit=limit, margin=limit, where=None, ok=True, sentence=words)
    ok = radius <= limit * (1 + 1e-9)
    words = f"nose_radius is {radius:.4g} mm, the limit is {limit:.4g} mm {_position(where)}"
    words += "" if ok else f": use a nose_radius of at most {limit:.4g} mm"
    return AccessFinding(
        name=name, value=radius, limit=limit, margin=limit - radius, where=where, ok=ok, sentence=words
    )


def _angle(name: str, field: str, needed: float, has: float | None, where: tuple[float, float]) -> AccessFinding:
    words = f"{name} needs to be {_deg(needed)} {_position(where)}"
    ok = needed <= DISCONTINUITY_TOL if has is None else needed <= has
    if has is None:
        words += f", it is not given: give {field}"
    else:
        words += f", the tool has {_deg(has)}"
        words += "" if ok else f": use a tool with a larger {name}"
    margin = None if has is None else has - needed
    return AccessFinding(name=name, value=needed, limit=has, margin=margin, where=where, ok=ok, sentence=words)


def _borders(part: Part, tool: Tool, places: _Places) -> list[AccessFinding]:
    """Find valleys and steps where a radial line passes from one piece of the surface to the next."""
    surface = part.surface
    # Full diameters, to find a valley through the centre too.
    along = np.linspace(-part.reach, part.reach, 2 * math.ceil(part.reach / places.step) + 1)
    azimuths = min(math.ceil(math.pi * part.reach / places.step), 2 * MAX_GRID_POINTS // along.size)
    angle, radius = np.meshgrid(np.arange(azimuths) * (math.pi / azimuths), along, indexing="ij")
    c, s = np.cos(angle), np.sin(angle)
    number = surface.piece(radius * c, radius * s)
    if number is None:
        return []
    changes = number[:, 1:] != number[:, :-1]
    if part.outline is not None:
        on = part.covers(radius * c, radius * s)
        changes &= on[:, 1:] & on[:, :-1]
    ray, ring = np.nonzero(changes)
    c, s, inner = c[ray, 0], s[ray, 0], number[ray, ring]
    low, high = radius[ray, ring], radius[ray, ring + 1]
    for _ in range(60):
        middle = (low + high) / 2
        same = surface.piece(middle * c, middle * s) == inner
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    (before, bx, by), (after, ax, ay) = (surface.evaluate(r * c, r * s, 1) for r in (low, high))
    with np.errstate(invalid="ignore"):  # undefined on the axis
        jump = np.nan_to_num(np.abs(after - before))
        turn = np.nan_to_num(np.arctan(ax * c + ay * s) - np.arctan(bx * c + by * s))
    turn = np.where(jump > DISCONTINUITY_TOL, 0.0, turn)

    def find_worst(name: str, sizes: Floats, words: Callable[[float, str], str]) -> list[AccessFinding]:
        if not sizes.size or sizes.max() <= DISCONTINUITY_TOL:
            return []
        at = int(np.argmax(sizes))
        size, where = float(sizes[at]), (float(low[at] * c[at]), float(low[at] * s[at]))
        sentence = words(size, _position(where))
        return [AccessFinding(name=name, value=size, limit=0.0, margin=-size, where=where, ok=False, sentence=sentence)]

    def step(size: float, at: str) -> str:
        return (
            f"the surface has a step of {size:.4g} mm {at}, a nose cannot cut the wall: a fillet as wide as the edge "
            "remains"
        )

    def valley(size: float, at: str) -> str:
        fillet_um = 1e3 * tool.actual_radius * (1 / math.cos(size / 2) - 1)
        return (
            f"the slope changes by {_deg(size)} in a sharp valley {at}, the nose cannot reach its bottom: a fillet "
            f"{fillet_um:.3g} um high remains"
        )

    return find_worst("valley", turn, valley) + find_worst("step", jump, step)
