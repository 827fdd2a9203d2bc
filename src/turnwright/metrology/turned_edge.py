r"""The edge that cut a turned surface, from its cusps.

Between two crests a single revolution has cut the surface, so a valley is a piece of the edge: over the distance
:math:`u = s\,(r - X_k)` from the tip in revolution k, with s the side of the axis,

.. math:: h(r) = Z_k + e(u + \delta_k), \qquad X_k = m_k - R \sin\arctan h'(m_k),

where :math:`m_k` is the middle between the crests, whose tangent says where on the nose of radius R the contact lies.
The edge e is one spline for all valleys; heights :math:`Z_k` and small shifts :math:`\delta_k` belong to each, for
revolutions scatter, and a wavy edge does not touch where its circle would. On a curved part the contact moves over the
nose, so that the valleys overlap and show more of the edge than one cusp.

An instrument rounds the crests and lifts what is near them. The surface cut by the estimated edge is therefore passed
through a model of the instrument, and the difference is added to the estimate until convergence (van Cittert).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import legendre

from turnwright._arrays import Bools, Floats, Ints, frozen, robust_scatter
from turnwright._validate import one_of, positive
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology.cusps import find_cusps, inflation, spikes
from turnwright.metrology.profile import line_profile
from turnwright.profile import Profile
from turnwright.tool import Tool, WavinessTable

if TYPE_CHECKING:
    from turnwright.instrument import Instrument
    from turnwright.metrology.cusps import Cusps
    from turnwright.surface import Surface

RADIAL_LINES = 24
"""Radial lines taken from a map."""

FORM_DEGREE = 6
"""Degree of the polynomial whose slope gives the contact point on the edge."""

MEAN_SIGMA = 0.6
"""Standard deviation of the Gaussian that leaves the waviness of the part, relative to the feed."""

TRIM_STEPS = 1.0
"""Least distance from a crest at which heights count without an instrument. [steps]"""

KNOTS_PER_CUTOFF = 4

DEFAULT_CUTOFF_STEPS = 2.0
"""Default cutoff, in steps or in resolutions of the instrument."""

MIN_VALLEYS = 4
"""Least number of valleys, and of valleys that show a point of the edge."""

SHIFT_SIGMA = 0.25
"""Standard deviation of the shift of a valley, relative to the feed: slopes of the edge itself move the contact."""

ITERATIONS = 8
"""Iterations of the weights and of the instrument model."""

HUBER_SIGMA = 3.0
"""Standard deviations at which the weight of a height begins to fall (Huber)."""

MIN_FINE_STEPS = 4
"""Least number of points of the modelled surface in a measured step."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnedEdge:
    """The edge that cut a surface. See `edge_from_cusps`.

    Parameters
    ----------
    tool
        The nominal tool with the waviness found; held constant beyond ``reach``.
    sweep, deviation, deviation_std
        Its waviness and its standard uncertainty, without that of the instrument's scales. Each (n,) [rad], [mm], [mm]
    reach
        Distances from the tip toward +X between which the edge has shown. [mm]
    radius, radius_std
        Of the circle of best fit over the reach; a narrow reach says little of it. [mm]
    residual_rms
        Of the measured heights about the edge. [mm]
    valleys
        Number of cuts between crests that were used.
    cutoff
        Wavelength along the edge of which the waviness keeps half of the height. [mm]
    """

    tool: Tool
    sweep: Floats
    deviation: Floats
    deviation_std: Floats
    reach: tuple[float, float]
    radius: float
    radius_std: float
    residual_rms: float
    valleys: int
    cutoff: float


class _Line(NamedTuple):
    """One profile across the cusps, with its form and on its own side of the axis."""

    profile: Profile  # distance from the axis where that is known
    form: Floats  # what was removed from it. (n,) [mm]
    cusps: Cusps
    slope: Floats  # of the part, without its cusps. (n,)


class _Valleys(NamedTuple):
    """All heights between crests, one row each."""

    line: Ints  # of which line
    point: Ints  # which point of it
    valley: Ints
    u: Floats  # distance from the tip toward +X [mm]
    inner: Bools  # whether it is further from both crests than the instrument resolves
    tip: Floats  # where along the line, of each valley. (k,) [mm]
    side: Floats  # +1 where u grows with the distance, else -1. (k,)
    ends: Floats  # crests before and after each valley. (k, 2) [mm]
    owner: Ints  # line of each valley. (k,)


def edge_from_cusps(
    measured: Profile | HeightMap,
    tool: Tool,
    *,
    axis: float | tuple[float, float] | None = None,
    removed: Surface | None = None,
    instrument: Instrument | None = None,
    feed: float | None = None,
    cutoff: float | None = None,
    toward_x: int = 1,
) -> TurnedEdge:
    """Reconstruct the edge that cut a turned surface from the valleys between its cusps.

    Parameters
    ----------
    measured
        A profile across the lay, or a map of a turned surface, of which radial lines are taken.
    tool
        The nominal tool: its radius places the contact, and is kept.
    axis
        Where the profile crosses the spindle axis [mm], or where that lies on the map (x, y) [mm]. A profile without it
        lies on one side; a map needs it.
    removed
        The form that the instrument has removed from the heights, as a surface of revolution about the axis; ``None``
        where the heights still have their form.
    instrument
        Instrument model; without it the rounding by the instrument is attributed to the edge.
    feed
        First guess, see `find_cusps`. [mm]
    cutoff
        Wavelength along the edge of which half is kept; by default twice the step, or the instrument's resolution. [mm]
    toward_x
        +1 if, without an axis, the distance grows toward the machine's +X, -1 if it falls.

    Raises
    ------
    InputError
        If there are too few valleys, a map has no axis, or the edge found is none that a tool can have.

    Sources
    -------
    Oracle: surfaces cut by a brute-force minimum over the passes of a known wavy edge.
    """
    one_of(toward_x, "toward_x", (1, -1))
    lines = _lines(measured, axis, removed, feed)
    finest = max(lines[0].profile.step, 0.0 if instrument is None else _resolution(instrument))
    cutoff = DEFAULT_CUTOFF_STEPS * finest if cutoff is None else positive(cutoff, "cutoff", "mm")
    # What is seen through an instrument is fitted up to the crests, but the edge is known where they do not blur it.
    trim = TRIM_STEPS * lines[0].profile.step if instrument is None else 0.0
    clear = trim if instrument is None else finest
    valleys = _valleys(lines, tool.nose_radius, (trim, clear), known=axis is not None, toward_x=toward_x)
    return _solve(lines, valleys, tool, instrument, cutoff)


def _resolution(instrument: Instrument) -> float:
    return max(instrument.pixel or 0.0, 1 / instrument.cutoff)


def _lines(
    measured: Profile | HeightMap, axis: float | tuple[float, float] | None, removed: Surface | None, feed: float | None
) -> list[_Line]:
    """Return the profiles across the cusps, their distances from the axis where it is known."""
    if isinstance(measured, Profile):
        if isinstance(axis, tuple):
            raise InputError(
                f"the axis of a profile is {axis}, it must be one distance: give where the profile crosses it"
            )
        at = measured.distance - (axis or 0.0)
        return [_line(replace(measured, distance=at), removed, feed, known=axis is not None)]
    if not isinstance(axis, tuple):
        raise InputError(f"the axis of a map is {axis!r}, it must be (x, y): give where the spindle axis lies on it")
    x, y = measured.points()
    reach = np.arctan2(y - axis[1], x - axis[0])
    low, high = (0.0, np.pi) if _holds(measured, axis) else (float(reach.min()), float(reach.max()))
    if high - low > np.pi:  # a patch across the branch of the angle
        reach = reach % (2 * np.pi)
        low, high = float(reach.min()), float(reach.max())
    lines = []
    for angle in low + (high - low) * (np.arange(RADIAL_LINES) + 0.5) / RADIAL_LINES:
        try:
            profile = line_profile(measured, axis, angle=float(angle), method="cubic")
            lines.append(_line(profile, removed, feed, known=True))
        except InputError:  # a line through a corner of the map shows too little
            continue
    if not lines:
        raise InputError(
            f"none of {RADIAL_LINES} lines through the axis at {axis} shows cusps: check the axis, or give the feed"
        )
    return lines


def _holds(heights: HeightMap, axis: tuple[float, float]) -> bool:
    if heights.x is None or heights.y is None:
        return True
    inside_x = heights.x[0] <= axis[0] <= heights.x[-1]
    return bool(inside_x and heights.y[0] <= axis[1] <= heights.y[-1])


def _line(profile: Profile, removed: Surface | None, feed: float | None, *, known: bool) -> _Line:
    from scipy import ndimage  # noqa: PLC0415 - costly to import

    cusps = find_cusps(profile, feed=feed, axis=0.0 if known else None)
    at = profile.distance
    form = np.zeros(at.size) if removed is None else removed.sag(at, np.zeros(at.size))
    valid = ~np.isnan(profile.z)
    valid[valid] = ~spikes(profile.z[valid])
    shape = legendre.Legendre.fit(at[valid], (profile.z + form)[valid], FORM_DEGREE)
    # The polynomial does not follow waviness; the mean of the cusps does.
    wavy = np.interp(at, at[valid], (profile.z + form)[valid] - shape(at[valid]))
    mean = ndimage.gaussian_filter1d(wavy, MEAN_SIGMA * cusps.feed / profile.step, mode="nearest")
    slope = shape.deriv()(at) + np.gradient(mean, at)
    return _Line(replace(profile, z=np.where(valid, profile.z, np.nan)), form, cusps, slope)


def _valleys(lines: list[_Line], radius: float, away: tuple[float, float], *, known: bool, toward_x: int) -> _Valleys:
    """Return the heights between crests, without those close to a crest."""
    trim, clear = away
    points: list[Ints] = []
    places: list[tuple[float, ...]] = []
    for owner, line in enumerate(lines):
        at, crest = line.profile.distance, line.cusps.crest
        for k in np.flatnonzero(np.diff(line.cusps.run) == 0):
            before, after = float(crest[k]), float(crest[k + 1])
            inside = np.flatnonzero((at > before + trim) & (at < after - trim) & ~np.isnan(line.profile.z))
            if inside.size < MIN_VALLEYS:
                continue
            middle = (before + after) / 2
            steep = float(np.interp(middle, at, line.slope))
            tip = middle - radius * np.sin(np.arctan(steep))
            points.append(inside)
            places.append((owner, tip, float(np.sign(middle)) if known else toward_x, before, after))
    if len(points) < MIN_VALLEYS:
        raise InputError(
            f"the profile shows {len(points)} valleys between crests, an edge needs {MIN_VALLEYS}: measure a longer one"
        )
    owners, tips, sides, before_all, after_all = np.array(places).T
    owner_of, point = owners.astype(np.int64), np.concatenate(points)
    valley = np.repeat(np.arange(len(points)), [one.size for one in points])
    line_of = owner_of[valley]
    at = np.concatenate([lines[owner].profile.distance[inside] for owner, inside in zip(owner_of, points, strict=True)])
    return _Valleys(
        line=line_of,
        point=point,
        valley=valley,
        u=sides[valley] * (at - tips[valley]),
        inner=np.minimum(at - before_all[valley], after_all[valley] - at) > clear,
        tip=tips,
        side=sides,
        ends=np.stack([before_all, after_all], axis=1),
        owner=owner_of,
    )


def _solve(
    lines: list[_Line], valleys: _Valleys, tool: Tool, instrument: Instrument | None, cutoff: float
) -> TurnedEdge:
    """Fit the edge, the heights and the shifts of the valleys, and what an instrument takes away."""
    radius = tool.nose_radius
    if np.abs(valleys.u).max() > 0.9 * radius:
        raise InputError(
            f"the valleys reach {np.abs(valleys.u).max():.4g} mm from the tip, the limit is 0.9 of the nose_radius, "
            f"{0.9 * radius:.4g} mm: check nose_radius, axis and removed form"
        )
    with_form = [line.profile.z + line.form for line in lines]
    measured = np.concatenate([with_form[n][valleys.point[valleys.line == n]] for n in range(len(lines))])
    feed = lines[0].cusps.feed
    knot = cutoff / KNOTS_PER_CUTOFF
    first = np.floor(valleys.u.min() / knot) - 1
    knots = knot * np.arange(first, np.ceil(valleys.u.max() / knot) + 2)
    circle = _circle(valleys.u, radius)
    penalty = _penalty(knots, valleys.u.size, cutoff)
    target, weight, noise = measured - circle, np.ones(measured.size), float(np.std(measured - circle))
    for _ in range(ITERATIONS):
        fit = _fit_valleys(valleys, knots, radius, target, weight, penalty, (noise / (SHIFT_SIGMA * feed)) ** 2)
        model = fit.at(valleys, knots, radius)
        seen = (
            model + circle if instrument is None else _measured_heights(lines, valleys, knots, fit, radius, instrument)
        )
        residual = measured - seen
        if instrument is not None:
            target = model + residual
        noise = max(robust_scatter(residual - np.median(residual)), 1e-12)
        weight = np.minimum(1.0, HUBER_SIGMA * noise / np.maximum(np.abs(residual), 1e-300))
    uncertainty = _uncertainty(valleys, knots, residual, fit)
    return _to_edge(tool, knots, fit, uncertainty, residual, valleys.tip.size, cutoff, feed)


class _Fit(NamedTuple):
    """Heights and shifts of the valleys, each (k,) [mm], and the edge over its circle at the knots (n,). [mm]."""

    height: Floats
    shift: Floats
    edge: Floats
    spread: Floats  # covariance of the edge over the variance of a height. (n, n)

    def at(self, valleys: _Valleys, knots: Floats, radius: float) -> Floats:
        """Return the heights over the nominal circle at all points."""
        of_valley = self.height[valleys.valley] + self.shift[valleys.valley] * valleys.u / radius
        return np.asarray(of_valley + np.interp(valleys.u, knots, self.edge))


def _fit_valleys(
    valleys: _Valleys, knots: Floats, radius: float, target: Floats, weight: Floats, penalty: Floats, ridge: float
) -> _Fit:
    """Fit edge, heights and shifts by least squares; those of each valley are eliminated first."""
    count, size, knot = valleys.tip.size, knots.size, knots[1] - knots[0]
    place = np.clip(((valleys.u - knots[0]) / knot).astype(np.int64), 0, size - 2)
    share = (valleys.u - knots[place]) / knot
    across = valleys.u / radius
    of_edge = penalty.copy()
    right = np.zeros(size)
    both: Floats = np.zeros((size, count, 2))
    for at, part in ((place, 1 - share), (place + 1, share)):
        for other, other_part in ((place, 1 - share), (place + 1, share)):
            np.add.at(of_edge, (at, other), weight * part * other_part)
        np.add.at(right, at, weight * part * target)
        np.add.at(both[..., 0], (at, valleys.valley), weight * part)
        np.add.at(both[..., 1], (at, valleys.valley), weight * part * across)
    sums = [
        np.bincount(valleys.valley, weights=weight * column, minlength=count)
        for column in (np.ones(across.size), across, across * across, target, across * target)
    ]
    blocks = np.array([[sums[0], sums[1]], [sums[1], sums[2] + ridge]]).transpose(2, 0, 1)
    own_right = np.stack(sums[3:], axis=1)
    inverse = np.linalg.inv(blocks)
    reduced = np.einsum("nki,kij->nkj", both, inverse).reshape(size, -1)
    spread = np.linalg.inv(of_edge - reduced @ both.reshape(size, -1).T)
    edge = spread @ (right - reduced @ own_right.ravel())
    solved = np.einsum("kij,kj->ki", inverse, own_right - np.einsum("nki,n->ki", both, edge))
    return _Fit(height=solved[:, 0], shift=solved[:, 1], edge=edge, spread=spread)


def _penalty(knots: Floats, points: int, cutoff: float) -> Floats:
    """Return the penalty of the edge: a wave of the cutoff keeps half; height and tilt are those of the tool."""
    size, knot = knots.size, knots[1] - knots[0]
    stiff = points / size / (2 * np.sin(np.pi * knot / cutoff)) ** 4
    second = np.diff(np.eye(size), 2, axis=0)
    tilt = knots / np.abs(knots).max()
    return np.asarray(stiff * second.T @ second + np.ones((size, size)) + np.outer(tilt, tilt))


def _circle(u: Floats, radius: float) -> Floats:
    """Return how high the nose stands above its tip. [mm]."""
    return np.asarray(radius - np.sqrt(radius * radius - u * u))


def _measured_heights(
    lines: list[_Line], valleys: _Valleys, knots: Floats, found: _Fit, radius: float, instrument: Instrument
) -> Floats:
    """Return the heights that the estimate would have as measured: the lowest pass, seen through the instrument."""
    out = np.empty(valleys.u.size)
    for n, line in enumerate(lines):
        at = line.profile.distance
        step = line.profile.step
        many = max(MIN_FINE_STEPS, int(np.ceil(2.5 * step / _resolution(instrument))))
        fine = at[0] + step / many * np.arange(many * (at.size - 1) + 1)
        valid = ~np.isnan(line.profile.z)
        heights = np.interp(fine, at[valid], line.profile.z[valid])
        form = np.interp(fine, at, line.form)
        lowest = np.full(fine.size, np.inf)
        inside = np.zeros(fine.size, dtype=bool)
        for k in np.flatnonzero(valleys.owner == n):
            before, after = valleys.ends[k]
            near = slice(*np.searchsorted(fine, (1.5 * before - 0.5 * after, 1.5 * after - 0.5 * before)))
            u = valleys.side[k] * (fine[near] - valleys.tip[k])
            edge = _circle(np.clip(u, -radius, radius), radius) + np.interp(u, knots, found.edge)
            model = found.height[k] + edge + found.shift[k] * u / radius
            lowest[near] = np.minimum(lowest[near], model)
            inside[slice(*np.searchsorted(fine, (before, after)))] = True
        surface = np.where(inside, lowest - form, heights)
        profile = Profile(distance=fine, z=surface, x=fine, y=np.zeros(fine.size))
        chosen = valleys.line == n
        seen = instrument.see(profile).z[::many]
        out[chosen] = (seen + line.form)[valleys.point[chosen]]
    return out


def _uncertainty(valleys: _Valleys, knots: Floats, residual: Floats, fit: _Fit) -> tuple[Floats, Bools]:
    """Return the covariance of the edge, and at which knots enough valleys show it.

    Residuals of one valley hang together, those of different valleys do not: so their means at a knot count. Heights
    and tilts of valleys that overlap in part leave waves longer than one more uncertain, by the covariance of the fit.
    """
    knot = knots[1] - knots[0]
    std, seen = np.full(knots.size, np.nan), np.zeros(knots.size, dtype=bool)
    place = np.rint((valleys.u - knots[0]) / knot).astype(np.int64)
    for k in range(knots.size):
        near = (np.abs(place - k) <= 1) & valleys.inner
        count = np.bincount(valleys.valley[near], minlength=valleys.tip.size)
        total = np.bincount(valleys.valley[near], weights=residual[near], minlength=valleys.tip.size)
        means = total[count > 0] / count[count > 0]
        if means.size >= MIN_VALLEYS:
            seen[k] = True
            std[k] = means.std(ddof=1) / np.sqrt(means.size)
    covariance = _correlated_variance(valleys, residual) * fit.spread
    covariance[seen, seen] += std[seen] ** 2
    return covariance, seen


def _correlated_variance(valleys: _Valleys, residual: Floats) -> float:
    """Return the variance of a height times how many neighbours in a valley share their error. [mm²]."""
    same = np.diff(valleys.valley) == 0
    variance = robust_scatter(residual - np.median(residual)) ** 2
    clipped = np.clip(residual, -HUBER_SIGMA * np.sqrt(variance), HUBER_SIGMA * np.sqrt(variance))
    square = float(np.mean(clipped**2)) * np.count_nonzero(same)
    return variance * inflation(clipped[1:][same], clipped[:-1][same], square)


def _radius_bias(u: Floats, edge: Floats, radius: float, feed: float) -> float:
    r"""Return how far the radius is off because the nominal circle places the valleys. [mm].

    Where the edge is :math:`c` more curved than its circle it touches over :math:`1 / (1 + R c)` of the width, so the
    mean of the curvature over what it shows counts :math:`1 + R c` times too little: :math:`R^2 c^2` in the mean.
    """
    half = feed / 4
    inside = (u > u[0] + 2 * half) & (u < u[-1] - 2 * half)
    if not inside.any():
        return 0.0
    at = u[inside]
    second = np.interp(at + 2 * half, u, edge) - 2 * edge[inside] + np.interp(at - 2 * half, u, edge)
    return float(radius * np.mean((radius * second / (2 * half) ** 2) ** 2))


def _to_edge(
    tool: Tool, knots: Floats, fit: _Fit, known: tuple[Floats, Bools], residual: Floats, count: int, cutoff: float,
    feed: float,
) -> TurnedEdge:  # fmt: skip
    """Return the edge as waviness of the nose, without what is a height or a shift of the tool."""
    covariance, seen = known
    if np.count_nonzero(seen) < MIN_VALLEYS:
        raise InputError(
            f"{np.count_nonzero(seen)} points of the edge appear in {MIN_VALLEYS} valleys or more, at least "
            f"{MIN_VALLEYS} points are needed: measure a longer profile"
        )
    radius = tool.nose_radius
    u, height, covariance = knots[seen], fit.edge[seen], covariance[np.ix_(seen, seen)]
    # Height, shift and radius of the circle of best fit.
    columns = np.column_stack([np.ones(u.size), u / radius, 1 - 1 / np.sqrt(1 - (u / radius) ** 2)])
    # Height and tilt are no waviness, so their uncertainty is not one of it.
    bare = np.eye(u.size) - columns[:, :2] @ np.linalg.pinv(columns[:, :2])
    std = np.sqrt(np.diag(bare @ covariance @ bare.T))
    weight = 1 / np.maximum(std, np.median(std))
    held = np.linalg.lstsq(columns[:, :2] * weight[:, None], height * weight, rcond=None)[0]
    best = np.linalg.lstsq(columns * weight[:, None], height * weight, rcond=None)[0]
    off = height - columns @ best
    of_circle = np.linalg.pinv((columns * weight[:, None]).T @ (columns * weight[:, None]))
    # The waves of the edge itself make its circle uncertain, and neighbouring knots hang together over a cutoff.
    excess = max(1.0, float(np.mean((off * weight) ** 2))) * KNOTS_PER_CUTOFF
    radius_std = float(np.sqrt(of_circle[2, 2] * excess))
    # How the edge bends over all valleys is known as well as the radius, beyond what shows at one place.
    bend = columns[:, 2] - columns[:, :2] @ np.linalg.lstsq(columns[:, :2], columns[:, 2], rcond=None)[0]
    radius_std = float(np.hypot(radius_std, _radius_bias(knots[seen], fit.edge[seen], radius, feed)))
    std = np.hypot(std, bend * radius_std)
    height = height - columns[:, :2] @ held
    above = np.sqrt(radius * radius - u * u) - height
    sweep, deviation = np.arctan2(u, above), np.hypot(u, above) - radius
    low, high = tool.arc
    chosen = (sweep > low) & (sweep < high)
    try:
        table = WavinessTable(sweep=sweep[chosen], deviation=deviation[chosen])
        compensated = replace(tool, waviness=table)
    except InputError as error:
        raise InputError(
            f"{count} valleys give an impossible edge ({error}): check nose_radius, axis and removed form"
        ) from error
    return TurnedEdge(
        tool=compensated,
        sweep=frozen(sweep[chosen], "sweep"),
        deviation=frozen(deviation[chosen], "deviation"),
        deviation_std=frozen(std[chosen], "deviation_std"),
        reach=(float(u[chosen][0]), float(u[chosen][-1])),
        radius=radius + float(best[2]),
        radius_std=radius_std,
        residual_rms=float(np.sqrt(np.mean(residual**2))),
        valleys=count,
        cutoff=cutoff,
    )
