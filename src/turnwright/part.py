"""The part: nominal surface, clear aperture, material, stock and blank."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from turnwright._arrays import Floats
from turnwright._tables import TableModel, read_by
from turnwright._validate import check_numbers, positive
from turnwright.errors import InputError
from turnwright.material import Material
from turnwright.surface import Gridded, Surface
from turnwright.units import Size, Text, Thickness

__all__ = ["Blank", "Part", "evenly"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Blank(TableModel):
    """The blank of a part: a disc on the spindle axis.

    Its top is the part's stock above the finished surface. Beyond the clear aperture it continues at
    the slope of the rim where that rises outward, and level where it falls.

    Parameters
    ----------
    radius
        Largest distance of material from the axis, runout included. [mm]

    Raises
    ------
    InputError
        If the radius is not positive.
    """

    radius: Size

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "blank radius", "mm")

    @property
    def reach(self) -> float:
        """Largest distance of material from the axis. [mm]."""
        return self.radius


@dataclass(frozen=True, slots=True, kw_only=True)
class Part(TableModel):
    """A part to be cut.

    Parameters
    ----------
    surface
        The finished surface z = f(x, y), with the vertex at the origin and the spindle along z.
    radius
        Semi-diameter of the clear aperture. [mm]
    stock
        Thickness of material above the finished surface before the first pass. [mm]
    material
        Name of the material in any spelling, or the ``.toml`` file of one. Uncut chip thickness and ductile regime are
        checked against it.
    material_note
        Free text on the material: condition, supplier, lot. Nothing is derived from it.
    name
        Name of the part.
    correction
        Heights added to the surface for the tool path, as `correct` writes them, to cancel a repeatable form error.
        The form error is still measured from the design.
    blank
        The blank; ``None`` if not known. Material is then assumed wherever the tool goes, so that every pass begins
        with a plunge.

    Raises
    ------
    InputError
        If the radius is not positive, the stock is negative, or the blank is smaller than the part.
    DomainError
        If the surface is not defined everywhere in the clear aperture.
    """

    surface: Surface
    radius: Size
    stock: Thickness = 0.0
    material: Annotated[str, read_by("material")] = ""
    material_note: Text = ""
    name: Text = ""
    correction: Annotated[Gridded | None, read_by("correction")] = None
    blank: Blank | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "part radius", "mm")
        if self.blank is not None and self.blank.reach < self.radius:
            raise InputError(
                f"the blank reaches {self.blank.reach:g} mm from the axis, it must reach at least the radius of the "
                f"clear aperture, {self.radius:g} mm: give the radius of the blank"
            )
        if self.stock < 0:
            raise InputError(f"stock is {self.stock:g} mm, it cannot be below 0 mm: give the thickness to remove")
        self.surface.require_disc(self.radius, "the radius of the clear aperture")

    @property
    def design(self) -> Part:
        """The part without its correction, from which form errors are measured."""
        return self if self.correction is None else replace(self, correction=None)

    @property
    def aimed(self) -> Part:
        """The part that the tool path is planned for: the design with its correction added."""
        if self.correction is None:
            return self
        return replace(self, surface=self.surface + self.correction, correction=None)

    @property
    def substance(self) -> Material | None:
        """The `Material`; ``None`` if its name is not known."""
        if self.material.endswith(".toml"):
            return Material.load(self.material)
        named = Material.named(self.material)
        return None if named is None else Material.load(named)

    @property
    def material_name(self) -> str:
        """Name of the material; for a material file, the name in that file."""
        # With the path of the file the program would depend on where its job is stored.
        return self.substance.name if self.substance and self.material.endswith(".toml") else self.material


def evenly(part: Part, count: int) -> tuple[Floats, Floats]:
    """Return points of equal density over a part (a Fibonacci, or sunflower, lattice). Each (count,) [mm]."""
    number = np.arange(count) + 0.5
    radius, angle = part.radius * np.sqrt(number / count), np.pi * (1 + np.sqrt(5)) * number
    return radius * np.cos(angle), radius * np.sin(angle)
