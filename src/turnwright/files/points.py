"""Text and CSV: points x, y, z in rows, which become a grid if they lie on one; or a table of heights.

Separator and decimal sign are detected from the rows, and refused where two readings are possible; names and units of
the columns are read from the description above the rows. Points on a grid become a map with nan where points are
missing. A table of heights has x in its first row, after an empty cell or a word, and y in its first column; without
axes it has more than eight columns, no names, and its first row at the top of the picture.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import MapError
from turnwright.files.base import SPELLINGS, finite_or_missing, grid_map, require_points, to_mm
from turnwright.files.lattice import on_lattice
from turnwright.files.numbers import table
from turnwright.heightmap import HeightMap

__all__ = ["read", "read_slice"]

MAX_DESCRIPTION_LINES = 300
"""Lines of description above the table."""

MIN_EQUAL_ROWS = 3
"""Consecutive rows with equal columns at the beginning of a table."""

PARTLY_NUMERIC, ALL_NUMERIC = 1, 2
"""Readings of lines as a table."""

MIN_AXES_COLUMNS = 4
"""Columns of a table with x in its first row and y in its first column: three of heights."""

MAX_POINT_COLUMNS = 8
"""A table without names and with more columns is a grid of heights; with fewer it may be a list of points."""

MAX_DESCRIPTION_CHARACTERS = 2000
"""Characters of the description in the metadata."""

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
COMMA = re.compile(r"[+-]?(?:\d*,\d+|\d+)(?:[eE][+-]?\d+)?")
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
ONLY_NUMBERS = re.compile(r"\s*[-+\d.,][-+\d.,;eE\s]*")
MISSING = re.compile(r"(?i)nan|[+-]?inf(?:inity)?|no ?data|bad|n/?a|null|\*+|-{2,}|")
MARKS = "#%!;/"
"""Characters that mark a line of description."""

NAMES = {
    "x": re.compile(r"x([ _-]?(pos(ition)?|coord(inate)?|axis|value))?"),
    "y": re.compile(r"y([ _-]?(pos(ition)?|coord(inate)?|axis|value))?"),
    "z": re.compile(r"z([ _-]?(pos(ition)?|coord(inate)?|axis|value))?|heights?|sag|elevation"),
}
ROLES = {
    "distance": re.compile(rf"{NAMES['x'].pattern}|dist(ance)?|pos(ition)?|lateral|abscissa|scan|along"),
    "height": re.compile(rf"{NAMES['z'].pattern}|h|profile|deviation|topography"),
}
"""Names of the columns of a profile; a column named y may be either."""

NO_LENGTH = re.compile(r"slopes?\b.*|(local )?(gradient|angle|tilt|curvature)s?|dz[ /]?dx")
"""Names of columns that are neither distances nor heights."""

UNIT = "|".join(sorted(map(re.escape, SPELLINGS), key=len, reverse=True)) + "|px|pixels?"
CELL = re.compile(rf"(?i)\s*(.*?)\s*(?:[\[(/_,]\s*({UNIT})\s*[\])]?|\s({UNIT}))?\s*")
STATED = re.compile(
    rf"(?i)\b(?:(x[ /,&-]*y|lateral|x|y|z|heights?)[ _-]*)?units?\b(?:\s+of\s+(x|y|z|heights?))?\W{{1,4}}({UNIT})\b"
)
PIXELS = frozenset({"px", "pixel", "pixels"})


@dataclass(frozen=True, slots=True)
class _Layout:
    first: int  # first line, from 0
    separator: str | None  # None: white space
    comma: bool  # decimal commas
    columns: int
    numeric: bool  # whether every column is


def read(path: Path, text: str, unit: str | None, lateral_unit: str | None) -> HeightMap:
    """Read text; the units are for numbers without a unit in the text."""
    lines = _first_lines(text)
    layout = _layout(path, lines)
    # With an empty lateral unit, that of the heights is not used for x and y.
    default_unit = unit if lateral_unit is None else None
    lateral_unit = lateral_unit or None
    x_row = _x_row(lines, layout)
    if x_row is not None:
        units = (unit, lateral_unit, default_unit)
        return _read_with_axes(path, text, layout, x_row, _find_stated_units(lines[: x_row[0]]), units)
    above = lines[: layout.first]
    names = _names(above, layout)
    chosen = _columns(path, names, layout.columns, _numeric_columns(lines, layout))
    body = _below(text, layout.first)
    metadata = {
        "format": "text",
        "description": "\n".join(line for line in above if line.strip())[:MAX_DESCRIPTION_CHARACTERS],
    }
    if chosen is None:
        scale = _unit(path, {}, _find_stated_units(above), "z", unit)
        if scale is None:
            raise MapError(f"{path} has heights in pixels, they must be lengths: give their unit")
        heights = _table(path, body, layout, None)
        require_points(path, heights.shape[1], heights.shape[0])
        return grid_map(path, heights[::-1] * scale, None, metadata=metadata)
    column_units = {
        axis: _split_cell(cell)[1] for cell in names or [] if (axis := _axis(cell)) and _split_cell(cell)[1]
    }
    stated = _find_stated_units(above)
    options = {"x": (lateral_unit, default_unit), "y": (lateral_unit, default_unit), "z": (unit, None)}
    scales = {axis: _unit(path, column_units, stated, axis, *options[axis]) for axis in chosen}
    columns = _table(path, body, layout, tuple(chosen.values())).T
    return _to_map(path, dict(zip(chosen, columns, strict=True)), scales, metadata)


def read_slice(
    path: Path, text: str, columns: tuple[str | None, str | None], unit: str | None, lateral_unit: str | None
) -> tuple[Floats, Floats, str]:
    """Return distances and heights of a text's rows in mm, missing ones nan, and its description. Each (n,).

    ``columns`` are names or numbers (from 1) of the columns of distance and height, ``None`` to detect them; the units
    are those of the heights, and of the distances if different, where the text has none.
    """
    lines = _first_lines(text)
    layout = _layout(path, lines)
    above = lines[: layout.first]
    names = _names(above, layout) or [str(number + 1) for number in range(layout.columns)]
    chosen = _slice_columns(path, names, columns, _numeric_columns(lines, layout))
    column_units = {
        axis: symbol for axis, at in zip("xz", chosen, strict=True) if (symbol := _split_cell(names[at])[1])
    }
    scales = []
    for axis, option, default in (("x", lateral_unit, unit), ("z", unit, None)):
        scale = _unit(path, column_units, _find_stated_units(above), axis, option, default)
        if scale is None:
            raise MapError(f"{path} is in pixels, a profile needs lengths: export it calibrated")
        scales.append(scale)
    distance, height = (_table(path, _below(text, layout.first), layout, chosen) * scales).T
    has_place = np.isfinite(distance)
    if (np.isfinite(height) & ~has_place).any():
        raise MapError(f"{path} has heights without a distance: complete or remove them")
    description = "\n".join(line for line in above if line.strip())[:MAX_DESCRIPTION_CHARACTERS]
    return distance[has_place], finite_or_missing(height[has_place]), description


def _numeric_columns(lines: list[str], layout: _Layout) -> list[int]:
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
    """Return the columns of distance and height: as requested, else by their names, else in this order."""
    listed = ", ".join(repr(name) for name in names)[:200]
    listed_numeric = ", ".join(repr(names[at]) for at in numeric)[:200]
    places: dict[str, int] = {}
    for what, column in zip(ROLES, columns, strict=True):
        if column is not None:
            places[what] = _column_of(path, names, listed, numeric, what, column)
    unused = [at for at in numeric if at not in places.values()]
    missing = [what for what in ROLES if what not in places]
    if len(unused) != len(missing) and missing:
        raise MapError(
            f"{path} has {len(numeric)} columns of numbers, {listed_numeric}, a profile has 2: name distance and "
            "height, as in distance='X', height='Z'"
        )
    if len(missing) == 2 and not all(_allows(names[at], what) for at, what in zip(unused, missing, strict=True)):
        unused.reverse()
    for at, what in zip(unused, missing, strict=False):
        if not _allows(names[at], what):
            raise MapError(
                f"{path} has the columns {listed}, and {names[at]!r} is not the name of a {what}: name the column of "
                f"the {what}, as in {what}='{'X' if what == 'distance' else 'Z'}'"
            )
        places[what] = at
    if places["distance"] == places["height"]:
        raise MapError(f"{path} has one column for distance and height, {names[places['height']]!r}: name two")
    return places["distance"], places["height"]


def _column_of(path: Path, names: list[str], listed: str, numeric: list[int], what: str, column: str) -> int:
    spelled = column.strip().lower()
    matches = [at for at, name in enumerate(names) if spelled in (name.lower(), _split_cell(name)[0])]
    if not matches and column.isdigit() and 1 <= int(column) <= len(names):
        matches = [int(column) - 1]
    if len(matches) != 1:
        raise MapError(
            f"{path} has {len(matches)} columns {column!r} for the {what}, its columns are {listed}: name one of them"
        )
    if matches[0] not in numeric:
        raise MapError(
            f"{path} has no numbers in the column {column!r} for the {what}, its columns are {listed}: name another"
        )
    return matches[0]


def _allows(name: str, what: str) -> bool:
    plain = _split_cell(name)[0]
    other = ROLES["height" if what == "distance" else "distance"]
    return not (NO_LENGTH.fullmatch(plain) or other.fullmatch(plain))


def _below(text: str, lines: int) -> str:
    return "".join(text.split("\n", lines)[lines:])


def _x_row(lines: list[str], layout: _Layout) -> tuple[int, list[str]] | None:
    """Return the number and cells of the row of x, for a table with y in its first column."""
    kind = COMMA if layout.comma else NUMBER
    for number in (layout.first, layout.first - 1):
        cells = _cells(lines[number], layout.separator, layout.columns) if number >= 0 else []
        if not len(cells) == layout.columns >= MIN_AXES_COLUMNS or not all(map(kind.fullmatch, cells[1:])):
            continue
        # A word for a missing number belongs to a table of heights without axes.
        if not cells[0] or not (kind.fullmatch(cells[0]) or MISSING.fullmatch(cells[0])):
            return number, cells[1:]
    return None


def _read_with_axes(
    path: Path,
    text: str,
    layout: _Layout,
    x_row: tuple[int, list[str]],
    stated: dict[str, set[str]],
    units: tuple[str | None, str | None, str | None],
) -> HeightMap:
    number, cells = x_row
    unit, lateral_unit, default_unit = units
    axis_units = {axis: _unit(path, {}, stated, axis, lateral_unit, default_unit) for axis in "xy"}
    axis_units["z"] = _unit(path, {}, stated, "z", unit)
    scales = {axis: scale for axis, scale in axis_units.items() if scale is not None}
    if len(scales) < len(axis_units):
        raise MapError(f"{path} is in pixels, x, y and z must be lengths: give their units")
    x = np.array([float(cell.replace(",", ".") if layout.comma else cell) for cell in cells])
    rows = _table(path, _below(text, number + 1), replace(layout, first=number + 1), None)
    y, z = rows[:, 0], rows[:, 1:]
    require_points(path, x.size, y.size)
    if x.size != z.shape[1]:
        raise MapError(
            f"{path} has {x.size} columns of x and {z.shape[1]} of heights, they must be equal in number: complete it"
        )
    axes = []
    for name, axis in (("x", x), ("y", y)):
        step = np.diff(axis)
        if not ((step > 0).all() or (step < 0).all()):
            raise MapError(f"{path} has values of {name} that neither ascend nor descend: sort the table")
        axes.append(np.argsort(axis))
    z = z[np.ix_(axes[1], axes[0])] * scales["z"]
    return HeightMap(
        x=x[axes[0]] * scales["x"], y=y[axes[1]] * scales["y"], z=finite_or_missing(z), name=path.name,
        metadata={"format": "text"},
    )  # fmt: skip


def _to_map(
    path: Path, columns: dict[str, Floats], scales: dict[str, float | None], metadata: dict[str, str]
) -> HeightMap:
    """Return points as a grid where they lie on one, in mm."""
    x, z = columns["x"], columns["z"]
    y = columns.get("y", np.zeros_like(x))
    pixels = scales["x"] is None
    if scales["z"] is None or pixels != (scales.get("y", scales["x"]) is None):
        raise MapError(f"{path} has an axis in pixels, only x and y together may be: give the other units as lengths")
    has_place = np.isfinite(x) & np.isfinite(y)
    if not has_place.any() or (np.isfinite(z) & ~has_place).any():
        raise MapError(f"{path} has heights without x or y: complete or remove them")
    x, y, z = x[has_place], y[has_place], finite_or_missing(z[has_place] * scales["z"])
    lattice = on_lattice(x, y)
    along_x, along_y = scales["x"] or 1.0, (scales["y"] or 1.0) if "y" in scales else 1.0
    if lattice is None:
        if pixels:
            raise MapError(f"{path} has x and y in pixels that are not on a grid: give lengths")
        return HeightMap(x=x * along_x, y=y * along_y, z=z, name=path.name, metadata=metadata)
    require_points(path, lattice.x.size, lattice.y.size)
    heights = np.full((lattice.y.size, lattice.x.size), np.nan)
    heights[lattice.row, lattice.column] = z
    if pixels:
        # Rows of pixels are counted from the top.
        return grid_map(path, heights[::-1], None, metadata=metadata)
    return HeightMap(z=heights, x=lattice.x * along_x, y=lattice.y * along_y, name=path.name, metadata=metadata)


# ------------------------------------------------------------------ format of the table
def _first_lines(text: str) -> list[str]:
    count = MAX_DESCRIPTION_LINES + 20
    return [line.rstrip("\r") for line in text.split("\n", count)[:count]]


def _layout(path: Path, lines: list[str]) -> _Layout:
    for first, line in enumerate(lines[:MAX_DESCRIPTION_LINES]):
        if not line.strip() or line.lstrip()[0] in MARKS:
            continue
        rows = [row for row in lines[first:] if row.strip() and row.lstrip()[0] not in MARKS][: MIN_EQUAL_ROWS + 17]
        above = next((row for row in reversed(lines[:first]) if row.strip()), "")
        candidates = [(*form, _width(rows, above, form[0])) for form in _formats(rows)]
        formats = [(*form, match == ALL_NUMERIC) for form in candidates if (match := _match(rows, *form))]
        # Formats in which every cell is a number are preferred.
        formats = [form for form in formats if form[-1]] or formats
        if len(formats) > 1 or (
            not formats and len(re.findall(r"\d+", line)) > 2 and "," in line and ONLY_NUMBERS.fullmatch(line)
        ):
            raise MapError(
                f"{path} is ambiguous from line {first + 1}, {line.strip()[:60]!r}, as commas may separate numbers, "
                "decimals or thousands: write decimal points, or separate the columns by semicolons"
            )
        if formats:
            separator, comma, width, numeric = formats[0]
            return _Layout(first, separator, comma, width, numeric)
        if ONLY_NUMBERS.fullmatch(line) and len(line.split()) > 1:
            raise MapError(
                f"{path} has the numbers {line.strip()[:60]!r} in line {first + 1}, unlike the lines below: every line "
                "must have the same columns, or be marked as a comment with #"
            )
    raise MapError(
        f"{path} has no table of numbers within its first {MAX_DESCRIPTION_LINES} lines: it is not a map, or not text"
    )


def _formats(lines: list[str]) -> list[tuple[str | None, bool]]:
    joined = "".join(lines)
    for strong in ";\t":
        if strong in joined:
            return [(strong, False), (strong, True)] if "," in joined else [(strong, False)]
    if "," not in joined:
        return [(None, False)]
    return [(",", False), (None, True)]


def _cells(line: str, separator: str | None, width: int = 1) -> list[str]:
    """Return the cells of a line; an empty cell after a final separator counts only within the width of the table."""
    cells = [cell.strip().strip('"').strip() for cell in line.split(separator)]
    if separator is not None and len(cells) > width and not cells[-1]:
        cells.pop()
    return cells


def _width(lines: list[str], above: str, separator: str | None) -> int:
    """Return the number of columns of the first rows; the last column may be empty if it has a name."""
    width = max(len(_cells(line, separator)) for line in lines[:MIN_EQUAL_ROWS])
    names = len(_cells(above, separator))
    every = all(len(_cells(line, separator, names)) == names for line in lines[:MIN_EQUAL_ROWS])
    return names if names == width + 1 and every else width


def _match(lines: list[str], separator: str | None, comma: bool, width: int) -> int:
    """Return whether lines are a table: `ALL_NUMERIC`, `PARTLY_NUMERIC` with a numeric first column, or 0 for no."""
    rows = [_cells(line, separator, width) for line in lines[:MIN_EQUAL_ROWS]]
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
        # Where each comma could separate thousands, it need not be a decimal sign.
        marked = [cell for cell in cells if "," in cell]
        clear = not marked or not all(GROUPED.fullmatch(cell) for cell in marked)
    else:
        # An even number of integers between commas may be decimals too.
        clear = separator != "," or width % 2 == 1 or any("." in cell or "e" in cell.lower() for cell in cells)
    return (ALL_NUMERIC if all(numeric) else PARTLY_NUMERIC) if clear else 0


def _table(path: Path, body: str, layout: _Layout, columns: tuple[int, ...] | None) -> Floats:
    if layout.numeric and columns is not None:
        # Reading all columns ensures that no line has more of them.
        return _table(path, body, layout, None)[:, columns]
    body = body.replace(",", ".") if layout.comma else body
    for mark in "%!":
        body = body.replace(f"\n{mark}", "\n#")
    try:
        return table(path, body, layout.separator, columns, layout.first + 1)
    except MapError:
        # Replace words for missing numbers, only where the plain table cannot be read.
        separator = layout.separator
        if separator is None:
            body = re.sub(r"(?i)(?<!\S)(?:no data|nodata|bad|n/?a|null|\*+|-{2,})(?!\S)", "nan", body)
        else:
            part = re.escape(separator)
            word = r"[ \"]*(?:no ?data|bad|n/?a|null|\*+|-{2,})[ \"]*"
            body = re.sub(rf"(?im)(?:(?<={part})|^){word}(?={part}|\r?$)", "nan", body)
            # An empty cell; an empty line is skipped.
            body = re.sub(rf"(?m)(?<={part})[ \"]*(?={part}|\r?$)|^[ \"]*(?={part})", "nan", body)
        return table(path, body, separator, columns, layout.first + 1)


# ------------------------------------------------------------------ names and units
def _names(above: list[str], layout: _Layout) -> list[str] | None:
    """Return the cells of the line of names above the table, if it has one."""
    for line in reversed(above):
        plain = line.strip().lstrip(MARKS).strip()
        # A row of numbers too short for the table, or a rule, has no names.
        values = all(NUMBER.fullmatch(cell) or MISSING.fullmatch(cell) for cell in _cells(plain, layout.separator))
        if values or STATED.search(line):
            continue
        for separator in (layout.separator, ",", ";", "\t", None):
            # A unit belongs to the name before it, also where white space separates the names.
            joined = re.sub(r"(?<!\s)\s++(?=[\[(/])", "", plain) if separator is None else plain
            cells = _cells(joined, separator, layout.columns)
            if len(cells) == layout.columns and not any(NUMBER.fullmatch(cell) for cell in cells):
                return cells
        return None
    return None


def _split_cell(cell: str) -> tuple[str, str]:
    """Return name and unit of a column."""
    match = CELL.fullmatch(" ".join(cell.split()))  # runs of blanks would cause backtracking
    if match is None:
        return cell.lower(), ""
    return match[1].lower(), (match[2] or match[3] or "")


def _axis(cell: str) -> str | None:
    name = _split_cell(cell)[0]
    return next((axis for axis, spelled in NAMES.items() if spelled.fullmatch(name)), None)


def _columns(path: Path, names: list[str] | None, width: int, numeric: list[int]) -> dict[str, int] | None:
    """Return the columns of x, y and z; ``None`` for a table of heights without axes."""
    axes = [_axis(cell) for cell in names or []]
    places = {axis: axes.index(axis) for axis in "xyz" if axis in axes}
    repeated = [axis for axis in "xyz" if axes.count(axis) > 1]
    if repeated:
        raise MapError(
            f"{path} has {axes.count(repeated[0])} columns {repeated[0]}, only 1 is allowed: rename the others"
        )
    if places.keys() == {"x", "y", "z"} or (places.keys() == {"x", "z"} and width == 2):
        return places
    if names is not None and places:
        raise MapError(
            f"{path} has the columns {', '.join(names)}, it needs x, y and z (or only x and z): rename them"
            + _profile_advice(names, numeric)
        )
    if width == 3:
        return {"x": 0, "y": 1, "z": 2}
    if width > MAX_POINT_COLUMNS:
        return None
    raise MapError(
        f"{path} has {width} columns without names, points have 3 and a table of heights has more than "
        f"{MAX_POINT_COLUMNS}: name the columns in the line above them"
    )


def _profile_advice(names: list[str], numeric: list[int]) -> str:
    """Return the advice to read columns as a profile, if one is a distance and another may be a height."""
    distance = [at for at in numeric if ROLES["distance"].fullmatch(_split_cell(names[at])[0])]
    height = [at for at in numeric if at not in distance and _allows(names[at], "height")]
    if not distance or not height:
        return ""
    return f", or read a profile (show --profile --height {shlex.quote(names[height[-1]])}, read_profile in Python)"


def _find_stated_units(above: list[str]) -> dict[str, set[str]]:
    stated: dict[str, set[str]] = {"x": set(), "y": set(), "z": set()}
    for match in STATED.finditer("\n".join(above)):
        what = re.sub(r"[^a-z]", "", (match[1] or match[2] or "xyz").lower())
        axes = {"lateral": "xy", "height": "z", "heights": "z"}.get(what, what)
        for axis in axes:
            stated[axis].add(match[3])
    return stated


def _unit(
    path: Path, columns: dict[str, str], stated: dict[str, set[str]], axis: str, option: str | None,
    default: str | None = None,
) -> float | None:  # fmt: skip
    """Return the unit of an axis in mm; ``None`` for pixels. ``option`` must not contradict the file."""
    names = {columns[axis]} if axis in columns else stated[axis]
    if len({_normalise_unit(name) for name in names}) > 1:
        raise MapError(f"{path} states the units {', '.join(sorted(names))} for {axis}, only 1 is allowed: state one")
    if names and option is not None and _normalise_unit(option) not in map(_normalise_unit, names):
        whose, keyword = ("its heights", "unit") if axis == "z" else (axis, "lateral_unit")
        raise MapError(f"{path} states the unit of {whose}, {next(iter(names))}: do not give {keyword}={option!r}")
    unit = next(iter(names), option or default)
    if unit is None:
        raise MapError(f"{path} does not state the unit of {axis}: give it as unit='mm', or as a column '{axis} [mm]'")
    return None if unit.lower() in PIXELS else to_mm(unit, f"{path} has {axis} in")


def _normalise_unit(unit: str) -> str:
    return SPELLINGS.get(unit.strip().lower(), unit.strip().lower())
