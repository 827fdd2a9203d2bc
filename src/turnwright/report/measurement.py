"""Report pages of measured parts: form error, diagnosis and correction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.diagnosis import centre_defect, handbook_offset, moves
from turnwright.errors import InputError
from turnwright.metrology import best_fit
from turnwright.report import figures
from turnwright.report.drawing import draw
from turnwright.report.page import Number, Page, Section, Table, write_page
from turnwright.surface import Sphere

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from os import PathLike
    from pathlib import Path as File

    from turnwright.diagnosis import Diagnosis, Finding
    from turnwright.job import Correction, Measured

__all__ = ["write_correction", "write_diagnosis", "write_measured"]

NM = 1e6

MAX_LISTED_LENSLETS = 200
"""Rows of the table of lenslets; the CSV file has all of them."""

MAX_SIGNATURES = 6
"""Error sources whose signature is drawn."""

PREDICTION_TEXT = (
    "The prediction is the measured error, including cusps and instrument noise, plus the simulated change by the "
    "correction. The diagnosed errors are assumed to repeat."
)

SIMULATION_TEXT = (
    "The simulation does not contain errors without a known source. On its own it therefore shows the compensation "
    "that is added to the nominal surface: the remaining form error with its sign reversed."
)

MOVES_TEXT = (
    "Move the tool by these amounts or cut with the corrected job, not both. X is positive away from the axis on the "
    "side where the tool cuts, Z away from the part, tool height toward increasing spindle angles under the tool."
)

CORE_FRACTION = 0.05
"""Fraction of the semi-diameter within which a centre defect is searched."""

MIN_CORE_SHARPNESS = 8
"""Smallest ratio of the radius of a centre defect to its uncertainty."""

INTERVAL_TEXT = (
    "Each value lies in its interval with a probability of 95 %, for any values of the other sources and any spindle "
    "error motion, drift and low-order form. An interval as wide as the plausible range means that the maps do not "
    "determine the value."
)

TERMS_TEXT = "Contributions without a single source. With several maps of a part, the shared contribution is listed."


def _number(label: str, value: float, note: str) -> Number:
    return Number(label, f"{value:.4g}", "nm", note)


def write_measured(measured: Measured, path: str | PathLike[str]) -> File:
    """Write the page of a measured part, see `write_page`."""
    rough = measured.roughness
    page = Page(
        kind="Measured",
        job=measured.job,
        **_verdict(measured),
        numbers=[
            _number(
                "Form error PV", measured.form_pv_nm, f"rms {measured.form_rms_nm:.4g} nm, over the clear aperture"
            ),
            _number(
                "Residual", measured.registration.rms_nm, f"rms of {measured.registration.count} registered heights"
            ),
            _number("Texture Sq", rough.sq_nm, "after removal of the Zernike terms")
            if rough
            else Number("Outliers", str(measured.outliers), "", "removed"),
        ],
        notes=measured.open_questions,
        sections=[*_form(measured), *_lens_section(measured), *_instrument_sections(measured), _pose(measured)],
    )
    return write_page(page, path)


def write_diagnosis(measured: Sequence[Measured], diagnosis: Diagnosis, path: str | PathLike[str]) -> File:
    """Write the page of a diagnosis of measured parts, see `write_page`."""
    correctable = [one for one in diagnosis if one.verdict == "correct"]
    noise = f"point-to-point noise {max(diagnosis.noise_nm):.3g} nm"
    page = Page(
        title=" and ".join(dict.fromkeys(one.job.part.name or "part" for one in measured)),
        kind="Diagnosis",
        job=measured[0].job,
        grade="warn" if correctable else "good",
        word=f"{len(correctable)} to correct" if correctable else "Nothing to correct",
        why=[", ".join(one.name for one in correctable) or "No error source needs correction."],
        numbers=[
            _number("Form error", diagnosis.measured_rms_nm, "rms after registration"),
            _number("Attributed", diagnosis.explained_rms_nm, "rms attributed to error sources"),
            _number("Residual", diagnosis.unexplained_rms_nm, f"rms; {noise}"),
        ],
        notes=[note for one in measured for note in one.open_questions],
        sections=[
            _error_sources(diagnosis),
            _terms(diagnosis),
            *_setup(measured, diagnosis),
            _signatures(measured, diagnosis),
            *(section for one in measured for section in _instrument_sections(one)),
        ],
    )
    return write_page(page, path)


def write_correction(
    measured: Sequence[Measured], diagnosis: Diagnosis, correction: Correction, path: str | PathLike[str]
) -> File:
    """Write the page of a correction, see `write_page`."""
    sizes = correction.numbers_nm
    is_compensated = correction.job.alone().part.correction is not None
    names = {"measured": "as measured", "predicted": "predicted after the correction", "simulated": "simulated alone"}
    maps = {"measured": correction.measured, "predicted": correction.predicted, "simulated": correction.simulated}
    changes = [
        "The tool path uses the diagnosed tool." if correction.job.tool != measured[0].job.tool else "",
        "The tool path uses the diagnosed machine." if correction.job.machine != measured[0].job.machine else "",
        f"Repeatable form error at wavelengths above {correction.cutoff:.3g} mm is compensated."
        if correction.cutoff
        else "No repeatable form error remains to be compensated.",
    ]
    page = Page(
        kind="Correction",
        job=correction.job,
        grade="good",
        word="Corrected job",
        why=[one for one in changes if one],
        numbers=[_number(names[name].capitalize(), rms, f"rms; PV {pv:.4g} nm") for name, (pv, rms) in sizes.items()],
        notes=[note for one in measured for note in one.open_questions],
        sections=[
            Section(
                title="Before and after",
                text=[*correction.sentences, PREDICTION_TEXT, *([SIMULATION_TEXT] if is_compensated else [])],
                items=[
                    draw(
                        figures.places_map,
                        one,
                        correction.job.alone().part.border,
                        names[name],
                        what=f"Error {names[name]}",
                    )
                    for name, one in maps.items()
                    if one is not None
                ],
            ),
            _error_sources(diagnosis),
            _terms(diagnosis),
        ],
    )
    return write_page(page, path)


def _verdict(measured: Measured) -> dict[str, Any]:
    """Return grade, word and reason of the verdict on the tolerances that the map can decide."""
    verdicts = measured.verdicts
    judged = [one.is_kept for one in verdicts if one.value is not None]
    if not judged:
        return {"grade": "plain", "word": "Measured", "why": ["The job states no tolerances.form_pv and no drawing."]}
    grade, word = "good", "Within tolerance"
    if False in judged:
        grade, word = "bad", "Out of tolerance"
    elif None in judged:
        grade, word = "warn", "Not decided"
    return {"grade": grade, "word": word, "why": [f"{one.sentence}." for one in verdicts]}


def _instrument_sections(measured: Measured) -> list[Section]:
    """Return the effect of the instrument on nominal surface and cusps, if the job states one."""
    text = [f"{one[0].upper()}{one[1:]}." for one in measured.as_seen]
    seen = measured.job.measurement.instrument
    if seen is not None and seen.source:
        text.append(f"Source: {seen.source}.")
    return [Section(title="Effect of the instrument", text=text)] if text else []


def _form(measured: Measured) -> list[Section]:
    """Return the sections of the form error and its Zernike terms."""
    radius = measured.job.part.reach
    pictures = [
        draw(
            figures.places_map,
            measured.error,
            measured.job.part.border,
            "over the part",
            what="Error",
            like=measured.registration.error,
        ),
        draw(figures.over_radius, measured.error, radius),
    ]
    sections = [Section(title="Error (cut minus nominal)", items=pictures)]
    terms = measured.zernike
    if terms is not None:
        order = np.argsort(-np.abs(terms.coefficients))[:16]
        rows = [
            (f"Z{terms.indices[k]}", f"{terms.coefficients[k] * NM:+.4g}", f"{terms.uncertainty[k] * NM:.2g}")
            for k in order
        ]
        sections.append(
            Section(
                title="Form in fringe Zernike terms",
                text=["The largest of 37 terms over the clear aperture, in the part frame."],
                items=[_table(("term", "coefficient [nm]", "uncertainty [nm]"), rows, (1, 2))],
            )
        )
    return sections


def _lens_section(measured: Measured) -> list[Section]:
    """Return the section of the lenslets, if the part is a lens array."""
    lenslets = measured.lenslets
    if lenslets is None:
        return []
    lines = lenslets.csv().splitlines()
    head, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    return [
        Section(
            title="Lenslets",
            text=[lenslets.summary, lenslets.frame],
            items=[
                draw(figures.dislocation_map, lenslets),
                _table(head, rows[:MAX_LISTED_LENSLETS], range(1, len(head))),
            ],
        )
    ]


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], numeric: Collection[int]) -> Table:
    return Table(columns=columns, rows=rows, numeric=numeric, dense=True)


def _pose(measured: Measured) -> Section:
    """Return the section of the part pose."""
    registration = measured.registration
    pose = registration.pose
    rows = []
    values = (*pose.shift, pose.rotation, *pose.tilt)
    for name, value in zip(("x", "y", "z", "rotation", "tilt_x", "tilt_y"), values, strict=True):
        unit, scale = ("mm", 1.0) if name in ("x", "y", "z") else ("mrad", 1e3)
        std = None if name in registration.held else registration.std.get(name)
        rows.append((name, f"{value * scale:.9g}", unit, "fixed" if std is None else f"{std * scale:.2g}"))
    return Section(
        title="Part pose (registration result)",
        text=[registration.sentences[0], f"{measured.outliers} outliers were removed."],
        items=[_table(("degree of freedom", "value", "unit", "standard uncertainty"), rows, (1, 3))],
    )


def _error_sources(diagnosis: Diagnosis) -> Section:
    """Return the table of error sources."""
    columns = ("source", "value", "interval", "plausible", "rms [nm]", "verdict", "explanation")
    rows = [
        (
            source.name,
            _quantity(source, source.value),
            _format_interval(source, source.interval),
            _quantity(source, source.plausible),
            f"{source.rms_nm:.3g}",
            source.verdict,
            source.explanation,
        )
        for source in diagnosis
    ]
    return Section(title="Error sources", text=[INTERVAL_TEXT], items=[_table(columns, rows, (4,))])


def _terms(diagnosis: Diagnosis) -> Section:
    """Return the table of contributions without a single source, and the repeatability between maps of a part."""
    columns = ("term", "rms [nm]", "uncertainty [nm]", "shared [nm]", "explanation")
    rows = [
        (
            term.name,
            f"{term.rms_nm:.3g}",
            f"{term.uncertainty_nm:.2g}",
            "" if term.common_nm is None else f"{term.common_nm:.3g}",
            term.explanation,
        )
        for term in diagnosis.contributions
    ]
    text = [TERMS_TEXT]
    if diagnosis.repeatability_nm is not None:
        text.append(f"Repeatability: {diagnosis.repeatability_nm:.3g} nm rms between cuts of a part.")
    return Section(title="Spindle error motion, drift and form", text=text, items=[_table(columns, rows, (1, 2, 3))])


def _setup(measured: Sequence[Measured], diagnosis: Diagnosis) -> list[Section]:
    """Return the tool moves, with the handbook rule and the centre defect for comparison."""
    tool_moves = moves(diagnosis)
    text = [one for sample in measured for one in (*_handbook(sample, diagnosis), *_centre(sample))]
    if not tool_moves:
        return [Section(title="Tool adjustment at the machine", text=text)] if text else []
    columns = ("axis", "move [µm]", "uncertainty [µm]", "instruction")
    rows = [(one.axis, f"{one.by * 1e3:+.4g}", f"{one.uncertainty * 1e3:.2g}", one.sentence) for one in tool_moves]
    return [
        Section(
            title="Tool adjustment at the machine",
            text=[MOVES_TEXT, *text],
            items=[draw(figures.tool_moves, tool_moves), _table(columns, rows, (1, 2))],
        )
    ]


def _handbook(sample: Measured, diagnosis: Diagnosis) -> list[str]:
    """Compare the handbook rule for the centring error of a sphere with the diagnosis."""
    surface, exact = sample.job.part.surface, [one.value for one in diagnosis if one.name == "offset x"]
    if not isinstance(surface, Sphere) or not exact:
        return []
    pv_nm = best_fit(sample.placed, "sphere").pv_nm
    ruled = handbook_offset(pv_nm / NM, surface.radius, 2 * sample.job.part.reach)
    name = sample.job.part.name or "the part"
    sentence = (
        f"The handbook rule, 8 R/A PV, gives a tool centring error of {ruled * 1e3:.3g} µm from a best-sphere residual "
        f"of {pv_nm:.4g} nm of {name}; exact contact gives {exact[0] * 1e3:+.4g} µm. The rule differs by "
        f"{(ruled - abs(exact[0])) * 1e3:+.2g} µm and gives no sign."
    )
    return [sentence]


def _centre(sample: Measured) -> list[str]:
    """Return the tool height error from the centre defect, where the map resolves one."""
    part = sample.job.part
    try:
        core = centre_defect(sample.placed, part, within=CORE_FRACTION * part.reach, sense=sample.job.strategy.sense)
    except InputError:  # too few points near the axis
        return []
    return [] if core is None or core.uncertainty > core.radius / MIN_CORE_SHARPNESS else [core.sentence]


def _format_interval(finding: Finding, interval: tuple[float, float]) -> str:
    """Format an interval in the display unit."""
    unit, factor = _unit(finding)
    low, high = (one * factor for one in interval)
    return f"{low:.4g} to {high:.4g} {unit}".strip() if np.isfinite([low, high]).all() else "open"


def _quantity(finding: Finding, value: float) -> str:
    """Format a value in the display unit."""
    unit, factor = _unit(finding)
    return f"{value * factor:.4g} {unit}".strip()


def _unit(finding: Finding) -> tuple[str, float]:
    """Return the display unit of an error source and the factor to it."""
    if finding.unit.startswith("mm"):
        return f"µm{finding.unit.removeprefix('mm')}", 1e3
    return ("µrad", 1e6) if finding.unit == "rad" else (finding.unit, 1.0)


def _signatures(measured: Sequence[Measured], diagnosis: Diagnosis) -> Section:
    """Return the signatures of the largest error sources, and the residuals."""
    sources = sorted(diagnosis, key=lambda one: -one.rms_nm)[:MAX_SIGNATURES]
    pictures = []
    for sample, signatures in zip(measured, diagnosis.signatures, strict=True):
        part = sample.job.part
        pictures += [
            draw(
                figures.places_map,
                signatures[one.name],
                part.border,
                f"{one.name}, {part.name or 'part'}",
                what=f"Signature of {one.name}",
            )
            for one in sources
            if one.rms_nm > 0
        ]
    for sample, residual in zip(measured, diagnosis.residuals, strict=True):
        part = sample.job.part
        pictures.append(
            draw(
                figures.places_map,
                residual,
                part.border,
                f"residual, {part.name or 'part'}",
                what="Residual without a known source",
            )
        )
    return Section(title="Error signatures", items=pictures)
