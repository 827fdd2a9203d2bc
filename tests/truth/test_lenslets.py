"""Lenslets of a measured array. Oracles: SciPy's dense fit of the true surface, closed forms, SVD of the point sets."""

import csv

import numpy as np
import pytest

import turnwright as tw
from lenslet_oracle import APERTURE, ARRAY, BASE, PART, RIM, MadeArray

POSE = tw.Pose(shift=(0.3, -0.2, 0.5), rotation=0.02, tilt=(0.004, -0.003))


def rms(away):
    """Root mean square length. [mm]."""
    return np.sqrt(np.mean(np.sum(away**2, axis=1)))


def mean_removed(away):
    return away - away.mean(axis=0)


@pytest.fixture(scope="module")
def made():
    """Return an array with dislocations of 10 to 140 um and forms of 0.1 to 0.8 um, and what an instrument shows."""
    rng = np.random.default_rng(1)
    array = MadeArray.of(rng)
    return array, array.seen(POSE, rng, side=400)


@pytest.fixture(scope="module")
def perfect():
    """Return an array whose lenslets are moved, and differ in radius, and are perfect."""
    rng = np.random.default_rng(2)
    return MadeArray.of(rng, form=(0, 0), spread=0.003)


@pytest.mark.parametrize("form", ["design", "sphere"])
def test_centres_and_forms_are_those_of_an_ideal_fit(made, form):
    """The pose is off as a registration leaves it: turned by the dislocations themselves, tilted by 30 urad."""
    array, heights = made
    off = tw.Pose(shift=(0.010, 0.005, 2e-3), rotation=3e-3, tilt=(2e-5, -3e-5)).after(POSE)
    found = tw.lenslets(heights, PART, pose=off, form=form)
    assert found.measured.all()
    ideal = [array.ideal(k, design=form == "design") for k in range(len(found))]
    away = mean_removed(np.array([one[0] for one in ideal]) - ARRAY.centres)
    assert rms(mean_removed(found.dislocations) - away) < 0.2e-3
    sq = np.array([one.sq_nm for one in found]) - [one[2] for one in ideal]
    assert np.sqrt(np.mean(sq**2)) < 5
    # Noise of 20 nm; the largest of many differs more.
    assert np.array([one.scatter_nm for one in found]) == pytest.approx(20, abs=3)
    assert found.base_sq_nm == pytest.approx(20, abs=0.2)
    assert "rotation by the base" in found.frame
    assert found.pose.rotation == pytest.approx(POSE.rotation, abs=3e-5)


@pytest.mark.proof
def test_a_map_in_the_instruments_frame_is_registered_first(made):
    """As test_lens_array_base registers its maps; here with forms of each lenslet."""
    array, heights = made
    found = tw.lenslets(heights, PART)
    assert found.pose.rotation == pytest.approx(POSE.rotation, abs=3e-5)
    away = mean_removed(np.array([array.ideal(k, design=True)[0] for k in range(len(found))]) - ARRAY.centres)
    assert rms(found.centred - away) < 0.2e-3


def test_without_noise_centre_height_and_radius_are_exact(perfect):
    heights = perfect.seen(POSE, np.random.default_rng(0), side=400, noise=0, spikes=0)
    found = tw.lenslets(heights, PART, pose=POSE, radius=True, level=False)
    assert np.abs(found.centres - perfect.centres).max() < 1e-9
    assert np.array([one.radius for one in found]) == pytest.approx(perfect.radii, abs=1e-7)
    # The depth was that of the design's radius for all: vertices stand where the design has them.
    assert np.abs([one.height for one in found]).max() < 1e-11
    assert max(one.pv_nm for one in found) < 1e-4
    assert sum(one.outliers for one in found) == 0
    fixed = tw.lenslets(heights, PART, pose=POSE, level=False)
    assert np.array([one.radius for one in fixed]) == pytest.approx(perfect.radii, abs=1e-7)


@pytest.mark.parametrize("patch", [1, 2])
def test_the_uncertainty_holds_for_correlated_noise(perfect, patch):
    """Noise that is one value over patches of 2 x 2 pixels carries a quarter of the information."""
    rng = np.random.default_rng(3)
    x = np.linspace(-RIM, RIM, 700)
    noise = rng.normal(0, 2e-5, (700 // patch, 700 // patch)).repeat(patch, 0).repeat(patch, 1)
    z = perfect.sag(*np.meshgrid(x, x)) + noise
    z[np.hypot(x, x[:, None]) > RIM] = np.nan
    found = tw.lenslets(tw.HeightMap(x=x, y=x, z=z), PART, pose=tw.Pose(), form="sphere", level=False)
    scores = (found.centres - perfect.centres) / [one.centre_std for one in found]
    radii = (np.array([one.radius for one in found]) - perfect.radii) / [one.radius_std for one in found]
    # 74 and 37 normal deviates: their root mean square lies within these bounds in 99 of 100 cases.
    assert 0.75 < np.sqrt(np.mean(scores**2)) < 1.3
    assert 0.68 < np.sqrt(np.mean(radii**2)) < 1.4


def test_the_lowest_pixel_is_no_centre(perfect):
    """Noise of 20 nm lets it wander by the root of 2 R times the noise: 20 um, a thousand times as far as the fit."""
    rng = np.random.default_rng(4)
    x = np.linspace(-RIM, RIM, 600)
    gx, gy = np.meshgrid(x, x)
    z = perfect.sag(gx, gy) + rng.normal(0, 2e-5, gx.shape)
    lowest = []
    for centre in perfect.centres:
        near = np.flatnonzero(np.hypot(gx - centre[0], gy - centre[1]) < 0.9 * APERTURE)
        lens = z.ravel()[near] - BASE.sag(gx.ravel()[near], gy.ravel()[near])
        lowest.append([gx.ravel()[near[np.argmin(lens)]], gy.ravel()[near[np.argmin(lens)]]])
    z[np.hypot(gx, gy) > RIM] = np.nan
    found = tw.lenslets(tw.HeightMap(x=x, y=x, z=z), PART, pose=tw.Pose(), level=False)
    assert rms(np.array(lowest) - perfect.centres) > 100 * rms(found.centres - perfect.centres)


def test_rotation_and_scale_are_separated_from_displacements():
    """The share that is one rotation or scale; the same turn from the singular vectors of the covariance (Umeyama)."""
    rng = np.random.default_rng(5)
    turn, scale = 4e-3, 1 + 2e-3
    matrix = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    centres = ARRAY.centres @ matrix.T + [0.05, -0.02] + rng.normal(0, 1e-3, ARRAY.centres.shape)
    found = tw.metrology.Alignment.of(ARRAY.centres, centres)
    about, moved = mean_removed(ARRAY.centres), mean_removed(centres)
    left, sizes, right = np.linalg.svd(moved.T @ about)
    best = left @ np.diag([1, np.linalg.det(left @ right)]) @ right
    assert found.rotation == pytest.approx(np.arctan2(best[1, 0], best[0, 0]), abs=1e-15)
    assert found.scale == pytest.approx(sizes.sum() / np.sum(about**2) - 1, abs=1e-14)
    assert found.explained_fraction > 0.99
    assert abs(found.rotation - turn) < 4 * found.rotation_std
    assert np.abs(np.array(found.shift) - [0.05, -0.02]).max() < 4 * found.shift_std
    # The same lenslets on a part that is clocked and shifted: the rest only turns with it.
    clocked = tw.metrology.Alignment.of(ARRAY.centres, centres @ [[0.8, 0.6], [-0.6, 0.8]] + 3)
    assert np.linalg.norm(clocked.residual, axis=1) == pytest.approx(np.linalg.norm(found.residual, axis=1), abs=1e-12)


@pytest.mark.parametrize("noise", [0, 2e-5])
def test_hexagonal_lenslets_that_share_borders(noise):
    """The circle that a cell holds is the aperture; there is no base, so the pose stays."""
    rng = np.random.default_rng(6)
    array = tw.LensArray.hexagonal(pitch=0.5, rings=2, lenslet=tw.Sphere(radius=-3.0))
    moved = array.centres + rng.normal(0, 1e-3, array.centres.shape)
    part = tw.Part(surface=array, radius=1.4)
    x = np.linspace(-1.4, 1.4, 500)
    made = tw.LensArray(centres=moved, lenslet=tw.Sphere(radius=-3.0))
    z = made.sag(x, x[:, None]) + rng.normal(0, 1, (500, 500)) * noise
    found = tw.lenslets(tw.HeightMap(x=x, y=x, z=z), part, pose=tw.Pose())
    assert found.measured.all()
    assert found.base_points == 0
    assert "pose" in found.frame
    off = found.centres - moved
    if noise:
        assert np.sqrt(np.mean((off / [one.centre_std for one in found]) ** 2)) < 1.5
    else:
        assert np.abs(off).max() < 1e-9


def test_missing_lenslets_are_reported_and_spoil_nothing(perfect):
    rng = np.random.default_rng(7)
    x = np.linspace(-RIM, RIM, 500)
    gx, gy = np.meshgrid(x, x)
    z = perfect.sag(gx, gy) + rng.normal(0, 2e-5, gx.shape)
    gone, half, flat = perfect.centres[0], perfect.centres[5], perfect.centres[9]
    z[np.hypot(gx - gone[0], gy - gone[1]) < 1] = np.nan
    z[(np.hypot(gx - half[0], gy - half[1]) < 1) & (gx < half[0] - 0.15)] = np.nan
    hole = np.hypot(gx - flat[0], gy - flat[1]) < 0.8
    z[hole] = BASE.sag(gx[hole], gy[hole]) + rng.normal(0, 2e-5, hole.sum())
    z[rng.random(z.shape) < 0.2] = np.nan
    z[np.hypot(gx, gy) > RIM] = np.nan
    found = tw.lenslets(tw.HeightMap(x=x, y=x, z=z), PART, pose=tw.Pose())
    assert len(found) == 37
    assert np.flatnonzero(~found.measured).tolist() == [0, 9]
    assert "0 points within" in found[0].finding
    assert "lenslet" in found[9].finding
    assert "of its aperture is measured" in found[5].finding
    assert len(found.findings) == 3
    fine = found.measured
    assert rms((found.centres - perfect.centres)[fine]) < 0.3e-3
    assert found[5].centre_std[0] > 1.2 * found[6].centre_std[0]
    rows = list(csv.DictReader(found.csv().splitlines()))
    assert [row["lens"] for row in rows] == [str(k + 1) for k in range(37)]
    assert rows[0]["finding"] == found[0].finding.replace(",", ";")
    assert rows[0]["sq_nm"] == ""
    assert float(rows[1]["irregular_y_mm"]) == pytest.approx(found.irregular[1, 1], rel=1e-8)
    assert found[0].finding in found.table()


def test_part_pose_with_an_array_rotated_on_its_base():
    rng = np.random.default_rng(8)
    lens = tw.Sphere(radius=8.0).placed(shift=(0, 0, np.sqrt(8**2 - 0.5**2) - 8))  # flush with the base
    array = tw.LensArray.square(pitch=1.5, rows=2, columns=3, aperture=0.5, lenslet=lens, surround=0.0)
    turned = array.placed(rotation=0.3, shift=(0.1, -0.2, 0.01))
    placed = {"shift": (0.3, 0.1, -0.02), "rotation": -0.2, "tilt": (0.01, 0.02)}
    part = tw.Part(surface=(tw.Sphere(radius=60.0) + turned).placed(**placed), radius=2.6)
    x = np.linspace(-2.6, 2.6, 400)
    z = part.surface.sag(x, x[:, None]) + rng.normal(0, 1e-6, (400, 400))
    found = tw.lenslets(tw.HeightMap(x=x, y=x, z=z), part, pose=tw.Pose())
    pose, inner = tw.Pose(**placed), tw.Pose(rotation=0.3, shift=(0.1, -0.2, 0.01))
    at = inner.apply(*array.centres.T, 0.0)
    at = pose.apply(at[0], at[1], tw.Sphere(radius=60.0).sag(at[0], at[1]) + 0.01 + lens.sag(0, 0))
    assert found.design == pytest.approx(np.stack(at[:2], axis=1), abs=1e-12)
    assert rms(found.dislocations) < 2e-5
    assert found.centres[0] == pytest.approx(found.design[0], abs=1e-4)


def test_free_tilt_is_found_where_the_form_separates_it():
    """An asphere on which r^4 outweighs r^2; tilts of up to 2 mrad added as slopes."""
    rng = np.random.default_rng(9)
    form = tw.EvenAsphere(radius=20.0, conic=0.0, terms={4: 0.2})
    array = tw.LensArray.square(pitch=2.0, rows=2, columns=2, aperture=0.8, lenslet=form, surround=0.0)
    x = np.linspace(-2, 2, 400)
    gx, gy = np.meshgrid(x, x)
    z, tilts = np.zeros(gx.shape), rng.normal(0, 1e-3, (4, 2))
    for centre, tilt in zip(array.centres + 0.01, tilts, strict=True):
        u, v = gx - centre[0], gy - centre[1]
        disc = np.hypot(u, v) <= 0.8
        z[disc] = form.sag(u[disc], v[disc]) + tilt[0] * u[disc] + tilt[1] * v[disc]
    part = tw.Part(surface=array, radius=3.0)
    found = tw.lenslets(tw.HeightMap(x=x, y=x, z=z), part, pose=tw.Pose(), tilt=True, level=False)
    assert np.abs(found.dislocations - 0.01).max() < 1e-9
    assert np.array([one.tilt for one in found]) == pytest.approx(tilts, abs=1e-9)


def test_polar_and_scattered_maps_give_the_same_lenslets(perfect):
    radius, angle = np.linspace(0, RIM, 200), np.linspace(0, 2 * np.pi, 600, endpoint=False)
    gx, gy = np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius
    z = perfect.sag(gx, gy)
    polar = tw.lenslets(tw.HeightMap(radius=radius, angle=angle, z=z), PART, pose=tw.Pose(), radius=True)
    few = slice(None, None, 2)
    points = tw.HeightMap(x=gx.ravel()[few], y=gy.ravel()[few], z=z.ravel()[few])
    scattered = tw.lenslets(points, PART, pose=tw.Pose(), radius=True)
    for found in (polar, scattered):
        assert np.abs(found.centres - perfect.centres).max() < 1e-7
    assert polar[0].residual.scattered
