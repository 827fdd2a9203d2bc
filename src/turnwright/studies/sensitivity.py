r"""Variance-based sensitivity indices, and intervals of probabilities and percentiles.

The first-order index of an input, or of a group of inputs, is the part of the variance that fixing it would remove on
average; the total index is the part that remains on average if all other inputs are fixed:

.. math:: S_i = \frac{\mathrm{Var}\,\mathrm E[y | x_i]}{\mathrm{Var}\,y}, \qquad
   T_i = \frac{\mathrm E\,\mathrm{Var}[y | x_{\sim i}]}{\mathrm{Var}\,y}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright._arrays import Floats, Ints

__all__ = [
    "Indices",
    "Interval",
    "MapModel",
    "binomial_interval",
    "group_inputs",
    "neighbour_indices",
    "percentile",
    "sobol_indices",
    "unit_points",
]

MISS_PROBABILITY = 0.05
"""Probability that an interval does not hold the true value."""

MAPS_PER_BLOCK = 2_000
"""Maps that are evaluated together."""


class Interval(NamedTuple):
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float


def binomial_interval(successes: int, trials: int) -> Interval:
    """Return the estimated probability of success with the exact interval of Clopper and Pearson.

    Its coverage is at least 95 %, also with no successes and with all [Clopper1934]_. Oracle:
    ``scipy.stats.binomtest``.

    >>> [round(one, 4) for one in binomial_interval(190, 200)]
    [0.95, 0.91, 0.9758]
    """
    from scipy.special import betaincinv  # noqa: PLC0415 - costly to import

    if not 0 <= successes <= trials or trials < 1:
        raise InputError(
            f"successes must be 0 to the number of trials, and trials at least 1, got {successes} of {trials}"
        )
    k, n = successes, trials
    low = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, MISS_PROBABILITY / 2))
    high = 1.0 if k == n else float(betaincinv(k + 1, n - k, 1 - MISS_PROBABILITY / 2))
    return Interval(k / n, low, high)


def percentile(values: Floats, share: float) -> Interval:
    """Estimate a percentile from draws, with its confidence interval by order statistics [Conover1999]_.

    An end of the interval for which there are too few draws is infinite.
    """
    from scipy.special import bdtr  # noqa: PLC0415 - costly to import

    ordered = np.sort(values)
    n = ordered.size
    below = bdtr(np.arange(n + 1.0), n, share)  # chance that at most so many draws lie below
    first = int(np.searchsorted(below, MISS_PROBABILITY / 2, side="right"))
    last = int(np.searchsorted(below, 1 - MISS_PROBABILITY / 2, side="left")) + 1
    low = -np.inf if first == 0 else float(ordered[first - 1])
    high = np.inf if last > n else float(ordered[last - 1])
    return Interval(float(np.quantile(ordered, share)), low, high)


class Indices(NamedTuple):
    """Sobol' indices of groups of inputs, and their standard errors of sampling. Each (groups,)."""

    first: Floats
    total: Floats
    first_error: Floats
    total_error: Floats


def unit_points(dimensions: int, log2: int, seed: int) -> Floats:
    """Return points of a scrambled Sobol' sequence inside the unit cube. (2**log2, dimensions)."""
    from scipy.stats import qmc  # noqa: PLC0415 - costly to import

    points = qmc.Sobol(dimensions, scramble=True, seed=seed).random_base2(log2)
    return np.asarray(np.clip(points, 1e-12, 1 - 1e-12), dtype=np.float64)


def sobol_indices(
    function: Callable[[Floats], Floats], groups: Sequence[Sequence[int]], a: Floats, b: Floats
) -> Indices:
    """Return first-order and total indices of groups of inputs, by the design of Saltelli.

    ``a`` and ``b`` (n, d) are independent draws of all inputs, preferably the two halves of one sequence.
    [Saltelli2010]_, Table 2: (b) for the first order, that of Jansen (f) for the total. Oracle:
    ``scipy.stats.sobol_indices`` and closed forms.
    """
    of_a, of_b = function(a), function(b)
    both = np.concatenate([of_a, of_b])
    variance = float(np.var(both)) or 1.0
    of_a, of_b = of_a - both.mean(), of_b - both.mean()
    terms = np.empty((2, len(groups), of_a.size))
    for k, group in enumerate(groups):
        mixed = a.copy()
        mixed[:, group] = b[:, group]
        of_mixed = function(mixed) - both.mean()
        terms[0, k] = of_b * (of_mixed - of_a) / variance
        terms[1, k] = (of_a - of_mixed) ** 2 / 2 / variance
    means, errors = terms.mean(axis=2), terms.std(axis=2) / np.sqrt(of_a.size)
    return Indices(means[0], means[1], errors[0], errors[1])


def neighbour_indices(inputs: Floats, result: Floats, groups: Sequence[Sequence[int]]) -> Floats:
    """Estimate first-order indices of groups of inputs from independent cases.

    Two cases that are nearest neighbours in the inputs (n, d), in units of their standard deviations, differ by the
    effect of the other inputs. For one input this is Chatterjee's rank correlation with the result in place of its
    ranks [Gamboa2022]_, for groups see [Broto2020]_. The standard error is about 1 over the root of the number of
    cases.
    """
    from scipy.spatial import KDTree  # noqa: PLC0415 - costly to import

    variance = float(np.var(result))
    indices = np.zeros(len(groups))
    if variance == 0:
        return indices
    centred = result - result.mean()
    for k, group in enumerate(groups):
        columns = inputs[:, group]
        if len(group) == 1:
            order = np.argsort(columns[:, 0])
            partner = np.roll(order, -1)
            products = centred[order] * centred[partner]
        else:
            nearest = np.asarray(KDTree(columns).query(columns, k=2)[1])
            other = np.where(nearest[:, 0] == np.arange(columns.shape[0]), nearest[:, 1], nearest[:, 0])
            products = centred * centred[other]
        indices[k] = products.mean() / variance
    return indices


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapModel:
    """Error maps as sums of error signatures, one for each input and one for its square, fitted to cases.

    Small errors superpose: each changes every height in proportion, with a small quadratic term. Some hundred cases
    therefore determine the map of any draw, so that the peak to valley of a million draws needs no further cases.
    """

    share: Floats  # coefficient of each height for a constant, the inputs and their squares. (1 + d or 1 + 2d, m) [nm]
    weight: Floats  # weight of each height. (m,)
    leverage: Floats  # leverage of each case in the fit. (n,)
    left: Floats  # residual of each case. (n, m) [nm]
    maps: Floats  # fitted maps. (n, m) [nm]

    @classmethod
    def fit(cls, inputs: Floats, maps: Floats, weight: Floats, chosen: Ints | None = None) -> MapModel | None:
        """Fit the model to scaled draws (n, d) and maps (n, m) [nm], by default all; ``None`` if they are too few."""
        columns = cls.columns(inputs, squares=inputs.shape[0] >= 4 * (2 * inputs.shape[1] + 1))
        if inputs.shape[0] < cls.min_cases(inputs.shape[1]):
            return None
        terms, seen = (columns, maps) if chosen is None else (columns[chosen], maps[chosen])
        share = np.asarray(np.linalg.lstsq(terms, seen, rcond=None)[0], dtype=np.float64)
        q = np.linalg.qr(columns)[0]
        return cls(share=share, weight=weight, leverage=(q**2).sum(axis=1), left=maps - columns @ share, maps=maps)

    @staticmethod
    def min_cases(inputs: int) -> int:
        """Return the least number of cases for a number of inputs."""
        return 2 * (1 + inputs)

    @staticmethod
    def columns(inputs: Floats, *, squares: bool) -> Floats:
        """Return the design matrix of the fit. (n, 1 + d or 1 + 2d)."""
        parts = [np.ones((inputs.shape[0], 1)), inputs]
        if squares:
            parts.append(inputs**2 - 1)
        return np.concatenate(parts, axis=1)

    def pv(self, inputs: Floats) -> Floats:
        """Return peak to valley of draws. (n, d) to (n,) [nm]."""
        squares = self.share.shape[0] > 1 + inputs.shape[1]
        pv = np.empty(inputs.shape[0])
        for start in range(0, inputs.shape[0], MAPS_PER_BLOCK):
            block = slice(start, start + MAPS_PER_BLOCK)
            pv[block] = np.ptp(self.columns(inputs[block], squares=squares) @ self.share, axis=1)
        return pv

    def _rms(self, maps: Floats) -> Floats:
        return np.asarray(np.sqrt(maps**2 @ self.weight / self.weight.sum()))

    def explained_variance(self) -> tuple[float, float]:
        """Return the part of the variance of peak to valley and of root mean square that the model predicts.

        By leave-one-out cross-validation in closed form.
        """
        without = self.maps - self.left / (1 - self.leverage)[:, None]
        shares = []
        for observed, predicted in (
            (np.ptp(self.maps, axis=1), np.ptp(without, axis=1)),
            (self._rms(self.maps), self._rms(without)),
        ):
            variance = float(np.var(observed))
            shares.append(1 - float(np.mean((observed - predicted) ** 2)) / variance if variance > 0 else 1.0)
        return shares[0], shares[1]


def group_inputs(names: Sequence[str], group_of: Callable[[str], str]) -> Mapping[str, list[int]]:
    """Return the numbers of the inputs in each group."""
    groups: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        groups.setdefault(group_of(name), []).append(k)
    return groups
