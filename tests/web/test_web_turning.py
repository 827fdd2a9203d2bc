"""A job in spindle mode in the workbench. Oracle: the command line, and the program read back."""

import numpy as np
import pytest
from fastapi.testclient import TestClient

import turnwright as tw
from turnwright.cli import main
from turnwright.job import Job
from turnwright.web import create_app

JOB = {
    "part": {"surface": {"family": "sphere", "radius": "50 mm"}, "radius": "1 mm", "stock": "20 um"},
    "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
    "machine": {"name": "nanoform"},
    "strategy": {"kind": "turning", "feed": "10 um/rev", "spindle_speed": "1000 rpm", "chord": "1 nm"},
    "simulation": {"whole_part": {"radii": 60, "angles": 36}},
}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    app = create_app(tmp_path_factory.mktemp("workbench"), at_a_time=2, nice=0)
    with TestClient(app, base_url="http://127.0.0.1:8765") as client:
        yield client


def test_a_turned_part_is_checked_run_and_shown(client, tmp_path):
    reported = client.post("/api/job/check", json={"data": JOB}).json()
    assert reported["errors"] == []
    name = client.post("/api/runs", json={"data": JOB, "kind": "run"}).json()["id"]
    with client.stream("GET", f"/api/runs/{name}/events") as stream:
        _ = [*stream.iter_lines()]
    run = client.get(f"/api/runs/{name}").json()
    assert run["state"] == "done", run["sentence"]
    Job.read(JOB).dump(tmp_path / "job.toml")
    assert main(["run", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]) == 0
    ours = (tmp_path / "out" / "part.nc").read_bytes()
    assert client.get(f"/api/runs/{name}/files/program").content == ours

    motion = tw.read_nc(tmp_path / "out" / "part.nc", tw.Machine.load("nanoform"))
    x, z = (motion.axes[letter][motion.blocks] for letter in "XZ")
    for point in (20, x.size // 2):
        near = f"{-0.6 * x[point]},{0.8 * x[point]}"  # at any azimuth
        line = client.get(f"/api/runs/{name}/program", params={"near": near}).json()["line"]
        row = client.get(f"/api/runs/{name}/program", params={"first": line, "count": 1}).json()
        assert np.allclose(row["places"][0], [x[point], 0, z[point]], atol=1e-6)


def test_a_surface_that_is_none_of_revolution_is_refused(client):
    surface = [
        JOB["part"]["surface"],
        {"family": "zernike", "indexing": "fringe", "radius": "1 mm", "units": "nm", "terms": {"5": 40}},
    ]
    job = {**JOB, "part": {**JOB["part"], "surface": surface}}
    reported = client.post("/api/job/check", json={"data": job}).json()
    assert "nm" in str(reported)
    assert "surface of revolution by 40 nm" in str(reported)
