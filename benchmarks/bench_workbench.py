"""What somebody at the workbench waits for: the server as a process, asked as a page asks."""

import json
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.client import HTTPConnection
from urllib.parse import urlsplit

PATIENCE_S = 600
CLIENTS = 20


class Page:
    """One browser's connection."""

    def __init__(self, address):
        self.line = HTTPConnection(urlsplit(address).netloc, timeout=PATIENCE_S)

    def ask(self, path, data=None):
        """The answer and the seconds until it was there."""
        start = time.perf_counter()
        body = None if data is None else json.dumps(data)
        self.line.request("GET" if data is None else "POST", path, body, {"Content-Type": "application/json"})
        answer = self.line.getresponse()
        content = answer.read()
        if answer.status >= 300:
            raise RuntimeError(f"{path}: {answer.status} {content[:300]!r}")
        return content, time.perf_counter() - start

    def told(self, path, data=None):
        return json.loads(self.ask(path, data)[0])


@contextmanager
def serving(folder, *more):
    """A server: its address, and the seconds until a browser may come."""
    command = [sys.executable, "-m", "turnwright", "serve", "--port", "0", "--no-open", "--folder", folder, *more]
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            address = process.stdout.readline().split()[-1]
            yield address, time.perf_counter() - start
        finally:
            process.send_signal(signal.SIGINT)
            process.wait()


def typed(data, turn):
    """The job as somebody has just changed it: no answer is kept for it."""
    nose = f"{data['tool']['nose_radius'].split()[0]}{turn:04d} mm"
    return {"data": data | {"tool": data["tool"] | {"nose_radius": nose}}}


def start(times=3):
    """Seconds until the page can be opened, until it is there, and until the lens's first surface and check are."""
    ready, page, surface, check = [], [], [], []
    for turn in range(times):
        with tempfile.TemporaryDirectory() as folder, serving(folder) as (address, spent):
            began = time.perf_counter()
            one = Page(address)
            for path in (
                "/",
                "/app.js",
                "/form.js",
                "/scene.js",
                "/vendor/three.js",
                "/style.css",
                "/api/about",
                "/api/schema",
                "/api/examples",
            ):
                one.ask(path)
            page.append(time.perf_counter() - began)
            ready.append(spent)
            lens = typed(one.told("/api/examples/infrared_lens")["data"], turn + 1)
            one.ask("/api/view/surface", lens | {"quantity": "height", "pixels": 288})
            surface.append(time.perf_counter() - began)
            one.ask("/api/job/check", lens)
            check.append(time.perf_counter() - began)
    return ready, page, surface, check


def checks(page, data, times, first=0):
    """Seconds of each check of a job that changes all the time."""
    return [page.ask("/api/job/check", typed(data, first + turn + 1))[1] for turn in range(times)]


def run(page, data, name):
    return page.told("/api/runs", {"data": data, "kind": "run", "name": name})["id"]


def ended(page, name):
    """Wait for a run."""
    until = time.monotonic() + PATIENCE_S
    while (told := page.told(f"/api/runs/{name}"))["state"] not in ("done", "failed", "cancelled"):
        if time.monotonic() > until:
            raise RuntimeError(f"the run is not done after {PATIENCE_S} s")
        time.sleep(0.2)
    if told["state"] != "done":
        raise RuntimeError(told["sentence"])


def read_by_many(address, whole, asked):
    """Seconds of the maps that many clients read at once, every second one another part of it."""

    def read(number):
        mine, spent = Page(address), []
        for turn in range(asked):
            span = 0.4 + 0.001 * (number * asked + turn)
            path = f"{whole}&x0=-{span}&x1={span}&y0=-{span}&y1={span}" if turn % 2 else whole
            spent.append(mine.ask(path)[1])
        return spent

    with ThreadPoolExecutor(CLIENTS) as clients:
        return [one for spent in clients.map(read, range(CLIENTS)) for one in spent]


def under_load(small, large, asked=10):
    """Seconds of checks, windows and maps of a finished run: alone, and while two runs of a large job go on.

    Returns seconds of checks of the large job alone and beside the runs, of windows of the small one that are
    generated anew, of the maps that many clients read beside the runs, and how many runs still went on at the end.
    """
    with tempfile.TemporaryDirectory() as folder, serving(folder, "--at-a-time", "2") as (address, _):
        page = Page(address)
        quiet = checks(page, large, 8)[2:]
        name = run(page, small, "done")
        ended(page, name)
        first = page.told(f"/api/runs/{name}/maps")[0]["name"].replace(" ", "%20")
        whole = f"/api/runs/{name}/map?name={first}&nx=400&ny=400"
        window = f"/api/runs/{name}/map?name={first}&x0=0.1&x1=0.12&y0=0&y1=0.02&nx=200&ny=200"
        page.ask(window)
        # What is zoomed into is a new window every time.
        windows = [page.ask(window.replace("x0=0.1&", f"x0=0.1{turn:04d}&"))[1] for turn in range(1, asked)]
        for number in range(2):
            run(page, large, f"lens {number}")
        while any(one["state"] == "queued" for one in page.told("/api/runs")):
            time.sleep(0.1)
        time.sleep(3)
        busy = checks(page, large, 12, 100)
        answers = read_by_many(address, whole, asked)
        page = Page(address)  # the server hangs up on who says nothing for seconds
        still = sum(one["state"] == "running" for one in page.told("/api/runs"))
        for one in page.told("/api/runs"):
            if one["state"] in ("running", "queued"):
                page.ask(f"/api/runs/{one['id']}/cancel", {})
    return quiet, busy, windows, answers, still
