"""The workbench as a program: lock its folder, start the workers, serve until stopped."""

from __future__ import annotations

from contextlib import closing, contextmanager, suppress
from typing import TYPE_CHECKING

from turnwright.errors import InputError
from turnwright.web.workers import planners

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterator
    from pathlib import Path

__all__ = ["serve_until_stopped"]


@contextmanager
def _lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder for one server; a second one would remove the first one's unfinished runs."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "server.lock").open("a") as lock:
        with suppress(ImportError):
            import fcntl  # noqa: PLC0415 - there is none on Windows

            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"another server uses {str(folder)!r}: open its page, or choose another --folder"
                ) from None
        yield


def serve_until_stopped(
    listener: socket.socket,
    folder: Path,
    *,
    token: str | None,
    origin: str | None,
    at_a_time: int,
    ready: Callable[[], None],
) -> None:
    """Serve the workbench until SIGINT (Ctrl-C) or SIGTERM; ``ready`` is called when it accepts connections.

    Raises
    ------
    InputError
        If another server uses the folder, or the token is too short.
    """
    with _lock_folder(folder), closing(planners()) as workers:
        # Slow import, while the first worker warms up.
        from turnwright.web.app import create_app  # noqa: PLC0415
        from turnwright.web.server import answer  # noqa: PLC0415

        app = create_app(folder, token=token, origin=origin, at_a_time=at_a_time, workers=workers)
        answer(app, listener, ready)
