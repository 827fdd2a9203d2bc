"""The hybrid tool servo: one path, its slow share on the slide Z and its fast share on a fast tool."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from turnwright._arrays import rounding
from turnwright._validate import whole as whole_number
from turnwright.errors import InputError
from turnwright.machine import Axis
from turnwright.placing import touch
from turnwright.strategy.fast import OverPlan
from turnwright.strategy.split import smoothest
from turnwright.surface import Surface
from turnwright.tool import Tool
from turnwright.units import Count

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Path, Spiral
    from turnwright.progress import Progress
    from turnwright.strategy.base import Strategy

__all__ = ["HybridToolServo"]


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridToolServo(OverPlan):
    r"""A fast tool on the axis W that rides on the slide Z: together they stand where the path says.

    The tool is placed once, on the whole surface. To compensate the nose on a base and on its lenses apart and to add
    the heights errs, with the slopes :math:`s_1` and :math:`s_2` of both along the radius, by about :math:`R s_1 s_2`,
    tens of nanometres. Only then is the motion split, in one of two ways.

    *By design*: Z follows the tip on the ``base`` alone, as if there were no lenses, and W is the rest, with the middle
    of its range at 0.

    *Found*, with the limits of the ``fast`` axis: Z is the motion of least jerk that keeps W within its travel, and
    within its speed and acceleration if the plan states a spindle speed. Where no limit binds, Z takes what is slower
    than a turn, see `turnwright.strategy.split`. The bandwidth is not for the split to keep: whatever is faster than a
    slide could follow is on W either way. `check_limits` judges it, as it does Z.

    Parameters
    ----------
    plan
        The spiral, its points and the spindle speed: any strategy that moves C, X and Z.
    base
        The slow share of the surface.
    tool
        The tool that is placed on it, with ``base`` only; in a job that of the job.
    fast
        The limits of the fast tool, ``machine.axes["W"]``, with both ends of its travel; in a job those of its machine.
    blocks_per_rev
        Blocks of the lathe in a turn, at least: Z then moves straight from one to the next, as a controller with linear
        interpolation moves it, W takes what that leaves, and the program of the lathe is as short. If not given, Z is
        smooth and every point may be a block, see `Motion.lathe`.

    Raises
    ------
    InputError
        If it is both base or tool and fast; if the plan is not a strategy, or the blocks are too few.
    LimitError
        Of `axes`, if no motion of Z keeps the limits.

    Sources
    -------
    [Kong2019]_ for the arrangement, with both parts compensated apart.
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
        # In a job tool and axis come with `on`, so that either may be missing here, but nothing may be too much.
        if self._given not in ([], ["base"], ["base", "tool"], ["fast"]):
            self._refuse()
        for name, kind in (("base", Surface), ("tool", Tool), ("fast", Axis)):
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise InputError(f"{name} is {value!r}, which is no {kind.__name__}: give one")
        if self.fast is not None and (self.fast.low is None or self.fast.high is None):
            raise InputError(
                f"the fast tool travels from {self.fast.low} to {self.fast.high} mm, both ends are needed to split a "
                "motion: state low and high"
            )
        if self.blocks_per_rev is not None:
            object.__setattr__(self, "blocks_per_rev", whole_number(self.blocks_per_rev, "blocks_per_rev", 8))

    @property
    def _given(self) -> list[str]:
        return [name for name in ("base", "tool", "fast") if getattr(self, name) is not None]

    def _refuse(self) -> NoReturn:
        raise InputError(
            f"the motion is split by {' and '.join(self._given) or 'nothing'}, it takes base and tool, or fast alone: "
            "give the slow share of the surface, or the limits of the fast tool"
        )

    def on(self, tool: Tool, machine: Machine) -> Strategy:
        """Return the strategy with the tool that is placed on its base, else with the limits of the machine's W axis.

        Raises
        ------
        InputError
            If it has no base, and the machine no W axis.
        """
        plan = self.plan.on(tool, machine)
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
        """Return the spiral of the plan.

        Raises
        ------
        InputError
            If nothing says how the motion is split.
        """
        if self._given not in (["base", "tool"], ["fast"]):
            self._refuse()
        return OverPlan.spiral(self, part, tool, progress=progress)

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: those of the plan, with its Z split into Z and W. [mm]."""
        axes = self._planned(path)
        slow, _ = self._slow(path, axes["Z"])
        if self.blocks_per_rev is not None:
            turned = np.abs(path.angle - path.angle[0])
            widest = float(np.diff(turned).max()) - rounding(path.angle)
            # By halves, so that every block of the shorter program is found again among the points.
            stride = 2 ** max(math.floor(math.log2(2 * math.pi / self.blocks_per_rev / widest)), 0)
            blocks = np.append(np.arange(0, turned.size - 1, stride), turned.size - 1)
            slow = np.interp(turned, turned[blocks], slow[blocks])
        return {**axes, "Z": slow, "W": axes["Z"] - slow}

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivatives by the angle of these axes, or ``None`` if the path or a Z with corners has none."""
        rates = self.plan.rates(path)
        if rates is None or self.blocks_per_rev is not None:
            return None
        _, slow = self._slow(path, self.plan.axes(path)["Z"])
        return {**rates, "Z": slow, "W": rates["Z"] - slow}

    def _slow(self, path: Path, tip: Floats) -> tuple[Floats, Floats]:
        """Return the height of the slide and its derivative by the angle. (n,) [mm], (n,) [mm/rad]."""
        if self.base is None or self.tool is None:
            omega = None if self.spindle_rpm is None else self.spindle_rpm * 2 * math.pi / 60
            turned = np.abs(path.angle - path.angle[0])
            z, rate = smoothest(turned, tip, self.fast, omega)  # type: ignore[arg-type]
            return z, path.sense * rate
        rim = float(np.abs(path.radius).max())
        at = touch(self.base, self.tool, angle=path.angle, radius=path.radius, y=path.y, sense=path.sense, rim=rim)
        rest = tip - at.z
        z = at.z + (rest.min() + rest.max()) / 2
        zx, zy = self.base.gradient(at.x, at.y)
        # The height of a maximum changes as the surface does under the contact, which moves with the tip.
        rate = at.x * zy - at.y * zx
        cosine, sine = np.cos(path.angle), np.sin(path.angle)
        if path.radius_rate is not None:
            rate = rate + path.radius_rate * (zx * cosine + zy * sine)
        if path.y_rate is not None:
            rate = rate + path.y_rate * (zy * cosine - zx * sine)
        return z, rate
