"""Estimate the force coefficients and the critical chip thickness of a material from measured forces.

One regression gives coefficients, drift and the forces beyond the critical thickness. See `straight` for chips of
uniform thickness along the edge, and `edge_rows` for other chips.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, frozen
from turnwright._validate import between
from turnwright.cutting.learning.cuts import Cuts, NoseCuts
from turnwright.cutting.learning.edge_rows import InterruptedRows, TurningRows
from turnwright.cutting.learning.regression import MIN_ROWS, TINY, WARNING_CONFIDENCE, Fit, Rows, Solution
from turnwright.cutting.learning.results import (
    FORCE_NAMES,
    Estimate,
    ForceFit,
    LearnedMaterial,
    Transition,
    report_estimates,
)
from turnwright.cutting.learning.signals import MIN_FILL, find_clipped, find_saturated
from turnwright.cutting.learning.straight import StraightRows
from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.cutting.learning.cuts import InterruptedCuts

__all__ = ["learn_material"]

MAX_SCATTER_RATIO = 10.0
"""Ratio of the scatter in the cut to that in air above which a warning is reported."""

OFFSET_TOL = 1e-6
"""Offset of the chip thickness, relative to the thickest chip, that counts as rounding."""

MAX_NEWTON_STEPS = 20
"""Newton steps for the exponents of a size effect."""

EXPONENT_TOL = 1e-10
"""Change of an exponent at which the Newton steps end."""

DETECTION_SIGMA = 5.0
"""Force, in standard deviations of the noise in air, at which a cut is detected reliably; as in `engagements`."""

MIN_COEFFICIENT, MAX_COEFFICIENT = 10.0, 1e5
"""Range of plausible cutting coefficients; outside it a unit is probably wrong. [N/mm²]"""

MAX_THICKNESS_MM = 0.1
"""Largest plausible uncut chip thickness in diamond turning; above it a unit is probably wrong."""


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
    """Estimate the force coefficients and the critical chip thickness of a material.

    Parameters
    ----------
    cuts
        Forces and cuts: chips of uniform thickness along the edge, round noses, or end mills and fly-cutters.
    drift
        Degree of the polynomial in time that the forces in air follow; ``None`` for forces without drift.
    edge_force
        Whether to fit an edge force (rubbing), proportional to the engaged length of the edge.
    size_effect
        Whether to fit a size effect, coefficients :math:`K_0 (h/h_0)^{-m}`; :math:`h_0` is the geometric mean of all
        thicknesses, weighted by area along an edge.
    calibration
        Relative standard uncertainty of each measured component, common to all rows; that of the dynamometer, see
        `Dynamometer.relative_uncertainty`. (components) [1]
    area_uncertainty
        Relative standard uncertainty common to all chip areas, such as that of width or depth. [1]
    thickness_uncertainty
        Standard uncertainty common to all chip thicknesses, such as that of the start of the cut. [mm]
    confidence
        Confidence level of all intervals. [1]

    Raises
    ------
    InputError
        If there are too few cuts, or a channel is saturated, all zero, or of the wrong sign or unit.

    Sources
    -------
    Force model of [Troutman2016]_; [Hansen2000]_ for a transition with a jump of the forces. Oracles: forces from
    known coefficients, integrated by brute force along the edge, in a hundred random experiments; Student's t of a
    regression; weighted least squares by SciPy.
    """
    from scipy.stats import norm  # noqa: PLC0415 - costly to import

    between(confidence, "confidence", 0.5, 0.999, "")
    if edge_force and size_effect:
        raise InputError("only one of edge_force and size_effect can be fitted, got both: choose one")
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
    relative = np.zeros(components) if calibration is None else frozen(calibration, "calibration")
    if relative.size != components or not ((relative >= 0) & (relative <= 1)).all():
        raise InputError(
            f"calibration must be {components} numbers of 0 to 1, one for each component, got {relative.tolist()}"
        )
    rows.synchronise(None, np.inf)
    rows.determined = rows.find_determined()
    rows.edge, rows.power = edge_force, [0.0, 0.0] if size_effect else None
    split, ductile = _iterate(rows, confidence)
    coverage = float(norm.ppf(0.5 + confidence / 2))
    estimates: dict[str, Estimate] = {}
    standard: dict[str, float] = {}
    powers: dict[str, Estimate] = {}
    between(area_uncertainty, "area_uncertainty", 0.0, 1.0, "")
    for part, component_relative in rows.groups(relative):
        solution = _fit_coefficients(part, ductile | ~rows.engaged, confidence, split)
        for k, name in enumerate(part.determined):
            at = k * rows.parts
            value, half = float(solution.value[at]), float(solution.half[at])
            _require_material(name, value, value + half)
            calibration_part = np.linalg.norm(component_relative * solution.by_component[at])
            common = float(np.hypot(calibration_part, area_uncertainty * value))
            estimates[name] = Estimate.around(value, float(np.hypot(half, coverage * common)))
            standard[name] = float(np.hypot(solution.sigma[at], common))
            if rows.power is not None:
                power = rows.power[list(FORCE_NAMES).index(name)]
                powers[name] = Estimate.around(power, float(solution.half[at + 1]) / abs(value))
    critical = None
    if split is not None:
        margin = coverage * between(thickness_uncertainty, "thickness_uncertainty", 0.0, np.inf, "mm")
        critical = Estimate(value=split.value, low=max(split.low - margin, 0.0), high=split.high + margin)
    thickest, fitted = float(rows.thickest.max()), _compare_forces(rows, np.inf if split is None else split.value)
    report = [*report_estimates(estimates, split, thickest, confidence), *rows.find_warnings(split, ductile)]
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
        sentences=(*report, *_find_misfits(rows, ductile, fitted)),
        fit=fitted,
        exponents=(powers.get("cutting"), powers.get("thrust")) if size_effect else None,
        reference_thickness=rows.reference if size_effect else None,
    )


def _iterate(rows: Rows, confidence: float) -> tuple[Transition | None, Bools]:
    """Return the transition and the ductile rows, after convergence of exponents and cutter positions."""
    for _ in range(3 if rows.turns else 0):
        rows.synchronise(Fit(rows).solve(rows.columns(np.inf))[0], np.inf)
    for turn in range(MAX_NEWTON_STEPS + 1):
        split = rows.transition(confidence)
        ductile = rows.engaged & rows.surely_ductile(np.inf if split is None else split.low)
        if rows.turns:
            limit = np.inf if split is None else split.value
            rows.synchronise(Fit(rows).solve(rows.columns(limit))[0], limit)
        if rows.power is None and not turn and rows.turns:
            continue
        if rows.power is None or turn == MAX_NEWTON_STEPS:
            break
        answer = Fit(rows, ductile | ~rows.engaged).solve(rows.columns(np.inf))[0]
        steps = [
            answer[2 * k + 1] / answer[2 * k] if name in rows.determined else 0.0 for k, name in enumerate(FORCE_NAMES)
        ]
        rows.power = [float(np.clip(old + step, -2, 2)) for old, step in zip(rows.power, steps, strict=True)]
        if max(abs(step) for step in steps) < EXPONENT_TOL:
            break
    return split, ductile


def _fit_coefficients(rows: Rows, used: Bools, confidence: float, split: Transition | None = None) -> Solution:
    used, columns, count = rows.design(used, split)
    return Fit(rows, used).estimate(columns, confidence, count)


def _compare_forces(rows: Rows, limit: float) -> ForceFit:
    columns = rows.columns(limit)
    fitted = columns @ Fit(rows).solve(columns)[0]
    measured = rows.force.copy()
    for component, weight in enumerate(rows.weights.T if rows.drift.size else ()):
        residual = (measured - fitted)[:, component] * weight
        measured[:, component] -= rows.drift @ np.linalg.lstsq(rows.drift * weight[:, None], residual, rcond=None)[0]
    cut = rows.engaged
    return ForceFit(
        components=rows.components, thickness=rows.thickest[cut], measured=measured[cut], fitted=fitted[cut]
    )


def _find_misfits(rows: Rows, ductile: Bools, fitted: ForceFit) -> list[str]:
    """Return warnings of deviations from the model that the intervals do not cover."""
    warnings = []
    used = ductile | ~rows.engaged
    if rows.in_time and min(np.count_nonzero(~rows.engaged), np.count_nonzero(ductile)) >= MIN_ROWS:
        residual = Fit(rows, used).solve(rows.columns(np.inf))[2] / rows.weights[used]
        air = np.maximum(residual[~rows.engaged[used]].std(axis=0), TINY)
        scatter_ratio = float((residual[rows.engaged[used]].std(axis=0) / air)[rows.judged].max())
        if scatter_ratio > MAX_SCATTER_RATIO:
            warnings.append(
                f"the forces in the cut scatter {scatter_ratio:.3g} times as much as in air, the limit is "
                f"{MAX_SCATTER_RATIO:g}: check that no air is counted as cut, and that chips, geometry and feeds are "
                "as stated"
            )
        if not rows.turns:
            component = int(np.argmax((np.abs(fitted.fitted).max(axis=0) / air)[rows.judged]))
            weakest = float(np.abs(fitted.fitted[:, component]).min())
            limit = DETECTION_SIGMA * float(air[component])
            if weakest < limit:
                warnings.append(
                    f"the weakest cuts have {weakest * 1e3:.3g} mN, reliable detection needs {limit * 1e3:.3g} mN "
                    f"({DETECTION_SIGMA:g} times the noise in air): thinner cuts may have been taken for air, and the "
                    "intervals do not hold; remove the thinnest chips, cut wider, lower the low-pass, or state begin "
                    "and end of the cuts"
                )
    if rows.edge or rows.power is not None or np.unique(rows.thickest[ductile]).size < MIN_ROWS:
        return warnings
    rows.edge = True
    try:
        solutions = [(part.determined, _fit_coefficients(part, used, WARNING_CONFIDENCE)) for part, _ in rows.groups()]
    except InputError:
        return warnings  # the cuts are too similar to determine an edge force
    finally:
        rows.edge = False
    for names, solution in solutions:
        value_edge_half = (solution.value[::2], solution.value[1::2], solution.half[1::2])
        for name, value, edge, half in zip(names, *value_edge_half, strict=True):
            if abs(edge) > max(half, OFFSET_TOL * abs(value) * rows.thickest.max()):
                warnings.append(
                    f"the {FORCE_NAMES[name]} is not proportional to the chip thickness: the forces are those of chips "
                    f"{abs(edge / value) * 1e6:.3g} nm {'thicker' if edge > 0 else 'thinner'} than stated, and the "
                    "intervals do not hold: check the start of the cut, feed, depth and nose radius, or fit an edge "
                    "force or a size effect"
                )
    return warnings


def _require_plausible(rows: Rows) -> None:
    thickness, forces = rows.thickest, dict(zip(rows.labels, rows.force.T, strict=True))
    thickest = float(thickness.max(initial=0.0))
    if thickest > MAX_THICKNESS_MM:
        raise InputError(
            f"the thickest chip is {thickest:g} mm, the limit is {MAX_THICKNESS_MM:g} mm: state thicknesses in mm (1 "
            "um is 0.001 mm)"
        )
    for name, force in forces.items():
        if not force[rows.engaged].any():
            raise InputError(f"the {name} of all cuts is 0 N, at least one must not be: check its channel")
    order = np.flatnonzero(rows.engaged)
    order = order[np.argsort(thickness[order], kind="stable")]
    for name, force in forces.items():
        clipped = find_saturated(force[order])
        contiguous = clipped.size >= MIN_FILL * (np.ptp(clipped) + 1 if clipped.size else 1)
        # Without noise all forces may be constant beyond a transition; saturation affects only one of them.
        same_rows = [component[order[clipped]] for component in forces.values()]
        if not contiguous or (len(forces) > 1 and not any(np.ptp(values) for values in same_rows)):
            clipped = find_clipped(rows.load[order], force[order])
        if not clipped.size:
            continue
        at = order[clipped]
        largest = force[at[np.argmax(np.abs(force[at]))]]
        raise InputError(
            f"the {name} is saturated: it is {largest:.6g} N, closer than its noise, in {at.size} of {order.size} "
            f"cuts, with chips of {thickness[at].min() * 1e6:.4g} to {thickness[at].max() * 1e6:.4g} nm: record with a "
            "larger range, or remove these cuts"
        )


def _require_material(name: str, value: float, high: float) -> None:
    if not value > 0 and (name == "cutting" or high < 0):
        raise InputError(
            f"the {name} coefficient is {value:.4g} N/mm^2, it must be above 0: check the signs of both channels"
        )
    if abs(value) > MAX_COEFFICIENT or (name == "cutting" and value < MIN_COEFFICIENT):
        raise InputError(
            f"the {name} coefficient is {value:.4g} N/mm^2, materials have {MIN_COEFFICIENT:g} to "
            f"{MAX_COEFFICIENT:.0e} N/mm^2: state forces in N, and thickness and width of the chip in mm"
        )
