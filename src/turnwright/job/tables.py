"""The base class of the tables of a job, and values that they state by name or file."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path as File
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from pydantic import BeforeValidator

from turnwright._arrays import Floats, Value, same
from turnwright._tables import ByName, TableModel, types_of, write_table
from turnwright._validate import check_numbers, key_of
from turnwright.errors import InputError, JobError, MapError, UnitError, quote
from turnwright.files import read_map
from turnwright.instrument import Instrument
from turnwright.machine import PLAUSIBLE, ErrorSizes, Machine
from turnwright.material import Material
from turnwright.post import dialect_of
from turnwright.surface import Family, Gridded, Scattered
from turnwright.tool import WavinessTable
from turnwright.units import Flag, Number, Size, Slope, Text, Thickness, parse, write

if TYPE_CHECKING:
    from pydantic import ValidationInfo

__all__ = [
    "AnyInstrument",
    "AnyMachine",
    "ExistingFile",
    "HeightFile",
    "MachineDeviations",
    "Table",
    "context_of",
    "name_keys",
    "with_interpolation",
]  # fmt: skip


class Table(TableModel, Value):
    """Base class of the tables of a job file that only hold values."""

    __slots__ = ()
    like: ClassVar[Any] = None
    """Class or function whose docstring explains the fields of the same names."""


def read_columns(file: File, columns: Mapping[str, str]) -> Iterator[Floats]:
    """Read a CSV table whose first row names the columns with their units, such as ``sweep [deg],deviation [um]``.

    Lines starting with # are comments. Yields each of the named columns in the stated unit. (n,)

    Raises
    ------
    JobError
        If the file is not a CSV table, a column is missing or a value is not a number.
    UnitError
        If a column has the wrong unit.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as lines:
            rows = [row for row in csv.reader(lines) if row and not row[0].lstrip().startswith("#")]
    except (UnicodeDecodeError, csv.Error) as error:
        raise JobError(f"{file.name} is not a CSV table in UTF-8 ({error}): save it as plain text") from error
    heads = [re.fullmatch(r"\s*(.*?)\s*\[(.*)\]\s*", cell) for cell in (rows[0] if rows else [])]
    units = {head.group(1): (place, head.group(2)) for place, head in enumerate(heads) if head}
    for name, wanted in columns.items():
        if name not in units:
            raise JobError(
                f"{file.name} has no column {name!r} in its first row: name its columns like "
                f"{','.join(f'{key} [{value}]' for key, value in columns.items())!r}"
            )
        place, have = units[name]
        values = np.empty(len(rows) - 1)
        for number, row in enumerate(rows[1:]):
            text = f"{row[place] if place < len(row) else ''} {have}"
            try:
                values[number] = parse(text, wanted)
            except UnitError as error:
                raise UnitError(f"{file.name}, row {number + 1} below the header, column {name}: {error}") from error
        yield values


def existing_file(text: str, folder: str | PathLike[str]) -> File:
    """Return the absolute path of a file, relative to the folder of the job file."""
    file = File(folder) / text
    if not os.path.isfile(file):  # noqa: PTH113 - also false for an invalid path
        if os.path.exists(file):  # noqa: PTH110 - likewise
            raise JobError(f"{text!r} must be a file, got a folder or a device")
        raise JobError(
            f"the file {text!r} does not exist in the folder of the job file: correct its path, or copy it there"
        )
    return file.resolve()


def _check_existing(text: object, info: ValidationInfo) -> object:
    return existing_file(str(text), (info.context or {}).get("folder", ".")) if isinstance(text, str | File) else text


ExistingFile: TypeAlias = Annotated[File, BeforeValidator(_check_existing)]


def _dialect(name: object, info: ValidationInfo) -> object:
    """Return the name of a dialect unchanged, or the absolute path of its file."""
    is_file = isinstance(name, str) and name.endswith(".toml")
    return str(_check_existing(name, info)) if is_file else name


DialectName: TypeAlias = Annotated[Text, BeforeValidator(_dialect)]


def context_of(folder: str | PathLike[str]) -> dict[str, Any]:
    """Return the validation context of a job: the folder of its files, and their readers."""
    return {"folder": folder, "readers": READERS}


def _correction(text: str, folder: str) -> Gridded:
    file = existing_file(text, folder)
    heights = read_map(file)
    if heights.x is None or heights.y is None or heights.scattered or np.isnan(heights.z).any():
        raise JobError(
            f"{file.name} must be a grid of heights over x and y without gaps: name a file that turnwright correct "
            "wrote"
        )
    return Gridded(x=heights.x, y=heights.y, z=heights.z, source=HeightFile(file=file))


def _material(text: str, folder: str) -> str:
    """Return the name of a known material unchanged, or the absolute path of a material file."""
    if not text.endswith(".toml"):
        if text and Material.named(text) is None:
            raise JobError(
                f"{quote(text)} is not a known material: {Material.suggest(text)}; give a .toml file of "
                "your own material, or state a material without cutting data as material_note"
            )
        return text
    file = str(existing_file(text, folder))
    Material.load(file)
    return file


def _waviness(text: str, folder: str) -> WavinessTable:
    """Return the waviness of an edge from its certificate: columns sweep and deviation with units in the header."""
    file = existing_file(text, folder)
    sweep, deviation = read_columns(file, {"sweep": "rad", "deviation": "mm"})
    return WavinessTable(sweep=sweep, deviation=deviation, file=str(file))


READERS: dict[str, Callable[[str, str], Any]] = {
    "correction": _correction,
    "material": _material,
    "waviness": _waviness,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightFile(Family):
    """Heights from a file of any kind that `turnwright.read_map` reads. See `turnwright.Gridded`.

    Parameters
    ----------
    file
        Table or list of heights, or a measured map: text, CSV, Zemax grid sag and others.
    units
        Unit of x and y, where the file does not state it.
    sag_units
        Unit of the heights, where the file does not state it.
    pixel_size
        Pixel size of a file without lengths: one, or one along x and one along y. [mm]
    inverted
        Whether the heights of the file increase into the material.
    """

    family = "gridded"
    example = MappingProxyType({"file": "heights.csv", "units": "mm", "sag_units": "mm"})
    file: ExistingFile
    units: Literal["m", "mm", "um", "in"] | None = None
    sag_units: Literal["m", "mm", "um", "nm", "in"] | None = None
    pixel_size: Size | tuple[Size, Size] | None = None
    inverted: Flag = False

    @property
    def heights(self) -> Gridded | Scattered:
        """The surface through the heights, read again when the file has changed."""
        stamp = self.file.stat()
        return _load_heights(self, (stamp.st_mtime_ns, stamp.st_size))


def name_keys(message: str, where: str) -> str:
    """Return a message on a missing unit with the keys of the job that state it, and their table."""
    message = re.sub("unit='mm', or as a column '([xy]) ", rf"units = 'mm' in {where}, or as a column '\1 ", message)
    return message.replace("unit='mm', or", f"sag_units = 'mm' in {where}, or")


@lru_cache(maxsize=4)
def _load_heights(stated: HeightFile, _stamp: tuple[int, int]) -> Gridded | Scattered:
    file = stated.file
    try:
        heights = read_map(file, unit=stated.sag_units, lateral_unit=stated.units or "", pixel_size=stated.pixel_size)
    except MapError as error:
        raise JobError(name_keys(str(error).replace(str(file), file.name), "the job")) from error
    if not heights.calibrated:
        raise JobError(f"{file.name} counts pixels and does not state their size: state pixel_size")
    z = -heights.z if stated.inverted else heights.z
    if heights.x is None or heights.y is None:
        raise JobError(f"{file.name} holds a polar grid: write its heights over x and y, or as a list of points")
    if heights.scattered:
        valid = np.isfinite(z)
        return Scattered(x=heights.x[valid], y=heights.y[valid], z=z[valid], source=stated)
    return Gridded(x=heights.x, y=heights.y, z=z, source=stated)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MachineDeviations(Table):
    """Deviations of the actual machine from the planned one.

    Parameters
    ----------
    squareness
        Deviation of X and Z from a right angle: the error of Z is this times X. [rad]
    straightness_file
        File with the columns x and error, with units in the header: the error of Z over X.
    """

    squareness: Slope | None = None
    straightness_file: ExistingFile | None = None

    @property
    def stated(self) -> dict[str, Any]:
        """The stated deviations as arguments of `Machine`."""
        stated: dict[str, Any] = {} if self.squareness is None else {"squareness": self.squareness}
        if self.straightness_file is not None:
            stated["straightness"] = tuple(read_columns(self.straightness_file, {"x": "mm", "error": "mm"}))
        return stated

    def deviating(self, machine: Machine) -> Machine:
        """Return the machine with the stated deviations."""
        file = self.straightness_file
        sources = {**machine.sources, "straightness": str(file)} if file else machine.sources
        return replace(machine, sources=sources, **self.stated)

    def __post_init__(self) -> None:
        check_numbers(self)
        _ = self.stated


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MachineTable(MachineDeviations):
    """The lathe, by a name that comes with Turnwright or by a machine file. See `turnwright.Machine`.

    Parameters
    ----------
    name
        One of the lathes that come with Turnwright; otherwise give a file.
    file
        Your own machine file, in place of the name.
    dialect
        Dialect of the controller, or a ``.toml`` file of one, where it differs from that of the machine file.
    interpolation
        Interpolation between the points, where the controller offers several; that of the machine by default.
    plausible
        Plausible sizes of the machine's errors, where they differ from the machine file.
    """

    name: Text | None = None
    file: ExistingFile | None = None
    dialect: DialectName | None = None
    interpolation: Text | None = None
    plausible: ErrorSizes = field(default_factory=dict)

    def build(self) -> Machine:
        """Return the machine."""
        if (self.name is None) == (self.file is None):
            raise JobError("the machine needs either name or file, got both or neither")
        loaded = Machine.load(self.file or self.name or "")
        default_interpolation = loaded.controller.interpolation
        machine = loaded if self.interpolation is None else with_interpolation(loaded, self.interpolation)
        machine = replace(
            machine, plausible={**machine.plausible, **self.plausible}, dialect=self.dialect or machine.dialect
        )
        machine = self.deviating(machine)
        dialect, interpolation = dialect_of(machine), machine.controller.interpolation
        # Any interpolation but the controller's default must be selected in the program.
        if interpolation not in (default_interpolation, dialect.interpolation):
            raise JobError(
                f"interpolation must be {dialect.interpolation}, which the dialect {dialect.name} selects, or "
                f"{default_interpolation}, the default of {machine.name}, got {interpolation!r}"
            )
        return machine

    @classmethod
    def table_of(cls, machine: Machine) -> dict[str, Any]:
        """Return the table of a machine in a job: its name or file, and the differences from it.

        Raises `InputError` if it was not loaded from a file, or has differences that a job cannot state.
        """
        if machine.loaded is None:
            raise InputError(f"a job names a machine by its file, {machine.name!r} has none: write a machine file")
        name, loaded = machine.loaded
        table: dict[str, Any] = {"file" if File(name).suffix or File(name).is_absolute() else "name": name}
        if machine.controller != loaded.controller:
            table["interpolation"] = machine.controller.interpolation
            loaded = with_interpolation(loaded, machine.controller.interpolation)
        if machine.dialect != loaded.dialect:
            table["dialect"] = machine.dialect
        if machine.squareness != loaded.squareness:
            table["squareness"] = write(machine.squareness, "rad")
        if not same(machine.straightness, loaded.straightness):
            file = machine.sources.get("straightness", "")
            if not File(file).is_absolute():
                raise InputError(
                    f"a job names a straightness by its file, that of {machine.name!r} has none: write a file"
                )
            table["straightness_file"] = file
        sizes = {name: size for name, size in machine.plausible.items() if loaded.plausible.get(name) != size}
        if sizes:
            table["plausible"] = {key_of(name): write(size, PLAUSIBLE[name]) for name, size in sizes.items()}
        stated = replace(
            loaded,
            dialect=machine.dialect,
            squareness=machine.squareness,
            straightness=machine.straightness,
            plausible=machine.plausible,
            sources=machine.sources,
        )
        if stated != machine:
            raise InputError(f"{machine.name!r} differs from its file in values that no job states: write them there")
        return table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InstrumentTable(Table):
    """The instrument that a prediction is filtered by. See `turnwright.Instrument`.

    Parameters
    ----------
    name
        One of the instruments that come with Turnwright; the other keys replace its values.
    file
        Your own ``.toml`` file of an instrument, in place of the name.
    """

    like = Instrument
    name: Text | None = None
    file: ExistingFile | None = None
    pixel: Size | None = None
    numerical_aperture: Number | None = None
    wavelength: Size | None = None
    resolution: Size | None = None
    filling: Number | None = None
    stylus_radius: Size | None = None
    noise: Thickness | None = None

    def build(self) -> Instrument:
        """Return the instrument."""
        if self.name is not None and self.file is not None:
            raise JobError("the instrument needs either name or file, got both")
        if self.name is not None and self.name not in Instrument.known():
            raise JobError(
                f"the instrument is {quote(self.name)}, the known ones are {', '.join(Instrument.known())}: choose "
                "one, name a .toml file, or state its pixel and resolution"
            )
        source = self.file or self.name
        base = Instrument() if source is None else Instrument.load(source)
        values = {key: getattr(self, key) for key in types_of(type(self)) if key not in ("name", "file")}
        stated = {key: value for key, value in values.items() if value is not None}
        if not stated and source is None:
            raise JobError("the instrument has no values: give its name, a file, or its resolution, such as pixel")
        return replace(base, **stated)

    @classmethod
    def table_of(cls, instrument: Instrument) -> dict[str, Any]:
        """Return the table of an instrument in a job: its name or file, and the differences from it."""
        source, base = instrument.loaded or ("", Instrument())
        table: dict[str, Any] = {"file" if source.endswith(".toml") else "name": source} if source else {}
        stated = write_table(instrument, base=base)
        return table | {key: stated[key] for key in types_of(cls) if key in stated and key != "name"}


def with_interpolation(machine: Machine, interpolation: str) -> Machine:
    """Return a machine whose controller uses an interpolation and offers no other."""
    chosen = machine.interpolating(interpolation)
    return replace(chosen, controller=replace(chosen.controller, other_interpolations={}))


def _instrument(value: object) -> object:
    if isinstance(value, str):
        return {"file" if value.endswith(".toml") else "name": value}
    return value


AnyMachine: TypeAlias = Annotated[Machine, ByName(MachineTable)]
AnyInstrument: TypeAlias = Annotated[Instrument, ByName(InstrumentTable), BeforeValidator(_instrument)]
