"""Rows of chips of uniform thickness along the edge."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright.cutting.learning.cuts import Cuts
from turnwright.cutting.learning.learned import FORCE_NAMES
from turnwright.cutting.learning.rows import Rows

__all__ = ["COMPONENTS", "UniformRows"]

COMPONENTS = 2
"""Cutting force and thrust."""


class UniformRows(Rows):
    """Rows of chips of uniform thickness along the edge: each component determines one coefficient."""

    judged = slice(0, 1)

    def __init__(self, cuts: Cuts, drift: int | None = None) -> None:
        """Take the cuts and the degree of their drift."""
        force, engaged = np.column_stack((cuts.cutting, cuts.thrust)), cuts.thickness > 0
        super().__init__(
            force, tuple(FORCE_NAMES), engaged, cuts.thickness,
            time=cuts.time, record=cuts.record, drift=drift, uncertainty=cuts.uncertainty,
        )  # fmt: skip
        area = cuts.thickness * cuts.width if cuts.area is None else cuts.area
        self.areas = np.column_stack((area, area if cuts.thrust_area is None else cuts.thrust_area))
        self.widths = np.divide(
            self.areas, cuts.thickness[:, None], out=np.zeros_like(self.areas), where=engaged[:, None]
        )
        self.spread = np.zeros_like(cuts.thickness) if cuts.spread is None else cuts.spread
        self.reference = float(np.exp(np.log(cuts.thickness[engaged]).mean()))
        self.load, self.labels = self.areas[:, 0], tuple(FORCE_NAMES.values())
        self.selected = np.arange(COMPONENTS)

    def ductile(self, component: int, limit: float = np.inf) -> Floats:
        """Return the columns of a coefficient and of its edge force or exponent. (n, 1 or 2).

        Beyond ``limit`` [mm] they are constant per width.
        """
        width, thickness = self.widths[:, component], np.minimum(self.thickest, limit)
        area = width * thickness if limit < np.inf else self.areas[:, component]
        if self.power is not None:
            ratio = np.where(self.engaged, thickness / self.reference, 1.0)
            falls = area * ratio ** -self.power[component]
            return np.column_stack((falls, -falls * np.log(ratio)))
        return np.column_stack((area, width)) if self.edge else area[:, None]

    def columns(self, limit: float) -> Floats:
        """Return the design matrix, see `Rows.columns`."""
        thin, p = (self.thickest <= limit)[:, None], self.parts
        columns = np.zeros((self.engaged.size, COMPONENTS, 2 * p + (2 * COMPONENTS if limit < np.inf else 0)))
        for c in range(COMPONENTS):
            columns[:, c, p * c : p * (c + 1)] = self.ductile(c) * thin
            if limit < np.inf:
                brittle = np.column_stack((self.widths[:, c], self.areas[:, c])) * ~thin
                columns[:, c, 2 * p + 2 * c : 2 * p + 2 * c + 2] = brittle
        return columns[:, self.selected]

    def part(self, component: int) -> UniformRows:
        """Return the rows with one force component."""
        single = super().part(component)
        assert isinstance(single, UniformRows)  # noqa: S101 - a copy
        single.selected = self.selected[[component]]
        return single

    def groups(
        self, relative: Sequence[float] | Floats = (0.0, 0.0)
    ) -> Iterator[tuple[Rows, Sequence[float] | Floats]]:
        """Return each component separately, since it determines its own coefficient only."""
        yield from ((self.part(c), relative[c : c + 1]) for c in range(COMPONENTS))

    def surely_ductile(self, low: float) -> Bools:
        """Return the mask of rows that are ductile for every limit of at least ``low``."""
        return np.asarray(self.thickest + self.spread <= low)

    def surely_brittle(self, high: float) -> Bools:
        """Return the mask of rows that are brittle for every limit of at most ``high``."""
        return np.asarray(self.thickest - self.spread >= high)

    @property
    def free(self) -> int:
        """Degrees of freedom after the drift, a line and a limit."""
        return int(max(self.engaged.size - self.drift.shape[1] - 3, 1))
