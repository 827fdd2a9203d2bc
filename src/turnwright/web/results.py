"""Results of a finished run: map windows, profiles, axis motion and spectra.

Whole maps are read from the files of the run. Finer windows are simulated: one worker process caches the motions of the
last runs, each read from its program. `windows` has the routes.
"""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path as File
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from turnwright._kernels import raster as kernel
from turnwright.errors import InputError
from turnwright.generation import Prepared, Tiles
from turnwright.heightmap import HeightMap
from turnwright.job import Job, predicted_motion
from turnwright.progress import run_chunks
from turnwright.web.binary import pack
from turnwright.web.limits import STORED_PIXEL_RATIO

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright._arrays import Floats
    from turnwright.path import Motion

__all__ = [
    "chips",
    "finishing_pass",
    "list_maps",
    "motion",
    "numbers_of",
    "profile",
    "simulate_window",
    "spectrum",
    "warm",
    "window",
]

TURN = 2 * math.pi

MAX_CACHED_RUNS = 2
"""Runs whose motion is cached."""

MAX_CACHED_POINTS = 20_000_000
"""Points of all cached motions, unless a single one has more: 32 bytes each, twice that while reading."""

MIN_MEAN_WIDTH = 1.2
"""Stored heights per pixel above which a pixel is their mean."""

SPECTRUM_SPANS = 4
"""Spans of two revolutions from which the spectrum of an axis is computed."""


@dataclass(frozen=True, slots=True)
class _Opened:
    """A run with its motion, prepared for simulation."""

    job: Job
    motion: Motion
    ready: Prepared


@dataclass(frozen=True, slots=True)
class _Stored:
    """A stored map of a run."""

    heights: HeightMap
    pixel: float


_opened: OrderedDict[str, _Opened] = OrderedDict()
"""Cache of this process."""

_stored: OrderedDict[tuple[str, str], _Stored] = OrderedDict()


def warm() -> None:
    """Compute a small window, so that its kernels are loaded."""
    from turnwright.machine import Machine  # noqa: PLC0415
    from turnwright.path import Motion as Moved  # noqa: PLC0415
    from turnwright.tool import Tool  # noqa: PLC0415

    c = np.linspace(0, 3 * TURN, 37)
    axes = {"C": c, "X": 0.03 * (1 - c / c[-1]), "Z": np.zeros(c.size)}
    motion = Moved(time=c, axes=axes, machine=Machine.load("generic"))
    ready = Prepared.of(motion, Tool(nose_radius=0.5), None, distances=(0, 0.02), most_rings=4)
    x = np.linspace(-0.01, 0.01, 4)
    ready.fill_grid(x, x)
    rings = HeightMap(z=np.zeros((4, 5)), radius=np.arange(5.0), angle=np.linspace(0.0, 4.0, 4))
    _resample(_Stored(rings, 1.0), x, x)


def _ready(folder: str) -> _Opened:
    if folder in _opened:
        _opened.move_to_end(folder)
        return _opened[folder]
    job, file, name = finishing_pass(folder, "only its stored maps are available")
    motion = predicted_motion(job, file, name)
    radius = job.part.reach
    ready = Prepared.of(motion, job.actual_tool, job.actual_machine, distances=(0.0, radius), most_rings=10_000)
    points = motion.time.size
    while _opened and (
        len(_opened) >= MAX_CACHED_RUNS
        or sum(one.motion.time.size for one in _opened.values()) + points > MAX_CACHED_POINTS
    ):
        _opened.popitem(last=False)
    _opened[folder] = _Opened(job, motion, ready)
    return _opened[folder]


class FinishingPass(NamedTuple):
    """The last pass of a run on disk: its job, main program file and name."""

    job: Job
    file: File
    name: str


def finishing_pass(folder: str, so: str) -> FinishingPass:
    """Return the last pass of a run; ``so`` completes the message if there is none."""
    numbers = numbers_of(folder)
    try:
        file, name = numbers["program"]["files"][0], numbers["passes"][-1]["name"]
    except (KeyError, IndexError) as error:
        raise InputError(f"the run has no program, so {so}") from error
    return FinishingPass(Job.load(File(folder) / "job.toml"), File(folder) / file, name)


def numbers_of(folder: str) -> dict[str, Any]:
    """Return the numbers of a run."""
    try:
        numbers: dict[str, Any] = json.loads((File(folder) / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError("the run has no result yet") from error
    return numbers


def list_maps(folder: str) -> list[dict[str, Any]]:
    """List the stored maps of a run, the whole part first."""
    maps = []
    for entry in numbers_of(folder).get("predictions", []):
        axes = {name: np.load(File(folder) / file) for name, file in entry["axes"].items()}
        spans = {name: [float(axis[0]), float(axis[-1])] for name, axis in axes.items()}
        rough = entry["roughness"]
        maps.append(
            {
                "name": entry["name"], "unit": "mm", "shape": list(entry["shape"]),
                "x": spans.get("x"), "y": spans.get("y"), "radius": spans.get("radius"), "angle": spans.get("angle"),
                "pixel": _pixel(axes), "pv_nm": entry["pv_nm"], "sq_nm": rough["sq_nm"],
                "tracking": entry["tracking"] is not None,
            }
        )  # fmt: skip
    return maps


def _pixel(axes: Mapping[str, Floats]) -> float:
    """Return the column spacing of a map. [mm]."""
    axis = axes.get("radius", axes.get("x"))
    return float(np.diff(axis).mean()) if axis is not None and axis.size > 1 else math.inf


def _map_of(folder: str, name: str) -> _Stored:
    """Return a stored map."""
    if (folder, name) in _stored:
        _stored.move_to_end((folder, name))
        return _stored[folder, name]
    entries = {entry["name"]: entry for entry in numbers_of(folder).get("predictions", [])}
    if name not in entries:
        raise InputError(f"map must be one of {', '.join(entries) or 'none'}, got {name[:60]!r}")
    entry = entries[name]
    axes = {axis: np.load(File(folder) / file) for axis, file in entry["axes"].items()}
    stored = _Stored(HeightMap(z=np.load(File(folder) / entry["file"]), name=name, **axes), _pixel(axes))
    while len(_stored) >= 4 * MAX_CACHED_RUNS:
        _stored.popitem(last=False)
    _stored[folder, name] = stored
    return stored


def window(
    folder: str, name: str, x: tuple[float, float], y: tuple[float, float], shape: tuple[int, int], quantity: str
) -> bytes:
    """Return a window of the error (cut minus nominal) or of the height on a grid of ``shape`` (ny, nx)."""
    stored = _map_of(folder, name)
    columns, rows = np.linspace(*x, shape[1]), np.linspace(*y, shape[0])
    step = min(float(columns[1] - columns[0]), float(rows[1] - rows[0]))
    is_generated = step < STORED_PIXEL_RATIO * stored.pixel or not _covers(stored.heights, x, y)
    if is_generated:
        (error, design), mean_of = simulate_window(folder, columns, rows), 1
    else:
        (error, mean_of), design = _resample(stored, columns, rows), None
    values = error
    if quantity == "height":
        if design is None:
            design = Job.load(File(folder) / "job.toml").part.heights(*np.meshgrid(columns, rows))
        values = error + design
    header = {
        "name": name, "quantity": quantity, "unit": "mm", "x": list(x), "y": list(y),
        "source": "generated" if is_generated else "stored", "mean_of": mean_of, "pixel": step,
        "stored_pixel": stored.pixel, "diverging": quantity == "error", **_spread(values),
    }  # fmt: skip
    return pack(header, {"values": values})


def chips(folder: str, pixels: int) -> bytes:
    """Return the maximum uncut chip thickness of the finishing pass over the part, by nearest sample.

    Points outside the clear aperture have the value of the nearest point on its edge, as in `seen.surface`.
    """
    import h5py  # noqa: PLC0415 - slow import
    from scipy.spatial import cKDTree  # noqa: PLC0415

    finish = numbers_of(folder)["passes"][-1]
    radius = Job.load(File(folder) / "job.toml").part.reach
    try:
        with h5py.File(File(folder) / "run.h5", "r") as archive:
            group = archive.get(f"chips/{finish['name']}")
            samples = group and {name: np.asarray(group[name]) for name in ("x", "y", "inside", "thickness")}
    except OSError as error:
        raise InputError("the archive run.h5 of the run cannot be read: run the job again") from error
    if not samples:
        raise InputError(
            "the run has no chip data: set the stock and the material of the part, see `turnwright material list`, and "
            "run it again"
        )
    inside = samples["inside"].astype(bool)
    thickness = samples["thickness"][inside]
    axis = np.linspace(-radius, radius, pixels)
    x, y = np.meshgrid(axis, axis)
    within = radius / np.maximum(np.hypot(x, y), radius)
    _, nearest = cKDTree(np.stack((samples["x"][inside], samples["y"][inside]), axis=1)).query(
        np.stack((x * within, y * within), axis=-1)
    )
    sentence = (finish["chips"] or {}).get("sentence", "")
    header = {
        "unit": "mm", "label": "uncut chip thickness", "x": [-radius, radius], "y": [-radius, radius], "radius": radius,
        **_spread(thickness), "diverging": False, "points": thickness.size,
        "note": f"computed at {thickness.size} points of the path" + (f"; {sentence}" if sentence else ""),
    }  # fmt: skip
    return pack(header, {"values": thickness[nearest]})


def _spread(values: Floats) -> dict[str, float | None]:
    """Return the range and the colour limits of values."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"low": None, "high": None, "p1": None, "p99": None}
    sample = finite[:: max(1, finite.size // 20_000)]
    low, high = np.percentile(sample, (0.5, 99.5))
    return {"low": float(finite.min()), "high": float(finite.max()), "p1": float(low), "p99": float(high)}


def _covers(heights: HeightMap, x: tuple[float, float], y: tuple[float, float]) -> bool:
    """Whether a stored map covers a window; a map of the whole part does."""
    if heights.x is None or heights.y is None:
        return True
    slack = 1e-9 + 0.5 * float(heights.x[1] - heights.x[0])
    inside = (
        heights.x[0] - slack <= x[0], x[1] <= heights.x[-1] + slack,
        heights.y[0] - slack <= y[0], y[1] <= heights.y[-1] + slack,
    )  # fmt: skip
    return all(inside)


def _resample(stored: _Stored, columns: Floats, rows: Floats) -> tuple[Floats, int]:
    """Resample a stored map; return it with the number of heights averaged per pixel.

    Along the radius of a polar map, a pixel is the mean over two pixel widths, so that cusps are not aliased. In all
    other cases it is the nearest height.
    """
    heights = stored.heights
    if heights.radius is not None and heights.angle is not None:
        width = float(columns[1] - columns[0]) / stored.pixel
        count = 1 if width < MIN_MEAN_WIDTH else round(2 * width)
        out = np.empty((rows.size, columns.size))
        kernel.over_grid(
            columns, rows, heights.z, float(heights.angle[0]), float(heights.radius[0]), stored.pixel,
            count // 2, count - count // 2, out,
        )  # fmt: skip
        return out, count
    assert heights.x is not None  # noqa: S101 - a map that is not polar has x and y
    assert heights.y is not None  # noqa: S101
    across, along = (_nearest(axis, wanted) for axis, wanted in ((heights.x, columns), (heights.y, rows)))
    return np.asarray(heights.z[np.ix_(along, across)]), 1


def _nearest(axis: Floats, wanted: Floats) -> Any:
    middle = (axis[1:] + axis[:-1]) / 2
    return np.searchsorted(middle, wanted)


def simulate_window(folder: str, columns: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Return the simulated error in a window and the nominal height, nan outside the clear aperture. [mm]."""
    opened = _ready(folder)
    x, y = np.meshgrid(columns, rows)
    design = opened.job.part.heights(x, y)
    inside = opened.job.part.covers(x, y)
    if not inside.any():
        return design, design
    away = np.hypot(x[inside], y[inside])
    ready = opened.ready.narrowed((float(away.min()), float(away.max())), int(inside.sum()))
    return ready.fill_grid(columns, rows, inside=inside) - design, design


def profile(folder: str, ends: tuple[float, float, float, float], count: int) -> bytes:
    """Return the simulated error along a straight line."""
    x0, y0, x1, y1 = ends
    opened = _ready(folder)
    part = opened.job.part
    share = np.linspace(0, 1, count)
    x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
    inside = part.covers(x, y)
    error = np.full(count, np.nan)
    if inside.any():
        px, py = x[inside], y[inside]
        away = np.hypot(px, py)
        ready = opened.ready.narrowed((float(away.min()), float(away.max())), px.size)
        out = np.empty(px.size)
        run_chunks(lambda a, b: ready.fill(px, py, Tiles.of_points(px.size), (a, b), out), px.size, 256)
        error[inside] = np.where(out >= 1e299, np.nan, out) - part.surface.sag(px, py)
    length = math.hypot(x1 - x0, y1 - y0)
    header = {"unit": "mm", "length": length, "ends": list(ends), "count": count, **_spread(error)}
    return pack(header, {"distance": share * length, "error": error})


DERIVATIVES = ("speed", "acceleration", "jerk")


def motion(folder: str, points: int) -> bytes:
    """Return the axis motion of the finishing pass: minimum and maximum in each time span.

    Speed, acceleration and jerk are divided differences over 1, 2 and 3 blocks, as in the check of the machine limits.
    Each span has its largest value, so that no peak is lost.
    """
    opened = _ready(folder)
    moved, machine = opened.motion, opened.job.machine
    time = moved.time - moved.time[0]
    borders = np.unique(np.linspace(0, time.size - 1, min(points, time.size) + 1).astype(np.int64))[:-1]
    arrays: dict[str, Floats] = {"time": time[borders], "radius": np.asarray(moved.axes["X"][borders])}
    axes: dict[str, dict[str, Any]] = {}
    for letter, position in moved.axes.items():
        axis = machine.axes.get(letter)
        axes[letter] = {
            "unit": "rad" if letter == "C" else "mm",
            "limits": {kind: getattr(axis, kind, None) for kind in (*DERIVATIVES, "low", "high")},
            "bandwidth_hz": getattr(axis, "bandwidth_hz", None),
            "peaks": {},
        }
        arrays[f"{letter} low"] = np.minimum.reduceat(position, borders)
        arrays[f"{letter} high"] = np.maximum.reduceat(position, borders)
        rate = np.asarray(position)
        for order, kind in enumerate(DERIVATIVES, 1):
            rate = order * np.diff(rate) / (time[order:] - time[:-order])
            at = np.minimum(borders, rate.size - 1)
            arrays[f"{letter} {kind}"] = np.maximum.reduceat(np.abs(rate), at)
            axes[letter]["peaks"][kind] = float(np.abs(rate).max(initial=0.0))
    header = {
        "axes": axes, "points": int(time.size), "duration_s": float(time[-1]), "machine": machine.name,
        "block_rate_hz": machine.block_rate_hz, "pass": numbers_of(folder)["passes"][-1]["name"],
        "limits": numbers_of(folder)["passes"][-1]["limits"],
    }  # fmt: skip
    return pack(header, arrays)


def spectrum(folder: str, letter: str) -> bytes:
    """Return the amplitude spectrum of an axis, and the largest sine amplitude within its limits.

    The spectrum is the maximum over a few spans of two revolutions, each with its linear trend removed and a Hann
    window applied.
    """
    from scipy import fft, interpolate  # noqa: PLC0415 - costly to import

    opened = _ready(folder)
    moved = opened.motion
    if letter not in moved.axes:
        raise InputError(f"axis must be one of {', '.join(moved.axes)}, got {letter[:8]!r}")
    axis = opened.job.machine.axes.get(letter)
    turned = np.abs(moved.axes["C"] - moved.axes["C"][0]) / TURN
    position = np.asarray(moved.axes[letter])
    length = min(2.0, float(turned[-1]))
    spans: list[tuple[Floats, Floats]] = []
    for begin in np.linspace(0, float(turned[-1]) - length, SPECTRUM_SPANS):
        first, last = np.searchsorted(turned, (begin, begin + length))
        first, last = max(int(first) - 1, 0), min(int(last) + 1, turned.size)
        time = moved.time[first:last]
        size = fft.next_fast_len(max(2 * time.size, 64), real=True)
        even = np.linspace(time[0], time[-1], size, endpoint=False)
        values = interpolate.CubicSpline(time, position[first:last])(even)
        values = values - np.polynomial.Polynomial.fit(even, values, 1)(even)
        hann = 0.5 - 0.5 * np.cos(TURN * np.arange(size) / size)
        bins = 2 * np.abs(fft.rfft(values * hann)) / hann.sum()
        spans.append((np.arange(bins.size) / float(time[-1] - time[0]), bins))
    top = min(float(frequency[bins.size // 2]) for frequency, bins in spans)
    base = max(float(frequency[1]) for frequency, _ in spans)
    frequency = np.arange(base, top, base / 2)[:20_000]
    amplitude = np.max([np.interp(frequency, *one) for one in spans], axis=0)
    arrays = {"frequency": frequency, "amplitude": amplitude}
    if axis is not None:
        allowed = axis.amplitude(frequency)
        arrays["allowed"] = np.where(np.isfinite(allowed), allowed, np.nan)
    response = getattr(axis, "response", None)
    header = {
        "axis": letter, "unit": "rad" if letter == "C" else "mm",
        "bandwidth_hz": getattr(axis, "bandwidth_hz", None),
        "resonance_hz": getattr(response, "frequency_hz", None),
        "axes": sorted(moved.axes), "spans": len(spans),
    }  # fmt: skip
    return pack(header, arrays)
