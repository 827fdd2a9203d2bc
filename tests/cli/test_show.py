"""turnwright show: a measurement by itself, of every kind of file. Oracles: closed forms of what the files hold."""

from pathlib import Path

import numpy as np
import pytest

from measured_files import metropro, sdf
from turnwright.cli import main
from turnwright.files import write_map
from turnwright.heightmap import HeightMap

ROOT = Path(__file__).parents[2]
REAL = ROOT / "examples" / "real_part_1021"


def shown(capsys, *arguments):
    assert main(["show", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_a_map_is_shown_with_its_header_size_missing_and_sq(tmp_path, capsys):
    x = 0.002 * np.arange(50)
    z = 1e-5 * np.cos(2 * np.pi * np.arange(50) / 25) + 0.01 * x + np.zeros((40, 1))
    z[3, :7] = np.nan
    write_map(HeightMap(z=z, x=x, y=0.003 * np.arange(40), metadata={"operator": "somebody"}), tmp_path / "a.npz")
    out = shown(capsys, tmp_path / "a.npz")
    assert "operator: somebody" in out
    assert "size: 50 x 40 points, 2 um x 3 um apart, 98 um x 117 um" in out
    assert "missing: 7 of 2,000 (0.35 %)" in out
    sq = float(out.split("Sq: ")[1].split()[0])
    assert sq == pytest.approx(1e6 * 1e-5 / np.sqrt(2), rel=0.02)
    with_tilt = shown(capsys, tmp_path / "a.npz", "--form", "none")
    assert float(with_tilt.split("Sq: ")[1].split()[0]) > 100


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_picture_is_drawn_and_an_old_one_stays(tmp_path, capsys, suffix):
    (tmp_path / "a.sdf").write_bytes(sdf())
    picture = tmp_path / f"a{suffix}"
    assert f"picture: {picture}" in shown(capsys, tmp_path / "a.sdf", "--picture", picture)
    first = picture.read_bytes()
    assert first[:4] in (b"\x89PNG", b"<?xm", b"%PDF")
    assert main(["show", str(tmp_path / "a.sdf"), "--picture", str(picture)]) == 2
    assert "already exists" in capsys.readouterr().err
    assert picture.read_bytes() == first


def test_maps_of_every_kind_are_shown_and_drawn(tmp_path, capsys):
    radius, angle = np.linspace(0.1, 1, 20), np.linspace(0, 2 * np.pi, 24, endpoint=False)
    write_map(HeightMap(z=np.cos(angle)[:, None] * radius * 1e-4, radius=radius, angle=angle), tmp_path / "polar.npz")
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 300))
    write_map(HeightMap(z=1e-3 * x, x=x, y=y), tmp_path / "points.npz")
    (tmp_path / "pixels.dat").write_bytes(metropro(pixel=0.0))
    (tmp_path / "void.npz").write_bytes(b"")
    write_map(HeightMap(z=np.full((5, 5), np.nan), x=np.arange(5.0), y=np.arange(5.0)), tmp_path / "void.npz")
    out = {
        name: shown(capsys, tmp_path / name, "--picture", tmp_path / f"{name}.png")
        for name in ("polar.npz", "points.npz", "pixels.dat")
    }
    assert "24 azimuths x 20 radii from 100 um to 1 mm" in out["polar.npz"]
    assert "300 scattered points" in out["points.npz"]
    assert float(out["points.npz"].split("Sq: ")[1].split()[0]) < 1e-3  # a plane is nothing but tilt
    assert "4 x 3 pixels of unknown size" in out["pixels.dat"]
    assert "missing: 25 of 25 (100 %)" in shown(capsys, tmp_path / "void.npz")
    assert "25 um x 25 um apart" in shown(capsys, tmp_path / "pixels.dat", "--pixel-size", "25 um")


def test_a_profile_is_shown_with_its_feed_and_scallops(tmp_path, capsys):
    out = shown(
        capsys, REAL / "measured_slice_1016.csv", "--profile", "--nose-radius", "0.2 mm",
        "--instrument", "zygo-nexview-10x", "--cutoff", "0.08 mm", "--axis", "0.415 mm",
        "--picture", tmp_path / "a.png",
    )  # fmt: skip
    assert "size: 962 points, 871.1 nm apart, 837.1 um" in out
    assert "feed: 10.17 um" in out
    assert "median 58.51 nm" in out
    assert "ideal scallop height of a 200 um nose: 64.63 nm" in out
    assert "as measured by zygo-nexview-10x" in out
    assert "roughness over 5 sections of 80 um: Ra 8.427 nm" in out
    assert (tmp_path / "a.png").stat().st_size > 1000
    # A feed is stated as in a job.
    guided = shown(capsys, REAL / "measured_slice_1016.csv", "--profile", "--feed", "10 um/rev", "--axis", "0.415 mm")
    assert "feed: 10.17 um" in guided


def test_columns_of_a_profile_are_chosen_by_name(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("X,Y,Slice\n" + "\n".join(f"{k},{k % 10 / 1000},Slice 1" for k in range(100)))
    assert "feed: 10 um" in shown(capsys, tmp_path / "a.csv", "--height", "Y", "--unit", "um")
    (tmp_path / "b.csv").write_text("X,Y\n" + "\n".join(f"{k},{k % 10 / 1000}" for k in range(100)))
    assert main(["show", str(tmp_path / "b.csv"), "--unit", "um"]) == 2
    assert "--profile --height Y" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--picture", "a.jpg"], "must end in .png, .svg, .pdf"),
        (["--form", "cone"], "form is 'cone'"),
        (["--nose-radius", "0.2 mm"], "--nose-radius"),
        (["--pixel-size", "2 um"], "states its pixel size"),
        (["--profile"], "not a profile"),
    ],
)
def test_what_does_not_fit_is_one_sentence(tmp_path, capsys, arguments, sentence):
    (tmp_path / "a.sdf").write_bytes(sdf())
    assert main(["show", str(tmp_path / "a.sdf"), *arguments]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_a_damaged_file_says_one_sentence(tmp_path, capfd):
    (tmp_path / "a.opd").write_bytes(b"\1\0Directory" + bytes(range(256)) * 400)
    assert main(["show", str(tmp_path / "a.opd")]) == 2
    out, error = capfd.readouterr()
    assert out == ""
    assert len(error) < 400


SLICE = "X,Y,Slice\n" + "\n".join(f"{k}.0,{k % 10 / 1000},Slice 1" for k in range(100))


def test_the_advice_on_a_profile_can_be_followed(tmp_path, capsys):
    """The column that is named holds numbers and is no distance; what is missing is stated by the option given."""
    (tmp_path / "a.csv").write_text(SLICE)
    assert main(["show", str(tmp_path / "a.csv")]) == 2
    assert "show --profile --height Y," in capsys.readouterr().err
    assert main(["show", str(tmp_path / "a.csv"), "--profile", "--height", "Y"]) == 2
    assert "give it as --unit 'mm'" in capsys.readouterr().err
    assert "feed: 10 um" in shown(capsys, tmp_path / "a.csv", "--profile", "--height", "Y", "--unit", "um")
    assert main(["show", str(tmp_path / "a.csv"), "--profile", "--height", "Slice"]) == 2
    assert "no numbers in the column 'Slice'" in capsys.readouterr().err


def test_a_slope_is_offered_as_no_height(tmp_path, capsys):
    (tmp_path / "a.dat").write_text("x(mm) Slope (urad)\n" + "\n".join(f"{k}.5 {k / 7:.3f}" for k in range(30)))
    assert main(["show", str(tmp_path / "a.dat")]) == 2
    assert "--height" not in capsys.readouterr().err
    (tmp_path / "b.csv").write_text("X [mm],My Trace [nm]\n" + "\n".join(f"{k}.5,{k / 7:.3f}" for k in range(30)))
    assert main(["show", str(tmp_path / "b.csv")]) == 2
    assert "--height 'My Trace [nm]'" in capsys.readouterr().err


def test_options_stand_for_arguments_in_python(tmp_path, capsys):
    (tmp_path / "a.csv").write_text(SLICE + "\n" + SLICE.split("\n", 1)[1])
    for extra, option in (
        (["--height", "Y", "--unit", "um"], "--number 1"),
        (["--profile"], "--unit 'mm'"),
    ):
        assert main(["show", str(tmp_path / "a.csv"), *extra]) == 2
        assert option in capsys.readouterr().err
    (tmp_path / "a.sdf").write_bytes(sdf())
    assert main(["show", str(tmp_path / "a.sdf"), "--unit", "um"]) == 2
    assert "do not give --unit 'um'" in capsys.readouterr().err


@pytest.mark.parametrize("highest", [1e160, 1e300, 1e10])
def test_heights_out_of_any_range_are_one_sentence(tmp_path, capsys, highest):
    picture = np.ones((4, 5))
    picture[1, 2] = highest
    (tmp_path / "a.sdf").write_bytes(sdf(picture, kind=7, scales=(2e-6, 3e-6, 1.0)))
    (tmp_path / "a.csv").write_text("X [mm],Z [m]\n" + "\n".join(f"{k}.5,{highest:g}" for k in range(30)))
    for arguments in (["a.sdf"], ["a.csv", "--profile"]):
        assert main(["show", str(tmp_path / arguments[0]), *arguments[1:]]) == 2
        out, error = capsys.readouterr()
        assert out == ""
        assert "the limit is 1e+06 mm" in error
        assert error.count("\n") == 1
