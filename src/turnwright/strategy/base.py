"""The base class of the strategies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args, get_origin

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._tables import TableModel, forget_adapters, types_of, write_table, written_by
from turnwright._validate import check_numbers, one_of, positive
from turnwright.chuck import Chuck
from turnwright.errors import InputError
from turnwright.machine import Machine
from turnwright.part import Part
from turnwright.path import Path, SpindleMode, Spiral
from turnwright.progress import Progress
from turnwright.speed_profile import SpeedProfile, check_one_speed
from turnwright.strategy.sampling import sample_turns
from turnwright.tool import Tool
from turnwright.units import unit

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

__all__ = ["STRATEGIES", "Strategy", "outermost_turn"]

STRATEGIES: dict[str, type[Strategy]] = {}
"""The strategies by the ``kind`` that a job file states; each class is added when its module is imported."""


class Strategy(TableModel, ABC):
    """A cutting strategy: the plan that the tool follows over the part, and the axes that make the motion.

    To add a strategy, write a frozen dataclass in a module of its own in this package with the methods `spiral` and
    `axes`. `place` puts the edge into contact along its spiral, and `drive` turns its axes into a motion; neither
    depends on the class. A strategy with a ``kind`` can be stated in a job file: its fields carry their units.

    Parameters
    ----------
    spindle_rpm
        Spindle speed; ``None`` for the highest one that keeps every limit of the machine. [rev/min]
    spindle_speeds
        Spindle speed over the radius, in place of one speed: each with the radius at which it is reached.
    sense
        +1 where the azimuth of the part under the tool grows, -1 where it falls.
    inside_out
        Cut from the centre to the rim.
    along
        How the tool is placed on the surface: along "z" or along the "normal" of the surface.
    """

    __slots__ = ()
    kind: ClassVar[str] = ""
    crosses_air: ClassVar[bool] = False
    """Whether it can lift the tool and turn faster outside an outline."""
    ways: ClassVar[Collection[str]] = ()
    """Fields that set the points together: a pass that states one of them replaces all of them."""
    example: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """An example for a job file."""
    key_names: ClassVar[Mapping[str, str]] = MappingProxyType({"spindle_rpm": "spindle_speed"})

    spindle_rpm: float | None
    spindle_speeds: SpeedProfile | None = None
    sense: int = 1
    inside_out: bool = False
    along: Literal["z", "normal"] = "z"

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        if "kind" in vars(cls):
            STRATEGIES[cls.kind] = cls
            forget_adapters()

    @property
    def moves_fast_tool(self) -> bool:
        """Whether a fast tool is driven by a separate table of heights."""
        return False

    @property
    def spindle_mode(self) -> SpindleMode | None:
        """Feed and speed of a cut in spindle mode; ``None`` for a cut with C as an axis."""
        return None

    def target(self, part: Part) -> Part:
        """Return the part that the tool is placed on, the design with its correction added."""
        return part.aimed

    def blocks(self, path: Path) -> Ints:
        """Return the indices of the points of a path that are points of its program. (m,)."""
        return np.arange(path.angle.size)

    @property
    def spiral_strategy(self) -> Strategy:
        """The strategy that sets the spiral and its points: this one, or the plan of a fast tool."""
        return self

    def adapted_to(self, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - for those that need it
        """Return the strategy with the values that it takes from tool and machine where they are not set."""
        return self

    def with_fields(self, **fields: Any) -> Strategy:
        """Return the strategy with some fields replaced, its own or those of its plan, as a pass states them."""
        if foreign := sorted(fields.keys() - types_of(type(self)).keys()):
            raise InputError(f"{', '.join(foreign)} is set, which the {self.kind} does not have: remove it")
        if fields.keys() & (speeds := {"spindle_rpm", "spindle_speeds"} & types_of(type(self)).keys()):
            fields = {**dict.fromkeys(speeds), **fields}
        if fields.keys() & {*self.ways}:
            fields = {**dict.fromkeys(self.ways), **fields}
        dataclass_self: Any = self  # a dataclass, as every strategy is
        made: Strategy = replace(dataclass_self, **fields)
        return made

    def require_crossings(self, part: Part) -> None:
        """Raise if the tool leaves a part within a revolution, and the strategy cannot lift it there."""
        if self.spindle_mode is not None and isinstance(part.surface, Chuck):
            raise InputError(
                "the parts of a chuck are no surface of revolution, in spindle mode the tool cannot follow them: cut "
                "them with C as an axis, in roughing passes too"
            )
        if part.leaves_air and self.spindle_mode is None and not self.crosses_air:
            kinds = [name for name, one in STRATEGIES.items() if one.crosses_air]
            raise InputError(
                f"the {self.kind} cannot lift the tool outside an outline within a revolution: use the "
                f"{' or the '.join(kinds)}, or a disc or an annulus on the axis"
            )

    @abstractmethod
    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral of the tool over the part, in plan view.

        Raises
        ------
        GougeError
            If neighbouring cuts would not overlap, or the rim would stay uncut.
        InputError
            If the surface has no such path, or the chord tolerance cannot be kept because the path jumps.
        LimitError
            If there are more points than any controller takes, or an axis is too slow.
        """

    def preview_spiral(self, part: Part, tool: Tool, *, turns: int, per_turn: int) -> Spiral:
        """Return some of the points of `spiral` for a preview: single revolutions, evenly from first to last.

        At most ``turns`` revolutions of at most ``per_turn`` points.
        """
        spiral = self.spiral(part, tool)
        turned = np.abs(spiral.angle - spiral.angle[0]) / (2 * np.pi)
        wanted = sample_turns(float(turned[-1]), turns, per_turn)
        near = np.clip(np.searchsorted(turned, wanted), 1, turned.size - 1)
        near = np.unique(near - (wanted - turned[near - 1] < turned[near] - wanted))
        return spiral.select(near)

    def extent(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> tuple[int, Spiral]:
        """Return the number of points of `spiral`, and its outermost revolution with the point at the other end."""
        spiral = self.spiral(part, tool, progress=progress)
        return spiral.angle.size, outermost_turn(spiral)

    @abstractmethod
    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the position of every axis at the points of a path, by letter, at least "C", "X" and "Z".

        Axes in the same direction add up to the tip: where a second carriage makes part of Z, the sum is that of the
        path.
        """

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivative by the angle of every axis of `axes`, or ``None`` if the path has none.

        The base class assumes that C, X and Z, and Y if the path has one, follow the path; a strategy that splits an
        axis must split its derivative too. [mm/rad, C rad/rad]
        """
        if path.radius_rate is None or path.z_rate is None or (path.y is not None and path.y_rate is None):
            return None
        rates = {"C": np.ones(path.angle.size), "X": path.radius_rate, "Z": path.z_rate}
        return rates if path.y_rate is None else {**rates, "Y": path.y_rate}

    def _check_fields(self) -> None:
        """Raise unless numbers are finite, sizes above 0, thicknesses at least 0, choices known, the speed unique."""
        check_numbers(self)
        for name, stated in types_of(type(self)).items():
            value = getattr(self, name)
            kinds = [kind for kind in (stated, *get_args(stated)) if kind is not type(None)]
            choices = next((get_args(kind) for kind in kinds if get_origin(kind) is Literal), ())
            if choices and (value is not None or type(None) not in get_args(stated)):
                one_of(value, name, choices)
            limits = [one for kind in kinds for one in getattr(kind, "__metadata__", ()) if isinstance(one, unit)]
            for limit in limits if value is not None else ():
                symbol = limit.units[0].replace("rpm", "rev/min")
                if limit.above == 0:
                    positive(value, name, symbol)
                if value < limit.least:
                    raise InputError(f"{name} is {value:g} {symbol}, it must be at least {limit.least:g} {symbol}")
        check_one_speed(self)

    @classmethod
    def table_keys(cls) -> Mapping[str, Any]:
        """Return the keys of a job file, with their types."""
        return {"kind": str, **super().table_keys()}

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table without the kind, which selects the class."""
        return {name: value for name, value in table.items() if name != "kind"}

    def to_table(self, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table with its kind."""
        if not self.kind:
            raise InputError(
                f"a {type(self).__name__} has no kind for a job file, the kinds are {', '.join(STRATEGIES)}"
            )
        return {"kind": self.kind} | {key: value for key, value in table.items() if key != "kind"}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        if cls is not Strategy:
            return super().__get_pydantic_core_schema__(source, handler)
        tagged = core_schema.tagged_union_schema(
            {name: handler.generate_schema(one) for name, one in STRATEGIES.items()}, discriminator="kind"
        )

        def read(value: Any, build: Callable[[Any], Any]) -> Any:
            return value if isinstance(value, Strategy) else build(value)

        return core_schema.no_info_wrap_validator_function(read, tagged, serialization=written_by(write_table))

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = super().__get_pydantic_json_schema__(core, handler) if cls is not Strategy else handler(core)
        if cls.kind:
            place = handler.resolve_ref_schema(schema)
            fields = {key: one for key, one in place["properties"].items() if key != "kind"}
            place["properties"] = {"kind": {"type": "string", "const": cls.kind}, **fields}
            place["required"] = ["kind", *(key for key in place.get("required", ()) if key != "kind")]
        return schema


def outermost_turn(spiral: Spiral) -> Spiral:
    """Return the outermost revolution of a spiral with the point at the other end."""
    size = spiral.angle.size
    inwards = spiral.radius[0] > spiral.radius[-1]
    away = np.abs(spiral.angle - spiral.angle[0 if inwards else -1])
    turn = np.flatnonzero(away <= 2 * np.pi)
    return spiral.select(np.unique([*turn, size - 1 if inwards else 0]))
