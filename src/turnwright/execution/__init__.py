"""Many cases of anything, on any executor: what is finished is never lost and never computed twice.

It knows nothing of jobs: a case is data, the work a function that turns data into one row of numbers.
"""

from turnwright.execution._conduct import Case, Row, Work, case_key, conduct, program_version
from turnwright.execution._executors import (
    Cluster,
    LocalPool,
    WorkerDied,
    cluster,
    fitting,
    local,
    require_reach,
    share_of,
)
from turnwright.execution._store import Store

__all__ = [
    "Case",
    "Cluster",
    "LocalPool",
    "Row",
    "Store",
    "Work",
    "WorkerDied",
    "case_key",
    "cluster",
    "conduct",
    "fitting",
    "local",
    "program_version",
    "require_reach",
    "share_of",
]
