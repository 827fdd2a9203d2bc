r"""Setting the tool up: what to move, and by how much; and the rule of thumb beside it.

A tip that passes beside the axis leaves a core standing there. If it passes above the centre, its clearance face wipes
the core to a cone; if it passes below, the core stays as a cylinder until it breaks off. Either is as wide as the tip
is off, for the last ring that is cut has the radius

.. math:: \sqrt{d_x^2 + d_y^2} \approx |d_y|
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Bools, Floats, robust_scatter
from turnwright._validate import positive
from turnwright.diagnosis.findings import Diagnosis, shown
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.part import Part

__all__ = ["CentreDefect", "Move", "centre_defect", "handbook_offset", "moves"]

STANDS = 5.0
"""A core stands out of the ring around it by this many times what that scatters, at least."""

STEEP = 0.5
"""A core whose upper half is at least this wide, as a share of its foot, has the walls of a cylinder."""

FEWEST = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """Something to do at the machine.

    Parameters
    ----------
    axis
        ``"X"``, ``"Z"`` or ``"tool height"``.
    by
        How far to move the tool, positive toward +X, away from the part, or up along the cutting direction, the way
        in which the spindle angle under the tool grows. [mm]
    uncertainty
        Half the width of the interval that holds it in 95 of 100 cases. [mm]
    sentence
        The same in words.
    """

    axis: Literal["X", "Z", "tool height"]
    by: float
    uncertainty: float
    sentence: str


def moves(diagnosis: Diagnosis) -> tuple[Move, ...]:
    """Return what to move so that the tool stands where it was planned, for every offset worth correcting.

    Do this, or plan with `Diagnosis.tool`; not both.
    """
    axes: dict[str, tuple[Literal["X", "Z", "tool height"], str]] = {
        "offset x": ("X", "along X"),
        "offset y": ("tool height", "in height, up being the way in which the spindle angle under the tool grows"),
        "offset z": ("Z", "along Z"),
    }
    out = []
    for finding in diagnosis:
        if finding.name not in axes or finding.verdict != "correct":
            continue
        axis, words = axes[finding.name]
        low, high = finding.interval
        half = max(high - finding.value, finding.value - low)
        sentence = f"move the tool by {shown(-finding.value, 'mm')} {words}, known within {shown(half, 'mm')[1:]}"
        out.append(Move(axis=axis, by=-finding.value, uncertainty=half, sentence=sentence))
    return tuple(out)


def handbook_offset(pv: float, radius: float, aperture: float) -> float:
    r"""Return the offset along X that the rule of thumb reads from the ogive of a sphere.

    .. math:: d_x = \frac{8 R}{A} \mathrm{PV}

    An offset leaves :math:`|d_x| \rho / R`; the parabola through its ends, which takes most off its PV, leaves an
    eighth of :math:`A d_x / R`. So it holds for small slopes and for a fit of least PV, and is given only to be
    compared with: a sphere fitted by least squares leaves more.

    Parameters
    ----------
    pv
        Peak to valley of the departure from the best-fit sphere. [mm]
    radius
        Of the sphere. [mm]
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
    """The core that a tip beside the axis leaves.

    Parameters
    ----------
    shape
        ``"cone"`` or ``"cylinder"``.
    radius
        Of its foot, and so the distance by which the tip passes the axis. [mm]
    uncertainty
        Half a pixel. [mm]
    height
        Above the surface around it. [mm]
    offset_y
        Height of the tip above the centre that this speaks for, if its offset along X is less. [mm]
    sentence
        What to do.
    """

    shape: Literal["cone", "cylinder"]
    radius: float
    uncertainty: float
    height: float
    offset_y: float
    sentence: str


def centre_defect(heights: HeightMap, part: Part, *, within: float, sense: int = 1) -> CentreDefect | None:
    """Find the core at the centre of a part, or ``None`` if nothing stands out of the surface there.

    Parameters
    ----------
    heights
        A map in the frame of the part, fine enough to show the core; nan inside it counts as standing out, for what
        is rough or steep reflects nothing.
    part
        Its design.
    within
        How far from the axis to look; the outer half of that disc is taken for good. [mm]
    sense
        +1 where the spindle angle under the tool grew with time, -1 where it fell; the tip cuts against that.

    Raises
    ------
    InputError
        If the map has too few points there.

    Sources
    -------
    Cone above centre and cylinder below is what manuals of lathes say of facing: geometry alone tells the size only.
    """
    positive(within, "within", "mm")
    heights.require_calibrated()
    x, y = heights.points()
    radius = np.hypot(x, y).ravel()
    near = radius <= within
    error = _departure(heights, part).ravel()
    ring = near & (radius > within / 2) & np.isfinite(error)
    if np.count_nonzero(ring) < FEWEST or np.count_nonzero(near & ~ring) < FEWEST:
        raise InputError(
            f"the map has {np.count_nonzero(near)} points within {within:g} mm of the axis, it needs {FEWEST} in the "
            "inner half and as many heights in the outer one: measure the centre more finely"
        )
    rows = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=1)
    level = np.linalg.lstsq(rows[ring], error[ring], rcond=None)[0]
    off = error - rows @ level
    scatter = robust_scatter(off[ring])
    inner = near & (radius <= within / 2)
    core = inner & (np.isnan(off) | (np.abs(off) > max(STANDS * scatter, 1e-7)))
    if np.count_nonzero(core) < 3:
        return None
    pixel = float(np.sqrt(np.pi * within**2 / np.count_nonzero(near)))
    foot = _equal_radius(core, pixel)
    height = float(np.nanmax(np.where(core, off, np.nan), initial=-np.inf)) if np.isfinite(off[core]).any() else 0.0
    top = core & (np.isnan(off) | (off > height / 2))
    shape: Literal["cone", "cylinder"] = "cylinder" if _equal_radius(top, pixel) > (1 + STEEP) / 2 * foot else "cone"
    above = shape == "cone"
    offset = sense * (foot if above else -foot)
    side = "above" if above else "below"
    sentence = (
        f"a {shape} of {foot * 1e3:.3g} um radius stands at the centre, so the tip passes {side} it by about as much: "
        f"{'lower' if above else 'raise'} the tool by {foot * 1e3:.3g} um"
    )
    return CentreDefect(
        shape=shape, radius=foot, uncertainty=pixel / 2, height=max(height, 0.0), offset_y=offset, sentence=sentence
    )  # fmt: skip


def _departure(heights: HeightMap, part: Part) -> Floats:
    """Return the map minus the design, nan where either has no height."""
    x, y = heights.points()
    with np.errstate(all="ignore"):
        return np.asarray(heights.z - part.surface.evaluate(np.ascontiguousarray(x), np.ascontiguousarray(y), 0)[0])


def _equal_radius(where: Bools, pixel: float) -> float:
    """Return the radius of the disc that is as large as some pixels."""
    return float(np.sqrt(np.count_nonzero(where) / np.pi)) * pixel
