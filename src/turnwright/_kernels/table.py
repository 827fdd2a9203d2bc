"""Rows of whole numbers as lines of decimals with commas between them."""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.text import ONE, U, write_fixed


@jit
def format_rows(rows, decimals, out):
    """Write rows (n, k), in units of their last decimal, as text into ``out``; return its length in bytes."""
    at = U(0)
    last = rows.shape[1] - 1
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            at = write_fixed(out, at, rows[i, k], decimals[k])
            out[at] = 44 if k < last else 10
            at += ONE
    return np.int64(at)
