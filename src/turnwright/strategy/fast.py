"""The fast tool servo: spindle and slides in steady motion, the tool on a separate axis of short stroke."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from turnwright._arrays import Floats
from turnwright._tables import Merged
from turnwright._validate import check_numbers, instance_of
from turnwright.errors import InputError
from turnwright.machine import Machine
from turnwright.part import Part
from turnwright.path import Path, Spiral
from turnwright.progress import Progress
from turnwright.strategy.base import Strategy
from turnwright.strategy.slow import SlowToolServo
from turnwright.tool import Tool

__all__ = ["FastToolServo", "OverPlan"]

STEADY_TOL_MM = 1e-9
"""Largest deviation of the radius from a steady advance."""


def _of_plan(text: str, name: str) -> Any:
    return property(lambda servo: getattr(servo.plan, name), doc=text)


@dataclass(frozen=True, slots=True, kw_only=True)
class OverPlan(Strategy):
    """A fast tool on the plan of another strategy, which sets the spiral and the spindle speed.

    Parameters
    ----------
    plan
        The spiral, its points and the spindle speed.
    """

    key_names = MappingProxyType({})
    plan: Annotated[Strategy, Merged(SlowToolServo)]

    def __post_init__(self) -> None:
        check_numbers(self)
        instance_of(self.plan, Strategy, "plan")

    spindle_rpm = _of_plan("Spindle speed of the plan. [rev/min].", "spindle_rpm")
    spindle_speeds = _of_plan("Spindle speed of the plan over the radius.", "spindle_speeds")
    sense = _of_plan("Sense of rotation of the plan.", "sense")
    inside_out = _of_plan("Whether the plan goes from the centre to the rim.", "inside_out")
    along = _of_plan("Direction in which the tool of the plan is placed.", "along")

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool is driven by a separate table of heights."""
        return True

    @property
    def spiral_strategy(self) -> Strategy:
        """The strategy that sets spiral and points."""
        return self.plan.spiral_strategy

    def with_fields(self, **stated: Any) -> Strategy:
        """Return the strategy with some fields replaced, its own or those of its plan, as a pass states them."""
        own_fields = {one.name for one in fields(self)}
        plan = self.plan.with_fields(**{name: value for name, value in stated.items() if name not in own_fields})
        return replace(self, plan=plan, **{name: value for name, value in stated.items() if name in own_fields})

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral of the plan."""
        return self.plan.spiral(part, tool, progress=progress)

    def preview_spiral(self, part: Part, tool: Tool, *, turns: int, per_turn: int) -> Spiral:
        """Return some of the points of the spiral of the plan."""
        return self.plan.preview_spiral(part, tool, turns=turns, per_turn=per_turn)

    def extent(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> tuple[int, Spiral]:
        """Return the number of points of the spiral of the plan, and its ends."""
        return self.plan.extent(part, tool, progress=progress)

    def _plan_axes(self, path: Path) -> dict[str, Floats]:
        axes = self.plan.axes(path)
        if "W" in axes:
            raise InputError(f"the plan is a {type(self.plan).__name__}, which moves W itself: use its plan")
        return axes


@dataclass(frozen=True, slots=True, kw_only=True)
class FastToolServo(OverPlan):
    """Fast tool servo: spindle and X in steady motion, Z at rest, the whole height on a fast tool, the axis W.

    Z is set so that W uses the middle of its stroke; W adds to Z. The lathe then needs only a few blocks per
    revolution, however dense the points of the tool are, see `Motion.lathe` and `write_fast_tool`.

    Parameters
    ----------
    plan
        The spiral, its points and the spindle speed: a `SlowToolServo`, or another strategy whose X advances steadily.

    Raises
    ------
    InputError
        If the plan is not a strategy. From `axes`: if X of the plan does not advance steadily (as along the normal), or
        the plan moves a fast tool itself.

    Sources
    -------
    The arrangement is that of the fast tools that lathe makers offer, see the machine files. The tool moves in straight
    lines between points, so that a plan by chord is one for linear interpolation.

    >>> from turnwright.strategy.slow import SlowToolServo
    >>> servo = FastToolServo(plan=SlowToolServo(feed=0.01, spindle_rpm=200, points_per_rev=3600))
    >>> servo.spindle_rpm
    200
    """

    kind = "fast tool servo"
    example = MappingProxyType({"feed": "8 um/rev", "points_per_rev": 3600, "spindle_speed": "100 rpm"})

    def adapted_to(self, tool: Tool, machine: Machine) -> Strategy:
        """Return the strategy with what its plan takes from tool and machine."""
        return replace(self, plan=self.plan.adapted_to(tool, machine))

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: those of the plan, with Z at rest and the height on W. [mm]."""
        axes = self._plan_axes(path)
        ends = axes["C"][[0, -1]]
        steady = np.interp(axes["C"] * path.sense, ends * path.sense, axes["X"][[0, -1]])
        off = float(np.abs(axes["X"] - steady).max())
        if off > STEADY_TOL_MM:
            raise InputError(
                f"X is up to {off:.3g} mm from a steady advance, the limit is {STEADY_TOL_MM:g} mm, since with a fast "
                "tool the slides do not follow the part: place a spiral of constant feed along z"
            )
        tip = axes["Z"]
        z = np.full(tip.size, (tip.min() + tip.max()) / 2)
        return {**axes, "Z": z, "W": tip - z}

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivatives by the angle of these axes, or ``None`` if the path has none."""
        rates = self.plan.rates(path)
        return None if rates is None else {**rates, "Z": np.zeros(path.z.size), "W": rates["Z"]}
