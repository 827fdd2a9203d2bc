"""The ends of a spiral: where the tip starts outside the clear aperture, and how wide the edge cuts."""

from __future__ import annotations

import math

import numpy as np

from turnwright._arrays import Floats
from turnwright.edge import Edge
from turnwright.errors import GougeError, InputError
from turnwright.outline import Outline
from turnwright.outlined import Continued
from turnwright.part import OVERLAP_FEEDS, OVERLAP_MM, Part

__all__ = ["check_overrun", "find_ends", "require_overlap"]

AIR_TURNS = 2
"""Revolutions in air before and after a part that the tool leaves within a revolution."""


def require_overlap(edge: Edge, feed: float) -> None:
    """Raise if the cuts of neighbouring revolutions do not overlap."""
    width = edge.radius * (math.sin(edge.high) - math.sin(edge.low))
    if feed >= width:
        raise GougeError(
            f"feed {feed:g} mm per rev is at least the width of the edge {width:.4g} mm, so cuts do not "
            "overlap: use a smaller feed, or a tool with a larger nose_radius or included angle"
        )


def check_overrun(overrun: float, feed: float) -> None:
    """Raise if the tip runs further beyond the axis than one feed."""
    if not 0 <= overrun <= feed:
        raise InputError(
            f"overrun is {overrun:g} mm, the limits are 0 mm and one feed, {feed:g} mm: a quarter of a "
            f"feed, {feed / 4:g} mm, is enough to keep the cusp at the axis as low as the others"
        )


def find_ends(
    part: Part, edge: Edge, feed: float, lead_in: float | None, overrun: float, *, step: float = 0.0
) -> tuple[float, float]:
    """Return the commanded radii of the inner end and of the outer end of a spiral. [mm].

    The outer end is outside the clear aperture by the lead-in, as stated or the least one; the inner end is as far
    inside an annulus, or on the axis. Where the tool leaves the part within a revolution, both are in air; ``step`` is
    the largest distance between points there. [mm]
    """
    needed = _find_shift(part, edge, *Outline(disc=part.reach).border(), on_rim=True)[1]
    inner, outer = -edge.dx - overrun, part.reach + max(0.0, needed) + feed / 2
    if part.outline is not None:
        # Whole revolutions more or fewer than on the whole disc, so that its path is the same wherever both cut.
        low, high = _find_shift(part, edge, *part.outline.border(), on_rim=False)
        beyond = OVERLAP_MM + (OVERLAP_FEEDS + AIR_TURNS) * feed + step if part.leaves_air else feed / 2
        outer += feed * math.ceil(max(0.0, high + beyond - outer) / feed)
        if part.nearest > 0:
            inner += feed * math.floor(max(0.0, low - beyond - inner) / feed)
        needed = high - part.reach
    if lead_in is None:
        return inner, outer
    # The outermost revolution cuts as far inward as its neighbours: a lead-in shorter by a feed still cuts the rim.
    if lead_in < needed - feed:
        raise GougeError(
            f"lead_in is {lead_in:g} mm but the edge touches the rim {needed:.4g} mm inside its tip, so a "
            f"band would stay uncut: set lead_in to at least {needed:.4g} mm, or leave it out"
        )
    return inner, part.reach + lead_in


def _find_shift(part: Part, edge: Edge, x: Floats, y: Floats, *, on_rim: bool) -> tuple[float, float]:
    """Return the least and the greatest radius of the tip with the edge on some points; from the rim on it. [mm]."""
    distance = np.hypot(x, y)
    x, y, distance = (one[distance > 0] for one in (x, y, distance))
    surface = part.surface.surface if isinstance(part.surface, Continued) else part.surface
    inside = surface.inside(x, y)
    if inside is not None and not inside.all():
        surface = part.continuation
    zx, zy = surface.gradient(x, y)
    sweep = np.clip(np.arctan((zx * x + zy * y) / distance), edge.low, edge.high)
    shift = -edge.radius * np.sin(sweep) - edge.dx
    tip = shift if on_rim else distance + shift
    return float(tip.min()), float(tip.max())
