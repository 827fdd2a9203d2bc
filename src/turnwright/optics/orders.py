"""Diffraction orders of tool marks, and total integrated scatter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Floats, Ints, frozen, gauss_rule
from turnwright._validate import between, check_index, check_wavelength, finite, positive
from turnwright.errors import InputError

__all__ = ["cusp_orders", "order_angles", "path_factor", "profile_orders", "tis"]

MOST_ORDERS = 100_000

PANEL_RAD, PANEL_NODES = 4.0, 16
"""Phase across a panel of the quadrature, and its nodes: Gauss-Legendre is then exact to rounding."""


def path_factor(*, index: float | None = None, incidence: ArrayLike = 0.0, inside: bool = False) -> Floats:
    r"""Optical path that light gains for each length by which the surface is raised along its normal.

    .. math:: n' \cos t' - n \cos t \quad \text{(refracting)}, \qquad -2 \cos t \quad \text{(mirror)}

    Parameters
    ----------
    index
        Refractive index of the material; ``None`` for a mirror.
    incidence
        Angle t between the ray and the normal. Any shape [rad]
    inside
        Whether the light arrives through the material.

    Returns
    -------
    ndarray
        Shape of ``incidence``; nan beyond the angle of total reflection. [1]

    Raises
    ------
    InputError
        If the index is below 1 or above 10, or an angle is not within a quarter turn.

    Sources
    -------
    [BornWolf]_ ch. 4 and 9, to first order in the displacement.

    >>> float(path_factor()), round(float(path_factor(index=1.5)), 12)
    (-2.0, 0.5)
    """
    angle = np.asarray(incidence, dtype=np.float64)
    if not (np.abs(angle) < math.pi / 2).all():
        raise InputError(
            f"incidence is {float(angle.flat[np.argmax(np.abs(angle))]):g} rad, it must be within a quarter turn, "
            "1.57 rad: give angles from the normal in rad"
        )
    if index is None:
        return np.asarray(-2.0 * np.cos(angle))
    n = check_index(index)
    sine = np.sin(angle) * (n if inside else 1 / n)
    with np.errstate(invalid="ignore"):
        refracted = np.sqrt(1.0 - sine * sine)
    return np.asarray(n * np.cos(angle) - refracted if inside else n * refracted - np.cos(angle))


def cusp_orders(
    *,
    nose_radius: float,
    feed: float,
    wavelength: float,
    orders: ArrayLike,
    index: float | None = None,
    incidence: float = 0.0,
    curvature: float = 0.0,
) -> Floats:
    r"""Efficiency of the diffraction orders of the cusps that a round tool leaves.

    With :math:`\varphi` the phase over the height of a cusp, :math:`h = f^2 (1/R - \kappa) / 8`,

    .. math::

        \eta_m = \Bigl| \int_{-1/2}^{1/2} e^{4 i \varphi t^2 - 2 \pi i m t} dt \Bigr|^2
               = \frac{|F(k (\tfrac12 - s)) - F(k (-\tfrac12 - s))|^2}{k^2}, \quad
        k = \sqrt{8 \varphi / \pi}, \ s = \frac{m \pi}{4 \varphi}, \ F = C + i S

    Parameters
    ----------
    nose_radius
        Nose radius R of the tool. [mm]
    feed
        Feed f per revolution, the distance of neighbouring cusps along the part. [mm/rev]
    wavelength
        Wavelength in air. [mm]
    orders
        Numbers m of the orders; 0 is the specular one. Any shape
    index, incidence
        See `path_factor`; the plane of incidence contains the grooves or the angle is small. [1, rad]
    curvature
        Curvature of the profile of the part along the feed, positive concave. [1/mm]

    Returns
    -------
    ndarray
        Share of the light in each order, out of 1 over all of them. Shape of ``orders``

    Raises
    ------
    InputError
        If a length is not positive, the feed is not below the tool width, the part is curved more than the nose, or an
        order is not an integer.

    Notes
    -----
    Scalar theory; orders whose angle is imaginary (`order_angles`) do not propagate. It is within 1 % of rigorous
    theory for feeds of 2.5 wavelengths or more. The parabola in place of the circle changes the first order by
    f²/(8 R²), relatively; `profile_orders` takes any profile.

    Sources
    -------
    [BornWolf]_ ch. 8. Oracle: Fresnel integrals at 40 digits.

    >>> cusp_orders(nose_radius=0.514, feed=0.010, wavelength=633e-6, orders=[0, 1]).round(7).tolist()
    [0.9794648, 0.0094563]
    """
    radius = positive(nose_radius, "nose_radius", "mm")
    width = between(positive(feed, "feed", "mm/rev"), "feed", 0.0, 2 * radius, "mm/rev")
    finite(curvature, "curvature")
    if curvature >= 1 / radius:
        raise InputError(
            f"curvature is {curvature:g} 1/mm, it must be below that of the nose, {1 / radius:g} 1/mm: use a smaller "
            "nose radius"
        )
    height = width * width * (1 / radius - curvature) / 8
    factor = float(path_factor(index=index, incidence=incidence))
    phase = 2 * math.pi * height * abs(factor) / check_wavelength(wavelength)
    numbers = _whole(orders)
    distinct, place = np.unique(np.abs(numbers), return_inverse=True)
    efficiency = np.array([_parabola_order(phase, int(m)) for m in distinct])
    return np.asarray(efficiency[place].reshape(numbers.shape))


def _whole(orders: ArrayLike) -> Ints:
    """Return the numbers of orders."""
    values = np.asarray(orders, dtype=np.float64)
    if not (values == np.rint(values)).all() or np.abs(values).max(initial=0) > MOST_ORDERS:
        raise InputError(
            f"orders are up to {np.abs(values).max():g}, they must be whole numbers of at most {MOST_ORDERS}: correct "
            "them"
        )
    return values.astype(np.int64)


def _parabola_order(phase: float, order: int) -> float:
    """Return the efficiency of one order of parabolic cusps.

    Fresnel integrals lose digits on shallow cusps; the quadrature does not.
    """
    panels = max(1, math.ceil((phase + math.pi * order) / PANEL_RAD))
    node, weight = gauss_rule(PANEL_NODES)
    t = (np.arange(panels)[:, None] + (node + 1) / 2) / (2 * panels)
    terms = np.exp(4j * phase * t * t) * np.cos(2 * math.pi * order * t) * weight
    return float(abs(terms.sum() / (2 * panels)) ** 2)


def profile_orders(
    heights: ArrayLike, *, wavelength: float, orders: ArrayLike, index: float | None = None, incidence: float = 0.0
) -> Floats:
    """Efficiency of the diffraction orders of one period of any profile.

    Parameters
    ----------
    heights
        Heights over one period in even steps, its end left out. (n,) [mm]
    wavelength, orders, index, incidence
        See `cusp_orders`. [mm, 1, 1, rad]

    Raises
    ------
    InputError
        If a height is not finite, or an order is not below half the number of heights.

    >>> t = (np.arange(1000) + 0.5) / 1000 - 0.5
    >>> cusp = 0.01**2 * t**2 / (2 * 0.514)
    >>> profile_orders(cusp, wavelength=633e-6, orders=[0, 1]).round(6).tolist()
    [0.979465, 0.009456]
    """
    z = frozen(heights, "heights")
    numbers = _whole(orders)
    if 2 * np.abs(numbers).max(initial=0) >= z.size:
        raise InputError(
            f"orders are up to {np.abs(numbers).max()}, {z.size} heights in a period resolve those below {z.size / 2:g}"
        )
    factor = float(path_factor(index=index, incidence=incidence))
    amplitude = np.fft.fft(np.exp(2j * math.pi * factor / check_wavelength(wavelength) * z)) / z.size
    # The sign of the phase only exchanges the two sides.
    return np.asarray(np.abs(amplitude[numbers]) ** 2)


def order_angles(
    period: float, *, wavelength: float, orders: ArrayLike, index: float | None = None, incidence: float = 0.0
) -> Floats:
    r"""Angles of diffraction orders from the normal, :math:`n \sin t_m = \sin t + m \lambda / p`.

    Parameters
    ----------
    period
        Period of the marks, such as the feed. [mm]
    wavelength, orders, index, incidence
        See `cusp_orders`; light enters the material, and the angles are those inside it. [mm, 1, 1, rad]

    Returns
    -------
    ndarray
        nan for orders that do not propagate. Shape of ``orders`` [rad]

    >>> np.rad2deg(order_angles(0.010, wavelength=633e-6, orders=[0, 1, 16])).round(3).tolist()
    [0.0, 3.629, nan]
    """
    path_factor(index=index, incidence=incidence)
    lines = check_wavelength(wavelength) / positive(period, "period", "mm")
    sine = (math.sin(incidence) + _whole(orders) * lines) / (index or 1.0)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.arcsin(sine))


def tis(*, sq: ArrayLike, wavelength: float, index: float | None = None, incidence: float = 0.0) -> Floats:
    r"""Total integrated scatter of a surface with Gaussian heights, :math:`1 - e^{-(4 \pi S_q \cos t / \lambda)^2}`.

    Parameters
    ----------
    sq
        Root mean square roughness over the wavelengths of the surface that scatter. Any shape [mm]
    wavelength, index, incidence
        See `cusp_orders`; a refracting surface has :math:`2 \pi S_q (n' \cos t' - n \cos t) / \lambda`. [mm, 1, rad]

    Notes
    -----
    Cusps are not Gaussian: to the next order they scatter s⁴/14 more, with s = 4 pi Sq/lambda.

    Sources
    -------
    [Bennett1961]_.

    >>> round(float(tis(sq=7.25e-6, wavelength=633e-6)), 6)
    0.020502
    """
    heights = np.asarray(sq, dtype=np.float64)
    if not (heights >= 0).all():
        raise InputError(f"sq is {heights.min():g} mm, it cannot be below 0 mm: give the rms roughness")
    factor = float(path_factor(index=index, incidence=incidence))
    return np.asarray(-np.expm1(-((2 * math.pi * factor * heights / check_wavelength(wavelength)) ** 2)))
