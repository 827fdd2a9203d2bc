"""What a controller makes of a motion, as straight pieces so short that a predicted map does not show them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turnwright._arrays import only_read
from turnwright._kernels.tracking import bulge
from turnwright.machine import ROTARY
from turnwright.tracking import track

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.path import Motion
    from turnwright.progress import Progress

__all__ = ["UNSEEN", "interpolated", "off_curves"]

UNSEEN = 1e-8
"""Distance between straight pieces and the controller's curves that no map shows. [mm]"""

COARSEST = 1e-6
"""The same for a motion of so many points that it cannot be kept. [mm]"""

MOST_PIECES = 5_000_000
"""Pieces up to which it is kept: 160 MB for the time and three axes."""


def interpolated(motion: Motion, machine: Machine, progress: Progress | None = None) -> Motion:
    """Return the real axes in straight pieces within 0.01 nm of the controller's curves, or as near as memory allows.

    Lines are straight already: a controller that interpolates linearly needs no more pieces than `track` takes.

    Parameters
    ----------
    motion, machine, progress
        See `track`.
    """
    made = track(motion, machine, chord=COARSEST, progress=progress)
    if machine.controller.interpolation == "linear":
        return made
    off = off_curves(made)
    # The distance falls with the square of the number of pieces.
    chord = max(UNSEEN, off * (made.time.size / MOST_PIECES) ** 2)
    return made if chord >= min(off, COARSEST) else track(motion, machine, chord=chord, progress=progress)


def off_curves(motion: Motion) -> float:
    """Return how far the straight pieces of a motion are from a smooth one through their ends. [mm]."""
    time = only_read(motion.time)
    return max(float(bulge(time, only_read(one))) for letter, one in motion.axes.items() if letter not in ROTARY)
