"""What is asked for: a surface, how far it reaches, and what it is cut from."""

from __future__ import annotations

from dataclasses import dataclass

from turnwright._arrays import positive
from turnwright.errors import InputError
from turnwright.surface import Surface

__all__ = ["Part"]


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
        What the shop calls the material.
    name
        What the shop calls the part.

    Raises
    ------
    InputError
        If the radius is not positive or the stock is negative.
    DomainError
        If the surface is not defined everywhere inside the clear radius.
    """

    surface: Surface
    radius: float
    stock: float = 0.0
    material: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        positive(self.radius, "part radius", "mm")
        if not self.stock >= 0:
            raise InputError(f"stock is {self.stock:g} mm, it cannot be below 0 mm: give the thickness to remove")
        self.surface.require_disc(self.radius, "the clear radius")
