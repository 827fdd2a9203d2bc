"""The server as a part of this process: it says when it is ready, and ends at a signal as a server ends."""

from __future__ import annotations

import asyncio
import signal
from contextlib import contextmanager
from typing import TYPE_CHECKING

import uvicorn

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterator
    from types import FrameType

    from fastapi import FastAPI

__all__ = ["answer"]

FAREWELL_S = 3
"""For answers that are under way at the end."""


class _Server(uvicorn.Server):
    """Says when it is ready, and when it is about to end."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None], parting: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready, self._parting = ready, parting

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """End at a wish to stop as a server ends, which is no error."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = [signal.signal(number, self.handle_exit) for number in numbers]
        try:
            yield
        finally:
            for number, handler in zip(numbers, before, strict=True):
                signal.signal(number, handler)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Let go of the pages that listen, or the end would wait for them."""
        self._parting()
        super().handle_exit(sig, frame)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer."""
        await super().startup(sockets)
        if self.started:
            self._ready()


def answer(app: FastAPI, door: socket.socket, ready: Callable[[], None]) -> None:
    """Answer whoever comes, until a signal.

    Parameters
    ----------
    app
        Knows the answers.
    door
        Bound to its address.
    ready
        Called once a browser may come.
    """
    config = uvicorn.Config(
        app, log_level="critical", access_log=False, server_header=False, lifespan="on", ws="none",
        timeout_graceful_shutdown=FAREWELL_S, h11_max_incomplete_event_size=64 * 2**10, proxy_headers=False,
    )  # fmt: skip
    asyncio.run(_Server(config, ready, app.state.runs.hush).serve(sockets=[door]))
