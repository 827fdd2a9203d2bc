"""The exceptions of Turnwright.

::

    TurnwrightError
    ├── InputError            the input is invalid or cannot be carried out (also a ValueError)
    │   ├── UnitError         a quantity that cannot be read, or that has the wrong dimension
    │   ├── DomainError       a point where a surface is not defined
    │   ├── GougeError        a tool, feed or path that gouges or cannot produce the nominal surface
    │   ├── LimitError        a motion or a job beyond the limits of the machine or computer
    │   ├── JobError          an invalid job file; the message names the field
    │   ├── ProgramError      an NC program that cannot be written or read
    │   ├── MapError          a file of a measured map that cannot be written or read
    │   └── StudyError        a study that cannot continue; finished cases are kept
    ├── CorrectionError       a correction that is not written because its benefit is not certain
    └── Stopped               the run was cancelled

A message is one sentence: what was given, what is allowed, and the remedy. Several sentences stand on separate lines.
Long inputs are shortened, so that a line has at most `MAX_LINE_CHARACTERS` and a message at most `MAX_LINES` lines.
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
    "quote",
    "shorten_message",
]

MAX_LINE_CHARACTERS = 400
MAX_LINES = 20
MAX_VALUE_CHARACTERS = 60

HEAD_CHARACTERS = 130
"""Characters kept at the start of a shortened line; the rest of the limit goes to its end, where the remedy stands."""


def shorten_message(message: str) -> str:
    """Return a message with long lines cut in the middle and surplus lines dropped.

    >>> shorten_message("name is '" + "x" * 5000 + "', the limit is 30 letters: rename it")[-60:]
    "...xxxxxxxxxxxxxxxxxxx', the limit is 30 letters: rename it"
    """
    if len(message) <= MAX_LINE_CHARACTERS and message.count("\n") < MAX_LINES:
        return message
    lines = message.split("\n")
    if len(lines) > MAX_LINES:
        lines = [*lines[: MAX_LINES - 1], f"and {len(lines) - MAX_LINES + 1} lines more"]
    return "\n".join(
        line
        if len(line) <= MAX_LINE_CHARACTERS
        else f"{line[:HEAD_CHARACTERS]} ... {line[HEAD_CHARACTERS + 5 - MAX_LINE_CHARACTERS :]}"
        for line in lines
    )


def quote(value: object) -> str:
    """Return the text of a value for a message, shortened to `MAX_VALUE_CHARACTERS`.

    >>> quote("0,5 mm"), quote([1.5] * 100)
    ("'0,5 mm'", '[1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1...')
    """
    if isinstance(value, float) and math.isinf(value):
        return "infinite"  # such as 1e999
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python does not print integers of thousands of digits
        text = "too long to be written out"
    return text if len(text) <= MAX_VALUE_CHARACTERS else f"{text[: MAX_VALUE_CHARACTERS - 3]}..."


class TurnwrightError(Exception):
    """Base class of all exceptions that Turnwright raises on purpose."""

    def __init__(self, *message: object) -> None:
        super().__init__(*(shorten_message(str(part)) for part in message))


class InputError(TurnwrightError, ValueError):
    """The input is invalid or cannot be carried out."""


class UnitError(InputError):
    """A quantity cannot be read, or has the wrong dimension."""


class DomainError(InputError):
    """A point lies where the surface is not defined."""


class GougeError(InputError):
    """The tool, feed or path gouges or cannot produce the nominal surface."""


class LimitError(InputError):
    """A limit of the machine or of the computer is exceeded."""


class JobError(InputError):
    """A job file is invalid; the message names the field, the value and the remedy."""


class ProgramError(InputError):
    """An NC program cannot be written or read."""


class MapError(InputError):
    """A file of a measured map cannot be written or read."""


class StudyError(InputError):
    """A study cannot continue, such as on a full disk; finished cases are kept."""


class CorrectionError(TurnwrightError):
    """A correction is not written because its benefit is not certain."""


class Stopped(TurnwrightError):  # noqa: N818 - a requested stop is not an error
    """The run was cancelled before it finished."""
