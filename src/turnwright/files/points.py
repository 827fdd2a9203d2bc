"""Text and CSV: points x, y, z in rows, which become a grid if they stand on one; or a table of heights.

What the numbers mean must be in the file: separator and decimal sign are found from the rows, and refused where two
readings are possible; names and units of the columns are taken from the description above. Points of a lattice become a
grid with nan where it has none. A table of heights has x in its first row, after an empty cell or a word, and y in its
first column; a bare one has more than eight columns, no names, and its first row at the top.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from shlex import quote
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import MapError
from turnwright.files.base import finite_or_missing, grid_map, require_points
from turnwright.files.lattice import on_lattice
from turnwright.files.numbers import table
from turnwright.files.units import SPELLINGS, to_mm
from turnwright.heightmap import HeightMap

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["read", "read_slice"]

MOST_LINES = 300
"""Lines of description above the table, at most."""

ALIKE = 3
"""Rows that must have the same columns for a table to begin with the first of them."""

SOME, ALL = 1, 2
"""How well lines read as a table."""

CROSSED = 4
"""Columns of a table with x in its first row and y in its first column, at least: three of heights."""

BARE = 8
"""A table of more columns than this is one of heights; of fewer, it may be points with more beside them."""

LONGEST = 2000
"""Letters of the description that are kept."""

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
COMMA = re.compile(r"[+-]?(?:\d*,\d+|\d+)(?:[eE][+-]?\d+)?")
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
ONLY_NUMBERS = re.compile(r"\s*[-+\d.,][-+\d.,;eE\s]*")
MISSING = re.compile(r"(?i)nan|[+-]?inf(?:inity)?|no ?data|bad|n/?a|null|\*+|-{2,}|")
MARKS = "#%!;/"
"""What a line of description may begin with."""

NAMES = {
    "x": re.compile(r"x([ _-]?(pos(ition)?|coord(inate)?|axis|value))?"),
    "y": re.compile(r"y([ _-]?(pos(ition)?|coord(inate)?|axis|value))?"),
    "z": re.compile(r"z([ _-]?(pos(ition)?|coord(inate)?|axis|value))?|heights?|sag|elevation"),
}
ROLES = {
    "distance": re.compile(rf"{NAMES['x'].pattern}|dist(ance)?|pos(ition)?|lateral|abscissa|scan|along"),
    "height": re.compile(rf"{NAMES['z'].pattern}|h|profile|deviation|topography"),
}
"""What names of columns say in a profile; y is whichever the other column is not."""

NO_LENGTH = re.compile(r"slopes?\b.*|(local )?(gradient|angle|tilt|curvature)s?|dz[ /]?dx")
"""Names of columns that hold neither distances nor heights."""

UNIT = "|".join(sorted(map(re.escape, SPELLINGS), key=len, reverse=True)) + "|px|pixels?"
CELL = re.compile(rf"(?i)\s*(.*?)\s*(?:[\[(/_,]\s*({UNIT})\s*[\])]?|\s({UNIT}))?\s*")
STATED = re.compile(
    rf"(?i)\b(?:(x[ /,&-]*y|lateral|x|y|z|heights?)[ _-]*)?units?\b(?:\s+of\s+(x|y|z|heights?))?\W{{1,4}}({UNIT})\b"
)
PIXELS = frozenset({"px", "pixel", "pixels"})


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the table is written."""

    first: int  # line in which it begins, from 0
    separator: str | None  # None: white space
    comma: bool  # decimal commas
    columns: int
    numeric: bool  # every column


def read(path: Path, text: str, unit: str | None, lateral_unit: str | None) -> HeightMap:
    """Read text; the units are for numbers that the text gives none."""
    lines = _first_lines(text)
    layout = _layout(path, lines)
    # An empty lateral unit keeps that of the heights from standing in for it.
    rest = unit if lateral_unit is None else None
    lateral_unit = lateral_unit or None
    crossed = _crossed(lines, layout)
    if crossed is not None:
        return _read_crossed(path, text, layout, crossed, _stated(lines[: crossed[0]]), (unit, lateral_unit, rest))
    above = lines[: layout.first]
    names = _names(above, layout)
    chosen = _columns(path, names, layout.columns, _numeric_columns(lines, layout))
    body = _body(text, layout)
    metadata = {"format": "text", "description": "\n".join(line for line in above if line.strip())[:LONGEST]}
    if chosen is None:
        scale = _unit(path, {}, _stated(above), "z", unit)
        if scale is None:
            raise MapError(f"{path} has heights that count pixels: state a length")
        found = _table(path, body, layout, None)
        require_points(path, found.shape[1], found.shape[0])
        return grid_map(path, found[::-1] * scale, None, metadata=metadata)
    units = _column_units(above, layout)
    stated = _stated(above)
    given = {"x": (lateral_unit, rest), "y": (lateral_unit, rest), "z": (unit, None)}
    scales = {axis: _unit(path, units, stated, axis, *given[axis]) for axis in chosen}
    found = _table(path, body, layout, tuple(chosen.values()))
    return _as_map(path, dict(zip(chosen, found.T, strict=True)), scales, metadata)


def read_slice(
    path: Path, text: str, columns: tuple[str | None, str | None], unit: str | None, lateral_unit: str | None
) -> tuple[Floats, Floats, str]:
    """Return distances and heights of a text's rows in mm, missing ones nan, and its description. Each (n,).

    Parameters
    ----------
    path
        Of the file, for messages.
    text
        Rows of numbers below a line of names.
    columns
        Names of the columns of distance and height, or their numbers from 1; without names two columns of numbers.
    unit, lateral_unit
        Of the heights, and of the distances if not the same, where the text states none.
    """
    lines = _first_lines(text)
    layout = _layout(path, lines)
    above = lines[: layout.first]
    names = _names(above, layout) or [str(number + 1) for number in range(layout.columns)]
    chosen = _slice_columns(path, names, columns, _numeric_columns(lines, layout))
    own = {axis: named for axis, at in zip("xz", chosen, strict=True) if (named := _split_cell(names[at])[1])}
    scales = []
    for axis, given, rest in (("x", lateral_unit, unit), ("z", unit, None)):
        scale = _unit(path, own, _stated(above), axis, given, rest)
        if scale is None:
            raise MapError(f"{path} counts pixels where a profile needs lengths: export it calibrated")
        scales.append(scale)
    found = _table(path, _body(text, layout), layout, chosen) * scales
    placed = np.isfinite(found[:, 0])
    if (np.isfinite(found[:, 1]) & ~placed).any():
        raise MapError(f"{path} has heights whose place is missing: give every height its distance, or leave it out")
    description = "\n".join(line for line in above if line.strip())[:LONGEST]
    return found[placed, 0], finite_or_missing(found[placed, 1]), description


def _numeric_columns(lines: list[str], layout: _Layout) -> list[int]:
    """Return which columns hold numbers, by the first rows."""
    rows = [_cells(line, layout.separator, layout.columns) for line in lines[layout.first :] if line.strip()]
    kind = COMMA if layout.comma else NUMBER
    return [
        column
        for column in range(layout.columns)
        if any(kind.fullmatch(row[column]) for row in rows if column < len(row))
    ]


def _slice_columns(
    path: Path, names: list[str], columns: tuple[str | None, str | None], numeric: list[int]
) -> tuple[int, int]:
    """Return where distance and height stand: as they are asked for, else as their names say, else in this order."""
    listed = ", ".join(repr(name) for name in names)[:200]
    counted = ", ".join(repr(names[at]) for at in numeric)[:200]
    places: dict[str, int] = {}
    for what, wanted in zip(ROLES, columns, strict=True):
        if wanted is not None:
            places[what] = _column_of(path, names, listed, numeric, what, wanted)
    rest = [at for at in numeric if at not in places.values()]
    free = [what for what in ROLES if what not in places]
    if len(rest) != len(free) and free:
        raise MapError(
            f"{path} has {len(numeric)} columns of numbers, {counted}, distance and height are 2: name both, as in "
            "distance='X', height='Z'"
        )
    if len(free) == 2 and not all(_says(names[at], what) for at, what in zip(rest, free, strict=True)):
        rest.reverse()
    for at, what in zip(rest, free, strict=False):
        if not _says(names[at], what):
            raise MapError(
                f"{path} has the columns {listed}, and {names[at]!r} is no {what} by its name: name the column of the "
                f"{what}, as in {what}='{'X' if what == 'distance' else 'Z'}'"
            )
        places[what] = at
    if places["distance"] == places["height"]:
        raise MapError(f"{path} has one column for distance and height, {names[places['height']]!r}: name two")
    return places["distance"], places["height"]


def _column_of(path: Path, names: list[str], listed: str, numeric: list[int], what: str, wanted: str) -> int:
    """Return the column that is asked for by its name or number."""
    spelled = wanted.strip().lower()
    matches = [at for at, name in enumerate(names) if spelled in (name.lower(), _split_cell(name)[0])]
    if not matches and wanted.isdigit() and 1 <= int(wanted) <= len(names):
        matches = [int(wanted) - 1]
    if len(matches) != 1:
        raise MapError(
            f"{path} has {len(matches)} columns {wanted!r} for the {what}, its columns are {listed}: name one of them"
        )
    if matches[0] not in numeric:
        raise MapError(
            f"{path} has no numbers in the column {wanted!r} for the {what}, its columns are {listed}: name another"
        )
    return matches[0]


def _says(name: str, what: str) -> bool:
    """Return whether the name of a column allows that it holds distances, or heights."""
    plain = _split_cell(name)[0]
    other = ROLES["height" if what == "distance" else "distance"]
    return not (NO_LENGTH.fullmatch(plain) or other.fullmatch(plain))


def _body(text: str, layout: _Layout) -> str:
    """Return the text from the first row of the table on."""
    begin = 0
    for _ in range(layout.first):
        begin = text.index("\n", begin) + 1
    return text[begin:]


def _crossed(lines: list[str], layout: _Layout) -> tuple[int, list[str]] | None:
    """Return the line that holds x, and its cells, where rows of heights begin with their y."""
    kind = COMMA if layout.comma else NUMBER
    for number in (layout.first, layout.first - 1):
        cells = _cells(lines[number], layout.separator, layout.columns) if number >= 0 else []
        if not len(cells) == layout.columns >= CROSSED or not all(map(kind.fullmatch, cells[1:])):
            continue
        # A word for a missing number is one of a table of heights without axes.
        if not cells[0] or not (kind.fullmatch(cells[0]) or MISSING.fullmatch(cells[0])):
            return number, cells[1:]
    return None


def _read_crossed(
    path: Path,
    text: str,
    layout: _Layout,
    crossed: tuple[int, list[str]],
    stated: dict[str, set[str]],
    units: tuple[str | None, str | None, str | None],
) -> HeightMap:
    """Read a table with x in its first row and y in its first column."""
    number, cells = crossed
    unit, lateral_unit, rest = units
    found_units = {axis: _unit(path, {}, stated, axis, lateral_unit, rest) for axis in "xy"}
    found_units["z"] = _unit(path, {}, stated, "z", unit)
    scales = {axis: scale for axis, scale in found_units.items() if scale is not None}
    if len(scales) < len(found_units):
        raise MapError(f"{path} counts pixels where a length is needed: x, y and z must have lengths")
    x = np.array([float(cell.replace(",", ".") if layout.comma else cell) for cell in cells])
    begin = 0
    for _ in range(number + 1):
        begin = text.find("\n", begin) + 1 or len(text)
    found = _table(path, text[begin:], replace(layout, first=number + 1), None)
    y, z = found[:, 0], found[:, 1:]
    require_points(path, x.size, y.size)
    if x.size != z.shape[1]:
        raise MapError(
            f"{path} has {x.size} columns of x and {z.shape[1]} of heights, there must be as many: complete it"
        )
    axes = []
    for name, axis in (("x", x), ("y", y)):
        step = np.diff(axis)
        if not ((step > 0).all() or (step < 0).all()):
            raise MapError(f"{path} has {name} that neither ascend nor descend from {name} to {name}: sort the table")
        axes.append(np.argsort(axis))
    z = z[np.ix_(axes[1], axes[0])] * scales["z"]
    return HeightMap(
        x=x[axes[0]] * scales["x"], y=y[axes[1]] * scales["y"], z=finite_or_missing(z), name=path.name,
        metadata={"format": "text"},
    )  # fmt: skip


def _as_map(
    path: Path, found: dict[str, Floats], scales: dict[str, float | None], metadata: dict[str, str]
) -> HeightMap:
    """Return points as a grid where they stand on one, in mm."""
    x, z = found["x"], found["z"]
    y = found.get("y", np.zeros_like(x))
    pixels = scales["x"] is None
    if scales["z"] is None or pixels != (scales.get("y", scales["x"]) is None):
        raise MapError(f"{path} counts pixels where a length is needed: only x and y together may, never z")
    placed = np.isfinite(x) & np.isfinite(y)
    if not placed.any() or (np.isfinite(z) & ~placed).any():
        raise MapError(f"{path} has heights whose place is missing: give every height its x and y, or leave it out")
    x, y, z = x[placed], y[placed], finite_or_missing(z[placed] * scales["z"])
    lattice = on_lattice(x, y)
    along_x, along_y = scales["x"] or 1.0, (scales["y"] or 1.0) if "y" in scales else 1.0
    if lattice is None:
        if pixels:
            raise MapError(f"{path} counts pixels in x and y that stand on no grid: give lengths")
        return HeightMap(x=x * along_x, y=y * along_y, z=z, name=path.name, metadata=metadata)
    require_points(path, lattice.x.size, lattice.y.size)
    heights = np.full((lattice.y.size, lattice.x.size), np.nan)
    heights[lattice.row, lattice.column] = z
    if pixels:
        # Rows of pixels are counted from the top.
        return grid_map(path, heights[::-1], None, metadata=metadata)
    return HeightMap(z=heights, x=lattice.x * along_x, y=lattice.y * along_y, name=path.name, metadata=metadata)


# ------------------------------------------------------------------ how it is written
def _first_lines(text: str) -> list[str]:
    """Return the lines in which a table must begin."""
    lines: list[str] = []
    begin = 0
    while begin < len(text) and len(lines) < MOST_LINES + 20:
        end = text.find("\n", begin)
        end = len(text) if end < 0 else end
        lines.append(text[begin:end].rstrip("\r"))
        begin = end + 1
    return lines


def _layout(path: Path, lines: list[str]) -> _Layout:
    """Find where the table begins and how it is written."""
    for first, line in enumerate(lines[:MOST_LINES]):
        if not line.strip() or line.lstrip()[0] in MARKS:
            continue
        some = [one for one in lines[first:] if one.strip() and one.lstrip()[0] not in MARKS][: ALIKE + 17]
        above = next((one for one in reversed(lines[:first]) if one.strip()), "")
        widths = [(*way, _width(some, above, way[0])) for way in _ways(some)]
        ways = [(*way, agreed == ALL) for way in widths if (agreed := _agree(some, *way))]
        # A way in which all is numbers is meant before one in which some is not.
        ways = [way for way in ways if way[-1]] or ways
        if len(ways) > 1 or (
            not ways and len(re.findall(r"\d+", line)) > 2 and "," in line and ONLY_NUMBERS.fullmatch(line)
        ):
            raise MapError(
                f"{path} can be read in more than one way from line {first + 1}, {line.strip()[:60]!r}, for commas may "
                "part numbers, decimals or thousands: write decimal points, or part the columns by semicolons"
            )
        if ways:
            separator, comma, width, numeric = ways[0]
            return _Layout(first, separator, comma, width, numeric)
        if ONLY_NUMBERS.fullmatch(line) and len(line.split()) > 1:
            raise MapError(
                f"{path} has the numbers {line.strip()[:60]!r} in line {first + 1}, unlike the lines below: every line "
                "must have the same columns, or be marked as a remark with #"
            )
    raise MapError(
        f"{path} has no table of numbers within its first {MOST_LINES} lines: it holds no map, or is no text"
    )


def _ways(lines: list[str]) -> list[tuple[str | None, bool]]:
    """Return the separators that can be meant, with and without decimal commas."""
    joined = "".join(lines)
    for strong in ";\t":
        if strong in joined:
            return [(strong, False), (strong, True)] if "," in joined else [(strong, False)]
    if "," not in joined:
        return [(None, False)]
    return [(",", False), (None, True)]


def _cells(line: str, separator: str | None, width: int = 1) -> list[str]:
    """Return the cells of a line; what follows a separator at its end is one only up to the width of the table."""
    cells = [cell.strip().strip('"').strip() for cell in line.split(separator)]
    if separator is not None and len(cells) > width and not cells[-1]:
        cells.pop()
    return cells


def _width(lines: list[str], above: str, separator: str | None) -> int:
    """Return how many columns the first rows have: the last may be empty in some, or in all below a name."""
    width = max(len(_cells(line, separator)) for line in lines[:ALIKE])
    names = len(_cells(above, separator))
    every = all(len(_cells(line, separator, names)) == names for line in lines[:ALIKE])
    return names if names == width + 1 and every else width


def _agree(lines: list[str], separator: str | None, comma: bool, width: int) -> int:
    """Return how well lines read as a table: ALL numbers, SOME of them with the first column, or not at all (0)."""
    rows = [_cells(line, separator, width) for line in lines[:ALIKE]]
    kind = COMMA if comma else NUMBER
    if width < 2 or any(len(row) != width for row in rows) or not any(kind.fullmatch(cell) for cell in rows[0]):
        return 0
    numeric = [
        all(kind.fullmatch(cell) or MISSING.fullmatch(cell) for cell in column) for column in zip(*rows, strict=True)
    ]
    if not (numeric[0] and sum(numeric) >= 2):
        return 0
    cells = [cell for line in lines for cell in _cells(line, separator, width)]
    if comma:
        # Where each comma could part thousands, nothing says that it is a decimal sign.
        marked = [cell for cell in cells if "," in cell]
        clear = not marked or not all(GROUPED.fullmatch(cell) for cell in marked)
    else:
        # Whole numbers between commas are as well decimals, if they are even in number.
        clear = separator != "," or width % 2 == 1 or any("." in cell or "e" in cell.lower() for cell in cells)
    return (ALL if all(numeric) else SOME) if clear else 0


def _table(path: Path, body: str, layout: _Layout, columns: tuple[int, ...] | None) -> Floats:
    """Return the columns of the table, or all; missing numbers are nan."""
    if layout.numeric and columns is not None:
        # All columns are read, for then no line may have more of them.
        return _table(path, body, layout, None)[:, columns]
    body = body.replace(",", ".") if layout.comma else body
    for mark in "%!":
        body = body.replace(f"\n{mark}", "\n#")
    try:
        return table(path, body, layout.separator, columns, layout.first + 1)
    except MapError:
        # Words for missing numbers are put right only where there are some.
        separator = layout.separator
        if separator is None:
            body = re.sub(r"(?i)(?<!\S)(?:no data|nodata|bad|n/?a|null|\*+|-{2,})(?!\S)", "nan", body)
        else:
            part = re.escape(separator)
            word = r"[ \"]*(?:no ?data|bad|n/?a|null|\*+|-{2,})[ \"]*"
            body = re.sub(rf"(?im)(?:(?<={part})|^){word}(?={part}|\r?$)", "nan", body)
            # A cell with nothing in it; a line with nothing in it is none.
            body = re.sub(rf"(?m)(?<={part})[ \"]*(?={part}|\r?$)|^[ \"]*(?={part})", "nan", body)
        return table(path, body, separator, columns, layout.first + 1)


# ------------------------------------------------------------------ what it means
def _names(above: list[str], layout: _Layout) -> list[str] | None:
    """Return the cells of the line of names above the table, if it has one."""
    for line in reversed(above):
        plain = line.strip().lstrip(MARKS).strip()
        # A row of numbers that is too short for the table, or a rule, is none of names.
        values = all(NUMBER.fullmatch(cell) or MISSING.fullmatch(cell) for cell in _cells(plain, layout.separator))
        if values or STATED.search(line):
            continue
        for separator in (layout.separator, ",", ";", "\t", None):
            # A unit belongs to the name before it, also where white space parts the names.
            joined = re.sub(r"(?<!\s)\s++(?=[\[(/])", "", plain) if separator is None else plain
            cells = _cells(joined, separator, layout.columns)
            if len(cells) == layout.columns and not any(NUMBER.fullmatch(cell) for cell in cells):
                return cells
        return None
    return None


def _split_cell(cell: str) -> tuple[str, str]:
    """Return name and unit of a column."""
    found = CELL.fullmatch(" ".join(cell.split()))  # blanks in a row would be tried again and again
    if found is None:
        return cell.lower(), ""
    return found[1].lower(), (found[2] or found[3] or "")


def _axis(cell: str) -> str | None:
    name = _split_cell(cell)[0]
    return next((axis for axis, spelled in NAMES.items() if spelled.fullmatch(name)), None)


def _columns(path: Path, names: list[str] | None, width: int, numeric: list[int]) -> dict[str, int] | None:
    """Return where x, y and z stand; nothing for a bare table of heights."""
    axes = [_axis(cell) for cell in names or []]
    places = {axis: axes.index(axis) for axis in "xyz" if axis in axes}
    twice = [axis for axis in "xyz" if axes.count(axis) > 1]
    if twice:
        raise MapError(f"{path} has {axes.count(twice[0])} columns {twice[0]}, the limit is 1: name them apart")
    if places.keys() == {"x", "y", "z"} or (places.keys() == {"x", "z"} and width == 2):
        return places
    if names is not None and places:
        raise MapError(
            f"{path} names its columns {', '.join(names)}, x, y and z (or x and z alone) are needed: name them so"
            + _as_profile(names, numeric)
        )
    if width == 3:
        return {"x": 0, "y": 1, "z": 2}
    if width > BARE:
        return None
    raise MapError(
        f"{path} has {width} columns without names, x, y and z are 3, and a table of heights has more than {BARE}: "
        "name the columns in the line above them"
    )


def _as_profile(names: list[str], numeric: list[int]) -> str:
    """Return the advice to read columns as a profile, if one is a distance and another can be a height."""
    distance = [at for at in numeric if ROLES["distance"].fullmatch(_split_cell(names[at])[0])]
    height = [at for at in numeric if at not in distance and _says(names[at], "height")]
    if not distance or not height:
        return ""
    return f", or read a profile (show --profile --height {quote(names[height[-1]])}, read_profile in Python)"


def _column_units(above: list[str], layout: _Layout) -> dict[str, str]:
    names = _names(above, layout)
    return {axis: _split_cell(cell)[1] for cell in names or [] if (axis := _axis(cell)) and _split_cell(cell)[1]}


def _stated(above: list[str]) -> dict[str, set[str]]:
    """Return the units that lines of description state, by axis."""
    stated: dict[str, set[str]] = {"x": set(), "y": set(), "z": set()}
    for found in STATED.finditer("\n".join(above)):
        what = re.sub(r"[^a-z]", "", (found[1] or found[2] or "xyz").lower())
        axes = {"lateral": "xy", "height": "z", "heights": "z"}.get(what, what)
        for axis in axes:
            stated[axis].add(found[3])
    return stated


def _unit(
    path: Path, columns: dict[str, str], stated: dict[str, set[str]], axis: str, given: str | None,
    rest: str | None = None,
) -> float | None:  # fmt: skip
    """Return the unit of an axis in mm, or nothing if it counts pixels; ``rest`` is for what nothing else states."""
    names = {columns[axis]} if axis in columns else stated[axis]
    if len({_spelled(one) for one in names}) > 1:
        raise MapError(f"{path} states the units {', '.join(sorted(names))} for {axis}, the limit is 1: state one")
    if names and given is not None and _spelled(given) not in map(_spelled, names):
        whose, option = ("its heights", "unit") if axis == "z" else (axis, "lateral_unit")
        raise MapError(f"{path} states the unit of {whose}, {next(iter(names))}: do not give {option}={given!r}")
    unit = next(iter(names), given or rest)
    if unit is None:
        raise MapError(f"{path} does not state the unit of {axis}: give it as unit='mm', or as a column '{axis} [mm]'")
    return None if unit.lower() in PIXELS else to_mm(unit, f"{path} has {axis} in")


def _spelled(unit: str) -> str:
    return SPELLINGS.get(unit.strip().lower(), unit.strip().lower())
