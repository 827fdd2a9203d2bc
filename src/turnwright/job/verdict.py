"""Compare predicted or measured surfaces with the stated tolerances: for `run`, `plan`, `measure` and `correct`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from turnwright.job.prediction import Prediction
from turnwright.job.schema import Job

__all__ = ["WHOLE", "Verdict", "any_missed", "judge", "judge_form", "not_evaluated", "tolerances_of"]

NM = 1e6
TOLERANCE_NAMES = {"form_pv": "form error PV", "sq": "Sq"}

WHOLE = "whole part"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Whether a stated tolerance is met, on the whole part or in one patch.

    Parameters
    ----------
    tolerance
        Key in the job file: "form_pv" or "sq".
    place
        "whole part", or the name of a patch.
    limit_nm
        Tolerance that the job states.
    value_nm
        Predicted or measured value; ``None`` where there is none.
    is_kept
        Whether the tolerance is met; ``None`` if it was not evaluated.
    reason
        Why it was not evaluated, or why it is missed although its value is in tolerance; else empty.
    """

    tolerance: str
    place: str
    limit_nm: float
    value_nm: float | None = None
    is_kept: bool | None = None
    reason: str = ""

    @property
    def sentence(self) -> str:
        """The value and the tolerance."""
        name = TOLERANCE_NAMES[self.tolerance]
        if self.is_kept is None or self.value_nm is None:
            return f"{self.place}: {name} was not evaluated ({self.reason}), the tolerance is {self.limit_nm:.4g} nm"
        also = f" and {self.reason}" if self.reason else ""
        value, limit = _distinct(self.value_nm, self.limit_nm)
        return f"{self.place}: {name} is {value} nm{also}, the tolerance is {limit} nm"


def _distinct(one: float, other: float) -> tuple[str, str]:
    """Return two numbers with four digits, or with as many as they need to differ.

    >>> _distinct(225.049, 225.04)
    ('225.05', '225.04')
    """
    digits = next((n for n in range(4, 17) if one == other or f"{one:.{n}g}" != f"{other:.{n}g}"), 17)
    return f"{one:.{digits}g}", f"{other:.{digits}g}"


def tolerances_of(job: Job) -> dict[str, float]:
    """Return the tolerances that a job states, by name. [nm]."""
    stated = {"form_pv": job.tolerances.form_pv, "sq": job.tolerances.sq}
    return {name: limit * NM for name, limit in stated.items() if limit is not None}


def judge(job: Job, predictions: Iterable[Prediction]) -> tuple[Verdict, ...]:
    """Return a verdict for each stated tolerance, on the whole part and in the patches.

    Form error is the peak to valley between the highest and the lowest point of the whole part. Surface finish is the
    Sq of each patch, after the form removal of the job's ``roughness``; without patches it is the Sq of the roughest
    ring of the whole part. A patch or a part with points that no pass cuts misses every tolerance.
    """
    by_name = {one.name: one for one in predictions}
    return tuple(_judge_place(one, by_name.get(one.place)) for one in not_evaluated(job, ""))


def _judge_place(verdict: Verdict, prediction: Prediction | None) -> Verdict:
    is_form, is_patch = verdict.tolerance == "form_pv", verdict.place != WHOLE
    if prediction is None:
        reason = "the whole part was not predicted" if is_form else "the job has no patch"
        return replace(verdict, reason="this patch was not predicted" if is_patch else reason)
    value = prediction.pv_nm if is_form else prediction.roughness.sq_nm if is_patch else prediction.finish_nm
    reason = "the job has no patch" if value is None else ""
    if prediction.uncut:
        reason = f"{prediction.uncut:,} of {prediction.error.z.size:,} points are not cut"
    is_kept = None if value is None else value <= verdict.limit_nm and not prediction.uncut
    return replace(verdict, value_nm=value, is_kept=is_kept, reason=reason)


def judge_form(job: Job, pv_nm: float, *, sq_reason: str) -> tuple[Verdict, ...]:
    """Return verdicts where only the form error PV of the whole part is known, and why the finish is not evaluated."""
    return tuple(
        replace(one, value_nm=pv_nm, is_kept=pv_nm <= one.limit_nm, reason="") if one.tolerance == "form_pv" else one
        for one in not_evaluated(job, sq_reason)
    )


def not_evaluated(job: Job, reason: str) -> tuple[Verdict, ...]:
    """Return every stated tolerance as not evaluated, for a reason."""
    verdicts = []
    for name, limit in tolerances_of(job).items():
        places = [patch.name for patch in job.simulation.patches if name == "sq"] or [WHOLE]
        verdicts += [Verdict(tolerance=name, place=one, limit_nm=limit, reason=reason) for one in places]
    return tuple(verdicts)


def any_missed(verdicts: Iterable[Verdict]) -> bool:
    """Return whether any tolerance is missed; one that was not evaluated does not count."""
    return any(one.is_kept is False for one in verdicts)
