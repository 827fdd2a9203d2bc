r"""Coefficients and the chip a material bears, from cuts whose chip is not equally thick all along the edge.

Every element of an edge adds Kc dA along the cut and Kt dA along its normal. For constant coefficients each measured
component of the force is linear in both, with integrals of the chip's area and of the edge's directions that the
geometry alone decides. Beyond the critical thickness the elements leave that line, and only those beyond it do,

.. math::
    F = d(t) + K_c \int_{h \le h_c} e_c\,dA + K_t \int_{h \le h_c} e_t\,dA
      + \int_{h > h_c} \frac{(q_0 + q_1 h)\,e_c + (p_0 + p_1 h)\,e_t}{h}\,dA ,

so that every component of every cut is one equation of the same six numbers and :math:`h_c`. Of a nose that cuts beyond
:math:`h_c` a part is still below it: the forces change smoothly where the limit is crossed. The critical thickness is
then found as any parameter is, and its interval holds all :math:`h_c` for which

.. math:: \frac{S(h_c) - S(\hat h_c)}{\tau} \le F_{1,\nu}(p),

with the squares S in units of the noise of each component, within the ductile range and beyond it apart, and the
correlation time τ. Where the chip is equally thick along the edge the forces jump, and Hansen's limit holds instead, as
for straight edges. Coefficients come from rows that are ductile all along the edge at every limit in that interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from turnwright._arrays import Bools, Floats, frozen
from turnwright._validate import between
from turnwright.cutting.learning.edge_cuts import InterruptedCuts, NoseCuts
from turnwright.cutting.learning.edge_rows import Fit, InterruptedRows, Rows, TurningRows
from turnwright.cutting.learning.material_fit import (
    CERTAIN,
    EXACT,
    FEWEST,
    ROUNDS,
    SETTLED,
    UNLIKELY,
    WILD,
    Estimate,
    ForceFit,
    LearnedMaterial,
    require_material,
    require_plausible,
    said_of,
    too_weak,
)
from turnwright.errors import InputError

__all__ = ["learn_along_edge"]

NAMES = ("cutting", "thrust")

LABELS = {"axial": "axial force", "feed": "feed force", "cutting": "cutting force"}
"""What components of the force are called; those of a mill are named after their axes."""

LOOKED = 96
"""Thicknesses at which a transition is first looked for."""

HALVED = 12
"""Times that the interval between two of these is halved."""

MANY = 50
"""Rows in time from which on each brings its own noise."""


@dataclass(frozen=True, slots=True)
class _Transition:
    """A critical thickness that was found, and what remains beyond."""

    value: float
    low: float
    high: float
    chance: float
    remaining: tuple[float, ...]


def learn_along_edge(
    cuts: NoseCuts | InterruptedCuts,
    *,
    drift: int | None = None,
    edge_force: bool = False,
    size_effect: bool = False,
    calibration: Sequence[float] | None = None,
    area_uncertainty: float = 0.0,
    thickness_uncertainty: float = 0.0,
    confidence: float = 0.95,
) -> LearnedMaterial:
    """Learn coefficients and critical thickness from round noses, mills and fly-cutters.

    Parameters
    ----------
    cuts
        Forces and what was cut.
    drift
        Degree of the polynomial in time that the forces in air follow; ``None`` for forces without drift.
    edge_force
        Whether a force in proportion to the engaged edge alone is taken out of the coefficients.
    size_effect
        Whether the coefficients fall with a power of the chip thickness, :math:`K_0 (h/h_0)^{-m}`; :math:`h_0` is the
        geometric mean of all thicknesses, each counted by its area.
    calibration
        Standard uncertainty of each measured component, as a share: of the dynamometer. (components)
    area_uncertainty
        Standard uncertainty that is common to all areas of chips, such as that of the depth, as a share.
    thickness_uncertainty
        Standard uncertainty that is common to all thicknesses. [mm]
    confidence
        Of all intervals.

    Raises
    ------
    InputError
        If there are too few cuts to tell.

    Sources
    -------
    The force model of [Troutman2016]_; [Hansen2000]_ for a transition where forces jump. Oracles: forces by brute force
    from the shapes that the edge leaves, in a hundred random experiments; weighted least squares by SciPy.
    """
    between(confidence, "confidence", 0.5, 0.999, "")
    if edge_force and size_effect:
        raise InputError("edge_force and size_effect are both asked for, the limit is 1: forces do not tell them apart")
    rows = TurningRows(cuts, drift) if isinstance(cuts, NoseCuts) else InterruptedRows(cuts, drift)
    names = [LABELS.get(one, f"force along {one}") for one in cuts.components]
    require_plausible(rows.thickest, dict(zip(names, rows.force.T, strict=True)))
    shares = np.zeros(rows.force.shape[1]) if calibration is None else frozen(calibration, "calibration")
    if shares.size != rows.force.shape[1]:
        raise InputError(
            f"calibration has {shares.size} numbers and the cuts {rows.force.shape[1]} components: give one for each"
        )
    rows.synchronise(None, np.inf)
    told = _told(rows)
    rows.edge, rows.power = edge_force, [0.0, 0.0] if size_effect else None
    split, ductile = _settled(rows, told, confidence)
    fit = _Estimates(rows, ductile | ~rows.engaged, told, confidence, split)
    for name, value, half in zip(told, fit.value, fit.half, strict=True):
        require_material(name, float(value), float(value + half))
    from scipy.stats import norm  # noqa: PLC0415 - costly to import

    wide = float(norm.ppf(0.5 + confidence / 2))
    estimates: dict[str, Estimate] = {}
    standard: dict[str, float] = {}
    for name, value, sigma, half, by in zip(told, fit.value, fit.sigma, fit.half, fit.by_component, strict=True):
        common = float(
            np.hypot(np.linalg.norm(shares * by), between(area_uncertainty, "area_uncertainty", 0, 1, "") * value)
        )
        reach = float(np.hypot(half, wide * common))
        estimates[name] = Estimate(value=float(value), low=float(value) - reach, high=float(value) + reach)
        standard[name] = float(np.hypot(sigma, common))
    critical = None
    if split is not None:
        more = wide * between(thickness_uncertainty, "thickness_uncertainty", 0.0, np.inf, "mm")
        critical = Estimate(value=split.value, low=max(split.low - more, 0.0), high=split.high + more)
    thickest = float(rows.thickest.max())
    sentences = said_of(
        estimates,
        None if split is None else split.value,
        () if split is None else split.remaining,
        thickest,
        confidence,
    )
    shown = _shown(rows, cuts.components, np.inf if split is None else split.value)
    powers = None
    if rows.power is not None:
        found = dict(zip(told, fit.powers, strict=True))
        powers = (found.get("cutting"), found.get("thrust"))
    return LearnedMaterial(
        cutting=estimates.get("cutting"),
        thrust=estimates.get("thrust"),
        uncertainty=(standard.get("cutting"), standard.get("thrust")),
        critical=critical,
        confidence=confidence,
        ductile=int(np.count_nonzero(ductile)),
        brittle=0 if split is None else int(np.count_nonzero(rows.thickest > split.high)),
        thickest=thickest,
        remaining=None if split is None else split.remaining,
        chance=1.0 if split is None else split.chance,
        sentences=(*sentences, *_misfits(rows, ductile, told, shown)),
        fit=shown,
        exponents=powers,
        reference_thickness=rows.reference if size_effect else None,
    )


def _told(rows: Rows) -> tuple[str, ...]:
    """Return which coefficients the measured components tell of."""
    size = np.abs(rows.columns(np.inf)).max(axis=(0, 1))
    return tuple(name for name, one in zip(NAMES, size, strict=True) if one > 1e-9 * size.max())


def _settled(rows: Rows, told: tuple[str, ...], confidence: float) -> tuple[_Transition | None, Bools]:
    """Return the transition and which rows are ductile, when powers and the place of the cutter no longer change."""
    split: _Transition | None = None
    ductile = rows.engaged.copy()
    everything = np.ones(rows.engaged.size, dtype=np.bool_)
    for _ in range(3):
        rows.synchronise(Fit(rows, everything).solve(rows.columns(np.inf))[0], np.inf)
    for turn in range(ROUNDS):
        split = _transition(rows, told, confidence)
        limit = np.inf if split is None else split.value
        ductile = rows.engaged & (rows.thickest <= (np.inf if split is None else split.low))
        rows.synchronise(Fit(rows, everything).solve(rows.columns(limit))[0], limit)
        if rows.power is None:
            if turn or not isinstance(rows, InterruptedRows):
                break
            continue
        answer = Fit(rows, ductile | ~rows.engaged).solve(rows.columns(np.inf))[0]
        steps = [answer[2 * k + 1] / answer[2 * k] if name in told else 0.0 for k, name in enumerate(NAMES)]
        rows.power = [float(np.clip(old + step, -2, 2)) for old, step in zip(rows.power, steps, strict=True)]
        if max(abs(step) for step in steps) < SETTLED:
            break
    return split, ductile


def _designed(
    rows: Rows, used: Bools, told: tuple[str, ...], split: _Transition | None
) -> tuple[Fit, Bools, Floats, int]:
    """Return the fit of the coefficients, its rows and columns, and how many of these do not place the cutter."""
    beyond = split is not None and isinstance(rows, InterruptedRows) and not rows.cuts.whole_turns
    limit = split.value if split is not None and beyond else np.inf
    used = used | beyond
    every = rows.columns(limit)
    place = [rows.parts * NAMES.index(name) + k for name in told for k in range(rows.parts)]
    if beyond:
        place += [2 * rows.parts + 2 * NAMES.index(name) + k for name in told for k in (0, 1)]
    columns = every[:, :, place]
    count = int(np.count_nonzero(used & rows.engaged)) * columns.shape[1]
    if count <= columns.shape[2]:
        raise InputError(
            f"{count} forces are of chips that are ductile beyond doubt, {columns.shape[2]} numbers need more: "
            "measure more thin chips, or take a force of the edge or a size effect into account"
        )
    fit = Fit(rows, used)
    answer = fit.solve(columns)[0]
    whole = np.zeros(every.shape[2])
    whole[place] = answer
    columns = np.concatenate((columns, rows.unknown(whole, limit)), axis=2)
    if split is not None and beyond:
        # Where the cutter stands is told best by when the limit is crossed, so that all rows take part; how the
        # forces depend on the limit is one more unknown.
        step = max((split.high - split.low) / 4, 1e-4 * limit)
        slope = (rows.columns(limit + step) - rows.columns(limit - step))[:, :, place] @ answer
        columns = np.concatenate((columns, slope[:, :, None]), axis=2)
    return fit, used, columns, len(place)


class _Estimates:
    """The coefficients from some rows, with what they are uncertain by."""

    def __init__(
        self, rows: Rows, used: Bools, told: tuple[str, ...], confidence: float, split: _Transition | None = None
    ) -> None:
        from scipy.stats import t  # noqa: PLC0415 - costly to import

        fit, used, columns, told_columns = _designed(rows, used, told, split)
        answer, squares, left, table = fit.solve(columns)
        place = range(told_columns)
        first = np.arange(0, rows.parts * len(told), rows.parts)
        size = np.sqrt((table**2).sum(axis=(0, 1)))
        # What says nothing here, such as the speed of a pass without ductile rows, is left out.
        kept = size > 1e-12 * size.max() if columns.shape[2] > len(place) else size > 0
        kept[: len(place)] = size[: len(place)] > 0
        scaled = table[:, :, kept] / size[kept]
        flat = scaled.reshape(-1, scaled.shape[2])
        if not kept[: len(place)].all() or np.linalg.cond(flat) > 1e8:
            raise InputError(
                "the ductile cuts do not tell the coefficients from each other, edge force and drift: vary depth or "
                "feed, measure one more component, or drop these"
            )
        inverse = np.linalg.inv(flat.T @ flat)
        residual = np.zeros(rows.force.shape)
        residual[used] = left
        tau = max(rows.noise(residual, used & rows.engaged), rows.noise(residual, used & ~rows.engaged))
        size = size[kept]
        told_by = flat.shape[1]
        total = sum(basis.shape[1] for basis in fit.drift)
        free = max(flat.shape[0] / tau - told_by - total, 1.0)
        share = np.stack([inverse @ (one.T @ one) @ inverse for one in scaled.transpose(1, 0, 2)])
        if rows.in_time and np.count_nonzero(used) > MANY:
            # Components of one row may hang together, so each row brings its noise as a whole.
            each = np.einsum("rcp,rc->rp", scaled, left)
            rows_left = each.shape[0]
            cover = tau * rows_left / max(rows_left - told_by - total, 1) * inverse @ (each.T @ each) @ inverse
        else:
            scale = squares / free * tau
            cover = (max(scale, 1.0) if rows.stated else scale) * inverse
        spread = np.sqrt(np.diag(cover))[: len(place)] / size[: len(place)]
        # Few rows know the noise of each component only so well (Welch and Satterthwaite).
        parts = np.stack([np.diag(one)[: len(place)] for one in share])
        ratio = parts / parts.sum(axis=0)
        each_free = np.maximum(np.count_nonzero(used) / tau - total / left.shape[1] - told_by * ratio, 1.0)
        freedom = np.full(len(place), free) if rows.stated else 1 / (ratio**2 / each_free).sum(axis=0)
        half = t.ppf(0.5 + confidence / 2, freedom) * spread
        self.value, self.sigma, self.half = answer[first], spread[first], half[first]
        by = [inverse @ one.T @ fit.free_force[:, c] for c, one in enumerate(scaled.transpose(1, 0, 2))]
        self.by_component = (np.stack(by, axis=1) / size[:, None])[first]
        self.second = [(answer[k + 1], half[k + 1]) for k in first] if rows.parts > 1 else []
        self.powers: list[Estimate] = []
        if rows.power is not None:
            for name, value, (_, reach) in zip(told, self.value, self.second, strict=True):
                power, wide = rows.power[NAMES.index(name)], reach / abs(value)
                self.powers.append(Estimate(value=power, low=power - wide, high=power + wide))


def _weigh(rows: Rows, limit: float) -> float:
    """Weigh each component by its noise, within the ductile range and beyond apart; return the correlation time."""
    before = rows.weights
    if not rows.stated:
        rows.weights = np.ones_like(before)
        for _ in range(2):
            left = Fit(rows, np.ones(rows.engaged.size, dtype=np.bool_)).solve(rows.columns(limit))[2] / rows.weights
            thick = rows.engaged & (rows.thickest > limit)
            groups = (
                [thick, ~thick]
                if min(np.count_nonzero(thick), np.count_nonzero(~thick)) > 2 * FEWEST
                else [np.ones(thick.size, dtype=np.bool_)]
            )
            weights = np.empty_like(before)
            floor = 1e-9 * np.abs(rows.force).max(axis=0) + np.finfo(np.float64).tiny
            for group in groups:
                weights[group] = 1 / np.maximum(np.sqrt((left[group] ** 2).mean(axis=0)), floor)
            rows.weights = weights
    left = np.zeros(rows.force.shape)
    left[:] = Fit(rows, np.ones(rows.engaged.size, dtype=np.bool_)).solve(rows.columns(limit))[2]
    thick = rows.engaged & (rows.thickest > limit)
    return max(rows.noise(left, one) for one in (thick, rows.engaged & ~thick, ~rows.engaged))


def _transition(rows: Rows, told: tuple[str, ...], confidence: float) -> _Transition | None:
    """Find the thickness beyond which elements of the edge leave the ductile line, and all that could be it."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - costly to import
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    every = np.ones(rows.engaged.size, dtype=np.bool_)
    low, high = max(ascending[FEWEST - 1], ascending[-1] / 50), ascending[-FEWEST]
    _weigh(rows, np.inf)
    if not low < high * (1 - 1e-6) or ascending.size < 2 * FEWEST:
        return None
    fit = Fit(rows, every)  # as the rows are weighed now
    grid = np.geomspace(low, high * (1 - 1e-9), LOOKED)

    def squares(limit: float) -> float:
        columns = rows.columns(limit)
        answer, least = fit.solve(columns)[:2]
        beside = rows.unknown(answer, limit)
        return fit.solve(np.concatenate((columns, beside), axis=2))[1] if beside.shape[2] else least

    rough = grid[::3]
    best = float(rough[int(np.argmin([squares(float(one)) for one in rough]))])
    tau = _weigh(rows, best)
    fit = Fit(rows, every)
    profile = np.array([squares(float(one)) for one in grid])
    at = int(np.argmin(profile))
    around = (float(grid[max(at - 1, 0)]), float(grid[min(at + 1, grid.size - 1)]))
    finer = minimize_scalar(squares, bounds=around, method="bounded", options={"xatol": 1e-4 * float(grid[at])})
    best, least = (
        (float(finer.x), float(finer.fun)) if finer.fun < profile[at] else (float(grid[at]), float(profile[at]))
    )
    number, size = rows.force.shape[0] * rows.force.shape[1], rows.columns(best).shape[2]
    free = max(number / tau - size - rows.drift.shape[1] * rows.force.shape[1], 1.0)
    # Weights were made from what is left, so that a square counts as number over what is free.
    eta = max(tau * max(least / max(number - size, 1), 1.0 if rows.stated else 0.0), tau * _told_by(rows, best))
    limit = -2 * np.log(1 - np.sqrt(confidence)) if rows.even else float(f.ppf(confidence, 1, free))
    allowed = np.flatnonzero(profile - least <= limit * eta)
    first, last = (int(allowed.min()), int(allowed.max())) if allowed.size else (at, at)
    ends = []
    for inner, outer in ((first, first - 1), (last, last + 1)):
        if not 0 <= outer < grid.size:
            ends.append(0.0 if outer < 0 else float(ascending[-1]))
            continue
        inside, outside = (float(grid[inner]) if allowed.size else best), float(grid[outer])
        for _ in range(HALVED):
            middle = (inside + outside) / 2
            if squares(middle) - least <= limit * eta:
                inside = middle
            else:
                outside = middle
        ends.append(outside)
    gain = squares(np.inf) - least
    more = 2 * len(told)
    chance = float(min(1.0, rows.engaged.sum() * f.sf(gain / eta / more, more, free)))
    answer = fit.solve(rows.columns(best))[0]
    remaining = tuple(_remaining(rows, answer, NAMES.index(name), best) for name in told)
    # What could as well begin at no thickness at all is no transition: forces are out of proportion everywhere.
    thickest = _remaining(rows, answer, NAMES.index(told[0]), float(ascending[-1]))
    if chance > CERTAIN or thickest >= 1 or ends[0] == 0:
        return None
    return _Transition(best, min(ends[0], best), max(ends[1], best), chance, remaining)


def _told_by(rows: Rows, limit: float) -> float:
    """Return the noise of what tells the limit over that of independent components; those of a row may hang together.

    What fracture does to one component it does to all.
    """
    fit = Fit(rows, np.ones(rows.engaged.size, dtype=np.bool_))
    columns = rows.columns(limit)
    answer, _, left, table = fit.solve(columns)
    step = 0.01 * limit
    slope = ((rows.columns(limit + step) - rows.columns(limit - step)) @ answer * fit.weight)[:, :, None]
    flat, target = table.reshape(-1, table.shape[2]), fit.without_drift(slope)[:, :, 0].reshape(-1)
    size = np.maximum(np.linalg.norm(flat, axis=0), np.finfo(np.float64).tiny)
    rest = target - flat / size @ np.linalg.lstsq(flat / size, target, rcond=1e-10)[0]
    whole = float(rest @ rest)
    return float(((rest.reshape(left.shape) * left).sum(axis=1) ** 2).sum() / whole) if whole else 0.0


def _remaining(rows: Rows, answer: Floats, which: int, at: float) -> float:
    """Return the force per width of a chip beyond the limit over what the ductile line has there."""
    thin = answer[rows.parts * which : rows.parts * (which + 1)]
    thick = answer[2 * rows.parts + 2 * which :][:2]
    line = thin[0] * at
    if rows.power is not None:
        ratio = at / rows.reference
        line = at * ratio ** -rows.power[which] * (thin[0] - thin[1] * np.log(ratio))
    elif rows.edge:
        line = line + thin[1]
    return float((thick[0] + thick[1] * at) / line) if line else np.inf


def _shown(rows: Rows, components: tuple[str, ...], limit: float) -> ForceFit:
    """Return the forces of the cuts without drift, and what was learned makes of them."""
    columns = rows.columns(limit)
    answer = Fit(rows, np.ones(rows.engaged.size, dtype=np.bool_)).solve(columns)[0]
    fitted = columns @ answer
    measured = rows.force.copy()
    if rows.drift.size:
        for component in range(measured.shape[1]):
            weight = rows.weights[:, component]
            rest = (measured - fitted)[:, component] * weight
            found = np.linalg.lstsq(rows.drift * weight[:, None], rest, rcond=None)[0]
            measured[:, component] -= rows.drift @ found
    cut = rows.engaged
    return ForceFit(components=components, thickness=rows.thickest[cut], measured=measured[cut], fitted=fitted[cut])


def _misfits(rows: Rows, ductile: Bools, told: tuple[str, ...], shown: ForceFit) -> list[str]:
    """Say what no interval accounts for."""
    said = []
    used = ductile | ~rows.engaged
    if rows.in_time and min(np.count_nonzero(~rows.engaged), np.count_nonzero(ductile)) >= FEWEST:
        left = Fit(rows, used).solve(rows.columns(np.inf))[2] / rows.weights[used]
        cut = rows.engaged[used]
        air = left[~cut].std(axis=0)
        wild = float((left[cut].std(axis=0) / np.maximum(air, np.finfo(np.float64).tiny)).max())
        if wild > WILD:
            said.append(
                f"the forces in the cut scatter {wild:.3g} times as much as in air, more than {WILD:g} times: check "
                "that no air is counted as cut, and that geometry and feeds are as stated"
            )
        if isinstance(rows, TurningRows):
            clear = int(np.argmax(np.abs(shown.fitted).max(axis=0) / np.maximum(air, np.finfo(np.float64).tiny)))
            said += too_weak(float(np.abs(shown.fitted[:, clear]).min()), float(air[clear]))
    if rows.edge or rows.power is not None or np.unique(rows.thickest[ductile]).size < FEWEST:
        return said
    rows.edge = True
    try:
        fit = _Estimates(rows, used, told, UNLIKELY)
    except InputError:
        return said  # cuts too alike to tell an edge force
    finally:
        rows.edge = False
    for name, value, (edge, half) in zip(told, fit.value, fit.second, strict=True):
        if abs(edge) > max(half, EXACT * abs(value) * rows.thickest.max()):
            force = {"cutting": "cutting force", "thrust": "thrust"}[name]
            said.append(
                f"the {force} is not in proportion to the chip: it is as if chips were {abs(edge / value) * 1e6:.3g} "
                f"nm {'thicker' if edge > 0 else 'thinner'} than stated, so the intervals do not hold: check feed, "
                "depth and nose, or take a force of the edge or a size effect into account"
            )
    return said
