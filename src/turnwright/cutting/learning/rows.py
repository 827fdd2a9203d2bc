"""What a regression takes of its rows, whatever the cut: forces, drift, and columns for any critical thickness."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright._validate import whole
from turnwright.cutting.learning.learned import NAMES, Transition
from turnwright.cutting.learning.signals import HIGHEST_DRIFT, correlation_time
from turnwright.errors import InputError

__all__ = ["FEWEST", "Rows"]

FEWEST = 4
"""Rows that a part of the forces must have on either side of a transition."""


class Rows(ABC):
    """Rows of a regression; what is learned of them on the way is kept here too."""

    turns: ClassVar[bool] = False
    """Whether the rows are of a cutter that turns, whose angle the forces themselves must tell."""

    clearest: ClassVar[slice] = slice(None)
    """The components whose noise is judged."""

    def __init__(
        self,
        force: Floats,
        components: tuple[str, ...],
        engaged: Bools,
        thickest: Floats,
        *,
        time: Floats | None,
        record: Floats | None,
        drift: int | None,
        uncertainty: Floats | None = None,
    ) -> None:
        self.force, self.components, self.engaged, self.thickest = force, components, engaged, thickest
        self.labels, self.load = components, thickest
        n = engaged.size
        if np.count_nonzero(engaged) < FEWEST:
            raise InputError(f"{np.count_nonzero(engaged)} rows are cuts, at least {FEWEST} are needed: measure more")
        record = np.zeros(n) if record is None else record
        self.in_time = time is not None
        self.order = np.arange(n) if time is None else np.lexsort((time, record))
        self.drift = np.zeros((n, 0)) if drift is None else _drifts(time, record, ~engaged, drift)
        self.stated = uncertainty is not None
        self.weights = np.ones_like(force) if uncertainty is None else 1 / uncertainty
        self.told: tuple[str, ...] = tuple(NAMES)
        self.edge = False
        self.power: list[float] | None = None
        self.reference = 1.0

    @property
    def parts(self) -> int:
        """Ductile columns of each coefficient."""
        return 2 if self.edge or self.power is not None else 1

    @abstractmethod
    def columns(self, limit: float) -> Floats:
        """Return what each parameter is multiplied by. (n, components, parameters).

        For the cutting coefficient: ductile area, edge or bend; then the same for thrust; then what is beyond the
        limit per width and per area, for both.
        """

    @abstractmethod
    def transition(self, confidence: float) -> Transition | None:
        """Find the critical thickness, and all that could be it; ``None`` where the forces show none."""

    def which_are_told(self) -> tuple[str, ...]:
        """Return which coefficients the measured components tell of."""
        size = np.abs(self.columns(np.inf)).max(axis=(0, 1))
        return tuple(name for name, one in zip(NAMES, size, strict=True) if one > 1e-9 * size.max())

    def groups(self, shares: Sequence[float] | Floats = ()) -> Iterator[tuple[Rows, Sequence[float] | Floats]]:
        """Return what is estimated together, with the shares by which its components are uncertain."""
        yield self, shares

    def place(self, beyond: bool = False) -> list[int]:
        """Return the columns of the coefficients that are told, and of what is beyond the limit for them."""
        which = [list(NAMES).index(name) for name in self.told]
        found = [self.parts * k + i for k in which for i in range(self.parts)]
        return found + [2 * self.parts + 2 * k + i for k in which for i in (0, 1) if beyond]

    def design(self, used: Bools, split: Transition | None) -> tuple[Bools, Floats, int]:  # noqa: ARG002 - see cutters that turn
        """Return the rows and columns that coefficients are estimated of, and how many of these tell of them."""
        place = self.place()
        return used, self.columns(np.inf)[:, :, place], len(place)

    def unknown(self, answer: Floats, limit: float) -> Floats:  # noqa: ARG002 - for those that have some
        """Return columns of what else is fitted beside the parameters. (n, components, k)."""
        return np.zeros((*self.force.shape, 0))

    def synchronise(self, answer: Floats | None, limit: float) -> None:  # noqa: B027 - for those that turn
        """Find what the rows themselves tell of where the cutter stands: nothing in a steady cut."""

    def questions(self, split: Transition | None, ductile: Bools) -> list[str]:  # noqa: ARG002 - for those that have some
        """Say what a person should look at."""
        return []

    def surely_ductile(self, low: float) -> Bools:
        """Return which rows are ductile all along the edge at every limit from ``low`` on."""
        return np.asarray(self.thickest <= low)

    def surely_brittle(self, high: float) -> Bools:
        """Return which rows are brittle at every limit up to ``high``."""
        return np.asarray(self.thickest > high)

    def line(self, which: int, answer: Floats, at: float) -> float:
        """Return the force per width of a ductile chip of some thickness."""
        thin = answer[self.parts * which :]
        if self.power is not None:
            ratio = at / self.reference
            return float(at * ratio ** -self.power[which] * (thin[0] - thin[1] * np.log(ratio)))
        return float(thin[0] * at + (thin[1] if self.edge else 0.0))

    def remaining(self, which: int, answer: Floats, at: float) -> float:
        """Return the force per width of a chip beyond the limit over what the ductile line has there."""
        thick, line = answer[2 * self.parts + 2 * which :], self.line(which, answer, at)
        return float((thick[0] + thick[1] * at) / line) if line else np.inf

    def together(self, left: Floats, rows: Bools) -> float:
        """Return how many rows in time say as much as one. ``left`` is (n, components)."""
        inside = self.order[rows[self.order]]
        if not self.in_time or inside.size <= 16:
            return 1.0
        return max(correlation_time(column) for column in left[inside].T)

    def part(self, component: int) -> Rows:
        """Return the rows with one component of the force, which tells of the coefficient of its number alone."""
        one = copy.copy(self)
        one.force, one.weights = self.force[:, [component]], self.weights[:, [component]]
        one.components, one.told = (self.components[component],), (tuple(NAMES)[component],)
        return one


def _drifts(time: Floats | None, record: Floats, air: Bools, degree: int) -> Floats:
    """Return the columns of a drift of each record. (n, records times (degree + 1))."""
    if time is None:
        raise InputError("cuts without times have a drift to be found: give their times, or no drift")
    degree = whole(degree, "the degree of the drift", 0, HIGHEST_DRIFT)
    columns = []
    for one in np.unique(record):
        inside = record == one
        if np.count_nonzero(air & inside) <= degree + 1:
            raise InputError(
                f"{np.count_nonzero(air & inside)} rows of a record are in air, a drift of degree {degree} needs more "
                f"than {degree + 1}: record air beside the cuts"
            )
        first, span = time[inside].min(), np.ptp(time[inside]) or 1.0
        columns.append(np.polynomial.legendre.legvander(2 * (time - first) / span - 1, degree) * inside[:, None])
    return np.asarray(np.hstack(columns), dtype=np.float64)
