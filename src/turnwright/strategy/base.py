"""What every way of cutting must say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from turnwright.path import Spiral

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.part import Part
    from turnwright.path import Path
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = ["Strategy", "glimpsed"]


def glimpsed(turned: float, turns: int, per_turn: int) -> Floats:
    """Return where points of single turns stand that show a cut, counted in turns from its first point. (n,)."""
    whole = max(turned - 1, 0.0)
    first = np.round(np.linspace(0, whole, max(min(turns, int(whole) + 1), 1)))
    at = first[:, None] + np.arange(per_turn + 1) / per_turn
    return np.unique(np.append(at[at < turned], turned))


class Strategy(ABC):
    """A way of cutting: which plan the tool follows over the part, and which axes share the motion.

    This is where a sibling joins (a fast tool servo, an adaptive spacing, a hybrid of two servos): a frozen dataclass
    in a file of its own in this folder that says two things. `place` puts the edge into contact along its spiral,
    `drive` turns the axes it names into a motion; neither needs to know it.

    Attributes
    ----------
    spindle_rpm
        Spindle speed, or ``None`` for the highest one that keeps every limit of the machine. [rev/min]
    """

    __slots__ = ()

    spindle_rpm: float | None

    @abstractmethod
    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return where the tool is sent over the part, in plan view."""

    def glimpse(self, part: Part, tool: Tool, *, turns: int, per_turn: int) -> Spiral:
        """Return some of the points of `spiral`, enough for a picture: single turns, evenly apart from first to last.

        Parameters
        ----------
        part, tool
            See `spiral`.
        turns
            How many, at most.
        per_turn
            Points of each, at most.
        """
        whole = self.spiral(part, tool)
        turned = np.abs(whole.angle - whole.angle[0]) / (2 * np.pi)
        wanted = glimpsed(float(turned[-1]), turns, per_turn)
        near = np.clip(np.searchsorted(turned, wanted), 1, turned.size - 1)
        near = np.unique(near - (wanted - turned[near - 1] < turned[near] - wanted))
        y = None if whole.y is None else whole.y[near]
        return Spiral(angle=whole.angle[near], radius=whole.radius[near], y=y)

    def extent(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> tuple[int, Spiral]:
        """Return how many points `spiral` has, and of these its outermost turn and the last one at its other end.

        Parameters
        ----------
        part, tool, progress
            See `spiral`.
        """
        whole = self.spiral(part, tool, progress=progress)
        size = whole.angle.size
        inwards = whole.radius[0] > whole.radius[-1]
        away = np.abs(whole.angle - whole.angle[0 if inwards else -1])
        turn = np.flatnonzero(away <= 2 * np.pi)
        at = np.unique([*turn, size - 1 if inwards else 0])
        y = None if whole.y is None else whole.y[at]
        return size, Spiral(angle=whole.angle[at], radius=whole.radius[at], y=y)

    @abstractmethod
    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the position of every axis at the points of a path, by letter, at least "C", "X" and "Z".

        Their sum is the tip: whatever share of Z a second carriage takes, together they stand where the path says.
        """

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivative by the angle of every axis that `axes` names, or ``None`` if the path states none.

        As it stands this is for a strategy that moves C, X and Z, and Y where the path has one, as the path says; one
        that splits an axis splits its rate too. [mm/rad, C rad/rad]
        """
        if path.radius_rate is None or path.z_rate is None or (path.y is not None and path.y_rate is None):
            return None
        rates = {"C": np.ones(path.angle.size), "X": path.radius_rate, "Z": path.z_rate}
        return rates if path.y_rate is None else {**rates, "Y": path.y_rate}
