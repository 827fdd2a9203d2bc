"""Reports of runs: self-contained HTML pages for screen and print, and result files."""

from turnwright.report.archive import (
    archive_comparison,
    archive_correction,
    archive_diagnosis,
    archive_measured,
    archive_optics,
    archive_run,
    archive_tiled,
    read_maps,
    write_maps,
)
from turnwright.report.certificate import write_certificate
from turnwright.report.comparison import write_comparison
from turnwright.report.drawing import draw_apart
from turnwright.report.figures import write_fit_picture, write_picture
from turnwright.report.lens import write_lens_picture
from turnwright.report.measurement import write_correction, write_diagnosis, write_measured
from turnwright.report.optics import optics_facts, write_optics
from turnwright.report.page import write_page
from turnwright.report.run import compose_report, draw_part, write_backplot, write_report
from turnwright.report.study import write_study
from turnwright.report.tiled import write_tiled
from turnwright.report.tolerance import write_tolerance

__all__ = [
    "archive_comparison",
    "archive_correction",
    "archive_diagnosis",
    "archive_measured",
    "archive_optics",
    "archive_run",
    "archive_tiled",
    "compose_report",
    "draw_apart",
    "draw_part",
    "optics_facts",
    "read_maps",
    "write_backplot",
    "write_certificate",
    "write_comparison",
    "write_correction",
    "write_diagnosis",
    "write_fit_picture",
    "write_lens_picture",
    "write_maps",
    "write_measured",
    "write_optics",
    "write_page",
    "write_picture",
    "write_report",
    "write_study",
    "write_tiled",
    "write_tolerance",
]
