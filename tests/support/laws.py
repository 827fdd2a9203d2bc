"""How many examples a law gets: a quarter in the suite, all of them in the proof."""

import os

from hypothesis import settings

SHARE = 1.0 if os.environ.get("TURNWRIGHT_LAWS") == "all" else 0.25
LEAST = 3


def examples(count, **more):
    """Return the settings of a law whose proof has so many examples."""
    return settings(max_examples=max(round(SHARE * count), min(LEAST, count)), **more)
