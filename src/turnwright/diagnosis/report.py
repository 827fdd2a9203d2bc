"""Results of an estimate: numbers, maps and sentences."""

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
from turnwright.diagnosis.error_sources import LOBES
from turnwright.diagnosis.estimate import PLACES, POSE_SIGMA, TERMS, Estimate, LinearSystem
from turnwright.diagnosis.findings import (
    NM,
    Contribution,
    Diagnosis,
    DrawnCut,
    Draws,
    Finding,
    judge,
)
from turnwright.diagnosis.map_points import MapPoints, add_signatures, prepare_maps, select_valid
from turnwright.diagnosis.model import Deviations, Sweeps, raise_sweep
from turnwright.diagnosis.terms import GROUPS, columns, describe_group, tip_motion
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.part import evenly
from turnwright.tool import LARGEST_ERROR, Tool, WavinessTable

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.part import Part

__all__ = ["ReportRequest", "write_report"]

MISS_PROBABILITY = 0.05
"""Probability that an interval does not contain the true value."""

MIN_NAMED_CORRELATION = 0.95
"""Correlation from which two findings are reported as correlated."""

DETERMINED_RATIO = 0.5
"""A value is determined if its uncertainty is below this fraction of the plausible size."""

CERTAIN_RATIO = 0.5
"""The effect of a source is certain if its uncertainty is below this fraction of it."""

DRAWS = 200
DRAW_POINTS = 2_000
"""Number of draws, and of points at which a further part is drawn."""

MAP_STEPS = 3
"""Steps that make a draw consistent with its map."""

FULL_CASES = 5
"""Draws for full simulation."""

EDGE_POINTS = 721
"""Points of the waviness table over the arc of the edge."""


class _Numbers(NamedTuple):
    """Values and covariance of the source parameters, in their units."""

    value: Floats  # (k,)
    covariance: Floats  # (k, k)
    dof: float

    @property
    def std(self) -> Floats:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def half(self) -> Floats:
        """Return half the widths of the 95 % confidence intervals. (k,)."""
        from scipy.special import stdtrit  # noqa: PLC0415 - costly to import

        return float(stdtrit(self.dof, 1 - MISS_PROBABILITY / 2)) * self.std


class ReportRequest(NamedTuple):
    """Plan and options of a report."""

    tool: Tool
    machine: Machine
    min_effect_nm: float
    repeats: bool
    allowed: frozenset[str] | None  # sources that may be corrected by tool and machine; None for all


def write_report(
    estimate: Estimate,
    maps: Sequence[HeightMap],
    thin: Sequence[HeightMap],
    parts: Sequence[Part],
    request: ReportRequest,
) -> Diagnosis:
    """Return the diagnosis from an estimate."""
    numbers = _collect_numbers(estimate)
    findings = _judge_findings(estimate, numbers, request)
    certain = np.array([one.verdict == "correct" for one in findings])
    corrected = certain & np.array([one.error_source in PLANNABLE for one in findings])
    effect = [float(one.rms_nm) for one in findings]
    order = sorted(range(len(findings)), key=lambda k: (not certain[k], -effect[k], k))
    likely = np.where(_made_by_cut(estimate), numbers.value, 0.0)
    real_tool, real_machine = _apply_deviations(estimate, np.where(corrected, numbers.value, 0.0), request)
    likely_tool, likely_machine = real_tool, real_machine
    with suppress(InputError):  # an edge that no tool can have
        likely_tool, likely_machine = _apply_deviations(estimate, likely, request)
    residuals, remainders, fields = zip(
        *(
            _complete_maps(estimate, m, one, few, part, corrected, request.repeats)
            for m, (one, few, part) in enumerate(zip(maps, thin, parts, strict=True))
        ),
        strict=True,
    )
    measured, explained, unexplained = _evaluate_rms(estimate)
    std = np.where(numbers.std > 0, numbers.std, np.inf)
    noise = estimate.scale / np.sqrt(estimate.correlated_points)
    return Diagnosis(
        findings=tuple(findings[k] for k in order),
        contributions=_evaluate_contributions(estimate),
        names=tuple(column.name for column in estimate.names),
        correlation=frozen(numbers.covariance / np.outer(std, std), "correlation", ndim=2),
        residuals=residuals, remainders=remainders, fields=fields,
        poses=tuple(map_points.motion for map_points in estimate.all_points),
        measured_rms_nm=measured, explained_rms_nm=explained, unexplained_rms_nm=unexplained,
        noise_nm=tuple((np.maximum(noise, estimate.stated) * NM).tolist()),
        correlated_points=tuple(estimate.correlated_points.tolist()),
        repeatability_nm=_evaluate_repeatability(estimate),
        rejected=tuple(int(np.count_nonzero(map_points.outliers)) for map_points in estimate.all_points),
        signatures=tuple(_evaluate_signatures(estimate, m, one) for m, one in enumerate(thin)),
        draws=lambda m: _draw_parts(estimate, m, corrected, parts[m], request),
        tool=real_tool, machine=real_machine, likely_tool=likely_tool, likely_machine=likely_machine,
        effects_on=partial(_draw_other_part, estimate, request),
    )  # fmt: skip


def _collect_numbers(estimate: Estimate) -> _Numbers:
    typical = estimate.typical
    k, posterior = typical.size, estimate.posterior
    root = posterior.root[:k] * typical[:, None]
    points = sum(
        system.rows.shape[0] / one for system, one in zip(estimate.systems, estimate.correlated_points, strict=True)
    )
    return _Numbers(posterior.shared[:k] * typical, root @ root.T, max(points - TERMS, 1.0))


def _remove_pose(estimate: Estimate, m: int) -> Floats:
    """Return the effect of every column of a map beyond a change of pose, with equal mean squares. (r, c) [mm]."""
    system = estimate.systems[m]
    return np.asarray(system.root[system.poses :, system.poses : -1] / np.sqrt(system.rows.shape[0]))


def _judge_findings(estimate: Estimate, numbers: _Numbers, request: ReportRequest) -> list[Finding]:
    k, typical, many = estimate.typical.size, estimate.typical, len(estimate.all_points)
    half, std = numbers.half(), numbers.std
    marks = [_remove_pose(estimate, m)[:, :k] / typical for m in range(many)]
    pv = _evaluate_pv(estimate, numbers.value)
    by_source = {
        error_source: _evaluate_source(estimate, error_source, marks, numbers)
        for error_source in estimate.error_sources
    }
    findings = []
    for i, column in enumerate(estimate.names):
        value, seen = float(numbers.value[i]), bool(estimate.seen[i])
        rms, uncertain, between = by_source[column.error_source]
        differs = many > 1 and between > request.min_effect_nm
        alike = [
            (other.name, float(numbers.covariance[i, j] / (std[i] * std[j])))
            for j, other in enumerate(estimate.names)
            if j != i and seen and estimate.seen[j]
        ]
        number_rms = np.sqrt(np.mean([np.sum((one[:, i] * value) ** 2) for one in marks])) * NM
        correlated = [pair for pair in alike if abs(pair[1]) > MIN_NAMED_CORRELATION]
        finding = Finding(
            name=column.name, error_source=column.error_source, value=value, unit=column.unit, plausible=column.typical,
            standard_uncertainty=float(std[i]), interval=(value - float(half[i]), value + float(half[i])),
            rms_nm=float(number_rms), pv_nm=float(pv[i]) * NM,
            correlated_with=tuple(sorted(correlated, key=lambda pair: -abs(pair[1]))),
            determined=seen and bool(std[i] < DETERMINED_RATIO * typical[i]),
            repeatable=None if many == 1 or not seen else not differs,
            map_values=tuple(estimate.values[:, i].tolist()) if differs else (),
        )  # fmt: skip
        allowed = request.allowed is None or column.error_source in request.allowed
        findings.append(
            judge(
                finding, seen=seen, rms_nm=rms, certain=uncertain < CERTAIN_RATIO * rms, steady=between < rms,
                allowed=allowed, min_effect_nm=request.min_effect_nm,
            )
        )  # fmt: skip
    return findings


def _evaluate_source(
    estimate: Estimate, error_source: str, marks: Sequence[Floats], numbers: _Numbers
) -> tuple[float, float, float]:
    """Return the effect of a source on the form, its uncertainty and its difference between maps. rms [nm]."""
    at = estimate.of_source(error_source)
    squares = np.zeros(3)
    for one, values in zip(marks, estimate.values, strict=True):
        source_columns = one[:, at]
        squares += [
            np.sum((source_columns @ numbers.value[at]) ** 2),
            np.sum((source_columns.T @ source_columns) * numbers.covariance[np.ix_(at, at)]),
            np.sum((source_columns @ (values - numbers.value)[at]) ** 2),
        ]
    rms, uncertain, between = np.sqrt(squares / len(marks)) * NM
    return float(rms), float(uncertain), float(between)


def _evaluate_pv(estimate: Estimate, value: Floats) -> Floats:
    """Return the peak to valley of the effect of each value beyond a change of pose. (k,) [mm]."""
    tops = np.zeros(value.size)
    for system in estimate.systems:
        j = system.poses
        marks = system.rows[:, j : j + value.size] / estimate.typical
        pose = np.linalg.lstsq(system.rows[:, :j], marks, rcond=1e-12)[0] if j else np.zeros((0, value.size))
        tops = np.maximum(tops, np.ptp((marks - system.rows[:, :j] @ pose) * value, axis=0))
    return tops


def _evaluate_contributions(estimate: Estimate) -> tuple[Contribution, ...]:
    contributions = []
    for name in dict.fromkeys(group.name for group in GROUPS):
        at = np.concatenate(
            [np.arange(TERMS)[place] for group, place in zip(GROUPS, PLACES, strict=True) if group.name == name]
        )
        squares, several = np.zeros(3), False
        for m in range(len(estimate.all_points)):
            k = estimate.typical.size
            rows = _remove_pose(estimate, m)[:, k + at]
            split = estimate.split(m)
            spread = (np.hstack([split.own, split.shared]) @ estimate.posterior.roots(m))[-TERMS:][at]
            common = (split.shared @ estimate.posterior.shared)[-TERMS:][at]
            several |= estimate.kinds[m] is not None
            squares += [
                np.sum((rows @ estimate.numbers(m)[-TERMS:][at]) ** 2), np.sum((rows @ spread) ** 2),
                np.sum((rows @ common) ** 2),
            ]  # fmt: skip
        rms, uncertain, common_nm = (np.sqrt(squares / len(estimate.all_points)) * NM).tolist()
        text = describe_group(
            name, np.mean([estimate.numbers(m)[-TERMS:] for m in range(len(estimate.all_points))], axis=0)
        )
        contributions.append(
            Contribution(
                name=name, rms_nm=rms, uncertainty_nm=uncertain, common_nm=common_nm if several else None,
                explanation=f"{name} causes {rms:.3g} nm rms, known within {uncertain:.2g} nm{text}",
            )
        )  # fmt: skip
    return tuple(sorted(contributions, key=lambda one: -one.rms_nm))


def _evaluate_rms(estimate: Estimate) -> tuple[float, float, float]:
    """Return rms values beyond a change of pose: measured, explained and residual. [nm].

    The measured value refers to the registered pose, which may differ from the fitted one, as errors of the part affect
    the registration.
    """
    sums, count = np.zeros(3), 0
    for m, system in enumerate(estimate.systems):
        map_points = estimate.all_points[m]
        registered = replace(
            map_points, pose=map_points.start_pose.copy(), sweeps=Sweeps(*(one.copy() for one in map_points.sweeps))
        )
        measured = registered.cut(estimate.columns.deviations(np.zeros(estimate.typical.size)))[0]
        measured, residual = measured[system.good] * system.counts, estimate.residual_of(m)
        pose = system.rows[:, : system.poses]
        finite = np.isfinite(measured)
        both = np.stack([measured, measured - residual], axis=1)[finite]
        both -= pose[finite] @ np.linalg.lstsq(pose[finite], both, rcond=1e-12)[0]
        sums += [*(both**2).sum(axis=0), float(residual[finite] @ residual[finite])]
        count += int(np.count_nonzero(finite))
    measured_nm, explained_nm, left_nm = (np.sqrt(sums / count) * NM).tolist()
    return measured_nm, explained_nm, left_nm


def _evaluate_repeatability(estimate: Estimate) -> float | None:
    """Return the rms difference between the maps of a part, beyond a change of pose."""
    squares, freedom = 0.0, 0
    k = estimate.typical.size
    for kind in dict.fromkeys(estimate.kinds):
        alike = [m for m, one in enumerate(estimate.kinds) if one == kind]
        if kind is None or len(alike) < 2:
            continue
        deviations = [
            (estimate.split(m).own @ estimate.posterior.map_unknowns(m))[estimate.systems[m].poses :] for m in alike
        ]
        mean = np.mean(deviations, axis=0)
        for m, one in zip(alike, deviations, strict=True):
            squares += float(np.sum((_remove_pose(estimate, m)[:, : k + TERMS] @ (one - mean)) ** 2))
        freedom += len(alike) - 1
    return math.sqrt(squares / freedom) * NM if freedom else None


def _evaluate_signatures(estimate: Estimate, m: int, heights: HeightMap) -> Mapping[str, HeightMap]:
    """Return the effect of every value and group of terms on a map beyond a change of pose."""
    system, k = estimate.systems[m], estimate.typical.size
    j, numbers = system.poses, estimate.numbers(m)
    fields = {column.name: system.rows[:, j + i] * numbers[j + i] for i, column in enumerate(estimate.names)}
    for group, place in zip(GROUPS, PLACES, strict=True):
        group_field = system.rows[:, j + k : -1][:, place] @ numbers[j + k :][place]
        fields[group.name] = fields.get(group.name, 0.0) + group_field
    made = np.stack([*fields.values()], axis=1)
    pose = system.rows[:, :j]
    made = made - pose @ np.linalg.lstsq(pose, made, rcond=1e-12)[0] if j else made
    out = {}
    for name, one in zip(fields, made.T, strict=True):
        every = np.full(system.good.size, np.nan)
        every[system.good] = one
        out[name] = _put_on_grid(heights, every, estimate.all_points[m])
    return MappingProxyType(out)


class _Places(NamedTuple):
    """Points at which a further part is drawn."""

    map_points: MapPoints
    rows: Floats  # see `LinearSystem` (n, j + k + g) [mm]
    turned: Floats  # (n,) [mm]
    planned: Floats  # heights as planned (n,) [mm]
    taken: Floats  # additional heights by the corrected sources (n,) [mm]

    @classmethod
    def of(
        cls, estimate: Estimate, m: int, map_points: MapPoints, rows: Floats, turned: Floats, found: Floats
    ) -> _Places:  # fmt: skip
        """Return the points that all tools cut."""
        ends = [
            _simulate_heights(estimate, map_points, values)
            for values in (np.zeros(found.size), found, estimate.values[m])
        ]
        finite = np.flatnonzero(np.isfinite(ends).all(axis=0) & np.isfinite(rows).all(axis=1))
        planned, taken = ends[0][finite], ends[1][finite]
        return cls(_select_points(map_points, finite), rows[finite], turned[finite], planned, taken - planned)

    def off(self, estimate: Estimate, m: int, numbers: Floats) -> Floats:
        """Return cut minus design of draws: motions of the edge exactly, all else linearly. (draws, n) [mm]."""
        poses, k = estimate.systems[m].poses, estimate.typical.size
        moving = np.array([column.error_source in PLANNABLE for column in estimate.names])
        others = np.append(
            poses + np.flatnonzero(_made_by_cut(estimate) & ~moving), np.arange(poses + k, len(numbers.T))
        )
        values = numbers[:, poses : poses + k] * np.where(moving, estimate.typical, 0.0)
        made = np.stack([_simulate_heights(estimate, self.map_points, one) for one in values]) - self.planned
        for i in estimate.of_source("offset y"):  # the lobes are rotated by the difference from the fit
            turn = numbers[:, poses + i, None] - estimate.values[m][i] / estimate.typical[i]
            made += turn * self.turned
        return np.asarray(made + numbers[:, others] @ self.rows[:, others].T)


def _draw_parts(estimate: Estimate, m: int, corrected: Bools, part: Part, request: ReportRequest) -> Draws:
    """Return draws of the form error of a further part, cut like that of a map."""
    system, k = estimate.systems[m], estimate.typical.size
    random = np.random.default_rng(1)
    corrected_values = np.where(corrected, estimate.posterior.shared[:k] * estimate.typical, 0.0)
    beyond = _find_unmeasured(estimate, m, part, request.tool)
    most = DRAW_POINTS - (0 if beyond is None else beyond.x.size)
    some = np.arange(0, system.rows.shape[0], -(-system.rows.shape[0] // most))
    map_points = _select_points(estimate.all_points[m], np.flatnonzero(system.good)[some])
    shown = _Places.of(estimate, m, map_points, system.rows[some, :-1], system.turned[some], corrected_values)
    numbers, lacking, moved = _draw_numbers(estimate, m, shown, random)
    single = estimate.kinds[m] is None
    if single and not request.repeats:  # the next part has another drift and form of the same size
        sources = np.flatnonzero(~corrected & _made_by_cut(estimate))
        at = np.append(system.poses + sources, system.poses + k + np.flatnonzero(~LASTING))
        numbers[:, at] *= random.normal(size=(DRAWS, 1))
    places = [shown]
    if beyond is not None:
        _, cutting = beyond.cut(estimate.columns.deviations(estimate.values[m]))
        rows, turned, _ = estimate.marks(m, beyond, cutting)
        places.append(_Places.of(estimate, m, beyond, rows, turned, corrected_values))
    rows = np.concatenate([one.rows for one in places])
    # The tool of a draw may not cut every point.
    before = np.nan_to_num(np.hstack([one.off(estimate, m, numbers) for one in places]))
    before[:, : lacking.shape[1]] += lacking
    x, y = (np.concatenate(one) for one in zip(*(one.map_points.moved()[:2] for one in places), strict=True))
    shift, turn = _split_pose(system, moved)
    return Draws(
        x=x, y=y, before=before, after=before - np.concatenate([one.taken for one in places]), single=single,
        pose=rows[:, : system.poses],
        places=np.stack([x + shift[:, :1] - turn * y, y + shift[:, 1:] + turn * x], axis=1),
        unmeasured=0.0 if beyond is None else beyond.x.size / DRAW_POINTS,
        cases=tuple(itertools.islice(_yield_cases(estimate, m, numbers, lacking, rows, request), FULL_CASES)),
    )  # fmt: skip


def _find_unmeasured(estimate: Estimate, m: int, part: Part, tool: Tool) -> MapPoints | None:
    """Return the points, of `DRAW_POINTS` evenly over a part, that a map does not cover; ``None`` if there are few."""
    from scipy.spatial import KDTree  # noqa: PLC0415 - costly to import

    map_points = estimate.all_points[m]
    if map_points.sphere is not None:
        return None
    x, y, _ = map_points.moved()
    places = _sample_design(part, DRAW_POINTS)
    distance = KDTree(np.stack([x, y], axis=1)[map_points.good]).query(np.stack(places.points(), axis=1))[0]
    out = distance > UNMEASURED_SPACINGS * part.reach / math.sqrt(DRAW_POINTS)
    if np.count_nonzero(out) < MIN_UNMEASURED_FRACTION * DRAW_POINTS:
        return None
    x, y = (one[out] for one in places.points())
    places = HeightMap(x=x, y=y, z=places.z[out], name=part.name)
    with suppress(InputError):  # where the tool does not cut
        (beyond,), _ = prepare_maps([places], [part], tool, map_points.free, "true form", estimate.sense, 0.0)
        beyond.cusp = map_points.cusp
        add_signatures(beyond, estimate.columns)
        return beyond
    return None


UNMEASURED_SPACINGS, MIN_UNMEASURED_FRACTION = 4.0, 0.02
"""Points further than this many spacings from all points of a map are unmeasured; a smaller fraction is ignored."""


def _sample_design(part: Part, count: int) -> HeightMap:
    x, y = evenly(part, count)
    return HeightMap(x=x, y=y, z=part.surface.sag(x, y), name=part.name)


def _split_pose(system: LinearSystem, poses: Floats) -> tuple[Floats, Floats]:
    """Return shift along x and y (draws, 2) [mm] and rotation about z (draws, 1) [rad] of some changes of pose."""
    every = np.zeros((poses.shape[0], POSE_SIGMA.size))
    every[:, system.numbers] = poses * POSE_SIGMA[system.numbers]
    return every[:, :2], every[:, 3:4]


def _yield_cases(
    estimate: Estimate, m: int, numbers: Floats, lacking: Floats, rows: Floats, request: ReportRequest
) -> Iterator[DrawnCut]:
    """Yield draws for full simulation, from the half with the smallest deficit."""
    size = (lacking**2).sum(axis=1)
    for number in np.flatnonzero(size <= np.median(size)).tolist():
        with suppress(InputError):  # an edge that no tool can have
            yield _make_case(estimate, m, number, numbers[number], rows, request)


def _draw_numbers(
    estimate: Estimate, m: int, places: _Places, random: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return draws of the unknowns of a further part that is cut like that of a map, their deficits, and poses.

    Each (draws, *).

    The heights of large sources are nonlinear, so that a linear draw would not agree with the map. Least-squares steps
    from the disagreement make the draw consistent with the map. The remaining disagreement is the deficit: heights at
    the points of the rows. [mm] The poses are those of the map relative to the fitted pose, in units of `POSE_SIGMA`.
    """
    system, split, k = estimate.systems[m], estimate.split(m), estimate.typical.size
    off, rows = partial(places.off, estimate, m), places.rows
    shared, owns = estimate.posterior.draws(DRAWS, random)
    map_draws = owns[m]
    best_numbers, first = estimate.numbers(m), system.poses + k
    best_numbers[system.poses : first] = estimate.values[m] / estimate.typical
    cut = np.r_[np.zeros(system.poses, dtype=np.bool_), _made_by_cut(estimate), np.ones(TERMS, dtype=np.bool_)]
    drawn = map_draws @ split.own.T + shared @ split.shared.T
    wanted = off(best_numbers[None]) + ((drawn - best_numbers) * cut) @ rows.T
    columns = rows @ np.hstack([split.own, split.shared]) / estimate.scale[m]
    root, weight = estimate.posterior.roots(m), system.rows.shape[0] / rows.shape[0]
    alike = sum(kind is not None and kind == estimate.kinds[m] for kind in estimate.kinds)
    pose = np.linalg.qr(rows[:, : system.poses])[0]
    best, lacking, uncut = (map_draws, shared), np.full(wanted.shape, np.inf), np.full(len(map_draws), wanted.shape[1])
    for _ in range(MAP_STEPS + 1):
        lack = wanted - off(map_draws @ split.own.T + shared @ split.shared.T)
        missing = np.count_nonzero(~np.isfinite(lack), axis=1)
        lack = np.where(np.isfinite(lack), lack, wanted)
        lack -= (lack @ pose) @ pose.T
        # The deficit of a tool that cuts nothing is the whole target, which may be less than that of another draw.
        nearer = (missing <= uncut) & ((lack**2).sum(axis=1) < (lacking**2).sum(axis=1))
        uncut = np.where(nearer, missing, uncut)
        best = np.where(nearer[:, None], map_draws, best[0]), np.where(nearer[:, None], shared, best[1])
        lacking = np.where(nearer[:, None], lack, lacking)
        back = (lack / estimate.scale[m] * weight) @ columns @ root @ root.T
        if not alike:
            map_draws = map_draws + back[:, : map_draws.shape[1]]
        shared = shared + max(alike, 1) * back[:, map_draws.shape[1] :]  # maps of one part have the same nonlinearity
    map_draws, shared = best
    moved = (map_draws @ split.own.T)[:, : system.poses] - best_numbers[: system.poses]
    return _draw_further_cut(estimate, m, map_draws, random) @ split.own.T + shared @ split.shared.T, lacking, moved


def _select_points(map_points: MapPoints, some: Ints) -> MapPoints:
    return replace(
        map_points, x=map_points.x[some], y=map_points.y[some], z=map_points.z[some],
        sweeps=Sweeps(*(one[some] for one in map_points.sweeps)),
        added={error_source: one[:, some] for error_source, one in map_points.added.items()},
        usable=map_points.usable[some], good=map_points.good[some], outliers=map_points.outliers[some],
        along_normal=None if map_points.along_normal is None else map_points.along_normal[some],
    )  # fmt: skip


LASTING = np.concatenate([np.full(group.relative.size, group.lasting) for group in GROUPS])


def _made_by_cut(estimate: Estimate) -> Bools:
    """Return which unknowns belong to the cut, not to the mount. (k,)."""
    return np.array([column.error_source not in LOBES for column in estimate.names])


def _draw_other_part(estimate: Estimate, request: ReportRequest, part: Part) -> Draws:
    """Return draws of the form error of another part by the sources, without and with correction of all of them.

    Error motions of the spindle are included in both.
    """
    thin, k = estimate.all_points[0], estimate.typical.size
    (map_points,), _ = prepare_maps(
        [_sample_design(part, OTHER_PART_POINTS)], [part], request.tool, thin.free, "true form", estimate.sense, 0.0
    )
    add_signatures(map_points, estimate.columns)
    best_values = estimate.posterior.shared[:k]
    _, cutting = map_points.cut(estimate.columns.deviations(best_values * estimate.typical))
    marks = estimate.columns.slopes(cutting, map_points.added, estimate.sense, 0.0) * estimate.typical
    nuisances, _ = map_points.nuisances(cutting, np.zeros(cutting.x.size))
    finite = map_points.usable & np.isfinite(marks).all(axis=1) & np.isfinite(nuisances).all(axis=1)
    marks = marks[finite] * _made_by_cut(estimate)
    random = np.random.default_rng(1)
    shared, owns = estimate.posterior.draws(DRAWS, random)
    values = shared[:, :k]
    if len(estimate.all_points) > 1:
        between = _draw_further_cut(estimate, 0, owns[0], random)[:, estimate.systems[0].poses : -TERMS]
        values = values + between * np.sqrt(estimate.variance_between_maps())
    split = estimate.split(0)
    terms = (owns[0] @ split.own.T + shared @ split.shared.T)[:, -TERMS:]
    lasting = terms[:, LASTING] @ columns(cutting, estimate.radius[0])[np.ix_(finite, LASTING)].T
    ends = (best_values * estimate.typical * _made_by_cut(estimate), np.zeros(k))
    every, planned = (_simulate_heights(estimate, map_points, one)[finite] for one in ends)
    after = (values - best_values) @ marks.T + lasting
    before = after + every - planned
    x, y = map_points.x[finite], map_points.y[finite]
    return Draws(
        x=x, y=y, before=before, after=after, single=len(estimate.all_points) == 1,
        pose=nuisances[finite], places=np.stack([x, y])[None], unmeasured=0.0, cases=(),
    )  # fmt: skip


OTHER_PART_POINTS = 3_000
"""Points on another part."""


def _make_case(
    estimate: Estimate, m: int, number: int, numbers: Floats, rows: Floats, request: ReportRequest
) -> DrawnCut:
    k, j = estimate.typical.size, estimate.systems[m].poses
    values = numbers[j : j + k] * estimate.typical
    moving = np.array([column.error_source in PLANNABLE for column in estimate.names])
    tool, machine = _apply_deviations(estimate, np.where(moving, values, 0.0), request)
    remaining = numbers.copy()
    remaining[j : j + k][moving] = 0.0
    terms = remaining[j + k :].copy()
    form = PLACES[-1]
    across = slice(PLACES[-2].start + 1, PLACES[-2].stop)  # the tilts that move the tip along Y
    remaining[j + k :][: across.start] = 0.0
    terms[form], terms[across] = 0.0, 0.0
    return DrawnCut(
        number=number, tool=tool, machine=machine, rest=rows @ remaining,
        tip_motion=lambda radius, angle, z: tip_motion(terms, radius, angle, z, estimate.radius[m]),
    )  # fmt: skip


PLANNABLE = frozenset({"offset x", "offset y", "offset z", "radius error", "waviness", "squareness", "straightness"})
"""Sources that planning with the real tool and machine corrects. The others are left to a compensation of the form."""


def _draw_further_cut(estimate: Estimate, m: int, cut_numbers: Floats, random: np.random.Generator) -> Floats:
    """Return draws of the unknowns of a further cut from those of a map. (draws, o).

    Sources are drawn again for each part, and so are the terms if several cuts of a part determine their size.
    """
    system = estimate.systems[m]
    cut_numbers = cut_numbers.copy()
    cut_numbers[:, : system.poses] = 0.0
    between, terms = cut_numbers[:, system.poses : -TERMS], cut_numbers[:, -TERMS:]
    between[:] = _draw_student(between.shape, between.shape[1] * (len(estimate.all_points) - 1), random)
    alike = sum(kind is not None and kind == estimate.kinds[m] for kind in estimate.kinds)
    if alike < 2:
        return cut_numbers
    for name in dict.fromkeys(group.name for group in GROUPS):
        places = [place for group, place in zip(GROUPS, PLACES, strict=True) if group.name == name]
        group_slice = slice(places[0].start, places[-1].stop)
        # The size of the differences is estimated from few cuts, and may be much larger.
        shape = cut_numbers.shape[0], group_slice.stop - group_slice.start
        terms[:, group_slice] = _draw_student(shape, (alike - 1) * shape[1], random)
    return cut_numbers


def _draw_student(shape: tuple[int, ...], freedom: int, random: np.random.Generator) -> Floats:
    """Return draws of unit size, where the size is known with some degrees of freedom."""
    if not np.prod(shape):
        return np.zeros(shape)
    return np.asarray(random.normal(size=shape) * np.sqrt(freedom / random.chisquare(freedom, size=(shape[0], 1))))


def _complete_maps(
    estimate: Estimate, m: int, heights: HeightMap, thinned: HeightMap, part: Part, corrected: Bools, repeats: bool
) -> tuple[HeightMap, HeightMap, HeightMap]:
    """Return the residual at all points of a map, and the repeatable form error with and without correction."""
    thin, system, k = estimate.all_points[m], estimate.systems[m], estimate.typical.size
    map_points = thin if heights is thinned else _expand_map(thin, thinned, heights, part, estimate)
    residual, cutting = map_points.cut(estimate.columns.deviations(estimate.values[m]))
    for error_source, one in map_points.added.items():
        residual = residual - estimate.values[m][estimate.of_source(error_source)] @ one
    residual[~(map_points.good | map_points.outliers)] = np.nan
    terms = columns(cutting, estimate.radius[m])
    numbers = estimate.numbers(m)[system.poses + k :]
    residual_form = residual - terms @ numbers
    # The differences of the cuts from their mean do not repeat.
    common = numbers
    if estimate.kinds[m] is not None:
        common = (estimate.split(m).shared @ estimate.posterior.shared)[-TERMS:]
    steady = repeats or estimate.kinds[m] is not None
    repeated = terms @ np.where(LASTING | steady, common, 0.0) + 0.0 * residual_form
    cut_values = np.where(_made_by_cut(estimate), estimate.posterior.shared[:k] * estimate.typical, 0.0)
    planned, certain, every = (
        _simulate_heights(estimate, map_points, values)
        for values in (np.zeros(k), np.where(corrected, cut_values, 0.0), cut_values)
    )

    def shown(z: Floats, name: str) -> HeightMap:
        return replace(_put_on_grid(heights, z, map_points), name=f"{heights.name} {name}".strip())

    return (
        shown(residual_form, "residual"),
        shown(repeated + (every - certain if steady else 0.0), "remainder"),
        shown(repeated + (every if steady else certain) - planned, "field"),
    )


def _simulate_heights(estimate: Estimate, map_points: MapPoints, values: Floats) -> Floats:
    """Return the exact heights at the points of a map for some values of the sources. (n,) [mm]."""
    along_normal = map_points.along_normal
    _, cutting = map_points.cut(estimate.columns.deviations(values))
    map_points.along_normal = along_normal
    made = cutting.z + map_points.cusp * cutting.between
    for error_source, marks in map_points.added.items():
        made = made + values[estimate.of_source(error_source)] @ marks
    return np.asarray(made)


def _put_on_grid(heights: HeightMap, mark: Floats, map_points: MapPoints) -> HeightMap:
    z = np.full(heights.z.shape, np.nan)
    z[map_points.where] = mark
    return replace(heights, z=z)


def _grid_axes(heights: HeightMap) -> tuple[Floats, Floats]:
    rows, columns = (heights.angle, heights.radius) if heights.polar else (heights.y, heights.x)
    assert rows is not None  # noqa: S101 - a grid has both
    assert columns is not None  # noqa: S101
    return rows, columns


def _expand_map(thin: MapPoints, thinned: HeightMap, heights: HeightMap, part: Part, estimate: Estimate) -> MapPoints:
    """Return a map with all its points; each takes the state of the nearest point of the thinned map."""
    where, x, y, z = select_valid(heights, part)
    map_points = replace(
        thin,
        x=x,
        y=y,
        z=z,
        where=where,
        sweeps=thin.swept.guess(x, y),
        added={},
        usable=np.isfinite(z),
        good=np.isfinite(z),
        outliers=np.zeros(z.size, dtype=np.bool_),
    )
    if not heights.scattered:
        held = np.zeros(thin.where.shape, dtype=np.bool_)
        held[thin.where] = thin.good | thin.outliers
        near = [_find_nearest(full, few) for full, few in zip(_grid_axes(heights), _grid_axes(thinned), strict=True)]
        map_points.good = held[np.ix_(*near)][where]
    if thin.along_normal is not None:
        map_points.along_normal = z
    add_signatures(map_points, estimate.columns)
    return map_points


def _find_nearest(full: Floats, few: Floats) -> Ints:
    """Return the index of the nearest of few positions for each of all, along an ascending or descending axis. (n,)."""
    order = np.argsort(few)
    return np.asarray(np.rint(np.interp(full, few[order], order)).astype(np.int64))


def _apply_deviations(estimate: Estimate, values: Floats, request: ReportRequest) -> tuple[Tool, Machine]:
    """Return the planned tool and machine with the deviations of some values. (k,) in."""
    tool, machine = request.tool, request.machine
    real = estimate.columns.deviations(values)
    x, y, z = (planned + more for planned, more in zip(tool.offset, real.offset, strict=True))
    most = tool.nose_radius * LARGEST_ERROR
    radius_error = float(np.clip(tool.radius_error + real.radius, -most, most))  # more would be another tool
    tool = replace(tool, offset=(x, y, z), radius_error=radius_error)
    if real.waviness.any():
        tool = replace(tool, waviness=_make_waviness_table(estimate, real, tool))
    machine = replace(machine, squareness=machine.squareness + real.squareness)
    if real.straightness.any():
        at, error = machine.straightness or (real.knots, np.zeros_like(real.knots))
        both = np.union1d(at, real.knots)
        straightness_error = np.interp(both, real.knots, real.straightness)
        machine = replace(machine, straightness=(both, np.interp(both, at, error) + straightness_error))
    return tool, machine


def _make_waviness_table(estimate: Estimate, real: Deviations, tool: Tool) -> WavinessTable:
    """Return the waviness of the planned edge plus the fit, over the whole arc, extrapolated beyond the sweeps used."""
    used = np.concatenate([map_points.sweeps.cut[map_points.good] for map_points in estimate.all_points])
    low, high = float(np.nanmin(used)), float(np.nanmax(used))
    sweep = np.linspace(*tool.arc, EDGE_POINTS)
    held = np.clip(sweep, low, high)
    height, slope, _ = np.tensordot(raise_sweep(held, real.powers), real.waviness, (1, 0))
    return WavinessTable(sweep=sweep, deviation=tool.deviation(sweep) + height + slope * (sweep - held))
