r"""Placing the tool: bring the real edge into contact with the surface, exactly.

Along Z the tip goes straight down until the edge touches: by the one tangent where there is only one
(`placing.tangent`), otherwise by the exact maximum (`placing.search`), free of gouges by construction; the clearance of
the edge, looked at all over it and not where the contact was found, proves it. Along
the normal the contact point stays where the spiral sends it and the tip moves aside,

.. math:: \rho' = \rho - u(s), \qquad z' = f(\rho, \theta) - e(s), \qquad e'(s)/u'(s) = f_\rho

with s the place on the nose whose tangent is the surface's; for a perfect nose u = R sin s and e = R (1 - cos s). That
can gouge elsewhere, so the clearance of the whole edge is measured by the dilation at the new tip.

How fast the tip rises while the tool goes along its spiral is known too. Among the places on the edge the one that
touches gives the greatest height, so to first order it does not matter that it moves along the edge [Danskin1967]_:

.. math:: \frac{dZ}{d\theta} = \nabla f(\mathbf p) \cdot \frac{\partial \mathbf p}{\partial\theta}, \qquad
   \mathbf p = \begin{pmatrix} (\rho + u)\cos\theta - (y + v)\sin\theta \\
   (\rho + u)\sin\theta + (y + v)\cos\theta \end{pmatrix}

with u and v held fixed. Where the edge rides on a ridge of the surface the slope is the mixture of those on both sides
that the edge is tangent to.
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
from turnwright.placing.breaks import BESIDE
from turnwright.placing.search import CHUNK, search
from turnwright.placing.tangent import Tips, Touch, bend_limit, find_tangents, set_contact, tangents_through
from turnwright.progress import Progress, run_chunks
from turnwright.surface import Surface
from turnwright.tool import Tool

__all__ = ["place", "tip_height", "touch"]

TANGENT = 1e-3
"""A contact this near to a tangent, as Newton's method sees it, is one; other contacts are on corners. [rad]"""

PLACES, MOST_PLACES = 250_000, 4
"""Places on the edge where its clearance is looked at, over the whole path and at one tip: of a longer path every
second, third and so on is tried."""

AXIS = 1e-6
"""How close to the axis nothing is looked at: what a formula in the azimuth does there is rounding. [mm]"""

STEP = 1e-8
"""What is higher than this on one side than on the other is a step, a ridge is not. [mm]"""

NEAR = 1e-5
"""How far to either side along the spiral the tip is placed once more where the surface has no slope. [rad]"""


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
        Where the tool is sent: the tip, or along the normal the contact point.
    part, tool
        What is to be left, and the real tool: its waviness, rake, radius error and offset are compensated.
    along
        "z" moves only Z and never gouges inside the clear radius and the lead-in; "normal" moves X and Z, and reports
        the clearance it leaves.
    progress
        Called with (done, total).

    Returns
    -------
    Path
        Commanded tip positions, contact points and the clearance of the whole edge. If the spiral states the
        derivatives of its radius (and height above centre) by the angle, those of the tip's radius and height too.
        Along "z" that of the height is in a valley the one of the side touched, and on the lip of a step or on the
        rim, where the surface has no slope, by the heights a hair to either side; along the normal the tip jumps there.

    Raises
    ------
    DomainError
        If the edge touches where the surface is not defined.
    GougeError
        If the edge has no tangent of the surface's slope (along the normal).
    InputError
        If ``along`` is neither.

    Sources
    -------
    [Li2018]_, [Troutman2016]_ ch. 6; DESIGN of the exact maximum in `turnwright.placing.search`. Its derivative:
    [Danskin1967]_.
    """
    if along not in ("z", "normal"):
        raise InputError(f'along is {along!r}, it must be "z" or "normal": choose one')
    edge = tool.cutting_edge(spiral.sense)
    tips = Tips(spiral.angle, spiral.radius, np.zeros(spiral.angle.size) if spiral.y is None else spiral.y)
    if along == "normal":
        return _along_normal(spiral, part, edge, tips, progress)
    at = touch_down(part.surface, edge, tips, part.radius, progress)
    return Path(
        angle=spiral.angle, radius=spiral.radius, z=at.z, sweep=at.sweep, contact_x=at.x, contact_y=at.y,
        contact_z=at.surface_z, clearance=_clearance(part, edge, tips, at.z), y=spiral.y, y_rate=spiral.y_rate,
        radius_rate=spiral.radius_rate, lift=spiral.lift, z_rate=_z_rate(spiral, part, edge, tips, at),
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
    surface, tool
        What is to be left, and the real tool.
    angle, radius
        Rake plane, and where the commanded tip stands along it. (n,) [rad], (n,) [mm]
    y
        How far across that plane it stands, toward growing azimuth; ``None`` for at centre. (n,) [mm]
    sense
        +1 where the angle grows with time, -1 where it falls.
    rim
        How far from the axis the surface is wanted; no nearer than the farthest tip. Outside, it is continued under
        the arc of the outermost tips if it has one tangent as far; otherwise it counts as ended, and an edge that would
        touch outside is lowered onto the rim. By default all of the surface counts. [mm]
    progress
        Called with (done, total).

    Raises
    ------
    DomainError
        If the edge touches where the surface is not defined.
    GougeError
        If no place on the edge can be found that touches, which a surface with infinite heights does, or one that is
        steeper than the flanks as far as the rim.
    """
    angle, radius = frozen(angle, "angle"), frozen(radius, "radius")
    tips = Tips(angle, radius, np.zeros(angle.size) if y is None else frozen(y, "y"))
    same_length([("angle", angle), ("radius", radius), ("y", tips.aside)])
    return touch_down(surface, tool.cutting_edge(sense), tips, rim, progress)


def tip_height(
    surface: Surface,
    tool: Tool,
    *,
    angle: ArrayLike,
    radius: ArrayLike,
    y: ArrayLike | None = None,
    sense: int,
    rim: float = np.inf,
    progress: Progress | None = None,
) -> Floats:
    """Return the commanded tip heights at which the edge touches the surface. (n,) [mm]. See `touch`."""
    return touch(surface, tool, angle=angle, radius=radius, y=y, sense=sense, rim=rim, progress=progress).z


def touch_down(surface: Surface, edge: Edge, tips: Tips, rim: float, progress: Progress | None = None) -> Touch:
    """Bring an edge down as `touch` does: by the one tangent, unless a point doubts that it is the only one."""
    tips = Tips(*(only_read(one) for one in tips))  # kernels are compiled for such
    contact = set_contact(surface, edge, tips, rim)
    out = Touch(*(np.empty(tips.angle.size) for _ in range(5)))
    limit = bend_limit(contact)
    doubtful = limit is None

    def work(start: int, stop: int) -> None:
        nonlocal doubtful
        part = slice(start, stop)
        if not doubtful and limit is not None and not find_tangents(contact, limit, tips.some(part), out.some(part)):
            doubtful = True

    if limit is not None:
        run_chunks(work, tips.angle.size, CHUNK, progress)
    if doubtful:
        search(contact, tips, out, progress)
    return out


def _clearance(part: Part, edge: Edge, tips: Tips, z: Floats) -> Floats:
    """Return the least height of the edge above the surface inside the rim, 0 at most, without a look at any contact.

    The tips are tried at places of their own all over the edge, flanks included: the golden ratio spreads them evenly
    over edge and path together, so that what a search has missed shows at some of the tips that miss it.
    """
    least = np.zeros(z.size)
    every = slice(None, None, max(1, z.size // PLACES))
    rim = max(part.radius, float(np.hypot(tips.radius, tips.aside).max()))
    tips = Tips(*(np.ascontiguousarray(one) for one in tips.some(every)))
    seen, tip_z = np.zeros(tips.angle.size), np.ascontiguousarray(z[every])
    # A flank is a straight line over the sweep too: this is what it takes to the far side of the rim.
    ends = np.array([edge.low, edge.high])
    low, high = 2 * rim / np.abs(edge.points(ends + np.array([-1.0, 1.0]))[0] - edge.points(ends)[0])
    times = int(np.clip(PLACES // seen.size, 1, MOST_PLACES))

    def work(start: int, stop: int) -> None:
        some = slice(start, stop)
        x, y, e = np.empty((3, stop - start))
        for k in range(times):
            kernel.spread(edge, *tips.some(some), start * times + k, times, low, high, x, y, e)
            with np.errstate(all="ignore"):
                height = part.surface.evaluate(x, y, 0)[0]
            inside = part.surface.inside(x, y)
            if inside is not None:
                height[~inside] = np.nan
            kernel.lower_to_gap(tip_z[some], e, height, x, y, AXIS, rim, seen[some])

    run_chunks(work, seen.size, CHUNK)
    least[every] = seen
    return least


def _z_rate(spiral: Spiral, part: Part, edge: Edge, tips: Tips, at: Touch) -> Floats | None:
    """Return the derivative of the tip's height by the angle, or ``None`` if the spiral does not state its own."""
    if spiral.radius_rate is None or (spiral.y is not None and spiral.y_rate is None):
        return None
    surface, outward = part.surface, spiral.radius_rate
    upward = np.zeros(outward.size) if spiral.y_rate is None else spiral.y_rate
    rim = max(part.radius, float(np.hypot(tips.radius, tips.aside).max()))
    rate = np.empty(outward.size)

    def work(start: int, stop: int) -> None:
        some = slice(start, stop)
        x, y = at.x[some], at.y[some]
        across, along = np.empty((2, 2, x.size))
        rise, tangent = np.empty(x.size), np.empty(x.size, dtype=np.bool_)
        with np.errstate(all="ignore"):
            slopes = surface.evaluate(x, y, 2)[1:]
        kernel.rates(
            edge, spiral.angle[some], x, y, at.sweep[some], *slopes, outward[some], upward[some], TANGENT,
            rate[some], across, along, rise, tangent,
        )  # fmt: skip
        if not tangent.all():
            rate[some][~tangent & (np.hypot(x, y) > rim * (1 - 1e-9))] = np.nan
        if not surface.in_pieces:
            return
        hair = BESIDE * along / np.hypot(*along)
        sides = [(x - hair[0], y - hair[1]), (x + hair[0], y + hair[1])]
        before, after = (surface.piece(*side) for side in sides)
        if before is not None and after is not None and (on := np.flatnonzero(before != after)).size:
            mixed, ridge = _on_ridge(part, [(side[0][on], side[1][on]) for side in sides], along[:, on], rise[on])
            rate[some][on[ridge]] = (mixed * across[:, on]).sum(axis=0)[ridge]

    run_chunks(work, rate.size, CHUNK)
    lost = np.flatnonzero(np.isnan(rate))
    if lost.size:
        aside, own = np.array([[-NEAR], [NEAR]]), tips.some(lost)
        moved = (own.angle + aside, own.radius + aside * outward[lost], own.aside + aside * upward[lost])
        z = touch_down(surface, edge, Tips(*(one.ravel() for one in moved)), rim).z
        rate[lost] = (z[lost.size :] - z[: lost.size]) / (2 * NEAR)
    return rate


def _on_ridge(part: Part, sides: list[tuple[Floats, Floats]], along: Floats, rise: Floats) -> tuple[Floats, Bools]:
    """Return the slopes (2, n) that an edge feels between two sides, nan on the lip of a step, and where it does so.

    In a valley it does not: there the contact stands beside it, on a slope of its own.
    """
    with np.errstate(all="ignore"):
        before, after = (np.stack(part.surface.evaluate(*side, 1)) for side in sides)
    low, high = ((side[1:] * along).sum(axis=0) for side in (after, before))
    ridge = high > low
    share = np.clip((rise - low) / np.where(ridge, high - low, 1.0), 0.0, 1.0)
    mixed = share * before[1:] + (1 - share) * after[1:]
    lip = np.abs(before[0] - after[0]) > STEP
    mixed[:, lip] = np.nan
    return mixed, ridge | lip


def _along_normal(spiral: Spiral, part: Part, edge: Edge, contacts: Tips, progress: Progress | None) -> Path:
    sweep, x, y, surface_z = tangents_through(part.surface, edge, contacts)
    u, _, e = edge.points(sweep)
    tips, z = contacts._replace(radius=contacts.radius - u), surface_z - e
    radius_rate, z_rate = _normal_rates(spiral, part, edge, sweep, x, y)
    at = touch_down(part.surface, edge, tips, part.radius, progress)
    return Path(
        angle=tips.angle, radius=tips.radius, z=z, sweep=sweep, contact_x=x, contact_y=y, contact_z=surface_z,
        clearance=z - at.z, y=spiral.y, y_rate=spiral.y_rate, radius_rate=radius_rate, z_rate=z_rate, lift=spiral.lift,
    )  # fmt: skip


def _normal_rates(
    spiral: Spiral, part: Part, edge: Edge, sweep: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats] | tuple[None, None]:
    """Return the derivatives of the tip's radius and height by the angle, if the spiral states its own."""
    if spiral.radius_rate is None or (spiral.y is not None and spiral.y_rate is None):
        return None, None
    upward = np.zeros(x.size) if spiral.y_rate is None else spiral.y_rate
    radius_rate, z_rate = np.empty((2, x.size))
    slopes = part.surface.evaluate(x, y, 2)[1:]
    rates = spiral.radius_rate, upward
    kernel.normal_rates(edge, spiral.angle, x, y, sweep, *slopes, *rates, radius_rate, z_rate)
    return radius_rate, z_rate
