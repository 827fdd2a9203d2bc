"""The recipe: a job is data only, and `run` is the one place that knows the order of the stages."""

from turnwright.job._compare import Candidate, Comparison, compare
from turnwright.job._plan import Plan, Trial, plan
from turnwright.job._result import Pass, Prediction, Preview, Result
from turnwright.job._run import StageProgress, predict, preview, run
from turnwright.job._schema import Job
from turnwright.job._shares import Shares, shares

__all__ = [
    "Candidate",
    "Comparison",
    "Job",
    "Pass",
    "Plan",
    "Prediction",
    "Preview",
    "Result",
    "Shares",
    "StageProgress",
    "Trial",
    "compare",
    "plan",
    "predict",
    "preview",
    "run",
    "shares",
]
