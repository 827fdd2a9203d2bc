"""A map that is plainly not of its part as the job places it is reported. Oracle: how it was spoilt."""

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from job_files import written
from turnwright.cli import main
from turnwright.errors import CorrectionError
from turnwright.job import Job

TERMS = {"2,0": "1e-3 1/mm", "0,2": "2e-3 1/mm", "3,0": "2e-4 1/mm^2", "1,2": "-1e-4 1/mm^2"}
FREEFORM = (
    ("part.radius", "3 mm"),
    ("part.surface", {"family": "xy polynomial", "terms": TERMS}),
    ("measurement.reach", "0.5 mm"),
)
SPHERE = (("part.radius", "2 mm"), ("part.surface", {"family": "sphere", "radius": "20 mm"}))
FLAT = (("part.radius", "2 mm"), ("part.surface", {"family": "plane"}))


def shown(job, cone=0.0, count=61, noise=5e-6):
    """Heights of a part that is off by a cone, and by 20 nm of astigmatism."""
    radius = job.part.radius
    axis = np.linspace(-radius, radius, count)
    x, y = np.meshgrid(axis, axis)
    z = job.part.surface.sag(x, y) + 40e-6 * x * y / radius**2 + cone * np.hypot(x, y) / radius
    z += noise * np.random.default_rng(3).normal(size=z.shape)
    return tw.HeightMap(x=axis, y=axis, z=np.where(np.hypot(x, y) < 0.975 * radius, z, np.nan), name="seen")


@pytest.fixture
def freeform(tmp_path):
    return Job.load(written(tmp_path, *FREEFORM))


SPOILT = {
    "mirrored": (lambda a, z: (a, z[:, ::-1]), "mirrored = true"),
    "turned": (lambda a, z: (a, z[::-1, ::-1]), 'rotation = "180 deg"'),
    "inverted": (lambda a, z: (a, -z), "with inverted = true in"),
    "too large": (lambda a, z: (1.5 * a, z), "pixel size"),
    "micrometres": (lambda a, z: (a, 1e3 * z), "unit of the heights"),
    "nothing": (lambda a, z: (a, 0 * z), "Check"),
    "missing is 0": (lambda a, z: (a, np.nan_to_num(z)), "heights are exactly 0"),
    "another": (lambda a, z: (a, z - z + (a**2 + a[:, None] ** 2) / 60), "the part."),
}


@pytest.mark.parametrize("how", SPOILT)
def test_a_map_of_another_part_is_reported(freeform, how):
    spoil, words = SPOILT[how]
    good = shown(freeform)
    axis, z = spoil(good.x, good.z)
    measured = tw.measure(freeform, tw.HeightMap(x=axis, y=axis, z=z, name="seen"))
    assert measured.mismatch is not None
    assert "'seen' do not match this part" in measured.mismatch
    assert words in measured.mismatch
    assert measured.open_questions[0] == measured.mismatch


PARTS = {"freeform": FREEFORM, "sphere": SPHERE, "flat": FLAT}


@pytest.mark.parametrize(("part", "size"), every_second(PARTS, [0.5e-3, 0.0]))
def test_a_part_that_is_off_is_still_the_part(tmp_path, part, size):
    """By 0.5 um of a cone, which a tool offset or a slide out of square leaves."""
    job = Job.load(written(tmp_path, *PARTS[part]))
    measured = tw.measure(job, shown(job, size))
    assert measured.mismatch is None


def test_a_concave_map_of_a_convex_part_is_reported(tmp_path):
    job = Job.load(written(tmp_path, *SPHERE))
    good = shown(job)
    measured = tw.measure(job, tw.HeightMap(x=good.x, y=good.y, z=-good.z))
    assert "inverted = true" in measured.mismatch


def test_nothing_is_corrected_by_a_map_of_something_else(freeform, tmp_path, capsys):
    """By one map, and by several if one of them is: exit code 3, and no folder. Oracle: the part as it lies."""
    good = shown(freeform, count=41)
    placed = tw.measure(freeform, good)
    found = tw.diagnose(placed)
    again = shown(freeform, count=41, noise=6e-6)
    turned = tw.measure(freeform, tw.HeightMap(x=good.x, y=good.y, z=again.z[:, ::-1], name="turned"))
    for every in (turned, [placed, turned]):
        with pytest.raises(CorrectionError, match="'turned' do not match this part"):
            tw.correct(freeform, found, every, out=tmp_path / "out")
    tw.write_map(turned.heights, tmp_path / "turned.npz")
    arguments = [str(tmp_path / "turned.npz"), "--job", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]
    there = sorted(tmp_path.iterdir())
    assert main(["correct", *arguments]) == 3
    assert "mirrored = true" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == there
    assert main(["measure", *arguments]) == 0
    assert "do not match this part" in capsys.readouterr().err
