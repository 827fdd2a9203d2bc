"""Removal of form by least squares before texture is evaluated."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

from turnwright.errors import InputError
from turnwright.metrology.best_fits import subtract_sphere
from turnwright.metrology.grid import measure, valid_points
from turnwright.metrology.separable import subtract_polynomial

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

Form: TypeAlias = str | int

MAX_DEGREE = 10


def remove_form(heights: HeightMap, form: Form) -> HeightMap:
    r"""Return the map without its form, fitted by least squares over the valid points.

    On a polar map every point counts with its area. Combinations of polynomial terms whose effect on the valid points
    is below 1/3,000,000 of the largest, as at degree 10 over a narrow slice, stay in the map.

    Parameters
    ----------
    heights
        Missing points stay missing.
    form
        ``"none"``; ``"mean"``, a constant; ``"plane"``; an integer, the total degree of a polynomial in x and y;
        or ``"sphere"``, the best-fit sphere in z, of any position, radius and sense of curvature (planes included).

    Raises
    ------
    InputError
        If the form is unknown, the map has fewer points than the form has parameters, or no sphere fits.

    Sources
    -------
    ISO 25178-3; least squares in z replace total least squares, because optics are specified in sag.

    >>> import numpy as np
    >>> from turnwright.heightmap import HeightMap
    >>> x = np.linspace(-1, 1, 5)
    >>> bowl = HeightMap(x=x, y=x, z=100 - np.sqrt(100**2 - x**2 - x[:, None] ** 2))
    >>> bool(np.abs(remove_form(bowl, "sphere").z).max() < 1e-12)
    True
    """
    degree = {"mean": 0, "plane": 1}.get(form, form) if isinstance(form, str) else form
    if form == "none":
        return heights
    if degree == "sphere":
        return subtract_sphere(heights)
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise InputError(
            f'form is {form!r}, it must be "none", "mean", "plane", "sphere" or the degree of a polynomial from 0 to '
            f"{MAX_DEGREE}: choose one of them"
        )
    terms = (degree + 1) * (degree + 2) // 2
    valid = valid_points(heights, terms, f"a form of degree {degree}")
    return replace(heights, z=subtract_polynomial(heights.z, valid, measure(heights), degree, polar=heights.polar))
