"""Compound surfaces: sums of surfaces, and a surface moved in the part frame."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from turnwright._validate import check_numbers, instance_of
from turnwright.errors import InputError
from turnwright.pose import Pose, rotation_matrix
from turnwright.surface.base import COSTLIEST, Lenslets, Surface

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats, Ints

__all__ = ["Placed", "Sum"]

MAX_NEWTON_STEPS = 60
"""Newton steps for the height of a tilted surface; a smooth one needs about five, a discontinuity some more."""

GAP_TOL_MM = 1e-11
"""Gap between line and surface at which their intersection is accepted."""

EVALUATIONS_PER_POINT = 10
"""Evaluations of the surface for one point of the tilted one, for its cost."""

OVERHANG_SAMPLES = (np.arange(16) + 0.5) / 16
"""Samples between the middle of the part and a point at which overhang is checked, as fractions of the distance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sum(Surface):
    """Sum of surfaces, such as a base and a departure from it.

    Parameters
    ----------
    terms
        The surfaces to add. Sums among them are flattened, so that ``a + b + c`` has three terms.

    Raises
    ------
    InputError
        If there is no term, or one that is not a surface.
    """

    family = "sum"
    example = MappingProxyType({"terms": [{"family": "sphere", "radius": "50 mm"}, {"family": "plane"}]})
    terms: tuple[Surface, ...]

    def __post_init__(self) -> None:
        check_numbers(self)
        flat: list[Surface] = []
        for term in self.terms:
            instance_of(term, Surface, "a term of a sum")
            flat.extend(term.terms if isinstance(term, Sum) else (term,))
        if not flat:
            raise InputError("a sum has 0 terms, it needs at least 1: give the surfaces to add")
        cost = sum(term.cost for term in flat)
        if cost > COSTLIEST:
            raise InputError(
                f"a sum of {len(flat)} surfaces costs {cost} additions per point, the limit is {COSTLIEST}: give "
                "fewer terms, or their heights as a table"
            )
        object.__setattr__(self, "terms", tuple(flat))

    def require_disc(self, radius: float, what: str) -> None:
        """Raise unless every term is defined in the disc. See `Surface.require_disc`."""
        for term in self.terms:
            term.require_disc(radius, what)

    @property
    def of_revolution(self) -> bool:
        """Whether every term is known to be one of revolution."""
        return all(term.of_revolution for term in self.terms)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the sums of the terms' heights and derivatives. See `Surface.evaluate`."""
        total = self.terms[0].evaluate(x, y, order)
        for term in self.terms[1:]:
            total = tuple(part + more for part, more in zip(total, term.evaluate(x, y, order), strict=True))
        return total

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where every term is defined."""
        masks = [mask for term in self.terms if (mask := term.inside(x, y)) is not None]
        return np.logical_and.reduce(masks) if masks else None

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return the poles of all terms. See `Surface.poles`."""
        pole_x, pole_y = zip(*(term.poles(x, y, reach) for term in self.terms), strict=True)
        return np.concatenate(pole_x), np.concatenate(pole_y)

    @property
    def domain(self) -> str:
        """The domain common to all terms, in words."""
        limits = dict.fromkeys(term.domain for term in self.terms if term.domain != "the whole plane")
        return ", and ".join(limits) or "the whole plane"

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return a number for each combination of the terms' pieces; convex pieces intersect in convex pieces."""
        return _combined([part for term in self.terms if (part := term.piece(x, y)) is not None])

    def border(self, first: Ints, second: Ints, x: Floats, y: Floats) -> Floats:
        """Return that of the only term with pieces, if it is the only one. See `Surface.border`."""
        parted = [term for term in self.terms if term.in_pieces]
        return parted[0].border(first, second, x, y) if len(parted) == 1 else np.full(x.shape, np.nan)

    def sample(self, x: Floats, y: Floats) -> tuple[Floats, Ints | None]:
        """Return the sum of the terms' heights, and the piece. See `Surface.sample`."""
        heights, pieces = zip(*(term.sample(x, y) for term in self.terms), strict=True)
        return sum(heights[1:], heights[0]), _combined([piece for piece in pieces if piece is not None])

    @property
    def convex_pieces(self) -> bool:
        """Whether every term with pieces has convex ones."""
        return self.in_pieces and all(term.convex_pieces for term in self.terms if term.in_pieces)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of all terms. See `Surface.remarks`."""
        return tuple(sentence for term in self.terms for sentence in term.remarks)

    @property
    def feature_size(self) -> float:
        """The smallest of the terms. [mm]."""
        return min(term.feature_size for term in self.terms)

    @property
    def cost(self) -> int:
        """Cost of all terms. See `Surface.cost`."""
        return sum(term.cost for term in self.terms)


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed(Surface):
    """A surface moved in the part frame: tilted, then rotated about z, then shifted. See `Surface.placed`.

    A point p of the surface goes to ``shift + Rz(rotation) Rx(tilt[0]) Ry(tilt[1]) p``: the second tilt is about the
    y axis tilted by the first, the order of lens-design programs.

    A tilted surface has a height z = f(x, y) only where it does not overhang. The height at (x, y) is where the
    vertical line intersects the surface, found by Newton's method to rounding; the derivatives follow from the implicit
    function theorem. Where a vertical line intersects a tilted concave surface twice, the point whose normal points up
    is taken. The domain is the region around the middle of the part (or the surface's vertex, if the surface is not
    defined there) that is not behind an overhang; this is checked at 16 samples for each point.

    Parameters
    ----------
    surface
        The surface to move.
    shift
        New position of its vertex (x, y, z). [mm]
    rotation
        About z, counter-clockwise seen from the tool. [rad]
    tilt
        About its own x axis, then about its own y axis, before the rotation. [rad]

    Raises
    ------
    InputError
        If a number is not finite, or the tilt turns the surface's axis by a right angle or more.

    Notes
    -----
    The pieces of a tilted surface meet along curves that are not exactly straight. If the surface has steps, walls that
    the tilt exposes are outside the domain; a rim that hides the foot of its step is not detected.

    Examples
    --------
    >>> from turnwright.surface.expression import Expression
    >>> wedge = Expression("0.01*x").placed(rotation=np.pi / 2)   # its slope now points along y
    >>> float(np.round(wedge.sag(0.0, 2.0).item(), 12))
    0.02
    """

    surface: Surface
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        instance_of(self.surface, Surface, "the surface to place")
        pose = self.pose
        for name in ("shift", "rotation", "tilt"):
            object.__setattr__(self, name, getattr(pose, name))
        total_tilt = np.rad2deg(np.arccos(np.clip(np.cos(self.tilt[0]) * np.cos(self.tilt[1]), -1, 1)))
        if total_tilt > 89.9:
            raise InputError(
                f"tilt turns the axis of {type(self.surface).__name__} by {total_tilt:.4g} deg, the limit is 89.9 deg: "
                "reduce the tilt"
            )

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives in the part frame. See `Surface.evaluate`."""
        flat = self._level(x, y, order) if self.tilt == (0.0, 0.0) else self._tilted(x, y, order)
        return tuple(part.reshape(x.shape) for part in flat)

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where the moved surface is defined and does not overhang."""
        u, v, height = self._local(x, y)
        if self.tilt == (0.0, 0.0):
            inside = self.surface.inside(u, v)
            return None if inside is None else inside.reshape(x.shape)
        inside = np.isfinite(height)
        # In a convex region where the normal points up everywhere, a vertical line meets the surface only once.
        u0, v0, middle = (part.item() for part in self._local(np.zeros(1), np.zeros(1)))
        if not np.isfinite(middle):
            u0 = v0 = 0.0
        for part in OVERHANG_SAMPLES:
            with np.errstate(all="ignore"):
                _, up = self._gap(u0 + part * (u - u0), v0 + part * (v - v0), 0.0)
            inside &= ~(up <= 0)  # nan, outside the surface's own domain, is no overhang
        return inside.reshape(x.shape)

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return the moved poles; with a tilt they overhang and are outside the domain. See `Surface.poles`."""
        if self.tilt != (0.0, 0.0):
            return Surface.poles(self, x, y, reach)
        u, v, _ = self._local(x, y)
        u, v = self.surface.poles(u.reshape(x.shape), v.reshape(x.shape), reach)
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        return c * u - s * v + self.shift[0], s * u + c * v + self.shift[1]

    @property
    def domain(self) -> str:
        """The domain of the moved surface in words."""
        overhang = "" if self.tilt == (0.0, 0.0) else ", no farther from the middle than where it starts to overhang"
        if self.surface.domain == "the whole plane":
            return self.surface.domain + overhang
        return f"the moved {type(self.surface).__name__}'s ({self.surface.domain}){overhang}"

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the pieces of the moved surface."""
        u, v, _ = self._local(x, y)
        number = self.surface.piece(u, v)
        return None if number is None else number.reshape(x.shape)

    def border(self, first: Ints, second: Ints, x: Floats, y: Floats) -> Floats:
        """Return that of the moved surface. See `Surface.border`."""
        u, v, _ = self._local(x, y)
        return self.surface.border(first, second, u, v)

    def sample(self, x: Floats, y: Floats) -> tuple[Floats, Ints | None]:
        """Return height and piece of the moved surface. See `Surface.sample`."""
        if self.tilt != (0.0, 0.0):
            return Surface.sample(self, x, y)
        u, v, _ = self._local(x, y)
        z, number = self.surface.sample(u, v)
        return (z + self.shift[2]).reshape(x.shape), None if number is None else number.reshape(x.shape)

    @property
    def lenslets(self) -> Lenslets | None:
        """Those of the moved surface, if it is level. See `Surface.lenslets`."""
        lenslets = self.surface.lenslets if self.tilt == (0.0, 0.0) else None
        if lenslets is None:
            return None
        return lenslets._replace(vertices=np.column_stack(self.pose.apply(*lenslets.vertices.T)))

    @property
    def convex_pieces(self) -> bool:
        """Whether the pieces of a level surface are convex; those of a tilted one meet along curves."""
        return self.tilt == (0.0, 0.0) and self.surface.convex_pieces

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of the moved surface. See `Surface.remarks`."""
        return self.surface.remarks

    @property
    def cost(self) -> int:
        """Cost of the surface, times the evaluations for a tilted one. See `Surface.cost`."""
        return (EVALUATIONS_PER_POINT if any(self.tilt) else 1) * self.surface.cost

    @property
    def feature_size(self) -> float:
        """Feature size of the surface, foreshortened by the tilt. [mm]."""
        return float(self.surface.feature_size * self._turn[2, 2])

    @property
    def pose(self) -> Pose:
        """Pose of the surface's frame in the part frame."""
        return Pose(shift=self.shift, rotation=self.rotation, tilt=self.tilt)

    @property
    def _turn(self) -> Floats:
        """The matrix of `pose`, without its checks, which cost more than the matrix. (3, 3)."""
        return rotation_matrix(self.rotation, *self.tilt)

    def _level(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        u, v, _ = self._local(x, y)
        z, *derivatives = self.surface.evaluate(u, v, order)
        z = z + self.shift[2]
        if order == 0 or self.rotation == 0:
            return z, *derivatives
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        fu, fv, *second = derivatives
        first = (c * fu - s * fv, s * fu + c * fv)
        if order == 1:
            return z, *first
        fuu, fuv, fvv = second
        zxx = c * c * fuu - 2 * c * s * fuv + s * s * fvv
        zxy = c * s * (fuu - fvv) + (c * c - s * s) * fuv
        zyy = s * s * fuu + 2 * c * s * fuv + c * c * fvv
        return z, *first, zxx, zxy, zyy

    def _tilted(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        turn = self._turn
        u, v, height = self._local(x, y)
        with np.errstate(all="ignore"):
            z = height + self.shift[2]
            if order == 0:
                return (z,)
            # Where no intersection was found, u and v are nan, and so is the result.
            _, fu, fv, *second = self.surface.evaluate(u, v, order)
            up = turn[2, 2] - turn[2, 0] * fu - turn[2, 1] * fv
            zx = -(turn[0, 2] - turn[0, 0] * fu - turn[0, 1] * fv) / up
            zy = -(turn[1, 2] - turn[1, 0] * fu - turn[1, 1] * fv) / up
            if order == 1:
                return z, zx, zy
            # Along x the surface point moves by (1, 0, zx); (au, av) is this vector in the surface's frame.
            au, av = turn[0, 0] + turn[2, 0] * zx, turn[0, 1] + turn[2, 1] * zx
            bu, bv = turn[1, 0] + turn[2, 0] * zy, turn[1, 1] + turn[2, 1] * zy
            fuu, fuv, fvv = second
            zxx = (au * au * fuu + 2 * au * av * fuv + av * av * fvv) / up
            zxy = (au * bu * fuu + (au * bv + av * bu) * fuv + av * bv * fvv) / up
            zyy = (bu * bu * fuu + 2 * bu * bv * fuv + bv * bv * fvv) / up
        return z, zx, zy, zxx, zxy, zyy

    def _local(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the point of the surface at (x, y): (u, v) in its own frame, and its height minus the shift.

        Without tilt the returned height is 0; with tilt it is nan where no intersection was found. Each (n,).
        """
        dx, dy = (at.ravel() - shift if shift else at.ravel() for at, shift in zip((x, y), self.shift, strict=False))
        level = self.tilt == (0.0, 0.0)
        if level and self.rotation == 0:
            return dx, dy, np.broadcast_to(0.0, dx.shape)
        turn = self._turn
        u, v = turn[0, 0] * dx + turn[1, 0] * dy, turn[0, 1] * dx + turn[1, 1] * dy
        if level:
            return u, v, np.broadcast_to(0.0, u.shape)
        # The vertical line through (x, y), in the surface's frame: (u, v, w) + t (lu, lv, lw); t is the height.
        w = turn[0, 2] * dx + turn[1, 2] * dy
        lu, lv, lw = turn[2]
        height = np.full_like(u, np.nan)
        # Starting points: the plane z = 0 of the part, the tangent plane at the surface's vertex, the height of the
        # vertex, and the point of the line closest to the surface's axis, which is inside any disc that it crosses.
        closest = -(u * lu + v * lv) / max(lu * lu + lv * lv, 1e-300)
        starts = (np.full_like(u, -self.shift[2]), -w / lw, np.zeros_like(u), closest)
        for start in starts:
            missing = np.flatnonzero(np.isnan(height))
            if missing.size == 0:
                break
            height[missing] = self._intersect(*(part[missing] for part in (u, v, w, start)))
        return u + height * lu, v + height * lv, height

    def _intersect(self, u: Floats, v: Floats, w: Floats, start: Floats) -> Floats:
        """Return the heights at which lines intersect the surface, nan where not found; Newton with step halving.

        A step is accepted only if it ends in the domain, where the normal points up, and closer to the surface.
        """
        lu, lv, lw = self._turn[2]
        t = start.copy()
        height = np.full_like(t, np.nan)
        with np.errstate(all="ignore"):
            gap, up = self._gap(u + t * lu, v + t * lv, w + t * lw)
            rounding = 4 * np.finfo(np.float64).eps
            active = np.flatnonzero(np.isfinite(gap) & (up > 0))
            step = np.zeros_like(t)
            step[active] = -gap[active] / up[active]
            for _ in range(MAX_NEWTON_STEPS):
                trial = t[active] + step[active]
                new, steep = self._gap(u[active] + trial * lu, v[active] + trial * lv, w[active] + trial * lw)
                better = np.isfinite(new) & (steep > 0) & (np.abs(new) < np.abs(gap[active]))
                accepted = active[better]
                t[accepted], gap[accepted] = trial[better], new[better]
                step[accepted] = -new[better] / steep[better]
                step[active[~better]] /= 2
                scale = np.abs(t[active]) + np.abs(w[active]) + np.abs(u[active]) + np.abs(v[active])
                converged = np.abs(step[active]) <= rounding * scale
                # A step that vanished by halving while the gap is open has reached a wall or the edge of the domain.
                closed = np.abs(gap[active]) <= 64 * rounding * scale + GAP_TOL_MM
                height[active[converged & closed]] = t[active[converged & closed]]
                active = active[~converged]
                if active.size == 0:
                    break
        return height

    def _gap(self, u: Floats, v: Floats, w: Floats | float) -> tuple[Floats, Floats]:
        """Return the height of a point above the surface along its own axis, and its derivative along part z."""
        z, fu, fv = self.surface.evaluate(u, v, 1)
        lu, lv, lw = self._turn[2]
        gap, up = w - z, lw - lu * fu - lv * fv
        inside = self.surface.inside(u, v)
        if inside is not None:
            gap = np.where(inside, gap, np.nan)
            up = np.where(inside, up, np.nan)
        return gap, up


def _combined(parts: list[Ints]) -> Ints | None:
    """Return a number for each combination of pieces."""
    if not parts:
        return None
    # Each number gets an equal part of the 63 bits: two surfaces may have 2**31 pieces each.
    bits = 63 // len(parts)
    number = parts[0]
    for part in parts[1:]:
        number = (number << bits) + part
    return number
