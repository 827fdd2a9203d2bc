"""The command of the workbench."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from turnwright.cli.shared import Door, app
from turnwright.errors import InputError

__all__: list[str] = []


@app.command()
def serve(
    context: typer.Context,
    host: Annotated[str, typer.Option(help="Address to listen at; any but this computer's own needs a token.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 for any that is free.")] = 8765,
    folder: Annotated[
        Path | None, typer.Option(help="Where runs are kept.", show_default="the user's data directory")
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(envvar="TURNWRIGHT_TOKEN", help="What a browser must know, 16 characters or more."),
    ] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="https://NAME", help="Address of the page, if a proxy stands before it.")
    ] = None,
    at_a_time: Annotated[int, typer.Option(min=1, max=64, help="How many runs are carried out at a time.")] = 1,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """Open the workbench: a page to plan, see, run and correct a part."""
    door: Door = context.obj
    for name in ("fastapi", "uvicorn"):
        if find_spec(name) is None:
            raise InputError(f"the workbench needs {name}, which is not installed: pip install 'turnwright[web]'")
    from turnwright.web import is_loopback, listening, serve_until_stopped  # noqa: PLC0415 - no other command needs them

    if not is_loopback(host) and token is None:
        raise InputError(
            f"host is {host!r}, so that others reach the server, and no token is given: state --token with 16 "
            "characters or more, or listen at 127.0.0.1"
        )
    if folder is None:
        import platformdirs  # noqa: PLC0415

        folder = Path(platformdirs.user_data_dir("turnwright", appauthor=False)) / "workbench"
    with listening(host, port) as (socket, address):
        shown = f"{address}/?token={token}" if token else f"{address}/"

        def ready() -> None:
            door.say(f"the workbench is open at {shown}")
            door.say(f"runs are kept in {folder}; Ctrl-C ends it, what is under way then goes on at the next start")
            if open_page:
                import webbrowser  # noqa: PLC0415

                webbrowser.open(shown)

        serve_until_stopped(socket, folder, token=token, origin=origin, at_a_time=at_a_time, ready=ready)
