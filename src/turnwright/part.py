"""What is asked for: a surface, how far it reaches, and what it is cut from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._validate import check_numbers, positive
from turnwright.errors import InputError
from turnwright.surface import Surface

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.heightmap import HeightMap
    from turnwright.surface import Smooth

__all__ = ["Blank", "Part", "correction_of", "evenly"]

FEWEST = 100
"""Heights below which an error is not told from its noise."""

FINEST = 200
"""Cutoffs on the diameter at most: a finer correction follows cusps and noise of any instrument."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Blank:
    """What a part is cut from: a disc on the axis of the spindle.

    Its top follows the finished surface at the distance of the part's stock. Beyond the clear radius, where nothing is
    known of the finished surface, it goes on at the slope of the rim where that rises outward, and level where it
    falls.

    Parameters
    ----------
    radius
        How far from the axis there is material, its runout included. [mm]

    Raises
    ------
    InputError
        If the radius is not positive.
    """

    radius: float

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "blank radius", "mm")

    @property
    def reach(self) -> float:
        """Largest distance of any material from the axis. [mm]."""
        return self.radius


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part to be cut.

    Parameters
    ----------
    surface
        The finished surface z = f(x, y), with the vertex at the origin and the spindle along z.
    radius
        Clear radius: how far from the axis the surface must be right. [mm]
    stock
        Thickness of material above the finished surface before the first pass. [mm]
    material
        What is cut, as the drawing names it.
    material_note
        Free text on the material: condition, supplier, lot. Nothing is derived from it.
    name
        What the shop calls the part.
    blank
        What it is cut from; ``None`` where that is not known. Then material is taken to reach farther out than the tool
        ever does, so that no pass begins beside it.

    Raises
    ------
    InputError
        If the radius is not positive, the stock is negative, or the blank is smaller than the part.
    DomainError
        If the surface is not defined everywhere inside the clear radius.
    """

    surface: Surface
    radius: float
    stock: float = 0.0
    material: str = ""
    material_note: str = ""
    name: str = ""
    blank: Blank | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "part radius", "mm")
        if self.blank is not None and self.blank.reach < self.radius:
            raise InputError(
                f"the blank reaches {self.blank.reach:g} mm from the axis, the limit is the clear radius "
                f"{self.radius:g} mm or more: give the radius of the blank"
            )
        if self.stock < 0:
            raise InputError(f"stock is {self.stock:g} mm, it cannot be below 0 mm: give the thickness to remove")
        self.surface.require_disc(self.radius, "the clear radius")

    def corrected(self, error: HeightMap, *, cutoff: float, beyond: float) -> Part:
        r"""Return the part to aim at so that an error that repeats does not come back.

        What the measured error has in common over wavelengths above the cutoff is taken off the surface. No wavelength
        is corrected by more than it was measured, so noise is never amplified: half of the heights is foretold from
        the other half, the cutoff that does so best is taken, among this one and longer ones, and where none foretells
        more than noise the surface stays as it is. Missing places and the rim are bridged by a bending plate.

        Parameters
        ----------
        error
            Cut minus design in the frame of the part, without what other corrections take care of; grid or scattered.
        cutoff
            Shortest wavelength to correct; of it a half is. Well above the feed, or cusps are taken for form. [mm]
        beyond
            How far outside the clear radius the tool's edge comes: lead-in and the width of the nose. [mm]

        Raises
        ------
        InputError
            If the map holds fewer than 100 heights within the clear radius, or the cutoff does not fit the part.

        >>> from turnwright.heightmap import HeightMap
        >>> from turnwright.surface import Plane
        >>> x = np.linspace(-5, 5, 201)
        >>> bowl = HeightMap(x=x, y=x, z=1e-5 * (x**2 + x[:, None] ** 2))
        >>> part = Part(surface=Plane(slope=(0.0, 0.0)), radius=5.0)
        >>> bool(abs(part.corrected(bowl, cutoff=0.5, beyond=1.0).surface.sag(2.0, 0.0) + 4e-5) < 1e-8)
        True
        """
        smooth = correction_of(self, error, cutoff=cutoff, beyond=beyond)
        return self if smooth.cutoff is None else replace(self, surface=self.surface + smooth.table)


def evenly(part: Part, count: int) -> tuple[Floats, Floats]:
    """Return places evenly over a part, like the seeds of a sunflower: as many on every area. Each (count,) [mm]."""
    number = np.arange(count) + 0.5
    radius, angle = part.radius * np.sqrt(number / count), np.pi * (1 + np.sqrt(5)) * number
    return radius * np.cos(angle), radius * np.sin(angle)


def correction_of(part: Part, error: HeightMap, *, cutoff: float, beyond: float) -> Smooth:
    """Return what to add to a part so that an error that repeats does not come back, and the cutoff that was chosen.

    See `Part.corrected`.
    """
    from turnwright.surface import smooth_table  # noqa: PLC0415 - scipy is costly to import

    error.require_calibrated()
    if not 2 * part.radius / FINEST <= cutoff <= part.radius:
        raise InputError(
            f"cutoff is {cutoff:g} mm, the limits on this part are {2 * part.radius / FINEST:g} to {part.radius:g} "
            "mm: give a wavelength well above the feed"
        )
    x, y = error.points()
    used = ~np.isnan(error.z) & (np.hypot(x, y) <= part.radius)
    if np.count_nonzero(used) < FEWEST:
        raise InputError(
            f"the measured error has {np.count_nonzero(used)} heights within the clear radius {part.radius:g} mm, "
            f"a correction needs {FEWEST}: register the map to the part first, or measure more of it"
        )
    reach = part.radius + positive(beyond, "beyond", "mm") + cutoff
    return smooth_table(x[used], y[used], -error.z[used], cutoff=cutoff, reach=reach)
