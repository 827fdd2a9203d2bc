"""References to files in a job of the page: only files stored by this server can be named, never paths.

A reference is ``examples/NAME`` for a file of the examples, ``runs/ID/NAME`` for a file written by a run, such as the
correction of a corrected job, or ``files/ID/NAME`` for an uploaded file, which is located by its ID alone. Anything
else is refused before the job is read.
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
    "BUNDLE",
    "CORRECTION",
    "FILE_KEYS",
    "JOB",
    "MAX_DEPTH",
    "UPLOAD_REFERENCE",
    "Located",
    "display_name",
    "job_in",
    "kind_of",
    "list_files",
    "located",
    "place_of",
    "plain_name",
    "rename_files",
    "require_flat",
    "text_in",
    "unpack_references",
]

FILE_KEYS = frozenset({"file", "correction", "waviness_file", "straightness_file", "mask"})
"""Keys of a job that name a file."""

FILE_OR_NAME = frozenset({"dialect", "instrument", "material"})
"""Keys of a job that name a file if the value ends in ``.toml``."""

MAX_DEPTH = 40
"""Largest nesting depth of tables and lists."""

MAX_VALUES = 500_000

JOB = "job.toml"
"""File name of a job as text."""

CORRECTION = "correction"
"""Folder in that of a run with the corrected job and its files."""

BUNDLE = "job.zip"
"""Archive of a job with its files, if it names any."""

RUN_REFERENCE = re.compile(r"runs/([0-9a-f]{16})/([A-Za-z0-9_-]{1,60}\.[A-Za-z0-9]{1,8})")
UPLOAD_REFERENCE = re.compile(r"files/([0-9a-f]{32})/([A-Za-z0-9_-]{1,60}(\.[a-z0-9]{1,8}))")


class Located(NamedTuple):
    """A job with paths in place of references, the faults of its references, and the path of each valid one."""

    data: dict[str, Any]
    problems: list[dict[str, str]]
    references: dict[str, str]


def kind_of(field: str, key: str) -> str:
    """Return the kind of file that a field of a job names, see `turnwright.web.limits.FILE_ENDINGS`.

    >>> kind_of("machine.file", "file"), kind_of("part.surface.file", "file"), kind_of("part.material", "material")
    ('machine', 'heights', 'material')
    >>> kind_of("measurement.instrument.file", "file"), kind_of("measurement.instrument", "instrument")
    ('instrument', 'instrument')
    """
    if key in ("file", "mask"):
        return {"machine.file": "machine", "measurement.instrument.file": "instrument"}.get(field, "heights")
    return key.removesuffix("_file")


def display_name(name: str) -> str:
    r"""Return the name of a file without folders and special characters.

    >>> display_name("C:\\maps\\my <part>.x3p")
    'my _part_.x3p'
    """
    return re.sub(r"[^\w .()+-]", "_", Path(name.replace("\\", "/")).name)


def plain_name(name: str) -> str:
    """Return a portable file name without extension."""
    text = re.sub("[^A-Za-z0-9_-]+", "_", Path(display_name(name)).stem)[:60].strip("_-")
    # Windows reserves these names for devices.
    return f"{text or 'file'}_" if re.fullmatch("(?i)con|prn|aux|nul|com.|lpt.", text) else text or "file"


def place_of(folder: Path, name: str, kind: str, ending: str) -> Path:
    """Return the path of an uploaded file."""
    return folder / "files" / f"{name}-{kind}{ending}"


def located(data: dict[str, Any], folder: Path) -> Located:
    """Replace the references of a job by paths in the folder of the server, and report invalid ones."""
    result = Located({}, [], {})

    def replaced(value: object, field: str, key: str) -> object:
        if isinstance(value, str) and "\0" in value:
            result.problems.append({"field": field, "sentence": "must not contain the null character"})
            return ""
        return _path(value, field, key, folder, result) if _names_file(key, value) else value

    try:
        require_flat(data)
    except InputError as error:
        return Located({}, [{"field": "", "sentence": str(error)}], {})
    return result._replace(data=_rebuilt(data, replaced))


def _rebuilt(value: Any, replaced: Callable[[object, str, str], object], field: str = "", key: str = "") -> Any:
    """Replace each value of a job by ``replaced(value, field, key)``."""
    if isinstance(value, dict):
        return {
            name: _rebuilt(one, replaced, f"{field}.{name}" if field else str(name), str(name))
            for name, one in value.items()
        }
    if isinstance(value, list):
        return [_rebuilt(one, replaced, f"{field}[{place}]", key) for place, one in enumerate(value, 1)]
    return replaced(value, field, key)


def require_flat(data: dict[str, Any]) -> None:
    """Raise if a job has too many values, or is nested too deeply to be walked; a dotted key can create any depth."""
    level: list[Any] = [data]
    count = 0
    for _ in range(MAX_DEPTH + 1):
        count += len(level)
        tables = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)]
        level = [inner for one in tables for inner in one]
    if level:
        raise InputError(f"the nesting depth of a job must be at most {MAX_DEPTH}")
    if count > MAX_VALUES:
        raise InputError(f"a job must have at most {MAX_VALUES} values")


def _names_file(key: str, value: object) -> bool:
    return key in FILE_KEYS or (key in FILE_OR_NAME and isinstance(value, str) and value.endswith(".toml"))


def _path(value: object, field: str, key: str, folder: Path, located: Located) -> object:
    """Return the path of a reference, or record a fault."""
    if value is None:
        return None
    file = _file(value, kind_of(field, key), folder) if isinstance(value, str) else None
    if file is not None:
        located.references[str(value)] = str(file)
        return str(file)
    text = repr(value)
    text = text if len(text) <= 60 else f"{text[:57]}..."
    located.problems.append(
        {
            "field": field,
            "sentence": f"{key} must be an uploaded file, or a file of an example or a run, got {text}: upload it, "
            "or use the command line",
        }
    )
    return None


def _file(reference: str, kind: str, folder: Path) -> Path | None:
    if reference in example_files():
        return example_files()[reference]
    file = None
    if match := RUN_REFERENCE.fullmatch(reference):
        file = folder / "runs" / match.group(1) / CORRECTION / match.group(2)
    elif (match := UPLOAD_REFERENCE.fullmatch(reference)) and match.group(3) in FILE_ENDINGS.get(kind, ()):
        file = place_of(folder, match.group(1), kind, match.group(3))
    return file if file is not None and file.is_file() and not file.is_symlink() else None


def unpack_references(data: dict[str, Any], folder: Path) -> tuple[dict[str, Any], dict[str, Path]]:
    """Replace the references of a job by plain file names; return it with the files by name."""
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
    return rename_files(data, lambda _, value: names.get(value, value)), files


def text_in(run: Path) -> str:
    """Return the job of a run as text, with its line endings; empty if there is none."""
    with suppress(OSError, UnicodeDecodeError):
        return (run / JOB).read_bytes().decode("utf-8")
    return ""


def job_in(run: Path, folder: Path) -> dict[str, Any]:
    """Return the job in the folder of a run, with references; for a correction, the corrected job."""
    data: dict[str, Any] = json.loads((run / "job.json").read_text(encoding="utf-8"))
    corrected = run / CORRECTION / JOB
    if not corrected.is_file():
        return data
    # Files of the correction are next to the corrected job; all others are unchanged.
    references = {str(path): name for name, path in example_files().items()}
    references |= {path: name for name, path in located(data, folder).references.items()}

    def reference(_: str, value: str) -> str:
        own_reference = f"runs/{run.name}/{value}"
        return references.get(value) or (own_reference if RUN_REFERENCE.fullmatch(own_reference) else value)

    return rename_files(tomllib.loads(corrected.read_text(encoding="utf-8")), reference)


class Named(NamedTuple):
    """A file that a job names: path of the field, kind as of `kind_of`, and value."""

    field: str
    kind: str
    name: str


def list_files(data: dict[str, Any]) -> list[Named]:
    """Return the files that a job names."""
    names: list[Named] = []

    def listed(value: object, field: str, key: str) -> None:
        if isinstance(value, str) and _names_file(key, value):
            names.append(Named(field, kind_of(field, key), value))

    _rebuilt(data, listed)
    return names


def rename_files(data: dict[str, Any], name: Callable[[str, str], str]) -> dict[str, Any]:
    """Replace each file name in a job by ``name(kind, file_name)``."""

    def replaced(value: object, field: str, key: str) -> object:
        return name(kind_of(field, key), value) if isinstance(value, str) and _names_file(key, value) else value

    return _rebuilt(data, replaced)  # type: ignore[no-any-return]
