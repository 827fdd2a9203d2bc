"""Hostile requests: each is refused in a sentence, the server lives on, and nothing is written outside its folder."""

import asyncio
import contextlib
import io
import json
import os
import re
import socket
import sys
import threading
import time
import tomllib
import zipfile
from functools import partial
from importlib import resources
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
import uvicorn
from fastapi.testclient import TestClient

import turnwright as tw
from job_files import changed
from patience import PATIENCE_S
from turnwright.errors import InputError
from turnwright.web import bundles as _bundles, create_app, queue as _queue, server as _server
from turnwright.web.guard import Guard
from turnwright.web.limits import FILE_BYTES, MIN_FREE_BYTES
from turnwright.web.workers import TooLong

HERE = "http://127.0.0.1:8765"
RUN = "0123456789abcdef"
TOKEN = "correct-horse-battery"  # noqa: S105 - of a server that lives for a test


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("above") / "workbench"


CHANGES = {"os.mkdir", "os.rename", "os.link", "os.symlink", "os.remove", "os.rmdir", "os.truncate", "shutil.rmtree"}
"""What Python tells of that changes a file system."""


@pytest.fixture(scope="module")
def client(folder, tmp_path_factory):
    """A server of which every file that it opens for writing, makes, moves or removes is watched, by Python itself."""
    touched, watching = [], [True]

    def hear(event, arguments):
        # The tests of this process write where they like; the server answers in threads of its own.
        if not watching[0] or threading.current_thread() is threading.main_thread():
            return
        if event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            touched.append(arguments[0])
        elif event in CHANGES and not (event in ("os.remove", "os.rmdir") and arguments[1] != -1):  # below an rmtree
            touched.extend(one for one in arguments if isinstance(one, str | os.PathLike))

    sys.addaudithook(hear)
    with TestClient(create_app(folder, nice=0), base_url=HERE, raise_server_exceptions=False) as client:
        yield client
        assert client.get("/api/about").status_code == 200  # it is still there
        # What it writes when all is well is seen: these tests alone may have made it write nothing.
        assert client.post("/api/files", params={"kind": "heights", "name": "a.csv"}, content=TABLE).status_code < 300
    watching[0] = False
    places = {Path(os.fsdecode(one)).resolve() for one in touched if not isinstance(one, int)} - {Path(os.devnull)}
    base = tmp_path_factory.getbasetemp().resolve()  # where other servers of these tests have their own folders
    mine = {one for one in places if one.is_relative_to(folder.parent.resolve()) or not one.is_relative_to(base)}
    assert mine
    assert [one for one in mine if not one.is_relative_to(folder.resolve())] == []


@pytest.fixture(scope="module")
def cut(client, folder):
    """A run that is done, made by hand: what is sent for it is refused before anything is computed."""
    return made_by_hand(client)


def made_by_hand(client):
    from turnwright.web.queue import Run

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

DIALECT = resources.files("turnwright") / "dialects" / "generic.toml"
"""A file that could be read: it is the path that is refused."""

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
    "a dialect by its file": job(("machine.dialect", str(DIALECT))),
    "a material by its file": job(("part.material", "/etc/x.toml")),
    "a run that is not there": job(("part.correction", "runs/0123456789abcdee/correction.npz")),
    "a reference with a climb": job(("part.correction", f"runs/{RUN}/../../x.npz")),
    "a name of a file in the program": job(("program.name", "../../part")),
    "a name with a zero in it": job(("part.name", "a\0b")),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_no_job_names_a_file_of_the_server(client, folder, name):
    before = tree(folder)
    response = client.post("/api/job/check", json=FILES[name]).json()
    assert response["errors"], response
    assert not re.search("root:|localhost", json.dumps(response["errors"]))
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
    response = client.post("/api/job/check", json=job(("part.surface", surface))).json()
    assert response["errors"]
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
    response = client.post("/api/job/check", json=SIZES[name])
    assert response.status_code in (200, 422), response.text
    assert response.json().get("errors") or response.json()["detail"]
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
    # A key of many words is read however many they are.
    for toml in ("a = " + "[" * 50_000, "a = " + "[" * 50 + "]" * 50, "a." * 900 + "a = 1"):
        answer = client.post("/api/job/parse", json={"toml": toml})
        assert answer.status_code == 200, answer.text
        assert answer.json()["errors"]


def test_a_large_body_is_refused_before_it_is_read(client):
    length = {"content-type": "application/json", "content-length": str(10 * 2**30)}
    answer = client.post("/api/job/check", content=b"{}", headers=length)
    assert answer.status_code == 413
    assert "8 MiB" in answer.json()["detail"]


def test_a_long_job_comes_with_its_text_and_both_are_taken(client):
    """Each alone is within the limit."""
    long = changed(("part.name", "x" * 5 * 2**20))
    answer = client.post("/api/job/write", json={"data": long, "toml": tomli_w.dumps(long)})
    assert answer.status_code == 200, answer.text
    assert tomllib.loads(answer.json()["toml"]) == long
    assert client.post("/api/job/check", json={"data": long, "client": "x" * 5 * 2**20}).status_code == 413


def test_a_run_too_many_is_refused_and_leaves_nothing(client, folder, monkeypatch):
    monkeypatch.setattr(_queue, "MAX_QUEUED", 0)
    before = tree(folder)
    answer = client.post("/api/runs", json={"data": changed(), "kind": "run"})
    assert answer.status_code == 422
    assert "cancel some" in answer.json()["detail"]
    assert tree(folder) == before


# --- the processes that compute


def test_an_answer_that_takes_too_long_ends_its_process_only(client):
    ask = client.app.state.workers.ask
    with pytest.raises(TooLong, match=r"more than 0\.2 s"):
        client.portal.call(partial(ask, time.sleep, 60, limit_s=0.2))
    assert client.post("/api/job/check", json=job()).json()["errors"] == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="no other system limits memory so")
def test_an_answer_that_takes_too_much_memory_is_refused(client):
    with pytest.raises(TooLong, match="memory"):
        client.portal.call(partial(client.app.state.workers.ask, bytearray, 8 * 2**30))
    assert client.post("/api/job/check", json=job()).json()["errors"] == []


# --- files that a job is to name

TABLE = b",0,1,2,3,4,5\n" + b"".join(b"%d,0,0,0,0,0,0\n" % row for row in range(6))
BAD_FILES = {
    "a table cut short": ("heights", "a.csv", TABLE[:-4], 422),
    "a head alone": ("heights", "a.csv", TABLE[:13], 422),
    "not numbers": ("heights", "a.csv", TABLE.replace(b"0", b"=HYPERLINK(1)"), 422),
    "a column nowhere": ("heights", "a.csv", TABLE.replace(b",0,1,2", b",0,nan,2"), 422),
    "not text": ("heights", "a.csv", b"\xff\xfe\x00\x01" * 50, 422),
    "a certificate cut short": ("waviness", "a.csv", b"sweep [deg],deviation [nm]\n-30,1\n0,2\n30,", 422),
    "a certificate without units": ("waviness", "a.csv", b"sweep,deviation\n-30,1\n0,2\n", 422),
    "a certificate of nothing": ("straightness", "a.csv", b"x [mm],error [nm]\n", 422),
    "a machine that is cut short": ("machine", "a.toml", b'base = "generic"\n[axes.X', 422),
    "a machine upon a file": ("machine", "a.toml", b'base = "/etc/passwd"', 422),
    "a machine upon a file above": ("machine", "a.toml", b'base = "../../machines/generic.toml"', 422),
    "a machine upon itself": ("machine", "a.toml", b"base = 'a.toml'", 422),
    "a machine with a file": (
        "machine",
        "a.toml",
        b'base="generic"\n[axes.X]\nresponse = { file = "/etc/passwd" }',
        422,
    ),
    "a machine with a dialect file": ("machine", "a.toml", b'base="generic"\ndialect="/etc/x.toml"', 422),
    "a machine with a dialect file for cubics": (
        "machine",
        "a.toml",
        b'base="generic"\n[controller]\nother_interpolations = { hermite = "/etc/x.toml" }',
        422,
    ),
    "a dialect that is cut short": ("dialect", "a.toml", b'name = "mine"', 422),
    "a machine of lists within lists": ("machine", "a.toml", b"a = " + b"[" * 50_000, 422),
    "a material of endless digits": ("material", "a.toml", b"name = " + b"1" * 50_000, 422),
    "a correction that is cut short": ("correction", "a.npz", b"PK\x03\x04", 422),
    "a correction of objects": ("correction", "a.npz", None, 422),
    "a correction without end": ("correction", "a.npz", None, 422),
    "heights of objects": ("heights", "a.npz", None, 422),
    "heights without end": ("heights", "a.npz", None, 422),
    "another kind of file": ("machine", "a.csv", TABLE, 422),
    "no kind": ("shell", "a.csv", TABLE, 422),
    "no ending": ("heights", "../../.ssh/authorized_keys", b"ssh-rsa", 422),
    "a zero in the name": ("heights", "a.csv\0.exe", TABLE, 422),
    "no bytes": ("heights", "a.csv", b"", 422),
    "an endless name": ("heights", "a" * 5000 + ".csv", TABLE, 422),
}


class Touch:
    """What unpickling would carry out."""

    def __init__(self, place):
        self.place = place

    def __reduce__(self):
        return os.mkdir, (str(self.place),)


@pytest.mark.parametrize("name", BAD_FILES)
def test_file_of_another_kind_is_refused_and_deleted(client, folder, tmp_path, name):
    kind, called, content, status = BAD_FILES[name]
    if content is None:
        sink, trap = io.BytesIO(), Touch(tmp_path / "owned")
        what = np.array([trap], dtype=object) if "objects" in name else np.broadcast_to(0.0, (30_000, 30_000))
        if "objects" in name:
            np.savez(sink, z=what, x=what, y=what, allow_pickle=True)
        else:
            with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("z.npy", "w") as file:
                np.lib.format.write_array_header_2_0(
                    file, {"descr": "<f8", "fortran_order": False, "shape": what.shape}
                )
                file.write(bytes(2**22))
        content = sink.getvalue()
    before = tree(folder)
    answer = client.post("/api/files", params={"kind": kind, "name": called}, content=content)
    assert answer.status_code == status, answer.text
    assert re.fullmatch(r"\S[^\n]*", answer.json()["detail"])
    assert str(folder) not in answer.text
    assert len(answer.text) < 3000
    assert tree(folder) == before
    assert not (tmp_path / "owned").exists()


NAMES = ["../../x.csv", "C:\\Windows\\x.csv", "CON.csv", "..csv", " .csv", "a\u202egnp.csv", "\u002e\u2024/x.csv",
         "%2e%2e%2fx.csv", "$(id).csv", "<b>.csv", "a\nb.csv", "x.csv."[:-1], "ｘ" * 150 + ".csv"]  # fmt: skip


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_a_file_has_the_name_that_the_server_gives_it(client, folder, name):
    before = {one for one in tree(folder) if f"{os.sep}files{os.sep}" not in one}
    answer = client.post("/api/files", params={"kind": "heights", "name": name}, content=TABLE)
    assert answer.status_code == 201, answer.text
    assert re.fullmatch(r"files/[0-9a-f]{32}/(?!(?i:con|nul)\.)[A-Za-z0-9_-]+\.csv", answer.json()["reference"])
    assert {one for one in tree(folder) if f"{os.sep}files{os.sep}" not in one} == before
    assert len(list((folder / "files").glob("*-heights.csv"))) == 1
    assert len(list((folder / "files").glob("*-*"))) == len(list((folder / "files").iterdir()))


@pytest.mark.parametrize(
    "reference",
    ["files/../../x/a.csv", "files/" + "0" * 32 + "/a.csv", "files/" + "0" * 32 + "/../a.csv", "files//a.csv",
     "files/" + "0" * 31 + "g/a.csv", "FILES/" + "0" * 32 + "/a.csv", "files/" + "０" * 32 + "/a.csv", "", 7, ["a"],
     "examples/../pyproject.toml", "file:///etc/passwd", "\\\\host\\share\\a.csv"],
    ids=str,
)  # fmt: skip
def test_a_reference_leads_nowhere_else(client, reference):
    surface = {"family": "gridded", "file": reference, "units": "mm", "sag_units": "um"}
    response = client.post("/api/job/check", json=job(("part.surface", surface))).json()
    assert response["errors"][0]["field"].startswith("part.surface.file")


def test_reading_a_file_ends_at_its_limit(client, folder, monkeypatch):
    from turnwright.web import files as _files

    monkeypatch.setattr(_files, "MAX_FILE_READ_S", 0.0)
    before = tree(folder)
    answer = client.post("/api/files", params={"kind": "heights", "name": "a.csv"}, content=TABLE + b"\n")
    assert answer.status_code == 422
    assert "within the limits" in answer.json()["detail"]
    assert tree(folder) == before
    assert client.post("/api/job/check", json=job()).json()["errors"] == []


def test_a_file_in_chunks_is_counted(client, folder, monkeypatch):
    from turnwright.web import guard as _guard

    monkeypatch.setattr(_guard, "FILE_BYTES", 2**20)
    before = tree(folder)
    answer = client.post(
        "/api/files", params={"kind": "heights", "name": "a.csv"}, content=(b"0," * 2**15 for _ in range(64))
    )
    assert answer.status_code == 413
    assert tree(folder) == before


# --- archives of a job and its files


def packed(entries, kind=zipfile.ZIP_DEFLATED):
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", kind) as archive:
        for name, content in entries:
            archive.writestr(name, content)
    return sink.getvalue()


def naming(name, *more):
    surface = {"family": "gridded", "units": "mm", "sag_units": "mm", "file": name}
    return "job.toml", tomli_w.dumps(changed(("part.surface", surface), *more))


def sealed():
    """An archive that asks for a password: a flag in both of its records."""
    found = bytearray(packed([naming("a.csv"), ("a.csv", TABLE)]))
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        found[found.index(mark) + at] |= 1
    return bytes(found)


def lying():
    """An archive that says of a large file that it is small."""
    found = bytearray(packed([naming("a.csv"), ("a.csv", bytes(FILE_BYTES + 1))]))
    size = (FILE_BYTES + 1).to_bytes(4, "little")
    return bytes(found).replace(size, (100).to_bytes(4, "little"))


def misplaced():
    """An archive whose list says that it begins later than it does, so its files would begin before it."""
    found = bytearray(packed([naming("a.csv"), ("a.csv", TABLE)]))
    at = found.index(b"PK\x05\x06") + 16
    found[at : at + 4] = (int.from_bytes(found[at : at + 4], "little") + 5).to_bytes(4, "little")
    return bytes(found)


ARCHIVES = {
    "no archive": (lambda: b"not a zip", "cannot be read"),
    "one that breaks off": (lambda: packed([naming("a.csv"), ("a.csv", TABLE)])[:-40], "cannot be read"),
    "one without a job": (lambda: packed([("a.csv", TABLE)]), "must contain job.toml"),
    "a job that is no text": (lambda: packed([("job.toml", b"\xff\xfe")]), "not UTF-8"),
    "a job that is none": (lambda: packed([("job.toml", "[part")]), "not TOML"),
    "a job too long": (lambda: packed([("job.toml", b" " * (8 * 2**20 + 1))]), "at most 8 MiB"),
    "a job of tables in tables": (lambda: packed([("job.toml", "a." * 900 + "a = 1")]), "nesting depth"),
    "a way up": (lambda: packed([naming("../a.csv"), ("../a.csv", TABLE)]), "relative paths"),
    "a way up under Windows": (lambda: packed([naming("a.csv"), ("x\\..\\..\\a.csv", TABLE)]), "relative paths"),
    "a place on the disk": (lambda: packed([naming("/etc/passwd"), ("/etc/passwd", TABLE)]), "relative paths"),
    "a place on a drive": (lambda: packed([naming("C:/a.csv"), ("C:/a.csv", TABLE)]), "relative paths"),
    "a file that is none of its kind": (lambda: packed([naming("a.csv"), ("a.csv", b"<html>")]), "a.csv: "),
    "a file of another ending": (lambda: packed([naming("a.exe"), ("a.exe", TABLE)]), "must end in .csv"),
    "a bomb": (lambda: packed([naming("a.csv"), ("a.csv", bytes(FILE_BYTES + 1))]), "at most 64 MiB"),
    "a bomb that lies": (lying, "cannot be read"),
    "files before its beginning": (misplaced, "cannot be read"),
    "a password": (sealed, "cannot be read"),
    "another packing": (lambda: packed([naming("a.csv")], zipfile.ZIP_LZMA), "must be stored or deflated"),
    "a crowd": (lambda: packed([naming("a.csv"), *((f"{n}.csv", "") for n in range(300))]), "at most 200"),
}  # fmt: skip


@pytest.mark.parametrize("name", ARCHIVES)
def test_an_archive_that_is_none_is_refused_and_leaves_nothing(client, folder, name):
    content, message = ARCHIVES[name]
    before = tree(folder)
    answer = client.post("/api/files/archive", content=content())
    assert answer.status_code == 422, answer.text
    assert message in answer.json()["detail"]
    assert "root:" not in answer.text
    assert tree(folder) == before


def test_what_an_archive_does_not_hold_is_not_looked_for(client, folder):
    """Neither on this disk nor among what was brought: the field says that it must be brought."""
    for name in ("/etc/hosts", "../../secret.csv", "other.csv"):
        before = tree(folder)
        response = client.post("/api/files/archive", content=packed([naming(name), ("__MACOSX/._job.toml", "x")]))
        assert response.status_code == 201, response.text
        (error,) = response.json()["errors"]
        assert error["field"] == "part.surface.file"
        assert "must be an uploaded file" in error["sentence"]
        assert tree(folder) == before


def test_an_archive_leaves_room_on_the_disk(tmp_path, monkeypatch):
    (tmp_path / "files").mkdir()
    file = tmp_path / "files" / ".new.zip"
    file.write_bytes(packed([naming("a.csv"), ("a.csv", TABLE)]))
    monkeypatch.setattr(_bundles.shutil, "disk_usage", lambda _folder: SimpleNamespace(free=MIN_FREE_BYTES))
    before = tree(tmp_path)
    with pytest.raises(InputError, match="GB free"):
        _bundles.unpack_job(str(file), str(tmp_path))
    assert tree(tmp_path) == before


def test_an_archive_beyond_the_limits_of_the_upload_is_not_read(client, folder):
    before = tree(folder)
    answer = client.post("/api/files/archive", content=(bytes(2**20) for _ in range(FILE_BYTES // 2**20 + 1)))
    assert answer.status_code == 413
    assert tree(folder) == before


def test_an_archive_has_its_time(client, folder, monkeypatch):
    from turnwright.web import files as _files

    monkeypatch.setattr(_files, "MAX_FILE_READ_S", 0.0)
    before = tree(folder)
    answer = client.post("/api/files/archive", content=packed([naming("a.csv"), ("a.csv", TABLE)]))
    assert answer.status_code == 422
    assert "the archive cannot be read within the limits" in answer.json()["detail"]
    assert tree(folder) == before


# --- measured files beyond the limits of time and memory


def zeros():
    """A map of 80 MB in some 80 kB."""
    sink = io.BytesIO()
    np.savez_compressed(sink, x=np.arange(3200.0), y=np.arange(3200.0), z=np.zeros((3200, 3200)))
    return sink.getvalue()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="no other system limits memory so")
@pytest.mark.parametrize(
    ("limits", "sentence"),
    [({"parse_s": 0.0}, "more than 0 s, the limit"), ({"parse_bytes": 2**25}, "Unable to allocate")],
    ids=["time", "memory"],
)
def test_reading_a_measured_file_ends_at_its_limit(tmp_path, limits, sentence):
    folder = tmp_path / "workbench"
    with TestClient(create_app(folder, nice=0, **limits), base_url=HERE) as client:
        made_by_hand(client)
        sent = client.post("/api/measurements", params={"run": RUN, "name": "a.npz"}, content=zeros()).json()["id"]
        before = tree(folder)
        with client.stream("GET", f"/api/runs/{sent}/events") as stream:
            assert "failed" in "".join(stream.iter_text())
        response = client.get(f"/api/measurements/{sent}").json()
        assert sentence in response["sentence"]
        assert "defect" not in response["sentence"]
        left = set(tree(folder)) - set(before)
        assert {Path(one).name for one in left} <= {"log.txt", "state.json"}
        assert client.delete(f"/api/runs/{sent}").status_code == 204
        assert client.post("/api/job/check", json=job()).json()["errors"] == []


# --- uploads

CUT_SHORT = ("x3p", "npz", "dat", "grd")


@pytest.mark.parametrize("ending", CUT_SHORT)
def test_a_measured_file_that_is_cut_short_is_refused(client, cut, tmp_path, ending):
    """Read by what a process that was started for it calls; here in one that is there already, which takes less."""
    file = tmp_path / f"a.{ending}"
    x = np.linspace(-1, 1, 41)
    tw.write_map(tw.HeightMap(x=x, y=x, z=np.outer(x, x) * 1e-3), file, format="zygo" if ending == "dat" else None)
    whole = file.read_bytes()
    for share in (0.02, 0.5, 0.98):
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"^[^\n]+$"):
            client.portal.call(partial(client.app.state.workers.ask, tw.read_map, str(file)))


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
    from turnwright.web import guard as _guard

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


def test_a_token_is_required_for_everything(tmp_path):
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


@contextlib.contextmanager
def served(app):
    """Run the server in a thread; yield its port."""
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        config = uvicorn.Config(app, http=_server.TimedProtocol, log_level="critical", lifespan="on", ws="none")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[door])))
        thread.start()
        while not server.started:
            time.sleep(0.01)
        yield door.getsockname()[1]
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="module")
def port(tmp_path_factory):
    with served(create_app(tmp_path_factory.mktemp("raw"))) as found:
        yield found


def head(target, *more, method="GET", host="127.0.0.1"):
    """The head of a request."""
    return "\r\n".join([f"{method} {target} HTTP/1.1", f"Host: {host}", *more, "", ""]).encode("latin-1")


RAW = {
    "rubbish": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + os.urandom(200) + b"\r\n\r\n",
    "an endless header": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 200_000 + b"\r\n\r\n",
    "two hosts": b"GET /api/about HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n",
    "no host": b"GET /api/about HTTP/1.1\r\n\r\n",
    "another server as target": b"GET http://evil.example/api/about HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    "two lengths": b"POST /api/job/parse HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 2\r\nContent-Length: 9\r\n\r\n",
    "a climb in the target": b"GET /../../../etc/passwd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    "a climb in overlong letters": head("/%c0%ae%c0%ae/%c0%ae%c0%ae/etc/passwd"),
    "an id in full-width digits": head("/api/runs/" + "%EF%BC%90" * 16),
    "a socket of the web": head("/api/runs", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
                                "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Origin: http://evil.example"),
    "a method that is none": head("/api/runs", method="EVIL"),
    "a tunnel": head("evil.example:80", method="CONNECT"),
    "an echo": head("/api/about", "X: secret", method="TRACE"),
    "another method": head("/api/about", "Content-Length: 0", method="DELETE"),
    "a method in a header": head(f"/api/runs/{RUN}", "X-HTTP-Method-Override: DELETE", method="POST"),
    "a put of a file": head("/app.js", "Content-Length: 1", method="PUT") + b"x",
    "a host of a proxy": head("/api/about", "X-Forwarded-Host: 127.0.0.1", host="evil.example"),
    "a host with a line in it": head("/api/about", host="127.0.0.1\rX: y"),
    "a host with a user": head("/api/about", host="127.0.0.1@evil.example"),
    "two kinds of length": head("/api/job/parse", "Content-Length: 5", "Transfer-Encoding: chunked", method="POST")
    + b"0\r\n\r\nGET /api/runs HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    "an unknown coding": head("/api/job/parse", "Transfer-Encoding: gzip, evil", method="POST") + b"x",
    "a folded header": head("/api/about", "X: a", " b: c", "Host: evil.example"),
    "a space before the colon": head("/api/about", "Content-Length : 5"),
    "a line in the query": head("/api/runs/0%0d%0aSet-Cookie:%20a=b"),
    "a plain form": head("/api/runs", "Content-Type: text/plain", "Content-Length: 26", method="POST")
    + b'{"data": {}, "kind":"run"}',
    "JSON in another alphabet": head("/api/runs", "Content-Type: application/json; charset=utf-7", "Content-Length: 6",
                                     method="POST") + b"+AHs-x",
    "half a letter": head("/api/job/parse", "Content-Type: application/json", "Content-Length: 18", method="POST")
    + b'{"toml": "\\ud8"}  ',
    "a file of 10 GB by its own word": head("/api/files?kind=heights&name=a.csv", "Content-Length: 10737418240",
                                            method="POST"),
    "an old version": b"GET /api/about HTTP/0.9\r\n\r\n",
    "a later version": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
}  # fmt: skip


@pytest.mark.parametrize("name", RAW)
def test_requests_that_no_library_sends(port, name):
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line:
        line.sendall(RAW[name])
        answer = line.recv(65536)
    assert answer == b"" or re.match(rb"HTTP/1\.1 4\d\d", answer), answer[:100]
    assert _alive(port)


def test_ten_gigabytes_in_chunks_end_at_the_limit(port):
    """A client that never stops: the server hangs up when the limit is passed, and nothing of it stays."""
    chunk = b"100000\r\n" + b"0," * 2**19 + b"\r\n"
    sent = 0
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line:
        target = "/api/files?kind=heights&name=a.csv"
        line.sendall(head(target, "Transfer-Encoding: chunked", method="POST"))
        with contextlib.suppress(OSError):
            while sent < 10 * 2**30:
                line.sendall(chunk)
                sent += len(chunk)
    assert sent < 2 * FILE_BYTES
    assert _alive(port)


def test_unfinished_requests_keep_no_one_waiting(port):
    with contextlib.ExitStack() as stack:
        for number in range(200):
            line = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S))
            half = head("/api/job/parse", "Content-Length: 1000", method="POST")
            line.sendall(half[:-2] if number % 2 else half + b"{")
        assert _alive(port)


@pytest.mark.parametrize(
    "sent", [b"", b"GET /api/about HTTP/1.1\r\nHost:", head("/api/job/parse", "Content-Length: 9", method="POST")]
)
def test_a_request_that_does_not_arrive_is_closed(tmp_path, monkeypatch, sent):
    monkeypatch.setattr(_server, "HEAD_S", 0.3)
    monkeypatch.setattr(_server, "BODY_S", 0.3)
    with (
        served(create_app(tmp_path)) as port,
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line,
    ):
        line.sendall(sent)
        with contextlib.suppress(ConnectionResetError):  # aborted: the peer owes nothing more
            assert line.recv(100) == b""
        assert _alive(port)


def test_a_request_that_dribbles_is_closed(tmp_path, monkeypatch):
    monkeypatch.setattr(_server, "HEAD_S", 0.5)
    with (
        served(create_app(tmp_path)) as port,
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line,
    ):
        letters = iter(range(50 * PATIENCE_S))
        with contextlib.suppress(OSError):  # which one depends on the system
            for _ in letters:  # a letter every 20 ms
                line.sendall(b"G")
                time.sleep(0.02)
        assert next(letters, None) is not None


def test_what_is_too_large_is_answered_before_the_line_is_closed(tmp_path):
    body = b"x" * (3 * 8 * 2**20)
    with (
        served(create_app(tmp_path)) as port,
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line,
    ):
        line.sendall(
            head("/api/job/check", f"Content-Length: {len(body)}", "Content-Type: application/json", method="POST")
        )
        line.sendall(body)  # as a browser does, which reads the answer afterwards
        assert line.recv(100).startswith(b"HTTP/1.1 413")


def test_a_client_that_hangs_up_leaves_nothing(port):
    for head in (b"Content-Length: 1000000", b"Transfer-Encoding: chunked"):
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line:
            line.sendall(b"POST /api/job/check HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n")
            line.sendall(head + b"\r\n\r\n" + b"5\r\n{")
    assert _alive(port)


def test_a_body_in_chunks_is_counted(port):
    """Ten megabytes that do not say so."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line:
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
        line.settimeout(PATIENCE_S)
        try:
            answer = line.recv(65536)
        except OSError:
            answer = b""
    assert answer == b"" or answer.startswith(b"HTTP/1.1 413")
    assert _alive(port)


def _alive(port):
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line:
        line.sendall(b"GET /api/about HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
        return line.recv(64).startswith(b"HTTP/1.1 200")
