"""Spindle speed over the radius."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np
from annotated_types import MinLen

from turnwright._arrays import Floats, Value, freeze
from turnwright._validate import check_numbers
from turnwright.errors import InputError
from turnwright.units import Speed, Thickness, write

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema

__all__ = ["SpeedProfile", "Speeds", "check_one_speed", "time_over_angle"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpeedProfile(Value):
    r"""Spindle speed over the radius, for a controller that can vary it.

    Between two radii :math:`\omega^2` is linear in the radius, so that at a constant feed the spindle accelerates
    uniformly in time; beyond the ends the speed is constant.

    Parameters
    ----------
    radius
        Positions of X, ascending. (n,) [mm]
    spindle_rpm
        Spindle speed at these positions. (n,) [rev/min]

    Raises
    ------
    InputError
        If the radii do not ascend, or a speed is not positive.

    >>> profile = SpeedProfile(radius=[1.0, 2.0], spindle_rpm=[500.0, 100.0])
    >>> (profile.at(np.array([0.0, 1.0, 1.5, 3.0])) * 60 / (2 * np.pi)).round(3).tolist()
    [500.0, 500.0, 360.555, 100.0]
    """

    radius: Floats
    spindle_rpm: Floats

    def __post_init__(self) -> None:
        check_numbers(self)
        freeze(self, ("radius", "spindle_rpm"))
        if not self.radius.size:
            raise InputError("a speed profile has 0 radii, it needs at least 1: give a radius and its spindle speed")
        if not (self.radius[1:] > self.radius[:-1]).all():
            raise InputError("the radii of a speed profile do not ascend: sort them and remove repeated radii")
        if not (self.spindle_rpm > 0).all():
            raise InputError(
                f"spindle_rpm of a speed profile is {self.spindle_rpm.min():g} rev/min, it must be above 0 rev/min: "
                "increase it"
            )

    def at(self, radius: Floats) -> Floats:
        """Return the spindle speed at positions of X. (n,) [rad/s]."""
        omega: Floats = np.sqrt(np.interp(radius, self.radius, (self.spindle_rpm * (2 * np.pi / 60)) ** 2))
        return omega


def time_over_angle(angle: Floats, omega: Floats) -> Floats:
    """Return the time at angles that grow, at speeds with a constant acceleration in between. (n,) [s].

    ``angle`` [rad] and ``omega`` [rad/s] are (n,).
    """
    return np.concatenate([[0.0], np.cumsum(2 * np.diff(angle) / (omega[1:] + omega[:-1]))])


def check_one_speed(owner: Any) -> None:
    """Raise if a strategy or a pass states both one spindle speed and a speed over the radius."""
    if owner.spindle_rpm is not None and owner.spindle_speeds is not None:
        raise InputError("spindle_speed and spindle_speeds are both given, only one can be right: remove one")


class _Pairs:
    """Annotation of a speed profile that a file has as pairs of a radius and the spindle speed there."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        def read(value: Any, pairs: Any) -> SpeedProfile:
            if isinstance(value, SpeedProfile):
                return value
            radius, speed = np.array(pairs(value), dtype=np.float64).reshape(-1, 2).T
            return SpeedProfile(radius=radius, spindle_rpm=speed)

        def written(profile: SpeedProfile) -> list[list[str]]:
            pairs = zip(profile.radius.tolist(), profile.spindle_rpm.tolist(), strict=True)
            return [[write(radius, "mm"), write(speed, "rpm")] for radius, speed in pairs]

        return core_schema.no_info_wrap_validator_function(
            read,
            handler.generate_schema(Annotated[tuple[tuple[Thickness, Speed], ...], MinLen(2)]),
            serialization=core_schema.plain_serializer_function_ser_schema(written),
        )


Speeds: TypeAlias = Annotated[SpeedProfile, _Pairs]
