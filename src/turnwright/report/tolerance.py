"""Report page of a tolerance study: yield, and the most important set-up errors."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from turnwright.report import study_figures as figures
from turnwright.report.drawing import draw
from turnwright.report.page import Number, Page, Section, Table, write_page

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path as File

    from turnwright.studies import Interval, Outcome, ToleranceStudy

__all__ = ["write_tolerance"]

GOOD_PROBABILITY, BAD_PROBABILITY = 0.95, 0.5
"""Smallest probability graded as good, and largest graded as bad."""

MIN_MODEL_R2 = 0.8
"""Explained variance below which the linear model of signatures is flagged as a rough guide."""

SENSITIVITY_TEXT = (
    "Sensitivities are Sobol' indices of the form error PV. They come from a linear model: each error map is a sum of "
    "one signature per error, fitted to the cases. The column 'by neighbours' is a model-free first-order index from "
    "nearest neighbours among the cases; it scatters by about one over the square root of their number. With half the "
    "spread of a group, form is from the linear model and finish from the reweighted cases."
)


def write_tolerance(study: ToleranceStudy, path: str | PathLike[str]) -> File:
    """Write the page of a tolerance study, see `write_page`."""
    kind, best = list(study.outcomes.items())[-1]
    grade, word = _grade(best.probability.value)
    page = Page(
        kind="Tolerances",
        job=study.job,
        grade=grade,
        word=word,
        why=[f"{study.count} parts, {kind}"],
        numbers=_numbers(study),
        notes=_notes(study),
        sections=[_distributions(study), *(_sensitivities(*one) for one in study.outcomes.items()), _budget(study)],
    )
    return write_page(page, path)


def _grade(probability: float) -> tuple[str, str]:
    if probability >= GOOD_PROBABILITY:
        return "good", "Meets its tolerances"
    return ("warn", "May miss its tolerances") if probability >= BAD_PROBABILITY else ("bad", "Misses its tolerances")


def _share(one: Interval | None) -> str:
    return "" if one is None else f"{one.value:.3f} ({one.low:.3f} to {one.high:.3f})"


def _percent(one: Interval) -> str:
    return f"{one.value:.1%} ({one.low:.1%} to {one.high:.1%})"


def _label(measure: str) -> str:
    """Return the display name of a measure."""
    name, _, where = measure.partition("@")
    called = {
        "form_pv_nm": "form error PV", "form_rms_nm": "form error RMS", "wavefront_rms_nm": "wavefront error RMS",
        "sq_nm": "Sq", "sa_nm": "Sa",
    }[name]  # fmt: skip
    return f"{called}, {where}" if where else called


def _numbers(study: ToleranceStudy) -> list[Number]:
    numbers = []
    for kind, outcome in study.outcomes.items():
        p = outcome.probability
        numbers.append(Number(f"yield, {kind}", f"{p.value:.1%}", "", f"{p.low:.1%} to {p.high:.1%}"))
    kind = list(study.outcomes)[-1]
    name = "form_pv_nm" if kind == "as planned" else "corrected form_pv_nm"
    p95 = study.percentiles(name)[0.95]
    note = f"95th percentile, {kind}; {_format_interval(p95)}"
    numbers.append(Number("form error PV", f"{p95.value:.3g}", "nm", note))
    return numbers[:3]


def _format_interval(one: Interval) -> str:
    high = f"{one.high:.3g}" if math.isfinite(one.high) else "unbounded (too few cases)"
    return f"{one.low:.3g} to {high}" if math.isfinite(one.low) else f"up to {high}"


def _notes(study: ToleranceStudy) -> list[str]:
    notes = [*study.remarks, *(f"{kind}: {outcome.advice}" for kind, outcome in study.outcomes.items())]
    if study.tightening is not None:
        t = study.tightening
        notes.append(
            f"with half the spread of {t.group} and the same number of cases, {_percent(t.probability)} meet all "
            f"tolerances, {_percent(t.before)} before"
        )
    for kind, outcome in study.outcomes.items():
        if outcome.explained_variance is not None and outcome.explained_variance[0] < MIN_MODEL_R2:
            share = max(outcome.explained_variance[0], 0)
            notes.append(
                f"{kind}: the linear model explains only {share:.0%} of the variance of form error PV, so the "
                "sensitivities are a rough guide: too few cases, or form is not linear in the errors"
            )
    for reason, count in Counter(study.reasons).most_common(3):
        notes.append(f"{count} cases failed and count as parts out of tolerance: {reason}")
    return notes


def _distributions(study: ToleranceStudy) -> Section:
    plain = [name for name in study.columns if not name.startswith("corrected")]
    pictured = [name for name in plain if name in study.limits or name == "form_pv_nm"]
    pictures = []
    for name in pictured:
        values = {"as planned": study.columns[name]}
        if f"corrected {name}" in study.columns:
            values["corrected"] = study.columns[f"corrected {name}"]
        pictures.append(draw(figures.histogram, values, _label(name), study.limits.get(name)))
    rows = []
    for name in plain:
        for kind, outcome in study.outcomes.items():
            column = name if kind == "as planned" else f"corrected {name}"
            limit = study.limits.get(name)
            probability = "" if limit is None else _percent(outcome.probabilities[name])
            shown = [f"{one.value:.3g} ({_format_interval(one)})" for one in study.percentiles(column).values()]
            rows.append([f"{_label(name)}, {kind}", *shown, "" if limit is None else f"{limit:.4g}", probability])
    measurement = study.job.measurement
    free = ", ".join(name.replace("_", " ") for name in measurement.free)
    exclusion = f", with {', '.join(measurement.fixed)} fixed" if measurement.fixed else ""
    return Section(
        title="Distributions",
        text=[
            f"Form error is evaluated over the whole part, weighted by area, after registration in {free}{exclusion}.",
            "Finish is evaluated over each patch, as stated by the roughness table of the job.",
            "Intervals are 95 % confidence intervals.",
        ],
        items=[
            *pictures,
            Table(
                columns=["", "5th percentile", "median", "90th", "95th", "99th", "tolerance", "yield"],
                rows=rows,
                numeric=range(1, 8),
                dense=True,
            ),
        ],
    )


def _sensitivities(kind: str, outcome: Outcome) -> Section:
    rows = [
        (
            one.group, _share(one.first), _share(one.total), f"{one.neighbour_index:.2f}",
            "" if one.probability is None else f"{one.probability:.1%}",
            "" if one.percentile_nm is None else f"{one.percentile_nm:.3g}",
        )
        for one in outcome.sensitivities
    ]  # fmt: skip
    columns = ["", "first order", "total", "by neighbours", "yield, half the spread", "95th percentile [nm]"]
    return Section(
        title=f"Sensitivities, {kind}",
        text=[outcome.advice[0].upper() + outcome.advice[1:] + ".", _model(outcome)],
        items=[
            draw(figures.tornado, outcome.sensitivities, kind),
            Table(columns=columns, rows=rows, numeric=range(1, 6), dense=True),
        ],
    )


def _model(outcome: Outcome) -> str:
    if outcome.explained_variance is None:
        return (
            "There are too few cases for the linear model: sensitivities are first-order indices by nearest neighbours "
            "among the cases, which scatter by about one over the square root of their number."
        )
    pv, rms = (max(one, 0.0) for one in outcome.explained_variance)
    shares = f"{pv:.1%} of the variance of PV and {rms:.1%} of that of RMS"
    return f"{SENSITIVITY_TEXT} In leave-one-out cross-validation the model explains {shares}."


def _budget(study: ToleranceStudy) -> Section:
    budget = study.budget
    drift = "is linear" if budget.settling is None else f"decays with a time constant of {budget.settling:g} s"
    return Section(
        title="Error budget",
        text=[
            f"{budget.name or 'Budget'}: drift {drift}; instrument noise {budget.noise * 1e6:.3g} nm.",
            f"Test parts: {', '.join(budget.test_parts)}; they share tool, slides and servos with the part.",
            "Drift, mounting and chuck tilt are drawn independently for every cut.",
        ],
        items=[
            Table(
                columns=["error", "spread", "source"],
                rows=[
                    [name, spread.format(budget.unit(name)), spread.source] for name, spread in budget.errors.items()
                ],
                dense=True,
            )
        ],
    )
