"""What the server takes, known to it and to the processes that work for it."""

__all__ = [
    "BODY_BYTES", "FILE_BYTES", "FILE_ENDINGS", "FILE_S", "FINER", "LONGEST_H", "MAP_TYPES", "MOST_POINTS",
    "PARSE_BYTES", "PARSE_S", "SPARE_BYTES",
]  # fmt: skip

FINER = 0.75
"""A window whose pixels are smaller than this share of those that a run has stored is generated."""

MOST_POINTS = 60_000_000
"""Points of all passes together in a job from a page: four times those of the freeform infrared lens."""

MAP_TYPES = (
    ".al3d", ".asc", ".csv", ".dat", ".datx", ".frt", ".grd", ".lext", ".npy", ".npz", ".opd", ".opdx", ".os3d", ".plu",
    ".plux", ".sdf", ".sur", ".txt", ".vk3", ".vk4", ".vk6", ".vk7", ".x3p", ".xyz",
)  # fmt: skip
"""Endings of measured files; what a file really is decides its reader."""

PARSE_S = 300.0
"""How long reading a measured file may take. [s]"""

PARSE_BYTES = 8 * 2**30
"""What a process that reads one may take beyond what it starts with."""

LONGEST_H = 48
"""How long a run may take. [h]"""

FILE_ENDINGS = {
    "heights": (".csv", ".dat", ".npz", ".sdf", ".txt", ".x3p", ".xyz"),
    "waviness": (".csv", ".txt"),
    "straightness": (".csv", ".txt"),
    "correction": (".npz",),
    "machine": (".toml",),
    "material": (".toml",),
    "instrument": (".toml",),
}
"""Kinds of files that a job may name, with their endings."""

BODY_BYTES = 8 * 2**20
"""Of a job or any other JSON."""

FILE_BYTES = 64 * 2**20
"""Of one of them."""

FILE_S = 30.0
"""How long reading one of them may take. [s]"""

SPARE_BYTES = 2**30
"""What must stay free on the disk."""
