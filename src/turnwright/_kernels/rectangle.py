"""The largest rectangle without a hole."""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit

__all__ = ["largest_rectangle"]


@jit
def largest_rectangle(valid, step_x, step_y):
    """Return (row, rows, column, columns) of the largest rectangle of valid points, by area; zeros if there is none.

    For each row the heights of the columns of valid points above it; a stack holds those that still grow, so that each
    column is pushed and popped once a row.
    """
    rows, columns = valid.shape
    tall = np.zeros(columns + 1, dtype=np.int64)
    start = np.empty(columns + 1, dtype=np.int64)
    height = np.empty(columns + 1, dtype=np.int64)
    best = 0.0
    row = count = column = width = 0
    for i in range(rows):
        for j in range(columns):
            tall[j] = tall[j] + 1 if valid[i, j] else 0
        top = 0
        for j in range(columns + 1):
            leftmost = j
            while top > 0 and height[top - 1] > tall[j]:
                top -= 1
                leftmost = start[top]
                area = height[top] * step_y * (j - leftmost) * step_x
                if area > best:
                    best, row, count, column, width = area, i - height[top] + 1, height[top], leftmost, j - leftmost
            if tall[j] > 0 and (top == 0 or height[top - 1] < tall[j]):
                start[top], height[top] = leftmost, tall[j]
                top += 1
    return row, count, column, width
