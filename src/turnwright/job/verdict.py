"""Compare predicted or measured surfaces with the stated tolerances: for `run`, `plan`, `measure` and `correct`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from turnwright.errors import InputError, quote
from turnwright.heightmap import HeightMap
from turnwright.job.extremes import Extremes
from turnwright.job.prediction import Prediction
from turnwright.job.schema import Job
from turnwright.metrology import CallOut, evaluate_call_out, form_components, noise_doubt, pv_doubt, require_covered
from turnwright.part import Part

__all__ = ["WHOLE", "Verdict", "any_missed", "form_values", "judge", "judge_form", "judge_measured", "not_evaluated"]

Values: TypeAlias = Mapping[str, tuple[float, float | None]]
"""Value and expanded uncertainty of each quantity of a call-out, by symbol. [mm, rad, mm³]"""

NM = 1e6
KEYS = {"form_pv": ("form error PV", "nm"), "sq": ("Sq", "nm"), "cusp_order": ("light in one order of the cusps", "%")}
"""Quantity and unit of each tolerance that a job states by key."""

SCALES = {"nm": NM, "mrad": 1e3, "nm² mm": NM**2, "%": 100.0}
"""Factor from mm, rad, mm³ and shares to the unit of a verdict."""

WHOLE = "whole part"
MEASURED = "measured map"

UNDECIDED = "neither conforming nor nonconforming beyond its uncertainty"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Whether one limit of a stated tolerance is met, on the whole part or in one patch.

    Parameters
    ----------
    tolerance
        Key in the job file, such as "form_pv" or "sq", or a call-out as it is written on the drawing.
    quantity
        What it limits: "form error PV", "Sq" and so on, or the symbol in the call-out.
    place
        "whole part", "measured map", or the name of a patch.
    unit
        Unit of limit, value and uncertainty.
    limit
        Tolerance that the job states.
    value
        Predicted or measured value; ``None`` where there is none.
    uncertainty
        Expanded uncertainty (k = 2) of the value; ``None`` if it is not known.
    is_kept
        Whether the tolerance is met; ``None`` if it was not evaluated, or lies within the uncertainty of the value.
    reason
        Why it was not evaluated or decided, or why it is missed although its value is in tolerance; else empty.
    """

    tolerance: str
    quantity: str
    place: str
    unit: str = "nm"
    limit: float
    value: float | None = None
    uncertainty: float | None = None
    is_kept: bool | None = None
    reason: str = ""

    @property
    def sentence(self) -> str:
        """The value and the tolerance."""
        name = self.quantity
        if self.tolerance not in KEYS:
            name = f"{name} of {quote(self.tolerance)}"
        if self.value is None:
            limit = f"{self.limit:.4g} {self.unit}"
            return f"{self.place}: {name} was not evaluated ({self.reason}), the tolerance is {limit}"
        also = f" and {self.reason}" if self.reason else ""
        value, limit = _distinct(self.value, self.limit)
        plus_minus = f" ± {self.uncertainty:.2g}" if self.uncertainty else ""
        return f"{self.place}: {name} is {value}{plus_minus} {self.unit}{also}, the tolerance is {limit} {self.unit}"

    def judged(self, value: float, uncertainty: float | None = None) -> Verdict:
        """Return the verdict on a value, after ISO 14253-1: kept or missed only beyond its uncertainty."""
        doubt = uncertainty or 0.0
        is_kept = True if value + doubt <= self.limit else False if value - doubt > self.limit else None
        return replace(
            self, value=value, uncertainty=uncertainty, is_kept=is_kept, reason=UNDECIDED if is_kept is None else ""
        )


def _distinct(one: float, other: float) -> tuple[str, str]:
    """Return two numbers with four digits, or with as many as they need to differ.

    >>> _distinct(225.049, 225.04)
    ('225.05', '225.04')
    """
    digits = next((n for n in range(4, 17) if one == other or f"{one:.{n}g}" != f"{other:.{n}g}"), 17)
    return f"{one:.{digits}g}", f"{other:.{digits}g}"


def judge(job: Job, predictions: Iterable[Prediction]) -> tuple[Verdict, ...]:
    """Return a verdict for each stated tolerance, on the whole part and in the patches.

    Form error is the peak to valley between the highest and the lowest point of the whole part. Surface finish is the
    Sq of each patch, after the form removal of the job's ``roughness``; without patches it is the Sq of the roughest
    ring of the whole part. Call-outs of form and slope hold for the whole part, those of texture for each patch. A
    patch or a part with points that no pass cuts misses every tolerance.
    """
    by_name = {one.name: one for one in predictions}
    verdicts = [_judge_key(one, by_name.get(one.place)) for one in _keys(job, "")]
    for call_out in job.tolerances.call_outs:
        for place in _places(job, texture=call_out.is_texture):
            prediction = by_name.get(place)
            limits = _limits(call_out, place, _missing(place, is_form=not call_out.is_texture))
            if prediction is not None and (place != WHOLE or not call_out.is_texture):
                limits = _judge_values(limits, partial(_predicted, call_out, job.part, prediction))
                limits = [_uncut(one, prediction) for one in limits]
            verdicts += limits
    return tuple(verdicts)


def _judge_key(verdict: Verdict, prediction: Prediction | None) -> Verdict:
    if prediction is None:
        return replace(verdict, reason=_missing(verdict.place, is_form=verdict.tolerance != "sq"))
    order = prediction.cusp_order
    value = {
        "form_pv": prediction.pv_nm,
        "sq": prediction.finish_nm if verdict.place == WHOLE else prediction.roughness.sq_nm,
        "cusp_order": None if order is None else order * SCALES["%"],
    }[verdict.tolerance]
    if value is None:
        why = "the part has no regular cusps" if verdict.tolerance == "cusp_order" else _missing(WHOLE, is_form=False)
        return replace(verdict, reason=why)
    verdict = verdict.judged(value)
    return _uncut(verdict, prediction)


def _uncut(verdict: Verdict, prediction: Prediction) -> Verdict:
    """Return a verdict on a map, where points that are not cut miss a tolerance."""
    if not prediction.uncut:
        return verdict
    reason = f"{prediction.uncut:,} of {prediction.error.z.size:,} points are not cut"
    return replace(verdict, is_kept=None if verdict.value is None else False, reason=reason)


def _missing(place: str, *, is_form: bool) -> str:
    if place != WHOLE:
        return "this patch was not predicted"
    return "the whole part was not predicted" if is_form else "the job has no patch"


def _predicted(call_out: CallOut, part: Part, prediction: Prediction) -> Values:
    """Return the values of a predicted map."""
    if call_out.standard != "ISO 10110-5":
        return _of_grid(call_out, prediction.error)
    values = prediction.form_values or form_values(part, prediction.error, prediction.form)
    return {symbol: (value, None) for symbol, value in values.items()}


def form_values(part: Part, error: HeightMap, form: Extremes | None) -> dict[str, float]:
    """Return the quantities of ISO 10110-5 of a predicted part by symbol. [mm].

    A grid hits the highest and the lowest point only by chance, so they count for the irregularity as well.
    """
    components = form_components(_along_normal(part, error), part.border)
    values = components.values
    if form is not None:
        x, y, z = np.array([form.highest, form.lowest]).T
        ends = _along_normal(part, HeightMap(x=x, y=y, z=z)).z - components.sphere.sag(x, y)
        z = np.append(components.irregularity.z, ends)
        values["B"] = float(np.nanmax(z) - np.nanmin(z))
    return values


def _of_grid(
    call_out: CallOut, error: HeightMap, noise: float | None = None, calibration: float | None = None
) -> Values:
    """Return the value of a map for a call-out of texture, density or slope."""
    value = evaluate_call_out(call_out, error)
    by_noise = None if noise is None else noise_doubt(call_out, error, value, noise)
    return {call_out.limits[0].symbol: (value, _combine(by_noise, calibration if call_out.unit == "nm" else None))}


def _along_normal(part: Part, error: HeightMap) -> HeightMap:
    """Return an error along the normal of the nominal surface, to first order, instead of along z."""
    z, valid = np.full(error.z.shape, np.nan), np.isfinite(error.z)
    x, y = (axis[valid] for axis in error.points())
    z[valid] = error.z[valid] / np.sqrt(1 + sum(slope**2 for slope in part.surface.gradient(x, y)))
    return replace(error, z=z)


def _judge_values(limits: list[Verdict], evaluate: Callable[[], Values]) -> list[Verdict]:
    """Return verdicts on the values of a map; where it does not tell them, with the reason."""
    try:
        values = evaluate()
    except InputError as error:
        return [replace(one, reason=str(error)) for one in limits]
    verdicts = []
    for one in limits:
        scale, (value, doubt) = SCALES[one.unit], values.get(one.quantity, (None, None))
        if value is None:
            verdicts.append(replace(one, reason="the heights are relative to a sphere of unknown radius"))
        else:
            verdicts.append(one.judged(value * scale, None if doubt is None else doubt * scale))
    return verdicts


def judge_measured(job: Job, pv_nm: float, error: HeightMap, on_grid: HeightMap) -> tuple[Verdict, ...]:
    """Return a verdict for each stated tolerance of a measured part.

    Expanded uncertainties come from the noise of a height and the calibration of the instrument, where the job states
    them. The pose is the datum of the form error and adds nothing. Stated noise is subtracted from the rms
    of the form; of texture and slopes it is part of the uncertainty.

    Parameters
    ----------
    job
        The job that the part was cut by.
    pv_nm
        Peak to valley of the form error. [nm]
    error
        Form error over the clear aperture, in the frame of the part, scattered. [mm]
    on_grid
        The same error on the grid of the map. [mm]
    """
    noise, calibration = job.measurement.height_noise, job.measurement.calibration
    count = int(np.count_nonzero(np.isfinite(error.z)))
    doubt_of_pv = _combine(None if noise is None else pv_doubt(noise, count), calibration)

    def form() -> Values:
        components = form_components(_along_normal(job.part, error), job.part.border, like=on_grid)
        values: Values = {symbol: (value, None) for symbol, value in components.values.items()}
        if noise is not None:
            values = components.measured(noise)
        is_true = job.measurement.reference == "true form"
        return {
            symbol: (value, _combine(doubt, calibration))
            for symbol, (value, doubt) in values.items()
            if is_true or symbol not in ("A", "RMSt")
        }

    verdicts = [
        one.judged(pv_nm, None if doubt_of_pv is None else doubt_of_pv * NM) if one.tolerance == "form_pv" else one
        for one in _keys(job, "a form map does not resolve it, predict or measure the patches")
    ]
    for call_out in job.tolerances.call_outs:
        limits = _limits(call_out, MEASURED if call_out.is_texture else WHOLE, "")
        of_grid = partial(_of_grid, call_out, on_grid, noise, calibration)
        verdicts += _judge_values(limits, form if call_out.standard == "ISO 10110-5" else of_grid)
    try:
        require_covered(error, job.part.border)
    except InputError as short:  # a part of the surface can prove that a limit is missed, not that it is kept
        return tuple(
            replace(one, is_kept=None, reason=str(short)) if one.is_kept and one.place == WHOLE else one
            for one in verdicts
        )
    return tuple(verdicts)


def _combine(*uncertainties: float | None) -> float | None:
    """Return the root sum of squares of the uncertainties that are known, ``None`` if none is."""
    stated = [one for one in uncertainties if one is not None]
    return float(np.linalg.norm(stated)) if stated else None


def judge_form(job: Job, pv_nm: float, *, reason: str) -> tuple[Verdict, ...]:
    """Return verdicts where only the form error PV of the whole part is known, and why the others are not evaluated."""
    return tuple(one.judged(pv_nm) if one.tolerance == "form_pv" else one for one in not_evaluated(job, reason))


def not_evaluated(job: Job, reason: str) -> tuple[Verdict, ...]:
    """Return every stated tolerance as not evaluated, for a reason."""
    verdicts = _keys(job, reason)
    for call_out in job.tolerances.call_outs:
        for place in _places(job, texture=call_out.is_texture):
            verdicts += _limits(call_out, place, reason)
    return tuple(verdicts)


def _keys(job: Job, reason: str) -> list[Verdict]:
    """Return the tolerances that a job states by key as not evaluated."""
    stated, order = job.tolerances, job.tolerances.cusp_order
    limits = {"form_pv": stated.form_pv, "sq": stated.sq, "cusp_order": None if order is None else order.max}
    return [
        Verdict(
            tolerance=key, quantity=KEYS[key][0], unit=KEYS[key][1], place=place, limit=limit * SCALES[KEYS[key][1]],
            reason=reason,
        )
        for key, limit in limits.items()
        if limit is not None
        for place in _places(job, texture=key == "sq")
    ]  # fmt: skip


def _limits(call_out: CallOut, place: str, reason: str) -> list[Verdict]:
    """Return the limits of a call-out as not evaluated."""
    return [
        Verdict(
            tolerance=call_out.text, quantity=symbol, place=place, unit=call_out.unit,
            limit=limit * SCALES[call_out.unit], reason=reason,
        )
        for symbol, limit in call_out.limits
    ]  # fmt: skip


def _places(job: Job, *, texture: bool) -> list[str]:
    """Return where a tolerance is judged: texture in each patch."""
    return [patch.name for patch in job.simulation.patches if texture] or [WHOLE]


def any_missed(verdicts: Iterable[Verdict]) -> bool:
    """Return whether any tolerance is missed; one that was not evaluated does not count."""
    return any(one.is_kept is False for one in verdicts)
