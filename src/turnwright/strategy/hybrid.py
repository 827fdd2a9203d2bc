"""The hybrid tool servo: one path, with its slow part on the slide Z and its fast part on a fast tool."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NoReturn

import numpy as np

from turnwright._arrays import Floats, rounding
from turnwright._validate import instance_of, whole_number
from turnwright.errors import InputError
from turnwright.machine import Axis, Machine
from turnwright.part import Part
from turnwright.path import Path, Spiral
from turnwright.placing import Tips, touch_down
from turnwright.progress import Progress
from turnwright.strategy.base import Strategy
from turnwright.strategy.fast import OverPlan
from turnwright.strategy.split import find_smoothest
from turnwright.surface import Surface
from turnwright.tool import Tool
from turnwright.units import Count

__all__ = ["HybridToolServo"]


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridToolServo(OverPlan):
    r"""Hybrid tool servo: a fast tool on the axis W, carried by the slide Z; W and Z add up to the path.

    The tool is placed once, on the whole surface, and the motion is split afterwards. *By design*, Z follows the tip on
    the ``base`` alone, and W is the difference, with the middle of its range at 0. *Computed*, with the limits of the
    ``fast`` axis, Z is the motion of least jerk that keeps W within its travel, and within its speed and acceleration
    if the plan has a spindle speed. `check_limits` checks the bandwidth of W and Z.

    Parameters
    ----------
    plan
        The spiral, its points and the spindle speed: any strategy that moves C, X and Z.
    base
        The slow part of the surface.
    tool
        The tool that is placed on ``base``; in a job the tool of the job.
    fast
        The limits of the fast tool, ``machine.axes["W"]``, with both ends of its travel; in a job those of its machine.
    blocks_per_rev
        Least number of blocks of the lathe per revolution. Z then moves straight from one to the next, as with linear
        interpolation of the controller, W adds the difference, and the program of the lathe is short. If not set, Z is
        smooth and every point may be a block, see `Motion.lathe`.

    Raises
    ------
    InputError
        If ``fast`` is set with base or tool, the plan is not a strategy, or there are too few blocks.
    LimitError
        From `axes`: if no motion of Z keeps the limits.

    Sources
    -------
    [Kong2019]_ for the arrangement; it compensates both parts separately.
    """

    kind = "hybrid tool servo"
    example = MappingProxyType({"feed": "8 um/rev", "points_per_rev": 3600, "spindle_speed": "100 rpm"})
    hidden = ("tool", "fast")
    base: Surface | None = None
    tool: Tool | None = None
    fast: Axis | None = None
    blocks_per_rev: Count | None = None

    def __post_init__(self) -> None:
        OverPlan.__post_init__(self)
        # In a job, `on` adds tool and axis, so that they may be missing here.
        if self._split_fields not in ([], ["base"], ["base", "tool"], ["fast"]):
            self._raise_split_error()
        for name, kind in (("base", Surface), ("tool", Tool), ("fast", Axis)):
            value = getattr(self, name)
            if value is not None:
                instance_of(value, kind, name)
        if self.fast is not None and (self.fast.low is None or self.fast.high is None):
            raise InputError(
                f"the fast tool travels from {self.fast.low} to {self.fast.high} mm, both ends are needed to split a "
                "motion: set low and high"
            )
        if self.blocks_per_rev is not None:
            object.__setattr__(self, "blocks_per_rev", whole_number(self.blocks_per_rev, "blocks_per_rev", 8))

    @property
    def _split_fields(self) -> list[str]:
        return [name for name in ("base", "tool", "fast") if getattr(self, name) is not None]

    def _raise_split_error(self) -> NoReturn:
        raise InputError(
            f"the motion is split by {' and '.join(self._split_fields) or 'nothing'}, it needs base and tool, or fast "
            "alone: set the slow part of the surface, or the limits of the fast tool"
        )

    def adapted_to(self, tool: Tool, machine: Machine) -> Strategy:
        """Return the strategy with the tool for its base, or without a base with the limits of the machine's W axis."""
        plan = self.plan.adapted_to(tool, machine)
        if self.fast is not None:
            return replace(self, plan=plan)
        if self.base is not None:
            return replace(self, plan=plan, tool=self.tool or tool)
        if "W" not in machine.axes:
            raise InputError(
                f"a hybrid tool servo needs the limits of axis W, {machine.name} has "
                f"{', '.join(sorted(machine.axes))}: choose a machine with a fast tool"
            )
        return replace(self, plan=plan, fast=machine.axes["W"])

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral of the plan, or raise if neither base and tool nor fast is set."""
        if self._split_fields not in (["base", "tool"], ["fast"]):
            self._raise_split_error()
        return OverPlan.spiral(self, part, tool, progress=progress)

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: those of the plan, with its Z split into Z and W. [mm]."""
        axes = self._plan_axes(path)
        slow, _ = self._find_slow_motion(path, axes["Z"])
        if self.blocks_per_rev is not None:
            turned = np.abs(path.angle - path.angle[0])
            widest = float(np.diff(turned).max()) - rounding(path.angle)
            # A power of 2, so that every block of the shorter program is one of the points.
            stride = 2 ** max(math.floor(math.log2(2 * math.pi / self.blocks_per_rev / widest)), 0)
            blocks = np.append(np.arange(0, turned.size - 1, stride), turned.size - 1)
            slow = np.interp(turned, turned[blocks], slow[blocks])
        return {**axes, "Z": slow, "W": axes["Z"] - slow}

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivatives by the angle of these axes, ``None`` if the path has none or Z has corners."""
        rates = self.plan.rates(path)
        if rates is None or self.blocks_per_rev is not None:
            return None
        _, slow = self._find_slow_motion(path, self.plan.axes(path)["Z"])
        return {**rates, "Z": slow, "W": rates["Z"] - slow}

    def _find_slow_motion(self, path: Path, tip: Floats) -> tuple[Floats, Floats]:
        """Return the height of the slide and its derivative by the angle. (n,) [mm], (n,) [mm/rad]."""
        if self.base is None or self.tool is None:
            omega = None if self.spindle_rpm is None else self.spindle_rpm * 2 * math.pi / 60
            turned = np.abs(path.angle - path.angle[0])
            z, rate = find_smoothest(turned, tip, self.fast, omega)  # type: ignore[arg-type]
            return z, path.sense * rate
        rim = float(np.abs(path.radius).max())
        tips = Tips.at(path.angle, path.radius, path.y)
        at = touch_down(self.base, self.tool.cutting_edge(path.sense), tips, rim)
        fast_height = tip - at.z
        z = at.z + (fast_height.min() + fast_height.max()) / 2
        zx, zy = self.base.gradient(at.x, at.y)
        # The derivative of the maximum is that of the surface under the contact, which moves with the tip.
        rate = at.x * zy - at.y * zx
        cosine, sine = np.cos(path.angle), np.sin(path.angle)
        if path.radius_rate is not None:
            rate = rate + path.radius_rate * (zx * cosine + zy * sine)
        if path.y_rate is not None:
            rate = rate + path.y_rate * (zy * cosine - zx * sine)
        return z, rate
