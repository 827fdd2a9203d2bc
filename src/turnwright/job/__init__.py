"""The recipe: a job is data only, and `run` is the one place that knows the order of the stages.

Each name is imported when it is first asked for: to read a job takes none of the stages that carry it out.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from turnwright.job.agenda import (
        steps_of_comparison,
        steps_of_correction,
        steps_of_diagnosis,
        steps_of_measurement,
        steps_of_plan,
        steps_of_prediction,
        steps_of_preview,
        steps_of_run,
    )
    from turnwright.job.artefacts import Artefact, artefact
    from turnwright.job.comparison import Candidate, Comparison, compare
    from turnwright.job.correction import Correction, correct
    from turnwright.job.measurement import Measured, diagnose, measure, read_measurement
    from turnwright.job.planning import Plan, Trial, plan
    from turnwright.job.result import Pass, Prediction, Preview, Result
    from turnwright.job.running import (
        finishing_motion,
        predict,
        predicted_motion,
        preview,
        program_shares,
        run,
    )
    from turnwright.job.schema import Job, faults
    from turnwright.job.shape import PartShape, part_shape
    from turnwright.job.contributions import Shares, shares
    from turnwright.job.stages import Stages
    from turnwright.job.finish_terms import Finish, finish
    from turnwright.job.text import edited
    from turnwright.job.verdict import Verdict, judge, judge_form, missed, unjudged

_HOMES = {
    "_agenda": (
        "steps_of_comparison",
        "steps_of_correction",
        "steps_of_diagnosis",
        "steps_of_measurement",
        "steps_of_plan",
        "steps_of_prediction",
        "steps_of_preview",
        "steps_of_run",
    ),
    "_artefacts": ("Artefact", "artefact"),
    "_compare": ("Candidate", "Comparison", "compare"),
    "_correct": ("Correction", "correct"),
    "_measure": ("Measured", "diagnose", "measure", "read_measurement"),
    "_plan": ("Plan", "Trial", "plan"),
    "_result": ("Pass", "Prediction", "Preview", "Result"),
    "_run": ("finishing_motion", "predict", "predicted_motion", "preview", "program_shares", "run"),
    "_schema": ("Job", "faults"),
    "_shape": ("PartShape", "part_shape"),
    "_shares": ("Shares", "shares"),
    "_stages": ("Stages",),
    "_terms": ("Finish", "finish"),
    "_verdict": ("Verdict", "judge", "judge_form", "missed", "unjudged"),
    "_text": ("edited",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "Artefact",
    "Candidate",
    "Comparison",
    "Correction",
    "Finish",
    "Job",
    "Measured",
    "PartShape",
    "Pass",
    "Plan",
    "Prediction",
    "Preview",
    "Result",
    "Shares",
    "Stages",
    "Trial",
    "Verdict",
    "artefact",
    "compare",
    "correct",
    "diagnose",
    "edited",
    "faults",
    "finish",
    "finishing_motion",
    "judge",
    "judge_form",
    "measure",
    "missed",
    "part_shape",
    "plan",
    "predict",
    "predicted_motion",
    "preview",
    "program_shares",
    "read_measurement",
    "run",
    "shares",
    "steps_of_comparison",
    "steps_of_correction",
    "steps_of_diagnosis",
    "steps_of_measurement",
    "steps_of_plan",
    "steps_of_prediction",
    "steps_of_preview",
    "steps_of_run",
    "unjudged",
]


def __getattr__(name: str) -> object:
    """Import a name from where it lives."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = found
    return found
