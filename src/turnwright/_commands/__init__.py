"""The commands, thin: each reads what was asked for, calls the job, and says what came out."""

from turnwright._commands import _cutting, _materials, _measuring, _tiling  # noqa: F401 - each registers its commands
from turnwright._commands._shared import Door, app, tell

__all__ = ["Door", "app", "tell"]
