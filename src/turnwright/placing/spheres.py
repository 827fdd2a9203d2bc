"""A round nose on an array of spheres, in closed form along the radial line.

The radial plane cuts a sphere in a circle. A round nose in that plane touches it where both centres are in line with
the contact; if that is outside the lens, it touches at the lens's near end. The highest of the lenses under the edge
counts: no place is searched for, and none of the surface is sampled but the numbers of its lenses, between which the
valleys and ridges are located.

Sources
-------
Reference solutions of the tests: brute-force dilation.
"""

from __future__ import annotations

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._kernels import spheres as kernel
from turnwright.placing.breaks import find_segments
from turnwright.placing.tangent import MAX_CURVATURE_RATIO, Contact, Tips, Touch
from turnwright.surface import Spheres

__all__ = ["touch_spheres"]


def touch_spheres(
    contact: Contact, spheres: Spheres, tips: Tips, rows: Tips, offsets: Ints, position: Floats, u: Floats
) -> Touch | None:
    """Return the contacts of an upright round edge that is steeper than the spheres; ``None`` if one is not certain.

    The tips are on the lines of ``rows``, sampled at ``u`` (rows, n): row i holds the positions offsets[i] to
    offsets[i + 1] of ``position``, from the tip of the row. [mm]
    """
    edge = contact.edge
    top, at = np.empty((2, position.size))
    certain = kernel.touch(
        edge, np.cos(rows.angle), np.sin(rows.angle), rows.radius + edge.dx, offsets, position,
        *find_segments(contact, rows, u), *spheres, MAX_CURVATURE_RATIO, top, at,
    )  # fmt: skip
    return contact.touch(tips, top - edge.dz, edge.sweeps(at)) if certain else None
