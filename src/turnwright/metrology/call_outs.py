"""Read the call-outs of a drawing: form after ISO 10110-5, texture after -8 and ISO 21920, slopes after -12."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, NamedTuple, TypeAlias

from turnwright.errors import InputError, UnitError, quote
from turnwright.units import convert, parse, say_length

Standard: TypeAlias = Literal["ISO 10110-5", "ISO 10110-8", "ISO 10110-12", "ISO 21920"]

NM = 1e6

SYMBOLS = {
    "A": "sagitta error A (PV of the best-fit sphere)",
    "B": "irregularity B (PV)",
    "C": "rotationally symmetric irregularity C (PV)",
    "RMSt": "rms total RMSt",
    "RMSi": "rms irregularity RMSi",
    "RMSa": "rms asymmetry RMSa",
    "slope": "largest slope",
    "rms slope": "rms slope",
    "PSD": "PSD at 1/mm",
}
"""Quantities of a call-out in words; the others are their symbols."""

SETTINGS = {
    "Ra": ((2e-5, 0.08), (1e-4, 0.25), (2e-3, 0.8), (1e-2, 2.5), (math.inf, 8.0)),
    "Rz": ((1.6e-4, 0.08), (8e-4, 0.25), (1.6e-2, 0.8), (8e-2, 2.5), (math.inf, 8.0)),
}
"""Default nesting index of the L-filter by the upper limit of the parameter (ISO 21920-3). [mm]"""

S_FILTERS = {2.5: 0.008, 8.0: 0.025}
"""Default nesting index of the S-filter by that of the L-filter, 0.0025 mm for shorter ones (ISO 21920-3). [mm]"""

MAX_CHARACTERS = 200
"""Characters in a call-out; longer numbers have no meaning."""

MOST = 1e3

WAVELENGTHS = (1e-4, 2e-2)
"""Least and greatest wavelength of an interferometer. [mm]"""

WHOLE_AND_PART = (
    ("B", "C"), ("B", "RMSi"), ("B", "RMSa"), ("RMSt", "RMSi"), ("RMSt", "RMSa"), ("RMSi", "RMSa"),
    ("Rz", "Ra"), ("Rz", "Rq"), ("Rq", "Ra"), ("slope", "rms slope"),
)  # fmt: skip
"""Pairs of quantities of which the second is never above the first."""

EXAMPLES = (
    "'3/ 0.5(0.2/0.1); λ = 546.07 nm', 'Sq 2 nm; 0.0025/0.08', 'PSD 50 nm² mm/2; 0.01/1', 'slope < 0.5 mrad; 1' or "
    "'0.0025-0.08 / Ra 0.02'"
)

_NUMBER = r"([0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]{1,2})?)"
_UNIT = r"([nuµμm]?m)?"
_SIZE = rf"{_NUMBER}\s*{_UNIT}"
_BAND = rf"{_NUMBER}\s*(?:mm)?\s*[-/]\s*{_NUMBER}\s*(?:mm)?"
_FORM = re.compile(
    rf"3\s*/\s*(?:{_SIZE}|-)\s*(?:\(\s*(?:{_SIZE}|-)\s*(?:/\s*(?:{_SIZE}|-)\s*)?\)\s*{_UNIT}(?![\w(]))?\s*(.*)"
)
_RMS = re.compile(rf"RMS\s*_?([tia])\s*<?\s*{_SIZE}")
_WAVELENGTH = re.compile(rf"(?:λ|lambda)\s*=\s*{_NUMBER}\s*(\w*)")
_AREA = re.compile(r"(?:all\s*)?(?:[øØ⌀∅]|dia).*", re.IGNORECASE)
_BAND_RMS = re.compile(rf"(Sq|Rq)\s*<?\s*{_NUMBER}\s*([nuµμ]m)?\s*;\s*{_BAND}")
_PSD = re.compile(rf"PSD\s*<?\s*{_NUMBER}\s*([^/;0-9][^/;]*?)?\s*/\s*([0-9](?:\.[0-9]+)?)\s*;\s*{_BAND}")
_SLOPE = re.compile(rf"(rms\s+)?slope\s*<?\s*{_NUMBER}\s*([^;\s]*)\s*;\s*{_SIZE}(?:\s*;\s*{_SIZE})?", re.IGNORECASE)
_NESTING = rf"(?:{_NUMBER}\s*(?:mm)?)?\s*-\s*{_NUMBER}\s*(?:mm)?"
_PROFILE = re.compile(
    rf"(?:U\s+)?(?:{_NESTING}\s*/\s*)?(Ra|Rq|Rz)\s*<?\s*{_NUMBER}\s*([nuµμ]m)?"
    rf"(?:\s*;\s*(?:{_NESTING}|{_NUMBER}\s*(?:mm)?))?"
)


class Limit(NamedTuple):
    """The largest value of one quantity, by its symbol.

    Heights are in mm, slopes in rad, a power spectral density in mm³ at the spatial frequency 1/mm.
    """

    symbol: str
    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CallOut:
    """A tolerance of a drawing. See `read_call_out`.

    Parameters
    ----------
    text
        As written on the drawing.
    standard
        The standard that defines it.
    limits
        Largest value of each quantity.
    short, long
        Shortest and longest wavelength of a band, or nesting indices of S-filter and L-filter; of a slope its sampling
        and integration length. ``None`` where the drawing states none. [mm]
    exponent
        Of a power spectral density, which falls with this power of the spatial frequency.
    wavelength
        Two fringe spacings. ``None`` if not stated. [mm]
    """

    text: str
    standard: Standard
    limits: tuple[Limit, ...]
    short: float | None = None
    long: float | None = None
    exponent: float = 0.0
    wavelength: float | None = None

    @property
    def band(self) -> tuple[float | None, float]:
        """The shortest and the longest wavelength, of ISO 21920 by default as its limit sets them. [mm]."""
        long = self.long
        if long is None:
            symbol, limit = self.limits[0]
            long = next(one for most, one in SETTINGS[symbol] if limit <= most * (1 + 1e-9))
        if self.short is None and self.standard == "ISO 21920":
            return S_FILTERS.get(long, 0.0025), long
        return self.short, long

    @property
    def is_texture(self) -> bool:
        """Whether it limits texture, which a patch shows, instead of the form or the slopes of the whole part."""
        return self.standard in ("ISO 10110-8", "ISO 21920")

    @property
    def unit(self) -> str:
        """Unit in which its values are stated."""
        return {"slope": "mrad", "rms slope": "mrad", "PSD": "nm² mm"}.get(self.limits[0].symbol, "nm")

    @property
    def scale(self) -> float:
        """Factor from the values to this unit."""
        return {"mrad": 1e3, "nm² mm": NM**2, "nm": NM}[self.unit]

    @property
    def meaning(self) -> str:
        """What it limits, in one unit, with its band.

        >>> read_call_out("3/ -(1); RMSa < 0,1; λ = 546 nm").meaning
        'B ≤ 273 nm, RMSa ≤ 27.3 nm'
        """
        limits = ", ".join(f"{symbol} ≤ {value * self.scale:.6g} {self.unit}" for symbol, value in self.limits)
        if self.standard == "ISO 10110-5":
            return limits
        short, long = self.band
        if self.standard == "ISO 10110-12":
            sampled = "" if short is None else f", sampled every {say_length(short)}"
            return f"{limits} over {say_length(long)}{sampled}"
        power = f" at 1/mm, falling with f^-{self.exponent:g}," if self.exponent else ""
        filters = ", Gaussian filters" if self.standard == "ISO 21920" else ""
        return f"{limits}{power} in the band {say_length(short or 0.0)} to {say_length(long)}{filters}"


def read_call_out(text: str) -> CallOut:
    """Read one call-out as it is written on a drawing, with decimal point or comma, ``<`` or ``≤``.

    ========================================================  =====================================================
    ``3/ A(B/C) RMSt < D; RMSi < E; RMSa < F; λ = 546 nm``    ISO 10110-5; ``-`` for no limit. Numbers without a unit
                                                              are fringe spacings, each half of λ.
    ``Sq 2 nm; 0.0025/0.08``, ``Rq 2 nm; 0.0025/0.08``        ISO 10110-8, the rms of an area or of a profile in a band
                                                              of wavelengths [mm]
    ``PSD 50 nm² mm/2; 0.01/1``, ``PSD 5e-8 µm³/2; 0.01/1``   ISO 10110-8, at most A/f^B in a band of wavelengths, with
                                                              f in 1/mm, or in 1/µm for µm³
    ``slope < 0.5 mrad; 1; 0.1``, ``rms slope < ...``         ISO 10110-12, with integration and sampling length [mm]
    ``0.0025-0.08 / Ra 0.02``, ``Rz 0.1; 0.8``, ``Ra 0.02``   ISO 21920 in µm, with nesting indices [mm]
    ========================================================  =====================================================

    Raises
    ------
    InputError
        If it is none of these, its limits contradict each other, or a wavelength or a unit is missing.

    Sources
    -------
    ISO 10110-5:2015 and ISO 14999-4; ISO 10110-8:2019, whose PSD had µm³ in the edition of 1997; ISO 10110-12:2019; ISO
    21920-1:2021, its default settings as ISO 21920-3:2021. Oracle: printed examples of fringe spacings, closed forms.

    >>> read_call_out("3/ 2(1/0,5); λ = 632,8 nm").limits[0]
    Limit(symbol='A', value=0.0006328)
    """
    if len(text) > MAX_CHARACTERS:
        raise InputError(
            f"the call-out {quote(text)} has {len(text)} characters, the limit is {MAX_CHARACTERS}: write one call-out"
        )
    if not text.isprintable():
        raise InputError(f"the call-out {quote(text)} has a line end or a control character: write it in one line")
    plain = re.sub(r"(?<=\d),(?=\d)", ".", text.strip())
    for signs, sign in (("≤|<=", "<"), ("[−–—]", "-")):
        plain = re.sub(signs, sign, plain)
    for pattern, read in _READERS:
        match = pattern.fullmatch(plain)
        if match is not None:
            call_out = read(text, match)
            break
    else:
        raise InputError(f"the call-out {quote(text)} cannot be read: write it such as {EXAMPLES}")
    zeros = [limit.symbol for limit in call_out.limits if limit.value == 0]
    if zeros:
        raise InputError(f"the call-out {quote(text)} limits {zeros[0]} to 0, it must be above 0: use - for no limit")
    if any(limit.value > MOST for limit in call_out.limits):
        raise InputError(f"the call-out {quote(text)} has a limit above {MOST:g} mm, rad or mm³: check its unit")
    if 0.0 in (call_out.short, call_out.long):
        raise InputError(f"the call-out {quote(text)} states a length of 0 mm, it must be above 0 mm: correct it")
    if call_out.short is not None and call_out.long is not None and call_out.short >= call_out.long:
        raise InputError(
            f"the call-out {quote(text)} has the lengths {call_out.short:g} and {call_out.long:g} mm, the first of a "
            "band, or the sampling length of a slope, must be the shorter one: correct them"
        )
    require_consistent([call_out])
    return call_out


def require_consistent(call_outs: Iterable[CallOut]) -> None:
    """Raise `InputError` if call-outs of one drawing contradict each other."""
    limits = [(one, limit) for one in call_outs for limit in one.limits]
    for (first, one), (second, other) in combinations(limits, 2):
        bands = [
            (each.standard, each.band if each.standard == "ISO 21920" else (each.short, each.long))
            for each in (first, second)
        ]
        if bands[0] != bands[1]:
            continue
        where = quote(first.text) if first is second else f"{quote(first.text)} and {quote(second.text)}"
        shown = [f"{limit.symbol} to {limit.value * first.scale:.4g} {first.unit}" for limit in (one, other)]
        if one.symbol == other.symbol and one.value != other.value and first.exponent == second.exponent:
            raise InputError(f"the call-outs {where} limit {shown[0]} and {shown[1]}: state one limit")
        for larger, part in WHOLE_AND_PART:
            values = {one.symbol: one.value, other.symbol: other.value}
            if {larger, part} == values.keys() and values[part] > values[larger]:
                raise InputError(
                    f"the call-out {where} limits {shown[0]} and {shown[1]}, but {part} never exceeds {larger}: "
                    "correct one of them"
                )


def _read_form(text: str, match: re.Match[str]) -> CallOut:
    *sizes, common, clauses = match.groups()
    stated = {"A": sizes[:2], "B": sizes[2:4], "C": sizes[4:]}
    if common and not any(unit for _, unit in stated.values()):
        stated = {symbol: [number, common] for symbol, (number, _) in stated.items()}
    if len({bool(unit) for number, unit in stated.values() if number}) > 1:
        raise InputError(
            f"the call-out {quote(text)} states some of A, B and C with a unit and some without: write it after the "
            "bracket for all, or after each number"
        )
    wavelength = _read_clauses(text, clauses, stated)
    limits = []
    for symbol, (number, unit) in stated.items():
        if number and not unit and wavelength is None:
            raise InputError(
                f"the call-out {quote(text)} states {symbol} = {number} in fringe spacings without their wavelength: "
                "add it, such as λ = 546.07 nm, or write nm after each number"
            )
        if number:
            size = parse(f"{number} {unit}", "mm") if unit else float(number) * (wavelength or 0.0) / 2
            limits.append(Limit(symbol, size))
    if not limits:
        raise InputError(f"the call-out {quote(text)} states 0 limits, it needs at least 1: leave it out")
    return CallOut(text=text, standard="ISO 10110-5", limits=tuple(limits), wavelength=wavelength)


def _read_clauses(text: str, clauses: str, stated: dict[str, Any]) -> float | None:
    """Add the rms limits after 3/A(B/C) to those stated, and return the wavelength. [mm]."""
    wavelength = None
    for clause in re.findall(r"RMS[^R;λ]*|[^;\s][^;]*", clauses.replace("lambda", "λ")):
        rms, wave = _RMS.fullmatch(clause.strip()), _WAVELENGTH.fullmatch(clause.strip())
        if wave is not None and wavelength is None:
            wavelength = _read_wavelength(text, *wave.groups())
        elif rms is not None and f"RMS{rms.group(1)}" not in stated:
            stated[f"RMS{rms.group(1)}"] = [rms.group(2), rms.group(3)]
        else:
            cause = "after 3/A(B/C) it can have RMSt, RMSi, RMSa and λ, each once"
            if _AREA.fullmatch(clause.strip()):
                cause = "a diameter of test areas, only the whole clear aperture can be judged"
            raise InputError(f"the call-out {quote(text)} has {clause.strip()[:40]!r}, {cause}: correct it")
    return wavelength


def _read_wavelength(text: str, number: str, unit: str) -> float:
    """Return the wavelength of fringe spacings. [mm]."""
    if not unit:
        raise InputError(f"the wavelength {number} of the call-out {quote(text)} has no unit: write λ = {number} nm")
    wavelength = parse(f"{number} {unit}", "mm")
    if not WAVELENGTHS[0] <= wavelength <= WAVELENGTHS[1]:
        raise InputError(
            f"the wavelength of the call-out {quote(text)} is {say_length(wavelength)}, the limits are "
            f"{say_length(WAVELENGTHS[0])} and {say_length(WAVELENGTHS[1])}: check its unit"
        )
    return wavelength


def _read_band(text: str, match: re.Match[str]) -> CallOut:
    symbol, number, unit, short, long = match.groups()
    if unit is None:
        raise InputError(f"{symbol} of the call-out {quote(text)} has no unit: write {symbol} {number} nm")
    return CallOut(
        text=text, standard="ISO 10110-8", limits=(Limit(symbol, parse(f"{number} {unit}", "mm")),),
        short=float(short), long=float(long),
    )  # fmt: skip


def _read_psd(text: str, match: re.Match[str]) -> CallOut:
    number, unit, exponent, short, long = match.groups()
    spelled = re.sub(r"\s|\^", "", unit or "").replace("²", "2").replace("³", "3").replace("μ", "µ").replace("u", "µ")
    if spelled not in ("nm2mm", "µm3"):
        raise InputError(
            f"the density of the call-out {quote(text)} has {f'the unit {unit[:20]!r}' if unit else 'no unit'}, and "
            "editions of ISO 10110-8 differ in it: write nm² mm for frequencies in 1/mm, or µm³ for those in 1/µm"
        )
    factor = NM**-2 if spelled == "nm2mm" else 1e-9 * 1e3 ** float(exponent)
    return CallOut(
        text=text, standard="ISO 10110-8", limits=(Limit("PSD", float(number) * factor),),
        short=float(short), long=float(long), exponent=float(exponent),
    )  # fmt: skip


def _read_slope(text: str, match: re.Match[str]) -> CallOut:
    rms, number, unit, long, long_unit, short, short_unit = match.groups()
    try:
        limit = parse(f"{number} {unit}", "rad")
    except UnitError as error:
        raise InputError(f"the slope of the call-out {quote(text)} needs a unit such as mrad: {error}") from error
    return CallOut(
        text=text, standard="ISO 10110-12", limits=(Limit("rms slope" if rms else "slope", limit),),
        short=None if short is None else parse(f"{short} {short_unit or 'mm'}", "mm"),
        long=parse(f"{long} {long_unit or 'mm'}", "mm"),
    )  # fmt: skip


def _read_profile(text: str, match: re.Match[str]) -> CallOut:
    before_short, before_long, symbol, number, unit, after_short, after_long, cutoff = match.groups()
    if before_long and (after_long or cutoff):
        raise InputError(f"the call-out {quote(text)} states its nesting indices twice: remove one")
    short, long = before_short or after_short, before_long or after_long or cutoff
    if long is None and symbol not in SETTINGS:
        raise InputError(
            f"the call-out {quote(text)} has no nesting index, only {' and '.join(SETTINGS)} have a default here: "
            f"write 0.0025-0.8 / {symbol} {number}"
        )
    return CallOut(
        text=text, standard="ISO 21920", limits=(Limit(symbol, convert(float(number), unit or "um", "mm")),),
        short=None if short is None else float(short), long=None if long is None else float(long),
    )  # fmt: skip


_READERS = (
    (_FORM, _read_form),
    (_PROFILE, _read_profile),
    (_BAND_RMS, _read_band),
    (_PSD, _read_psd),
    (_SLOPE, _read_slope),
)
