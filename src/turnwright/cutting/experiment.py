"""A cutting experiment as its files describe it: from what was recorded to a material.

Either a CSV of averaged cuts, a line each; or a TOML file that names the records and says what was cut in each, see the
page on learning from forces.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright import units
from turnwright._arrays import Floats
from turnwright._toml import read_toml
from turnwright.cutting.dynamometer import Dynamometer, TapTest
from turnwright.cutting.learning import Cuts, LearnedMaterial, learn_material, measured_cuts
from turnwright.cutting.records import NEWTONS, read_forces
from turnwright.cutting.signals import ForceRecord, engagements, in_air, low_pass, remove_drift
from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Experiment", "learn_from_file"]

GONE = object()

LENGTHS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}

COLUMNS = ("thickness", "width", "cutting", "thrust")
"""What a CSV of averaged cuts has; each with its unit, such as ``thickness [nm]``."""

UNCERTAINTIES = ("cutting uncertainty", "thrust uncertainty")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Experiment:
    """What was learned, and from what.

    Parameters
    ----------
    name
        Of the material.
    source
        Where the forces come from.
    learned
        The coefficients and the critical thickness.
    cuts
        The rows that they were learned from.
    rake
        Of the tool that cut. [rad]
    """

    name: str
    source: str
    learned: LearnedMaterial
    cuts: Cuts
    rake: float = 0.0

    def table(self) -> dict[str, Any]:
        """Return the material as the tables of a file that `Material.load` reads."""
        found = self.learned
        at = f"; the tool's rake was {np.rad2deg(self.rake):g} deg" if self.rake else ""
        interval = f"{found.confidence:.0%} interval"
        table: dict[str, Any] = {
            "name": self.name,
            "brittle_plateau": found.critical is not None,
            "notes": ". ".join(f"{one[0].upper()}{one[1:]}" for one in found.sentences) + f"{at}.",
        }
        sources: dict[str, Any] = {}
        for key, one, sigma in zip(
            ("cutting", "thrust"), (found.cutting, found.thrust), found.uncertainty, strict=True
        ):
            if not one.value > 0:
                raise InputError(
                    f"the {key} coefficient comes out as {one.value:.4g} N/mm^2, it must be above 0: check the signs "
                    "of both channels"
                )
            table[key] = {"n_per_mm2": _rounded(one.value), "uncertainty_n_per_mm2": _rounded(sigma)}
            sources[key] = {
                "value": f"{self.source}: {interval} {one.low:.5g} to {one.high:.5g} N/mm2{at}",
                "uncertainty": f"{self.source}: standard uncertainty",
            }
        if found.exponents is not None and found.reference_thickness is not None:
            for key, one in zip(("cutting", "thrust"), found.exponents, strict=True):
                table[key]["exponent"] = _rounded(one.value)
                table[key]["reference_thickness"] = f"{_rounded(found.reference_thickness * 1e6)} nm"
                sources[key]["exponent"] = f"{self.source}: {interval} {one.low:.4g} to {one.high:.4g}{at}"
        if found.critical is not None:
            low, high = found.critical.low * 1e6, found.critical.high * 1e6
            table["critical"] = {
                "value": f"{_rounded(found.critical.value * 1e6)} nm",
                "uncertainty": f"{_rounded((high - low) / 4)} nm",
            }
            sources["critical"] = {
                "value": f"{self.source}: {interval} {low:.5g} to {high:.5g} nm{at}",
                "uncertainty": f"{self.source}: a quarter of the interval",
            }
            sources["brittle_plateau"] = "assumed: on the safe side, since the forces measured beyond are lower"
        return {**table, "sources": sources}


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def learn_from_file(file: str | Path) -> Experiment:
    """Learn a material from the file of an experiment.

    Parameters
    ----------
    file
        TOML, or CSV of averaged cuts.

    Raises
    ------
    InputError
        If a file cannot be read or the experiment is too small; the message says where.
    """
    path = Path(file)
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is no name of a file"
        raise InputError(f"the experiment {str(file)!r} cannot be read ({why}): check its name") from error
    if path.suffix.lower() == ".toml":
        table = read_toml(data, f"the experiment {str(file)!r}")
    else:
        table = {"name": path.stem, "source": path.name, "averages": {"file": path.name}}
    try:
        return _learned(_Keys(table, "the experiment"), path.parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


class _Keys:
    """A table of a file whose keys are asked for one by one; what nobody asks for is an error."""

    def __init__(self, table: Mapping[str, Any], where: str) -> None:
        self.table, self.where, self.asked = table, where, set[str]()

    def raw(self, key: str, default: Any = GONE) -> Any:
        self.asked.add(key)
        if key in self.table:
            return self.table[key]
        if default is GONE:
            raise InputError(f"{self.where} lacks {key}: add it")
        return default

    def text(self, key: str, default: Any = GONE) -> Any:
        value = self.raw(key, default)
        if value is not default and (not isinstance(value, str) or not value):
            raise InputError(f"{self.where} has {key} = {value!r}, it must be a text: put it in quotes")
        return value

    def number(self, key: str, default: Any = GONE) -> Any:
        value = self.raw(key, default)
        if value is not default and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise InputError(f"{self.where} has {key} = {value!r}, it must be a plain number: write one")
        return value

    def flag(self, key: str) -> bool:
        value = self.raw(key, False)
        if not isinstance(value, bool):
            raise InputError(f"{self.where} has {key} = {value!r}, it must be true or false: change it")
        return value

    def quantity(self, key: str, unit: str, default: Any = GONE) -> Any:
        value = self.raw(key, default)
        return value if value is default else self._read(key, value, unit)

    def quantities(self, key: str, unit: str) -> list[float]:
        value = self.raw(key)
        if not isinstance(value, list):
            raise InputError(f"{self.where} has {key} = {value!r}, it must be a list of quantities: write [ ]")
        return [self._read(key, one, unit) for one in value]

    def tables(self, key: str) -> list[_Keys]:
        value = self.raw(key, [])
        if not isinstance(value, list) or not all(isinstance(one, dict) for one in value):
            raise InputError(f"{self.where} has {key} that is no list of tables: write [[{key}]] above each")
        return [_Keys(one, f"{key} number {i + 1}") for i, one in enumerate(value)]

    def part(self, key: str) -> _Keys | None:
        value = self.raw(key, None)
        if value is not None and not isinstance(value, dict):
            raise InputError(f"{self.where} has {key} = {value!r}, it must be a table: write [{key}]")
        return None if value is None else _Keys(value, key)

    def done(self) -> None:
        for key in self.table:
            if key not in self.asked:
                raise InputError(
                    f"{key!r} in {self.where} is not known, the keys are {', '.join(sorted(self.asked))}: correct it"
                )

    def _read(self, key: str, value: object, unit: str) -> float:
        try:
            return units.parse(value, unit)
        except InputError as error:
            raise InputError(f"{self.where}, {key}: {error}") from error


def _learned(keys: _Keys, folder: Path) -> Experiment:
    """Learn from the tables of an experiment."""
    name, source = keys.text("name"), keys.text("source")
    rake = keys.quantity("rake", "rad", 0.0)
    confidence = keys.number("confidence", 0.95)
    edge, falls = keys.flag("edge_force"), keys.flag("size_effect")
    common = float(keys.number("width_uncertainty", 0.0))
    averages, cuts = keys.part("averages"), keys.tables("cuts")
    record, dynamometer = keys.part("record"), keys.part("dynamometer")
    thickness = keys.quantity("thickness_uncertainty", "mm", 0.0)
    keys.done()
    if (averages is None) == (not cuts):
        raise InputError("the experiment has neither averages nor cuts, or both: give [averages] or [[cuts]]")
    drift: int | None = None
    calibration = (common, common)
    if averages is not None:
        rows = _averages(folder / averages.text("file"))
        averages.done()
    else:
        if record is None:
            raise InputError("the experiment lacks record: say in [record] which channel is which")
        rows, drift, calibration = _recorded(_Record(record), dynamometer, cuts, folder, common)
    learned = learn_material(
        rows,
        drift=drift,
        edge_force=edge,
        size_effect=falls,
        calibration=calibration,
        thickness_uncertainty=thickness,
        confidence=confidence,
    )
    return Experiment(name=name, source=source, learned=learned, cuts=rows, rake=rake)


class _Record:
    """How the records are to be read and cleaned."""

    def __init__(self, keys: _Keys) -> None:
        self.cutting, self.thrust = keys.text("cutting"), keys.text("thrust")
        self.channels = keys.raw("channels", [one.removeprefix("-") for one in (self.cutting, self.thrust)])
        if not isinstance(self.channels, list) or not all(isinstance(one, str) for one in self.channels):
            raise InputError(f"record has channels = {self.channels!r}, it must be a list of names: write [ ]")
        self.unit = keys.text("unit", None)
        self.rate = keys.quantity("rate", "Hz", None)
        self.drift = keys.raw("drift")
        self.shortest, self.lead = keys.quantity("shortest", "s"), keys.quantity("lead", "s", 0.0)
        self.block, self.guard = keys.quantity("block", "s"), keys.quantity("guard", "s")
        smooth = keys.part("low_pass")
        self.smooth = None if smooth is None else (smooth.quantity("cutoff", "Hz"), smooth.raw("order"))
        if smooth is not None:
            smooth.done()
        keys.done()

    def read(self, path: Path) -> ForceRecord:
        return read_forces(path, channels=self.channels, unit=self.unit, rate_hz=self.rate)


def _recorded(
    how: _Record, dynamometer: _Keys | None, cuts: Sequence[_Keys], folder: Path, common: float
) -> tuple[Cuts, int, tuple[float, float]]:
    """Return the rows of all records, the degree of their drift, and what is common to all forces."""
    sensor, bandwidth, noise = _sensor(dynamometer, how, folder)
    parts, steady = [], np.zeros(len(how.channels))
    for one in cuts:
        record = how.read(folder / one.text("file"))
        width = one.quantity("width", "mm")
        if sensor is not None:
            record = sensor.forces(record, bandwidth_hz=bandwidth, noise_to_signal=noise)
        if how.smooth is not None:
            record = low_pass(record, *how.smooth)
        found = engagements(record, how.cutting, shortest=how.shortest, drift=how.drift, lead=how.lead)
        parts.append(
            measured_cuts(
                record,
                found,
                cutting=how.cutting,
                thrust=how.thrust,
                thickness=_thickness(one, found / record.rate_hz),
                width=width,
                block=how.block,
                guard=how.guard,
            )
        )
        one.done()
        air = in_air(record.samples, found)
        steady += remove_drift(record, air, degree=how.drift).force[~air].mean(axis=0)
    rows = Cuts(
        **{
            key: np.concatenate([getattr(part, key) for part in parts])
            for key in ("thickness", "width", "cutting", "thrust", "time", "spread")
        },
        record=np.repeat(np.arange(len(parts), dtype=np.float64), [part.thickness.size for part in parts]),
    )
    calibration = (common, common)
    if sensor is not None:
        share = sensor.relative_uncertainty(steady)
        both = [
            float(np.hypot(share[how.channels.index(channel.removeprefix("-"))], common))
            for channel in (how.cutting, how.thrust)
        ]
        calibration = (both[0], both[1])
    return rows, how.drift, calibration


def _thickness(keys: _Keys, spans: Floats) -> Callable[[Floats], Floats]:
    """Return the thickness over time: one for all, a ramp from first entry to last exit, or one for each cut."""
    given = [key for key in ("thickness", "ramp", "steps") if key in keys.table]
    if len(given) != 1:
        raise InputError(f"{keys.where} has {', '.join(given) or 'no thickness'}: give one of thickness, ramp, steps")
    if given[0] == "thickness":
        steady = float(keys.quantity("thickness", "mm"))
        return lambda at: np.full(at.shape, steady)
    values = keys.quantities(given[0], "mm")
    if given[0] == "ramp":
        if len(values) != 2:
            raise InputError(f"{keys.where} has a ramp of {len(values)} thicknesses, it needs 2: give first and last")
        ends = keys.quantities("times", "s") if "times" in keys.table else [spans[0, 0], spans[-1, 1]]
        if len(ends) != 2 or not ends[0] < ends[1]:
            raise InputError(f"{keys.where} has times {ends}, a ramp needs 2 that ascend: give begin and end")
        return lambda at: np.interp(at, ends, values)
    if len(values) != len(spans):
        raise InputError(
            f"{keys.where} has {len(values)} steps, and {len(spans)} cuts are found in its record: give one for each "
            "cut, or another value of shortest"
        )
    return lambda at: np.asarray(values)[np.clip(np.searchsorted(spans[:, 0], at, side="right") - 1, 0, None)]


def _sensor(keys: _Keys | None, how: _Record, folder: Path) -> tuple[Dynamometer | None, float, float]:
    """Return the dynamometer with its bandwidth and share of noise, if tap tests are given."""
    if keys is None:
        return None, 0.0, 0.0
    bandwidth, noise = keys.quantity("bandwidth", "Hz"), float(keys.number("noise_to_signal"))
    hammer, unit, flat = keys.text("hammer"), keys.text("unit", how.unit), keys.quantity("flat", "Hz", None)
    if len(how.channels) != 3:
        raise InputError(f"record has {len(how.channels)} channels, with a dynamometer it needs 3: name all three")
    taps = []
    for one in keys.tables("taps"):
        said = read_forces(
            folder / one.text("file"),
            channels=[hammer, *how.channels],
            unit=unit,
            rate_hz=keys.quantity("rate", "Hz", how.rate),
        )
        direction = one.raw("direction")
        taps.append(
            TapTest(hammer=said.force[:, 0], response=said.force[:, 1:], direction=direction, rate_hz=said.rate_hz)
        )
        one.done()
    keys.done()
    return Dynamometer.from_taps(taps, flat_hz=flat), bandwidth, noise


def _averages(path: Path) -> Cuts:
    """Read a CSV of averaged cuts, a line each."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): check its name") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is no text: give a CSV of averaged cuts, or a TOML file of an experiment") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    heads = [one.strip() for one in (lines[0] if lines else "").split(",")]
    found: dict[str, tuple[int, float]] = {}
    for i, head in enumerate(heads):
        match = re.fullmatch(r"(.+?)\s*[\[(]\s*(\S+)\s*[\])]", head)
        known = (*COLUMNS, *UNCERTAINTIES)
        if match is None or match.group(1) not in known:
            raise InputError(
                f"{path} has a column {head!r}, the known ones are {', '.join(known)}, each with its unit such as "
                "'thickness [nm]': correct the first line"
            )
        name, unit = match.groups()
        sizes = LENGTHS if name in COLUMNS[:2] else NEWTONS
        if unit not in sizes:
            raise InputError(f"{path} has {name} in {unit!r}, the units are {', '.join(sizes)}: convert it")
        found[name] = (i, sizes[unit])
    missing = [name for name in COLUMNS if name not in found]
    if missing or sum(name in found for name in UNCERTAINTIES) == 1:
        lacking = missing or [name for name in UNCERTAINTIES if name not in found]
        raise InputError(f"{path} lacks {', '.join(lacking)}: add it with its unit, such as 'thickness [nm]'")
    try:
        table = np.loadtxt(lines[1:], delimiter=",", ndmin=2, dtype=np.float64, comments=None)
    except ValueError as error:
        why = str(error).splitlines()[0]
        raise InputError(f"{path} is not a table of numbers ({why}): use decimal points and commas between") from error
    if table.shape[0] == 0 or table.shape[1] != len(heads):
        raise InputError(f"{path} has {len(heads)} names and numbers of shape {table.shape}: give as many in each line")
    columns = {name: table[:, i] * factor for name, (i, factor) in found.items()}
    rows = Cuts(**{name: columns[name] for name in COLUMNS})
    if UNCERTAINTIES[0] in columns:
        rows = replace(rows, uncertainty=np.column_stack([columns[name] for name in UNCERTAINTIES]))
    return rows
