"""Uncertainty of a pose from noise and from a plausible form error, and its undetermined directions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright.metrology.rigid import Fit, Problem, Rows, rows, turns, weights
from turnwright.surface import Surface, Zernike

RANK_TOL = 1e-12
"""Singular value, relative to the largest, at which a direction changes only rounding."""

UNDETERMINED_STD_MM = 1e6
"""Standard deviation given to a direction that nothing determines."""

CELLS_PER_SIDE = 8
"""Cells of the map along each axis within which residuals may be correlated."""

MIN_CORRELATED_RATIO = 2.0
"""Ratio of the variance to that of independent residuals from which they are correlated; chance stays below."""

FORM_INDICES = range(3, 15)
"""ANSI numbers of the forms that can be mistaken for a change of the pose: degrees 2, 3 and 4."""


class Doubt(NamedTuple):
    """Covariances of the free degrees of freedom from noise and from form, as movement of the rim. (k, k) [mm²]."""

    noise: Floats
    form: Floats

    @property
    def total(self) -> Floats:
        """Both together."""
        return self.noise + self.form


def rim_forms(numbers: Sequence[int], radius: float) -> list[Zernike]:
    """Return Zernike terms by their ANSI numbers, each 1 mm at the rim."""
    return [Zernike(terms={one: 1.0}, radius=radius, indexing="ansi", normalised=False) for one in numbers]


def rim_form_heights(numbers: Sequence[int], radius: float, x: Floats, y: Floats) -> Floats:
    """Return the heights of Zernike terms, each 1 mm at the rim. (k, n)."""
    x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
    forms = rim_forms(numbers, radius)
    return np.array([form.evaluate(x, y, 0)[0] for form in forms]).reshape(len(forms), x.size)


def doubt(
    problem: Problem,
    found: Fit,
    free: Sequence[int],
    size: Floats,
    *,
    noise: float,
    count: int,
    form: float,
    white: bool,
) -> Doubt:
    r"""Return the covariance of the free degrees of freedom.

    Noise of standard deviation s gives :math:`s^2 N^{-1}` with :math:`N = J W J^T`. A form error g moves the pose by
    :math:`N^{-1} J W g`; each of the plausible forms has the standard deviation ``form`` at the rim.

    Parameters
    ----------
    noise
        Standard deviation of a height [mm], independent from point to point over ``count`` points.
    white
        Whether it is known to be independent. Otherwise correlated residuals, as of a displaced lenslet, increase the
        covariance: their contributions are summed over cells of the part before they are squared.
    """
    chosen = np.asarray(free, dtype=np.int64)
    at = rows(problem, found.state, slice(0, problem.points.shape[1]))
    root = np.sqrt(problem.weighed(weights(at.residual, found.scale, problem.loss)[0], at.which))
    # Singular values reach down to rounding; eigenvalues of the normal equations stop at its square root.
    columns = _of_design(problem, found.state, at)[chosen] * size[chosen, None]
    points, singular, vectors = np.linalg.svd((columns * root).T, full_matrices=False)
    fixed = singular > RANK_TOL * max(singular[0], 1e-300)
    inverse = np.where(fixed, 1 / np.where(fixed, singular, 1.0), 0.0)
    share = at.which.size / max(count, 1)
    std = np.where(fixed, np.minimum(noise * inverse * np.sqrt(share), UNDETERMINED_STD_MM), UNDETERMINED_STD_MM)
    variance = (vectors.T * std**2) @ vectors
    if problem.area is not None:
        # Areas are weights, not inverse variances: the covariance is A⁻¹ J W² Jᵀ A⁻¹ with A = J W Jᵀ.
        spread = np.eye(chosen.size)
        spread[np.ix_(fixed, fixed)] = (points[:, fixed].T * problem.area[at.which]) @ points[:, fixed]
        variance = (vectors.T * std) @ spread @ (vectors.T * std).T
    if not white and problem.surface.in_pieces and fixed.all():
        variance = _inflate_covariance(problem.surface, variance, share, at, singular, vectors, points * root[:, None])
    if form == 0:
        return Doubt(variance, np.zeros_like(variance))
    shapes = rim_form_heights(FORM_INDICES, problem.within, at.at[0], at.at[1])
    moved = form * (vectors.T * inverse) @ (points.T @ (root[:, None] * shapes.T))
    return Doubt(variance, moved @ moved.T)


def _of_design(problem: Problem, state: Floats, at: Rows) -> Floats:
    """Return the derivatives for the design without its form error, which must not seem to determine a direction.

    A sphere is invariant to rotation about its centre, but heights that deviate from it by e change by e times the
    slope.
    """
    if problem.normal:
        return at.columns
    slope_x, slope_y = -at.columns[0], -at.columns[1]
    lever = np.stack([at.residual * slope_y, -at.residual * slope_x, np.zeros_like(at.residual)])
    columns = at.columns.copy()
    columns[3:6] -= turns(state)[1] @ lever
    return columns


def _inflate_covariance(
    surface: Surface, variance: Floats, share: float, at: Rows, singular: Floats, vectors: Floats, pulls: Floats
) -> Floats:
    """Return the covariance increased for spatially correlated residuals."""
    low, high = at.at[:2].min(axis=1, keepdims=True), at.at[:2].max(axis=1, keepdims=True)
    i, j = np.minimum(
        (CELLS_PER_SIDE * (at.at[:2] - low) / np.maximum(high - low, 1e-300)).astype(np.int64), CELLS_PER_SIDE - 1
    )
    cell = i * CELLS_PER_SIDE + j
    piece = surface.piece(np.ascontiguousarray(at.at[0]), np.ascontiguousarray(at.at[1]))
    if piece is not None:  # a lenslet is one cell; the surface between them is divided into cells
        _, number, size = np.unique(piece, return_inverse=True, return_counts=True)
        cell = np.where(size[number] < cell.size / CELLS_PER_SIDE, CELLS_PER_SIDE**2 + number, cell)
    pull = pulls * at.residual[:, None]
    sums = np.stack([np.bincount(cell, weights=column) for column in pull.T])
    scatter = float((pull * pull).sum()) / singular.size
    if scatter == 0:
        return variance
    # In the frame of the singular vectors independent residuals have the same scatter along all of them.
    ratio, axes = np.linalg.eigh(sums @ sums.T / scatter)
    excess = np.where(ratio > MIN_CORRELATED_RATIO, ratio - 1, 0.0) / share
    stretch = (vectors.T / singular) @ axes
    white = float(np.trace(variance)) / float(np.sum(1 / singular**2))
    return np.asarray(variance + (stretch * (white * excess)) @ stretch.T)


def undetermined_directions(covariance: Floats, limit: float) -> tuple[Floats, list[int]]:
    """Return the directions (k, m) with a standard deviation beyond the limit, and the m degrees of freedom to fix.

    Entirely undetermined directions come first: each moves one of these by 1 and the others not at all. The remaining
    directions are unit vectors, and move theirs most.
    """
    from scipy.linalg import qr  # noqa: PLC0415 - scipy is costly to import

    values, vectors = np.linalg.eigh(covariance)
    weak = vectors[:, values > limit**2][:, ::-1]
    free = int(np.count_nonzero(values > (UNDETERMINED_STD_MM / 10) ** 2))
    numbers: list[int] = []
    if free:
        numbers = [int(k) for k in qr(weak[:, :free].T, pivoting=True, mode="r")[1][:free]]
        weak[:, :free] = weak[:, :free] @ np.linalg.inv(weak[numbers, :free])
    for k in range(free, weak.shape[1]):
        order = np.argsort(-np.abs(weak[:, k]))
        numbers.append(next(int(one) for one in order if one not in numbers))
    return weak, numbers
