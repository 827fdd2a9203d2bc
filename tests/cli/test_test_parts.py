"""Jobs of test parts: the slopes asked of the nose against closed form, and what they take over from the part's job."""

from pathlib import Path

import numpy as np
import pytest

from turnwright import Job, check_access
from turnwright.errors import JobError
from turnwright.job import make_test_part

EXAMPLES = Path(__file__).parents[2] / "examples"
LENS = {
    "part": {"surface": {"family": "sphere", "radius": "61.5 mm"}, "radius": "5 mm", "stock": "20 um"},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "8 um/rev", "points_per_rev": 360, "spindle_speed": "40 rpm"},
    "simulation": {
        "patches": [{"name": "rim", "centre": ["4.5 mm", "0 mm"], "size": ["50 um", "50 um"], "pixel": "1 um"}]
    },
    "tolerances": {"form_pv": "50 nm", "sq": "10 nm"},
}  # fmt: skip


def test_a_test_part_is_cut_as_the_part_will_be():
    job = Job.read(LENS)
    for kind in ("tilted flat", "concave sphere"):
        made = make_test_part(job, kind)
        assert made.strategy == job.strategy
        assert made.tool == job.tool
        assert made.part.stock == 0.02
        assert made.simulation.patches == ()


def test_the_test_parts_use_the_nose_as_the_part_does():
    """Oracle: the sphere's rim has the slope asin(5 / 61.5) = 4.663 deg; both test parts reach the next tenth."""
    job = Job.read(LENS)
    flat, sphere = (make_test_part(job, kind).part for kind in ("tilted flat", "concave sphere"))
    assert np.rad2deg(check_access(flat, job.tool).sweep) == pytest.approx([-4.7, 4.7], abs=1e-3)
    assert np.rad2deg(check_access(sphere, job.tool).sweep[1]) == pytest.approx(4.7, abs=2e-3)


def test_values_that_are_not_stated_are_found():
    """Oracle: the part's own highest speed, which a test part must not leave; 3 deg for a part without slopes."""
    flat = {**LENS, "part": {"surface": {"family": "plane", "slope": [0.0, 0.0]}, "radius": "2 mm"}}
    flat["strategy"] = {name: value for name, value in LENS["strategy"].items() if name != "spindle_speed"}
    del flat["simulation"]
    made = make_test_part(Job.read(flat), "tilted flat", radius=1.0)
    assert made.part.radius == 1.0
    assert np.rad2deg(np.arctan(made.part.surface.slope[0])) == pytest.approx(3.0)
    # 500 blocks a second, 360 a turn
    assert made.strategy.spindle_rpm == pytest.approx(60 * 500 / 360, abs=1e-2)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"kind": "cube"}, "tilted flat"),
        ({"kind": "tilted flat", "slope": 1.0}, r"57.3 deg, .* 45 deg"),
        ({"kind": "concave sphere", "radius": 0.1, "slope": 0.5}, "nose radius of 0.5 mm"),
    ],
)
def test_what_is_no_test_part_is_refused(asked, words):
    with pytest.raises(JobError, match=words):
        make_test_part(Job.read(LENS), **asked)


def test_a_test_part_can_be_made_of_every_servo():
    for name in ("kong2019_hybrid", "li2018_lens_array"):
        made = make_test_part(Job.load(EXAMPLES / f"{name}.toml"), "concave sphere")
        assert made.strategy.kind == Job.load(EXAMPLES / f"{name}.toml").strategy.kind
