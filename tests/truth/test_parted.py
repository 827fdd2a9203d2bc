"""A place predicted from its own share of a finishing pass.

Oracle: the same place from the whole pass, every point of it planned, placed and driven by `run`'s own stages.
"""

import copy

import numpy as np
import pytest

from turnwright.job import Job, PassPlan, Pipeline, predict, run
from turnwright.job.window import can_predict_window, predict_window

GRID = {"family": "sine grid", "amplitude": ["3 um", "2 um"], "period": ["0.9 mm", "1.3 mm"]}
LENSES = {
    "family": "lens array", "layout": "square", "pitch": "0.8 mm", "rows": 4, "columns": 4,
    "lenslet": {"family": "sphere", "radius": "12 mm"},
}  # fmt: skip
STEPS = {
    "family": "lens array", "layout": "square", "pitch": "0.9 mm", "rows": 3, "columns": 3, "aperture": "0.3 mm",
    "lenslet": {"family": "sphere", "radius": "9 mm"}, "surround": "2 um",
}  # fmt: skip
BOWL = [{"family": "sphere", "radius": "30 mm"}, {"family": "plane", "slope": [0.01, 0.004]}]
BASE = {
    "part": {"surface": GRID, "radius": "1.5 mm"},
    "tool": {"nose_radius": "0.3 mm", "included": "120 deg", "clearance": "12 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 240, "spindle_speed": "60 rpm"},
    "simulation": {
        "whole_part": {"radii": 150, "angles": 12},
        "patches": [
            {"name": "aside", "centre": ["0.61 mm", "-0.43 mm"], "size": ["60 um", "50 um"], "pixel": "1.7 um"},
            {"name": "axis", "centre": ["0.01 mm", "0 mm"], "size": ["60 um", "60 um"], "pixel": "1.7 um"},
            {"name": "rim", "centre": ["-1.40 mm", "0.1 mm"], "size": ["60 um", "60 um"], "pixel": "1.9 um"},
        ],
    },
    "accept": ["nose radius", "included angle", "clearance", "valley", "step", "limits"],
}
CASES = {
    "as it is": {},
    "outward": {"strategy.inside_out": True, "strategy.sense": -1},
    "overrun": {"strategy.overrun": "1.75 um"},
    "constant arc": {"strategy.arc_length": "9 um", "strategy.points_per_rev": None},
    "constant arc and angle": {
        "strategy.arc_length": "9 um", "strategy.max_step": "1.5 deg", "strategy.points_per_rev": None,
    },
    "lenses": {"part.surface": LENSES},
    "steps": {"part.surface": STEPS},
    "bowl": {"part.surface": BOWL},
    "planned deviations": {"tool.offset": ["3 um", "0 um", "2 um"], "tool.radius_error": "1 um"},
    "actual tool": {
        "actual.tool.offset": ["4 um", "0 um", "1 um"], "actual.tool.radius_error": "-2 um",
        "actual.tool.waviness": ["0 mm/rad", "1e-5 mm/rad^2", "4e-4 mm/rad^3"],
    },
    "actual machine": {"actual.machine.squareness": "20 arcsec", "machine.squareness": "-7 arcsec"},
    "fast tool": {
        "strategy.kind": "fast tool servo", "machine.name": "nanoform-fts-70", "program.fast_tool": "position",
    },
}  # fmt: skip


def job_with(changes):
    data = copy.deepcopy(BASE)
    for name, value in changes.items():
        *tables, last = name.split(".")
        node = data
        for table in tables:
            node = node.setdefault(table, {})
        if value is None:
            del node[last]
        else:
            node[last] = value
    return Job.read(data)


PROOF = ("outward", "overrun", "constant arc", "bowl", "actual machine")
"""Cases of which the others are like, or harder."""


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.proof] * (one in PROOF)) for one in CASES])
def test_one_part_of_the_path_leaves_the_same_surface(name):
    job = job_with(CASES[name])
    assert can_predict_window(job)
    motion = PassPlan(job).commanded
    parted = 0
    for one in predict(job, motion):
        share = predict_window(job, one.name)
        if share is not None:
            parted += 1
            # 0.01 nm is asked for; what is left is rounding.
            np.testing.assert_allclose(share.error.z, one.error.z, rtol=0, atol=1e-12)
            assert share.roughness.sq_nm == pytest.approx(one.roughness.sq_nm, rel=1e-9)
    assert parted >= 2


@pytest.mark.parametrize(
    "changes",
    [
        {"strategy.along": "normal"},
        {"strategy.chord": "1 nm", "strategy.points_per_rev": None},
        {"tool.rake": "-5 deg"},
        {"actual.tool.offset": ["0 um", "3 um", "0 um"]},
    ],
)
def test_a_job_that_depends_on_the_whole_path_is_not_parted(changes):
    assert not can_predict_window(job_with(changes))


def test_access_is_that_of_the_file_as_it_is_now(tmp_path):
    file, at = tmp_path / "sag.csv", np.linspace(-2, 2, 41)
    job = {"part.surface": {"family": "gridded", "file": str(file), "units": "mm", "sag_units": "mm"}}

    def limit(radius):
        rows = ["," + ",".join(f"{x:.1f}" for x in at)]
        rows += [f"{y:.1f}," + ",".join(f"{(x * x + y * y) / (2 * radius):.12f}" for x in at) for y in at]
        file.write_text("\n".join(rows), encoding="utf-8")
        return Pipeline(job_with(job)).access.nose_radius_limit

    # A paraboloid has its radius at the vertex.
    assert limit(10.0) == pytest.approx(10, rel=1e-3)
    assert limit(20.0) == pytest.approx(20, rel=1e-3)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"part.stock": "20 um", "part.material": "IRG 26", "passes": [
            {"name": "rough", "feed": "15 um/rev", "allowance": "4 um", "depth": "9 um"}, {"name": "finish"},
        ]},
        {"machine.name": "nanotech-350fg", "strategy.along": "normal", "strategy.spindle_speed": None},
    ],
    ids=["a pass", "three passes", "along the normal, at the highest speed"],
)  # fmt: skip
def test_the_stages_of_a_job_are_those_of_its_run(changes):
    job = job_with({"strategy.feed": "14 um/rev", **changes})
    stages, result = Pipeline(job), run(job)
    assert stages.access == result.access
    assert [one.name for one in stages.passes] == [one.name for one in result.passes]
    for one, other in zip(stages.passes, result.passes, strict=True):
        assert (one.allowance, one.depth, one.feed, one.points) == (
            other.allowance, other.depth, other.feed, other.points,
        )  # fmt: skip
        assert one.limits == other.limits
    assert stages.minutes == pytest.approx(sum(one.limits.cycle_time_s for one in result.passes) / 60, rel=1e-15)
    assert float(stages.path.clearance.min()) == result.least_clearance
    if job.part.substance is not None:
        assert stages.chips == tuple(one.chips for one in result.passes)
    # A run looks at the program on disk: they are as far apart as its decimals are.
    for one in result.predictions:
        apart = np.nanmax(np.abs(stages.prediction(one.name).error.z - one.error.z)) * 1e6
        assert apart <= result.rounding_limit_nm
