"""The stages of a job one at a time, each carried out when it is first asked for, and once."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

from turnwright.access import check_access
from turnwright.errors import InputError
from turnwright.job.cutting import chips_of
from turnwright.job.pass_plan import PassPlan, plan_pass
from turnwright.job.result import Pass
from turnwright.job.running import GOUGE, WHOLE, judge_depths, predict, repeated
from turnwright.job.window import can_be_parted, predict_parted
from turnwright.motion import check_limits

if TYPE_CHECKING:
    from collections.abc import Iterator

    from turnwright.access import Access
    from turnwright.job.cutting import PassChips
    from turnwright.job.result import Prediction
    from turnwright.job.schema import Job, PassTable
    from turnwright.motion import Limits
    from turnwright.part import Part
    from turnwright.path import Motion, Path
    from turnwright.tool import Tool

__all__ = ["Pipeline"]


@lru_cache(maxsize=8)
def _access(part: Part, tool: Tool, sense: int) -> Access:
    """Return the access of a tool; cases that differ in feed and speed share it."""
    return check_access(part, tool, sense=sense)


class Pipeline:
    """What becomes of a job, stage by stage: each is carried out when it is first asked for, and kept.

    Unlike `run` it writes no program, and refuses nothing: what `run` would refuse is in `refused`. A place on the part
    is predicted from its own share of the finishing pass where that leaves the same surface (a spiral placed along z,
    straight lines between its points, no servos), so that the roughness of a patch costs a small part of a whole
    path.

    Parameters
    ----------
    job
        What is asked for.

    Examples
    --------
    >>> from turnwright.job import Job
    >>> job = Job.read({
    ...     "part": {"surface": {"family": "plane"}, "radius": "2 mm"},
    ...     "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    ...     "machine": {"name": "generic"},
    ...     "strategy": {
    ...         "kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 360, "spindle_speed": "100 rpm",
    ...     },
    ...     "simulation": {
    ...         "patches": [
    ...             {"name": "rim", "centre": ["1 mm", "0 mm"], "size": ["0.1 mm", "0.1 mm"], "pixel": "0.37 um"},
    ...         ],
    ...     },
    ... })
    >>> stages = Pipeline(job)
    >>> f"{stages.prediction('rim').roughness.sq_nm:.2f} nm in {stages.minutes:.1f} minutes"
    '7.48 nm in 2.0 minutes'
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self._predictions: dict[str, Prediction] = {}

    @cached_property
    def access(self) -> Access:
        """Whether the tool reaches the part."""
        return _access(self.job.part.aimed, self.job.tool, self.job.strategy.sense)

    @cached_property
    def _finishing(self) -> PassPlan:
        return plan_pass(self.job, self.job.passes[-1])

    @property
    def feed(self) -> float:
        """Mean advance per revolution of the finishing pass. [mm/rev]."""
        return self._finishing.feed

    @property
    def path(self) -> Path:
        """Where the tool stands in the finishing pass."""
        return self._finishing.path

    @property
    def motion(self) -> Motion:
        """What the finishing pass commands the axes."""
        return self._finishing.commanded

    def _repetitions(self) -> Iterator[tuple[PassTable, float, tuple[str, float, float, Motion]]]:
        """Yield every pass with its feed and, for each repetition, its name, depth, what it leaves, and its motion."""
        stock = self.job.part.stock
        for cut in self.job.passes:
            last = cut is self.job.passes[-1]
            feed, _, motion, _ = self._finishing if last else plan_pass(self.job, cut)
            for one in repeated(cut, motion, stock):
                yield cut, feed, one
            stock = cut.allowance

    @cached_property
    def passes(self) -> tuple[Pass, ...]:
        """All passes in the order of cutting, with what they ask of the axes; their chips are in `chips`."""
        found = []
        for _, feed, (name, depth, left, motion) in self._repetitions():
            limits = check_limits(motion, self.job.machine)
            found.append(
                Pass(
                    name=name, allowance=left, depth=depth, feed=feed, spindle_rpm=limits.spindle_rpm,
                    points=limits.points, limits=limits,
                )
            )  # fmt: skip
        return tuple(found)

    @property
    def limits(self) -> Limits:
        """What the finishing pass asks of the axes."""
        return self.passes[-1].limits

    @property
    def minutes(self) -> float:
        """Time of all passes. [min]."""
        return sum(one.limits.cycle_time_s for one in self.passes) / 60

    @cached_property
    def chips(self) -> tuple[PassChips, ...]:
        """The chips of every pass, in the order of cutting.

        Raises
        ------
        InputError
            If nothing is known of the material, or it is not known what the first pass cuts.
        """
        known = self.job.part.substance
        if known is None or (known.critical is None and known.cutting is None):
            raise InputError(
                "the job names no material, so its chips and forces are not found: state part.material, one of "
                "turnwright material list or the file of one"
            )
        found: list[PassChips] = []
        before: Motion | None = None
        for _, _, (_, _, left, motion) in self._repetitions():
            one = chips_of(self.job, motion, before, left, lambda _done, _total: None)
            if isinstance(one, str):
                raise InputError(one)
            found.append(one[0])
            before = motion
        return tuple(found)

    def prediction(self, name: str) -> Prediction:
        """Predict what a patch, or the "whole part", will look like.

        Parameters
        ----------
        name
            Of the patch, or "whole part".
        """
        if name not in self._predictions:
            self._predictions[name] = self._predicted(name)
        return self._predictions[name]

    @cached_property
    def form_pv_nm(self) -> float:
        """Form error of the whole part, from its highest to its lowest place."""
        known = self._predictions.get(WHOLE)
        if known is None or known.form is None:
            _ = self._finishing  # the places between the azimuths of the map count too
            self._predictions[WHOLE] = known = self._predicted(WHOLE)
        return known.pv_nm

    def _predicted(self, name: str) -> Prediction:
        known = [WHOLE, *(patch.name for patch in self.job.simulation.patches)]
        if name not in known:
            raise InputError(f"the job has no patch {name!r}, it predicts {', '.join(known)}: name one of them")
        if "_finishing" not in self.__dict__ and can_be_parted(self.job):
            found = predict_parted(self.job, name)
            if found is not None:
                return found
        _, _, motion, meant = self._finishing
        return predict(self.job, motion, meant=meant, only=(name,))[0]

    @property
    def refused(self) -> tuple[str, ...]:
        """Why `run` would refuse the job, a sentence each; of the stages that were carried out, and of access.

        What the job accepts is not among it.
        """
        accepted, found = self.job.accept, []
        found += [one.sentence for one in self.access.findings if not one.ok and one.name not in accepted]
        if not found:
            found += [one.sentence for one in judge_depths(self.job) if not one.ok]
        if "_finishing" in self.__dict__ and "gouge" not in accepted:
            least = float(self.path.clearance.min())
            if least < -GOUGE:
                found.append(
                    f"placed along the {self.job.strategy.along}, the edge cuts {-least * 1e6:.3g} nm below the surface"
                )
        if "passes" in self.__dict__ and "limits" not in accepted:
            found += [f"pass {one.name}: {said}" for one in self.passes for said in one.limits.findings]
        return tuple(found)
