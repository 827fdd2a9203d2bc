"""Values of a map for the call-outs of a drawing: form after ISO 10110-5, texture, density and slopes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import InputError, quote
from turnwright.metrology.call_outs import CallOut
from turnwright.metrology.grid import area_rms, even_step, measure
from turnwright.metrology.profile_parameters import DEFAULT_SECTIONS, profile_roughness
from turnwright.metrology.slope import slope_error
from turnwright.metrology.spectrum import area_psd, line_psd
from turnwright.metrology.zernike_fit import fit_zernike
from turnwright.profile import Profile
from turnwright.surface import Surface, Zernike, zernike_order
from turnwright.units import say_length

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.outline import Outline

NM = 1e6
DISC_TERMS, OTHER_TERMS = 37, 4
"""Fringe Zernike terms that are fitted together over a disc, and over any other clear aperture."""

REACH_TOL, SPACING_TOL = 0.03, 1.5
"""Largest distance of the border of the clear aperture from the map: these shares of its half-width and of the mean
spacing of the heights together; of a polar map the spacing along the rim."""

BORDER_SAMPLES, CHECK_POINTS = 180, 50_000
"""Points of the border and of the map that are compared."""

MAX_RINGS, MIN_RING_POINTS = 200, 100
"""Rings over which a map without a polar grid is averaged, and least heights in one of them."""

MAX_LINES = 25
"""Profiles evaluated in each direction of a map."""

BAND_TOL = 1e-9

NOISE_TOL = 0.2
"""Expanded uncertainty (k = 2) of a stated noise, relative."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FormComponents:
    """Parts of a form error after ISO 10110-5 and ISO 14999-4. See `form_components`.

    Parameters
    ----------
    power_pv
        Sagitta error A: peak to valley of the best-fit sphere. [mm]
    power_std
        Its standard uncertainty for independent noise of 1 of each height.
    irregularity_pv
        Irregularity B: peak to valley without piston, tilt and this sphere. [mm]
    symmetric_pv
        Peak to valley C of the part of the irregularity that is rotationally symmetric. [mm]
    rms_total, rms_irregularity, rms_asymmetry
        Root mean square RMSt without piston and tilt, RMSi of the irregularity, and RMSa of the irregularity without
        its rotationally symmetric part. [mm]
    sphere
        Piston, tilt and sphere of best fit.
    irregularity, symmetric
        Irregularity, and its rotationally symmetric part, at the points of the map. [mm]
    count, ring_count
        Number of heights, and the least number averaged on a ring.
    """

    power_pv: float
    power_std: float
    irregularity_pv: float
    symmetric_pv: float
    rms_total: float
    rms_irregularity: float
    rms_asymmetry: float
    sphere: Surface
    irregularity: HeightMap
    symmetric: HeightMap
    count: int
    ring_count: int

    @property
    def values(self) -> dict[str, float]:
        """The quantities by the symbol of a call-out. [mm]."""
        return {
            "A": self.power_pv, "B": self.irregularity_pv, "C": self.symmetric_pv, "RMSt": self.rms_total,
            "RMSi": self.rms_irregularity, "RMSa": self.rms_asymmetry,
        }  # fmt: skip

    def measured(self, noise: float) -> dict[str, tuple[float, float]]:
        r"""Return the values without the noise of the heights, and their expanded uncertainties (k = 2). [mm].

        Independent noise of each height adds to the mean squares, from which it is subtracted; it is taken to be known
        to 20 %. It widens a peak to valley of n heights by up to :math:`2 \sigma \sqrt{2 \ln n}`, see `pv_doubt`, or of
        the means over rings by less.

        Parameters
        ----------
        noise
            Standard deviation of a height. [mm]
        """
        mean = 2 * noise / np.sqrt(self.count)
        by_symbol = {
            "A": (self.power_pv, 2 * self.power_std * noise),
            "B": (self.irregularity_pv, pv_doubt(noise, self.count)),
            "C": (self.symmetric_pv, pv_doubt(noise / np.sqrt(self.ring_count), max(self.count // self.ring_count, 2))),
        }
        for symbol in ("RMSt", "RMSi", "RMSa"):
            low, value, high = (
                float(np.sqrt(max(self.values[symbol] ** 2 - (share * noise) ** 2, 0.0)))
                for share in (1 + NOISE_TOL, 1.0, 1 - NOISE_TOL)
            )
            by_symbol[symbol] = value, float(np.hypot(max(high - value, value - low), mean))
        return by_symbol


def pv_doubt(noise: float, count: int) -> float:
    """Return the expanded uncertainty of the peak to valley of so many heights by their independent noise. [mm]."""
    return float(2 * noise * (np.sqrt(2 * np.log(max(count, 2))) + np.sqrt(0.5)))


def form_components(error: HeightMap, outline: Outline, *, like: HeightMap | None = None) -> FormComponents:
    r"""Split a form error into sphere, rotationally symmetric part and asymmetry, as ISO 10110-5 tolerances them.

    Over a disc, 37 fringe Zernike terms are fitted together by least squares, so that maps made of them are decomposed
    exactly on any grid, although sampled terms are not orthogonal. The sphere is the term :math:`2\rho^2 - 1`: a sphere
    to first order of its departure. The irregularity is the map minus piston, tilt and this term. Its rotationally
    symmetric part consists of the terms without azimuth, and the mean over each ring of the residual of the fit. Over
    any other clear aperture only the first four terms are fitted, about the middle of its box.

    Parameters
    ----------
    error
        Measured minus nominal surface, along the normal or along z; on a grid, or scattered.
    outline
        Clear aperture, whose border is nowhere farther from the map than 3 % of its half-width and 1.5 spacings.
    like
        Grid that scattered points were taken from, for their areas; see `area_rms`.

    Raises
    ------
    InputError
        If the map is smaller than the clear aperture, or does not determine the terms.

    Sources
    -------
    ISO 10110-5:2015, ISO 14999-4:2015. Oracle: closed forms of Zernike terms.

    >>> from turnwright.heightmap import HeightMap
    >>> from turnwright.outline import Outline
    >>> radius, angle = np.linspace(0, 5, 101), np.linspace(0, 2 * np.pi, 72, endpoint=False)
    >>> bowl = HeightMap(radius=radius, angle=angle, z=np.tile(1e-5 * radius**2, (72, 1)))
    >>> parts = form_components(bowl, Outline(disc=5.0))
    >>> round(parts.power_pv * 1e6, 6), round(abs(parts.irregularity_pv) * 1e6, 6)
    (250.0, 0.0)
    """
    require_covered(error, outline)
    low_x, high_x, low_y, high_y = outline.box
    centre = (low_x + high_x) / 2, (low_y + high_y) / 2
    disc = outline.disc is not None and not outline.holes
    x, y = error.points()
    distance = np.hypot(x - centre[0], y - centre[1])
    used = np.isfinite(error.z)
    radius = outline.disc if disc and outline.disc is not None else float(distance[used].max())
    fit = fit_zernike(
        error, terms=DISC_TERMS if disc else OTHER_TERMS, indexing="fringe", normalised=True, radius=radius,
        centre=centre,
    )  # fmt: skip
    residual, terms = fit.residual, fit.terms
    round_terms = {j: c for j, c in terms.items() if j > OTHER_TERMS and zernike_order(j, "fringe")[1] == 0}
    other_terms = {j: c for j, c in terms.items() if j > OTHER_TERMS and j not in round_terms}

    def heights(some: Mapping[int, float]) -> Floats:
        if not some:
            return np.zeros(x.shape)
        made = Zernike(terms=some, radius=radius, indexing="fringe", normalised=True)
        return np.asarray(made.sag(x - centre[0], y - centre[1]))

    rings, ring_count = _ring_means(residual, distance / radius)
    symmetric = np.where(np.isfinite(residual.z), heights(round_terms) + rings, np.nan)
    irregularity = symmetric + heights(other_terms) + residual.z - rings
    # The terms are orthogonal over a disc; the residual of the fit is orthogonal to them on the grid.
    sizes = fit.coefficients if disc else fit.orthonormal
    squares = {j: size**2 for j, size in zip(fit.indices, sizes.tolist(), strict=True)}
    residual_rms = area_rms(residual, like=like)
    asymmetry_rms = area_rms(replace(residual, z=residual.z - rings), like=like)
    irregular = sum(square for j, square in squares.items() if j > OTHER_TERMS) + residual_rms**2
    low, high = (0.0, 1.0) if disc else (float(one(distance[used])) / radius for one in (np.min, np.max))
    height = 2 * float(np.sqrt(3)) * (high**2 - low**2)
    return FormComponents(
        power_pv=height * abs(terms[4]),
        power_std=height * fit.noise_gain[list(fit.indices).index(4)],
        irregularity_pv=_pv(irregularity),
        symmetric_pv=_pv(symmetric),
        rms_total=float(np.sqrt(squares[4] + irregular)),
        rms_irregularity=float(np.sqrt(irregular)),
        rms_asymmetry=float(np.sqrt(sum(squares[j] for j in other_terms) + asymmetry_rms**2)),
        sphere=Zernike(
            terms={j: terms[j] for j in range(1, OTHER_TERMS + 1)}, radius=radius, indexing="fringe", normalised=True
        ).placed(shift=(*centre, 0.0)),
        irregularity=replace(error, z=irregularity, name=f"{error.name} irregularity".strip()),
        symmetric=replace(error, z=symmetric, name=f"{error.name} symmetric part".strip()),
        count=fit.valid,
        ring_count=ring_count,
    )


def _pv(z: Floats) -> float:
    return float(np.nanmax(z) - np.nanmin(z))


def require_covered(error: HeightMap, outline: Outline) -> None:
    """Raise `InputError` unless a map reaches the border of the clear aperture everywhere."""
    if outline.several is not None:
        raise InputError(
            f"the clear aperture has {len(outline.several)} parts, a form error is that of 1 part: judge each alone"
        )
    from scipy.spatial import cKDTree  # noqa: PLC0415 - costly

    few = error.thinned(CHECK_POINTS)
    x, y = few.points()
    valid = np.isfinite(few.z)
    if not valid.any():
        raise InputError("the map has 0 valid heights, a form error needs more: measure the part")
    at = np.stack(outline.border(BORDER_SAMPLES), axis=1)
    away = np.asarray(cKDTree(np.stack([x[valid], y[valid]], axis=1)).query(at)[0])
    far = int(away.argmax())
    gap = SPACING_TOL * float(np.sqrt(outline.area / np.count_nonzero(valid)))
    if few.angle is not None:
        gap = float(np.diff(few.angle).max(initial=0.0)) * outline.reach
    limit = REACH_TOL * float(np.ptp(at, axis=0).max()) / 2 + gap
    if away[far] > limit:
        x_far, y_far = (round(float(one), 6) + 0.0 for one in at[far])
        raise InputError(
            f"the map is smaller than the clear aperture: at its border at x = {x_far:.4g} mm, y = {y_far:.4g} mm the "
            f"nearest height is {away[far]:.3g} mm away, the limit is {limit:.2g} mm: "
            "measure the whole clear aperture"
        )


def _ring_means(residual: HeightMap, distance: Floats) -> tuple[Floats, int]:
    """Return the mean of a map on the ring of each height, and the least number of heights on one."""
    z, means = residual.z, np.full(residual.z.shape, np.nan)
    if residual.polar:
        weight = np.where(np.isnan(z), 0.0, measure(residual).row_width[:, None])
        total = weight.sum(axis=0)
        ring = np.where(np.isnan(z), 0.0, weight * z).sum(axis=0) / np.where(total > 0, total, 1.0)
        counts = np.count_nonzero(np.isfinite(z), axis=0)
        return np.where(np.isnan(z), np.nan, ring), int(counts[counts > 0].min())
    valid = np.flatnonzero(np.isfinite(z))
    order = valid[np.argsort(distance.ravel()[valid], kind="stable")]
    rings = np.array_split(order, int(np.clip(valid.size // MIN_RING_POINTS, 1, MAX_RINGS)))
    for ring in rings:
        means.flat[ring] = z.flat[ring].mean()
    return means, min(ring.size for ring in rings)


def noise_doubt(call_out: CallOut, error: HeightMap, value: float, noise: float) -> float:
    r"""Return the expanded uncertainty (k = 2) of a value of texture, density or slope by the noise of the heights.

    Independent noise of standard deviation :math:`\sigma` adds to a mean square what is in its band, to a slope over a
    length L :math:`\sqrt 2 \sigma / L`, and to a largest slope, a largest height or a density at most several times
    that. It is not subtracted from the value, which it can only have raised.

    Parameters
    ----------
    call_out, error
        See `evaluate_call_out`.
    value
        What that function returned. [mm, rad, or mm³ of a density]
    noise
        Standard deviation of a height. [mm]
    """
    symbol, (short, long) = call_out.limits[0].symbol, call_out.band
    if call_out.standard == "ISO 10110-12":
        each = float(np.sqrt(2)) * noise / long
        return _removed(value, each) if symbol == "rms slope" else pv_doubt(each, error.z.size) / 2
    steps = [
        even_step(axis, "the map", "texture") for _, axis in _axes(error, ("radius",) if error.polar else ("x", "y"))
    ]
    low, high = 1 / long, 1 / (short or 2 * max(steps))
    if symbol == "PSD":
        return min(value, 6 * noise**2 * max(steps) * float(high**call_out.exponent))
    share = np.pi * (high**2 - low**2) * float(np.prod(steps)) if symbol == "Sq" else 2 * (high - low) * max(steps)
    inside = noise * float(np.sqrt(min(share, 1.0)))
    return pv_doubt(inside, error.z.shape[-1]) if symbol == "Rz" else _removed(value, inside)


def _removed(value: float, noise: float) -> float:
    """Return how much of a root mean square is noise that is known to 20 %."""
    return value - float(np.sqrt(max(value**2 - ((1 + NOISE_TOL) * noise) ** 2, 0.0)))


def evaluate_call_out(call_out: CallOut, error: HeightMap) -> float:
    """Return the value that a map has for a call-out of texture, density or slope. [mm, rad, or mm³ of a density].

    A band is that of the mean spectrum of all lines with a Hann window, after removal of a plane; Sq uses all
    directions, Rq and PSD the worse of x and y, of a polar map the radius. A density of exponent B has the largest
    P f^B of the band. Parameters of ISO 21920 are the largest of up to 25 profiles in each direction, over five
    sections, after removal of a straight line. Slopes start at every height, not only at the sampling length, so they
    are never underrated.

    Parameters
    ----------
    call_out
        Of any standard but ISO 10110-5, for which see `form_components`.
    error
        Measured minus nominal surface, on an even grid.

    Raises
    ------
    InputError
        If the map is too short or too coarse for the band.

    Sources
    -------
    ISO 10110-8:2019, ISO 10110-12:2019, ISO 21920-2:2021 and -3:2021. Oracles: closed forms of sines and wedges.

    >>> from turnwright.heightmap import HeightMap
    >>> from turnwright.metrology.call_outs import read_call_out
    >>> x = np.arange(256) * 0.001
    >>> sine = HeightMap(x=x, y=x, z=np.tile(1e-5 * np.sin(2 * np.pi * x / 0.016), (256, 1)))
    >>> round(evaluate_call_out(read_call_out("Sq 8 nm; 0.004/0.1"), sine) * 1e6, 3)   # 10 / sqrt(2)
    7.071
    """
    ways: tuple[Literal["x", "y", "radius"], ...] = ("radius",) if error.polar else ("x", "y")
    symbol = call_out.limits[0].symbol
    if call_out.standard == "ISO 10110-12":
        return _largest_slope(call_out, error, rms=symbol == "rms slope")
    if call_out.standard == "ISO 21920":
        return max(_profile_value(call_out, error, along) for along in ways)
    _require_band(call_out, error, ways)
    short, long = call_out.band
    low, high = 1 / long * (1 - BAND_TOL), 1 / (short or long) * (1 + BAND_TOL)
    if symbol == "Sq":
        return area_psd(error).band_rms_nm(low, high) / NM
    spectra = [line_psd(error, along=along) for along in ways]
    if symbol == "Rq":
        return max(one.band_rms_nm(low, high) for one in spectra) / NM
    values = []
    for one in spectra:
        inside = (one.frequency >= low) & (one.frequency <= high)
        values.append(float((one.density[inside] * one.frequency[inside] ** call_out.exponent).max(initial=0.0)))
    return max(values) / NM**2


def _axes(error: HeightMap, ways: tuple[str, ...]) -> Iterator[tuple[str, Floats]]:
    grid = measure(error)
    for along in ways:
        yield along, grid.rows if along == "y" else grid.columns


def _require_band(call_out: CallOut, error: HeightMap, ways: tuple[str, ...]) -> None:
    """Raise unless a map resolves the shortest wavelength of a band, and is as long as the longest."""
    short, long = call_out.band
    for along, axis in _axes(error, ways):
        step = even_step(axis, f"the map along {along}", "a band of wavelengths")
        extent = step * axis.size
        if short is None or short < 2 * step * (1 - BAND_TOL) or long > extent * (1 + BAND_TOL):
            raise InputError(
                f"the band of {quote(call_out.text)} is {say_length(short or 0.0)} to {say_length(long)}, the map "
                f"resolves {say_length(2 * step)} to {say_length(extent)} along {along}"
            )


def _largest_slope(call_out: CallOut, error: HeightMap, *, rms: bool) -> float:
    sampling, length = call_out.band
    grid = measure(error)
    step = float(max(np.diff(grid.columns).max(), np.diff(grid.rows).max() * grid.stretch.max()))
    if sampling is not None and step > sampling * (1 + BAND_TOL):
        raise InputError(
            f"the sampling length of {quote(call_out.text)} is {say_length(sampling)}, the heights of the map are "
            f"{say_length(step)} apart"
        )
    slopes = slope_error(error, integration_length=length)
    return slopes.rms if rms else slopes.peak


def _profile_value(call_out: CallOut, error: HeightMap, along: Literal["x", "y", "radius"]) -> float:
    """Return the largest parameter of the profiles in one direction that are long enough. [mm]."""
    short, long = call_out.band
    ((_, axis),) = _axes(error, (along,))
    lines = error.z.T if along == "y" else error.z
    field: Callable[[Profile], float] = lambda one: getattr(  # noqa: E731
        profile_roughness(one, cutoff=long, short=short, sections=DEFAULT_SECTIONS),
        f"{call_out.limits[0].symbol.lower()}_nm",
    )
    values, refusal, longest = [], None, 0
    for number in np.unique(np.linspace(0, len(lines) - 1, MAX_LINES).round().astype(np.int64)):
        valid = np.flatnonzero(np.isfinite(lines[number]))
        if valid.size < 2:
            continue
        part = slice(valid[0], valid[-1] + 1)
        try:
            values.append(field(Profile(distance=axis[part], z=lines[number, part], x=axis[part], y=0.0 * axis[part])))
        except InputError as error_of_line:
            if valid.size > longest:  # the longest line tells why best
                refusal, longest = error_of_line, valid.size
    if not values:
        raise refusal or InputError(f"the map has 0 profiles along {along}, texture needs 1: measure more of the part")
    return max(values) / NM
