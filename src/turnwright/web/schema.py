"""JSON schema of a job for the form of the page, with file kinds and known names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from turnwright.instrument import Instrument
from turnwright.job import job_schema as described
from turnwright.material import Material
from turnwright.web.jobs import machines
from turnwright.web.limits import FILE_ENDINGS
from turnwright.web.references import FILE_KEYS, kind_of

__all__ = ["job_schema"]

FILE_FIELDS = {"MachineTable": "machine.file", "InstrumentTable": "measurement.instrument.file"}
"""Tables whose key ``file`` does not name heights, with the field."""

KNOWN_NAMES: dict[str, Callable[[], list[str]]] = {
    "MachineTable": machines,
    "InstrumentTable": lambda: list(Instrument.known()),
}
"""Values of the key ``name`` of a table."""


def job_schema() -> dict[str, Any]:
    """Return the JSON schema of a job; a key that names a file has its kind in ``holds`` and its ``endings``."""
    schema = described()
    for table, definition in [*schema["$defs"].items(), ("Job", schema)]:
        for name, description in definition.get("properties", {}).items():
            kind = description.pop("reads", kind_of(FILE_FIELDS.get(table, ""), name) if name in FILE_KEYS else "")
            if not kind:
                continue
            description["holds"] = kind
            description["endings"] = list(FILE_ENDINGS[kind])
            if kind == "material":
                description["examples"] = list(Material.known())
            else:
                description["format"] = "reference"
        if table in KNOWN_NAMES:
            definition["properties"]["name"]["enum"] = KNOWN_NAMES[table]()
    return schema
