"""Cutting experiments in files: estimate a material from a CSV of averaged cuts, or from a TOML file with records.

The TOML file names the records and states the cuts of each, see the page on learning from forces.
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
from turnwright._tables import TableModel
from turnwright.cutting.forces import FlyCut, SlotMill
from turnwright.cutting.learning.cuts import (
    MILLED,
    SPINDLE_SPEED_TOL,
    TURNED,
    Cuts,
    InterruptedCuts,
    NoseCuts,
    interrupted_cuts,
    measured_cuts,
    turning_cuts,
)
from turnwright.cutting.learning.dynamometer import STOP_RATIO, Dynamometer, TapTest
from turnwright.cutting.learning.material_fit import learn_material
from turnwright.cutting.learning.records import NEWTONS, read_forces, read_table
from turnwright.cutting.learning.results import Estimate, LearnedMaterial
from turnwright.cutting.learning.signals import ForceRecord, engagements, in_air, low_pass, remove_drift
from turnwright.errors import InputError
from turnwright.units import Angle, Count, Feed, Flag, Frequency, Length, Number, Size, Speed, Text, Time, plain

if TYPE_CHECKING:
    from turnwright.cutting.learning.cuts import Passband

__all__ = ["Experiment", "learn_from_file"]

MIN_PASS_TURNS = 8
"""Shortest pass, in cutter revolutions, that `engagements` can find: it averages over an eighth of ``shortest``."""

RAKE_TOL_RAD = np.deg2rad(0.5)
"""Largest difference of rakes within one experiment."""

LENGTHS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}

COLUMNS = {"thickness": "thickness", "width": "width"}
FORCES = {"cutting": "cutting", "thrust": "thrust"}
"""Columns of a CSV of averaged orthogonal cuts, each with its unit, such as ``thickness [nm]``."""

NOSE_COLUMNS = {"nose radius": "nose_radius", "depth": "depth", "feed": "feed"}
NOSE_FORCES = {"axial force": "axial", "feed force": "feed_force", "cutting force": "cutting"}
"""Columns of a CSV of averaged cuts with a round nose, each with its unit; only measured forces are needed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Experiment:
    """Cutting experiment with the material estimated from it.

    Parameters
    ----------
    name
        Name of the material.
    source
        Source of the forces.
    learned
        Coefficients and critical chip thickness.
    cuts
        Rows of the regression.
    rake
        Tool rake. [rad]
    """

    name: str
    source: str
    learned: LearnedMaterial
    cuts: Cuts | NoseCuts | InterruptedCuts
    rake: float = 0.0

    def table(self) -> dict[str, Any]:
        """Return the material as the tables of a file that `Material.load` reads."""
        learned = self.learned
        at = f"; the tool's rake was {np.rad2deg(self.rake):g} deg" if self.rake else ""

        def interval(estimate: Estimate, scale: float = 1.0, unit: str = "", digits: int = 5) -> str:
            low, high = (f"{end * scale:.{digits}g}" for end in (estimate.low, estimate.high))
            return f"{self.source}: {learned.confidence:.0%} interval {low} to {high}{unit}{at}"

        table: dict[str, Any] = {
            "name": self.name,
            "brittle_plateau": learned.critical is not None,
            "notes": ". ".join(f"{sentence[0].upper()}{sentence[1:]}" for sentence in learned.sentences) + f"{at}.",
        }
        sources: dict[str, Any] = {}
        exponents = learned.exponents or (None, None)
        for key, estimate, sigma, exponent in zip(
            ("cutting", "thrust"), (learned.cutting, learned.thrust), learned.uncertainty, exponents, strict=True
        ):
            if estimate is None or sigma is None:
                raise InputError(
                    f"the measured forces do not determine the {key} coefficient, a material needs both: also measure "
                    + ("the cutting force" if key == "cutting" else "the axial force or the feed force")
                )
            if not estimate.value > 0:
                raise InputError(
                    f"the {key} coefficient is {estimate.value:.4g} N/mm^2, it must be above 0: check the signs of "
                    "both channels"
                )
            table[key] = {"n_per_mm2": _round(estimate.value), "uncertainty_n_per_mm2": _round(sigma)}
            sources[key] = {
                "value": interval(estimate, unit=" N/mm2"),
                "uncertainty": f"{self.source}: standard uncertainty",
            }
            if exponent is not None and learned.reference_thickness is not None:
                table[key]["exponent"] = _round(exponent.value)
                table[key]["reference_thickness"] = f"{_round(learned.reference_thickness * 1e6)} nm"
                sources[key]["exponent"] = interval(exponent, digits=4)
        if learned.critical is not None:
            critical = learned.critical
            table["critical"] = {
                "value": f"{_round(critical.value * 1e6)} nm",
                "uncertainty": f"{_round((critical.high * 1e6 - critical.low * 1e6) / 4)} nm",
            }
            sources["critical"] = {
                "value": interval(critical, 1e6, " nm"),
                "uncertainty": f"{self.source}: a quarter of the interval",
            }
            sources["brittle_plateau"] = "assumed: forces are constant beyond the critical thickness"
        if learned.remaining is not None:
            table["brittle_force"] = [_round(min(max(ratio, 0.0), 1.0)) for ratio in learned.remaining]
            sources["brittle_force"] = f"{self.source}: forces just beyond over those just below the critical thickness"
        return {**table, "sources": sources}


def _round(value: float) -> float:
    return float(f"{value:.6g}")


def learn_from_file(file: str | Path) -> Experiment:
    """Estimate a material from the file of an experiment.

    Parameters
    ----------
    file
        TOML file of an experiment, or CSV file of averaged cuts.

    Raises
    ------
    InputError
        If a file cannot be read, or the experiment is too small.
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
        return _estimate(plan, path.parent)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error


Named: TypeAlias = Annotated[str, plain(1)]
"""Non-empty text."""


@dataclass(frozen=True, kw_only=True)
class _Cut(TableModel):
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
        keys = [key for key in ("thickness", "ramp", "steps") if getattr(self, key) is not None]
        if len(keys) != 1:
            raise InputError(f"exactly one of thickness, ramp, steps must be stated, got {', '.join(keys) or 'none'}")
        if self.ramp is not None and self.times is not None and not self.times[0] < self.times[1]:
            raise InputError(f"times must be begin and end of the ramp, ascending, got {list(self.times)} s")


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
                stated = f"{key} and {key}s" if each else "none"
                raise InputError(f"either {key} or {key}s (one for each cut) must be stated, got {stated}")

    def of_each(self, key: str, count: int) -> Sequence[float]:
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
class _LowPass(TableModel):
    cutoff: Frequency
    order: Annotated[int, plain()]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Record(TableModel):
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
            stated = "both" if self.whole_turns else "neither"
            raise InputError(f"either block or whole_turns = true must be stated, got {stated}")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tap(TableModel):
    file: Named
    direction: tuple[Number, Number, Number]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sensor(TableModel):
    hammer: Named
    bandwidth: Frequency
    noise_to_signal: Number
    unit: Named | None = None
    rate: Frequency | None = None
    flat: Frequency | None = None
    taps: tuple[_Tap, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Averages(TableModel):
    file: Named


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan(TableModel):
    components: ClassVar[tuple[str, ...]] = ()
    """Force components; the first measured one is used to find the cuts."""

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
                f"inclination must be 0 deg (no coefficient is estimated for the force along an oblique edge), got "
                f"{np.rad2deg(self.inclination):g} deg"
            )
        if (self.averages is None) == (not self.cuts):
            stated = "both" if self.cuts else "neither"
            raise InputError(f"either [averages] or [[cuts]] must be stated, got {stated}")
        if self.averages is None and self.record is None:
            raise InputError("the experiment lacks record: state the channels in [record]")
        if self.record is not None and not self.named:
            raise InputError(f"record must name a channel for at least 1 of {', '.join(self.components)}, got none")
        for i, cut in enumerate(self.cuts):
            _require_rake(self.rake if cut.rake is None else cut.rake, self.rake, f"cuts[{i + 1}]")

    @property
    def named(self) -> dict[str, str]:
        return {
            component: channel
            for component in self.components
            if (channel := getattr(self.record, component)) is not None
        }


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
"""Force components, in the order of the estimates."""


def _estimate(plan: _Plan, folder: Path) -> Experiment:
    rake = plan.rake
    drift: int | None = None
    calibration: list[float] | None = None
    rows: Cuts | NoseCuts | InterruptedCuts
    if plan.averages is None:
        reading = _Reading(plan, folder)
        rows, drift, calibration = reading.rows(), reading.record.drift, reading.calibration()
    else:
        rows, rake = _read_averages(folder / plan.averages.file, plan)
    learned = learn_material(
        rows, drift=drift, edge_force=plan.edge_force, size_effect=plan.size_effect, calibration=calibration,
        area_uncertainty=plan.area_uncertainty, thickness_uncertainty=plan.thickness_uncertainty,
        confidence=plan.confidence,
    )  # fmt: skip
    return Experiment(name=plan.name, source=plan.source, learned=learned, cuts=rows, rake=rake)


class _Reading:
    """Reader of the records of an experiment: compensates the dynamometer, filters and averages."""

    def __init__(self, plan: _Plan, folder: Path) -> None:
        self.record: _Record = plan.record
        self.cuts, self.folder, self.named = plan.cuts, folder, plan.named
        self.by = self.record.found_by or next(iter(self.named.values()))
        self.channels = self.record.channels or tuple(
            dict.fromkeys(channel.removeprefix("-") for channel in (*self.named.values(), self.by))
        )
        self.sensor: Dynamometer | None = None
        self.filter = {"bandwidth_hz": 0.0, "noise_to_signal": 0.0}
        if plan.dynamometer is not None:
            self._tap(plan.dynamometer)
        self.steady = np.zeros(len(self.channels))

    def _tap(self, keys: _Sensor) -> None:
        if len(self.channels) != 3:
            raise InputError(f"record must name 3 channels with a dynamometer, got {len(self.channels)}")
        taps = []
        for tap in keys.taps:
            record = read_forces(
                self.folder / tap.file, channels=[keys.hammer, *self.channels],
                unit=keys.unit or self.record.unit, rate_hz=keys.rate or self.record.rate,
            )  # fmt: skip
            direction, force = np.array(tap.direction), record.force
            taps.append(TapTest(hammer=force[:, 0], response=force[:, 1:], direction=direction, rate_hz=record.rate_hz))
        self.sensor = Dynamometer.from_taps(taps, flat_hz=keys.flat)
        self.filter = {"bandwidth_hz": keys.bandwidth, "noise_to_signal": keys.noise_to_signal}

    def rows(self) -> Cuts | NoseCuts | InterruptedCuts:
        parts = []
        for i, cut in enumerate(self.cuts):
            try:
                parts.append(self._rows_of(cut))
            except InputError as error:
                raise InputError(f"cuts[{i + 1}]: {error}") from error
        return _join_records(parts)

    def _rows_of(self, cut: _Cut) -> Cuts | NoseCuts | InterruptedCuts:
        settings = self.record
        record = read_forces(
            self.folder / cut.file,
            channels=self.channels,
            unit=settings.unit,
            rate_hz=settings.rate,
            range_n=settings.range_n,
        )
        passed = self._passband(record.rate_hz)
        if self.sensor is not None:
            record = self.sensor.forces(record, **self.filter)
        if settings.low_pass is not None:
            record = low_pass(record, settings.low_pass.cutoff, settings.low_pass.order)
        spans = self._find_cuts(cut, record)
        rows = self._averaged(cut, record, spans, passed)
        air = in_air(record.samples, spans)
        self.steady += remove_drift(record, air, degree=settings.drift).force[~air].mean(axis=0)
        return rows

    def calibration(self) -> list[float] | None:
        if self.sensor is None:
            return None
        of_channel = np.minimum(self.sensor.relative_uncertainty(self.steady), 1.0)
        named = [self.named[key].removeprefix("-") for key in COMPONENTS if key in self.named]
        return [float(of_channel[self.channels.index(channel)]) for channel in named]

    def _passband(self, rate: float) -> Passband | None:
        """Return the transfer matrix of the filters over frequency; ``None`` without filters."""
        smooth = self.record.low_pass
        if self.sensor is None and smooth is None:
            return None

        def transfer(frequency: Floats) -> Complexes:
            matrix = np.tile(np.eye(len(self.channels), dtype=np.complex128), (frequency.size, 1, 1))
            if self.sensor is not None:
                passed = frequency <= STOP_RATIO * self.filter["bandwidth_hz"]
                matrix[~passed] = 0
                matrix[passed] = self.sensor.resolution(frequency[passed], **self.filter)
            if smooth is not None:
                ratio = np.tan(np.pi * np.minimum(frequency / rate, 0.499)) / np.tan(np.pi * smooth.cutoff / rate)
                matrix *= (1 / (1 + ratio ** (2 * smooth.order)))[:, None, None]
            return matrix

        return transfer

    def _find_cuts(self, cut: _Cut, record: ForceRecord) -> Ints:
        """Return the first sample of each cut of a record, and the first one after it. (m, 2)."""
        settings = self.record
        if isinstance(cut, _Pass):
            if cut.times is not None:
                ends = [round(at * record.rate_hz) for at in cut.times]
                if not 0 <= ends[0] < ends[1] <= record.samples:
                    raise InputError(
                        "times must be begin and end of the pass, ascending within the record of "
                        f"{record.samples / record.rate_hz:.4g} s, got {list(cut.times)} s"
                    )
                return np.array([ends], dtype=np.int64)
            turn = 60 / cut.spindle
            if settings.shortest < MIN_PASS_TURNS * turn * (1 - SPINDLE_SPEED_TOL):
                raise InputError(
                    f"shortest must be at least {MIN_PASS_TURNS} revolutions of {turn:.3g} s to find a pass, got "
                    f"{settings.shortest:g} s: raise it, or state the times of the pass"
                )
        return engagements(record, self.by, shortest=settings.shortest, drift=settings.drift, lead=settings.lead)

    def _averaged(
        self, cut: _Cut, record: ForceRecord, spans: Ints, passed: Passband | None
    ) -> Cuts | NoseCuts | InterruptedCuts:
        block, guard = self.record.block, self.record.guard
        if isinstance(cut, _SlotPass | _FlyCutPass):
            return interrupted_cuts(
                record, spans, geometry=cut, spindle_rpm=cut.spindle, block=block, guard=guard, passband=passed,
                **self.named,
            )  # fmt: skip
        assert block is not None  # noqa: S101 - records of the other kinds state it
        if isinstance(cut, _Straight):
            return measured_cuts(
                record, spans, thickness=_thickness(cut, spans / record.rate_hz), width=cut.width,
                block=block, guard=guard, **self.named,
            )  # fmt: skip
        assert isinstance(cut, _Turned)  # noqa: S101 - the last kind
        channels = {"feed_force" if key == "feed" else key: channel for key, channel in self.named.items()}
        depth, feed = (cut.of_each(key, len(spans)) for key in ("depth", "feed"))
        return turning_cuts(
            record, spans, nose_radius=cut.nose_radius, depth=depth, feed=feed, block=block, guard=guard, **channels
        )


def _require_rake(rake: float, common: float, where: str) -> None:
    if abs(rake - common) > RAKE_TOL_RAD:
        raise InputError(
            f"{where} has a rake of {np.rad2deg(rake):g} deg, that of the experiment is {np.rad2deg(common):g} deg: "
            "make a separate experiment for each rake"
        )


def _of_each(values: Sequence[float], name: str, count: int) -> Sequence[float]:
    """Return the values; raise unless there is one for each cut of a record."""
    if len(values) != count:
        raise InputError(
            f"{name} must have one value for each of the {count} cuts found in the record, got {len(values)}: correct "
            "it, or change shortest"
        )
    return values


def _join_records(parts: Sequence[Cuts | NoseCuts | InterruptedCuts]) -> Cuts | NoseCuts | InterruptedCuts:
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
    interrupted = [part for part in parts if isinstance(part, InterruptedCuts)]
    passes = np.cumsum([0, *[int(part.cut.max()) + 1 for part in interrupted]])
    cut = [np.where(part.cut >= 0, part.cut + begin, -1) for part, begin in zip(interrupted, passes[:-1], strict=True)]
    rates = {part.rate_hz for part in interrupted}
    if len(rates) > 1:
        raise InputError(f"the records must have 1 sampling rate, got {len(rates)}: choose records of one rate")
    return replace(
        first,
        **joined(("force", "begin", "end")),
        geometry=tuple(part.geometry[0] for part in interrupted),
        spindle_rpm=tuple(part.spindle_rpm[0] for part in interrupted),
        cut=np.concatenate(cut),
        record=number,
    )


def _thickness(cut: _Straight, spans: Floats) -> Callable[[Floats], Floats]:
    """Return the thickness over time: constant, a ramp from first entry to last exit, or one value for each cut."""
    if cut.thickness is not None:
        steady = cut.thickness
        return lambda at: np.full(at.shape, steady)
    if cut.ramp is not None:
        ramp, ends = cut.ramp, cut.times or [spans[0, 0], spans[-1, 1]]
        return lambda at: np.interp(at, ends, ramp)
    steps = _of_each(cut.steps or (), "steps", len(spans))
    return lambda at: np.asarray(steps)[np.clip(np.searchsorted(spans[:, 0], at, side="right") - 1, 0, None)]


def _read_columns(path: Path, factors: Mapping[str, Mapping[str, float]], needed: Sequence[str]) -> dict[str, Floats]:
    """Read a CSV of averaged cuts; ``factors`` holds the units of each column with their factors."""
    columns, units = read_table(path, bytes_of(path, "the table"), "cut")
    for name in columns:
        if name not in factors or name not in units:
            raise InputError(
                f"columns of {path} must be {', '.join(factors)}, each with its unit such as '{needed[0]} [nm]', got "
                f"{name[:60]!r}"
            )
        if units[name] not in factors[name]:
            listed = ", ".join(factors[name])
            raise InputError(f"the unit of {name} in {path} must be one of {listed}, got {units[name]!r}")
    missing = [name for name in needed if name not in columns]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}: add it with its unit, such as '{needed[0]} [nm]'")
    return {name: column * factors[name][units[name]] for name, column in columns.items()}


def _read_averages(path: Path, plan: _Plan) -> tuple[Cuts | NoseCuts, float]:
    """Read averages of cuts, and their rake."""
    straight = isinstance(plan, _Orthogonal)
    lengths, forces = (COLUMNS, FORCES) if straight else (NOSE_COLUMNS, NOSE_FORCES)
    factors = dict.fromkeys(lengths, LENGTHS)
    factors |= dict.fromkeys((*forces, *(f"{name} uncertainty" for name in forces)), NEWTONS)
    factors |= {} if straight else {"rake": {"deg": np.pi / 180, "rad": 1.0}}
    columns = _read_columns(path, factors, (*lengths, *(forces if straight else ())))
    rake = plan.rake
    if "rake" in columns:
        rake = float(columns["rake"][0])
        for i, cut_rake in enumerate(columns["rake"]):
            _require_rake(float(cut_rake), rake, f"{path}, cut {i + 1},")
    values = {key: columns[name] for name, key in (lengths | forces).items() if name in columns}
    if any(f"{name} uncertainty" in columns for name in forces):
        names = [f"{name} uncertainty" for name in forces if name in columns]
        missing = [name for name in names if name not in columns]
        if missing:
            raise InputError(f"{path} lacks {', '.join(missing)}: add it with its unit, such as '{missing[0]} [mN]'")
        values["uncertainty"] = np.column_stack([columns[name] for name in names])
    return (Cuts if straight else NoseCuts)(**values), rake
