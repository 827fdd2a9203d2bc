"""Choose feed, points and spindle speed so that a part keeps its tolerances, and prove it by simulation."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path as File
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from turnwright.contact import place
from turnwright.errors import JobError, LimitError
from turnwright.generation import generate_polar
from turnwright.job._run import read_back, written
from turnwright.job._schema import Job
from turnwright.job._shares import (
    Shares,
    apart_nm,
    exact_motion,
    finish_nm,
    has_servos,
    lines,
    pv_nm_of,
    shares,
    without_servos,
)
from turnwright.job._strategies import Choices
from turnwright.motion import Limits, check_limits, drive
from turnwright.tracking import track
from turnwright.units import write

if TYPE_CHECKING:
    from turnwright.job._run import StageProgress
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Motion, Spiral
    from turnwright.strategy import Strategy
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
    r"""Choose feed, points and spindle speed for the finishing pass.

    The feed, or the scallop of an adaptive tool servo, is the largest whose cusps keep the finish tolerance, and half
    of the form tolerance. What the cusps and the program's decimals leave of the form tolerance is split between the
    points (chord) and the servos (tracking):
    several splits are planned, each at the highest speed that keeps both the machine's limits and its share, and the
    quickest is written, read back and simulated whole. Since not all shares meet in one place it may keep the
    tolerances with room to spare: then the shares grow, until the proof uses the tolerances up.

    A machine that may vary its speed, and states no servos, is left to do so; otherwise one speed is stated.

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
        If a tolerance is not stated, or the strategy does not set its points by a chord.
    LimitError
        If no plan keeps them.
    """
    form, sq = job.tolerances.form_pv, job.tolerances.sq
    if form is None or sq is None:
        raise JobError("the job states no tolerances.form_pv or no tolerances.sq: a plan needs both, add them")
    if "chord" not in type(job.strategy).model_fields:
        raise JobError(f"a plan sets a chord, which the {job.strategy.kind} does not have: choose another kind")
    told = progress or (lambda _stage, _done, _total: None)
    told("cusps", 0, 1)
    across, cusp = _across(job, form, sq)
    told("cusps", 1, 1)
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
        proved = _proved(job, across, left, roughest)
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


def _proved(job: Job, across: float, left: float, roughest: float) -> Plan:
    """Return the quickest plan whose points and servos share what is left [mm], written, read back and simulated."""
    part, tool, machine = job.part.part, job.tool.tool, job.machine.machine
    answers = has_servos(machine)
    varied = machine.controller.variable_speed and not answers
    if not varied:
        machine = replace(machine, controller=replace(machine.controller, variable_speed=False))
    tried: list[tuple[float, float, float]] = []
    best: tuple[Job, Spiral, Motion] | None = None
    for split in SPLITS if answers else (1.0,):
        chord = _plain(min(split * left, roughest))
        filled = _filled(job, across, chord=chord)
        servo = filled.servo(filled.passes[-1])
        spiral = servo.spiral(part, tool)
        motion = _within(servo, spiral, part, tool, machine, left - chord if answers else math.inf)
        minutes = float(motion.time[-1] - motion.time[0]) / 60
        tried.append((chord, check_limits(motion, machine).spindle_rpm, minutes))
        if best is None or motion.time[-1] - motion.time[0] < best[2].time[-1] - best[2].time[0]:
            best = filled, spiral, motion
    assert best is not None  # noqa: S101 - there is at least one split
    filled, spiral, motion = best
    rpm = None if varied else _plain(check_limits(motion, machine).spindle_rpm)
    if rpm is not None:
        motion = replace(motion, time=motion.time * (check_limits(motion, machine).spindle_rpm / rpm))
    with TemporaryDirectory(prefix="turnwright-") as folder:
        again = read_back(filled, written(filled, {"finish": motion}, File(folder)).files[0], "finish")
    return Plan(
        job=_filled(filled, across, chord=filled.strategy.chord, rpm=rpm),  # type: ignore[union-attr] # it has one
        shares=shares(part, tool, spiral, motion, again=again),
        limits=check_limits(motion, machine),
        tried=tuple(tried),
    )


def _plain(value: float) -> float:
    """Return the next lower number of four digits, as a person would write it."""
    places = 3 - math.floor(math.log10(value))
    return float(Decimal(math.floor(value * 10.0**places)).scaleb(-places))


def _key(job: Job) -> tuple[str, str]:
    """Return what sets the height of the cusps, and its unit."""
    return ("scallop", "mm") if "scallop" in type(job.strategy).model_fields else ("feed", "mm/rev")


def _filled(
    job: Job, across: float, *, chord: float | None = None, points: int | None = None, rpm: float | None = None
) -> Job:
    """Return the job with what was chosen, and nothing that it said itself of feed, points and speed."""
    table = tomllib.loads(job.to_toml())
    for one in (table["strategy"], table.get("passes", [{}])[-1]):
        for name in Choices.model_fields.keys() - {"lead_in"}:
            one.pop(name, None)
    key, unit = _key(job)
    chosen = {
        key: write(across, unit),
        "chord": None if chord is None else write(chord, "mm"),
        "points_per_rev": points,
        "spindle_speed": None if rpm is None else write(rpm, "rpm"),
    }
    table["strategy"] |= {name: value for name, value in chosen.items() if value is not None}
    return Job.read(table)


def _across(job: Job, form: float, sq: float) -> tuple[float, float]:
    """Return the largest feed or scallop whose cusps keep their share of both tolerances, and their height [mm]."""
    part, tool, machine = job.part.part, job.tool.tool, job.machine.machine
    pv_limit, sq_limit = CUSP_SHARE * ROOM * form, SQ_SHARE * ROOM * sq
    scallop = _key(job)[0] == "scallop"
    across = min(pv_limit, sq_limit / CUSP_SQ)
    if not scallop:
        across = math.sqrt(8 * tool.actual_radius * across)
    for _ in range(ROUNDS):
        filled = _filled(job, across, chord=pv_limit) if scallop else _filled(job, across, points=FEWEST)
        spiral = filled.servo(filled.passes[-1]).spiral(part, tool)
        feed = spiral.feed
        radius, angle = lines(part, feed)
        made = generate_polar(exact_motion(spiral, part, tool, machine, angle), tool, radius=radius, angle=angle)
        error = made.minus(part.surface)
        pv, finish = pv_nm_of(error.z) / NM, finish_nm(error, feed) / NM
        share = max(pv / pv_limit, finish / sq_limit)
        if NEAR <= share <= 1:
            return _plain(across), pv
        # Cusps grow with the square of the feed.
        across *= ((1 + NEAR) / 2 / share) ** (1.0 if scallop else 0.5)
    name, unit = _key(job)
    raise LimitError(
        f"no {name} keeps form_pv {form * NM:.3g} nm and sq {sq * NM:.3g} nm: at {write(_plain(across), unit)} the "
        f"exact path leaves {pv * NM:.3g} nm and {finish * NM:.3g} nm, so what it leaves is not cusps; take a smaller "
        "nose_radius"
    )


def _within(servo: Strategy, spiral: Spiral, part: Part, tool: Tool, machine: Machine, share: float) -> Motion:
    """Return the quickest motion that keeps the machine's limits, and whose servos keep their share [mm]."""
    motion = drive(place(spiral, part, tool), servo, machine)
    if math.isinf(share):
        return motion
    radius, angle = lines(part, COARSE * spiral.feed)
    # Without servos a slower spindle takes the tool along the same way.
    ideal = generate_polar(track(motion, without_servos(machine), chord=NEAR_ENOUGH), tool, radius=radius, angle=angle)
    slow, quick = 0.0, math.inf  # speeds, as shares of the highest, that keep it and that do not
    speed = 1.0
    kept: Motion | None = None
    for _ in range(2 * ROUNDS):
        asked = replace(motion, time=motion.time / speed)
        made = generate_polar(track(asked, machine, chord=NEAR_ENOUGH), tool, radius=radius, angle=angle)
        ratio = apart_nm(made, ideal) / NM / share
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
