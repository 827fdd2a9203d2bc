"""Rendering of a page: template, content, atomic write."""

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

    try:
        return version("turnwright")
    except PackageNotFoundError:
        return "not installed"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Page:
    """Content that every page has."""

    title: str
    kind: str
    job: str
    version: str = field(default_factory=_version)


def page_file(path: str | PathLike[str]) -> File:
    """Return the file of a page; in an existing folder it is named ``report.html``."""
    path = File(path)
    return path / "report.html" if path.is_dir() else path


def set_page(template: str, page: Page, path: File) -> File:
    """Render a page and write it atomically."""
    import jinja2  # noqa: PLC0415 - needed only to render

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("turnwright.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = lambda text: re.sub(r"(?<![\w.])-(?=\d)", "\u2212", text)
    text = environment.get_template(template).render(page=page)
    text = re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "", text)  # control characters are invalid in HTML
    write_whole(path, text)
    return path
