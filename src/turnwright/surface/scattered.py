"""A surface defined by heights at scattered points."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright._arrays import Bools, Floats, frozen
from turnwright._validate import check_numbers
from turnwright.errors import InputError
from turnwright.surface.base import Surface
from turnwright.surface.gridded import Gridded
from turnwright.units import say_length

if TYPE_CHECKING:
    from scipy.interpolate import RBFInterpolator

__all__ = ["MOST_SCATTERED", "Scattered"]

MIN_SCATTERED = 30
"""Points; a polynomial of degree 5 has 21 coefficients."""

MOST_SCATTERED = 2000
"""Points; the equations for their weights are solved at once."""

DEGREE = 5
"""Degree of the polynomials that are reproduced exactly."""

STEPS_PER_DISTANCE = 2.0
"""Steps of the grid per median distance of neighbouring points."""

FOLDS = 5
"""Folds of the cross-validation; each of the first two is predicted from all others."""

MAX_CHECKED_CELLS = 2000
"""Cells at whose middles the spline is compared with the radial functions."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scattered(Surface):
    r"""Heights at scattered points, interpolated by a smooth surface.

    Radial functions :math:`r^5` and a polynomial of degree 5 interpolate all points exactly. They are evaluated once on
    a grid with half the distance of neighbouring points, which a bicubic spline interpolates, see `Gridded`. The
    surface is defined in the convex hull of the points, which must therefore extend beyond the clear aperture.

    Parameters
    ----------
    x, y, z
        The points. Each (n,) [mm]
    source
        Description of the heights in a job file, where they were read from a file.

    Attributes
    ----------
    fit_error
        Estimated interpolation error: the largest error of a cross-validation, in which twice a fifth of the points is
        predicted from the others (without points near the edge of the hull), or of the spline if that is larger. The
        surface through all points is usually better. [mm]

    Raises
    ------
    InputError
        If there are fewer than 30 or more than 2000 points, a number is not finite, two points coincide, or all points
        are on a line.

    Sources
    -------
    [Wendland2005]_ ch. 8: polyharmonic splines.
    """

    hidden = ("source",)
    x: Floats
    y: Floats
    z: Floats
    source: Any = field(default=None, compare=False, repr=False)
    fit_error: float = field(init=False)
    _grid: Gridded = field(init=False, repr=False)
    _hull: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        from scipy.spatial import ConvexHull, KDTree, QhullError  # noqa: PLC0415 - scipy is costly to import

        for name in "xyz":
            object.__setattr__(self, name, frozen(getattr(self, name), f"{name} of scattered points"))
        if not self.x.size == self.y.size == self.z.size:
            raise InputError(
                f"scattered points have {self.x.size} x, {self.y.size} y and {self.z.size} z: give equal numbers"
            )
        if not MIN_SCATTERED <= self.x.size <= MOST_SCATTERED:
            raise InputError(
                f"a surface of scattered points has {self.x.size} points, the limits are {MIN_SCATTERED} and "
                f"{MOST_SCATTERED}: give a grid of heights, or thin the list"
            )
        middle = np.array([(at.max() + at.min()) / 2 for at in (self.x, self.y)])
        size = max(float(np.ptp(at)) for at in (self.x, self.y)) / 2
        # Normalised to the half size of the part, so that the equations are well scaled.
        places = (np.stack([self.x, self.y], axis=1) - middle) / size if size > 0 else np.zeros((self.x.size, 2))
        try:
            hull = ConvexHull(places)
        except QhullError as error:
            raise InputError("all scattered points are on a line: give points over the whole part") from error
        distance = np.asarray(KDTree(places).query(places, 2)[0])[:, 1]
        if distance.min() < 1e-9:
            first = int(distance.argmin())
            raise InputError(
                f"two scattered points are at x = {self.x[first]:.6g} mm, y = {self.y[first]:.6g} mm: remove one"
            )
        # Lines a x + b y + c <= 0 that bound the hull. (n, 3)
        lines = np.column_stack(
            [hull.equations[:, :2] / size, hull.equations[:, 2] - hull.equations[:, :2] @ middle / size]
        )
        object.__setattr__(self, "_hull", frozen(lines, "hull", ndim=2))
        step = float(np.median(distance)) / STEPS_PER_DISTANCE
        axis = np.linspace(-1 - 4 * step, 1 + 4 * step, int(np.ceil(2 / step)) + 9)
        u, v = np.meshgrid(axis, axis)
        through = _fit_rbf(places, self.z)
        # The functions are smooth beyond the hull too, so that the spline is as accurate at the border as inside.
        heights = through(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(u.shape)
        object.__setattr__(self, "_grid", Gridded(x=middle[0] + size * axis, y=middle[1] + size * axis, z=heights))
        middles = axis[:-1] + np.diff(axis) / 2
        between = np.stack([at.ravel() for at in np.meshgrid(middles, middles)], axis=1)
        chosen = np.flatnonzero(self.inside(*(middle + size * between).T))
        chosen = chosen[:: -(-chosen.size // MAX_CHECKED_CELLS)]
        at = np.concatenate([between[chosen], places])
        (spline,) = self._grid.evaluate(middle[0] + size * at[:, 0], middle[1] + size * at[:, 1], 0)
        spline_error = float(np.abs(spline - through(at)).max())
        prediction_error = self._cross_validate(places, hull.equations, STEPS_PER_DISTANCE * step)
        object.__setattr__(self, "fit_error", max(spline_error, prediction_error))

    def _cross_validate(self, places: Floats, lines: Floats, margin: float) -> float:
        """Return the largest error of points that are predicted from others. [mm]."""
        worst = 0.0
        inner = (lines[:, :2] @ places.T + lines[:, 2:]).max(axis=0) < -margin
        fold = np.random.default_rng(0).permutation(self.x.size) % FOLDS
        for number in range(2):
            training, test = fold != number, (fold == number) & inner
            if test.any():
                predicted = _fit_rbf(places[training], self.z[training])(places[test])
                worst = max(worst, float(np.abs(predicted - self.z[test]).max()))
        return worst

    @property
    def file(self) -> str:
        """File from which the heights were read, by which a job names them; empty if none."""
        return "" if self.source is None else str(self.source.file)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives. See `Surface.evaluate`."""
        return self._grid.evaluate(x, y, order)

    def inside(self, x: Floats, y: Floats) -> Bools:
        """Return the mask of points in the hull."""
        a, b, c = self._hull.T
        within = np.ones(x.shape, dtype=np.bool_)
        for k in range(a.size):
            within &= a[k] * x + b[k] * y + c[k] <= 1e-12
        return within

    @property
    def domain(self) -> str:
        """The hull of the points in words."""
        return (
            f"the convex hull of its {self.x.size} points, x from {self.x.min():.6g} to {self.x.max():.6g} mm and y "
            f"from {self.y.min():.6g} to {self.y.max():.6g} mm"
        )

    @property
    def feature_size(self) -> float:
        """The step of the grid. [mm]."""
        return self._grid.feature_size

    @property
    def remarks(self) -> tuple[str, ...]:
        """Interpolation error between the points. See `Surface.remarks`."""
        sentence = (
            f"{self.x.size} scattered points, interpolated by radial functions: the estimated interpolation error is "
            f"{say_length(self.fit_error)} (cross-validation); finer structure is not included"
        )
        return (sentence,)


def _fit_rbf(places: Floats, z: Floats) -> RBFInterpolator:
    from scipy.interpolate import RBFInterpolator  # noqa: PLC0415

    return RBFInterpolator(places, z, kernel="quintic", degree=DEGREE)
