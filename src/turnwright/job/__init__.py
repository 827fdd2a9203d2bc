"""The recipe: a job is data only, and `run` is the one place that knows the order of the stages."""

from turnwright.job._result import Pass, Prediction, Preview, Result
from turnwright.job._run import StageProgress, predict, preview, run
from turnwright.job._schema import Job

__all__ = ["Job", "Pass", "Prediction", "Preview", "Result", "StageProgress", "predict", "preview", "run"]
