"""The header of a program: writing it, and reading it back."""

from __future__ import annotations

import hashlib
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._kernels import text as kernel
from turnwright._validate import one_of
from turnwright.errors import InputError, ProgramError, quote
from turnwright.machine import Machine
from turnwright.post.approach import Approach, entry_words
from turnwright.post.convention import axis_signs, convention_line, reading
from turnwright.post.dialect import Dialect

__all__ = [
    "ProgramHeader", "ProgramInfo", "ProgramPass", "ProgramStart", "ProgramWarning", "WorkOffset", "inspect_nc",
]  # fmt: skip

SIGNATURE = "( TURNWRIGHT PROGRAM 1 )"
SUB_SIGNATURE = "( TURNWRIGHT SUB-PROGRAM 1 )"
EACH_TIME = " #"
"""End of the name of a pass that a loop repeats; the cuts are numbered from 1."""
ENTRY = ", ENTRY"
"""Suffix of the name of a pass where its plunge begins, whose blocks are not part of the cut."""
BEGIN = re.compile(r"\A(?:[%O<][^\n]{0,80}\n){0,3}")
"""Lines that a dialect may have before the signature: a percent sign, and the number or name of the program."""

BEGIN_BYTES = 512
"""Bytes of a file in which its signature begins."""

TOOL_WORD = r"(?:[THD]\d{1,8}|M0?6|G43)"
"""Word of a tool call."""

WorkOffset: TypeAlias = Literal["G54", "G55", "G56", "G57", "G58", "G59"]
"""Work offsets that a program can select."""

NO_HASH = "0" * 64
SOFTWARE = f"TURNWRIGHT {version('turnwright')}"
BOM = b"\xef\xbb\xbf"
"""Byte order mark of UTF-8."""


class ProgramWarning(UserWarning):
    """A program differs, or may differ, from the one that was written, or was read only in part."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramHeader:
    """Free texts in the header of a program, for the operator.

    Parameters
    ----------
    design, tool, notes
        Plain text; brackets, line breaks and letters beyond ASCII are replaced by characters that a controller can
        read, control characters are removed.
    date
        Day of writing; today (UTC) by default.
    """

    design: str = ""
    tool: str = ""
    date: str = ""
    notes: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramPass:
    """One pass of a program.

    Parameters
    ----------
    name
        Name of the pass.
    points
        Number of points, one more than its cutting blocks.
    minutes
        Time of the cut, without approach and retract. [min]
    first_c
        The controller's C at the first point, cumulative. [deg]
    sense
        +1 where the azimuth of the part under the tool grows, else -1.
    hash
        SHA-256 over the points as written: one row of little-endian unsigned 32-bit integers per point, the axis words
        without their decimal points modulo 2^32, then the two halves of the bits of the block's duration [s, float64],
        combined by exclusive or.
    """

    name: str
    points: int
    minutes: float
    first_c: float
    sense: int
    hash: str


def bytes_to_hash(units: Ints, duration: Floats) -> memoryview:
    """Return the bytes to hash for points, see `ProgramPass`.

    ``units`` are the words without their decimal points, as written (n, k); ``duration`` that of each block. (n,) [s]
    """
    packed = np.empty((units.shape[0], units.shape[1] + 1), dtype=np.uint32)
    kernel.pack(units, duration.view(np.int64), packed)
    return packed.astype("<u4", copy=False).data.cast("B")


def program_hash(passes: Sequence[ProgramPass]) -> str:
    """Return the SHA-256 of a program, over the hashes of its passes, one per line."""
    return hashlib.sha256("\n".join(cut.hash for cut in passes).encode()).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramInfo:
    """Contents of a program's header.

    Parameters
    ----------
    header
        Design, tool, date and notes.
    software, machine, dialect
        The software that wrote it, the machine, and the program dialect.
    convention
        Signs and zero of the controller's axes, as one line of text.
    passes
        The passes, in the order of cutting.
    """

    header: ProgramHeader
    software: str
    machine: str
    dialect: str
    convention: str
    passes: tuple[ProgramPass, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramStart:
    """What a program selects before its first move.

    Parameters
    ----------
    work_offset
        Work offset, "G54" to "G59"; empty where the operator selects it.
    tool_call
        Words that call the tool with its offset, T, M6, G43, H and D, such as "T0101" or "T1 M06"; empty where the
        operator selects it.
    auxiliary
        Functions of the dialect that are switched on before the first move, and off after the last.

    Raises
    ------
    InputError
        If the work offset is another, or a tool call has other words.
    """

    work_offset: str = ""
    tool_call: str = ""
    auxiliary: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.work_offset:
            one_of(self.work_offset, "work_offset", get_args(WorkOffset))
        if not re.fullmatch(f"({TOOL_WORD}( {TOOL_WORD})*)?", self.tool_call):
            raise InputError(
                f"tool_call is {quote(self.tool_call)}, the words T, M6, G43, H and D are allowed: correct it, such as "
                '"T0101"'
            )

    def lines(self, dialect: Dialect) -> tuple[list[str], list[str]]:
        """Return the lines at the start and at the end of a program."""
        if unknown := [name for name in self.auxiliary if name not in dialect.auxiliary]:
            raise ProgramError(
                f"auxiliary names {quote(unknown[0])}, the dialect {dialect.name} has "
                f"{', '.join(dialect.auxiliary) or 'none'}: add it to the dialect file, or correct it"
            )
        if dialect.velocities and (self.work_offset or self.tool_call):
            raise ProgramError(
                f"work_offset or tool_call is stated, programs of the dialect {dialect.name} are native statements "
                "without them: leave them out"
            )
        on, off = ([dialect.auxiliary[name][k] for name in dict.fromkeys(self.auxiliary)] for k in (0, 1))
        return [*filter(None, (self.work_offset, self.tool_call)), *on], list(dict.fromkeys(off))


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolChange:
    """A change of tool before a pass: the tool goes up, then these words call the next one with its offset.

    Parameters
    ----------
    call
        Words that call the tool, as in `ProgramStart`.
    tool
        Name of the tool.
    height
        Height above the highest clear plane at which it is called. [mm]
    """

    call: str
    tool: str
    height: float


def plain(text: str) -> str:
    """Return text that is allowed in a controller's comment."""
    one_line = " ".join(text.split()).translate(str.maketrans("()", "[]"))
    return "".join(letter for letter in one_line if letter.isprintable()).encode("ascii", "replace").decode()


def comments(key: str, text: str) -> list[str]:
    """Return a comment, or several of at most 120 letters where the text is long."""
    return [f"( {key}: {part} )" for part in textwrap.wrap(plain(text), 100)]


def language(machine: Machine, dialect: Dialect) -> list[str]:
    """Return the comments on dialect and convention, which define the meaning of the numbers; every file has them."""
    return [f"( DIALECT: {dialect.name} )", f"( CONVENTION: {convention_line(machine)} )"]


def _feed_line(dialect: Dialect) -> str:
    if dialect.velocities:
        return (
            "( FEED: PVT IS THE TIME OF A BLOCK IN MS; THE VELOCITY AT ITS END FOLLOWS A COLON, MM/S OR DEG/S; "
            "F IS MM/S; FROM REST TO REST )"
        )
    meaning = "THE BLOCK TIME IN SECONDS" if dialect.feed == "seconds" else "1 / BLOCK TIME IN 1/MIN"
    validity = "" if dialect.feed_every_block else ", IN FORCE UNTIL THE NEXT F"
    return f"( FEED: UNDER G93, F IS {meaning}{validity}; WITH {dialect.feed_decimals} DECIMALS AT MOST )"


def stop_instructions(dialect: Dialect, *, has_c: bool = True) -> tuple[str, ...]:
    """Return instructions for the operator after a program, with C as an axis or not, was stopped, as sentences."""
    restart = "Retract in Z first, then begin the pass again with its approach"
    if dialect.wrapped or not has_c:
        return (restart,)
    unwind = "Before that, set C by whole turns to within 360 deg of the start of that approach, or it unwinds"
    return restart, unwind


def lines(
    header: ProgramHeader,
    machine: Machine,
    dialect: Dialect,
    passes: Sequence[ProgramPass],
    approaches: Sequence[Approach],
    begins: Sequence[str],
    links_s: float,
    spindle: Sequence[str],
    start: ProgramStart,
    changes: Mapping[str, ToolChange],
) -> list[str]:
    """Return the header as comment lines.

    ``begins`` are the C words at which the approaches begin, and ``spindle`` the words that start the spindle, empty
    for passes with C as an axis.
    """
    convention = machine.convention
    written = [SIGNATURE, f"( SOFTWARE: {SOFTWARE} )"]
    for key in ("design", "tool", "notes"):
        text = getattr(header, key)
        written += comments(key.upper(), text) if text else []
    away, outward, turning = ("GROWS" if axis_signs(machine)[letter] > 0 else "FALLS" for letter in "XZC")
    counting = "CUMULATIVE FROM PASS TO PASS; FROM C BELOW IS WITHOUT WHOLE TURNS"
    if dialect.wrapped:
        counting = "WRITTEN FROM 0 TO 360, SHORT WAY"
    dialect_comment, convention_comment = language(machine, dialect)
    has_c = not all(spindle)
    c_lines = [
        f"( C: {turning} WITH THE AZIMUTH OF THE PART UNDER THE TOOL, {counting} )",
        f"( MARK: C = {np.rad2deg(convention.clocking) + 0.0:.5f} WHERE THE +X MARK OF THE PART IS UNDER THE TOOL )",
    ]
    spindle_feed = ["( FEED: UNDER G94, F IS MM/MIN ALONG THE PATH; UNDER G95, MM/REV )"]
    written += [
        f"( DATE: {plain(header.date)} )",
        f"( MACHINE: {plain(machine.name)} )",
        dialect_comment,
        "( UNITS: MM AND DEGREES, ABSOLUTE )",
        *([_feed_line(dialect)] if has_c else []),
        *(spindle_feed if any(spindle) else []),
        f"( X: {away} AWAY FROM THE AXIS ON THE SIDE WHERE THE TOOL CUTS )",
        f"( Z: {outward} OUT OF THE PART, TOWARD THE TOOL )",
        *(c_lines if has_c else []),
        convention_comment,
        f"( SPINDLE: {_spindle_line(spindle)}; M03 IS CLOCKWISE SEEN FROM BEHIND THE SPINDLE )",
        *_before_start(start),
    ]
    for cut, approach, begin, turning in zip(passes, approaches, begins, spindle, strict=True):
        if (change := changes.get(cut.name)) is not None:
            written.append(f"( TOOL FROM {cut.name}: {change.call}{plain(f', {change.tool}' if change.tool else '')} )")
        written.append(f"( ENTRY {cut.name}: {entry_words(approach).upper()} )")
        if not dialect.wrapped and not turning:
            written.append(f"( APPROACH {cut.name}: BEGINS AT {begin} )")
        c = "GROWS" if cut.sense * convention.c_sense > 0 else "FALLS"
        written.append(
            f"( TURNS {cut.name}: {plain(turning) if turning else f'C {c}'}, SEEN FROM THE TOOL "
            f"THE PART TURNS {'CLOCKWISE, AS M04' if cut.sense > 0 else 'COUNTER-CLOCKWISE, AS M03'} )"
        )
        written.append(
            f"( CUT {cut.name}: {cut.points} POINTS, {cut.minutes:.3f} MINUTES, FROM C {cut.first_c:.6f}, "
            f"SENSE {cut.sense:+d}, SHA256 {cut.hash} )"
        )
    written += [
        f"( MINUTES: {sum(cut.minutes for cut in passes):.3f} )",
        f"( LINKS: {links_s / 60:.3f} MINUTES FOR APPROACH, PLUNGE AND RETRACT )",
        *(
            f"( AFTER A STOP: {instruction.upper()} )"
            for instruction in stop_instructions(dialect)[: None if has_c else 1]
        ),
    ]
    return written


def _before_start(start: ProgramStart) -> list[str]:
    selected = {"WORK OFFSET": start.work_offset, "TOOL": start.tool_call}
    missing = [what for what, words in selected.items() if not words]
    return [f"( BEFORE THE START: SELECT {' AND '.join(missing)} )"] if missing else []


def _spindle_line(spindle: Sequence[str]) -> str:
    if not any(spindle):
        return "C AXIS, NO M03 OR M04"
    return "SPINDLE MODE" if all(spindle) else "SPINDLE MODE WHERE A PASS STATES M03 OR M04, ELSE C AXIS"


FIELD = re.compile(r"^\( ([A-Z]+): (.*) \)$")
CUT = re.compile(
    r"^\( CUT (.{1,60}): (\d{1,15}) POINTS, (\d{1,15}\.\d{1,15}) MINUTES, FROM C (-?\d{1,15}\.\d{1,15}), "
    r"SENSE ([+-]1), SHA256 ([0-9a-f]{64}) \)$"
)


def _from_signature(head: bytes) -> str:
    """Return the text of a file without the lines that a dialect may have before the signature."""
    return BEGIN.sub("", head.removeprefix(BOM).decode("latin-1").replace("\r\n", "\n"), count=1)


def is_signed(head: bytes, *signatures: str) -> bool:
    """Return whether a file that begins with these bytes has one of the signatures."""
    return _from_signature(head).lstrip("; ").startswith(signatures)


def read_info(path: Path, signature: str = SIGNATURE) -> ProgramInfo | None:
    """Return the contents of a file's header, or ``None`` if the file does not begin with the signature."""
    require_regular(path)
    with path.open("rb") as file:
        text = _from_signature(file.read(1 << 18))
    rows = [row.lstrip("; \t").rstrip() for row in text.splitlines()]
    if not rows or rows[0] != signature:
        return None
    fields: dict[str, list[str]] = {}
    passes = []
    for row in rows[1:]:
        if not row.startswith("("):
            break
        if match := CUT.match(row):
            name, points, minutes, first_c, sense, digest = match.groups()
            passes.append(
                ProgramPass(
                    name=name,
                    points=int(points),
                    minutes=float(minutes),
                    first_c=float(first_c),
                    sense=int(sense),
                    hash=digest,
                )
            )
        elif match := FIELD.match(row):
            fields.setdefault(match[1], []).append(match[2])
    entries = {key: " ".join(parts) for key, parts in fields.items()}
    return ProgramInfo(
        header=ProgramHeader(**{key: entries.get(key.upper(), "") for key in ("design", "tool", "date", "notes")}),
        software=entries.get("SOFTWARE", ""),
        machine=entries.get("MACHINE", ""),
        dialect=entries.get("DIALECT", ""),
        convention=entries.get("CONVENTION", ""),
        passes=tuple(passes),
    )


def require_regular(path: Path) -> None:
    """Raise for a device or a pipe, which may be endless."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ProgramError(f"{path} is a device or a pipe, it must be a file on disk: give one")


def inspect_nc(path: str | PathLike[str]) -> ProgramInfo:
    """Return the contents of a program's header, without reading its cuts.

    Raises
    ------
    ProgramError
        If the file cannot be opened or was not written by Turnwright.
    """
    path = Path(path)
    with reading(path):
        info = read_info(path)
    if info is None:
        raise ProgramError(
            f"{path} has no Turnwright header, its first line must be {SIGNATURE!r}: read it with read_nc"
        )
    return info
