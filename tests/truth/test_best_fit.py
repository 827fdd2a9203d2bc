"""Best-fit forms against exact surfaces, SciPy's optimiser on geometric distances, and random trials."""

import numpy as np
import pytest
from scipy import optimize

from turnwright.heightmap import HeightMap
from turnwright.metrology import best_fit, interferogram
from turnwright.surface import Conic, EvenAsphere, Sphere

X = np.linspace(-4, 4, 61) + 0.3
COLUMNS, ROWS = np.meshgrid(X, X)


def seen(surface, *, noise=0.0, missing=0.3, seed=1):
    rng = np.random.default_rng(seed)
    z = surface.sag(COLUMNS, ROWS) + noise * rng.standard_normal(COLUMNS.shape)
    z[rng.random(z.shape) < missing] = np.nan
    return HeightMap(x=X, y=X, z=z)


def places(heights):
    x, y = heights.points()
    valid = ~np.isnan(heights.z)
    return x[valid], y[valid], heights.z[valid]


@pytest.mark.parametrize("distance", ["vertical", "normal"])
@pytest.mark.parametrize("radius", [20.0, -9.0, 1e4])
def test_a_sphere_is_found_to_rounding(radius, distance):
    heights = seen(Sphere(radius=radius).placed(shift=(0.4, -0.2, 1.5)))
    found = best_fit(heights, "sphere", distance=distance)
    assert found.parameters["radius"] == pytest.approx(radius, rel=1e-9)
    assert [found.parameters[name] for name in "xyz"] == pytest.approx([0.4, -0.2, 1.5], abs=1e-12 * abs(radius) ** 1.5)
    assert found.rms_nm < 1e-8
    held = best_fit(heights, Sphere(radius=radius), distance=distance, free=("x", "y", "z"))
    assert held.held == {"radius": pytest.approx(radius)}
    assert held.rms_nm < 1e-8


@pytest.mark.parametrize("distance", ["vertical", "normal"])
def test_a_conic_is_found_to_rounding_from_its_best_sphere(distance):
    found = best_fit(seen(Conic(radius=15.0, conic=-2.3).placed(shift=(0.1, 0.2, -0.5))), "conic", distance=distance)
    assert dict(found.parameters) == pytest.approx(
        {"x": 0.1, "y": 0.2, "z": -0.5, "radius": 15.0, "conic": -2.3}, rel=1e-9
    )


@pytest.mark.parametrize("distance", ["vertical", "normal"])
def test_a_tilted_even_asphere_is_found_to_rounding(distance):
    lens = EvenAsphere(radius=30.0, conic=-0.7, terms={4: 1e-5, 6: -2e-7})
    start = EvenAsphere(radius=29.0, conic=-0.7, terms={4: 1e-6, 6: 1e-9})
    free = ("x", "y", "z", "tilt_x", "tilt_y", "radius", "a4", "a6")
    placed = lens.placed(shift=(0.1, 0.2, 0.3), tilt=(0.01, -0.02))
    found = best_fit(seen(placed), start, distance=distance, free=free)
    assert dict(found.parameters) == pytest.approx(
        {"x": 0.1, "y": 0.2, "z": 0.3, "tilt_x": 0.01, "tilt_y": -0.02, "radius": 30.0, "a4": 1e-5, "a6": -2e-7},
        rel=1e-8,
    )
    assert np.abs(found.surface.sag(COLUMNS, ROWS) - placed.sag(COLUMNS, ROWS)).max() < 1e-13
    assert found.held == {"conic": -0.7}


def test_noisy_spheres_are_those_that_scipy_finds_by_geometry():
    heights = seen(Sphere(radius=7.0).placed(shift=(0.4, -0.2, 1.5)), noise=1e-3)
    x, y, z = places(heights)

    def along_normal(p):
        return np.hypot(np.hypot(x - p[0], y - p[1]), z - p[2]) - p[3]

    def along_z(p):
        return z - p[2] + np.sqrt(p[3] ** 2 - (x - p[0]) ** 2 - (y - p[1]) ** 2)

    for distance, left in (("normal", along_normal), ("vertical", along_z)):
        truth = optimize.least_squares(left, [0, 0, 8, 7], xtol=1e-15, ftol=1e-15, gtol=1e-15)
        found = best_fit(heights, "sphere", distance=distance)
        mine = found.parameters
        assert [mine["x"], mine["y"], mine["z"] + mine["radius"], mine["radius"]] == pytest.approx(truth.x, rel=1e-7)
        # Positive above the sphere: a bowl's centre is above, so a bump is nearer to it.
        sign = -1 if distance == "normal" else 1
        assert found.residual.z[~np.isnan(heights.z)] == pytest.approx(sign * truth.fun, abs=1e-9)
        covariance = np.linalg.inv(truth.jac.T @ truth.jac) * (truth.fun @ truth.fun) / (x.size - 4)
        assert found.uncertainty["radius"] == pytest.approx(np.sqrt(covariance[3, 3]), rel=1e-4)
        assert found.uncertainty["x"] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-4)
        vertex = np.sqrt(covariance[2, 2] + covariance[3, 3] - 2 * covariance[2, 3])
        assert found.uncertainty["z"] == pytest.approx(vertex, rel=1e-3)


def test_a_plane_by_normals_is_total_least_squares():
    rng = np.random.default_rng(2)
    z = 0.7 * COLUMNS - 1.1 * ROWS + 0.1 * rng.standard_normal(COLUMNS.shape)
    found = best_fit(HeightMap(x=X, y=X, z=z), "plane", distance="normal")
    points = np.stack([COLUMNS.ravel(), ROWS.ravel(), z.ravel()], axis=1)
    middle = points.mean(axis=0)
    nx, ny, nz = np.linalg.svd(points - middle)[2][2]
    assert found.parameters["slope_x"] == pytest.approx(-nx / nz, rel=1e-9)
    assert found.parameters["slope_y"] == pytest.approx(-ny / nz, rel=1e-9)
    flat = np.stack([np.ones(z.size), COLUMNS.ravel(), ROWS.ravel()], axis=1)
    vertical = best_fit(HeightMap(x=X, y=X, z=z), "plane")
    assert list(vertical.parameters.values()) == pytest.approx(np.linalg.lstsq(flat, z.ravel())[0], rel=1e-9)
    truth = np.linalg.inv(flat.T @ flat) * np.sum((z.ravel() - flat @ np.linalg.lstsq(flat, z.ravel())[0]) ** 2)
    assert list(vertical.uncertainty.values()) == pytest.approx(np.sqrt(np.diag(truth) / (z.size - 3)), rel=1e-9)


def test_normal_distances_of_a_conic_are_the_shortest():
    conic = Conic(radius=9.0, conic=0.4).placed(shift=(0.1, 0.0, 0.0), tilt=(0.05, 0.1))
    heights = seen(conic, noise=0.02, missing=0.0)
    free = ("z", "tilt_x", "tilt_y", "radius")
    found = best_fit(heights, Conic(radius=9.0, conic=0.4), distance="normal", free=free)
    z = heights.z
    for row, column in ((3, 5), (30, 30), (55, 10), (20, 58)):
        point = np.array([X[column], X[row], z[row, column]])

        def gap(at, point=point):
            return [*(point[:2] - at), point[2] - found.surface.sag(*at).item()]

        shortest = optimize.least_squares(gap, point[:2], xtol=1e-15, ftol=1e-15, gtol=1e-15)
        above = np.sign(point[2] - found.surface.sag(point[0], point[1]).item())
        assert found.residual.z[row, column] == pytest.approx(above * np.sqrt(2 * shortest.cost), rel=1e-6)


@pytest.mark.parametrize("distance", ["vertical", "normal"])
def test_no_neighbour_of_the_best_conic_is_better(distance):
    # The gradient of the sum of squares by every parameter, by differences of refitted residuals, is zero.
    start = Conic(radius=9.0, conic=0.4)
    heights = seen(start.placed(shift=(0.1, 0.0, 0.0)), noise=0.01, missing=0.2)
    free = ("x", "y", "z", "radius", "conic")
    best = best_fit(heights, start, distance=distance, free=free)
    total = np.nansum(best.residual.z**2)
    for name in ("radius", "conic"):
        for sign in (-1, 1):
            values = {"radius": best.parameters["radius"], "conic": best.parameters["conic"]}
            values[name] += sign * 2 * best.uncertainty[name]
            near = best_fit(heights, Conic(**values), distance=distance, free=("x", "y", "z"))
            other = np.nansum(near.residual.z**2)
            assert other > total
            # Two standard uncertainties from the best in one direction, the other free: at least about 4 variances.
            assert (other - total) / (total / np.count_nonzero(~np.isnan(heights.z))) > 3.5


@pytest.mark.parametrize("distance", ["vertical", "normal"])
def test_the_stated_uncertainty_is_the_scatter_of_random_trials(distance):
    rng = np.random.default_rng(9)
    sphere = Sphere(radius=12.0).placed(shift=(0.2, 0.1, 0.0))
    x = np.linspace(-3, 3, 25)
    z = sphere.sag(x, x[:, None])
    off = []
    for _ in range(100):
        noisy = HeightMap(x=x, y=x, z=z + rng.normal(0, 1e-4, z.shape))
        found = best_fit(noisy, "sphere", distance=distance)
        off.append(
            [
                (found.parameters[name] - true) / found.uncertainty[name]
                for name, true in (("x", 0.2), ("y", 0.1), ("z", 0.0), ("radius", 12.0))
            ]
        )
    assert np.square(off).mean(axis=0) == pytest.approx(1, abs=0.45)
    assert np.square(off).mean() == pytest.approx(1, abs=0.22)


def test_a_polar_map_and_scattered_points_find_the_same_sphere():
    sphere = Sphere(radius=-30.0).placed(shift=(0.1, -0.2, 0.3))
    radius, angle = np.linspace(0, 4, 40), np.linspace(0, 2 * np.pi, 50)[:-1]
    x, y = np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius
    polar = HeightMap(radius=radius, angle=angle, z=sphere.sag(x, y))
    scattered = HeightMap(x=x.ravel(), y=y.ravel(), z=sphere.sag(x, y).ravel())
    for heights in (polar, scattered):
        assert best_fit(heights, "sphere").parameters["radius"] == pytest.approx(-30.0, rel=1e-10)


def test_interferogram_is_the_departure_from_the_best_fit_sphere():
    # A sphere grown along its normals by a bump is seen as the bump, whatever the slope; along z it is taller by the
    # secant of the slope.
    bump = 1e-4
    for radius in (8.0, -8.0):
        base = Sphere(radius=radius)
        slope = np.hypot(*base.gradient(COLUMNS, ROWS))
        spot = bump * np.exp(-((COLUMNS - 2.5) ** 2 + (ROWS - 2.0) ** 2) / 0.3**2)
        lifted = HeightMap(x=X, y=X, z=base.sag(COLUMNS, ROWS) + spot * np.sqrt(1 + slope**2))
        held = interferogram(lifted, radius=radius).residual.z
        assert np.abs(held - np.median(held) - spot).max() < 0.03 * bump
        along_z = best_fit(lifted, base, free=("x", "y", "z")).residual.z
        top = np.unravel_index(spot.argmax(), spot.shape)
        taller = (along_z - np.median(along_z))[top] / (held - np.median(held))[top]
        assert taller == pytest.approx(np.sqrt(1 + slope[top] ** 2), abs=0.02)
        assert taller > 1.05


def test_fizeau_with_a_held_radius_shows_the_power():
    # A sphere of another radius than the one stated: distances of two spheres by geometry.
    part = Sphere(radius=50.0)
    view = interferogram(HeightMap(x=X, y=X, z=part.sag(COLUMNS, ROWS)), radius=50.5)
    centre = view.parameters["z"] + 50.5
    truth = 50.5 - np.sqrt(
        (COLUMNS - view.parameters["x"]) ** 2
        + (ROWS - view.parameters["y"]) ** 2
        + (part.sag(COLUMNS, ROWS) - centre) ** 2
    )
    assert np.abs(view.residual.z - truth).max() < 1e-12
    assert view.pv_nm > 1000


def test_what_the_heights_do_not_tell_apart_is_refused():
    from turnwright.errors import InputError

    sphere = seen(Sphere(radius=20.0), missing=0.0)
    with pytest.raises(InputError, match=r"cannot separate .*conic"):
        best_fit(sphere, "conic", free=("x", "y", "z", "tilt_x", "tilt_y", "radius"))


@pytest.mark.parametrize("steepness", [6.325, 10.0, 100.0])
def test_a_search_that_leaves_the_heights_is_refused(steepness):
    from turnwright.errors import InputError

    radius, angle = np.linspace(0.0, 1.0, 201), np.linspace(0.0, 2.0 * np.pi, 361)[:-1]
    x, y = radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]
    roof = HeightMap(radius=radius, angle=angle, z=np.hypot(steepness * x, y))
    with pytest.raises(InputError, match=r"sphere|sums of squares"):
        best_fit(roof, "sphere")
