"""The hash of a pass, over its numbers as written in the program."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright._kernels import text

if TYPE_CHECKING:
    from turnwright._arrays import Floats, Ints

__all__ = ["hashed_rows"]


def hashed_rows(units: Ints, duration: Floats) -> memoryview:
    """Return the bytes to hash for points, see `ProgramPass`.

    Parameters
    ----------
    units
        Words without their decimal points, in the order in which they are written. (n, k)
    duration
        Duration of the block that ends at the point; 0 at the first. (n,) [s]
    """
    packed = np.empty((units.shape[0], units.shape[1] + 1), dtype=np.uint32)
    text.pack(units, duration.view(np.int64), packed)
    return packed.astype("<u4", copy=False).data.cast("B")
