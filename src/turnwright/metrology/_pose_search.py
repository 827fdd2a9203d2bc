"""Where a map may lie on a part: level it, correlate it with a table of the design, and keep every peak."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright.metrology._rigid import Fit, Problem, fit, residuals, rows, turns
from turnwright.progress import run_chunks
from turnwright.surface import LensArray, Placed, Sum, Surface

__all__ = ["Lattice", "lattice_of", "mostly_on_part", "search"]

LARGEST_TABLE = 1500
PEAKS = 12
"""How many places of the correlation are refined; with a full turn of clocking twice as many."""

FOLDS = (2, 3, 4, 5, 6, 8, 12)
"""Symmetries about the axis that parts have."""

QUIET = 1e-6
"""Misfit below which nothing is poor. [mm]."""

WRONG = 5e-3
"""Residual rms beyond which something else than the part may have been measured too. [mm]."""

SURE = 4
"""So many are refined, however poor they are beside the best."""

POOR = 4.0
"""Mean square over the best one's at which a place is not refined."""

MOST_LOOKUPS = 50_000_000
"""Points times places of a correlation; beyond it points are left out."""

MOST_REPEATS = 60
PLACES_AT_A_TIME = 64
COVER = 0.95
"""Share of the points that a place must explain, of those that others explain as well."""

LEAST = 0.5
"""Share of the points that must lie on the part, of those that can."""


class _Tabled(NamedTuple):
    """Levelled points (3, n), and the square table of the part that they are laid on. [mm]."""

    points: Floats
    start: Floats  # the state that levelled them
    table: Floats
    low: float
    step: float


class Lattice(NamedTuple):
    """What repeats on a surface: two steps of its pattern in the part frame (2, 2), and how fine it is. [mm]."""

    steps: Floats | None
    fine: float


def lattice_of(surface: Surface) -> Lattice:
    """Return the pattern of lenses of a surface; no steps where there is none or where it does not repeat."""
    turn, inner = 0.0, surface
    while isinstance(inner, Placed):
        turn, inner = turn + inner.rotation, inner.surface
    if isinstance(inner, Sum):
        found = [lattice_of(term) for term in inner.terms]
        fine = min(one.fine for one in found)
        patterns = [one for one in found if one.steps is not None]
        steps = patterns[0].steps if len(patterns) == 1 else None
    elif isinstance(inner, LensArray):
        fine = 2 * inner.feature_size if inner.aperture is None else min(2 * inner.feature_size, inner.aperture / 2)
        steps = _repeat(inner.centres)
    else:
        return Lattice(None, inner.feature_size)
    if steps is not None:
        c, s = np.cos(turn), np.sin(turn)
        steps = steps @ np.array([[c, s], [-s, c]])
    return Lattice(steps, fine)


def _repeat(centres: Floats) -> Floats | None:
    """Return the two shortest shifts that bring most centres onto others. (2, 2), or None."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - scipy is costly to import

    if centres.shape[0] < 4:
        return None
    tree = cKDTree(centres)
    middle = int(np.argmin(np.hypot(*(centres - centres.mean(axis=0)).T)))
    shifts = centres[tree.query(centres[middle], k=min(25, centres.shape[0]))[1]] - centres[middle]
    kept: list[Floats] = []
    for shift in shifts[1:]:
        length = np.hypot(*shift)
        if kept and abs(kept[0][0] * shift[1] - kept[0][1] * shift[0]) < 0.3 * length * np.hypot(*kept[0]):
            continue
        meets = np.asarray(tree.query(centres + shift)[0]) < 1e-6 * length
        # What runs over the edge of a round array meets nothing.
        if meets.mean() > 0.4:
            kept.append(shift)
        if len(kept) == 2:
            return np.array(kept)
    return None


def axisymmetric(surface: Surface, radius: float) -> bool:
    """Say whether a surface is the same at every clocking."""
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    rings = radius * np.array([0.13, 0.37, 0.61, 0.83, 0.997])[:, None]
    x, y = rings * np.cos(angle), rings * np.sin(angle)
    (z,) = surface.evaluate(np.ascontiguousarray(x), np.ascontiguousarray(y), 0)
    return bool(np.nanmax(np.ptp(z, axis=1)) < 1e-12 * max(1.0, float(np.nanmax(np.abs(z)))))


def search(problem: Problem, state: Floats, free: list[int], size: Floats, reach: float, clocking: float) -> list[Fit]:
    """Return fits to the problem's (few) points from every place where the correlation peaks, the best first.

    Parameters
    ----------
    state
        The start (6 + terms,); lateral places up to ``reach`` mm and turns up to ``clocking`` rad from it count.
    """
    pattern = lattice_of(problem.surface)
    start = level(problem, state, free, size)
    lateral = [k for k in (0, 1, 3) if k in free]
    if not lateral or (reach == 0 and clocking == 0):
        return [fit(problem, start, free, size, close=1e-9)]
    points = _levelled(problem, start)
    if points is None:
        return [fit(problem, start, free, size, close=1e-9)]
    a = min(1 / size[3], problem.within)
    step = min(pattern.fine / 2 if np.isfinite(pattern.fine) else np.inf, a / 5)
    if axisymmetric(problem.surface, problem.within) or 3 not in free:
        clocking = 0.0
    tabled = _Tabled(points, start, *_table(problem.surface, problem.within, step))
    turn_step = min(step / a * 1.5, 0.35)
    angles = _turns(clocking, turn_step)
    along = [_axis(reach, step) if k in free else np.zeros(1) for k in (0, 1)]
    cell: Floats
    if pattern.steps is not None and 0 in free and 1 in free:
        count = np.maximum(np.ceil(np.hypot(*pattern.steps.T) / step), 2)
        u, v = np.meshgrid(np.arange(count[0]) / count[0], np.arange(count[1]) / count[1])
        cell = np.stack([u.ravel() - 0.5, v.ravel() - 0.5], axis=-1) @ pattern.steps
        if cell.shape[0] > along[0].size * along[1].size:
            pattern = Lattice(None, pattern.fine)
    if pattern.steps is None or 0 not in free or 1 not in free:
        x, y = np.meshgrid(*along)
        cell = np.stack([x.ravel(), y.ravel()], axis=-1)
    places = np.concatenate([np.repeat(cell, angles.size, axis=0), np.tile(angles, cell.shape[0])[:, None]], axis=1)
    thin = max(points.shape[1] * places.shape[0] // MOST_LOOKUPS, 1)
    score = _scores(tabled, places + np.array([start[0], start[1], 0.0]), thin=thin)
    peaks = _peaks(places, score, 1.6 * step, 1.6 * turn_step, PEAKS * (2 if clocking > 0.5 else 1))
    peaks.append((np.zeros(3), np.inf))  # the start itself
    fits = [one for place, _ in peaks if (one := _refined(problem, start, place, free, size)) is not None]
    if fits and min(one.rms for one in fits) > WRONG:
        calm = (_refined(problem, start, place, free, size, calm=True) for place, _ in peaks)
        fits += [one for one in calm if one is not None]
    if pattern.steps is not None and fits:
        fits += _repeats(problem, fits, pattern.steps, state, reach, free, size, tabled, peaks[0][1])
    if fits:
        fits += _twins(problem, min(fits, key=lambda one: one.cost), state, free, size, clocking)
    fits = _covering(sorted(fits, key=lambda one: one.cost))
    near = [one for one in fits if np.abs(one.state[:2] - state[:2]).max() <= reach + step / 2]
    return near if near and near[0].cost <= POOR * fits[0].cost + QUIET**2 else fits


def _twins(problem: Problem, best: Fit, state: Floats, free: list[int], size: Floats, clocking: float) -> list[Fit]:
    """Return fits where a symmetry of the part has them.

    A turn about the part's axis turns the place of the pivot and adds to the rotation, which is the last of the angles.
    """
    found: list[Fit] = []
    if clocking > 0:
        turns_tried = {round(2 * np.pi * k / n, 12) for n in FOLDS for k in range(1, n)}
        for turn in sorted(turns_tried):
            twin = best.state.copy()
            c, s = np.cos(turn), np.sin(turn)
            twin[:2] = c * twin[0] - s * twin[1], s * twin[0] + c * twin[1]
            twin[3] = state[3] + (twin[3] + turn - state[3] + np.pi) % (2 * np.pi) - np.pi
            if abs(twin[3] - state[3]) > clocking:
                continue
            left = residuals(problem, twin)
            left = left[np.isfinite(left)]
            if left.size > LEAST * best.used and np.median(left * left) < POOR * best.cost + QUIET**2:
                found.append(fit(problem, twin, free, size, steps=25, close=1e-9))
    return found


def mostly_on_part(fits: list[Fit]) -> list[Fit]:
    """Return the fits that bring at least half of the points to the part that any of them brings there.

    The fewer points lie on the part, the better they fit, so a poor map would else slide off it.
    """
    most = max((one.used for one in fits), default=0)
    return [one for one in fits if one.used >= LEAST * most]


def _covering(fits: list[Fit]) -> list[Fit]:
    """Return the fits that leave no more of the map beyond the part than others that fit as well."""
    fits = mostly_on_part(fits)
    good = [one for one in fits if one.cost <= POOR * fits[0].cost + QUIET**2]
    most = max((one.used for one in good), default=0)
    return [one for one in fits if one.used >= COVER * most]


def level(problem: Problem, state: Floats, free: list[int], size: Floats) -> Floats:
    """Return the state with height and tilts fitted, whatever the lateral place is."""
    state = state.copy()
    tilts = [k for k in (2, 4, 5) if k in free]
    if not tilts:
        return state
    calm = replace(problem, terms=(), normal=False, loss="huber")
    left = residuals(calm, state[:6])
    left = left[np.isfinite(left)]
    if 2 in free and left.size:
        state[2] -= float(np.median(left))
    found = fit(calm, state[:6], tilts, size, steps=12, close=1e-6)
    state[:6] = found.state
    return state


def _levelled(problem: Problem, state: Floats) -> Floats | None:
    """Return the points (3, n) as the state turns them, about the pivot, without gross outliers."""
    found = rows(problem, state, slice(0, problem.points.shape[1]))
    if found.which.size < 10:
        return None
    limit = 4 * np.quantile(np.abs(found.residual), 0.95) + 1e-9
    bad = found.which[np.abs(found.residual) > limit]
    arm = turns(state)[0] @ problem.points
    arm[2] += state[2]
    return np.ascontiguousarray(np.delete(arm, bad, axis=1))


def _axis(reach: float, step: float) -> Floats:
    """Return places from -reach to reach no farther apart than the step."""
    half = int(np.ceil(reach / step))
    return np.linspace(-reach, reach, 2 * half + 1) if half else np.zeros(1)


def _turns(clocking: float, step: float) -> Floats:
    """Return turns from -clocking to clocking no farther apart than the step; a full turn closes on itself."""
    if clocking < np.pi * (1 - 1e-9):
        return _axis(clocking, step)
    return np.linspace(-np.pi, np.pi, int(np.ceil(2 * np.pi / step)), endpoint=False)


def _table(surface: Surface, within: float, step: float) -> tuple[Floats, float, float]:
    """Tabulate the surface over the part, nan outside; return its lower corner and its step too."""
    count = int(min(max(2 * within / (step / 4), 64), LARGEST_TABLE))
    axis = np.linspace(-within, within, count)
    x, y = np.meshgrid(axis, axis)
    table = np.full(x.shape, np.nan)
    there = x * x + y * y <= (within * (1 + 2 / count)) ** 2
    inside = surface.inside(x, y)
    if inside is not None:
        there &= inside
    table[there] = surface.evaluate(x[there], y[there], 0)[0]
    return table, -within, float(axis[1] - axis[0])


def _scores(tabled: _Tabled, places: Floats, *, thin: int = 1, share: float = LEAST) -> Floats:
    """Return the misfit at each place, inf where too few points lie on the part. (m,)."""
    from turnwright._kernels.registration import misfit  # noqa: PLC0415 - numba is costly to import

    x, y, z = (np.ascontiguousarray(row[::thin]) for row in tabled.points)
    places = np.ascontiguousarray(places)
    out = np.empty((2, places.shape[0]))

    def work(start: int, stop: int) -> None:
        part = np.empty((2, stop - start))
        misfit(x, y, z, places[start:stop], tabled.table, tabled.low, tabled.step, part)
        out[:, start:stop] = part

    run_chunks(work, places.shape[0], PLACES_AT_A_TIME)
    most = max(out[0].max(), 1.0)
    # A flat valley is the same everywhere: there the more of the map lies on the part, the better.
    return np.where(out[0] >= share * most, out[1] * (most / np.maximum(out[0], 1)) ** 2, np.inf)


def _peaks(places: Floats, score: Floats, apart: float, turn_apart: float, most: int) -> list[tuple[Floats, float]]:
    """Return the best places that are not on the flank of a better one, with their scores."""
    kept: list[tuple[Floats, float]] = []
    left = np.isfinite(score)
    order = np.argsort(score)
    places, left, score = places[order], left[order], score[order]
    while left.any() and len(kept) < most:
        first = int(np.argmax(left))
        if len(kept) >= SURE and score[first] > POOR * score[0]:
            break
        best = places[first]
        kept.append((best, float(score[first])))
        turn = np.abs((places[:, 2] - best[2] + np.pi) % (2 * np.pi) - np.pi)
        left &= (np.hypot(places[:, 0] - best[0], places[:, 1] - best[1]) > apart) | (turn > turn_apart)
    return kept


def _refined(
    problem: Problem, start: Floats, place: Floats, free: list[int], size: Floats, *, calm: bool = False
) -> Fit | None:
    """Fit from a place of the correlation: turned and shifted as it says, levelled, then all at once.

    Calm, by Tukey's loss first: what is no part of the part, such as a flange beyond its rim, then does not pull.
    """
    state = start.copy()
    state[:2] += place[:2]
    state[3] += place[2]
    tilts = [k for k in (2, 4, 5) if k in free]
    pose = [k for k in free if k < 6]
    state = fit(problem, state, tilts, size, steps=1).state if not calm else level(problem, state, free, size)
    if calm:
        state = fit(replace(problem, loss="tukey"), state, pose, size, steps=25, close=1e-7).state
    found = fit(problem, state, pose, size, steps=25, close=1e-7)
    if len(pose) < len(free):
        # Where a term and a turn pass for each other the pose alone goes half-way to a twin.
        both = [fit(problem, one, free, size, steps=25, close=1e-9) for one in (found.state, state)]
        found = min(both, key=lambda one: one.cost)
    return found if found.used > 0 else None


def _repeats(
    problem: Problem,
    fits: list[Fit],
    steps: Floats,
    state: Floats,
    reach: float,
    free: list[int],
    size: Floats,
    tabled: _Tabled,
    lowest: float,
) -> list[Fit]:
    """Return fits from every repeat of the pattern within reach of the best that was found."""
    start = tabled.start
    base = min(fits, key=lambda one: one.cost)
    most = int(np.ceil((2 * reach) / np.sqrt(abs(np.linalg.det(steps))))) + 1
    i, j = np.meshgrid(np.arange(-most, most + 1), np.arange(-most, most + 1))
    at = base.state[:2] + np.stack([i.ravel(), j.ravel()], axis=-1) @ steps
    at = at[np.abs(at - state[:2]).max(axis=1) <= reach + np.hypot(*steps.T).min() / 2]
    places = np.concatenate([at, np.full((at.shape[0], 1), base.state[3] - start[3])], axis=1)
    if not places.size:
        return []
    score = _scores(tabled, places, share=COVER)
    most_score = POOR * min(lowest, float(score.min()))
    order = [int(k) for k in np.argsort(score)[:MOST_REPEATS] if score[k] <= most_score]
    refined = [_refined(problem, start, places[k] - np.array([start[0], start[1], 0.0]), free, size) for k in order]
    return [one for one in refined if one is not None]
