"""Least squares over the points of any map: in chunks, on all cores, with uncertainties."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from threading import Lock
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import least_squares
from turnwright.errors import InputError
from turnwright.metrology.grid import measure
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

CHUNK_POINTS = 8000
"""Points processed at a time, so that a few dozen terms stay in the cache."""

MAX_CONDITION = 1e7
"""Condition number beyond which the normal equations have no correct digit."""

Model: TypeAlias = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""From x, y and z (n,) to the derivatives by each parameter (k, n) and the residual (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """Positions and weights of the used points of a map; the weights are areas with a mean of 1 over the grid."""

    heights: HeightMap
    used: Bools
    columns: Floats  # axis of a grid, or x of scattered points
    rows: Floats
    column_weight: Floats
    row_weight: Floats

    @classmethod
    def of(cls, heights: HeightMap, used: Bools) -> Cloud:
        """Weight the points of a grid by area; scattered points equally."""
        if heights.scattered:
            heights.require_calibrated()
            x, y = heights.points()
            one = np.ones(1)
            return cls(heights=heights, used=used, columns=x, rows=y, column_weight=one, row_weight=one)
        grid = measure(heights)
        return cls(
            heights=heights,
            used=used,
            columns=grid.columns,
            rows=grid.rows,
            column_weight=grid.column_area / grid.column_area.mean(),
            row_weight=grid.row_width / grid.row_width.mean(),
        )

    @property
    def even(self) -> bool:
        """Whether all points have equal weights."""
        return all(np.ptp(weight) <= 1e-6 * weight.max() for weight in (self.column_weight, self.row_weight))

    def thinned(self, count: int) -> Cloud:
        """Return about ``count`` of the points, evenly spaced in rows and columns."""
        number = int(np.count_nonzero(self.used))
        if number <= count:
            return self
        used = np.zeros_like(self.used)
        if self.heights.scattered:
            used[np.flatnonzero(self.used)[:: -(-number // count)]] = True
        else:
            step = int(np.ceil(np.sqrt(number / count)))
            used[::step, ::step] = self.used[::step, ::step]
        return replace(self, used=used)

    @property
    def chunk(self) -> int:
        """Number of rows, or of scattered points, in a chunk."""
        return CHUNK_POINTS if self.heights.scattered else max(CHUNK_POINTS // self.columns.size, 1)

    def take(self, start: int, stop: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Return x, y, z and the weights of the points used in some rows. Each (n,)."""
        rows = slice(start, stop)
        used = self.used[rows]
        z = self.heights.z[rows][used]
        if self.heights.scattered:
            return self.columns[rows][used], self.rows[rows][used], z, np.ones(z.size)
        weight = (self.row_weight[rows, None] * self.column_weight)[used]
        row, column = self.rows[rows, None], self.columns
        if self.heights.polar:
            return (np.cos(row) * column)[used], (np.sin(row) * column)[used], z, weight
        x, y = np.broadcast_arrays(column, row)
        return x[used], y[used], z, weight

    @property
    def ends(self) -> tuple[Floats, Floats]:
        """First and last used point of every row, or all scattered points: their hull is that of all points."""
        if self.heights.scattered:
            return self.columns[self.used], self.rows[self.used]
        some = np.flatnonzero(self.used.any(axis=1))
        first = self.used[some].argmax(axis=1)
        last = self.used.shape[1] - 1 - self.used[some, ::-1].argmax(axis=1)
        row, column = np.tile(self.rows[some], 2), self.columns[np.concatenate([first, last])]
        return (np.cos(row) * column, np.sin(row) * column) if self.heights.polar else (column, row)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sums:
    """Sums over all points: normal matrix, right-hand side, weights and squares."""

    normal: Floats
    spread: Floats  # the normal matrix with squared weights
    right: Floats
    weight: float
    square: float
    count: int

    @property
    def rms(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(self.square / self.weight))

    def covariance(self) -> Floats:
        """Covariance of the parameters for independent noise, equal at all points, estimated from the residual.

        Weights are areas, not inverse variances, so the covariance is A⁻¹ B A⁻¹ with A = X'WX and B = X'W²X.
        """
        inverse = self._inverse
        freedom = self.weight - np.trace(inverse @ self.spread)
        noise = self.square / freedom if self.count > self.normal.shape[0] and freedom > 0 else np.nan
        return self.noise_gain() * noise

    def noise_gain(self) -> Floats:
        """Covariance of the parameters for independent noise of variance 1 at all points."""
        return np.asarray(self._inverse @ self.spread @ self._inverse)

    @property
    def _inverse(self) -> Floats:
        scale = 1 / np.sqrt(np.diag(self.normal))
        return np.asarray(np.linalg.inv(self.normal * scale * scale[:, None]) * scale * scale[:, None])


def sums_over(
    cloud: Cloud,
    model: Model,
    parameters: Floats,
    *,
    whole: bool = True,
    left: Floats | None = None,
) -> Sums:
    """Sum over the points of a cloud.

    Parameters
    ----------
    model
        Returns derivatives and residuals.
    parameters
        Parameters of a linear model whose terms are subtracted too; else zeros. (k,)
    whole
        Whether to compute the normal matrix; else it is zeros.
    left
        Filled with the residual at the used points.

    Raises
    ------
    InputError
        If a sum is not finite, because the heights are too far from the form.
    """
    k = parameters.size
    padded = k + -k % 4
    padded_parameters = np.zeros(padded)
    padded_parameters[:k] = parameters
    normal, spread, right = np.zeros((padded, padded)), np.zeros((padded, padded)), np.zeros(padded)
    totals = np.zeros(3)
    even, lock = cloud.even, Lock()

    @np.errstate(all="ignore")  # sums that are not finite raise an error below
    def work(start: int, stop: int) -> None:
        x, y, z, weight = cloud.take(start, stop)
        if z.size == 0:
            return
        derivatives, residual = model(x, y, z)
        terms = derivatives
        if derivatives.shape[0] != padded:
            terms = np.zeros((padded, z.size))
            terms[:k] = derivatives
        values = np.array(residual)
        mine, mine_spread, mine_right = np.zeros_like(normal), np.zeros_like(normal), np.zeros(padded)
        least_squares.gram(terms, weight, values, padded_parameters, mine, mine_right, whole)
        if whole and not even:
            least_squares.gram(
                terms, weight * weight, values.copy(), np.zeros(padded), mine_spread, mine_right * 0, True
            )
        with lock:
            normal[...] += mine
            spread[...] += mine_spread
            right[...] += mine_right
            totals[...] += np.array([weight.sum(), weight @ values**2, z.size])
        if left is not None:
            left[start:stop][cloud.used[start:stop]] = values

    run_chunks(work, cloud.used.shape[0], cloud.chunk)
    normal, spread = (np.tril(one) + np.tril(one, -1).T for one in (normal[:k, :k], spread[:k, :k]))
    if not all(np.isfinite(total).all() for total in (normal, spread, right[:k], totals)):
        raise InputError(
            "the heights are so far from the fitted form that the sums of squares exceed 1e308: fit another form, or "
            "remove outliers"
        )
    return Sums(
        normal=normal,
        spread=normal * float(totals[0] / max(totals[2], 1)) if even else spread,
        right=right[:k],
        weight=float(totals[0]),
        square=float(totals[1]),
        count=int(totals[2]),
    )


def clustered_covariance(slopes: Floats, residual: Floats, weight: Floats, blocks: Ints, terms: int) -> Floats:
    """Return the covariance of fitted parameters for errors correlated within blocks. (k, k).

    The fit of so many terms has reduced the scatter of the blocks in proportion to their number.
    """
    weighted = slopes * weight[:, None]
    inverse = np.linalg.pinv(weighted.T @ slopes, rcond=1e-15)
    score = np.stack([np.bincount(blocks, weights=column * residual) for column in weighted.T], axis=1)
    count = int(np.count_nonzero(np.bincount(blocks)))
    return np.asarray(inverse @ (score.T @ score) @ inverse * (count / max(count - terms, 1)))


def solve(normal: Floats, right: Floats, names: Sequence[str], what: str) -> tuple[Floats, float]:
    """Return the solution of the normal equations, and the condition number of the terms scaled to unit length.

    Raises
    ------
    InputError
        If the points do not determine the parameters; the message names them.
    """
    length = np.sqrt(np.diag(normal))
    blind = [name for name, size in zip(names, length, strict=True) if not size > 0]
    if blind:
        raise InputError(
            f"the valid heights do not determine {', '.join(blind)} of {what}: fix these parameters or leave them out"
        )
    values, vectors = np.linalg.eigh(normal / length / length[:, None])
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-300)))
    if condition > MAX_CONDITION:
        share = np.abs(vectors[:, 0])
        confused = [names[i] for i in np.argsort(-share)[:6] if share[i] > 0.1]
        raise InputError(
            f"the heights cannot separate {', '.join(confused)} of {what} (condition {condition:.1e}, the limit is "
            f"{MAX_CONDITION:.0e}): fix one of them or leave it out, or measure more of the part"
        )
    return vectors @ (vectors.T @ (right / length) / values) / length, condition
