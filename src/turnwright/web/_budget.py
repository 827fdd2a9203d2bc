"""Where the error of a finished run comes from, asked of the functions that `turnwright compare` asks."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import fields
from pathlib import Path as File
from typing import Any

from turnwright._whole import write_whole
from turnwright.errors import InputError
from turnwright.job import Job, Shares, shares
from turnwright.job._run import Watch, planned, read_back
from turnwright.web._made import numbers_of

__all__ = ["budget"]

KEPT = "budget.json"
"""Beside what the run has written: finding it takes as long as planning a path."""


def budget(folder: str) -> dict[str, Any]:
    """Return the shares of the form error of the finishing pass, with the tool and the machine as planned.

    A run that does not correct for the servos has its motion read from its program, so that the decimals' part is in
    ``chord_nm``; the run itself has found it alone.
    """
    out = File(folder)
    kept = out.parent / KEPT
    with suppress(OSError, ValueError):
        found: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    numbers = numbers_of(folder)
    job = Job.load(out / "job.toml")
    part, tool, cut = job.part.aimed, job.tool.tool, job.passes[-1]
    try:
        program, name = numbers["program"]["files"][0], numbers["passes"][-1]["name"]
    except (KeyError, IndexError) as error:
        raise InputError("the run has written no program, so its error has no shares: look at its maps") from error
    again = read_back(job, out / program, name)
    spiral = job.servo(cut).spiral(part, tool)
    if job.program.precorrect:
        _, _, motion, meant = planned(job, cut, Watch(None))
        told = shares(part, tool, spiral, motion, again=again, meant=meant)
    else:
        told = shares(part, tool, spiral, again)
    found = {one.name: _number(getattr(told, one.name)) for one in fields(Shares) if one.name != "error"}
    found["rounding_nm"] = numbers["rounding_nm"]
    found["servos"] = any(one.response is not None or one.dead_time for one in job.machine.machine.axes.values())
    with suppress(OSError):  # a full disk: it is found again
        write_whole(kept, json.dumps(found))
    return found


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
