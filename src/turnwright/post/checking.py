"""A dialect checked: test programs are written in it and read back."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from turnwright.errors import ProgramError
from turnwright.machine import Axis, Controller, Machine
from turnwright.path import Motion, SpindleMode
from turnwright.post.dialect import Dialect
from turnwright.post.reader import read_nc
from turnwright.post.writer import write_nc

__all__ = ["DialectCheck", "check_dialect"]

POINTS = 1500
"""Points of a test pass."""

POINTS_PER_REV = 90
"""Points per revolution of a test pass."""

HEIGHTS = {"rough": 0.01, "finish": 0.0}
"""Height of each test pass. [mm]"""

RADII = np.linspace(5.0, -0.01, 21)
"""Points of a test cut in spindle mode. [mm]"""

LOOP_HEIGHTS = (0.05, 0.034, 0.018)
"""Heights of the cuts of a test pass that is repeated. [mm]"""

TIME_RATIO = 1e-3
"""Largest relative difference of the time of a pass that is read back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DialectCheck:
    """Differences between test programs in a dialect and the motions that they were written from.

    Parameters
    ----------
    dialect
        The dialect.
    differences
        Largest difference by axis letter, in mm or deg; within half a unit of the last decimal.
    time_ratio
        Largest relative difference of the time of a pass.
    programs
        Number of programs: both senses of rotation, with and without Y, in one file and with sub-programs; and in
        spindle mode, at constant spindle speed and constant surface speed, and with loops, as far as the dialect has
        them.
    lines
        First lines of a cut, as written.
    """

    dialect: Dialect
    differences: Mapping[str, float]
    time_ratio: float
    programs: int
    lines: tuple[str, ...]


def check_dialect(name: str) -> DialectCheck:
    """Write test programs of two passes in a dialect, read them back and compare them.

    The motion has no symmetry: a wrong sign, letter, order or unit changes it.

    Parameters
    ----------
    name
        A dialect that comes with Turnwright, or the path of its ``.toml`` file.

    Raises
    ------
    ProgramError
        If there is no such dialect, its file is wrong, a program cannot be read back, or differs by more than half a
        unit of the last decimal.
    """
    dialect = Dialect.load(name)
    machine = Machine(
        name="test lathe", axes=dict.fromkeys("CXYZ", Axis()), spindle_rpm=1000, block_rate_hz=1000, dialect=name,
        controller=Controller(interpolation=dialect.interpolation),
    )  # fmt: skip
    differences: dict[str, float] = {}
    cases = list(
        product(
            (1, -1),
            ("CXZ", "CXYZ") if "Y" in dialect.decimals else ("CXZ",),
            (None, 400) if dialect.call else (None,),
        )
    )
    time_ratio = 0.0
    lines: tuple[str, ...] = ()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "test.nc"
        for sense, axes, max_lines in cases:
            passes = {name: _motion(machine, sense, axes, height) for name, height in HEIGHTS.items()}
            done = write_nc(passes, machine, path, max_lines=max_lines, depth={"rough": 0.02, "finish": None})
            for one, motion in passes.items():
                again = read_nc(path, machine, name=one)
                time_ratio = max(time_ratio, _compare(dialect, one, again, motion, differences))
            lines = lines or _first_lines(done.files[-1], dialect)
        modes = _spindle_modes(dialect)
        for mode, sense in product(modes, (1, -1)):
            motion = mode.motion(RADII, 0.1 - 0.03 * RADII + 0.01 * RADII**2, machine, sense=sense)
            write_nc(motion, machine, path, depth=0.02)
            _compare_spindle(dialect, read_nc(path, machine), motion, differences)
            if dialect.loop_begin:
                cuts = {
                    f"rough {number}": replace(motion, axes={**motion.axes, "Z": motion.axes["Z"] + height})
                    for number, height in enumerate(LOOP_HEIGHTS, 1)
                }
                write_nc({**cuts, "finish": motion}, machine, path, depth=0.02)
                for each, cut in cuts.items():
                    _compare_spindle(dialect, read_nc(path, machine, name=each), cut, differences)
    return DialectCheck(
        dialect=dialect,
        differences=differences,
        time_ratio=time_ratio,
        programs=len(cases) + (4 if dialect.loop_begin else 2) * len(modes),
        lines=lines,
    )


def _spindle_modes(dialect: Dialect) -> list[SpindleMode]:
    """Return the modes of a cut in spindle mode that a dialect can write."""
    plain = SpindleMode(feed=0.01, spindle_rpm=777.5)
    modes = [plain, replace(plain, per_rev=True)] if dialect.spindle_start else []
    return [*modes, replace(plain, per_rev=True, surface_speed=150.0)] if dialect.surface_speed_start else modes


def _compare_spindle(dialect: Dialect, again: Motion, motion: Motion, differences: dict[str, float]) -> None:
    """Add to the differences those of a cut in spindle mode; raise if one is too large."""
    at, was = again.blocks, motion.blocks
    if at.size != was.size or again.sense != motion.sense or again.spindle_mode is None:
        raise ProgramError(
            f"dialect {dialect.name}: a cut in spindle mode of {was.size} points and sense {motion.sense} reads "
            f"back as {at.size} and {again.sense}: correct spindle_start, feed_per_min and feed_per_rev"
        )
    for letter in "XZ":
        off = float(np.abs(again.axes[letter][at] - motion.axes[letter][was]).max())
        differences[letter] = max(differences.get(letter, 0.0), off)
    for what, values in {"time": (again.time, motion.time), "revolutions": (again.axes["C"], motion.axes["C"])}.items():
        ratio = abs(float(np.ptp(values[0]) / np.ptp(values[1])) - 1)
        if ratio > TIME_RATIO:
            raise ProgramError(
                f"dialect {dialect.name}: the {what} of a cut in spindle mode differ by {ratio:.1%} after reading "
                "back: correct spindle_start, surface_speed_start, feed_per_min and feed_per_rev"
            )


def _motion(machine: Machine, sense: int, axes: str, height: float) -> Motion:
    turned = 2 * np.pi * np.arange(POINTS) / POINTS_PER_REV
    angle, radius = sense * (turned + 0.3), np.linspace(5.0, -0.01, POINTS)
    values = {
        "C": angle, "X": radius, "Y": 0.02 * np.sin(2 * turned + 0.1),
        "Z": height - 0.03 * radius + 0.004 * np.cos(angle) + 0.002 * np.sin(3 * angle) + 0.01 * radius**2,
    }  # fmt: skip
    return Motion(time=turned / (2 * np.pi) / 0.5, axes={letter: values[letter] for letter in axes}, machine=machine)


def _compare(dialect: Dialect, name: str, again: Motion, motion: Motion, differences: dict[str, float]) -> float:
    """Add to the differences, and return that of the time; raise if one is too large."""
    if again.time.size != motion.time.size or set(again.axes) != set(motion.axes):
        raise ProgramError(
            f"dialect {dialect.name}: pass {name} has {motion.time.size} points of {', '.join(motion.axes)} and reads "
            f"back as {again.time.size} of {', '.join(again.axes)}: correct the lines of the dialect"
        )
    for letter, values in motion.axes.items():
        unit = np.rad2deg(1.0) if letter == "C" else 1.0
        off = float(np.abs(again.axes[letter] - values).max()) * unit
        differences[letter] = max(differences.get(letter, 0.0), off)
        limit = 0.5 * 10.0 ** -dialect.decimals[letter]
        if off > limit * 1.001 + 1e-9:
            raise ProgramError(
                f"dialect {dialect.name}: {letter} of pass {name} differs by {off:.3g} after reading back, the limit "
                f"is {limit:g}, half of its last decimal: correct the words or their order"
            )
    ratio = abs(float(np.ptp(again.time) / np.ptp(motion.time)) - 1)
    if ratio > TIME_RATIO:
        raise ProgramError(
            f"dialect {dialect.name}: pass {name} takes {np.ptp(motion.time):.4g} s, read back "
            f"{np.ptp(again.time):.4g} s: correct the meaning of feed, or its decimals"
        )
    return ratio


def _first_lines(file: Path, dialect: Dialect) -> tuple[str, ...]:
    rows = file.read_text().splitlines()
    count = len(dialect.cut_begin)
    begins = [k for k in range(len(rows)) if rows[k : k + count] == [*dialect.cut_begin]]
    return tuple(rows[begins[-1] :][:4]) if begins else ()
