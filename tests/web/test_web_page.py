"""The workbench's page in a real Chromium.

Oracles: the command line's files, `generate` in this process, closed forms of a sphere and its cusps, the tool offset
that was injected into a measurement, and the browser itself, which says what failed.
"""

import io
import itertools
import json
import math
import os
import re
import time
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest

from dish import DISH, OFFSET, seen
from job_files import changed, written

pytest.importorskip("fastapi", reason="the workbench is an extra: pip install 'turnwright[web]'")
pytest.importorskip("playwright", reason="the page is tested in a browser: pip install 'turnwright[test]'")

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect, sync_playwright

import turnwright as tw
from turnwright.cli import main
from turnwright.web.binary import unpack
from workbench_page import (
    PATIENCE_S,
    Bench,
    browser,
    chromium,
    colours_of,
    figures,
    pixels,
    plain,
    serving,
    smaller,
    wait,
)

EXAMPLES = Path(__file__).parents[2] / "examples"
NOSE, SPHERE, FEED = 0.5, 20.0, 0.02
PANELS = ("maps", "profile", "motion", "compare", "program", "measure")
WINDOW = {"centre": ["0.9 mm", "0 mm"], "size": ["0.6 mm", "0.6 mm"], "pixel": "0.4 um"}
# Millions of points, as slowly as the lathe reads them, and windows for another quarter of a minute.
LIT = (*DISH, ("optics", {"wavelength": "633 nm"}))
LONG = (
    *DISH, ("part.name", "long"), ("strategy.feed", "2 um/rev"), ("strategy.points_per_rev", 3600),
    ("strategy.spindle_speed", "8 rpm"),
    ("simulation.patches", [{"name": f"window {number}"} | WINDOW for number in range(12)]),
)  # fmt: skip

expect.set_options(timeout=PATIENCE_S * 1000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("page")


@pytest.fixture(scope="module")
def by_hand(folder):
    """The job of these tests, with a person's remarks, carried out by the command line."""
    file = written(folder, *LIT)
    text = file.read_text(encoding="utf-8").replace("[tool]", "# from the drawer\n[tool]")
    text = text.replace("[strategy]", "\n# How it is cut\n[strategy] # slow").replace('"dish"', '"dish"  # as drawn')
    file.write_text(text, encoding="utf-8")
    assert main(["run", str(file), "--out", str(folder / "by-hand")]) == 0
    return folder / "by-hand"


@pytest.fixture(scope="module")
def earlier(by_hand, folder):
    """The job before its feed is changed, which makes it the job of these tests."""
    text = (by_hand.parent / "job.toml").read_text(encoding="utf-8")
    (folder / "earlier.toml").write_text(text.replace('"20 um/rev"', '"50 um/rev"'), encoding="utf-8")
    return folder / "earlier.toml"


@pytest.fixture(scope="module")
def motion(by_hand):
    return tw.read_nc(by_hand / "part.nc", tw.Machine.load("generic"))


@pytest.fixture(scope="module")
def chrome():
    if browser() is None:
        missing = "no Chromium here, so the page is not tested: install one, or name it in TURNWRIGHT_BROWSER"
        (pytest.fail if os.environ.get("TURNWRIGHT_BROWSER_REQUIRED") else pytest.skip)(missing)
    with sync_playwright() as playwright, chromium(playwright) as started:
        yield started


@pytest.fixture(scope="module")
def address(chrome, folder):
    with serving(folder / "served") as found:
        yield found


@pytest.fixture
def bench(chrome, address):
    """Open pages; nothing may go wrong in any of them."""
    opened = []

    def look(**how):
        opened.append(Bench(chrome, address, **how))
        return opened[-1].open()

    yield look
    for one in opened:
        one.close()


@pytest.fixture(scope="module")
def kept(chrome, address):
    one = Bench(chrome, address).open()
    yield one
    one.close()


@pytest.fixture
def desk(kept):
    """A page that stays open: each test begins with a job or a run of its own. Nothing may go wrong in it."""
    yield kept
    wrong, kept.wrong = kept.wrong, []
    assert not wrong, "\n".join(wrong)


def begun(one, press):
    """Return the id of the run that a press begins."""
    return one.answer("/api/runs", press).json()["id"]


def cancelled(one, title):
    """Cancel a run by its button: what it would show is looked at elsewhere."""
    one.page.get_by_role("tab", name=re.compile("^Runs")).click()
    one.page.get_by_role("button", name=f"Cancel {title}").click()
    expect(one.page.locator(".run", has_text=title)).to_have_attribute("data-state", "cancelled")


def gone(one, name):
    """Throw a run away, which other tests do not know."""
    assert one.page.request.delete(f"{one.address.rstrip('/')}/api/runs/{name}").status == 204


@pytest.fixture(scope="module")
def done(chrome, address, earlier):
    """The job, changed and carried out by a press on Run; the run's id."""
    one = Bench(chrome, address).open().take(earlier)
    one.page.locator("#field-strategy-feed").fill("20 um/rev")
    name = begun(one, one.page.locator("#run").click)
    one.page.locator("#outcome").wait_for()
    one.close()
    return name


@pytest.fixture(scope="module")
def compared(chrome, address, by_hand):
    """A small job of long strides by every strategy; the run's id."""
    one = Bench(chrome, address).open().take(by_hand.parent / "job.toml")
    one.page.locator("#field-part-radius").fill("0.3 mm")
    one.page.locator("#field-strategy-feed").fill("50 um/rev")
    name = begun(one, one.page.get_by_role("button", name="Compare", exact=True).click)
    one.page.locator("svg.pareto").wait_for()
    one.close()
    return name


@pytest.fixture(scope="module")
def measured(chrome, address, done, by_hand):
    """A map of the dish cut with a tool offset, brought as a person brings it."""
    file = seen(by_hand.parent / "job.toml", by_hand.parent / "dish.x3p")
    one = Bench(chrome, address).open().look_at("run")
    one.page.keyboard.press("6")
    with one.page.expect_file_chooser() as chosen:
        one.page.get_by_role("button", name="Choose a file").click()
    chosen.value.set_files(file)
    one.page.locator("#measured").wait_for()
    one.close()


# ---------------------------------------------------------------------------------------------------- planning a job


def test_an_empty_page_teaches_and_an_example_fills_it(bench):
    one = bench(scene=True)
    page = one.page
    expect(page.get_by_role("heading", name="From a prescription to a proven program")).to_be_visible()
    offered = page.locator("#welcome .examples button")
    assert offered.count() == page.locator("#examples option").count() - 1 >= 8
    expect(page.locator("#run")).to_be_disabled()
    offered.filter(has_text="sinusoidal grid").first.click()
    expect(page.locator("#welcome")).to_be_hidden()
    expect(page.locator("#verdict")).to_have_class("card verdict good")
    expect(page.locator("#run")).to_be_enabled()
    expect(page.get_by_label("Position of the tool")).to_be_visible()  # from here on the scene keeps its size
    # The grid has shades, an empty canvas one colour, and a plane with its axes some dozens.
    shown = pixels(one.drawn("canvas.scene", colours=1500))
    page.get_by_label("Colour the part by").select_option("slope")
    wait(lambda: differs_from(shown, one.png(page.locator("canvas.scene"))), what="the slope in other colours")


def differs_from(before, png, share=0.02):
    """Whether a good part of the pixels has another colour."""
    return np.mean(np.abs(before - pixels(png)).max(axis=-1) > 16) > share


def test_the_verdict_turns_at_the_radius_of_the_sphere(bench, by_hand):
    """Closed form: a nose of more than a bowl's own radius does not fit into it."""
    one = bench().take(by_hand.parent / "job.toml")
    # As on a computer without graphics, where all but the drawing works.
    expect(one.page.locator("#scene")).to_contain_text("This browser has no 3-D graphics (WebGL)")
    verdict, nose = one.page.locator("#verdict"), one.page.locator("#field-tool-nose_radius")
    for typed, kind in (("20.001 mm", "bad"), ("19.999 mm", "good"), ("20001 um", "bad"), ("0.5", "good")):
        nose.fill(typed)
        expect(verdict).to_have_class(f"card verdict {kind}")
    nose.blur()
    assert nose.input_value() == "0.5 mm"  # the unit of the field, where none was typed
    limit = one.page.locator(".finding", has_text="nose radius").locator(".number")
    assert figures(limit.inner_text()) == pytest.approx([NOSE, SPHERE])


def test_a_wrong_field_is_marked_where_it_stands(desk, by_hand, tmp_path, capsys):
    one = desk.take(by_hand.parent / "job.toml")
    nose = one.page.locator("#field-tool-nose_radius")
    for typed in ("0.5 kg", "0,5 mm", "-1 mm"):
        nose.fill(typed)
        wrong = one.page.locator("#field-tool-nose_radius-wrong")
        expect(nose).to_have_attribute("aria-invalid", "true")
        assert main(["check", str(written(tmp_path, *DISH, ("tool.nose_radius", typed)))]) == 2
        message = " ".join(capsys.readouterr().err.split())
        wait(lambda: wrong.inner_text().strip() and wrong.inner_text().strip() in message, what="the sentence")  # noqa: B023
        expect(one.page.locator("#run")).to_be_disabled()
    nose.fill("0.5 mm")
    expect(nose).not_to_have_attribute("aria-invalid", "true")
    expect(one.page.locator("#run")).to_be_enabled()


def test_a_job_goes_in_and_out_as_toml(desk, by_hand):
    one = desk.take(by_hand.parent / "job.toml")
    page = one.page
    assert tomllib.loads(one.download(page.get_by_role("button", name="Save the job file")).decode()) == changed(*LIT)
    page.get_by_role("tab", name="TOML").click()
    text = page.get_by_label("The job as TOML")
    one.answer("/api/job/parse", lambda: text.fill(text.input_value().replace('"20 um/rev"', '"7 um/rev"')))
    page.get_by_role("tab", name="Fields").click()
    feed = page.locator("#field-strategy-feed")
    expect(feed).to_have_value("7 um/rev")
    feed.fill("9 um/rev")
    saved = tomllib.loads(one.download(page.get_by_role("button", name="Save the job file")).decode())
    assert saved == changed(*LIT, ("strategy.feed", "9 um/rev"))
    feed.blur()
    for wanted in ("7 um/rev", "20 um/rev"):
        page.get_by_role("button", name="Undo").click()
        expect(feed).to_have_value(wanted)


@pytest.mark.usefixtures("done")
def test_remarks_stay_when_a_job_is_changed_undone_and_run(desk, by_hand, earlier):
    """Oracle: the text that was opened."""
    text = earlier.read_text(encoding="utf-8")
    wanted = (by_hand.parent / "job.toml").read_text(encoding="utf-8")
    assert wanted.count("#") == text.count("#") == 4
    one = desk.take(earlier)
    page = one.page
    save = page.get_by_role("button", name="Save the job file")
    feed = page.locator("#field-strategy-feed")
    feed.fill("20 um/rev")
    assert one.download(save).decode() == wanted
    feed.blur()
    page.get_by_role("button", name="Undo").click()
    assert one.download(save).decode() == text
    page.get_by_role("button", name="Redo").click()
    assert one.download(save).decode() == wanted
    one.look_at("run")
    links = page.locator("#outcome .downloads")
    assert one.download(links.get_by_role("link", name="Job as written")).decode() == wanted
    one.take(earlier)
    page.locator("#field-tool-nose_radius").fill("0.4 mm")
    page.get_by_role("button", name="Edit this job").click()
    expect(feed).to_have_value("20 um/rev")
    assert one.download(save).decode() == wanted
    page.reload()
    expect(feed).to_have_value("20 um/rev")
    assert one.download(save).decode() == wanted


def test_text_counts_as_soon_as_it_is_typed(bench, by_hand):
    one = bench().take(by_hand.parent / "job.toml")
    page = one.page
    page.get_by_role("tab", name="TOML").click()
    text = page.get_by_label("The job as TOML")
    text.fill(text.input_value().replace('"20 um/rev"', '"0.49 um/rev"').replace('"dish"', '"quick"'))
    answer = one.answer("/api/runs", lambda: text.press("Control+Enter"))
    asked = answer.request.post_data_json
    assert asked["data"]["strategy"]["feed"] == "0.49 um/rev"
    assert '"0.49 um/rev"' in asked["toml"]
    text.fill(text.input_value().replace('"0.49 um/rev"', '"0.48 um/rev"'))
    assert '"0.48 um/rev"' in one.download(page.get_by_role("button", name="Save the job file")).decode()
    cancelled(one, "quick")
    gone(one, answer.json()["id"])


def test_unread_text_is_neither_lost_nor_skipped(bench, by_hand):
    one = bench().take(by_hand.parent / "job.toml")
    page = one.page
    asked = []
    page.on("request", lambda request: asked.append((request.method, urlsplit(request.url).path)))
    page.get_by_role("tab", name="TOML").click()
    text = page.get_by_label("The job as TOML")
    typed = text.input_value().replace('"20 um/rev"', '"0.47 um/rev"').replace('"dish"', '"typed"')
    page.route("**/api/job/parse", lambda route: route.fulfill(status=503, json={"detail": "too many questions"}))
    text.fill(typed)
    text.press("Control+Enter")
    expect(page.locator("#foot")).to_contain_text("too many questions")
    text.blur()
    page.wait_for_timeout(1000)
    assert ("POST", "/api/runs") not in asked
    assert text.input_value() == typed
    page.unroute("**/api/job/parse")
    answer = one.answer("/api/runs", lambda: text.press("Control+Enter"))
    assert answer.request.post_data_json["data"]["strategy"]["feed"] == "0.47 um/rev"
    cancelled(one, "typed")
    gone(one, answer.json()["id"])
    one.wrong = [each for each in one.wrong if "503" not in each]  # as the browser says it, too


def test_a_late_archive_leaves_a_newer_job(bench, by_hand, tmp_path):
    with zipfile.ZipFile(tmp_path / "late.zip", "w") as archive:
        archive.writestr("job.toml", (by_hand.parent / "job.toml").read_text(encoding="utf-8").replace("dish", "late"))
    one = bench()
    page, held = one.page, []
    page.route("**/api/files/archive", lambda route: held.append(route))  # noqa: PLW0108 - its parameters are read
    with page.expect_file_chooser() as chosen:
        page.get_by_role("button", name="Open a job file").first.click()
    chosen.value.set_files(tmp_path / "late.zip")
    wait(lambda: page.title() and held, what="the archive on its way")
    one.take(by_hand.parent / "job.toml")
    one.answer("/api/files/archive", held[0].continue_)
    page.wait_for_timeout(300)
    expect(page.locator("#field-part-name")).to_have_value("dish")


def test_a_file_goes_to_its_field_into_the_archive_and_back(desk, tmp_path):
    """Oracle: the bytes that were brought."""
    axis = np.linspace(-2.5, 2.5, 11)
    rows = [["", *axis], *([y, *(axis**2 + y**2) / 100] for y in axis)]
    (tmp_path / "Sag table.csv").write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")
    surface = {"family": "gridded", "units": "mm", "sag_units": "mm"}
    file = written(tmp_path, *DISH, ("part.surface", surface))
    file.write_text(file.read_text(encoding="utf-8").replace("[tool]", "# of steel\n[tool]"), encoding="utf-8")
    one = desk.take(file)
    page = one.page
    picker, field = page.locator("#field-part-surface-file-file"), page.locator("#field-part-surface-file")
    expect(page.locator("#run")).to_be_disabled()
    picker.set_input_files(tmp_path / "Sag table.csv")
    expect(field).to_have_text("Sag_table.csv")
    expect(page.locator("#pill")).to_have_class("pill good")
    packed = one.download(page.get_by_role("button", name="Save the job file"))
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        assert archive.read("Sag_table.csv") == (tmp_path / "Sag table.csv").read_bytes()
        assert "# of steel" in archive.read("job.toml").decode()
    (tmp_path / "dish.zip").write_bytes(packed)
    page.get_by_role("button", name="Remove Sag_table.csv from the job").click()
    expect(page.locator("#run")).to_be_disabled()
    with page.expect_file_chooser() as chosen:
        page.get_by_role("button", name="Open a job file").first.click()
    chosen.value.set_files(tmp_path / "dish.zip")
    expect(field).to_have_text("Sag_table.csv")
    expect(page.locator("#pill")).to_have_class("pill good")
    again = one.download(page.get_by_role("button", name="Save the job file"))
    with zipfile.ZipFile(io.BytesIO(packed)) as first, zipfile.ZipFile(io.BytesIO(again)) as second:
        assert [(name, first.read(name)) for name in first.namelist()] == [
            (name, second.read(name)) for name in second.namelist()
        ]


def test_a_file_of_another_kind_is_reported_by_its_name(desk, tmp_path):
    (tmp_path / "no table.csv").write_text("<html>", encoding="utf-8")
    surface = {"family": "gridded", "units": "mm", "sag_units": "mm"}
    one = desk.take(written(tmp_path, *DISH, ("part.surface", surface)))
    one.page.locator("#field-part-surface-file-file").set_input_files(tmp_path / "no table.csv")
    expect(one.page.locator("#foot")).to_contain_text("no table.csv: ")
    expect(one.page.locator("#run")).to_be_disabled()
    one.wrong = [each for each in one.wrong if "422" not in each]  # as the browser says it, too


def test_a_file_that_is_no_job_leaves_the_job_as_it_is(desk, by_hand, tmp_path):
    one = desk.take(by_hand.parent / "job.toml")
    (tmp_path / "odd.toml").write_text("[part", encoding="utf-8")
    one.take(tmp_path / "odd.toml")
    expect(one.page.locator("#foot")).to_contain_text("odd.toml: the job is not TOML")
    assert not one.store("errors")
    assert tomllib.loads(one.store("toml")) == changed(*LIT)
    expect(one.page.locator("#run")).to_be_enabled()
    one.take(by_hand.parent / "job.toml")
    expect(one.page.locator("#foot")).not_to_contain_text("odd.toml")


def typed_by_hand(one, count, seed):
    """Type entries letter by letter, 70 to 220 ms a key, into fields of an open job; return those that changed."""
    page, random = one.page, np.random.default_rng(seed)
    fields = page.locator("#form input[type=text]").evaluate_all("all => all.map((one) => one.id || one.ariaLabel)")
    # A term is named after its box is left, so its value's box is found by its label.
    changed_entries = []
    for turn in range(count):
        name = fields[(turn + seed) % len(fields)]
        box = page.locator(f'[id="{name}"]') if name.startswith("field-") else page.get_by_label(name, exact=True)
        word, _, unit = box.input_value().partition(" ")
        text = f"{random.uniform(0.3, 9):.{random.integers(2, 6)}f}"
        if not re.fullmatch("[-+0-9.e]+", word):
            text = f"entry {text}"
        elif unit:
            text += f" {unit}"
        box.click()
        page.keyboard.press("Control+A")
        page.keyboard.press("Delete")
        for key in text:
            page.keyboard.type(key)
            page.wait_for_timeout(random.uniform(70, 220))
        page.wait_for_timeout(300)
        if box.input_value() != text:
            changed_entries.append((name, text, box.input_value()))
    return changed_entries


def test_a_typed_entry_stays_as_it_is_typed(bench, by_hand):
    # Oracle: the text itself. A slow computer draws between two keys, where an older text could come back.
    one = bench().take(by_hand.parent / "job.toml")
    one.context.new_cdp_session(one.page).send("Emulation.setCPUThrottlingRate", {"rate": 4})
    assert typed_by_hand(one, 2, seed=1) == []
    one.wrong = [each for each in one.wrong if "422" not in each]  # half a number is refused


def test_the_value_of_a_term_is_typed_with_all_its_digits(desk, tmp_path):
    asphere = {"family": "even asphere", "radius": "40 mm", "conic": -0.8, "units": "mm", "terms": {"4": 2e-6}}
    one = desk.take(written(tmp_path, ("part.surface", asphere)))
    box = one.page.get_by_label("value of 4")
    box.fill("")
    for text in ("1", "1.", "1.0", "1.05", "1.05e", "1.05e-", "1.05e-6"):
        box.press(text[-1])
        assert box.input_value() == text
    assert one.store("job")["part"]["surface"]["terms"] == {"4": 1.05e-6}


def test_a_field_that_is_emptied_stays_under_the_hand(desk, by_hand):
    one = desk.take(by_hand.parent / "job.toml")
    box = one.page.locator("#field-part-name")
    box.click()
    one.page.keyboard.press("Control+A")
    one.page.keyboard.press("Delete")
    one.page.wait_for_timeout(300)
    expect(box).to_be_focused()


def test_two_terms_never_become_one(desk, tmp_path):
    terms = {"4": 2e-6, "6": -3e-8}
    asphere = {"family": "even asphere", "radius": "40 mm", "conic": -0.8, "units": "mm", "terms": terms}
    one = desk.take(written(tmp_path, ("part.surface", asphere)))
    name = one.page.get_by_label("name of term 2")
    name.fill("4")
    name.blur()
    expect(one.page.locator("#foot")).to_contain_text("A term named 4 already exists")
    assert name.input_value() == "6"
    one.page.get_by_label("value of 6").fill("\N{MINUS SIGN}5e-8")
    assert one.store("job")["part"]["surface"]["terms"] == {"4": 2e-6, "6": -5e-8}


def test_a_map_of_one_value_has_a_scale_around_it(bench, by_hand):
    """Closed form: along the cut a part of revolution does not fall, so the whole clearance is left everywhere."""
    one = bench(scene=True).take(by_hand.parent / "job.toml")
    one.drawn("canvas.scene", colours=200)
    one.page.get_by_label("Colour the part by").select_option("clearance margin")
    expect(one.page.locator("#scene")).to_contain_text("clearance angle of the tool, 10 deg")
    # The bar has its colours and its numbers, the part the middle of them.
    one.drawn("canvas.scenecolours", colours=100)


# -------------------------------------------------------------------------------------------------------- a long run


def test_a_long_run_shows_progress_and_can_be_cancelled(bench, folder, tmp_path):
    one = bench().take(written(tmp_path, *LONG))
    page = one.page
    name = begun(one, lambda: page.keyboard.press("Control+Enter"))
    reported = page.locator(".run", has_text="long").locator(".progress [role=status]")
    shown = []

    def risen():
        text = plain(reported.inner_text())
        if (not shown or text != shown[-1]) and text.endswith("%"):
            shown.append(text)
        shares = [(one.rpartition(":")[0], figures(one)[-1]) for one in shown]
        return any(a[0] == b[0] and a[1] < b[1] for a, b in itertools.pairwise(shares))

    wait(risen, what="progress within a stage")
    # What the page has shown, the run has written.
    lines = (folder / "served" / "runs" / name / "progress.jsonl").read_text(encoding="utf-8").splitlines()
    wrote = [json.loads(line) for line in lines]
    assert set(shown) <= {
        f"step {each['step']} of {each['steps']}, {each['stage']}: {math.floor(100 * each['fraction'])} %"
        for each in wrote
    }
    page.reload()
    page.get_by_role("tab", name="Runs").click()
    expect(reported).to_be_visible()
    assert page.locator("#field-strategy-feed").input_value() == "2 um/rev"  # the job outlives the reload, too
    page.get_by_role("button", name="Cancel long").click()
    expect(page.locator(".run", has_text="long")).to_have_attribute("data-state", "cancelled")
    assert not (folder / "served" / "runs" / name / "out").exists()


def test_what_one_page_throws_away_leaves_every_page(bench, by_hand):
    first = bench().take(by_hand.parent / "job.toml")
    first.page.locator("#field-part-name").fill("short-lived")
    first.page.locator("#field-strategy-feed").fill("0.49 um/rev")
    begun(first, first.page.locator("#run").click)
    cancelled(first, "short-lived")
    second = bench()
    second.page.get_by_role("tab", name="Runs").click()
    expect(second.page.locator(".run", has_text="short-lived")).to_have_attribute("data-state", "cancelled")
    wait(lambda: not first.open_questions(), what="what the page asks of the run that has ended")
    second.page.get_by_role("button", name="Delete short-lived").click()
    second.page.get_by_role("button", name="Delete", exact=True).click()
    for one in (second, first):
        expect(one.page.locator(".run", has_text="short-lived")).to_have_count(0)


def test_many_runs_leave_connections_for_other_requests(bench):
    """A browser keeps six of them."""
    one = bench()
    page, heard = one.page, set()
    line = {
        "name": "many", "kind": "run", "state": "running", "created": "2026-01-01T00:00:00Z", "started": None,
        "ended": None, "sentence": "", "missed": False, "of": "", "progress": None,
    }  # fmt: skip
    page.on("request", lambda request: heard.add(urlsplit(request.url).path))
    page.route("**/api/runs", lambda route: route.fulfill(json=[{"id": f"{n:016x}"} | line for n in range(8)]))
    page.route(
        "**/api/runs/*/events",
        lambda route: route.fulfill(content_type="text/event-stream", body="retry: 60000\n\n"),
    )
    page.get_by_role("tab", name=re.compile("^Runs")).click()
    page.evaluate("dispatchEvent(new Event('focus'))")
    expect(page.locator(".run", has_text="many")).to_have_count(8)
    page.wait_for_timeout(300)
    assert len([path for path in heard if re.fullmatch("/api/runs/[0-9a-f]{16}/events", path)]) == 2


# ------------------------------------------------------------------------------------------------------- what it left


TOOL = tw.Tool(nose_radius=NOSE, included=np.deg2rad(60), clearance=np.deg2rad(10))


def zoomed(one, act):
    """Return the view after an act, and what the server sent of it: header, x, y and values."""
    reported = []
    one.page.on("response", lambda each: reported.append(each) if "/map?" in each.url and "x0=" in each.url else None)
    act()

    def rested():
        before = one.store("window"), len(reported)
        time.sleep(0.4)  # by then the page has asked for what it still wants
        view = one.store("window")
        if (view, len(reported)) != before or one.page.locator("#panel-maps .mapwait").is_visible():
            return None
        # Asked is a little more than is in view, but nothing beyond the part.
        asked = [dict(parse_qsl(urlsplit(each.url).query)) for each in reported]
        there = [
            each for each, window in zip(reported, asked, strict=True)
            if float(window["x0"]) <= max(-2.0, view["x0"]) and float(window["x1"]) >= min(2.0, view["x1"])
        ]  # fmt: skip
        return (view, there[-1]) if there else None

    view, answer = wait(rested, what="a finer map")
    header, arrays = unpack(answer.body())
    values = arrays["values"].astype(float)
    x, y = (np.linspace(*header[axis], count) for axis, count in (("x", values.shape[1]), ("y", values.shape[0])))
    return view["x1"] - view["x0"], header, x, y, values


@pytest.mark.usefixtures("done")
def test_the_wheel_leads_to_single_cusps(bench, motion):
    one = bench().look_at("run")
    page = one.page
    one.drawn("#panel-maps canvas.mapcanvas", colours=60)
    box = page.locator("#panel-maps canvas.mapcanvas").bounding_box()
    place = box["x"] + 0.57 * box["width"], box["y"] + 0.4 * box["height"]
    page.mouse.move(*place)
    spans, pixel = [], []
    turn(page, 8)  # what is stored is fine enough so far
    for notches in (4, 8):
        span, header, x, y, values = zoomed(one, lambda: turn(page, notches))  # noqa: B023
        spans.append(span)
        pixel.append(x[1] - x[0])
        assert header["source"] == "generated"
    assert (np.diff(spans) < 0).all()
    assert (np.diff(pixel) < 0).all()
    assert spans[-1] < 10 * FEED
    # Each value is that of `generate`; they are sent as float32.
    rows, columns = np.arange(1, y.size, y.size // 7), np.arange(2, x.size, x.size // 9)
    wanted = tw.generate(motion, TOOL, x=x[columns], y=y[rows]).minus(tw.Sphere(radius=SPHERE)).z
    inside = np.hypot(*np.meshgrid(x[columns], y[rows])) < 2
    np.testing.assert_allclose(values[np.ix_(rows, columns)][inside], wanted[inside], rtol=1e-5, atol=1e-12)
    assert np.mean(inside) > 0.5
    # Closed form: a nose set along z leaves cusps of feed² / 8R(1 - R/sphere); a pixel may miss the crest of one.
    cusp = FEED**2 / (8 * NOSE * (1 - NOSE / SPHERE))
    assert np.nanmax(values) - np.nanmin(values) == pytest.approx(cusp, rel=0.03)
    # What stands under the pointer is what was sent.
    page.mouse.move(place[0] + 7, place[1] + 5)
    reported = page.locator("#panel-maps .readout")
    wait(lambda: "mm" in reported.inner_text(), what="a value under the pointer")
    at_x, at_y, value = figures(reported.inner_text())
    near = values[np.abs(y - at_y).argmin()][np.abs(x - at_x).argmin()]
    beside = np.abs(np.diff(values, axis=1)).max() + np.abs(np.diff(values, axis=0)).max()
    assert value == pytest.approx(near * 1e6, abs=beside * 1e6 + 0.01)
    expect(page.locator("#panel-maps .mapbarrow")).to_contain_text("simulated from the program")


def turn(page, notches):
    for _ in range(notches):
        page.mouse.wheel(0, -120)


@pytest.mark.usefixtures("done")
def test_a_line_on_the_map_is_a_profile(desk, motion):
    one = desk.look_at("run")
    page = one.page
    one.drawn("#panel-maps canvas.mapcanvas", colours=60)
    box = page.locator("#panel-maps canvas.mapcanvas").bounding_box()
    page.get_by_role("button", name="Profile line").click()

    def drag():
        page.mouse.move(box["x"] + 0.45 * box["width"], box["y"] + 0.5 * box["height"])
        page.mouse.down()
        page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.3 * box["height"], steps=4)
        page.mouse.up()

    answer = one.answer("/profile", drag)
    asked = {key: float(value) for key, value in parse_qsl(urlsplit(answer.url).query) if key != "client"}
    _, arrays = unpack(answer.body())
    along = np.linspace(0, 1, int(asked["n"]))
    x, y = (asked[f"{axis}0"] + along * (asked[f"{axis}1"] - asked[f"{axis}0"]) for axis in "xy")
    np.testing.assert_allclose(arrays["distance"][-1], math.hypot(x[-1] - x[0], y[-1] - y[0]), rtol=1e-6)
    wanted = tw.generate_points(motion, TOOL, x=x, y=y) - tw.Sphere(radius=SPHERE).sag(x, y)
    np.testing.assert_allclose(arrays["error"], wanted, rtol=1e-4, atol=1e-11)
    one.drawn("#panel-maps .mapside .charthost", colours=20)
    message = page.locator("#panel-maps .mapside .bar strong").inner_text()
    assert figures(message) == pytest.approx([np.ptp(wanted) * 1e6], rel=5e-3)
    assert message.endswith("nm")


@pytest.mark.usefixtures("done")
def test_the_axes_are_shown_against_their_limits(desk, by_hand):
    one = desk.look_at("run")
    page = one.page
    page.keyboard.press("3")
    reported = json.loads((by_hand / "result.json").read_text(encoding="utf-8"))["passes"][-1]["limits"]
    machine = tw.Machine.load("generic")
    for letter in "XZ":
        title = page.locator("#panel-motion figcaption").filter(has_text=f"{letter}, peak")
        share = 100 * reported["peak_speed"][letter] / machine.axes[letter].speed
        assert figures(title.inner_text())[-1] == pytest.approx(share, rel=0.05), letter
    assert one.drawn("#panel-motion .charthost >> nth=0", colours=20)


def test_strategies_stand_side_by_side(desk, compared, folder):
    one = desk.look_at("compare")
    page = one.page
    reported = json.loads(
        (folder / "served" / "runs" / compared / "out" / "comparison.json").read_text(encoding="utf-8")
    )
    planned = {each["name"]: each for each in reported["candidates"] if not each["refused"]}
    assert len(planned) >= 3
    rows = page.locator("table.data tbody tr")
    assert {row.locator("th").inner_text().strip().splitlines()[0] for row in rows.all()} == set(planned)
    refused = {each["name"] for each in reported["candidates"] if each["refused"]}
    assert {each.inner_text() for each in page.locator("#panel-compare .sentences strong").all()} == refused
    for error in ("pv_nm", "rms_nm"):
        page.get_by_label("Error to compare").select_option(error)
        places = {name: (one["limits"]["cycle_time_s"], one["breakdown"][error]) for name, one in planned.items()}
        unbeaten = {
            name for name, (time, left) in places.items()
            if not any((a <= time and b <= left and (a, b) != (time, left)) for a, b in places.values())
        }  # fmt: skip
        best = page.locator("svg.pareto .spot.best title")
        wait(lambda: set(best.all_text_contents()) == unbeaten, what="the strategies that none beats")  # noqa: B023
        assert page.locator("svg.pareto .spot").count() == len(planned)


def test_downloads_are_the_files_of_the_command_line(desk, done, by_hand, folder):
    one = desk.look_at("run")
    links = one.page.locator("#outcome .downloads")
    for title, file in (("Program", "part.nc"), ("Job", "job.toml")):
        assert one.download(links.get_by_role("link", name=title, exact=True)) == (by_hand / file).read_bytes()
    report = one.download(links.get_by_role("link", name="Report", exact=True))
    assert report == (folder / "served" / "runs" / done / "out" / "report.html").read_bytes()
    assert b"<html" in report


@pytest.mark.usefixtures("done")
def test_the_light_of_a_run_has_its_card(desk, by_hand):
    """The dish is turned at 20 um/rev with a nose of 0.5 mm: its figures are those of the command line."""
    light = json.loads((by_hand / "result.json").read_text())["optics"]
    card = desk.look_at("run").page.locator("#optics")
    expect(card).to_contain_text(f"{light['strehl']:.3f}"[:4])
    expect(card).to_contain_text(f"{100 * light['orders'][0]['efficiency']:.3g} %")


@pytest.mark.usefixtures("done")
def test_lines_of_the_program_lead_to_the_part(desk, motion):
    one = desk.look_at("run")
    page = one.page
    page.keyboard.press("5")
    line = page.get_by_label("Go to line", exact=True).first
    line.fill("3000")
    line.press("Enter")
    chosen = page.locator("#panel-program [role=option][aria-selected=true]")
    expect(chosen.locator(".at")).to_have_text("3000")
    expect(chosen.locator("code")).to_contain_text("G1 X")
    x, z, turned = (float(word[1:]) for word in chosen.locator("code").inner_text().split()[1:4])
    reported = figures(page.locator("#panel-program .bar .number").inner_text())
    angle = math.radians(turned)
    assert reported == pytest.approx([x * math.cos(angle), x * math.sin(angle), z], rel=1e-4)
    # Closed form: the tip of a round nose in a bowl stands on a bowl that is smaller by the nose.
    assert z == pytest.approx(SPHERE - NOSE - math.sqrt((SPHERE - NOSE) ** 2 - x**2), abs=1e-6)


# ------------------------------------------------------------------------------------------------ measure and correct


def test_a_map_is_shown_without_a_job(bench, tmp_path):
    x = 0.002 * np.arange(120)
    z = 1e-5 * np.cos(2 * np.pi * np.arange(120) / 40) * np.cos(2 * np.pi * np.arange(90) / 45)[:, None]
    tw.write_map(tw.HeightMap(z=z, x=x, y=0.002 * np.arange(90)), tmp_path / "alone.npz")
    one = bench()
    page = one.page
    page.keyboard.press("6")
    with page.expect_file_chooser() as chosen:
        page.get_by_role("button", name="Show a map without a job").click()
    chosen.value.set_files(tmp_path / "alone.npz")
    page.locator("#lone").wait_for()
    assert "120 x 90 points" in page.locator("#lone dl").inner_text()
    one.drawn("#lone canvas.mapcanvas", colours=40)
    page.get_by_role("button", name="Show another map").click()
    page.get_by_role("button", name="Show a map without a job").wait_for()


@pytest.mark.usefixtures("measured")
def test_an_injected_offset_is_found_and_corrected(bench, folder, tmp_path):
    one = bench().look_at("measure")
    page = one.page
    error_source = page.locator(".error-source", has=page.get_by_text("offset x", exact=True))
    value, doubt = figures(error_source.locator(".number").inner_text())
    assert plain(error_source.locator(".number").inner_text()).endswith(" \u00b5m")
    assert abs(value - OFFSET * 1e3) <= doubt
    # A drift of Z would do as well, which makes the doubt a large one.
    assert figures(error_source.locator("p").inner_text())[0] == pytest.approx(OFFSET * 1e3, abs=doubt)
    assert figures(error_source.locator("p").inner_text())[:3] == [value, doubt, 95]  # number and sentence say the same
    # A dish of revolution has no azimuth, so that part of the pose is fixed: nothing was found of it.
    assert page.locator("dt", has_text="rotation").locator("+ dd").inner_text() == "fixed"
    one.drawn("#measured .map canvas.mapcanvas", colours=60)
    for box in page.locator(".error-source input").all():
        box.set_checked(False)
    expect(page.locator("#correct")).to_have_text("Correct the form")
    error_source.get_by_role("checkbox").check()
    name = one.answer("/correct", page.locator("#correct").click).json()["id"]
    after = page.get_by_role("tab", name="After correction")
    expect(after).to_be_enabled()
    before = pixels(one.drawn("#measured .map canvas.mapcanvas", colours=60))
    reported = one.answer("/map", after.click)
    assert reported.url.endswith("name=predicted")
    header, arrays = unpack(reported.body())
    wait(
        lambda: differs_from(before, one.png(page.locator("#measured .map canvas.mapcanvas"))), what="the predicted map"
    )
    # As the command line judges it: by the prediction, which holds what no correction reaches, against the tolerance.
    judged = page.locator("#measured .decide .bar > span")
    expect(judged).to_contain_text("then predicted")
    # Closed form: an offset leaves a cone, offset times slope; it was there, and will be gone.
    measured = unpack(page.request.get(reported.url.replace("predicted", "measured")).body())
    assert header["unit"] == "nm"
    assert cone(*measured) == pytest.approx(-OFFSET / SPHERE, rel=0.05)
    assert abs(cone(header, arrays)) < 0.05 * OFFSET / SPHERE
    # Everything that is offered stands on disk, and the command line writes the same program.
    out = folder / "served" / "runs" / name / "out"
    links = page.locator("#measured .decide .downloads")
    program = one.download(links.get_by_role("link", name="Program", exact=True))
    assert program == (out / "part.nc").read_bytes()
    (tmp_path / "job.toml").write_bytes(one.download(links.get_by_role("link", name="Job", exact=True)))
    # What is not certain of the offset is compensated as form, by a table next to the job.
    table = one.download(links.get_by_role("link", name="Correction", exact=True))
    (tmp_path / "correction.npz").write_bytes(table)
    assert main(["run", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "part.nc").read_bytes() == program
    assert tw.Job.load(tmp_path / "job.toml").tool.offset[0] == pytest.approx(OFFSET, abs=doubt * 1e-3)
    page.get_by_role("button", name="Edit the corrected job").click()
    page.locator("#pill.good").wait_for()


def cone(header, arrays):
    """Return the slope of the cone in a map, without its mean and its paraboloid."""
    z = arrays["values"].astype(float) * 1e-6  # [mm] of nm
    radius = np.hypot(
        *np.meshgrid(*(np.linspace(*header[axis], n) for axis, n in zip("xy", z.shape[::-1], strict=True)))
    )
    known = np.isfinite(z)
    rows = np.stack([np.ones(known.sum()), radius[known] ** 2, radius[known]], axis=1)
    return np.linalg.lstsq(rows, z[known])[0][2]


# --------------------------------------------------------------------------------------------- hands, eyes and screens


@pytest.mark.usefixtures("done")
def test_everything_is_reached_by_keys(bench):
    one = bench(scene=True).look_at("run")
    page = one.page
    page.locator("#panel-maps canvas.mapcanvas").wait_for()
    page.get_by_role("button", name="Edit this job").click()
    page.locator("#field-tool-nose_radius").wait_for()
    page.get_by_label("Position of the tool on the finishing path").wait_for()
    reached = []
    # The first round begins anywhere, and past its end is the browser itself.
    while [at["name"] for at in reached].count("Skip to the job") < 2:
        page.keyboard.press("Tab")
        reached.append(page.evaluate(FOCUSED))
        assert len(reached) < 400
    names = [at["name"] for at in reached]
    reached = [at for at in reached[names.index("Skip to the job") : -1] if at["name"]]
    names = [at["name"] for at in reached]
    wanted = [
        "examples", "Open a job file", "run", "field-tool-nose_radius", "Colour the part by",
        "Position of the tool on the finishing path", "Delete dish", "tab-maps",
    ]  # fmt: skip
    places = [next((at for at, name in enumerate(names) if name.startswith(one)), None) for one in wanted]
    assert None not in places, (wanted, names)
    assert places == sorted(places)
    assert [at["name"] for at in reached if not at["marked"]] == []
    page.evaluate("document.activeElement.blur()")
    for key, panel in enumerate(PANELS, 1):
        page.keyboard.press(str(key))
        expect(page.locator(f"#panel-{panel}")).to_be_visible()
        expect(page.locator(f"#tab-{panel}")).to_have_attribute("aria-selected", "true")
    page.keyboard.press("Escape")
    expect(page.locator("#panel-measure")).to_be_hidden()


FOCUSED = """() => {
  const at = document.activeElement;
  if (!at || at === document.body) return {name: ""};
  const look = () => {
    const {outline, boxShadow, backgroundColor, borderColor} = getComputedStyle(at);
    return [outline, boxShadow, backgroundColor, borderColor].join();
  };
  const focused = look();
  at.blur();
  const marked = look() !== focused;
  at.focus();
  return {name: at.id || at.getAttribute('aria-label') || at.labels?.[0]?.textContent || at.textContent.trim(), marked};
}"""


@pytest.mark.usefixtures("done")
def test_a_map_is_worked_by_keys_alone(bench):
    one = bench().look_at("run")
    page = one.page
    one.drawn("#panel-maps canvas.mapcanvas", colours=60)
    page.locator("#panel-maps canvas.mapcanvas").focus()
    first = zoomed(one, lambda: [page.keyboard.press("+") for _ in range(8)])[0]
    then = zoomed(one, lambda: [page.keyboard.press("+") for _ in range(4)])[0]
    assert then == pytest.approx(0.8**4 * first, rel=1e-6)
    one.answer("/profile", lambda: page.keyboard.press("l"))


def test_the_part_is_requested_first_and_once(bench):
    one = bench(scene=True)
    page = one.page
    page.locator("#scene canvas").first.wait_for(state="attached")  # what this first page asks for is not to be held
    asked, held = [], []
    page.on("request", lambda request: asked.append(urlsplit(request.url).path))
    page.route("**/scene.js", lambda route: held.append(route))  # noqa: PLW0108 - its parameters are read
    page.reload()
    offered = page.locator("#welcome .examples button")
    offered.first.wait_for()
    wait(lambda: page.title() and held, what="the scene, which comes unasked")
    with page.expect_response("**/api/view/surface"):
        offered.filter(has_text="sinusoidal grid").first.click()
    expect(page.locator("canvas.scene")).to_have_count(0)
    held[0].continue_()
    one.drawn("canvas.scene", colours=1500)
    expect(page.locator("#verdict")).to_have_class("card verdict good")
    questions = [path for path in asked if path in ("/api/view/surface", "/api/job/check")]
    assert questions == ["/api/view/surface", "/api/job/check"]


def test_an_opened_example_takes_the_focus_to_the_job(bench):
    one = bench()
    one.page.locator("#welcome .examples button").filter(has_text="sinusoidal grid").first.click()
    expect(one.page.locator("#left")).to_be_focused()


PHONE = (390, 844)
COVERED = """(id) => {
  const {left, top, right, bottom} = document.getElementById(id).getBoundingClientRect();
  return left < 0 || top < 0 || right > innerWidth || bottom > innerHeight
    || document.elementFromPoint((left + right) / 2, (top + bottom) / 2)?.closest(`#${id}`) === null;
}"""


@pytest.mark.usefixtures("done", "measured")
def test_a_phone_shows_one_pane_at_a_time_with_run_in_reach(bench, by_hand):
    one = bench(size=PHONE, touch=True, scene=True).take(by_hand.parent / "job.toml")
    page = one.page
    panes = {"Job": "left", "Scene": "middle", "Results": "right", "Maps": "drawer"}
    for name, pane in panes.items():
        page.get_by_role("navigation", name="Panes").get_by_role("button", name=name, exact=True).click()
        for other in panes.values():
            (
                expect(page.locator(f"#{other}")).to_be_visible
                if other == pane
                else expect(page.locator(f"#{other}")).to_be_hidden
            )()
        assert not page.evaluate(COVERED, "run")
        assert page.evaluate(BEYOND) == []
    # A tab that is open already stays so: there is nothing else to see in its pane.
    page.locator("#tab-maps").click()
    expect(page.locator("#panel-maps")).to_be_visible()
    one.look_at("run")
    expect(page.locator("#right")).to_be_visible()
    assert not page.evaluate(COVERED, "run")


HARD = {"critical", "serious"}
LOOKS = [
    pytest.param({}, id="light"),
    pytest.param({"dark": True}, id="dark", marks=pytest.mark.proof),
    pytest.param({"size": PHONE, "touch": True}, id="phone", marks=pytest.mark.proof),
]


def barriers(page, state, within="html"):
    """Return what axe-core calls critical or serious for those who use the page, or a part of it, by other means."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(Axe().axe_script)
    broken = page.evaluate("within => axe.run(within, {resultTypes: ['violations']})", within)["violations"]
    return [(state, one["id"], one["nodes"][0]["html"][-200:]) for one in broken if one["impact"] in HARD]


@pytest.mark.parametrize("how", LOOKS)
@pytest.mark.usefixtures("done", "compared", "measured")
def test_no_state_has_a_barrier(bench, by_hand, how):
    # Oracle: axe-core.
    one = bench(**how, scene=True)
    page = one.page
    found = barriers(page, "empty")
    one.take(by_hand.parent / "job.toml")
    found += barriers(page, "job")
    for kind in ("run", "compare", "measure"):
        one.look_at(kind)
        found += barriers(page, kind)
        for key, panel in enumerate(PANELS, 1):
            if not how and kind not in ("run", panel):
                continue  # what another kind of run has nothing to show of; make proof looks at it in both other ways
            page.keyboard.press(str(key))
            expect(page.locator(f"#panel-{panel}")).to_be_visible()
            one.rest()
            found += barriers(page, f"{kind}, {panel}", "html" if how else "#drawer")  # all else is as before
    page.keyboard.press("?")
    found += barriers(page, "help")
    assert found == []


def test_help_of_a_field_shows_its_drawing(desk, by_hand):
    # Oracle: the size that the drawings state, and axe-core.
    page = desk.take(by_hand.parent / "job.toml").page
    page.locator("#field-tool-nose_radius").focus()
    page.get_by_role("button", name=re.compile("^Enlarge: ")).click()
    dialog = page.get_by_role("dialog")
    wait(lambda: dialog.locator("img").evaluate("image => image.naturalWidth") == 720, what="the drawing")
    assert barriers(page, "drawing") == []
    page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    page.locator("#field-part-name").focus()
    expect(page.get_by_role("button", name=re.compile("^Enlarge: "))).to_have_count(0)


@pytest.mark.parametrize("how", LOOKS)
def test_a_job_with_an_error_or_under_check_has_no_barrier(bench, by_hand, how):
    # Oracle: axe-core.
    one = bench(**how).take(by_hand.parent / "job.toml")
    page, held = one.page, []
    box = page.locator("#field-tool-included")
    box.fill("60 degrees")
    page.locator("#pill").filter(has_text="to correct").wait_for()
    found = barriers(page, "error")
    if "size" in how:
        page.get_by_role("navigation", name="Panes").get_by_role("button", name="Results", exact=True).click()
    page.get_by_role("tab", name="Plan").click()
    expect(page.locator(".cards.stale")).to_be_visible()
    found += barriers(page, "plan of a job with an error")
    if "size" in how:
        page.get_by_role("navigation", name="Panes").get_by_role("button", name="Job", exact=True).click()
    page.route("**/api/job/check", lambda route: held.append(route))  # noqa: PLW0108 - playwright marks the function
    box.fill("61 deg")
    expect(page.locator("#pill.waiting")).to_be_visible()
    found += barriers(page, "checking")
    for route in held:
        route.continue_()
    page.unroute("**/api/job/check")
    expect(page.locator("#pill.waiting")).to_be_hidden()
    assert found == []


def test_light_and_dark_follow_the_system_and_the_switch(bench):
    for dark in (False, True):
        one = bench(dark=dark)
        page = one.page
        message = pixels(one.png()).mean()
        assert (message < 100) == dark
        assert (message > 180) != dark
        page.keyboard.press("t")
        wait(lambda: (pixels(one.png()).mean() < 100) != dark, what="the other scheme")  # noqa: B023
        page.reload()
        page.locator("#welcome .examples button").first.wait_for()
        assert (pixels(one.png()).mean() < 100) != dark  # what was chosen is kept


@pytest.mark.usefixtures("done")
def test_two_fingers_zoom_a_map(bench):
    one = bench(touch=True).look_at("run")
    page = one.page
    one.drawn("#panel-maps canvas.mapcanvas", colours=60)
    box = page.locator("#panel-maps canvas.mapcanvas").bounding_box()
    middle = box["x"] + 0.6 * box["width"], box["y"] + 0.45 * box["height"]
    hands = one.context.new_cdp_session(page)

    def pinch(first, last):
        for kind, apart in (
            ("touchStart", first),
            *(("touchMove", first + (last - first) * at / 5) for at in range(1, 6)),
        ):
            fingers = [{"x": middle[0] + side * apart, "y": middle[1], "id": one} for one, side in enumerate((-1, 1))]
            hands.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})
        hands.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    pinch(20, 100)  # what is stored is fine enough so far
    first = zoomed(one, lambda: pinch(20, 60))[0]
    assert zoomed(one, lambda: pinch(20, 60))[0] == pytest.approx(first / 3, rel=0.02)


@pytest.mark.parametrize(
    "size",
    [pytest.param((1280, 800), id="desk", marks=pytest.mark.proof), pytest.param((1024, 768), id="tablet")],
)
@pytest.mark.usefixtures("done", "compared", "measured")
def test_nothing_needs_to_be_scrolled_sideways(bench, size):
    one = bench(size=size, scene=True)
    page = one.page
    wide = {"empty": page.evaluate(BEYOND)}
    for kind in ("run", "compare", "measure"):
        one.look_at(kind)
        for key, panel in enumerate(PANELS, 1):
            page.keyboard.press(str(key))
            expect(page.locator(f"#panel-{panel}")).to_be_visible()
            wide[f"{kind}, {panel}"] = page.evaluate(BEYOND)
    assert {state: found for state, found in wide.items() if found} == {}


BEYOND = """() => [document.scrollingElement, ...document.querySelectorAll('.scroll, .pane, [role=tabpanel], table')]
  .filter((one) => one.scrollWidth > one.clientWidth + 1 && one.clientWidth > 0)
  .map((one) => `${one.tagName} ${one.id} ${one.className}: ${one.scrollWidth} of ${one.clientWidth}`)"""


# ------------------------------------------------------------------------------------------------------------ pictures


@pytest.mark.skipif("TURNWRIGHT_SCREENSHOTS" not in os.environ, reason="make screenshots takes them")
def test_every_state_of_an_example_has_its_picture(chrome, tmp_path):
    """Those that docs and README show, each by day and by night."""
    shown = Path(os.environ["TURNWRIGHT_SCREENSHOTS"])
    shown.mkdir(parents=True, exist_ok=True)
    named = ("part.name", "concave mirror"), ("strategy.feed", "5 um/rev")
    mirror = written(tmp_path, *DISH, *named)
    with serving(tmp_path / "served") as address:
        one = Bench(chrome, address, scene=True).open()
        page = one.page

        def keep(state):
            for scheme, png in both_schemes(one).items():
                (shown / f"{state}-{scheme}.png").write_bytes(smaller(png))

        page.get_by_text("No job yet.").wait_for()
        keep("empty")
        one.take(EXAMPLES / "li2018_sine_grid.toml")
        one.drawn("canvas.scene", colours=1000)
        page.locator("#pill.good").wait_for()
        keep("planned")
        page.locator("#run").click()
        page.locator("#outcome").wait_for()
        page.locator("#outcome", has_text="Simulating the finishing pass").wait_for(state="hidden")
        show_cut(one)
        keep("cut")
        page.get_by_role("button", name="Compare", exact=True).click()
        page.locator("svg.pareto").wait_for()
        keep("compared")
        bring_back(one, mirror, tmp_path / "mirror.x3p", keep)
        begin_long(one, EXAMPLES / "infrared_lens.toml")
        keep("running")
        one.close()


@pytest.mark.proof
@pytest.mark.usefixtures("done", "compared", "measured")
def test_every_state_has_its_picture(bench, by_hand, tmp_path):
    """Each by day and by night, of what is carried out already."""
    one = bench(scene=True)
    pictures = {}

    def keep(state):
        pictures[state] = both_schemes(one)

    keep("empty")
    one.take(by_hand.parent / "job.toml")
    one.drawn("canvas.scene", colours=1000)
    one.page.locator("#pill.good").wait_for()
    keep("planned")
    one.look_at("run")
    show_cut(one)
    keep("cut")
    one.look_at("compare")
    keep("compared")
    one.look_at("measure")
    one.page.keyboard.press("6")
    one.drawn("#measured canvas.mapcanvas", colours=60)
    keep("measured")
    begin_long(one, written(tmp_path, *LONG))
    keep("running")
    one.page.get_by_role("button", name="Cancel long").click()
    expect(one.page.locator(".run", has_text="long").first).to_have_attribute("data-state", "cancelled")
    assert list(pictures) == ["empty", "planned", "cut", "compared", "measured", "running"]


def show_cut(one):
    """Show the last map of what is cut, and a profile across it."""
    choice = one.page.get_by_label("Map", exact=True)
    expect(choice.locator("option")).not_to_have_count(0)
    choice.select_option(index=min(1, choice.locator("option").count() - 1))
    one.drawn("#panel-maps canvas.mapcanvas", colours=60)
    one.answer("/profile", lambda: one.page.locator("#panel-maps canvas.mapcanvas").press("l"))


def begin_long(one, job):
    """Begin a long run, until it tells how far it is."""
    one.page.keyboard.press("0")
    one.page.keyboard.press("Escape")
    one.take(job)
    one.page.locator("#run").click()
    going = one.page.locator(".run[data-state=running] .progress [role=status]")
    wait(lambda: figures(going.inner_text()), what="progress")


def bring_back(one, job, file, keep):
    """Run a job, measure its part, and correct what is found."""
    page = one.page
    one.take(job)
    page.locator("#run").click()
    page.locator("#outcome", has_text="concave mirror").wait_for()
    page.keyboard.press("6")
    page.keyboard.press("0")
    with page.expect_file_chooser() as chosen:
        page.get_by_role("button", name="Choose a file").click()
    chosen.value.set_files(instrument(job, file))
    page.locator("#measured .error-source").first.wait_for()
    one.drawn("#measured canvas.mapcanvas", colours=60)
    keep("measured")
    page.locator("#correct").click()
    page.get_by_role("tab", name="After correction").click()
    one.drawn("#measured canvas.mapcanvas", colours=60)
    page.locator("#measured .decide .downloads").wait_for()
    keep("diagnosed")


def both_schemes(one):
    """Return pictures of the page as it stands, light and dark."""
    found = {}
    for _ in range(2):
        scheme = one.page.evaluate("document.documentElement.dataset.theme")
        found[scheme] = one.settled()
        one.page.keyboard.press("t")
    assert pixels(found["light"]).mean() > 180
    assert pixels(found["dark"]).mean() < 100
    assert min(map(colours_of, found.values())) > 200
    return found


def instrument(job, file):
    """Write what an instrument sees of a job that was cut with a tool offset."""
    recipe = tw.Job.load(job)
    part, tool, servo = recipe.part.aimed, recipe.tool, recipe.servo(recipe.passes[-1])
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, recipe.machine)
    axis = np.linspace(-part.radius, part.radius, 301)
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) < 0.98 * part.radius
    z = np.full(x.shape, np.nan)
    actual = replace(tool, offset=(OFFSET, 0.0, 0.0))
    z[inside] = tw.generate_points(motion, actual, x=x[inside], y=y[inside])
    z += 2e-6 * np.random.default_rng(5).normal(size=z.shape)
    tw.write_map(tw.HeightMap(x=axis, y=axis, z=z, name="part"), file)
    return file
