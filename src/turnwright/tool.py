"""The diamond: what its edge is, exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from turnwright._arrays import Floats, between, frozen, positive
from turnwright.errors import InputError

__all__ = ["EdgeTable", "Profile", "Tool", "WavinessTable"]

HALF_CIRCLE = np.pi / 2 - 1e-3
"""Half of the included angle of a nose whose maker states none: the arc ends just before its wall is vertical. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WavinessTable:
    """A tool certificate: the measured deviation of the edge from its circle, joined by a cubic spline.

    Parameters
    ----------
    sweep
        Angles on the nose, ascending, 0 at the tip, positive toward +X. (n,) [rad]
    deviation
        Radial deviation there, positive outward. (n,) [mm]

    Raises
    ------
    InputError
        If there are fewer than four points, they are not ascending, or anything is not finite.
    """

    sweep: Floats
    deviation: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "sweep", frozen(self.sweep, "waviness sweep"))
        object.__setattr__(self, "deviation", frozen(self.deviation, "waviness deviation"))
        if self.sweep.shape != self.deviation.shape or self.sweep.size < 4:
            raise InputError(
                f"a waviness table has {self.sweep.size} sweeps and {self.deviation.size} deviations, "
                "it needs at least 4 of each and as many of one as of the other: complete it"
            )
        if not (np.diff(self.sweep) > 0).all():
            raise InputError("the sweeps of a waviness table do not ascend: sort them and drop repeated ones")


class EdgeTable(NamedTuple):
    """The edge as plain arrays for the kernels. Read it with `Tool.edge`."""

    row: Floats  # radius [mm], sweep at the arc's two ends [rad], rake cosine, rake sine, offset dx, dy, dz [mm]
    breaks: Floats  # (m + 1,) sweep at the ends of the waviness pieces [rad]
    coefficients: Floats  # (k + 1, m) waviness polynomials, highest power first, in sweep - breaks[i] [mm/rad^k]


class Profile(NamedTuple):
    """The edge as a height over the distance from its tip, w(u) in the rake plane, for the kernels.

    Inside the arc w = base - sqrt(base² - u²) plus a tabulated departure (none for a perfect nose), flat beyond.
    The departure is joined by cubic Hermite pieces: with 8192 of them its error is below 1e-12 mm where the waviness is
    smooth; where a certificate ends inside the arc its slope jumps, and within a piece of there the error is up to
    1e-4 mm times the jump (1e-7 mm has been seen).
    """

    row: Floats  # base radius, then (u, w, slope) where the arc ends toward -X and +X, then pieces per mm
    table: Floats  # (2, n) departure and its slope at equal distances; (2, 0) for a perfect nose
    convex: bool  # whether the edge curves upward everywhere: then two placings of it cross at most once


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tool:
    """A round-nosed diamond tool, with its deviations.

    The edge lies in the rake plane: an arc of ``nose_radius + radius_error`` plus waviness, inside the included angle,
    and straight flanks, tangent to the arc's ends, beyond it. The *tip* is the lowest point of the nominal arc. A
    ``radius_error`` leaves the tip where it is, because the tip is what is touched off; ``offset`` says where the tip
    really is minus where it should be.

    Parameters
    ----------
    nose_radius
        Radius of the cutting edge in the rake plane. [mm]
    included
        Included angle of the arc, symmetric about the tip; ``None`` if not stated, then the edge counts as half a
        circle and `check_access` says so. [rad]
    rake
        Angle of the rake face against the vertical, positive leaning back from the cutting direction. [rad]
    clearance
        Angle under the clearance face; ``None`` if not stated. [rad]
    waviness
        Radial deviation of the edge, positive outward: polynomial coefficients (c1, c2, ...) of the sweep in mm/rad^k,
        or a `WavinessTable`.
    radius_error
        Actual minus nominal nose radius. [mm]
    offset
        (dx, dy, dz), where the tip really is minus where it should be; dy is the height above centre, along the
        direction of growing spindle angle. [mm]
    name
        What the shop calls it.

    Raises
    ------
    InputError
        If the edge cannot exist: a radius that is not positive, an included angle beyond half a turn, waviness as
        large as the nose.

    Examples
    --------
    >>> tool = Tool(nose_radius=0.5, included=np.deg2rad(60))
    >>> u, v, e = tool.edge(np.deg2rad([0, 30]))
    >>> np.round(e * 1e3, 3)   # um above the tip
    array([ 0.   , 66.987])
    """

    nose_radius: float
    included: float | None = None
    rake: float = 0.0
    clearance: float | None = None
    waviness: tuple[float, ...] | WavinessTable = ()
    radius_error: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = ""

    def __post_init__(self) -> None:
        positive(self.nose_radius, "nose_radius", "mm")
        if self.included is not None and not 0 < self.included <= np.pi:
            raise InputError(
                f"included is {np.rad2deg(self.included):g} deg, the limits are above 0 and up to 180 deg: "
                "give the included angle of the arc"
            )
        between(np.rad2deg(self.rake), "rake", -80, 80, "deg")
        if self.clearance is not None:
            between(np.rad2deg(self.clearance), "clearance", 0, 80, "deg")
        if self.nose_radius + self.radius_error <= 0:
            raise InputError(
                f"radius_error is {self.radius_error:g} mm on a nose_radius of {self.nose_radius:g} mm, nothing is "
                "left of the nose: give actual minus nominal radius"
            )
        if len(self.offset) != 3 or not np.isfinite(self.offset).all():
            raise InputError(f"offset is {self.offset}, it must be three finite lengths (dx, dy, dz): complete it")
        object.__setattr__(self, "offset", tuple(float(value) for value in self.offset))
        if not isinstance(self.waviness, WavinessTable):
            coefficients = tuple(float(value) for value in self.waviness)
            if not np.isfinite(coefficients).all():
                raise InputError(f"waviness is {coefficients}, every coefficient must be finite: correct it")
            object.__setattr__(self, "waviness", coefficients)
        low, high = self.arc
        deviation = self.deviation(np.linspace(low, high, 721))
        if np.abs(deviation).max() > 0.2 * self.nose_radius:
            raise InputError(
                f"waviness reaches {np.abs(deviation).max():.3g} mm, the limit is a fifth of the nose_radius "
                f"({0.2 * self.nose_radius:.3g} mm): check its unit, mm/rad^k"
            )

    @property
    def arc(self) -> tuple[float, float]:
        """Sweep at the two ends of the arc (lo, hi). [rad]."""
        half = HALF_CIRCLE if self.included is None else min(self.included / 2, HALF_CIRCLE)
        return -half, half

    @property
    def actual_radius(self) -> float:
        """Nominal radius plus its error. [mm]."""
        return self.nose_radius + self.radius_error

    def table(self, sense: int = 1) -> EdgeTable:
        """Return the edge as plain arrays; ``sense`` is +1 where the spindle angle under the tool grows, else -1."""
        low, high = self.arc
        if isinstance(self.waviness, WavinessTable):
            spline = CubicSpline(self.waviness.sweep, self.waviness.deviation)
            breaks, coefficients = spline.x, spline.c
        else:
            # One piece, expanded about sweep 0: sum of c_k sweep^k, with no constant (that is the radius error).
            breaks = np.array([0.0, 1.0])
            coefficients = np.array([*reversed(self.waviness), 0.0])[:, None]
        lean = -sense * np.sin(self.rake)
        return EdgeTable(
            row=np.array([self.actual_radius, low, high, np.cos(self.rake), lean, *self.offset]),
            breaks=np.ascontiguousarray(breaks, dtype=np.float64),
            coefficients=np.ascontiguousarray(coefficients, dtype=np.float64),
        )

    def profile(self) -> Profile:
        """Return the edge as a height over the distance from its tip, for the kernels."""
        from turnwright._kernels import edge as kernel  # noqa: PLC0415 - numba is costly to import

        table = self.table()
        ends = [kernel.edge(*table, end)[:4] for end in self.arc]
        (u_low, w_low, du_low, dw_low), (u_high, w_high, du_high, dw_high) = ends
        perfect = not isinstance(self.waviness, WavinessTable) and not any(self.waviness)
        base = self.actual_radius
        departure = np.empty((2, 0))
        pieces = 8192
        convex = True
        if not perfect:
            base = max(base, 1.000001 * max(-u_low, u_high))
            departure = np.empty((2, pieces + 1))
            kernel.profile_table(*table, base, np.linspace(u_low, u_high, pieces + 1), departure)
            slopes = np.empty(4 * pieces)
            for i, s in enumerate(np.linspace(*self.arc, slopes.size)):
                _, _, du, dw, _, _ = kernel.edge(*table, s)
                slopes[i] = dw / du
            convex = bool((np.diff(slopes) > 0).all())
        row = [base, u_low, w_low, dw_low / du_low, u_high, w_high, dw_high / du_high, pieces / (u_high - u_low)]
        return Profile(row=np.array(row), table=departure, convex=convex)

    def deviation(self, sweep: ArrayLike) -> Floats:
        """Waviness at ``sweep``, held constant beyond the arc (and beyond a certificate's ends). [mm]."""
        low, high = self.arc
        inside = np.clip(np.asarray(sweep, dtype=np.float64), low, high)
        if isinstance(self.waviness, WavinessTable):
            held = np.clip(inside, self.waviness.sweep[0], self.waviness.sweep[-1])
            return np.asarray(CubicSpline(self.waviness.sweep, self.waviness.deviation)(held))
        return np.asarray(np.polyval([*reversed(self.waviness), 0.0], inside))

    def edge(self, sweep: ArrayLike, sense: int = 1) -> tuple[Floats, Floats, Floats]:
        """Return where the edge is, measured from the commanded tip.

        Parameters
        ----------
        sweep
            Angle on the nose; beyond the arc it runs on along the flank. (n,) [rad]
        sense
            +1 where the spindle angle under the tool grows, -1 where it falls: a raked edge leans the other way.

        Returns
        -------
        u, v, e
            Distance toward +X, distance toward growing spindle angle, height. Each (n,) [mm]
        """
        from turnwright._kernels import edge as kernel  # noqa: PLC0415 - numba is costly to import

        sweep = np.asarray(sweep, dtype=np.float64)
        out = np.empty((3, sweep.size))
        kernel.edge_points(*self.table(sense), sweep.ravel(), out)
        u, v, e = (part.reshape(sweep.shape) for part in out)
        return u, v, e
