r"""Error terms besides the named sources: error motions and tilt of the spindle, drift, low-order form.

Each term adds a small height in proportion. A motion of the tip by :math:`(\delta_x, \delta_z)` adds
:math:`\delta_x \, \partial h / \partial d_x + \delta_z` where it cuts [Danskin1967]_, so that the terms depend only on
the derivatives of the cut by the offset, on the azimuth of the tip and on the time.

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

__all__ = ["GROUPS", "Group", "columns", "describe_group", "form_of", "lobes_by_angle", "tip_motion"]

AXIAL = tuple(range(1, 13))
RADIAL = tuple(range(2, 13))
"""Lobes per revolution. One radial lobe is an offset along X, which shifts the axis of turning."""

NODES = np.array([0.0, 0.03, 0.07, 0.12, 0.18, 0.25, 0.33, 0.41, 0.49, 0.57, 0.65, 0.73, 0.81, 0.9, 1.0])
"""Nodes of a drift, as fractions of a cut: a warm-up drift changes mostly at the beginning, a drift with the room
temperature some times per cut."""

KNOTS = NODES.size - 1

RAMP_RATIO = 15.0
"""Size of the linear part of a drift relative to that of its curvature. Squareness imitates the linear part. A warm-up
drift has 4 to 10 times as much linear part as curvature."""

MIN_RAMP_MM = 1e-4
"""Least size of the linear part: a linear drift has no curvature by which it could be detected."""

ZERNIKE_DEGREE = 14
"""Highest Zernike degree of the form error."""


class Group(NamedTuple):
    """Terms that share a size."""

    name: str
    size: float  # start value of the size, or its fixed value [mm or rad]
    least: float  # limits of the size
    most: float
    relative: Floats  # variances of the terms, in squares of the size. (g,)
    lasting: bool  # whether it always repeats on the next part
    ramp: float = 0.0  # least size of the first term [mm]


def _list_zernike_indices() -> list[tuple[int, int]]:
    """Return degree and order of the Zernike terms; sines have negative orders."""
    return [(n, m) for n in range(2, ZERNIKE_DEGREE + 1) for m in range(-n, n + 1, 2)]


_DRIFT = np.append(RAMP_RATIO**2, np.ones(KNOTS - 1))
_FALLING = np.array([1 / (n - 1) ** 3 for n, _ in _list_zernike_indices()])

GROUPS = (
    Group("axial error motion of the spindle", 30e-6, 30e-6, 1e-3, np.ones(2), lasting=True),
    Group("axial error motion of the spindle", 20e-6, 0.2e-6, 6e-4, np.ones(2 * len(AXIAL) - 2), lasting=True),
    Group("radial error motion of the spindle", 20e-6, 0.2e-6, 6e-4, np.ones(2 * len(RADIAL)), lasting=True),
    Group("drift of Z", 12e-6, 0.3e-6, 40e-6, _DRIFT, lasting=False, ramp=MIN_RAMP_MM),
    Group("drift of X", 12e-6, 0.3e-6, 20e-6, _DRIFT, lasting=False, ramp=MIN_RAMP_MM),
    Group("tilt of the spindle", 1e-4, 1e-4, 3e-3, np.ones(3), lasting=True),
    Group("low form", 30e-6, 0.2e-6, 1e-3, _FALLING, lasting=False),
)


def columns(cutting: Cutting, radius: float, form: Floats | None = None) -> Floats:
    """Return the height that one unit of each term of all groups adds. (n, g) [mm per mm, or mm per rad].

    ``form`` is the result of `form_of` if already computed. (g, n)
    """
    by_x, by_y, _ = np.nan_to_num(cutting.by_tip)
    lobes, drift = (
        _evaluate_lobes(np.nan_to_num(cutting.tip_angle)),
        _evaluate_drift(np.nan_to_num(cutting.tip_radius) / radius),
    )
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
    """Return the derivative of the height of the lobes by the azimuth of the tip. (n,) [mm/rad]."""
    axial, radial = np.split(terms[: sum(_MOTIONS[:2])], _MOTIONS[:1])
    turned = _differentiate_lobes(_evaluate_lobes(np.nan_to_num(cutting.tip_angle)))
    return np.asarray(axial @ turned + (radial @ turned[FIRST_RADIAL:]) * np.nan_to_num(cutting.by_tip[0]))


def tip_motion(terms: Floats, radius: Floats, angle: Floats, z: Floats, rim: float) -> tuple[Floats, Floats]:
    """Return the motion of the tip along X and Z by some terms, at some radius, azimuth and height of the tip. [mm].

    Motion along Y and form are not included.
    """
    axial, radial, z_drift, x_drift, tilt, _ = np.split(terms, np.cumsum(_MOTIONS))
    lobes, drift = _evaluate_lobes(angle), _evaluate_drift(radius / rim)
    along_x = radial @ lobes[FIRST_RADIAL:] + x_drift @ drift + tilt[0] * z
    return np.asarray(along_x), np.asarray(axial @ lobes + z_drift @ drift)


FIRST_RADIAL = 2 * (RADIAL[0] - AXIAL[0])
_MOTIONS = (2 * len(AXIAL), 2 * len(RADIAL), KNOTS, KNOTS, 3)


def _evaluate_lobes(angle: Floats) -> Floats:
    """Return cosine and sine of every multiple of an azimuth. (2 k, n)."""
    lobes = np.empty((len(AXIAL), 2, angle.size))
    np.cos(angle, out=lobes[0, 0])
    np.sin(angle, out=lobes[0, 1])
    cosine, sine = lobes[0]
    for last, lobe in itertools.pairwise(lobes):  # by the angle sum formulas: a sine takes ten times as long
        np.subtract(last[0] * cosine, last[1] * sine, out=lobe[0])
        np.add(last[1] * cosine, last[0] * sine, out=lobe[1])
    return lobes.reshape(-1, angle.size)


def _differentiate_lobes(lobes: Floats) -> Floats:
    """Return the derivatives of these by the azimuth. (2 k, n)."""
    pairs = lobes.reshape(len(AXIAL), 2, -1)
    order = np.asarray(AXIAL)[:, None]
    return np.stack([-order * pairs[:, 1], order * pairs[:, 0]], axis=1).reshape(lobes.shape)


def _evaluate_drift(share: Floats) -> Floats:
    """Return the linear part of a drift from the rim to the axis, and its curvature terms. (g, n)."""
    gone = np.clip(1 - share, 0.0, 1.0)
    return np.concatenate([gone[None], _bend_splines()(gone).T])


@cache
def _bend_splines() -> CubicSpline:
    """Return splines that are 1 at one of the inner nodes each and 0 at the other nodes."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

    return CubicSpline(NODES, np.eye(NODES.size)[:, 1:-1], bc_type="natural")


def form_of(x: Floats, y: Floats) -> Floats:
    """Return Zernike terms of unit rms, starting with astigmatism and power. (g, n)."""
    from scipy.special import eval_jacobi  # noqa: PLC0415 - costly to import

    rho, angle = np.hypot(x, y), np.arctan2(y, x)
    out = []
    for n, m in _list_zernike_indices():
        k = abs(m)
        radial = rho**k * eval_jacobi((n - k) // 2, 0, k, 2 * rho**2 - 1)
        wave = np.sin(k * angle) if m < 0 else np.cos(k * angle)
        out.append(np.sqrt((n + 1) * (1 if m == 0 else 2)) * radial * wave)
    return np.stack(out)


def describe_group(name: str, terms: Floats) -> str:
    """Return a description of a group beyond its size; the terms are those of all groups. [mm or rad]."""
    ends = np.cumsum([group.relative.size for group in GROUPS])
    pieces = np.split(terms, ends[:-1])
    group_terms = np.concatenate([one for group, one in zip(GROUPS, pieces, strict=True) if group.name == name])
    if name.endswith("error motion of the spindle"):
        amplitudes = np.hypot(group_terms[::2], group_terms[1::2])
        first = AXIAL if name.startswith("axial") else RADIAL
        top = int(np.argmax(amplitudes))
        return f": most of it {first[top]} per revolution with an amplitude of {amplitudes[top] * 1e6:.3g} nm"
    if name.startswith("drift"):
        return (
            f": {group_terms[0] * 1e6:+.3g} nm from the rim to the axis, as far as it can be separated from squareness"
        )
    if name.startswith("tilt"):
        return f": {group_terms[0] * 1e6:+.3g} urad along X"
    return ""
