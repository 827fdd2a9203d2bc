"""Program dialects of controllers: each is a file of words, in ``turnwright/dialects`` or in the shop's own folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from string import Formatter
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal

from turnwright._faults import read_table
from turnwright._io import bytes_of, read_toml
from turnwright._tables import Sources, TableModel
from turnwright._validate import check_numbers, positive
from turnwright.errors import InputError, ProgramError, quote
from turnwright.units import Count, Flag, Text, Time, plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from turnwright.machine import Machine

__all__ = ["MIN_LINES", "Dialect", "dialect_of"]

AXES = frozenset("CXYZ")
"""Axes that a lathe program can have."""

MAX_DECIMALS = 9
"""Most decimals of a word."""

MIN_LINES = 100
"""Least number of lines in one file."""

FEED_FORM = re.compile(r"(\.\d)?[fg]")
"""Forms of a feed in a line of a dialect."""

PLACEHOLDERS = MappingProxyType({
    "begin": frozenset({"file"}), "call": frozenset({"file"}),
    "feed_move": frozenset({"words", "feed", "note"}), "rapid_move": frozenset({"words"}),
    "loop_begin": frozenset({"count", "first", "step"}), "loop_end": frozenset({"step"}),
    "spindle_start": frozenset({"direction", "speed"}),
    "surface_speed_start": frozenset({"direction", "speed", "surface_speed"}),
})  # fmt: skip
"""What stands in braces in the lines of a dialect, by field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect(TableModel):
    """The program format of one controller. To add a controller, write a ``.toml`` file of these fields.

    Parameters
    ----------
    name
        Name in the header of a program, of letters, digits, - and _.
    decimals
        Decimals by axis letter, in the order of the words in a block; a motion without Y has no Y word.
    wrapped
        Whether C is written modulo one turn (the axis rolls over and takes the short way) or cumulative.
    feed
        Meaning of F under G93: the block time in seconds, or its inverse in 1/min. With velocities, the meaning of
        PVT: the block time in milliseconds.
    feed_decimals
        Largest number of decimals of the block time.
    feed_every_block
        Whether G93 needs an F in every block; otherwise F is modal.
    block
        Text before the words of every cutting block.
    begin, end
        Lines before the header of every file, with its name in ``{file}``, and after its last block.
    setup
        Lines before the first move.
    cut_begin, cut_resume
        Lines before the first block of a cut, and before that of a plunge or of a cut that continues in another file.
    cut_end
        Lines that end a cut and select feed moves.
    feed_move
        Lines of a feed move outside the cut, with ``{words}``, ``{feed}`` and ``{note}``.
    feed_unit
        Unit of ``{feed}``: "mm/min" or "mm/s".
    rapid_move
        Lines of a rapid move with ``{words}``, after which feed moves continue.
    call
        Line that calls the sub-program ``{file}``; empty if the dialect has no sub-programs.
    always_call
        Whether every pass is a sub-program, or only those of a program too long for one file.
    program_end, call_end
        Last line of the program, and of a sub-program.
    max_lines
        Largest number of lines in one file.
    spindle_start
        Lines that start the spindle in spindle mode, with ``{direction}`` ("M03" or "M04") and ``{speed}`` in rev/min;
        empty for a dialect without spindle mode.
    surface_speed_start
        The same for a constant ``{surface_speed}`` in m/min, with the highest ``{speed}``.
    spindle_end
        Lines that stop it.
    loop_begin, loop_end
        Lines around a pass in spindle mode that is repeated, each time deeper: the program's origin in Z is ``{first}``
        above that of the last cut and moves down by ``{step}`` each time, ``{count}`` times in all. Empty for a dialect
        that writes out every cut.
    local_origin
        Word that moves the origin of the program, "G52"; its axis words count from the work offset.
    auxiliary
        Functions of the machine that a job can name, such as mist or vacuum: the words that switch each on and off.
    feed_per_min, feed_per_rev
        Word that makes F a feed per minute, and per revolution.
    velocities
        Whether each word ends with the velocity of the axis at the end of the block, ``X1.5:20``, in mm/s or deg/s.
    comment
        Text before the bracket of a comment; empty if the bracket alone begins a comment.
    longest_block
        Longest block time. [s]
    sources
        Source of each value, by field; assumed values are marked.

    Raises
    ------
    InputError
        If a number of decimals is out of range, a line has other placeholders, or two fields contradict each other.
    """

    name: Text
    decimals: Mapping[str, Annotated[int, plain()]]
    wrapped: Flag
    feed: Literal["seconds", "inverse minutes", "milliseconds"]
    feed_decimals: Annotated[int, plain()]
    feed_every_block: Flag
    block: Text = ""
    begin: tuple[Text, ...] = ()
    end: tuple[Text, ...] = ()
    setup: tuple[Text, ...]
    cut_begin: tuple[Text, ...] = ("G93",)
    cut_resume: tuple[Text, ...] = ("G93 G1",)
    cut_end: tuple[Text, ...] = ("G94",)
    feed_move: tuple[Text, ...] = ("G1 {words} F{feed:g}{note}",)
    feed_unit: Literal["mm/min", "mm/s"] = "mm/min"
    rapid_move: tuple[Text, ...] = ("G0 {words}",)
    call: Text = ""
    always_call: Flag = False
    program_end: Text = "M30"
    call_end: Text = "M99"
    max_lines: Count
    spindle_start: tuple[Text, ...] = ()
    surface_speed_start: tuple[Text, ...] = ()
    spindle_end: tuple[Text, ...] = ("M05",)
    loop_begin: tuple[Text, ...] = ()
    loop_end: tuple[Text, ...] = ()
    local_origin: Literal["", "G52"] = ""
    auxiliary: Mapping[str, tuple[Text, Text]] = field(default_factory=dict)
    feed_per_min: Text = "G94"
    feed_per_rev: Text = "G95"
    velocities: Flag = False
    comment: Text = ""
    longest_block: Time = 1e4
    sources: Annotated[Mapping[str, str], Sources] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.longest_block, "longest_block", "s")
        object.__setattr__(self, "decimals", MappingProxyType(dict(self.decimals)))
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))
        object.__setattr__(self, "auxiliary", MappingProxyType(dict(self.auxiliary)))
        if not self.name.replace("-", "").replace("_", "").isalnum() or not self.name.isascii():
            raise InputError(f"name is {quote(self.name)}, letters, digits, - and _ are allowed: change it")
        if not {"C", "X", "Z"} <= set(self.decimals) <= AXES:
            raise InputError(
                f"decimals has {quote(', '.join(self.decimals))}, it needs C, X and Z and can have Y: name these axes"
            )
        places = {f"decimals.{letter}": count for letter, count in self.decimals.items()}
        for place, count in (places | {"feed_decimals": self.feed_decimals}).items():
            if not 0 <= count <= MAX_DECIMALS:
                raise InputError(f"{place} is {count}, the limits are 0 and {MAX_DECIMALS}: correct it")
        if self.max_lines < MIN_LINES:
            raise InputError(f"max_lines is {self.max_lines}, it must be at least {MIN_LINES}: increase it")
        if self.velocities != (self.feed == "milliseconds"):
            raise InputError(
                f"feed is {self.feed!r} with velocities {str(self.velocities).lower()}: milliseconds go with velocities"
            )
        stated = (bool(self.loop_begin), bool(self.loop_end), bool(self.local_origin))
        if any(stated) and not all(stated):
            raise InputError("loop_begin, loop_end or local_origin is missing, a loop needs all of them: state them")
        if self.always_call and not self.call:
            raise InputError("always_call is true and call is empty: state the call of a sub-program")
        self._check_texts()

    def _check_texts(self) -> None:
        """Raise unless all lines are printable and have the placeholders of their fields."""
        for place, words in self.auxiliary.items():
            _check_lines(f"auxiliary.{place}", words)
        for place in ("block", "begin", "end", "setup", "cut_begin", "cut_resume", "cut_end", "feed_move", "rapid_move",
                      "call", "program_end", "call_end", "comment", "spindle_start", "surface_speed_start",
                      "spindle_end", "loop_begin", "loop_end", "feed_per_min", "feed_per_rev"):  # fmt: skip
            value = getattr(self, place)
            _check_lines(place, (value,) if isinstance(value, str) else value)

    @staticmethod
    def known() -> tuple[str, ...]:
        """Return the names of the dialects that come with Turnwright."""
        return tuple(_supplied())

    @classmethod
    def load(cls, name: str | Path) -> Dialect:
        """Return a dialect that comes with Turnwright, or one described in a file.

        Parameters
        ----------
        name
            One of `known`, or the path of a ``.toml`` file of the fields.

        Raises
        ------
        InputError
            If there is no such dialect, or its file is wrong; the message names the key.

        >>> Dialect.load("nanotech").decimals["C"]
        5
        """
        name, supplied = str(name), _supplied()
        if name in supplied:
            return supplied[name]
        if not name.endswith(".toml"):
            raise InputError(
                f"dialect {quote(name)} is not known, Turnwright writes {', '.join(supplied)}: name one of these, or a "
                ".toml file of a dialect"
            )
        what = f"dialect file {name!r}"
        return read_table(cls, read_toml(bytes_of(Path(name), "dialect file"), what), what)

    @property
    def interpolation(self) -> str:
        """Interpolation of its cutting blocks: "hermite" with velocities, else "linear"."""
        return "hermite" if self.velocities else "linear"

    @property
    def time_code(self) -> int:
        """Number of the meaning of the block time in the kernels."""
        return ("seconds", "inverse minutes", "milliseconds").index(self.feed)

    def letters(self, axes: Mapping[str, object]) -> tuple[str, ...]:
        """Return the axis letters of a motion in the order in which this dialect writes them."""
        return tuple(letter for letter in self.decimals if letter in axes)

    def straight(self, words: str, feed: float, note: str = "") -> list[str]:
        """Return the lines of a feed move outside the cut, ``feed`` in mm/s."""
        feed = 60 * feed if self.feed_unit == "mm/min" else feed
        note = f" ({note})" if note else ""
        return [line.format(words=words, feed=feed, note=note) for line in self.feed_move]

    def rapid(self, words: str) -> list[str]:
        """Return the lines of a rapid move, after which feed moves continue."""
        return [line.format(words=words) for line in self.rapid_move]

    def first_lines(self, file: str) -> list[str]:
        """Return the lines before the header of a file."""
        return [line.format(file=file) for line in self.begin]

    def commented(self, rows: Sequence[str]) -> list[str]:
        """Return lines with the text that begins a comment before their brackets."""
        return [row.replace("(", f"{self.comment}(", 1) if self.comment else row for row in rows]


def _check_lines(place: str, lines: Iterable[str]) -> None:
    for line in lines:
        _check_line(place, line)


def _check_line(place: str, line: str) -> None:
    """Raise unless a line of a dialect is printable ASCII and has the placeholders of its field."""
    if not line.isascii() or not (line.isprintable() or not line):
        raise InputError(f"{place} has the line {quote(line)}, printable ASCII is allowed: correct it")
    allowed = PLACEHOLDERS.get(place)
    if allowed is None:
        return
    try:
        parts = [(name, form, kind) for _, name, form, kind in Formatter().parse(line) if name is not None]
    except ValueError as error:
        raise InputError(f"{place} has the line {quote(line)}, its braces do not match: close them") from error
    for name, form, kind in parts:
        if name not in allowed or kind or not (FEED_FORM.fullmatch(form or "") if name == "feed" else not form):
            raise InputError(
                f"{place} has {quote(name)} in braces, the names allowed are {', '.join(sorted(allowed))}: correct it, "
                "the feed with a form such as {feed:.4f}"
            )


def dialect_of(machine: Machine) -> Dialect:
    """Return the program dialect of a machine's controller.

    Raises
    ------
    ProgramError
        If there is no such dialect, its file is wrong, or its programs need another interpolation than the
        controller's.
    """
    try:
        dialect = Dialect.load(machine.dialect)
    except InputError as error:
        raise ProgramError(f"machine {machine.name}: {error}") from error
    interpolation = machine.controller.interpolation
    if dialect.velocities and interpolation != "hermite":
        raise ProgramError(
            f"the dialect {dialect.name} has velocities and needs the interpolation hermite, the controller of "
            f"{machine.name} has {interpolation}: choose another dialect, or the interpolation hermite"
        )
    return dialect


@cache
def _supplied() -> Mapping[str, Dialect]:
    """Return the dialects that come with Turnwright, by name."""
    files = sorted((resources.files("turnwright") / "dialects").iterdir(), key=lambda file: file.name)
    tables = {file.name: read_toml(file.read_bytes(), file.name) for file in files if file.name.endswith(".toml")}
    return MappingProxyType({Path(name).stem: read_table(Dialect, one, name) for name, one in tables.items()})
