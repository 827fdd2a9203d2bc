"""Predict the surface finish of a motion: the shape of the tool, vibration and minimum chip as separate terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from numpy.typing import ArrayLike

from turnwright.cutting import MinimumChip, Vibration, add_vibration, predict_uncut_height
from turnwright.generation import generate_polar
from turnwright.heightmap import HeightMap
from turnwright.machine import Machine
from turnwright.path import Motion
from turnwright.tool import Tool

__all__ = ["Finish", "finish"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finish:
    """A predicted surface and its terms.

    Parameters
    ----------
    surface
        Sum of all terms. [mm]
    terms
        Contribution of each term by name, in the order of addition: "kinematic", then "vibration" and "minimum chip"
        where requested. [mm]
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
        Motion of the axes.
    tool
        The edge.
    radius, angle
        The polar grid. (n_radius,) [mm], (n_angle,) [rad]
    vibration
        Vibration of the tool relative to the part.
    minimum_chip
        Minimum chip thickness that the edge cuts; from its radius by `MinimumChip.of_edge`.
    machine
        Actual machine with its geometric errors; that of the motion if not given.

    Returns
    -------
    Finish
        A term is the change of the surface when it is added to the ones before: the minimum chip is that of the
        vibrating tool.
    """
    made = generate_polar(motion, tool, radius=radius, angle=angle, machine=machine)
    terms = {"kinematic": made}
    moving = motion
    if vibration is not None:
        moving = add_vibration(motion, vibration)
        after = generate_polar(moving, tool, radius=radius, angle=angle, machine=machine)
        terms["vibration"] = _name_map(after, after.z - made.z, "vibration")
        made = after
    if minimum_chip is not None:
        extra = predict_uncut_height(moving, tool, minimum_chip, radius=radius, angle=angle, machine=machine)
        terms["minimum chip"] = _name_map(made, extra.z, "minimum chip")
        made = _name_map(made, made.z + extra.z, made.name)
    return Finish(surface=_name_map(made, made.z, "predicted finish"), terms=MappingProxyType(terms))


def _name_map(like: HeightMap, z: ArrayLike, name: str) -> HeightMap:
    return HeightMap(z=z, radius=like.radius, angle=like.angle, name=name)  # type: ignore[arg-type] # frozen there
