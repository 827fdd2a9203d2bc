"""Why a part is off: measured maps against the marks that tool and machine leave, by exact contact."""

from turnwright.diagnosis.diagnosing import diagnose, plausible_rms_nm
from turnwright.diagnosis.error_sources import DEFAULT, ERROR_SOURCES, ErrorSource
from turnwright.diagnosis.findings import Contribution, Diagnosis, DrawnCut, Draws, Finding
from turnwright.diagnosis.map_points import FREE
from turnwright.diagnosis.proof import Proof, prove
from turnwright.diagnosis.setup import CentreDefect, Move, centre_defect, handbook_offset, moves

__all__ = [
    "DEFAULT",
    "ERROR_SOURCES",
    "FREE",
    "CentreDefect",
    "Contribution",
    "Diagnosis",
    "DrawnCut",
    "Draws",
    "ErrorSource",
    "Finding",
    "Move",
    "Proof",
    "centre_defect",
    "diagnose",
    "handbook_offset",
    "moves",
    "plausible_rms_nm",
    "prove",
]
