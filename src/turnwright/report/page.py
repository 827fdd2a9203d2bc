"""Setting a page: from what it says to a file that appears when it is whole."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path as File
from typing import TYPE_CHECKING

from turnwright._io import write_whole

if TYPE_CHECKING:
    from os import PathLike

__all__ = ["Page", "page_file", "set_page"]


def _version() -> str:
    """Return which version sets the page."""
    try:
        return version("turnwright")
    except PackageNotFoundError:
        return "not installed"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Page:
    """What every page says beside what is its own, ready to be set."""

    title: str
    kind: str
    job: str
    version: str = field(default_factory=_version)


def page_file(path: str | PathLike[str]) -> File:
    """Return the file of a page: in a folder that exists it is called ``report.html``."""
    path = File(path)
    return path / "report.html" if path.is_dir() else path


def set_page(template: str, page: Page, path: File) -> File:
    """Set a page; it appears under its name only when it is whole."""
    import jinja2  # noqa: PLC0415 - only a page needs it

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("turnwright.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = lambda text: re.sub(r"(?<![\w.])-(?=\d)", "\u2212", text)
    text = environment.get_template(template).render(page=page)
    text = re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "", text)  # no page may hold them, whatever a name does
    write_whole(path, text)
    return path
