"""The commands, thin: each reads what was asked for, calls the job, and says what came out."""

from turnwright.cli.commands import # noqa: F401 - each registers its commands     _cutting, _measuring, _serving, _showing, _studies, _tiling, _tolerances
from turnwright.cli import materials as _materials
from turnwright.cli.shared import Door, app, tell

__all__ = ["Door", "app", "tell"]
