"""The lathe: what its axes can do, how they err, and how its controller counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np

from turnwright._arrays import Floats, Value, frozen
from turnwright._faults import read_table
from turnwright._io import bytes_of, read_toml
from turnwright._tables import Columns, Loaded, Plausible, Sources, Stated, flat
from turnwright._validate import check_angle, check_numbers, plausible_sizes, positive
from turnwright.errors import InputError, shown
from turnwright.machine.axes import Axes, Axis
from turnwright.machine.controller import Controller, Convention
from turnwright.units import Number, Slope, Text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Machine"]

MOST_BASES = 8
"""Machine files that may build on each other."""

PLAUSIBLE = MappingProxyType(
    {"squareness": "rad", "straightness": "mm", "servo lag": "rad", "drift of X": "mm", "drift of Z": "mm"}
)
"""Errors whose plausible size a machine may state, and their units."""

PLAUSIBLE_TEXTS = MappingProxyType({
    "squareness": "Of the X slide to the spindle.",
    "straightness": "Of the X slide.",
    "servo lag": "Angle by which Z comes late.",
    "drift of X": "Over the time of a cut; as large as the maps allow if left out.",
    "drift of Z": "Over the time of a cut; as large as the maps allow if left out.",
})  # fmt: skip

ErrorSizes: TypeAlias = Annotated[Mapping[str, float], Plausible(PLAUSIBLE, PLAUSIBLE_TEXTS, slopes=("squareness",))]

STEEPEST = 0.1
"""A squareness beyond this is a slip of the unit, not an error of a machine. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Machine(Stated, Value):
    """A lathe with a C axis.

    Parameters
    ----------
    name
        What the machine is called.
    axes
        `Axis` by letter, at least "C", "X" and "Z".
    spindle_rpm
        Highest speed of the spindle as a C axis. [rev/min]
    block_rate_hz
        Program blocks that the controller can take in a second, coordinated over all axes.
    dialect
        Name of the program dialect.
    convention
        How the controller counts.
    controller
        What it makes of the points.
    squareness
        Height error of the tip per distance along X: Z error = squareness * X. [rad]
    straightness
        Height error of the tip along X beyond squareness: ascending positions and errors, linear in between, held
        beyond. ((n,), (n,)) [mm]
    plausible
        How large its errors plausibly are, one standard deviation, where they are not as `CAUSES` of the diagnosis
        says: "squareness" [rad], "straightness" [mm], "servo lag" [rad]; and "drift of X", "drift of Z" over the time
        of a cut [mm], else as large as the maps allow.
    sources
        Where each fact comes from, by field ("axes.X.speed"); anything assumed says so.
    loaded
        What `load` was given, and what that states; ``None`` for a machine that was put together.

    Raises
    ------
    InputError
        If an axis is missing, a limit is not positive, or an error of the geometry cannot be one.

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
        object.__setattr__(self, "block_rate_hz", positive(self.block_rate_hz, "block_rate_hz", "blocks/s"))
        check_angle(self.squareness, "squareness", -STEEPEST, STEEPEST)
        if self.straightness is not None:
            if len(self.straightness) != 2:
                raise InputError(
                    f"straightness has {len(self.straightness)} parts, it needs 2: give positions and errors"
                )
            x, error = (
                frozen(self.straightness[0], "straightness x"),
                frozen(self.straightness[1], "straightness error"),
            )
            if x.size < 2 or x.shape != error.shape or not (np.diff(x) > 0).all():
                raise InputError(
                    f"straightness has {x.size} positions and {error.size} errors, it needs as many of one as of the "
                    "other, at least 2, at ascending positions: sort and complete it"
                )
            object.__setattr__(self, "straightness", (x, error))

    @classmethod
    def load(cls, name: str | Path) -> Machine:
        """Return a machine that comes with Turnwright, or one described in a file of the same form.

        Parameters
        ----------
        name
            "nanotech-350fg", "nanoform", "nanoform-fts-70", "nanoform-fts-500", "generic", or the path of a ``.toml``
            file. A file that says ``base = NAME`` adds to another machine, or says some of its facts anew.

        Raises
        ------
        InputError
            If there is no such machine, or its file is wrong; the message names the key.
        """
        table, what = _read(name, ()), f"machine file {str(name)!r}"
        found = read_table(cls, table, what)
        facts = flat({key: value for key, value in table.items() if key != "sources"})
        for key in found.sources:
            if key not in facts:
                raise InputError(f"{what}: sources has {key!r}, which the file does not state: correct or drop it")
        return replace(found, loaded=Loaded(str(name), found))

    def interpolating(self, interpolation: str) -> Machine:
        """Return the machine with its controller asked for one of the interpolations that it offers.

        Its programs are then in the dialect that asks for it.

        Raises
        ------
        InputError
            If the controller does not offer it.

        >>> machine = Machine.load("nanoform")
        >>> both = replace(machine, controller=Controller(other_interpolations={"hermite": "pmac"}))
        >>> machine.dialect, both.interpolating("hermite").dialect
        ('generic', 'pmac')
        """
        own, others = self.controller.interpolation, dict(self.controller.other_interpolations)
        if interpolation == own:
            return self
        if interpolation not in others:
            raise InputError(
                f"interpolation is {interpolation!r}, the controller of {self.name} offers "
                f"{', '.join((own, *others))}: choose one of these, or add it to the machine file"
            )
        dialect = others.pop(interpolation)
        controller = replace(
            self.controller, interpolation=interpolation, other_interpolations={own: self.dialect, **others}
        )
        return replace(self, controller=controller, dialect=dialect)

    def z_error(self, x: ArrayLike) -> Floats:
        """Height of the tip where X stands at ``x``, minus what it should be. (n,) [mm]."""
        x = np.asarray(x, dtype=np.float64)
        error = self.squareness * x
        if self.straightness is not None:
            error = error + np.interp(x, *self.straightness)
        return error

    def z_error_slope(self, x: ArrayLike) -> Floats:
        """Return the derivative of `z_error` by X, at a corner that of the line toward +X. (n,) [1]."""
        x = np.asarray(x, dtype=np.float64)
        slope = np.full(x.shape, self.squareness)
        if self.straightness is not None:
            at, error = self.straightness
            steep = np.concatenate(([0.0], np.diff(error) / np.diff(at), [0.0]))
            slope += steep[np.searchsorted(at, x, side="right")]
        return slope


def _read(name: str | Path, above: tuple[str | Path, ...]) -> dict[str, Any]:
    """Return the tables of a machine file over those of its base; files that it names stand in the same folder."""
    folder = resources.files("turnwright") / "machines"
    known = sorted(Path(entry.name).stem for entry in folder.iterdir() if entry.name.endswith(".toml"))
    if name in known:
        data, beside = (folder / f"{name}.toml").read_bytes(), Path()
    else:
        remedy = f"name one of {', '.join(known)}, or give the path of a .toml file"
        data, beside = bytes_of(Path(name), "machine file", remedy), Path(name).parent
    table = read_toml(data, f"machine file {str(name)!r}")
    axes = table.get("axes")
    for axis in axes.values() if isinstance(axes, dict) else ():
        response = axis.get("response") if isinstance(axis, dict) else None
        if isinstance(response, dict) and isinstance(response.get("file"), str):
            response["file"] = str(beside / response["file"])
    base = table.get("base")
    if base is None:
        return table
    if not isinstance(base, str) or not base:
        raise InputError(f"machine file {str(name)!r}: base is {shown(base)}, it must be a name or a file: correct it")
    if len(above) == MOST_BASES:
        raise InputError(
            f"machine file {str(name)!r}: more than {MOST_BASES} files build on each other, or in a ring: let one of "
            "them stand alone"
        )
    del table["base"]
    return _over(_read(base if base in known else beside / base, (*above, name)), table)


def _over(base: dict[str, Any], table: dict[str, Any]) -> dict[str, Any]:
    """Return tables with those of another laid over them."""
    both = dict(base)
    for key, value in table.items():
        below = base.get(key)
        both[key] = _over(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return both
