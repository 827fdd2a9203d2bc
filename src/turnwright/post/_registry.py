"""Which dialects there are: a new one is a sibling file and one more name here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turnwright.errors import ProgramError
from turnwright.post.generic import GENERIC
from turnwright.post.nanotech import NANOTECH

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.post._dialect import Dialect

__all__ = ["DIALECTS", "dialect_of"]

DIALECTS = {dialect.name: dialect for dialect in (GENERIC, NANOTECH)}


def dialect_of(machine: Machine) -> Dialect:
    """Return the dialect that a machine's controller speaks.

    Raises
    ------
    ProgramError
        If there is no such dialect, or the machine's convention is not one.
    """
    dialect = DIALECTS.get(machine.dialect)
    if dialect is None:
        raise ProgramError(
            f"machine {machine.name} speaks the dialect {machine.dialect!r}, Turnwright writes "
            f"{', '.join(sorted(DIALECTS))}: name one of these, or add a file to turnwright/post"
        )
    convention = machine.convention
    for field in ("x_side", "c_sense", "z_sign"):
        if getattr(convention, field) not in (-1, 1):
            raise ProgramError(
                f"{field} of machine {machine.name} is {getattr(convention, field)}, it must be +1 or -1: correct the "
                "machine's convention"
            )
    return dialect
