"""Hostile requests: each is refused in a sentence, the server lives on, and nothing is written outside its folder."""

import asyncio
import json
import os
import re
import socket
import threading
import time

import pytest
import uvicorn
from fastapi.testclient import TestClient
from job_files import changed

from turnwright.errors import InputError
from turnwright.web import create_app
from turnwright.web._guard import Guard

HERE = "http://127.0.0.1:8765"
RUN = "0123456789abcdef"
TOKEN = "correct-horse-battery"  # noqa: S105 - of a server that lives for a test


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("above") / "workbench"


@pytest.fixture(scope="module")
def client(folder):
    with TestClient(create_app(folder), base_url=HERE, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def cut(client, folder):
    """A run that is done, made by hand: what is sent for it is refused before anything is computed."""
    from turnwright.web._queue import Run

    runs = client.app.state.runs
    place = runs.place / RUN
    (place / "out").mkdir(parents=True)
    (place / "job.json").write_text(json.dumps(changed()))
    (place / "out" / "secret.txt").write_text("not for the web")
    runs._keep(Run(id=RUN, kind="run", name="made by hand", state="done", created="2026-01-01T00:00:00Z"))
    return RUN


def tree(folder):
    return sorted(str(path) for path in folder.parent.rglob("*"))


def job(*changes):
    return {"data": changed(*changes)}


def deep(levels):
    return '{"data":' + '{"a":' * levels + "1" + "}" * levels + "}"


# --- paths that lead elsewhere

PATHS = [
    "/../pyproject.toml",
    "/%2e%2e/%2e%2e/etc/passwd",
    "/..%2f..%2f..%2fetc%2fpasswd",
    "/..%5c..%5cwindows%5cwin.ini",
    "//etc/passwd",
    "/vendor/../../_app.py",
    "/%00index.html",
    "/api/examples/..%2f..%2fpyproject",
    "/api/examples/%2e%2e",
    "/api/runs/..%2f..%2fetc",
    "/api/runs/0123456789abcdeF",
    "/api/runs/0123456789abcdef0",
    f"/api/runs/{RUN}/files/secret.txt",
    f"/api/runs/{RUN}/files/..%2fjob.json",
    f"/api/runs/{RUN}/files/program?part=-1",
    f"/api/runs/{RUN}/program?near=nan,0",
    f"/api/runs/{RUN}/program?near=1;import os",
    f"/api/runs/{RUN}/program?first=-1",
    f"/api/runs/{RUN}/program?count=1000000000",
    f"/api/measurements/{RUN}/map?name=../../error",
    f"/api/measurements/{RUN}/map?nx=1000000&ny=1000000",
]


@pytest.mark.parametrize("path", PATHS)
def test_no_path_leads_out(client, cut, folder, path):
    before = tree(folder)
    answer = client.get(path)
    assert answer.status_code in (404, 409, 422), answer.text
    assert re.fullmatch(r"\S.*", answer.json()["detail"])
    assert "root:" not in answer.text
    assert tree(folder) == before


# --- jobs that name files, or hold what is none

FILES = {
    "a file of the system": job(("part.surface", {"family": "gridded", "file": "/etc/passwd", "units": "mm",
                                                  "sag_units": "mm"})),
    "a file above": job(("part.correction", "../../secret.npz")),
    "a file in a sum": job(("part.surface", {"family": "sum", "terms": [
        {"family": "gridded", "file": "/proc/self/environ", "units": "mm", "sag_units": "mm"}]})),
    "a waviness file": job(("tool.waviness_file", "/etc/hosts")),
    "a straightness file": job(("actual.machine", {"straightness_file": "/dev/zero"})),
    "a machine by its file": job(("machine", {"file": "/dev/stdin"})),
    "a machine by a path as name": job(("machine.name", "../machines/generic.toml")),
    "a material by its file": job(("part.material", "/etc/x.toml")),
    "a run that is not there": job(("part.correction", "runs/0123456789abcdee/correction.npz")),
    "a reference with a climb": job(("part.correction", f"runs/{RUN}/../../x.npz")),
    "a name of a file in the program": job(("program.name", "../../part")),
    "a name with a zero in it": job(("part.name", "a\0b")),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_no_job_names_a_file_of_the_server(client, folder, name):
    before = tree(folder)
    told = client.post("/api/job/check", json=FILES[name]).json()
    assert told["errors"], told
    assert not re.search("root:|localhost", json.dumps(told["errors"]))
    answer = client.post("/api/runs", json={**FILES[name], "kind": "run"})
    assert answer.status_code == 422
    assert answer.json()["detail"]
    assert tree(folder) == before


FORMULAS = [
    "__import__('os').system('touch OWNED')",
    "x.__class__.__mro__",
    "(lambda: 1)()",
    "open('/etc/passwd').read()",
    "9**9**9**9**9",
    "[x for x in (1,)]",
    "x if x else y",
    "sin" + "(" * 3000 + "x" + ")" * 3000,
]


@pytest.mark.parametrize("formula", FORMULAS, ids=range(len(FORMULAS)))
def test_formulas_are_never_carried_out_as_code(client, formula, tmp_path):
    owned = tmp_path / "owned"
    surface = {"family": "expression", "formula": formula.replace("OWNED", str(owned)), "units": "mm"}
    told = client.post("/api/job/check", json=job(("part.surface", surface))).json()
    assert told["errors"]
    assert not owned.exists()


# --- sizes

SIZES = {
    "points without end": job(("strategy.feed", "1 nm/rev"), ("strategy.points_per_rev", 100_000)),
    "a map without end": job(("simulation.whole_part", {"radii": 10**9, "angles": 10**9})),
    "lenses without end": job(("part.surface", {"family": "lens array", "layout": "square", "pitch": "1 um",
                                                "rows": 10**9, "columns": 10**9,
                                                "lenslet": {"family": "sphere", "radius": "1 mm"}})),
    "a number of endless digits": job(("tool.nose_radius", "1" * 5000 + " mm")),
}  # fmt: skip


@pytest.mark.parametrize("name", SIZES)
def test_absurd_sizes_are_refused_in_a_sentence(client, name):
    told = client.post("/api/job/check", json=SIZES[name])
    assert told.status_code in (200, 422), told.text
    assert told.json().get("errors") or told.json()["detail"]
    assert client.post("/api/runs", json={**SIZES[name], "kind": "run"}).status_code == 422


BODIES = {
    "nothing": b"",
    "broken JSON": b'{"data": {',
    "JSON within JSON": deep(100_000).encode(),
    "tables within tables": deep(60).encode(),
    "a list": b"[]",
    "not text": b"\xff\xfe\x00\x01",
    "more keys": b'{"data": {}, "kind": "run", "folder": "/etc"}',
    "another kind": b'{"data": {}, "kind": "shell"}',
    "an endless name": json.dumps({"data": {}, "kind": "run", "name": "n" * 10_000}).encode(),
    "a number too long": b'{"data": {"a": ' + b"1" * 10_000 + b'}, "kind": "run"}',
    "not a number": b'{"data": {"part": NaN}, "kind": "run"}',
}


@pytest.mark.parametrize("name", BODIES)
def test_bodies_that_are_none_are_refused(client, folder, name):
    before = tree(folder)
    answer = client.post("/api/runs", content=BODIES[name], headers={"content-type": "application/json"})
    assert answer.status_code in (400, 413, 422), answer.text
    assert isinstance(answer.json()["detail"], str)
    assert len(answer.text) < 3000
    assert tree(folder) == before


def test_toml_within_toml_is_refused(client):
    told = client.post("/api/job/parse", json={"toml": "a = " + "[" * 50_000}).json()
    assert told["errors"]


def test_a_large_body_is_refused_before_it_is_read(client):
    length = {"content-type": "application/json", "content-length": str(10 * 2**30)}
    answer = client.post("/api/job/check", content=b"{}", headers=length)
    assert answer.status_code == 413
    assert "8 MiB" in answer.json()["detail"]


# --- uploads

UPLOADS = {
    "10 GB by its own word": ({"name": "a.x3p"}, b"x", {"content-length": str(10 * 2**30)}, 413),
    "a length that is none": ({"name": "a.x3p"}, b"x", {"content-length": "-5"}, 413),
    "a program": ({"name": "a.exe"}, b"MZ", {}, 422),
    "a page": ({"name": "a.html"}, b"<script>", {}, 422),
    "no ending": ({"name": "../../.ssh/authorized_keys"}, b"ssh-rsa", {}, 422),
    "nothing": ({"name": "a.dat"}, b"", {}, 422),
    "no name": ({}, b"x", {}, 422),
    "a name without end": ({"name": "a" * 5000 + ".dat"}, b"x", {}, 422),
    "of no run": ({"name": "a.dat", "run": "0" * 16}, b"x", {}, 404),
    "of a path": ({"name": "a.dat", "run": "../../../etc/pas"}, b"x", {}, 422),
}


@pytest.mark.parametrize("name", UPLOADS)
def test_uploads_are_limited_in_kind_and_size(client, cut, folder, name):
    query, content, headers, status = UPLOADS[name]
    before = tree(folder)
    answer = client.post("/api/measurements", params={"run": RUN, **query}, content=content, headers=headers)
    assert answer.status_code == status, answer.text
    assert answer.json()["detail"]
    assert tree(folder) == before


def test_an_upload_in_chunks_is_counted(client, cut, folder, monkeypatch):
    """A request in chunks says no length, so what arrives is counted; the limit is lowered, 2 GiB take their time."""
    from turnwright.web import _guard

    monkeypatch.setattr(_guard, "UPLOAD_BYTES", 2**20)
    before = tree(folder)
    answer = client.post(
        "/api/measurements", params={"run": RUN, "name": "a.dat"}, content=(b"x" * 2**16 for _ in range(64))
    )
    assert answer.status_code == 413
    assert tree(folder) == before


# --- who asks from where

FOREIGN = [
    {"host": "evil.example"},
    {"host": "127.0.0.1.evil.example"},
    {"host": "evil.example:8765"},
    {"host": "localhost@evil.example"},
    {"host": ""},
    {"origin": "http://evil.example"},
    {"origin": "null"},
    {"origin": "http://127.0.0.1:9999"},
    {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"},
]


@pytest.mark.parametrize("headers", FOREIGN, ids=str)
def test_foreign_pages_and_names_are_refused(client, folder, headers):
    before = tree(folder)
    answer = client.post("/api/runs", json={**job(), "kind": "run"}, headers=headers)
    assert answer.status_code in (403, 421), answer.text
    assert answer.json()["detail"]
    assert tree(folder) == before


def test_the_page_of_the_server_is_not_refused(client):
    mine = {"origin": HERE, "sec-fetch-site": "same-origin"}
    assert client.post("/api/job/write", json=job(), headers=mine).status_code == 200
    assert client.get("/api/about", headers={"host": "localhost:8765"}).status_code == 200


def test_a_token_is_asked_for_everything(tmp_path):
    with TestClient(create_app(tmp_path, token=TOKEN), base_url=HERE, follow_redirects=False) as client:
        for given in ({}, {"authorization": "Bearer wrong"}, {"cookie": "turnwright=wrong"}, {"cookie": "%%;=;"}):
            assert client.get("/", headers=given).status_code == 401
            assert client.get("/api/about", headers=given).status_code == 401
        assert client.get("/?token=" + TOKEN[:-1]).status_code == 401
        assert client.get("/api/about", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
        # A proxy or a name of the workshop's net needs the token, a foreign name is refused with it too.
        assert client.get("/", headers={"host": "evil.example", "authorization": f"Bearer {TOKEN}"}).status_code == 421
        answer = client.get(f"{HERE}//evil.example/?token={TOKEN}")
        assert answer.headers["location"] == "/evil.example/"
        login = client.get(f"/?token={TOKEN}")
        assert login.status_code == 303
        assert login.headers["location"] == "/"
        assert re.search("(?i)httponly.*samesite=strict", login.headers["set-cookie"])
        assert client.get("/api/about").status_code == 200  # the cookie is enough from here on


@pytest.mark.parametrize("token", ["short", "with spaces in between", "x" * 300, "ä" * 20])
def test_a_token_that_is_guessed_is_refused(tmp_path, token):
    with pytest.raises(InputError, match="16 to 200"):
        Guard(None, token=token)


# --- bytes that no client library sends, to a real server


@pytest.fixture(scope="module")
def port(tmp_path_factory):
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        app = create_app(tmp_path_factory.mktemp("raw"))
        server = uvicorn.Server(uvicorn.Config(app, log_level="critical", lifespan="on", ws="none"))
        thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[door])))
        thread.start()
        while not server.started:
            time.sleep(0.01)
        yield door.getsockname()[1]
        server.should_exit = True
        thread.join()


RAW = {
    "rubbish": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + os.urandom(200) + b"\r\n\r\n",
    "an endless header": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 200_000 + b"\r\n\r\n",
    "two hosts": b"GET /api/about HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n",
    "no host": b"GET /api/about HTTP/1.1\r\n\r\n",
    "another server as target": b"GET http://evil.example/api/about HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    "two lengths": b"POST /api/job/parse HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 2\r\nContent-Length: 9\r\n\r\n",
    "a climb in the target": b"GET /../../../etc/passwd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
}


@pytest.mark.parametrize("name", RAW)
def test_requests_that_no_library_sends(port, name):
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line:
        line.sendall(RAW[name])
        answer = line.recv(65536)
    assert answer == b"" or re.match(rb"HTTP/1\.1 4\d\d", answer), answer[:100]
    assert _alive(port)


def test_a_client_that_hangs_up_leaves_nothing(port):
    for head in (b"Content-Length: 1000000", b"Transfer-Encoding: chunked"):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as line:
            line.sendall(b"POST /api/job/check HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n")
            line.sendall(head + b"\r\n\r\n" + b"5\r\n{")
    assert _alive(port)


def test_a_body_in_chunks_is_counted(port):
    """Ten megabytes that do not say so."""
    with socket.create_connection(("127.0.0.1", port), timeout=20) as line:
        line.sendall(
            b"POST /api/job/check HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
            b"Transfer-Encoding: chunked\r\n\r\n"
        )
        chunk = b"10000\r\n" + b" " * 0x10000 + b"\r\n"
        try:
            for _ in range(160):
                line.sendall(chunk)
            line.sendall(b"0\r\n\r\n")
        except OSError:
            pass  # it hung up, which is as good
        line.settimeout(10)
        try:
            answer = line.recv(65536)
        except OSError:
            answer = b""
    assert answer == b"" or answer.startswith(b"HTTP/1.1 413")
    assert _alive(port)


def _alive(port):
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line:
        line.sendall(b"GET /api/about HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
        return line.recv(64).startswith(b"HTTP/1.1 200")
