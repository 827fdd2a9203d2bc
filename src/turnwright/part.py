"""The part: nominal surface, outline, material, stock and blank."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright._tables import TableModel, read_by
from turnwright._validate import check_numbers, positive
from turnwright.chuck import Assembled, Chuck
from turnwright.errors import DomainError, InputError
from turnwright.heightmap import HeightMap
from turnwright.material import Material
from turnwright.outline import Outline
from turnwright.outlined import Bounded, Continued
from turnwright.surface import Gridded, Surface
from turnwright.units import Size, Text, Thickness, say_length

__all__ = ["OVERLAP_FEEDS", "OVERLAP_MM", "Blank", "Part", "evenly"]

OVERLAP_MM = 0.05
"""Distance outside the outline to which the tool cuts: more than the errors of a machine and the setting of a tool."""

RING_SAMPLES, RING_MARGIN_MM = (64, 256), 1.0
"""Radii and azimuths at which a surface is compared with its continuation, and how far beyond the ring. [mm]"""

OVERLAP_FEEDS = 1.5
"""Additional distance in feeds: the neighbouring revolutions form the surface up to half a feed from a contact."""

OUTLINE_SAMPLES, GRID_SAMPLES, POLE_COLUMNS = 2000, 201, 16
"""Samples along an outline, and along each side of its box, where the surface must be defined; and those of a row in
which poles are searched."""

TOP_SAMPLES, TOP_TOL_MM = 4000, 1e-6
"""Points at which the top of a blank is compared with the finished surface, and what is rounding."""

MAX_DENSITY = 1000
"""Largest number of points of the disc for each point of the part; an outline with less area gets fewer points."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Blank(TableModel):
    """The blank of a part: a disc on the spindle axis.

    Unless its top is stated, that is the part's stock above the finished surface. Beyond the clear aperture it then
    continues at the slope of the rim where that rises outward, and level where it falls.

    Parameters
    ----------
    radius
        Largest distance of material from the axis, runout included. [mm]
    surface
        Top of the blank in the frame of the part, such as a plane, a sphere or a measured map; roughing passes cut only
        where it stands above them.

    Raises
    ------
    InputError
        If the radius is not positive.
    DomainError
        If the top is not defined out to the radius.
    """

    radius: Size
    surface: Surface | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "blank radius", "mm")
        if self.surface is not None:
            self.surface.require_disc(self.radius, "the radius of the blank")

    @property
    def reach(self) -> float:
        """Largest distance of material from the axis. [mm]."""
        return self.radius

    def top(self, x: Floats, y: Floats) -> Floats:
        """Return the heights of its stated top, held beyond its radius. Shape of the points. [mm]."""
        assert self.surface is not None  # noqa: S101 - for the type checker
        reach = self.radius * (1 - 1e-12)
        held = reach / np.maximum(np.hypot(x, y), reach)
        return np.asarray(self.surface.sag(x * held, y * held))


@dataclass(frozen=True, slots=True, kw_only=True)
class Part(TableModel):
    """A part to be cut.

    Parameters
    ----------
    surface
        The finished surface z = f(x, y), with the vertex at the origin and the spindle along z.
    radius
        Semi-diameter of the clear aperture, for a disc on the axis. [mm]
    outline
        Clear aperture of any other shape, in place of ``radius``; a chuck has those of its parts.
    air_clearance
        Height above the stock at which the tool crosses air outside the outline. [mm]
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
        If not exactly one of radius and outline is given, the radius is not positive, the stock is negative, or the
        blank is smaller than the part, below it, or higher than the stock.
    DomainError
        If the surface is not defined everywhere in the clear aperture.
    """

    surface: Surface
    radius: Size | None = None
    outline: Outline | None = None
    air_clearance: Size = 0.1
    stock: Thickness = 0.0
    material: Annotated[str, read_by("material")] = ""
    material_note: Text = ""
    name: Text = ""
    correction: Annotated[Gridded | None, read_by("correction")] = None
    blank: Blank | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        if isinstance(self.surface, Chuck):
            self._check_chuck(self.surface)
        elif isinstance(getattr(self.surface, "surface", None), Chuck) and not isinstance(self.surface, Continued):
            raise InputError("a chuck is placed as a whole: state the position and clocking of its parts")
        if (self.radius is None) == (self.outline is None):
            raise InputError(
                f"the part has {'neither radius nor' if self.outline is None else 'both radius and'} outline, it needs "
                "one of them: radius for a disc on the axis, outline for any other clear aperture"
            )
        if self.radius is not None:
            positive(self.radius, "part radius", "mm")
        positive(self.air_clearance, "air_clearance", "mm")
        if self.blank is not None and self.blank.reach < self.reach:
            raise InputError(
                f"the blank reaches {self.blank.reach:g} mm from the axis, it must reach at least as far as the "
                f"clear aperture, {self.reach:g} mm: give the radius of the blank"
            )
        if self.stock < 0:
            raise InputError(f"stock is {self.stock:g} mm, it cannot be below 0 mm: give the thickness to remove")
        self._require_defined()
        if self.shaped_blank is not None:
            self._check_top()

    def _check_top(self) -> None:
        """Raise unless the top of the blank is between the finished surface and the stock above it."""
        x, y = (np.append(*columns) for columns in zip(evenly(self, TOP_SAMPLES), self._rim_points, strict=True))
        above = self.thickness(x, y)
        low, high = int(above.argmin()), int(above.argmax())
        if above[low] < -TOP_TOL_MM:
            raise InputError(
                f"the blank is {say_length(-float(above[low]))} below the finished surface at x = {x[low]:.4g} mm, y = "
                f"{y[low]:.4g} mm, it must be above it: raise its surface, or correct that of the part"
            )
        if above[high] > self.stock + TOP_TOL_MM:
            raise InputError(
                f"the blank is {say_length(float(above[high]))} above the finished surface at x = {x[high]:.4g} mm, "
                f"y = {y[high]:.4g} mm, the stock is {say_length(self.stock)}: state the largest thickness as stock"
            )

    def _require_defined(self) -> None:
        """Raise unless the surface is defined everywhere in the clear aperture."""
        if self.outline is None:
            self.surface.require_disc(self.reach, "the radius of the clear aperture")
        elif isinstance(self.surface, Chuck):
            for one in self.surface.parts:
                try:
                    _require_on(one.placed, one.border)
                except DomainError as error:
                    raise DomainError(f"the part {one.name!r} of the chuck: {error}") from error
        else:
            _require_on(self.surface, self.outline)

    def _check_chuck(self, chuck: Chuck) -> None:
        """Take over the outlines of a chuck; raise if the part states others, or a correction."""
        if self.radius is not None or self.outline not in (None, chuck.outline):
            raise InputError(
                "the part states a radius or an outline, its surface is a chuck: state outlines there only"
            )
        if self.correction is not None:
            raise InputError("the part states a correction, its surface is a chuck: state it at the part of the chuck")
        object.__setattr__(self, "outline", chuck.outline)

    @property
    def unstated(self) -> Collection[str]:
        """The outline of a chuck, which its parts state."""
        return ("outline",) if isinstance(self.surface, Chuck) else ()

    def alone(self, name: str) -> Part:
        """Return one part of a chuck, at its place there.

        Raises
        ------
        InputError
            If this is no chuck, or it has no part of this name.
        """
        if not isinstance(self.surface, Chuck):
            raise InputError(f"the surface is no chuck, so it has no part {name[:40]!r}: leave the name out")
        one = self.surface.mounted(name)
        return replace(self, surface=one.placed, outline=one.border, correction=one.correction, name=name)

    @property
    def apart(self) -> tuple[Part, ...]:
        """The parts of a chuck, each with its own surface only; this part if it is none."""
        surface = self.surface.surface if isinstance(self.surface, Continued) else self.surface
        if not isinstance(surface, Assembled):
            return (self,)
        return tuple(
            replace(self, surface=one, outline=outline, name=name)
            for one, outline, name in zip(surface.surfaces, surface.outlines, surface.names, strict=True)
        )

    @property
    def border(self) -> Outline:
        """The outline, that of a disc included."""
        return Outline(disc=self.radius) if self.outline is None else self.outline

    @property
    def reach(self) -> float:
        """Largest distance of the clear aperture from the axis. [mm]."""
        return self.border.reach if self.radius is None else self.radius

    @property
    def nearest(self) -> float:
        """Smallest distance of the clear aperture from the axis. [mm]."""
        return 0.0 if self.outline is None else self.outline.nearest

    @property
    def rim_stock(self) -> float:
        """Thickness of material at the rim before the first pass. [mm]."""
        return self.stock if self.shaped_blank is None else float(self.thickness(*self._rim_points).max())

    @property
    def _rim_points(self) -> tuple[Floats, Floats]:
        """Points just within the border. Each (n,) [mm]."""
        x, y = self.border.border(OUTLINE_SAMPLES)
        return x * (1 - 1e-9), y * (1 - 1e-9)

    @property
    def shaped_blank(self) -> Blank | None:
        """The blank if its top is stated."""
        return None if self.blank is None or self.blank.surface is None else self.blank

    def thickness(self, x: Floats, y: Floats) -> Floats:
        """Return the thickness of material under a stated top of the blank. Shape of the points. [mm]."""
        assert self.shaped_blank is not None  # noqa: S101 - for the type checker
        return np.asarray(self.shaped_blank.top(x, y) - self.surface.sag(x, y))

    @property
    def turned_share(self) -> float:
        """Share of a spiral over the radii of the part that is on the part, to about 1 %."""
        if not self.leaves_air:
            return 1.0
        radius, angle = np.meshgrid(
            np.linspace(self.nearest, self.reach, RING_SAMPLES[0] * 4), np.linspace(0, 2 * np.pi, RING_SAMPLES[1] * 4)
        )
        return float(self.covers(radius * np.cos(angle), radius * np.sin(angle)).mean())

    @property
    def leaves_air(self) -> bool:
        """Whether the tool crosses air within a revolution: the outline is not a disc or an annulus on the axis."""
        return self.outline is not None and not self.outline.is_centred

    def covers(self, x: Floats, y: Floats) -> Bools:
        """Return the mask of points on the clear aperture."""
        if self.radius is not None:
            return np.asarray(np.hypot(x, y) <= self.radius)
        return self.border.covers(x, y)

    def heights(self, x: Floats, y: Floats) -> Floats:
        """Return the finished heights of points, nan outside the clear aperture. [mm]."""
        on = self.covers(x, y)
        z = np.full(np.shape(x), np.nan)
        z[on] = self.surface.sag(x[on], y[on])
        return z

    def crop(self, made: HeightMap) -> HeightMap:
        """Return a map without its heights outside the outline; that of a disc as it is."""
        if self.outline is None:
            return made
        return replace(made, z=np.where(self.covers(*made.points()), made.z, np.nan))

    def finished(self, made: HeightMap) -> HeightMap:
        """Return the finished surface on the grid of a map, nan where that is, and outside an outline."""
        if self.outline is not None:
            return replace(made, z=self.heights(*made.points()))
        return made.of_surface(self.surface)

    def form_error(self, made: HeightMap) -> HeightMap:
        """Return a map minus the finished surface, nan outside an outline; a disc is evaluated wherever the map is."""
        return made.minus(self.finished(made))

    @property
    def design(self) -> Part:
        """The part without its correction, from which form errors are measured."""
        return self if self.correction is None else replace(self, correction=None)

    @property
    def aimed(self) -> Part:
        """The part that the tool path is planned for: the design with its correction added."""
        if isinstance(self.surface, Chuck) and (aimed := self.surface.aimed) is not self.surface:
            return replace(self, surface=aimed).continued
        if self.correction is None:
            return self.continued
        return replace(self, surface=self.surface + self.correction, correction=None).continued

    def bounded(self, margin: float) -> Part:
        """Return the part with its surface defined only within a margin of its outline; a disc as it is. [mm]."""
        if self.outline is None:
            return self
        return replace(self, surface=Bounded(surface=self.surface, outline=self.outline, margin=margin))

    @property
    def continued(self) -> Part:
        """The part with its surface continued outside its outline, where its prescription does not serve there."""
        surface = self.continuation
        return self if surface is self.surface else replace(self, surface=surface)

    @property
    def continuation(self) -> Surface:
        """The surface of `continued`."""
        surface, outline = self.surface, self.outline
        if (
            outline is None
            or isinstance(surface, Continued)
            or (outline.is_centred and _covers_disc(surface, self.reach))
            or _extends(surface, outline)
        ):
            return surface
        return Continued(surface=surface, outline=outline)

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
    least, total = part.nearest**2, count
    while True:
        number = np.arange(total) + 0.5
        radius, angle = np.sqrt(least + (part.reach**2 - least) * number / total), np.pi * (1 + np.sqrt(5)) * number
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        if part.outline is None:
            return x, y
        on = np.flatnonzero(part.covers(x, y))
        if on.size >= count or total > MAX_DENSITY * count:
            few = on[:: max(on.size // count, 1)]
            return x[few], y[few]
        total = min(int(total * 1.05 * count / max(on.size, 1)) + 1, 4 * total)


@lru_cache(maxsize=64)
def _covers_disc(surface: Surface, radius: float) -> bool:
    """Return whether a surface is defined on the whole disc about the axis."""
    try:
        surface.require_disc(radius, "")
    except DomainError:
        return False
    return True


@lru_cache(maxsize=64)
def _extends(surface: Surface, outline: Outline) -> bool:
    """Return whether a surface is defined on the ring of an outline and varies no more than its continuation."""
    radius = np.linspace(max(outline.nearest - RING_MARGIN_MM, 0.0), outline.reach + RING_MARGIN_MM, RING_SAMPLES[0])
    angle = np.linspace(0, 2 * np.pi, RING_SAMPLES[1], endpoint=False)
    x, y = np.outer(radius, np.cos(angle)).ravel(), np.outer(radius, np.sin(angle)).ravel()
    defined = surface.inside(x, y)
    if defined is not None and not defined.all():
        return False
    with np.errstate(all="ignore"):
        stated, continued = (one.evaluate(x, y, 0)[0] for one in (surface, Continued(surface=surface, outline=outline)))
    return bool(np.ptp(stated) <= np.ptp(continued))


def _require_on(surface: Surface, outline: Outline) -> None:
    """Raise unless the surface is defined everywhere on an outline."""
    x_low, x_high, low, high = outline.box
    x, y = (
        one.ravel()
        for one in np.meshgrid(np.linspace(x_low, x_high, GRID_SAMPLES), np.linspace(low, high, GRID_SAMPLES))
    )
    inside = outline.distance(x, y) < 0
    edge_x, edge_y = outline.border(OUTLINE_SAMPLES)
    x, y = np.append(x[inside], edge_x), np.append(y[inside], edge_y)
    defined = surface.inside(x, y)
    if defined is not None and not defined.all():
        k = int(np.argmin(defined))
        raise DomainError(
            f"the outline includes x = {x[k]:.6g} mm, y = {y[k]:.6g} mm, where {type(surface).__name__} is not "
            f"defined, its domain is {surface.domain}: move or shrink the outline, or extend the surface"
        )
    rows = x.size // POLE_COLUMNS * POLE_COLUMNS
    starts = (one[:rows].reshape(-1, POLE_COLUMNS) for one in (x, y))
    pole_x, pole_y = surface.poles(next(starts), next(starts), outline.reach / 16)
    poles = np.flatnonzero(outline.covers(pole_x, pole_y) & (np.hypot(pole_x, pole_y) > 0))
    if poles.size:
        raise DomainError(
            f"the outline includes x = {pole_x[poles[0]]:g} mm, y = {pole_y[poles[0]]:g} mm, where "
            f"{type(surface).__name__} divides by 0 and has no height: move the outline or change the surface"
        )
