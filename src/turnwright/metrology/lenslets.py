r"""Lens arrays: the form of every lenslet, and where it stands.

A lenslet is fitted with its design form :math:`f` (or a sphere) on the base :math:`b` of the part,

.. math:: z = b(x, y) + h + f_0 + s\,[f(u/s, v/s) - f_0] + a\,u + c\,v, \qquad u = x - x_c,\; v = y - y_c

by least squares of the vertical distance over the points within ``inner`` lens radii of the centre that is found, the
derivatives exact. The centre :math:`(x_c, y_c)` and the height :math:`h` are always free. The scale :math:`s` of all
lengths turns a sphere of radius R into one of radius s R; the slopes a, c tilt the form.

Sources
-------
[Kong2019]_ separates lenses and base by the factors 0.95 and 1.05 of the lens radius, and takes the base first. The
lowest pixel of a lens is not its centre: noise of 20 nm moves it by :math:`\sqrt{2 R \cdot 20\,\mathrm{nm}}`, 20 um on
a lens of R 10 mm. Uncertainties are those of [Liang1986]_: points that stand together may err together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, overload

import numpy as np
from numpy.polynomial.legendre import legvander

from turnwright._arrays import Bools, Floats, Ints, between, frozen, positive
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology._grid import measure, valid_points
from turnwright.pose import Pose
from turnwright.progress import cores, run_chunks
from turnwright.surface import LensArray, Placed, Plane, Sphere, Sum, Surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from turnwright.part import Part

__all__ = ["Alignment", "Lenslet", "Lenslets", "has_lenslets", "lenslets"]

NM = 1e6

FEWEST = 30
"""Points below which a lenslet is not fitted."""

LEAST_COVERAGE = 0.5
"""Share of the aperture that must hold points."""

WHOLE = 0.95
"""Share of the aperture above which a lenslet counts as wholly measured; pixels at the rim are lost to the raster."""

TOLD_APART = 1e-4
"""Least share of a parameter's effect, in squares, that the others cannot imitate: a 100-fold uncertainty."""

COARSE = 4000
"""Points of a lenslet that are enough to find it."""

STEPS = 12
"""Rounds of fit and separation, at most; each shrinks the error of the centre about five times."""

SETTLED = 2e-6
"""Step of the centre, in lens radii, at which separation and fit agree."""

DEGREE = 6
"""Of the polynomial that stands for the smooth form when spikes and scatter are judged."""

OUTLIER = 6.0
"""Standard deviations, estimated from the median, beyond which a point is a spike."""

GRAIN = 5e-6
"""What a spike must exceed even on a map without noise. [mm]"""

BLOCKS = 12
"""Blocks across a lenslet, and twice that across a base, within which points may err together."""

PER_BLOCK = 8
"""Points that a block should hold."""

REGISTERED = 100_000
"""Points that are enough to register an array, which is then levelled on its base."""

LEVELLING = 300_000
"""Points of the base that are enough to level it."""

FLAT = 1e-9
"""A slope, or a height over a length, that has no effect."""

SIGMA = 1.4826
"""Standard deviation of a normal scatter over the median of its magnitudes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    r"""The shift, rotation and scale that bring the design centres closest to the found ones.

    What an array as a whole does, such as clocking of the part on the instrument or thermal growth, must not be
    mistaken for an error of the machine from lens to lens: that is the rest.

    Parameters
    ----------
    shift, shift_std
        Of the array, at the axis of the part, and its standard uncertainty from the scatter of the lenslets. [mm]
    rotation, rotation_std
        About the axis of the part, counter-clockwise seen from the tool. [rad]
    scale, scale_std
        Of all distances, less one. [1]
    rest
        Dislocations that remain. (n, 2) [mm]
    share
        How much of the dislocations, their mean removed, rotation and scale explain: share of the squares. [1]
    """

    shift: tuple[float, float]
    shift_std: float
    rotation: float
    rotation_std: float
    scale: float
    scale_std: float
    rest: Floats
    share: float

    @classmethod
    def of(cls, design: ArrayLike, centres: ArrayLike) -> Alignment:
        """Fit found centres to design centres, both (n, 2) [mm], n at least 2.

        Raises
        ------
        InputError
            If there are fewer than two lenslets, not as many of one as of the other, or all in one place.

        >>> corners = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
        >>> turned = Alignment.of(corners, corners @ [[1, 0.002], [-0.002, 1]])
        >>> round(turned.rotation, 6), round(turned.share, 6)
        (0.002, 1.0)
        """
        from_, to = frozen(design, "design centres", ndim=2), frozen(centres, "centres", ndim=2)
        if from_.shape != to.shape or from_.shape[1] != 2 or from_.shape[0] < 2:
            raise InputError(
                f"design centres and centres have the shapes {from_.shape} and {to.shape}, both must be (n, 2) with n "
                "of 2 or more: give x and y of at least two lenslets"
            )
        middle = from_.mean(axis=0)
        about, moved = from_ - middle, to - to.mean(axis=0)
        spread = float(np.sum(about**2))
        if spread <= 0:
            raise InputError("all design centres stand in one place, two places are needed: give other centres")
        # As complex numbers a rotation with scale is one factor, found by linear least squares.
        along = float(np.sum(about * moved)) / spread
        across = float(np.sum(about[:, 0] * moved[:, 1] - about[:, 1] * moved[:, 0])) / spread
        turn = np.array([[along, -across], [across, along]])
        rest = moved - about @ turn.T
        shift = to.mean(axis=0) - turn @ middle
        freedom = 2 * from_.shape[0] - 4
        scatter = float(np.sqrt(np.sum(rest**2) / freedom)) if freedom else float("nan")
        dislocated = float(np.sum((moved - about) ** 2))
        return cls(
            shift=(float(shift[0]), float(shift[1])),
            shift_std=scatter * float(np.sqrt(1 / from_.shape[0] + middle @ middle / spread)),
            rotation=float(np.arctan2(across, along)),
            rotation_std=scatter / float(np.sqrt(spread)),
            scale=float(np.hypot(along, across)) - 1,
            scale_std=scatter / float(np.sqrt(spread)),
            rest=frozen(rest, "rest", ndim=2),
            share=1 - float(np.sum(rest**2)) / dislocated if dislocated > 0 else float("nan"),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lenslet:
    """One lenslet, as found. What could not be found is nan, and ``finding`` says why.

    Parameters
    ----------
    number
        Counted from 1, in the order of the centres of the array.
    design, centre, centre_std
        Where its origin should be, where it is, and the standard uncertainty from noise (x, y). [mm]
    height, height_std
        Of its vertex above the design. [mm]
    radius, radius_error, radius_std
        Of curvature, from a fit in which it is free; that minus the design's; standard uncertainty. [mm]
    tilt, tilt_std
        Slopes (zx, zy) added to the form, if they were free. [rad]
    sq_nm, pv_nm
        Of the heights that the fitted form leaves, spikes left out.
    scatter_nm
        Rms of what no smooth form explains: noise and texture.
    points, outliers
        How many points the numbers rest on, and how many spikes were left out.
    coverage
        Share of the aperture that holds points. [1]
    finding
        Why it was not fitted, or what is to be known of it; empty where all is well.
    residual
        What the fitted form leaves, at points about the centre. [mm]
    """

    number: int
    design: tuple[float, float]
    centre: tuple[float, float]
    centre_std: tuple[float, float]
    height: float
    height_std: float
    radius: float
    radius_error: float
    radius_std: float
    tilt: tuple[float, float]
    tilt_std: tuple[float, float]
    sq_nm: float
    pv_nm: float
    scatter_nm: float
    points: int
    outliers: int
    coverage: float
    finding: str
    residual: HeightMap

    @property
    def measured(self) -> bool:
        """Whether it could be fitted."""
        return bool(np.isfinite(self.centre).all())

    @property
    def dislocation(self) -> tuple[float, float]:
        """Found centre minus design centre (x, y). [mm]."""
        return self.centre[0] - self.design[0], self.centre[1] - self.design[1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lenslets(Sequence[Lenslet]):
    """All lenslets of an array in the order of its centres, and what they say together.

    Parameters
    ----------
    items
        The lenslets, also those that could not be fitted.
    form
        ``"design"`` or ``"sphere"``, what was fitted.
    frame
        Says in words what centres and dislocations refer to.
    pose
        From the map's frame to the frame of the centres.
    alignment
        Shift, rotation and scale of the array; ``None`` with fewer than two lenslets fitted.
    base_points
        Points of the base, those more than ``outer`` lens radii away from every lenslet.
    base_sq_nm, base_pv_nm
        Of the base minus its design at up to 300,000 of its points, spikes left out; nan without a base.
    """

    items: tuple[Lenslet, ...]
    form: str
    frame: str
    pose: Pose
    alignment: Alignment | None
    base_points: int
    base_sq_nm: float
    base_pv_nm: float

    def __len__(self) -> int:
        return len(self.items)

    @overload
    def __getitem__(self, index: int) -> Lenslet: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Lenslet]: ...
    def __getitem__(self, index: int | slice) -> Lenslet | Sequence[Lenslet]:
        """Return a lenslet, or several."""
        return self.items[index]

    @property
    def measured(self) -> Bools:
        """Which lenslets could be fitted. (n,)."""
        return np.array([one.measured for one in self.items])

    @property
    def design(self) -> Floats:
        """Where the lenslets should be. (n, 2) [mm]."""
        return np.array([one.design for one in self.items])

    @property
    def centres(self) -> Floats:
        """Where they are, nan where not fitted. (n, 2) [mm]."""
        return np.array([one.centre for one in self.items])

    @property
    def dislocations(self) -> Floats:
        """Found centres minus design centres in `frame`. (n, 2) [mm]."""
        return self.centres - self.design

    @property
    def centred(self) -> Floats:
        """The dislocations with their mean removed. (n, 2) [mm]."""
        dislocations = self.dislocations
        return dislocations - dislocations[self.measured].mean(axis=0) if self.measured.any() else dislocations

    @property
    def irregular(self) -> Floats:
        """The dislocations without shift, rotation and scale: the same in every frame. (n, 2) [mm]."""
        rest = np.full((len(self.items), 2), np.nan)
        if self.alignment is not None:
            rest[self.measured] = self.alignment.rest
        return rest

    @property
    def findings(self) -> tuple[str, ...]:
        """What is to be known of single lenslets, one sentence each."""
        return tuple(
            f"lens {one.number} at ({one.design[0]:g}, {one.design[1]:g}) mm: {one.finding}"
            for one in self.items
            if one.finding
        )

    def table(self) -> str:
        """Return the table that a person reads: lengths in um, forms in nm."""
        heading = (
            f"{'lens':>4}{'design x, y [mm]':>20}{'dislocation x, y [um]':>23}{'+-':>8}{'irregular x, y [um]':>22}"
            f"{'height [um]':>13}{'R - design, +- [um]':>21}{'Sq [nm]':>9}{'PV [nm]':>9}{'covered':>9}"
        )
        lines = [heading]
        for one, rest in zip(self.items, self.irregular, strict=True):
            places = f"{one.number:4d}{one.design[0]:10.4f}{one.design[1]:10.4f}"
            if not one.measured:
                lines.append(f"{places}   {one.finding}")
                continue
            away = [1e3 * part for part in (*one.dislocation, max(one.centre_std), *rest)]
            lines.append(
                f"{places}{away[0]:12.3f}{away[1]:11.3f}{away[2]:8.3f}{away[3]:11.3f}{away[4]:11.3f}"
                f"{1e3 * one.height:13.3f}{1e3 * one.radius_error:12.3f}{1e3 * one.radius_std:9.3f}"
                f"{one.sq_nm:9.1f}{one.pv_nm:9.1f}{one.coverage:9.0%}"
            )
        return "\n".join(lines)

    def csv(self) -> str:
        """Return one row for each lenslet, in the units of the heading; empty cells where nothing was found."""
        heading = (
            "lens,design_x_mm,design_y_mm,centre_x_mm,centre_y_mm,centre_std_x_mm,centre_std_y_mm,dislocation_x_mm,"
            "dislocation_y_mm,irregular_x_mm,irregular_y_mm,height_mm,height_std_mm,radius_mm,radius_error_mm,"
            "radius_std_mm,tilt_x_rad,tilt_y_rad,sq_nm,pv_nm,scatter_nm,points,outliers,coverage,finding"
        )
        lines = [heading]
        for one, rest in zip(self.items, self.irregular, strict=True):
            values = (
                *one.design, *one.centre, *one.centre_std, *one.dislocation, *rest, one.height, one.height_std,
                one.radius, one.radius_error, one.radius_std, *one.tilt, one.sq_nm, one.pv_nm, one.scatter_nm,
            )  # fmt: skip
            cells = [str(one.number), *("" if np.isnan(value) else f"{value:.9g}" for value in values)]
            cells += [str(one.points), str(one.outliers), f"{one.coverage:.4f}", one.finding.replace(",", ";")]
            lines.append(",".join(cells))
        return "\n".join(lines) + "\n"


def lenslets(
    heights: HeightMap,
    part: Part,
    *,
    inner: float = 0.95,
    outer: float = 1.05,
    pose: Pose | None = None,
    form: str = "design",
    radius: bool = False,
    tilt: bool = False,
    aperture: float | None = None,
    level: bool = True,
) -> Lenslets:
    """Find every lenslet of a measured array: its centre, its height, its radius, and the form error it has.

    A lenslet is found up to about half its radius from where it should be.

    Parameters
    ----------
    heights
        The measured map; missing points are missing, spikes are left out.
    part
        The design: a `LensArray`, alone or added to a base, and placed as a whole or on its base.
    inner, outer
        Points within ``inner`` lens radii of a found centre belong to the lenslet, those beyond ``outer`` of all to
        the base; between them lies the rim, which no instrument shows well.
    pose
        From the map's frame to the part's; ``Pose()`` if the map is in the part's frame already. By default the map
        is registered, see `register`.
    form
        ``"design"``, the design form; ``"sphere"``, the best sphere, its radius free.
    radius
        Whether the radius of the design form is free: its form error is then that of the form alone.
    tilt
        Whether the tilt of each lenslet is free. On a sphere a tilt is a shift, which is refused.
    aperture
        Radius of a lenslet; by default that of the array or, where lenslets fill their cells, that of the circle
        that the cell holds. [mm]
    level
        Whether tilt, height and, where the base fixes it better than the lenslets do, rotation are those of the base:
        base first, then the lenslets on it. Without it they are those of the pose. `Lenslets.frame` says what was done.

    Raises
    ------
    InputError
        If the part has no lens array or several, the form cannot tell its own centre, a factor is out of range, or
        the map has no heights.

    Sources
    -------
    [Kong2019]_. Oracles: SciPy's dense fit of the true surface; closed forms.

    >>> from turnwright.part import Part
    >>> array = LensArray.square(pitch=1.0, rows=2, columns=2, lenslet=Sphere(radius=5.0))
    >>> x = np.linspace(-1, 1, 201)
    >>> moved = array.placed(shift=(0.003, 0, 0))
    >>> made = HeightMap(x=x, y=x, z=moved.sag(x, x[:, None]))
    >>> found = lenslets(made, Part(surface=array, radius=1.0), pose=Pose())
    >>> found[0].dislocation[0].__round__(9), found[3].measured
    (0.003, True)
    """
    between(inner, "inner, the share of its radius that belongs to a lenslet,", 0.1, 1.0, "lens radii")
    between(outer, "outer, where the base begins,", inner, 10.0, "lens radii")
    if form not in ("design", "sphere"):
        raise InputError(f'form is {form!r}, it can be "design" or "sphere": choose one of them')
    design = _design(part, form, aperture)
    free = _free(design, inner, radius=radius or form == "sphere", tilt=tilt)
    heights.require_calibrated()
    valid_points(heights, 1, "a fit of lenslets")
    if pose is None:
        from turnwright.metrology.registration import register  # noqa: PLC0415 - costly to import

        # Displaced lenslets are no reason to turn the rest, so they pull less the farther off they are.
        pose = register(_thinned(heights, REGISTERED), part, loss="huber").pose
    pose = design.outer.inverse.after(pose)
    points = _points(heights, pose, design)
    starts = np.zeros((design.centres.shape[0], 6))
    starts[:, :2] = design.centres
    seen = np.zeros(starts.shape[0], dtype=np.bool_)

    def find(k: int) -> None:
        if (rough := _coarse(points, design, k, inner)) is not None:
            starts[k], seen[k] = rough, True

    _each(starts.shape[0], find)
    base = _base(points, design, starts, outer)
    frame = "the part's frame: shift, rotation, tilt and height by the pose"
    # The second time from so near that the step is linear and what is left is form.
    for _ in range(2 if level and base.size >= FEWEST else 0):
        correction, frame = _level(points, base, design, starts, seen)
        pose = correction.after(pose)
        points = _points(heights, pose, design)
        starts[:, 0], starts[:, 1], _ = correction.apply(starts[:, 0], starts[:, 1], 0.0)
        base = _base(points, design, starts, outer)
    found: dict[int, _Found] = {}

    def fit(k: int) -> None:
        found[k] = _fit(points, design, k, starts, free, inner)

    _each(starts.shape[0], fit)
    items = tuple(_lenslet(k, found[k], design) for k in range(starts.shape[0]))
    measured = [one for one in items if one.measured]
    alignment = None
    if len(measured) > 1:
        alignment = Alignment.of([one.design for one in measured], [one.centre for one in measured])
    base = _base(points, design, np.array([found[k].local for k in range(starts.shape[0])]), outer)
    error, weight = _base_error(points, base, design)[0], points.weight[base]
    few = np.flatnonzero(np.isfinite(error))
    few, size = few[:: few.size // LEVELLING + 1], (float("nan"), float("nan"))
    if few.size >= FEWEST:
        x, y = (part[base[few]] / design.reach for part in (points.x, points.y))
        keep = few[_smooth(x, y, error[few]).keep]
        size = _size(error[keep], weight[keep])
    return Lenslets(
        items=items,
        form=form,
        frame=frame,
        pose=design.outer.after(pose),
        alignment=alignment,
        base_points=base.size,
        base_sq_nm=size[0],
        base_pv_nm=size[1],
    )


def has_lenslets(surface: Surface) -> bool:
    """Say whether a surface holds one lens array, so that `lenslets` can look at it."""
    return len(_arrays(surface)) == 1


class _Points(NamedTuple):
    """Valid points in the frame of the array's base, sorted by squares of the plane. Each (n,)."""

    x: Floats
    y: Floats
    z: Floats
    departure: Floats  # from the base alone
    weight: Floats  # the area that each stands for
    low: Floats  # where the first square begins
    step: float  # side of a square
    squares: int  # of them along x and along y
    first: Ints  # where the points of each square begin

    def near(self, centre: Floats, radius: float) -> Ints:
        """Return which points lie within a radius of a centre. (k,)."""
        ends = np.floor((np.stack([centre[:2] - radius, centre[:2] + radius]) - self.low) / self.step)
        (left, bottom), (right, top) = np.clip(ends, -1, self.squares).astype(np.int64)
        left, right = max(left, 0), min(right, self.squares - 1)
        spans = [
            np.arange(self.first[row * self.squares + left], self.first[row * self.squares + right + 1])
            for row in range(max(bottom, 0), min(top, self.squares - 1) + 1)
            if left <= right
        ]
        chosen = np.concatenate(spans) if spans else np.empty(0, dtype=np.int64)
        away = (self.x[chosen] - centre[0]) ** 2 + (self.y[chosen] - centre[1]) ** 2
        return np.asarray(chosen[away <= radius**2])


class _Design(NamedTuple):
    """What the array should be."""

    outer: Pose  # from the frame of base and array to the part's
    base: Surface | None  # all that is added to the array
    centres: Floats
    radii: Floats
    lens: Surface  # about its own origin, turned as the array is
    vertex: float  # height of the lens at its origin
    radius: float  # of curvature there, nan if it has none
    surround: Surface | None  # what lies between the lenslets; None where they fill their cells
    reach: float  # the clear radius


class _Free(NamedTuple):
    """Which parameters are fitted, and which beside them for the radius; None if the form does not tell it."""

    columns: list[int]
    with_radius: list[int] | None


class _Smooth(NamedTuple):
    """Which points are no spikes, the smooth form at all points, and how many terms it has."""

    keep: Bools
    form: Floats
    terms: int


class _Found(NamedTuple):
    """What the fit of one lenslet gave, in the frame of the base."""

    parameters: Floats | None  # None where it was not fitted
    covariance: Floats  # (6, 6), nan for what was not free
    growth: tuple[float, float]  # scale less one, and its uncertainty
    local: Floats  # the centre, or where it was last looked for
    residual: HeightMap
    size_nm: tuple[float, float]
    scatter_nm: float
    points: int
    outliers: int
    coverage: float
    finding: str


def _arrays(surface: Surface) -> list[Surface]:
    """Return the terms of a surface that hold a lens array."""
    while isinstance(surface, Placed):
        surface = surface.surface
    if isinstance(surface, Sum):
        return [term for term in surface.terms if _arrays(term)]
    return [surface] if isinstance(surface, LensArray) else []


def _design(part: Part, form: str, aperture: float | None) -> _Design:
    """Take the part apart: base, array, where both sit."""
    outer, surface = Pose(), part.surface
    while isinstance(surface, Placed):
        outer, surface = outer.after(surface.pose), surface.surface
    terms = surface.terms if isinstance(surface, Sum) else (surface,)
    arrays = [term for term in terms if _arrays(term)]
    if len(arrays) != 1:
        raise InputError(
            f"the surface of the part, a {type(part.surface).__name__}, holds {len(arrays)} lens arrays, it must hold "
            "1: give a LensArray, or a base with one added to it"
        )
    rest = tuple(term for term in terms if term is not arrays[0])
    array, inside = arrays[0], Pose()
    while isinstance(array, Placed):
        inside, array = inside.after(array.pose), array.surface
    if not isinstance(array, LensArray) or inside.tilt != (0.0, 0.0):
        raise InputError(
            f"the lens array is tilted against its base by {np.rad2deg(inside.tilt)} deg or hidden in a placed sum, "
            "the limit is 0 deg: place base and array together"
        )
    x, y, _ = inside.apply(array.centres[:, 0], array.centres[:, 1], 0.0)
    centres = np.stack([x, y], axis=1)
    lens, surround = array.lenslet, array.surround
    if surround is not None and not isinstance(surround, Surface):
        surround = Plane(slope=(0.0, 0.0)).placed(shift=(0.0, 0.0, float(surround)))
    if inside != Pose():
        lens = lens.placed(shift=(0.0, 0.0, inside.shift[2]), rotation=inside.rotation)
        if surround is not None:
            surround = surround.placed(shift=inside.shift, rotation=inside.rotation)
    radii = _radii(centres, array.aperture if aperture is None else aperture, part.radius)
    z, zx, zy, zxx, zxy, zyy = (float(value[0]) for value in lens.evaluate(np.zeros(1), np.zeros(1), 2))
    mean = ((1 + zy * zy) * zxx - 2 * zx * zy * zxy + (1 + zx * zx) * zyy) / (2 * (1 + zx * zx + zy * zy) ** 1.5)
    vertex = z if np.isfinite(z) else 0.0
    curved = bool(np.isfinite(mean) and abs(mean) * radii.max() > FLAT)
    if form == "sphere":
        if not curved:
            raise InputError(
                f"the lenslet's curvature at its vertex is {mean:g} per mm, a sphere to start from needs one other "
                "than 0: fit the design form"
            )
        lens = Sphere(radius=1 / mean).placed(shift=(0.0, 0.0, vertex))
    return _Design(
        outer=outer,
        base=(Sum(terms=rest) if len(rest) > 1 else rest[0]) if rest else None,
        centres=centres,
        radii=radii,
        lens=lens,
        vertex=vertex,
        radius=1 / mean if curved else float("nan"),
        surround=surround,
        reach=part.radius,
    )


def _radii(centres: Floats, aperture: float | None, reach: float) -> Floats:
    """Return the radius of every lenslet: the aperture, or that of the largest circle in its cell. (n,) [mm]."""
    if aperture is not None:
        return np.full(centres.shape[0], positive(aperture, "aperture of a lenslet", "mm"))
    if centres.shape[0] == 1:
        return np.array([reach])
    from scipy.spatial import cKDTree  # noqa: PLC0415 - scipy is costly to import

    distance, _ = cKDTree(centres).query(centres, k=2)
    return np.asarray(distance)[:, 1] / 2


def _free(design: _Design, inner: float, *, radius: bool, tilt: bool) -> _Free:
    """Return which parameters are fitted, after a look at whether the form tells them apart."""
    free = [0, 1, 2, *([3] if radius else []), *([4, 5] if tilt else [])]
    reach = inner * float(design.radii.min())
    u, v = (part.ravel() for part in np.meshgrid(*2 * [np.linspace(-reach, reach, 41)]))
    within = u * u + v * v <= reach**2
    _, slopes = _model(design, np.zeros(6), u[within], v[within], [0, 1, 2, 3, 4, 5])
    slopes = slopes[np.isfinite(slopes).all(axis=1)]
    names = ("centre along x", "centre along y", "height", "radius", "tilt along x", "tilt along y")

    def alone(columns: list[int]) -> dict[int, float]:
        """Return how much of the effect of each parameter no other one can imitate, in squares."""
        size = np.sqrt(np.mean(slopes[:, columns] ** 2, axis=0))
        # A slope, a height and a relative size that have less effect than this have none.
        if (size <= FLAT * np.where(np.array(columns) == 3, reach, 1.0)).any():
            return {columns[int(np.argmin(size))]: 0.0}
        scaled = slopes[:, columns] / size
        left = []
        for k in range(len(columns)):
            others = np.delete(scaled, k, axis=1)
            missed = scaled[:, k] - others @ np.linalg.lstsq(others, scaled[:, k], rcond=None)[0]
            left.append(float(np.mean(missed**2)))
        return dict(zip(columns, left, strict=True))

    for column, share in alone(free).items():
        if share < TOLD_APART:
            raise InputError(
                f"the form of the lenslet tells the {names[column]} from the other free parameters by {share:.1g} of "
                f"its effect, in squares, the limit is {TOLD_APART:g}: "
                + ("leave the tilt fixed" if tilt else "fit a form with more curvature, or a larger aperture")
            )
    known = np.isfinite(design.radius) and min(alone(sorted({*free, 3})).values()) >= TOLD_APART
    return _Free(columns=free, with_radius=sorted({*free, 3}) if known else None)


def _model(design: _Design, parameters: Floats, x: Floats, y: Floats, free: list[int]) -> tuple[Floats, Floats]:
    """Return what a lenslet adds to the base (n,), and its derivatives by the free parameters (n, k).

    The parameters are those of the module's formula: centre x, y, height, scale less one, slopes; about the origin.
    """
    at_x, at_y, height, growth, slope_x, slope_y = parameters
    dx, dy = x - at_x, y - at_y
    u, v = dx / (1 + growth), dy / (1 + growth)
    z, zx, zy = design.lens.evaluate(u, v, 1)
    z -= design.vertex
    value = design.vertex + height + (1 + growth) * z + slope_x * dx + slope_y * dy
    slopes = np.empty((x.size, len(free)))
    for place, column in enumerate(free):
        match column:
            case 0:
                slopes[:, place] = -zx - slope_x
            case 1:
                slopes[:, place] = -zy - slope_y
            case 2:
                slopes[:, place] = 1.0
            case 3:
                slopes[:, place] = z - u * zx - v * zy
            case _:
                slopes[:, place] = dx if column == 4 else dy
    return value, slopes


def _points(heights: HeightMap, pose: Pose, design: _Design) -> _Points:
    """Bring the map into the frame of the base, within the clear radius, sorted by squares of the plane."""
    valid = ~np.isnan(heights.z)
    x, y, z = (part[valid] for part in (*heights.points(), heights.z))
    if heights.scattered:
        weight = np.ones(x.size)
    else:
        grid = measure(heights)
        weight = (grid.row_width[:, None] * grid.column_area)[valid]
        weight /= weight.max()
    x, y, z = pose.apply(x, y, z)
    part_x, part_y, _ = design.outer.apply(x, y, z)
    kept = (part_x**2 + part_y**2 <= design.reach**2) & (weight > 0)
    if design.base is not None and (inside := design.base.inside(x, y)) is not None:
        kept &= inside
    if not kept.any():
        raise InputError(
            f"0 of the {x.size} valid points of the map lie within the clear radius {design.reach:g} mm of the part: "
            "check the pose and the units"
        )
    step = max(float(design.radii.max()) / 2, design.reach / 1000)
    count = int(2 * design.reach / step) + 3
    low = np.array([x[kept].min(), y[kept].min()])
    across, along = ((part - start) / step for part, start in zip((x, y), low, strict=True))
    cell = np.minimum(along[kept].astype(np.int64), count - 1) * count
    cell += np.minimum(across[kept].astype(np.int64), count - 1)
    order = np.flatnonzero(kept)[np.argsort(cell, kind="stable")]
    x, y, z, weight = (np.ascontiguousarray(part[order]) for part in (x, y, z, weight))
    base = design.base.evaluate(x, y, 0)[0] if design.base is not None else 0.0
    first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=count * count))])
    return _Points(x, y, z, z - base, weight, low, step, count, first)


def _thinned(heights: HeightMap, most: int) -> HeightMap:
    """Return so many valid points of a map, chosen without a pattern that the raster could beat with."""
    valid = np.flatnonzero(~np.isnan(heights.z).ravel())
    if valid.size > most:
        valid = np.sort(np.random.default_rng(0).choice(valid, most, replace=False))
    x, y, z = (part.ravel()[valid] for part in (*heights.points(), heights.z))
    return HeightMap(x=x, y=y, z=z, name=heights.name)


def _each(count: int, work: Callable[[int], None]) -> None:
    """Do the work for every lenslet, on all cores."""

    def some(start: int, stop: int) -> None:
        for k in range(start, stop):
            work(k)

    run_chunks(some, count, max(1, count // (8 * cores())))


def _step(slopes: Floats, error: Floats, weight: Floats) -> Floats:
    """Return the weighted least-squares step. (k,)."""
    weighted = slopes * weight[:, None]
    normal = weighted.T @ slopes
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    step = np.linalg.lstsq(normal / np.outer(size, size), weighted.T @ error / size, rcond=1e-12)[0]
    return np.asarray(step / size)


def _coarse(points: _Points, design: _Design, k: int, inner: float) -> Floats | None:
    """Find a lenslet roughly, from its middle outward; return its parameters, or ``None``."""
    radius, parameters = float(design.radii[k]), np.zeros(6)
    parameters[:2] = design.centres[k]
    free = [0, 1, 2]
    for share in (0.5, 0.75, inner):
        chosen = points.near(parameters, share * radius)
        if chosen.size < FEWEST:
            return None
        chosen = chosen[:: chosen.size // COARSE + 1]
        x, y, departure, weight = (part[chosen] for part in (points.x, points.y, points.departure, points.weight))
        for _ in range(STEPS):
            value, slopes = _model(design, parameters, x, y, free)
            error = departure - value
            keep = np.isfinite(error)
            off = np.abs(error - np.median(error[keep])) if keep.any() else error
            keep &= off <= max(OUTLIER * SIGMA * float(np.median(off[keep])), GRAIN) if keep.any() else False
            if np.count_nonzero(keep) < FEWEST:
                return None
            step = _step(slopes[keep], error[keep], weight[keep])
            parameters[free] += step
            if not np.hypot(*(parameters[:2] - design.centres[k])) < radius:
                return None
            if np.hypot(*step[:2]) < 1e-4 * radius:
                break
    return parameters


def _smooth(x: Floats, y: Floats, error: Floats) -> _Smooth:
    """Fit a polynomial to what a form leaves, spikes left out. The points lie in [-1, 1]."""
    degree = DEGREE
    while degree and (degree + 1) * (degree + 2) // 2 * PER_BLOCK > error.size:
        degree -= 1
    along_x, along_y = legvander(x, degree), legvander(y, degree)
    terms = np.stack([along_x[:, i] * along_y[:, j] for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
    off = np.abs(error - np.median(error))
    # Form itself may stand out this much; what it is, the first polynomial shows.
    keep = off <= max(2 * OUTLIER * SIGMA * float(np.median(off)), GRAIN)
    normal, right, form = terms.T @ terms, terms.T @ error, error
    for _ in range(6):
        spikes = terms[~keep]
        solved = np.linalg.lstsq(normal - spikes.T @ spikes, right - spikes.T @ error[~keep], rcond=1e-12)[0]
        form = terms @ solved
        off = np.abs(error - form)
        last, keep = keep, off <= max(OUTLIER * SIGMA * float(np.median(off)), GRAIN)
        if np.array_equal(last, keep):
            break
    return _Smooth(keep, form, terms.shape[1])


def _blocks(u: Floats, v: Floats, most: int) -> tuple[Ints, float]:
    """Number the blocks that points of the unit disc lie in, and return how much of the disc they cover. (n,)."""
    count = int(np.clip(np.sqrt(u.size / PER_BLOCK), 3, most))
    row, column = (np.clip((part + 1) / 2 * count, 0, count - 1).astype(np.int64) for part in (v, u))
    number = row * count + column
    middle = (2 * np.arange(count) + 1) / count - 1
    disc = (np.hypot(middle, middle[:, None]) <= 1).ravel()
    filled = np.bincount(number, minlength=count * count) > 0
    return number, float(np.count_nonzero(filled & disc) / np.count_nonzero(disc))


def _covariance(slopes: Floats, rest: Floats, weight: Floats, blocks: Ints, terms: int) -> Floats:
    """Return the covariance of fitted parameters when points of one block may err together. (k, k)."""
    weighted = slopes * weight[:, None]
    inverse = np.linalg.pinv(weighted.T @ slopes, rcond=1e-15)
    score = np.stack([np.bincount(blocks, weights=column * rest) for column in weighted.T], axis=1)
    count = int(np.count_nonzero(np.bincount(blocks)))
    # A polynomial of as many terms was taken off: it has taken its share of the scatter with it.
    together = score.T @ score * (count / max(count - terms, 1))
    return np.asarray(inverse @ together @ inverse)


def _size(error: Floats, weight: Floats) -> tuple[float, float]:
    """Return rms and peak to valley. [nm]."""
    return float(np.sqrt(np.average(error**2, weights=weight))) * NM, float(np.ptp(error)) * NM


def _missing(parameters: Floats, count: int, coverage: float, finding: str) -> _Found:
    """Return a lenslet that could not be fitted."""
    empty = np.empty(0)
    nan = float("nan")
    return _Found(
        None, np.full((6, 6), nan), (nan, nan), parameters[:2], HeightMap(x=empty, y=empty, z=empty), (nan, nan), nan,
        count, 0, coverage, finding,
    )  # fmt: skip


def _fit(points: _Points, design: _Design, k: int, starts: Floats, free: _Free, inner: float) -> _Found:
    """Fit one lenslet over the points around its own centre."""
    parameters, reach = starts[k].copy(), inner * float(design.radii[k])
    apart = np.hypot(*(starts[:, :2] - starts[k, :2]).T)
    grain = 0.0
    rivals = starts[(apart < 2.2 * reach) & (apart > 0), :2]
    for _ in range(STEPS):
        chosen = points.near(parameters, reach + grain)
        for rival in rivals:  # where cells touch, a lenslet's neighbour may stand inside of its circle
            x, y = points.x[chosen], points.y[chosen]
            own = (x - parameters[0]) ** 2 + (y - parameters[1]) ** 2
            chosen = chosen[own <= (x - rival[0]) ** 2 + (y - rival[1]) ** 2]
        if chosen.size < FEWEST:
            words = f"{chosen.size} points within {inner:g} of its radius, a fit needs {FEWEST}: measure more of it"
            return _missing(parameters, chosen.size, 0.0, words)
        x, y, departure, weight = (part[chosen] for part in (points.x, points.y, points.departure, points.weight))
        before = parameters[:2].copy()
        value, _ = _model(design, parameters, x, y, free.columns)
        u, v, error = (x - before[0]) / reach, (y - before[1]) / reach, departure - value
        # A point at the rim counts with the share of its pixel that lies within, so that no point jumps in or out.
        grain = reach * float(np.sqrt(np.pi / chosen.size)) / 2
        weight = weight * np.clip((reach * (1 - np.hypot(u, v)) / grain + 1) / 2, 0, 1)
        known = np.isfinite(error) & (weight > 0)
        if np.count_nonzero(known) < FEWEST:
            words = f"its form is defined at {np.count_nonzero(known)} points, a fit needs {FEWEST}: check the design"
            return _missing(parameters, chosen.size, 0.0, words)
        x, y, u, v, departure, weight = (part[known] for part in (x, y, u, v, departure, weight))
        smooth = _smooth(u, v, error[known])
        x, y, u, v, departure, weight = (part[smooth.keep] for part in (x, y, u, v, departure, weight))
        _gauss_newton(design, parameters, x, y, departure, weight, free.columns)
        if not np.hypot(*(parameters[:2] - design.centres[k])) < design.radii[k]:
            words = f"no such form within its radius of {design.radii[k]:g} mm: check the pose and the design"
            return _missing(starts[k], x.size, 0.0, words)
        if np.hypot(*(parameters[:2] - before)) < SETTLED * reach:
            break
    return _judge(design, free, parameters, (x, y, u, v, departure, weight), smooth)


def _gauss_newton(
    design: _Design, parameters: Floats, x: Floats, y: Floats, departure: Floats, weight: Floats, free: list[int]
) -> Floats:
    """Improve the parameters in place until they stay; return the derivatives at the end. (n, k)."""
    reach = np.ptp(x) + 1e-300
    for _ in range(STEPS):
        value, slopes = _model(design, parameters, x, y, free)
        error = departure - value
        known = np.isfinite(error)
        step = _step(slopes[known], error[known], weight[known])
        parameters[free] += step
        parameters[3] = max(parameters[3], -0.9)
        if np.hypot(*step[:2]) < 1e-9 * reach and np.abs(step[2:]).max() < 1e-9:
            break
    return _model(design, parameters, x, y, free)[1]


def _judge(design: _Design, free: _Free, parameters: Floats, data: tuple[Floats, ...], smooth: _Smooth) -> _Found:
    """Say what a fit is worth."""
    x, y, u, v, departure, weight = data
    value, slopes = _model(design, parameters, x, y, free.columns)
    error = departure - value
    blocks, coverage = _blocks(u, v, BLOCKS)
    outliers = smooth.keep.size - x.size
    if coverage < LEAST_COVERAGE:
        words = f"{coverage:.0%} of its aperture is measured, a fit needs {LEAST_COVERAGE:.0%}: measure more of it"
        return _missing(parameters, x.size, coverage, words)
    spread = float(np.average((departure - np.average(departure, weights=weight)) ** 2, weights=weight))
    left = float(np.average(error**2, weights=weight))
    if left > spread / 2:
        words = (
            f"the form leaves {np.sqrt(left) * NM:.0f} nm rms of {np.sqrt(spread) * NM:.0f} nm, so no such lenslet is "
            "there: check the pose and the design"
        )
        return _missing(parameters, x.size, coverage, words)
    rest = error - _smooth(u, v, error).form
    covariance = np.full((6, 6), np.nan)
    covariance[np.ix_(free.columns, free.columns)] = _covariance(slopes, rest, weight, blocks, smooth.terms)
    growth = float("nan"), float("nan")
    if free.with_radius is not None:
        other = parameters.copy()
        slopes = _gauss_newton(design, other, x, y, departure, weight, free.with_radius)
        place = free.with_radius.index(3)
        variance = _covariance(slopes, rest, weight, blocks, smooth.terms)[place, place]
        growth = float(other[3]), float(np.sqrt(variance))
    return _Found(
        parameters=parameters,
        covariance=covariance,
        growth=growth,
        local=parameters[:2],
        residual=HeightMap(x=x - parameters[0], y=y - parameters[1], z=error, name="lenslet residual"),
        size_nm=_size(error, weight),
        scatter_nm=float(np.sqrt(np.average(rest**2, weights=weight))) * NM,
        points=x.size,
        outliers=outliers,
        coverage=coverage,
        finding="" if coverage >= WHOLE else f"only {coverage:.0%} of its aperture is measured",
    )


def _lenslet(k: int, found: _Found, design: _Design) -> Lenslet:
    """Say in the part's frame what was found."""

    def place(at: Floats, height: float) -> tuple[float, float]:
        x, y = at[:1].copy(), at[1:2].copy()
        base = float(design.base.evaluate(x, y, 0)[0][0]) if design.base is not None else 0.0
        px, py, _ = design.outer.apply(at[0], at[1], base + design.vertex + height)
        return float(px), float(py)

    nan = (float("nan"), float("nan"))
    turn = design.outer.matrix[:2, :2]

    def std(first: int) -> tuple[float, float]:
        span = slice(first, first + 2)
        x, y = np.sqrt(np.diag(turn @ found.covariance[span, span] @ turn.T))
        return float(x), float(y)

    p = found.parameters
    tilted = p is not None and np.isfinite(found.covariance[4, 4])
    tilt = turn @ p[4:6] if p is not None and tilted else nan
    return Lenslet(
        number=k + 1,
        design=place(design.centres[k], 0.0),
        centre=place(p[:2], float(p[2])) if p is not None else nan,
        centre_std=std(0) if p is not None else nan,
        height=float(p[2]) if p is not None else float("nan"),
        height_std=float(np.sqrt(found.covariance[2, 2])),
        radius=design.radius * (1 + found.growth[0]),
        radius_error=design.radius * found.growth[0],
        radius_std=abs(design.radius) * found.growth[1],
        tilt=(float(tilt[0]), float(tilt[1])),
        tilt_std=std(4) if tilted else nan,
        sq_nm=found.size_nm[0],
        pv_nm=found.size_nm[1],
        scatter_nm=found.scatter_nm,
        points=found.points,
        outliers=found.outliers,
        coverage=found.coverage,
        finding=found.finding,
        residual=found.residual,
    )


def _base(points: _Points, design: _Design, centres: Floats, outer: float) -> Ints:
    """Return the points beyond ``outer`` lens radii of all lenslets. (m,)."""
    base = np.full(points.x.size, design.surround is not None)
    if design.surround is not None:
        for centre, radius in zip(centres, design.radii, strict=True):
            base[points.near(centre, outer * radius)] = False
    return np.flatnonzero(base)


def _base_error(points: _Points, base: Ints, design: _Design) -> tuple[Floats, Floats]:
    """Return how far the base is off (m,), and what a turn of the points about x, y, z and a shift along z does to it.

    Returns
    -------
    error, slopes
        (m,) [mm] and (m, 4).
    """
    x, y, z, error = points.x[base], points.y[base], points.z[base], points.departure[base]
    zx, zy = np.zeros(x.size), np.zeros(x.size)
    for surface in (design.base, design.surround):
        if surface is not None:
            height, slope_x, slope_y = surface.evaluate(x, y, 1)
            zx += slope_x
            zy += slope_y
            if surface is design.surround:
                error = error - height
    slopes = np.stack([y + zy * z, -x - zx * z, np.ones(x.size), zx * y - zy * x], axis=1)
    return error, slopes


def _level(points: _Points, base: Ints, design: _Design, starts: Floats, seen: Bools) -> tuple[Pose, str]:
    """Return the turn and the shift along z that bring the base onto its design, and the words for the frame."""
    base = base[:: base.size // LEVELLING + 1]
    weight, reach = points.weight[base], design.reach
    error, slopes = _base_error(points, base, design)
    known = np.isfinite(error)
    base, error, slopes, weight = base[known], error[known], slopes[known], weight[known]
    middle = np.array([np.mean(points.x[base]), np.mean(points.y[base])])
    size = max(float(np.hypot(points.x[base] - middle[0], points.y[base] - middle[1]).max()), 1e-300)
    u, v = (points.x[base] - middle[0]) / size, (points.y[base] - middle[1]) / size
    smooth = _smooth(u, v, error)
    u, v, error, slopes, weight = (part[smooth.keep] for part in (u, v, error, slopes, weight))
    step = -_step(slopes[:, :3], error, weight)
    # What rotation alone does, beside which tilts and height are free.
    along = slopes[:, 3] - slopes[:, :3] @ _step(slopes[:, :3], slopes[:, 3], weight)
    whole = -_step(slopes, error, weight)
    left = error + slopes @ whole
    again = _smooth(u, v, left)
    rest = left - again.form
    strength = float(np.sqrt(np.average(along**2, weights=weight)))
    rotation_std = float("inf")
    if strength > FLAT * reach:
        blocks, _ = _blocks(u, v, 2 * BLOCKS)
        noise = _covariance(along[:, None], rest, weight, blocks, again.terms)[0, 0]
        # Form of the base that is no rotation is seen; as much again may look like one, and is not.
        form = np.average(again.form**2, weights=weight) - again.terms * np.average(rest**2, weights=weight) / u.size
        rotation_std = float(np.sqrt(noise + max(form, 0.0) / strength**2))
    pattern_std = float("inf")
    if np.count_nonzero(seen) > 2:
        pattern_std = Alignment.of(design.centres[seen], starts[seen, :2]).rotation_std
    by_base = rotation_std < pattern_std
    turn = whole if by_base else np.append(step, 0.0)
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - scipy is costly to import

    matrix = Rotation.from_rotvec(turn[[0, 1, 3]]).as_matrix()
    words = "the part's frame: tilt and height by the base, shift by the pose, rotation by the "
    words += f"base within {rotation_std * 1e6:.2g} urad" if by_base else "pose"
    return Pose.of(matrix, (0.0, 0.0, turn[2])), words
