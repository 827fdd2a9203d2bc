"""The workbench as a person meets it: `turnwright serve` as a process, and its page in a real Chromium.

`TURNWRIGHT_BROWSER` names another browser of that family; `TURNWRIGHT_BROWSER_REQUIRED` makes its absence a failure.
"""

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from PIL import Image
from playwright.sync_api import Error

from patience import PATIENCE_S

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

ARGUMENTS = [
    # Pictures in three dimensions without a graphics card.
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    # The page itself is drawn without it too: through that imitation it takes several times as long.
    "--disable-gpu-rasterization", "--disable-gpu-compositing",
    # Nothing but what the page asks for.
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
]  # fmt: skip

FLAT = """{
  const {getContext} = HTMLCanvasElement.prototype;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...more);
  };
}"""
"""Takes three dimensions from a page, whose shaders a computer without a graphics card compiles for seconds."""

MISSED = "Error creating WebGL context"  # what the page then says, which works without it

SLOWLY = "GPU stall due to ReadPixels"  # what Chromium says of a picture that is taken without a graphics card

REPLACED = "the server responded with a status of 409"  # to a question that a later one has taken the place of


def browser():
    """Return where the browser is, or None."""
    named = os.environ.get("TURNWRIGHT_BROWSER")
    return shutil.which(named) if named else next(filter(None, map(shutil.which, NAMES)), None)


def wait(call, *, what):
    """Return the first answer of `call` that is true. The page's policy forbids that it waits by itself."""
    until = time.monotonic() + PATIENCE_S
    while not (found := call()):
        assert time.monotonic() < until, f"waited {PATIENCE_S} s in vain for {what}"
        time.sleep(0.05)
    return found


@contextlib.contextmanager
def serving(folder):
    """Start the server as a person does, and yield its address."""
    command = [sys.executable, "-m", "turnwright", "serve", "--port", "0", "--no-open", "--folder", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


@contextlib.contextmanager
def chromium(playwright):
    """Start the browser; root has no sandbox."""
    alone = ["--no-sandbox"] if hasattr(os, "getuid") and os.getuid() == 0 else []
    started = playwright.chromium.launch(executable_path=browser(), args=[*alone, *ARGUMENTS])
    try:
        yield started
    finally:
        started.close()


class Bench:
    """A page that is open, and all that goes wrong in it; the part is drawn where a test asks for its scene."""

    def __init__(self, chrome, address, *, size=(1280, 800), dark=False, touch=False, scene=False):
        self.address = address
        self.wrong = []
        self._waits = set()
        width, height = size
        self.context = chrome.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", has_touch=touch
        )
        self.context.set_default_timeout(PATIENCE_S * 1000)
        if not scene:
            self.context.add_init_script(FLAT)
        self.page = self.context.new_page()
        for event, hear in {
            "console": self._said,
            "pageerror": lambda error: self.wrong.append(f"error: {error}"),
            "request": self._asked,
            "requestfailed": self._failed,
            "requestfinished": self._finished,
            "response": self._answered,
        }.items():
            self.page.on(event, hear)

    def _said(self, message):
        # The browser says here, too, what a policy has forbidden.
        if message.type in ("error", "warning") and not any(one in message.text for one in (SLOWLY, MISSED, REPLACED)):
            self.wrong.append(f"{message.type}: {message.text}")

    def _asked(self, request):
        asked = urlsplit(request.url)
        if not asked.path.endswith("/events"):  # these stay open
            self._waits.add(request)
        if asked.scheme not in ("blob", "data") and asked[:2] != urlsplit(self.address)[:2]:
            self.wrong.append(f"asked elsewhere: {request.url}")

    def _failed(self, request):
        self._waits.discard(request)
        # A question that a later one has replaced is given up by the page itself.
        if request.failure != "net::ERR_ABORTED":
            self.wrong.append(f"failed: {request.url}, {request.failure}")

    def _finished(self, request):
        self._waits.discard(request)

    def _answered(self, response):
        # 409: see `REPLACED`.
        if response.status >= 400 and response.status != 409:
            self.wrong.append(f"answered {response.status}: {response.url}")

    def open(self):
        """Open the page, and wait until a person can use it."""
        self.page.goto(self.address)
        self.page.locator("#examples option").nth(1).wait_for(state="attached")
        return self

    def take(self, file):
        """Open a job file by the button for it."""
        with self.page.expect_file_chooser() as chosen:
            self.page.get_by_role("button", name="Open a job file").first.click()
        self.answer("/api/job/parse", lambda: chosen.value.set_files(file))
        self.page.locator("#pill").filter(has_not_text="checking").wait_for()
        return self

    def look_at(self, kind):
        """Look at what a run of this kind has found, which is done: "run", "compare", "measure" or "correct"."""
        runs = self.page.get_by_role("tab", name=re.compile("^Runs"))
        if not runs.is_visible():  # where there is room for one pane only
            self.page.get_by_role("button", name=re.compile("^Results")).click()
        runs.click()
        done = self.page.locator(".run[data-state=done]")
        named = re.compile("(compare|measure|correct),")
        of_kind = done.filter(has_not_text=named) if kind == "run" else done.filter(has_text=f"{kind},")
        of_kind.last.locator(".line").click()
        found = {"compare": "svg.pareto", "measure": "#measured .error-source"}.get(kind, "#outcome")
        self.page.locator(found).first.wait_for()
        return self

    def store(self, key):
        """Return what the page itself keeps."""
        return self.page.evaluate("async (key) => (await import('/state.js')).state[key]", key)

    def open_questions(self):
        """Return what the page has asked within a moment, and waits for."""
        self.page.wait_for_timeout(300)
        return self._waits

    def rest(self):
        """Wait until the page has all that it has asked for within a moment."""

        def answered():
            self.page.wait_for_timeout(60)
            return not self._waits

        wait(answered, what="answers to the page")

    def answer(self, path, act):
        """Return what the server answers to the first question at a path that `act` makes the page ask."""
        with self.page.expect_response(lambda one: urlsplit(one.url).path.endswith(path) and one.ok) as response:
            act()
        return response.value

    def download(self, link):
        """Return the bytes that a link leads to."""
        with self.page.expect_download() as taken:
            link.click()
        return Path(taken.value.path()).read_bytes()

    def png(self, locator=None):
        """Return a picture of the page, or of a part of it."""
        return (locator or self.page).screenshot(animations="disabled")

    def drawn(self, selector, *, colours):
        """Wait until a part of the page has so many colours, and return its picture."""
        part = self.page.locator(selector)
        part.wait_for()

        def picture():
            # An element drawn again just now has none yet.
            with contextlib.suppress(Error):
                png = self.png(part)
                return png if colours_of(png) >= colours else None

        return wait(picture, what=f"{colours} colours in {selector}")

    def settled(self):
        """Return a picture of the page once nothing moves in it any more, or of one that goes on moving."""
        before = self.png()
        for _ in range(6):
            time.sleep(0.2)
            now = self.png()
            if now == before:
                break
            before = now
        return now

    def close(self):
        """Close the page, in which nothing may have gone wrong."""
        self.context.close()
        assert not self.wrong, "\n".join(self.wrong)


def pixels(png):
    """Return the colours of a picture, (rows, columns, 3) from 0 to 255."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def colours_of(png):
    """Count the colours of a picture."""
    return len(Image.open(io.BytesIO(png)).convert("RGB").getcolors(1 << 24))


def plain(text):
    """Return a text of the page with the signs and gaps of a keyboard."""
    return text.replace("\u202f", " ").replace("\u2212", "-")


def figures(text):
    """Return the numbers of a text of the page."""
    return [float(one.replace(" ", "")) for one in re.findall(r"-?\d+(?: \d{3})*(?:\.\d+)?", plain(text))]


def smaller(png):
    """Return a picture in fewer bytes: six bits of each colour are enough for a page."""
    found = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").point(lambda value: value & 252 | value >> 6).save(
        found, "PNG", optimize=True
    )
    return found.getvalue()
