"""Dialects are files of words: what they write reads back, and what is wrong in one is a sentence."""

from dataclasses import replace

import pytest

from turnwright.cli import main
from turnwright.errors import InputError, ProgramError
from turnwright.machine import Axis, Controller, Machine
from turnwright.post import Dialect, check_dialect, dialect_of

WORKSHOP = """
name = "workshop"
wrapped = false
feed = "seconds"
feed_decimals = 7
feed_every_block = true
block = "G01 "
setup = ["G71 G90"]
call = "M98({file})"
max_lines = 500_000

[decimals]
C = 4
X = 5
Z = 6

[sources]
call = "assumed"
"""

MACHINE = """
base = "generic"
dialect = "workshop.toml"
"""


def lathe(dialect):
    interpolation = Dialect.load(dialect).interpolation
    return Machine(
        name="lathe", axes=dict.fromkeys("CXYZ", Axis()), spindle_rpm=1000, block_rate_hz=1000, dialect=dialect,
        controller=Controller(interpolation=interpolation),
    )  # fmt: skip


@pytest.fixture
def workshop(tmp_path):
    path = tmp_path / "workshop.toml"
    path.write_text(WORKSHOP)
    return str(path)


@pytest.mark.parametrize("name", Dialect.known())
def test_supplied_dialects_read_back_what_they_write(name):
    done = check_dialect(name)
    assert done.dialect.name == name
    for letter, difference in done.differences.items():
        assert difference <= 0.5001 * 10.0 ** -done.dialect.decimals[letter] + 1e-9
    assert set(done.differences) == set(done.dialect.decimals)


def test_a_dialect_of_the_shop_reads_back_what_it_writes(workshop):
    done = check_dialect(workshop)
    assert set(done.differences) == set("CXZ")
    assert done.programs == 4
    assert 1e-5 < done.differences["C"] < 5.1e-5  # its four decimals are used
    assert done.lines[0] == "G93"
    assert done.lines[1].startswith("G01 C")


def test_a_machine_file_names_a_dialect_file_beside_it(tmp_path, workshop):
    (tmp_path / "lathe.toml").write_text(MACHINE)
    assert dialect_of(Machine.load(tmp_path / "lathe.toml")) == Dialect.load(workshop)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('feed = "seconds"', 'feed = "hours"', "feed is 'hours', it must be 'seconds'"),
        ("C = 4", "C = 14", "decimals.C is 14, the limits are 0 and 9"),
        ("C = 4", "U = 4", "decimals has 'U, X, Z', it needs C, X and Z"),
        ("({file})", "({folder})", "call has 'folder' in braces, the names allowed are file"),
        ("({file})", "({file", "braces do not match"),
        ("({file})", "({file:>999999999})", "call has 'file' in braces"),
        ("({file})", "({file.__class__})", "call has 'file.__class__' in braces"),
        ('block = "G01 "', 'block = "G01\\n"', "printable ASCII"),
        ('name = "workshop"', 'name = "work shop"', "letters, digits, - and _ are allowed"),
        ("500_000", "50", "max_lines is 50, it must be at least 100"),
        ("wrapped = false", "wrapped = false\nvelocities = true", "milliseconds go with velocities"),
        ('call = "M98({file})"', "always_call = true", "always_call is true and call is empty"),
        ("wrapped = false", "wraped = false", "did you mean 'wrapped'"),
        ('call = "assumed"', "speed = 3", "sources"),
    ],
)
def test_a_wrong_dialect_file_is_refused_in_a_sentence(tmp_path, old, new, message):
    path = tmp_path / "workshop.toml"
    assert old in WORKSHOP
    path.write_text(WORKSHOP.replace(old, new))
    with pytest.raises(InputError) as error:
        Dialect.load(str(path))
    assert message in str(error.value)
    assert len(str(error.value)) < 400 + len(str(path))


def test_a_machine_with_an_unknown_dialect_is_refused():
    with pytest.raises(ProgramError, match="machine lathe: dialect 'nix' is not known"):
        dialect_of(replace(lathe("generic"), dialect="nix"))


def test_velocities_need_cubic_interpolation():
    with pytest.raises(ProgramError, match="needs the interpolation hermite"):
        dialect_of(replace(lathe("generic"), dialect="pmac"))


def test_the_command_checks_a_dialect(workshop, capsys):
    assert main(["post", "check", workshop]) == 0
    text = capsys.readouterr().out
    assert "4 programs written and read back" in text
    assert "assumed: call" in text
    assert main(["post", "list"]) == 0
    assert capsys.readouterr().out.count("\n") == len(Dialect.known())
    assert main(["post", "check", "nix"]) == 2
