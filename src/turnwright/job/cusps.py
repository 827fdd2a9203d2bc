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
    from turnwright.path import Motion, Spiral

__all__ = ["CuspLight", "Feeds", "cusp_geometry", "cusp_light"]

CUSP_POINTS = 200
"""Points of the part at which the height of the cusps is evaluated."""

CUSP_HEIGHTS = 65
"""Heights of cusps for which orders are computed; in between they are interpolated."""

FEWEST_ORDERS = 3

MOST_TURNS = 2_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CuspLight:
    """Diffraction by the cusps that feed and nose radius leave over the part. See `turnwright.optics.cusp_orders`.

    Parameters
    ----------
    feed
        Median feed of the tip. [mm/rev]
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


class Feeds(NamedTuple):
    """Feed of the tip at radii of the tip. Each (n,) [mm, mm/rev]."""

    radius: Floats
    feed: Floats

    @classmethod
    def of_motion(cls, motion: Motion) -> Feeds:
        """Return the feed of every revolution of a motion."""
        fast = motion.axes.get("U")
        return cls._of_tip(motion.axes["C"], motion.axes["X"] if fast is None else motion.axes["X"] + fast)

    @classmethod
    def of_spiral(cls, job: Job, spiral: Spiral) -> Feeds:
        """Return the feed of every revolution of a spiral before it is placed."""
        radius = spiral.radius
        if job.strategy.along == "normal":  # the spiral is that of the contact
            cosine, sine = np.cos(spiral.angle), np.sin(spiral.angle)
            zx, zy = job.part.continuation.gradient(radius * cosine, radius * sine)
            radius = radius - job.tool.actual_radius * np.sin(np.arctan(zx * cosine + zy * sine))
        return cls._of_tip(spiral.angle, radius)

    @classmethod
    def _of_tip(cls, angle: Floats, radius: Floats) -> Feeds:
        """Return the feed of every revolution of the tip; revolutions that stand still do not count."""
        turned = np.abs(angle - angle[0])
        marks = np.arange(turned[-1], 0.0, -2 * math.pi)[:MOST_TURNS] if turned[-1] > 2 * math.pi else turned[[-1, 0]]
        at = np.abs(np.interp(marks, turned, radius))
        feed = np.abs(np.diff(at) / np.diff(marks)) * 2 * math.pi
        middle = (at[1:] + at[:-1]) / 2
        moves = feed > feed.max() / 10
        order = np.argsort(middle[moves])
        return cls(middle[moves][order], feed[moves][order])


class CuspGeometry(NamedTuple):
    """Cusps at points of a part. Each (n,)."""

    secant: Floats  # of the slope angle along the feed
    period: Floats  # distance of neighbouring cusps along the surface [mm]
    height: Floats  # along the normal [mm]


def cusp_geometry(job: Job, feeds: Feeds, x: Floats, y: Floats) -> CuspGeometry:
    r"""Return distance and height of the cusps of a feed at points of the part.

    With slope angle :math:`\alpha` and curvature :math:`\kappa` along the feed, the tip of a nose of radius R is at
    :math:`r - R \sin \alpha`. A feed f of the tip leaves cusps :math:`p = f / ((1 - R \kappa) \cos \alpha)` apart along
    the surface and :math:`p^2 (1/R - \kappa) / 8` high.

    Raises
    ------
    InputError
        If the part is curved more than the nose.
    """
    nose_radius, surface = job.actual_tool.actual_radius, job.part.design.surface
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    cosine, sine = np.cos(angle), np.sin(angle)
    zx, zy = surface.gradient(x, y)
    zxx, zxy, zyy = surface.hessian(x, y)
    slope = zx * cosine + zy * sine
    secant = np.sqrt(1 + slope**2)
    curvature = (zxx * cosine**2 + 2 * zxy * cosine * sine + zyy * sine**2) / secant**3
    if (bad := curvature * nose_radius >= 1).any():
        raise InputError(
            f"the part is curved by {curvature[bad].max():.4g} 1/mm along the feed, the nose by {1 / nose_radius:.4g} "
            "1/mm, so that it leaves no cusps: use a smaller nose radius"
        )
    feed = np.interp(radius - nose_radius * slope / secant, feeds.radius, feeds.feed)
    period = feed * secant / (1 - nose_radius * curvature)
    return CuspGeometry(secant, period, period**2 * (1 / nose_radius - curvature) / 8)


def cusp_light(job: Job, feeds: Feeds, stated: OpticsTable) -> CuspLight:
    """Return the diffraction by the cusps of a feed over the part.

    Raises
    ------
    InputError
        If the part is curved more than the nose.
    """
    x, y = evenly(job.part, CUSP_POINTS)
    cusps = cusp_geometry(job, feeds, x, y)
    incidence = incidence_angles(job.part.design.surface, x, y, source=stated.source)
    gain, straight = (path_factor(index=stated.index, incidence=one, inside=stated.inside) for one in (incidence, 0.0))
    heights = cusps.height * np.abs(gain / straight)
    # The phase of a parabola turns fastest at its ends, by which the light of deep cusps goes to high orders.
    phase = 2 * math.pi * float(heights.max()) * abs(float(straight)) / stated.wavelength
    orders = np.arange(1, FEWEST_ORDERS + math.ceil(4 * phase / math.pi) + 1)
    shares = _shares(heights, stated, np.append(0, orders))
    angles = order_angles(float(cusps.period.mean()), wavelength=stated.wavelength, orders=orders)
    return CuspLight(
        feed=float(np.median(feeds.feed)), orders=tuple(orders.tolist()), angles=tuple(angles.tolist()),
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
