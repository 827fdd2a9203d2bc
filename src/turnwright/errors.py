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
    └── Stopped               the user asked for an end

Every message is one sentence: what, how much, the limit, the remedy.
"""

__all__ = [
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
]


class TurnwrightError(Exception):
    """The root: catch this to catch everything Turnwright raises on purpose."""


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


class Stopped(TurnwrightError):  # noqa: N818 - an end that was asked for is not an error
    """The user asked for an end before the work was done."""
