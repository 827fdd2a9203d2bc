"""The available dialects; a new one is another entry here."""

from __future__ import annotations

from turnwright.errors import ProgramError
from turnwright.machine import Machine
from turnwright.post.dialect import Dialect

__all__ = ["DIALECTS", "dialect_of"]

GENERIC = Dialect(
    name="generic",
    decimals={"X": 6, "Y": 6, "Z": 6, "C": 6},
    wrapped=False,
    feed="inverse minutes",
    feed_decimals=6,
    feed_every_block=True,
    block="G1 ",
    setup=("G21 G90 G40 G18",),
    call="M98 <{file}>",
    sources={
        "feed": "RS-274/NGC: under G93, F is one over the minutes of the move and is required in every block",
        "feed_decimals": "assumed: accepted by any controller",
        "call": "assumed: a Fanuc-like call of a file by name",
        "max_lines": "assumed: files of about 50 MB",
    },
)
"""A generic lathe with a C axis, in plain RS-274: one program, cumulative C, an F in every block."""

NANOTECH = Dialect(
    name="nanotech",
    decimals={"C": 5, "X": 6, "Y": 6, "Z": 6},
    wrapped=True,
    feed="seconds",
    feed_decimals=9,
    setup=("G71 G90 G40 G18", "M26.1 (SPINDLE AS C AXIS)"),
    call="M98({file})",
    always_call=True,
    sources={
        "feed": "published slow-tool-servo programs for these machines: LRBLRBLRB/upm_toolpath_waviness, "
        "1021-r1000sts-res1-0.02-0.5-tool191.nc (G93 F0.001 at 0.5 deg per block), and O. Spires's post-processor for "
        "the 350FG, which names the number 'Inverse Feedrate (seconds per line)'",
        "feed_decimals": "assumed: a nanosecond, a millionth of a block of 1 ms",
        "wrapped": "the same program runs C from 0 to 360 repeatedly",
        "setup": "G71, G90, G40, G18 and M26.1 as in the same program",
        "call": "assumed: the form in which these controllers are known to call a file by name",
        "max_lines": "assumed: files of about 30 MB",
    },
)
"""Moore Nanotech lathes: a main program that calls one sub-program per pass."""

PMAC = Dialect(
    name="pmac",
    decimals={"C": 6, "X": 6, "Y": 6, "Z": 6},
    wrapped=False,
    feed="milliseconds",
    feed_decimals=6,
    setup=("ABS",),
    max_lines=1_000_000_000,
    sources={
        "feed": "Turbo PMAC/PMAC2 Software Reference, PVT{data}: the time of every segment in ms until the next one, "
        "up to 4095.9998 ms, which the controller rounds to a quarter of a microsecond",
        "feed_decimals": "a nanosecond, far below the quarter of a microsecond to which the controller rounds",
        "velocities": "the same, {axis}{data}:{data}: signed, in axis units over the time units of Isx90, which is "
        "1000 for seconds; no velocity means 0; PMAC User Manual: the path is a Hermite spline through the points",
        "setup": "the same: ABS, LINEAR, RAPID, DWELL{data} in ms, F in axis units over the time units of Isx90",
        "comment": "the same: a semicolon",
        "call": "none: a program too long for the memory goes through the rotary buffer, line by line",
        "max_lines": "assumed: the rotary buffer takes any number",
        "end": "assumed: M30 is an M-code subroutine, of the installation",
    },
    velocities=True,
    comment="; ",
    longest_block=4.0959998,
)
"""Delta Tau's PMAC controllers in position-velocity-time moves: one program of native statements, sent as it runs."""

DIALECTS = {dialect.name: dialect for dialect in (GENERIC, NANOTECH, PMAC)}


def dialect_of(machine: Machine) -> Dialect:
    """Return the program dialect of a machine's controller, or raise if its programs cannot be written."""
    dialect = DIALECTS.get(machine.dialect)
    if dialect is None:
        raise ProgramError(
            f"machine {machine.name} has the dialect {machine.dialect!r}, Turnwright writes "
            f"{', '.join(sorted(DIALECTS))}: name one of these, or add one to turnwright/post/registry.py"
        )
    interpolation = machine.controller.interpolation
    if dialect.velocities and interpolation != "hermite":
        raise ProgramError(
            f"the dialect {dialect.name} has velocities and needs the interpolation hermite, the controller of "
            f"{machine.name} has {interpolation}: choose another dialect, or the interpolation hermite"
        )
    return dialect
