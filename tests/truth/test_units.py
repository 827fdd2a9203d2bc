"""Quantities against pint, against decimal literals, and against what must not be read.

Oracles: pint (with a revolution defined as a dimension of its own), Python's own correctly rounded decimal literals.
"""

import math
from typing import Annotated

import pint
import pytest
from hypothesis import given, strategies as st
from pydantic import TypeAdapter, ValidationError

from laws import examples
from turnwright.errors import UnitError
from turnwright.units import convert, parse, say_length, unit, write

REGISTRY = pint.UnitRegistry()
REGISTRY.define("shaft = [shaft]")
REGISTRY.define("slant = [slant]")  # pint holds angles for plain numbers; here they are a dimension
PINT = {
    "m": "m", "cm": "cm", "mm": "mm", "um": "um", "µm": "um", "μm": "um", "nm": "nm", "in": "inch",
    "ms": "ms", "s": "s", "min": "min", "h": "hour", "rev": "shaft", "Hz": "1/s", "rpm": "shaft/min",
    "rad": "slant", "mrad": "1e-3*slant", "urad": "1e-6*slant", "deg": f"{math.pi / 180!r}*slant",
    "arcmin": f"{math.pi / 10800!r}*slant", "arcsec": f"{math.pi / 648000!r}*slant", "turn": f"{2 * math.pi!r}*slant",
}  # fmt: skip
FAMILIES = (("m", "cm", "mm", "um", "µm", "μm", "nm", "in"), ("rad", "mrad", "urad", "deg", "arcmin", "arcsec", "turn"),
            ("ms", "s", "min", "h"))  # fmt: skip


def by_pint(number: float, written: str, wanted: str) -> float:
    def of(expression: str) -> pint.Quantity:
        product = REGISTRY.Quantity(1.0)
        sign = 1
        for word in expression.replace("*", " * ").replace("/", " / ").split():
            if word in "*/":
                sign = 1 if word == "*" else -1
                continue
            name, _, power = word.partition("^")
            product = product * REGISTRY.Quantity(PINT.get(name, name)) ** (sign * int(power or 1))
        return product

    return float((number * of(written) / of(wanted)).to("dimensionless").magnitude)


@given(
    number=st.floats(min_value=1e-9, max_value=1e9),
    bases=st.tuples(*(st.tuples(*map(st.sampled_from, FAMILIES)) for _ in range(2))),
    powers=st.tuples(st.integers(-4, 4), st.integers(-3, 3), st.integers(-2, 2)),
    sign=st.sampled_from([1, -1]),
)
@examples(150)
def test_compound_units_agree_with_pint(number, bases, powers, sign):
    def expression(side: int) -> str:
        return "*".join(f"{name}^{power}" for name, power in zip((*bases[side], "rev"), (*powers, 1), strict=True))

    got = parse(f"{sign * number!r} {expression(0)}", expression(1))
    assert got == pytest.approx(by_pint(sign * number, expression(0), expression(1)), rel=1e-13)
    assert convert(sign * number, expression(0), expression(1)) == pytest.approx(got, rel=1e-13)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("8 um/rev", "mm/rev"),
        ("150 rpm", "rev/min"),
        ("0.2 mm/min", "mm/s"),
        ("2e-5 mm/deg", "mm/rad"),
        ("-3e-7 mm/deg^3", "mm/rad^3"),
        ("2.88E-16 1/mm^7", "mm^-7"),
        ("35 um/m", "1"),
        ("-.5 in", "mm"),
    ],
)
def test_quantities_of_the_trade_agree_with_pint(text, wanted):
    number, written = text.split()
    assert parse(text, wanted) == pytest.approx(by_pint(float(number), written, wanted), rel=1e-14)


@given(digits=st.integers(1, 10**12), point=st.integers(-12, 3))
@examples(150)
def test_lengths_are_rounded_once(digits, point):
    """Oracle: Python rounds a decimal literal correctly, so shifting the exponent of the text is exact."""
    assert parse(f"{digits}e{point} um", "mm") == float(f"{digits}e{point - 3}")
    assert parse(f"{digits}e{point} nm", "mm") == float(f"{digits}e{point - 6}")
    assert parse(f"{digits}e{point}m", "mm") == float(f"{digits}e{point + 3}")


@given(value=st.floats(allow_nan=False, allow_infinity=False), name=st.sampled_from(["mm", "mm/rev", "rad", "1/mm^5"]))
@examples(200)
def test_what_is_written_reads_back_to_the_same_number(value, name):
    assert parse(write(value, name), name) == value


@pytest.mark.parametrize(
    "text",
    [
        "0,5 mm", "2 mm 3", "5", "5.", "nan mm", "inf mm", "-inf mm", "1e400 mm", "1e-400 mm", "1 000 mm", "1_000 mm",
        "mm", "", "  ", "2 mm/", "2 /mm", "2 mm//mm", "2 um/turn", "2 mm/rev", "2 mm^2", "2 deg", "2 furlong", "2 MM",
        "1.2.3 mm", "--2 mm", "+-2 mm", "0x10 mm", "١ mm", "2 mm^", "2 mm^1.5", "2 mm mm", "2 mm+1 mm", "1/2 mm",
        "2 mm;", "1e5e5 mm", "9" * 101 + " mm", "1 mm^99/nm^98", 5, 5.0, None, True, ["5 mm"],
    ],
)  # fmt: skip
def test_what_is_not_one_length_is_refused_in_one_sentence(text):
    with pytest.raises(UnitError) as caught:
        parse(text, "mm")
    message = str(caught.value)
    assert "\n" not in message
    assert ": " in message  # what is wrong, then the remedy
    assert len(message) < 250


def test_the_message_says_what_it_is_and_what_it_must_be():
    with pytest.raises(
        UnitError, match=r"^'2 um/turn' is a length per angle, it must be a feed per revolution: write it"
    ):
        parse("2 um/turn", "mm/rev")


def test_zero_stays_zero_whatever_its_exponent():
    assert parse("0 um", "mm") == 0
    assert parse("0.000e999999999 um", "mm") == 0


def test_a_pydantic_field_takes_text_only_and_goes_out_as_text():
    feed = TypeAdapter(Annotated[float, unit("mm/rev")])
    assert feed.validate_python("8 um/rev") == 0.008
    assert feed.dump_python(0.008) == "8 um/rev"
    with pytest.raises(ValidationError, match="has no unit"):
        feed.validate_python(0.008)
    squareness = TypeAdapter(Annotated[float, unit("rad", "1")])
    assert squareness.validate_python("-35 um/m") == -35e-6
    with pytest.raises(ValidationError, match="it must be an angle"):
        squareness.validate_python("35 um")
    with pytest.raises(ValidationError, match="is not above 0"):
        TypeAdapter(Annotated[float, unit("rad", "1", above=0.0)]).validate_python("-35 um/m")


@given(st.floats(1e-6, 9.99e5), st.sampled_from((1, -1)))
def test_a_length_is_written_in_plain_digits_and_reads_back(length, sign):
    """Oracle: pint reads the text."""
    output = say_length(sign * length)
    number, name = output.split()
    assert "e" not in number
    assert 1 <= abs(float(number)) < 1000
    assert REGISTRY.Quantity(float(number), name).to("mm").magnitude == pytest.approx(sign * length, rel=5.1e-3)
