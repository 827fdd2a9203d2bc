"""Measured maps: what each format says, what is refused, and that no bytes whatever do more than end in a sentence.

Oracles: files packed byte by byte in `measured_files`, numbers on which independent readers agreed for real files
(tests/data/measured), prysm, x3pio and SurfaceTopography.
"""

import io
import os
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, strategies as st

from laws import examples
from measured_files import (
    COUNTS,
    PICTURE,
    RESOLUTION,
    X3P,
    al3d,
    archive,
    array_file,
    codev,
    datx,
    digital_surf,
    grid_sag,
    metropro,
    metropro_height,
    plu,
    sdf,
    sdf_text,
    single,
    x3p,
    zygo_ascii,
    zygo_xyz,
)
from turnwright import _io
from turnwright.errors import InputError, MapError
from turnwright.files import read_map, write_map
from turnwright.heightmap import HeightMap

REAL = Path(__file__).parents[1] / "data" / "measured"
UP = PICTURE[::-1]
"""The picture with rows ascending in y, as maps have them."""

NM = 1e-6
FRINGE = 632.8e-9 * 0.5 * 1.25 * 1e3


def read(tmp_path, data, name, **options):
    file = tmp_path / name
    file.write_bytes(data.encode() if isinstance(data, str) else data)
    return read_map(file, **options)


# --------------------------------------------------------------------- what each format says
FORMATS = {
    "metropro": ("a.dat", metropro(), UP * metropro_height(), (1e3 * single(RESOLUTION),) * 2, (0, 0)),
    "metropro, 4096 bytes of head": (
        "a.dat",
        metropro(kind=3, resolution=2),
        UP * metropro_height(2),
        (1e3 * single(RESOLUTION),) * 2,
        (0, 0),
    ),
    "metropro, coarse, no pictures": (
        "a.dat",
        metropro(kind=2, resolution=0, buckets=0),
        UP * metropro_height(0),
        (1e3 * single(RESOLUTION),) * 2,
        (0, 0),
    ),
    "datx in fringes": ("a.datx", datx(), UP * FRINGE, (0.025, 0.05), (0, 0)),
    "datx in nanometres": ("a.datx", datx(unit="NanoMeters"), UP * NM, (0.025, 0.05), (0, 0)),
    "datx, deflated": (
        "a.datx",
        datx(unit="MicroMeters", chunks=(2, 2), compression="gzip"),
        UP * 1e-3,
        (0.025, 0.05),
        (0, 0),
    ),
    "datx, factors in the converter": (
        "a.datx",
        datx(without=("Wavelength", "Obliquity Factor")),
        UP * FRINGE,
        (0.025, 0.05),
        (0, 0),
    ),
    "zygo ascii": ("a.asc", zygo_ascii(), UP * FRINGE / COUNTS[1], (0.025, 0.025), (0, 0)),
    "zygo ascii, one block": (
        "a.txt",
        zygo_ascii(resolution=2, empty_block=False),
        UP * FRINGE / COUNTS[2],
        (0.025, 0.025),
        (0, 0),
    ),
    "zygo xyz": ("a.xyz", zygo_xyz(), UP * 1e-3, (0.025, 0.025), (0, 0)),
    "digital surf": ("a.sur", digital_surf(), UP * 0.125 * NM, (0.5e-3, 0.25e-3), (0, 0)),
    "digital surf, 16 bits": ("a.sur", digital_surf(bits=16), UP * 0.125 * NM, (0.5e-3, 0.25e-3), (0, 0)),
    "digital surf, deflated": ("a.sur", digital_surf(packed=True), UP * 0.125 * NM, (0.5e-3, 0.25e-3), (0, 0)),
    "sdf 1, 16 bits": ("a.sdf", sdf(revision=1, kind=5), UP * NM, (0.002, 0.003), (0, 0)),
    "sdf 2": ("a.sdf", sdf(), UP * NM, (0.002, 0.003), (0, 0)),
    "sdf 2, 64 bits": ("a.sdf", sdf(kind=7), UP * NM, (0.002, 0.003), (0, 0)),
    "sdf text": ("a.sdf", sdf_text(), UP * NM, (0.002, 0.003), (0, 0)),
    "x3p": ("a.x3p", x3p(), UP * NM, (0.002, 0.003), (1, -2)),
    "grid sag": ("a.dat", grid_sag(), UP, (0.5, 0.25), (0.25, -2.25)),
    "grid sag in inches": ("a.dat", grid_sag(unit=2), UP * 25.4, (12.7, 6.35), (6.35, -57.15)),
    "plu": ("a.plu", plu(), UP * 1e-3, (0.002, 0.003), (0, 0)),
    "al3d": ("a.al3d", al3d(), UP * NM, (0.002, 0.003), (0, 0)),
}


@pytest.mark.parametrize(("name", "data", "z", "pixel", "start"), FORMATS.values(), ids=FORMATS)
def test_heights_pixels_missing_points_and_the_way_up(tmp_path, name, data, z, pixel, start):
    found = read(tmp_path, data, name)
    np.testing.assert_allclose(found.z, z, rtol=2e-7 if "al3d" in name else 1e-14)
    np.testing.assert_allclose(found.x, start[0] + pixel[0] * np.arange(4), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(found.y, start[1] + pixel[1] * np.arange(3), rtol=1e-14, atol=1e-15)
    assert found.calibrated
    assert found.name == name
    assert found.metadata["format"]


@pytest.mark.parametrize(
    "name", ["metropro", "datx in fringes", "digital surf", "sdf 2", "sdf text", "x3p", "grid sag"]
)
def test_the_bytes_tell_the_format_whatever_the_name(tmp_path, name):
    _, data, z, *_ = FORMATS[name]
    np.testing.assert_allclose(read(tmp_path, data, "unnamed").z, z, rtol=1e-14)


def test_what_the_file_says_is_kept(tmp_path):
    message = read(tmp_path, metropro(), "a.dat").metadata
    assert message["comment"] == "a dish"
    assert message["objective"] == "Sm Aperture"
    assert message["wavelength"] == "632.8 nm"
    assert message["timestamp"] == "2015-04-24T19:54:52+00:00"
    assert read(tmp_path, zygo_ascii(), "a.asc").metadata["part"] == "part 7"
    assert read(tmp_path, datx(), "a.datx").metadata["part number"] == "7b"
    assert read(tmp_path, digital_surf(), "a.sur").metadata["comment"] == "a dish"
    assert read(tmp_path, digital_surf(), "a.sur").metadata["date"] == "2010-01-04T08:42:09"
    assert read(tmp_path, sdf_text(), "a.sdf").metadata["comment"] == "OperatorName = Jane Doe"
    message = read(tmp_path, x3p(), "a.x3p").metadata
    assert (message["manufacturer"], message["comment"], message["date"]) == (
        "M",
        "a dish",
        "2010-01-04T08:42:09+00:00",
    )


@pytest.mark.parametrize("resolution", COUNTS)
def test_prysm_reads_the_same_heights_from_metropro(tmp_path, resolution):
    from prysm.io import read_zygo_dat

    found = read(tmp_path, metropro(resolution=resolution), "a.dat")
    np.testing.assert_allclose(found.z[::-1] * 1e6, read_zygo_dat(tmp_path / "a.dat")["phase"], rtol=1e-12)


# What independent readers agreed on: shape, pixel, missing points, lowest, highest and standard deviation. [m]
AGREED = {
    "gpi_mirror_strip.datx": (
        (259, 33),
        (0.0010000000474974513,) * 2,
        776,
        (-1.4647505221458094e-07, 3.0655542666074594e-07, 8.081765263965922e-08),
    ),
    "sdf-1_ascii.sdf": ((4, 7), (1e-6, 1e-6), 0, (9.4907e-07, 1e-06, 1.3602897289488263e-08)),
    "sdfio_iso1_surface_ascii.sdf": (
        (32, 48),
        (2e-6, 3e-6),
        40,
        (-1.2925e-06, 1.2925e-06, 5.447817349184698e-07),
    ),
    "sdfio_iso2_surface_int32_binary.sdf": (
        (32, 48),
        (2e-6, 3e-6),
        40,
        (-1.2924784e-06, 1.2924784e-06, 5.447778199258682e-07),
    ),
}


@pytest.mark.parametrize("name", AGREED)
def test_real_files_come_out_as_independent_readers_agreed(name):
    shape, pixel, missing, values = AGREED[name]
    found = read_map(REAL / name)
    valid = found.z[~np.isnan(found.z)]
    assert found.z.shape == shape
    assert np.isnan(found.z).sum() == missing
    np.testing.assert_allclose((found.x[1], found.y[1]), np.array(pixel) * 1e3, rtol=1e-12)
    np.testing.assert_allclose((valid.min(), valid.max(), valid.std()), np.array(values) * 1e3, rtol=1e-12)


def test_a_profile_is_one_row(tmp_path):
    found = read(tmp_path, sdf(PICTURE[:1]), "a.sdf")
    np.testing.assert_allclose(found.z, PICTURE[:1] * NM, rtol=1e-14)
    assert found.y.tolist() == [0.0]


def test_a_cloud_of_points_is_scattered(tmp_path):
    import x3pio

    points = np.random.default_rng(3).normal(size=(20, 3))
    x3pio.PointCloud.from_points(points).save(tmp_path / "a.x3p")
    found = read_map(tmp_path / "a.x3p")
    assert found.scattered
    np.testing.assert_allclose(np.column_stack([found.x, found.y, found.z]), points * 1e3, rtol=1e-14)


# --------------------------------------------------------------------- pixels without a size
UNSIZED = {
    "metropro": ("a.dat", metropro(pixel=0.0)),
    "datx": ("a.datx", datx(pixel=0.0)),
    "datx without converters": ("a.datx", datx(without=("X Converter", "Y Converter"))),
    "zygo ascii": ("a.asc", zygo_ascii(pixel=0)),
    "zygo xyz": ("a.xyz", zygo_xyz(pixel=0)),
    "npy": ("a.npy", array_file(PICTURE)),
}


@pytest.mark.parametrize(("name", "data"), UNSIZED.values(), ids=UNSIZED)
def test_an_uncalibrated_file_asks_for_its_pixel_size(tmp_path, name, data):
    found = read(tmp_path, data, name)
    assert not found.calibrated
    assert found.x.tolist() == [0, 1, 2, 3]
    with pytest.raises(InputError, match="pixel_size"):
        found.require_calibrated()
    sized = read(tmp_path, data, name, pixel_size=(0.1, 0.2))
    assert sized.calibrated
    np.testing.assert_allclose((sized.x[-1], sized.y[-1]), (0.3, 0.4), rtol=1e-15)
    np.testing.assert_array_equal(sized.z, found.z)


def test_a_pixel_size_for_a_file_that_has_one_is_refused(tmp_path):
    with pytest.raises(MapError, match=r"do not give pixel_size=0\.1"):
        read(tmp_path, metropro(), "a.dat", pixel_size=0.1)


def test_a_wrong_pixel_size_is_refused(tmp_path):
    for size in (-1.0, 0.0, np.nan, (0.1, -0.1)):
        with pytest.raises(InputError, match="must be finite and above 0 mm"):
            read(tmp_path, metropro(pixel=0.0), "a.dat", pixel_size=size)
    with pytest.raises(MapError, match="pixel_size has 3 values"):
        read(tmp_path, metropro(pixel=0.0), "a.dat", pixel_size=(1, 2, 3))
    assert read(tmp_path, metropro(pixel=0.0), "a.dat", pixel_size=[1, 2]).y.tolist() == [0, 2, 4]


def test_a_unit_for_a_file_that_has_one_is_refused(tmp_path):
    for name, data, *_ in FORMATS.values():
        with pytest.raises(MapError, match="do not give unit='um'"):
            read(tmp_path, data, name, unit="um")


# --------------------------------------------------------------------- text
GRID = "\n".join(f"{x} {y} {100 * y + x}" for y in (0, 5, 10) for x in (0.5, 1.0, 1.5, 2.0))
GRID_Z = np.array([[0.5, 1, 1.5, 2], [500.5, 501, 501.5, 502], [1000.5, 1001, 1001.5, 1002]])


def with_(text, *changes):
    for old, new in changes:
        text = text.replace(old, new)
    return text


TEXTS = {
    "spaces": (GRID, "mm", 1),
    "tabs and a line of names": ("X\tY\tZ\n" + with_(GRID, (" ", "\t")), "mm", 1),
    "commas, units beside the names": ("x [mm],y [mm],z [mm]\n" + with_(GRID, (" ", ",")), None, 1),
    "semicolons and decimal commas": ("x/mm;y/mm;z/mm\n" + with_(GRID, (" ", ";"), (".", ",")), None, 1),
    "spaces and decimal commas": ("# unit: um\n" + with_(GRID, (".", ",")), None, 1e-3),
    "tabs and decimal commas": (with_(GRID, (" ", "\t"), (".", ",")), "um", 1e-3),
    "commas with spaces": (with_(GRID, (" ", ", ")), "mm", 1),
    "quoted names": ('"X (um)","Y (um)","Z (um)"\n' + with_(GRID, (" ", ",")), None, 1e-3),
    "remarks between": ("% made by hand\n" + with_(GRID, ("\n0.5 5", "\n# second row\n0.5 5")), "mm", 1),
    "blank lines between": (with_(GRID, ("\n0.5 5", "\n\n0.5 5")), "mm", 1),
    "Windows lines and a mark": ("\ufeffx_mm y_mm z_mm\r\n" + with_(GRID, ("\n", "\r\n")) + "\r\n", None, 1),
    "micro signs": ("x [µm] y [μm] z [micron]\n" + GRID, None, 1e-3),
    "stated for all": ("Instrument ABC 123\nUnits = nm\n" + GRID, None, 1e-6),
    "another order": (
        "z [mm] y [mm] x [mm]\n" + "\n".join(" ".join(reversed(line.split())) for line in GRID.splitlines()),
        None,
        1,
    ),
    "more columns": (
        "no,x [mm],y [mm],z [mm],note\n"
        + "\n".join(f"{k}," + line.replace(" ", ",") + ",ok then" for k, line in enumerate(GRID.splitlines())),
        None,
        1,
    ),
    "rows from the top": ("\n".join(reversed(GRID.splitlines())), "mm", 1),
    "columns first": ("\n".join(sorted(GRID.splitlines())), "mm", 1),
    "exponents": (with_(GRID, ("0.5 ", "5.0E-1 ")), "mm", 1),
}


@pytest.mark.parametrize(("text", "unit", "scale"), TEXTS.values(), ids=TEXTS)
def test_points_of_a_lattice_become_a_grid(tmp_path, text, unit, scale):
    found = read(tmp_path, text, "a.csv", unit=unit)
    np.testing.assert_allclose(found.z, GRID_Z * scale, rtol=1e-14)
    np.testing.assert_allclose(found.x, np.array([0.5, 1, 1.5, 2]) * scale, rtol=1e-14)
    np.testing.assert_allclose(found.y, np.array([0, 5, 10]) * scale, rtol=1e-14)
    assert found.calibrated


def test_text_in_sixteen_bits(tmp_path):
    data = ("x [µm]\ty [µm]\tz [nm]\n" + GRID.replace(" ", "\t")).encode("utf-16")
    found = read(tmp_path, data, "a.txt")
    np.testing.assert_allclose(found.z, GRID_Z * 1e-6, rtol=1e-14)
    np.testing.assert_allclose(found.x[-1], 2e-3, rtol=1e-14)


def test_lateral_and_height_units_may_differ(tmp_path):
    found = read(tmp_path, "XY unit: mm\nZ unit: nm\n" + GRID, "a.xyz")
    np.testing.assert_allclose((found.x[-1], found.z[-1, -1]), (2.0, 1002e-6), rtol=1e-14)


@pytest.mark.parametrize("word", ["nan", "NaN", "No Data", "***", "---", "BAD", "", "N/A", '""'])
def test_words_for_missing_heights(tmp_path, word):
    text = "x [mm];y [mm];z [mm]\n" + with_(GRID, (" ", ";"), (";501.0\n", f";{word}\n")) + "\n\n"
    found = read(tmp_path, text, "a.csv")
    assert np.isnan(found.z[1, 1])
    assert np.isnan(found.z).sum() == 1


def test_places_of_a_lattice_that_are_not_listed_are_missing(tmp_path):
    lines = [line for line in GRID.splitlines() if not line.startswith(("1.0 5", "1.5 5", "2.0 0"))]
    found = read(tmp_path, "\n".join(lines), "a.xyz", unit="mm")
    assert found.z.shape == (3, 4)
    assert np.argwhere(np.isnan(found.z)).tolist() == [[0, 3], [1, 1], [1, 2]]


def test_a_codev_interferogram_is_in_pixels(tmp_path):
    found = read(tmp_path, codev(), "a.int")
    np.testing.assert_allclose(found.z, UP * 0.6328e-3 / 20000, rtol=1e-14)
    assert (found.calibrated, found.metadata["title"]) == (False, "a dish")
    np.testing.assert_allclose(read(tmp_path, codev(), "a.int", pixel_size=0.1).x, [0, 0.1, 0.2, 0.3])


def test_an_unlisted_column_has_missing_heights(tmp_path):
    lines = [f"{x} {y} 1" for y in range(6) for x in (0, 1, 2, 4, 5, 6, 7)]
    found = read(tmp_path, "\n".join(lines), "a.xyz", unit="mm")
    assert found.x.tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert np.isnan(found.z[:, 3]).all()


def test_rounded_places_are_put_back_on_even_steps(tmp_path):
    x = np.arange(40) / 3
    text = "\n".join(f"{a:.3f} {b:.3f} {a * b:.6f}" for b in x for a in x)
    found = read(tmp_path, text, "a.xyz", unit="mm")
    assert found.z.shape == (40, 40)
    assert np.ptp(np.diff(found.x)) < 1e-13
    np.testing.assert_allclose(found.x, x, atol=0.5e-3)


def test_uneven_steps_are_kept_as_they_are(tmp_path):
    x = [0.0, 1.0, 3.0, 4.0, 6.0]
    found = read(tmp_path, "\n".join(f"{a} {b} 1" for b in x for a in x), "a.xyz", unit="mm")
    assert found.x.tolist() == x
    assert found.z.shape == (5, 5)


def test_points_anywhere_stay_points(tmp_path):
    points = np.random.default_rng(1).uniform(-1, 1, (200, 3))
    found = read(tmp_path, "\n".join(f"{x!r} {y!r} {z!r}" for x, y, z in points.tolist()), "a.xyz", unit="mm")
    assert found.scattered
    np.testing.assert_array_equal(np.column_stack([found.x, found.y, found.z]), points)


def test_a_grid_with_a_place_twice_stays_points(tmp_path):
    assert read(tmp_path, GRID + "\n0.5 0 7", "a.xyz", unit="mm").scattered


def test_pixels_are_counted_from_the_top(tmp_path):
    text = "x [px] y [px] z [um]\n" + "\n".join(f"{x} {y} {PICTURE[y, x]}" for y in range(3) for x in range(4))
    found = read(tmp_path, text, "a.csv")
    assert not found.calibrated
    np.testing.assert_allclose(found.z, UP * 1e-3, rtol=1e-14)


def test_a_bare_table_is_a_picture(tmp_path):
    picture = np.arange(60.0).reshape(5, 12) + 0.5
    text = "\n".join(",".join(map(str, row)) for row in picture.tolist())
    found = read(tmp_path, text, "a.csv", unit="nm")
    np.testing.assert_allclose(found.z, picture[::-1] * NM, rtol=1e-14)
    assert not found.calibrated


def test_two_named_columns_are_a_profile(tmp_path):
    found = read(tmp_path, "x [mm],z [um]\n" + "\n".join(f"{k / 4},{k * k}" for k in range(9)), "a.csv")
    np.testing.assert_allclose(found.z, [np.arange(9.0) ** 2 * 1e-3], rtol=1e-14)
    assert found.y.tolist() == [0.0]


OPEN_QUESTIONS = {
    "no unit": (GRID, "does not state the unit of x: give it as unit='mm'"),
    "a unit of one column only": ("x [mm] y [mm] z\n" + GRID, "does not state the unit of z"),
    "two units": ("unit: mm\nunit: um\n" + GRID, "states the units mm, um for x, only 1 is allowed"),
    "megametres": ("x [Mm] y [Mm] z [Mm]\n" + GRID, "'Mm', the known units"),
    "no unit of length": ("x [V] y [V] z [V]\n" + GRID, "names its columns|does not state"),
    "commas that part or are decimals": ("0,5,1,5,2,5\n" * 5, "ambiguous"),
    "commas that may part thousands": ("1,000 2,000 3,000\n" * 5, "ambiguous"),
    "the same with semicolons": ("1,000;2,000;3,000\n" * 5, "ambiguous"),
    "four columns without names": ("1 2 3 4\n" * 5, "4 columns without names"),
    "two columns without names": ("1 2\n" * 5, "2 columns without names"),
    "names of something else": ("x [mm],slope [urad]\n" + "1.5,2\n" * 5, "x, y and z"),
    "a column twice": ("x [mm] x [mm] z [mm]\n" + GRID, "2 columns x, only 1 is allowed"),
    "a short line": ("# unit: mm\n" + with_(GRID, ("1.5 10 1001.5", "1.5 10")), "same columns"),
    "a long line": ("# unit: mm\n" + with_(GRID, ("1.5 10 1001.5", "1.5 10 1001.5 9")), "same columns"),
    "a first line of other length": ("4 3\n" + GRID, "unlike the lines below"),
    "a word": ("# unit: mm\n" + with_(GRID, ("1001.5", "much")), "cannot be read"),
    "pixels as heights": ("x [px] y [px] z [px]\n" + GRID, "in pixels"),
    "heights without a place": ("# unit: mm\n" + with_(GRID, ("1.5 10 ", "nan 10 ")), "heights without"),
    "no numbers": ("it was a dark and stormy night\n" * 5, "no table of numbers"),
}


@pytest.mark.parametrize(("text", "message"), OPEN_QUESTIONS.values(), ids=OPEN_QUESTIONS)
def test_what_would_have_to_be_guessed_is_refused(tmp_path, text, message):
    with pytest.raises(MapError, match=message):
        read(tmp_path, text, "a.csv")


def test_a_unit_that_the_text_states_cannot_be_given_too(tmp_path):
    with pytest.raises(MapError, match="do not give unit='nm'"):
        read(tmp_path, "# unit: mm\n" + GRID, "a.csv", unit="nm")


# --------------------------------------------------------------------- arrays
def test_named_arrays_may_be_meshes_and_descend(tmp_path):
    x, y = np.meshgrid([3.0, 2.0, 1.0, 0.0], [0.0, -1.0, -2.0])
    data = array_file(None, x=x, y=y, z=PICTURE)
    found = read(tmp_path, data, "a.npz")
    assert found.x.tolist() == [0, 1, 2, 3]
    assert found.y.tolist() == [-2, -1, 0]
    np.testing.assert_array_equal(found.z, PICTURE[::-1, ::-1])


def test_meshes_of_a_turned_grid_are_points(tmp_path):
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0))
    assert read(tmp_path, array_file(None, x=x + y / 9, y=y - x / 9, z=PICTURE), "a.npz").scattered


ARRAYS = {
    "a number without end": (
        "a.npy",
        array_file(PICTURE).replace(b"4), }" + 50 * b" ", b"4" + 54 * b"4"),
        "not of real numbers",
    ),
    "objects": ("a.npy", array_file(np.array([{}, 1], dtype=object)), "not of real numbers"),
    "complex numbers": ("a.npy", array_file(np.ones((4, 4), dtype=complex)), "not of real numbers"),
    "three columns": ("a.npy", array_file(np.ones((9, 3))), "may be points or a grid"),
    "one dimension": ("a.npy", array_file(np.ones(9)), "may be points or a grid"),
    "no x": ("a.npz", array_file(None, z=PICTURE, y=np.arange(3.0)), "it needs z with x and y"),
    "axes exchanged": ("a.npz", array_file(None, z=PICTURE, x=np.arange(3.0), y=np.arange(4.0)), "rows of z are y"),
    "an axis to and fro": ("a.npz", array_file(None, z=PICTURE, x=np.array([0, 2, 1, 3]), y=np.arange(3)), "ascend"),
    "a nan in an axis": ("a.npz", array_file(None, z=PICTURE, x=np.array([0, np.nan, 2, 3]), y=np.arange(3)), "ascend"),
    "metadata of another kind": (
        "a.npz",
        array_file(None, z=PICTURE, x=np.arange(4), y=np.arange(3), metadata=np.array("[1]")),
        "not a JSON object",
    ),
}


@pytest.mark.parametrize(("name", "data", "message"), ARRAYS.values(), ids=ARRAYS)
def test_arrays_that_are_no_maps_are_refused(tmp_path, name, data, message):
    with pytest.raises(MapError, match=message):
        read(tmp_path, data, name)


# --------------------------------------------------------------------- there and back
MAPS = st.builds(
    lambda z, x0, y0, dx, dy, name, metadata: HeightMap(
        z=z,
        x=x0 + dx * np.arange(z.shape[1]),
        y=y0 + dy * np.arange(z.shape[0]),
        name=name,
        metadata=metadata,
    ),
    st.tuples(st.integers(6, 9), st.integers(6, 9), st.integers(0, 2**32 - 1)).map(
        lambda shape: np.where(
            np.random.default_rng(shape[2]).random(shape[:2]) < 0.2,
            np.nan,
            np.random.default_rng(shape[2]).normal(scale=1e-3, size=shape[:2]),
        )
    ),
    st.floats(-100, 100),
    st.floats(-100, 100),
    st.floats(1e-4, 10),
    st.floats(1e-4, 10),
    # NumPy ends a text at its trailing zero characters.
    st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=10),
    st.dictionaries(st.text(max_size=5), st.text(max_size=10), max_size=3),
)
LAW = examples(25, suppress_health_check=[HealthCheck.function_scoped_fixture])


@LAW
@given(MAPS)
def test_npz_keeps_a_map_bit_by_bit(tmp_path, one):
    write_map(one, tmp_path / "a.npz")
    again = read_map(tmp_path / "a.npz")
    for name in ("x", "y", "z"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))
    assert (again.name, again.metadata, again.calibrated) == (one.name, one.metadata, True)


@LAW
@given(MAPS, st.sampled_from(["x3p", "grid sag"]))
def test_other_formats_keep_a_map_to_rounding(tmp_path, one, kind):
    write_map(one, tmp_path / "a.dat", format=kind)
    again = read_map(tmp_path / "a.dat")
    np.testing.assert_allclose(again.z, one.z, rtol=1e-15)
    for name in ("x", "y"):
        largest = np.abs(getattr(one, name)).max()
        np.testing.assert_allclose(getattr(again, name), getattr(one, name), rtol=0, atol=4e-15 * largest)


def test_npz_keeps_polar_grids_points_and_pixels(tmp_path):
    polar = HeightMap(z=PICTURE, radius=np.arange(4.0), angle=np.arange(3.0))
    points = HeightMap(z=PICTURE[0], x=np.arange(4.0), y=np.zeros(4))
    pixels = HeightMap(z=PICTURE, x=np.arange(4.0), y=np.arange(3.0), calibrated=False)
    for one in (polar, points, pixels):
        write_map(one, tmp_path / "a.npz")
        again = read_map(tmp_path / "a.npz")
        np.testing.assert_array_equal(again.z, one.z)
        assert (again.polar, again.scattered, again.calibrated) == (one.polar, one.scattered, one.calibrated)


@pytest.mark.parametrize(
    ("name", "data"),
    {
        "grid": ("a.npz", array_file(None, z=[[0.0, np.inf], [-np.inf, np.nan]], x=[0.0, 1.0], y=[0.0, 1.0])),
        "polar": ("a.npz", array_file(None, z=[[0.0, np.inf], [-np.inf, np.nan]], radius=[0.0, 1.0], angle=[0.0, 1.0])),
        "bare": ("a.npy", array_file(np.array([[0.0, np.inf], [-np.inf, np.nan]]))),
        "points": ("a.npz", array_file(None, z=[0.0, np.inf, -np.inf, np.nan], x=[0.0, 1, 0, 2], y=[0.0, 0.1, 1, 2])),
        "text": ("a.csv", b"x [mm],y [mm],z [mm]\n0,0.5,0\n1,0.5,1e999\n0,1.5,-1e999\n1,1.5,nan\n"),
        "crossed": ("a.csv", b"# z unit: mm\n# x unit: mm\n# y unit: mm\ny,0,1.5,2\n0,0,1e999,0\n1,-1e999,nan,0\n"),
    }.values(),
)
def test_an_infinite_height_is_missing_in_every_format(tmp_path, name, data):
    found = read(tmp_path, data, name)
    assert np.count_nonzero(np.isnan(found.z)) == 3
    assert (found.z[np.isfinite(found.z)] == 0).all()


def test_a_damaged_file_is_refused_and_nothing_is_printed(tmp_path, capfd, caplog):
    damaged = b"\1\0" + b"Directory" + bytes(range(256)) * 4000
    for suffix in (".opd", ".al3d", ".frt", ".vk4", ".opdx", ".os3d", ".lext"):
        with pytest.raises(MapError, match="cannot be read by SurfaceTopography"):
            read(tmp_path, damaged, f"a{suffix}")
    assert len("".join(capfd.readouterr())) == 0
    assert caplog.text == ""


def test_an_npz_of_other_names_is_refused_with_the_names_it_has(tmp_path):
    with pytest.raises(MapError, match=r"'X', 'heights', .*z with x and y"):
        read(tmp_path, array_file(None, heights=PICTURE, X=np.arange(4.0), y=np.arange(3.0)), "a.npz")
    many = {f"array_{k:03d}": np.zeros(2) for k in range(300)}
    with pytest.raises(MapError, match="and 292 more, it needs z"):
        read(tmp_path, array_file(None, **many), "a.npz")


def test_other_programs_read_a_written_x3p_alike(tmp_path):
    import x3pio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its own imports
        from SurfaceTopography.IO import open_topography

    one = HeightMap(z=UP * 1e-6, x=5 + 0.002 * np.arange(4), y=0.003 * np.arange(3), metadata={"part": "7b"})
    write_map(one, tmp_path / "a.x3p")
    message = zipfile.ZipFile(tmp_path / "a.x3p").read("main.xml").decode()
    assert "<Revision>ISO5436 - 2000</Revision>" in message
    file = x3pio.read(tmp_path / "a.x3p")
    assert file.metadata.comment == "part: 7b"
    np.testing.assert_allclose(file.layers[0].z, UP * 1e-9, rtol=1e-15)
    with open_topography(str(tmp_path / "a.x3p")) as reader:
        topography = reader.topography()
    assert topography.unit == "m"
    np.testing.assert_allclose(np.ma.filled(topography.heights(), np.nan).T, UP * 1e-9, rtol=1e-12)
    np.testing.assert_allclose(topography.physical_sizes, (8e-6, 9e-6), rtol=1e-12)


def test_surface_topography_reads_the_same_heights_from_plu(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its own imports
        from SurfaceTopography.IO import open_topography

    found = read(tmp_path, plu(PICTURE * 1.1), "a.plu")
    with open_topography(str(tmp_path / "a.plu"), format="plu") as reader:
        topography = reader.topography()
    assert topography.unit == "µm"
    np.testing.assert_array_equal(np.ma.filled(topography.heights(), np.nan).T[::-1] * 1e-3, found.z)
    np.testing.assert_allclose(topography.physical_sizes, (8, 9), rtol=1e-15)


def test_a_grid_sag_begins_at_the_top_left(tmp_path):
    z = np.arange(42.0).reshape(6, 7)
    write_map(HeightMap(z=z, x=np.arange(7.0), y=2 * np.arange(6.0)), tmp_path / "a.dat", format="grid sag")
    lines = (tmp_path / "a.dat").read_text().splitlines()
    assert lines[0].split() == ["7", "6", "1.0", "2.0", "0", "3.0", "5.0"]
    assert [float(line.split()[0]) for line in lines[1:]] == z[::-1].ravel().tolist()


NARROW = HeightMap(z=np.zeros((5, 6)), x=np.arange(6.0), y=2 * np.arange(5.0), name="narrow")
FLAT = HeightMap(z=np.zeros((5, 5)), x=np.arange(5.0), y=np.arange(5.0), name="flat")
UNWRITABLE = {
    "suffix": (FLAT, "a.csv", "formats by suffix are"),
    "suffix of two formats": (FLAT, "a.dat", "state the format, npz, x3p, grid sag"),
    "few rows": (NARROW, "a.grd", "5 rows and 6 columns, .* at least 6"),
    "oblong": (NARROW, "a.int", "pixels of 1 x 2 mm, CODE V files hold square ones"),
    "uneven": (
        HeightMap(z=np.zeros((5, 5)), x=np.arange(5.0) ** 2, y=np.arange(5.0)),
        "a.x3p",
        "deviates from even steps",
    ),
    "polar": (HeightMap(z=PICTURE, radius=np.arange(4.0), angle=np.arange(3.0)), "a.x3p", "a polar grid"),
    "points": (HeightMap(z=PICTURE[0], x=np.arange(4.0), y=np.zeros(4)), "a.int", "scattered points"),
    "pixels": (
        HeightMap(z=PICTURE, x=np.arange(4.0), y=np.arange(3.0), calibrated=False),
        "a.x3p",
        "no pixel size",
    ),
    "no folder": (FLAT, "none/a.npz", "check its folder"),
}


@pytest.mark.parametrize(("one", "name", "message"), UNWRITABLE.values(), ids=UNWRITABLE)
def test_map_that_a_format_cannot_hold_is_refused_without_a_file(tmp_path, one, name, message):
    with pytest.raises(MapError, match=message):
        write_map(one, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------- damage and harm
def hollow_hdf5(shape):
    """A file of a few bytes that says it holds a huge table."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        surface = file.create_dataset("Data/Surface/a", shape=shape, dtype="f8", chunks=(16, 16))
        surface.attrs["Unit"] = "NanoMeters"
    return buffer.getvalue()


def other_hdf5(*, link):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        if link:
            file["Data/Surface/a"] = h5py.ExternalLink("/etc/passwd", "/a")
        else:
            file["something"] = 1
    return buffer.getvalue()


def huge_npy(shape):
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return buffer.getvalue() + bytes(64)


LAUGHS = '<!DOCTYPE l [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>'
BAD = {
    "empty": ("a.dat", b"", "0 bytes"),
    "rubbish": ("a.dat", bytes(range(256)) * 4, "unknown format"),
    "metropro, head cut": ("a.dat", metropro()[:500], "834 bytes"),
    "metropro, phase cut": ("a.dat", metropro()[:-1], "truncated"),
    "metropro, no phase": ("a.dat", metropro(columns=0), "0 columns"),
    "metropro, too large": ("a.dat", metropro(columns=65535, rows=65535), "the limit is"),
    "metropro, phase resolution": ("a.dat", metropro(**{"phase resolution": 3}), "phase resolution 3"),
    "metropro, nan pixel": ("a.dat", metropro(pixel=np.nan), "pixel size of nan mm"),
    "metropro, negative pixel": ("a.dat", metropro(pixel=-1.0), "pixel size of -1000 mm"),
    "metropro, no wavelength": ("a.dat", metropro(wavelength=0.0), "wavelength 0 m"),
    "metropro, inverted": ("a.dat", metropro(sign=1), "sign of z"),
    "metropro, contradiction": ("a.dat", metropro(**{"camera bytes": 3}), "they must agree"),
    "datx, other HDF5": ("a.datx", other_hdf5(link=False), "without a group Data/Surface"),
    "datx, link elsewhere": ("a.datx", other_hdf5(link=True), "no table of heights"),
    "datx, hollow": ("a.datx", hollow_hdf5((10_000, 10_000)), "damaged or malicious"),
    "datx, huge": ("a.datx", hollow_hdf5((1_000_000_000, 1_000_000_000)), "the limit is"),
    "datx, unit": ("a.datx", datx(unit="Volts"), "'Volts', the known units"),
    "datx, no factors": ("a.datx", datx(without=("Wavelength", "Z Converter")), "must be finite"),
    "datx, cut": ("a.datx", datx()[:3000], "damaged"),
    "zygo ascii, cut": ("a.asc", zygo_ascii()[:-30], "phases for 3 rows of 4"),
    "zygo ascii, head cut": ("a.asc", b"\n".join(zygo_ascii().split(b"\n")[:6]) + b"\n#\n", "lines of description"),
    "zygo ascii, huge": ("a.asc", zygo_ascii().replace(b"10 20 4 3", b"0 0 1000000000 1000000000"), "the limit is"),
    "zygo ascii, large": ("a.asc", zygo_ascii().replace(b"10 20 4 3", b"0 0 10000 10000"), "truncated"),
    "zygo ascii, negative": ("a.asc", zygo_ascii().replace(b"10 20 4 3", b"0 0 -4 -3"), "-4 columns"),
    "zygo ascii, nan": ("a.asc", zygo_ascii().replace(b"10 20 4 3", b"0 0 nan 3"), "must be an integer"),
    "zygo ascii, word": ("a.asc", zygo_ascii().replace(b"10 20 4 3", b"0 0 four 3"), "no number 3 in its line 4"),
    "zygo xyz, outside": ("a.xyz", zygo_xyz().replace(b"13 22 1500", b"14 22 1500"), "outside its 4 x 3 pixels"),
    "zygo xyz, twice": ("a.xyz", zygo_xyz().replace(b"13 22 1500", b"12 22 1500"), "two heights at one pixel"),
    "digital surf, cut": ("a.sur", digital_surf()[:-3], "truncated"),
    "digital surf, negative": ("a.sur", digital_surf(columns=-4, rows=-3), "-4 columns"),
    "digital surf, points": ("a.sur", digital_surf(points=13), "13 points for 4 x 3"),
    "digital surf, many": ("a.sur", digital_surf(objects=5), "save the surface alone"),
    "digital surf, series": ("a.sur", digital_surf(kind=5), "save the surface alone"),
    "digital surf, inverted": ("a.sur", digital_surf(inverted=1), "has inverted 1"),
    "digital surf, unit": ("a.sur", digital_surf(**{"unit z": b"V"}), "'V', the known units"),
    "digital surf, nan": ("a.sur", digital_surf(**{"step x": np.nan}), "pixel size of nan mm"),
    "digital surf, deflated to much": (
        "a.sur",
        digital_surf(packed=True, columns=14000, rows=14000, points=196_000_000),
        "damaged or malicious",
    ),
    "sdf, cut": ("a.sdf", sdf()[:-2], "damaged"),
    "sdf, huge": ("a.sdf", sdf(shape=(2**32 - 1, 2**32 - 1)), "damaged"),
    "sdf, empty": ("a.sdf", sdf(shape=(0, 0)), "0 columns"),
    "sdf, nan pixel": ("a.sdf", sdf(scales=(np.nan, 1e-6, 1e-9)), "pixel size of nan mm"),
    "sdf, height scale": ("a.sdf", sdf(scales=(1e-6, 1e-6, np.inf)), "scales its heights by inf"),
    "sdf text, huge": ("a.sdf", sdf_text().replace(b"NumPoints = 4", b"NumPoints = 1000000000"), "damaged"),
    "sdf text, negative": (
        "a.sdf",
        sdf_text().replace(b"NumPoints = 4", b"NumPoints = -4").replace(b"NumProfiles = 3", b"NumProfiles = -3"),
        "damaged",
    ),
    "x3p, no zip": ("a.x3p", x3p()[:200], "cannot be opened"),
    "x3p, size": ("a.x3p", x3p(columns=5), "damaged"),
    "x3p, huge": ("a.x3p", x3p(columns=1_000_000_000, rows=1_000_000_000), "damaged"),
    "x3p, negative": ("a.x3p", x3p(columns=-4, rows=-3), "damaged"),
    "x3p, nan pixel": ("a.x3p", x3p(x="nan"), "damaged"),
    "x3p, laughs": ("a.x3p", x3p(before=LAUGHS, comment="&c;&c;&c;"), "damaged"),
    "x3p, bomb": ("a.x3p", x3p(data=bytes((1 << 28) + 8), columns=1 << 13, rows=(1 << 12) + 1), "damaged or malicious"),
    "x3p, XML bomb": ("a.x3p", archive({"main.xml": X3P.encode() + b" " * (70 << 20)}), "bytes of XML"),
    "x3p, other zip": ("a.x3p", archive({"a.txt": b"hello"}), "neither an .x3p nor an .npz"),
    "npy, huge": ("a.npy", huge_npy((1_000_000_000, 1_000_000_000)), "the limit is"),
    "npy, cut": ("a.npy", huge_npy((10_000, 10_000)), "truncated"),
    "npy, negative": ("a.npy", huge_npy((-4, -4)), "header is damaged"),
    "npz, huge": ("a.npz", archive({f"{k}.npy": huge_npy((10**9, 10**9)) for k in "xyz"}), "the limit is"),
    "npz, cut": ("a.npz", archive({f"{k}.npy": huge_npy((10_000, 10_000)) for k in "xyz"}), "truncated"),
    "grid sag, cut": ("a.dat", grid_sag()[:-20], "points for 4 x 3|cannot be read"),
    "grid sag, huge": ("a.dat", b"1000000000 1000000000 1 1 0 0 0\n0 0 0 0\n", "the limit is"),
    "grid sag, large": ("a.dat", b"10000 10000 1 1 0 0 0\n0 0 0 0\n", "truncated"),
    "codev, cut": ("a.int", codev()[:-20], "counts for 4 x 3"),
    "codev, huge": ("a.int", codev(head="GRD 1000000000 1000000000 SUR WVL 1 SSZ 1"), "the limit is"),
    "codev, large": ("a.int", codev(head="GRD 10000 10000 SUR WVL 1 SSZ 1"), "truncated"),
    "codev, nan": ("a.int", codev(head="GRD nan 3 SUR WVL 1 SSZ 1"), "must be integers"),
    "codev, no number": ("a.int", codev(head="GRD 4 3 SUR WVL SSZ 1"), "no number after WVL"),
    "codev, no wavelength": ("a.int", codev(head="GRD 4 3 SUR SSZ 1"), "WVL nan"),
    "codev, no scale": ("a.int", codev(head="GRD 4 3 SUR WVL 1 SSZ 0"), "SSZ 0, they must be"),
    "codev, wavefront": ("a.int", codev(head="GRD 4 3 WFR WVL 1 SSZ 1"), "not marked SUR"),
    "codev, oblong": ("a.int", codev(head="GRD 4 3 SUR WVL 1 SSZ 1 XSC 1.5"), "not square"),
    "codev, unknown": ("a.int", codev(head="GRD 4 3 SUR WVL 1 SSZ 1 ABC 2"), "keyword 'ABC'"),
    "codev, Zernike": ("a.int", codev(head="ZFR 12 SUR WVL 1 SSZ 1"), "files.read_zernikes"),
    "nms": ("a.nms", bytes(range(256)) * 20, "disagree on the sign"),
    "plu, profile": ("a.plu", plu(type=2), "type 2 and 1 layers, it must have type 3"),
    "plu, no layer": ("a.plu", plu(layers=0), "type 3 and 0 layers, .* at least 1"),
    "plu, cut": ("a.plu", plu()[:-1], "needs 564 bytes by its header and has 563"),
    "opd, rubbish": ("a.opd", bytes(range(256)) * 20, "cannot be read by SurfaceTopography"),
    "al3d, cut": ("a.al3d", al3d()[:-5], "cannot be read by SurfaceTopography"),
}


@pytest.mark.parametrize(("name", "data", "message"), BAD.values(), ids=BAD)
def test_damage_and_harm_end_in_one_sentence_and_take_no_memory(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(MapError, match=message) as caught:
            read_map(tmp_path / name)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)
    assert peak < 64e6 + 4 * len(data)


def test_what_is_no_file_is_refused(tmp_path):
    with pytest.raises(MapError, match="is not a file"):
        read_map(tmp_path)
    with pytest.raises(MapError, match="No such file"):
        read_map(tmp_path / "none.dat")
    with pytest.raises(MapError, match=r"cannot be read|is not a file"):
        read_map("a\0b.dat")
    with pytest.raises(MapError, match="is not a file"):
        read_map("/dev/zero")


SAMPLES = {
    **{name: one[:2] for name, one in FORMATS.items() if not name.startswith("datx")},
    "datx": ("a.datx", datx()),
    "codev": ("a.int", codev()),
    "csv": ("a.csv", ("x [mm],y [mm],z [mm]\n" + GRID.replace(" ", ",")).encode()),
    "npy": ("a.npy", array_file(PICTURE)),
    "npz": ("a.npz", array_file(None, z=PICTURE, x=np.arange(4.0), y=np.arange(3.0))),
}


@pytest.mark.parametrize(("name", "data"), SAMPLES.values(), ids=SAMPLES)
def test_bytes_cut_or_changed_give_a_map_or_a_sentence(tmp_path, name, data):
    random = np.random.default_rng(len(data))
    file = tmp_path / name
    # Every damaged .datx costs a process.
    count = 4 if name.endswith("datx") else 75
    cuts = [data[:end] for end in np.unique(random.integers(1, len(data), count // 3))]
    for _ in range(count):
        changed = bytearray(data)
        for place in random.integers(0, len(data), random.integers(1, 4)):
            changed[place] = random.integers(0, 256)
        cuts.append(bytes(changed))
    for damaged in cuts:
        file.write_bytes(damaged)
        try:
            found = read_map(file, unit="mm" if name.endswith("csv") and b"[mm]" not in damaged else None)
        except MapError as error:
            assert "\n" not in str(error)  # noqa: PT017 - most bytes end here, some in a map
        else:
            assert found.z.size < 1e6


@pytest.mark.parametrize("member", ["main.xml", "a.npy"])
def test_changed_bytes_in_an_archive_give_a_map_or_a_message(tmp_path, member):
    # An archive's own sums would find what is changed from outside.
    packed = x3p() if member == "main.xml" else SAMPLES["npz"][1]
    with zipfile.ZipFile(io.BytesIO(packed)) as file:
        members = {name: file.read(name) for name in file.namelist()}
    victim = next(name for name in members if name.endswith(member[-4:]))
    random = np.random.default_rng(5)
    for _ in range(25):
        changed = bytearray(members[victim])
        for place in random.integers(0, len(changed), random.integers(1, 4)):
            changed[place] = random.choice([*b"019-.<>/", random.integers(0, 256)])
        (tmp_path / "a").write_bytes(archive({**members, victim: bytes(changed)}))
        try:
            found = read_map(tmp_path / "a")
        except MapError as error:
            assert "\n" not in str(error)  # noqa: PT017 - most bytes end here, some in a map
        else:
            assert found.z.size < 1e6


def test_a_library_that_dies_of_a_file_ends_nothing_else(tmp_path, monkeypatch):
    _io._end_idle_readers()
    with monkeypatch.context() as deadly:
        deadly.setattr("turnwright._io.READER", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
        with pytest.raises(MapError, match=r"is HDF5 that cannot be read \(code -11\)"):
            read(tmp_path, datx(), "a.datx")
    assert read(tmp_path, datx(), "a.datx").z.shape == PICTURE.shape


def test_process_that_reads_hdf5_is_kept_until_a_file_fails(tmp_path):
    read(tmp_path, datx(), "a.datx")
    (first,) = _io._idle_readers[os.getpid()]
    read(tmp_path, datx(unit="NanoMeters"), "b.datx")
    assert _io._idle_readers[os.getpid()] == [first]
    first.kill()  # it may not have ended yet when the next file comes
    read(tmp_path, datx(), "a.datx")
    (second,) = _io._idle_readers[os.getpid()]
    with pytest.raises(MapError, match="Volts"):
        read(tmp_path, datx(unit="Volts"), "c.datx")
    assert _io._idle_readers[os.getpid()] == []
    assert second.returncode is not None


def test_hdf5_that_takes_too_long_is_refused(tmp_path, monkeypatch):
    _io._end_idle_readers()
    monkeypatch.setattr("turnwright._io.READER", "import time; time.sleep(60)")
    monkeypatch.setattr("turnwright._io.READ_TIMEOUT_S", 0.5)
    with pytest.raises(MapError, match=r"not read within 0\.5 s"):
        read(tmp_path, datx(), "a.datx")


@pytest.mark.parametrize("head", ["x{0}q,y,z", "5 5 1 1 0{0}0 0 x", "x [mm{0}],y,z", "{0}x"])
def test_blanks_without_end_are_read_once(tmp_path, head):
    """A pattern that tries a run of blanks again at each of them takes a minute; here it would not end."""
    (tmp_path / "a.csv").write_text(head.format(1_000_000 * " ") + "\n1,2,3\n2,3,4\n")
    with pytest.raises(InputError):
        read_map(tmp_path / "a.csv")


@pytest.mark.parametrize("empty", ["", "inf", "nan"])
def test_a_map_whose_first_heights_are_missing_keeps_its_units(tmp_path, empty):
    rows = [
        f"{0.01 * i:.2f},{0.01 * j:.2f},{empty if (i + j) % 9 == 0 or j == 0 else i + j}"
        for j in range(30)
        for i in range(40)
    ]
    (tmp_path / "a.csv").write_text("x [mm],y [mm],z [nm]\n" + "\n".join(rows))
    found = read_map(tmp_path / "a.csv")
    assert found.z.shape == (30, 40)
    assert np.nanmax(found.z) == pytest.approx(68e-6)
    assert np.isnan(found.z[0]).all()
    with pytest.raises(MapError, match="states the unit of its heights"):
        read_map(tmp_path / "a.csv", unit="um")
    with pytest.raises(MapError, match="states the unit of x"):
        read_map(tmp_path / "a.csv", lateral_unit="um")


def test_a_micro_sign_in_utf8_is_a_unit(tmp_path):
    """Surfalize writes the micrometre of a .sur file so."""
    surfalize = pytest.importorskip("surfalize")
    z = np.random.default_rng(5).normal(size=(12, 20))
    surfalize.Surface(z, 0.5, 0.5).save(tmp_path / "a.sur")
    again = read_map(tmp_path / "a.sur")
    assert (again.x[1], again.y[1]) == pytest.approx((0.5e-3, 0.5e-3))
    np.testing.assert_allclose(np.ptp(again.z), np.ptp(z) * 1e-3, rtol=1e-6)
