"""Reading and writing measured maps, one module per file format; reading lens files.

A reader takes the path and the bytes of a file and returns a `turnwright.HeightMap` in mm, rows ascending in y.
To add a format, add a module here and a line to ``read.py`` (its signature) or ``write.py`` (its name).

Sizes stated in a file are compared with its length before memory is allocated. Every failure is a
`turnwright.errors.MapError` of one sentence. Lens files are read by ``zemax_lens.py`` and ``codev_lens.py`` into
the classes of ``lens.py``.
"""

from turnwright.files.codev import read_zernikes, write_zernikes
from turnwright.files.lens import LensFile, LensPhase, LensSide, LensSurface
from turnwright.files.lens_files import read_lens
from turnwright.files.read import read_map
from turnwright.files.slices import read_profile
from turnwright.files.write import write_grid_sag, write_map

__all__ = [
    "LensFile",
    "LensPhase",
    "LensSide",
    "LensSurface",
    "read_lens",
    "read_map",
    "read_profile",
    "read_zernikes",
    "write_grid_sag",
    "write_map",
    "write_zernikes",
]
