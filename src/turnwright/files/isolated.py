"""Zygo's datx, which is HDF5, read in a process of its own."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from turnwright._io import answer_parent, read_isolated
from turnwright.errors import MapError
from turnwright.files import arrays, datx
from turnwright.files.base import DAMAGE

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["read_datx"]


def read_datx(path: Path, data: bytes) -> HeightMap:
    """Read a datx file; its bytes go to the other process, its map comes back."""
    return arrays.read_named(path, read_isolated(__name__, path, refusal=MapError, data=data))


def main() -> int:
    """Read the bytes that come in as the file that is named, and send its map out."""
    path = Path(sys.argv[1])
    return answer_parent(
        lambda: arrays.packed(datx.read(path, sys.stdin.buffer.read())), refusal=MapError, damage=DAMAGE
    )
