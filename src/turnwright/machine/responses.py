r"""The closed-loop response of a servo axis, from command to position.

A response is the transfer function :math:`H(s)`, position over command, with :math:`H(0) = 1`: at rest an axis is at
its commanded position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turnwright._arrays import Floats, Value, frozen
from turnwright._tables import Numbers, TableModel, adapter
from turnwright._validate import between, check_numbers, positive
from turnwright.errors import InputError
from turnwright.units import Frequency, Number

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

__all__ = [
    "AnyResponse", "FrequencyResponse", "RationalResponse", "Response", "SecondOrder", "TransferFunction",
]  # fmt: skip

STATIC_GAIN_TOL = 1e-6
"""Deviation of the gain at rest from 1."""

MAX_POLES = 20
"""Order of a transfer function; poles of higher orders are lost to rounding."""

MAX_FILE_BYTES = 16 << 20
"""Bytes of a file of a frequency response."""


@runtime_checkable
class Response(Protocol):
    """Closed-loop response of an axis to its command."""

    def at(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return position over command at frequencies of any shape [Hz]."""

    def slower(self, factor: float) -> Response:
        """Return the response with all times longer by a factor."""


@runtime_checkable
class RationalResponse(Response, Protocol):
    """A response that is a ratio of polynomials, so that its answer to a command has a closed form."""

    @property
    def polynomials(self) -> tuple[Floats, Floats]:
        """Numerator and denominator in s, highest power first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondOrder(TableModel):
    r"""A servo axis as a mass on a damped spring, with feed-forward.

    .. math:: H(s) = \frac{a s^2 + 2 v \zeta \omega s + \omega^2}{s^2 + 2 \zeta \omega s + \omega^2}

    Parameters
    ----------
    frequency_hz
        Natural frequency :math:`\omega / 2\pi`. [Hz]
    damping
        Damping ratio :math:`\zeta`.
    velocity_feedforward
        :math:`v`: 0 for none, which lags a steady motion by :math:`2\zeta/\omega`; 1 for no lag at steady speed.
    acceleration_feedforward
        :math:`a`: 0 for none; with both 1 the axis follows exactly.

    Raises
    ------
    InputError
        If frequency or damping is not positive, or a feed-forward lies outside 0 to 2.

    >>> axis = SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1)
    >>> abs(axis.at([1.0, 50.0])).round(4)
    array([1.0001, 1.1898])
    """

    key_names = MappingProxyType({"frequency_hz": "frequency"})
    frequency_hz: Frequency
    damping: Number
    velocity_feedforward: Number = 0.0
    acceleration_feedforward: Number = 0.0

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.frequency_hz, "frequency_hz", "Hz")
        positive(self.damping, "damping", "")
        for name in ("velocity_feedforward", "acceleration_feedforward"):
            between(getattr(self, name), name, 0.0, 2.0, "")

    @property
    def polynomials(self) -> tuple[Floats, Floats]:
        """Numerator and denominator in s, highest power first."""
        omega = 2 * math.pi * self.frequency_hz
        drag = 2 * self.damping * omega
        return (
            np.array([self.acceleration_feedforward, self.velocity_feedforward * drag, omega**2]),
            np.array([1.0, drag, omega**2]),
        )

    def at(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return position over command at frequencies of any shape [Hz]."""
        return _ratio(self.polynomials, frequency_hz)

    def slower(self, factor: float) -> SecondOrder:
        """Return the response with all times longer by a factor."""
        return SecondOrder(
            frequency_hz=self.frequency_hz / factor, damping=self.damping,
            velocity_feedforward=self.velocity_feedforward, acceleration_feedforward=self.acceleration_feedforward,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferFunction(TableModel, Value):
    """A stable ratio of polynomials in s.

    Parameters
    ----------
    numerator, denominator
        Coefficients, highest power first; the constant terms are equal, so that the static gain is 1. (m,), (n,) with
        m <= n [powers of s]

    Raises
    ------
    InputError
        If the response is not stable, not proper, of too high an order, or its static gain is not 1.

    >>> lag = TransferFunction(numerator=[50.0], denominator=[1.0, 50.0])
    >>> round(float(abs(lag.at(50 / (2 * np.pi)))), 6)
    0.707107
    """

    numerator: Annotated[Floats, Numbers]
    denominator: Annotated[Floats, Numbers]

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("numerator", "denominator"):
            values = np.trim_zeros(frozen(getattr(self, name), name), "f")
            object.__setattr__(self, name, frozen(values, name))
        above, below = self.numerator, self.denominator
        if not 2 <= below.size <= MAX_POLES + 1:
            raise InputError(
                f"the denominator has {below.size} coefficients, the limits are 2 to {MAX_POLES + 1}: give the "
                "closed loop from command to position"
            )
        if not 1 <= above.size <= below.size:
            raise InputError(
                f"the numerator has {above.size} coefficients, the limits are 1 to {below.size} (those of the "
                "denominator): give a proper transfer function"
            )
        if below[-1] == 0 or abs(above[-1] / below[-1] - 1) > STATIC_GAIN_TOL:
            raise InputError(
                f"the constant terms are {above[-1]:g} and {below[-1]:g}, they must be equal and not 0: give the "
                "closed loop from command to position, in equal units"
            )
        worst = float(np.roots(below).real.max())
        if not worst < 0:
            raise InputError(
                f"a pole of the response has the real part {worst:g} rad/s, the limit is below 0: give a stable axis"
            )

    @property
    def polynomials(self) -> tuple[Floats, Floats]:
        """Numerator and denominator in s, highest power first."""
        return self.numerator, self.denominator

    def at(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return position over command at frequencies of any shape [Hz]."""
        return _ratio(self.polynomials, frequency_hz)

    def slower(self, factor: float) -> TransferFunction:
        """Return the response with all times longer by a factor."""
        return TransferFunction(
            numerator=self.numerator * factor ** np.arange(self.numerator.size - 1.0, -1, -1),
            denominator=self.denominator * factor ** np.arange(self.denominator.size - 1.0, -1, -1),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrequencyResponse(Value):
    """A measured response: position over command at ascending frequencies.

    Logarithm of the magnitude and unwrapped phase are linear between the frequencies, and begin with magnitude 1 and
    phase 0 at rest. Above the last frequency the phase is constant and the magnitude falls with the square of the
    frequency.

    Parameters
    ----------
    frequency_hz
        Ascending, above 0, with phase changes below half a turn from one frequency to the next. (n,) [Hz]
    magnitude
        Position over command. (n,)
    phase
        Phase of position over command, negative where it lags, in any branch. (n,) [rad]

    Raises
    ------
    InputError
        If there are fewer than two frequencies, they do not ascend, or a magnitude is not positive.
    """

    frequency_hz: Floats
    magnitude: Floats
    phase: Floats

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("frequency_hz", "magnitude", "phase"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        f = self.frequency_hz
        if f.size < 2 or f.shape != self.magnitude.shape or f.shape != self.phase.shape:
            raise InputError(
                f"a frequency response has {f.size} frequencies, {self.magnitude.size} magnitudes and "
                f"{self.phase.size} phases: give equal numbers of each, at least 2"
            )
        if not (f[0] > 0 and (np.diff(f) > 0).all()):
            raise InputError(
                f"the frequencies of a response begin at {f[0]:g} Hz, they must ascend and be above 0 Hz: sort them"
            )
        if not (self.magnitude > 0).all():
            raise InputError(
                f"a magnitude of the response is {self.magnitude.min():g}, it must be above 0: give position over "
                "command, or dB"
            )
        phase = np.unwrap(np.concatenate(([0.0], self.phase)))[1:]
        object.__setattr__(self, "phase", frozen(phase, "phase"))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> FrequencyResponse:
        """Return the response in a text file of three columns: frequency [Hz], magnitude [dB], phase [deg].

        Columns are separated by commas, semicolons or blanks; lines that begin with a letter or # are skipped.

        Raises
        ------
        InputError
            If the file cannot be read or has other contents.
        """
        path = Path(path)
        try:
            if path.stat().st_size > MAX_FILE_BYTES:
                raise InputError(
                    f"{path} has {path.stat().st_size / 1e6:.0f} MB, a frequency response has at most "
                    f"{MAX_FILE_BYTES / 1e6:.0f} MB: give the file of three columns"
                )
            lines = path.read_text(encoding="utf-8-sig").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is not text"
            raise InputError(f"{path} cannot be read as a frequency response ({reason}): check its name") from error
        rows = []
        for number, line in enumerate(lines, 1):
            words = line.replace(",", " ").replace(";", " ").split()
            if not words or words[0][0] == "#" or words[0][0].isalpha():
                continue
            try:
                rows.append([float(word) for word in words])
            except ValueError:
                rows.append([])
            if len(rows[-1]) != 3:
                raise InputError(
                    f"{path} line {number} is {line[:40]!r}, it needs 3 numbers: frequency in Hz, magnitude in dB, "
                    "phase in deg"
                )
        table = np.array(rows, dtype=np.float64).reshape(-1, 3)
        try:
            return cls(frequency_hz=table[:, 0], magnitude=10 ** (table[:, 1] / 20), phase=np.deg2rad(table[:, 2]))
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    def at(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return position over command at frequencies of any shape [Hz]."""
        frequency = np.abs(np.asarray(frequency_hz, dtype=np.float64))
        knots = np.concatenate(([0.0], self.frequency_hz))
        gain = np.interp(frequency, knots, np.concatenate(([0.0], np.log(self.magnitude))))
        phase = np.interp(frequency, knots, np.concatenate(([0.0], self.phase)))
        beyond = np.maximum(frequency / knots[-1], 1.0)
        value: NDArray[np.complex128] = np.exp(gain + 1j * np.sign(frequency_hz) * phase) / beyond**2
        return value

    def slower(self, factor: float) -> FrequencyResponse:
        """Return the response with all times longer by a factor."""
        return FrequencyResponse(frequency_hz=self.frequency_hz / factor, magnitude=self.magnitude, phase=self.phase)


class AnyResponse:
    """Annotation of a response: a file of measured values, polynomials, or a second-order system."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        return core_schema.no_info_plain_validator_function(_read_response)

    @classmethod
    def __get_pydantic_json_schema__(cls, _core: CoreSchema, _handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "object"}


def _read_response(table: Any) -> Any:
    if isinstance(table, SecondOrder | TransferFunction | FrequencyResponse):
        return table
    if isinstance(table, Mapping) and table.keys() == {"file"}:
        return FrequencyResponse.load(table["file"])
    polynomials = isinstance(table, Mapping) and table.keys() & {"numerator", "denominator"}
    return adapter(TransferFunction if polynomials else SecondOrder).validate_python(table)


def _ratio(polynomials: tuple[Floats, Floats], frequency_hz: ArrayLike) -> NDArray[np.complex128]:
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    above, below = polynomials
    value: NDArray[np.complex128] = np.polyval(above, s) / np.polyval(below, s)
    return value
