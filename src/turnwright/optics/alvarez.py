"""Focal length of a pair of freeform lenses against their shear."""

from __future__ import annotations

import math

import numpy as np

from turnwright._arrays import Floats, gauss_rule
from turnwright._validate import finite, positive
from turnwright.errors import DomainError
from turnwright.heightmap import HeightMap
from turnwright.metrology import fit_zernike
from turnwright.optics.orders import path_factor
from turnwright.optics.pupil import PathMap
from turnwright.surface import Surface

__all__ = ["alvarez_focal_length"]

MAP_TERMS = 66
"""Zernike terms up to degree 10 through which a map enters."""

RINGS, AZIMUTHS = 48, 96
"""Nodes of the quadrature over a disc, exact for polynomials up to degree 95."""


def alvarez_focal_length(
    first: Surface | HeightMap, second: Surface | HeightMap, *, shear: float, index: float, radius: float | None = None
) -> float:
    r"""Focal length along x of two thin lenses that face each other and are displaced in opposite senses.

    The second lens is turned half a turn about y. With the heights :math:`z_1, z_2` of the two surfaces, each in its
    own part frame, the pair has the thickness

    .. math:: T(x, y) = z_1(x - d, y) + z_2(-x - d, y), \qquad 1/f = -(n - 1) T_{xx}(0, 0)

    Parameters
    ----------
    first, second
        The surfaces, or simulated or measured maps of them (heights, not errors).
    shear
        Displacement d of each lens; they are 2 d apart. [mm]
    index
        Refractive index of the lenses.
    radius
        Semi-diameter of a disc over which piston, tilts and a term in r² are fitted to T; paraxial if left out. [mm]

    Returns
    -------
    float
        Positive for a converging pair; infinite without power. [mm]

    Raises
    ------
    InputError
        If the index is not above 1, or the radius is not positive.
    DomainError
        If a surface is not defined where the pair needs it.

    Notes
    -----
    A map enters by Zernike polynomials up to degree 10, fitted over its own aperture.

    Sources
    -------
    [Alvarez1967]_ for the pair; [Troutman2016]_ ch. 7 for one in the infrared. Oracle: SymPy's second derivative.

    >>> from turnwright.surface import XYPolynomial
    >>> cubic = XYPolynomial(terms={(3, 0): 1e-3 / 3, (1, 2): 1e-3})
    >>> round(alvarez_focal_length(cubic, cubic, shear=1.0, index=1.5), 6)   # T = -2 d a r², f = 1 / (4 a d (n - 1))
    500.0
    """
    power_of_height = float(path_factor(index=index))
    d = finite(shear, "shear")
    reach = 0.0 if radius is None else positive(radius, "radius", "mm")
    x, y, weight = _disc(reach)
    one, other = (
        _surface(lens, np.append(side * x - d, -d), np.append(y, 0.0)) for lens, side in ((first, 1), (second, -1))
    )
    if radius is None:
        middle = np.array([-d])
        bend = float((one.hessian(middle, 0.0)[0] + other.hessian(middle, 0.0)[0])[0])
    else:
        thickness = one.sag(x - d, y) + other.sag(-x - d, y)
        # The Zernike term 2 r² - 1 is orthogonal to piston and tilts.
        focus = 2 * (x * x + y * y) / reach**2 - 1
        bend = float(4 * (weight * focus * thickness).sum() / (weight * focus * focus).sum() / reach**2)
    power = -power_of_height * bend
    return 1 / power if power else math.inf


def _surface(lens: Surface | HeightMap, x: Floats, y: Floats) -> Surface:
    """Return a surface, or the one fitted to a map, which must have heights around the points."""
    if isinstance(lens, Surface):
        return lens
    _, measured = PathMap(lens)(x, y)
    if not measured.all():
        at = int(measured.argmin())
        raise DomainError(
            f"the map {lens.name!r} has no height at x = {x[at]:.6g} mm, y = {y[at]:.6g} mm, where the pair needs it: "
            "reduce the shear or the radius, or measure more of the lens"
        )
    return fit_zernike(lens, terms=MAP_TERMS, indexing="ansi").surface


def _disc(radius: float) -> tuple[Floats, Floats, Floats]:
    """Return nodes and weights of a quadrature over a disc. Each (n,) [mm, mm, 1]."""
    node, weight = gauss_rule(RINGS)
    r, angle = radius * np.sqrt((node + 1) / 2), 2 * math.pi * np.arange(AZIMUTHS) / AZIMUTHS
    return (
        np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel(),
        np.repeat(weight, AZIMUTHS) / (2 * AZIMUTHS),
    )  # fmt: skip
