"""The server as a part of this process: it says when it is ready, and ends at a signal as a server ends."""

from __future__ import annotations

import asyncio
import signal
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterator
    from types import FrameType

    from fastapi import FastAPI

__all__ = ["TimedProtocol", "answer"]

FAREWELL_S = 3
"""For answers that are under way at the end."""


HEAD_S = 20.0
"""From the connection, or from the first byte on one that is kept, until the head of a request is whole."""

BODY_S = 60.0
"""From the head of a request until its body is whole, and longer by what has arrived at the least rate."""

LEAST_RATE = 20_000
"""Slower than any line to a workshop. [byte/s]"""


class TimedProtocol(H11Protocol):
    """Closes a connection whose request does not arrive in time."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._timer: asyncio.TimerHandle | None = None
        self._since, self._received = 0.0, 0
        self._state: Any = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first head."""
        super().connection_made(transport)
        self._watch(0)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Give a body more time by what it brings."""
        super().data_received(data)
        self._watch(len(data))

    def _watch(self, size: int) -> None:
        """Set the deadline of what is arriving now."""
        state, now = self.conn.their_state, self.loop.time()
        if state is not self._state or self._timer is None:
            self._since, self._received, self._state = now, 0, state
        self._received += size
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        allowed = {h11.IDLE: HEAD_S, h11.SEND_BODY: BODY_S + self._received / LEAST_RATE}.get(state)
        if allowed is not None and not self.transport.is_closing():
            self._timer = self.loop.call_at(self._since + allowed, self._expire, state)

    def _expire(self, state: Any) -> None:
        """Close the connection unless what was waited for has arrived."""
        self._timer = None
        if self.conn.their_state is state and not self.transport.is_closing():
            self.transport.abort()


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
        app, http=TimedProtocol, log_level="critical", access_log=False, server_header=False, lifespan="on", ws="none",
        timeout_graceful_shutdown=FAREWELL_S, h11_max_incomplete_event_size=64 * 2**10, proxy_headers=False,
    )  # fmt: skip
    asyncio.run(_Server(config, ready, app.state.runs.hush).serve(sockets=[door]))
