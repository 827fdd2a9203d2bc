"""The workbench: a page where an engineer plans, sees and corrects a part. It holds no physics of its own.

The server answers from the event loop alone; all that takes time happens in other processes: a few that are kept warm
for what a page waits for, and one for each run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from turnwright.web.address import is_loopback, listening
from turnwright.web.serve import serve_until_stopped

if TYPE_CHECKING:
    from turnwright.web.app import create_app

__all__ = ["create_app", "is_loopback", "listening", "serve_until_stopped"]


def __getattr__(name: str) -> Any:
    """Import the server where it is asked for: the processes that compute for it need none."""
    if name != "create_app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from turnwright.web.app import create_app  # noqa: PLC0415

    return create_app
