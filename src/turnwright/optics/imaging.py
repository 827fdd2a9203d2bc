"""The wavefront that a surface with an error leaves, and the images that it makes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, frozen
from turnwright._validate import (
    between,
    check_numbers,
    check_obscuration,
    check_wavelength,
    finite_tuple,
    one_of,
    positive,
)
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import ZernikeFit, fit_zernike
from turnwright.optics.orders import path_factor
from turnwright.optics.pupil import PathMap, phasors, pupil_nodes
from turnwright.surface import Indexing, Plane, Surface

__all__ = ["Modulation", "PointSpread", "Removed", "Wavefront", "incidence_angles", "path_per_height", "wavefront"]

Removed: TypeAlias = Literal["none", "piston", "tilt", "focus"]
Source: TypeAlias = float | tuple[float, float, float]
REMOVED = ("none", "piston", "tilt", "focus")

NODES, PSF_NODES, MTF_NODES = (96, 1200), (96, 320), (64, 192)
"""Least and most nodes along a chord of the pupil, for a point spread, and for each frequency of an MTF; in between two
for each step of the map, or one in an image."""

FINE_MAP = 600
"""Points along a side of a rectangular map above which its own points are the nodes, so that no ripple is lost."""

LEAST_COVERED = 0.95
"""Share of a stated pupil for which the map must have heights; holes in it are no part of the pupil."""

FREQUENCIES, IMAGE_POINTS, IMAGE_WIDTH = 33, 129, 16.0
"""Frequencies of an MTF, points along a point spread, and its width in wavelengths over the pupil's diameter."""

MOST_IMAGE_POINTS = 4097


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointSpread:
    """Image of a point. See `Wavefront.psf`.

    Parameters
    ----------
    x, y
        Positions in the image. (n,) [rad] or, with a focal length, [mm]
    intensity
        Relative to the peak without errors. (n, n)
    """

    x: Floats
    y: Floats
    intensity: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Modulation:
    """Modulation transfer of an image along x and along y. See `Wavefront.mtf`.

    Parameters
    ----------
    frequency
        Spatial frequencies. (n,) [1/rad] or, with a focal length, [1/mm]
    x, y
        Modulation of gratings that vary along x, and along y. Each (n,)
    cutoff
        Frequency beyond which nothing is transmitted. [1/rad or 1/mm]
    """

    frequency: Floats
    x: Floats
    y: Floats
    cutoff: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wavefront:
    """Optical path differences over a circular pupil. See `wavefront`.

    Parameters
    ----------
    opd
        Optical path that the light gains by the error. [mm]
    wavelength
        Wavelength in air. [mm]
    radius, centre
        Semi-diameter and centre of the pupil on the map. [mm]
    obscuration
        Radius of the central obscuration over that of the pupil.
    specular
        Share of the light that the tool marks leave in the specular order, see `scatter`; it lowers the Strehl ratio,
        the point spread and, beyond the lowest frequencies, the MTF.
    """

    opd: HeightMap
    wavelength: float
    radius: float
    centre: tuple[float, float] = (0.0, 0.0)
    obscuration: float = 0.0
    specular: float = 1.0
    _path: PathMap = field(init=False, repr=False, compare=False)
    _samples: tuple[Floats, Floats, Floats, Floats] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        check_wavelength(self.wavelength)
        positive(self.radius, "the radius of the pupil", "mm")
        object.__setattr__(self, "centre", finite_tuple(self.centre, "the centre of the pupil", 2))
        check_obscuration(self.obscuration)
        between(self.specular, "specular", 0.0, 1.0, "of the light")
        self.opd.require_calibrated()
        object.__setattr__(self, "_path", PathMap(self.opd))
        object.__setattr__(self, "_samples", self._sample())

    @property
    def strehl(self) -> float:
        """Intensity at the image point relative to that without errors, by the integral over the pupil."""
        _, _, path, weight = self._samples
        return float(abs((weight * phasors(path, self.wavelength)).sum() / weight.sum()) ** 2) * self.specular

    @property
    def rms(self) -> float:
        """Root mean square of the path differences over the pupil, about their mean. [mm]."""
        _, _, path, weight = self._samples
        mean = np.average(path, weights=weight)
        return float(np.sqrt(np.average((path - mean) ** 2, weights=weight)))

    @property
    def rms_waves(self) -> float:
        """The same in wavelengths."""
        return self.rms / self.wavelength

    @property
    def covered(self) -> float:
        """Share of the area of the pupil for which the map has heights."""
        outer, inner = self._radii
        return float(self._samples[3].sum() / (math.pi * (outer * outer - inner * inner)))

    def zernike(self, terms: int | tuple[int, ...] = 37, indexing: Indexing = "fringe") -> ZernikeFit:
        """Return the Zernike decomposition over the pupil. See `turnwright.metrology.fit_zernike`."""
        return fit_zernike(self.opd, terms=terms, indexing=indexing, radius=self.radius, centre=self.centre)

    def psf(
        self, *, width: float | None = None, points: int = IMAGE_POINTS, focal_length: float | None = None
    ) -> PointSpread:
        """Return the image of a point, by the matrix Fourier transform of the pupil.

        Parameters
        ----------
        width
            Width of the square; 16 wavelengths over the diameter of the pupil if left out. [rad], or [mm]
        points
            Points along each side.
        focal_length
            Focal length, for positions in the image plane. [mm]
        """
        if not 2 <= points <= MOST_IMAGE_POINTS:
            raise InputError(f"points is {points}, the limits are 2 and {MOST_IMAGE_POINTS}: change it")
        scale = 1.0 if focal_length is None else positive(focal_length, "focal_length", "mm")
        extent = IMAGE_WIDTH * self.wavelength / (2 * self.radius) * scale if width is None else width
        image = positive(extent, "width", "rad" if focal_length is None else "mm") * np.linspace(-0.5, 0.5, points)
        wave_number = 2 * math.pi / (self.wavelength * scale) * image
        nodes = pupil_nodes(self._radii, 0.0, self._count(PSF_NODES))
        path, measured = self._at(nodes.x, nodes.y)
        weight = nodes.weight * measured
        light = weight * phasors(path, self.wavelength)
        rows = np.array([one @ np.exp(-1j * np.outer(x, wave_number)) for x, one in zip(nodes.x, light, strict=True)])
        amplitude = np.exp(-1j * np.outer(wave_number, nodes.y[:, 0])) @ rows
        intensity = np.abs(amplitude / weight.sum()) ** 2 * self.specular
        return PointSpread(
            x=frozen(image, "x"), y=frozen(image, "y"), intensity=frozen(intensity, "intensity", ndim=2)
        )  # fmt: skip

    def mtf(self, frequency: ArrayLike | None = None, *, focal_length: float | None = None) -> Modulation:
        """Return the modulation transfer along x and y, by the autocorrelation of the pupil.

        Parameters
        ----------
        frequency
            Spatial frequencies, 0 or more; 33 up to the cutoff if left out. (n,) [1/rad] or, with a focal length,
            [1/mm]
        focal_length
            Focal length, for frequencies in the image plane. [mm]

        Notes
        -----
        Each frequency is integrated over the exact overlap of the two displaced pupils. Tool marks scatter out of the
        image: they lower every frequency above about feed / (wavelength · focal length) by the specular share.
        """
        scale = 1.0 if focal_length is None else positive(focal_length, "focal_length", "mm")
        cutoff = 2 * self.radius / (self.wavelength * scale)
        at = frozen(np.linspace(0.0, cutoff, FREQUENCIES) if frequency is None else frequency, "frequency")
        if (at < 0).any():
            raise InputError(f"frequency is {at.min():g}, it cannot be below 0: give its size")
        area = self._transfer(0.0, (1.0, 0.0)).real
        x, y = (
            np.array([abs(self._transfer(nu * self.wavelength * scale, way)) / area for nu in at])
            for way in ((1.0, 0.0), (0.0, 1.0))
        )
        lowered = np.where(at > 0, self.specular, 1.0)
        return Modulation(
            frequency=at, x=frozen(x * lowered, "modulation"), y=frozen(y * lowered, "modulation"), cutoff=cutoff
        )  # fmt: skip

    def _transfer(self, shift: float, way: tuple[float, float]) -> complex:
        """Return the autocorrelation of the pupil at a shift along a direction. [mm²]."""
        nodes = pupil_nodes(self._radii, shift, self._count(MTF_NODES))
        phases, weight = np.ones(nodes.x.shape, dtype=np.complex128), nodes.weight
        for side in (1, -1):
            along = nodes.x + side * shift / 2
            path, measured = self._at(along * way[0] - nodes.y * way[1], along * way[1] + nodes.y * way[0])
            weight = weight * measured
            phases *= phasors(side * path, self.wavelength)
        return complex((weight * phases).sum())

    @property
    def _radii(self) -> tuple[float, float]:
        """Radii of the pupil and of its obscuration. [mm]."""
        return self.radius, self.radius * self.obscuration

    def _count(self, limits: tuple[int, int], per_step: int = 1) -> int:
        """Return the nodes along a chord."""
        return int(np.clip(per_step * max(self.opd.z.shape), *limits))

    def _sample(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Points from the centre, path differences and weights over the pupil. Each (n,) [mm, mm, mm, mm²]."""
        if self.opd.x is not None and self.opd.y is not None and max(self.opd.z.shape) > FINE_MAP:
            outer, inner = self._radii
            x, y = (one - middle for one, middle in zip(self.opd.points(), self.centre, strict=True))
            radius = np.hypot(x, y)
            on = np.isfinite(self.opd.z) & (radius <= outer) & (radius >= inner)
            weight = np.outer(np.gradient(self.opd.y), np.gradient(self.opd.x))
            return x[on], y[on], self.opd.z[on], weight[on]
        nodes = pupil_nodes(self._radii, 0.0, self._count(NODES, 2))
        path, measured = self._at(nodes.x, nodes.y)
        on = measured.ravel()
        return tuple(one.ravel()[on] for one in (nodes.x, nodes.y, path, nodes.weight))  # type: ignore[return-value]

    def _at(self, x: Floats, y: Floats) -> tuple[Floats, Bools]:
        return self._path(x + self.centre[0], y + self.centre[1])


def wavefront(
    error: HeightMap,
    *,
    wavelength: float,
    index: float | None = None,
    design: Surface | None = None,
    source: Source | None = None,
    inside: bool = False,
    radius: float | None = None,
    centre: tuple[float, float] | None = None,
    obscuration: float = 0.0,
    remove: Removed = "tilt",
    specular: float = 1.0,
) -> Wavefront:
    r"""Return the wavefront error that a form error causes along the rays of the design.

    .. math:: \text{path} = \frac{n' \cos t' - n \cos t}{\sqrt{1 + |\nabla f|^2}} \, (z - f)

    Parameters
    ----------
    error
        Surface minus design along z, on an even grid. [mm]
    wavelength
        Wavelength in air. [mm]
    index
        Refractive index of the material; ``None`` for a mirror.
    design
        The surface, for the angles of the rays; a plane if left out.
    source
        Point (x, y, z) from which the light comes, or to which it converges, or its height if it is on the axis;
        collimated along the axis if left out. [mm]
    inside
        Whether the light arrives through the material.
    radius, centre
        Semi-diameter and centre of the pupil. By default the smallest circle around all heights; on a polar map it is
        centred on the axis. [mm]
    obscuration
        Radius of the central obscuration over that of the pupil.
    remove
        What alignment removes: "none", "piston", "tilt" (and piston), or "focus" (and tilts and piston).
    specular
        See `Wavefront`.

    Raises
    ------
    InputError
        If the wavelength, the index or the pupil cannot be, or the map covers less than 95 % of a stated pupil.
    DomainError
        If the design is not defined at a height of the map.

    Sources
    -------
    [BornWolf]_ ch. 9; prysm and closed forms are oracles.

    >>> x = np.linspace(-5, 5, 101)
    >>> r2 = (x**2 + x[:, None] ** 2) / 25
    >>> bowl = HeightMap(x=x, y=x, z=np.where(r2 <= 1, 20e-6 * (2 * r2 - 1), np.nan))
    >>> made = wavefront(bowl, wavelength=633e-6, radius=5.0)
    >>> round(made.rms_waves, 4), round(made.strehl, 4)   # 40 nm / sqrt(3), and sinc² of 40 nm
    (0.0365, 0.9485)
    """
    one_of(remove, "remove", REMOVED)
    error.require_calibrated()
    around = fit_zernike(error, terms=1, indexing="fringe", radius=radius, centre=centre)
    measured = np.isfinite(error.z)
    opd = np.full(error.z.shape, np.nan)
    x, y = (one[measured] for one in error.points())
    plane = Plane() if design is None else design
    opd[measured] = error.z[measured] * path_per_height(plane, x, y, index=index, source=source, inside=inside)
    made = Wavefront(
        opd=replace(error, z=opd, name=f"{error.name} wavefront".strip()),
        wavelength=wavelength, radius=around.radius, centre=around.centre, obscuration=obscuration, specular=specular,
    )  # fmt: skip
    if radius is not None and made.covered < LEAST_COVERED:
        raise InputError(
            f"the map covers {made.covered:.1%} of the pupil of radius {radius:g} mm, at least {LEAST_COVERED:.0%} are "
            "needed: measure all of it, or state a smaller pupil or its obscuration"
        )
    return made if remove == "none" else _without(made, REMOVED.index(remove))


def incidence_angles(design: Surface, x: Floats, y: Floats, *, source: Source | None = None) -> Floats:
    """Return the angles between rays and normals of a surface.

    Parameters
    ----------
    design
        The surface.
    x, y
        Points, of one shape. [mm]
    source
        See `wavefront`. [mm]

    Returns
    -------
    ndarray
        Shape of the points. [rad]

    Raises
    ------
    InputError
        If the source is above the tangent planes of some points and below those of others.

    >>> from turnwright.surface import Conic
    >>> paraboloid = Conic(radius=10.0, conic=-1.0)   # light from its focus leaves along the axis
    >>> np.rad2deg(incidence_angles(paraboloid, np.array([10.0]), np.zeros(1), source=5.0)).round(9).tolist()
    [45.0]
    """
    return _incidence(design, x, y, design.gradient(x, y), source)


def _incidence(design: Surface, x: Floats, y: Floats, gradient: tuple[Floats, Floats], source: Source | None) -> Floats:
    """Return the angles between rays and normals of a surface of this gradient. Shape of the points [rad]."""
    zx, zy = gradient
    cosine = 1 / np.sqrt(1 + zx * zx + zy * zy)
    if source is not None:
        at = source if isinstance(source, tuple) else (0.0, 0.0, source)
        dx, dy, dz = (
            coordinate - one
            for coordinate, one in zip(finite_tuple(at, "source", 3), (x, y, design.sag(x, y)), strict=True)
        )
        height = dz - zx * dx - zy * dy  # above the tangent plane
        if height.size and not (height > 0).all() and not (height < 0).all():
            raise InputError(
                f"source is at {at[2]:g} mm, within the sag of the surface, it must be above all tangent planes or "
                "below them: correct its height or its sign"
            )
        cosine = np.abs(height) * cosine / np.sqrt(dx * dx + dy * dy + dz * dz)
    return np.asarray(np.arccos(np.minimum(cosine, 1.0)))


def path_per_height(
    design: Surface,
    x: Floats,
    y: Floats,
    *,
    index: float | None = None,
    source: Source | None = None,
    inside: bool = False,
) -> Floats:
    """Return the optical path that light gains for each length by which a surface is raised along z.

    Parameters
    ----------
    design, x, y
        The surface, and points of one shape. [mm]
    index, source, inside
        See `wavefront`.

    Returns
    -------
    ndarray
        Shape of the points. [1]

    Raises
    ------
    InputError
        If light is totally reflected at a point.
    """
    gradient = zx, zy = design.gradient(x, y)
    gain = path_factor(index=index, incidence=_incidence(design, x, y, gradient, source), inside=inside)
    if (lost := np.isnan(gain)).any():
        raise InputError(
            f"light is totally reflected at {np.count_nonzero(lost)} of {lost.size} points of the map: correct the "
            "index or the source"
        )
    return np.asarray(gain / np.sqrt(1 + zx * zx + zy * zy))


def _without(made: Wavefront, degree: int) -> Wavefront:
    """Return a wavefront without piston (1), and tilts (2), and focus (3)."""
    columns = (1, 3, 4)[degree - 1]
    at_x, at_y, path, weight = made._samples  # noqa: SLF001 - of this module
    term = _low_terms(at_x, at_y, made.radius)[:, :columns]
    normal = term.T @ (weight[:, None] * term)
    low = np.linalg.solve(normal, term.T @ (weight * path))
    x, y = (one - middle for one, middle in zip(made.opd.points(), made.centre, strict=True))
    return replace(made, opd=replace(made.opd, z=made.opd.z - _low_terms(x, y, made.radius)[..., :columns] @ low))


def _low_terms(x: Floats, y: Floats, radius: float) -> Floats:
    """Return piston, tilts and focus at points. Shape of the points and 4."""
    u, v = x / radius, y / radius
    return np.stack([np.ones_like(u), u, v, 2 * (u * u + v * v) - 1], axis=-1)
