"""Results of a material fit: estimates with confidence intervals, and a report in sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from turnwright._arrays import Floats, frozen

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["FORCE_NAMES", "Estimate", "ForceFit", "LearnedMaterial", "Transition", "report_estimates"]

FORCE_NAMES = {"cutting": "cutting force", "thrust": "thrust"}
"""Force that belongs to each coefficient."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Estimate of a quantity, with its confidence interval.

    Parameters
    ----------
    value
        The best estimate. [N/mm² or mm]
    low, high
        The interval. [N/mm² or mm]
    """

    value: float
    low: float
    high: float

    @classmethod
    def around(cls, value: float, half: float) -> Estimate:
        """Return an estimate with a symmetric interval of the given half width."""
        return cls(value=float(value), low=float(value - half), high=float(value + half))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceFit:
    """Measured and fitted forces of the cuts.

    Parameters
    ----------
    components
        Names of the force components.
    thickness
        Maximum uncut chip thickness of each cut. (n,) [mm]
    measured
        Measured forces with the drift removed. (n, components) [N]
    fitted
        Forces from the fitted coefficients. (n, components) [N]
    """

    components: tuple[str, ...]
    thickness: Floats
    measured: Floats
    fitted: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "thickness", frozen(self.thickness, "thickness"))
        for name in ("measured", "fitted"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, ndim=2))


@dataclass(frozen=True, slots=True)
class Transition:
    """Ductile-to-brittle transition: critical thickness, its interval, and the remaining fraction of each force."""

    value: float
    low: float
    high: float
    remaining: tuple[float, ...]
    chance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedMaterial:
    """Force coefficients and critical chip thickness estimated from measured forces.

    Parameters
    ----------
    cutting, thrust
        Coefficients Kc and Kt of the ductile regime; ``None`` if the measured components do not determine one. [N/mm²]
    uncertainty
        Standard uncertainties of ``cutting`` and ``thrust``. (2) [N/mm²]
    critical
        Critical chip thickness; ``None`` if the forces show no transition. [mm]
    confidence
        Confidence level of the intervals. [1]
    ductile, brittle
        Number of rows that are certainly ductile, and certainly brittle.
    thickest
        Maximum uncut chip thickness of all rows. [mm]
    remaining
        Force just beyond the transition over the ductile force, for each determined coefficient; 1 for a transition
        without a drop, ``None`` without a transition. [1]
    fit
        Measured and fitted forces.
    chance
        Upper bound of the probability that an experiment without a transition shows one as clear, of any kind and at
        any thickness; for normal noise that is equal in all cuts, or larger on the brittle side. [1]
    sentences
        Report of the result, with warnings.
    exponents
        Exponents of the size effect; ``None`` if it was not fitted. (2)
    reference_thickness
        Chip thickness at which the coefficients of a size effect are stated; ``None`` without one. [mm]
    """

    cutting: Estimate | None
    thrust: Estimate | None
    uncertainty: tuple[float | None, float | None]
    critical: Estimate | None
    confidence: float
    ductile: int
    brittle: int
    thickest: float
    remaining: tuple[float, ...] | None
    chance: float
    sentences: tuple[str, ...]
    fit: ForceFit
    exponents: tuple[Estimate | None, Estimate | None] | None = None
    reference_thickness: float | None = None


def report_estimates(
    estimates: dict[str, Estimate], split: Transition | None, thickest: float, confidence: float
) -> Sequence[str]:
    """Report the estimates and the transition, one sentence each."""
    report = [
        f"the {name} coefficient is {estimate.value:.5g} N/mm^2, {confidence:.0%} interval {estimate.low:.5g} to "
        f"{estimate.high:.5g} N/mm^2"
        for name, estimate in estimates.items()
    ]
    if split is None:
        no_transition = (
            f"the forces show no transition up to the thickest chip of {thickest * 1e6:.4g} nm: the critical thickness "
            "is larger, or the cuts are too few or too noisy to show it"
        )
        return [*report, no_transition]
    fractions = [
        f"{ratio:.0%} of the {FORCE_NAMES[name]}" for name, ratio in zip(estimates, split.remaining, strict=True)
    ]
    beyond = f"{' and '.join(fractions)} {'remain' if len(fractions) > 1 else 'remains'}"
    if all(ratio == 1 for ratio in split.remaining):
        beyond = "the forces grow more slowly, without a drop"
    return [*report, f"the critical thickness is {split.value * 1e6:.4g} nm; beyond it {beyond}"]
