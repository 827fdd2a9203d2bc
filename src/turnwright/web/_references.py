"""Files in a job that came from a page: only those that this server itself keeps, by a reference and never by a path.

A reference is ``examples/NAME`` for a file that comes with the examples, or ``runs/ID/NAME`` for one that a run has
left, such as the correction that belongs to a corrected job. Everything else is refused before the job is read.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from turnwright.web._examples import example_files

__all__ = ["CORRECTION", "DEEPEST", "FILE_KEYS", "located", "referred"]

FILE_KEYS = frozenset({"file", "correction", "waviness_file", "straightness_file"})
"""Keys of a job that name a file."""

DEEPEST = 40
"""Tables and lists within each other."""

MOST_VALUES = 500_000

CORRECTION = "correction"
"""Folder in that of a run for a corrected job and the files that it names."""

KEPT = re.compile(r"runs/([0-9a-f]{16})/([A-Za-z0-9_-]{1,60}\.[A-Za-z0-9]{1,8})")


class _Refused(Exception):  # noqa: N818
    pass


def located(data: dict[str, Any], folder: Path) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Return a job with its references as paths, and what is wrong with them.

    Parameters
    ----------
    data
        The job as a page sent it.
    folder
        Of the server.
    """
    problems: list[dict[str, str]] = []
    count = 0

    def walked(value: object, field: str, key: str, depth: int) -> Any:
        nonlocal count
        count += 1
        if depth > DEEPEST or count > MOST_VALUES:
            raise _Refused(
                f"the job has tables within each other to a depth of more than {DEEPEST}: make it flat"
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
            problems.append({"field": field, "sentence": "holds a character that no text has: remove it"})
            return ""
        if key in FILE_KEYS or (key == "material" and isinstance(value, str) and value.endswith(".toml")):
            return _path(value, field, key, folder, problems)
        return value

    try:
        return walked(data, "", "", 0), problems
    except _Refused as error:
        return {}, [{"field": "", "sentence": str(error)}]


def _path(value: object, field: str, key: str, folder: Path, problems: list[dict[str, str]]) -> object:
    """Return the file that a reference stands for, or note that it stands for none."""
    if value is None:
        return None
    if isinstance(value, str):
        if value in example_files():
            return str(example_files()[value])
        match = KEPT.fullmatch(value)
        if match:
            file = folder / "runs" / match.group(1) / CORRECTION / match.group(2)
            if file.is_file() and not file.is_symlink():
                return str(file)
    text = repr(value)
    text = text if len(text) <= 60 else f"{text[:57]}..."
    problems.append(
        {
            "field": field,
            "sentence": f"{key} is {text}, a job from a page can only name files "
            "that come with an example or that a run here has left: leave it out, or run the job by the command line",
        }
    )
    return None


def referred(data: dict[str, Any], run: str) -> dict[str, Any]:
    """Return the job that a correction wrote, with the files beside it as references.

    Parameters
    ----------
    data
        As its file reads.
    run
        The id of the run that corrected.
    """
    known = {str(path): name for name, path in example_files().items()}

    def walked(value: object, key: str) -> Any:
        if isinstance(value, dict):
            return {name: walked(one, name) for name, one in value.items()}
        if isinstance(value, list):
            return [walked(one, key) for one in value]
        if isinstance(value, str) and key in FILE_KEYS:
            return known.get(value) or (f"runs/{run}/{value}" if KEPT.fullmatch(f"runs/{run}/{value}") else value)
        return value

    return walked(data, "")  # type: ignore[no-any-return]
