"""Estimation of material coefficients from forces: records, signals, experiments and fits."""

from turnwright.cutting.learning.cuts import (
    Cuts,
    InterruptedCuts,
    NoseCuts,
    interrupted_cuts,
    measured_cuts,
    turning_cuts,
)
from turnwright.cutting.learning.dynamometer import Dynamometer, TapTest
from turnwright.cutting.learning.experiment import Experiment, learn_from_file
from turnwright.cutting.learning.learned import Estimate, ForceFit, LearnedMaterial
from turnwright.cutting.learning.material_fit import learn_material
from turnwright.cutting.learning.records import read_forces
from turnwright.cutting.learning.signals import (
    ForceAverage,
    ForceRecord,
    average_force,
    engagements,
    in_air,
    low_pass,
    remove_drift,
)

__all__ = [
    "Cuts",
    "Dynamometer",
    "Estimate",
    "Experiment",
    "ForceAverage",
    "ForceFit",
    "ForceRecord",
    "InterruptedCuts",
    "LearnedMaterial",
    "NoseCuts",
    "TapTest",
    "average_force",
    "engagements",
    "in_air",
    "interrupted_cuts",
    "learn_from_file",
    "learn_material",
    "low_pass",
    "measured_cuts",
    "read_forces",
    "remove_drift",
    "turning_cuts",
]
