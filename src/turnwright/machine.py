"""The lathe: what its axes can do, how they err, and how its controller counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Floats, frozen

__all__ = ["Axis", "Convention", "Machine"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """Limits of one axis; ``None`` is a limit that nobody states.

    Parameters
    ----------
    speed, acceleration, jerk
        Largest magnitude, in mm or rad and s.
    low, high
        Ends of the travel. [mm or rad]
    """

    speed: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Convention:
    """How the controller counts, against Turnwright's own axes.

    Parameters
    ----------
    x_side
        +1 if the controller's X grows away from the axis on the side where the tool cuts, -1 if it falls.
    c_sense
        +1 if the controller's C grows with the azimuth of the part under the tool, -1 if it falls.
    z_sign
        +1 if the controller's Z grows out of the part, -1 if it grows into it.
    clocking
        Controller's C when the part's +x mark stands under the tool. [rad]
    """

    x_side: int = 1
    c_sense: int = 1
    z_sign: int = 1
    clocking: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Machine:
    """A lathe with a C axis.

    Parameters
    ----------
    name
        What the machine is called.
    axes
        `Axis` by letter, at least "C", "X" and "Z".
    spindle_rpm
        Highest speed of the spindle as a C axis. [rev/min]
    block_rate_hz
        Program blocks that the controller can take in a second, coordinated over all axes.
    dialect
        Name of the program dialect.
    convention
        How the controller counts.
    squareness
        Height error of the tip per distance along X: Z error = squareness * X. [rad]
    straightness
        Height error of the tip along X beyond squareness: positions and errors, linear in between, held beyond.
        ((n,), (n,)) [mm]
    sources
        Where each fact comes from, by field; anything assumed says so.
    """

    name: str
    axes: Mapping[str, Axis]
    spindle_rpm: float
    block_rate_hz: float
    dialect: str = "generic"
    convention: Convention = Convention()
    squareness: float = 0.0
    straightness: tuple[Floats, Floats] | None = None
    sources: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", MappingProxyType(dict(self.axes)))
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))
        if self.straightness is not None:
            x, dz = self.straightness
            object.__setattr__(self, "straightness", (frozen(x, "straightness x"), frozen(dz, "straightness dz")))

    def z_error(self, x: ArrayLike) -> Floats:
        """Height of the tip where X stands at ``x``, minus what it should be. (n,) [mm]."""
        x = np.asarray(x, dtype=np.float64)
        error = self.squareness * x
        if self.straightness is not None:
            error = error + np.interp(x, *self.straightness)
        return error
