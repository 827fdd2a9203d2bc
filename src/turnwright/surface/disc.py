"""Sums of polynomials on a disc by azimuthal order, for Zernike and Forbes surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints, frozen

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["DiscSum", "disc_sum"]


class DiscSum(NamedTuple):
    """Tables for the kernel `_kernels.polynomials.disc`."""

    recurrence: Floats
    coefficients: Floats
    sizes: Ints


def disc_sum(series: Mapping[int, Floats]) -> DiscSum:
    r"""Return the kernel's tables for a sum over azimuthal orders.

    .. math:: \sum_{m \ge 0} \Re w^m F_m(s) + \sum_{m < 0} \Im w^{|m|} F_m(s), \qquad
              F_m(s) = \sum_k c_k P_k^{(0, |m|)}(2s - 1), \quad s = |w|^2

    Parameters
    ----------
    series
        Jacobi coefficients c by the order m, negative for the sine.

    Sources
    -------
    [DLMF]_ 18.9.2, with the coefficients of Table 18.9.1. A power series would cancel: its error at degree 40 is 1e-3.
    """
    orders = 1 + max((abs(m) for m in series), default=0)
    count = max((len(c) for c in series.values()), default=0)
    sizes = np.zeros((2, orders), dtype=np.int64)
    coefficients = np.zeros((2, orders, max(count, 1)))
    for order, row in series.items():
        sizes[int(order < 0), abs(order)] = len(row)
        coefficients[int(order < 0), abs(order), : len(row)] = row
    m, k = np.arange(orders, dtype=np.float64)[:, None], np.arange(count + 1, dtype=np.float64)
    n = 2 * k + m
    divisor = (k + 1) * (k + m + 1)
    b = (n + 1) * (n + 2) / divisor
    # The general formula is 0/0 at k = m = 0; k = 0 has a simple form.
    safe = np.where(k > 0, n, 1.0)
    a = np.where(k > 0, -b / 2 - (n + 1) * m * m / (2 * divisor * safe), -(m + 1))
    c = np.where(k > 0, k * (k + m) * (n + 2) / (divisor * safe), 0.0)
    sizes.flags.writeable = False
    return DiscSum(
        recurrence=frozen(np.stack([a, b, c]), "recurrence", ndim=3),
        coefficients=frozen(coefficients, "coefficients", ndim=3),
        sizes=sizes,
    )
