"""Where the error of a finished run comes from, asked of the functions that `turnwright compare` asks."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import fields
from pathlib import Path as File
from typing import Any

from turnwright._io import write_whole
from turnwright.job import Shares, program_shares
from turnwright.web.made import finishing_pass, numbers_of

__all__ = ["budget"]

KEPT = "budget.json"
"""Beside what the run has written: finding it takes as long as planning a path."""


def budget(folder: str) -> dict[str, Any]:
    """Return the shares of the form error of the finishing pass; that of decimals is what its run has found."""
    kept = File(folder).parent / KEPT
    with suppress(OSError, ValueError):
        found: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    job, file, name = finishing_pass(folder, "its error has no shares: look at its maps")
    told = program_shares(job, file, name)
    found = {one.name: _number(getattr(told, one.name)) for one in fields(Shares) if one.name != "error"}
    found["rounding_nm"] = numbers_of(folder)["rounding_nm"]
    found["servos"] = any(one.response is not None or one.dead_time for one in job.machine.axes.values())
    with suppress(OSError):  # a full disk: it is found again
        write_whole(kept, json.dumps(found))
    return found


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
