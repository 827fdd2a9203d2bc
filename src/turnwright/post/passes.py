"""The passes of a program as they are written, and the loops of those that are repeated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from turnwright._arrays import Floats
from turnwright.path import Motion
from turnwright.post.approach import Approach
from turnwright.post.dialect import Dialect
from turnwright.post.spindle import position_word

__all__ = ["Loop", "WrittenPass", "even_loops", "find_loops"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenPass:
    """A cut with its approach, and how its positions are written."""

    name: str
    motion: Motion
    letters: tuple[str, ...]
    factors: Mapping[str, float]  # Turnwright's unit to the controller's, without decimals
    shifts: Mapping[str, float]
    clocking: float  # of C, whose shift also has the full turns of the passes before [deg]
    dialect: Dialect
    velocity: Mapping[str, Floats] | None  # at the points, from rest to rest; only for dialects with velocities
    approach: Approach

    def units(self, letter: str, value: float) -> int:
        """Return a position as written, without its decimal point and without wrapping."""
        scale = 10.0 ** self.dialect.decimals[letter]
        return int(np.rint(value * (self.factors[letter] * scale) + self.shifts[letter] * scale))

    @property
    def points(self) -> int:
        """Number of points in the program."""
        return self.motion.time.size if self.motion.spindle_mode is None else self.motion.blocks.size

    def raised(self, height: float) -> WrittenPass:
        """Return the pass with its approach, higher by so much. [mm]."""
        axes, approach = self.motion.axes, self.approach
        motion = replace(self.motion, axes={**axes, "Z": axes["Z"] + height})
        start = {**approach.start, "Z": approach.start["Z"] + height}
        return replace(self, motion=motion, approach=replace(approach, clear=approach.clear + height, start=start))

    @property
    def first_c(self) -> float:
        """The controller's C at the first point, without full turns of the passes before; 0 in spindle mode. [deg]."""
        if self.motion.spindle_mode is not None:
            return 0.0
        places = self.dialect.decimals["C"]
        turns = round((self.shifts["C"] - self.clocking) / 360)
        units = self.units("C", float(self.motion.axes["C"][0])) - turns * 360 * 10**places
        return float(units / 10.0**places)

    def word(self, letter: str, value: float) -> str:
        """Return the word of a position."""
        places = self.dialect.decimals[letter]
        units = self.units(letter, value)
        if letter == "C" and self.dialect.wrapped:
            units %= 360 * 10**places
        return position_word(letter, units, places)


@dataclass(frozen=True, slots=True)
class Loop:
    """Cuts of one pass in spindle mode that differ by their height only."""

    name: str
    count: int
    step: float  # height of each cut above the next, whole decimals [mm]


def find_loops(passes: Sequence[WrittenPass], dialect: Dialect) -> dict[int, Loop]:
    """Return the loops of a program, by the index of their first cut: equal cuts at equal steps of depth."""
    loops: dict[int, Loop] = {}
    for name, group in groupby(range(len(passes)), lambda k: _repeated_name(passes[k].name)):
        cuts = list(group)
        named = [f"{name} {number}" for number in range(1, len(cuts) + 1)]
        if not dialect.loop_begin or not name or len(cuts) < 2 or [passes[k].name for k in cuts] != named:
            continue
        last = passes[cuts[-1]]
        lifts = [_lift(passes[k], last) for k in cuts]
        if any(one is None for one in lifts):
            continue
        steps, unit = -np.diff(np.array(lifts, dtype=np.float64)), 10.0 ** -dialect.decimals["Z"]
        if np.ptp(steps) < unit and (steps > 0).all():
            loops[cuts[0]] = Loop(name, len(cuts), float(np.rint(steps.mean() / unit)) * unit)
    return loops


def even_loops(passes: list[WrittenPass], loops: Mapping[int, Loop]) -> list[WrittenPass]:
    """Return the passes with the cuts of each loop at its steps, and with the same approach."""
    result = list(passes)
    for first, loop in loops.items():
        cuts = passes[first : first + loop.count]
        lifts = [(loop.count - 1 - k) * loop.step for k in range(loop.count)]
        clear = max(one.approach.clear - lift for one, lift in zip(cuts, lifts, strict=True))
        start = max(one.approach.start["Z"] - lift for one, lift in zip(cuts, lifts, strict=True))
        deepest = max(cuts, key=lambda one: one.approach.height).approach
        for k, lift in enumerate(lifts):
            approach = replace(deepest, clear=clear + lift, start={**cuts[k].approach.start, "Z": start + lift})
            axes = cuts[-1].motion.axes
            motion = replace(cuts[-1].motion, axes={**axes, "Z": axes["Z"] + lift})
            result[first + k] = replace(cuts[k], motion=motion, approach=approach)
    return result


def _repeated_name(name: str) -> str:
    base, _, number = name.rpartition(" ")
    return base if number.isdigit() else ""


def _lift(one: WrittenPass, last: WrittenPass) -> float | None:
    """Return by how much a cut in spindle mode is higher than another one, ``None`` if it differs otherwise. [mm]."""
    same = one.motion.spindle_mode is not None and one.motion.spindle_mode == last.motion.spindle_mode
    if not same or one.motion.time.size != last.motion.time.size:
        return None
    if np.abs(one.motion.axes["X"] - last.motion.axes["X"]).max() > 0:
        return None
    lift = one.motion.axes["Z"] - last.motion.axes["Z"]
    return float(lift.mean()) if np.ptp(lift) < 1e-9 else None
