"""One case of a study, in a worker: from the data of a job to a row of measures."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from turnwright.job import Job, Pipeline
from turnwright.studies.files import provide_files, relocate_paths
from turnwright.studies.measures import evaluate, measure_of

if TYPE_CHECKING:
    from turnwright.studies.store import Store

__all__ = ["REFUSED", "SECONDS", "carry_out"]

REFUSED = "refused"
"""Column with the reason why `run` would refuse a job that can still be measured."""

SECONDS = "seconds"
"""Column with the computing time of a case. [s]"""


def carry_out(data: Mapping[str, Any], shared: Mapping[str, Any], store: Store | None) -> dict[str, Any]:
    """Return the row of a case: its measures, the reason why `run` would refuse it, and its computing time."""
    start = time.perf_counter()
    with provide_files(data["files"], shared.get("files", {}), store) as places:
        job = Job.read(relocate_paths(data["job"], places))
        pipeline = Pipeline(job)
        functions = shared.get("own", {})
        measures = [measure_of(job, functions.get(name, name)) for name in shared["measures"]]
        row = evaluate(pipeline, measures)
    if pipeline.refused:
        row[REFUSED] = "; ".join(pipeline.refused)
    row[SECONDS] = round(time.perf_counter() - start, 4)
    return row
