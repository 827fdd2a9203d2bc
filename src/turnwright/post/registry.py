"""The available dialects: a new one is another module and another entry here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turnwright.errors import ProgramError
from turnwright.post.generic import GENERIC
from turnwright.post.nanotech import NANOTECH
from turnwright.post.pmac import PMAC

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.post.dialect import Dialect

__all__ = ["DIALECTS", "dialect_of"]

DIALECTS = {dialect.name: dialect for dialect in (GENERIC, NANOTECH, PMAC)}


def dialect_of(machine: Machine) -> Dialect:
    """Return the program dialect of a machine's controller.

    Raises
    ------
    ProgramError
        If the dialect is unknown, or its programs need another interpolation than the controller's.
    """
    dialect = DIALECTS.get(machine.dialect)
    if dialect is None:
        raise ProgramError(
            f"machine {machine.name} has the dialect {machine.dialect!r}, Turnwright writes "
            f"{', '.join(sorted(DIALECTS))}: name one of these, or add a module to turnwright/post"
        )
    interpolation = machine.controller.interpolation
    if dialect.velocities and interpolation != "hermite":
        raise ProgramError(
            f"the dialect {dialect.name} has velocities and needs the interpolation hermite, the controller of "
            f"{machine.name} has {interpolation}: choose another dialect, or the interpolation hermite"
        )
    return dialect
