"""Power spectral densities of maps and profiles, with missing points, and the rms in a band of spatial frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from turnwright._arrays import Bools, Floats, frozen
from turnwright._kernels.rectangle import largest_rectangle
from turnwright._validate import one_of
from turnwright.errors import InputError
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import by_row_blocks, even_rectangle, even_step, measure, valid_points
from turnwright.metrology.profile import without_form
from turnwright.profile import Profile
from turnwright.progress import cores

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

Window: TypeAlias = Literal["none", "hann", "blackman"]
Missing: TypeAlias = Literal["rectangle", "mask"]

NM = 1e6
FEWEST = 8
"""Least number of points along each axis of a spectrum."""

WINDOW_COEFFICIENTS = {"none": (1.0,), "hann": (0.5, -0.5), "blackman": (0.42, -0.5, 0.08)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectrum:
    r"""Power spectral density of lines, or radial mean of that of an area. See `line_psd` and `area_psd`.

    Parameters
    ----------
    frequency
        Middle of each bin; (n,) [1/mm]
    edges
        Borders of the bins; the first and the last of a line's are half as wide as the others. (n + 1,) [1/mm]
    density
        Of lines one-sided: :math:`\int_0 P\,df` is the mean square. [nm² mm] Radial:
        :math:`\int_0 P\,2\pi f\,df` is. [nm² mm²]
    radial
        Whether it is a radial mean.
    count
        Number of lines, or of bins in the outermost ring.
    notes
        Omitted heights and biases of the density.
    """

    frequency: Floats
    edges: Floats
    density: Floats
    radial: bool
    count: int
    notes: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Unit of the density."""
        return "nm² mm²" if self.radial else "nm² mm"

    def band_rms_nm(self, low: float, high: float) -> float:
        """Return the rms between two spatial frequencies [1/mm]; partial bins count in proportion. [nm].

        Raises
        ------
        InputError
            If the band is empty, or begins below 0.
        """
        _require_band(low, high)
        inside = np.clip(self.edges, low, high)
        size = np.diff(np.pi * inside**2 if self.radial else inside)
        return float(np.sqrt(self.density @ size))

    @property
    def rms_nm(self) -> float:
        """Root mean square over all frequencies. [nm]."""
        return self.band_rms_nm(0.0, float("inf"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AreaSpectrum:
    r"""Power spectral density over two spatial frequencies. See `area_psd`.

    Parameters
    ----------
    frequency_x, frequency_y
        Ascending, 0 in the middle. (nx,), (ny,) [1/mm]
    density
        Two-sided: :math:`\iint P\,df_x\,df_y` is the mean square. (ny, nx) [nm² mm²]
    notes
        Omitted heights and biases of the density.
    """

    frequency_x: Floats
    frequency_y: Floats
    density: Floats
    notes: tuple[str, ...] = ()

    @property
    def _steps(self) -> tuple[float, float]:
        return float(np.diff(self.frequency_x).mean()), float(np.diff(self.frequency_y).mean())

    @property
    def _radius(self) -> Floats:
        return np.asarray(np.hypot(self.frequency_x, self.frequency_y[:, None]))

    @property
    def rms_nm(self) -> float:
        """Root mean square over all frequencies. [nm]."""
        return float(np.sqrt(self.density.sum() * np.prod(self._steps)))

    def band_rms_nm(self, low: float, high: float) -> float:
        """Return the rms of spatial frequencies, in any direction, from ``low`` to below ``high`` [1/mm]. [nm].

        A bin counts if its middle lies in the band.
        """
        _require_band(low, high)
        radius = self._radius
        return float(np.sqrt(self.density[(radius >= low) & (radius < high)].sum() * np.prod(self._steps)))

    def radial(self) -> Spectrum:
        """Return the mean over all directions, in rings up to the lower of the two highest frequencies."""
        step = max(self._steps)
        ring = np.rint(self._radius / step).astype(np.int64)
        count = 1 + int(min(self.frequency_x[-1], self.frequency_y[-1]) / step + 1e-9)
        inside = ring < count
        bins = np.bincount(ring[inside], minlength=count)
        density = np.bincount(ring[inside], weights=self.density[inside], minlength=count) / bins
        frequency = np.arange(count) * step
        edges = np.concatenate([[0.0], frequency + step / 2])
        return Spectrum(
            frequency=frozen(frequency, "frequency"),
            edges=frozen(edges, "edges"),
            density=frozen(density, "density"),
            radial=True,
            count=int(bins[-1]),
            notes=(*self.notes, "the corners beyond the highest frequency of either axis are left out"),
        )


def line_psd(
    heights: HeightMap | Profile,
    *,
    along: Literal["x", "y", "radius"] | None = None,
    form: Form = "plane",
    window: Window = "hann",
    missing: Missing = "rectangle",
) -> Spectrum:
    r"""Return the power spectral density of profiles: the mean over all lines of a map, or of one profile.

    .. math:: P(f) = \frac{2\,\Delta}{\sum w^2} \left|\sum_j w_j (z_j - \bar z)\,e^{-2\pi i f j\Delta}\right|^2

    One-sided, in nm² mm. The mean of each line, weighted with the window, is removed.

    Parameters
    ----------
    heights
        A map on an even grid, or a profile.
    along
        The lines of a map: ``"x"`` or ``"y"``, of a polar one ``"radius"``, the radial lines, which cross the turning
        marks.
    form
        Removed first from all valid points, see `remove_form`; of a profile ``"none"``, ``"mean"``, ``"plane"`` (a
        line) or a degree.
    window
        ``"hann"`` and ``"blackman"`` reduce the leakage from the ends of the line; a peak is then two, or three, steps
        wide. ``"none"`` suits a whole number of periods.
    missing
        ``"rectangle"`` uses the largest rectangle of valid points; ``"mask"`` uses all points, with zero weight for
        missing ones, and smears a steep density.

    Raises
    ------
    InputError
        If the grid is uneven or polar and the lines are not, there are fewer than eight points, or a choice is unknown.

    Sources
    -------
    ISO 10110-8:2019; [Heinzel2002]_ for windows. Oracles: closed forms, SciPy's periodogram.
    """
    _require(window, missing)
    if isinstance(heights, Profile):
        profile = without_form(heights, form)
        z, step = profile.z[None], even_step(profile.distance, "the profile", "a spectrum", FEWEST)
        valid = ~np.isnan(z)
        if along is not None:
            raise InputError(f"along is {along!r}, a profile has one direction: leave it out")
    else:
        choices = ("radius",) if heights.polar else ("x", "y")
        if along not in choices:
            listed = " or ".join(f'"{one}"' for one in choices)
            raise InputError(f"along is {along!r}, the lines of this map run along {listed}: choose")
        valid = valid_points(heights, FEWEST, "a spectrum")
        grid = measure(heights)
        z = remove_form(heights, form).z
        axis = grid.rows if along == "y" else grid.columns
        step = even_step(axis, f"the map along {along}", "a spectrum", FEWEST)
        z, valid = (z.T, valid.T) if along == "y" else (z, valid)
    z, notes = _cut(z, valid, missing, (1.0, step), rows=1)
    from scipy import fft  # noqa: PLC0415 - only this needs it

    power, squares, count = _line_power(z, _taper(z.shape[1], window))
    frequency = fft.rfftfreq(z.shape[1], step)
    width = frequency[1]
    edges = np.concatenate([[0.0], frequency[:-1] + width / 2, [0.5 / step]])
    return Spectrum(
        frequency=frozen(frequency, "frequency"),
        edges=frozen(edges, "edges"),
        density=frozen(2 * step * power / squares, "density"),
        radial=False,
        count=count,
        notes=notes,
    )


def area_psd(
    heights: HeightMap, *, form: Form = "plane", window: Window = "hann", missing: Missing = "rectangle"
) -> AreaSpectrum:
    r"""Return the power spectral density of an area, two-sided, in nm² mm².

    .. math:: P(f_x, f_y) = \frac{\Delta_x \Delta_y}{\sum w^2}
        \left|\sum w (z - \bar z)\,e^{-2\pi i (f_x x + f_y y)}\right|^2

    Parameters
    ----------
    heights
        A map on an even rectangular grid.
    form, window, missing
        See `line_psd`; the window is the product of one along x and one along y, over the rectangle, or over the one
        around all valid points.

    Raises
    ------
    InputError
        If the grid is uneven or polar, there are fewer than 8 x 8 points, or a choice is unknown.
    """
    _require(window, missing)
    valid = valid_points(heights, FEWEST, "a spectrum")
    steps = even_rectangle(heights, "the spectrum of an area", FEWEST)[::-1]
    z, notes = _cut(remove_form(heights, form).z, valid, missing, steps, rows=FEWEST)
    from scipy import fft  # noqa: PLC0415 - only this needs it

    absent = np.isnan(z)
    weight = np.multiply.outer(_taper(z.shape[0], window), _taper(z.shape[1], window))
    weight[absent] = 0.0
    z = np.where(absent, 0.0, z)
    z = (z - np.vdot(weight, z) / weight.sum()) * weight * NM
    waves = fft.fftshift(fft.fft2(z, workers=cores()))
    density = (waves.real**2 + waves.imag**2) * (steps[0] * steps[1] / np.vdot(weight, weight))
    frequency_x, frequency_y = (fft.fftshift(fft.fftfreq(z.shape[axis], steps[axis])) for axis in (1, 0))
    return AreaSpectrum(
        frequency_x=frozen(frequency_x, "frequency_x"),
        frequency_y=frozen(frequency_y, "frequency_y"),
        density=frozen(density, "density", ndim=2),
        notes=notes,
    )


def _require(window: str, missing: str) -> None:
    one_of(window, "the window", WINDOW_COEFFICIENTS)
    one_of(missing, "missing", ("rectangle", "mask"))


def _require_band(low: float, high: float) -> None:
    if not 0 <= low < high:
        raise InputError(f"the band is {low:g} to {high:g} /mm, it must rise from 0 /mm or more: correct it")


def _taper(size: int, window: str) -> Floats:
    """Return the window at the middles of the samples' cells. (size,)."""
    turn = 2 * np.pi * (np.arange(size) + 0.5) / size
    return np.asarray(
        sum(share * np.cos(order * turn) for order, share in enumerate(WINDOW_COEFFICIENTS[window])) * np.ones(size)
    )


def _line_power(z: Floats, taper: Floats) -> tuple[Floats, float, int]:
    """Return the power of all lines (columns // 2 + 1,) [nm²], the sum of their squared weights, and their number."""
    blocks = by_row_blocks(lambda rows: _power_of_block(z[rows], taper), z.shape)
    power, squares, count = zip(*blocks, strict=True)
    return np.asarray(np.sum(power, axis=0)), sum(squares), sum(count)


def _power_of_block(lines: Floats, taper: Floats) -> tuple[Floats, float, int]:
    from scipy import fft  # noqa: PLC0415 - only this needs it

    weight, gaps = taper[None], np.isnan(lines)
    if gaps.any():
        weight, lines = np.where(gaps, 0.0, taper), np.where(gaps, 0.0, lines)
    total = weight.sum(axis=1, keepdims=True)
    mean = (weight * lines).sum(axis=1, keepdims=True) / np.where(total > 0, total, 1.0)
    waves = fft.rfft((lines - mean) * (weight * NM), axis=1)
    power = (np.square(waves.real) + np.square(waves.imag)).sum(axis=0)
    repeats = lines.shape[0] // weight.shape[0]
    return power, repeats * float(np.vdot(weight, weight)), repeats * int(np.count_nonzero(total > 0))


def _cut(
    z: Floats, valid: Bools, missing: str, steps: tuple[float, float], *, rows: int
) -> tuple[Floats, tuple[str, ...]]:
    """Return the heights to transform, and a note about those left out."""
    if valid.all():
        return z, ()
    if missing == "rectangle":
        row, tall, column, wide = largest_rectangle(np.ascontiguousarray(valid), steps[1], steps[0])
        part = z[row : row + tall, column : column + wide]
        share = part.size / np.count_nonzero(valid)
        note = (
            f"{100 * share:.3g} % of the valid heights lie in the largest rectangle without gaps, the others are left "
            "out"
        )
    else:
        some_rows, some_columns = np.flatnonzero(valid.any(axis=1)), np.flatnonzero(valid.any(axis=0))
        part = z[some_rows[0] : some_rows[-1] + 1, some_columns[0] : some_columns[-1] + 1]
        note = (
            f"{100 * np.isnan(part).mean():.3g} % of the heights are missing: the spectrum of the mask smears the "
            "density, so a steep density reads too high where it is low"
        )
    if part.shape[0] < rows or part.shape[1] < FEWEST:
        raise InputError(
            f"the part of the map for the spectrum has {part.shape[0]} x {part.shape[1]} points, the least is {rows} x "
            f'{FEWEST}: map more of the part, or use missing="mask"'
        )
    return part, (note,)
