"""Autocorrelation of a map with missing points, and the lags at which it has fallen (ISO 25178-2:2021, 4.3)."""

from __future__ import annotations

import math

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.progress import run_chunks

__all__ = ["DECAY_THRESHOLD", "autocorrelation", "decay"]

DECAY_THRESHOLD = 0.2
"""Autocorrelation at which Sal and Str are read (ISO 25178-3)."""

MIN_OVERLAP_SHARE = 0.1
"""Share of the valid points that must overlap at a lag for its autocorrelation to count."""

CHUNK_LINES = 64
"""Lines of the map that a thread transforms at once."""

PLACES_AT_ONCE = 2048
"""Places of rays at which the autocorrelation is evaluated at once."""

SPLINE_POLE = math.sqrt(3) - 2
SPLINE_MARGIN = 28
"""Pole of the filter for cubic splines, and points after which it has decayed to the rounding."""


def autocorrelation(z: Floats) -> tuple[Floats, Bools]:
    """Return the autocorrelation up to lags of half the field, lag 0 in the middle, and where enough points overlap."""
    reach = z.shape[0] // 2, z.shape[1] // 2
    valid = ~np.isnan(z)
    if valid.all():
        lags = [size - np.abs(np.arange(-lag, lag + 1)) for size, lag in zip(z.shape, reach, strict=True)]
        overlap = np.multiply.outer(*lags).astype(np.float64)
    else:
        overlap = np.rint(_correlate(valid.astype(np.float64), reach))
    product = _correlate(np.where(valid, z - np.nanmean(z), 0.0), reach) / np.maximum(overlap, 1)
    has_overlap = overlap >= max(MIN_OVERLAP_SHARE * np.count_nonzero(valid), 1)
    # Unknown values count as correlated, so that a hole does not look like the end of the lay.
    return np.where(has_overlap, product / product[reach], 1.0), has_overlap


def _correlate(values: Floats, reach: tuple[int, int]) -> Floats:
    """Return the sums of the products of values at all lags up to a reach, lag 0 in the middle."""
    tall, wide = (_fast_length(size + lag) for size, lag in zip(values.shape, reach, strict=True))
    spectrum = np.zeros((tall, wide // 2 + 1), dtype=np.complex128)
    rows, columns = (np.arange(-lag, lag + 1) for lag in reach)
    sums = np.empty((rows.size, columns.size))

    def transform_rows(start: int, stop: int) -> None:
        spectrum[start:stop] = np.fft.rfft(values[start:stop], wide)

    def correlate_columns(start: int, stop: int) -> None:
        some = np.fft.fft(spectrum[:, start:stop], axis=0)
        spectrum[:, start:stop] = np.fft.ifft(some.real**2 + some.imag**2, axis=0)

    def transform_back(start: int, stop: int) -> None:
        sums[start:stop] = np.fft.irfft(spectrum[rows[start:stop]], wide)[:, columns]

    for work, lines in (
        (transform_rows, values.shape[0]), (correlate_columns, spectrum.shape[1]), (transform_back, rows.size),
    ):  # fmt: skip
        run_chunks(work, lines, CHUNK_LINES)
    return sums


def _fast_length(least: int) -> int:
    """Return the least product of 2, 3 and 5 that is no smaller, of which the transform is fast.

    >>> _fast_length(1201)
    1215
    """
    odd = [int(3**i * 5**j) for i in range(least.bit_length()) for j in range(least.bit_length())]
    return min(one << max(-(-least // one) - 1, 0).bit_length() for one in odd)


def decay(correlation: Floats, known: Bools, dx: float, dy: float) -> tuple[Floats, Bools]:
    """Return how far the autocorrelation stays above `DECAY_THRESHOLD` along rays, and whether it falls. (n,) [mm].

    The rays end half a pixel apart on the border. Each is searched every half pixel and then bisected.
    """
    reach_y, reach_x = np.array(correlation.shape) // 2
    coefficients = _spline(correlation)
    half_x, half_y = np.arange(-reach_x, reach_x, 0.5), np.arange(-reach_y, reach_y, 0.5)
    ends_y = np.concatenate([np.full_like(half_x, reach_y), half_y])
    ends_x = np.concatenate([half_x, np.full_like(half_y, reach_x)])

    def at(rays: Ints, share: Floats | float) -> Floats:
        return _spline_at(coefficients, reach_y + ends_y[rays] * share, reach_x + ends_x[rays] * share)

    steps = 2 * int(max(reach_x, reach_y))
    share = np.ones(ends_x.size)
    fallen = np.zeros(ends_x.size, dtype=bool)
    rays, begin = np.arange(ends_x.size, dtype=np.int64), 0
    while rays.size and begin < steps:
        # Several steps at once where few rays are left: each call takes as long as some hundred points.
        each = np.arange(begin + 1, min(begin + max(PLACES_AT_ONCE // rays.size, 1), steps) + 1)
        ray, along = np.repeat(rays, each.size), np.tile(each / steps, rays.size)
        row = np.rint(reach_y + ends_y[ray] * along).astype(np.intp)
        column = np.rint(reach_x + ends_x[ray] * along).astype(np.intp)
        lost = ~known[row, column].reshape(rays.size, each.size)
        ends = lost | (at(ray, along).reshape(lost.shape) <= DECAY_THRESHOLD)
        first = ends.argmax(axis=1)
        done = np.flatnonzero(ends.any(axis=1))
        unknown = lost[done, first[done]]
        share[rays[done]] = (begin + first[done] + np.where(unknown, 0, 1)) / steps
        fallen[rays[done]] = ~unknown
        rays, begin = np.delete(rays, done), int(each[-1])
    ended = np.flatnonzero(fallen).astype(np.int64)
    low_end, high_end = share[ended] - 1 / steps, share[ended].copy()
    for _ in range(40):
        middle = (low_end + high_end) / 2
        below = at(ended, middle) <= DECAY_THRESHOLD
        high_end = np.where(below, middle, high_end)
        low_end = np.where(below, low_end, middle)
    share[ended] = (low_end + high_end) / 2
    return share * np.hypot(ends_x * dx, ends_y * dy), fallen


def _spline(values: Floats) -> Floats:
    """Return the coefficients of the cubic spline through values that are mirrored at their borders [Unser1999]_.

    Beyond each border it has two more.
    """
    spread = np.pad(values, SPLINE_MARGIN, mode="symmetric")
    for _ in range(2):
        spread = np.ascontiguousarray(spread.T)
        for k in range(1, spread.shape[0]):
            spread[k] += SPLINE_POLE * spread[k - 1]
        for k in range(spread.shape[0] - 2, -1, -1):
            np.subtract(spread[k + 1], spread[k], out=spread[k])
            spread[k] *= SPLINE_POLE
        spread *= 6.0
    inside = slice(SPLINE_MARGIN - 2, 2 - SPLINE_MARGIN)
    return np.ascontiguousarray(spread[inside, inside])


def _spline_at(coefficients: Floats, row: Floats, column: Floats) -> Floats:
    """Return the values of a spline at places within the borders of its values. (n,)."""
    first_row, first_column = row.astype(np.intp), column.astype(np.intp)
    # The four coefficients around a place in each direction, of which the first is one before it.
    first = (first_row + 1) * coefficients.shape[1] + first_column + 1
    around = np.add.outer(np.arange(4) * coefficients.shape[1], np.arange(4))
    taken = coefficients.take(around[..., np.newaxis] + first)
    return np.asarray(np.einsum("in,jn,ijn->n", _basis(row - first_row), _basis(column - first_column), taken))


def _basis(share: Floats) -> Floats:
    """Return the weights of four coefficients at a share of the way from the second to the third. (4, n)."""
    to_third = 1 - share
    return np.stack([to_third**3, 4 - 3 * share**2 * (1 + to_third), 4 - 3 * to_third**2 * (1 + share), share**3]) / 6
