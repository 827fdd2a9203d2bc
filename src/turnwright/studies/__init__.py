"""Studies of a job: what becomes of it when its fields are varied, and how likely it is to keep its tolerances."""

from turnwright.studies._budget import ErrorBudget, Spread
from turnwright.studies._measures import MEASURES
from turnwright.studies._study import Column, Grid, Study, study
from turnwright.studies._tolerance import Outcome, Sensitivity, Tightening, ToleranceStudy, tolerance
from turnwright.studies._vary import DESIGNS

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
