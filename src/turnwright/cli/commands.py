"""The commands, thin: each reads what was requested, calls the job, and reports the result."""

from turnwright.cli import (  # noqa: F401 - each registers its commands
    cutting,
    materials,
    measuring,
    serving,
    showing,
    studies,
    tiling,
    tolerances,
)
from turnwright.cli.shared import Door, app, tell

__all__ = ["Door", "app", "tell"]
