"""From what is wrong to a job that comes out right: the same pipeline with better inputs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path as File
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turnwright._arrays import robust_scatter
from turnwright._io import write_whole
from turnwright.diagnosis import Proof, prove
from turnwright.errors import CorrectionError, InputError
from turnwright.files import write_map
from turnwright.generation import generate_points
from turnwright.heightmap import HeightMap
from turnwright.job.contributions import pv_nm_of, rms_nm_of
from turnwright.job.measurement import Measured, beyond_pose, cutoff_of, errors_at_candidates, same_part
from turnwright.job.named import HeightFile
from turnwright.job.predicted_finish import across_feed, cut_by, feed_of, motion_of
from turnwright.job.schema import Actual, Job
from turnwright.job.text import edited
from turnwright.job.verdict import Verdict, judge_form
from turnwright.metrology import Smooth, form_compensation, sum_tables
from turnwright.part import evenly
from turnwright.tool import WavinessTable

if TYPE_CHECKING:
    from os import PathLike

    from turnwright._arrays import Floats
    from turnwright.diagnosis import Diagnosis, DrawnCut, Draws
    from turnwright.machine import Machine
    from turnwright.path import Motion
    from turnwright.progress import StageProgress
    from turnwright.surface import Gridded
    from turnwright.tool import Tool

__all__ = ["Correction", "correct"]

SHOWN = 40_000
"""Points at which the corrected part is predicted."""

PLANNED = frozenset({"offset x", "offset y", "offset z", "radius error", "waviness", "squareness", "straightness"})
"""Causes that planning with the real tool and machine takes care of."""

PLACES = 600
"""Places at which draws are simulated in full."""

SMALL = 3.0
"""What is off by less than this many times what is worth correcting is good."""

LINEAR, LINEAR_NM = 0.1, 1.0
"""A draw that is simulated in full may differ from the linear model by this share of it, or by this."""

SIMULATED, SIMULATED_NM = 0.3, 3.0
"""What a correction changes by simulation may differ from what is intended by this share of it, or by this."""

EFFECT, RINGS, SECTORS = 2_000, 4, 12
"""Places at which a part is looked at for what was corrected, and patches in which what else it has hangs together."""

REPEATED, TOLD = 0.05, 3.0
"""Standard deviation by which an error comes back in another size, and how many of these tell two sizes apart."""

NOTHING = 0.05
"""Share of what was corrected that is too little to be looked at apart."""

FINE = 24
"""Places across a feed where little is left to see of a difference but cusps."""

OUTLIER_SIGMA = 6.0
"""Standard deviations from which a residual is an outlier and not form, as in the fit of a diagnosis."""

EXPLAINED = 1.1
"""What is explained may be larger than what was measured by this factor."""

SURE = 2.0
"""A contribution is named if it is larger than this many standard uncertainties."""

NM = 1e6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correction:
    """A better job, and what it should leave.

    Parameters
    ----------
    job
        With the tool and the machine as they were found, aiming at the part without what repeats besides.
    file
        Where it is written; the files that it names stand beside it.
    cutoff
        Wavelength from which the part itself is corrected, or ``None`` if nothing but noise is left there. [mm]
    measured
        Cut minus design as it was measured, at some points; ``None`` if the part itself was not. [mm]
    predicted
        The same after the correction, if all that was found repeats: what was measured, its cusps and noise among it,
        and what the correction changes by simulation, beyond a change of pose. [mm]
    simulated
        Cut minus design of the corrected job by simulation, without noise, if what was found repeats. [mm]
    proof
        What the correction does in draws of all that is not certain.
    sources
        The findings that are planned with, by name; none where only the form is compensated.
    sentences
        What is corrected, how surely, and what is at stake.
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
        """Peak to valley and root mean square of each map that there is. [nm]."""
        maps = {"measured": self.measured, "predicted": self.predicted, "simulated": self.simulated}
        return {name: (pv_nm_of(one.z), rms_nm_of(one)) for name, one in maps.items() if one is not None}

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Which stated tolerances the corrected part should keep, at the places that it is predicted at."""
        pv_nm, _ = self.numbers_nm["simulated" if self.predicted is None else "predicted"]
        return judge_form(self.job, pv_nm, sq_reason="a correction predicts the form, run the job")


def correct(
    job: Job,
    found: Diagnosis,
    measured: Measured | Sequence[Measured] | None = None,
    *,
    out: str | PathLike[str],
    source: str | PathLike[str] | None = None,
    progress: StageProgress | None = None,
) -> Correction:
    """Write the job that takes what was found into account, and predict what it leaves.

    Tool and machine become what they were found to be, as far as that is certain. What else repeats is taken off the
    surface that is aimed at, smoothly and where it was measured; the design stays what everything is judged by. What a
    mount does to the part while it is measured or held is not corrected.

    Before anything is written the correction is proved on draws of all that is not certain: 95 of 100 must become
    better by more than ``measurement.worth`` and none worse by more, five of them are simulated in full. If that fails,
    a correction of the form alone is tried.

    Parameters
    ----------
    job
        To be corrected: that of the measured part, or of another that is cut with this tool on this machine.
    found
        Why measured parts were off, see `diagnose`.
    measured
        What was diagnosed, if the part that the job has cut was among it and was the first; the part as earlier jobs
        have cut it counts with it. Without it only tool and machine are corrected.
    out
        Folder for ``job.toml`` and the files that it names; it is made if there is none.
    source
        The file that the job was read from: its text is kept but for what changes. Without it all is written anew.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InputError
        If the job was not planned with the tool and machine of the measured parts, or was corrected by a map already.
    CorrectionError
        If no correction is certain to help, or a map does not look like its part; nothing is written then.
    """
    report = progress or (lambda _stage, _done, _total: None)
    _check(job, found)
    every = [measured] if isinstance(measured, Measured) else list(measured or ())
    for one in every:
        if one.misplaced:
            raise CorrectionError(f"nothing is corrected: {one.misplaced}")
    own = [same_part(one.job, job) for one in every]
    _check_new(job, every, own)
    _check_sane(found)
    report("prove the correction", 0, 2)
    plan = _proved(job, found, own)
    report("prove the correction", 1, 2)
    motions = _Motions()
    if any(own):
        _check_linear(every[plan.map].job, plan.draws, motions)
    report("prove the correction", 2, 2)
    text, beside = ("", File()) if source is None else (File(source).read_bytes().decode(), File(source).parent)
    out = File(out).resolve()  # the job names its files beside itself, wherever it is read from
    names = tuple(
        one.name for one in found if one.cause in PLANNED and (one.verdict == "correct" or (plan.likely and one.value))
    )
    names = names if plan.sources else ()
    report("simulate", 0, 2)
    maps = _simulated(job, found, plan, every if any(own) else (), motions)
    report("simulate", 1, 2)
    out.mkdir(parents=True, exist_ok=True)
    better = _better(job, found, plan, [(one, _entry(one, names, plan)) for one in every], out)
    file = out / "job.toml"
    write_whole(file, edited(text, job, better, folder=beside, into=out))
    cutoff = None if plan.smooth is None else plan.smooth.cutoff
    report("simulate", 2, 2)
    parts = [one for one, part in zip(every, own, strict=True) if part]
    return Correction(
        job=better, file=file, cutoff=cutoff, measured=maps.measured, predicted=maps.predicted,
        simulated=maps.simulated, proof=plan.proof, sources=names,
        sentences=_sentences(found, plan, names, parts),
    )  # fmt: skip


class _Plan(NamedTuple):
    """A correction that may be written."""

    likely: bool  # whether every source is planned with as it most probably is, not only those that are certain
    sources: bool  # whether tool and machine are planned as they were found
    smooth: Smooth | None
    map: int  # by whose draws it is proved
    draws: Draws
    proof: Proof


class _Maps(NamedTuple):
    """See `Correction`."""

    measured: HeightMap | None
    predicted: HeightMap | None
    simulated: HeightMap


class _Motions:
    """The motions of some jobs' finishing passes, each of them planned once."""

    def __init__(self) -> None:
        self._known: list[tuple[Job, Motion]] = []

    def of(self, job: Job) -> Motion:
        """Return the motion of a job's finishing pass."""
        for other, motion in self._known:
            if other == job:
                return motion
        motion = motion_of(job)
        self._known.append((job, motion))
        return motion


def _simulated(
    job: Job, found: Diagnosis, plan: _Plan, every: Sequence[Measured], motions: _Motions
) -> _Maps:  # fmt: skip
    """Return what a correction makes of the part, and raise where that is not what is claimed.

    Parameters
    ----------
    every
        The maps, if the part itself was among them.
    """
    with TemporaryDirectory(prefix="turnwright-") as folder:
        real = _better(job, found, plan._replace(likely=True, sources=True, smooth=None), (), File(folder))
        better = _better(job, found, plan, (), File(folder))
        new = motions.of(better)
        if not every:
            x, y = evenly(job.part, SHOWN)
            off = cut_by(new, real, x, y) - job.part.surface.sag(x, y)
            simulated = HeightMap(x=x, y=y, z=beyond_pose(job, x, y, off), name="simulated error")
            return _Maps(None, None, simulated)
        _check_simulated(job, better, plan, motions)
    old, error, field = motions.of(job), every[plan.map].error, found.fields[plan.map]

    def change(x: Floats, y: Floats) -> Floats:
        """Return what the real tool leaves by the corrected job, less what it left by the old one."""
        return cut_by(new, real, x, y) - cut_by(old, real, x, y)

    step = -(-error.z.size // SHOWN)
    x, y = (one[::step] for one in error.points())
    before = HeightMap(x=x, y=y, z=error.z[::step], name="measured error")
    predicted = replace(before, z=beyond_pose(job, x, y, before.z + change(x, y)), name="predicted error")
    x, y = field.points()
    # The field holds what the job adds to its design already.
    planned = cut_by(old, job, x, y) - job.part.aimed.surface.sag(x, y)
    off = planned + field.z + change(x, y)
    _check_claim(job, plan, off=(x, y, off), planned=planned)
    _check_candidates(every[plan.map], job, change)
    simulated = HeightMap(x=x, y=y, z=beyond_pose(job, x, y, off), name="simulated error")
    return _Maps(before, predicted, simulated)


def _check(job: Job, found: Diagnosis) -> None:
    """Raise unless the job cuts with the tool on the machine that were diagnosed, whatever their deviations."""
    tool, machine = job.tool, job.machine
    if (tool.nose_radius, tool.included, tool.rake) != (found.tool.nose_radius, found.tool.included, found.tool.rake):
        raise InputError(
            f"the job cuts with a nose radius {tool.nose_radius:g} mm, the measured parts were cut with "
            f"{found.tool.nose_radius:g} mm or another edge: correct a job of the tool that was measured"
        )
    if machine.name != found.machine.name:
        raise InputError(
            f"the job is for the machine {machine.name!r}, the measured parts were cut on {found.machine.name!r}: "
            "correct a job of the machine that was measured"
        )


def _better(
    job: Job, found: Diagnosis, plan: _Plan, ledger: Sequence[tuple[Measured, str]], out: File
) -> Job:  # fmt: skip
    """Return the corrected job; the files that it names are written."""
    kept = [line for line in job.measurement.corrected if not any(one.fingerprint in line for one, _ in ledger)]
    corrected = (*kept, *(line for _, line in ledger)) if ledger else job.measurement.corrected
    # The next part is another one, and the correction is its prediction now.
    better = replace(job, measurement=replace(job.measurement, corrected=corrected, cut_by=None), actual=Actual())
    if plan.sources:
        tool, machine = (found.likely_tool, found.likely_machine) if plan.likely else (found.tool, found.machine)
        better = replace(
            better, tool=_named_tool(tool, job.tool, out), machine=_named_machine(machine, job.machine, out)
        )
    if plan.smooth is not None and plan.smooth.cutoff is not None:
        file, new = out / "correction.npz", plan.smooth.table
        write_map(HeightMap(x=new.x, y=new.y, z=new.z, name="correction"), file)
        correction = replace(new, source=HeightFile(file=file))
        better = replace(better, part=replace(better.part, correction=correction))
    return better


def _check_new(job: Job, every: Sequence[Measured], own: Sequence[bool]) -> None:
    """Raise if a job that is corrected was corrected by one of the maps already."""
    for one, part in zip(every, own, strict=True):
        noted = (one.job if part else job).measurement.corrected
        if any(one.fingerprint in line for line in noted):
            raise InputError(
                f"the map {one.heights.name!r} was taken into account by an earlier correction of this job: measure a "
                "part that this job has cut, or give the map with the job that cut it"
            )
        if part and noted and one.job.measurement.cut_by is None:
            _check_effect(one)


def _check_effect(one: Measured) -> None:
    """Raise if a part shows all that its job was corrected by, as one does that was cut before.

    What tool and machine were corrected by and what the form was are looked at apart: a tool that moved again shows the
    former, in another size or without the latter.
    """
    job = one.job
    own = job.machine.loaded.value if job.machine.loaded else job.machine
    plain = replace(
        job,
        tool=replace(job.tool, offset=(0.0, 0.0, 0.0), radius_error=0.0, waviness=()),
        machine=replace(job.machine, squareness=own.squareness, straightness=own.straightness),
        part=replace(job.part, correction=None),
    )
    x, y = one.error.points()
    some = slice(None, None, -(-x.size // EFFECT))
    x, y, error = x[some], y[some], one.error.z[some]
    motion = motion_of(plain)
    by_tool, by_form = cut_by(motion, job, x, y) - cut_by(motion, plain, x, y), -_added(job, x, y)
    known = np.isfinite(by_tool + by_form + error)
    x, y = x[known], y[known]
    seen, *effects = (beyond_pose(job, x, y, each[known]) for each in (error, by_tool, by_form))
    corrected = effects[0] + effects[1]
    seen_nm, was_nm = (float(np.sqrt(np.mean(each**2))) * NM for each in (seen, corrected))
    if was_nm <= job.measurement.worth * NM:
        return
    columns = np.stack([each for each in effects if np.sqrt(np.mean(each**2)) * NM > NOTHING * was_nm], axis=1)
    shares, covariance = _shares(columns, seen, _patches(x, y))
    whole, none = (_away(shares - value, covariance) for value in (1.0, 0.0))
    if whole < TOLD < none:
        share = float(seen @ corrected) / float(corrected @ corrected)
        raise InputError(
            f"the map {one.heights.name!r} shows {share:.0%} of the {was_nm:.3g} nm rms that its job was corrected by, "
            f"in {seen_nm:.3g} nm, as if it was cut before the correction: give the job that cut it. If this job did, "
            'and the same error came back, write cut_by = "this job" in [measurement]'
        )


def _patches(x: Floats, y: Floats) -> NDArray[np.intp]:
    """Return which of rings and sectors of equal area points lie in, within which errors may hang together. (n,)."""
    square = x * x + y * y
    ring = np.minimum((RINGS * square / square.max()).astype(np.intp), RINGS - 1)
    sector = np.minimum(((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp), SECTORS - 1)
    return np.asarray(ring * SECTORS + sector)


def _shares(columns: Floats, seen: Floats, patches: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return how much of each column is seen, and the covariance of that if the rest hangs together in patches."""
    inverse = np.linalg.pinv(columns)
    shares = inverse @ seen
    rest = seen - columns @ shares
    pulls = np.stack([np.bincount(patches, weights=row * rest) for row in inverse])
    return shares, np.asarray(pulls @ pulls.T, dtype=np.float64)


def _away(off: Floats, covariance: Floats) -> float:
    """Return by how many standard deviations shares are off, those by which cuts repeat included."""
    both = covariance + REPEATED**2 * np.eye(off.size)
    return float(np.sqrt(off @ np.linalg.solve(both, off)))


def _check_sane(found: Diagnosis) -> None:
    """Raise if a diagnosis cannot be right."""
    for one in found:
        if one.determined and one.implausible:
            raise CorrectionError(f"nothing is corrected: {one.why}")
    if found.explained_rms_nm > EXPLAINED * found.measured_rms_nm + 1.0:
        raise CorrectionError(
            f"nothing is corrected: the diagnosis explains {found.explained_rms_nm:.3g} nm rms of "
            f"{found.measured_rms_nm:.3g} nm that were measured, at most {EXPLAINED:g} times as much can be right: "
            "measure an artefact, which tells the causes apart"
        )


def _proved(job: Job, found: Diagnosis, own: Sequence[bool]) -> _Plan:
    """Return the first correction that is certain to help."""
    plans = list(_plans(job, found, own))
    for plan in plans:
        if plan.proof.ok:
            return plan
    raise CorrectionError(_refusal(found, plans[0], sum(own)))


def _plans(job: Job, found: Diagnosis, own: Sequence[bool]) -> Iterator[_Plan]:
    """Yield the corrections that may be written, the best first."""
    worth_nm = job.measurement.worth * NM
    worth = any(one.verdict == "correct" and one.cause in PLANNED for one in found)
    if not any(own):
        draws = found.on(job.part.design)
        proof = prove(draws, np.zeros(draws.x.size), worth_nm=worth_nm)
        yield _Plan(likely=True, sources=True, smooth=None, map=0, draws=draws, proof=proof)
        return
    first = list(own).index(True)
    draws = found.draws(first)
    residuals = [
        _without_outliers(left, cutoff_of(job)) for left, part in zip(found.residuals, own, strict=True) if part
    ]
    beyond = _beyond(job, residuals, draws)
    # What no term of the diagnosis has is smoothed out of its noise.
    rest = _smooth(job, _joined(job, residuals)) if job.measurement.repeats else None
    for sources, maps in ((True, found.remainders), (False, found.fields)):
        if not sources and not worth:
            return
        form = _smooth(job, _joined(job, [one for one, part in zip(maps, own, strict=True) if part]))
        smooth = _together(
            [one for one in (form, rest) if one is not None and one.cutoff is not None], job.part.correction
        )
        added = np.zeros(draws.x.size)
        if smooth is not None:
            x, y = draws.places[:, 0], draws.places[:, 1]  # what is added stays on the part, wherever the map was
            added = smooth.table.evaluate(x, y, 0)[0] - _added(job, x, y)
        proof = prove(draws, added, sources=sources, beyond=beyond, worth_nm=worth_nm)
        yield _Plan(likely=False, sources=sources, smooth=smooth, map=first, draws=draws, proof=proof)


def _without_outliers(left: HeightMap, cutoff: float) -> HeightMap:
    """Return residuals without places that stand out of the rest, such as dust, and their surroundings. Scattered.

    What stands out so much is no form of the part that comes back; taken for one, it would be cut into the next part.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - scipy is costly to import

    x, y = (one.ravel() for one in left.points())
    z = left.z.ravel()
    known = np.isfinite(z)
    x, y, z = x[known], y[known], z[known]
    off = np.abs(z - np.median(z))
    out = off > OUTLIER_SIGMA * robust_scatter(off)
    if out.any():
        near = cKDTree(np.stack([x[out], y[out]], axis=1)).query(np.stack([x, y], axis=1))[0] <= cutoff / 2
        x, y, z = x[~near], y[~near], z[~near]
    return HeightMap(x=x, y=y, z=z, name=left.name)


def _together(parts: Sequence[Smooth], before: Gridded | None) -> Smooth | None:
    """Return what is added to a part in all, ``None`` if nothing is new."""
    if not parts:
        return None
    tables = [one.table for one in parts] + ([] if before is None else [before])
    table = reduce(sum_tables, tables)
    return Smooth(table, min(one.cutoff for one in parts if one.cutoff is not None))


def _beyond(job: Job, residuals: Sequence[HeightMap], draws: Draws) -> Floats:
    """Return what a further part has beyond all that a diagnosis knows, in draws. (draws, n) [mm].

    What the residuals of several maps share comes back; by as much as they differ, so does the next part.
    """
    smooth = [
        -one.table.evaluate(draws.x, draws.y, 0)[0]
        for one in (_smooth(job, _joined(job, [left])) for left in residuals)
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


def _refusal(found: Diagnosis, plan: _Plan, parts: int) -> str:
    """Return why nothing is corrected, and what measurement would decide it."""
    proof = plan.proof
    if proof.before_nm < SMALL * proof.worth_nm:
        return (
            f"no correction is written: the next part is off by {proof.before_nm:.2g} nm rms beyond cusps and noise, "
            f"too little to become better by {proof.worth_nm:g} nm for certain: cut on, or lower measurement.worth"
        )
    gain = proof.gain_nm
    usual = (
        f"95 % become better by {gain:.2g} nm rms or more" if gain > 0 else f"5 % become worse by {-gain:.2g} nm rms"
    )
    worst = f"worse by {proof.worst_nm:.2g} nm" if proof.worst_nm > 0 else f"better by {-proof.worst_nm:.2g} nm"
    why = (
        f"no correction is written: of {proof.draws} draws of the next part, off by {proof.before_nm:.3g} nm rms, "
        f"{usual}, and the worst becomes {worst}; 95 % must gain {proof.worth_nm:g} nm, and none may lose as much"
    )
    if plan.draws.unmeasured:
        return f"{why}. {plan.draws.unmeasured:.0%} of the part lies beyond the map: measure all of it"
    scatter = found.repeatability_nm
    if scatter is not None and scatter > 1:
        shared = math.sqrt(max(found.explained_rms_nm**2 - scatter**2, 0.0))
        more = math.ceil(4 * (scatter / shared) ** 2) - parts if shared > scatter / 4 else 0
        remedy = f"measure {more} more" if more > 0 else "find what moves from part to part"
        return f"{why}. The maps differ by {scatter:.3g} nm rms: {remedy}"
    hidden = next((one for one in found if one.verdict != "correct" and one.rms_nm > 1), None)
    return f"{why}. {hidden.why if hidden else 'Measure more points, or more parts'}"


def _check_linear(job: Job, draws: Draws, motions: _Motions) -> None:
    """Raise if some draws, simulated in full, are not what the linear model makes of them."""
    some, places = _cuspless(job, draws)
    motion = replace(motions.of(job), velocity=None)
    tool, machine = job.tool, job.machine
    clean = _means(motion, tool, machine, places)
    for case in draws.cases:
        made = _means(_off(motion, case), case.tool, case.machine, places) - clean + case.rest[some]
        known = np.isfinite(made)
        linear = draws.before[case.number][some]
        rest = replace(draws, pose=draws.pose[some][known])
        off, size = (float(rest.rms_nm(one[None, known])[0]) for one in (made - linear, linear))
        if off > max(LINEAR * size, LINEAR_NM):
            raise CorrectionError(
                f"nothing is corrected: a draw of the errors makes {size:.3g} nm rms by the model that they were found "
                f"with and differs by {off:.3g} nm in full simulation, {LINEAR:.0%} is the limit: correct the largest "
                "at the machine first, then measure again"
            )


def _check_simulated(job: Job, better: Job, plan: _Plan, motions: _Motions) -> None:
    """Raise if the corrected job does not change the part as it is meant to."""
    draws = plan.draws
    some, places = _cuspless(job, draws)
    after, before = (_means(motions.of(one), one.tool, one.machine, places) for one in (better, job))
    now, then = (_added(one, draws.x[some], draws.y[some]) for one in (better, job))
    known = np.isfinite(after - before)
    rest = replace(draws, pose=draws.pose[some][known])
    meant = now - then
    off, size = (float(rest.rms_nm(one[None, known])[0]) for one in (after - before - meant, meant))
    if off > max(SIMULATED * size, SIMULATED_NM):
        cutoff = None if plan.smooth is None else plan.smooth.cutoff
        remedy = f"raise measurement.cutoff above {cutoff:g} mm" if cutoff else "look at the job with turnwright check"
        raise CorrectionError(
            f"nothing is corrected: the corrected job should change the part by {size:.3g} nm rms and is {off:.3g} nm "
            f"off that by simulation, the limit is {SIMULATED:.0%} and {SIMULATED_NM:g} nm: {remedy}"
        )


def _check_claim(job: Job, plan: _Plan, *, off: tuple[Floats, Floats, Floats], planned: Floats) -> None:
    """Raise if the corrected part, by simulation, is farther off than the draws and its cusps say."""
    x, y, z = off
    simulated, cusps = (
        float(np.sqrt(np.nanmean(beyond_pose(job, x, y, one) ** 2))) * NM for one in (z, planned)
    )  # fmt: skip
    claimed = math.hypot(plan.proof.after_nm, cusps)
    if simulated > claimed + max(SIMULATED * claimed, SIMULATED_NM):
        raise CorrectionError(
            f"nothing is corrected: the draws leave {claimed:.3g} nm rms with the cusps, the simulation of the "
            f"corrected job {simulated:.3g} nm, {SIMULATED:.0%} and {SIMULATED_NM:g} nm more are the limit: clean the "
            "map of what is not the part, or measure a second part"
        )


def _check_candidates(one: Measured, job: Job, change: Callable[[Floats, Floats], Floats]) -> None:
    """Raise if the part would become worse by a correction where the map may lie as well."""
    worth_nm = job.measurement.worth * NM
    for pose, error in errors_at_candidates(one):
        x, y = error.points()
        step = -(-error.z.size // SHOWN)
        x, y, z = x[::step], y[::step], error.z[::step]
        before, after = (
            float(np.sqrt(np.nanmean(beyond_pose(job, x, y, each) ** 2))) * NM for each in (z, z + change(x, y))
        )
        if after > before + worth_nm:
            shift = ", ".join(f"{value:.4g}" for value in pose.shift)
            raise CorrectionError(
                f"nothing is corrected: the map lies on the part with shift ({shift}) mm and rotation "
                f"{np.rad2deg(pose.rotation):.4g} deg nearly as well, and there {before:.3g} nm rms would become "
                f"{after:.3g} nm: measure the edge of the part or a mark, and state shift, rotation and a smaller "
                "reach and clocking in [measurement]"
            )


def _added(job: Job, x: Floats, y: Floats) -> Floats:
    """Return what a job adds to its design at some places, of their shape. [mm]."""
    return np.zeros_like(x) if job.part.correction is None else job.part.correction.evaluate(x, y, 0)[0]


def _off(motion: Motion, case: DrawnCut) -> Motion:
    """Return the motion of a tip that is moved as in a draw."""
    along_x, along_z = case.tip_motion(*(motion.axes[letter] for letter in "XCZ"))
    return replace(motion, axes={**motion.axes, "X": motion.axes["X"] + along_x, "Z": motion.axes["Z"] + along_z})


def _cuspless(job: Job, draws: Draws) -> tuple[NDArray[np.intp], tuple[Floats, Floats]]:
    """Return which of the places of some draws are simulated, and the places across a feed around each. (n, FINE).

    Nearer to the rim than a drawn tip is off, the first turn may come short of the part.
    """
    planned = job.tool.offset
    off = max((math.dist(case.tool.offset[:2], planned[:2]) for case in draws.cases), default=0.0)
    cut = np.flatnonzero(np.hypot(draws.x, draws.y) < job.part.radius - off - feed_of(job))
    some = cut[:: -(-draws.x.size // PLACES)]
    return some, across_feed(job, draws.x[some], draws.y[some], FINE)


def _means(motion: Motion, tool: Tool, machine: Machine, places: tuple[Floats, Floats]) -> Floats:
    """Return mean heights across a feed. (n,) [mm]."""
    x, y = (one.ravel() for one in places)
    return np.asarray(generate_points(motion, tool, x=x, y=y, machine=machine).reshape(places[0].shape).mean(axis=1))


def _entry(one: Measured, names: Sequence[str], plan: _Plan) -> str:
    """Return what a job notes of a map that it was corrected by."""
    what = [*names, *(["form"] if plan.smooth is not None and plan.smooth.cutoff else [])]
    return f"{one.heights.name[:NAMED] or 'map'} ({one.fingerprint}): {', '.join(what)}"


NAMED = 60
"""Letters of the name of a map that a job notes."""


def _sentences(
    found: Diagnosis, plan: _Plan, names: Sequence[str], parts: Sequence[Measured]
) -> tuple[str, ...]:  # fmt: skip
    """Return what is corrected, how surely, and what is at stake."""
    proof, sentences = plan.proof, []
    form = plan.smooth is not None and plan.smooth.cutoff is not None
    sentences.append(
        f"corrected: {', '.join(names) or 'no source'} by tool and machine"
        + (", all else that repeats by the surface that is aimed at" if form else "")
    )
    sentences.append(
        f"of {proof.draws} draws of what is not certain, 95 % become better by {proof.gain_nm:.3g} nm rms or more and "
        f"none becomes worse by more than {max(proof.worst_nm, 0.0):.2g} nm: {proof.before_nm:.3g} nm become "
        f"{proof.after_nm:.3g} nm"
    )
    stays = [one for one in found.contributions if one.rms_nm > max(proof.worth_nm, SURE * one.uncertainty_nm)]
    if plan.likely and stays:
        shown = ", ".join(f"{one.name} ({one.rms_nm:.3g} nm rms on the measured parts)" for one in stays)
        sentences.append(f"not corrected on this part: {shown}; cut it, measure it and correct it by its own map")
    if form and plan.draws.unmeasured:
        sentences.append(
            f"the map leaves out {plan.draws.unmeasured:.0%} of the part: its form is not corrected there, and what is "
            "predicted and simulated does not count it"
        )
    if any("rotation" in one.registration.held for one in parts):
        sentences.append(
            "nothing on the part shows its clocking: the correction takes the map as it is turned, within a few "
            "degrees, and lies wrong on the next part if that is measured or mounted otherwise"
        )
    if found.repeatability_nm is not None:
        sentences.append(f"the maps differ by {found.repeatability_nm:.3g} nm rms; only what they share is corrected")
    elif proof.at_stake_nm > 1:
        sentences.append(
            f"one map cannot show what repeats: if the {proof.at_stake_nm:.3g} nm rms that are corrected do not, "
            f"the next part is off by up to {proof.if_not_repeated_nm:.3g} nm, {proof.at_stake_nm:.3g} nm more than "
            "without at most; a second part decides"
        )
    return tuple(sentences)


def _joined(job: Job, maps: Sequence[HeightMap]) -> HeightMap:
    """Return all heights of some maps, scattered."""
    points = [tuple(one.ravel() for one in (*heights.points(), heights.z)) for heights in maps]
    x, y, z = (np.concatenate(one) for one in zip(*points, strict=True))
    known = ~np.isnan(z)
    x, y = x[known], y[known]
    return HeightMap(x=x, y=y, z=beyond_pose(job, x, y, z[known]), name="left to correct")


def _smooth(job: Job, left: HeightMap) -> Smooth:
    """Return what is to be added to a part so that an error does not come back."""
    strategy, last = job.strategy, job.passes[-1]

    def stated(name: str) -> float:
        return getattr(last, name, None) or getattr(strategy, name, None) or 0.0

    tool = job.tool
    half = np.pi / 2 if tool.included is None else tool.included / 2
    beyond = stated("lead_in") + stated("overrun") + tool.actual_radius * float(np.sin(half))
    return form_compensation(job.part, left, cutoff=cutoff_of(job), beyond=beyond)


def _named_tool(tool: Tool, planned: Tool, out: File) -> Tool:
    """Return the planned tool as it was found; the file of its certificate is written."""
    found = replace(planned, radius_error=tool.radius_error, offset=tool.offset)
    if not isinstance(tool.waviness, WavinessTable) or tool.waviness is planned.waviness:
        return found
    columns = _columns(out / "waviness.csv", "sweep [rad],deviation [mm]", tool.waviness.sweep, tool.waviness.deviation)
    return replace(found, waviness=replace(tool.waviness, file=str(columns)))


def _named_machine(machine: Machine, planned: Machine, out: File) -> Machine:
    """Return the planned machine as it was found; the file of its straightness is written."""
    found = replace(planned, squareness=machine.squareness)
    if machine.straightness is None or machine.straightness is planned.straightness:
        return found
    file = _columns(out / "straightness.csv", "x [mm],error [mm]", *machine.straightness)
    return replace(found, straightness=machine.straightness, sources={**planned.sources, "straightness": str(file)})


def _columns(file: File, head: str, one: Floats, other: Floats) -> File:
    """Write two columns with every digit."""
    rows = (f"{a!r},{b!r}" for a, b in zip(one.tolist(), other.tolist(), strict=True))
    write_whole(file, "\n".join([head, *rows]) + "\n")
    return file
