"""A cutting experiment as its files describe it: from what was recorded to a material.

Either a CSV of averaged cuts, a line each; or a TOML file that names the records and says what was cut in each, see the
page on learning from forces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np

from turnwright._arrays import Complexes, Floats, Ints
from turnwright._faults import read_table as read_stated
from turnwright._io import bytes_of, read_toml
from turnwright._tables import Stated
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
from turnwright.errors import InputError
from turnwright.units import Angle, Count, Feed, Flag, Frequency, Length, Number, Size, Speed, Text, Time, plain

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
    data, what = bytes_of(path, "the experiment"), f"the experiment {str(file)!r}"
    if path.suffix.lower() == ".toml":
        table = read_toml(data, what)
    else:
        table = {"name": path.stem, "source": path.name, "averages": {"file": path.name}}
        if b"nose radius" in data.split(b"\n", 1)[0]:
            table["kind"] = "round nose"
    plan = read_stated(KINDS.get(str(table.get("kind", "orthogonal")), _Plan), table, what)
    try:
        return _learned(plan, path.parent)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error


Named: TypeAlias = Annotated[str, plain(1)]
"""A text that is not empty."""


@dataclass(frozen=True, kw_only=True)
class _Cut(Stated):
    """A record, and what was cut in it."""

    __slots__ = ()
    file: Named
    rake: Angle | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Straight(_Cut):
    width: Length
    thickness: Length | None = None
    ramp: tuple[Length, Length] | None = None
    steps: tuple[Length, ...] | None = None
    times: tuple[Time, Time] | None = None

    def __post_init__(self) -> None:
        given = [key for key in ("thickness", "ramp", "steps") if getattr(self, key) is not None]
        if len(given) != 1:
            raise InputError(f"it has {', '.join(given) or 'no thickness'}: give one of thickness, ramp, steps")
        if self.ramp is not None and self.times is not None and not self.times[0] < self.times[1]:
            raise InputError(f"times are {list(self.times)} s, those of a ramp ascend: give begin and end")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Turned(_Cut):
    nose_radius: Size
    depth: Size | None = None
    depths: tuple[Size, ...] | None = None
    feed: Feed | None = None
    feeds: tuple[Feed, ...] | None = None

    def __post_init__(self) -> None:
        for key in ("depth", "feed"):
            each = getattr(self, key)
            if (each is None) == (getattr(self, f"{key}s") is None):
                given = f"{key} and {key}s" if each else f"no {key}"
                raise InputError(f"it has {given}: give {key}, or {key}s of its cuts")

    def of_each(self, key: str, count: int) -> Sequence[float]:
        """Return the depth or the feed of each cut of the record."""
        each = getattr(self, key)
        return _of_each(getattr(self, f"{key}s"), f"{key}s", count) if each is None else [each] * count


@dataclass(frozen=True, kw_only=True)
class _Pass(_Cut):
    __slots__ = ()
    spindle: Speed
    times: tuple[Time, Time] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _SlotPass(_Pass, SlotMill):
    teeth: Count


@dataclass(frozen=True, slots=True, kw_only=True)
class _FlyCutPass(_Pass, FlyCut):
    pass


@dataclass(frozen=True, slots=True, kw_only=True)
class _LowPass(Stated):
    cutoff: Frequency
    order: Annotated[int, plain()]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Record(Stated):
    """How the records are to be read and cleaned."""

    found_by: Named | None = None
    channels: tuple[Text, ...] | None = None
    unit: Named | None = None
    rate: Frequency | None = None
    range_n: Number | None = None
    drift: Annotated[int, plain()]
    shortest: Time
    lead: Time = 0.0
    block: Time | None = None
    guard: Time
    low_pass: _LowPass | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _StraightRecord(_Record):
    cutting: Named
    thrust: Named
    block: Time


@dataclass(frozen=True, slots=True, kw_only=True)
class _TurnedRecord(_Record):
    cutting: Named | None = None
    axial: Named | None = None
    feed: Named | None = None
    block: Time


@dataclass(frozen=True, slots=True, kw_only=True)
class _MilledRecord(_Record):
    x: Named | None = None
    y: Named | None = None
    z: Named | None = None
    whole_turns: Flag = False

    def __post_init__(self) -> None:
        if (self.block is None) != self.whole_turns:
            raise InputError("it has neither block nor whole_turns = true, or both: give one of them")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tap(Stated):
    file: Named
    direction: tuple[Number, Number, Number]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sensor(Stated):
    hammer: Named
    bandwidth: Frequency
    noise_to_signal: Number
    unit: Named | None = None
    rate: Frequency | None = None
    flat: Frequency | None = None
    taps: tuple[_Tap, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Averages(Stated):
    file: Named


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan(Stated):
    """What the file of an experiment states; those of its kind say of what sort its record and its cuts are."""

    components: ClassVar[tuple[str, ...]] = ()
    """Of the force; the first that is measured tells when the tool cuts."""

    name: Named
    source: Named
    kind: Literal["orthogonal", "round nose", "slot", "fly-cut"] = "orthogonal"
    rake: Angle = 0.0
    inclination: Angle = 0.0
    confidence: Number = 0.95
    edge_force: Flag = False
    size_effect: Flag = False
    area_uncertainty: Number = 0.0
    thickness_uncertainty: Length = 0.0
    averages: _Averages | None = None
    record: Any = None
    dynamometer: _Sensor | None = None
    cuts: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        if self.inclination:
            raise InputError(
                f"inclination is {np.rad2deg(self.inclination):g} deg, the limit is 0 deg: an oblique cut also presses "
                "along its edge, for which no coefficient is learned, so set the edge square to the cut"
            )
        if (self.averages is None) == (not self.cuts):
            raise InputError("the experiment has neither averages nor cuts, or both: give [averages] or [[cuts]]")
        if self.averages is None and self.record is None:
            raise InputError("the experiment lacks record: say in [record] which channel is which")
        if self.record is not None and not self.named:
            raise InputError(f"record names no channel, it needs at least 1 of {', '.join(self.components)}: name one")
        for i, one in enumerate(self.cuts):
            _require_rake(self.rake if one.rake is None else one.rake, self.rake, f"cuts[{i + 1}]")

    @property
    def named(self) -> dict[str, str]:
        """The channels of the components that were measured."""
        return {one: name for one in self.components if (name := getattr(self.record, one)) is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Orthogonal(_Plan):
    components = ("cutting", "thrust")
    key_names = MappingProxyType({"area_uncertainty": "width_uncertainty"})
    record: _StraightRecord | None = None
    cuts: tuple[_Straight, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _RoundNose(_Plan):
    components = ("cutting", "axial", "feed")
    record: _TurnedRecord | None = None
    cuts: tuple[_Turned, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slot(_Plan):
    components = ("x", "y", "z")
    hidden = ("averages",)
    record: _MilledRecord
    cuts: tuple[_SlotPass, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _FlyCutting(_Plan):
    components = ("y", "z", "x")
    hidden = ("averages",)
    record: _MilledRecord
    cuts: tuple[_FlyCutPass, ...]


KINDS: dict[str, type[_Plan]] = {
    "orthogonal": _Orthogonal, "round nose": _RoundNose, "slot": _Slot, "fly-cut": _FlyCutting,
}  # fmt: skip

COMPONENTS = (*TURNED, "thrust", *MILLED)
"""Of the force, in the order of what is learned from them."""


def _learned(plan: _Plan, folder: Path) -> Experiment:
    """Learn from what an experiment states."""
    rake = plan.rake
    drift: int | None = None
    shares: list[float] | None = None
    rows: Cuts | NoseCuts | InterruptedCuts
    if plan.averages is None:
        how = _Reading(plan, folder)
        rows, drift, shares = how.rows(), how.record.drift, how.shares()
    elif isinstance(plan, _Orthogonal):
        rows = _averages(folder / plan.averages.file)
    else:
        rows, rake = _nose_averages(folder / plan.averages.file, rake)
    learned = learn_material(
        rows, drift=drift, edge_force=plan.edge_force, size_effect=plan.size_effect, calibration=shares,
        area_uncertainty=plan.area_uncertainty, thickness_uncertainty=plan.thickness_uncertainty,
        confidence=plan.confidence,
    )  # fmt: skip
    return Experiment(name=plan.name, source=plan.source, learned=learned, cuts=rows, rake=rake)


class _Reading:
    """Reads the records of an experiment, takes the dynamometer's share and fast changes out, and averages them."""

    def __init__(self, plan: _Plan, folder: Path) -> None:
        """Take what the experiment states, and where its files lie."""
        self.record: _Record = plan.record
        self.cuts, self.folder, self.named = plan.cuts, folder, plan.named
        self.by = self.record.found_by or next(iter(self.named.values()))
        self.channels = self.record.channels or tuple(
            dict.fromkeys(one.removeprefix("-") for one in (*self.named.values(), self.by))
        )
        self.sensor: Dynamometer | None = None
        self.filter = {"bandwidth_hz": 0.0, "noise_to_signal": 0.0}
        if plan.dynamometer is not None:
            self._tap(plan.dynamometer)
        self.steady = np.zeros(len(self.channels))

    def _tap(self, keys: _Sensor) -> None:
        """Learn the responses of the dynamometer from its taps."""
        if len(self.channels) != 3:
            raise InputError(f"record has {len(self.channels)} channels, with a dynamometer it needs 3: name all three")
        taps = []
        for one in keys.taps:
            said = read_forces(
                self.folder / one.file, channels=[keys.hammer, *self.channels],
                unit=keys.unit or self.record.unit, rate_hz=keys.rate or self.record.rate,
            )  # fmt: skip
            direction, force = np.array(one.direction), said.force
            taps.append(TapTest(hammer=force[:, 0], response=force[:, 1:], direction=direction, rate_hz=said.rate_hz))
        self.sensor = Dynamometer.from_taps(taps, flat_hz=keys.flat)
        self.filter = {"bandwidth_hz": keys.bandwidth, "noise_to_signal": keys.noise_to_signal}

    def rows(self) -> Cuts | NoseCuts | InterruptedCuts:
        """Return the averages of all records."""
        parts = []
        for i, one in enumerate(self.cuts):
            try:
                parts.append(self._rows_of(one))
            except InputError as error:
                raise InputError(f"cuts[{i + 1}]: {error}") from error
        return _together(parts)

    def _rows_of(self, one: _Cut) -> Cuts | NoseCuts | InterruptedCuts:
        """Return the averages of one record, and count its mean force."""
        how = self.record
        record = read_forces(
            self.folder / one.file, channels=self.channels, unit=how.unit, rate_hz=how.rate, range_n=how.range_n
        )
        passed = self._passband(record.rate_hz)
        if self.sensor is not None:
            record = self.sensor.forces(record, **self.filter)
        if how.low_pass is not None:
            record = low_pass(record, how.low_pass.cutoff, how.low_pass.order)
        found = self._found(one, record)
        rows = self._averaged(one, record, found, passed)
        air = in_air(record.samples, found)
        self.steady += remove_drift(record, air, degree=how.drift).force[~air].mean(axis=0)
        return rows

    def shares(self) -> list[float] | None:
        """Return by what share the dynamometer leaves each component uncertain."""
        if self.sensor is None:
            return None
        of_channel = np.minimum(self.sensor.relative_uncertainty(self.steady), 1.0)
        named = [self.named[key].removeprefix("-") for key in COMPONENTS if key in self.named]
        return [float(of_channel[self.channels.index(one)]) for one in named]

    def _passband(self, rate: float) -> Passband | None:
        """Return what the filters leave of forces at some frequencies, or ``None`` for all."""
        smooth = self.record.low_pass
        if self.sensor is None and smooth is None:
            return None

        def left(frequency: Floats) -> Complexes:
            found = np.tile(np.eye(len(self.channels), dtype=np.complex128), (frequency.size, 1, 1))
            if self.sensor is not None:
                heard = frequency <= CLOSES * self.filter["bandwidth_hz"]
                found[~heard] = 0
                found[heard] = self.sensor.resolution(frequency[heard], **self.filter)
            if smooth is not None:
                ratio = np.tan(np.pi * np.minimum(frequency / rate, 0.499)) / np.tan(np.pi * smooth.cutoff / rate)
                found *= (1 / (1 + ratio ** (2 * smooth.order)))[:, None, None]
            return found

        return left

    def _found(self, one: _Cut, record: ForceRecord) -> Ints:
        """Return first samples of the cuts of a record, and first ones after them. (m, 2)."""
        how = self.record
        if isinstance(one, _Pass):
            if one.times is not None:
                ends = [round(at * record.rate_hz) for at in one.times]
                if not 0 <= ends[0] < ends[1] <= record.samples:
                    raise InputError(
                        f"times are {list(one.times)} s, those of a pass ascend within the record of "
                        f"{record.samples / record.rate_hz:.4g} s: give begin and end"
                    )
                return np.array([ends], dtype=np.int64)
            turn = 60 / one.spindle
            if how.shortest < LEAST_TURNS * turn * (1 - OFF_SPEED):
                raise InputError(
                    f"shortest is {how.shortest:g} s, a pass is found by means over turns of {turn:.3g} s and the "
                    f"limit is {LEAST_TURNS} of these: raise it, or give the times of the pass"
                )
        return engagements(record, self.by, shortest=how.shortest, drift=how.drift, lead=how.lead)

    def _averaged(
        self, one: _Cut, record: ForceRecord, found: Ints, passed: Passband | None
    ) -> Cuts | NoseCuts | InterruptedCuts:
        """Return the averages of one record."""
        block, guard = self.record.block, self.record.guard
        if isinstance(one, _SlotPass | _FlyCutPass):
            return interrupted_cuts(
                record, found, geometry=one, spindle_rpm=one.spindle, block=block, guard=guard, passband=passed,
                **self.named,
            )  # fmt: skip
        assert block is not None  # noqa: S101 - records of the other kinds state it
        if isinstance(one, _Straight):
            return measured_cuts(
                record, found, thickness=_thickness(one, found / record.rate_hz), width=one.width,
                block=block, guard=guard, **self.named,
            )  # fmt: skip
        assert isinstance(one, _Turned)  # noqa: S101 - the last kind
        channels = {"feed_force" if key == "feed" else key: channel for key, channel in self.named.items()}
        depth, feed = (one.of_each(key, len(found)) for key in ("depth", "feed"))
        return turning_cuts(
            record, found, nose_radius=one.nose_radius, depth=depth, feed=feed, block=block, guard=guard, **channels
        )


def _require_rake(mine: float, common: float, where: str) -> None:
    if abs(mine - common) > RAKES_DIFFER:
        raise InputError(
            f"{where} has a rake of {np.rad2deg(mine):g} deg and the experiment one of {np.rad2deg(common):g} deg, "
            "coefficients are learned for one: give each rake an experiment of its own"
        )


def _of_each(values: Sequence[float], name: str, count: int) -> Sequence[float]:
    """Return values if there is one for each cut of a record."""
    if len(values) != count:
        raise InputError(
            f"it has {len(values)} {name}, and {count} cuts are found in its record: give one for each cut, or another "
            "value of shortest"
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


def _thickness(one: _Straight, spans: Floats) -> Callable[[Floats], Floats]:
    """Return the thickness over time: one for all, a ramp from first entry to last exit, or one for each cut."""
    if one.thickness is not None:
        steady = one.thickness
        return lambda at: np.full(at.shape, steady)
    if one.ramp is not None:
        ramp, ends = one.ramp, one.times or [spans[0, 0], spans[-1, 1]]
        return lambda at: np.interp(at, ends, ramp)
    steps = _of_each(one.steps or (), "steps", len(spans))
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
    if any(name in columns for name in UNCERTAINTIES):
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
