"""What the warm processes make of a job that is typed: everything here is called there, never in the server."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from turnwright._faults import sentences
from turnwright._io import read_toml
from turnwright._tables import adapter, types_of
from turnwright.errors import InputError, TurnwrightError, shortened
from turnwright.instrument import Instrument
from turnwright.job import (
    HeightFile,
    Job,
    MachineDeviations,
    as_tables,
    context_of,
    faults,
    written,
)
from turnwright.machine import Machine
from turnwright.material import Material
from turnwright.part import Part
from turnwright.tool import Tool
from turnwright.web.limits import MOST_POINTS
from turnwright.web.references import located, require_flat

__all__ = [
    "check", "look_into", "machines", "parse", "plain", "read", "require", "warm", "warm_kernels", "write",
]  # fmt: skip

MEMORY_BYTES = 6 * 2**30
"""What a warm process may take beyond what it starts with."""


def warm() -> None:
    """Limit the memory of this process; what it needs is loaded with this module."""
    limit_memory(MEMORY_BYTES)


def warm_kernels() -> None:
    """Load what the first check needs: the stages, and their compiled kernels."""
    from turnwright.job import preview  # noqa: PLC0415 - whoever only reads a job, or looks at it, needs no stage

    preview(Job.read(SMALL))


SMALL: dict[str, Any] = {
    "part": {
        "surface": {"family": "radial polynomial", "units": "mm", "radial": [-0.01], "slope": [-0.001], "tilt": 0.01},
        "radius": "1 mm",
        "stock": "5 um",
        "material": "IRG 26",
    },
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "50 um/rev", "points_per_rev": 60},
}
"""A job that is checked at once, and by the same kernels as a freeform lens."""


def limit_memory(extra: int) -> None:
    """Let this process take no more address space than it has and so many bytes; where the system can limit it."""
    with suppress(ImportError, OSError, ValueError):
        import resource  # noqa: PLC0415 - there is none on Windows

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        most = pages * resource.getpagesize() + extra
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def read(data: dict[str, Any], folder: str) -> tuple[Job | None, list[dict[str, str]]]:
    """Return the job that a page describes, or what is wrong with it.

    Parameters
    ----------
    data
        As JSON has it.
    folder
        Of the server, where references lead.
    """
    real, problems, references = located(data, Path(folder))
    problems += _unknown_machine(real)
    if problems:
        return None, problems
    try:
        return adapter(Job).validate_python(real, context=context_of(folder)), []
    except ValidationError as error:
        return None, [
            {"field": field, "sentence": _with_names(sentence, references)} for field, sentence in faults(error)
        ]
    except (RecursionError, OverflowError) as error:
        sentence = f"the job cannot be read ({error}): make it flat, with usual numbers"
        return None, [{"field": "", "sentence": shortened(sentence)}]


def _with_names(sentence: str, references: Mapping[str, str]) -> str:
    """Return a sentence with the files in it as who brought them calls them."""
    for reference, path in references.items():
        name = reference.rpartition("/")[2]
        sentence = sentence.replace(path, name).replace(Path(path).name, name)
    return sentence


def look_into(file: str, kind: str) -> None:
    """Read a file that a job is to name, as the job would.

    Parameters
    ----------
    file
        Where it lies.
    kind
        See `turnwright.web.limits.FILE_ENDINGS`.

    Raises
    ------
    InputError
        If it is none of its kind.
    """
    path = Path(file)
    found = []
    for more in UNITS if kind == "heights" else ({},):
        try:
            _read_as(path, kind, more)
        except ValidationError as error:
            found.append("; ".join(sentences(error, READERS[kind], {})))
        except TurnwrightError as error:
            found.append(str(error))
        else:
            return
    # Whether the job is to state units is told when it names the file.
    told = next((one for one in found if "unit" not in one), found[0])
    raise InputError(told.replace(file, "the file").replace(path.name, "the file"))


def _read_as(path: Path, kind: str, more: Mapping[str, str]) -> None:
    """Read a file of a kind, in a table of a job that states more."""
    if kind == "machine":
        _require_whole(read_toml(path.read_bytes(), "the machine file"))
        Machine.load(path)
    elif kind == "material":
        Material.load(path)
    elif kind == "instrument":
        Instrument.load(path)
    else:
        stated = {
            "correction": str(path),
            "waviness": path,
            "heights": {"family": "gridded", "file": str(path), **more},
            "straightness": {"straightness_file": str(path)},
        }[kind]
        found = adapter(READERS[kind]).validate_python(stated, context=context_of("."))
        if kind == "straightness":
            found.deviating(Machine.load("generic"))


UNITS: tuple[dict[str, str], ...] = (
    {"units": "mm", "sag_units": "mm"}, {}, {"sag_units": "mm"}, {"units": "mm"},
)  # fmt: skip
"""What a job may have to state of a table of heights: what the file states itself it must not."""

READERS: dict[str, Any] = {
    "correction": types_of(Part)["correction"],
    "heights": HeightFile,
    "straightness": MachineDeviations,
    "waviness": types_of(Tool)["waviness"],
}
"""What of a job is read from a kind of file."""


def _require_whole(machine: dict[str, Any]) -> None:
    """Refuse a machine that goes on in other files: what it names would be looked for on this computer."""
    base, axes = machine.get("base"), machine.get("axes")
    responses = (
        [one.get("response") for one in axes.values() if isinstance(one, dict)] if isinstance(axes, dict) else []
    )
    if any(isinstance(one, dict) and "file" in one for one in responses):
        raise InputError(
            "the machine names the file of a response, which only the command line reads: state frequency and damping, "
            "or run the job there"
        )
    if base is not None and base not in machines():
        raise InputError(
            f"the base of the machine is {str(base)[:60]!r}, it can be {', '.join(machines())}: name one of them, or "
            "let the machine stand alone"
        )


def machines() -> list[str]:
    """Return the names of the machines that come with Turnwright."""
    folder = resources.files("turnwright") / "machines"
    return sorted(Path(one.name).stem for one in folder.iterdir() if one.name.endswith(".toml"))


def _unknown_machine(data: dict[str, Any]) -> list[dict[str, str]]:
    """Refuse a machine by anything but its name: a name with an ending would be looked for as a file."""
    table = data.get("machine")
    name = table.get("name") if isinstance(table, dict) else None
    known = machines()
    if name is None or not isinstance(name, str) or name in known:
        return []
    return [
        {
            "field": "machine.name",
            "sentence": f"{name[:60]!r} is not one of {', '.join(known)}: choose one of them",
        }
    ]


def require(data: dict[str, Any], folder: str) -> Job:
    """Return the job that a page describes.

    Raises
    ------
    InputError
        With all that is wrong with it, in one text.
    """
    job, problems = read(data, folder)
    if job is None:
        raise InputError("\n".join(one["sentence"] for one in problems[:5]))
    return job


def parse(toml: str, folder: str) -> dict[str, Any]:
    """Return a job file as data, and what is wrong with it."""
    try:
        told = read_toml(toml.encode("utf-8", "surrogatepass"), "the job")
        require_flat(told)
    except InputError as error:
        return {"data": {}, "errors": [{"field": "", "sentence": str(error)}]}
    data = plain(as_tables(told))
    return {"data": data, "errors": read(data, folder)[1]}


def write(data: dict[str, Any], folder: str, before: str = "") -> dict[str, Any]:
    """Return a job as a file, and what is wrong with it.

    Parameters
    ----------
    data
        As JSON has it.
    folder
        Of the server, where references lead.
    before
        The file before the job was changed, whose remarks and layout stay.
    """
    _, problems = read(data, folder)
    try:
        toml = written(data, before)
        toml.encode()
    except (TypeError, ValueError, RecursionError, AttributeError) as error:
        sentence = f"the job cannot be written as TOML ({error}): correct it"
        problems = problems or [{"field": "", "sentence": shortened(sentence)}]
        return {"toml": "", "errors": problems}
    return {"toml": toml, "errors": problems}


def check(data: dict[str, Any], folder: str) -> dict[str, Any]:
    """Say whether the tool reaches the part, how long the program will be, and what becomes of the material."""
    from turnwright.access import check_access  # noqa: PLC0415
    from turnwright.job import preview, unjudged  # noqa: PLC0415

    found: dict[str, Any] = {"errors": [], "access": None, "preview": None, "chips": {}, "warnings": []}
    job, found["errors"] = read(data, folder)
    if job is None:
        return found
    try:
        plan = preview(job)
    except TurnwrightError as error:
        found["errors"] = [{"field": "strategy", "sentence": str(error)}]
        with suppress(TurnwrightError):
            found["access"] = plain(check_access(job.part.aimed, job.tool, sense=job.strategy.sense))
        return found
    found["access"] = plain(plan.access)
    found["preview"] = plain(
        {
            "points": plan.points,
            "shortest_s": plan.shortest_s,
            "refused": plan.refused,
            "shape": plan.shape.facts,
            "remarks": plan.remarks,
            "unjudged": [one.sentence for one in unjudged(job, "check predicts no surface, Run does")],
        }
    )
    found["chips"] = dict(plan.chips)
    accepted = [one.sentence for one in plan.access.findings if not one.ok and one.name in job.accept]
    found["warnings"] = [*accepted, *plan.warnings]
    points = sum(plan.points.values())
    if points > MOST_POINTS:
        found["errors"] = [{"field": "strategy", "sentence": too_many(points)}]
    return found


def too_many(points: int) -> str:
    """Say that a job is too long for a page."""
    return (
        f"the program has {points} points, a page takes {MOST_POINTS}: take a larger feed or fewer points, or run the "
        "job by the command line"
    )


def plain(value: Any) -> Any:
    """Return a value as JSON has it: infinite and missing numbers become ``None``."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    elif isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, bool | str | int) or value is None else str(value)
