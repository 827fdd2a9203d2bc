"""Choose feed, points and spindle speed so that a part keeps its tolerances, and prove it by simulation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as File
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeAlias

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
from turnwright.job.interpolated import interpolated
from turnwright.job.named import with_interpolation
from turnwright.job.pass_plan import PassPlan
from turnwright.job.predicting import predict
from turnwright.job.programs import read_back, written
from turnwright.job.speed import NEAR, ROUNDS, Servos, at_speed, few_lines, guess, largest, plain
from turnwright.job.verdict import Verdict, judge, missed
from turnwright.motion import Limits, check_limits, drive
from turnwright.speed_profile import SpeedProfile
from turnwright.units import write

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright.job.schema import Job
    from turnwright.path import Motion, Path, Spiral
    from turnwright.progress import StageProgress
    from turnwright.strategy import Strategy

__all__ = ["Plan", "Trial", "plan", "stage_of"]

Share: TypeAlias = Callable[[float], None]
"""Called with the share of some work that is done."""

TURN = 2 * math.pi
NM = 1e6
CUSP_SQ = math.sqrt(4 / 45)
"""Sq of round cusps over their height."""

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

AIMS = 4
"""Plans that aim lower each time, while what is judged is more than what was planned for."""

ROOM = 0.97
"""Share of a tolerance that is planned for; what a simulation then finds may be a little more."""

SPLITS = (0.9, 0.6, 0.4, 0.25, 0.15)
"""Parts of what the cusps leave that are tried for the points; the servos get the rest."""

MOST_POINTS = 10_000_000
"""Points of a plan that is searched for; beyond this no search of minutes holds it in memory."""

WIDEST = math.radians(15)
"""Largest step of points at even distances, which near the axis say nothing of the angle."""

AGAIN = 0.15
"""Share of the plans that miss what is judged and aim lower, about."""

CUSPS = 0.1
"""Share of the work that the largest feed takes, about."""

FINE = 1000
"""Parts of the work that progress is told in."""

FEW = 6
"""Points to a feature of the surface that a search for fewer begins with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What one of the interpolations that the controller offers makes of the tolerances.

    Parameters
    ----------
    interpolation
        Which one.
    points, minutes
        Of the quickest plan found that keeps the tolerances.
    refused
        Why there is none, in a sentence; empty if there is.
    """

    interpolation: str
    points: int = 0
    minutes: float = math.nan
    refused: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """What was chosen, and what comes of it.

    Parameters
    ----------
    job
        The job with its strategy filled in.
    shares
        Where the form error comes from, of the program read back, with interpolation and servos.
    verdicts
        Which tolerances it keeps, as a run judges them.
    limits
        What the program asks of the machine.
    tried
        What each interpolation that was tried would do; the quickest was taken.
    """

    job: Job
    shares: ErrorBreakdown
    verdicts: tuple[Verdict, ...]
    limits: Limits
    tried: tuple[Trial, ...]


def plan(job: Job, *, progress: StageProgress | None = None) -> Plan:
    r"""Choose feed, points, interpolation and spindle speed for the finishing pass.

    The feed, or the scallop of an adaptive tool servo, is the largest whose cusps keep the finish tolerance, and half
    of the form tolerance. What the cusps and the program's decimals leave of the form tolerance is split between the
    points (chord) and the servos (tracking):
    several splits are planned, each at the highest speed that keeps both the machine's limits and its share, and the
    quickest is written, read back and simulated whole. Since not all shares meet in one place it may keep the
    tolerances with room to spare: then the shares grow, until the proof uses the tolerances up.

    Every interpolation that the controller offers is tried, unless the job asks for one itself. The quickest plan is
    taken; where minutes are alike, that of fewer points.

    A machine that may vary its speed, and states no servos, is left to do so. With servos one speed is sought, and, if
    the machine may vary it, a speed over the radius that lets every ring use up its share; the quicker is taken. A job
    that says ``precorrect`` gets its speed for the corrected motion, within the limits of the machine.

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
    if not hasattr(job.strategy.lays_out, "chord"):
        raise JobError(f"a plan sets a chord, which the {job.strategy.kind} does not have: choose another kind")
    report = progress or (lambda _stage, _done, _total: None)
    controller = job.machine.controller
    own = controller.interpolation
    others = tuple(controller.other_interpolations)
    plans: list[Plan] = []
    tried: list[Trial] = []
    why: TurnwrightError | None = None
    for name in (own, *others):
        try:
            found = _planned(job if name == own else _asking(job, name), form, sq, report)
        except Stopped:
            raise
        except TurnwrightError as error:
            why = why or error
            tried.append(Trial(interpolation=name, refused=str(error)))
            continue
        plans.append(found)
        tried.append(Trial(interpolation=name, points=found.limits.points, minutes=found.limits.cycle_time_s / 60))
    if why is not None and not plans:
        raise why
    least = min(one.limits.cycle_time_s for one in plans)
    alike = [one for one in plans if one.limits.cycle_time_s <= least / NEAR]  # no search here is finer
    return replace(min(alike, key=lambda one: one.limits.points), tried=tuple(tried))


def stage_of(interpolation: str) -> str:
    """Return what the stage of a plan is called that tries an interpolation."""
    return f"points, speed and proof, {interpolation}"


def _asking(job: Job, interpolation: str) -> Job:
    """Return the job with its controller asked for another interpolation."""
    return replace(job, machine=with_interpolation(job.machine, interpolation))


def _planned(job: Job, form: float, sq: float, report: StageProgress) -> Plan:
    """Return the quickest plan that keeps the tolerances [mm], with the interpolation that the job has."""
    stage = stage_of(job.machine.controller.interpolation)

    def tell(share: float) -> None:
        report(stage, round(share * FINE), FINE)

    aim = {"form_pv": form, "sq": sq}
    tell(0.0)
    for number in range(AIMS):
        span = 1 - AGAIN**number, 1 - AGAIN ** (number + 1)
        found = _aimed(job, aim["form_pv"], aim["sq"], _between(tell, *span))
        if not missed(found.verdicts):
            tell(1.0)
            return found
        # What is judged in a patch may be rougher than the rings that the feed is chosen by.
        for name in aim:
            over = [(one.value_nm or 0.0) / one.limit_nm for one in found.verdicts if one.tolerance == name]
            aim[name] *= ROOM / max(over) if max(over) > 1 else 1.0
    raise LimitError(
        f"the plan misses a tolerance: {'; '.join(one.sentence for one in found.verdicts if not one.kept)}; form error "
        f"of {found.shares.sentence}: allow more, or change tool or machine"
    )


def _between(tell: Share, first: float, last: float) -> Share:
    """Return who is told the progress of a part of some work, from one share of it to another."""
    return lambda share: tell(first + (last - first) * share)


def _aimed(job: Job, form: float, sq: float, tell: Share) -> Plan:
    """Return the quickest plan of those that aim at a form error and a finish [mm]; it may miss the tolerances."""
    across, cusp = _across(job, form, sq)
    tell(CUSPS)
    # Points and servos err to both sides.
    left = (ROOM * form - cusp - DECIMALS) / 2
    if left <= 0:
        raise LimitError(
            f"cusps of {cusp * NM:.3g} nm and the program's decimals leave nothing of form_pv {form * NM:.3g} nm: "
            "allow more, or take a larger nose_radius"
        )
    search = _Search(job, across, ROOM * sq * math.sqrt(1 - SQ_SHARE**2) / CHORD_SQ)
    kept: Plan | None = None
    within, beyond = 0.0, math.inf  # shares that keep the tolerances, and that do not
    for number in range(PROOFS):
        # Half of the plans that are proved are followed by another.
        span = (1 - (1 - CUSPS) * 0.5**one for one in (number, number + 1))
        proved = search.proved(left, _between(tell, *span))
        if missed(proved.verdicts):
            if kept is None:
                return proved
            beyond = left
        else:
            if kept is not None and proved.limits.cycle_time_s > NEAR * kept.limits.cycle_time_s:
                kept = min(kept, proved, key=lambda one: one.limits.cycle_time_s)
                break
            kept, within = proved, left
        more = min((ROOM * form * NM - kept.shares.cusp_nm) / max(kept.shares.pv_nm - kept.shares.cusp_nm, 1e-3), 3.0)
        if more < 1 / NEAR or beyond < within / NEAR:
            break
        left = min(within * more, math.sqrt(within * beyond))
    assert kept is not None  # noqa: S101 - the loop keeps a plan or returns the first
    return kept


class _Search:
    """What is known of a job while its points and its speed are sought.

    Parameters
    ----------
    job
        What is asked for.
    across
        The feed or the scallop. [mm]
    roughest
        What the points may add, for the sake of the finish. [mm]
    """

    def __init__(self, job: Job, across: float, roughest: float) -> None:
        self.job, self.across, self.roughest = job, across, roughest
        self.part, self.tool, machine = job.part.aimed, job.tool, job.machine
        self.answers, self.corrected = has_servos(machine), job.program.precorrect
        self.varies = machine.controller.variable_speed
        self.machine = machine
        if self.answers:
            self.machine = replace(machine, controller=replace(machine.controller, variable_speed=False))
        self.servos: Servos | None = None
        # Cubics bend with the path, so that steps may be as long where it does; by chord they are longest where not.
        self.evenly = machine.controller.interpolation == "hermite" and hasattr(job.strategy.lays_out, "arc_length")
        self.evenly &= not job.strategy.moves_fast_tool
        self.spacings: list[tuple[float, float]] = []  # (chord or arc length, what the points really add) [mm]

    def proved(self, left: float, tell: Share) -> Plan:
        """Return the quickest plan whose points and servos share what is left [mm], proved by its own program."""
        best: tuple[_Points, Motion, float] | None = None
        tell(0.0)
        splits = SPLITS if self.answers else (1.0,)
        for share in sorted({min(split * left, self.roughest) for split in splits}, reverse=True):
            points = self._points(share)
            motion, rest = points.top, left - share
            tell(0.3)
            if self.answers:
                self.servos = self.servos or Servos(
                    self.part, self.tool, self.machine, spiral=points.spiral, corrected=self.corrected
                )
                motion = self.servos.constant(points.top, rest)
            if best is not None and motion.time[-1] >= best[1].time[-1]:
                break
            best = points, motion, rest
        assert best is not None  # noqa: S101 - there is at least one split
        tell(0.5)
        points, meant, rest = best
        speed: float | SpeedProfile | None = None
        if self.answers or not self.varies:
            turning = check_limits(meant, self.machine).peak_speed["C"] * (60 / TURN)  # not the mean with both ends
            speed = plain(turning)
            meant = at_speed(meant, speed / turning)
            if meant.velocity is not None:  # at a lower speed it comes there and to rest in less time
                stated = _filled(self.job, self.across, points.ways, speed)
                meant = drive(points.path, stated.servo(stated.passes[-1]), self.machine)
        if self.servos is not None and self.varies:
            found = self.servos.varied(points.path, points.servo, self.job.machine, rest, meant)
            if found is not None and found[1].time[-1] < meant.time[-1]:
                speed, meant = found
        motion = meant if self.servos is None else self.servos.commanded(meant)
        tell(0.6)
        filled = points.filled
        with TemporaryDirectory(prefix="turnwright-") as folder:
            again = read_back(filled, written(filled, {"finish": motion}, File(folder)).files[0], "finish")
        tell(0.7)
        final, aimed = _filled(filled, self.across, points.ways, speed), meant if self.corrected else None
        predictions = predict(final, again, meant=aimed)
        tell(0.9)
        return Plan(
            job=final,
            shares=break_down_error(
                self.part, self.tool, points.spiral, motion, again=again, meant=aimed, pv_nm=predictions[0].pv_nm
            ),
            verdicts=judge(final, predictions),
            limits=check_limits(motion, self.machine),
            tried=(),
        )

    def _points(self, share: float) -> _Points:
        """Return the fewest points that add no more than a share [mm], by what the controller makes of them."""
        if self.machine.controller.interpolation == "linear" or self.job.strategy.moves_fast_tool:
            return self._placed(plain(share))  # what a chord is
        first = guess(self.spacings, share)
        if not math.isfinite(first):
            size = min(self.part.surface.feature_size, self.part.radius)
            first = size / FEW if self.evenly else share
        tried: dict[float, _Points] = {}

        def added(spacing: float) -> float:
            for other, points in tried.items():
                if (foreseen := points.spiral.angle.size * other / spacing) > MOST_POINTS and other >= spacing:
                    raise LimitError(
                        f"points that keep within {share * NM:.3g} nm of the path would be {foreseen:.2g}, the limit "
                        f"of a plan is {MOST_POINTS:.0e}: allow more form_pv, or another interpolation"
                    )
            points = tried[spacing] = self._placed(plain(spacing))
            self.spacings.append((spacing, self._added(points)))
            return self.spacings[-1][1]

        found = largest(added, share, first, self.part.radius)
        if not found:
            nearest, left = min(((one, off) for one, off in self.spacings if one in tried), key=lambda both: both[1])
            raise LimitError(
                f"no points let the controller of {self.machine.name} keep within {share * NM:.3g} nm of the path: "
                f"{tried[nearest].spiral.angle.size} points at {write(plain(nearest), 'mm')} leave {left * NM:.3g} nm; "
                "allow more form_pv"
            )
        return tried[found]

    def _added(self, points: _Points) -> float:
        """Return how far the surface of an exact path is from that of the controller's. [mm]."""
        radius, angle = few_lines(self.part, points.spiral.feed, points.spiral.angle)
        exact = exact_motion(points.spiral, self.part, self.tool, self.machine, angle)
        made = interpolated(points.top, without_servos(self.machine, corrected=self.corrected))
        maps = [generate_polar(one, self.tool, radius=radius, angle=angle) for one in (exact, made)]
        return max_difference_nm(*maps) / NM

    def _placed(self, spacing: float) -> _Points:
        """Return points at a chord, or at an arc length [mm], at the highest speed within the limits."""
        ways = {"arc_length": spacing, "max_step": WIDEST} if self.evenly else {"chord": spacing}
        filled = _filled(self.job, self.across, ways)
        plan = PassPlan(replace(filled, machine=self.machine))
        return _Points(ways=ways, filled=filled, servo=plan.servo, spiral=plan.spiral, path=plan.path, top=plan.wanted)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Points:
    """Points by what sets them, placed, and in motion at the highest speed within the limits."""

    ways: dict[str, float]
    filled: Job
    servo: Strategy
    spiral: Spiral
    path: Path
    top: Motion


def _key(job: Job) -> tuple[str, str]:
    """Return what sets the height of the cusps, and its unit."""
    return ("scallop", "mm") if hasattr(job.strategy.lays_out, "scallop") else ("feed", "mm/rev")


def _filled(job: Job, across: float, ways: Mapping[str, float], speed: float | SpeedProfile | None = None) -> Job:
    """Return the job with what was chosen, and nothing that it said itself of feed, points and speed."""
    last, (key, _) = job.passes[-1], _key(job)
    freed: dict[str, Any] = dict.fromkeys(last.choices.keys() - {"lead_in"})
    several = isinstance(speed, SpeedProfile)
    strategy = job.strategy.stating(**{key: across, **ways}, **{"spindle_speeds" if several else "spindle_rpm": speed})
    simulation = job.simulation
    if has_servos(job.actual_machine):  # they count in the proof, so they do in a run
        simulation = replace(simulation, tracking=True)
    return replace(
        job,
        strategy=strategy,
        passes=(*job.passes[:-1], replace(last, **freed)),
        simulation=simulation,
    )


def _across(job: Job, form: float, sq: float) -> tuple[float, float]:
    """Return the largest feed or scallop whose cusps keep their share of both tolerances, and their height [mm]."""
    part, tool, machine = job.part.aimed, job.tool, job.machine
    pv_limit, sq_limit = CUSP_SHARE * ROOM * form, SQ_SHARE * ROOM * sq
    scallop = _key(job)[0] == "scallop"
    across = min(pv_limit, sq_limit / CUSP_SQ)
    if not scallop:
        across = math.sqrt(8 * tool.actual_radius * across)
    for _ in range(ROUNDS):
        filled = _filled(job, across, {"chord": pv_limit} if scallop else {"points_per_rev": FEWEST})
        spiral = PassPlan(filled).spiral
        error, pv_nm = exact_cusps(spiral, part, tool, machine)
        pv, finish = pv_nm / NM, finish_nm(error, spiral.feed) / NM
        share = max(pv / pv_limit, finish / sq_limit)
        if NEAR <= share <= 1:
            return plain(across), pv
        # Cusps grow with the square of the feed.
        across *= ((1 + NEAR) / 2 / share) ** (1.0 if scallop else 0.5)
    name, unit = _key(job)
    raise LimitError(
        f"no {name} keeps form_pv {form * NM:.3g} nm and sq {sq * NM:.3g} nm: at {write(plain(across), unit)} the "
        f"exact path leaves {pv * NM:.3g} nm and {finish * NM:.3g} nm, so what it leaves is not cusps; take a smaller "
        "nose_radius"
    )
