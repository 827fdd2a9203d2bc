"""What a height map says: its form, and the surface parameters of what remains.

surfalize and the like refuse maps with missing points (their parameters raise, or want the holes filled in), and none
knows a polar grid, so the parameters are computed here; surfalize is the oracle of the tests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.polynomial.legendre import legvander

from turnwright._arrays import Bools, Floats, Ints
from turnwright.errors import InputError
from turnwright.progress import cores

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["Roughness", "remove_form", "roughness"]

Form: TypeAlias = str | int
Notes: TypeAlias = tuple[str, ...]

NM = 1e6
"""Nanometres in a millimetre."""

CORRELATED = 0.2
"""Autocorrelation below which two places count as independent; ISO 25178-3 sets it."""

OVERLAP = 0.1
"""Share of the valid points that must still overlap at a lag for its autocorrelation to count."""

MAX_DEGREE = 10
MAX_STEPS = 50
BLOCK = 1 << 14
"""Points of a map that the form fit takes at a time."""

EQUATOR = 1e-6
"""Squared cosine of the slope at which a fitted sphere is taken to end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Roughness:
    r"""Surface parameters of ISO 25178-2:2021. What cannot be stated is nan, and ``notes`` says why.

    Parameters
    ----------
    sa_nm, sq_nm
        Mean and root-mean-square of the heights left by the form. [nm]
    sz_nm, pv_nm
        Highest minus lowest height: the standard's name and the optician's. [nm]
    ssk, sku
        Skewness and kurtosis of the heights. [1]
    sdq
        Root-mean-square gradient. [1]
    sdr
        Developed area beyond the projected one. [%]
    sal
        Shortest lag at which the autocorrelation has fallen to 0.2. [mm]
    str
        ``sal`` over the longest such lag: 0 for a lay of one direction, 1 for none. [1]
    valid, missing
        Number of heights counted, and of missing ones.
    form
        What was removed first; see `remove_form`.
    notes
        Why a parameter is nan, or only a bound.
    """

    sa_nm: float
    sq_nm: float
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


class _Grid(NamedTuple):
    """A rectangular or polar grid: how long its steps are, and how much area its points and cells stand for."""

    columns: Floats
    rows: Floats
    stretch: Floats  # length of one unit of the row axis, at each column: 1, or the radius
    closed: bool  # the row after the last one is the first
    column_area: Floats  # area for each point per unit of row: its width, or that of its ring
    row_width: Floats
    column_step_area: Floats  # the same between neighbouring columns
    row_step: Floats


def _grid(heights: HeightMap) -> _Grid:
    """Measure the grid of a map."""
    polar = heights.radius is not None
    columns, rows = (heights.radius, heights.angle) if polar else (heights.x, heights.y)
    if columns is None or rows is None:
        raise InputError("a height map lacks an axis: give x and y, or radius and angle")
    for name, axis in zip(("radius", "angle") if polar else ("x", "y"), (columns, rows), strict=True):
        if not (np.diff(axis) > 0).all():
            raise InputError(f"the {name} of the height map does not ascend: sort it and drop repeated values")
    if polar and columns[0] < 0:
        raise InputError(f"the height map has radius {columns[0]:g} mm, the limit is 0 mm: give radii, not diameters")
    # A full turn is one whose gap at the end is no wider than the widest step.
    gap = 2 * np.pi - (rows[-1] - rows[0])
    closed = polar and rows.size > 2 and 1e-9 < gap <= np.diff(rows).max() * (1 + 1e-6)
    row_edges = _edges(np.concatenate([[rows[-1] - 2 * np.pi], rows, [rows[0] + 2 * np.pi]]) if closed else rows)
    if closed:
        row_edges = row_edges[1:-1]
    column_edges = _edges(columns)
    column_area = np.diff(np.maximum(column_edges, 0) ** 2) / 2 if polar else np.diff(column_edges)
    return _Grid(
        columns=columns,
        rows=rows,
        stretch=columns if polar else np.ones_like(columns),
        closed=closed,
        column_area=column_area,
        row_width=np.diff(row_edges),
        column_step_area=np.diff(columns**2) / 2 if polar else np.diff(columns),
        row_step=np.diff(rows, append=rows[0] + 2 * np.pi) if closed else np.diff(rows),
    )


def _edges(axis: Floats) -> Floats:
    """Return the borders of the pixels around the values of an axis; the first and last pixel are whole."""
    if axis.size == 1:
        return np.array([axis[0] - 0.5, axis[0] + 0.5])
    middle = (axis[1:] + axis[:-1]) / 2
    return np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]])


def _mean(values: Floats, rows: Floats, columns: Floats) -> float:
    """Average over what is not nan, each value weighted by its row and its column; nan if there is nothing."""
    missing = np.isnan(values)
    if missing.any():
        weight = rows @ (~missing).astype(np.float64) @ columns
        values = np.where(missing, 0.0, values)
    else:
        weight = rows.sum() * columns.sum()
    return float(rows @ values @ columns / weight) if weight > 0 else float("nan")


def _valid(heights: HeightMap, needed: int, what: str) -> Bools:
    """Return where the map has heights, and raise unless there are ``needed`` of them."""
    if np.isinf(heights.z).any():
        count = int(np.isinf(heights.z).sum())
        raise InputError(f"the height map holds {count} infinite heights, the limit is 0: mark missing points with nan")
    valid = ~np.isnan(heights.z)
    count = int(np.count_nonzero(valid))
    if count < needed:
        raise InputError(f"the height map has {count} valid heights, {what} needs {needed}: measure more of the part")
    return valid


Fit: TypeAlias = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""From parameters (k,), x and y (n,) to the form there (n,) and its derivatives by each parameter (n, k)."""


def remove_form(heights: HeightMap, form: Form) -> HeightMap:
    r"""Return the map without its form, fitted by least squares over the valid points.

    On a polar map every point counts with the area it stands for, :math:`r\,dr\,d\theta`.

    Parameters
    ----------
    heights
        Missing points stay missing.
    form
        ``"none"``; ``"mean"``, a constant; ``"plane"``; a whole number, the total degree of a polynomial in x and y;
        or ``"sphere"``, the sphere of best fit in z, of any position, radius and sense (a plane is one of them).

    Raises
    ------
    InputError
        If the form is unknown, the map has fewer points than the form has parameters, or no sphere fits.

    Sources
    -------
    ISO 25178-3 (association of the form by total least squares is replaced by that in z: optics is specified in sag).

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.linspace(-1, 1, 5)
    >>> bowl = HeightMap(x=x, y=x, z=100 - np.sqrt(100**2 - x**2 - x[:, None] ** 2))
    >>> bool(np.abs(remove_form(bowl, "sphere").z).max() < 1e-12)
    True
    """
    degree = {"mean": 0, "plane": 1}.get(form, form) if isinstance(form, str) else form
    if form == "none":
        return heights
    if degree == "sphere":
        return _remove_sphere(heights)
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise InputError(
            f'form is {form!r}, it can be "none", "mean", "plane", "sphere" or the degree of a polynomial from 0 to '
            f"{MAX_DEGREE}: choose one of them"
        )
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    _valid(heights, len(powers), f"a form of degree {degree}")

    def polynomial(parameters: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        along_x, along_y = legvander(x, degree), legvander(y, degree)
        terms = np.stack([along_x[:, i] * along_y[:, j] for i, j in powers], axis=1)
        return terms @ parameters, terms

    return _subtract(heights, polynomial, _fit(heights, polynomial, len(powers)))


def _scale(heights: HeightMap) -> tuple[float, float, float]:
    """Return the middle of the map (x, y) and the half-width that brings it into [-1, 1]. [mm]."""
    if heights.radius is not None:
        return 0.0, 0.0, float(heights.radius[-1]) or 1.0
    x, y = heights.x, heights.y
    ends = np.array([[x[0], x[-1]], [y[0], y[-1]]])  # type: ignore[index]
    middle = ends.mean(axis=1)
    return float(middle[0]), float(middle[1]), float(np.diff(ends, axis=1).max() / 2) or 1.0


def _blocks(heights: HeightMap) -> Iterator[tuple[slice, Floats, Floats, Floats]]:
    """Walk over a map in groups of rows: the rows, scaled x and y (n,), and the area of each point (n,)."""
    grid = _grid(heights)
    x0, y0, scale = _scale(heights)
    count = max(BLOCK // grid.columns.size, 1)
    for start in range(0, grid.rows.size, count):
        rows = slice(start, start + count)
        if heights.polar:
            angle = grid.rows[rows, None]
            x, y = np.cos(angle) * grid.columns, np.sin(angle) * grid.columns
        else:
            x, y = np.broadcast_arrays(grid.columns, grid.rows[rows, None])
        area = grid.row_width[rows, None] * grid.column_area
        yield rows, ((x - x0) / scale).ravel(), ((y - y0) / scale).ravel(), area.ravel()


def _fit(heights: HeightMap, form: Fit, count: int) -> Floats:
    """Return the ``count`` parameters of least squares in z, by Gauss-Newton from zero.

    The normal equations lose half of the digits, and each further step, also of a linear form, wins them back.
    """
    parameters, last = np.zeros(count), np.inf
    for _ in range(MAX_STEPS):
        normal, right = np.zeros((count, count)), np.zeros(count)
        for rows, x, y, area in _blocks(heights):
            z = heights.z[rows].ravel()
            valid = ~np.isnan(z)
            values, derivatives = form(parameters, x[valid], y[valid])
            weighted = derivatives.T * area[valid]
            normal += weighted @ derivatives
            right += weighted @ (z[valid] - values)
        # Points on one line cannot carry every term; the solution of least norm is as good as any there.
        step = np.linalg.lstsq(normal, right, rcond=1e-13)[0]
        parameters = parameters + step
        size = np.abs(step).max()
        if size <= 1e-11 * np.abs(parameters).max() or size >= last:
            break
        last = size
    return parameters


def _subtract(heights: HeightMap, form: Fit, parameters: Floats) -> HeightMap:
    """Return the map minus the fitted form."""
    z = np.array(heights.z)
    for rows, x, y, _ in _blocks(heights):
        z[rows] -= form(parameters, x, y)[0].reshape(z[rows].shape)
    return replace(heights, z=z)


def _remove_sphere(heights: HeightMap) -> HeightMap:
    """Subtract the sphere of best fit in z.

    The sphere through (0, 0, c) with slopes p, q there is k/2 (x² + y² + t²) + p x + q y - t = 0 with t = z - c: smooth
    in k where the sphere is flat, unlike its centre and radius.
    """
    _valid(heights, 4, "a sphere")
    *_, scale = _scale(heights)

    def sphere(parameters: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        c, p, q, k = parameters / scale
        squares = k / 2 * (x * x + y * y) + p * x + q * y
        root = np.sqrt(np.maximum(1 - 2 * k * squares, EQUATOR))
        t = 2 * squares / (1 + root)
        derivatives = np.stack([np.ones_like(x), x / root, y / root, (x * x + y * y + t * t) / (2 * root)], axis=1)
        return scale * (c + t), derivatives

    parameters = _fit(heights, sphere, 4)
    _, p, q, k = parameters / scale
    # Where the sphere ends, its root is zero; there it was only continued so that the next step could come back.
    reach = max(
        float(
            (2 * k * (k / 2 * (x * x + y * y) + p * x + q * y)).max(where=~np.isnan(heights.z[rows]).ravel(), initial=0)
        )
        for rows, x, y, _ in _blocks(heights)
    )
    if reach >= 1 - EQUATOR:
        raise InputError(
            f"the best sphere has a radius of {scale / abs(k) * np.sqrt(1 + p * p + q * q):g} mm and does not reach "
            f"over the map, whose half-width is {scale:g} mm: remove a polynomial instead"
        )
    return _subtract(heights, sphere, parameters)


def roughness(heights: HeightMap, *, form: Form = "plane") -> Roughness:
    r"""Return the surface parameters of a map after its form is removed. Missing points are honoured everywhere.

    Height parameters are averages over the valid points; on a polar map each counts with its area
    :math:`r\,dr\,d\theta`. With ``form="none"`` the heights count from zero, as they are.

    Gradients are differences of valid neighbours divided by their distance (on a full polar turn the last row meets
    the first): ``sdq`` sums the two directions' mean squares, ``sdr`` averages the two ways to cut each pixel cell
    with four valid corners into triangles (ISO 25178-2:2021, D.15). A sine of n pixels per period so loses a
    share of :math:`\pi^2 / 6 n^2` of its ``sdq``.

    The autocorrelation at a lag is the mean product over the points that overlap, divided by its value at lag 0. It is
    followed by a cubic spline along straight rays (ISO 25178-2:2021, 4.3.1 and 4.3.2) over lags up to half of the field
    at which a tenth of the valid points overlap. Where it does not fall to 0.2 along a ray, the ray counts as far as it
    goes, so ``str`` is an upper bound, and ``notes`` says so. If no ray falls, or the grid is polar or not even (a
    resampled map would have another autocorrelation), ``sal`` and ``str`` are nan.

    Parameters
    ----------
    heights
        Map to judge. 2000 x 2000 points take a few seconds.
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
    _valid(heights, 1, "roughness")
    grid = _grid(heights)
    residual = remove_form(heights, form)
    z = residual.z
    weights = grid.row_width, grid.column_area
    sa = _mean(np.abs(z), *weights)
    square = z * z
    sq = float(np.sqrt(_mean(square, *weights)))
    sz = float(np.nanmax(z) - np.nanmin(z))
    notes: list[str] = []
    if sq > 0:
        ssk = _mean(square * z, *weights) / sq**3
        sku = _mean(square * square, *weights) / sq**4
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


def _gradients(z: Floats, grid: _Grid) -> tuple[float, float]:
    """Return the root-mean-square gradient [1] and the developed area ratio [%]."""
    if z.shape[1] < 2 or z.shape[0] < 2:
        return float("nan"), float("nan")
    around = np.vstack([z, z[:1]]) if grid.closed else z
    across = (np.diff(around, axis=1) / np.diff(grid.columns)) ** 2
    # On the axis of a polar grid all azimuths are one point, so there is no step.
    stretch = np.where(grid.stretch > 0, grid.stretch, np.inf)
    along = (np.diff(around, axis=0) / grid.row_step[:, None] / stretch) ** 2
    sdq = np.sqrt(
        _mean(across[: z.shape[0]], grid.row_width, grid.column_step_area)
        + _mean(along, grid.row_step, grid.column_area)
    )
    excess = np.zeros((grid.row_step.size, z.shape[1] - 1))
    for side in (across[:-1], across[1:]):
        for flank in (along[:, :-1], along[:, 1:]):
            steep = side + flank
            excess += steep / (1 + np.sqrt(1 + steep))  # sqrt(1 + s) - 1 without its cancellation
    return float(sdq), 25 * _mean(excess, grid.row_step, grid.column_step_area)


def _texture(residual: HeightMap, grid: _Grid, sq: float) -> tuple[float, float, Notes]:
    """Return sal [mm], str [1] and why they are what they are."""
    nothing = float("nan"), float("nan")
    steps = [np.diff(axis) for axis in (grid.columns, grid.rows)]
    if residual.polar:
        return *nothing, ("sal and str are nan: a polar grid has no even lags, so take a rectangular patch",)
    if any(step.size < 3 or np.ptp(step) > 1e-6 * step.mean() for step in steps):
        return *nothing, ("sal and str are nan: they need an even grid of at least 4 x 4 points",)
    if sq == 0:
        return *nothing, ("sal and str are nan: the map is perfectly flat",)
    correlation, known = _autocorrelation(residual.z)
    lengths, fallen = _decay(correlation, known, steps[0].mean(), steps[1].mean())
    if not fallen.any():
        note = f"the autocorrelation stays above {CORRELATED} as far as it is known, so map a larger area"
        return *nothing, (f"sal and str are nan: {note}",)
    sal, longest = float(lengths[fallen].min()), float(lengths.max())
    if fallen.all():
        return sal, sal / longest, ()
    note = (
        f"str is an upper bound: the autocorrelation stays above {CORRELATED} along some direction to {longest:.3g} mm"
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
    known = overlap >= max(OVERLAP * np.count_nonzero(valid), 1)
    # What is not known counts as correlated, lest a hole in the map look like an end of the lay.
    return np.where(known, product / product[reach], 1.0), known


def _decay(correlation: Floats, known: Bools, dx: float, dy: float) -> tuple[Floats, Bools]:
    """Follow the autocorrelation along rays over half a turn, to where it falls to `CORRELATED` or is no longer known.

    The rays end half a pixel apart on the border, and are searched every half pixel and then bisected.

    Returns
    -------
    lengths, fallen
        Each ray's length, and whether it ended by falling. Each (n,) [mm]
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
        low = at(rays, step / steps) <= CORRELATED
        share[rays[low]] = step / steps
        fallen[rays[low]] = True
        rays = rays[~low]
        if rays.size == 0:
            break
    ended = np.flatnonzero(fallen).astype(np.int64)
    low_end, high_end = share[ended] - 1 / steps, share[ended].copy()
    for _ in range(40):
        middle = (low_end + high_end) / 2
        below = at(ended, middle) <= CORRELATED
        high_end = np.where(below, middle, high_end)
        low_end = np.where(below, low_end, middle)
    share[ended] = (low_end + high_end) / 2
    return share * np.hypot(ends_x * dx, ends_y * dy), fallen
