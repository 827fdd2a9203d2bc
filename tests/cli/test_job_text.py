"""A job keeps a person's remarks and layout when a field of it is changed. Oracles: tomllib, and the text itself."""

import copy
import difflib
import random
import tomllib

import pytest

pytest.importorskip("fastapi", reason="the workbench is an extra: pip install 'turnwright[web]'")

from turnwright.job.text import as_tables, write_job
from turnwright.web.examples import examples
from turnwright.web.queue import Runs
from turnwright.web.references import text_in

HAND = """\
# A dish for the printer.

[part]
name = "dish"   # as on the drawing
radius = "1 mm"
surface = [
    {family = "sphere", radius = "50 mm"},  # the base
    # a ripple
    {family = "sine grid", amplitude = ["10 nm", "10 nm"], period = ["1 mm", "1 mm"]},
]

[tool] # from the drawer
nose_radius = '0.5 mm'      # certified
waviness = [
  "1 nm/rad",  # c1
  "2 nm/rad^2",
]

# How it is cut
[strategy]
kind = "slow tool servo"
feed = "20 um/rev"
points_per_rev = 1_200
#spindle_speed = "50 rpm"

[[passes]]
name = "rough" # first

# the last
[[passes]]
name = "finish"

[simulation]
whole_part.radii = 41
whole_part.angles = 24 # few
"""


def lines_changed(before, after):
    """Return the lines that a text has lost, and those that it has gained."""
    report = list(difflib.ndiff(before.splitlines(), after.splitlines()))
    return [one[2:] for one in report if one[0] == "-"], [one[2:] for one in report if one[0] == "+"]


def edited(text, place, value):
    job = as_tables(tomllib.loads(text))
    *above, last = place
    table = job
    for key in above:
        table = table[key]
    if value is None:
        del table[last]
    else:
        table[last] = value
    return job


EDITS = {
    "a value": (
        ("tool", "nose_radius"), "0.4 mm",
        ["nose_radius = '0.5 mm'      # certified"], ['nose_radius = "0.4 mm"      # certified'],
    ),
    "a number": (("strategy", "points_per_rev"), 360, ["points_per_rev = 1_200"], ["points_per_rev = 360"]),
    "one of a list": (("tool", "waviness", 0), "3 nm/rad", ['  "1 nm/rad",  # c1'], ['  "3 nm/rad",  # c1']),
    "a term of a sum in its short form": (
        ("part", "surface", "terms", 0, "radius"), "60 mm",
        ['    {family = "sphere", radius = "50 mm"},  # the base'],
        ['    {family = "sphere", radius = "60 mm"},  # the base'],
    ),
    "a key of several words": (
        ("simulation", "whole_part", "angles"), 48, ["whole_part.angles = 24 # few"], ["whole_part.angles = 48 # few"]
    ),
    "a table of a list": (("passes", 1, "name"), "last", ['name = "finish"'], ['name = "last"']),
    "a key that goes": (("strategy", "feed"), None, ['feed = "20 um/rev"'], []),
    "a key that comes": (("part", "stock"), "5 um", [], ['stock = "5 um"']),
}  # fmt: skip


@pytest.mark.parametrize("edit", EDITS)
def test_a_change_touches_its_own_line_alone(edit):
    place, value, lost, gained = EDITS[edit]
    job = edited(HAND, place, value)
    text = write_job(job, HAND)
    assert as_tables(tomllib.loads(text)) == job
    assert lines_changed(HAND, text) == (lost, gained)


def test_an_unchanged_job_is_the_text_itself():
    for text in (HAND, *(one.toml for one in examples().values())):
        assert write_job(as_tables(tomllib.loads(text)), text) == text
        assert write_job({**as_tables(tomllib.loads(text)), "nothing": None}, text) == text
    # A page does not tell whole numbers from others.
    assert write_job({"a": {"b": 1.0}}, "[a]\nb = 1 # one\n") == "[a]\nb = 1 # one\n"
    assert write_job({"a": {"b": True}}, "[a]\nb = 1 # one\n") == "[a]\nb = true # one\n"


def test_what_cannot_be_changed_in_place_is_still_the_job():
    job = as_tables(tomllib.loads(HAND))
    job["simulation"]["whole_part"]["deep"] = {"er": [1]}  # below a key of several words
    text = write_job(job, HAND)
    assert as_tables(tomllib.loads(text)) == job
    assert "# certified" in text
    twice = ("[a]\nb = 1\nb = 2\n", "a = {b = 1, b = 2}\n", "[a]\nb = 1\n[a.b]\n")
    for broken in ("[part", "\ufeff" + HAND, "a = 1\n" * 2, *twice):
        assert as_tables(tomllib.loads(write_job(job, broken))) == job
    assert "# certified" in write_job(job, "\ufeff" + HAND)


def test_a_run_keeps_a_text_with_the_ends_of_lines_that_it_has(tmp_path):
    """Oracle: the bytes."""
    runs = Runs(tmp_path, at_a_time=0)
    text = HAND.replace("\n", "\r\n")
    assert write_job(as_tables(tomllib.loads(HAND)), text) == text
    with runs.new_folder() as folder:
        run = runs.add(folder, {}, kind="run", name="", text=text)
    assert runs.text(run) == text_in(runs.folder_of(run)) == text
    assert (runs.folder_of(run) / "job.toml").read_bytes() == text.encode()


def places(value, at=()):
    for key, one in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield (*at, key)
        yield from places(one, (*at, key))


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(one, marks=pytest.mark.proof) for one in range(8, 40))])
def test_whatever_is_changed_the_text_says_the_job(seed):
    chance = random.Random(seed)  # noqa: S311 - edits, not secrets
    text = chance.choice([HAND, *(one.toml for one in examples().values())])
    job = as_tables(tomllib.loads(text))
    for _ in range(8):
        job = copy.deepcopy(job)
        *above, last = chance.choice(list(places(job)))
        table = job
        for key in above:
            table = table[key]
        act = chance.randrange(4)
        if act == 0:
            del table[last]
        elif isinstance(table, list) and act == 1:
            table.insert(chance.randrange(len(table) + 1), copy.deepcopy(chance.choice(table)))
        elif isinstance(table, list) and act == 2:
            chance.shuffle(table)
        else:
            table[last] = chance.choice(["7 mm", 3, 2.5, True, ["1 mm", "2 mm"], {"a": {"b": "2 mm"}}, [{"c": 1}]])
        if not job:
            break
        text = write_job(job, text)
        assert as_tables(tomllib.loads(text)) == as_tables(job)
