"""Generate a commented job file and the job-file reference from the classes."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w
import tomlkit

from turnwright._faults import suggestion
from turnwright._tables import write_table
from turnwright.errors import JobError
from turnwright.job.reference import job_schema
from turnwright.job.text import name_files
from turnwright.part import Part
from turnwright.strategy import STRATEGIES
from turnwright.surface import FAMILIES

__all__ = ["KeyHelp", "TableHelp", "job_template", "part_template", "reference_tables"]

WIDTH = 110

LEGEND = "# Quantities are text with a unit. A line that begins with # and a key is optional: remove the # to state it."

_EXAMPLES: dict[str, dict[str, Any]] = {
    "part": {"name": "lens", "radius": "5 mm"},
    "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "20 deg", "rake": "0 deg"},
    "machine": {"name": "generic"},
}

_ADDED: dict[str, dict[str, Any]] = {
    "simulation.patches": {"name": "zone", "centre": ["2 mm", "0 mm"], "size": ["0.1 mm", "0.1 mm"], "pixel": "1 um"},
    "tolerances": {"form_pv": "300 nm", "sq": "5 nm"},
}
"""Tables that a template adds: a patch for the surface finish, and tolerances."""

_BY_KEY: dict[str, Any] = {
    "spindle_speeds": [["0 mm", "200 rpm"], ["5 mm", "100 rpm"]], "waviness": ["0.1 um/rad", "-0.2 um/rad^2"],
    "material": "copper-ofhc", "dialect": "generic", "interpolation": "linear", "file": "my_file.toml",
    "waviness_file": "edge.csv", "straightness_file": "straightness.csv", "correction": "correction.csv",
    "mask": "mask.csv", "instrument": {"name": "zygo-nexview-20x"}, "departure_from": "design",
    "placed": {"shift": ["0.1 mm", "0 mm", "0 mm"], "rotation": "5 deg"}, "free": ["x", "y", "z"],
    "blank": {"radius": "6 mm"}, "form": "plane", "wavelength": "633 nm", "index": 1.49, "focal_length": "100 mm",
    "cusp_order": {"max": 0.001, "wavelength": "633 nm"}, "max": 0.001,
    "drawing": ["3/ 0.5(0.2/0.1); λ = 546.07 nm", "Ra 0.02"],
}  # fmt: skip
"""Examples of keys whose type gives no sensible one."""

_BY_DISPLAY = {
    "mm": "1 mm", "um": "10 um", "nm": "5 nm", "deg": "5 deg", "urad": "1 urad", "um/rev": "8 um/rev",
    "rpm": "100 rpm", "Hz": "1000 Hz", "mm/min": "30 mm/min", "mm/s^2": "1000 mm/s^2",
}  # fmt: skip
"""Examples of quantities, by their unit in a job file."""


class KeyHelp(NamedTuple):
    """One key of a table: help text, type, limits or choices, default, and an example line."""

    name: str
    text: str
    takes: str
    limits: str
    default: str
    line: str
    required: bool


class TableHelp(NamedTuple):
    """One table of a job file: its place, the class that reads it, its help text and its keys."""

    place: str
    title: str
    text: str
    keys: tuple[KeyHelp, ...]


def job_template(family: str, strategy: str = "slow tool servo") -> str:
    """Return a job file of a surface family and a kind of strategy to start from, with an explanation of every key.

    Optional keys are commented out. Raises `JobError` if there is no such family or strategy.
    """
    for name, classes in ((family, FAMILIES), (strategy, STRATEGIES)):
        if name not in classes:
            raise JobError(f"{name!r} is not known: {suggestion(name, classes)}")
    schema = job_schema()
    part, patches = dict(_EXAMPLES["part"]), [("simulation.patches", "Patch", _ADDED["simulation.patches"])]
    if FAMILIES[family].has_outline:
        del part["radius"]
        patches = []  # they must be on the part
    others = _other_tables(strategy)
    tables: list[tuple[str, str, Mapping[str, Any]]] = [
        ("part", "Part", part),
        ("part.surface", FAMILIES[family].__name__, {"family": family, **FAMILIES[family].example}),
        *others[:3],
        *patches,
        *others[3:],
    ]
    head = f"# A job of turnwright: a part of the family {family!r}, cut with a {strategy}."
    return "\n".join([head, LEGEND, *_sections(schema, tables)]) + "\n"


def part_template(part: Part, notes: Sequence[str], strategy: str = "slow tool servo", *, folder: Path) -> str:
    """Return a job file of a part, with notes above it, and with examples of everything else as `job_template` does.

    ``folder`` is that of the job: files in it are named without it.
    """
    if strategy not in STRATEGIES:
        raise JobError(f"{strategy!r} is not known: {suggestion(strategy, STRATEGIES)}")
    lines = [f"# A job of turnwright: {part.name}, cut with a {strategy}.", *(f"# {note}" for note in notes), LEGEND]
    text = "\n".join(line for one in lines for line in textwrap.wrap(one, WIDTH, subsequent_indent="# "))
    others = "\n".join(_sections(job_schema(), _other_tables(strategy)))
    return f"{text}\n\n{tomli_w.dumps({'part': name_files(write_table(part), folder)})}{others}\n"


def _other_tables(strategy: str) -> list[tuple[str, str, Mapping[str, Any]]]:
    """Return place, class and values of the tables of a job besides its part and patches."""
    moves_fast_tool = "fast" in strategy or "hybrid" in strategy
    machine = {"name": "nanoform-fts-70"} if moves_fast_tool else _EXAMPLES["machine"]
    program = [("program", "ProgramTable", {"fast_tool": "position"})] if moves_fast_tool else []
    return [
        ("tool", "Tool", _EXAMPLES["tool"]),
        ("machine", "MachineTable", machine),
        ("strategy", STRATEGIES[strategy].__name__, {"kind": strategy, **STRATEGIES[strategy].example}),
        ("tolerances", "Tolerances", _ADDED["tolerances"]),
        *program,
    ]


def _sections(schema: dict[str, Any], tables: Sequence[tuple[str, str, Mapping[str, Any]]]) -> list[str]:
    """Return the lines of tables with an explanation of every key."""
    lines: list[str] = []
    for place, cls, values in tables:
        lines += ["", f"[[{place}]]" if place.endswith("patches") else f"[{place}]"]
        for key in _keys(schema["$defs"][cls], values):
            if not key.line or key.name == "surface":  # a table of its own
                continue
            note = " ".join(filter(None, (key.text, key.limits, f"Default: {key.default}." if key.default else "")))
            lines += textwrap.wrap(note, WIDTH, initial_indent="# ", subsequent_indent="# ")
            lines.append(key.line if key.name in values else f"#{key.line}")
    return lines


def reference_tables() -> tuple[TableHelp, ...]:
    """Return every table that a job file can have, in the order of the file, with its keys."""
    schema = job_schema()
    tables: list[TableHelp] = []
    seen: set[str] = set()
    _collect(schema, "", schema, tables, seen)
    return tuple(tables)


def _collect(
    schema: dict[str, Any], place: str, table: dict[str, Any], tables: list[TableHelp], seen: set[str]
) -> None:
    title = str(table.get("title", ""))
    if place:
        keys = _keys(table, {**_EXAMPLES.get(place, {}), **_ADDED.get(place, {}), **_example_of(title)})
        tables.append(TableHelp(place, title, str(table.get("description", "")), keys))
    for name, field in table["properties"].items():
        inner = f"{place}.{name}" if place else name
        for reference in _references(field):
            definition = reference.rsplit("/", 1)[-1]
            if definition in seen:
                continue
            seen.add(definition)
            below = schema["$defs"][definition]
            kinds = below["discriminator"]["mapping"].values() if "discriminator" in below else (reference,)
            for kind in kinds:
                _collect(schema, inner, schema["$defs"][kind.rsplit("/", 1)[-1]], tables, seen)


def _example_of(title: str) -> Mapping[str, Any]:
    """Return the example of a surface family or a strategy, by the name of its class."""
    for key, classes in (("family", FAMILIES), ("kind", STRATEGIES)):
        for name, cls in classes.items():
            if cls.__name__ == title:
                return {key: name, **cls.example}
    return {}


def _references(field: Any) -> Iterator[str]:
    if isinstance(field, dict):
        if "$ref" in field:
            yield field["$ref"]
        for key in ("anyOf", "oneOf", "items", "prefixItems"):
            yield from _references(field.get(key, []))
    elif isinstance(field, list):
        for one in field:
            yield from _references(one)


def _keys(table: dict[str, Any], values: Mapping[str, Any]) -> tuple[KeyHelp, ...]:
    """Return the keys of a table, required ones first."""
    required = table.get("required", ())
    order = sorted(table["properties"].items(), key=lambda one: (one[0] not in required, one[0] not in values))
    return tuple(_key(name, field, values.get(name), required=name in required) for name, field in order)


def _key(name: str, field: dict[str, Any], value: Any, *, required: bool) -> KeyHelp:
    default = field.get("default")
    stated = default not in (None, "", [], {})
    example = next((one for one in (value, default if stated else None, _BY_KEY.get(name)) if one is not None), None)
    example = _example(field) if example is None else example
    line = "" if example is None else f"{_bare(name)} = {_toml(example)}"
    return KeyHelp(
        name, str(field.get("description", "")), _takes(field), _limits(field), _toml(default) if stated else "", line,
        required,
    )  # fmt: skip


def _takes(field: dict[str, Any]) -> str:
    if "unit" in field:
        return "a plain number" if field["unit"] == "1" else f"a quantity in {field['display']}"
    if "const" in field or "enum" in field:
        return "a choice"
    if field.get("type") == "array":
        item = _takes(field.get("items", {}) or next(iter(field.get("prefixItems", [])), {}))
        return f"a list, each {item}" if item else "a list"
    kinds = {"integer": "a whole number", "number": "a number", "boolean": "true or false", "string": "text"}
    return kinds.get(str(field.get("type")), "a table" if "$ref" in field or field.get("type") == "object" else "")


def _limits(field: dict[str, Any]) -> str:
    if "enum" in field:
        return f"One of {', '.join(map(_toml, field['enum']))}."
    if "above" in field:
        return f"Above {field['above']:g}."
    low, high = field.get("least", field.get("minimum")), field.get("maximum")
    if low is None or low <= -1e99:  # a range of numbers, no limit
        return ""
    return f"{low:g} or more." if high is None or high >= 10**9 else f"{low:g} to {high:g}."


def _example(field: dict[str, Any]) -> Any:
    """Return an example value of a key; ``None`` for tables and lists of tables."""
    example: Any = None
    if "const" in field or "enum" in field:
        example = field["const"] if "const" in field else field["enum"][0]
    elif "unit" in field:
        example = _BY_DISPLAY.get(field["display"], "1" if field["unit"] == "1" else f"1 {field['display']}")
    elif "anyOf" in field:
        example = next((one for one in map(_example, field["anyOf"]) if one is not None), None)
    elif field.get("type") == "array":
        count = max(field.get("minItems", 1), 1)
        parts = [_example(one) for one in field.get("prefixItems") or [field.get("items", {})] * count]
        example = None if None in parts else parts
    else:
        plain = {"integer": max(field.get("minimum", 1), 1), "number": 0.0, "boolean": True, "string": "..."}
        example = plain.get(str(field.get("type")))
    return example


def _bare(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else f'"{key}"'


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_bare(key)} = {_toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return str(tomlkit.item(value).as_string())
