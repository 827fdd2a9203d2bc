r"""Lens arrays: form and position of every lenslet.

A lenslet is fitted with its design form :math:`f` (or a sphere) on the base :math:`b` of the part,

.. math:: z = b(x, y) + h + f_0 + s\,[f(u/s, v/s) - f_0] + a\,u + c\,v, \qquad u = x - x_c,\; v = y - y_c

by least squares of the vertical distance. The scale :math:`s` of all lengths turns a sphere of radius R into one of
radius s R; the slopes a, c tilt the form.

Sources
-------
[Kong2019]_ separates lenses and base by the factors 0.95 and 1.05 of the lens radius. Uncertainties follow
[Liang1986]_, which allows for spatially correlated errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright._validate import between, one_of
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology.alignment import Alignment
from turnwright.metrology.grid import valid_points
from turnwright.metrology.lenslet_fit import (
    MAX_LEVELLING_POINTS,
    MIN_POINTS,
    BaseForm,
    Design,
    FittedLenslet,
    errors_of_base,
    find_arrays,
    find_roughly,
    fit_lenslet,
    fit_smooth,
    free_parameters,
    level_on_base,
    place_points,
    points_of_base,
    size_nm,
    split_design,
    subtract_form,
)
from turnwright.metrology.registration import register, sample
from turnwright.metrology.undetermined import rim_forms
from turnwright.pose import Pose
from turnwright.progress import cores, run_chunks
from turnwright.surface import Zernike

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright.part import Part
    from turnwright.surface import Surface

DEFAULT_BASE_DEGREE = 4

NM = 1e6
SUMMARY_TERMS = 3
MAX_BASE_DEGREE = 12
MAX_REGISTRATION_POINTS = 100_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lenslet:
    """Measured form and position of one lenslet. Undefined values are nan; ``finding`` gives the reason.

    Parameters
    ----------
    number
        Counted from 1, in the order of the centres of the array.
    design, centre, centre_std
        Nominal and measured position of its origin, and the standard uncertainty from noise (x, y). [mm]
    height, height_std
        Height of its vertex above the design, and its standard uncertainty. [mm]
    radius, radius_error, radius_std
        Radius of curvature, from a fit in which it is free; its deviation from the design; standard uncertainty. [mm]
    tilt, tilt_std
        Slopes (zx, zy) added to the form, if they were free. [rad]
    sq_nm, pv_nm
        Of the residual heights, without outliers.
    scatter_nm
        Rms of the residual without smooth form: noise and texture.
    points, outliers
        Number of points used, and of outliers removed.
    coverage
        Share of the aperture that holds points. [1]
    finding
        Why the lenslet was not fitted, or a remark; empty without findings.
    residual
        Residual of the fitted form, relative to the centre. [mm]
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
        """Measured minus nominal centre (x, y). [mm]."""
        return self.centre[0] - self.design[0], self.centre[1] - self.design[1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lenslets(Sequence[Lenslet]):
    """All lenslets of an array in the order of its centres, and the results for the array.

    Parameters
    ----------
    items
        The lenslets, also those that could not be fitted.
    form
        Fitted form, ``"design"`` or ``"sphere"``.
    frame
        Description of the frame of centres and dislocations.
    pose
        From the map's frame to the frame of the centres.
    alignment
        Shift, rotation and scale of the array; ``None`` with fewer than two lenslets fitted.
    base_points
        Number of points of the base, more than ``outer`` lens radii from every lenslet.
    base_sq_nm, base_pv_nm
        Of the base minus its design, without outliers; nan without a base.
    base_form
        Form error of the base in its own frame, as Zernike terms by ANSI number, each with its height at the rim;
        ``None`` if none was fitted. [mm]
    base_form_std
        Standard uncertainty of each of these. [mm]
    """

    items: tuple[Lenslet, ...]
    form: str
    frame: str
    pose: Pose
    alignment: Alignment | None
    base_points: int
    base_sq_nm: float
    base_pv_nm: float
    base_form: Zernike | None
    base_form_std: Mapping[int, float]

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: Any) -> Any:
        """Return a lenslet, or several."""
        return self.items[index]

    @property
    def measured(self) -> Bools:
        """Which lenslets could be fitted. (n,)."""
        return np.array([one.measured for one in self.items])

    @property
    def design(self) -> Floats:
        """Nominal centres. (n, 2) [mm]."""
        return np.array([one.design for one in self.items])

    @property
    def centres(self) -> Floats:
        """Measured centres, nan where not fitted. (n, 2) [mm]."""
        return np.array([one.centre for one in self.items])

    @property
    def dislocations(self) -> Floats:
        """Measured minus nominal centres in `frame`. (n, 2) [mm]."""
        return self.centres - self.design

    @property
    def centred(self) -> Floats:
        """The dislocations with their mean removed. (n, 2) [mm]."""
        dislocations = self.dislocations
        return dislocations - dislocations[self.measured].mean(axis=0) if self.measured.any() else dislocations

    @property
    def irregular(self) -> Floats:
        """The dislocations without shift, rotation and scale: the same in every frame. (n, 2) [mm]."""
        irregular = np.full((len(self.items), 2), np.nan)
        if self.alignment is not None:
            irregular[self.measured] = self.alignment.residual
        return irregular

    @property
    def summary(self) -> str:
        """Number of measured lenslets, residual dislocation and base form error, in a sentence."""
        irregular = self.irregular[self.measured]
        words = f"{len(irregular)} of {len(self)} lenslets"
        if self.alignment is not None:
            off = 1e3 * float(np.sqrt(np.mean(np.sum(irregular**2, axis=1))))
            words += f", dislocations of {off:.3g} um rms beyond shift, rotation and scale"
        if self.base_form is None:
            return words
        # An uncertain term may be as large as its uncertainty, so it is listed too.
        std = self.base_form_std
        terms = sorted(dict(self.base_form.terms).items(), key=lambda term: -np.hypot(term[1], std[term[0]]))[
            :SUMMARY_TERMS
        ]
        named = ", ".join(f"ANSI {number} {value * NM:.3g} +- {std[number] * NM:.2g} nm" for number, value in terms)
        return f"{words}; form of the base at the rim: {named}"

    @property
    def findings(self) -> tuple[str, ...]:
        """Findings about single lenslets, one sentence each."""
        return tuple(
            f"lens {one.number} at ({one.design[0]:g}, {one.design[1]:g}) mm: {one.finding}"
            for one in self.items
            if one.finding
        )

    def table(self) -> str:
        """Return a text table: lengths in um, forms in nm."""
        heading = (
            f"{'lens':>4}{'design x, y [mm]':>20}{'dislocation x, y [um]':>23}{'+-':>8}{'irregular x, y [um]':>22}"
            f"{'height [um]':>13}{'R - design, +- [um]':>21}{'Sq [nm]':>9}{'PV [nm]':>9}{'covered':>9}"
        )
        lines = [heading]
        for one, irregular in zip(self.items, self.irregular, strict=True):
            places = f"{one.number:4d}{one.design[0]:10.4f}{one.design[1]:10.4f}"
            if not one.measured:
                lines.append(f"{places}   {one.finding}")
                continue
            away = [1e3 * part for part in (*one.dislocation, max(one.centre_std), *irregular)]
            lines.append(
                f"{places}{away[0]:12.3f}{away[1]:11.3f}{away[2]:8.3f}{away[3]:11.3f}{away[4]:11.3f}"
                f"{1e3 * one.height:13.3f}{1e3 * one.radius_error:12.3f}{1e3 * one.radius_std:9.3f}"
                f"{one.sq_nm:9.1f}{one.pv_nm:9.1f}{one.coverage:9.0%}"
            )
        return "\n".join(lines)

    def csv(self) -> str:
        """Return comma-separated rows, one for each lenslet, in the units of the heading; undefined cells are empty."""
        heading = (
            "lens,design_x_mm,design_y_mm,centre_x_mm,centre_y_mm,centre_std_x_mm,centre_std_y_mm,dislocation_x_mm,"
            "dislocation_y_mm,irregular_x_mm,irregular_y_mm,height_mm,height_std_mm,radius_mm,radius_error_mm,"
            "radius_std_mm,tilt_x_rad,tilt_y_rad,sq_nm,pv_nm,scatter_nm,points,outliers,coverage,finding"
        )
        lines = [heading]
        for one, irregular in zip(self.items, self.irregular, strict=True):
            values = (
                *one.design, *one.centre, *one.centre_std, *one.dislocation, *irregular, one.height, one.height_std,
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
    base_degree: int = DEFAULT_BASE_DEGREE,
) -> Lenslets:
    """Measure centre, height, radius and form error of every lenslet of an array.

    A lenslet is found up to about half its radius from its nominal position.

    Parameters
    ----------
    heights
        The measured map; missing points and outliers are left out.
    part
        The design: a `LensArray`, alone or added to a base, placed as a whole or on its base.
    inner, outer
        Points within ``inner`` lens radii of a measured centre belong to the lenslet, those beyond ``outer`` lens radii
        of all lenslets to the base.
    pose
        From the map's frame to the part's. By default the map is registered, see `register`.
    form
        ``"design"``, the design form; ``"sphere"``, the best sphere, its radius free.
    radius
        Whether the radius of the design form is free.
    tilt
        Whether the tilt of each lenslet is free; not on a sphere, where tilt and shift are equivalent.
    aperture
        Semi-diameter of a lenslet; by default that of the array or of the largest circle in the cell. [mm]
    level
        Whether tilt and height are taken from the base, and rotation too where the base determines it better than the
        lenslets. `Lenslets.frame` states the result.
    base_degree
        Highest degree of the form error of the base, in Zernike terms from the second degree on, which is fitted with
        the level and subtracted under the lenslets; 0 for none.

    Raises
    ------
    InputError
        If the part has no lens array or several, the form does not determine its centre, a factor is out of range, or
        the map has no heights.

    Sources
    -------
    [Kong2019]_. Oracles: SciPy's dense fit of the true surface; closed forms.

    >>> from turnwright.part import Part
    >>> from turnwright.surface import LensArray, Sphere
    >>> array = LensArray.square(pitch=1.0, rows=2, columns=2, lenslet=Sphere(radius=5.0))
    >>> x = np.linspace(-1, 1, 201)
    >>> moved = array.placed(shift=(0.003, 0, 0))
    >>> made = HeightMap(x=x, y=x, z=moved.sag(x, x[:, None]))
    >>> found = lenslets(made, Part(surface=array, radius=1.0), pose=Pose())
    >>> found[0].dislocation[0].__round__(9), found[3].measured
    (0.003, True)
    """
    between(inner, "inner, the fraction of its radius that belongs to a lenslet,", 0.1, 1.0, "lens radii")
    between(outer, "outer, where the base begins,", inner, 10.0, "lens radii")
    one_of(form, "form", ("design", "sphere"))
    if not 0 <= base_degree <= MAX_BASE_DEGREE or base_degree == 1:
        raise InputError(
            f"base_degree must be 0 or 2 to {MAX_BASE_DEGREE} (degree 1 is part of the pose), got {base_degree!r}"
        )
    degree = base_degree if level else 0
    design = split_design(part, form, aperture, degree)
    free = free_parameters(design, inner, radius=radius or form == "sphere", tilt=tilt)
    heights.require_calibrated()
    valid_points(heights, 1, "a fit of lenslets")
    pose, rotation_std, doubt = _register_map(heights, part, degree) if pose is None else (pose, float("inf"), "")
    pose = design.outer.inverse.after(pose)
    points = place_points(heights, pose, design)
    starts = np.zeros((design.centres.shape[0], 6))
    starts[:, :2] = design.centres
    seen = np.zeros(starts.shape[0], dtype=np.bool_)

    chunk = max(1, starts.shape[0] // (8 * cores()))

    def find(start: int, stop: int) -> None:
        for k in range(start, stop):
            if (rough := find_roughly(points, design, k, inner)) is not None:
                starts[k], seen[k] = rough, True

    run_chunks(find, starts.shape[0], chunk)
    base = points_of_base(points, design, starts, outer)
    frame = "the part's frame: shift, rotation, tilt and height by the pose"
    base_form = BaseForm(np.empty(0), np.empty((0, 0)), np.empty(0))
    # The second time the start is so close that the step is linear and the residual is form.
    for _ in range(2 if level and base.size >= MIN_POINTS else 0):
        correction, frame, base_form = level_on_base(points, base, design, starts, seen, rotation_std)
        pose = correction.after(pose)
        points = place_points(heights, pose, design)
        starts[:, 0], starts[:, 1], _ = correction.apply(starts[:, 0], starts[:, 1], 0.0)
        base = points_of_base(points, design, starts, outer)
    formless = subtract_form(points, design, base_form)
    lenslets: dict[int, FittedLenslet] = {}

    def fit(start: int, stop: int) -> None:
        for k in range(start, stop):
            lenslets[k] = fit_lenslet(formless, design, k, starts, free, inner, base_form)

    run_chunks(fit, starts.shape[0], chunk)
    items = tuple(_lenslet(k, lenslets[k], design) for k in range(starts.shape[0]))
    measured = [one for one in items if one.measured]
    alignment = None
    if len(measured) > 1:
        alignment = Alignment.of([one.design for one in measured], [one.centre for one in measured])
    base = points_of_base(points, design, np.array([lenslets[k].local for k in range(starts.shape[0])]), outer)
    error, weight = errors_of_base(points, base, design)[0], points.weight[base]
    few = np.flatnonzero(np.isfinite(error))
    few, size = few[:: few.size // MAX_LEVELLING_POINTS + 1], (float("nan"), float("nan"))
    if few.size >= MIN_POINTS:
        x, y = (part[base[few]] / design.reach for part in (points.x, points.y))
        keep = few[fit_smooth(x, y, error[few]).keep]
        size = size_nm(error[keep], weight[keep])
    return Lenslets(
        items=items,
        form=form,
        frame=frame + doubt,
        pose=design.outer.after(pose),
        alignment=alignment,
        base_points=base.size,
        base_sq_nm=size[0],
        base_pv_nm=size[1],
        base_form=base_form.surface(design),
        base_form_std=dict(zip(design.terms, base_form.std.tolist(), strict=False)),
    )


def base_forms(part: Part, degree: int = DEFAULT_BASE_DEGREE) -> tuple[Zernike, ...]:
    """Return the form error terms of the base of a lens array, each 1 mm at the rim; none without a base.

    Parameters
    ----------
    part
        A `LensArray`, alone or on a base.
    degree
        Highest degree of the Zernike terms, which start at the second.
    """
    return tuple(rim_forms(split_design(part, "design", None, degree).terms, part.reach))


def _register_map(heights: HeightMap, part: Part, degree: int) -> tuple[Pose, float, str]:
    """Return the part pose, the standard deviation of its rotation [rad], and a warning if it is ambiguous."""
    # A robust loss, so that displaced lenslets do not rotate the others.
    registration = register(
        _sample_points(heights, MAX_REGISTRATION_POINTS),
        part,
        loss="huber",
        terms=base_forms(part, degree),
        form_error=0.0,
    )
    others, doubt = len(registration.candidates), ""
    if others:
        doubt = f"; {others} other poses fit nearly as well, so the numbering of the lenslets is uncertain: give a pose"
    return registration.pose, registration.std.get("rotation", float("inf")), doubt


def has_lenslets(surface: Surface) -> bool:
    """Return whether a surface contains exactly one lens array, as `lenslets` needs."""
    return len(find_arrays(surface)) == 1


def _lenslet(k: int, found: FittedLenslet, design: Design) -> Lenslet:
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


def _sample_points(heights: HeightMap, most: int) -> HeightMap:
    """Return a random sample of the valid points of a map."""
    valid = np.flatnonzero(~np.isnan(heights.z).ravel())
    valid = valid[sample(valid.size, most)]
    x, y, z = (part.ravel()[valid] for part in (*heights.points(), heights.z))
    return HeightMap(x=x, y=y, z=z, name=heights.name)
