"""From an instrument's file to how far a part is off: clean, register, and judge what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright.diagnosis import DEFAULT, FREE, Diagnosis, diagnose
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.job._shares import pv_nm_of, rms_nm_of
from turnwright.metrology import (
    Lenslets,
    Registration,
    Roughness,
    ZernikeFit,
    despike,
    fit_zernike,
    has_lenslets,
    keep_disc,
    lenslets,
    register,
    roughness,
    trim_edge,
)

if TYPE_CHECKING:
    from turnwright.job._run import StageProgress
    from turnwright.job._schema import Job

__all__ = ["Measured", "explain", "measure"]

FIRST = 100_000
"""Points by which a map is found on the part before its spikes are known."""

NM = 1e6

TERMS = 37
"""Fringe Zernike terms that the form is told in."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """A measured part against its design.

    Parameters
    ----------
    job
        That the part was cut by.
    heights
        What was measured, in the instrument's frame, without spikes and edge. [mm]
    spikes
        Heights that were taken out as spikes.
    registration
        Where the map lies on the part, and what the surface cannot tell about it.
    placed
        The same heights at their places on the part, scattered. [mm]
    error
        Cut minus design at these places, along z. [mm]
    form_pv_nm, form_rms_nm
        Of the error within the clear radius. [nm]
    zernike
        The error in fringe terms over the clear radius, or ``None`` if too little of the part was measured for them.
    roughness
        Of what the terms leave, in the map's own grid; ``None`` for scattered points.
    lenslets
        Every lenslet's place and form, if the part has some.
    """

    job: Job
    heights: HeightMap
    spikes: int
    registration: Registration
    placed: HeightMap
    error: HeightMap
    form_pv_nm: float
    form_rms_nm: float
    zernike: ZernikeFit | None
    roughness: Roughness | None
    lenslets: Lenslets | None


def measure(job: Job, heights: HeightMap, *, progress: StageProgress | None = None) -> Measured:
    """Say how far a measured part is off its design.

    The map is found on the part by a robust fit to some of its points; what stands out of its neighbours *there*, so
    without the part's own edges, is taken out; then all points are fitted. The job's ``measurement`` says what is known
    of the instrument.

    Parameters
    ----------
    job
        That the part was cut by.
    heights
        As the instrument shows them, see `turnwright.read_map`.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InputError
        If the map has no lengths and the job does not state its pixel size, or too little of it lies on the part.
    """
    told = progress or (lambda _stage, _done, _total: None)
    asked, part = job.measurement, job.part.part
    told("register", 0, 2)
    heights = _turned(heights, job)
    pieces = part.surface.in_pieces
    first = register(
        _thinned(heights, FIRST), part, free=asked.free, loss="huber" if pieces else "tukey", start=asked.pose,
        reach=asked.reach, clocking=asked.clocking,
    )  # fmt: skip
    told("register", 1, 2)
    told("clean", 0, 1)
    spikes = 0
    if asked.spikes != "none":
        # The error shows no edges of the part, so only what does not belong there stands out.
        error = register(heights, part, free=asked.free, start=first.pose, reach=0.0, clocking=0.0).error
        found = despike(error, rule="kong" if asked.spikes == "second difference" else "robust")
        spikes = found.count
        heights = replace(heights, z=np.where(found.spikes, np.nan, heights.z))
    if asked.trim:
        heights = trim_edge(heights, asked.trim)
    told("clean", 1, 1)
    registration = register(
        heights, part, free=asked.free, loss="huber" if pieces else "linear", start=first.pose, reach=0.0, clocking=0.0
    )
    registration = replace(registration, candidates=first.candidates, start=first.start)
    told("register", 2, 2)
    told("judge", 0, 1)
    placed, error = _on_part(heights, registration)
    inside = keep_disc(error, part.radius)
    terms = _terms(inside, part.radius)
    rough = None
    if not heights.scattered:
        left = np.full(heights.z.shape, np.nan)
        left[~np.isnan(registration.error.z)] = error.z if terms is None else terms.residual.z
        rough = roughness(replace(registration.error, z=left), form="plane")
    measured = Measured(
        job=job, heights=heights, spikes=spikes, registration=registration, placed=placed, error=error,
        form_pv_nm=pv_nm_of(inside.z), form_rms_nm=rms_nm_of(inside.z), zernike=terms, roughness=rough,
        lenslets=lenslets(heights, part, pose=registration.pose) if has_lenslets(part.surface) else None,
    )  # fmt: skip
    told("judge", 1, 1)
    return measured


def explain(measured: Measured | Sequence[Measured], *, progress: StageProgress | None = None) -> Diagnosis:
    """Say why measured parts are off. See `turnwright.diagnose`.

    Parameters
    ----------
    measured
        Of the part, or of artefacts, all cut with one tool on one machine: what they share is found together.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InputError
        If the jobs were planned with different tools or machines.
    """
    told = progress or (lambda _stage, _done, _total: None)
    every = [measured] if isinstance(measured, Measured) else list(measured)
    if not every:
        raise InputError("0 measured parts are given, a diagnosis needs at least 1: measure one")
    first = every[0].job
    for one in every[1:]:
        if one.job.tool != first.tool or one.job.machine != first.machine:
            raise InputError(
                f"{one.job.part.name!r} and {first.part.name!r} were planned with different tools or machines, one "
                "diagnosis takes 1 of each: diagnose them apart"
            )
    told("diagnose", 0, 1)
    asked = first.measurement
    found = diagnose(
        [one.placed for one in every],
        [one.job.part.part for one in every],
        first.tool.tool,
        first.machine.machine,
        causes=asked.causes or DEFAULT,
        reference=asked.reference,
        free=[one for one in FREE if one not in asked.fixed],
        waviness=asked.waviness,
        sense=first.strategy.sense,
        feed=_feed(first),
        worth_nm=asked.worth * NM,
    )
    told("diagnose", 1, 1)
    return found


def _feed(job: Job) -> float:
    """Return the feed that the job states for its finishing pass, or 0. [mm/rev]."""
    return getattr(job.passes[-1], "feed", None) or getattr(job.strategy, "feed", None) or 0.0


def _turned(heights: HeightMap, job: Job) -> HeightMap:
    """Return the map with lengths, seen from the tool's side, material below."""
    asked = job.measurement
    if asked.pixel_size is not None:
        heights = heights.scaled(asked.pixel_size)
    heights.require_calibrated()
    if asked.inverted:
        heights = replace(heights, z=-heights.z)
    if asked.mirrored and heights.x is not None:
        mirrored = -heights.x
        if heights.scattered:
            return replace(heights, x=mirrored)
        return replace(heights, x=mirrored[::-1], z=heights.z[:, ::-1])
    return heights


def _thinned(heights: HeightMap, most: int) -> HeightMap:
    """Return every so-manieth point, row and column."""
    valid = int(np.count_nonzero(~np.isnan(heights.z)))
    if valid <= most:
        return heights
    if heights.scattered:
        few = np.flatnonzero(~np.isnan(heights.z))[:: -(-valid // most)]
        x, y = heights.points()
        return replace(heights, x=x[few], y=y[few], z=heights.z[few])
    step = int(np.ceil(np.sqrt(valid / most)))
    names = ("radius", "angle") if heights.polar else ("x", "y")
    axes = {name: getattr(heights, name)[::step] for name in names}
    return replace(heights, z=heights.z[::step, ::step], **axes)


def _on_part(heights: HeightMap, registration: Registration) -> tuple[HeightMap, HeightMap]:
    """Return the heights and their errors, scattered over the part."""
    x, y = heights.points()
    used = ~np.isnan(registration.error.z)
    x, y, z = registration.pose.apply(x[used], y[used], heights.z[used])
    placed = HeightMap(x=x, y=y, z=z, name=heights.name)
    return placed, HeightMap(x=x, y=y, z=registration.error.z[used], name=f"{heights.name} error".strip())


def _terms(error: HeightMap, radius: float) -> ZernikeFit | None:
    """Return the form in Zernike terms, if the points fix them."""
    try:
        return fit_zernike(error, terms=TERMS, indexing="fringe", radius=radius, centre=(0.0, 0.0))
    except InputError:
        return None
