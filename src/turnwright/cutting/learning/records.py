"""Read force records of data loggers: CSV, HDF5 and TDMS.

Channel names, units and sampling rate come from the file. What the file does not state must be given; there are no
default values.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from turnwright._arrays import Floats, rows_of_numbers
from turnwright._io import bytes_of, read_isolated
from turnwright._validate import positive
from turnwright.cutting.learning.signals import ForceRecord, require_unsaturated
from turnwright.errors import InputError

__all__ = ["NEWTONS", "read_forces", "read_table"]

NEWTONS = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "uN": 1e-6, "µN": 1e-6, "μN": 1e-6}
"""Factors of the force units."""

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}

TIMES = frozenset({"time", "t", "zeit"})
"""Names of a time column, in lower case."""

RATES = ("rate_hz", "sample_rate", "sampling_rate", "samplerate")
STEPS = ("wf_increment", "dt")
UNITS = ("unit", "units", "unit_string")
"""Attributes of HDF5 and TDMS for rate, step and unit."""

STEP_TOL = 0.1
"""Largest deviation of a sample time from even spacing, in steps; a missing sample deviates by half a step."""

RANGE_TOL = 1e-6
"""Relative rounding of the range of a channel in print."""

REAL_KINDS = "iuf"
"""NumPy kinds of real numbers."""

MAX_VALUES = 1 << 30

HDF5 = b"\x89HDF\r\n\x1a\n"
TDMS = b"TDSm"


@dataclass(frozen=True, slots=True)
class _Raw:
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
        CSV with a header line such as ``time [s], Fx [N]``; HDF5 with one dataset for each channel; or TDMS. The format
        is detected from the contents.
    channels
        Names of the channels to read, in order; by default all except the time. In HDF5 and TDMS the last part of a
        path is enough if it is unique.
    unit
        Unit of the forces if the file does not state it: N, kN, mN or uN.
    rate_hz
        Sampling rate if the file states neither the rate nor the times. [Hz]
    range_n
        Measuring range of the channels, in both directions; ``None`` if unknown. [N]

    Raises
    ------
    InputError
        If the file cannot be read, lacks a channel, its unit or its rate, holds non-finite values, or a channel is
        saturated.

    Sources
    -------
    TDMS is read by npTDMS; HDF5 by h5py in a separate process, because a damaged file may crash its library.
    """
    path = Path(file)
    data = bytes_of(path, "the force record")
    if data.startswith(HDF5):
        raw = _unpack(path, read_isolated(_read_hdf5, path, data, tuple(channels or ()), refusal=InputError))
    elif data.startswith(TDMS):
        raw = _read_tdms(path, data, channels)
    else:
        raw = _Raw(*read_table(path, data, "sample"), None)
    record = _select_channels(path, raw, channels, unit, rate_hz)
    if range_n is not None:
        limit = positive(range_n, "range_n", "N") * (1 - RANGE_TOL)
        for name, column in zip(record.channels, record.force.T, strict=True):
            require_unsaturated(str(path), name, column, np.flatnonzero(np.abs(column) >= limit), record.rate_hz)
    return record


def _select_channels(
    path: Path, raw: _Raw, channels: Sequence[str] | None, unit: str | None, rate_hz: float | None
) -> ForceRecord:
    times = [name for name in raw.columns if _last(name).lower() in TIMES]
    wanted = (
        [_find_channel(path, raw, name) for name in channels]
        if channels
        else [name for name in raw.columns if name not in times]
    )
    if not wanted:
        raise InputError(f"{path} must hold at least 1 force channel, got 0")
    sizes = {raw.columns[name].size for name in wanted}
    if len(sizes) > 1:
        raise InputError(
            f"the channels of {path} must have equal lengths, got {min(sizes)} to {max(sizes)} samples: choose "
            "channels of one length"
        )
    scale = []
    for name in wanted:
        stated = raw.units.get(name) or unit
        if stated is None:
            raise InputError(f"{path} states no unit for channel {name!r}: state it, such as 'N'")
        if stated not in NEWTONS:
            raise InputError(f"the unit of {name!r} of {path} must be one of {', '.join(NEWTONS)}, got {stated!r}")
        scale.append(NEWTONS[stated])
    count = sizes.pop()
    stated_rate = raw.rate_hz or next(
        (_rate_from_times(path, raw, name) for name in times if raw.columns[name].size == count), None
    )
    rate = stated_rate or rate_hz
    if rate is None:
        raise InputError(f"{path} states neither the sampling rate nor the times: state the rate, such as '10 kHz'")
    force = np.column_stack([raw.columns[name] * factor for name, factor in zip(wanted, scale, strict=True)])
    names = tuple(channels) if channels else tuple(wanted)
    try:
        return ForceRecord(force=force, rate_hz=rate, channels=names, name=path.name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _last(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _find_channel(path: Path, raw: _Raw, wanted: str) -> str:
    if wanted in raw.columns:
        return wanted
    alike = [name for name in raw.columns if _last(name) == wanted]
    if len(alike) != 1:
        listed = ", ".join(list(raw.columns)[:12])
        state = f"{len(alike)} channels" if alike else "no channel"
        raise InputError(f"{path} has {state} {wanted!r}, it has {listed}: give the full name of one of these")
    return alike[0]


def _rate_from_times(path: Path, raw: _Raw, name: str) -> float:
    """Return the sampling rate from a time column. [Hz]."""
    stated = raw.units.get(name, "s")
    if stated not in SECONDS:
        raise InputError(f"the unit of the times of {path} must be s, ms or us, got {stated!r}")
    times = raw.columns[name] * SECONDS[stated]
    step = (times[-1] - times[0]) / (times.size - 1) if times.size > 1 else 0.0
    off = np.abs(times - times[0] - step * np.arange(times.size)).max() if step > 0 else np.inf
    if not off <= STEP_TOL * step:
        raise InputError(
            f"the times of {path} must be evenly spaced to {STEP_TOL:.0%} of a step, got deviations up to {off:.3g} s "
            f"at steps of {step:.3g} s: resample it, or remove the times and state the rate"
        )
    return float(1 / step)


_NAME = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*")
_NUMBER = re.compile(r"[-+.\d][-+.\deE]*|nan|inf")


def read_table(path: Path, data: bytes, row: str) -> tuple[dict[str, Floats], dict[str, str]]:
    """Read CSV text with a header line, and return the columns and their units."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is neither CSV text, HDF5 nor TDMS: export it as one of these") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise InputError(f"{path} must have a header line and a line for each {row}, got {len(lines)} lines")
    mark = next((candidate for candidate in ("\t", ";") if candidate in lines[0]), ",")
    heads = [_NAME.fullmatch(cell) for cell in lines[0].split(mark)]
    names = [head.group(1).strip('"') if head else "" for head in heads]
    if any(not name or _NUMBER.fullmatch(name) for name in names) or len(set(names)) != len(names):
        raise InputError(f"{path} must begin with a unique name for each column, got {lines[0][:60]!r}")
    try:
        table = rows_of_numbers(lines[1:], mark)
    except ValueError as error:
        raise InputError(
            f"{path} is not a table of numbers after its header line ({error}): use decimal points and equally many "
            "numbers in each line"
        ) from error
    if table.shape[1] != len(names):
        raise InputError(
            f"{path} must have a name for each column, got {len(names)} names and {table.shape[1]} columns"
        )
    columns = dict(zip(names, table.T, strict=True))
    return columns, {name: head.group(2) for name, head in zip(names, heads, strict=True) if head and head.group(2)}


def _read_tdms(path: Path, data: bytes, channels: Sequence[str] | None) -> _Raw:
    try:
        from nptdms import TdmsFile  # noqa: PLC0415 - an optional extra
    except ImportError as error:
        raise InputError(
            f"{path} is TDMS, for which npTDMS is not installed: pip install 'turnwright[formats]', or export it as CSV"
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
                    _require_bytes(path, len(channel), len(data))
                    values = np.asarray(channel[:])
                    if values.ndim == 1 and values.dtype.kind in REAL_KINDS:
                        columns[name] = values.astype(np.float64)
                        unit = _first(channel.properties, UNITS)
                        units.update({name: str(unit)} if unit else {})
                        step = channel.properties.get("wf_increment")
                        rates.update({_rate_from_attribute(path, None, step)} if step else ())
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path} is corrupt: TDMS cannot be read ({type(error).__name__})") from error
    return _Raw(columns, units, _common_rate(path, rates))


def _require_bytes(path: Path, samples: int, size: int) -> None:
    if samples > size:
        raise InputError(f"{path} is corrupt: it states {samples} samples and has {size} bytes")


def _first(attributes: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((attributes[name] for name in names if name in attributes), None)


def _rate_from_attribute(path: Path, rate: Any, step: Any) -> float:
    attribute = step if rate is None else rate
    try:
        value = float(attribute)
    except (TypeError, ValueError):
        value = float("nan")
    if not 0 < value < np.inf:
        raise InputError(
            f"the {'step' if rate is None else 'rate'} of the samples of {path} must be a finite number above 0, got "
            f"{attribute}: correct it, or export the record as CSV with its times"
        )
    return 1 / value if rate is None else value


def _common_rate(path: Path, rates: set[float]) -> float | None:
    if not rates:
        return None
    if max(rates) > min(rates) * (1 + 1e-9):
        raise InputError(
            f"the channels of {path} must have 1 sampling rate, got {len(rates)}: choose channels of one rate"
        )
    return max(rates)


def _pack(raw: _Raw) -> bytes:
    header = json.dumps({"names": list(raw.columns), "units": raw.units, "rate_hz": raw.rate_hz})
    packed = io.BytesIO()
    np.savez(packed, header=np.array(header), **{f"column{i}": one for i, one in enumerate(raw.columns.values())})  # type: ignore[arg-type] # names do not clash with its options
    return packed.getvalue()


def _unpack(path: Path, data: bytes) -> _Raw:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as packed:
            header = json.loads(str(packed["header"]))
            columns = {name: packed[f"column{i}"] for i, name in enumerate(header["names"])}
    except (ValueError, KeyError, OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is corrupt: HDF5 cannot be read") from error
    return _Raw(columns, header["units"], header["rate_hz"])


def _read_hdf5(path: Path, data: bytes, channels: Sequence[str]) -> bytes:
    """Read the one-dimensional numeric datasets, all or the requested ones."""
    import h5py  # noqa: PLC0415 - costly to import

    columns: dict[str, Floats] = {}
    units: dict[str, str] = {}
    rates: set[float] = set()

    def take(name: str, item: Any) -> None:
        attribute_sets = [item.attrs, item.parent.attrs, item.file.attrs]
        if not isinstance(item, h5py.Dataset):
            return
        if item.ndim != 1 or item.dtype.kind not in REAL_KINDS:
            return
        if channels and not {name, _last(name)} & set(channels) and _last(name).lower() not in TIMES:
            return
        if item.size > MAX_VALUES:
            raise InputError(f"{name!r} of {path} must have at most {MAX_VALUES} samples, got {item.size}")
        columns[name] = np.asarray(item[:], dtype=np.float64)
        unit = _first(item.attrs, UNITS)
        if unit is not None:
            units[name] = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
        for attributes in attribute_sets:
            rate, step = _first(attributes, RATES), _first(attributes, STEPS)
            if rate is not None or step is not None:
                rates.add(_rate_from_attribute(path, rate, step))
                break

    with h5py.File(io.BytesIO(data), "r") as file:
        file.visititems(take)
    return _pack(_Raw(columns, units, _common_rate(path, rates)))
