"""What every prescription can do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, Ints, Value
from turnwright._tables import Stated, forget_adapters
from turnwright._validate import IN_RAD, check_angle
from turnwright.errors import DomainError
from turnwright.pose import Pose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

    from turnwright.surface.compound import Placed, Sum

__all__ = ["COSTLIEST", "FAMILIES", "Family", "Series", "Surface"]

FAMILIES: dict[str, type[Any]] = {}
"""What a job file can name as a ``family``: each class that states one, as soon as its module is imported."""

COSTLIEST = 4500
"""Additions that a surface may cost at a point; a microsecond takes about 400 of them, with their derivatives."""

PLAIN_COST = 20
"""Additions that a surface in closed form costs at a point."""


@dataclass(frozen=True, slots=True)
class Series:
    """How a job file names the coefficients of a formula, and in which unit each is.

    Parameters
    ----------
    power
        The power of length that a coefficient has, by its key.
    key
        Reads the text of a key; ``None`` for a list, whose keys count from 0.
    """

    power: Callable[[Any], int]
    key: Callable[[str], Any] | None = None

    def written(self, terms: Iterable[Any]) -> Any:
        """Return coefficients as a table of a job file."""
        if self.key is None:
            return list(terms)
        return {",".join(map(str, key)) if isinstance(key, list | tuple) else str(key): value for key, value in terms}


class Family(Stated):
    """What a job file can name as the ``family`` of a surface: a surface, or the file of its heights.

    ``series`` says which fields are coefficients of a formula, ``formula_units`` in which unit a formula is that a job
    file must confirm, ``needed`` which keys it must state though their fields have defaults, ``example`` how it may do
    so.
    """

    __slots__ = ()
    family: ClassVar[str] = ""
    series: ClassVar[Mapping[str, Series]] = {}
    formula_units: ClassVar[str] = ""
    needed: ClassVar[Collection[str]] = ()
    example: ClassVar[Mapping[str, Any]] = MappingProxyType({})

    @classmethod
    def table_keys(cls) -> Mapping[str, Any]:
        """Return the keys that a file can state, with their types."""
        units = {"units": str} if cls.series or cls.formula_units else {}
        return {"family": str, "placed": Pose, **units, **super().table_keys()}

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        if "family" in vars(cls):
            FAMILIES[cls.family] = cls
            forget_adapters()

    @classmethod
    def _build(cls, table: dict[str, Any], build: Callable[[Any], Any], context: Any) -> Any:
        from turnwright.surface.stated import built  # noqa: PLC0415 - only job files need pydantic

        above = super()._build
        return built(cls, table, lambda fields: above(fields, build, context), context)

    @classmethod
    def _written(cls, value: Any, *, whole: bool) -> dict[str, Any]:
        from turnwright.surface.stated import table_of  # noqa: PLC0415 - only job files need pydantic

        return table_of(value, whole=whole)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        from turnwright.surface.stated import json_schema_of  # noqa: PLC0415 - only job files need pydantic

        found = handler(core)
        if cls.family:
            place = handler.resolve_ref_schema(found)
            place.update(json_schema_of(cls, place, handler))
        return found


class Surface(Family, Value, ABC):
    """A finished surface z = f(x, y), material below it.

    A new family implements `evaluate`, and where they are not the default: `inside` and `domain` (where it is
    defined), `poles` (where samples may miss that it is not), `piece` (where it has kinks or steps) and `feature_size`
    (how fine its structure is). A job file can state a family that has a name in ``family``: its fields carry their
    units, see `Family`.
    """

    __slots__ = ()

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from turnwright.surface.stated import AnySurface  # noqa: PLC0415 - only job files need pydantic

        if cls is Surface:
            return handler.generate_schema(AnySurface)
        return super().__get_pydantic_core_schema__(source, handler)

    @property
    def stated(self) -> Any:
        """What a job file states in place of it: a file for heights that were read from one."""
        return self

    @abstractmethod
    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its exact derivatives, without looking at the domain.

        Parameters
        ----------
        x, y
            Points, contiguous float64 arrays of one shape. [mm]
        order
            0 for (z,), 1 for (z, zx, zy), 2 for (z, zx, zy, zxx, zxy, zyy).

        Returns
        -------
        tuple
            Fresh arrays of the shape of ``x``. [mm, 1, 1/mm] Outside the domain anything, or nan, without a warning.
        """

    def inside(self, x: Floats, y: Floats) -> Bools | None:  # noqa: ARG002
        """Return where the surface is defined, or ``None`` if it is everywhere."""
        return None

    @property
    def domain(self) -> str:
        """Say in words where the surface is defined."""
        return "the whole plane"

    def piece(self, x: Floats, y: Floats) -> Ints | None:  # noqa: ARG002
        """Return the number of the smooth piece that each point belongs to, or ``None`` if all is one piece.

        The height is twice differentiable inside a piece; between pieces it may have a kink or a step. A piece cuts
        a straight line in one interval (its cells are convex).
        """
        return None

    @property
    def in_pieces(self) -> bool:
        """Whether it has kinks or steps, as a lens array has."""
        return self.piece(np.zeros(1), np.zeros(1)) is not None

    @property
    def feature_size(self) -> float:
        """Length over which the curvature changes noticeably; the step of a search must be well below it. [mm]."""
        return float("inf")

    @property
    def cost(self) -> int:
        """Height and derivatives at a point in additions, to about a factor of 2; `COSTLIEST` is the limit."""
        return PLAIN_COST

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was worked out for the surface, or is known of its accuracy, and nobody stated; a sentence each."""
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
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        x, y = np.asarray(x, order="C"), np.asarray(y, order="C")  # a number stays a number
        inside = self.inside(x, y)
        if inside is not None and not inside.all():
            first = np.flatnonzero(~inside.ravel())[0]
            raise DomainError(
                f"{type(self).__name__} is not defined at x = {x.ravel()[first]:.6g} mm, y = {y.ravel()[first]:.6g} mm "
                f"({np.count_nonzero(~inside)} of {x.size} points), its domain is {self.domain}: stay inside it"
            )
        return self.evaluate(x, y, order)

    def require_disc(self, radius: float, what: str) -> None:
        """Raise unless the surface is defined all over the disc of ``radius``; the axis alone may be missing.

        A formula in the azimuth, such as cos(3 phi), has no height on the axis and is cut everywhere around it.

        Raises
        ------
        DomainError
            With the part of the disc that is missing.
        """
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        rings = radius * np.linspace(0, 1, 65)[1:]
        x, y = np.outer(rings, np.cos(angle)), np.outer(rings, np.sin(angle))
        inside = self.inside(x, y)
        if inside is not None and not inside.all():
            reach = rings[np.argmin(inside.all(axis=1))]
            raise DomainError(
                f"{what} is {radius:g} mm but {type(self).__name__} is not defined beyond about {reach:.4g} mm "
                f"somewhere around the axis, its domain is {self.domain}: reduce the radius or extend the surface"
            )
        x, y = self.poles(x, y, radius / 16)
        shown = np.flatnonzero(np.hypot(x, y) <= radius)
        if shown.size:
            at_x, at_y = (round(float(at[shown[0]]), 6) + 0.0 for at in (x, y))
            raise DomainError(
                f"{what} is {radius:g} mm but {type(self).__name__} divides by 0 at x = {at_x:g} mm, y = {at_y:g} mm, "
                "where it has no height: reduce the radius or change the surface"
            )

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Return places without a height, such as poles, that the points may miss.

        Parameters
        ----------
        x, y
            Points, row by row; each row looks from the one that seems nearest to a pole. (m, n) [mm]
        reach
            How far from the points poles matter; there may be others among those returned. [mm]

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
        """Return this surface itself where `sum` begins with 0."""
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
            Where its vertex goes (x, y, z). [mm]
        rotation
            About z, counter-clockwise seen from the tool. [rad]
        tilt
            About its own x axis, then about its own y axis, before the rotation, each within an eighth of a turn:
            only an off-axis part leans further, see `OffAxis` and `Placed`. [rad]

        Raises
        ------
        InputError
            If a number is not finite or out of its range, as an angle in degrees is.
        """
        from turnwright.surface.compound import Placed  # noqa: PLC0415

        for lean in np.atleast_1d(tilt):
            remedy = f"{IN_RAD}; for a piece far from the axis of its parent use OffAxis"
            check_angle(lean, "tilt", -np.pi / 4, np.pi / 4, remedy)
        return Placed(surface=self, shift=shift, rotation=rotation, tilt=tilt)
