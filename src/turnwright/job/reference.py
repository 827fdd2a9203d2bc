"""The schema of a job file: each table and key with unit, default and limits, generated from the classes.

The texts come from the ``Parameters`` sections of the docstrings of these classes.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

from turnwright._tables import TableModel, adapter, merged_fields
from turnwright.job.schema import Job
from turnwright.units import write

__all__ = ["job_schema"]

DISPLAY = {"mm": "mm", "mm/rev": "um/rev", "rad": "deg", "rpm": "rpm", "Hz": "Hz", "mm/s": "mm/min", "mm/s^2": "mm/s^2"}
"""The unit in a job file, by the internal unit."""

SMALLER = {
    **dict.fromkeys(
        ("stock", "allowance", "depth", "pixel", "radius_error", "arc_length", "resolution", "stylus_radius"), "um"
    ),
    **dict.fromkeys(("form_pv", "sq", "chord", "scallop", "min_effect", "wavelength", "calibration"), "nm"),
    "squareness": "urad",
}
"""The unit in a job file of keys whose values are far below a millimetre or a degree."""

TEXTS = {
    "family": "Surface family.",
    "kind": "Kind of strategy.",
    "placed": "Position and orientation in the part frame; centred on the axis if left out.",
    "units": "Unit of length of the formula, so that its coefficients can be plain numbers; without it each of them is "
    "text with its own unit.",
    "waviness_file": "File with the columns sweep and deviation, each with its unit in the header, in place of the "
    "coefficients.",
}
"""Texts of the keys that are not fields of their class."""


def job_schema() -> dict[str, Any]:
    """Return the JSON schema of a job.

    Every key has a ``title`` and a ``description``. A quantity also has its internal ``unit`` and its ``display`` unit,
    the one used in job files; quantities are text such as "8 um/rev".
    """
    schema = adapter(Job).json_schema()
    tables = {table.__name__: table for table in _nested_tables(TableModel)}
    for name, definition in [*schema["$defs"].items(), ("Job", schema)]:
        if "properties" in definition:
            _explain(tables.get(name), definition)
    return schema


def _nested_tables(table: type[Any]) -> list[type[Any]]:
    return [one for child in table.__subclasses__() for one in (child, *_nested_tables(child))]


def _explain(table: type[Any] | None, definition: dict[str, Any]) -> None:
    texts = {} if table is None else texts_of(table)
    definition["description"] = _clean(inspect.getdoc(table) or "").split("\n\n")[0].replace("\n", " ")
    for name, entry in definition["properties"].items():
        field = dict(_drop_null(entry))
        entry.clear()
        entry.update(field)
        entry["title"] = name.replace("_", " ")
        entry["description"] = entry.get("description") or texts.get(name) or TEXTS.get(name, "")
        _add_units(entry, name)
        if entry.get("default", 0) is None:
            del entry["default"]
        for key, inner in entry.get("properties", {}).items():
            inner["title"] = key.replace("_", " ")
            _add_units(inner, key)
        if "$ref" in entry or isinstance(entry.get("default"), dict):
            entry.pop("default", None)  # a table has the defaults of its own fields


def _drop_null(field: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of an optional field without the alternative "null"."""
    kinds = [one for one in field.get("anyOf", []) if one != {"type": "null"}]
    if not kinds or len(kinds) == len(field["anyOf"]):
        return field
    others = {key: value for key, value in field.items() if key != "anyOf"}
    if others.get("default", 0) is None:
        del others["default"]
    return {**(kinds[0] if len(kinds) == 1 else {"anyOf": kinds}), **others}


def _add_units(field: dict[str, Any], name: str) -> None:
    """Add the display unit of a quantity, and convert its default to that unit."""
    leaves = [field, *field.get("anyOf", []), *field.get("prefixItems", [])]
    items = field.get("items")
    if isinstance(items, dict):
        _add_units(items, name)
    for leaf in leaves[1:]:
        _add_units(leaf, name)
    if "unit" in field:
        field["display"] = SMALLER.get(name) or DISPLAY.get(field["unit"], field["unit"])
        if isinstance(field.get("default"), int | float):
            field["default"] = write(float(field["default"]), field["unit"])
    elif isinstance(field.get("default"), list | tuple) and field.get("prefixItems"):
        pairs = zip(field["default"], field["prefixItems"], strict=False)
        field["default"] = [write(float(one), item["unit"]) if "unit" in item else one for one, item in pairs]


def texts_of(table: type[TableModel]) -> dict[str, str]:
    """Return the help text of each key of a table of a job file."""
    texts: dict[str, str] = {}
    for owner in reversed(inspect.getmro(table)):
        texts |= _parameters(vars(owner).get("like")) | _parameters(owner)
    for inner in merged_fields(table).values():
        texts = texts_of(inner) | texts
    return texts | {key: texts[name] for name, key in table.key_names.items() if name in texts}


def _parameters(owner: object) -> dict[str, str]:
    """Return the texts of the ``Parameters`` section of a docstring, by name."""
    doc = inspect.getdoc(owner) or "" if owner is not None else ""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^[^\s][^\n]*\n-{3,}$|\Z)", doc, re.DOTALL | re.MULTILINE)
    texts: dict[str, list[str]] = {}
    names: list[str] = []
    for line in (section.group(1) if section else "").splitlines():
        if line.startswith(" "):
            for name in names:
                texts[name].append(line.strip())
        elif line.strip():
            if line.startswith((">>>", "..")):
                break
            names = [name.strip() for name in line.split(",")]
            texts |= {name: [] for name in names}
    return {name: _clean(" ".join(lines)) for name, lines in texts.items()}


def _clean(text: str) -> str:
    """Return a docstring text without markup, array shapes and units."""
    text = re.sub(r"\s*\[[A-Za-z0-9+]+\]_", "", text)
    text = re.sub(r":[a-z]+:`([^`]*)`", r"\1", text)
    text = re.sub(r"(^|\. )``None``", r"\1Left out", text)
    text = re.sub(r"``None``", "left out", text)
    text = re.sub(r"``([^`]*)``", r"\1", text)
    text = re.sub(r"`(?:turnwright\.)?([^`]*)`", r"\1", text)
    return re.sub(r"\s*(?:\([a-z0-9, ]+\)\s*)?\[[^\]]*\]\.?\s*$", "", text).strip()
