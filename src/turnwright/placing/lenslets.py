"""A round nose on an array of lenslets of revolution, along the radial line.

Where the radial plane cuts each lenslet in a profile that curves up less than the nose, the nose touches it at one
place, or at the near end of the lenslet. The highest of the lenslets under the edge counts. Newton's method begins with
the closed form on the vertex spheres, where the centres of section and nose are in line with the contact; on spheres
that is exact. None of the surface is sampled but the numbers of its lenslets, between which the valleys and ridges are
located.

Sources
-------
Reference solutions of the tests: brute-force dilation.
"""

from __future__ import annotations

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._kernels import lenslets as kernel
from turnwright.placing.breaks import find_segments
from turnwright.placing.tangent import MAX_CURVATURE_RATIO, Contact, Tips, Touch
from turnwright.surface import Lenslets

__all__ = ["touch_lenslets"]


def touch_lenslets(
    contact: Contact, lenslets: Lenslets, tips: Tips, rows: Tips, offsets: Ints, position: Floats, u: Floats
) -> Touch | None:
    """Return the contacts of an upright round edge that is steeper than the lenslets; ``None`` if one is not certain.

    The tips are on the lines of ``rows``, sampled at ``u`` (rows, n): row i holds the positions offsets[i] to
    offsets[i + 1] of ``position``, from the tip of the row. [mm]
    """
    edge = contact.edge
    top, at = np.empty((2, position.size))
    certain = kernel.touch(
        edge, np.cos(rows.angle), np.sin(rows.angle), rows.radius + edge.dx, offsets, position,
        *find_segments(contact, rows, u), *lenslets, MAX_CURVATURE_RATIO, contact.surface.feature_size, top, at,
    )  # fmt: skip
    return contact.touch(tips, top - edge.dz, edge.sweeps(at)) if certain else None
