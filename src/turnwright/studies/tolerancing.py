"""Tolerance studies: the probability that a part meets its tolerances, and which set-up error to reduce first."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright import _validate as validate
from turnwright._io import write_atomic
from turnwright.errors import InputError, JobError, StudyError
from turnwright.job import Job
from turnwright.studies.budget import MAX_DRAWS, ErrorBudget, Spread, group_of
from turnwright.studies.cases import Case, case_key, run_cases
from turnwright.studies.draws import carry_out, plan_cuts
from turnwright.studies.executors import local, require_reach
from turnwright.studies.files import list_files
from turnwright.studies.scenes import make_lines, servos_respond
from turnwright.studies.sensitivity import (
    Interval,
    MapModel,
    binomial_interval,
    group_inputs,
    neighbour_indices,
    percentile,
    sobol_indices,
    unit_points,
)
from turnwright.studies.store import Store

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from os import PathLike

    from turnwright._arrays import Bools, Floats
    from turnwright.progress import StageProgress
    from turnwright.studies.cases import Row

__all__ = ["Outcome", "Sensitivity", "Tightening", "ToleranceStudy", "tolerance"]

NM = 1e6

MIN_CASES = 10
"""Least number of cases of a study."""

PERCENTILES = (0.05, 0.5, 0.9, 0.95, 0.99)

SAMPLES_LOG2 = 10
"""Binary logarithm of the number of points from which the indices are estimated."""

MODEL_HEIGHTS, BOOTSTRAP_HEIGHTS = 1500, 300
"""Approximate number of heights of a map in the model and in its bootstrap."""

BOOTSTRAP_COUNT = 40
"""Bootstrap resamples for the intervals of the indices."""

POOR_VARIANCE = 0.5
"""Explained variance below which the sum of signatures is a poor model."""

MIN_EFFECTIVE_CASES = 20
"""Least effective number of weighted cases; below it the roughness is taken unweighted."""

USUAL_AXES = ("C", "X", "Z")
"""Axes that a budget may name for every lathe."""

AS_PLANNED, CORRECTED = "as planned", "corrected"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """Effect of a group of errors on a part.

    Parameters
    ----------
    group
        Such as ``"tool offset"``; ``"concave sphere: drift"`` is the drift during the cut of that test part.
    first, total
        Sobol' indices of the form error PV, from a model of maps as sums of signatures; ``None`` if the cases are too
        few.
    neighbour_index
        First-order index of the form error PV by nearest neighbours among the cases.
    probability
        Probability of meeting all tolerances with half the spread of the group; ``None`` if the cases are too few.
    percentile_nm
        95th percentile of the form error PV with half the spread. [nm]
    """

    group: str
    first: Interval | None
    total: Interval | None
    neighbour_index: float
    probability: float | None
    percentile_nm: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Tightening:
    """The group of errors to reduce first, and the result of a second study with half its spread.

    Parameters
    ----------
    group
        Group with the halved spread.
    probability
        Probability of meeting all tolerances with the halved spread, in otherwise identical cases.
    before
        Probability with the full spread.
    """

    group: str
    probability: Interval
    before: Interval


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """Results of the cases, as planned or corrected.

    Parameters
    ----------
    probability
        Probability of meeting all tolerances of the job.
    probabilities
        Probability of meeting each of them, by measure.
    sensitivities
        Effect of each group, the most important first.
    explained_variance
        Part of the variance of form error PV and RMS that the sum of signatures predicts, by cross-validation;
        ``None`` if the cases are too few.
    advice
        Which group to reduce first, in a sentence.
    """

    probability: Interval
    probabilities: Mapping[str, Interval]
    sensitivities: tuple[Sensitivity, ...]
    explained_variance: tuple[float, float] | None
    advice: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToleranceStudy:
    """Cases of an error budget, and their evaluation.

    Parameters
    ----------
    job, budget
        Job and error budget of the study.
    seed
        Seed of the draws.
    draws
        Values of each input, in the order of the cases. Each (n,) [mm, rad]
    columns
        Values of each measure; names after the correction begin with ``corrected``. Each (n,) [nm]
    reasons
        Reasons of failed cases, which are not among the columns and count as parts out of tolerance.
    limits
        Tolerance of each measure that has one. [nm]
    outcomes
        ``"as planned"``, and ``"corrected"`` with a correction.
    tightening
        Result of the confirmation, if requested.
    """

    job: Job
    budget: ErrorBudget
    seed: int
    draws: Mapping[str, Floats]
    columns: Mapping[str, Floats]
    reasons: tuple[str, ...]
    limits: Mapping[str, float]
    outcomes: Mapping[str, Outcome]
    tightening: Tightening | None

    @property
    def remarks(self) -> tuple[str, ...]:
        """Tolerances of the job that the cases do not tell."""
        stated = self.job.tolerances
        remarks = []
        if stated.drawing:
            remarks.append(f"{len(stated.drawing)} call-outs of the drawing are not evaluated: run the job")
        if stated.cusp_order is not None:
            remarks.append("cusp_order is not evaluated, it hardly varies: run the job")
        return tuple(remarks)

    @property
    def count(self) -> int:
        """Number of successful cases."""
        return int(next(iter(self.columns.values())).size)

    def percentiles(self, measure: str) -> dict[float, Interval]:
        """Return percentiles of a measure, each with its confidence interval. [nm]."""
        if measure not in list(self.columns):
            raise InputError(f"there is no measure {measure!r} among {', '.join(self.columns)}: name one of them")
        return {share: percentile(self.columns[measure], share) for share in PERCENTILES}

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one row for each case: drawn errors with their units, and measures."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        heads = [f"{name} [{self.budget.unit(name)}]" for name in self.draws]
        writer.writerow([*heads, *(f"{name.replace('_nm', '')} [nm]" for name in self.columns)])
        for row in zip(*(one.tolist() for one in (*self.draws.values(), *self.columns.values())), strict=True):
            writer.writerow([repr(one) for one in row])
        write_atomic(Path(validate.path(path, "the table")), text.getvalue())


def tolerance(
    job: Job,
    *,
    budget: ErrorBudget | None = None,
    count: int = 200,
    seed: int = 0,
    correction: bool = True,
    confirm: bool = False,
    executor: Executor | None = None,
    workers: int | None = None,
    store: Store | str | PathLike[str] | None = None,
    progress: StageProgress | None = None,
) -> ToleranceStudy:
    """Estimate the probability that a part meets its tolerances, and which set-up error to reduce first.

    The finishing pass is planned once. Every case simulates its cut with another draw of the errors of tool, slides,
    servos, drift and mount, along lines across the part and in the job's patches. The form error is taken after a fit
    of the rigid motions that the job's ``measurement`` leaves free, the roughness as the job's ``roughness`` states.
    With a correction, every case also cuts and measures the test parts of the budget first, diagnoses them, and cuts
    the part as planned with the diagnosed tool and machine.

    Parameters
    ----------
    job
        Job with tolerances.
    budget
        Error budget; by default `ErrorBudget.typical`.
    count
        Number of independent cases.
    seed
        Seed of all draws.
    correction
        Whether to include the correction by test parts.
    confirm
        Whether to repeat the cases with half the spread of the group to reduce first, if the cases are enough to
        determine it.
    executor
        Executor of the cases; by default processes of this machine.
    workers
        Number of these processes.
    store
        Store of motions and finished cases, from which a repeated study continues: a folder, a URL or a `Store`. By
        default a temporary folder.
    progress
        Called with (stage, done, total).

    Raises
    ------
    JobError
        If the job states no tolerance.
    InputError
        If there are fewer than 10 cases, the job cannot be planned, or the workers do not reach the store.
    StudyError
        If the executor breaks, the store is full, or fewer than 10 cases succeed.
    """
    validate.instance_of(job, Job, "the job")
    validate.listener(progress)
    report = progress or (lambda _stage, _done, _total: None)
    limits = _limits(job)
    count, seed = (
        validate.whole_number(count, "the number of cases", 0, MAX_DRAWS),
        validate.whole_number(seed, "the seed", 0),
    )
    if count < MIN_CASES:
        raise InputError(f"the study has {count} cases, it needs at least {MIN_CASES}: give a larger count")
    budget = ErrorBudget.typical() if budget is None else validate.instance_of(budget, ErrorBudget, "the budget")
    _check_axes(job, budget)
    with ExitStack() as stack:
        if store is None:
            store = stack.enter_context(TemporaryDirectory(prefix="turnwright-"))
        place = store if isinstance(store, Store) else Store.open(store)
        if executor is None:
            executor = stack.enter_context(local(workers))
        require_reach(place.place, executor, arrays=True)
        shared = _plan_shared(job, budget, place, correction=correction, report=report)
        run = partial(
            _run_draws, shared=shared, executor=executor, store=place, seed=seed, correction=correction, report=report,
            study=case_key({"shared": shared}),
        )  # fmt: skip
        inputs = {
            name: spread
            for name, spread in budget.inputs(correction=correction).items()
            if servos_respond(job) or not name.startswith("servo ")
        }
        drawn = budget.draw(count, seed=seed, correction=correction)
        draws = {name: drawn[name] for name in inputs}
        rows = run("cases", draws)
        good = [k for k, row in enumerate(rows) if "reason" not in row]
        reasons = tuple(str(row["reason"]) for row in rows if "reason" in row)
        if len(good) < MIN_CASES:
            raise StudyError(f"{len(good)} of {count} cases succeeded, at least {MIN_CASES} are needed: {reasons[0]}")
        used = {name: values[good] for name, values in draws.items()}
        columns = {
            name: np.array([rows[k][name] for k in good], dtype=np.float64)
            for name in rows[good[0]]
            if not name.endswith("map")
        }
        outcomes: dict[str, Outcome] = {}
        for number, kind in enumerate((AS_PLANNED, CORRECTED)[: 1 + correction]):
            report("sensitivity", number, 1 + correction)
            names = set(budget.inputs(correction=kind == CORRECTED))
            maps = np.stack([place.array(rows[k][_column_name("map", kind)]).ravel() for k in good])
            outcomes[kind] = _evaluate(
                job, {name: inputs[name] for name in inputs if name in names}, used, columns, maps, limits, kind, seed,
                failed=len(reasons), feed=shared["cuts"][""]["feed"],
            )  # fmt: skip
        report("sensitivity", 1, 1)
        tightening = None
        kind = CORRECTED if correction else AS_PLANNED
        if confirm and outcomes[kind].explained_variance is not None:
            tightening = _confirm(run, inputs, draws, outcomes[kind], limits, kind)
    return ToleranceStudy(
        job=job, budget=budget, seed=seed, draws=MappingProxyType(used), columns=MappingProxyType(columns),
        reasons=reasons, limits=MappingProxyType(limits), outcomes=MappingProxyType(outcomes), tightening=tightening,
    )  # fmt: skip


def _check_axes(job: Job, budget: ErrorBudget) -> None:
    """Raise if a budget names the servo of an axis that the machine lacks; `USUAL_AXES` are always allowed."""
    axes = job.machine.axes
    for name in budget.errors:
        if name.startswith("servo ") and name[-1] not in {*axes, *USUAL_AXES}:
            raise InputError(
                f"{name}: {job.machine.name} has no axis {name[-1]}, it has {', '.join(sorted(axes))}: name "
                "one of them, or leave it out"
            )


def _limits(job: Job) -> dict[str, float]:
    """Return the tolerance of each measure that has one. [nm]."""
    limits = {}
    if job.tolerances.form_pv is not None:
        limits["form_pv_nm"] = job.tolerances.form_pv * NM
    if job.tolerances.sq is not None:
        limits |= {f"sq_nm@{patch.name}": job.tolerances.sq * NM for patch in job.simulation.patches}
    if not limits:
        raise JobError(
            "the job states 0 tolerances that can be evaluated, it needs at least 1: add form_pv, or sq and a patch, "
            "under [tolerances]"
        )
    return limits


def _plan_shared(
    job: Job, budget: ErrorBudget, store: Store, *, correction: bool, report: StageProgress
) -> dict[str, Any]:
    planned = {"job": job.to_toml(), "files": list_files(job.table())}
    key = case_key({"planned": planned, "budget": budget.table(), "correction": correction})
    row = store.row(key)
    if row is None:
        row = plan_cuts(
            job, budget, store, correction=correction, progress=lambda done, total: report("plan", done, total)
        )
        store.put_row(key, row)
    report("plan", 1, 1)
    return row


def _run_draws(
    stage: str,
    draws: Mapping[str, Floats],
    *,
    shared: Mapping[str, Any],
    executor: Executor,
    store: Store,
    seed: int,
    study: str,
    correction: bool,
    report: StageProgress,
) -> list[Row]:
    cases = []
    for k in range(next(iter(draws.values())).size):
        draw = {name: float(values[k]) for name, values in draws.items()}
        data = {"draw": draw, "seed": [seed, k], "correction": correction, "study": study}
        cases.append(Case(key=case_key(data), data=data))
    return run_cases(
        carry_out, cases, shared=shared, executor=executor, store=store, progress=partial(report, stage)
    )  # fmt: skip


def _column_name(measure: str, kind: str) -> str:
    return measure if kind == AS_PLANNED else f"{CORRECTED} {measure}"


def _meet_tolerances(columns: Mapping[str, Floats], limits: Mapping[str, float], kind: str) -> dict[str, Bools]:
    """Return which cases meet each tolerance. Each (n,)."""
    return {measure: columns[_column_name(measure, kind)] <= limit for measure, limit in limits.items()}


def _evaluate(
    job: Job,
    inputs: Mapping[str, Spread],
    draws: Mapping[str, Floats],
    columns: Mapping[str, Floats],
    maps: Floats,
    limits: Mapping[str, float],
    kind: str,
    seed: int,
    *,
    failed: int,
    feed: float,
) -> Outcome:
    keeps = _meet_tolerances(columns, limits, kind)
    every = np.logical_and.reduce(list(keeps.values()))
    probability = binomial_interval(int(every.sum()), every.size + failed)
    groups = group_inputs(list(inputs), group_of)
    scaled = np.stack([(draws[name] - one.mean) / one.deviation for name, one in inputs.items()], axis=1)
    neighbour = neighbour_indices(scaled, columns[_column_name("form_pv_nm", kind)], list(groups.values()))
    lines = make_lines(job, feed)
    weight = np.broadcast_to(lines.weight, (lines.rows.size, lines.columns.size)).ravel()
    seen = np.flatnonzero(np.isfinite(maps).all(axis=0))
    if seen.size > MODEL_HEIGHTS:  # at random, so that no pattern of the part is sampled at a single phase
        seen = np.sort(np.random.default_rng(seed).choice(seen, MODEL_HEIGHTS, replace=False))
    maps, weight = maps[:, seen], weight[seen]
    pv = columns[_column_name("form_pv_nm", kind)]
    # A subset of heights has a slightly smaller peak to valley, which is scaled to that of the whole maps.
    maps = maps * float(np.mean(pv) / np.mean(np.ptp(maps, axis=1)))
    model = MapModel.fit(scaled, maps, weight)
    study = _SignatureAnalysis(inputs=inputs, groups=groups, scaled=scaled, maps=maps, weight=weight, pv=pv, seed=seed)
    effects: list[tuple[Any, ...]] = [(None,) * 4] * len(groups)
    if model is not None:
        finish = [one for name, one in keeps.items() if name != "form_pv_nm"]
        fine = np.logical_and.reduce([*finish, np.ones(every.size, dtype=np.bool_)])
        halves = study.halved(model, limits.get("form_pv_nm"), draws, fine, probability.value)
        effects = [(*index, *half) for *index, half in zip(*study.indices(model), halves, strict=True)]
    sensitivities = [
        Sensitivity(
            group=group, first=first, total=total, neighbour_index=float(share), probability=better, percentile_nm=pv95
        )
        for group, share, (first, total, better, pv95) in zip(groups, neighbour, effects, strict=True)
    ]
    sensitivities.sort(key=lambda one: -_importance(one))
    return Outcome(
        probability=probability,
        probabilities=MappingProxyType(
            {name: binomial_interval(int(one.sum()), one.size + failed) for name, one in keeps.items()}
        ),
        sensitivities=tuple(sensitivities),
        explained_variance=None if model is None else model.explained_variance(),
        advice=_write_advice(sensitivities, probability.value, pv, model, fewest=MapModel.min_cases(len(inputs))),
    )


def _importance(one: Sensitivity) -> float:
    return one.neighbour_index if one.total is None else one.total.value


def _select_group(sensitivities: Sequence[Sensitivity], before: float) -> Sensitivity:
    """Return the group to reduce first: by the gain in probability, then by the percentile."""

    def worth(one: Sensitivity) -> tuple[float, float]:
        if one.probability is None or one.percentile_nm is None:
            return 0.0, _importance(one)
        return max(round(one.probability - before, 2), 0.0), -one.percentile_nm

    return max(sensitivities, key=worth)


def _write_advice(
    sensitivities: Sequence[Sensitivity], before: float, pv: Floats, model: MapModel | None, *, fewest: int
) -> str:
    if model is None:
        return f"{pv.size} cases are too few to determine what to tighten first: draw at least {fewest}"
    best = _select_group(sensitivities, before)
    advice = (
        f"tighten {best.group} first: with half its spread the yield changes from {before:.1%} to about "
        f"{best.probability:.1%}, and 95 of 100 parts are within {best.percentile_nm:.3g} nm PV instead of "
        f"{np.quantile(pv, 0.95):.3g} nm"
    )
    if (share := model.explained_variance()[0]) >= POOR_VARIANCE:
        return advice
    return f"{advice}; a rough estimate: the linear model explains only {max(share, 0.0):.0%} of the variance"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _SignatureAnalysis:
    """Sensitivity analysis with a model of maps as sums of signatures."""

    inputs: Mapping[str, Spread]  # distributions, and the numbers of those in each group
    groups: Mapping[str, list[int]]
    scaled: Floats  # draws in units of their standard deviations. (n, d)
    maps: Floats  # form errors of the cases (n, m) [nm], and the area of each height. (m,)
    weight: Floats
    pv: Floats  # peak to valley of the whole maps. (n,) [nm]
    seed: int  # seed of all draws

    def points(self, unit: Floats) -> Floats:
        """Return scaled draws of points in the unit cube. (n, d)."""
        rows = [(one.quantile(unit[:, k]) - one.mean) / one.deviation for k, one in enumerate(self.inputs.values())]
        return np.stack(rows, axis=1)

    def indices(self, model: MapModel) -> tuple[list[Interval], list[Interval]]:
        """Return first-order and total indices of form error PV, with their intervals.

        The intervals combine the bootstrap of the cases with the sampling error of the indices.
        """
        groups, many = list(self.groups.values()), len(self.inputs)
        unit = unit_points(2 * many, SAMPLES_LOG2, self.seed)
        a, b = self.points(unit[:, :many]), self.points(unit[:, many:])
        best = sobol_indices(model.pv, groups, a, b)
        rng = np.random.default_rng([self.seed, 1])
        again = []
        thin = slice(None, None, max(1, self.maps.shape[1] // BOOTSTRAP_HEIGHTS))
        for _ in range(BOOTSTRAP_COUNT):
            chosen = np.asarray(rng.integers(0, self.scaled.shape[0], size=self.scaled.shape[0]))
            other = MapModel.fit(self.scaled, self.maps[:, thin], self.weight[thin], chosen)
            assert other is not None  # noqa: S101 - as many cases as before
            indices = sobol_indices(other.pv, groups, a, b)
            again.append((indices.first, indices.total))
        both = []
        for values, error, spread in zip(best[:2], best[2:], np.std(np.array(again), axis=0), strict=True):
            half = 1.96 * np.hypot(error, spread)
            both.append(
                [
                    Interval(float(v), max(float(v - h), 0.0), min(float(v + h), 1.0))
                    for v, h in zip(values, half, strict=True)
                ]
            )
        return both[0], both[1]

    def halved(
        self, model: MapModel, limit: float | None, draws: Mapping[str, Floats], fine: Bools, before: float
    ) -> list[tuple[float, float]]:
        """Return probability and 95th percentile of form error PV [nm], each group at half its spread.

        The form error comes from the model; the roughness from the cases, weighted by the ratio of the densities with
        half and with full spread.
        """
        samples = self.points(unit_points(len(self.inputs), SAMPLES_LOG2 + 2, self.seed))
        names = list(self.inputs)

        def form(group: Sequence[int]) -> tuple[float, float]:
            tight = samples.copy()
            tight[:, group] /= 2
            pv = model.pv(tight)
            return 1.0 if limit is None else float(np.mean(pv <= limit)), float(np.quantile(pv, 0.95))

        now, percentile_nm = form([])
        # The part of the spread that the model does not explain is assumed unchanged by halving a group.
        real = float(np.quantile(self.pv, 0.95)) / percentile_nm
        outcomes = []
        for group in self.groups.values():
            keeps, percentile_nm = form(group)
            weight = np.ones(fine.size)
            for k in group:
                weight *= self.inputs[names[k]].density_halved(draws[names[k]])
            effective = weight.sum() ** 2 / max(float((weight**2).sum()), 1e-300)
            better = float(weight @ fine / weight.sum()) if effective >= MIN_EFFECTIVE_CASES else float(fine.mean())
            rise = keeps * better - now * float(fine.mean())
            outcomes.append((float(np.clip(before + rise, 0.0, 1.0)), real * percentile_nm))
        return outcomes


def _confirm(
    run: Callable[[str, Mapping[str, Floats]], list[Row]],
    inputs: Mapping[str, Spread],
    draws: Mapping[str, Floats],
    outcome: Outcome,
    limits: Mapping[str, float],
    kind: str,
) -> Tightening:
    best = _select_group(outcome.sensitivities, outcome.probability.value)
    tight = {
        name: (values + inputs[name].mean) / 2 if group_of(name) == best.group else values
        for name, values in draws.items()
    }
    rows = run("confirm", tight)
    good = [
        "reason" not in row and all(row[_column_name(measure, kind)] <= limit for measure, limit in limits.items())
        for row in rows
    ]
    return Tightening(group=best.group, probability=binomial_interval(sum(good), len(good)), before=outcome.probability)
