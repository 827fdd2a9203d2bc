"""The uvicorn server in this process, with request time limits and a ready callback."""

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

SHUTDOWN_S = 3
"""Time for open requests at shutdown. [s]"""


HEAD_S = 20.0
"""Time limit for receiving the head of a request. [s]"""

BODY_S = 60.0
"""Time limit for receiving the body of a request, extended by the received bytes over `MIN_RATE`. [s]"""

MIN_RATE = 20_000
"""Smallest accepted data rate. [byte/s]"""


class TimedProtocol(H11Protocol):
    """HTTP/1.1 protocol that closes a connection whose request does not arrive in time."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._timer: asyncio.TimerHandle | None = None
        self._since, self._received = 0.0, 0
        self._state: Any = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer of the first request."""
        super().connection_made(transport)
        self._watch(0)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Extend the deadline of a body by the received bytes."""
        super().data_received(data)
        self._watch(len(data))

    def _watch(self, size: int) -> None:
        """Set the deadline of the current part of a request."""
        state, now = self.conn.their_state, self.loop.time()
        if state is not self._state or self._timer is None:
            self._since, self._received, self._state = now, 0, state
        self._received += size
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        allowed = {h11.IDLE: HEAD_S, h11.SEND_BODY: BODY_S + self._received / MIN_RATE}.get(state)
        if allowed is not None and not self.transport.is_closing():
            self._timer = self.loop.call_at(self._since + allowed, self._expire, state)

    def _expire(self, state: Any) -> None:
        """Close the connection if it is still in the same state."""
        self._timer = None
        if self.conn.their_state is state and not self.transport.is_closing():
            self.transport.abort()


class _Server(uvicorn.Server):
    """Server that calls back when it is ready and when it shuts down."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None], parting: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready, self._parting = ready, parting

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Shut down on SIGINT and SIGTERM without raising them again."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = [signal.signal(number, self.handle_exit) for number in numbers]
        try:
            yield
        finally:
            for number, handler in zip(numbers, before, strict=True):
                signal.signal(number, handler)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """End the event streams first, or shutdown would wait for them."""
        self._parting()
        super().handle_exit(sig, frame)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then call ``ready``."""
        await super().startup(sockets)
        if self.started:
            self._ready()


def answer(app: FastAPI, listener: socket.socket, ready: Callable[[], None]) -> None:
    """Serve until SIGINT or SIGTERM; ``ready`` is called when the server accepts connections."""
    config = uvicorn.Config(
        app, http=TimedProtocol, log_level="critical", access_log=False, server_header=False, lifespan="on", ws="none",
        timeout_graceful_shutdown=SHUTDOWN_S, h11_max_incomplete_event_size=64 * 2**10, proxy_headers=False,
    )  # fmt: skip
    asyncio.run(_Server(config, ready, app.state.runs.end_streams).serve(sockets=[listener]))
