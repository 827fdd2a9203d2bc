"""Zemax lens files, ``.zmx``: lines of a word of four letters and its values, indented below each ``SURF``.

The types of surfaces follow the formulas of the manual. Parameters from 13 on are the extra data of older versions, so
that ``PARM 13`` is ``XDAT 1``. Lengths are in the unit of the file and coefficients in its powers.

Sources
-------
[Zemax]_ gives the sags and their parameters.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from turnwright.errors import InputError, quote
from turnwright.files.base import to_mm
from turnwright.files.lens import (
    MAX_SURFACES,
    LensFile,
    LensPhase,
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
from turnwright.surface import Biconic, Forbes, Gridded, Placed, Surface, Toroid, XYPolynomial, Zernike

__all__ = ["SIGNATURE", "read"]

SIGNATURE = re.compile(r"\s*(VERS|MODE|NAME|UNIT|SURF|NOTE)\b")

UNITS = {"MM": "mm", "CM": "cm", "IN": "in", "METER": "m"}

_SYSTEM = """
    VERS NOTE AUTH PFIL LANG ENPD ENVD FNUM OBNA FLOA GFAC GCAT RAIM PUSH SDMA OMMA ROPD HYPR PICB XFLN YFLN FWGN
    FWGT XFLD YFLD VDXN VDYN VCXN VCYN VANN ZVDX ZVDY ZVCX ZVCY ZVAN WWGT WWGN POLS GLRS GLRC GSTD NSCD COFN IWDP
    LUID EERA STUD WFNO DBDT EFFL PUPD PRIM ISNA EPDA APOD TELE AFOC CONF
"""
SYSTEM = frozenset(_SYSTEM.split())
"""Words of the whole lens that change no surface: names, apertures, fields, glass catalogues, display."""

_HARMLESS = """
    SSID FIMP HIDE MIRR SLAB POPS MEMA OEMA COAT SCAT VDSZ VPAR PPAR VCON VCUR VGLS VXDT VXDA PXDT PZUP PKUP PCUR
    PCON PGLS MAZH EDGE COMP FLAP TCED TOLE SCOL GLCZ BLNK
"""
HARMLESS = frozenset(_HARMLESS.split())
"""Words of a surface that change neither its shape nor its frame: coatings, display, solves that keep their value."""

_OPERANDS = """
    MOFF WAVE WLWT PRWV XFIE YFIE FLTP FLWT FVDX FVDY FVCX FVCY FVAN APER STPS TEMP PRES CWGT LTTL THIC
"""
OPERANDS = frozenset(_OPERANDS.split())
"""Operands of several configurations that change no surface; the first value of the others is its number."""

SHAPES = frozenset(("CRVT", "CONN", "SDIA", "APMN", "APMX", "APDX", "APDY"))
"""Operands that change the shape or the aperture of a surface, but not the direction of the light."""

FRINGE_TERMS = 37

BELOW = frozenset(("TOL", "MNUM", "MOFF"))
"""Words that begin what stands below the surfaces."""

CLEAR = ("CLAP", "SQAP", "ELAP", "UDAP", "UDAD", "USAP")
ONCE = frozenset(("TYPE", "CURV", "CONI", "DIAM", "DISZ", "GLAS", "GDAT", "OBDC", *CLEAR))
"""Words that a surface states once."""

OBSCURED = ("OBSC", "SQOB", "ELOB")


@dataclass(slots=True)
class _Words(Row):
    """One ``SURF``; ``values`` are its parameters, the extra data from 13 on, of which ``read`` are those in use."""

    values: dict[int, float] = field(default_factory=dict)
    read: set[int] = field(default_factory=set)
    clear: dict[str, tuple[float, ...]] = field(default_factory=dict)
    stated: dict[str, list[str]] = field(default_factory=dict)  # values of words that stand once
    grid: list[float] = field(default_factory=list)
    heights: dict[int, tuple[float, ...]] = field(default_factory=dict)
    scale: float = 1.0

    def parameter(self, place: int) -> float:
        """Return a parameter, 0 if it is not stated."""
        self.read.add(place)
        return self.values.get(place, 0.0)

    def entry(self, place: int) -> float:
        """Return an entry of the extra data, from 1."""
        return self.parameter(12 + place)

    def count(self, place: int = 1) -> int:
        """Return the number of terms, an entry of the extra data."""
        terms = self.entry(place)
        if not (terms.is_integer() and 0 <= terms <= 240):
            raise InputError(f"its number of terms is {terms:g}, it must be a whole number up to 240: correct the file")
        return int(terms)

    def terms(self, first: int = 3, count: int = 1) -> dict[int, float]:
        """Return the coefficients of the extra data in mm, from 1; what stands past their number is not in use."""
        stated = {place: self.entry(first - 1 + place) * self.scale for place in range(1, self.count(count) + 1)}
        self.read |= {place for place in self.values if place > 12 + count}
        return {place: value for place, value in stated.items() if value}

    def norm_radius(self, place: int = 2) -> float:
        """Return the normalisation radius, an entry of the extra data. [mm]."""
        radius = self.entry(place) * self.scale
        if radius <= 0:
            raise InputError(f"its normalisation radius is {radius:g} mm, it must be above 0: correct the file")
        return radius

    @property
    def vertex_radius(self) -> float:
        """Vertex radius. [mm]."""
        return self.radius * self.scale

    def powers(self, first: int, step: int, count: int = 8, at: int = 1) -> dict[int, float]:
        """Return the coefficients of the powers ``first``, ``first + step``, ... in mm from parameter ``at``."""
        return {
            power: self.parameter(at + place) * self.scale ** (1 - power)
            for place, power in enumerate(range(first, first + step * count, step))
        }

    def even_asphere(self) -> Surface:
        """Return the even asphere of the parameters 1 to 8."""
        return radial(self.vertex_radius, self.conic, self.powers(2, 2))


def _standard(row: _Words) -> Surface:
    return radial(row.vertex_radius, row.conic, {})


def _odd_asphere(row: _Words) -> Surface:
    return radial(row.vertex_radius, row.conic, row.powers(1, 1))


def _extended_asphere(row: _Words, step: int) -> Surface:
    """Powers of r / r0, of which the first is ``step``."""
    terms = row.terms()
    radius = row.norm_radius() if terms else 1.0
    return radial(
        row.vertex_radius, row.conic, {step * place: value / radius ** (step * place) for place, value in terms.items()}
    )


def _biconic(row: _Words) -> Surface:
    across = row.parameter(1) * row.scale or math.inf
    return Biconic(radius_x=across, radius_y=row.vertex_radius, conic_x=row.parameter(2), conic_y=row.conic)


def _toroid(row: _Words) -> Surface:
    """A curve in the yz plane, turned about a line along y: the torus of Turnwright with x and y exchanged."""
    terms = {power: value for power, value in row.powers(2, 2, 7, at=2).items() if value}
    torus = Toroid(
        radius_x=row.vertex_radius, conic=row.conic, terms=terms, radius_y=row.parameter(1) * row.scale or math.inf
    )
    return _with_zernike(row, torus.placed(rotation=math.pi / 2), "noll")


def _polynomial(row: _Words) -> Surface:
    terms = row.terms()
    base = radial(row.vertex_radius, row.conic, {})
    if not terms:
        return base
    radius = row.norm_radius()
    powers = {polynomial_powers(place): value for place, value in terms.items()}
    return base + XYPolynomial(terms={(i, j): value / radius ** (i + j) for (i, j), value in powers.items()})


def _with_zernike(row: _Words, base: Surface, indexing: str, decentre: tuple[float, float] = (0.0, 0.0)) -> Surface:
    """Return a base with the Zernike terms of the extra data; parameter 0 says whether they go on outside r0."""
    goes_on, terms = row.parameter(0), row.terms()
    if not terms:
        return base
    radius = row.norm_radius()
    if not goes_on:
        row.limit = radius - math.hypot(*decentre)
    if indexing == "fringe" and max(terms) > FRINGE_TERMS:
        raise InputError(
            f"it has the Zernike term {max(terms)}, fringe terms are 1 to {FRINGE_TERMS}: correct the file"
        )
    zernike: Surface = Zernike(terms=terms, radius=radius, indexing=indexing)  # type: ignore[arg-type]
    return base + (zernike.placed(shift=(*decentre, 0.0)) if any(decentre) else zernike)


def _zernike(row: _Words, indexing: str) -> Surface:
    decentre = row.parameter(9) * row.scale, row.parameter(10) * row.scale
    return _with_zernike(row, row.even_asphere(), indexing, decentre)


def _forbes(row: _Words) -> Surface:
    """Extra data of type, number of terms, normalisation radius and coefficients; or the type is parameter 0.

    Which of the two it is follows from the number of entries.
    """
    entries = [row.values.get(12 + place, 0.0) for place in (1, 2)]
    last = max(row.values, default=0) - 12
    layouts = {shift: last - (2 + shift + entries[shift]) for shift in (0, 1) if shift or 0 in row.values}
    fitting = [shift for shift, surplus in layouts.items() if surplus == 0] or [
        shift for shift, surplus in layouts.items() if surplus < 0 and (not shift or entries[0] in (0.0, 1.0))
    ]
    if len(fitting) != 1:
        raise InputError(f"its extra data has {last} entries, which do not fit its number of terms: correct the file")
    (shift,) = fitting
    kind = row.entry(1) if shift else row.parameter(0)
    if kind not in (0.0, 1.0):
        raise InputError(f"its type is {kind:g}, it must be 0 (Q-bfs) or 1 (Q-con): correct the file")
    terms = row.terms(3 + shift, 1 + shift)
    if kind == 0 and row.conic:
        raise InputError(f"its conic constant is {row.conic:g}, a Q-bfs surface is based on a sphere: set it to 0")
    return Forbes(
        radius=row.vertex_radius, conic=row.conic, norm_radius=row.norm_radius(2 + shift),
        kind="qcon" if kind else "qbfs", terms={place - 1: value for place, value in terms.items()},
    )  # fmt: skip


def _irregular(row: _Words) -> Surface:
    r"""Conic plus :math:`Z_s \rho^4 + Z_a \rho_y'^2 + Z_c \rho^2 \rho_y'`, decentred and tilted.

    :math:`\rho_y' = \rho_y \cos\theta - \rho_x \sin\theta`, with :math:`\rho` over the semi-diameter.
    """
    shift = row.parameter(1) * row.scale, row.parameter(2) * row.scale, 0.0
    tilt = math.radians(row.parameter(3)), math.radians(row.parameter(4))
    spherical, astigmatism, coma = (row.parameter(place) * row.scale for place in (5, 6, 7))
    along_y, along_x = math.cos(math.radians(row.parameter(8))), -math.sin(math.radians(row.parameter(8)))
    reach = (row.semi_diameter or 0.0) * row.scale
    if not reach and (spherical or astigmatism or coma):
        raise InputError("its spherical aberration, astigmatism and coma need its semi-diameter (DIAM): state it")
    surface = radial(row.vertex_radius, row.conic, {4: spherical / reach**4} if spherical else {})
    terms = {
        (2, 0): astigmatism * along_x**2, (1, 1): 2 * astigmatism * along_x * along_y, (0, 2): astigmatism * along_y**2,
        (3, 0): coma * along_x, (2, 1): coma * along_y, (1, 2): coma * along_x, (0, 3): coma * along_y,
    }  # fmt: skip
    if astigmatism or coma:
        surface = surface + XYPolynomial(terms={key: value / reach ** sum(key) for key, value in terms.items()})
    return Placed(surface=surface, shift=shift, tilt=tilt) if any(shift) or any(tilt) else surface


def _grid(row: _Words) -> Surface:
    """Even asphere, Zernike terms and a table of heights; the first height is at -x and +y, rows descend in y."""
    if row.parameter(0):
        raise InputError("its grid is interpolated linearly (PARM 0), which has creases: set it to bicubic")
    decentre = row.parameter(9) * row.scale, row.parameter(10) * row.scale
    base = _with_zernike(row, row.even_asphere(), "noll", decentre)
    if len(row.grid) not in (5, 7):
        raise InputError("its grid has no line GDAT of nx ny delx dely unit xdec ydec: it is in a file of its own")
    columns, rows, step_x, step_y, unit, *centre = row.grid
    if not (columns.is_integer() and rows.is_integer() and unit in (0, 1, 2, 3)) or len(row.heights) != columns * rows:
        raise InputError(f"its grid has {len(row.heights)} heights for {columns:g} x {rows:g} points: correct the file")
    scale = to_mm(("mm", "cm", "in", "m")[int(unit)], "the unit of a grid")
    points = [row.heights[place] for place in sorted(row.heights)]
    z = np.array([math.nan if point[4:] == (1.0,) else point[0] for point in points]) * scale
    if min(columns, rows) < 6:
        raise InputError(
            f"its table GRID_SAG has {columns:g} x {rows:g} heights, the spline needs 6 x 6: make it finer"
        )
    if any(any(point[1:4]) for point in points):
        raise InputError("its grid states slopes, which the spline of Turnwright does not take: set them to 0")
    x, y = (
        (np.arange(count) - (count - 1) / 2) * abs(step) * scale + at * scale
        for count, step, at in zip((columns, rows), (step_x, step_y), centre or (0.0, 0.0), strict=True)
    )
    return base + Gridded(x=x, y=y, z=z.reshape(int(rows), int(columns))[::-1])


def _binary(row: _Words) -> Surface:
    """An even asphere with a phase, which is not in its sag."""
    order = row.parameter(0)
    terms = {place: value / row.scale for place, value in row.terms().items()}  # rad
    if terms:
        last = max(terms)
        row.phase = LensPhase(
            order=order, radius=row.norm_radius(),
            coefficients=tuple(terms.get(place, 0.0) for place in range(1, last + 1)),
        )  # fmt: skip
    return row.even_asphere()


TYPES: Mapping[str, Callable[[_Words], Surface]] = {
    "STANDARD": _standard,
    "EVENASPH": _Words.even_asphere,
    "ODDASPHE": _odd_asphere,
    "XASPHERE": partial(_extended_asphere, step=2),
    "XOSPHERE": partial(_extended_asphere, step=1),
    "BICONICX": _biconic,
    "TOROIDAL": _toroid,
    "XPOLYNOM": _polynomial,
    "FZERNSAG": partial(_zernike, indexing="fringe"),
    "SZERNSAG": partial(_zernike, indexing="noll"),
    "QED_TYPE": _forbes,
    "IRREGULA": _irregular,
    "GRID_SAG": _grid,
    "BINARY_2": _binary,
}
"""Sag of a type of surface."""


def _build(row: Row) -> Surface:
    assert isinstance(row, _Words)  # noqa: S101 - for the type checker
    surface = TYPES[row.type](row)
    unused = [place for place, value in sorted(row.values.items()) if value and place not in row.read]
    if unused and row.type != "STANDARD":
        word = f"PARM {unused[0]}" if unused[0] < 13 else f"XDAT {unused[0] - 12}"
        raise InputError(f"{word} is {row.values[unused[0]]:g}, which a surface of type {row.type} does not have")
    return surface


def _outline(row: _Words) -> Outline | None:
    """Return the clear aperture where it is no disc on the axis."""
    shapes = row.clear.keys() - {"OBDC"}
    if len(shapes) > 1:
        raise InputError(f"its apertures are {' and '.join(sorted(shapes))}, one is read: remove the others")
    if not shapes & set(CLEAR):  # a decentre is then that of an obscuration
        return None
    x, y = (*row.clear.get("OBDC", ()), 0.0, 0.0)[:2]
    centre = x * row.scale, y * row.scale
    if other := shapes - {"CLAP", "SQAP"}:
        raise InputError(f"its aperture is {other.pop()}, an outline is a disc, an annulus or a rectangle: change it")
    if any(row.clear.get("SQAP", ())[2:]):
        raise InputError(
            "its aperture SQAP has more than two half-widths, which is not read: state an outline in the job"
        )
    if "SQAP" in row.clear:
        across, along = (2 * value * row.scale for value in (*row.clear["SQAP"], 0.0)[:2])
        return Outline(rectangle=(across, along), centre=centre)
    inner, outer = (value * row.scale for value in (*row.clear["CLAP"], 0.0)[:2])
    row.semi_diameter = outer / row.scale
    if inner:
        return Outline(annulus=(outer, inner), centre=centre)
    return Outline(disc=outer, centre=centre) if any(centre) and outer else None


@dataclass(slots=True)
class _Lens:
    """The whole lens while it is read."""

    path: Path
    name: str
    unit: str = ""
    waves: dict[int, float] = field(default_factory=dict)
    count: int = 0
    primary: int = 1
    configurations: int = 1
    stray: str = ""
    is_flat: bool = False  # whether the words of a surface are not indented
    rows: list[_Words] = field(default_factory=list)

    def read(self, word: str, values: list[str], line: str) -> None:
        """Read a word above the surfaces."""
        if word in SYSTEM:
            return
        if word not in LENS_WORDS:
            raise InputError(f"{self.path} has the word {quote(word)} above its surfaces, which is not read: remove it")
        try:
            LENS_WORDS[word](self, values or [""], line)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error

    def add(self, values: list[str]) -> None:
        """Begin the next surface."""
        if values[:1] != [str(len(self.rows))]:
            raise InputError(f"{self.path} has SURF {quote(' '.join(values))}, next is {len(self.rows)}: correct it")
        if len(self.rows) == MAX_SURFACES:
            raise InputError(f"{self.path} has over {MAX_SURFACES:,} surfaces, the limit: split the file")
        if self.stray:  # a merit function stands below the last surface only
            _read_word(self.rows[-1], self.stray, [], "")
            self.stray = ""
        self.rows.append(_Words(number=len(self.rows), type="STANDARD"))

    def read_below(self, word: str, values: list[str]) -> None:
        """Read a line below the surfaces: merit function, tolerances, and configurations that change a surface."""
        if word == "MNUM" and values:
            self.configurations = int(to_number(values[0], "MNUM"))
        elif self.configurations > 1:
            for row in self.rows[1:]:
                is_turned = word == "THIC" and row.thickness * to_number((*values, "", "", "")[2], word) < 0
                if values[:1] == [str(row.number)] and (is_turned or word not in OPERANDS):
                    refuse = row.refuse if word in SHAPES else row.doubt
                    refuse(f"differs between the {self.configurations} configurations ({word}): save one of them")

    def finish(self) -> LensFile:
        """Return the lens."""
        if not self.rows:
            raise InputError(f"{self.path} has no surface (SURF): it is not a Zemax lens file")
        if not self.unit:
            raise InputError(f"{self.path} states no UNIT, known are {', '.join(UNITS)}: add the line")
        if self.stray and self.is_flat:
            _read_word(self.rows[-1], self.stray, [], "")
        scale = to_mm(self.unit, f"{self.path} has the unit")
        for row in self.rows:
            row.scale = scale
            row.aperture = partial(_outline, row)
            if row.type == "COORDBRK":
                _break(row)
            elif row.type not in TYPES:
                row.scatters = True
                refuse = row.doubt if row.type == "NONSEQCO" else row.refuse
                refuse(f"has the type {quote(row.type)}, which is not read; known are {', '.join(TYPES)}")
        wavelengths = tuple(value for place, value in sorted(self.waves.items()) if place <= (self.count or place))
        return LensFile(
            name=self.name, program="Zemax", unit=self.unit, wavelengths=wavelengths,
            primary=self.waves.get(self.primary), surfaces=finish(self.rows, scale, _build),
        )  # fmt: skip


def read(path: Path, text: str) -> LensFile:
    """Read a Zemax lens file."""
    lens = _Lens(path=path, name=path.name)
    is_below = False
    for line in text.splitlines():
        word, *values = line.split() or [""]
        is_below = word in BELOW or (is_below and word != "SURF")
        if word == "SURF":
            lens.add(values)
        elif word and not lens.rows:
            lens.read(word, values, line)
        elif is_below:
            lens.read_below(word, values)
        elif word and (line[0] in " \t" or word in SURFACE_WORDS or word in HARMLESS):
            lens.is_flat |= word in SURFACE_WORDS and line[0] not in " \t"
            _read_word(lens.rows[-1], word, values, line)
        else:
            lens.stray = lens.stray or word
    return lens.finish()


def _rest(line: str) -> str:
    return plain_text("".join(line.split(maxsplit=1)[1:]))


def _unit(lens: _Lens, values: list[str], _line: str) -> None:
    lens.unit = UNITS.get(values[0].upper(), "")
    if not lens.unit:
        raise InputError(f"its unit is {quote(values[0])}, known are {', '.join(UNITS)}: save it in one of them")


def _mode(_lens: _Lens, values: list[str], _line: str) -> None:
    if values[0] != "SEQ":
        raise InputError(f"its mode is {quote(values[0])}, only sequential lenses (SEQ) are read: choose another file")


def _name(lens: _Lens, _values: list[str], line: str) -> None:
    lens.name = _rest(line) or lens.path.name


def _wave(lens: _Lens, values: list[str], _line: str) -> None:
    lens.waves[to_integer(values[0], "WAVM")] = to_number((*values, "")[1], "WAVM") / 1e3


def _waves(lens: _Lens, values: list[str], _line: str) -> None:
    lens.waves = {place: to_number(value, "WAVL") / 1e3 for place, value in enumerate(values, 1)}


def _count(lens: _Lens, values: list[str], _line: str) -> None:
    lens.count = to_integer(values[3], "FTYP") if len(values) > 3 else 0


def _primary(lens: _Lens, values: list[str], _line: str) -> None:
    lens.primary = to_integer(values[0], "PWAV")


LENS_WORDS: Mapping[str, Callable[[_Lens, list[str], str], None]] = {
    "UNIT": _unit, "MODE": _mode, "NAME": _name, "WAVM": _wave, "WAVL": _waves, "FTYP": _count, "PWAV": _primary,
}  # fmt: skip
"""Words of the whole lens that are read."""


def _read_word(row: _Words, word: str, values: list[str], line: str) -> None:
    """Read one word of a surface."""
    if word in HARMLESS:
        return
    if word not in SURFACE_WORDS:
        row.doubt(f"has the word {quote(word)}, which is not read: remove it if it does not change the shape")
        return
    refuse = row.doubt if word in ("TYPE", "PARM", "DISZ", "GLAS") else row.refuse
    try:
        SURFACE_WORDS[word](row, values or [""], line)
    except InputError as error:
        refuse(f"cannot be read: {error}")
    if word in ONCE and row.stated.setdefault(word, values) != values:
        refuse(f"cannot be read: {word} is stated twice with different values: remove one")


def _number(name: str) -> Callable[[_Words, list[str], str], None]:
    def read_number(row: _Words, values: list[str], line: str) -> None:
        setattr(row, name, to_number(values[0], f"the value of {line.split(maxsplit=1)[0]}"))

    return read_number


def _curvature(row: _Words, values: list[str], _line: str) -> None:
    curvature = to_number(values[0], "CURV")
    row.radius = 1 / curvature if curvature else math.inf


def _type(row: _Words, values: list[str], _line: str) -> None:
    row.type = plain_text(values[0])


def _stop(row: _Words, _values: list[str], _line: str) -> None:
    row.is_stop = True


def _comment(row: _Words, _values: list[str], line: str) -> None:
    row.comment = _rest(line)


def _thickness(row: _Words, values: list[str], _line: str) -> None:
    row.thickness = math.inf if values[0] == "INFINITY" else to_number(values[0], "DISZ")


def _parameter(row: _Words, values: list[str], line: str) -> None:
    word = line.split(maxsplit=1)[0]
    place = to_integer(values[0], word) + 12 * (word == "XDAT")
    value = to_number((*values, "")[1], f"{word} {values[0]}")
    if row.values.setdefault(place, value) != value:
        raise InputError(f"{word} {values[0]} is stated twice with different values: remove one")


def _glass(row: _Words, values: list[str], _line: str) -> None:
    """Read a glass; the index is that of a model glass, for others it is a default."""
    name = values[0]
    row.is_mirror = name.upper() == "MIRROR"
    if (name == "___BLANK" or values[1:2] == ["1"]) and len(values) > 3:
        row.index = to_number(values[3], "the index of GLAS")
    row.glass = f"model glass n = {row.index:g}" if name == "___BLANK" and row.index else plain_text(name)


def _clear(row: _Words, values: list[str], line: str) -> None:
    word = line.split(maxsplit=1)[0]
    row.clear[word] = tuple(to_number(value, word) for value in values)


def _grid_size(row: _Words, values: list[str], _line: str) -> None:
    row.grid = [to_number(value, "GDAT") for value in values]


def _grid_height(row: _Words, values: list[str], _line: str) -> None:
    if not row.fault:
        row.heights[to_integer(values[0], "GARR")] = tuple(to_number(value, "GARR") for value in values[1:])


SURFACE_WORDS: Mapping[str, Callable[[_Words, list[str], str], None]] = {
    "TYPE": _type, "CURV": _curvature, "CONI": _number("conic"), "DIAM": _number("semi_diameter"),
    "DISZ": _thickness, "PARM": _parameter, "XDAT": _parameter, "GLAS": _glass, "STOP": _stop, "COMM": _comment,
    "GDAT": _grid_size, "GARR": _grid_height, **dict.fromkeys((*CLEAR, *OBSCURED, "OBDC"), _clear),
}  # fmt: skip
"""Words of a surface that are read."""


def _break(row: _Words) -> None:
    """Read a coordinate break: no surface, but a frame that may be turned against the light."""
    row.passes = True
    row.is_decentred = bool(row.parameter(1) or row.parameter(2))
    x, y, z = (row.parameter(place) for place in (3, 4, 5))
    # With parameter 6 it is the inverse of a break with the opposite angles: about z first, then about y and x.
    row.enter = row.enter @ (rotation(-x, -y, -z).T if row.parameter(6) else rotation(x, y, z))
    row.refuse("is a coordinate break, which has no shape: choose another surface")
