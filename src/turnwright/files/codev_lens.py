"""CODE V lens files, ``.seq``: commands of up to three letters, separated by line ends or ``;``.

A line that ends in ``&`` goes on, and ``!`` begins a comment. ``S`` adds a surface: its radius, or with ``RDM N`` its
curvature, its thickness and its glass. Lengths are in the unit of ``DIM``, by default mm.

Sources
-------
[CODEV]_ gives commands and sags.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from turnwright.errors import InputError, quote
from turnwright.files.base import to_mm
from turnwright.files.lens import (
    MAX_SURFACES,
    RIGHT_ANGLE_TOL,
    UNKNOWN,
    LensFile,
    Row,
    finish,
    plain_text,
    polynomial_powers,
    radial,
    rotation,
    to_integer,
    to_number,
)
from turnwright.outline import Outline
from turnwright.surface import Surface, Toroid, XYPolynomial, Zernike

__all__ = ["is_codev", "read"]

UNITS = {"M": "mm", "MM": "mm", "C": "cm", "CM": "cm", "I": "in", "IN": "in"}

_SYSTEM = """
    LEN EPD FNO NA NAO WTW TEM PRE INI XAN YAN XIM YIM XOB YOB XRI YRI WTF VUX VLX VUY VLY DOR WID CWL PUI PUX PUY
    AFI TEL RAY PFR PTP DDM SSI POL GO CAN RED END CLS DER PIK
    CA UID SUR LIS
"""
SYSTEM = frozenset(_SYSTEM.split())
"""Commands that change no surface: apertures, fields, weights."""

_HARMLESS = """
    CCY CCX THC KC AC BC CC DC EC FC GC HC JC XDC YDC ZDC ADC BDC CDC SCC HCC GLC INC GC1 GC2 COA MLT THM CUM TCE PIM IC
"""
HARMLESS = frozenset(_HARMLESS.split())
"""Commands of a surface that change neither its shape nor its frame: coupling of variables, coatings, solves."""

EDITS = frozenset(("SCA", "FLY", "INS", "DEL", "COP", "MOV", "RES"))
"""Commands that change surfaces stated before."""

TILTS = ("ADE", "BDE", "CDE")

_SOLVES = "UMY UMX UCY UCX IMY IMX ICY ICX AMY AMX ACY ACX HMY HMX HCY HCX PIM PIK OAL"
SOLVES = frozenset(_SOLVES.split())
"""Solves of a radius or a thickness, which keep the stated one."""

QUALIFIER = re.compile(r"(?i)s(?:\d|['\"]|[aois](?:$|\.\.|[-+]\d))")
"""Beginning of a word that names surfaces: S3, S1..4, SA for all, SO, SI, SS for the stop, or S'label'."""

LABEL = re.compile("L['\"]")
"""Beginning of the label of one of several apertures, in capitals."""

MAX_COMMAND = 100_000
"""Characters of a command over all its lines."""

POWERS = {letter: 4 + 2 * place for place, letter in enumerate("ABCDEFGHJ")}
"""Powers of the distance from the axis of the coefficients A, B, ..."""

SPECIAL = {"SPS XYP": (2, 66, "NRADIUS"), "SPS ODD": (2, 31, "C33"), "SPS ZFR": (4, 40, "C3")}
"""First and last coefficient of the special surfaces that are read, and the name of their normalisation radius."""


@dataclass(slots=True)
class _Words(Row):
    """One surface: its commands."""

    label: str = ""
    unstated: bool = False  # whether its first value may be a radius or a curvature
    across: float | None = None  # radius in x
    powers: dict[int, float] = field(default_factory=dict)
    special: dict[str, float] = field(default_factory=dict)
    tilts: dict[str, float] = field(default_factory=dict)
    clear: dict[frozenset[str], dict[str, float]] = field(default_factory=dict)  # words of each aperture
    scale: float = 1.0


def is_codev(text: str) -> bool:
    """Whether a text has an object and a surface of CODE V."""
    return all(re.search(rf"(?im)(?:^|;)[ \t]*{word}[ \t]+[-+.&\d]", text) for word in ("SO", "S"))


def _commands(path: Path, text: str) -> Iterator[list[str]]:
    """Yield the words of each command, without comments; quoted text is one word."""
    joined = ""
    for line in text.splitlines():
        bare = re.match(r"(?:'[^']*'|\"[^\"]*\"|[^!'\"]|['\"])*", line)
        joined += (bare[0] if bare else "").rstrip()
        if joined.endswith("&"):
            joined = joined[:-1] + " "
            if len(joined) > MAX_COMMAND:
                raise InputError(f"{path} has a command of over {MAX_COMMAND:,} characters, the limit: correct it")
            continue
        for command in re.findall(r"(?:'[^']*'|\"[^\"]*\"|[^;])+", joined):
            if words := re.findall(r"(?:'[^']*'|\"[^\"]*\"|\S)+", command):
                yield words
        joined = ""
    if joined:
        raise InputError(f"{path} ends within a command, after &: it is cut short, export it again")


@dataclass(slots=True)
class _Lens:
    """The whole lens while it is read."""

    path: Path
    name: str
    radii: bool | None
    unit: str = "mm"
    waves: tuple[float, ...] = ()
    reference: int = 1
    is_private: bool = False
    has_image: bool = False
    rows: list[_Words] = field(default_factory=list)

    def read(self, command: str, values: list[str]) -> None:
        """Read a command."""
        self.is_private = command == "PRV" or (self.is_private and command != "END")
        if self.is_private or command[:3] in SYSTEM:
            return
        if command[:3] in EDITS:
            raise InputError(
                f"{self.path} has the command {quote(command)}, which changes surfaces: save the lens again"
            )
        if command in ("S", "SO", "SI", f"S{len(self.rows)}"):
            self.has_image |= command == "SI"
            self.add(values)
        elif QUALIFIER.match(command):
            raise InputError(
                f"{self.path} has {quote(command)}, the next surface is {len(self.rows)}: correct the file"
            )
        elif command[:3] in LENS_COMMANDS:
            try:
                LENS_COMMANDS[command[:3]](self, values or [""])
            except InputError as error:
                raise InputError(f"{self.path}: {error}") from error
        elif self.rows:
            _read_command(self, command, values)
        else:
            raise InputError(f"{self.path} has the command {quote(command)}, which is not read: remove it")

    def add(self, values: list[str]) -> None:
        """Begin the next surface: radius or curvature, thickness, glass."""
        if len(self.rows) == MAX_SURFACES:
            raise InputError(f"{self.path} has over {MAX_SURFACES:,} surfaces, the limit: split the file")
        row = _Words(number=len(self.rows), type="SPH")
        self.rows.append(row)
        first, thickness, glass, mode, *more = (*values, *("" for _ in range(4 - len(values))))
        bend = to_number(first, f"{self.path}: the first value of surface {row.number}")
        row.unstated = bend != 0 and self.radii is None
        if bend and not row.unstated:
            row.radius = bend if self.radii else 1 / bend
        if re.fullmatch(r"(?i)inf(inity)?", thickness):
            row.thickness = math.inf
        else:
            row.thickness = to_number(thickness or "0", f"{self.path}: the thickness of surface {row.number}")
        _glass(row, glass)
        if more:
            row.doubt(f"has {len(values)} values, radius, thickness, glass and mode are read: remove the others")
        elif mode:
            _read_value(row, "RMD", [mode])

    def named(self, word: str, command: str) -> list[_Words]:
        """Return the surfaces that a qualifier names."""
        if word.upper() == "SA":
            return self.rows
        labels = [f"'{row.label.upper()}'" for row in self.rows]
        numbers = {str(row.number): row.number for row in self.rows}
        numbers |= {label: place for place, label in enumerate(labels) if labels.count(label) == 1}
        numbers |= {"O": 0} | ({"I": len(self.rows) - 1} if self.has_image else {})
        stops = [row.number for row in self.rows if row.is_stop]
        numbers |= {"S": stops[-1]} if stops else {}
        ends = [re.sub("^S(?=.)", "", end).replace('"', "'") for end in word[1:].upper().split("..")]
        first, last = numbers.get(ends[0]), numbers.get(ends[-1])
        if first is None or last is None or len(ends) > 2 or first > last:
            raise InputError(
                f"{command} names the surface {quote(word)}, which does not stand above it: correct the file"
            )
        return self.rows[first : last + 1]

    def qualified(self, command: str, values: list[str], keep: int = 0) -> tuple[list[list[_Words]], list[str]]:
        """Return the surfaces that qualifiers name, and the other values, of which the last ``keep`` are none."""
        words, others = values[: len(values) - keep], values[len(values) - keep :]
        names = [word for word in words if QUALIFIER.match(word)]
        return [self.named(word, command) for word in names], [word for word in words if word not in names] + others

    def finish(self) -> LensFile:
        """Return the lens."""
        if self.is_private:
            raise InputError(f"{self.path} has no END after PRV: it is cut short, export it again")
        scale = to_mm(self.unit, f"{self.path} has the unit")
        for row in self.rows:
            row.scale = scale
            row.aperture = partial(_outline, row)
            _place(row, self.rows)
            if row.unstated:
                row.refuse(
                    "begins with a number that may be a radius or a curvature: add the line RDM Y (radii) or RDM N "
                    "(curvatures) to the file, or state which it is"
                )
        return LensFile(
            name=self.name, program="CODE V", unit=self.unit, wavelengths=self.waves,
            primary=self.waves[self.reference - 1] if 0 < self.reference <= len(self.waves) else None,
            surfaces=finish(self.rows, scale, _build),
        )  # fmt: skip


def read(path: Path, text: str, radii: bool | None = None) -> LensFile:
    """Read a CODE V lens file; ``radii`` where it does not state ``RDM``."""
    lens = _Lens(path=path, name=path.name, radii=radii)
    for command, *values in _commands(path, text):
        lens.read(command.upper(), values)
    return lens.finish()


def _radius_mode(lens: _Lens, values: list[str]) -> None:
    lens.radii = not values[0].upper().startswith("N")


def _unit(lens: _Lens, values: list[str]) -> None:
    lens.unit = UNITS.get(values[0].upper(), "")
    if not lens.unit:
        raise InputError(f"its unit is DIM {quote(values[0])}, known are M (mm), C (cm) and I (inch): correct it")


def _title(lens: _Lens, values: list[str]) -> None:
    lens.name = plain_text(" ".join(values)) or lens.name


def _waves(lens: _Lens, values: list[str]) -> None:
    lens.waves = tuple(to_number(value, "WL") / 1e6 for value in values)


def _reference(lens: _Lens, values: list[str]) -> None:
    lens.reference = to_integer(values[0], "REF")


def _zoom(lens: _Lens, values: list[str]) -> None:
    """Refuse a surface whose shape differs between zoom positions."""
    word = values[0].upper()
    if word in HARMLESS:
        return
    groups, values = lens.qualified("ZOO", values)
    if word == "THI" and len({value.startswith("-") for value in values[1:]}) < 2:
        return
    if not groups and word in SURFACE_COMMANDS:
        groups = [lens.rows[-1:]]
    for row in itertools.chain(*groups):
        refuse = row.refuse if word in SHAPES else row.doubt
        refuse(f"differs between zoom positions (ZOO {word}): save one of them")


LENS_COMMANDS: Mapping[str, Callable[[_Lens, list[str]], None]] = {
    "RDM": _radius_mode, "DIM": _unit, "TIT": _title, "WL": _waves, "REF": _reference, "ZOO": _zoom,
}  # fmt: skip
"""Commands of the whole lens that are read."""


def _read_command(lens: _Lens, command: str, values: list[str]) -> None:
    """Read a command of a surface: the last one, or those that qualifiers such as S3 name."""
    word = command if command in SURFACE_COMMANDS else command[:3]
    if word in HARMLESS:
        return
    groups, values = lens.qualified(command, values, keep=int(word == "GLA"))
    if word == "RET" and groups:
        values = [str(groups.pop()[0].number)]
    for row in itertools.chain(*groups or [lens.rows[-1:]]):
        if word not in SURFACE_COMMANDS:
            row.doubt(f"has the command {quote(command)}, which is not read: remove it if it does not change the shape")
            continue
        _read_value(row, word, values or [""])


def _read_value(row: _Words, word: str, values: list[str]) -> None:
    try:
        SURFACE_COMMANDS[word](row, word, values)
    except InputError as error:
        refuse = row.refuse if word in SHAPES else row.doubt
        refuse(f"cannot be read: {error}")


def _glass(row: _Words, word: str) -> None:
    """Read a glass: a name, REFL, AIR, or a number such as 517000.520000 for n = 1.517 and V = 52."""
    word = plain_text(word)
    row.is_mirror = word.upper() in ("REFL", "MIRROR")
    if model := re.fullmatch(r"(\d{3,})\.(\d+)|(\d\.\d+)(?::[\d.]+)?", word):
        row.index = float(model[3] or f"1.{model[1]}")
    row.glass = "" if row.is_mirror or word.upper() == "AIR" else word


def _alone(word: str, values: list[str]) -> float:
    """Return the only value of a command."""
    if len(values) != 1:
        raise InputError(f"{word} has the values {quote(' '.join(values))}, it must have one: correct the file")
    return to_number(values[0], word)


def _is_solve(values: list[str]) -> bool:
    return values[0].upper() in SOLVES


def _bend(row: _Words, word: str, values: list[str]) -> None:
    """Read a radius or a curvature; a solve keeps the stated one."""
    if _is_solve(values):
        return
    bend = _alone(word, values)
    radius = math.inf if not bend else bend if word.startswith("RD") else 1 / bend
    if word.endswith("Y"):
        row.radius, row.unstated = radius, False
    else:
        row.across = radius


def _thickness(row: _Words, word: str, values: list[str]) -> None:
    row.thickness = row.thickness if _is_solve(values) else _alone(word, values)


def _stop(row: _Words, _word: str, _values: list[str]) -> None:
    row.is_stop = True


def _label(row: _Words, word: str, values: list[str]) -> None:
    row.comment = plain_text(" ".join(values))
    row.label = row.comment if word == "SLB" else row.label


def _none(word: str, values: list[str]) -> None:
    if values != [""]:
        raise InputError(f"{word} has the value {quote(' '.join(values))}, it has none: correct the file")


def _shape(row: _Words, word: str, values: list[str]) -> None:
    _none(word, values)
    row.type = word


def _special_shape(row: _Words, word: str, values: list[str]) -> None:
    """Read a special shape, and its normalisation radius where it follows."""
    row.type = plain_text(f"{word} {values[0].upper()}")
    if len(values) > 1 and (norm := _alone(word, values[1:])):
        row.special["NRADIUS"] = norm


def _special_value(row: _Words, word: str, values: list[str]) -> None:
    row.special[values[0].upper()] = _alone(f"{word} {values[0]}", values[1:])


def _state(row: _Words, word: str, values: list[str]) -> None:
    """Read a glass, or whether the surface reflects; total internal reflection is one."""
    if len(values) != 1 or (word == "RMD" and values[0].upper() not in ("REFR", "REFL", "TIR")):
        raise InputError(f"{word} has the values {quote(' '.join(values))}, which are not read: correct the file")
    reflects = row.is_mirror
    if word == "GLA":
        _glass(row, values[0])
    else:
        row.is_mirror = values[0].upper() != "REFR"
    if reflects and not row.is_mirror:
        raise InputError(f"{word} is {quote(values[0])} after words that make it reflect: state the glass, then RMD")


def _conic(row: _Words, word: str, values: list[str]) -> None:
    row.conic = _alone(word, values)


def _power(row: _Words, word: str, values: list[str]) -> None:
    row.powers[POWERS[word]] = _alone(word, values)


def _fresnel(_row: _Words, word: str, values: list[str]) -> None:
    if _alone(word, values):
        raise InputError("it is a Fresnel surface (CUF), which is not read: choose another")


def _tilt(row: _Words, word: str, values: list[str]) -> None:
    row.tilts[word] = _alone(word, values)


def _order_of_tilts(row: _Words, word: str, values: list[str]) -> None:
    """Read DAR, BEN or REV; RET has the surface to whose frame this one returns."""
    if word == "RET":
        row.returns = to_integer(values[0], word)
        values = [""] if row.returns < row.number else values
    _none(word, values)
    row.tilts[word] = 1.0


def _place(row: _Words, rows: list[_Words]) -> None:
    """Read decentres and tilts, which last unless DAR ends them, BEN repeats them or REV only undoes them behind."""
    turned = rotation(*(row.tilts.get(word, 0.0) for word in TILTS))
    kinds = {"DAR", "BEN", "REV", "RET"} & row.tilts.keys()
    row.is_decentred = any(row.tilts.get(word) for word in ("XDE", "YDE"))
    returning = [] if row.returns is None else [row, rows[row.returns]]
    if (
        len(kinds) > 1
        or (kinds and turned[2, 2] < RIGHT_ANGLE_TOL)
        or any(one.tilts.get(word) for one in returning for word in TILTS)
    ):
        row.enter, row.leave, row.returns = UNKNOWN, UNKNOWN, None
    else:
        row.enter = row.enter if "REV" in kinds else row.enter @ turned
        row.leave = row.leave @ (turned if "BEN" in kinds else turned.T if kinds else np.eye(3))


def _aperture(row: _Words, word: str, values: list[str]) -> None:
    """Read a word of an aperture: EDG is the edge of the lens, OBS an obscuration, HOL a hole; labels name others."""
    kinds = frozenset(value.upper() for value in values[:-1]) - {"CLR"}
    words = row.clear.setdefault(kinds, {})
    if "OBS" in kinds:
        return
    if unknown := {kind for kind in kinds if not LABEL.match(kind)} - {"EDG", "HOL"}:
        raise InputError(f"its aperture {word} has the word {quote(unknown.pop())}, which is not read: correct it")
    if words.setdefault(word, value := to_number(values[-1], word)) != value:
        raise InputError(f"its aperture {' '.join([word, *kinds])} is both {words[word]:g} and {value:g}: state one")


SURFACE_COMMANDS: Mapping[str, Callable[[_Words, str, list[str]], None]] = {
    **dict.fromkeys(("RDY", "CUY", "RDX", "CUX"), _bend), "THI": _thickness, "STO": _stop, "SLB": _label, "COM": _label,
    **dict.fromkeys(("SPH", "CON", "ASP", "XTO", "YTO"), _shape), "SPS": _special_shape, "SCO": _special_value,
    "GLA": _state, "RMD": _state, "K": _conic, "CUF": _fresnel, **dict.fromkeys(POWERS, _power),
    **dict.fromkeys(("XDE", "YDE", "ZDE", *TILTS), _tilt),
    **dict.fromkeys(("DAR", "BEN", "REV", "RET"), _order_of_tilts),
    **dict.fromkeys(("CIR", "REX", "REY", "ELX", "ELY", "ADX", "ADY", "ARO"), _aperture),
}  # fmt: skip
"""Commands of a surface that are read."""


SHAPES = SURFACE_COMMANDS.keys() - {"THI", "GLA", "RMD", "XDE", "YDE", "ZDE", *TILTS, "DAR", "BEN", "REV", "RET"}
"""Commands of a surface that do not turn the light."""


def _build(row: Row) -> Surface:
    assert isinstance(row, _Words)  # noqa: S101 - for the type checker
    radius = row.radius * row.scale
    powers = {power: value * row.scale ** (1 - power) for power, value in row.powers.items() if value}
    if row.type in ("SPH", "CON", "ASP"):
        if (row.type == "SPH" and row.conic) or (row.type != "ASP" and powers) or row.across is not None:
            raise InputError(
                f"it is a {row.type} with values of another shape (K, A to J, RDX): state ASP, CON, XTO or YTO"
            )
        return radial(radius, row.conic, powers)
    if row.type in ("XTO", "YTO"):
        across = math.inf if row.across is None else row.across * row.scale
        along_x = row.type == "XTO"
        torus = Toroid(
            radius_x=across if along_x else radius,
            radius_y=radius if along_x else across,
            conic=row.conic,
            terms=powers,
        )
        return torus if along_x else torus.placed(rotation=math.pi / 2)
    if row.type not in SPECIAL:
        raise InputError(f"its type is {quote(row.type)}, known are SPH, CON, ASP, XTO, YTO, {', '.join(SPECIAL)}")
    return _special(row, radius)


def _special(row: _Words, radius: float) -> Surface:
    """A conic, C1 its K, plus C2, ... for x, y, x^2, ... (XYP) or r, r^2, ... (ODD), or C4, ... for Z1, ... (ZFR)."""
    named = dict(row.special)
    least, most, norm_name = SPECIAL[row.type]
    conic = row.conic or _one_of(named, "K", "C1")
    norm = (_one_of(named, "NRADIUS", norm_name) or 1.0) * row.scale
    if norm <= 0:
        raise InputError(f"its normalisation radius is {norm:g} mm, it must be above 0: correct the file")
    stated: dict[int, float] = {}
    for name, value in named.items():
        match = re.fullmatch(r"(C|AR)(\d{1,2})", name)
        place = int(match[2]) + (match[1] == "AR") if match and (match[1] == "C" or row.type == "SPS ODD") else 0
        if not least <= place <= most and value:
            raise InputError(f"its coefficient {quote(name)} is not read, known are C{least} to C{most}: remove it")
        if stated.setdefault(place, value) != value:
            raise InputError(f"its coefficient {quote(name)} has another value under its other name: remove one")
    terms = {place: value * row.scale for place, value in stated.items() if value}
    if row.type == "SPS ODD":
        return radial(radius, conic, {place - 1: value / norm ** (place - 1) for place, value in terms.items()})
    base = radial(radius, conic, {})
    if not terms:
        return base
    if row.type == "SPS ZFR":
        return base + Zernike(
            terms={place - 3: value for place, value in terms.items()}, radius=norm, indexing="fringe"
        )
    powers = {polynomial_powers(place - 1): value for place, value in terms.items()}
    return base + XYPolynomial(terms={(i, j): value / norm ** (i + j) for (i, j), value in powers.items()})


def _one_of(named: dict[str, float], *names: str) -> float:
    """Take the value that stands under one of several names, 0 without any."""
    values = {named.pop(name) for name in names if name in named}
    if len(values) > 1:
        raise InputError(f"it states {' and '.join(names)} with different values: remove one")
    return values.pop() if values else 0.0


def _outline(row: _Words) -> Outline | None:
    """Return the clear aperture where it is no disc on the axis; the edge of the lens where no other is stated."""
    obscured = {"OBS"}.union(*(kinds for kinds in row.clear if "OBS" in kinds))
    stated = [
        (kinds & {"EDG", "HOL"}, {word: value * row.scale for word, value in words.items() if value})
        for kinds, words in row.clear.items()
        if any(words.values()) and not kinds & obscured
    ]
    holes = [words for kinds, words in stated if "HOL" in kinds]
    shapes = [words for kinds, words in stated if not kinds] or [words for kinds, words in stated if kinds == {"EDG"}]
    if not shapes and not holes:
        return None
    places = [(words.pop("ADX", 0.0), words.pop("ADY", 0.0)) for words in (*shapes, *holes)]
    kinds = [words.keys() for words in (*shapes, *holes)]
    if shapes and kinds == [{"REX", "REY"}]:
        return Outline(rectangle=(2 * shapes[0]["REX"], 2 * shapes[0]["REY"]), centre=places[0])
    if len(shapes) != 1 or kinds not in ([{"CIR"}], [{"CIR"}, {"CIR"}]) or places != places[:1] * len(places):
        named = ", ".join(sorted({word for words in row.clear.values() for word in words}))
        raise InputError(f"its aperture of {named} is no disc, annulus or upright rectangle, which are read: change it")
    disc = shapes[0]["CIR"]
    row.semi_diameter = disc / row.scale
    if holes:
        return Outline(annulus=(disc, holes[0]["CIR"]), centre=places[0])
    return Outline(disc=disc, centre=places[0]) if any(places[0]) else None
