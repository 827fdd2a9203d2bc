"""Commands for the program dialects of controllers: list and check."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import Session, app

if TYPE_CHECKING:
    from turnwright.post import Dialect

__all__: list[str] = []

posts = typer.Typer(help="List and check controller dialects.")
app.add_typer(posts, name="post")

Name = Annotated[str, typer.Argument(metavar="DIALECT", help="A listed name, or a .toml file.", show_default=False)]


@posts.command("list")
def list_all(context: typer.Context) -> None:
    """List the dialects supplied with Turnwright."""
    session: Session = context.obj
    from turnwright.post import Dialect  # noqa: PLC0415

    for name in Dialect.known():
        session.echo(_describe(Dialect.load(name)))


@posts.command()
def check(context: typer.Context, name: Name) -> None:
    """Write test programs in a dialect and read them back."""
    session: Session = context.obj
    from turnwright.post import check_dialect  # noqa: PLC0415

    done = check_dialect(name)
    session.echo(_describe(done.dialect))
    session.echo("a cut begins with:")
    for line in done.lines:
        session.echo(f"  {line}")
    units = {letter: "deg" if letter == "C" else "mm" for letter in done.differences}
    largest = ", ".join(f"{letter} {value:.2g} {units[letter]}" for letter, value in done.differences.items())
    session.echo(
        f"{done.programs} programs written and read back, largest difference: {largest}, time {done.time_ratio:.1g}"
    )
    assumed = [key for key, source in done.dialect.sources.items() if source.startswith("assumed")]
    if assumed:
        session.echo(f"assumed: {', '.join(assumed)}; compare with the manual of the controller")


def _describe(dialect: Dialect) -> str:
    """Return name, words and files of a dialect in a line."""
    words = " ".join(f"{letter}{'.' + '0' * count}" for letter, count in dialect.decimals.items())
    c = "C from 0 to 360" if dialect.wrapped else "C cumulative"
    return f"{dialect.name}: {words}, {c}, block time in {dialect.feed}, {dialect.interpolation} interpolation"
