"""The workbench as a program: it holds its folder, starts what plans, then the server, and ends when it is asked to."""

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
        Bound to its address.
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
    with _alone(folder), closing(planners()) as workers:
        # Costly to import: meanwhile the first of them warms up.
        from turnwright.web.app import create_app  # noqa: PLC0415
        from turnwright.web.server import answer  # noqa: PLC0415

        app = create_app(folder, token=token, origin=origin, at_a_time=at_a_time, workers=workers)
        answer(app, door, ready)
