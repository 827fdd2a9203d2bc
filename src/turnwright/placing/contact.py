r"""Placing the tool: bring the real edge into contact with the surface, exactly.

Along Z the contact is the tangent where that is unique (`placing.tangent`), otherwise the exact maximum
(`placing.search`). Along the normal the edge can gouge elsewhere. The clearance of the whole edge is evaluated
independently of the contact as a check.

The derivative of the tip's height along the spiral is computed too. The contact gives the greatest height, so to first
order its own movement along the edge has no effect [Danskin1967]_:

.. math:: \frac{dZ}{d\theta} = \nabla f(\mathbf p) \cdot \frac{\partial \mathbf p}{\partial\theta}, \qquad
   \mathbf p = \begin{pmatrix} (\rho + u)\cos\theta - (y + v)\sin\theta \\
   (\rho + u)\sin\theta + (y + v)\cos\theta \end{pmatrix}

with u and v held fixed. Where the edge rests on a ridge of the surface, the slope is the weighted mean of the slopes on
both sides to which the edge is tangent.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, frozen, only_read, same_length
from turnwright._kernels import contact as kernel
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.part import Part
from turnwright.path import Path, Spiral
from turnwright.placing.air import place_apart
from turnwright.placing.breaks import AXIS_ZONE_MM, SLOPE_OFFSET_MM
from turnwright.placing.search import CHUNK, search
from turnwright.placing.tangent import (
    Contact,
    Tips,
    Touch,
    find_curvature_limit,
    find_tangents,
    find_tangents_through,
)
from turnwright.progress import Progress, run_chunks
from turnwright.surface import Surface
from turnwright.tool import Tool

__all__ = ["place", "tip_height", "touch"]

TANGENT_TOL_RAD = 1e-3
"""A contact is a tangent if a Newton step would change its sweep by less; other contacts are on corners. [rad]"""

CLEARANCE_CHECKS, MAX_CHECKS_PER_TIP = 250_000, 4
"""Places on the edge where the clearance is evaluated: over the whole path, and at most at one tip. In a longer path
only every second tip is evaluated, or every third, and so on."""

STEP_TOL_MM = 1e-8
"""A greater difference in height between both sides is a step, not a ridge. [mm]"""

RATE_STEP_RAD = 1e-5
"""Where the surface has no slope, the tip is placed at this distance on both sides along the spiral. [rad]"""


def place(
    spiral: Spiral,
    part: Part,
    tool: Tool,
    *,
    along: Literal["z", "normal"] = "z",
    progress: Progress | None = None,
) -> Path:
    """Place the edge on the finished surface at every point of a spiral.

    Parameters
    ----------
    spiral
        Commanded positions in plan view: of the tip, or along the normal of the contact point.
    part, tool
        The finished part, and the real tool: its waviness, rake, radius error and offset are compensated.
    along
        "z" moves only Z and never gouges inside the clear aperture and the lead-in; "normal" moves X and Z, and reports
        the resulting clearance.
    progress
        Called with (done, total).

    Notes
    -----
    Outside an outline that the tool leaves within a revolution, the surface continues as `Part.continued` does. The
    path states the height for crossing air there. Points further out are not placed, their height is that of the
    continuation, or on a chuck that of the nearest border.

    Returns
    -------
    Path
        Commanded tip positions, contact points and the clearance of the whole edge. If the spiral has the derivatives
        of its radius (and of its height above centre) by the angle, the path has those of the tip's radius and height.
        Along "z", the derivative of the height in a valley is that of the side touched. On the lip of a step and on the
        rim, where the surface has no slope, it is a difference of the heights on both sides. Along the normal the tip
        jumps there.

    Raises
    ------
    DomainError
        If the edge touches where the surface is not defined.
    GougeError
        If the edge has no tangent of the surface's slope (along the normal only).
    InputError
        If ``along`` is neither "z" nor "normal", or the tool cannot pass between two parts of a chuck.

    Sources
    -------
    [Li2018]_, [Troutman2016]_ ch. 6; the exact maximum: `turnwright.placing.search`. Its derivative: [Danskin1967]_.
    """
    if along not in ("z", "normal"):
        raise InputError(f'along is {along!r}, it must be "z" or "normal"')
    edge = tool.cutting_edge(spiral.sense)
    if not part.leaves_air:
        return _place_on(spiral, part.continued, edge, along, progress)

    def place_on(some: Spiral, one: Part) -> Path:
        return _place_on(some, one, edge, along, progress)

    return place_apart(spiral, part, edge, place_on)


def _place_on(spiral: Spiral, part: Part, edge: Edge, along: Literal["z", "normal"], progress: Progress | None) -> Path:
    """Place the edge on a surface at every point of a spiral."""
    tips = Tips.at(spiral.angle, spiral.radius, spiral.y)
    if along == "normal":
        return _place_along_normal(spiral, part, edge, tips, progress)
    at = touch_down(part.surface, edge, tips, _rim(part), progress)
    return Path(
        angle=spiral.angle, radius=spiral.radius, z=at.z, sweep=at.sweep, contact_x=at.x, contact_y=at.y,
        contact_z=at.surface_z, clearance=_measure_clearance(part, edge, tips, at.z), y=spiral.y, y_rate=spiral.y_rate,
        radius_rate=spiral.radius_rate, lift=spiral.lift, z_rate=_find_z_rate(spiral, part, edge, tips, at),
    )  # fmt: skip


def touch(
    surface: Surface,
    tool: Tool,
    *,
    angle: ArrayLike,
    radius: ArrayLike,
    y: ArrayLike | None = None,
    sense: int,
    rim: float = np.inf,
    progress: Progress | None = None,
) -> Touch:
    """Bring the edge down onto the surface along Z.

    Parameters
    ----------
    surface, tool, sense
        The finished surface, and the real tool; ``sense`` is +1 if the angle grows with time, -1 if it falls.
    angle, radius, y
        Azimuth of the rake plane [rad], and positions of the commanded tip along and across it, across toward growing
        azimuth; ``None`` for 0. Each (n,) [mm]
    rim
        Radius inside which the surface counts, at least that of the farthest tip. Outside, it is continued under the
        arc of the outermost tips if its tangent is unique that far; otherwise it ends at the rim, and an edge that
        would touch outside is lowered onto the rim. By default all of the surface counts. [mm]

    Raises
    ------
    DomainError
        If the edge touches where the surface is not defined.
    GougeError
        If no place on the edge touches: the surface has infinite heights, or is steeper than the flanks as far as the
        rim.
    """
    angle, radius = frozen(angle, "angle"), frozen(radius, "radius")
    tips = Tips.at(angle, radius, None if y is None else frozen(y, "y"))
    same_length([("angle", angle), ("radius", radius), ("y", tips.lateral)])
    return touch_down(surface, tool.cutting_edge(sense), tips, rim, progress)


def tip_height(
    surface: Surface, tool: Tool, *, angle: ArrayLike, radius: ArrayLike, y: ArrayLike | None = None, sense: int,
    rim: float = np.inf,
) -> Floats:  # fmt: skip
    """Return the commanded tip heights at which the edge touches the surface. (n,) [mm]. See `touch`."""
    return touch(surface, tool, angle=angle, radius=radius, y=y, sense=sense, rim=rim).z


def touch_down(surface: Surface, edge: Edge, tips: Tips, rim: float, progress: Progress | None = None) -> Touch:
    """Bring an edge down as `touch` does: by the tangent, unless it may not be unique at one of the points."""
    tips = Tips(*(only_read(one) for one in tips))  # the kernels are compiled for read-only arrays
    contact = Contact.of(surface, edge, tips, rim)
    out = Touch(*(np.empty(tips.angle.size) for _ in range(5)))
    limit = find_curvature_limit(contact)
    unique = limit is not None

    def work(start: int, stop: int) -> None:
        nonlocal unique
        part = slice(start, stop)
        # Other threads may write it meanwhile: a chunk that fails must never be overwritten by one that does not.
        if unique and not find_tangents(contact, limit or 0.0, tips.select(part), out.select(part)):
            unique = False

    if unique:
        run_chunks(work, tips.angle.size, CHUNK, progress)
    if not unique:
        search(contact, tips, out, progress)
    return out


def _rim(part: Part) -> float:
    """Return the radius inside which the surface counts: all of one that continues outside an outline. [mm]."""
    return np.inf if part.leaves_air else part.reach


def _measure_clearance(part: Part, edge: Edge, tips: Tips, z: Floats) -> Floats:
    """Return the least height of the edge above the surface inside the rim, at most 0, without use of the contacts.

    Each tip is checked at different places of the edge, flanks included. The golden ratio spreads these places evenly
    over edge and path together, so that a contact that the search has missed is detected at some of the tips.
    """
    least = np.zeros(z.size)
    every = slice(None, None, max(1, z.size // CLEARANCE_CHECKS))
    rim = max(part.reach, tips.outermost())
    tips = Tips(*(np.ascontiguousarray(one) for one in tips.select(every)))
    seen, tip_z = np.zeros(tips.angle.size), np.ascontiguousarray(z[every])
    # A flank is a straight line over the sweep too: this is the sweep that reaches the far side of the rim.
    ends = np.array([edge.low, edge.high])
    low, high = 2 * rim / np.abs(edge.points(ends + np.array([-1.0, 1.0]))[0] - edge.points(ends)[0])
    times = int(np.clip(CLEARANCE_CHECKS // seen.size, 1, MAX_CHECKS_PER_TIP))

    def work(start: int, stop: int) -> None:
        some = slice(start, stop)
        x, y, e = np.empty((3, stop - start))
        for k in range(times):
            kernel.spread(edge, *tips.select(some), start * times + k, times, low, high, x, y, e)
            with np.errstate(all="ignore"):
                height, _ = part.surface.sample(x, y)
            kernel.lower_to_gap(tip_z[some], e, height, x, y, AXIS_ZONE_MM, rim, seen[some])

    run_chunks(work, seen.size, CHUNK)
    least[every] = seen
    return least


def _plan_rates(spiral: Spiral) -> tuple[Floats, Floats] | None:
    """Return the derivatives of radius and lateral position by the angle, or ``None`` if the spiral has none."""
    if spiral.radius_rate is None or (spiral.y is not None and spiral.y_rate is None):
        return None
    return spiral.radius_rate, np.zeros(spiral.angle.size) if spiral.y_rate is None else spiral.y_rate


def _find_z_rate(spiral: Spiral, part: Part, edge: Edge, tips: Tips, at: Touch) -> Floats | None:
    """Return the derivative of the tip's height by the angle, or ``None`` if the spiral has no derivatives."""
    rates = _plan_rates(spiral)
    if rates is None:
        return None
    surface, (outward, upward) = part.surface, rates
    rim = max(part.reach, tips.outermost())
    rate = np.empty(outward.size)

    def work(start: int, stop: int) -> None:
        some = slice(start, stop)
        x, y = at.x[some], at.y[some]
        across, along = np.empty((2, 2, x.size))
        rise, tangent = np.empty(x.size), np.empty(x.size, dtype=np.bool_)
        with np.errstate(all="ignore"):
            slopes = surface.evaluate(x, y, 2)[1:]
        kernel.rates(
            edge, spiral.angle[some], x, y, at.sweep[some], *slopes, outward[some], upward[some], TANGENT_TOL_RAD,
            rate[some], across, along, rise, tangent,
        )  # fmt: skip
        if not tangent.all():
            rate[some][~tangent & (np.hypot(x, y) > rim * (1 - 1e-9))] = np.nan
        if not surface.in_pieces:
            return
        hair = SLOPE_OFFSET_MM * along / np.hypot(*along)
        sides = [(x - hair[0], y - hair[1]), (x + hair[0], y + hair[1])]
        before, after = (surface.piece(*side) for side in sides)
        if before is not None and after is not None and (on := np.flatnonzero(before != after)).size:
            mixed, ridge = _mix_ridge_slopes(
                part, [(side[0][on], side[1][on]) for side in sides], along[:, on], rise[on]
            )
            rate[some][on[ridge]] = (mixed * across[:, on]).sum(axis=0)[ridge]

    run_chunks(work, rate.size, CHUNK)
    lost = np.flatnonzero(np.isnan(rate))
    if lost.size:
        turn, lost_tips = np.array([[-RATE_STEP_RAD], [RATE_STEP_RAD]]), tips.select(lost)
        moved = (
            lost_tips.angle + turn,
            lost_tips.radius + turn * outward[lost],
            lost_tips.lateral + turn * upward[lost],
        )
        z = touch_down(surface, edge, Tips(*(one.ravel() for one in moved)), rim).z
        rate[lost] = (z[lost.size :] - z[: lost.size]) / (2 * RATE_STEP_RAD)
    return rate


def _mix_ridge_slopes(
    part: Part, sides: list[tuple[Floats, Floats]], along: Floats, rise: Floats
) -> tuple[Floats, Bools]:
    """Return the mean slopes (2, n) of an edge that rests on a ridge, nan on the lip of a step, and where it does.

    In a valley the edge touches one of the sides, next to the valley, and the slope is that of the side.
    """
    with np.errstate(all="ignore"):
        before, after = (np.stack(part.surface.evaluate(*side, 1)) for side in sides)
    low, high = ((side[1:] * along).sum(axis=0) for side in (after, before))
    ridge = high > low
    share = np.clip((rise - low) / np.where(ridge, high - low, 1.0), 0.0, 1.0)
    mixed = share * before[1:] + (1 - share) * after[1:]
    lip = np.abs(before[0] - after[0]) > STEP_TOL_MM
    mixed[:, lip] = np.nan
    return mixed, ridge | lip


def _place_along_normal(spiral: Spiral, part: Part, edge: Edge, contacts: Tips, progress: Progress | None) -> Path:
    sweep, x, y, surface_z = find_tangents_through(part.surface, edge, contacts)
    u, _, e = edge.points(sweep)
    tips, z = contacts._replace(radius=contacts.radius - u), surface_z - e
    radius_rate = z_rate = None
    if rates := _plan_rates(spiral):
        radius_rate, z_rate = np.empty((2, x.size))
        slopes = part.surface.evaluate(x, y, 2)[1:]
        kernel.normal_rates(edge, spiral.angle, x, y, sweep, *slopes, *rates, radius_rate, z_rate)
    at = touch_down(part.surface, edge, tips, _rim(part), progress)
    return Path(
        angle=tips.angle, radius=tips.radius, z=z, sweep=sweep, contact_x=x, contact_y=y, contact_z=surface_z,
        clearance=z - at.z, y=spiral.y, y_rate=spiral.y_rate, radius_rate=radius_rate, z_rate=z_rate, lift=spiral.lift,
    )  # fmt: skip
