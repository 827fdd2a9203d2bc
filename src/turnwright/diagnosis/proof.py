"""Whether a correction makes the next part better, on draws of all that is not certain."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from turnwright._arrays import Floats
from turnwright.diagnosis.findings import Draws

__all__ = ["Proof", "prove"]

REACHED = 0.05
"""Share of the draws that need not reach the improvement that is claimed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """What a correction does to the next part, as far as is known.

    Parameters
    ----------
    draws
        How many cases of all that is not certain were looked at.
    before_nm, after_nm
        Median root mean square of cut minus design beyond a change of pose, without noise and cusps.
    gain_nm
        By how much 95 of 100 draws become better, at least.
    worst_nm
        By how much the worst draw becomes worse; negative if it becomes better.
    worth_nm
        What the gain must exceed, and the worst draw must not.
    at_stake_nm
        Root mean square of what is corrected although only a single map shows it: if none of it comes back, the next
        part is off by so much more, at most.
    """

    draws: int
    before_nm: float
    after_nm: float
    gain_nm: float
    worst_nm: float
    worth_nm: float
    at_stake_nm: float

    @property
    def if_not_repeated_nm(self) -> float:
        """How far the next part may be off if what is at stake does not come back, but another of the same size."""
        return math.hypot(self.after_nm, math.sqrt(2) * self.at_stake_nm)

    @property
    def ok(self) -> bool:
        """Whether the correction is worth writing."""
        return self.gain_nm > self.worth_nm and self.worst_nm <= self.worth_nm


def prove(
    draws: Draws, added: Floats, *, sources: bool = True, beyond: Floats | float = 0.0, worth_nm: float = 1.0
) -> Proof:  # fmt: skip
    """Say what a correction does in all draws.

    Parameters
    ----------
    draws
        See `Diagnosis`.
    added
        What is added to the surface aimed at, at the places of the draws. (n,) or (draws, n) [mm]
    sources
        Whether tool and machine are planned as they were found.
    beyond
        What the part has at these places beyond all that was drawn. (n,) or (draws, n) [mm]
    worth_nm
        By how much 95 of 100 draws must become better, and by how much none may become worse.
    """
    before = draws.rms_nm(draws.before + beyond)
    after = draws.rms_nm((draws.after if sources else draws.before) + beyond + added)
    gain = before - after
    change = (draws.after - draws.before if sources else np.zeros_like(draws.before)) + added
    stake = float(draws.rms_nm(change.mean(axis=0, keepdims=True))[0]) if draws.single else 0.0
    return Proof(
        draws=before.size, before_nm=float(np.median(before)), after_nm=float(np.median(after)),
        gain_nm=float(np.quantile(gain, REACHED)), worst_nm=float(-gain.min()), worth_nm=worth_nm, at_stake_nm=stake,
    )  # fmt: skip
