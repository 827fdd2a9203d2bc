"""The ends of a spiral: where the tip starts outside the clear aperture, and how wide the edge cuts."""

from __future__ import annotations

import math

import numpy as np

from turnwright.edge import Edge
from turnwright.errors import GougeError, InputError
from turnwright.part import Part
from turnwright.strategy.sampling import TURN

__all__ = ["check_overrun", "find_lead_in", "require_overlap"]

RIM_AZIMUTHS = 3600
"""Azimuths at which the slope at the rim is evaluated."""


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


def find_lead_in(part: Part, edge: Edge, feed: float, lead_in: float | None) -> float:
    """Return the distance outside the clear aperture at which the tip starts: as stated, or the least one. [mm]."""
    azimuth = np.linspace(0, TURN, RIM_AZIMUTHS, endpoint=False)
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    zx, zy = part.surface.gradient(part.radius * cosine, part.radius * sine)
    sweep = np.clip(np.arctan(zx * cosine + zy * sine), edge.low, edge.high)
    needed = max(0.0, float(np.max(-edge.radius * np.sin(sweep))) - edge.dx)
    if lead_in is None:
        return needed + feed / 2
    # The outermost revolution cuts as far inward as its neighbours: a lead-in shorter by a feed still cuts the rim.
    if lead_in < needed - feed:
        raise GougeError(
            f"lead_in is {lead_in:g} mm but the edge touches the rim {needed:.4g} mm inside its tip, so a "
            f"band would stay uncut: set lead_in to at least {needed:.4g} mm, or leave it out"
        )
    return lead_in
