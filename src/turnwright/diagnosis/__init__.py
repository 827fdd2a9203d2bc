"""Why a part is off: measured maps against the marks that tool and machine leave, by exact contact."""

from turnwright.diagnosis._causes import CAUSES, DEFAULT, Cause
from turnwright.diagnosis._diagnose import diagnose
from turnwright.diagnosis._findings import Diagnosis, Finding
from turnwright.diagnosis._fit import FREE
from turnwright.diagnosis._setup import CentreDefect, Move, centre_defect, handbook_offset, moves

__all__ = [
    "CAUSES",
    "DEFAULT",
    "FREE",
    "Cause",
    "CentreDefect",
    "Diagnosis",
    "Finding",
    "Move",
    "centre_defect",
    "diagnose",
    "handbook_offset",
    "moves",
]
