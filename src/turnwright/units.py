"""Quantities with units, for job files, the command line and reports; inside, lengths are mm and angles rad.

A quantity is one plain number and one unit expression, such as ``8 um/rev``, ``2e-5 mm/deg^2`` or ``4e-9 1/mm^3``.
A revolution (``rev``) is a dimension of its own, so a feed is never mistaken for a length or for a length per angle;
a ``turn`` is an angle.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from turnwright.errors import UnitError, quote

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

__all__ = [
    "Angle",
    "Count",
    "Feed",
    "Flag",
    "Frequency",
    "Length",
    "Natural",
    "Number",
    "Size",
    "Slope",
    "Speed",
    "Step",
    "Text",
    "Thickness",
    "Time",
    "convert",
    "parse",
    "plain",
    "say_length",
    "unit",
    "write",
]

LEAST, MOST = 1e-30, 1e30
"""Limits of any size, in the internal units; powers of sizes beyond them overflow."""

MAX_CHARACTERS = 100
"""Characters in a quantity; exact arithmetic on longer numbers is slow."""


@dataclass(frozen=True, slots=True)
class _Scale:
    """A unit: an exact factor times a power of pi, and the powers of length, angle, time and revolution."""

    factor: Fraction
    pi: int
    powers: tuple[int, int, int, int]

    def times(self, other: _Scale, power: int) -> _Scale:
        powers = tuple(mine + power * theirs for mine, theirs in zip(self.powers, other.powers, strict=True))
        return _Scale(self.factor * other.factor**power, self.pi + power * other.pi, powers)  # type: ignore[arg-type]


_DIMENSIONS = ("length", "angle", "time", "revolution")
_ONE = _Scale(Fraction(1), 0, (0, 0, 0, 0))


def _table() -> dict[str, _Scale]:
    length, angle, time, revolution = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)
    units = {
        **{name: _Scale(Fraction(size), 0, length) for name, size in _LENGTHS.items()},
        **{name: _Scale(Fraction(size), pi, angle) for name, (size, pi) in _ANGLES.items()},
        **{name: _Scale(Fraction(size), 0, time) for name, size in _TIMES.items()},
        "rev": _Scale(Fraction(1), 0, revolution),
    }
    units["rpm"] = units["rev"].times(units["min"], -1)
    units["Hz"] = _ONE.times(units["s"], -1)
    units["kHz"] = _Scale(Fraction(1000), 0, _ONE.powers).times(units["s"], -1)
    return units


# Exact sizes in mm, rad and s; angles carry a power of pi.
_LENGTHS = {"m": "1000", "cm": "10", "mm": "1", "um": "1e-3", "µm": "1e-3", "μm": "1e-3", "nm": "1e-6", "in": "25.4"}
_ANGLES = {
    "rad": ("1", 0),
    "mrad": ("1e-3", 0),
    "urad": ("1e-6", 0),
    "µrad": ("1e-6", 0),
    "μrad": ("1e-6", 0),
    "deg": ("1/180", 1),
    "arcmin": ("1/10800", 1),
    "arcsec": ("1/648000", 1),
    "turn": ("2", 1),
}
_TIMES = {"ms": "1e-3", "s": "1", "min": "60", "h": "3600"}
_UNITS = _table()

# One decimal number in ASCII digits with a decimal point, then the unit.
_QUANTITY = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?![0-9.,_])\s*(.*?)\s*", re.DOTALL)
_FACTOR = re.compile(r"\s*(1|[A-Za-zµμ]+)(?:\^(-?[0-9]{1,2}))?\s*")
_NAMES = {
    (0, 0, 0, 0): "a plain number",
    (1, 0, 0, -1): "a feed per revolution",
    (0, 0, -1, 1): "a spindle speed",
    (1, 0, -1, 0): "a speed",
}


def _read_unit(text: str, quoted: str) -> _Scale:
    """Return the scale of a unit expression: factors joined by ``*`` or ``/``, each with an integer power."""
    scale, position, sign = _ONE, 0, 1
    while True:
        match = _FACTOR.match(text, position)
        if match is None:
            raise UnitError(f"{quoted} holds no unit that can be read in {text!r}: write it like 'mm/rev' or '1/mm^3'")
        name, power = match.group(1), int(match.group(2) or 1)
        if name != "1" and name not in _UNITS:
            units = " ".join(key for key in _UNITS if key.isascii())
            raise UnitError(f"{quoted} has the unit {name!r}, the known ones are {units}: use one of them")
        scale = scale.times(_UNITS.get(name, _ONE), sign * power)
        position = match.end()
        if position == len(text):
            return scale
        if text[position] not in "*/":
            raise UnitError(f"{quoted} has {text[position:]!r} after its unit: write one number and one unit")
        sign = 1 if text[position] == "*" else -1
        position += 1


def _dimension(scale: _Scale) -> str:
    if scale.powers in _NAMES:
        return _NAMES[scale.powers]
    named = [*zip(_DIMENSIONS, scale.powers, strict=True)]
    over = [f"{name}^{power}" if power > 1 else name for name, power in named if power > 0]
    under = [f"{name}^{-power}" if power < -1 else name for name, power in named if power < 0]
    words = " per ".join(["*".join(over) or "number", *under])
    return f"an {words}" if words[0] == "a" else f"a {words}"


def _value(number: str, scale: _Scale, quoted: str) -> float:
    """Return the number times the scale, rounded once unless the scale contains pi."""
    plain = float(number)
    if plain == 0 and not re.search("[1-9]", re.split("[eE]", number)[0]):
        return 0.0
    if math.isfinite(plain) and plain != 0:
        try:
            value = float(Fraction(number) * scale.factor) * math.pi**scale.pi
        except OverflowError:
            value = math.inf
        if math.isfinite(value) and value != 0:
            return value
    raise UnitError(f"{quoted} is beyond the range of numbers, about 1e-308 to 1e308: check its exponent")


def _example(unit: str) -> str:
    return f"8 {_FRIENDLY[unit][0]}" if unit in _FRIENDLY else f"0.5 {unit}".removesuffix(" 1")


def parse(text: object, unit: str) -> float:
    """Return the number of a quantity in the given unit.

    Parameters
    ----------
    text
        One number and one unit, such as ``8 um/rev``.
    unit
        The unit of the result; the quantity must have the same dimension.

    Raises
    ------
    UnitError
        If the text is not one finite number with one unit, or has another dimension.

    >>> parse("8 um/rev", "mm/rev")
    0.008
    >>> parse("2e-5 mm/deg", "mm/rad")
    0.0011459155902616464
    >>> parse("0,5 mm", "mm")
    Traceback (most recent call last):
    ...
    turnwright.errors.UnitError: '0,5 mm' does not start with a plain number: write digits with a decimal point, no
    comma, such as '8 um'
    """
    quoted = quote(text)
    wanted = _read_unit(unit, repr(unit))
    remedy = f"write it such as '{_example(unit)}'"
    if not isinstance(text, str):
        raise UnitError(f"{quoted} has no unit, it must be {_dimension(wanted)}: {remedy}")
    if len(text) > MAX_CHARACTERS:
        raise UnitError(f"{text[:20] + '...'!r} has {len(text)} characters, the limit is {MAX_CHARACTERS}: {remedy}")
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise UnitError(
            f"{quoted} does not start with a plain number: write digits with a decimal point, no comma, such as "
            f"'{_example(unit)}'"
        )
    number, written = match.groups()
    if not written and wanted.powers != _ONE.powers:
        raise UnitError(f"{quoted} has no unit, it must be {_dimension(wanted)}: {remedy}")
    scale = _read_unit(written or "1", quoted)
    if scale.powers != wanted.powers:
        raise UnitError(f"{quoted} is {_dimension(scale)}, it must be {_dimension(wanted)}: {remedy}")
    return _value(number, scale.times(wanted, -1), quoted)


def convert(value: float, unit: str, into: str) -> float:
    """Return ``value`` of ``unit`` expressed in the unit ``into``.

    >>> round(convert(7.25e-6, "mm", "nm"), 9)
    7.25
    """
    have, want = _read_unit(unit, repr(unit)), _read_unit(into, repr(into))
    if have.powers != want.powers:
        raise UnitError(
            f"{unit!r} is {_dimension(have)} and {into!r} is {_dimension(want)}: convert between like units"
        )
    scale = have.times(want, -1)
    return value * float(scale.factor) * math.pi**scale.pi


# Units in which people write a quantity, in order of preference.
_FRIENDLY = {
    "mm": ("um", "mm", "nm"),
    "mm/rev": ("um/rev", "mm/rev"),
    "rad": ("deg", "urad", "rad"),
    "rpm": ("rpm",),
    "s": ("s",),
    "mm/s": ("mm/min",),
}


def write(value: float, unit: str) -> str:
    """Return a quantity as text that `parse` reads back exactly, in a customary unit where that is possible.

    >>> write(0.008, "mm/rev"), write(math.pi / 18, "rad"), write(12.5, "mm")
    ('8 um/rev', '10 deg', '12.5 mm')
    """
    texts = []
    for friendly in _FRIENDLY.get(unit, ()):
        number = f"{convert(value, unit, friendly):.15g}"
        with suppress(UnitError):  # a number at the end of the range may overflow in the customary unit
            if parse(f"{number} {friendly}", unit) == value:
                texts.append(f"{number} {friendly}")
    return min(texts, key=len) if texts else f"{value!r} {unit}"


def say_length(length: float, digits: int = 3) -> str:
    """Return a length in mm as text: three significant digits, in the unit that needs the fewest zeros.

    >>> say_length(7500.0), say_length(0.00099999), say_length(2e-4), say_length(0.0)
    ('7.5 m', '1 um', '200 nm', '0 nm')
    >>> say_length(0.123456, digits=4)
    '123.5 um'
    """
    rounded = float(f"{length:.{digits}g}")
    sizes = (("m", 1e-3), ("mm", 1.0), ("um", 1e3), ("nm", 1e6))
    name, factor = next((size for size in sizes if abs(rounded) * size[1] >= 1 - 1e-9), sizes[-1])
    return f"{rounded * factor:.{digits}g} {name}"


class unit:  # noqa: N801 - reads as a word inside Annotated[float, unit("mm")]
    """A pydantic field that reads text with a unit and stores the number in this unit.

    With ``plain`` true in pydantic's context, it also accepts a number.

    >>> from typing import Annotated
    >>> from pydantic import TypeAdapter
    >>> TypeAdapter(Annotated[float, unit("mm/rev")]).validate_python("8 um/rev")
    0.008
    """

    __slots__ = ("above", "least", "units")

    def __init__(self, *units: str, above: float = -math.inf, least: float = -math.inf) -> None:
        """Set the unit, alternative units of another dimension (um/m for rad), and limits in the first unit."""
        self.units, self.above, self.least = units, above, least

    def read(self, text: object) -> float:
        """Return the number of ``text`` in the unit of the same dimension."""
        for other in self.units[1:]:
            with suppress(UnitError):
                value = parse(text, other)
                break
        else:
            value = parse(text, self.units[0])
        return self.within(value, text)

    def validate(self, value: object, info: Any) -> float:
        """Return the number of a text, or a number unchanged where pydantic's context allows numbers."""
        if (info.context or {}).get("plain") and isinstance(value, Real) and not isinstance(value, bool):
            return self.within(float(value), value)
        return self.read(value)

    def within(self, value: float, given: object) -> float:
        """Return a number in the first unit if it lies within the limits; ``given`` is quoted in the message."""
        if math.isnan(value):
            raise UnitError(f"{given!r} is not a number: give one in {self.units[0]}")
        if abs(value) > MOST or (self.above == 0 and 0 < value < LEAST):
            limit = f"below {LEAST:g}" if abs(value) < LEAST else f"above {MOST:g}"
            raise UnitError(
                f"{given!r} is {limit} {self.units[0]}, the limit for any size: check its exponent and its unit"
            )
        if not value > self.above:
            raise UnitError(f"{given!r} is not above {self.above:g} {self.units[0]}: give a larger value")
        if not value >= self.least:
            raise UnitError(f"{given!r} is below {self.least:g} {self.units[0]}: give at least that")
        return value

    def show(self, value: float | None) -> str | None:
        """Return text that `read` reads back to the same number."""
        return None if value is None else write(value, self.units[0])

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        return core_schema.with_info_plain_validator_function(
            self.validate,
            serialization=core_schema.plain_serializer_function_ser_schema(self.show),
        )

    def __get_pydantic_json_schema__(self, _core: CoreSchema, _handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema: dict[str, Any] = {"type": "string", "unit": self.units[0]}
        limits = {"above": self.above, "least": self.least}
        return schema | {name: value for name, value in limits.items() if value > -math.inf}


class plain:  # noqa: N801 - reads as a word inside Annotated[int, plain(1, 10)]
    """A pydantic field that accepts only values of its own type: no number in quotes, no 1 for true.

    >>> from typing import Annotated
    >>> from pydantic import TypeAdapter
    >>> TypeAdapter(Annotated[int, plain(least=1)]).validate_python(5)
    5
    """

    __slots__ = ("least", "most")

    def __init__(self, least: float | None = None, most: float | None = None) -> None:
        self.least, self.most = least, most

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        limits: dict[str, Any] = {
            name: limit for name, limit in (("ge", self.least), ("le", self.most)) if limit is not None
        }
        if source is float:
            return core_schema.float_schema(strict=True, allow_inf_nan=False, **limits)
        if source is int:
            return core_schema.int_schema(strict=True, **limits)
        if source is bool:
            return core_schema.bool_schema(strict=True)
        return core_schema.str_schema(strict=True, min_length=int(self.least or 0))


Length: TypeAlias = Annotated[float, unit("mm")]
Size: TypeAlias = Annotated[float, unit("mm", above=0.0)]
Thickness: TypeAlias = Annotated[float, unit("mm", least=0.0)]
Angle: TypeAlias = Annotated[float, unit("rad")]
Step: TypeAlias = Annotated[float, unit("rad", above=0.0)]
Slope: TypeAlias = Annotated[float, unit("rad", "1")]
Time: TypeAlias = Annotated[float, unit("s")]
Frequency: TypeAlias = Annotated[float, unit("Hz")]
Feed: TypeAlias = Annotated[float, unit("mm/rev", above=0.0)]
Speed: TypeAlias = Annotated[float, unit("rpm", above=0.0)]
# A coefficient may have any unit; the limits keep its powers finite.
Number: TypeAlias = Annotated[float, plain(-1e100, 1e100)]
Count: TypeAlias = Annotated[int, plain(1, 10**9)]
Natural: TypeAlias = Annotated[int, plain(0, 10**9)]
Flag: TypeAlias = Annotated[bool, plain()]
Text: TypeAlias = Annotated[str, plain()]

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9 _-]{0,29}$"
"""Names that are valid for a sub-program of a controller and for a file."""
