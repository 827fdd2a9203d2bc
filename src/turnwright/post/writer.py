"""Write NC programs: quantised, hashed, formatted on all cores, and moved into place only when complete."""

from __future__ import annotations

import errno
import hashlib
import math
import re
import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import BinaryIO, TypeAlias

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._kernels import text as text_kernel, tracking as tracking_kernel
from turnwright.errors import ProgramError
from turnwright.machine import FAST, Machine
from turnwright.path import Motion, SpindleMode
from turnwright.post.approach import (
    DOWN_FEED,
    MOST_CLEARANCE,
    PLUNGE_FEED,
    TRAVERSE_FEED,
    Approach,
    link_seconds,
    plan_approach,
)
from turnwright.post.convention import axis_signs
from turnwright.post.dialect import MIN_LINES, Dialect, dialect_of
from turnwright.post.header import (
    BEGIN_BYTES,
    EACH_TIME,
    ENTRY,
    NO_HASH,
    SUB_SIGNATURE,
    ProgramHeader,
    ProgramPass,
    ProgramStart,
    ToolChange,
    bytes_to_hash,
    is_signed,
    language,
    lines,
    program_hash,
)
from turnwright.post.passes import Loop, WrittenPass, even_loops, find_loops
from turnwright.post.spindle import require_spindle_modes, spindle_lines, start_spindle
from turnwright.progress import Progress, cores

__all__ = ["ProgramFiles", "write_nc"]

CHUNK_POINTS = 1 << 16
"""Points formatted at a time; their text and numbers take about 10 MB."""
FASTEST_PLUNGE = 1.0
"""Largest plunge feed. [mm/s]"""
MAX_POSITION = 1e9
"""Largest position, safe in 64-bit integers at six decimals. [mm or deg]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramFiles:
    """The files that `write_nc` wrote.

    Parameters
    ----------
    files
        The main program, then the sub-programs in the order of their calls; empty where they were deleted again.
    lines, bytes
        Totals over all files.
    minutes
        Time of the cuts. [min]
    links_minutes
        Time of approaches, plunges and retracts, from the first clear plane on. [min]
    passes
        Each pass with its points, minutes and hash.
    approaches
        Approach to each pass, by name.
    """

    files: tuple[Path, ...]
    lines: int
    bytes: int
    minutes: float
    links_minutes: float
    passes: tuple[ProgramPass, ...]
    approaches: Mapping[str, Approach]

    @property
    def hash(self) -> str:
        """SHA-256 of the program, over the hashes of its passes, one per line."""
        return program_hash(self.passes)


_Chunk: TypeAlias = tuple[int, int, Ints, Ints, Floats]


def write_nc(
    motion: Motion | Mapping[str, Motion],
    machine: Machine,
    path: str | PathLike[str],
    *,
    header: ProgramHeader | None = None,
    start: ProgramStart | None = None,
    changes: Mapping[str, ToolChange] | None = None,
    clearance: float = 5.0,
    depth: float | Mapping[str, float | None] | None = 0.0,
    plunge_feed: float = PLUNGE_FEED,
    entry_heights: Floats | Mapping[str, Floats | None] | None = None,
    max_lines: int | None = None,
    progress: Progress | None = None,
) -> ProgramFiles:
    """Write a motion, or the named passes of a job in their order, as a program for a machine's controller.

    Positions and block times are fixed-point numbers, rounded to the last decimal of the dialect. Every pass begins
    with an approach from ``clearance`` above its highest point and ends with a retract to that height. From 0.1 mm
    above the material the tool plunges while C turns, at the radius where the pass begins, by at most the feed of the
    pass (or 1 um) per revolution and in no block faster than ``plunge_feed``. Without ``entry_heights`` the heights of
    this revolution are extrapolated from the motion, and C turns slower where necessary. A cumulative C begins within
    one turn of 0 and continues from pass to pass, so that the spindle never unwinds.

    If writing fails, the target folder is unchanged. Sub-programs of an earlier program of the same name that this one
    does not call are removed.

    Parameters
    ----------
    motion
        One motion, which becomes the pass "finish", or motions by pass name.
    machine
        Machine with the dialect and the convention.
    path
        The main program. Sub-programs are in the same folder: part.nc, part.finish.001.nc, ...
    header
        Design, tool, date and notes for the header.
    start
        Work offset, tool call and auxiliary functions; none by default.
    changes
        Changes of tool before passes, by the names of these; none by default.
    clearance
        Height of approach and retract above the highest point of the pass; more than the stock. [mm]
    depth
        Height of the material above the path where the pass begins, for all passes or by name; ``None`` for a pass that
        begins clear of the material and needs no plunge. [mm]
    plunge_feed
        Largest plunge feed into material. [mm/s]
    entry_heights
        Z for one revolution at the radius where the pass begins, for a motion or by name, at the angles of
        `turnwright.post.entry_path`. (n,) [mm]
    max_lines
        Largest number of lines in one file; by default the limit of the dialect.
    progress
        Called with (points done, total points).

    Raises
    ------
    ProgramError
        If the dialect is unknown, a number is too large, C stands still or turns by half a turn or more within a block,
        a block is too short or too long, or the files cannot be written.

    Sources
    -------
    The files of the dialects state their sources. Oracle of the formatting: Python's decimal module.

    Examples
    --------
    >>> from turnwright.machine import Axis, Machine
    >>> machine = Machine(
    ...     name="lathe", axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=1000, block_rate_hz=1000, dialect="nanotech"
    ... )
    >>> axes = {"C": [6.1, 6.2, 6.3], "X": [5.0, 4.9, 4.8], "Z": [0.25, 0.24, 0.23]}
    >>> motion = Motion(time=[0.0, 0.001, 0.002], axes=axes, machine=machine)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = write_nc(motion, machine, Path(folder) / "part.nc")
    ...     text = done.files[-1].read_text()
    >>> [file.name for file in done.files]
    ['part.nc', 'part.finish.001.nc']
    >>> print(text[text.rindex("G93") : text.rindex("G94")].rstrip())
    G93
    C355.23383 X4.900000 Z0.240000 F0.001
    C0.96341 X4.800000 Z0.230000
    """
    path = Path(path)
    dialect = dialect_of(machine)
    if not 0 < clearance <= MOST_CLEARANCE:
        raise ProgramError(
            f"clearance is {clearance:g} mm, it must be above 0 and at most {MOST_CLEARANCE:g} mm: correct it"
        )
    if not 0 < plunge_feed <= FASTEST_PLUNGE:
        raise ProgramError(
            f"plunge_feed is {plunge_feed * 60:g} mm/min, it must be above 0 and at most {FASTEST_PLUNGE * 60:g} "
            "mm/min: give it in mm/s"
        )
    motions = {"finish": motion} if isinstance(motion, Motion) else motion
    require_spindle_modes(dialect, (one.spindle_mode for one in motions.values()))
    approaches = _approaches(motions, clearance, depth, plunge_feed, entry_heights)
    passes = _passes(motions, machine, dialect, approaches)
    limit = dialect.max_lines if max_lines is None else max_lines
    if limit < MIN_LINES:
        raise ProgramError(f"max_lines is {limit}, it must be at least {MIN_LINES}: increase it")
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{path.stem}-", dir=path.parent))
    except OSError as error:
        raise _disk_error(path, error) from error
    try:
        header = header or ProgramHeader()
        header = replace(header, date=header.date or datetime.now(UTC).date().isoformat())
        job = _Job(
            folder, path, dialect, machine, header, start or ProgramStart(), dict(changes or {}), limit, progress
        )
        written = job.write(passes)
        _put_in_place(folder, path.parent, [path.name, *written], _find_stale_files(path, written))
        return job.summary(written)
    except OSError as error:
        raise _disk_error(path, error) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _disk_error(path: Path, error: OSError) -> ProgramError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return ProgramError(
            f"the disk is full while writing {path}, nothing was changed there: free some space, or write elsewhere"
        )
    if error.errno == errno.EFBIG:
        return ProgramError(
            f"{path} cannot be written, a file exceeds the largest size allowed here ({error.strerror}), nothing was "
            "changed: raise that limit (ulimit -f), or write elsewhere"
        )
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return ProgramError(f"{path} cannot be written, {path.parent} is not a folder: create it, or write elsewhere")
    return ProgramError(f"{path} cannot be written ({error.strerror}), nothing was changed: check its permissions")


def _approaches(
    motions: Mapping[str, Motion],
    clearance: float,
    depth: float | Mapping[str, float | None] | None,
    plunge_feed: float,
    entry_heights: Floats | Mapping[str, Floats | None] | None,
) -> dict[str, Approach]:
    approaches = {}
    depths = dict.fromkeys(motions, depth) if depth is None or isinstance(depth, int | float) else depth
    around = entry_heights if isinstance(entry_heights, Mapping) else dict.fromkeys(motions, entry_heights)
    for name, motion in motions.items():
        height, heights = depths[name], around.get(name)
        if height is not None and not np.isfinite(height):
            raise ProgramError(f"depth of pass {name} is {height:g} mm, it must be finite: correct it")
        approaches[name] = plan_approach(
            motion, clearance=clearance, depth=height, plunge_feed=plunge_feed, name=name,
            heights=None if heights is None else np.asarray(heights, dtype=np.float64),
        )  # fmt: skip
    return approaches


def _passes(
    motions: Mapping[str, Motion], machine: Machine, dialect: Dialect, approaches: Mapping[str, Approach]
) -> list[WrittenPass]:
    if not motions:
        raise ProgramError("a program has 0 passes, it needs at least 1: give a motion")
    convention = machine.convention
    factors = {
        letter: float(np.rad2deg(sign) if letter == "C" else sign) for letter, sign in axis_signs(machine).items()
    }
    clocking = float(np.rad2deg(convention.clocking))
    shifts = {"C": clocking, "X": 0.0, "Y": 0.0, "Z": 0.0}
    passes: list[WrittenPass] = []
    for name, motion in motions.items():
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _-]{0,39}", name):
            raise ProgramError(
                f"a pass has the name {name!r}, up to 40 letters, digits, blanks and - _ are allowed: rename it"
            )
        fast = sorted(FAST.keys() & motion.axes.keys())
        if fast:
            raise ProgramError(
                f"pass {name} moves axis {' and '.join(fast)} of a fast tool, which a lathe program cannot have: use "
                "write_fast_tool, or write motion.lathe() for the lathe alone"
            )
        unknown = set(motion.axes) - set(dialect.decimals)
        if unknown:
            raise ProgramError(
                f"pass {name} moves axis {', '.join(sorted(unknown))}, the dialect {dialect.name} has "
                f"{', '.join(dialect.decimals)}: remove it"
            )
        velocity = _velocity(motion) if dialect.velocities else None
        if not dialect.wrapped and motion.spindle_mode is None:
            start = approaches[name].start["C"] * factors["C"] + clocking
            turns = _turns_on(passes[-1] if passes else None, start, motion.sense * convention.c_sense)
            shifts = {**shifts, "C": clocking + 360.0 * turns}
        numbers = {letter: one for letter, one in motion.axes.items() if letter != "C" or motion.spindle_mode is None}
        _require_sizes(name, numbers, factors, shifts, "reaches", "mm or deg: check its unit")
        if velocity is not None:
            _require_sizes(name, velocity, factors, {}, "moves at", "mm/s or deg/s: check the time of its blocks")
        passes.append(
            WrittenPass(
                name=name, motion=motion, letters=dialect.letters(motion.axes), factors=factors, shifts=shifts,
                clocking=clocking, dialect=dialect, velocity=velocity, approach=approaches[name],
            )
        )  # fmt: skip
    if len({cut.letters for cut in passes}) > 1:
        raise ProgramError(
            "some passes move Y and others do not, all passes of a program need the same axes: give every pass a Y"
        )
    names = {_file_part(cut.name) for cut in passes}
    if len(names) < len(passes):
        raise ProgramError("two passes have the same file name: give them names that differ in more than blanks")
    return passes


def _turns_on(before: WrittenPass | None, start: float, sense: int) -> int:
    """Return the turns to add to C, so that it turns by less than one turn to the start of an approach [deg].

    C comes from the end of the pass before, or from 0 for the first pass.
    """
    end = (
        0.0
        if before is None or before.motion.spindle_mode is not None
        else float(before.motion.axes["C"][-1]) * before.factors["C"] + before.shifts["C"]
    )
    return sense * math.ceil(sense * (end - start) / 360.0)


def _require_sizes(
    name: str, numbers: Mapping[str, Floats], factors: Mapping[str, float], shifts: Mapping[str, float], what: str,
    remedy: str,
) -> None:  # fmt: skip
    for letter, values in numbers.items():
        largest = max(abs(values.min()), abs(values.max())) * abs(factors[letter]) + abs(shifts.get(letter, 0.0))
        if largest > MAX_POSITION:
            raise ProgramError(
                f"axis {letter} of pass {name} {what} {largest:.3g}, the limit is {MAX_POSITION:g} {remedy}"
            )


def _velocity(motion: Motion) -> dict[str, Floats]:
    """Return the velocities of a motion, or those of the parabolas that `track` uses; from rest to rest.

    The velocity at the first and last point is 0, as a controller begins with that of the block before.
    """
    velocity = {}
    for letter, position in motion.axes.items():
        speed = np.empty(position.size)
        if motion.velocity is None:
            tracking_kernel.rates(motion.time, position, speed)
        else:
            speed[:] = motion.velocity[letter]
        speed[[0, -1]] = 0.0
        velocity[letter] = speed
    return velocity


def _file_part(name: str) -> str:
    return name.replace(" ", "-")


@dataclass(slots=True)
class _Job:
    folder: Path  # temporary
    path: Path
    dialect: Dialect
    machine: Machine
    header: ProgramHeader
    start: ProgramStart
    changes: dict[str, ToolChange]
    limit: int
    progress: Progress | None
    lines: int = 0
    bytes: int = 0
    done: int = 0
    total: int = 0
    links_s: float = 0.0
    entries: list[ProgramPass] = field(default_factory=list)
    approaches: dict[str, Approach] = field(default_factory=dict)
    begins: list[str] = field(default_factory=list)
    spindle: list[str] = field(default_factory=list)

    def write(self, passes: list[WrittenPass]) -> list[str]:
        """Write all files into the folder; return the names of the sub-programs in the order of their calls."""
        loops = find_loops(passes, self.dialect)
        passes = even_loops(passes, loops)
        self.total = sum(one.points for one in passes)
        self.entries = [self._entry(one, NO_HASH) for one in passes]
        self.approaches = {one.name: one.approach for one in passes}
        self.begins = [
            one.word("C", one.approach.start["C"]) if one.motion.spindle_mode is None else "" for one in passes
        ]
        self.spindle = [
            " ".join(start_spindle(self.dialect, mode, one.motion.sense)) if (mode := one.motion.spindle_mode) else ""
            for one in passes
        ]
        self.links_s = link_seconds([(one.approach, one.motion) for one in passes], self.machine)
        self.links_s += sum(2 * change.height / TRAVERSE_FEED for change in self.changes.values())
        begin, end = self.start.lines(self.dialect)
        main = [*self.dialect.setup, *begin]
        blocks = self.total + sum(
            plunge.time.size
            for one in passes
            if (plunge := one.approach.plunge) is not None and one.motion.spindle_mode is None
        )
        inline = not self.dialect.always_call and blocks + 100 * (len(passes) + 1) <= self.limit
        if not (inline or self.dialect.call):
            raise ProgramError(
                f"the program has {blocks} blocks, the limit is {self.limit} lines, and the dialect "
                f"{self.dialect.name} has no sub-programs: allow more lines"
            )
        subs: list[str] = []
        with (self.folder / self.path.name).open("wb") as file:
            if inline:
                # The hashes in the header are known at the end: it is written twice, with the same length.
                self._text(file, self._head() + main)
                looped = 0  # passes that loops have written
                for index, one in enumerate(passes):
                    if (loop := loops.get(index)) is not None:
                        looped = index + loop.count
                        digests = self._loop(file, one, loop)
                        self.entries[index:looped] = map(self._entry, passes[index:looped], digests)
                    if index < looped:
                        continue
                    self._text(file, [*self._change(one), f"( PASS: {one.name} )", *self._approach(one)])
                    if one.motion.spindle_mode is not None:
                        rows, digest = self._spindle_cut(one, one.motion.spindle_mode)
                        self._text(file, [*rows, *self._retract(one)])
                        self.entries[index] = self._entry(one, digest)
                        continue
                    if one.approach.plunge is not None:
                        self._text(file, [*self._plunge_begins(one), *self._plunge(one), f"( PASS: {one.name} )"])
                    self._text(file, [*self.dialect.cut_begin])
                    self.entries[index] = self._entry(one, self._cut(one, [(file, 1, one.motion.time.size)]))
                    self._text(file, self._retract(one))
                self._text(file, [*end, self.dialect.program_end, *self.dialect.end])
                file.seek(0)
                file.write("\n".join(self.dialect.commented(self._head())).encode())
            else:
                for index, one in enumerate(passes):
                    names, digest = self._sub_programs(one)
                    self.entries[index] = self._entry(one, digest)
                    subs += names
                    main += [*self._change(one), f"( PASS {index + 1} OF {len(passes)} )"]
                    main += [self.dialect.call.format(file=name) for name in names]
                self._text(file, [*self._head(), *main, *end, self.dialect.program_end, *self.dialect.end])
        return subs

    def _head(self) -> list[str]:
        approaches = list(self.approaches.values())
        return self.dialect.first_lines(self.path.name) + lines(
            self.header,
            self.machine,
            self.dialect,
            self.entries,
            approaches,
            self.begins,
            self.links_s,
            self.spindle,
            self.start,
            self.changes,
        )

    def summary(self, written: list[str]) -> ProgramFiles:
        return ProgramFiles(
            files=tuple(self.path.parent / name for name in [self.path.name, *written]),
            lines=self.lines,
            bytes=self.bytes,
            minutes=sum(entry.minutes for entry in self.entries),
            links_minutes=self.links_s / 60,
            passes=tuple(self.entries),
            approaches=self.approaches,
        )

    def _entry(self, one: WrittenPass, digest: str) -> ProgramPass:
        time = one.motion.time
        return ProgramPass(
            name=one.name,
            points=one.points,
            minutes=float(time[-1] - time[0]) / 60,
            first_c=one.first_c,
            sense=one.motion.sense,
            hash=digest,
        )

    def _text(self, file: BinaryIO, rows: list[str]) -> None:
        if not rows:
            return
        data = ("\n".join(self.dialect.commented(rows)) + "\n").encode("ascii")
        file.write(data)
        self.lines += len(rows)
        self.bytes += len(data)

    def _loop(self, file: BinaryIO, one: WrittenPass, loop: Loop) -> list[str]:
        """Write the cuts of a repeated pass as one loop; return the hash of each of them."""
        mode = one.motion.spindle_mode
        assert mode is not None  # noqa: S101 - for the type checker
        lowest = one.raised(-(loop.count - 1) * loop.step)
        step = loop.step * one.factors["Z"]
        origins = [(loop.count - 1 - k) * step for k in range(loop.count)]
        words = {
            name: f"{value:.{one.dialect.decimals['Z']}f}" for name, value in (("first", origins[0]), ("step", step))
        }
        rows: list[str] = []
        digests = []
        for origin in origins:
            rows, digest = self._spindle_cut(lowest, mode, origin)
            digests.append(digest)
        begin, end = (
            [line.format(count=loop.count, **words) for line in lines]
            for lines in (self.dialect.loop_begin, self.dialect.loop_end)
        )
        marker = f"( PASS: {loop.name}{EACH_TIME} )"
        self._text(
            file, [*self._change(one), *begin, marker, *self._approach(lowest), *rows, *self._retract(lowest), *end]
        )
        return digests

    def _change(self, one: WrittenPass) -> list[str]:
        """Return the lines of a change of tool before a pass: up first, as the next tool may be longer."""
        if (change := self.changes.get(one.name)) is None:
            return []
        up = one.word("Z", max(approach.clear for approach in self.approaches.values()) + change.height)
        return [*self.dialect.cut_end, *self.dialect.straight(up, TRAVERSE_FEED, "TOOL CHANGE"), change.call]

    def _approach(self, one: WrittenPass) -> list[str]:
        start, dialect = one.approach.start, self.dialect
        others = " ".join(one.word(letter, start[letter]) for letter in ("X", "Y") if letter in one.letters)
        if (mode := one.motion.spindle_mode) is not None:
            first = float(one.motion.axes["Z"][0])
            plunge = dialect.straight(one.word("Z", first), one.approach.plunge_feed, "INTO THE MATERIAL")
            return [
                *dialect.cut_end,
                *dialect.straight(one.word("Z", one.approach.clear), TRAVERSE_FEED, "CLEAR OF THE PART"),
                *dialect.straight(others, TRAVERSE_FEED),
                # Only then does the spindle start: a feed move of X while it runs is a cut.
                *start_spindle(dialect, mode, one.motion.sense),
                *dialect.straight(one.word("Z", start["Z"]), DOWN_FEED, "ABOVE THE MATERIAL"),
                *(plunge if one.approach.plunge is not None else []),
            ]
        return [
            *dialect.cut_end,
            *dialect.straight(one.word("Z", one.approach.clear), TRAVERSE_FEED, "CLEAR OF THE PART"),
            *dialect.straight(others, TRAVERSE_FEED),
            *dialect.rapid(one.word("C", start["C"])),
            *dialect.straight(one.word("Z", start["Z"]), DOWN_FEED, "ABOVE THE MATERIAL"),
        ]

    def _plunge_begins(self, one: WrittenPass) -> list[str]:
        """Return the lines before a plunge, or a continued one; they separate its blocks from those of the cut."""
        return [f"( PASS: {one.name}{ENTRY} )", *self.dialect.cut_resume]

    def _plunge(self, one: WrittenPass) -> list[str]:
        motion = one.approach.plunge
        if motion is None:
            return []
        velocity = _velocity(motion) if self.dialect.velocities else None
        text = BytesIO()
        before = self.lines, self.bytes, self.done, self.progress
        self.progress = None
        self._cut(replace(one, motion=motion, velocity=velocity), [(text, 1, motion.time.size)])
        self.lines, self.bytes, self.done, self.progress = before  # counted when the text is written
        return text.getvalue().decode("ascii").splitlines()

    def _retract(self, one: WrittenPass) -> list[str]:
        clear = one.word("Z", one.approach.clear)
        stop = () if one.motion.spindle_mode is None else self.dialect.spindle_end
        return [*self.dialect.cut_end, *self.dialect.straight(clear, DOWN_FEED, "CLEAR OF THE PART"), *stop]

    def _spindle_cut(self, one: WrittenPass, mode: SpindleMode, origin: float = 0.0) -> tuple[list[str], str]:
        """Return the lines of a cut in spindle mode, and the hash of its points."""
        axes, points = one.motion.axes, one.motion.blocks
        units = {
            letter: np.array([one.units(letter, value) for value in axes[letter][points].tolist()], dtype=np.int64)
            for letter in one.letters
            if letter != "C"
        }
        rows, digest = spindle_lines(one.name, units, mode, one.motion.sense, self.dialect, origin)
        self._count(points.size)
        return rows, digest

    def _spindle_programs(self, one: WrittenPass, mode: SpindleMode) -> tuple[list[str], str]:
        """Write a pass in spindle mode as sub-programs; return their names and the hash."""
        rows, digest = self._spindle_cut(one, mode)
        each = self.limit - 50
        parts = [rows[k : k + each] for k in range(0, len(rows), each)]
        names = [f"{self.path.stem}.{_file_part(one.name)}.{k + 1:03d}{self.path.suffix}" for k in range(len(parts))]
        for k, (name, part) in enumerate(zip(names, parts, strict=True)):
            with self._sub_program(one, name, k, len(names)) as file:
                self._text(file, part)
        return names, digest

    @contextmanager
    def _sub_program(self, one: WrittenPass, name: str, k: int, count: int) -> Iterator[BinaryIO]:
        """Yield the file of the sub-program ``k`` of ``count`` of a pass, with its first lines; add its last."""
        with (self.folder / name).open("wb") as file:
            part = f", PART {k + 1} OF {count}" if count > 1 else ""
            self._text(file, [*self.dialect.first_lines(name), SUB_SIGNATURE, f"( PASS: {one.name}{part} )"])
            self._text(file, [*language(self.machine, self.dialect), *(self._approach(one) if k == 0 else [])])
            yield file
            self._text(file, [*(self._retract(one) if k == count - 1 else []), self.dialect.call_end])
            self._text(file, [*self.dialect.end])

    def _sub_programs(self, one: WrittenPass) -> tuple[list[str], str]:
        if one.motion.spindle_mode is not None:
            return self._spindle_programs(one, one.motion.spindle_mode)
        points, plunge = one.motion.time.size, self._plunge(one)
        each = self.limit - 30
        count = -(-(len(plunge) + points - 1) // each)
        names = [f"{self.path.stem}.{_file_part(one.name)}.{k + 1:03d}{self.path.suffix}" for k in range(count)]

        def files() -> Iterator[tuple[BinaryIO, int, int]]:
            for k, name in enumerate(names):
                first, last = k * each - len(plunge) + 1, (k + 1) * each - len(plunge) + 1
                entry = plunge[k * each : (k + 1) * each]
                with self._sub_program(one, name, k, len(names)) as file:
                    if entry:
                        self._text(file, [*self._plunge_begins(one), *entry])
                    if last > 1:
                        # The plunge ends in this file, or ended with the file before, and the cut begins.
                        begins = first <= 1
                        self._text(file, [f"( PASS: {one.name} )"] if begins and plunge else [])
                        self._text(file, [*(self.dialect.cut_begin if begins else self.dialect.cut_resume)])
                        yield file, max(first, 1), min(last, points)

        return names, self._cut(one, files())

    def _cut(
        self, one: WrittenPass, spans: Iterator[tuple[BinaryIO, int, int]] | list[tuple[BinaryIO, int, int]]
    ) -> str:
        """Format the blocks of one pass on all cores and write them in order; return the hash."""
        scale = {letter: 10.0 ** self.dialect.decimals[letter] for letter in one.letters}
        turn = 360 * int(scale["C"])
        wraps = {"C": turn if self.dialect.wrapped else 0}
        words = one.letters if one.velocity is None else [sign for letter in one.letters for sign in (letter, ":")]
        letters = np.array([ord(letter) for letter in words], dtype=np.int64)
        decimals = np.array([self.dialect.decimals[letter] for letter in one.letters], dtype=np.int64)
        decimals = np.repeat(decimals, len(words) // len(one.letters))
        prefix = np.frombuffer(self.dialect.block.encode(), dtype=np.uint8)
        leading = np.frombuffer(b"PVT" if self.dialect.velocities else b"", dtype=np.uint8)
        sign = float(one.motion.sense) * self.machine.convention.c_sense
        digest = hashlib.sha256()

        def quantise(start: int, stop: int) -> Ints:
            rows = np.empty((stop - start, len(words)), dtype=np.int64)
            each = len(words) // len(one.letters)
            for column, letter in enumerate(one.letters):
                values = one.motion.axes[letter][start:stop]
                factor, shift = one.factors[letter] * scale[letter], one.shifts[letter] * scale[letter]
                text_kernel.quantise(values, factor, shift, wraps.get(letter, 0), rows, each * column)
                if one.velocity is not None:
                    text_kernel.quantise(one.velocity[letter][start:stop], factor, 0.0, 0, rows, each * column + 1)
            return rows

        def work(chunk: _Chunk) -> tuple[int, memoryview, memoryview]:
            start, stop, mantissa, places, duration = chunk
            angle = one.motion.axes["C"][start - 1 : stop]
            factor, shift = one.factors["C"] * scale["C"], one.shifts["C"] * scale["C"]
            bad = text_kernel.check_steps(angle, factor, shift, turn // 2, sign)
            if bad >= 0:
                raise _step_error(one, start - 1 + bad)
            rows = quantise(start, stop)
            out = np.empty((stop - start) * (prefix.size + 24 * (letters.size + 1)) + 8, dtype=np.uint8)
            size = text_kernel.format_blocks(rows, letters, decimals, prefix, leading, mantissa, places, out)
            return stop - start, bytes_to_hash(rows, duration), out[:size].data

        digest.update(bytes_to_hash(quantise(0, 1), np.zeros(1)))
        self._count(1)
        state = np.zeros(3, dtype=np.int64)
        threads = cores()
        with ThreadPoolExecutor(threads) as pool, ThreadPoolExecutor(1) as hasher:
            hashed = hasher.submit(digest.update, b"")
            for file, start, stop in spans:
                state[1] = 0  # every file begins with a feed word
                for points, rows, data in _in_order(pool, work, self._chunks(one, start, stop, state), 2 * threads):
                    hashed.result()
                    hashed = hasher.submit(digest.update, rows)
                    file.write(data)
                    self.bytes += len(data)
                    self.lines += points
                    self._count(points)
            hashed.result()
        return digest.hexdigest()

    def _count(self, points: int) -> None:
        self.done += points
        if self.progress is not None:
            self.progress(self.done, self.total)

    def _chunks(self, one: WrittenPass, start: int, stop: int, state: Ints) -> Iterator[_Chunk]:
        """Yield the chunks of a file with their feeds, which must be chosen in order in one thread."""
        unit, every, most = self.dialect.time_code, self.dialect.feed_every_block, self.dialect.feed_decimals
        state[0] = min(state[0], start)
        for begin in range(start, stop, CHUNK_POINTS):
            end = min(begin + CHUNK_POINTS, stop)
            mantissa, places = np.empty((2, end - begin), dtype=np.int64)
            duration = np.empty(end - begin)
            bad = text_kernel.feeds(one.motion.time, begin, end, unit, every, most, state, mantissa, places, duration)
            longest = self.dialect.longest_block
            if bad < 0 and duration.max() > longest:
                bad = begin + int(duration.argmax())
            if bad >= 0:
                span = one.motion.time[bad] - one.motion.time[bad - 1]
                raise ProgramError(
                    f"block {bad} of pass {one.name} lasts {span:.6g} s, the limits are 1e-6 s to {longest:g} s: check "
                    "the spindle speed and the points per revolution"
                )
            if self.dialect.velocities:  # block times are separate lines
                self.lines += int(np.count_nonzero(mantissa))
            yield begin, end, mantissa, places, duration


def _step_error(one: WrittenPass, index: int) -> ProgramError:
    places = one.dialect.decimals["C"]
    angle = one.motion.axes["C"]
    step = abs(one.units("C", float(angle[index])) - one.units("C", float(angle[index - 1]))) / 10.0**places
    if step >= 180:
        return ProgramError(
            f"block {index} of pass {one.name} turns C by {step:g} deg, it must be below 180 deg, so that the sense of "
            "rotation is unambiguous: use more points per revolution"
        )
    return ProgramError(
        f"block {index} of pass {one.name} turns C by {step:g} deg, it must be at least one unit of the program, "
        f"{10.0**-places:.{places}f} deg: use fewer points per revolution"
    )


def _in_order(
    pool: ThreadPoolExecutor,
    work: Callable[[_Chunk], tuple[int, memoryview, memoryview]],
    chunks: Iterator[_Chunk],
    ahead: int,
) -> Iterator[tuple[int, memoryview, memoryview]]:
    """Yield ``work(chunk)`` in the order of the chunks, with a few in progress at once."""
    waiting: deque[Future[tuple[int, memoryview, memoryview]]] = deque()
    try:
        for chunk in chunks:
            waiting.append(pool.submit(work, chunk))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def _find_stale_files(path: Path, written: list[str]) -> list[str]:
    """Return sub-programs of an earlier program of this name, so that they are not run by mistake."""
    pattern = re.compile(re.escape(path.stem) + r"\.[A-Za-z0-9_-]+\.\d{3,}" + re.escape(path.suffix))
    stale = []
    for entry in path.parent.iterdir():
        if pattern.fullmatch(entry.name) and entry.name not in written and entry.is_file():
            with entry.open("rb") as file:
                if is_signed(file.read(BEGIN_BYTES), SUB_SIGNATURE):
                    stale.append(entry.name)
    return stale


def _put_in_place(source: Path, target: Path, names: list[str], stale: list[str]) -> None:
    """Move the files of a program into place, the main program last; undo everything if one fails."""
    backup = source / "earlier"
    backup.mkdir()
    order = [*stale, *names[1:], names[0]]
    try:
        for name in order:
            if (target / name).exists():
                (target / name).replace(backup / name)
            if name in names:
                (source / name).replace(target / name)
    except BaseException:
        for name in order:
            if (backup / name).exists():
                (backup / name).replace(target / name)
            elif name in names and not (source / name).exists():
                (target / name).unlink(missing_ok=True)
        raise
