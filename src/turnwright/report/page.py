"""Content of a report page, and its one template.

A page has an optional verdict with key figures, then sections. The items of a section (pictures, tables, texts) stand
side by side in a grid of six columns, of which each takes its ``span``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path as File
from typing import TYPE_CHECKING, Generic, NamedTuple, ParamSpec, TypeVar

import jinja2

from turnwright import __version__
from turnwright._io import write_atomic

if TYPE_CHECKING:
    from os import PathLike

    from turnwright.job import Job

__all__ = [
    "Cell", "Code", "Drawing", "Figure", "Number", "Page", "Picture", "Section", "Table", "page_file", "write_page",
]  # fmt: skip

_P = ParamSpec("_P")
_Shown = TypeVar("_Shown")


class Number(NamedTuple):
    """A key figure at the top of a page."""

    label: str
    value: str
    unit: str
    note: str
    ok: bool = True


class Picture(NamedTuple):
    """An inline SVG with its caption."""

    svg: str
    alt: str
    title: str = ""
    span: int = 3


class Figure(Generic[_P, _Shown]):
    """A function that draws a figure, in two steps.

    ``show`` returns what the figure shows of its arguments, which may be as large as a run. ``draw`` draws that; in
    another process, it needs neither the arguments nor the kernels.
    """

    def __init__(self, show: Callable[_P, _Shown], draw: Callable[[_Shown], Picture]) -> None:
        self.show, self.draw = show, draw

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> Picture:
        """Draw the figure in this process."""
        return self.draw(self.show(*args, **kwargs))


class Drawing:
    """A picture that was ordered and may not be drawn yet.

    Parameters
    ----------
    order
        Draws it in this process.
    future
        The picture from another process.
    """

    def __init__(self, order: Callable[[], Picture], future: Future[Picture] | None = None) -> None:
        self._order, self._future = order, future

    def picture(self) -> Picture:
        """Return the picture when it is drawn, by this process if no other one could."""
        if self._future is not None:
            # A figure that cannot be drawn fails here again, for its reason.
            with suppress(Exception):
                return self._future.result()
        return self._order()


class Cell(NamedTuple):
    """A table cell that is more than a text: graded, linked or with a bar."""

    text: str = ""
    style: str = ""  # yes, no, soft or code
    address: str = ""
    share: float | None = None  # length of the bar
    bar: str = ""  # binds or over


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """A table; without columns it is a list of facts."""

    rows: Sequence[Sequence[str | Cell]]
    columns: Sequence[str] = ()
    numeric: Collection[int] = ()
    title: str = ""
    text: str = ""
    notes: Sequence[str] = ()
    numbered: bool = False
    folded: bool = False
    dense: bool = False
    span: int = 6


class Code(NamedTuple):
    """A text that keeps its lines."""

    title: str
    text: str
    span: int = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Section:
    """A section with text, notes and items; a subsection has a smaller heading."""

    title: str = ""
    source: str = ""
    text: Sequence[str] = ()
    notes: Sequence[str] = ()
    items: Sequence[Picture | Drawing | Table | Code] = ()
    is_subsection: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Page:
    """A page about a job."""

    kind: str
    job: Job
    sections: Sequence[Section]
    title: str = ""
    grade: str = ""  # of the verdict: good, warn, bad or plain
    word: str = ""
    why: Sequence[str] = ()
    numbers: Sequence[Number] = ()
    notes: Sequence[str] = ()
    is_sheet: bool = False  # one printed sheet, without the job


def page_file(path: str | PathLike[str]) -> File:
    """Return the file of a page; in an existing folder it is named ``report.html``."""
    path = File(path)
    return path / "report.html" if path.is_dir() else path


def write_page(page: Page, path: str | PathLike[str]) -> File:
    """Render a page, write it atomically, and return its file.

    In an existing folder, the file is named ``report.html``.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("turnwright.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = lambda text: re.sub(r"(?<![\w.])-(?=\d)", "\u2212", text)
    page = replace(page, sections=[replace(one, items=[*map(_drawn, one.items)]) for one in page.sections])
    text = environment.get_template("page.html.j2").render(page=page, version=__version__)
    text = re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "", text)  # control characters are invalid in HTML
    path = page_file(path)
    write_atomic(path, text)
    return path


def _drawn(item: Picture | Drawing | Table | Code) -> Picture | Table | Code:
    return item.picture() if isinstance(item, Drawing) else item
