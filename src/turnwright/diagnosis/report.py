"""What an estimate says of a part, in numbers, maps and words."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen
from turnwright.diagnosis.estimate import LOOSE, PLACES, TERMS, Estimate, Look
from turnwright.diagnosis.findings import NM, Contribution, Diagnosis, DrawnCut, Draws, Finding, Said, around, judge
from turnwright.diagnosis.model import Deviations, Sweeps
from turnwright.diagnosis.sight import Sight, mark, sights_of, valid
from turnwright.diagnosis.terms import GROUPS, columns, described, tip_motion
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.part import evenly
from turnwright.pose import Pose
from turnwright.tool import LARGEST_ERROR, Tool, WavinessTable

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.part import Part

__all__ = ["Asked", "reported"]

MISSED = 0.05
"""Chance that an interval misses the true value."""

ALIKE = 0.95
"""Correlation from which two findings are named as such."""

TOLD = 0.5
"""A number whose uncertainty is below this share of what was plausible is determined."""

CERTAIN = 0.5
"""What a cause makes of the form is known if its uncertainty is below this share of it."""

DRAWS = 200
DRAWN = 2_000
"""Places at which a further part is drawn."""

BACK = 3
"""Steps back to what a map allows."""

CASES = 5
"""Draws that can be simulated in full."""

CERTIFICATE = 721
"""Points over the arc of the edge that is found."""


class _Numbers(NamedTuple):
    """All that is known of the sources, in their units."""

    value: Floats  # (k,)
    covariance: Floats  # (k, k)
    dof: float

    @property
    def std(self) -> Floats:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def half(self) -> Floats:
        """Return half the widths of intervals that hold the numbers in 95 of 100 cases. (k,)."""
        from scipy.special import stdtrit  # noqa: PLC0415 - costly to import

        return float(stdtrit(self.dof, 1 - MISSED / 2)) * self.std


class Asked(NamedTuple):
    """What was planned, and what is asked of the report."""

    tool: Tool
    machine: Machine
    worth_nm: float
    repeats: bool
    allowed: frozenset[str] | None  # causes that may be corrected by tool and machine; None if all may


def reported(
    estimate: Estimate, maps: Sequence[HeightMap], thin: Sequence[HeightMap], parts: Sequence[Part], asked: Asked
) -> Diagnosis:
    """Return all that an estimate says."""
    numbers = _numbers(estimate)
    findings = _findings(estimate, numbers, asked)
    certain = np.array([one.verdict == "correct" for one in findings])
    corrected = certain & np.array([one.cause in MOVING for one in findings])
    effect = [float(one.rms_nm) for one in findings]
    order = sorted(range(len(findings)), key=lambda k: (not certain[k], -effect[k], k))
    likely = np.where(_of_the_cut(estimate), numbers.value, 0.0)
    real_tool, real_machine = _as_found(estimate, np.where(corrected, numbers.value, 0.0), asked)
    likely_tool, likely_machine = real_tool, real_machine
    with suppress(InputError):  # an edge that no tool can have
        likely_tool, likely_machine = _as_found(estimate, likely, asked)
    whole = [
        _Whole.of(estimate, m, one, few, part, corrected, asked.repeats)
        for m, (one, few, part) in enumerate(zip(maps, thin, parts, strict=True))
    ]
    measured, explained, left = _rms_nm(estimate)
    std = np.where(numbers.std > 0, numbers.std, np.inf)
    return Diagnosis(
        findings=tuple(findings[k] for k in order),
        contributions=_contributions(estimate),
        names=tuple(column.name for column in estimate.names),
        correlation=frozen(numbers.covariance / np.outer(std, std), "correlation", ndim=2),
        residuals=tuple(one.residual for one in whole),
        remainders=tuple(one.remainder for one in whole),
        fields=tuple(one.field for one in whole),
        poses=tuple(_pose(sight) for sight in estimate.sights),
        measured_rms_nm=measured, explained_rms_nm=explained, unexplained_rms_nm=left,
        noise_nm=tuple((np.maximum(estimate.scale / np.sqrt(estimate.together), estimate.stated) * NM).tolist()),
        together=tuple(estimate.together.tolist()),
        repeatability_nm=_repeatability_nm(estimate),
        rejected=tuple(int(np.count_nonzero(sight.apart)) for sight in estimate.sights),
        signatures=tuple(_signatures(estimate, m, one) for m, one in enumerate(thin)),
        draws=lambda m: _draws(estimate, m, corrected, parts[m], asked),
        tool=real_tool, machine=real_machine, likely_tool=likely_tool, likely_machine=likely_machine,
        on=partial(_elsewhere, estimate, asked),
    )  # fmt: skip


def _numbers(estimate: Estimate) -> _Numbers:
    typical = estimate.typical
    k, posterior = typical.size, estimate.posterior
    root = posterior.root[:k] * typical[:, None]
    points = sum(look.rows.shape[0] / one for look, one in zip(estimate.looks, estimate.together, strict=True))
    return _Numbers(posterior.shared[:k] * typical, root @ root.T, max(points - TERMS, 1.0))


def _beyond_pose(estimate: Estimate, m: int) -> Floats:
    """Return what every column of a map adds beyond a change of pose, with the same squares per point. (r, c) [mm]."""
    look = estimate.looks[m]
    return np.asarray(look.root[look.poses :, look.poses : -1] / np.sqrt(look.rows.shape[0]))


def _findings(estimate: Estimate, numbers: _Numbers, asked: Asked) -> list[Finding]:
    worth_nm = asked.worth_nm
    k, typical, many = estimate.typical.size, estimate.typical, len(estimate.sights)
    half, std = numbers.half(), numbers.std
    marks = [_beyond_pose(estimate, m)[:, :k] / typical for m in range(many)]
    pv = _pv(estimate, numbers.value)
    by_cause = {cause: _cause(estimate, cause, marks, numbers) for cause in estimate.causes}
    findings = []
    for i, column in enumerate(estimate.names):
        value, seen = float(numbers.value[i]), bool(estimate.seen[i])
        rms, uncertain, between = by_cause[column.cause]
        differs = many > 1 and between > worth_nm
        each = tuple(estimate.values[:, i].tolist()) if differs else ()
        verdict, why = judge(
            Said(
                column=column, value=value, whole=around(value, float(half[i]), column.unit), seen=seen,
                determined=bool(std[i] < TOLD * typical[i]), significant=abs(value) > half[i],
                certain=uncertain < CERTAIN * rms, rms_nm=rms, worth_nm=worth_nm, each=each,
                allowed=asked.allowed is None or column.cause in asked.allowed, steady=between < rms,
            )
        )  # fmt: skip
        alike = [
            (other.name, float(numbers.covariance[i, j] / (std[i] * std[j])))
            for j, other in enumerate(estimate.names)
            if j != i and seen and estimate.seen[j]
        ]
        own = np.sqrt(np.mean([np.sum((one[:, i] * value) ** 2) for one in marks])) * NM
        findings.append(
            Finding(
                name=column.name, cause=column.cause, value=value, unit=column.unit, plausible=column.typical,
                standard_uncertainty=float(std[i]), interval=(value - float(half[i]), value + float(half[i])),
                rms_nm=float(own), pv_nm=float(pv[i]) * NM,
                correlated_with=tuple(
                    sorted((pair for pair in alike if abs(pair[1]) > ALIKE), key=lambda pair: -abs(pair[1]))
                ),
                determined=seen and bool(std[i] < TOLD * typical[i]), verdict=verdict, why=why,
                repeatable=None if many == 1 or not seen else not differs, each=each,
            )
        )  # fmt: skip
    return findings


def _cause(estimate: Estimate, cause: str, marks: Sequence[Floats], numbers: _Numbers) -> tuple[float, float, float]:
    """Return what a cause makes of the form, how uncertain that is, and how it differs between maps. rms [nm]."""
    at = estimate.of_cause(cause)
    squares = np.zeros(3)
    for one, values in zip(marks, estimate.values, strict=True):
        own = one[:, at]
        squares += [
            np.sum((own @ numbers.value[at]) ** 2),
            np.sum((own.T @ own) * numbers.covariance[np.ix_(at, at)]),
            np.sum((own @ (values - numbers.value)[at]) ** 2),
        ]
    rms, uncertain, between = np.sqrt(squares / len(marks)) * NM
    return float(rms), float(uncertain), float(between)


def _pv(estimate: Estimate, value: Floats) -> Floats:
    """Return peak to valley of what each number makes beyond a change of pose. (k,) [mm]."""
    tops = np.zeros(value.size)
    for look in estimate.looks:
        j = look.poses
        marks = look.rows[:, j : j + value.size] / estimate.typical
        pose = np.linalg.lstsq(look.rows[:, :j], marks, rcond=1e-12)[0] if j else np.zeros((0, value.size))
        tops = np.maximum(tops, np.ptp((marks - look.rows[:, :j] @ pose) * value, axis=0))
    return tops


def _contributions(estimate: Estimate) -> tuple[Contribution, ...]:
    found = []
    for name in dict.fromkeys(group.name for group in GROUPS):
        at = np.concatenate(
            [np.arange(TERMS)[place] for group, place in zip(GROUPS, PLACES, strict=True) if group.name == name]
        )
        squares, several = np.zeros(3), False
        for m in range(len(estimate.sights)):
            k = estimate.typical.size
            rows = _beyond_pose(estimate, m)[:, k + at]
            split = estimate.split(m)
            spread = (np.hstack([split.own, split.shared]) @ estimate.posterior.roots(m))[-TERMS:][at]
            common = (split.shared @ estimate.posterior.shared)[-TERMS:][at]
            several |= estimate.kinds[m] is not None
            squares += [
                np.sum((rows @ estimate.numbers(m)[-TERMS:][at]) ** 2), np.sum((rows @ spread) ** 2),
                np.sum((rows @ common) ** 2),
            ]  # fmt: skip
        rms, uncertain, common_nm = (np.sqrt(squares / len(estimate.sights)) * NM).tolist()
        text = described(name, np.mean([estimate.numbers(m)[-TERMS:] for m in range(len(estimate.sights))], axis=0))
        found.append(
            Contribution(
                name=name, rms_nm=rms, uncertainty_nm=uncertain, common_nm=common_nm if several else None,
                why=f"{name} makes {rms:.3g} nm rms, known within {uncertain:.2g} nm{text}",
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda one: -one.rms_nm))


def _rms_nm(estimate: Estimate) -> tuple[float, float, float]:
    """Return root mean squares: of what was measured beyond a change of pose, of what explains it, of what is left.

    It was measured where the map was registered, which may be off what is found: errors of the part moved it there.
    """
    sums, count = np.zeros(3), 0
    for m, look in enumerate(estimate.looks):
        sight = estimate.sights[m]
        registered = replace(sight, pose=sight.begun.copy(), sweeps=Sweeps(*(one.copy() for one in sight.sweeps)))
        measured = registered.cut(estimate.columns.deviations(np.zeros(estimate.typical.size)))[0]
        measured, left = measured[look.good] * look.counts, estimate.left(m)
        pose = look.rows[:, : look.poses]
        known = np.isfinite(measured)
        both = np.stack([measured, measured - left], axis=1)[known]
        both -= pose[known] @ np.linalg.lstsq(pose[known], both, rcond=1e-12)[0]
        sums += [*(both**2).sum(axis=0), float(left[known] @ left[known])]
        count += int(np.count_nonzero(known))
    measured_nm, explained_nm, left_nm = (np.sqrt(sums / count) * NM).tolist()
    return measured_nm, explained_nm, left_nm


def _repeatability_nm(estimate: Estimate) -> float | None:
    """Return root mean square of what differs from one map of a part to another, beyond a change of pose."""
    squares, freedom = 0.0, 0
    k = estimate.typical.size
    for kind in dict.fromkeys(estimate.kinds):
        alike = [m for m, one in enumerate(estimate.kinds) if one == kind]
        if kind is None or len(alike) < 2:
            continue
        own = [(estimate.split(m).own @ estimate.posterior.own(m))[estimate.looks[m].poses :] for m in alike]
        mean = np.mean(own, axis=0)
        for m, one in zip(alike, own, strict=True):
            squares += float(np.sum((_beyond_pose(estimate, m)[:, : k + TERMS] @ (one - mean)) ** 2))
        freedom += len(alike) - 1
    return math.sqrt(squares / freedom) * NM if freedom else None


def _signatures(estimate: Estimate, m: int, heights: HeightMap) -> Mapping[str, HeightMap]:
    """Return what every number and group of terms makes of a map beyond a change of pose."""
    look, k = estimate.looks[m], estimate.typical.size
    j, numbers = look.poses, estimate.numbers(m)
    fields = {column.name: look.rows[:, j + i] * numbers[j + i] for i, column in enumerate(estimate.names)}
    for group, place in zip(GROUPS, PLACES, strict=True):
        own = look.rows[:, j + k : -1][:, place] @ numbers[j + k :][place]
        fields[group.name] = fields.get(group.name, 0.0) + own
    made = np.stack([*fields.values()], axis=1)
    pose = look.rows[:, :j]
    made = made - pose @ np.linalg.lstsq(pose, made, rcond=1e-12)[0] if j else made
    out = {}
    for name, one in zip(fields, made.T, strict=True):
        every = np.full(look.good.size, np.nan)
        every[look.good] = one
        out[name] = _on(heights, every, estimate.sights[m])
    return MappingProxyType(out)


class _Places(NamedTuple):
    """Where a further part is drawn."""

    sight: Sight
    rows: Floats  # see `Look` (n, j + k + g) [mm]
    turned: Floats  # (n,) [mm]
    planned: Floats  # heights that are left as planned (n,) [mm]
    taken: Floats  # and by the corrected sources beyond that (n,) [mm]

    @classmethod
    def of(
        cls, estimate: Estimate, m: int, sight: Sight, rows: Floats, turned: Floats, found: Floats
    ) -> _Places:  # fmt: skip
        """Return those of some places that all tools cut."""
        ends = [_made(estimate, sight, values) for values in (np.zeros(found.size), found, estimate.values[m])]
        known = np.flatnonzero(np.isfinite(ends).all(axis=0) & np.isfinite(rows).all(axis=1))
        planned, taken = ends[0][known], ends[1][known]
        return cls(_some_of(sight, known), rows[known], turned[known], planned, taken - planned)

    def off(self, estimate: Estimate, m: int, numbers: Floats) -> Floats:
        """Return cut minus design of draws: what moves the edge in full, all else in proportion. (draws, n) [mm]."""
        poses, k = estimate.looks[m].poses, estimate.typical.size
        moving = np.array([column.cause in MOVING for column in estimate.names])
        others = np.append(
            poses + np.flatnonzero(_of_the_cut(estimate) & ~moving), np.arange(poses + k, len(numbers.T))
        )
        values = numbers[:, poses : poses + k] * np.where(moving, estimate.typical, 0.0)
        made = np.stack([_made(estimate, self.sight, one) for one in values]) - self.planned
        for i in estimate.of_cause("offset y"):  # only what differs from that at which the lobes were found turns them
            turn = numbers[:, poses + i, None] - estimate.values[m][i] / estimate.typical[i]
            made += turn * self.turned
        return np.asarray(made + numbers[:, others] @ self.rows[:, others].T)


def _draws(estimate: Estimate, m: int, corrected: Bools, part: Part, asked: Asked) -> Draws:
    """Return how a further part, cut like that of a map, may be off."""
    look, k = estimate.looks[m], estimate.typical.size
    random = np.random.default_rng(1)
    found = np.where(corrected, estimate.posterior.shared[:k] * estimate.typical, 0.0)
    beyond = _unmeasured(estimate, m, part, asked.tool)
    most = DRAWN - (0 if beyond is None else beyond.x.size)
    some = np.arange(0, look.rows.shape[0], -(-look.rows.shape[0] // most))
    sight = _some_of(estimate.sights[m], np.flatnonzero(look.good)[some])
    shown = _Places.of(estimate, m, sight, look.rows[some, :-1], look.turned[some], found)
    numbers, lacking, moved = _drawn(estimate, m, shown, random)
    single = estimate.kinds[m] is None
    if single and not asked.repeats:  # the next part has another drift and form of the same size
        sources = np.flatnonzero(~corrected & _of_the_cut(estimate))
        at = np.append(look.poses + sources, look.poses + k + np.flatnonzero(~LASTING))
        numbers[:, at] *= random.normal(size=(DRAWS, 1))
    places = [shown]
    if beyond is not None:
        _, cutting = beyond.cut(estimate.columns.deviations(estimate.values[m]))
        rows, turned, _ = estimate.marks(m, beyond, cutting)
        places.append(_Places.of(estimate, m, beyond, rows, turned, found))
    rows = np.concatenate([one.rows for one in places])
    # The tool of a draw may leave a point out.
    before = np.nan_to_num(np.hstack([one.off(estimate, m, numbers) for one in places]))
    before[:, : lacking.shape[1]] += lacking
    x, y = (np.concatenate(one) for one in zip(*(one.sight.moved()[:2] for one in places), strict=True))
    shift, turn = _aside(look, moved)
    return Draws(
        x=x, y=y, before=before, after=before - np.concatenate([one.taken for one in places]), single=single,
        pose=rows[:, : look.poses], places=np.stack([x + shift[:, :1] - turn * y, y + shift[:, 1:] + turn * x], axis=1),
        unmeasured=0.0 if beyond is None else beyond.x.size / DRAWN,
        cases=tuple(itertools.islice(_cases(estimate, m, numbers, lacking, rows, asked), CASES)),
    )  # fmt: skip


def _unmeasured(estimate: Estimate, m: int, part: Part, tool: Tool) -> Sight | None:
    """Return places of a part that a map leaves out, out of `DRAWN` evenly over it; ``None`` if there are few."""
    from scipy.spatial import KDTree  # noqa: PLC0415 - costly to import

    sight = estimate.sights[m]
    if sight.sphere is not None:
        return None
    x, y, _ = sight.moved()
    places = _nominal(part, DRAWN)
    apart = KDTree(np.stack([x, y], axis=1)[sight.good]).query(np.stack(places.points(), axis=1))[0]
    out = apart > AWAY * part.radius / math.sqrt(DRAWN)
    if np.count_nonzero(out) < LEFT_OUT * DRAWN:
        return None
    x, y = (one[out] for one in places.points())
    places = HeightMap(x=x, y=y, z=places.z[out], name=part.name)
    with suppress(InputError):  # where the tool does not cut
        (beyond,), _ = sights_of([places], [part], tool, sight.free, "true form", estimate.sense, 0.0)
        beyond.cusp = sight.cusp
        mark(beyond, estimate.columns)
        return beyond
    return None


AWAY, LEFT_OUT = 4.0, 0.02
"""Places so many spacings of the draws away from all points of a map are not measured; this share of them is few."""


def _nominal(part: Part, count: int) -> HeightMap:
    """Return the design at places evenly over a part."""
    x, y = evenly(part, count)
    return HeightMap(x=x, y=y, z=part.surface.sag(x, y), name=part.name)


def _aside(look: Look, poses: Floats) -> tuple[Floats, Floats]:
    """Return how far some changes of pose lead along x and y (draws, 2) [mm], and around z (draws, 1) [rad]."""
    every = np.zeros((poses.shape[0], LOOSE.size))
    every[:, look.numbers] = poses * LOOSE[look.numbers]
    return every[:, :2], every[:, 3:4]


def _cases(
    estimate: Estimate, m: int, numbers: Floats, lacking: Floats, rows: Floats, asked: Asked
) -> Iterator[DrawnCut]:
    """Yield draws that can be simulated in full: of those that lack the least."""
    size = (lacking**2).sum(axis=1)
    for number in np.flatnonzero(size <= np.median(size)).tolist():
        with suppress(InputError):  # an edge that no tool can have
            yield _case(estimate, m, number, numbers[number], rows, asked)


def _drawn(estimate: Estimate, m: int, places: _Places, random: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return draws of the numbers of a further part that is cut like that of a map, what these lack, and poses.

    Each (draws, *).

    Where sources may be large, their heights bend away from their marks, and by that much a draw would miss the map.
    Steps of least squares, from what it misses, take it back to what the map allows. What they cannot take back is what
    the draw lacks: heights at the places of the rows. [mm] The poses are those of the map, beyond that which was found,
    in units of `LOOSE`.
    """
    look, split, k = estimate.looks[m], estimate.split(m), estimate.typical.size
    off, rows = partial(places.off, estimate, m), places.rows
    shared, owns = estimate.posterior.draws(DRAWS, random)
    own = owns[m]
    found, first = estimate.numbers(m), look.poses + k
    found[look.poses : first] = estimate.values[m] / estimate.typical
    cut = np.r_[np.zeros(look.poses, dtype=np.bool_), _of_the_cut(estimate), np.ones(TERMS, dtype=np.bool_)]
    drawn = own @ split.own.T + shared @ split.shared.T
    wanted = off(found[None]) + ((drawn - found) * cut) @ rows.T
    columns = rows @ np.hstack([split.own, split.shared]) / estimate.scale[m]
    root, weight = estimate.posterior.roots(m), look.rows.shape[0] / rows.shape[0]
    alike = sum(kind is not None and kind == estimate.kinds[m] for kind in estimate.kinds)
    pose = np.linalg.qr(rows[:, : look.poses])[0]
    best, lacking, uncut = (own, shared), np.full(wanted.shape, np.inf), np.full(len(own), wanted.shape[1])
    for _ in range(BACK + 1):
        lack = wanted - off(own @ split.own.T + shared @ split.shared.T)
        missing = np.count_nonzero(~np.isfinite(lack), axis=1)
        lack = np.where(np.isfinite(lack), lack, wanted)
        lack -= (lack @ pose) @ pose.T
        # A tool that cuts nothing lacks all that is wanted, which may be less than what a draw lacks.
        nearer = (missing <= uncut) & ((lack**2).sum(axis=1) < (lacking**2).sum(axis=1))
        uncut = np.where(nearer, missing, uncut)
        best = np.where(nearer[:, None], own, best[0]), np.where(nearer[:, None], shared, best[1])
        lacking = np.where(nearer[:, None], lack, lacking)
        back = (lack / estimate.scale[m] * weight) @ columns @ root @ root.T
        if not alike:
            own = own + back[:, : own.shape[1]]
        shared = shared + max(alike, 1) * back[:, own.shape[1] :]  # maps of one part bend alike
    own, shared = best
    moved = (own @ split.own.T)[:, : look.poses] - found[: look.poses]
    return _further(estimate, m, own, random) @ split.own.T + shared @ split.shared.T, lacking, moved


def _some_of(sight: Sight, some: Ints) -> Sight:
    """Return a map with some of its points."""
    return replace(
        sight, x=sight.x[some], y=sight.y[some], z=sight.z[some], sweeps=Sweeps(*(one[some] for one in sight.sweeps)),
        added={cause: one[:, some] for cause, one in sight.added.items()}, usable=sight.usable[some],
        good=sight.good[some], apart=sight.apart[some], stands=None if sight.stands is None else sight.stands[some],
    )  # fmt: skip


LASTING = np.concatenate([np.full(group.relative.size, group.lasting) for group in GROUPS])


def _of_the_cut(estimate: Estimate) -> Bools:
    """Return which numbers belong to the cut, not to the mount. (k,)."""
    return np.array([column.cause not in MOUNT for column in estimate.names])


def _elsewhere(estimate: Estimate, asked: Asked, part: Part) -> Draws:
    """Return how another part may be off by the sources, and the residual if all are planned with.

    What the spindle does comes along, and stays.
    """
    thin, k = estimate.sights[0], estimate.typical.size
    (sight,), _ = sights_of(
        [_nominal(part, ELSEWHERE)], [part], asked.tool, thin.free, "true form", estimate.sense, 0.0
    )
    mark(sight, estimate.columns)
    found = estimate.posterior.shared[:k]
    _, cutting = sight.cut(estimate.columns.deviations(found * estimate.typical))
    marks = estimate.columns.slopes(cutting, sight.added, estimate.sense, 0.0) * estimate.typical
    nuisances, _ = sight.nuisances(cutting, np.zeros(cutting.x.size))
    known = sight.usable & np.isfinite(marks).all(axis=1) & np.isfinite(nuisances).all(axis=1)
    marks = marks[known] * _of_the_cut(estimate)
    random = np.random.default_rng(1)
    shared, owns = estimate.posterior.draws(DRAWS, random)
    values = shared[:, :k]
    if len(estimate.sights) > 1:
        between = _further(estimate, 0, owns[0], random)[:, estimate.looks[0].poses : -TERMS]
        values = values + between * np.sqrt(estimate.between_numbers())
    split = estimate.split(0)
    terms = (owns[0] @ split.own.T + shared @ split.shared.T)[:, -TERMS:]
    lasting = terms[:, LASTING] @ columns(cutting, estimate.radius[0])[np.ix_(known, LASTING)].T
    ends = (found * estimate.typical * _of_the_cut(estimate), np.zeros(k))
    every, planned = (_made(estimate, sight, one)[known] for one in ends)
    after = (values - found) @ marks.T + lasting
    before = after + every - planned
    x, y = sight.x[known], sight.y[known]
    return Draws(
        x=x, y=y, before=before, after=after, single=len(estimate.sights) == 1,
        pose=nuisances[known], places=np.stack([x, y])[None], unmeasured=0.0, cases=(),
    )  # fmt: skip


ELSEWHERE = 3_000
"""Places on another part."""


def _case(estimate: Estimate, m: int, number: int, numbers: Floats, rows: Floats, asked: Asked) -> DrawnCut:
    """Return one draw as it can be simulated."""
    k, j = estimate.typical.size, estimate.looks[m].poses
    values = numbers[j : j + k] * estimate.typical
    moving = np.array([column.cause in MOVING for column in estimate.names])
    tool, machine = _as_found(estimate, np.where(moving, values, 0.0), asked)
    rest = numbers.copy()
    rest[j : j + k][moving] = 0.0
    terms = rest[j + k :].copy()
    form = PLACES[-1]
    across = slice(PLACES[-2].start + 1, PLACES[-2].stop)  # the tilts that move the tip along Y
    rest[j + k :][: across.start] = 0.0
    terms[form], terms[across] = 0.0, 0.0
    return DrawnCut(
        number=number, tool=tool, machine=machine, rest=rows @ rest,
        tip_motion=lambda radius, angle, z: tip_motion(terms, radius, angle, z, estimate.radius[m]),
    )  # fmt: skip


MOVING = frozenset({"offset x", "offset y", "offset z", "radius error", "waviness", "squareness", "straightness"})
"""Causes that planning with the real tool and machine takes care of. What others make is left to the form."""


def _further(estimate: Estimate, m: int, own: Floats, random: np.random.Generator) -> Floats:
    """Return draws of what a further cut has of its own, of those of a map. (draws, o).

    Sources differ anew from part to part, and so do the terms where several cuts of a part say by how much.
    """
    look = estimate.looks[m]
    own = own.copy()
    own[:, : look.poses] = 0.0
    between, terms = own[:, look.poses : -TERMS], own[:, -TERMS:]
    between[:] = _anew(between.shape, between.shape[1] * (len(estimate.sights) - 1), random)
    alike = sum(kind is not None and kind == estimate.kinds[m] for kind in estimate.kinds)
    if alike < 2:
        return own
    for name in dict.fromkeys(group.name for group in GROUPS):
        places = [place for group, place in zip(GROUPS, PLACES, strict=True) if group.name == name]
        whole = slice(places[0].start, places[-1].stop)
        # The size of the differences is known from few, and may be far larger.
        shape = own.shape[0], whole.stop - whole.start
        terms[:, whole] = _anew(shape, (alike - 1) * shape[1], random)
    return own


def _anew(shape: tuple[int, ...], freedom: int, random: np.random.Generator) -> Floats:
    """Return numbers of unit size, where that is known with so many degrees of freedom."""
    if not np.prod(shape):
        return np.zeros(shape)
    return np.asarray(random.normal(size=shape) * np.sqrt(freedom / random.chisquare(freedom, size=(shape[0], 1))))


class _Whole(NamedTuple):
    """What is left of all points of a map."""

    residual: HeightMap
    remainder: HeightMap
    field: HeightMap

    @classmethod
    def of(
        cls, estimate: Estimate, m: int, heights: HeightMap, thinned: HeightMap, part: Part, corrected: Bools,
        repeats: bool,
    ) -> _Whole:  # fmt: skip
        """Return what neither sources nor terms explain, and what corrected sources, and none, leave to the form."""
        thin, look, k = estimate.sights[m], estimate.looks[m], estimate.typical.size
        sight = thin if heights is thinned else _every_point(thin, thinned, heights, part, estimate)
        residual, cutting = sight.cut(estimate.columns.deviations(estimate.values[m]))
        for cause, one in sight.added.items():
            residual = residual - estimate.values[m][estimate.of_cause(cause)] @ one
        residual[~(sight.good | sight.apart)] = np.nan
        terms = columns(cutting, estimate.radius[m])
        numbers = estimate.numbers(m)[look.poses + k :]
        left = residual - terms @ numbers
        # What differs from cut to cut, from its mean over them, does not come back.
        common = numbers
        if estimate.kinds[m] is not None:
            common = (estimate.split(m).shared @ estimate.posterior.shared)[-TERMS:]
        steady = repeats or estimate.kinds[m] is not None
        repeated = terms @ np.where(LASTING | steady, common, 0.0) + 0.0 * left
        found = np.where(_of_the_cut(estimate), estimate.posterior.shared[:k] * estimate.typical, 0.0)
        planned, certain, every = (
            _made(estimate, sight, values) for values in (np.zeros(k), np.where(corrected, found, 0.0), found)
        )

        def shown(z: Floats, name: str) -> HeightMap:
            return replace(_on(heights, z, sight), name=f"{heights.name} {name}".strip())

        return cls(
            shown(left, "residual"),
            shown(repeated + (every - certain if steady else 0.0), "remainder"),
            shown(repeated + (every if steady else certain) - planned, "field"),
        )


def _made(estimate: Estimate, sight: Sight, values: Floats) -> Floats:
    """Return the heights that some values of the sources leave at the points of a map, in full. (n,) [mm]."""
    stands = sight.stands
    _, cutting = sight.cut(estimate.columns.deviations(values))
    sight.stands = stands
    made = cutting.z + sight.cusp * cutting.between
    for cause, marks in sight.added.items():
        made = made + values[estimate.of_cause(cause)] @ marks
    return np.asarray(made)


MOUNT = frozenset({"astigmatism", "trefoil"})
"""Causes that are not in the cut."""


def _pose(sight: Sight) -> Pose:
    return Pose.within_a_turn(sight.pose[:3].tolist(), sight.pose[3], sight.pose[4:6])


def _on(heights: HeightMap, mark: Floats, sight: Sight) -> HeightMap:
    """Return a mark on the grid of a map."""
    z = np.full(heights.z.shape, np.nan)
    z[sight.where] = mark
    return replace(heights, z=z)


def _axes(heights: HeightMap) -> tuple[Floats, Floats]:
    """Return rows and columns of a grid."""
    rows, columns = (heights.angle, heights.radius) if heights.polar else (heights.y, heights.x)
    assert rows is not None  # noqa: S101 - a grid has both
    assert columns is not None  # noqa: S101
    return rows, columns


def _every_point(thin: Sight, thinned: HeightMap, heights: HeightMap, part: Part, estimate: Estimate) -> Sight:
    """Return a map with all its points, where it was thinned for the fit: what held there holds around it."""
    where, x, y, z = valid(heights, part)
    sight = replace(
        thin,
        x=x,
        y=y,
        z=z,
        where=where,
        sweeps=thin.swept.guess(x, y),
        added={},
        usable=np.isfinite(z),
        good=np.isfinite(z),
        apart=np.zeros(z.size, dtype=np.bool_),
    )
    if not heights.scattered:
        held = np.zeros(thin.where.shape, dtype=np.bool_)
        held[thin.where] = thin.good | thin.apart
        near = [_nearest(full, few) for full, few in zip(_axes(heights), _axes(thinned), strict=True)]
        sight.good = held[np.ix_(*near)][where]
    if thin.stands is not None:
        sight.stands = z
    mark(sight, estimate.columns)
    return sight


def _nearest(full: Floats, few: Floats) -> Ints:
    """Return which of few positions along an axis, which may fall, is about the nearest to each of all. (n,)."""
    order = np.argsort(few)
    return np.asarray(np.rint(np.interp(full, few[order], order)).astype(np.int64))


def _as_found(estimate: Estimate, values: Floats, asked: Asked) -> tuple[Tool, Machine]:
    """Return the planned tool and machine with deviations of some values, none where they are 0. (k,) in."""
    tool, machine = asked.tool, asked.machine
    real = estimate.columns.deviations(values)
    x, y, z = (own + more for own, more in zip(tool.offset, real.offset, strict=True))
    most = tool.nose_radius * LARGEST_ERROR
    radius_error = float(np.clip(tool.radius_error + real.radius, -most, most))  # beyond it is another tool
    tool = replace(tool, offset=(x, y, z), radius_error=radius_error)
    if real.waviness.any():
        tool = replace(tool, waviness=_certificate(estimate, real, tool))
    machine = replace(machine, squareness=machine.squareness + real.squareness)
    if real.straightness.any():
        at, error = machine.straightness or (real.knots, np.zeros_like(real.knots))
        both = np.union1d(at, real.knots)
        found = np.interp(both, real.knots, real.straightness)
        machine = replace(machine, straightness=(both, np.interp(both, at, error) + found))
    return tool, machine


def _certificate(estimate: Estimate, real: Deviations, tool: Tool) -> WavinessTable:
    """Return the waviness of the planned edge and that found, over the whole arc: beyond the sweeps used it runs on."""
    used = np.concatenate([sight.sweeps.cut[sight.good] for sight in estimate.sights])
    low, high = float(np.nanmin(used)), float(np.nanmax(used))
    sweep = np.linspace(*tool.arc, CERTIFICATE)
    held = np.clip(sweep, low, high)
    height, slope, _ = np.tensordot(real.basis.values(held), real.waviness, (1, 0))
    return WavinessTable(sweep=sweep, deviation=tool.deviation(sweep) + height + slope * (sweep - held))
