"""Registration: pose of a measured map on the part, and the degrees of freedom that the surface does not determine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from turnwright._arrays import STEP_TOL, Bools, Floats, Ints
from turnwright._validate import between, check_angle, one_of, positive
from turnwright.errors import InputError
from turnwright.metrology.grid import disc_points, point_areas, valid_points
from turnwright.metrology.noise import MapNoise, map_noise
from turnwright.metrology.pose_search import MIN_COVER_SHARE, axisymmetric, costs, level, rank_fits, search
from turnwright.metrology.rigid import (
    FULL_SHARE,
    LOSS_WIDTHS,
    MIN_SCATTER_MM,
    NAMES,
    Fit,
    Loss,
    Problem,
    chance,
    fit,
    pose_of,
    residuals,
    scatter,
    state_of,
    turns,
    weights,
    wrap_angle,
)
from turnwright.metrology.undetermined import UNDETERMINED_STD_MM, Doubt, doubt, undetermined_directions
from turnwright.pose import Pose
from turnwright.surface import Surface
from turnwright.units import say_length

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.part import Part

DoubtKind: TypeAlias = Literal["undetermined", "tails", "held", "lost", "ambiguous", "symmetric"]
"""Kinds of findings that make a pose uncertain."""

SEARCH_POINTS = 3000

STATISTICS_POINTS = 20_000
"""Points used for uncertainties and for the comparison of candidates."""

ROTATION_INDEX = NAMES.index("rotation")

MAX_RIM_STD_MM = 0.1
"""Standard deviation of the position of the rim beyond which a direction is undetermined: a dial gauge does better."""

DEFAULT_FORM_ERROR_MM = 1e-3

MAX_RIVAL_RATIO = 1.44
"""Ratio of mean squares up to which another pose fits nearly as well: 20 % more rms."""

EQUAL_CHI_SQUARE = 10.0
"""Difference in chi-square up to which two poses fit equally well; noise alone exceeds it once in 650 times."""

HELD_COST_TOL = 0.01
"""Relative increase of the mean square allowed when undetermined degrees of freedom are fixed."""

MAX_CENTRING_STEPS, MIN_CENTRING_STEP_MM = 200, 1e-4
"""Steps, and their least length, that bring a map onto a part of which only the edge determines the position."""

MIN_LOST_SHARE = 0.01
"""Share of the points beyond the part from which they are reported."""

MIN_COMPARED_RMS_MM = 1e-6
"""Lower bound of noise and form error together when poses are compared."""

MIN_NOISE_MM = 1e-7
"""Lower bound of the noise when uncertainties are stated."""

SYMMETRY_TOL_MM = 1e-7
"""Rms difference between a part and the moved part up to which it counts as symmetric."""

MIN_CURVATURE_POINTS, MAX_CURVATURE_RADIUS_MM = 10, 1e4
"""Limits for the centres of curvature of the surface."""

MAX_CANDIDATES = 50

MAX_RESTARTS = 3
"""Fits off the part that are repeated from within its edge."""

MAX_TAIL_RATIO = 3.0
"""Ratio of the residual rms and the robust scatter beyond which a few points dominate."""

OUTLIER_SIGMA = 6.0
"""Robust standard deviations beyond which a robust loss flags a point."""

EDGE = 1e-6
"""Tolerance of the rim, relative to the radius of the part: a pose is not known more exactly."""

HEIGHT_QUANTILE = 0.99
"""Quantile of the heights that is free of gross outliers."""

NM = 1e6
DEFAULT_CLOCKING_RAD = np.deg2rad(30)
"""Default range of the rotation about the start."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseCandidate:
    """Another pose that fits equally or nearly as well.

    Parameters
    ----------
    pose
        From the map's frame to the part's, as `Registration.pose`.
    rms_nm
        Root mean square of the residual there. [nm]
    ratio
        Mean square of the residual there over that at `Registration.pose`: 1 fits as well.
    symmetric
        Whether a symmetry of the design makes the two poses equivalent.
    """

    pose: Pose
    rms_nm: float
    ratio: float
    symmetric: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Undetermined:
    """A direction in which the part can move without an effect on the map.

    Parameters
    ----------
    direction
        Change of (x, y, z, rotation, tilt_x, tilt_y) that moves the rim of the map by 1 mm. (6,) [mm, rad]
    std
        Standard deviation along it, as movement of the rim; inf if only rounding changes. [mm]
    reason
        Whether the invariance of the design, a plausible form error, or noise leaves it undetermined.
    words
        The finding in a sentence.
    """

    direction: Floats
    std: float
    reason: Literal["surface", "form", "noise"]
    words: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """Pose of a map on a part. See `register`.

    Parameters
    ----------
    pose
        From the frame of the map to that of the part.
    names
        Fitted degrees of freedom, of "x", "y", "z", "rotation", "tilt_x", "tilt_y". The first three are the position of
        the ``pivot`` in the part frame [mm]; the others are the angles of `Pose` [rad].
    pivot
        Point of the map, in its own frame, about which it was rotated: the centre of its valid points. [mm]
    covariance
        Covariance of the fitted degrees of freedom from noise alone; on a lens array, residuals may be correlated
        within a lenslet or an eighth of the map. (k, k) [mm, rad]
    form_covariance
        The same from form errors of size ``form_error``. (k, k) [mm, rad]
    form_error
        Assumed standard deviation of each Zernike form of degree 2 to 4, as height at the rim. [mm]
    amplitudes, amplitudes_std
        Fitted amplitude of each of ``terms``, and its standard deviation from noise. (n_terms,)
    residual
        Measured minus design, without the fitted terms, at the points of the map. ``x`` and ``y`` are in the frame of
        the map, heights along z of the part (with ``distance="normal"``, along the normal of the design). nan where the
        map has no height or lies off the part. [mm]
    error
        The same including the fitted terms: measured minus design at this pose.
    candidates
        Other poses that fit as well or nearly so, the best first. Empty if the pose is unique within the search.
    undetermined
        Directions in which the position of the rim is uncertain by more than 0.1 mm. They are fitted nevertheless if
        the noise allows it.
    held
        Degrees of freedom that nothing determines, and which are fixed.
    start
        Start of the search.
    outliers
        Points flagged by a robust loss, at six times the scatter or more. The shape of the map.
    count
        Number of fitted points.
    lost
        Number of points that lie off the part at this pose and do not count.
    rms_nm
        Root mean square of ``residual`` over its area, without outliers: the form error if nothing is fixed. [nm]
    noise_nm
        Standard deviation of the white noise, as stated or from differences of neighbours. [nm]
    correlated_nm, correlation_length
        Standard deviation of the correlated noise and its correlation radius; 0 if the noise is stated. [nm], [mm]
    iterations
        Steps of least squares over all points.
    distance
        "vertical" or "normal".
    """

    pose: Pose
    names: tuple[str, ...]
    pivot: tuple[float, float, float]
    covariance: Floats
    form_covariance: Floats
    form_error: float
    amplitudes: Floats
    amplitudes_std: Floats
    residual: HeightMap
    error: HeightMap
    candidates: tuple[PoseCandidate, ...]
    undetermined: tuple[Undetermined, ...]
    held: tuple[str, ...]
    start: Pose
    outliers: Bools
    count: int
    lost: int
    rms_nm: float
    noise_nm: float
    correlated_nm: float
    correlation_length: float
    iterations: int
    distance: str

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each fitted degree of freedom, noise and form error together. [mm, rad]."""
        both = np.sqrt(np.diag(self.covariance + self.form_covariance))
        return dict(zip(self.names, both.tolist(), strict=True))

    @property
    def correlation(self) -> Floats:
        """Correlation of the fitted degrees of freedom, noise and form error together. (k, k)."""
        both = self.covariance + self.form_covariance
        size = np.sqrt(np.diag(both))
        return np.asarray(both / np.outer(size, size))

    @property
    def ambiguous(self) -> bool:
        """Whether another pose, not a symmetric one, fits nearly as well."""
        return bool(self.rivals)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Result and findings, one sentence each."""
        shift = ", ".join(f"{one:.6g}" for one in self.pose.shift)
        angles = ", ".join(f"{1e3 * one:.6g}" for one in (self.pose.rotation, *self.pose.tilt))
        along = "part z" if self.distance == "vertical" else "normal"
        first = (
            f"The map lies on the part with shift ({shift}) mm and rotation and tilts ({angles}) mrad from its own "
            f"frame to the part's; {self.count} points fit to {self.rms_nm:.4g} nm rms along the {along}."
        )
        remedies = {
            "tails": 'Clean the map, mask it, or use loss="huber".',
            "ambiguous": "Measure the edge of the part or a fiducial, and give a start and a reach that exclude the "
            "others.",
        }
        return first, *(" ".join(filter(None, (fact, remedies.get(kind)))) for kind, fact in self.findings)

    @property
    def findings(self) -> tuple[tuple[DoubtKind, str], ...]:
        """Findings that make the pose uncertain: kind and sentence."""
        return tuple(self._findings())

    def _findings(self) -> Iterator[tuple[DoubtKind, str]]:
        for direction in self.undetermined:
            yield "undetermined", direction.words
        typical = scatter(self.residual.z[~self.outliers]) * NM
        if self.rms_nm > MAX_TAIL_RATIO * typical and self.rms_nm > 1:
            words = "outliers, displaced lenslets or points off the part bias the pose."
            yield "tails", f"Most points scatter by only {typical:.3g} nm: {words}"
        if self.held:
            yield "held", f"Not determined by the fit and {self._held_where}: {', '.join(self.held)}."
        if self.lost > MIN_LOST_SHARE * (self.count + self.lost):
            total = np.count_nonzero(self.outliers) + self.count + self.lost
            yield "lost", f"{self.lost} of the {total} points of the map lie off the part and do not count."
        if near := self.rivals:
            shift = ", ".join(f"{one:.4g}" for one in near[0].pose.shift)
            rotation = np.rad2deg(near[0].pose.rotation)
            count = "Another pose fits" if len(near) == 1 else f"{len(near)} other poses fit"
            place = f"with shift ({shift}) mm and rotation {rotation:.4g} deg at {near[0].rms_nm:.4g} nm rms."
            yield "ambiguous", f"{count} nearly as well, the best {place}"
        turned = sorted(
            float((np.rad2deg(one.pose.rotation - self.pose.rotation) + 180.001) % 360 - 180.001)
            for one in self.candidates
            if one.symmetric
        )
        if turned:
            words = "deg the pose is equivalent, and only a fiducial on the part distinguishes them."
            yield "symmetric", f"The part is symmetric: rotated by {', '.join(f'{one:.4g}' for one in turned)} {words}"

    @property
    def _held_where(self) -> str:
        """Where the undetermined degrees of freedom are fixed."""
        at, start = (np.array(pose.apply(*self.pivot)[:2]) for pose in (self.pose, self.start))
        moved = any(name in self.held and abs(at[k] - start[k]) > 1e-9 for k, name in enumerate("xy"))
        turned = "rotation" in self.held and abs(self.pose.rotation - self.start.rotation) > 1e-9
        if turned:
            return "fixed where the search ended"
        return "fixed at a position within the edge of the part" if moved else "fixed at the start"

    @property
    def rivals(self) -> tuple[PoseCandidate, ...]:
        """Other poses that fit nearly as well and are not equivalent by symmetry, the best first."""
        return tuple(other for other in self.candidates if not other.symmetric)


class _Task(NamedTuple):
    problem: Problem
    pivot: Floats
    start: Floats
    free: list[int]
    size: Floats
    noise: float | None  # as stated
    form: float
    which: Ints
    seen: MapNoise | None = None  # as the map shows it


def register(
    heights: HeightMap,
    part: Part,
    *,
    free: Sequence[str] = NAMES,
    terms: Sequence[Surface] = (),
    distance: Literal["vertical", "normal"] = "vertical",
    loss: Loss = "linear",
    start: Pose | None = None,
    reach: float = 5.0,
    clocking: float = DEFAULT_CLOCKING_RAD,
    noise_nm: float | None = None,
    form_error: float | None = None,
    undetermined: Literal["fit", "hold", "raise"] = "fit",
) -> Registration:
    r"""Find the pose of a measured map on a part by least squares of its distance to the exact prescription.

    All poses within ``reach`` and ``clocking`` are compared; a point off the part costs as much as an outlier. Points
    of a grid are weighted by area, scattered points equally. Every direction that the heights determine at their noise
    is fitted. Other poses that fit nearly as well are listed, and so are directions that cannot be distinguished from
    a form error.

    Parameters
    ----------
    heights
        The measured map.
    part
        The measured part. Points farther from its axis than its radius do not count.
    free
        Free degrees of freedom: any of "x", "y", "z", "rotation", "tilt_x", "tilt_y"; see `Registration.names`.
    terms
        Form errors to fit together with the pose, each a surface in the part frame whose amplitude is fitted.
    distance
        Along the part's z, or along the normal of the design: to the tangent plane at the foot of the perpendicular.
    loss
        "linear" for least squares; "huber" or "tukey" to limit the effect of dust and outliers. For a lens array with
        displaced lenslets use "huber": Tukey's loss would reject the lenslets.
    start
        Approximate pose of the map. By default the frames coincide, or, if the map then extends beyond the part by
        more than 5 mm, its centre is on the axis of the part.
    reach
        Range of the search about the start along x and along y; 0 with ``clocking=0`` skips the search. [mm]
    clocking
        Range of the search in rotation about the start, 30 degrees by default, π for all. [rad]
    noise_nm
        Standard deviation of a height, independent from point to point; by default estimated from the map. [nm]
    form_error
        Standard deviation of each form error of Zernike degrees 2 to 4, as height at the rim, from which the
        uncertainty of the pose is computed. By default 1 um; 0 if ``terms`` contain all form errors. [mm]
    undetermined
        Treatment of directions in which a form error may move the rim by more than 0.1 mm: fit and report them ("fit"),
        fix as many degrees of freedom at the start ("hold"), or "raise".

    Raises
    ------
    InputError
        If the map has too few heights on the part, an option is out of range, or with ``undetermined="raise"`` the
        surface does not determine the pose.

    Sources
    -------
    [Troutman2016]_ 7.3.1 (registration of 360 points). [Kong2019]_ (two-step matching of a compound surface).
    [Nocedal2006]_ 10.3 (Levenberg-Marquardt). Oracles: SciPy's least squares on residuals of its own, closed forms.
    """
    task = _task(heights, part, free, terms, distance, loss, start, noise_nm, form_error)
    between(reach, "reach of the search", 0, np.inf, "mm")
    check_angle(clocking, "clocking of the search", 0.0, np.pi * (1 + 1e-9))
    one_of(undetermined, "undetermined", ("hold", "fit", "raise"))
    few, some = (
        task.problem.only(sample(task.problem.points.shape[1], count)) for count in (SEARCH_POINTS, STATISTICS_POINTS)
    )
    # The rotation of an axisymmetric part is not searched for.
    alike = not task.problem.terms and axisymmetric(part.surface, task.problem.within)
    sought = [k for k in task.free if k != ROTATION_INDEX or not alike]
    on_part = [one for one in search(few, task.start, sought, task.size, reach, clocking) if _enough(one)]
    on_part = _restart_within_part(few, on_part, sought, task.size)
    if not on_part:
        raise InputError(
            f"fewer than {len(task.free) + 2} of the {task.which.size} heights of the map lie within "
            f"{task.problem.within:g} mm of the axis of the part from this start: check units and start, or give a "
            "larger reach"
        )
    # The fit must not lose points that the search had on the part.
    seen = on_part[0].used / few.points.shape[1]
    best = fit(some, on_part[0].state, sought, task.size, close=1e-10, least=MIN_COVER_SHARE, seen=seen)
    if task.noise is None:
        task = task._replace(seen=map_noise(task.problem, some, best.state, heights, task.which))
    free_directions, fixed, directions = _decide(task, some, best, undetermined)
    fits = _distinct(task, few, some, on_part, best, free_directions, fixed)
    chosen, candidates = _candidates(task, some, fits, free_directions, seen)
    final = fit(task.problem, chosen.state, free_directions, task.size, least=MIN_COVER_SHARE, seen=seen)
    return _answer(task, heights, final, some, free_directions, fixed, directions, candidates)


def _task(
    heights: HeightMap,
    part: Part,
    free: Sequence[str],
    terms: Sequence[Surface],
    distance: str,
    loss: Loss,
    start: Pose | None,
    noise_nm: float | None,
    form_error: float | None,
) -> _Task:
    heights.require_calibrated()
    unknown = sorted(set(free) - set(NAMES))
    if unknown or not free:
        raise InputError(f"free has {unknown or 'no entry'}, allowed are {', '.join(NAMES)}: choose among them")
    one_of(distance, "distance", ("vertical", "normal"))
    one_of(loss, "loss", ("linear", *LOSS_WIDTHS))
    noise = None if noise_nm is None else positive(noise_nm, "noise", "nm") / NM
    form = DEFAULT_FORM_ERROR_MM if form_error is None else between(form_error, "form_error", 0, np.inf, "mm")
    valid = valid_points(heights, len(free) + len(terms) + 1, "a registration")
    index = np.flatnonzero(valid)
    x, y = heights.points()
    points = np.stack([one.ravel()[index] for one in (x, y, heights.z)])
    area = point_areas(heights).ravel()[index]
    # Robust against single gross heights such as 1e9.
    pivot = np.array([points[0].mean(), points[1].mean(), np.median(points[2])])
    points -= pivot[:, None]
    rim = float(np.hypot(np.hypot(points[0], points[1]).max(), np.quantile(np.abs(points[2]), HEIGHT_QUANTILE))) or 1.0
    if start is None:
        start = _find_start(points, pivot, part)
    part = part.bounded(part.reach * EDGE)
    return _Task(
        problem=Problem(
            points=np.ascontiguousarray(points),
            area=None if np.ptp(area) <= STEP_TOL * area.max() else area / area.mean(),
            surface=part.surface,
            terms=tuple(terms),
            within=part.reach * (1 + EDGE),
            normal=distance == "normal",
            loss=loss,
            bends=_bends(part.surface, part.reach),
        ),
        pivot=pivot,
        start=state_of(start, pivot, len(terms)),
        free=[k for k, name in enumerate(NAMES) if name in free] + list(range(6, 6 + len(terms))),
        size=np.array([1, 1, 1, 1 / rim, 1 / rim, 1 / rim, *[1 / _largest(term, part.reach) for term in terms]]),
        noise=noise,
        form=form,
        which=index,
    )


def _find_start(points: Floats, pivot: Floats, part: Part) -> Pose:
    """Return the start of a search: as measured, or with the middle of the map on that of the part if it is far off."""
    if part.outline is None:
        middle = np.zeros(2)
        far = np.hypot(points[0] + pivot[0], points[1] + pivot[1]).max() > part.reach + 5
    else:
        x_low, x_high, low, high = part.outline.box
        middle = np.array([x_low + x_high, low + high]) / 2
        on = part.covers(points[0] + pivot[0], points[1] + pivot[1])
        far = np.count_nonzero(on) < on.size / 2
    return Pose(shift=(middle[0] - pivot[0], middle[1] - pivot[1], 0.0)) if far else Pose()


def _bends(surface: Surface, radius: float) -> Floats:
    """Return the centres of curvature of a surface, see `turnwright._kernels.registration.bend`. (6,)."""
    x, y = disc_points(radius)
    if (inside := surface.inside(x, y)) is not None:
        x, y = x[inside], y[inside]
    z = surface.evaluate(x, y, 0)[0]
    valid = np.isfinite(z)
    x, y, z = x[valid], y[valid], z[valid]
    bend = np.full(6, np.nan)
    if z.size < MIN_CURVATURE_POINTS:
        return bend
    columns = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=1)
    height, along_x, along_y, xx, xy, yy = np.linalg.lstsq(columns, z, rcond=None)[0]
    curvatures, ways = np.linalg.eigh([[xx, xy], [xy, yy]])
    bend[:2] = ways[:, 0]
    across = np.array([-ways[1, 0], ways[0, 0]])
    for k, way in enumerate((ways[:, 0], across)):
        if abs(curvatures[k]) * MAX_CURVATURE_RADIUS_MM > 1:
            slope = along_x * way[0] + along_y * way[1]
            bend[2 + 2 * k : 4 + 2 * k] = -slope / curvatures[k], height + 1 / curvatures[k]
    return bend


def _largest(term: Surface, radius: float) -> float:
    """Return the largest height of a term over the part, which scales the steps. [mm]."""
    (z,) = term.evaluate(*disc_points(radius), 0)
    largest = float(np.nanmax(np.abs(z), initial=0.0))
    if not 0 < largest < np.inf:
        raise InputError(
            f"the term {type(term).__name__} has the height {largest:g} mm over the part: give one that is not 0, for "
            "instance with the amplitude 1"
        )
    return largest


def sample(count: int, most: int) -> Ints:
    """Return a reproducible stratified random sample of the points."""
    if count <= most:
        return np.arange(count)
    # One point from each of equal intervals: even coverage without aliasing with the raster.
    edges = np.linspace(0, count, most + 1)
    return (edges[:-1] + np.random.default_rng(0).random(most) * np.diff(edges)).astype(np.int64)


def _enough(one: Fit) -> bool:
    return one.used > one.state.size + 1


def _restart_within_part(few: Problem, found: list[Fit], free: list[int], size: Floats) -> list[Fit]:
    """Add fits started from within the edge of the part for those that have left it, and return the best first.

    A form error that acts like a shift leads a fit off the part; the edge of the map limits the shift.
    """
    lateral = [k for k in (0, 1) if k in free]
    within = []
    for one in found[:MAX_RESTARTS]:
        if lateral and one.used < few.points.shape[1]:
            state = one.state.copy()
            state[:2] = _shift_within_edge(few, state, state[:2], lateral)
            within.append(fit(few, level(few, state, free, size), free, size, close=1e-9, least=MIN_COVER_SHARE))
    return rank_fits(few, [*found, *filter(_enough, within)])


def _shift_within_edge(problem: Problem, state: Floats, at: Floats, lateral: Sequence[int]) -> Floats:
    """Return a lateral position that brings more of the map within the edge of the part. (2,) [mm]."""
    arm = turns(state)[0][:2] @ problem.points
    at = at.copy()
    for turn in range(MAX_CENTRING_STEPS):
        away = np.hypot(*(arm + at[:, None]))
        far = int(np.argmax(away))
        beyond = away[far] - problem.within / (1 + EDGE)
        if beyond <= 0:
            break
        way = (arm[:, far] + at) / away[far]
        at[[*lateral]] -= (
            way[[*lateral]] * max(beyond, MIN_CENTRING_STEP_MM) / max(1.0, (turn - MAX_CENTRING_STEPS / 2) / 10)
        )
    return at


def _noise(task: _Task) -> float:
    """Return the standard deviation of equivalent independent noise. [mm]."""
    if task.noise is not None:
        return task.noise
    if task.seen is None:
        return MIN_NOISE_MM
    if task.problem.surface.in_pieces:  # correlated noise is counted for each piece
        return max(float(np.hypot(task.seen.white, task.seen.correlated)), MIN_NOISE_MM)
    return max(task.seen.effective, MIN_NOISE_MM)


def _doubt(task: _Task, some: Problem, one: Fit, free: list[int], count: int) -> Doubt:
    return doubt(
        some, one, free, task.size, noise=_noise(task), count=count, form=task.form, white=task.noise is not None
    )


def _decide(
    task: _Task, some: Problem, best: Fit, undetermined: str
) -> tuple[list[int], dict[int, float], tuple[Undetermined, ...]]:
    """Return the degrees of freedom to fit, those to fix and their values, and the undetermined directions."""
    pose = [k for k in task.free if k < 6]
    count = int(task.which.size * best.used / some.points.shape[1])
    unsure = _doubt(task, some, best, task.free, count)
    parts = Doubt(*(one[: len(pose), : len(pose)] for one in unsure))
    vectors, pivots = undetermined_directions(parts.total, MAX_RIM_STD_MM)
    directions = tuple(_describe_undetermined(task, pose, vector, parts) for vector in vectors.T)
    if directions and undetermined == "raise":
        raise InputError(
            " ".join(one.words for one in directions)[:-1]
            + f", the limit is {MAX_RIM_STD_MM:g} mm: reduce free, give terms, a smaller form_error or a fiducial"
        )
    lateral = [k for k in (0, 1, ROTATION_INDEX) if k in task.free]
    levelled = fit(some, task.start, [k for k in task.free if k not in lateral], task.size, close=1e-9)
    if (
        _enough(levelled)
        and best.used < MIN_COVER_SHARE * levelled.used
        and np.argmin(costs(some, [best, levelled])) == 1
    ):
        # The shifted fit does not outweigh the points that it loses.
        return [k for k in task.free if k not in lateral], {k: float(task.start[k]) for k in lateral}, directions
    # Directions undetermined by noise are always fixed; those confused with form only if requested.
    if undetermined == "fit":
        pivots = undetermined_directions(parts.noise, MAX_RIM_STD_MM)[1]
    wanted = [pose[k] for k in pivots]
    allowed = EQUAL_CHI_SQUARE * _noise(task) ** 2 / max(count, 1) * best.used
    if undetermined == "hold":
        allowed += (best.cost + 9 * task.form**2) * best.used
    for count_held in range(len(wanted), 0, -1):
        for fixed in combinations(wanted, count_held):
            free = [k for k in task.free if k not in fixed]
            for where in _places(task, some, best, fixed):
                state = best.state.copy()
                state[list(fixed)] = where
                there = fit(some, state, free, task.size, close=1e-9)
                before, after = costs(some, [best, there])
                slack = chance(some, there.state - best.state, best.used, there.used) + HELD_COST_TOL
                if (
                    there.used >= FULL_SHARE * best.used
                    and (after - before) * best.used <= allowed + slack * before * best.used
                ):
                    return free, dict(zip(fixed, where.tolist(), strict=True)), directions
    # The start contradicts the heights: directions undetermined by the surface are fixed where the search ended.
    fixed_there = _final_values(some, best, wanted[: sum(one.reason == "surface" for one in directions)])
    return [k for k in task.free if k not in fixed_there], fixed_there, directions


def _final_values(some: Problem, best: Fit, numbers: list[int]) -> dict[int, float]:
    """Return the values at the end of the search, with the map within the edge of the part."""
    state = best.state.copy()
    if lateral := [k for k in numbers if k < 2]:
        state[:2] = _shift_within_edge(some, state, state[:2], lateral)
    return {k: float(state[k]) for k in numbers}


def _places(task: _Task, some: Problem, best: Fit, fixed: tuple[int, ...]) -> list[Floats]:
    """Return values for fixed degrees of freedom: the start, or close to it with more of the map on the part.

    Only the edge of the part then determines its position.
    """
    lateral = [k for k in fixed if k < 2]
    start = task.start[list(fixed)]
    if not lateral:
        return [start]
    at = best.state[:2].copy()
    at[lateral] = task.start[lateral]
    at = _shift_within_edge(some, best.state, at, lateral)
    moved = start.copy()
    moved[[fixed.index(k) for k in lateral]] = at[lateral]
    return [start] if np.array_equal(moved, start) else [start, moved]


def _describe_undetermined(task: _Task, pose: list[int], vector: Floats, covariances: Doubt) -> Undetermined:
    """Return an undetermined direction, which moves the pose along a vector (k,), with its sentence."""
    by_noise, by_form = (float(vector @ one @ vector) / float(vector @ vector) for one in covariances)
    std = float(np.sqrt(by_noise + by_form))
    direction = np.zeros(6)
    direction[pose] = vector / np.linalg.norm(vector) * task.size[pose] * np.sign(vector[np.argmax(np.abs(vector))])
    share = np.abs(direction / task.size[:6])
    named = [
        f"{NAMES[k]} {direction[k]:+.4g} mm" if k < 3 else f"{NAMES[k]} {1e3 * direction[k]:+.4g} mrad"
        for k in np.argsort(-share)
        if share[k] > 0.003
    ]
    together = " with ".join(named)
    if std > UNDETERMINED_STD_MM / 10:
        words = f"The surface is the same when the part moves by {together}: nothing determines this direction."
        return Undetermined(direction=direction, std=np.inf, reason="surface", words=words)
    why = f"a form error of {say_length(task.form)}" if by_form > by_noise else "noise"
    words = f"The surface hardly determines the direction {together}: {why} acts like {say_length(std)} at the rim."
    return Undetermined(direction=direction, std=std, reason="form" if by_form > by_noise else "noise", words=words)


def _distinct(
    task: _Task, few: Problem, some: Problem, found: list[Fit], best: Fit, kept: list[int], fixed: dict[int, float]
) -> list[Fit]:
    distinct: list[Fit] = []
    for one in found:
        if one.cost > 9 * found[0].cost + MIN_COMPARED_RMS_MM**2:
            continue
        moved = one
        if fixed:
            state = one.state.copy()
            state[list(fixed)] = list(fixed.values())
            moved = fit(few, state, kept, task.size, close=1e-9)
            if not _enough(moved):
                continue
        if all(_rim_distance(task, moved.state, other.state) > 0.02 for other in distinct):
            distinct.append(moved)
    pose = [k for k in kept if k < 6]
    if len(pose) < len(kept):
        # A quadric with a term that acts like a rotation: the fit without terms lies halfway between two solutions.
        for one in distinct[:2]:
            alone = one.state.copy()
            alone[6:] = 0
            middle = fit(some, alone, pose, task.size, close=1e-9).state
            distinct.append(fit(some, 2 * middle - one.state, kept, task.size, close=1e-9))
    if not distinct:
        return [best]
    return rank_fits(few, distinct)[:MAX_CANDIDATES]


def _rim_distance(task: _Task, one: Floats, other: Floats) -> float:
    """Return the distance of two poses as movement of the rim. [mm]."""
    return float(np.abs(_gap(one, other)[:6] / task.size[:6]).max())


def _candidates(
    task: _Task, some: Problem, fits: list[Fit], kept: list[int], seen: float
) -> tuple[Fit, list[tuple[Fit, float]]]:
    """Return the best fit, and the others that fit nearly as well with their ratios of mean squares."""
    if len(fits) == 1:
        return fits[0], []
    fine: list[Fit] = []
    close = [
        fit(some, one.state, kept, task.size, steps=25, close=1e-9, least=MIN_COVER_SHARE, seen=seen) for one in fits
    ]
    for one in rank_fits(some, close):
        if not any(_share_minimum(some, one, other) for other in fine):
            fine.append(one)
    fine = [one for one in fine if one.used >= MIN_COVER_SHARE * fine[0].used]
    cost = costs(some, fine)
    fit_costs = np.array([one.cost for one in fine])
    noise = max(fit_costs[0], MIN_SCATTER_MM**2) if task.noise is None else task.noise**2
    even = np.flatnonzero((cost - cost[0]) * fine[0].used <= EQUAL_CHI_SQUARE * noise)
    near = even[np.argmin([_rim_distance(task, fine[k].state, task.start) for k in even])]
    ratio = (fit_costs + MIN_COMPARED_RMS_MM**2) / (fit_costs[near] + MIN_COMPARED_RMS_MM**2)
    # Poses within their uncertainty are the same.
    unsure = _doubt(task, some, fine[near], kept, some.points.shape[1])
    variance, axes = np.linalg.eigh(unsure.noise)
    others = []
    for k in np.argsort(ratio):
        gap = (_gap(fine[k].state, fine[near].state) / task.size)[kept]
        far = float(np.sum((axes.T @ gap) ** 2 / np.maximum(variance, MIN_SCATTER_MM**2)))
        if k != near and ratio[k] <= MAX_RIVAL_RATIO and far > 9 * len(kept):
            others.append((fine[k], float(ratio[k])))
    return fine[near], others


def _share_minimum(some: Problem, one: Fit, other: Fit) -> bool:
    """Return whether two fits share a minimum: the cost halfway between them is no higher than at the higher one."""
    middle = other.state + _gap(one.state, other.state) / 2
    scale = max(one.scale, other.scale)
    heights = []
    for state in (middle, one.state, other.state):
        there = residuals(some, state)
        on = np.isfinite(there)
        if np.count_nonzero(on) < one.used / 2:
            return False
        heights.append(some.mean(weights(there[on], scale, some.loss)[1], on))
    slack = 1.001 + chance(some, one.state - other.state, one.used, other.used)
    return heights[0] <= max(heights[1:]) * slack + MIN_SCATTER_MM**2


def _gap(one: Floats, other: Floats) -> Floats:
    """Return the difference of two states, with angles in [-π, π)."""
    gap = one - other
    gap[3:6] = wrap_angle(gap[3:6])
    return gap


def _symmetric(task: _Task, one: Floats, other: Floats) -> bool:
    """Return whether the design is the same surface at both poses."""
    move = pose_of(other, task.pivot).after(pose_of(one, task.pivot).inverse)
    radius = task.problem.within
    x, y = disc_points(0.98 * radius, 61)
    surface = task.problem.surface
    with np.errstate(all="ignore"):
        at = move.apply(x, y, surface.evaluate(x, y, 0)[0])
        gap = at[2] - surface.evaluate(np.ascontiguousarray(at[0]), np.ascontiguousarray(at[1]), 0)[0]
    # The tolerance allows for fits that stopped slightly apart.
    rms = float(np.sqrt(np.mean(gap * gap)))
    inside = np.hypot(at[0], at[1]).max() <= radius * 1.001
    return bool(inside and np.isfinite(rms) and rms < SYMMETRY_TOL_MM)


def _answer(
    task: _Task,
    heights: HeightMap,
    final: Fit,
    some: Problem,
    kept: list[int],
    fixed: dict[int, float],
    undetermined: tuple[Undetermined, ...],
    candidates: list[tuple[Fit, float]],
) -> Registration:
    problem = task.problem
    residual = residuals(problem, final.state)
    names = [k for k in kept if k < 6]
    outliers = np.zeros(heights.z.shape, dtype=np.bool_)
    good = np.isfinite(residual)
    if problem.loss != "linear":
        stray = good & (np.abs(residual) > OUTLIER_SIGMA * scatter(residual))
        outliers.ravel()[task.which[stray]] = True
        good &= ~stray
    rms = float(np.sqrt(problem.mean(residual[good] ** 2, good))) if good.any() else 0.0
    unsure = _doubt(task, some, final, kept, final.used)
    unit = task.size[kept]
    noise, form = (one * np.outer(unit, unit) for one in unsure)
    size = len(names)
    outliers.flags.writeable = False
    pose = pose_of(final.state, task.pivot)
    return Registration(
        pose=pose,
        names=tuple(NAMES[k] for k in names),
        pivot=(float(task.pivot[0]), float(task.pivot[1]), float(task.pivot[2])),
        covariance=noise[:size, :size],
        form_covariance=form[:size, :size],
        form_error=task.form,
        amplitudes=final.state[6:],
        amplitudes_std=np.sqrt(np.diag(noise)[size:]),
        residual=_fill_map(heights, task.which, residual, "residual"),
        error=_fill_map(heights, task.which, residual + _terms(problem, final.state), "error"),
        candidates=tuple(
            PoseCandidate(
                pose=pose_of(one.state, task.pivot),
                rms_nm=one.rms * NM,
                ratio=ratio,
                symmetric=_symmetric(task, final.state, one.state),
            )
            for one, ratio in candidates
        ),
        undetermined=undetermined,
        held=tuple(NAMES[k] for k in sorted(fixed)),
        start=pose_of(task.start, task.pivot),
        outliers=outliers,
        count=int(good.sum()),
        rms_nm=rms * NM,
        lost=int(task.which.size - np.count_nonzero(np.isfinite(residual))),
        noise_nm=(task.noise if task.seen is None else max(task.seen.white, MIN_NOISE_MM)) * NM,  # type: ignore[operator]
        correlated_nm=0.0 if task.seen is None else task.seen.correlated * NM,
        correlation_length=0.0 if task.seen is None else task.seen.length,
        iterations=final.steps,
        distance="normal" if problem.normal else "vertical",
    )


def _terms(problem: Problem, state: Floats) -> Floats | float:
    """Return the contribution of the terms at every point, along the fitted distance. [mm]."""
    if not problem.terms:
        return 0.0
    plain = replace(problem, terms=())
    return residuals(plain, state[:6]) - residuals(problem, state)


def _fill_map(heights: HeightMap, index: Ints, values: Floats, what: str) -> HeightMap:
    z = np.full(heights.z.size, np.nan)
    z[index] = values
    return replace(heights, z=z.reshape(heights.z.shape), name=f"{heights.name} {what}".strip())
