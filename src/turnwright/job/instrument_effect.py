"""The design and the predicted cusps of a job as measured by the instrument of its map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from turnwright._arrays import Floats, is_even
from turnwright.heightmap import HeightMap
from turnwright.instrument import Instrument
from turnwright.job.pass_plan import cut_heights, feed_of, motion_of
from turnwright.job.schema import Job
from turnwright.metrology import filter_map
from turnwright.pose import Pose

__all__ = ["TextureComparison", "compare_texture", "measured_design"]

MOST_POINTS = 20_000_000
WINDOW_POINTS = 600_000
FEED_STEPS = 8
MARGIN_LENGTHS = 4
"""Margin of the surface around the map, in pixels or optical resolutions."""

CUTOFF_FEEDS = 5
"""Cutoff of the texture in feeds: the filter removes 3e-8 of the height of cusps."""

CUTOFF_STEPS = 5
"""Least steps of a map per cutoff of the texture."""

MIN_MEASURED_FRACTION = 0.5
NM = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureComparison:
    """The texture in the middle of a map against the predicted one, with and without the instrument.

    Parameters
    ----------
    side
        Size of the window. (along x, along y) [mm]
    cutoff
        Wavelength up to which the heights count as texture. [mm]
    measured_nm, predicted_nm, seen_nm
        Sq as measured, as predicted for the job's tool, and as predicted through the instrument with its noise. [nm]
    """

    side: tuple[float, float]
    cutoff: float
    measured_nm: float
    predicted_nm: float
    seen_nm: float

    @property
    def sentence(self) -> str:
        """The comparison in a sentence."""
        return (
            f"texture below {1e3 * self.cutoff:.3g} um in the middle {self.side[0]:.3g} x {self.side[1]:.3g} mm: Sq "
            f"{self.measured_nm:.3g} nm measured, {self.seen_nm:.3g} nm predicted with the instrument, "
            f"{self.predicted_nm:.3g} nm without it"
        )


def measured_design(job: Job, heights: HeightMap, pose: Pose) -> Floats | None:
    """Return the change of the design by pixel and stylus of the job's instrument. (ny, nx) [mm].

    Optics act on the cusps only: their linear filter holds for heights small against the wavelength. On a form of many
    fringes light from distant points averages out, while the filter would include the slow tails of the image.

    It is 0 where the design has no height, and ``None`` if the job states no instrument, or the map is not evenly
    spaced or needs too fine a grid.
    """
    stated = job.measurement.instrument
    if stated is None or heights.x is None or heights.y is None or heights.scattered or min(heights.z.shape) < 2:
        return None
    instrument = replace(stated, resolution=None, numerical_aperture=None, wavelength=None)
    if instrument.pixel is None and instrument.stylus_radius is None:
        return np.zeros(heights.z.shape)
    grid = _grid(heights.x, heights.y, instrument.max_step, _reach(instrument))
    if grid is None:
        return None
    u, v, _ = pose.apply(*np.meshgrid(grid.x, grid.y), 0.0)
    design = _ideal_reading(job, u, v)
    seen = instrument.see(HeightMap(x=grid.x, y=grid.y, z=design)).z - design
    return np.nan_to_num(seen[grid.rows, grid.columns])


def compare_texture(job: Job, error: HeightMap, pose: Pose) -> TextureComparison | None:
    """Return the texture in the middle of a map of the error against the prediction of the job.

    ``None`` if the job states no instrument or no feed, or the window holds too few heights.
    """
    feed, instrument = feed_of(job), job.measurement.instrument
    if instrument is None or not feed or error.x is None or error.y is None or error.scattered:
        return None
    limit = min(instrument.max_step, feed / FEED_STEPS)
    steps = [float(np.diff(axis).mean()) for axis in (error.y, error.x)]
    # The window has the shape of the map, and as many pixels as the finer grid allows.
    most = math.sqrt(WINDOW_POINTS) * limit
    sizes = [min(axis.size, int(most / step)) for axis, step in zip((error.y, error.x), steps, strict=True)]
    starts = [(axis.size - size) // 2 for axis, size in zip((error.y, error.x), sizes, strict=True)]
    rows, columns = (slice(start, start + size) for start, size in zip(starts, sizes, strict=True))
    window = HeightMap(x=error.x[columns], y=error.y[rows], z=error.z[rows, columns])
    cutoff = max(CUTOFF_FEEDS * feed, CUTOFF_STEPS * max(steps) * (1 + 1e-9))
    if min(size * step for size, step in zip(sizes, steps, strict=True)) < 2 * cutoff:
        return None
    if np.isfinite(window.z).mean() < MIN_MEASURED_FRACTION:
        return None
    grid = _grid(error.x[columns], error.y[rows], limit, _reach(instrument))
    if grid is None:
        return None
    u, v, _ = pose.apply(*np.meshgrid(grid.x, grid.y), 0.0)
    design = _ideal_reading(job, u, v)
    inside = np.isfinite(design) & job.part.covers(u, v)
    made = np.full(u.shape, np.nan)
    made[inside] = cut_heights(motion_of(job), job, u[inside], v[inside])
    surface = np.where(np.isfinite(made), design, np.nan)
    through = (instrument.see(HeightMap(x=grid.x, y=grid.y, z=one)).z for one in (made, surface))
    seen = next(through) - next(through)
    valid = np.isfinite(window.z) & np.isfinite(seen[grid.rows, grid.columns])
    if valid.mean() < MIN_MEASURED_FRACTION:
        return None

    def sq_nm(z: Floats) -> float:
        texture = replace(window, z=np.where(valid, z, np.nan))
        return float(np.nanstd(texture.z - filter_map(texture, cutoff).z)) * NM

    return TextureComparison(
        side=(float(np.ptp(error.x[columns])), float(np.ptp(error.y[rows]))), cutoff=cutoff,
        measured_nm=sq_nm(window.z),
        predicted_nm=sq_nm((made - design)[grid.rows, grid.columns]),
        seen_nm=math.hypot(sq_nm(seen[grid.rows, grid.columns]), instrument.noise * NM),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grid:
    """A finer grid that extends beyond a map, and the points of the map on it."""

    x: Floats
    y: Floats
    rows: slice
    columns: slice


def _reach(instrument: Instrument) -> float:
    return max(MARGIN_LENGTHS * instrument.finest, instrument.stylus_radius or 0.0)


def _grid(x: Floats, y: Floats, limit: float, reach: float) -> _Grid | None:
    """Return a grid with steps up to a limit that contains the points of a map; ``None`` if it has too many points."""
    axes, places = [], []
    if not (is_even(x) and is_even(y)):
        return None
    for axis in (x, y):
        step = float(np.diff(axis).mean())
        parts = max(math.ceil(step / limit - 1e-9), 1)
        margin = math.ceil(reach / step * parts)
        count = (axis.size - 1) * parts + 1
        axes.append(axis[0] + (np.arange(count + 2 * margin) - margin) * (step / parts))
        places.append(slice(margin, margin + count, parts))
    if axes[0].size * axes[1].size > MOST_POINTS:
        return None
    return _Grid(x=axes[0], y=axes[1], rows=places[1], columns=places[0])


def _ideal_reading(job: Job, u: Floats, v: Floats) -> Floats:
    """Return the reading of an ideal instrument on the design: height, or departure from the reference. [mm]."""
    surfaces = [job.part.surface]
    if job.measurement.quantity != "height":
        surfaces.append(job.reference)
    masks = [inside for surface in surfaces if (inside := surface.inside(u, v)) is not None]
    on = np.logical_and.reduce([np.ones(u.shape, dtype=np.bool_), *masks])
    shown = np.full(u.shape, np.nan)
    shown[on] = surfaces[0].sag(u[on], v[on])
    if len(surfaces) > 1:
        shown[on] -= surfaces[1].sag(u[on], v[on])
    return shown
