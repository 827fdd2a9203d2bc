"""Routes of files that a job names, such as a table of heights: brought once, then named by a reference.

A file lies at ``<folder>/files/ID-KIND.ENDING``, where the id is the beginning of the SHA-256 of its bytes, so the same
file takes its place once; what it was called stands in the reference alone.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import shutil
import time
from contextlib import suppress
from pathlib import Path as File
from typing import Annotated, Literal

from fastapi import APIRouter, HTTPException, Query, Request
from starlette.requests import ClientDisconnect

from turnwright.errors import InputError
from turnwright.web import bundles, jobs
from turnwright.web.guard import HANG_UP
from turnwright.web.limits import FILE_BYTES, FILE_ENDINGS, FILE_S, SPARE_BYTES
from turnwright.web.models import Kept, Opened
from turnwright.web.references import BROUGHT, place_of, plain_name, shown_name
from turnwright.web.workers import TooLong

__all__ = ["RAW_BODY", "router", "stored", "tidy"]

router = APIRouter(prefix="/api/files", tags=["files"])

KEPT_DAYS = 30
"""How long a file stays that no run names."""

RAW_BODY = {
    "requestBody": {
        "description": "The bytes of the file.",
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}

Kind = Literal["heights", "waviness", "straightness", "correction", "machine", "material", "instrument"]


@router.post("", status_code=201, openapi_extra=RAW_BODY)
async def bring(
    request: Request,
    kind: Annotated[Kind, Query(description="What it holds; the schema of a job says which for each field.")],
    name: Annotated[str, Query(min_length=1, max_length=200, description="What the file is called.")],
) -> Kept:
    """Bring a file that a job is to name; it is read at once, so what is wrong with it is said here."""
    state = request.app.state
    ending = File(shown_name(name)).suffix.lower()
    if ending not in FILE_ENDINGS[kind]:
        raise HTTPException(
            422,
            f"the file ends in {ending[:12]!r}, one of {kind} can end in {', '.join(FILE_ENDINGS[kind])}: save it so",
        )
    folder: File = state.folder / "files"
    # Whatever the file is called, its place and name on this disk are the server's own.
    new = folder / f".{secrets.token_hex(16)}{ending}"
    try:
        size, digest = await stored(request, new, FILE_BYTES)
        try:
            await state.workers.ask(jobs.look_into, str(new), kind, limit_s=FILE_S)
        except TooLong as error:
            raise InputError(_too_long("file", error)) from None
        new.replace(place_of(state.folder, digest, kind, ending))
    finally:
        new.unlink(missing_ok=True)
    label = f"{plain_name(name)}{ending}"
    return Kept(reference=f"files/{digest}/{label}", name=label, bytes=size)


@router.post("/archive", status_code=201, openapi_extra=RAW_BODY)
async def open_archive(request: Request) -> Opened:
    """Open an archive of a job and the files that it names, as the page or a run packs it, and keep those files."""
    state = request.app.state
    folder: File = state.folder / "files"
    new = folder / f".{secrets.token_hex(16)}.zip"
    try:
        await stored(request, new, FILE_BYTES)
        try:
            found = await state.workers.ask(bundles.opened, str(new), str(state.folder), limit_s=FILE_S)
        except TooLong as error:
            raise InputError(_too_long("archive", error)) from None
    finally:
        await asyncio.to_thread(_forget, new)
    return Opened(**found)


def _forget(archive: File) -> None:
    """Remove an archive, and what a process was about to take out of it when it was ended."""
    for one in archive.parent.glob(f"{archive.name}*"):
        one.unlink(missing_ok=True)


def _too_long(what: str, error: TooLong) -> str:
    return f"the {what} cannot be read within the limits, {FILE_S:g} s and the memory of a page ({error})"


async def stored(request: Request, file: File, most: int) -> tuple[int, str]:
    """Write what arrives to disk as it arrives; return its size and the beginning of its SHA-256.

    Parameters
    ----------
    request
        Whose body it is.
    file
        Where it goes.
    most
        How large it may be. [byte]
    """
    seen, digest = 0, hashlib.sha256()
    most = min(most, shutil.disk_usage(file.parent).free - SPARE_BYTES)
    try:
        with file.open("wb") as stream:
            async for chunk in request.stream():
                seen += len(chunk)
                if seen > most:
                    raise HTTPException(
                        413,
                        f"the file is larger than {max(most, 0) / 1e9:.3g} GB, which is what the server takes or has "
                        "room for: bring a smaller one",
                        HANG_UP,
                    )
                stream.write(chunk)
                digest.update(chunk)
    except ClientDisconnect:
        raise HTTPException(400, "the file broke off before its end: bring it again") from None
    except OSError as error:
        raise HTTPException(413, f"the file cannot be kept ({error.strerror}): free some space") from error
    if not seen:
        raise HTTPException(422, "the file is empty: bring one that holds something")
    return seen, digest.hexdigest()[:32]


def tidy(folder: File) -> None:
    """Make the place of what is brought; throw away what no run names for long, and what was half-brought."""
    (folder / "files").mkdir(exist_ok=True)
    named: set[str] = set()
    for job in folder.glob("runs/*/job.json"):
        with suppress(OSError, UnicodeDecodeError):
            named |= {one[0] for one in BROUGHT.findall(job.read_text(encoding="utf-8"))}
    for file in folder.glob("files/*"):
        with suppress(OSError):
            old = time.time() - file.stat().st_mtime > KEPT_DAYS * 24 * 3600
            if file.name.startswith(".") or (old and file.name.partition("-")[0] not in named):
                file.unlink()
