"""Compare predicted or measured surfaces with the stated tolerances: for `run`, `plan`, `measure` and `correct`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from turnwright.job.prediction import Prediction
    from turnwright.job.schema import Job

__all__ = ["Verdict", "judge", "judge_form", "missed", "tolerances_of", "unjudged"]

NM = 1e6

TOLERANCE_NAMES = {"form_pv": "form error PV", "sq": "Sq"}
"""The name of each tolerance of a job file, as messages write it."""

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
    value_nm: float | None
    is_kept: bool | None
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

    Parameters
    ----------
    job
        States the tolerances.
    predictions
        Of the whole part and of the patches, see `predict`.
    """
    limits, verdicts = tolerances_of(job), list[Verdict]()
    by_name = {one.name: one for one in predictions}

    def add(tolerance: str, place: str, value: float | None, reason: str) -> None:
        one, limit = by_name.get(place), limits[tolerance]
        uncut = 0 if one is None else one.uncut
        if value is None or one is None:
            is_kept = None
        else:
            is_kept, reason = value <= limit and not uncut, ""
        if uncut and one is not None:
            reason = f"{uncut:,} of {one.error.z.size:,} points are not cut"
        verdicts.append(
            Verdict(tolerance=tolerance, place=place, limit_nm=limit, value_nm=value, is_kept=is_kept, reason=reason)
        )

    whole_part = by_name.get(WHOLE)
    if "form_pv" in limits:
        add("form_pv", WHOLE, None if whole_part is None else whole_part.pv_nm, "the whole part was not predicted")
    if "sq" in limits:
        for patch in job.simulation.patches:
            one = by_name.get(patch.name)
            add("sq", patch.name, None if one is None else one.roughness.sq_nm, "this patch was not predicted")
        if not job.simulation.patches:
            add("sq", WHOLE, None if whole_part is None else whole_part.finish_nm, "the job has no patch")
    return tuple(verdicts)


def judge_form(job: Job, pv_nm: float, *, sq_reason: str) -> tuple[Verdict, ...]:
    """Return verdicts where only the form error of the whole part is known.

    Parameters
    ----------
    job
        States the tolerances.
    pv_nm
        Peak to valley of the surface minus the design. [nm]
    sq_reason
        Why the finish is not evaluated.
    """
    verdicts = []
    for name, limit in tolerances_of(job).items():
        is_form = name == "form_pv"
        verdicts += [
            Verdict(
                tolerance=name, place=place, limit_nm=limit, value_nm=pv_nm if is_form else None,
                is_kept=pv_nm <= limit if is_form else None, reason="" if is_form else sq_reason,
            )
            for place in _places(job, name)
        ]  # fmt: skip
    return tuple(verdicts)


def unjudged(job: Job, reason: str) -> tuple[Verdict, ...]:
    """Return every stated tolerance as not evaluated, for a reason."""
    return tuple(
        Verdict(tolerance=name, place=place, limit_nm=limit, value_nm=None, is_kept=None, reason=reason)
        for name, limit in tolerances_of(job).items()
        for place in _places(job, name)
    )


def _places(job: Job, tolerance: str) -> list[str]:
    """Return where a tolerance is evaluated: the patches, or the whole part."""
    return [patch.name for patch in job.simulation.patches if tolerance == "sq"] or [WHOLE]


def missed(verdicts: Iterable[Verdict]) -> bool:
    """Return whether any tolerance is missed; one that was not evaluated does not count."""
    return any(one.is_kept is False for one in verdicts)
