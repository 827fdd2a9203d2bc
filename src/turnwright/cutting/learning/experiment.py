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
from turnwright._arrays import Floats, Ints, rows_of_numbers
from turnwright._io import read_toml
from turnwright._validate import positive
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
from turnwright.cutting.learning.records import NEWTONS, read_forces, separator
from turnwright.cutting.learning.signals import ForceRecord, engagements, in_air, low_pass, remove_drift
from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from turnwright.cutting.learning.cuts import Passband

__all__ = ["Experiment", "learn_from_file"]

GONE = object()

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
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is no name of a file"
        raise InputError(f"the experiment {str(file)!r} cannot be read ({why}): check its name") from error
    if path.suffix.lower() == ".toml":
        table = read_toml(data, f"the experiment {str(file)!r}")
    else:
        table = {"name": path.stem, "source": path.name, "averages": {"file": path.name}}
        if b"nose radius" in data.split(b"\n", 1)[0]:
            table["kind"] = "round nose"
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
    kind = keys.text("kind", "orthogonal")
    if kind not in CHANNELS:
        raise InputError(f"kind is {kind!r}, the known ones are {', '.join(CHANNELS)}: choose one")
    rake, leans = keys.quantity("rake", "rad", 0.0), keys.quantity("inclination", "rad", 0.0)
    if leans:
        raise InputError(
            f"the edge is inclined by {np.rad2deg(leans):g} deg, the limit is 0 deg: an oblique cut also presses along "
            "its edge, for which no coefficient is learned, so set the edge square to the cut"
        )
    confidence = keys.number("confidence", 0.95)
    edge, falls = keys.flag("edge_force"), keys.flag("size_effect")
    shared = "width_uncertainty" if kind == "orthogonal" else "area_uncertainty"
    common = float(keys.number(shared, 0.0))
    averages, cuts = keys.part("averages"), keys.tables("cuts")
    record, dynamometer = keys.part("record"), keys.part("dynamometer")
    thickness = keys.quantity("thickness_uncertainty", "mm", 0.0)
    keys.done()
    if (averages is None) == (not cuts):
        raise InputError("the experiment has neither averages nor cuts, or both: give [averages] or [[cuts]]")
    more = {"edge_force": edge, "size_effect": falls, "thickness_uncertainty": thickness, "confidence": confidence}
    drift: int | None = None
    shares: list[float] | None = None
    rows: Cuts | NoseCuts | InterruptedCuts
    if averages is not None:
        file = folder / averages.text("file")
        averages.done()
        if kind in ("slot", "fly-cut"):
            raise InputError(
                f"averages were given of the kind {kind!r}, averages can be of orthogonal or round nose: give records"
            )
        if kind == "orthogonal":
            rows = _averages(file)
        else:
            rows, rake = _nose_averages(file, rake)
    elif record is None:
        raise InputError("the experiment lacks record: say in [record] which channel is which")
    else:
        how = _Record(record, kind)
        rows, shares = _recorded(how, dynamometer, cuts, folder, kind, rake)
        drift = how.drift
    learned = learn_material(rows, drift=drift, calibration=shares, area_uncertainty=common, **more)
    return Experiment(name=name, source=source, learned=learned, cuts=rows, rake=rake)


class _Record:
    """How the records are to be read and cleaned."""

    def __init__(self, keys: _Keys, kind: str) -> None:
        given = {one: keys.text(one, *(() if kind == "orthogonal" else (None,))) for one in CHANNELS[kind]}
        self.named: dict[str, str] = {key: channel for key, channel in given.items() if channel is not None}
        if not self.named:
            raise InputError(f"record names no channel, it needs at least 1 of {', '.join(given)}: add it")
        self.by = keys.text("found_by", next(iter(self.named.values())))
        plain = [one.removeprefix("-") for one in (*self.named.values(), self.by)]
        self.channels = keys.raw("channels", list(dict.fromkeys(plain)))
        if not isinstance(self.channels, list) or not all(isinstance(one, str) for one in self.channels):
            raise InputError(f"record has channels = {self.channels!r}, it must be a list of names: write [ ]")
        self.unit = keys.text("unit", None)
        self.rate = keys.quantity("rate", "Hz", None)
        self.range = keys.number("range_n", None)
        self.drift = keys.raw("drift")
        self.shortest, self.lead = keys.quantity("shortest", "s"), keys.quantity("lead", "s", 0.0)
        self.whole_turns = kind in ("slot", "fly-cut") and keys.flag("whole_turns")
        self.block = None if self.whole_turns else keys.quantity("block", "s")
        self.guard = keys.quantity("guard", "s")
        smooth = keys.part("low_pass")
        self.smooth = None if smooth is None else (smooth.quantity("cutoff", "Hz"), smooth.raw("order"))
        if smooth is not None:
            smooth.done()
        keys.done()

    def read(self, path: Path) -> ForceRecord:
        return read_forces(path, channels=self.channels, unit=self.unit, rate_hz=self.rate, range_n=self.range)

    def passband(self, sensor: Dynamometer | None, bandwidth: float, noise: float, rate: float) -> Passband | None:
        """Return what the filters leave of forces at some frequencies, or ``None`` for all."""
        if sensor is None and self.smooth is None:
            return None

        def left(frequency: Floats) -> NDArray[np.complex128]:
            found = np.tile(np.eye(len(self.channels), dtype=np.complex128), (frequency.size, 1, 1))
            if sensor is not None:
                heard = frequency <= CLOSES * bandwidth
                found[~heard] = 0
                found[heard] = sensor.resolution(frequency[heard], bandwidth_hz=bandwidth, noise_to_signal=noise)
            if self.smooth is not None:
                cutoff, order = self.smooth
                ratio = np.tan(np.pi * np.minimum(frequency / rate, 0.499)) / np.tan(np.pi * cutoff / rate)
                found *= (1 / (1 + ratio ** (2 * order)))[:, None, None]
            return found

        return left


def _recorded(
    how: _Record, dynamometer: _Keys | None, cuts: Sequence[_Keys], folder: Path, kind: str, rake: float
) -> tuple[Cuts | NoseCuts | InterruptedCuts, list[float] | None]:
    """Return the rows of all records, and by what share the dynamometer leaves each component uncertain."""
    sensor, bandwidth, noise = _sensor(dynamometer, how, folder)
    parts: list[Cuts | NoseCuts | InterruptedCuts] = []
    steady = np.zeros(len(how.channels))
    for one in cuts:
        _require_rake(one.quantity("rake", "rad", rake), rake, one.where)
        record = how.read(folder / one.text("file"))
        passed = how.passband(sensor, bandwidth, noise, record.rate_hz)
        if sensor is not None:
            record = sensor.forces(record, bandwidth_hz=bandwidth, noise_to_signal=noise)
        if how.smooth is not None:
            record = low_pass(record, *how.smooth)
        found = _found(how, one, record, kind)
        if kind == "orthogonal":
            parts.append(_straight(how, one, record, found))
        elif kind == "round nose":
            parts.append(_turned(how, one, record, found))
        else:
            parts.append(_milled(how, one, record, found, kind, passed))
        one.done()
        air = in_air(record.samples, found)
        steady += remove_drift(record, air, degree=how.drift).force[~air].mean(axis=0)
    shares: list[float] | None = None
    if sensor is not None:
        of_channel = np.minimum(sensor.relative_uncertainty(steady), 1.0)
        order = {"round nose": TURNED, "orthogonal": CHANNELS[kind]}.get(kind, MILLED)
        shares = [
            float(of_channel[how.channels.index(how.named[key].removeprefix("-"))]) for key in order if key in how.named
        ]
    return _together(parts), shares


def _found(how: _Record, one: _Keys, record: ForceRecord, kind: str) -> Ints:
    """Return first samples of the cuts of a record, and first ones after them. (m, 2)."""
    if kind in ("slot", "fly-cut"):
        turn = 60 / positive(one.quantity("spindle", "rpm"), f"spindle of {one.where}", "rpm")
        if "times" in one.table:
            times = one.quantities("times", "s")
            ends = [round(at * record.rate_hz) for at in times]
            if len(ends) != 2 or not 0 <= ends[0] < ends[1] <= record.samples:
                raise InputError(
                    f"{one.where} has times {times}, a pass needs 2 that ascend within the record of "
                    f"{record.samples / record.rate_hz:.4g} s: give begin and end"
                )
            return np.array([ends], dtype=np.int64)
        if how.shortest < LEAST_TURNS * turn * (1 - OFF_SPEED):
            raise InputError(
                f"shortest is {how.shortest:g} s, a pass is found by means over turns of {turn:.3g} s and the limit is "
                f"{LEAST_TURNS} of these: raise it, or give the times of {one.where}"
            )
    return engagements(record, how.by, shortest=how.shortest, drift=how.drift, lead=how.lead)


def _require_rake(mine: float, common: float, where: str) -> None:
    if abs(mine - common) > RAKES_DIFFER:
        raise InputError(
            f"{where} has a rake of {np.rad2deg(mine):g} deg and the experiment one of {np.rad2deg(common):g} deg, "
            "coefficients are learned for one: give each rake an experiment of its own"
        )


def _straight(how: _Record, one: _Keys, record: ForceRecord, found: Ints) -> Cuts:
    assert how.block is not None  # noqa: S101 - whole turns are of other kinds
    return measured_cuts(
        record,
        found,
        cutting=how.named["cutting"],
        thrust=how.named["thrust"],
        thickness=_thickness(one, found / record.rate_hz),
        width=one.quantity("width", "mm"),
        block=how.block,
        guard=how.guard,
    )


def _turned(how: _Record, one: _Keys, record: ForceRecord, found: Ints) -> NoseCuts:
    assert how.block is not None  # noqa: S101 - whole turns are of other kinds
    of_each = {}
    for key, many, unit in (("depth", "depths", "mm"), ("feed", "feeds", "mm/rev")):
        given = [name for name in (key, many) if name in one.table]
        if len(given) != 1:
            raise InputError(f"{one.where} has {' and '.join(given) or f'no {key}'}: give {key}, or {many} of its cuts")
        values = [one.quantity(key, unit)] * len(found) if given == [key] else one.quantities(many, unit)
        if len(values) != len(found):
            raise InputError(
                f"{one.where} has {len(values)} {many}, and {len(found)} cuts are found in its record: give one for "
                "each cut, or another value of shortest"
            )
        of_each[key] = np.array([positive(value, f"a {key} of {one.where}", unit) for value in values])
    channels = {"feed_force" if key == "feed" else key: channel for key, channel in how.named.items()}
    return turning_cuts(
        record, found, nose_radius=positive(one.quantity("nose_radius", "mm"), "nose_radius", "mm"),
        depth=of_each["depth"], feed=of_each["feed"], block=how.block, guard=how.guard, **channels,
    )  # fmt: skip


def _milled(
    how: _Record, one: _Keys, record: ForceRecord, found: Ints, kind: str, passed: Passband | None
) -> InterruptedCuts:
    geometry: SlotMill | FlyCut
    if kind == "slot":
        geometry = SlotMill(
            radius=one.quantity("radius", "mm"),
            feed_per_tooth=one.quantity("feed_per_tooth", "mm"),
            depth=one.quantity("depth", "mm"),
            teeth=one.raw("teeth"),
            corner_radius=one.quantity("corner_radius", "mm", 0.0),
            entry=one.quantity("entry", "rad", 0.0),
            exit=one.quantity("exit", "rad", np.pi),
        )
    else:
        lengths = {key: one.quantity(key, "mm") for key in ("swing", "nose_radius", "step", "depth")}
        geometry = FlyCut(**lengths, feed=one.quantity("feed", "mm/rev"))
    return interrupted_cuts(
        record,
        found,
        geometry=geometry,
        spindle_rpm=one.quantity("spindle", "rpm"),
        block=how.block,
        guard=how.guard,
        passband=passed,
        **how.named,
    )


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


def _columns(path: Path, known: Mapping[str, Mapping[str, float]], needed: Sequence[str]) -> dict[str, Floats]:
    """Read a CSV of averaged cuts, a line each; every column with its unit, of which the sizes are given."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): check its name") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is no text: give a CSV of averaged cuts, or a TOML file of an experiment") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise InputError(f"{path} has {len(lines)} lines, it needs a line of names and one for each cut: add them")
    mark = separator(lines[0])
    heads = [one.strip() for one in lines[0].split(mark)]
    found: dict[str, tuple[int, float]] = {}
    for i, head in enumerate(heads):
        match = re.fullmatch(r"(.+?)\s*[\[(]\s*(\S+)\s*[\])]", head)
        if match is None or match.group(1) not in known:
            raise InputError(
                f"{path} has a column {head[:60]!r}, the known ones are {', '.join(known)}, each with its unit such as "
                f"'{needed[0]} [nm]': correct the first line"
            )
        name, unit = match.groups()
        if unit not in known[name]:
            raise InputError(f"{path} has {name} in {unit!r}, the units are {', '.join(known[name])}: convert it")
        found[name] = (i, known[name][unit])
    missing = [name for name in needed if name not in found]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}: add it with its unit, such as '{needed[0]} [nm]'")
    try:
        table = rows_of_numbers(lines[1:], mark)
    except ValueError as error:
        raise InputError(
            f"{path} is not a table of numbers ({error}): use decimal points and as many numbers in each line"
        ) from error
    if table.shape[1] != len(heads):
        raise InputError(f"{path} has {len(heads)} names and numbers of shape {table.shape}: give as many in each line")
    return {name: table[:, i] * factor for name, (i, factor) in found.items()}


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
