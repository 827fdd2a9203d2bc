"""Interpolate a motion as the controller does, in linear segments too short to show in a predicted map."""

from __future__ import annotations

from turnwright._arrays import only_read
from turnwright._kernels.tracking import bulge
from turnwright.machine import ROTARY, Machine
from turnwright.path import Motion
from turnwright.progress import Progress
from turnwright.tracking import track

__all__ = ["CHORD_TOL", "chord_error", "interpolate_motion"]

CHORD_TOL = 1e-8
"""Distance between linear segments and the controller's curves that does not show in a map. [mm]"""

MAX_CHORD = 1e-6
"""The same for a motion with so many points that `CHORD_TOL` would need too much memory. [mm]"""

MAX_SEGMENTS = 5_000_000
"""Segments up to which `CHORD_TOL` is used: 160 MB for the time and three axes."""


def interpolate_motion(motion: Motion, machine: Machine, progress: Progress | None = None) -> Motion:
    """Return the real axes in linear segments within 0.01 nm of the controller's curves, or as close as memory allows.

    Where the controller moves in straight lines the segments of `track` are sufficient.
    """
    real = track(motion, machine, chord=MAX_CHORD, progress=progress)
    if machine.controller.is_straight:
        return real
    off = chord_error(real)
    # The distance falls with the square of the number of segments.
    chord = max(CHORD_TOL, off * (real.time.size / MAX_SEGMENTS) ** 2)
    return real if chord >= min(off, MAX_CHORD) else track(motion, machine, chord=chord, progress=progress)


def chord_error(motion: Motion) -> float:
    """Return the largest distance between the linear segments of a motion and a smooth curve through them. [mm]."""
    time = only_read(motion.time)
    return max(float(bulge(time, only_read(one))) for letter, one in motion.axes.items() if letter not in ROTARY)
