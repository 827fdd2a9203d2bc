r"""Placing the tool: bring the real edge into contact with the surface, exactly.

Along Z the tip goes straight down until the edge touches: the dilation of `turnwright.dilation`, free of gouges by
construction. Along the normal the contact point stays where the spiral sends it and the tip moves aside,

.. math:: \rho' = \rho - u(s), \qquad z' = f(\rho, \theta) - e(s), \qquad e'(s)/u'(s) = f_\rho

with s the place on the nose whose tangent is the surface's; for a perfect nose u = R sin s and e = R (1 - cos s). That
can gouge elsewhere, so the clearance of the whole edge is measured by the dilation at the new tip.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from turnwright._arrays import Floats
from turnwright.dilation import touch
from turnwright.errors import GougeError, InputError
from turnwright.part import Part
from turnwright.path import Path, Spiral
from turnwright.progress import Progress
from turnwright.tool import Tool

__all__ = ["place"]


def place(
    spiral: Spiral,
    part: Part,
    tool: Tool,
    *,
    along: Literal["z", "normal"] = "z",
    progress: Progress | None = None,
) -> Path:
    """Place the edge on the finished surface at every point of a spiral.

    Parameters
    ----------
    spiral
        Where the tool is sent: the tip, or along the normal the contact point.
    part, tool
        What is to be left, and the real tool: its waviness, rake, radius error and offset are compensated.
    along
        "z" moves only Z and never gouges inside the clear radius and the lead-in; "normal" moves X and Z, and reports
        the clearance it leaves.
    progress
        Called with (done, total).

    Returns
    -------
    Path
        Commanded tip positions, contact points and the clearance of the whole edge.

    Raises
    ------
    DomainError
        If the edge touches where the surface is not defined.
    GougeError
        If the edge has no tangent of the surface's slope (along the normal).
    InputError
        If ``along`` is neither.

    Sources
    -------
    [Li2018]_, [Troutman2016]_ ch. 6; DESIGN of the exact maximum in `turnwright.dilation`.
    """
    if along not in ("z", "normal"):
        raise InputError(f'along is {along!r}, it must be "z" or "normal": choose one')
    angle, radius, sense = spiral.angle, spiral.radius, spiral.sense
    if along == "normal":
        return _along_normal(spiral, part, tool, progress)
    rim, y = part.radius, spiral.y
    at = touch(part.surface, tool, angle=angle, radius=radius, y=y, sense=sense, rim=rim, progress=progress)
    # Nowhere on the edge is there less clearance than at the maximum itself; there it is what rounding leaves of 0. On
    # the wall of a step the contact point, rounded, may fall to the foot of the wall, and right on an axis without a
    # height there is none to compare with: neither is less than 0.
    with np.errstate(all="ignore"):
        left = at.surface_z - part.surface.evaluate(at.x, at.y, 0)[0]
    return Path(
        angle=angle, radius=radius, z=at.z, sweep=at.sweep, contact_x=at.x, contact_y=at.y, contact_z=at.surface_z,
        clearance=np.fmin(left, 0.0), y=y, y_rate=spiral.y_rate, radius_rate=spiral.radius_rate,
    )  # fmt: skip


def _along_normal(spiral: Spiral, part: Part, tool: Tool, progress: Progress | None) -> Path:
    angle, contact, sense = spiral.angle, spiral.radius, spiral.sense
    aside = np.zeros(angle.size) if spiral.y is None else spiral.y
    sweep, x, y, surface_z = _tangent(part, tool, angle, contact, aside, sense)
    u, _, e = tool.edge(sweep, sense)
    radius, z = contact - u, surface_z - e
    rim = part.radius
    at = touch(part.surface, tool, angle=angle, radius=radius, y=aside, sense=sense, rim=rim, progress=progress)
    return Path(
        angle=angle, radius=radius, z=z, sweep=sweep, contact_x=x, contact_y=y, contact_z=surface_z,
        clearance=z - at.z, y=spiral.y,
    )  # fmt: skip


def _tangent(
    part: Part, tool: Tool, angle: Floats, contact: Floats, aside: Floats, sense: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return sweep, x, y and height where the edge's tangent is the surface's, at ``contact`` along the rake plane."""
    from turnwright._kernels import dilation as kernel  # noqa: PLC0415 - numba is costly to import

    edge = tool.table(sense)
    cosine, sine = np.cos(angle), np.sin(angle)
    sweep = np.zeros(angle.size)
    across = aside + edge.row[6]
    for _ in range(20):
        x, y = contact * cosine - across * sine, contact * sine + across * cosine
        surface_z = part.surface.sag(x, y)
        zx, zy = part.surface.gradient(x, y)
        kernel.tangent_sweep(*edge, zx * cosine + zy * sine, zy * cosine - zx * sine, sweep)
        if not np.isfinite(sweep).all():
            k = int(np.argmin(np.isfinite(sweep)))
            low, high = np.rad2deg(tool.arc)
            raise GougeError(
                f"the surface slopes {np.rad2deg(np.arctan(np.hypot(zx[k], zy[k]))):.4g} deg at x = {x[k]:.6g} mm, "
                f"y = {y[k]:.6g} mm, the arc of the tool holds tangents from {low:.4g} to {high:.4g} deg: "
                "take a tool with a larger included angle"
            )
        moved = aside + tool.edge(sweep, sense)[1]
        # An upright edge stays in the radial plane; a leaning one moves aside with its place on the nose.
        if np.abs(moved - across).max() < 1e-15:
            break
        across = moved
    return sweep, x, y, surface_z
