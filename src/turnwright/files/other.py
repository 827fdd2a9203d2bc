"""Formats that SurfaceTopography reads, an optional extra: ``pip install turnwright[formats]``.

The first row is the top of the picture in all of them. Heights of ``.opd``, ``.al3d`` and ``.frt`` files were compared
with other readers; ``.nms`` files are refused, as readers disagree on the sign of their heights.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np

from turnwright.errors import MapError
from turnwright.files.base import grid_map, require_points, to_mm
from turnwright.heightmap import HeightMap

__all__ = ["DISPUTED", "SUFFIXES", "read", "refuse"]

SUFFIXES = {
    **{f".{name}": name for name in ("al3d", "frt", "lext", "opd", "opdx", "os3d", "plux")},
    **{f".vk{version}": "vk" for version in (3, 4, 6, 7)},
}
"""Format of SurfaceTopography by suffix. No other is tried, as one of them logs all bytes of the file."""

DISPUTED = ".nms"


def refuse(path: Path, _: bytes) -> HeightMap:
    """Raise for a format on which readers disagree."""
    raise MapError(
        f"{path} is {DISPUTED}, a format for which readers disagree on the sign of z: export it as .x3p or .sdf"
    )


def read(path: Path, data: bytes) -> HeightMap:
    """Read a file through SurfaceTopography."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from SurfaceTopography.IO import open_topography  # noqa: PLC0415 - an optional extra, costly to import
    except ImportError as error:
        raise MapError(
            f"{path} is read through SurfaceTopography, which is not installed: pip install 'turnwright[formats]', or "
            "export it as .x3p or .sdf"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with open_topography(io.BytesIO(data), format=SUFFIXES[path.suffix.lower()]) as reader:
                channel = reader.default_channel
                require_points(path, *channel.nb_grid_pts)
                topography = reader.topography(channel_index=channel.index)
                heights = np.ma.filled(np.ma.asarray(topography.heights(), dtype=np.float64), np.nan)
                unit, sizes = topography.unit, topography.physical_sizes
                kind = reader.format()
    except MapError:
        raise
    except Exception as error:
        raise MapError(
            f"{path} cannot be read by SurfaceTopography ({type(error).__name__}): it is damaged, or export it as .x3p"
        ) from error
    if unit is None:
        raise MapError(f"{path} does not state the unit of its heights: export it as .x3p or .sdf")
    scale = to_mm(unit, f"{path} states its heights in")
    pixel = None
    if sizes is not None:
        pixel = (sizes[0] / heights.shape[0] * scale, sizes[1] / heights.shape[1] * scale)
    return grid_map(
        path,
        np.ascontiguousarray(heights.T[::-1]) * scale,
        pixel,
        metadata={"format": f"{kind}, by SurfaceTopography"},
    )
