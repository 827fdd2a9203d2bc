"""The axes of a lathe: travel, limits and servo response."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Floats
from turnwright._tables import TableModel, refuse
from turnwright._validate import between, check_numbers, positive
from turnwright.errors import InputError, UnitError
from turnwright.machine.responses import AnyResponse, Response
from turnwright.units import Frequency, Time, parse, unit

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema

__all__ = ["ROTARY", "Axes", "Axis"]

ROTARY = frozenset("ABC")
"""Letters of the rotary axes; all others are linear."""

FAST = MappingProxyType({"U": "X", "W": "Z"})
"""Letters of the axes of a fast tool, and of the slides to which they add."""

_UNITS = {
    "speed": ("mm/s", "rad/s"),
    "acceleration": ("mm/s^2", "rad/s^2"),
    "jerk": ("mm/s^3", "rad/s^3"),
    **dict.fromkeys(("low", "high", "bandwidth_residual"), ("mm", "rad")),
}
"""Units of the limits of a linear and of a rotary axis."""

MAX_DEAD_TIME_S = 1.0
"""Longest dead time; larger values are taken for a wrong unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis(TableModel):
    """Limits of one axis; ``None`` where a limit is not known.

    Parameters
    ----------
    speed, acceleration, jerk
        Limit of the magnitude, in mm or rad and s.
    low, high
        Ends of the travel. [mm or rad]
    bandwidth_hz
        Highest frequency that the axis follows; `check_limits` compares a motion with it. [Hz]
    bandwidth_residual
        Largest motion above the bandwidth, as the amplitude of a sine of equal power over two revolutions; ``None``
        for 1e-5. [mm or rad]
    response
        Closed-loop response from command to position; ``None`` for an axis that follows exactly.
    dead_time
        Delay of the response; ``None`` for no delay. [s]

    Raises
    ------
    InputError
        If a limit is not positive, ``low`` is not below ``high``, or the dead time is not from 0 to 1 s.
    """

    key_names = MappingProxyType({"bandwidth_hz": "bandwidth"})
    speed: Annotated[float, unit(*_UNITS["speed"])] | None = None
    acceleration: Annotated[float, unit(*_UNITS["acceleration"])] | None = None
    jerk: Annotated[float, unit(*_UNITS["jerk"])] | None = None
    low: Annotated[float, unit(*_UNITS["low"])] | None = None
    high: Annotated[float, unit(*_UNITS["high"])] | None = None
    bandwidth_hz: Frequency | None = None
    bandwidth_residual: Annotated[float, unit(*_UNITS["bandwidth_residual"])] | None = None
    response: Annotated[Response, AnyResponse] | None = None
    dead_time: Time | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        for name, power in (("speed", "/s"), ("acceleration", "/s^2"), ("jerk", "/s^3")):
            limit = getattr(self, name)
            if limit is not None:
                positive(limit, f"the {name} of an axis", f"mm{power} or rad{power}")
        if self.bandwidth_hz is not None:
            positive(self.bandwidth_hz, "the bandwidth of an axis", "Hz")
        if self.bandwidth_residual is not None:
            positive(self.bandwidth_residual, "the bandwidth_residual of an axis", "mm or rad")
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        if not low < high:
            raise InputError(
                f"the travel of an axis is {low:g} to {high:g} mm or rad, low must be below high: correct it"
            )
        between(self.dead_time or 0.0, "the dead_time of an axis", 0.0, MAX_DEAD_TIME_S, "s")

    def amplitude(self, frequency_hz: ArrayLike) -> Floats:
        r"""Return the largest amplitude of a sine within travel, speed, acceleration, jerk and bandwidth.

        A sine of amplitude a has the peaks :math:`a\omega`, :math:`a\omega^2` and :math:`a\omega^3`. Above the
        bandwidth the amplitude is 0; without limits it is infinite. Any shape [mm or rad]

        >>> fast = Axis(low=-0.035, high=0.035, acceleration=1e5, bandwidth_hz=700)
        >>> fast.amplitude([100.0, 500.0, 800.0]).round(5).tolist()
        [0.035, 0.01013, 0.0]
        """
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        most = np.full(frequency.shape, np.inf)
        if self.low is not None and self.high is not None:
            most[...] = (self.high - self.low) / 2
        with np.errstate(divide="ignore"):
            for limit, power in ((self.speed, 1), (self.acceleration, 2), (self.jerk, 3)):
                if limit is not None:
                    most = np.minimum(most, limit / (2 * np.pi * frequency) ** power)
        return np.where(frequency > (np.inf if self.bandwidth_hz is None else self.bandwidth_hz), 0.0, most)


class Axes:
    """Annotation of axes by letter: linear axes in mm, rotary axes in rad."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        table = core_schema.dict_schema(core_schema.str_schema(strict=True), handler.generate_schema(Axis))
        return core_schema.no_info_before_validator_function(_check_axes, table)


def _check_axes(axes: Any) -> Any:
    problems: dict[tuple[str | int, ...], Exception | str] = {}
    for letter, limits in axes.items() if isinstance(axes, Mapping) else ():
        if len(letter) != 1 or not letter.isupper():
            problems[letter,] = "it is not an axis: name it with one capital letter"
            continue
        for key, value in limits.items() if isinstance(limits, Mapping) else ():
            units = [symbol for symbol in _UNITS.get(key, ()) if ("rad" in symbol) == (letter in ROTARY)]
            try:
                _ = [parse(value, symbol) for symbol in units]
            except UnitError as error:
                problems[letter, key] = error
    if problems:
        raise refuse("axes", problems, axes)
    return axes
