"""Inject, measure, diagnose and correct in spindle mode: the symmetric part goes, the rest is stated."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
import turnwright.diagnosis.report as _draws
import turnwright.job.correction as _correct
from turnwright.job import Job, correct, diagnose, measure
from turnwright.job.pass_plan import motion_of
from turnwright.strategy import turning

RADIUS = 8.0
OFFSET = (0.003, 0.0, 0.0)
ASTIGMATISM = 3e-5


def symmetric_form(x, y):
    return 8e-5 * ((x**2 + y**2) / RADIUS**2) ** 2


def form(x, y):
    return symmetric_form(x, y) + ASTIGMATISM * (x**2 - y**2) / RADIUS**2


@pytest.fixture
def job():
    return Job.read({
        "part": {"surface": {"family": "conic", "radius": "60 mm", "conic": -1.0}, "radius": "8 mm"},
        "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
        "machine": {"name": "nanoform"},
        "strategy": {"kind": "turning", "feed": "10 um/rev", "spindle_speed": "1000 rpm", "chord": "1 nm"},
        "measurement": {"free": ["z", "tilt_x", "tilt_y"], "fixed": ["decentre", "clocking"], "min_effect": "0.1 nm"},
    })  # fmt: skip


def cut(job, x, y):
    tool = replace(job.tool, offset=OFFSET) if job.tool.offset == (0.0, 0.0, 0.0) else job.tool
    real = replace(tool, offset=OFFSET)
    return tw.generate_points(motion_of(job), real, x=x, y=y) + form(x, y)


def means(job, radii, angles):
    """Form error over whole feeds, by radius and azimuth. [mm]."""
    across = radii[:, None] + 0.01 * ((np.arange(16) + 0.5) / 16 - 0.5)
    r, t = np.broadcast_arrays(across[None], angles[:, None, None])
    x, y = (r * np.cos(t)).ravel(), (r * np.sin(t)).ravel()
    return (cut(job, x, y) - job.part.surface.sag(x, y)).reshape(r.shape).mean(axis=-1)


def test_the_symmetric_part_is_corrected_and_the_rest_is_stated(job, tmp_path, monkeypatch):
    monkeypatch.setattr(turning, "MERIDIAN_SAMPLES", 2000)  # by which points are spread, not their heights
    monkeypatch.setattr(_draws, "DRAWS", 50)
    monkeypatch.setattr(_draws, "FULL_CASES", 2)
    monkeypatch.setattr(_correct, "MAX_PREDICTED_POINTS", 4_000)
    monkeypatch.setattr(_correct, "MAX_SIMULATED_PLACES", 200)
    axis = np.linspace(-RADIUS, RADIUS, 81)
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) < 7.9
    z = np.full(x.shape, np.nan)
    z[inside] = cut(job, x[inside], y[inside])
    z += 3e-6 * np.random.default_rng(4).normal(size=z.shape)
    part = measure(job, tw.HeightMap(x=axis, y=axis, z=z, name="part"))
    better = correct(job, diagnose(part), part, out=tmp_path)
    stated = [one for one in better.sentences if "vary with the azimuth" in one]
    expected = ASTIGMATISM * np.sqrt(1 / 6) * 1e6
    assert float(stated[0].split("axis is corrected: ")[1].split()[0]) == pytest.approx(expected, rel=0.1)
    radii, angles = np.linspace(0.5, 7.6, 40), np.linspace(0, 2 * np.pi, 12, endpoint=False)
    before, after = (means(one, radii, angles) for one in (job, better.job))
    off = [one.mean(axis=0) for one in (before, after)]
    residual = [np.std(one - np.polyval(np.polyfit(radii**2, one, 0), radii**2)) * 1e6 for one in off]
    assert residual[0] > 10
    assert residual[1] < 2.0
    around = [one - one.mean(axis=0) for one in (before, after)]
    assert np.abs(around[1] - around[0]).max() < 1e-6  # nothing is added around the axis
