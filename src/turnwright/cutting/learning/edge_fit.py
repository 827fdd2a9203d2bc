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
from typing import TYPE_CHECKING

import numpy as np

from turnwright.cutting.learning.cuts import InterruptedCuts, NoseCuts
from turnwright.cutting.learning.edge_rows import InterruptedRows, TurningRows
from turnwright.cutting.learning.fit import CERTAIN, TINY, Fit, interval, learn, require_plausible
from turnwright.cutting.learning.learned import NAMES, LearnedMaterial, Transition
from turnwright.cutting.learning.material_fit import hansen
from turnwright.cutting.learning.rows import FEWEST, Rows

if TYPE_CHECKING:
    from turnwright._arrays import Floats

__all__ = ["learn_along_edge"]

LABELS = {"axial": "axial force", "feed": "feed force", "cutting": "cutting force"}
"""What components of the force are called; those of a mill are named after their axes."""

LOOKED = 96
"""Thicknesses at which a transition is first looked for."""

HALVED = 12
"""Times that the interval between two of these is halved."""


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
    rows: Rows = TurningRows(cuts, drift) if isinstance(cuts, NoseCuts) else InterruptedRows(cuts, drift)
    names = [LABELS.get(one, f"force along {one}") for one in cuts.components]
    require_plausible(rows, names, rows.thickest)
    return learn(
        rows,
        _transition,
        edge_force=edge_force,
        size_effect=size_effect,
        calibration=calibration,
        area_uncertainty=area_uncertainty,
        thickness_uncertainty=thickness_uncertainty,
        confidence=confidence,
    )


def _weigh(rows: Rows, limit: float) -> float:
    """Weigh each component by its noise, within the ductile range and beyond apart; return the correlation time."""
    thick = rows.engaged & (rows.thickest > limit)
    if not rows.stated:
        apart = min(np.count_nonzero(thick), np.count_nonzero(~thick)) > 2 * FEWEST
        floor = 1e-9 * np.abs(rows.force).max(axis=0) + TINY
        rows.weights = np.ones_like(rows.force)
        for _ in range(2):
            left = Fit(rows).solve(rows.columns(limit))[2] / rows.weights
            weights = np.empty_like(left)
            for group in (thick, ~thick) if apart else (np.ones_like(thick),):
                weights[group] = 1 / np.maximum(np.sqrt((left[group] ** 2).mean(axis=0)), floor)
            rows.weights = weights
    left = Fit(rows).solve(rows.columns(limit))[2]
    return max(rows.together(left, one) for one in (thick, rows.engaged & ~thick, ~rows.engaged))


def _transition(rows: Rows, confidence: float) -> Transition | None:
    """Find the thickness beyond which elements of the edge leave the ductile line, and all that could be it."""
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    low, high = max(ascending[FEWEST - 1], ascending[-1] / 50), ascending[-FEWEST]
    _weigh(rows, np.inf)
    if not low < high * (1 - 1e-6) or ascending.size < 2 * FEWEST:
        return None
    fit = Fit(rows)  # as the rows are weighed now
    grid = np.geomspace(low, high * (1 - 1e-9), LOOKED)

    def squares(limit: float) -> float:
        columns = rows.columns(limit)
        answer, least = fit.solve(columns)[:2]
        beside = rows.unknown(answer, limit)
        return fit.solve(np.concatenate((columns, beside), axis=2))[1] if beside.shape[2] else least

    rough = grid[::3]
    tau = _weigh(rows, float(rough[int(np.argmin([squares(float(one)) for one in rough]))]))
    fit = Fit(rows)
    profile = np.array([squares(float(one)) for one in grid])
    exact = 1e-4 * float(grid[int(np.argmin(profile))])
    best, least, within = interval(squares, grid, profile, exact, every=True)
    columns = rows.columns(best)
    number, size = rows.force.size, columns.shape[2]
    free = max(number / tau - size - rows.drift.shape[1] * rows.force.shape[1], 1.0)
    answer, _, left = fit.solve(columns)
    # Weights were made from what is left, so that a square counts as number over what is free.
    eta = tau * max(
        least / max(number - size, 1), 1.0 if rows.stated else 0.0, _told_by(fit, columns, answer, left, best)
    )
    limit = hansen(confidence) if rows.even else float(f.ppf(confidence, 1, free))
    ends = within(limit * eta, (0.0, float(ascending[-1])), HALVED)
    more = 2 * len(rows.told)
    gain = (squares(np.inf) - least) / eta / more
    chance = float(min(1.0, rows.engaged.sum() * f.sf(gain, more, free)))
    which = [tuple(NAMES).index(name) for name in rows.told]
    # What could as well begin at no thickness at all is no transition: forces are out of proportion everywhere.
    if chance > CERTAIN or ends[0] == 0 or rows.remaining(which[0], answer, float(ascending[-1])) >= 1:
        return None
    remaining = tuple(rows.remaining(one, answer, best) for one in which)
    return Transition(best, min(ends[0], best), max(ends[1], best), remaining, chance)


def _told_by(fit: Fit, columns: Floats, answer: Floats, left: Floats, limit: float) -> float:
    """Return the noise of what tells the limit over that of independent components; those of a row may hang together.

    What fracture does to one component it does to all.
    """
    rows, step = fit.rows, 0.01 * limit
    slope = (rows.columns(limit + step) - rows.columns(limit - step)) @ answer
    target, table = fit.table(slope[:, :, None]).reshape(-1), fit.table(columns).reshape(-1, columns.shape[2])
    table = table / np.maximum(np.linalg.norm(table, axis=0), TINY)
    rest = target - table @ np.linalg.lstsq(table, target, rcond=1e-10)[0]
    whole = float(rest @ rest)
    return float(((rest.reshape(left.shape) * left).sum(axis=1) ** 2).sum() / whole) if whole else 0.0
