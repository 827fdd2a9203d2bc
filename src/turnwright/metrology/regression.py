"""Gaussian regression on even grids: at every point the polynomial that fits its weighted surroundings best.

The sums a fit needs, of weight, of powers of the distance and of heights, are convolutions with a Gaussian times such
powers. They are separable and have next to no content at high frequencies, so they go by Fourier transforms of lines,
padded so that nothing wraps, of which only the low frequencies are kept. Both cuts are below the rounding of doubles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turnwright._arrays import Floats
from turnwright._kernels.regression import solve
from turnwright.progress import run_chunks

GAUSSIAN_WIDTHS = (float(np.sqrt(np.log(2) / np.pi)),) * 2 + (0.7309134280946758,)
"""Width of the Gaussian relative to the cutoff, by order of the polynomial: exp(-pi a²) = 1/2 for orders 0 and 1,
(1 + pi a²) exp(-pi a²) = 1/2 for order 2."""

KERNEL_REACH = 3.7
"""Widths at which the Gaussian is cut off, in space and in frequency: exp(-pi 3.7²) = 2e-19."""

RELATIVE_TOL, ABSOLUTE_TOL = 1e-6, 1e-10
"""Determination of a term, relative to the local weight and to all weight, below which the term is left out."""

CHUNK_ROWS = 8
CHUNK_COLUMNS = 64
"""Lines transformed at a time, so that they stay in the cache."""

Spectrum = NDArray[np.complex128]


class Axis(NamedTuple):
    """How an axis is transformed: its padded length, and the spectra of Gaussian times powers of the distance."""

    length: int
    bins: int
    spectra: list[Spectrum]


def regress(z: Floats, weight: Floats, widths: tuple[float, float | None], order: int) -> Floats:
    """Return the constant term of the local polynomial at every point, nan where nothing determines it.

    Parameters
    ----------
    z
        Heights, finite also where they weigh nothing. (ny, nx)
    weight
        Of each height, from 0 to 1. (ny, nx)
    widths
        Of the Gaussian along the columns and along the rows, ``None`` to take every row for itself. [points]
    order
        Total degree of the polynomial.
    """
    from scipy import fft  # noqa: PLC0415 - only this needs it

    count, n = z.shape
    x = _axis(n, widths[0], 2 * order, real=True)
    y = None if widths[1] is None else _axis(count, widths[1], 2 * order, real=False)
    # The constant stands last; see the kernel.
    terms = [(i, s - i) for s in range(order, -1, -1) for i in range(s, -1, -1) if y is not None or i == s]
    needed = sorted({(a + c, b + d) for a, b in terms for c, d in terms})
    pairs = np.array([[needed.index((a + c, b + d)) for c, d in terms] for a, b in terms])
    nominal = np.array([_nominal(2 * i) * _nominal(2 * j) for i, j in terms])

    heights, weights = (np.empty((count, x.bins), dtype=np.complex128) for _ in range(2))

    def forward(start: int, stop: int) -> None:
        rows = slice(start, stop)
        heights[rows] = fft.rfft(z[rows] * weight[rows], x.length, axis=1)[:, : x.bins]
        weights[rows] = fft.rfft(weight[rows], x.length, axis=1)[:, : x.bins]

    run_chunks(forward, count, CHUNK_ROWS)
    if y is None:
        along_heights, along_weights = [heights], [weights]
    else:
        along_heights = [np.empty_like(heights) for _ in range(order)] + [heights]
        along_weights = [np.empty_like(heights) for _ in range(2 * order)] + [weights]

        def across(start: int, stop: int) -> None:
            columns = slice(start, stop)
            for source, targets in ((heights, along_heights), (weights, along_weights)):
                spectrum = fft.fft(source[:, columns], y.length, axis=0)
                for kernel, target in zip(y.spectra, targets, strict=False):
                    target[:, columns] = fft.ifft(spectrum * kernel[:, None], axis=0)[:count]

        run_chunks(across, x.bins, CHUNK_COLUMNS)
    out = np.empty_like(z)

    def backward(start: int, stop: int) -> None:
        rows = slice(start, stop)

        def sums(spectra: list[Spectrum], powers: list[tuple[int, int]]) -> Floats:
            values = np.empty((len(powers), stop - start, n))
            for value, (i, j) in zip(values, powers, strict=True):
                value[:] = fft.irfft(spectra[j][rows] * x.spectra[i], x.length, axis=1, overwrite_x=True)[:, :n]
            return values.reshape(len(powers), -1)

        solve(
            sums(along_weights, needed), sums(along_heights, terms), pairs, nominal, RELATIVE_TOL, ABSOLUTE_TOL,
            out[rows].reshape(-1),
        )  # fmt: skip

    run_chunks(backward, count, CHUNK_ROWS)
    return out


def _nominal(power: int) -> float:
    """Return the integral of the Gaussian times an even power of the distance."""
    return {0: 1.0, 2: 1 / (2 * np.pi), 4: 3 / (4 * np.pi**2)}[power]


def _axis(n: int, width: float, powers: int, *, real: bool) -> Axis:
    """Sample the Gaussian times powers of the distance around the first of ``n`` points, and transform it."""
    from scipy import fft  # noqa: PLC0415 - only this needs it

    half = int(KERNEL_REACH * width)
    length = fft.next_fast_len(max(n + half, 2 * half + 1), real=real)
    u = np.arange(-half, half + 1) / width
    bell = np.exp(-np.pi * u * u) / width
    count = min(length // 2, int(KERNEL_REACH * length / width)) + 1
    spectra = []
    for power in range(powers + 1):
        kernel = np.zeros(length)
        kernel[: half + 1] = (bell * u**power)[half:]
        kernel[length - half :] = (bell * u**power)[:half]
        spectra.append(fft.rfft(kernel)[:count] if real else fft.fft(kernel))
    return Axis(length, count, spectra)
