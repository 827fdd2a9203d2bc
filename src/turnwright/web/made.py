"""What is seen of a finished run: its maps at any size, profiles, and how its axes move.

Whole maps come from what the run has stored. A window finer than that is generated for what is looked at: one process
keeps the motions of the last runs ready for it, each read back from its own program. `windows` has the routes.
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
from turnwright.web.limits import FINER
from turnwright.web.packed import pack

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright._arrays import Floats
    from turnwright.path import Motion

__all__ = [
    "chips",
    "finishing_pass",
    "generated",
    "listed",
    "motion",
    "numbers_of",
    "profile",
    "spectrum",
    "warm",
    "window",
]

TURN = 2 * math.pi

KEPT = 2
"""Runs whose motion is kept ready."""

MOST_POINTS = 20_000_000
"""Points of them together, unless one alone has more: 32 bytes each, and as many again while they are read."""

FEW = 1.2
"""Stored heights to a pixel above which it is a mean."""

LOUDEST = 4
"""Spans of two turns in which the spectrum of an axis is looked for, from the first to the last turn."""


@dataclass(frozen=True, slots=True)
class _Opened:
    """A run whose motion is ready."""

    job: Job
    motion: Motion
    ready: Prepared


@dataclass(frozen=True, slots=True)
class _Stored:
    """A map as a run has stored it."""

    name: str
    heights: HeightMap
    pixel: float


_opened: OrderedDict[str, _Opened] = OrderedDict()
"""What this process keeps."""

_stored: OrderedDict[tuple[str, str], _Stored] = OrderedDict()


def warm() -> None:
    """Load what the first window needs."""
    from turnwright.machine import Machine  # noqa: PLC0415
    from turnwright.path import Motion as Moved  # noqa: PLC0415
    from turnwright.tool import Tool  # noqa: PLC0415

    c = np.linspace(0, 3 * TURN, 37)
    axes = {"C": c, "X": 0.03 * (1 - c / c[-1]), "Z": np.zeros(c.size)}
    motion = Moved(time=c, axes=axes, machine=Machine.load("generic"))
    ready = Prepared.of(motion, Tool(nose_radius=0.5), None, distances=(0, 0.02), most_rings=4)
    x = np.linspace(-0.01, 0.01, 4)
    _filled(ready, x, x, np.ones((4, 4), dtype=bool))
    rings = HeightMap(z=np.zeros((4, 5)), radius=np.arange(5.0), angle=np.linspace(0.0, 4.0, 4))
    _resampled(_Stored("", rings, 1.0), x, x)


def open_run(folder: str) -> bool:
    """Make the motion of a run ready; say so."""
    _ready(folder)
    return True


def _ready(folder: str) -> _Opened:
    if folder in _opened:
        _opened.move_to_end(folder)
        return _opened[folder]
    job, file, name = finishing_pass(folder, "no window is finer than its maps: look at those")
    motion = predicted_motion(job, file, name)
    radius = job.part.radius
    ready = Prepared.of(motion, job.actual_tool, job.actual_machine, distances=(0.0, radius), most_rings=10_000)
    points = motion.time.size
    while _opened and (
        len(_opened) >= KEPT or sum(one.motion.time.size for one in _opened.values()) + points > MOST_POINTS
    ):
        _opened.popitem(last=False)
    _opened[folder] = _Opened(job, motion, ready)
    return _opened[folder]


class FinishingPass(NamedTuple):
    """The last pass of a run, on disk.

    Parameters
    ----------
    job
        That the run carried out.
    file
        Its main program.
    name
        Of the pass in it.
    """

    job: Job
    file: File
    name: str


def finishing_pass(folder: str, so: str) -> FinishingPass:
    """Return the last pass of a run; ``so`` says what comes of it that there is none, and what to do."""
    numbers = numbers_of(folder)
    try:
        file, name = numbers["program"]["files"][0], numbers["passes"][-1]["name"]
    except (KeyError, IndexError) as error:
        raise InputError(f"the run has written no program, so {so}") from error
    return FinishingPass(Job.load(File(folder) / "job.toml"), File(folder) / file, name)


def numbers_of(folder: str) -> dict[str, Any]:
    """Return what a run has written of itself."""
    try:
        found: dict[str, Any] = json.loads((File(folder) / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError("the run has no result yet: wait until it is done") from error
    return found


def listed(folder: str) -> list[dict[str, Any]]:
    """Return what maps a run has stored, the whole part first."""
    found = []
    for one in numbers_of(folder).get("predictions", []):
        axes = {name: np.load(File(folder) / file) for name, file in one["axes"].items()}
        spans = {name: [float(axis[0]), float(axis[-1])] for name, axis in axes.items()}
        rough = one["roughness"]
        found.append(
            {
                "name": one["name"], "unit": "mm", "shape": list(one["shape"]),
                "x": spans.get("x"), "y": spans.get("y"), "radius": spans.get("radius"), "angle": spans.get("angle"),
                "pixel": _pixel(axes), "pv_nm": one["pv_nm"], "sq_nm": rough["sq_nm"],
                "tracking": one["tracking"] is not None,
            }
        )  # fmt: skip
    return found


def _pixel(axes: Mapping[str, Floats]) -> float:
    """Return how far apart the columns of a map stand. [mm]."""
    axis = axes.get("radius", axes.get("x"))
    return float(np.diff(axis).mean()) if axis is not None and axis.size > 1 else math.inf


def _map_of(folder: str, name: str) -> _Stored:
    """Return a stored map."""
    if (folder, name) in _stored:
        _stored.move_to_end((folder, name))
        return _stored[folder, name]
    told = {one["name"]: one for one in numbers_of(folder).get("predictions", [])}
    if name not in told:
        raise InputError(f"the run has no map {name[:60]!r}, it has {', '.join(told) or 'none'}: name one of them")
    one = told[name]
    axes = {axis: np.load(File(folder) / file) for axis, file in one["axes"].items()}
    found = _Stored(name, HeightMap(z=np.load(File(folder) / one["file"]), name=name, **axes), _pixel(axes))
    while len(_stored) >= 4 * KEPT:
        _stored.popitem(last=False)
    _stored[folder, name] = found
    return found


def window(
    folder: str, name: str, x: tuple[float, float], y: tuple[float, float], shape: tuple[int, int], quantity: str
) -> bytes:
    """Return a window of the error (cut minus design), or of the height, over a grid of ``shape`` (ny, nx)."""
    stored = _map_of(folder, name)
    columns, rows = np.linspace(*x, shape[1]), np.linspace(*y, shape[0])
    step = min(float(columns[1] - columns[0]), float(rows[1] - rows[0]))
    fine = step < FINER * stored.pixel or not _covers(stored.heights, x, y)
    if fine:
        (error, design), many = generated(folder, columns, rows), 1
    else:
        (error, many), design = _resampled(stored, columns, rows), None
    values = error
    if quantity == "height":
        values = error + (_design(Job.load(File(folder) / "job.toml"), columns, rows) if design is None else design)
    header = {
        "name": name, "quantity": quantity, "unit": "mm", "x": list(x), "y": list(y),
        "source": "generated" if fine else "stored", "mean_of": many, "pixel": step, "stored_pixel": stored.pixel,
        "diverging": quantity == "error", **_spread(values),
    }  # fmt: skip
    return pack(header, {"values": values})


def chips(folder: str, pixels: int) -> bytes:
    """Return the thickest chip of the finishing pass over the part, at each place that of the nearest point looked at.

    Beyond the clear radius a place has the value of the nearest place on the rim, as in `_seen.surface`.
    """
    import h5py  # noqa: PLC0415 - costly, and only chips are read from the archive
    from scipy.spatial import cKDTree  # noqa: PLC0415

    finish = numbers_of(folder)["passes"][-1]
    radius = Job.load(File(folder) / "job.toml").part.radius
    try:
        with h5py.File(File(folder) / "run.h5", "r") as archive:
            group = archive.get(f"chips/{finish['name']}")
            told = group and {name: np.asarray(group[name]) for name in ("x", "y", "inside", "thickness")}
    except OSError as error:
        raise InputError("the archive of the run cannot be read, so its chips are not known: run it again") from error
    if not told:
        raise InputError(
            "the run has found no chips: give the part a stock and a material of `turnwright material list`, then run "
            "it again"
        )
    inside = told["inside"].astype(bool)
    thickness = told["thickness"][inside]
    axis = np.linspace(-radius, radius, pixels)
    x, y = np.meshgrid(axis, axis)
    within = radius / np.maximum(np.hypot(x, y), radius)
    _, nearest = cKDTree(np.stack((told["x"][inside], told["y"][inside]), axis=1)).query(
        np.stack((x * within, y * within), axis=-1)
    )
    sentence = (finish["chips"] or {}).get("sentence", "")
    header = {
        "unit": "mm", "label": "thickest chip", "x": [-radius, radius], "y": [-radius, radius], "radius": radius,
        **_spread(thickness), "diverging": False, "points": thickness.size,
        "note": f"found at {thickness.size} points of the path" + (f"; {sentence}" if sentence else ""),
    }  # fmt: skip
    return pack(header, {"values": thickness[nearest]})


def _spread(values: Floats) -> dict[str, float | None]:
    """Return what a colour bar needs to know."""
    good = values[np.isfinite(values)]
    if not good.size:
        return {"low": None, "high": None, "p1": None, "p99": None}
    few = good[:: max(1, good.size // 20_000)]
    low, high = np.percentile(few, (0.5, 99.5))
    return {"low": float(good.min()), "high": float(good.max()), "p1": float(low), "p99": float(high)}


def _covers(heights: HeightMap, x: tuple[float, float], y: tuple[float, float]) -> bool:
    """Say whether a stored map holds all of a window; one of the whole part does."""
    if heights.x is None or heights.y is None:
        return True
    slack = 1e-9 + 0.5 * float(heights.x[1] - heights.x[0])
    inside = (
        heights.x[0] - slack <= x[0], x[1] <= heights.x[-1] + slack,
        heights.y[0] - slack <= y[0], y[1] <= heights.y[-1] + slack,
    )  # fmt: skip
    return all(inside)


def _resampled(stored: _Stored, columns: Floats, rows: Floats) -> tuple[Floats, int]:
    """Return a stored map over another grid, and how many of its heights each pixel is the mean of.

    Along the radius of a polar map, where the cusps stand, it is the mean over two pixels: single heights would beat
    with them. Everywhere else it is the nearest height; none is invented.
    """
    heights = stored.heights
    if heights.radius is not None and heights.angle is not None:
        wide = float(columns[1] - columns[0]) / stored.pixel
        many = 1 if wide < FEW else round(2 * wide)
        out = np.empty((rows.size, columns.size))
        kernel.over_grid(
            columns, rows, heights.z, float(heights.angle[0]), float(heights.radius[0]), stored.pixel,
            many // 2, many - many // 2, out,
        )  # fmt: skip
        return out, many
    assert heights.x is not None  # noqa: S101 - a map that is not polar has x and y
    assert heights.y is not None  # noqa: S101
    across, along = (_nearest(axis, wanted) for axis, wanted in ((heights.x, columns), (heights.y, rows)))
    return np.asarray(heights.z[np.ix_(along, across)]), 1


def _nearest(axis: Floats, wanted: Floats) -> Any:
    middle = (axis[1:] + axis[:-1]) / 2
    return np.searchsorted(middle, wanted)


def generated(folder: str, columns: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Return the error that the program leaves in a window, and the design there, nan beyond the clear radius."""
    opened = _ready(folder)
    radius = opened.job.part.radius
    x, y = np.meshgrid(columns, rows)
    inside = np.hypot(x, y) <= radius
    design = np.full(inside.shape, np.nan)
    design[inside] = opened.job.part.surface.sag(x[inside], y[inside])
    if not inside.any():
        return design, design
    away = np.hypot(x[inside], y[inside])
    ready = opened.ready.narrowed((float(away.min()), float(away.max())), int(inside.sum()))
    return _filled(ready, columns, rows, inside) - design, design


def _filled(ready: Prepared, columns: Floats, rows: Floats, inside: Any) -> Floats:
    """Return the heights of a grid where it is asked for; whole tiles, so that each has the same to the last bit."""
    steps = tuple(float(np.diff(axis).mean()) for axis in (rows, columns))
    tiles = Tiles.of_grid(inside.shape, ready.sides((steps[0], steps[1])))
    x, y = columns[tiles.order % columns.size], rows[tiles.order // columns.size]
    out = np.full(inside.size, np.inf)
    wanted = np.flatnonzero(np.logical_or.reduceat(inside.ravel()[tiles.order], tiles.offsets[tiles.groups[:-1]]))

    def work(start: int, stop: int) -> None:
        for group in wanted[start:stop].tolist():
            ready.fill(x, y, tiles, (group, group + 1), out)

    run_chunks(work, wanted.size, max(1, min(64, wanted.size // 16)))
    z = np.empty(inside.size)
    z[tiles.order] = out
    z[(z >= 1e299) | ~inside.ravel()] = np.nan  # beside the axis a tip off centre covers nothing
    return z.reshape(inside.shape)


def _design(job: Job, columns: Floats, rows: Floats) -> Floats:
    """Return the design over a grid, nan beyond the clear radius."""
    x, y = np.meshgrid(columns, rows)
    inside = np.hypot(x, y) <= job.part.radius
    z = np.full(inside.shape, np.nan)
    z[inside] = job.part.surface.sag(x[inside], y[inside])
    return z


def profile(folder: str, ends: tuple[float, float, float, float], count: int) -> bytes:
    """Return the error along a straight line, generated at each of its places."""
    x0, y0, x1, y1 = ends
    opened = _ready(folder)
    part = opened.job.part
    share = np.linspace(0, 1, count)
    x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
    inside = np.hypot(x, y) <= part.radius
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


KINDS = ("speed", "acceleration", "jerk")


def motion(folder: str, points: int) -> bytes:
    """Return how the axes of the finishing pass move: lowest and highest in each of some spans of time.

    Speeds, accelerations and jerks are divided differences over 1, 2 and 3 blocks, as the limits of the machine are
    held against; each span shows the largest, so that no peak is lost however few spans there are.
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
            "limits": {kind: getattr(axis, kind, None) for kind in (*KINDS, "low", "high")},
            "bandwidth_hz": getattr(axis, "bandwidth_hz", None),
            "peaks": {},
        }
        arrays[f"{letter} low"] = np.minimum.reduceat(position, borders)
        arrays[f"{letter} high"] = np.maximum.reduceat(position, borders)
        rate = np.asarray(position)
        for order, kind in enumerate(KINDS, 1):
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
    """Return the amplitudes of an axis over frequency, and the largest sine that its limits allow.

    The largest of a few spans of two turns between the first and the last, each without its steady advance, under a
    Hann window.
    """
    from scipy import fft, interpolate  # noqa: PLC0415 - costly to import

    opened = _ready(folder)
    moved = opened.motion
    if letter not in moved.axes:
        raise InputError(f"the motion has no axis {letter[:8]!r}, it has {', '.join(moved.axes)}: name one of them")
    axis = opened.job.machine.axes.get(letter)
    turned = np.abs(moved.axes["C"] - moved.axes["C"][0]) / TURN
    position = np.asarray(moved.axes[letter])
    span = min(2.0, float(turned[-1]))
    found: list[tuple[Floats, Floats]] = []
    for begin in np.linspace(0, float(turned[-1]) - span, LOUDEST):
        first, last = np.searchsorted(turned, (begin, begin + span))
        first, last = max(int(first) - 1, 0), min(int(last) + 1, turned.size)
        time = moved.time[first:last]
        size = fft.next_fast_len(max(2 * time.size, 64), real=True)
        even = np.linspace(time[0], time[-1], size, endpoint=False)
        values = interpolate.CubicSpline(time, position[first:last])(even)
        values = values - np.polynomial.Polynomial.fit(even, values, 1)(even)
        hann = 0.5 - 0.5 * np.cos(TURN * np.arange(size) / size)
        bins = 2 * np.abs(fft.rfft(values * hann)) / hann.sum()
        found.append((np.arange(bins.size) / float(time[-1] - time[0]), bins))
    top = min(float(frequency[bins.size // 2]) for frequency, bins in found)
    base = max(float(frequency[1]) for frequency, _ in found)
    frequency = np.arange(base, top, base / 2)[:20_000]
    amplitude = np.max([np.interp(frequency, *one) for one in found], axis=0)
    arrays = {"frequency": frequency, "amplitude": amplitude}
    if axis is not None:
        allowed = axis.amplitude(frequency)
        arrays["allowed"] = np.where(np.isfinite(allowed), allowed, np.nan)
    response = getattr(axis, "response", None)
    header = {
        "axis": letter, "unit": "rad" if letter == "C" else "mm",
        "bandwidth_hz": getattr(axis, "bandwidth_hz", None),
        "resonance_hz": getattr(response, "frequency_hz", None),
        "axes": sorted(moved.axes), "spans": len(found),
    }  # fmt: skip
    return pack(header, arrays)
