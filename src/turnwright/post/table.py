"""Read a table of C X Z points, such as other path planners write."""

from __future__ import annotations

import io
import warnings
from os import PathLike
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats, rows_of_numbers
from turnwright.errors import ProgramError
from turnwright.machine import Machine
from turnwright.path import Motion
from turnwright.post.convention import motion_of, reading, short_steps
from turnwright.post.header import ProgramWarning, require_regular

__all__ = ["read_table"]

COLUMNS = {"c_deg": "C", "x_mm": "X", "y_mm": "Y", "z_mm": "Z"}


def read_table(
    path: str | PathLike[str],
    machine: Machine,
    *,
    spindle_rpm: float | None = None,
    block_rate_hz: float | None = None,
) -> Motion:
    """Read a comma-separated table with the columns C_deg, X_mm, Z_mm (and Y_mm), in the machine's convention.

    C may run either way and may roll over after each turn. A repeated point is dropped. Rows in which C stands still
    while the tool moves are a plunge or a retract: at the two ends they are dropped with a warning, between cutting
    rows they are refused.

    Parameters
    ----------
    path
        The table; its first line names the columns.
    machine
        Machine with the convention of the table.
    spindle_rpm
        Constant spindle speed. [rev/min]
    block_rate_hz
        Alternatively, constant rate of the rows. [1/s]

    Raises
    ------
    ProgramError
        If not exactly one of speed and rate is given, or the table cannot be read or is not one motion.

    Warns
    -----
    ProgramWarning
        If plunge or retract rows were dropped.
    """
    path = Path(path)
    speeds = [value for value in (spindle_rpm, block_rate_hz) if value is not None]
    if len(speeds) != 1 or not 0 < speeds[0] < np.inf:
        raise ProgramError(
            f"{path} needs one speed above 0, spindle_rpm is {spindle_rpm} and block_rate_hz {block_rate_hz}: give one"
        )
    values = _columns(path)
    rows = np.arange(2, len(values["C"]) + 2)  # line in the file
    moved = np.zeros(len(rows), dtype=bool)
    moved[:1] = True
    for column in values.values():
        moved[1:] |= np.diff(column) != 0
    values, rows = {letter: column[moved] for letter, column in values.items()}, rows[moved]
    turning = short_steps(values["C"]) != 0
    cutting = np.flatnonzero(turning)
    if not cutting.size:
        raise ProgramError(f"{path} never moves C, at least 1 row must: give a table of a C-axis motion")
    first, last = int(cutting[0]), int(cutting[-1]) + 1
    if not turning[first:last].all():
        bad = rows[first + 1 + int(np.argmin(turning[first:last]))]
        raise ProgramError(f"{path} line {bad} moves the tool within a cut while C is at rest: split the table there")
    dropped = len(rows) - (last + 1 - first)
    if dropped:
        warnings.warn(
            f"{path}: {dropped} rows of plunge and retract, in which C is at rest, were dropped",
            ProgramWarning,
            stacklevel=2,
        )
    axes = {letter: column[first : last + 1].copy() for letter, column in values.items()}
    steps = short_steps(axes["C"])
    if (np.abs(steps) == 180).any() or not ((steps > 0).all() or (steps < 0).all()):
        bad = int(np.flatnonzero((np.abs(steps) == 180) | (steps * steps[0] <= 0))[0])
        raise ProgramError(
            f"{path} line {rows[first + bad + 1]} turns C back or by half a turn, the sense of rotation must not "
            "change: split the table"
        )
    turned = np.concatenate([[0.0], np.cumsum(steps)])
    axes["C"] = turned + axes["C"][0]
    time = (
        np.arange(len(turned)) / block_rate_hz
        if block_rate_hz is not None
        else np.abs(turned) / (6 * speeds[0])  # 1 rev/min is 6 deg/s
    )
    return motion_of(path, axes, time, machine)


def _columns(path: Path) -> dict[str, Floats]:
    try:
        with reading(path):
            require_regular(path)
            text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ProgramError(f"{path} is not a table of text: give comma-separated numbers") from error
    head, _, body = text.partition("\n")
    names = [name.strip().lower() for name in head.split(",")]
    letters = [COLUMNS.get(name) for name in names]
    if not {"C", "X", "Z"} <= set(letters) or None in letters or len(set(letters)) < len(letters):
        raise ProgramError(
            f"{path} has the columns {head.strip()[:60]!r}, it needs C_deg, X_mm, Z_mm (and may have Y_mm): name them"
        )
    if not body.strip():
        raise ProgramError(f"{path} has no rows, at least 2 are needed: give the points below the names")
    try:
        table = rows_of_numbers(io.StringIO(body), ",", comments="#")
    except ValueError as error:
        raise ProgramError(f"{path} holds a value that is not a number ({error}): correct it") from error
    if table.shape[1] != len(letters) or not np.isfinite(table).all():
        bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
        where = f"line {bad[0] + 2} is not finite" if bad.size else f"rows have {table.shape[1]} numbers"
        raise ProgramError(f"{path} has {len(letters)} columns and its {where}: correct the table")
    return {str(letter): np.ascontiguousarray(table[:, k]) for k, letter in enumerate(letters)}
