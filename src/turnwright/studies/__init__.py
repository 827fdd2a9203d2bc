"""Parameter studies, tolerance studies, and maps of whole parts in tiles."""

from turnwright.studies.budget import ErrorBudget, Spread
from turnwright.studies.cases import Case, Row, Work, case_key, program_version, run_cases
from turnwright.studies.designs import DESIGNS
from turnwright.studies.executors import (
    Cluster,
    LocalPool,
    WorkerDied,
    cluster,
    count_threads,
    count_workers,
    local,
    require_reach,
)
from turnwright.studies.measures import MEASURES
from turnwright.studies.sensitivity import Interval
from turnwright.studies.store import Store
from turnwright.studies.tiled_map import TiledMap
from turnwright.studies.tiles import generate_tiled, plan_tiles
from turnwright.studies.tolerancing import Outcome, Sensitivity, Tightening, ToleranceStudy, tolerance
from turnwright.studies.variation import Column, Grid, Study, study

__all__ = [
    "DESIGNS",
    "MEASURES",
    "Case",
    "Cluster",
    "Column",
    "ErrorBudget",
    "Grid",
    "Interval",
    "LocalPool",
    "Outcome",
    "Row",
    "Sensitivity",
    "Spread",
    "Store",
    "Study",
    "Tightening",
    "TiledMap",
    "ToleranceStudy",
    "Work",
    "WorkerDied",
    "case_key",
    "cluster",
    "count_threads",
    "count_workers",
    "generate_tiled",
    "local",
    "plan_tiles",
    "program_version",
    "require_reach",
    "run_cases",
    "study",
    "tolerance",
]
