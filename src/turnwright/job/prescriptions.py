"""The prescriptions of a job file: a table for each family, chosen by the key ``family``.

To add a family, add its table here: it names the parameters with their units and builds the surface. A list of many
coefficients may hold plain numbers where the table states once which ``units`` its formula is written in.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeAlias, get_args

import numpy as np
from annotated_types import Ge
from pydantic import BeforeValidator, Field, Strict, model_validator

from turnwright import surface as surfaces
from turnwright.errors import JobError, MapError, UnitError
from turnwright.files import read_map
from turnwright.job.table import (
    Angle,
    Count,
    ExistingFile,
    Length,
    Number,
    Size,
    Table,
    Text,
    Thickness,
    refuse,
)
from turnwright.units import parse, unit

if TYPE_CHECKING:
    from turnwright.surface import Surface

__all__ = ["FAMILIES", "AnySurface"]

HIGHEST = 99
"""A coefficient of a higher power of 1/mm belongs to no series."""

Coordinate: TypeAlias = tuple[Length, Length]


def _as_sum(data: object) -> object:
    """Read a list of tables as their sum."""
    return {"family": "sum", "terms": data} if isinstance(data, list | tuple) else data


def _level(data: object) -> object:
    """Read a bare height as the level plane there."""
    return {"family": "plane", "placed": {"shift": ["0 mm", "0 mm", data]}} if isinstance(data, str) else data


class Placement(Table):
    """Where a surface is put in the part frame: tilted, then rotated, then shifted.

    Parameters
    ----------
    shift
        Along x, y and z, after tilt and rotation. [mm]
    rotation
        About z, counter-clockwise seen from the tool. [rad]
    tilt
        About x and about y, before the rotation. [rad]
    """

    shift: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    rotation: Angle = 0.0
    tilt: tuple[Angle, Angle] = (0.0, 0.0)


class Family(Table):
    """What all prescriptions share.

    Parameters
    ----------
    family
        Which kind of surface it is.
    placed
        Where it is put in the part frame; about the axis if left out.
    """

    placed: Placement | None = None

    @abstractmethod
    def _build(self) -> Surface:
        """Return the surface about its own origin."""

    @cached_property
    def surface(self) -> Surface:
        """The surface where it is placed."""
        surface = self._build()
        if self.placed is None:
            return surface
        return surface.placed(shift=self.placed.shift, rotation=self.placed.rotation, tilt=self.placed.tilt)

    @model_validator(mode="after")
    def _can_exist(self) -> Self:
        _ = self.surface
        return self


class Series(Family):
    """A family with coefficients, as text with a unit or as plain numbers in the ``units`` of the formula.

    Once read, every coefficient is in mm to its power, and ``units`` says so.

    Parameters
    ----------
    units
        Which unit of length the formula of the coefficients is written in, so that they can be plain numbers;
        without it each coefficient is text with its own unit.
    """

    units: Literal["mm"] | None = None
    series: ClassVar[tuple[str, ...]] = ("terms",)

    @classmethod
    @abstractmethod
    def _power(cls, field: str, key: str) -> int:
        """Return the power of length that a coefficient has."""

    @model_validator(mode="before")
    @classmethod
    def _read_coefficients(cls, data: object) -> object:
        if not isinstance(data, Mapping):
            return data
        read = dict(data)
        problems: dict[tuple[str | int, ...], Exception | str] = {}
        units = data.get("units")
        if units is not None:
            try:
                parse(f"1 {units}", "mm")
            except UnitError as error:
                raise refuse(cls.__name__, {("units",): error}, units) from error
        for field in cls.series:
            given = data.get(field)
            values: dict[Any, float] = {}
            problems |= {(field, key): error for key, error in _repeated(given).items()}
            for key, value in _entries(given):
                try:
                    values[key] = _coefficient(value, units, cls._power(field, str(key)))
                except (UnitError, JobError) as error:
                    problems[field, key] = error
            if values:
                read[field] = values if isinstance(given, Mapping) else list(values.values())
            if values or units is not None:
                read["units"] = "mm"
        if problems:
            raise refuse(cls.__name__, problems, data)
        return read


def _entries(given: object) -> list[tuple[Any, object]]:
    """Return the keys and values of a table, or the places and values of a list."""
    if isinstance(given, Mapping):
        return list(given.items())
    return list(enumerate(given)) if isinstance(given, list | tuple) else []


def _coefficient(value: object, units: str | None, power: int) -> float:
    """Return a coefficient in mm^power."""
    if abs(power) > HIGHEST:
        raise JobError(f"its unit is mm^{power}, the limit is mm^-{HIGHEST}, a degree of {HIGHEST + 1}: leave it out")
    if units is not None and isinstance(value, int | float) and not isinstance(value, bool):
        return parse(f"{value!r} {_power_of(units, power)}", _power_of("mm", power))
    if not isinstance(value, str):
        raise UnitError(f"{value!r} has no unit: write it as text with a unit, or state the units of the formula once")
    return parse(value, _power_of("mm", power))


def _power_of(units: str, power: int) -> str:
    """Return a power of a unit as a person writes it."""
    if power == 0:
        return "1"
    raised = units if abs(power) == 1 else f"{units}^{abs(power)}"
    return raised if power > 0 else f"1/{raised}"


_DIGITS = "[0-9]{1,9}"
"""An index of more digits is none that any series has."""


def _indices(key: object) -> tuple[int, ...]:
    """Return the numbers that a key names, however it writes them."""
    return tuple(int(digits) for digits in re.findall(rf"-?{_DIGITS}", str(key)))


def _repeated(given: object) -> dict[Any, JobError]:
    """Return what is wrong with keys that say the same as one before them."""
    seen: dict[tuple[int, ...], object] = {}
    return {
        key: JobError(f"the key {key!r} means the same as {first!r}: remove one")
        for key, _ in _entries(given)
        if (first := seen.setdefault(_indices(key), key)) != key
    }


def _pair(key: str) -> tuple[int, int]:
    """Return a key that must be two whole numbers."""
    match = re.fullmatch(rf"\s*({_DIGITS})\s*,\s*(-?{_DIGITS})\s*", key)
    if match is None:
        raise JobError(f"the key {key!r} is not two whole numbers: name each coefficient like '2,0'")
    return int(match.group(1)), int(match.group(2))


def _whole(key: str) -> int:
    """Return a key that must be a whole number."""
    if re.fullmatch(_DIGITS, key) is None:
        raise JobError(f"the key {key!r} is not a whole number: name each coefficient by its number")
    return int(key)


class _Radius(unit):
    """A vertex radius: a length, or the word "flat" for one without end."""

    __slots__ = ()

    def read(self, text: object) -> float:
        """Return the radius. [mm]."""
        return float("inf") if text == "flat" else super().read(text)

    def show(self, value: float | None) -> str | None:
        """Return text that `read` takes back to the same number."""
        return "flat" if value == float("inf") else super().show(value)


Radius: TypeAlias = Annotated[float, _Radius("mm")]


class PlaneTable(Family):
    """See `turnwright.Plane`."""

    family: Literal["plane"]
    slope: tuple[Number, Number] = (0.0, 0.0)

    def _build(self) -> Surface:
        return surfaces.Plane(slope=self.slope)


class SphereTable(Family):
    """See `turnwright.Sphere`."""

    family: Literal["sphere"]
    radius: Radius

    def _build(self) -> Surface:
        return surfaces.Sphere(radius=self.radius)


class ConicTable(Family):
    """See `turnwright.Conic`."""

    family: Literal["conic"]
    radius: Radius
    conic: Number

    def _build(self) -> Surface:
        return surfaces.Conic(radius=self.radius, conic=self.conic)


class EvenAsphereTable(Series):
    """See `turnwright.EvenAsphere`; its terms are named by the power of the distance from the axis."""

    family: Literal["even asphere"]
    radius: Radius
    conic: Number
    terms: dict[int, Number]

    @classmethod
    def _power(cls, _field: str, key: str) -> int:
        return 1 - _whole(key)

    def _build(self) -> Surface:
        return surfaces.EvenAsphere(radius=self.radius, conic=self.conic, terms=self.terms)


class ToroidTable(Family):
    """See `turnwright.Toroid`."""

    family: Literal["toroid"]
    radius_x: Radius
    radius_y: Radius

    def _build(self) -> Surface:
        return surfaces.Toroid(radius_x=self.radius_x, radius_y=self.radius_y)


class BiconicTable(Family):
    """See `turnwright.Biconic`."""

    family: Literal["biconic"]
    radius_x: Radius
    radius_y: Radius
    conic_x: Number
    conic_y: Number

    def _build(self) -> Surface:
        return surfaces.Biconic(
            radius_x=self.radius_x, radius_y=self.radius_y, conic_x=self.conic_x, conic_y=self.conic_y
        )


class XYPolynomialTable(Series):
    """See `turnwright.XYPolynomial`; its terms are named by the powers of x and y, such as "2,0"."""

    family: Literal["xy polynomial"]
    terms: dict[str, Number]

    @classmethod
    def _power(cls, _field: str, key: str) -> int:
        return 1 - sum(_pair(key))

    def _build(self) -> Surface:
        return surfaces.XYPolynomial(terms={_pair(key): value for key, value in self.terms.items()})


class RadialPolynomialTable(Series):
    """See `turnwright.RadialPolynomial`; its coefficients are lists that begin with r^2."""

    family: Literal["radial polynomial"]
    radial: tuple[Number, ...] = ()
    slope: tuple[Number, ...] = ()
    tilt: Number = 0.0
    series: ClassVar[tuple[str, ...]] = ("radial", "slope")

    @classmethod
    def _power(cls, field: str, key: str) -> int:
        return (1 if field == "radial" else 0) - 2 * (int(key) + 1)

    def _build(self) -> Surface:
        return surfaces.RadialPolynomial(radial=self.radial, slope=self.slope, tilt=self.tilt)


class ZernikeTable(Series):
    """See `turnwright.Zernike`; its terms are named by their index."""

    family: Literal["zernike"]
    terms: dict[int, Number]
    radius: Size
    indexing: Literal["fringe", "noll", "ansi"]
    normalised: Annotated[bool, Strict()] | None = None

    @classmethod
    def _power(cls, _field: str, key: str) -> int:
        _whole(key)
        return 1

    def _build(self) -> Surface:
        return surfaces.Zernike(
            terms=self.terms, radius=self.radius, indexing=self.indexing, normalised=self.normalised
        )


class ForbesTable(Series):
    """See `turnwright.Forbes`; its terms are named by n, those of "q2d" by n and m, such as "0,-2"."""

    family: Literal["forbes"]
    radius: Radius
    conic: Number
    norm_radius: Size
    kind: Literal["qbfs", "qcon", "q2d"]
    terms: dict[str, Number]

    @classmethod
    def _power(cls, _field: str, _key: str) -> int:
        return 1

    def _build(self) -> Surface:
        read = _pair if self.kind == "q2d" else _whole
        return surfaces.Forbes(
            radius=self.radius,
            conic=self.conic,
            norm_radius=self.norm_radius,
            kind=self.kind,
            terms={read(key): value for key, value in self.terms.items()},  # type: ignore[arg-type]
        )


class SineGridTable(Family):
    """See `turnwright.SineGrid`."""

    family: Literal["sine grid"]
    amplitude: tuple[Length, Length]
    period: tuple[Size, Size]
    phase: tuple[Angle, Angle] = (0.0, 0.0)

    def _build(self) -> Surface:
        return surfaces.SineGrid(amplitude=self.amplitude, period=self.period, phase=self.phase)


class ExpressionTable(Family):
    """See `turnwright.Expression`; ``units`` says that the formula is written in mm.

    Parameters
    ----------
    units
        The formula is written in mm.
    """

    family: Literal["expression"]
    formula: Text
    units: Literal["mm"]
    constants: dict[str, Number] = Field(default_factory=dict)
    feature_size: Size | None = None

    def _build(self) -> Surface:
        return surfaces.Expression(self.formula, constants=self.constants, feature_size=self.feature_size)  # type: ignore[arg-type]


class GriddedTable(Family):
    """See `turnwright.Gridded`; the file is of any kind that `turnwright.read_map` reads.

    Parameters
    ----------
    file
        Table or list of heights, or a map of an instrument: text, CSV, Zemax grid sag and others.
    units
        Of x and y, where the file does not state it.
    sag_units
        Of the heights, where the file does not state it.
    pixel_size
        Of a file that counts pixels: one size, or one along x and one along y. [mm]
    inverted
        Whether the heights of the file grow into the material.
    """

    family: Literal["gridded"]
    file: ExistingFile
    units: Literal["m", "mm", "um", "in"] | None = None
    sag_units: Literal["m", "mm", "um", "nm", "in"] | None = None
    pixel_size: Size | tuple[Size, Size] | None = None
    inverted: Annotated[bool, Strict()] = False

    def _build(self) -> Surface:
        stamp = self.file.stat()
        return _tabulated(
            self.file, (stamp.st_mtime_ns, stamp.st_size), self.units, self.sag_units, self.pixel_size, self.inverted
        )


def with_keys(told: str, where: str) -> str:
    """Return a message on a missing unit with the keys of a job that state it, and where they stand."""
    told = re.sub("unit='mm', or as a column '([xy]) ", rf"units = 'mm' in {where}, or as a column '\1 ", told)
    return told.replace("unit='mm', or", f"sag_units = 'mm' in {where}, or")


@lru_cache(maxsize=4)
def _tabulated(
    file: File,
    _stamp: tuple[int, int],
    units: str | None,
    sag_units: str | None,
    pixel_size: float | tuple[float, float] | None,
    inverted: bool,
) -> Surface:
    """Return the surface through the heights of a file, which is read anew when it has changed."""
    try:
        found = read_map(file, unit=sag_units, lateral_unit=units or "", pixel_size=pixel_size)
    except MapError as error:
        raise JobError(with_keys(str(error).replace(str(file), file.name), "the job")) from error
    if not found.calibrated:
        raise JobError(f"{file.name} counts pixels and does not say how large they are: state pixel_size")
    z = -found.z if inverted else found.z
    if found.x is None or found.y is None:
        raise JobError(f"{file.name} holds a polar grid: write its heights over x and y, or as a list of points")
    if found.scattered:
        known = np.isfinite(z)
        return surfaces.Scattered(x=found.x[known], y=found.y[known], z=z[known])
    return surfaces.Gridded(x=found.x, y=found.y, z=z)


class SumTable(Family):
    """Heights added; a list of tables where one surface is wanted means the same.

    Parameters
    ----------
    terms
        The surfaces whose heights are added.
    """

    family: Literal["sum"]
    terms: tuple[AnySurface, ...]

    def _build(self) -> Surface:
        return surfaces.Sum(terms=tuple(term.surface for term in self.terms))


class OffAxisTable(Family):
    """See `turnwright.OffAxis`; the parent is any prescription."""

    family: Literal["off-axis"]
    parent: AnySurface
    distance: Thickness
    azimuth: Angle = 0.0

    def _build(self) -> Surface:
        return surfaces.OffAxis(parent=self.parent.surface, distance=self.distance, azimuth=self.azimuth)


class LensArrayTable(Family):
    """See `turnwright.LensArray`, its ``square`` and ``hexagonal``.

    Parameters
    ----------
    layout
        How the lenslets stand.
    pitch
        Distance between neighbours. [mm]
    rows
        Of a square array.
    columns
        Of a square array.
    rings
        Around the lenslet in the middle of a hexagonal array.
    within
        Only lenslets that lie whole within this radius. [mm]
    offset
        Where the middle of the array stands. [mm]
    centres
        Of listed lenslets, one by one. [mm]
    """

    family: Literal["lens array"]
    layout: Literal["square", "hexagonal", "listed"]
    lenslet: AnySurface
    pitch: Size | None = None
    rows: Count | None = None
    columns: Count | None = None
    rings: Annotated[int, Strict(), Ge(0)] | None = None
    within: Size | None = None
    offset: Coordinate | None = None
    centres: tuple[Coordinate, ...] | None = None
    aperture: Size | None = None
    surround: Annotated[AnySurface, BeforeValidator(_level)] | None = None

    def _build(self) -> Surface:
        used = {
            "square": ("pitch", "rows", "columns", "within", "offset"),
            "hexagonal": ("pitch", "rings", "within", "offset"),
            "listed": ("centres",),
        }[self.layout]
        given = {
            name: getattr(self, name)
            for name in ("pitch", "rows", "columns", "rings", "within", "offset", "centres")
            if getattr(self, name) is not None
        }
        for name in given:
            if name not in used:
                raise JobError(
                    f"{name} does not go with the layout {self.layout!r}, which takes {', '.join(used)}: remove it"
                )
        if used[0] not in given:
            raise JobError(f"the layout {self.layout!r} needs {used[0]}, which is missing: add it")
        if self.layout == "listed":
            given["centres"] = np.array(self.centres, dtype=np.float64).reshape(-1, 2)
        make: Callable[..., Surface] = surfaces.LensArray
        if self.layout != "listed":
            make = getattr(surfaces.LensArray, self.layout)
        return make(
            lenslet=self.lenslet.surface,
            aperture=self.aperture,
            surround=self.surround.surface if self.surround else None,
            **given,
        )


_Tagged: TypeAlias = Annotated[
    PlaneTable
    | SphereTable
    | ConicTable
    | EvenAsphereTable
    | ToroidTable
    | BiconicTable
    | XYPolynomialTable
    | RadialPolynomialTable
    | ZernikeTable
    | ForbesTable
    | SineGridTable
    | ExpressionTable
    | GriddedTable
    | SumTable
    | LensArrayTable
    | OffAxisTable,
    Field(discriminator="family"),
]
AnySurface: TypeAlias = Annotated[_Tagged, BeforeValidator(_as_sum)]
"""Any prescription: a table with its ``family``, or a list of such tables, which are added."""

FAMILIES: dict[str, type[Family]] = {
    get_args(table.model_fields["family"].annotation)[0]: table for table in get_args(get_args(_Tagged)[0])
}
SumTable.model_rebuild()
LensArrayTable.model_rebuild()
OffAxisTable.model_rebuild()
