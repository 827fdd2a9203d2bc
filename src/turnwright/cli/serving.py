"""Command that serves the workbench."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from turnwright.cli.shared import Session, app
from turnwright.errors import InputError

__all__: list[str] = []


@app.command()
def serve(
    context: typer.Context,
    host: Annotated[str, typer.Option(help="Address to listen on; a network address needs a token.")] = ("127.0.0.1"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 selects a free one.")] = 8765,
    folder: Annotated[
        Path | None, typer.Option(help="Folder of the runs.", show_default="the user's data directory")
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(envvar="TURNWRIGHT_TOKEN", help="Access token, at least 16 characters."),
    ] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="https://NAME", help="Public address behind a reverse proxy.")
    ] = None,
    at_a_time: Annotated[int, typer.Option(min=1, max=64, help="Number of parallel runs.")] = 1,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """Open the workbench in a browser."""
    session: Session = context.obj
    for name in ("fastapi", "uvicorn"):
        if find_spec(name) is None:
            raise InputError(f"the workbench needs {name}, which is not installed: run pip install 'turnwright[web]'")
    from turnwright.web import is_loopback, listening, serve_until_stopped  # noqa: PLC0415 - no other command needs them

    if not is_loopback(host) and token is None:
        raise InputError(
            f"--token must be given (at least 16 characters) for a host that others can reach, got host {host!r}"
        )
    if folder is None:
        import platformdirs  # noqa: PLC0415

        folder = Path(platformdirs.user_data_dir("turnwright", appauthor=False)) / "workbench"
    with listening(host, port) as (socket, address):
        shown = f"{address}/?token={token}" if token else f"{address}/"

        def ready() -> None:
            session.echo(f"the workbench is open at {shown}")
            session.echo(
                f"runs are kept in {folder}; Ctrl-C stops the server, unfinished runs resume at the next start"
            )
            if open_page:
                import webbrowser  # noqa: PLC0415

                webbrowser.open(shown)

        serve_until_stopped(socket, folder, token=token, origin=origin, at_a_time=at_a_time, ready=ready)
