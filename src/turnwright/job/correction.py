"""Correct a job by a diagnosis: the same pipeline, with the actual tool, the actual machine and a corrected surface."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from itertools import compress
from os import PathLike
from pathlib import Path as File
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from turnwright._arrays import Floats, robust_scatter
from turnwright._io import write_atomic
from turnwright.diagnosis import Diagnosis, DrawnCut, Draws, Proof, prove
from turnwright.errors import CorrectionError, InputError
from turnwright.files import write_map
from turnwright.generation import generate_points
from turnwright.heightmap import HeightMap
from turnwright.job.contributions import pv_nm_of, rms_nm_of
from turnwright.job.measurement import Measured, cutoff_of, errors_at_candidates, same_part, subtract_pose
from turnwright.job.pass_plan import Watch, across_feed, cut_heights, feed_of, motion_of
from turnwright.job.schema import Actual, Job
from turnwright.job.tables import HeightFile
from turnwright.job.text import edit_text
from turnwright.job.verdict import Verdict, judge_form
from turnwright.machine import Machine
from turnwright.metrology import Smooth, form_compensation, sum_tables
from turnwright.part import Part, evenly
from turnwright.path import Motion
from turnwright.progress import StageProgress
from turnwright.strategy import revolve
from turnwright.surface import Gridded
from turnwright.tool import Tool, WavinessTable

__all__ = ["Correction", "correct"]

MAX_PREDICTED_POINTS = 40_000
PLANNED_SOURCES = frozenset(
    {"offset x", "offset y", "offset z", "radius error", "waviness", "squareness", "straightness"}
)
"""Error sources that planning with the actual tool and machine corrects."""

MAX_SIMULATED_PLACES = 600
MIN_ERROR_RATIO = 3.0
"""Least form error, as a multiple of the error worth correcting, for which a correction can gain anything."""

LINEAR_TOL, LINEAR_TOL_NM = 0.1, 1.0
"""Most by which a full simulation of a draw may differ from the linear model: relative, or in nm if that is more."""

SIMULATION_TOL, SIMULATION_TOL_NM = 0.3, 3.0
"""Most by which the simulated effect of a correction may differ from the intended one: relative, or in nm."""

MAX_EFFECT_POINTS, RINGS, SECTORS = 2_000, 4, 12
"""Most points used to look for an earlier correction, and the patches within which other errors are correlated."""

REPEAT_SD, DIFFERENT_SIGMAS = 0.05, 3.0
"""Relative standard deviation with which an error repeats, and how many of these make two sizes differ."""

MIN_EFFECT_FRACTION = 0.05
"""Least fraction of the corrected error that is fitted separately."""

FINE_PLACES_PER_FEED = 24
"""Points across a feed where a small difference has to be separated from the cusps."""

OUTLIER_SIGMA = 6.0
"""Standard deviations from which a residual is an outlier and not form, as in the fit of a diagnosis."""

MAX_EXPLAINED_RATIO = 1.1
NAMED_SIGMAS = 2.0
"""A contribution is named if it exceeds this many standard uncertainties."""

NM = 1e6

MotionOf: TypeAlias = "Callable[[Job], Motion]"
"""Returns the motion of the finishing pass of a job, see `motion_of`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correction:
    """A corrected job, and the form error predicted for it.

    Parameters
    ----------
    job
        The job with the actual tool and machine as diagnosed, and with the surface corrected for the other errors that
        repeat.
    file
        The job file; the files that it names are in the same folder.
    cutoff
        Shortest wavelength of the form that is corrected, or ``None`` if only noise remains there. [mm]
    measured
        Measured form error (cut minus design) at some of the points; ``None`` if the part was not measured. [mm]
    predicted
        Form error after the correction, if all diagnosed errors repeat: the measured one, with its cusps and noise,
        plus the simulated effect of the correction, without a change of pose. [mm]
    simulated
        Simulated form error of the corrected job, without noise, if the diagnosed errors repeat. [mm]
    proof
        The effect of the correction in random draws of all that is uncertain.
    sources
        Names of the error sources corrected by tool and machine; none where only the form is compensated.
    sentences
        What is corrected, with what confidence, and the risk.
    """

    job: Job
    file: File
    cutoff: float | None
    measured: HeightMap | None
    predicted: HeightMap | None
    simulated: HeightMap
    proof: Proof
    sources: tuple[str, ...]
    sentences: tuple[str, ...]

    @property
    def numbers_nm(self) -> dict[str, tuple[float, float]]:
        """PV and rms of each map that exists. [nm]."""
        maps = {"measured": self.measured, "predicted": self.predicted, "simulated": self.simulated}
        return {name: (pv_nm_of(one.z), rms_nm_of(one)) for name, one in maps.items() if one is not None}

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Which stated tolerances the corrected part should meet, at the predicted points."""
        pv_nm, _ = self.numbers_nm["simulated" if self.predicted is None else "predicted"]
        return judge_form(self.job, pv_nm, reason="a correction predicts the form, run the job")


def correct(
    job: Job,
    diagnosis: Diagnosis,
    measured: Measured | Sequence[Measured] | None = None,
    *,
    out: str | PathLike[str],
    source: str | PathLike[str] | None = None,
    progress: StageProgress | None = None,
) -> Correction:
    """Write a job corrected by a diagnosis, and predict its form error.

    The job is planned with the actual tool and machine, as far as the diagnosis is certain. The other errors that
    repeat are subtracted from the target surface, smoothed, where the part was measured; the part is still judged by
    the design. Distortion by the mount, while the part is measured or held, is not corrected.

    Before anything is written, the correction is tested on random draws of all that is uncertain: 95 % must improve by
    more than ``measurement.min_effect`` and none may lose more than that; five of them are simulated in full. If that
    fails, a correction of the form alone is tried.

    Parameters
    ----------
    job
        The job to correct: that of the measured part, or of another part cut with the same tool on the same machine.
    diagnosis
        The diagnosis of the measured parts, see `diagnose`.
    measured
        The diagnosed parts, if the first of them was cut by this job; the same part as cut by earlier jobs may follow.
        Without it only tool and machine are corrected.
    out
        Folder for ``job.toml`` and the files that it names; created if missing.
    source
        The file that the job was read from: its text is preserved except for the changes. Without it the whole file is
        generated.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InputError
        If the job was planned with another tool or machine than the measured parts, or was already corrected by one of
        the maps.
    CorrectionError
        If no correction is certain to help, or a map does not match its part; nothing is written then.
    """
    watch, stated = Watch(progress), job
    job = stated.alone() if measured else stated
    _check(job, diagnosis)
    every = [measured] if isinstance(measured, Measured) else list(measured or ())
    for one in every:
        if one.mismatch:
            raise CorrectionError(f"nothing is corrected: {one.mismatch}")
    is_same_part = [same_part(one.job, job) for one in every]
    _check_new(job, every, is_same_part)
    _check_sane(diagnosis)
    cached_motion = cache(motion_of)
    with watch.stage("verify the correction") as update:
        plan = _choose_plan(job, diagnosis, is_same_part)
        update(1, 2)
        if any(is_same_part):
            _check_linear(every[plan.map].job, plan.draws, cached_motion)
    text, source_folder = ("", File()) if source is None else (File(source).read_bytes().decode(), File(source).parent)
    out = File(out).resolve()  # the job names its files relative to its own folder
    planned = [one for one in diagnosis if one.error_source in PLANNED_SOURCES] if plan.sources else []
    names = tuple(one.name for one in planned if one.verdict == "correct" or (plan.likely and one.value))
    file = out / "job.toml"
    with watch.stage("simulate") as update:
        before, predicted, simulated = _simulate(
            job, diagnosis, plan, every if any(is_same_part) else (), cached_motion
        )
        update(1, 2)
        out.mkdir(parents=True, exist_ok=True)
        entries = [(one, _entry(one, names, plan)) for one in every]
        better = _write_corrected(job, diagnosis, plan, entries, out)
        if job is not stated:  # the correction is that of one part of a chuck
            better = stated.with_alone(better)
        write_atomic(file, edit_text(text, stated, better, folder=source_folder, into=out))
    return Correction(
        job=better, file=file, cutoff=plan.cutoff, measured=before, predicted=predicted, simulated=simulated,
        proof=plan.proof, sources=names,
        sentences=_sentences(diagnosis, plan, names, list(compress(every, is_same_part))),
    )  # fmt: skip


class _Plan(NamedTuple):
    likely: bool  # whether all error sources enter with their most probable values, not only the certain ones
    sources: bool  # whether the job is planned with the diagnosed tool and machine
    smooth: Smooth | None
    map: int  # number of the map whose draws test it
    draws: Draws
    proof: Proof
    azimuthal_nm: float = 0.0  # rms of the form that varies with the azimuth, where spindle mode cannot follow it

    @property
    def cutoff(self) -> float | None:
        """Shortest wavelength of the form that is corrected, ``None`` if none is. [mm]."""
        return None if self.smooth is None else self.smooth.cutoff


def _simulate(
    job: Job, diagnosis: Diagnosis, plan: _Plan, every: Sequence[Measured], motion_of: MotionOf
) -> tuple[HeightMap | None, HeightMap | None, HeightMap]:
    """Return measured, predicted and simulated form error, see `Correction`; raise where simulation contradicts it.

    ``every`` has the measured parts, if the part of this job is among them.
    """
    with TemporaryDirectory(prefix="turnwright-") as folder:
        real = _write_corrected(job, diagnosis, plan._replace(likely=True, sources=True, smooth=None), (), File(folder))
        better = _write_corrected(job, diagnosis, plan, (), File(folder))
        new = motion_of(better)
        if not every:
            x, y = evenly(job.part, MAX_PREDICTED_POINTS)
            off = cut_heights(new, real, x, y) - job.part.surface.sag(x, y)
            simulated = HeightMap(x=x, y=y, z=subtract_pose(job, x, y, off), name="simulated error")
            return None, None, simulated
        _check_simulated(job, better, plan, motion_of)
    old, error, field = motion_of(job), every[plan.map].error, diagnosis.fields[plan.map]

    def change(x: Floats, y: Floats) -> Floats:
        return cut_heights(new, real, x, y) - cut_heights(old, real, x, y)

    step = -(-error.z.size // MAX_PREDICTED_POINTS)
    x, y = (one[::step] for one in error.points())
    before = HeightMap(x=x, y=y, z=error.z[::step], name="measured error")
    predicted = replace(before, z=subtract_pose(job, x, y, before.z + change(x, y)), name="predicted error")
    x, y = field.points()
    # The field already holds the correction of the job.
    planned = cut_heights(old, job, x, y) - job.part.aimed.surface.sag(x, y)
    off = planned + field.z + change(x, y)
    _check_claim(job, plan, off=(x, y, off), planned=planned)
    _check_candidates(every[plan.map], job, change)
    simulated = HeightMap(x=x, y=y, z=subtract_pose(job, x, y, off), name="simulated error")
    return before, predicted, simulated


def _check(job: Job, diagnosis: Diagnosis) -> None:
    """Raise unless the job uses the tool and the machine that were diagnosed, apart from their deviations."""
    tool, machine = job.tool, job.machine
    if (tool.nose_radius, tool.included, tool.rake) != (
        diagnosis.tool.nose_radius,
        diagnosis.tool.included,
        diagnosis.tool.rake,
    ):
        raise InputError(
            f"the job cuts with a nose radius {tool.nose_radius:g} mm, the measured parts were cut with "
            f"{diagnosis.tool.nose_radius:g} mm or another edge: correct a job of the tool that was measured"
        )
    if machine.name != diagnosis.machine.name:
        raise InputError(
            f"the job is for the machine {machine.name!r}, the measured parts were cut on {diagnosis.machine.name!r}: "
            "correct a job of the machine that was measured"
        )


def _write_corrected(
    job: Job, diagnosis: Diagnosis, plan: _Plan, ledger: Sequence[tuple[Measured, str]], out: File
) -> Job:
    """Return the corrected job, and write the files that it names."""
    earlier_entries = [
        line for line in job.measurement.corrected if not any(one.fingerprint in line for one, _ in ledger)
    ]
    corrected = (*earlier_entries, *(line for _, line in ledger)) if ledger else job.measurement.corrected
    # The stated deviations were those of the last part; the correction contains them.
    better = replace(job, measurement=replace(job.measurement, corrected=corrected, cut_by=None), actual=Actual())
    if plan.sources:
        tool, machine = (
            (diagnosis.likely_tool, diagnosis.likely_machine) if plan.likely else (diagnosis.tool, diagnosis.machine)
        )
        tool, machine = _write_tool(tool, job.tool, out), _write_machine(machine, job.machine, out)
        better = replace(better, tool=tool, machine=machine)
    if plan.smooth is not None and plan.cutoff is not None:
        file, new = out / "correction.npz", plan.smooth.table
        write_map(HeightMap(x=new.x, y=new.y, z=new.z, name="correction"), file)
        correction = replace(new, source=HeightFile(file=file))
        better = replace(better, part=replace(better.part, correction=correction))
    return better


def _check_new(job: Job, every: Sequence[Measured], is_same_part: Sequence[bool]) -> None:
    for one, part in zip(every, is_same_part, strict=True):
        noted = (one.job if part else job).measurement.corrected
        if any(one.fingerprint in line for line in noted):
            raise InputError(
                f"the map {one.heights.name!r} was used in an earlier correction of this job: measure a part cut by "
                "this job, or give the map with the job that cut it"
            )
        if part and noted and one.job.measurement.cut_by is None:
            _check_effect(one)


def _check_effect(one: Measured) -> None:
    """Raise if a part still shows the full error that its job corrects, so that it was cut before the correction.

    The corrections of tool and machine and that of the form are fitted separately: a tool that has moved again shows
    the former with another size, or without the latter.
    """
    job = one.job
    nominal_machine = job.machine.loaded.value if job.machine.loaded else job.machine
    plain = replace(
        job,
        tool=replace(job.tool, offset=(0.0, 0.0, 0.0), radius_error=0.0, waviness=()),
        machine=replace(job.machine, squareness=nominal_machine.squareness, straightness=nominal_machine.straightness),
        part=replace(job.part, correction=None),
    )
    x, y = one.error.points()
    some = slice(None, None, -(-x.size // MAX_EFFECT_POINTS))
    x, y, error = x[some], y[some], one.error.z[some]
    motion = motion_of(plain)
    by_tool, by_form = cut_heights(motion, job, x, y) - cut_heights(motion, plain, x, y), -_addition_at(job, x, y)
    valid = np.isfinite(by_tool + by_form + error)
    x, y = x[valid], y[valid]
    seen, *effects = (subtract_pose(job, x, y, each[valid]) for each in (error, by_tool, by_form))
    corrected = effects[0] + effects[1]
    seen_nm, was_nm = (float(np.sqrt(np.mean(each**2))) * NM for each in (seen, corrected))
    if was_nm <= job.measurement.min_effect * NM:
        return
    columns = np.stack(
        [each for each in effects if np.sqrt(np.mean(each**2)) * NM > MIN_EFFECT_FRACTION * was_nm], axis=1
    )
    shares, covariance = _fit_fractions(columns, seen, _patches(x, y))
    full_effect_sd, no_effect_sd = (_count_sigmas(shares - value, covariance) for value in (1.0, 0.0))
    if full_effect_sd < DIFFERENT_SIGMAS < no_effect_sd:
        share = float(seen @ corrected) / float(corrected @ corrected)
        raise InputError(
            f"the map {one.heights.name!r} has a form error of {seen_nm:.3g} nm rms and contains {share:.0%} of the "
            f"{was_nm:.3g} nm rms that its job corrects, as if it was cut before the correction: give the job that cut "
            'it; if this job did and the same error came back, write cut_by = "this job" in [measurement]'
        )


def _patches(x: Floats, y: Floats) -> NDArray[np.intp]:
    """Return the number of the patch of each point: rings and sectors of equal area. (n,)."""
    square = x * x + y * y
    ring = np.minimum((RINGS * square / square.max()).astype(np.intp), RINGS - 1)
    sector = np.minimum(((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp), SECTORS - 1)
    return np.asarray(ring * SECTORS + sector)


def _fit_fractions(columns: Floats, seen: Floats, patches: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return the fitted fraction of each column, and its covariance if the residual is correlated within patches."""
    inverse = np.linalg.pinv(columns)
    shares = inverse @ seen
    residual = seen - columns @ shares
    pulls = np.stack([np.bincount(patches, weights=row * residual) for row in inverse])
    return shares, np.asarray(pulls @ pulls.T, dtype=np.float64)


def _count_sigmas(off: Floats, covariance: Floats) -> float:
    """Return by how many standard deviations fractions are off, with the repeatability of a cut."""
    both = covariance + REPEAT_SD**2 * np.eye(off.size)
    return float(np.sqrt(off @ np.linalg.solve(both, off)))


def _check_sane(diagnosis: Diagnosis) -> None:
    for one in diagnosis:
        if one.determined and one.implausible:
            raise CorrectionError(f"nothing is corrected: {one.explanation}")
    if diagnosis.explained_rms_nm > MAX_EXPLAINED_RATIO * diagnosis.measured_rms_nm + 1.0:
        raise CorrectionError(
            f"nothing is corrected: the diagnosis attributes {diagnosis.explained_rms_nm:.3g} nm rms of a "
            f"measured {diagnosis.measured_rms_nm:.3g} nm, the limit is {MAX_EXPLAINED_RATIO:g} times the measured "
            "error: measure a test part, which separates the error sources"
        )


def _choose_plan(job: Job, diagnosis: Diagnosis, is_same_part: Sequence[bool]) -> _Plan:
    plans = list(_plans(job, diagnosis, is_same_part))
    for plan in plans:
        if plan.proof.ok:
            return plan
    raise CorrectionError(_refusal(diagnosis, plans[0], sum(is_same_part)))


def _plans(job: Job, diagnosis: Diagnosis, is_same_part: Sequence[bool]) -> Iterator[_Plan]:
    """Yield the corrections that may be written, the best first."""
    min_effect_nm = job.measurement.min_effect * NM
    worth = any(one.verdict == "correct" and one.error_source in PLANNED_SOURCES for one in diagnosis)
    if not any(is_same_part):
        draws = diagnosis.effects_on(job.part.design)
        proof = prove(draws, np.zeros(draws.x.size), min_effect_nm=min_effect_nm)
        yield _Plan(likely=True, sources=True, smooth=None, map=0, draws=draws, proof=proof)
        return
    first = list(is_same_part).index(True)
    draws = diagnosis.draws(first)
    residuals = [_remove_outliers(one, cutoff_of(job)) for one in compress(diagnosis.residuals, is_same_part)]
    beyond = _draw_unattributed(job, residuals, draws)
    # The residual of the diagnosis is smoothed to separate it from noise.
    residual_form = _smooth_addition(job, _join_maps(job, residuals)) if job.measurement.repeats else None
    for sources, maps in ((True, diagnosis.remainders), (False, diagnosis.fields)):
        if not sources and not worth:
            return
        form = _smooth_addition(job, _join_maps(job, list(compress(maps, is_same_part))))
        smooth = _sum_additions(
            [one for one in (form, residual_form) if one is not None and one.cutoff is not None], job.part.correction
        )
        added, azimuthal_nm = np.zeros(draws.x.size), 0.0
        if smooth is not None and job.servo(job.passes[-1]).spindle_mode is not None:
            smooth, azimuthal_nm = _keep_symmetric_part(job.part, smooth)
        if smooth is not None:
            x, y = draws.places[:, 0], draws.places[:, 1]  # the addition is fixed to the part, at any pose of the map
            added = smooth.table.evaluate(x, y, 0)[0] - _addition_at(job, x, y)
        proof = prove(draws, added, sources=sources, beyond=beyond, min_effect_nm=min_effect_nm)
        yield _Plan(
            likely=False, sources=sources, smooth=smooth, map=first, draws=draws, proof=proof, azimuthal_nm=azimuthal_nm
        )  # fmt: skip


def _keep_symmetric_part(part: Part, smooth: Smooth) -> tuple[Smooth, float]:
    """Return an addition that a cut in spindle mode can follow, its mean over the azimuth, and the rms of the rest.

    Beyond the largest circle within the table, the mean is that of the rim of the circle.
    """
    table = smooth.table
    reach = float(min(-table.x[0], table.x[-1], -table.y[0], table.y[-1]))
    mean = revolve(table, reach)
    x, y = np.meshgrid(table.x, table.y)
    radius = np.minimum(np.hypot(x, y), reach)
    symmetric = Gridded(x=table.x, y=table.y, z=mean.evaluate(radius, np.zeros(radius.shape), 0)[0])
    x, y = evenly(part, MAX_PREDICTED_POINTS)
    residual = table.evaluate(x, y, 0)[0] - symmetric.evaluate(x, y, 0)[0]
    return smooth._replace(table=symmetric), float(np.sqrt(np.mean(residual**2))) * NM


def _remove_outliers(residual: HeightMap, cutoff: float) -> HeightMap:
    """Return residuals without outliers, such as dust, and their surroundings. Scattered.

    An outlier is no form error that repeats; corrected as one, it would be cut into the next part.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - scipy is costly to import

    x, y = (one.ravel() for one in residual.points())
    z = residual.z.ravel()
    valid = np.isfinite(z)
    x, y, z = x[valid], y[valid], z[valid]
    off = np.abs(z - np.median(z))
    out = off > OUTLIER_SIGMA * robust_scatter(off)
    if out.any():
        near = cKDTree(np.stack([x[out], y[out]], axis=1)).query(np.stack([x, y], axis=1))[0] <= cutoff / 2
        x, y, z = x[~near], y[~near], z[~near]
    return HeightMap(x=x, y=y, z=z, name=residual.name)


def _sum_additions(parts: Sequence[Smooth], before: Gridded | None) -> Smooth | None:
    if not parts:
        return None
    tables = [one.table for one in parts] + ([] if before is None else [before])
    table = reduce(sum_tables, tables)
    return Smooth(table, min(one.cutoff for one in parts if one.cutoff is not None))


def _draw_unattributed(job: Job, residuals: Sequence[HeightMap], draws: Draws) -> Floats:
    """Return draws of the form error of the next part that the diagnosis does not attribute. (draws, n) [mm].

    The mean residual of several maps repeats; the next part scatters about it as the maps do.
    """
    smooth = [
        -one.table.evaluate(draws.x, draws.y, 0)[0]
        for one in (_smooth_addition(job, _join_maps(job, [one])) for one in residuals)
    ]
    count, random = len(smooth), np.random.default_rng(2)
    mean: Floats = np.mean(smooth, axis=0)
    if count == 1:
        sign = np.ones(draws.before.shape[0])
        if not job.measurement.repeats:
            sign = random.normal(size=sign.size)
        return np.asarray(sign[:, None] * mean)
    off = np.stack(smooth) - mean
    weight = random.normal(size=(draws.before.shape[0], count)) * math.sqrt((1 + 1 / count) / (count - 1))
    return np.asarray(mean + weight @ off)


def _refusal(diagnosis: Diagnosis, plan: _Plan, parts: int) -> str:
    proof = plan.proof
    if proof.before_nm < MIN_ERROR_RATIO * proof.min_effect_nm:
        return (
            f"no correction is written: the next part has a form error of {proof.before_nm:.2g} nm rms without cusps "
            f"and noise, too small for a certain gain of {proof.min_effect_nm:g} nm: keep this job, or lower "
            "measurement.min_effect"
        )
    gain = proof.gain_nm
    usual = (
        f"95 % improve by {gain:.2g} nm rms or more" if gain > 0 else f"5 % become worse by {-gain:.2g} nm rms or more"
    )
    worst = f"worse by {proof.worst_nm:.2g} nm" if proof.worst_nm > 0 else f"better by {-proof.worst_nm:.2g} nm"
    why = (
        f"no correction is written: of {proof.draws} simulated next parts, {proof.before_nm:.3g} nm rms before, "
        f"{usual}, and the worst becomes {worst}; 95 % must improve by {proof.min_effect_nm:g} nm, none may become "
        "worse by as much"
    )
    if plan.draws.unmeasured:
        return f"{why}. {plan.draws.unmeasured:.0%} of the part lies beyond the map: measure all of it"
    scatter = diagnosis.repeatability_nm
    if scatter is not None and scatter > 1:
        shared = math.sqrt(max(diagnosis.explained_rms_nm**2 - scatter**2, 0.0))
        more = math.ceil(4 * (scatter / shared) ** 2) - parts if shared > scatter / 4 else 0
        remedy = f"measure {more} more" if more > 0 else "find what differs between the cuts"
        return f"{why}. The maps differ by {scatter:.3g} nm rms: {remedy}"
    hidden = next((one for one in diagnosis if one.verdict != "correct" and one.rms_nm > 1), None)
    return f"{why}. {hidden.explanation if hidden else 'Measure more points, or more parts'}"


def _check_linear(job: Job, draws: Draws, motion_of: MotionOf) -> None:
    """Raise if the full simulation of some draws differs too much from the linear model."""
    some, places = _cuspless(job, draws)
    motion = replace(motion_of(job), velocity=None)
    tool, machine = job.tool, job.machine
    clean = _means(motion, tool, machine, places)
    for case in draws.cases:
        made = _means(_move_tip(motion, case), case.tool, case.machine, places) - clean + case.rest[some]
        linear = np.where(np.isfinite(made), draws.before[case.number][some], np.nan)
        off, size = (_rms_of_draws(draws, some, one) for one in (made - linear, linear))
        if off > max(LINEAR_TOL * size, LINEAR_TOL_NM):
            raise CorrectionError(
                f"nothing is corrected: a random set of errors causes {size:.3g} nm rms in the linear model, which "
                f"differs by {off:.3g} nm in full simulation, the limit is {LINEAR_TOL:.0%}: correct the largest error "
                "at the machine first, then measure again"
            )


def _rms_of_draws(draws: Draws, some: NDArray[np.intp], error: Floats) -> float:
    """Return the rms of an error at some points of the draws, without a change of pose. [nm]."""
    valid = np.isfinite(error)
    return float(replace(draws, pose=draws.pose[some][valid]).rms_nm(error[None, valid])[0])


def _rms_beyond_pose_nm(job: Job, x: Floats, y: Floats, error: Floats) -> float:
    return float(np.sqrt(np.nanmean(subtract_pose(job, x, y, error) ** 2))) * NM


def _check_simulated(job: Job, better: Job, plan: _Plan, motion_of: MotionOf) -> None:
    """Raise if the corrected job does not change the part as intended."""
    draws = plan.draws
    some, places = _cuspless(job, draws)
    after, before = (_means(motion_of(one), one.tool, one.machine, places) for one in (better, job))
    now, then = (_addition_at(one, draws.x[some], draws.y[some]) for one in (better, job))
    intended = np.where(np.isfinite(after - before), now - then, np.nan)
    off, size = (_rms_of_draws(draws, some, one) for one in (after - before - intended, intended))
    if off > max(SIMULATION_TOL * size, SIMULATION_TOL_NM):
        remedy = "check the job with turnwright check"
        if plan.cutoff:
            remedy = f"raise measurement.cutoff above {plan.cutoff:g} mm"
        raise CorrectionError(
            f"nothing is corrected: the corrected job should change the part by {size:.3g} nm rms, its simulation "
            f"differs from that by {off:.3g} nm, the limit is {SIMULATION_TOL:.0%} and {SIMULATION_TOL_NM:g} nm: "
            f"{remedy}"
        )


def _check_claim(job: Job, plan: _Plan, *, off: tuple[Floats, Floats, Floats], planned: Floats) -> None:
    """Raise if the simulated form error of the corrected part exceeds that of the draws and its cusps."""
    x, y, z = off
    simulated, cusps = (_rms_beyond_pose_nm(job, x, y, one) for one in (z, planned))
    claimed = math.hypot(plan.proof.after_nm, cusps)
    if simulated > claimed + max(SIMULATION_TOL * claimed, SIMULATION_TOL_NM):
        raise CorrectionError(
            f"nothing is corrected: {claimed:.3g} nm rms with the cusps are predicted, the simulation of the "
            f"corrected job gives {simulated:.3g} nm, the limit is {SIMULATION_TOL:.0%} and {SIMULATION_TOL_NM:g} nm "
            "more: mask what is not the part in the map, or measure a second part"
        )


def _check_candidates(one: Measured, job: Job, change: Callable[[Floats, Floats], Floats]) -> None:
    """Raise if the correction would make the part worse at another pose that fits the map as well."""
    min_effect_nm = job.measurement.min_effect * NM
    for pose, error in errors_at_candidates(one):
        x, y = error.points()
        step = -(-error.z.size // MAX_PREDICTED_POINTS)
        x, y, z = x[::step], y[::step], error.z[::step]
        before, after = (_rms_beyond_pose_nm(job, x, y, each) for each in (z, z + change(x, y)))
        if after > before + min_effect_nm:
            shift = ", ".join(f"{value:.4g}" for value in pose.shift)
            raise CorrectionError(
                f"nothing is corrected: the map fits nearly as well with shift ({shift}) mm and rotation "
                f"{np.rad2deg(pose.rotation):.4g} deg, and there {before:.3g} nm rms would become "
                f"{after:.3g} nm: measure the edge of the part or a fiducial, and state shift, rotation and a smaller "
                "reach and clocking in [measurement]"
            )


def _addition_at(job: Job, x: Floats, y: Floats) -> Floats:
    """Return the correction that a job adds to its design, in the shape of the points. [mm]."""
    return np.zeros_like(x) if job.part.correction is None else job.part.correction.evaluate(x, y, 0)[0]


def _move_tip(motion: Motion, case: DrawnCut) -> Motion:
    along_x, along_z = case.tip_motion(*(motion.axes[letter] for letter in "XCZ"))
    return replace(motion, axes={**motion.axes, "X": motion.axes["X"] + along_x, "Z": motion.axes["Z"] + along_z})


def _cuspless(job: Job, draws: Draws) -> tuple[NDArray[np.intp], tuple[Floats, Floats]]:
    """Return which points of the draws are simulated, and the points across a feed around each.

    (n,), 2 of (n, FINE_PLACES_PER_FEED) [mm]. Closer to the rim than a drawn tool centring error, the first revolution
    may not reach the part.
    """
    planned = job.tool.offset
    off = max((math.dist(case.tool.offset[:2], planned[:2]) for case in draws.cases), default=0.0)
    cut = np.flatnonzero(np.hypot(draws.x, draws.y) < job.part.reach - off - feed_of(job))
    some = cut[:: -(-draws.x.size // MAX_SIMULATED_PLACES)]
    return some, across_feed(job, draws.x[some], draws.y[some], FINE_PLACES_PER_FEED)


def _means(motion: Motion, tool: Tool, machine: Machine, places: tuple[Floats, Floats]) -> Floats:
    x, y = (one.ravel() for one in places)
    return np.asarray(generate_points(motion, tool, x=x, y=y, machine=machine).reshape(places[0].shape).mean(axis=1))


def _entry(one: Measured, names: Sequence[str], plan: _Plan) -> str:
    what = [*names, *(["form"] if plan.cutoff else [])]
    return f"{one.heights.name[:MAX_NAME_LENGTH] or 'map'} ({one.fingerprint}): {', '.join(what)}"


MAX_NAME_LENGTH = 60


def _sentences(
    diagnosis: Diagnosis, plan: _Plan, names: Sequence[str], parts: Sequence[Measured]
) -> tuple[str, ...]:  # fmt: skip
    """Return what is corrected, with what confidence, and the risk."""
    proof, sentences = plan.proof, []
    form = plan.cutoff is not None
    sentences.append(
        f"corrected: {', '.join(names) or 'no source'} by tool and machine"
        + (", all other errors that repeat by the target surface" if form else "")
    )
    sentences.append(
        f"of {proof.draws} next parts simulated with random errors, 95 % improve by {proof.gain_nm:.3g} nm rms or more "
        f"and none becomes worse by more than {max(proof.worst_nm, 0.0):.2g} nm: {proof.before_nm:.3g} nm rms before, "
        f"{proof.after_nm:.3g} nm after"
    )
    stays = [
        one
        for one in diagnosis.contributions
        if one.rms_nm > max(proof.min_effect_nm, NAMED_SIGMAS * one.uncertainty_nm)
    ]
    if plan.likely and stays:
        shown = ", ".join(f"{one.name} ({one.rms_nm:.3g} nm rms on the measured parts)" for one in stays)
        sentences.append(f"not corrected on this part: {shown}; cut it, measure it and correct it by its own map")
    if plan.azimuthal_nm:
        sentences.append(
            f"in spindle mode only the part of the form that is symmetric about the axis is corrected: "
            f"{plan.azimuthal_nm:.3g} nm rms vary with the azimuth and stay, a slow tool servo can correct them"
        )
    if form and plan.draws.unmeasured:
        sentences.append(
            f"the map does not cover {plan.draws.unmeasured:.0%} of the part: its form is not corrected there, and the "
            "predicted and simulated errors do not include it"
        )
    if any("rotation" in one.registration.held for one in parts):
        sentences.append(
            "the surface does not show the clocking of the part: the correction uses the orientation of the map, to a "
            "few degrees, and is misplaced on the next part if that is measured or mounted at another angle"
        )
    if diagnosis.repeatability_nm is not None:
        sentences.append(
            f"the maps differ by {diagnosis.repeatability_nm:.3g} nm rms; only their common error is corrected"
        )
    elif proof.at_stake_nm > 1:
        sentences.append(
            f"one map cannot show which errors repeat: if the corrected {proof.at_stake_nm:.3g} nm rms do not, the "
            f"next part has a form error of up to {proof.if_not_repeated_nm:.3g} nm, at most "
            f"{proof.at_stake_nm:.3g} nm more than without the correction; a second measured part decides"
        )
    return tuple(sentences)


def _join_maps(job: Job, maps: Sequence[HeightMap]) -> HeightMap:
    """Return all heights of several maps without a change of pose. Scattered."""
    points = [tuple(one.ravel() for one in (*heights.points(), heights.z)) for heights in maps]
    x, y, z = (np.concatenate(one) for one in zip(*points, strict=True))
    valid = ~np.isnan(z)
    x, y = x[valid], y[valid]
    return HeightMap(x=x, y=y, z=subtract_pose(job, x, y, z[valid]), name="residual")


def _smooth_addition(job: Job, residual: HeightMap) -> Smooth:
    strategy, last = job.strategy, job.passes[-1]

    def stated(name: str) -> float:
        return getattr(last, name, None) or getattr(strategy, name, None) or 0.0

    tool = job.tool
    half = np.pi / 2 if tool.included is None else tool.included / 2
    beyond = stated("lead_in") + stated("overrun") + tool.actual_radius * float(np.sin(half))
    return form_compensation(job.part, residual, cutoff=cutoff_of(job), beyond=beyond)


def _write_tool(tool: Tool, planned: Tool, out: File) -> Tool:
    """Return the planned tool with the diagnosed errors, and write its waviness file."""
    actual_tool = replace(planned, radius_error=tool.radius_error, offset=tool.offset)
    if not isinstance(tool.waviness, WavinessTable) or tool.waviness is planned.waviness:
        return actual_tool
    columns = _write_columns(
        out / "waviness.csv", "sweep [rad],deviation [mm]", tool.waviness.sweep, tool.waviness.deviation
    )
    return replace(actual_tool, waviness=replace(tool.waviness, file=str(columns)))


def _write_machine(machine: Machine, planned: Machine, out: File) -> Machine:
    """Return the planned machine with the diagnosed errors, and write its straightness file."""
    actual_machine = replace(planned, squareness=machine.squareness)
    if machine.straightness is None or machine.straightness is planned.straightness:
        return actual_machine
    file = _write_columns(out / "straightness.csv", "x [mm],error [mm]", *machine.straightness)
    return replace(
        actual_machine, straightness=machine.straightness, sources={**planned.sources, "straightness": str(file)}
    )


def _write_columns(file: File, head: str, one: Floats, other: Floats) -> File:
    rows = (f"{a!r},{b!r}" for a, b in zip(one.tolist(), other.tolist(), strict=True))
    write_atomic(file, "\n".join([head, *rows]) + "\n")
    return file
