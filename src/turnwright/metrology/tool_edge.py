r"""Nose radius, flanks and waviness of a diamond tool from a measured trace of its edge.

The trace is compared with the model of `turnwright.Tool`, an arc and two straight flanks tangent to its ends, with a
robust loss, so that dust and the broken ends of the trace have little effect; this separates the nose from the flanks.
Radius and waviness are then fitted to the nose alone.

Instruments trace a nose in strokes, one from each side, which on measured edges miss each other by micrometres. So the
circle has one radius, and a centre for each stroke.

Sources
-------
The uncertainty of the radius counts only as many points as are independent (A. Sokal, Monte Carlo methods, 1997).
Oracles: traces made from known edges; the algebraic circle of G. Taubin (IEEE PAMI 13, 1991) on a measured one.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen, robust_scatter, same_length
from turnwright._validate import check_angle, one_of, positive
from turnwright.errors import InputError
from turnwright.tool import Tool, WavinessTable

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import ArrayLike

MIN_POINTS = 50
"""Least number of points for the separation of arc and flanks."""

MAX_START_POINTS = 400
"""Points of a trace used to find the start of the fit."""

OUTLIER_SIGMA = 4.0
"""Robust standard deviations beyond which a point is dust."""

BLEND_RAD = np.deg2rad(2.0)
"""Part of the arc next to each flank that is left out, where grinding has blended the two."""

STROKE_JUMP_STEPS = 20.0
"""Backward jump, in median steps of the trace, that begins another stroke."""

MIN_ARC_HEIGHT_RATIO = 5.0
"""Least height of the arc, relative to the scatter, for its radius to be determined."""

POINTS_PER_CUTOFF = 8
"""Points of the waviness table in a cutoff wavelength."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeFit:
    """Result of the fit of an edge trace. See `fit_edge`.

    Parameters
    ----------
    tool
        The tool with its measured radius error and waviness, its tip at the lowest point of the fitted arc; of its
        included angle the shorter side counts.
    radius, radius_std
        Of the nose, and its standard uncertainty, without that of the instrument's scale. [mm]
    sweep
        Sweeps at which the arc ends and the flanks begin (lo, hi). [rad]
    tilt
        Angle from the tip to the bisector of the flanks, toward +X. [rad]
    centre
        Of the fitted arc in the trace's own (u, height), for each stroke. (strokes, 2) [mm]
    nose
        Points of the trace used for radius and waviness. (n,)
    residual_rms
        Of these points about the circle, waviness and noise together. [mm]
    noise_rms
        Of these points about the circle with its waviness. [mm]
    waviness_std
        Standard uncertainty of the waviness at each sweep of ``tool.waviness``. (m,) [mm]
    cutoff
        Wavelength along the edge of which the waviness keeps half of the height. [mm]
    """

    tool: Tool
    radius: float
    radius_std: float
    sweep: tuple[float, float]
    tilt: float
    centre: Floats
    nose: Bools
    residual_rms: float
    noise_rms: float
    waviness_std: Floats
    cutoff: float


def read_edge_trace(path: str | PathLike[str], *, profile: int | None = None) -> tuple[Floats, Floats]:
    """Read a trace of an edge as the Mitaka MLP point-autofocus instruments export it, or as two plain columns.

    Parameters
    ----------
    path
        Lines of description, a line ``X,Y,Z``, then rows of X along the trace and Y across the edge in mm; or only
        rows of these two, separated by blanks or commas.
    profile
        Number of the profile, from 1, if the file has several.

    Returns
    -------
    u, height
        Along the trace and across the edge. Each (n,) [mm]

    Raises
    ------
    InputError
        If the file cannot be read, is not of this form, or ``profile`` is needed to select one of several.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): check its name and folder") from error
    heads = [number for number, line in enumerate(lines) if line.replace(" ", "").upper() == "X,Y,Z"]
    head, body = (lines[: heads[0]], lines[heads[0] + 1 :]) if heads else ([], lines)
    body = _profile(path, head, body, profile)
    table = [line.replace(",", " ").split() for line in body if line.strip()]
    if not heads and any(len(row) != 2 for row in table):
        raise InputError(
            f"{path} has no line 'X,Y,Z' above its points, and not two columns: export the trace with its head"
        )
    try:
        rows = np.array([[float(cell) for cell in row[:2]] for row in table])
    except ValueError as error:
        raise InputError(f"{path} holds something that is not a number ({error}): correct it") from error
    if rows.ndim != 2 or rows.shape[1] != 2:
        raise InputError(f"{path} has {len(body)} rows, it needs rows of X,Y,Z or of two columns: export it again")
    return frozen(rows[:, 0], "trace X"), frozen(rows[:, 1], "trace Y")


def _profile(path: Path, head: list[str], body: list[str], profile: int | None) -> list[str]:
    profiles, size = 1, len(body)
    for line in head:
        cells = [cell.strip() for cell in line.split(",")]
        if cells[0] == "Number of points in Y direction" and cells[-1].isdigit():
            profiles = int(cells[-1])
        if cells[0] == "Number of data" and len(cells) == 3 and cells[1].isdigit() and cells[2].isdigit():
            size, profiles = int(cells[1]), int(cells[2])
    if profiles > 1 and (profile is None or size == len(body)):
        raise InputError(
            f"{path} holds {profiles} profiles, the limit is 1: give its number (profile=1, ...), or export one"
        )
    if profile is None:
        return body
    if not 1 <= profile <= profiles:
        raise InputError(f"{path} has no profile {profile}, it holds {profiles}: give one of these numbers, from 1")
    return body[(profile - 1) * size : profile * size]


def fit_edge(
    u: ArrayLike,
    height: ArrayLike,
    *,
    toward_x: int,
    cutoff: float,
    nose_radius: float | None = None,
    tilt: float = 0.0,
) -> EdgeFit:
    """Find the nose in a measured trace of an edge, and return the tool with its radius and waviness.

    Parameters
    ----------
    u, height
        Along the trace and across the edge, in the order of tracing. Each (n,) [mm]
    toward_x
        +1 if ``u`` grows toward the machine's +X when the tool is mounted, -1 if it falls.
    cutoff
        Wavelength along the edge of which the waviness keeps half the height: shorter ones are taken for noise. [mm]
    nose_radius
        Nominal radius of the tool; by default the measured one. [mm]
    tilt
        Turn of the mounted tool toward +X since it was traced; minus `EdgeFit.tilt` levels the flanks. [rad]

    Raises
    ------
    InputError
        If there are too few points, or they show no arc above their scatter.

    >>> tool = Tool(nose_radius=0.2, included=np.deg2rad(100), waviness=(0.0, 1e-4))
    >>> u, _, e = tool.edge(np.deg2rad(np.linspace(-60, 60, 2401)))   # flanks beyond the arc
    >>> fit = fit_edge(u, -e, toward_x=+1, cutoff=0.01)               # the edge points up
    >>> fit.tool.nose_radius == fit.radius, np.rad2deg(fit.sweep).round(0)
    (True, array([-50.,  50.]))
    """
    along, across = frozen(u, "trace u"), frozen(height, "trace height")
    same_length([("u", along), ("height", across)])
    if along.size < MIN_POINTS:
        raise InputError(f"a trace has {along.size} points, it needs at least {MIN_POINTS}: trace the edge more finely")
    one_of(toward_x, "toward_x", (1, -1))
    positive(cutoff, "cutoff", "mm")
    check_angle(tilt, "tilt", -np.pi / 4, np.pi / 4)

    # Along +X, and outward: the way the edge points, whichever of the two ways lets an arc fit better.
    a = toward_x * along
    fits = {sign: _fit_shape(a, sign * across) for sign in (1.0, -1.0)}
    sign = min(fits, key=lambda way: fits[way][1])
    b, shape = sign * across, fits[sign][0]
    radius, centre, stroke, nose = _fit_nose(a, b, shape, _strokes(along))
    sweep, off = _polar(a, b, radius, centre[stroke])
    low, high = _ends(sweep, off, shape)
    inside, scatter = sweep[nose], robust_scatter(off[nose])
    arc_height = radius * (1 - np.cos(np.ptp(inside) / 2)) if inside.size else 0.0
    if inside.size < MIN_POINTS or arc_height < MIN_ARC_HEIGHT_RATIO * scatter or min(-(low + tilt), high + tilt) <= 0:
        raise InputError(
            f"a trace of {along.size} points shows no arc: the best has {inside.size} points (at least {MIN_POINTS}) "
            f"and a height of {1e3 * arc_height:.3g} um, with a scatter of {1e3 * scatter:.3g} um (at least "
            f"{MIN_ARC_HEIGHT_RATIO:g} times the scatter): clean the tool and trace its nose again"
        )
    table, table_std = _smooth(inside + tilt, off[nose], cutoff / radius)
    nominal = radius if nose_radius is None else positive(nose_radius, "nose_radius", "mm")
    try:
        tool = Tool(
            nose_radius=nominal,
            radius_error=radius - nominal,
            included=2 * min(-(low + tilt), high + tilt, np.pi / 2),
            waviness=table,
        )
    except InputError as error:
        raise InputError(
            f"a trace of {along.size} points shows an arc of {radius:.4g} mm that is no possible nose ({error}): clean "
            "the tool and trace its nose again"
        ) from error
    return EdgeFit(
        tool=tool,
        radius=radius,
        radius_std=_radius_std(inside, off[nose], stroke[nose]),
        sweep=(low + tilt, high + tilt),
        tilt=0.5 * (low + high) + tilt,
        centre=frozen(centre * (toward_x, sign), "centre", ndim=2),
        nose=nose,
        residual_rms=float(np.sqrt(np.mean(off[nose] ** 2))),
        noise_rms=float(np.sqrt(np.mean((off[nose] - tool.deviation(inside + tilt)) ** 2))),
        waviness_std=frozen(table_std, "waviness_std"),
        cutoff=cutoff,
    )


def _polar(a: Floats, b: Floats, radius: float, centre: Floats) -> tuple[Floats, Floats]:
    """Return sweep [rad] and distance outside the circle [mm]; ``centre`` is one for all or one for each point."""
    across, out = a - centre[..., 0], b - centre[..., 1]
    return np.arctan2(across, out), np.hypot(across, out) - radius


def _strokes(along: Floats) -> Ints:
    """Return the number of the stroke of each point of the trace. (n,)."""
    steps = np.diff(along)
    steps = steps * np.sign(np.sum(np.sign(steps)) or 1.0)
    return np.concatenate([[0], np.cumsum(steps < -STROKE_JUMP_STEPS * np.median(np.abs(steps)))])


def _edge_distance(shape: Floats, a: Floats, b: Floats) -> Floats:
    """Return the signed distance from an arc with tangent flanks, positive outside. (n,) [mm]."""
    across, out = a - shape[0], b - shape[1]
    sweep = np.clip(np.arctan2(across, out), -shape[3], shape[4])
    return np.asarray(across * np.sin(sweep) + out * np.cos(sweep) - shape[2])


def _slopes_off_edge(shape: Floats, a: Floats, b: Floats) -> Floats:
    """Return the derivatives of `_off_edge` by the parameters. (n, 5)."""
    across, out = a - shape[0], b - shape[1]
    angle = np.arctan2(across, out)
    sweep = np.clip(angle, -shape[3], shape[4])
    sine, cosine = np.sin(sweep), np.cos(sweep)
    turn = across * cosine - out * sine  # 0 on the arc: its distance does not depend on where the flanks begin
    flanks = np.where(angle < -shape[3], -turn, 0), np.where(angle > shape[4], turn, 0)
    return np.stack([-sine, -cosine, np.full(a.size, -1.0), *flanks], axis=1)


def _fit_shape(a: Floats, b: Floats) -> tuple[Floats, float]:
    """Return the best arc with tangent flanks that points toward +b, and its cost.

    The arc is its centre along and across, its radius [mm], and the sweeps, as magnitudes, at which the flanks begin
    [rad]. (5,)
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - costly to import

    extent = max(np.ptp(a), np.ptp(b))
    top = a[np.argsort(b)[-max(a.size // 20, 5) :]]
    middle, peak = float(np.median(top)), float(np.quantile(b, 0.99))
    low = [-np.inf, -np.inf, 1e-4 * extent, 0.01, 0.01]
    high = [np.inf, np.inf, 100 * extent, np.pi / 2, np.pi / 2]

    def fit(start: Floats, few: int, scale: float) -> Any:
        return least_squares(
            _edge_distance, start, _slopes_off_edge, bounds=(low, high), loss="soft_l1", f_scale=scale,
            x_scale=[extent, extent, extent, 1.0, 1.0], args=(a[::few], b[::few]), max_nfev=200,
        )  # fmt: skip

    few = max(a.size // MAX_START_POINTS, 1)
    starts = [
        np.array([middle, peak - radius, radius, flank, flank])
        for radius, flank in product(extent * np.geomspace(0.03, 3, 7), np.deg2rad([30, 60]))
    ]
    best = min((fit(start, few, 0.01 * extent) for start in starts), key=lambda result: float(result.cost))
    shape = best.x
    for _ in range(3):  # from a loss as wide as the trace to one as narrow as its scatter
        scale = max(robust_scatter(_edge_distance(shape, a, b)), 1e-7 * extent)
        shape = fit(shape, 1, scale).x
    # Both ways are judged by one loss.
    return shape, float(np.minimum(np.abs(_edge_distance(shape, a, b)), 0.01 * extent).sum())


def _fit_nose(a: Floats, b: Floats, shape: Floats, strokes: Ints) -> tuple[float, Floats, Ints, Bools]:
    """Fit a circle to the nose alone, without flanks and dust.

    Return its radius [mm], its centre for each stroke (strokes, 2) [mm], and of each point its stroke and whether it
    belongs to the nose. (n,)
    """
    from scipy.optimize import least_squares  # noqa: PLC0415

    sweep, off = _polar(a, b, shape[2], shape[:2])
    arc = (sweep > BLEND_RAD - shape[3]) & (sweep < shape[4] - BLEND_RAD)
    # Strokes that hold too little of the arc are dust; numbers outside of the arc do not matter.
    strokes_used = np.flatnonzero(np.bincount(strokes[arc], minlength=1) >= MIN_POINTS)
    arc &= np.isin(strokes, strokes_used)
    stroke = np.clip(np.searchsorted(strokes_used, strokes), 0, max(strokes_used.size - 1, 0)).astype(np.int64)
    circle = np.concatenate([shape[2:3], np.tile(shape[:2], max(strokes_used.size, 1))])
    nose = np.zeros(a.size, dtype=np.bool_)

    def distance(circle: Floats, chosen: Bools) -> Floats:
        return _polar(a[chosen], b[chosen], circle[0], circle[1:].reshape(-1, 2)[stroke[chosen]])[1]

    everywhere = np.ones_like(nose)
    for _ in range(10):
        off = distance(circle, everywhere)
        scale = max(robust_scatter(off[arc]), 1e-9 * circle[0])
        last, nose = nose, arc & (np.abs(off) < OUTLIER_SIGMA * scale)
        if np.count_nonzero(nose) < MIN_POINTS or np.array_equal(last, nose):
            break
        circle = least_squares(distance, circle, loss="soft_l1", f_scale=scale, x_scale=circle[0], args=(nose,)).x
    return float(circle[0]), circle[1:].reshape(-1, 2), stroke, nose


def _ends(sweep: Floats, off: Floats, shape: Floats) -> tuple[float, float]:
    """Return where the arc ends: at the flanks, or with the trace if that shows none."""
    near = sweep[np.abs(off) < max(OUTLIER_SIGMA * robust_scatter(off), 0.01 * shape[2])]
    if not near.size:
        return -float(shape[3]), float(shape[4])
    return max(-float(shape[3]), float(near.min())), min(float(shape[4]), float(near.max()))


def _smooth(sweep: Floats, off: Floats, cutoff: float) -> tuple[WavinessTable, Floats]:
    """Return the deviation without wavelengths shorter than ``cutoff`` [rad], and its standard uncertainty [mm].

    A smoothing spline through points h apart passes 1 / (1 + lam h w^4) of a wave of angular frequency w.
    """
    from scipy.interpolate import make_smoothing_spline  # noqa: PLC0415

    step = cutoff / POINTS_PER_CUTOFF
    number = np.floor((sweep - sweep.min()) / step).astype(np.int64)
    count = np.bincount(number)
    filled = count > 0
    if np.count_nonzero(filled) < POINTS_PER_CUTOFF:
        raise InputError(
            f"the arc spans {np.rad2deg(np.ptp(sweep)):.3g} deg and the cutoff {np.rad2deg(cutoff):.3g} deg of it, at "
            "least one cutoff must fit: use a smaller cutoff"
        )
    at, height = (np.bincount(number, weights=values)[filled] / count[filled] for values in (sweep, off))

    def smoothed(values: Floats) -> Floats:
        return np.asarray(make_smoothing_spline(at, values, lam=(cutoff / (2 * np.pi)) ** 4 / step)(at))

    deviation = smoothed(height)
    residual = off - np.interp(sweep, at, deviation)
    # What each point of the table draws from every bin; bins this far apart share nothing, so one spline tells many.
    order, apart = np.arange(at.size), 8 * POINTS_PER_CUTOFF
    trace, variance = 0.0, np.zeros(at.size)
    for first in range(min(apart, at.size)):
        drawn = smoothed((order % apart == first).astype(np.float64))
        trace += drawn[first::apart].sum()
        nearest = np.clip(
            first + apart * np.round((order - first) / apart).astype(np.int64), first, order[first::apart][-1]
        )
        variance += drawn**2 / count[filled][nearest]
    together = _correlation_count(residual[np.argsort(sweep)])
    scatter = together * np.sum(residual**2) / max(residual.size - trace * together, 1.0)
    return WavinessTable(sweep=at, deviation=deviation), np.sqrt(variance * scatter)


def _correlation_count(values: Floats) -> float:
    """Return how many neighbouring values count as one, since they scatter in a correlated way."""
    centred = values - values.mean()
    correlation = np.correlate(centred, centred, "full")[values.size - 1 :] / max(float(centred @ centred), 1e-300)
    end = int(np.argmax(correlation <= 0)) or values.size
    return float(1 + 2 * correlation[1:end].sum())


def _radius_std(sweep: Floats, off: Floats, stroke: Ints) -> float:
    """Return the standard uncertainty of the radius of a circle fitted to points that scatter in a correlated way."""
    order = np.argsort(sweep)
    indicator = stroke[:, None] == np.arange(stroke.max() + 1)  # each stroke has its own centre
    slopes = np.column_stack(
        [np.ones(sweep.size), indicator * np.sin(sweep)[:, None], indicator * np.cos(sweep)[:, None]]
    )
    together = _correlation_count(off[order])
    variance = together * np.sum(off**2) / max(off.size - slopes.shape[1] * together, 1)
    return float(np.sqrt(variance * np.linalg.inv(slopes.T @ slopes)[0, 0]))
