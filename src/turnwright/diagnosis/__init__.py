"""Why a part is off: measured maps against the marks that tool and machine leave, by exact contact."""

from turnwright.diagnosis._causes import CAUSES, DEFAULT, Cause
from turnwright.diagnosis._diagnose import diagnose
from turnwright.diagnosis._findings import Diagnosis, Finding
from turnwright.diagnosis._fit import FREE

__all__ = ["CAUSES", "DEFAULT", "FREE", "Cause", "Diagnosis", "Finding", "diagnose"]
