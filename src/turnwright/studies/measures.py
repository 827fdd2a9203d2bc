"""Measures of a case, in a worker: named numbers of any stage with their units, or user functions."""

from __future__ import annotations

import difflib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from turnwright.errors import InputError, TurnwrightError
from turnwright.job import Job, Pipeline
from turnwright.machine import ROTARY
from turnwright.studies.digests import digest_of
from turnwright.studies.files import provide_files, relocate_paths

if TYPE_CHECKING:
    from turnwright.studies.store import Store

__all__ = ["MEASURES", "REFUSED", "SECONDS", "Measure", "MeasureFunction", "Value", "carry_out", "measure_of"]

Value: TypeAlias = float | int | str | None
MeasureFunction: TypeAlias = Callable[[Pipeline], Value]
"""A user-defined measure: a function of the pipeline of a case that returns a number."""

WHOLE_PART = "whole part"

REFUSED = "refused"
"""Column with the reason why `run` would refuse a job that can still be measured."""

SECONDS = "seconds"
"""Column with the computing time of a case. [s]"""

NM = 1e6
MN_PER_N = 1e3
"""Millinewtons of a newton."""

STAGE_ORDER = ("access", "plan", "drive", "chips", "place")
"""Order in which stages are evaluated: a complete path, if needed, is also used for the patches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """A quantity that a study evaluates for every case."""

    name: str  # name as requested; the text after an @ is a patch or an axis
    unit: str  # empty if there is none, or if the name contains it
    stage: str  # stage of the job that it needs, see `STAGE_ORDER`
    function: MeasureFunction | None = None  # function of a user-defined measure

    @property
    def sign(self) -> str:
        """Key of the measure in stored rows: the name, and for a user function a digest of its code and data."""
        if self.function is None:
            return self.name
        return f"{self.name} {getattr(self.function, '__module__', '')} {digest_of(self.function)}"


def _margin(pipeline: Pipeline, name: str) -> float:
    """Return the margin of a tool in an access check; infinite if the part makes no demand."""
    margins = [one.margin for one in pipeline.access.findings if one.name == name]
    return margins[0] if margins and margins[0] is not None else math.inf


def _largest(values: Sequence[float | None]) -> float | None:
    numbers = [value for value in values if value is not None]
    return max(numbers) if numbers else None


_Evaluator: TypeAlias = Callable[[Pipeline, str], Value]

JOB_MEASURES: dict[str, tuple[str, str, _Evaluator]] = {
    "nose_radius_limit": ("mm", "access", lambda pipeline, _: pipeline.access.nose_radius_limit),
    "included_margin_deg": ("", "access", lambda pipeline, _: math.degrees(_margin(pipeline, "included angle"))),
    "clearance_margin_deg": ("", "access", lambda pipeline, _: math.degrees(_margin(pipeline, "clearance"))),
    "turns": ("", "plan", lambda pipeline, _: float(np.ptp(pipeline.path.angle)) / (2 * math.pi)),
    "feed": ("mm/rev", "plan", lambda pipeline, _: pipeline.feed),
    "least_clearance_nm": ("", "plan", lambda pipeline, _: float(pipeline.path.clearance.min()) * NM),
    "largest_sweep_deg": ("", "plan", lambda pipeline, _: math.degrees(float(np.abs(pipeline.path.sweep).max()))),
    "minutes": ("", "drive", lambda pipeline, _: pipeline.minutes),
    "points": ("", "drive", lambda pipeline, _: sum(one.points for one in pipeline.passes)),
    "spindle_rpm": ("", "drive", lambda pipeline, _: pipeline.limits.spindle_rpm),
    "block_rate_hz": ("", "drive", lambda pipeline, _: pipeline.limits.block_rate_hz),
    "utilisation": (
        "", "drive", lambda pipeline, _: max(max(one.limits.utilisation.values()) for one in pipeline.passes),
    ),
    "binding": ("", "drive", lambda pipeline, _: pipeline.limits.binding),
    "thickest_chip_nm": ("", "chips", lambda pipeline, _: pipeline.chips[-1].thickest * NM),
    "typical_chip_nm": ("", "chips", lambda pipeline, _: pipeline.chips[-1].typical * NM),
    "axial_force_mN": ("", "chips", lambda pipeline, _: _milli(pipeline.chips[-1].axial)),
    "cutting_force_mN": ("", "chips", lambda pipeline, _: _milli(pipeline.chips[-1].cutting)),
    "form_pv_nm": ("", "place", lambda pipeline, _: pipeline.form_pv_nm),
    "form_rms_nm": ("", "place", lambda pipeline, _: pipeline.prediction(WHOLE_PART).roughness.sq_nm),
    "strehl": ("", "place", lambda pipeline, _: pipeline.optics.strehl),
    "form_strehl": ("", "place", lambda pipeline, _: pipeline.optics.form_strehl),
    "wavefront_rms_nm": ("", "place", lambda pipeline, _: pipeline.optics.wavefront.rms * NM),
    "tis": ("", "place", lambda pipeline, _: pipeline.optics.tis),
    "cusp_order": ("", "place", lambda pipeline, _: pipeline.optics.cusp_order),
}  # fmt: skip
"""Measures of a whole job: unit, stage and function. Chips and forces are those of the finishing pass."""

PATCH_MEASURES: dict[str, str] = {
    "sa_nm": "", "sq_nm": "", "sp_nm": "", "sv_nm": "", "sz_nm": "", "pv_nm": "", "ssk": "", "sku": "", "sdq": "",
    "sdr": "", "sal": "mm", "str": "", "missing": "",
}  # fmt: skip
"""Measures of a patch, and their units: see `turnwright.metrology.Roughness`."""

AXIS_MEASURES: dict[str, tuple[str, str]] = {
    "peak_speed": ("mm/s", "rad/s"),
    "peak_acceleration": ("mm/s^2", "rad/s^2"),
    "peak_jerk": ("mm/s^3", "rad/s^3"),
    "stroke": ("mm", "rad"),
}
"""Measures of an axis in the finishing pass, with the units of linear and rotary axes."""

MEASURES: tuple[str, ...] = (
    *JOB_MEASURES,
    *(f"{name}@PATCH" for name in PATCH_MEASURES),
    *(f"{name}@AXIS" for name in AXIS_MEASURES),
)
"""Names of all measures."""


def _milli(force: float | None) -> float | None:
    return None if force is None else force * MN_PER_N


def measure_of(job: Job, asked: str | MeasureFunction) -> Measure:
    """Return a measure by its name, such as "sq_nm@axis" (of the patch called axis), or of a user function."""
    if not isinstance(asked, str):
        if not callable(asked):
            raise InputError(f"a measure is {asked!r}, it must be a name or a function: give one of {_known_names()}")
        return Measure(name=getattr(asked, "__name__", type(asked).__name__), unit="", stage="place", function=asked)
    name, at, where = asked.strip().partition("@")
    if name in PATCH_MEASURES:
        patches = [patch.name for patch in job.simulation.patches]
        if not at and not patches:
            raise InputError(
                f"{name} needs a patch, and the job has none: add one to [simulation], or use {name}@{WHOLE_PART}"
            )
        if at and where not in (WHOLE_PART, *patches):
            raise InputError(f"{asked}: the job has no patch {where!r}, it has {', '.join((WHOLE_PART, *patches))}")
        return Measure(name=asked.strip(), unit=PATCH_MEASURES[name], stage="place")
    if name in AXIS_MEASURES:
        axes = job.machine.axes
        if where not in axes:
            what = f"has no axis {where!r}" if at else "has several axes"
            raise InputError(
                f"{asked}: {name} is a measure of an axis, {job.machine.name} {what}: use "
                f"{' or '.join(f'{name}@{letter}' for letter in sorted(axes))}"
            )
        return Measure(name=asked.strip(), unit=AXIS_MEASURES[name][where in ROTARY], stage="drive")
    if name in JOB_MEASURES and not at:
        unit, stage, _ = JOB_MEASURES[name]
        return Measure(name=name, unit=unit, stage=stage)
    names = [*JOB_MEASURES, *PATCH_MEASURES, *AXIS_MEASURES]
    close = [one for one in names if name and one.startswith(name)] or difflib.get_close_matches(name, names, 1, 0.5)
    if name in JOB_MEASURES:
        raise InputError(f"{asked}: {name} is a measure of the whole job: leave out the part after @")
    remedy = f"did you mean {close[0]}?" if close else f"the known ones are {_known_names()}, use one of them"
    raise InputError(f"{asked!r} is not a measure: {remedy}")


def _known_names() -> str:
    return ", ".join(MEASURES)


def evaluate(pipeline: Pipeline, measures: Sequence[Measure]) -> dict[str, Value]:
    """Return the measures of a case by name; only the stages that they need are computed."""
    values: dict[str, Value] = {}
    for one in sorted(measures, key=lambda measure: STAGE_ORDER.index(measure.stage)):
        values[one.name] = _finite(_evaluate_one(pipeline, one))
    return {one.name: values[one.name] for one in measures}


def _evaluate_one(pipeline: Pipeline, one: Measure) -> Value:
    if one.function is not None:
        try:
            return one.function(pipeline)
        except (TurnwrightError, MemoryError, OSError, ImportError):  # of a stage, or of the machine
            raise
        except Exception as error:
            reason = " ".join(str(error).split()) or "no reason given"
            raise InputError(f"the measure {one.name} fails ({type(error).__name__}: {reason}): correct it") from error
    name, _, where = one.name.partition("@")
    if name in PATCH_MEASURES:
        patch = where or pipeline.job.simulation.patches[0].name
        value: Any = getattr(pipeline.prediction(patch).roughness, name)
        return value  # type: ignore[no-any-return] # a number
    if name in AXIS_MEASURES:
        if where not in pipeline.limits.travel:
            raise InputError(f"{one.name}: this case does not move axis {where}")
        if name == "stroke":
            low, high = pipeline.limits.travel[where]
            return high - low
        return float(getattr(pipeline.limits, name)[where])
    return JOB_MEASURES[name][2](pipeline, where)


def _finite(value: Any) -> Value:
    plain = value.item() if isinstance(value, np.generic) else value
    if plain is not None and not isinstance(plain, int | float | str):
        raise InputError(f"a measure gives {type(plain).__name__}, it must be a number, a text or None: change it")
    return plain


def carry_out(data: Mapping[str, Any], shared: Mapping[str, Any], store: Store | None) -> dict[str, Any]:
    """Return the row of a case: its measures, the reason why `run` would refuse it, and its computing time."""
    start = time.perf_counter()
    with provide_files(data["files"], shared.get("files", {}), store) as places:
        job = Job.read(relocate_paths(data["job"], places))
        pipeline = Pipeline(job)
        functions = shared.get("own", {})
        measures = [measure_of(job, functions.get(name, name)) for name in shared["measures"]]
        row = evaluate(pipeline, measures)
    if pipeline.refused:
        row[REFUSED] = "; ".join(pipeline.refused)
    row[SECONDS] = round(time.perf_counter() - start, 4)
    return row
