"""Materials from round noses, slots and fly-cuts at the command line; what is wrong is one sentence."""

import re

import numpy as np
import pytest

from edge_oracle import RATE, SLOT, Glass, in_time, slot, turning
from turnwright.cli import main
from turnwright.material import Material

GLASS = Glass(1489.0, 816.0)
AVERAGES = "nose radius [mm],depth [um],feed [um],rake [deg],axial force [mN],cutting force [mN]\n"


def averages(rake="-25"):
    """Steady cuts of a round nose, made by brute force."""
    random, lines = np.random.default_rng(1), []
    for feed in np.linspace(1, 6, 10):
        axial, _, cutting = 1e3 * turning(GLASS, 1.0, 0.01, 1e-3 * feed, 500)[0] + 0.02 * random.normal(size=3)
        lines.append(f"1.0,10,{feed:.6f},{rake},{axial:.5f},{cutting:.5f}")
    return AVERAGES + "\n".join(lines) + "\n"


def write(path, names, force):
    np.savetxt(path, force, delimiter=",", header=",".join(f"{one} [N]" for one in names), comments="", fmt="%.7f")


def test_table_of_cuts_with_a_round_nose_states_kind_and_rake(tmp_path, capsys):
    (tmp_path / "cuts.csv").write_text(averages())
    out, picture = tmp_path / "glass.toml", tmp_path / "fit.png"
    assert main(["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(out), "--picture", str(picture)]) == 0
    glass = Material.load(out)
    assert glass.cutting.value == pytest.approx(1489, rel=2e-3)
    assert glass.thrust.value == pytest.approx(816, rel=2e-3)
    assert "the tool's rake was -25 deg" in glass.notes
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"picture: {picture}" in capsys.readouterr().out


NOSE = """
name = "glass"
source = "made up"
kind = "round nose"
[record]
axial = "Fa"
cutting = "-Fc"
rate = "25.6 kHz"
drift = 1
shortest = "40 ms"
lead = "60 ms"
block = "2 ms"
guard = "2 ms"
[[cuts]]
file = "turn.csv"
nose_radius = "1 mm"
depth = "10 um"
feeds = ["2 um/rev", "3 um/rev", "4 um/rev", "6 um/rev"]
"""

MILL = """
name = "glass"
source = "made up"
kind = "slot"
[record]
x = "Fx"
y = "Fy"
rate = "25.6 kHz"
drift = 1
shortest = "400 ms"
block = "1 ms"
guard = "60 ms"
low_pass = {cutoff = "2 kHz", order = 2}
[[cuts]]
file = "slot.csv"
radius = "1 mm"
feed_per_tooth = "1 um"
depth = "0.2 mm"
teeth = 1
spindle = "1200 rpm"
"""


def turned(folder):
    random, time = np.random.default_rng(1), np.arange(int(0.9 * RATE)) / RATE
    force = np.zeros((time.size, 2))
    for i, feed in enumerate((2e-3, 3e-3, 4e-3, 6e-3)):
        axial, _, cutting = turning(GLASS, 1.0, 0.01, feed, 500)[0]
        force[(time > 0.1 + 0.18 * i) & (time < 0.22 + 0.18 * i)] = axial, -cutting
    write(folder / "turn.csv", ("Fa", "Fc"), force + 1e-3 * random.normal(size=force.shape) + 0.1 * time[:, None])


def milled(folder):
    random, time = np.random.default_rng(1), np.arange(int(3 * RATE)) / RATE
    phi = np.linspace(0, np.pi, 1001)
    force = in_time(slot(GLASS, *SLOT.values(), 0.0, phi), phi, time, 1203.0, 0.6, 2.0)[:, :2]
    force *= ((time > 0.6) & (time < 2.4))[:, None]
    write(folder / "slot.csv", ("Fx", "Fy"), force + 2e-3 * random.normal(size=force.shape) + 0.02 * time[:, None])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("records")
    turned(folder)
    milled(folder)
    return folder


def fit(folder, text, tmp_path, capsys):
    (folder / "experiment.toml").write_text(text)
    code = main(["material", "fit", str(folder / "experiment.toml"), "--out", str(tmp_path / "glass.toml")])
    return code, capsys.readouterr()


@pytest.mark.parametrize(
    "text",
    [
        NOSE,
        MILL,
        MILL.replace('block = "1 ms"', "whole_turns = true"),
        MILL.replace('spindle = "', 'times = ["0.6 s", "2.4 s"]\nspindle = "').replace('"400 ms"', '"10 ms"'),
    ],
)
def test_records_of_every_kind_give_a_material_that_loads(folder, tmp_path, capsys, text):
    assert fit(folder, text, tmp_path, capsys)[0] == 0
    glass = Material.load(tmp_path / "glass.toml")
    assert glass.cutting.value == pytest.approx(1489, abs=4 * glass.cutting.uncertainty)
    assert glass.thrust.value == pytest.approx(816, abs=4 * glass.thrust.uncertainty)
    assert glass.cutting.uncertainty < 0.01 * 1489
    assert glass.thrust.uncertainty < 0.015 * 816


FLY = MILL[: MILL.index("[[cuts]]")].replace('"slot"', '"fly-cut"') + '[[cuts]]\nfile = "slot.csv"\nswing = "20 mm"\n'
FLY += 'nose_radius = "1 mm"\nfeed = "5 um/rev"\nstep = "10 um"\ndepth = "5 um"\nspindle = "1200 rpm"\n'

# What is changed in which experiment, and what the sentence must say.
WRONG = {
    "an unknown kind": (NOSE, 'kind = "round nose"', 'kind = "drill"', "kind is 'drill'.*'fly-cut'"),
    "a kind that is a list": (NOSE, 'kind = "round nose"', "kind = []", r"kind is \[\].*'fly-cut'"),
    "an oblique cut": (
        NOSE,
        "[record]",
        'inclination = "10 deg"\n[record]',
        "inclination must be 0 deg .*got 10 deg",
    ),
    "another rake": (NOSE, 'depth = "10 um"', 'depth = "10 um"\nrake = "-25 deg"', "has a rake of -25 deg"),
    "no channel": (
        NOSE,
        'axial = "Fa"\ncutting = "-Fc"',
        "",
        "record must name a channel for at least 1 of cutting, axial, feed",
    ),
    "one coefficient": (NOSE, 'axial = "Fa"', "", "do not determine the thrust coefficient"),
    "feeds that are not those of the record": (
        NOSE,
        ', "6 um/rev"',
        "",
        r"cuts\[1\]: feeds must have one value for each of the 4 cuts .*got 3",
    ),
    "two depths": (
        NOSE,
        "feeds = ",
        'depths = ["10 um"]\nfeeds = ',
        r"cuts\[1\]: either depth or depths .*got depth and depths",
    ),
    "a feed of nothing": (
        NOSE,
        '"2 um/rev"',
        '"0 um/rev"',
        r"cuts\[1\]\.feeds\[1\]: '0 um/rev' is not above 0 mm/rev",
    ),
    "a depth beyond the nose": (NOSE, 'depth = "10 um"', 'depth = "2 mm"', "depth must be below 1 mm"),
    "turns too short to be found": (MILL, '"400 ms"', '"100 ms"', "shortest must be at least 8 revolutions"),
    "times beyond the record": (MILL, "teeth = 1", 'teeth = 1\ntimes = ["1 s", "9 s"]', "within the record of 3 s"),
    "half a tooth": (MILL, "teeth = 1", "teeth = 0.5", r"cuts\[1\]\.teeth is 0\.5.*a whole number"),
    "long stretches": (MILL, 'block = "1 ms"', 'block = "20 ms"', "block must be at most 0.0125 s"),
    "a cutter that turns the other way": (MILL, 'y = "Fy"', 'y = "-Fy"', "coefficient is -"),
    "no swing": (FLY, 'swing = "20 mm"', "", r"cuts\[1\]\.swing is missing"),
    "averages of a slot": (
        MILL,
        MILL[MILL.index("[[cuts]]") :],
        '[averages]\nfile = "a.csv"\n',
        "averages is not a known key.*record, ",
    ),
    "a channel of another kind": (NOSE, 'axial = "Fa"', 'x = "Fa"', r"record\.x is not a known key.*axial"),
    "an uncertainty of another kind": (
        NOSE,
        "[record]",
        "width_uncertainty = 0.1\n[record]",
        "width_uncertainty is not a known key",
    ),
    "an empty name of a file": (NOSE, '"turn.csv"', '""', r"cuts\[1\]\.file is empty"),
    "neither block nor turns": (MILL, 'block = "1 ms"', "", "record: either block or whole_turns"),
    "turns where none are": (NOSE, "[record]", "[record]\nwhole_turns = true", r"record\.whole_turns is not a known"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_experiment_of_a_kind_is_one_sentence(folder, tmp_path, capsys, case):
    text, before, after, sentence = WRONG[case]
    assert before in text
    code, message = fit(folder, text.replace(before, after), tmp_path, capsys)
    assert code == 2
    assert re.search(sentence, message.err)
    assert len([line for line in message.err.splitlines() if line.startswith("turnwright:")]) == 1
    assert not (tmp_path / "glass.toml").exists()


def test_rakes_that_differ_are_two_experiments(tmp_path, capsys):
    (tmp_path / "cuts.csv").write_text(averages().replace("1.0,10,6.000000,-25", "1.0,10,6.000000,0"))
    assert main(["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(tmp_path / "g.toml")]) == 2
    assert "a separate experiment for each rake" in capsys.readouterr().err


def test_a_picture_of_no_known_kind_is_refused_first(tmp_path, capsys):
    (tmp_path / "cuts.csv").write_text(averages())
    arguments = ["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(tmp_path / "g.toml")]
    assert main([*arguments, "--picture", str(tmp_path / "g.bmp")]) == 2
    assert "it must end in .png, .svg, .pdf" in capsys.readouterr().err
    assert not (tmp_path / "g.toml").exists()
