"""What a surface cannot tell of its pose: what noise and a plausible error of form would do to each direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright.metrology._rigid import Fit, Problem, rows, spans, weights
from turnwright.surface import Zernike

__all__ = ["Doubt", "doubt", "held", "plausible"]

NOTHING = 1e-13
"""Eigenvalue, as a share of the largest one, at which a direction changes nothing but rounding."""

ENDLESS = 1e6
"""Standard deviation of a direction that nothing fixes. [mm]."""

FORMS = range(3, 15)
"""ANSI numbers of the forms that a pose may be mistaken for: degrees 2, 3 and 4."""


class Doubt(NamedTuple):
    """Covariances of the free numbers (k, k), from noise and from form, in mm of movement of the rim. [mm²]."""

    noise: Floats
    form: Floats

    @property
    def total(self) -> Floats:
        """Both together."""
        return self.noise + self.form


def plausible(radius: float) -> list[Zernike]:
    """Return the forms that a pose may be mistaken for, each 1 mm at the rim."""
    return [Zernike(terms={j: 1.0}, radius=radius, indexing="ansi", normalised=False) for j in FORMS]


def doubt(
    problem: Problem, found: Fit, free: Sequence[int], size: Floats, *, noise: float, count: int, form: float
) -> Doubt:
    r"""Return how uncertain the free numbers are.

    Noise of standard deviation s gives :math:`s^2 N^{-1}` with :math:`N = J W J^T`. A form error g moves the answer by
    :math:`N^{-1} J W g`; each of the plausible forms has the standard deviation ``form`` at the rim.

    Parameters
    ----------
    noise
        Standard deviation of a height [mm], independent from point to point over ``count`` points.
    """
    chosen = np.asarray(free, dtype=np.int64)
    unit = size[chosen]
    shapes = plausible(problem.within) if form > 0 else []
    normal = np.zeros((chosen.size, chosen.size))
    mixed = np.zeros((chosen.size, len(shapes)))
    used = 0
    for span in spans(problem.points.shape[1]):
        at = rows(problem, found.state, span)
        columns = at.columns[chosen] * unit[:, None]
        weighted = columns * weights(at.residual, found.scale, problem.loss)[0]
        normal += weighted @ columns.T
        used += at.which.size
        if shapes:
            x, y = np.ascontiguousarray(at.at[0]), np.ascontiguousarray(at.at[1])
            mixed += weighted @ np.stack([shape.evaluate(x, y, 0)[0] for shape in shapes], axis=-1)
    values, vectors = np.linalg.eigh(normal)
    fixed = values > NOTHING * max(values[-1], 1e-300)
    safe = np.where(fixed, values, 1.0)
    share = used / max(count, 1)
    variance = np.where(fixed, np.minimum(noise**2 / safe * share, ENDLESS**2), ENDLESS**2)
    moved = form * (vectors * np.where(fixed, 1 / safe, 0.0)) @ (vectors.T @ mixed)
    return Doubt((vectors * variance) @ vectors.T, moved @ moved.T)


def held(covariance: Floats, limit: float) -> tuple[Floats, list[int]]:
    """Return the directions whose standard deviation is beyond the limit, and numbers that hold them when fixed.

    Returns
    -------
    tuple
        Unit vectors (k, m), the worst first, and m of the k numbers: those that the directions move most.
    """
    from scipy.linalg import qr  # noqa: PLC0415 - scipy is costly to import

    values, vectors = np.linalg.eigh(covariance)
    weak = vectors[:, values > limit**2][:, ::-1]
    if weak.shape[1] == 0:
        return weak, []
    order = qr(weak.T, pivoting=True, mode="r")[1]
    return weak, [int(k) for k in order[: weak.shape[1]]]
