"""Outlier removal, edge trimming, clear aperture and hole filling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from turnwright._arrays import STEP_TOL, Bools, Floats, Ints, is_even, robust_scatter
from turnwright._kernels.neighbours import prominent, second_differences, stand_out
from turnwright._validate import one_of, positive
from turnwright.errors import InputError
from turnwright.metrology.grid import even_rectangle, measure, valid_points
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.surface import Surface

Rule: TypeAlias = Literal["robust", "kong"]

DEFAULT_THRESHOLD_SIGMA: dict[str, float] = {"robust": 5.0, "kong": 3.0}
"""Default threshold of each rule, in standard deviations."""

MIN_NOISE_MM = 1e-9
"""Lower bound of the noise: 1 pm, below the resolution of any instrument."""

CHUNK_POINTS = 1 << 16
"""Points that a thread processes at a time."""

EIGHT_NEIGHBOURS = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutlierRemoval:
    """A map without outliers, and the outliers. See `remove_outliers`.

    Parameters
    ----------
    heights
        The map, nan at the outliers.
    outliers
        True at the outliers. The shape of the map.
    scale
        Standard deviation of the noise; for ``"kong"`` that of the second differences, across and along. [mm]
    threshold
        Threshold of an outlier in standard deviations. [1]
    unjudged
        Number of valid points with too few neighbours to be tested. They stay in the map.
    """

    heights: HeightMap
    outliers: Bools
    scale: tuple[float, ...]
    threshold: float
    unjudged: int

    @property
    def count(self) -> int:
        """Number of outliers."""
        return int(np.count_nonzero(self.outliers))

    @property
    def places(self) -> Floats:
        """Positions of the outliers, x and y. (count, 2) [mm]."""
        x, y = self.heights.points()
        return np.stack([x[self.outliers], y[self.outliers]], axis=-1)


def remove_outliers(
    heights: HeightMap,
    *,
    rule: Rule = "robust",
    threshold: float | None = None,
    design: Surface | None = None,
) -> OutlierRemoval:
    r"""Remove outliers: single points and small groups that stand out from their neighbours.

    ``"robust"`` takes the least deviation of a point from the mean of its two neighbours along the row, the column and
    both diagonals (on a polar grid along the first two), so that scratches, ridges and straight edges stay; at borders
    and holes, from the line through the next two points on one side. A deviation that the median of 5 x 5 neighbours
    shares is form. The largest of touching outliers is removed first, and its neighbours are tested again without it.

    ``"kong"`` is the published rule: a point is an outlier if its second difference along the row or the column is more
    than 3 standard deviations from the mean.

    Both rules mistake edges of lenses and steps for outliers. With ``design`` they test the residual and compare points
    of the same smooth piece only.

    Parameters
    ----------
    heights
        On a rectangular or polar grid; uneven steps need a flat form.
    rule
        ``"robust"`` or ``"kong"``.
    threshold
        Standard deviations beyond which a point is an outlier, by default 5 (robust) and 3 (Kong). [1]
    design
        Nominal surface in the frame of the map.

    Raises
    ------
    InputError
        If the rule is unknown, the threshold is not positive, or the points are scattered.
    DomainError
        If the design is not defined at a point of the map.

    Sources
    -------
    [Kong2019]_ removes noise by second differences and three standard deviations.

    >>> from turnwright.heightmap import HeightMap
    >>> z = np.random.default_rng(1).normal(0, 2e-5, (50, 60))
    >>> z[20, 30] += 1e-3
    >>> found = remove_outliers(HeightMap(x=np.arange(60.0), y=np.arange(50.0), z=z))
    >>> found.places.tolist()
    [[30.0, 20.0]]
    """
    one_of(rule, "the rule", DEFAULT_THRESHOLD_SIGMA)
    threshold = (
        DEFAULT_THRESHOLD_SIGMA[rule] if threshold is None else positive(threshold, "the threshold", "deviations")
    )
    valid = valid_points(heights, 3, "outlier removal")
    grid = measure(heights)
    z, piece = np.array(heights.z), np.zeros(heights.z.shape, dtype=np.int64)
    if design is not None:
        z = np.array(heights.minus(design).z)
        x, y = heights.points()
        pieces = design.piece(x[valid], y[valid])
        if pieces is not None:
            piece[~valid], piece[valid] = -1, pieces
    if rule == "kong":
        outliers, scale, open_points = _kong(z, piece, threshold)
    else:
        outliers, scale, open_points = _robust(z, piece, threshold, closed=grid.closed, ways=2 if heights.polar else 4)
    outliers.flags.writeable = False
    return OutlierRemoval(
        heights=replace(heights, z=np.where(outliers, np.nan, heights.z)),
        outliers=outliers,
        scale=scale,
        threshold=threshold,
        unjudged=int(np.count_nonzero(valid & open_points)),
    )


def _differences(z: Floats) -> tuple[Floats, Floats]:
    """Return the second differences across and along, nan where a neighbour is missing."""
    across, along = np.empty_like(z), np.empty_like(z)
    rows = max(CHUNK_POINTS // z.shape[1], 1)
    run_chunks(lambda start, stop: second_differences(z, start, stop, across, along), z.shape[0], rows)
    return across, along


def _kong(z: Floats, piece: Ints, threshold: float) -> tuple[Bools, tuple[float, ...], Bools]:
    """Return the outliers by mean and standard deviation, the deviations, and the points not tested."""
    outliers, judged = np.zeros(z.shape, dtype=bool), np.zeros(z.shape, dtype=bool)
    scales = []
    for axis, values in zip((1, 0), _differences(z), strict=True):
        mixed = np.diff(piece, axis=axis) != 0
        pad = [(0, 0), (0, 0)]
        for side in ((1, 0), (0, 1)):
            pad[axis] = side
            values[np.pad(mixed, pad)] = np.nan
        valid = ~np.isnan(values)
        judged |= valid
        if valid.any():
            mean, deviation = float(values[valid].mean()), float(values[valid].std())
            scales.append(deviation)
            outliers |= np.abs(values - mean) > max(threshold * deviation, MIN_NOISE_MM)
    return outliers, tuple(scales), ~judged


def _robust(
    z: Floats, piece: Ints, threshold: float, *, closed: bool, ways: int
) -> tuple[Bools, tuple[float, ...], Bools]:
    """Return the outliers, the noise and the points not tested; removes the outliers from ``z``."""
    spread = [d - np.median(d) for values in _differences(z) if (d := values[~np.isnan(values)]).size]
    scale = max(robust_scatter(np.concatenate([[], *spread])) / 6**0.5, MIN_NOISE_MM)
    least = 2 if min(z.shape) > 1 else 1
    amount = np.full(z.shape, np.nan)
    outliers = np.zeros(z.shape, dtype=bool)
    index = np.flatnonzero(~np.isnan(z))
    while index.size:

        def judge(start: int, stop: int, index: Ints = index) -> None:
            stand_out(z, piece, closed, ways, least, index[start:stop], amount)

        run_chunks(judge, index.size, CHUNK_POINTS)
        high = np.flatnonzero(np.abs(amount) > threshold * scale)
        chosen = np.zeros(high.size, dtype=bool)
        prominent(amount, closed, threshold * scale, high, chosen)
        gone = high[chosen]
        outliers.flat[gone] = True
        z.flat[gone] = amount.flat[gone] = np.nan
        index = _neighbours(gone, z, closed=closed)
    alone = np.isnan(amount) & ~np.isnan(z)
    lost = alone & _isolated_points(z, outliers, closed=closed)
    return outliers | lost, (scale,), alone & ~lost


def _neighbours(places: Ints, z: Floats, *, closed: bool) -> Ints:
    """Return the flat indices of the valid points within two steps of some points."""
    m, n = z.shape
    offsets = np.arange(-2, 3)
    rows = (places // n)[:, None, None] + offsets[:, None]
    columns = (places % n)[:, None, None] + offsets
    rows, columns = np.broadcast_arrays(rows % m if closed else rows, columns)
    inside = (rows >= 0) & (rows < m) & (columns >= 0) & (columns < n)
    cells = np.unique(rows[inside] * n + columns[inside])
    return cells[~np.isnan(z.flat[cells])]


def _isolated_points(z: Floats, outliers: Bools, *, closed: bool) -> Bools:
    """Return the points without valid neighbours and next to an outlier: the middle of a broad outlier."""
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    ring = EIGHT_NEIGHBOURS.copy()
    ring[1, 1] = False
    mode: Literal["wrap", "constant"] = "wrap" if closed else "constant"
    padded = [np.pad(mask, ((1, 1), (0, 0)), mode=mode) for mask in (~np.isnan(z), outliers)]
    near, touched = (ndimage.binary_dilation(mask, ring)[1:-1] for mask in padded)
    return touched & ~near


def trim_edge(heights: HeightMap, width: float) -> HeightMap:
    """Return the map without the points within ``width`` of its edge: of missing points connected to the outside.

    Parameters
    ----------
    heights
        On a rectangular or polar grid.
    width
        Distance from the edge within which points are removed. [mm]

    Raises
    ------
    InputError
        If the width is not positive or no point would remain.

    >>> from turnwright.heightmap import HeightMap
    >>> whole = HeightMap(x=np.arange(5.0), y=np.arange(5.0), z=np.zeros((5, 5)))
    >>> int(np.isfinite(trim_edge(whole, 1.5).z).sum())
    9
    """
    positive(width, "the width to trim", "mm")
    valid = valid_points(heights, 1, "trimming")
    missing = np.pad(~valid, 1, constant_values=True)
    near = _distance(heights, _outside(missing, closed=measure(heights).closed)) <= width
    if not (valid & ~near).any():
        raise InputError(f"trimming {width:g} mm leaves no point of the map {heights.name!r}: trim less")
    return replace(heights, z=np.where(near, np.nan, heights.z))


def _outside(missing: Bools, *, closed: bool) -> Bools:
    """Return the missing points connected to the frame around the map; a closed grid has no frame at its seam."""
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    if closed:
        missing = missing.copy()
        missing[0], missing[-1] = missing[-2], missing[1]
    label = ndimage.label(missing, EIGHT_NEIGHBOURS)[0]
    frame = [label[:, 0], label[:, -1]] if closed else [label[:, 0], label[:, -1], label[0], label[-1]]
    out = set(np.concatenate(frame).tolist()) - {0}
    while closed:
        # The same rows are at both ends, with different labels.
        same = {*zip(label[0], label[-2], strict=True), *zip(label[1], label[-1], strict=True)}
        more = {int(one) for pair in same if out & set(pair) for one in pair} - {0} - out
        if not more:
            break
        out |= more
    return np.isin(label, list(out))


def _distance(heights: HeightMap, targets: Bools) -> Floats:
    """Return the distance of every point from the nearest target, of which a frame surrounds the map. [mm]."""
    from scipy import ndimage  # noqa: PLC0415 - only this needs it
    from scipy.spatial import cKDTree  # noqa: PLC0415

    grid = measure(heights)
    axes = [_extend_axis(axis) for axis in (grid.columns, grid.rows)]
    steps = [np.diff(axis) for axis in axes]
    if not heights.polar and all(is_even(axis) for axis in axes):
        sampling = float(steps[1].mean()), float(steps[0].mean())
        return np.asarray(ndimage.distance_transform_edt(~targets, sampling=sampling))[1:-1, 1:-1]
    if grid.closed:
        targets[0], targets[-1] = targets[-2], targets[1]
    # Only targets at the border of the set can be the nearest.
    rim = targets & ndimage.binary_dilation(~targets, EIGHT_NEIGHBOURS)
    if grid.closed:
        rim[[0, -1]] = False
    columns, rows = np.broadcast_arrays(axes[0], axes[1][:, None])
    if heights.polar:
        rim &= columns > 0
        columns, rows = columns * np.cos(rows), columns * np.sin(rows)
    points = np.stack([columns, rows], axis=-1)
    distances = np.asarray(cKDTree(points[rim]).query(points[1:-1, 1:-1].reshape(-1, 2), workers=-1)[0])
    return np.where(targets[1:-1, 1:-1], 0.0, distances.reshape(heights.z.shape))


def _extend_axis(axis: Floats) -> Floats:
    """Return an axis extended by one step at either end."""
    if axis.size == 1:
        return np.array([axis[0] - 1, axis[0], axis[0] + 1])
    return np.concatenate([[2 * axis[0] - axis[1]], axis, [2 * axis[-1] - axis[-2]]])


def crop_to_aperture(heights: HeightMap, radius: float) -> HeightMap:
    """Return the map within a round clear aperture about the origin.

    Parameters
    ----------
    heights
        On any grid, or scattered.
    radius
        Semi-diameter of the aperture. [mm]

    Raises
    ------
    InputError
        If the radius is not positive, or no valid height lies inside.

    >>> from turnwright.heightmap import HeightMap
    >>> whole = HeightMap(x=np.arange(-2.0, 3.0), y=np.arange(-2.0, 3.0), z=np.zeros((5, 5)))
    >>> int(np.isfinite(crop_to_aperture(whole, 1.1).z).sum())
    5
    """
    heights.require_calibrated()
    positive(radius, "the radius of the aperture", "mm")
    x, y = heights.points()
    z = np.where(np.hypot(x, y) <= radius, heights.z, np.nan)
    if np.isnan(z).all():
        raise InputError(f"no valid height lies within {radius:g} mm of the origin: move the map into the part's frame")
    return replace(heights, z=z)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Filled:
    """A map with filled holes. See `fill_holes`.

    Parameters
    ----------
    heights
        The map.
    filled
        True at the filled heights, which were not measured. The shape of the map.
    holes
        Number of filled holes.
    unfilled
        Number of holes not filled, because they are larger.
    """

    heights: HeightMap
    filled: Bools
    holes: int
    unfilled: int


def fill_holes(heights: HeightMap, largest: float) -> Filled:
    """Fill the holes inside a map with a thin plate of least bending energy.

    The plate is the biharmonic surface through the two rings of points around a hole; it reproduces polynomials of
    degree 3 exactly. Missing points connected to the outside stay missing. Filled heights are not measured: fill only
    for evaluations that need complete maps.

    Parameters
    ----------
    heights
        On an even rectangular grid.
    largest
        Extent along x and along y of the largest hole to fill. [mm]

    Raises
    ------
    InputError
        If the map is not on an even rectangular grid, or ``largest`` is not positive.

    Sources
    -------
    Thin plates: discrete biharmonic equation of thirteen points. Oracle: cubics.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.arange(9.0)
    >>> z = np.add.outer(x, x**2)
    >>> z[4, 4] = np.nan
    >>> float(round(fill_holes(HeightMap(x=x, y=x, z=z), largest=1.0).heights.z[4, 4], 9))
    20.0
    """
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    positive(largest, "the largest hole to fill", "mm")
    valid = valid_points(heights, 1, "filling holes")
    dx, dy = even_rectangle(heights, "filling holes", 3)
    missing = np.pad(~valid, 1, constant_values=True)
    inside = (missing & ~_outside(missing, closed=False))[1:-1, 1:-1]
    label, count = ndimage.label(inside, EIGHT_NEIGHBOURS)
    small = [False]
    for rows, columns in ndimage.find_objects(label):
        extent = max((rows.stop - rows.start) * dy, (columns.stop - columns.start) * dx)
        small.append(extent <= largest * (1 + STEP_TOL))
    filled = np.array(small)[label]
    z = np.array(heights.z)
    if filled.any():
        z[filled] = _plate(z, filled, dx, dy)
    filled.flags.writeable = False
    return Filled(heights=replace(heights, z=z), filled=filled, holes=sum(small), unfilled=count - sum(small))


def _plate(z: Floats, unknown: Bools, dx: float, dy: float) -> Floats:
    """Return the unknown heights of least bending: least squares of all second differences that contain them."""
    from scipy.sparse import csc_array  # noqa: PLC0415 - only this needs it
    from scipy.sparse.linalg import spsolve  # noqa: PLC0415

    m, n = z.shape
    number = np.full(z.size, -1)
    number[unknown.ravel()] = np.arange(np.count_nonzero(unknown))
    mean = float(np.nanmean(z))
    flat = np.where(unknown, 0.0, z - mean).ravel()
    # For each second derivative: the offsets of its points in rows and columns, and their weights.
    kinds = [
        ([(0, 0), (0, 1), (0, 2)], np.array([1, -2, 1]) / dx**2),
        ([(0, 0), (1, 0), (2, 0)], np.array([1, -2, 1]) / dy**2),
        ([(0, 0), (0, 1), (1, 0), (1, 1)], np.array([1, -1, -1, 1]) * np.sqrt(2) / (dx * dy)),
    ]
    rows, columns, values, right = [], [], [], []
    total = 0
    places = np.argwhere(unknown)
    for offsets, shares in kinds:
        first = np.unique(np.concatenate([places - offset for offset in offsets]), axis=0)
        reach = np.max(offsets, axis=0)
        first = first[((first >= 0) & (first + reach < (m, n))).all(axis=1)]
        points = np.stack([(first + offset) @ (n, 1) for offset in offsets], axis=1)
        points = points[~np.isnan(flat[points]).any(axis=1)]
        heights = flat[points] @ shares
        numbers = number[points]
        equation = np.broadcast_to(np.arange(points.shape[0])[:, None] + total, points.shape)
        chosen = numbers >= 0
        rows.append(equation[chosen])
        columns.append(numbers[chosen])
        values.append(np.broadcast_to(shares, points.shape)[chosen])
        right.append(-heights)
        total += points.shape[0]
    system = csc_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(total, places.shape[0])
    )
    return np.asarray(spsolve(system.T @ system, system.T @ np.concatenate(right))) + mean
