"""Diffraction by the cusps of a job over its part."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.errors import InputError
from turnwright.optics import cusp_orders, incidence_angles, order_angles, path_factor
from turnwright.part import evenly

if TYPE_CHECKING:
    from turnwright.job.schema import Job, OpticsTable

__all__ = ["CuspLight", "cusp_geometry", "cusp_light"]

CUSP_POINTS = 200
"""Points of the part at which the height of the cusps is evaluated."""

CUSP_HEIGHTS = 65
"""Heights of cusps for which orders are computed; in between they are interpolated."""

LISTED_ORDERS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CuspLight:
    """Diffraction by the cusps that feed and nose radius leave over the part. See `turnwright.optics.cusp_orders`.

    Parameters
    ----------
    feed
        Their period. [mm/rev]
    orders, angles
        Numbers from 1 on, and their angles from the specular direction at normal incidence, nan where an order does
        not propagate. (n,) [rad]
    efficiency
        Largest share of the light in each order, on either side, anywhere on the part. (n,)
    specular
        Share of the light in the specular order over the part: the square of its mean amplitude.
    """

    feed: float
    orders: tuple[int, ...]
    angles: tuple[float, ...]
    efficiency: tuple[float, ...]
    specular: float

    @property
    def brightest(self) -> float:
        """Largest share of the light in one order."""
        return max(self.efficiency)


class CuspGeometry(NamedTuple):
    """Cusps at points of a part. Each (n,)."""

    secant: Floats  # of the slope angle along the feed
    period: Floats  # distance of neighbouring cusps along the surface [mm]
    height: Floats  # along the normal [mm]


def cusp_geometry(job: Job, feed: float, x: Floats, y: Floats) -> CuspGeometry:
    r"""Return distance and height of the cusps of a feed at points of the part.

    With slope angle :math:`\alpha` and curvature :math:`\kappa` along the feed, neighbouring cusps are
    :math:`p = f / \cos \alpha` apart along the surface and :math:`p^2 (1/R - \kappa) / 8` high; a path placed along z
    has its feed at the tip, and cusps farther apart by :math:`1 / (1 - R \kappa)`.

    Raises
    ------
    InputError
        If the part is curved more than the nose.
    """
    nose_radius, surface = job.actual_tool.actual_radius, job.part.design.surface
    angle = np.arctan2(y, x)
    cosine, sine = np.cos(angle), np.sin(angle)
    zx, zy = surface.gradient(x, y)
    zxx, zxy, zyy = surface.hessian(x, y)
    secant = np.sqrt(1 + (zx * cosine + zy * sine) ** 2)
    curvature = (zxx * cosine**2 + 2 * zxy * cosine * sine + zyy * sine**2) / secant**3
    if (bad := curvature * nose_radius >= 1).any():
        raise InputError(
            f"the part is curved by {curvature[bad].max():.4g} 1/mm along the feed, the nose by {1 / nose_radius:.4g} "
            "1/mm, so that it leaves no cusps: use a smaller nose radius"
        )
    period = feed * secant / (1 - nose_radius * curvature if job.strategy.along == "z" else 1.0)
    return CuspGeometry(secant, period, period**2 * (1 / nose_radius - curvature) / 8)


def cusp_light(job: Job, feed: float, stated: OpticsTable) -> CuspLight:
    """Return the diffraction by the cusps of a feed over the part.

    Raises
    ------
    InputError
        If the part is curved more than the nose.
    """
    x, y = evenly(job.part, CUSP_POINTS)
    cusps = cusp_geometry(job, feed, x, y)
    incidence = incidence_angles(job.part.design.surface, x, y, source=stated.source)
    gain, straight = (path_factor(index=stated.index, incidence=one, inside=stated.inside) for one in (incidence, 0.0))
    orders = np.arange(1, LISTED_ORDERS + 1)
    shares = _shares(cusps.height * gain / straight, stated, np.append(0, orders))
    angles = order_angles(float(cusps.period.mean()), wavelength=stated.wavelength, orders=orders)
    return CuspLight(
        feed=feed, orders=tuple(orders.tolist()), angles=tuple(angles.tolist()),
        efficiency=tuple(shares[:, 1:].max(axis=0).tolist()), specular=float(np.sqrt(shares[:, 0]).mean() ** 2),
    )  # fmt: skip


def _shares(heights: Floats, stated: OpticsTable, orders: Ints) -> Floats:
    """Return the shares of orders of cusps at normal incidence, by a table over their height. (n, orders)."""
    nodes = np.linspace(heights.min(), heights.max(), CUSP_HEIGHTS)
    table = np.array([
        cusp_orders(
            nose_radius=1.0, feed=math.sqrt(8 * height), wavelength=stated.wavelength, orders=orders, index=stated.index
        )
        for height in nodes
    ])  # fmt: skip
    return np.stack([np.interp(heights, nodes, column) for column in table.T], axis=1)
