"""What the surface that a job leaves does to light: form and tool marks, each at its own scale, and both together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import InputError
from turnwright.generation import generate_points, generate_polar
from turnwright.heightmap import HeightMap
from turnwright.job.cusps import CuspLight, Feeds, cusp_geometry, cusp_light
from turnwright.job.predicting import follow_motion
from turnwright.optics import (
    Scatter,
    Wavefront,
    path_per_height,
    scatter,
    wavefront,
)
from turnwright.part import Part
from turnwright.pose import Pose
from turnwright.surface import Placed, Surface

if TYPE_CHECKING:
    from turnwright.job.measurement import Measured
    from turnwright.job.pass_plan import Watch
    from turnwright.job.prediction import Prediction
    from turnwright.job.schema import Job, OpticsTable
    from turnwright.path import Motion
    from turnwright.progress import Progress

__all__ = ["OpticalPerformance", "measured_optics", "predict_optics"]

RINGS, AZIMUTHS = 128, 134
"""Grid of the form in the pupil, for errors with up to 67 lobes. Points per revolution hardly ever have the factor
67, so that all phases of their chords are sampled."""

FEWEST_PERIODS = 8
"""Cusps along a patch that separate its diffraction orders."""

SAMPLES_PER_FEED = 8
"""Samples across a feed whose mean is the form without its cusps."""

LEAST_COVERED = 0.95
"""Share of a clear aperture that a map must cover."""


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
        Diffraction and scatter of each patch that is several feeds wide, by name.
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
        return None if self.cusps is None else self.cusps.brightest

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
    stated = job.light
    followed, real = follow_motion(job, motion, job.simulation.tracking, nominal, watch)
    feeds = Feeds.of_motion(motion)
    with watch.stage("optics") as update:
        form = _mean_form(job, real or followed, feeds, update)
        patches = {
            patch.name: _light_of_patch(job, one.error)
            for patch in job.simulation.patches
            for one in predictions
            if one.name == patch.name and max(patch.size) > FEWEST_PERIODS * motion.feed
        }
        light = _wavefront(job.part, job.part.design.surface, form, stated, Pose())
        cusps = cusp_light(job, feeds, stated)
        return OpticalPerformance(
            wavefront=replace(light, specular=cusps.specular),
            cusps=cusps, marks=patches, focal_length=stated.focal_length,
        )  # fmt: skip


def measured_optics(measured: Measured) -> OpticalPerformance:
    """Return the optical performance of a measured part; marks are in its form as far as the map resolves them.

    Raises
    ------
    InputError
        If the job does not state ``optics``, the map has scattered points, or it covers less than 95 % of the aperture.
    """
    job = measured.job
    stated = job.light
    to_map = measured.registration.pose.inverse
    surface = Placed(surface=job.part.design.surface, shift=to_map.shift, rotation=to_map.rotation, tilt=to_map.tilt)
    return OpticalPerformance(
        wavefront=_wavefront(job.part, surface, measured.registration.error, stated, to_map),
        focal_length=stated.focal_length,
    )


def _light_of_patch(job: Job, error: HeightMap) -> Scatter:
    """Return the diffraction and the scatter of a patch, for the ray that meets its middle."""
    stated, (x, y) = job.light, (np.array([float(one.mean())]) for one in error.points())
    made = scatter(error, wavelength=stated.wavelength, index=stated.index, form=job.roughness.form)
    gain = path_per_height(
        job.part.design.surface, x, y, index=stated.index, source=stated.source, inside=stated.inside
    )  # fmt: skip
    return replace(made, gain=float(gain[0]))


def _wavefront(part: Part, surface: Surface, error: HeightMap, stated: OpticsTable, frame: Pose) -> Wavefront:
    """Return the wavefront over the clear aperture, of an error and a design in another frame than that of the part.

    The pupil is the circle around the aperture; what is outside an outline of another shape has no heights.
    """
    x_low, x_high, low, high = part.border.box
    middle = ((x_low + x_high) / 2, (low + high) / 2)
    points = np.array([(*middle, 0.0), (0.0, 0.0, stated.source or 0.0)]).T
    (x, x0), (y, y0), (_, z0) = (one.tolist() for one in frame.apply(*points))
    obscuration = stated.obscuration
    if part.outline is not None and part.outline.is_centred:
        obscuration = max(obscuration, part.nearest / part.reach)
    light = wavefront(
        error, wavelength=stated.wavelength, index=stated.index, design=surface, inside=stated.inside,
        source=None if stated.source is None else (x0, y0, z0), radius=part.radius, centre=(x, y),
        obscuration=obscuration, remove=stated.remove,
    )  # fmt: skip
    covered = light.covered * math.pi * light.radius**2 * (1 - obscuration**2) / part.border.area
    if part.radius is None and covered < LEAST_COVERED:
        raise InputError(
            f"the map covers {covered:.1%} of the clear aperture, at least {LEAST_COVERED:.0%} are needed: measure "
            "all of it"
        )
    return light


def _mean_form(job: Job, motion: Motion, feeds: Feeds, update: Progress) -> HeightMap:
    """Return the form error: the mean of the error from cusp to cusp, on a polar grid or a rectangular one."""
    part = job.part
    share = (np.arange(SAMPLES_PER_FEED) + 0.5) / SAMPLES_PER_FEED - 0.5
    settings: dict[str, Any] = {"machine": job.actual_machine, "progress": update}
    if part.leaves_air:
        x_low, x_high, low, high = part.border.box
        columns, rows = np.linspace(x_low, x_high, RINGS), np.linspace(low, high, RINGS)
        x, y = np.meshgrid(columns, rows)
        on = part.covers(x, y)
        radius, angle = np.hypot(x[on], y[on]), np.arctan2(y[on], x[on])
        across = radius[:, None] + _periods(job, feeds, x[on], y[on])[:, None] * share
        at_x, at_y = (across * turn(angle)[:, None] for turn in (np.cos, np.sin))
        z = np.full(x.shape, np.nan)
        made = generate_points(motion, job.actual_tool, x=at_x.ravel(), y=at_y.ravel(), **settings)
        off = part.continuation.evaluate(at_x.ravel(), at_y.ravel(), 0)[0]
        z[on] = (made - off).reshape(across.shape).mean(axis=1)
        return HeightMap(x=columns, y=rows, z=z, name="form")
    rings = np.linspace(part.nearest, part.reach, RINGS)
    angle = np.linspace(0, 2 * np.pi, AZIMUTHS, endpoint=False)
    x, y = np.outer(np.cos(angle), rings), np.outer(np.sin(angle), rings)
    width = np.minimum(_periods(job, feeds, x, y).mean(axis=0), part.reach - part.nearest)
    middles = np.clip(rings, part.nearest + width / 2, part.reach - width / 2)
    radius, place = np.unique(middles[:, None] + width[:, None] * share, return_inverse=True)
    error = part.form_error(generate_polar(motion, job.actual_tool, radius=radius, angle=angle, **settings))
    z = error.z[:, place.reshape(-1)].reshape(AZIMUTHS, RINGS, SAMPLES_PER_FEED).mean(axis=2)
    return HeightMap(radius=rings, angle=angle, z=z, name="form")


def _periods(job: Job, feeds: Feeds, x: Floats, y: Floats) -> Floats:
    """Return the distance of neighbouring cusps over the radius at points. Shape of the points [mm]."""
    geometry = cusp_geometry(job, feeds, x.ravel(), y.ravel())
    return (geometry.period / geometry.secant).reshape(x.shape)
