"""Delta Tau's PMAC controllers in position-velocity-time moves: one program of native statements, sent as it runs."""

from turnwright.post.dialect import Dialect

__all__ = ["PMAC"]

PMAC = Dialect(
    name="pmac",
    decimals={"C": 6, "X": 6, "Y": 6, "Z": 6},
    wrapped=False,
    feed="milliseconds",
    feed_decimals=6,
    feed_every_block=False,
    block="",
    setup=("ABS",),
    call="",
    always_call=False,
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
