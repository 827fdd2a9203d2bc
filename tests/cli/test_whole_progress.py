"""One line for the whole run: it never falls, ends at 1, and names every stage that is carried out."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import turnwright as tw
from job_files import written
from turnwright.cli import main, shared as _shared
from turnwright.diagnosis import report as _draws
from turnwright.job import Job
from turnwright.progress import OverallProgress

DISH = (
    ("part.radius", "0.65 mm"),
    ("tolerances", {"form_pv": "1 um", "sq": "50 nm"}),
    ("strategy.overrun", "5 um"),
    ("strategy.spindle_speed", "100 rpm"),
)
WITH_PASSES = (
    *DISH,
    ("part.stock", "4 um"),
    ("part.material", "Ge"),
    ("passes", [{"name": "rough", "allowance": "2 um", "depth": "1 um"}, {"name": "finish"}]),
)

FINE = (*DISH, ("strategy.feed", "20 um/rev"), ("strategy.points_per_rev", 90))


@pytest.fixture
def lines(monkeypatch):
    """What a terminal is shown, and the stages that it comes from."""
    shown = []

    class Recorded(OverallProgress):
        def __init__(self, steps, listener):
            self.known, self.stages, self.seen = [one.stage for one in steps], [], []
            shown.append(self)
            super().__init__(steps, lambda one: (self.seen.append(one), listener(one)))

        def __call__(self, stage, done, total):
            if not self.stages or self.stages[-1] != stage:
                self.stages.append(stage)
            super().__call__(stage, done, total)

    monkeypatch.setattr(_shared, "OverallProgress", Recorded)
    terminal = SimpleNamespace(isatty=lambda: True)
    monkeypatch.setattr(_shared, "sys", SimpleNamespace(stderr=terminal, stdout=sys.stdout))
    return shown


@pytest.fixture(scope="module")
def heights(tmp_path_factory):
    """A map of the dish, cut with a tool offset of 2 um, 3 nm of noise on it."""
    file = tmp_path_factory.mktemp("map") / "dish.x3p"
    axis = np.linspace(-0.65, 0.65, 41)
    x, y = np.meshgrid(axis, axis)
    z = (
        50
        - np.sqrt(50**2 - x**2 - y**2)
        + 2e-3 * np.hypot(x, y) / 50
        + 3e-6 * np.random.default_rng(1).normal(size=x.shape)
    )
    tw.write_map(tw.HeightMap(x=axis, y=axis, z=np.where(np.hypot(x, y) < 0.64, z, np.nan)), file)
    return str(file)


def command_of(kind, folder, heights):
    job = str(written(folder, *{"run": WITH_PASSES, "correct": FINE}.get(kind, DISH)))
    out = ["--out", str(folder / "planned.toml" if kind == "plan" else folder / "out")]
    if kind in ("measure", "correct", "diagnose"):
        return [kind, heights, "--job", job, *out]
    if kind == "tolerance":
        return [kind, job, "--cases", "10", "--no-correction", "--workers", "1", *out]
    return [kind, job] if kind == "check" else [kind, job, *out]


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("kind", ["run", "check", "plan", "compare", "measure", "diagnose", "correct", "tolerance"])
def test_the_whole_run_has_one_line_that_never_falls(kind, tmp_path, lines, heights, capsys, monkeypatch):
    monkeypatch.setattr(_draws, "DRAWS", 25)
    assert main(command_of(kind, tmp_path, heights)) in (0, 4)
    (line,) = lines
    fractions = [one.fraction for one in line.seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1
    assert fractions[-2] > 0.5  # the last step is not most of it
    assert all(math.isfinite(one.left_s) and one.left_s >= 0 for one in line.seen)
    assert line.seen[-1].left_s == 0
    steps = [one.step for one in line.seen]
    assert steps == sorted(steps)
    assert all(1 <= one <= len(line.known) for one in steps)
    assert set(line.stages) == set(line.known)
    assert "done" in capsys.readouterr().err
    if kind == "run":
        repeated_passes_are_steps_of_their_own(line)


def repeated_passes_are_steps_of_their_own(line):
    """Oracle: a stock of 4 um, 2 um to leave and 1 um at a time are two cuts, and one more finishes."""
    assert [line.known.count(one) for one in ("place", "limits", "chips", "write program")] == [2, 3, 3, 1]
    report = [(one.step, one.stage) for one in line.seen]
    assert len({step for step, stage in report if stage == "limits"}) == 3
    assert len({step for step, stage in report if stage == "place"}) == 2


@pytest.mark.parametrize(
    "way", [{"points_per_rev": 120}, {"arc_length": "50 um", "max_step": "5 deg"}, {"chord": "10 nm"}]
)
def test_the_points_of_a_pass_are_foreseen(way, tmp_path):
    """Oracle: the points that are counted when the spiral is made; half or twice as many are near enough for a bar."""
    from turnwright.job.time_estimate import _points

    surface = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["0.5 mm", "0.5 mm"]}
    strategy = {"kind": "slow tool servo", "feed": "20 um/rev", **way}
    job = Job.load(written(tmp_path, ("part.surface", surface), ("strategy", strategy)))
    real = job.servo(job.passes[-1]).extent(job.part.aimed, job.tool)[0]
    assert 0.5 < _points(job, job.passes[-1]) * 1e6 / real < 2
