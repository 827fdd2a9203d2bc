"""A generic lathe with a C axis, in plain RS-274: one program, cumulative C, an F in every block."""

from turnwright.post.dialect import Dialect

__all__ = ["GENERIC"]

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
    always_call=False,
    max_lines=1_000_000,
    sources={
        "feed": "RS-274/NGC: under G93, F is one over the minutes of the move and is required in every block",
        "feed_decimals": "assumed: accepted by any controller",
        "call": "assumed: a Fanuc-like call of a file by name",
        "max_lines": "assumed: files of about 50 MB",
    },
)
