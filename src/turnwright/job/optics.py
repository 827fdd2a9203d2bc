"""What the surface that a job leaves does to light: form and tool marks, each at its own scale, and both together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.errors import InputError
from turnwright.generation import generate_polar
from turnwright.heightmap import HeightMap
from turnwright.job.predicting import follow_motion
from turnwright.metrology import Form
from turnwright.optics import (
    Scatter,
    Wavefront,
    cusp_orders,
    incidence_angles,
    order_angles,
    path_factor,
    scatter,
    wavefront,
)
from turnwright.part import Part, evenly
from turnwright.pose import Pose
from turnwright.surface import Placed, Surface

if TYPE_CHECKING:
    from turnwright.job.measurement import Measured
    from turnwright.job.pass_plan import Watch
    from turnwright.job.prediction import Prediction
    from turnwright.job.schema import Job, OpticsTable
    from turnwright.path import Motion
    from turnwright.progress import Progress

__all__ = ["NO_OPTICS", "CuspLight", "OpticalPerformance", "cusp_light", "measured_optics", "predict_optics"]

RINGS, AZIMUTHS = 128, 128
"""Grid of the form in the pupil: errors with up to 64 lobes."""

SAMPLES_PER_FEED = 8
"""Samples across a feed whose mean is the form without its cusps."""

CUSP_POINTS = 200
"""Points of the part at which the height of the cusps is evaluated."""

CUSP_HEIGHTS = 65
"""Heights of cusps for which orders are computed; in between they are interpolated."""

LISTED_ORDERS = 3

BORDER_POINTS = 720

NO_OPTICS = "the job states no [optics], its optical performance needs a wavelength: add the table"


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpticalPerformance:
    """Optical performance of a predicted or measured surface.

    Parameters
    ----------
    wavefront
        Wavefront of the form over the pupil, lowered by what the marks scatter.
    cusps
        Diffraction by the cusps; ``None`` where the feed is not known.
    marks
        Diffraction and scatter of each patch, by name.
    focal_length
        Focal length for positions and frequencies in the image. [mm]
    """

    wavefront: Wavefront
    cusps: CuspLight | None = None
    marks: Mapping[str, Scatter] = field(default_factory=dict)
    focal_length: float | None = None

    @property
    def form_strehl(self) -> float:
        """Strehl ratio of the form alone."""
        return self.wavefront.strehl / self.wavefront.specular if self.wavefront.specular else math.nan

    @property
    def strehl(self) -> float:
        """Strehl ratio of form and marks together."""
        return self.wavefront.strehl

    @property
    def cusp_order(self) -> float | None:
        """Largest share of the light in one order of the cusps; ``None`` where the feed is not known."""
        return None if self.cusps is None else max(self.cusps.efficiency)

    @property
    def tis(self) -> float:
        """Share of the light that the marks take from the image."""
        return 1.0 - self.wavefront.specular


def predict_optics(
    job: Job,
    motion: Motion,
    *,
    nominal: Motion | None = None,
    predictions: Iterable[Prediction] = (),
    watch: Watch,
) -> OpticalPerformance:
    """Predict the optical performance of the surface that a motion leaves.

    The form is the mean of the surface across each feed, so that cusps do not count twice; they lower the image by the
    share of the light that they diffract.

    Parameters
    ----------
    job
        A job that states ``optics``.
    motion, nominal
        See `predict`.
    predictions
        Predicted patches; those that show the marks enter with their own scatter.
    watch
        Records the wall time.

    Raises
    ------
    InputError
        If the job does not state ``optics``, or the part is curved more than the nose.
    """
    if job.optics is None:
        raise InputError(NO_OPTICS)
    followed, real = follow_motion(job, motion, job.simulation.tracking, nominal, watch)
    with watch.stage("optics") as update:
        form = _mean_form(job, real or followed, update)
        patches = {
            one.name: light_of_patch(one.error, job.optics, job.roughness.form)
            for one in predictions
            if one.name in {patch.name for patch in job.simulation.patches}
        }
        light = _wavefront(job.part, job.part.design.surface, form, job.optics, Pose())
        cusps = cusp_light(job, motion.feed)
        return OpticalPerformance(
            wavefront=replace(light, specular=cusps.specular),
            cusps=cusps, marks=patches, focal_length=job.optics.focal_length,
        )  # fmt: skip


def measured_optics(measured: Measured) -> OpticalPerformance:
    """Return the optical performance of a measured part; marks are in its form as far as the map resolves them.

    Raises
    ------
    InputError
        If the job does not state ``optics``, the map has scattered points, or it covers less than 95 % of the aperture.
    """
    job = measured.job
    if job.optics is None:
        raise InputError(NO_OPTICS)
    to_map = measured.registration.pose.inverse
    surface = Placed(surface=job.part.design.surface, shift=to_map.shift, rotation=to_map.rotation, tilt=to_map.tilt)
    return OpticalPerformance(
        wavefront=_wavefront(job.part, surface, measured.registration.error, job.optics, to_map),
        focal_length=job.optics.focal_length,
    )


def light_of_patch(error: HeightMap, stated: OpticsTable, form: Form) -> Scatter:
    """Return the diffraction and the scatter of a patch, at normal incidence."""
    return scatter(error, wavelength=stated.wavelength, index=stated.index, form=form)


def _wavefront(part: Part, surface: Surface, error: HeightMap, stated: OpticsTable, frame: Pose) -> Wavefront:
    """Return the wavefront over the clear aperture, of an error and a design in another frame than that of the part."""
    x_low, x_high, low, high = part.border.box
    middle = ((x_low + x_high) / 2, (low + high) / 2)
    x, y = part.border.border(BORDER_POINTS)
    centre = [float(one[0]) for one in frame.apply(*np.array([[middle[0]], [middle[1]], [0.0]]))]
    return wavefront(
        error, wavelength=stated.wavelength, index=stated.index, design=surface, source=stated.source,
        inside=stated.inside, radius=float(np.hypot(x - middle[0], y - middle[1]).max()), centre=(centre[0], centre[1]),
        obscuration=stated.obscuration, remove=stated.remove,
    )  # fmt: skip


def _mean_form(job: Job, motion: Motion, update: Progress) -> HeightMap:
    """Return the form error: the mean of the error across a feed, on a polar grid."""
    part, feed = job.part, motion.feed
    low, high = part.nearest, part.reach
    width = min(feed, (high - low) / RINGS)
    rings = np.linspace(low, high, RINGS)
    middles = np.clip(rings, low + width / 2, high - width / 2)
    share = (np.arange(SAMPLES_PER_FEED) + 0.5) / SAMPLES_PER_FEED - 0.5
    radius = np.unique(middles[:, None] + width * share)
    angle = np.linspace(0, 2 * np.pi, AZIMUTHS, endpoint=False)
    made = generate_polar(
        motion, job.actual_tool, radius=radius, angle=angle, machine=job.actual_machine, progress=update
    )  # fmt: skip
    error = part.form_error(made)
    z = error.z.reshape(AZIMUTHS, RINGS, SAMPLES_PER_FEED).mean(axis=2)
    return HeightMap(radius=rings, angle=angle, z=z, name="form")


def cusp_light(job: Job, feed: float) -> CuspLight:
    r"""Return the diffraction by the cusps of a feed over the part.

    With slope angle :math:`\alpha` and curvature :math:`\kappa` along the feed, neighbouring cusps are
    :math:`p = f / \cos \alpha` apart along the surface and :math:`p^2 (1/R - \kappa) / 8` high; a path placed along z
    has its feed at the tip, and cusps farther apart by :math:`1 / (1 - R \kappa)`.

    Raises
    ------
    InputError
        If the job does not state ``optics``, or the part is curved more than the nose.
    """
    stated, nose_radius = job.optics, job.actual_tool.actual_radius
    if stated is None:
        raise InputError(NO_OPTICS)
    surface = job.part.design.surface
    x, y = evenly(job.part, CUSP_POINTS)
    radius = np.hypot(x, y)
    cosine, sine = x / radius, y / radius
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
    heights = period**2 * (1 / nose_radius - curvature) / 8
    incidence = incidence_angles(surface, x, y, source=stated.source)
    gain, straight = (path_factor(index=stated.index, incidence=one, inside=stated.inside) for one in (incidence, 0.0))
    orders = np.arange(1, LISTED_ORDERS + 1)
    shares = _shares(heights * gain / straight, stated, np.append(0, orders))
    angles = order_angles(float(period.mean()), wavelength=stated.wavelength, orders=orders)
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
