r"""From measured forces to the coefficients of a material and the chip it bears, each with its interval.

Everything is one regression. In the ductile range the forces are in proportion to the area A of the uncut chip, beyond
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

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, freeze, frozen, same_length
from turnwright._validate import between, check_numbers, positive, whole as whole_number
from turnwright.cutting.learning.chance import chance_of
from turnwright.cutting.learning.saturation import SOLID, rail, saturated
from turnwright.cutting.learning.signals import ForceRecord, correlation_time, in_air
from turnwright.cutting.learning.slope_change import SlopeChange, slope_change
from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from turnwright.cutting.learning.edge_cuts import NoseCuts

__all__ = ["Cuts", "Estimate", "ForceFit", "LearnedMaterial", "learn_material", "measured_cuts"]

COMPONENTS = 2
"""Cutting force and thrust."""

CERTAIN = 0.01
"""A transition is told of if chance would make one as clear in less than this share of experiments."""

WILD = 10.0
"""Scatter in the cut over that in air beyond which something is likely not as stated."""

UNLIKELY = 0.999
"""A departure from proportion is told of outside this interval."""

SURE = 3.0
"""Standard uncertainties within which a slope is that of forces that stand still, or go on."""

STILL = 0.05
"""Share of the ductile slope that counts as nothing, where the place of a transition is not quite known."""

SLOW = 0.3
"""Share of the ductile slope that these may be at most to tell one from the other."""

ROUNDS = 20
"""Steps of Newton for the power of a size effect."""

SETTLED = 1e-10
"""Change of a power at which these end."""

CLEAR = 5.0
"""Times the scatter in air that a force must have for its cut to be found beyond doubt, as `engagements` looks for it.
"""

SOFTEST, HARDEST = 10.0, 1e5
"""Cutting coefficients that materials have; beyond, a unit is likely not as stated. [N/mm²]"""

THICKEST = 0.1
"""Uncut chip beyond which a thickness is likely not in mm: that of a diamond is below. [mm]"""

EXACT = 1e-6
"""Share of the thickest chip below which a departure from proportion is that of the arithmetic."""

FEWEST = 4
"""Rows that a part of the forces must have on either side of the transition."""

HIGHEST_DRIFT = 6


def freeze_cuts(cuts: Cuts | NoseCuts, names: Sequence[str], optional: Sequence[str], components: int) -> None:
    """Make arrays of the fields of cuts, with positive uncertainties of all components if they are stated."""
    freeze(cuts, names, optional, of=" of the cuts")
    if cuts.uncertainty is None:
        return
    stated = frozen(cuts.uncertainty, "uncertainty of the cuts", ndim=2)
    same_length([(names[0], getattr(cuts, names[0])), ("uncertainty", stated)])
    if stated.shape[1] != components or not (stated > 0).all():
        raise InputError(
            f"the uncertainties of the cuts are not {components} positive numbers for each: give one for each "
            "component that was measured, or none at all"
        )
    object.__setattr__(cuts, "uncertainty", stated)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cuts:
    """Forces and the chips that they belong to: a row for each steady cut, or for each short stretch of a record.

    Parameters
    ----------
    thickness
        Thickest place of the uncut chip; 0 where the tool is in air. (n,) [mm]
    width
        Of the uncut chip. (n,) [mm]
    cutting, thrust
        Mean forces. Each (n,) [N]
    area
        Of the uncut chip across the cutting direction; thickness times width, as in orthogonal cutting, if not given.
        (n,) [mm²]
    thrust_area
        What the thrust coefficient multiplies: for a round nose the area as it is seen along the measured direction.
        As ``area`` if not given. (n,) [mm²]
    uncertainty
        Standard uncertainties of cutting force and thrust; ``None`` where the scatter of the rows is to tell. (n, 2)
        [N]
    time
        Of each row, where the rows are stretches of one record. (n,) [s]
    spread
        Half the range of thicknesses within each row. (n,) [mm]
    record
        Number of the record that each row is of; each has a drift of its own. All are of one if not given. (n,)

    Raises
    ------
    InputError
        If the arrays differ in length, or a thickness or width is below zero.
    """

    thickness: Floats
    width: Floats
    cutting: Floats
    thrust: Floats
    area: Floats | None = None
    thrust_area: Floats | None = None
    uncertainty: Floats | None = None
    time: Floats | None = None
    spread: Floats | None = None
    record: Floats | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        optional = ("area", "thrust_area", "time", "spread", "record")
        freeze_cuts(self, ("thickness", "width", "cutting", "thrust"), optional, COMPONENTS)
        if self.thickness.size and min(self.thickness.min(), self.width.min()) < 0:
            raise InputError(
                f"the cuts have a thickness or width of {min(self.thickness.min(), self.width.min()):g} mm, the "
                "limit is 0 mm: correct it"
            )
        bare = int(np.count_nonzero((self.thickness > 0) & (self.width == 0)))
        if bare:
            raise InputError(f"{bare} cuts have a thickness and a width of 0 mm: state how wide they are")


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
        check_numbers(self)
        object.__setattr__(self, "thickness", frozen(self.thickness, "thickness"))
        for name in ("measured", "fitted"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, ndim=2))


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


def measured_cuts(
    record: ForceRecord,
    cuts: ArrayLike,
    *,
    cutting: str,
    thrust: str,
    thickness: Callable[[Floats], Floats],
    width: float,
    block: float,
    guard: float,
) -> Cuts:
    """Average a record over short stretches, in the cuts and in air.

    Parameters
    ----------
    record
        Forces, the dynamometer's own share taken out; the drift may stay in, see `learn_material`.
    cuts
        First sample of each cut and first one after it, see `engagements`. (m, 2)
    cutting, thrust
        Which channel is which, with a minus where it points the other way.
    thickness
        Gives the chip thickness at some times. (k,) [s] to (k,) [mm]
    width
        Of the chip. [mm]
    block
        Length of a stretch; the transition is found to about this. [s]
    guard
        What is left out on either side of each entry and exit. [s]

    Raises
    ------
    InputError
        If no stretch fits in a cut.
    """
    at = stretches(record, cuts, block=block, guard=guard)
    start, step, flag = at.start, at.step, at.cut >= 0
    begin, end = start / record.rate_hz, (start + step - 1) / record.rate_hz
    ends = np.array([np.where(flag, thickness(at), 0.0) for at in (begin, end)])
    return Cuts(
        thickness=ends.mean(axis=0),
        width=np.where(flag, width, 0.0),
        cutting=at.means(record.channel(cutting)),
        thrust=at.means(record.channel(thrust)),
        time=(begin + end) / 2,
        spread=np.abs(ends[1] - ends[0]) / 2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Short stretches of a record, in its cuts and in air, in the order of time."""

    start: Ints
    step: int
    cut: Ints  # number of the cut that each is in; -1 in air

    def means(self, values: Floats) -> Floats:
        """Return the mean of each stretch."""
        total = np.concatenate(([0.0], np.cumsum(values)))
        return np.asarray((total[self.start + self.step] - total[self.start]) / self.step)


def stretches(record: ForceRecord, cuts: ArrayLike, *, block: float, guard: float) -> Stretches:
    """Divide a record into stretches of one length that lie in one cut, or in air."""
    step = max(1, round(positive(block, "block", "s") * record.rate_hz))
    margin = max(0, round(between(guard, "guard", 0.0, np.inf, "s") * record.rate_hz))
    pairs = np.asarray(cuts, dtype=np.int64).reshape(-1, 2)
    air = in_air(record.samples, pairs, guard=margin)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], air, [False])).astype(np.int8))).reshape(-1, 2)
    spans = [(first + margin, last - margin, number) for number, (first, last) in enumerate(pairs)]
    spans += [(first, last, -1) for first, last in edges]
    starts, which = [], []
    for first, last, number in spans:
        count = max((last - first) // step, 0)
        starts.append(first + step * np.arange(count))
        which.append(np.full(count, number))
    start, cut = np.concatenate(starts).astype(np.int64), np.concatenate(which).astype(np.int64)
    if not (cut >= 0).any():
        raise InputError(
            f"no stretch of {block:g} s fits in a cut with {guard:g} s left out at entry and exit: shorten them"
        )
    order = np.argsort(start)
    return Stretches(start[order], step, cut[order])


def learn_material(
    cuts: Cuts,
    *,
    drift: int | None = None,
    edge_force: bool = False,
    size_effect: bool = False,
    calibration: tuple[float, float] = (0.0, 0.0),
    thickness_uncertainty: float = 0.0,
    confidence: float = 0.95,
) -> LearnedMaterial:
    """Learn the coefficients and the critical thickness of a material.

    Parameters
    ----------
    cuts
        Forces and chips.
    drift
        Degree of the polynomial in time that the forces in air follow; ``None`` for forces without drift.
    edge_force
        Whether a force in proportion to the width alone, of the rubbing edge, is taken out of the coefficients.
    size_effect
        Whether the coefficients fall with a power of the chip thickness, :math:`K_0 (h/h_0)^{-m}`; :math:`h_0` is the
        geometric mean of all thicknesses.
    calibration
        Standard uncertainties, as shares, that are common to all cutting forces and to all thrusts: of the dynamometer
        (see `Dynamometer.relative_uncertainty`), the width, the thickness.
    thickness_uncertainty
        Standard uncertainty that is common to all thicknesses, such as that of where the cut began. [mm]
    confidence
        Of all intervals.

    Raises
    ------
    InputError
        If there are too few cuts to tell, or a channel is saturated, all zero, or of the wrong sign or unit.

    Sources
    -------
    [Hansen2000]_ for the transition; the force model of [Troutman2016]_. Oracles: forces made from known coefficients,
    in a hundred random experiments; Student's t of a regression.
    """
    between(confidence, "confidence", 0.5, 0.999, "")
    rows = _Rows(cuts, drift, edge=edge_force, falling=size_effect)
    split, ductile = _parts(rows, confidence)
    for _ in range(ROUNDS if size_effect else 0):
        if rows.bend(ductile | ~rows.engaged) < SETTLED:
            break
        split, ductile = _parts(rows, confidence)
    parts = [rows.slope(component, ductile | ~rows.engaged, confidence) for component in range(COMPONENTS)]
    for name, (value, _, half) in zip(("cutting", "thrust"), parts, strict=True):
        require_material(name, value, value + half)
    from scipy.stats import norm  # noqa: PLC0415 - costly to import

    wide = float(norm.ppf(0.5 + confidence / 2))
    estimates, standard = [], []
    for (value, sigma, half), share in zip(parts, calibration, strict=True):
        common = between(share, "calibration", 0.0, 1.0, "") * abs(value)
        reach = float(np.hypot(half, wide * common))
        estimates.append(Estimate(value=value, low=value - reach, high=value + reach))
        standard.append(float(np.hypot(sigma, common)))
    critical = None
    standing = () if split is None else _standing(rows, split.value)
    if split is not None:
        more = wide * between(thickness_uncertainty, "thickness_uncertainty", 0.0, np.inf, "mm")
        critical = Estimate(value=split.value, low=max(split.low - more, 0.0), high=split.high + more)
    brittle = 0 if split is None else int(np.count_nonzero(rows.lower >= split.high))
    sentences = [
        *said_of(
            dict(zip(("cutting", "thrust"), estimates, strict=True)),
            None if split is None else split.value,
            () if split is None else split.remaining,
            float(cuts.thickness.max()),
            confidence,
        ),
        *standing,
        *_misfits(rows, ductile | ~rows.engaged, split),
    ]
    return LearnedMaterial(
        cutting=estimates[0],
        thrust=estimates[1],
        uncertainty=(standard[0], standard[1]),
        critical=critical,
        confidence=confidence,
        ductile=int(np.count_nonzero(ductile)),
        brittle=brittle,
        thickest=float(cuts.thickness.max()),
        remaining=None if split is None else split.remaining,
        chance=1.0 if split is None else split.chance,
        sentences=tuple(sentences),
        fit=_fitted(rows, split),
        exponents=None if rows.power is None else rows.exponents(ductile | ~rows.engaged, confidence),
        reference_thickness=None if rows.power is None else rows.reference,
    )


def _parts(rows: _Rows, confidence: float) -> tuple[_Split | None, Bools]:
    """Return the transition, and which rows are ductile beyond doubt."""
    split = _selected(rows, _transition(rows, confidence), slope_change(rows, confidence))
    return split, rows.engaged & (rows.upper <= (np.inf if split is None else split.low))


class _Rows:
    """The rows as a regression takes them: forces, columns, and what is common to all parts."""

    def __init__(self, cuts: Cuts, drift: int | None, *, edge: bool, falling: bool) -> None:
        if edge and falling:
            raise InputError(
                "edge_force and size_effect are both asked for, the limit is 1: forces do not tell them apart"
            )
        area = cuts.thickness * cuts.width if cuts.area is None else cuts.area
        require_plausible(cuts.thickness, {"cutting force": cuts.cutting, "thrust": cuts.thrust}, area)
        self.thickness = cuts.thickness
        self.engaged: Bools = cuts.thickness > 0
        spread = np.zeros_like(cuts.thickness) if cuts.spread is None else cuts.spread
        self.lower, self.upper = cuts.thickness - spread, cuts.thickness + spread
        self.areas = (area, area if cuts.thrust_area is None else cuts.thrust_area)
        self.forces = (cuts.cutting, cuts.thrust)
        self.in_time = cuts.time is not None
        n = cuts.thickness.size
        record = np.zeros(n) if cuts.record is None else cuts.record
        self.order = np.arange(n) if cuts.time is None else np.lexsort((cuts.time, record))
        self.nuisance = np.zeros((n, 0)) if drift is None else drifts(cuts.time, record, ~self.engaged, drift)
        self.edge = edge
        self.power: list[float] | None = [0.0, 0.0] if falling else None
        self.stated = cuts.uncertainty is not None
        weight = 1 / cuts.uncertainty if cuts.uncertainty is not None else np.ones((n, COMPONENTS))
        self.weights = (weight[:, 0], weight[:, 1])

    @property
    def reference(self) -> float:
        """Thickness at which a power of it is 1. [mm]."""
        return float(np.exp(np.log(self.thickness[self.engaged]).mean()))

    def ductile_columns(self, component: int, limit: float = np.inf) -> Floats:
        """Return what multiplies the coefficient, and the edge's own force or the bend by a power. (n, 1 or 2).

        Beyond a limit [mm] they stay, per width, what they are there.
        """
        area, thickness = self.areas[component], self.thickness
        if limit < np.inf:
            thickness = np.minimum(thickness, limit)
            area = self.per_thickness(component) * thickness
        if self.power is not None:
            ratio = np.where(self.engaged, thickness / self.reference, 1.0)
            falls = area * ratio ** -self.power[component]
            return np.column_stack((falls, -falls * np.log(ratio)))
        if not self.edge:
            return area[:, None]
        return np.column_stack((area, self.per_thickness(component)))

    def line(self, component: int, answer: Floats, at: float) -> float:
        """Return the force per width of the ductile part at some thickness."""
        if self.power is not None:
            ratio = at / self.reference
            return float(at * ratio ** -self.power[component] * (answer[0] - answer[1] * np.log(ratio)))
        return float(answer[0] * at + (answer[1] if self.edge else 0.0))

    def bend(self, rows: Bools) -> float:
        """Take one step of Newton towards the powers that fit, and return how far it went."""
        assert self.power is not None  # noqa: S101 - asked for with a size effect only
        steps = []
        for component in range(COMPONENTS):
            columns = self.ductile_columns(component)
            value = self.first(component, columns, rows, 0.9)[0]
            steps.append(self.first(component, columns[:, ::-1], rows, 0.9)[0] / value)
        self.power = [float(np.clip(old + step, -2, 2)) for old, step in zip(self.power, steps, strict=True)]
        return max(abs(step) for step in steps)

    def exponents(self, rows: Bools, confidence: float) -> tuple[Estimate, Estimate]:
        """Return the powers and their intervals."""
        assert self.power is not None  # noqa: S101 - asked for with a size effect only
        found = []
        for component in range(COMPONENTS):
            columns = self.ductile_columns(component)
            value = self.first(component, columns, rows, confidence)[0]
            half = self.first(component, columns[:, ::-1], rows, confidence)[2] / abs(value)
            power = self.power[component]
            found.append(Estimate(value=power, low=power - half, high=power + half))
        return found[0], found[1]

    def brittle_columns(self, component: int) -> Floats:
        """Return a constant force per width, and one that grows with the thickness. (n, 2)."""
        return np.column_stack((self.per_thickness(component), self.areas[component]))

    def per_thickness(self, component: int) -> Floats:
        """Return the width that takes part in a force: the area over the thickness, 0 in air. (n,) [mm]."""
        return np.divide(self.areas[component], self.thickness, out=np.zeros_like(self.thickness), where=self.engaged)

    def tau(self, residual: Floats, rows: Bools) -> float:
        """Return how many rows in time say as much as one."""
        if not self.in_time:
            return 1.0
        inside = self.order[rows[self.order]]
        return correlation_time(residual[inside]) if inside.size > 16 else 1.0

    def slope(self, component: int, rows: Bools, confidence: float) -> tuple[float, float, float]:
        """Return the coefficient, its standard uncertainty and half its interval, from some rows."""
        return self.first(component, self.ductile_columns(component), rows, confidence)

    def scatter(self, rows: Bools) -> float:
        """Return how many times as much the cutting force scatters in the cut as in air; 0 where that is not known."""
        table = np.column_stack((self.ductile_columns(0), self.nuisance))[rows]
        force, cut = self.forces[0][rows], self.engaged[rows]
        if min(np.count_nonzero(cut), np.count_nonzero(~cut)) < FEWEST or not self.in_time:
            return 0.0
        left = force - table @ np.linalg.lstsq(table, force, rcond=None)[0]
        return float(left[cut].std() / max(left[~cut].std(), np.finfo(np.float64).tiny))

    def weakest(self, split: _Split | None) -> tuple[float, float]:
        """Return the smallest cutting force that the fit has in a cut, and the scatter in air. [N]."""
        fit, air = _fitted(self, split), ~self.engaged
        drift = self.nuisance[air]
        left = self.forces[0][air]
        left = left - (drift @ np.linalg.lstsq(drift, left, rcond=None)[0] if drift.size else left.mean())
        return float(fit.fitted[:, 0].min()), float(left.std())

    def offset(self, component: int, rows: Bools, confidence: float) -> tuple[float, float, float]:
        """Return by how much too thick the stated chips would be, were that all that keeps forces from proportion.

        The value [mm], its standard uncertainty and half its interval.
        """
        columns = np.column_stack((self.per_thickness(component), self.areas[component]))
        edge, sigma, half = self.first(component, columns, rows, confidence)
        slope = self.first(component, columns[:, ::-1], rows, confidence)[0]
        return -edge / slope, abs(sigma / slope), abs(half / slope)

    def first(self, component: int, columns: Floats, rows: Bools, confidence: float) -> tuple[float, float, float]:
        """Return what the first of some columns is multiplied by, its standard uncertainty and half its interval."""
        from scipy.stats import t  # noqa: PLC0415 - costly to import

        weight = self.weights[component][rows]
        table = np.column_stack((columns, self.nuisance))[rows] * weight[:, None]
        force = self.forces[component][rows] * weight
        size = np.linalg.norm(table, axis=0)
        if table.shape[0] <= table.shape[1] or not (size > 0).all():
            raise InputError(
                f"{table.shape[0]} rows are ductile beyond doubt, the coefficient needs more than {table.shape[1]}: "
                "measure more thin chips"
            )
        table = table / size
        if np.linalg.cond(table) > 1e8:
            raise InputError(
                "the ductile cuts do not tell the coefficient from edge force and drift: vary thickness, or drop these"
            )
        answer = np.linalg.lstsq(table, force, rcond=None)[0]
        full = np.zeros(rows.size)
        full[rows] = left = force - table @ answer
        tau = max(self.tau(full, rows & self.engaged), self.tau(full, rows & ~self.engaged))
        free = max(table.shape[0] / tau - table.shape[1], 1.0)
        inverse = np.linalg.inv(table.T @ table)
        if self.in_time and table.shape[0] > 50:  # noise in the cut and in air differ, so each row brings its own
            leverage = np.einsum("ij,jk,ik->i", table, inverse, table)
            own = (left / (1 - np.minimum(leverage, 0.9))) ** 2
            cover = tau * inverse @ (table.T @ (own[:, None] * table)) @ inverse
        else:
            scale = float(left @ left) / free * tau
            # Stated uncertainties are not made smaller by a lucky fit.
            cover = (max(scale, 1.0) if self.stated else scale) * inverse
        sigma = float(np.sqrt(cover[0, 0])) / size[0]
        return float(answer[0] / size[0]), sigma, float(t.ppf(0.5 + confidence / 2, free)) * sigma


def require_plausible(thickness: Floats, forces: Mapping[str, Floats], area: Floats | None = None) -> None:
    """Raise for chips that are no diamond's, and for channels that measured nothing or are saturated."""
    thickest = float(thickness.max(initial=0.0))
    if thickest > THICKEST:
        raise InputError(
            f"the thickest chip is {thickest:g} mm, the limit is {THICKEST:g} mm: state thicknesses in mm, of which 1 "
            "um is 0.001"
        )
    engaged = thickness > 0
    if np.count_nonzero(engaged) < FEWEST:
        raise InputError(f"{np.count_nonzero(engaged)} rows are cuts, at least {FEWEST} are needed: measure more")
    for name, force in forces.items():
        if not force[engaged].any():
            raise InputError(f"the {name} of all cuts is 0 N, it must be measured: check its channel")
    order = np.flatnonzero(engaged)
    order = order[np.argsort(thickness[order], kind="stable")]
    for name, force in forces.items():
        clipped = saturated(force[order])
        solid = clipped.size >= SOLID * (np.ptp(clipped) + 1 if clipped.size else 1)
        # Without noise all forces may be constant beyond a transition; a range ends for one of them.
        others = [other[order[clipped]] for other in forces.values()]
        if not solid or (len(forces) > 1 and not any(np.ptp(other) for other in others)):
            clipped = rail((thickness if area is None else area)[order], force[order])
        if not clipped.size:
            continue
        at = order[clipped]
        largest = force[at[np.argmax(np.abs(force[at]))]]
        raise InputError(
            f"the {name} is saturated: it stands at {largest:.6g} N in {at.size} of {order.size} cuts, of chips from "
            f"{thickness[at].min() * 1e6:.4g} to {thickness[at].max() * 1e6:.4g} nm, closer together than its noise: "
            "record with a larger range, or leave these cuts out"
        )


def require_material(name: str, value: float, high: float) -> None:
    """Raise for a coefficient of cutting force or thrust that no material has."""
    if not value > 0 and (name == "cutting" or high < 0):
        raise InputError(
            f"the {name} coefficient comes out as {value:.4g} N/mm^2, it must be above 0: check the signs of both "
            "channels"
        )
    if abs(value) > HARDEST or (name == "cutting" and value < SOFTEST):
        raise InputError(
            f"the {name} coefficient comes out as {value:.4g} N/mm^2, materials have {SOFTEST:g} to {HARDEST:.0e}: "
            "state forces in N, and thickness and width of the chip in mm"
        )


def drifts(time: Floats | None, record: Floats, air: Bools, degree: int) -> Floats:
    """Return the columns of a drift of each record. (n, records times (degree + 1))."""
    if time is None:
        raise InputError("cuts without times have a drift to be found: give their times, or no drift")
    degree = whole_number(degree, "the degree of the drift", 0, HIGHEST_DRIFT)
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


@dataclass(frozen=True, slots=True)
class _Split:
    """A transition: where, within which limits, and what is left of the forces."""

    value: float
    low: float
    high: float
    remaining: tuple[float, float]
    chance: float


@dataclass(frozen=True, slots=True)
class _Drop:
    """The best split with a drop, and what it leaves of each component, with weights and long-run variance."""

    split: _Split
    squares: Floats
    weight: Floats
    noise: float


def _transition(rows: _Rows, confidence: float) -> _Drop | None:
    """Find the thickness at which the forces leave the ductile line with a jump, and all those that could be it."""
    engaged = np.flatnonzero(rows.engaged)
    order = engaged[np.argsort(rows.thickness[engaged], kind="stable")]
    ascending = rows.thickness[order]
    # Number of rows on the thin side; rows of one thickness stay together.
    after = np.flatnonzero(np.diff(ascending) > 0) + 1
    after = after[(after >= FEWEST) & (after <= ascending.size - FEWEST)]
    if not after.size:
        return None
    sums = [_left(rows, component, order, after) for component in range(COMPONENTS)]
    n = rows.thickness.size
    free = max(n - rows.nuisance.shape[1] - 3, 1)
    scale = [max(float(many.min()) / free, np.finfo(np.float64).tiny) for many, _ in sums]
    fits = _sides(rows, order, after, int(np.argmin(sum(many / s for (many, _), s in zip(sums, scale, strict=True)))))
    # The two components weigh as the noise of the ductile side tells.
    weight = 1 / np.diag(fits[0])
    joint = np.asarray(sum(w * many for w, (many, _) in zip(weight, sums, strict=True)))
    best = int(np.argmin(joint))
    thin, thick, gone, residuals = _sides(rows, order, after, best)
    jump = max(float(weight @ gone**2), np.finfo(np.float64).tiny)
    eta = [float((weight * gone) @ side @ (weight * gone) / jump) for side in (thin, thick)]
    limit = -2 * np.log(1 - np.sqrt(confidence))
    # A split below the best one would make ductile what is brittle, and is judged by the noise of the brittle side.
    allowed = (joint - joint[best]) <= limit * np.where(np.arange(joint.size) < best, eta[1], eta[0])
    inside = after[allowed]
    low, high = ascending[inside.min() - 1], ascending[inside.max()]
    spread = rows.upper - rows.thickness
    chance = chance_of(rows, [whole for _, whole in sums], residuals, order[: int(after[best])])
    at = 0.5 * (ascending[after[best] - 1] + ascending[after[best]])
    remaining = tuple(_remaining(rows, component, order, int(after[best]), float(at)) for component in (0, 1))
    split = _Split(
        value=float(at),
        low=max(float(low - spread[order[inside.min() - 1]]), 0.0),
        high=float(high + spread[order[inside.max()]]),
        remaining=(remaining[0], remaining[1]),
        chance=chance,
    )
    return _Drop(split, np.array([many[best] for many, _ in sums]), weight, max(eta))


def _selected(rows: _Rows, drop: _Drop | None, bend: SlopeChange | None) -> _Split | None:
    """Return the transition that the forces ask for: none, a drop, or a change of slope.

    A change of slope is the simpler one. A drop is taken where it explains more than chance would; where it may, the
    interval holds both. Neither is taken where an edge force or a size effect explains as much.
    """
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    n = rows.thickness.size
    free = max(n - rows.nuisance.shape[1] - 3, 1)

    def probability(squares: Floats, numbers: int) -> float:
        """Return how often noise alone lets a drop, with so many more numbers, explain so much more."""
        assert drop is not None  # noqa: S101 - asked of a drop only
        # The noise is that of the richer model: what a drop leaves of two lines that meet would count as noise.
        return float(f.sf(float(drop.weight @ (squares - drop.squares)) / drop.noise / numbers, numbers, free))

    for one in (bend, None if drop is None else drop.split):
        if one is not None and one.chance <= CERTAIN:
            _standing(rows, one.value)
    split = None if drop is None or drop.split.chance > CERTAIN or drop.split.remaining[0] >= 1 else drop.split
    if bend is None:
        return split
    if split is not None and n * probability(bend.smooth, COMPONENTS) > CERTAIN:
        split = None
    # What could as well begin at no thickness at all is no change of slope.
    if bend.chance > CERTAIN or bend.straight or not bend.falls or bend.low == 0:
        return split
    bent = _Split(bend.value, bend.low, bend.high, (1.0, 1.0), bend.chance)
    if drop is None:
        return bent
    chance = probability(bend.squares, COMPONENTS + 1)
    if n * chance < CERTAIN:
        return split
    if split is not None and chance < CERTAIN:
        return replace(bent, low=min(bent.low, split.low), high=max(bent.high, split.high))
    return bent


def _design(rows: _Rows, component: int, order: np.ndarray) -> tuple[Floats, Floats, Floats, Floats]:
    """Return nuisance, ductile and brittle columns and the forces, engaged rows in order, scaled alike."""
    every = np.concatenate((order, np.flatnonzero(~rows.engaged)))
    weight = rows.weights[component][every][:, None]
    tables = [rows.nuisance, rows.ductile_columns(component), rows.brittle_columns(component)]
    scaled = [one[every] * weight for one in tables]
    scaled = [one / np.maximum(np.linalg.norm(one, axis=0), np.finfo(np.float64).tiny) for one in scaled]
    return scaled[0], scaled[1], scaled[2], rows.forces[component][every] * weight[:, 0]


def _left(rows: _Rows, component: int, order: np.ndarray, after: np.ndarray) -> tuple[Floats, float]:
    """Return the squares left by each split, (k,), and by no split at all, from sums that are added up once."""
    steady, ductile, brittle, force = _design(rows, component, order)
    count, d, b, s = order.size, ductile.shape[1], brittle.shape[1], steady.shape[1]
    size = s + d + b
    table = np.zeros((after.size, size, size))
    right = np.zeros((after.size, size))

    def upto(one: Floats, other: Floats) -> Floats:
        products = one[:count, :, None] * other[:count, None, :]
        return np.concatenate((np.zeros((1, *products.shape[1:])), np.cumsum(products, axis=0)))

    table[:, :s, :s] = steady.T @ steady
    right[:, :s] = steady.T @ force
    column = force[:, None]
    for place, part, thin in ((slice(s, s + d), ductile, True), (slice(s + d, size), brittle, False)):
        for other, where in ((part, place), (steady, slice(0, s)), (column, None)):
            sums = upto(part, other)
            share = sums[after] if thin else sums[-1] - sums[after]
            if where is None:
                right[:, place] = share[:, :, 0]
            else:
                table[:, place, where] = share
                table[:, where, place] = share.transpose(0, 2, 1)
    # Both columns of the brittle side are one where all its chips are as thick; a touch of the diagonal decides.
    table += 1e-11 * np.trace(table, axis1=1, axis2=2)[:, None, None] / size * np.eye(size)
    answer = np.linalg.solve(table, right[:, :, None])[:, :, 0]
    total = float(force @ force)
    many = np.maximum(total - np.einsum("ij,ij->i", answer, right), 1e-14 * total)
    whole = np.column_stack((steady, ductile))
    rest = force - whole @ np.linalg.lstsq(whole, force, rcond=None)[0]
    return many, float(rest @ rest)


def _sides(rows: _Rows, order: np.ndarray, after: np.ndarray, best: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the long-run covariances of the thin and the thick side at a split, the jump there and what is left.

    (2, 2), (2, 2), (2,) and (2, n).
    """
    cut = int(after[best])
    residuals, jumps = [], []
    for component in range(COMPONENTS):
        steady, ductile, brittle, force = _design(rows, component, order)
        thin = np.arange(force.size) < cut
        thick = ~thin & (np.arange(force.size) < order.size)
        table = np.column_stack((steady, ductile * thin[:, None], brittle * thick[:, None]))
        answer = np.linalg.lstsq(table, force, rcond=1e-10)[0]
        residual = np.zeros(force.size)
        residual[np.concatenate((order, np.flatnonzero(~rows.engaged)))] = force - table @ answer
        residuals.append(residual)
        s, d = steady.shape[1], ductile.shape[1]
        jumps.append(float(ductile[cut] @ answer[s : s + d] - brittle[cut] @ answer[s + d :]))
    left = np.array(residuals)
    covers = []
    for which in (order[:cut], order[cut:]):
        rows_in = np.zeros(rows.thickness.size, dtype=np.bool_)
        rows_in[which] = True
        tau = max(rows.tau(one, rows_in) for one in left)
        free = max(which.size - 1, 1)
        covers.append(tau * left[:, which] @ left[:, which].T / free)
    # Few rows on a side say little of its noise: then the larger of the two stands for both.
    fewest = min(cut, order.size - cut)
    if fewest < 2 * FEWEST:
        larger = max(covers, key=np.trace)
        covers = [larger, larger]
    floor = 1e-18 * np.array([one @ one / one.size for one in rows.forces])
    thin_cover, thick_cover = (one + np.diag(floor + np.finfo(np.float64).tiny) for one in covers)
    return np.asarray(thin_cover), np.asarray(thick_cover), np.array(jumps), left


def _remaining(rows: _Rows, component: int, order: np.ndarray, cut: int, at: float) -> float:
    """Return the force just beyond a split over what the ductile line has there."""
    steady = rows.nuisance
    thin, thick = (np.zeros(rows.thickness.size, dtype=np.bool_) for _ in range(2))
    thin[order[:cut]], thick[order[cut:]] = True, True
    ductile, brittle = rows.ductile_columns(component), rows.brittle_columns(component)
    table = np.column_stack((steady, ductile * thin[:, None], brittle * thick[:, None]))
    weight = rows.weights[component]
    size = np.maximum(np.linalg.norm(table * weight[:, None], axis=0), np.finfo(np.float64).tiny)
    answer = np.linalg.lstsq(table * weight[:, None] / size, rows.forces[component] * weight, rcond=1e-10)[0] / size
    s, d = steady.shape[1], ductile.shape[1]
    line = rows.line(component, answer[s : s + d], at)
    beyond = answer[s + d] + answer[s + d + 1] * at
    return float(beyond / line) if line else np.inf


def _fitted(rows: _Rows, split: _Split | None) -> ForceFit:
    """Return the forces of the cuts without drift, and what the ductile and the brittle part make of them."""
    limit = np.inf if split is None else split.value
    thin = rows.thickness <= limit
    measured, fitted = [], []
    for component in range(COMPONENTS):
        ductile = rows.ductile_columns(component) * thin[:, None]
        brittle = rows.brittle_columns(component) * ~thin[:, None]
        table = np.column_stack((ductile, brittle, rows.nuisance))
        weight = rows.weights[component]
        size = np.maximum(np.linalg.norm(table * weight[:, None], axis=0), np.finfo(np.float64).tiny)
        answer = np.linalg.lstsq(table * weight[:, None] / size, rows.forces[component] * weight, rcond=1e-10)[0] / size
        of_chip = ductile.shape[1] + brittle.shape[1]
        measured.append((rows.forces[component] - rows.nuisance @ answer[of_chip:])[rows.engaged])
        fitted.append((table[:, :of_chip] @ answer[:of_chip])[rows.engaged])
    return ForceFit(
        components=("cutting", "thrust"),
        thickness=rows.thickness[rows.engaged],
        measured=np.column_stack(measured),
        fitted=np.column_stack(fitted),
    )


def _misfits(rows: _Rows, ductile: Bools, split: _Split | None) -> list[str]:
    """Say if the ductile forces are not in proportion to the chips, which no interval accounts for."""
    said = []
    if rows.in_time and np.count_nonzero(~rows.engaged) >= FEWEST:
        said += too_weak(*rows.weakest(split))
    wild = rows.scatter(ductile)
    if wild > WILD:
        said.append(
            f"the forces in the cut scatter {wild:.3g} times as much as in air, more than {WILD:g} times: check that "
            "no air is counted as cut, and that the chips are as stated"
        )
    few = int(np.count_nonzero(ductile & rows.engaged))
    if split is not None and few <= FEWEST:
        said.append(
            f"only the {few} thinnest cuts are ductile beyond doubt, at least {FEWEST + 1} are needed to tell: if they "
            "are brittle too, coefficients and critical thickness are wrong, so measure thinner chips"
        )
    if rows.edge or rows.power is not None or np.unique(rows.thickness[ductile]).size < FEWEST:
        return said
    for component, name in enumerate(("cutting force", "thrust")):
        off, _, half = rows.offset(component, ductile, UNLIKELY)
        if abs(off) > max(half, EXACT * rows.thickness.max()):
            said.append(
                f"the {name} is not in proportion to the chip: it is as if the chips were {abs(off) * 1e6:.3g} nm "
                f"{'thinner' if off > 0 else 'thicker'} than stated, so the intervals do not hold: check where the cut "
                "begins and how thick it is there, or take a force of the edge or a size effect into account"
            )
    return said


def said_of(
    estimates: Mapping[str, Estimate],
    critical: float | None,
    remaining: Sequence[float],
    thickest: float,
    confidence: float,
) -> list[str]:
    """Say what was learned."""
    said = [
        f"the {name} coefficient is {one.value:.5g} N/mm^2, {confidence:.0%} interval {one.low:.5g} to "
        f"{one.high:.5g} N/mm^2"
        for name, one in estimates.items()
    ]
    if critical is None:
        said.append(
            f"the forces show no transition up to the thickest chip of {thickest * 1e6:.4g} nm: the critical thickness "
            "is beyond, or the cuts are too few or too noisy to tell"
        )
    else:
        force = {"cutting": "cutting force", "thrust": "thrust"}
        shares = [f"{share:.0%} of the {force[name]}" for name, share in zip(estimates, remaining, strict=True)]
        said.append(
            f"the critical thickness is {critical * 1e6:.4g} nm; beyond it the forces grow more slowly, without a drop"
            if all(share == 1 for share in remaining)
            else f"the critical thickness is {critical * 1e6:.4g} nm; beyond it {' and '.join(shares)} "
            f"{'remain' if len(shares) > 1 else 'remains'}"
        )
    return said


def _standing(rows: _Rows, limit: float) -> list[str]:
    """Say if both forces stand still at their largest beyond a limit; raise if one does and the other goes on.

    Fracture changes both; the end of a range is that of a channel.
    """
    names = ("cutting force", "thrust")
    level, clear, stands, goes = [], [], [], []
    thick = rows.thickness > limit
    for component in range(COMPONENTS):
        beyond = rows.per_thickness(component) * np.maximum(rows.thickness - limit, 0.0)
        line = rows.ductile_columns(component, limit)
        every = np.ones_like(rows.engaged)
        slope, sigma, _ = rows.first(component, np.column_stack((beyond, line)), every, UNLIKELY)
        whole = rows.first(component, np.column_stack((line, beyond)), every, UNLIKELY)[0]
        force = np.abs(rows.forces[component])
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
    for which, other in ((0, 1), (1, 0)):
        if all(clear) and stands[which] and goes[other]:
            raise InputError(
                f"the {names[which]} stands at its largest, {level[which]:.4g} N, from {limit * 1e6:.4g} nm on "
                f"and the {names[other]} goes on in proportion: fracture changes both, so the channel is saturated; "
                "record with a larger range, or leave these cuts out"
            )
    return []


def too_weak(weakest: float, scatter: float) -> list[str]:
    """Say if cuts may have been taken for air, since their forces do not stand out of the noise there."""
    if weakest >= CLEAR * scatter:
        return []
    said = (
        f"the weakest cuts press with {weakest * 1e3:.3g} mN and forces in air scatter by {scatter * 1e3:.3g} mN, so "
        f"that cuts below {CLEAR * scatter * 1e3:.3g} mN, {CLEAR:g} times that, may have been taken for air, and chips "
        "then be thicker than stated: do not rely on the intervals; leave the thinnest chips out, cut wider, filter "
        "more, or state when the cuts begin and end"
    )
    return [said]
