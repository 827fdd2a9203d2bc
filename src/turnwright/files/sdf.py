"""ISO 25178-71 ``.sdf``, text or binary, revisions 1 and 2 and their forerunner BCR, read by sdfio.

Rows ascend in y as in the standard; in BCR files they descend, as MountainsMap reads them. A profile is one row.

Sources
-------
Oracles: files on which sdfio, SurfaceTopography, surfalize and Gwyddion agree; files packed field by field.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from turnwright.files.base import damaged, grid_map, require_points
from turnwright.heightmap import HeightMap

__all__ = ["SIGNATURE", "read"]

SIGNATURE = re.compile(rb"(\xef\xbb\xbf)?[abAB](ISO|BCR)-\d\.\d")


def read(path: Path, data: bytes) -> HeightMap:
    """Read an SDF file."""
    import sdfio  # noqa: PLC0415 - needed by few

    # sdfio allocates no more memory than the length of the file justifies.
    file = sdfio.SdfFile.loads(data)
    header = file.header
    rows, columns = file.data.shape
    require_points(path, columns, rows)
    if not (math.isfinite(header.z_scale) and header.z_scale != 0):
        raise damaged(path, f"scales its heights by {header.z_scale:g}, it must be finite and not 0")
    trailer = file.trailer if isinstance(file.trailer, str) else file.trailer.decode("latin-1")
    along_x = header.x_scale * 1e3
    return grid_map(
        path,
        np.asarray(file.data * 1e3),
        (along_x, header.y_scale * 1e3 if rows > 1 else along_x),
        metadata={
            "format": f"ISO 25178-71 .sdf, {header.magic}",
            "manufacturer": header.manufacturer_id,
            "date": header.create_date.isoformat() if header.create_date else "",
            "comment": " ".join(trailer.split())[:1000].rstrip("* "),
        },
    )
