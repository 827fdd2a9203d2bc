"""Global search for the pose of a map on a part: a grid of positions on a tabulated design, then descents."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright._kernels.registration import misfit, settle
from turnwright.errors import InputError
from turnwright.metrology.rigid import (
    Fit,
    Problem,
    fit,
    place_pivot,
    residuals,
    rotation_about,
    rows,
    turns,
    wrap_angle,
)
from turnwright.outlined import Bounded
from turnwright.progress import run_chunks
from turnwright.surface import LensArray, Placed, Sum, Surface
from turnwright.units import say_length

MIN_TABLE_SIZE, MAX_TABLE_SIZE = 256, 1000

STEP_IN_FEATURES = 1.0
"""Step of the search relative to the feature size of the surface, which is an eighth of a wave."""

MIN_STEPS_ON_RADIUS = 5

MAX_STARTS = 60
"""Positions from which a descent starts; twice as many for a search over all clockings."""

MAX_REFINED = 8
"""Minima that are refined on the exact surface."""

MAX_ROBUST_STEPS = 8
"""Steps with Tukey's loss, which only finds the start of the least-squares fit."""

MAX_DESCENT_STEPS = 40

LEVELLING_PASSES = 2
"""Levelling passes at each position; the first removes the tilt that goes with the position."""

MIN_POINTS = 150
"""Least number of points by which a position is judged."""

ROTATIONAL_FOLDS = (2, 3, 4, 5, 6, 8, 12)
"""Rotational symmetries that are tried."""

MIN_MISFIT_MM = 1e-6
"""Misfit below which no position is rejected."""

ROBUST_MEDIANS = 4.0
"""Width of the robust loss, in median residuals; points off the part then do not pull."""

MAX_COST_RATIO = 4.0
"""Mean square relative to the best one beyond which a position is not refined."""

MAX_LOOKUPS = 30_000_000
"""Points times positions of the search; beyond it points are skipped, down to `MIN_POINTS`."""

MAX_PLACES = 4_000_000
"""Positions of the search: a minute on two cores and 0.5 GB. A map that needs more is refused."""

MAX_REPEATS = 60
CHUNK_PLACES = 64
MIN_COVER_SHARE = 0.95
"""Least number of points on the part, relative to the best pose."""

MIN_ON_PART_SHARE = 0.5
"""Share of the points that must lie on the part, of those that can."""

TRUNCATION_MEDIANS = 7.5
"""Median residuals (five standard deviations) at which the cost of a point is capped; off the part it is the same."""

RIM_TOL = 0.01
"""Distance beyond the rim, relative to the radius, at which a point still costs nothing."""


class _TabledProblem(NamedTuple):
    """Levelled points (3, n), and the square table of the part that they are laid on. [mm]."""

    points: Floats
    start: Floats  # the state that levelled them
    table: Floats
    low: float
    step: float
    moves: Bools  # which of shift (x, y, z) and turns about x, y, z may move


class _Marks(NamedTuple):
    """Evenly spaced places along an axis, or turns, that may be too many to lay out. [mm or rad]."""

    begin: float
    number: float  # of them, a whole one
    pitch: float

    @property
    def at(self) -> Floats:
        return np.asarray(self.begin + self.pitch * np.arange(self.number))


class Lattice(NamedTuple):
    """Periodic pattern of a surface: two lattice vectors in the part frame (2, 2), and its feature size. [mm]."""

    steps: Floats | None
    fine: float


def lattice_of(surface: Surface) -> Lattice:
    """Return the pattern of lenses of a surface; no steps where there is none or where it does not repeat."""
    turn, inner = 0.0, surface
    while isinstance(inner, Placed):
        turn, inner = turn + inner.rotation, inner.surface
    if isinstance(inner, Sum):
        lattices = [lattice_of(term) for term in inner.terms]
        fine = min(one.fine for one in lattices)
        patterns = [one for one in lattices if one.steps is not None]
        steps = patterns[0].steps if len(patterns) == 1 else None
    elif isinstance(inner, LensArray):
        fine = inner.feature_size if inner.aperture is None else min(inner.feature_size, inner.aperture / 4)
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
    steps: list[Floats] = []
    for shift in shifts[1:]:
        length = np.hypot(*shift)
        if steps and abs(steps[0][0] * shift[1] - steps[0][1] * shift[0]) < 0.3 * length * np.hypot(*steps[0]):
            continue
        meets = np.asarray(tree.query(centres + shift)[0]) < 1e-6 * length
        # What runs over the edge of a round array meets nothing.
        if meets.mean() > 0.4:
            steps.append(shift)
        if len(steps) == 2:
            return np.array(steps)
    return None


def axisymmetric(surface: Surface, radius: float) -> bool:
    """Return whether a surface is rotationally symmetric about the axis of the part."""
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    rings = radius * np.array([0.13, 0.37, 0.61, 0.83, 0.997])[:, None]
    x, y = rings * np.cos(angle), rings * np.sin(angle)
    (z,) = surface.evaluate(np.ascontiguousarray(x), np.ascontiguousarray(y), 0)
    return bool(np.nanmax(np.ptp(z, axis=1)) < 1e-12 * max(1.0, float(np.nanmax(np.abs(z)))))


def search(problem: Problem, state: Floats, free: list[int], size: Floats, reach: float, clocking: float) -> list[Fit]:
    """Return fits to the problem's (few) points from every valley within reach of the state, the best first."""
    pattern = lattice_of(problem.surface)
    start = level(problem, state, free, size)
    lateral = [k for k in (0, 1, 3) if k in free]
    points = _level_points(problem, start) if lateral and (reach > 0 or clocking > 0) else None
    if points is None:
        return [fit(problem, start, free, size, close=1e-9)]
    a = min(1 / size[3], problem.within)
    step = min(pattern.fine * STEP_IN_FEATURES if np.isfinite(pattern.fine) else np.inf, a / MIN_STEPS_ON_RADIUS)
    if 3 not in free:
        clocking = 0.0
    moves = np.array([k in free for k in (0, 1, 2, 4, 5, 3)])
    tabled = _TabledProblem(points, start, *_table(problem.surface, problem.within, step), moves)
    # A turn about the middle of the map moves the frame that the reach is stated in.
    reach += 2 * np.sin(min(clocking, np.pi) / 2) * min(float(np.hypot(*state[:2])), a) if reach > 0 else 0.0
    turn_step = min(step / a * 1.5, 0.35)
    places, pattern = _places(
        pattern, start, free, reach=reach, step=step, clocking=clocking, turn_step=turn_step,
        rim=1 / size[3], within=problem.within,
    )  # fmt: skip
    scores = _scores(tabled, places)
    chosen = _peaks(places, scores[0], 1.6 * step, 1.6 * turn_step, MAX_STARTS * (2 if clocking > 1.0 else 1))
    begin = np.concatenate([places, scores[1:].T], axis=1)[chosen]
    begin = np.concatenate([begin, [[start[0], start[1], 0.0, start[2], 0.0, 0.0]]])
    fits = []
    for width in (np.inf, ROBUST_MEDIANS):
        # A robust loss too, so that surfaces off the part, such as a flange beyond its rim, have no effect.
        states = [start, *_valleys(tabled, begin, step, problem, free, width)]
        refined = (_refine_fit(problem, each, free, size, calm=width < np.inf) for each in states)
        fits += [one for one in refined if one is not None]
    if pattern.steps is not None and fits:
        fits += _repeats(problem, fits, pattern.steps, state, reach, free, size, tabled)
    if fits:
        fits += _twins(problem, rank_fits(problem, fits)[0], state, free, size, clocking)
    fits = rank_fits(problem, fits)
    # Those that leave more of the map beyond the part than the best one do not count.
    fits = [one for one in fits if one.used >= MIN_COVER_SHARE * fits[0].used]
    near = [one for one in fits if np.abs(one.state[:2] - state[:2]).max() <= reach + step / 2]
    return near if near and near[0].cost <= MAX_COST_RATIO * fits[0].cost + MIN_MISFIT_MM**2 else fits


def costs(problem: Problem, fits: list[Fit]) -> Floats:
    """Return the cost of each fit: the mean square over *all* points, capped at that of an outlier. (m,) [mm²].

    A point off the part costs as much as an outlier, so that no pose gains by losing points. The cap follows from the
    least median residual of all fits, over the points that can lie on the part.
    """
    if not fits:
        return np.empty(0)
    sizes = []
    for one in fits:
        off = np.abs(residuals(problem, one.state))
        beyond = np.isnan(off)
        at = turns(one.state)[0][:2] @ problem.points[:, beyond] + one.state[:2, None]
        outside = np.hypot(*at) > problem.within * (1 + RIM_TOL)
        if isinstance(problem.surface, Bounded):
            outside |= ~problem.surface.on_outline(*at)
        off[beyond] = np.where(outside, np.inf, np.nan)
        sizes.append(off)
    most = max(*(int(np.count_nonzero(np.isfinite(off))) for off in sizes), 1)
    least = min(float(np.partition(np.where(np.isnan(off), 0.0, off), most // 2)[most // 2]) for off in sizes)
    limit = TRUNCATION_MEDIANS * max(least, MIN_MISFIT_MM / 100)
    return np.array([np.nanmean(np.minimum(off, limit) ** 2) for off in sizes])


def rank_fits(problem: Problem, fits: list[Fit]) -> list[Fit]:
    """Return the fits, the one that costs least first."""
    return [fits[k] for k in np.argsort(costs(problem, fits), kind="stable")]


def _twins(problem: Problem, best: Fit, state: Floats, free: list[int], size: Floats, clocking: float) -> list[Fit]:
    """Return fits where a symmetry of the part has them.

    A turn about the part's axis turns the place of the pivot and adds to the rotation, which is the last of the angles.
    """
    fits: list[Fit] = []
    if clocking > 0:
        turns_tried = {round(2 * np.pi * k / n, 12) for n in ROTATIONAL_FOLDS for k in range(1, n)}
        for turn in sorted(turns_tried):
            twin = best.state.copy()
            c, s = np.cos(turn), np.sin(turn)
            twin[:2] = c * twin[0] - s * twin[1], s * twin[0] + c * twin[1]
            twin[3] = state[3] + wrap_angle(twin[3] + turn - state[3])
            if abs(twin[3] - state[3]) > clocking:
                continue
            residual = residuals(problem, twin)
            residual = residual[np.isfinite(residual)]
            if (
                residual.size > MIN_ON_PART_SHARE * best.used
                and np.median(residual * residual) < MAX_COST_RATIO * best.cost + MIN_MISFIT_MM**2
            ):
                fits.append(fit(problem, twin, free, size, steps=25, close=1e-9))
    return fits


def level(problem: Problem, state: Floats, free: list[int], size: Floats) -> Floats:
    """Return the state with height and tilts fitted, whatever the lateral place is."""
    state = state.copy()
    tilts = [k for k in (2, 4, 5) if k in free]
    if not tilts:
        return state
    calm = replace(problem, terms=(), normal=False, loss="huber")
    residual = residuals(calm, state[:6])
    residual = residual[np.isfinite(residual)]
    if 2 in free and residual.size:
        state[2] -= float(np.median(residual))
    state[:6] = fit(calm, state[:6], tilts, size, steps=12, close=1e-6).state
    return state


def _level_points(problem: Problem, state: Floats) -> Floats | None:
    """Return the points (3, n) as the state turns them, about the pivot, without gross outliers."""
    sample = rows(problem, state, slice(0, problem.points.shape[1]))
    if sample.which.size < 10:
        return None
    limit = 4 * np.quantile(np.abs(sample.residual), 0.95) + 1e-9
    bad = sample.which[np.abs(sample.residual) > limit]
    arm = turns(state)[0] @ problem.points
    return np.ascontiguousarray(np.delete(arm, bad, axis=1))


def _places(
    pattern: Lattice, start: Floats, free: list[int], *, reach: float, step: float, clocking: float, turn_step: float,
    rim: float, within: float,
) -> tuple[Floats, Lattice]:  # fmt: skip
    """Return places and turns to look at (n, 3), and the pattern if they are those of one of its cells."""
    turns_tried = _turns(clocking, turn_step)
    # Farther from the part's axis nothing of the map lies on the part.
    farthest = within + rim
    along = [
        _axis(reach, step, -farthest - start[k], farthest - start[k]) if k in free else _Marks(0.0, 1, 0.0)
        for k in (0, 1)
    ]
    count = along[0].number * along[1].number
    of_cell = np.full(2, np.inf)
    if pattern.steps is not None and 0 in free and 1 in free:
        of_cell = np.maximum(np.ceil(np.hypot(*pattern.steps.T) / step), 2)
    by_cell = bool(of_cell.prod() <= count)
    total = min(count, float(of_cell.prod())) * turns_tried.number
    if by_cell and pattern.steps is not None:
        total += float(2 * _most_repeats(pattern.steps, reach) + 1) ** 2
    if total > MAX_PLACES:
        widest = step * (np.sqrt(MAX_PLACES / turns_tried.number) - 1) / 2
        remedy = f"a reach of at most {say_length(widest)}" if widest > step else "a smaller reach and clocking"
        raise InputError(
            f"the map's field of {say_length(2 * rim)} cannot be searched within a reach of {say_length(reach)} and "
            f"a clocking of {np.rad2deg(clocking):.3g} deg: these are {total / 1e6:,.0f} million positions "
            f"{say_length(step)} apart, the limit is {MAX_PLACES / 1e6:g} million. Check the unit of its lengths; if "
            f"that is right, state shift and rotation of the map and {remedy}"
        )
    if by_cell:
        u, v = np.meshgrid(np.arange(of_cell[0]) / of_cell[0], np.arange(of_cell[1]) / of_cell[1])
        cell = np.stack([u.ravel() - 0.5, v.ravel() - 0.5], axis=-1) @ pattern.steps
    else:
        pattern = Lattice(None, pattern.fine)
        x, y = np.meshgrid(*(one.at for one in along))
        cell = np.stack([x.ravel(), y.ravel()], axis=-1)
        cell = cell[np.hypot(*(cell + start[:2]).T) <= farthest]
    angles = turns_tried.at
    places = np.concatenate([np.repeat(cell, angles.size, axis=0), np.tile(angles, cell.shape[0])[:, None]], axis=1)
    return places + np.array([start[0], start[1], 0.0]), pattern


def _axis(reach: float, step: float, low: float = -np.inf, high: float = np.inf) -> _Marks:
    """Return places from -reach to reach no farther apart than the step, and of them those between two others."""
    half = float(np.ceil(reach / step))
    if half == 0:
        return _Marks(0.0, 1, 0.0)
    pitch = reach / half
    first, last = max(-half, np.ceil(low / pitch)), min(half, np.floor(high / pitch))
    return _Marks(first * pitch, max(last - first + 1, 0.0), pitch)


def _turns(clocking: float, step: float) -> _Marks:
    """Return turns from -clocking to clocking no farther apart than the step; a full turn closes on itself."""
    if clocking < np.pi * (1 - 1e-9):
        return _axis(clocking, step)
    count = float(np.ceil(2 * np.pi / step))
    return _Marks(-np.pi, count, 2 * np.pi / count)


def _table(surface: Surface, within: float, step: float) -> tuple[Floats, float, float]:
    """Tabulate the surface over the part, nan outside; return its lower corner and its step too."""
    count = int(min(max(2 * within / (step / 4), MIN_TABLE_SIZE), MAX_TABLE_SIZE))
    axis = np.linspace(-within, within, count)
    x, y = np.meshgrid(axis, axis)
    table = np.full(x.shape, np.nan)
    there = x * x + y * y <= (within * (1 + 2 / count)) ** 2
    inside = surface.inside(x, y)
    if inside is not None:
        there &= inside
    table[there] = surface.evaluate(x[there], y[there], 0)[0]
    return table, -within, float(axis[1] - axis[0])


def _scores(tabled: _TabledProblem, places: Floats, *, share: float = MIN_ON_PART_SHARE) -> Floats:
    """Return the misfit at each place, inf where too few points lie on the part, and what levels it there. (4, m)."""
    count = tabled.points.shape[1]
    keep = max(MAX_LOOKUPS // (LEVELLING_PASSES * max(places.shape[0], 1)), MIN_POINTS)
    x, y, z = (np.ascontiguousarray(row[:: -(-count // keep)]) for row in tabled.points)
    places = np.ascontiguousarray(places)
    out = np.empty((5, places.shape[0]))

    def work(start: int, stop: int) -> None:
        part = np.empty((5, stop - start))
        misfit(
            x, y, z, places[start:stop], float(tabled.start[2]), tabled.table, tabled.low, tabled.step, tabled.moves,
            LEVELLING_PASSES, part,
        )  # fmt: skip
        out[:, start:stop] = part

    run_chunks(work, places.shape[0], CHUNK_PLACES)
    return np.concatenate([_penalise_coverage(out[0], out[1], share)[None], out[2:]])


def _penalise_coverage(count: Floats, square: Floats, share: float) -> Floats:
    """Return mean squares with a price for points off the part, inf where too few of the points lie on it.

    A flat valley is the same everywhere: there the more of the map lies on the part, the better.
    """
    most = max(count.max(initial=0.0), 1.0)
    return np.where(count >= share * most, square * (most / np.maximum(count, 1)) ** 2, np.inf)


def _peaks(places: Floats, score: Floats, apart: float, turn_apart: float, most: int) -> list[int]:
    """Return the best places that are not on the flank of a better one."""
    chosen: list[int] = []
    order = np.argsort(score)[: np.count_nonzero(np.isfinite(score))]
    sorted_places = places[order]
    open_ = np.ones(order.size, dtype=np.bool_)
    while len(chosen) < most and open_.any():
        first = int(np.argmax(open_))
        chosen.append(int(order[first]))
        best = sorted_places[first]
        turn = np.abs(wrap_angle(sorted_places[:, 2] - best[2]))
        open_ &= (np.hypot(sorted_places[:, 0] - best[0], sorted_places[:, 1] - best[1]) > apart) | (turn > turn_apart)
    return chosen


def _valleys(
    tabled: _TabledProblem, begin: Floats, step: float, problem: Problem, free: list[int], width: float
) -> list[Floats]:  # fmt: skip
    """Return the states of the best valleys that these places slide into, each once."""
    x, y, z = (np.ascontiguousarray(row) for row in tabled.points)
    out = np.empty((begin.shape[0], 14))
    bends = problem.bends if tabled.moves[:5].all() else np.full(6, np.nan)

    def work(start: int, stop: int) -> None:
        part = np.empty((stop - start, 14))
        settle(
            x, y, z, np.ascontiguousarray(begin[start:stop]), bends, tabled.table, tabled.low, tabled.step,
            tabled.moves, MAX_DESCENT_STEPS, width, part,
        )  # fmt: skip
        out[start:stop] = part

    run_chunks(work, begin.shape[0], 2)
    cost = _penalise_coverage(out[:, 0], out[:, 1], MIN_ON_PART_SHARE)
    levelled = turns(tabled.start)[0]
    states: list[Floats] = []
    for k in np.argsort(cost):
        if not np.isfinite(cost[k]) or len(states) >= MAX_REFINED:
            break
        state = place_pivot(tabled.start, free, out[k, 2:5], out[k, 5:].reshape(3, 3) @ levelled)
        gaps = [np.abs(state[:6] - other[:6]) for other in states]
        if all(max(gap[:2].max(), problem.within * gap[3:].max()) > step / 20 for gap in gaps):
            states.append(state)
    return states


def _refine_fit(problem: Problem, state: Floats, free: list[int], size: Floats, *, calm: bool = False) -> Fit | None:
    """Fit from a valley of the table; calm, by Tukey's loss first."""
    pose = [k for k in free if k < 6]
    if calm:
        state = fit(replace(problem, loss="tukey"), state, pose, size, steps=MAX_ROBUST_STEPS, close=1e-7).state
    best = fit(problem, state, pose, size, steps=25, close=1e-7)
    if len(pose) < len(free):
        # Where a term and a turn pass for each other the pose alone goes half-way to a twin.
        both = [fit(problem, one, free, size, steps=25, close=1e-9) for one in (best.state, state)]
        best = min(both, key=lambda one: one.cost)
    return best if best.used > 0 else None


def _most_repeats(steps: Floats, reach: float) -> int:
    """Return how many steps of a pattern, either way, may lie within reach."""
    return int(np.ceil((2 * reach) / np.sqrt(abs(np.linalg.det(steps))))) + 1


def _repeats(
    problem: Problem, fits: list[Fit], steps: Floats, state: Floats, reach: float, free: list[int], size: Floats,
    tabled: _TabledProblem,
) -> list[Fit]:  # fmt: skip
    """Return fits from every repeat of the pattern within reach of the best that was found."""
    start = tabled.start
    base = rank_fits(problem, fits)[0]
    most = _most_repeats(steps, reach)
    i, j = np.meshgrid(np.arange(-most, most + 1), np.arange(-most, most + 1))
    at = base.state[:2] + np.stack([i.ravel(), j.ravel()], axis=-1) @ steps
    at = at[np.abs(at - state[:2]).max(axis=1) <= reach + np.hypot(*steps.T).min() / 2]
    places = np.concatenate([at, np.full((at.shape[0], 1), base.state[3] - start[3])], axis=1)
    if not places.size:
        return []
    scores = _scores(tabled, places, share=MIN_COVER_SHARE)
    most_score = MAX_COST_RATIO * float(scores[0].min())
    chosen = [int(k) for k in np.argsort(scores[0])[:MAX_REPEATS] if scores[0][k] <= most_score]
    repeats = []
    for k in chosen:
        # Where a repeat is another cell of the pattern, the tilt that goes with its place is another.
        turn = rotation_about((*scores[2:, k], 0.0)) @ rotation_about((0.0, 0.0, places[k, 2])) @ turns(start)[0]
        moved = place_pivot(start, free, np.array([*places[k, :2], scores[1, k]]), turn)
        repeats.append(_refine_fit(problem, moved, free, size))
    return [one for one in repeats if one is not None]
