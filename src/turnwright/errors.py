"""Everything Turnwright raises on purpose.

::

    TurnwrightError
    ├── InputError            the request cannot be carried out as it was stated (also a ValueError)
    │   ├── UnitError         a quantity that cannot be read, or that has the wrong dimension
    │   ├── DomainError       a point where a surface is not defined
    │   ├── GougeError        a tool, feed or path that cannot leave the designed surface
    │   ├── LimitError        something beyond what the machine can do
    │   ├── JobError          a job file that is wrong, with the field named
    │   ├── ProgramError      a lathe program that cannot be written or read
    │   ├── MapError          a file of a measured map that cannot be written or read
    │   └── StudyError        many cases that cannot go on; what is finished is kept
    ├── CorrectionError       a correction that is not written because it would not certainly help
    └── Stopped               the user asked for an end

Every message is one sentence: what, how much, the limit, the remedy; or a few, each on a line of its own. However long
an input is that a message shows, its lines stay within `LONGEST` letters and it within `MOST_LINES` lines.
"""

import math

__all__ = [
    "CorrectionError",
    "DomainError",
    "GougeError",
    "InputError",
    "JobError",
    "LimitError",
    "MapError",
    "ProgramError",
    "Stopped",
    "StudyError",
    "TurnwrightError",
    "UnitError",
    "shortened",
    "shown",
]

LONGEST = 400
"""Letters in a line of a message."""

MOST_LINES = 20
"""Lines of a message: more would fill the screen."""

SHOWN = 60
"""Letters of a value that a message shows."""

HEAD = 130
"""Letters that stay before the cut in a line that is too long: what it is about. Limit and remedy come last."""


def shortened(message: str) -> str:
    """Return a message with its long lines cut in the middle, where they show an input, and without too many of them.

    >>> shortened("name is '" + "x" * 5000 + "', the limit is 30 letters: rename it")[-60:]
    "...xxxxxxxxxxxxxxxxxxx', the limit is 30 letters: rename it"
    """
    if len(message) <= LONGEST and message.count("\n") < MOST_LINES:
        return message
    lines = message.split("\n")
    if len(lines) > MOST_LINES:
        lines = [*lines[: MOST_LINES - 1], f"and {len(lines) - MOST_LINES + 1} lines more"]
    return "\n".join(
        line if len(line) <= LONGEST else f"{line[:HEAD]} ... {line[HEAD + 5 - LONGEST :]}" for line in lines
    )


def shown(value: object) -> str:
    """Return a value in a few letters, as a message shows what was given.

    >>> shown("0,5 mm"), shown([1.5] * 100)
    ("'0,5 mm'", '[1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1...')
    """
    if isinstance(value, float) and math.isinf(value):
        return "infinite"  # 1e999 is, to those who read it
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python writes out no number of thousands of digits
        text = "too long to be written out"
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


class TurnwrightError(Exception):
    """The root: catch this to catch everything Turnwright raises on purpose."""

    def __init__(self, *message: object) -> None:
        super().__init__(*(shortened(str(one)) for one in message))


class InputError(TurnwrightError, ValueError):
    """The request cannot be carried out as it was stated."""


class UnitError(InputError):
    """A quantity cannot be read, or has the wrong dimension."""


class DomainError(InputError):
    """A point lies where the surface is not defined."""


class GougeError(InputError):
    """The tool, feed or path cannot leave the designed surface."""


class LimitError(InputError):
    """The machine cannot do what is asked."""


class JobError(InputError):
    """A job file is wrong; the message names the field, the value and the remedy."""


class ProgramError(InputError):
    """A lathe program cannot be written or read."""


class MapError(InputError):
    """A file of a measured map cannot be written or read."""


class StudyError(InputError):
    """Many cases cannot go on, such as on a full disk; what is finished is kept."""


class CorrectionError(TurnwrightError):
    """A correction is not written because it would not certainly help."""


class Stopped(TurnwrightError):  # noqa: N818 - an end that was asked for is not an error
    """The user asked for an end before the work was done."""
