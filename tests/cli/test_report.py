"""The page of a run: whole, self-contained, escaped, and saying what the result says."""

import dataclasses
import html.parser
import re
from pathlib import Path

import numpy as np
import pytest

from turnwright.heightmap import HeightMap
from turnwright.job import Job, Prediction, predict, run
from turnwright.metrology import roughness
from turnwright.motion import check_limits
from turnwright.report import write_backplot, write_report

SMALL = {
    "part": {
        "surface": {"family": "sphere", "radius": "20 mm"},
        "radius": "1 mm",
        "stock": "10 um",
        "name": '<script>alert("part")</script> & co',
    },
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "nanotech-350fg"},
    "strategy": {"kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 180},
    "passes": [{"name": "rough", "allowance": "2 um"}, {"name": "finish"}],
    "simulation": {
        "whole_part": {"radii": 61, "angles": 72},
        "patches": [{"name": "zone", "centre": ["0.5 mm", "0 mm"], "size": ["80 um", "60 um"], "pixel": "2 um"}],
    },
    "tolerances": {"form_pv": "10 um", "sq": "10 um"},
}


class Reader(html.parser.HTMLParser):
    """Collects what a browser would see: tags that must close, addresses, alternative texts, running text."""

    VOID = frozenset({"meta", "br", "hr", "img", "link", "input"})

    def __init__(self):
        super().__init__()
        self.open, self.addresses, self.pictures, self.text, self.tags = [], [], [], "", set()

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.tags.add(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "xlink:href") and value]
        if named.get("role") == "img":
            self.pictures.append(named["aria-label"])

    def handle_startendtag(self, tag, attrs):
        if tag not in self.VOID:
            self.handle_starttag(tag, attrs)
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag in ("td", "th", "div"):
            self.text += " "

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


def read(page):
    reader = Reader()
    reader.feed(page.read_text(encoding="utf-8"))
    assert reader.open == []
    reader.text = re.sub(r"\s+", " ", reader.text)
    return reader


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return run(Job.read(SMALL), out=folder), folder


@pytest.fixture(scope="module")
def page(small):
    result, folder = small
    return write_report(result, folder)


@pytest.fixture
def unprinted(monkeypatch):
    """Leave out the printing of figures, most of the time of a page, where a test only reads its text."""
    monkeypatch.setattr("turnwright.report.figures._print_svg", lambda _canvas: "<svg></svg>")


def test_the_page_lies_in_the_folder_and_nothing_else_is_left(page, small):
    _, folder = small
    assert page == folder / "report.html"
    assert not list(folder.glob(".*"))
    assert page.stat().st_size < 3e6


def test_the_page_needs_nothing_from_outside(page):
    text = page.read_text(encoding="utf-8")
    assert "http:" not in text
    assert "https:" not in text
    assert "@import" not in text
    assert not re.findall(r"url\((?!#)[^)]*\)", text)
    seen = read(page)
    outside = [one for one in seen.addresses if not one.startswith(("#", "data:image/png;base64,"))]
    # The other files are the programs next to the page.
    assert outside
    assert all((page.parent / one).is_file() for one in outside)
    assert not {"script", "iframe", "link", "object"} & seen.tags


def test_names_from_a_job_are_text_and_not_markup(page):
    text = page.read_text(encoding="utf-8")
    assert "<script" not in text
    assert SMALL["part"]["name"] in read(page).text


@pytest.mark.usefixtures("unprinted")
def test_no_control_character_reaches_the_page(small, tmp_path):
    result, _ = small
    text = write_report(dataclasses.replace(result, warnings=("a \x1b[2J\x00name\x9b",)), tmp_path).read_text(
        encoding="utf-8"
    )
    assert "a [2Jname" in text
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", text)


def test_every_picture_has_its_words_and_every_axis_its_unit(page):
    seen = read(page)
    assert len(seen.pictures) == 13
    assert all(len(words) > 20 for words in seen.pictures)
    labels = re.findall(r"<text[^>]*>([^<]*)</text>", page.read_text(encoding="utf-8"))
    named = [
        label
        for label in labels
        if re.match(r"(x|y|z|X|Z|design|cut|contact|time|spindle|distance|a[lc]\w+ the)", label)
    ]
    assert len(named) >= 20
    assert all(re.search(r"\[(mm|µm|nm|deg|min|s|mm/s)\]$", label) for label in named), named


def test_the_verdict_and_its_three_numbers_come_first(page, small):
    result, _ = small
    text = read(page).text
    zone = result.predictions[1].roughness
    seconds = sum(cut.limits.cycle_time_s for cut in result.passes)
    head = text[: text.index("Part, tool, machine")]
    assert "Ready to cut" in head
    assert f"Form error PV {result.predictions[0].pv_nm:.4g}nm" in head
    assert f"Sq {zone.sq_nm:.4g}nm" in head
    assert f"Cutting time {seconds:.3g}s" in head
    assert all(warning in head for warning in result.warnings)


def test_the_page_says_what_the_result_says(page, small):
    result, _ = small
    text = read(page).text
    for finding in result.access.findings:
        assert finding.name in text
    for cut in result.passes:
        assert f"{cut.points:,} points" in text
    assert f"{result.limits.nearest} is nearest to its limit" in text
    assert result.program.hash in text
    assert 'family = "sphere"' in text
    for stage, seconds in result.timings.items():
        assert f"{stage} {seconds:.2f} s" in text
    for field in ("sa_nm", "sq_nm", "sz_nm", "ssk", "sku"):
        value = getattr(result.predictions[1].roughness, field)
        assert f"{value:.4g}".replace("-", "\u2212") in text, field
    first = result.program.files[0].read_text(encoding="utf-8").splitlines()[0]
    assert first in text


def in_glass(folder, *, critical, ratio=1):
    """The page of the small job in a glass of its own, and what the finishing pass is like."""
    (folder / "glass.toml").write_text(f'name = "glass"\nfracture_ratio = {ratio}\n[critical]\n{critical}\n')
    job = SMALL | {
        "part": SMALL["part"] | {"radius": "0.6 mm", "material": str(folder / "glass.toml")},
        "strategy": SMALL["strategy"] | {"feed": "5 um/rev"},
    }
    result = run(Job.read(job), out=folder)
    return read(write_report(result, folder)).text, result.passes[-1].chips


@pytest.mark.usefixtures("unprinted")
def test_the_chips_of_every_pass_stand_in_a_table(tmp_path):
    text, chips = in_glass(tmp_path, critical='value = "600 nm"')
    thickest = f"{chips.thickest * 1e6:.3g} nm"
    assert f"finish ductile {thickest} 600 nm {100 * (1 - chips.thickest / 600e-6):.0f} %" in text
    assert f"pass finish, up to {thickest}; the critical chip thickness is 600 nm, exceeded nowhere." in text
    assert "rough brittle, removed by later passes" in text
    assert "Effective rake angle: 0° to 0°" in text
    assert "Ready to cut" in text


@pytest.mark.usefixtures("unprinted")
def test_a_margin_inside_its_uncertainty_is_not_ready_to_cut(tmp_path):
    """Where a crack would be twenty times as long as the chip, what cannot be decided may stay."""
    text, chips = in_glass(tmp_path, critical='value = "450 nm"\nuncertainty = "90 nm"', ratio=20)
    margin, band = 100 * (1 - chips.thickest / 450e-6), 100 * 2 * 90 / 450
    assert abs(margin) < band
    assert f"uncertain {chips.thickest * 1e6:.3g} nm 450 nm {margin:.0f} ± {band:.3g} %" in text
    assert "Brittle fracture possible" in text
    assert "ductile regime not certain" in text


@pytest.mark.usefixtures("unprinted")
def test_a_tolerance_that_is_not_kept_is_the_verdict(small, tmp_path):
    result, _ = small
    strict = Job.read(SMALL | {"tolerances": {"form_pv": "1 nm", "sq": "10 um"}})
    text = read(write_report(dataclasses.replace(result, job=strict, warnings=("a b c",)), tmp_path)).text
    head = text[: text.index("Part, tool, machine")]
    assert re.search(r"Not ready whole part: form error PV is [0-9.]+ nm, the tolerance is 1 nm 1 warning", head)
    assert "tolerance 1 nm" in head
    assert "a b c" in head


@pytest.mark.usefixtures("unprinted")
def test_what_the_job_accepts_is_neither_good_nor_bad(small, tmp_path):
    result, _ = small
    findings = (dataclasses.replace(result.access.findings[0], ok=False), *result.access.findings[1:])
    access = dataclasses.replace(result.access, ok=False, findings=findings)
    text = read(
        write_report(dataclasses.replace(result, access=access, findings=findings), tmp_path / "page.html")
    ).text
    assert "Ready with exceptions" in text
    assert "not ok" in text


@pytest.mark.usefixtures("unprinted")
def test_a_program_that_differs_from_its_plan_is_the_verdict(small, tmp_path):
    result, _ = small
    text = read(write_report(dataclasses.replace(result, rounding_nm=9.0, rounding_limit_nm=1.0), tmp_path)).text
    assert "Not ready rounding in the program exceeds its limit" in text


@pytest.mark.usefixtures("unprinted")
def test_programs_that_are_gone_are_named_without_a_link(small, tmp_path):
    result, _ = small
    gone = dataclasses.replace(result.program, files=(Path("/nowhere/gone.nc"),))
    seen = read(write_report(dataclasses.replace(result, program=gone), tmp_path))
    assert "gone.nc" in seen.text
    assert "gone.nc" not in seen.addresses
    assert "First lines" not in seen.text


def test_missing_points_and_large_maps_stay_legible_and_small(small, tmp_path):
    result, _ = small
    x = np.linspace(-0.3, 0.3, 1500)
    z = (
        1e-5 * np.sin(300 * x) * np.cos(200 * x[:, None])
        + np.random.default_rng(1).standard_normal((1500, 1500)) * 1e-6
    )
    z[np.hypot(x, x[:, None]) > 0.25] = np.nan
    large = HeightMap(x=x, y=x, z=z)
    rough = roughness(HeightMap(x=x[::30], y=x[::30], z=z[::30, ::30]))
    nothing = HeightMap(x=x[:9], y=x[:9], z=np.full((9, 9), np.nan))
    more = tuple(Prediction(name=f"zone {n}", error=large, roughness=rough) for n in range(6))
    empty = Prediction(name="empty", error=nothing, roughness=rough)
    shown = dataclasses.replace(result, predictions=(result.predictions[0], empty, *more))
    page = write_report(shown, tmp_path)
    assert page.stat().st_size < 3e6, page.stat().st_size
    text = read(page).text
    assert "zone 3" in text
    assert "2 more maps are in the run folder" in text
    assert "–" in text


def test_the_same_result_makes_the_same_page(page, small, tmp_path):
    # Except for links, which depend on the folder.
    result, _ = small
    again = write_report(result, tmp_path).read_text(encoding="utf-8")
    plain = [re.sub(r"<a href=[^>]*>|</a>", "", text) for text in (again, page.read_text(encoding="utf-8"))]
    assert plain[0] == plain[1]


@pytest.mark.usefixtures("unprinted")
def test_a_page_that_cannot_be_written_leaves_nothing(small, tmp_path):
    result, _ = small
    with pytest.raises(OSError, match="absent"):
        write_report(result, tmp_path / "absent" / "page.html")
    assert not list(tmp_path.iterdir())


def test_a_foreign_program_gets_a_page_without_a_plan(small, tmp_path):
    result, _ = small
    job = Job.read(SMALL)
    motion = result.motion
    limits = check_limits(motion, result.machine)
    seen = read(write_backplot(result.program.files[0], job, motion, limits, predict(job, motion), tmp_path))
    assert f"Back-plot of {result.program.files[0].name}" in seen.text
    assert "Within limits" in seen.text
    assert "Access" not in seen.text
    assert "20 µm/rev" in seen.text
    assert len(seen.pictures) == 9


@pytest.mark.usefixtures("unprinted")
def test_a_foreign_program_beyond_the_machine_says_so(small, tmp_path):
    result, _ = small
    job = Job.read(SMALL)
    slow = dataclasses.replace(result.machine, block_rate_hz=1.0)
    limits = check_limits(result.motion, slow)
    text = read(write_backplot("foreign.nc", job, result.motion, limits, result.predictions, tmp_path / "p.html")).text
    assert "Exceeds a limit a machine limit is exceeded" in text
    assert limits.findings[0] in text
