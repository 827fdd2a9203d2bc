"""The recipe: a job is data only, and `run` is the one place that knows the order of the stages."""

from turnwright.job._artefacts import Artefact, artefact
from turnwright.job._compare import Candidate, Comparison, compare
from turnwright.job._correct import Correction, correct
from turnwright.job._measure import Measured, explain, measure
from turnwright.job._plan import Plan, Trial, plan
from turnwright.job._result import Pass, Prediction, Preview, Result
from turnwright.job._run import (
    StageProgress,
    finishing_motion,
    predict,
    predicted_motion,
    preview,
    program_shares,
    run,
)
from turnwright.job._schema import Job, faults
from turnwright.job._shares import Shares, shares
from turnwright.job._stages import Stages
from turnwright.job._terms import Finish, finish

__all__ = [
    "Artefact",
    "Candidate",
    "Comparison",
    "Correction",
    "Finish",
    "Job",
    "Measured",
    "Pass",
    "Plan",
    "Prediction",
    "Preview",
    "Result",
    "Shares",
    "StageProgress",
    "Stages",
    "Trial",
    "artefact",
    "compare",
    "correct",
    "explain",
    "faults",
    "finish",
    "finishing_motion",
    "measure",
    "plan",
    "predict",
    "predicted_motion",
    "preview",
    "program_shares",
    "run",
    "shares",
]
