"""What one controller's programs look like, as data."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

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
        What F means under G93: the block's time in seconds, or one over its time in minutes.
    feed_every_block
        Whether G93 needs an F in every block, or F is modal.
    block
        Text before the words of every cutting block.
    setup
        Lines before anything moves.
    call
        Format of a call of the sub-program ``{file}``.
    always_call
        Whether every pass is a sub-program, or only the passes of a program too long for one file.
    max_lines
        Most lines in one file.
    sources
        Where these facts come from; anything assumed says so.
    """

    name: str
    decimals: Mapping[str, int]
    wrapped: bool
    feed: Literal["seconds", "inverse minutes"]
    feed_every_block: bool
    block: str
    setup: tuple[str, ...]
    call: str
    always_call: bool
    max_lines: int
    sources: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "decimals", MappingProxyType(dict(self.decimals)))
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))

    def letters(self, axes: Mapping[str, object]) -> tuple[str, ...]:
        """Return the axis letters of a motion in the order in which this dialect writes them."""
        return tuple(letter for letter in self.decimals if letter in axes)
