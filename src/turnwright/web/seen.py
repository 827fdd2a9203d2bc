"""What is seen of a job that is only typed: its surface in any colour, the path, the edge in contact.

This runs in the warm processes and only calls what the command line calls; `views` has the routes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from turnwright.access import reach_at
from turnwright.errors import InputError
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.web.jobs import SMALL, require
from turnwright.web.packed import pack

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats
    from turnwright.job import Job
    from turnwright.part import Part
    from turnwright.path import Path
    from turnwright.strategy import Strategy
    from turnwright.tool import Tool

__all__ = ["path", "section", "surface", "warm_compiler", "warm_surface"]

TURN = 2 * math.pi

MOST_TURNS = 72
"""Turns that a picture of a path shows."""

BESIDE = 1e-9
"""How far beside the axis, of the radius, places on it are looked at: some quantities have a direction there."""

TWIST = 1e-7
"""Angle to a second point of a spiral that has one. [rad]"""

PASSES = 4
"""Passes to either side that the section shows."""


class _Colours(NamedTuple):
    """What a quantity is at some places of a part."""

    values: Floats
    unit: str
    label: str
    note: str = ""


def warm_compiler() -> None:
    """Import what compiled kernels stand on."""
    import turnwright._kernels.compiling  # noqa: F401, PLC0415 - numba is costly to import


def warm_surface() -> None:
    """Load what the first surface needs: its kernel, and with it most of what kernels need at all."""
    surface(SMALL, "", "height", 16)


def surface(data: dict[str, Any], folder: str, quantity: str, pixels: int) -> bytes:
    """Return a map of a part: heights for the shape, and values for the colours.

    The grid covers the square around the clear radius. Beyond it a place has the height and the value of the nearest
    place on the rim, so that whoever joins the points gets the rim right.
    """
    job = require(data, folder)
    part = job.part
    axis = np.linspace(-part.radius, part.radius, pixels)
    x, y = (one.ravel() for one in np.meshgrid(axis, axis))
    away = np.hypot(x, y)
    beyond = away > part.radius
    x[beyond] *= part.radius / away[beyond] * (1 - 1e-12)
    y[beyond] *= part.radius / away[beyond] * (1 - 1e-12)
    x[away < BESIDE * part.radius] = BESIDE * part.radius
    z = part.surface.sag(x, y)
    refused = ""
    try:
        found = _coloured(job, part, quantity, x, y, z)
    except InputError as error:
        # The shape can be seen, whatever stands against its colours.
        found, refused = _Colours(np.full(z.size, np.nan), "mm", quantity), str(error)
    shown = found.values[~beyond & np.isfinite(found.values)]
    low, high = (float(shown.min()), float(shown.max())) if shown.size else (0.0, 1.0)
    inside = z[~beyond]
    header = {
        "quantity": quantity, "unit": found.unit, "label": found.label, "note": found.note, "refused": refused,
        "diverging": False,
        "x": [-part.radius, part.radius], "y": [-part.radius, part.radius], "radius": part.radius,
        "low": low, "high": high, "z_low": float(inside.min()), "z_high": float(inside.max()), "name": part.name,
    }  # fmt: skip
    shape = (pixels, pixels)
    return pack(header, {"values": found.values.reshape(shape), "z": z.reshape(shape)})


def _coloured(job: Job, part: Part, quantity: str, x: Floats, y: Floats, z: Floats) -> _Colours:
    """Return the values that colour a part."""
    tool, sense = job.tool, job.strategy.sense
    if quantity == "height":
        return _Colours(z, "mm", "height of the surface")
    if quantity == "slope":
        return _Colours(np.arctan(np.hypot(*part.surface.gradient(x, y))), "rad", "slope")
    if quantity == "curvature":
        bend = reach_at(part, tool, x=x, y=y, sense=sense).curvature
        return _Colours(bend, "1/mm", "curvature along the radius", "concave places are positive")
    if quantity == "clearance margin":
        needed = reach_at(part, tool, x=x, y=y, sense=sense).clearance
        if tool.clearance is None:
            note = "the tool states no clearance angle, so what it needs is shown"
            return _Colours(np.maximum(needed, 0.0), "rad", "clearance needed", note)
        note = f"clearance angle of the tool, {np.rad2deg(tool.clearance):.3g} deg, less the fall of the surface"
        return _Colours(tool.clearance - needed, "rad", "clearance margin", note)
    return _chips(job, part, x, y)


def _chips(job: Job, part: Part, x: Floats, y: Floats) -> _Colours:
    """Return the thickest chip of the finishing pass to expect."""
    from turnwright.cutting import expected_thickest  # noqa: PLC0415 - only this quantity needs it

    before, cut = part.stock, job.passes[-1]
    for one in job.passes[:-1]:
        before = one.allowance
    depth = (before - cut.allowance) / cut.repeats(before)
    if not depth > 0:
        raise InputError(
            f"the job states a stock of {part.stock:g} mm and the finishing pass takes off {depth:g} mm, so that its "
            "chips have no thickness: add part.stock"
        )
    feed = _feed(job)
    bend = reach_at(part, job.tool, x=x, y=y, sense=job.strategy.sense).curvature
    note = (
        f"expected before any path is known, at {feed * 1e3:.3g} um/rev and a depth of {depth * 1e3:.3g} um: a run "
        "finds the chips along the path"
    )
    return _Colours(expected_thickest(job.tool, feed=feed, depth=depth, bend=bend), "mm", "thickest chip", note)


def _stated_feed(servo: Strategy) -> float | None:
    """Return how far a pass advances in every turn, ``None`` where that varies. [mm/rev]."""
    feed: float | None = getattr(servo.lays_out, "feed", None)
    return feed


def _feed(job: Job) -> float:
    """Return how far the finishing pass advances per turn; on the whole, where that varies. [mm/rev]."""
    servo = job.servo(job.passes[-1])
    return _stated_feed(servo) or servo.glimpse(job.part.aimed, job.tool, turns=MOST_TURNS, per_turn=8).feed


def path(data: dict[str, Any], folder: str, points: int) -> bytes:
    """Return single turns of the finishing path, evenly apart, every place in true contact."""
    job = require(data, folder)
    part, tool = job.part.aimed, job.tool
    servo = job.servo(job.passes[-1])
    per_turn = int(np.clip(points // MOST_TURNS, 36, 180))
    spiral = servo.glimpse(part, tool, turns=max(points // per_turn, 1), per_turn=per_turn)
    found = place(spiral, part, tool, along=job.strategy.along)
    turned = np.abs(found.angle - found.angle[0]) / TURN
    breaks = np.flatnonzero(np.diff(turned) > 0.5) + 1
    starts = np.concatenate(([0], breaks, [turned.size]))
    drawn = float((turned[starts[1:] - 1] - turned[starts[:-1]]).sum())
    header = {
        "turns": spiral.turns, "feed": spiral.feed, "sense": spiral.sense, "along": job.strategy.along,
        "nose_radius": tool.nose_radius, "actual_radius": tool.actual_radius, "rake": tool.rake,
        "included": tool.included, "clearance": tool.clearance, "radius": part.radius,
        "sweep": [float(found.sweep.min()), float(found.sweep.max())],
        "pass": job.passes[-1].name, "starts": starts.tolist(),
        "note": f"{drawn:.0f} of {spiral.turns:.4g} turns are drawn, every point in contact",
    }  # fmt: skip
    # Far out single precision tells no azimuth from the next after thousands of turns: angles stay below one.
    return pack(
        header,
        {
            "position": np.stack(_tip(found), axis=1),
            "contact": np.stack((found.contact_x, found.contact_y, found.contact_z), axis=1),
            "angle": np.mod(found.angle, TURN), "radius": found.radius, "sweep": found.sweep,
            "clearance": found.clearance, "fraction": turned / turned[-1],
            "y": np.zeros(found.angle.size) if found.y is None else found.y,
        },
    )  # fmt: skip


def _tip(found: Path) -> tuple[Floats, Floats, Floats]:
    """Return where the tip stands in the frame of the part."""
    cosine, sine = np.cos(found.angle), np.sin(found.angle)
    aside = 0.0 if found.y is None else found.y
    return found.radius * cosine - aside * sine, found.radius * sine + aside * cosine, found.z


def section(
    data: dict[str, Any], folder: str, angle: float, radius: float, y: float, feed: float | None = None
) -> bytes:
    """Return the part and the edge in the plane of the edge, to scale, and close by with the cusps beside it."""
    job = require(data, folder)
    part, tool, sense = job.part.aimed, job.tool, job.strategy.sense
    feed = feed or _feed(job)
    # The tip at this radius, and where the passes beside it stand at the same azimuth.
    ranks = np.arange(-PASSES, PASSES + 1)
    radii: Floats = np.asarray(radius + feed * ranks, dtype=np.float64)
    raised = None if y == 0 else np.full(radii.size, y)
    azimuths: Floats = angle + sense * TURN * np.arange(radii.size, dtype=np.float64)
    spiral = Spiral(angle=azimuths, radius=radii, y=raised)
    found = place(spiral, part, tool, along=job.strategy.along)
    here = PASSES
    low, high = tool.arc
    sweeps = np.linspace(low * 1.15, high * 1.15, 721)
    u, _, e = tool.edge(sweeps, sense)
    tip, tip_z = float(found.radius[here]), float(found.z[here])
    whole = tip + u
    across = np.linspace(whole.min(), whole.max(), 721)
    contact_u = float(found.contact_x[here] * math.cos(angle) + found.contact_y[here] * math.sin(angle))
    near = np.linspace(contact_u - PASSES * feed, contact_u + PASSES * feed, 961)
    designed = _along(part, angle, near, y)
    passes = np.stack([_height(tool, sense, near - radii[k]) + found.z[k] for k in range(radii.size)])
    # An edge that came from outside has already cut what lies outside of it.
    inward = not job.strategy.inside_out
    earlier = passes[ranks > 0] if inward else passes[ranks < 0]
    left = np.fmin(np.fmin.reduce(earlier, axis=0), passes[here])
    with np.errstate(invalid="ignore"):
        arrays = {
            "surface": np.stack((across, _along(part, angle, across, y)), axis=1),
            "edge": np.stack((whole, tip_z + e), axis=1),
            "near": near - contact_u, "edge_gap": passes[here] - designed, "left_gap": left - designed,
            "passes_gap": passes - designed,
        }  # fmt: skip
    header = {
        "angle": float(np.mod(angle, TURN)), "radius": radius, "feed": feed,
        "tip": {"radius": tip, "z": tip_z},
        "contact": {
            "u": contact_u, "x": float(found.contact_x[here]), "y": float(found.contact_y[here]),
            "z": float(found.contact_z[here]), "sweep": float(found.sweep[here]),
        },
        "clearance": float(found.clearance[here]), "nose_radius": tool.nose_radius, "arc": [low, high],
        "inward": inward,
        "varies": _stated_feed(job.servo(job.passes[-1])) is None,
    }  # fmt: skip
    return pack(header, arrays)


def _along(part: Part, angle: float, u: Floats, y: float) -> Floats:
    """Return the finished surface along the line under the edge, nan where the part ends."""
    cosine, sine = math.cos(angle), math.sin(angle)
    x, across = u * cosine - y * sine, u * sine + y * cosine
    inside: Bools = np.hypot(x, across) <= part.radius
    z = np.full(u.size, np.nan)
    z[inside] = part.surface.sag(x[inside], across[inside])
    return z


def _height(tool: Tool, sense: int, u: Floats) -> Floats:
    """Return how high the edge stands above the commanded tip at some distances from it, nan where it has none."""
    low, high = tool.arc
    ends = np.clip((u[[0, -1]] - tool.offset[0]) / tool.actual_radius, -0.999, 0.999)
    ends = np.clip(np.arcsin(ends) + np.array([-0.02, 0.02]), low * 1.1, high * 1.1)
    at, _, e = tool.edge(np.linspace(ends[0], ends[1], 8001), sense)
    return np.asarray(np.interp(u, at, e, left=np.nan, right=np.nan))
