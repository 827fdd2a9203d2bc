"""The server of the workbench. Oracles: the command line, read_nc, the job classes, another JSON schema validator."""

import io
import json
import os
import re
import shutil
import time
import tomllib
import zipfile
from dataclasses import replace
from importlib import resources

import jsonschema
import numpy as np
import pytest
import tomli_w
from fastapi.testclient import TestClient

import turnwright as tw
from dish import DISH, OFFSET, seen
from job_files import changed, written
from patience import PATIENCE_S
from turnwright._tables import adapter
from turnwright.cli import main
from turnwright.job import Job, compare, correct, diagnose, measure, preview
from turnwright.report import archive_comparison
from turnwright.units import convert, parse
from turnwright.web import create_app
from turnwright.web.binary import unpack
from turnwright.web.examples import examples
from turnwright.web.measurement_data import write_predicted
from turnwright.web.queue import Runs
from turnwright.web.references import FILE_KEYS, located

HERE = "http://127.0.0.1:8765"
# A run of some seconds that a test interrupts.
LONG = changed(("strategy.feed", "1 um/rev"), ("strategy.points_per_rev", 3600), ("simulation.patches", []))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("workbench")


@pytest.fixture(scope="module")
def client(folder):
    with TestClient(create_app(folder, at_a_time=2, nice=0), base_url=HERE) as client:
        yield client


def ended(client, name, *, state="done"):
    """Wait for the end of a run as a page does, by its events."""
    reported = []
    with client.stream("GET", f"/api/runs/{name}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = [line for line in stream.iter_lines() if line and not line.startswith(":")]
    for kind, data in zip(lines[::2], lines[1::2], strict=True):
        reported.append((kind.removeprefix("event: "), json.loads(data.removeprefix("data: "))))
    run = client.get(f"/api/runs/{name}").json()
    assert run["state"] == state, run["sentence"]
    assert reported[-1] == ("state", {"state": state, "sentence": run["sentence"]})
    return reported


@pytest.fixture(scope="module")
def dish(folder, client):
    """A job by the server and by the command line."""
    job = changed(*DISH)
    name = client.post("/api/runs", json={"data": job, "kind": "run"}).json()["id"]
    reported = ended(client, name)
    file = written(folder, *DISH)
    assert main(["run", str(file), "--out", str(folder / "by-hand")]) == 0
    return name, folder / "by-hand", reported


def test_the_server_says_what_it_is(client):
    reported = client.get("/api/about").json()
    assert reported["version"] == tw.__version__
    assert "infrared_lens" in reported["examples"]
    assert reported["limits"]["upload_bytes"] == 2 * 2**30


def test_the_page_may_load_only_from_the_server(client):
    answer = client.get("/")
    assert answer.status_code == 200
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_every_example_is_a_job_in_the_schema(client):
    schema = client.get("/api/schema").json()
    check = jsonschema.Draft202012Validator(schema)
    listed = client.get("/api/examples").json()
    assert [one["name"] for one in listed] == list(examples())
    for one in listed:
        reported = client.get(f"/api/examples/{one['name']}").json()
        assert reported["errors"] == []
        assert [error.message for error in check.iter_errors(reported["data"])] == []
        # The text and the data say the same, and a page can send either back.
        assert tomllib.loads(reported["toml"])["tool"] == reported["data"]["tool"]
        assert client.post("/api/job/parse", json={"toml": reported["toml"]}).json() == {
            "data": reported["data"],
            "errors": [],
        }
        back = client.post("/api/job/write", json={"data": reported["data"]}).json()
        assert back["errors"] == []
        assert tomllib.loads(back["toml"]) == reported["data"]


def leaves(schema, node, where=""):
    if "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    for name, field in node.get("properties", {}).items():
        yield node["title"], f"{where}{name}", field


def test_every_field_of_the_schema_explains_itself(client):
    schema = client.get("/api/schema").json()
    fields = [leaf for node in [schema, *schema["$defs"].values()] for leaf in leaves(schema, node)]
    assert len(fields) > 150
    assert [f"{table}.{name}" for table, name, field in fields if not field["description"] or not field["title"]] == []
    for table, name, field in fields:
        if "unit" in field:
            # What is shown measures the same as what is meant.
            assert convert(1.0, field["unit"], field["display"]) > 0, (table, name)


def test_drawings_of_the_fields_are_served(client):
    script = client.get("/form.js").text
    rows = re.findall(r'^  \[/(.+)/, "(\w+)", ', script, re.MULTILINE)
    assert len(rows) > 8
    schema = client.get("/api/schema").json()
    keys = {name for node in [schema, *schema["$defs"].values()] for _, name, _ in leaves(schema, node)}
    for fields, drawing in rows:
        answer = client.get(f"/drawings/{drawing}.svg")
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/svg+xml")
        assert set(re.findall(r"[a-z_]{4,}", fields)) & keys, fields


def test_every_field_that_names_a_file_says_which_it_takes(client):
    """What the page offers there is what the server then takes."""
    schema = client.get("/api/schema").json()
    fields = [leaf for node in [schema, *schema["$defs"].values()] for leaf in leaves(schema, node)]
    holds = {(name, field["holds"]) for _, name, field in fields if "holds" in field}
    assert holds == {
        ("file", "heights"), ("file", "machine"), ("waviness_file", "waviness"), ("straightness_file", "straightness"),
        ("correction", "correction"), ("material", "material"), ("mask", "heights"),
        ("file", "instrument"),
    }  # fmt: skip
    for _, name, field in fields:
        if field.get("format") == "reference":
            assert field["holds"], name
        for ending in field.get("endings", []):
            answer = client.post("/api/files", params={"kind": field["holds"], "name": f"x{ending}"}, content=b"?")
            assert answer.status_code == 422
            assert "ends in" not in answer.json()["detail"], name


def test_errors_stand_where_the_field_is(client):
    job = changed(("tool.nose_radius", "0.5"), ("strategy.fed", "1 um/rev"), ("part.surface.radius", "0,5 mm"))
    reported = client.post("/api/job/check", json={"data": job}).json()
    assert {one["field"] for one in reported["errors"]} == {"tool.nose_radius", "strategy.fed", "part.surface.radius"}
    assert reported["access"] is None
    broken = client.post("/api/job/parse", json={"toml": "[part"}).json()
    assert broken["data"] == {}
    assert "not TOML" in broken["errors"][0]["sentence"]


def test_a_check_says_what_the_job_classes_say(client):
    job = changed(("tool.included", "20 deg"), ("part.surface.radius", "2 mm"))
    reported = client.post("/api/job/check", json={"data": job}).json()
    plan = preview(Job.read(job))
    assert reported["access"]["ok"] is plan.access.ok is False
    assert reported["access"]["nose_radius_limit"] == pytest.approx(plan.access.nose_radius_limit)
    assert [one["sentence"] for one in reported["access"]["findings"]] == [one.sentence for one in plan.access.findings]
    assert reported["preview"]["points"] == dict(plan.points)
    assert reported["preview"]["refused"] == list(plan.refused)


def test_the_program_is_that_of_the_command_line(client, dish):
    name, by_hand, _ = dish
    files = client.get(f"/api/runs/{name}").json()["files"]
    for one in files:
        answer = client.get(f"/api/runs/{name}/files/{one['name']}", params={"part": one["part"]})
        assert answer.headers["content-disposition"].startswith("attachment")
        assert len(answer.content) == one["bytes"]
        if one["name"] in ("program", "job"):
            assert answer.content == (by_hand / one["file"]).read_bytes()
    mine, theirs = client.get(f"/api/runs/{name}/result").json(), json.loads((by_hand / "result.json").read_text())
    for reported in (mine, theirs):
        reported.pop("timings"), reported.pop("peak_memory_gb")
    assert mine == theirs


def test_all_files_of_a_program_come_together(client, dish):
    name, by_hand, _ = dish
    answer = client.get(f"/api/runs/{name}/files/programs")
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        assert archive.testzip() is None
        assert {one: archive.read(one) for one in archive.namelist()} == {"part.nc": (by_hand / "part.nc").read_bytes()}


def test_a_run_tells_its_progress(dish):
    reported = dish[2]
    stages = [data["stage"] for kind, data in reported if kind == "progress"]
    assert len(set(stages)) >= 2
    fractions = [data["fraction"] for kind, data in reported if kind == "progress"]
    assert fractions == sorted(fractions)
    assert all(0 <= one <= 1 for one in fractions)
    assert all(
        1 <= data["step"] <= data["steps"] and data["left_s"] >= 0 for kind, data in reported if kind == "progress"
    )


@pytest.fixture(scope="module")
def strict(client):
    """A run that misses a tolerance: its job with the text that a person wrote, its id, and the text to be kept."""
    text = tomli_w.dumps(changed(*DISH, ("tolerances.form_pv", "1 nm"))).replace("[tool]", "# from the drawer\n[tool]")
    job = changed(*DISH, ("tolerances.form_pv", "1 nm"), ("strategy.feed", "25 um/rev"))
    request = {"data": job, "toml": text}
    name = client.post("/api/runs", json={**request, "kind": "run"}).json()["id"]
    ended(client, name)
    return request, name, text.replace("20 um/rev", "25 um/rev")


def test_a_run_that_misses_a_tolerance_says_so_in_the_list(client, dish, strict):
    """The list put a green tick next to it."""
    name = strict[1]
    missed = {one["id"]: one["missed"] for one in client.get("/api/runs").json()}
    assert missed[name] is True
    assert missed[dish[0]] is False


def test_lines_of_the_program_lie_where_the_motion_is(client, dish):
    name, by_hand, _ = dish
    motion = tw.read_nc(by_hand / "part.nc", tw.Machine.load("generic"))
    angle, x, z = (motion.axes[letter] for letter in "CXZ")
    tip = np.stack([x * np.cos(angle), x * np.sin(angle), z], axis=1)
    text = (by_hand / "part.nc").read_text().splitlines()
    first = len(text) - text[::-1].index("G93")  # the plunge before it begins with G93 too
    begin = first - 100
    reported = client.get(f"/api/runs/{name}/program", params={"first": begin, "count": 2000}).json()
    assert reported["lines"] == text[begin : begin + 2000]
    assert reported["total"] == len(text)
    places = np.array(reported["places"][100:])
    np.testing.assert_allclose(places, tip[1 : len(places) + 1], atol=2e-8)
    for row in (700, 2500):
        line = client.get(f"/api/runs/{name}/program", params={"near": f"{tip[row, 0]},{tip[row, 1]}"}).json()["line"]
        assert line == first + row - 1
    assert client.get(f"/api/runs/{name}/program", params={"first": 10**9}).json()["lines"] == []


def test_a_long_program_is_found_by_its_index(tmp_path, monkeypatch):
    """The index knows every 16th line only; the nearest of all lines is the oracle."""
    from turnwright.web import program as _program

    monkeypatch.setattr(_program, "MAX_FULLY_INDEXED_LINES", 300)
    file = written(tmp_path, ("machine.name", "nanotech-350fg"), ("program.max_lines", 2000))
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 0
    machine = tw.Machine.load("nanotech-350fg")
    _program.index(tmp_path / "out", machine)
    whole = _program.lines(str(tmp_path / "out"), 0, 10**6)
    places = np.array([[np.nan] * 3 if one is None else one for one in whole["places"]])
    assert whole["total"] == len(whole["lines"]) > 5000
    rng = np.random.default_rng(3)
    for x, y in rng.uniform(-0.6, 0.6, (12, 2)):
        line = _program.nearest_line(str(tmp_path / "out"), x, y)["line"]
        best = np.nanmin(np.hypot(places[:, 0] - x, places[:, 1] - y))
        assert np.hypot(*(places[line, :2] - (x, y))) == pytest.approx(best, abs=1e-9)
        assert _program.lines(str(tmp_path / "out"), line, 1)["lines"] == [whole["lines"][line]]


def test_a_comparison_is_that_of_the_command_line(client, folder):
    job = changed(("part.radius", "0.3 mm"), ("strategy.feed", "50 um/rev"), ("simulation.patches", []))
    name = client.post("/api/runs", json={"data": job, "kind": "compare", "name": "which way"}).json()["id"]
    ended(client, name)
    reported = client.get(f"/api/runs/{name}/comparison").json()
    (folder / "compared").mkdir()
    archive_comparison(compare(Job.read(job)), folder / "compared")
    theirs = json.loads((folder / "compared" / "comparison.json").read_text())
    for one in (*reported["candidates"], *theirs["candidates"]):
        one.pop("wall_s")
    assert reported == theirs
    assert client.get(f"/api/runs/{name}").json()["name"] == "which way"


@pytest.fixture(scope="module")
def measured(client, dish, folder):
    """A map of the dish as a tool offset of 3 um would have cut it, sent as a page sends it."""
    file = seen(folder / "job.toml", folder / "dish.x3p")
    answer = client.post("/api/measurements", params={"run": dish[0], "name": "dish.x3p"}, content=file.read_bytes())
    assert answer.status_code == 201, answer.text
    ended(client, answer.json()["id"])
    return answer.json()["id"]


def test_a_measured_map_tells_the_injected_offset(client, measured):
    reported = client.get(f"/api/measurements/{measured}").json()
    offset = next(one for one in reported["findings"] if one["name"] == "offset x")
    assert offset["value"] == pytest.approx(OFFSET, abs=offset["uncertainty"])
    assert {one["name"] for one in reported["contributions"]} >= {"drift of Z", "low form"}
    assert offset["correctable"]
    assert reported["alignment"]["rms_nm"] > 0
    assert len(reported["zernike"]) == 37
    assert reported["psd"]["frequency"]
    for name in ("measured", "residual"):
        header, arrays = unpack(
            client.get(f"/api/measurements/{measured}/map", params={"name": name, "nx": 60, "ny": 50}).content
        )
        assert arrays["values"].shape == (50, 60)
        assert header["low"] < 0 < header["high"]
        assert header["x"] == [-2, 2]
    assert client.get(f"/api/measurements/{measured}/map", params={"name": "predicted"}).status_code == 409
    assert b"<html" in client.get(f"/api/measurements/{measured}/files/report").content


def test_a_correction_plans_with_the_tool_as_it_was_found(client, measured, folder):
    wrong = client.post(f"/api/measurements/{measured}/correct", json={"error_sources": ["weather"]})
    assert wrong.status_code == 422
    reported = client.get(f"/api/measurements/{measured}").json()
    error_source = next(one["error_source"] for one in reported["findings"] if one["name"] == "offset x")
    name = client.post(f"/api/measurements/{measured}/correct", json={"error_sources": [error_source]}).json()["id"]
    ended(client, name)
    run = client.get(f"/api/runs/{name}").json()
    assert parse(run["data"]["tool"]["offset"][0], "mm") == pytest.approx(OFFSET, abs=5e-4)
    reported = client.get(f"/api/measurements/{measured}").json()
    assert reported["correction"] == name
    # The same by what the command line calls, of a job that corrects this cause.
    (folder / "again").mkdir()
    part = measure(Job.read(changed(*DISH, ("measurement.correct", [error_source]))), tw.read_map(folder / "dish.x3p"))
    better = correct(part.job, diagnose([part]), [part], out=folder / "again")
    left = reported["predicted"]["predicted"]
    assert (left["pv_nm"], left["rms_nm"]) == pytest.approx(better.numbers_nm["predicted"], rel=1e-9)
    assert reported["predicted"]["missed"] == []
    strict = replace(better, job=Job.read(changed(*DISH, ("tolerances.form_pv", "1 nm"))))
    write_predicted(strict, folder / "again")
    (missed,) = json.loads((folder / "again" / "shown.json").read_text())["missed"]
    assert missed == strict.verdicts[0].sentence
    ours = client.get(f"/api/measurements/{measured}/files/job").content.decode()
    both = [tomllib.loads(ours), tomllib.loads(better.file.read_text())]
    # Threads add up in any order, so the last digits of what was found may differ.
    found, again = ([parse(one, "mm") for one in job["tool"].pop("offset")] for job in both)
    assert found == pytest.approx(again, rel=1e-9, abs=1e-12)
    assert both[0] == both[1]
    header, _ = unpack(client.get(f"/api/measurements/{measured}/map", params={"name": "predicted"}).content)
    assert header["unit"] == "nm"
    assert client.get(f"/api/measurements/{measured}/files/program").content.startswith(b"(")
    # The corrected job goes back into the form, with the file that belongs to it.
    checked = client.post("/api/job/check", json={"data": run["data"]}).json()
    assert checked["errors"] == []


def test_a_map_is_shown_without_a_job_and_not_kept(client, folder, tmp_path):
    x = 0.002 * np.arange(80)
    z = 1e-5 * np.cos(2 * np.pi * np.arange(80) / 20) + 0.01 * x + np.zeros((60, 1))
    z[4, 5] = np.nan
    tw.write_map(tw.HeightMap(z=z, x=x, y=0.002 * np.arange(60)), tmp_path / "a.npz")
    before = sorted(folder.rglob("*.npz"))
    answer = client.post(
        "/api/measurements/show", params={"name": "../my map.npz"}, content=(tmp_path / "a.npz").read_bytes()
    )
    assert answer.status_code == 200, answer.text
    header, arrays = unpack(answer.content)
    rows = dict(header["rows"])
    assert rows["size"] == "80 x 60 points, 2 um x 2 um apart, 158 um x 118 um"
    assert rows["missing"] == "1 of 4,800 (0.0208 %)"
    assert float(rows["Sq"].split()[0]) == pytest.approx(1e6 * 1e-5 / np.sqrt(2), rel=0.01)
    assert arrays["values"].shape == (60, 80)
    assert np.nanstd(arrays["values"]) == pytest.approx(1e6 * 1e-5 / np.sqrt(2), rel=0.01)
    assert header["x"] == pytest.approx([0.0, 0.158])
    assert sorted(folder.rglob("*.npz")) == before
    radius, angle = np.linspace(0, 1, 20), np.linspace(0, 2 * np.pi, 24, endpoint=False)
    tw.write_map(tw.HeightMap(z=np.zeros((24, 20)), radius=radius, angle=angle), tmp_path / "a.npz")
    answer = client.post("/api/measurements/show", params={"name": "a.npz"}, content=(tmp_path / "a.npz").read_bytes())
    assert unpack(answer.content)[1]["values"].shape == (600, 600)
    for name, content, sentence in (
        ("my map.x3p", b"PK\x03\x04 cut", "my map.x3p is an archive"),
        ("a.exe", b"MZ", "must end in"),
        ("a.npz", b"", "empty"),
    ):
        answer = client.post("/api/measurements/show", params={"name": name}, content=content)
        assert answer.status_code == 422
        assert sentence in answer.json()["detail"]
        assert str(folder) not in answer.json()["detail"]


def test_a_damaged_file_ends_its_own_process_only(client, dish):
    answer = client.post(
        "/api/measurements", params={"run": dish[0], "name": "../my measured.x3p"}, content=b"PK\x03\x04 cut"
    )
    name = answer.json()["id"]
    ended(client, name, state="failed")
    reported = client.get(f"/api/measurements/{name}").json()
    assert "my measured.x3p" in reported["sentence"]  # as who brought it calls it
    assert re.findall("my|measured", reported["sentence"]) == ["my", "measured"]
    assert "/" not in reported["sentence"].replace("and/or", "")
    assert client.delete(f"/api/runs/{name}").status_code == 204
    assert client.get(f"/api/runs/{name}").status_code == 404


def test_a_run_is_cancelled_and_leaves_nothing(client, folder):
    name = client.post("/api/runs", json={"data": LONG, "kind": "run"}).json()["id"]
    until = time.monotonic() + PATIENCE_S
    while not (client.get(f"/api/runs/{name}").json()["progress"]) and time.monotonic() < until:
        time.sleep(0.05)
    assert client.delete(f"/api/runs/{name}").status_code == 409
    reported = client.post(f"/api/runs/{name}/cancel").json()
    assert reported["state"] == "cancelled"
    left = {file.name for file in (folder / "runs" / name).iterdir()}
    assert left == {"job.json", "state.json", "log.txt"}
    assert client.post(f"/api/runs/{name}/cancel").status_code == 409


def test_runs_wait_for_their_turn_and_outlive_the_server(tmp_path, folder, dish):
    """A server that is ended while a run goes on takes its process along; the next one begins the run again."""
    with TestClient(create_app(tmp_path), base_url=HERE) as client:
        first = client.post("/api/runs", json={"data": LONG, "kind": "run", "name": "first"}).json()["id"]
        second = client.post("/api/runs", json={"data": changed(), "kind": "run"}).json()["id"]
        until = time.monotonic() + PATIENCE_S
        while not client.get(f"/api/runs/{first}").json()["progress"] and time.monotonic() < until:
            time.sleep(0.05)
        assert client.get(f"/api/runs/{second}").json()["state"] == "queued"
    assert list((tmp_path / "runs" / first).glob(".out*")) == []
    assert json.loads((tmp_path / "runs" / first / "state.json").read_text())["state"] == "running"
    # As the next server finds them; it has not begun yet.
    found = Runs(tmp_path, at_a_time=1)
    assert [(run.id, run.state, run.name) for run in reversed(found.all())] == [
        (first, "queued", "first"),
        (second, "queued", "dish"),
    ]
    with TestClient(create_app(tmp_path), base_url=HERE) as client:
        reported = {one["id"]: one["state"] for one in client.get("/api/runs").json()}
        assert reported == {first: "running", second: "queued"}
        for name in (second, first):
            assert client.post(f"/api/runs/{name}/cancel").json()["state"] == "cancelled"
    # What has ended stays as it is, and its folder with it.
    assert {run.state for run in Runs(tmp_path, at_a_time=1).all()} == {"cancelled"}
    assert Runs(folder, at_a_time=1).get(dish[0]).state == "done"


def test_only_keys_that_are_watched_name_files():
    """Every field of a job that holds a file is one that the server looks at."""
    schema = adapter(Job).json_schema()
    tables = [schema, *schema["$defs"].values()]
    named = {
        name
        for table in tables
        for name, field in table.get("properties", {}).items()
        for one in (field, *field.get("anyOf", ()))
        if one.get("format") == "path" or one.get("reads") in ("correction", "waviness")
    }
    assert named - {"waviness"} == FILE_KEYS


SAG = 0.01
"""Curvature of the table of heights. [1/mm]"""


def table():
    """A paraboloid as a table of heights in um, twice as wide as the part."""
    x = np.linspace(-2, 2, 41)
    rows = [[y, *(SAG / 2 * 1e3 * (x**2 + y**2))] for y in x]
    lines = [["", *map(repr, x.tolist())], *([repr(float(one)) for one in row] for row in rows)]
    return "".join(",".join(line) + "\n" for line in lines).encode()


WAVY = b"sweep [deg],deviation [nm]\n" + b"".join(b"%d,%d\n" % (place, place % 7) for place in range(-30, 31))
STRAIGHT = b"x [mm],error [nm]\n-2,0\n0,20\n2,0\n"
LATHE = b'base = "generic"\nname = "the one in room 7"\n'
BROUGHT = {
    "heights": ("sag table (2).CSV", table()),
    "waviness": ("edge.csv", WAVY),
    "straightness": ("edge.csv", STRAIGHT),
    "machine": ("../room7.toml", LATHE),
    "material": ("lot.toml", (resources.files("turnwright") / "materials" / "irg26.toml").read_bytes()),
}


def with_files(names):
    """A job that names a file wherever a page can bring one."""
    return changed(
        ("part.surface", {"family": "gridded", "file": names["heights"], "units": "mm", "sag_units": "um"}),
        ("part.material", names["material"]),
        ("tool.waviness_file", names["waviness"]),
        ("machine", {"file": names["machine"], "straightness_file": names["straightness"]}),
        ("simulation", {"whole_part": {"radii": 11, "angles": 6}, "patches": []}),
        ("strategy.feed", "40 um/rev"),
    )


@pytest.mark.parametrize(("text", "status"), [(b'pixel = "3 um"', 201), (b'pixels = "3 um"', 422)])
def test_the_file_of_an_instrument_is_read_when_it_is_brought(client, text, status):
    answer = client.post("/api/files", params={"kind": "instrument", "name": "mine.toml"}, content=text)
    assert answer.status_code == status, answer.text


def test_files_travel_with_a_job_to_the_command_line(client, folder, tmp_path):
    """Oracles: the bytes that were brought, and the command line with them on disk."""
    reported = {}
    for kind, (name, content) in BROUGHT.items():
        answer = client.post("/api/files", params={"kind": kind, "name": name}, content=content)
        assert answer.status_code == 201, answer.text
        reported[kind] = answer.json()
        assert reported[kind]["bytes"] == len(content)
    # Its bytes alone say where a file lies.
    again = client.post("/api/files", params={"kind": "waviness", "name": "x.csv"}, content=WAVY).json()["reference"]
    assert again.split("/")[1] == reported["waviness"]["reference"].split("/")[1]
    job = with_files({kind: one["reference"] for kind, one in reported.items()})
    checked = client.post("/api/job/check", json={"data": job}).json()
    assert checked["errors"] == []
    name = client.post("/api/runs", json={"data": job, "kind": "run"}).json()["id"]
    ended(client, name)
    files = {one["name"]: one for one in client.get(f"/api/runs/{name}").json()["files"]}
    ours = client.get(f"/api/runs/{name}/files/program").content

    packed = client.get(f"/api/runs/{name}/files/bundle").content
    assert len(packed) == files["bundle"]["bytes"]
    assert client.post("/api/job/bundle", json={"data": job}).headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        archive.extractall(tmp_path)
    names = {"heights": "sag_table_2.csv", "material": "lot.toml", "machine": "room7.toml"}
    names |= {"waviness": "edge.csv", "straightness": "edge-2.csv"}
    assert {one.name for one in tmp_path.iterdir()} == {"job.toml", *names.values()}
    for kind, (_, content) in BROUGHT.items():
        assert (tmp_path / names[kind]).read_bytes() == content
    assert tomllib.loads((tmp_path / "job.toml").read_text()) == with_files(names)
    assert main(["run", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]) == 0
    assert ours == (tmp_path / "out" / "part.nc").read_bytes()


def grid_sag():
    """The same paraboloid as Zemax writes it: rows from the top down, unit 0 is mm."""
    x = np.linspace(-2, 2, 41)
    rows = [f"{SAG / 2 * (a**2 + b**2):.12f} 0 0 0 0" for b in x[::-1] for a in x]
    return ("41 41 0.1 0.1 0 0 0\n" + "\n".join(rows) + "\n").encode()


def list_of_points():
    """The same as a list that states the units of its columns, with decimal commas."""
    x = np.linspace(-2, 2, 41)
    rows = [f"{a};{b};{SAG / 2 * 1e3 * (a**2 + b**2):.9f}".replace(".", ",") for b in x for a in x]
    return ("x [mm];y [mm];z [um]\n" + "\n".join(rows) + "\n").encode()


@pytest.mark.parametrize(
    ("name", "content", "keys"),
    [
        ("lens.dat", grid_sag(), {}),
        ("list.txt", list_of_points(), {}),
        ("table.csv", table(), {"units": "mm", "sag_units": "um"}),
        ("half.csv", b"x [mm],y [mm],z\n" + b"".join(
            b"%.3f,%.3f,%.9f\n" % (a, b, SAG / 2 * 1e3 * (a * a + b * b))
            for b in np.linspace(-2, 2, 41) for a in np.linspace(-2, 2, 41)
        ), {"sag_units": "um"}),
    ],
)  # fmt: skip
def test_a_table_with_units_of_its_own_is_brought_too(client, name, content, keys):
    """Oracle: the paraboloid that all of them hold, 1 mm out and so 5 um up."""
    answer = client.post("/api/files", params={"kind": "heights", "name": name}, content=content)
    assert answer.status_code == 201, answer.text
    job = changed(("part.surface", {"family": "gridded", "file": answer.json()["reference"], **keys}))
    reported = client.post("/api/job/check", json={"data": job}).json()
    assert reported["errors"] == []
    assert reported["preview"]["shape"]["Heights"].endswith("PV 5 um")


def test_a_check_names_the_tolerances_that_it_does_not_judge(client):
    job = changed(("tolerances", {"form_pv": "100 nm", "sq": "8 nm"}))
    reported = client.post("/api/job/check", json={"data": job}).json()["preview"]["unjudged"]
    assert [("form error PV" in one, "Sq" in one, "not evaluated" in one) for one in reported] == [
        (True, False, True), (False, True, True),
    ]  # fmt: skip
    assert client.post("/api/job/check", json={"data": changed()}).json()["preview"]["unjudged"] == []


def test_an_archive_of_a_job_is_opened_again(client):
    """Oracles: the archive that the page itself saves, the bytes that were brought, and the remarks in its text."""
    reported = {
        kind: client.post("/api/files", params={"kind": kind, "name": name}, content=content).json()["reference"]
        for kind, (name, content) in BROUGHT.items()
    }
    job = with_files(reported)
    text = client.post("/api/job/write", json={"data": job}).json()["toml"].replace("[tool]", "# the good one\n[tool]")
    saved = client.post("/api/job/bundle", json={"data": job, "toml": text}).content
    with zipfile.ZipFile(io.BytesIO(saved)) as archive:
        assert "# the good one" in archive.read("job.toml").decode()
    opened = client.post("/api/files/archive", content=saved)
    assert opened.status_code == 201, opened.text
    assert opened.json()["errors"] == []
    assert "# the good one" in opened.json()["toml"]
    assert tomllib.loads(opened.json()["toml"]) == opened.json()["data"]
    again = client.post("/api/job/bundle", json={"data": opened.json()["data"]}).content
    with zipfile.ZipFile(io.BytesIO(saved)) as first, zipfile.ZipFile(io.BytesIO(again)) as second:
        assert sorted(first.namelist()) == sorted(second.namelist())
        for name in first.namelist()[1:]:
            assert first.read(name) == second.read(name)
        assert tomllib.loads(first.read("job.toml").decode()) == tomllib.loads(second.read("job.toml").decode())


def test_a_job_is_kept_as_it_was_written(client, strict):
    """Oracle: the text itself."""
    request, name, wanted = strict
    assert client.post("/api/job/write", json=request).json() == {"toml": wanted, "errors": []}
    reported = client.get(f"/api/runs/{name}").json()
    assert reported["toml"] == wanted
    assert client.get(f"/api/runs/{name}/files/written").text == wanted
    plain = client.post("/api/runs", json={"data": request["data"], "kind": "run"}).json()["id"]
    assert client.get(f"/api/runs/{plain}").json()["toml"] == ""
    assert client.get(f"/api/runs/{plain}/files/written").status_code == 404
    client.post(f"/api/runs/{plain}/cancel")


def test_a_file_of_two_names_is_archived_by_both(client):
    """Oracle: the bytes that were brought."""
    first, second = (
        client.post("/api/files", params={"kind": "waviness", "name": name}, content=WAVY).json()["reference"]
        for name in ("edge.csv", "same.csv")
    )
    job = changed(("tool.waviness_file", first), ("actual.tool.waviness_file", second))
    packed = client.post("/api/job/bundle", json={"data": job})
    assert packed.status_code == 200, packed.text
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        reported = tomllib.loads(archive.read("job.toml").decode())
        assert reported["tool"]["waviness_file"] == "edge.csv"
        assert reported["actual"]["tool"]["waviness_file"] == "same.csv"
        assert [archive.read(name) for name in ("edge.csv", "same.csv")] == [WAVY, WAVY]


def test_a_job_without_files_comes_as_it_is(client, dish):
    packed = client.post("/api/job/bundle", json={"data": changed(*DISH)})
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        assert archive.namelist() == ["job.toml"]
        assert tomllib.loads(archive.read("job.toml").decode()) == changed(*DISH)
    assert client.get(f"/api/runs/{dish[0]}/files/bundle").status_code == 404
    wrong = client.post("/api/job/bundle", json={"data": changed(("tool.nose_radius", 3))})
    assert wrong.status_code == 422
    assert "nose_radius" in wrong.json()["detail"]


def test_a_file_is_thrown_away_when_no_run_names_it_for_long(tmp_path):
    names = [digit * 32 for digit in "abc"]
    create_app(tmp_path).state.workers.close()
    run = tmp_path / "runs" / ("0" * 16)
    run.mkdir()
    (run / "job.json").write_text(json.dumps({"file": f"files/{names[0]}/x.csv"}))
    for name in names:
        (tmp_path / "files" / f"{name}-heights.csv").write_text("1")
    for name in names[:2]:
        os.utime(tmp_path / "files" / f"{name}-heights.csv", (0, 0))
    (tmp_path / "files" / ".half.csv").write_text("1")
    create_app(tmp_path).state.workers.close()
    left = sorted(file.name[0] for file in (tmp_path / "files").iterdir())
    assert left == ["a", "c"]


def test_an_error_in_a_file_names_the_file(client):
    """A table that is none of this surface is met at the check, and called what its owner calls it."""
    reported = client.post("/api/files", params={"kind": "waviness", "name": "edge 3.csv"}, content=WAVY).json()
    job = changed(("tool.waviness_file", reported["reference"]), ("tool.waviness", ["1 um/rad"]))
    one = client.post("/api/job/check", json={"data": job}).json()["errors"]
    assert [error["field"] for error in one] == ["tool"]
    # A file is of the kind that it was brought as.
    job = changed(
        ("part.surface", {"family": "gridded", "file": reported["reference"], "units": "mm", "sag_units": "mm"})
    )
    assert [one["field"] for one in client.post("/api/job/check", json={"data": job}).json()["errors"]] == [
        "part.surface.file"
    ]
    small = client.post("/api/files", params={"kind": "heights", "name": "my sag.csv"}, content=table()).json()
    job = changed(
        ("part.surface", {"family": "gridded", "file": small["reference"], "units": "mm", "sag_units": "um"}),
        ("part.radius", "3 mm"),
    )
    (error,) = client.post("/api/job/check", json={"data": job}).json()["errors"]
    assert error["field"].startswith("part")
    assert small["reference"].split("/")[1] not in error["sentence"]


def test_references_lead_to_files_of_the_server_only(tmp_path):
    data = {"machine": {"file": "examples/machines/lathe_with_y.toml"}, "part": {"correction": None}}
    real, problems, _ = located(data, tmp_path)
    assert problems == []
    assert real["machine"]["file"].endswith("lathe_with_y.toml")
    kept = tmp_path / "runs" / "0123456789abcdef" / "correction"
    kept.mkdir(parents=True)
    (kept / "correction.npz").write_bytes(b"x")
    reference = "runs/0123456789abcdef/correction.npz"
    assert located({"part": {"correction": reference}}, tmp_path)[1] == []
    (kept / "link.npz").symlink_to("/etc/passwd")
    for bad in ("runs/0123456789abcdef/link.npz", "runs/0123456789abcdef/../job.toml", "/etc/passwd", ["a"], 3):
        assert located({"part": {"correction": bad}}, tmp_path)[1]


DELETED = ["", "job.json", "out"]


@pytest.fixture(scope="module")
def copies(folder, dish, tmp_path_factory):
    """A server that finds a run once for each of what is deleted of it, and their folders."""
    served = tmp_path_factory.mktemp("copies")
    places = {what: served / "runs" / f"{number:016x}" for number, what in enumerate(DELETED)}
    for place in places.values():
        shutil.copytree(folder / "runs" / dish[0], place)
        state = json.loads((place / "state.json").read_text())
        (place / "state.json").write_text(json.dumps({**state, "id": place.name}))
    with TestClient(create_app(served, nice=0), base_url=HERE) as client:
        yield client, places


@pytest.mark.parametrize("deleted", DELETED)
def test_a_run_deleted_outside_the_workbench_is_no_defect(copies, deleted):
    client, places = copies
    name = places[deleted].name
    assert client.get(f"/api/runs/{name}").json()["state"] == "done"
    place = places[deleted] / deleted
    shutil.rmtree(place) if place.is_dir() else place.unlink()
    schema = client.get("/api/openapi.json").json()["paths"]
    for path, verbs in schema.items():
        if "{id}" in path and "get" in verbs and path.startswith("/api/runs"):
            target = path.replace("{id}", name).replace("{name}", "program")
            status = client.get(target, params={"ends": "0,0,1,1", "letter": "Z", "near": "0,0"}).status_code
            assert status < 500, (path, status)
    assert client.get("/api/runs").status_code == 200
    assert client.delete(f"/api/runs/{name}").status_code == 204
