"""Program dialects of controllers, as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

__all__ = ["Dialect"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """The program format of one controller: to add a controller, add an instance to `DIALECTS`.

    Parameters
    ----------
    name
        Name that `Machine.dialect` refers to.
    decimals
        Decimals by axis letter, in the order of the words in a block; a motion without Y has no Y word.
    wrapped
        Whether C is written modulo one turn (the axis rolls over and takes the short way) or cumulative.
    feed
        Meaning of F under G93: the block time in seconds, or one over the block time in minutes; where words have
        velocities, the meaning of PVT: the block time in milliseconds.
    feed_decimals
        Largest number of decimals of the block time.
    feed_every_block
        Whether G93 needs an F in every block; otherwise F is modal.
    block
        Text before the words of every cutting block.
    setup
        Lines before the first move.
    call
        Format of a call of the sub-program ``{file}``; empty where there is none.
    always_call
        Whether every pass is a sub-program, or only those of a program too long for one file.
    max_lines
        Largest number of lines in one file.
    sources
        Source of each value; assumed values are marked.
    velocities
        Whether each word ends with the velocity of the axis at the end of the block, ``X1.5:20``, in mm/s or deg/s.
        The moves between the cuts are then plain words after LINEAR and RAPID, with F in mm/s.
    comment
        Text that begins a comment, before its bracket; empty where the bracket does.
    longest_block
        Longest block time. [s]
    """

    name: str
    decimals: Mapping[str, int]
    wrapped: bool
    feed: Literal["seconds", "inverse minutes", "milliseconds"]
    feed_decimals: int
    setup: tuple[str, ...]
    sources: Mapping[str, str]
    feed_every_block: bool = False
    block: str = ""
    call: str = ""
    always_call: bool = False
    max_lines: int = 1_000_000
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
        """Interpolation of its cutting blocks: "hermite" with velocities, else "linear"."""
        return "hermite" if self.velocities else "linear"

    @property
    def feed_unit(self) -> int:
        """Number of the meaning of F in the kernels."""
        return ("seconds", "inverse minutes", "milliseconds").index(self.feed)

    def begin(self) -> list[str]:
        """Return the lines before the first block of a cut."""
        return ["DWELL10"] if self.velocities else ["G93"]

    def plunge(self) -> list[str]:
        """Return the lines before the first block of a plunge, which has the form of a cut."""
        return ["DWELL10"] if self.velocities else ["G93 G1"]

    def end(self) -> list[str]:
        """Return the lines that end a cut and select feed moves in mm per minute."""
        return ["LINEAR"] if self.velocities else ["G94"]

    def straight(self, words: str, feed: float, note: str = "") -> list[str]:
        """Return the lines of a feed move outside the cut, ``feed`` in mm/min."""
        note = f" ({note})" if note else ""
        return [f"F{feed / 60:.4f}", f"{words}{note}"] if self.velocities else [f"G1 {words} F{feed:g}{note}"]

    def rapid(self, words: str) -> list[str]:
        """Return the lines of a rapid move, after which feed moves continue."""
        return ["RAPID", words, "LINEAR"] if self.velocities else [f"G0 {words}"]

    def commented(self, rows: Sequence[str]) -> list[str]:
        """Return lines with the text that begins a comment before their brackets."""
        return [row.replace("(", f"{self.comment}(", 1) if self.comment else row for row in rows]
