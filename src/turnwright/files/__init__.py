"""Measured maps come in and go out: one file format per module.

A reader is given the path and the bytes of a file and returns a `turnwright.HeightMap` in mm, rows ascending in y.
To add a format, add a module here and a line to ``read.py`` (its signature) or ``write.py`` (its suffix).

Whatever a file claims is compared with the bytes that are there before memory is asked for, and everything that goes
wrong ends in one sentence, a `turnwright.errors.MapError`.
"""

from turnwright.files.read import read_map
from turnwright.files.slices import read_profile
from turnwright.files.write import write_map

__all__ = ["read_map", "read_profile", "write_map"]
