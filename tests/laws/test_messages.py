"""Messages stay short however long the input is that they show. Oracle: its letters are counted."""

import pickle  # noqa: TID251 - errors travel between processes

import pytest
from pydantic import ValidationError

import turnwright as tw
from turnwright import units
from turnwright._faults import MAX_FAULTS, read_table, sentences, suggestion
from turnwright._io import read_toml
from turnwright._tables import adapter
from turnwright.errors import InputError, JobError, MapError, UnitError
from turnwright.job import Job
from turnwright.material import Lobes


@pytest.mark.parametrize("size", [1, 399, 400, 401, 5688, 45_978, 10**6])
def test_a_long_input_is_cut_in_the_middle(size):
    text = str(MapError(f"the name of the map is {'x' * size!r}, the limit is 30 letters: rename it"))
    assert len(text) <= 400
    assert text.startswith("the name of the map is 'x")
    assert text.endswith("', the limit is 30 letters: rename it")
    assert (" ... " in text) == (size > 400 - 59)


def test_many_lines_are_counted_not_shown():
    text = str(JobError("\n".join(f"field {number} is missing" for number in range(1000))))
    assert text.splitlines()[:19] == [f"field {number} is missing" for number in range(19)]
    assert text.splitlines()[19:] == ["and 981 lines more"]


def test_an_error_keeps_what_python_gives_it():
    error = pickle.loads(pickle.dumps(UnitError("'1 x' has no unit")))  # noqa: S301
    assert isinstance(error, ValueError)
    assert error.args == ("'1 x' has no unit",)
    assert tw.errors.Stopped().args == ()


def test_suggestion_names_the_nearest_key_or_all_keys():
    assert "'feed'" in suggestion("fed", ["feed", "depth"])
    assert "feed, depth" in suggestion("angle", ["feed", "depth"])
    assert "known ones" not in suggestion("angle", [])


@pytest.mark.parametrize(
    ("table", "words"),
    [({"count": 3}, ": amplitude is missing"), (3, " is 3, it must be a table"), ([], " is [], it must be a table")],
)
def test_read_table_names_any_file_not_the_job(table, words):
    with pytest.raises(InputError) as caught:
        read_table(Lobes, table, "lobes.toml")
    assert str(caught.value).startswith(f"lobes.toml{words}")
    assert "job" not in str(caught.value)


def test_sentences_count_the_places_beyond_the_most():
    with pytest.raises(ValidationError) as caught:
        adapter(Lobes).validate_python({f"key {number}": number for number in range(100)})
    *_, last = sentences(caught.value, Lobes, {})
    assert last.startswith(f"{102 - MAX_FAULTS} more keys are wrong")


LONG = {
    "a quantity": lambda: units.parse("1" * 6000 + " mm", "mm"),
    "a list for a quantity": lambda: units.parse(["1 mm"] * 5000, "mm"),
    "a unit": lambda: units.parse("1 mm" + "*mm" * 5000, "mm"),
    "a number without a unit": lambda: units.parse(10**5000, "mm"),
    "a name": lambda: tw.Machine.load("x" * 5000),
    "a job of wrong keys": lambda: Job.read({f"key {number}": number for number in range(5000)}),
    "a job of a long key": lambda: Job.read({"k" * 50_000: 1}),
    "a job of long numbers": lambda: Job.read({"part": {"radius": 10**5000}, "passes": [10**5000] * 300}),
    "a formula": lambda: tw.Expression("(" * 2000 + "nonsense" * 500),
    "a formula that steps": lambda: tw.Expression("phi+" + "+".join(["x"] * 1500)),
    "a formula without a height": lambda: tw.Expression("log(x)+" + "+".join(["x"] * 1500)).sag(-1.0, 0.0),
}


@pytest.mark.parametrize("name", LONG)
def test_no_refusal_fills_the_screen(name):
    with pytest.raises(InputError) as caught:
        LONG[name]()
    lines = str(caught.value).splitlines()
    assert len(lines) <= 20
    assert max(map(len, lines)) <= 400


@pytest.mark.parametrize("number", ["1" * 5000, "0x" + "f" * 4400, "[[1, [0b" + "1" * 20_000 + "]]]"])
def test_a_number_of_thousands_of_digits_is_refused(number):
    with pytest.raises(InputError, match="the file holds a whole number of thousands of digits"):
        read_toml(f"a = {number}".encode(), "the file")


def test_a_large_toml_text_is_refused_before_it_is_read():
    with pytest.raises(InputError, match=r"the job has 7,340,036 bytes, the limit is 1,048,576"):
        read_toml(b"a=1\n" + b"\n" * (7 << 20), "the job")


def test_job_of_too_many_values_is_refused_at_once():
    with pytest.raises(JobError, match=r"^a job can have at most 100,000 values"):
        Job.read({"passes": [1] * 4_000_000})
