"""A surface given by heights at scattered points."""

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

FEWEST_SCATTERED = 30
"""Points that a polynomial of degree 5 is more than fixed by."""

MOST_SCATTERED = 2000
"""Points of one list: the equations for their weights are solved at once."""

DEGREE = 5
"""Degree of the polynomials that are reproduced exactly."""

FINER = 2.0
"""Steps of the grid to the typical distance of two neighbouring points."""

FOLDS = 5
"""Parts that the points are dealt into; each of the first two is predicted from all others."""

MOST_MIDDLES = 2000
"""Middles of cells at which the spline is compared with what it stands for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scattered(Surface):
    r"""Heights at scattered points, joined by a smooth surface through every one of them.

    Radial functions :math:`r^5` and a polynomial of degree 5 go through all points exactly. They are evaluated once on
    a grid with half the distance of neighbouring points, and a bicubic spline joins that grid, see `Gridded`; the
    surface is defined within the convex hull of the points, so these must reach beyond the clear radius.

    Parameters
    ----------
    x, y, z
        The points. Each (n,) [mm]
    source
        How a job file names the heights, where they were read from a file.

    Attributes
    ----------
    fit_error
        What the surface may be off between the points: the largest of the errors that are made when a fifth of the
        points is predicted from the others, twice, points near the edge of the hull left out, and of the spline's own.
        With all points it is usually less. [mm]

    Raises
    ------
    InputError
        If there are fewer than 30 or more than 2000 points, a number is not finite, two points share a place, or all
        stand on a line.

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
                f"scattered points have {self.x.size} x, {self.y.size} y and {self.z.size} z: give as many of each"
            )
        if not FEWEST_SCATTERED <= self.x.size <= MOST_SCATTERED:
            raise InputError(
                f"a surface of scattered points has {self.x.size} of them, the limits are {FEWEST_SCATTERED} and "
                f"{MOST_SCATTERED}: give a grid of heights, or thin the list"
            )
        middle = np.array([(at.max() + at.min()) / 2 for at in (self.x, self.y)])
        size = max(float(np.ptp(at)) for at in (self.x, self.y)) / 2
        # In units of half the part, so that the equations are well scaled.
        places = (np.stack([self.x, self.y], axis=1) - middle) / size if size > 0 else np.zeros((self.x.size, 2))
        try:
            hull = ConvexHull(places)
        except QhullError as error:
            raise InputError("all scattered points stand on a line: give points over the whole part") from error
        apart = np.asarray(KDTree(places).query(places, 2)[0])[:, 1]
        if apart.min() < 1e-9:
            first = int(apart.argmin())
            raise InputError(
                f"two scattered points stand at x = {self.x[first]:.6g} mm, y = {self.y[first]:.6g} mm: remove one"
            )
        # Lines a x + b y + c <= 0 that bound the hull. (n, 3)
        lines = np.column_stack(
            [hull.equations[:, :2] / size, hull.equations[:, 2] - hull.equations[:, :2] @ middle / size]
        )
        object.__setattr__(self, "_hull", frozen(lines, "hull", ndim=2))
        step = float(np.median(apart)) / FINER
        axis = np.linspace(-1 - 4 * step, 1 + 4 * step, int(np.ceil(2 / step)) + 9)
        u, v = np.meshgrid(axis, axis)
        through = _through(places, self.z)
        # The functions are smooth beyond the hull too, so that the spline is as good at its border as within.
        heights = through(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(u.shape)
        object.__setattr__(self, "_grid", Gridded(x=middle[0] + size * axis, y=middle[1] + size * axis, z=heights))
        middles = axis[:-1] + np.diff(axis) / 2
        between = np.stack([at.ravel() for at in np.meshgrid(middles, middles)], axis=1)
        chosen = np.flatnonzero(self.inside(*(middle + size * between).T))
        chosen = chosen[:: -(-chosen.size // MOST_MIDDLES)]
        at = np.concatenate([between[chosen], places])
        (spline,) = self._grid.evaluate(middle[0] + size * at[:, 0], middle[1] + size * at[:, 1], 0)
        off = float(np.abs(spline - through(at)).max())
        object.__setattr__(self, "fit_error", max(off, self._missed(places, hull.equations, FINER * step)))

    def _missed(self, places: Floats, lines: Floats, apart: float) -> float:
        """Return the largest error of points that are predicted from others. [mm]."""
        worst = 0.0
        inner = (lines[:, :2] @ places.T + lines[:, 2:]).max(axis=0) < -apart
        part = np.random.default_rng(0).permutation(self.x.size) % FOLDS
        for number in range(2):
            known, asked = part != number, (part == number) & inner
            if asked.any():
                predicted = _through(places[known], self.z[known])(places[asked])
                worst = max(worst, float(np.abs(predicted - self.z[asked]).max()))
        return worst

    @property
    def stated(self) -> Any:
        """How a job file names the heights. See `Surface.stated`."""
        return self.source

    @property
    def file(self) -> str:
        """The file that the heights were read from; empty if none."""
        return "" if self.source is None else str(self.source.file)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives. See `Surface.evaluate`."""
        return self._grid.evaluate(x, y, order)

    def inside(self, x: Floats, y: Floats) -> Bools:
        """Return where the hull of the points is."""
        a, b, c = self._hull.T
        within = np.ones(x.shape, dtype=np.bool_)
        for k in range(a.size):
            within &= a[k] * x + b[k] * y + c[k] <= 1e-12
        return within

    @property
    def domain(self) -> str:
        """Say where the points are."""
        return (
            f"the convex hull of its {self.x.size} points, x from {self.x.min():.6g} to {self.x.max():.6g} mm and y "
            f"from {self.y.min():.6g} to {self.y.max():.6g} mm"
        )

    @property
    def feature_size(self) -> float:
        """The step of the grid that stands for the points. [mm]."""
        return self._grid.feature_size

    @property
    def remarks(self) -> tuple[str, ...]:
        """Say what is missed between the points. See `Surface.remarks`."""
        sentence = (
            f"{self.x.size} scattered points, joined by radial functions through all of them: a fifth of the points "
            f"left out is predicted from the others to {say_length(self.fit_error)}, finer structure is not in it"
        )
        return (sentence,)


def _through(places: Floats, z: Floats) -> RBFInterpolator:
    """Return radial functions through points."""
    from scipy.interpolate import RBFInterpolator  # noqa: PLC0415

    return RBFInterpolator(places, z, kernel="quintic", degree=DEGREE)
