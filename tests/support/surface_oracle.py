"""Heights and derivatives of a formula: SymPy differentiates it, mpmath evaluates it at 50 digits."""

import mpmath
import numpy as np
import sympy as sp

X, Y = sp.symbols("x y", real=True)


def exact(formula, x, y, digits=50):
    """Return z, zx, zy, zxx, zxy, zyy of the formula in X and Y at the points, rounded once. (6, n)."""
    wanted = [formula, *(sp.diff(formula, *by) for by in ((X,), (Y,), (X, X), (X, Y), (Y, Y)))]
    function = sp.lambdify((X, Y), wanted, "mpmath", cse=True)
    with mpmath.workdps(digits):
        return np.array(
            [[float(v) for v in function(mpmath.mpf(a), mpmath.mpf(b))] for a, b in zip(x, y, strict=True)]
        ).T


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
