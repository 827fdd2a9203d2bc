"""A lens array on a base with a form of its own, in one command. Oracle: the closed forms that it is made of."""

import json

import numpy as np
import pytest
import tomli_w

import turnwright as tw
import turnwright.job
from turnwright.cli import main

RADIUS, APERTURE, PITCH, RIM, COUNT = 10.0, 0.5, 2.0, 9.2, 7
DEPTH = RADIUS - np.sqrt(RADIUS**2 - APERTURE**2)
ASTIGMATISM, COMA = 0.5e-3, 0.3e-3
POSE = tw.Pose(shift=(0.3, -0.2, 0.05), rotation=0.012, tilt=(2e-3, -1e-3))
BASES = {
    "toroid": ((500.0, 250.0), tw.Toroid(radius_x=500.0, radius_y=250.0)),
    "sphere": ((300.0, 300.0), tw.Sphere(radius=300.0)),
}


def made(base, seed, *, way=0.0, displaced=2e-3, side=500, coma=COMA):
    """Return map, part, nominal centres and displacements, which have no shift, rotation or scale in them."""
    rng = np.random.default_rng(seed)
    (bend_x, bend_y), surface = BASES[base]
    array = tw.LensArray.square(
        pitch=PITCH, rows=COUNT, columns=COUNT, aperture=APERTURE, surround=0.0,
        lenslet=tw.Sphere(radius=RADIUS).placed(shift=(0, 0, -DEPTH)),
    )  # fmt: skip
    centres = np.array(array.centres)
    x, y = centres.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    frame = np.concatenate([np.stack([one, zero, -y, x], 1), np.stack([zero, one, x, y], 1)])
    moved = rng.normal(0, displaced, (2, x.size)).ravel()
    moved = (moved - frame @ np.linalg.lstsq(frame, moved, rcond=None)[0]).reshape(2, -1).T

    def sag(x, y):
        tube = bend_y - bend_x + np.sqrt(bend_x**2 - x * x)  # the circle in the plane of x and z
        z = bend_y - np.sqrt(tube**2 - y * y)
        u, v = x / RIM, y / RIM
        z += ASTIGMATISM * (np.cos(2 * way) * (u * u - v * v) + np.sin(2 * way) * 2 * u * v)
        z += coma * (3 * (u * u + v * v) - 2) * u
        for at in centres + moved:
            u, v = x - at[0], y - at[1]
            lens = u * u + v * v <= APERTURE**2
            z[lens] += RADIUS - np.sqrt(RADIUS**2 - u[lens] ** 2 - v[lens] ** 2) - DEPTH
        return z

    axis = np.linspace(-9.3, 9.3, side)
    gx, gy = np.meshgrid(axis + POSE.inverse.shift[0], axis + POSE.inverse.shift[1])
    z = np.zeros(gx.shape)
    for _ in range(6):
        px, py, pz = POSE.apply(gx, gy, z)
        z += sag(px, py) - pz
    px, py, _ = POSE.apply(gx, gy, z)
    z += rng.normal(0, 10e-6, z.shape)
    spikes = rng.random(z.shape) < 1e-3
    z[spikes] += rng.choice([-1, 1], spikes.sum()) * rng.uniform(0.2e-3, 20e-3, spikes.sum())
    z[rng.random(z.shape) < 0.03] = np.nan
    for spot in rng.uniform(-6, 6, (6, 2)):
        z[np.hypot(gx - spot[0], gy - spot[1]) < 0.2] = np.nan
    z[np.hypot(px, py) > RIM] = np.nan
    return tw.HeightMap(x=gx[0], y=gy[:, 0], z=z), tw.Part(surface=surface + array, radius=RIM), centres, moved


def judged(found, centres, moved):
    """Return how far the centres are off without a frame [mm], over their stated uncertainty too."""
    assert found.measured.all()
    frame = tw.metrology.Alignment.of(centres, centres + moved).residual
    off = found.irregular - frame
    stated = np.array([one.centre_std for one in found])
    return np.sqrt(np.mean(np.sum(off**2, axis=1))), np.sqrt(np.mean((off / stated) ** 2))


@pytest.mark.proof
@pytest.mark.parametrize(("base", "way"), [("toroid", 0.0), ("sphere", 0.6)])
def test_form_of_the_base_does_not_displace_the_lenslets(base, way):
    """Without it the centres are 1.4 um off, stated within 10 nm; a toroid turns by what 0.5 um of astigmatism is."""
    heights, part, centres, moved = made(base, 1, way=way)
    found = tw.lenslets(heights, part)
    off, ratio = judged(found, centres, moved)
    assert off < 0.1e-3
    assert 0.6 < ratio < 1.6
    assert found.pose.rotation == pytest.approx(POSE.rotation, abs=0.05e-3)
    terms = dict(found.base_form.terms)
    assert terms[5] == pytest.approx(ASTIGMATISM * np.cos(2 * way), abs=0.02 * ASTIGMATISM)
    assert terms[3] == pytest.approx(ASTIGMATISM * np.sin(2 * way), abs=0.02 * ASTIGMATISM)
    assert terms[8] == pytest.approx(COMA, rel=0.02)
    if way == 0:  # what is injected matters
        plain = tw.lenslets(heights, part, base_degree=0)
        assert judged(plain, centres, moved)[0] > 0.5e-3


@pytest.mark.parametrize(("side", "coma"), [pytest.param(206, COMA, marks=pytest.mark.proof), (300, 0.0)])
def test_the_lenslets_and_not_a_base_with_form_tell_the_rotation(side, coma):
    """Astigmatism at 45 deg is a turned toroid: by its base the array was 5.8 mrad off, with 11 pixels to a lens.

    Without coma the base shows no other form, and yet it must not be taken to have none.
    """
    heights, part, centres, moved = made("toroid", 3, way=np.pi / 4, displaced=1.5e-3, side=side, coma=coma)
    found = tw.lenslets(heights, part)
    off, ratio = judged(found, centres, moved)
    assert off < 0.15e-3
    assert ratio < 1.6
    assert found.pose.rotation == pytest.approx(POSE.rotation, abs=0.05e-3)
    assert "rotation by the pose within" in found.frame
    assert float(found.frame.split("by the pose within ")[1].split()[0]) < 60
    terms = dict(found.base_form.terms)
    assert terms[3] == pytest.approx(ASTIGMATISM, rel=0.02)
    assert abs(terms[3] - ASTIGMATISM) < 3 * found.base_form_std[3] < 0.03 * ASTIGMATISM
    assert terms[8] == pytest.approx(coma, abs=0.01 * COMA)
    assert "ANSI 3 " in found.summary
    # A pose from elsewhere that lies as far off as the form passes for: the lenslets contradict the base.
    off = tw.lenslets(heights, part, pose=tw.Pose(rotation=5.8e-3).after(POSE))
    assert "rotation by the pose" in off.frame
    assert abs(dict(off.base_form.terms)[3] - ASTIGMATISM) < 2 * off.base_form_std[3]


def test_measure_finds_base_and_lenslets_in_one_command(tmp_path, capsys, monkeypatch):
    heights, _, centres, moved = made("toroid", 2, way=np.pi / 4, side=400)
    low = {"shift": ["0 mm", "0 mm", f"{-DEPTH:.12g} mm"]}
    lens = {"family": "sphere", "radius": f"{RADIUS} mm", "placed": low}
    array = {
        "family": "lens array", "layout": "square", "pitch": "2 mm", "rows": COUNT, "columns": COUNT,
        "aperture": "0.5 mm", "surround": "0 mm", "lenslet": lens,
    }  # fmt: skip
    toroid = {"family": "toroid", "radius_x": "500 mm", "radius_y": "250 mm"}
    job = {
        "part": {"name": "array", "radius": f"{RIM} mm", "surface": [toroid, array]},
        "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
        "machine": {"name": "generic"},
        "strategy": {"kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 720},
    }
    (tmp_path / "job.toml").write_text(tomli_w.dumps(job), encoding="utf-8")
    tw.write_map(heights, tmp_path / "array.npz")
    out = tmp_path / "out"
    command = ["measure", str(tmp_path / "array.npz"), "--job", str(tmp_path / "job.toml"), "--out", str(out)]
    results, register = [], turnwright.job.measure

    def measure(*given, **options):
        results.append(register(*given, **options))
        return results[-1]

    monkeypatch.setattr(turnwright.job, "measure", measure)
    monkeypatch.setattr("turnwright.report.figures._print_svg", lambda _canvas: "<svg></svg>")
    assert main(command) == 0
    assert "base" in capsys.readouterr().out
    (measured,) = results
    off, ratio = judged(measured.lenslets, centres, moved)
    assert off < 0.1e-3
    assert 0.6 < ratio < 1.6
    assert measured.registration.pose.rotation == pytest.approx(POSE.rotation, abs=0.05e-3)
    terms = json.loads((out / "measured.json").read_text(encoding="utf-8"))["base_form"]
    assert terms["3"]["height"] == pytest.approx(ASTIGMATISM, rel=0.02)
    assert terms["3"]["std"] < 0.02 * ASTIGMATISM
    assert terms["5"]["height"] == pytest.approx(0, abs=0.02 * ASTIGMATISM)
    assert terms["8"]["height"] == pytest.approx(COMA, rel=0.02)
    # The form error is that of the part, base and lenslets: the form of the base is in it.
    assert measured.form_rms_nm > 100
