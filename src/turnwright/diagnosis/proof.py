"""Whether a correction improves the next part, evaluated on random draws of all uncertain quantities."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from turnwright._arrays import Floats
from turnwright.diagnosis.findings import Draws

__all__ = ["Proof", "prove"]

GAIN_QUANTILE = 0.05
"""Fraction of the draws that may have less than the claimed improvement."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """Predicted effect of a correction on the next part.

    Parameters
    ----------
    draws
        Number of random draws.
    before_nm, after_nm
        Median rms of cut minus design beyond a change of pose, without noise and cusps.
    gain_nm
        Least improvement of 95 % of the draws.
    worst_nm
        Degradation of the worst draw; negative if it improves.
    min_effect_nm
        Limit that the gain must exceed and the degradation must not.
    at_stake_nm
        Rms of the corrections that are based on a single map: if none of it repeats, the error of the next part grows
        by this at most.
    """

    draws: int
    before_nm: float
    after_nm: float
    gain_nm: float
    worst_nm: float
    min_effect_nm: float
    at_stake_nm: float

    @property
    def if_not_repeated_nm(self) -> float:
        """Form error of the next part if the error at stake is replaced by another one of the same size."""
        return math.hypot(self.after_nm, math.sqrt(2) * self.at_stake_nm)

    @property
    def ok(self) -> bool:
        """Whether the correction is worth writing."""
        return self.gain_nm > self.min_effect_nm and self.worst_nm <= self.min_effect_nm


def prove(
    draws: Draws, added: Floats, *, sources: bool = True, beyond: Floats | float = 0.0, min_effect_nm: float = 1.0
) -> Proof:  # fmt: skip
    """Evaluate a correction on all draws.

    Parameters
    ----------
    draws
        See `Diagnosis`.
    added
        Height added to the nominal surface, at the points of the draws. (n,) or (draws, n) [mm]
    sources
        Whether the plan uses the corrected tool and machine.
    beyond
        Form error at these points that the draws do not include. (n,) or (draws, n) [mm]
    min_effect_nm
        Improvement that 95 % of the draws must exceed, and degradation that none may exceed.
    """
    before = draws.rms_nm(draws.before + beyond)
    after = draws.rms_nm((draws.after if sources else draws.before) + beyond + added)
    gain = before - after
    change = (draws.after - draws.before if sources else np.zeros_like(draws.before)) + added
    stake = float(draws.rms_nm(change.mean(axis=0, keepdims=True))[0]) if draws.single else 0.0
    return Proof(
        draws=before.size, before_nm=float(np.median(before)), after_nm=float(np.median(after)),
        gain_nm=float(np.quantile(gain, GAIN_QUANTILE)), worst_nm=float(-gain.min()), min_effect_nm=min_effect_nm,
        at_stake_nm=stake,
    )  # fmt: skip
