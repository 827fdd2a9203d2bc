"""The controller's axes and Turnwright's: signs, zero of C, and the motion of positions in a program."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import InputError, ProgramError
from turnwright.machine import Machine
from turnwright.path import Motion

__all__ = ["axis_signs", "convention_line", "motion_of", "reading", "short_steps", "to_part_axes"]


def axis_signs(machine: Machine) -> dict[str, int]:
    """Return the signs of the controller's axes relative to Turnwright's."""
    convention = machine.convention
    return {"C": convention.c_sense, "X": convention.x_side, "Y": 1, "Z": convention.z_sign}


def convention_line(machine: Machine) -> str:
    """Return the machine's convention as one line that can be compared."""
    convention = machine.convention
    return (
        f"X SIDE {convention.x_side:+d}, C SENSE {convention.c_sense:+d}, Z SIGN {convention.z_sign:+d}, "
        f"CLOCKING {np.rad2deg(convention.clocking) + 0.0:.9f} DEG"
    )


def to_part_axes(axes: Mapping[str, Floats], machine: Machine) -> None:
    """Convert positions in the controller's axes, C cumulative in deg, in place."""
    convention = machine.convention
    for letter, values in axes.items():
        np.multiply(values, axis_signs(machine)[letter] * (np.pi / 180 if letter == "C" else 1), out=values)
    axes["C"][:] -= convention.c_sense * convention.clocking


def motion_of(
    path: Path, axes: Mapping[str, Floats], time: Floats, machine: Machine, velocity: Mapping[str, Floats] | None = None
) -> Motion:
    """Return the motion of positions in the controller's axes; they are converted in place."""
    to_part_axes(axes, machine)
    try:
        return Motion(time=time, axes=axes, machine=machine, velocity=velocity)
    except InputError as error:
        raise ProgramError(f"{path} does not hold a motion: {error}") from error


def short_steps(degrees: Floats) -> Floats:
    """Return the steps of C, reduced to at most half a turn. (n - 1,) [deg]."""
    step = np.diff(degrees)
    return np.asarray(step - 360 * np.rint(step / 360))


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise a `ProgramError` where the file system fails."""
    try:
        yield
    except OSError as error:
        where = error.filename or path
        raise ProgramError(f"{where} cannot be read ({error.strerror}): check its name and folder") from error
