"""Files in a job that came from a page: only those that this server itself keeps, by a reference and never by a path.

A reference is ``examples/NAME`` for a file that comes with the examples, ``runs/ID/NAME`` for one that a run has left,
such as the correction that belongs to a corrected job, or ``files/ID/NAME`` for one that was brought, of which the id
alone says where it lies. Everything else is refused before the job is read.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from turnwright.errors import InputError
from turnwright.web.examples import example_files
from turnwright.web.limits import FILE_ENDINGS

__all__ = [
    "BROUGHT",
    "BUNDLE",
    "CORRECTION",
    "DEEPEST",
    "FILE_KEYS",
    "JOB",
    "Located",
    "beside",
    "job_in",
    "kind_of",
    "located",
    "named",
    "place_of",
    "plain_name",
    "renamed",
    "require_flat",
    "shown_name",
    "text_in",
]

FILE_KEYS = frozenset({"file", "correction", "waviness_file", "straightness_file", "mask"})
"""Keys of a job that name a file."""

FILE_OR_NAME = frozenset({"material", "instrument"})
"""Keys of a job that name a file if they end in ``.toml``."""

DEEPEST = 40
"""Tables and lists within each other."""

TOO_DEEP = f"the job has tables within each other to a depth of more than {DEEPEST}: make it flat"

MOST_VALUES = 500_000

JOB = "job.toml"
"""A job as text, wherever it is kept."""

CORRECTION = "correction"
"""Folder in that of a run for a corrected job and the files that it names."""

BUNDLE = "job.zip"
"""What a run leaves whose job names files: the job with them beside it."""

KEPT = re.compile(r"runs/([0-9a-f]{16})/([A-Za-z0-9_-]{1,60}\.[A-Za-z0-9]{1,8})")
BROUGHT = re.compile(r"files/([0-9a-f]{32})/([A-Za-z0-9_-]{1,60}(\.[a-z0-9]{1,8}))")


class _Refused(Exception):  # noqa: N818
    pass


class Located(NamedTuple):
    """A job with paths in it.

    Parameters
    ----------
    data
        The job.
    problems
        What is wrong with its references.
    references
        Those that lead to a file, with its path. A file may have several: as often as it was brought by other names.
    """

    data: dict[str, Any]
    problems: list[dict[str, str]]
    references: dict[str, str]


def kind_of(field: str, key: str) -> str:
    """Return which kind of file a field of a job names, see `turnwright.web.limits.FILE_ENDINGS`.

    >>> kind_of("machine.file", "file"), kind_of("part.surface.file", "file"), kind_of("part.material", "material")
    ('machine', 'heights', 'material')
    >>> kind_of("measurement.instrument.file", "file"), kind_of("measurement.instrument", "instrument")
    ('instrument', 'instrument')
    """
    if key in ("file", "mask"):
        return {"machine.file": "machine", "measurement.instrument.file": "instrument"}.get(field, "heights")
    return key.removesuffix("_file")


def shown_name(name: str) -> str:
    r"""Return what a file is called, without folders and marks.

    >>> shown_name("C:\\maps\\my <part>.x3p")
    'my _part_.x3p'
    """
    return re.sub(r"[^\w .()+-]", "_", Path(name.replace("\\", "/")).name)


def plain_name(name: str) -> str:
    """Return a name that any computer takes as that of a file, without its ending."""
    text = re.sub("[^A-Za-z0-9_-]+", "_", Path(shown_name(name)).stem)[:60].strip("_-")
    # Windows takes a few short names for devices.
    return f"{text or 'file'}_" if re.fullmatch("(?i)con|prn|aux|nul|com.|lpt.", text) else text or "file"


def place_of(folder: Path, name: str, kind: str, ending: str) -> Path:
    """Return where a file that was brought lies."""
    return folder / "files" / f"{name}-{kind}{ending}"


def located(data: dict[str, Any], folder: Path) -> Located:
    """Return a job with its references as paths, and what is wrong with them.

    Parameters
    ----------
    data
        The job as a page sent it.
    folder
        Of the server.
    """
    found = Located({}, [], {})
    count = 0

    def walked(value: object, field: str, key: str, depth: int) -> Any:
        nonlocal count
        count += 1
        if depth > DEEPEST or count > MOST_VALUES:
            raise _Refused(
                TOO_DEEP
                if depth > DEEPEST
                else f"the job has more than {MOST_VALUES} values, the limit: make it shorter"
            )
        if isinstance(value, dict):
            return {
                name: walked(one, f"{field}.{name}" if field else str(name), str(name), depth + 1)
                for name, one in value.items()
            }
        if isinstance(value, list):
            return [walked(one, f"{field}[{place}]", key, depth + 1) for place, one in enumerate(value, 1)]
        if isinstance(value, str) and "\0" in value:
            found.problems.append({"field": field, "sentence": "holds a character that no text has: remove it"})
            return ""
        if _names_file(key, value):
            return _path(value, field, key, folder, found)
        return value

    try:
        return found._replace(data=walked(data, "", "", 0))
    except _Refused as error:
        return Located({}, [{"field": "", "sentence": str(error)}], {})


def require_flat(data: dict[str, Any]) -> None:
    """Raise unless a job that was read can be walked: one key of many words makes tables as deep as it is long.

    Raises
    ------
    InputError
        If tables or lists within each other are too deep.
    """
    level: list[Any] = [data]
    for _ in range(DEEPEST + 1):
        tables = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)]
        level = [inner for one in tables for inner in one]
    if level:
        raise InputError(TOO_DEEP)


def _names_file(key: str, value: object) -> bool:
    return key in FILE_KEYS or (key in FILE_OR_NAME and isinstance(value, str) and value.endswith(".toml"))


def _path(value: object, field: str, key: str, folder: Path, found: Located) -> object:
    """Return the file that a reference stands for, or note that it stands for none."""
    if value is None:
        return None
    file = _file(value, kind_of(field, key), folder) if isinstance(value, str) else None
    if file is not None:
        found.references[str(value)] = str(file)
        return str(file)
    text = repr(value)
    text = text if len(text) <= 60 else f"{text[:57]}..."
    found.problems.append(
        {
            "field": field,
            "sentence": f"{key} is {text}, a job from a page can only name files that were brought to this field, come "
            "with an example or were left by a run here: bring the file, or run the job by the command line",
        }
    )
    return None


def _file(reference: str, kind: str, folder: Path) -> Path | None:
    if reference in example_files():
        return example_files()[reference]
    file = None
    if match := KEPT.fullmatch(reference):
        file = folder / "runs" / match.group(1) / CORRECTION / match.group(2)
    elif (match := BROUGHT.fullmatch(reference)) and match.group(3) in FILE_ENDINGS.get(kind, ()):
        file = place_of(folder, match.group(1), kind, match.group(3))
    return file if file is not None and file.is_file() and not file.is_symlink() else None


def beside(data: dict[str, Any], folder: Path) -> tuple[dict[str, Any], dict[str, Path]]:
    """Return a job with its references as names of files beside it, and those files by name.

    Parameters
    ----------
    data
        The job as a page sent it.
    folder
        Of the server.
    """
    references = {reference: Path(path) for reference, path in located(data, folder).references.items()}
    files: dict[str, Path] = {}
    names: dict[str, str] = {}
    for reference, path in references.items():
        name = reference.rpartition("/")[2]
        number = 1
        while name.casefold() in {JOB, *(one.casefold() for one in files)}:
            number += 1
            name = f"{Path(reference).stem}-{number}{path.suffix}"
        files[name], names[reference] = path, name
    return renamed(data, lambda _, value: names.get(value, value)), files


def text_in(run: Path) -> str:
    """Return the job of a run as somebody wrote it, ends of lines and all; empty if nobody did."""
    with suppress(OSError, UnicodeDecodeError):
        return (run / JOB).read_bytes().decode("utf-8")
    return ""


def job_in(run: Path, folder: Path) -> dict[str, Any]:
    """Return the job that a run carries out, with references: that of a correction is the corrected one.

    Parameters
    ----------
    run
        Its folder.
    folder
        Of the server.
    """
    data: dict[str, Any] = json.loads((run / "job.json").read_text(encoding="utf-8"))
    corrected = run / CORRECTION / JOB
    if not corrected.is_file():
        return data
    # Beside the corrected job stands what the correction has made; the rest is where it was before.
    known = {str(path): name for name, path in example_files().items()}
    known |= {path: name for name, path in located(data, folder).references.items()}

    def reference(_: str, value: str) -> str:
        mine = f"runs/{run.name}/{value}"
        return known.get(value) or (mine if KEPT.fullmatch(mine) else value)

    return renamed(tomllib.loads(corrected.read_text(encoding="utf-8")), reference)


class Named(NamedTuple):
    """A file that a job names.

    Parameters
    ----------
    field
        Where.
    kind
        See `kind_of`.
    name
        As it stands there.
    """

    field: str
    kind: str
    name: str


def named(data: dict[str, Any]) -> list[Named]:
    """Return the files that a job names."""
    found: list[Named] = []

    def walked(value: object, field: str, key: str) -> None:
        if isinstance(value, dict):
            for name, one in value.items():
                walked(one, f"{field}.{name}" if field else name, name)
        elif isinstance(value, list):
            for place, one in enumerate(value, 1):
                walked(one, f"{field}[{place}]", key)
        elif isinstance(value, str) and _names_file(key, value):
            found.append(Named(field, kind_of(field, key), value))

    walked(data, "", "")
    return found


def renamed(data: dict[str, Any], name: Callable[[str, str], str]) -> dict[str, Any]:
    """Return a job with each name of a file as a function of its kind and its name says."""

    def walked(value: object, field: str, key: str) -> Any:
        if isinstance(value, dict):
            return {one: walked(inner, f"{field}.{one}" if field else one, one) for one, inner in value.items()}
        if isinstance(value, list):
            return [walked(one, field, key) for one in value]
        return name(kind_of(field, key), value) if isinstance(value, str) and _names_file(key, value) else value

    return walked(data, "", "")  # type: ignore[no-any-return]
