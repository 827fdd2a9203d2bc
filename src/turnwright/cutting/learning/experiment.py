"""A cutting experiment as its files describe it: from what was recorded to a material.

Either a CSV of averaged cuts, a line each; or a TOML file that names the records and says what was cut in each, see the
page on learning from forces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from turnwright._arrays import Complexes, Floats, Ints
from turnwright._io import bytes_of, read_toml
from turnwright.cutting.forces import FlyCut, SlotMill
from turnwright.cutting.learning.cuts import (
    MILLED,
    OFF_SPEED,
    TURNED,
    Cuts,
    InterruptedCuts,
    NoseCuts,
    interrupted_cuts,
    measured_cuts,
    turning_cuts,
)
from turnwright.cutting.learning.dynamometer import CLOSES, Dynamometer, TapTest
from turnwright.cutting.learning.learned import LearnedMaterial
from turnwright.cutting.learning.material_fit import learn_material
from turnwright.cutting.learning.records import NEWTONS, read_forces, read_table
from turnwright.cutting.learning.signals import ForceRecord, engagements, in_air, low_pass, remove_drift
from turnwright.errors import InputError, shown
from turnwright.units import Angle, Feed, Frequency, Length, Size, Speed, Time

if TYPE_CHECKING:
    from turnwright.cutting.learning.cuts import Passband

__all__ = ["Experiment", "learn_from_file"]

LEAST_TURNS = 8
"""Turns of a cutter that a pass must last to be found by the force; `engagements` looks at eighths of that."""

RAKES_DIFFER = np.deg2rad(0.5)
"""Rakes that are further apart are those of two experiments. [rad]"""

LENGTHS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}

COLUMNS = ("thickness", "width", "cutting", "thrust")
"""What a CSV of averaged cuts has; each with its unit, such as ``thickness [nm]``."""

UNCERTAINTIES = ("cutting uncertainty", "thrust uncertainty")

NOSE_COLUMNS = {"nose radius": "nose_radius", "depth": "depth", "feed": "feed"}
NOSE_FORCES = {"axial force": "axial", "feed force": "feed_force", "cutting force": "cutting"}
"""What a CSV of averaged cuts with a round nose has; each with its unit, and forces as far as they were measured."""

CHANNELS = {
    "orthogonal": ("cutting", "thrust"),
    "round nose": ("cutting", "axial", "feed"),
    "slot": ("x", "y", "z"),
    "fly-cut": ("y", "z", "x"),
}
"""Kinds of experiments and their components of the force; the first that is measured tells when the tool cuts."""


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
    cuts: Cuts | NoseCuts | InterruptedCuts
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
            if one is None or sigma is None:
                raise InputError(
                    f"the measured forces do not tell the {key} coefficient, a material has both: measure "
                    + ("the cutting force too" if key == "cutting" else "the axial force or that against the feed too")
                )
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
                assert one is not None  # noqa: S101 - both are told, or the above has raised
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
            sources["brittle_plateau"] = "assumed: forces stay what they are just beyond the critical thickness"
        if found.remaining is not None:
            table["brittle_force"] = [_rounded(min(max(one, 0.0), 1.0)) for one in found.remaining]
            sources["brittle_force"] = f"{self.source}: forces just beyond the critical thickness, those before it 1"
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
    data = bytes_of(path, "the experiment")
    if path.suffix.lower() == ".toml":
        table = read_toml(data, f"the experiment {str(file)!r}")
    else:
        table = {"name": path.stem, "source": path.name, "averages": {"file": path.name}}
        if b"nose radius" in data.split(b"\n", 1)[0]:
            table["kind"] = "round nose"
    try:
        return _learned(_Stated.read(table, "the experiment"), path.parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


Text = Annotated[str, Field(min_length=1)]


class _Table(BaseModel):
    """A table of the file; a key that it has not is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @classmethod
    def read(cls, table: Mapping[str, Any], where: str) -> Self:
        """Return the table, or say in a sentence what is wrong with it."""
        try:
            return cls.model_validate(table)
        except ValidationError as error:
            found = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
            key, *number = (f"number {one + 1}" if isinstance(one, int) else one for one in found["loc"])
            name, reason = " ".join((key, *number)), found["msg"].removeprefix("Value error, ")
            said = f"{where} has {name} = {shown(found['input'])}, {reason[:1].lower()}{reason[1:]}: correct it"
            if found["type"] == "value_error":
                said = f"{where}, {name}: {reason}"
            elif found["type"] == "missing":
                said = f"{where} lacks {name}: add it"
            elif found["type"] == "extra_forbidden":
                said = f"{name!r} in {where} is not known, the keys are {', '.join(cls.model_fields)}: correct it"
            raise InputError(said) from error


class _Stated(_Table):
    name: Text
    source: Text
    kind: str = "orthogonal"
    rake: Angle = 0.0
    inclination: Angle = 0.0
    confidence: float = 0.95
    edge_force: bool = False
    size_effect: bool = False
    width_uncertainty: float = 0.0
    area_uncertainty: float = 0.0
    thickness_uncertainty: Length = 0.0
    averages: dict[str, Any] | None = None
    cuts: list[dict[str, Any]] = []
    record: dict[str, Any] | None = None
    dynamometer: dict[str, Any] | None = None


class _LowPass(_Table):
    cutoff: Frequency
    order: int


class _File(_Table):
    file: Text


class _Cut(_File):
    rake: Angle | None = None


class _Straight(_Cut):
    width: Length
    thickness: Length | None = None
    ramp: list[Length] | None = None
    steps: list[Length] | None = None
    times: list[Time] | None = None


class _Turned(_Cut):
    nose_radius: Size
    depth: Size | None = None
    depths: list[Size] | None = None
    feed: Feed | None = None
    feeds: list[Feed] | None = None


class _Pass(_Cut):
    spindle: Speed
    times: list[Time] | None = None


class _Slot(_Pass):
    radius: Length
    feed_per_tooth: Length
    depth: Length
    teeth: int
    corner_radius: Length = 0.0
    entry: Angle = 0.0
    exit: Angle = np.pi


class _FlyCut(_Pass):
    swing: Length
    nose_radius: Length
    step: Length
    depth: Length
    feed: Feed


KINDS: dict[str, type[_Cut]] = {"orthogonal": _Straight, "round nose": _Turned, "slot": _Slot, "fly-cut": _FlyCut}
"""What says what was cut in a record, for each kind of experiment."""


class _Tap(_File):
    direction: list[float]


class _Sensor(_Table):
    hammer: Text
    bandwidth: Frequency
    noise_to_signal: float
    unit: Text | None = None
    rate: Frequency | None = None
    flat: Frequency | None = None
    taps: list[dict[str, Any]]


class _Record(_Table):
    """How the records are to be read and cleaned."""

    cutting: Text | None = None
    thrust: Text | None = None
    axial: Text | None = None
    feed: Text | None = None
    x: Text | None = None
    y: Text | None = None
    z: Text | None = None
    found_by: Text | None = None
    channels: list[str] | None = None
    unit: Text | None = None
    rate: Frequency | None = None
    range_n: float | None = None
    drift: int
    shortest: Time
    lead: Time = 0.0
    whole_turns: bool = False
    block: Time | None = None
    guard: Time
    low_pass: dict[str, Any] | None = None

    def named(self, kind: str) -> dict[str, str]:
        """Return the channels of the components that were measured, the one first by which the tool cuts."""
        every = [one for names in CHANNELS.values() for one in names if getattr(self, one) is not None]
        wrong = [one for one in every if one not in CHANNELS[kind]]
        if wrong or not every or (kind == "orthogonal" and len(every) < len(CHANNELS[kind])):
            raise InputError(
                f"record names {', '.join(dict.fromkeys(every)) or 'no channel'}, it needs "
                f"{'both' if kind == 'orthogonal' else 'at least 1'} of {', '.join(CHANNELS[kind])}: correct it"
            )
        return {one: getattr(self, one) for one in CHANNELS[kind] if one in every}


def _learned(stated: _Stated, folder: Path) -> Experiment:
    """Learn from the tables of an experiment."""
    kind, rake = stated.kind, stated.rake
    if kind not in CHANNELS:
        raise InputError(f"kind is {kind!r}, the known ones are {', '.join(CHANNELS)}: choose one")
    if stated.inclination:
        raise InputError(
            f"the edge is inclined by {np.rad2deg(stated.inclination):g} deg, the limit is 0 deg: an oblique cut also "
            "presses along its edge, for which no coefficient is learned, so set the edge square to the cut"
        )
    right, wrong = ("width", "area") if kind == "orthogonal" else ("area", "width")
    if getattr(stated, f"{wrong}_uncertainty"):
        raise InputError(f"{wrong}_uncertainty is given of the kind {kind!r}, which has {right}_uncertainty: rename it")
    if (stated.averages is None) == (not stated.cuts):
        raise InputError("the experiment has neither averages nor cuts, or both: give [averages] or [[cuts]]")
    drift: int | None = None
    shares: list[float] | None = None
    rows: Cuts | NoseCuts | InterruptedCuts
    if stated.averages is not None:
        file = folder / _File.read(stated.averages, "averages").file
        if kind in ("slot", "fly-cut"):
            raise InputError(
                f"averages were given of the kind {kind!r}, averages can be of orthogonal or round nose: give records"
            )
        if kind == "orthogonal":
            rows = _averages(file)
        else:
            rows, rake = _nose_averages(file, rake)
    elif stated.record is None:
        raise InputError("the experiment lacks record: say in [record] which channel is which")
    else:
        how = _Reading(_Record.read(stated.record, "record"), stated, folder)
        rows, drift, shares = how.rows(), how.record.drift, how.shares()
    learned = learn_material(
        rows,
        drift=drift,
        edge_force=stated.edge_force,
        size_effect=stated.size_effect,
        calibration=shares,
        area_uncertainty=getattr(stated, f"{right}_uncertainty"),
        thickness_uncertainty=stated.thickness_uncertainty,
        confidence=stated.confidence,
    )
    return Experiment(name=stated.name, source=stated.source, learned=learned, cuts=rows, rake=rake)


class _Reading:
    """Reads the records of an experiment, takes the dynamometer's share and fast changes out, and averages them."""

    def __init__(self, record: _Record, stated: _Stated, folder: Path) -> None:
        """Take how the records are to be read, and what was cut in them."""
        self.record, self.stated, self.folder, self.kind = record, stated, folder, stated.kind
        self.turns = self.kind in ("slot", "fly-cut")
        if (record.block is None) != record.whole_turns or (record.whole_turns and not self.turns):
            raise InputError(
                "record lacks block, or has whole_turns beside it or of a kind that does not turn: give one of both"
            )
        self.named = record.named(self.kind)
        self.by = record.found_by or next(iter(self.named.values()))
        self.channels = record.channels or list(
            dict.fromkeys(one.removeprefix("-") for one in (*self.named.values(), self.by))
        )
        smooth = None if record.low_pass is None else _LowPass.read(record.low_pass, "low_pass")
        self.smooth = None if smooth is None else (smooth.cutoff, smooth.order)
        self.sensor: Dynamometer | None = None
        self.filter = {"bandwidth_hz": 0.0, "noise_to_signal": 0.0}
        if stated.dynamometer is not None:
            self._tap(_Sensor.read(stated.dynamometer, "dynamometer"))
        self.steady = np.zeros(len(self.channels))

    def _tap(self, keys: _Sensor) -> None:
        """Learn the responses of the dynamometer from its taps."""
        if len(self.channels) != 3:
            raise InputError(f"record has {len(self.channels)} channels, with a dynamometer it needs 3: name all three")
        taps = []
        for i, table in enumerate(keys.taps):
            one = _Tap.read(table, f"taps number {i + 1}")
            said = read_forces(
                self.folder / one.file,
                channels=[keys.hammer, *self.channels],
                unit=keys.unit or self.record.unit,
                rate_hz=keys.rate or self.record.rate,
            )
            hammer, response = said.force[:, 0], said.force[:, 1:]
            taps.append(
                TapTest(hammer=hammer, response=response, direction=np.array(one.direction), rate_hz=said.rate_hz)
            )
        self.sensor = Dynamometer.from_taps(taps, flat_hz=keys.flat)
        self.filter = {"bandwidth_hz": keys.bandwidth, "noise_to_signal": keys.noise_to_signal}

    def rows(self) -> Cuts | NoseCuts | InterruptedCuts:
        """Return the averages of all records."""
        how = self.record
        parts: list[Cuts | NoseCuts | InterruptedCuts] = []
        for i, table in enumerate(self.stated.cuts):
            where = f"cuts number {i + 1}"
            one = KINDS[self.kind].read(table, where)
            _require_rake(self.stated.rake if one.rake is None else one.rake, self.stated.rake, where)
            record = read_forces(
                self.folder / one.file, channels=self.channels, unit=how.unit, rate_hz=how.rate, range_n=how.range_n
            )
            passed = self._passband(record.rate_hz)
            if self.sensor is not None:
                record = self.sensor.forces(record, **self.filter)
            if self.smooth is not None:
                record = low_pass(record, *self.smooth)
            found = self._found(one, record, where)
            parts.append(self._averaged(one, record, found, passed, where))
            air = in_air(record.samples, found)
            self.steady += remove_drift(record, air, degree=how.drift).force[~air].mean(axis=0)
        return _together(parts)

    def shares(self) -> list[float] | None:
        """Return by what share the dynamometer leaves each component uncertain."""
        if self.sensor is None:
            return None
        of_channel = np.minimum(self.sensor.relative_uncertainty(self.steady), 1.0)
        order = {"round nose": TURNED, "orthogonal": CHANNELS[self.kind]}.get(self.kind, MILLED)
        named = [self.named[key].removeprefix("-") for key in order if key in self.named]
        return [float(of_channel[self.channels.index(one)]) for one in named]

    def _passband(self, rate: float) -> Passband | None:
        """Return what the filters leave of forces at some frequencies, or ``None`` for all."""
        if self.sensor is None and self.smooth is None:
            return None

        def left(frequency: Floats) -> Complexes:
            found = np.tile(np.eye(len(self.channels), dtype=np.complex128), (frequency.size, 1, 1))
            if self.sensor is not None:
                heard = frequency <= CLOSES * self.filter["bandwidth_hz"]
                found[~heard] = 0
                found[heard] = self.sensor.resolution(frequency[heard], **self.filter)
            if self.smooth is not None:
                cutoff, order = self.smooth
                ratio = np.tan(np.pi * np.minimum(frequency / rate, 0.499)) / np.tan(np.pi * cutoff / rate)
                found *= (1 / (1 + ratio ** (2 * order)))[:, None, None]
            return found

        return left

    def _found(self, one: _Cut, record: ForceRecord, where: str) -> Ints:
        """Return first samples of the cuts of a record, and first ones after them. (m, 2)."""
        how = self.record
        if isinstance(one, _Pass):
            if one.times is not None:
                ends = [round(at * record.rate_hz) for at in one.times]
                if len(ends) != 2 or not 0 <= ends[0] < ends[1] <= record.samples:
                    raise InputError(
                        f"{where} has times {one.times}, a pass needs 2 that ascend within the record of "
                        f"{record.samples / record.rate_hz:.4g} s: give begin and end"
                    )
                return np.array([ends], dtype=np.int64)
            turn = 60 / one.spindle
            if how.shortest < LEAST_TURNS * turn * (1 - OFF_SPEED):
                raise InputError(
                    f"shortest is {how.shortest:g} s, a pass is found by means over turns of {turn:.3g} s and the "
                    f"limit is {LEAST_TURNS} of these: raise it, or give the times of {where}"
                )
        return engagements(record, self.by, shortest=how.shortest, drift=how.drift, lead=how.lead)

    def _averaged(
        self, one: _Cut, record: ForceRecord, found: Ints, passed: Passband | None, where: str
    ) -> Cuts | NoseCuts | InterruptedCuts:
        """Return the averages of one record."""
        block, guard = self.record.block, self.record.guard
        if isinstance(one, _Straight) and block is not None:
            return measured_cuts(
                record, found, thickness=_thickness(one, found / record.rate_hz, where), width=one.width,
                block=block, guard=guard, **self.named,
            )  # fmt: skip
        if isinstance(one, _Turned) and block is not None:
            channels = {"feed_force" if key == "feed" else key: channel for key, channel in self.named.items()}
            depth, feed = (_of_each(one, key, len(found), where) for key in ("depth", "feed"))
            return turning_cuts(
                record, found, nose_radius=one.nose_radius, depth=depth, feed=feed, block=block, guard=guard, **channels
            )
        assert isinstance(one, _Pass)  # noqa: S101 - the other kinds have a block
        stated = {key: getattr(one, key) for key in type(one).model_fields if key not in _Pass.model_fields}
        return interrupted_cuts(
            record, found, geometry=(SlotMill if isinstance(one, _Slot) else FlyCut)(**stated),
            spindle_rpm=one.spindle, block=block, guard=guard, passband=passed, **self.named,
        )  # fmt: skip


def _require_rake(mine: float, common: float, where: str) -> None:
    if abs(mine - common) > RAKES_DIFFER:
        raise InputError(
            f"{where} has a rake of {np.rad2deg(mine):g} deg and the experiment one of {np.rad2deg(common):g} deg, "
            "coefficients are learned for one: give each rake an experiment of its own"
        )


def _of_each(one: _Turned, key: str, count: int, where: str) -> list[float]:
    """Return a depth or feed of each cut of a record."""
    each, many = getattr(one, key), getattr(one, f"{key}s")
    if (each is None) == (many is None):
        given = f"{key} and {key}s" if each else f"no {key}"
        raise InputError(f"{where} has {given}: give {key}, or {key}s of its cuts")
    values = [each] * count if many is None else many
    if len(values) != count:
        raise InputError(
            f"{where} has {len(values)} {key}s, and {count} cuts are found in its record: give one for each cut, or "
            "another value of shortest"
        )
    return values


def _together(parts: Sequence[Cuts | NoseCuts | InterruptedCuts]) -> Cuts | NoseCuts | InterruptedCuts:
    """Return the rows of all records as those of one experiment."""

    def joined(keys: Sequence[str]) -> dict[str, Any]:
        return {key: np.concatenate([getattr(part, key) for part in parts]) for key in keys}

    first = parts[0]
    sizes = [(part.thickness if isinstance(part, Cuts) else part.force).shape[0] for part in parts]
    number = np.repeat(np.arange(len(parts)), sizes)
    if isinstance(first, Cuts):
        return Cuts(
            **joined(("thickness", "width", "cutting", "thrust", "time", "spread")), record=number.astype(np.float64)
        )
    if isinstance(first, NoseCuts):
        keys = ("nose_radius", "depth", "feed", "time")
        forces = [key for key in ("axial", "feed_force", "cutting") if getattr(first, key) is not None]
        return NoseCuts(**joined((*keys, *forces)), record=number.astype(np.float64))
    rest = [part for part in parts if isinstance(part, InterruptedCuts)]
    passes = np.cumsum([0, *[int(part.cut.max()) + 1 for part in rest]])
    cut = [np.where(part.cut >= 0, part.cut + begin, -1) for part, begin in zip(rest, passes[:-1], strict=True)]
    if len({part.rate_hz for part in rest}) > 1:
        raise InputError(
            f"the records have {len({part.rate_hz for part in rest})} rates, there must be 1: choose those"
        )
    return replace(
        first,
        **joined(("force", "begin", "end")),
        geometry=tuple(part.geometry[0] for part in rest),
        spindle_rpm=tuple(part.spindle_rpm[0] for part in rest),
        cut=np.concatenate(cut),
        record=number,
    )


def _thickness(one: _Straight, spans: Floats, where: str) -> Callable[[Floats], Floats]:
    """Return the thickness over time: one for all, a ramp from first entry to last exit, or one for each cut."""
    given = [key for key in ("thickness", "ramp", "steps") if getattr(one, key) is not None]
    if len(given) != 1:
        raise InputError(f"{where} has {', '.join(given) or 'no thickness'}: give one of thickness, ramp, steps")
    if one.thickness is not None:
        steady = one.thickness
        return lambda at: np.full(at.shape, steady)
    if one.ramp is not None:
        ramp, ends = one.ramp, one.times or [spans[0, 0], spans[-1, 1]]
        if len(ramp) != 2 or len(ends) != 2 or not ends[0] < ends[1]:
            raise InputError(
                f"{where} has times {ends} and a ramp of {len(ramp)} thicknesses, it needs 2 times that ascend and 2 "
                "thicknesses: give first and last"
            )
        return lambda at: np.interp(at, ends, ramp)
    steps = one.steps or []
    if len(steps) != len(spans):
        raise InputError(
            f"{where} has {len(steps)} steps, and {len(spans)} cuts are found in its record: give one for each cut, or "
            "another value of shortest"
        )
    return lambda at: np.asarray(steps)[np.clip(np.searchsorted(spans[:, 0], at, side="right") - 1, 0, None)]


def _columns(path: Path, known: Mapping[str, Mapping[str, float]], needed: Sequence[str]) -> dict[str, Floats]:
    """Read a CSV of averaged cuts, a line each; every column with its unit, of which the sizes are given."""
    found, units = read_table(path, bytes_of(path, "the table"), "cut")
    for name in found:
        if name not in known or name not in units:
            raise InputError(
                f"{path} has a column {name[:60]!r}, the known ones are {', '.join(known)}, each with its unit such as "
                f"'{needed[0]} [nm]': correct the first line"
            )
        if units[name] not in known[name]:
            listed = ", ".join(known[name])
            raise InputError(f"{path} has {name} in {units[name]!r}, the units are {listed}: convert it")
    missing = [name for name in needed if name not in found]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}: add it with its unit, such as '{needed[0]} [nm]'")
    return {name: column * known[name][units[name]] for name, column in found.items()}


def _averages(path: Path) -> Cuts:
    """Read averages of orthogonal cuts."""
    known = {name: LENGTHS if name in COLUMNS[:2] else NEWTONS for name in (*COLUMNS, *UNCERTAINTIES)}
    columns = _columns(path, known, COLUMNS)
    rows = Cuts(**{name: columns[name] for name in COLUMNS})
    stated = [name for name in UNCERTAINTIES if name in columns]
    if stated:
        rows = replace(rows, uncertainty=_stated(path, columns, UNCERTAINTIES))
    return rows


def _stated(path: Path, columns: Mapping[str, Floats], names: Sequence[str]) -> Floats:
    """Return the uncertainties of all components."""
    missing = [name for name in names if name not in columns]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}: add it with its unit, such as '{missing[0]} [mN]'")
    return np.column_stack([columns[name] for name in names])


def _nose_averages(path: Path, rake: float) -> tuple[NoseCuts, float]:
    """Read averages of cuts with a round nose, and their rake."""
    doubts = [f"{name} uncertainty" for name in NOSE_FORCES]
    known: dict[str, Mapping[str, float]] = dict.fromkeys(NOSE_COLUMNS, LENGTHS)
    known |= dict.fromkeys((*NOSE_FORCES, *doubts), NEWTONS) | {"rake": {"deg": np.pi / 180, "rad": 1.0}}
    columns = _columns(path, known, tuple(NOSE_COLUMNS))
    if "rake" in columns:
        for i, one in enumerate(columns["rake"]):
            _require_rake(float(one), float(columns["rake"][0]), f"{path}, cut {i + 1},")
        rake = float(columns["rake"][0])
    rows = NoseCuts(**{key: columns[name] for name, key in {**NOSE_COLUMNS, **NOSE_FORCES}.items() if name in columns})
    if any(name in columns for name in doubts):
        names = [f"{name} uncertainty" for name in NOSE_FORCES if name in columns]
        rows = replace(rows, uncertainty=_stated(path, columns, names))
    return rows, rake
