"""Registration. Oracles: poses that were put in, SciPy's least squares on residuals written here, closed forms."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import proof_registration
from turnwright import (
    Biconic,
    Conic,
    HeightMap,
    InputError,
    Job,
    LensArray,
    OffAxis,
    Part,
    Pose,
    Sphere,
    Toroid,
    XYPolynomial,
    Zernike,
    register,
)

EXAMPLES = Path(__file__).parents[2] / "examples"
TORUS = Toroid(radius_x=500.0, radius_y=250.0)
TERMS = {(2, 0): 1 / 60, (0, 2): 1 / 40, (3, 0): 2e-3, (1, 2): -1e-3, (0, 3): 1e-3}
FREEFORM = Part(surface=XYPolynomial(terms=TERMS), radius=6.0)


def lenses(rows, base=TORUS):
    """Spheres of radius 10 and aperture 1 at a pitch of 2 on a base, flush with it."""
    drop = 10 - np.sqrt(99)
    lens = Sphere(radius=10.0).placed(shift=(0, 0, -drop))
    return base + LensArray.square(pitch=2.0, rows=rows, columns=rows, lenslet=lens, aperture=1.0, surround=0.0)


def disc(part, count, rng, radius=None):
    r, angle = (radius or part.radius) * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    x, y = r * np.cos(angle), r * np.sin(angle)
    return np.array([x, y, part.surface.sag(x, y)])


def random_pose(rng, shift=5.0, angle=5.0):
    turn = np.deg2rad(rng.uniform(-angle, angle, 3))
    return Pose(shift=tuple(rng.uniform(-shift, shift, 3)), rotation=turn[0], tilt=(turn[1], turn[2]))


def measured(points, pose):
    """What an instrument sees of points of the part when ``pose`` brings its frame to that of the part."""
    x, y, z = pose.inverse.apply(*points)
    return HeightMap(x=x, y=y, z=z)


def numbers(pose):
    return np.array([*pose.shift, pose.rotation, *pose.tilt])


def test_troutman_731_random_poses_of_the_lens_are_found():
    """Troutman 2016, 7.3.1: 360 points, poses within 5 mm and 5 deg. All 500 were run; here 5 of them."""
    part = Job.load(EXAMPLES / "infrared_lens.toml").part
    for seed in range(5):
        rng = np.random.default_rng(1000 + seed)
        true = random_pose(rng)
        found = register(measured(disc(part, 360, rng), true), part)
        assert found.held == ()
        assert found.candidates == ()
        difference = np.abs(numbers(found.pose) - numbers(true))
        assert difference[:3].max() < 1e-9
        assert difference[3:].max() < 1e-10


def test_it_is_scipys_least_squares():
    """The vertical residual and its covariance, derived again from SciPy's rotations."""
    rng = np.random.default_rng(3)
    points = disc(FREEFORM, 600, rng, radius=5.5)
    points[2] += rng.normal(0, 1e-4, 600)
    start = Pose(shift=(0.05, -0.02, 0.03), rotation=0.01, tilt=(0.004, -0.006))
    heights = measured(points, start)
    found = register(heights, FREEFORM, form_error=0.0, noise_nm=100)
    pivot = np.array(found.pivot)

    def residual(p):
        turn = Rotation.from_euler("ZXY", p[3:]).as_matrix()
        x, y, z = turn @ (np.array([heights.x, heights.y, heights.z]) - pivot[:, None]) + p[:3, None]
        return z - sum(a * x**i * y**j for (i, j), a in TERMS.items())

    first = np.concatenate([start.apply(*pivot), [0.01, 0.004, -0.006]])
    oracle = least_squares(residual, first, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    at_pivot = np.concatenate([found.pose.apply(*pivot), numbers(found.pose)[3:]])
    np.testing.assert_allclose(at_pivot, oracle.x, atol=1e-8)
    scatter = 2 * oracle.cost / 600
    np.testing.assert_allclose(found.covariance, 1e-8 * np.linalg.inv(oracle.jac.T @ oracle.jac), rtol=2e-3)
    np.testing.assert_allclose(found.residual.z, residual(oracle.x), atol=1e-9)
    assert found.rms_nm == pytest.approx(1e6 * np.sqrt(scatter), rel=1e-9)


def test_the_normal_distance_is_the_distance_to_the_sphere():
    rng = np.random.default_rng(4)
    part = Part(surface=Sphere(radius=8.0), radius=6.0)
    points = disc(part, 500, rng, radius=5.5)
    direction = np.array([0, 0, 8.0])[:, None] - points
    points += direction / 8 * rng.normal(0, 1e-3, 500)
    heights = measured(points, Pose(shift=(0.02, 0.01, -0.03)))
    found = register(heights, part, distance="normal", free=("x", "y", "z"), reach=0.0, clocking=0.0)
    assert found.held == ()

    def residual(shift):
        return 8 - np.linalg.norm(np.array([heights.x, heights.y, heights.z - 8]) + shift[:, None], axis=0)

    oracle = least_squares(residual, np.zeros(3), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(found.pose.shift, oracle.x, atol=1e-9)
    np.testing.assert_allclose(found.residual.z, residual(oracle.x), atol=1e-9)


def test_the_stated_uncertainty_is_the_spread_of_many_trials():
    rng = np.random.default_rng(5)
    squares = []
    for _ in range(40):
        points = disc(FREEFORM, 400, rng, radius=5.5)
        points[2] += rng.normal(0, 20e-6, 400)
        found = register(measured(points, Pose()), FREEFORM, reach=0.0, clocking=0.0, form_error=0.0, noise_nm=20)
        off = np.concatenate([np.array(found.pose.apply(*found.pivot)) - found.pivot, numbers(found.pose)[3:]])
        squares.append(off @ np.linalg.solve(found.covariance, off))
    # The mean of 40 chi-squares of 6 degrees is 6 with a standard deviation of sqrt(12 / 40).
    assert np.mean(squares) == pytest.approx(6, abs=3 * np.sqrt(12 / 40))


def test_astigmatism_on_a_torus_is_confused_with_a_rotation():
    """1 um at 45 deg is 2 c / (a² |1/Ry - 1/Rx|) of rotation: fitted, uncertain by as much; or fixed; or separated."""
    rng = np.random.default_rng(6)
    part = Part(surface=TORUS, radius=7.5)
    astigmatism = Zernike(terms={6: 1.0}, radius=7.5, indexing="fringe")
    points = disc(part, 2000, rng)
    points[2] += 1e-3 * astigmatism.sag(points[0], points[1])
    heights = measured(points, Pose())
    plain = register(heights, part)
    alike = 2e-3 / (7.5**2 * (1 / 250 - 1 / 500))
    assert set(plain.held) <= {"y"}  # which a tilt undoes: the torus is one of revolution
    assert abs(plain.pose.rotation) == pytest.approx(alike, rel=0.01)
    assert plain.std["rotation"] > alike  # other forms too
    assert plain.rms_nm < 10  # of 408 nm
    assert any("rotation" in one.words and one.reason == "form" for one in plain.undetermined)
    kept = register(heights, part, undetermined="hold")
    assert "rotation" in kept.held
    assert kept.pose.rotation == 0
    with pytest.raises(InputError, match="hardly determines the direction rotation"):
        register(heights, part, undetermined="raise")
    # Lengths are written in the unit that suits them: a um of form, and what it passes for at the rim.
    message = next(one.words for one in plain.undetermined if "rotation" in one.words)
    assert re.search(r"a form error of 1 um .* [\d.]+ (nm|um|mm|m) at the rim\.$", message), message
    assert "e+" not in message
    unsure = register(heights, part, terms=[astigmatism], undetermined="hold")  # other forms remain
    assert "rotation" in unsure.held
    along = register(heights, part, terms=[astigmatism], form_error=0.0)
    assert abs(along.pose.rotation) < 5e-6
    assert along.amplitudes == pytest.approx([1e-3], abs=1e-9)
    np.testing.assert_allclose(along.error.z - along.residual.z, 1e-3 * astigmatism.sag(*points[:2]), atol=1e-8)


def test_what_a_form_error_does_to_the_rotation_of_a_torus():
    """2 c / (a² |1/Ry - 1/Rx|) for c of astigmatism over the radius a, where only the rotation is free."""
    part = Part(surface=TORUS, radius=7.5)
    points = disc(part, 20_000, np.random.default_rng(7))
    found = register(measured(points, Pose()), part, free=("rotation",), undetermined="fit")
    assert found.std["rotation"] == pytest.approx(2e-3 / (7.5**2 * (1 / 250 - 1 / 500)), rel=0.02)


def test_a_sphere_says_what_it_cannot_tell():
    """It turns about its centre: a shift along x is a tilt of 1/R about the other axis."""
    part = Part(surface=Sphere(radius=50.0), radius=5.0)
    points = disc(part, 3000, np.random.default_rng(8))
    found = register(measured(points, Pose(shift=(0.0, 0.0, 0.7), tilt=(0.02, 0.01))), part)
    assert set(found.held) == {"x", "y", "rotation"}
    assert [one.reason for one in found.undetermined] == ["surface"] * 3
    assert found.rms_nm < 1e-3
    along = {int(np.argmax(np.abs(one.direction[:4]) * [1, 1, 1, 5])): one.direction for one in found.undetermined}
    assert along[0][5] / along[0][0] == pytest.approx(-1 / 50, rel=0.03)
    assert along[1][4] / along[1][1] == pytest.approx(1 / 50, rel=0.03)


def poor_map(factor):
    """A conic with 60 nm of astigmatism, 25 nm of coma and noise, times a factor: its part, heights and errors."""
    part = Part(surface=Conic(radius=-120.0, conic=-2.0), radius=8.0)
    axis = np.linspace(-8, 8, 161)
    x, y = np.meshgrid(axis, axis)
    r, angle = np.hypot(x, y) / 8, np.arctan2(y, x)
    error = 60e-6 * r**2 * np.cos(2 * angle) + 25e-6 * (3 * r**3 - 2 * r) * np.cos(angle)
    error += 0.3e-6 * np.random.default_rng(2).normal(size=r.shape)
    there = r <= 0.98
    z = np.where(there, factor * error + part.surface.sag(x, y), np.nan)
    return part, HeightMap(x=axis, y=axis, z=z), factor * error[there]


def test_a_map_in_the_wrong_unit_does_not_slide_off_the_part():
    """Oracle: at the start all of it lies on the part, and fits to the rms of what was put in."""
    part, heights, error = poor_map(1000)
    found = register(heights, part)
    assert np.isfinite(found.residual.z).sum() >= error.size / 2
    assert found.rms_nm <= np.std(error) * 1e6


def test_departure_read_as_heights_is_a_poor_fit():
    """Oracle: the sag of the part, which such a map lacks."""
    part, heights, error = poor_map(1)
    sag = part.surface.sag(*np.meshgrid(heights.x, heights.y))
    found = register(replace(heights, z=heights.z - sag), part)
    assert found.count > 0.995 * error.size  # the rest are at the rim
    assert found.rms_nm == pytest.approx(np.nanstd(sag + 0 * heights.z) * 1e6, rel=0.01)


def test_an_array_on_a_torus_is_found_from_a_raw_start():
    """Bias below 0.1 nm of height at 1e5 points and 5 nm of noise. 200 starts were run; here one of them."""
    part = Part(surface=lenses(7), radius=10.0)
    for seed in range(1):
        rng = np.random.default_rng(seed)
        clean = disc(part, 100_000, rng, radius=7.5)
        true = random_pose(rng)
        found = register(measured(clean + [[0], [0], [1]] * rng.normal(0, 5e-6, 100_000), true), part)
        assert found.held == ()
        assert not found.candidates
        x, y, z = found.pose.apply(*true.inverse.apply(*clean))
        assert 1e6 * np.sqrt(np.mean((z - part.surface.sag(x, y)) ** 2)) < 0.1


def test_a_partial_scan_lists_the_places_one_pitch_off():
    rng = np.random.default_rng(9)
    part = Part(surface=lenses(11), radius=12.0)
    x, y = rng.uniform(-3, 3.4, (2, 5_000))
    points = np.array([x, y, part.surface.sag(x, y) + rng.normal(0, 20e-6, x.size)])
    heights = measured(points, Pose(shift=(0.3, 0.2, 0.0)))
    found = register(heights, part)
    assert found.ambiguous
    steps = np.array([np.array(one.pose.shift[:2]) - found.pose.shift[:2] for one in found.candidates])
    assert np.abs(steps - 2 * np.round(steps / 2)).max() < 0.02
    for one_off in ((2, 0), (-2, 0), (0, 2), (0, -2)):
        assert np.abs(steps - one_off).max(axis=1).min() < 0.02
    assert any("fiducial" in one for one in found.sentences)
    near = register(heights, part, reach=0.8)
    assert not near.candidates
    assert near.pose.shift[:2] == pytest.approx([0.3, 0.2], abs=1e-3)


@pytest.mark.parametrize("square", [True, pytest.param(False, marks=pytest.mark.proof)])
def test_a_symmetric_part_lists_its_equivalent_poses(square):
    rng = np.random.default_rng(10)
    hexagonal = LensArray.hexagonal(pitch=2.0, rings=2, lenslet=Sphere(radius=10.0))
    part = Part(surface=lenses(5, Sphere(radius=300.0)) if square else hexagonal, radius=6.5 if square else 5.0)
    points = disc(part, 4000, rng)
    points[2] += rng.normal(0, 5e-6, 4000)
    true = Pose(shift=(1.3, -0.2, 0.1), rotation=0.2, tilt=(0.01, -0.02))
    found = register(measured(points, true), part, clocking=np.pi)
    step, count = (90, 4) if square else (60, 6)
    assert found.pose.rotation == pytest.approx(0.2, abs=2e-4)  # the one closest to the start
    assert not found.ambiguous
    turns = sorted(round(np.rad2deg(one.pose.rotation - found.pose.rotation), 3) % 360 for one in found.candidates)
    np.testing.assert_allclose(turns, step * np.arange(1, count), atol=1e-3)
    assert all(one.symmetric for one in found.candidates)
    assert any("The part is symmetric" in one for one in found.sentences)


def test_displaced_lenslets_widen_the_uncertainty_as_they_should():
    """Lenslets 50 um off at random: 45 of them decide the pose, not 20 000 points."""
    part, drop, errors = Part(surface=lenses(7), radius=10.0), 10 - np.sqrt(99), []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        nominal = LensArray.square(pitch=2.0, rows=7, columns=7, lenslet=Sphere(radius=10.0)).centres
        off = np.clip(rng.normal(0, 0.05, nominal.shape), -0.07, 0.07)
        lens = Sphere(radius=10.0).placed(shift=(0, 0, -drop))
        real = TORUS + LensArray(centres=nominal + off, lenslet=lens, aperture=0.92, surround=0.0)
        points = disc(Part(surface=real, radius=7.5), 20_000, rng)
        found = register(measured(points, Pose()), part, reach=0.0, clocking=0.0)
        at = np.array(found.pose.apply(*found.pivot)) - found.pivot
        errors.append([at[0] / found.std["x"], at[1] / found.std["y"], found.pose.rotation / found.std["rotation"]])
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 2


@pytest.mark.parametrize("loss", [pytest.param("huber", marks=pytest.mark.proof), "tukey"])
def test_spikes_do_not_pull_a_robust_fit(loss):
    rng = np.random.default_rng(11)
    points = disc(FREEFORM, 4000, rng, radius=5.5)
    points[2] += rng.normal(0, 20e-6, 4000)
    clean = register(measured(points, Pose()), FREEFORM)
    spikes = rng.random(4000) < 0.01
    points[2, spikes] += rng.uniform(0.01, 0.1, spikes.sum())
    found = register(measured(points, Pose()), FREEFORM, loss=loss)
    np.testing.assert_array_equal(found.outliers, spikes)
    np.testing.assert_allclose(found.pose.shift, clean.pose.shift, atol=6 * np.sqrt(clean.covariance[0, 0]))
    assert found.rms_nm == pytest.approx(20, rel=0.05)
    pulled = register(measured(points, Pose()), FREEFORM)
    assert any("outliers" in one for one in pulled.sentences)


def test_a_map_on_a_grid_keeps_its_grid_and_what_was_left_out():
    """A flange around the part, missing points, a mask, a frame whose origin is the corner of the map."""
    axis = np.linspace(0, 16, 129)
    x, y = np.meshgrid(axis, axis)
    true = Pose(shift=(-8.2, -7.9, 0.5), rotation=0.02)
    at = true.apply(x, y, 0.0)
    on = np.hypot(at[0], at[1]) <= 6
    z = np.where(on, FREEFORM.surface.sag(at[0], at[1]) - 0.5, 0.8)
    z[60:64, 70:74] = np.nan
    mask = np.ones(z.shape, dtype=bool)
    mask[50:55, 50:60] = False
    z[~mask] = np.nan
    found = register(HeightMap(x=axis, y=axis, z=z), FREEFORM)
    np.testing.assert_allclose(numbers(found.pose), numbers(true), atol=1e-9)
    counted = on & mask & ~np.isnan(z)
    assert found.count == counted.sum()
    np.testing.assert_array_equal(np.isfinite(found.residual.z), counted)
    assert np.nanmax(np.abs(found.residual.z)) < 1e-10


def test_a_step_that_tilts_a_sphere_around_is_not_tried():
    """Oracle: the astigmatism that was put in; a sphere hardly tells tilt from decentre, so first steps can be wild."""
    axis = np.linspace(-7, 7, 71)
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) < 5.9
    added = 1e-4 * (x**2 - y**2) / 36
    z = np.where(inside, 60 - np.sqrt(60**2 - x**2 - y**2) + added, np.nan)
    found = register(HeightMap(x=axis, y=axis, z=np.round(z, 9)), Part(surface=Sphere(radius=60.0), radius=6.0))
    left = found.error.z[inside] - added[inside]
    assert np.sqrt(np.mean((left - left.mean()) ** 2)) < 2e-6


def gridded(part, pose, *, noise=8e-6, half=None, side=101, beyond=1.0, middle=None, seed=0):
    """What an instrument sees on its grid, by the roots of the moved design: the whole part, or a window of it."""
    rng = np.random.default_rng(seed)
    half = 1.02 * part.radius if half is None else half
    middle = np.array(pose.inverse.apply(0, 0, 0))[:2] if middle is None else middle
    axis = np.linspace(-half, half, side)
    x, y = np.meshgrid(axis + middle[0], axis + middle[1])
    z = np.zeros(x.shape)
    with np.errstate(invalid="ignore"):
        for _ in range(30):
            u, v, w = pose.apply(x, y, z)
            z = z - (w - part.surface.evaluate(u.ravel(), v.ravel(), 0)[0].reshape(x.shape))
    u, v, _ = pose.apply(x, y, z)
    z[np.hypot(u, v) > beyond * part.radius] = np.nan
    return HeightMap(x=x[0], y=y[:, 0], z=z + rng.normal(0, noise, z.shape))


def test_a_flawless_part_is_flawless_however_it_was_clocked():
    """Oracle: the noise. Holding a turn of 4 deg and 0.1 mm made it 46.8 nm rms."""
    surface = Conic(radius=60.0, conic=-0.6) + Zernike(terms={5: 0.4e-3, 7: 0.3e-3}, radius=5.0, indexing="fringe")
    part = Part(surface=surface, radius=5.0)
    pose = Pose(shift=(0.07, -0.07, 0.1), rotation=np.deg2rad(4), tilt=(1e-3, -2e-3))
    found = register(gridded(part, pose), part)
    assert found.held == ()
    assert found.rms_nm == pytest.approx(8, rel=0.02)
    assert found.noise_nm == pytest.approx(8, rel=0.05)
    assert found.pose.rotation == pytest.approx(pose.rotation, abs=5 * np.sqrt(found.covariance[3, 3]))
    # How far an error of form may have turned it is another number.
    assert found.form_covariance[3, 3] > 100 * found.covariance[3, 3]


@pytest.mark.parametrize(
    "view",
    [
        {"middle": (0.0, 0.0)},
        pytest.param({"middle": (0.0, 0.0), "half": 8.0, "side": 181}, marks=pytest.mark.proof),
        pytest.param({}, marks=pytest.mark.proof),
        {"half": 6.0, "beyond": 1.2},
        {"half": 3.0},
    ],
    ids=["window", "large window", "whole part", "beyond the part", "middle of the part"],
)
@pytest.mark.parametrize("way", [0.3, pytest.param(2.6, marks=pytest.mark.proof)])
def test_a_weak_freeform_far_off_is_found_in_its_own_valley(view, way):
    """Oracle: the noise. A pose that moved half the map off the part left 227.7 nm rms of the rest."""
    surface = Conic(radius=30.0, conic=-1.0) + Zernike(terms={5: 0.6e-3, 6: 0.3e-3}, radius=5.0, indexing="fringe")
    part = Part(surface=surface, radius=5.0)
    pose = Pose(shift=(3.6 * np.cos(way), 3.6 * np.sin(way), 0.2), rotation=np.deg2rad(18), tilt=(0.004, -0.003))
    found = register(gridded(part, pose, **view), part)
    assert found.rms_nm == pytest.approx(8, rel=0.05)
    assert not found.ambiguous


def test_points_beyond_the_part_are_reported():
    """Oracle: the points within the radius. A sphere 4 mm off lost half of its map without a word."""
    part = Part(surface=Sphere(radius=40.0), radius=5.0)
    heights = gridded(part, Pose(shift=(4.0, 0.0, 0.0)), side=101)
    found = register(heights, part)
    assert found.lost == 0
    assert found.count == np.isfinite(heights.z).sum()
    assert set(found.held) == {"x", "y", "rotation"}
    assert any("within the edge of the part" in one for one in found.sentences)
    # What nothing fixes stays where the start has it, if the map is on the part there.
    small = register(gridded(part, Pose(), half=2.0), part, start=Pose(shift=(0.5, 0.0, 0.0)))
    assert small.pose.apply(*small.pivot)[0] == pytest.approx(small.start.apply(*small.pivot)[0], abs=1e-12)
    # A map that is larger than the part loses points at any pose, and says so.
    large = register(gridded(part, Pose(), half=6.0, beyond=1.2), part)
    assert large.lost > 0.2 * large.count
    assert any(f"{large.lost} of the {large.count + large.lost} points" in one for one in large.sentences)


def test_the_noise_is_that_of_the_map_and_not_of_the_pose():
    """White noise on form; correlated noise with the length of its kernel; cusps, which are none."""
    part = Part(surface=FREEFORM.surface, radius=6.0)
    rng = np.random.default_rng(3)
    form = Zernike(terms={5: 1e-3, 8: 0.5e-3}, radius=6.0, indexing="fringe")
    plain = gridded(part, Pose(), noise=0.0, side=161)
    x, y = plain.points()
    white = replace(plain, z=plain.z + form.sag(x, y) + rng.normal(0, 12e-6, x.shape))
    found = register(white, part)
    assert found.rms_nm > 100
    assert found.noise_nm == pytest.approx(12, rel=0.05)
    assert found.correlated_nm < 12
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(rng.normal(size=x.shape), 4)
    smooth *= 20e-6 / smooth.std()
    both = replace(plain, z=plain.z + smooth + rng.normal(0, 5e-6, x.shape))
    found = register(both, part)
    assert found.noise_nm == pytest.approx(5, rel=0.1)
    assert found.correlated_nm == pytest.approx(20, rel=0.1)
    # Of a field with the correlation exp(-d²/(4 s²)) an independent cell covers 4 pi s², a circle of 2 s.
    assert found.correlation_length == pytest.approx(2 * 4 * (x[0, 1] - x[0, 0]), rel=0.3)
    cusps = 30e-6 * np.cos(2 * np.pi * np.hypot(x, y) / 0.25)
    found = register(replace(plain, z=plain.z + cusps + rng.normal(0, 5e-6, x.shape)), part)
    assert found.noise_nm == pytest.approx(5, rel=0.2)


def test_random_parts_are_found_at_their_noise():
    """A few of tests/proof/proof_registration.py, one of each family."""
    assert proof_registration.main(6, 11) == 0


@pytest.mark.parametrize(
    ("loss", "count"), [("linear", 300_000), pytest.param("huber", 1_000_000, marks=pytest.mark.proof)]
)
def test_many_points_take_fifteen_evaluations_at_most(loss, count, monkeypatch):
    """Counted: points at which the design is evaluated, over the points of the map. It was 49 to 57."""
    surface = Conic(radius=30.0, conic=-1.0) + Zernike(terms={5: 0.6e-3, 6: 0.3e-3}, radius=5.0, indexing="fringe")
    part = Part(surface=surface, radius=5.0)
    rng = np.random.default_rng(1)
    r, angle = 5 * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    points = np.array([r * np.cos(angle), r * np.sin(angle), np.zeros(r.size)])
    points[2] = surface.sag(points[0], points[1]) + rng.normal(0, 8e-6, r.size)
    heights = measured(points, Pose(shift=(1.6, -1.2, 0.1), rotation=0.2, tilt=(0.004, -0.003)))
    counted, plain = [], type(surface).evaluate

    def evaluate(self, x, y, order):
        counted.append(x.size)
        return plain(self, x, y, order)

    monkeypatch.setattr(type(surface), "evaluate", evaluate)
    found = register(heights, part, loss=loss)
    assert found.rms_nm == pytest.approx(8, rel=0.01)
    assert sum(counted) <= 15 * r.size


def test_a_height_that_is_none_does_not_weigh():
    """Oracle: the same map without the 1e9 that an instrument has put where it saw nothing."""
    part = Part(surface=Toroid(radius_x=15.0, radius_y=25.0), radius=2.0)
    axis = np.linspace(-1.9, 1.9, 61)
    x, y = np.meshgrid(axis, axis)
    z = np.where(np.hypot(x, y) < 1.85, part.surface.sag(x, y), np.nan)
    z += 5e-6 * np.random.default_rng(1).normal(size=z.shape)
    missing, wild = z.copy(), z.copy()
    missing[30, 30], wild[30, 30] = np.nan, 1e9
    one, other = (register(HeightMap(x=axis, y=axis, z=each), part, loss="tukey") for each in (missing, wild))
    assert other.held == one.held
    assert other.pose.shift == pytest.approx(one.pose.shift, abs=1e-4)
    assert other.pose.rotation == pytest.approx(one.pose.rotation, abs=1e-4)


def with_form(surface, radius, form, seed, *, move, turn, across):
    """Return a map of a whole part with a form error, rms ``form`` in mm, moved and turned, and its points (3, n)."""
    rng = np.random.default_rng(seed)
    terms = {int(j): float(rng.normal()) for j in rng.choice(np.arange(5, 20), 4, replace=False)}
    shape = Zernike(terms=terms, radius=1.02 * radius, indexing="fringe")
    axis = np.linspace(-radius, radius, 81)
    x, y = np.meshgrid(axis, axis)
    on = np.hypot(x, y) < radius
    scale = form / shape.sag(x[on], y[on]).std()
    way = rng.uniform(0, 2 * np.pi)
    pose = Pose(shift=(move * np.cos(way), move * np.sin(way), 0.01), rotation=turn, tilt=(1e-3, -2e-3))
    axis = np.linspace(-across * radius, across * radius, 91)
    x, y = np.meshgrid(axis, axis)
    z = np.zeros(x.shape)
    for _ in range(20):
        u, v, w = pose.apply(x, y, z)
        on = np.hypot(u, v) < 0.985 * radius
        z[on] -= w[on] - surface.sag(u[on], v[on]) - scale * shape.sag(u[on], v[on])
    z = np.where(on, z + rng.normal(0, 8e-6, z.shape), np.nan)
    return HeightMap(x=axis, y=axis, z=z), np.stack([x[on], y[on], z[on]]), pose


NEARLY_ROUND = Biconic(radius_x=60.0, radius_y=90.0, conic_x=-1.0, conic_y=-0.5)


@pytest.mark.parametrize(
    ("surface", "form", "seed", "move", "turn"),
    [
        (Toroid(radius_x=400.0, radius_y=200.0), 200e-6, 1, 1.2, 0.035),
        pytest.param(Toroid(radius_x=400.0, radius_y=200.0), 200e-6, 6, 1.2, 0.035, marks=pytest.mark.proof),
        pytest.param(NEARLY_ROUND, 10e-6, 3, 0.4, 0.05, marks=pytest.mark.proof),
        pytest.param(NEARLY_ROUND, 50e-6, 6, 0.5, 0.05, marks=pytest.mark.proof),
        (NEARLY_ROUND, 200e-6, 13, 1.5, 0.05),
    ],
    ids=["torus 1", "torus 6", "biconic 10 nm", "biconic 50 nm", "biconic 200 nm"],
)
def test_a_form_error_is_that_of_the_best_fit_within_the_edge(surface, form, seed, move, turn):
    """Oracle: SciPy's least squares over the six numbers, points beyond the edge at a cost. A shift imitates form."""
    radius = 4.0
    heights, points, true = with_form(surface, radius, form, seed, move=move, turn=turn, across=1.4)
    found = register(heights, Part(surface=surface, radius=radius))
    assert found.lost < 0.01 * points.shape[1]

    def off(numbers):
        u, v, w = Pose(shift=tuple(numbers[:3]), rotation=numbers[3] / 10, tilt=tuple(numbers[4:] / 100)).apply(*points)
        return np.concatenate([(w - surface.sag(u, v)) * 1e6, 1e4 * np.maximum(np.hypot(u, v) - radius, 0)])

    begun = [*true.shift, 10 * true.rotation, *(100 * one for one in true.tilt)]
    best = least_squares(off, begun, x_scale="jac", max_nfev=200).x
    rms = np.sqrt(np.mean(off(best)[: points.shape[1]] ** 2))
    assert found.rms_nm == pytest.approx(rms, rel=0.02)


def test_a_rotation_about_an_axis_off_the_part_is_fixed():
    """Oracle: an off-axis conic stays what it is when it is turned about the axis of its parent."""
    surface = OffAxis(parent=Conic(radius=60.0, conic=-1.0), distance=8.0)
    part = Part(surface=surface, radius=5.0)
    axis = np.linspace(-4.5, 4.5, 81)
    x, y = np.meshgrid(axis, axis)
    on = np.hypot(x, y) < 4.4
    pose = Pose(shift=(0.2, -0.3, 0.05), rotation=0.1, tilt=(1e-3, -2e-3))
    z = np.zeros(x.shape)
    for _ in range(20):
        u, v, w = pose.apply(x, y, z)
        z[on] -= w[on] - surface.sag(u[on], v[on])
    z = np.where(on, z + np.random.default_rng(2).normal(0, 5e-6, z.shape), np.nan)
    found = register(HeightMap(x=axis, y=axis, z=z), part, form_error=0.0)
    assert found.rms_nm < 5.5
    assert found.held
    assert not found.ambiguous
    assert max(found.std.values()) < 0.1


def test_a_torus_is_held_within_its_edge_in_few_steps():
    """It is one of revolution: a shift along y is a tilt. The map shows 97 % of its radius, moved by half a mm."""
    surface, radius = Toroid(radius_x=30.0, radius_y=45.0), 5.0
    pose = Pose(shift=(0.4, -0.3, 0.02), rotation=0.05, tilt=(1e-3, -2e-3))
    axis = np.linspace(-5.4, 5.4, 161)
    x, y = np.meshgrid(axis, axis)
    z = np.zeros(x.shape)
    for _ in range(20):
        u, v, w = pose.apply(x, y, z)
        on = np.hypot(u, v) < 0.97 * radius
        z[on] -= w[on] - surface.sag(u[on], v[on])
    z = np.where(on, z + np.random.default_rng(3).normal(0, 8e-6, z.shape), np.nan)
    found = register(HeightMap(x=axis, y=axis, z=z), Part(surface=surface, radius=radius))
    assert found.held == ("y",)
    assert found.lost == 0
    assert found.rms_nm == pytest.approx(8.0, rel=0.01)
    assert found.iterations < 10
