"""Choose feed, points and spindle speed so that a part meets its tolerances, and verify it by simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path as File
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeAlias

from turnwright.errors import JobError, LimitError, Stopped, TurnwrightError
from turnwright.generation import generate_polar
from turnwright.job.contributions import (
    ErrorBreakdown,
    break_down_error,
    exact_cusps,
    exact_motion,
    finish_nm,
    has_servos,
    max_difference_nm,
    without_servos,
)
from turnwright.job.cusps import Feeds, cusp_light
from turnwright.job.interpolation import interpolate_motion
from turnwright.job.pass_plan import PassPlan
from turnwright.job.predicting import predict
from turnwright.job.programs import read_back, write_programs
from turnwright.job.schema import Job
from turnwright.job.speed import NEAR, ROUNDS, Servos, at_speed, few_lines, guess, largest, round_down
from turnwright.job.tables import with_interpolation
from turnwright.job.verdict import Verdict, any_missed, judge
from turnwright.motion import Limits, check_limits, drive
from turnwright.path import Motion, Spiral
from turnwright.progress import StageProgress
from turnwright.speed_profile import SpeedProfile
from turnwright.units import write

__all__ = ["Plan", "Trial", "plan", "stage_of"]

ReportFraction: TypeAlias = Callable[[float], None]
"""Called with the completed fraction of some work."""

TURN = 2 * math.pi
NM = 1e6
CUSP_SQ_RATIO = math.sqrt(4 / 45)

SPIRAL_POINTS_PER_REV = 72
"""Points per revolution of a spiral of which only the radii are used."""

CUSP_SHARE = 0.5
"""Largest share of the form tolerance for the cusps: the cycle time varies with the inverse root of their height, and
with the inverse root of the share that remains for points and servos."""

SQ_SHARE = 0.9
"""Share of the finish tolerance for the cusps, added in quadrature to that of the points."""

CHORD_SQ_RATIO = 0.3
"""Ratio of the Sq from the points to their chord error, for parabolas that do not line up between revolutions."""

DECIMALS_MM = 2e-6
"""Largest error from the decimals of the program; the simulation measures it. [mm]"""

MAX_PROOFS = 4
"""Plans that are simulated, each with larger shares than the one before."""

MAX_TARGETS = 4
"""Plans with a lower target each time, while the evaluated error exceeds the planned one."""

MARGIN = 0.97
"""Fraction of a tolerance used as target, since a simulation can find slightly more."""

POINT_SHARES = (0.9, 0.6, 0.4, 0.25, 0.15)
"""Shares of the residual after the cusps that are tried for the points; the servos get the remainder."""

MAX_POINTS = 10_000_000
"""Most points of a plan; more do not fit in memory or in minutes of search."""

MAX_STEP_RAD = math.radians(15)
"""Largest angle between points at a constant arc length, which does not limit the angle near the axis. [rad]"""

RETRY_FRACTION = 0.15
"""Approximate fraction of plans that miss a tolerance and need a lower target, for the progress."""

CUSP_FRACTION = 0.1
"""Approximate fraction of the work for the largest feed, for the progress."""

PROGRESS_STEPS = 1000
FIRST_POINTS_PER_FEATURE = 6
"""Points per feature of the surface at which the search for fewer points begins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """The best plan with one of the interpolations of the controller.

    Parameters
    ----------
    interpolation
        Name of the interpolation.
    points, minutes
        Number of points and cycle time of the fastest plan that meets the tolerances.
    refused
        Why there is no such plan, in a sentence; empty if there is one.
    """

    interpolation: str
    points: int = 0
    minutes: float = math.nan
    refused: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """The chosen strategy, and the simulated result.

    Parameters
    ----------
    job
        The job with its strategy filled in.
    breakdown
        Error contributions to the form error of the program read back, with interpolation and servos.
    verdicts
        Verdict on each tolerance, as in a run.
    limits
        Speed, acceleration and jerk of the axes against the limits of the machine.
    tried
        The best plan with each interpolation; the fastest was chosen.
    """

    job: Job
    breakdown: ErrorBreakdown
    verdicts: tuple[Verdict, ...]
    limits: Limits
    tried: tuple[Trial, ...]


def plan(job: Job, *, progress: StageProgress | None = None) -> Plan:
    r"""Choose feed, points, interpolation and spindle speed for the finishing pass.

    The feed, or the scallop of an adaptive tool servo, is the largest whose cusps stay within the finish tolerance and
    half of the form tolerance. The residual of the form tolerance, after cusps and decimals of the program, is split
    between the points (chord error) and the servos (tracking error). Several splits are planned, each at the highest
    speed within the limits of the machine and its share. The fastest plan is written, read back and simulated. The
    contributions do not all peak at the same point, so the plan may stay well within the tolerances: then the shares
    are increased until the simulated error uses the tolerances up.

    Every interpolation of the controller is tried, unless the job states one. The fastest plan is chosen; of plans with
    about the same cycle time, the one with fewer points.

    A machine with variable speed and without servo data varies its speed by itself. With servo data, the highest
    constant speed is searched for. If the machine can vary it, so is a speed over the radius with which every ring uses
    up its share; the faster plan is chosen. With ``precorrect`` the speed is that of the precorrected motion, within
    the limits of the machine.

    Feed, points and speed of the job's strategy are replaced; everything else stays.

    Parameters
    ----------
    job
        A job that states both tolerances.
    progress
        Called with (stage, done, total).

    Raises
    ------
    JobError
        If a tolerance is not stated, or the strategy does not set its points by a chord, or turns in spindle mode.
    LimitError
        If no plan meets them.
    """
    form, sq = job.tolerances.form_pv, job.tolerances.sq
    if form is None or sq is None:
        raise JobError("a plan needs tolerances.form_pv and tolerances.sq, the job does not state both: add them")
    if not hasattr(job.strategy.spiral_strategy, "chord"):
        raise JobError(f"a plan needs a strategy with a chord, the {job.strategy.kind} has none: choose another kind")
    if job.strategy.spindle_mode is not None:
        raise JobError(
            "plan chooses the speed of C as an axis, this job turns in spindle mode: state its feed and speed; cusps "
            "are feed² / 8 nose_radius high"
        )
    report = progress or (lambda _stage, _done, _total: None)
    controller = job.machine.controller
    stated = controller.interpolation
    others = tuple(controller.other_interpolations)
    plans: list[Plan] = []
    tried: list[Trial] = []
    first_error: TurnwrightError | None = None
    for name in (stated, *others):
        try:
            machine = job.machine if name == stated else with_interpolation(job.machine, name)
            best = _plan_interpolation(replace(job, machine=machine), form, sq, report)
        except Stopped:
            raise
        except TurnwrightError as error:
            first_error = first_error or error
            tried.append(Trial(interpolation=name, refused=str(error)))
            continue
        plans.append(best)
        tried.append(Trial(interpolation=name, points=best.limits.points, minutes=best.limits.cycle_time_s / 60))
    if first_error is not None and not plans:
        raise first_error
    least = min(one.limits.cycle_time_s for one in plans)
    alike = [one for one in plans if one.limits.cycle_time_s <= least / NEAR]  # the resolution of the searches
    return replace(min(alike, key=lambda one: one.limits.points), tried=tuple(tried))


def stage_of(interpolation: str) -> str:
    """Return the name of the stage of a plan that tries an interpolation."""
    return f"points, speed and verification, {interpolation}"


def _plan_interpolation(job: Job, form: float, sq: float, report: StageProgress) -> Plan:
    """Return the fastest plan that meets the tolerances [mm], with the interpolation of the job."""
    stage = stage_of(job.machine.controller.interpolation)

    def update(share: float) -> None:
        report(stage, round(share * PROGRESS_STEPS), PROGRESS_STEPS)

    order = job.tolerances.cusp_order
    target = {"form_pv": form, "sq": sq, "cusp_order": math.inf if order is None else order.max}
    update(0.0)
    for number in range(MAX_TARGETS):
        span = 1 - RETRY_FRACTION**number, 1 - RETRY_FRACTION ** (number + 1)
        best = _plan_target(job, target, _report_range(update, *span))
        if not any_missed(best.verdicts):
            update(1.0)
            return best
        # A patch may be rougher than the rings that the feed is chosen by.
        for name in target:
            over = [(one.value or 0.0) / one.limit for one in best.verdicts if one.tolerance == name]
            target[name] *= MARGIN / max(over) if max(over) > 1 else 1.0
    raise LimitError(
        f"the plan misses a tolerance: {'; '.join(one.sentence for one in best.verdicts if not one.is_kept)}; form "
        f"error of {best.breakdown.sentence}: relax the tolerance, or change tool or machine"
    )


def _report_range(update: ReportFraction, first: float, last: float) -> ReportFraction:
    """Return a function that reports the progress of a part of the work, from one fraction to another."""
    return lambda share: update(first + (last - first) * share)


def _plan_target(job: Job, target: Mapping[str, float], update: ReportFraction) -> Plan:
    """Return the fastest plan for targets of the tolerances [mm, 1]; it may miss the tolerances."""
    form, sq = target["form_pv"], target["sq"]
    across, cusp = _largest_feed(job, form, sq, target["cusp_order"])
    update(CUSP_FRACTION)
    # Errors of points and servos have both signs.
    residual = (MARGIN * form - cusp - DECIMALS_MM) / 2
    if residual <= 0:
        raise LimitError(
            f"cusps of {cusp * NM:.3g} nm and the decimals of the program use up form_pv {form * NM:.3g} nm: relax it, "
            "or use a larger nose_radius"
        )
    search = _Search(job, across, MARGIN * sq * math.sqrt(1 - SQ_SHARE**2) / CHORD_SQ_RATIO)
    best: Plan | None = None
    within, beyond = 0.0, math.inf  # residuals that meet the tolerances, and that miss them
    for number in range(MAX_PROOFS):
        # About half of the simulated plans are followed by another.
        span = (1 - (1 - CUSP_FRACTION) * 0.5**one for one in (number, number + 1))
        simulated = search.simulate(residual, _report_range(update, *span))
        if any_missed(simulated.verdicts):
            if best is None:
                return simulated
            beyond = residual
        else:
            if best is not None and simulated.limits.cycle_time_s > NEAR * best.limits.cycle_time_s:
                best = min(best, simulated, key=lambda one: one.limits.cycle_time_s)
                break
            best, within = simulated, residual
        more = min(
            (MARGIN * form * NM - best.breakdown.cusp_nm) / max(best.breakdown.pv_nm - best.breakdown.cusp_nm, 1e-3),
            3.0,
        )
        if more < 1 / NEAR or beyond < within / NEAR:
            break
        residual = min(within * more, math.sqrt(within * beyond))
    assert best is not None  # noqa: S101 - the loop finds a plan or returns the first
    return best


class _Search:
    """Search for points and speed of a job at a feed or scallop ``across``.

    ``roughest`` is the largest chord error that the finish allows. [mm]
    """

    def __init__(self, job: Job, across: float, roughest: float) -> None:
        self.job, self.across, self.roughest = job, across, roughest
        self.part, self.tool, machine = job.part.aimed, job.tool, job.machine
        self.simulates_servos, self.corrected = has_servos(machine), job.program.precorrect
        self.varies = machine.controller.variable_speed
        self.machine = machine
        if self.simulates_servos:
            self.machine = replace(machine, controller=replace(machine.controller, variable_speed=False))
        self.servos: Servos | None = None
        # Cubics follow the curvature of the path, so that steps can have a constant length.
        self.evenly = machine.controller.interpolation == "hermite" and hasattr(
            job.strategy.spiral_strategy, "arc_length"
        )
        self.evenly &= not job.strategy.moves_fast_tool
        self.spacings: list[tuple[float, float]] = []  # (chord or arc length, measured error of the points) [mm]

    def simulate(self, residual: float, update: ReportFraction) -> Plan:
        """Return the fastest plan whose points and servos share the residual [mm], simulated from its program."""
        best: tuple[_Points, Motion, float] | None = None
        update(0.0)
        splits = POINT_SHARES if self.simulates_servos else (1.0,)
        for share in sorted({min(split * residual, self.roughest) for split in splits}, reverse=True):
            points = self._points(share)
            motion, tracking = points.plan.planned, residual - share
            update(0.3)
            if self.simulates_servos:
                self.servos = self.servos or Servos(
                    self.part, self.tool, self.machine, spiral=points.plan.spiral, corrected=self.corrected
                )
                motion = self.servos.constant(points.plan.planned, tracking)
            if best is not None and motion.time[-1] >= best[1].time[-1]:
                break
            best = points, motion, tracking
        assert best is not None  # noqa: S101 - there is at least one split
        update(0.5)
        points, nominal, tracking = best
        speed: float | SpeedProfile | None = None
        if self.simulates_servos or not self.varies:
            peak_rpm = check_limits(nominal, self.machine).peak_speed["C"] * (60 / TURN)  # the mean includes the ramps
            speed = round_down(peak_rpm)
            nominal = at_speed(nominal, speed / peak_rpm)
            if nominal.velocity is not None:  # at a lower speed the ramps are shorter
                stated = _fill_in(self.job, self.across, points.ways, speed)
                nominal = drive(points.plan.path, stated.servo(stated.passes[-1]), self.machine)
        if self.servos is not None and self.varies:
            variable = self.servos.varied(points.plan.path, points.plan.servo, self.job.machine, tracking, nominal)
            if variable is not None and variable[1].time[-1] < nominal.time[-1]:
                speed, nominal = variable
        motion = nominal if self.servos is None else self.servos.commanded(nominal)
        update(0.6)
        filled = points.filled
        with TemporaryDirectory(prefix="turnwright-") as folder:
            program_motion = read_back(
                filled, write_programs(filled, {"finish": motion}, File(folder)).files[0], "finish"
            )
        update(0.7)
        final = _fill_in(filled, self.across, points.ways, speed)
        reference = nominal if self.corrected else None
        predictions = predict(final, program_motion, nominal=reference)
        update(0.9)
        return Plan(
            job=final,
            breakdown=break_down_error(
                self.part, self.tool, points.plan.spiral, motion, program_motion=program_motion, nominal=reference,
                pv_nm=predictions[0].pv_nm,
            ),
            verdicts=judge(final, predictions),
            limits=check_limits(motion, self.machine),
            tried=(),
        )  # fmt: skip

    def _points(self, share: float) -> _Points:
        """Return the fewest points whose error, after interpolation by the controller, is within a share [mm]."""
        if self.machine.controller.interpolation == "linear" or self.job.strategy.moves_fast_tool:
            return self._place(round_down(share))  # their error is the chord error
        first = guess(self.spacings, share)
        if not math.isfinite(first):
            size = min(self.part.surface.feature_size, self.part.reach)
            first = size / FIRST_POINTS_PER_FEATURE if self.evenly else share
        tried: dict[float, _Points] = {}

        def error_of(spacing: float) -> float:
            for other, points in tried.items():
                if (expected := points.plan.spiral.angle.size * other / spacing) > MAX_POINTS and other >= spacing:
                    raise LimitError(
                        f"a path within {share * NM:.3g} nm needs {expected:.2g} points, the limit of a plan is "
                        f"{MAX_POINTS:.0e}: relax form_pv, or allow another interpolation"
                    )
            points = tried[spacing] = self._place(round_down(spacing))
            self.spacings.append((spacing, self._point_error(points)))
            return self.spacings[-1][1]

        spacing = largest(error_of, share, first, self.part.reach)
        if not spacing:
            nearest, smallest = min(
                ((one, off) for one, off in self.spacings if one in tried), key=lambda both: both[1]
            )
            raise LimitError(
                f"the controller of {self.machine.name} cannot follow the path within {share * NM:.3g} nm: "
                f"{tried[nearest].plan.spiral.angle.size} points at {write(round_down(nearest), 'mm')} leave "
                f"{smallest * NM:.3g} nm: relax form_pv"
            )
        return tried[spacing]

    def _point_error(self, points: _Points) -> float:
        """Return the difference between the surfaces of the exact and of the interpolated path. [mm]."""
        radius, angle = few_lines(self.part, points.plan.spiral.feed, points.plan.spiral.angle)
        exact = exact_motion(points.plan.spiral, self.part, self.tool, self.machine, angle)
        real = interpolate_motion(points.plan.planned, without_servos(self.machine, corrected=self.corrected))
        maps = [generate_polar(one, self.tool, radius=radius, angle=angle) for one in (exact, real)]
        return max_difference_nm(*maps) / NM

    def _place(self, spacing: float) -> _Points:
        """Return points at a chord or an arc length [mm], in motion at the highest speed within the limits."""
        ways = {"arc_length": spacing, "max_step": MAX_STEP_RAD} if self.evenly else {"chord": spacing}
        filled = _fill_in(self.job, self.across, ways)
        return _Points(ways, filled, PassPlan(replace(filled, machine=self.machine)))


class _Points(NamedTuple):
    """Keys that set the points, the job with them, and its plan at the highest speed within the limits."""

    ways: dict[str, float]
    filled: Job
    plan: PassPlan


def _key(job: Job) -> tuple[str, str]:
    return ("scallop", "mm") if hasattr(job.strategy.spiral_strategy, "scallop") else ("feed", "mm/rev")


def _fill_in(job: Job, across: float, ways: Mapping[str, float], speed: float | SpeedProfile | None = None) -> Job:
    last, (key, _) = job.passes[-1], _key(job)
    freed: dict[str, Any] = dict.fromkeys(last.choices.keys() - {"lead_in"})
    several = isinstance(speed, SpeedProfile)
    strategy = job.strategy.with_fields(
        **{key: across, **ways}, **{"spindle_speeds" if several else "spindle_rpm": speed}
    )
    simulation = job.simulation
    if has_servos(job.actual_machine):  # the plan simulates them, so must a run
        simulation = replace(simulation, tracking=True)
    passes = (*job.passes[:-1], replace(last, **freed))
    return replace(job, strategy=strategy, passes=passes, simulation=simulation)


def _order_share(job: Job, spiral: Spiral, most: float) -> float:
    """Return the height of the cusps over that which keeps the tolerance of their diffraction orders."""
    limit = job.tolerances.cusp_order
    if limit is None:
        return 0.0
    light = cusp_light(job, Feeds.of_spiral(job, spiral), limit.light)
    # On shallow cusps the light in an order is proportional to the square of their height.
    return math.sqrt(light.brightest / (MARGIN * most))


def _largest_feed(job: Job, form: float, sq: float, order: float) -> tuple[float, float]:
    """Return the largest feed or scallop whose cusps keep their share of both tolerances, and their height [mm]."""
    part, tool, machine = job.part.aimed, job.tool, job.machine
    pv_limit, sq_limit = CUSP_SHARE * MARGIN * form, SQ_SHARE * MARGIN * sq
    scallop = _key(job)[0] == "scallop"
    across = min(pv_limit, sq_limit / CUSP_SQ_RATIO)
    if not scallop:
        across = math.sqrt(8 * tool.actual_radius * across)
    for _ in range(ROUNDS):
        filled = _fill_in(job, across, {"chord": pv_limit} if scallop else {"points_per_rev": SPIRAL_POINTS_PER_REV})
        spiral = PassPlan(filled).spiral
        error, pv_nm = exact_cusps(spiral, part, tool, machine)
        pv, finish = pv_nm / NM, finish_nm(error, spiral.feed) / NM
        share = max(pv / pv_limit, finish / sq_limit, _order_share(filled, spiral, order))
        if NEAR <= share <= 1:
            return round_down(across), pv
        # The cusp height is proportional to the square of the feed.
        across *= ((1 + NEAR) / 2 / share) ** (1.0 if scallop else 0.5)
    name, unit = _key(job)
    also = f" and cusp_order {order:.3g}" if math.isfinite(order) else ""
    raise LimitError(
        f"no {name} meets form_pv {form * NM:.3g} nm and sq {sq * NM:.3g} nm{also}: at "
        f"{write(round_down(across), unit)} the exact path leaves {pv * NM:.3g} nm and {finish * NM:.3g} nm, which are "
        "not from cusps: use a smaller "
        "nose_radius"
    )
