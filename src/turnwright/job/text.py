"""A job as the text that a person wrote: only what was changed is written anew, remarks and layout stay."""

from __future__ import annotations

import os
import re
import tomllib
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from turnwright.errors import TurnwrightError, UnitError
from turnwright.job.schema import Job
from turnwright.units import parse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["as_tables", "edited", "written"]

_LONE_END = re.compile(r"(?<!\r)\n")

MARK = "\N{BYTE ORDER MARK}"

SURFACES = ("surface", "lenslet", "surround", "base", "parent")
DEEPEST = 60

LONGEST = 2**20
"""Letters of a text whose layout is kept; reading them takes some ten seconds."""


def as_tables(value: Any, depth: int = 0) -> Any:
    """Write the short forms of a surface, a list for a sum and a height for a plane, as the tables they mean."""
    if depth > DEEPEST:
        return value
    if isinstance(value, list):
        return [as_tables(one, depth + 1) for one in value]
    if not isinstance(value, dict):
        return value
    found = {key: as_tables(one, depth + 1) for key, one in value.items()}
    for key in SURFACES:
        if isinstance(found.get(key), list):
            found[key] = {"family": "sum", "terms": found[key]}
    if "family" in found and isinstance(found.get("surround"), str):
        found["surround"] = {"family": "plane", "placed": {"shift": ["0 mm", "0 mm", found["surround"]]}}
    return found


def written(data: Mapping[str, Any], before: str = "") -> str:
    """Return a job as TOML.

    Parameters
    ----------
    data
        The job.
    before
        The text of the same job before it was changed, whose remarks, order and layout are kept.
    """
    wanted = as_tables(_stated(data))
    # A few ways of writing cannot be changed in their place: then the tables that differ are written anew.
    for whole in (False, True) if 0 < len(before) <= LONGEST else ():
        from tomlkit.exceptions import TOMLKitError  # noqa: PLC0415 - only a text that is changed needs it

        with suppress(TOMLKitError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
            found = _changed(before, wanted, whole=whole)
            if _same(as_tables(tomllib.loads(found)), wanted):
                return found
    return tomli_w.dumps(wanted)


def edited(before: str, old: Job, new: Job, *, folder: Path, into: Path) -> str:
    """Return the text of a job file after a change of the job: keys that changed are set, all else stays as it was.

    A quantity keeps the unit that it was written in, where that says the same number.

    Parameters
    ----------
    before
        The text of the file; if empty, all is written anew.
    old, new
        The job that it describes, and that after the change.
    folder
        Of the file, where the files that it names are looked for.
    into
        Folder that the new text is for. Names of files stay as they are in the same folder, and become whole paths in
        another; a file of the new job that lies there has its name alone, so that the folder can move.
    """
    table = tomllib.loads(before.removeprefix(MARK))
    into = into.resolve()
    if folder.resolve() != into:
        table = _with_whole_paths(table, folder)
    was, now = (_beside(one.table(), into) for one in (old, new))
    for quantities in (_in_its_unit, _as_it_is) if table else ():
        text = written(_carried(table, was, now, quantities), before)
        with suppress(TurnwrightError, tomllib.TOMLDecodeError):
            if Job.read(tomllib.loads(text), folder=into) == new:
                return MARK * before.startswith(MARK) + text
    return tomli_w.dumps(now)


def _beside(value: Any, folder: Path) -> Any:
    """Return data with the files that lie in a folder by their names alone."""
    if isinstance(value, dict):
        return {key: _beside(one, folder) for key, one in value.items()}
    if isinstance(value, list):
        return [_beside(one, folder) for one in value]
    if isinstance(value, str) and Path(value).parent == folder:
        return Path(value).name
    return value


def _with_whole_paths(value: Any, folder: Path) -> Any:
    """Return data with the names of files as whole paths."""
    if isinstance(value, dict):
        return {key: _with_whole_paths(one, folder) for key, one in value.items()}
    if isinstance(value, list):
        return [_with_whole_paths(one, folder) for one in value]
    if isinstance(value, str) and Path(value).suffix and os.path.isfile(folder / value):  # noqa: PTH113 - see `existing`
        return str((folder / value).resolve())
    return value


def _carried(value: Any, was: Any, now: Any, quantities: Callable[[Any, Any], Any]) -> Any:
    """Return the data of a file with what differs between two readings of it."""
    if was == now:
        return value
    if isinstance(value, dict) and isinstance(was, dict) and isinstance(now, dict):
        kept = {key: one for key, one in value.items() if key in now or key not in was}
        return kept | {
            key: _carried(value.get(key), was.get(key), one, quantities)
            for key, one in now.items()
            if one != was.get(key)
        }
    if (
        isinstance(value, list)
        and isinstance(was, list)
        and isinstance(now, list)
        and len(value) == len(was) == len(now)
    ):
        return [_carried(*one, quantities) for one in zip(value, was, now, strict=True)]
    return quantities(value, now)


def _as_it_is(_value: Any, now: Any) -> Any:
    return now


def _in_its_unit(value: Any, now: Any) -> Any:
    """Return a new quantity in the unit of the old one, if that is the same number."""
    if not isinstance(value, str) or not isinstance(now, str):
        return now
    own, unit = value.strip().partition(" ")[2].strip(), now.partition(" ")[2]
    with suppress(UnitError):
        if own and unit:
            text = f"{parse(now, own):.15g} {own}"
            if parse(text, unit) == parse(now, unit):
                return text
    return now


def _changed(before: str, wanted: dict[str, Any], *, whole: bool) -> str:
    import tomlkit  # noqa: PLC0415 - only a text that is changed needs it

    document = tomlkit.parse(before.removeprefix(MARK))
    has = tomllib.loads(document.as_string())
    if whole:
        for key in [key for key in has if key in wanted and not _same(as_tables(has[key]), wanted[key])]:
            del document[key], has[key]
    _merge(document, has, wanted)
    text = document.as_string()
    return _LONE_END.sub("\r\n", text) if "\r\n" in before and not _LONE_END.search(before) else text


def _merge(place: Any, has: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Change a table of a text into the wanted one. ``has`` is what it holds, as plain data."""
    for key in [key for key in has if key not in wanted]:
        del place[key]
    for key, value in wanted.items():
        if key not in has:
            place[key] = value
        elif not _same(_told(has, key), value):
            _replace(place, key, has[key], value)


def _told(has: dict[str, Any], key: str) -> Any:
    """Return what a key of a table means, short forms written out."""
    about = {"family": has["family"]} if "family" in has else {}
    return as_tables({**about, key: has[key]})[key]


def _replace(place: Any, key: Any, has: Any, value: Any) -> None:
    """Change what stands at a key, or at a number of a list, as far as it differs."""
    if isinstance(has, dict) and isinstance(value, dict):
        _merge(place[key], has, value)
    elif isinstance(has, list) and _is_sum(value):
        _replace(place, key, has, value["terms"])
    elif isinstance(has, list) and isinstance(value, list) and has and value:
        _change_list(place[key], has, value)
    else:
        place[key] = value


def _is_sum(value: Any) -> bool:
    """Whether a surface has a short form, a list of its terms."""
    return isinstance(value, dict) and value.keys() == {"family", "terms"} and isinstance(value["terms"], list)


def _change_list(place: Any, has: list[Any], wanted: list[Any]) -> None:
    """Change a list; what is the same at its beginning and at its end stays as it is."""
    old = [as_tables(one) for one in has]
    first = _alike(old, wanted)
    last = _alike(old[first:][::-1], wanted[first:][::-1])
    between, new = has[first : len(has) - last], wanted[first : len(wanted) - last]
    for number, (was, value) in enumerate(zip(between, new, strict=False), first):
        if not _same(as_tables(was), value):
            _replace(place, number, was, value)
    for number in reversed(range(first + len(new), first + len(between))):
        del place[number]
    for number, value in enumerate(new[len(between) :], first + len(between)):
        place.insert(number, value)


def _alike(old: list[Any], new: list[Any]) -> int:
    """Return how many values two lists begin with in common."""
    return sum(1 for _ in takewhile(lambda pair: _same(*pair), zip(old, new, strict=False)))


def _stated(value: Any) -> Any:
    """Leave out what is not stated: TOML has no word for nothing."""
    if isinstance(value, dict):
        return {key: _stated(one) for key, one in value.items() if one is not None}
    if isinstance(value, list):
        return [_stated(one) for one in value if one is not None]
    return value


def _same(one: Any, other: Any) -> bool:
    """Whether two values are the same; 1 and 1.0 are, for a page cannot tell them apart, and true is not 1."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(value, other[key]) for key, value in one.items())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)
