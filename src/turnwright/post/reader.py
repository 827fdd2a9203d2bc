"""Read NC programs: plain cutting blocks in bulk, all other lines word by word."""

from __future__ import annotations

import hashlib
import mmap
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice, pairwise
from os import PathLike
from pathlib import Path
from string import ascii_lowercase, ascii_uppercase
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turnwright._arrays import Floats, Ints
from turnwright._kernels import text as kernel
from turnwright.errors import InputError, ProgramError
from turnwright.machine import Machine
from turnwright.path import Motion, SpindleMode
from turnwright.post.convention import axis_signs, convention_line, motion_of, reading
from turnwright.post.dialect import Dialect, dialect_of
from turnwright.post.header import (
    BEGIN_BYTES,
    BOM,
    EACH_TIME,
    ENTRY,
    SIGNATURE,
    SUB_SIGNATURE,
    ProgramInfo,
    ProgramPass,
    ProgramWarning,
    bytes_to_hash,
    is_signed,
    read_info,
)
from turnwright.post.macro import Macros
from turnwright.post.spindle import Spindle, origin_bytes, turning_number
from turnwright.progress import Progress

__all__ = ["Move", "ProgramCut", "read_cut_and_moves", "read_moves", "read_nc"]

BUFFER_BYTES = 1 << 20
UPPERCASE = str.maketrans(ascii_lowercase, ascii_uppercase)
"""Translation to upper case of ASCII letters only."""

MAX_LINE_BYTES = 1 << 16
HASH_POINTS = 1 << 14
"""Points hashed at a time, few enough to stay in the cache."""
MAX_CALL_DEPTH = 8
MAX_CALLS = 1000
"""Calls of one file; nested calls would otherwise multiply without limit."""
MAX_NUMBER = 1e9
MAX_MOVES = 100_000
MAX_LOOPS = 20
"""Loops within one another."""
MAX_REPEATS, MAX_REPEATED_BYTES = 10_000, 100_000_000
"""Repetitions of loops in a program, and the text that they repeat; more comes from a loop that does not end."""
NO_NAME = "\x00"
"""Name that no pass has."""
COPY_AGAIN = "copy all files of the program again from where they were written"
"""Remedy for an incomplete program."""
AXES = "CXYZ"
CALL_MARK = "\x00"
"""Placeholder of a call in a block without comments; it does not occur in text."""
MAX_QUOTED = 40
"""Characters of a name or a line in a message."""
KNOWN_LETTERS = frozenset("CXYZFTSODHPLQ")
"""Letters that move the known axes, or no axis; others are allowed with the value 0 only."""
# Slots of the kernel's state, as in turnwright._kernels.text.
LINEAR, FEED_MODE, OPEN, FEED_UNIT, LINES, Y_SEEN = range(6)
FEED = 4

IGNORED_G = frozenset({4, 8, 15, 17, 18, 19, 21, 40, 43, 49, 61, 63, 64, 69, 71, 80, 90, 103, 144})
"""Planes, offsets set once, metric units, corner modes, cancellations: no motion of the tool relative to the part."""
MACHINE_G = frozenset({28, 30, 53})
"""Moves in machine coordinates, after which the position relative to the part is unknown."""
WORK_OFFSET_G = frozenset({54, 55, 56, 57, 58, 59})
SHIFT_G = frozenset({50, 52})
"""Shifts of the origin, whose meaning differs among controllers; ignored without axis words or with 0."""
SET_G = 92
"""Assigns new coordinates to the current position."""
UNSET_G = frozenset({92.1, 92.2})
GROUPS: tuple[set[float], ...] = (
    {0, 1, 2, 3},
    {4, 28, 30, 50, 52, 53, 92, 92.1, 92.2},
    {17, 18, 19},
    {20, 21},
    {43, 49},
    {54, 55, 56, 57, 58, 59},
    {61, 63, 64},
    {70, 71},
    {90, 91},
    {93, 94, 95},
    {96, 97},
)
"""Groups of G codes of which a block may have one."""

# All repeats are possessive, as backtracking over long runs of blanks would hang.
COMMENT = re.compile(r"\([^()]*+(?:\([^()]*+\)\s*+)?+\)|;.*$")
"""A comment, which may contain a bracket at its end."""
CALL = re.compile(r"M\s*+98\s*+(?:\(([^()<>\r\n]++)\)|<([^()<>\r\n]++)>)", re.IGNORECASE)
PARTS = re.compile(f"{CALL.pattern}|{COMMENT.pattern}|(?P<stray>[()])", re.IGNORECASE)
REPEAT = re.compile(r"(?:L\s*+0*+([1-9]\d{0,2}))?+")
"""Number of repetitions of a call."""
PASS = re.compile(r"\(\s*+PASS:([^()\r\n]++)\)", re.IGNORECASE)
PART = re.compile(r"PART (\d{1,9}) OF \d{1,9}", re.IGNORECASE)
MOVES = re.compile(r"(?<![A-Z#])[CXYZ]\s*+[-+.\d#\[]", re.IGNORECASE)
"""A word that moves an axis."""
DELETED = re.compile(r"\s*+(?:N\s*+\d++\s*+)?/[1-9]?", re.IGNORECASE)
"""Start of a block that the block-delete switch skips."""
TOKEN = re.compile(r"([A-Z])\s*(?:([+-]?(?:\d+\.?\d*|\.\d+))|(\[|[+-]?#))", re.IGNORECASE)
SPEED = re.compile(r":([+-]?(?:\d+\.?\d*|\.\d+))")
NATIVE = re.compile(r"(ABS|LINEAR|RAPID|DWELL\s*\d+\.?\d*|PVT\s*(\d+\.?\d*|\.\d+))")
"""Statements of a controller with velocities (PVT)."""
NAME = re.compile(r"<[A-Z0-9.+_-]{1,80}>")
"""The name of a program file."""

LIMIT = re.compile(r"LIMS\s*=\s*(\d+\.?\d*)")
"""The highest spindle speed under G96 on some controllers."""

ASSIGN = re.compile(r"#\s*(\d{1,9})\s*=(.*)")
WHILE = re.compile(r"WHILE\s*\[(.+)\]\s*DO\s*(\d{1,9})", re.IGNORECASE)
END = re.compile(r"END\s*(\d{1,9})", re.IGNORECASE)
OTHER = re.compile(r"IF|GOTO|O\s*<|#")


def read_nc(
    path: str | PathLike[str],
    machine: Machine,
    *,
    name: str | None = None,
    block_delete: bool | None = None,
    progress: Progress | None = None,
) -> Motion:
    """Read one pass of a program, written by Turnwright or not, as the commanded motion.

    The motion begins where the first cutting block begins and has one point more than there are blocks. A cutting
    block is a straight feed move (G1) that turns C, or one of X while the spindle runs (M03 or M04 in spindle mode);
    moves before, between and after the cuts are followed but not returned. Time begins at 0, C is cumulative, and the
    coordinates are those in which the program begins. The time of dwells (G4) is not counted. A program with
    Turnwright's header is checked against it.

    Parameters
    ----------
    path
        The main program, or a single sub-program.
    machine
        Machine with the dialect (which defines F) and the convention.
    name
        The pass to read: its name, or "cut 1", "cut 2", ... in a program without names. By default the last one.
    block_delete
        State of the block-delete switch: true skips blocks that begin with a slash, false executes them. A program with
        such blocks is refused if it is not given.
    progress
        Called with (bytes read, total bytes).

    Raises
    ------
    ProgramError
        If a file cannot be read or is damaged, commands anything other than a C X Z (Y) motion, has no such pass, or
        has another number of points than its header states.

    Warns
    -----
    ProgramWarning
        If there are several unnamed cuts and no name was given (only one is read), the hash in the header differs (the
        program was edited), a file has no end (M30 or M02, M99 in a sub-program, or a second percent sign; it may be
        truncated), or axes move in blocks after the M30, M02 or M99 of a file (they are skipped).

    Sources
    -------
    Kramer, Proctor, Messina: The NIST RS274NGC Interpreter, Version 3, NISTIR 6556 (2000): 3.5.18 for G92, 3.5.19 for
    feeds, 3.3.1 and 2.2.3 for the end of a program and for block delete. LinuxCNC, `convert_feed_mode`: G94 ends the F
    in force.
    """
    return _read_cut(Path(path), machine, name, block_delete, progress)[0]


def _read_cut(
    path: Path,
    machine: Machine,
    name: str | None,
    block_delete: bool | None,
    progress: Progress | None,
    watch: _Watch | None = None,
) -> tuple[Motion, tuple[Move, ...]]:
    """Return the motion of a pass, and the moves of the whole program if they are watched."""
    dialect = dialect_of(machine)
    with reading(path):
        info = read_info(path)
        part = read_info(path, SUB_SIGNATURE)
        if part is not None:
            _require_language(path, part, machine, dialect)
        header_pass = _pass_in_header(path, info, machine, dialect, name)
        with ThreadPoolExecutor(1) as pool:
            reader = _Reader(
                path, machine, name=header_pass.name if header_pass else name, header_pass=header_pass,
                block_delete=block_delete, pool=pool, progress=progress, watch=watch,
            )  # fmt: skip
            reader.run()
            cut, digest = reader.finish()
    for warning in reader.warnings:
        warnings.warn(warning, ProgramWarning, stacklevel=3)
    if header_pass is not None and digest != header_pass.hash:
        warnings.warn(
            f"{path}: pass {_shorten(header_pass.name)} has the hash {digest[:12]}..., the header states "
            f"{header_pass.hash[:12]}...: it was edited or damaged",
            ProgramWarning,
            stacklevel=3,
        )
    return _motion(path, cut, header_pass, machine), reader.listed_moves


class Move(NamedTuple):
    """A move of a program outside its cuts with C as an axis, in the axes of the part.

    Parameters
    ----------
    line
        Number of its line in its file.
    is_rapid
        Whether it is one in rapid (G0).
    start, end
        C [rad], X and Z [mm] before and after it; nan where a position is not known.
    turns
        Whether the part rotates: the spindle runs, or C turns in this move.
    cuts
        Number of cuts with C as an axis before it.
    spindle_cut
        Number of the cut in spindle mode of which it is a block; 0 for other moves.
    changes
        Number of changes of tool after a cut before it.
    tool
        Number of the tool that is called, 0 if none is.
    """

    line: int
    is_rapid: bool
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    turns: bool
    cuts: int
    spindle_cut: int
    changes: int
    tool: float


class ProgramCut(NamedTuple):
    """A cut of a program, with C as an axis or in spindle mode, or the plunge before it.

    Parameters
    ----------
    is_entry
        Whether it is a plunge.
    changes, tool
        As of a `Move`.
    motion
        Its motion, see `read_nc`.
    lines
        First block of consecutive lines, their file, and the number of the line before them.
    """

    is_entry: bool
    changes: int
    tool: float
    motion: Motion
    lines: tuple[tuple[int, Path, int], ...]

    def line(self, block: int) -> int:
        """Return the number of the line of a block, from 0, in its file."""
        first, path, number = next(one for one in reversed(self.lines) if one[0] <= block)
        with path.open("rb") as file:
            for at, line in enumerate(islice(file, number, None), number + 1):
                first += MOVES.search(COMMENT.sub(" ", line.decode("latin-1"))) is not None
                if first > block:
                    return at
        return number + 1


class _Watch(NamedTuple):
    """What is reported of a program besides the requested cut: all moves outside cuts, and cuts or only plunges."""

    inspect: Callable[[ProgramCut], None] | None
    only_plunges: bool


def read_moves(
    path: str | PathLike[str],
    machine: Machine,
    *,
    inspect: Callable[[ProgramCut], None] | None = None,
    only_plunges: bool = False,
    block_delete: bool | None = None,
) -> tuple[Move, ...]:
    """Return the moves of a whole program in their order, without the blocks of cuts with C as an axis, see `read_nc`.

    ``inspect`` is called with every cut and every plunge on the way, one in memory at a time, or with the plunges
    alone. Cuts that are no motion, such as with C turning back, are left out: `read_nc` refuses them.

    Raises
    ------
    ProgramError
        As `read_nc`; and if there are more than `MAX_MOVES`.
    """
    path = Path(path)
    with reading(path), ThreadPoolExecutor(1) as pool:
        reader = _Reader(
            path, machine, name=NO_NAME if inspect is None or only_plunges else None, header_pass=None,
            block_delete=block_delete, pool=pool, progress=None, watch=_Watch(inspect, only_plunges),
        )  # fmt: skip
        reader.run()
    return reader.listed_moves


def read_cut_and_moves(
    path: str | PathLike[str],
    machine: Machine,
    *,
    name: str,
    inspect: Callable[[ProgramCut], None] | None = None,
    progress: Progress | None = None,
) -> tuple[Motion, tuple[Move, ...]]:
    """Return one pass of a program as `read_nc`, and all moves as `read_moves`, with one reading of its files.

    ``inspect`` is called with the plunges alone.
    """
    return _read_cut(Path(path), machine, name, None, progress, _Watch(inspect, only_plunges=True))


def _pass_in_header(
    path: Path, info: ProgramInfo | None, machine: Machine, dialect: Dialect, name: str | None
) -> ProgramPass | None:
    """Return the entry of the requested pass in the header, if there is one; refuse a program for another machine."""
    if info is None:
        return None
    _require_language(path, info, machine, dialect)
    for entry in info.passes:
        if entry.name == name:
            return entry
    if not info.passes:
        raise ProgramError(f"{path} names no pass in its header, it must name at least 1: {COPY_AGAIN}")
    if name is not None:
        raise ProgramError(
            f"{path} has no pass {_shorten(name)!r}, it has {_list_names([entry.name for entry in info.passes])}: name "
            "one of these"
        )
    return info.passes[-1]


def _shorten(text: str) -> str:
    return text if len(text) <= MAX_QUOTED else f"{text[:MAX_QUOTED]}..."


def _list_names(names: Sequence[str]) -> str:
    more = [f"{len(names) - 4} more"] if len(names) > 5 else []
    return ", ".join([_shorten(name) for name in names[: 4 if more else 5]] + more) or "none"


def _require_language(path: Path, info: ProgramInfo, machine: Machine, dialect: Dialect) -> None:
    if not info.dialect or not info.convention:
        raise ProgramError(f"{path} has a header without dialect or convention, it is truncated: {COPY_AGAIN}")
    if info.dialect != dialect.name:
        raise ProgramError(
            f"{path} is written in the dialect {_shorten(info.dialect)}, machine {machine.name} has {dialect.name}: "
            "read it with the machine that it was written for"
        )
    if info.convention != convention_line(machine):
        raise ProgramError(
            f"{path} is written for the convention {info.convention[:80]}, machine {machine.name} has "
            f"{convention_line(machine)}: read it with the machine that it was written for"
        )


class _Loop(NamedTuple):
    """A loop of a program: its file and condition, where its first line is, and the number of the line before."""

    path: Path
    condition: str
    start: int
    line: int


@dataclass(slots=True)
class _Cut:
    """Consecutive cutting blocks, in the controller's units."""

    name: str
    named: bool
    rows: Floats  # (5 or 9, capacity): C [deg], X, Y, Z [mm], duration [s] (0 at the first point); 4 velocities, if any
    points: int = 1
    blocks: int = 0
    has_y: bool = False
    timed: bool = False
    """Whether its first block has a time (G93), which a positioning block never has."""
    spindle: Spindle | None = None
    """How the spindle runs in a cut in spindle mode, whose durations are revolutions instead."""
    mode: SpindleMode | None = None
    """Feed and speed of its first block."""
    lines: list[tuple[int, Path, int]] = field(default_factory=list)
    """First block of consecutive lines, their file, and the number of the line before them; where requested"""
    changes: int = 0
    tool: float = 0.0
    """As of a `Move`"""
    shifts: list[tuple[int, Floats]] = field(default_factory=list)
    """First column, and shift of the part's C, X, Y, Z relative to the program's from there on. (4,) [deg, mm]"""


def _apply_shifts(cut: _Cut) -> None:
    """Turn the positions of a cut from the program's coordinates into the part's, in place."""
    for (start, shift), (stop, _) in pairwise([*cut.shifts, (cut.points, np.zeros(4))]):
        for k in np.flatnonzero(shift):
            cut.rows[k, start:stop] += shift[k]


def _spindle_motion(path: Path, cut: _Cut, machine: Machine) -> Motion:
    """Return the motion of a cut in spindle mode."""
    assert cut.spindle is not None and cut.mode is not None  # noqa: S101, PT018 - for the type checker
    rows, signs = cut.rows[:, : cut.points], axis_signs(machine)
    x, z = rows[1] * signs["X"], rows[3] * signs["Z"]
    try:
        return cut.mode.motion(x, z, machine, sense=cut.spindle.sense, turns=rows[4, 1:])
    except InputError as error:
        raise ProgramError(f"{path} does not hold a motion: {error}") from error


def _motion(path: Path, cut: _Cut, header_pass: ProgramPass | None, machine: Machine) -> Motion:
    dialect = dialect_of(machine)
    rows = cut.rows[:, : cut.points]
    within_one_turn = bool(rows[0].min() >= 0 and rows[0].max() <= 360)
    _apply_shifts(cut)
    if cut.spindle is not None:
        return _spindle_motion(path, cut, machine)
    axes: dict[str, Floats] = {letter: rows[k] for k, letter in enumerate(AXES) if letter != "Y" or cut.has_y}
    first = header_pass.first_c if header_pass else rows[0, 0] - 360 * np.rint(cut.shifts[0][1][0] / 360)
    # A cumulative C is exact for blocks of any angle; one that rolls over takes the short way.
    cumulative = not (within_one_turn and dialect.wrapped)
    bad = kernel.count_on(axes["C"], first) if cumulative else -1
    if not cumulative or (bad >= 0 and within_one_turn):
        bad = kernel.unwrap(axes["C"], first)
        cumulative = False
    if bad >= 0:
        reason = "" if within_one_turn else " (it leaves 0 to 360, so it does not roll over)"
        alternative = "or not at all" if cumulative else "not at all or by half a turn"
        raise ProgramError(
            f"{path}: block {bad} of {cut.name} turns C backwards, {alternative}, to {axes['C'][bad]:g}{reason}, the "
            "sense of rotation must not change: split the program there"
        )
    time = rows[4]
    kernel.clock(time)
    velocity = None
    if rows.shape[0] > 5:
        factors = {letter: sign * (np.pi / 180 if letter == "C" else 1) for letter, sign in axis_signs(machine).items()}
        velocity = {letter: rows[5 + AXES.index(letter)] * factors[letter] for letter in axes}
    return motion_of(path, axes, time, machine, velocity)


def _pass_name(text: str) -> tuple[str, int] | None:
    """Return the pass that a comment names, and the number of its part that follows."""
    match = PASS.search(text)
    if match is None or not (name := match[1].strip()):
        return None
    before, comma, after = name.rpartition(",")
    part = PART.fullmatch(after.strip()) if comma else None
    return (before.strip(), int(part[1])) if part else (name, 1)


def _allocate(capacity: int, height: int) -> Floats:
    """Return memory for the blocks of a cut. (height, capacity).

    NumPy would request huge pages, which on virtual machines can double the reading time.
    """
    return np.frombuffer(mmap.mmap(-1, height * 8 * capacity)).reshape(height, capacity)


class _Reader:
    """The state of a controller that follows a program."""

    def __init__(
        self,
        path: Path,
        machine: Machine,
        *,
        name: str | None,
        header_pass: ProgramPass | None,
        block_delete: bool | None,
        pool: ThreadPoolExecutor,
        progress: Progress | None,
        watch: _Watch | None,
    ) -> None:
        self.path, self.machine, self.requested, self.header_pass = path, machine, name, header_pass
        self.dialect, self.watch = dialect_of(machine), watch
        self.block_delete, self.pool, self.progress = block_delete, pool, progress
        self.state: Ints = np.zeros(6, dtype=np.int64)
        self.state[[LINEAR, FEED_MODE]] = 1, 94
        self.state[FEED_UNIT] = self.dialect.time_code
        self.height = 9 if self.dialect.velocities else 5
        self.speeds: dict[str, float] = {}  # velocities of the current block
        self.real: Floats = np.full(5, np.nan)  # C, X, Y, Z and F
        self.time_feed = np.nan  # F of G93, saved while G94 is active
        self.speed_feed = np.nan  # feed of straight moves in a program with velocities [mm/min]
        self.shift: Floats = np.zeros(4)  # by G92: the part's coordinates minus the program's
        self.begun: set[str] = set()  # axes whose first coordinate was set by G92
        self.lost: set[str] = set()  # axes whose position in the part's coordinates is unknown
        self.spindle = Spindle()
        self.moves: list[tuple[int, bool, Floats, Floats, bool, int, int, int, float]] = []  # if there is a watch
        self.changes = 0  # of tool, after a cut
        self.c_cuts = 0  # cuts with C as an axis
        self.work_offset = 54.0
        self.tool = self.length = 0.0  # T and H in force
        self.tool_change = ""  # change of tool or length since the last cut
        self.scratch: Floats = np.empty((self.height, 1 << 12))  # for blocks that were not requested
        self.macros = Macros(lambda what: self._error(what, "write it as a number"))
        self.loops: dict[int, _Loop] = {}  # by label
        self.here = self.next = 0  # positions in the file of this line and the next
        self.repeats = self.repeated = 0  # of loops, and their bytes
        self.visits: dict[str, int] = {}  # of passes that a loop repeats, by their name
        self.origin: Floats = np.zeros(4)  # where the dialect's local origin is, G92 apart
        self.named: str | None = None
        self.cut: _Cut | None = None
        self.selected: _Cut | None = None
        self.cuts = 0
        self.names: list[str] = []
        self.unnamed: list[int] = []  # numbers of blocks of the unnamed cuts
        self.done = self.total = 0
        self.over = self.ended = False
        self.end = ""  # the code that ended the current file
        self.stack: list[Path] = []
        self.calls: dict[Path, int] = {}
        self.coded = False  # whether the current file has had a block
        self.warnings: list[str] = []
        self.hashing: Future[None] | None = None
        self.digest = hashlib.sha256()
        self.selected_digest = ""

    # ------------------------------------------------------------------ files
    def run(self) -> None:
        self.total = self.path.stat().st_size
        if self.total < BUFFER_BYTES:
            head = self.path.read_bytes().decode("latin-1")
            called = (self._sibling(call[1] or call[2]) for call in CALL.finditer(head))
            self.total += sum(file.stat().st_size for file in called if file is not None)
        self._file(self.path)
        self._close()
        self._report(self.total)

    def _report(self, done: int) -> None:
        if self.progress is not None:
            self.progress(done, self.total)

    def finish(self) -> tuple[_Cut, str]:
        """Return the requested cut and its hash."""
        points = 0 if self.selected is None else self.selected.points
        if self.header_pass is not None and points != self.header_pass.points:
            raise ProgramError(
                f"{self.path} has {points} points in pass {self.header_pass.name}, its header states "
                f"{self.header_pass.points}: {COPY_AGAIN}, or after an intended change, correct the header"
            )
        if self.selected is None:
            if self.requested is not None:
                raise ProgramError(
                    f"{self.path} has no pass {_shorten(self.requested)!r}, it has {_list_names(self.names)}: name one "
                    "of these"
                )
            raise ProgramError(
                f"{self.path} has no cutting block, at least 1 is needed: give a program whose G1 blocks turn C, or "
                "move X while the spindle runs (M03 or M04 with S)"
            )
        others = sum(self.unnamed) - self.selected.blocks
        ends = "a block that does not turn C" if self.selected.spindle is None else "a move of Z alone or a change of S"
        if self.requested is None and not self.selected.named and len(self.unnamed) > 1 and others > 0:
            self.warnings.append(
                f"{self.path} has {len(self.unnamed)} unnamed cuts, only {self.selected.name} is read and {others} of "
                f"{sum(self.unnamed)} blocks are skipped ({ends} ends a cut): give the name of the cut to read, such "
                'as "cut 1"'
            )
        return self.selected, self.selected_digest

    def _file(self, path: Path) -> None:
        if path in self.stack or len(self.stack) >= MAX_CALL_DEPTH:
            raise ProgramError(
                f"{path} is called by itself or more than {MAX_CALL_DEPTH} calls deep: give every pass its own "
                "sub-program"
            )
        self.calls[path] = self.calls.get(path, 0) + 1
        if self.calls[path] > MAX_CALLS:
            raise self._error(f"calls {_shorten(path.name)} more than {MAX_CALLS} times", "write out its passes")
        self.stack.append(path)
        outer, self.state[LINES] = self.state[LINES], 0
        before, loops, self.coded = self.real.copy(), set(self.loops), False
        with path.open("rb") as file:
            head = file.read(BEGIN_BYTES)
        has_signature = is_signed(head, SIGNATURE, SUB_SIGNATURE)
        begin = len(BOM) if head.startswith(BOM) else 0  # of the buffer, in the file
        for text_bytes, data, end in self._buffers(path):
            at = self._lines(text_bytes, data, end, begin, before)
            self._report(min(self.done, self.total))
            if self.over or self.ended:
                self._warn_of_blocks_after_end(path, begin + at)
                break
            begin += end
        if not (self.over or self.ended):
            if has_signature:
                raise self._error("is the last line, a complete file ends with M30 or M99", COPY_AGAIN)
            self._warn_of_missing_end(path, [label for label in self.loops if label not in loops])
        else:
            self._require_ends(path, [label for label in self.loops if label not in loops])
        self.over, self.coded = False, True
        self.state[LINES] = outer
        self.stack.pop()

    def _lines(self, text_bytes: bytearray, data: NDArray[np.uint8], end: int, begin: int, before: Floats) -> int:
        """Follow the lines in a buffer that holds a file from ``begin`` on; return where it ended or was left."""
        at = 0
        while at < end and not (self.over or self.ended):
            at, is_full = self._parse_blocks(data, at, end)
            if at < end and not is_full:
                stop = text_bytes.find(b"\n", at, min(at + MAX_LINE_BYTES, end)) + 1
                self.state[LINES] += 1
                if stop <= at:
                    raise self._error(f"is longer than {MAX_LINE_BYTES} bytes", "give a text file with line ends")
                self.coded = self.coded or not np.array_equal(before, self.real, equal_nan=True)
                self.here, self.next = begin + at, begin + stop
                self._line(text_bytes[at:stop].decode("latin-1"))
                at = stop
        return at

    def _repeat(self, loop: _Loop, label: int) -> None:
        """Follow the body of a loop again, as long as its condition holds."""
        path, end = self.stack[-1], self.here
        self.repeats, self.repeated = self.repeats + 1, self.repeated + end - loop.start
        if self.repeats > MAX_REPEATS or self.repeated > MAX_REPEATED_BYTES:
            raise self._error(
                f"repeats loops more than {MAX_REPEATS:,} times, or {MAX_REPEATED_BYTES // 10**6} MB of them",
                "check that the loop ends",
            )
        with path.open("rb") as file:
            file.seek(loop.start)
            body = file.read(end - loop.start)
        line, buffer = self.state[LINES], bytearray(body) + bytes(kernel.BEHIND)
        self.loops[label] = loop
        self.state[LINES] = loop.line
        self._lines(buffer, np.frombuffer(buffer, dtype=np.uint8), len(body), loop.start, self.real.copy())
        self.state[LINES], self.here = line, end

    def _parse_blocks(self, data: NDArray[np.uint8], at: int, end: int) -> tuple[int, bool]:
        """Read plain cutting blocks; return where another line begins, and whether there is no room for more blocks."""
        if self.spindle.runs:
            return at, False  # the few blocks in spindle mode are read word by word
        rows, first = self._free_columns()
        line = int(self.state[LINES])
        at, last = kernel.parse_blocks(data, at, end, self.state, self.real, rows, first)
        self._count_blocks(rows, first, last, line)
        return at, last == rows.shape[1]

    def _require_ends(self, path: Path, loops: list[int]) -> None:
        if not loops:
            return
        tail = path.read_bytes().upper().rpartition(b"WHILE")[2].decode("latin-1")
        ends = {int(end[1]) for line in tail.splitlines() if (end := END.fullmatch(COMMENT.sub(" ", line).strip()))}
        for label in loops:
            if label not in ends:
                raise self._error(f"ends the file within loop {label}, which has no END", "give each WHILE its END")
            del self.loops[label]

    def _warn_of_missing_end(self, path: Path, loops: list[int]) -> None:
        with path.open("rb") as file:
            file.seek(-min(path.stat().st_size, MAX_LINE_BYTES), 2)
            last = file.read().rpartition(b"\n")[2].decode("latin-1")
        signs = ["M30 or M02" if len(self.stack) == 1 else "M99"]
        if COMMENT.sub(" ", last).strip():
            signs.append(f"line {int(self.state[LINES])} has no line end")
        signs += [f"loop {label} has no END" for label in loops[-1:]]
        self._warn(
            f"{path} ends without {' and '.join([', and '.join(signs[:2]), *signs[2:]])}: it may be truncated, compare "
            "it with the file that was written"
        )

    def _warn_of_blocks_after_end(self, path: Path, position: int) -> None:
        blocks = 0
        with path.open("rb") as file:
            file.seek(position)
            while line := file.readline(MAX_LINE_BYTES).decode("latin-1"):
                if line.startswith("%"):
                    break
                blocks += MOVES.search(COMMENT.sub(" ", line)) is not None
        if blocks and self.end:
            self._warn(
                f"{path} continues after the {self.end} in line {int(self.state[LINES])}: {blocks} blocks that move "
                f"axes are skipped; if they belong to the program, remove the {self.end}"
            )

    def _warn(self, warning: str) -> None:
        if warning not in self.warnings:
            self.warnings.append(warning)

    def _buffers(self, path: Path) -> Iterator[tuple[bytearray, NDArray[np.uint8], int]]:
        """Yield the file in pieces, as bytes and as an array on the same memory, with the end of the last full line.

        The memory is reused for the next piece.
        """
        buffer = bytearray(BUFFER_BYTES + MAX_LINE_BYTES + 1 + kernel.BEHIND)
        data = np.frombuffer(buffer, dtype=np.uint8)
        carried = 0  # bytes of an incomplete line
        with path.open("rb") as file:
            file.seek(len(BOM) if file.read(len(BOM)) == BOM else 0)
            while count := file.readinto(memoryview(buffer)[carried : carried + BUFFER_BYTES]):
                self.done += count
                filled = carried + count
                end = buffer.rfind(b"\n", max(0, filled - MAX_LINE_BYTES), filled) + 1
                if not end and filled > MAX_LINE_BYTES:
                    raise self._error(f"is longer than {MAX_LINE_BYTES} bytes", "give a text file with line ends")
                yield buffer, data, end
                carried = filled - end
                buffer[:carried] = buffer[end:filled]
        buffer[carried] = 10
        yield buffer, data, carried + 1

    def _error(self, what: str, remedy: str) -> ProgramError:
        where = self.stack[-1] if self.stack else self.path
        return ProgramError(f"{where} line {int(self.state[LINES]) or 1} {what}: {remedy}")

    # ------------------------------------------------------------------- cuts
    def _free_columns(self) -> tuple[Floats, int]:
        """Return the array for the next blocks, and its first free column."""
        cut = self.cut
        if cut is None or not self._is_requested(cut):
            return self.scratch, 0
        if cut.points == cut.rows.shape[1]:
            wider = _allocate(2 * cut.points, self.height)
            wider[:, : cut.points] = cut.rows
            cut.rows = wider
        return cut.rows, cut.points

    def _is_requested(self, cut: _Cut) -> bool:
        return self.requested in (None, cut.name) or self._is_inspected(cut)

    def _is_inspected(self, cut: _Cut) -> bool:
        watch = self.watch
        return watch is not None and watch.inspect is not None and (not watch.only_plunges or cut.name.endswith(ENTRY))

    def _inspect(self, cut: _Cut) -> None:
        assert self.watch is not None and self.watch.inspect is not None  # noqa: S101, PT018 - for the type checker
        if np.isnan(cut.rows[[0, 1, 3], : cut.points]).any():
            return
        try:
            motion = _motion(self.path, cut, None, self.machine)
        except ProgramError:
            return
        self.watch.inspect(ProgramCut(cut.name.endswith(ENTRY), cut.changes, cut.tool, motion, tuple(cut.lines)))

    @property
    def listed_moves(self) -> tuple[Move, ...]:
        """The moves outside cuts, if there is a watch, in the axes of the part."""
        signs, clocking = axis_signs(self.machine), self.machine.convention.clocking

        def place(position: Floats) -> tuple[float, float, float]:
            c, x, _, z = position.tolist()
            return float(np.deg2rad(c) * signs["C"] - signs["C"] * clocking), x * signs["X"], z * signs["Z"]

        return tuple(
            Move(line, rapid, place(start), place(end), turns, cuts, spindle_cut, changes, tool)
            for line, rapid, start, end, turns, cuts, spindle_cut, changes, tool in self.moves
        )

    def _count_blocks(self, rows: Floats, first: int, last: int, line: int) -> None:
        """Count the new blocks in columns first to last - 1 after a line, and hash them in another thread."""
        cut = self.cut
        if cut is None or last == first:
            return
        if self._is_inspected(cut):
            cut.lines.append((cut.blocks, self.stack[-1], line))
        cut.blocks += last - first
        if rows is self.scratch:
            return
        cut.points = last
        self._submit(rows, first, last)

    def _submit(self, rows: Floats, first: int, last: int) -> None:
        if self.header_pass is not None:
            self._drain()
            letters = [letter for letter in self.dialect.decimals if letter != "Y" or self.state[Y_SEEN]]
            self.hashing = self.pool.submit(self._hash, rows[:, first:last], letters)

    def _hash(self, rows: Floats, letters: list[str]) -> None:
        for start in range(0, rows.shape[1], HASH_POINTS):
            part = rows[:, start : start + HASH_POINTS]
            each = 2 if self.dialect.velocities else 1
            units = np.empty((part.shape[1], each * len(letters)), dtype=np.int64)
            for column, letter in enumerate(letters):
                scale, row = 10.0 ** self.dialect.decimals[letter], AXES.index(letter)
                kernel.quantise(part[row], scale, 0.0, 0, units, each * column)
                if each == 2:
                    kernel.quantise(part[5 + row], scale, 0.0, 0, units, each * column + 1)
            self.digest.update(bytes_to_hash(units, part[4]))

    def _open(self, *, timed: bool, turning: float = 0.0) -> _Cut:
        """Begin a cut; ``turning`` stands for the spindle in the hash of a cut in spindle mode."""
        self.cuts += 1
        # As many points as the header states, limited by the length of the text, plus one, so that the array is not
        # enlarged when full.
        capacity = max(2, min(self.header_pass.points, self.total) + 1) if self.header_pass else 1 << 16
        cut = _Cut(
            name=self.named or f"cut {self.cuts}",
            named=self.named is not None,
            timed=timed,
            rows=_allocate(capacity, self.height),
            changes=self.changes,
            tool=self.tool,
        )
        cut.rows[:4, 0] = self.real[:4]
        cut.rows[4, 0] = turning
        cut.shifts.append((0, self.shift.copy()))
        self.cut = cut
        self.state[OPEN] = 1
        self._drain()
        self.digest = hashlib.sha256(origin_bytes(float(self.origin[3]), self.dialect))
        self._submit(cut.rows, 0, 1)
        return cut

    def _drain(self) -> None:
        if self.hashing is not None:
            self.hashing.result()
            self.hashing = None

    def _close(self) -> None:
        """End the open cut, if there is one, and select it if it is the requested one."""
        cut, self.cut = self.cut, None
        self.state[OPEN] = 0
        if cut is None:
            return
        if self._is_inspected(cut):
            self._inspect(cut)
        if cut.name.endswith(ENTRY):
            self.cuts -= 1  # the plunge before a cut
            return
        if not cut.named and (cut.blocks > 1 or cut.timed):
            self.unnamed.append(cut.blocks)
        if cut.blocks == 1 and not cut.named and cut.spindle is None:
            self.cuts -= 1  # a single block positions C, and is a cut only if there is no other
        elif cut.name not in self.names:
            self.names.append(cut.name)
        if self.requested is not None and cut.name != self.requested:
            return
        previous = self.selected
        if previous is not None and previous.blocks > 1 and cut.blocks == 1 and cut.spindle is None:
            return
        if previous is not None and previous.blocks > 1 and cut.named and previous.name == cut.name:
            raise self._error(
                f"ends a second cut in pass {_shorten(cut.name)}, of {cut.blocks} blocks after {previous.blocks}, only "
                "one is allowed",
                "name a pass for every cut",
            )
        cut.has_y = bool(self.state[Y_SEEN])
        self._drain()
        self.selected, self.selected_digest = cut, self.digest.hexdigest()

    # ------------------------------------------------------------------ lines
    def _line(self, text: str) -> None:
        if "\x00" in text:
            raise self._error("holds binary data", "give a program in plain text")
        if "\r" in text.rstrip():  # a line end for some controllers, a blank for others
            raise self._error(
                "has a carriage return (CR) within the line, lines must end with LF or CR LF",
                "save the program with such line ends",
            )
        text = self._apply_block_delete(text)
        if name := _pass_name(text):
            self._marker(*name)
        calls: list[str] = []
        bare = PARTS.sub(lambda part: self._part(part, calls), text).strip().translate(UPPERCASE)
        block, *after = bare.split(CALL_MARK)
        if calls:
            self._call_from(block.strip(), calls, after)
        else:
            self._follow_block(block)

    def _part(self, part: re.Match[str], calls: list[str]) -> str:
        """Return the replacement of a comment, or of a call, which is added to ``calls``."""
        if part["stray"]:
            raise self._error("has an unmatched bracket", "close the comment")
        if name := part[1] or part[2]:
            calls.append(name.strip())
            return CALL_MARK
        return " "

    def _call_from(self, block: str, calls: list[str], after: list[str]) -> None:
        """Follow a block that ends with a call; its own words are executed first."""
        repeat = REPEAT.fullmatch(after[0].strip())
        if repeat is None or len(calls) > 1 or re.search("[DHLPQ]", block):
            raise self._error(
                f"calls {_shorten(calls[0])} with more words, only L and a number of repetitions, 1 to 999, is allowed",
                "write the other words, or the other call, in a separate block",
            )
        self._follow_block(block)
        if self.over or self.ended:
            raise self._error("ends and calls a file", "write the call in a separate block")
        for _ in range(int(repeat[1] or 1)):
            self._call(calls[0])
            if self.ended:
                return

    def _follow_block(self, bare: str) -> None:
        if bare.startswith("%"):
            bare = self._tape_mark(bare)
        if not bare:
            return
        self.coded = True
        if len(bare) > 512:
            raise self._error("is longer than 512 characters without its comments", "give a program of plain blocks")
        if limit := LIMIT.fullmatch(bare):
            self.spindle = self.spindle._replace(highest=float(limit[1]))
        elif NAME.fullmatch(bare) or (self.dialect.velocities and self._native(bare)) or self._statement(bare):
            return
        else:
            self._words(bare)

    def _apply_block_delete(self, text: str) -> str:
        """Return a line without its block-delete slash, or nothing if the line is skipped."""
        slash = DELETED.match(text)
        if slash is None:
            return text
        block = text[slash.end() :]
        if self.block_delete is None and COMMENT.sub(" ", block).strip():
            raise self._error(
                "begins with a slash, the block-delete switch decides whether it is executed",
                "give block_delete, on the command line --block-delete or --no-block-delete",
            )
        return "" if self.block_delete else block

    def _tape_mark(self, bare: str) -> str:
        """Return the text after a percent sign: the first one begins a file, the second one ends it."""
        self.over, self.end = self.coded, ""
        self.coded = True
        return "" if self.over else bare.lstrip("%").strip()

    def _native(self, bare: str) -> bool:
        """Follow a statement of a controller with velocities; return whether the line is one."""
        statement = NATIVE.fullmatch(bare)
        if statement is None:
            return False
        if statement[2]:
            self.state[LINEAR], self.state[FEED_MODE], self.real[FEED] = 1, 93, float(statement[2])
        elif bare in {"LINEAR", "RAPID"}:
            self.state[LINEAR], self.state[FEED_MODE], self.real[FEED] = bare == "LINEAR", 94, self.speed_feed
        return True

    def _statement(self, bare: str) -> bool:
        """Follow a macro statement; return whether the line is one."""
        if assign := ASSIGN.fullmatch(bare):
            self.macros.variables[int(assign[1])] = self.macros.value(assign[2])
        elif loop := WHILE.fullmatch(bare):
            if int(loop[2]) in self.loops:
                raise self._error(f"begins loop {loop[2]} within itself", "give each loop its own number")
            if len(self.loops) == MAX_LOOPS:
                raise self._error(f"begins more than {MAX_LOOPS} loops within one another", "write them out")
            self.loops[int(loop[2])] = _Loop(self.stack[-1], loop[1], self.next, int(self.state[LINES]))
            if not self.macros.holds(loop[1]):
                raise self._error("begins a loop that runs 0 times", "give a program whose loop runs once")
        elif end := END.fullmatch(bare):
            label = next((one for one in reversed(self.loops) if self.loops[one].path == self.stack[-1]), None)
            if label != int(end[1]):
                expected = "no loop is open" if label is None else f"the innermost open loop is {label}"
                raise self._error(f"ends loop {end[1]}, {expected}", "give each WHILE its END")
            runs = self.loops[label]
            while self.macros.holds(runs.condition) and not self.ended:
                self._repeat(runs, label)
            self.loops.pop(label)
        elif OTHER.match(bare):
            raise self._error(f"is a statement that Turnwright does not support ({bare[:30]})", "give plain blocks")
        else:
            return False
        return True

    def _marker(self, name: str, part: int) -> None:
        if name.endswith(EACH_TIME):  # a pass that a loop repeats
            self.visits[name] = self.visits.get(name, 0) + 1
            name = f"{name.removesuffix(EACH_TIME)} {self.visits[name]}"
        if part == 1 or name != self.named:
            self._close()
            self.named = name
            self.tool_change = ""

    def _sibling(self, name: str) -> Path | None:
        name = name.strip()
        if len(name) > 255 or Path(name).name != name or "\\" in name:
            return None
        path = self.path.parent / name
        return path if path.is_file() else None

    def _call(self, name: str) -> None:
        path = self._sibling(name)
        if path is None:
            raise self._error(
                f"calls {_shorten(name)}, which is not in the same folder",
                "put all files of the program into one folder",
            )
        if self.header_pass is not None and self.watch is None:
            # Sub-programs of other passes are skipped: each names its pass in its first lines.
            with path.open("rb") as file:
                marker = _pass_name(file.read(512).decode("latin-1"))
            if marker and marker[0] != self.requested:
                self.done += path.stat().st_size
                return
        self._file(path)

    def _parse_words(self, bare: str) -> list[tuple[str, float]]:
        """Return the words of a block, and store its velocities."""
        words: list[tuple[str, float]] = []
        self.speeds = {}
        at = 0
        while at < len(bare):
            if bare[at].isspace():
                at += 1
                continue
            match = TOKEN.match(bare, at)
            if match is None:
                unread = bare[at : at + 20].encode("latin-1", "replace").decode("utf-8", "replace")
                raise self._error(
                    f"cannot be read at {unread!r}, a word is a letter and a fixed-point number",
                    "correct it",
                )
            letter = match[1]
            if match[2] is not None:
                value, at = float(match[2]), match.end()
                if self.dialect.velocities and (speed := SPEED.match(bare, at)):
                    self.speeds[match[1].upper()], at = float(speed[1]), speed.end()
            else:
                at = match.start(3)
                value, at = self.macros.factor(bare, at)
            if not abs(value) <= MAX_NUMBER:
                raise self._error(f"has {letter}{value:g}, the limit is {MAX_NUMBER:g}", "correct the number")
            words.append((letter, value))
        return words

    def _words(self, bare: str) -> None:
        words = self._parse_words(bare)
        codes = [value for letter, value in words if letter == "G"]
        self._follow_spindle(words, codes)
        for letter, value in words:
            if letter == "M":
                self._m(value, words)
        for group in GROUPS:
            if len(conflict := sorted(group & set(codes))) > 1:
                names = " and ".join(f"G{code:g}" for code in conflict)
                raise self._error(f"has {names}, only one of them is allowed in a block", "split the block")
        self._tooling(words, codes)
        for code in codes:
            self._g(code)
        values = {letter: value for letter, value in words if letter not in "GMN"}
        letters = [letter for letter, _ in words if letter not in "GMN"]
        if repeated := [letter for letter in values if letters.count(letter) > 1]:
            raise self._error(f"gives {', '.join(repeated)} two values", "keep one word of each letter")
        self._block(codes, values)

    def _follow_spindle(self, words: list[tuple[str, float]], codes: list[float]) -> None:
        """Follow speed and direction of the spindle in spindle mode; a change ends a cut."""
        spindle = self.spindle.follow(words, codes)
        is_stated = any(letter == "S" for letter, _ in words)
        if spindle.constant_surface != self.spindle.constant_surface and self.spindle.runs and not is_stated:
            raise self._error("changes between G96 and G97 without an S, whose unit changes", "give an S in that block")
        if spindle != self.spindle:
            self._close()
            self.spindle = spindle

    def _m(self, code: float, words: list[tuple[str, float]]) -> None:
        if code == 98:
            number = next((value for letter, value in words if letter == "P"), 0)
            raise self._error(f"calls sub-program {number:g} by number", "read the file of that sub-program")
        self.ended = self.ended or code in {2, 30}
        self.over = self.over or code == 99
        if code in {2, 30, 99}:
            self.end = f"M{code:02g}"

    def _tooling(self, words: list[tuple[str, float]], codes: list[float]) -> None:
        """Follow a change of tool or tool length, after which the position relative to the part is unknown."""
        changes = []
        for letter, value in words:
            if (letter == "T" and value != self.tool) or (letter == "M" and value == 6):
                changes.append(f"{letter}{value:g}")
        self.tool = next((value for letter, value in words if letter == "T"), self.tool)
        number = next((value for letter, value in words if letter == "H"), self.length)
        length = 0.0 if 49 in codes else number if number or 43 not in codes else -1.0
        if length != self.length:
            changes.append("G49" if 49 in codes else f"H{length:g}" if length > 0 else "G43")
            self.length = length
        if not changes:
            return
        if self.cuts:
            self.changes += any(one.startswith("T") for one in changes)
            self.tool_change = f"line {int(self.state[LINES])} changed the tool or its length ({', '.join(changes)})"
        self._close()
        self._lose("XYZ")

    def _g(self, code: float) -> None:
        if code in {0, 1}:
            self.state[LINEAR] = int(code)
        elif code in {93, 94, 95}:
            self._change_mode(int(code))
        elif code in WORK_OFFSET_G:
            if code != self.work_offset and not np.isnan(self.real[:4]).all():
                raise self._error(
                    f"changes the work offset from G{self.work_offset:g} to G{code:g} by an unknown distance",
                    "give a program with one work offset",
                )
            self.work_offset = code
        elif code in {20, 70}:
            raise self._error(f"selects inches (G{code:g}), only millimetres are allowed", "write the program in mm")
        elif code == 91:
            raise self._error("selects incremental moves (G91)", "write the program in absolute positions (G90)")
        elif code in {2, 3}:
            raise self._error(f"is an arc (G{code:g})", "write the program in straight blocks (G1)")
        elif code not in IGNORED_G | {96, 97} | MACHINE_G | SHIFT_G | UNSET_G | {SET_G}:
            raise self._error(f"has G{code:g}, which Turnwright does not support", "remove it, or write it with G1")

    def _change_mode(self, mode: int) -> None:
        """Change the meaning of F; an F of the other mode is not valid.

        A block time stays in force until an F is given as a speed.
        """
        if mode == self.state[FEED_MODE]:
            return
        feed = float(self.real[FEED])
        if mode != 93:
            self.time_feed = feed if self.state[FEED_MODE] == 93 else self.time_feed
            self.real[FEED] = np.nan
        else:
            self.real[FEED] = self.time_feed if np.isnan(feed) else np.nan
        self.state[FEED_MODE] = mode

    def _block(self, codes: list[float], values: dict[str, float]) -> None:
        axes = {letter: values[letter] for letter in AXES if letter in values}
        if MACHINE_G & set(codes):
            self._close()
            # Without words, or with distances (U, W), the axes concerned differ among controllers.
            self._lose(axes if axes and values.keys() <= KNOWN_LETTERS else AXES)
            return
        if 4 in codes:
            if axes.keys() - {"X"} or 1 in codes:
                raise self._error("moves and dwells (G4)", "write the dwell in a separate block")
            return  # the time of a dwell may be an X word
        others = [
            letter for letter, value in values.items() if letter not in KNOWN_LETTERS and (value or letter == "E")
        ]
        if others:
            raise self._error(
                f"has the word {', '.join(others)}, the axes are C, X, Y and Z in fixed-point numbers", "correct it"
            )
        if (SHIFT_G | UNSET_G | {SET_G}) & set(codes):
            self._coordinates(codes, axes, feed="F" in values)
            return
        if "F" in values:
            self._feed(values["F"])
        if axes:
            self._move(axes)

    def _feed(self, feed: float) -> None:
        """Set F; in a program with velocities it is the speed of straight moves in mm/s."""
        if not self.dialect.velocities:
            self.real[FEED] = feed
            return
        self.speed_feed = 60 * feed
        if self.state[FEED_MODE] == 94:
            self.real[FEED] = self.speed_feed

    def _lose(self, letters: Iterable[str]) -> None:
        for letter in letters:
            k = AXES.index(letter)
            if not np.isnan(self.real[k]):
                self.lost.add(letter)
            self.real[k] = np.nan

    def _coordinates(self, codes: list[float], axes: dict[str, float], *, feed: bool) -> None:
        if shifts := SHIFT_G & set(codes):
            if self.dialect.local_origin == "G52" and shifts == {52}:
                self._move_origin(axes)
            elif any(axes.values()) or (axes and 50 in shifts) or any(self._is_set(letter) for letter in axes):
                raise self._error(
                    f"shifts the origin within the program (G{min(shifts)})",
                    "give a program without shifts",
                )
        elif UNSET_G & set(codes):
            self._unset()
        elif axes and feed:
            raise self._error("is a thread-cutting cycle on some controllers (G92 with F)", "write G92 without F")
        else:
            self._set(axes)

    def _is_set(self, letter: str) -> bool:
        k = AXES.index(letter)
        return bool(self.shift[k] - self.origin[k]) or letter in self.begun

    def _set(self, axes: dict[str, float]) -> None:
        """Assign new coordinates to the current position; the tool does not move relative to the part."""
        for letter, value in axes.items():
            k = AXES.index(letter)
            if not np.isnan(self.real[k]):
                self.shift[k] += self.real[k] - value
            elif letter in self.lost:
                raise self._error(
                    f"sets {letter} where its position is unknown",
                    "give a program of one pass, or without G28, G30 and G53 before the G92",
                )
            else:
                self.begun.add(letter)
            self.real[k] = value
        self._note_shift()

    def _move_origin(self, axes: dict[str, float]) -> None:
        """Move the origin of the program to a place in the part's coordinates; the tool does not move."""
        for letter, value in axes.items():
            k = AXES.index(letter)
            moved = value - self.origin[k]
            self.origin[k], self.shift[k], self.real[k] = value, self.shift[k] + moved, self.real[k] - moved
        self._note_shift()

    def _unset(self) -> None:
        self.real[:4] += self.shift - self.origin
        self.shift[:] = self.origin
        self._lose(sorted(self.begun))
        self.begun.clear()
        self._note_shift()

    def _note_shift(self) -> None:
        if self.cut is not None:
            self.cut.shifts.append((self.cut.points, self.shift.copy()))

    def _move(self, axes: dict[str, float]) -> None:
        before = self.real[:4].copy()
        for letter, value in axes.items():
            self.real[AXES.index(letter)] = value
        if "Y" in axes and not self.state[Y_SEEN]:
            if self.cut is not None:
                raise self._error("moves Y for the first time within a cut", "give Y before the cut")
            self.state[Y_SEEN] = 1
        step = self.real[:4] - before
        if not self.state[Y_SEEN]:
            step[2] = 0.0
        if "C" in axes:
            self.spindle = self.spindle._replace(sense=0)  # C is an axis
        blocks = 0 if self.cut is None else self.cut.blocks
        if self.spindle.runs:
            self._turn(before, step)
        else:
            self._move_c(before, step)
        if self.spindle.runs or self.cut is None or self.cut.blocks == blocks:
            self._note_move(before, turns=self.spindle.runs or bool(abs(step[0]) > 0))

    def _note_move(self, before: Floats, *, turns: bool) -> None:
        if self.watch is None:
            return
        if len(self.moves) == MAX_MOVES:
            raise self._error(f"is the {MAX_MOVES:,}th move outside a cut", "give a program of fewer passes")
        line, rapid = int(self.state[LINES]), not self.state[LINEAR]
        spindle_cut = self.cuts if self.cut is not None and self.cut.spindle is not None else 0
        place = self.real[:4] + self.shift
        counts = (self.c_cuts, spindle_cut, self.changes, self.tool)
        self.moves.append((line, rapid, before + self.shift, place, turns, *counts))

    def _move_c(self, before: Floats, step: Floats) -> None:
        """Follow a move with C as an axis: a feed move of C is a cut, all others position the tool."""
        unknown = [letter for letter in sorted(self.lost - {"C"}) if np.isnan(step[AXES.index(letter)])]
        if self.state[LINEAR] and abs(step[0]) > 0 and unknown:
            ends = self.real[[AXES.index(letter) for letter in unknown]]
            if self.state[FEED_MODE] == 93 or np.isnan(ends).any():
                raise self._error(
                    f"turns C while the position of {', '.join(unknown)} is unknown",
                    f"give {', '.join(unknown)} in a block before, without C",
                )
        # A move with an unknown start, or one that does not turn C, positions the tool and does not cut.
        if self.state[LINEAR] and step[0] != 0 and not np.isnan(step).any():
            self._cut(before, step)
        elif np.any(step != 0):
            self._close()
        elif self.cut is not None:
            raise self._error("does not move within a cut", "remove the repeated point")

    def _turn(self, before: Floats, step: Floats) -> None:
        """Follow a move in spindle mode: a feed move of X is a cut, all others position the tool."""
        moves = step[[1, 3]]
        if not self.state[LINEAR] or step[1] == 0 or np.isnan(moves).any():
            if np.any(moves != 0):
                self._close()
            return
        spindle, feed, per_rev = self.spindle, float(self.real[FEED]), self.state[FEED_MODE] == 95
        if not feed > 0 or self.state[FEED_MODE] == 93:
            words = f"a feed of {feed:g}" if feed <= 0 else "no feed" if np.isnan(feed) else "a block time (G93)"
            raise self._error(f"cuts in spindle mode with {words}", "give an F above 0 under G94 or G95")
        if spindle.constant_surface and not (per_rev and spindle.highest > 0):
            missing = "the highest spindle speed" if per_rev else "a feed per revolution (G95)"
            raise self._error(f"cuts at constant surface speed (G96) without {missing}", "state it")
        mode = spindle.mode(feed, per_rev=per_rev)
        if self.cut is None:
            after = self.real.copy()
            self.real[:4] = before
            self.real[0] = 0.0
            cut = self._open(timed=True, turning=turning_number(mode, spindle.sense))
            cut.spindle, cut.mode = spindle, mode
            self.real[:] = after
        rows, first = self._free_columns()
        rows[:4, first] = self.real[:4]
        rows[0, first] = 0.0
        rows[4, first] = mode.turns(*np.stack([before, self.real[:4]])[:, [1, 3]].T)[0]
        self._count_blocks(rows, first, first + 1, int(self.state[LINES]) - 1)

    def _cut(self, before: Floats, step: Floats) -> None:
        """Add the current block to the cut, beginning one if none is open."""
        inverse = self.state[FEED_MODE] == 93
        feed = float(self.real[FEED])
        if self.state[FEED_MODE] == 95:
            raise self._error("turns C with a feed per revolution (G95)", "give a block time under G93, or G94")
        if not feed > 0:
            mode = ("PVT" if inverse else "LINEAR") if self.dialect.velocities else f"G{93 if inverse else 94}"
            words = "without a feed" if np.isnan(feed) else f"with a feed of {feed:g}"
            raise self._error(f"cuts {words} under {mode}, it must be above 0", f"give an F after {mode}")
        if inverse:
            duration = kernel.seconds(feed, self.state[FEED_UNIT])
        else:
            length = float(np.linalg.norm(step[1:]))
            duration = 60 * (length or abs(float(step[0]))) / feed
        if self.cut is None:
            if self.tool_change:
                raise self._error(
                    f"cuts again after {self.tool_change}", "give a program with one tool, or name its passes"
                )
            after = self.real.copy()
            self.real[:4] = before
            self._open(timed=inverse)
            self.c_cuts += 1
            self.real[:] = after
        rows, first = self._free_columns()
        rows[:4, first] = self.real[:4]
        rows[4, first] = duration
        if self.dialect.velocities:
            rows[5:, first] = [self.speeds.get(letter, 0.0) for letter in AXES]
        self._count_blocks(rows, first, first + 1, int(self.state[LINES]) - 1)
