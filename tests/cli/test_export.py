"""turnwright export: a map in the format of another program. Oracles: prysm, closed forms of what files hold."""

import numpy as np
import prysm.io
import pytest

from turnwright.cli import main
from turnwright.files import read_map, write_map
from turnwright.heightmap import HeightMap

AXIS = np.linspace(-2, 2, 21)
X, Y = np.meshgrid(AXIS, AXIS)
ERROR = 1e-4 * (X**2 + 0.3 * Y)
JOB = """
[part]
surface = { family = "conic", radius = "40 mm", conic = -1.0 }
radius = "2 mm"
[tool]
nose_radius = "0.5 mm"
included = "60 deg"
clearance = "10 deg"
[machine]
name = "generic"
[strategy]
kind = "slow tool servo"
feed = "10 um/rev"
points_per_rev = 360
spindle_speed = "50 rpm"
"""


@pytest.fixture
def measured(tmp_path):
    write_map(HeightMap(x=AXIS, y=AXIS, z=ERROR + (X**2 + Y**2) / 80), tmp_path / "a.npz")
    (tmp_path / "job.toml").write_text(JOB)
    return tmp_path / "a.npz"


def exported(folder, *options):
    assert main(["export", str(folder / "a.npz"), *map(str, options)]) == 0


def test_a_departure_goes_to_codev_and_to_zygo(tmp_path, capsys, measured):
    exported(tmp_path, "--out", tmp_path / "a.int", "--base", tmp_path / "job.toml")
    assert f"map: {tmp_path / 'a.int'}" in capsys.readouterr().out
    count_nm = np.abs(ERROR).max() * 1e6 / 32767
    found = read_map(tmp_path / "a.int").z
    np.testing.assert_allclose(found * 1e6, ERROR * 1e6, rtol=0, atol=0.501 * count_nm)
    exported(tmp_path, "--out", tmp_path / "b.dat", "--format", "zygo", "--base", tmp_path / "job.toml")
    found = prysm.io.read_zygo_dat(tmp_path / "b.dat")["phase"]
    np.testing.assert_allclose(found[::-1], ERROR * 1e6, rtol=0, atol=0.501 * 632.8 / 2 / 131072)


def test_a_front_face_is_turned_and_a_phase_has_its_wavelength(tmp_path, measured):
    options = ("--base", tmp_path / "job.toml", "--face", "front")
    exported(tmp_path, "--out", tmp_path / "a.grd", *options)
    np.testing.assert_allclose(read_map(tmp_path / "a.grd").z, -ERROR[:, ::-1], rtol=0, atol=1e-15)
    phase = ("--format", "grid phase", "--wavelength", "500 nm")
    exported(tmp_path, "--out", tmp_path / "b.dat", *options, *phase)
    lines = (tmp_path / "b.dat").read_text().splitlines()[2:]
    found = np.array([float(line.split()[0]) for line in lines]).reshape(21, 21)[::-1]
    np.testing.assert_allclose(found, -4 * np.pi / 500e-6 * ERROR[:, ::-1], rtol=1e-9, atol=1e-9)


BAD = {
    "ambiguous suffix": (("--out", "a.dat"), "state the format"),
    "format": (("--out", "a.dat", "--format", "sur"), '"zygo" or "codev"'),
    "face": (("--out", "a.int", "--face", "left"), '"front" or "back"'),
    "phase": (("--out", "a.dat", "--format", "grid phase"), "needs the wavelength"),
    "wavelength": (("--out", "a.dat", "--format", "grid phase", "--wavelength", "500"), "unit"),
    "pixel size": (("--out", "b.int", "--pixel-size", "1 um"), "states its pixel size"),
    "existing file": (("--out", "a.npz"), "already exists"),
    "folder": (("--out", "none/a.int"), "does not exist"),
}


@pytest.mark.parametrize(("options", "message"), BAD.values(), ids=BAD)
def test_bad_input_of_an_export_is_one_sentence(tmp_path, capsys, monkeypatch, measured, options, message):
    monkeypatch.chdir(tmp_path)
    files = sorted(tmp_path.iterdir())
    assert main(["export", "a.npz", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == files


def test_a_map_without_a_pixel_size_names_the_option(tmp_path, capsys):
    (tmp_path / "a.int").write_text("one\nGRD 2 2 SUR WVL 0.5 SSZ 20000 NDA -32768\n20000 0 0 -32768\n")
    assert main(["export", str(tmp_path / "a.int"), "--out", str(tmp_path / "b.int")]) == 2
    assert "read it with --pixel-size ..., or write it as .npz" in capsys.readouterr().err
