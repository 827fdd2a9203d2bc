"""Areal surface texture parameters of a map after removal of its form, with missing points and on polar grids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import Grid, mean, measure, valid_points
from turnwright.progress import cores

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

Notes: TypeAlias = tuple[str, ...]

NM = 1e6

DECAY_THRESHOLD = 0.2
"""Autocorrelation at which Sal and Str are read (ISO 25178-3)."""

MIN_OVERLAP_SHARE = 0.1
"""Share of the valid points that must overlap at a lag for its autocorrelation to count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Roughness:
    r"""Surface parameters of ISO 25178-2:2021. Undefined parameters are nan; ``notes`` gives the reason.

    Parameters
    ----------
    sa_nm, sq_nm
        Arithmetic mean and root mean square height of the residual. [nm]
    sp_nm, sv_nm
        Height of the highest peak and depth of the lowest valley, from zero. [nm]
    sz_nm, pv_nm
        Highest minus lowest height, under its name in the standard and in optics. [nm]
    ssk, sku
        Skewness and kurtosis of the heights. [1]
    sdq
        Root-mean-square gradient. [1]
    sdr
        Developed area beyond the projected one. [%]
    sal
        Shortest lag at which the autocorrelation has fallen to 0.2. [mm]
    str
        ``sal`` over the longest such lag: near 0 for a unidirectional lay, 1 for an isotropic surface. [1]
    valid, missing
        Number of valid and of missing heights.
    form
        Form removed first; see `remove_form`.
    notes
        Why a parameter is nan, or only a bound.
    """

    sa_nm: float
    sq_nm: float
    sp_nm: float
    sv_nm: float
    sz_nm: float
    pv_nm: float
    ssk: float
    sku: float
    sdq: float
    sdr: float
    sal: float
    str: float
    valid: int
    missing: int
    form: Form
    notes: Notes = ()


def roughness(heights: HeightMap, *, form: Form = "plane") -> Roughness:
    r"""Return the surface parameters of a map after its form is removed. Missing points are left out.

    Height parameters are averages over the valid points, weighted by area on a polar map; see `area_rms`. With
    ``form="none"`` the heights are measured from zero.

    Gradients are differences of valid neighbours divided by their distance: ``sdq`` sums the two directions' mean
    squares, ``sdr`` averages the two ways to cut each pixel cell with four valid corners into triangles
    (ISO 25178-2:2021, D.15). A sine of n pixels per period therefore loses a share of :math:`\pi^2 / 6 n^2` of its
    ``sdq``.

    The autocorrelation is interpolated by a cubic spline along straight rays (ISO 25178-2:2021, 4.3.1 and 4.3.2) over
    lags up to half of the field at which a tenth of the valid points overlap. Where it does not fall to 0.2 along a
    ray, the full length of the ray counts, so ``str`` is an upper bound. If it falls along no ray, or the grid is
    polar or uneven, ``sal`` and ``str`` are nan.

    Parameters
    ----------
    heights
        Measured map.
    form
        See `remove_form`.

    Raises
    ------
    InputError
        If the form is unknown or the map has too few valid heights.

    Sources
    -------
    ISO 25178-2:2021. Oracles: closed forms of sine and cusp, surfalize.

    >>> from turnwright.heightmap import HeightMap
    >>> x, y = np.arange(2000) / 1000, np.arange(8) / 1000
    >>> sine = HeightMap(x=x, y=y, z=1e-4 * np.sin(2 * np.pi * x) * np.ones((8, 1)))
    >>> round(roughness(sine, form="mean").sa_nm, 2)   # 2/pi of 100 nm
    63.66
    """
    valid_points(heights, 1, "roughness")
    grid = measure(heights)
    residual = remove_form(heights, form)
    z = residual.z
    weights = grid.row_width, grid.column_area
    sa = mean(np.abs(z), *weights)
    square = z * z
    sq = float(np.sqrt(mean(square, *weights)))
    sp, sv = float(np.nanmax(z)), -float(np.nanmin(z))
    sz = sp + sv
    notes: list[str] = []
    if sq > 0:
        ssk = mean(square * z, *weights) / sq**3
        sku = mean(square * square, *weights) / sq**4
    else:
        ssk = sku = float("nan")
        notes.append("ssk and sku are nan: the map is perfectly flat")
    sdq, sdr = _gradients(z, grid)
    if np.isnan(sdr):
        notes.append("sdq and sdr are nan where no neighbouring points are valid in both directions")
    sal, ratio, reasons = _texture(residual, grid, sq)
    missing = int(np.count_nonzero(np.isnan(z)))
    return Roughness(
        sa_nm=sa * NM,
        sq_nm=sq * NM,
        sp_nm=sp * NM,
        sv_nm=sv * NM,
        sz_nm=sz * NM,
        pv_nm=sz * NM,
        ssk=ssk,
        sku=sku,
        sdq=sdq,
        sdr=sdr,
        sal=sal,
        str=ratio,
        valid=z.size - missing,
        missing=missing,
        form=form,
        notes=(*notes, *reasons),
    )


def _gradients(z: Floats, grid: Grid) -> tuple[float, float]:
    """Return the root-mean-square gradient [1] and the developed area ratio [%]."""
    if z.shape[1] < 2 or z.shape[0] < 2:
        return float("nan"), float("nan")
    around = np.vstack([z, z[:1]]) if grid.closed else z
    across = (np.diff(around, axis=1) / np.diff(grid.columns)) ** 2
    # On the axis of a polar grid all azimuths are one point, so there is no step.
    stretch = np.where(grid.stretch > 0, grid.stretch, np.inf)
    along = (np.diff(around, axis=0) / grid.row_step[:, None] / stretch) ** 2
    sdq = np.sqrt(
        mean(across[: z.shape[0]], grid.row_width, grid.column_step_area) + mean(along, grid.row_step, grid.column_area)
    )
    excess = np.zeros((grid.row_step.size, z.shape[1] - 1))
    for side in (across[:-1], across[1:]):
        for flank in (along[:, :-1], along[:, 1:]):
            steep = side + flank
            excess += steep / (1 + np.sqrt(1 + steep))  # sqrt(1 + s) - 1 without its cancellation
    return float(sdq), 25 * mean(excess, grid.row_step, grid.column_step_area)


def _texture(residual: HeightMap, grid: Grid, sq: float) -> tuple[float, float, Notes]:
    """Return sal [mm], str [1] and the notes about them."""
    nothing = float("nan"), float("nan")
    steps = [np.diff(axis) for axis in (grid.columns, grid.rows)]
    if residual.polar:
        return *nothing, ("Sal and Str cannot be stated: a polar grid has no even lags, so use a rectangular patch",)
    if any(step.size < 3 or np.ptp(step) > 1e-6 * step.mean() for step in steps):
        return *nothing, ("Sal and Str cannot be stated: they need an even grid of at least 4 x 4 points",)
    if sq == 0:
        return *nothing, ("Sal and Str cannot be stated: the map is perfectly flat",)
    correlation, has_overlap = _autocorrelation(residual.z)
    lengths, fallen = _decay(correlation, has_overlap, steps[0].mean(), steps[1].mean())
    if not fallen.any():
        note = f"the autocorrelation stays above {DECAY_THRESHOLD} wherever it is known, so map a larger area"
        return *nothing, (f"Sal and Str cannot be stated: {note}",)
    sal, longest = float(lengths[fallen].min()), float(lengths.max())
    if fallen.all():
        return sal, sal / longest, ()
    note = (
        f"str is an upper bound: the autocorrelation stays above {DECAY_THRESHOLD} to {longest:.3g} mm in one direction"
    )
    return sal, min(sal / longest, 1.0), (note,)


def _autocorrelation(z: Floats) -> tuple[Floats, Bools]:
    """Return the autocorrelation up to lags of half the field, lag 0 in the middle, and where enough points overlap."""
    from scipy import fft  # noqa: PLC0415 - only this needs it

    reach = z.shape[0] // 2, z.shape[1] // 2
    shape = [fft.next_fast_len(size + lag, real=True) for size, lag in zip(z.shape, reach, strict=True)]

    def correlate(values: Floats) -> Floats:
        spectrum = fft.rfft2(values, shape, workers=cores())
        power = fft.irfft2(spectrum.real**2 + spectrum.imag**2, shape, workers=cores())
        folded = np.roll(power, reach, axis=(0, 1))
        return np.asarray(folded[: 2 * reach[0] + 1, : 2 * reach[1] + 1])

    valid = ~np.isnan(z)
    if valid.all():
        lags = [size - np.abs(np.arange(-lag, lag + 1)) for size, lag in zip(z.shape, reach, strict=True)]
        overlap = np.multiply.outer(*lags).astype(np.float64)
    else:
        overlap = np.rint(correlate(valid.astype(np.float64)))
    product = correlate(np.where(valid, z - np.nanmean(z), 0.0)) / np.maximum(overlap, 1)
    has_overlap = overlap >= max(MIN_OVERLAP_SHARE * np.count_nonzero(valid), 1)
    # Unknown values count as correlated, so that a hole does not look like the end of the lay.
    return np.where(has_overlap, product / product[reach], 1.0), has_overlap


def _decay(correlation: Floats, known: Bools, dx: float, dy: float) -> tuple[Floats, Bools]:
    """Return how far the autocorrelation stays above `DECAY_THRESHOLD` along rays, and whether it falls. (n,) [mm].

    The rays end half a pixel apart on the border. Each is searched every half pixel and then bisected.
    """
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    reach_y, reach_x = np.array(correlation.shape) // 2
    spline = ndimage.spline_filter(correlation, order=3, mode="nearest")
    half_x, half_y = np.arange(-reach_x, reach_x, 0.5), np.arange(-reach_y, reach_y, 0.5)
    ends_y = np.concatenate([np.full_like(half_x, reach_y), half_y])
    ends_x = np.concatenate([half_x, np.full_like(half_y, reach_x)])

    def at(rays: Ints, share: Floats | float) -> Floats:
        places = np.stack([reach_y + ends_y[rays] * share, reach_x + ends_x[rays] * share])
        return np.asarray(ndimage.map_coordinates(spline, places, order=3, mode="nearest", prefilter=False))

    steps = 2 * int(max(reach_x, reach_y))
    share = np.ones(ends_x.size)
    fallen = np.zeros(ends_x.size, dtype=bool)
    rays = np.arange(ends_x.size, dtype=np.int64)
    for step in range(1, steps + 1):
        row = np.rint(reach_y + ends_y[rays] * (step / steps)).astype(np.intp)
        column = np.rint(reach_x + ends_x[rays] * (step / steps)).astype(np.intp)
        lost = ~known[row, column]
        share[rays[lost]] = (step - 1) / steps
        rays = rays[~lost]
        low = at(rays, step / steps) <= DECAY_THRESHOLD
        share[rays[low]] = step / steps
        fallen[rays[low]] = True
        rays = rays[~low]
        if rays.size == 0:
            break
    ended = np.flatnonzero(fallen).astype(np.int64)
    low_end, high_end = share[ended] - 1 / steps, share[ended].copy()
    for _ in range(40):
        middle = (low_end + high_end) / 2
        below = at(ended, middle) <= DECAY_THRESHOLD
        high_end = np.where(below, middle, high_end)
        low_end = np.where(below, low_end, middle)
    share[ended] = (low_end + high_end) / 2
    return share * np.hypot(ends_x * dx, ends_y * dy), fallen
