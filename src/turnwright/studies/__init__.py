"""Studies of a job: what becomes of it when its fields are varied, and how likely it is to keep its tolerances."""

from turnwright.studies.budget import ErrorBudget, Spread
from turnwright.studies.measures import MEASURES
from turnwright.studies.variation import Column, Grid, Study, study
from turnwright.studies.tolerancing import Outcome, Sensitivity, Tightening, ToleranceStudy, tolerance
from turnwright.studies.designs import DESIGNS

__all__ = [
    "DESIGNS",
    "MEASURES",
    "Column",
    "ErrorBudget",
    "Grid",
    "Outcome",
    "Sensitivity",
    "Spread",
    "Study",
    "Tightening",
    "ToleranceStudy",
    "study",
    "tolerance",
]
