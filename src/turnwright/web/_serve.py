"""The server as a program: it listens, says where, and ends when it is asked to."""

from __future__ import annotations

import asyncio
import ipaddress
import signal
import socket
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import uvicorn

from turnwright.errors import InputError
from turnwright.web._app import create_app
from turnwright.web._guard import is_loopback

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

__all__ = ["is_loopback", "listening", "serve_until_stopped"]

FAREWELL_S = 3
"""For answers that are under way at the end."""


class _Server(uvicorn.Server):
    """Says when it is ready."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

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

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer."""
        await super().startup(sockets)
        if self.started:
            self._ready()


@contextmanager
def listening(host: str, port: int) -> Iterator[tuple[socket.socket, str]]:
    """Yield a socket that listens, and the address of the page.

    Parameters
    ----------
    host
        A number or a name of this computer.
    port
        0 for any that is free.

    Raises
    ------
    InputError
        If nothing can be heard there.
    """
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        door = socket.socket(family, kind, protocol)
    except OSError as error:
        raise _deaf(host, port, error) from error
    with door:
        try:
            door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            door.bind(place)
        except OSError as error:
            raise _deaf(host, port, error) from error
        number = door.getsockname()[1]
        name = host
        try:
            address = ipaddress.ip_address(host)
        except ValueError:
            pass
        else:
            if address.is_unspecified:
                name = socket.gethostname()
            elif address.version == 6:
                name = f"[{host}]"
        yield door, f"http://{name}:{number}"


def _deaf(host: str, port: int, error: OSError) -> InputError:
    return InputError(
        f"no server can listen at {host}:{port} ({error.strerror}): name another --port, or 0 for any that is free"
    )


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold a folder for one server: two would throw away each other's half-made runs."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "server.lock").open("a") as lock:
        with suppress(ImportError):
            import fcntl  # noqa: PLC0415 - there is none on Windows

            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"another server keeps its runs in {str(folder)!r}: open its page, or name another --folder"
                ) from None
        yield


def serve_until_stopped(
    door: socket.socket,
    folder: Path,
    *,
    token: str | None,
    origin: str | None,
    at_a_time: int,
    ready: Callable[[], None],
) -> None:
    """Serve the workbench until Ctrl-C or a polite kill.

    Parameters
    ----------
    door
        Listens already.
    folder
        Where runs are kept.
    token, origin, at_a_time
        See `turnwright.web.create_app`.
    ready
        Called once a browser may come.

    Raises
    ------
    InputError
        If another server has the folder, or the token is too short.
    """
    with _alone(folder):
        app = create_app(folder, token=token, origin=origin, at_a_time=at_a_time)
        config = uvicorn.Config(
            app, log_level="critical", access_log=False, server_header=False, lifespan="on", ws="none",
            timeout_graceful_shutdown=FAREWELL_S, h11_max_incomplete_event_size=64 * 2**10, proxy_headers=False,
        )  # fmt: skip
        server = _Server(config, ready)
        asyncio.run(server.serve(sockets=[door]))
