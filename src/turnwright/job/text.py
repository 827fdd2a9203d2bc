"""Edit the text of a job file: only changed keys are rewritten, comments and layout are preserved."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import Any

import tomli_w

from turnwright.errors import TurnwrightError, UnitError
from turnwright.job.schema import Job
from turnwright.units import parse

__all__ = ["as_tables", "edit_text", "name_files", "write_job"]

_LONE_END = re.compile(r"(?<!\r)\n")

MARK = "\N{BYTE ORDER MARK}"

SURFACE_KEYS = ("surface", "lenslet", "surround", "base", "parent")
MAX_DEPTH = 60

MAX_CHARACTERS = 2**20
"""Length of a text whose layout is preserved; parsing it takes about ten seconds."""


def as_tables(value: Any, depth: int = 0) -> Any:
    """Expand the short forms of a surface: a list becomes a sum, and a height a plane."""
    if depth > MAX_DEPTH:
        return value
    if isinstance(value, list):
        return [as_tables(one, depth + 1) for one in value]
    if not isinstance(value, dict):
        return value
    table = {key: as_tables(one, depth + 1) for key, one in value.items()}
    for key in SURFACE_KEYS:
        if isinstance(table.get(key), list):
            table[key] = {"family": "sum", "terms": table[key]}
    if "family" in table and isinstance(table.get("surround"), str):
        table["surround"] = {"family": "plane", "placed": {"shift": ["0 mm", "0 mm", table["surround"]]}}
    return table


def write_job(data: Mapping[str, Any], before: str = "") -> str:
    """Return a job as TOML. Comments, order and layout of ``before``, its text before the change, are preserved."""
    wanted = as_tables(_drop_none(data))
    # Some notations cannot be changed in place: then the tables that differ are rewritten.
    for rewrite in (False, True) if 0 < len(before) <= MAX_CHARACTERS else ():
        from tomlkit.exceptions import TOMLKitError  # noqa: PLC0415 - only a text that is changed needs it

        with suppress(TOMLKitError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
            text = _change(before, wanted, rewrite=rewrite)
            if _equal(as_tables(tomllib.loads(text)), wanted):
                return text
    return tomli_w.dumps(wanted)


def edit_text(before: str, old: Job, new: Job, *, folder: Path, into: Path) -> str:
    """Return the text of a job file after a change of the job: only changed keys are set.

    A quantity keeps the unit that it was written in, where that gives the same number. Names of files stay as they are
    where ``into``, the folder of the new text, is that of ``before``, and become absolute paths in another; a file of
    the new job in that folder is written by its name alone, so that the folder can move.
    """
    table = tomllib.loads(before.removeprefix(MARK))
    into = into.resolve()
    if folder.resolve() != into:
        table = _with_absolute_paths(table, folder)
    was, now = (name_files(one.table(), into) for one in (old, new))
    for convert in (_keep_unit, lambda _value, new: new) if table else ():
        text = write_job(_merge_changes(table, was, now, convert), before)
        with suppress(TurnwrightError, tomllib.TOMLDecodeError):
            if Job.read(tomllib.loads(text), folder=into) == new:
                return MARK * before.startswith(MARK) + text
    return tomli_w.dumps(now)


def name_files(table: Any, folder: Path) -> Any:
    """Return a table in which the files of a folder have their names alone."""
    return _replace_texts(table, lambda text: Path(text).name if Path(text).parent == folder else text)


def _with_absolute_paths(value: Any, folder: Path) -> Any:
    def absolute(text: str) -> str:
        is_file = Path(text).suffix and os.path.isfile(folder / text)  # noqa: PTH113 - see `existing`
        return str((folder / text).resolve()) if is_file else text

    return _replace_texts(value, absolute)


def _replace_texts(value: Any, change: Callable[[str], str]) -> Any:
    if isinstance(value, dict):
        return {key: _replace_texts(one, change) for key, one in value.items()}
    if isinstance(value, list):
        return [_replace_texts(one, change) for one in value]
    return change(value) if isinstance(value, str) else value


def _merge_changes(value: Any, was: Any, now: Any, convert: Callable[[Any, Any], Any]) -> Any:
    """Return the data of a file with the differences between two versions of its job."""
    if was == now:
        return value
    if isinstance(value, dict) and isinstance(was, dict) and isinstance(now, dict):
        unchanged = {key: one for key, one in value.items() if key in now or key not in was}
        return unchanged | {
            key: _merge_changes(value.get(key), was.get(key), one, convert)
            for key, one in now.items()
            if one != was.get(key)
        }
    if all(isinstance(one, list) for one in (value, was, now)) and len(value) == len(was) == len(now):
        return [_merge_changes(*one, convert) for one in zip(value, was, now, strict=True)]
    return convert(value, now)


def _keep_unit(value: Any, now: Any) -> Any:
    """Return a new quantity in the unit of the old one, if that gives the same number."""
    if not isinstance(value, str) or not isinstance(now, str):
        return now
    old_unit, unit = value.strip().partition(" ")[2].strip(), now.partition(" ")[2]
    with suppress(UnitError):
        if old_unit and unit:
            text = f"{parse(now, old_unit):.15g} {old_unit}"
            if parse(text, unit) == parse(now, unit):
                return text
    return now


def _change(before: str, wanted: dict[str, Any], *, rewrite: bool) -> str:
    import tomlkit  # noqa: PLC0415 - only a text that is changed needs it

    document = tomlkit.parse(before.removeprefix(MARK))
    has = tomllib.loads(document.as_string())
    if rewrite:
        for key in [key for key in has if key in wanted and not _equal(as_tables(has[key]), wanted[key])]:
            del document[key], has[key]
    _merge(document, has, wanted)
    text = document.as_string()
    return _LONE_END.sub("\r\n", text) if "\r\n" in before and not _LONE_END.search(before) else text


def _merge(place: Any, has: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Change a table of a text into the wanted one. ``has`` is its present content, as plain data."""
    for key in [key for key in has if key not in wanted]:
        del place[key]
    for key, value in wanted.items():
        if key not in has:
            place[key] = value
        elif not _equal(_expand(has, key), value):
            _replace(place, key, has[key], value)


def _expand(has: dict[str, Any], key: str) -> Any:
    """Return the value of a key of a table with short forms expanded."""
    family = {"family": has["family"]} if "family" in has else {}
    return as_tables({**family, key: has[key]})[key]


def _replace(place: Any, key: Any, has: Any, value: Any) -> None:
    """Change the value of a key, or an entry of a list, where it differs."""
    if isinstance(has, dict) and isinstance(value, dict):
        _merge(place[key], has, value)
    elif isinstance(has, list) and _is_sum(value):
        _replace(place, key, has, value["terms"])
    elif isinstance(has, list) and isinstance(value, list) and has and value:
        _change_list(place[key], has, value)
    else:
        place[key] = value


def _is_sum(value: Any) -> bool:
    """Whether a surface is a sum that a list of its terms can replace."""
    return isinstance(value, dict) and value.keys() == {"family", "terms"} and isinstance(value["terms"], list)


def _change_list(place: Any, has: list[Any], wanted: list[Any]) -> None:
    """Change a list; equal entries at its beginning and at its end are not touched."""
    old = [as_tables(one) for one in has]
    first = _count_common(old, wanted)
    last = _count_common(old[first:][::-1], wanted[first:][::-1])
    between, new = has[first : len(has) - last], wanted[first : len(wanted) - last]
    for number, (was, value) in enumerate(zip(between, new, strict=False), first):
        if not _equal(as_tables(was), value):
            _replace(place, number, was, value)
    for number in reversed(range(first + len(new), first + len(between))):
        del place[number]
    for number, value in enumerate(new[len(between) :], first + len(between)):
        place.insert(number, value)


def _count_common(old: list[Any], new: list[Any]) -> int:
    return sum(1 for _ in takewhile(lambda pair: _equal(*pair), zip(old, new, strict=False)))


def _drop_none(value: Any) -> Any:
    """Return data without values of ``None``, which TOML cannot write."""
    if isinstance(value, dict):
        return {key: _drop_none(one) for key, one in value.items() if one is not None}
    if isinstance(value, list):
        return [_drop_none(one) for one in value if one is not None]
    return value


def _equal(one: Any, other: Any) -> bool:
    """Whether two values are equal; 1 equals 1.0, since JavaScript does not distinguish them, but true is not 1."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(value, other[key]) for key, value in one.items())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_equal, one, other))
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)
