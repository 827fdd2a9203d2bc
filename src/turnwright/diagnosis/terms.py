r"""What every cut has besides the sources that are named: lobes, drift, tilt of the spindle, low form.

Each term adds a small height in proportion. What moves the tip by :math:`(\delta_x, \delta_z)` leaves
:math:`\delta_x \, \partial h / \partial d_x + \delta_z` where it cut [Danskin1967]_, so that the terms need nothing of
the cut but its derivatives by the offset, the azimuth of the tip and the time.

Sources
-------
ISO 230-7 names the error motions of a spindle; [MacKay1992]_ finds the size of a group of terms from the data.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright.diagnosis.model import Cutting

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = ["GROUPS", "Group", "columns", "described", "form_of", "lobes_by_angle", "tip_motion"]

AXIAL = tuple(range(1, 13))
RADIAL = tuple(range(2, 13))
"""Per revolution: once is an offset along X that the axis of turning takes up."""

NODES = np.array([0.0, 0.03, 0.07, 0.12, 0.18, 0.25, 0.33, 0.41, 0.49, 0.57, 0.65, 0.73, 0.81, 0.9, 1.0])
"""Shares of a cut at which a drift bends: what comes to rest does most of it at the beginning, what swings with the
temperature of the room does so some times a cut."""

KNOTS = NODES.size - 1

RAMP = 15.0
"""Size of the ramp of a drift, which squareness hides, over that of its bends, which less hides: what comes to rest
within a cut has 4 to 10 times as much ramp as bend."""

EVEN = 1e-4
"""Size of a ramp at least: an even drift has no bends that would tell of it. [mm]"""

DEGREE = 14
"""Zernike degree up to which the form may err."""


class Group(NamedTuple):
    """Terms that share a size."""

    name: str
    size: float  # where the search for it begins, and what it is if that is stated [mm or rad]
    least: float  # that the search may find
    most: float  # and the largest
    relative: Floats  # variances of the terms, in squares of the size. (g,)
    lasting: bool  # whether it comes back on the next part by its nature
    ramp: float = 0.0  # least size of the first term, which nothing else of the group tells of [mm]


def _indices() -> list[tuple[int, int]]:
    """Return degree and order of the terms of form, sines with an order below 0."""
    return [(n, m) for n in range(2, DEGREE + 1) for m in range(-n, n + 1, 2)]


_DRIFT = np.append(RAMP**2, np.ones(KNOTS - 1))
_FALLING = np.array([1 / (n - 1) ** 3 for n, _ in _indices()])

GROUPS = (
    Group("axial error motion of the spindle", 30e-6, 30e-6, 1e-3, np.ones(2), lasting=True),
    Group("axial error motion of the spindle", 20e-6, 0.2e-6, 6e-4, np.ones(2 * len(AXIAL) - 2), lasting=True),
    Group("radial error motion of the spindle", 20e-6, 0.2e-6, 6e-4, np.ones(2 * len(RADIAL)), lasting=True),
    Group("drift of Z", 12e-6, 0.3e-6, 40e-6, _DRIFT, lasting=False, ramp=EVEN),
    Group("drift of X", 12e-6, 0.3e-6, 20e-6, _DRIFT, lasting=False, ramp=EVEN),
    Group("tilt of the spindle", 1e-4, 1e-4, 3e-3, np.ones(3), lasting=True),
    Group("low form", 30e-6, 0.2e-6, 1e-3, _FALLING, lasting=False),
)


def columns(cutting: Cutting, radius: float, form: Floats | None = None) -> Floats:
    """Return the height that one unit of each term of all groups adds. (n, g) [mm per mm, or mm per rad].

    ``form`` is that of the form if it is known already, see `form_of`. (g, n)
    """
    by_x, by_y, _ = np.nan_to_num(cutting.by_tip)
    lobes, drift = _lobes(np.nan_to_num(cutting.tip_angle)), _drift(np.nan_to_num(cutting.tip_radius) / radius)
    z = np.nan_to_num(cutting.z)
    rows = [
        lobes,
        lobes[FIRST_RADIAL:] * by_x,
        drift,
        drift * by_x,
        np.stack([by_x * z, by_y * z, by_y * np.nan_to_num(cutting.tip_radius)]),
        form_of(cutting.x / radius, cutting.y / radius) if form is None else form,
    ]
    return np.concatenate(rows).T


def lobes_by_angle(cutting: Cutting, terms: Floats) -> Floats:
    """Return the derivative of what lobes add by the azimuth of the tip. (n,) [mm/rad]."""
    axial, radial = np.split(terms[: sum(_MOTIONS[:2])], _MOTIONS[:1])
    turned = _lobes_by_angle(_lobes(np.nan_to_num(cutting.tip_angle)))
    return np.asarray(axial @ turned + (radial @ turned[FIRST_RADIAL:]) * np.nan_to_num(cutting.by_tip[0]))


def tip_motion(terms: Floats, radius: Floats, angle: Floats, z: Floats, rim: float) -> tuple[Floats, Floats]:
    """Return by how much terms move the tip along X and Z where it stands at some radius, azimuth and height. [mm].

    What lies across, along Y, is not among it, nor the form.
    """
    axial, radial, z_drift, x_drift, tilt, _ = np.split(terms, np.cumsum(_MOTIONS))
    lobes, drift = _lobes(angle), _drift(radius / rim)
    along_x = radial @ lobes[FIRST_RADIAL:] + x_drift @ drift + tilt[0] * z
    return np.asarray(along_x), np.asarray(axial @ lobes + z_drift @ drift)


FIRST_RADIAL = 2 * (RADIAL[0] - AXIAL[0])
_MOTIONS = (2 * len(AXIAL), 2 * len(RADIAL), KNOTS, KNOTS, 3)


def _lobes(angle: Floats) -> Floats:
    """Return cosine and sine of every multiple of an azimuth. (2 k, n)."""
    lobes = np.empty((len(AXIAL), 2, angle.size))
    np.cos(angle, out=lobes[0, 0])
    np.sin(angle, out=lobes[0, 1])
    cosine, sine = lobes[0]
    for last, lobe in itertools.pairwise(lobes):  # by the sum formulas, as a sine takes ten times as long
        np.subtract(last[0] * cosine, last[1] * sine, out=lobe[0])
        np.add(last[1] * cosine, last[0] * sine, out=lobe[1])
    return lobes.reshape(-1, angle.size)


def _lobes_by_angle(lobes: Floats) -> Floats:
    """Return the derivatives of these by the azimuth. (2 k, n)."""
    pairs = lobes.reshape(len(AXIAL), 2, -1)
    order = np.asarray(AXIAL)[:, None]
    return np.stack([-order * pairs[:, 1], order * pairs[:, 0]], axis=1).reshape(lobes.shape)


def _drift(share: Floats) -> Floats:
    """Return a ramp from the rim to the axis and the bends on it, at a share of the radius. (g, n)."""
    gone = np.clip(1 - share, 0.0, 1.0)
    return np.concatenate([gone[None], _bends()(gone).T])


@cache
def _bends() -> CubicSpline:
    """Return smooth bends that are 1 at one of the inner nodes each; 0 at both ends, as the ramp has the rest."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

    return CubicSpline(NODES, np.eye(NODES.size)[:, 1:-1], bc_type="natural")


def form_of(x: Floats, y: Floats) -> Floats:
    """Return Zernike terms of unit rms from astigmatism and power on. (g, n)."""
    from scipy.special import eval_jacobi  # noqa: PLC0415 - costly to import

    rho, angle = np.hypot(x, y), np.arctan2(y, x)
    out = []
    for n, m in _indices():
        k = abs(m)
        radial = rho**k * eval_jacobi((n - k) // 2, 0, k, 2 * rho**2 - 1)
        wave = np.sin(k * angle) if m < 0 else np.cos(k * angle)
        out.append(np.sqrt((n + 1) * (1 if m == 0 else 2)) * radial * wave)
    return np.stack(out)


def described(name: str, terms: Floats) -> str:
    """Return what is to be said of a group beyond its size; the terms are those of all groups. [mm or rad]."""
    ends = np.cumsum([group.relative.size for group in GROUPS])
    pieces = np.split(terms, ends[:-1])
    own = np.concatenate([one for group, one in zip(GROUPS, pieces, strict=True) if group.name == name])
    if name.endswith("error motion of the spindle"):
        amplitudes = np.hypot(own[::2], own[1::2])
        first = AXIAL if name.startswith("axial") else RADIAL
        top = int(np.argmax(amplitudes))
        return f": most of it {first[top]} per revolution with an amplitude of {amplitudes[top] * 1e6:.3g} nm"
    if name.startswith("drift"):
        return f": {own[0] * 1e6:+.3g} nm from the rim to the axis, as far as squareness allows to tell"
    if name.startswith("tilt"):
        return f": {own[0] * 1e6:+.3g} urad along X"
    return ""
