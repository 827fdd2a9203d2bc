"""The page of a study of tolerances: how likely a part keeps them, and what to set up better."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from turnwright.report.measured import _Number, _Section, _Sheet
from turnwright.report.page import page_file, set_page

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path as File

    from turnwright.studies import Interval, Outcome, ToleranceStudy

__all__ = ["write_tolerance"]

LIKELY, UNLIKELY = 0.95, 0.5
"""From which probability a part counts as safe, and below which as not."""

POOR = 0.8
"""Share of the variance below which sums of marks are no good model, and the page says so."""

ESTIMATED = (
    "Shares are Sobol' indices of the form error PV, of error maps as sums of one mark for each error, fitted to the "
    "cases; the column by neighbours has the first-order index by nearest neighbours among the cases, which "
    "scatters by about one over the root of their number. With half of a group's spread the form is that of the sums "
    "of marks, the finish that of the cases, weighted."
)


def write_tolerance(found: ToleranceStudy, path: str | PathLike[str]) -> File:
    """Write the page of a study of tolerances.

    Parameters
    ----------
    found
        What its cases say.
    path
        Where to; in a folder that exists the page is called ``report.html``.

    Returns
    -------
    pathlib.Path
        The file written.
    """
    path = page_file(path)
    kind, best = list(found.outcomes.items())[-1]
    grade, word = _grade(best.probability.value)
    page = _Sheet(
        title=found.job.part.name or "Part",
        kind="Tolerances",
        grade=grade,
        word=word,
        why=f"{found.count} parts, {kind}",
        numbers=_numbers(found),
        notes=_notes(found),
        sections=[_distributions(found), *_sensitivities(found), _budget(found)],
        job=found.job.to_toml(),
    )
    return set_page("sheet.html.j2", page, path)


def _grade(probability: float) -> tuple[str, str]:
    if probability >= LIKELY:
        return "good", "Keeps its tolerances"
    return ("warn", "May miss its tolerances") if probability >= UNLIKELY else ("bad", "Misses its tolerances")


def _share(one: Interval | None) -> str:
    return "" if one is None else f"{one.value:.3f} ({one.low:.3f} to {one.high:.3f})"


def _percent(one: Interval) -> str:
    return f"{one.value:.1%} ({one.low:.1%} to {one.high:.1%})"


def _label(measure: str) -> str:
    """Return a measure as people call it."""
    name, _, where = measure.partition("@")
    called = {"form_pv_nm": "form error PV", "form_rms_nm": "form error RMS", "sq_nm": "Sq", "sa_nm": "Sa"}[name]
    return f"{called}, {where}" if where else called


def _numbers(found: ToleranceStudy) -> list[_Number]:
    numbers = []
    for kind, one in found.outcomes.items():
        p = one.probability
        numbers.append(
            _Number(f"parts that keep all tolerances, {kind}", f"{p.value:.1%}", "", f"{p.low:.1%} to {p.high:.1%}")
        )
    kind = list(found.outcomes)[-1]
    name = "form_pv_nm" if kind == "as planned" else "corrected form_pv_nm"
    p95 = found.percentiles(name)[0.95]
    note = f"of 100 parts 95 keep this, {kind}; {_between(p95)}"
    numbers.append(_Number("form error PV", f"{p95.value:.3g}", "nm", note))
    return numbers[:3]


def _between(one: Interval) -> str:
    high = f"{one.high:.3g}" if math.isfinite(one.high) else "more cases would tell"
    return f"{one.low:.3g} to {high}" if math.isfinite(one.low) else f"up to {high}"


def _notes(found: ToleranceStudy) -> list[str]:
    notes = [f"{kind}: {one.advice}" for kind, one in found.outcomes.items()]
    if found.tightening is not None:
        t = found.tightening
        notes.append(
            f"as many cases again, the same but for half the spread of {t.group}: {_percent(t.probability)} keep all "
            f"tolerances, {_percent(t.before)} before"
        )
    for kind, one in found.outcomes.items():
        if one.foretold is not None and one.foretold[0] < POOR:
            notes.append(
                f"{kind}: sums of marks foretell {max(one.foretold[0], 0):.0%} of the variance of form error PV only, "
                "so its shares are a rough guide: more cases help, or the form is not a sum of small errors"
            )
    for reason, count in Counter(found.reasons).most_common(3):
        notes.append(f"{count} cases could not be carried out and count as parts out of tolerance: {reason}")
    return notes


def _distributions(found: ToleranceStudy) -> _Section:
    from turnwright.report import tolerance_figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    plain = [name for name in found.columns if not name.startswith("corrected")]
    pictured = [name for name in plain if name in found.limits or name == "form_pv_nm"]
    pictures = []
    for name in pictured:
        values = {"as planned": found.columns[name]}
        if f"corrected {name}" in found.columns:
            values["corrected"] = found.columns[f"corrected {name}"]
        pictures.append(("", draw.histogram(values, _label(name), found.limits.get(name))))
    rows = []
    for name in plain:
        for kind, outcome in found.outcomes.items():
            own = name if kind == "as planned" else f"corrected {name}"
            limit = found.limits.get(name)
            kept = "" if limit is None else _percent(outcome.each[name])
            shown = [f"{one.value:.3g} ({_between(one)})" for one in found.percentiles(own).values()]
            rows.append([f"{_label(name)}, {kind}", *shown, "" if limit is None else f"{limit:.4g}", kept])
    asked = found.job.measurement
    free = ", ".join(name.replace("_", " ") for name in asked.free)
    held = f", but for {', '.join(asked.fixed)}, which are fixed" if asked.fixed else ""
    return _Section(
        title="What comes out",
        text=[
            f"Form counts over the whole part beyond the rigid motions that measuring leaves free ({free}{held}).",
            "Every place counts by its area. Finish counts over each patch, as the job's roughness says.",
            "Intervals hold the true value in 95 of 100 studies.",
        ],
        pictures=pictures,
        columns=["", "5 of 100 below", "half below", "90 below", "95 below", "99 below", "tolerance", "keep it"],
        rows=rows,
        numeric=frozenset(range(1, 8)),
    )


def _sensitivities(found: ToleranceStudy) -> list[_Section]:
    from turnwright.report import tolerance_figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    sections = []
    for kind, outcome in found.outcomes.items():
        sections.append(
            _Section(
                title=f"What it comes from, {kind}",
                text=[outcome.advice[0].upper() + outcome.advice[1:] + ".", _model(outcome)],
                pictures=[("", draw.tornado(outcome.sensitivities, kind))],
                columns=["", "alone", "with others", "by neighbours", "kept with half of it", "95 below then [nm]"],
                rows=[
                    [
                        one.group, _share(one.first), _share(one.total), f"{one.given:.2f}",
                        "" if one.probability is None else f"{one.probability:.1%}",
                        "" if one.percentile_nm is None else f"{one.percentile_nm:.3g}",
                    ]
                    for one in outcome.sensitivities
                ],
                numeric=frozenset(range(1, 6)),
            )
        )  # fmt: skip
    return sections


def _model(outcome: Outcome) -> str:
    if outcome.foretold is None:
        return (
            "The cases are too few for sums of marks: shares are first-order indices by nearest neighbours among the "
            "cases, which scatter by about one over the root of their number."
        )
    pv, rms = (max(one, 0.0) for one in outcome.foretold)
    shares = f"{pv:.1%} of the variance of PV and {rms:.1%} of that of RMS"
    return f"{ESTIMATED} Each case left out in turn, they foretell {shares}."


def _budget(found: ToleranceStudy) -> _Section:
    budget = found.budget
    drift = "goes on evenly" if budget.settling is None else f"dies away with a time constant of {budget.settling:g} s"
    return _Section(
        title="Error budget",
        text=[
            f"{budget.name or 'Budget'}: drift {drift}; the instrument's noise is {budget.noise * 1e6:.3g} nm.",
            f"Artefacts: {', '.join(budget.artefacts)}; the tool, slides and servos that cut them cut the part too.",
            "Drift, mounting and chuck tilt are drawn anew for every cut.",
        ],
        columns=["error", "spread", "source"],
        rows=[[name, spread.shown(budget.unit(name)), spread.source] for name, spread in budget.errors.items()],
    )
