r"""Instrument models: turn a predicted surface into what an instrument would measure.

An interference microscope images the complex reflectance of the surface. Heights that are small against the wavelength
pass through a linear filter. For a source that fills the fraction :math:`s` of the aperture, the transfer function at
the spatial frequency :math:`\nu` is the overlap of two discs of radius 1 and :math:`s` at the distance
:math:`d = \nu\lambda/\mathrm{NA}`, over the area of the smaller disc. :math:`s = 1` gives the optical transfer function
of incoherent light,

.. math:: T(\nu) = \tfrac{2}{\pi}\left(\arccos q - q\sqrt{1 - q^2}\right), \qquad q = \nu\lambda / 2\,\mathrm{NA},

and :math:`s = 0` that of coherent light, which passes all frequencies up to :math:`\mathrm{NA}/\lambda` and none above.
A pixel of side :math:`p` averages: :math:`\operatorname{sinc}(p\nu_x)\operatorname{sinc}(p\nu_y)`. A stylus traces the
grey-scale dilation of the surface by its ball, which is not linear and has no transfer function.

Sources
-------
[deGroot2024]_ for the linear regime of heights, [Goodman2005]_ for the overlap of the pupils, ISO 16610-41 for the
ball.
Oracles: closed forms of sines and cusps, a sphere over a ball, a brute-force overlap.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, is_even
from turnwright._faults import read_table
from turnwright._io import bytes_of, read_toml
from turnwright._tables import Loaded, TableModel
from turnwright._validate import between, check_numbers, positive, whole_number
from turnwright.errors import InputError, quote
from turnwright.heightmap import HeightMap
from turnwright.profile import Profile
from turnwright.units import Length, Number, Text

__all__ = ["Instrument"]

MIN_STEPS_PER_RESOLUTION = 2
MIN_STEPS_PER_BALL = 10
"""Steps per stylus radius; between the points the ball dips by at most 1/800 of the radius."""

PADDING_LENGTHS = 40
"""Resolved lengths by which a surface is extended beyond its borders, as a diffraction image decays slowly."""

MAX_BALL_POINTS = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument(TableModel):
    """An instrument that measures surfaces: its resolution and noise.

    Fields that are not given have no effect: an instrument with only a pixel just averages over it.

    Parameters
    ----------
    pixel
        Side of a pixel on the surface, over which the heights are averaged. [mm]
    numerical_aperture, wavelength
        Numerical aperture of the objective and mean wavelength of the light; both or none. [mm]
    resolution
        In place of these, the optical resolution wavelength / (2 NA): periods below it are not transmitted. [mm]
    filling
        Fraction of the aperture that the source fills: 1 for incoherent light, 0 for coherent.
    stylus_radius
        Radius of the stylus ball. [mm]
    noise
        Standard deviation of each height, independent of its neighbours. [mm]
    name, source
        Name of the instrument, and source of its data.
    loaded
        Name given to `load` and the value it loaded; ``None`` for an instrument that was not loaded.

    Raises
    ------
    InputError
        If a length is not positive, the optics are incomplete or given twice, or the aperture is above 1.5.

    >>> microscope = Instrument.load("zygo-nexview-10x")
    >>> [round(float(one), 3) for one in microscope.transfer([0.0, 100.0, 1060.0])]   # periods of 10 um and 0.94 um
    [1.0, 0.868, 0.0]
    """

    hidden = ("loaded",)
    pixel: Length | None = None
    numerical_aperture: Number | None = None
    wavelength: Length | None = None
    resolution: Length | None = None
    filling: Number = 1.0
    stylus_radius: Length | None = None
    noise: Length = 0.0
    name: Text = ""
    source: Text = ""
    loaded: Loaded | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("pixel", "wavelength", "resolution", "stylus_radius"):
            if getattr(self, name) is not None:
                positive(getattr(self, name), name, "mm")
        if (self.numerical_aperture is None) != (self.wavelength is None):
            raise InputError("numerical_aperture and wavelength must be given together: give both or none")
        if self.numerical_aperture is not None:
            if not 0 < self.numerical_aperture <= 1.5:
                raise InputError(
                    f"numerical_aperture is {self.numerical_aperture:g}, the limits are 0 and 1.5: correct it"
                )
            if self.resolution is not None:
                raise InputError(
                    "resolution is given next to numerical_aperture and wavelength, only one of the two is allowed: "
                    "remove one"
                )
        between(self.filling, "filling", 0.0, 1.0, "")
        between(self.noise, "noise", 0.0, 1.0, "mm")

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the names of the instruments that come with Turnwright."""
        return tuple(_presets())

    @classmethod
    def load(cls, name: str | Path) -> Instrument:
        """Return an instrument that comes with Turnwright, or one described in a file.

        Parameters
        ----------
        name
            One of `known`, or the path of a ``.toml`` file of the fields, lengths with their units.

        Raises
        ------
        InputError
            If there is no such instrument, or its file is wrong; the message names the key.
        """
        presets = _presets()
        if str(name) in presets:
            return _read(presets[str(name)], str(name), str(name))
        path = Path(name)
        if path.suffix != ".toml":
            raise InputError(
                f"there is no instrument {quote(str(name))}, the known ones are {', '.join(presets)}: choose one, or "
                "name a .toml file"
            )
        table = read_toml(bytes_of(path, "instrument file"), f"instrument file {str(path)!r}")
        return _read(table, path.stem, str(name))

    @property
    def summary(self) -> str:
        """Resolution and noise in words."""
        values = {
            "pixel {:.3g} um": (self.pixel or 0.0) * 1e3,
            "optics pass periods above {:.3g} um": 1e3 / self.cutoff,
            "stylus radius {:.3g} um": (self.stylus_radius or 0.0) * 1e3,
            "noise {:.3g} nm": self.noise * 1e6,
        }
        return ", ".join(text.format(value) for text, value in values.items() if value) or "no limits"

    @property
    def cutoff(self) -> float:
        """Highest spatial frequency that the optics transmit; infinite without optics. [1/mm]."""
        if self.numerical_aperture is not None and self.wavelength is not None:
            return (1 + self.filling) * self.numerical_aperture / self.wavelength
        return (1 + self.filling) / (2 * self.resolution) if self.resolution is not None else np.inf

    def transfer(self, frequency_x: ArrayLike, frequency_y: ArrayLike = 0.0) -> Floats:
        """Return the transfer function of optics and pixel: measured over true amplitude of a sine.

        Parameters
        ----------
        frequency_x, frequency_y
            Spatial frequencies of the sine along x and y. Broadcast [1/mm]
        """
        along, across = np.asarray(frequency_x, dtype=np.float64), np.asarray(frequency_y, dtype=np.float64)
        passed: Floats = np.ones(np.broadcast_shapes(along.shape, across.shape))
        if np.isfinite(self.cutoff):
            passed = _overlap(np.hypot(along, across) * (1 + self.filling) / self.cutoff, self.filling)
        if self.pixel is not None:
            passed = passed * np.sinc(along * self.pixel) * np.sinc(across * self.pixel)
        return passed

    @overload
    def see(self, surface: Profile, *, like: Profile | None = None, seed: int | None = None) -> Profile: ...
    @overload
    def see(self, surface: HeightMap, *, like: HeightMap | None = None, seed: int | None = None) -> HeightMap: ...

    def see(self, surface: Any, *, like: Any = None, seed: int | None = None) -> Any:
        """Return a surface as the instrument measures it.

        The steps are: dilation by the stylus ball, filter of optics and pixel, interpolation at the points of another
        measurement, noise. A profile is taken as a cut across grooves, with no variation across the profile. Beyond
        its borders a surface is extended by point reflection, which keeps its slope. Missing heights stay missing;
        within a few resolution lengths of them, the result depends on the nearest heights.

        Parameters
        ----------
        surface
            A profile, or a map on a rectangular grid, evenly spaced by at most half the larger of pixel and optical
            resolution, and at most a tenth of the stylus radius.
        like
            A measured profile or map; the result is interpolated at its points by cubic splines. Without it the points
            of ``surface`` are kept.
        seed
            Seed of the noise to add; without it the result has no noise.

        Raises
        ------
        InputError
            If the grid is uneven, polar or too coarse, or ``like`` extends beyond the surface.
        """
        if isinstance(surface, Profile):
            z, steps = surface.z[None], (np.inf, surface.step)
        else:
            z, steps = surface.z, _steps(surface)
        self._require_fine(max(step for step in steps if np.isfinite(step)))
        missing = np.isnan(z)
        if missing.all():
            raise InputError("the surface has 0 valid heights, an instrument needs at least 1: measure more of it")
        if self.stylus_radius is not None:
            z = _roll_ball(z, missing, steps, self.stylus_radius)
        if self.pixel is not None or np.isfinite(self.cutoff):
            z = self._averaged(z, missing, steps)
        z = np.where(missing, np.nan, z)
        measured = replace(surface, z=z[0] if isinstance(surface, Profile) else z)
        measured = measured if like is None else _resample(measured, like)
        if seed is not None and self.noise > 0:
            random = np.random.default_rng(whole_number(seed, "the seed", 0))
            measured = replace(measured, z=measured.z + self.noise * random.standard_normal(measured.z.shape))
        return measured

    @property
    def finest(self) -> float:
        """Shortest length that optics and pixel resolve. [mm]."""
        return max(self.pixel or 0.0, 1 / self.cutoff)

    @property
    def max_step(self) -> float:
        """Largest step of a surface that `see` takes; infinite without any limit. [mm]."""
        ball = np.inf if self.stylus_radius is None else self.stylus_radius / MIN_STEPS_PER_BALL
        return min(self.finest / MIN_STEPS_PER_RESOLUTION or np.inf, ball)

    def _require_fine(self, step: float) -> None:
        if step > self.max_step * (1 + 1e-6):
            raise InputError(
                f"the surface has steps of {step * 1e3:.3g} um, the limit for this instrument is "
                f"{self.max_step * 1e3:.3g} um: use a finer grid"
            )

    def _averaged(self, z: Floats, missing: Bools, steps: tuple[float, float]) -> Floats:
        """Return heights filtered by optics and pixel, by the convolution theorem."""
        from scipy import fft  # noqa: PLC0415 - only this needs it

        z = _fill_missing(z, missing)
        pads = [
            min(int(np.ceil(PADDING_LENGTHS * self.finest / step)), size - 1) if np.isfinite(step) else 0
            for size, step in zip(z.shape, steps, strict=True)
        ]
        wide = np.pad(z, [(pad, pad) for pad in pads], mode="reflect", reflect_type="odd")
        # The transform is periodic: removing a straight line makes the two ends meet.
        trend = sum(_closing_line(wide, axis) for axis in (0, 1))
        shape = wide.shape
        frequencies = [
            fft.fftfreq(shape[0], steps[0]) if np.isfinite(steps[0]) else np.zeros(shape[0]),
            fft.rfftfreq(shape[1], steps[1]),
        ]
        passed = self.transfer(frequencies[1], frequencies[0][:, None])
        smooth = fft.irfft2(fft.rfft2(wide - trend) * passed, shape) + trend
        return np.asarray(smooth[pads[0] : shape[0] - pads[0], pads[1] : shape[1] - pads[1]])


def _presets() -> dict[str, dict[str, Any]]:
    return read_toml((resources.files("turnwright") / "instruments.toml").read_bytes(), "instruments.toml")


def _read(table: dict[str, Any], name: str, source: str) -> Instrument:
    instrument = read_table(Instrument, {"name": name, **table}, f"instrument {name!r}")
    return replace(instrument, loaded=Loaded(source, instrument))


def _overlap(distance: Floats, filling: float) -> Floats:
    """Return the overlap of two discs of radius 1 and ``filling``, over the area of the smaller, by their distance."""
    far, near = 1 + filling, 1 - filling
    if filling < 1e-9:
        return np.where(distance < 1, 1.0, 0.0)
    between_them = (distance > near) & (distance < far)
    d = np.where(between_them, distance, 0.5 * (near + far))
    large = np.arccos(np.clip((d * d + 1 - filling**2) / (2 * d), -1, 1))
    small = np.arccos(np.clip((d * d + filling**2 - 1) / (2 * d * filling), -1, 1))
    kite = 0.5 * np.sqrt(np.maximum((far - d) * (d - near) * (d + near) * (d + far), 0.0))
    shared = (large + filling**2 * small - kite) / (np.pi * filling**2)
    return np.where(between_them, shared, np.where(distance <= near, 1.0, 0.0))


def _steps(heights: HeightMap) -> tuple[float, float]:
    """Return the steps of a rectangular grid along y and x; infinite for a single row or column. [mm]."""
    heights.require_calibrated()
    if heights.polar or heights.scattered or heights.x is None or heights.y is None:
        raise InputError(
            f"the map has {'a polar grid' if heights.polar else 'scattered points'}, an instrument needs a rectangular "
            "grid: generate the surface on one"
        )
    steps = []
    for name, axis in (("y", heights.y), ("x", heights.x)):
        if axis.size > 1 and not is_even(axis):
            raise InputError(f"the steps of {name} are uneven, an instrument needs even steps: interpolate the map")
        steps.append(float(np.diff(axis).mean()) if axis.size > 1 else np.inf)
    return steps[0], steps[1]


def _fill_missing(z: Floats, missing: Bools) -> Floats:
    """Return heights with missing ones replaced by the nearest valid height."""
    if not missing.any():
        return z
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(z[tuple(nearest)])


def _closing_line(z: Floats, axis: int) -> Floats:
    """Return the line along one axis whose removal makes the mean heights of both ends equal. (ny, nx)."""
    size = z.shape[axis]
    if size < 3:
        return np.zeros(z.shape)
    rise = float((z.take(-1, axis) - z.take(0, axis)).mean()) / (size - 1)
    line = rise * (np.arange(size) - (size - 1) / 2)
    return np.broadcast_to(line[:, None] if axis == 0 else line[None], z.shape)


def _roll_ball(z: Floats, missing: Bools, steps: tuple[float, float], radius: float) -> Floats:
    """Return the trace of the lowest point of a ball rolled over heights. Missing heights do not touch the ball."""
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    # Beyond this distance the ball is higher above its lowest point than the surface varies.
    rise = float(np.nanmax(z) - np.nanmin(z))
    reach = radius if rise >= radius else np.sqrt(rise * (2 * radius - rise))
    away = []
    for size, step in zip(z.shape, steps, strict=True):
        count = min(int(reach / step), size - 1) if np.isfinite(step) else 0
        away.append(np.arange(-count, count + 1) * (step if np.isfinite(step) else 0.0))
    square = away[0][:, None] ** 2 + away[1] ** 2
    if square.size > MAX_BALL_POINTS:
        raise InputError(
            f"the ball of {radius * 1e3:g} um covers {square.size:,} points of the surface, the limit is "
            f"{MAX_BALL_POINTS:,}: use a coarser grid"
        )
    under = square <= radius**2
    ball = np.sqrt(np.where(under, radius**2 - square, 0.0)) - radius
    traced: Floats = np.empty_like(z)
    ndimage.grey_dilation(  # type: ignore[call-overload] # its stubs take no structure of floats
        np.where(missing, -np.inf, z), footprint=under, structure=ball, output=traced, mode="constant", cval=-np.inf
    )
    return traced


def _resample(seen: HeightMap | Profile, like: HeightMap | Profile) -> HeightMap | Profile:
    """Return heights interpolated at the points of another profile or grid by cubic splines."""
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    if isinstance(seen, Profile):
        if not isinstance(like, Profile):
            raise InputError("a profile is compared with a map: extract a line of the map first (line_profile)")
        axes, targets, z = [seen.distance], [like.distance], seen.z
    else:
        if not isinstance(like, HeightMap) or like.x is None or like.y is None or like.scattered:
            raise InputError("like must be a map on a rectangular grid: give one")
        assert seen.x is not None  # noqa: S101 - a rectangular grid has x and y
        assert seen.y is not None  # noqa: S101
        axes, targets, z = [seen.y, seen.x], [like.y, like.x], seen.z
    places = []
    for axis, at in zip(axes, targets, strict=True):
        step = (axis[-1] - axis[0]) / max(axis.size - 1, 1) or 1.0
        place = (at - axis[0]) / step
        if place.min() < -1e-6 or place.max() > axis.size - 1 + 1e-6:
            raise InputError(
                f"the measured points reach from {at[0]:g} to {at[-1]:g} mm, the surface from {axis[0]:g} to "
                f"{axis[-1]:g} mm: simulate a larger area"
            )
        places.append(place)
    missing = np.isnan(z)
    grid = np.meshgrid(*places, indexing="ij")
    resampled = ndimage.map_coordinates(_fill_missing(z, missing), grid, order=3, mode="mirror")
    if missing.any():
        resampled[ndimage.map_coordinates(missing.astype(np.float64), grid, order=1, mode="nearest") > 1e-9] = np.nan
    return replace(like, z=resampled, name=f"{seen.name} as measured".strip())
