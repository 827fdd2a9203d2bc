"""Reading, writing and checking jobs of the page; called in worker processes, never in the server."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from turnwright._faults import sentences
from turnwright._io import json_data, read_toml
from turnwright._tables import adapter, types_of
from turnwright.errors import InputError, TurnwrightError, shorten_message
from turnwright.instrument import Instrument
from turnwright.job import (
    HeightFile,
    Job,
    MachineDeviations,
    as_tables,
    context_of,
    faults,
    write_job,
)
from turnwright.machine import Machine
from turnwright.material import Material
from turnwright.part import Part
from turnwright.post import Dialect
from turnwright.tool import Tool
from turnwright.web.limits import MAX_POINTS
from turnwright.web.references import located, require_flat

__all__ = [
    "check", "look_into", "machines", "parse", "read", "require", "warm", "warm_kernels", "write",
]  # fmt: skip

MEMORY_BYTES = 6 * 2**30
"""Memory limit of a worker process, in addition to the memory at the start."""


def warm() -> None:
    """Limit the memory of this process; importing this module has loaded what it needs."""
    limit_memory(MEMORY_BYTES)


def warm_kernels() -> None:
    """Check a small job, so that the stages and their compiled kernels are loaded."""
    from turnwright.job import preview  # noqa: PLC0415 - not needed to read a job

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
"""A job that is checked quickly by the same kernels as a freeform lens."""


def limit_memory(extra: int) -> None:
    """Limit the address space of this process to its present size plus ``extra`` bytes, where supported."""
    with suppress(ImportError, OSError, ValueError):
        import resource  # noqa: PLC0415 - there is none on Windows

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        most = pages * resource.getpagesize() + extra
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def read(data: dict[str, Any], folder: str) -> tuple[Job | None, list[dict[str, str]]]:
    """Return the job of a page, or its problems; references are resolved in the folder of the server."""
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
        sentence = f"the job cannot be read ({error})"
        return None, [{"field": "", "sentence": shorten_message(sentence)}]


def _with_names(sentence: str, references: Mapping[str, str]) -> str:
    """Replace paths in a message by the original file names."""
    for reference, path in references.items():
        name = reference.rpartition("/")[2]
        sentence = sentence.replace(path, name).replace(Path(path).name, name)
    return sentence


def look_into(file: str, kind: str) -> None:
    """Raise unless a file is valid for use in a job; for its kind see `turnwright.web.limits.FILE_ENDINGS`."""
    path = Path(file)
    reasons = []
    for units in UNITS if kind == "heights" else ({},):
        try:
            _read_as(path, kind, units)
        except ValidationError as error:
            reasons.append("; ".join(sentences(error, READERS[kind], {})))
        except TurnwrightError as error:
            reasons.append("; ".join(str(error).splitlines()))
        else:
            return
    # Missing units are reported when a job names the file.
    reason = next((one for one in reasons if "unit" not in one), reasons[0])
    raise InputError(reason.replace(file, "the file").replace(path.name, "the file"))


def _read_as(path: Path, kind: str, units: Mapping[str, str]) -> None:
    """Read a file of a kind, with the given units."""
    if kind == "machine":
        _require_whole(read_toml(path.read_bytes(), "the machine file"))
        Machine.load(path)
    elif kind in LOADERS:
        LOADERS[kind](path)
    else:
        stated = {
            "correction": str(path),
            "waviness": path,
            "heights": {"family": "gridded", "file": str(path), **units},
            "straightness": {"straightness_file": str(path)},
        }[kind]
        value = adapter(READERS[kind]).validate_python(stated, context=context_of("."))
        if kind == "straightness":
            value.deviating(Machine.load("generic"))


UNITS: tuple[dict[str, str], ...] = (
    {"units": "mm", "sag_units": "mm"}, {}, {"sag_units": "mm"}, {"units": "mm"},
)  # fmt: skip
"""Units that a job may have to state for a table of heights; it must not repeat those of the file."""

LOADERS: dict[str, Callable[[Path], Any]] = {
    "dialect": Dialect.load, "instrument": Instrument.load, "material": Material.load,
}  # fmt: skip
"""Loader of each kind of file that a class of its own describes."""

READERS: dict[str, Any] = {
    "correction": types_of(Part)["correction"],
    "heights": HeightFile,
    "straightness": MachineDeviations,
    "waviness": types_of(Tool)["waviness"],
}
"""Type that each kind of file is read as."""


def _require_whole(machine: dict[str, Any]) -> None:
    """Raise if a machine refers to other files: they would be read from this computer."""
    base, axes, controller = (machine.get(key) for key in ("base", "axes", "controller"))
    responses = (
        [one.get("response") for one in axes.values() if isinstance(one, dict)] if isinstance(axes, dict) else []
    )
    if any(isinstance(one, dict) and "file" in one for one in responses):
        raise InputError(
            "a machine file on the page must not name a response file: state frequency and damping, or use the command "
            "line"
        )
    others = controller.get("other_interpolations") if isinstance(controller, dict) else None
    dialects = [machine.get("dialect"), *(others.values() if isinstance(others, dict) else ())]
    if any(isinstance(one, str) and one not in Dialect.known() for one in dialects):
        raise InputError(
            f"a machine file on the page must name a supplied dialect, {', '.join(Dialect.known())}: state a dialect "
            "file in the job, or use the command line"
        )
    if base is not None and base not in machines():
        raise InputError(f"the base of the machine must be one of {', '.join(machines())}, got {str(base)[:60]!r}")


def machines() -> list[str]:
    """Return the names of the supplied machines."""
    folder = resources.files("turnwright") / "machines"
    return sorted(Path(one.name).stem for one in folder.iterdir() if one.name.endswith(".toml"))


def _unknown_machine(data: dict[str, Any]) -> list[dict[str, str]]:
    """Return a fault for an unknown machine name; a path would be read from this computer."""
    table = data.get("machine")
    name = table.get("name") if isinstance(table, dict) else None
    names = machines()
    if name is None or not isinstance(name, str) or name in names:
        return []
    return [
        {
            "field": "machine.name",
            "sentence": f"machine must be one of {', '.join(names)}, got {name[:60]!r}",
        }
    ]


def require(data: dict[str, Any], folder: str) -> Job:
    """Return the job of a page, or raise an InputError with its first problems."""
    job, problems = read(data, folder)
    if job is None:
        raise InputError("\n".join(one["sentence"] for one in problems[:5]))
    return job


def parse(toml: str, folder: str) -> dict[str, Any]:
    """Return a job file as data, with its problems."""
    try:
        table = read_toml(toml.encode("utf-8", "surrogatepass"), "the job")
        require_flat(table)
    except InputError as error:
        return {"data": {}, "errors": [{"field": "", "sentence": str(error)}]}
    data = json_data(as_tables(table))
    return {"data": data, "errors": read(data, folder)[1]}


def write(data: dict[str, Any], folder: str, before: str = "") -> dict[str, Any]:
    """Return a job as a file, with its problems; comments and layout of the text ``before`` are kept."""
    _, problems = read(data, folder)
    try:
        toml = write_job(data, before)
        toml.encode()
    except (TypeError, ValueError, RecursionError, AttributeError) as error:
        sentence = f"the job cannot be written as TOML ({error})"
        problems = problems or [{"field": "", "sentence": shorten_message(sentence)}]
        return {"toml": "", "errors": problems}
    return {"toml": toml, "errors": problems}


def check(data: dict[str, Any], folder: str) -> dict[str, Any]:
    """Check tool access, length of the program and uncut chip thickness."""
    from turnwright.access import check_access  # noqa: PLC0415
    from turnwright.job import not_evaluated, preview  # noqa: PLC0415

    result: dict[str, Any] = {"errors": [], "access": None, "preview": None, "chips": {}, "warnings": []}
    job, result["errors"] = read(data, folder)
    if job is None:
        return result
    try:
        plan = preview(job)
    except TurnwrightError as error:
        result["errors"] = [{"field": "strategy", "sentence": str(error)}]
        with suppress(TurnwrightError):
            result["access"] = json_data(check_access(job.part.aimed, job.tool, sense=job.strategy.sense))
        return result
    result["access"] = json_data(plan.access)
    result["preview"] = json_data(
        {
            "points": plan.points,
            "shortest_s": plan.shortest_s,
            "refused": plan.refused,
            "shape": plan.shape.facts,
            "remarks": plan.remarks,
            "unjudged": [one.sentence for one in not_evaluated(job, "only a run predicts the surface")],
        }
    )
    result["chips"] = dict(plan.chips)
    accepted = [one.sentence for one in plan.findings if not one.ok and one.name in job.accept]
    result["warnings"] = [*accepted, *plan.warnings]
    points = sum(plan.points.values())
    if points > MAX_POINTS:
        result["errors"] = [{"field": "strategy", "sentence": too_many(points)}]
    return result


def too_many(points: int) -> str:
    """Return the message for a program that is too long for the page."""
    return (
        f"the program must have at most {MAX_POINTS} points on the page, got {points}: increase the feed, reduce the "
        "points per revolution, or use the command line"
    )
