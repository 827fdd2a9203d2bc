"""The lathe: axes, controller and geometric errors, and the files that describe it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Floats, Value, frozen
from turnwright._faults import read_table
from turnwright._io import bytes_of, read_toml
from turnwright._tables import Columns, Loaded, Plausible, Sources, TableModel, flat
from turnwright._validate import check_angle, check_numbers, plausible_sizes, positive
from turnwright.errors import InputError, LimitError, quote
from turnwright.machine.axes import Axes, Axis
from turnwright.machine.controller import Controller, Convention
from turnwright.units import Number, Slope, Text

__all__ = ["Machine"]

MAX_BASES = 8
"""Machine files in a chain of ``base`` keys."""

PLAUSIBLE = MappingProxyType(
    {"squareness": "rad", "straightness": "mm", "servo lag": "rad", "drift of X": "mm", "drift of Z": "mm"}
)
"""Error sources whose plausible size a machine may give, and their units."""

PLAUSIBLE_TEXTS = MappingProxyType({
    "squareness": "Squareness of the X slide to the spindle.",
    "straightness": "Straightness of the X slide.",
    "servo lag": "Angle of C by which Z lags.",
    "drift of X": "Drift over the time of a cut; limited only by the maps if not given.",
    "drift of Z": "Drift over the time of a cut; limited only by the maps if not given.",
})  # fmt: skip

ErrorSizes: TypeAlias = Annotated[Mapping[str, float], Plausible(PLAUSIBLE, PLAUSIBLE_TEXTS, slopes=("squareness",))]

MAX_SQUARENESS_RAD = 0.1
"""Largest squareness error; larger values are taken for a wrong unit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Machine(TableModel, Value):
    """A lathe with a C axis.

    Parameters
    ----------
    name
        Name of the machine.
    axes
        `Axis` by letter, at least "C", "X" and "Z".
    spindle_rpm
        Highest speed of the spindle as a C axis. [rev/min]
    spindle_mode_rpm
        Highest speed of the spindle in spindle mode; ``None`` for a machine that does not turn in spindle mode.
        [rev/min]
    block_rate_hz
        Program blocks per second that the controller executes, coordinated over all axes. [1/s]
    dialect
        Name of the program dialect, or the path of its ``.toml`` file; in a machine file relative to its folder.
    convention
        Signs and zero of the controller's axes.
    controller
        Interpolation of the controller.
    squareness
        Height error of the tip per distance along X: Z error = squareness * X. [rad]
    straightness
        Further height error of the tip along X: ascending positions and errors, linear in between, constant beyond the
        ends. ((n,), (n,)) [mm]
    plausible
        Plausible sizes (standard deviations) of errors, where they differ from `ERROR_SOURCES`: "squareness" [rad],
        "straightness" [mm], "servo lag" [rad]; and "drift of X", "drift of Z" over the time of a cut [mm], limited only
        by the maps if not given.
    sources
        Source of each value, by field ("axes.X.speed"); assumed values are marked.
    loaded
        Name given to `load` and the value it loaded; ``None`` for a machine that was not loaded.

    Raises
    ------
    InputError
        If an axis is missing, a limit is not positive, or a geometric error is out of range.

    Examples
    --------
    >>> machine = Machine.load("nanotech-350fg")
    >>> machine.block_rate_hz
    1000.0
    >>> machine.sources["axes.X.acceleration"]
    'assumed'
    """

    hidden = ("loaded",)
    name: Text
    axes: Annotated[Mapping[str, Axis], Axes]
    spindle_rpm: Number
    block_rate_hz: Number
    spindle_mode_rpm: Number | None = None
    dialect: Text = "generic"
    convention: Convention = Convention()  # noqa: RUF009 - frozen
    controller: Controller = Controller()  # noqa: RUF009 - frozen
    squareness: Slope = 0.0
    straightness: Annotated[tuple[Floats, Floats], Columns(x_mm=1.0, error_nm=1e-6)] | None = None
    plausible: ErrorSizes = field(default_factory=dict)
    sources: Annotated[Mapping[str, str], Sources] = field(default_factory=dict)
    loaded: Loaded | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "axes", MappingProxyType(dict(self.axes)))
        object.__setattr__(self, "plausible", plausible_sizes(self.plausible, PLAUSIBLE))
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))
        missing = sorted({"C", "X", "Z"} - set(self.axes))
        if missing:
            raise InputError(f"machine {self.name!r} lacks axis {', '.join(missing)}: give at least C, X and Z")
        object.__setattr__(self, "spindle_rpm", positive(self.spindle_rpm, "spindle_rpm", "rev/min"))
        if self.spindle_mode_rpm is not None:
            positive(self.spindle_mode_rpm, "spindle_mode_rpm", "rev/min")
        object.__setattr__(self, "block_rate_hz", positive(self.block_rate_hz, "block_rate_hz", "blocks/s"))
        check_angle(self.squareness, "squareness", -MAX_SQUARENESS_RAD, MAX_SQUARENESS_RAD)
        if self.straightness is not None:
            x, error = (frozen(values, "straightness") for values in self.straightness)
            if x.size < 2 or x.shape != error.shape or not (np.diff(x) > 0).all():
                raise InputError(
                    f"straightness has {x.size} positions and {error.size} errors, it needs equal numbers of both, at "
                    "least 2, positions ascending: sort and complete it"
                )
            object.__setattr__(self, "straightness", (x, error))

    @classmethod
    def load(cls, name: str | Path) -> Machine:
        """Return a machine that comes with Turnwright, or one described in a file of the same form.

        Parameters
        ----------
        name
            "nanotech-350fg", "nanoform", "nanoform-fts-70", "nanoform-fts-500", "generic", or the path of a ``.toml``
            file. A file with ``base = NAME`` extends another machine and overrides its values.

        Raises
        ------
        InputError
            If there is no such machine, or its file is wrong; the message names the key.
        """
        table, what = _read(name, ()), f"machine file {str(name)!r}"
        machine = read_table(cls, table, what)
        values = flat({key: value for key, value in table.items() if key != "sources"})
        for key in machine.sources:
            if key not in values:
                raise InputError(f"{what}: sources has {key!r}, a key that the file lacks: correct or remove it")
        return replace(machine, loaded=Loaded(str(name), machine))

    def interpolating(self, interpolation: str) -> Machine:
        """Return the machine with another interpolation of its controller selected.

        Its programs are then in the dialect that selects this interpolation.

        Raises
        ------
        InputError
            If the controller does not offer it.

        >>> machine = Machine.load("nanoform")
        >>> both = replace(machine, controller=Controller(other_interpolations={"hermite": "pmac"}))
        >>> machine.dialect, both.interpolating("hermite").dialect
        ('generic', 'pmac')
        """
        current, others = self.controller.interpolation, dict(self.controller.other_interpolations)
        if interpolation == current:
            return self
        if interpolation not in others:
            raise InputError(
                f"interpolation is {interpolation!r}, the controller of {self.name} offers "
                f"{', '.join((current, *others))}: choose one of these, or add it to the machine file"
            )
        dialect = others.pop(interpolation)
        controller = replace(
            self.controller, interpolation=interpolation, other_interpolations={current: self.dialect, **others}
        )
        return replace(self, controller=controller, dialect=dialect)

    def in_spindle_mode(self) -> Machine:
        """Return the machine with the limits that hold in spindle mode, in which C is no axis.

        Raises
        ------
        LimitError
            If no highest speed in spindle mode is stated.
        """
        if self.spindle_mode_rpm is None:
            raise LimitError(
                f"the cut is in spindle mode, the machine file of {self.name} states no spindle_mode_rpm: state the "
                "highest speed of its spindle, or cut with C as an axis"
            )
        return replace(self, spindle_rpm=self.spindle_mode_rpm, axes={**self.axes, "C": Axis()})

    def z_error(self, x: ArrayLike) -> Floats:
        """Return the height error of the tip at positions of X: actual minus nominal. (n,) [mm]."""
        x = np.asarray(x, dtype=np.float64)
        error = self.squareness * x
        if self.straightness is not None:
            error = error + np.interp(x, *self.straightness)
        return error

    def z_error_slope(self, x: ArrayLike) -> Floats:
        """Return the derivative of `z_error` by X; at a corner, that toward +X. (n,) [1]."""
        x = np.asarray(x, dtype=np.float64)
        slope = np.full(x.shape, self.squareness)
        if self.straightness is not None:
            at, error = self.straightness
            steep = np.concatenate(([0.0], np.diff(error) / np.diff(at), [0.0]))
            slope += steep[np.searchsorted(at, x, side="right")]
        return slope


def _read(name: str | Path, above: tuple[str | Path, ...]) -> dict[str, Any]:
    """Return the tables of a machine file merged over those of its base; file names are relative to its folder."""
    shipped = resources.files("turnwright") / "machines"
    names = sorted(Path(entry.name).stem for entry in shipped.iterdir() if entry.name.endswith(".toml"))
    if name in names:
        data, folder = (shipped / f"{name}.toml").read_bytes(), Path()
    else:
        remedy = f"name one of {', '.join(names)}, or give the path of a .toml file"
        data, folder = bytes_of(Path(name), "machine file", remedy), Path(name).parent
    table = read_toml(data, f"machine file {str(name)!r}")
    axes = table.get("axes")
    for axis in axes.values() if isinstance(axes, dict) else ():
        response = axis.get("response") if isinstance(axis, dict) else None
        if isinstance(response, dict) and isinstance(response.get("file"), str):
            response["file"] = str(folder / response["file"])
    _place_dialects(table, folder)
    base = table.get("base")
    if base is None:
        return table
    if not isinstance(base, str) or not base:
        raise InputError(f"machine file {str(name)!r}: base is {quote(base)}, it must be a name or a file: correct it")
    if len(above) == MAX_BASES:
        raise InputError(
            f"machine file {str(name)!r}: base leads to a chain of more than {MAX_BASES} files, or to a circle: remove "
            "base from one of them"
        )
    del table["base"]
    return _merge(_read(base if base in names else folder / base, (*above, name)), table)


def _place_dialects(table: dict[str, Any], folder: Path) -> None:
    """Make the names of dialect files relative to the folder of the machine file."""
    controller = table.get("controller")
    others = controller.get("other_interpolations") if isinstance(controller, dict) else None
    if isinstance(others, dict):
        others |= {key: _resolve_dialect(name, folder) for key, name in others.items()}
    if "dialect" in table:
        table["dialect"] = _resolve_dialect(table["dialect"], folder)


def _resolve_dialect(name: Any, folder: Path) -> Any:
    """Return the name of a dialect unchanged, or the path of its file."""
    return str(folder / name) if isinstance(name, str) and name.endswith(".toml") else name


def _merge(base: dict[str, Any], table: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in table.items():
        below = base.get(key)
        merged[key] = _merge(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged
