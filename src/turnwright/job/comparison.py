"""One part, one tool, one machine, one cusp and one chord: every strategy that the machine can do, side by side."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from turnwright._tables import written
from turnwright.errors import Stopped, TurnwrightError
from turnwright.job.contributions import ErrorBreakdown, break_down_error
from turnwright.job.pipeline import Pipeline
from turnwright.motion import Limits, check_limits, drive
from turnwright.placing import place
from turnwright.strategy import (
    AdaptiveToolServo,
    FastToolServo,
    HybridToolServo,
    QuasiEllipticalToolServo,
    SlowToolServo,
    Strategy,
)

if TYPE_CHECKING:
    from turnwright.job.schema import Job
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.progress import StageProgress
    from turnwright.tool import Tool

__all__ = ["Candidate", "Comparison", "compare", "strategies_of"]

TURN = 2 * math.pi

AS_IT_STANDS = "the job as it stands"
"""What the job's own strategy is called next to the others."""

FEW = 1e-4
"""Share of the steps of a plan by chord that may be shorter than those of the plan at a constant angle."""

BLOCKS = 360
"""Blocks of the slide in a turn under a fast tool, which has its own table."""

SHORTEST = 0.5
"""Arc between valleys, over the feature size of the surface, below which the quasi-elliptical servo skips one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A strategy that was tried.

    Parameters
    ----------
    name
        What it is.
    servo
        The strategy; ``None`` if it could not be set up.
    refused
        Why it is out of the question, in a sentence; empty if it is not, and then the rest is there.
    turns
        Of the spindle.
    size_bytes
        Of all files of its program.
    limits
        What it asks of the machine.
    shares
        Where its form error comes from, of the program read back, with interpolation and servos.
    wall_s
        Time that it took to plan, write, read back and simulate. [s]
    """

    name: str
    servo: Strategy | None = None
    refused: str = ""
    turns: float = math.nan
    size_bytes: int = 0
    limits: Limits | None = None
    shares: ErrorBreakdown | None = None
    wall_s: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """What the strategies make of a job.

    Parameters
    ----------
    job
        The job compared for.
    scallop, chord
        Height of cusps and of chords that all of them were planned to keep. [mm]
    candidates
        One for each strategy.
    """

    job: Job
    scallop: float
    chord: float
    candidates: tuple[Candidate, ...]

    def stated(self, candidate: Candidate) -> dict[str, Any]:
        """Return a strategy as the table ``strategy`` of a job file states it; empty if it could not be set up.

        Parameters
        ----------
        candidate
            One of `candidates`.
        """
        if candidate.name == AS_IT_STANDS:
            return written(self.job.strategy)
        if candidate.servo is None:
            return {}
        # The slide under a fast tool follows what the limits of that tool leave to it, as the job file finds by itself.
        return written(candidate.servo)


def compare(job: Job, *, progress: StageProgress | None = None) -> Comparison:
    """Plan the finishing pass by every strategy, to the same cusps and the same chord, and simulate what each leaves.

    The first is the job as it stands, with its own points, feed and speeds.
    An adaptive job says both itself. Of any other, the cusps are the highest that its own feed leaves away from the
    axis (those of a flat, where the surface is in pieces, since no nose reaches its valleys), and the chord is the one
    it states, or the largest that its points leave. Strategies of constant feed keep the job's feed, or, in an adaptive
    job, take the largest that keeps the scallop; slow, fast and hybrid servos keep its lead-in and its overrun, too.
    Each turns at the job's spindle speed or speeds, or at the highest within all limits if it states none.

    Parameters
    ----------
    job
        Part, tool, machine and strategy.
    progress
        Called with (stage, done, total).
    """
    report = progress or (lambda _stage, _done, _total: None)
    part, tool, machine = job.part.aimed, job.tool, job.machine
    own = job.servo(job.passes[-1])
    report("what the job asks for", 0, 1)
    feed, scallop, chord = _asked(own, part, tool, machine)
    report("what the job asks for", 1, 1)
    ways = list(_ways(job, own, feed, scallop, chord))
    candidates = []
    for name, way in ways:
        report(name, 0, 1)
        candidates.append(_tried(name, way, job, report))
        report(name, 1, 1)
    return Comparison(job=job, scallop=scallop, chord=chord, candidates=tuple(candidates))


def _asked(own: Strategy, part: Part, tool: Tool, machine: Machine) -> tuple[float, float, float]:
    """Return the feed [mm/rev], the scallop and the chord [mm] that a strategy stands for."""
    if isinstance(own, AdaptiveToolServo):
        spiral = replace(own, x_motion="steady").spiral(part, tool)
        return spiral.feed, own.scallop, own.chord
    plain = _plain(own)
    spiral = plain.spiral(part, tool)
    feed, nose = spiral.feed, tool.actual_radius
    # Where pieces meet in a valley that no nose reaches, what stays there would hide the cusps.
    cusp = nose - math.sqrt(nose**2 - feed**2 / 4) if part.surface.in_pieces else None
    chord: float | None = getattr(plain, "chord", None)
    if cusp is None or chord is None:
        found = break_down_error(part, tool, spiral, drive(place(spiral, part, tool), plain, machine))
        cusp = cusp or found.cusp_away_nm * 1e-6
        chord = chord or max(found.chord_nm, 0.1) * 1e-6
    return feed, cusp, chord


def _plain(own: Strategy) -> Strategy:
    """Return the spiral that a fast or a swinging tool goes by."""
    if isinstance(own, QuasiEllipticalToolServo):
        names = {one.name for one in fields(SlowToolServo)} & {one.name for one in fields(own)}
        return SlowToolServo(**{name: getattr(own, name) for name in names})
    return own.lays_out


def _ways(
    job: Job, own: Strategy, feed: float, scallop: float, chord: float
) -> Iterator[tuple[str, Callable[[], Strategy]]]:
    """Yield every strategy by its name, to be set up when its turn comes."""
    part, tool, machine = job.part.aimed, job.tool, job.machine
    linear = machine.controller.interpolation != "hermite"
    shared: dict[str, Any] = {
        name: getattr(own, name) for name in ("spindle_rpm", "spindle_speeds", "sense", "inside_out")
    }
    plain = _plain(own)
    ends: dict[str, Any] = {}
    if isinstance(plain, SlowToolServo):
        ends = {"lead_in": plain.lead_in, "overrun": min(plain.overrun, feed)}
    by_chord = SlowToolServo(feed=feed, chord=chord, **shared, **ends)

    @cache  # several strategies go by it
    def even() -> SlowToolServo:
        """The spiral of constant angle that keeps the chord: at its tightest place like the one by chord."""
        steps = np.abs(np.diff(by_chord.spiral(part, tool).angle))
        # The last two steps of a plan by chord share what is left, and may be short.
        least = float(np.quantile(steps, FEW))
        return SlowToolServo(feed=feed, points_per_rev=max(math.ceil(TURN / least), 8), **shared, **ends)

    def adaptive(x_motion: Literal["servo", "steady"]) -> AdaptiveToolServo:
        return AdaptiveToolServo(
            scallop=scallop, chord=chord, interpolation="linear" if linear else "hermite", x_motion=x_motion, **shared
        )

    yield AS_IT_STANDS, lambda: own
    yield "slow, constant angle", even
    yield "slow, points by chord", lambda: by_chord
    yield "adaptive points", lambda: adaptive("steady")
    yield "adaptive points and feed", lambda: adaptive("servo")
    if "W" in machine.axes:
        yield "fast", lambda: FastToolServo(plan=even())
        yield "hybrid", lambda: HybridToolServo(plan=even(), fast=machine.axes["W"], blocks_per_rev=BLOCKS)
    if "Y" in machine.axes and part.surface.in_pieces:

        def elliptical() -> QuasiEllipticalToolServo:
            if isinstance(own, QuasiEllipticalToolServo):
                return own
            shortest = SHORTEST * part.surface.feature_size
            turns = even().points_per_rev
            return QuasiEllipticalToolServo(feed=feed, points_per_rev=turns, short="skip", shortest=shortest, **shared)

        yield "quasi-elliptical", elliptical


def strategies_of(job: Job) -> list[str]:
    """Return the names of the strategies that a job is compared by."""
    # None of them is set up, so that neither feed nor heights count.
    return [name for name, _ in _ways(job, job.servo(job.passes[-1]), 1.0, 1.0, 1.0)]


def _stating(job: Job, servo: Strategy) -> Job:
    """Return the job of a strategy: its finishing pass alone, with a table of heights where that moves a fast tool."""
    last = job.passes[-1]
    freed: dict[str, Any] = dict.fromkeys(last.choices)
    alone = replace(last, depth=None, **freed)
    program = replace(
        job.program, fast_tool="position" if servo.moves_fast_tool else None, fast_tool_rate=None, name="part"
    )
    return replace(job, strategy=servo, passes=(alone,), program=program)


def _tried(name: str, way: Callable[[], Strategy], job: Job, report: StageProgress) -> Candidate:
    """Return what a strategy makes of a part, or why it does not."""
    start = time.perf_counter()
    servo = None
    stages = ("plan", "place", "shares")  # each a third of the bar

    def told(stage: str, done: int, total: int) -> None:
        if stage in stages:
            report(name, 100 * stages.index(stage) + 99 * done // max(total, 1), 300)

    try:
        servo = way()
        line = Pipeline(_stating(job, servo), progress=told)
        limits = check_limits(line.motion, job.machine)
        return Candidate(
            name=name,
            servo=servo,
            turns=line.spiral.turns,
            size_bytes=line.program.bytes,
            limits=limits,
            shares=line.shares,
            wall_s=time.perf_counter() - start,
        )
    except (Stopped, OSError):  # a full disk fails every strategy
        raise
    except TurnwrightError as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 - the page of the other strategies outlives a defect in this one
        reason = (
            f"a defect of Turnwright, not of the job ({type(error).__name__}: {str(error)[:100]}): please report it"
        )
    return Candidate(name=name, servo=servo, refused=reason, wall_s=time.perf_counter() - start)
