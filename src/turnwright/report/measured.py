"""The pages after a measurement: how far the part is off, why, and what the corrected job should leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright.errors import InputError
from turnwright.report.page import Page, page_file, set_page

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path as File

    from turnwright.diagnosis import Diagnosis, Finding
    from turnwright.job import Correction, Measured
    from turnwright.report.figures import Picture

__all__ = ["write_correction", "write_diagnosis", "write_measured"]

NM = 1e6

MOST_LENSLETS = 200
"""Rows of the table of lenslets; the CSV file beside the page has them all."""

MARKS = 6
"""Causes whose marks are drawn."""

FORETOLD = (
    "The prediction is what was measured, cusps and noise of the instrument among it, and what the correction changes "
    "by simulation. It holds if all that was found repeats."
)

ON_PURPOSE = (
    "The simulation knows nothing of what has no cause. So alone it shows what the part is aimed at beside its design: "
    "the form that comes on top, with its sign turned."
)

EITHER = (
    "Move the tool by this, or cut with the corrected job; not both. X is positive away from the axis on the side "
    "where the tool cuts, Z away from the part, the height toward growing spindle angles under the tool."
)

CORE = 0.05
"""Share of the radius around the axis in which a core is looked for."""

SHARP = 8
"""Half pixels on its radius from which a core is more than a blurred tip of the surface."""

ALL = (
    "Each number lies in the interval in 95 of 100 cases, whatever the others are, and whatever lobes of the spindle, "
    "drift and low form share in it. Where the interval is as wide as what was plausible, the maps tell nothing."
)

TERMS = "What has no single cause: with several maps of a part, of it that which they share."


class _Number(NamedTuple):
    """One of the numbers that matter."""

    label: str
    value: str
    unit: str
    note: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Section:
    """A heading with what belongs to it."""

    title: str
    text: Sequence[str] = ()
    pictures: Sequence[tuple[str, Picture]] = ()
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    numeric: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sheet(Page):
    """What a page says, ready to be set."""

    grade: str
    word: str
    why: str
    numbers: Sequence[_Number]
    notes: Sequence[str]
    sections: Sequence[_Section]


def _number(label: str, value: float, note: str) -> _Number:
    return _Number(label, f"{value:.4g}", "nm", note)


def write_measured(measured: Measured, path: str | PathLike[str]) -> File:
    """Write the page of a measured part: how far it is off.

    Parameters
    ----------
    measured
        From `turnwright.measure`.
    path
        Where to; in a folder that exists the page is called ``report.html``.
    """
    path = page_file(path)
    rough = measured.roughness
    sheet = _Sheet(
        title=measured.job.part.name or "Part",
        kind="Measured",
        **_judged(measured),
        numbers=[
            _number(
                "Form error PV", measured.form_pv_nm, f"rms {measured.form_rms_nm:.4g} nm, within the clear radius"
            ),
            _number(
                "Residual", measured.registration.rms_nm, f"rms of {measured.registration.count} registered heights"
            ),
            _number("Texture Sq", rough.sq_nm, "of what the Zernike terms leave")
            if rough
            else _Number("Spikes", str(measured.spikes), "", "taken out"),
        ],
        notes=_open_questions(measured),
        sections=[*_form(measured), *_lens_section(measured), *_through_instrument(measured), _placed(measured)],
        job=measured.job.to_toml(),
    )
    return set_page("sheet.html.j2", sheet, path)


def write_diagnosis(measured: Sequence[Measured], found: Diagnosis, path: str | PathLike[str]) -> File:
    """Write the page of a diagnosis: why parts are off.

    Parameters
    ----------
    measured
        What the diagnosis rests on.
    found
        From `turnwright.diagnose`.
    path
        Where to; in a folder that exists the page is called ``report.html``.
    """
    path = page_file(path)
    worth = [one for one in found if one.verdict == "correct"]
    sheet = _Sheet(
        title=" and ".join(dict.fromkeys(one.job.part.name or "part" for one in measured)),
        kind="Diagnosis",
        grade="warn" if worth else "good",
        word=f"{len(worth)} to correct" if worth else "Nothing to correct",
        why=", ".join(one.name for one in worth) or "No cause is worth correcting.",
        numbers=[
            _number("Off the design", found.measured_rms_nm, "rms beyond a change of pose"),
            _number("Explained", found.explained_rms_nm, "rms of what the causes make of it"),
            _number("Left", found.unexplained_rms_nm, f"rms, noise {max(found.noise_nm):.3g} nm from point to point"),
        ],
        notes=[note for one in measured for note in _open_questions(one)],
        sections=[
            _causes(found),
            _terms(found),
            *_setup(measured, found),
            _marks(measured, found),
            *(section for one in measured for section in _through_instrument(one)),
        ],
        job=measured[0].job.to_toml(),
    )  # fmt: skip
    return set_page("sheet.html.j2", sheet, path)


def write_correction(
    measured: Sequence[Measured], found: Diagnosis, better: Correction, path: str | PathLike[str]
) -> File:
    """Write the page of a correction: what was changed, and what should be left.

    Parameters
    ----------
    measured, found
        What the correction rests on.
    better
        From `turnwright.correct`.
    path
        Where to; in a folder that exists the page is called ``report.html``.
    """
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    path = page_file(path)
    told = better.numbers_nm
    radius = better.job.part.radius
    names = {"measured": "as measured", "predicted": "predicted after the correction", "simulated": "simulated alone"}
    before = {"measured": better.measured, "predicted": better.predicted, "simulated": better.simulated}
    what = [
        "The tool is planned as it was found." if better.job.tool != measured[0].job.tool else "",
        "The machine is planned as it was found." if better.job.machine != measured[0].job.machine else "",
        f"The part is aimed at without what repeats over wavelengths above {better.cutoff:.3g} mm."
        if better.cutoff
        else "The part is aimed at as it was: nothing that repeats is left of it.",
    ]
    sheet = _Sheet(
        title=better.job.part.name or "Part",
        kind="Correction",
        grade="good",
        word="Corrected job",
        why=" ".join(one for one in what if one),
        numbers=[
            _number(names[name].capitalize(), rms, f"rms; PV {pv:.4g} nm") for name, (pv, rms) in told.items()
        ],
        notes=[note for one in measured for note in _open_questions(one)],
        sections=[
            _Section(
                title="Before and after",
                text=[*better.sentences, FORETOLD, *([ON_PURPOSE] if better.job.part.correction is not None else [])],
                pictures=[
                    (names[name], draw.places_map(one, radius)) for name, one in before.items() if one is not None
                ],
            ),
            _causes(found),
            _terms(found),
        ],
        job=better.job.to_toml(),
    )  # fmt: skip
    return set_page("sheet.html.j2", sheet, path)


def _judged(measured: Measured) -> dict[str, str]:
    """Return grade, word and reason: whether the form keeps its tolerance."""
    verdicts = measured.verdicts
    form = next((one for one in verdicts if one.tolerance == "form_pv"), None)
    if form is None:
        return {"grade": "plain", "word": "Measured", "why": "The job states no tolerances.form_pv to judge by."}
    why = " ".join(f"{one.sentence}." for one in verdicts)
    return {
        "grade": "good" if form.kept else "bad",
        "word": "Keeps its form" if form.kept else "Form is off",
        "why": why,
    }


def _through_instrument(measured: Measured) -> list[_Section]:
    """Return what the instrument makes of design and cusps, if the job states one."""
    text = [f"{one[0].upper()}{one[1:]}." for one in measured.as_seen]
    seen = measured.job.measurement.instrument
    if seen is not None and seen.source:
        text.append(f"Source: {seen.source}.")
    return [_Section(title="Through the instrument", text=text)] if text else []


def _open_questions(measured: Measured) -> list[str]:
    """Return what the registration could not settle."""
    return list(measured.open_questions)


def _form(measured: Measured) -> list[_Section]:
    """Return the pictures of the error, and its terms."""
    from turnwright.report import figures as draw  # noqa: PLC0415

    radius = measured.job.part.radius
    pictures = [("over the part", draw.places_map(measured.error, radius, like=measured.registration.error))]
    pictures.append(("around the axis", draw.over_radius(measured.error, radius)))
    sections = [_Section(title="Cut minus design", pictures=pictures)]
    terms = measured.zernike
    if terms is not None:
        order = np.argsort(-np.abs(terms.coefficients))[:16]
        rows = [
            (f"Z{terms.indices[k]}", f"{terms.coefficients[k] * NM:+.4g}", f"{terms.uncertainty[k] * NM:.2g}")
            for k in order
        ]
        sections.append(
            _Section(
                title="Form in fringe Zernike terms",
                text=["The largest of 37 terms over the clear radius, in the frame of the part."],
                columns=("term", "coefficient [nm]", "uncertainty [nm]"),
                rows=rows,
                numeric=frozenset({1, 2}),
            )
        )
    return sections


def _lens_section(measured: Measured) -> list[_Section]:
    """Return the lenslets, if there are any."""
    found = measured.lenslets
    if found is None:
        return []
    from turnwright.report import lenslets as draw  # noqa: PLC0415

    lines = found.csv().splitlines()
    head, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    return [
        _Section(
            title="Lenslets",
            text=[found.summary, found.frame],
            pictures=[("dislocation", draw.dislocation_map(found))],
            columns=head,
            rows=rows[:MOST_LENSLETS],
            numeric=frozenset(range(1, len(head))),
        )
    ]


def _placed(measured: Measured) -> _Section:
    """Return where the map lies on the part."""
    found = measured.registration
    values = dict(zip(("x", "y", "z"), found.pose.shift, strict=True))
    values |= {"rotation": found.pose.rotation, "tilt_x": found.pose.tilt[0], "tilt_y": found.pose.tilt[1]}
    rows = []
    for name, value in values.items():
        length = name in ("x", "y", "z")
        std = found.std.get(name)
        unit = "mm" if length else "mrad"
        scale = 1.0 if length else 1e3
        rows.append(
            (name, f"{value * scale:.9g}", unit, "held" if name in found.held or std is None else f"{std * scale:.2g}")
        )
    return _Section(
        title="Where the map lies",
        text=[found.sentences[0], f"{measured.spikes} heights stood out of their neighbours and were taken out."],
        columns=("of the pose", "value", "unit", "standard deviation of the fitted number"),
        rows=rows,
        numeric=frozenset({1, 3}),
    )


def _causes(found: Diagnosis) -> _Section:
    """Return the table of causes."""
    return _Section(
        title="Causes",
        text=[ALL],
        columns=("source", "value", "interval", "plausible", "rms [nm]", "verdict", "why"),
        rows=[
            (
                one.name,
                _quantity(one, one.value),
                _between(one, one.interval),
                _quantity(one, one.plausible),
                f"{one.rms_nm:.3g}",
                one.verdict,
                one.why,
            )
            for one in found
        ],
        numeric=frozenset({4}),
    )


def _terms(found: Diagnosis) -> _Section:
    """Return the table of what has no single cause."""
    return _Section(
        title="Spindle, drift and form",
        text=[TERMS, *_repeatability(found)],
        columns=("term", "rms [nm]", "uncertainty [nm]", "shared [nm]", "why"),
        rows=[
            (
                one.name,
                f"{one.rms_nm:.3g}",
                f"{one.uncertainty_nm:.2g}",
                "" if one.common_nm is None else f"{one.common_nm:.3g}",
                one.why,
            )
            for one in found.contributions
        ],
        numeric=frozenset({1, 2, 3}),
    )


def _repeatability(found: Diagnosis) -> list[str]:
    """Return by how much the maps of a part differ."""
    if found.repeatability_nm is None:
        return []
    return [f"Repeatability: the maps of a part differ from cut to cut by {found.repeatability_nm:.3g} nm rms."]


def _setup(measured: Sequence[Measured], found: Diagnosis) -> list[_Section]:
    """Return what to do at the machine, with the rule of the handbook and the defect at the centre beside it."""
    from turnwright.diagnosis import moves  # noqa: PLC0415
    from turnwright.report import figures as draw  # noqa: PLC0415

    asked = moves(found)
    text = [
        *([EITHER] if asked else []),
        *(one for sample in measured for one in (*_handbook(sample, found), *_centre(sample))),
    ]
    if not text:
        return []
    return [
        _Section(
            title="At the machine",
            text=text,
            pictures=[("", draw.tool_moves(asked))] if asked else [],
            columns=("axis", "move [µm]", "within [µm]", "in words"),
            rows=[(one.axis, f"{one.by * 1e3:+.4g}", f"{one.uncertainty * 1e3:.2g}", one.sentence) for one in asked],
            numeric=frozenset({1, 2}),
        )
    ]


def _handbook(sample: Measured, found: Diagnosis) -> list[str]:
    """Return what the rule of thumb reads from a sphere, beside what was found."""
    from turnwright.diagnosis import handbook_offset  # noqa: PLC0415
    from turnwright.metrology import best_fit  # noqa: PLC0415
    from turnwright.surface import Sphere  # noqa: PLC0415

    surface, exact = sample.job.part.surface, [one.value for one in found if one.name == "offset x"]
    if not isinstance(surface, Sphere) or not exact:
        return []
    pv_nm = best_fit(sample.placed, "sphere").pv_nm
    ruled = handbook_offset(pv_nm / NM, surface.radius, 2 * sample.job.part.radius)
    name = sample.job.part.name or "the part"
    said = (
        f"The rule of the handbook, 8 R/A PV, reads an offset of {ruled * 1e3:.3g} µm from the {pv_nm:.4g} nm that the "
        f"best sphere leaves of {name}; the exact contact says {exact[0] * 1e3:+.4g} µm, so the rule is off by "
        f"{(ruled - abs(exact[0])) * 1e3:+.2g} µm, and it knows no sign."
    )
    return [said]


def _centre(sample: Measured) -> list[str]:
    """Return what the core at the centre says of the tool's height, where the map shows one."""
    from turnwright.diagnosis import centre_defect  # noqa: PLC0415

    part = sample.job.part
    try:
        core = centre_defect(sample.placed, part, within=CORE * part.radius, sense=sample.job.strategy.sense)
    except InputError:  # too few points there
        return []
    return [] if core is None or core.uncertainty > core.radius / SHARP else [core.sentence]


def _between(finding: Finding, interval: tuple[float, float]) -> str:
    """Return an interval as people read it."""
    unit, factor = _unit(finding)
    low, high = (one * factor for one in interval)
    return f"{low:.4g} to {high:.4g} {unit}".strip() if np.isfinite([low, high]).all() else "open"


def _quantity(finding: Finding, value: float) -> str:
    """Return a value as people read it."""
    unit, factor = _unit(finding)
    return f"{value * factor:.4g} {unit}".strip()


def _unit(finding: Finding) -> tuple[str, float]:
    """Return the unit that people read a finding in, and what its values are multiplied by."""
    if finding.unit.startswith("mm"):
        return f"µm{finding.unit.removeprefix('mm')}", 1e3
    return ("µrad", 1e6) if finding.unit == "rad" else (finding.unit, 1.0)


def _marks(measured: Sequence[Measured], found: Diagnosis) -> _Section:
    """Return the marks of the causes that matter most, and what is left."""
    from turnwright.report import figures as draw  # noqa: PLC0415

    called = sorted(found, key=lambda one: -one.rms_nm)[:MARKS]
    called = [one for one in called if one.rms_nm > 0]
    pictures = [
        (f"{one.name}, {sample.job.part.name or 'part'}", draw.places_map(marks[one.name], sample.job.part.radius))
        for sample, marks in zip(measured, found.signatures, strict=True)
        for one in called
    ]
    pictures += [
        (f"left unexplained, {sample.job.part.name or 'part'}", draw.places_map(left, sample.job.part.radius))
        for sample, left in zip(measured, found.residuals, strict=True)
    ]
    return _Section(title="What each cause leaves", pictures=pictures)
