"""A job and the files that it names in one ZIP archive: packed for the command line, and opened again."""

from __future__ import annotations

import hashlib
import io
import re
import shutil
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from turnwright._io import read_toml
from turnwright.errors import InputError
from turnwright.job import as_tables, written
from turnwright.web.jobs import look_into, plain, read, require
from turnwright.web.limits import BODY_BYTES, FILE_BYTES, FILE_ENDINGS, SPARE_BYTES
from turnwright.web.references import JOB, beside, named, place_of, plain_name, renamed, require_flat

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["bundle", "opened"]

MOST_ENTRIES = 200
"""In an archive; whoever packs one by hand may have left other files in it."""

MOST_FILES = 20
"""That a job in an archive may name."""

PIECE = 2**20


def bundle(data: dict[str, Any], folder: str, before: str = "") -> bytes:
    """Return an archive of a job and the files that it names, as the command line takes them.

    Parameters
    ----------
    data, folder, before
        See `turnwright.web.jobs.write`.

    Raises
    ------
    InputError
        With all that is wrong with the job, in one text.
    """
    require(data, folder)
    told, files = beside(data, Path(folder))
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        archive.writestr(JOB, written(told, before))
        for name, file in files.items():
            archive.write(file, name)
    return sink.getvalue()


def opened(file: str, folder: str) -> dict[str, Any]:
    """Keep the files of an archive that its job names, and return the job with references to them.

    What the archive calls a file never leads to a place on disk: a file is read from it by its name, and kept by what
    it holds.

    Parameters
    ----------
    file
        The archive; what is taken out of it lies beside it under names that begin as its own does, until it is kept.
    folder
        Of the server.

    Returns
    -------
    dict
        Its text, its data and what is wrong with it, as `turnwright.web.jobs.parse`.

    Raises
    ------
    InputError
        If it is no such archive, is too large, holds names that lead elsewhere, or a file that is none of its kind.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            entries = _entries(archive)
            if JOB not in entries:
                raise InputError(f"the archive holds no {JOB}: pack the job under this name, its files beside it")
            text = b"".join(_pieces(archive, entries[JOB], BODY_BYTES))
            job = read_toml(text, f"{JOB} in the archive")
            require_flat(job)
            wanted = [one for one in named(job) if one.name in entries]
            if len(wanted) > MOST_FILES:
                raise InputError(
                    f"the job names {len(wanted)} files, the limit in an archive is {MOST_FILES}: name fewer"
                )
            references: dict[tuple[str, str], str] = {}
            for field, kind, name in wanted:
                if (kind, name) not in references:
                    references[kind, name] = _kept(archive, entries[name], field, kind, Path(file), Path(folder))
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        why = error.strerror if isinstance(error, OSError) else str(error)[:80]  # the rest is a place on this disk
        raise InputError(f"the archive cannot be read ({why}): pack it anew, without a password") from None
    told = plain(renamed(as_tables(job), lambda kind, name: references.get((kind, name), name)))
    return {"toml": written(told, text.decode("utf-8-sig")), "data": told, "errors": read(told, folder)[1]}


def _entries(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return what an archive holds by name."""
    found: dict[str, zipfile.ZipInfo] = {}
    listed = archive.infolist()
    if len(listed) > MOST_ENTRIES:
        raise InputError(
            f"the archive holds {len(listed)} files, the limit is {MOST_ENTRIES}: pack the job and its files"
        )
    for entry in listed:
        name = entry.filename
        parts = re.split(r"[/\\]", name)
        if ".." in parts or not parts[0] or ":" in name or "\0" in name:
            raise InputError(
                f"the archive holds the name {name[:60]!r}, which leads out of it: pack the job and its files beside it"
            )
        if name in found:
            raise InputError(f"the archive holds {name[:60]!r} twice: pack it once")
        found[name] = entry
    return found


def _pieces(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, most: int) -> Iterator[bytes]:
    """Yield what a file in an archive holds, up to a limit, whatever the archive says of its size."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(
            f"{entry.filename[:60]!r} in the archive is packed in a way that few programs read: pack it by deflate"
        )
    seen = 0
    with archive.open(entry) as stream:
        while piece := stream.read(PIECE):
            seen += len(piece)
            if seen > most:
                raise InputError(
                    f"{entry.filename[:60]!r} in the archive has more than {most // 2**20} MiB, the limit: shorten it"
                )
            yield piece


def _kept(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, field: str, kind: str, beside: Path, folder: Path) -> str:
    """Keep a file of an archive if it is one of its kind; return the reference to it."""
    ending = Path(entry.filename).suffix.lower()
    if ending not in FILE_ENDINGS[kind]:
        raise InputError(
            f"{field} names {entry.filename[:60]!r}, one of {kind} can end in {', '.join(FILE_ENDINGS[kind])}: save it "
            "so"
        )
    if shutil.disk_usage(beside.parent).free < SPARE_BYTES + FILE_BYTES:
        raise InputError(
            f"{entry.filename[:60]!r} cannot be kept, the disk of the server has less than "
            f"{(SPARE_BYTES + FILE_BYTES) / 1e9:.3g} GB left: free some space"
        )
    new = beside.with_name(f"{beside.name}-{kind}{ending}")
    digest = hashlib.sha256()
    try:
        with new.open("wb") as stream:
            for piece in _pieces(archive, entry, FILE_BYTES):
                stream.write(piece)
                digest.update(piece)
        try:
            look_into(str(new), kind)
        except InputError as error:
            raise InputError(f"{entry.filename[:60]}: {error}") from None
        name = digest.hexdigest()[:32]
        new.replace(place_of(folder, name, kind, ending))
    finally:
        new.unlink(missing_ok=True)
    return f"files/{name}/{plain_name(entry.filename)}{ending}"
