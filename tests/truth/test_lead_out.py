"""The end of a pass: the tool leaves the part while C goes on turning."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import InputError
from turnwright.generation import generate_polar
from turnwright.job import Pipeline, run
from turnwright.job.lead_out import add_lead_out

SLOPE = (3e-3, -1e-3)
TABLE = {
    "part": {"surface": {"family": "plane", "slope": [*SLOPE]}, "radius": "2 mm"},
    "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
    "machine": {"name": "nanoform"},
    "strategy": {"kind": "slow tool servo", "feed": "20 um/rev", "spindle_speed": "60 rpm", "points_per_rev": 90},
    "program": {"lead_out": "30 um"},
}  # fmt: skip
SADDLE = {"family": "biconic", "radius_x": "20 mm", "radius_y": "-30 mm", "conic_x": 0.0, "conic_y": 0.0}


def job_of(**changes):
    return tw.Job.read({**TABLE, **changes})


def motions(job):
    """Return the motion without a lead-out, and the points that the lead-out adds to it."""
    plain = job.replace("program", {})
    before, after = Pipeline(plain).motion, Pipeline(job).motion
    count = before.time.size
    for letter, values in before.axes.items():
        assert (after.axes[letter][:count] == values).all()
    return before, after.select(slice(count - 1, None)), after


@pytest.mark.parametrize("sense", [1, -1])
def test_the_lead_out_of_a_tilted_plane_is_its_contact_plus_a_polynomial(sense):
    """Oracle: on a plane of slope g along the radius, the tip of a round nose is R (sqrt(1 + g²) - 1) above it."""
    before, added, _ = motions(job_of(strategy={**TABLE["strategy"], "sense": sense, "overrun": "5 um"}))
    c, share = added.axes["C"], np.linspace(0, 1, added.time.size)
    # X slows down from the feed of 20 um in 1 s, as the integral of one minus the rise.
    rise = 10 * share**3 - 15 * share**4 + 6 * share**5
    stopping = share - (2.5 * share**4 - 3 * share**5 + share**6)
    x = before.axes["X"][-1] - 0.02 * (share.size - 1) / 90 * stopping
    assert np.diff(c) * sense == pytest.approx(2 * np.pi / 90, abs=1e-9)
    assert np.abs(added.axes["X"] - x).max() < 1e-12
    slope = SLOPE[0] * np.cos(c) + SLOPE[1] * np.sin(c)
    contact = x * slope + 0.5 * (np.sqrt(1 + slope**2) - 1)
    assert np.abs(added.axes["Z"] - contact - 0.03 * rise).max() < 1e-12
    assert np.diff(added.time) == pytest.approx(1 / 90, rel=1e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"part": {"surface": SADDLE, "radius": "2 mm"}},
        {"part": {"surface": SADDLE, "radius": "2 mm"}, "strategy": {**TABLE["strategy"], "inside_out": True}},
        {"part": {"surface": SADDLE, "outline": {"annulus": ["2 mm", "1 mm"]}}},
        {"tool": {**TABLE["tool"], "rake": "-10 deg", "offset": ["3 um", "-4 um", "0 um"]}},
    ],
    ids=["outside in", "inside out", "annulus", "raked"],
)
def test_a_lead_out_cuts_nothing_below_the_part(changes):
    """Oracle: the surface that the motion leaves, against the design; and without the lead-out, away from its end."""
    job = job_of(**changes)
    before, added, after = motions(job)
    assert added.axes["Z"][-1] - added.axes["Z"][0] == pytest.approx(0.03, abs=0.05)
    radius = np.linspace(max(job.part.nearest, 0.0), 2.0, 300)
    angle = np.linspace(0, 2 * np.pi, 45, endpoint=False) + 0.01
    plain, made = (generate_polar(one, job.tool, radius=radius, angle=angle) for one in (before, after))
    design = job.part.surface.sag(radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None])
    # The chords between 90 points a turn cut below the design, with and without it.
    assert np.nanmin(made.z - design) > 1.05 * np.nanmin(plain.z - design) - 1e-6
    far = np.abs(radius - abs(before.axes["X"][-1])) > 0.2
    assert np.nanmax(np.abs(made.z - plain.z)[:, far]) < 1e-12


def test_a_lead_out_keeps_the_limits_and_is_read_back(tmp_path):
    job = job_of(program={"lead_out": "0.4 mm"})
    result = run(job, out=tmp_path)
    assert result.ok
    again = tw.read_nc(result.program.files[0], job.machine)
    assert again.axes["Z"].max() == pytest.approx(0.4, abs=0.01)
    after = Pipeline(job).motion
    peak = result.passes[-1].limits.peak_acceleration["Z"]
    assert peak <= 0.55 * job.machine.axes["Z"].acceleration
    assert after.time.size == again.time.size


FREEFORM = {
    "family": "expression", "units": "mm",
    "formula": "0.002*(x**2+y**2)+0.01*x**3/27+0.02*exp(-((x-1.0)**2+(y-0.3)**2)/0.3**2)",
}  # fmt: skip


@pytest.mark.parametrize("lead_out", ["30 um", "3 um", "0.5 um"])
def test_uneven_points_keep_the_speed_of_c_and_the_chord(lead_out):
    """Points by chord: C turns on at its speed, and the lead-out cuts no deeper than the chord."""
    job = job_of(
        part={"surface": FREEFORM, "outline": {"annulus": ["3 mm", "1 mm"]}},
        tool={**TABLE["tool"], "nose_radius": "0.1 mm"}, program={"lead_out": lead_out},
        strategy={"kind": "slow tool servo", "feed": "20 um/rev", "spindle_speed": "25 rpm", "chord": "0.2 um"},
    )  # fmt: skip
    _, added, after = motions(job)
    speed = np.abs(np.diff(added.axes["C"]) / np.diff(added.time))[1:] * 60 / (2 * np.pi)
    assert speed == pytest.approx(25, rel=1e-3)
    assert Pipeline(job).limits.ok
    radius, angle = np.linspace(1.0, 1.3, 151), np.linspace(0, 2 * np.pi, 720, endpoint=False)
    made = generate_polar(after, job.tool, radius=radius, angle=angle)
    design = job.part.surface.sag(radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None])
    assert np.nanmin(made.z - design) > -0.25e-3


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_job_without_a_stated_speed_keeps_its_limits(inside_out):
    strategy = {"kind": "slow tool servo", "feed": "40 um/rev", "points_per_rev": 180, "inside_out": inside_out}
    part = {"surface": {"family": "sphere", "radius": "50 mm"}, "radius": "5 mm"}
    assert Pipeline(job_of(part=part, strategy=strategy)).limits.ok


def test_precorrected_programs_have_no_lead_out(tmp_path):
    (tmp_path / "lathe.toml").write_text(
        'base = "nanoform"\n[axes.Z]\nresponse = { frequency = "50 Hz", damping = 0.7 }\n'
    )
    table = {**TABLE, "machine": {"file": "lathe.toml"}, "simulation": {"tracking": True}}
    with pytest.raises(InputError, match="lead_out and precorrect are stated"):
        tw.Job.read({**table, "program": {"lead_out": "30 um", "precorrect": True}}, folder=tmp_path)


def test_spindle_mode_and_passes_that_end_in_air_need_none():
    turning = {"kind": "turning", "feed": "20 um/rev", "spindle_speed": "1000 rpm", "chord": "10 nm"}
    flat = {"surface": {"family": "plane"}, "radius": "2 mm"}
    for changes in (
        {"strategy": turning, "part": flat},
        {"part": {"surface": SADDLE, "outline": {"rectangle": ["2 mm", "1 mm"], "centre": ["3 mm", "0 mm"]}}},
    ):
        with_one, without = Pipeline(job_of(**changes)).motion, Pipeline(job_of(**changes, program={})).motion
        assert with_one.time.size == without.time.size


def test_programs_with_velocities_have_no_lead_out():
    job = job_of()
    before = Pipeline(job_of(program={})).motion
    moving = replace(before, velocity={letter: np.zeros(before.time.size) for letter in before.axes})
    with pytest.raises(InputError, match="lead_out is stated"):
        add_lead_out(moving, job.part, job.tool, job.machine, 0.03)
