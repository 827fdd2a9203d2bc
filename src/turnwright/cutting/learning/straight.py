r"""Chips that are equally thick all along the edge, and where their forces leave the ductile line.

In the ductile range the forces are in proportion to the area A of the uncut chip, beyond
the critical thickness they leave that line,

.. math:: F = d(t) + \begin{cases} K A & h \le h_c \\ (q_0 + q_1 h)\,A/h & h > h_c \end{cases}

with the drift d of the amplifier, a polynomial that the samples in air tell, in the same fit, so that its uncertainty
is in that of K. The critical thickness :math:`h_c` is the split at which both parts leave the least to explain. Since a
jump is found more sharply than the noise would let a mean be, its interval is not that of a normal distribution: it is
made of all splits that the likelihood ratio does not reject,

.. math:: \frac{S(h_c) - S(\hat h_c)}{\eta^2} \le -2 \ln\!\bigl(1 - \sqrt{p}\bigr)

(7.35 for p = 95 %), with the long-run variance η² of the noise on the side that would then be on the wrong part
[Hansen2000]_. What lies within that interval takes no part in the fit of K. Correlation in time is counted in all of
it.

Forces may also go on without a drop and grow more slowly beyond the critical thickness. F tests choose among no
transition, a drop and a change of slope; an edge force or a size effect, which bend forces too, is no transition.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.cutting.learning.cuts import Cuts
from turnwright.cutting.learning.fit import CERTAIN, TINY, UNLIKELY, Fit, hansen
from turnwright.cutting.learning.learned import NAMES, Transition
from turnwright.cutting.learning.rows import FEWEST, Rows
from turnwright.cutting.learning.slope_change import COMPONENTS, ROUNDING, SlopeChange, chance_of, slope_change
from turnwright.errors import InputError

__all__ = ["StraightRows", "least_chance"]

SURE = 3.0
"""Standard uncertainties within which a slope is that of forces that stand still, or go on."""

STILL = 0.05
"""Share of the ductile slope that counts as nothing, where the place of a transition is not quite known."""

SLOW = 0.3
"""Share of the ductile slope that these may be at most to tell one from the other."""


class StraightRows(Rows):
    """Rows of chips that are equally thick all along the edge: each component tells of one coefficient."""

    clearest = slice(0, 1)

    def __init__(self, cuts: Cuts, drift: int | None = None) -> None:
        """Take the cuts, and the degree of their drift."""
        force, engaged = np.column_stack((cuts.cutting, cuts.thrust)), cuts.thickness > 0
        super().__init__(
            force, tuple(NAMES), engaged, cuts.thickness,
            time=cuts.time, record=cuts.record, drift=drift, uncertainty=cuts.uncertainty,
        )  # fmt: skip
        area = cuts.thickness * cuts.width if cuts.area is None else cuts.area
        self.areas = np.column_stack((area, area if cuts.thrust_area is None else cuts.thrust_area))
        self.widths = np.divide(
            self.areas, cuts.thickness[:, None], out=np.zeros_like(self.areas), where=engaged[:, None]
        )
        self.spread = np.zeros_like(cuts.thickness) if cuts.spread is None else cuts.spread
        self.reference = float(np.exp(np.log(cuts.thickness[engaged]).mean()))
        self.load, self.labels = self.areas[:, 0], tuple(NAMES.values())
        self.kept = np.arange(COMPONENTS)

    def ductile(self, component: int, limit: float = np.inf) -> Floats:
        """Return what multiplies the coefficient, and the edge's own force or the bend by a power. (n, 1 or 2).

        Beyond a limit [mm] they stay, per width, what they are there.
        """
        width, thickness = self.widths[:, component], np.minimum(self.thickest, limit)
        area = width * thickness if limit < np.inf else self.areas[:, component]
        if self.power is not None:
            ratio = np.where(self.engaged, thickness / self.reference, 1.0)
            falls = area * ratio ** -self.power[component]
            return np.column_stack((falls, -falls * np.log(ratio)))
        return np.column_stack((area, width)) if self.edge else area[:, None]

    def columns(self, limit: float) -> Floats:
        """Return what each parameter is multiplied by. See its base."""
        thin, p = (self.thickest <= limit)[:, None], self.parts
        found = np.zeros((self.engaged.size, COMPONENTS, 2 * p + (2 * COMPONENTS if limit < np.inf else 0)))
        for c in range(COMPONENTS):
            found[:, c, p * c : p * (c + 1)] = self.ductile(c) * thin
            if limit < np.inf:
                brittle = np.column_stack((self.widths[:, c], self.areas[:, c])) * ~thin
                found[:, c, 2 * p + 2 * c : 2 * p + 2 * c + 2] = brittle
        return found[:, self.kept]

    def part(self, component: int) -> StraightRows:
        """Return the rows with one component of the force."""
        one = super().part(component)
        assert isinstance(one, StraightRows)  # noqa: S101 - a copy
        one.kept = self.kept[[component]]
        return one

    def groups(self, shares: Sequence[float] | Floats = (0.0, 0.0)) -> Iterator[tuple[Rows, Sequence[float] | Floats]]:
        """Return each component, which tells of its own coefficient alone."""
        yield from ((self.part(c), shares[c : c + 1]) for c in range(COMPONENTS))

    def surely_ductile(self, low: float) -> Bools:
        """Return which rows are ductile at every limit from ``low`` on."""
        return np.asarray(self.thickest + self.spread <= low)

    def surely_brittle(self, high: float) -> Bools:
        """Return which rows are brittle at every limit up to ``high``."""
        return np.asarray(self.thickest - self.spread >= high)

    def questions(self, split: Transition | None, ductile: Bools) -> list[str]:
        """Say if forces stand still, or too few are ductile."""
        if split is None:
            return []
        said, few = _standing(self, split.value), int(np.count_nonzero(ductile))
        if few <= FEWEST:
            said.append(
                f"only the {few} thinnest cuts are ductile beyond doubt, at least {FEWEST + 1} are needed to tell: if "
                "they are brittle too, coefficients and critical thickness are wrong, so measure thinner chips"
            )
        return said

    def transition(self, confidence: float) -> Transition | None:
        """Return the transition that the forces ask for: none, a drop, or a change of slope."""
        return _transition(self, confidence)

    @property
    def free(self) -> int:
        """Rows that are free beside the drift, a line and a limit."""
        return int(max(self.engaged.size - self.drift.shape[1] - 3, 1))


@dataclass(frozen=True, slots=True)
class _Drop:
    """The best split with a drop, and what it leaves of each component, with weights and long-run variance."""

    split: Transition
    squares: Floats
    weight: Floats
    noise: float


def _drop(rows: StraightRows, confidence: float) -> _Drop | None:
    """Find the thickness at which the forces leave the ductile line with a jump, and all those that could be it."""
    engaged = np.flatnonzero(rows.engaged)
    order = engaged[np.argsort(rows.thickest[engaged], kind="stable")]
    ascending = rows.thickest[order]
    # Number of rows on the thin side; rows of one thickness stay together.
    after = np.flatnonzero(np.diff(ascending) > 0) + 1
    after = after[(after >= FEWEST) & (after <= ascending.size - FEWEST)]
    if not after.size:
        return None
    middle = (ascending[after - 1] + ascending[after]) / 2
    squares = np.array([_left(rows, component, order, after) for component in range(COMPONENTS)])
    scale = np.maximum(squares.min(axis=1) / rows.free, TINY)
    rough = int(np.argmin((squares / scale[:, None]).sum(axis=0)))
    # The two components weigh as the noise of the ductile side tells.
    weight = 1 / np.diag(_sides(rows, order, int(after[rough]), float(middle[rough]))[0])
    joint = weight @ squares
    best = int(np.argmin(joint))
    at = float(middle[best])
    thin, thick, gone, left, answer = _sides(rows, order, int(after[best]), at)
    jump = max(float(weight @ gone**2), TINY)
    eta = [float((weight * gone) @ side @ (weight * gone) / jump) for side in (thin, thick)]
    # A split below the best one would make ductile what is brittle, and is judged by the noise of the brittle side.
    allowed = joint - joint[best] <= hansen(confidence) * np.where(np.arange(joint.size) < best, eta[1], eta[0])
    inside = after[allowed]
    low, high = order[inside.min() - 1], order[inside.max()]
    split = Transition(
        value=at,
        low=max(float(rows.thickest[low] - rows.spread[low]), 0.0),
        high=float(rows.thickest[high] + rows.spread[high]),
        remaining=tuple(rows.remaining(component, answer, at) for component in range(COMPONENTS)),
        chance=chance_of(rows, left, at),
    )
    return _Drop(split, squares[:, best], weight, max(eta))


def _left(rows: StraightRows, component: int, order: Ints, after: Ints) -> Floats:
    """Return the squares left by each split, from products of the columns that are added up once. (k,)."""
    ductile, beyond = rows.ductile(component), np.column_stack((rows.widths[:, component], rows.areas[:, component]))
    table = np.column_stack((rows.drift, ductile, beyond, rows.force[:, component]))
    table = table * rows.weights[:, component, None]
    size = np.maximum(np.linalg.norm(table, axis=0), TINY)
    size[-1] = 1.0
    table = table / size
    of_split = np.repeat([0, 1, 2, 0], [rows.drift.shape[1], ductile.shape[1], 2, 1])
    products = np.cumsum(table[order, :, None] * table[order, None, :], axis=0)
    air = table[~rows.engaged].T @ table[~rows.engaged]
    thin, thick = (np.outer(of_split != other, of_split != other) for other in (2, 1))
    sums = products[after - 1] * thin + (products[-1] - products[after - 1]) * thick + air
    normal, right, total = sums[:, :-1, :-1], sums[:, :-1, -1], float(sums[0, -1, -1])
    # Both columns of the brittle side are one where all its chips are as thick; a touch of the diagonal decides.
    normal = normal + 1e-11 * np.trace(normal, axis1=1, axis2=2)[:, None, None] / right.shape[1] * np.eye(
        right.shape[1]
    )
    answer = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(total - np.einsum("ij,ij->i", answer, right), 1e-14 * total))


def _sides(rows: StraightRows, order: Ints, cut: int, limit: float) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return the long-run covariances of the thin and the thick side at a split, the jump there, what is left, the fit.

    (2, 2), (2, 2), (2,), (n, 2) and (k,).
    """
    fit, columns = Fit(rows), rows.columns(limit)
    answer, _, left = fit.solve(columns)
    line, first = answer[: 2 * rows.parts], order[cut]
    jump = rows.weights[first] * (rows.columns(np.inf)[first] @ line - columns[first] @ answer)
    covers = []
    for which in (order[:cut], order[cut:]):
        side = np.zeros(rows.engaged.size, dtype=np.bool_)
        side[which] = True
        covers.append(rows.together(left, side) * left[which].T @ left[which] / max(which.size - 1, 1))
    # Few rows on a side say little of its noise: then the larger of the two stands for both.
    if min(cut, order.size - cut) < 2 * FEWEST:
        covers = [max(covers, key=np.trace)] * 2
    floor = np.diag(ROUNDING * (fit.force**2).mean(axis=0) + TINY)
    return covers[0] + floor, covers[1] + floor, jump, left, answer


def least_chance(cuts: Cuts, confidence: float = 0.95) -> float:
    """Return the chance of the clearest transition that forces show, of either kind, told or not."""
    rows = StraightRows(cuts)
    drop, bend = _drop(rows, confidence), slope_change(rows, confidence)
    found = (bend, None if drop is None else drop.split)
    return min([1.0, *(one.chance for one in found if one is not None)])


def _transition(rows: StraightRows, confidence: float) -> Transition | None:
    """Return the transition that the forces ask for: none, a drop, or a change of slope.

    A change of slope is the simpler one. A drop is taken where it explains more than chance would; where it may, the
    interval holds both. Neither is taken where an edge force or a size effect explains as much.
    """
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    drop, bend = _drop(rows, confidence), slope_change(rows, confidence)
    n = rows.engaged.size

    def probability(drop: _Drop, squares: Floats, numbers: int) -> float:
        """Return how often noise alone lets a drop, with so many more numbers, explain so much more."""
        # The noise is that of the richer model: what a drop leaves of two lines that meet would count as noise.
        gain = float(drop.weight @ (squares - drop.squares)) / drop.noise / numbers
        return n * float(f.sf(gain, numbers, rows.free))

    for one in (bend, None if drop is None else drop.split):
        if one is not None and one.chance <= CERTAIN:
            _standing(rows, one.value)
    split = None if drop is None or drop.split.chance > CERTAIN or drop.split.remaining[0] >= 1 else drop.split
    if bend is None or drop is None:
        return _bent(bend) or split
    if probability(drop, bend.smooth, COMPONENTS) > CERTAIN:
        split = None
    bent, chance = _bent(bend), probability(drop, bend.squares, COMPONENTS + 1)
    if bent is None or chance < CERTAIN:
        return split
    if split is not None and chance < n * CERTAIN:
        return replace(bent, low=min(bent.low, split.low), high=max(bent.high, split.high))
    return bent


def _bent(bend: SlopeChange | None) -> Transition | None:
    """Return a change of slope as a transition; what could as well begin at no thickness at all is none."""
    if bend is None or bend.chance > CERTAIN or bend.straight or not bend.falls or bend.low == 0:
        return None
    return Transition(bend.value, bend.low, bend.high, (1.0, 1.0), bend.chance)


def _standing(rows: StraightRows, limit: float) -> list[str]:
    """Say if both forces stand still at their largest beyond a limit; raise if one does and the other goes on.

    Fracture changes both; the end of a range is that of a channel.
    """
    level, clear, stands, goes = [], [], [], []
    thick = rows.thickest > limit
    for component in range(COMPONENTS):
        beyond = rows.widths[:, component] * np.maximum(rows.thickest - limit, 0.0)
        fit = Fit(rows.part(component))
        found = fit.estimate(np.column_stack((beyond, rows.ductile(component, limit)))[:, None], UNLIKELY)
        slope, sigma, whole = found.value[0], found.sigma[0], found.value[1]
        force = np.abs(rows.force[:, component])
        level.append(float(force[thick].mean()))
        near = max(SURE * sigma, STILL * whole)
        clear.append(SURE * sigma < SLOW * whole)
        stands.append(abs(slope) < near and force[thick].max() >= force[~thick].max())
        goes.append(abs(slope - whole) < near)
    if all(stands):
        question = (
            f"both forces stand at their largest from there on, {level[0]:.4g} N and {level[1]:.4g} N: if these are "
            "the ends of the ranges, the critical thickness is not the material's"
        )
        return [question]
    names = tuple(NAMES.values())
    for which, other in ((0, 1), (1, 0)):
        if all(clear) and stands[which] and goes[other]:
            raise InputError(
                f"the {names[which]} stands at its largest, {level[which]:.4g} N, from {limit * 1e6:.4g} nm on "
                f"and the {names[other]} goes on in proportion: fracture changes both, so the channel is saturated; "
                "record with a larger range, or leave these cuts out"
            )
    return []
