"""One least squares of sources, poses and terms, with priors; sizes of the terms and noise from the maps themselves."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, robust_scatter
from turnwright.diagnosis.causes import Column, Columns
from turnwright.diagnosis.model import Cutting
from turnwright.diagnosis.posterior import Posterior, Scaled, posterior
from turnwright.diagnosis.sight import CENTRE, Sight
from turnwright.diagnosis.terms import GROUPS, Group, columns, form_of, lobes_by_angle
from turnwright.errors import InputError

__all__ = ["FLOOR", "LOOSE", "Estimate", "Look"]

LOOSE = np.array([0.05, 0.05, 1.0, 0.05, 0.01, 0.01, 0.01, 0.01, 1e-3])
"""How far a registered map may still be off its place, one standard deviation: shift x, y, z [mm], rotation and tilts
[rad], slopes [1] and curvature [1/mm] of a sphere. It holds those in place that the surface does not determine."""

FITTED = 10.0
"""A direction that the surface determines was fitted to the map, errors of the part included, and may be so many times
farther off: a tool that is off by 20 um moves a map of the middle of a freeform by half a millimetre."""

NEAR = 0.01
"""Points that moved by more than this share of the radius see another wave of the form."""

CANNOT = 1e-8
"""A mark whose plausible size, less what the pose explains of it, is smaller than this is none. [mm]"""

FLOOR = 1e-8
"""The model is no truer than this. [mm]"""

OUTSIDE = 6.0
"""Points this many standard deviations off, as the median sees it, are left out: beside a seam of the design a chord of
the program or a pixel of the instrument makes micrometres."""

BETWEEN = (0.003, 1e-6, 0.1)
"""Change of a source from map to map in plausible units: where its search begins, and its limits."""

EDGE = frozenset({"radius error", "waviness"})
"""Causes that are the same in all cuts with a tool."""

SAME = 2e-3
"""Terms of two cuts of a part may differ by as little as this share of where the search for their size begins."""

BEGUN = 0.05
"""Where the search for the size of what differs from cut to cut begins, as a share of that for what they share."""

FEW, MANY = 1.4, 1.7
"""The largest of the terms of a group is at most so many standard deviations: a few lobes may stand out of many, but
not a term of form."""

DRIFTS = np.geomspace(0.3e-6, 40e-6, 9)
"""Sizes of a drift that are tried. [mm]"""

EXCLUDED = 2.0
"""A size under which the maps are less probable than under another, by so much in the logarithm, is excluded."""

ROUGH = 0.3
"""Noise as a share of the residual, before anything is known."""

STEPS = 12
"""Gauss-Newton steps at most."""

WHOLE, DAMPED = 3, 0.5
"""After so many steps only this share of each is gone: where numbers hardly matter, whole steps overshoot."""

LAST = (0.5, 0.5, 0.5, 1.0)
"""Shares of the steps at the end, with the sizes of all terms held."""

SETTLED = 0.3
"""A step that moves the fit by less than this of the noise of a single number is the last."""

SIZED = 0.03
"""Sizes that change by less than this share are found."""

SEARCHES = 60

SQUARES = ((4, 4), (8, 8), (16, 16))
CELLS = ((48, 1), (1, 64), *SQUARES)
"""Rings and sectors over which residuals are averaged to see how far they hang together."""

RINGS, SECTORS, FEWEST = 16, 16, 64
"""Cells of equal area over which maps of one part are compared, and how many of them it needs."""

ALIKE = 0.3
"""Correlation of what is left from which maps of one part are not independent."""

HANGS = 1.5
"""From so many points that count as one on it is no chance of the sample."""

PANEL = 64
"""Columns at a time of the triangle of a map."""

TERMS = sum(group.relative.size for group in GROUPS)
PLACES = tuple(
    slice(end - group.relative.size, end)
    for group, end in zip(GROUPS, itertools.accumulate(group.relative.size for group in GROUPS), strict=True)
)
"""Where the terms of each group are."""


class Look(NamedTuple):
    """One map at the present numbers: what each number adds at its points, and what is measured beyond them all.

    The columns are the free numbers of the pose in units of `LOOSE`, the sources in plausible units, the terms, and the
    residual.
    """

    rows: Floats  # (n, j + k + g + 1) [mm]
    root: Floats  # the same in few rows, upper triangular: with the same products
    numbers: list[int]  # of the pose that are free
    good: Bools
    turned: Floats  # what the offset along Y adds by turning the lobes, which is in the rows too (n,) [mm]
    counts: Floats  # share of a height that is in the rows, which may be along the normal (n,)

    @property
    def poses(self) -> int:
        """How many numbers the pose has."""
        return len(self.numbers)


class _Split(NamedTuple):
    """What the numbers of a map's columns are made of: c = own o + shared s, of unit prior."""

    own: Floats  # (c, o)
    shared: Floats  # (c, s)


@dataclass(slots=True, kw_only=True, eq=False)
class Estimate:
    """Maps, sources, and what is known of them so far."""

    sights: list[Sight]
    columns: Columns
    sense: int
    radius: Sequence[float]  # of the part of each map [mm]
    kinds: Sequence[int | None]  # which set of maps of one part each map belongs to, if there are several of it
    values: Floats  # of the sources in each map (maps, k)
    scale: Floats  # of the noise of each map, so that points count as if they were independent [mm]
    together: Floats  # points of each map that count as one
    stated: Floats  # noise of a height of each map as it is known, 0 where it is not: it is taken for no less [mm]
    plausible: Mapping[str, float]  # sizes of the groups of terms that are known beforehand [mm]
    own: Floats = field(init=False)  # variances of the groups of terms in each map (groups,) [mm² or rad²]
    common: Floats = field(init=False)  # of those that all maps of a part share (groups,)
    between: Floats = field(init=False)  # of the causes from map to map, in plausible units (causes,)
    forms: list[Floats] = field(init=False)  # columns of the terms of form (g, n) each
    formed: list[Floats] = field(init=False)  # poses at which these were taken
    loose: list[Floats] = field(init=False)  # root of the prior covariance of each pose in units of LOOSE (j, j)
    terms: list[Floats] = field(init=False)  # of each map, as last found (groups' terms,)
    seen: Bools = field(init=False)  # which numbers leave something that no change of pose would (k,)
    looks: list[Look] = field(init=False, default_factory=list)
    posterior: Posterior = field(init=False)

    def __post_init__(self) -> None:
        self.own = np.array([self._begun(group) ** 2 for group in GROUPS])
        self.common = self.own.copy()
        if self.several:  # or what all cuts share may be found as what each of them has of its own
            self.own *= BEGUN**2
        self.between = np.array([BETWEEN[1 if cause in EDGE else 0] ** 2 for cause in self.causes])
        self.terms = [np.zeros(TERMS) for _ in self.sights]
        self.forms = [np.zeros((0, 0)) for _ in self.sights]
        self.formed = [np.full(sight.pose.size, np.inf) for sight in self.sights]
        self.loose = []
        self.seen = np.ones(len(self.names), dtype=np.bool_)

    def _begun(self, group: Group) -> float:
        """Return where the search for the size of a group begins, which is what it is if that is known."""
        known = self.plausible.get(group.name)
        return group.size if known is None else known / float(np.sqrt(group.relative.max()))

    def _known(self, group: Group) -> bool:
        """Whether the size of a group is not to be found."""
        return group.least == group.size or group.name in self.plausible

    @property
    def several(self) -> bool:
        """Whether every map is one of several of its part."""
        return all(kind is not None for kind in self.kinds)

    @property
    def names(self) -> list[Column]:
        """All numbers of the sources."""
        return self.columns.all

    @property
    def causes(self) -> list[str]:
        """What the numbers belong to."""
        return list(dict.fromkeys(column.cause for column in self.names))

    @property
    def typical(self) -> Floats:
        """Plausible size of each number. (k,)."""
        return np.array([column.typical for column in self.names])

    def of_cause(self, cause: str) -> list[int]:
        """Return which numbers belong to a cause."""
        return [k for k, column in enumerate(self.names) if column.cause == cause]

    def solve(self) -> None:
        """Find all numbers, the poses, the noise and the sizes of the terms."""
        for step in range(STEPS):
            self.looks = [self._look(m) for m in range(len(self.sights))]
            if step == 0:
                self.seen = self._seen()
                if not self.seen.all():
                    self.looks = [self._look(m) for m in range(len(self.sights))]
                for m, look in enumerate(self.looks):
                    self.scale[m] = max(ROUGH * float(np.std(look.rows[:, -1])), FLOOR, self.stated[m])
                self.loose = [self._loose(m) for m in range(len(self.sights))]
            self._settle()
            self._measure_noise()
            if not self._reject() and self._move(1.0 if step < WHOLE else DAMPED) < SETTLED:
                break
        self._widen()
        for share in LAST:  # with all sizes held, so that sources, terms and poses belong together
            self.looks = [self._look(m) for m in range(len(self.sights))]
            self.posterior = self._posterior()
            self._move(share)

    def plausible_rms(self, m: int) -> float:
        """Return what all sources make of a map beyond its pose, each as large as is plausible. [mm]."""
        look = self._look(m)
        j, k = look.poses, self.typical.size
        return float(np.sqrt((look.root[j:, j : j + k] ** 2).sum() / look.rows.shape[0]))

    def _look(self, m: int) -> Look:
        """Take one map at the present numbers."""
        sight, values = self.sights[m], self.values[m]
        residual, cutting = sight.cut(self.columns.deviations(values))
        for cause, mark in sight.added.items():
            residual = residual - values[self.of_cause(cause)] @ mark
        good = sight.usable & ~sight.apart & np.isfinite(residual) & (cutting.tip_radius >= 0)
        sight.good = good
        marks, turned, numbers = self.marks(m, sight, cutting, self._form(m))
        if (points := int(np.count_nonzero(good))) < (needed := len(numbers) + self.typical.size + 3):
            raise InputError(
                f"{points} points of the map can be used, {self.typical.size} numbers and a pose need at least "
                f"{needed}: measure more of the part, or look for fewer causes"
            )
        rows = np.column_stack([marks, residual])[good]
        counts = np.ones(points)
        if sight.stands is not None:  # the instrument's noise is along the normal
            counts = 1 / np.sqrt(1 + cutting.zx[good] ** 2 + cutting.zy[good] ** 2)
            rows *= counts[:, None]
        return Look(rows, _triangle(rows), numbers, good, turned[good], counts)

    def marks(
        self, m: int, sight: Sight, cutting: Cutting, form: Floats | None = None
    ) -> tuple[Floats, Floats, list[int]]:
        """Return what each number of a map adds at some points, see `Look`: rows, turned and numbers."""
        typical, by_angle = self.typical, lobes_by_angle(cutting, self.terms[m])
        nuisances, numbers = sight.nuisances(cutting, by_angle)
        marks = self.columns.slopes(cutting, sight.added, self.sense, sight.cusp) * typical
        marks[:, ~self.seen] = 0.0
        turned: Floats = np.zeros(cutting.x.size)
        for k in self.of_cause("offset y"):
            away = np.maximum(np.hypot(cutting.x, cutting.y), CENTRE)
            turned = -by_angle / away * typical[k]
            marks[:, k] += turned
        return (
            np.column_stack([-nuisances * LOOSE[numbers], marks, columns(cutting, self.radius[m], form)]),
            turned,
            numbers,
        )

    def _form(self, m: int) -> Floats:
        """Return the columns of the terms of form at the points of a map. (g, n)."""
        sight, radius = self.sights[m], self.radius[m]
        off = np.abs(sight.pose - self.formed[m])
        if np.hypot(off[0], off[1]) + off[3] * radius > NEAR * radius:
            x, y, _ = sight.moved()
            self.forms[m], self.formed[m] = form_of(x / radius, y / radius), sight.pose.copy()
        return self.forms[m]

    def _loose(self, m: int) -> Floats:
        """Return a root of the covariance of a pose beforehand, in units of `LOOSE`. (j, j)."""
        j = self.looks[m].poses
        _, heights, directions = np.linalg.svd(self.looks[m].root[:, :j], full_matrices=False)
        shown = (heights / self.scale[m]) ** 2
        wide = 1 + (FITTED - 1) * shown / (1 + shown)
        return np.asarray((directions.T * wide) @ directions)

    def _seen(self) -> Bools:
        """Say of which numbers anything is left that a change of pose cannot explain."""
        k = self.typical.size
        squares, points = np.zeros(k), 0
        for look in self.looks:
            squares += (look.root[look.poses :, look.poses : look.poses + k] ** 2).sum(axis=0)
            points += look.rows.shape[0]
        return np.asarray(np.sqrt(squares / points) > CANNOT)

    def split(self, m: int) -> _Split:
        """Return what the numbers of a map are made of, at the present sizes."""
        j, k = self.looks[m].poses, self.typical.size
        many = len(self.sights) > 1
        kinds = 1 + max((kind for kind in self.kinds if kind is not None), default=-1)
        own = np.zeros((j + k + TERMS, j + many * k + TERMS))
        own[:j, :j] = self.loose[m]
        if many:
            own[j : j + k, j : j + k] = np.diag(np.sqrt(self.between_numbers()))
        own[j + k :, -TERMS:] = np.diag(self._spread(self.own, even=len(self.sights) == 1))
        shared = np.zeros((j + k + TERMS, k + kinds * TERMS))
        shared[j : j + k, :k] = np.eye(k)
        if (kind := self.kinds[m]) is not None:
            shared[j + k :, k + kind * TERMS : k + (kind + 1) * TERMS] = np.diag(self._spread(self.common, even=True))
        return _Split(own, shared)

    def _spread(self, sizes: Floats, *, even: bool) -> Floats:
        """Return the standard deviation of every term; an even drift is one that nothing else tells of. (g,)."""
        spread = []
        for size, group in zip(sizes.tolist(), GROUPS, strict=True):
            own = np.sqrt(size * group.relative)
            if even and group.name not in self.plausible:
                own[0] = max(own[0], group.ramp)
            spread.append(own)
        return np.concatenate(spread)

    def between_numbers(self) -> Floats:
        """Return the variance of each number from map to map. (k,)."""
        causes = self.causes
        return self.between[[causes.index(column.cause) for column in self.names]]

    def target(self, m: int) -> Floats:
        """Return what there is to explain, in the rows of the root: the residual if all numbers but the pose were 0."""
        look = self.looks[m]
        j, k = look.poses, self.typical.size
        return np.asarray(look.root[:, -1] + look.root[:, j : j + k] @ (self.values[m] / self.typical))

    def numbers(self, m: int) -> Floats:
        """Return the numbers of a map's columns. (j + k + g,)."""
        split = self.split(m)
        return np.asarray(split.own @ self.posterior.own(m) + split.shared @ self.posterior.shared)

    def _posterior(self) -> Posterior:
        scaled, begun = [], []
        for m, (look, scale) in enumerate(zip(self.looks, self.scale, strict=True)):
            split, columns = self.split(m), look.root[:, :-1] / scale
            scaled.append(Scaled(columns @ split.own, columns @ split.shared, self.target(m) / scale))
            mean = np.zeros(split.own.shape[1])
            sight = self.sights[m]
            away = (sight.begun - sight.pose)[look.numbers] / LOOSE[look.numbers]
            mean[: look.poses] = np.linalg.solve(self.loose[m], away)
            begun.append(mean)
        return posterior(scaled, begun)

    def _settle(self) -> None:
        """Find noise and sizes of the terms under which the maps are most probable."""
        for _ in range(SEARCHES):
            self.posterior = self._posterior()
            variances = [self.posterior.variances(m) for m in range(len(self.sights))]
            changes = [*self._scales(variances), *self._sizes(variances)]
            if max(changes, default=0.0) < SIZED and not self._pooled():
                break

    def _pooled(self) -> bool:
        """Take terms that every cut has for ones that all share where that is more probable; say whether any were.

        Each size is sought near where it is. From maps that are decentred by different amounts the search may end
        where what all cuts share is found in each of them anew, though not as probable.
        """
        if not self.several:
            return False
        pooled = False
        for g, group in enumerate(GROUPS):
            if self._known(group) or self.own[g] <= self.common[g]:
                continue
            own, common, best = self.own[g], self.common[g], self._posterior().evidence
            self.own[g], self.common[g] = BEGUN**2 * own, own
            if self._posterior().evidence > best:
                pooled = True
            else:
                self.own[g], self.common[g] = own, common
        return pooled

    def _widen(self) -> None:
        """Give a drift the largest size that the maps do not exclude: sources may have taken what shows of it."""
        for g, group in enumerate(GROUPS):
            if not group.name.startswith("drift") or group.name in self.plausible:
                continue
            sizes = self.common if self.several else self.own
            found, evidence = sizes[g], []
            for size in DRIFTS:
                sizes[g] = size**2
                evidence.append(self._posterior().evidence)
            likely = np.flatnonzero(np.array(evidence) >= max(evidence) - EXCLUDED)
            sizes[g] = max(found, min(DRIFTS[likely[-1]], group.most) ** 2)

    def _scales(self, variances: Sequence[Floats]) -> list[float]:
        """Set the noise of each map to what is left; return by how much that changes its logarithm."""
        changes = []
        for m, look in enumerate(self.looks):
            left = self.target(m) - look.root[:, :-1] @ self.numbers(m)
            points = look.rows.shape[0] / self.together[m]
            free = max(points - self._spent(variances[m]), 1.0)
            scale = max(float(np.sqrt(left @ left / free)), FLOOR, float(self.stated[m]))
            changes.append(abs(float(np.log(scale / self.scale[m]))))
            self.scale[m] = scale
        return changes

    def _spent(self, variances: Floats) -> float:
        """Return how many numbers a map has told of its own."""
        shared = self.posterior.shared.size
        told = 1 - variances
        return float(told[:-shared].sum() + told[-shared:].sum() / len(self.sights))

    def _sizes(self, variances: Sequence[Floats]) -> list[float]:
        """Set the sizes of the groups to what the terms are; return by how much that changes their logarithms."""
        changes: list[float] = []
        own = [self.posterior.own(m) for m in range(len(self.sights))]
        k = self.typical.size
        for g, (group, place) in enumerate(zip(GROUPS, PLACES, strict=True)):
            limits, apart = (group.least**2, group.most**2), MANY if group.name == "low form" else FEW
            if group.ramp and len(self.sights) == 1:
                place = slice(place.start + 1, place.stop)  # noqa: PLW2901 - the ramp has a size of its own
            values = np.stack([one[-TERMS:][place] for one in own])
            spread = np.stack([each[: one.size][-TERMS:][place] for each, one in zip(variances, own, strict=True)])
            # How a cut differs from another of the same part hides in nothing, so that its size is always found.
            least = SAME**2 * group.size**2 if self.several else limits[0]
            known = self._known(group)
            if self.several or not known:
                self.own[g], change = _resized(self.own[g], values, spread, (least, limits[1]), apart)
                changes.append(change)
            if known:
                continue
            if any(kind is not None for kind in self.kinds):
                rest = self.posterior.shared[k:].reshape(-1, TERMS)[:, place]
                spread = (self.posterior.root[k:] ** 2).sum(axis=1).reshape(-1, TERMS)[:, place]
                self.common[g], change = _resized(self.common[g], rest, spread, limits, apart)
                changes.append(change)
        if len(self.sights) > 1:
            for c, cause in enumerate(self.causes):
                if cause in EDGE:
                    continue
                numbers = self.of_cause(cause)
                at = [look.poses + np.array(numbers) for look in self.looks]
                values = np.stack([one[where] for one, where in zip(own, at, strict=True)])
                spread = np.stack([each[where] for each, where in zip(variances, at, strict=True)])
                self.between[c], change = _resized(self.between[c], values, spread, (BETWEEN[1] ** 2, BETWEEN[2] ** 2))
                changes.append(change)
        return changes

    def left(self, m: int) -> Floats:
        """Return what is left at the points of a map. (n,) [mm]."""
        look = self.looks[m]
        j, k = look.poses, self.typical.size
        numbers = self.numbers(m)
        numbers[j : j + k] -= self.values[m] / self.typical
        return np.asarray(look.rows[:, -1] - look.rows[:, :-1] @ numbers)

    def _measure_noise(self) -> None:
        """Find how far what is left hangs together in each map."""
        for m, look in enumerate(self.looks):
            split, roots = self.split(m), self.posterior.roots(m)
            spread = np.hstack([split.own, split.shared]) @ roots
            sight = self.sights[m]
            self.together[m] = _together(
                self.left(m), look, spread / self.scale[m], sight.x[look.good], sight.y[look.good]
            )
        for kind in {one for one in self.kinds if one is not None}:
            alike = [m for m, one in enumerate(self.kinds) if one == kind]
            if (shared := self._shared(alike)) > ALIKE:  # cusps that the pixels hit alike in all of them, say
                self.together[alike] *= 1 + (len(alike) - 1) * shared

    def _shared(self, maps: Sequence[int]) -> float:
        """Return how far what is left in maps of one part is the same: the mean correlation of its means over cells."""
        means = []
        for m in maps:
            sight, good = self.sights[m], self.looks[m].good
            x, y = sight.x[good] / self.radius[m], sight.y[good] / self.radius[m]
            ring = np.minimum((RINGS * (x * x + y * y)).astype(np.int64), RINGS - 1)
            cell = ring * SECTORS + ((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64) % SECTORS
            number, total = (np.bincount(cell, weights=one, minlength=RINGS * SECTORS) for one in (None, self.left(m)))
            means.append(np.where(number > 3, total / np.maximum(number, 1), np.nan))
        known = np.isfinite(means).all(axis=0)
        if np.count_nonzero(known) < FEWEST:
            return 0.0
        every = np.corrcoef(np.array(means)[:, known])
        return float(np.mean(every[np.triu_indices(len(maps), 1)]))

    def _move(self, share: float) -> float:
        """Go a share of the way to the numbers and poses as found; return how far that led, in noise."""
        moved, every = 0.0, [self.numbers(m) for m in range(len(self.looks))]
        # The marks hold near the pose at which they were taken.
        far = max(
            float(np.abs(numbers[: look.poses]).max(initial=0)) for look, numbers in zip(self.looks, every, strict=True)
        )
        share = min(share, 1 / max(far, 1e-9))
        for m, look in enumerate(self.looks):
            j, k = look.poses, self.typical.size
            here = np.concatenate([np.zeros(j), self.values[m] / self.typical, self.terms[m]])
            step = share * (every[m] - here)
            numbers = here + step
            moved += float(np.sum((look.root[:, :-1] @ step / self.scale[m]) ** 2))
            self.sights[m].pose[look.numbers] += LOOSE[look.numbers] * numbers[:j]
            self.values[m] = numbers[j : j + k] * self.typical
            self.terms[m] = numbers[j + k :]
        return float(np.sqrt(moved))

    def _reject(self) -> bool:
        """Leave out points that stand out of the rest; say whether there were new ones."""
        new = False
        for m, look in enumerate(self.looks):
            off = self.left(m)
            off = np.abs(off - np.median(off))
            out = off > OUTSIDE * max(robust_scatter(off), FLOOR)
            self.sights[m].apart[np.flatnonzero(look.good)[out]] = True
            new |= bool(out.any())
        return new


def _resized(
    size: float, values: Floats, variance: Floats, limits: tuple[float, float], apart: float = FEW
) -> tuple[float, float]:
    """Return the variance under which some numbers of unit prior are most probable, and its change as a logarithm.

    The largest of the numbers is at most ``apart`` standard deviations.
    """
    determined = max(float((1 - variance).sum()), 1e-9)
    likely = max(float((values**2).sum()) / determined, float((values**2).max()) / apart**2)
    new = float(np.clip(size * likely, *limits))
    return new, abs(float(np.log(new / size))) / 2


def _triangle(rows: Floats) -> Floats:
    """Return the triangle of few rows with the same products. (n, c) in, (min(n, c), c)."""
    from scipy.linalg.lapack import dgeqrt  # noqa: PLC0415 - costly to import

    # Panels that are factored recursively take half the time of those of `numpy.linalg.qr`.
    packed = dgeqrt(min(PANEL, *rows.shape), np.asfortranarray(rows))[0]
    return np.triu(packed[: rows.shape[1]])


def _together(left: Floats, look: Look, spread: Floats, x: Floats, y: Floats) -> float:
    """Return how many points count as one.

    If the residual were independent from point to point, means over cells of n points would scatter by 1/sqrt(n); by
    how much more they scatter is how many points count as one. What the fit has taken from them is accounted for.
    """
    from scipy.sparse import csr_array  # noqa: PLC0415 - costly to import

    rows = look.rows[:, :-1]
    taken_all = float(((look.root[:, :-1] @ spread) ** 2).sum())
    variance = max(float(left @ left) / max(left.size - taken_all, 1.0), FLOOR**2)
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
    together = max(1.0, *over.values()) if over else 1.0
    if together > HANGS:
        # Cells that are not far larger than what hangs together see too little of it, by a share as their outline is
        # to their area: twice as long sides miss half as much.
        for large, small in itertools.pairwise(SQUARES):
            if large in over and small in over:
                together = max(together, 2 * over[large] - over[small])
    return min(together, left.size / 4)
