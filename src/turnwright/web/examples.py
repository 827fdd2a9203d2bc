"""Example jobs: inside the installed package, or at the root of a checkout."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from turnwright.web.data_folders import shipped_folder

__all__ = ["Example", "example_files", "examples"]

MACHINES = "machines"
"""Folder of machine files, which are not jobs."""


class Example:
    """An example job.

    Parameters
    ----------
    name
        Name in the API.
    file
        Path of the job file.
    """

    def __init__(self, name: str, file: Path) -> None:
        self.name, self.file = name, file

    @property
    def toml(self) -> str:
        """Text of the job, with file names replaced by references, see `turnwright.web.references`."""
        text = self.file.read_text(encoding="utf-8")
        for reference, path in example_files().items():
            if path.is_relative_to(self.file.parent):
                text = text.replace(f'"{path.relative_to(self.file.parent).as_posix()}"', f'"{reference}"')
        return text

    @property
    def data(self) -> dict[str, Any]:
        """The job as data."""
        return tomllib.loads(self.toml)

    @property
    def title(self) -> str:
        """Name of the part."""
        return str(self.data["part"].get("name") or self.name.replace("_", " "))

    @property
    def summary(self) -> str:
        """First comment of the file."""
        lines = []
        for line in self.file.read_text(encoding="utf-8").splitlines():
            if not line.startswith("#") or line.strip() == "#":
                break
            lines.append(line.lstrip("# ").rstrip())
        return " ".join(lines)


def _root() -> Path | None:
    return shipped_folder("examples", "examples")


@cache
def examples() -> dict[str, Example]:
    """Return the examples by name."""
    root = _root()
    if root is None:
        return {}
    files = sorted(file for file in root.rglob("*.toml") if file.parent.name != MACHINES)
    named = {"_".join(file.relative_to(root).with_suffix("").parts): file for file in files}
    return {name: Example(name, file) for name, file in named.items()}


@cache
def example_files() -> dict[str, Path]:
    """Return the files of the examples, by reference."""
    root = _root()
    if root is None:
        return {}
    return {f"examples/{file.relative_to(root).as_posix()}": file for file in sorted(root.rglob("*")) if file.is_file()}
