"""Scatter and diffraction of a finely sampled patch of a surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from turnwright._arrays import Complexes, Floats, is_even
from turnwright._validate import check_numbers, check_wavelength, whole_number
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import Form, remove_form
from turnwright.optics.orders import path_factor
from turnwright.optics.pupil import phasors

__all__ = ["Order", "Scatter", "scatter"]

FEWEST_PIXELS = 16

REFINEMENTS = 12
"""Halvings of the frequency step around a peak."""

PEAK_STEPS = 4
"""Frequency steps of the patch around a peak that belong to it: half the main lobe of the window, and one."""

FAINTEST = 1e-6
"""Share of the light below which an order is not listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """One diffraction order of a patch.

    Parameters
    ----------
    frequency
        Spatial frequency along x and y. [1/mm]
    angle
        Angle from the specular direction at normal incidence, in air; nan if the order does not propagate. [rad]
    efficiency
        Share of the light.
    """

    frequency: tuple[float, float]
    angle: float
    efficiency: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """Where a patch of a surface sends light. See `scatter`.

    Parameters
    ----------
    texture
        Heights of the patch without its form, on an even grid. [mm]
    gain
        Optical path for each height, see `path_factor`.
    wavelength
        Wavelength in air. [mm]
    """

    texture: HeightMap
    gain: float
    wavelength: float

    def __post_init__(self) -> None:
        check_numbers(self)
        check_wavelength(self.wavelength)

    @property
    def specular(self) -> float:
        """Share of the light in the specular direction."""
        light, weight = self._light
        return float(abs(light.sum() / weight.sum()) ** 2)

    @property
    def tis(self) -> float:
        """Total integrated scatter: the share outside the specular direction, diffraction orders included."""
        return 1.0 - self.specular

    def orders(self, most: int = 20) -> tuple[Order, ...]:
        """Return the brightest diffraction orders other than the specular one, the brightest first.

        An order is a peak of the spectrum; scatter without direction has none of its own, and the peaks are then those
        of its speckle.
        """
        light, weight = self._light
        amplitude = light / weight.sum()
        size = [2 * count for count in amplitude.shape]
        share = np.abs(np.fft.fft2(amplitude, size)) ** 2
        x, y = self._axes
        steps = [1 / (count * float(axis[1] - axis[0])) for count, axis in ((size[1], x), (size[0], y))]
        _clear(share, (0, 0))
        peaks: list[Order] = []
        for _ in range(whole_number(most, "most", 1, 1000)):
            row, column = (int(at) for at in np.unravel_index(share.argmax(), share.shape))
            if share[row, column] < FAINTEST:
                break
            _clear(share, (row, column))
            start = [(at + count // 2) % count - count // 2 for at, count in ((column, size[1]), (row, size[0]))]
            frequency, efficiency = self._peak(amplitude, (start[0] * steps[0], start[1] * steps[1]), steps)
            sine = self.wavelength * math.hypot(*frequency)
            peaks.append(
                Order(frequency=frequency, angle=math.asin(sine) if sine <= 1 else math.nan, efficiency=efficiency)
            )
        return tuple(sorted(peaks, key=lambda order: -order.efficiency))

    def bsdf(self, bins: int = 60) -> tuple[Floats, Floats]:
        """Return the scatter distribution function against the angle, averaged over the azimuth.

        Returns
        -------
        tuple
            Angles from the specular direction at normal incidence [rad] and BSDF [1/sr], without the specular peak, up
            to the finest structure that the pixels resolve. Each (n,)
        """
        light, weight = self._light
        density = np.abs(np.fft.fft2(light)) ** 2
        x, y = self._axes
        pixel = x[1] - x[0], y[1] - y[0]
        # The integral over all frequencies is 1, and cos(t) dOmega = wavelength² dfx dfy.
        density *= pixel[0] * pixel[1] / (weight**2).sum() / self.wavelength**2
        fx, fy = np.meshgrid(np.fft.fftfreq(x.size, pixel[0]), np.fft.fftfreq(y.size, pixel[1]))
        sine = self.wavelength * np.hypot(fx, fy)
        lowest = PEAK_STEPS * self.wavelength / min(np.ptp(x), np.ptp(y))
        highest = min(1.0, self.wavelength / 2 / max(pixel))
        edges = np.linspace(lowest, highest, whole_number(bins, "bins", 1, 10_000) + 1)
        count, _ = np.histogram(sine, edges)
        total, _ = np.histogram(sine, edges, weights=density)
        full = count > 0
        return np.arcsin((edges[:-1] + edges[1:])[full] / 2), total[full] / count[full]

    @property
    def _axes(self) -> tuple[Floats, Floats]:
        assert self.texture.x is not None  # noqa: S101 - checked by `scatter`
        assert self.texture.y is not None  # noqa: S101
        return self.texture.x, self.texture.y

    @property
    def _light(self) -> tuple[Complexes, Floats]:
        """Light at each height times the window, and the window. Each (ny, nx)."""
        rows, columns = (np.sin(math.pi * (np.arange(count) + 0.5) / count) ** 4 for count in self.texture.z.shape)
        measured = np.isfinite(self.texture.z)
        weight = rows[:, None] * columns * measured
        return weight * phasors(self.gain * np.where(measured, self.texture.z, 0.0), self.wavelength), weight

    def _peak(
        self, amplitude: Complexes, start: tuple[float, float], steps: list[float]
    ) -> tuple[tuple[float, float], float]:
        """Return the frequency and the share of the light at the peak next to a frequency."""
        x, y = self._axes

        def share(at: tuple[float, float]) -> float:
            value = np.exp(-2j * math.pi * at[1] * y) @ amplitude @ np.exp(-2j * math.pi * at[0] * x)
            return float(abs(value) ** 2)

        best, top, reach = start, share(start), 0.5
        for _ in range(REFINEMENTS):
            for way in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                at = (best[0] + reach * way[0] * steps[0], best[1] + reach * way[1] * steps[1])
                if (value := share(at)) > top:
                    best, top = at, value
            reach /= 2
        return best, top


def _clear(share: Floats, at: tuple[int, int]) -> None:
    """Remove a peak from a spectrum of twice the resolution."""
    reach = np.arange(-2 * PEAK_STEPS, 2 * PEAK_STEPS + 1)
    share[np.ix_((at[0] + reach) % share.shape[0], (at[1] + reach) % share.shape[1])] = 0.0


def scatter(
    error: HeightMap,
    *,
    wavelength: float,
    index: float | None = None,
    incidence: float = 0.0,
    form: Form = "plane",
) -> Scatter:
    """Return the scatter and the diffraction orders of a patch, such as the cusps of turning.

    Parameters
    ----------
    error
        Heights or errors on an even rectangular grid whose pixels resolve the marks. [mm]
    wavelength, index, incidence
        See `cusp_orders`. [mm, 1, rad]
    form
        Form removal, see `turnwright.roughness`.

    Raises
    ------
    InputError
        If the map is not an even rectangular grid of at least 16 pixels each way.

    Notes
    -----
    The patch is weighted by the fourth power of a sine along each side, so that orders do not leak into one another;
    they are resolved where the patch is several periods wide. With n pixels per period the light of order m is within
    about 3 m²/n² of its share, the total scatter within 5/n².

    Sources
    -------
    [Harvey2012]_ for the scalar spectrum of phases; [Stover2012]_ for the BSDF. Oracle: `cusp_orders` in closed form.

    >>> x = (np.arange(2000) + 0.5) * 0.1e-3
    >>> cusps = ((x % 0.010) - 0.005) ** 2 / (2 * 0.514)
    >>> patch = HeightMap(x=x, y=x[:50], z=np.tile(cusps, (50, 1)))
    >>> marks = scatter(patch, wavelength=633e-6, form="mean")
    >>> [round(one.efficiency, 4) for one in marks.orders(2)], round(marks.specular, 4)
    ([0.0095, 0.0095], 0.9795)
    """
    error.require_calibrated()
    even = error.x is not None and error.y is not None and is_even(error.x) and is_even(error.y)
    if not even or error.scattered or min(error.z.shape) < FEWEST_PIXELS:
        raise InputError(
            f"the map {error.name!r} has the shape {error.z.shape}, scatter needs an even rectangular grid of at least "
            f"{FEWEST_PIXELS} pixels each way: predict or measure a patch"
        )
    return Scatter(
        texture=remove_form(error, form),
        gain=float(path_factor(index=index, incidence=incidence)),
        wavelength=wavelength,
    )
