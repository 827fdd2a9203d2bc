"""What is asked for: a surface, how far it reaches, and what it is cut from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from turnwright._tables import Stated, read_by
from turnwright._validate import check_numbers, positive
from turnwright.errors import InputError
from turnwright.material import Material
from turnwright.surface import Gridded, Surface
from turnwright.units import Size, Text, Thickness

if TYPE_CHECKING:
    from turnwright._arrays import Floats

__all__ = ["Blank", "Part", "evenly"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Blank(Stated):
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

    radius: Size

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "blank radius", "mm")

    @property
    def reach(self) -> float:
        """Largest distance of any material from the axis. [mm]."""
        return self.radius


@dataclass(frozen=True, slots=True, kw_only=True)
class Part(Stated):
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
        What is cut, as the drawing names it: a known material in any spelling, or the ``.toml`` file of one. Chips and
        ductile regime are judged by it.
    material_note
        Free text on the material: condition, supplier, lot. Nothing is derived from it.
    name
        What the shop calls the part.
    correction
        Heights that are added to the surface that the tool is sent to, as `correct` writes them, so that an error that
        repeats does not come back; the part is judged by its design as before.
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
                f"the blank reaches {self.blank.reach:g} mm from the axis, the limit is the clear radius "
                f"{self.radius:g} mm or more: give the radius of the blank"
            )
        if self.stock < 0:
            raise InputError(f"stock is {self.stock:g} mm, it cannot be below 0 mm: give the thickness to remove")
        self.surface.require_disc(self.radius, "the clear radius")

    @property
    def design(self) -> Part:
        """The part as it was designed, by which everything is judged."""
        return self if self.correction is None else replace(self, correction=None)

    @property
    def aimed(self) -> Part:
        """The part that the tool is sent to: the design with its correction."""
        if self.correction is None:
            return self
        return replace(self, surface=self.surface + self.correction, correction=None)

    @property
    def substance(self) -> Material | None:
        """What is known of the material; ``None`` where nothing is."""
        if self.material.endswith(".toml"):
            return Material.load(self.material)
        named = Material.named(self.material)
        return None if named is None else Material.load(named)

    @property
    def material_name(self) -> str:
        """What the material is called: of one that a file describes, the name in the file."""
        # A path would make the program another one wherever its job lies.
        return self.substance.name if self.substance and self.material.endswith(".toml") else self.material


def evenly(part: Part, count: int) -> tuple[Floats, Floats]:
    """Return places evenly over a part, like the seeds of a sunflower: as many on every area. Each (count,) [mm]."""
    number = np.arange(count) + 0.5
    radius, angle = part.radius * np.sqrt(number / count), np.pi * (1 + np.sqrt(5)) * number
    return radius * np.cos(angle), radius * np.sin(angle)
