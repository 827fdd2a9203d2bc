"""Rows of the force regression: forces, drift, and the design matrix for any critical thickness."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright._validate import whole
from turnwright.cutting.learning.learned import FORCE_NAMES, Transition
from turnwright.cutting.learning.signals import MAX_DRIFT_DEGREE, correlation_time
from turnwright.errors import InputError

__all__ = ["MIN_ROWS", "Rows"]

MIN_ROWS = 4
"""Number of rows on either side of a transition."""


class Rows(ABC):
    """Rows of a regression, with the state of the fit."""

    turns: ClassVar[bool] = False
    """Whether the rows are those of a rotating cutter, whose angle is estimated from the forces."""

    judged: ClassVar[slice] = slice(None)
    """Components whose noise is judged."""

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
        if np.count_nonzero(engaged) < MIN_ROWS:
            raise InputError(
                f"at least {MIN_ROWS} rows must be cuts, got {np.count_nonzero(engaged)}: measure more cuts"
            )
        record = np.zeros(n) if record is None else record
        self.in_time = time is not None
        self.order = np.arange(n) if time is None else np.lexsort((time, record))
        self.drift = np.zeros((n, 0)) if drift is None else _drift_columns(time, record, ~engaged, drift)
        self.stated = uncertainty is not None
        self.weights = np.ones_like(force) if uncertainty is None else 1 / uncertainty
        self.determined: tuple[str, ...] = tuple(FORCE_NAMES)
        self.edge = False
        self.power: list[float] | None = None
        self.reference = 1.0

    @property
    def parts(self) -> int:
        """Number of ductile columns of each coefficient."""
        return 2 if self.edge or self.power is not None else 1

    @abstractmethod
    def columns(self, limit: float) -> Floats:
        """Return the design matrix. (n, components, parameters).

        Its columns are, for the cutting coefficient, the ductile area, and the edge or the derivative with respect to
        the exponent; the same for the thrust; then, for both, the forces beyond the limit per width and per area.
        """

    @abstractmethod
    def transition(self, confidence: float) -> Transition | None:
        """Return the critical thickness with its interval; ``None`` if the forces show no transition."""

    def find_determined(self) -> tuple[str, ...]:
        """Return the coefficients that the measured components determine."""
        size = np.abs(self.columns(np.inf)).max(axis=(0, 1))
        return tuple(name for name, largest in zip(FORCE_NAMES, size, strict=True) if largest > 1e-9 * size.max())

    def groups(self, relative: Sequence[float] | Floats = ()) -> Iterator[tuple[Rows, Sequence[float] | Floats]]:
        """Return the rows that are fitted together, with the relative uncertainties of their components."""
        yield self, relative

    def place(self, beyond: bool = False) -> list[int]:
        """Return the column indices of the determined coefficients, and of their forces beyond the limit."""
        which = [list(FORCE_NAMES).index(name) for name in self.determined]
        ductile = [self.parts * k + i for k in which for i in range(self.parts)]
        return ductile + [2 * self.parts + 2 * k + i for k in which for i in (0, 1) if beyond]

    def design(self, used: Bools, split: Transition | None) -> tuple[Bools, Floats, int]:  # noqa: ARG002 - for rotating cutters
        """Return the rows and columns of the final fit, and the number of columns that belong to coefficients."""
        place = self.place()
        return used, self.columns(np.inf)[:, :, place], len(place)

    def unknown(self, answer: Floats, limit: float) -> Floats:  # noqa: ARG002 - for subclasses
        """Return columns of additional unknowns. (n, components, k)."""
        return np.zeros((*self.force.shape, 0))

    def synchronise(self, answer: Floats | None, limit: float) -> None:  # noqa: B027 - for rotating cutters
        """Estimate the angle of a rotating cutter from the forces; does nothing for a steady cut."""

    def find_warnings(self, split: Transition | None, ductile: Bools) -> list[str]:  # noqa: ARG002 - for subclasses
        """Return warnings about the result."""
        return []

    def surely_ductile(self, low: float) -> Bools:
        """Return the mask of rows that are ductile all along the edge for every limit of at least ``low``."""
        return np.asarray(self.thickest <= low)

    def surely_brittle(self, high: float) -> Bools:
        """Return the mask of rows that are brittle for every limit of at most ``high``."""
        return np.asarray(self.thickest > high)

    def line(self, which: int, answer: Floats, at: float) -> float:
        """Return the ductile force per width at a chip thickness."""
        thin = answer[self.parts * which :]
        if self.power is not None:
            ratio = at / self.reference
            return float(at * ratio ** -self.power[which] * (thin[0] - thin[1] * np.log(ratio)))
        return float(thin[0] * at + (thin[1] if self.edge else 0.0))

    def remaining(self, which: int, answer: Floats, at: float) -> float:
        """Return the force beyond the limit over the ductile force, at a chip thickness."""
        thick, line = answer[2 * self.parts + 2 * which :], self.line(which, answer, at)
        return float((thick[0] + thick[1] * at) / line) if line else np.inf

    def correlation(self, residual: Floats, rows: Bools) -> float:
        """Return the largest correlation time of the components of ``residual``, in rows. (n, components)."""
        inside = self.order[rows[self.order]]
        if not self.in_time or inside.size <= 16:
            return 1.0
        return max(correlation_time(column) for column in residual[inside].T)

    def part(self, component: int) -> Rows:
        """Return the rows with one force component, which determines the coefficient of the same index only."""
        single = copy.copy(self)
        single.force, single.weights = self.force[:, [component]], self.weights[:, [component]]
        single.components, single.determined = (self.components[component],), (tuple(FORCE_NAMES)[component],)
        return single


def _drift_columns(time: Floats | None, record: Floats, air: Bools, degree: int) -> Floats:
    """Return the design columns for the drift of each record. (n, records times (degree + 1))."""
    if time is None:
        raise InputError("a drift needs the times of the cuts, got none: state time, or leave drift out")
    degree = whole(degree, "the degree of the drift", 0, MAX_DRIFT_DEGREE)
    columns = []
    for number in np.unique(record):
        inside = record == number
        if np.count_nonzero(air & inside) <= degree + 1:
            raise InputError(
                f"a drift of degree {degree} needs more than {degree + 1} rows in air for each record, got "
                f"{np.count_nonzero(air & inside)}: record air before and after the cuts"
            )
        first, span = time[inside].min(), np.ptp(time[inside]) or 1.0
        columns.append(np.polynomial.legendre.legvander(2 * (time - first) / span - 1, degree) * inside[:, None])
    return np.asarray(np.hstack(columns), dtype=np.float64)
