"""Studies of a job: what becomes of it when its fields are varied, and how likely it is to keep its tolerances."""

from turnwright.studies._measures import MEASURES
from turnwright.studies._study import Column, Grid, Study, study
from turnwright.studies._vary import DESIGNS

__all__ = ["DESIGNS", "MEASURES", "Column", "Grid", "Study", "study"]
