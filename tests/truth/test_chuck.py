"""Several parts on a chuck: each surface is that of the part alone at its place, and each is measured alone."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
import turnwright.diagnosis.report as _draws
import turnwright.job.correction as _correct
from cases import every_second
from turnwright.job import Job, correct, diagnose, measure, preview

TOOL = tw.Tool(nose_radius=0.5, included=np.deg2rad(90), clearance=np.deg2rad(10))
PARABOLA = tw.OffAxis(parent=tw.Conic(radius=150.0, conic=-1.0), distance=30.0)
MIRROR = tw.Mounted(name="A", surface=PARABOLA, outline=tw.Outline(rectangle=(12.0, 8.0)), position=(14.0, 0.0))
CHUCK = tw.Chuck(
    parts=(
        MIRROR,
        tw.Mounted(
            name="B", surface=tw.OffAxis(parent=tw.Conic(radius=-200.0, conic=-1.0), distance=40.0, azimuth=1.0),
            outline=tw.Outline(polygon=((-5, -5), (5, -4), (4, 5), (-4, 4))), position=(-8.0, 12.0), clocking=2.1,
        ),
        tw.Mounted(
            name="C", surface=tw.Toroid(radius_x=200.0, radius_y=-300.0), outline=tw.Outline(disc=6.0),
            position=(-8.0, -12.0), clocking=4.2, height=0.05, tilt=(0.01, -0.005),
        ),
        tw.Mounted(
            name="fiducial", surface=tw.Sphere(radius=20.0), outline=tw.Outline(disc=1.0), position=(2.0, 0.0),
            height=-0.02,
        ),
    )
)  # fmt: skip


@pytest.fixture(scope="module")
def motions():
    part, machine = tw.Part(surface=CHUCK, stock=0.01), tw.Machine.load("nanoform")
    servo = tw.SlowToolServo(feed=0.2, spindle_rpm=20, points_per_rev=360)
    spiral = servo.spiral(part, TOOL)
    every = {None: part, **{one.name: part.alone(one.name) for one in CHUCK.parts}}
    return {name: (one, tw.drive(tw.place(spiral, one, TOOL), servo, machine)) for name, one in every.items()}


@pytest.mark.parametrize("name", [one.name for one in CHUCK.parts])
def test_each_surface_is_that_of_the_part_alone_on_the_same_spiral(motions, name):
    part, alone = motions[name]
    x_low, x_high, low, high = part.border.box
    x, y = np.random.default_rng(0).uniform([[x_low], [low]], [[x_high], [high]], (2, 1000))
    on = part.covers(x, y)
    made, expected = (tw.generate_points(one, TOOL, x=x[on], y=y[on]) for one in (motions[None][1], alone))
    np.testing.assert_allclose(made, expected, atol=1e-12, rtol=0)


def test_the_axes_keep_their_limits_between_the_parts(motions):
    assert tw.check_limits(motions[None][1], tw.Machine.load("nanoform")).ok


def test_the_frame_of_a_part_is_turned_and_moved():
    # By hand: the point (1, 0) of a part at (5, 2) turned by 90 degrees is at (5, 3) on the chuck.
    tilted = tw.Mounted(
        name="wedge", surface=tw.Expression("0.01*x"), outline=tw.Outline(rectangle=(4.0, 2.0)), position=(5.0, 2.0),
        height=0.5, clocking=np.pi / 2,
    )  # fmt: skip
    part = tw.Part(surface=tw.Chuck(parts=(tilted,)))
    assert part.surface.sag(5.0, 3.0) == pytest.approx(0.51, abs=1e-12)
    assert part.border.box == pytest.approx((4.0, 6.0, 0.0, 4.0), abs=1e-12)
    assert part.reach == pytest.approx(np.hypot(6.0, 4.0), abs=1e-12)


@pytest.mark.parametrize(
    ("second", "match"),
    [
        (replace(MIRROR, name="near", position=(20.0, 3.0)), "overlap"),
        (replace(MIRROR, position=(-14.0, 0.0)), "name"),
        (replace(MIRROR, name="around", outline=tw.Outline(disc=60.0), surface=tw.Plane()), "overlap"),
    ],
)
def test_parts_that_cannot_be_together_are_refused(second, match):
    with pytest.raises(tw.InputError, match=match):
        tw.Chuck(parts=(MIRROR, second))


@pytest.mark.parametrize("wrong", [{"radius": 5.0}, {"outline": tw.Outline(disc=5.0)}])
def test_a_chuck_has_the_outlines_of_its_parts(wrong):
    with pytest.raises(tw.InputError, match="chuck"):
        tw.Part(surface=CHUCK, **wrong)


@pytest.mark.parametrize("gap", [0.1, 0.6])
def test_a_tool_that_cannot_pass_between_two_parts_is_refused(gap):
    # The flat is 1 mm higher: at 0.6 mm the arc of 0.5 mm is beside it, but not its flank at 45 degrees.
    low, high = (
        tw.Mounted(name=name, surface=tw.Plane(), outline=tw.Outline(rectangle=(4.0, 4.0)), position=(x, 0.0), height=z)
        for name, x, z in (("low", 5.0, 0.0), ("high", 9.0 + gap, 1.0))
    )
    part = tw.Part(surface=tw.Chuck(parts=(low, high)))
    servo = tw.SlowToolServo(feed=0.1, spindle_rpm=20, points_per_rev=360)
    with pytest.raises(tw.InputError, match="cannot pass between the parts 'low' and 'high'"):
        tw.place(servo.spiral(part, TOOL), part, TOOL)
    apart = tw.Part(surface=tw.Chuck(parts=(low, replace(high, position=(11.0, 0.0)))))
    tw.place(servo.spiral(apart, TOOL), apart, TOOL)


@pytest.mark.parametrize(("side", "inside_out"), every_second([1, -1], [False, True]))
def test_a_tall_neighbour_is_never_cut(side, inside_out):
    # Diagonally behind the low part: the tool must rise 1 mm, and the flank at 45 degrees reaches over the tall part.
    low = tw.Mounted(name="low", surface=tw.Plane(), outline=tw.Outline(rectangle=(4.0, 4.0)), position=(12.0, 0.0))
    tall = replace(low, name="tall", outline=tw.Outline(rectangle=(3.0, 4.0)), position=(16.2, side * 4.8), height=1.0)
    part, machine = tw.Part(surface=tw.Chuck(parts=(low, tall)), stock=0.01), tw.Machine.load("nanoform")
    servo = tw.SlowToolServo(feed=0.05, spindle_rpm=5, points_per_rev=720, inside_out=inside_out)
    motion = tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, machine)
    assert tw.check_limits(motion, machine).ok
    for one, (x_low, x_high, low_y, high_y) in ((alone, alone.border.box) for alone in part.apart):
        x, y = np.meshgrid(np.linspace(x_low, x_high, 61), np.linspace(low_y, high_y, 61))
        made = tw.generate_points(motion, TOOL, x=x.ravel(), y=y.ravel())
        assert (made - one.surface.sag(x, y).ravel()).min() > -1e-9


def test_a_part_outside_the_domain_of_its_surface_is_named():
    ball = tw.Mounted(name="ball", surface=tw.Sphere(radius=3.0), outline=tw.Outline(disc=4.0))
    with pytest.raises(tw.TurnwrightError, match=r"'ball'.*Sphere"):
        tw.Part(surface=tw.Chuck(parts=(ball,)))


JOB = {
    "part": {
        "stock": "10 um",
        "surface": {
            "family": "chuck",
            "parts": [
                {
                    "name": name,
                    "surface": {"family": "toroid", "radius_x": "200 mm", "radius_y": "240 mm"},
                    "outline": {"rectangle": ["8 mm", "6 mm"]}, "position": [x, "0 mm"], "clocking": clocking,
                }
                for name, x, clocking in (("M1", "9 mm", "0 deg"), ("M2", "-9 mm", "180 deg"))
            ],
        },
    },
    "tool": {"nose_radius": "0.5 mm", "included": "90 deg", "clearance": "10 deg"},
    "machine": {"name": "nanoform"},
    "strategy": {
        "kind": "slow tool servo", "feed": "50 um/rev", "points_per_rev": 360, "spindle_speed": "20 rpm",
    },
    "measurement": {"part": "M2", "fixed": ["decentre", "clocking"]},
}  # fmt: skip


def test_a_map_of_one_part_corrects_this_part(tmp_path, monkeypatch):
    monkeypatch.setattr(_draws, "DRAWS", 50)
    monkeypatch.setattr(_draws, "FULL_CASES", 2)
    monkeypatch.setattr(_correct, "MAX_PREDICTED_POINTS", 4_000)
    monkeypatch.setattr(_correct, "MAX_SIMULATED_PLACES", 200)
    job = Job.read(JOB)
    assert Job.read(job.table()) == job
    x, y = np.linspace(-4, 4, 65), np.linspace(-3, 3, 49)
    columns, rows = np.meshgrid(x, y)
    # A ripple of 60 nm, in the frame of the part, as an interferometer sees it.
    ripple = 60e-6 * np.cos(2 * np.pi * columns / 4)
    noise = np.random.default_rng(0).normal(0, 2e-6, ripple.shape)
    sag = job.part.surface.mounted("M2").surface.sag(columns, rows)
    measured = measure(job, tw.HeightMap(x=x, y=y, z=sag + ripple + noise, name="M2"))
    assert measured.form_rms_nm == pytest.approx(1e6 * np.std(ripple), rel=0.03)
    correction = correct(job, diagnose(measured), measured, out=tmp_path)
    first, second = correction.job.part.surface.parts
    assert first.correction is None
    # Turned by 180 degrees at x = -9 mm. Apart from a parabola (mount, and the tool's offset that is corrected as such)
    # the correction on the chuck is the ripple, inverted.
    u, v = columns[8:-8, 8:-8].ravel(), rows[8:-8, 8:-8].ravel()
    on_chuck = second.correction.sag(-9 - u, -v)
    terms = np.stack([np.cos(np.pi * u / 2), np.ones(u.size), u, v, u * u, v * v], axis=1)
    amplitude = np.linalg.lstsq(terms, on_chuck, rcond=None)[0][0]
    assert amplitude == pytest.approx(-60e-6, rel=0.1)
    assert Job.load(tmp_path / "job.toml").part.surface.parts[1].correction is not None


def test_a_chuck_can_be_checked_before_a_run():
    assert preview(Job.read(JOB)).refused == ()


def test_a_measurement_names_its_part():
    job = Job.read(JOB)
    flat = tw.HeightMap(x=np.arange(10.0), y=np.arange(10.0), z=np.zeros((10, 10)))
    with pytest.raises(tw.JobError, match=r"measurement.part, one of M1, M2"):
        measure(job.replace("measurement.part", ""), flat)
    with pytest.raises(tw.JobError, match="M3"):
        job.replace("measurement.part", "M3")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("strategy", {"kind": "turning", "feed": "50 um/rev", "spindle_speed": "500 rpm", "chord": "1 nm"}),
        ("strategy", {"kind": "adaptive tool servo", "scallop": "50 nm", "chord": "1 nm"}),
        ("passes", [
            {"name": "rough", "kind": "turning", "spindle_speed": "500 rpm", "chord": "1 um", "allowance": "5 um"},
            {"name": "finish"},
        ]),
    ],
)  # fmt: skip
def test_strategies_that_cannot_cut_a_chuck_are_refused(key, value):
    with pytest.raises(tw.JobError, match=r"chuck|outline"):
        Job.read({**JOB, key: value})
