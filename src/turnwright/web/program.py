"""The text of a program and the places of its lines, by an index that a run leaves beside it.

A program of many million lines is never read as a whole: the index says where every so-manieth line begins and where
the tip then is, so that a few lines are read for any question.
"""

from __future__ import annotations

import json
import math
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.errors import InputError
from turnwright.job import Job

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from turnwright._arrays import Floats
    from turnwright.machine import Machine

__all__ = ["index", "lines", "near"]

INDEX = "program.npz"
FINEST = 200_000
"""Lines of a program up to which the index knows every line."""

COARSEST = 64
BUFFER = 1 << 24
BACK = 40
"""Lines before those asked for, which say what these leave unsaid."""

BEST = 6
"""Pieces between known lines that are read when a place is looked for."""

REMARK = re.compile(r"\([^()]*\)|;.*$")
WORD = re.compile(r"([CXYZ])\s*([+-]?(?:\d+\.?\d*|\.\d+))")
PASS = re.compile(rb"PASS: ([^,)\n]*)(, ENTRY)?")


def index(out: Path, machine: Machine) -> None:
    """Write where the lines of a program are, beside it.

    Parameters
    ----------
    out
        Folder of a run that is complete.
    machine
        Whose axes the program moves.
    """
    files = _files(out)
    total = sum(_count(file) for file in files)
    stride = min(max(1, total // FINEST), COARSEST)
    number, starts, which = 0, [], []
    plunging: set[bytes] = set()
    passes: dict[bytes, int] = {}  # where each begins, so that a place is looked for in the last one only
    for place, file in enumerate(files):
        first, begun = number, 0
        for ends, block, offset in _ends(file):
            at = np.arange(first, first + ends.size + 1)
            begins = np.concatenate([[begun], ends + 1])
            keep = at[:-1] % stride == 0
            starts.append(begins[:-1][keep])
            which.append(np.full(int(keep.sum()), place))
            for match in PASS.finditer(block):
                name = match.group(1).strip()
                if match.group(2):
                    plunging.add(name)  # its cut is named again, and begins there
                elif name in plunging or name not in passes:
                    plunging.discard(name)
                    passes[name] = first + int(np.searchsorted(ends, offset + match.start()))
            first, begun = int(at[-1]), int(begins[-1])
        number = first
    offsets, owners = np.concatenate(starts), np.concatenate(which)
    tips = _tips_at(files, offsets, owners, _Axes(machine))
    np.savez(
        out / INDEX, offsets=offsets, owners=owners, tips=tips, total=number, stride=stride,
        finish=max(passes.values(), default=0),
    )  # fmt: skip


def lines(out: str, first: int, count: int) -> dict[str, Any]:
    """Return some lines of a program, counted from 0, and where the tip is after each.

    Parameters
    ----------
    out
        Folder of a run.
    first, count
        Which lines; those beyond the end are left out.

    Returns
    -------
    dict
        ``lines``, ``total`` and ``places``, each (x, y, z) in the part frame [mm] or ``None`` for a line that moves
        nothing.
    """
    found = _Index(Path(out))
    begin = max(0, first - BACK)
    texts = found.read(begin, first + count - begin)
    places = list(_Axes(found.machine).followed(texts))
    skip = first - begin
    moved = [None if one is None else [round(value, 9) for value in one] for one in places[skip:]]
    return {"lines": texts[skip:], "total": found.total, "places": moved}


def near(out: str, x: float, y: float) -> dict[str, Any]:
    """Return the line of the finishing pass after which the tip is nearest to a place.

    Parameters
    ----------
    out
        Folder of a run.
    x, y
        Where, in the part frame. [mm]
    """
    found = _Index(Path(out))
    axes = _Axes(found.machine)
    tips = found.tips
    use = np.flatnonzero((np.arange(tips.shape[0]) * found.stride >= found.finish) & np.isfinite(tips).all(axis=1))
    if use.size == 0:
        raise InputError("the program has no line that moves the tool over the part: look at its text")
    if found.stride == 1:
        at = tips[use]
        return {"line": int(use[np.argmin(np.hypot(at[:, 0] - x, at[:, 1] - y))])}
    best = (math.inf, 0)
    for begin in found.pieces(use, x, y):
        texts = found.read(begin, found.stride + 1)
        for step, place in enumerate(axes.followed(texts)):
            if place is not None:
                best = min(best, (math.hypot(place[0] - x, place[1] - y), begin + step))
    return {"line": best[1]}


class _Index:
    """What `index` has left."""

    def __init__(self, out: Path) -> None:
        try:
            with np.load(out / INDEX) as kept:
                self.offsets, self.owners, self.tips = kept["offsets"], kept["owners"], kept["tips"]
                self.total, self.stride, self.finish = int(kept["total"]), int(kept["stride"]), int(kept["finish"])
        except (OSError, ValueError, KeyError) as error:
            raise InputError(
                f"the run has no program that can be shown ({type(error).__name__}): run it again"
            ) from error
        self.files = _files(out)
        self.machine = Job.load(out / "job.toml").machine

    def read(self, first: int, count: int) -> list[str]:
        """Return lines by number."""
        first = min(max(first, 0), self.total)
        count = min(count, self.total - first)
        if count <= 0:
            return []
        known = first // self.stride
        owner, skip = int(self.owners[known]), first - known * self.stride
        found: list[str] = []
        offset = int(self.offsets[known])
        while len(found) < skip + count and owner < len(self.files):
            with self.files[owner].open("rb") as file:
                file.seek(offset)
                while len(found) < skip + count and (line := file.readline(1 << 16)):
                    found.append(line.decode("ascii", "replace").rstrip("\r\n"))
            owner, offset = owner + 1, 0
        return found[skip:]

    def pieces(self, use: Any, x: float, y: float) -> list[int]:
        """Return the lines at which the likeliest pieces begin."""
        tips = self.tips[use]
        angle, radius = np.unwrap(np.arctan2(tips[:, 1], tips[:, 0])), np.hypot(tips[:, 0], tips[:, 1])
        wanted, far = math.atan2(y, x), math.hypot(x, y)
        # Between two known lines angle and radius run nearly straight, so the piece that passes the place is told.
        low, high = np.minimum(angle[:-1], angle[1:]), np.maximum(angle[:-1], angle[1:])
        there = wanted + 2 * np.pi * np.ceil((low - wanted) / (2 * np.pi) - 1e-9)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(high > low, (there - angle[:-1]) / (angle[1:] - angle[:-1]), 0.5)
        off = np.abs(radius[:-1] + np.clip(share, 0, 1) * np.diff(radius) - far)
        off[there > high] = np.inf
        # At the centre the angle says nothing.
        off = np.minimum(off, np.hypot(tips[:-1, 0] - x, tips[:-1, 1] - y))
        return [int(use[one]) * self.stride for one in np.argsort(off)[:BEST]]


class _Axes:
    """From the words of a program to the place of the tip."""

    def __init__(self, machine: Machine) -> None:
        self.convention = machine.convention

    def followed(self, texts: Iterable[str]) -> Iterator[tuple[float, float, float] | None]:
        """Yield the place of the tip after each line; ``None`` for one that moves nothing."""
        at: dict[str, float] = {}
        for text in texts:
            words = WORD.findall(REMARK.sub("", text))
            at |= {letter: float(value) for letter, value in words}
            yield self.tip(at) if words and {"C", "X", "Z"} <= at.keys() else None

    def tip(self, at: dict[str, float]) -> tuple[float, float, float]:
        """Return the place of the tip on the part. [mm]."""
        way = self.convention
        angle = (math.radians(at["C"]) - way.clocking) * way.c_sense
        x, y = at["X"] * way.x_side, at.get("Y", 0.0)
        cosine, sine = math.cos(angle), math.sin(angle)
        return x * cosine - y * sine, x * sine + y * cosine, at["Z"] * way.z_sign


def _files(out: Path) -> list[Path]:
    """Return the files of a program: those of lines, in the order of their calls."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        told = json.loads((out / "result.json").read_text(encoding="utf-8"))
        files = [out / Path(name).name for name in told["program"]["files"] if not name.endswith(".csv")]
        if files and all(file.is_file() for file in files):
            return files
    raise InputError("the run has no program: look at the list of runs for one that is done")


def _count(file: Path) -> int:
    return sum(ends.size for ends, _, _ in _ends(file))


def _ends(file: Path) -> Iterator[tuple[Any, bytes, int]]:
    """Yield where the lines of each block of a file end, the block, and where it begins; every line has an end."""
    with file.open("rb") as stream:
        offset = 0
        while block := stream.read(BUFFER):
            yield np.flatnonzero(np.frombuffer(block, dtype=np.uint8) == 10) + offset, block, offset
            offset += len(block)


def _tips_at(files: list[Path], offsets: Any, owners: Any, axes: _Axes) -> Floats:
    """Return where the tip is after the lines at some places of the files. (n, 3) [mm]."""
    tips = np.full((offsets.size, 3), np.nan)
    for place, file in enumerate(files):
        with file.open("rb") as stream:
            for row in np.flatnonzero(owners == place):
                stream.seek(int(offsets[row]))
                text = REMARK.sub("", stream.readline(1 << 16).decode("ascii", "replace"))
                words = {letter: float(value) for letter, value in WORD.findall(text)}
                if {"C", "X", "Z"} <= words.keys():
                    tips[row] = axes.tip(words)
    return tips
