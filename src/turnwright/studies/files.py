"""The files that a job names, on their way to machines that do not have them."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright._io import read_toml
from turnwright.errors import InputError, StudyError

if TYPE_CHECKING:
    from turnwright.studies.store import Store

__all__ = ["fetch_array", "list_files", "provide_files", "relocate_paths", "store_files"]


def list_files(data: Any) -> dict[str, str]:
    """Return the files that data names by absolute paths, and the files named in those: path to digest of content."""
    digests: dict[str, str] = {}
    for text in _texts(data):
        if os.path.isabs(text) and os.path.isfile(text):  # noqa: PTH113, PTH117 - false of a name that no system takes
            _add_file(Path(text), digests)
    return dict(sorted(digests.items()))


def _add_file(file: Path, digests: dict[str, str]) -> None:
    """Add a file and, if it is TOML, the files that it names, such as the base of a machine file."""
    if str(file) in digests:
        return
    state = file.stat()
    digests[str(file)] = _digest(file, state.st_mtime_ns, state.st_size)
    if file.suffix != ".toml":
        return
    with suppress(InputError):  # no TOML: it names no files
        for text in _texts(read_toml(file.read_bytes(), f"the file {str(file)!r}")):
            with suppress(OSError, ValueError):  # not a file name
                other = Path(os.path.normpath(file.parent / text))
                if other.is_file():
                    _add_file(other, digests)


@lru_cache(maxsize=1024)
def _digest(file: Path, _changed_ns: int, _size: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(one)


def store_files(files: Mapping[str, str], store: Store | None) -> dict[str, str]:
    """Copy files to a store, for workers on other machines; return the name of each in the store."""
    if store is None:
        return {}
    return {path: store.put_array("file", np.frombuffer(Path(path).read_bytes(), dtype=np.uint8)) for path in files}


def fetch_array(store: Store, name: str) -> np.ndarray:
    """Return an array that the driver process has written to a store.

    If a worker does not find it, the study stops: as the reason of a case it would be stored.
    """
    try:
        return store.array(name)
    except InputError:
        raise StudyError(
            f"a worker finds no array {name!r} in the store {store.place!r}: use a store that all machines can access"
        ) from None


@contextmanager
def provide_files(files: Mapping[str, str], kept: Mapping[str, str], store: Store | None) -> Iterator[dict[str, str]]:
    """Yield the local paths of the files of a job, by their paths in the job; empty if all are in place.

    If a file is missing or differs, all are copied from the store to a temporary folder with the same relative paths.
    ``files`` gives the digest of each, ``kept`` its name in the store.
    """
    missing = [path for path, digest in files.items() if not _is_stored(path, digest)]
    if not missing:
        yield {}
        return
    if store is None or any(path not in kept for path in missing):
        raise StudyError(
            f"a worker does not have {len(missing)} of the files that the job names, such as {missing[0]!r}: "
            "use a store that all machines can access"
        )
    with tempfile.TemporaryDirectory(prefix="turnwright-") as folder:
        places = {path: str(Path(folder) / path.replace(":", "").lstrip("/\\")) for path in files}
        for path, place in places.items():
            content = np.asarray(fetch_array(store, kept[path])).tobytes()
            if path.endswith(".toml"):  # it may name others by absolute path
                for other, there in places.items():
                    content = content.replace(other.encode(), there.encode())
            Path(place).parent.mkdir(parents=True, exist_ok=True)
            Path(place).write_bytes(content)
        yield places


def _is_stored(path: str, digest: str) -> bool:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest() == digest
    except OSError:
        return False


def relocate_paths(value: Any, places: Mapping[str, str]) -> Any:
    """Return data with paths replaced by their local paths."""
    if not places:
        return value
    if isinstance(value, str):
        return places.get(value, value)
    if isinstance(value, Mapping):
        return {key: relocate_paths(one, places) for key, one in value.items()}
    return [relocate_paths(one, places) for one in value] if isinstance(value, list | tuple) else value
