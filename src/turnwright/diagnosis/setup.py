r"""Tool set-up: corrections of tool height and centring, and the handbook rule for comparison.

A tip that passes the axis at a distance leaves a core at the centre. With the tip above the centre, the clearance face
rubs the core to a cone; with the tip below, the core stays as a cylinder until it breaks off. The radius of the core is
the distance of the tip from the axis, since the last ring that is cut has the radius

.. math:: \sqrt{d_x^2 + d_y^2} \approx |d_y|
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Bools, Floats, robust_scatter
from turnwright._validate import positive
from turnwright.diagnosis.findings import Diagnosis, format_value
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.part import Part

__all__ = ["CentreDefect", "Move", "centre_defect", "handbook_offset", "moves"]

CORE_SIGMA = 5.0
"""A core is higher than the ring around it by at least this many standard deviations of the ring."""

CYLINDER_RATIO = 0.5
"""A core is a cylinder if the radius at half its height exceeds the middle between 1 and this fraction of its foot."""

MIN_POINTS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """A correction at the machine.

    Parameters
    ----------
    axis
        ``"X"``, ``"Z"`` or ``"tool height"``.
    by
        Distance to move the tool: positive toward +X, away from the part, or up along the cutting direction, in which
        the spindle angle under the tool grows. [mm]
    uncertainty
        Half the width of the 95 % confidence interval. [mm]
    sentence
        The same as a sentence.
    """

    axis: Literal["X", "Z", "tool height"]
    by: float
    uncertainty: float
    sentence: str


def moves(diagnosis: Diagnosis) -> tuple[Move, ...]:
    """Return the moves that bring the tool to its planned position, for every offset that is worth a correction.

    Either make these moves, or plan with `Diagnosis.tool`; not both.
    """
    axes: dict[str, tuple[Literal["X", "Z", "tool height"], str]] = {
        "offset x": ("X", "along X"),
        "offset y": ("tool height", "in height (positive toward increasing spindle angle under the tool)"),
        "offset z": ("Z", "along Z"),
    }
    out = []
    for finding in diagnosis:
        if finding.name not in axes or finding.verdict != "correct":
            continue
        axis, words = axes[finding.name]
        low, high = finding.interval
        half = max(high - finding.value, finding.value - low)
        sentence = (
            f"move the tool by {format_value(-finding.value, 'mm')} {words}, known within "
            f"{format_value(half, 'mm')[1:]}"
        )
        out.append(Move(axis=axis, by=-finding.value, uncertainty=half, sentence=sentence))
    return tuple(out)


def handbook_offset(pv: float, radius: float, aperture: float) -> float:
    r"""Return the tool centring error along X from the ogive of a sphere, by the handbook rule.

    .. math:: d_x = \frac{8 R}{A} \mathrm{PV}

    An offset leaves the form error :math:`|d_x| \rho / R`. The parabola through its ends, which reduces its PV most,
    leaves an eighth of :math:`A d_x / R`. The rule holds for small slopes and for a fit of least PV, and is provided
    for comparison only: a sphere fitted by least squares leaves more.

    Parameters
    ----------
    pv
        Peak to valley of the deviation from the best-fit sphere. [mm]
    radius
        Radius of the sphere. [mm]
    aperture
        Diameter of the map. [mm]

    Sources
    -------
    [Troutman2016]_ Eq. 6.20.

    >>> round(handbook_offset(pv=1e-3, radius=10.0, aperture=10.0) * 1e3, 3)   # um
    8.0
    """
    positive(pv, "pv", "mm")
    positive(abs(radius), "the magnitude of the radius", "mm")
    positive(aperture, "aperture", "mm")
    return 8 * abs(radius) / aperture * pv


@dataclass(frozen=True, slots=True, kw_only=True)
class CentreDefect:
    """The core that a tip at a distance from the axis leaves.

    Parameters
    ----------
    shape
        ``"cone"`` or ``"cylinder"``.
    radius
        Radius of its foot, equal to the distance of the tip from the axis. [mm]
    uncertainty
        Half a pixel. [mm]
    height
        Height above the surface around it. [mm]
    offset_y
        Tool height error that would explain it, if the tool centring error along X is smaller. [mm]
    sentence
        The correction, as a sentence.
    """

    shape: Literal["cone", "cylinder"]
    radius: float
    uncertainty: float
    height: float
    offset_y: float
    sentence: str


def centre_defect(heights: HeightMap, part: Part, *, within: float, sense: int = 1) -> CentreDefect | None:
    """Return the core at the centre of a part, or ``None`` if there is none.

    Parameters
    ----------
    heights
        A map in the frame of the part, fine enough to resolve the core. Missing points inside count as core, since
        rough or steep places reflect no light.
    part
        Nominal part.
    within
        Radius of the disc that is searched; its outer half is the reference surface. [mm]
    sense
        +1 if the spindle angle under the tool grew with time, -1 if it fell; the tip cuts against that direction.

    Raises
    ------
    InputError
        If the map has too few points there.

    Sources
    -------
    That the core is a cone above centre and a cylinder below is from lathe manuals on facing; geometry alone gives the
    size only.
    """
    positive(within, "within", "mm")
    heights.require_calibrated()
    x, y = heights.points()
    radius = np.hypot(x, y).ravel()
    near = radius <= within
    error = _subtract_design(heights, part).ravel()
    ring = near & (radius > within / 2) & np.isfinite(error)
    if np.count_nonzero(ring) < MIN_POINTS or np.count_nonzero(near & ~ring) < MIN_POINTS:
        raise InputError(
            f"the map has {np.count_nonzero(near)} points within {within:g} mm of the axis, it needs {MIN_POINTS} in "
            "the inner half and as many heights in the outer one: measure the centre more finely"
        )
    rows = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=1)
    level = np.linalg.lstsq(rows[ring], error[ring], rcond=None)[0]
    off = error - rows @ level
    scatter = robust_scatter(off[ring])
    inner = near & (radius <= within / 2)
    core = inner & (np.isnan(off) | (np.abs(off) > max(CORE_SIGMA * scatter, 1e-7)))
    if np.count_nonzero(core) < 3:
        return None
    pixel = float(np.sqrt(np.pi * within**2 / np.count_nonzero(near)))
    foot = _find_equal_radius(core, pixel)
    height = float(np.nanmax(np.where(core, off, np.nan), initial=-np.inf)) if np.isfinite(off[core]).any() else 0.0
    top = core & (np.isnan(off) | (off > height / 2))
    shape: Literal["cone", "cylinder"] = (
        "cylinder" if _find_equal_radius(top, pixel) > (1 + CYLINDER_RATIO) / 2 * foot else "cone"
    )
    above = shape == "cone"
    offset = sense * (foot if above else -foot)
    side = "above" if above else "below"
    sentence = (
        f"the centre has a {shape} of {foot * 1e3:.3g} um radius, so the tip passes {side} it by about as much: "
        f"{'lower' if above else 'raise'} the tool by {foot * 1e3:.3g} um"
    )
    return CentreDefect(
        shape=shape, radius=foot, uncertainty=pixel / 2, height=max(height, 0.0), offset_y=offset, sentence=sentence
    )  # fmt: skip


def _subtract_design(heights: HeightMap, part: Part) -> Floats:
    """Return the map minus the design, nan where either has no height."""
    x, y = heights.points()
    with np.errstate(all="ignore"):
        return np.asarray(heights.z - part.surface.evaluate(np.ascontiguousarray(x), np.ascontiguousarray(y), 0)[0])


def _find_equal_radius(where: Bools, pixel: float) -> float:
    return float(np.sqrt(np.count_nonzero(where) / np.pi)) * pixel
