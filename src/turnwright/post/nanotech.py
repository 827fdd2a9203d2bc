"""Moore Nanotech lathes: a main program that calls one sub-program per pass."""

from turnwright.post.dialect import Dialect

__all__ = ["NANOTECH"]

NANOTECH = Dialect(
    name="nanotech",
    decimals={"C": 5, "X": 6, "Y": 6, "Z": 6},
    wrapped=True,
    feed="seconds",
    feed_decimals=9,
    feed_every_block=False,
    block="",
    setup=("G71 G90 G40 G18", "M26.1 (SPINDLE AS C AXIS)"),
    call="M98({file})",
    always_call=True,
    max_lines=1_000_000,
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
