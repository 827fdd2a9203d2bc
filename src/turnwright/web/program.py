"""Text of a program and the tip position of its lines, by an index file next to it.

A program of many million lines is never read as a whole. The index has the file offset and the tip position of every
n-th line, so that only a few lines are read per request.
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

__all__ = ["index", "lines", "nearest_line"]

INDEX = "program.npz"
MAX_FULLY_INDEXED_LINES = 200_000
"""Number of lines up to which every line is indexed."""

MAX_STRIDE = 64
BUFFER_BYTES = 1 << 24
CONTEXT_LINES = 40
"""Lines read before the requested ones, for modal axis words."""

MAX_SEGMENTS = 6
"""Segments between indexed lines that are read to find the line nearest to a point."""

COMMENT = re.compile(r"\([^()]*\)|;.*$")
WORD = re.compile(r"([CXYZ])\s*([+-]?(?:\d+\.?\d*|\.\d+))")
SPINDLE = re.compile(r"\bM0?[34]\b")
PASS = re.compile(rb"PASS: ([^,)\n]*)(, ENTRY)?")


def index(out: Path, machine: Machine) -> None:
    """Write the index of the program of a complete run next to it."""
    files = _files(out)
    total = sum(_count(file) for file in files)
    stride = min(max(1, total // MAX_FULLY_INDEXED_LINES), MAX_STRIDE)
    number, starts, which = 0, [], []
    plunging: set[bytes] = set()
    passes: dict[bytes, int] = {}  # first line of each pass; a point is searched in the last pass only
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
                    plunging.add(name)  # the cut begins where the pass is named again
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
    """Return lines of a program, counted from 0, and the tip position after each.

    ``places`` are (x, y, z) in the part frame [mm], or ``None`` for a line without motion.
    """
    index = _Index(Path(out))
    begin = max(0, first - CONTEXT_LINES)
    texts = index.read(begin, first + count - begin)
    places = list(_Axes(index.machine).followed(texts))
    skip = first - begin
    moved = [None if one is None else [round(value, 9) for value in one] for one in places[skip:]]
    return {"lines": texts[skip:], "total": index.total, "places": moved}


def nearest_line(out: str, x: float, y: float) -> dict[str, Any]:
    """Return the line of the finishing pass after which the tip is nearest to a point in the part frame [mm].

    In spindle mode it is the nearest in its distance from the axis.
    """
    index = _Index(Path(out))
    if any(SPINDLE.search(COMMENT.sub("", text)) for text in index.read(index.finish, CONTEXT_LINES)):
        x, y = math.hypot(x, y), 0.0
    axes = _Axes(index.machine)
    tips = index.tips
    use = np.flatnonzero((np.arange(tips.shape[0]) * index.stride >= index.finish) & np.isfinite(tips).all(axis=1))
    if use.size == 0:
        raise InputError("the program has no line that moves the tool over the part")
    if index.stride == 1:
        at = tips[use]
        return {"line": int(use[np.argmin(np.hypot(at[:, 0] - x, at[:, 1] - y))])}
    best = (math.inf, 0)
    for begin in index.pieces(use, x, y):
        texts = index.read(begin, index.stride + 1)
        for step, place in enumerate(axes.followed(texts)):
            if place is not None:
                best = min(best, (math.hypot(place[0] - x, place[1] - y), begin + step))
    return {"line": best[1]}


class _Index:
    """The file that `index` writes."""

    def __init__(self, out: Path) -> None:
        try:
            with np.load(out / INDEX) as archive:
                self.offsets, self.owners, self.tips = archive["offsets"], archive["owners"], archive["tips"]
                self.total, self.stride, self.finish = (
                    int(archive["total"]),
                    int(archive["stride"]),
                    int(archive["finish"]),
                )
        except (OSError, ValueError, KeyError) as error:
            raise InputError(
                f"the program index of the run cannot be read ({type(error).__name__}): run the job again"
            ) from error
        self.files = _files(out)
        self.machine = Job.load(out / "job.toml").machine

    def read(self, first: int, count: int) -> list[str]:
        """Return lines by number."""
        first = min(max(first, 0), self.total)
        count = min(count, self.total - first)
        if count <= 0:
            return []
        entry = first // self.stride
        owner, skip = int(self.owners[entry]), first - entry * self.stride
        lines: list[str] = []
        offset = int(self.offsets[entry])
        while len(lines) < skip + count and owner < len(self.files):
            with self.files[owner].open("rb") as file:
                file.seek(offset)
                while len(lines) < skip + count and (line := file.readline(1 << 16)):
                    lines.append(line.decode("ascii", "replace").rstrip("\r\n"))
            owner, offset = owner + 1, 0
        return lines[skip:]

    def pieces(self, use: Any, x: float, y: float) -> list[int]:
        """Return the first lines of the segments that most likely pass the point."""
        tips = self.tips[use]
        angle, radius = np.unwrap(np.arctan2(tips[:, 1], tips[:, 0])), np.hypot(tips[:, 0], tips[:, 1])
        azimuth, place_radius = math.atan2(y, x), math.hypot(x, y)
        # Between two indexed lines angle and radius are nearly linear, which identifies the segment.
        low, high = np.minimum(angle[:-1], angle[1:]), np.maximum(angle[:-1], angle[1:])
        there = azimuth + 2 * np.pi * np.ceil((low - azimuth) / (2 * np.pi) - 1e-9)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(high > low, (there - angle[:-1]) / (angle[1:] - angle[:-1]), 0.5)
        distance = np.abs(radius[:-1] + np.clip(share, 0, 1) * np.diff(radius) - place_radius)
        distance[there > high] = np.inf
        # At the centre the angle is undefined.
        distance = np.minimum(distance, np.hypot(tips[:-1, 0] - x, tips[:-1, 1] - y))
        return [int(use[one]) * self.stride for one in np.argsort(distance)[:MAX_SEGMENTS]]


class _Axes:
    """Conversion of axis words to the tip position."""

    def __init__(self, machine: Machine) -> None:
        self.convention = machine.convention

    def followed(self, texts: Iterable[str]) -> Iterator[tuple[float, float, float] | None]:
        """Yield the tip position after each line; ``None`` for a line without motion.

        In spindle mode, without a C, it is at azimuth 0.
        """
        at: dict[str, float] = {}
        for text in texts:
            words = WORD.findall(COMMENT.sub("", text))
            at |= {letter: float(value) for letter, value in words}
            yield self.tip(at) if words and {"X", "Z"} <= at.keys() else None

    def tip(self, at: dict[str, float]) -> tuple[float, float, float]:
        """Return the tip position in the part frame. [mm]."""
        way = self.convention
        angle = (math.radians(at["C"]) - way.clocking) * way.c_sense if "C" in at else 0.0
        x, y = at["X"] * way.x_side, at.get("Y", 0.0)
        cosine, sine = math.cos(angle), math.sin(angle)
        return x * cosine - y * sine, x * sine + y * cosine, at["Z"] * way.z_sign


def _files(out: Path) -> list[Path]:
    """Return the text files of a program, in the order of their calls."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        numbers = json.loads((out / "result.json").read_text(encoding="utf-8"))
        files = [out / Path(name).name for name in numbers["program"]["files"] if not name.endswith(".csv")]
        if files and all(file.is_file() for file in files):
            return files
    raise InputError("the run has no program")


def _count(file: Path) -> int:
    return sum(ends.size for ends, _, _ in _ends(file))


def _ends(file: Path) -> Iterator[tuple[Any, bytes, int]]:
    """Yield the offsets of line ends in each block of a file, the block, and its offset."""
    with file.open("rb") as stream:
        offset = 0
        while block := stream.read(BUFFER_BYTES):
            yield np.flatnonzero(np.frombuffer(block, dtype=np.uint8) == 10) + offset, block, offset
            offset += len(block)


def _tips_at(files: list[Path], offsets: Any, owners: Any, axes: _Axes) -> Floats:
    """Return the tip position after the lines at given file offsets. (n, 3) [mm]."""
    tips = np.full((offsets.size, 3), np.nan)
    for place, file in enumerate(files):
        with file.open("rb") as stream:
            for row in np.flatnonzero(owners == place):
                stream.seek(int(offsets[row]))
                text = COMMENT.sub("", stream.readline(1 << 16).decode("ascii", "replace"))
                words = {letter: float(value) for letter, value in WORD.findall(text)}
                if {"X", "Z"} <= words.keys():
                    tips[row] = axes.tip(words)
    return tips
