"""Maps for other programs: counts, slopes, phases and the way up.

Oracles: prysm reads Zygo and CODE V files, mpmath differentiates, polynomials in closed form, rotation matrices; files
are taken apart here by hand.
"""

import re
from importlib.metadata import version

import mpmath
import numpy as np
import prysm.io
import pytest

import turnwright as tw
from turnwright.errors import InputError, MapError
from turnwright.files import read_map, read_zernikes, write_grid_sag, write_map, write_zernikes

AXIS = np.linspace(-3, 3, 49)
X, Y = np.meshgrid(AXIS, AXIS)
STROKES = ((X > 1) & (X < 1.5) & (Y > -1) & (Y < 2)) | ((X > 1) & (X < 2.5) & (Y > -1) & (Y < -0.5))
"""An L in the right half: it differs from its mirror images and from its half turn."""
MARK = tw.HeightMap(
    x=AXIS, y=AXIS, z=np.where(np.hypot(X, Y) > 2.9, np.nan, 1e-4 * STROKES + 3e-5 * np.sin(X) + 1e-5 * Y), name="L"
)
ABOUT_Y = np.diag([-1.0, 1.0, -1.0])
"""Half a turn about y."""

WAVELENGTH = 632.8e-6
FIRST_READER = version("prysm").startswith("0.21")


def grid_file(file):
    """Return x, y, and z, dz/dx, dz/dy, d2z/dxdy of a grid file, rows ascending in y; nan where a point is missing."""
    head, *lines = (line for line in file.read_text().splitlines() if line[0] != "!")
    columns, rows, step_x, step_y, _, x, y = map(float, head.split())
    points = np.array([[float(cell) for cell in line.split()] for line in lines])
    points[points[:, 4] != 0] = np.nan
    nodes = points[:, :4].reshape(int(rows), int(columns), 4)[::-1]
    return (
        x + step_x * (np.arange(columns) - (columns - 1) / 2),
        y + step_y * (np.arange(rows) - (rows - 1) / 2),
        np.moveaxis(nodes, -1, 0),
    )


# --------------------------------------------------------------------- counts and the way up
def test_a_zygo_file_is_read_by_prysm_to_half_a_count(tmp_path):
    write_map(MARK, tmp_path / "a.dat", format="zygo")
    found = prysm.io.read_zygo_dat(tmp_path / "a.dat")
    count_nm = 632.8 * 0.5 / 131072
    # The first row of an instrument's file is the top.
    np.testing.assert_allclose(found["phase"][::-1], MARK.z * 1e6, rtol=0, atol=0.5001 * count_nm)
    assert found["meta"]["lateral_resolution"] == pytest.approx(0.125e-3, rel=1e-7)
    again = read_map(tmp_path / "a.dat")
    np.testing.assert_allclose(again.z, MARK.z, rtol=0, atol=0.5001e-6 * count_nm)
    np.testing.assert_allclose(np.diff(again.x), 0.125, rtol=1e-7)


def test_a_deep_zygo_file_takes_coarser_counts_up_to_its_limit(tmp_path):
    deep = tw.HeightMap(x=AXIS, y=AXIS, z=X**2)
    write_map(deep, tmp_path / "a.dat", format="zygo")
    found = prysm.io.read_zygo_dat(tmp_path / "a.dat")
    np.testing.assert_allclose(found["phase"][::-1], X**2 * 1e6, rtol=0, atol=0.5001 * 632.8 * 0.5 / 32768)
    with pytest.raises(MapError, match=r"up to 27 mm, Zygo files hold up to 20\.7"):
        write_map(tw.HeightMap(x=AXIS, y=AXIS, z=X**3), tmp_path / "b.dat", format="zygo")


def test_a_codev_file_is_read_by_prysm_to_half_a_count(tmp_path):
    write_map(MARK, tmp_path / "a.int")
    lines = (tmp_path / "a.int").read_text().splitlines()
    assert max(map(len, lines)) <= 80
    per_um = float(re.search(r"SUR WVL 1\.0 SSZ (\S+) NDA -32768", lines[2])[1])
    assert per_um == pytest.approx(32767 / np.nanmax(np.abs(MARK.z)) / 1e3)
    found, meta = prysm.io.read_codev_gridint(tmp_path / "a.int")
    assert meta["data meaning"] == "surface error"
    # Release 0.21 leaves the rows as they are, with the top first.
    upward = found[::-1] if FIRST_READER else found
    np.testing.assert_allclose(upward, MARK.z * 1e6, rtol=0, atol=0.5001 * 1e3 / per_um)
    again = read_map(tmp_path / "a.int", pixel_size=0.125)
    np.testing.assert_allclose(again.z, MARK.z, rtol=0, atol=0.5001e-3 / per_um)


@pytest.mark.skipif(not FIRST_READER, reason="an erratum of prysm 0.21")
def test_prysm_errs_on_a_codev_file_of_another_wavelength(tmp_path):
    """Erratum of prysm 0.21: it divides by the wavelength. 20000 counts of one in 20000 are one wavelength."""
    (tmp_path / "a.int").write_text("one\nGRD 2 2 SUR WVL 0.5 SSZ 20000 NDA -32768\n20000 0 0 -32768\n")
    assert prysm.io.read_codev_gridint(tmp_path / "a.int")[0][0, 0] == pytest.approx(2000)
    assert read_map(tmp_path / "a.int").z[1, 0] == pytest.approx(500e-6)


@pytest.mark.parametrize(
    ("kind", "name", "accuracy"),
    [
        ("npz", "a.npz", 0),
        ("x3p", "a.x3p", 1e-18),
        ("grid sag", "a.dat", 0),
        ("zygo", "a.dat", 2e-9),
        ("codev", "a.int", 3e-9),
    ],
)
def test_a_mark_on_either_face_is_turned_and_never_mirrored(tmp_path, kind, name, accuracy):
    for face, turn in ((None, np.eye(3)), ("back", np.eye(3)), ("front", ABOUT_Y)):
        assert np.linalg.det(turn) == 1
        write_map(MARK, tmp_path / name, format=kind, face=face)
        found = read_map(tmp_path / name)
        # Zygo and CODE V files do not keep the place of the grid.
        x, y = np.meshgrid(*(axis - axis.mean() for axis in (found.x, found.y)))
        size = 6 / (x.max() - x.min())
        # A missing point is carried as a height of 1 mm, which no other has.
        part = np.stack([X, Y, np.nan_to_num(MARK.z, nan=1.0)], axis=-1) @ turn.T
        nodes = {tuple(np.rint(8 * point[:2]).astype(int)): point[2] for point in part.reshape(-1, 3)}
        there = [nodes[a, b] for a, b in np.rint(8 * size * np.stack([x, y], -1)).astype(int).reshape(-1, 2).tolist()]
        np.testing.assert_allclose(np.nan_to_num(found.z, nan=turn[2, 2]).ravel(), there, rtol=0, atol=accuracy)


@pytest.mark.parametrize("kind", ["polar", "scattered"])
def test_polar_and_scattered_maps_turn_as_points_do(kind):
    angle, radius = np.linspace(0.3, 4, 7), np.linspace(0, 2, 5)
    z = np.random.default_rng(3).normal(size=(7, 5))
    polar = tw.HeightMap(angle=angle, radius=radius, z=z)
    x, y = polar.points()
    one = polar if kind == "polar" else tw.HeightMap(x=x.ravel(), y=y.ravel(), z=z.ravel())
    turned = one.turned_over()
    expected = np.stack([x, y, z]).reshape(3, -1).T @ ABOUT_Y.T
    found = np.stack([*turned.points(), turned.z]).reshape(3, -1).T
    np.testing.assert_allclose(found[np.argsort(found[:, 2])], expected[np.argsort(expected[:, 2])], atol=1e-14)
    again = turned.turned_over()
    np.testing.assert_allclose([*again.points(), again.z], [*one.points(), one.z], atol=1e-14)


# --------------------------------------------------------------------- slopes
ASPHERE = tw.EvenAsphere(radius=40.0, conic=-0.7, terms={4: 3e-5, 6: -2e-7}).placed(shift=(0.2, -0.1, 0.0))
BASE = tw.Conic(radius=40.0, conic=-0.7)


def departure(x, y):
    def sag(r2, *terms):
        c = mpmath.mpf(1) / 40
        return c * r2 / (1 + mpmath.sqrt(1 - mpmath.mpf("0.3") * c**2 * r2)) + sum(a * r2**k for k, a in terms)

    x0, y0 = x - mpmath.mpf("0.2"), y + mpmath.mpf("0.1")
    high = ((2, mpmath.mpf("3e-5")), (3, mpmath.mpf("-2e-7")))
    return sag(x0 * x0 + y0 * y0, *high) - sag(x * x + y * y)


@pytest.mark.parametrize("face", [None, "front"])
def test_slopes_of_a_departure_surface_are_exact(tmp_path, face):
    write_grid_sag(ASPHERE, tmp_path / "a.dat", x=np.linspace(-3, 3, 9), y=np.linspace(-2, 2, 7), base=BASE, face=face)
    x, y, nodes = grid_file(tmp_path / "a.dat")
    sign = -1 if face == "front" else 1
    with mpmath.workdps(40):
        for column, row in ((0, 0), (2, 5), (8, 3), (5, 6)):
            at = (mpmath.mpf(float(x[column])), mpmath.mpf(float(y[row])))
            for node, order in zip(nodes, ((0, 0), (1, 0), (0, 1), (1, 1)), strict=True):
                exact = mpmath.diff(lambda a, b: sign * departure(sign * a, b), at, order)
                assert float(exact) == pytest.approx(node[row, column], rel=1e-11, abs=1e-16)


def test_points_outside_a_surface_or_its_base_are_missing(tmp_path):
    # A hemisphere of 2 mm has no height beyond 2 mm.
    axis = np.linspace(-3, 3, 13)
    write_grid_sag(tw.Sphere(radius=2.0), tmp_path / "a.dat", x=axis, y=axis, base=tw.Sphere(radius=2.5))
    _, _, (z, zx, *_) = grid_file(tmp_path / "a.dat")
    radius = np.hypot(*np.meshgrid(axis, axis))
    np.testing.assert_array_equal(np.isnan(z), radius >= 2)
    np.testing.assert_array_equal(np.isnan(read_map(tmp_path / "a.dat").z), radius >= 2)
    inside = radius < 1.9
    assert np.isfinite(zx[inside]).all()


def test_slopes_of_a_map_are_those_of_a_cubic_and_of_its_departure(tmp_path):
    # A bicubic polynomial is its own spline; the parabola is the base.
    x, y = np.linspace(-2, 1, 13), np.linspace(-1, 2, 9)
    at_x, at_y = np.meshgrid(x, y)
    cubic = 1e-3 * (at_x**3 - at_x**2 * at_y**3 + 2 * at_y)
    base = tw.XYPolynomial(terms={(2, 0): 0.01, (0, 2): 0.02})
    write_map(
        tw.HeightMap(x=x, y=y, z=cubic + 0.01 * at_x**2 + 0.02 * at_y**2),
        tmp_path / "a.dat",
        format="grid sag",
        base=base,
    )
    _, _, nodes = grid_file(tmp_path / "a.dat")
    exact = [
        cubic,
        1e-3 * (3 * at_x**2 - 2 * at_x * at_y**3),
        1e-3 * (-3 * at_x**2 * at_y**2 + 2),
        1e-3 * (-6 * at_x * at_y**2),
    ]
    np.testing.assert_allclose(nodes, exact, rtol=0, atol=2e-15)


def test_every_valid_point_next_to_a_hole_has_its_slopes(tmp_path):
    write_map(MARK, tmp_path / "a.dat", format="grid sag")
    _, _, nodes = grid_file(tmp_path / "a.dat")
    for node in nodes:
        np.testing.assert_array_equal(np.isnan(node), np.isnan(MARK.z))


# --------------------------------------------------------------------- phase
@pytest.mark.parametrize(("index", "waves"), [(None, -2.0), (1.49, 0.49), (3.42, 2.42)])
@pytest.mark.parametrize("face", [None, "front"])
def test_phase_of_a_bump_is_the_longer_path_on_both_faces(tmp_path, index, waves, face):
    """One wavelength of material more: a mirror shortens the path twice, a lens adds n - 1 wavelengths."""
    bump = tw.HeightMap(x=AXIS, y=AXIS, z=WAVELENGTH * np.exp(-((X - 1) ** 2) - Y**2))
    write_map(bump, tmp_path / "a.dat", format="grid phase", wavelength=WAVELENGTH, index=index, face=face)
    x, y, (phase, along_x, along_y, cross) = grid_file(tmp_path / "a.dat")
    centre = -1 if face == "front" else 1
    row, column = np.unravel_index(np.argmax(np.abs(phase)), phase.shape)
    assert (x[column], y[row]) == (centre, 0)
    assert phase[row, column] == pytest.approx(2 * np.pi * waves, rel=1e-12)
    at_x, at_y = np.meshgrid(x, y)
    exact = 2 * np.pi * waves * np.exp(-((at_x - centre) ** 2) - at_y**2)
    inner = np.s_[6:-6, 6:-6]
    for found, factor in ((along_x, -2 * (at_x - centre)), (along_y, -2 * at_y), (cross, 4 * (at_x - centre) * at_y)):
        np.testing.assert_allclose(found[inner], (factor * exact)[inner], rtol=0, atol=3e-4 * abs(waves) * 2 * np.pi)


def test_a_phase_is_not_read_as_heights(tmp_path):
    write_map(MARK, tmp_path / "a.dat", format="grid phase", wavelength=WAVELENGTH)
    with pytest.raises(MapError, match="a phase in radians, not heights"):
        read_map(tmp_path / "a.dat")


# --------------------------------------------------------------------- Zernike coefficients
NOLL = tw.Zernike(terms={4: 2e-4, 7: -1e-4, 8: 3e-4, 11: 5e-5, 6: 1e-5, 5: 2e-5}, radius=5.0, indexing="noll")


@pytest.mark.parametrize("face", [None, "front"])
def test_zernike_file_holds_the_same_surface_on_both_faces(tmp_path, face):
    write_zernikes(NOLL, tmp_path / "a.int", face=face)
    found = read_zernikes(tmp_path / "a.int", radius=5.0)
    sign = -1 if face == "front" else 1
    x, y = np.random.default_rng(1).uniform(-3, 3, (2, 50))
    np.testing.assert_allclose(found.sag(x, y), sign * NOLL.sag(sign * x, y), rtol=1e-13, atol=1e-18)
    assert found.indexing == "fringe"


def test_zernike_file_states_micrometres_in_fringe_order(tmp_path):
    write_zernikes(tw.Zernike(terms={9: 1e-3, 2: 5e-4}, radius=5.0, indexing="fringe"), tmp_path / "a.int")
    remark, title, head, *values = (tmp_path / "a.int").read_text().splitlines()
    assert (remark[0], title, head) == ("!", "surface", "ZFR 37 SUR WVL 1.0 SSZ 1.0")
    assert {j: float(value) for j, value in enumerate(values, 1) if float(value)} == {2: 0.5, 9: 1.0}
    text = "by hand\nZFR 9 SUR WVL 0.5 SSZ 2\n0 0 0 4 0 0 0 0 -1e0\n"  # of a half-micrometre wave, in halves
    (tmp_path / "b.int").write_text(text)
    assert dict(read_zernikes(tmp_path / "b.int", radius=2.0).terms) == pytest.approx({1: 0, 4: 1e-3, 9: -2.5e-4})


BAD_ZERNIKES = {
    "a grid": ("a\nGRD 2 2 SUR WVL 1 SSZ 1\n1 2 3 4\n", "reads ZFR only"),
    "standard terms": ("a\nZRN 1 SUR WVL 1 SSZ 1\n1\n", "reads ZFR only"),
    "a wavefront": ("a\nZFR 1 WFR WVL 1 SSZ 1\n1\n", "not marked SUR"),
    "too few": ("a\nZFR 4 SUR WVL 1 SSZ 1\n1 2 3\n", "3 coefficients for ZFR 4"),
    "text": ("x,y,z\n1,2,3\n", "not a CODE V interferogram"),
    "words": ("a\nZFR 1 SUR WVL 1 SSZ 1\none\n", "not a number"),
}


@pytest.mark.parametrize(("text", "message"), BAD_ZERNIKES.values(), ids=BAD_ZERNIKES)
def test_zernike_file_of_another_kind_is_refused(tmp_path, text, message):
    (tmp_path / "a.int").write_text(text)
    with pytest.raises(MapError, match=message):
        read_zernikes(tmp_path / "a.int", radius=5.0)


def test_a_term_beyond_the_fringe_set_is_refused(tmp_path):
    high = tw.Zernike(terms={40: 1e-5}, radius=5.0, indexing="noll")
    with pytest.raises(MapError, match="not among the 37 fringe terms"):
        write_zernikes(high, tmp_path / "a.int")
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------- options
OPTIONS = {
    "format": ({"format": "opd"}, 'it must be "npz", "x3p"'),
    "face": ({"format": "npz", "face": "left"}, '"front" or "back"'),
    "wavelength without use": ({"format": "x3p", "wavelength": 5e-4}, "grid phase only, not to x3p"),
    "no wavelength": ({"format": "grid phase", "index": 1.5}, "needs the wavelength, and the index"),
    "index": ({"format": "grid phase", "wavelength": 5e-4, "index": 1.0}, "above 1 and at most 10"),
    "wavelength": ({"format": "grid phase", "wavelength": 0.0, "index": 1.5}, "must be finite and above 0"),
}


@pytest.mark.parametrize(("options", "message"), OPTIONS.values(), ids=OPTIONS)
def test_an_option_without_meaning_is_refused_without_a_file(tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        write_map(MARK, tmp_path / "a.dat", **options)
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------- xarray
def test_xarray_has_the_axes_and_units_of_every_kind_of_map():
    grid = MARK.to_xarray()
    assert (grid.dims, grid.name, grid.attrs["units"]) == (("y", "x"), "L", "mm")
    assert (
        float(grid.sel(x=1.25, y=0.5, method="nearest"))
        == MARK.z[np.argmin(abs(AXIS - 0.5)), np.argmin(abs(AXIS - 1.25))]
    )
    polar = tw.HeightMap(angle=[0.0, 1.0], radius=[1.0, 2.0, 3.0], z=np.arange(6.0).reshape(2, 3)).to_xarray()
    assert (polar.dims, polar.coords["angle"].attrs["units"]) == (("angle", "radius"), "rad")
    points = tw.HeightMap(x=[0.0, 1.0], y=[2.0, 2.0], z=[5.0, 6.0]).to_xarray()
    assert (points.dims, points.coords["y"].dims) == (("point",), ("point",))
    pixels = tw.HeightMap(x=[0.0, 1.0], y=[2.0], z=[[5.0, 6.0]], calibrated=False).to_xarray()
    assert pixels.coords["x"].attrs["units"] == "pixel"


def test_missing_xarray_is_one_sentence(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(InputError, match="pip install"):
        MARK.to_xarray()


@pytest.mark.parametrize("name", ["a.npz", "a.x3p", "a.grd", "a.int"])
def test_heights_that_no_reader_takes_are_not_written(tmp_path, name):
    with pytest.raises(MapError, match=r"heights of up to 1e\+300 mm, the limit is 1e\+06 mm"):
        write_map(tw.HeightMap(x=AXIS, y=AXIS, z=np.full_like(X, 1e300)), tmp_path / name)
    with pytest.raises(MapError, match=r"heights of up to 2e\+06 mm"):
        write_grid_sag(tw.Plane(slope=(2e6, 0.0)), tmp_path / name, x=np.linspace(0, 1, 9), y=np.linspace(0, 1, 9))
    assert not list(tmp_path.iterdir())


def test_a_map_that_is_no_grid_is_refused_by_format(tmp_path):
    scattered = tw.HeightMap(x=np.arange(3.0), y=np.array([0.0, 1.0, 0.0]), z=np.zeros(3))
    with pytest.raises(MapError, match="scattered points, grid phase files hold"):
        write_map(scattered, tmp_path / "a.dat", format="grid phase", wavelength=500e-6)
