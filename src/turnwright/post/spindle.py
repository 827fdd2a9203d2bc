"""Cuts in spindle mode: their lines in a program, and the state of the spindle that a program commands."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Ints
from turnwright.errors import ProgramError
from turnwright.path import SpindleMode
from turnwright.post.dialect import Dialect
from turnwright.post.header import bytes_to_hash

__all__ = [
    "Spindle", "origin_bytes", "position_word", "require_spindle_modes", "spindle_lines", "start_spindle",
    "turning_number",
]  # fmt: skip

DECIMALS = 6
"""Decimals of speeds and feeds in spindle mode."""

MM_PER_S = 1000 / 60
"""A speed of 1 m/min. [mm/s]"""


class Spindle(NamedTuple):
    """State of the spindle in spindle mode, as a program commands it.

    Parameters
    ----------
    sense
        +1 after M04, -1 after M03, 0 at rest.
    speed
        S. [rev/min, with G96 m/min]
    highest
        Highest speed with G96. [rev/min]
    constant_surface
        Whether G96 is in force.
    """

    sense: int = 0
    speed: float = 0.0
    highest: float = 0.0
    constant_surface: bool = False

    @property
    def runs(self) -> bool:
        """Whether the spindle runs at a stated speed."""
        return bool(self.sense and self.speed > 0)

    def follow(self, words: Sequence[tuple[str, float]], codes: Sequence[float]) -> Spindle:
        """Return the state after a block of these words and G codes."""
        spindle = self
        if {96, 97} & set(codes):
            spindle = spindle._replace(constant_surface=96 in codes)
        for letter, value in words:
            if letter == "S":
                is_limit = {50, 92} & set(codes)  # the highest speed of G96 on some controllers
                spindle = spindle._replace(highest=value) if is_limit else spindle._replace(speed=value)
            elif letter == "D" and 96 in codes:
                spindle = spindle._replace(highest=value)
            elif letter == "M" and value in {2, 3, 4, 5, 30}:
                spindle = spindle._replace(sense={3: -1, 4: 1}.get(int(value), 0))
        return spindle

    def mode(self, feed: float, *, per_rev: bool) -> SpindleMode:
        """Return the mode of a cut with a feed as written, per revolution or per minute."""
        if self.constant_surface:
            surface = self.speed * MM_PER_S
            return SpindleMode(feed=feed, spindle_rpm=self.highest, surface_speed=surface, per_rev=per_rev)
        return SpindleMode(feed=feed if per_rev else feed / self.speed, spindle_rpm=self.speed, per_rev=per_rev)


def require_spindle_modes(dialect: Dialect, modes: Iterable[SpindleMode | None]) -> None:
    """Raise if a dialect cannot write cuts in these modes; ``None`` stands for C as an axis."""
    for mode in modes:
        name = "spindle_start" if mode is None or mode.surface_speed is None else "surface_speed_start"
        if mode is not None and not getattr(dialect, name):
            what = "spindle mode" if name == "spindle_start" else "constant surface speed"
            instead = "choose another strategy" if name == "spindle_start" else "leave out surface_speed"
            raise ProgramError(
                f"the cut needs {what}, the dialect {dialect.name} has none: {instead}, or add {name} to its file"
            )


def start_spindle(dialect: Dialect, mode: SpindleMode, sense: int) -> list[str]:
    """Return the lines that start the spindle in spindle mode; ``sense`` as of a `Motion`."""
    direction, surface = "M04" if sense > 0 else "M03", mode.surface_speed
    lines = dialect.spindle_start if surface is None else dialect.surface_speed_start
    speeds = {"speed": _decimal(mode.spindle_rpm), "surface_speed": _decimal((surface or 0.0) / MM_PER_S)}
    return [line.format(direction=direction, **speeds) for line in lines]


def spindle_lines(
    name: str, units: Mapping[str, Ints], mode: SpindleMode, sense: int, dialect: Dialect, origin: float = 0.0
) -> tuple[list[str], str]:
    """Return the lines of a cut, and the hash of its points, see `ProgramPass`.

    ``units`` are the positions by axis letter in units of the last decimal, above an origin in Z [mm]. Each (n,)
    """
    feed, written = _written_feed(mode)
    x, z = (units[letter] / 10.0 ** dialect.decimals[letter] for letter in "XZ")
    turns = written.turns(x, z)
    if (still := np.flatnonzero(turns == 0)).size:
        raise ProgramError(
            f"block {still[0] + 1} of pass {name} moves by less than the last decimal of the program: allow a larger "
            "chord"
        )
    columns = [units.get(letter, np.zeros(x.size, dtype=np.int64)) for letter in dialect.letters({**units, "C": 0})]
    digest = hashlib.sha256(
        origin_bytes(origin, dialect)
        + bytes_to_hash(np.stack(columns, axis=1), np.concatenate(([turning_number(written, sense)], turns)))
    ).hexdigest()
    words = [
        [position_word(letter, one, dialect.decimals[letter]) for one in units[letter].tolist()] for letter in units
    ]
    blocks = [" ".join(block) for block in list(zip(*words, strict=True))[1:]]
    begin = dialect.feed_per_rev if mode.per_rev else dialect.feed_per_min
    return [begin, f"G1 {blocks[0]} F{feed}", *(f"{dialect.block}{block}" for block in blocks[1:])], digest


def _written_feed(mode: SpindleMode) -> tuple[str, SpindleMode]:
    """Return the feed as written, and the mode with feed and speed as written."""
    speed, feed = _decimal(mode.spindle_rpm), _decimal(mode.feed if mode.per_rev else mode.feed * mode.spindle_rpm)
    if not (float(feed) > 0 and float(speed) > 0):
        raise ProgramError(
            f"feed {mode.feed:g} mm/rev at {mode.spindle_rpm:g} rev/min is 0 with {DECIMALS} decimals: check the units"
        )
    surface = None if mode.surface_speed is None else float(_decimal(mode.surface_speed / MM_PER_S)) * MM_PER_S
    per_rev = float(feed) if mode.per_rev else float(feed) / float(speed)
    return feed, replace(mode, feed=per_rev, spindle_rpm=float(speed), surface_speed=surface)


def origin_bytes(height: float, dialect: Dialect) -> bytes:
    """Return what stands for the height of the local origin in the hash of a cut; nothing if it is not moved."""
    units = np.int64(np.rint(height * 10.0 ** dialect.decimals["Z"]))
    return units.tobytes() if units else b""


def turning_number(mode: SpindleMode, sense: int) -> float:
    """Return a number that stands for direction and speed of the spindle in the hash of a cut."""
    return sense * (mode.spindle_rpm + 1e6 * (mode.surface_speed or 0.0))


def position_word(letter: str, units: int, places: int) -> str:
    """Return a word of a position in units of the last decimal."""
    sign = "-" if units < 0 else ""
    return f"{letter}{sign}{abs(units) // 10**places}.{abs(units) % 10**places:0{places}d}"


def _decimal(value: float) -> str:
    return f"{value:.{DECIMALS}f}".rstrip("0").rstrip(".")
