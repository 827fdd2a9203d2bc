"""The command optics, and the section of a run: the light of a job and of a measured map."""

import json
import math
import tomllib

import numpy as np
import pytest
import tomli_w

import turnwright as tw
from turnwright.cli import main
from turnwright.errors import JobError
from turnwright.job import Pipeline

MIRROR = {
    "part": {"surface": {"family": "conic", "radius": "80 mm", "conic": -1.0}, "radius": "4 mm"},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 180, "spindle_speed": "60 rpm"},
    "simulation": {
        "whole_part": {"radii": 60, "angles": 60},
        "patches": [{"name": "zone", "centre": ["2 mm", "0 mm"], "size": ["0.2 mm", "0.05 mm"], "pixel": "0.5 um"}],
    },
    "optics": {"wavelength": "633 nm", "focal_length": "40 mm"},
}


@pytest.fixture(scope="module")
def performance():
    return Pipeline(tw.Job.read(MIRROR)).optics


def test_optics_of_a_nominal_mirror(performance):
    """Only cusps and chords remain: cusps of 20 um in closed form, chords of half a degree below 1 nm."""
    height = 0.02**2 / 8 / 0.5 / (1 - 0.5 / 80)  # placed along z
    assert performance.form_strehl > 0.9999
    share = tw.optics.cusp_orders(nose_radius=1.0, feed=math.sqrt(8 * height), wavelength=633e-6, orders=[0, 1])
    assert performance.cusps.specular == pytest.approx(share[0], rel=1e-3)  # slope and curvature vary over the part
    assert performance.cusp_order == pytest.approx(share[1], rel=5e-3)
    assert performance.strehl == pytest.approx(performance.form_strehl * performance.cusps.specular)
    marks = performance.marks["zone"]
    assert marks.tis == pytest.approx(1 - share[0], rel=5e-3)
    assert marks.orders(1)[0].angle == pytest.approx(math.asin(633e-6 / 0.02 * (1 - 0.5 / 80)), rel=3e-3)


def test_optics_sees_a_tool_centring_error():
    """A known form error: an error of the tool along X raises the surface by offset times slope, r/80."""
    offset = 2e-3
    data = MIRROR | {"actual": {"tool": {"offset": [f"{offset} mm", "0 mm", "0 mm"]}}}
    light = Pipeline(tw.Job.read(data)).optics.wavefront
    radius = light.opd.radius
    expected = -2 * (-offset * radius / 80) / (1 + (radius / 80) ** 2)
    profile = light.opd.z.mean(axis=0)
    inner = slice(5, -5)
    assert profile[inner] - profile[64] == pytest.approx(expected[inner] - expected[64], abs=3e-6)


def test_optics_command_writes_a_page(tmp_path, capsys):
    job = tmp_path / "job.toml"
    job.write_text(tomli_w.dumps(MIRROR))
    assert main(["optics", str(job), "--out", str(tmp_path / "light")]) == 0
    printed = capsys.readouterr().out
    assert "Strehl ratio of form and cusps" in printed
    numbers = json.loads((tmp_path / "light" / "result.json").read_text())["optics"]
    assert 0.6 < numbers["strehl"] < numbers["form_strehl"] <= 1
    assert numbers["orders"][0]["order"] == 1
    page = (tmp_path / "light" / "report.html").read_text()
    assert "Diffraction orders" in page
    assert page.count("<svg") == 3


def test_optics_of_a_measured_map(tmp_path):
    """Astigmatism of 60 nm on a mirror measured off its place: a rotation of the map only rotates the image."""
    x = np.linspace(-4.3, 4.3, 87)
    u, v = np.meshgrid(x, x)
    astigmatism = 60e-6 * (u * u - v * v) / 16
    z = np.where(np.hypot(u, v) <= 4.3, tw.Conic(radius=80.0, conic=-1.0).sag(u, v) + astigmatism, np.nan)
    shifted = tw.HeightMap(x=x + 0.3, y=x - 0.2, z=z + 0.01)
    tw.write_map(shifted, tmp_path / "map.npz")
    job = tmp_path / "job.toml"
    job.write_text(tomli_w.dumps(MIRROR | {"measurement": {"reach": "0.5 mm"}}))
    out = tmp_path / "light"
    assert main(["optics", str(tmp_path / "map.npz"), "--job", str(job), "--out", str(out)]) == 0
    numbers = json.loads((out / "result.json").read_text())["optics"]
    assert abs(numbers["zernike_fringe"]["5"]) == pytest.approx(120e-6, rel=0.01)
    small = tmp_path / "small.npz"
    tw.write_map(tw.HeightMap(x=x / 2, y=x / 2, z=tw.Conic(radius=80.0, conic=-1.0).sag(u / 2, v / 2)), small)
    assert main(["optics", str(small), "--job", str(job), "--out", str(tmp_path / "none")]) == 2
    assert not (tmp_path / "none").exists()


def test_optics_of_a_map_without_a_job(tmp_path, capsys):
    """Astigmatism of a flat mirror, and a ripple whose first orders are J1(2 k a)²."""
    from scipy.special import j0, jv

    x = np.linspace(-1, 1, 201)
    u, v = np.meshgrid(x, x)
    z = np.where(np.hypot(u, v) <= 1, 20e-6 * np.sin(2 * np.pi * u / 0.1), np.nan)
    tw.write_map(tw.HeightMap(x=x, y=x, z=z), tmp_path / "map.npz")
    command = ["optics", str(tmp_path / "map.npz"), "--out", str(tmp_path / "light")]
    assert main(command) == 2
    assert "--wavelength" in capsys.readouterr().err
    assert main([*command, "--wavelength", "633 nm"]) == 0
    numbers = json.loads((tmp_path / "light" / "result.json").read_text())["optics"]
    depth = 4 * math.pi * 20e-6 / 633e-6
    assert numbers["strehl"] == pytest.approx(j0(depth) ** 2, rel=2e-3)
    assert numbers["orders"][0]["efficiency"] == pytest.approx(jv(1, depth) ** 2, rel=2e-3)
    assert main([*command, "--job", str(tmp_path / "no.toml"), "--wavelength", "633 nm", "--force"]) == 2


def test_optics_in_a_run_and_its_tolerance(tmp_path, capsys):
    """20 um/rev leaves 13 % in an order, far above 0.1 %."""
    job = tmp_path / "job.toml"
    job.write_text(tomli_w.dumps(MIRROR | {"tolerances": {"cusp_order": {"max": 0.001, "wavelength": "633 nm"}}}))
    assert main(["run", str(job), "--out", str(tmp_path / "run")]) == 4
    assert "light in one order of the cusps is 13." in capsys.readouterr().err
    numbers = json.loads((tmp_path / "run" / "result.json").read_text())
    (verdict,) = numbers["verdicts"]
    assert (verdict["kept"], verdict["unit"], verdict["limit"]) == (False, "%", pytest.approx(0.1))
    assert numbers["optics"]["scatter"]["zone"] == pytest.approx(numbers["optics"]["tis"], rel=0.03)
    assert "Optical performance" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.usefixtures("in_this_process")
def test_optics_in_a_study():
    """The order of a shallow cusp is the square of its height, the fourth power of the feed."""
    study = tw.studies.study(
        tw.Job.read(MIRROR), vary={"strategy.feed": [0.005, 0.01]}, measure=["cusp_order", "strehl"], workers=1
    )
    orders = study["cusp_order"]
    assert orders[1] / orders[0] == pytest.approx(16, rel=0.06)


@pytest.mark.parametrize(
    ("optics", "named"),
    [
        ({"wavelength": 633}, "wavelength"),
        ({"wavelength": "633 mm"}, "wavelength"),
        ({"wavelength": "633 nm", "index": 0.5}, "index"),
        ({"wavelength": "633 nm", "inside": True}, "index"),
        ({"wavelength": "633 nm", "obscuration": 1.0}, "obscuration"),
        ({}, "wavelength"),
    ],
)
def test_light_that_cannot_be_is_refused(optics, named):
    with pytest.raises(JobError, match=named) as refused:
        tw.Job.read(MIRROR | {"optics": optics})
    assert len(str(refused.value)) <= 400


def test_run_is_written_where_light_cannot_be_told(tmp_path, capsys):
    """A source on the vertex meets the surface at no angle: the program does not depend on it."""
    job = tmp_path / "job.toml"
    optics = {"wavelength": "633 nm", "source": "0 mm"}
    job.write_text(tomli_w.dumps(MIRROR | {"simulation": {}, "optics": optics}))
    assert main(["run", str(job), "--out", str(tmp_path / "run")]) == 0
    assert "warning: optics: source is at 0 mm" in capsys.readouterr().err
    assert (tmp_path / "run" / "part.nc").exists()


def test_optics_needs_its_table():
    plain = {key: value for key, value in MIRROR.items() if key != "optics"}
    with pytest.raises(tw.InputError, match=r"\[optics\]"):
        _ = Pipeline(tw.Job.read(plain)).optics
    assert "optics" not in tomllib.loads(tw.Job.read(plain).to_toml())


def test_optics_of_an_off_axis_mirror():
    """A rectangle off the axis: its pupil is the circle around it, with heights on the rectangle only."""
    outline = {"rectangle": ["6 mm", "3 mm"], "centre": ["7 mm", "0 mm"]}
    surface = {"family": "conic", "radius": "80 mm", "conic": -1.0}
    data = MIRROR | {"part": {"surface": surface, "outline": outline}, "simulation": {}}
    tilted = data | {"actual": {"tool": {"offset": ["20 um", "0 mm", "0 mm"]}}}
    light, off = (Pipeline(tw.Job.read(one)).optics.wavefront for one in (data, tilted))
    assert light.centre == (7.0, 0.0)
    assert light.radius == pytest.approx(math.hypot(3, 1.5), rel=0.02)
    assert light.covered == pytest.approx(18 / (math.pi * light.radius**2), rel=0.05)
    assert light.strehl > 0.999 * light.specular
    # The error of a centring error, 20 um * r / 80, is a cone: without its tilt r - x, so y² / 2 r.
    assert off.rms > 10 * light.rms
    row = off.opd.z[:, 64] - light.opd.z[:, 64]
    bend = np.polyfit(off.opd.y, row, 2)[0]
    assert bend == pytest.approx(2 * 20e-3 / 80 / (2 * 7.0), rel=0.05)


def brute_force(job, motion, radius_over_feed, azimuths=61):
    """Return the Strehl ratio of a surface from its finely simulated rings."""
    part, count = job.part, int(24 * radius_over_feed)
    radius = part.nearest + (part.reach - part.nearest) * (np.arange(count) + 0.5) / count
    angle = np.linspace(0, 2 * np.pi, azimuths, endpoint=False)
    error = tw.generate_polar(motion, job.actual_tool, radius=radius, angle=angle).minus(part.surface).z
    x, y = np.outer(np.cos(angle), radius), np.outer(np.sin(angle), radius)
    gain = tw.optics.path_per_height(part.surface, x, y)
    phases = np.exp(2j * np.pi / job.optics.wavelength * gain * error)
    return abs(np.average(phases, weights=np.broadcast_to(radius, phases.shape))) ** 2


@pytest.mark.parametrize(
    "changes",
    [
        {"part": {"surface": {"family": "conic", "radius": "80 mm", "conic": -1.0}, "radius": "1 mm"}},
        {
            "part": {"surface": {"family": "sphere", "radius": "6 mm"}, "radius": "2 mm"},
            "strategy": MIRROR["strategy"] | {"along": "normal"},
        },
        {
            "part": {"surface": {"family": "sphere", "radius": "-6 mm"}, "radius": "2 mm"},
            "strategy": MIRROR["strategy"] | {"along": "normal"},
        },
        {"part": {"surface": {"family": "sphere", "radius": "6 mm"}, "radius": "2 mm"}},
        {"part": {"surface": {"family": "sphere", "radius": "60 mm"}, "outline": {"annulus": ["3 mm", "1 mm"]}}},
        {
            "part": {
                "surface": {
                    "family": "zernike",
                    "radius": "2 mm",
                    "indexing": "fringe",
                    "units": "um",
                    "terms": {"5": 60.0},
                },
                "radius": "2 mm",
            },
            "strategy": MIRROR["strategy"] | {"points_per_rev": 128},
        },
    ],
    ids=["few revolutions", "concave, normal", "convex, normal", "concave, z", "annulus", "128 chords"],
)
def test_optics_of_a_finely_simulated_surface(changes):
    """Form and cusps apart, against all points of the surface at once."""
    pipeline = Pipeline(tw.Job.read(MIRROR | {"simulation": {}} | changes))
    job, light = pipeline.job, pipeline.optics
    expected = brute_force(job, pipeline.motion, (job.part.reach - job.part.nearest) / 0.02)
    assert light.strehl == pytest.approx(expected, abs=4e-3)
    assert light.form_strehl == pytest.approx(1.0, abs=4e-3) or job.strategy.points_per_rev == 128


def test_brightest_order_of_deep_cusps_is_a_high_one():
    """A nose of 0.2 mm and 50 um/rev at 500 nm: order 19 has more light than the first three."""
    tool = {"nose_radius": "0.2 mm", "included": "60 deg", "clearance": "10 deg"}
    strategy = MIRROR["strategy"] | {"feed": "50 um/rev"}
    part = {"surface": {"family": "plane"}, "radius": "4 mm"}
    data = MIRROR | {
        "tool": tool,
        "strategy": strategy,
        "part": part,
        "simulation": {},
        "optics": {"wavelength": "500 nm"},
    }
    light = Pipeline(tw.Job.read(data)).optics
    shares = tw.optics.cusp_orders(nose_radius=0.2, feed=0.05, wavelength=500e-6, orders=np.arange(1, 60))
    assert light.cusp_order == pytest.approx(shares.max(), rel=1e-6)
    assert shares.argmax() > 3


LENS = {
    **MIRROR,
    "strategy": {"kind": "slow tool servo", "feed": "5 um/rev", "chord": "5 nm"},
    "simulation": {"whole_part": {"radii": 40, "angles": 60}},
}


def test_plan_keeps_the_orders_of_the_cusps():
    """The feed where f² / (8 R (1 - R / 80)) sends 0.1 % into the first order, by Fresnel integrals at 40 digits."""
    tolerances = {"form_pv": "500 nm", "sq": "100 nm", "cusp_order": {"max": 0.001, "wavelength": "633 nm"}}
    planned = tw.plan(tw.Job.read(LENS | {"tolerances": tolerances}))
    feed = planned.job.strategy.feed
    period = feed / math.sqrt(1 - 0.5 / 80)
    made = tw.optics.cusp_orders(nose_radius=0.5, feed=period, wavelength=633e-6, orders=1)
    assert 0.85e-3 < float(made) <= 0.001
    assert [one.is_kept for one in planned.verdicts] == [True, True, True]


@pytest.mark.parametrize(
    ("order", "named"),
    [
        ({"max": 0.001}, "wavelength"),
        ({"max": 1.5, "wavelength": "633 nm"}, "max"),
        ({"max": 0.001, "wavelength": "633 nm", "index": 0.3}, "index"),
    ],
)
def test_order_that_cannot_be_is_refused(order, named):
    with pytest.raises(JobError, match=named):
        tw.Job.read(MIRROR | {"tolerances": {"cusp_order": order}})
