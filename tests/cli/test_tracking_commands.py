"""Predictions with the axes as they really move, by job, by command line and by controller. Oracle: the library."""

import json

import numpy as np
import pytest

import turnwright as tw
from job_files import written
from turnwright.cli import main
from turnwright.report import read_maps

SERVO = """
name = "lathe with servos"
spindle_rpm = 500
block_rate_hz = 2000
{more}
[axes.C]
[axes.X.response]
frequency = "100 Hz"
damping = 0.7
velocity_feedforward = 1.0
[axes.Z.response]
frequency = "60 Hz"
damping = 0.7
"""
WAVES = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["1 mm", "1 mm"]}
CHANGES = [
    ("machine", {"file": "lathe.toml"}), ("part.surface", WAVES), ("strategy.spindle_speed", "120 rpm"),
]  # fmt: skip


def lathe(folder, more=""):
    (folder / "lathe.toml").write_text(SERVO.format(more=more), encoding="utf-8")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    lathe(folder)
    job = written(folder, *CHANGES, ("simulation.tracking", True))
    assert main(["run", str(job), "--out", str(folder / "out")]) == 0
    return folder


def test_a_run_predicts_what_the_servos_make_of_its_program(done):
    job = tw.Job.load(done / "job.toml")
    reported = json.loads((done / "out" / "result.json").read_text())["predictions"]
    motion = tw.read_nc(done / "out" / "part.nc", job.machine)
    real = tw.track(motion)
    for one, axes in zip(reported, (("radius", "angle"), ("x", "y")), strict=True):
        grid = {name: np.load(done / "out" / one["axes"][name]) for name in axes}
        make = tw.generate_polar if "radius" in grid else tw.generate
        with_servos, without = (make(each, job.tool, **grid) for each in (real, motion))
        error = with_servos.minus(job.part.surface).z
        np.testing.assert_allclose(np.load(done / "out" / one["file"]), error, atol=1e-12)
        added = np.load(done / "out" / one["tracking"]["file"])
        np.testing.assert_allclose(added, with_servos.z - without.z, atol=1e-12)
        assert one["tracking"]["pv_nm"] == pytest.approx(np.ptp(added) * 1e6, rel=1e-9)
        weights = np.ones(added.shape[1])
        if "radius" in grid:  # integrals of r times the straight hat over each radius, the rim's and the axis' halved
            step = grid["radius"][1]
            weights = grid["radius"] * step
            weights[0], weights[-1] = step**2 / 6, weights[-1] / 2 - step**2 / 6
        mean = np.average((added**2).mean(axis=0), weights=weights)
        assert one["tracking"]["rms_nm"] == pytest.approx(np.sqrt(mean) * 1e6, rel=1e-9)
        assert one["tracking"]["pv_nm"] > 20
    page = (done / "out" / "report.html").read_text()
    assert page.count("Servo contribution: ") == 2
    assert "Servo contribution, PV" in page
    assert set(read_maps(done / "out" / "run.h5")) == {"patch", "whole part"}


def test_a_backplot_tracks_any_program(done, tmp_path, capsys):
    without = written(tmp_path, *CHANGES)
    lathe(tmp_path)
    program = str(done / "out" / "part.nc")
    assert main(["backplot", program, "--job", str(without), "--track", "--out", str(tmp_path / "maps")]) == 0
    message = capsys.readouterr()
    assert "servo contribution" in message.out
    assert "track" in message.err.split()
    reported = json.loads((tmp_path / "maps" / "backplot.json").read_text())
    for one in reported:
        for file in (one["file"], one["tracking"]["file"]):
            np.testing.assert_array_equal(np.load(tmp_path / "maps" / file), np.load(done / "out" / file))
    assert main(["backplot", program, "--job", str(without)]) == 0
    assert "servos" not in capsys.readouterr().out


def test_known_servos_are_not_left_out_silently(tmp_path):
    lathe(tmp_path)
    result = tw.run(tw.Job.load(written(tmp_path, *CHANGES)))
    assert any("set tracking = true" in one for one in result.warnings)
    assert all(one.tracking is None and one.tracking_nm is None for one in result.predictions)


def test_servos_that_are_not_stated_cannot_be_requested(done, tmp_path, capsys):
    job = written(tmp_path, ("simulation.tracking", True))
    assert main(["check", str(job)]) == 2
    assert "simulation.tracking: tracking needs a servo response" in capsys.readouterr().err
    job = written(tmp_path, *CHANGES[1:])
    assert main(["backplot", str(done / "out" / "part.nc"), "--job", str(job), "--track"]) == 2
    assert "states it for 0 of 3 axes" in capsys.readouterr().err


def test_pvt_controller_is_always_predicted_with_cubics(tmp_path):
    """Few points: straight lines would miss the waves by their chords, the cubics of a PVT program do not."""
    lathe(tmp_path, 'dialect = "pmac"\n[controller]\ninterpolation = "hermite"')
    few = [*CHANGES, ("strategy.points_per_rev", 60), ("simulation.patches", [])]
    result = tw.run(tw.Job.load(written(tmp_path, *few)), out=tmp_path)
    assert all(one.velocity is not None for one in result.revolutions)
    text = result.program.files[0].read_text()
    assert "PVT" in text
    part, tool = result.part, result.tool
    again = tw.read_nc(result.program.files[0], result.machine)
    error = result.predictions[0].error
    straight = tw.generate_polar(again, tool, radius=error.radius, angle=error.angle).minus(part.surface)
    ring = error.radius < 0.9  # the program starts from rest outside
    # A wave of 2 um and 1 mm in steps of 0.094 mm: the sags of chords and of cubics, and 1 nm between track's samples.
    phase = 2 * np.pi * 0.9 * (2 * np.pi / 60)
    assert straight.z[:, ring].min() < -0.25 * 2e-3 * phase**2 / 8
    assert error.z[:, ring].min() > -2e-3 * phase**4 / 384 - 1e-6


def test_a_corrected_program_leaves_what_was_planned(done, tmp_path, capsys):
    """Oracle: the servos' share of the same job without the correction, and the library's own correction."""
    lathe(tmp_path)
    job = tw.Job.load(
        written(tmp_path, *CHANGES, ("simulation.tracking", True), ("program.precorrect", True),
                ("strategy.points_per_rev", 360))
    )  # fmt: skip
    result = tw.run(job, out=tmp_path)
    before = json.loads((done / "out" / "result.json").read_text())["predictions"]
    part, tool, machine = job.part, job.tool, job.machine
    servo = tw.SlowToolServo(feed=0.02, points_per_rev=360, spindle_rpm=120)
    planned = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
    again = tw.read_nc(result.program.files[0], machine)
    command = tw.precorrect(planned)
    assert np.abs(command.axes["Z"] - planned.axes["Z"]).max() > 1e-4
    assert np.abs(again.axes["Z"] - command.axes["Z"]).max() < 0.51e-6
    for one, uncorrected in zip(result.predictions, before, strict=True):
        meant = (
            tw.generate_polar(planned, tool, radius=one.error.radius, angle=one.error.angle)
            if one.error.polar
            else (tw.generate(planned, tool, x=one.error.x, y=one.error.y))
        )
        left = one.error.z - meant.minus(part.surface).z
        assert np.ptp(left) * 1e6 < 0.1 * uncorrected["tracking"]["pv_nm"]
        np.testing.assert_allclose(one.tracking.z, left, atol=1e-12)  # against what was meant, not what is commanded
    alone = written(tmp_path, *CHANGES, ("program.precorrect", True))
    assert main(["check", str(alone)]) == 2
    assert "program.precorrect is true and simulation.tracking is false" in capsys.readouterr().err
