"""The workbench: a page where an engineer plans, sees and corrects a part. It holds no physics of its own.

The server answers from the event loop alone; all that takes time happens in other processes: a few that are kept warm
for what a page waits for, and one for each run.
"""

from turnwright.web._app import create_app

__all__ = ["create_app"]
