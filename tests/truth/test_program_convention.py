"""What stands in the file, against an independent reading of it with regular expressions and decimals."""

import re
from dataclasses import replace
from decimal import Decimal
from itertools import product

import numpy as np
import pytest

from turnwright.machine import Axis, Convention, Machine
from turnwright.path import Motion
from turnwright.post import read_nc, write_nc

SIDES = list(product((1, -1), (1, -1), (1, -1), (0.0, 1.234)))


def machine(dialect, x_side=1, c_sense=1, z_sign=1, clocking=0.0):
    return Machine(
        name="lathe",
        axes={letter: Axis() for letter in "CXYZ"},
        spindle_rpm=1000,
        block_rate_hz=1000,
        dialect=dialect,
        convention=Convention(x_side=x_side, c_sense=c_sense, z_sign=z_sign, clocking=clocking),
    )


def part(x, y):
    """A part with no symmetry at all: every mix-up of sense, side or clocking changes a height."""
    return 0.01 * x + 0.02 * y + 0.003 * x * x - 0.001 * x * y + 0.0007 * y**3


def motion(lathe, sense=1, count=700):
    angle = sense * np.arange(count) * np.deg2rad(1.7) + 0.3
    radius = 6 - 5.5 * np.arange(count) / count
    return Motion(
        time=np.arange(count) * 0.002,
        axes={"C": angle, "X": radius, "Z": part(radius * np.cos(angle), radius * np.sin(angle))},
        machine=lathe,
    )


def words(path):
    """Numbers of the cutting blocks, as the controller sees them, with an independent reader."""
    blocks = []
    for line in path.read_text().split("\nG93\n")[-1].splitlines():
        bare = re.sub(r"\(.*?\)", "", line)
        found = {letter: Decimal(number) for letter, number in re.findall(r"([CXYZ])(-?\d+\.\d+)", bare)}
        if len(found) >= 3 and "C" in found:
            blocks.append(found)
    return blocks


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
@pytest.mark.parametrize("sides", SIDES)
def test_controller_words_recombine_to_the_part(tmp_path, dialect, sides, sense):
    x_side, c_sense, z_sign, clocking = sides
    lathe = machine(dialect, *sides)
    path = tmp_path / "part.nc"
    write_nc(motion(lathe, sense, 200), lathe, path)
    blocks = words(path if dialect == "generic" else tmp_path / "part.finish.001.nc")
    assert len(blocks) == 199
    for block in blocks:
        # By the declared convention alone: azimuth of the part under the tool, distance from the axis, height.
        azimuth = c_sense * (np.deg2rad(float(block["C"])) - clocking)
        x, z = x_side * float(block["X"]), z_sign * float(block["Z"])
        assert z == pytest.approx(part(x * np.cos(azimuth), x * np.sin(azimuth)), abs=1.5e-6)
    turn = blocks[1]["C"] - blocks[0]["C"]
    assert np.sign(float(turn)) == sense * c_sense


def test_formats_of_the_two_dialects(tmp_path):
    for dialect, pattern, name in (
        ("nanotech", r"C\d{1,3}\.\d{5} X-?\d+\.\d{6} Z-?\d+\.\d{6}( F\d+(\.\d+)?)?", "part.finish.001.nc"),
        ("generic", r"G1 X-?\d+\.\d{6} Z-?\d+\.\d{6} C-?\d+\.\d{6} F\d+(\.\d+)?", "part.nc"),
    ):
        lathe = machine(dialect)
        write_nc(motion(lathe), lathe, tmp_path / "part.nc")
        text = (tmp_path / name).read_text()
        cut = text.split("G93\n")[-1].split("\nG94")[0].splitlines()
        assert len(cut) == 699
        assert all(re.fullmatch(pattern, line) for line in cut)
        assert sum(" F" in line for line in cut) == (1 if dialect == "nanotech" else 699)
        assert "-0.000000" not in text
        assert not re.search(r"\d[eE][-+\d]", re.sub(r"\(.*?\)", "", text))


def test_tiny_negative_heights_have_no_sign(tmp_path):
    lathe = machine("nanotech")
    angle = np.arange(5) * 0.1
    flat = Motion(time=np.arange(5.0), axes={"C": angle, "X": np.full(5, -1e-9), "Z": np.full(5, -4e-7)}, machine=lathe)
    write_nc(flat, lathe, tmp_path / "part.nc")
    assert "-0.000000" not in (tmp_path / "part.finish.001.nc").read_text()


@pytest.mark.parametrize("z_sign", [1, -1])
def test_tool_comes_and_goes_above_the_part(tmp_path, z_sign):
    lathe = machine("generic", z_sign=z_sign)
    cut = motion(lathe)
    write_nc(cut, lathe, tmp_path / "part.nc", clearance=3.0)
    before, _, after = (tmp_path / "part.nc").read_text().rpartition("G93\n")
    heights = [z_sign * float(z) for z in re.findall(r"^G1 Z(-?[\d.]+)", before, re.MULTILINE)]
    assert heights[0] == pytest.approx(cut.axes["Z"].max() + 3.0, abs=1e-6)
    assert heights == sorted(heights, reverse=True)
    assert heights[-1] == pytest.approx(cut.axes["Z"][0] + 0.1, abs=1e-6)  # and from there on C turns
    assert before.index(f"Z{z_sign * heights[0]:.6f}") < before.index("G1 X") < before.index("G0 C")
    last = re.findall(r"^G1 Z(-?[\d.]+)", after.split("G94\n")[1], re.MULTILINE)
    assert z_sign * float(last[0]) == pytest.approx(heights[0], abs=1e-6)


@pytest.mark.parametrize("dialect", ["generic", "pmac", "nanotech"])
def test_the_header_says_where_c_must_stand_after_a_stop(tmp_path, dialect):
    """Oracle: the C words of the approaches themselves; the second pass begins turns beyond the first."""
    lathe = machine(dialect)
    if dialect == "pmac":  # which asks for cubics
        lathe = replace(lathe, controller=replace(lathe.controller, interpolation="hermite"))
    one = motion(lathe)
    files = write_nc({"rough": one, "finish": one}, lathe, tmp_path / "part.nc").files
    head = [row.strip("; ") for row in files[0].read_text().splitlines() if row.strip("; ").startswith("(")]
    stop = " ".join(row for row in head if row.startswith("( AFTER A STOP"))
    assert "RETRACT IN Z FIRST" in stop
    assert ("SET C" in stop) == (dialect != "nanotech")
    if dialect == "nanotech":  # which turns C the short way
        return
    report = [re.search(r"^\( APPROACH \w+: BEGINS AT (C-?[\d.]+) \)$", row) for row in head]
    report = [found[1] for found in report if found]
    rapids = re.findall(r"(?:G0|RAPID|rapid)\s*(C-?[\d.]+)", files[0].read_text(), re.IGNORECASE)
    assert report == rapids
    assert abs(float(report[1][1:]) - float(report[0][1:])) > 360


@pytest.mark.parametrize(("sense", "words_of_it"), [(1, "CLOCKWISE, AS M04"), (-1, "COUNTER-CLOCKWISE, AS M03")])
@pytest.mark.parametrize("c_sense", [1, -1])
def test_header_says_how_the_part_turns(tmp_path, sense, c_sense, words_of_it):
    """If the azimuth under a fixed tool grows, the part turns the other way about +z: clockwise from the tool."""
    lathe = machine("nanotech", c_sense=c_sense)
    write_nc(motion(lathe, sense), lathe, tmp_path / "part.nc")
    (line,) = (row for row in (tmp_path / "part.nc").read_text().splitlines() if row.startswith("( TURNS"))
    assert f"THE PART TURNS {words_of_it} )" in line
    assert ("C GROWS" in line) == (sense * c_sense > 0)


def test_a_foreign_program_of_these_machines(tmp_path):
    """The grammar of published slow-tool-servo programs: macros, a loop that runs once, C that starts again."""
    count = 2000
    degrees = np.arange(1, count + 1) * 0.5
    wrapped = degrees - 360 * np.ceil(degrees / 360 - 1)
    radius = 1.0 - np.arange(1, count + 1) * 0.0004
    rows = [f"C{c:.6f} X{x:.6f} Z{0.04 * x * x:.6f}" for c, x in zip(wrapped, radius, strict=True)]
    head = """#100 = 1       ( PASSES )
#103 = 0.0     ( DEPTH )
#555 = 0.001   ( FEED )
G52 G63 G71 G103 G40 G18 G90
G55
T0202
M26.1
#5 = 0
#8 = 0
WHILE[#5 LT #100] DO 2
#8 = #8 - #103
G52 X0 Y0 Z[#8]
G94 X1.000000
G93 F0.001 C0
G94 Z5 F500
Z0.140000 F20
Z0.040000  F1
G93 F[#555]
C0.000000 X1.000000 Z0.040000
"""
    tail = "\n(linking block)\nG94 Z5 F200\n#5 = #5 + 1\nEND 2\nG94 Z20 F800\nM30"
    path = tmp_path / "foreign.nc"
    path.write_text(head + "\n".join(rows) + tail)
    cut = read_nc(path, machine("nanotech"))
    assert cut.time == pytest.approx(np.arange(count + 1) * 0.001, rel=1e-12)
    assert np.rad2deg(cut.axes["C"][1:]) == pytest.approx(degrees, rel=1e-13)
    assert (cut.axes["X"][1:] == [float(f"{x:.6f}") for x in radius]).all()
    assert cut.axes["Z"][0] == 0.04
