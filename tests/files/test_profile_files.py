"""Slices of instruments: columns by name, units stated or given, gaps, several slices; nothing is guessed."""

from pathlib import Path

import numpy as np
import pytest

from turnwright.errors import InputError, MapError
from turnwright.files import read_profile, write_map
from turnwright.heightmap import HeightMap

ROOT = Path(__file__).parents[2]
REAL = ROOT / "examples" / "real_part_1021"
SLICE = "X   ,Y    ,Slice\n1.0,-0.5,Slice 1\n2.0,,Slice 1\n3.0,0.25,Slice 1\n5.0,0.5,Slice 1\n"


def read(tmp_path, text, **options):
    (tmp_path / "a.csv").write_text(text)
    return read_profile(tmp_path / "a.csv", **options)


def test_a_slice_has_its_height_in_y_and_its_unit_as_given(tmp_path):
    found = read(tmp_path, SLICE, unit="um")
    np.testing.assert_allclose(found.distance, 1e-3 * np.arange(1, 6), rtol=1e-12)
    np.testing.assert_allclose(found.z, [-5e-4, np.nan, 2.5e-4, np.nan, 5e-4], rtol=1e-12)


def test_columns_are_chosen_by_name_or_number(tmp_path):
    text = "t [s];Position [mm];Raw [nm];Filtered [nm]\n0;0.1;10;1\n1;0.2;20;2\n2;0.3;30;3\n"
    for options in (
        {"distance": "position", "height": "Filtered"},
        {"distance": "Position [mm]", "height": "FILTERED [nm]"},
        {"distance": "2", "height": "4"},
    ):
        found = read(tmp_path, text, **options)
        np.testing.assert_allclose(found.distance, [0.1, 0.2, 0.3], rtol=1e-12)
        np.testing.assert_allclose(found.z, [1e-6, 2e-6, 3e-6], rtol=1e-12)
    with pytest.raises(MapError, match=r"4 columns of numbers, 't \[s\]', .*a profile has 2"):
        read(tmp_path, text)
    with pytest.raises(MapError, match="0 columns 'Z' for the height"):
        read(tmp_path, text, distance="position", height="Z")


def test_a_falling_slice_keeps_its_places_and_steps_are_even(tmp_path):
    at = np.round(0.8711 * np.arange(400), 3)[::-1]
    rows = "\n".join(f"{x} {x / 1000}" for x in at)
    found = read(tmp_path, "x_um height_nm\n" + rows)
    assert found.step == pytest.approx(0.8711e-3, rel=1e-4)
    assert found.distance[0] == 0
    assert found.z[0] == 0
    np.testing.assert_allclose(found.z, found.distance * 1e-6, rtol=1e-3, atol=1e-12)  # 1 nm per mm, as in the file
    twice = read(tmp_path, "x_um height_nm\n" + rows + "\n" + rows.replace("\n", "5\n"), number=2)
    assert twice.distance[0] < 1e-9
    assert (np.diff(twice.z) > 0).all()


@pytest.mark.parametrize(
    ("distance", "height"),
    [
        ("X [mm]", "Z [um]"), ("x [mm]", "HEIGHT [um]"), ("Position (mm)", "Y (um)"), ("Distance_mm", "h_um"),
        ("Y [mm]", "z [um]"), ("X [mm]", "Raw [um]"), ("t [mm]", "Height [um]"), ("x_pos [mm]", "Profile [um]"),
    ],
)  # fmt: skip
def test_names_of_columns_outrank_their_order(tmp_path, distance, height):
    at, z = 0.05 * np.arange(40), 0.001 * np.arange(40) ** 2
    expected = 1e-3 * z
    for first, second, header in ((at, z, f"{distance};{height}"), (z, at, f"{height};{distance}")):
        rows = "\n".join(f"{one:.4f};{other:.4f}" for one, other in zip(first, second, strict=True))
        found = read(tmp_path, f"{header}\n{rows}\n")
        np.testing.assert_allclose(found.distance, at, atol=1e-12)
        np.testing.assert_allclose(found.z, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("header", "column"),
    [("slope,x", "slope"), ("x,Slope (urad)", "Slope"), ("X,Position", "Position"), ("Z,height", "Z")],
)
def test_columns_that_are_no_heights_are_not_taken_for_them(tmp_path, header, column):
    with pytest.raises(MapError, match=rf"'{column}.*is not the name of a"):
        read(tmp_path, f"{header}\n1.0,0.0\n2.0,0.1\n3.0,0.2\n", unit="um")


def test_a_column_of_words_is_no_height(tmp_path):
    with pytest.raises(MapError, match="no numbers in the column 'Slice' for the height"):
        read(tmp_path, SLICE, unit="um", height="Slice")


def test_one_of_several_slices_is_selected(tmp_path):
    text = SLICE + SLICE.split("\n", 1)[1].replace("Slice 1", "Slice 2").replace("0.5", "0.75")
    with pytest.raises(MapError, match="holds 2 slices"):
        read(tmp_path, text, unit="um")
    assert read(tmp_path, text, unit="um", number=2).z[-1] == pytest.approx(7.5e-4)
    with pytest.raises(InputError, match="1 to 2"):
        read(tmp_path, text, unit="um", number=3)


def test_units_are_never_guessed(tmp_path):
    with pytest.raises(MapError, match="does not state the unit of x"):
        read(tmp_path, SLICE)
    with pytest.raises(MapError, match="states the unit of its heights"):
        read(tmp_path, "x [um],z [nm]\n0.5,1\n1.5,2\n2.5,3\n", unit="mm")
    mixed = read(tmp_path, "x,z [nm]\n0.5,1\n1.5,2\n2.5,3\n", lateral_unit="um")
    assert mixed.step == pytest.approx(1e-3)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(
    "empty", [[""], ["inf"], ["-Infinity"], ["nan"], ["***"], [""] * 3, [""] * 30, ["", "inf", "nan"]]
)
def test_the_header_counts_whatever_the_first_rows_hold(tmp_path, separator, empty):
    heights = [*empty, *(f"{10 * k}.5" for k in range(40))]
    rows = [separator.join([f"{0.5 * k:.4f}", cell]) for k, cell in enumerate(heights)]
    text = "\n".join([separator.join(["X [um]", "Z [nm]"]), *rows])
    found = read(tmp_path, text)
    assert found.z.size == len(heights)
    assert np.isnan(found.z).sum() == len(empty)
    assert found.z[-1] == pytest.approx(390.5e-6)
    assert found.step == pytest.approx(0.5e-3)
    with pytest.raises(MapError, match=r"states the unit of its heights, nm: do not give unit='um'"):
        read(tmp_path, text, unit="um")
    with pytest.raises(MapError, match=r"states the unit of x, um: do not give lateral_unit='mm'"):
        read(tmp_path, text, lateral_unit="mm")


def test_a_row_that_ends_early_hides_no_header(tmp_path):
    found = read(tmp_path, "X [um],Z [nm]\n0.5\n1.5,2.0\n2.5,3.0\n3.5,4.0\n")
    assert found.z == pytest.approx([2e-6, 3e-6, 4e-6])
    assert read(tmp_path, "x [µm],z [micron]\n0.5,1\n1.5,2\n2.5,3\n", unit="um").z[0] == pytest.approx(1e-3)


def test_a_file_of_one_line_is_a_profile_and_a_map_is_none(tmp_path):
    line = HeightMap(z=np.arange(5.0)[None] * 1e-6, x=0.1 * np.arange(5), y=[0.0])
    write_map(line, tmp_path / "a.npz")
    found = read_profile(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.z, line.z[0])
    np.testing.assert_array_equal(found.distance, line.x)
    with pytest.raises(MapError, match="do not give columns or units"):
        read_profile(tmp_path / "a.npz", unit="um")
    with pytest.raises(MapError, match="not a profile"):
        read_profile(ROOT / "tests" / "data" / "measured" / "sdf-1_ascii.sdf")


def test_the_slice_of_the_real_part_is_read():
    found = read_profile(REAL / "measured_slice.csv")
    assert found.z.size == 999
    assert found.step * 1e3 == pytest.approx(0.8711, abs=2e-4)
    assert np.ptp(found.z) * 1e6 == pytest.approx(1260, abs=30)
