"""What one controller's programs look like, as data."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["Dialect"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """One controller's way of writing a program: to add a controller, add a file with one of these.

    Parameters
    ----------
    name
        What `Machine.dialect` says.
    decimals
        Decimals by axis letter, in the order in which the words stand in a block; a motion without Y has no Y word.
    wrapped
        Whether C is written modulo one turn (the axis rolls over and takes the short way) or cumulative.
    feed
        What F means under G93: the block's time in seconds, or one over its time in minutes; or, where words hold
        velocities, what PVT means: its time in milliseconds.
    feed_decimals
        Most decimals of the number that says the time of a block.
    feed_every_block
        Whether G93 needs an F in every block, or F is modal.
    block
        Text before the words of every cutting block.
    setup
        Lines before anything moves.
    call
        Format of a call of the sub-program ``{file}``; empty where there is none.
    always_call
        Whether every pass is a sub-program, or only the passes of a program too long for one file.
    max_lines
        Most lines in one file.
    sources
        Where these facts come from; anything assumed says so.
    velocities
        Whether each word ends with the velocity that the axis has at the end of the block, ``X1.5:20``, in mm/s or
        deg/s. The moves between the cuts are then said in plain words, LINEAR and RAPID, with F in mm/s.
    comment
        What begins a comment, before its bracket; nothing where the bracket does.
    longest_block
        Longest time that a block may last. [s]
    """

    name: str
    decimals: Mapping[str, int]
    wrapped: bool
    feed: Literal["seconds", "inverse minutes", "milliseconds"]
    feed_decimals: int
    feed_every_block: bool
    block: str
    setup: tuple[str, ...]
    call: str
    always_call: bool
    max_lines: int
    sources: Mapping[str, str]
    velocities: bool = False
    comment: str = ""
    longest_block: float = 1e4

    def __post_init__(self) -> None:
        object.__setattr__(self, "decimals", MappingProxyType(dict(self.decimals)))
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))

    def letters(self, axes: Mapping[str, object]) -> tuple[str, ...]:
        """Return the axis letters of a motion in the order in which this dialect writes them."""
        return tuple(letter for letter in self.decimals if letter in axes)

    @property
    def interpolation(self) -> str:
        """What its cutting blocks ask the controller for: "hermite" by velocities, else "linear"."""
        return "hermite" if self.velocities else "linear"

    @property
    def feed_unit(self) -> int:
        """Number of the meaning of F, as the kernels count."""
        return ("seconds", "inverse minutes", "milliseconds").index(self.feed)

    def begin(self) -> list[str]:
        """Return the lines before the first block of a cut."""
        return ["DWELL10"] if self.velocities else ["G93"]

    def plunge(self) -> list[str]:
        """Return the lines before the first block of a plunge, which is written like a cut."""
        return ["DWELL10"] if self.velocities else ["G93 G1"]

    def end(self) -> list[str]:
        """Return the lines that end a cut, or any other way of moving, for feed moves at mm per minute."""
        return ["LINEAR"] if self.velocities else ["G94"]

    def straight(self, words: str, feed: float, note: str = "") -> list[str]:
        """Return the lines of a feed move outside the cut, ``feed`` in mm/min."""
        note = f" ({note})" if note else ""
        return [f"F{feed / 60:.4f}", f"{words}{note}"] if self.velocities else [f"G1 {words} F{feed:g}{note}"]

    def rapid(self, words: str) -> list[str]:
        """Return the lines of a rapid move, after which feed moves go on."""
        return ["RAPID", words, "LINEAR"] if self.velocities else [f"G0 {words}"]

    def commented(self, rows: Sequence[str]) -> list[str]:
        """Return lines with what begins a comment before their brackets."""
        return [row.replace("(", f"{self.comment}(", 1) if self.comment else row for row in rows]
