"""Read a program back: plain cutting blocks in bulk, everything else word by word."""

from __future__ import annotations

import hashlib
import mmap
import re
import warnings
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from string import ascii_lowercase, ascii_uppercase
from typing import TYPE_CHECKING

import numpy as np

from turnwright._kernels import text as kernel
from turnwright.errors import InputError, ProgramError
from turnwright.path import Motion
from turnwright.post.digest import hashed_rows
from turnwright.post.header import (
    BOM,
    ENTRY,
    SIGNATURE,
    SUB_SIGNATURE,
    ProgramInfo,
    ProgramPass,
    ProgramWarning,
    convention_line,
    read_info,
)
from turnwright.post.macro import Macros
from turnwright.post.registry import dialect_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from os import PathLike

    from numpy.typing import NDArray

    from turnwright._arrays import Floats, Ints
    from turnwright.machine import Machine
    from turnwright.post.dialect import Dialect
    from turnwright.progress import Progress

__all__ = ["read_nc"]

BUFFER = 1 << 20
"""Bytes of text taken at a time."""
UPPER = str.maketrans(ascii_lowercase, ascii_uppercase)
"""Letters of words; other signs stay, as a message shows them."""

LONGEST = 1 << 16
"""Letters in the longest line."""
HASHED = 1 << 14
"""Points hashed at a time: few enough to stay in the cache, where fresh memory would cost more than the hash."""
DEEPEST = 8
MOST_CALLS = 1000
"""How often one file may be called: calls of calls would otherwise be read for ever."""
LARGEST = 1e9
WHOLE = "take all files of the program from where they were written again"
"""What to do about a program that is not whole."""
AXES = "CXYZ"
CALLED = "\x00"
"""What stands for a call in a block whose comments are gone; no text has it."""
SHOWN = 40
"""Letters of a name or a line that a message repeats."""
HARMLESS = frozenset("CXYZFTSODHPLQ")
"""Letters that move the known axes, or nothing; the others may only say 0."""
# Slots of the kernel's state, as in turnwright._kernels.text.
LINEAR, FEED_MODE, OPEN, FEED_UNIT, LINES, Y_SEEN = range(6)
FEED = 4

IGNORED_G = frozenset({4, 8, 15, 17, 18, 19, 21, 40, 43, 49, 61, 63, 64, 69, 71, 80, 90, 97, 103, 144})
"""Planes, offsets set once, metric units, corner modes, cancellations: nothing that moves the tool against the part."""
MACHINE_G = frozenset({28, 30, 53})
"""Moves in machine coordinates: where the tool then stands against the part is not known."""
WORK_OFFSET_G = frozenset({54, 55, 56, 57, 58, 59})
SHIFT_G = frozenset({50, 52})
"""Shifts of the origin whose size differs among controllers; without one, or by nothing, they do no harm."""
SET_G = 92
"""The tool stays where it is, and its place gets the coordinates stated."""
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
)
"""G codes of which a block has one at most."""

# No pattern may try a run of letters twice (possessive repeats, which give nothing back): 60,000 blanks would hang.
COMMENT = re.compile(r"\([^()]*+(?:\([^()]*+\)\s*+)?+\)|;.*$")
"""A comment, which may end with a bracket of its own; what stands in it is not followed."""
CALL = re.compile(r"M\s*+98\s*+(?:\(([^()<>\r\n]++)\)|<([^()<>\r\n]++)>)", re.IGNORECASE)
PARTS = re.compile(f"{CALL.pattern}|{COMMENT.pattern}|(?P<stray>[()])", re.IGNORECASE)
REPEAT = re.compile(r"(?:L\s*+0*+([1-9]\d{0,2}))?+")
"""How often a call is made."""
PASS = re.compile(r"\(\s*+PASS:([^()\r\n]++)\)", re.IGNORECASE)
PART = re.compile(r"PART (\d{1,9}) OF \d{1,9}", re.IGNORECASE)
MOVES = re.compile(r"(?<![A-Z#])[CXYZ]\s*+[-+.\d#\[]", re.IGNORECASE)
"""A word that moves an axis."""
DELETED = re.compile(r"\s*+(?:N\s*+\d++\s*+)?/[1-9]?", re.IGNORECASE)
"""What begins a block that the operator's block-delete switch leaves out."""
TOKEN = re.compile(r"([A-Z])\s*(?:([+-]?(?:\d+\.?\d*|\.\d+))|(\[|[+-]?#))", re.IGNORECASE)
SPEED = re.compile(r":([+-]?(?:\d+\.?\d*|\.\d+))")
NATIVE = re.compile(r"(ABS|LINEAR|RAPID|DWELL\s*\d+\.?\d*|PVT\s*(\d+\.?\d*|\.\d+))")
"""Statements of a controller that takes velocities."""
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
    """Read one pass of a program, this one's or another's, as the motion that it commands.

    The motion begins where the first cutting block begins and has one point more than there are blocks. A cutting
    block is a straight feed move (G1) that turns C; what stands before, between and after the cuts is followed but not
    kept. Time begins at 0. C is cumulative. It is taken as written where the machine's dialect counts on or a C word
    leaves 0 to 360; within one turn it may roll over, and then takes the short way. A program that carries
    Turnwright's header is checked against it.

    Where a program sets coordinates (G92), the motion stays in those that it began with; at the start, where no place
    is known yet, it begins with those that are set. F holds within its mode: under G93 that of G94 is none, and under
    G94 after G93 it must be stated again, since controllers differ in what is in force there. The time of dwells (G4)
    is not counted.

    Parameters
    ----------
    path
        The main program, or a sub-program on its own.
    machine
        Names the dialect (so, what F means) and the convention.
    name
        The pass to read: its name, or "cut 1", "cut 2", ... in a program that names none. The last one if not given.
    block_delete
        The operator's switch for the blocks that begin with a slash: on leaves them out, off cuts them. A program with
        such blocks is refused if it is not given.
    progress
        Called with (bytes read, bytes in all).

    Raises
    ------
    ProgramError
        If a file cannot be read or is damaged, commands something that is not a C X Z (Y) motion, or has no such pass;
        if it has more or fewer points than its header says.

    Warns
    -----
    ProgramWarning
        If several stretches of cutting without names exist and none was asked for: the others are left out.
        If the numbers are not those whose hash the header states: the program was edited. If a file has no end (M30 or
        M02, M99 in a sub-program, or a second percent sign): it may be cut short. If axes move in blocks behind the
        M30, M02 or M99 of a file: they are left out.

    Sources
    -------
    Kramer, Proctor, Messina: The NIST RS274NGC Interpreter, Version 3, NISTIR 6556 (2000): 3.5.18 for G92, 3.5.19 for
    feeds, 3.3.1 and 2.2.3 for the end of a program and for block delete. LinuxCNC, `convert_feed_mode`: G94 ends the F
    in force.
    """
    path = Path(path)
    dialect = dialect_of(machine)
    try:
        info = read_info(path)
        part = read_info(path, SUB_SIGNATURE)
        if part is not None:
            _require_language(path, part, machine, dialect)
        told = _told(path, info, machine, dialect, name)
        with ThreadPoolExecutor(1) as pool:
            wanted = told.name if told else name
            reader = _Reader(
                path, dialect, wanted=wanted, told=told, block_delete=block_delete, pool=pool, progress=progress
            )
            reader.run()
            found, digest = reader.finish()
    except OSError as error:
        where = error.filename or path
        raise ProgramError(f"{where} cannot be read ({error.strerror}): check its name and place") from error
    for doubt in reader.doubts:
        warnings.warn(doubt, ProgramWarning, stacklevel=2)
    if told is not None and digest != told.hash:
        warnings.warn(
            f"{path}: pass {_short(told.name)} is not as it was written, its hash is {digest[:12]}... and the header "
            f"says {told.hash[:12]}...: it was edited or damaged",
            ProgramWarning,
            stacklevel=2,
        )
    return _motion(path, found, told, machine)


def _told(
    path: Path, info: ProgramInfo | None, machine: Machine, dialect: Dialect, name: str | None
) -> ProgramPass | None:
    """Return what the header says about the wanted pass, if it says anything; refuse another machine's program."""
    if info is None:
        return None
    _require_language(path, info, machine, dialect)
    for one in info.passes:
        if one.name == name:
            return one
    if not info.passes:
        raise ProgramError(f"{path} names no pass in its header, it must name at least 1: {WHOLE}")
    if name is not None:
        raise ProgramError(
            f"{path} has no pass {_short(name)!r}, it has {_listed([one.name for one in info.passes])}: name one of "
            "these"
        )
    return info.passes[-1]


def _short(text: str) -> str:
    """Return text that a message can repeat."""
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


def _listed(names: Sequence[str]) -> str:
    """Return names as a message can list them."""
    more = [f"{len(names) - 4} more"] if len(names) > 5 else []
    return ", ".join([_short(name) for name in names[: 4 if more else 5]] + more) or "none"


def _require_language(path: Path, info: ProgramInfo, machine: Machine, dialect: Dialect) -> None:
    """Raise unless a file of ours is written the way that the machine counts."""
    if not info.dialect or not info.convention:
        raise ProgramError(
            f"{path} has a header that does not state both dialect and convention, it is cut short: {WHOLE}"
        )
    if info.dialect != dialect.name:
        raise ProgramError(
            f"{path} is written in the dialect {_short(info.dialect)}, machine {machine.name} speaks {dialect.name}: "
            "read it with the machine that it was written for"
        )
    if info.convention != convention_line(machine):
        raise ProgramError(
            f"{path} is written for the convention {info.convention[:80]}, machine {machine.name} counts "
            f"{convention_line(machine)}: read it with the machine that it was written for"
        )


@dataclass(slots=True)
class _Cut:
    """Consecutive cutting blocks, in the controller's own numbers."""

    name: str
    named: bool
    rows: Floats  # (5, room): C [deg], X, Y, Z [mm], duration [s]; the first point has none; then 4 velocities, if any
    points: int = 1
    blocks: int = 0
    has_y: bool = False
    timed: bool = False
    """Whether its first block states its time (G93), as no block does that only positions."""
    shifts: list[tuple[int, Floats]] = field(default_factory=list)
    """From which column on, by how much the part's C, X, Y, Z are above the program's. (4,) [deg, mm]"""


def _motion(path: Path, found: _Cut, told: ProgramPass | None, machine: Machine) -> Motion:
    """Return a cut in Turnwright's own convention."""
    convention = machine.convention
    dialect = dialect_of(machine)
    rows = found.rows[:, : found.points]
    within = bool(rows[0].min() >= 0 and rows[0].max() <= 360)
    for (start, shift), (stop, _) in pairwise([*found.shifts, (found.points, np.zeros(4))]):
        for k in np.flatnonzero(shift):
            rows[k, start:stop] += shift[k]
    axes: dict[str, Floats] = {letter: rows[k] for k, letter in enumerate(AXES) if letter != "Y" or found.has_y}
    first = told.first_c if told else rows[0, 0] - 360 * np.rint(found.shifts[0][1][0] / 360)
    # A C that counts on is exact, however far a block turns it; one that rolls over takes the short way.
    cumulative = not (within and dialect.wrapped)
    bad = kernel.count_on(axes["C"], first) if cumulative else -1
    if not cumulative or (bad >= 0 and within):
        bad = kernel.unwrap(axes["C"], first)
        cumulative = False
    if bad >= 0:
        why = "" if within else " (it leaves 0 to 360, so it does not roll over)"
        how = "or not at all" if cumulative else "by nothing or by half a turn"
        raise ProgramError(
            f"{path}: block {bad} of {found.name} turns C back, {how}, to {axes['C'][bad]:g}{why}, the sense of "
            "rotation must stay: split the program there"
        )
    time = rows[4]
    kernel.clock(time)
    axes["C"] *= convention.c_sense * (np.pi / 180)
    axes["C"] -= convention.c_sense * convention.clocking
    axes["X"] *= convention.x_side
    axes["Z"] *= convention.z_sign
    velocity = None
    if rows.shape[0] > 5:
        signs = {"C": convention.c_sense * (np.pi / 180), "X": convention.x_side, "Y": 1, "Z": convention.z_sign}
        velocity = {letter: rows[5 + AXES.index(letter)] * signs[letter] for letter in axes}
    try:
        return Motion(time=time, axes=axes, machine=machine, velocity=velocity)
    except InputError as error:
        raise ProgramError(f"{path} does not hold a motion: {error}") from error


def _pass_name(text: str) -> tuple[str, int] | None:
    """Return the pass that a comment in a text names, and which part of it follows."""
    found = PASS.search(text)
    if found is None or not (name := found[1].strip()):
        return None
    before, comma, behind = name.rpartition(",")
    part = PART.fullmatch(behind.strip()) if comma else None
    return (before.strip(), int(part[1])) if part else (name, 1)


def _rows(room: int, height: int) -> Floats:
    """Return memory for the blocks of a cut. (height, room).

    NumPy would ask for it in huge pages, and a virtual machine may have to fetch each of those from its host: that made
    the time of reading swing between once and twice.
    """
    return np.frombuffer(mmap.mmap(-1, height * 8 * room)).reshape(height, room)


class _Reader:
    """The state of a controller that follows a program."""

    def __init__(
        self,
        path: Path,
        dialect: Dialect,
        *,
        wanted: str | None,
        told: ProgramPass | None,
        block_delete: bool | None,
        pool: ThreadPoolExecutor,
        progress: Progress | None,
    ) -> None:
        self.path, self.dialect, self.wanted, self.told = path, dialect, wanted, told
        self.block_delete, self.pool, self.progress = block_delete, pool, progress
        self.whole: Ints = np.zeros(6, dtype=np.int64)
        self.whole[[LINEAR, FEED_MODE]] = 1, 94
        self.whole[FEED_UNIT] = dialect.feed_unit
        self.height = 9 if dialect.velocities else 5
        self.speeds: dict[str, float] = {}  # of the block that is being read
        self.real: Floats = np.full(5, np.nan)
        self.time_feed = np.nan  # the F in force under G93 while G94 is
        self.speed_feed = np.nan  # the speed of straight moves beside curves with times of their own [mm/min]
        self.shift: Floats = np.zeros(4)  # what G92 has set: the part's coordinates less the program's
        self.begun: set[str] = set()  # axes whose coordinates begin where G92 set them
        self.lost: set[str] = set()  # axes that moved to where the part's coordinates are not known
        self.work_offset = 54.0
        self.tool = self.length = 0.0  # T and H in force
        self.unseen = ""  # what has moved the tool unseen since it cut
        self.scratch: Floats = np.empty((self.height, 1 << 12))  # for blocks that nobody asked for
        self.macros = Macros(lambda what: self._error(what, "write it as a number"))
        self.loops: dict[int, str] = {}  # condition by label
        self.named: str | None = None
        self.cut: _Cut | None = None
        self.kept: _Cut | None = None
        self.cuts = 0
        self.names: list[str] = []
        self.unnamed: list[int] = []  # blocks of each cut that has no name
        self.done = self.total = 0
        self.over = self.ended = False
        self.end = ""  # the code that ended the file that is read
        self.stack: list[Path] = []
        self.calls: dict[Path, int] = {}
        self.coded = False  # whether the file that is read has had a block yet
        self.doubts: list[str] = []
        self.hashing: Future[None] | None = None
        self.digest = hashlib.sha256()
        self.kept_digest = ""

    # ------------------------------------------------------------------ files
    def run(self) -> None:
        """Follow the main program to its end."""
        self.total = self.path.stat().st_size
        if self.total < BUFFER:
            head = self.path.read_bytes().decode("latin-1")
            called = (self._beside(call[1] or call[2]) for call in CALL.finditer(head))
            self.total += sum(file.stat().st_size for file in called if file is not None)
        self._file(self.path)
        self._close()
        self._report(self.total)

    def _report(self, done: int) -> None:
        if self.progress is not None:
            self.progress(done, self.total)

    def finish(self) -> tuple[_Cut, str]:
        """Return the cut that was asked for, and its hash."""
        points = 0 if self.kept is None else self.kept.points
        if self.told is not None and points != self.told.points:
            raise ProgramError(
                f"{self.path} says that pass {self.told.name} has {self.told.points} points, its blocks make {points}: "
                f"{WHOLE}, or if they were changed on purpose, state the new number in the header"
            )
        if self.kept is None:
            if self.wanted is not None:
                raise ProgramError(
                    f"{self.path} has no pass {_short(self.wanted)!r}, it has {_listed(self.names)}: name one of these"
                )
            raise ProgramError(
                f"{self.path} has no cutting block, at least 1 is needed: give a program whose G1 blocks turn C"
            )
        others = sum(self.unnamed) - self.kept.blocks
        if self.wanted is None and not self.kept.named and len(self.unnamed) > 1 and others > 0:
            self.doubts.append(
                f"{self.path} cuts in {len(self.unnamed)} stretches without names, {others} of their "
                f"{sum(self.unnamed)} blocks are left out: only {self.kept.name} is read, a block that does not turn C "
                "ends a stretch; state the name of the one to read"
            )
        return self.kept, self.kept_digest

    def _file(self, path: Path) -> None:
        """Follow one file."""
        if path in self.stack or len(self.stack) >= DEEPEST:
            raise ProgramError(
                f"{path} is called from within itself or {DEEPEST} calls deep: give every pass a sub-program of its own"
            )
        self.calls[path] = self.calls.get(path, 0) + 1
        if self.calls[path] > MOST_CALLS:
            raise self._error(f"calls {_short(path.name)} more than {MOST_CALLS} times", "write its passes one by one")
        self.stack.append(path)
        outer, self.whole[LINES] = self.whole[LINES], 0
        before, loops, self.coded = self.real.copy(), set(self.loops), False
        with path.open("rb") as file:
            head = file.read(64)
        ours = head.removeprefix(BOM).lstrip(b"; ").startswith((SIGNATURE.encode(), SUB_SIGNATURE.encode()))
        begin = len(BOM) if head.startswith(BOM) else 0  # of the piece, in the file
        for text_bytes, data, end in self._buffers(path):
            at = 0
            while at < end and not (self.over or self.ended):
                rows, first = self._room()
                at, last = kernel.parse_blocks(data, at, end, self.whole, self.real, rows, first)
                self._added(rows, first, last)
                if at < end and last < rows.shape[1]:
                    stop = text_bytes.find(b"\n", at, min(at + LONGEST, end)) + 1
                    self.whole[LINES] += 1
                    if stop <= at:
                        raise self._error(f"is longer than {LONGEST} letters", "give a text file with line ends")
                    self.coded = self.coded or not np.array_equal(before, self.real, equal_nan=True)
                    self._line(text_bytes[at:stop].decode("latin-1"))
                    at = stop
            self._report(min(self.done, self.total))
            if self.over or self.ended:
                self._doubt_rest(path, begin + at)
                break
            begin += end
        if not (self.over or self.ended):
            if ours:
                raise self._error("is the last one, a whole file ends with M30 or M99", WHOLE)
            self._doubt_end(path, [label for label in self.loops if label not in loops])
        else:
            self._require_ends(path, [label for label in self.loops if label not in loops])
        self.over, self.coded = False, True
        self.whole[LINES] = outer
        self.stack.pop()

    def _require_ends(self, path: Path, loops: list[int]) -> None:
        """Raise unless each loop within which a file ends has its END further on."""
        if not loops:
            return
        rest = path.read_bytes().upper().rpartition(b"WHILE")[2].decode("latin-1")
        ends = {int(end[1]) for line in rest.splitlines() if (end := END.fullmatch(COMMENT.sub(" ", line).strip()))}
        for label in loops:
            if label not in ends:
                raise self._error(f"ends the file within loop {label}, which has no END", "give each WHILE its END")
            del self.loops[label]

    def _doubt_end(self, path: Path, loops: list[int]) -> None:
        """Note that a file has no end, and where it breaks off within a line, or within its loops."""
        with path.open("rb") as file:
            file.seek(-min(path.stat().st_size, LONGEST), 2)
            last = file.read().rpartition(b"\n")[2].decode("latin-1")
        signs = ["M30 or M02" if len(self.stack) == 1 else "M99"]
        if COMMENT.sub(" ", last).strip():
            signs.append(f"line {int(self.whole[LINES])} has no line end")
        signs += [f"loop {label} has no END" for label in loops[-1:]]
        self._doubt(
            f"{path} ends without {' and '.join([', and '.join(signs[:2]), *signs[2:]])}: it may be cut short, compare "
            "it with the file that was written"
        )

    def _doubt_rest(self, path: Path, behind: int) -> None:
        """Note how many blocks that move axes stand behind the end of a file."""
        blocks = 0
        with path.open("rb") as file:
            file.seek(behind)
            while line := file.readline(LONGEST).decode("latin-1"):
                if line.startswith("%"):
                    break
                blocks += MOVES.search(COMMENT.sub(" ", line)) is not None
        if blocks and self.end:
            self._doubt(
                f"{path} goes on behind the {self.end} in line {int(self.whole[LINES])}: {blocks} blocks there that "
                f"move axes are left out; if they belong to the program, remove the {self.end}"
            )

    def _doubt(self, doubt: str) -> None:
        if doubt not in self.doubts:
            self.doubts.append(doubt)

    def _buffers(self, path: Path) -> Iterator[tuple[bytearray, NDArray[np.uint8], int]]:
        """Yield the file in pieces, twice the same memory, each with where its last line ends.

        It is gone when the next one is asked for.
        """
        buffer = bytearray(BUFFER + LONGEST + 1 + kernel.BEHIND)
        data = np.frombuffer(buffer, dtype=np.uint8)
        kept = 0
        with path.open("rb") as file:
            file.seek(len(BOM) if file.read(len(BOM)) == BOM else 0)
            while count := file.readinto(memoryview(buffer)[kept : kept + BUFFER]):
                self.done += count
                filled = kept + count
                end = buffer.rfind(b"\n", max(0, filled - LONGEST), filled) + 1
                if not end and filled > LONGEST:
                    raise self._error(f"is longer than {LONGEST} letters", "give a text file with line ends")
                yield buffer, data, end
                kept = filled - end
                buffer[:kept] = buffer[end:filled]
        buffer[kept] = 10
        yield buffer, data, kept + 1

    def _error(self, what: str, remedy: str) -> ProgramError:
        """Return a sentence with file and line."""
        where = self.stack[-1] if self.stack else self.path
        return ProgramError(f"{where} line {int(self.whole[LINES]) or 1} {what}: {remedy}")

    # ------------------------------------------------------------------- cuts
    def _room(self) -> tuple[Floats, int]:
        """Return where the next blocks go: rows, and the first free column."""
        cut = self.cut
        if cut is None or not self._asked(cut):
            return self.scratch, 0
        if cut.points == cut.rows.shape[1]:
            wider = _rows(2 * cut.points, self.height)
            wider[:, : cut.points] = cut.rows
            cut.rows = wider
        return cut.rows, cut.points

    def _asked(self, cut: _Cut) -> bool:
        return self.wanted is None or cut.name == self.wanted

    def _added(self, rows: Floats, first: int, last: int) -> None:
        """Count the blocks that now stand in columns first to last - 1, and hash them on the other core."""
        cut = self.cut
        if cut is None or last == first:
            return
        cut.blocks += last - first
        if rows is self.scratch:
            return
        cut.points = last
        self._submit(rows, first, last)

    def _submit(self, rows: Floats, first: int, last: int) -> None:
        if self.told is not None:
            self._drain()
            letters = [letter for letter in self.dialect.decimals if letter != "Y" or self.whole[Y_SEEN]]
            self.hashing = self.pool.submit(self._hash, rows[:, first:last], letters)

    def _hash(self, rows: Floats, letters: list[str]) -> None:
        for start in range(0, rows.shape[1], HASHED):
            some = rows[:, start : start + HASHED]
            each = 2 if self.dialect.velocities else 1
            units = np.empty((some.shape[1], each * len(letters)), dtype=np.int64)
            for column, letter in enumerate(letters):
                scale, row = 10.0 ** self.dialect.decimals[letter], AXES.index(letter)
                kernel.quantise(some[row], scale, 0.0, 0, units, each * column)
                if each == 2:
                    kernel.quantise(some[5 + row], scale, 0.0, 0, units, each * column + 1)
            self.digest.update(hashed_rows(units, some[4]))

    def _open(self, *, timed: bool) -> None:
        """Begin a cut at the present position."""
        self.cuts += 1
        # As many points as the header says, if the text is long enough to hold them, and one to spare: only a full
        # table is made wider.
        room = max(2, min(self.told.points, self.total) + 1) if self.told else 1 << 16
        cut = _Cut(
            name=self.named or f"cut {self.cuts}",
            named=self.named is not None,
            timed=timed,
            rows=_rows(room, self.height),
        )
        cut.rows[:4, 0] = self.real[:4]
        cut.rows[4, 0] = 0.0
        cut.shifts.append((0, self.shift.copy()))
        self.cut = cut
        self.whole[OPEN] = 1
        self._drain()
        self.digest = hashlib.sha256()
        self._submit(cut.rows, 0, 1)

    def _drain(self) -> None:
        if self.hashing is not None:
            self.hashing.result()
            self.hashing = None

    def _close(self) -> None:
        """End the cut that is open, if there is one, and keep it if it is the one that is wanted."""
        cut, self.cut = self.cut, None
        self.whole[OPEN] = 0
        if cut is None:
            return
        if cut.name.endswith(ENTRY):
            self.cuts -= 1  # the plunge before a cut
            return
        if not cut.named and (cut.blocks > 1 or cut.timed):
            self.unnamed.append(cut.blocks)
        if cut.blocks == 1 and not cut.named:
            self.cuts -= 1  # one block alone positions C, and is a cut only where there is no other
        elif cut.name not in self.names:
            self.names.append(cut.name)
        if self.wanted is not None and cut.name != self.wanted:
            return
        kept = self.kept
        if kept is not None and kept.blocks > 1 and cut.blocks == 1:
            return
        if kept is not None and kept.blocks > 1 and cut.named and kept.name == cut.name:
            raise self._error(
                f"ends a second cut in pass {_short(cut.name)}, of {cut.blocks} blocks after {kept.blocks}, the limit "
                "is 1",
                "give every cut a pass of its own",
            )
        cut.has_y = bool(self.whole[Y_SEEN])
        self._drain()
        self.kept, self.kept_digest = cut, self.digest.hexdigest()

    # ------------------------------------------------------------------ lines
    def _line(self, text: str) -> None:
        """Follow one line of any kind."""
        if "\x00" in text:
            raise self._error("holds binary data", "give a program in plain text")
        if "\r" in text.rstrip():  # a line end to some controllers, a blank to others
            raise self._error(
                "has a carriage return (CR) between its letters, a line ends with LF or CR LF",
                "save the program with such line ends",
            )
        text = self._undeleted(text)
        if name := _pass_name(text):
            self._marker(*name)
        calls: list[str] = []
        block, *behind = PARTS.sub(lambda part: self._part(part, calls), text).strip().translate(UPPER).split(CALLED)
        if calls:
            self._call_from(block.strip(), calls, behind)
        else:
            self._bare(block)

    def _part(self, part: re.Match[str], calls: list[str]) -> str:
        """Return what stands for a comment, or for a call, which is noted."""
        if part["stray"]:
            raise self._error("has a bracket without its partner", "close the comment")
        if name := part[1] or part[2]:
            calls.append(name.strip())
            return CALLED
        return " "

    def _call_from(self, block: str, calls: list[str], behind: list[str]) -> None:
        """Follow a block that ends with a call: what stands before it comes first."""
        repeat = REPEAT.fullmatch(behind[0].strip())
        if repeat is None or len(calls) > 1 or re.search("[DHLPQ]", block):
            raise self._error(
                f"calls {_short(calls[0])} with more words, behind a call may stand L and how often, 1 to 999",
                "write the other words, or the other call, in a block of their own",
            )
        self._bare(block)
        if self.over or self.ended:
            raise self._error("ends and calls a file", "write the call in a block of its own")
        for _ in range(int(repeat[1] or 1)):
            self._call(calls[0])
            if self.ended:
                return

    def _bare(self, bare: str) -> None:
        """Follow a block without comments."""
        if bare.startswith("%"):
            bare = self._tape_mark(bare)
        if not bare:
            return
        self.coded = True
        if len(bare) > 512:
            raise self._error("is longer than 512 letters without its comments", "give a program of plain blocks")
        if not (self.dialect.velocities and self._native(bare)) and not self._statement(bare):
            self._words(bare)

    def _undeleted(self, text: str) -> str:
        """Return a line without the slash that block delete asks for, or nothing if it is left out."""
        slash = DELETED.match(text)
        if slash is None:
            return text
        block = text[slash.end() :]
        if self.block_delete is None and COMMENT.sub(" ", block).strip():
            raise self._error(
                "begins with a slash, it is cut or left out as the block-delete switch stands",
                "state block_delete, on the command line --block-delete or --no-block-delete",
            )
        return "" if self.block_delete else block

    def _tape_mark(self, bare: str) -> str:
        """Return what stands behind a percent sign: the first one begins a file, the second one ends it."""
        self.over, self.end = self.coded, ""
        self.coded = True
        return "" if self.over else bare.lstrip("%").strip()

    def _native(self, bare: str) -> bool:
        """Follow a statement of a controller that takes velocities, if the line is one."""
        said = NATIVE.fullmatch(bare)
        if said is None:
            return False
        if said[2]:
            self.whole[LINEAR], self.whole[FEED_MODE], self.real[FEED] = 1, 93, float(said[2])
        elif bare in {"LINEAR", "RAPID"}:
            self.whole[LINEAR], self.whole[FEED_MODE], self.real[FEED] = bare == "LINEAR", 94, self.speed_feed
        return True

    def _statement(self, bare: str) -> bool:
        """Follow a macro statement, if the line is one."""
        if assign := ASSIGN.fullmatch(bare):
            self.macros.variables[int(assign[1])] = self.macros.value(assign[2])
        elif loop := WHILE.fullmatch(bare):
            if int(loop[2]) in self.loops:
                raise self._error(f"begins loop {loop[2]} within itself", "give each loop a number of its own")
            self.loops[int(loop[2])] = loop[1]
            if not self.macros.holds(loop[1]):
                raise self._error("begins a loop that never runs", "give a program that cuts once")
        elif end := END.fullmatch(bare):
            label = next(reversed(self.loops), None)
            if label != int(end[1]):
                within = "no loop is open" if label is None else f"the last one begun is {label}"
                raise self._error(f"ends loop {end[1]}, {within}", "give each WHILE its END")
            if self.macros.holds(self.loops.pop(label)):
                raise self._error("repeats a loop, the limit is to run it once", "give a program of one pass")
        elif OTHER.match(bare):
            raise self._error(f"is a statement that Turnwright does not follow ({bare[:30]})", "give plain blocks")
        else:
            return False
        return True

    def _marker(self, name: str, part: int) -> None:
        if part == 1 or name != self.named:
            self._close()
            self.named = name
            self.unseen = ""

    def _beside(self, name: str) -> Path | None:
        """Return a file of the program's own folder, if it is there."""
        name = name.strip()
        if len(name) > 255 or Path(name).name != name or "\\" in name:
            return None
        path = self.path.parent / name
        return path if path.is_file() else None

    def _call(self, name: str) -> None:
        path = self._beside(name)
        if path is None:
            raise self._error(
                f"calls {_short(name)}, which is not beside it", "put all files of the program into one folder"
            )
        if self.told is not None:
            # Passes that nobody asked for need not be read: each names itself in its first lines.
            with path.open("rb") as file:
                own = _pass_name(file.read(512).decode("latin-1"))
            if own and own[0] != self.wanted:
                self.done += path.stat().st_size
                return
        self._file(path)

    def _parsed(self, bare: str) -> list[tuple[str, float]]:
        """Return the words of a block, and keep its velocities."""
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
            if not abs(value) <= LARGEST:
                raise self._error(f"has {letter}{value:g}, the limit is {LARGEST:g}", "correct the number")
            words.append((letter, value))
        return words

    def _words(self, bare: str) -> None:
        """Follow a block of words."""
        words = self._parsed(bare)
        codes = [value for letter, value in words if letter == "G"]
        for letter, value in words:
            if letter == "M":
                self._m(value, words)
        for group in GROUPS:
            if len(both := sorted(group & set(codes))) > 1:
                raise self._error(f"has {' and '.join(f'G{code:g}' for code in both)}", "keep one of them in a block")
        self._tooling(words, codes)
        for code in codes:
            self._g(code)
        values = {letter: value for letter, value in words if letter not in "GMN"}
        letters = [letter for letter, _ in words if letter not in "GMN"]
        if twice := [letter for letter in values if letters.count(letter) > 1]:
            raise self._error(f"gives {', '.join(twice)} two values", "keep one word of each letter")
        self._block(codes, values)

    def _m(self, code: float, words: list[tuple[str, float]]) -> None:
        if code == 98:
            number = next((value for letter, value in words if letter == "P"), 0)
            raise self._error(f"calls sub-program {number:g} by number", "read that sub-program's own file")
        self.ended = self.ended or code in {2, 30}
        self.over = self.over or code == 99
        if code in {2, 30, 99}:
            self.end = f"M{code:02g}"

    def _tooling(self, words: list[tuple[str, float]], codes: list[float]) -> None:
        """Follow what changes the tool or its length: where it then stands against the part is not known."""
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
            self.unseen = f"line {int(self.whole[LINES])} changed the tool or its length ({', '.join(changes)})"
        self._close()
        self._lose("XYZ")

    def _g(self, code: float) -> None:
        """Follow one G code, as far as it matters to where the tool goes."""
        if code in {0, 1}:
            self.whole[LINEAR] = int(code)
        elif code in {93, 94}:
            self._change_mode(int(code))
        elif code in WORK_OFFSET_G:
            if code != self.work_offset and not np.isnan(self.real[:4]).all():
                raise self._error(
                    f"changes the work offset from G{self.work_offset:g} to G{code:g}, by how much is not known",
                    "give a program of one work offset",
                )
            self.work_offset = code
        elif code in {20, 70}:
            raise self._error(f"asks for inches (G{code:g}), the limit is millimetres", "write the program in mm")
        elif code == 91:
            raise self._error("asks for incremental moves (G91)", "write the program in absolute positions (G90)")
        elif code in {2, 3}:
            raise self._error(f"is an arc (G{code:g})", "write the program in straight blocks (G1)")
        elif code not in IGNORED_G | MACHINE_G | SHIFT_G | UNSET_G | {SET_G}:
            raise self._error(f"has G{code:g}, which Turnwright does not follow", "remove it, or write it with G1")

    def _change_mode(self, mode: int) -> None:
        """Change what F means, and with it the F in force: a number of the other unit is none.

        A time stays in force until an F is stated as a speed.
        """
        if mode == self.whole[FEED_MODE]:
            return
        feed = float(self.real[FEED])
        if mode == 94:
            self.real[FEED], self.time_feed = np.nan, feed
        else:
            self.real[FEED] = self.time_feed if np.isnan(feed) else np.nan
        self.whole[FEED_MODE] = mode

    def _block(self, codes: list[float], values: dict[str, float]) -> None:
        """Follow the axis words of a block."""
        axes = {letter: values[letter] for letter in AXES if letter in values}
        if MACHINE_G & set(codes):
            self._close()
            # Distances (U, W), or no words at all, stand for axes that differ among controllers.
            self._lose(axes if axes and values.keys() <= HARMLESS else AXES)
            return
        if 4 in codes:
            if axes.keys() - {"X"} or 1 in codes:
                raise self._error("moves and dwells (G4)", "write the dwell in a block of its own")
            return  # a dwell, whose time some controllers call X
        others = [letter for letter, value in values.items() if letter not in HARMLESS and (value or letter == "E")]
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
        """Take an F; beside curves with times of their own it is the mm per second of straight moves."""
        if not self.dialect.velocities:
            self.real[FEED] = feed
            return
        self.speed_feed = 60 * feed
        if self.whole[FEED_MODE] == 94:
            self.real[FEED] = self.speed_feed

    def _lose(self, letters: Iterable[str]) -> None:
        """Forget where axes stand."""
        for letter in letters:
            k = AXES.index(letter)
            if not np.isnan(self.real[k]):
                self.lost.add(letter)
            self.real[k] = np.nan

    def _coordinates(self, codes: list[float], axes: dict[str, float], *, feed: bool) -> None:
        """Follow a block that changes what the coordinates mean."""
        if shifts := SHIFT_G & set(codes):
            if any(axes.values()) or (axes and 50 in shifts) or any(self._is_set(letter) for letter in axes):
                raise self._error(
                    f"shifts the origin within the program (G{min(shifts)})",
                    "give a program of one pass without shifts",
                )
        elif UNSET_G & set(codes):
            self._unset()
        elif axes and feed:
            raise self._error("is a cycle of thread cutting on some controllers (G92 with F)", "write G92 without F")
        else:
            self._set(axes)

    def _is_set(self, letter: str) -> bool:
        return bool(self.shift[AXES.index(letter)]) or letter in self.begun

    def _set(self, axes: dict[str, float]) -> None:
        """Give the place where the tool stands the coordinates stated; it stays where it is against the part."""
        for letter, value in axes.items():
            k = AXES.index(letter)
            if not np.isnan(self.real[k]):
                self.shift[k] += self.real[k] - value
            elif letter in self.lost:
                raise self._error(
                    f"sets {letter} where its place in the coordinates before is not known",
                    "give a program of one pass, or without G28, G30 and G53 before the G92",
                )
            else:
                self.begun.add(letter)
            self.real[k] = value
        self._note_shift()

    def _unset(self) -> None:
        """Return to the coordinates with which the program began."""
        self.real[:4] += self.shift
        self.shift[:] = 0
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
        if "Y" in axes and not self.whole[Y_SEEN]:
            if self.cut is not None:
                raise self._error("moves Y for the first time in mid-cut", "state Y before the cut")
            self.whole[Y_SEEN] = 1
        step = self.real[:4] - before
        if not self.whole[Y_SEEN]:
            step[2] = 0.0
        unknown = [letter for letter in sorted(self.lost - {"C"}) if np.isnan(step[AXES.index(letter)])]
        if self.whole[LINEAR] and abs(step[0]) > 0 and unknown:
            ends = self.real[[AXES.index(letter) for letter in unknown]]
            if self.whole[FEED_MODE] == 93 or np.isnan(ends).any():
                raise self._error(
                    f"turns C where it is not known where {', '.join(unknown)} stands, something moved it unseen",
                    f"state {', '.join(unknown)} in a block before, without C",
                )
        # Without a known start, or without turning C, a move positions the tool and does not cut.
        if self.whole[LINEAR] and step[0] != 0 and not np.isnan(step).any():
            self._cut(before, step)
        elif np.any(step != 0):
            self._close()
        elif self.cut is not None:
            raise self._error("stands still in mid-cut", "remove the repeated point")

    def _cut(self, before: Floats, step: Floats) -> None:
        """Add the block that has just led here to the cut, which begins if none is open."""
        inverse = self.whole[FEED_MODE] == 93
        feed = float(self.real[FEED])
        if not feed > 0:
            mode = ("PVT" if inverse else "LINEAR") if self.dialect.velocities else f"G{93 if inverse else 94}"
            stated = "without a feed" if np.isnan(feed) else f"with a feed of {feed:g}"
            raise self._error(f"cuts {stated} under {mode}, it must be above 0", f"give an F after {mode}")
        if inverse:
            duration = kernel.seconds(feed, self.whole[FEED_UNIT])
        else:
            length = float(np.linalg.norm(step[1:]))
            duration = 60 * (length or abs(float(step[0]))) / feed
        if self.cut is None:
            if self.unseen:
                raise self._error(f"cuts on after {self.unseen}", "give a program of one tool, or name its passes")
            after = self.real.copy()
            self.real[:4] = before
            self._open(timed=inverse)
            self.real[:] = after
        rows, first = self._room()
        rows[:4, first] = self.real[:4]
        rows[4, first] = duration
        if self.dialect.velocities:
            rows[5:, first] = [self.speeds.get(letter, 0.0) for letter in AXES]
        self._added(rows, first, first + 1)
