r"""Most probable values of a linear model with priors, their covariance, and random draws.

Map m measures :math:`y_m = A_m o_m + B_m s + \varepsilon_m`: unknowns o of the map, unknowns s shared by all maps, each
with a normal prior, and noise. The system is solved by orthogonal triangularisation, the unknowns of the maps first:

.. math:: Q^T \begin{pmatrix} A_m & B_m & y_m \\ I & 0 & \mu_m \end{pmatrix} =
   \begin{pmatrix} R_m & S_m & c_m \\ 0 & T_m & d_m \end{pmatrix}

in units of noise and prior. The sizes of groups of terms are those for which the maps are most probable [MacKay1992]_.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats

__all__ = ["Posterior", "Scaled", "posterior"]


class Scaled(NamedTuple):
    """The reduced system of a map, in units of its noise."""

    own: Floats  # (r, o)
    shared: Floats  # (r, s)
    target: Floats  # (r,)


class _MapUnknowns(NamedTuple):
    """The unknowns of one map, conditional on the shared ones."""

    inverse: Floats  # of R (o, o)
    by_shared: Floats  # S (o, s)
    right: Floats  # c (o,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Posterior:
    """Shared unknowns and those of each map, in units of their priors."""

    shared: Floats  # (s,)
    root: Floats  # (s, s): the covariance is its product with its transpose
    owns: tuple[_MapUnknowns, ...]
    evidence: float  # logarithm of the probability of the maps, up to a constant

    def map_unknowns(self, m: int) -> Floats:
        """Return the unknowns of a map. (o,)."""
        one = self.owns[m]
        return np.asarray(one.inverse @ (one.right - one.by_shared @ self.shared))

    def roots(self, m: int) -> Floats:
        """Return a root of the covariance of a map's unknowns followed by the shared ones. (o + s, *)."""
        one = self.owns[m]
        size = one.inverse.shape[0]
        upper = np.hstack([one.inverse, -one.inverse @ (one.by_shared @ self.root)])
        lower = np.hstack([np.zeros((self.shared.size, size)), self.root])
        return np.vstack([upper, lower])

    def variances(self, m: int) -> Floats:
        """Return the variances of a map's unknowns followed by the shared ones; 1 is the variance of the prior."""
        one = self.owns[m]
        by_shared = one.inverse @ (one.by_shared @ self.root)
        map_variances = np.einsum("ij,ij->i", one.inverse, one.inverse) + np.einsum("ij,ij->i", by_shared, by_shared)
        return np.concatenate([map_variances, np.einsum("ij,ij->i", self.root, self.root)])

    def draws(self, count: int, random: np.random.Generator) -> tuple[Floats, list[Floats]]:
        """Return draws of the shared unknowns (count, s), and of those of each map. (count, o) each."""
        shared = self.shared + random.normal(size=(count, self.shared.size)) @ self.root.T
        map_draws = []
        for one in self.owns:
            noise = random.normal(size=(count, one.right.size))
            map_draws.append((one.right - shared @ one.by_shared.T + noise) @ one.inverse.T)
        return shared, map_draws


def posterior(maps: Sequence[Scaled], prior_means: Sequence[Floats]) -> Posterior:
    """Return the posterior of unknowns of unit prior.

    Parameters
    ----------
    maps
        Systems with columns of unit prior.
    prior_means
        Prior means of the unknowns of each map. (o,) each
    """
    from scipy.linalg import qr, solve_triangular  # noqa: PLC0415 - costly to import

    owns, below, right = [], [np.eye(maps[0].shared.shape[1])], [np.zeros(maps[0].shared.shape[1])]
    evidence = 0.0
    for one, mean in zip(maps, prior_means, strict=True):
        size, shared_size = one.own.shape[1], one.shared.shape[1]
        stack = np.vstack([
            np.hstack([one.own, one.shared, one.target[:, None]]),
            np.hstack([np.eye(size), np.zeros((size, shared_size)), mean[:, None]]),
        ])  # fmt: skip
        r = qr(stack, mode="r", overwrite_a=True, check_finite=False)[0]
        evidence -= float(np.log(np.abs(np.diag(r)[:size])).sum())
        inverse = solve_triangular(r[:size, :size], np.eye(size), check_finite=False)
        owns.append(_MapUnknowns(inverse, r[:size, size:-1], r[:size, -1]))
        below.append(r[size : size + shared_size + 1, size:-1])
        right.append(r[size : size + shared_size + 1, -1])
    q, r = np.linalg.qr(np.vstack(below))
    root = solve_triangular(r, np.eye(r.shape[0]), check_finite=False)
    every = np.concatenate(right)
    seen = q.T @ every
    evidence -= float(np.log(np.abs(np.diag(r))).sum() + (every @ every - seen @ seen) / 2)
    return Posterior(shared=root @ seen, root=root, owns=tuple(owns), evidence=evidence)
