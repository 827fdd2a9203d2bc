"""Views of a job before it is run: surface maps, tool path and section through the cutting edge.

This module runs in the worker processes; `views` has the routes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from turnwright.access import reach_at
from turnwright.errors import InputError
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.web.binary import pack
from turnwright.web.jobs import SMALL, require

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.job import Job
    from turnwright.part import Part
    from turnwright.path import Path
    from turnwright.strategy import Strategy
    from turnwright.tool import Tool

__all__ = ["path", "section", "surface", "warm_compiler", "warm_surface"]

TURN = 2 * math.pi

MAX_TURNS = 72
"""Revolutions shown in the view of a path."""

AXIS_OFFSET = 1e-9
"""Distance from the axis, relative to the radius, at which points on the axis are evaluated."""

NEIGHBOURS = 4
"""Neighbouring revolutions on either side in the section."""


class _Quantity(NamedTuple):
    """Values of a quantity at points of a part."""

    values: Floats
    unit: str
    label: str
    note: str = ""


def warm_compiler() -> None:
    """Import numba."""
    import turnwright._kernels.compiling  # noqa: F401, PLC0415 - numba is costly to import


def warm_surface() -> None:
    """Compute a small surface map, so that its kernels are loaded."""
    surface(SMALL, "", "height", 16)


def surface(data: dict[str, Any], folder: str, quantity: str, pixels: int) -> bytes:
    """Return a packed map of a part: heights, and values of a quantity.

    The grid covers the square around the clear aperture. Points outside it have the height and value of the nearest
    point on its edge, so that a mesh through the grid reproduces the edge.
    """
    job = require(data, folder)
    part = job.part
    grid = np.linspace(-part.reach, part.reach, pixels)
    x, y = (one.ravel() for one in np.meshgrid(grid, grid))
    distance = np.hypot(x, y)
    is_outside = ~part.covers(x, y)
    if part.outline is None:
        x[is_outside] *= part.reach / distance[is_outside] * (1 - 1e-12)
        y[is_outside] *= part.reach / distance[is_outside] * (1 - 1e-12)
    else:
        x[is_outside], y[is_outside] = part.border.nearest_border(x[is_outside], y[is_outside])
        distance = np.hypot(x, y)
    x[distance < AXIS_OFFSET * part.reach] = AXIS_OFFSET * part.reach
    z = part.surface.sag(x, y)
    refused = ""
    try:
        colours = _evaluate(job, part, quantity, x, y, z)
    except InputError as error:
        # Show the shape even if the quantity cannot be evaluated.
        colours, refused = _Quantity(np.full(z.size, np.nan), "mm", quantity), str(error)
    finite = colours.values[~is_outside & np.isfinite(colours.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    inside = z[~is_outside]
    header = {
        "quantity": quantity, "unit": colours.unit, "label": colours.label, "note": colours.note, "refused": refused,
        "diverging": False,
        "x": [-part.reach, part.reach], "y": [-part.reach, part.reach], "radius": part.reach,
        "low": low, "high": high, "z_low": float(inside.min()), "z_high": float(inside.max()), "name": part.name,
    }  # fmt: skip
    shape = (pixels, pixels)
    return pack(header, {"values": colours.values.reshape(shape), "z": z.reshape(shape)})


def _evaluate(job: Job, part: Part, quantity: str, x: Floats, y: Floats, z: Floats) -> _Quantity:
    """Return the values of a quantity over a part."""
    tool, sense = job.tool, job.strategy.sense
    if quantity == "height":
        return _Quantity(z, "mm", "height of the surface")
    if quantity == "slope":
        return _Quantity(np.arctan(np.hypot(*part.surface.gradient(x, y))), "rad", "slope")
    if quantity == "curvature":
        bend = reach_at(part, tool, x=x, y=y, sense=sense).curvature
        return _Quantity(bend, "1/mm", "radial curvature", "positive where concave")
    if quantity == "clearance margin":
        needed = reach_at(part, tool, x=x, y=y, sense=sense).clearance
        if tool.clearance is None:
            note = "the tool states no clearance angle: the required angle is shown"
            return _Quantity(np.maximum(needed, 0.0), "rad", "required clearance", note)
        note = f"clearance angle of the tool, {np.rad2deg(tool.clearance):.3g} deg, minus the required angle"
        return _Quantity(tool.clearance - needed, "rad", "clearance margin", note)
    return _chips(job, part, x, y)


def _chips(job: Job, part: Part, x: Floats, y: Floats) -> _Quantity:
    """Return the expected maximum uncut chip thickness of the finishing pass."""
    from turnwright.cutting import expected_thickest  # noqa: PLC0415 - only this quantity needs it

    before, cut = part.stock, job.passes[-1]
    for one in job.passes[:-1]:
        before = one.allowance
    depth = (before - cut.allowance) / cut.repeats(before)
    if not depth > 0:
        raise InputError(
            f"depth of the finishing pass must be positive, got {depth:g} mm with a stock of {part.stock:g} mm: set "
            "part.stock"
        )
    feed = _feed(job)
    bend = reach_at(part, job.tool, x=x, y=y, sense=job.strategy.sense).curvature
    note = (
        f"estimate at {feed * 1e3:.3g} um/rev and a depth of {depth * 1e3:.3g} um; a run computes the chip along the "
        "path"
    )
    return _Quantity(expected_thickest(job.tool, feed=feed, depth=depth, bend=bend), "mm", "uncut chip thickness", note)


def _stated_feed(servo: Strategy) -> float | None:
    """Return the feed of a pass, ``None`` if it varies. [mm/rev]."""
    feed: float | None = getattr(servo.spiral_strategy, "feed", None)
    return feed


def _feed(job: Job) -> float:
    """Return the feed of the finishing pass; the mean feed if it varies. [mm/rev]."""
    servo = job.servo(job.passes[-1])
    return _stated_feed(servo) or servo.preview_spiral(job.part.aimed, job.tool, turns=MAX_TURNS, per_turn=8).feed


def path(data: dict[str, Any], folder: str, points: int) -> bytes:
    """Return evenly spaced revolutions of the finishing path, with exact contact points."""
    job = require(data, folder)
    part, tool = job.part.aimed, job.tool
    servo = job.servo(job.passes[-1])
    per_turn = int(np.clip(points // MAX_TURNS, 36, 180))
    spiral = servo.preview_spiral(part, tool, turns=max(points // per_turn, 1), per_turn=per_turn)
    placed = place(spiral, part, tool, along=job.strategy.along)
    turned = np.abs(placed.angle - placed.angle[0]) / TURN
    breaks = np.flatnonzero(np.diff(turned) > 0.5) + 1
    starts = np.concatenate(([0], breaks, [turned.size]))
    drawn = float((turned[starts[1:] - 1] - turned[starts[:-1]]).sum())
    header = {
        "turns": spiral.turns, "feed": spiral.feed, "sense": spiral.sense, "along": job.strategy.along,
        "nose_radius": tool.nose_radius, "actual_radius": tool.actual_radius, "rake": tool.rake,
        "included": tool.included, "clearance": tool.clearance, "radius": part.reach,
        "sweep": [float(placed.sweep.min()), float(placed.sweep.max())],
        "pass": job.passes[-1].name, "starts": starts.tolist(),
        "note": f"{drawn:.0f} of {spiral.turns:.4g} revolutions are drawn, with exact contact",
    }  # fmt: skip
    # Angles are reduced to one revolution: float32 cannot resolve azimuths after thousands of revolutions.
    return pack(
        header,
        {
            "position": np.stack(_tip(placed), axis=1),
            "contact": np.stack((placed.contact_x, placed.contact_y, placed.contact_z), axis=1),
            "angle": np.mod(placed.angle, TURN), "radius": placed.radius, "sweep": placed.sweep,
            "clearance": placed.clearance, "fraction": turned / turned[-1],
            "y": np.zeros(placed.angle.size) if placed.y is None else placed.y,
        },
    )  # fmt: skip


def _tip(path: Path) -> tuple[Floats, Floats, Floats]:
    """Return the position of the tool tip in the part frame. [mm]."""
    cosine, sine = np.cos(path.angle), np.sin(path.angle)
    lateral = 0.0 if path.y is None else path.y
    return path.radius * cosine - lateral * sine, path.radius * sine + lateral * cosine, path.z


def section(
    data: dict[str, Any], folder: str, angle: float, radius: float, y: float, feed: float | None = None
) -> bytes:
    """Return a section in the plane of the cutting edge: to scale, and enlarged with the neighbouring cusps."""
    job = require(data, folder)
    part, tool, sense = job.part.aimed, job.tool, job.strategy.sense
    feed = feed or _feed(job)
    # The tip at this radius, and the neighbouring revolutions at the same azimuth.
    ranks = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    radii: Floats = np.asarray(radius + feed * ranks, dtype=np.float64)
    raised = None if y == 0 else np.full(radii.size, y)
    azimuths: Floats = angle + sense * TURN * np.arange(radii.size, dtype=np.float64)
    spiral = Spiral(angle=azimuths, radius=radii, y=raised)
    placed = place(spiral, part, tool, along=job.strategy.along)
    centre = NEIGHBOURS
    low, high = tool.arc
    sweeps = np.linspace(low * 1.15, high * 1.15, 721)
    u, _, e = tool.edge(sweeps, sense)
    tip, tip_z = float(placed.radius[centre]), float(placed.z[centre])
    edge_u = tip + u
    across = np.linspace(edge_u.min(), edge_u.max(), 721)
    contact_u = float(placed.contact_x[centre] * math.cos(angle) + placed.contact_y[centre] * math.sin(angle))
    near_u = np.linspace(contact_u - NEIGHBOURS * feed, contact_u + NEIGHBOURS * feed, 961)
    designed = _surface_profile(part, angle, near_u, y)
    passes = np.stack([_edge_height(tool, sense, near_u - radii[k]) + placed.z[k] for k in range(radii.size)])
    # With an inward feed, the revolutions at larger radius have already been cut.
    inward = not job.strategy.inside_out
    earlier = passes[ranks > 0] if inward else passes[ranks < 0]
    remaining = np.fmin(np.fmin.reduce(earlier, axis=0), passes[centre])
    with np.errstate(invalid="ignore"):
        arrays = {
            "surface": np.stack((across, _surface_profile(part, angle, across, y)), axis=1),
            "edge": np.stack((edge_u, tip_z + e), axis=1),
            "near": near_u - contact_u, "edge_gap": passes[centre] - designed, "left_gap": remaining - designed,
            "passes_gap": passes - designed,
        }  # fmt: skip
    header = {
        "angle": float(np.mod(angle, TURN)), "radius": radius, "feed": feed,
        "tip": {"radius": tip, "z": tip_z},
        "contact": {
            "u": contact_u, "x": float(placed.contact_x[centre]), "y": float(placed.contact_y[centre]),
            "z": float(placed.contact_z[centre]), "sweep": float(placed.sweep[centre]),
        },
        "clearance": float(placed.clearance[centre]), "nose_radius": tool.nose_radius, "arc": [low, high],
        "inward": inward,
        "varies": _stated_feed(job.servo(job.passes[-1])) is None,
    }  # fmt: skip
    return pack(header, arrays)


def _surface_profile(part: Part, angle: float, u: Floats, y: float) -> Floats:
    """Return the nominal surface along the line under the cutting edge, nan outside the part. [mm]."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return part.heights(u * cosine - y * sine, u * sine + y * cosine)


def _edge_height(tool: Tool, sense: int, u: Floats) -> Floats:
    """Return the height of the cutting edge above the commanded tip at distances u, nan beyond the edge. [mm]."""
    low, high = tool.arc
    ends = np.clip((u[[0, -1]] - tool.offset[0]) / tool.actual_radius, -0.999, 0.999)
    ends = np.clip(np.arcsin(ends) + np.array([-0.02, 0.02]), low * 1.1, high * 1.1)
    at, _, e = tool.edge(np.linspace(ends[0], ends[1], 8001), sense)
    return np.asarray(np.interp(u, at, e, left=np.nan, right=np.nan))
