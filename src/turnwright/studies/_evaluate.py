"""One case of a study, in a worker: from the data of a job to a row of measures."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.errors import StudyError
from turnwright.job import Job, Stages
from turnwright.studies._measures import Measure, evaluate, measure_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from turnwright.execution import Store

__all__ = ["REFUSED", "SECONDS", "carry_out", "files_of", "kept_files"]

REFUSED = "refused"
"""Column of why `run` would refuse a job whose measures are there all the same."""

SECONDS = "seconds"
"""Column of what a case took."""


def carry_out(data: Mapping[str, Any], shared: Mapping[str, Any], store: Store | None) -> dict[str, Any]:
    """Return the row of a case: its measures, why `run` would refuse it, and what it took.

    Parameters
    ----------
    data
        The data of the job, and the digests of the files that it names.
    shared
        The names of the measures, functions of one's own by name, and under which names the store has the files.
    store
        Where to find files that this machine does not have.
    """
    start = time.perf_counter()
    with _at_hand(data["files"], shared.get("files", {}), store) as places:
        job = Job.read(_moved(data["job"], places))
        stages = Stages(job)
        own = shared.get("own", {})
        measures = [_measure(job, name, own) for name in shared["measures"]]
        row = evaluate(stages, measures)
    if stages.refused:
        row[REFUSED] = "; ".join(stages.refused)
    row[SECONDS] = round(time.perf_counter() - start, 4)
    return row


def _measure(job: Job, name: str, own: Mapping[str, Any]) -> Measure:
    return Measure(name=name, unit="", stage="place", own=own[name]) if name in own else measure_of(job, name)


def files_of(job: Job) -> dict[str, str]:
    """Return the files that a job names, by their whole path, with the digest of what is in them."""
    found = {str(path) for path in _paths(job.model_dump())}
    material = job.part.material
    if material.endswith(".toml"):
        found.add(material)
    return {path: hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in sorted(found)}


def _paths(value: Any) -> Iterator[Path]:
    """Yield the files in the data of a job."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _paths(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _paths(one)


def kept_files(files: Mapping[str, str], store: Store | None) -> dict[str, str]:
    """Keep files in a store, for workers on machines that do not have them; return what the store calls them."""
    if store is None:
        return {}
    return {path: store.put_array("file", np.frombuffer(Path(path).read_bytes(), dtype=np.uint8)) for path in files}


@contextmanager
def _at_hand(files: Mapping[str, str], kept: Mapping[str, str], store: Store | None) -> Iterator[dict[str, str]]:
    """Yield where the files of a job are on this machine, those that are elsewhere than the job says."""
    missing = {path: digest for path, digest in files.items() if not _is_there(path, digest)}
    if not missing:
        yield {}
        return
    if store is None or any(path not in kept for path in missing):
        raise StudyError(
            f"a worker does not have {len(missing)} of the files that the job names, such as {next(iter(missing))!r}: "
            "give the study a store that all machines reach"
        )
    with tempfile.TemporaryDirectory(prefix="turnwright-") as folder:
        places = {}
        for number, path in enumerate(missing):
            place = Path(folder) / str(number) / Path(path).name
            place.parent.mkdir()
            place.write_bytes(np.asarray(store.array(kept[path])).tobytes())
            places[path] = str(place)
        yield places


def _is_there(path: str, digest: str) -> bool:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest() == digest
    except OSError:
        return False


def _moved(value: Any, places: Mapping[str, str]) -> Any:
    """Return data with files where they are on this machine."""
    if not places:
        return value
    if isinstance(value, str):
        return places.get(value, value)
    if isinstance(value, Mapping):
        return {key: _moved(one, places) for key, one in value.items()}
    return [_moved(one, places) for one in value] if isinstance(value, list) else value
