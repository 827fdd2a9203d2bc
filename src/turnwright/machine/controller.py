"""The controller: interpolation between points, and sign conventions of its axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, TypeAlias

from turnwright._arrays import Value
from turnwright._tables import TableModel
from turnwright._validate import check_angle, check_numbers, positive, whole_number
from turnwright.errors import InputError
from turnwright.units import Angle, Flag, Text, Time, plain

__all__ = ["INTERPOLATIONS", "Controller", "Convention"]

Sign: TypeAlias = Annotated[int, plain()]

INTERPOLATIONS = ("linear", "hermite", "quadratic spline", "cubic spline", "linuxcnc")
"""Interpolations of a controller, the first in the order of the kernel's constants."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Controller(TableModel, Value):
    """Interpolation of the points of a program by the controller.

    Parameters
    ----------
    interpolation
        "linear", "hermite" (PVT), "quadratic spline", "cubic spline" or "linuxcnc", see `track`.
    cycle
        Servo cycle, for the interpolation "linuxcnc". [s]
    look_ahead
        Number of blocks that the controller reads ahead, within which it must be able to brake; ``None`` for no limit.
    variable_speed
        Whether the spindle speed may differ from block to block, as in programs with block times or inverse time feed.
    other_interpolations
        Other interpolations that the controller offers, each with the program dialect that selects it; see
        `Machine.interpolating`.

    Raises
    ------
    InputError
        If the interpolation is unknown, or the look-ahead is below one block.
    """

    interpolation: Text = "linear"
    look_ahead: Annotated[int, plain()] | None = None
    variable_speed: Flag = False
    other_interpolations: Mapping[str, Text] = field(default_factory=dict)
    cycle: Time = 1e-3

    @property
    def is_straight(self) -> bool:
        """Whether axes move in straight lines between the points, or between servo cycles."""
        return self.interpolation in ("linear", "linuxcnc")

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.cycle, "cycle of the controller", "s")
        others = MappingProxyType(dict(self.other_interpolations))
        object.__setattr__(self, "other_interpolations", others)
        for name in (self.interpolation, *others):
            if name not in INTERPOLATIONS:
                raise InputError(f"interpolation is {name!r}, it must be one of {', '.join(INTERPOLATIONS)}: name one")
        if self.interpolation in others:
            raise InputError(
                f"other_interpolations has {self.interpolation!r}, which is the interpolation already: remove it"
            )
        if self.look_ahead is not None:
            object.__setattr__(self, "look_ahead", whole_number(self.look_ahead, "look_ahead", 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Convention(TableModel):
    """Signs and zero of the controller's axes relative to Turnwright's.

    Parameters
    ----------
    x_side
        +1 if the controller's X grows away from the axis on the side where the tool cuts, -1 if it falls.
    c_sense
        +1 if the controller's C grows with the azimuth of the part under the tool, -1 if it falls.
    z_sign
        +1 if the controller's Z grows out of the part, -1 if it grows into it.
    clocking
        The controller's C when the part's +x direction is under the tool. [rad]

    Raises
    ------
    InputError
        If a sign is neither +1 nor -1, or the clocking is not finite.
    """

    x_side: Sign = 1
    c_sense: Sign = 1
    z_sign: Sign = 1
    clocking: Angle = 0.0

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("x_side", "c_sense", "z_sign"):
            sign = getattr(self, name)
            if sign not in (-1, 1):
                raise InputError(f"{name} of the convention is {sign!r}, it must be the integer 1 or -1: give the sign")
        check_angle(self.clocking, "clocking of the convention")
