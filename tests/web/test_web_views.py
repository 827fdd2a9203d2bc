"""What the workbench shows: every number against the public functions, closed forms, numpy and matplotlib."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turnwright as tw
import turnwright.machine
from turnwright.cutting.chip import RoundChip, expected_thickest
from turnwright.report import archive_run

pytest.importorskip("fastapi", reason="the workbench is an extra: pip install 'turnwright[web]'")

from fastapi.testclient import TestClient

from turnwright.web import create_app, previews as _seen, results as _made
from turnwright.web.binary import MEDIA_TYPE, pack, unpack

EXAMPLES = Path(__file__).parents[2] / "examples"
STATIC = Path(create_app.__code__.co_filename).parent / "static"
RUN = "0123456789abcdef"

PLANE = {
    "part": {"surface": {"family": "plane"}, "radius": "2 mm", "stock": "20 um"},
    "tool": {"nose_radius": "0.5 mm", "included": "100 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 90, "spindle_speed": "60 rpm"},
}
BOWL = PLANE | {
    "part": {"surface": {"family": "sphere", "radius": "9 mm"}, "radius": "2 mm", "stock": "20 um"},
    "simulation": {
        "whole_part": {"radii": 101, "angles": 60},
        "patches": [{"name": "spot", "centre": ["1 mm", "0 mm"], "size": ["60 um", "40 um"], "pixel": "2 um"}],
    },
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tw.job.Result]:
    """Carry out a small job into the folder of a run, as the command line does."""
    out = tmp_path_factory.mktemp("server") / "runs" / RUN / "out"
    out.mkdir(parents=True)
    result = tw.run(tw.Job.read(BOWL), out=out)
    archive_run(result, out)
    return out, result


def test_a_message_is_what_numpy_reads_from_its_bytes() -> None:
    z = np.array([[1.0, np.nan, -2.5], [1e-9, 3e7, 0.1]])
    message = pack({"unit": "mm", "x": [0.0, None]}, {"z": z, "none": np.empty((0, 3)), "one": [7.0]})
    assert message[:4] == b"TW01"
    length = int(np.frombuffer(message, "<u4", 1, 4)[0])
    assert length % 4 == 0
    header = json.loads(message[8 : 8 + length])
    assert header["arrays"] == [
        {"name": "z", "shape": [2, 3]}, {"name": "none", "shape": [0, 3]}, {"name": "one", "shape": [1]},
    ]  # fmt: skip
    numbers = np.frombuffer(message, "<f4", offset=8 + length)
    np.testing.assert_array_equal(numbers, np.append(z.ravel(), 7.0).astype("<f4"))
    again, arrays = unpack(message)
    assert again == header
    np.testing.assert_array_equal(arrays["z"], z.astype("<f4"))
    assert arrays["none"].shape == (0, 3)


@pytest.mark.parametrize("cut", [0, 3, 20, -1])
def test_a_message_that_is_cut_short_is_refused(cut: int) -> None:
    with pytest.raises(tw.InputError, match="bytes"):
        unpack(pack({}, {"z": np.arange(5.0)})[:cut])


@pytest.mark.parametrize("name", ["infrared_lens", "hexagonal_array"])
def test_a_surface_is_seen_as_its_own_functions_say(name: str) -> None:
    data = tomllib.loads((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8"))
    part = tw.Job.read(data).part
    axis = np.linspace(-part.radius, part.radius, 33)
    x, y = np.meshgrid(axis, axis)
    inside = (np.hypot(x, y) <= part.radius) & (np.hypot(x, y) > 0)
    for quantity, wanted in (
        ("height", part.surface.sag(x[inside], y[inside])),
        ("slope", np.arctan(np.hypot(*part.surface.gradient(x[inside], y[inside])))),
    ):
        header, arrays = unpack(_seen.surface(data, "", quantity, 33))
        np.testing.assert_array_equal(arrays["values"][inside], wanted.astype("<f4"))
        np.testing.assert_array_equal(arrays["z"][inside], part.surface.sag(x[inside], y[inside]).astype("<f4"))
        assert np.isfinite(arrays["z"]).all()
        assert header["low"] <= wanted.min() + 1e-15
        assert header["high"] >= wanted.max() - 1e-15
        assert header["radius"] == part.radius


def test_the_curvature_of_a_sphere_is_that_of_its_circle() -> None:
    header, arrays = unpack(_seen.surface(BOWL, "", "curvature", 21))
    np.testing.assert_allclose(arrays["values"], 1 / 9, rtol=1e-6)
    assert header["unit"] == "1/mm"


def test_the_least_clearance_margin_seen_is_that_of_the_access() -> None:
    data = tomllib.loads((EXAMPLES / "infrared_lens.toml").read_text(encoding="utf-8"))
    job = tw.Job.read(data)
    finding = next(one for one in tw.check_access(job.part, job.tool).findings if one.name == "clearance")
    header, _ = unpack(_seen.surface(data, "", "clearance margin", 257))
    assert finding.margin is not None
    assert finding.margin - 1e-12 <= header["low"] <= finding.margin + 1e-3
    stated = {**data["tool"]}
    stated.pop("clearance")
    header, _ = unpack(_seen.surface({**data, "tool": stated}, "", "clearance margin", 65))
    assert header["label"] == "required clearance"


def test_the_chip_on_a_flat_is_the_round_chip() -> None:
    header, arrays = unpack(_seen.surface(PLANE, "", "chip thickness", 16))
    chip = RoundChip(nose_radius=0.5, feed=0.02, depth=0.02)
    np.testing.assert_allclose(arrays["values"], chip.thickest, rtol=1e-6)
    assert "estimate" in header["note"]
    bare, arrays = unpack(_seen.surface(PLANE | {"part": {**PLANE["part"], "stock": "0 um"}}, "", "chip thickness", 16))
    assert "part.stock" in bare["refused"]
    assert np.isnan(arrays["values"]).all()
    assert not arrays["z"].any()


def test_the_chip_on_a_curve_is_that_found_along_a_path() -> None:
    # Oracle: the chip of a path that was placed, well away from entry and axis.
    job = tw.Job.read(BOWL)
    part, tool = job.part, job.tool
    motion = tw.job.Pipeline(job).motion
    found = tw.cutting.chip_map(motion, tool, part)
    away = np.hypot(found.x, found.y)
    there = found.inside & (away > 0.8) & (away < 1.7)
    expected = expected_thickest(tool, feed=0.02, depth=0.02, bend=1 / 9)
    np.testing.assert_allclose(found.thickness[there], expected, rtol=1e-2)


@pytest.mark.parametrize(
    "servo",
    [
        tw.SlowToolServo(feed=0.021, points_per_rev=360),
        tw.SlowToolServo(feed=0.021, points_per_rev=77, sense=-1, lead_in=0.1, overrun=0.005),
        tw.SlowToolServo(feed=0.021, points_per_rev=360, inside_out=True),
        tw.SlowToolServo(feed=0.021, arc_length=0.05, max_step=0.3),
        tw.FastToolServo(plan=tw.SlowToolServo(feed=0.021, points_per_rev=90)),
    ],
)
def test_a_glimpse_is_points_of_the_whole_spiral(servo: tw.strategy.Strategy) -> None:
    job = tw.Job.read(BOWL)
    part, tool = job.part, replace(job.tool, offset=(0.003, 0.0, 0.0))
    whole = servo.spiral(part, tool)
    some = servo.preview_spiral(part, tool, turns=12, per_turn=24)
    at = np.searchsorted(whole.angle * whole.sense, some.angle * some.sense)
    np.testing.assert_array_equal(some.angle, whole.angle[at])
    np.testing.assert_array_equal(some.radius, whole.radius[at])
    assert some.sense == whole.sense
    assert at[0] == 0
    assert at[-1] == whole.angle.size - 1
    assert 200 < at.size <= 12 * 25 + 1


def test_a_path_is_seen_in_true_contact() -> None:
    header, arrays = unpack(_seen.path(BOWL, "", 2000))
    job = tw.Job.read(BOWL)
    radius, angle = arrays["radius"].astype(float), arrays["angle"].astype(float)
    # Closed form: the tip of a round nose inside a sphere of 9 mm stands on a sphere of 8.5 mm.
    np.testing.assert_allclose(arrays["position"][:, 2], 8.5 - np.sqrt(8.5**2 - radius**2), atol=1e-7)
    np.testing.assert_allclose(arrays["position"][:, 0], radius * np.cos(angle), atol=1e-6)
    contact = arrays["contact"].astype(float)
    np.testing.assert_allclose(contact[:, 2], 9 - np.sqrt(81 - contact[:, 0] ** 2 - contact[:, 1] ** 2), atol=1e-7)
    np.testing.assert_allclose(np.sin(arrays["sweep"]), radius / 8.5, atol=1e-6)
    assert arrays["clearance"].min() > -1e-12  # rounding
    assert header["feed"] == pytest.approx(0.02)
    assert header["nose_radius"] == job.tool.nose_radius
    assert header["starts"][0] == 0
    assert header["starts"][-1] == radius.size
    # Between two pieces at least a turn is left out, within one none.
    starts, fraction = np.array(header["starts"]), arrays["fraction"].astype(float) * header["turns"]
    assert (np.diff(fraction)[starts[1:-1] - 1] > 0.9).all()
    assert (np.delete(np.diff(fraction), starts[1:-1] - 1) < 0.05).all()
    assert arrays["fraction"][0] == 0
    assert arrays["fraction"][-1] == 1


def test_the_cusps_next_to_the_contact_are_those_of_a_flat() -> None:
    header, arrays = unpack(_seen.section(PLANE, "", 0.7, 1.0, 0.0))
    assert header["contact"]["u"] == pytest.approx(1.0, abs=1e-12)
    near, left = arrays["near"].astype(float), arrays["left_gap"].astype(float)
    cut = near >= 0
    cusp = 0.5 - np.sqrt(0.5**2 - 0.01**2)
    assert left[cut].max() == pytest.approx(cusp, rel=1e-3)
    assert left[cut].min() == pytest.approx(0, abs=1e-9)
    # Towards the axis nothing is cut yet: there only the edge stands.
    np.testing.assert_allclose(left[near < -0.011], arrays["edge_gap"][near < -0.011], rtol=1e-6)
    edge = arrays["edge"].astype(float)
    round_ = np.abs(edge[:, 0] - 1.0) < 0.5 * np.sin(np.deg2rad(50))
    away = np.hypot(edge[round_, 0] - 1.0, edge[round_, 1] - 0.5)
    np.testing.assert_allclose(away, 0.5, atol=1e-6)


def test_maps_are_listed_as_they_are_stored(made: tuple[Path, tw.job.Result]) -> None:
    out, result = made
    reported = _made.list_maps(str(out))
    assert [one["name"] for one in reported] == ["whole part", "spot"]
    assert [one["shape"] for one in reported] == [list(one.error.z.shape) for one in result.predictions]
    assert reported[1]["pixel"] == pytest.approx(0.002)


@pytest.mark.parametrize("quantity", ["error", "height"])
def test_a_fine_window_is_that_of_generate(made: tuple[Path, tw.job.Result], quantity: str) -> None:
    out, result = made
    # From inside the part to beyond its rim.
    x, y = np.linspace(1.93, 2.01, 61), np.linspace(-0.3, -0.21, 71)
    header, arrays = unpack(
        _made.window(str(out), "whole part", (x[0], x[-1]), (y[0], y[-1]), (y.size, x.size), quantity)
    )
    job = result.job
    again = tw.read_nc(out / result.program.files[0].name, result.machine)
    whole = tw.generate(again, job.actual_tool, x=x, y=y, machine=job.actual_machine)
    inside = np.hypot(*np.meshgrid(x, y)) <= job.part.radius
    px, py = (one[inside] for one in np.meshgrid(x, y))
    wanted = whole.z[inside] - job.part.surface.sag(px, py)
    if quantity == "height":
        wanted = wanted + job.part.surface.sag(px, py)
    np.testing.assert_array_equal(arrays["values"][inside], wanted.astype("<f4"))
    assert np.isnan(arrays["values"][~inside]).all()
    assert header["source"] == "generated"
    assert 100 < np.count_nonzero(~inside) < inside.size - 100


def test_a_coarse_window_is_what_was_stored(made: tuple[Path, tw.job.Result]) -> None:
    out, result = made
    spot = next(one.error for one in result.predictions if one.name == "spot")
    assert spot.x is not None
    assert spot.y is not None
    ends = (float(spot.x[0]), float(spot.x[-1])), (float(spot.y[0]), float(spot.y[-1]))
    header, arrays = unpack(_made.window(str(out), "spot", *ends, spot.z.shape, "error"))
    np.testing.assert_array_equal(arrays["values"], spot.z.astype("<f4"))
    assert (header["source"], header["mean_of"]) == ("stored", 1)
    with pytest.raises(tw.InputError, match="whole part, spot"):
        _made.window(str(out), "../../etc", *ends, (5, 5), "error")


@pytest.mark.parametrize("interpolation", ["linear", "cubic spline"])
def test_regenerated_map_is_the_stored_one(interpolation: str, tmp_path: Path) -> None:
    # Oracle: the run itself, whatever the controller makes of the points of its program.
    lathe = tmp_path / "lathe.toml"
    generic = Path(turnwright.__file__).parent / "machines" / "generic.toml"
    lathe.write_text(f'{generic.read_text(encoding="utf-8")}\n[controller]\ninterpolation = "{interpolation}"\n')
    data = {**BOWL, "machine": {"file": str(lathe)}}
    job = tw.Job.read({**data, "strategy": {**BOWL["strategy"], "points_per_rev": 24}})
    result = tw.run(job, out=tmp_path)
    archive_run(result, tmp_path)
    spot = result.predictions[1].error
    assert spot.x is not None
    assert spot.y is not None
    error, _ = _made.simulate_window(str(tmp_path), spot.x, spot.y)
    np.testing.assert_array_equal(error, spot.z)


def test_a_whole_map_is_the_mean_of_what_was_stored(made: tuple[Path, tw.job.Result]) -> None:
    out, result = made
    stored = result.predictions[0].error
    header, arrays = unpack(_made.window(str(out), "whole part", (-2.0, 2.0), (-2.0, 2.0), (41, 41), "error"))
    many = header["mean_of"]
    assert many == 10
    # Along +x, on the first ray: radii of every fifth stored height.
    ray = stored.z[0]
    rings = np.rint(np.linspace(0.4, 1.6, 13) / 0.02).astype(int)
    wanted = [np.mean(ray[k - 5 : k + 5]) for k in rings]
    np.testing.assert_allclose(arrays["values"][20, 24:37], wanted, rtol=1e-5)
    assert np.isnan(arrays["values"][0, 0])


def test_a_profile_is_generated_at_its_points(made: tuple[Path, tw.job.Result]) -> None:
    out, result = made
    header, arrays = unpack(_made.profile(str(out), (0.5, 0.1, 0.62, -0.05), 301))
    share = np.linspace(0, 1, 301)
    x, y = 0.5 + share * 0.12, 0.1 - share * 0.15
    again = tw.read_nc(out / result.program.files[0].name, result.machine)
    wanted = tw.generate_points(again, result.job.actual_tool, x=x, y=y) - result.part.surface.sag(x, y)
    np.testing.assert_allclose(arrays["error"], wanted, atol=1e-12)
    assert header["length"] == pytest.approx(np.hypot(0.12, 0.15))
    np.testing.assert_allclose(arrays["distance"], share * header["length"], rtol=1e-6)


def test_the_motion_keeps_every_peak(made: tuple[Path, tw.job.Result]) -> None:
    out, result = made
    again = tw.read_nc(out / result.program.files[0].name, result.machine)
    limits = tw.check_limits(again, result.machine)
    header, arrays = unpack(_made.motion(str(out), 40))
    for letter in "CXZ":
        for kind, peaks in (
            ("speed", limits.peak_speed),
            ("acceleration", limits.peak_acceleration),
            ("jerk", limits.peak_jerk),
        ):
            assert header["axes"][letter]["peaks"][kind] == pytest.approx(peaks[letter], rel=1e-9)
            assert arrays[f"{letter} {kind}"].max() == pytest.approx(peaks[letter], rel=1e-6)
        assert arrays[f"{letter} low"].min() == pytest.approx(again.axes[letter].min(), rel=1e-6, abs=1e-7)
    assert header["duration_s"] == pytest.approx(float(again.time[-1] - again.time[0]))


def test_the_spectrum_finds_a_sine(made: tuple[Path, tw.job.Result], monkeypatch: pytest.MonkeyPatch) -> None:
    out, _ = made
    opened = _made._ready(str(out))
    time = opened.motion.time
    sine = 2e-5 * np.sin(2 * np.pi * 7.5 * time)
    motion = replace(opened.motion, axes={**opened.motion.axes, "Z": sine})
    monkeypatch.setitem(_made._opened, str(out), replace(opened, motion=motion))
    header, arrays = unpack(_made.spectrum(str(out), "Z"))
    at = int(np.argmax(arrays["amplitude"]))
    assert arrays["frequency"][at] == pytest.approx(7.5, abs=0.5)
    assert arrays["amplitude"][at] == pytest.approx(2e-5, rel=0.1)
    limit = opened.job.machine.axes["Z"].amplitude(arrays["frequency"].astype(float))
    np.testing.assert_allclose(arrays["allowed"], limit, rtol=1e-5)
    assert header["axis"] == "Z"
    with pytest.raises(tw.InputError, match="C, X, Z"):
        _made.spectrum(str(out), "B")


def test_the_routes_answer_and_keep_their_limits(made: tuple[Path, tw.job.Result]) -> None:
    out, result = made
    app = create_app(out.parents[2])
    with TestClient(app, base_url="http://127.0.0.1:8765") as client:
        view = {"data": PLANE, "quantity": "slope", "pixels": 16}
        found = client.post("/api/view/surface", json=view)
        assert (found.status_code, found.headers["content-type"]) == (200, MEDIA_TYPE)
        assert unpack(found.content)[1]["values"].shape == (16, 16)
        assert client.post("/api/view/path", json={"data": PLANE, "points": 500}).status_code == 200
        place = {"angle": 0.3, "radius": 1.0}
        assert client.post("/api/view/section", json={"data": PLANE, "at": place}).status_code == 200
        found = client.get(f"/api/runs/{RUN}/map", params={"nx": 30, "ny": 20})
        assert unpack(found.content)[1]["values"].shape == (20, 30)
        fine = {"x0": 1, "x1": 1.01, "y0": 0, "y1": 0.01, "nx": 30, "ny": 30}
        assert unpack(client.get(f"/api/runs/{RUN}/map", params=fine).content)[0]["source"] == "generated"
        listed = client.get(f"/api/runs/{RUN}/maps").json()
        assert [one["name"] for one in listed] == [one.name for one in result.predictions]
        for body in ({**view, "pixels": 5000}, {**view, "quantity": "../x"}, {**view, "data": {"part": 3}}):
            assert client.post("/api/view/surface", json=body).status_code == 422
        for query, status in (
            ({"nx": 100_000}, 422), ({"x0": 1, "x1": 1}, 422), ({"x0": "nan"}, 422), ({"name": "../etc/passwd"}, 404),
        ):  # fmt: skip
            answer = client.get(f"/api/runs/{RUN}/map", params=query)
            assert answer.status_code == status
            assert isinstance(answer.json()["detail"], str)
        assert client.get("/api/runs/ffffffffffffffff/maps").status_code == 404
        assert client.get("/api/runs/..%2f..%2fetc/maps").status_code in (404, 422)
        line = {"x0": 0, "y0": 0, "x1": 0, "y1": 0}
        assert client.get(f"/api/runs/{RUN}/profile", params=line).status_code == 422


def _nodes(name: str) -> np.ndarray:
    """Return the colours of a table of the page. (33, 3) [0 to 1]."""
    text = (STATIC / "colour.js").read_text(encoding="utf-8")
    block = re.search(rf"{name}:\n((?:\s+\"[0-9a-f]+\"[ +,]*\n)+)", text)
    assert block is not None
    digits = "".join(re.findall(r"[0-9a-f]{6,}", block.group(1)))
    return np.frombuffer(bytes.fromhex(digits), np.uint8).reshape(33, 3) / 255


@pytest.mark.parametrize("name", ["viridis", "cividis"])
def test_the_colours_of_values_are_those_of_matplotlib(name: str) -> None:
    from matplotlib import colormaps

    wanted = colormaps[name](np.linspace(0, 1, 33))[:, :3]
    np.testing.assert_allclose(_nodes(name), wanted, atol=0.5 / 255 + 1e-9)


@pytest.mark.parametrize("name", ["light", "dark"])
def test_the_colours_of_errors_are_even_and_alike_on_both_sides(name: str) -> None:
    # Oracle: CIE lightness, another measure than the one that they were made by.
    srgb = _nodes(name)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    luminance = linear @ np.array([0.2126, 0.7152, 0.0722])
    lightness = 116 * np.cbrt(luminance) - 16
    way = -1 if name == "light" else 1
    assert (np.diff(way * lightness[16:]) > 0).all()
    assert (np.diff(way * lightness[16::-1]) > 0).all()
    np.testing.assert_allclose(lightness, lightness[::-1], atol=6)
    steps = np.abs(np.diff(lightness))
    assert steps.max() < 2.2 * np.median(steps)
    red_less_blue = srgb[:, 0] - srgb[:, 2]
    assert (red_less_blue[20:] > 0.05).all()
    assert (red_less_blue[:13] < -0.05).all()
