"""Data of a measured part for the page: numbers in one file, maps as gridded pictures."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright._io import write_json
from turnwright.errors import InputError
from turnwright.files import read_map
from turnwright.metrology import area_psd, level, overview
from turnwright.web.binary import pack
from turnwright.web.jobs import require

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.diagnosis import Diagnosis
    from turnwright.job import Correction, Measured

__all__ = ["lone_map", "map_picture", "picture", "write_page_data", "write_predicted"]

MAX_PIXELS = 600
"""Longest side of a map that is shown without a job."""

COLOUR_PERCENTILES = (0.5, 99.5)
"""Percentiles of the heights that limit the colours, so that outliers do not take the whole range."""

FIELDS = (
    "name", "error_source", "value", "unit", "plausible", "standard_uncertainty", "interval", "rms_nm", "pv_nm",
    "determined", "verdict", "explanation", "repeatable", "correlated_with",
)  # fmt: skip
LENSLET = (
    "number", "design", "centre", "centre_std", "height", "height_std", "radius", "radius_error", "radius_std", "tilt",
    "sq_nm", "pv_nm", "finding",
)  # fmt: skip


def write_page_data(measured: Measured, diagnosis: Diagnosis, out: Path) -> None:
    """Write ``shown.json``, the data of a measured part for the page, to an existing folder."""
    registration, terms, lenses = measured.registration, measured.zernike, measured.lenslets
    zernike = [] if terms is None else zip(terms.indices, terms.coefficients, terms.uncertainty, strict=True)
    numbers = {
        "name": measured.heights.name,
        "form_pv_nm": measured.form_pv_nm,
        "form_rms_nm": measured.form_rms_nm,
        "outliers": measured.outliers,
        "alignment": {
            "pose": registration.pose,
            "pivot": registration.pivot,
            "std": registration.std,
            "held": registration.held,
            "count": registration.count,
            "rms_nm": registration.rms_nm,
            "sentences": (registration.sentences[0], *measured.open_questions),
        },
        "roughness": measured.roughness,
        "zernike": [
            {"index": int(index), "coefficient_nm": float(size) * 1e6, "uncertainty_nm": float(uncertainty) * 1e6}
            for index, size, uncertainty in zernike
        ],
        "psd": _psd(measured),
        "lenslets": [] if lenses is None else [{name: getattr(one, name) for name in LENSLET} for one in lenses],
        "findings": [
            {
                **{name: getattr(one, name) for name in FIELDS},
                "uncertainty": one.interval[1] - one.value,
                "sentence": one.explanation,
                "correctable": one.verdict == "correct",
                "chosen": one.verdict == "correct",
            }
            for one in diagnosis
        ],
        "contributions": [
            {name: getattr(one, name) for name in ("name", "rms_nm", "uncertainty_nm", "common_nm", "explanation")}
            for one in diagnosis.contributions
        ],
        "measured_rms_nm": diagnosis.measured_rms_nm,
        "explained_rms_nm": diagnosis.explained_rms_nm,
        "unexplained_rms_nm": diagnosis.unexplained_rms_nm,
    }
    write_json(out / "shown.json", numbers)


def _psd(measured: Measured) -> dict[str, Any] | None:
    """Return the spectrum of the form error; ``None`` unless the map is on a grid."""
    with suppress(InputError):
        grid = measured.registration.error
        if grid.scattered or grid.x is None:
            return None
        radial = area_psd(grid).radial()
        return {"frequency": radial.frequency, "density": radial.density, "unit": radial.unit, "frequency_unit": "1/mm"}
    return None


def write_predicted(better: Correction, out: Path) -> None:
    """Write the predicted residual of a correction and the tolerances it misses, for the page."""
    sizes = {name: {"pv_nm": pv, "rms_nm": rms} for name, (pv, rms) in better.numbers_nm.items()}
    missed = [one.sentence for one in better.verdicts if one.is_kept is False]
    summary = sizes | {"missed": missed, "sentences": better.sentences}
    write_json(out / "shown.json", summary)


def map_picture(file: str, data: dict[str, Any], folder: str, nx: int, ny: int) -> bytes:
    """Return `picture` of a map of a job's part."""
    return picture(file, require(data, folder).part.reach, nx, ny)


def lone_map(file: str, name: str) -> bytes:
    """Return a measured map as a packed picture, with the facts that `turnwright show` prints.

    An error message names the file by its original ``name``.
    """
    try:
        heights = read_map(file)
        rows = overview(heights)
        flat = level(heights) if np.isfinite(heights.z).any() else heights
    except InputError as error:
        raise InputError(str(error).replace(file, name)) from None
    if flat.x is None or flat.y is None or flat.scattered:
        x, y = (axis.ravel() for axis in flat.points())
        middle = [float(axis.min() + axis.max()) / 2 for axis in (x, y)]
        half_width = max(float(np.ptp(axis)) for axis in (x, y)) / 2 or 1.0
        values = _means(x - middle[0], y - middle[1], flat.z.ravel(), np.sqrt(2) * half_width, MAX_PIXELS, MAX_PIXELS)
        half_width *= float(np.sqrt(2))
        ends = [[at - half_width, at + half_width] for at in middle]
    else:
        stride = -(-max(flat.z.shape) // MAX_PIXELS)
        values = flat.z[::stride, ::stride]
        ends = [[float(axis[::stride][0]), float(axis[::stride][-1])] for axis in (flat.x, flat.y)]
        ends = [[low, high] if high > low else [low - 0.5, low + 0.5] for low, high in ends]
    return _pack_map(values, ends, heights.z, name=name, rows=rows)


def _pack_map(values: Floats, ends: list[list[float]], z: Floats, **more: Any) -> bytes:
    """Pack a map in mm as a picture in nm, with its ends along x and y."""
    values = values * 1e6
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, COLOUR_PERCENTILES) if finite.size else (0.0, 0.0)
    header = {
        "unit": "nm", "x": ends[0], "y": ends[1], "low": float(low), "high": float(high), "diverging": True,
        "points": int(np.isfinite(z).sum()), **more,
    }  # fmt: skip
    return pack(header, {"values": values})


def picture(file: str, radius: float, nx: int, ny: int) -> bytes:
    """Return a map of errors over the whole part as a packed picture of ``nx`` by ``ny`` pixels.

    Each is the mean of its points, or of neighbouring pixels if it has none.
    """
    heights = read_map(file)
    x, y = heights.points()
    values = _means(x.ravel(), y.ravel(), heights.z.ravel(), radius, nx, ny)
    return _pack_map(values, [[-radius, radius]] * 2, heights.z, radius=radius)


def _means(x: Floats, y: Floats, z: Floats, radius: float, nx: int, ny: int) -> Floats:
    """Return the mean height in each pixel. (ny, nx) [mm]."""
    is_used = np.isfinite(z) & (np.hypot(x, y) <= radius * (1 + 1e-9))
    x, y, z = x[is_used], y[is_used], z[is_used]
    column = np.clip(np.rint((x + radius) / (2 * radius) * (nx - 1)), 0, nx - 1).astype(np.int64)
    row = np.clip(np.rint((y + radius) / (2 * radius) * (ny - 1)), 0, ny - 1).astype(np.int64)
    at = row * nx + column
    count: Floats = np.bincount(at, minlength=nx * ny).astype(np.float64).reshape(ny, nx)
    total: Floats = np.bincount(at, weights=z, minlength=nx * ny).astype(np.float64).reshape(ny, nx)
    if z.size:
        # Empty pixels between scattered points are filled from neighbours up to two pixels away.
        for _ in range(2):
            empty = count == 0
            around_count, around_total = _neighbours(count), _neighbours(total)
            total, count = np.where(empty, around_total, total), np.where(empty, around_count, count)
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def _neighbours(values: Floats) -> Floats:
    """Return the sum over the eight neighbours of each pixel."""
    wide = np.pad(values, 1)
    rows = wide[:-2] + wide[1:-1] + wide[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:] - values)
