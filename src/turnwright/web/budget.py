"""Error budget of a finished run, by the same functions as `turnwright compare`."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import fields
from pathlib import Path as File
from typing import Any

from turnwright._io import json_data, write_atomic
from turnwright.job import program_shares
from turnwright.web.results import finishing_pass, numbers_of

__all__ = ["budget"]

CACHE_FILE = "budget.json"
"""Name of the cached result in the folder of the run; computing it takes as long as planning a path."""


def budget(folder: str) -> dict[str, Any]:
    """Return the error contributions of the finishing pass; that of rounding is taken from the run."""
    cache = File(folder).parent / CACHE_FILE
    with suppress(OSError, ValueError):
        numbers: dict[str, Any] = json.loads(cache.read_text(encoding="utf-8"))
        return numbers
    job, file, name = finishing_pass(folder, "no error budget is available")
    contributions = program_shares(job, file, name)
    names = [one.name for one in fields(contributions) if one.name != "error"]
    numbers = json_data({name: getattr(contributions, name) for name in names})
    numbers["rounding_nm"] = numbers_of(folder)["rounding_nm"]
    numbers["servos"] = any(one.response is not None or one.dead_time for one in job.machine.axes.values())
    with suppress(OSError):  # on a full disk the result is not cached
        write_atomic(cache, json.dumps(numbers))
    return numbers
