"""All commands of the command line; importing this module registers them."""

import typer

from turnwright.cli import (  # noqa: F401 - importing them registers the commands
    cutting,
    exporting,
    importing,
    materials,
    measuring,
    optics,
    posts,
    serving,
    showing,
    studies,
    tiling,
    tolerances,
)
from turnwright.cli.shared import Session, app, print_status

__all__ = ["Session", "app", "command", "print_status"]

command = typer.main.get_command(app)
