"""What every way of cutting must say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from turnwright._tables import Stated, forget_adapters, types_of, written, written_by
from turnwright.errors import InputError
from turnwright.path import Spiral
from turnwright.speed_profile import SpeedProfile

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

    from turnwright._arrays import Floats
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Path
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = ["STRATEGIES", "Strategy", "glimpsed"]

STRATEGIES: dict[str, type[Strategy]] = {}
"""What a job file can name as the ``kind`` of its strategy: each class, as soon as its module is imported."""


def glimpsed(turned: float, turns: int, per_turn: int) -> Floats:
    """Return where points of single turns stand that show a cut, counted in turns from its first point. (n,)."""
    whole = max(turned - 1, 0.0)
    first = np.round(np.linspace(0, whole, max(min(turns, int(whole) + 1), 1)))
    at = first[:, None] + np.arange(per_turn + 1) / per_turn
    return np.unique(np.append(at[at < turned], turned))


class Strategy(Stated, ABC):
    """A way of cutting: which plan the tool follows over the part, and which axes share the motion.

    This is where a sibling joins (a fast tool servo, an adaptive spacing, a hybrid of two servos): a frozen dataclass
    in a file of its own in this folder that says two things. `place` puts the edge into contact along its spiral,
    `drive` turns the axes it names into a motion; neither needs to know it. A job file states one that has a ``kind``:
    its fields carry their units.

    Attributes
    ----------
    spindle_rpm
        Spindle speed, or ``None`` for the highest one that keeps every limit of the machine. [rev/min]
    spindle_speeds
        Spindle speed over the radius, in place of one speed.
    sense
        +1 where the azimuth of the part under the tool grows, -1 where it falls.
    inside_out
        Whether the part is cut from the centre to the rim.
    along
        How `place` brings the tool into contact: "z" or "normal".
    """

    __slots__ = ()
    kind: ClassVar[str] = ""
    ways: ClassVar[Collection[str]] = ()
    """Fields that set the points together: a pass that states one of them states them all."""
    example: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """How a job file may state one."""
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
        """Whether a fast tool takes its own table of heights."""
        return False

    @property
    def lays_out(self) -> Strategy:
        """The strategy that sets spiral and points: this one, or the plan of a fast tool."""
        return self

    def on(self, tool: Tool, machine: Machine) -> Strategy:  # noqa: ARG002 - for those that need it
        """Return the strategy with what it takes from tool and machine where it does not state it."""
        return self

    def stating(self, **fields: Any) -> Strategy:
        """Return the strategy with some fields of its own, or of its plan, as a pass states them.

        Raises
        ------
        InputError
            If it has no such field, or cannot be so.
        """
        if foreign := sorted(fields.keys() - types_of(type(self)).keys()):
            raise InputError(f"it states {', '.join(foreign)}, which the {self.kind} does not have: leave it out")
        if fields.keys() & {"spindle_rpm", "spindle_speeds"}:
            fields = {"spindle_rpm": None, "spindle_speeds": None, **fields}
        if fields.keys() & {*self.ways}:
            fields = {**dict.fromkeys(self.ways), **fields}
        whole: Any = self  # a dataclass, as every strategy is
        made: Strategy = replace(whole, **fields)
        return made

    @abstractmethod
    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return where the tool is sent over the part, in plan view."""

    def glimpse(self, part: Part, tool: Tool, *, turns: int, per_turn: int) -> Spiral:
        """Return some of the points of `spiral`, enough for a picture: single turns, evenly apart from first to last.

        Parameters
        ----------
        part, tool
            See `spiral`.
        turns
            How many, at most.
        per_turn
            Points of each, at most.
        """
        whole = self.spiral(part, tool)
        turned = np.abs(whole.angle - whole.angle[0]) / (2 * np.pi)
        wanted = glimpsed(float(turned[-1]), turns, per_turn)
        near = np.clip(np.searchsorted(turned, wanted), 1, turned.size - 1)
        near = np.unique(near - (wanted - turned[near - 1] < turned[near] - wanted))
        y = None if whole.y is None else whole.y[near]
        return Spiral(angle=whole.angle[near], radius=whole.radius[near], y=y)

    def extent(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> tuple[int, Spiral]:
        """Return how many points `spiral` has, and of these its outermost turn and the last one at its other end.

        Parameters
        ----------
        part, tool, progress
            See `spiral`.
        """
        whole = self.spiral(part, tool, progress=progress)
        size = whole.angle.size
        inwards = whole.radius[0] > whole.radius[-1]
        away = np.abs(whole.angle - whole.angle[0 if inwards else -1])
        turn = np.flatnonzero(away <= 2 * np.pi)
        at = np.unique([*turn, size - 1 if inwards else 0])
        y = None if whole.y is None else whole.y[at]
        return size, Spiral(angle=whole.angle[at], radius=whole.radius[at], y=y)

    @abstractmethod
    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the position of every axis at the points of a path, by letter, at least "C", "X" and "Z".

        Their sum is the tip: whatever share of Z a second carriage takes, together they stand where the path says.
        """

    def rates(self, path: Path) -> dict[str, Floats] | None:
        """Return the derivative by the angle of every axis that `axes` names, or ``None`` if the path states none.

        As it stands this is for a strategy that moves C, X and Z, and Y where the path has one, as the path says; one
        that splits an axis splits its rate too. [mm/rad, C rad/rad]
        """
        if path.radius_rate is None or path.z_rate is None or (path.y is not None and path.y_rate is None):
            return None
        rates = {"C": np.ones(path.angle.size), "X": path.radius_rate, "Z": path.z_rate}
        return rates if path.y_rate is None else {**rates, "Y": path.y_rate}

    def _check_speed(self) -> None:
        """Raise if both one speed and several are stated."""
        if self.spindle_rpm is not None and self.spindle_speeds is not None:
            raise InputError("spindle_speed and spindle_speeds are both given, only one can be right: remove one")

    @classmethod
    def table_keys(cls) -> Mapping[str, Any]:
        """Return the keys that a file can state, with their types."""
        return {"kind": str, **super().table_keys()}

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table without the kind, which has chosen the class."""
        return {name: value for name, value in table.items() if name != "kind"}

    def to_table(self, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table with its kind."""
        if not self.kind:
            raise InputError(f"a job file has no kind for a {type(self).__name__}: it knows {', '.join(STRATEGIES)}")
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

        return core_schema.no_info_wrap_validator_function(read, tagged, serialization=written_by(written))

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        found = super().__get_pydantic_json_schema__(core, handler) if cls is not Strategy else handler(core)
        if cls.kind:
            place = handler.resolve_ref_schema(found)
            fields = {key: one for key, one in place["properties"].items() if key != "kind"}
            place["properties"] = {"kind": {"type": "string", "const": cls.kind}, **fields}
            place["required"] = ["kind", *(key for key in place.get("required", ()) if key != "kind")]
        return found
