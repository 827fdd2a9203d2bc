"""Summarise the shape of a part over its clear aperture, to show a wrong unit or sign."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import best_fit
from turnwright.part import Part
from turnwright.units import say_length

__all__ = ["PartShape", "part_shape"]

RADII, ANGLES = 201, 360
"""Samples along the radius, the axis included, and around it."""

FLAT = 1e-12
"""Largest curvature of a flat point. [1/mm]"""

ROUNDING = 1e-9
"""Largest height, or departure from the best-fit sphere, that is rounding. [mm]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PartShape:
    """The shape of a surface over the clear aperture of its part, at 201 radii and 360 azimuths.

    Parameters
    ----------
    lowest, highest
        Heights of the finished surface. [mm]
    steepest, steepest_at
        Largest slope, and its position x, y. [rad, mm]
    sphere_radius
        Radius of curvature of the best-fit sphere, positive where concave; infinite for a plane. [mm]
    departure_pv, departure_rms
        Departure of the surface from that sphere, or from the best-fit plane where no sphere fits, along z. [mm]
    concave_radius, convex_radius
        Least radius of curvature of either sign; infinite if there is none. [mm]
    """

    lowest: float
    highest: float
    steepest: float
    steepest_at: tuple[float, float]
    sphere_radius: float
    departure_pv: float
    departure_rms: float
    concave_radius: float
    convex_radius: float

    @property
    def facts(self) -> dict[str, str]:
        """Each quantity with its unit, by name."""
        x, y = (round(one, 6) + 0.0 for one in self.steepest_at)
        departure = f"departure PV {say_length(self.departure_pv)}, RMS {say_length(self.departure_rms)}"
        sphere = f"none, a plane fits best, {departure}"
        if math.isfinite(self.sphere_radius):
            bend = "concave" if self.sphere_radius > 0 else "convex"
            sphere = f"R {say_length(abs(self.sphere_radius))} {bend}, {departure}"
        elif self.departure_pv == 0:
            sphere = "none, the part is flat"
        radii = {"concave": self.concave_radius, "convex": self.convex_radius}
        curved = [f"{say_length(radius)} {kind}" for kind, radius in radii.items() if math.isfinite(radius)]
        return {
            "Heights": (
                f"{say_length(self.lowest)} to {say_length(self.highest)}, PV {say_length(self.highest - self.lowest)}"
            ),
            "Steepest slope": f"{math.degrees(self.steepest):.4g} deg at x = {x:.4g} mm, y = {y:.4g} mm",
            "Best-fit sphere": sphere,
            "Least radius of curvature": ", ".join(curved) or "none, it is flat",
        }

    @property
    def sentences(self) -> tuple[str, ...]:
        """The facts, one line each."""
        return tuple(f"{name[0].lower()}{name[1:]}: {value}" for name, value in self.facts.items())


def part_shape(part: Part) -> PartShape:
    """Return the shape of a part's surface over its clear aperture.

    Sources
    -------
    Curvatures are the eigenvalues of the shape operator of a graph. Oracle: closed forms of sphere, cylinder, cone.

    >>> from turnwright.part import Part
    >>> from turnwright.surface import Sphere
    >>> shape = part_shape(Part(surface=Sphere(radius=-40.0), radius=5.0))
    >>> round(shape.sphere_radius, 6), round(shape.convex_radius, 6), shape.concave_radius
    (-40.0, 40.0, inf)
    """
    radius = np.linspace(part.nearest, part.reach, RADII)
    angle = np.linspace(0.0, 2.0 * np.pi, ANGLES, endpoint=False)
    x, y = radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]
    z = part.heights(x, y)
    surface = part.continuation
    with np.errstate(all="ignore"):  # a formula may have no slope at single points
        zx, zy = surface.gradient(x, y)
        zxx, zxy, zyy = surface.hessian(x, y)
        slope = np.hypot(zx, zy)
        # Second form along the slope and across it, each over the length of its tangent: a symmetric shape operator.
        normal = np.sqrt(1.0 + slope**2)
        level = slope == 0.0
        ux, uy = np.where(level, 1.0, zx / slope), np.where(level, 0.0, zy / slope)
        along = (ux**2 * zxx + 2.0 * ux * uy * zxy + uy**2 * zyy) / normal**3
        across = (uy**2 * zxx - 2.0 * ux * uy * zxy + ux**2 * zyy) / normal
        mixed = (ux * uy * (zyy - zxx) + (ux**2 - uy**2) * zxy) / normal**2
        spread = np.hypot((along - across) / 2.0, mixed)
        bends = (along + across) / 2.0 + np.stack([-spread, spread])
    bends = bends[np.isfinite(bends) & np.isfinite(z)]
    slope = np.where(np.isfinite(slope) & np.isfinite(z), slope, -1.0)
    worst = int(np.argmax(slope))
    heights = HeightMap(z=z, radius=radius, angle=angle)
    try:
        fit = best_fit(heights, "sphere")
    except InputError:  # no sphere fits, for example two levels of a step
        fit = best_fit(heights, "plane")
    sphere, departs = fit.parameters.get("radius", math.inf), fit.pv_nm * 1e-6 > ROUNDING
    lowest, highest = float(np.nanmin(z)), float(np.nanmax(z))
    least, most = (float(bends.min()), float(bends.max())) if bends.size else (0.0, 0.0)
    return PartShape(
        lowest=lowest if abs(lowest) > ROUNDING else 0.0,
        highest=highest if abs(highest) > ROUNDING else 0.0,
        steepest=float(np.arctan(slope.flat[worst])),
        steepest_at=(float(x.flat[worst]), float(y.flat[worst])),
        sphere_radius=sphere if abs(sphere) < 1.0 / FLAT else math.inf,
        departure_pv=fit.pv_nm * 1e-6 if departs else 0.0,
        departure_rms=fit.rms_nm * 1e-6 if departs else 0.0,
        concave_radius=1.0 / most if most > FLAT else math.inf,
        convex_radius=-1.0 / least if least < -FLAT else math.inf,
    )
