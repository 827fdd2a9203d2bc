"""Base class of surfaces, and their families in a job file."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, Ints, Value
from turnwright._tables import TableModel, forget_adapters
from turnwright._validate import IN_RAD, check_angle
from turnwright.errors import DomainError
from turnwright.pose import Pose
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

    from turnwright.surface.compound import Placed, Sum

__all__ = ["COSTLIEST", "FAMILIES", "Family", "Lenslets", "Series", "Surface"]

FAMILIES: dict[str, type[Any]] = {}
"""Classes by the ``family`` that a job file names; a class is registered when its module is imported."""

COSTLIEST = 4500
"""Largest cost of a surface per point, in additions; 400 of them with derivatives take about a microsecond."""

CHUNK_POINTS = 1 << 15
"""Points of a costly surface that are evaluated at a time."""

COSTLY = 100
"""Cost per point from which points are evaluated in chunks on all cores."""

PLAIN_COST = 20
"""Cost per point of a surface in closed form, in additions."""


@dataclass(frozen=True, slots=True)
class Series:
    """Keys and units of the coefficients of a formula in a job file.

    Parameters
    ----------
    power
        Function from the key of a coefficient to the power of length in its unit.
    key
        Parser of a key; ``None`` for a list, whose keys count from 0.
    """

    power: Callable[[Any], int]
    key: Callable[[str], Any] | None = None

    def written(self, terms: Iterable[Any]) -> Any:
        """Return coefficients as a table of a job file."""
        if self.key is None:
            return list(terms)
        return {",".join(map(str, key)) if isinstance(key, list | tuple) else str(key): value for key, value in terms}


class Family(TableModel):
    """A family of surfaces in a job file: a class of surfaces, or of files of heights.

    ``series`` names the fields that are coefficients of a formula, ``formula_units`` the unit of a formula that a job
    file must confirm, ``needed`` the required keys whose fields have defaults; ``example`` is an example table;
    ``has_outline`` says whether the surface states the clear aperture of the part.
    """

    __slots__ = ()
    family: ClassVar[str] = ""
    series: ClassVar[Mapping[str, Series]] = {}
    formula_units: ClassVar[str] = ""
    needed: ClassVar[Collection[str]] = ()
    example: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    has_outline: ClassVar[bool] = False

    @classmethod
    def table_keys(cls) -> Mapping[str, Any]:
        """Return the keys that a file may have, with their types."""
        units = {"units": str} if cls.series or cls.formula_units else {}
        return {"family": str, "placed": Pose, **units, **super().table_keys()}

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        if "family" in vars(cls):
            FAMILIES[cls.family] = cls
            forget_adapters()

    @classmethod
    def _build(cls, table: dict[str, Any], build: Callable[[Any], Any], context: Any) -> Any:
        from turnwright.surface.tables import built  # noqa: PLC0415 - only job files need pydantic

        above = super()._build
        return built(cls, table, lambda fields: above(fields, build, context), context)

    @classmethod
    def _written(cls, value: Any, *, whole: bool) -> dict[str, Any]:
        from turnwright.surface.tables import table_of  # noqa: PLC0415 - only job files need pydantic

        return table_of(value, whole=whole)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        from turnwright.surface.tables import json_schema_of  # noqa: PLC0415 - only job files need pydantic

        schema = handler(core)
        if cls.family:
            definition = handler.resolve_ref_schema(schema)
            definition.update(json_schema_of(cls, definition, handler))
        return schema


class Lenslets(NamedTuple):
    """Upright conics with even powers, all alike, by the number of the piece. See `EvenAsphere`."""

    vertices: Floats  # (n, 3) [mm]
    curvature: float  # at the vertex, positive for a concave surface [1/mm]
    conic: float
    coefficients: Floats  # of the powers 0, 2, ... of the distance from the axis


class Surface(Family, Value, ABC):
    """A finished surface z = f(x, y) with the material below it.

    A new family implements `evaluate` and, where the defaults do not hold: `inside` and `domain` (where it is defined),
    `poles` (singular points that sampling may miss), `piece` (where it has slope discontinuities or steps) and
    `feature_size` (the size of its finest structure). A job file can name a family that sets ``family``; its fields
    carry their units, see `Family`.
    """

    __slots__ = ()

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from turnwright.surface.tables import AnySurface  # noqa: PLC0415 - only job files need pydantic

        if cls is Surface:
            return handler.generate_schema(AnySurface)
        return super().__get_pydantic_core_schema__(source, handler)

    @property
    def stated(self) -> Any:
        """The value that a job file describes in place of this one: the ``source`` of heights from a file."""
        return getattr(self, "source", self)

    @abstractmethod
    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its exact derivatives, without checking the domain.

        Parameters
        ----------
        x, y
            Points, contiguous float64 arrays of one shape. [mm]
        order
            0 for (z,), 1 for (z, zx, zy), 2 for (z, zx, zy, zxx, zxy, zyy).

        Returns
        -------
        tuple
            New arrays of the shape of ``x``. [mm, 1, 1/mm] Outside the domain any value, or nan, without a warning.
        """

    def inside(self, x: Floats, y: Floats) -> Bools | None:  # noqa: ARG002
        """Return the mask of points where the surface is defined; ``None`` if it is defined everywhere."""
        return None

    @property
    def domain(self) -> str:
        """The domain of the surface in words."""
        return "the whole plane"

    def piece(self, x: Floats, y: Floats) -> Ints | None:  # noqa: ARG002
        """Return the number of the smooth piece that each point belongs to, or ``None`` if there is only one.

        The height is twice differentiable inside a piece; between pieces it may have a slope discontinuity or a step.
        Pieces are convex: each intersects a straight line in one interval.
        """
        return None

    def border(self, first: Ints, second: Ints, x: Floats, y: Floats) -> Floats:  # noqa: ARG002
        """Return a smooth function that is positive on the side of one piece and negative on that of another. (n,).

        It is zero where the two meet, and nan where no such function is known.

        Parameters
        ----------
        first, second
            Numbers of pieces, see `piece`; negative numbers are none. (n,)
        x, y
            Position on the part. (n,) [mm]
        """
        return np.full(x.shape, np.nan)

    @property
    def lenslets(self) -> Lenslets | None:
        """The conics with even powers that the pieces are, if alike and each that of the nearest vertex, or ``None``.

        They meet without a step then. The number of a piece is the index of its vertex.
        """
        return None

    def sample(self, x: Floats, y: Floats) -> tuple[Floats, Ints | None]:
        """Return the height, nan outside the domain, and the `piece`, which may take less than one after the other."""
        z = self.evaluate(x, y, 0)[0]
        inside = self.inside(x, y)
        if inside is not None:
            z[~inside] = np.nan
        return z, self.piece(x, y)

    @property
    def in_pieces(self) -> bool:
        """Whether the surface has several smooth pieces, like a lens array."""
        return self.piece(np.zeros(1), np.zeros(1)) is not None

    @property
    def convex_pieces(self) -> bool:
        """Whether the surface has several pieces that are certainly convex, so that no line meets one twice."""
        return False

    @property
    def of_revolution(self) -> bool:
        """Whether the surface is known to be one of revolution about the axis."""
        return False

    @property
    def feature_size(self) -> float:
        """Length over which the curvature changes noticeably; sampling must be well below it. [mm]."""
        return float("inf")

    @property
    def cost(self) -> int:
        """Cost of height and derivatives per point, in additions, to about a factor of 2; limited to `COSTLIEST`."""
        return PLAIN_COST

    @property
    def remarks(self) -> tuple[str, ...]:
        """Derived quantities and accuracy of the surface that are not in its prescription; one sentence each."""
        return ()

    def sag(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return the height z = f(x, y).

        Parameters
        ----------
        x, y
            Points, broadcast against each other. [mm]

        Raises
        ------
        DomainError
            If the surface is not defined at a point.
        """
        return self._checked(x, y, 0)[0]

    def gradient(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """Return the slopes (zx, zy). [1]. See `sag`."""
        _, zx, zy = self._checked(x, y, 1)
        return zx, zy

    def hessian(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return the second derivatives (zxx, zxy, zyy). [1/mm]. See `sag`."""
        _, _, _, zxx, zxy, zyy = self._checked(x, y, 2)
        return zxx, zxy, zyy

    def _checked(self, x: ArrayLike, y: ArrayLike, order: int) -> tuple[Floats, ...]:
        x, y = np.asarray(x, dtype=np.float64, order="C"), np.asarray(y, dtype=np.float64, order="C")
        if x.shape != y.shape:
            x, y = (np.array(one, order="C") for one in np.broadcast_arrays(x, y))
        if x.size <= CHUNK_POINTS or not (self.cost >= COSTLY or self.in_pieces):
            inside = self.inside(x, y)
            if inside is not None and not inside.all():
                outside = np.flatnonzero(~inside.ravel())
                raise self._outside(x, y, int(outside[0]), outside.size)
            return self.evaluate(x, y, order)
        flat_x, flat_y = x.ravel(), y.ravel()
        values = np.empty(((order + 1) * (order + 2) // 2, x.size))
        outsides: list[Ints] = []

        def work(start: int, stop: int) -> None:
            part_x, part_y = flat_x[start:stop], flat_y[start:stop]
            inside = self.inside(part_x, part_y)
            if inside is None or inside.all():
                for value, made in zip(values, self.evaluate(part_x, part_y, order), strict=True):
                    value[start:stop] = made
            else:
                outsides.append(start + np.flatnonzero(~inside))

        # Few points at a time stay in the cache of a core. A thread among others starts no further ones.
        is_alone = threading.current_thread() is threading.main_thread()
        run_chunks(work, x.size, CHUNK_POINTS, threads=None if is_alone else 1)
        if outsides:
            first = min(int(points[0]) for points in outsides)
            raise self._outside(x, y, first, sum(points.size for points in outsides))
        return tuple(value.reshape(x.shape) for value in values)

    def _outside(self, x: Floats, y: Floats, first: int, count: int) -> DomainError:
        return DomainError(
            f"{type(self).__name__} is not defined at x = {x.ravel()[first]:.6g} mm, y = {y.ravel()[first]:.6g} mm "
            f"({count} of {x.size} points), its domain is {self.domain}: stay inside it"
        )

    def require_disc(self, radius: float, what: str) -> None:
        """Raise unless the surface is defined everywhere in the disc of ``radius`` except possibly on the axis.

        A formula in the azimuth, such as cos(3 phi), has no height on the axis, but can be cut around it.

        Raises
        ------
        DomainError
            With the place where the surface is not defined.
        """
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        rings = radius * np.linspace(0, 1, 65)[1:]
        x, y = np.outer(rings, np.cos(angle)), np.outer(rings, np.sin(angle))
        inside = self.inside(x, y)
        if inside is not None and not inside.all():
            first = int(np.argmin(inside.all(axis=1)))
            reach, outside = rings[first] - rings[0], rings[first]
            for _ in range(20):
                middle = (reach + outside) / 2
                is_inside = np.all(self.inside(middle * np.cos(angle), middle * np.sin(angle)))
                reach, outside = (middle, outside) if is_inside else (reach, middle)
            raise DomainError(
                f"{what} is {radius:g} mm but {type(self).__name__} is not defined beyond about {reach:.4g} mm "
                f"somewhere around the axis, its domain is {self.domain}: reduce the radius or extend the surface"
            )
        x, y = self.poles(x, y, radius / 16)
        poles = np.flatnonzero(np.hypot(x, y) <= radius)
        if poles.size:
            at_x, at_y = (round(float(at[poles[0]]), 6) + 0.0 for at in (x, y))
            raise DomainError(
                f"{what} is {radius:g} mm but {type(self).__name__} divides by 0 at x = {at_x:g} mm, y = {at_y:g} mm, "
                "where it has no height: reduce the radius or change the surface"
            )

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Return points without a height, such as poles, that sampling may miss.

        Parameters
        ----------
        x, y
            Samples; in each row the search starts from the sample that seems closest to a pole. (m, n) [mm]
        reach
            Distance from the samples within which poles are found; farther ones may be returned too. [mm]

        Returns
        -------
        tuple
            x and y of the poles. (k,) [mm]
        """
        return np.empty(0), np.empty(0)

    def __add__(self, other: Surface) -> Sum:
        from turnwright.surface.compound import Sum  # noqa: PLC0415 - a sum is itself a surface

        return Sum(terms=(self, other))

    def __radd__(self, other: object) -> Surface:
        """Return this surface where `sum` begins with 0."""
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def placed(
        self,
        *,
        shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
        rotation: float = 0.0,
        tilt: tuple[float, float] = (0.0, 0.0),
    ) -> Placed:
        """Return this surface moved in the part frame: tilted, then rotated about z, then shifted.

        Parameters
        ----------
        shift
            New position of its vertex (x, y, z). [mm]
        rotation
            About z, counter-clockwise seen from the tool. [rad]
        tilt
            About its own x axis, then about its own y axis, before the rotation, each within an eighth of a turn; for
            larger tilts see `OffAxis` and `Placed`. [rad]

        Raises
        ------
        InputError
            If a number is not finite or out of range (an angle in degrees often is).
        """
        from turnwright.surface.compound import Placed  # noqa: PLC0415

        for angle in np.atleast_1d(tilt):
            remedy = f"{IN_RAD}; for a piece far from the axis of its parent use OffAxis"
            check_angle(angle, "tilt", -np.pi / 4, np.pi / 4, remedy)
        return Placed(surface=self, shift=shift, rotation=rotation, tilt=tilt)
