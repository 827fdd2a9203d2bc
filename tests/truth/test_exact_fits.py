"""Least-squares forms of data whose optimum is known by construction.

The data are a form plus a residual that is orthogonal to every derivative of the form by its parameters, so that the
sum of squares is stationary there; the residual is small, so that it is least. Oracle: SymPy's derivatives and a
projection by QR.
"""

import numpy as np
import pytest
import sympy

from area_oracle import ring_weights
from cases import every_second
from turnwright.heightmap import HeightMap
from turnwright.metrology import best_fit, fit_zernike, remove_form
from turnwright.surface import Conic, EvenAsphere, Sphere

U, V = sympy.symbols("u v")
NAMES = ("x", "y", "z", "tilt_x", "tilt_y", "radius", "conic", "a4", "a6")
TRUE = {
    "x": 0.3,
    "y": -0.2,
    "z": 0.7,
    "tilt_x": 0.02,
    "tilt_y": -0.03,
    "radius": 17.0,
    "conic": -0.6,
    "a4": 2e-5,
    "a6": -3e-7,
}


def form_columns(free, u, v, true):
    """Return points of the form, its normals, and how fast the form moves along them with each free parameter."""
    x, y, z, alpha, beta, radius, conic, a4, a6 = symbols = sympy.symbols(" ".join(NAMES))
    s = U**2 + V**2
    sag = s / radius / (1 + sympy.sqrt(1 - (1 + conic) * s / radius**2)) + a4 * s**2 + a6 * s**3
    turn = sympy.rot_axis1(-alpha) * sympy.rot_axis2(-beta)
    point = turn * sympy.Matrix([U, V, sag]) + sympy.Matrix([x, y, z])
    normal = turn * sympy.Matrix([-sag.diff(U), -sag.diff(V), 1])
    normal /= sympy.sqrt(1 + sag.diff(U) ** 2 + sag.diff(V) ** 2)
    speeds = [normal.dot(point.diff(symbol)) for symbol, name in zip(symbols, NAMES, strict=True) if name in free]
    values = dict(zip(symbols, (true[name] for name in NAMES), strict=True))

    def numbers(what):
        found = sympy.lambdify((U, V), [one.subs(values) for one in what], "numpy", cse=True)(u, v)
        return np.stack([one * np.ones_like(u) for one in found])

    return numbers(point), numbers(normal), numbers(speeds)


def orthogonal(columns, size, seed=5, weights=None):
    """Return random residuals to which every column is orthogonal, weighted by ``weights``. (k, n) gives (n,)."""
    root = np.ones(columns.shape[1]) if weights is None else np.sqrt(weights)
    basis = np.linalg.qr((columns * root).T)[0]
    noise = np.random.default_rng(seed).standard_normal(columns.shape[1])
    for _ in range(2):
        noise -= basis @ (basis.T @ noise)
    return size * noise / root


def disc(count=900, radius=4.0):
    rng = np.random.default_rng(8)
    r, angle = radius * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return r * np.cos(angle), r * np.sin(angle)


SPHERE = {**TRUE, "tilt_x": 0.0, "tilt_y": 0.0, "conic": 0.0, "a4": 0.0, "a6": 0.0}
CONIC = {**TRUE, "a4": 0.0, "a6": 0.0}
FORMS = {
    "sphere": ("sphere", SPHERE, ("x", "y", "z", "radius")),
    "sphere of stated radius": (Sphere(radius=17.0), SPHERE, ("x", "y", "z")),
    "dome": ("sphere", {**SPHERE, "radius": -9.0}, ("x", "y", "z", "radius")),
    "conic": ("conic", {**CONIC, "tilt_x": 0.0, "tilt_y": 0.0}, ("x", "y", "z", "radius", "conic")),
    "tilted conic": (
        Conic(radius=16.0, conic=-0.6),
        CONIC,
        ("x", "y", "z", "tilt_x", "tilt_y", "radius"),
    ),
    "tilted asphere": (
        EvenAsphere(radius=16.5, conic=-0.6, terms={4: 1e-5, 6: 0.0}),
        TRUE,
        ("x", "y", "z", "tilt_x", "tilt_y", "radius", "a4", "a6"),
    ),
}


@pytest.mark.parametrize(("name", "distance"), every_second(FORMS, ["vertical", "normal"]))
def test_a_form_is_found_under_an_orthogonal_residual(name, distance):
    form, true, free = FORMS[name]
    point, normal, speeds = form_columns(free, *disc(), true)
    # At a point that is off by e along z, the height of the form under it moves with the speed over n_z.
    way = normal if distance == "normal" else np.array([[0.0], [0.0], [1.0]])
    residual = orthogonal(speeds if distance == "normal" else speeds / normal[2], 1e-3)
    x, y, z = point + residual * way
    found = best_fit(HeightMap(x=x, y=y, z=z), form, distance=distance, free=free)
    assert dict(found.parameters) == pytest.approx({one: true[one] for one in free}, rel=1e-9)
    assert found.rms_nm == pytest.approx(1e6 * np.sqrt(np.mean(residual**2)), rel=1e-12)
    np.testing.assert_allclose(found.residual.z, residual, rtol=0, atol=1e-12)


@pytest.mark.parametrize("distance", ["vertical", "normal"])
def test_a_plane_is_found_under_an_orthogonal_residual(distance):
    x, y = disc()
    p, q = 0.4, -0.7
    normal = np.array([-p, -q, 1.0]) / np.sqrt(1 + p * p + q * q)
    residual = orthogonal(np.stack([np.ones_like(x), x, y]), 1e-2)
    way = normal if distance == "normal" else np.array([0.0, 0.0, 1.0])
    at = np.stack([x, y, 0.3 + p * x + q * y]) + residual * way[:, None]
    found = best_fit(HeightMap(x=at[0], y=at[1], z=at[2]), "plane", distance=distance)
    assert dict(found.parameters) == pytest.approx({"z": 0.3, "slope_x": p, "slope_y": q}, rel=1e-12)


def uneven(rng, size):
    axis = np.sort(rng.uniform(-4, 4, size))
    middle = (axis[1:] + axis[:-1]) / 2
    return axis, np.diff(np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]]))


@pytest.mark.parametrize("polar", [False, True])
def test_a_sphere_on_a_grid_weighs_areas_and_omits_holes(polar):
    rng = np.random.default_rng(4)
    if polar:
        radius, angle = np.linspace(0.2, 4, 30), np.linspace(0, 2 * np.pi, 41)[:-1]
        axes, x, y = (
            {"radius": radius, "angle": angle},
            np.cos(angle)[:, None] * radius,
            np.sin(angle)[:, None] * radius,
        )
        area = np.ones((40, 1)) * ring_weights(radius)
    else:
        (across, width), (along, height) = uneven(rng, 35), uneven(rng, 28)
        axes, (x, y) = {"x": across, "y": along}, np.meshgrid(across, along)
        area = height[:, None] * width
    valid = rng.random(x.shape) > 0.2
    point, normal, speeds = form_columns(("x", "y", "z", "radius"), x[valid] - 0.3, y[valid] + 0.2, SPHERE)
    z = np.full(x.shape, np.nan)
    residual = orthogonal(speeds / normal[2], 1e-3, weights=area[valid])
    z[valid] = point[2] + residual
    found = best_fit(HeightMap(z=z, **axes), "sphere")
    assert dict(found.parameters) == pytest.approx({"x": 0.3, "y": -0.2, "z": 0.7, "radius": 17.0}, rel=1e-9)
    left = remove_form(HeightMap(z=z, **axes), "sphere").z
    np.testing.assert_allclose(left[valid], residual, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 3, 8])
def test_a_polynomial_is_removed_under_an_orthogonal_residual(degree):
    rng = np.random.default_rng(6)
    (across, width), (along, height) = uneven(rng, 35), uneven(rng, 30)
    x, y = np.meshgrid(across, along)
    valid = rng.random(x.shape) > 0.2
    terms = np.stack(
        [(x[valid] / 4) ** i * (y[valid] / 4) ** j for i in range(degree + 1) for j in range(degree + 1 - i)]
    )
    residual = orthogonal(terms, 1.0, weights=(height[:, None] * width)[valid])
    z = np.full(x.shape, np.nan)
    z[valid] = rng.standard_normal(len(terms)) @ terms + residual
    left = remove_form(HeightMap(x=across, y=along, z=z), degree).z
    np.testing.assert_allclose(left[valid], residual, rtol=0, atol=1e-11)


def test_zernike_terms_are_found_under_an_orthogonal_residual():
    """The fringe terms 1 to 9, written out."""
    x, y = disc(600, 2.0)
    a, b = x / 2, y / 2
    r2 = a * a + b * b
    terms = [
        1 + 0 * a, a, b, 2 * r2 - 1, a * a - b * b, 2 * a * b,
        (3 * r2 - 2) * a, (3 * r2 - 2) * b, 6 * r2 * r2 - 6 * r2 + 1,
    ]  # fmt: skip
    true = np.array([1, -2, 3, -4, 5, -6, 7, -8, 9]) * 1e-4
    z = true @ np.stack(terms) + orthogonal(np.stack(terms), 1e-3)
    found = fit_zernike(HeightMap(x=x, y=y, z=z), terms=9, indexing="fringe", radius=2.0, centre=(0.0, 0.0))
    np.testing.assert_allclose(found.coefficients, true, rtol=1e-12)
