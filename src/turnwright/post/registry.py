"""Which dialects there are: a new one is a sibling file and one more name here."""

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
    """Return the dialect that a machine's controller speaks.

    Raises
    ------
    ProgramError
        If there is no such dialect, or its programs ask for another interpolation than the controller's.
    """
    dialect = DIALECTS.get(machine.dialect)
    if dialect is None:
        raise ProgramError(
            f"machine {machine.name} speaks the dialect {machine.dialect!r}, Turnwright writes "
            f"{', '.join(sorted(DIALECTS))}: name one of these, or add a file to turnwright/post"
        )
    own = machine.controller.interpolation
    if dialect.velocities and own != "hermite":
        raise ProgramError(
            f"programs in the dialect {dialect.name} ask for cubics by their velocities (hermite), the controller of "
            f"{machine.name} is said to interpolate by {own}: choose another dialect, or interpolation hermite"
        )
    return dialect
