"""The workbench: a web page on which an engineer plans, inspects and corrects a part.

It contains no physics of its own. The server answers from the event loop; computations run in other processes: a few
persistent workers for interactive requests, and one process per run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from turnwright.web.address import is_loopback, listening
from turnwright.web.serve import serve_until_stopped

if TYPE_CHECKING:
    from turnwright.web.app import create_app

__all__ = ["create_app", "is_loopback", "listening", "serve_until_stopped"]


def __getattr__(name: str) -> Any:
    """Import the server on demand: worker processes do not need it."""
    if name != "create_app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from turnwright.web.app import create_app  # noqa: PLC0415

    return create_app
