"""Mechanics of the cut: uncut chip thickness, cutting forces and the ductile regime."""

from turnwright.cutting.chip import ChipMap, OrthogonalChip, RoundChip, chip_map, expected_thickest
from turnwright.cutting.ductile_check import DuctileCheck, check_ductile, predict_chips
from turnwright.cutting.finish import MinimumChip, Vibration, add_vibration, cusp_height, predict_uncut_height
from turnwright.cutting.forces import CuttingForces, FlyCut, ForceHistory, SlotMill, chip_forces
from turnwright.cutting.fracture import IntactShare, ri80
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
from turnwright.cutting.learning.material_fit import learn_material
from turnwright.cutting.learning.records import read_forces
from turnwright.cutting.learning.results import Estimate, ForceFit, LearnedMaterial
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
    "ChipMap",
    "Cuts",
    "CuttingForces",
    "DuctileCheck",
    "Dynamometer",
    "Estimate",
    "Experiment",
    "FlyCut",
    "ForceAverage",
    "ForceFit",
    "ForceHistory",
    "ForceRecord",
    "IntactShare",
    "InterruptedCuts",
    "LearnedMaterial",
    "MinimumChip",
    "NoseCuts",
    "OrthogonalChip",
    "RoundChip",
    "SlotMill",
    "TapTest",
    "Vibration",
    "add_vibration",
    "average_force",
    "check_ductile",
    "chip_forces",
    "chip_map",
    "cusp_height",
    "engagements",
    "expected_thickest",
    "in_air",
    "interrupted_cuts",
    "learn_from_file",
    "learn_material",
    "low_pass",
    "measured_cuts",
    "predict_chips",
    "predict_uncut_height",
    "read_forces",
    "remove_drift",
    "ri80",
    "turning_cuts",
]
