r"""The ductile-mode check: whether the uncut chip stays below the critical chip thickness.

A pass is ductile if no chip exceeds :math:`t_c - 2u` and brittle if one exceeds :math:`t_c + 2u`, with the standard
uncertainty u. In between it is uncertain and is treated as brittle. The largest ductile feed follows from the chip at
each point: on a nose of radius R the chip is thickest at

.. math:: s = \frac{R^2 + f^2 - (R - t)^2}{2 f}, \qquad f_c = s - \sqrt{s^2 - R^2 + (R - t_c)^2} .
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright.cutting.chip import RoundChip, relative_radius
from turnwright.errors import InputError
from turnwright.units import say_length

if TYPE_CHECKING:
    from collections.abc import Callable

    from turnwright.cutting.chip import ChipMap
    from turnwright.material import CriticalThickness, Material
    from turnwright.tool import Tool

__all__ = ["DuctileCheck", "check_ductile", "predict_chips"]

MIN_RAKE_RAD = np.deg2rad(-45)
"""Most negative rake that is proposed as a remedy."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DuctileCheck:
    """Result of the ductile-mode check of a pass.

    Parameters
    ----------
    chips
        Uncut chip of the pass.
    critical
        Critical chip thickness at each point, for its effective rake. (n,) [mm]
    margin
        1 - thickness / critical; negative where the material fractures. (n,) [1]
    uncertainty
        Expanded uncertainty of the margin (k = 2); ``None`` if the material states no uncertainty. [1]
    share
        Fraction of the clear aperture that is cut beyond the critical thickness. [1]
    doubtful
        Fraction of the clear aperture whose margin lies within its uncertainty. [1]
    fracture
        Greatest depth of cracks below the surface that the pass leaves; ``None`` if the material states no
        ``fracture_ratio``. [mm]
    allowance
        Thickness that later passes remove. [mm]
    feed
        Feed of the pass. [mm/rev]
    largest_feed
        Largest feed at which every chip is ductile; infinite if the depth of cut alone ensures that. [mm/rev]
    rake
        Tool rake nearest to the actual one at which every chip is ductile at this feed; ``None`` if none is known.
        [rad]
    """

    chips: ChipMap
    critical: Floats
    margin: Floats
    uncertainty: float | None
    share: float
    doubtful: float
    fracture: float | None
    allowance: float
    feed: float
    largest_feed: float
    rake: float | None

    @property
    def worst(self) -> int:
        """Index of the point within the clear aperture that has the smallest margin."""
        return int(np.argmin(np.where(self.chips.inside, self.margin, np.inf)))

    @property
    def verdict(self) -> Literal["ductile", "uncertain", "brittle"]:
        """Whether the smallest margin is above zero, within its uncertainty of zero, or below zero."""
        if not self.chips.inside.any():
            return "ductile"
        margin = self.margin[self.worst]
        band = self.uncertainty or 0.0
        return "ductile" if margin >= band else "brittle" if margin < -band else "uncertain"

    @property
    def ductile(self) -> bool:
        """Whether every chip is below its critical thickness by more than the uncertainty."""
        return self.verdict == "ductile"

    @property
    def ok(self) -> bool:
        """Whether the pass is ductile, or later passes remove its cracks."""
        return self.ductile or self.fracture == 0.0 or (self.fracture is not None and self.fracture < self.allowance)

    @property
    def sentence(self) -> str:
        """The result in one sentence, with remedies if the pass is not acceptable."""
        at = self.worst
        x, y = (round(float(values[at]), 6) + 0.0 for values in (self.chips.x, self.chips.y))
        chip = f"the chip is up to {say_length(self.chips.thickness[at])} thick at ({x:.3g}, {y:.3g}) mm"
        chip += f", the limit there is {say_length(self.critical[at])}"
        margin = f"margin of {_percent(self.margin[at])}"
        if self.uncertainty is not None:
            margin += f" +- {_percent(self.uncertainty)}"
        if self.ductile:
            return f"ductile, with a {margin}: {chip}"
        if self.verdict == "brittle":
            result = f"brittle: {chip}, which {100 * self.share:.3g} % of the area exceeds"
        else:
            result = (
                f"ductile regime not certain: the {margin} lies within its uncertainty on "
                f"{100 * self.doubtful:.3g} % of the area; {chip}"
            )
        if self.fracture == 0.0:
            return f"{result}; cracks end above the surface that the pass leaves"
        if self.ok and self.fracture is not None:
            removal = f"within the {say_length(self.allowance)} that later passes remove"
            return f"{result}; cracks may be {say_length(self.fracture)} deep, {removal}"
        depth = "" if self.fracture is None else f"; cracks may be {say_length(self.fracture)} deep"
        remedies = _feed_remedy(self.largest_feed)
        if self.rake is not None:
            remedies.append(f"a rake of {np.rad2deg(self.rake):.3g} deg")
        if self.fracture is not None:
            remedies.append(f"later passes that remove more than {say_length(self.fracture)}")
        remedy = ", or ".join(remedies) or "a material with a smaller uncertainty of the limit"
        return f"{result}{depth}, and later passes remove {say_length(self.allowance)}: use {remedy}"


def _feed_remedy(feed: float) -> list[str]:
    """Return the largest safe feed as a remedy; none if the limit is so uncertain that no feed is safe."""
    return [f"feed at most {feed * 1e3:.3g} um/rev"] if feed > 0 else []


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.0f} %" if abs(ratio) >= 0.1 else f"{100 * ratio:.2g} %"


def check_ductile(chips: ChipMap, material: Material, tool: Tool, *, allowance: float = 0.0) -> DuctileCheck:
    """Check whether the chips of a pass stay in the ductile regime.

    Parameters
    ----------
    chips
        Uncut chip of the pass, computed for the same material; it holds the depth of cracks.
    material
        Material, with a critical chip thickness.
    tool
        Tool that cuts the pass.
    allowance
        Thickness that later passes remove. [mm]

    Raises
    ------
    InputError
        If the material states no critical thickness: it is then ductile at any chip thickness.

    Sources
    -------
    [Troutman2016]_ chs. 4-5, [Blackley1991]_. Oracle of the feed: the chips at that feed.
    """
    limit = _critical_of(material)
    critical = limit.at(rake=chips.rake, angle=chips.angle)
    margin = 1 - chips.thickness / critical
    band, inside = limit.doubt, chips.inside
    weight = np.hypot(chips.x, chips.y) * np.abs(np.gradient(chips.angle) if chips.angle.size > 1 else np.ones(1))
    total = float(weight[inside].sum())

    def area_fraction(where: Bools) -> float:
        fraction = float(weight[inside & where].sum()) / total if total > 0 else 0.0
        return max(fraction, np.finfo(float).tiny) if (inside & where).any() else 0.0

    def is_ductile(turned: float) -> bool:
        highest = limit.at(rake=chips.rake[inside] + turned, angle=chips.angle[inside]) * limit.safe
        return bool((chips.thickness[inside] <= highest).all())

    fracture = None
    if material.fracture_ratio is not None:
        fracture = float(chips.fracture[inside].max(initial=0.0))
    return DuctileCheck(
        chips=chips, critical=critical, margin=margin, share=area_fraction(margin < 0),
        uncertainty=None if limit.uncertainty is None else band,
        doubtful=area_fraction((margin < band) & (margin >= -band)),
        fracture=fracture, allowance=float(allowance),
        feed=chips.feed, largest_feed=_largest_feed(chips, critical * limit.safe, tool),
        rake=_ductile_rake(limit, tool, is_ductile),
    )  # fmt: skip


def _largest_feed(chips: ChipMap, critical: Floats, tool: Tool) -> float:
    """Return the largest feed at which no chip exceeds the limit. [mm/rev]."""
    cut = chips.inside & (chips.thickness > 0)
    if not cut.any():
        return float("inf")
    radius, feed = tool.actual_radius / np.cos(tool.rake), chips.feed
    t, limit = chips.thickness[cut], np.minimum(critical[cut], radius)
    side = (feed**2 + t * (2 * radius - t)) / (2 * feed)
    square = side**2 - limit * (2 * radius - limit)
    feeds = np.where(square >= 0, side - np.sqrt(np.maximum(square, 0.0)), np.inf)
    return float(feeds.min())


def _ductile_rake(critical: CriticalThickness, tool: Tool, is_ductile: Callable[[float], bool]) -> float | None:
    """Return the ductile tool rake nearest to the actual one, in steps of a degree; ``None`` if none is known."""
    if critical.rake is None:
        return None
    low, high = max(critical.rake[0][0], MIN_RAKE_RAD), critical.rake[0][-1]
    for turned in sorted(np.deg2rad(np.arange(-45, 46)), key=abs):
        if low - 1e-9 <= tool.rake + turned <= high + 1e-9 and is_ductile(turned):
            return float(tool.rake + turned)
    return None


def _critical_of(material: Material) -> CriticalThickness:
    if material.critical is None:
        raise InputError(
            f"material {material.name!r} states no critical thickness, the ductile-mode check needs one: state it, or "
            "leave the check out"
        )
    return material.critical


def predict_chips(
    tool: Tool,
    material: Material,
    *,
    feed: float,
    depth: float,
    bend: float,
    rakes: tuple[float, float],
    allowance: float,
) -> str:
    """Predict the ductile-mode check of a pass from its feed and depth, before the path is planned.

    Parameters
    ----------
    tool, material
        Tool, and material with a critical chip thickness.
    feed, depth
        Feed and depth of cut of the pass. [mm/rev], [mm]
    bend
        Smallest curvature of the surface along the radius, negative where it is convex. The chip is thickest there.
        [1/mm]
    rakes
        Lowest and highest effective rake. [rad]
    allowance
        Thickness that later passes remove. [mm]

    Returns
    -------
    str
        Expected chip thickness, its limit, and the feed and rake that would stay ductile.

    Raises
    ------
    InputError
        If the material states no critical thickness, or neighbouring revolutions do not meet below the stock.
    """
    of_material = _critical_of(material)
    radius = float(relative_radius(tool, bend))
    chip = RoundChip(nose_radius=radius, feed=feed, depth=depth)
    around = np.linspace(0, 2 * np.pi, 73)[:-1]

    def limit(turned: float) -> float:
        places = np.linspace(rakes[0], rakes[1], 33) + turned
        return float(of_material.at(rake=places[:, None], angle=around).min())

    critical, band = limit(0.0), of_material.doubt
    safe = critical * of_material.safe
    expected = f"the chip will be about {say_length(chip.thickest)} thick, the limit is {say_length(critical)}"
    if band:
        expected += f" +- {say_length(band * critical)}"
    side = np.sqrt(depth * (2 * radius - depth))
    square = side**2 - safe * (2 * radius - safe)
    largest = side - np.sqrt(square) if square > 0 else float("inf")
    feeds = f"ductile up to a feed of {largest * 1e3:.3g} um/rev" if np.isfinite(largest) else "ductile at any feed"
    if chip.thickest <= safe:
        return f"{expected}: {feeds}"
    remedies = _feed_remedy(largest)
    rake = _ductile_rake(of_material, tool, lambda turned: limit(turned) * of_material.safe >= chip.thickest)
    if rake is not None:
        remedies.append(f"a rake of {np.rad2deg(rake):.3g} deg")
    elif of_material.rake is None:
        remedies.append("a more negative rake (this material does not state its effect)")
    cracks = _predict_cracks(chip, safe, material.fracture_ratio, allowance)
    certain = chip.thickest > critical * (1 + band)
    verdict = "brittle" if certain else "ductile regime not certain, the margin lies within its uncertainty"
    return f"{verdict}: {expected}; {cracks}; to stay ductile use {', or '.join(remedies)}"


def _predict_cracks(chip: RoundChip, safe: float, ratio: float | None, allowance: float) -> str:
    """Return the depth of cracks; they begin at the lowest point of the edge that exceeds the limit."""
    removal = f"later passes remove {say_length(allowance)}"
    if ratio is None:
        return f"{removal}, the depth of cracks is not known"
    sweep = np.linspace(0.0, chip.sweep[1], 4001)
    begins = float(sweep[np.argmax(chip.thickness(sweep) > safe)])
    depth = ratio * chip.thickest - chip.nose_radius * (1 - np.cos(begins))
    if depth <= 0:
        return "cracks end above the surface that the pass leaves"
    shortfall = "" if depth < allowance else ", which is not enough"
    return f"cracks may be {say_length(depth)} deep, {removal}{shortfall}"
