"""Spellings of units of length in files."""

from __future__ import annotations

from turnwright.errors import MapError
from turnwright.units import convert

__all__ = ["SPELLINGS", "to_mm"]

SPELLINGS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetres"), "cm"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers", "micrometres"), "um"),
    **dict.fromkeys(("nm", "nanometer", "nanometers", "nanometre", "nanometres"), "nm"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
}
"""Unit by its spelling in lower case."""


def to_mm(unit: str, where: str) -> float:
    """Return one ``unit`` in mm.

    Raises
    ------
    MapError
        If it is not a length; the message begins with ``where``.
    """
    symbol = SPELLINGS.get(unit.strip().lower())
    # A capital M means mega, not milli.
    if symbol is None or unit.strip() in {"M", "Mm"}:
        raise MapError(f"{where} {unit.strip()!r}, the known units are m, cm, mm, um, nm and in: export it in one")
    return convert(1.0, symbol, "mm")
