"""Least-squares polynomials in x and y on a grid, through sums over its rows and columns.

Every term is a product of a function of the column and a function of the row: Legendre polynomials of x and of y on a
rectangular grid; polynomials of the radius, and cosines and sines of the angle, on a polar one. The product of two
terms has the same structure. The normal matrix therefore needs only the moments of the valid points, and the right-hand
side those of the heights: products of blocks of rows with narrow matrices, for any pattern of missing points.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from turnwright._arrays import Bools, Floats, Ints, row_blocks
from turnwright.metrology.grid import Grid, by_row_blocks

MAX_STEPS = 20

CONVERGENCE_TOL = 1e-11
"""Change of the coefficients, relative to the largest, at which the heights no longer change."""


class Basis(NamedTuple):
    """The terms of a polynomial as products, and a basis of the products of two terms."""

    columns: Floats  # (n_columns, p), functions of the column
    rows: Floats  # (n_rows, q), functions of the row
    terms: Ints  # (2, k), column function and row function of each term
    column_moments: Floats  # (n_columns, a), basis of the products of two column functions
    row_moments: Floats  # (n_rows, b)
    column_products: Floats  # (a, p, p), their coefficients
    row_products: Floats  # (b, q, q)


def subtract_polynomial(z: Floats, valid: Bools, grid: Grid, degree: int, *, polar: bool) -> Floats:
    """Return heights minus the polynomial of best fit in z, weighted by area.

    The normal equations lose half of the digits; further iterations restore them.

    Parameters
    ----------
    z
        Heights. (n_rows, n_columns) [mm]
    valid
        Heights that count; the others are returned as nan.
    """
    basis = (_polar if polar else _rectangular)(grid, valid, degree)
    missing = None if valid.all() else ~valid
    normal = _normal(basis, grid, valid)
    total = np.zeros(basis.terms.shape[1])
    last = np.inf
    for _ in range(MAX_STEPS):
        # Points on one line do not determine every term; any solution serves, so that of least norm is taken.
        step = np.linalg.lstsq(normal, _right_side(basis, grid, z, missing, total), rcond=1e-13)[0]
        size = np.abs(step).max()
        if size >= last:
            break
        total = total + step
        last = size
        if size <= CONVERGENCE_TOL * np.abs(total).max():
            break
    remainder, residuals = np.empty_like(z), _residuals(basis, z, missing, total, fill=np.nan)

    def fill(rows: slice) -> None:
        remainder[rows] = residuals(rows)

    by_row_blocks(fill, z.shape)
    return remainder


def _legendre(axis: Floats, degree: int) -> Floats:
    return np.asarray(legvander(axis, degree), dtype=np.float64)


def _normal(basis: Basis, grid: Grid, valid: Bools) -> Floats:
    """Return the normal matrix. (k, k)."""
    along = basis.column_moments * grid.column_area[:, None]
    across = basis.row_moments * grid.row_width[:, None]
    if valid.all():
        moments = np.outer(across.sum(axis=0), along.sum(axis=0))
    else:
        moments = np.zeros((across.shape[1], along.shape[1]))
        for rows in row_blocks(valid.shape):
            moments += across[rows].T @ (valid[rows].astype(np.float64) @ along)
    p, q = basis.terms
    both = np.tensordot(moments, basis.column_products[:, p[:, None], p], 1)
    return np.asarray(np.einsum("bkl,bkl->kl", basis.row_products[:, q[:, None], q], both))


def _residuals(
    basis: Basis, z: Floats, missing: Bools | None, total: Floats, *, fill: float
) -> Callable[[slice], Floats]:
    """Return a function for the heights of some rows minus the polynomial, with ``fill`` for missing points."""
    p, q = basis.terms
    table = np.zeros((basis.rows.shape[1], basis.columns.shape[1]))
    table[q, p] = total
    columns, subtracts = np.ascontiguousarray(basis.columns.T), total.any()

    def residuals(rows: slice) -> Floats:
        block = z[rows] - (basis.rows[rows] @ table) @ columns if subtracts else z[rows]
        return block if missing is None else np.where(missing[rows], fill, block)

    return residuals


def _right_side(basis: Basis, grid: Grid, z: Floats, missing: Bools | None, total: Floats) -> Floats:
    """Return the right-hand side of the next iteration. (k,)."""
    weighted = basis.columns * grid.column_area[:, None]
    across = basis.rows * grid.row_width[:, None]
    residuals = _residuals(basis, z, missing, total, fill=0.0)
    parts = by_row_blocks(lambda rows: across[rows].T @ (residuals(rows) @ weighted), z.shape)
    p, q = basis.terms
    return np.asarray(np.sum(parts, axis=0)[q, p])


def _unit(axis: Floats, used: Bools) -> Floats:
    """Return an axis scaled so that its used part spans [-1, 1]."""
    low, high = axis[used][[0, -1]]
    return np.asarray((axis - (low + high) / 2) / (((high - low) / 2) or 1.0))


def _products(values: Floats, moments: Floats, weight: Floats) -> Floats:
    """Expand products of functions, sampled at quadrature nodes, in functions orthogonal under that quadrature."""
    norm = weight @ moments**2
    return np.asarray(np.einsum("na,np,nq,n->apq", moments / norm, values, values, weight, optimize=True))


def _rectangular(grid: Grid, valid: Bools, degree: int) -> Basis:
    """Legendre polynomials of x and y, over the rectangle that holds the valid points."""
    x, y = (_unit(axis, np.any(valid, axis=way)) for axis, way in ((grid.columns, 0), (grid.rows, 1)))
    # Exact for products of two polynomials of this degree and one of twice the degree.
    nodes, weight = leggauss(2 * degree + 1)
    table = _products(_legendre(nodes, degree), _legendre(nodes, 2 * degree), weight)
    terms = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)], dtype=np.int64).T
    return Basis(
        columns=_legendre(x, degree),
        rows=_legendre(y, degree),
        terms=terms,
        column_moments=_legendre(x, 2 * degree),
        row_moments=_legendre(y, 2 * degree),
        column_products=table,
        row_products=table,
    )


def _polar(grid: Grid, valid: Bools, degree: int) -> Basis:
    r"""Zernike polynomials, :math:`r^m P_k^{(0,m)}(2r^2 - 1)` with the cosine or sine of m times the angle."""
    from scipy.special import eval_jacobi  # noqa: PLC0415 - only polar maps need it

    orders = [(n, m) for n in range(degree + 1) for m in range(n % 2, n + 1, 2)]

    def radial(r: Floats) -> Floats:
        return np.stack([r**m * eval_jacobi((n - m) // 2, 0, m, 2 * r * r - 1) for n, m in orders], axis=1)

    def turns(angle: Floats, highest: int) -> Floats:
        m = np.arange(highest + 1)
        return np.hstack([np.cos(angle[:, None] * m), np.sin(angle[:, None] * m[1:])])

    radius = grid.columns / (grid.columns[valid.any(axis=0)][-1] or 1.0)
    nodes, weight = leggauss(2 * degree + 1)
    around = np.linspace(0, 2 * np.pi, 4 * degree + 2, endpoint=False)
    places = [(at, m, sine) for at, (_, m) in enumerate(orders) for sine in ((False, True) if m else (False,))]
    return Basis(
        columns=radial(radius),
        rows=turns(grid.rows, degree),
        terms=np.array([(at, degree + m if sine else m) for at, m, sine in places], dtype=np.int64).T,
        column_moments=_legendre(2 * radius - 1, 2 * degree),
        row_moments=turns(grid.rows, 2 * degree),
        column_products=_products(radial((nodes + 1) / 2), _legendre(nodes, 2 * degree), weight),
        row_products=_products(turns(around, degree), turns(around, 2 * degree), np.ones_like(around)),
    )
