"""The fast tool servo: spindle and slides in steady motion, the tool on a short axis of its own."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from turnwright._tables import Merged
from turnwright._validate import check_numbers
from turnwright.errors import InputError
from turnwright.strategy.base import Strategy
from turnwright.strategy.slow import SlowToolServo

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Path, Spiral
    from turnwright.progress import Progress
    from turnwright.speed_profile import SpeedProfile
    from turnwright.tool import Tool

__all__ = ["FastToolServo", "OverPlan"]

STEADY = 1e-9
"""How far the radius may be from a steady advance. [mm]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class OverPlan(Strategy):
    """A fast tool over the plan of another strategy, which says where it is sent and how fast the spindle turns.

    Parameters
    ----------
    plan
        The spiral, its points and the spindle speed.
    """

    key_names = MappingProxyType({})
    plan: Annotated[Strategy, Merged(SlowToolServo)]

    def __post_init__(self) -> None:
        check_numbers(self)
        if not isinstance(self.plan, Strategy):
            raise InputError(f"the plan is {self.plan!r}, which is not a strategy: give a SlowToolServo for instance")

    @property
    def spindle_rpm(self) -> float | None:  # type: ignore[override] # a field of the plan
        """Spindle speed of the plan. [rev/min]."""
        return self.plan.spindle_rpm

    @property
    def spindle_speeds(self) -> SpeedProfile | None:  # type: ignore[override]
        """Spindle speed of the plan over the radius."""
        return self.plan.spindle_speeds

    @property
    def sense(self) -> int:  # type: ignore[override]
        """Sense of the plan."""
        return self.plan.sense

    @property
    def inside_out(self) -> bool:  # type: ignore[override]
        """Whether the plan goes from the centre to the rim."""
        return self.plan.inside_out

    @property
    def along(self) -> Literal["z", "normal"]:  # type: ignore[override]
        """How the tool is placed on the plan."""
        return self.plan.along

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool takes its own table of heights."""
        return True

    @property
    def lays_out(self) -> Strategy:
        """The strategy that sets spiral and points."""
        return self.plan.lays_out

    def stating(self, **stated: Any) -> Strategy:
        """Return the strategy with some fields of its own, or of its plan, as a pass states them."""
        own = {one.name for one in fields(self)}
        plan = self.plan.stating(**{name: value for name, value in stated.items() if name not in own})
        return replace(self, plan=plan, **{name: value for name, value in stated.items() if name in own})

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral of the plan."""
        return self.plan.spiral(part, tool, progress=progress)

    def glimpse(self, part: Part, tool: Tool, *, turns: int, per_turn: int) -> Spiral:
        """Return some of the points of the spiral of the plan."""
        return self.plan.glimpse(part, tool, turns=turns, per_turn=per_turn)

    def extent(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> tuple[int, Spiral]:
        """Return the size of the spiral of the plan, and its ends."""
        return self.plan.extent(part, tool, progress=progress)

    def _planned(self, path: Path) -> dict[str, Floats]:
        """Return the axes of the plan.

        Raises
        ------
        InputError
            If it moves a fast tool itself.
        """
        axes = self.plan.axes(path)
        if "W" in axes:
            raise InputError(
                f"the plan is a {type(self.plan).__name__}, which moves W itself: give the plan that it has"
            )
        return axes


@dataclass(frozen=True, slots=True, kw_only=True)
class FastToolServo(OverPlan):
    """Spindle and X in steady motion, Z standing still, all height made by a fast tool on the axis W.

    Z stands so that W uses the middle of its stroke; W adds to Z. The lathe then needs a few blocks a turn however
    dense the points of the tool are, see `Motion.lathe` and `write_fast_tool`.

    Parameters
    ----------
    plan
        The spiral, its points and the spindle speed: a `SlowToolServo`, or another strategy whose X advances steadily.

    Raises
    ------
    InputError
        If the plan is not a strategy; of `axes`, if its X does not advance steadily, as along the normal, or it moves a
        fast tool itself.

    Sources
    -------
    The arrangement of the fast tools that lathe makers offer, see the machine files. Between two points the tool goes
    straight, so that a plan by a chord is one for linear interpolation.

    >>> from turnwright.strategy.slow import SlowToolServo
    >>> servo = FastToolServo(plan=SlowToolServo(feed=0.01, spindle_rpm=200, points_per_rev=3600))
    >>> servo.spindle_rpm
    200
    """

    kind = "fast tool servo"
    example = MappingProxyType({"feed": "8 um/rev", "points_per_rev": 3600, "spindle_speed": "100 rpm"})

    def on(self, tool: Tool, machine: Machine) -> Strategy:
        """Return the strategy with what its plan takes from tool and machine."""
        return replace(self, plan=self.plan.on(tool, machine))

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: those of the plan with Z at rest [mm], and W all the rest [mm]."""
        axes = self._planned(path)
        ends = axes["C"][[0, -1]]
        steady = np.interp(axes["C"] * path.sense, ends * path.sense, axes["X"][[0, -1]])
        off = float(np.abs(axes["X"] - steady).max())
        if off > STEADY:
            raise InputError(
                f"X is up to {off:.3g} mm from a steady advance, the limit is {STEADY:g} mm, since beside a fast tool "
                "the slides do not follow the part: place along z a spiral of constant feed"
            )
        tip = axes["Z"]
        z = np.full(tip.size, (tip.min() + tip.max()) / 2)
        return {**axes, "Z": z, "W": tip - z}

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivatives by the angle of these axes, or ``None`` if the path states none."""
        rates = self.plan.rates(path)
        return None if rates is None else {**rates, "Z": np.zeros(path.z.size), "W": rates["Z"]}
