"""CODE V interferogram files ``.int``: integer heights on a grid, or fringe Zernike coefficients.

Lines that begin with ``!`` are comments. Then follow a title, a line of keywords, and numbers. ``GRD nx ny`` are counts
on a grid, ``ZFR n`` fringe Zernike coefficients; ``SUR`` marks heights of a surface, ``WFR`` a wavefront. ``WVL`` is
the wavelength in um, ``SSZ`` counts per wavelength, ``NDA`` the count of a missing point: height = count / SSZ * WVL.
x runs fastest; the first row is at +y. Files have square points and no size: CODE V scales them to the aperture.

Heights are written with WVL 1, so that SSZ counts are one micrometre, with the largest count that 16 bits hold.

Sources
-------
[prysm]_ for the layout and the first row. Oracle: its ``read_codev_gridint``, which is right where WVL is 1: release
0.21 divides by the wavelength where it must multiply, takes nx for the rows, and leaves the rows as in the file.
"""

from __future__ import annotations

import math
import re
from os import PathLike
from pathlib import Path

import numpy as np

from turnwright._validate import positive
from turnwright.errors import MapError
from turnwright.files.base import (
    damaged,
    grid_map,
    is_front,
    read_contents,
    require_bytes,
    require_points,
    square_pixel,
    write_file,
)
from turnwright.files.numbers import numbers, text_of
from turnwright.heightmap import HeightMap
from turnwright.surface import Zernike, zernike_order

__all__ = ["is_interferogram", "pack", "read", "read_zernikes", "write_zernikes"]

HEAD = re.compile(r"(?:[ \t]*![^\n]*\n)*([^\n!]*)\n[ \t]*((?:GRD|ZFR|ZRN)[ \t][^\n]*)(?:\n|$)", re.IGNORECASE)
MAX_COUNT, MISSING = 32767, -32768
UM = 1e3  # in a mm
COUNTS_PER_LINE = 10
MAX_TITLE = 72
MAX_TERM = 37
"""Last term of the fringe set."""


def is_interferogram(text: str) -> bool:
    """Whether a text begins like a CODE V interferogram file."""
    return HEAD.match(text) is not None


def read(path: Path, text: str) -> HeightMap:
    """Read a grid of heights, which counts pixels."""
    title, words, body = _split(path, text)
    if "GRD" not in words:
        raise MapError(f"{path} holds Zernike coefficients, not a grid of heights: read it with files.read_zernikes")
    columns, rows = (_integer(path, number) for number in words["GRD"])
    require_points(path, columns, rows)
    require_bytes(path, 2 * columns * rows, len(body))
    counts = numbers(path, body)
    if counts.size != columns * rows:
        raise damaged(path, f"has {counts.size} counts for {columns} x {rows}")
    heights = counts * _scale(path, words)
    heights[counts == float(words["NDA"][0])] = np.nan
    return grid_map(
        path, heights.reshape(rows, columns)[::-1], None, metadata={"format": "CODE V interferogram", "title": title}
    )


def pack(heights: HeightMap) -> bytes:
    """Return the bytes of a file of surface heights in counts of 1/32767 of the largest."""
    square_pixel(heights, "CODE V")
    rows, columns = heights.z.shape
    highest = float(np.nanmax(np.abs(heights.z), initial=0.0)) * UM
    per_um = MAX_COUNT / highest if highest > 0 else 1.0
    counts = np.where(np.isnan(heights.z), MISSING, np.rint(heights.z * UM * per_um)).astype(int)
    lines = [
        *_title(heights.name, f"x {_span(heights.x)} mm, y {_span(heights.y)} mm"),
        f"GRD {columns} {rows} SUR WVL 1.0 SSZ {per_um!r} NDA {MISSING}",
    ]
    for row in counts[::-1].tolist():
        lines += [
            "".join(f"{count:7d}" for count in row[start : start + COUNTS_PER_LINE])
            for start in range(0, columns, COUNTS_PER_LINE)
        ]
    return ("\n".join(lines) + "\n").encode("ascii")


def write_zernikes(surface: Zernike, file: str | PathLike[str], *, face: str | None = None) -> None:
    """Write a Zernike surface as fringe coefficients in a CODE V interferogram file; an existing file is replaced.

    The normalisation radius is not in the file: it is the aperture of the interferogram in CODE V.

    Parameters
    ----------
    surface
        In any order and normalisation.
    file
        Path, usually ``.int``.
    face
        See `write_map`.

    Raises
    ------
    MapError
        If a term is not in the fringe set of 37, or the file cannot be written.
    """
    front = is_front(face)
    order = {zernike_order(j, "fringe"): j for j in range(1, MAX_TERM + 1)}
    values = [0.0] * MAX_TERM
    normalised = surface.indexing != "fringe" if surface.normalised is None else surface.normalised
    for index, value in dict(surface.terms).items():
        n, m = zernike_order(index, surface.indexing)
        if (n, m) not in order:
            raise MapError(
                f"the {surface.indexing} term {index}, (n, m) = {n, m}, is not among the {MAX_TERM} fringe terms of a "
                "CODE V file: write a map of the surface"
            )
        # Half a turn about y: cos m(pi - a) = (-1)^m cos ma, sin m(pi - a) = -(-1)^m sin ma, and z changes sign.
        turned = (-1.0) ** (m + (m >= 0)) if front else 1.0
        values[order[n, m] - 1] = value * turned * (math.sqrt((n + 1) * (2 if m else 1)) if normalised else 1.0)
    lines = [*_title("", f"normalisation radius {surface.radius!r} mm"), f"ZFR {MAX_TERM} SUR WVL 1.0 SSZ 1.0"]
    lines += [repr(UM * value) for value in values]
    write_file(Path(file), ("\n".join(lines) + "\n").encode("ascii"))


def read_zernikes(file: str | PathLike[str], *, radius: float) -> Zernike:
    """Read fringe Zernike coefficients of a surface from a CODE V interferogram file.

    Parameters
    ----------
    file
        A file of ``ZFR``.
    radius
        Normalisation radius, which the file does not state. [mm]

    Raises
    ------
    MapError
        If the file cannot be read, or holds a grid, a wavefront or another order of terms.
    """
    path = Path(file)
    positive(radius, "the radius of a Zernike surface", "mm")
    text = text_of(read_contents(path))
    if text is None or not is_interferogram(text):
        raise MapError(f"{path} is not a CODE V interferogram file: export it again")
    _, words, body = _split(path, text)
    if "ZFR" not in words:
        raise MapError(f"{path} states {', '.join(words)}, this reads ZFR only: export fringe Zernike coefficients")
    values = numbers(path, body)
    if values.size != words["ZFR"][0] or not 1 <= values.size <= MAX_TERM:
        raise damaged(path, f"has {values.size} coefficients for ZFR {words['ZFR'][0]:g}, up to {MAX_TERM} are read")
    terms = dict(enumerate((values * _scale(path, words)).tolist(), 1))
    return Zernike(terms={j: value for j, value in terms.items() if value or j == 1}, radius=radius, indexing="fringe")


KEYS = {"GRD": 2, "ZFR": 1, "ZRN": 1, "WVL": 1, "SSZ": 1, "NDA": 1, "XSC": 1, "SUR": 0, "WFR": 0, "FIL": 0, "NNB": 0}
"""Keywords, and how many numbers follow each."""


def _split(path: Path, text: str) -> tuple[str, dict[str, list[float]], str]:
    """Return the title, the numbers by keyword, and the text of the counts or coefficients."""
    head = HEAD.match(text)
    assert head is not None  # noqa: S101 - callers know the format
    cells = head[2].split()
    words: dict[str, list[float]] = {}
    while cells:
        key = cells.pop(0).upper()
        if key not in KEYS:
            raise MapError(f"{path} has the keyword {key[:20]!r}, known are {', '.join(KEYS)}: export it without")
        try:
            words[key] = [float(cells.pop(0)) for _ in range(KEYS[key])]
        except (IndexError, ValueError) as error:
            raise damaged(path, f"has no number after {key}") from error
    if "SUR" not in words:
        raise MapError(f"{path} is not marked SUR, and only heights of a surface are read: export surface data")
    if words.get("XSC", [1.0]) != [1.0]:
        raise MapError(f"{path} has points that are not square (XSC {words['XSC'][0]:g}): resample it to square ones")
    return head[1].strip(), {"NDA": [MISSING], "SSZ": [1.0], **words}, text[head.end() :]


def _integer(path: Path, number: float) -> int:
    if not number.is_integer():
        raise damaged(path, f"has GRD {number:g}, both of its numbers must be integers")
    return int(number)


def _scale(path: Path, words: dict[str, list[float]]) -> float:
    """Return one count in mm."""
    wavelength, per_wave = words.get("WVL", [math.nan])[0], words["SSZ"][0]
    if not (0 < wavelength < math.inf and 0 < per_wave < math.inf):
        raise damaged(path, f"has WVL {wavelength:g} and SSZ {per_wave:g}, they must be finite and above 0")
    return wavelength / per_wave / UM


def _title(name: str, remark: str) -> tuple[str, str]:
    plain = name.encode("ascii", "replace").decode().replace("!", " ").replace("\n", " ").strip()
    return f"! {remark}", plain[:MAX_TITLE] or "surface"


def _span(axis: np.ndarray | None) -> str:
    assert axis is not None  # noqa: S101 - the caller requires a grid
    return f"{axis[0]:.9g} to {axis[-1]:.9g}"
