"""ZIP archives of a job and the files that it names, for exchange with the command line."""

from __future__ import annotations

import hashlib
import io
import re
import shutil
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from turnwright._io import json_data, read_toml
from turnwright.errors import InputError
from turnwright.job import as_tables, write_job
from turnwright.web.jobs import look_into, read, require
from turnwright.web.limits import BODY_BYTES, FILE_BYTES, FILE_ENDINGS, MIN_FREE_BYTES
from turnwright.web.references import (
    JOB,
    list_files,
    place_of,
    plain_name,
    rename_files,
    require_flat,
    unpack_references,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["bundle", "unpack_job"]

MAX_ENTRIES = 200
"""Files in an archive; one that is packed by hand may contain unrelated files."""

MAX_FILES = 20
"""Files that a job in an archive may name."""

PIECE_BYTES = 2**20


def bundle(data: dict[str, Any], folder: str, before: str = "") -> bytes:
    """Return an archive of a job and the files that it names, readable by the command line; see `jobs.write`."""
    require(data, folder)
    renamed_job, files = unpack_references(data, Path(folder))
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        archive.writestr(JOB, write_job(renamed_job, before))
        for name, file in files.items():
            archive.write(file, name)
    return sink.getvalue()


def unpack_job(file: str, folder: str) -> dict[str, Any]:
    """Store the files that the job of an archive names; return its text, data and problems as `jobs.parse` does.

    File names in the archive are never used as paths: a file is stored under the hash of its content.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            entries = _entries(archive)
            if JOB not in entries:
                raise InputError(f"the archive must contain {JOB} in its root folder")
            text = b"".join(_pieces(archive, entries[JOB], BODY_BYTES))
            job = read_toml(text, f"{JOB} in the archive")
            require_flat(job)
            wanted = [one for one in list_files(job) if one.name in entries]
            if len(wanted) > MAX_FILES:
                raise InputError(f"a job in an archive can name at most {MAX_FILES} files, got {len(wanted)}")
            references: dict[tuple[str, str], str] = {}
            for field, kind, name in wanted:
                if (kind, name) not in references:
                    references[kind, name] = _store_file(archive, entries[name], field, kind, Path(file), Path(folder))
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        why = error.strerror if isinstance(error, OSError) else str(error)[:80]  # without paths of this computer
        raise InputError(f"the archive cannot be read ({why}): create it again, without a password") from None
    data = json_data(rename_files(as_tables(job), lambda kind, name: references.get((kind, name), name)))
    return {"toml": write_job(data, text.decode("utf-8-sig")), "data": data, "errors": read(data, folder)[1]}


def _entries(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return the entries of an archive by name."""
    entries: dict[str, zipfile.ZipInfo] = {}
    listed = archive.infolist()
    if len(listed) > MAX_ENTRIES:
        raise InputError(f"an archive can contain at most {MAX_ENTRIES} files, got {len(listed)}")
    for entry in listed:
        name = entry.filename
        parts = re.split(r"[/\\]", name)
        if ".." in parts or not parts[0] or ":" in name or "\0" in name:
            raise InputError(f"names in the archive must be relative paths without '..', got {name[:60]!r}")
        if name in entries:
            raise InputError(f"the archive contains {name[:60]!r} twice")
        entries[name] = entry
    return entries


def _pieces(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, most: int) -> Iterator[bytes]:
    """Yield the content of a file in an archive up to a limit, whatever size the archive states."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(
            f"{entry.filename[:60]!r} in the archive must be stored or deflated: create it with a standard ZIP program"
        )
    seen = 0
    with archive.open(entry) as stream:
        while piece := stream.read(PIECE_BYTES):
            seen += len(piece)
            if seen > most:
                raise InputError(f"{entry.filename[:60]!r} in the archive must be at most {most // 2**20} MiB")
            yield piece


def _store_file(
    archive: zipfile.ZipFile, entry: zipfile.ZipInfo, field: str, kind: str, archive_file: Path, folder: Path
) -> str:
    """Validate and store a file of an archive; return the reference to it."""
    ending = Path(entry.filename).suffix.lower()
    if ending not in FILE_ENDINGS[kind]:
        raise InputError(f"{field} must end in {', '.join(FILE_ENDINGS[kind])}, got {entry.filename[:60]!r}")
    if shutil.disk_usage(archive_file.parent).free < MIN_FREE_BYTES + FILE_BYTES:
        raise InputError(
            f"{entry.filename[:60]!r} cannot be stored, the disk of the server has less than "
            f"{(MIN_FREE_BYTES + FILE_BYTES) / 1e9:.3g} GB free"
        )
    file = archive_file.with_name(f"{archive_file.name}-{kind}{ending}")
    digest = hashlib.sha256()
    try:
        with file.open("wb") as stream:
            for piece in _pieces(archive, entry, FILE_BYTES):
                stream.write(piece)
                digest.update(piece)
        try:
            look_into(str(file), kind)
        except InputError as error:
            raise InputError(f"{entry.filename[:60]}: {error}") from None
        name = digest.hexdigest()[:32]
        file.replace(place_of(folder, name, kind, ending))
    finally:
        file.unlink(missing_ok=True)
    return f"files/{name}/{plain_name(entry.filename)}{ending}"
