"""Materials at the command line: list, show, and fit from records of every format; what is wrong is one sentence."""

import re
import tomllib

import h5py
import numpy as np
import pytest

from turnwright.cli import main
from turnwright.cutting import read_forces
from turnwright.errors import InputError
from turnwright.material import Material

RATE = 5000.0
AVERAGES = "thickness [nm],width [mm],cutting [mN],thrust [mN]\n"


def averages(count=12):
    """Forces of IRG 26 without noise to speak of, brittle beyond 600 nm."""
    random = np.random.default_rng(1)
    lines = []
    for chip in np.linspace(50, 1200, count):
        of = min(chip, 600.0 * 0.7) if chip > 600 else chip
        lines.append(
            f"{chip:.3f},0.2,{1489 * of * 1e-6 * 0.2 * 1e3 + 0.05 * random.normal():.5f},"
            f"{816 * of * 1e-6 * 0.2 * 1e3 + 0.05 * random.normal():.5f}"
        )
    return AVERAGES + "\n".join(lines) + "\n"


def forces():
    """An interrupted ramp of 50 nm to 1.2 um, 3 channels. (n, 3) [N]."""
    random = np.random.default_rng(2)
    time = np.arange(int(1.4 * RATE)) / RATE
    on = (time > 0.1) & (time < 1.3) & ((time - 0.1) % 0.1 < 0.08)
    chip = 50e-6 + 1150e-6 * (time - 0.1) / 1.18
    of = np.where(chip > 600e-6, 0.7 * 600e-6, chip) * on * 0.2
    force = np.column_stack((0.1 * of, 1489 * of, -816 * of)) + 2e-3 * random.normal(size=(time.size, 3))
    return time, force + 0.05 * time[:, None]


def write_csv(path, time, force):
    table = np.column_stack((time, force * 1e3))
    np.savetxt(path, table, delimiter=";", fmt="%.6f", header="time [s];Fx [mN];Fy [mN];Fz [mN]", comments="")


def write_hdf5(path, _time, force):
    with h5py.File(path, "w") as file:
        file.attrs["rate_hz"] = RATE
        for name, column in zip(("Fx", "Fy", "Fz"), force.T, strict=True):
            file.create_dataset(f"cut/{name}", data=column).attrs["unit"] = "N"


def write_tdms(path, _time, force):
    from nptdms import ChannelObject, TdmsWriter

    message = {"wf_increment": 1 / RATE, "unit_string": "N"}
    with TdmsWriter(path) as file:
        file.write_segment(
            [
                ChannelObject("cut", name, column, message)
                for name, column in zip(("Fx", "Fy", "Fz"), force.T, strict=True)
            ]
        )


WRITERS = {"forces.csv": write_csv, "forces.h5": write_hdf5, "forces.tdms": write_tdms}

EXPERIMENT = """
name = "our glass"
source = "cuts of 2 March, tool 17"
[record]
cutting = "Fy"
thrust = "-Fz"
drift = 1
shortest = "15 ms"
block = "2 ms"
guard = "1 ms"
[[cuts]]
file = "{file}"
width = "0.2 mm"
ramp = ["50 nm", "1200 nm"]
"""


@pytest.mark.parametrize("name", WRITERS)
def test_a_record_comes_back_from_every_format(tmp_path, name):
    time, force = forces()
    WRITERS[name](tmp_path / name, time, force)
    found = read_forces(tmp_path / name, channels=["Fz", "Fx"])
    assert found.rate_hz == pytest.approx(RATE, rel=1e-9)
    assert found.channels == ("Fz", "Fx")
    assert np.abs(found.force - force[:, [2, 0]]).max() < 1e-9 if name != "forces.csv" else 1e-8


@pytest.mark.parametrize("name", WRITERS)
def test_fit_writes_a_material_that_loads(tmp_path, capsys, name):
    WRITERS[name](tmp_path / name, *forces())
    (tmp_path / "experiment.toml").write_text(EXPERIMENT.format(file=name))
    out = tmp_path / "glass.toml"
    assert main(["material", "fit", str(tmp_path / "experiment.toml"), "--out", str(out)]) == 0
    assert "the critical thickness is" in capsys.readouterr().out
    glass = Material.load(out)
    assert glass.name == "our glass"
    assert glass.cutting.value == pytest.approx(1489, rel=0.01)
    assert glass.thrust.value == pytest.approx(816, rel=0.01)
    assert glass.critical.value == pytest.approx(600e-6, rel=0.03)
    assert glass.sources["cutting.value"].startswith("cuts of 2 March, tool 17: 95% interval ")
    assert main(["material", "show", str(out)]) == 0
    assert "cutting coefficient: 14" in capsys.readouterr().out


def test_fit_takes_steady_and_stepped_records_and_filters_them(tmp_path):
    """Two records with a drift of their own: one cut of 300 nm; three of 100, 200 and 400 nm, one after the other."""
    random = np.random.default_rng(3)
    time = np.arange(int(RATE)) / RATE
    single = np.where((time > 0.3) & (time < 0.7), 300e-6, 0.0)
    three = sum(np.where((time > 0.1 + at) & (time < 0.3 + at), chip, 0.0) for at, chip in
                ((0.0, 100e-6), (0.3, 200e-6), (0.6, 400e-6)))  # fmt: skip
    for name, chip, drift in (("single.csv", single, 0.1 * time), ("three.csv", three, 0.3 - 0.2 * time)):
        force = 0.2 * chip[:, None] * [0.0, 1489.0, -816.0] + drift[:, None]
        write_csv(tmp_path / name, time, force + 2e-3 * random.normal(size=force.shape))
    text = EXPERIMENT.format(file="single.csv").replace('ramp = ["50 nm", "1200 nm"]', 'thickness = "300 nm"')
    text = text.replace("[[cuts]]", 'low_pass = {cutoff = "1 kHz", order = 2}\n[[cuts]]', 1)
    text += '[[cuts]]\nfile = "three.csv"\nwidth = "0.2 mm"\nsteps = ["100 nm", "200 nm", "400 nm"]\n'
    (tmp_path / "experiment.toml").write_text(text)
    out = tmp_path / "glass.toml"
    assert main(["material", "fit", str(tmp_path / "experiment.toml"), "--out", str(out)]) == 0
    glass = Material.load(out)
    assert glass.cutting.value == pytest.approx(1489, abs=3 * glass.cutting.uncertainty)
    assert glass.thrust.value == pytest.approx(816, abs=3 * glass.thrust.uncertainty)
    assert glass.cutting.uncertainty < 0.005 * 1489
    assert glass.critical is None


def test_fit_takes_a_table_of_averaged_cuts(tmp_path, capsys):
    (tmp_path / "cuts.csv").write_text(averages())
    out = tmp_path / "glass.toml"
    assert main(["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(out)]) == 0
    table = tomllib.loads(out.read_text())
    assert table["cutting"]["n_per_mm2"] == pytest.approx(1489, rel=2e-3)
    assert Material.load(out).critical.value == pytest.approx(600e-6, rel=0.1)  # the steps are 105 nm
    assert str(out) in capsys.readouterr().out


def test_a_size_effect_is_learned_and_loads(tmp_path):
    chip = np.linspace(50, 500, 12)
    force = 1489 * (chip / 200) ** -0.25 * chip * 1e-6 * 0.2 * 1e3
    rows = [f"{one:.6f},0.2,{two:.9f},{two / 2:.9f}" for one, two in zip(chip, force, strict=True)]
    (tmp_path / "cuts.csv").write_text(AVERAGES + "\n".join(rows))
    (tmp_path / "experiment.toml").write_text(
        'name = "crystal"\nsource = "made up"\nsize_effect = true\nrake = "-25 deg"\n[averages]\nfile = "cuts.csv"\n'
    )
    out = tmp_path / "crystal.toml"
    assert main(["material", "fit", str(tmp_path / "experiment.toml"), "--out", str(out)]) == 0
    crystal = Material.load(out)
    assert crystal.cutting.exponent == pytest.approx(0.25, abs=1e-5)
    assert float(crystal.cutting.at(200e-6)) == pytest.approx(1489, rel=1e-4)
    assert "the tool's rake was -25 deg" in crystal.notes


def test_list_names_every_material(capsys):
    assert main(["material", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == list(Material.known())
    assert any("Kc 1489, Kt 816 N/mm^2; ductile to 600 nm" in line for line in lines)
    message = "an estimate, Kc about 4500 +- 50 %, Kt about 2500 +- 71 % N/mm^2 at 1 um; no brittle limit"
    assert f"copper-ofhc: copper OFHC; {message}" in lines  # 700 (1 um / 1 mm)^-0.27 is 4520
    assert any("no coefficients; ductile to 100 nm and varies with crystal direction" in line for line in lines)
    assert any("PMMA; no coefficients; no brittle limit" in line for line in lines)


def test_show_says_where_each_number_is_from(capsys):
    assert main(["material", "show", "irg26"]) == 0
    message = capsys.readouterr().out
    assert "1489 +- 62 N/mm^2" in message
    assert "source of cutting.value: Troutman 2016" in message
    assert main(["material", "show", "brass"]) == 0
    message = capsys.readouterr().out
    assert "700 +- 350 N/mm^2 at 1 mm, decreasing with chip thickness to the power 0.27" in message
    assert "valid for chips of 100 um to 1 mm" in message


# What is changed in the experiment's file, and what the sentence must say.
WRONG = {
    "times that fall": (
        ('ramp = ["50 nm", "1200 nm"]', 'ramp = ["50 nm", "1200 nm"]\ntimes = ["1 s", "0.1 s"]'),
        r"cuts\[1\]: times must be .*got \[1\.0, 0\.1\] s",
    ),
    "no width": (('width = "0.2 mm"\n', ""), r"cuts\[1\]\.width is missing"),
    "a width of angle": (('"0.2 mm"', '"0.2 deg"'), r"cuts\[1\]\.width: '0\.2 deg' is an angle, it must be a length"),
    "no thickness": (
        ('ramp = ["50 nm", "1200 nm"]\n', ""),
        r"cuts\[1\]: exactly one of thickness, ramp, steps",
    ),
    "an unknown key": (("drift = 1", "drift = 1\ndrfit = 2"), r"record\.drfit is not a known key.*'drift'"),
    "no such channel": (('"Fy"', '"Fq"'), "has no channel 'Fq', it has"),
    "a range that ends below the forces": (
        ("drift = 1", "drift = 1\nrange_n = 0.15"),
        "samples of channel 'Fy' are at",
    ),
    "a range of no force": (("drift = 1", "drift = 1\nrange_n = 0"), "range_n"),
    "too high a drift": (("drift = 1", "drift = 9"), "the degree of the drift is 9, it must be a whole number, 0 to 6"),
    "no file": (
        ('file = "forces.csv"', 'file = "none.csv"'),
        r"cuts\[1\]: .*cannot be read \(No such file or directory\)",
    ),
    "the wrong sign": (('"-Fz"', '"Fz"'), "thrust coefficient is -8"),
    "the cutting force turned round": (('"Fy"', '"-Fy"'), "channel -Fy .* reverse the channel"),
    "steps that are not those of the record": (
        ('ramp = ["50 nm", "1200 nm"]', 'steps = ["1 um"]'),
        "steps must have one value for each of the 12 cuts .*got 1",
    ),
    "a long block": (('block = "2 ms"', 'block = "2 s"'), "no interval of 2 s fits in a cut"),
    "no TOML": (("[record]", "[record"), "is not TOML"),
    "nothing that was cut": (("[[cuts]]", "[[passes]]"), "passes is not a known key.*cuts"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_experiment_is_one_sentence(tmp_path, capsys, case):
    (before, after), sentence = WRONG[case]
    write_csv(tmp_path / "forces.csv", *forces())
    text = EXPERIMENT.format(file="forces.csv")
    assert before in text
    (tmp_path / "experiment.toml").write_text(text.replace(before, after))
    out = tmp_path / "glass.toml"
    assert main(["material", "fit", str(tmp_path / "experiment.toml"), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert re.search(sentence, message)
    assert len([line for line in message.splitlines() if line.startswith("turnwright:")]) == 1
    assert not out.exists()


TABLES = {
    "nothing": ("", "got 0 lines"),
    "a name without a unit": (averages().replace("width [mm]", "width"), "got 'width'"),
    "a unit of another kind": (averages().replace("[nm]", "[N]"), "got 'N'"),
    "a column too few": (averages().replace(",thrust [mN]", ""), "got 3 names and 4 columns"),
    "words": (averages() + "one,two,three,four\n", "is not a table of numbers"),
    "nan": (averages() + "nan,0.2,1,1\n", "values that are not finite"),
    "three cuts": (averages(3), "at least 4 rows must be cuts, got 3"),
    "a thickness below 0": (averages() + "-5,0.2,1,1\n", "at least 0 mm, got -5e-06 mm"),
}


@pytest.mark.parametrize("case", TABLES)
def test_a_wrong_table_is_one_sentence(tmp_path, capsys, case):
    text, sentence = TABLES[case]
    (tmp_path / "cuts.csv").write_text(text)
    assert main(["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(tmp_path / "glass.toml")]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "glass.toml").exists()


def test_a_material_is_not_written_over(tmp_path, capsys):
    (tmp_path / "cuts.csv").write_text(averages())
    (tmp_path / "glass.toml").write_text("mine")
    assert main(["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(tmp_path / "glass.toml")]) == 2
    assert "already exists" in capsys.readouterr().err
    assert (tmp_path / "glass.toml").read_text() == "mine"


RECORDS = {
    "no unit": ("time [s],Fx\n0,1\n1,2\n2,3\n", "states no unit for channel 'Fx'"),
    "volts": ("time [s],Fx [V]\n0,1\n1,2\n2,3\n", "got 'V'"),
    "no rate": ("Fx [N],Fy [N]\n0,1\n1,2\n2,3\n", "states neither the sampling rate nor the times"),
    "a missing sample": ("time [s],Fx [N]\n0,1\n1,2\n3,3\n4,1\n", "must be evenly spaced"),
    "no names": ("0,1\n1,2\n2,3\n", "a unique name for each column"),
    "two of a name": ("t,F,F\n0,1,1\n1,2,2\n", "a unique name for each column"),
    "a short line": ("time [s],Fx [N]\n0,1\n1\n2,3\n", "is not a table of numbers"),
    "nothing": ("", "got 0 lines"),
    "not finite": ("time [s],Fx [N]\n0,1\n1,inf\n2,3\n", "holds 1 values that are not finite"),
}


@pytest.mark.parametrize("case", RECORDS)
def test_a_wrong_record_is_one_sentence(tmp_path, case):
    text, sentence = RECORDS[case]
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(InputError, match=r"^[^\n]+$") as caught:
        read_forces(tmp_path / "r.csv")
    assert sentence in str(caught.value)


def constant(chip):
    """Forces per width that no longer grow, as all of a brittle range may be: no coefficient is in them."""
    random = np.random.default_rng(0)
    force = np.array([84.0, 45.0]) + 0.3 * random.normal(size=(chip.size, 2))
    return "thickness [nm];width [mm];cutting [mN];thrust [mN]\n" + "\n".join(
        f"{t:.1f};0.2;{c:.4f};{n:.4f}" for t, (c, n) in zip(chip, force, strict=True)
    )


def test_cuts_that_are_all_brittle_are_reported(tmp_path, capsys):
    """No line through 0 is in constant forces; whatever is made of them must not go without a word."""
    (tmp_path / "cuts.csv").write_text(constant(np.linspace(500, 900, 35)))
    assert main(["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(tmp_path / "a.toml")]) == 0
    assert "cuts are certainly ductile" in capsys.readouterr().out
    assert "measure thinner chips" in Material.load(tmp_path / "a.toml").notes


NAMES = "thickness [nm],width [mm],cutting [mN],thrust [mN]\n"
ODD = {
    "no width": (NAMES + "100,0,1,1\n" * 9, "width must be above 0 mm where the thickness is, got 0 mm for 9 cuts"),
    "names alone": (NAMES, "got 1 lines"),
    "a long line": ("x" * 500 + "\n1\n", f"got '{'x' * 60}'"),
}


@pytest.mark.parametrize("case", ODD)
def test_a_table_of_cuts_that_is_none_is_one_sentence(tmp_path, capsys, case):
    text, sentence = ODD[case]
    (tmp_path / "cuts.csv").write_text(text)
    assert main(["material", "fit", str(tmp_path / "cuts.csv"), "--out", str(tmp_path / "a.toml")]) == 2
    message = capsys.readouterr().err
    assert sentence in message
    assert "warning" not in message
    assert not (tmp_path / "a.toml").exists()


WRONG_RATES = {
    "dt": (0.0, "the step of the samples .* above 0, got 0.0"),
    "rate_hz": (-5.0, "the rate of the samples .* got -5.0"),
    "samplerate": ("fast", "the rate of the samples .* got fast"),
}


@pytest.mark.parametrize("name", WRONG_RATES)
def test_a_rate_that_is_none_is_named(tmp_path, name):
    value, sentence = WRONG_RATES[name]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("Fx", data=np.arange(5.0)).attrs.update({"unit": "N", name: value})
    with pytest.raises(InputError, match=sentence):
        read_forces(tmp_path / "a.h5")


def test_a_spectrum_is_no_force(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("Fx", data=np.arange(5) + 1j).attrs.update({"unit": "N", "rate_hz": 5.0})
    with pytest.raises(InputError, match="at least 1 force channel"):
        read_forces(tmp_path / "a.h5")


@pytest.mark.parametrize("name", ["forces.h5", "forces.tdms"])
def test_a_damaged_record_is_one_sentence_or_reads(tmp_path, name):
    """Bytes changed and the end cut off at many places: never a traceback."""
    time, force = forces()
    WRITERS[name](tmp_path / "good", time[:200], force[:200])
    data = (tmp_path / "good").read_bytes()
    random = np.random.default_rng(0)
    message = []
    for trial in range(4 if name == "forces.h5" else 60):  # HDF5 takes a process each
        bad = bytearray(data[: random.integers(8, len(data))] if trial % 2 else data)
        for place in random.integers(8, max(len(bad) // 4, 9), 3):
            bad[place] ^= 1 << random.integers(8)
        (tmp_path / "bad").write_bytes(bad)
        try:
            read_forces(tmp_path / "bad", unit="N", rate_hz=1.0)
        except InputError as error:
            message.append(str(error))
    assert message
    assert not any("\n" in one for one in message)


def test_a_file_that_is_no_record_is_named(tmp_path):
    (tmp_path / "r.bin").write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match="is neither CSV text, HDF5 nor TDMS"):
        read_forces(tmp_path / "r.bin")
