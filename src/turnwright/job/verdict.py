"""Which stated tolerances a part keeps: the one judge of `run`, `plan`, `measure`, `correct` and every page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from turnwright.job.result import Prediction
    from turnwright.job.schema import Job

__all__ = ["Verdict", "judge", "judge_form", "missed", "tolerances_of", "unjudged"]

NM = 1e6

CALLED = {"form_pv": "form error PV", "sq": "Sq"}
"""What a tolerance of a job file is called."""

WHOLE = "whole part"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Whether a stated tolerance is kept at one place.

    Parameters
    ----------
    tolerance
        Its name in the job file: "form_pv" or "sq".
    place
        "whole part", or the name of a patch.
    limit_nm
        What the job states.
    value_nm
        What was found; ``None`` where nothing was.
    kept
        ``None`` if it was not judged.
    reason
        Why it was not judged, or is not kept for another reason than its value; empty else.
    """

    tolerance: str
    place: str
    limit_nm: float
    value_nm: float | None
    kept: bool | None
    reason: str = ""

    @property
    def sentence(self) -> str:
        """What was found, and what is allowed."""
        called = CALLED[self.tolerance]
        if self.kept is None or self.value_nm is None:
            return f"{self.place}: {called} is not judged ({self.reason}), the tolerance is {self.limit_nm:.4g} nm"
        also = f" and {self.reason}" if self.reason else ""
        value, limit = _distinct(self.value_nm, self.limit_nm)
        return f"{self.place}: {called} is {value} nm{also}, the tolerance is {limit} nm"


def _distinct(one: float, other: float) -> tuple[str, str]:
    """Return two numbers with four digits, or as many as it takes to differ.

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
    """Return a verdict for each stated tolerance and each place that it holds at.

    Form is judged by the highest and the lowest place of the whole part. Finish is judged in the patches, after the
    form that the job's ``roughness`` removes; in a job without patches by the roughest ring of the whole part. A place
    that no pass cuts keeps no tolerance.

    Parameters
    ----------
    job
        States the tolerances.
    predictions
        Of the whole part and of the patches, see `predict`.
    """
    limits, found = tolerances_of(job), list[Verdict]()
    by_name = {one.name: one for one in predictions}

    def verdict(tolerance: str, place: str, value: float | None, reason: str) -> None:
        one, limit = by_name.get(place), limits[tolerance]
        uncut = 0 if one is None else one.uncut
        if value is None or one is None:
            kept = None
        else:
            kept, reason = value <= limit and not uncut, ""
        if uncut and one is not None:
            reason = f"{uncut:,} of {one.error.z.size:,} points are not cut"
        found.append(
            Verdict(tolerance=tolerance, place=place, limit_nm=limit, value_nm=value, kept=kept, reason=reason)
        )

    whole = by_name.get(WHOLE)
    if "form_pv" in limits:
        verdict("form_pv", WHOLE, None if whole is None else whole.pv_nm, "the whole part was not predicted")
    if "sq" in limits:
        for patch in job.simulation.patches:
            one = by_name.get(patch.name)
            verdict("sq", patch.name, None if one is None else one.roughness.sq_nm, "this patch was not predicted")
        if not job.simulation.patches:
            verdict("sq", WHOLE, None if whole is None else whole.finish_nm, "the job has no patch")
    return tuple(found)


def judge_form(job: Job, pv_nm: float, *, sq_reason: str) -> tuple[Verdict, ...]:
    """Return verdicts where only the form error of the whole part is known.

    Parameters
    ----------
    job
        States the tolerances.
    pv_nm
        Peak to valley of cut minus design.
    sq_reason
        Why the finish is not judged.
    """
    found = []
    for name, limit in tolerances_of(job).items():
        form = name == "form_pv"
        found += [
            Verdict(
                tolerance=name, place=place, limit_nm=limit, value_nm=pv_nm if form else None,
                kept=pv_nm <= limit if form else None, reason="" if form else sq_reason,
            )
            for place in _places(job, name)
        ]  # fmt: skip
    return tuple(found)


def unjudged(job: Job, reason: str) -> tuple[Verdict, ...]:
    """Return every stated tolerance as not judged, for a reason."""
    return tuple(
        Verdict(tolerance=name, place=place, limit_nm=limit, value_nm=None, kept=None, reason=reason)
        for name, limit in tolerances_of(job).items()
        for place in _places(job, name)
    )


def _places(job: Job, tolerance: str) -> list[str]:
    """Return where a tolerance is judged."""
    return [patch.name for patch in job.simulation.patches if tolerance == "sq"] or [WHOLE]


def missed(verdicts: Iterable[Verdict]) -> bool:
    """Say whether a tolerance is known to be missed."""
    return any(one.kept is False for one in verdicts)
