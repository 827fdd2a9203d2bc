"""Planes, spheres, conics and even aspheres of best fit, with uncertainties; and Fizeau interferograms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright._validate import one_of
from turnwright.errors import InputError
from turnwright.metrology.grid import valid_points
from turnwright.metrology.least_squares import Cloud, Sums, solve, sums_over
from turnwright.pose import Pose
from turnwright.surface import Conic, EvenAsphere, Placed, Plane, Sphere, Surface

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

Distance: TypeAlias = Literal["vertical", "normal"]

NM = 1e6
MAX_STEPS = 60
MAX_INITIAL_POINTS = 20_000
"""Points used for the first iterations; one or two iterations over all points follow."""

CONVERGENCE_TOL = 1e-14
"""Change of the residual, relative to the peak-to-valley of the map, at which the iteration stops."""

MIN_COS_SQUARED = 1e-6
"""Squared cosine of the slope at which a fitted conic is taken to end."""

POSE_NAMES = ("x", "y", "z", "tilt_x", "tilt_y")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BestFit:
    """A form fitted to a map. See `best_fit`.

    Parameters
    ----------
    surface
        The fitted form, in the frame of the map.
    parameters, uncertainty
        Fitted parameters by name, and their standard uncertainties. [mm, rad, 1]
    correlation
        Of the parameters, in their order. (k, k)
    held
        Parameters of the form that were not fitted, by name.
    distance
        Distance that was minimised and that the residual states.
    residual
        Deviation from the fitted form, positive above it. [mm]
    rms_nm, pv_nm
        Of the residual. [nm]
    condition
        Condition number of the fit with parameters scaled to unit length.
    """

    surface: Surface
    parameters: Mapping[str, float]
    uncertainty: Mapping[str, float]
    correlation: Floats
    held: Mapping[str, float]
    distance: Distance
    residual: HeightMap
    rms_nm: float
    pv_nm: float
    condition: float


def best_fit(
    heights: HeightMap,
    form: Literal["plane", "sphere", "conic"] | Conic | EvenAsphere | Sphere,
    *,
    distance: Distance = "vertical",
    free: Sequence[str] | None = None,
) -> BestFit:
    r"""Fit a plane, a sphere, a conic or an even asphere by least squares over the valid points.

    The sum of squared distances, weighted by the area of each point, is minimised along z (``"vertical"``, least
    squares in sag), or to the foot of the normal on the form (``"normal"``, total least squares).

    The vertex of a sphere is where its normal is along z. Nearly equivalent parameters show in ``condition`` and
    ``correlation``; parameters that the heights cannot separate raise an error.

    Parameters
    ----------
    heights
        On any grid, or scattered.
    form
        By name, or a surface to start from: its terms are those of the even asphere, and parameters not free are fixed.
    distance
        ``"vertical"`` or ``"normal"``.
    free
        Fitted parameters, of ``"x"``, ``"y"``, ``"z"`` (vertex), ``"tilt_x"``, ``"tilt_y"``, ``"radius"``, ``"conic"``
        and ``"a4"``, ``"a6"``, ...; of a plane ``"z"`` at the origin, ``"slope_x"``, ``"slope_y"``. By default
        everything but the tilts.

    Raises
    ------
    InputError
        If the form or a parameter is unknown, the heights do not determine it, or the form ends inside the map.

    Notes
    -----
    The uncertainties assume independent residuals; where form error prevails, they are too small.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.linspace(-1, 1, 41)
    >>> bowl = HeightMap(x=x, y=x, z=100 - np.sqrt(100**2 - (x - 0.1) ** 2 - x[:, None] ** 2))
    >>> fit = best_fit(bowl, "sphere")
    >>> round(fit.parameters["radius"], 6), round(fit.parameters["x"], 6)
    (100.0, 0.1)
    """
    one_of(distance, "the distance", ("vertical", "normal"))
    if form not in ("plane", "sphere", "conic") and not isinstance(form, Sphere | Conic | EvenAsphere):
        raise InputError(
            f'the form of a best fit is {form!r}, it must be "plane", "sphere", "conic", or a Sphere, Conic or '
            "EvenAsphere to start from: choose one of them"
        )
    along_normal = distance == "normal"
    if form == "plane":
        return _fit_model(heights, _Plane(along_normal=along_normal), free, distance)
    sphere = free is None or set(free) == {"x", "y", "z", "radius"}
    if sphere and (form == "sphere" or isinstance(form, Sphere)):
        return _fit_model(heights, _FreeSphere.of(heights, along_normal=along_normal), None, distance)
    if isinstance(form, str):
        start = best_fit(heights, "sphere")
        if not np.isfinite(start.parameters["radius"]):
            raise InputError(
                f"the best-fit sphere of the map is flat, a {form} needs curvature: give a surface to start from"
            )
        initial: Sphere | Conic | EvenAsphere = Sphere(radius=start.parameters["radius"])
        if form == "conic":
            initial = Conic(radius=start.parameters["radius"], conic=0.0)
        vertex = [start.parameters[name] for name in ("x", "y", "z")]
    else:
        initial = form
        vertex = [0.0, 0.0, float(np.nanmedian(heights.z - _sag(form, heights)))]
    return _fit_model(heights, _ConicOfRevolution(initial, vertex, along_normal=along_normal), free, distance)


def interferogram(heights: HeightMap, *, radius: float | None = None) -> BestFit:
    """Return the Fizeau interferogram of a map: its deviation from the best-fit sphere, along the normal.

    ``residual`` is positive where the part lies above the sphere; one fringe is half a wavelength. x and y are those of
    the map; the distortion of an instrument is not modelled.

    Parameters
    ----------
    heights
        Map of the surface itself, not of its form error.
    radius
        Radius of the reference sphere, as for `turnwright.Sphere`, where the part is at a stated distance from the
        focus instead of nulled for power. By default that of best fit. [mm]

    Sources
    -------
    [Troutman2016]_ chapter 6; its Eq. 6.20 is a fit of least PV for small angles, this is least squares.
    """
    if radius is None:
        return best_fit(heights, "sphere", distance="normal")
    return best_fit(heights, Sphere(radius=radius), distance="normal", free=("x", "y", "z"))


def subtract_sphere(heights: HeightMap) -> HeightMap:
    """Return a map minus the best-fit sphere in z; for points on one line, minus the flattest of these."""
    model = _FreeSphere.of(heights, along_normal=False)
    residual = np.full(heights.z.shape, np.nan)
    cloud = Cloud.of(heights, ~np.isnan(heights.z))
    size = float(np.nanmax(heights.z) - np.nanmin(heights.z)) or 1.0
    parameters, _, _ = _gauss_newton(cloud, model, model.start, [0, 1, 2, 3], size, residual, least_norm=True)
    _require_reach(model, parameters, cloud)
    return replace(heights, z=residual)


class _Model(ABC):
    """A form whose internal parameters suit Gauss-Newton."""

    names: tuple[str, ...]  # of the parameters that are stated
    default: tuple[str, ...]
    what: str
    start: Floats  # parameters (k,)
    along_normal: bool

    @abstractmethod
    def terms(self, parameters: Floats, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Return minus the derivatives of the residual by each parameter (k, n), and the residual (n,)."""

    @abstractmethod
    def stated(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Return the public parameters, and their derivatives by the internal ones. (k,), (k, k)."""

    @abstractmethod
    def surface(self, parameters: Floats) -> Surface:
        """Return the form."""

    def ends(self, parameters: Floats, x: Floats, y: Floats) -> bool:  # noqa: ARG002
        """Whether the form ends before it reaches all points."""
        return False


class _Plane(_Model):
    """z = c + p x + q y."""

    names = default = ("z", "slope_x", "slope_y")
    what = "a plane"

    start = np.zeros(3)

    def __init__(self, *, along_normal: bool) -> None:
        self.along_normal = along_normal

    def terms(self, parameters: Floats, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        c, p, q = parameters
        residual = z - c - p * x - q * y
        terms = np.stack([np.ones_like(x), x, y])
        if self.along_normal:
            up = 1 / np.sqrt(1 + p * p + q * q)
            terms *= up
            residual *= up
            terms[1] += residual * p * up * up
            terms[2] += residual * q * up * up
        return terms, residual

    def stated(self, parameters: Floats) -> tuple[Floats, Floats]:
        return parameters, np.eye(3)

    def surface(self, parameters: Floats) -> Surface:
        c, p, q = parameters.tolist()
        return Plane(slope=(p, q)).placed(shift=(0.0, 0.0, c))


class _FreeSphere(_Model):
    """A sphere of any position, radius and sense of curvature.

    The sphere through (x0, y0, c) with slopes p, q there is k/2 (u² + v² + t²) + p u + q v - t = 0 with t = z - c. It
    is smooth in the curvature k at a plane, unlike centre and radius.
    """

    names = default = ("x", "y", "z", "radius")
    what = "a sphere"

    start = np.zeros(4)

    def __init__(self, middle: tuple[float, float], *, along_normal: bool) -> None:
        self.middle, self.along_normal = middle, along_normal

    @classmethod
    def of(cls, heights: HeightMap, *, along_normal: bool) -> _FreeSphere:
        valid = valid_points(heights, 4, "a sphere")
        x, y = Cloud.of(heights, valid).ends
        return cls((float(np.ptp(x) / 2 + x.min()), float(np.ptp(y) / 2 + y.min())), along_normal=along_normal)

    def terms(self, parameters: Floats, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        c, p, q, k = parameters
        u, v = x - self.middle[0], y - self.middle[1]
        if not self.along_normal:
            squares = u * u + v * v
            linear = k / 2 * squares + p * u + q * v
            root = np.sqrt(np.maximum(1 - 2 * k * linear, MIN_COS_SQUARED))
            t = 2 * linear / (1 + root)
            return np.stack([np.ones_like(u), u / root, v / root, (squares + t * t) / (2 * root)]), z - c - t
        t = z - c
        squares = u * u + v * v + t * t
        gap = k / 2 * squares + p * u + q * v - t
        steep = np.sqrt(1 + p * p + q * q)
        length = np.sqrt(np.maximum(steep**2 + 2 * k * gap, MIN_COS_SQUARED))
        total = steep + length
        residual = -2 * gap / total
        by_gap = np.stack([1 - k * t, u, v, squares / 2])
        by_length = k * by_gap / length
        by_length[3] += gap / length
        by_length[1] += p / length
        by_length[2] += q / length
        by_length[1] += p / steep
        by_length[2] += q / steep
        return 2 * by_gap / total + residual / total * by_length, residual

    def stated(self, parameters: Floats) -> tuple[Floats, Floats]:
        c, p, q, k = parameters.tolist()
        steep = np.sqrt(1 + p * p + q * q)
        if k == 0:
            return np.array([np.nan, np.nan, c, np.inf]), np.full((4, 4), np.inf)
        # The vertex is at (1 - steep)/k above c, written so that it holds for a flat one too.
        drop = -(p * p + q * q) / (1 + steep)
        stated = np.array([self.middle[0] - p / k, self.middle[1] - q / k, c + drop / k, steep / k])
        by = np.zeros((4, 4))
        by[0, 1], by[0, 3] = -1 / k, p / k**2
        by[1, 2], by[1, 3] = -1 / k, q / k**2
        by[2] = 1, -p / steep / k, -q / steep / k, -drop / k**2
        by[3] = 0, p / steep / k, q / steep / k, -steep / k**2
        return stated, by

    def surface(self, parameters: Floats) -> Surface:
        c, p, q, k = parameters.tolist()
        if k == 0:
            return Plane(slope=(p, q)).placed(shift=(0.0, 0.0, c - p * self.middle[0] - q * self.middle[1]))
        x, y, z, radius = self.stated(parameters)[0].tolist()
        return Sphere(radius=radius).placed(shift=(x, y, z))

    def ends(self, parameters: Floats, x: Floats, y: Floats) -> bool:
        if self.along_normal:
            return False
        _, p, q, k = parameters
        u, v = x - self.middle[0], y - self.middle[1]
        # The root is zero at the equator; the sag is continued beyond it only so that the iteration can return.
        return bool((1 - 2 * k * (k / 2 * (u * u + v * v) + p * u + q * v)).min() <= MIN_COS_SQUARED)


class _ConicOfRevolution(_Model):
    """A conic with even terms and free vertex and axis; internally the curvature replaces the radius."""

    def __init__(self, given: Sphere | Conic | EvenAsphere, vertex: Sequence[float], *, along_normal: bool) -> None:
        self.given, self.along_normal = given, along_normal
        self.is_sphere = isinstance(given, Sphere)
        terms = dict(given.terms) if isinstance(given, EvenAsphere) else {}
        self.powers = tuple(terms)
        shape = ("radius",) if self.is_sphere else ("radius", "conic", *(f"a{power}" for power in terms))
        self.names = (*(POSE_NAMES[:3] if self.is_sphere else POSE_NAMES), *shape)
        self.default = ("x", "y", "z", *shape)
        self.what = {Sphere: "a sphere", Conic: "a conic"}.get(type(given), "an even asphere")
        values = (given.base[0],) if self.is_sphere else (0.0, 0.0, *given.base, *terms.values())
        self.start = np.array([*vertex, *values])

    def _pose(self, parameters: Floats) -> Pose:
        x, y, z = parameters[:3].tolist()
        tilt = (0.0, 0.0) if self.is_sphere else (float(parameters[3]), float(parameters[4]))
        return Pose.within_a_turn((x, y, z), 0.0, tilt)

    def _shape(self, parameters: Floats) -> tuple[float, float, Floats]:
        """Return curvature, conic constant and the even terms' coefficients."""
        if self.is_sphere:
            return float(parameters[3]), 0.0, np.empty(0)
        return float(parameters[5]), float(parameters[6]), parameters[7:]

    def _sag(self, parameters: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats, list[Floats]]:
        """Return height, its derivative by r²/2, and those by the shape, in the form's own frame."""
        c, k, coefficients = self._shape(parameters)
        s = u * u + v * v
        root = np.sqrt(np.maximum(1 - (1 + k) * c * c * s, MIN_COS_SQUARED))
        base = c * s / (1 + root)
        by_shape = [(s + (1 + k) * base * base) / (2 * root)]
        if not self.is_sphere:
            by_shape.append(c * base * base / (2 * root))
        height, slope = base, c / root
        for power, value in zip(self.powers, coefficients, strict=True):
            half = s ** (power // 2 - 1)
            by_shape.append(half * s)
            height = height + value * by_shape[-1]
            slope = slope + value * power * half
        return height, slope, by_shape

    def terms(self, parameters: Floats, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        pose = self._pose(parameters)
        turn = pose.matrix
        shifted = (x - pose.shift[0], y - pose.shift[1], z - pose.shift[2])
        a, b, height = (turn[0, i] * shifted[0] + turn[1, i] * shifted[1] + turn[2, i] * shifted[2] for i in range(3))
        residual = np.zeros_like(z)
        foot = np.zeros((3, z.size))
        normal = np.zeros((3, z.size))
        by_shape: list[Floats] = []
        # The foot of a point lies on the form at the residual below it, along z or along the normal at the foot. Each
        # iteration squares the error, or multiplies it by the residual over the radius of curvature.
        for _ in range(MAX_STEPS):
            way = normal if self.along_normal else np.repeat(turn[2][:, None], z.size, axis=1)
            u, v, w = a - residual * way[0], b - residual * way[1], height - residual * way[2]
            sag, slope, by_shape = self._sag(parameters, u, v)
            normal = np.stack([-slope * u, -slope * v, np.ones_like(u)])
            normal /= np.sqrt((normal * normal).sum(axis=0))
            along = 1.0 if self.along_normal else turn[2] @ normal
            more = (w - sag) * normal[2] / along
            foot = np.stack([u, v, sag])
            residual = residual + more
            if np.abs(more).max(initial=0.0) <= 1e-14 * (1 + np.abs(residual).max(initial=0.0)):
                break
        fixed = np.stack([turn[i] @ normal for i in range(3)])  # the normal in the frame of the map
        columns = [*fixed]
        if not self.is_sphere:
            alpha, beta = (float(parameters[3]), float(parameters[4]))
            ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
            about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
            about_x_by = np.array([[0, 0, 0], [0, -sa, -ca], [0, ca, -sa]])
            about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
            about_y_by = np.array([[-sb, 0, cb], [0, 0, 0], [-cb, 0, -sb]])
            columns += [(fixed * (by @ foot)).sum(axis=0) for by in (about_x_by @ about_y, about_x @ about_y_by)]
        columns += [by * normal[2] for by in by_shape]
        terms = np.stack(columns)
        return (terms if self.along_normal else terms / (turn[2] @ normal)), residual

    def stated(self, parameters: Floats) -> tuple[Floats, Floats]:
        at = self.names.index("radius")
        stated, by = parameters.copy(), np.eye(parameters.size)
        with np.errstate(divide="ignore"):
            stated[at] = 1 / parameters[at]
            by[at, at] = -1 / parameters[at] ** 2
        return stated, by

    def surface(self, parameters: Floats) -> Surface:
        c, conic, coefficients = self._shape(parameters)
        radius = 1 / c if c else float("inf")
        pose = self._pose(parameters)
        shape: Surface = Sphere(radius=radius)
        if isinstance(self.given, Conic):
            shape = Conic(radius=radius, conic=conic)
        elif isinstance(self.given, EvenAsphere):
            terms = dict(zip(self.powers, coefficients.tolist(), strict=True))
            shape = EvenAsphere(radius=radius, conic=conic, terms=terms)
        return Placed(surface=shape, shift=pose.shift, tilt=pose.tilt)

    def ends(self, parameters: Floats, x: Floats, y: Floats) -> bool:
        c, k, _ = self._shape(parameters)
        pose = self._pose(parameters)
        s = (x - pose.shift[0]) ** 2 + (y - pose.shift[1]) ** 2
        return bool((1 - (1 + k) * c * c * s).min() <= MIN_COS_SQUARED)


def _sag(form: Surface, heights: HeightMap) -> Floats:
    """Return the form where the map is, nan where it is not defined."""
    x, y = heights.points()
    inside = form.inside(x, y)
    z = form.evaluate(np.ascontiguousarray(x), np.ascontiguousarray(y), 0)[0]
    return z if inside is None else np.where(inside, z, np.nan)


def _select_parameters(model: _Model, free: Sequence[str] | None) -> list[int]:
    names = model.default if free is None else tuple(free)
    unknown = [name for name in names if name not in model.names]
    if unknown or not names:
        raise InputError(
            f"the free parameters of {model.what} are {', '.join(names) or 'none'}, it has {', '.join(model.names)}: "
            "choose among them"
        )
    return [at for at, name in enumerate(model.names) if name in names]


def _fit_model(heights: HeightMap, model: _Model, free: Sequence[str] | None, distance: Distance) -> BestFit:
    """Fit a model by Gauss-Newton: first to some of the points, then to all."""
    chosen = _select_parameters(model, free)
    valid = valid_points(heights, len(chosen), model.what)
    cloud = Cloud.of(heights, valid)
    names = [model.names[at] for at in chosen]
    size = float(np.nanmax(heights.z) - np.nanmin(heights.z)) or 1.0
    parameters = model.start
    thin = cloud.thinned(MAX_INITIAL_POINTS)
    if isinstance(model, _FreeSphere) and not model.along_normal and len(chosen) == len(model.start):
        # The normal distance has no singularity at the equator, so that nearly hemispherical maps converge too.
        normal = _FreeSphere(model.middle, along_normal=True)
        parameters, _, _ = _gauss_newton(thin, normal, parameters, chosen, size)
    if thin is not cloud and np.count_nonzero(thin.used) > 4 * len(chosen):
        parameters, _, _ = _gauss_newton(thin, model, parameters, chosen, size)
    residual = np.full(heights.z.shape, np.nan)
    parameters, sums, condition = _gauss_newton(cloud, model, parameters, chosen, size, residual)
    _require_reach(model, parameters, cloud)
    stated, by = model.stated(parameters)
    with np.errstate(invalid="ignore", divide="ignore"):
        by = by[np.ix_(chosen, chosen)]
        covariance = by @ sums.covariance() @ by.T
        deviation = np.sqrt(np.diag(covariance))
        correlation = covariance / deviation / deviation[:, None]
    values = dict(zip(model.names, stated.tolist(), strict=True))
    return BestFit(
        surface=model.surface(parameters),
        parameters=MappingProxyType({name: values[name] for name in names}),
        uncertainty=MappingProxyType(dict(zip(names, deviation.tolist(), strict=True))),
        correlation=frozen(correlation, "correlation", ndim=2, finite=False),
        held=MappingProxyType({name: value for name, value in values.items() if name not in names}),
        distance=distance,
        residual=replace(
            heights, z=residual, name=f"{heights.name} from {model.what.replace('a ', 'its best ', 1)}".strip()
        ),
        rms_nm=sums.rms * NM,
        pv_nm=float(np.nanmax(residual) - np.nanmin(residual)) * NM,
        condition=condition,
    )


def _require_reach(model: _Model, parameters: Floats, cloud: Cloud) -> None:
    """Raise where the form ends before it reaches all points."""
    x, y = cloud.ends
    if model.ends(parameters, x, y):
        stated = dict(zip(model.names, model.stated(parameters)[0], strict=True))
        reach = np.hypot(np.ptp(x), np.ptp(y)) / 2
        raise InputError(
            f"the best {model.what.split()[-1]} has a radius of {stated['radius']:g} mm and does not cover the map, "
            f"whose half-width is {reach:g} mm: remove a polynomial instead"
        )


def _gauss_newton(
    cloud: Cloud,
    model: _Model,
    parameters: Floats,
    chosen: list[int],
    size: float,
    left: Floats | None = None,
    *,
    least_norm: bool = False,
) -> tuple[Floats, Sums, float]:
    """Return the fitted parameters, their sums and the condition; fill ``left`` with the residual."""
    names = [model.names[at] for at in chosen]
    last = np.inf
    for _ in range(MAX_STEPS):
        now = parameters

        def terms(x: Floats, y: Floats, z: Floats, now: Floats = now) -> tuple[Floats, Floats]:
            derivatives, values = model.terms(now, x, y, z)
            return derivatives[chosen], values

        sums = sums_over(cloud, terms, np.zeros(len(chosen)), left=left)
        if least_norm:
            step, condition = np.linalg.lstsq(sums.normal, sums.right, rcond=1e-13)[0], np.nan
        else:
            step, condition = solve(sums.normal, sums.right, names, model.what)
        # Rms change of the heights.
        change = float(np.sqrt(max(float(step @ sums.normal @ step), 0.0) / sums.weight))
        if change <= CONVERGENCE_TOL * size or change >= last:
            break
        parameters = parameters.copy()
        parameters[chosen] += step
        last = change if change < 1e-6 * size else np.inf
    return parameters, sums, condition
