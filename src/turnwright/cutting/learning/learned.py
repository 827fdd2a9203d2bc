"""What forces tell of a material, as numbers with intervals and as sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from turnwright._arrays import Floats, frozen

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["NAMES", "Estimate", "ForceFit", "LearnedMaterial", "Transition", "said_of"]

NAMES = {"cutting": "cutting force", "thrust": "thrust"}
"""The coefficients, and the forces that they make."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A number that was learned, and the interval that holds the truth with the stated confidence.

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
        """Return an estimate with so much of its interval on either side."""
        return cls(value=float(value), low=float(value - half), high=float(value + half))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceFit:
    """Forces of the rows that are cuts, beside what was learned makes of them.

    Parameters
    ----------
    components
        Which forces.
    thickness
        Thickest place of each chip. (n,) [mm]
    measured
        The forces, drift taken out. (n, components) [N]
    fitted
        The same as they follow from what was learned. (n, components) [N]
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
    """A critical thickness that was found, its interval, and what share of each force remains beyond."""

    value: float
    low: float
    high: float
    remaining: tuple[float, ...]
    chance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedMaterial:
    """What forces tell of a material.

    Parameters
    ----------
    cutting, thrust
        Coefficients Kc and Kt of the ductile range; ``None`` for one that the measured forces do not tell. [N/mm²]
    uncertainty
        Their standard uncertainties. (2) [N/mm²]
    critical
        Critical thickness; ``None`` where the forces show no transition. [mm]
    confidence
        Of the intervals.
    ductile, brittle
        Rows that are ductile, and brittle, beyond doubt.
    thickest
        Thickest chip of all rows. [mm]
    remaining
        Force beyond the transition as a share of what the ductile line has there, for each coefficient that is told;
        1 where the forces go on without a drop; ``None`` without a transition.
    fit
        The forces beside what was learned makes of them.
    chance
        At most this share of experiments without a transition would show one as clear, wherever and of whichever kind,
        if their noise is normal and as large in all cuts, or larger on the brittle side.
    sentences
        What a person should know before relying on it.
    exponents
        Powers with which the coefficients fall as the chip grows; ``None`` where that was not asked for. (2)
    reference_thickness
        Chip thickness at which the coefficients then are what they are. [mm]
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


def said_of(
    estimates: dict[str, Estimate], split: Transition | None, thickest: float, confidence: float
) -> Sequence[str]:
    """Say what was learned."""
    said = [
        f"the {name} coefficient is {one.value:.5g} N/mm^2, {confidence:.0%} interval {one.low:.5g} to "
        f"{one.high:.5g} N/mm^2"
        for name, one in estimates.items()
    ]
    if split is None:
        none = (
            f"the forces show no transition up to the thickest chip of {thickest * 1e6:.4g} nm: the critical thickness "
            "is beyond, or the cuts are too few or too noisy to tell"
        )
        return [*said, none]
    shares = [f"{share:.0%} of the {NAMES[name]}" for name, share in zip(estimates, split.remaining, strict=True)]
    beyond = f"{' and '.join(shares)} {'remain' if len(shares) > 1 else 'remains'}"
    if all(share == 1 for share in split.remaining):
        beyond = "the forces grow more slowly, without a drop"
    return [*said, f"the critical thickness is {split.value * 1e6:.4g} nm; beyond it {beyond}"]
