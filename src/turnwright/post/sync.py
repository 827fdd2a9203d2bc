"""A lathe program with a table of the heights of a fast tool, by position or by time."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np

from turnwright._arrays import Floats, Ints, rows_of_numbers
from turnwright._kernels import table as table_kernel, text as text_kernel
from turnwright._validate import positive
from turnwright.errors import ProgramError
from turnwright.machine import Machine
from turnwright.path import Motion
from turnwright.post.approach import PLUNGE_FEED, entry_path, entry_shares
from turnwright.post.convention import convention_line, reading, short_steps, to_part_axes
from turnwright.post.dialect import Dialect, dialect_of
from turnwright.post.header import (
    NO_HASH,
    SOFTWARE,
    ProgramHeader,
    ProgramStart,
    inspect_nc,
    plain,
    program_hash,
    require_regular,
)
from turnwright.post.reader import read_nc
from turnwright.post.writer import CHUNK_POINTS, ProgramFiles, _disk_error, _velocity, write_nc
from turnwright.progress import Progress

__all__ = ["FastToolFiles", "read_fast_tool", "write_fast_tool"]

SIGNATURE = "# TURNWRIGHT FAST TOOL 1"
COLUMNS = {"position": ("radius_mm", "angle_deg"), "time": ()}
"""Columns before those of the fast tool's axes."""
AXIS_COLUMNS = {"W": "height_mm", "U": "outward_mm"}
"""Columns of the fast tool's axes."""
HEIGHT_DECIMALS = 7
"""Decimals of W and U: a tenth of a nanometre."""
MAX_DEVIATION = 0.05
"""Deviation of a motion from straight lines between the heights of a stream, relative to the stroke."""
MAX_ROWS = 300_000_000
"""Rows that fit into memory."""
COINCIDENCE_TOL = 1e-6
"""Time difference at which a block and a height coincide, relative to the time between two heights."""
LINEARITY_TOL_MM = 1e-6
"""Deviation of Z between blocks, for a controller with cubic interpolation, from the lathe's motion."""
MIN_BLOCKS = 4
"""Blocks from which some are between the first and the last."""
END_TOL_RAD = 1e-6
"""Difference of C between the ends of table and program, which are both rounded."""
RADIUS_TOL_MM = 1e-5
"""Difference between the radius of a table and X of its program, which are both rounded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FastToolFiles:
    """The files that `write_fast_tool` wrote.

    Parameters
    ----------
    program
        The files of the lathe.
    table
        The file of the fast tool.
    by
        "position" or "time".
    rows
        Rows of the cut in the table.
    entry_rows
        Rows of the plunge before them.
    off
        Largest deviation of W, or U, at the points of the motion from the straight lines between the rows. [mm]
    """

    program: ProgramFiles
    table: Path
    by: str
    rows: int
    entry_rows: int
    off: float


def write_fast_tool(
    motion: Motion,
    machine: Machine,
    path: str | PathLike[str],
    *,
    by: Literal["position", "time"],
    rate_hz: float | None = None,
    header: ProgramHeader | None = None,
    start: ProgramStart | None = None,
    clearance: float = 5.0,
    depth: float | Mapping[str, float | None] | None = 0.0,
    plunge_feed: float = PLUNGE_FEED,
    entry_heights: Floats | None = None,
    progress: Progress | None = None,
) -> FastToolFiles:
    """Write the lathe program without W, see `write_nc` and `Motion.lathe`, and a table of W for the fast tool.

    The table is a text file, part.fast.csv for part.nc, and its header describes it. By position it has a row of
    radius, angle (those of the program) and height for every point of the motion, after the revolution of a plunge;
    between two rows heights are linear in the angle. By time it has one height every 1/``rate_hz`` s from the first
    point of the cut on, linear in between. Heights add to Z, out of the part, whatever the convention of the lathe. A
    second axis U, which adds to the distance from the axis, has one more column. If writing fails, nothing changes.

    Parameters
    ----------
    motion
        With an axis W.
    machine
        Machine with the dialect and the convention.
    path
        The main program.
    by
        Synchronisation of the table.
    rate_hz
        Heights per second, by time only. [Hz]
    header, start, clearance, depth, plunge_feed, entry_heights, progress
        See `write_nc`; the heights are the sum of Z and W, at the angles of `turnwright.post.entry_path`. Without them
        lathe and fast tool are extrapolated; the extrapolation error of the fast tool does not slow the plunge down.

    Raises
    ------
    ProgramError
        If the motion has no W, the rate is missing, superfluous or too low for the motion, the angle does not change
        from row to row, or the files cannot be written.
    """
    path = Path(path)
    if "W" not in motion.axes:
        raise ProgramError(
            f"the motion has the axes {', '.join(motion.axes)}, a fast tool needs W: use write_nc, or plan it "
            "with FastToolServo or HybridToolServo"
        )
    if by not in COLUMNS:
        raise ProgramError(f'by is {by!r}, it must be "position" or "time": choose one')
    if (rate_hz is None) != (by == "position"):
        raise ProgramError(f"a table by {by} has the rate {rate_hz}, only a table by time has a rate: correct it")
    dialect = dialect_of(machine)
    table = path.parent / f"{path.stem}.fast.csv"
    hidden = table.with_name(f".{table.name}.{os.getpid()}")
    _require_straight(motion, dialect)
    lathe_heights, table_motion = entry_heights, motion
    if depth is not None:
        lathe_heights, entered = _prepend_entry(motion, entry_heights)
        table_motion = entered if by == "position" else motion
    rows, decimals, off = (
        _make_position_rows(table_motion, machine, dialect) if by == "position" else _make_stream_rows(motion, rate_hz)
    )
    counts = rows.shape[0], table_motion.time.size - motion.time.size
    try:
        try:
            with hidden.open("wb") as file:
                file.write(_head(motion, machine, dialect, counts, rate_hz, path, (NO_HASH, NO_HASH)))
                digest = _body(file, rows, decimals)
            program = write_nc(
                motion.lathe(), machine, path, header=header, start=start, clearance=clearance, depth=depth,
                plunge_feed=plunge_feed, entry_heights=lathe_heights, progress=progress,
            )  # fmt: skip
            with hidden.open("r+b") as file:
                file.write(_head(motion, machine, dialect, counts, rate_hz, path, (digest, program.hash)))
            hidden.replace(table)
        except OSError as error:
            raise _disk_error(table, error) from error
    finally:
        hidden.unlink(missing_ok=True)
    return FastToolFiles(program=program, table=table, by=by, rows=counts[0] - counts[1], entry_rows=counts[1], off=off)


def _require_straight(motion: Motion, dialect: Dialect) -> None:
    """Raise if Z of the lathe's controller deviates between its blocks from the motion that the table assumes."""
    lathe = motion.lathe()
    if not dialect.velocities or lathe.time.size < MIN_BLOCKS:
        return
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415 - costly to import

    curve = CubicHermiteSpline(lathe.time, lathe.axes["Z"], _velocity(lathe)["Z"])
    # The first and the last block begin or end at rest.
    steady = (motion.time >= lathe.time[1]) & (motion.time <= lathe.time[-2])
    off = float(np.abs(curve(motion.time[steady]) - motion.axes["Z"][steady]).max(initial=0.0))
    if off > LINEARITY_TOL_MM:
        raise ProgramError(
            f"Z deviates by up to {off * 1e6:.3g} nm between blocks from what the fast tool assumes, as the dialect "
            f"{dialect.name} interpolates by cubics, the limit is {LINEARITY_TOL_MM * 1e6:g} nm: remove blocks_per_rev"
        )


def _prepend_entry(motion: Motion, heights: Floats | None) -> tuple[Floats | None, Motion]:
    """Return the lathe's heights in a plunge, if ``heights`` are given, and the motion with one turn before it."""
    turned, axes = entry_path(motion)
    lathe, fast = entry_shares(motion, axes["Z"] + axes["W"] if heights is None else np.asarray(heights, np.float64))
    ahead = turned[-1] - turned[:-1]
    before = {letter: values[:-1] for letter, values in {**axes, **fast}.items()}
    before["C"] = motion.axes["C"][0] - motion.sense * ahead
    entered = {letter: np.concatenate([before[letter], values]) for letter, values in motion.axes.items()}
    time = np.concatenate([motion.time[0] - ahead, motion.time])
    return None if heights is None else lathe, Motion(time=time, axes=entered, machine=motion.machine)


def _make_position_rows(motion: Motion, machine: Machine, dialect: Dialect) -> tuple[Ints, Ints, float]:
    """Return radius, angle and height in units of their last decimals, the decimals, and the rounding error."""
    convention = machine.convention
    letters = _fast_axes(motion)
    decimals = np.array([dialect.decimals["X"], dialect.decimals["C"], *[HEIGHT_DECIMALS] * len(letters)])
    scale = 10.0**decimals
    turn = 360 * int(scale[1])
    rows = np.empty((motion.time.size, 2 + len(letters)), dtype=np.int64)
    degrees, mark = float(np.rad2deg(convention.c_sense)), float(np.rad2deg(convention.clocking))
    text_kernel.quantise(motion.axes["X"], convention.x_side * scale[0], 0.0, 0, rows, 0)
    text_kernel.quantise(motion.axes["C"], degrees * scale[1], mark * scale[1], turn, rows, 1)
    off = 0.0
    for column, letter in enumerate(letters, 2):
        text_kernel.quantise(motion.axes[letter], scale[2], 0.0, 0, rows, column)
        off = max(off, float(np.abs(rows[:, column] / scale[2] - motion.axes[letter]).max()))
    step = np.diff(rows[:, 1]) * (motion.sense * convention.c_sense) % turn
    bad = np.flatnonzero((step == 0) | (step >= turn // 2))
    if bad.size:
        raise ProgramError(
            f"row {bad[0] + 2} of the fast tool's table turns C by {step[bad[0]] / scale[1]:g} deg, the limits are one "
            f"unit of the program, {1 / scale[1]:g} deg, and half a turn: use another number of points per revolution"
        )
    return rows, decimals, off


def _make_stream_rows(motion: Motion, rate_hz: float | None) -> tuple[Ints, Ints, float]:
    """Return the heights at a constant rate in units of their last decimal, the decimals, and the largest deviation."""
    rate = positive(rate_hz or 0.0, "rate_hz", "Hz")
    time = motion.time - motion.time[0]
    count = math.ceil(time[-1] * rate - 1e-6) + 1
    if count > MAX_ROWS:
        raise ProgramError(f"the stream has {count:.3g} heights, the limit is {MAX_ROWS:.0e}: lower rate_hz")
    at = np.arange(count) / rate
    unit = 10.0**HEIGHT_DECIMALS
    positions = [motion.axes[letter] for letter in _fast_axes(motion)]
    rows = np.stack([np.rint(np.interp(at, time, values) * unit) for values in positions], axis=1).astype(np.int64)
    restored = [np.interp(time, at, column / unit) for column in rows.T]
    off = max(float(np.abs(back - values).max()) for back, values in zip(restored, positions, strict=True))
    stroke = max(float(np.ptp(values)) for values in positions)
    if off > MAX_DEVIATION * stroke + 10.0**-HEIGHT_DECIMALS:
        raise ProgramError(
            f"at rate_hz {rate:g} heights deviate by up to {off * 1e3:.3g} um from the fast tool's motion, the "
            f"limit is {MAX_DEVIATION:.0%} of its stroke of {stroke * 1e3:.3g} um: raise the rate, the motion has "
            f"points at up to {1 / float(np.diff(time).min()):.4g} Hz"
        )
    return rows, np.full(len(positions), HEIGHT_DECIMALS), off


def _fast_axes(motion: Motion) -> list[str]:
    return [letter for letter in AXIS_COLUMNS if letter in motion.axes]


def _head(
    motion: Motion,
    machine: Machine,
    dialect: Dialect,
    counts: tuple[int, int],
    rate_hz: float | None,
    path: Path,
    hashes: tuple[str, str],
) -> bytes:
    """Return the header; its length does not depend on the hashes. ``counts`` are all rows and the entry rows."""
    away = "GROWS" if machine.convention.x_side > 0 else "FALLS"
    grows = "GROWS" if motion.sense * machine.convention.c_sense > 0 else "FALLS"
    if rate_hz is None:
        lines_of_kind = [
            "# BY: POSITION",
            f"# RADIUS: X OF THE PROGRAM, MM, {away} AWAY FROM THE AXIS, DECIMALS {dialect.decimals['X']}",
            f"# ANGLE: C OF THE PROGRAM, DEGREES FROM 0 TO 360, {grows} FROM ROW TO ROW BY LESS THAN HALF A TURN",
            f"# ANGLE DECIMALS: {dialect.decimals['C']}",
            "# BETWEEN ROWS: STRAIGHT OVER THE ANGLE TURNED",
            f"# ENTRY ROWS: {counts[1]}, "
            + (
                "ONE TURN AT THE RADIUS WHERE THE CUT BEGINS, FOR EVERY TURN OF THE PLUNGE"
                if counts[1]
                else "NO PLUNGE"
            ),
        ]
        names = COLUMNS["position"]
    else:
        lines_of_kind = [
            "# BY: TIME",
            f"# RATE: {float(rate_hz)!r} HEIGHTS PER SECOND",
            "# START: THE FIRST HEIGHT IS THAT OF THE FIRST POINT OF THE CUT, WHERE THE APPROACH OF THE PROGRAM ENDS",
            "# BETWEEN ROWS: STRAIGHT OVER TIME",
        ]
        names = COLUMNS["time"]
    lines = [
        SIGNATURE,
        f"# SOFTWARE: {SOFTWARE}",
        f"# MACHINE: {plain(machine.name)}",
        f"# CONVENTION: {convention_line(machine)}",
        *lines_of_kind,
        f"# HEIGHT: MM THAT THE FAST TOOL ADDS TO Z, OUT OF THE PART, DECIMALS {HEIGHT_DECIMALS}",
        *(["# OUTWARD: MM THAT IT ADDS TO THE DISTANCE FROM THE AXIS, DECIMALS 7"] if "U" in motion.axes else []),
        f"# ROWS: {counts[0]}",
        f"# PROGRAM: {plain(path.name)}, SHA256 {hashes[1]}",
        f"# SHA256: {hashes[0]}",
        ",".join([*names, *(AXIS_COLUMNS[letter] for letter in _fast_axes(motion))]),
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _body(file: BinaryIO, rows: Ints, decimals: Ints) -> str:
    digest = hashlib.sha256()
    for start in range(0, rows.shape[0], CHUNK_POINTS):
        part = rows[start : start + CHUNK_POINTS]
        out = np.empty(part.size * 24 + 8, dtype=np.uint8)
        data = out[: table_kernel.format_rows(part, decimals, out)].tobytes()
        digest.update(data)
        file.write(data)
    return digest.hexdigest()


def read_fast_tool(path: str | PathLike[str], machine: Machine, *, progress: Progress | None = None) -> Motion:
    """Read a program and its fast-tool table back as one motion, with the axis W.

    By position the motion has a point at every row of the table, by time at every block of the program and at every
    height of the stream; in between, axes are linear.

    Parameters
    ----------
    path
        The main program; the table of part.nc is part.fast.csv in the same folder.
    machine
        Machine with the dialect and the convention.
    progress
        See `read_nc`.

    Raises
    ------
    ProgramError
        If a file cannot be read or is damaged, the table belongs to another program or convention, or the two do not
        fit.
    """
    path = Path(path)
    file = path.parent / f"{path.stem}.fast.csv"
    fields, names, table = _read(file)
    if fields["CONVENTION"] != convention_line(machine):
        raise ProgramError(
            f"{file} is written for {fields['CONVENTION']}, {machine.name} has {convention_line(machine)}: read it "
            "with the machine that it was written for"
        )
    info = inspect_nc(path)
    if not fields["PROGRAM"].endswith(f"SHA256 {program_hash(info.passes)}"):
        raise ProgramError(f"{file} belongs to another program than {path}: write both again")
    motion = read_nc(path, machine, progress=progress)
    if fields["BY"] == "TIME":
        match = re.match(r"\d{1,17}(?:\.\d{0,25})?(?:e[+-]?\d{1,2})?", fields.get("RATE", ""))
        rate = float(match[0]) if match else 0.0
        if rate <= 0:
            raise ProgramError(f"{file} states no rate: write it again")
        at = np.arange(len(table)) / rate
        after = np.clip(np.searchsorted(motion.time, at), 1, motion.time.size - 1)
        distance = np.minimum(np.abs(at - motion.time[after - 1]), np.abs(motion.time[after] - at))
        # Times that differ only by rounding are merged, as C must turn between two points.
        time = np.union1d(motion.time, at[(distance * rate > COINCIDENCE_TOL) & (at < motion.time[-1])])
        blocks = np.searchsorted(time, motion.time)
        rows = {name: np.interp(time, at, column) for name, column in zip(names, table.T, strict=True)}
    else:
        match = re.match(r"\d{1,9}(?=,)", fields.get("ENTRY ROWS", ""))
        if match is None or int(match[0]) > len(table) - 2:
            raise ProgramError(f"{file} does not state how many of its {len(table)} rows are the entry: write it again")
        table = table[int(match[0]) :]
        time = _find_row_times(file, table, motion, machine)
        blocks = None
        rows = dict(zip(names, table.T, strict=True))
    axes = {letter: np.interp(time, motion.time, values) for letter, values in motion.axes.items()}
    fast = {letter: rows[name] for letter, name in AXIS_COLUMNS.items() if name in rows}
    return Motion(time=time, axes={**axes, **fast}, machine=machine, stated_blocks=blocks)


def _find_row_times(file: Path, table: Floats, motion: Motion, machine: Machine) -> Floats:
    """Return the time of the program at each row of a table by position."""
    c = np.concatenate([[0.0], np.cumsum(short_steps(table[:, 1]))]) + table[0, 1]
    to_part_axes({"C": c}, machine)
    c += 2 * np.pi * np.rint((motion.axes["C"][0] - c[0]) / (2 * np.pi))
    if not (np.diff(c) * motion.sense > 0).all():
        raise ProgramError(f"{file} turns C in another sense than its program: write both again")
    ahead = motion.sense * motion.axes["C"]
    if abs(c[0] - motion.axes["C"][0]) > END_TOL_RAD:
        raise ProgramError(
            f"{file} has its first row of the cut at C {np.rad2deg(c[0]):.3f} deg where its program begins at "
            f"{np.rad2deg(motion.axes['C'][0]):.3f} deg, as its number of entry rows was edited: write both again"
        )
    time: Floats = np.interp(motion.sense * c, ahead, motion.time)
    x = np.interp(motion.sense * c, ahead, motion.axes["X"]) * machine.convention.x_side
    off = np.abs(x - table[:, 0])
    worst = int(np.argmax(off))
    if off[worst] > RADIUS_TOL_MM or abs(c[-1] - motion.axes["C"][-1]) > END_TOL_RAD:
        ends = np.rad2deg([c[-1], motion.axes["C"][-1]])
        raise ProgramError(
            f"{file} has the radius {table[worst, 0]:g} mm where its program has X {x[worst]:g} mm, and ends at C "
            f"{ends[0]:.3f} deg where that ends at {ends[1]:.3f} deg: write both again"
        )
    return time


def _read(file: Path) -> tuple[dict[str, str], list[str], Floats]:
    with reading(file):
        require_regular(file)
        data = file.read_bytes()
    text = data[: 1 << 14].decode("latin-1")
    fields = dict(re.findall(r"^# ([A-Z0-9 ]+): (.*)$", text, re.MULTILINE))
    needed = ("BY", "CONVENTION", "ROWS", "PROGRAM", "SHA256")
    first = re.search(r"^(?!#).*\n", text, re.MULTILINE)
    names = first[0].strip().split(",") if first else []
    before = COLUMNS.get(fields.get("BY", "").lower())
    is_valid = before is not None and names in ([*before, "height_mm"], [*before, *AXIS_COLUMNS.values()])
    if not text.startswith(SIGNATURE) or first is None or not is_valid or not all(name in fields for name in needed):
        raise ProgramError(f"{file} is not a fast-tool table, which begins with {SIGNATURE!r}: give the right file")
    body = data[first.end() :]
    if hashlib.sha256(body).hexdigest() != fields["SHA256"]:
        raise ProgramError(f"{file} has rows that do not match its hash, it was damaged or edited: write it again")
    try:
        table = _parse_rows(body, len(names))
    except ValueError as error:
        raise ProgramError(f"{file} does not hold rows of numbers ({error}): write it again") from error
    if str(table.shape[0]) != fields["ROWS"]:
        raise ProgramError(f"{file} has {table.shape[0]} rows, its header states {fields['ROWS']}: write it again")
    return fields, names, table


def _parse_rows(body: bytes, columns: int) -> Floats:
    """Return the numbers of a table, (rows, columns); raise ValueError unless it holds nothing else."""
    table = np.empty((body.count(b"\n"), columns))
    text = np.frombuffer(body + bytes(text_kernel.BEHIND), dtype=np.uint8)
    if len(table) and text_kernel.parse_rows(text, len(body), table) == len(table):
        return table
    return rows_of_numbers(body.decode("latin-1").splitlines(), ",")
