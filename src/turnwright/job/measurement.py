"""From an instrument's file to how far a part is off: clean, register, and judge what is left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, overload

import numpy as np

from turnwright.diagnosis import DEFAULT, FREE, Diagnosis, diagnose as attribute, plausible_rms_nm
from turnwright.errors import InputError, MapError
from turnwright.files import read_map
from turnwright.heightmap import HeightMap
from turnwright.job.advice import open_questions
from turnwright.job.contributions import pv_nm_of
from turnwright.job.named import with_keys
from turnwright.job.predicted_finish import across_feed, feed_of, finished
from turnwright.job.seen import SeenTexture, design_as_seen, texture_as_seen
from turnwright.job.verdict import Verdict, judge_form
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
    despike,
    fit_zernike,
    has_lenslets,
    keep_disc,
    lenslets,
    register,
    roughness,
    trim_edge,
    turning_centre,
)
from turnwright.pose import Pose
from turnwright.surface import Surface

if TYPE_CHECKING:
    from os import PathLike

    from turnwright._arrays import Bools, Floats, Ints
    from turnwright.job.schema import Job
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.progress import StageProgress
    from turnwright.tool import Tool

__all__ = ["Measured", "beyond_pose", "cutoff_of", "diagnose", "measure", "read_measurement", "same_part"]

FIRST = 100_000
"""Points by which a map is found on the part before its spikes are known."""

NM = 1e6

CELLS = 20_000
"""Cells of a map whose mean errors are explained."""

FINE = 5
"""Cells on the feature size of a surface at least, so 40 on a wave: its mean over one is less than 0.1 % off."""

FEEDS = 40
"""Least cutoff of a correction in feeds: cusps have the wavelength of one."""

ACROSS = 30
"""Cutoffs on the diameter, unless the job states one."""

MOST_SPIKES = 0.25
"""Share of the heights that are spikes at most."""

FEW = 3_000
"""Points by which a part is told from another one."""

FAR = 3.0
"""Plausible sizes of errors beyond which a part is not off by these."""

SHARE = 0.5
"""Share of what the design has beyond a sphere, or a plane, by which a part of this design is not off."""

TWICE = 3.0
"""A map that is turned is off by at most twice what the design has there, its noise and errors aside."""

BETTER = 5.0
"""By so much less a part must be off in another orientation to be taken to lie so."""

CHECK = (
    "Check the unit of the heights, the pixel size, mirrored, inverted and rotation, whether heights that are missing "
    "are stored as 0, and the part."
)
"""What to do with a map that does not look like its part in any orientation."""

ALIKE = 1.2
"""Orientations fit as well if the part is off by no more than this many times the best of them."""

ZEROS, STANDS_OUT = 0.005, 5.0
"""Share of heights of exactly 0, and how much farther off than the others they are, that are no heights."""

OF_RIM = 6**-0.5
"""Root mean square of an astigmatism over its height at the rim."""

KNOWN = 0.95
"""Share of the points by which orientations are compared: spikes are in the map yet."""

FLAT, RANK = 1e-12, 1e-6
"""Marks of a pose that are smaller than this are none, and those that others make but for this share."""

OF_POSE = MappingProxyType(
    {"piston": ("z",), "tilt": ("tilt_x", "tilt_y"), "decentre": ("x", "y"), "clocking": ("rotation",)}
)
"""What a registration calls that which a diagnosis leaves open."""

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
        Of the error within the clear radius, the rms over the area that the points of the map stand for. [nm]
    zernike
        The error in fringe terms over the clear radius, or ``None`` if too little of the part was measured for them.
    roughness
        Of what the terms leave, in the map's own grid; ``None`` for scattered points.
    lenslets
        Every lenslet's place and form, if the part has some.
    fingerprint
        Of the map, by which a job knows again that it was corrected by it, in whatever file and unit it comes.
    axis
        Where the axis of turning stands in the map, if the surface does not tell its lateral place and the marks of
        turning do: the part was put about it. ``None`` otherwise.
    seen_design_nm
        What the job's instrument makes of the design by itself, rms over the heights; it is taken off them. ``None``
        if the job states no instrument, or it cannot be applied to such a map. [nm]
    texture
        The cusps against the predicted ones, seen through that instrument, if it was stated and the map shows them.
    misplaced
        Why the heights do not look like this part as the job has it placed, in a sentence; ``None`` if they do.
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
    fingerprint: str
    axis: TurningCentre | None = None
    seen_design_nm: float | None = None
    texture: SeenTexture | None = None
    misplaced: str | None = None

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Which stated tolerances the measured part keeps: the form; a map of the form does not resolve the finish."""
        return judge_form(
            self.job, self.form_pv_nm, sq_reason="it is that of the patches, predict them or measure each"
        )

    @property
    def as_seen(self) -> tuple[str, ...]:
        """What the job's instrument makes of the part, in sentences; none if the job states no instrument."""
        seen = self.job.measurement.instrument
        if seen is None:
            return ()
        stated = f"seen through {seen.name or 'the stated instrument'} ({seen.summary})"
        if self.seen_design_nm is None:
            return (f"{stated}: it cannot be applied to the design on these places, which need an even grid",)
        return (
            f"{stated}: it changes the design by {self.seen_design_nm:.3g} nm rms, which is taken off the heights",
            *([] if self.texture is None else [self.texture.sentence]),
        )

    @property
    def open_questions(self) -> tuple[str, ...]:
        """What the registration could not settle, and what to write in the job's ``measurement`` to settle it."""
        found = open_questions(self.registration, self.job.measurement, self.job.part.radius)
        return found if self.misplaced is None else (self.misplaced, *found)


def read_measurement(job: Job, file: str | PathLike[str], *, unit: str | None = None) -> HeightMap:
    """Read a measured map in the units that the file states, or else the job.

    Parameters
    ----------
    job
        Whose ``measurement`` says what is known of the instrument.
    file
        See `turnwright.read_map`.
    unit
        Of the heights, in place of the job's.

    Raises
    ------
    MapError
        See `turnwright.read_map`; of a unit that neither file nor job states, with the key of the job that does.
    """
    asked = job.measurement
    try:
        return read_map(file, unit=unit or asked.sag_units, lateral_unit=asked.units or "")
    except MapError as error:
        raise MapError(with_keys(str(error), "[measurement]")) from error


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
    report = progress or (lambda _stage, _done, _total: None)
    asked, part = job.measurement, job.part
    report("register", 0, 1)
    raw = _masked(heights, job)
    heights, start = _with_reference(_turned(raw, job), job)
    pieces = part.surface.in_pieces
    common = _registered_by(job)
    free = common["free"]
    first = register(
        heights.thinned(FIRST), part, loss=asked.loss or ("huber" if pieces else "tukey"), start=start,
        reach=asked.reach, clocking=asked.clocking if "rotation" in free else 0.0, **common,
    )  # fmt: skip
    report("register", 1, 1)
    report("clean", 0, 1)
    heights, seen_design_nm = _without_seen_design(job, heights, first.pose)
    spikes = 0
    if asked.spikes != "none":
        # The error shows no edges of the part, so only what does not belong there stands out.
        found = despike(
            _error_at(heights, part, first.pose), rule="kong" if asked.spikes == "second difference" else "robust"
        )
        # Where most of the heights stand out, it is not the heights that are wrong: the map is of another part.
        if found.count <= MOST_SPIKES * np.count_nonzero(np.isfinite(heights.z)):
            spikes = found.count
            heights = replace(heights, z=np.where(found.spikes, np.nan, heights.z))
    if asked.trim:
        heights = trim_edge(heights, asked.trim)
    report("clean", 1, 1)
    report("register all points", 0, 1)
    registration = register(
        heights, part, loss=_loss_of(job), start=first.pose, reach=0.0, clocking=0.0,
        **common,
    )  # fmt: skip
    registration = replace(registration, candidates=first.candidates, start=first.start)
    axis = None
    open_ = {"x", "y"} & set(registration.held) and asked.shift is None and not pieces
    if open_ and heights.x is not None and not heights.scattered:
        # What the surface leaves open the marks of turning tell.
        axis = turning_centre(
            registration.error, feed=feed_of(job) or None, near=_origin(registration.pose)
        )  # fmt: skip
    if axis is not None:
        start = _about_axis(registration, axis)
        kept = [name for name in free if name not in registration.held]
        registration = register(
            heights, part, loss=_loss_of(job), start=start, reach=0.0, clocking=0.0,
            **{**common, "free": kept},
        )  # fmt: skip
    report("register all points", 1, 1)
    report("judge", 0, 1)
    placed, error = _on_part(heights, registration)
    inside = keep_disc(error, part.radius * (1 + EDGE))
    zernike = _terms(inside, part.radius)
    rough = None
    if not heights.scattered:
        left = np.full(heights.z.shape, np.nan)
        left[~np.isnan(registration.error.z)] = error.z if zernike is None else zernike.residual.z
        rough = roughness(replace(registration.error, z=left), form="plane")
    measured = Measured(
        job=job, heights=heights, spikes=spikes, registration=registration, placed=placed, error=error,
        form_pv_nm=pv_nm_of(inside.z), form_rms_nm=area_rms(inside, like=registration.error) * NM, zernike=zernike,
        roughness=rough,
        lenslets=lenslets(heights, part, pose=registration.pose) if has_lenslets(part.surface) else None,
        fingerprint=_fingerprint(error.z), axis=axis,
        seen_design_nm=seen_design_nm, texture=texture_as_seen(job, registration.error, registration.pose),
    )  # fmt: skip
    measured = replace(measured, misplaced=_misplaced(measured, raw))
    report("judge", 1, 1)
    return measured


def _registered_by(job: Job) -> dict[str, Any]:
    """Return what a job states of the registration of its maps, as `register` takes it."""
    asked, part = job.measurement, job.part
    # What a fiducial fixes is not fitted away beforehand.
    known = {name for one in asked.fixed for name in OF_POSE[one]}
    terms: tuple[Surface, ...] = asked.terms
    form_error = asked.form_error
    if not terms and has_lenslets(part.surface):
        # The form of the base is found along with the pose, else it turns and shifts the lenslets.
        terms, form_error = base_forms(part), 0.0
    return {
        "free": tuple(name for name in asked.free if name not in known), "terms": terms, "form_error": form_error,
        "weak": asked.weak, "noise_nm": None if asked.noise is None else asked.noise * NM,
    }  # fmt: skip


def _loss_of(job: Job) -> Literal["linear", "huber", "tukey"]:
    """Return the loss by which all points of a map are registered: displaced lenslets must not pull."""
    return job.measurement.loss or ("huber" if job.part.surface.in_pieces else "linear")


def errors_at_candidates(measured: Measured) -> Iterator[tuple[Pose, HeightMap]]:
    """Yield the poses at which a map lies on its part as well or nearly so, and its errors there. Scattered. [mm]."""
    job = measured.job
    part = job.part
    for one in measured.registration.candidates:
        there = register(
            measured.heights, part, loss=_loss_of(job), start=one.pose, reach=0.0, clocking=0.0, **_registered_by(job)
        )  # fmt: skip
        yield there.pose, _on_part(measured.heights, there)[1]


def _misplaced(measured: Measured, raw: HeightMap) -> str | None:
    """Return why heights do not look like the part of their job, ``None`` if they do.

    A part is not off by half of what its design has beyond a sphere, or beyond a plane if tool and machine plausibly
    make as much as that: another one is in the map, or this one in other units, or seen from another side.
    """
    job, off = measured.job, measured.form_rms_nm
    if job.measurement.reference != "true form":
        return None  # the heights hold a departure from a sphere that is not known
    few = measured.error.thinned(FEW)
    x, y = few.points()
    inside = np.isfinite(few.z) & (np.hypot(x, y) <= job.part.radius)
    x, y = x[inside], y[inside]
    design = job.part.surface.sag(x, y)
    own = [float(np.sqrt(np.mean(beyond_pose(job, x, y, design, sphere=one) ** 2))) * NM for one in (True, False)]
    shapes = ("best-fit sphere", "best-fit plane")
    better = None
    name = measured.heights.name or job.part.name
    if zeros := _zeros(measured):
        return f"the heights of {name!r} do not look like this part: {zeros}"
    faintest = FAR * measured.registration.noise_nm
    if any(max(SHARE * one, faintest) < off <= TWICE * one for one in own):
        better = _better_orientation(job, raw)
    form = FAR * job.measurement.form_error * OF_RIM * NM
    plausible = form
    if better is None:
        if off <= max(SHARE * own[0], form):
            return None
        try:
            plausible = float(np.hypot(form, FAR * _plausible_nm(job, x, y)))
        except InputError:
            return None  # too little of the part is there
        which = 0 if SHARE * own[0] > plausible else 1
        if off <= max(SHARE * own[which], plausible):
            return None
    else:
        which = 0 if SHARE * own[0] < off else 1
    return (
        f"the heights of {name!r} do not look like this part: they are off by {off:.4g} nm rms, and the design departs "
        f"from its {shapes[which]} by {own[which]:.4g} nm. " + (better or CHECK)
    )


def _zeros(measured: Measured) -> str | None:
    """Return that heights of exactly 0 stand out of the others, in a sentence, if they do."""
    error, heights = measured.registration.error.z, measured.heights.z
    known = np.isfinite(error)
    zero = known & (heights == 0)
    count, of = int(np.count_nonzero(zero)), int(np.count_nonzero(known))
    if not ZEROS * of < count < of:
        return None
    off, others = (float(np.median(np.abs(error[some]))) * NM for some in (zero, known & ~zero))
    if off <= STANDS_OUT * others:
        return None
    return (
        f"{count} of its {of} heights are exactly 0 and off by {off:.3g} nm, most of the others by less than "
        f"{others:.3g} nm. Leave out heights that are missing, or name a mask in [measurement]."
    )


def _plausible_nm(job: Job, x: Floats, y: Floats) -> float:
    """Return what tool and machine plausibly make of a part, one standard deviation. [nm]."""
    free = [one for one in FREE if one not in job.measurement.fixed]
    return plausible_rms_nm(job.part, job.tool, job.machine, x, y, free=free, sense=job.strategy.sense)


def _better_orientation(job: Job, raw: HeightMap) -> str | None:
    """Return the keys of the measurement by which a map fits far better, in a sentence, the fewest of them."""
    asked = job.measurement
    turned = (asked.rotation or 0.0) + (np.pi if (asked.rotation or 0.0) <= 0 else -np.pi)
    changes: dict[str, tuple[str, Any]] = {
        "mirrored": (f"mirrored = {str(not asked.mirrored).lower()}", not asked.mirrored),
        "inverted": (f"inverted = {str(not asked.inverted).lower()}", not asked.inverted),
        "rotation": (f'rotation = "{np.rad2deg(turned):.6g} deg"', turned),
    }
    if axisymmetric(job.part.surface, job.part.radius):
        changes = {"inverted": changes["inverted"]}
    thin = raw.thinned(FEW)
    off_nm = _fit_nm(job, thin)
    for count in range(1, len(changes) + 1):
        found = []
        for keys in combinations(changes, count):
            table = replace(asked, **{key: changes[key][1] for key in keys})
            with suppress(InputError):
                found.append((_fit_nm(replace(job, measurement=table), thin), keys))
        best = min((fits for fits, _ in found), default=np.inf)
        if best * BETTER <= off_nm:
            # A part that is its own mirror image fits as well turned as mirrored.
            alike = [", ".join(changes[key][0] for key in keys) for fits, keys in found if fits <= ALIKE * best]
            return f"It is off by {best:.3g} nm with {' or with '.join(alike)} in [measurement]: write what is so."
    return None


def _fit_nm(job: Job, raw: HeightMap) -> float:
    """Return how far a part is off by most of the points of a map, rms. [nm]."""
    heights, start = _with_reference(_turned(raw, job), job)
    asked = job.measurement
    known = {name for one in asked.fixed for name in OF_POSE[one]}
    free = tuple(name for name in asked.free if name not in known)
    found = register(
        heights, job.part, loss="huber", start=start, free=free, reach=asked.reach,
        clocking=asked.clocking if "rotation" in free else 0.0, form_error=asked.form_error,
    )  # fmt: skip
    squares = np.sort(found.error.z[np.isfinite(found.error.z)] ** 2)
    return float(np.sqrt(np.mean(squares[: int(np.ceil(KNOWN * squares.size))]))) * NM


def beyond_pose(job: Job, x: Floats, y: Floats, z: Floats, *, sphere: bool = False) -> Floats:
    """Return errors beyond a change of pose that the measurement leaves open, and beyond a sphere. (n,) [mm]."""
    zx, zy = job.part.surface.gradient(x, y)
    one, asked = np.ones_like(x), job.measurement
    marks = {"z": one, "tilt_x": y, "tilt_y": x, "x": zx, "y": zy, "rotation": y * zx - x * zy}
    known = {name for fixed in asked.fixed for name in OF_POSE[fixed]}
    columns = [mark for name, mark in marks.items() if name in asked.free and name not in known]
    columns += [x * x + y * y] if sphere else []
    if not columns:
        return z
    rows = np.stack(columns, axis=1)
    rows = rows / np.maximum(np.sqrt((rows**2).mean(axis=0)), FLAT)
    seen = np.isfinite(z)
    return np.asarray(z - rows @ np.linalg.lstsq(rows[seen], z[seen], rcond=RANK)[0])


def _without_seen_design(job: Job, heights: HeightMap, pose: Pose) -> tuple[HeightMap, float | None]:
    """Return heights without what the job's instrument makes of the design, and its rms. [nm]."""
    added = design_as_seen(job, heights, pose)
    if added is None:
        return heights, None
    return replace(heights, z=heights.z - added), float(np.std(added[~np.isnan(heights.z)])) * NM


def _fingerprint(error: Floats) -> str:
    """Return size, skewness and kurtosis of errors, which noise makes other ones in every measurement."""
    off = error - error.mean()
    size = max(float(np.sqrt(np.mean(off**2))), 1e-12)
    skewness, kurtosis = (float(np.mean((off / size) ** power)) for power in (3, 4))
    return f"{error.size} points, {size * NM:.5g} nm, {skewness:.4f}, {kurtosis:.4f}"


def _origin(pose: Pose) -> tuple[float, float]:
    """Return where the axis of the part is in the map. [mm]."""
    x, y, _ = pose.inverse.apply(0.0, 0.0, 0.0)
    return float(x), float(y)


def _about_axis(registration: Registration, axis: TurningCentre) -> Pose:
    """Return the pose that has the axis of turning where the part has it, along what was held."""
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
    *, progress: StageProgress | None = None, **asked: Any,
) -> Diagnosis: ...  # fmt: skip
def diagnose(
    measured: Measured | HeightMap | Sequence[Measured] | Sequence[HeightMap],
    parts: Part | Sequence[Part] | None = None,
    tool: Tool | None = None,
    machine: Machine | None = None,
    *,
    progress: StageProgress | None = None,
    **asked: Any,
) -> Diagnosis:
    """Say why measured parts are off. See `turnwright.diagnosis.diagnose`.

    Errors are averaged over small cells first, so every height of a map counts. A part that was cut by an earlier job,
    before a correction, counts as well: by simulation its errors are turned into those that the first of the jobs would
    have left.

    Parameters
    ----------
    measured
        Of the part, or of artefacts, all cut with one tool on one machine: what they share is found together. The first
        of them says what was planned. Bare maps, registered and clean, need ``parts``, ``tool`` and ``machine`` too.
    parts, tool, machine
        What was to be cut, with which tool on which machine, of bare maps.
    progress
        Called with (stage, done, total).
    asked
        Of bare maps: what else `turnwright.diagnosis.diagnose` takes. Of measured parts their job says it.

    Raises
    ------
    InputError
        If jobs of different parts were planned with different tools or machines.
    """
    report = progress or (lambda _stage, _done, _total: None)
    every = [measured] if isinstance(measured, Measured | HeightMap) else list(measured)
    if parts is not None and tool is not None and machine is not None:
        report("diagnose", 0, 1)
        found = attribute([one for one in every if isinstance(one, HeightMap)], parts, tool, machine, **asked)
        report("diagnose", 1, 1)
        return found
    samples = [one for one in every if isinstance(one, Measured)]
    if len(samples) < len(every) or asked:
        raise InputError(
            "a bare map does not say what was cut: give part, tool and machine with it, or measure it by its job"
        )
    return _diagnosed(samples, report)


def _diagnosed(every: Sequence[Measured], report: StageProgress) -> Diagnosis:
    """Return why measured parts are off."""
    if not every:
        raise InputError("0 measured parts are given, a diagnosis needs at least 1: measure one")
    first = every[0].job
    for one in every[1:]:
        if not same_part(one.job, first) and _planned_with(one.job) != _planned_with(first):
            raise InputError(
                f"{one.job.part.name!r} and {first.part.name!r} were planned with different tools or machines, one "
                "diagnosis takes 1 of each: diagnose them apart"
            )
    for k, one in enumerate(every):
        if any(one.fingerprint == other.fingerprint for other in every[:k]):
            raise InputError(
                f"the map {one.heights.name[:40]!r} is given twice, one measurement says nothing of what repeats: "
                "measure another part that was cut alike"
            )
    report("diagnose", 0, 1)
    asked = first.measurement
    means = [_gathered(one, first) for one in every]
    found = attribute(
        [one.heights for one in means],
        [one.job.part.design for one in every],
        first.tool,
        first.machine,
        causes=asked.causes or DEFAULT,
        reference=asked.reference,
        free=[one for one in FREE if one not in asked.fixed],
        waviness=asked.waviness,
        sense=first.strategy.sense,
        worth_nm=asked.worth * NM,
        points=2 * CELLS,
        noise_nm=[one.noise_nm for one in means],
        repeats=asked.repeats,
        correct=asked.correct,
    )
    report("diagnose", 1, 1)
    return _stated(found, every, means) if asked.reference == "true form" else found


def _planned_with(job: Job) -> tuple[Tool, Machine]:
    """Return tool and machine, whatever is held plausible of them."""
    return replace(job.tool, plausible={}), replace(job.machine, plausible={})


def _stated(found: Diagnosis, every: Sequence[Measured], means: Sequence[_Means]) -> Diagnosis:
    """Return a diagnosis that states the form error as the measurement does: what cells average out is residual.

    Maps whose errors were turned into those of another job have no such number.
    """
    if any(one.job != every[0].job for one in every):
        return found
    measured = float(np.sqrt(np.mean([one.form_rms_nm**2 for one in every])))
    left = float(np.sqrt(found.unexplained_rms_nm**2 + np.mean([one.averaged_nm**2 for one in means])))
    return replace(found, measured_rms_nm=measured, unexplained_rms_nm=left)


def cutoff_of(job: Job) -> float:
    """Return the shortest wavelength in which the part itself is corrected: well above its cusps. [mm]."""
    diameter = 2 * job.part.radius
    return job.measurement.cutoff or min(max(FEEDS * feed_of(job), diameter / ACROSS), diameter / 2)


def same_part(one: Job, other: Job) -> bool:
    """Say whether two jobs cut the same design in the same way, whatever they take into account."""
    design, other_design = (job.part.design for job in (one, other))
    return design == other_design and one.strategy == other.strategy and one.passes[-1:] == other.passes[-1:]


class _Means(NamedTuple):
    """A part's errors averaged over small cells, on the design."""

    heights: HeightMap  # scattered [mm]
    noise_nm: float  # of a mean, as the job states that of a height; 0 if it does not
    averaged_nm: float  # rms of the errors about the means of their cells


def _gathered(measured: Measured, job: Job) -> _Means:
    """Return a part's errors averaged over small cells, on the design, as if the job had cut it.

    They are without the cusps and the chords that the plan has: neither is a fault of tool or machine.
    """
    part = measured.job.part
    x, y = measured.error.points()
    error = measured.error.z
    inside = np.hypot(x, y) <= part.radius
    x, y, error = x[inside], y[inside], error[inside]
    cell = min(part.radius * np.sqrt(np.pi / CELLS), part.surface.feature_size / FINE)
    number = _cells(x, y, cell)
    if part.surface.in_pieces:
        # A mean across a seam is that of neither side.
        piece = np.asarray(part.surface.piece(x, y))
        piece = piece - piece.min(initial=0)
        number = number * (int(piece.max(initial=0)) + 1) + piece
    which, at = np.unique(number, return_inverse=True)
    count = np.bincount(at, minlength=which.size)
    few = slice(None, None, -(-which.size // (2 * CELLS)) or 1)
    means = [np.bincount(at, weights=one, minlength=which.size) / count for one in (x, y, error)]
    averaged = float(np.sqrt(np.mean((error - means[2][at]) ** 2)))
    noise = (measured.job.measurement.noise or 0.0) * float(np.sqrt(np.mean(1 / count[few])))
    x, y, error = (one[few] for one in means)
    real = job if same_part(measured.job, job) else measured.job
    across = across_feed(measured.job, x, y)
    flat = [one.ravel() for one in across]
    planned = finished(measured.job, real, *flat) - real.part.aimed.surface.sag(*flat)
    error -= planned.reshape(across[0].shape).mean(axis=1)
    heights = HeightMap(x=x, y=y, z=part.surface.sag(x, y) + error, name=measured.heights.name)
    return _Means(heights, noise * NM, averaged * NM)


def _cells(x: Floats, y: Floats, cell: float) -> Ints:
    """Return the number of the square cell that each point lies in. (n,)."""
    column, row = (np.floor((at - at.min(initial=0.0)) / cell).astype(np.int64) for at in (x, y))
    return np.asarray(row * (int(column.max(initial=0)) + 1) + column)


def _masked(heights: HeightMap, job: Job) -> HeightMap:
    """Return the map without the heights that do not count in the job's mask."""
    file = job.measurement.mask
    if file is None:
        return heights
    mask = read_measurement(job, file)
    if mask.z.shape != heights.z.shape:
        raise InputError(
            f"the mask {file.name} has the shape {mask.z.shape}, the map {heights.z.shape}: give a map of the same grid"
        )
    return replace(heights, z=np.where(_counted(mask.z, file.name), heights.z, np.nan))


def _counted(mask: Floats, name: str) -> Bools:
    """Return which heights a mask lets count: those that it has, or, where it is of 0 and 1, those with 1."""
    valid = ~np.isnan(mask)
    values = np.unique(mask[valid])
    if values.size == 2 and values[0] == 0 and values[1] > 0:  # 1 in the unit of the file
        return np.asarray(valid & (mask > 0))
    if valid.all():
        raise InputError(
            f"the mask {name} has all of its heights and is not of 0 and 1, so it masks nothing: leave out those "
            "that do not count, or give 1 where they count and 0 elsewhere"
        )
    return valid


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


def _with_reference(heights: HeightMap, job: Job) -> tuple[HeightMap, Pose | None]:
    """Return heights instead of departures, and where the map roughly lies on the part.

    The reference is fixed to the instrument: its axis is where the job says that the map lies, or at the origin of the
    map, or in its middle where the map does not reach the origin. A departure along the normal is turned into one along
    z by the slope of the reference; what that neglects is half its square times the curvature.
    """
    asked = job.measurement
    if asked.quantity == "height":
        return heights, asked.pose
    stated = asked.departure_from
    reference = stated if isinstance(stated, Surface) else job.part.surface
    x, y = heights.points()
    known = ~np.isnan(heights.z)
    pose = asked.pose
    if pose is None:
        spans = [(float(at[known].min()), float(at[known].max())) for at in (x, y)]
        beside = any(low > 0 or high < 0 for low, high in spans)
        pose = Pose(shift=(-sum(spans[0]) / 2, -sum(spans[1]) / 2, 0.0)) if beside else Pose()
    u, v, _ = pose.apply(x[known], y[known], 0.0)
    inside = reference.inside(u, v)
    on = np.ones(u.shape, dtype=np.bool_) if inside is None else inside
    departure = heights.z[known][on]
    if asked.quantity == "departure, along the normal":
        departure = departure * np.sqrt(1 + sum(slope**2 for slope in reference.gradient(u[on], v[on])))
    whole = np.full(u.shape, np.nan)
    whole[on] = departure + reference.sag(u[on], v[on])
    z = np.full(heights.z.shape, np.nan)
    z[known] = whole
    return replace(heights, z=z), pose


def _error_at(heights: HeightMap, part: Part, pose: Pose) -> HeightMap:
    """Return measured minus design at a pose on the map's own points, nan beyond the clear radius. [mm]."""
    valid = ~np.isnan(heights.z)
    x, y = heights.points()
    x, y, z = pose.apply(x[valid], y[valid], heights.z[valid])
    on = np.hypot(x, y) <= part.radius
    error = np.full(z.size, np.nan)
    error[on] = z[on] - part.surface.sag(x[on], y[on])
    whole = np.full(heights.z.shape, np.nan)
    whole[valid] = error
    return replace(heights, z=whole)


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
