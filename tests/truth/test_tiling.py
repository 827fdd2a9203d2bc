"""Maps in tiles. Oracles: the map in one piece, sums in extended precision written out here, SciPy's Welch."""

import math
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler

import numpy as np
import pytest
import scipy.signal

import turnwright as tw

TURN = 2 * np.pi
RADIUS, FEED, POINTS, PIXEL = 0.6, 0.02, 180, 0.004
MACHINE = tw.Machine(
    name="test", axes={letter: tw.Axis() for letter in "CXYZ"}, spindle_rpm=3000.0, block_rate_hz=1000.0
)
SURFACE = tw.SineGrid(amplitude=(0.001, 0.0005), period=(0.5, 0.4))
ROUND = tw.Tool(nose_radius=0.2, included=np.deg2rad(100))
TOOLS = {
    "round": ROUND,
    "wavy": replace(ROUND, waviness=(0.0, 2e-5, 0.0, -4e-5)),
    "high": replace(ROUND, offset=(0.001, 0.004, 0.0)),
}
VALUES = ("sa_nm", "sq_nm", "sp_nm", "sv_nm", "sz_nm", "pv_nm", "sku", "sdq", "sdr")


@pytest.fixture(scope="module")
def motion():
    spiral_angle = np.arange(round(RADIUS / FEED * POINTS) + 1) * TURN / POINTS
    spiral = tw.Spiral(angle=spiral_angle, radius=RADIUS - FEED * spiral_angle / TURN)
    path = tw.place(spiral, tw.Part(surface=SURFACE, radius=RADIUS), ROUND)
    time = np.arange(spiral_angle.size) * 1e-3
    return tw.Motion(time=time, axes={"C": path.angle, "X": path.radius, "Z": path.z}, machine=MACHINE)


@pytest.fixture(scope="module")
def error(motion, tmp_path_factory):
    """The error of the part on a disc, in tiles."""
    store = tmp_path_factory.mktemp("tiles") / "map"
    return tw.studies.generate_tiled(
        motion, ROUND, pixel=PIXEL, store=store, radius=RADIUS - 0.02, minus=SURFACE, tile=96
    )  # fmt: skip


def in_one_piece(motion, tool, made, *, radius=None, minus=None):
    x0, x1, y0, y1 = made.extent
    x, y = x0 + made.pixel[0] * np.arange(made.shape[1]), y0 + made.pixel[1] * np.arange(made.shape[0])
    assert (x[-1], y[-1]) == (x1, y1)
    whole = tw.generate(motion, tool, x=x, y=y)
    if radius is not None:
        z = whole.z.copy()
        z[np.hypot(x, y[:, None]) > radius * (1 + 1e-12)] = np.nan
        whole = replace(whole, z=z)
    return whole if minus is None else whole.minus(minus)


@pytest.mark.parametrize("name", TOOLS)
def test_a_disc_in_tiles_is_the_disc_in_one_piece(motion, tmp_path, name):
    tool = TOOLS[name]
    pixel = PIXEL if name == "round" else 2 * PIXEL
    made = tw.studies.generate_tiled(motion, tool, pixel=pixel, store=tmp_path / "map", radius=RADIUS, tile=64)
    one = in_one_piece(motion, tool, made, radius=RADIUS)
    assert made.shape[0] > made.tile[0]
    assert np.array_equal(made.height_map().z, one.z, equal_nan=True)
    assert made.valid == np.count_nonzero(~np.isnan(one.z))
    covered = np.hypot(one.x, one.y[:, None]) <= RADIUS
    assert made.unreached == np.count_nonzero(np.isnan(one.z) & covered)
    assert (made.unreached > 0) == (name == "high")


def test_a_rectangle_in_tiles_is_the_rectangle_in_one_piece(motion, tmp_path):
    made = tw.studies.generate_tiled(
        motion, ROUND, pixel=(0.002, 0.003), store=tmp_path / "map", x=(-0.31, 0.3), y=(-0.05, 0.4), tile=64,
        minus=SURFACE,
    )  # fmt: skip
    one = in_one_piece(motion, ROUND, made, minus=SURFACE)
    assert made.shape == (151, 306)
    assert np.array_equal(made.height_map().z, one.z)


def test_the_error_in_tiles_is_that_in_one_piece(motion, error):
    one = in_one_piece(motion, ROUND, error, radius=RADIUS - 0.02, minus=SURFACE)
    assert error.shape[0] > 2 * error.tile[0]
    np.testing.assert_allclose(error.height_map().z, one.z, rtol=0, atol=1e-15)


@pytest.mark.parametrize("form", ["none", "mean", "plane"])
def test_merged_roughness_is_that_of_one_piece(error, form):
    merged, one = error.roughness(form=form), tw.roughness(error.height_map(), form=form)
    for name in VALUES:
        assert getattr(merged, name) == pytest.approx(getattr(one, name), rel=1e-12), name
    assert merged.ssk == pytest.approx(one.ssk, abs=1e-12)
    assert (merged.valid, merged.missing, merged.form) == (one.valid, one.missing, one.form)
    assert math.isnan(merged.sal)
    assert math.isnan(merged.str)


def test_a_steep_plane_is_removed_as_in_one_piece(motion, tmp_path):
    """The tilt is ten thousand times the roughness, and the map lies far from zero."""
    tilted = tw.Plane(slope=(0.02, -0.03))
    made = tw.studies.generate_tiled(
        motion, ROUND, pixel=PIXEL, store=tmp_path / "map", radius=0.3, minus=tilted, tile=64
    )
    merged, one = made.roughness(), tw.roughness(made.height_map())
    for name in VALUES:
        assert getattr(merged, name) == pytest.approx(getattr(one, name), rel=1e-12), name


def test_the_slopes_of_a_tilted_flat_are_the_closed_form(tmp_path):
    """A flat cut by a wide nose at a fine feed, minus a plane: cusps of a picometre, on a slope that is known."""
    k = np.arange(100 * 90 + 1)
    axes = {"C": TURN * k / 90, "X": 0.1 - 0.001 * k / 90, "Z": np.zeros(k.size)}
    flat = tw.Motion(time=1e-3 * k, axes=axes, machine=MACHINE)
    made = tw.studies.generate_tiled(
        flat, tw.Tool(nose_radius=100.0, included=0.01), pixel=0.0007, store=tmp_path / "map", radius=0.09, tile=64,
        minus=tw.Plane(slope=(0.3, 0.4)),
    )  # fmt: skip
    found = made.roughness(form="none")
    assert found.sdq == pytest.approx(0.5, rel=1e-6)
    assert found.sdr == pytest.approx(100 * (math.sqrt(1.25) - 1), rel=1e-6)
    assert found.sz_nm == pytest.approx(2 * 0.09 * 0.5 * 1e6, rel=0.01)
    assert made.roughness(form="plane").sq_nm < 0.01


def test_merged_roughness_is_that_of_sums_in_extended_precision(error):
    """Plane, heights and slopes by their definitions, with sums that round once."""
    heights = error.height_map()
    x, y = (one.astype(np.longdouble) for one in heights.points())
    valid = ~np.isnan(heights.z)
    z = heights.z.astype(np.longdouble)
    columns = [np.ones(valid.sum(), np.longdouble), x[valid] - x[valid].mean(), y[valid] - y[valid].mean()]
    normal = np.array([[(a * b).sum() for b in columns] for a in columns])
    right = [(a * z[valid]).sum() for a in columns]
    plane = cramer(normal, right)
    r = z - (plane[0] + plane[1] * (x - x[valid].mean()) + plane[2] * (y - y[valid].mean()))
    flat = [float(one) for one in r[valid]]
    count = len(flat)
    sq = math.sqrt(math.fsum(one * one for one in flat) / count)
    found = error.roughness()
    assert found.sa_nm == pytest.approx(math.fsum(map(abs, flat)) / count * 1e6, rel=1e-12)
    assert found.sq_nm == pytest.approx(sq * 1e6, rel=1e-12)
    assert found.sku == pytest.approx(math.fsum(one**4 for one in flat) / count / sq**4, rel=1e-12)
    assert found.ssk == pytest.approx(math.fsum(one**3 for one in flat) / count / sq**3, abs=1e-12)
    assert found.sp_nm == pytest.approx(max(flat) * 1e6, rel=1e-12)
    assert found.sv_nm == pytest.approx(-min(flat) * 1e6, rel=1e-12)
    squares = []
    for axis in (0, 1):
        slope = np.diff(r, axis=axis) / np.longdouble(PIXEL)
        squares.append(math.fsum(float(one) ** 2 for one in slope[~np.isnan(slope)]) / (~np.isnan(slope)).sum())
    assert found.sdq == pytest.approx(math.sqrt(sum(squares)), rel=1e-12)


def cramer(normal, right):
    """Solve three equations in extended precision, which LAPACK has not."""
    whole = determinant(normal)
    found = []
    for k in range(3):
        changed = normal.copy()
        changed[:, k] = right
        found.append(determinant(changed) / whole)
    return found


def determinant(m):
    return sum(
        m[0][i] * (m[1][(i + 1) % 3] * m[2][(i + 2) % 3] - m[1][(i + 2) % 3] * m[2][(i + 1) % 3]) for i in range(3)
    )


def test_line_spectra_are_those_of_welch(motion, tmp_path):
    """SciPy's Welch without overlap, over all lines of a map without holes; a row of segments does not fit whole."""
    made = tw.studies.generate_tiled(
        motion, ROUND, pixel=0.002, store=tmp_path / "map", x=(-0.2, 0.2), y=(-0.2, 0.2), minus=SURFACE, tile=64
    )  # fmt: skip
    z = made.height_map().z[:192, :192] * 1e6
    for along, axis in (("x", 1), ("y", 0)):
        frequency, density = scipy.signal.welch(
            z, fs=1 / 0.002, window="boxcar", nperseg=48, noverlap=0, detrend="constant", axis=axis
        )  # fmt: skip
        found = made.line_psd(along=along, segment=48, form="none", window="none")
        np.testing.assert_allclose(found.frequency, frequency, rtol=1e-12)
        np.testing.assert_allclose(found.density[1:-1], density.mean(axis=1 - axis)[1:-1], rtol=1e-10)
        assert found.count == 192 * 4


def test_area_spectra_are_the_mean_over_segments_in_one_piece(error):
    """The windowed transform of every whole segment of the map in memory, by NumPy."""
    size = 40
    z = error.height_map().z
    weight = np.multiply.outer(*[0.5 - 0.5 * np.cos(TURN * (np.arange(size) + 0.5) / size)] * 2)
    total, count = np.zeros((size, size)), 0
    for row in range(0, z.shape[0] - size + 1, size):
        for column in range(0, z.shape[1] - size + 1, size):
            part = z[row : row + size, column : column + size]
            if np.isnan(part).any():
                continue
            part = weight * (part - (weight * part).sum() / weight.sum()) * 1e6
            total += np.abs(np.fft.fftshift(np.fft.fft2(part))) ** 2
            count += 1
    found = error.area_psd(segment=size, form="none")
    expected = total / count * PIXEL**2 / (weight**2).sum()
    assert count > 20
    np.testing.assert_allclose(found.density, expected, rtol=1e-12, atol=1e-12 * expected.max())
    assert f"{count} segments" in found.notes[0]


def test_overviews_are_means_of_what_is_there(error):
    z = error.height_map().z
    for level in range(1, error.levels):
        z = np.pad(z, [(0, size % 2) for size in z.shape], constant_values=np.nan)
        blocks = np.stack([z[j::2, i::2] for j in (0, 1) for i in (0, 1)])
        there = ~np.isnan(blocks)
        z = np.where(
            there.any(axis=0), np.where(there, blocks, 0).sum(axis=0) / np.maximum(there.sum(axis=0), 1), np.nan
        )
        found = error.height_map(level)
        np.testing.assert_allclose(found.z, z, rtol=1e-14)
        z = found.z
        assert np.diff(found.x) == pytest.approx(PIXEL * 2**level)
        assert found.x[0] == pytest.approx(error.extent[0] + PIXEL * (2**level - 1) / 2)


def test_more_overviews_than_a_tile_makes(motion, tmp_path):
    """Levels beyond a tile's own three are made of those when all are there."""
    made = tw.studies.generate_tiled(
        motion, ROUND, pixel=(0.0001, 0.01), store=tmp_path / "map", x=(-0.5, 0.5), y=(0.0, 0.2)
    )
    assert made.levels > 4
    z = made.height_map(made.levels - 2).z
    z = np.pad(z, [(0, size % 2) for size in z.shape], constant_values=np.nan)
    expected = np.nanmean(np.stack([z[j::2, i::2] for j in (0, 1) for i in (0, 1)]), axis=0)
    np.testing.assert_allclose(made.height_map(made.levels - 1).z, expected, rtol=1e-14)


def test_a_window_comes_from_the_coarsest_level_that_shows_it(error):
    assert error.shape == (291, 291)
    fine = error.window(x=(-0.1, 0.1), y=(-0.05, 0.05), pixels=51)
    assert np.array_equal(fine.z, error.height_map().z[133:158, 120:171])
    coarse = error.window(x=(-0.5, 0.5), y=(-0.5, 0.5), pixels=60)
    assert coarse.x[1] - coarse.x[0] == pytest.approx(4 * PIXEL)  # of twice that only 31 would lie in the window
    assert coarse.z.shape == (63, 63)  # from -0.494 to 0.498 mm
    assert error.window(x=(-9, 9), y=(-9, 9), pixels=10**6).z.shape == error.shape


class Posting(Executor):
    """Sends what it is given through pickle, as a process or a cluster would, and remembers how long that was."""

    def __init__(self):
        self.threads, self.longest, self._max_workers = ThreadPoolExecutor(2), 0, 2

    def submit(self, fn, /, *args, **kwargs) -> Future:
        sent = bytes(ForkingPickler.dumps((fn, args, kwargs)))
        self.longest = max(self.longest, len(sent))
        fn, args, kwargs = ForkingPickler.loads(sent)
        return self.threads.submit(fn, *args, **kwargs)


def test_any_executor_makes_the_same_map_and_gets_no_large_array(motion, error, tmp_path):
    executor = Posting()
    with executor.threads:
        made = tw.studies.generate_tiled(
            motion, ROUND, pixel=PIXEL, store=tmp_path / "map", radius=RADIUS - 0.02, minus=SURFACE, tile=96,
            executor=executor,
        )  # fmt: skip
    assert np.array_equal(made.height_map().z, error.height_map().z, equal_nan=True)
    assert 0 < executor.longest < 8000 < motion.time.nbytes
    assert not (tmp_path / "map" / ".motion").exists()
