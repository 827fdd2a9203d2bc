"""The JSON schema of a job for the form of the page: which keys name files, and which names a machine can have."""

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
"""Fields of tables whose key ``file`` names no heights."""

KNOWN_NAMES: dict[str, Callable[[], list[str]]] = {
    "MachineTable": machines,
    "InstrumentTable": lambda: list(Instrument.known()),
}
"""Names that the key ``name`` of a table can have."""


def job_schema() -> dict[str, Any]:
    """Return the JSON schema of a job; a key that names a file says what that ``holds`` and its ``endings``."""
    schema = described()
    for own, definition in [*schema["$defs"].items(), ("Job", schema)]:
        for name, given in definition.get("properties", {}).items():
            kind = given.pop("reads", kind_of(FILE_FIELDS.get(own, ""), name) if name in FILE_KEYS else "")
            if not kind:
                continue
            given["holds"] = kind
            given["endings"] = list(FILE_ENDINGS[kind])
            if kind == "material":
                given["examples"] = list(Material.known())
            else:
                given["format"] = "reference"
        if own in KNOWN_NAMES:
            definition["properties"]["name"]["enum"] = KNOWN_NAMES[own]()
    return schema
