"""Lens files: their surfaces, the side that is cut, and the part that a lathe cuts.

Light enters a lens file along +z, and a surface is z = f(x, y) with R > 0 where its centre of curvature is toward +z.
In the part frame z points out of the material. Where the material is toward -z of the surface both frames are one;
where it is toward +z, as at the front of a lens, the part is the lens after half a turn about the y axis, so that its
heights are -f(-x, y). A mere change of sign would cut the mirror image.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np

from turnwright._arrays import Compared, Floats
from turnwright.errors import InputError, quote
from turnwright.files.base import too_high
from turnwright.material import Material
from turnwright.outline import Outline
from turnwright.part import Part, evenly
from turnwright.surface import (
    Conic,
    EvenAsphere,
    Expression,
    Gridded,
    Placed,
    Plane,
    Sphere,
    Sum,
    Surface,
    XYPolynomial,
    Zernike,
    zernike_order,
)

__all__ = [
    "MAX_SURFACES",
    "RIGHT_ANGLE_TOL",
    "UNKNOWN",
    "LensFile",
    "LensPhase",
    "LensSide",
    "LensSurface",
    "Row",
    "Side",
    "finish",
    "plain_text",
    "polynomial_powers",
    "radial",
    "rotation",
    "to_integer",
    "to_number",
    "turned_over",
]

MAX_SURFACES = 2000
"""Surfaces of a lens file; large lenses have a hundred."""

Side: TypeAlias = Literal["before", "after", "+z", "-z"]
"""Side of a surface on which the material of the part is: in the order of the light, or in the lens file's frame."""

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
RIGHT_ANGLE_TOL = 0.1
"""Cosine of a tilt below which the light may go on to either side; glass and fields bend it by some degrees."""

SMALL_TURN = math.cos(math.radians(30.0))
"""Cosine of the largest turn of a frame through which the sign of a thickness still tells where the glass is."""

UNKNOWN = np.full((3, 3), math.nan)
UNKNOWN.flags.writeable = False
"""Rotation of a frame that is not known."""

CHECKED_POINTS = 2000
"""Points of a part at which its heights are checked."""

INFINITE_THICKNESS = 1e10
"""Thickness from which the programs mean an infinite distance, in their unit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensPhase(Compared):
    r"""Phase that a diffractive surface adds, :math:`M \sum_i a_i (r / r_0)^{2i}`.

    Attributes
    ----------
    order
        Diffraction order M.
    radius
        Normalisation radius r0. [mm]
    coefficients
        a_1, a_2, ... [rad]
    """

    order: float
    radius: float
    coefficients: tuple[float, ...]

    def at(self, x: Floats, y: Floats) -> Floats:
        """Return the phase at points in the frame of the lens file. Shape of the points. [rad]."""
        squared = (np.square(x) + np.square(y)) / self.radius**2
        return np.asarray(self.order * squared * np.polynomial.polynomial.polyval(squared, self.coefficients))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensSurface(Compared):
    """One surface of a lens file.

    Attributes
    ----------
    number
        Its number in the file, 0 for the object.
    type
        Its type in the word of the program.
    comment
        Its comment or label.
    radius
        Vertex radius, positive where the centre of curvature is toward +z, inf for a flat. [mm]
    thickness
        Distance along z to the next surface. [mm]
    before, after
        Material on the side that light comes from and on the side it would go on to, "" for air; a mirror has a
        "mirror substrate" behind it.
    index
        Refractive index of the material after it, where the file states one.
    is_mirror, is_stop
        Whether it reflects, and whether it is the aperture stop.
    semi_diameter
        Semi-diameter of the clear aperture, if stated. [mm]
    aperture
        Clear aperture of another shape, or off the axis, in the frame of the lens file.
    heading
        Direction of the light that arrives: +1 toward +z, -1 toward -z, 0 where it is not certain.
    toward_before, toward_after
        Direction of the glass on either side by the sign of its thickness, +1 or -1; 0 where that says nothing.
    limit
        Distance from the axis up to which its Zernike terms are stated, inf where they go on. [mm]
    phase
        Phase of a diffractive surface, whose relief is not part of `surface`.
    fault
        Why the surface cannot be cut; empty if it can.
    shape
        What `surface` returns; ``None`` where it raises.
    """

    number: int
    type: str
    comment: str = ""
    radius: float = math.inf
    thickness: float = 0.0
    before: str = ""
    after: str = ""
    index: float | None = None
    is_mirror: bool = False
    is_stop: bool = False
    semi_diameter: float | None = None
    aperture: Outline | None = None
    heading: int = 1
    toward_before: int = 0
    toward_after: int = 0
    limit: float = math.inf
    phase: LensPhase | None = None
    fault: str = ""
    shape: Surface | None = None

    @property
    def surface(self) -> Surface:
        """The surface z = f(x, y) in the frame of the lens file.

        Raises
        ------
        InputError
            If the file states it in words that are not read, naming surface and word.
        """
        if self.shape is None or self.fault:
            raise InputError(self.fault)
        return self.shape

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the surface has that its sag does not say; one sentence each."""
        sentences = []
        terms = self.shape.terms if isinstance(self.shape, Sum) else (self.shape,)
        if self.phase is not None:
            values = ", ".join(f"{value:.17g}" for value in self.phase.coefficients)
            sentences.append(
                f"surface {self.number} has a diffractive phase of order {self.phase.order:g} with the normalisation "
                f"radius {self.phase.radius:g} mm and the coefficients {values} rad; its relief is not in this part"
            )
        if slope := next((one.constants.get("a1", 0.0) for one in terms if isinstance(one, Expression)), 0.0):
            sentences.append(
                f"surface {self.number} has a crease at its vertex, where its slope changes by {2 * abs(slope):.4g}: "
                "the nose of the tool rounds it"
            )
        if any(isinstance(one, Gridded) for one in terms):
            sentences.append(
                f"surface {self.number} has a table of heights, which a bicubic spline interpolates; between them the "
                f"lens program may differ"
            )
        return tuple(sentences)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensSide(Compared):
    """The side of a surface of a lens file that is cut.

    Attributes
    ----------
    number
        Number of the surface.
    side
        Side of the material in the order of the light, "before" or "after" the surface; "" if that is not certain.
    material
        The material, "" if the file has none there.
    toward
        Direction of the material from the surface, +1 for +z of the lens file, -1 for -z; the tool is on the other
        side.
    """

    number: int
    side: str
    material: str
    toward: int

    @property
    def is_turned(self) -> bool:
        """Whether the part is the lens after half a turn about the y axis."""
        return self.toward > 0

    @property
    def sentence(self) -> str:
        """Orientation of the part in words."""
        material_side, tool_side = ("+z", "-z") if self.is_turned else ("-z", "+z")
        frame = (
            "the part is the lens after half a turn about y: its x and z are -x and -z of the lens file"
            if self.is_turned
            else "the part has the axes of the lens file"
        )
        return (
            f"surface {self.number} is cut into the material {self.side and f'{self.side} it '}"
            f"({self.material or 'none stated'}), which is toward {material_side}; "
            f"the tool comes from {tool_side} of the lens file; {frame}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensFile(Compared):
    """A lens file, as `read_lens` returns it.

    Attributes
    ----------
    name
        Title of the lens, or the name of the file.
    program
        "Zemax" or "CODE V".
    unit
        Unit of length in the file.
    wavelengths
        Wavelengths. [mm]
    primary
        The primary wavelength, ``None`` if the file states none. [mm]
    surfaces
        All surfaces, by number.
    """

    name: str
    program: str
    unit: str
    wavelengths: tuple[float, ...]
    primary: float | None
    surfaces: tuple[LensSurface, ...]

    def surface(self, number: int) -> LensSurface:
        """Return a surface by its number.

        Raises
        ------
        InputError
            If the file has no such surface.
        """
        if not 0 <= number < len(self.surfaces):
            raise InputError(f"{self.name} has the surfaces 0 to {len(self.surfaces) - 1}, not {number}: choose one")
        return self.surfaces[number]

    def side(self, number: int, side: Side | None = None) -> LensSide:
        """Return the side of a surface that is cut; without ``side`` that of its only material.

        A mirror in air is cut into its substrate, behind it in the direction of the light that arrives; one with glass
        before it into that glass.

        Raises
        ------
        InputError
            If the surface has material on both sides, or on none, or the direction of the light is not certain.
        """
        one = self.surface(number)
        named = {"before": one.before, "after": one.after}
        if side is None:
            solid = [name for name, material in named.items() if material]
            if one.is_mirror and one.before:
                solid = ["before"]
            if len(solid) != 1:
                both = f"has {one.before} before and {one.after} after it" if solid else "has air on both sides"
                raise InputError(f"surface {number} {both}: state side='before' or side='after', where the part is")
            side = "before" if solid == ["before"] else "after"
        if side in ("+z", "-z"):
            toward = 1 if side == "+z" else -1
            name = {one.heading: "after", -one.heading: "before"}.get(toward, "")
            return LensSide(number=number, side=name, material=named.get(name, ""), toward=toward)
        if side not in named:
            raise InputError(f"side is {quote(side)}, it must be before, after, +z or -z: choose one")
        toward = one.heading if side == "after" else -one.heading
        if (stated := one.toward_before if side == "before" else one.toward_after) not in (0, toward):
            if toward:
                raise InputError(
                    f"surface {number} has its {named[side]} toward {'+z' if stated > 0 else '-z'} by the sign of its "
                    f"thickness and toward {'+z' if toward > 0 else '-z'} by the light: state side='+z' or "
                    "side='-z', where the part is"
                )
            toward = stated
        if toward == 0:
            raise InputError(
                f"the direction of the light at surface {number} is not certain after tilts, or after words that "
                "are not read: state side='+z' or side='-z', where the part is"
            )
        return LensSide(number=number, side=side, material=named[side], toward=toward)

    def part(self, number: int, side: Side | None = None, *, radius: float | None = None) -> Part:
        """Return a surface as a part: in the part frame, with the clear aperture of the file.

        Parameters
        ----------
        number
            Number of the surface.
        side
            Side on which the material of the part is; without it that of the only material, see `side`.
        radius
            Semi-diameter, in place of the aperture in the file. [mm]

        Raises
        ------
        InputError
            If the surface cannot be cut or its side is not certain, or it has no aperture or too large heights.
        DomainError
            If the surface is not defined in its aperture.
        """
        one = self.surface(number)
        surface, outline = one.surface, None if radius is not None else one.aperture
        chosen = self.side(number, side)
        if radius is None and outline is None:
            radius = one.semi_diameter
            if not radius:
                raise InputError(f"surface {number} states no semi-diameter: state the radius of the part")
        reach = radius if outline is None else outline.reach
        if reach is not None and reach > one.limit * (1 + 1e-9):
            raise InputError(
                f"surface {number} has Zernike terms that end {one.limit:g} mm from the axis (PARM 0 is 0), inside the "
                f"aperture, which reaches {reach:g} mm: let them go on, or state a smaller radius"
            )
        if chosen.is_turned:
            surface = turned_over(surface)
            if outline is not None:
                x, y = outline.centre
                outline = replace(outline, centre=(0.0 - x, y), angle=0.0 - outline.angle)
        glass = "" if one.is_mirror and chosen.side == "after" else chosen.material
        is_listed = Material.named(glass) is not None
        with np.errstate(over="ignore", invalid="ignore"):
            part = Part(
                surface=surface, radius=None if outline is not None else radius, outline=outline,
                material=glass if is_listed else "", material_note="" if is_listed else glass,
                name=f"{self.name} surface {number}",
            )  # fmt: skip
            heights = surface.sag(*evenly(part, CHECKED_POINTS))
        if fault := too_high(np.where(np.isnan(heights), np.inf, heights)):
            raise InputError(f"surface {number} {fault}: check its coefficients and the unit of the file")
        return part


def turned_over(surface: Surface) -> Surface:
    """Return a surface after half a turn about the y axis, -f(-x, y); of the families that lens files have."""
    if isinstance(surface, Sum):
        return Sum(terms=tuple(map(turned_over, surface.terms)))
    if isinstance(surface, Placed):
        (x, y, z), (about_x, about_y) = surface.shift, surface.tilt
        return Placed(
            surface=turned_over(surface.surface),
            shift=(0.0 - x, y, 0.0 - z),
            rotation=0.0 - surface.rotation,
            tilt=(0.0 - about_x, about_y),
        )
    if isinstance(surface, Plane):
        return Plane(slope=(surface.slope[0], 0.0 - surface.slope[1]))
    if isinstance(surface, Gridded):
        return Gridded(x=-surface.x[::-1], y=surface.y, z=-surface.z[:, ::-1])
    if isinstance(surface, Expression):  # in the distance from the axis
        return replace(surface, constants={name: -value for name, value in surface.constants.items()})
    changes: dict[str, Any] = {
        name: -value if math.isfinite(value) else value
        for name in ("radius", "radius_x", "radius_y")
        if (value := getattr(surface, name, None)) is not None and not isinstance(surface, Zernike)
    }
    if hasattr(surface, "terms"):
        changes["terms"] = tuple((key, -_mirrored(surface, key) * value) for key, value in surface.terms)
    return replace(surface, **changes)  # type: ignore[type-var]


def _mirrored(surface: Surface, key: Any) -> float:
    """Return the sign that a term takes on where x is replaced by -x."""
    if isinstance(surface, XYPolynomial):
        return -1.0 if key[0] % 2 else 1.0
    if isinstance(surface, Zernike):
        _, m = zernike_order(key, surface.indexing)
        return (-1.0 if m % 2 else 1.0) * (1.0 if m >= 0 else -1.0)
    return 1.0


def radial(radius: float, conic: float, terms: Mapping[int, float]) -> Surface:
    """Return a conic with powers of the distance from the axis. [mm]."""
    even = {power: value for power, value in terms.items() if value and power % 2 == 0}
    odd = {power: value for power, value in terms.items() if value and power % 2}
    if even:
        base: Surface = EvenAsphere(radius=radius, conic=conic, terms=even)
    elif math.isinf(radius):
        base = Plane()
    else:
        base = Conic(radius=radius, conic=conic) if conic else Sphere(radius=radius)
    if not odd:
        return base
    formula = " + ".join(f"a{power} * rho**{power}" for power in sorted(odd))
    return base + Expression(formula, constants={f"a{power}": value for power, value in odd.items()})


def polynomial_powers(place: int) -> tuple[int, int]:
    """Return the powers of x and y of a term, counted from 0: 1, x, y, x^2, xy, y^2, x^3, ..."""
    degree = (math.isqrt(8 * place + 1) - 1) // 2
    j = place - degree * (degree + 1) // 2
    return degree - j, j


def plain_text(text: str) -> str:
    """Return text of a lens file without quotation marks and unprintable characters, shortened."""
    printable = "".join(letter if letter.isprintable() else " " for letter in text[:400])
    return " ".join(printable.split()).strip("'\" ")[:200]


def to_integer(word: str, where: str) -> int:
    """Return the whole number that a word of a lens file states."""
    if word.isascii() and word.isdigit() and len(word) <= 6:
        return int(word)
    raise InputError(f"{where} is {quote(word)}, it must be a whole number: correct the file")


def to_number(word: str, where: str) -> float:
    """Return the number that a word of a lens file states."""
    if NUMBER.fullmatch(word) and math.isfinite(value := float(word.upper().replace("D", "E"))):
        return value
    raise InputError(f"{where} is {quote(word)}, it must be a number: correct the file")


def rotation(*degrees: float) -> Floats:
    """Return the rotation about x, then about the new y, then about the new z. (3, 3)."""
    turned = np.eye(3)
    for (i, j), angle in zip(((1, 2), (2, 0), (0, 1)), np.radians(degrees), strict=True):
        one = np.eye(3)
        one[[i, j], [i, j]] = np.cos(angle)
        one[i, j], one[j, i] = -np.sin(angle), np.sin(angle)
        turned = turned @ one
    return turned


@dataclass(slots=True)
class Row:
    """One surface while it is read: its words, by which `LensSurface` is made.

    ``enter`` turns the frame of the surface before it into its own, unless it ``returns`` to an earlier one, and
    ``leave`` its own into the one in which its thickness is stated.
    """

    number: int
    type: str = ""
    comment: str = ""
    radius: float = math.inf
    conic: float = 0.0
    thickness: float = 0.0
    glass: str = ""
    index: float | None = None
    is_mirror: bool = False
    is_stop: bool = False
    semi_diameter: float | None = None
    aperture: Callable[[], Outline | None] | None = None
    enter: Floats = field(default_factory=partial(np.eye, 3))
    leave: Floats = field(default_factory=partial(np.eye, 3))
    returns: int | None = None
    is_decentred: bool = False
    scatters: bool = False  # whether it is not known where the light goes on to
    passes: bool = False
    limit: float = math.inf
    phase: LensPhase | None = None
    fault: str = ""

    def refuse(self, reason: str) -> None:
        """Keep the first reason for which the surface cannot be cut."""
        self.fault = self.fault or f"surface {self.number} {reason}"

    def doubt(self, reason: str) -> None:
        """Refuse the surface for words that may also turn the frame or the light."""
        self.refuse(reason)
        self.enter, self.leave, self.returns = UNKNOWN, UNKNOWN, None


def toward(along: Floats, least: float = RIGHT_ANGLE_TOL) -> int:
    """Return the side of a surface to which a direction goes by its cosine to z; 0 below the ``least``, or for nan."""
    return int(np.sign(along)) if abs(along) >= least else 0


@dataclass(slots=True)
class _Light:
    """The axial ray, and the frame of the surfaces that it meets, both in the frame of the file.

    While the light meets flat mirrors only, the axial ray is exact. Where a lens has tilts or decentres and curved
    surfaces or glass, the light leaves it; then it must agree with light that arrives along the axis at every tilt.
    A curved mirror that is used where it is steep turns the light to another side than the axial ray.
    """

    frame: Floats = field(default_factory=partial(np.eye, 3))
    ray: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    heading: int = 1
    is_tilted: bool = False
    bends: bool = False
    is_doubtful: bool = False  # whether the next thickness must confirm the direction
    frames: list[Floats] = field(default_factory=list)

    @property
    def runs_across(self) -> bool:
        """Whether the axial ray is known to be near a right angle to z, where the sign of a thickness tells nothing."""
        return bool(abs(self.ray @ self.frame[:, 2]) < RIGHT_ANGLE_TOL)

    def arrive(self, row: Row) -> int:
        """Return the sign at the next surface of a direction that is along z at the last one; set ``heading``."""
        frame = self.frame @ row.enter if row.returns is None else self.frames[row.returns]
        cosine = row.enter[2, 2] if row.returns is None else self.frame[:, 2] @ frame[:, 2]
        direction = toward(cosine)
        self.is_tilted |= row.is_decentred or not np.array_equal(frame, self.frame)
        self.frame = frame
        self.frames.append(frame)
        along = toward(self.ray @ frame[:, 2])
        is_exact = not (self.is_tilted and self.bends)
        self.heading = along if is_exact or along == direction * self.heading else 0
        return toward(cosine, SMALL_TURN)

    def leave(self, row: Row, *, bends: bool) -> None:
        """Go on from a surface, in the frame of its thickness."""
        normal = self.frame[:, 2]
        if row.is_mirror:
            self.ray = self.ray - 2 * (self.ray @ normal) * normal
            self.heading = -self.heading
        if row.scatters:
            self.ray = self.ray * math.nan
        self.bends |= bends
        self.frame = self.frame @ row.leave
        self.heading *= toward(row.leave[2, 2])
        self.is_doubtful |= row.is_mirror and bends
        if self.is_doubtful and row.thickness:
            self.is_doubtful = False
            if self.heading == -np.sign(row.thickness):
                self.ray, self.heading = self.ray * math.nan, 0
        self.is_tilted |= not np.array_equal(self.frame, self.frames[-1])


def _is_steep(surface: Surface, outline: Outline | None) -> bool:
    """Whether a mirror that is used off its axis turns the light there to another side than at its vertex."""
    if outline is None:
        return False
    x, y = outline.centre
    middle, angle = (outline.nearest + outline.reach) / 2, math.atan2(y, x)
    with np.errstate(all="ignore"):
        _, *slopes = surface.evaluate(np.array([middle * math.cos(angle)]), np.array([middle * math.sin(angle)]), 1)
    return not np.hypot(*slopes) <= 1.0  # nan beyond its edge


def finish(rows: Iterable[Row], scale: float, build: Callable[[Row], Surface]) -> tuple[LensSurface, ...]:
    """Return the surfaces with the media on both sides and the direction of the light. ``scale`` is a unit in mm."""
    surfaces = []
    medium, light, before_toward = "", _Light(), 0
    for row in rows:
        before = medium
        aperture = shape = None
        if not row.fault:
            try:
                shape = build(row)
                aperture = row.aperture() if row.aperture else None
            except InputError as error:
                row.fault = f"surface {row.number}: {error}"
            except ArithmeticError:
                row.refuse("has a number that is too large or too small to compute with: correct the file")
        before_toward *= light.arrive(row)
        heading, runs_across = light.heading, light.runs_across
        if not (row.is_mirror or row.passes):
            medium = row.glass
        is_flat = isinstance(shape, Plane) and row.phase is None
        row.scatters |= row.is_mirror and shape is not None and _is_steep(shape, aperture)
        light.leave(row, bends=medium != before or (row.is_mirror and not is_flat))
        onward = int(np.sign(row.thickness)) * (not light.runs_across)
        toward_after = onward * toward(row.leave[2, 2], SMALL_TURN)
        surfaces.append(
            LensSurface(
                number=row.number, type=row.type, comment=row.comment,
                radius=row.radius * scale,
                thickness=math.inf if abs(row.thickness) >= INFINITE_THICKNESS else row.thickness * scale,
                before=before, after="mirror substrate" if row.is_mirror else medium,
                index=row.index, is_mirror=row.is_mirror, is_stop=row.is_stop, aperture=aperture, heading=heading,
                toward_before=before_toward if before and not runs_across else 0,
                toward_after=toward_after if medium and not (row.is_mirror or runs_across) else 0,
                semi_diameter=None if row.semi_diameter is None else row.semi_diameter * scale,
                limit=row.limit, phase=row.phase, fault=row.fault, shape=None if row.fault else shape,
            )
        )  # fmt: skip
        before_toward = -onward if np.isfinite(row.leave).all() else 0
    return tuple(surfaces)
