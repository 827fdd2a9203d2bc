"""Reading Zygo ``.datx`` (HDF5) in a separate process."""

from __future__ import annotations

import sys
from pathlib import Path

from turnwright._io import answer_parent, read_isolated
from turnwright.errors import MapError
from turnwright.files import arrays, datx
from turnwright.files.base import DAMAGE
from turnwright.heightmap import HeightMap

__all__ = ["read_datx"]


def read_datx(path: Path, data: bytes) -> HeightMap:
    """Read a datx file in a separate process."""
    return arrays.read_named(path, read_isolated(__name__, path, refusal=MapError, data=data))


def main() -> int:
    """Read a datx file from standard input and write its map to standard output."""
    path = Path(sys.argv[1])
    return answer_parent(
        lambda: arrays.packed(datx.read(path, sys.stdin.buffer.read())), refusal=MapError, damage=DAMAGE
    )
