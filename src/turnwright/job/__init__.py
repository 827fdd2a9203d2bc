"""Jobs: the data of a job file, and the functions that plan, run, measure and correct it."""

from turnwright.job.approach import Entry
from turnwright.job.comparison import Candidate, Comparison, compare
from turnwright.job.contributions import ErrorBreakdown, break_down_error, has_servos, without_servos
from turnwright.job.correction import Correction, correct
from turnwright.job.cusps import CuspLight
from turnwright.job.finish_terms import Finish, finish
from turnwright.job.first_run import compile_simulation, compile_simulation_ahead
from turnwright.job.links import find_wrong_move
from turnwright.job.measurement import Measured, diagnose, measure, read_measurement
from turnwright.job.optics import OpticalPerformance, measured_optics
from turnwright.job.pass_plan import PassPlan
from turnwright.job.pipeline import Pipeline
from turnwright.job.planning import Plan, Trial, plan
from turnwright.job.predicting import predict
from turnwright.job.prediction import Prediction
from turnwright.job.programs import predicted_motion, program_shares
from turnwright.job.reference import job_schema
from turnwright.job.result import Pass, Preview, Result
from turnwright.job.running import finishing_motion, preview, run
from turnwright.job.schema import Job, faults
from turnwright.job.shape import PartShape, part_shape
from turnwright.job.tables import HeightFile, MachineDeviations, Table, context_of, name_keys
from turnwright.job.template import job_template, part_template, reference_tables
from turnwright.job.testparts import TestPartKind, make_test_part
from turnwright.job.text import as_tables, edit_text, write_job
from turnwright.job.time_estimate import (
    steps_of_comparison,
    steps_of_correction,
    steps_of_diagnosis,
    steps_of_measurement,
    steps_of_plan,
    steps_of_prediction,
    steps_of_preview,
    steps_of_run,
)
from turnwright.job.verdict import Verdict, any_missed, judge, judge_form, not_evaluated

__all__ = [
    "Candidate",
    "Comparison",
    "Correction",
    "CuspLight",
    "Entry",
    "ErrorBreakdown",
    "Finish",
    "HeightFile",
    "Job",
    "MachineDeviations",
    "Measured",
    "OpticalPerformance",
    "PartShape",
    "Pass",
    "PassPlan",
    "Pipeline",
    "Plan",
    "Prediction",
    "Preview",
    "Result",
    "Table",
    "TestPartKind",
    "Trial",
    "Verdict",
    "any_missed",
    "as_tables",
    "break_down_error",
    "compare",
    "compile_simulation",
    "compile_simulation_ahead",
    "context_of",
    "correct",
    "diagnose",
    "edit_text",
    "faults",
    "find_wrong_move",
    "finish",
    "finishing_motion",
    "has_servos",
    "job_schema",
    "job_template",
    "judge",
    "judge_form",
    "make_test_part",
    "measure",
    "measured_optics",
    "name_keys",
    "not_evaluated",
    "part_shape",
    "part_template",
    "plan",
    "predict",
    "predicted_motion",
    "preview",
    "program_shares",
    "read_measurement",
    "reference_tables",
    "run",
    "steps_of_comparison",
    "steps_of_correction",
    "steps_of_diagnosis",
    "steps_of_measurement",
    "steps_of_plan",
    "steps_of_prediction",
    "steps_of_preview",
    "steps_of_run",
    "without_servos",
    "write_job",
]
