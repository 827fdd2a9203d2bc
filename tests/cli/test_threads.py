"""Several threads find what a single one finds, which is all that each process of the suite has on a small machine."""

import numpy as np
import pytest

import turnwright as tw
from job_files import written
from turnwright import progress
from turnwright.job import Job, run

AXIS = np.linspace(-1, 1, 61)
PATCH = {"name": "patch", "centre": ["0 mm", "0 mm"], "size": ["80 um", "80 um"], "pixel": "1 um"}
GRIDS = {"whole_part": {"radii": 41, "angles": 40}, "patches": [PATCH]}


def seen(job):
    """The small part with an error, noise and a spike, as an instrument shows it."""
    x, y = np.meshgrid(AXIS, AXIS)
    z = job.part.surface.sag(x, y) + 3e-4 * np.hypot(x, y) ** 2 + 1e-4 * x**3
    z += 5e-6 * np.random.default_rng(3).normal(size=z.shape)
    z[24, 24] += 1e-2
    return tw.HeightMap(x=AXIS, y=AXIS, z=np.where(np.hypot(x, y) < 0.97, z, np.nan))


@pytest.fixture
def share(monkeypatch):
    """Give this process so many threads, whatever the machine has."""

    def give(threads):
        monkeypatch.setattr(progress, "_count_cores", lambda: threads)
        monkeypatch.setenv(progress.THREADS, str(threads))
        assert progress.cores() == threads

    return give


@pytest.mark.parametrize("offset", ["0 um", "5 um"])
def test_a_run_is_the_same_on_any_number_of_threads(offset, tmp_path, share):
    """To the last bit: program and maps, also of a tool off centre, which is simulated in another way."""
    job = Job.load(written(tmp_path, ("actual.tool.offset", ["1 um", offset, "0 um"]), ("simulation", GRIDS)))
    found = []
    for threads in (1, 3):
        share(threads)
        result = run(job, out=tmp_path / str(threads))
        heights = [one.error.z for one in result.predictions]
        found.append(((tmp_path / str(threads) / "part.nc").read_bytes(), result.predictions[0].form, heights))
    one, other = found
    assert one[:2] == other[:2]
    assert all(np.array_equal(*pair, equal_nan=True) for pair in zip(one[2], other[2], strict=True))


def test_a_diagnosis_is_the_same_on_any_number_of_threads(tmp_path, share):
    """As closely as sums in another order are; so are a robust filter's."""
    job, found = Job.load(written(tmp_path)), []
    for threads in (1, 3):
        share(threads)
        measured = tw.measure(job, seen(job))
        smooth = tw.metrology.filter_map(measured.heights, kind="robust", cutoff=0.2)
        values = [one.value for one in tw.diagnose(measured).findings]
        found.append([measured.form_rms_nm, np.nanstd(smooth.z), *values])
    assert found[0] == pytest.approx(found[1], rel=1e-6, abs=1e-9)
