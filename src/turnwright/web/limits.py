"""Limits shared by the server and its worker processes."""

__all__ = [
    "BODY_BYTES",
    "FILE_BYTES",
    "FILE_ENDINGS",
    "MAP_TYPES",
    "MAX_FILE_READ_S",
    "MAX_POINTS",
    "MAX_RUN_H",
    "MIN_FREE_BYTES",
    "PARSE_BYTES",
    "PARSE_S",
    "STORED_PIXEL_RATIO",
]  # fmt: skip

STORED_PIXEL_RATIO = 0.75
"""Ratio of window pixel to stored pixel below which a window is simulated instead of read."""

MAX_POINTS = 60_000_000
"""Points of all passes together in a job from the page: four times those of the freeform infrared lens."""

MAP_TYPES = (
    ".al3d", ".asc", ".csv", ".dat", ".datx", ".frt", ".grd", ".int", ".lext", ".npy", ".npz", ".opd", ".opdx", ".os3d",
    ".plu", ".plux", ".sdf", ".sur", ".txt", ".vk3", ".vk4", ".vk6", ".vk7", ".x3p", ".xyz",
)  # fmt: skip
"""File name extensions of measured maps; the reader is chosen by content."""

PARSE_S = 300.0
"""Time limit for reading a measured file. [s]"""

PARSE_BYTES = 8 * 2**30
"""Memory limit for reading a measured file, in addition to the memory at the start. [byte]"""

MAX_RUN_H = 48
"""Time limit of a run. [h]"""

FILE_ENDINGS = {
    "heights": (".csv", ".dat", ".npz", ".sdf", ".txt", ".x3p", ".xyz"),
    "waviness": (".csv", ".txt"),
    "straightness": (".csv", ".txt"),
    "correction": (".npz",),
    "machine": (".toml",),
    "material": (".toml",),
    "instrument": (".toml",),
    "dialect": (".toml",),
}
"""Kinds of files that a job may name, with their extensions."""

BODY_BYTES = 8 * 2**20
"""Size limit of a JSON request. [byte]"""

FILE_BYTES = 64 * 2**20
"""Size limit of a file that a job names. [byte]"""

MAX_FILE_READ_S = 30.0
"""Time limit for reading a file that a job names. [s]"""

MIN_FREE_BYTES = 2**30
"""Disk space that must stay free. [byte]"""
