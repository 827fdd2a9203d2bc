"""What cutting does: how thick the chip is, which forces act, and whether the cut stays ductile."""

from turnwright.cutting.chip import ChipMap, OrthogonalChip, RoundChip, chip_map, expected_thickest
from turnwright.cutting.dynamometer import Dynamometer, TapTest
from turnwright.cutting.edge_cuts import InterruptedCuts, NoseCuts, interrupted_cuts, turning_cuts
from turnwright.cutting.edge_learning import learn_along_edge
from turnwright.cutting.experiment import Experiment, learn_from_file
from turnwright.cutting.finish import MinimumChip, Vibration, cusp_height, left_standing, vibrated
from turnwright.cutting.forces import CuttingForces, FlyCut, ForceHistory, SlotMill, chip_forces
from turnwright.cutting.fracture import IntactShare, ri80
from turnwright.cutting.gate import DuctileGate, ductile_gate, foretell
from turnwright.cutting.learning import Cuts, Estimate, ForceFit, LearnedMaterial, learn_material, measured_cuts
from turnwright.cutting.records import read_forces
from turnwright.cutting.signals import (
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
    "DuctileGate",
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
    "average_force",
    "chip_forces",
    "chip_map",
    "cusp_height",
    "ductile_gate",
    "engagements",
    "expected_thickest",
    "foretell",
    "in_air",
    "interrupted_cuts",
    "learn_along_edge",
    "learn_from_file",
    "learn_material",
    "left_standing",
    "low_pass",
    "measured_cuts",
    "read_forces",
    "remove_drift",
    "ri80",
    "turning_cuts",
    "vibrated",
]
