"""Measure a part against its design: read the map, register it, remove outliers, and judge the form error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from os import PathLike
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, overload

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.diagnosis import DEFAULT, FREE, Diagnosis, diagnose as attribute, plausible_rms_nm
from turnwright.errors import InputError, MapError
from turnwright.files import read_map
from turnwright.heightmap import HeightMap
from turnwright.job.advice import open_questions
from turnwright.job.contributions import pv_nm_of
from turnwright.job.instrument_effect import TextureComparison, compare_texture, measured_design
from turnwright.job.pass_plan import Watch, across_feed, cut_heights, feed_of, motion_of
from turnwright.job.schema import Job
from turnwright.job.tables import name_keys
from turnwright.job.verdict import Verdict, judge_measured
from turnwright.machine import Machine
from turnwright.metrology import (
    EDGE,
    Lenslets,
    Registration,
    Roughness,
    TurningCentre,
    ZernikeFit,
    area_rms,
    axisymmetric,
    base_forms,
    crop_to_aperture,
    fit_zernike,
    has_lenslets,
    lenslets,
    register,
    remove_outliers,
    roughness,
    trim_edge,
    turning_centre,
)
from turnwright.part import Part
from turnwright.pose import Pose
from turnwright.progress import StageProgress
from turnwright.surface import Surface
from turnwright.tool import Tool

__all__ = ["Measured", "cutoff_of", "diagnose", "measure", "read_measurement", "same_part", "subtract_pose"]

MAX_START_POINTS = 100_000
NM = 1e6
CELL_COUNT = 20_000
"""Cells of a part over which a diagnosis averages the errors."""

CELLS_PER_FEATURE = 5
"""Least cells per feature size of a surface, so 40 per wave: the mean over one is within 0.1 %."""

MIN_CUTOFF_FEEDS = 40
"""Least cutoff of a correction, in feeds; cusps have a wavelength of one feed."""

CUTOFFS_PER_DIAMETER = 30
"""Diameter over the cutoff, unless the job states a cutoff."""

MAX_OUTLIER_FRACTION = 0.25
"""Most outliers, as a fraction of the heights; with more of them the map is of another part."""

CHECK_POINTS = 3_000
PLAUSIBLE_SIGMAS = 3.0
DEPARTURE_FRACTION = 0.5
"""Most form error of a part, as a fraction of the departure of its design from the best-fit sphere or plane."""

MAX_FLIP_RATIO = 3.0
"""Most form error of a wrongly oriented map, as a multiple of that departure; without noise it is 2."""

MIN_IMPROVEMENT = 5.0
"""Least ratio of form errors for which another orientation is suggested."""

CHECK_ADVICE = (
    "Check the unit of the heights, the pixel size, mirrored, inverted and rotation, whether heights that are missing "
    "are stored as 0, and the part."
)

MAX_TIE_RATIO = 1.2
"""Most ratio to the least form error for which an orientation fits equally well."""

MIN_ZERO_FRACTION, MIN_ZERO_ERROR_RATIO = 0.005, 5.0
"""Zeros are missing heights if there are more than this fraction, with errors more than this multiple of the others."""

RMS_PER_RIM_HEIGHT = 6**-0.5
"""Rms of an astigmatism over its height at the rim."""

INLIER_FRACTION = 0.95
"""Fraction of the points that orientations are compared by, since outliers are not removed yet."""

MIN_SIGNATURE, RANK_TOL = 1e-12, 1e-6
"""Least rms of the signature of a degree of freedom, and relative tolerance for linear dependence."""

DOFS_OF_TERM = MappingProxyType(
    {"piston": ("z",), "tilt": ("tilt_x", "tilt_y"), "decentre": ("x", "y"), "clocking": ("rotation",)}
)

ZERNIKE_TERMS = 37


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """A measured part against its design.

    Parameters
    ----------
    job
        The job that the part was cut by.
    heights
        Measured heights in the frame of the instrument, without outliers and edge. [mm]
    outliers
        Number of heights removed as outliers.
    registration
        Part pose, and the degrees of freedom that the surface does not determine.
    placed
        The same heights in the frame of the part, scattered. [mm]
    error
        Form error at these points: cut minus design along z. [mm]
    form_pv_nm, form_rms_nm
        PV and rms of the form error over the clear aperture; the rms is weighted by area. [nm]
    zernike
        Fringe Zernike terms of the form error over the clear aperture, or ``None`` if too little was measured.
    roughness
        Roughness of the residual of these terms on the grid of the map; ``None`` for scattered points.
    lenslets
        Position and form of every lenslet, if the part has lenslets.
    fingerprint
        Identifies the map in the corrections of a job, independent of file and unit.
    axis
        Axis of turning in the map, located by the turning marks where the surface does not determine the decentre.
        ``None`` otherwise.
    instrument_effect_nm
        Rms of the change of the design by the instrument, which is subtracted from the heights. ``None`` if the job
        states no instrument, or its model cannot be applied to such a map. [nm]
    texture
        Measured texture and predicted cusps through that instrument, if it is stated and the map resolves them.
    mismatch
        Why the heights do not match this part at this pose, in a sentence; ``None`` if they do.
    """

    job: Job
    heights: HeightMap
    outliers: int
    registration: Registration
    placed: HeightMap
    error: HeightMap
    form_pv_nm: float
    form_rms_nm: float
    zernike: ZernikeFit | None
    roughness: Roughness | None
    lenslets: Lenslets | None
    fingerprint: str
    axis: TurningCentre | None = None
    instrument_effect_nm: float | None = None
    texture: TextureComparison | None = None
    mismatch: str | None = None

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Which stated tolerances the measured part meets."""
        inside = _inside(self.error, self.job.part)
        return judge_measured(self.job, self.form_pv_nm, inside, self.registration.error)

    @property
    def as_seen(self) -> tuple[str, ...]:
        """The effect of the instrument on the map, in sentences; none if the job states no instrument."""
        seen = self.job.measurement.instrument
        if seen is None:
            return ()
        stated = f"measured with {seen.name or 'the stated instrument'} ({seen.summary})"
        if self.instrument_effect_nm is None:
            return (f"{stated}: its model cannot be applied to these points, it needs an evenly spaced grid",)
        return (
            f"{stated}: it changes the design by {self.instrument_effect_nm:.3g} nm rms, subtracted from the heights",
            *([] if self.texture is None else [self.texture.sentence]),
        )

    @property
    def open_questions(self) -> tuple[str, ...]:
        """What the registration could not determine, and the keys of ``measurement`` that determine it."""
        questions = open_questions(self.registration, self.job.measurement, self.job.part.reach)
        return questions if self.mismatch is None else (self.mismatch, *questions)


def read_measurement(job: Job, file: str | PathLike[str], *, unit: str | None = None) -> HeightMap:
    """Read a measured map in the units that the file states, or else the job.

    Parameters
    ----------
    job
        Its ``measurement`` describes the instrument and the map.
    file
        See `turnwright.read_map`.
    unit
        Unit of the heights, in place of the job's.

    Raises
    ------
    MapError
        See `turnwright.read_map`; for a missing unit the message names the key of the job that states it.
    """
    settings = job.measurement
    try:
        return read_map(file, unit=unit or settings.sag_units, lateral_unit=settings.units or "")
    except MapError as error:
        raise MapError(name_keys(str(error), "[measurement]")) from error


def measure(job: Job, heights: HeightMap, *, progress: StageProgress | None = None) -> Measured:
    """Compare a measured part with its design.

    The map is registered by a robust fit to some of its points; outliers of the form error are removed, so that edges
    of the design stay; then all points are registered. The job's ``measurement`` describes the instrument and the map.

    Parameters
    ----------
    job
        The job that the part was cut by.
    heights
        Heights as the instrument exports them, see `turnwright.read_map`.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InputError
        If the map counts pixels and the job does not state their size, or too little of the map is on the part.
    """
    job = job.alone()
    watch, settings, part = Watch(progress), job.measurement, job.part
    pieces, free = part.surface.in_pieces, _free_dofs(job)
    with watch.stage("register"):
        raw = _apply_mask(heights, job)
        heights, start = _add_reference(_orient(raw, job), job)
        first = register(
            heights.thinned(MAX_START_POINTS), part, loss=settings.loss or ("huber" if pieces else "tukey"),
            start=start, reach=settings.reach, clocking=settings.clocking if "rotation" in free else 0.0,
            **_registration_options(job),
        )  # fmt: skip
    with watch.stage("clean"):
        heights, instrument_effect_nm = _subtract_measured_design(job, heights, first.pose)
        outliers = 0
        if settings.outliers != "none":
            # The form error has no edges of the design, so only outliers stand out.
            rule: Literal["kong", "robust"] = "kong" if settings.outliers == "second difference" else "robust"
            removal = remove_outliers(_error_at(heights, part, first.pose), rule=rule)
            # Where many heights are outliers, the map is of another part.
            if removal.count <= MAX_OUTLIER_FRACTION * np.count_nonzero(np.isfinite(heights.z)):
                outliers = removal.count
                heights = replace(heights, z=np.where(removal.outliers, np.nan, heights.z))
        if settings.trim:
            heights = trim_edge(heights, settings.trim)
    axis = None
    with watch.stage("register all points"):
        registration = _register_at(job, heights, first.pose)
        registration = replace(registration, candidates=first.candidates, start=first.start)
        lateral_open = {"x", "y"} & set(registration.held) and settings.shift is None and not pieces
        if lateral_open and heights.x is not None and not heights.scattered:
            # The turning marks give the axis where the surface does not.
            axis = turning_centre(registration.error, feed=feed_of(job) or None, near=_origin(registration.pose))
        if axis is not None:
            free_dofs = [name for name in free if name not in registration.held]
            registration = _register_at(job, heights, _pose_on_axis(registration, axis), free=free_dofs)
    with watch.stage("judge"):
        placed, error = _to_part_frame(heights, registration)
        inside = _inside(error, part)
        zernike = _terms(inside, part.reach)
        rough = None
        if not heights.scattered:
            residual = np.full(heights.z.shape, np.nan)
            residual[~np.isnan(registration.error.z)] = error.z if zernike is None else zernike.residual.z
            rough = roughness(replace(registration.error, z=residual), form="plane")
        measured = Measured(
            job=job, heights=heights, outliers=outliers, registration=registration, placed=placed, error=error,
            form_pv_nm=pv_nm_of(inside.z), form_rms_nm=area_rms(inside, like=registration.error) * NM, zernike=zernike,
            roughness=rough,
            lenslets=lenslets(heights, part, pose=registration.pose) if has_lenslets(part.surface) else None,
            fingerprint=_fingerprint(error.z), axis=axis,
            instrument_effect_nm=instrument_effect_nm,
            texture=compare_texture(job, registration.error, registration.pose),
        )  # fmt: skip
        return replace(measured, mismatch=_explain_mismatch(measured, raw))


def _free_dofs(job: Job) -> tuple[str, ...]:
    """Return the degrees of freedom that are fitted: those of the job that no fiducial fixes."""
    fixed_dofs = {name for one in job.measurement.fixed for name in DOFS_OF_TERM[one]}
    return tuple(name for name in job.measurement.free if name not in fixed_dofs)


def _registration_options(job: Job) -> dict[str, Any]:
    settings, part = job.measurement, job.part
    terms: tuple[Surface, ...] = settings.terms
    form_error = settings.form_error
    if not terms and has_lenslets(part.surface):
        # The form of the base is fitted with the pose, otherwise it would rotate and shift the lenslets.
        terms, form_error = base_forms(part), 0.0
    return {
        "free": _free_dofs(job), "terms": terms, "form_error": form_error, "undetermined": settings.undetermined,
        "noise_nm": None if settings.noise is None else settings.noise * NM,
    }  # fmt: skip


def _register_at(job: Job, heights: HeightMap, pose: Pose, **changes: Any) -> Registration:
    """Register all points of a map close to a known pose; displaced lenslets do not pull."""
    loss = job.measurement.loss or ("huber" if job.part.surface.in_pieces else "linear")
    stated = _registration_options(job) | changes
    return register(heights, job.part, loss=loss, start=pose, reach=0.0, clocking=0.0, **stated)


def errors_at_candidates(measured: Measured) -> Iterator[tuple[Pose, HeightMap]]:
    """Yield the other poses that fit a map as well or nearly so, and the form error there. Scattered. [mm]."""
    for one in measured.registration.candidates:
        there = _register_at(measured.job, measured.heights, one.pose)
        yield there.pose, _to_part_frame(measured.heights, there)[1]


def _explain_mismatch(measured: Measured, raw: HeightMap) -> str | None:
    """Return why heights do not match the part of their job, ``None`` if they do.

    The form error of a part is less than half the departure of its design from the best-fit sphere, or from the
    best-fit plane if plausible errors of tool and machine reach half the former. Otherwise the map is of another
    part, in other units, or in another orientation.
    """
    job, off = measured.job, measured.form_rms_nm
    if job.measurement.reference != "true form":
        return None  # the heights are relative to a sphere of unknown radius
    few = measured.error.thinned(CHECK_POINTS)
    x, y = few.points()
    inside = np.isfinite(few.z) & job.part.covers(x, y)
    x, y = x[inside], y[inside]
    design = job.part.surface.sag(x, y)
    departures_nm = [
        float(np.sqrt(np.mean(subtract_pose(job, x, y, design, sphere=one) ** 2))) * NM for one in (True, False)
    ]
    shapes = ("best-fit sphere", "best-fit plane")
    better = None
    name = measured.heights.name or job.part.name
    if zeros := _describe_zeros(measured):
        return f"the heights of {name!r} do not match this part: {zeros}"
    faintest = PLAUSIBLE_SIGMAS * measured.registration.noise_nm
    if any(max(DEPARTURE_FRACTION * one, faintest) < off <= MAX_FLIP_RATIO * one for one in departures_nm):
        better = _better_orientation(job, raw)
    form = PLAUSIBLE_SIGMAS * job.measurement.form_error * RMS_PER_RIM_HEIGHT * NM
    plausible = form
    if better is None:
        if off <= max(DEPARTURE_FRACTION * departures_nm[0], form):
            return None
        try:
            tool_and_machine_nm = plausible_rms_nm(
                job.part, job.tool, job.machine, x, y, free=_free_terms(job), sense=job.strategy.sense
            )
            plausible = float(np.hypot(form, PLAUSIBLE_SIGMAS * tool_and_machine_nm))
        except InputError:
            return None  # too little of the part was measured
        which = 0 if DEPARTURE_FRACTION * departures_nm[0] > plausible else 1
        if off <= max(DEPARTURE_FRACTION * departures_nm[which], plausible):
            return None
    else:
        which = 0 if DEPARTURE_FRACTION * departures_nm[0] < off else 1
    return (
        f"the heights of {name!r} do not match this part: the form error is {off:.4g} nm rms, and the design departs "
        f"from its {shapes[which]} by {departures_nm[which]:.4g} nm. " + (better or CHECK_ADVICE)
    )


def _describe_zeros(measured: Measured) -> str | None:
    """Return in a sentence that heights of exactly 0 are outliers, ``None`` if they are not."""
    error, heights = measured.registration.error.z, measured.heights.z
    valid = np.isfinite(error)
    zero = valid & (heights == 0)
    count, of = int(np.count_nonzero(zero)), int(np.count_nonzero(valid))
    if not MIN_ZERO_FRACTION * of < count < of:
        return None
    off, others = (float(np.median(np.abs(error[some]))) * NM for some in (zero, valid & ~zero))
    if off <= MIN_ZERO_ERROR_RATIO * others:
        return None
    return (
        f"{count} of its {of} heights are exactly 0, with a median error of {off:.3g} nm against {others:.3g} nm of "
        "the others. Leave out missing heights, or name a mask in [measurement]."
    )


def _better_orientation(job: Job, raw: HeightMap) -> str | None:
    """Return in a sentence the fewest keys of the measurement with which a map fits far better."""
    settings = job.measurement
    turned = (settings.rotation or 0.0) + (np.pi if (settings.rotation or 0.0) <= 0 else -np.pi)
    changes: dict[str, tuple[str, Any]] = {
        "mirrored": (f"mirrored = {str(not settings.mirrored).lower()}", not settings.mirrored),
        "inverted": (f"inverted = {str(not settings.inverted).lower()}", not settings.inverted),
        "rotation": (f'rotation = "{np.rad2deg(turned):.6g} deg"', turned),
    }
    if axisymmetric(job.part.surface, job.part.reach):
        changes = {"inverted": changes["inverted"]}
    thin = raw.thinned(CHECK_POINTS)
    off_nm = _fit_nm(job, thin)
    for count in range(1, len(changes) + 1):
        orientations = []
        for keys in combinations(changes, count):
            table = replace(settings, **{key: changes[key][1] for key in keys})
            with suppress(InputError):
                orientations.append((_fit_nm(replace(job, measurement=table), thin), keys))
        best = min((fits for fits, _ in orientations), default=np.inf)
        if best * MIN_IMPROVEMENT <= off_nm:
            # A mirror-symmetric part fits as well rotated as mirrored.
            alike = [
                ", ".join(changes[key][0] for key in keys)
                for fits, keys in orientations
                if fits <= MAX_TIE_RATIO * best
            ]
            return (
                f"It is {best:.3g} nm rms with {' or with '.join(alike)} in [measurement]: state the one that is true."
            )
    return None


def _fit_nm(job: Job, raw: HeightMap) -> float:
    """Return the rms form error of the points of a map without the largest. [nm]."""
    heights, start = _add_reference(_orient(raw, job), job)
    settings = job.measurement
    free = _free_dofs(job)
    registration = register(
        heights, job.part, loss="huber", start=start, free=free, reach=settings.reach,
        clocking=settings.clocking if "rotation" in free else 0.0, form_error=settings.form_error,
    )  # fmt: skip
    squares = np.sort(registration.error.z[np.isfinite(registration.error.z)] ** 2)
    return float(np.sqrt(np.mean(squares[: int(np.ceil(INLIER_FRACTION * squares.size))]))) * NM


def subtract_pose(job: Job, x: Floats, y: Floats, z: Floats, *, sphere: bool = False) -> Floats:
    """Return errors without a change of pose in the free degrees of freedom, and without a sphere. (n,) [mm]."""
    zx, zy = job.part.surface.gradient(x, y)
    one, free = np.ones_like(x), _free_dofs(job)
    marks = {"z": one, "tilt_x": y, "tilt_y": x, "x": zx, "y": zy, "rotation": y * zx - x * zy}
    columns = [mark for name, mark in marks.items() if name in free]
    columns += [x * x + y * y] if sphere else []
    if not columns:
        return z
    rows = np.stack(columns, axis=1)
    rows = rows / np.maximum(np.sqrt((rows**2).mean(axis=0)), MIN_SIGNATURE)
    seen = np.isfinite(z)
    return np.asarray(z - rows @ np.linalg.lstsq(rows[seen], z[seen], rcond=RANK_TOL)[0])


def _subtract_measured_design(job: Job, heights: HeightMap, pose: Pose) -> tuple[HeightMap, float | None]:
    """Return heights without the change of the design by the job's instrument, and its rms. [nm]."""
    added = measured_design(job, heights, pose)
    if added is None:
        return heights, None
    return replace(heights, z=heights.z - added), float(np.std(added[~np.isnan(heights.z)])) * NM


def _fingerprint(error: Floats) -> str:
    """Return count, rms, skewness and kurtosis of errors; noise makes them differ in every measurement."""
    off = error - error.mean()
    size = max(float(np.sqrt(np.mean(off**2))), 1e-12)
    skewness, kurtosis = (float(np.mean((off / size) ** power)) for power in (3, 4))
    return f"{error.size} points, {size * NM:.5g} nm, {skewness:.4f}, {kurtosis:.4f}"


def _origin(pose: Pose) -> tuple[float, float]:
    """Return the position of the part axis in the map. [mm]."""
    x, y, _ = pose.inverse.apply(0.0, 0.0, 0.0)
    return float(x), float(y)


def _pose_on_axis(registration: Registration, axis: TurningCentre) -> Pose:
    """Return the pose with the axis of turning on the part axis, along the fixed degrees of freedom."""
    pose = registration.pose
    x, y, _ = pose.apply(axis.x, axis.y, 0.0)
    shift = list(pose.shift)
    for k, (name, at) in enumerate((("x", float(x)), ("y", float(y)))):
        if name in registration.held:
            shift[k] -= at
    return replace(pose, shift=(shift[0], shift[1], shift[2]))


@overload
def diagnose(
    measured: Measured | Sequence[Measured], *, progress: StageProgress | None = None
) -> Diagnosis: ...  # fmt: skip
@overload
def diagnose(
    measured: HeightMap | Sequence[HeightMap], parts: Part | Sequence[Part], tool: Tool, machine: Machine,
    *, progress: StageProgress | None = None, **options: Any,
) -> Diagnosis: ...  # fmt: skip
def diagnose(
    measured: Measured | HeightMap | Sequence[Measured] | Sequence[HeightMap],
    parts: Part | Sequence[Part] | None = None,
    tool: Tool | None = None,
    machine: Machine | None = None,
    *,
    progress: StageProgress | None = None,
    **options: Any,
) -> Diagnosis:
    """Attribute the form errors of measured parts to their sources. See `turnwright.diagnosis.diagnose`.

    Errors are averaged over small cells first, so that every height of a map counts. A part that was cut by an earlier
    job, before a correction, counts as well: simulation converts its errors to those of the first job.

    Parameters
    ----------
    measured
        Measured parts or test parts, all cut with one tool on one machine and diagnosed together, by the plan of the
        first. Bare maps, registered and without outliers, need ``parts``, ``tool`` and ``machine`` too.
    parts, tool, machine
        Design, tool and machine of bare maps.
    progress
        Called with (stage, done, total).
    options
        Further arguments of `turnwright.diagnosis.diagnose` for bare maps. Measured parts take them from their job.

    Raises
    ------
    InputError
        If jobs of different parts were planned with different tools or machines.
    """
    every = [measured] if isinstance(measured, Measured | HeightMap) else list(measured)
    samples = [one for one in every if isinstance(one, Measured)]
    with Watch(progress).stage("diagnose"):
        if parts is not None and tool is not None and machine is not None:
            return attribute([one for one in every if isinstance(one, HeightMap)], parts, tool, machine, **options)
        if len(samples) < len(every) or options:
            raise InputError("a map without a job needs part, tool and machine: give them, or give the job")
        return _diagnose_all(samples)


def _diagnose_all(every: Sequence[Measured]) -> Diagnosis:
    if not every:
        raise InputError("a diagnosis needs at least 1 measured part, got 0")
    first = every[0].job
    for one in every[1:]:
        if not same_part(one.job, first) and _nominal_equipment(one.job) != _nominal_equipment(first):
            raise InputError(
                f"{one.job.part.name!r} and {first.part.name!r} were planned with different tools or machines, a "
                "diagnosis allows 1 of each: diagnose them separately"
            )
    for k, one in enumerate(every):
        if any(one.fingerprint == other.fingerprint for other in every[:k]):
            raise InputError(
                f"the map {one.heights.name[:40]!r} is given twice, a diagnosis of several parts needs a map of each: "
                "measure another part of the same job"
            )
    settings = first.measurement
    means = [_average_over_cells(one, first) for one in every]
    diagnosis = attribute(
        [one.heights for one in means], [one.job.part.design for one in every], first.tool, first.machine,
        error_sources=settings.error_sources or DEFAULT, reference=settings.reference, free=_free_terms(first),
        waviness=settings.waviness, sense=first.strategy.sense, min_effect_nm=settings.min_effect * NM,
        points=2 * CELL_COUNT,
        noise_nm=[one.noise_nm for one in means], repeats=settings.repeats, correct=settings.correct,
    )  # fmt: skip
    if settings.reference != "true form" or any(one.job != first for one in every):
        return diagnosis  # maps whose errors were converted to those of another job have no form error of their own
    # The form error is that of the measurement: errors within the cells are residual.
    measured_nm = float(np.sqrt(np.mean([one.form_rms_nm**2 for one in every])))
    residual_nm = float(np.sqrt(diagnosis.unexplained_rms_nm**2 + np.mean([one.averaged_nm**2 for one in means])))
    return replace(diagnosis, measured_rms_nm=measured_nm, unexplained_rms_nm=residual_nm)


def _free_terms(job: Job) -> list[str]:
    return [one for one in FREE if one not in job.measurement.fixed]


def _nominal_equipment(job: Job) -> tuple[Tool, Machine]:
    """Return tool and machine without their plausible errors."""
    return replace(job.tool, plausible={}), replace(job.machine, plausible={})


def cutoff_of(job: Job) -> float:
    """Return the shortest wavelength of the form that is corrected, well above that of cusps. [mm]."""
    diameter = 2 * job.part.reach
    return job.measurement.cutoff or min(
        max(MIN_CUTOFF_FEEDS * feed_of(job), diameter / CUTOFFS_PER_DIAMETER), diameter / 2
    )


def same_part(one: Job, other: Job) -> bool:
    """Whether two jobs cut the same design with the same strategy, apart from corrections."""
    design, other_design = (job.part.design for job in (one, other))
    return design == other_design and one.strategy == other.strategy and one.passes[-1:] == other.passes[-1:]


class _Means(NamedTuple):
    """A part's errors averaged over small cells, on the design."""

    heights: HeightMap  # scattered [mm]
    noise_nm: float  # of a mean, from the stated noise of a height; 0 if none is stated
    averaged_nm: float  # rms of the errors about the means of their cells


def _average_over_cells(measured: Measured, job: Job) -> _Means:
    """Return a part's errors averaged over small cells, on the design, as if the job had cut it.

    The planned cusps and chords are subtracted: they are no errors of tool or machine.
    """
    part = measured.job.part
    x, y = measured.error.points()
    error = measured.error.z
    inside = part.covers(x, y)
    x, y, error = x[inside], y[inside], error[inside]
    cell = min(part.reach * np.sqrt(np.pi / CELL_COUNT), part.surface.feature_size / CELLS_PER_FEATURE)
    number = _number_cells(x, y, cell)
    if part.surface.in_pieces:
        # No cell extends across a seam.
        piece = np.asarray(part.surface.piece(x, y))
        piece = piece - piece.min(initial=0)
        number = number * (int(piece.max(initial=0)) + 1) + piece
    which, at = np.unique(number, return_inverse=True)
    count = np.bincount(at, minlength=which.size)
    few = slice(None, None, -(-which.size // (2 * CELL_COUNT)) or 1)
    means = [np.bincount(at, weights=one, minlength=which.size) / count for one in (x, y, error)]
    averaged = float(np.sqrt(np.mean((error - means[2][at]) ** 2)))
    noise = (measured.job.measurement.noise or 0.0) * float(np.sqrt(np.mean(1 / count[few])))
    x, y, error = (one[few] for one in means)
    real = job if same_part(measured.job, job) else measured.job
    across = across_feed(measured.job, x, y)
    flat = [one.ravel() for one in across]
    planned = cut_heights(motion_of(measured.job), real, *flat) - real.part.aimed.surface.sag(*flat)
    error -= planned.reshape(across[0].shape).mean(axis=1)
    heights = HeightMap(x=x, y=y, z=part.surface.sag(x, y) + error, name=measured.heights.name)
    return _Means(heights, noise * NM, averaged * NM)


def _number_cells(x: Floats, y: Floats, cell: float) -> Ints:
    """Return the number of the square cell of each point. (n,)."""
    column, row = (np.floor((at - at.min(initial=0.0)) / cell).astype(np.int64) for at in (x, y))
    return np.asarray(row * (int(column.max(initial=0)) + 1) + column)


def _apply_mask(heights: HeightMap, job: Job) -> HeightMap:
    file = job.measurement.mask
    if file is None:
        return heights
    mask = read_measurement(job, file)
    if mask.z.shape != heights.z.shape:
        raise InputError(
            f"the mask {file.name} has the shape {mask.z.shape}, the map {heights.z.shape}: give a map of the same grid"
        )
    return replace(heights, z=np.where(_read_mask(mask.z, file.name), heights.z, np.nan))


def _read_mask(mask: Floats, name: str) -> Bools:
    """Return which heights a mask selects: its valid ones, or the ones in a mask of 0 and 1."""
    valid = ~np.isnan(mask)
    values = np.unique(mask[valid])
    if values.size == 2 and values[0] == 0 and values[1] > 0:  # 1 in the unit of the file
        return np.asarray(valid & (mask > 0))
    if valid.all():
        raise InputError(
            f"the mask {name} has no missing heights and other values than 0 and 1, so it masks nothing: leave "
            "out the heights to ignore, or give 1 for heights to use and 0 elsewhere"
        )
    return valid


def _orient(heights: HeightMap, job: Job) -> HeightMap:
    """Return the map in millimetres, viewed from the tool side, with the material below."""
    settings = job.measurement
    if settings.pixel_size is not None:
        heights = heights.scaled(settings.pixel_size)
    heights.require_calibrated()
    if settings.inverted:
        heights = replace(heights, z=-heights.z)
    if settings.mirrored and heights.x is not None:
        mirrored = -heights.x
        if heights.scattered:
            return replace(heights, x=mirrored)
        return replace(heights, x=mirrored[::-1], z=heights.z[:, ::-1])
    return heights


def _add_reference(heights: HeightMap, job: Job) -> tuple[HeightMap, Pose | None]:
    """Return heights instead of departures, and the approximate pose of the map.

    The reference is fixed to the instrument: its axis is at the stated pose of the map, or at the origin of the map, or
    in its middle where the map does not reach the origin. A departure along the normal is converted to one along z by
    the slope of the reference; the neglected term is half its square times the curvature.
    """
    settings = job.measurement
    if settings.quantity == "height":
        return heights, settings.pose
    reference = job.reference
    x, y = heights.points()
    valid = ~np.isnan(heights.z)
    pose = settings.pose
    if pose is None:
        spans = [(float(at[valid].min()), float(at[valid].max())) for at in (x, y)]
        misses_origin = any(low > 0 or high < 0 for low, high in spans)
        pose = Pose(shift=(-sum(spans[0]) / 2, -sum(spans[1]) / 2, 0.0)) if misses_origin else Pose()
    u, v, _ = pose.apply(x[valid], y[valid], 0.0)
    inside = reference.inside(u, v)
    on = np.ones(u.shape, dtype=np.bool_) if inside is None else inside
    departure = heights.z[valid][on]
    if settings.quantity == "departure, along the normal":
        departure = departure * np.sqrt(1 + sum(slope**2 for slope in reference.gradient(u[on], v[on])))
    height = np.full(u.shape, np.nan)
    height[on] = departure + reference.sag(u[on], v[on])
    z = np.full(heights.z.shape, np.nan)
    z[valid] = height
    return replace(heights, z=z), pose


def _inside(error: HeightMap, part: Part) -> HeightMap:
    """Return an error without heights outside the clear aperture."""
    return crop_to_aperture(_on_outline(error, part), part.reach * (1 + EDGE))


def _on_outline(error: HeightMap, part: Part) -> HeightMap:
    """Return an error without heights beyond the outline of a part; that of a disc as it is."""
    if part.outline is None:
        return error
    return replace(error, z=np.where(part.border.distance(*error.points()) <= part.reach * EDGE, error.z, np.nan))


def _error_at(heights: HeightMap, part: Part, pose: Pose) -> HeightMap:
    """Return measured minus design at a pose, on the grid of the map, nan beyond the clear aperture. [mm]."""
    valid = ~np.isnan(heights.z)
    x, y = heights.points()
    x, y, z = pose.apply(x[valid], y[valid], heights.z[valid])
    on = part.covers(x, y)
    error = np.full(z.size, np.nan)
    error[on] = z[on] - part.surface.sag(x[on], y[on])
    error_map = np.full(heights.z.shape, np.nan)
    error_map[valid] = error
    return replace(heights, z=error_map)


def _to_part_frame(heights: HeightMap, registration: Registration) -> tuple[HeightMap, HeightMap]:
    """Return the heights and their errors in the frame of the part, scattered."""
    x, y = heights.points()
    used = ~np.isnan(registration.error.z)
    x, y, z = registration.pose.apply(x[used], y[used], heights.z[used])
    placed = HeightMap(x=x, y=y, z=z, name=heights.name)
    return placed, HeightMap(x=x, y=y, z=registration.error.z[used], name=f"{heights.name} error".strip())


def _terms(error: HeightMap, radius: float) -> ZernikeFit | None:
    try:
        return fit_zernike(error, terms=ZERNIKE_TERMS, indexing="fringe", radius=radius, centre=(0.0, 0.0))
    except InputError:
        return None
