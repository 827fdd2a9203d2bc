"""Fit of one lenslet, and of the base between the lenslets. See `lens_array` for the model."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, robust_scatter
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology.alignment import Alignment
from turnwright.metrology.grid import disc_points, point_areas, polynomial_terms
from turnwright.metrology.least_squares import clustered_covariance
from turnwright.metrology.rigid import rotation_about
from turnwright.metrology.undetermined import rim_form_heights
from turnwright.pose import Pose
from turnwright.surface import LensArray, Placed, Plane, Sphere, Sum, Surface, Zernike

if TYPE_CHECKING:
    from turnwright.part import Part

NM = 1e6

MIN_POINTS = 30

MIN_COVERAGE = 0.5
"""Share of the aperture that must hold points."""

FULL_COVERAGE = 0.95
"""Share of the aperture from which a lenslet counts as fully measured; the raster loses pixels at the rim."""

MIN_INDEPENDENT_SHARE = 1e-4
"""Least share of the squared effect of a parameter that the others cannot imitate: 100 times the uncertainty."""

MAX_SEARCH_POINTS = 4000

MAX_ITERATIONS = 12
"""Iterations of fit and separation; each reduces the error of the centre about five times."""

CENTRE_TOL = 2e-6
"""Step of the centre at which the iteration stops. [lens radii]"""

SMOOTH_DEGREE = 6
"""Degree of the polynomial for the smooth form, from which outliers and scatter are judged."""

OUTLIER_SIGMA = 6.0
"""Robust standard deviations beyond which a point is an outlier."""

MIN_OUTLIER_MM = 5e-6
"""Least height of an outlier, also on a map without noise."""

BLOCKS_PER_LENSLET = 12
"""Blocks across a lenslet (twice as many across the base) within which errors may be correlated."""

POINTS_PER_BLOCK = 8
MAX_LEVELLING_POINTS = 300_000

MIN_HIDDEN_FORM_MM = 50e-6
"""Lower bound, at the rim, of a form error that cannot be distinguished from a rotation."""

AGREEMENT_SIGMA = 3.0
"""Standard deviations within which the rotations from the base and from the lenslets agree."""

SLOPE_TOL = 1e-9
"""Slope, or height over a length, that has no effect."""


class Points(NamedTuple):
    """Valid points in the frame of the base, sorted by square cells. Each (n,)."""

    x: Floats
    y: Floats
    z: Floats
    departure: Floats  # from the base alone
    weight: Floats  # area of each point
    low: Floats  # lower corner of the first cell
    step: float  # side of a cell
    squares: int  # number of cells along x and along y
    first: Ints  # index of the first point of each cell

    def near(self, centre: Floats, radius: float) -> Ints:
        """Return the indices of the points within a radius of a centre. (k,)."""
        ends = np.floor((np.stack([centre[:2] - radius, centre[:2] + radius]) - self.low) / self.step)
        (first_column, bottom), (right, top) = np.clip(ends, -1, self.squares).astype(np.int64)
        first_column, right = max(first_column, 0), min(right, self.squares - 1)
        spans = [
            np.arange(self.first[row * self.squares + first_column], self.first[row * self.squares + right + 1])
            for row in range(max(bottom, 0), min(top, self.squares - 1) + 1)
            if first_column <= right
        ]
        chosen = np.concatenate(spans) if spans else np.empty(0, dtype=np.int64)
        away = (self.x[chosen] - centre[0]) ** 2 + (self.y[chosen] - centre[1]) ** 2
        return np.asarray(chosen[away <= radius**2])


class Design(NamedTuple):
    """The nominal array."""

    outer: Pose  # from the frame of base and array to the part's
    base: Surface | None  # all that is added to the array
    centres: Floats
    radii: Floats
    lens: Surface  # about its own origin, turned as the array is
    vertex: float  # height of the lens at its origin
    radius: float  # of curvature there, nan if it has none
    surround: Surface | None  # surface between the lenslets; None where they fill their cells
    reach: float  # semi-diameter of the clear aperture
    terms: tuple[int, ...]  # ANSI numbers of the Zernike terms of the base's form


class FreeParameters(NamedTuple):
    """Fitted parameters, and those of the fit for the radius; None if the form does not determine it."""

    columns: list[int]
    with_radius: list[int] | None


class Smooth(NamedTuple):
    """Mask of the points that are not outliers, smooth form at all points, and number of its terms."""

    keep: Bools
    form: Floats
    terms: int


class BaseForm(NamedTuple):
    """Form error of the base: amplitudes of its Zernike terms at the rim, and their uncertainty."""

    amplitudes: Floats  # (k,) [mm]
    covariance: Floats  # at the rotation of the frame (k, k) [mm²]
    turned: Floats  # standard deviation of each from the uncertainty of that rotation (k,) [mm]

    @property
    def std(self) -> Floats:
        """Standard uncertainty of each term. (k,) [mm]."""
        return np.sqrt(np.diag(self.covariance) + self.turned**2)

    def surface(self, design: Design) -> Zernike | None:
        """Return the form as a surface in the frame of the base; ``None`` where none was fitted."""
        if not self.amplitudes.size:
            return None
        return Zernike(
            terms=dict(zip(design.terms, self.amplitudes.tolist(), strict=True)),
            radius=design.reach, indexing="ansi", normalised=False,
        )  # fmt: skip


class FittedLenslet(NamedTuple):
    """Result of the fit of one lenslet, in the frame of the base."""

    parameters: Floats | None  # None where it was not fitted
    covariance: Floats  # (6, 6), nan for what was not free
    growth: tuple[float, float]  # scale less one, and its uncertainty
    local: Floats  # the centre, or the last position of the search
    residual: HeightMap
    size_nm: tuple[float, float]
    scatter_nm: float
    points: int
    outliers: int
    coverage: float
    finding: str


def find_arrays(surface: Surface) -> list[Surface]:
    """Return the terms of a surface that hold a lens array."""
    while isinstance(surface, Placed):
        surface = surface.surface
    if isinstance(surface, Sum):
        return [term for term in surface.terms if find_arrays(term)]
    return [surface] if isinstance(surface, LensArray) else []


def shapes_at(design: Design, x: Floats, y: Floats) -> Floats:
    """Return the terms of the base's form, each 1 mm at the rim. (k, n)."""
    return rim_form_heights(design.terms, design.reach, x, y)


def split_design(part: Part, form: str, aperture: float | None, degree: int) -> Design:
    """Split a part into base and array, their poses, and the form error terms of the base up to a degree."""
    outer, surface = Pose(), part.surface
    while isinstance(surface, Placed):
        outer, surface = outer.after(surface.pose), surface.surface
    terms = surface.terms if isinstance(surface, Sum) else (surface,)
    arrays = [term for term in terms if find_arrays(term)]
    if len(arrays) != 1:
        raise InputError(
            f"the surface of the part, a {type(part.surface).__name__}, has {len(arrays)} lens arrays, it must have "
            "1: give a LensArray, or a base with one added to it"
        )
    others = tuple(term for term in terms if term is not arrays[0])
    array, inside = arrays[0], Pose()
    while isinstance(array, Placed):
        inside, array = inside.after(array.pose), array.surface
    if not isinstance(array, LensArray) or inside.tilt != (0.0, 0.0):
        raise InputError(
            f"the lens array is tilted against its base by {np.rad2deg(inside.tilt)} deg or hidden in a placed sum, "
            "the limit is 0 deg: place base and array together"
        )
    x, y, _ = inside.apply(array.centres[:, 0], array.centres[:, 1], 0.0)
    centres = np.stack([x, y], axis=1)
    lens, surround = array.lenslet, array.surround
    if surround is not None and not isinstance(surround, Surface):
        surround = Plane(slope=(0.0, 0.0)).placed(shift=(0.0, 0.0, float(surround)))
    if inside != Pose():
        lens = lens.placed(shift=(0.0, 0.0, inside.shift[2]), rotation=inside.rotation)
        if surround is not None:
            surround = surround.placed(shift=inside.shift, rotation=inside.rotation)
    radii = _lens_radii(centres, array.aperture if aperture is None else aperture, part.reach)
    z, zx, zy, zxx, zxy, zyy = (float(value[0]) for value in lens.evaluate(np.zeros(1), np.zeros(1), 2))
    mean = ((1 + zy * zy) * zxx - 2 * zx * zy * zxy + (1 + zx * zx) * zyy) / (2 * (1 + zx * zx + zy * zy) ** 1.5)
    vertex = z if np.isfinite(z) else 0.0
    curved = bool(np.isfinite(mean) and abs(mean) * radii.max() > SLOPE_TOL)
    if form == "sphere":
        if not curved:
            raise InputError(
                f"the lenslet's curvature at its vertex is {mean:g} per mm, a sphere to start from needs one other "
                "than 0: fit the design form"
            )
        lens = Sphere(radius=1 / mean).placed(shift=(0.0, 0.0, vertex))
    return Design(
        outer=outer,
        base=(Sum(terms=others) if len(others) > 1 else others[0]) if others else None,
        centres=centres,
        radii=radii,
        lens=lens,
        vertex=vertex,
        radius=1 / mean if curved else float("nan"),
        surround=surround,
        reach=part.reach,
        terms=tuple(range(3, (degree + 1) * (degree + 2) // 2)) if surround is not None else (),
    )


def _lens_radii(centres: Floats, aperture: float | None, reach: float) -> Floats:
    """Return the radius of every lenslet: the aperture, or that of the largest circle in its cell. (n,) [mm]."""
    if aperture is not None:
        return np.full(centres.shape[0], positive(aperture, "aperture of a lenslet", "mm"))
    if centres.shape[0] == 1:
        return np.array([reach])
    from scipy.spatial import cKDTree  # noqa: PLC0415 - scipy is costly to import

    distance, _ = cKDTree(centres).query(centres, k=2)
    return np.asarray(distance)[:, 1] / 2


def free_parameters(design: Design, inner: float, *, radius: bool, tilt: bool) -> FreeParameters:
    """Return the fitted parameters, and raise if the form does not determine them."""
    free = [0, 1, 2, *([3] if radius else []), *([4, 5] if tilt else [])]
    reach = inner * float(design.radii.min())
    _, slopes = model(design, np.zeros(6), *disc_points(reach), [0, 1, 2, 3, 4, 5])
    slopes = slopes[np.isfinite(slopes).all(axis=1)]
    names = ("centre along x", "centre along y", "height", "radius", "tilt along x", "tilt along y")

    def alone(columns: list[int]) -> dict[int, float]:
        """Return the share of the squared effect of each parameter that the others cannot imitate."""
        size = np.sqrt(np.mean(slopes[:, columns] ** 2, axis=0))
        # Smaller effects of a slope, a height and a relative size are rounding.
        if (size <= SLOPE_TOL * np.where(np.array(columns) == 3, reach, 1.0)).any():
            return {columns[int(np.argmin(size))]: 0.0}
        scaled = slopes[:, columns] / size
        independent = []
        for k in range(len(columns)):
            others = np.delete(scaled, k, axis=1)
            missed = scaled[:, k] - others @ np.linalg.lstsq(others, scaled[:, k], rcond=None)[0]
            independent.append(float(np.mean(missed**2)))
        return dict(zip(columns, independent, strict=True))

    for column, share in alone(free).items():
        if share < MIN_INDEPENDENT_SHARE:
            raise InputError(
                f"the form of the lenslet does not determine the {names[column]}: only {share:.1g} of its squared "
                f"effect is independent of the other parameters, at least {MIN_INDEPENDENT_SHARE:g} is needed; "
                + ("leave the tilt fixed" if tilt else "fit a form with more curvature, or a larger aperture")
            )
    is_separable = np.isfinite(design.radius) and min(alone(sorted({*free, 3})).values()) >= MIN_INDEPENDENT_SHARE
    return FreeParameters(columns=free, with_radius=sorted({*free, 3}) if is_separable else None)


def model(design: Design, parameters: Floats, x: Floats, y: Floats, free: list[int]) -> tuple[Floats, Floats]:
    """Return the height of a lenslet over the base (n,), and its derivatives by the free parameters (n, k).

    The parameters are those of the formula in `lens_array`: centre x, y, height, scale minus one, slopes.
    """
    at_x, at_y, height, growth, slope_x, slope_y = parameters
    dx, dy = x - at_x, y - at_y
    u, v = dx / (1 + growth), dy / (1 + growth)
    z, zx, zy = design.lens.evaluate(u, v, 1)
    z -= design.vertex
    value = design.vertex + height + (1 + growth) * z + slope_x * dx + slope_y * dy
    slopes = -zx - slope_x, -zy - slope_y, np.ones(x.size), z - u * zx - v * zy, dx, dy
    return value, np.stack([slopes[column] for column in free], axis=1)


def place_points(heights: HeightMap, pose: Pose, design: Design) -> Points:
    """Return the points of the map within the clear aperture, in the frame of the base, sorted by cells."""
    valid = ~np.isnan(heights.z)
    x, y, z = (part[valid] for part in (*heights.points(), heights.z))
    weight = point_areas(heights)[valid]
    weight /= weight.max()
    x, y, z = pose.apply(x, y, z)
    part_x, part_y, _ = design.outer.apply(x, y, z)
    used = (part_x**2 + part_y**2 <= design.reach**2) & (weight > 0)
    if design.base is not None and (inside := design.base.inside(x, y)) is not None:
        used &= inside
    if not used.any():
        raise InputError(
            f"none of the {x.size} valid points of the map lie within the clear aperture, radius {design.reach:g} mm: "
            "check the pose and the units"
        )
    step = max(float(design.radii.max()) / 2, design.reach / 1000)
    count = int(2 * design.reach / step) + 3
    low = np.array([x[used].min(), y[used].min()])
    across, along = ((part - start) / step for part, start in zip((x, y), low, strict=True))
    cell = np.minimum(along[used].astype(np.int64), count - 1) * count
    cell += np.minimum(across[used].astype(np.int64), count - 1)
    order = np.flatnonzero(used)[np.argsort(cell, kind="stable")]
    x, y, z, weight = (np.ascontiguousarray(part[order]) for part in (x, y, z, weight))
    base = design.base.evaluate(x, y, 0)[0] if design.base is not None else 0.0
    first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=count * count))])
    return Points(x, y, z, z - base, weight, low, step, count, first)


def subtract_form(points: Points, design: Design, form: BaseForm) -> Points:
    """Return the points with the form error of the base subtracted."""
    if not form.amplitudes.size:
        return points
    return points._replace(departure=points.departure - form.amplitudes @ shapes_at(design, points.x, points.y))


def least_squares_step(slopes: Floats, error: Floats, weight: Floats) -> Floats:
    """Return the weighted least-squares step. (k,)."""
    weighted = slopes * weight[:, None]
    normal = weighted.T @ slopes
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    step = np.linalg.lstsq(normal / np.outer(size, size), weighted.T @ error / size, rcond=1e-12)[0]
    return np.asarray(step / size)


def find_roughly(points: Points, design: Design, k: int, inner: float) -> Floats | None:
    """Return approximate parameters of a lenslet, fitted from its centre outward, or ``None``."""
    radius, parameters = float(design.radii[k]), np.zeros(6)
    parameters[:2] = design.centres[k]
    free = [0, 1, 2]
    for share in (0.5, 0.75, inner):
        chosen = points.near(parameters, share * radius)
        if chosen.size < MIN_POINTS:  # with coarse pixels the inner zone has too few
            continue
        chosen = chosen[:: chosen.size // MAX_SEARCH_POINTS + 1]
        x, y, departure, weight = (part[chosen] for part in (points.x, points.y, points.departure, points.weight))
        for _ in range(MAX_ITERATIONS):
            value, slopes = model(design, parameters, x, y, free)
            error = departure - value
            keep = np.isfinite(error)
            off = np.abs(error - np.median(error[keep])) if keep.any() else error
            keep &= off <= max(OUTLIER_SIGMA * robust_scatter(off[keep]), MIN_OUTLIER_MM) if keep.any() else False
            if np.count_nonzero(keep) < MIN_POINTS:
                return None
            step = least_squares_step(slopes[keep], error[keep], weight[keep])
            parameters[free] += step
            if not np.hypot(*(parameters[:2] - design.centres[k])) < radius:
                return None
            if np.hypot(*step[:2]) < 1e-4 * radius:
                break
    return parameters if chosen.size >= MIN_POINTS else None


def fit_smooth(x: Floats, y: Floats, error: Floats) -> Smooth:
    """Fit a polynomial to a residual without outliers. The points lie in [-1, 1]."""
    degree = SMOOTH_DEGREE
    while degree and (degree + 1) * (degree + 2) // 2 * POINTS_PER_BLOCK > error.size:
        degree -= 1
    terms = polynomial_terms(x, y, degree)
    off = np.abs(error - np.median(error))
    # Twice the threshold at first, as the form is not yet removed.
    keep = off <= max(2 * OUTLIER_SIGMA * robust_scatter(off), MIN_OUTLIER_MM)
    normal, right, form = terms.T @ terms, terms.T @ error, error
    for _ in range(6):
        spikes = terms[~keep]
        solved = np.linalg.lstsq(normal - spikes.T @ spikes, right - spikes.T @ error[~keep], rcond=1e-12)[0]
        form = terms @ solved
        off = np.abs(error - form)
        last, keep = keep, off <= max(OUTLIER_SIGMA * robust_scatter(off), MIN_OUTLIER_MM)
        if np.array_equal(last, keep):
            break
    return Smooth(keep, form, terms.shape[1])


def number_blocks(u: Floats, v: Floats, most: int) -> tuple[Ints, float]:
    """Return the block number of each point of the unit disc (n,), and the share of the disc that is covered."""
    count = int(np.clip(np.sqrt(u.size / POINTS_PER_BLOCK), 3, most))
    row, column = (np.clip((part + 1) / 2 * count, 0, count - 1).astype(np.int64) for part in (v, u))
    number = row * count + column
    middle = (2 * np.arange(count) + 1) / count - 1
    disc = (np.hypot(middle, middle[:, None]) <= 1).ravel()
    filled = np.bincount(number, minlength=count * count) > 0
    return number, float(np.count_nonzero(filled & disc) / np.count_nonzero(disc))


def size_nm(error: Floats, weight: Floats) -> tuple[float, float]:
    """Return rms and peak to valley. [nm]."""
    return float(np.sqrt(np.average(error**2, weights=weight))) * NM, float(np.ptp(error)) * NM


def failed_fit(parameters: Floats, count: int, coverage: float, finding: str) -> FittedLenslet:
    """Return the result for a lenslet that could not be fitted."""
    empty = np.empty(0)
    nan = float("nan")
    return FittedLenslet(
        None, np.full((6, 6), nan), (nan, nan), parameters[:2], HeightMap(x=empty, y=empty, z=empty), (nan, nan), nan,
        count, 0, coverage, finding,
    )  # fmt: skip


def fit_lenslet(
    points: Points, design: Design, k: int, starts: Floats, free: FreeParameters, inner: float, base: BaseForm
) -> FittedLenslet:  # fmt: skip
    """Fit one lenslet to the points around its measured centre."""
    parameters, reach = starts[k].copy(), inner * float(design.radii[k])
    apart = np.hypot(*(starts[:, :2] - starts[k, :2]).T)
    grain = 0.0
    rivals = starts[(apart < 2.2 * reach) & (apart > 0), :2]
    for _ in range(MAX_ITERATIONS):
        chosen = points.near(parameters, reach + grain)
        for rival in rivals:  # where cells touch, a neighbour may overlap the circle
            x, y = points.x[chosen], points.y[chosen]
            distance_squared = (x - parameters[0]) ** 2 + (y - parameters[1]) ** 2
            chosen = chosen[distance_squared <= (x - rival[0]) ** 2 + (y - rival[1]) ** 2]
        if chosen.size < MIN_POINTS:
            words = f"{chosen.size} points within {inner:g} lens radii, a fit needs {MIN_POINTS}: measure more of it"
            return failed_fit(parameters, chosen.size, 0.0, words)
        x, y, departure, weight = (part[chosen] for part in (points.x, points.y, points.departure, points.weight))
        before = parameters[:2].copy()
        value, _ = model(design, parameters, x, y, free.columns)
        u, v, error = (x - before[0]) / reach, (y - before[1]) / reach, departure - value
        # A point at the rim counts with the share of its pixel inside, so that the sums are continuous.
        grain = reach * float(np.sqrt(np.pi / chosen.size)) / 2
        weight = weight * np.clip((reach * (1 - np.hypot(u, v)) / grain + 1) / 2, 0, 1)
        valid = np.isfinite(error) & (weight > 0)
        if np.count_nonzero(valid) < MIN_POINTS:
            words = (
                f"its form is defined at {np.count_nonzero(valid)} points, a fit needs {MIN_POINTS}: check the design"
            )
            return failed_fit(parameters, chosen.size, 0.0, words)
        x, y, u, v, departure, weight = (part[valid] for part in (x, y, u, v, departure, weight))
        smooth = fit_smooth(u, v, error[valid])
        x, y, u, v, departure, weight = (part[smooth.keep] for part in (x, y, u, v, departure, weight))
        gauss_newton(design, parameters, x, y, departure, weight, free.columns)
        if not np.hypot(*(parameters[:2] - design.centres[k])) < design.radii[k]:
            words = f"no lenslet found within its radius of {design.radii[k]:g} mm: check the pose and the design"
            return failed_fit(starts[k], x.size, 0.0, words)
        if np.hypot(*(parameters[:2] - before)) < CENTRE_TOL * reach:
            break
    return judge(design, free, parameters, (x, y, u, v, departure, weight), smooth, base)


def gauss_newton(
    design: Design, parameters: Floats, x: Floats, y: Floats, departure: Floats, weight: Floats, free: list[int]
) -> Floats:
    """Iterate the parameters in place to convergence; return the final derivatives. (n, k)."""
    reach = np.ptp(x) + 1e-300
    for _ in range(MAX_ITERATIONS):
        value, slopes = model(design, parameters, x, y, free)
        error = departure - value
        valid = np.isfinite(error)
        step = least_squares_step(slopes[valid], error[valid], weight[valid])
        parameters[free] += step
        parameters[3] = max(parameters[3], -0.9)
        if np.hypot(*step[:2]) < 1e-9 * reach and np.abs(step[2:]).max() < 1e-9:
            break
    return model(design, parameters, x, y, free)[1]


def judge(
    design: Design, free: FreeParameters, parameters: Floats, data: tuple[Floats, ...], smooth: Smooth, base: BaseForm
) -> FittedLenslet:  # fmt: skip
    """Return the result of a fit with its uncertainty, or why there is none."""
    x, y, u, v, departure, weight = data
    value, slopes = model(design, parameters, x, y, free.columns)
    error = departure - value
    blocks, coverage = number_blocks(u, v, BLOCKS_PER_LENSLET)
    outliers = smooth.keep.size - x.size
    if coverage < MIN_COVERAGE:
        words = f"{coverage:.0%} of its aperture is measured, a fit needs {MIN_COVERAGE:.0%}: measure more of it"
        return failed_fit(parameters, x.size, coverage, words)
    spread = float(np.average((departure - np.average(departure, weights=weight)) ** 2, weights=weight))
    mean_square = float(np.average(error**2, weights=weight))
    if mean_square > spread / 2:
        words = (
            f"the residual is {np.sqrt(mean_square) * NM:.0f} nm rms of {np.sqrt(spread) * NM:.0f} nm, no lenslet of "
            "this form: check the pose and the design"
        )
        return failed_fit(parameters, x.size, coverage, words)
    residual = error - fit_smooth(u, v, error).form
    covariance = np.full((6, 6), np.nan)
    covariance[np.ix_(free.columns, free.columns)] = clustered_covariance(
        slopes, residual, weight, blocks, smooth.terms
    )
    if base.amplitudes.size:
        # Uncertainty of the base form moves the lenslet.
        moved = np.stack([least_squares_step(slopes, one, weight) for one in shapes_at(design, x, y)], axis=1)
        covariance[np.ix_(free.columns, free.columns)] += moved @ base.covariance @ moved.T
    growth = float("nan"), float("nan")
    if free.with_radius is not None:
        other = parameters.copy()
        slopes = gauss_newton(design, other, x, y, departure, weight, free.with_radius)
        place = free.with_radius.index(3)
        variance = clustered_covariance(slopes, residual, weight, blocks, smooth.terms)[place, place]
        growth = float(other[3]), float(np.sqrt(variance))
    return FittedLenslet(
        parameters=parameters,
        covariance=covariance,
        growth=growth,
        local=parameters[:2],
        residual=HeightMap(x=x - parameters[0], y=y - parameters[1], z=error, name="lenslet residual"),
        size_nm=size_nm(error, weight),
        scatter_nm=float(np.sqrt(np.average(residual**2, weights=weight))) * NM,
        points=x.size,
        outliers=outliers,
        coverage=coverage,
        finding="" if coverage >= FULL_COVERAGE else f"only {coverage:.0%} of its aperture is measured",
    )


def points_of_base(points: Points, design: Design, centres: Floats, outer: float) -> Ints:
    """Return the points beyond ``outer`` lens radii of all lenslets. (m,)."""
    base = np.full(points.x.size, design.surround is not None)
    if design.surround is not None:
        for centre, radius in zip(centres, design.radii, strict=True):
            base[points.near(centre, outer * radius)] = False
    return np.flatnonzero(base)


def errors_of_base(points: Points, base: Ints, design: Design) -> tuple[Floats, Floats]:
    """Return the form error of the base (m,), and its derivatives by rx, ry, a shift along z, and rz. (m, 4)."""
    x, y, z, error = points.x[base], points.y[base], points.z[base], points.departure[base]
    zx, zy = np.zeros((2, x.size))
    for surface in (design.base, design.surround):
        if surface is not None:
            height, slope_x, slope_y = surface.evaluate(x, y, 1)
            zx, zy = zx + slope_x, zy + slope_y
            if surface is design.surround:
                error = error - height
    slopes = np.stack([y + zy * z, -x - zx * z, np.ones(x.size), zx * y - zy * x], axis=1)
    return error, slopes


def level_on_base(
    points: Points, base: Ints, design: Design, starts: Floats, seen: Bools, rotation_std: float
) -> tuple[Pose, str, BaseForm]:
    """Return the pose that levels the base, a description of the frame, and the form error of the base.

    ``rotation_std`` is that of the pose, used if too few lenslets determine the rotation. [rad]
    """
    base = base[:: base.size // MAX_LEVELLING_POINTS + 1]
    weight = points.weight[base]
    error, slopes = errors_of_base(points, base, design)
    valid = np.isfinite(error)
    base, error, slopes, weight = base[valid], error[valid], slopes[valid], weight[valid]
    middle = np.array([np.mean(points.x[base]), np.mean(points.y[base])])
    size = max(float(np.hypot(points.x[base] - middle[0], points.y[base] - middle[1]).max()), 1e-300)
    u, v = (points.x[base] - middle[0]) / size, (points.y[base] - middle[1]) / size
    smooth = fit_smooth(u, v, error)
    base = base[smooth.keep]
    u, v, error, slopes, weight = (part[smooth.keep] for part in (u, v, error, slopes, weight))
    # Tilts, height and form are fitted together; the rotation is separate.
    shapes, turned = shapes_at(design, points.x[base], points.y[base]).T, slopes[:, 3]
    level, slopes = slopes[:, :3], np.concatenate([slopes[:, :3], -shapes], axis=1)
    blocks, _ = number_blocks(u, v, 2 * BLOCKS_PER_LENSLET)
    alike = least_squares_step(slopes, turned, weight)[3:]
    chosen, by_base = np.append(-least_squares_step(slopes, error, weight), 0.0), False
    lattice = Alignment.of(design.centres[seen], starts[seen, :2]) if np.count_nonzero(seen) > 2 else None
    unsure = rotation_std if lattice is None else float(np.hypot(lattice.rotation, lattice.rotation_std))
    tells = _rotation_of_base(design, (u, v, error, weight, blocks), level, shapes, turned, alike)
    if tells is not None:
        rotation_known, base_std = tells
        by_base = base_std < (rotation_std if lattice is None else lattice.rotation_std)
        if lattice is not None:  # a rotation that the lenslets contradict is form error
            gap = abs(float(rotation_known[-1]) + lattice.rotation)
            by_base &= gap <= AGREEMENT_SIGMA * float(np.hypot(base_std, lattice.rotation_std))
        if by_base:
            chosen, unsure = rotation_known, base_std
    # The residual is correlated within blocks.
    residual = error + slopes @ chosen[:-1] + turned * chosen[-1]
    spread = fit_smooth(u, v, residual)
    covariance = clustered_covariance(slopes, residual, weight, blocks, spread.terms)[3:, 3:]
    matrix = rotation_about([chosen[0], chosen[1], chosen[-1]])
    within = f" within {unsure * 1e6:.2g} urad" if np.isfinite(unsure) else ""
    words = (
        "the part's frame: tilt and height by the base, shift by the pose, rotation by the "
        f"{'base' if by_base else 'pose'}{within}"
    )
    base_form = BaseForm(chosen[3:-1], covariance, alike * unsure if np.isfinite(unsure) else 0.0 * alike)
    return Pose.of(matrix, (0.0, 0.0, chosen[2])), words, base_form


def _rotation_of_base(
    design: Design, data: tuple[Floats, Floats, Floats, Floats, Ints], level: Floats, shapes: Floats, turned: Floats,
    alike: Floats,
) -> tuple[Floats, float] | None:  # fmt: skip
    """Return level, form and rotation by the base, and the standard deviation of the rotation; ``None`` if undefined.

    The form that cannot be distinguished from the rotation, ``alike`` for each rad, is left out. It is assumed to be as
    large as the largest of the other terms, which are fitted.
    """
    u, v, error, weight, blocks = data
    along = turned - level @ least_squares_step(level, turned, weight)
    strength = float(np.sqrt(np.average(along**2, weights=weight)))
    if strength <= SLOPE_TOL * design.reach:
        return None
    way = alike / max(float(np.sqrt(alike @ alike)), 1e-300)
    others = np.eye(alike.size) - np.outer(way, way)
    apart = np.concatenate([level, -shapes @ others, turned[:, None]], axis=1)
    correction = -least_squares_step(apart, error, weight)
    correction[3:-1] = others @ correction[3:-1]
    residual = error + apart @ correction
    smooth = fit_smooth(u, v, residual)
    texture = residual - smooth.form
    noise = clustered_covariance(along[:, None], texture, weight, blocks, smooth.terms)[0, 0]
    form = np.average(smooth.form**2, weights=weight) - smooth.terms * np.average(texture**2, weights=weight) / u.size
    variance = float(noise) + max(float(form), 0.0) / strength**2
    if alike.size:
        # Apparent rotation of the base for each mm of that form.
        leak = float(least_squares_step(apart, shapes @ way, weight)[-1])
        variance += (leak * max(float(np.abs(correction[3:-1]).max()), MIN_HIDDEN_FORM_MM)) ** 2
    return correction, float(np.sqrt(variance))
