"""Least-squares fit of sources, poses and terms, with priors; the sizes of the terms and the noise are fitted too."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, robust_scatter
from turnwright.diagnosis.error_sources import Column, Columns
from turnwright.diagnosis.map_points import CENTRE_ZONE_MM, MapPoints
from turnwright.diagnosis.model import Cutting
from turnwright.diagnosis.posterior import Posterior, Scaled, posterior
from turnwright.diagnosis.terms import GROUPS, Group, columns, form_of, lobes_by_angle
from turnwright.errors import InputError

__all__ = ["MODEL_ERROR_MM", "POSE_SIGMA", "Estimate", "LinearSystem"]

POSE_SIGMA = np.array([0.05, 0.05, 1.0, 0.05, 0.01, 0.01, 0.01, 0.01, 1e-3])
"""Pose error of a registered map, one standard deviation: shift x, y, z [mm], rotation and tilts [rad], slopes [1] and
curvature [1/mm] of a sphere. This prior fixes the degrees of freedom that the surface does not determine."""

MAX_POSE_FACTOR = 10.0
"""In a direction that the surface determines, the registration was fitted to the map, errors of the part included, and
its error may be this many times larger: a tool offset of 20 um moves a map of the middle of a freeform by 0.5 mm."""

POSE_TOL_FRACTION = 0.01
"""The terms of form are recomputed if the points moved by more than this fraction of the radius."""

MIN_SIGNATURE_MM = 1e-8
"""A signature of plausible size below this, beyond a change of pose, is not observable."""

MODEL_ERROR_MM = 1e-8
"""Accuracy of the model."""

OUTLIER_SIGMA = 6.0
"""Points beyond this many robust standard deviations are rejected: next to a seam of the design, a chord of the program
or a pixel of the instrument causes errors of micrometres."""

CHANGE_SIGMA = (0.003, 1e-6, 0.1)
"""Change of a source from map to map in plausible units: start value and limits of the search."""

TOOL_SOURCES = frozenset({"radius error", "waviness"})
"""Sources that are the same in all cuts with a tool."""

MIN_DIFFERENCE_RATIO = 2e-3
"""Least difference of the terms of two cuts of a part, as a fraction of the start value of their size."""

START_DIFFERENCE_RATIO = 0.05
"""Start value of the differences between cuts, as a fraction of the start value of the common part."""

MAX_TERM_SIGMA, MAX_FORM_SIGMA = 1.4, 1.7
"""Largest term of a group in standard deviations: a few lobes may be much larger than the others, a term of form may
not."""

DRIFT_SIZES_MM = np.geomspace(0.3e-6, 40e-6, 9)
"""Sizes of a drift that are compared."""

EXCLUSION_LOG_RATIO = 2.0
"""A size is excluded if the logarithm of the probability of the maps is lower by more than this."""

START_NOISE_RATIO = 0.3
"""Start value of the noise, as a fraction of the residual."""

MAX_STEPS = 12
"""Most Gauss-Newton steps."""

FULL_STEPS, DAMPING = 3, 0.5
"""After this many full steps, later steps are damped by this factor: full steps overshoot in weakly determined
unknowns."""

FINAL_STEP_FRACTIONS = (0.5, 0.5, 0.5, 1.0)
"""Fractions of the final steps, with the sizes of all terms fixed."""

STEP_TOL = 0.3
"""The iteration ends if a step moves the fit by less than this fraction of the noise of a single unknown."""

SIZE_TOL = 0.03
"""Relative tolerance of the sizes."""

MAX_SIZE_ITERATIONS = 60

SQUARES = ((4, 4), (8, 8), (16, 16))
CELLS = ((48, 1), (1, 64), *SQUARES)
"""Rings and sectors over which residuals are averaged to measure their spatial correlation."""

RINGS, SECTORS, MIN_COMMON_CELLS = 16, 16, 64
"""Cells of equal area over which maps of one part are compared, and the least number of common cells."""

MIN_SHARED_CORRELATION = 0.3
"""Correlation of the residuals from which maps of one part are not independent."""

MIN_CORRELATED_POINTS = 1.5
"""From this number of correlated points on, the correlation is significant."""

PANEL_COLUMNS = 64
"""Columns of a panel in the triangular factorisation of a map."""

TERMS = sum(group.relative.size for group in GROUPS)
PLACES = tuple(
    slice(end - group.relative.size, end)
    for group, end in zip(GROUPS, itertools.accumulate(group.relative.size for group in GROUPS), strict=True)
)
"""Index range of the terms of each group."""


class LinearSystem(NamedTuple):
    """Linearised fit of one map: the effect of each unknown at its points, and the residual.

    The columns are the free unknowns of the pose in units of `POSE_SIGMA`, the sources in plausible units, the terms,
    and the residual.
    """

    rows: Floats  # (n, j + k + g + 1) [mm]
    root: Floats  # upper triangular factor of the rows
    numbers: list[int]  # free unknowns of the pose
    good: Bools
    turned: Floats  # effect of the offset along Y by rotation of the lobes, included in the rows (n,) [mm]
    counts: Floats  # factor from a height to the rows, which may be along the normal (n,)

    @property
    def poses(self) -> int:
        """Number of free unknowns of the pose."""
        return len(self.numbers)


class _Split(NamedTuple):
    """Decomposition of the unknowns of a map, c = own o + shared s, with o and s of unit prior."""

    own: Floats  # (c, o)
    shared: Floats  # (c, s)


@dataclass(slots=True, kw_only=True, eq=False)
class Estimate:
    """Maps, sources, and the current state of the fit."""

    all_points: list[MapPoints]
    columns: Columns
    sense: int
    radius: Sequence[float]  # of the part of each map [mm]
    kinds: Sequence[int | None]  # number of the set of maps of one part, None for the only map of a part
    values: Floats  # of the sources in each map (maps, k)
    scale: Floats  # noise of each map, scaled so that points count as independent [mm]
    correlated_points: Floats  # number of correlated points of each map that count as one
    stated: Floats  # lower bound of the noise of a height of each map, 0 for none [mm]
    plausible: Mapping[str, float]  # known sizes of the groups of terms [mm]
    own: Floats = field(init=False)  # variances of the groups of terms in each map (groups,) [mm² or rad²]
    common: Floats = field(init=False)  # of those that all maps of a part share (groups,)
    between: Floats = field(init=False)  # of the sources from map to map, in plausible units (sources,)
    forms: list[Floats] = field(init=False)  # columns of the terms of form (g, n) each
    form_poses: list[Floats] = field(init=False)  # poses at which these were computed
    pose_roots: list[Floats] = field(
        init=False
    )  # root of the prior covariance of each pose in units of POSE_SIGMA (j, j)
    terms: list[Floats] = field(init=False)  # current terms of each map (groups' terms,)
    seen: Bools = field(init=False)  # unknowns that are observable beyond a change of pose (k,)
    systems: list[LinearSystem] = field(init=False, default_factory=list)
    posterior: Posterior = field(init=False)

    def __post_init__(self) -> None:
        self.own = np.array([self._find_start_size(group) ** 2 for group in GROUPS])
        self.common = self.own.copy()
        if self.has_several_maps:  # otherwise errors that all cuts share may be attributed to each cut separately
            self.own *= START_DIFFERENCE_RATIO**2
        self.between = np.array(
            [CHANGE_SIGMA[1 if error_source in TOOL_SOURCES else 0] ** 2 for error_source in self.error_sources]
        )
        self.terms = [np.zeros(TERMS) for _ in self.all_points]
        self.forms = [np.zeros((0, 0)) for _ in self.all_points]
        self.form_poses = [np.full(map_points.pose.size, np.inf) for map_points in self.all_points]
        self.pose_roots = []
        self.seen = np.ones(len(self.names), dtype=np.bool_)

    def _find_start_size(self, group: Group) -> float:
        stated_size = self.plausible.get(group.name)
        return group.size if stated_size is None else stated_size / float(np.sqrt(group.relative.max()))

    def _is_fixed(self, group: Group) -> bool:
        return group.least == group.size or group.name in self.plausible

    @property
    def has_several_maps(self) -> bool:
        """Whether every map is one of several of its part."""
        return all(kind is not None for kind in self.kinds)

    @property
    def names(self) -> list[Column]:
        """All unknowns of the sources."""
        return self.columns.all

    @property
    def error_sources(self) -> list[str]:
        """The sources, in the order of their unknowns."""
        return list(dict.fromkeys(column.error_source for column in self.names))

    @property
    def typical(self) -> Floats:
        """Plausible size of each unknown. (k,)."""
        return np.array([column.typical for column in self.names])

    def of_source(self, error_source: str) -> list[int]:
        """Return the indices of the unknowns of a source."""
        return [k for k, column in enumerate(self.names) if column.error_source == error_source]

    def solve(self) -> None:
        """Solve for all unknowns, the poses, the noise and the sizes of the terms."""
        for step in range(MAX_STEPS):
            self.systems = [self._linearise(m) for m in range(len(self.all_points))]
            if step == 0:
                self.seen = self._find_observable()
                if not self.seen.all():
                    self.systems = [self._linearise(m) for m in range(len(self.all_points))]
                for m, system in enumerate(self.systems):
                    self.scale[m] = max(
                        START_NOISE_RATIO * float(np.std(system.rows[:, -1])), MODEL_ERROR_MM, self.stated[m]
                    )
                self.pose_roots = [self._find_pose_prior(m) for m in range(len(self.all_points))]
            self._find_sizes()
            self._measure_noise()
            if not self._reject_outliers() and self._take_step(1.0 if step < FULL_STEPS else DAMPING) < STEP_TOL:
                break
        self._enlarge_drift()
        for share in FINAL_STEP_FRACTIONS:  # with all sizes fixed, so that sources, terms and poses are consistent
            self.systems = [self._linearise(m) for m in range(len(self.all_points))]
            self.posterior = self._solve_posterior()
            self._take_step(share)

    def plausible_rms(self, m: int) -> float:
        """Return the rms effect of all sources on a map beyond its pose, each of plausible size. [mm]."""
        system = self._linearise(m)
        j, k = system.poses, self.typical.size
        return float(np.sqrt((system.root[j:, j : j + k] ** 2).sum() / system.rows.shape[0]))

    def _linearise(self, m: int) -> LinearSystem:
        map_points, values = self.all_points[m], self.values[m]
        residual, cutting = map_points.cut(self.columns.deviations(values))
        for error_source, mark in map_points.added.items():
            residual = residual - values[self.of_source(error_source)] @ mark
        good = map_points.usable & ~map_points.outliers & np.isfinite(residual) & (cutting.tip_radius >= 0)
        map_points.good = good
        marks, turned, numbers = self.marks(m, map_points, cutting, self._update_form(m))
        if (points := int(np.count_nonzero(good))) < (needed := len(numbers) + self.typical.size + 3):
            raise InputError(
                f"{points} points of the map can be used, {self.typical.size} numbers and a pose need at least "
                f"{needed}: measure more of the part, or set fewer error sources"
            )
        rows = np.column_stack([marks, residual])[good]
        counts = np.ones(points)
        if map_points.along_normal is not None:  # the instrument's noise is along the normal
            counts = 1 / np.sqrt(1 + cutting.zx[good] ** 2 + cutting.zy[good] ** 2)
            rows *= counts[:, None]
        return LinearSystem(rows, _reduce_to_triangle(rows), numbers, good, turned[good], counts)

    def marks(
        self, m: int, map_points: MapPoints, cutting: Cutting, form: Floats | None = None
    ) -> tuple[Floats, Floats, list[int]]:
        """Return the effect of each unknown of a map at some points, see `LinearSystem`: rows, turned and numbers."""
        typical, by_angle = self.typical, lobes_by_angle(cutting, self.terms[m])
        nuisances, numbers = map_points.nuisances(cutting, by_angle)
        marks = self.columns.slopes(cutting, map_points.added, self.sense, map_points.cusp) * typical
        marks[:, ~self.seen] = 0.0
        turned: Floats = np.zeros(cutting.x.size)
        for k in self.of_source("offset y"):
            away = np.maximum(np.hypot(cutting.x, cutting.y), CENTRE_ZONE_MM)
            turned = -by_angle / away * typical[k]
            marks[:, k] += turned
        return (
            np.column_stack([-nuisances * POSE_SIGMA[numbers], marks, columns(cutting, self.radius[m], form)]),
            turned,
            numbers,
        )

    def _update_form(self, m: int) -> Floats:
        """Return the columns of the terms of form at the points of a map. (g, n)."""
        map_points, radius = self.all_points[m], self.radius[m]
        off = np.abs(map_points.pose - self.form_poses[m])
        if np.hypot(off[0], off[1]) + off[3] * radius > POSE_TOL_FRACTION * radius:
            x, y, _ = map_points.moved()
            self.forms[m], self.form_poses[m] = form_of(x / radius, y / radius), map_points.pose.copy()
        return self.forms[m]

    def _find_pose_prior(self, m: int) -> Floats:
        """Return a root of the prior covariance of a pose, in units of `POSE_SIGMA`. (j, j)."""
        j = self.systems[m].poses
        _, heights, directions = np.linalg.svd(self.systems[m].root[:, :j], full_matrices=False)
        shown = (heights / self.scale[m]) ** 2
        wide = 1 + (MAX_POSE_FACTOR - 1) * shown / (1 + shown)
        return np.asarray((directions.T * wide) @ directions)

    def _find_observable(self) -> Bools:
        k = self.typical.size
        squares, points = np.zeros(k), 0
        for system in self.systems:
            squares += (system.root[system.poses :, system.poses : system.poses + k] ** 2).sum(axis=0)
            points += system.rows.shape[0]
        return np.asarray(np.sqrt(squares / points) > MIN_SIGNATURE_MM)

    def split(self, m: int) -> _Split:
        """Return the decomposition of the unknowns of a map, at the current sizes."""
        j, k = self.systems[m].poses, self.typical.size
        many = len(self.all_points) > 1
        kinds = 1 + max((kind for kind in self.kinds if kind is not None), default=-1)
        map_columns = np.zeros((j + k + TERMS, j + many * k + TERMS))
        map_columns[:j, :j] = self.pose_roots[m]
        if many:
            map_columns[j : j + k, j : j + k] = np.diag(np.sqrt(self.variance_between_maps()))
        map_columns[j + k :, -TERMS:] = np.diag(self._find_term_sigmas(self.own, even=len(self.all_points) == 1))
        shared = np.zeros((j + k + TERMS, k + kinds * TERMS))
        shared[j : j + k, :k] = np.eye(k)
        if (kind := self.kinds[m]) is not None:
            shared[j + k :, k + kind * TERMS : k + (kind + 1) * TERMS] = np.diag(
                self._find_term_sigmas(self.common, even=True)
            )
        return _Split(map_columns, shared)

    def _find_term_sigmas(self, sizes: Floats, *, even: bool) -> Floats:
        """Return the standard deviation of every term; with ``even``, a linear drift has at least its least size."""
        spread = []
        for size, group in zip(sizes.tolist(), GROUPS, strict=True):
            sigmas = np.sqrt(size * group.relative)
            if even and group.name not in self.plausible:
                sigmas[0] = max(sigmas[0], group.ramp)
            spread.append(sigmas)
        return np.concatenate(spread)

    def variance_between_maps(self) -> Floats:
        """Return the variance of each unknown from map to map. (k,)."""
        error_sources = self.error_sources
        return self.between[[error_sources.index(column.error_source) for column in self.names]]

    def target(self, m: int) -> Floats:
        """Return the target of the fit in the rows of the root: the residual with all unknowns but the pose at 0."""
        system = self.systems[m]
        j, k = system.poses, self.typical.size
        return np.asarray(system.root[:, -1] + system.root[:, j : j + k] @ (self.values[m] / self.typical))

    def numbers(self, m: int) -> Floats:
        """Return the unknowns of a map's columns. (j + k + g,)."""
        split = self.split(m)
        return np.asarray(split.own @ self.posterior.map_unknowns(m) + split.shared @ self.posterior.shared)

    def _solve_posterior(self) -> Posterior:
        scaled, prior_means = [], []
        for m, (system, scale) in enumerate(zip(self.systems, self.scale, strict=True)):
            split, columns = self.split(m), system.root[:, :-1] / scale
            scaled.append(Scaled(columns @ split.own, columns @ split.shared, self.target(m) / scale))
            mean = np.zeros(split.own.shape[1])
            map_points = self.all_points[m]
            away = (map_points.start_pose - map_points.pose)[system.numbers] / POSE_SIGMA[system.numbers]
            mean[: system.poses] = np.linalg.solve(self.pose_roots[m], away)
            prior_means.append(mean)
        return posterior(scaled, prior_means)

    def _find_sizes(self) -> None:
        """Find the noise and the sizes of the terms for which the maps are most probable."""
        for _ in range(MAX_SIZE_ITERATIONS):
            self.posterior = self._solve_posterior()
            variances = [self.posterior.variances(m) for m in range(len(self.all_points))]
            changes = [*self._update_noise(variances), *self._update_sizes(variances)]
            if max(changes, default=0.0) < SIZE_TOL and not self._pool_sizes():
                break

    def _pool_sizes(self) -> bool:
        """Attribute terms of the single cuts to all cuts where that is more probable; return whether any were.

        The search for the sizes is local. With maps that are decentred by different amounts it may end at a less
        probable solution, in which the terms that all cuts share are attributed to each cut separately.
        """
        if not self.has_several_maps:
            return False
        pooled = False
        for g, group in enumerate(GROUPS):
            if self._is_fixed(group) or self.own[g] <= self.common[g]:
                continue
            own_size, common, best = self.own[g], self.common[g], self._solve_posterior().evidence
            self.own[g], self.common[g] = START_DIFFERENCE_RATIO**2 * own_size, own_size
            if self._solve_posterior().evidence > best:
                pooled = True
            else:
                self.own[g], self.common[g] = own_size, common
        return pooled

    def _enlarge_drift(self) -> None:
        """Set the size of a drift to the largest that the maps do not exclude: sources may have absorbed a part."""
        for g, group in enumerate(GROUPS):
            if not group.name.startswith("drift") or group.name in self.plausible:
                continue
            sizes = self.common if self.has_several_maps else self.own
            current_size, evidence = sizes[g], []
            for size in DRIFT_SIZES_MM:
                sizes[g] = size**2
                evidence.append(self._solve_posterior().evidence)
            likely = np.flatnonzero(np.array(evidence) >= max(evidence) - EXCLUSION_LOG_RATIO)
            sizes[g] = max(current_size, min(DRIFT_SIZES_MM[likely[-1]], group.most) ** 2)

    def _update_noise(self, variances: Sequence[Floats]) -> list[float]:
        """Set the noise of each map to its residual; return the changes of its logarithm."""
        changes = []
        for m, system in enumerate(self.systems):
            residual = self.target(m) - system.root[:, :-1] @ self.numbers(m)
            points = system.rows.shape[0] / self.correlated_points[m]
            free = max(points - self._count_determined(variances[m]), 1.0)
            scale = max(float(np.sqrt(residual @ residual / free)), MODEL_ERROR_MM, float(self.stated[m]))
            changes.append(abs(float(np.log(scale / self.scale[m]))))
            self.scale[m] = scale
        return changes

    def _count_determined(self, variances: Floats) -> float:
        shared = self.posterior.shared.size
        determined = 1 - variances
        return float(determined[:-shared].sum() + determined[-shared:].sum() / len(self.all_points))

    def _update_sizes(self, variances: Sequence[Floats]) -> list[float]:
        """Set the sizes of the groups to those of the terms; return the changes of their logarithms."""
        changes: list[float] = []
        map_numbers = [self.posterior.map_unknowns(m) for m in range(len(self.all_points))]
        k = self.typical.size
        for g, (group, place) in enumerate(zip(GROUPS, PLACES, strict=True)):
            limits, most_sigmas = (
                (group.least**2, group.most**2),
                MAX_FORM_SIGMA if group.name == "low form" else MAX_TERM_SIGMA,
            )
            if group.ramp and len(self.all_points) == 1:
                place = slice(place.start + 1, place.stop)  # noqa: PLW2901 - the ramp has a size of its own
            values = np.stack([one[-TERMS:][place] for one in map_numbers])
            spread = np.stack(
                [each[: one.size][-TERMS:][place] for each, one in zip(variances, map_numbers, strict=True)]
            )
            # The differences between cuts of one part are always determined, so their size is always fitted.
            least = MIN_DIFFERENCE_RATIO**2 * group.size**2 if self.has_several_maps else limits[0]
            fixed = self._is_fixed(group)
            if self.has_several_maps or not fixed:
                self.own[g], change = _find_variance(self.own[g], values, spread, (least, limits[1]), most_sigmas)
                changes.append(change)
            if fixed:
                continue
            if any(kind is not None for kind in self.kinds):
                common_terms = self.posterior.shared[k:].reshape(-1, TERMS)[:, place]
                spread = (self.posterior.root[k:] ** 2).sum(axis=1).reshape(-1, TERMS)[:, place]
                self.common[g], change = _find_variance(self.common[g], common_terms, spread, limits, most_sigmas)
                changes.append(change)
        if len(self.all_points) > 1:
            for c, error_source in enumerate(self.error_sources):
                if error_source in TOOL_SOURCES:
                    continue
                numbers = self.of_source(error_source)
                at = [system.poses + np.array(numbers) for system in self.systems]
                values = np.stack([one[where] for one, where in zip(map_numbers, at, strict=True)])
                spread = np.stack([each[where] for each, where in zip(variances, at, strict=True)])
                self.between[c], change = _find_variance(
                    self.between[c], values, spread, (CHANGE_SIGMA[1] ** 2, CHANGE_SIGMA[2] ** 2)
                )
                changes.append(change)
        return changes

    def residual_of(self, m: int) -> Floats:
        """Return the residual at the points of a map. (n,) [mm]."""
        system = self.systems[m]
        j, k = system.poses, self.typical.size
        numbers = self.numbers(m)
        numbers[j : j + k] -= self.values[m] / self.typical
        return np.asarray(system.rows[:, -1] - system.rows[:, :-1] @ numbers)

    def _measure_noise(self) -> None:
        """Measure the spatial correlation of the residual of each map."""
        for m, system in enumerate(self.systems):
            split, roots = self.split(m), self.posterior.roots(m)
            spread = np.hstack([split.own, split.shared]) @ roots
            map_points = self.all_points[m]
            self.correlated_points[m] = _count_correlated_points(
                self.residual_of(m),
                system,
                spread / self.scale[m],
                map_points.x[system.good],
                map_points.y[system.good],
            )
        for kind in {one for one in self.kinds if one is not None}:
            alike = [m for m, one in enumerate(self.kinds) if one == kind]
            if (
                shared := self._correlate_residuals(alike)
            ) > MIN_SHARED_CORRELATION:  # for example cusps that the pixels sample alike
                self.correlated_points[alike] *= 1 + (len(alike) - 1) * shared

    def _correlate_residuals(self, maps: Sequence[int]) -> float:
        """Return the mean correlation between the residuals of maps of one part, averaged over cells."""
        means = []
        for m in maps:
            map_points, good = self.all_points[m], self.systems[m].good
            x, y = map_points.x[good] / self.radius[m], map_points.y[good] / self.radius[m]
            ring = np.minimum((RINGS * (x * x + y * y)).astype(np.int64), RINGS - 1)
            cell = ring * SECTORS + ((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64) % SECTORS
            number, total = (
                np.bincount(cell, weights=one, minlength=RINGS * SECTORS) for one in (None, self.residual_of(m))
            )
            means.append(np.where(number > 3, total / np.maximum(number, 1), np.nan))
        covered = np.isfinite(means).all(axis=0)
        if np.count_nonzero(covered) < MIN_COMMON_CELLS:
            return 0.0
        every = np.corrcoef(np.array(means)[:, covered])
        return float(np.mean(every[np.triu_indices(len(maps), 1)]))

    def _take_step(self, share: float) -> float:
        """Take a fraction of the step to the solution; return its length in units of the noise."""
        moved, every = 0.0, [self.numbers(m) for m in range(len(self.systems))]
        # The linearisation holds only near its pose.
        far = max(
            float(np.abs(numbers[: system.poses]).max(initial=0))
            for system, numbers in zip(self.systems, every, strict=True)
        )
        share = min(share, 1 / max(far, 1e-9))
        for m, system in enumerate(self.systems):
            j, k = system.poses, self.typical.size
            present = np.concatenate([np.zeros(j), self.values[m] / self.typical, self.terms[m]])
            step = share * (every[m] - present)
            numbers = present + step
            moved += float(np.sum((system.root[:, :-1] @ step / self.scale[m]) ** 2))
            self.all_points[m].pose[system.numbers] += POSE_SIGMA[system.numbers] * numbers[:j]
            self.values[m] = numbers[j : j + k] * self.typical
            self.terms[m] = numbers[j + k :]
        return float(np.sqrt(moved))

    def _reject_outliers(self) -> bool:
        """Reject outliers; return whether there were new ones."""
        new = False
        for m, system in enumerate(self.systems):
            off = self.residual_of(m)
            off = np.abs(off - np.median(off))
            out = off > OUTLIER_SIGMA * max(robust_scatter(off), MODEL_ERROR_MM)
            self.all_points[m].outliers[np.flatnonzero(system.good)[out]] = True
            new |= bool(out.any())
        return new


def _find_variance(
    size: float, values: Floats, variance: Floats, limits: tuple[float, float], most_sigmas: float = MAX_TERM_SIGMA
) -> tuple[float, float]:
    """Return the variance for which some values of unit prior are most probable, and the change of its logarithm.

    The largest value is at most ``most_sigmas`` standard deviations.
    """
    determined = max(float((1 - variance).sum()), 1e-9)
    likely = max(float((values**2).sum()) / determined, float((values**2).max()) / most_sigmas**2)
    new = float(np.clip(size * likely, *limits))
    return new, abs(float(np.log(new / size))) / 2


def _reduce_to_triangle(rows: Floats) -> Floats:
    """Return the triangular factor of some rows. (n, c) in, (min(n, c), c)."""
    from scipy.linalg.lapack import dgeqrt  # noqa: PLC0415 - costly to import

    # Panels that are factored recursively take half the time of those of `numpy.linalg.qr`.
    packed = dgeqrt(min(PANEL_COLUMNS, *rows.shape), np.asfortranarray(rows))[0]
    return np.triu(packed[: rows.shape[1]])


def _count_correlated_points(left: Floats, system: LinearSystem, spread: Floats, x: Floats, y: Floats) -> float:
    """Return the number of correlated points that count as one.

    If the residual were independent from point to point, means over cells of n points would scatter by 1/sqrt(n). The
    ratio of the observed variance to that is the number of correlated points. The degrees of freedom of the fit are
    accounted for.
    """
    from scipy.sparse import csr_array  # noqa: PLC0415 - costly to import

    rows = system.rows[:, :-1]
    taken_all = float(((system.root[:, :-1] @ spread) ** 2).sum())
    variance = max(float(left @ left) / max(left.size - taken_all, 1.0), MODEL_ERROR_MM**2)
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    order = np.argsort(np.argsort(radius)) / radius.size  # rings of equal numbers of points
    over: dict[tuple[int, int], float] = {}
    for rings, sectors in CELLS:
        cell = np.minimum((order * rings).astype(np.int64), rings - 1) * sectors
        cell += np.minimum(((angle / (2 * np.pi) + 0.5) * sectors).astype(np.int64), sectors - 1)
        number = np.bincount(cell, minlength=rings * sectors)
        filled = number > 3
        weight = np.where(filled, 1 / np.sqrt(np.maximum(number, 1)), 0.0)
        means = csr_array((weight[cell], (cell, np.arange(cell.size))), shape=(rings * sectors, cell.size))
        sums, taken = means @ left, float(((means @ rows @ spread) ** 2).sum())
        free = np.count_nonzero(filled) - taken
        if free > 4:
            over[rings, sectors] = float(sums @ sums) / free / variance
    correlated_points = max(1.0, *over.values()) if over else 1.0
    if correlated_points > MIN_CORRELATED_POINTS:
        # Cells that are not much larger than the correlation length underestimate the correlation, in proportion to
        # the ratio of outline to area: cells of twice the side length underestimate by half as much.
        for large, small in itertools.pairwise(SQUARES):
            if large in over and small in over:
                correlated_points = max(correlated_points, 2 * over[large] - over[small])
    return min(correlated_points, left.size / 4)
