"""From measured forces to the coefficients of a material and the chip it bears, each with its interval.

Coefficients, drift and forces beyond the critical thickness are found in one regression, whatever was cut; see
`straight` for chips of one thickness along the edge, and `edge_rows` for others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, frozen
from turnwright._validate import between
from turnwright.cutting.learning.cuts import Cuts, NoseCuts
from turnwright.cutting.learning.edge_rows import InterruptedRows, TurningRows
from turnwright.cutting.learning.fit import TINY, UNLIKELY, Fit, Solved
from turnwright.cutting.learning.learned import NAMES, Estimate, ForceFit, LearnedMaterial, Transition, said_of
from turnwright.cutting.learning.rows import FEWEST, Rows
from turnwright.cutting.learning.saturation import SOLID, rail, saturated
from turnwright.cutting.learning.straight import StraightRows
from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.cutting.learning.cuts import InterruptedCuts

__all__ = ["learn_material"]

WILD = 10.0
"""Scatter in the cut over that in air beyond which something is likely not as stated."""

EXACT = 1e-6
"""Share of the thickest chip below which a departure from proportion is that of the arithmetic."""

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


def learn_material(
    cuts: Cuts | NoseCuts | InterruptedCuts,
    *,
    drift: int | None = None,
    edge_force: bool = False,
    size_effect: bool = False,
    calibration: Sequence[float] | None = None,
    area_uncertainty: float = 0.0,
    thickness_uncertainty: float = 0.0,
    confidence: float = 0.95,
) -> LearnedMaterial:
    """Learn the coefficients and the critical thickness of a material.

    Parameters
    ----------
    cuts
        Forces and what was cut: chips of one thickness along the edge, round noses, or mills and fly-cutters.
    drift
        Degree of the polynomial in time that the forces in air follow; ``None`` for forces without drift.
    edge_force
        Whether a force in proportion to the engaged edge alone, which rubs, is taken out of the coefficients.
    size_effect
        Whether the coefficients fall with a power of the chip thickness, :math:`K_0 (h/h_0)^{-m}`; :math:`h_0` is the
        geometric mean of all thicknesses, along an edge each counted by its area.
    calibration
        Standard uncertainty of each measured component, as a share that is common to all rows: of the dynamometer,
        see `Dynamometer.relative_uncertainty`. (components)
    area_uncertainty
        Standard uncertainty that is common to all areas of chips, such as that of width or depth, as a share.
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
    The force model of [Troutman2016]_; [Hansen2000]_ for a transition where forces jump. Oracles: forces made from
    known coefficients, along an edge by brute force from the shapes that it leaves, in a hundred random experiments;
    Student's t of a regression; weighted least squares by SciPy.
    """
    from scipy.stats import norm  # noqa: PLC0415 - costly to import

    between(confidence, "confidence", 0.5, 0.999, "")
    if edge_force and size_effect:
        raise InputError("edge_force and size_effect are both asked for, the limit is 1: forces do not tell them apart")
    rows: Rows
    match cuts:
        case Cuts():
            rows = StraightRows(cuts, drift)
        case NoseCuts():
            rows = TurningRows(cuts, drift)
        case _:
            rows = InterruptedRows(cuts, drift)
    _require_plausible(rows)
    components = rows.force.shape[1]
    shares = np.zeros(components) if calibration is None else frozen(calibration, "calibration")
    if shares.size != components or not ((shares >= 0) & (shares <= 1)).all():
        raise InputError(
            f"calibration is {shares.tolist()} and the cuts have {components} components: give each a share of 0 to 1"
        )
    rows.synchronise(None, np.inf)
    rows.told = rows.which_are_told()
    rows.edge, rows.power = edge_force, [0.0, 0.0] if size_effect else None
    split, ductile = _settled(rows, confidence)
    wide = float(norm.ppf(0.5 + confidence / 2))
    estimates: dict[str, Estimate] = {}
    standard: dict[str, float] = {}
    powers: dict[str, Estimate] = {}
    between(area_uncertainty, "area_uncertainty", 0.0, 1.0, "")
    for part, share in rows.groups(shares):
        found = _coefficients(part, ductile | ~rows.engaged, confidence, split)
        for k, name in enumerate(part.told):
            at = k * rows.parts
            value, half = float(found.value[at]), float(found.half[at])
            _require_material(name, value, value + half)
            common = float(np.hypot(np.linalg.norm(share * found.by_component[at]), area_uncertainty * value))
            estimates[name] = Estimate.around(value, float(np.hypot(half, wide * common)))
            standard[name] = float(np.hypot(found.sigma[at], common))
            if rows.power is not None:
                power = rows.power[list(NAMES).index(name)]
                powers[name] = Estimate.around(power, float(found.half[at + 1]) / abs(value))
    critical = None
    if split is not None:
        more = wide * between(thickness_uncertainty, "thickness_uncertainty", 0.0, np.inf, "mm")
        critical = Estimate(value=split.value, low=max(split.low - more, 0.0), high=split.high + more)
    thickest, fitted = float(rows.thickest.max()), _shown(rows, np.inf if split is None else split.value)
    said = [*said_of(estimates, split, thickest, confidence), *rows.questions(split, ductile)]
    return LearnedMaterial(
        cutting=estimates.get("cutting"),
        thrust=estimates.get("thrust"),
        uncertainty=(standard.get("cutting"), standard.get("thrust")),
        critical=critical,
        confidence=confidence,
        ductile=int(np.count_nonzero(ductile)),
        brittle=0 if split is None else int(np.count_nonzero(rows.surely_brittle(split.high))),
        thickest=thickest,
        remaining=None if split is None else split.remaining,
        chance=1.0 if split is None else split.chance,
        sentences=(*said, *_misfits(rows, ductile, fitted)),
        fit=fitted,
        exponents=(powers.get("cutting"), powers.get("thrust")) if size_effect else None,
        reference_thickness=rows.reference if size_effect else None,
    )


def _settled(rows: Rows, confidence: float) -> tuple[Transition | None, Bools]:
    """Return the transition and which rows are ductile, when powers and the place of a cutter no longer change."""
    for _ in range(3 if rows.turns else 0):
        rows.synchronise(Fit(rows).solve(rows.columns(np.inf))[0], np.inf)
    for turn in range(ROUNDS + 1):
        split = rows.transition(confidence)
        ductile = rows.engaged & rows.surely_ductile(np.inf if split is None else split.low)
        if rows.turns:
            limit = np.inf if split is None else split.value
            rows.synchronise(Fit(rows).solve(rows.columns(limit))[0], limit)
        if rows.power is None and not turn and rows.turns:
            continue
        if rows.power is None or turn == ROUNDS:
            break
        answer = Fit(rows, ductile | ~rows.engaged).solve(rows.columns(np.inf))[0]
        steps = [answer[2 * k + 1] / answer[2 * k] if one in rows.told else 0.0 for k, one in enumerate(NAMES)]
        rows.power = [float(np.clip(old + step, -2, 2)) for old, step in zip(rows.power, steps, strict=True)]
        if max(abs(step) for step in steps) < SETTLED:
            break
    return split, ductile


def _coefficients(rows: Rows, used: Bools, confidence: float, split: Transition | None = None) -> Solved:
    """Return the coefficients that are told from some rows, each with its edge force or power."""
    used, columns, told = rows.design(used, split)
    return Fit(rows, used).estimate(columns, confidence, told)


def _shown(rows: Rows, limit: float) -> ForceFit:
    """Return the forces of the cuts without drift, and what was learned makes of them."""
    columns = rows.columns(limit)
    fitted = columns @ Fit(rows).solve(columns)[0]
    measured = rows.force.copy()
    for component, weight in enumerate(rows.weights.T if rows.drift.size else ()):
        rest = (measured - fitted)[:, component] * weight
        measured[:, component] -= rows.drift @ np.linalg.lstsq(rows.drift * weight[:, None], rest, rcond=None)[0]
    cut = rows.engaged
    return ForceFit(
        components=rows.components, thickness=rows.thickest[cut], measured=measured[cut], fitted=fitted[cut]
    )


def _misfits(rows: Rows, ductile: Bools, fitted: ForceFit) -> list[str]:
    """Say what no interval accounts for."""
    said = []
    used = ductile | ~rows.engaged
    if rows.in_time and min(np.count_nonzero(~rows.engaged), np.count_nonzero(ductile)) >= FEWEST:
        left = Fit(rows, used).solve(rows.columns(np.inf))[2] / rows.weights[used]
        air = np.maximum(left[~rows.engaged[used]].std(axis=0), TINY)
        wild = float((left[rows.engaged[used]].std(axis=0) / air)[rows.clearest].max())
        if wild > WILD:
            said.append(
                f"the forces in the cut scatter {wild:.3g} times as much as in air, more than {WILD:g} times: check "
                "that no air is counted as cut, and that chips, geometry and feeds are as stated"
            )
        if not rows.turns:
            clear = int(np.argmax((np.abs(fitted.fitted).max(axis=0) / air)[rows.clearest]))
            said += _too_weak(float(np.abs(fitted.fitted[:, clear]).min()), float(air[clear]))
    if rows.edge or rows.power is not None or np.unique(rows.thickest[ductile]).size < FEWEST:
        return said
    rows.edge = True
    try:
        found = [(part.told, _coefficients(part, used, UNLIKELY)) for part, _ in rows.groups()]
    except InputError:
        return said  # cuts too alike to tell an edge force
    finally:
        rows.edge = False
    for names, one in found:
        for name, value, edge, half in zip(names, one.value[::2], one.value[1::2], one.half[1::2], strict=True):
            if abs(edge) > max(half, EXACT * abs(value) * rows.thickest.max()):
                said.append(
                    f"the {NAMES[name]} is not in proportion to the chip: it is as if the chips were "
                    f"{abs(edge / value) * 1e6:.3g} nm {'thicker' if edge > 0 else 'thinner'} than stated, so the "
                    "intervals do not hold: check where the cut begins, feed, depth and nose, or take a force of the "
                    "edge or a size effect into account"
                )
    return said


def _too_weak(weakest: float, scatter: float) -> list[str]:
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


def _require_plausible(rows: Rows) -> None:
    """Raise for chips that are no diamond's, and for channels that measured nothing or are saturated."""
    thickness, forces = rows.thickest, dict(zip(rows.labels, rows.force.T, strict=True))
    thickest = float(thickness.max(initial=0.0))
    if thickest > THICKEST:
        raise InputError(
            f"the thickest chip is {thickest:g} mm, the limit is {THICKEST:g} mm: state thicknesses in mm, of which 1 "
            "um is 0.001"
        )
    for name, force in forces.items():
        if not force[rows.engaged].any():
            raise InputError(f"the {name} of all cuts is 0 N, it must be measured: check its channel")
    order = np.flatnonzero(rows.engaged)
    order = order[np.argsort(thickness[order], kind="stable")]
    for name, force in forces.items():
        clipped = saturated(force[order])
        solid = clipped.size >= SOLID * (np.ptp(clipped) + 1 if clipped.size else 1)
        # Without noise all forces may be constant beyond a transition; a range ends for one of them.
        others = [other[order[clipped]] for other in forces.values()]
        if not solid or (len(forces) > 1 and not any(np.ptp(other) for other in others)):
            clipped = rail(rows.load[order], force[order])
        if not clipped.size:
            continue
        at = order[clipped]
        largest = force[at[np.argmax(np.abs(force[at]))]]
        raise InputError(
            f"the {name} is saturated: it stands at {largest:.6g} N in {at.size} of {order.size} cuts, of chips from "
            f"{thickness[at].min() * 1e6:.4g} to {thickness[at].max() * 1e6:.4g} nm, closer together than its noise: "
            "record with a larger range, or leave these cuts out"
        )


def _require_material(name: str, value: float, high: float) -> None:
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
