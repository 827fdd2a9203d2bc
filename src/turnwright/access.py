"""Whether the tool can reach the surface, where it is tightest, and by how much."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright.errors import DomainError, InputError
from turnwright.placing import touch
from turnwright.units import say_length

if TYPE_CHECKING:
    from turnwright._arrays import Floats, Ints
    from turnwright.part import Part
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = ["Access", "AccessFinding", "check_access", "check_depths"]

TURN = 2 * math.pi

MOST_PLACES = 400_000
"""Places that are looked at before the search narrows."""

CHUNK = 20_000
"""Of them at a time, between two words on the progress."""

STARTS = 32
"""Best places that the search narrows from."""

STEEPEST = 1e6
"""A surface steeper than this, in mm per mm, is described wrongly: no part has such a wall."""

HIGHEST = 1e6
"""A surface higher than this is described wrongly, and heights beyond lose their nanometres. [mm]."""

AXIS = 1e-5
"""How near to the axis a surface may be steeper still, as a formula in the azimuth is: it is judged as a wall. [mm]"""

SHARP = 1e-6
"""A slope that jumps by less than this, or a height by less than this many mm, is rounding."""


FIRST_PLACES = 3000
"""Places at which the chip is compared with the edge, before the search narrows."""

RING = 180
"""Further places on the rim, and nearest to the axis."""

GOLDEN = np.pi * (3 - np.sqrt(5))
"""Angle by which the seeds of a sunflower follow each other: it leaves no gaps and no rows. [rad]"""

ROUNDS = 8
"""Times that the search narrows, to a third of its step each."""

NARROWED = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
"""Steps from each place, outward and along the turn, by which the search narrows."""

ON_FLANK = 120
"""Points of a flank that are looked at, closer together where it begins."""

LARGEST_NOSE = 20.0
"""A nose beyond this is hardly a diamond's. [mm]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class AccessFinding:
    """One thing that was looked at.

    Parameters
    ----------
    name
        "nose radius", "included angle", "clearance", "rake", "valley" or "step"; "depth of cut" of a pass.
    value
        What the tool has (nose radius) or needs (angles), or the size of a valley or step, or the thickness that a pass
        takes off. [mm or rad]
    limit
        What the part allows (nose radius), the tool has (angles) or its edge cuts at a time; ``None`` if there is none
        or it is not stated.
    margin
        How much is left, negative where the limit is passed; ``None`` without a limit.
    where
        The tightest place on the part (x, y); ``None`` if there is none. [mm]
    ok
        Whether the tool passes. What is needed but not stated does not.
    sentence
        All of it in words.
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
    """What a part asks of a tool. See `check_access`.

    Parameters
    ----------
    nose_radius_limit
        Largest usable nose radius; infinite where no place is concave along the radius. [mm]
    sweep
        Lowest and highest angle on the nose that touches the part (lo, hi). [rad]
    included_needed
        Included angle, symmetric about the tip, that holds the sweep. [rad]
    clearance_needed
        Clearance angle that keeps the heel off the finished surface. [rad]
    rake_range
        Lowest and highest rake against the surface as it climbs and falls under the edge (lo, hi). [rad]
    ok
        Whether every finding is.
    findings
        What was looked at, with its margin and place.
    """

    nose_radius_limit: float
    sweep: tuple[float, float]
    included_needed: float
    clearance_needed: float
    rake_range: tuple[float, float]
    ok: bool
    findings: tuple[AccessFinding, ...]


class _Places(NamedTuple):
    """Where to look: rings about the axis, as dense along them as between them."""

    radius: Floats
    angle: Floats
    wide: Floats  # distance to the neighbours along the ring [rad]
    step: float  # distance to the next ring [mm]


class _Shape(NamedTuple):
    """The surface as the edge meets it."""

    curvature: Floats  # in the rake plane, positive concave [1/mm]
    sweep: Floats  # on the nose [rad]
    climb: Floats  # slope angle along the cutting direction, positive uphill [rad]


def check_access(part: Part, tool: Tool, *, sense: int = 1, progress: Progress | None = None) -> Access:
    r"""Return what a part asks of a tool, how much margin there is, and where on the part it is tightest.

    At radius :math:`\rho` and azimuth :math:`\theta` let :math:`f_u = \partial f/\partial\rho` be the slope outward and
    :math:`f_v = \partial f/\rho\,\partial\theta` the slope along growing azimuth.

    Nose radius
        The edge at rake :math:`\gamma` lies in a plane that leans back from the vertical, so a height :math:`w` along
        it stands at :math:`v = kw, z = cw` with :math:`c = \cos\gamma, k = -s\sin\gamma` and :math:`s` the sense. There
        the surface has the slope and the curvature

        .. math::
            w' = \frac{f_u}{c - k f_v}, \qquad
            w'' = \frac{f_{uu} + 2 k w' f_{uv} + k^2 w'^2 f_{vv}}{c - k f_v}, \qquad
            \kappa = \frac{w''}{(1 + w'^2)^{3/2}}.

        Only concave places (:math:`\kappa > 0`) limit the nose, to :math:`1/\max\kappa`. Without rake that is
        :math:`(1 + f_u^2)^{3/2} / f_{uu}`. Whether the edge hits the surface away from the contact is not a matter of
        curvature: placing the tool finds that exactly.
    Sweep
        The nose touches at the angle whose tangent is :math:`w'`. An included angle of twice the larger end holds it.
    Clearance
        The tool moves toward :math:`s\,v` over the part and its clearance face trails over what is cut, rising at the
        clearance angle :math:`\alpha`. Behind the edge the surface rises at :math:`-s f_v`, so where it falls along the
        cutting direction it needs :math:`\tan\alpha \ge -s f_v`. This holds at every sweep of a cylindrical clearance
        face; a conical one of the same angle clears a little more.
    Rake
        The surface climbs under the edge by :math:`\beta = \arctan(s f_v)`, so the rake against the surface is
        :math:`\gamma - \beta`. No limit is known to hold for all materials, so it is shown and not judged.

    Where two pieces of the surface meet in a valley along the radius, no nose reaches the bottom: that is a finding
    with the height that stays. An included or clearance angle that is needed and not stated is not passed.

    Parameters
    ----------
    part, tool
        What is cut, by what: the actual nose radius, the nominal angles.
    sense
        +1 where the azimuth of the part under the tool grows, -1 where it falls.
    progress
        Called with (done, total).

    Raises
    ------
    InputError
        If ``sense`` is neither.

    Notes
    -----
    The surface is looked at on rings an eighth of its feature size apart (at most 400 000 places), and the search
    then narrows around the best 32 of them, on one piece of the surface at a time. A raked edge is taken at the azimuth
    of its tip.

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
        raise InputError(f"sense is {sense!r}, it must be 1 or -1: give the way the azimuth runs under the tool")

    def shape(radius: Floats, angle: Floats) -> _Shape:
        return _shape(part, tool, sense, radius, angle)

    places = _places(part)
    chunks = math.ceil(places.radius.size / CHUNK)
    total = chunks + 1
    parts = []
    for number, chunk in enumerate(_chunks(places.radius.size)):
        if progress is not None:
            progress(number, total)
        parts.append(shape(places.radius[chunk], places.angle[chunk]))
    seen = _Shape(*(np.concatenate(one) for one in zip(*parts, strict=True)))
    if progress is not None:
        progress(chunks, total)
    found = _highest(shape, seen, places, part.radius)
    (curvature, curved), (high, at_high), (minus_low, at_low), (steep, climbing), (minus_fall, falling) = found
    if progress is not None:
        progress(total, total)

    limit = 1 / curvature if curvature > 0 else math.inf
    needed, at_needed = (2 * high, at_high) if high >= minus_low else (2 * minus_low, at_low)
    clearance = max(minus_fall, 0.0)
    rakes = (tool.rake - steep, tool.rake + minus_fall)
    findings = [
        _nose(tool, limit, curved),
        _angle("included angle", "included", needed, tool.included, at_needed),
        _angle("clearance", "clearance", clearance, tool.clearance, falling),
        AccessFinding(
            name="rake",
            value=rakes[0],
            limit=None,
            margin=None,
            where=climbing,
            ok=True,
            sentence=f"the rake against the surface goes from {_deg(rakes[0])} {_at(climbing)} to "
            f"{_deg(rakes[1])} {_at(falling)}",
        ),
        *_borders(part, tool, places),
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
    r"""Say of each pass whether its chip stays on the cutting edge.

    A pass cuts with the side of its edge that leads: toward the axis, or outward where it is cut inside out. There the
    edge stands the height :math:`g(u) = Z + e(u) - f(\rho + u)` above the finished surface, and cuts wherever that is
    less than the depth d; beyond the end of the cutting edge it must not:

    .. math:: d \le \min_{\rho, \theta} \min_{u\text{ beyond the edge}} g(u) .

    On the other side the revolution before has cut already, up to the cusp.

    Parameters
    ----------
    part
        Its finished surface; beyond the clear radius it goes on at the slope of the rim where that rises outward, and
        level where it falls.
    tool
        Its arc, and the length of its flanks that cuts if it states one.
    depths
        Thickness that each pass takes off at a time, along z, by name. [mm]
    inside_out
        Whether the passes go from the centre to the rim.
    sense
        +1 where the spindle angle under the tool grows, -1 where it falls.
    progress
        Called with (done, total).

    Returns
    -------
    tuple of AccessFinding
        One for every pass that takes anything off.

    >>> from turnwright.part import Part
    >>> from turnwright.surface import Plane
    >>> from turnwright.tool import Tool
    >>> tool = Tool(nose_radius=0.5, included=np.deg2rad(60), clearance=np.deg2rad(10))
    >>> flat = Part(surface=Plane(slope=(0.0, 0.0)), radius=5.0)
    >>> [(one.ok, round(one.limit, 3)) for one in check_depths(flat, tool, {"rough": 0.05, "all at once": 0.5})]
    [(True, 0.067), (False, 0.067)]
    """
    taken = {name: depth for name, depth in depths.items() if depth > 0}
    if not taken:
        return ()
    most, where = largest_depth(part, tool, side=1 if inside_out else -1, sense=sense, progress=progress)
    findings = []
    for name, depth in taken.items():
        ok = depth <= most * (1 + 1e-9)
        words = f"pass {name} takes off {say_length(depth)} at a time, the edge cuts up to {say_length(most)} here"
        if not ok:
            words += (
                f" (nose_radius {tool.actual_radius:.4g} mm, arc from {_deg(tool.arc[0])} to {_deg(tool.arc[1])}), "
                f"least {_at(where)}: use a smaller depth, or a tool with a larger nose_radius or included angle, or "
                "state the edge_length of its flanks"
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
    """Return the thickest layer that one side of the edge cuts all over a part [mm], and where it is the thinnest.

    ``side`` is +1 for the side away from the axis, -1 for that toward it; places nearer to the axis than ``nearest``
    [mm] do not count.
    """
    count = np.arange(FIRST_PLACES)
    square = nearest**2 + (part.radius**2 - nearest**2) * (count + 0.5) / FIRST_PLACES
    ring = np.linspace(0, TURN, RING, endpoint=False)
    radius = np.concatenate([np.sqrt(square), np.full(RING, part.radius), np.full(RING, nearest)])
    angle = np.concatenate([count * GOLDEN, ring, ring])
    done, total = 0, radius.size + ROUNDS * STARTS * NARROWED.size**2

    def look(radius: Floats, angle: Floats) -> Floats:
        """Return the room at some places, and tell how many were looked at."""
        nonlocal done
        before = done
        tell = None if progress is None else (lambda one, _all: progress(before + one, total))
        room = _room_beyond(part, tool, side, sense, radius, angle, tell)
        done += radius.size
        return room

    room = look(radius, angle)
    step = part.radius / math.sqrt(FIRST_PLACES)
    for _ in range(ROUNDS):
        best = np.argsort(room, kind="stable")[:STARTS]
        radius, angle, room = radius[best], angle[best], room[best]
        lateral = step * NARROWED
        out, turn = (one.ravel() for one in np.meshgrid(lateral, lateral))
        near = np.clip(np.add.outer(radius, out), nearest, part.radius).ravel()
        turned = angle[:, None] + turn / np.maximum(radius, step)[:, None]
        radius, angle = np.append(radius, near), np.append(angle, turned.ravel())
        room = np.append(room, look(near, turned.ravel()))
        step /= 3
    worst = int(np.argmin(room))
    return float(room[worst]), (
        float(radius[worst] * np.cos(angle[worst])),
        float(radius[worst] * np.sin(angle[worst])),
    )


def _room_beyond(
    part: Part, tool: Tool, side: int, sense: int, radius: Floats, angle: Floats, progress: Progress | None
) -> Floats:
    """Return how high the edge stands above the finished surface beyond its cutting part, at the least. (n,) [mm]."""
    tip = touch(part.surface, tool, angle=angle, radius=radius, sense=sense, rim=part.radius, progress=progress).z
    end = tool.arc[1] if side > 0 else tool.arc[0]
    u, v, e = tool.edge(np.array([end, end + side]), sense)
    begin = (tool.edge_length or 0.0) / math.hypot(u[1] - u[0], v[1] - v[0], e[1] - e[0])
    # The flank is straight: as far as the other side of the axis, or across all of the part.
    last = begin + 2 * part.radius / abs(u[1] - u[0])
    along = begin + (last - begin) * np.linspace(0, 1, ON_FLANK) ** 2
    out = radius[:, None] + u[0] + along * (u[1] - u[0])
    lateral = v[0] + along * (v[1] - v[0])
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    finished = _continued(part, out * cosine - lateral * sine, out * sine + lateral * cosine)
    gap = tip[:, None] + e[0] + along * (e[1] - e[0]) - finished
    # Half a turn before, the other side of the axis was cut as far as the edge reaches.
    gap[out < abs(u[0] + begin * (u[1] - u[0])) - radius[:, None]] = np.inf
    gap[np.isnan(gap)] = np.inf
    return np.asarray(gap.min(axis=1))


def _continued(part: Part, x: Floats, y: Floats) -> Floats:
    """Return the finished surface; beyond the clear radius at the slope of the rim, level where it falls. [mm]."""
    away = np.hypot(x, y)
    beyond = away > part.radius
    shrink = np.where(beyond, part.radius * (1 - 1e-12) / np.where(beyond, away, 1.0), 1.0)
    flat_x, flat_y = np.ascontiguousarray((x * shrink).ravel()), np.ascontiguousarray((y * shrink).ravel())
    with np.errstate(all="ignore"):
        z = part.surface.evaluate(flat_x, flat_y, 0)[0].reshape(x.shape)
        over = np.flatnonzero(beyond.ravel())
        _, zx, zy = part.surface.evaluate(flat_x[over], flat_y[over], 1)
    slope = (zx * flat_x[over] + zy * flat_y[over]) / part.radius
    z.ravel()[over] += np.maximum(slope, 0.0) * (away.ravel()[over] - part.radius)
    return z


def odd_sizes(part: Part, tool: Tool) -> tuple[str, ...]:
    """Return a sentence for every size that is hardly meant."""
    found = []
    if tool.nose_radius > LARGEST_NOSE:
        found.append(
            f"nose_radius is {tool.nose_radius:g} mm, noses of diamonds go up to about {LARGEST_NOSE:g} mm: check its "
            "unit"
        )
    if part.stock > tool.nose_radius:
        found.append(
            f"stock is {part.stock:g} mm, more than the nose_radius of {tool.nose_radius:g} mm: check its unit"
        )
    return tuple(found)


class Reach(NamedTuple):
    """What single places of a part ask of a tool, see `check_access`. Each (n,)."""

    curvature: Floats  # in the rake plane, positive concave; the nose must be rounder [1/mm]
    sweep: Floats  # where on the nose the edge touches [rad]
    clearance: Floats  # that the heel needs, negative where the surface rises along the cutting direction [rad]


def reach_at(part: Part, tool: Tool, *, x: Floats, y: Floats, sense: int = 1) -> Reach:
    """Return what `check_access` looks at, place by place.

    Parameters
    ----------
    part, tool, sense
        See `check_access`.
    x, y
        Places on the part, not on its axis where the surface has no slope there. Each (n,) [mm]
    """
    curvature, sweep, climb = _shape(part, tool, sense, np.hypot(x, y), np.arctan2(y, x))
    return Reach(curvature, sweep, -climb)


def _shape(part: Part, tool: Tool, sense: int, radius: Floats, angle: Floats) -> _Shape:
    """Return the surface as the edge meets it. Each (n,)."""
    c, s = np.cos(angle), np.sin(angle)
    z, zx, zy, zxx, zxy, zyy = part.surface.evaluate(radius * c, radius * s, 2)
    with np.errstate(all="ignore"):  # what is not finite is refused below
        fu, fv = zx * c + zy * s, zy * c - zx * s
        fuu = zxx * c**2 + 2 * zxy * c * s + zyy * s**2
        fuv = (zyy - zxx) * c * s + zxy * (c**2 - s**2)
        fvv = zxx * s**2 - 2 * zxy * c * s + zyy * c**2
        bad = ~np.isfinite(fu + fv + fuu + fuv + fvv) & (radius > 1e-9)  # the axis alone may be missing
    if bad.any():
        x, y = float((radius * c)[bad][0]), float((radius * s)[bad][0])
        raise DomainError(
            f"the surface has no finite slope and curvature {_at((x, y))} ({np.count_nonzero(bad)} of {bad.size} "
            "places), everywhere but on the axis it needs both: keep the part clear of poles and of places where a "
            "term ends"
        )
    steepness = np.where(radius > AXIS, np.hypot(fu, fv), 0.0)
    if steepness.max(initial=0.0) > STEEPEST:
        worst = int(np.argmax(steepness))
        x, y = float((radius * c)[worst]), float((radius * s)[worst])
        raise DomainError(
            f"the surface climbs by {steepness[worst]:.3g} mm per mm {_at((x, y))}, the limit is {STEEPEST:g}, as good "
            "as a vertical wall: check the units and the exponents of its terms"
        )
    if (highest := float(np.max(np.abs(z), where=np.isfinite(z), initial=0.0))) > HIGHEST:
        raise DomainError(
            f"the surface is {highest:.3g} mm high or deep, the limit is {HIGHEST:g} mm: check the units and the "
            "exponents of its terms"
        )
    up, back = math.cos(tool.rake), -sense * math.sin(tool.rake)
    # Not positive where the surface climbs over the rake face: there no edge cuts, and the limit of the nose is zero.
    open_ = np.maximum(up - back * fv, 1e-9)
    slope = fu / open_
    bend = (fuu + 2 * back * slope * fuv + (back * slope) ** 2 * fvv) / open_
    return _Shape(bend / (1 + slope**2) ** 1.5, np.arctan(slope), np.arctan(sense * fv))


MEASURES: tuple[Callable[[_Shape], Floats], ...] = (
    lambda one: one.curvature,
    lambda one: one.sweep,
    lambda one: -one.sweep,
    lambda one: one.climb,
    lambda one: -one.climb,
)
"""Of which the largest values on the part are searched."""


def _chunks(size: int) -> list[slice]:
    return [slice(start, start + CHUNK) for start in range(0, size, CHUNK)]


def _places(part: Part) -> _Places:
    """Return where to look first."""
    finest = math.sqrt(math.pi / MOST_PLACES) * part.radius
    step = max(min(part.radius / 48, part.surface.feature_size / 8), finest)
    rings = np.linspace(0, part.radius, math.ceil(part.radius / step) + 1)
    counts = np.maximum(np.ceil(TURN * rings / step), 64).astype(np.int64)
    radius = np.repeat(rings, counts)
    rank = np.arange(radius.size) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = TURN / np.repeat(counts, counts)
    return _Places(radius, rank * wide, wide, float(rings[1]))


def _highest(
    shape: Callable[[Floats, Floats], _Shape], seen: _Shape, places: _Places, rim: float
) -> list[tuple[float, tuple[float, float]]]:
    """Return the largest value of each measure on the part, and its place (x, y).

    From each of the best places seen, five by five neighbours are tried; where the middle one is best they close in.
    All measures are searched together, as a surface costs less by the point the more points it is asked for.
    """
    starts = [_starts(measure(seen), places) for measure in MEASURES]
    of = np.repeat(np.arange(len(MEASURES)), [chosen.size for chosen, _ in starts])
    chosen, value = (np.concatenate(one) for one in zip(*starts, strict=True))
    radius, angle = places.radius[chosen], places.angle[chosen]
    wide, step = places.wide[chosen], np.full(chosen.size, places.step)
    across, along = (part.ravel() for part in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))
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
        radius[moved], angle[moved], value[moved] = (one[top][better] for one in (radii, angles, values))
        closer = rows[~better]
        step[closer], wide[closer] = step[closer] / 2, wide[closer] / 2
    found = []
    for number in range(len(MEASURES)):
        rows = np.flatnonzero(of == number)
        winner = rows[np.argmax(value[rows])]
        r, a = float(radius[winner]), float(angle[winner])
        found.append((float(value[winner]), (r * math.cos(a), r * math.sin(a))))
    return found


def _starts(seen: Floats, places: _Places) -> tuple[Ints, Floats]:
    """Return the best places seen that are not beside each other, and the values there."""
    seen = np.where(np.isnan(seen), -np.inf, seen)  # the axis alone may be missing
    best = np.argsort(seen)[::-1][: 32 * STARTS]
    x, y = places.radius[best] * np.cos(places.angle[best]), places.radius[best] * np.sin(places.angle[best])
    starts: list[int] = []
    for i in range(best.size):
        near = np.hypot(x[starts] - x[i], y[starts] - y[i]) < 3 * places.step
        if not near.any() and len(starts) < STARTS:
            starts.append(i)
    return best[starts], seen[best[starts]]


def _at(where: tuple[float, float]) -> str:
    x, y = (round(value, 6) + 0.0 for value in where)  # adding nought turns -0 into 0
    return f"at x = {x:.4g} mm, y = {y:.4g} mm"


def _deg(angle: float) -> str:
    return f"{round(math.degrees(angle), 6) + 0.0:.3g} deg"


def _nose(tool: Tool, limit: float, where: tuple[float, float]) -> AccessFinding:
    """Judge the nose radius."""
    radius = tool.actual_radius
    if math.isinf(limit):
        words = f"nose_radius is {radius:.4g} mm and no place is concave along the radius: any nose fits"
        return AccessFinding(
            name="nose radius", value=radius, limit=limit, margin=limit, where=None, ok=True, sentence=words
        )
    ok = radius <= limit * (1 + 1e-9)
    words = f"nose_radius is {radius:.4g} mm, the limit is {limit:.4g} mm {_at(where)}"
    return AccessFinding(
        name="nose radius",
        value=radius,
        limit=limit,
        margin=limit - radius,
        where=where,
        ok=ok,
        sentence=words + ("" if ok else f": use a nose_radius of at most {limit:.4g} mm"),
    )


def _angle(name: str, field: str, needed: float, has: float | None, where: tuple[float, float]) -> AccessFinding:
    """Judge an angle of the tool."""
    words = f"{name} needs to be {_deg(needed)} {_at(where)}"
    ok = needed <= SHARP if has is None else needed <= has
    if has is None:
        words += f", it is not stated: state {field}"
    else:
        words += f", the tool has {_deg(has)}"
        words += "" if ok else f": use a tool with more {name}"
    margin = None if has is None else has - needed
    return AccessFinding(name=name, value=needed, limit=has, margin=margin, where=where, ok=ok, sentence=words)


def _borders(part: Part, tool: Tool, places: _Places) -> list[AccessFinding]:
    """Look for valleys and steps where a radial line passes from one piece of the surface to the next."""
    surface = part.surface
    # Whole diameters: a valley through the centre counts like any other.
    along = np.linspace(-part.radius, part.radius, 2 * math.ceil(part.radius / places.step) + 1)
    azimuths = min(math.ceil(math.pi * part.radius / places.step), 2 * MOST_PLACES // along.size)
    angle, radius = np.meshgrid(np.arange(azimuths) * (math.pi / azimuths), along, indexing="ij")
    c, s = np.cos(angle), np.sin(angle)
    number = surface.piece(radius * c, radius * s)
    if number is None:
        return []
    ray, ring = np.nonzero(number[:, 1:] != number[:, :-1])
    c, s, own = c[ray, 0], s[ray, 0], number[ray, ring]
    low, high = radius[ray, ring], radius[ray, ring + 1]
    for _ in range(60):
        middle = (low + high) / 2
        same = surface.piece(middle * c, middle * s) == own
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    (before, bx, by), (after, ax, ay) = (surface.evaluate(r * c, r * s, 1) for r in (low, high))
    with np.errstate(invalid="ignore"):  # the axis alone may be missing
        jump = np.nan_to_num(np.abs(after - before))
        turn = np.nan_to_num(np.arctan(ax * c + ay * s) - np.arctan(bx * c + by * s))
    turn = np.where(jump > SHARP, 0.0, turn)

    def worst(name: str, sizes: Floats, words: Callable[[float, str], str]) -> list[AccessFinding]:
        if not sizes.size or sizes.max() <= SHARP:
            return []
        at = int(np.argmax(sizes))
        size, where = float(sizes[at]), (float(low[at] * c[at]), float(low[at] * s[at]))
        sentence = words(size, _at(where))
        return [AccessFinding(name=name, value=size, limit=0.0, margin=-size, where=where, ok=False, sentence=sentence)]

    def step(size: float, at: str) -> str:
        return f"the surface steps by {size:.4g} mm {at}, no nose cuts a wall: a fillet as wide as the edge stays"

    def valley(size: float, at: str) -> str:
        stays = 1e3 * tool.actual_radius * (1 / math.cos(size / 2) - 1)
        return (
            f"a sharp valley turns by {_deg(size)} {at}, no nose reaches its bottom: a fillet of "
            f"{stays:.3g} um height stays"
        )

    return worst("valley", turn, valley) + worst("step", jump, step)
