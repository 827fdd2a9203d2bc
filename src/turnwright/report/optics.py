"""The optical performance of a part: a section of its page, a page of its own, and its numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.report import figures
from turnwright.report.drawing import draw
from turnwright.report.page import Page, Section, Table, page_file, write_page

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path as File

    from turnwright.job import Job, OpticalPerformance
    from turnwright.optics import Wavefront

__all__ = ["optics_facts", "optics_numbers", "optics_section", "write_optics"]

NM = 1e6

MARKS_TEXT = (
    "Form and marks are two scales: the wavefront is that of the surface without its cusps, and the light that cusps "
    "diffract is lost to the image, so that they lower the Strehl ratio, and the modulation beyond the lowest "
    "frequencies, by the specular share. A patch is evaluated for the ray of the design that meets its middle; angles "
    "are those at normal incidence."
)

LISTED_ORDERS = 6


def write_optics(job: Job, performance: OpticalPerformance, path: str | PathLike[str]) -> File:
    """Write the page of the optical performance of a part, see `write_page`."""
    page = Page(kind="Optical performance", job=job, sections=[optics_section(performance)])
    return write_page(page, page_file(path))


def optics_section(performance: OpticalPerformance) -> Section:
    """Return the section of the optical performance."""
    light, focal = performance.wavefront, performance.focal_length
    transfers = light.mtf(focal_length=focal), _perfect(light).mtf(focal_length=focal)
    unit = "rad" if focal is None else "mm"
    orders = [
        [
            "cusps of the feed" if place is None else place,
            f"{number:d}" if number else "–",
            _angle(angle),
            _share(share),
        ]
        for place, number, angle, share in _orders(performance)
    ]
    return Section(
        title="Optical performance",
        items=[
            Table(rows=[[name, value] for name, value in optics_facts(performance).items()], span=3),
            draw(figures.wavefront_map, light),
            draw(figures.point_spread, light.psf(focal_length=focal), light.strehl, unit),
            draw(figures.modulation, *transfers, f"1/{unit}"),
            Table(
                title="Diffraction orders of the marks", columns=("Marks", "Order", "Angle", "Share of the light"),
                numeric=(1, 2, 3), rows=orders, notes=[MARKS_TEXT], dense=True,
            ),
        ],
    )  # fmt: skip


def optics_facts(performance: OpticalPerformance) -> dict[str, str]:
    """Return the figures of the optical performance in words."""
    light = performance.wavefront
    facts = {
        "Wavelength": f"{light.wavelength * NM:.6g} nm",
        "Wavefront error": f"{light.rms * NM:.4g} nm rms, {light.rms_waves:.3g} waves",
        "Strehl ratio of the form": f"{performance.form_strehl:.4f}",
    }
    if performance.cusps is not None:
        facts["Light in the specular order of the cusps"] = _share(performance.cusps.specular)
        facts["Strehl ratio of form and cusps"] = f"{performance.strehl:.4f}"
    for name, marks in performance.marks.items():
        facts[f"Total integrated scatter at {name}"] = _share(marks.tis)
    return facts


def optics_numbers(performance: OpticalPerformance) -> dict[str, Any]:
    """Return the numbers of the optical performance, for a file."""
    light, transfer = performance.wavefront, performance.wavefront.mtf(focal_length=performance.focal_length)
    return {
        "wavelength": light.wavelength,
        "rms_waves": light.rms_waves,
        "strehl": performance.strehl,
        "form_strehl": performance.form_strehl,
        "tis": performance.tis,
        "zernike_fringe": light.zernike().terms,
        "mtf": {name: getattr(transfer, name).tolist() for name in ("frequency", "x", "y")},
        "frequency_unit": "1/rad" if performance.focal_length is None else "1/mm",
        "orders": [
            {"place": place or "whole part", "order": number, "angle": angle, "efficiency": share}
            for place, number, angle, share in _orders(performance)
        ],
        "scatter": {name: marks.tis for name, marks in performance.marks.items()},
    }


def _orders(performance: OpticalPerformance) -> list[tuple[str | None, int | None, float, float]]:
    """Return place, number, angle and share of the orders of the cusps, and of the peaks of each patch."""
    orders: list[tuple[str | None, int | None, float, float]] = []
    if (cusps := performance.cusps) is not None:
        listed = zip(cusps.orders, cusps.angles, cusps.efficiency, strict=True)
        orders += [(None, *one) for one in islice(listed, LISTED_ORDERS)]
    for name, marks in performance.marks.items():
        orders += [(name, None, one.angle, one.efficiency) for one in marks.orders(LISTED_ORDERS)]
    return orders


def _perfect(light: Wavefront) -> Wavefront:
    """Return the same pupil without errors."""
    return replace(light, opd=replace(light.opd, z=np.where(np.isnan(light.opd.z), np.nan, 0.0)), specular=1.0)


def _share(share: float) -> str:
    return f"{share:.4%}" if share > 1e-4 else f"{share:.2e}"


def _angle(angle: float) -> str:
    return "does not propagate" if math.isnan(angle) else f"{math.degrees(angle):.3f}°"
