"""Heights and derivatives of a formula: mpmath evaluates it, and its differences over 1e-33, at 100 digits."""

import mpmath
import numpy as np
import sympy as sp

X, Y = sp.symbols("x y", real=True)
DIGITS, STEP = 100, mpmath.mpf(10) ** -33
"""A second difference errs by the squared step, 1e-66, and by 1e-100, rounding, over that: 1e-34 of a height."""


def exact(formula, x, y):
    """Return z, zx, zy, zxx, zxy, zyy of the formula in X and Y at the points, rounded once. (6, n)."""
    function = sp.lambdify((X, Y), formula, "mpmath", cse=True)
    with mpmath.workdps(DIGITS):
        return np.array([_derivatives(function, mpmath.mpf(a), mpmath.mpf(b)) for a, b in zip(x, y, strict=True)]).T


def _derivatives(function, x, y):
    z = {(i, j): function(x + i * STEP, y + j * STEP) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    rows = [
        z[0, 0],
        (z[1, 0] - z[-1, 0]) / (2 * STEP),
        (z[0, 1] - z[0, -1]) / (2 * STEP),
        (z[1, 0] - 2 * z[0, 0] + z[-1, 0]) / STEP**2,
        (z[1, 1] - z[1, -1] - z[-1, 1] + z[-1, -1]) / (4 * STEP**2),
        (z[0, 1] - 2 * z[0, 0] + z[0, -1]) / STEP**2,
    ]
    rounding = 1e-32 * abs(z[0, 0])
    return [float(row) if abs(row) > rounding else 0.0 for row in rows]


def computed(surface, x, y):
    """Return the same six rows from the surface's public methods."""
    return np.array([surface.sag(x, y), *surface.gradient(x, y), *surface.hessian(x, y)])


def error(surface, formula, x, y):
    """Return the largest error of height, slope and second derivative, each relative to its largest size. (3,)."""
    truth, found = exact(formula, x, y), computed(surface, x, y)
    groups = (slice(0, 1), slice(1, 3), slice(3, 6))
    return np.array([np.abs(found[g] - truth[g]).max() / max(np.abs(truth[g]).max(), 1e-300) for g in groups])


def disc(radius, count=40, seed=1):
    """Return random points in a disc, with its centre and points close to it."""
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(-np.pi, np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    distance[:4] = 0.0, 1e-9 * radius, 1e-6 * radius, 1e-3 * radius
    return distance * np.cos(angle), distance * np.sin(angle)


def even_conic(radius, conic, terms=None):
    """Return the formula of a conic with even powers; every number is taken as exactly the double it is."""
    c = 0 if np.isinf(radius) else 1 / sp.Rational(radius)
    s = X**2 + Y**2
    root = sp.sqrt(1 - (1 + sp.Rational(conic)) * c**2 * s)
    return c * s / (1 + root) + sum(sp.Rational(a) * s ** (n // 2) for n, a in (terms or {}).items())
