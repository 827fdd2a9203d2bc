"""Areal surface texture parameters of a map after removal of its form, with missing points and on polar grids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from turnwright._arrays import Floats
from turnwright.metrology.autocorrelation import DECAY_THRESHOLD, autocorrelation, decay
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import Grid, mean, measure, valid_points

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

Notes: TypeAlias = tuple[str, ...]

NM = 1e6


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
    correlation, has_overlap = autocorrelation(residual.z)
    lengths, fallen = decay(correlation, has_overlap, steps[0].mean(), steps[1].mean())
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
