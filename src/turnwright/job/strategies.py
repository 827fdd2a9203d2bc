"""The strategies of a job file: a table for each way of cutting, chosen by the key ``kind``."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from annotated_types import MinLen
from pydantic import Field

from turnwright._tables import types_of
from turnwright._validate import check_numbers
from turnwright.errors import JobError
from turnwright.job.table import Table
from turnwright.motion import SpeedProfile
from turnwright.strategy import (
    AdaptiveToolServo,
    FastToolServo,
    HybridToolServo,
    QuasiEllipticalToolServo,
    SlowToolServo,
)
from turnwright.surface import Surface
from turnwright.units import Count, Feed, Flag, Size, Speed, Step, Thickness, unit

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.strategy import (
        AdaptiveToolServo,
        FastToolServo,
        HybridToolServo,
        QuasiEllipticalToolServo,
        SlowToolServo,
        Strategy,
    )
    from turnwright.tool import Tool

__all__ = ["KINDS", "AnyStrategy", "Choices"]

Speeds: TypeAlias = Annotated[tuple[tuple[Thickness, Speed], ...], MinLen(2)]
"""Spindle speeds, each with the radius at which it is reached, see `SpeedProfile`."""


def _one_speed(table: Choices | StrategyTable) -> None:
    """Raise if a table states one speed and several, or several that make no profile."""
    if table.spindle_speed is not None and table.spindle_speeds is not None:
        raise JobError("spindle_speed and spindle_speeds are both given, only one can be right: remove one")
    _profile(table)


def _profile(table: Choices | StrategyTable) -> SpeedProfile | None:
    """Return the speed over the radius that a table states."""
    if table.spindle_speeds is None:
        return None
    radius, speed = np.array(table.spindle_speeds).reshape(-1, 2).T
    return SpeedProfile(radius=radius, spindle_rpm=speed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choices(Table):
    """What a pass may state otherwise than the strategy.

    Parameters
    ----------
    feed
        Advance of X per revolution of the spindle, in this pass. [mm/rev]
    spindle_speed
        In this pass; that of the strategy if left out. [rpm]
    spindle_speeds
        Speeds, each with the radius at which it is reached, in this pass.
    points_per_rev
        Program points in a revolution, in this pass.
    arc_length
        Distance between program points along the spiral, in this pass. [mm]
    max_step
        Largest angle between program points, in this pass. [rad]
    chord
        Largest height between the exact path and straight lines between the points, in this pass. [mm]
    lead_in
        How far beyond the clear radius the tip starts, in this pass. [mm]
    scallop
        Largest height of cusps, in this pass. [mm]
    """

    feed: Feed | None = None
    spindle_speed: Speed | None = None
    spindle_speeds: Speeds | None = None
    points_per_rev: Count | None = None
    arc_length: Size | None = None
    max_step: Step | None = None
    chord: Size | None = None
    lead_in: Thickness | None = None
    scallop: Size | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        _one_speed(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StrategyTable(Table):
    """A way of cutting.

    Parameters
    ----------
    kind
        Which way of cutting it is.
    sense
        1 where the azimuth of the part under the tool grows, -1 where it falls.
    inside_out
        Whether the part is cut from the centre to the rim.
    along
        How the tool is brought into contact: by moving its height alone, or along the normal of the surface.
    spindle_speed
        Of the spindle; the highest that keeps every limit of the machine if left out. [rpm]
    spindle_speeds
        Speeds over the radius, each with the radius at which it is reached, in place of one speed.
    """

    kind: str
    sense: Literal[1, -1] = 1
    inside_out: Flag = False
    along: Literal["z", "normal"] = "z"
    spindle_speed: Speed | None = None
    spindle_speeds: Speeds | None = None

    placed_along: ClassVar[tuple[str, ...]] = ("z",)
    """Ways to place the tool under which what the strategy promises holds."""
    ways: ClassVar[tuple[str, ...]] = ()
    """Keys that set the points together: a pass that states one of them states them all."""

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool takes its own table of heights."""
        return False

    @abstractmethod
    def servo(self, cut: Choices, tool: Tool, machine: Machine) -> Strategy:
        """Return the strategy of one pass: what the pass states, else what all passes share.

        Parameters
        ----------
        cut
            The pass.
        tool, machine
            What it is cut with.
        """

    def __post_init__(self) -> None:
        check_numbers(self)
        _one_speed(self)

    def profile(self, cut: Choices) -> SpeedProfile | None:
        """Return the spindle speed over the radius, where a pass or else the strategy states one."""
        own = cut.spindle_speed is not None or cut.spindle_speeds is not None
        return _profile(cut if own else self)

    def chosen(self, cut: Choices) -> dict[str, Any]:
        """Return the shared keys as a strategy takes them, after the pass has had its say."""
        mine = types_of(type(self))
        stated = {name for name in types_of(Choices) if getattr(cut, name) is not None}
        if foreign := sorted(stated - set(mine)):
            raise JobError(f"it states {', '.join(foreign)}, which the {self.kind} does not have: leave it out")
        own = bool(stated & set(self.ways))
        values: dict[str, Any] = {"sense": self.sense, "inside_out": self.inside_out}
        for name in types_of(Choices):
            if name in mine and name != "spindle_speeds":  # which is for the motion, see `profile`
                value = getattr(cut, name)
                shared = None if own and name in self.ways else getattr(self, name)
                values["spindle_rpm" if name == "spindle_speed" else name] = shared if value is None else value
        return values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlowTable(StrategyTable):
    """See `turnwright.SlowToolServo`."""

    kind: Literal["slow tool servo"]
    feed: Feed
    points_per_rev: Count | None = None
    arc_length: Size | None = None
    max_step: Step | None = None
    chord: Size | None = None
    lead_in: Thickness | None = None
    overrun: Thickness = 0.0

    placed_along: ClassVar[tuple[str, ...]] = ("z", "normal")
    ways = ("points_per_rev", "arc_length", "max_step", "chord")

    def servo(self, cut: Choices, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - as its siblings
        """Return the strategy of one pass."""
        return self.slow(cut)

    def slow(self, cut: Choices) -> SlowToolServo:
        """Return the spiral and its points."""
        return SlowToolServo(overrun=self.overrun, **self.chosen(cut))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FastTable(SlowTable):
    """See `turnwright.FastToolServo`: the spiral is that of a slow tool servo."""

    kind: Literal["fast tool servo"]  # type: ignore[assignment] # each kind has a name of its own

    placed_along = ("z",)

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool takes its own table of heights."""
        return True

    def servo(self, cut: Choices, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - as its siblings
        """Return the strategy of one pass."""
        return FastToolServo(plan=self.slow(cut))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HybridTable(SlowTable):
    """See `turnwright.HybridToolServo`: the spiral is that of a slow tool servo.

    Without a ``base`` the share of the slide is found from the limits of the machine's W axis.

    Parameters
    ----------
    base
        The surface that the slide follows; the fast tool adds the rest. Found from the limits of the fast tool
        if left out.
    blocks_per_rev
        Blocks of the slide in a revolution.
    """

    kind: Literal["hybrid tool servo"]  # type: ignore[assignment] # each kind has a name of its own
    base: Surface | None = None
    blocks_per_rev: Count | None = None

    placed_along = ("z",)

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool takes its own table of heights."""
        return True

    def servo(self, cut: Choices, tool: Tool, machine: Machine) -> Strategy:
        """Return the strategy of one pass."""
        plan = self.slow(cut)
        if self.base is not None:
            return HybridToolServo(plan=plan, base=self.base, tool=tool, blocks_per_rev=self.blocks_per_rev)
        fast = machine.axes.get("W")
        if fast is None:
            raise JobError(
                f"a hybrid tool servo needs the limits of axis W, {machine.name} has "
                f"{', '.join(sorted(machine.axes))}: choose a machine with a fast tool"
            )
        return HybridToolServo(plan=plan, fast=fast, blocks_per_rev=self.blocks_per_rev)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AdaptiveTable(StrategyTable):
    """See `turnwright.AdaptiveToolServo`: it plans for the interpolation that the machine file states.

    With the motion of X split, a two-axis fast tool makes the height on W too.
    """

    kind: Literal["adaptive tool servo"]
    scallop: Size
    chord: Size
    off_path: Flag = True
    x_motion: Literal["servo", "split", "steady"] = "servo"

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool takes its own table: that of its two axes."""
        return self.x_motion == "split"

    def servo(self, cut: Choices, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - as its siblings
        """Return the strategy of one pass."""
        interpolation = machine.controller.interpolation
        servo = AdaptiveToolServo(
            interpolation=interpolation,  # type: ignore[arg-type] # one it does not plan for is refused in words
            off_path=self.off_path,
            x_motion=self.x_motion,
            **self.chosen(cut),
        )
        return FastToolServo(plan=servo) if self.x_motion == "split" else servo


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EllipticalTable(StrategyTable):
    """See `turnwright.QuasiEllipticalToolServo`."""

    kind: Literal["quasi-elliptical tool servo"]
    feed: Feed
    points_per_rev: Count | None = None
    arc_length: Size | None = None
    max_step: Step | None = None
    lead_in: Thickness | None = None
    short: Literal["merge", "skip", "slow"]
    shortest: Size | None = None
    y_acceleration: Annotated[float, unit("mm/s^2", above=0.0)] | None = None

    ways = ("points_per_rev", "arc_length", "max_step")

    def servo(self, cut: Choices, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - as its siblings
        """Return the strategy of one pass."""
        return QuasiEllipticalToolServo(
            short=self.short, shortest=self.shortest, y_acceleration=self.y_acceleration, **self.chosen(cut)
        )


KINDS: dict[str, type[StrategyTable]] = {
    "slow tool servo": SlowTable,
    "fast tool servo": FastTable,
    "hybrid tool servo": HybridTable,
    "adaptive tool servo": AdaptiveTable,
    "quasi-elliptical tool servo": EllipticalTable,
}

AnyStrategy: TypeAlias = Annotated[
    SlowTable | FastTable | HybridTable | AdaptiveTable | EllipticalTable, Field(discriminator="kind")
]
