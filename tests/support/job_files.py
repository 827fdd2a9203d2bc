"""A small good job, and how tests change and write it."""

import copy
from pathlib import Path

import tomli_w

SMALL = {
    "part": {"name": "dish", "radius": "1 mm", "surface": {"family": "sphere", "radius": "50 mm"}},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 120},
    "simulation": {
        "whole_part": {"radii": 41, "angles": 24},
        "patches": [{"name": "patch", "centre": ["0.5 mm", "0 mm"], "size": ["200 um", "200 um"], "pixel": "1 um"}],
    },
}

GONE = object()


def changed(*changes):
    """The small job with (dotted place, value) changes; GONE removes a key, a number in a place counts from 0."""
    job = copy.deepcopy(SMALL)
    for place, value in changes:
        *above, last = place.split(".")
        table = job
        for key in above:
            table = table[int(key)] if isinstance(table, list) else table.setdefault(key, {})
        if value is GONE:
            del table[last]
        else:
            table[last] = copy.deepcopy(value)
    return job


def written(folder: Path, *changes) -> Path:
    path = folder / "job.toml"
    path.write_text(tomli_w.dumps(changed(*changes)), encoding="utf-8")
    return path
