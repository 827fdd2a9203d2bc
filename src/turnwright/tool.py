"""The diamond: what its edge is, exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, Value, frozen
from turnwright._tables import Plausible, TableModel, read_by, refuse
from turnwright._validate import between, check_angle, check_numbers, finite_tuple, plausible_sizes, positive
from turnwright.edge import Edge, edge_of_arc
from turnwright.errors import InputError, UnitError
from turnwright.units import Angle, Length, Size, Text, unit

if TYPE_CHECKING:
    from pydantic import GetJsonSchemaHandler
    from pydantic_core import CoreSchema
    from scipy.interpolate import CubicSpline

__all__ = ["LARGEST_ERROR", "Shank", "Tool", "WavinessTable"]

HALF_CIRCLE = np.pi / 2 - 1e-3
"""Half of the included angle of a nose whose maker states none: the arc ends just before its wall is vertical. [rad]"""
STEEP = np.deg2rad(80)
"""From this sweep on waviness may end the arc, where it makes the wall vertical earlier. [rad]"""
STEEPEST = np.deg2rad(80)
"""Largest rake and clearance. [rad]"""
NARROW = 1e-3
"""A certificate that covers less is none. [rad]"""
LARGEST_ERROR = 0.1
"""Error of the nose radius at most, as a share of it."""

PLAUSIBLE = MappingProxyType(dict.fromkeys(("offset x", "offset y", "offset z", "radius error", "waviness"), "mm"))
"""Deviations whose plausible size a tool may state, and their units."""

PLAUSIBLE_TEXTS = MappingProxyType({
    "offset x": "Tool centring error along X.",
    "offset y": "Tool height error.",
    "offset z": "Touch-off error along Z.",
    "radius error": "Error of the nose radius.",
    "waviness": "Deviation of the edge at the used sweep farthest from the tip.",
})  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WavinessTable(Value):
    """A tool certificate: the measured deviation of the edge from its circle, joined by a cubic spline.

    Parameters
    ----------
    sweep
        Angles on the nose, ascending, 0 at the tip, positive toward +X. (n,) [rad]
    deviation
        Radial deviation there, positive outward. (n,) [mm]
    file
        The file that it was read from, if any.

    Raises
    ------
    InputError
        If there are fewer than four points, they are not ascending or cover next to nothing, or anything is not finite.
    """

    sweep: Floats
    deviation: Floats
    file: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "sweep", frozen(self.sweep, "waviness sweep"))
        object.__setattr__(self, "deviation", frozen(self.deviation, "waviness deviation"))
        if self.sweep.shape != self.deviation.shape or self.sweep.size < 4:
            raise InputError(
                f"a waviness table has {self.sweep.size} sweeps and {self.deviation.size} deviations, "
                "it needs equal numbers of both, at least 4: complete it"
            )
        for end in self.sweep[[0, -1]]:
            check_angle(end, "a sweep of a waviness table", -np.pi, np.pi)
        if not (np.diff(self.sweep) > 0).all():
            raise InputError("the sweeps of a waviness table do not ascend: sort them and drop repeated ones")
        if np.ptp(self.sweep) < NARROW:
            raise InputError(
                f"a waviness table covers {np.ptp(self.sweep):.3g} rad, the limit is {NARROW:g} rad: give its sweeps "
                "in rad, over the arc that was measured"
            )


def _last_within(over: Bools) -> int:
    """Return the number of the last step before the first that is over."""
    return max(int(np.argmax(over)) - 1, 0) if over.any() else over.size - 1


class _Waviness(read_by):
    """Coefficients of sweep, sweep^2, ... each in its own unit, or what the file of a certificate holds."""

    __slots__ = ()
    texts = (list, tuple)
    wrong = "tuple_type"

    def read(self, value: Any, info: Any) -> Any:
        """Return coefficients that a list states, or a certificate."""
        if isinstance(value, Path):
            return read_by.read(self, value, info)
        problems: dict[tuple[str | int, ...], Exception | str] = {}
        coefficients = []
        for index, one in enumerate(value):
            try:
                coefficients.append(unit(f"mm/rad^{index + 1}").validate(one, info))
            except UnitError as error:
                problems[index,] = error
        if problems:
            raise refuse("waviness", problems, value)
        return tuple(coefficients)

    def show(self, waviness: tuple[float, ...] | WavinessTable) -> Any:
        """Return coefficients as text, a certificate by the name of its file."""
        if isinstance(waviness, WavinessTable):
            return super().show(waviness)
        return [f"{value!r} mm/rad^{index + 1}" for index, value in enumerate(waviness)]

    def __get_pydantic_json_schema__(self, _core: CoreSchema, _handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "array", "items": {"type": "string"}}


Waviness: TypeAlias = Annotated[tuple[float, ...] | WavinessTable, _Waviness("waviness")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shank(TableModel):
    """The shank or the holder of a tool: a cylinder along z, from its lower end upward.

    Parameters
    ----------
    radius
        Radius of the cylinder; for a square shank half of its diagonal. [mm]
    height
        Height of its lower end above the tip; the stick-out, for a holder. [mm]
    offset
        (dx, dy), position of its centre line minus that of the tip; dy is positive toward growing spindle angle. [mm]

    Raises
    ------
    InputError
        If the radius or the height is not positive.
    """

    radius: Size
    height: Size
    offset: tuple[Length, Length] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "radius of a shank or holder", "mm")
        positive(self.height, "height of a shank or holder", "mm")
        object.__setattr__(self, "offset", finite_tuple(self.offset, "offset (dx, dy)", 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tool(TableModel, Value):
    """A round-nosed diamond tool, with its deviations.

    The edge lies in the rake plane: an arc of ``nose_radius + radius_error`` plus waviness, inside the included angle,
    and straight flanks, tangent to the arc's ends, beyond it. The *tip* is the lowest point of the nominal arc. A
    ``radius_error`` does not move the tip, since the tip is touched off; ``offset`` is its actual minus its nominal
    position. The *sweep* of a point of the arc is its angle on the nose, 0 at the tip.

    Parameters
    ----------
    nose_radius
        Radius of the cutting edge in the rake plane. [mm]
    included
        Included angle of the arc, symmetric about the tip. ``None`` if not stated: the edge is then taken as half a
        circle, which `check_access` reports. [rad]
    rake
        Rake angle; positive if the rake face leans back from the cutting direction. [rad]
    clearance
        Clearance angle of the edge; ``None`` if not stated. [rad]
    waviness
        Radial deviation of the edge, positive outward: polynomial coefficients (c1, c2, ...) of the sweep in mm/rad^k,
        or a `WavinessTable`.
    radius_error
        Actual minus nominal nose radius. [mm]
    offset
        (dx, dy, dz), actual minus nominal position of the tip; dy is the tool height error, positive toward growing
        spindle angle. [mm]
    name
        Name of the tool.
    edge_length
        Length of the sharp flank beyond each end of the arc; ``None`` if only the arc cuts. [mm]
    shank, holder
        Cylinders above the diamond that must stay clear of the part; ``None`` if not stated.
    plausible
        Plausible sizes (standard deviations) of tool errors, where they differ from `ERROR_SOURCES`: "offset x",
        "offset y", "offset z", "radius error", "waviness". [mm]

    Raises
    ------
    InputError
        If the edge cannot exist: a radius that is not positive, an included angle beyond half a turn, waviness as
        large as the nose or so steep that the edge overhangs.

    Examples
    --------
    >>> tool = Tool(nose_radius=0.5, included=np.deg2rad(60))
    >>> u, v, e = tool.edge(np.deg2rad([0, 30]))
    >>> np.round(e * 1e3, 3)   # um above the tip
    array([ 0.   , 66.987])
    """

    file_keys = MappingProxyType({"waviness": "waviness_file"})
    nose_radius: Size
    included: Angle | None = None
    rake: Angle = 0.0
    clearance: Angle | None = None
    waviness: Waviness = ()
    radius_error: Length = 0.0
    offset: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    name: Text = ""
    edge_length: Size | None = None
    shank: Shank | None = None
    holder: Shank | None = None
    plausible: Annotated[Mapping[str, float], Plausible(PLAUSIBLE, PLAUSIBLE_TEXTS)] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.nose_radius, "nose_radius", "mm")
        if self.edge_length is not None:
            positive(self.edge_length, "edge_length", "mm")
        if self.included is not None and check_angle(self.included, "included", 0.0, np.pi) == 0:
            raise InputError("included is 0 rad, it must be above 0 rad: give the included angle of the arc")
        check_angle(self.rake, "rake", -STEEPEST, STEEPEST)
        if self.clearance is not None:
            check_angle(self.clearance, "clearance", 0.0, STEEPEST)
        if self.nose_radius + self.radius_error <= 0:
            raise InputError(
                f"radius_error is {self.radius_error:g} mm on a nose_radius of {self.nose_radius:g} mm, no nose "
                "remains: give actual minus nominal radius"
            )
        most = LARGEST_ERROR * self.nose_radius
        between(self.radius_error, "radius_error", -most, most, "mm (a tenth of the nose_radius)")
        object.__setattr__(self, "offset", finite_tuple(self.offset, "offset (dx, dy, dz)", 3))
        if not isinstance(self.waviness, WavinessTable):
            object.__setattr__(self, "waviness", tuple(float(value) for value in self.waviness))
        object.__setattr__(self, "plausible", plausible_sizes(self.plausible, PLAUSIBLE))
        low, high = self.arc
        deviation = self.deviation(np.linspace(low, high, 721))
        if np.abs(deviation).max() > 0.2 * self.nose_radius:
            raise InputError(
                f"waviness reaches {np.abs(deviation).max():.3g} mm, the limit is a fifth of the nose_radius "
                f"({0.2 * self.nose_radius:.3g} mm): check its unit, mm/rad^k"
            )
        sweep = np.linspace(low, high, 721)
        angle = self._slope_angle(sweep)
        worst = int(np.argmax(np.abs(angle)))
        if abs(angle[worst]) > HALF_CIRCLE + 1e-12:
            raise InputError(
                f"waviness turns the edge to {np.rad2deg(angle[worst]):.4g} deg at sweep "
                f"{np.rad2deg(sweep[worst]):.4g} deg, the limit is {np.rad2deg(HALF_CIRCLE):.4g} deg, a vertical wall: "
                "check its unit, mm/rad^k, or give a smaller included angle"
            )

    @property
    def arc(self) -> tuple[float, float]:
        """Sweep at the two ends of the arc (lo, hi): half the included angle, or just before a vertical wall. [rad]."""
        half = HALF_CIRCLE if self.included is None else min(self.included / 2, HALF_CIRCLE)
        if self.perfect or half <= STEEP:
            return -half, half
        steps = np.linspace(STEEP, half, 1001)
        low, high = (
            side * steps[_last_within(side * self._slope_angle(side * steps) > HALF_CIRCLE)] for side in (-1, 1)
        )
        return float(low), float(high)

    @property
    def perfect(self) -> bool:
        """Whether the edge is an arc of one circle, without waviness."""
        return not isinstance(self.waviness, WavinessTable) and not any(self.waviness)

    @property
    def bodies(self) -> Mapping[str, Shank]:
        """Shank and holder, as far as they are stated, by name."""
        stated = {"shank": self.shank, "holder": self.holder}
        return {name: one for name, one in stated.items() if one is not None}

    @property
    def actual_radius(self) -> float:
        """Nominal radius plus its error. [mm]."""
        return self.nose_radius + self.radius_error

    def cutting_edge(self, sense: int = 1) -> Edge:
        """Return the edge as one value; ``sense`` is +1 where the spindle angle under the tool grows, else -1."""
        return _edge(self, sense)

    def deviation(self, sweep: ArrayLike) -> Floats:
        """Waviness at ``sweep``, held constant beyond the arc (and beyond a certificate's ends). [mm]."""
        return self._waviness(np.clip(np.asarray(sweep, dtype=np.float64), *self.arc))[0]

    def _waviness(self, sweep: Floats) -> tuple[Floats, Floats]:
        """Return the deviation on the arc [mm], and its derivative [mm/rad]."""
        if isinstance(self.waviness, WavinessTable):
            spline = _spline(self.waviness)
            held = np.clip(sweep, self.waviness.sweep[0], self.waviness.sweep[-1])
            return np.asarray(spline(held)), np.where(held == sweep, spline(held, 1), 0.0)
        coefficients = [*reversed(self.waviness), 0.0]
        return np.asarray(np.polyval(coefficients, sweep)), np.asarray(np.polyval(np.polyder(coefficients), sweep))

    def _slope_angle(self, sweep: Floats) -> Floats:
        """Return the angle of the edge itself, on the arc. [rad]."""
        deviation, rate = self._waviness(sweep)
        return np.asarray(sweep - np.arctan(rate / (self.actual_radius + deviation)))

    def edge(self, sweep: ArrayLike, sense: int = 1) -> tuple[Floats, Floats, Floats]:
        """Return where the edge is, measured from the commanded tip.

        Parameters
        ----------
        sweep
            Angle on the nose; beyond the arc it runs on along the flank. (n,) [rad]
        sense
            +1 where the spindle angle under the tool grows, -1 where it falls: a raked edge leans the other way.

        Returns
        -------
        u, v, e
            Distance toward +X, distance toward growing spindle angle, height. Each (n,) [mm]
        """
        u, v, e = self.cutting_edge(sense).points(sweep)
        return u, v, e


def _spline(certificate: WavinessTable) -> CubicSpline:
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - scipy is costly to import

    return CubicSpline(certificate.sweep, certificate.deviation)


@lru_cache(maxsize=64)
def _edge(tool: Tool, sense: int) -> Edge:
    if sense < 0:
        edge = _edge(tool, 1)
        return edge._replace(rake_sin=-edge.rake_sin)
    if isinstance(tool.waviness, WavinessTable):
        spline = _spline(tool.waviness)
        breaks, coefficients = spline.x, spline.c
    else:
        # One piece, expanded about sweep 0: sum of c_k sweep^k, with no constant (that is the radius error).
        breaks = np.array([0.0, 1.0])
        coefficients = np.array([*reversed(tool.waviness), 0.0])[:, None]
    return edge_of_arc(
        radius=tool.actual_radius, arc=tool.arc, rake=tool.rake, offset=tool.offset, breaks=breaks,
        coefficients=coefficients,
    )  # fmt: skip
