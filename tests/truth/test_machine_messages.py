"""Machines: the ones that come along, the file's form, and every refusal in one sentence."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from turnwright._tables import adapter
from turnwright.errors import InputError
from turnwright.job.tables import AnyMachine
from turnwright.machine import Axis, Controller, Convention, FrequencyResponse, Machine, SecondOrder

NAMES = ["nanotech-350fg", "nanoform", "nanoform-fts-70", "nanoform-fts-500", "generic"]
GOOD = """
name = "shop lathe"
spindle_rpm = 300
block_rate_hz = 250
[axes.C]
speed = "360 deg/s"
[axes.X]
speed = "600 mm/min"
low = "-0.1 m"
high = "100 mm"
[axes.Z]
jerk = "5 m/s^3"
"""


@pytest.mark.parametrize("name", NAMES)
def test_every_fact_of_a_machine_has_a_source(name):
    machine = Machine.load(name)
    stated = {
        f"axes.{letter}.{limit.removesuffix('_hz')}"
        for letter, axis in machine.axes.items()
        for limit in axis.__slots__
        if getattr(axis, limit) is not None
    }
    assert stated | {"spindle_rpm", "block_rate_hz"} <= set(machine.sources)
    assert all(text.startswith("assumed") or "20" in text for text in machine.sources.values())


def test_the_350fg_takes_1000_blocks_per_second():
    machine = Machine.load("nanotech-350fg")
    assert machine.block_rate_hz == 1000
    assert "Troutman 2016" in machine.sources["block_rate_hz"]
    assert machine.axes["X"].speed == pytest.approx(25)  # 1500 mm/min
    assert machine.dialect == "nanotech"


def test_a_file_is_read_in_units(tmp_path):
    file = tmp_path / "shop.toml"
    file.write_text(
        "squareness = '-7 arcsec'\nstraightness = { x_mm = [0, 50], error_nm = [0, 120] }\n"
        + GOOD
        + "[convention]\nx_side = -1\nclocking = '90 deg'\n[plausible]\nservo_lag = '1 deg'\ndrift_of_z = '9 nm'\n"
        + "[sources]\naxes.X.speed = 'name plate'\n"
    )
    machine = Machine.load(file)
    assert machine.axes["C"].speed == pytest.approx(2 * np.pi)
    assert (machine.axes["X"].speed, machine.axes["X"].low, machine.axes["X"].high) == (10, -100, 100)
    assert machine.axes["Z"].jerk == 5000
    assert machine.squareness == pytest.approx(-7 * np.pi / 180 / 3600)
    assert machine.convention == Convention(x_side=-1, clocking=np.pi / 2)
    assert machine.z_error([25, 80]) == pytest.approx(
        np.array([60e-6, 120e-6]) + machine.squareness * np.array([25, 80])
    )
    assert dict(machine.plausible) == {"servo lag": pytest.approx(np.pi / 180), "drift of Z": pytest.approx(9e-6)}
    assert machine.sources["axes.X.speed"] == "name plate"


@pytest.mark.parametrize("text", ["-35 um/m", "-35 urad", "-3.5e-5 rad"])
def test_squareness_is_an_angle_or_a_slope(tmp_path, text):
    file = tmp_path / "shop.toml"
    size = text.removeprefix("-")
    file.write_text(f"squareness = '{text}'\n{GOOD}[plausible]\nsquareness = '{size}'\n")
    machine = Machine.load(file)
    assert machine.squareness == pytest.approx(-35e-6)
    assert dict(machine.plausible) == {"squareness": pytest.approx(35e-6)}
    sizes = {"name": "generic", "plausible": {"squareness": size}}
    assert adapter(AnyMachine).validate_python(sizes).plausible["squareness"] == machine.plausible["squareness"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("[axes.C]", "[plausible]\nservo_lag = '35 um/m'\n[axes.C]"), "plausible.servo_lag: '35 um/m' is"),
        (("[axes.C]", "[plausible]\nsquareness = '-35 um/m'\n[axes.C]"), "plausible.squareness: '-35 um/m' is not"),
        (("spindle_rpm = 300", ""), "spindle_rpm is missing"),
        (("spindle_rpm = 300", "spindle_rpm = '300 rpm'"), "spindle_rpm is '300 rpm'"),
        (("spindle_rpm = 300", "spindle_rpm = 0"), "spindle_rpm is 0 rev/min"),
        (("block_rate_hz = 250", "block_rate_hz = nan"), "block_rate_hz is nan"),
        (("block_rate_hz = 250", "block_rate_hz = true"), "block_rate_hz is True"),
        (("block_rate_hz = 250", "block_rate_hz = 250\nblocks = 3"), "blocks is not a known key"),
        (('name = "shop lathe"', "name = 3"), "name is 3"),
        (('"600 mm/min"', "600"), "axes.X.speed: 600 has no unit"),
        (('"600 mm/min"', '"600 deg/min"'), "axes.X.speed"),
        (('"600 mm/min"', '"-600 mm/min"'), "axes.X: the speed of an axis is -10"),
        (('"100 mm"', '"-1 m"'), "axes.X: the travel of an axis is -100 to -1000"),
        (("[axes.Z]\njerk", "[axes.Z]\nsnap"), "axes.Z.snap is not a known key"),
        (('[axes.Z]\njerk = "5 m/s^3"', ""), "lacks axis Z"),
        (("[axes.Z]", "[axes.zee]"), "axes.zee: it is not an axis"),
        (('[axes.Z]\njerk = "5 m/s^3"', "[axes]\nZ = 3"), "axes.Z is 3, it must be a table"),
        (("[axes.C]", "[convention]\nx_side = 0\n[axes.C]"), "x_side of the convention is 0"),
        (("[axes.C]", "[convention]\nside = 1\n[axes.C]"), "convention.side is not a known key"),
        (("[axes.C]", "[straightness]\nx_mm = [0, 0]\nerror_nm = [1, 2]\n[axes.C]"), "ascending"),
        (("[axes.C]", "[straightness]\nx_mm = [0]\n[axes.C]"), "1 positions and 0 errors"),
        (("[axes.C]", "[sources]\naxes.Y.speed = 'x'\n[axes.C]"), "sources has 'axes.Y.speed'"),
        (("block_rate_hz = 250", "block_rate_hz = 250\nsquareness = '20 deg'"), "squareness is 0.349066 rad"),
        (("spindle_rpm = 300", "spindle_rpm ="), "Invalid value"),
        (("[axes.C]", "[controller]\ninterpolation = 'nurbs'\n[axes.C]"), "interpolation is 'nurbs'"),
        (("[axes.C]", "[controller]\nlook_ahead = 0\n[axes.C]"), "look_ahead is 0"),
        (("[axes.C]", "[axes.C]\nresponse = 5"), "axes.C.response is 5"),
        (("[axes.C]", "[axes.C]\nresponse = { frequency = '100 Hz' }"), "response.damping is missing"),
        (
            ("[axes.C]", "[axes.C]\nresponse = { frequency = 100, damping = 0.7 }"),
            "response.frequency: 100 has no unit",
        ),
        (("[axes.C]", "[axes.C]\nresponse = { frequency = '9 Hz', damping = '1' }"), "response.damping is '1'"),
        (("[axes.C]", "[axes.C]\nresponse = { frequency = '9 Hz', damping = -1 }"), "damping is -1"),
        (("[axes.C]", "[axes.C]\nresponse = { numerator = [1], denominator = [1, 2] }"), "constant terms are 1 and 2"),
        (("[axes.C]", "[axes.C]\nresponse = { numerator = [2], denominator = [-1, 2] }"), "stable"),
        (("[axes.C]", "[axes.C]\nresponse = { numerator = [1, 1, 1], denominator = [1, 1] }"), "3 coefficients"),
        (("[axes.C]", "[axes.C]\nresponse = { file = 'none.csv' }"), "none.csv cannot be read"),
        (("[axes.C]", "[axes.C]\ndead_time = '2 s'"), "dead_time of an axis is 2 s"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path, change, words):
    file = tmp_path / "shop.toml"
    assert change[0] in GOOD
    file.write_text(GOOD.replace(*change))
    with pytest.raises(InputError, match=r"shop\.toml") as caught:
        Machine.load(file)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["nanotech-350", "no/such/file.toml", Path("missing.toml")])
def test_an_unknown_machine_lists_the_known_ones(name):
    with pytest.raises(InputError, match="generic, nanoform, nanoform-fts-500, nanoform-fts-70, nanotech-350fg"):
        Machine.load(name)


def test_a_machine_cannot_be_wrong():
    machine = Machine.load("generic")
    for change in (
        {"axes": {"C": Axis(), "X": Axis()}},
        {"spindle_rpm": -1},
        {"block_rate_hz": np.inf},
        {"squareness": np.nan},
        {"straightness": ([0, 1], [0, np.nan])},
        {"straightness": ([1, 0], [0, 0])},
    ):
        with pytest.raises(InputError):
            replace(machine, **change)
    with pytest.raises(InputError, match="clocking"):
        Convention(clocking=np.inf)


def test_an_axis_answers_as_its_file_says(tmp_path):
    (tmp_path / "z.csv").write_text("Hz,dB,deg\n1,0,-1\n10; -6.0205999132796; -170\n# end\n100 -20 160\n")
    file = tmp_path / "shop.toml"
    file.write_text(
        GOOD.replace("[axes.Z]", "[axes.Z]\nresponse = { file = 'z.csv' }\ndead_time = '3 ms'").replace(
            "[axes.X]", "[axes.X]\nresponse = { frequency = '80 Hz', damping = 0.7, velocity_feedforward = 1 }"
        )
        + "[controller]\ninterpolation = 'cubic spline'\nlook_ahead = 50\n"
    )
    machine = Machine.load(file)
    assert machine.controller == Controller(interpolation="cubic spline", look_ahead=50)
    assert machine.axes["X"].response == SecondOrder(frequency_hz=80, damping=0.7, velocity_feedforward=1)
    assert machine.axes["Z"].dead_time == 0.003
    measured = machine.axes["Z"].response
    # The last phase is half a turn further on, not back: -170 deg, then -200 deg.
    assert measured.at([0, 10, 100]) == pytest.approx(
        [1, 0.5 * np.exp(-1j * np.deg2rad(170)), 0.1 * np.exp(-1j * np.deg2rad(200))]
    )
    assert measured.at(-10) == pytest.approx(np.conj(measured.at(10)))
    assert abs(measured.at(1000)) == pytest.approx(0.001)
    assert measured.slower(2).at(5) == pytest.approx(measured.at(10))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 0", "line 1 is '1 0'"),
        ("Hz dB deg\n1 0 x", "line 2"),
        ("1 0 0", "1 frequencies"),
        ("2 0 0\n1 0 0", "begin at 2 Hz"),
        ("1 0 0\n2 nan 0", "not finite"),
    ],
)
def test_a_wrong_response_file_is_refused(tmp_path, text, words):
    file = tmp_path / "z.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=r"z\.csv") as caught:
        FrequencyResponse.load(file)
    assert words in str(caught.value)


def test_a_file_may_add_to_another_one(tmp_path):
    (tmp_path / "shop.toml").write_text(GOOD)
    (tmp_path / "answer.csv").write_text("10,0,0\n100,-3,-45\n")
    file = tmp_path / "with_tool.toml"
    file.write_text(
        'base = "shop.toml"\nname = "with a tool"\n[axes.W]\nlow = "-35 um"\nhigh = "35 um"\nbandwidth = "700 Hz"\n'
        'response = { file = "answer.csv" }\n[sources]\naxes.W.low = "the label"\n'
    )
    plain, added = Machine.load(tmp_path / "shop.toml"), Machine.load(file)
    assert added.name == "with a tool"
    assert added.axes["W"].bandwidth_hz == 700
    assert added.axes["W"].high == pytest.approx(0.035)
    assert added.axes["W"].response is not None
    assert {letter: added.axes[letter] for letter in plain.axes} == dict(plain.axes)
    assert added.sources == {**plain.sources, "axes.W.low": "the label"}
    assert Machine.load("nanoform-fts-70").axes["X"] == Machine.load("nanoform").axes["X"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('base = "loop.toml"', "to a circle"),
        ('base = "none.toml"', "none.toml"),
        ("base = 3", "base is 3"),
        ('base = "generic"\n[axes.W]\nbandwidth = "700"', "axes.W.bandwidth: '700' has no unit"),
        ('base = "generic"\n[axes.W]\nbandwidth = "-7 Hz"', "the bandwidth of an axis is -7 Hz"),
        ('base = "generic"\n[axes]\nX = 3', "axes.X is 3"),
    ],
)
def test_a_wrong_addition_is_refused(tmp_path, text, words):
    file = tmp_path / "loop.toml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        Machine.load(file)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_an_axis_can_do_at_a_frequency():
    """A sine of 0.035 mm reaches 100 mm/s at 455 Hz and 1e5 mm/s^2 at 269 Hz."""
    axis = Axis(low=-0.035, high=0.035, speed=100, acceleration=1e5, bandwidth_hz=700)
    omega = 2 * np.pi * np.array([268.0, 270.0, 600.0])
    assert axis.amplitude(omega / (2 * np.pi)) == pytest.approx([0.035, *(1e5 / omega[1:] ** 2)])
    assert axis.amplitude([0.0, 700.0, 700.1]).tolist() == [0.035, pytest.approx(1e5 / (1400 * np.pi) ** 2), 0.0]
    assert Axis(jerk=8.0).amplitude(1 / np.pi) == pytest.approx(1.0)
    assert Axis().amplitude(3.0) == np.inf


def test_machine_stays_read_only_in_another_process():
    # A process of its own, in which nothing else of the package has been imported.
    ask = (
        "import pickle, turnwright as tw; m = tw.Machine.load('nanotech-350fg'); n = pickle.loads(pickle.dumps(m)); "
        "print(dict(n.axes) == dict(m.axes), n.name == m.name, type(n.axes).__name__)"
    )
    message = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True).stdout
    assert message.split() == ["True", "True", "mappingproxy"]
