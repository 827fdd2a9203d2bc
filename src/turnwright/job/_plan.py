"""Choose feed, points and spindle speed so that a part keeps its tolerances, and prove it by simulation."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, replace
from decimal import Decimal
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from turnwright.contact import place
from turnwright.errors import JobError, LimitError
from turnwright.generation import generate_polar
from turnwright.job._schema import Job
from turnwright.job._shares import (
    Shares,
    apart_nm,
    exact_motion,
    finish_nm,
    has_servos,
    lines,
    shares,
    without_servos,
)
from turnwright.motion import Limits, check_limits, drive
from turnwright.post import read_nc, write_nc
from turnwright.strategy import SlowToolServo
from turnwright.tracking import track
from turnwright.units import write

if TYPE_CHECKING:
    from turnwright.job._run import StageProgress
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Motion, Spiral
    from turnwright.tool import Tool

__all__ = ["Plan", "plan"]

NM = 1e6
CUSP_SQ = math.sqrt(4 / 45)
"""Sq of round cusps over their height."""

NEAR = 0.93
"""A share that is used up to here needs no better plan."""

ROUNDS = 8
"""Plans that are tried for one number."""

COARSE = 4
"""Where only the difference of two surfaces counts, one sample in so many will do."""

NEAR_ENOUGH = 1e-5
"""How finely the real motion is followed while a speed is sought. [mm]"""

FEWEST = 72
"""Points per turn of a spiral that is only looked at for its radii."""

CUSP_SHARE = 0.5
"""Most of the form tolerance that the cusps may take: the minutes go with one over the root of their height, and with
one over the root of what is left to points and servos."""

SQ_SHARE = 0.9
"""Share of the finish tolerance that the cusps may take, in squares with the points."""

CHORD_SQ = 0.3
"""Sq that the points add, over their chord: the path between two of them is a parabola, and turns do not match."""

DECIMALS = 2e-6
"""What the program's decimals may add, at most; the proof measures it. [mm]"""

PROOFS = 4
"""Plans that are proved, each with larger shares than the one before."""

ROOM = 0.97
"""Share of a tolerance that is planned for; what a simulation then finds may be a little more."""

SPLITS = (0.9, 0.6, 0.4, 0.25, 0.15)
"""Parts of what the cusps leave that are tried for the points; the servos get the rest."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """What was chosen, and what comes of it.

    Parameters
    ----------
    job
        The job with its strategy filled in.
    shares
        Where the form error comes from, of the program read back, with interpolation and servos.
    limits
        What the program asks of the machine.
    tried
        (chord [mm], spindle speed [rev/min], minutes) of every plan that was tried; the quickest was taken.
    """

    job: Job
    shares: Shares
    limits: Limits
    tried: tuple[tuple[float, float, float], ...]


def plan(job: Job, *, progress: StageProgress | None = None) -> Plan:
    r"""Choose feed, points and spindle speed for the finishing pass of a slow tool servo.

    The feed is the largest whose cusps keep the finish tolerance, and half of the form tolerance. What the cusps and
    the program's decimals leave of the form tolerance is split between the points (chord) and the servos (tracking):
    several splits are planned, each at the highest speed that keeps both the machine's limits and its share, and the
    quickest is written, read back and simulated whole. Since not all shares meet in one place it may keep the
    tolerances with room to spare: then the shares grow, until the proof uses the tolerances up.

    What the job's strategy says of feed, points and speed is replaced; all else stays.

    Parameters
    ----------
    job
        States both tolerances.
    progress
        Called with (stage, done, total).

    Raises
    ------
    JobError
        If a tolerance is not stated.
    LimitError
        If no plan keeps them.
    """
    form, sq = job.tolerances.form_pv, job.tolerances.sq
    if form is None or sq is None:
        raise JobError("the job states no tolerances.form_pv or no tolerances.sq: a plan needs both, add them")
    told = progress or (lambda _stage, _done, _total: None)
    told("feed", 0, 1)
    feed, cusp = _feed(job, form, sq)
    told("feed", 1, 1)
    # Points and servos err to both sides.
    left = (ROOM * form - cusp - DECIMALS) / 2
    if left <= 0:
        raise LimitError(
            f"cusps of {cusp * NM:.3g} nm and the program's decimals leave nothing of form_pv {form * NM:.3g} nm: "
            "allow more, or take a larger nose_radius"
        )
    roughest = ROOM * sq * math.sqrt(1 - SQ_SHARE**2) / CHORD_SQ
    kept: Plan | None = None
    for number in range(PROOFS):
        told("points, speed and proof", number, PROOFS)
        proved = _proved(job, feed, left, roughest)
        found = proved.shares
        if found.pv_nm > form * NM or found.sq_nm > sq * NM:
            if kept is None:
                raise LimitError(
                    f"the plan leaves a form error PV of {found.pv_nm:.4g} nm and an Sq of {found.sq_nm:.4g} nm, the "
                    f"tolerances are {form * NM:.4g} nm and {sq * NM:.4g} nm: cusps have {found.cusp_nm:.3g} nm, "
                    f"points {found.chord_nm:.3g} nm, decimals {found.rounding_nm:.3g} nm, servos "
                    f"{found.tracking_nm:.3g} nm of it; allow more, or change tool or machine"
                )
            break
        if kept is not None and proved.limits.cycle_time_s > NEAR * kept.limits.cycle_time_s:
            break
        kept = proved
        more = min((ROOM * form * NM - found.cusp_nm) / max(found.pv_nm - found.cusp_nm, 1e-3), 3.0)
        if more < 1 / NEAR:
            break
        left *= more
    told("points, speed and proof", PROOFS, PROOFS)
    assert kept is not None  # noqa: S101 - the loop keeps a plan or raises
    return kept


def _proved(job: Job, feed: float, left: float, roughest: float) -> Plan:
    """Return the quickest plan whose points and servos share what is left [mm], written, read back and simulated."""
    part, tool, machine = job.part.part, job.tool.tool, job.machine.machine
    answers = has_servos(machine)
    tried: list[tuple[float, float, float]] = []
    best: tuple[SlowToolServo, Spiral, Motion] | None = None
    for split in SPLITS if answers else (1.0,):
        chord = _plain(min(split * left, roughest))
        servo = replace(_servo(job), feed=feed, points_per_rev=None, arc_length=None, chord=chord, spindle_rpm=None)
        spiral = servo.spiral(part, tool)
        motion = _within(servo, spiral, part, tool, machine, left - chord if answers else math.inf)
        minutes = float(motion.time[-1] - motion.time[0]) / 60
        tried.append((chord, check_limits(motion, machine).spindle_rpm, minutes))
        if best is None or motion.time[-1] - motion.time[0] < best[2].time[-1] - best[2].time[0]:
            best = servo, spiral, motion
    assert best is not None  # noqa: S101 - there is at least one split
    servo, spiral, motion = best
    rpm = check_limits(motion, machine).spindle_rpm
    motion = replace(motion, time=motion.time * (rpm / _plain(rpm)))
    limits = check_limits(motion, machine)
    with TemporaryDirectory(prefix="turnwright-") as folder:
        again = read_nc(write_nc(motion, machine, f"{folder}/plan.nc").files[0], machine)
    return Plan(
        job=_filled(job, servo, _plain(rpm)),
        shares=shares(part, tool, spiral, motion, again=again),
        limits=limits,
        tried=tuple(tried),
    )


def _plain(value: float) -> float:
    """Return the next lower number of four digits, as a person would write it."""
    places = 3 - math.floor(math.log10(value))
    return float(Decimal(math.floor(value * 10.0**places)).scaleb(-places))


def _servo(job: Job) -> SlowToolServo:
    """Return the strategy of the finishing pass."""
    servo = job.servo(job.passes[-1])
    if not isinstance(servo, SlowToolServo):
        raise JobError(f'strategy.kind is "{job.strategy.kind}", a plan is made for a "slow tool servo": choose that')
    return servo


def _feed(job: Job, form: float, sq: float) -> tuple[float, float]:
    """Return the largest feed whose cusps keep their share of both tolerances, and their height. [mm/rev], [mm]."""
    part, tool, machine = job.part.part, job.tool.tool, job.machine.machine
    pv_limit, sq_limit = CUSP_SHARE * ROOM * form, SQ_SHARE * ROOM * sq
    feed = math.sqrt(8 * tool.actual_radius * min(pv_limit, sq_limit / CUSP_SQ))
    for _ in range(ROUNDS):
        servo = replace(_servo(job), feed=feed, points_per_rev=FEWEST, arc_length=None, max_step=None, chord=None)
        spiral = servo.spiral(part, tool)
        radius, angle = lines(part, feed)
        made = generate_polar(exact_motion(spiral, part, tool, machine, angle), tool, radius=radius, angle=angle)
        error = made.minus(part.surface)
        pv, finish = float(np.nanmax(error.z) - np.nanmin(error.z)), finish_nm(error, feed) / NM
        share = max(pv / pv_limit, finish / sq_limit)
        if NEAR <= share <= 1:
            return _plain(feed), pv
        # Cusps grow with the square of the feed.
        feed *= math.sqrt((1 + NEAR) / 2 / share)
    raise LimitError(
        f"no feed keeps form_pv {form * NM:.3g} nm and sq {sq * NM:.3g} nm: at {feed * 1e3:.3g} um/rev the exact path "
        f"leaves {pv * NM:.3g} nm and {finish * NM:.3g} nm, so what it leaves is not cusps; take a smaller nose_radius"
    )


def _within(servo: SlowToolServo, spiral: Spiral, part: Part, tool: Tool, machine: Machine, share: float) -> Motion:
    """Return the quickest motion that keeps the machine's limits, and whose servos keep their share [mm]."""
    motion = drive(place(spiral, part, tool), servo, machine)
    if math.isinf(share):
        return motion
    radius, angle = lines(part, COARSE * servo.feed)
    ideal = without_servos(machine)
    slow, quick = 0.0, math.inf  # speeds, as shares of the highest, that keep it and that do not
    speed = 1.0
    kept: Motion | None = None
    for _ in range(2 * ROUNDS):
        asked = replace(motion, time=motion.time / speed)
        made = [
            generate_polar(track(asked, one, chord=NEAR_ENOUGH), tool, radius=radius, angle=angle)
            for one in (machine, ideal)
        ]
        ratio = apart_nm(*made) / NM / share
        if ratio <= 1:
            slow, kept = speed, asked
            if speed == 1 or ratio >= NEAR:
                break
        else:
            quick = speed
        # Servos err with the speed, or with its square where they look ahead: somewhere between.
        guess = speed * (0.5 * (1 + NEAR) / ratio) ** 0.6
        low, high = slow, min(quick, 1.0)
        speed = guess if low < guess < high else 0.5 * (low + high)
        if slow and high / slow < 1 / NEAR:
            break
    if kept is None:
        raise LimitError(
            f"the servos of {machine.name} err by more than {share * NM:.3g} nm at any speed: allow more form_pv, or "
            "correct the motion beforehand (precorrect)"
        )
    return kept


def _filled(job: Job, servo: SlowToolServo, rpm: float) -> Job:
    """Return the job with what was chosen."""
    table = tomllib.loads(job.to_toml())
    own = table.get("passes", [{}])[-1]
    for one in (table["strategy"], own):
        for name in ("feed", "spindle_speed", "points_per_rev", "arc_length", "chord"):
            one.pop(name, None)
    table["strategy"] |= {
        "feed": write(servo.feed, "mm/rev"),
        "chord": write(servo.chord, "mm"),  # type: ignore[arg-type] # a plan is by chord
        "spindle_speed": write(rpm, "rpm"),
    }
    return Job.read(table)
