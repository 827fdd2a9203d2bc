"""Force records as data loggers write them: CSV, HDF5 and TDMS.

What a file says itself is believed: names, units, rate. What it does not say must be stated; nothing is guessed.
"""

from __future__ import annotations

import io
import json
import re
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from turnwright._arrays import Floats, rows_of_numbers
from turnwright._io import answer_parent, bytes_of, read_isolated
from turnwright._validate import positive
from turnwright.cutting.learning.saturation import require_unsaturated
from turnwright.cutting.learning.signals import ForceRecord
from turnwright.errors import InputError

__all__ = ["NEWTONS", "read_forces", "read_table"]

NEWTONS = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "uN": 1e-6, "µN": 1e-6, "μN": 1e-6}
"""What forces may be in."""

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}

TIMES = frozenset({"time", "t", "zeit"})
"""Names of a column that holds times, in small letters."""

RATES = ("rate_hz", "sample_rate", "sampling_rate", "samplerate")
STEPS = ("wf_increment", "dt")
UNITS = ("unit", "units", "unit_string")
"""Attributes of HDF5 and TDMS that say rate, step and unit."""

UNEVEN = 0.1
"""Share of a step by which a time may be off, since times are printed rounded; a sample that is missing is half a step.
"""

ROUNDED = 1e-6
"""Share of the range of a channel by which its end may be off in print."""

REAL = "iuf"
"""Kinds of numbers that a force can be; a complex one belongs to a spectrum."""

LARGEST = 1 << 30
"""Values in a record beyond which it is refused."""

HDF5 = b"\x89HDF\r\n\x1a\n"
TDMS = b"TDSm"


@dataclass(frozen=True, slots=True)
class _Raw:
    """Columns as a file has them."""

    columns: Mapping[str, Floats]
    units: Mapping[str, str]
    rate_hz: float | None


def read_forces(
    file: str | Path,
    *,
    channels: Sequence[str] | None = None,
    unit: str | None = None,
    rate_hz: float | None = None,
    range_n: float | None = None,
) -> ForceRecord:
    """Read a force record.

    Parameters
    ----------
    file
        CSV with a line of names such as ``time [s], Fx [N]``; HDF5 with a dataset for each channel; or TDMS. The
        contents tell which, not the name.
    channels
        Names of the channels wanted, in order; all but the time if not given. In HDF5 and TDMS the last part of a path
        is enough where it is the only one of its name.
    unit
        What the forces are in where the file does not say: N, kN, mN or uN.
    rate_hz
        Samples per second where the file says neither that nor the times. [Hz]
    range_n
        Force at which the channels end, either way; ``None`` where that is not known. [N]

    Raises
    ------
    InputError
        If the file cannot be read, lacks a channel, its unit or its rate, holds values that are not finite, or a
        channel is saturated.

    Sources
    -------
    TDMS is read by npTDMS, HDF5 by h5py in a process of its own, since its library may die of a damaged file.
    """
    path = Path(file)
    data = bytes_of(path, "the force record")
    if data.startswith(HDF5):
        raw = _apart(path, channels)
    elif data.startswith(TDMS):
        raw = _tdms(path, data, channels)
    else:
        raw = _Raw(*read_table(path, data, "sample"), None)
    record = _chosen(path, raw, channels, unit, rate_hz)
    if range_n is not None:
        limit = positive(range_n, "range_n", "N") * (1 - ROUNDED)
        for name, column in zip(record.channels, record.force.T, strict=True):
            require_unsaturated(str(path), name, column, np.flatnonzero(np.abs(column) >= limit), record.rate_hz)
    return record


def _chosen(
    path: Path, raw: _Raw, channels: Sequence[str] | None, unit: str | None, rate_hz: float | None
) -> ForceRecord:
    """Return the channels that are wanted in N, and their rate."""
    times = [name for name in raw.columns if _last(name).lower() in TIMES]
    wanted = (
        [_find(path, raw, one) for one in channels] if channels else [one for one in raw.columns if one not in times]
    )
    if not wanted:
        raise InputError(f"{path} holds no channel of forces: give a file with at least 1")
    sizes = {raw.columns[name].size for name in wanted}
    if len(sizes) > 1:
        raise InputError(f"the channels of {path} differ in length ({min(sizes)} to {max(sizes)}): choose those alike")
    scale = []
    for name in wanted:
        stated = raw.units.get(name) or unit
        if stated is None:
            raise InputError(f"{path} does not say what {name!r} is in: state the unit, such as 'N'")
        if stated not in NEWTONS:
            raise InputError(f"{name!r} of {path} is in {stated!r}, forces are in {', '.join(NEWTONS)}: convert it")
        scale.append(NEWTONS[stated])
    count = sizes.pop()
    found = raw.rate_hz or next((_rate(path, raw, one) for one in times if raw.columns[one].size == count), None)
    rate = found or rate_hz
    if rate is None:
        raise InputError(f"{path} says neither the rate nor the times of its samples: state the rate, such as '10 kHz'")
    force = np.column_stack([raw.columns[name] * factor for name, factor in zip(wanted, scale, strict=True)])
    names = tuple(channels) if channels else tuple(wanted)
    try:
        return ForceRecord(force=force, rate_hz=rate, channels=names, name=path.name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _last(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _find(path: Path, raw: _Raw, wanted: str) -> str:
    if wanted in raw.columns:
        return wanted
    alike = [name for name in raw.columns if _last(name) == wanted]
    if len(alike) != 1:
        listed = ", ".join(list(raw.columns)[:12])
        state = f"{len(alike)} channels" if alike else "no channel"
        raise InputError(f"{path} has {state} {wanted!r}, it has {listed}: name one of these in full")
    return alike[0]


def _rate(path: Path, raw: _Raw, name: str) -> float:
    """Return the rate that times tell."""
    stated = raw.units.get(name, "s")
    if stated not in SECONDS:
        raise InputError(f"the times of {path} are in {stated!r}, the known units are s, ms and us: convert them")
    times = raw.columns[name] * SECONDS[stated]
    step = (times[-1] - times[0]) / (times.size - 1) if times.size > 1 else 0.0
    off = np.abs(times - times[0] - step * np.arange(times.size)).max() if step > 0 else np.inf
    if not off <= UNEVEN * step:
        raise InputError(
            f"the times of {path} are not even, off by up to {off:.3g} s at steps of {step:.3g} s, the limit is "
            f"{UNEVEN:.0%} of a step: resample it, or leave the times out and state the rate"
        )
    return float(1 / step)


_NAME = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*")
_NUMBER = re.compile(r"[-+.\d][-+.\deE]*|nan|inf")


def read_table(path: Path, data: bytes, row: str) -> tuple[dict[str, Floats], dict[str, str]]:
    """Read text: a line of names, then a line of numbers for each row. Return the columns and their units."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is neither CSV text, HDF5 nor TDMS: export it as one of these") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise InputError(f"{path} has {len(lines)} lines, it needs a line of names and one for each {row}: add them")
    mark = next((one for one in ("\t", ";") if one in lines[0]), ",")
    heads = [_NAME.fullmatch(one) for one in lines[0].split(mark)]
    names = [head.group(1).strip('"') if head else "" for head in heads]
    if any(not name or _NUMBER.fullmatch(name) for name in names) or len(set(names)) != len(names):
        raise InputError(f"{path} begins with {lines[0][:60]!r}, that is no line of names: name each column apart")
    try:
        table = rows_of_numbers(lines[1:], mark)
    except ValueError as error:
        raise InputError(
            f"{path} is not a table of numbers after its line of names ({error}): use decimal points and as many "
            "numbers in each line"
        ) from error
    if table.shape[1] != len(names):
        raise InputError(f"{path} has {len(names)} names and {table.shape[1]} columns: name each column")
    columns = dict(zip(names, table.T, strict=True))
    return columns, {name: head.group(2) for name, head in zip(names, heads, strict=True) if head and head.group(2)}


def _tdms(path: Path, data: bytes, channels: Sequence[str] | None) -> _Raw:
    """Read TDMS, LabVIEW's format."""
    try:
        from nptdms import TdmsFile  # noqa: PLC0415 - an optional extra
    except ImportError as error:
        raise InputError(
            f"{path} is TDMS, which npTDMS reads, and that is not installed: pip install 'turnwright[formats]', or "
            "export it as CSV"
        ) from error
    columns: dict[str, Floats] = {}
    units: dict[str, str] = {}
    rates: set[float] = set()
    try:
        with TdmsFile.open(io.BytesIO(data)) as file:
            for group in file.groups():
                for channel in group.channels():
                    name = f"{group.name}/{channel.name}"
                    if channels and not {name, channel.name} & set(channels) and channel.name.lower() not in TIMES:
                        continue
                    _require_room(path, len(channel), len(data))
                    values = np.asarray(channel[:])
                    if values.ndim == 1 and values.dtype.kind in REAL:
                        columns[name] = values.astype(np.float64)
                        unit = _first(channel.properties, UNITS)
                        units.update({name: str(unit)} if unit else {})
                        step = channel.properties.get("wf_increment")
                        rates.update({_rate_of(path, None, step)} if step else ())
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path} is TDMS that cannot be read ({type(error).__name__}): copy it again") from error
    return _Raw(columns, units, _only(path, rates))


def _require_room(path: Path, samples: int, room: int) -> None:
    """Raise if a file claims more samples than it has bytes."""
    if samples > room:
        raise InputError(f"{path} claims {samples} samples in {room} bytes: it is damaged, so copy it again")


def _first(attributes: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((attributes[name] for name in names if name in attributes), None)


def _rate_of(path: Path, rate: Any, step: Any) -> float:
    """Return the rate that an attribute says, itself or as a step of time. [Hz]."""
    said = step if rate is None else rate
    try:
        value = float(said)
    except (TypeError, ValueError):
        value = float("nan")
    if not 0 < value < np.inf:
        raise InputError(
            f"{path} says {said} for the {'step' if rate is None else 'rate'} of its samples, it must be a finite "
            "number above 0: correct it, or export the record as CSV with its times"
        )
    return 1 / value if rate is None else value


def _only(path: Path, rates: set[float]) -> float | None:
    if not rates:
        return None
    if max(rates) > min(rates) * (1 + 1e-9):
        raise InputError(f"the channels of {path} have {len(rates)} rates, there must be 1: choose those alike")
    return max(rates)


def _apart(path: Path, channels: Sequence[str] | None) -> _Raw:
    """Read HDF5 in a process of its own, which may die without harm."""
    answer = read_isolated(__name__, path, refusal=InputError, arguments=[json.dumps(list(channels or []))])
    try:
        with np.load(io.BytesIO(answer), allow_pickle=False) as packed:
            said = json.loads(str(packed["said"]))
            columns = {name: packed[f"column{i}"] for i, name in enumerate(said["names"])}
    except (ValueError, KeyError, OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is HDF5 that cannot be read: it is damaged, so copy it again") from error
    return _Raw(columns, said["units"], said["rate_hz"])


def main() -> int:
    """Read the HDF5 file that is named, in the other process, and send its columns out."""
    path, channels = Path(sys.argv[1]), json.loads(sys.argv[2])
    return answer_parent(
        lambda: _packed(_hdf5(path, channels)),
        refusal=InputError,
        damage=(OSError, RuntimeError, KeyError, ValueError, TypeError),
    )


def _packed(raw: _Raw) -> bytes:
    said = json.dumps({"names": list(raw.columns), "units": raw.units, "rate_hz": raw.rate_hz})
    packed = io.BytesIO()
    np.savez(packed, said=np.array(said), **{f"column{i}": one for i, one in enumerate(raw.columns.values())})  # type: ignore[arg-type] # names do not clash with its options
    return packed.getvalue()


def _hdf5(path: Path, channels: Sequence[str]) -> _Raw:
    """Read every dataset that is a row of numbers, or the ones asked for."""
    import h5py  # noqa: PLC0415 - costly to import

    columns: dict[str, Floats] = {}
    units: dict[str, str] = {}
    rates: set[float] = set()

    def take(name: str, item: Any) -> None:
        said = [item.attrs, item.parent.attrs, item.file.attrs]
        if not isinstance(item, h5py.Dataset):
            return
        if item.ndim != 1 or item.dtype.kind not in REAL:
            return
        if channels and not {name, _last(name)} & set(channels) and _last(name).lower() not in TIMES:
            return
        if item.size > LARGEST:
            raise InputError(f"{path} claims {item.size} samples in {name!r}, the limit is {LARGEST}: cut it")
        columns[name] = np.asarray(item[:], dtype=np.float64)
        unit = _first(item.attrs, UNITS)
        if unit is not None:
            units[name] = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
        for one in said:
            rate, step = _first(one, RATES), _first(one, STEPS)
            if rate is not None or step is not None:
                rates.add(_rate_of(path, rate, step))
                break

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return _Raw(columns, units, _only(path, rates))
