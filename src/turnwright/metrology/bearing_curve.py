"""The bearing curve (Abbott and Firestone): how much of a surface lies above each height."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright._validate import between
from turnwright.errors import InputError
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import measure, valid_points

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

NM = 1e6
CORE_AREA_SHARE = 0.4
"""Share of the area over which the core line is fitted (ISO 25178-2)."""

RATIO_SAMPLES = 10_001
"""Material ratios at which the flattest part of the curve is searched for, 0.01 % apart."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bearing:
    """Bearing curve of a map, with the parameters of ISO 25178-2 that come from it. See `bearing`.

    Parameters
    ----------
    height_nm, ratio
        The curve: descending heights, and the share of the area above each. (n,) [nm, 1]
    sk_nm, spk_nm, svk_nm
        Height of the core, and reduced heights of the peaks above and of the valleys below it. [nm]
    smr1, smr2
        Material ratio at the top and at the foot of the core. [1]
    vmp_nm, vmc_nm
        Volume of material per area: of the highest 10 %, and from there to 80 %. [nm]
    vvc_nm, vvv_nm
        Volume of void per area: from 10 to 80 %, and of the lowest 20 %. [nm]
    form
        Form removed first.
    """

    height_nm: Floats
    ratio: Floats
    sk_nm: float
    spk_nm: float
    svk_nm: float
    smr1: float
    smr2: float
    vmp_nm: float
    vmc_nm: float
    vvc_nm: float
    vvv_nm: float
    form: Form

    def height_at_nm(self, ratio: float) -> float:
        """Return the height above which a share of the area lies. [nm]."""
        return float(np.interp(between(ratio, "the material ratio", 0.0, 1.0, ""), self.ratio, self.height_nm))

    def ratio_at(self, height_nm: float) -> float:
        """Return the share of the area above a height. [1]."""
        return float(np.interp(-height_nm, -self.height_nm, self.ratio, left=0.0, right=1.0))


def bearing(heights: HeightMap, *, form: Form = "plane") -> Bearing:
    """Return the bearing curve of a map after its form is removed; each valid point counts with its area.

    The line of best fit over the flattest 40 % of the curve gives the top and the foot of the core at 0 and at 100 %.
    Peaks and valleys beyond are triangles of equal area.

    Parameters
    ----------
    heights
        On a rectangular or polar grid.
    form
        See `remove_form`.

    Raises
    ------
    InputError
        If the form is unknown, the map has too few valid heights, or is perfectly flat.

    Sources
    -------
    ISO 25178-2:2021. Oracles: closed forms of sine and ramp, surfalize.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.arange(1000) / 1000
    >>> ramp = HeightMap(x=x, y=[0.0, 1.0], z=np.tile(1e-4 * x, (2, 1)))
    >>> round(bearing(ramp, form="none").sk_nm, 1)   # all core
    100.0
    """
    valid = valid_points(heights, 2, "a bearing curve")
    grid = measure(heights)
    z = remove_form(heights, form).z
    even = all(np.ptp(one) <= 1e-9 * one.max() for one in (grid.column_area, grid.row_width))
    if even:
        curve = np.sort(z[valid])[::-1] * NM
        weight = np.full(curve.size, 1 / curve.size)
    else:
        area = (grid.row_width[:, None] * grid.column_area)[valid]
        order = np.argsort(-z[valid])
        curve, weight = z[valid][order] * NM, area[order] / area.sum()
    if curve[0] == curve[-1]:
        raise InputError("the heights of the map differ by 0 nm, a bearing curve needs more than 0 nm")
    beyond = np.cumsum(weight)
    ratio = beyond - weight / 2
    # Integral of the curve from 0 to each ratio.
    edges, filled = np.append(0.0, beyond), np.append(0.0, np.cumsum(weight * curve))

    def above(share: float) -> float:
        return float(np.interp(share, edges, filled) - share * np.interp(share, ratio, curve))

    def below(share: float) -> float:
        return float((1 - share) * np.interp(share, ratio, curve) - (filled[-1] - np.interp(share, edges, filled)))

    at = np.linspace(0, 1, RATIO_SAMPLES)
    height = np.interp(at, ratio, curve)
    wide = round(CORE_AREA_SHARE * (RATIO_SAMPLES - 1))
    first = int(np.argmin(height[:-wide] - height[wide:]))
    # The middles of the samples: with both ends, the line would lean toward them.
    middle = (at[first : first + wide] + at[first + 1 : first + wide + 1]) / 2
    slope, top = np.polyfit(middle, np.interp(middle, ratio, curve), 1)
    foot = top + slope
    smr1, smr2 = (float(np.interp(-level, -curve, ratio, left=0.0, right=1.0)) for level in (top, foot))
    peaks = float(np.interp(smr1, edges, filled)) - smr1 * top
    valleys = (1 - smr2) * foot - float(filled[-1] - np.interp(smr2, edges, filled))
    return Bearing(
        height_nm=frozen(curve, "heights"),
        ratio=frozen(ratio, "ratio"),
        sk_nm=float(top - foot),
        spk_nm=2 * max(peaks, 0.0) / smr1 if smr1 > 0 else 0.0,
        svk_nm=2 * max(valleys, 0.0) / (1 - smr2) if smr2 < 1 else 0.0,
        smr1=smr1,
        smr2=smr2,
        vmp_nm=above(0.1),
        vmc_nm=above(0.8) - above(0.1),
        vvc_nm=below(0.1) - below(0.8),
        vvv_nm=below(0.8),
        form=form,
    )
