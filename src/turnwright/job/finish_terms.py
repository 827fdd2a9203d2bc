"""The finish that a motion leaves, with each published term beside the shape of the tool apart and by its name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from turnwright.cutting import MinimumChip, Vibration, left_standing, vibrated
from turnwright.generation import generate_polar
from turnwright.heightmap import HeightMap

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from turnwright.machine import Machine
    from turnwright.path import Motion
    from turnwright.tool import Tool

__all__ = ["Finish", "finish"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finish:
    """A predicted surface and what it is made of.

    Parameters
    ----------
    surface
        All together. [mm]
    terms
        What each adds, by name, in the order in which they were put on: "kinematic", then "vibration" and "minimum
        chip" where they were asked for. Their sum is the surface. [mm]
    """

    surface: HeightMap
    terms: Mapping[str, HeightMap]


def finish(
    motion: Motion,
    tool: Tool,
    *,
    radius: ArrayLike,
    angle: ArrayLike,
    vibration: Vibration | None = None,
    minimum_chip: MinimumChip | None = None,
    machine: Machine | None = None,
) -> Finish:
    """Predict a surface from the shape of the tool and further terms.

    Parameters
    ----------
    motion
        As the axes move.
    tool
        The edge.
    radius, angle
        The polar grid. (n_radius,) [mm], (n_angle,) [rad]
    vibration
        Of tool and work, relative to each other.
    minimum_chip
        What the edge does not cut; of its radius by `MinimumChip.of_edge`.
    machine
        Whose geometric errors act; that of the motion if not given.

    Returns
    -------
    Finish
        A term's share is what the surface gains by it when it comes on top of the ones before: what a thin chip leaves
        is that of the vibrating tool.
    """
    made = generate_polar(motion, tool, radius=radius, angle=angle, machine=machine)
    terms = {"kinematic": made}
    moving = motion
    if vibration is not None:
        moving = vibrated(motion, vibration)
        after = generate_polar(moving, tool, radius=radius, angle=angle, machine=machine)
        terms["vibration"] = _named(after, after.z - made.z, "vibration")
        made = after
    if minimum_chip is not None:
        extra = left_standing(moving, tool, minimum_chip, radius=radius, angle=angle, machine=machine)
        terms["minimum chip"] = _named(made, extra.z, "minimum chip")
        made = _named(made, made.z + extra.z, made.name)
    return Finish(surface=_named(made, made.z, "predicted finish"), terms=MappingProxyType(terms))


def _named(like: HeightMap, z: ArrayLike, name: str) -> HeightMap:
    return HeightMap(z=z, radius=like.radius, angle=like.angle, name=name)  # type: ignore[arg-type] # frozen there
