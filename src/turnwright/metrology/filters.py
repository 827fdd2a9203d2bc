"""Filters of ISO 16610 for maps with missing points, and the bands of a surface after ISO 25178-3.

Missing points have zero weight and stay missing; other libraries refuse such maps or fill the points first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from turnwright._arrays import STEP_TOL, Bools, Floats
from turnwright._kernels.regression import advance, biweight, spline
from turnwright._validate import check_numbers, one_of, positive
from turnwright.errors import InputError
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import even_step, measure, valid_points
from turnwright.metrology.regression import GAUSSIAN_WIDTHS, regress
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

Kind: TypeAlias = Literal["gaussian", "robust", "spline"]
Along: TypeAlias = Literal["x", "y", "radius"]

DEFAULT_ORDERS: dict[str, int] = {"gaussian": 1, "robust": 2}
"""Default order of the local polynomial."""

MIN_CUTOFF_STEPS = 5
"""Grid steps in the shortest cutoff (ISO 25178-3): the sampled Gaussian still transmits 0.5000 at the cutoff
(0.501 at 4 steps)."""

TUKEY_BOUND = 4.4478
"""Tukey's bound over the median absolute residual: three standard deviations of Gaussian noise (ISO 16610-31)."""

CONVERGENCE_TOL = 3e-3
"""Change of the bound, and rms change of the mean surface, at which a robust filter has converged; relative to the
bound."""

MIN_BOUND_MM = 1e-9
"""Lower bound of Tukey's bound: 1 pm."""

MAX_ITERATIONS = 50

CHUNK_LINES = 16
"""Lines that a thread processes at a time."""


def filter_map(
    heights: HeightMap,
    cutoff: float,
    *,
    kind: Kind = "gaussian",
    order: int | None = None,
    along: Along | None = None,
) -> HeightMap:
    r"""Return the mean line or surface: waves longer than the cutoff. Missing points have zero weight.

    ``"gaussian"`` fits, at every point, a polynomial of degree ``order`` to its neighbourhood with Gaussian weights:
    order 0 is the weighted mean, order 1 follows planes and order 2 curved forms up to borders and holes. Orders 0 and
    1 transmit :math:`2^{-(\lambda_c/\lambda)^2}` of a wave; all transmit 0.50 at the cutoff, in every direction.
    ``"robust"`` repeats this with Tukey's weights, with a bound of 4.4478 times the median distance. ``"spline"``,
    along lines only, is the natural cubic smoothing spline, which transmits :math:`1/(1 + (\sin(\pi
    d/\lambda)/\sin(\pi d/\lambda_c))^4)` at the step d.

    Parameters
    ----------
    heights
        On an even rectangular grid, or on a polar one along its radius.
    cutoff
        Nesting index: wavelength of 50 % transmission, at least 5 steps of the grid and at most its extent. [mm]
    kind
        ``"gaussian"``, ``"robust"`` or ``"spline"``.
    order
        0, 1 or 2; by default 1, and 2 for a robust filter. A spline has none.
    along
        ``None`` filters areas; ``"x"``, ``"y"`` or ``"radius"`` filters every line in that direction as a separate
        profile.

    Raises
    ------
    InputError
        If the options do not fit the map or each other, or a robust filter does not converge.

    Sources
    -------
    ISO 16610-21, -61 (Gaussian), -28 (ends), -31, -71 (robust regression), -22 (spline). Oracles: closed forms of
    waves, dense sums, SciPy's convolution, surfalize.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.arange(400) * 0.01
    >>> wave = HeightMap(x=x, y=x, z=np.tile(np.cos(2 * np.pi * x / 0.8), (400, 1)))
    >>> round(float(filter_map(wave, 0.8).z[200, 160]), 4)
    0.5
    """
    order = _order(kind, order, along)
    positive(cutoff, "the cutoff", "mm")
    valid = valid_points(heights, 1, "a filter")
    steps = _steps(heights, along)
    _check_cutoff(heights, cutoff, along, steps, "the cutoff")
    # A mean of zero preserves the digits of the sums.
    mean = float(heights.z[valid].mean())
    z = heights.z - mean
    if along == "y":
        z, valid = np.ascontiguousarray(z.T), np.ascontiguousarray(valid.T)
    if kind == "spline":
        out = _spline(z, cutoff / steps[0])
    else:
        width = GAUSSIAN_WIDTHS[order] * cutoff
        # A map of one line has no step across it, and any width will do.
        points = [width / step if np.isfinite(step) else 1.0 for step in steps]
        widths = points[0], (points[1] if along is None else None)
        z = np.where(valid, z, 0.0)

        def smooth(weight: Floats) -> Floats:
            return regress(z, weight, widths, order)

        out = smooth(valid.astype(np.float64))
        if kind == "robust":
            out = _robust(z, valid, smooth, out, apart=along is not None)
    out += mean
    out[~valid] = np.nan
    return replace(heights, z=out.T if along == "y" else out)


def _order(kind: str, order: int | None, along: str | None) -> int:
    """Return the order, and raise unless kind, order and direction go together."""
    one_of(kind, "the kind of filter", ("gaussian", "robust", "spline"))
    if kind == "spline" and (order is not None or along is None):
        raise InputError(
            "a spline filter works along lines and has no order: give along and leave the order out, or use a Gaussian"
        )
    order = DEFAULT_ORDERS.get(kind, 0) if order is None else order
    one_of(order, "the order of the filter", (0, 1, 2))
    return order


def _steps(heights: HeightMap, along: str | None) -> tuple[float, ...]:
    """Return the steps of the grid in the directions that are filtered. [mm]."""
    grid = measure(heights)
    one_of(along or "x", "the direction of the lines", ("x", "y", "radius"))
    if heights.polar != (along == "radius"):
        lines = 'use its lines with along="radius"' if heights.polar else 'use along="x" or "y"'
        way = "areas" if along is None else f"lines along {along}"
        raise InputError(
            f"the {'polar' if heights.polar else 'rectangular'} map cannot be filtered over {way}: {lines}"
            + (", or bring it to a rectangular grid" if heights.polar else "")
        )
    axes = {"x": grid.columns, "y": grid.rows, "radius": grid.columns}
    # A map of one line is filtered along it.
    return tuple(
        np.inf
        if along is None and axes[name].size == 1 < heights.z.size
        else even_step(axes[name], f"the map along {name}", "a filter")
        for name in (("x", "y") if along is None else (along,))
    )


def _check_cutoff(heights: HeightMap, cutoff: float, along: str | None, steps: tuple[float, ...], name: str) -> None:
    coarsest = max(step for step in steps if np.isfinite(step))
    if cutoff < MIN_CUTOFF_STEPS * coarsest * (1 - STEP_TOL):
        raise InputError(
            f"{name} must be at least {MIN_CUTOFF_STEPS * coarsest:g} mm ({MIN_CUTOFF_STEPS} steps of the grid), got "
            f"{cutoff:g} mm: filter longer waves, or measure with smaller pixels"
        )
    axes = [getattr(heights, axis) for axis in (("x", "y") if along is None else (along,))]
    extent = max(float(np.ptp(axis) + step) for axis, step in zip(axes, steps, strict=True) if axis.size > 1)
    if cutoff > extent * (1 + STEP_TOL):
        raise InputError(
            f"{name} must be at most {extent:g} mm (the extent of the map), got {cutoff:g} mm: filter shorter "
            "waves, or remove a form instead"
        )


def _spline(z: Floats, cutoff: float) -> Floats:
    """Return the smoothing spline of every line; the cutoff in points."""
    out = np.empty_like(z)
    stiffness = (2 * np.sin(np.pi / cutoff)) ** -4
    run_chunks(lambda start, stop: spline(z[start:stop], stiffness, out[start:stop]), z.shape[0], CHUNK_LINES)
    return out


def _robust(z: Floats, valid: Bools, smooth: Callable[[Floats], Floats], wave: Floats, *, apart: bool) -> Floats:
    """Iterate weights and smoothing until the bounds converge: one for the map, or one for each line."""
    weight, distance, change = np.empty_like(z), np.empty_like(z), np.empty(z.shape[0])
    # Missing points are nan, which gives them zero weight.
    measured = np.where(valid, z, np.nan)
    count = np.count_nonzero(valid)
    bound = np.maximum(TUKEY_BOUND * _medians(np.abs(measured - wave), apart=apart), MIN_BOUND_MM)
    for _ in range(MAX_ITERATIONS):

        def weigh(start: int, stop: int, bound: Floats = bound) -> None:
            rows = slice(start, stop)
            biweight(measured[rows], wave[rows], bound[rows], weight[rows])

        run_chunks(weigh, z.shape[0], CHUNK_LINES)
        new = smooth(weight)

        def move(start: int, stop: int, bound: Floats = bound, new: Floats = new) -> None:
            rows = slice(start, stop)
            # Where all neighbours are outliers, the mean surface stays unchanged.
            advance(measured[rows], new[rows], bound[rows], wave[rows], distance[rows], change[rows])

        run_chunks(move, z.shape[0], CHUNK_LINES)
        last, bound = bound, np.maximum(TUKEY_BOUND * _medians(distance, apart=apart), MIN_BOUND_MM)
        if change.sum() <= CONVERGENCE_TOL**2 * count and (np.abs(bound - last) <= CONVERGENCE_TOL * bound).all():
            return wave
    raise InputError(
        f"the robust filter has not converged to {CONVERGENCE_TOL * 100:g} % after {MAX_ITERATIONS} iterations: use a "
        "longer cutoff, or remove outliers and form first"
    )


def _medians(distances: Floats, *, apart: bool) -> Floats:
    """Return the median of the valid values, of all or of each line, for each line; 0 for an empty line."""
    count = distances.shape[0]
    if not apart:
        return np.full(count, np.median(distances[~np.isnan(distances)]))
    ordered = np.sort(distances, axis=1)  # nan goes last
    counts = np.count_nonzero(~np.isnan(ordered), axis=1)
    lines = np.arange(count)
    middle = (ordered[lines, np.maximum(counts - 1, 0) // 2] + ordered[lines, counts // 2]) / 2
    return np.where(counts > 0, middle, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Nesting:
    """Bands of a surface after ISO 25178-3: S-filter, F-operation, L-filter, in this order.

    Parameters
    ----------
    s_filter
        Nesting index of the S-filter, which removes shorter waves; ``None`` for none. [mm]
    form
        What the F-operation removes; see `remove_form`.
    l_filter
        Nesting index of the L-filter, which removes longer waves; ``None`` for none. [mm]
    kind, order, along
        Type of filter; see `filter_map`. The S-filter of a robust L-filter is Gaussian.
    """

    s_filter: float | None
    form: Form
    l_filter: float | None
    kind: Kind = "gaussian"
    order: int | None = None
    along: Along | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        _order(self.kind, self.order, self.along)
        for name, index in (("S", self.s_filter), ("L", self.l_filter)):
            if index is not None:
                positive(index, f"the nesting index of the {name}-filter", "mm")
        if self.s_filter is not None and self.l_filter is not None and self.s_filter >= self.l_filter:
            raise InputError(
                f"the nesting index of the S-filter must be below that of the L-filter, {self.l_filter:g} mm, got "
                f"{self.s_filter:g} mm: S removes shorter waves, L removes longer waves"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bands:
    """A surface in its bands: noise + form + waviness + roughness is the measured map.

    Parameters
    ----------
    nesting
        Limits of the bands.
    noise
        Waves removed by the S-filter. [mm]
    form
        Form removed by the F-operation. [mm]
    waviness
        Waves removed by the L-filter, the long waves of the SF-surface; zero without an L-filter. [mm]
    roughness
        Residual, the SL-surface; without an L-filter the SF-surface. [mm]
    """

    nesting: Nesting
    noise: HeightMap
    form: HeightMap
    waviness: HeightMap
    roughness: HeightMap

    @property
    def sf_surface(self) -> HeightMap:
        """Waviness and roughness: the surface after S-filter and F-operation."""
        return replace(self.roughness, z=self.waviness.z + self.roughness.z)


def separate_bands(heights: HeightMap, nesting: Nesting) -> Bands:
    """Separate a surface into bands: S-filter, F-operation, L-filter.

    Parameters
    ----------
    heights
        Missing points have zero weight and stay missing.
    nesting
        Limits of the bands.

    Raises
    ------
    InputError
        If the grid is too coarse for the S-filter or too small for the L-filter, and as `filter_map` and `remove_form`.

    Sources
    -------
    ISO 25178-3.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.arange(200) * 0.01
    >>> tilted = HeightMap(x=x, y=x, z=np.add.outer(0.1 * x, 0.2 * x))
    >>> bands = separate_bands(tilted, Nesting(s_filter=0.05, form="plane", l_filter=0.8))
    >>> bool(np.abs(bands.roughness.z).max() < 1e-12)
    True
    """
    steps = _steps(heights, nesting.along)
    for name, index in (("S", nesting.s_filter), ("L", nesting.l_filter)):
        if index is not None:
            _check_cutoff(heights, index, nesting.along, steps, f"the nesting index of the {name}-filter")
    primary, zero = heights, np.where(np.isnan(heights.z), np.nan, 0.0)
    if nesting.s_filter is not None:
        kind: Kind = "gaussian" if nesting.kind == "robust" else nesting.kind
        primary = filter_map(heights, nesting.s_filter, kind=kind, order=nesting.order, along=nesting.along)
    flat = remove_form(primary, nesting.form)
    waviness = zero
    if nesting.l_filter is not None:
        waviness = filter_map(flat, nesting.l_filter, kind=nesting.kind, order=nesting.order, along=nesting.along).z

    def part(z: Floats, what: str) -> HeightMap:
        return replace(heights, z=z, name=f"{heights.name} {what}".strip())

    return Bands(
        nesting=nesting,
        noise=part(heights.z - primary.z, "noise"),
        form=part(primary.z - flat.z, "form"),
        waviness=part(waviness, "waviness"),
        roughness=part(flat.z - waviness, "roughness"),
    )
