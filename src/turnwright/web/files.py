"""Routes of files that a job names, such as a table of heights: uploaded once, then used by reference.

A file is stored as ``<folder>/files/ID-KIND.ENDING``, where ID is the beginning of the SHA-256 of its content, so equal
files are stored once. Its original name is part of the reference only.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import shutil
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Request
from starlette.requests import ClientDisconnect

from turnwright.errors import InputError
from turnwright.web import bundles, jobs
from turnwright.web.guard import CLOSE_CONNECTION
from turnwright.web.limits import FILE_BYTES, FILE_ENDINGS, MAX_FILE_READ_S, MIN_FREE_BYTES
from turnwright.web.models import BINARY, FileName, Kept, Opened
from turnwright.web.references import UPLOAD_REFERENCE, display_name, place_of, plain_name
from turnwright.web.workers import TooLong

__all__ = ["RAW_BODY", "router", "stored", "tidy", "uploaded"]

router = APIRouter(prefix="/api/files", tags=["files"])

MAX_UNUSED_DAYS = 30
"""Days after which a file that no run names is removed."""

RAW_BODY = {
    "requestBody": {
        "description": "The bytes of the file.",
        "required": True,
        "content": {"application/octet-stream": {"schema": BINARY}},
    }
}

Kind = Literal["heights", "waviness", "straightness", "correction", "machine", "material", "instrument", "dialect"]


@router.post("", status_code=201, openapi_extra=RAW_BODY)
async def bring(
    request: Request,
    kind: Annotated[Kind, Query(description="Kind of the file; the schema of a job states it for each field.")],
    name: FileName,
) -> Kept:
    """Upload and validate a file for use in a job."""
    state = request.app.state
    ending = File(display_name(name)).suffix.lower()
    if ending not in FILE_ENDINGS[kind]:
        raise HTTPException(
            422,
            f"a file of kind {kind} must end in {', '.join(FILE_ENDINGS[kind])}, got {ending[:12]!r}",
        )
    async with uploaded(request, ending) as (new, size, digest):
        await _read(request, "file", jobs.look_into, str(new), kind)
        new.replace(place_of(state.folder, digest, kind, ending))
    label = f"{plain_name(name)}{ending}"
    return Kept(reference=f"files/{digest}/{label}", name=label, bytes=size)


@router.post("/archive", status_code=201, openapi_extra=RAW_BODY)
async def open_archive(request: Request) -> Opened:
    """Open an archive of a job and its files, and store the files."""
    async with uploaded(request, ".zip") as (new, *_):
        return Opened(**await _read(request, "archive", bundles.unpack_job, str(new), str(request.app.state.folder)))


@asynccontextmanager
async def uploaded(request: Request, ending: str) -> AsyncIterator[tuple[File, int, str]]:
    """Store a request body in a temporary file; yield it with its size and the beginning of its SHA-256."""
    # The name on disk does not depend on the name of the upload.
    file: File = request.app.state.folder / "files" / f".{secrets.token_hex(16)}{ending}"
    try:
        yield file, *await stored(request, file, FILE_BYTES)
    finally:
        await asyncio.to_thread(_forget, file)


def _forget(upload: File) -> None:
    """Remove an upload and partially extracted files of an archive."""
    for one in upload.parent.glob(f"{upload.name}*"):
        one.unlink(missing_ok=True)


async def _read(request: Request, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Read an upload in a worker process within the limits."""
    try:
        return await request.app.state.workers.ask(function, *arguments, limit_s=MAX_FILE_READ_S)
    except TooLong as error:
        limits = f"{MAX_FILE_READ_S:g} s and the memory of a page"
        raise InputError(f"the {what} cannot be read within the limits, {limits} ({error})") from None


async def stored(request: Request, file: File, most: int) -> tuple[int, str]:
    """Stream a request body of at most ``most`` bytes to disk; return its size and the beginning of its SHA-256."""
    seen, digest = 0, hashlib.sha256()
    most = min(most, shutil.disk_usage(file.parent).free - MIN_FREE_BYTES)
    try:
        with file.open("wb") as stream:
            async for chunk in request.stream():
                seen += len(chunk)
                if seen > most:
                    raise HTTPException(
                        413,
                        f"the file must be at most {max(most, 0) / 1e9:.3g} GB (the size limit or the free disk space)",
                        CLOSE_CONNECTION,
                    )
                stream.write(chunk)
                digest.update(chunk)
    except ClientDisconnect:
        raise HTTPException(400, "the upload was interrupted: upload the file again") from None
    except OSError as error:
        raise HTTPException(413, f"the file cannot be stored ({error.strerror})") from error
    if not seen:
        raise HTTPException(422, "the file is empty")
    return seen, digest.hexdigest()[:32]


def tidy(folder: File) -> None:
    """Create the folder of uploads; remove partial uploads and files that no run has named for a long time."""
    (folder / "files").mkdir(exist_ok=True)
    named: set[str] = set()
    for job in folder.glob("runs/*/job.json"):
        with suppress(OSError, UnicodeDecodeError):
            named |= {one[0] for one in UPLOAD_REFERENCE.findall(job.read_text(encoding="utf-8"))}
    for file in folder.glob("files/*"):
        with suppress(OSError):
            old = time.time() - file.stat().st_mtime > MAX_UNUSED_DAYS * 24 * 3600
            if file.name.startswith(".") or (old and file.name.partition("-")[0] not in named):
                file.unlink()
