"""The drawings of the documentation: committed as their modules write them, legible, and each on a page."""

import re
from pathlib import Path

import numpy as np
import pytest

from docs.drawings import IMAGES, NAMES, drawn
from docs.drawings.waviness import AMPLITUDE, SLOPE, WAVES, WAVY, contact

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {page: page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md") if "_build" not in page.parts}


def test_exactly_the_drawings_are_committed():
    assert sorted(picture.name for picture in IMAGES.iterdir()) == [f"{name}.svg" for name in NAMES]


@pytest.mark.parametrize("name", NAMES)
def test_drawing_is_what_its_module_writes(name):
    text = (IMAGES / f"{name}.svg").read_text(encoding="utf-8")
    # Not assert ==: the difference of two drawings is thousands of coordinates.
    if drawn(name) != text:
        pytest.fail(f"docs/images/drawings/{name}.svg is not what docs/drawings/{name}.py writes: make drawings")


@pytest.mark.parametrize("name", NAMES)
def test_drawing_is_legible(name):
    text = (IMAGES / f"{name}.svg").read_text(encoding="utf-8")
    assert min(float(size) for size in re.findall(r'font-size[:=]"?([\d.]+)', text)) >= 11
    assert int(re.search(r'width="(\d+)"', text)[1]) <= 720
    assert "prefers-color-scheme:dark" in text


@pytest.mark.parametrize("name", NAMES)
def test_drawing_is_on_a_page(name):
    shown = [page for page, text in PAGES.items() if f"images/drawings/{name}.svg" in text]
    assert shown
    for page in shown:
        for target in re.findall(rf"([./\w]*images/drawings/{name}\.svg)", PAGES[page]):
            assert (page.parent / target).is_file()


def test_drawn_contact_of_the_wavy_edge_follows_its_formula():
    _, sweep = contact()
    deviation, rate = AMPLITUDE * np.sin(WAVES * sweep), AMPLITUDE * WAVES * np.cos(WAVES * sweep)
    assert sweep == pytest.approx(SLOPE + np.arctan(rate / (WAVY.nose_radius + deviation)), abs=1e-6)
