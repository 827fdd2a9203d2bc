"""What can be stated in a job: each table and key with its unit, its default and its limits, from the classes alone.

The texts are those of the ``Parameters`` sections of the classes that a job file states.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

from turnwright._tables import Stated, adapter, merged
from turnwright.job.schema import Job
from turnwright.units import write

__all__ = ["job_schema"]

DISPLAY = {"mm": "mm", "mm/rev": "um/rev", "rad": "deg", "rpm": "rpm", "Hz": "Hz", "mm/s": "mm/min", "mm/s^2": "mm/s^2"}
"""The unit that a person writes, by the unit inside."""

SMALLER = {
    **dict.fromkeys(
        ("stock", "allowance", "depth", "pixel", "radius_error", "arc_length", "resolution", "stylus_radius"), "um"
    ),
    **dict.fromkeys(("form_pv", "sq", "chord", "scallop", "worth", "wavelength"), "nm"),
    "squareness": "urad",
}
"""The same of fields that are far below a millimetre or a degree."""

TEXTS = {
    "family": "Which kind of surface it is.",
    "kind": "Which way of cutting it is.",
    "placed": "Where it is put in the part frame; about the axis if left out.",
    "units": "Which unit of length the formula is written in, so that its coefficients can be plain numbers; without "
    "it each of them is text with its own unit.",
    "waviness_file": "File with the columns sweep and deviation, each with its unit in the head, in place of the "
    "coefficients.",
}
"""What is said of the keys of a file that are no fields of their class."""


def job_schema() -> dict[str, Any]:
    """Return the JSON schema of a job.

    Every leaf has a ``title``, a ``description`` and, where it is a quantity, its ``unit`` inside and the ``display``
    unit that a person writes; quantities are text such as "8 um/rev".
    """
    schema = adapter(Job).json_schema()
    tables = {table.__name__: table for table in _below(Stated)}
    for name, definition in [*schema["$defs"].items(), ("Job", schema)]:
        if "properties" in definition:
            _explain(tables.get(name), definition)
    return schema


def _below(table: type[Any]) -> list[type[Any]]:
    return [one for child in table.__subclasses__() for one in (child, *_below(child))]


def _explain(table: type[Any] | None, definition: dict[str, Any]) -> None:
    """Add texts and units to one table."""
    texts = {} if table is None else texts_of(table)
    definition["description"] = _clean(inspect.getdoc(table) or "").split("\n\n")[0].replace("\n", " ")
    for name, given in definition["properties"].items():
        field = dict(_without_null(given))
        given.clear()
        given.update(field)
        given["title"] = name.replace("_", " ")
        given["description"] = given.get("description") or texts.get(name) or TEXTS.get(name, "")
        _units(given, name)
        if given.get("default", 0) is None:
            del given["default"]
        for key, inner in given.get("properties", {}).items():
            inner["title"] = key.replace("_", " ")
            _units(inner, key)
        if "$ref" in given or isinstance(given.get("default"), dict):
            given.pop("default", None)  # a table says the defaults of its own fields


def _without_null(field: dict[str, Any]) -> dict[str, Any]:
    """Return a field that may be left out as what it is when it is there."""
    kinds = [one for one in field.get("anyOf", []) if one != {"type": "null"}]
    if not kinds or len(kinds) == len(field["anyOf"]):
        return field
    rest = {key: value for key, value in field.items() if key != "anyOf"}
    if rest.get("default", 0) is None:
        del rest["default"]
    return {**(kinds[0] if len(kinds) == 1 else {"anyOf": kinds}), **rest}


def _units(field: dict[str, Any], name: str) -> None:
    """Say in which unit a person writes a quantity, and its default in that unit."""
    leaves = [field, *field.get("anyOf", []), *field.get("prefixItems", [])]
    items = field.get("items")
    if isinstance(items, dict):
        _units(items, name)
    for leaf in leaves[1:]:
        _units(leaf, name)
    if "unit" in field:
        field["display"] = SMALLER.get(name) or DISPLAY.get(field["unit"], field["unit"])
        if isinstance(field.get("default"), int | float):
            field["default"] = write(float(field["default"]), field["unit"])
    elif isinstance(field.get("default"), list | tuple) and field.get("prefixItems"):
        pairs = zip(field["default"], field["prefixItems"], strict=False)
        field["default"] = [write(float(one), item["unit"]) if "unit" in item else one for one, item in pairs]


def texts_of(table: type[Stated]) -> dict[str, str]:
    """Return the explanation of each field of a table.

    Parameters
    ----------
    table
        A class that a job file states.
    """
    texts: dict[str, str] = {}
    for owner in reversed(inspect.getmro(table)):
        texts |= _parameters(vars(owner).get("like")) | _parameters(owner)
    for inner in merged(table).values():
        texts = texts_of(inner) | texts
    return texts | {key: texts[name] for name, key in table.key_names.items() if name in texts}


def _parameters(owner: object) -> dict[str, str]:
    """Return the texts of the ``Parameters`` section of a docstring, by name."""
    doc = inspect.getdoc(owner) or "" if owner is not None else ""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^[^\s][^\n]*\n-{3,}$|\Z)", doc, re.DOTALL | re.MULTILINE)
    found: dict[str, list[str]] = {}
    names: list[str] = []
    for line in (section.group(1) if section else "").splitlines():
        if line.startswith(" "):
            for name in names:
                found[name].append(line.strip())
        elif line.strip():
            if line.startswith((">>>", "..")):
                break
            names = [name.strip() for name in line.split(",")]
            found |= {name: [] for name in names}
    return {name: _clean(" ".join(lines)) for name, lines in found.items()}


def _clean(text: str) -> str:
    """Return a text of a docstring as people read it: without marks, shapes and units of arrays."""
    text = re.sub(r"\s*\[[A-Za-z0-9+]+\]_", "", text)
    text = re.sub(r":[a-z]+:`([^`]*)`", r"\1", text)
    text = re.sub(r"(^|\. )``None``", r"\1Left out", text)
    text = re.sub(r"``None``", "left out", text)
    text = re.sub(r"``([^`]*)``", r"\1", text)
    text = re.sub(r"`(?:turnwright\.)?([^`]*)`", r"\1", text)
    return re.sub(r"\s*(?:\([a-z0-9, ]+\)\s*)?\[[^\]]*\]\.?\s*$", "", text).strip()
