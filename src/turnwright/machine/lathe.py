"""The lathe: what its axes can do, how they err, and how its controller counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright import units
from turnwright._arrays import Floats, Value, frozen
from turnwright._io import read_toml
from turnwright._validate import check_angle, check_numbers, key_of, plausible_sizes, positive
from turnwright.errors import InputError
from turnwright.machine.axes import ROTARY, Axis
from turnwright.machine.controller import Controller, Convention
from turnwright.machine.responses import FrequencyResponse, Response, SecondOrder, TransferFunction

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

STEEPEST = 0.1
"""A squareness beyond this is a slip of the unit, not an error of a machine. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Machine(Value):
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
    loaded_from
        Name or file that `load` was given; empty for a machine that was put together.

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

    name: str
    axes: Mapping[str, Axis]
    spindle_rpm: float
    block_rate_hz: float
    dialect: str = "generic"
    convention: Convention = Convention()  # noqa: RUF009 - frozen
    controller: Controller = Controller()  # noqa: RUF009 - frozen
    squareness: float = 0.0
    straightness: tuple[Floats, Floats] | None = None
    plausible: Mapping[str, float] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    loaded_from: str = field(default="", compare=False, repr=False)

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
        table = _read(name, ())
        try:
            return replace(_from_table(table), loaded_from=str(name))
        except InputError as error:
            raise InputError(f"machine file {str(name)!r}: {error}") from error

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
        try:
            data, beside = Path(name).read_bytes(), Path(name).parent
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or "it is no name of a file"
            raise InputError(
                f"machine {str(name)!r} is not one of {', '.join(known)} and cannot be read as a file ({why}): "
                "name one of these, or give the path of a .toml file"
            ) from error
    table = read_toml(data, f"machine file {str(name)!r}")
    try:
        for axis in _table(table, "axes").values() if "axes" in table else ():
            response = axis.get("response") if isinstance(axis, dict) else None
            if isinstance(response, dict) and "file" in response:
                response["file"] = str(beside / _text(response, "file"))
        base = _text(table, "base") if "base" in table else None
    except InputError as error:
        raise InputError(f"machine file {str(name)!r}: {error}") from error
    if base is None:
        return table
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


def _from_table(table: Mapping[str, Any]) -> Machine:
    """Build a machine from its tables."""
    _check_keys(table, {item.name for item in fields(Machine)} - {"loaded_from"}, "the file")
    for needed in ("name", "axes", "spindle_rpm", "block_rate_hz"):
        if needed not in table:
            raise InputError(f"{needed} is missing: add it")
    given: dict[str, Any] = {"name": _text(table, "name"), "dialect": _text(table, "dialect", "generic")}
    for key in ("spindle_rpm", "block_rate_hz"):
        if isinstance(table[key], bool) or not isinstance(table[key], int | float):
            raise InputError(f"{key} is {table[key]!r}, its unit is in its name: give a plain number")
        given[key] = table[key]
    given["axes"] = {letter: _axis(letter, limits) for letter, limits in _table(table, "axes").items()}
    if "convention" in table:
        given["convention"] = _convention(_table(table, "convention"))
    if "controller" in table:
        controller = _table(table, "controller")
        _check_keys(controller, {item.name for item in fields(Controller)}, "controller")
        given["controller"] = Controller(**controller)
    if "squareness" in table:
        given["squareness"] = _quantity(table["squareness"], "rad", "squareness")
    if "straightness" in table:
        straightness = _table(table, "straightness")
        _check_keys(straightness, {"x_mm", "error_nm"}, "straightness")
        x, error = (frozen(straightness.get(key, []), f"straightness.{key}") for key in ("x_mm", "error_nm"))
        given["straightness"] = (x, error * 1e-6)
    if "plausible" in table:
        given["plausible"] = _plausible(_table(table, "plausible"))
    sources = _flat(_table(table, "sources")) if "sources" in table else {}
    facts = _flat({key: value for key, value in table.items() if key != "sources"})
    _check_keys(sources, set(facts), "sources")
    return Machine(**given, sources=sources)


def _convention(table: dict[str, Any]) -> Convention:
    _check_keys(table, {item.name for item in fields(Convention)}, "convention")
    if "clocking" in table:
        table = {**table, "clocking": _quantity(table["clocking"], "rad", "convention.clocking")}
    return Convention(**table)


def _plausible(table: Mapping[str, Any]) -> dict[str, float]:
    """Return plausible sizes of errors by their names."""
    name_of = {key_of(name): name for name in PLAUSIBLE}
    _check_keys(table, set(name_of), "plausible")
    return {name_of[key]: _quantity(size, PLAUSIBLE[name_of[key]], f"plausible.{key}") for key, size in table.items()}


def _response(table: Mapping[str, Any]) -> Response:
    """Build a response from its table: a file of measured values, polynomials, or a second order."""
    if "file" in table:
        _check_keys(table, {"file"}, "response")
        return FrequencyResponse.load(_text(table, "file"))
    if "numerator" in table or "denominator" in table:
        _check_keys(table, {"numerator", "denominator"}, "response")
        both = {key: frozen(table.get(key, []), f"response.{key}") for key in ("numerator", "denominator")}
        return TransferFunction(**both)
    _check_keys(table, {"frequency", "damping", "velocity_feedforward", "acceleration_feedforward"}, "response")
    for needed in ("frequency", "damping"):
        if needed not in table:
            raise InputError(f"response.{needed} is missing: add it, or give a file, or numerator and denominator")
    plain = {key: value for key, value in table.items() if key != "frequency"}
    for key, value in plain.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"response.{key} is {value!r}, it has no unit: give a plain number")
    return SecondOrder(frequency_hz=_quantity(table["frequency"], "Hz", "response.frequency"), **plain)


def _axis(letter: str, limits: object) -> Axis:
    """Build an axis from its table; sliding axes count in mm, turning ones in rad."""
    if len(letter) != 1 or not letter.isupper():
        raise InputError(f"axes.{letter} is not an axis: name it with one capital letter")
    if not isinstance(limits, dict):
        raise InputError(f"axes.{letter} is {limits!r}, it must be a table of limits: write [axes.{letter}]")
    length = "rad" if letter in ROTARY else "mm"
    own = {
        "speed": f"{length}/s",
        "acceleration": f"{length}/s^2",
        "jerk": f"{length}/s^3",
        "low": length,
        "high": length,
        "bandwidth_residual": length,
        "dead_time": "s",
    }
    _check_keys(limits, {*own, "bandwidth", "response"}, f"axes.{letter}")
    try:
        plain = {key: _quantity(value, own[key], key) for key, value in limits.items() if key in own}
        band = _quantity(limits["bandwidth"], "Hz", "bandwidth") if "bandwidth" in limits else None
        response = _response(_table(limits, "response")) if "response" in limits else None
        return Axis(**plain, bandwidth_hz=band, response=response)
    except InputError as error:
        raise InputError(f"axes.{letter}: {error}") from error


def _quantity(value: object, unit: str, where: str) -> float:
    try:
        return units.parse(value, unit)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _text(table: Mapping[str, Any], key: str, default: str = "") -> str:
    value = table.get(key, default)
    if not isinstance(value, str) or not value:
        raise InputError(f"{key} is {value!r}, it must be a text: put it in quotes")
    return value


def _table(table: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = table[key]
    if not isinstance(value, dict):
        raise InputError(f"{key} is {value!r}, it must be a table: write [{key}]")
    return value


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested table with dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _check_keys(table: Mapping[str, Any], known: set[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(
                f"{key!r} in {where} is not known, the keys are {', '.join(sorted(known))}: correct or drop it"
            )
