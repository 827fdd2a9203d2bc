"""Store of finished cases and large arrays: a folder, or any URL that fsspec supports.

A store is a path, not an open handle, and is sent to workers as text. Every file appears complete under its final name
or not at all, so that a reader never meets a part of a file, and a writer that is killed leaves no valid file behind.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import re
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self
from uuid import uuid4

import numpy as np

from turnwright import _validate as validate
from turnwright.errors import InputError, StudyError

__all__ = ["Store"]

DISK_FULL = frozenset(getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG") if hasattr(errno, name))
"""Error numbers of a full disk."""

Row = dict[str, Any]
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Store:
    """Rows of finished cases and the large arrays that cases share.

    Parameters
    ----------
    place
        The folder, absolute, or a URL of fsspec ("s3://bucket/study"), without a slash at its end.
    """

    place: str

    def __post_init__(self) -> None:
        validate.check_numbers(self)
        object.__setattr__(self, "place", validate.path(self.place, "the store"))

    @classmethod
    def open(cls, place: str | os.PathLike[str]) -> Self:
        """Open a store, and check that it can be written.

        Parameters
        ----------
        place
            A folder, created if missing, or a URL with "://" that fsspec supports.

        Raises
        ------
        InputError
            If fsspec, or its back end for this kind of URL, is not installed.
        StudyError
            If the folder cannot be created.
        """
        text = validate.path(place, "the store")
        store = cls(place=text.rstrip("/") if "://" in text else str(Path(text).expanduser().absolute()))
        if not store._remote:
            try:
                for part in ("rows", "arrays"):
                    (Path(store.place) / part).mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise store._storage_error(error) from error
        else:
            store._files()
        return store

    @property
    def _remote(self) -> bool:
        return "://" in self.place

    def row(self, key: str) -> Row | None:
        """Return the row of a finished case; ``None`` if there is none, or if its file is corrupt."""
        file = f"{_check_name(key)}.json"
        try:
            row = json.loads(self._read("rows", file))
        except (FileNotFoundError, ValueError):
            return None
        except OSError as error:
            raise self._storage_error(error, "read") from error
        return row if isinstance(row, dict) else None

    def put_row(self, key: str, row: Row) -> None:
        """Write the row of a finished case, completely or not at all.

        Parameters
        ----------
        key
            Key of the case.
        row
            Numbers, texts or None by name. Infinite numbers are written as Python's JSON writes them.

        Raises
        ------
        StudyError
            If the store is full or cannot be written; its content is kept.
        """
        try:
            text = json.dumps(row).encode()
        except (TypeError, ValueError) as error:
            raise InputError(f"a row must be plain data ({error}): use numbers, texts and None") from None
        self._write("rows", f"{_check_name(key)}.json", lambda stream: stream.write(text))

    def keys(self) -> set[str]:
        """Return the keys of all finished cases."""
        return {name.removesuffix(".json") for name in self._names("rows") if name.endswith(".json")}

    def put_array(self, name: str, array: np.ndarray) -> str:
        """Write an array, unless the store already has it.

        Parameters
        ----------
        name
            A word for people.
        array
            Any shape and type.

        Returns
        -------
        str
            Name for `array`: ``name`` and a digest of the content.

        Raises
        ------
        StudyError
            If the store is full or cannot be written.
        """
        array = np.ascontiguousarray(array)
        if array.dtype.hasobject:
            raise InputError(f"the array {name!r} holds objects, which cannot be stored: give plain numbers")
        digest = hashlib.sha256(f"{array.dtype.str} {array.shape}".encode())
        digest.update(array.view(np.uint8).data if array.size else b"")
        full = f"{_check_name(name)}-{digest.hexdigest()[:24]}"
        if f"{full}.npy" not in self._names("arrays"):
            self._write("arrays", f"{full}.npy", lambda stream: np.save(stream, array, allow_pickle=False))
        return full

    def array(self, name: str) -> np.ndarray:
        """Return an array, read only: mapped into memory from a folder, loaded from a URL.

        Parameters
        ----------
        name
            What `put_array` returned.

        Raises
        ------
        InputError
            If there is none of that name.
        """
        file = f"{_check_name(name)}.npy"
        try:
            if not self._remote:
                mapped: np.ndarray = np.load(Path(self.place) / "arrays" / file, mmap_mode="r", allow_pickle=False)
                return mapped
            array: np.ndarray = np.load(io.BytesIO(self._read("arrays", file)), allow_pickle=False)
        except FileNotFoundError:
            raise InputError(f"the store {self.place!r} has no array {name!r}: store it first") from None
        except OSError as error:
            raise self._storage_error(error, "read") from error
        array.flags.writeable = False
        return array

    def _files(self) -> tuple[Any, str]:
        try:
            from fsspec.core import url_to_fs  # noqa: PLC0415 - of an extra
        except ImportError:
            raise InputError(
                f"a store at {self.place!r} needs fsspec, which is not installed: pip install 'turnwright[cluster]', "
                "or name a folder"
            ) from None
        try:
            files, path = url_to_fs(self.place)
        except (ImportError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(
                f"the store {self.place!r} cannot be used ({reason}): see fsspec, or name a folder"
            ) from None
        return files, str(path).rstrip("/")

    def _names(self, part: str) -> set[str]:
        try:
            if not self._remote:
                with os.scandir(Path(self.place) / part) as entries:
                    return {entry.name for entry in entries if not entry.name.startswith(".")}
            files, root = self._files()
            files.invalidate_cache(f"{root}/{part}")
            listed = files.ls(f"{root}/{part}", detail=False)
        except FileNotFoundError:
            return set()
        except OSError as error:
            raise self._storage_error(error, "read") from error
        return {name for one in listed if not (name := str(one).rsplit("/", 1)[-1]).startswith(".")}

    def _read(self, part: str, name: str) -> bytes:
        if not self._remote:
            return (Path(self.place) / part / name).read_bytes()
        files, root = self._files()
        content: bytes = files.cat_file(f"{root}/{part}/{name}")
        return content

    def _write(self, part: str, name: str, fill: Callable[[IO[bytes]], object]) -> None:
        """Write a file under a temporary name, then rename it."""
        try:
            if self._remote:
                self._put(part, name, fill)
                return
            folder = Path(self.place) / part
            folder.mkdir(parents=True, exist_ok=True)  # a worker on another machine may be the first
            number, made = tempfile.mkstemp(prefix=".", dir=folder)
            try:
                with os.fdopen(number, "wb") as stream:
                    fill(stream)
                Path(made).replace(folder / name)
            except BaseException:
                Path(made).unlink(missing_ok=True)
                raise
        except OSError as error:
            raise self._storage_error(error) from error

    def _put(self, part: str, name: str, fill: Callable[[IO[bytes]], object]) -> None:
        files, root = self._files()
        made = f"{root}/{part}/.{uuid4().hex}"
        files.makedirs(f"{root}/{part}", exist_ok=True)
        try:
            with files.open(made, "wb") as stream:
                fill(stream)
            files.mv(made, f"{root}/{part}/{name}")
        except BaseException:
            with suppress(Exception):  # the first error is reported
                files.rm(made)
            raise

    def _storage_error(self, error: OSError, what: str = "written") -> StudyError:
        if error.errno in DISK_FULL:
            return StudyError(
                f"the store {self.place!r} is full ({error.strerror}), finished cases are kept: free some space there "
                "and start again"
            )
        reason = error.strerror or str(error).splitlines()[0]
        return StudyError(
            f"the store {self.place!r} cannot be {what} ({reason}), finished cases are kept: check its name and "
            "permissions"
        )


def _check_name(name: str) -> str:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InputError(f"{name!r} cannot be a name in a store: use letters, digits, dots, dashes and underscores")
    return name
