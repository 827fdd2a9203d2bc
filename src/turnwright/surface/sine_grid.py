"""The sinusoidal grid: two crossed sine waves."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from turnwright._arrays import Floats
from turnwright._kernels.sines import wave
from turnwright._validate import check_angle, check_numbers, finite_tuple, positive
from turnwright.surface.base import Surface
from turnwright.units import Angle, Length, Size

__all__ = ["SineGrid"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SineGrid(Surface):
    r"""A sinusoidal grid.

    .. math:: z = a_x \sin(2\pi x / p_x + \phi_x) + a_y \sin(2\pi y / p_y + \phi_y)

    Parameters
    ----------
    amplitude
        Amplitudes of the waves along x and y, half of their peak-to-valley. [mm]
    period
        Periods of the two waves. [mm]
    phase
        Phases of the two waves at the axis; pi/2 gives cosines. [rad]

    Raises
    ------
    InputError
        If a number is not finite, or a period is not positive.

    Sources
    -------
    [Li2018]_ Tables 2 and 3.

    >>> grid = SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5))
    >>> float(np.round(grid.sag(0.625, 0.625).item(), 12))   # both waves at their crest [mm]
    0.004
    """

    family = "sine grid"
    example = MappingProxyType({"amplitude": ["2 um", "2 um"], "period": ["2.5 mm", "2.5 mm"]})
    amplitude: tuple[Length, Length]
    period: tuple[Size, Size]
    phase: tuple[Angle, Angle] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("amplitude", "period", "phase"):
            object.__setattr__(self, name, finite_tuple(getattr(self, name), f"{name} of a sine grid", 2))
        for value, axis in zip(self.period, "xy", strict=True):
            positive(value, f"period of a sine grid along {axis}", "mm")
        for value, axis in zip(self.phase, "xy", strict=True):
            check_angle(value, f"phase of a sine grid along {axis}")

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives. See `Surface.evaluate`."""
        along_x, along_y = np.empty((order + 1, x.size)), np.empty((order + 1, x.size))
        for points, out, a, p, phase in zip(
            (x, y), (along_x, along_y), self.amplitude, self.period, self.phase, strict=True
        ):
            wave(points.ravel(), a, 2 * np.pi / p, phase, order, out)
        along_x[0] += along_y[0]
        flat = [along_x[0]]
        if order > 0:
            flat += [along_x[1], along_y[1]]
        if order > 1:
            flat += [along_x[2], np.zeros(x.size), along_y[2]]
        return tuple(part.reshape(x.shape) for part in flat)

    @property
    def feature_size(self) -> float:
        """An eighth of the shorter period with an amplitude above 0. [mm]."""
        periods = [p for a, p in zip(self.amplitude, self.period, strict=True) if a]
        return min(periods, default=float("inf")) / 8
