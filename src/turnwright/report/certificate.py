"""Certificate of a predicted or measured part: one sheet of its tolerances, values, uncertainties and verdicts."""

from __future__ import annotations

import hashlib
from datetime import datetime
from pathlib import Path as File
from typing import TYPE_CHECKING, Any

from turnwright.job import Result, Verdict
from turnwright.report.page import Cell, Number, Page, Section, Table, write_page
from turnwright.units import say_length

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from turnwright.job import Job, Measured

__all__ = ["write_certificate"]

COLUMNS = ("Call-out", "Where", "Quantity", "Limit", "Value", "U\u00a0(k\u00a0=\u00a02)", "Verdict")

RULE_TEXT = (
    "Conforming: value plus expanded uncertainty within the limit. Nonconforming: value minus expanded uncertainty "
    "beyond the limit. Otherwise neither is proven (ISO 14253-1). Where no uncertainty is stated, the value alone is "
    "compared with the limit."
)

FORM_TEXT = (
    "Form of ISO 10110-5 is the deviation along the normal: A the best-fit sphere, B without piston, tilt and sphere, "
    "C the rotationally symmetric part of B."
)

HASH_CHARACTERS = 16
"""Characters of a SHA-256 that are shown."""


def write_certificate(subject: Measured | Result, path: str | PathLike[str], files: Sequence[File] = ()) -> File | None:
    """Write the certificate of a measured part, or of one predicted from its program; ``None`` without a tolerance.

    Parameters
    ----------
    subject
        What is judged.
    path
        File; in an existing folder it is named ``certificate.html``.
    files
        Files of the measured heights.
    """
    verdicts, job = subject.verdicts, subject.job
    if not verdicts:
        return None
    path = File(path)
    met, missed = (sum(one.is_kept is state for one in verdicts) for state in (True, False))
    undecided = len(verdicts) - met - missed
    grade, word = (
        ("bad", "Nonconforming") if missed else ("warn", "Not decided") if undecided else ("good", "Conforming")
    )
    is_measured = not isinstance(subject, Result)
    facts = _prediction(subject) if isinstance(subject, Result) else _measurement(subject)
    part = {
        "Name": job.part.name or "–",
        "Clear aperture": job.part.border.words,
        "Surface": type(job.part.surface).__name__,
        "Material": job.part.material_name or "not stated",
        "Date": datetime.now().astimezone().date().isoformat(),
        "Job, SHA-256": _short(job.to_toml().encode()),
        **{f"{file.name}, SHA-256": _short(file.read_bytes()) for file in files},
    }
    notes = [
        f"{one.quantity}, {one.place}: {one.reason}."
        for one in verdicts
        if one.reason and (one.value is None or one.is_kept is False)
    ]
    page = Page(
        kind="Certificate, measured part" if is_measured else "Certificate, predicted part",
        job=job,
        is_sheet=True,
        grade=grade,
        word=word,
        why=["as measured" if is_measured else "as predicted from the program, not measured"],
        numbers=[
            Number("Conforming", str(met), f"of {len(verdicts)}", "limits"),
            Number("Nonconforming", str(missed), "", "limits", ok=not missed),
            Number("Not decided", str(undecided), "", "limits, see below"),
        ],
        sections=[
            Section(
                title="Tolerances",
                items=[Table(columns=COLUMNS, rows=_rows(job, verdicts), numeric=(3, 4, 5), dense=True, notes=notes)],
            ),
            Section(
                title="Part and measurement" if is_measured else "Part and prediction",
                items=[Table(rows=[*part.items()], span=3), Table(rows=[*facts.items()], span=3)],
                text=[RULE_TEXT, *([FORM_TEXT] if any(one.quantity in "ABC" for one in verdicts) else [])],
            ),
            Section(
                title="Signatures",
                items=[Table(rows=[(one, "\u00a0") for one in ("Name", "Date", "Signature")], title=who, span=3)
                       for who in ("Inspected", "Approved")],
            ),
        ],
    )  # fmt: skip
    return write_page(page, path / "certificate.html" if path.is_dir() else path)


def _rows(job: Job, verdicts: Sequence[Verdict]) -> list[tuple[str | Cell, ...]]:
    """Return the rows of the table of tolerances; a call-out is shown where it begins."""
    meanings = {one.text: one.meaning for one in job.tolerances.call_outs}
    styles: dict[bool | None, Cell] = {
        True: Cell("conforming", "yes"), False: Cell("nonconforming", "no"), None: Cell("not\u00a0proven"),
    }  # fmt: skip
    rows: list[tuple[str | Cell, ...]] = []
    previous = ""
    for one in verdicts:
        name = one.tolerance if one.tolerance in meanings else f"{one.tolerance} (job file)"
        has_band = one.tolerance != previous and " in the band " in meanings.get(one.tolerance, "")
        quantity = one.quantity
        if has_band:
            quantity = f"{quantity}, {meanings[one.tolerance].partition(' in the band ')[2]}"
        rows.append(
            (
                "" if one.tolerance == previous else name,
                one.place.replace(" ", "\u00a0"),
                quantity,
                *(
                    nothing if number is None else f"{number:.{digits}g} {one.unit}".replace(" ", "\u00a0")
                    for number, digits, nothing in (
                        (one.limit, 4, ""),
                        (one.value, 4, "–"),
                        (one.uncertainty, 2, "not\u00a0stated"),
                    )
                ),
                Cell("not\u00a0evaluated") if one.value is None else styles[one.is_kept],
            )
        )
        previous = one.tolerance
    return rows


def _measurement(measured: Measured) -> dict[str, str]:
    """Return how a part was measured, in words."""
    settings, registration = measured.job.measurement, measured.registration
    instrument = settings.instrument
    fixed = [*settings.fixed, *registration.held]
    datum = [f"{', '.join(one for one in settings.free if one not in registration.held)} fitted to the design"]
    datum += [f"{', '.join(fixed)} fixed"] if fixed else []
    mask = [f"file {settings.mask.name}"] if settings.mask else []
    mask += [f"edge of {say_length(settings.trim)} left out"] if settings.trim else []
    stated = {"noise of a height": settings.height_noise, "calibration of the instrument (k = 2)": settings.calibration}
    uncertainty = ", ".join(f"{name} {say_length(value)}" for name, value in stated.items() if value)
    return {
        "Instrument": "not stated" if instrument is None else f"{instrument.name or 'unnamed'} ({instrument.summary})",
        "Mask": "; ".join(mask) or "none",
        "Filter": f"form: none; {measured.outliers} outliers removed ({settings.outliers}); texture: as called out",
        "Datum": "; ".join([*datum, f"{registration.count:,} heights"]),
        "Reference": settings.reference,
        "Uncertainty from": uncertainty or "not stated",
    }


def _prediction(result: Result) -> dict[str, str]:
    """Return how a part was predicted, in words."""
    simulated: dict[str, Any] = {
        "servos": result.job.simulation.tracking, "actual tool": result.job.actual_tool != result.job.tool,
        "actual machine": result.job.actual_machine != result.job.machine,
    }  # fmt: skip
    return {
        "Instrument": "none; simulated from the program read back",
        "Program": result.program.files[0].name,
        "Points, SHA-256": result.program.hash[:HASH_CHARACTERS],
        "Simulated with": ", ".join(name for name, is_used in simulated.items() if is_used)
        or "nominal tool and machine",
        "Mask": "none",
        "Filter": "form: none; texture: as called out",
        "Datum": "axis and zero of the program, nothing is fitted",
        "Uncertainty from": "not stated",
    }


def _short(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:HASH_CHARACTERS]
