"""One least squares of forces, drift and coefficients together, and what a material's numbers are uncertain by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, frozen
from turnwright._validate import between
from turnwright.cutting.learning.learned import NAMES, Estimate, ForceFit, LearnedMaterial, Transition, said_of
from turnwright.cutting.learning.saturation import SOLID, rail, saturated
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.cutting.learning.rows import Rows

__all__ = ["CERTAIN", "TINY", "UNLIKELY", "Find", "Fit", "Solved", "interval", "learn", "require_plausible", "shown"]

CERTAIN = 0.01
"""A transition is told of if chance would make one as clear in less than this share of experiments."""

WILD = 10.0
"""Scatter in the cut over that in air beyond which something is likely not as stated."""

UNLIKELY = 0.999
"""A departure from proportion is told of outside this interval."""

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

FEWEST = 4
"""Rows that tell something."""

MANY = 50
"""Rows in time from which on each brings its own noise."""

ALIKE = 1e8
"""Condition of the columns beyond which they cannot be told apart."""

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True)
class Solved:
    """Numbers, standard uncertainties, half intervals, and how the numbers hang on each component. (k,), (k, c)."""

    value: Floats
    sigma: Floats
    half: Floats
    by_component: Floats


class Fit:
    """Weighted least squares of some rows, every component with a drift of its own."""

    def __init__(self, rows: Rows, used: Bools | None = None) -> None:
        """Take the rows, as they are weighed now, and those of them that are used; all if not given."""
        self.rows, self.used = rows, np.ones(rows.engaged.size, dtype=np.bool_) if used is None else used
        self.weight = rows.weights[self.used]
        self.force = rows.force[self.used] * self.weight
        self.drift = []
        for weight in self.weight.T:
            table = rows.drift[self.used] * weight[:, None]
            self.drift.append(np.linalg.qr(table[:, np.linalg.norm(table, axis=0) > 0])[0])
        self.free_force = self.without_drift(self.force[:, :, None])[:, :, 0]

    def without_drift(self, columns: Floats) -> Floats:
        """Take out of columns what the drift explains. (n, components, k)."""
        free = np.empty_like(columns)
        for component, basis in enumerate(self.drift):
            free[:, component] = columns[:, component] - basis @ (basis.T @ columns[:, component])
        return free

    def table(self, columns: Floats) -> Floats:
        """Return the columns of the rows that are used, weighted and without drift. (n, components, k)."""
        return self.without_drift(columns[self.used] * self.weight[:, :, None])

    def solve(self, columns: Floats) -> tuple[Floats, float, Floats]:
        """Return the parameters, the squares that are left, and what is left of each row. (k,), (n, components)."""
        table = self.table(columns)
        size = np.maximum(np.sqrt((table**2).sum(axis=(0, 1))), TINY)
        flat = (table / size).reshape(-1, size.size)
        # Columns of the brittle side may be one; a touch of the diagonal decides.
        normal = flat.T @ flat + 1e-11 * np.eye(size.size)
        answer = np.linalg.solve(normal, flat.T @ self.free_force.reshape(-1))
        left = self.free_force - (flat @ answer).reshape(self.force.shape)
        return answer / size, float((left**2).sum()), left

    def estimate(self, columns: Floats, confidence: float, told: int | None = None) -> Solved:
        """Return the first parameters with their uncertainties, all of them if ``told`` is not given."""
        from scipy.stats import t  # noqa: PLC0415 - costly to import

        rows, components = self.rows, self.force.shape[1]
        told = columns.shape[2] if told is None else told
        table = self.table(columns)
        size = np.sqrt((table**2).sum(axis=(0, 1)))
        # What says nothing here, such as the speed of a pass without ductile rows, is left out.
        kept = size > 1e-12 * size.max()
        kept[:told] = size[:told] > 0
        scaled = table[:, :, kept] / size[kept]
        flat = scaled.reshape(-1, scaled.shape[2])
        if flat.shape[0] <= flat.shape[1] or not kept[:told].all() or np.linalg.cond(flat) > ALIKE:
            raise InputError(
                f"the {flat.shape[0]} ductile forces do not tell the {kept.size} coefficients from each other, edge "
                "force and drift: measure more thin chips, vary thickness, depth or feed, measure one more component, "
                "or drop these"
            )
        inverse = np.linalg.inv(flat.T @ flat)
        answer = np.linalg.lstsq(flat, self.free_force.reshape(-1), rcond=None)[0]
        left = self.free_force - (flat @ answer).reshape(self.force.shape)
        residual = np.zeros(rows.force.shape)
        residual[self.used] = left
        tau = max(rows.together(residual, self.used & side) for side in (rows.engaged, ~rows.engaged))
        count, drifts = self.force.shape[0], sum(basis.shape[1] for basis in self.drift)
        free = max(flat.shape[0] / tau - flat.shape[1] - drifts, 1.0)
        if rows.in_time and count > MANY:
            # Noise in the cut and in air differ and components of a row may hang together: each row brings its own.
            leverage = np.einsum("rp,pq,rq->r", scaled[:, 0], inverse, scaled[:, 0]) + (self.drift[0] ** 2).sum(axis=1)
            own = left * np.sqrt(count / max(count - flat.shape[1] - drifts, 1))
            own = left / (1 - np.minimum(leverage, 0.9))[:, None] if components == 1 else own
            each = np.einsum("rcp,rc->rp", scaled, own)
            cover = tau * inverse @ (each.T @ each) @ inverse
        else:
            # Stated uncertainties are not made smaller by a lucky fit.
            scale = float((left**2).sum()) / free * tau
            cover = (max(scale, 1.0) if rows.stated else scale) * inverse
        size = size[kept][:told]
        sigma = np.sqrt(np.diag(cover))[:told] / size
        by = [inverse @ scaled[:, c].T @ self.free_force[:, c] for c in range(components)]
        # Few rows know the noise of each component only so well (Welch and Satterthwaite).
        parts = np.stack([np.diag(inverse @ (one.T @ one) @ inverse)[:told] for one in scaled.transpose(1, 0, 2)])
        ratio = parts / parts.sum(axis=0)
        each_free = np.maximum(count / tau - drifts / components - flat.shape[1] * ratio, 1.0)
        freedom = np.full(told, free) if rows.stated else 1 / (ratio**2 / each_free).sum(axis=0)
        half = t.ppf(0.5 + confidence / 2, freedom) * sigma
        return Solved(answer[:told] / size, sigma, half, np.stack(by, axis=1)[:told] / size[:, None])


def interval(
    squares: Callable[[float], float], grid: Floats, profile: Floats, exact: float, *, every: bool = False
) -> tuple[float, float, Callable[[float, tuple[float, float], int], tuple[float, float]]]:
    """Find the least of squares between the places of a grid, and what gives the interval about it.

    Parameters
    ----------
    squares
        What is left at some place.
    grid, profile
        Places that ascend and what is left there. Each (n,)
    exact
        Error that the place may have.
    every
        Whether the interval holds every place that leaves little enough, or ends at the first that leaves more.

    Returns
    -------
    tuple
        The place, what is left there, and a function that returns the interval. It takes by how much more may be left,
        the ends where the grid does not close it, and the number of bisections for each end.
    """
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - costly to import

    at = int(np.argmin(profile))
    around = (float(grid[max(at - 1, 0)]), float(grid[min(at + 1, grid.size - 1)]))
    finer = minimize_scalar(squares, bounds=around, method="bounded", options={"xatol": exact})
    least, best = min((float(profile[at]), float(grid[at])), (float(finer.fun), float(finer.x)))

    def within(reach: float, open_ends: tuple[float, float], halved: int) -> tuple[float, float]:
        ends = []
        for beyond, end in zip((grid[grid < best][::-1], grid[grid > best]), open_ends, strict=True):
            near = profile[np.searchsorted(grid, beyond)] - least <= reach
            held = int(np.flatnonzero(near).max(initial=-1)) + 1 if every else int(np.argmin([*near, False]))
            if held == beyond.size:
                ends.append(end)
                continue
            inside, outside = float(beyond[held - 1]) if held else best, float(beyond[held])
            for _ in range(halved):
                middle = (inside + outside) / 2
                inside, outside = (middle, outside) if squares(middle) - least <= reach else (inside, middle)
            ends.append(outside)
        return ends[0], ends[1]

    return best, least, within


Find = Callable[["Rows", float], Transition | None]
"""Finds the transition of rows with a confidence."""


def _settled(rows: Rows, find: Find, confidence: float) -> tuple[Transition | None, Bools]:
    """Return the transition and which rows are ductile, when powers and the place of a cutter no longer change."""
    for _ in range(3 if rows.turns else 0):
        rows.synchronise(Fit(rows).solve(rows.columns(np.inf))[0], np.inf)
    for turn in range(ROUNDS + 1):
        split = find(rows, confidence)
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


def learn(
    rows: Rows,
    find: Find,
    *,
    edge_force: bool,
    size_effect: bool,
    calibration: Sequence[float] | None,
    area_uncertainty: float,
    thickness_uncertainty: float,
    confidence: float,
) -> LearnedMaterial:
    """Learn coefficients and critical thickness from rows of any kind."""
    from scipy.stats import norm  # noqa: PLC0415 - costly to import

    between(confidence, "confidence", 0.5, 0.999, "")
    if edge_force and size_effect:
        raise InputError("edge_force and size_effect are both asked for, the limit is 1: forces do not tell them apart")
    components = rows.force.shape[1]
    shares = np.zeros(components) if calibration is None else frozen(calibration, "calibration")
    if shares.size != components or not ((shares >= 0) & (shares <= 1)).all():
        raise InputError(
            f"calibration is {shares.tolist()} and the cuts have {components} components: give each a share of 0 to 1"
        )
    rows.synchronise(None, np.inf)
    rows.told = rows.which_are_told()
    rows.edge, rows.power = edge_force, [0.0, 0.0] if size_effect else None
    split, ductile = _settled(rows, find, confidence)
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
    thickest, fitted = float(rows.thickest.max()), shown(rows, np.inf if split is None else split.value)
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


def _coefficients(rows: Rows, used: Bools, confidence: float, split: Transition | None = None) -> Solved:
    """Return the coefficients that are told from some rows, each with its edge force or power."""
    used, columns, told = rows.design(used, split)
    return Fit(rows, used).estimate(columns, confidence, told)


def shown(rows: Rows, limit: float) -> ForceFit:
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


def require_plausible(rows: Rows, names: Sequence[str], load: Floats) -> None:
    """Raise for chips that are no diamond's, and for channels that measured nothing or are saturated at some load."""
    thickness, forces = rows.thickest, dict(zip(names, rows.force.T, strict=True))
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
            clipped = rail(load[order], force[order])
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
