r"""The surface cut by a tool and a machine that differ from the planned ones, in closed form except for two sweeps.

The commanded heights of the tip are those at which the planned edge, :math:`(u, v, e)` at the sweep s, touches the
design,

.. math:: Z(\rho, \theta) = \max_s \; [\, f(\mathbf q) - e(s) \,], \qquad
   \mathbf q = \mathrm R(\theta) \begin{pmatrix} \rho + u(s) \\ v(s) \end{pmatrix}

and the real edge :math:`(\bar u, \bar v, \bar e)`, on a slide with the unplanned error :math:`\zeta`, leaves

.. math:: h(\mathbf p) = \min_{\bar s} \; [\, Z(\rho, \theta) + \zeta(\rho) + \bar e(\bar s) \,], \qquad
   \rho = \sqrt{r^2 - \bar v^2} - \bar u, \quad \theta = \varphi - \arcsin(\bar v / r)

at the point :math:`\mathbf p = (r, \varphi)`, in the limit of zero feed. Both sweeps are found together by Newton's
method. The height is stationary in both, so that its derivative by any error is the explicit one, with both sweeps
fixed [Danskin1967]_. This gives exact derivatives for a fit at the cost of one height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright._kernels import dilation as dilation_kernel, swept as kernel
from turnwright.placing import touch as touch_down
from turnwright.progress import run_chunks
from turnwright.surface import Surface
from turnwright.tool import Tool

__all__ = ["Cutting", "Deviations", "Sweeps", "Swept", "raise_sweep"]

MAX_STEPS = 30
"""Most Newton steps for both sweeps; four are usual."""

SWEEP_TOL_RAD = 1e-10
"""Tolerance of the sweeps; the height is stationary in them."""

HELD_OFF_TOL_MM = 1e-9
"""A tip that is higher than its tangent contact by more than this touches the surface elsewhere."""

CHUNK = 1 << 14
"""Points that are computed together."""

ROWS = 14
"""Rows that `turnwright._kernels.swept.heights` fills."""


def raise_sweep(sweep: Floats, powers: Sequence[int]) -> Floats:
    """Return ascending powers of the sweep and their first two derivatives. (3, powers, n)."""
    out = np.zeros((3, len(powers), sweep.size))
    raised = [np.ones_like(sweep)]
    for _ in range(max(powers, default=0)):
        raised.append(raised[-1] * sweep)
    for k, power in enumerate(powers):
        out[0, k] = raised[power]
        out[1, k] = power * raised[power - 1]
        if power > 1:
            out[2, k] = power * (power - 1) * raised[power - 2]
    return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Deviations:
    """Deviations of the real tool and machine from the planned ones.

    Parameters
    ----------
    offset
        Offset of the tip (dx, dy, dz). [mm]
    radius
        Error of the nose radius. [mm]
    powers, waviness
        Further deviation of the edge: powers of the sweep, and their coefficients. (k,) [mm/rad^k]
    squareness
        Height error per X. [rad]
    knots, straightness
        Height error along X at some positions, linear in between, constant beyond. Each (m,) [mm]
    late
        Azimuth by which the height lags behind the spindle. [rad]
    stiff
        Amplitude error of Z: the height lacks this multiple of its second derivative by the azimuth. [rad²]
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.0
    powers: tuple[int, ...] = ()
    waviness: Floats = field(default_factory=lambda: np.zeros(0))
    squareness: float = 0.0
    knots: Floats = field(default_factory=lambda: np.zeros(0))
    straightness: Floats = field(default_factory=lambda: np.zeros(0))
    late: float = 0.0
    stiff: float = 0.0

    def slide(self, at: Floats) -> tuple[Floats, Floats]:
        """Return the height error of the slide and its slope. Each (n,) [mm, 1]."""
        height, slope = self.squareness * at, np.full(at.shape, self.squareness)
        if self.knots.size:
            height = height + np.interp(at, self.knots, self.straightness)
            steep = np.concatenate(([0.0], np.diff(self.straightness) / np.diff(self.knots), [0.0]))
            slope += steep[np.searchsorted(self.knots, at, side="right")]
        return height, slope


class Sweeps(NamedTuple):
    """Places on the nose at which the planned edge touched and the real one cut. Each (n,) [rad], nan for none."""

    touch: Floats
    cut: Floats


class Cutting(NamedTuple):
    """How the points of a map were cut. Each (n,).

    ``z``, ``zx`` and ``zy`` are the height of the cut and its slopes; ``by_tip`` (3, n) its derivatives by the offset
    of the tip, ``by_radius`` by the nose radius, ``by_edge`` by a deviation of the edge where it cut, ``by_azimuth`` by
    an azimuth by which Z is early, ``bend`` the second derivative of the height of the tip by its azimuth,
    ``between`` the curvature that makes the cusps, and ``between_by`` (3, n) its derivatives by a deviation of the edge
    and by the first two derivatives of that. [mm, 1, mm/rad, mm/rad², 1/mm, 1/mm²]
    """

    x: Floats
    y: Floats
    tip_radius: Floats
    tip_angle: Floats
    sweep: Floats
    z: Floats
    zx: Floats
    zy: Floats
    by_tip: Floats
    by_radius: Floats
    by_edge: Floats
    by_azimuth: Floats
    bend: Floats
    between: Floats
    between_by: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Swept:
    """A design as cut by a real tool with the path of the planned tool.

    Parameters
    ----------
    surface, tool
        Nominal surface and planned tool.
    sense
        +1 if the spindle angle grew, -1 if it fell.
    rim
        Radius inside which the design counts. [mm]
    """

    surface: Surface
    tool: Tool
    sense: int
    rim: float

    def guess(self, x: Floats, y: Floats) -> Sweeps:
        """Return the sweeps of the tangent in the plane through the axis, nan where there is none."""
        edge = self.tool.cutting_edge(self.sense)
        sweep = np.zeros(x.size)

        def work(start: int, stop: int) -> None:
            some = slice(start, stop)
            with np.errstate(all="ignore"):
                radius = np.hypot(x[some], y[some])
                cosine, sine = x[some] / radius, y[some] / radius
                _, zx, zy = self.surface.evaluate(x[some], y[some], 1)
            dilation_kernel.tangent_sweep(edge, zx * cosine + zy * sine, zy * cosine - zx * sine, sweep[some])

        run_chunks(work, x.size, CHUNK)
        return Sweeps(sweep, sweep.copy())

    def start(self, x: Floats, y: Floats) -> Sweeps:
        """Return the sweeps at which the planned tool cuts some points, nan where it cannot or would reach the axis."""
        sweeps = self.guess(x, y)
        at = self.heights(x, y, sweeps, Deviations())
        with np.errstate(invalid="ignore"):
            cut_points = np.flatnonzero(np.isfinite(at.z) & (at.tip_radius > 0))
        reached = np.zeros(x.size, dtype=np.bool_)
        if cut_points.size:
            # The tangent may be one of several: the tool touches at the highest of them.
            tip = at.tip_radius[cut_points], at.tip_angle[cut_points]
            rim = max(self.rim, float(tip[0].max()))
            down = touch_down(self.surface, self.tool, angle=tip[1], radius=tip[0], sense=self.sense, rim=rim)
            height = at.z[cut_points] - self.tool.edge(sweeps.cut[cut_points], self.sense)[2]
            reached[cut_points] = np.abs(down.z - height) < HELD_OFF_TOL_MM
        for one in sweeps:
            one[~reached] = np.nan
        return sweeps

    def heights(self, x: Floats, y: Floats, sweeps: Sweeps, deviations: Deviations) -> Cutting:
        """Return how some points were cut; the sweeps are updated in place, nan where the edge has no such place.

        Parameters
        ----------
        x, y
            Points. (n,) [mm]
        sweeps
            Start values.
        deviations
            Deviations of the real tool and machine.
        """
        out = np.empty((ROWS, x.size))
        rho, psi = np.empty(x.size), np.empty(x.size)

        def work(start: int, stop: int) -> None:
            some, part = slice(start, stop), np.empty((ROWS, stop - start))
            self._chunk(x[some], y[some], sweeps.touch[some], sweeps.cut[some], deviations, part, rho[some], psi[some])
            out[:, some] = part

        run_chunks(work, x.size, CHUNK)
        z, zx, zy, by_x, by_y, by_z, by_radius, by_edge, by_azimuth, bend, between = out[:11]
        return Cutting(
            x=x, y=y, tip_radius=rho, tip_angle=psi, sweep=sweeps.cut, z=z, zx=zx, zy=zy,
            by_tip=np.stack([by_x, by_y, by_z]), by_radius=by_radius, by_edge=by_edge, by_azimuth=by_azimuth,
            bend=bend, between=between, between_by=out[11:],
        )  # fmt: skip

    def _chunk(
        self, x: Floats, y: Floats, touch: Floats, cut: Floats, real: Deviations, out: Floats, rho: Floats, psi: Floats
    ) -> None:
        """Fill the rows, the radius and the azimuth of the tip for some points, and update the sweeps."""
        planned = self.tool.cutting_edge(self.sense)
        dx, dy, dz = (float(one) for one in real.offset)
        # Only the fields for the arc of the real edge; its waviness is the planned one plus the deviation.
        edge = planned._replace(
            radius=planned.radius + float(real.radius), dx=planned.dx + dx, dy=planned.dy + dy, dz=planned.dz + dz
        )
        late = self.sense * real.late
        radius, azimuth = np.hypot(x, y), np.arctan2(y, x)
        piece = None if not self.surface.in_pieces else self.surface.piece(x, y)

        def deviation() -> Floats:
            if not real.waviness.size:
                return np.zeros((3, x.size))
            held = np.clip(np.nan_to_num(cut), planned.low, planned.high)
            return np.tensordot(raise_sweep(held, real.powers), real.waviness, (1, 0))

        at_x, at_y = np.empty(x.size), np.empty(x.size)
        for _ in range(MAX_STEPS):
            more = deviation()
            kernel.places(
                radius, azimuth, planned, edge, more, late, touch, cut, rho, psi, at_x, at_y
            )  # fmt: skip
            slope = real.slide(rho)[1]
            with np.errstate(all="ignore"):
                bent = self.surface.evaluate(at_x, at_y, 2)[1:]
            longest = kernel.step(
                radius, planned, edge, more, late, slope, rho, psi, *bent, touch, cut
            )  # fmt: skip
            # The deviation at the last step has not been evaluated yet: iterate until the step is small.
            if longest < SWEEP_TOL_RAD:
                break
        # Results beyond the arc of the edge, or beyond a seam of the design, are not valid.
        with np.errstate(invalid="ignore"):
            lost = ~((touch >= planned.low) & (touch <= planned.high) & (cut >= planned.low) & (cut <= planned.high))
        touch[lost], cut[lost] = np.nan, np.nan
        more = deviation()
        kernel.places(radius, azimuth, planned, edge, more, late, touch, cut, rho, psi, at_x, at_y)
        with np.errstate(all="ignore"):
            bent = self.surface.evaluate(at_x, at_y, 2)
        kernel.heights(
            radius, azimuth, planned, edge, more, late, *real.slide(rho), rho, psi, *bent, touch, cut, out
        )  # fmt: skip
        out[0] -= real.stiff * out[9]
        if piece is not None:
            out[:, self.surface.piece(at_x, at_y) != piece] = np.nan
