"""`turnwright serve` as a process. Oracles: the processes and sockets of the operating system."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from urllib.request import Request, urlopen

import pytest

from job_files import changed
from patience import PATIENCE_S
from turnwright.cli import main
from turnwright.web import address as _address

LONG = changed(("strategy.feed", "1 um/rev"), ("strategy.points_per_rev", 3600), ("simulation.patches", []))


@contextlib.contextmanager
def serving(folder, *more):
    command = [sys.executable, "-m", "turnwright", "serve", "--port", "0", "--no-open", "--folder", str(folder), *more]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            message = process.stdout.readline()
            yield process, message.split()[-1] if message else ""
        finally:
            process.kill()


def ask(address, data=None):
    body = None if data is None else json.dumps(data).encode()
    with urlopen(Request(address, body, {"Content-Type": "application/json"}), timeout=PATIENCE_S) as answer:  # noqa: S310
        return answer.read()


@pytest.mark.usefixtures("signals_heard")
def test_a_server_answers_and_ends_at_an_interrupt(tmp_path):
    with serving(tmp_path) as (process, address):
        assert address.startswith("http://127.0.0.1:")
        assert b"<html" in ask(address)
        with serving(tmp_path) as (second, _):
            assert second.wait(PATIENCE_S) == 2
            assert "another server uses" in second.stderr.read()
        # Neither kernels nor pictures belong into the process that answers.
        loaded = (f"/proc/{process.pid}/maps").replace("//", "/")
        if os.path.exists(loaded):  # noqa: PTH110
            with open(loaded) as maps:  # noqa: PTH123
                assert "llvmlite" not in maps.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
        assert process.stderr.read() == ""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no system of this kind kills so")
def test_nothing_outlives_a_server_that_is_killed(tmp_path):
    with serving(tmp_path) as (process, address):
        name = json.loads(ask(f"{address}api/runs", {"data": LONG, "kind": "run"}))["id"]
        until = time.monotonic() + PATIENCE_S
        while not (tmp_path / "runs" / name / "progress.jsonl").exists() and time.monotonic() < until:
            time.sleep(0.05)
        mine = children(process.pid)
        assert len(mine) >= 2  # a warm process and that of the run
        process.kill()
        process.wait()
        while any(map(alive, mine)) and time.monotonic() < until:
            time.sleep(0.05)
        assert [pid for pid in mine if alive(pid)] == []


def children(parent):
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(parent)], capture_output=True, text=True, check=True)
    return [int(pid) for pid in found.stdout.split()]


def alive(pid):
    """Whether a process goes on; one that has ended and waits to be counted does not."""
    found = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return bool(found.stdout.strip()) and not found.stdout.startswith("Z")


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--host", "0.0.0.0"], "--token"),  # noqa: S104 - which is refused
        (["--host", "192.168.1.5"], "--token"),
        (["--host", "0.0.0.0", "--token", "short"], "16 to 200"),  # noqa: S104
        (["--host", "no.such.name.invalid", "--token", "x" * 16], "cannot listen"),
        (["--host", "a..b", "--token", "x" * 16], "--host"),
        (["--port", "99999"], "65535"),
    ],
)
def test_a_server_that_cannot_be_is_refused_in_a_sentence(tmp_path, more, sentence, capsys):
    assert main(["serve", "--no-open", "--port", "0", "--folder", str(tmp_path), *more]) == 2
    assert sentence in capsys.readouterr().err


def test_a_workbench_without_its_extra_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert main(["serve", "--no-open", "--port", "0", "--folder", str(tmp_path)]) == 2
    assert "needs uvicorn, which is not installed: run pip install 'turnwright[web]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_to_read_a_job_imports_nothing_heavy():
    script = "import sys, turnwright.web.jobs as jobs; jobs.warm(); print([one for one in {} if one in sys.modules])"
    heavy = ["numba", "matplotlib", "h5py", "zarr", "scipy.signal", "scipy.stats", "scipy.optimize", "fastapi"]
    ran = subprocess.run([sys.executable, "-c", script.format(heavy)], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


def test_a_port_that_is_taken_is_refused(tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = str(taken.getsockname()[1])
        assert main(["serve", "--no-open", "--port", number, "--folder", str(tmp_path)]) == 2
    assert "--port" in capsys.readouterr().err


def test_under_windows_a_second_server_cannot_share_the_port(monkeypatch):
    """Its own option for that is asked for, and never the one that lets anybody in."""
    monkeypatch.setattr(_address.sys, "platform", "win32")
    monkeypatch.setattr(_address.socket, "SO_EXCLUSIVEADDRUSE", socket.SO_KEEPALIVE, raising=False)
    with _address.listening("127.0.0.1", 0) as (door, _):
        assert door.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        assert not door.getsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR)
