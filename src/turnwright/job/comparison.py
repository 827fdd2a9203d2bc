"""Compare all strategies that the machine can run, for the same part, tool, cusp height and chord error."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from turnwright._tables import write_table
from turnwright.errors import Stopped, TurnwrightError
from turnwright.job.contributions import ErrorBreakdown, break_down_error
from turnwright.job.pass_plan import Watch
from turnwright.job.pipeline import Pipeline
from turnwright.job.schema import Job
from turnwright.machine import Machine
from turnwright.motion import Limits, check_limits, drive
from turnwright.part import Part
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.progress import Progress, StageProgress
from turnwright.strategy import (
    AdaptiveToolServo,
    FastToolServo,
    HybridToolServo,
    QuasiEllipticalToolServo,
    SlowToolServo,
    Strategy,
)
from turnwright.tool import Tool

__all__ = ["Candidate", "Comparison", "compare", "strategies_of"]

TURN = 2 * math.pi
AS_IT_STANDS = "the current job"

SHORT_STEP_FRACTION = 1e-4
"""Fraction of the steps of a plan by chord that may be shorter than the steps of the plan at a constant angle."""

SLIDE_BLOCKS_PER_REV = 360
"""Blocks of the slide per revolution under a fast tool, which has its own table."""

MIN_ARC_RATIO = 0.5
"""Arc between valleys, over the feature size of the surface, below which the quasi-elliptical servo skips one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """One strategy of a comparison.

    Parameters
    ----------
    name
        Name of the strategy.
    servo
        The strategy; ``None`` if it could not be set up.
    refused
        Why it cannot be used, in a sentence; if empty, it can, and all fields below have values.
    turns
        Revolutions of the spindle.
    size_bytes
        Size of all files of its program.
    limits
        Speed, acceleration and jerk of the axes against the limits of the machine.
    breakdown
        Error contributions to the form error of the program read back, with interpolation and servos.
    wall_s
        Time to plan, write, read back and simulate. [s]
    """

    name: str
    servo: Strategy | None = None
    refused: str = ""
    turns: float = math.nan
    size_bytes: int = 0
    limits: Limits | None = None
    breakdown: ErrorBreakdown | None = None
    wall_s: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """The strategies for a job.

    Parameters
    ----------
    job
        The job.
    scallop, chord
        Cusp height and chord error that all strategies are planned for. [mm]
    candidates
        One for each strategy.
    """

    job: Job
    scallop: float
    chord: float
    candidates: tuple[Candidate, ...]

    def stated(self, candidate: Candidate) -> dict[str, Any]:
        """Return a strategy as the table ``strategy`` of a job file; empty if it could not be set up."""
        if candidate.name == AS_IT_STANDS:
            return write_table(self.job.strategy)
        if candidate.servo is None:
            return {}
        # The motion of the slide under a fast tool is not stated: a job computes it from the limits of that tool.
        return write_table(candidate.servo)


def compare(
    job: Job, *, progress: StageProgress | None = None, ready: Callable[[Candidate], object] | None = None
) -> Comparison:
    """Plan the finishing pass with every strategy, to the same cusp height and chord error, and simulate each surface.

    The first candidate is the current job, with its own points, feed and speeds.
    An adaptive job states cusp height and chord error. For any other job, the cusp height is the largest that its feed
    leaves away from the axis; where the surface is in pieces it is that of a flat, since no nose reaches the valleys.
    The chord error is the one that the job states, or the largest between its points. Strategies of constant feed keep
    the feed of the job, or, for an adaptive job, take the largest that keeps the scallop. Slow, fast and hybrid servos
    also keep its lead-in and overrun. Each uses the spindle speed or speeds of the job, or the highest within all
    limits if it states none.

    Parameters
    ----------
    job
        Part, tool, machine and strategy.
    progress
        Called with (stage, done, total).
    ready
        Called with each candidate when it is evaluated, so that it can be shown meanwhile.
    """
    watch, stated = Watch(progress), job.servo(job.passes[-1])
    spirals = _Spirals(job)
    with watch.stage("what the job asks for"):
        feed, scallop, chord = _targets(stated, job.part.aimed, job.tool, job.machine, spirals)
    candidates: list[Candidate] = []
    for name, set_up in list(_strategies(job, stated, feed, scallop, chord, spirals)):
        with watch.stage(name) as update:
            candidates.append(_evaluate(name, set_up, job, spirals, candidates, update))
        if ready is not None:
            ready(candidates[-1])
    return Comparison(job=job, scallop=scallop, chord=chord, candidates=tuple(candidates))


class _Spirals:
    """The spirals of a comparison: several strategies share one, and its targets and step are those of others."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self.planned: dict[Strategy, Spiral] = {}

    def plan(self, servo: Strategy, progress: StageProgress | None = None) -> Pipeline:
        """Return the pipeline of a strategy with its spiral."""
        line = Pipeline(_with_strategy(self.job, servo), progress=progress)
        strategy = line.finishing.servo.spiral_strategy
        if strategy in self.planned:
            line.finishing.spiral = self.planned[strategy]
        self.planned[strategy] = line.spiral
        return line


def _targets(
    stated: Strategy, part: Part, tool: Tool, machine: Machine, spirals: _Spirals
) -> tuple[float, float, float]:
    """Return feed [mm/rev], scallop and chord error [mm] of the stated strategy."""
    if isinstance(stated, AdaptiveToolServo):
        return spirals.plan(replace(stated, x_motion="steady")).feed, stated.scallop, stated.chord
    plain = _plain(stated)
    spiral = spirals.plan(plain).spiral
    feed, nose = spiral.feed, tool.actual_radius
    # Where pieces meet in a valley that no nose reaches, the uncut material there would mask the cusps.
    cusp = nose - math.sqrt(nose**2 - feed**2 / 4) if part.surface.in_pieces else None
    chord: float | None = getattr(plain, "chord", None)
    if cusp is None or chord is None:
        contributions = break_down_error(part, tool, spiral, drive(place(spiral, part, tool), plain, machine))
        cusp = cusp or contributions.cusp_away_nm * 1e-6
        chord = chord or max(contributions.chord_nm, 0.1) * 1e-6
    return feed, cusp, chord


def _plain(stated: Strategy) -> Strategy:
    """Return the strategy of the spiral under a fast tool or under a quasi-elliptical motion."""
    if isinstance(stated, QuasiEllipticalToolServo):
        names = {one.name for one in fields(SlowToolServo)} & {one.name for one in fields(stated)}
        return SlowToolServo(**{name: getattr(stated, name) for name in names})
    return stated.spiral_strategy


def _strategies(
    job: Job, stated: Strategy, feed: float, scallop: float, chord: float, spirals: _Spirals
) -> Iterator[tuple[str, Callable[[], Strategy]]]:
    part, machine = job.part.aimed, job.machine
    linear = machine.controller.interpolation != "hermite"
    shared: dict[str, Any] = {
        name: getattr(stated, name) for name in ("spindle_rpm", "spindle_speeds", "sense", "inside_out")
    }
    if stated.spindle_mode is not None:  # its speed is not one of C as an axis
        shared["spindle_rpm"] = None
    plain = _plain(stated)
    ends: dict[str, Any] = {}
    if isinstance(plain, SlowToolServo):
        ends = {"lead_in": plain.lead_in, "overrun": min(plain.overrun, feed)}
    by_chord = SlowToolServo(feed=feed, chord=chord, **shared, **ends)

    @cache  # several strategies use it
    def even() -> SlowToolServo:
        """The spiral of constant angle with the smallest step of the spiral by chord."""
        steps = np.abs(np.diff(spirals.plan(by_chord).spiral.angle))
        # The last two steps of a plan by chord split the remaining angle, and may be short.
        least = float(np.quantile(steps, SHORT_STEP_FRACTION))
        return SlowToolServo(feed=feed, points_per_rev=max(math.ceil(TURN / least), 8), **shared, **ends)

    def adaptive(x_motion: Literal["servo", "steady"]) -> AdaptiveToolServo:
        return AdaptiveToolServo(
            scallop=scallop, chord=chord, interpolation="linear" if linear else "hermite", x_motion=x_motion, **shared
        )

    yield AS_IT_STANDS, lambda: stated
    yield "slow, constant angle", even
    yield "slow, points by chord", lambda: by_chord
    yield "adaptive points", lambda: adaptive("steady")
    yield "adaptive points and feed", lambda: adaptive("servo")
    if "W" in machine.axes:
        yield "fast", lambda: FastToolServo(plan=even())
        yield (
            "hybrid",
            lambda: HybridToolServo(plan=even(), fast=machine.axes["W"], blocks_per_rev=SLIDE_BLOCKS_PER_REV),
        )
    if "Y" in machine.axes and part.surface.in_pieces:

        def elliptical() -> QuasiEllipticalToolServo:
            if isinstance(stated, QuasiEllipticalToolServo):
                return stated
            shortest = MIN_ARC_RATIO * part.surface.feature_size
            points = even().points_per_rev
            return QuasiEllipticalToolServo(feed=feed, points_per_rev=points, short="skip", shortest=shortest, **shared)

        yield "quasi-elliptical", elliptical


def strategies_of(job: Job) -> list[str]:
    """Return the names of the strategies in the comparison of a job."""
    # None of them is set up, so feed, scallop and chord do not matter.
    return [name for name, _ in _strategies(job, job.servo(job.passes[-1]), 1.0, 1.0, 1.0, _Spirals(job))]


def _with_strategy(job: Job, servo: Strategy) -> Job:
    """Return a job with the finishing pass only, cut with a strategy, and with a fast tool table if it needs one."""
    last = job.passes[-1]
    freed: dict[str, Any] = dict.fromkeys(last.choices)
    alone = replace(last, depth=None, **freed)
    program = replace(
        job.program, fast_tool="position" if servo.moves_fast_tool else None, fast_tool_rate=None, name="part"
    )
    return replace(job, strategy=servo, passes=(alone,), program=program)


def _evaluate(
    name: str, set_up: Callable[[], Strategy], job: Job, spirals: _Spirals, done: list[Candidate], report: Progress
) -> Candidate:
    start = time.perf_counter()
    servo = None
    stages = ("plan", "place", "shares")  # each is a third of the progress bar

    def update(stage: str, done: int, total: int) -> None:
        if stage in stages:
            report(100 * stages.index(stage) + 99 * done // max(total, 1), 300)

    try:
        servo = set_up()
        if same := [one for one in done if one.servo == servo]:
            return replace(same[0], name=name)
        line = spirals.plan(servo, update)
        limits = check_limits(line.motion, job.machine)
        return Candidate(
            name=name, servo=servo, turns=line.spiral.turns, size_bytes=line.program.bytes, limits=limits,
            breakdown=line.breakdown, wall_s=time.perf_counter() - start,
        )  # fmt: skip
    except (Stopped, OSError):  # a full disk fails every strategy
        raise
    except TurnwrightError as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 - the other strategies are compared despite a defect in this one
        reason = (
            f"a defect of Turnwright, not of the job ({type(error).__name__}: {str(error)[:100]}): please report it"
        )
    return Candidate(name=name, servo=servo, refused=reason, wall_s=time.perf_counter() - start)
