"""What the server takes, known to it and to the processes that work for it."""

__all__ = ["FINER", "MAP_TYPES", "MOST_POINTS"]

FINER = 0.75
"""A window whose pixels are smaller than this share of those that a run has stored is generated."""

MOST_POINTS = 60_000_000
"""Points of all passes together in a job from a page: four times those of the freeform infrared lens."""

MAP_TYPES = (
    ".asc", ".al3d", ".csv", ".dat", ".datx", ".h5", ".npy", ".npz", ".opd", ".plux", ".sdf", ".sur", ".pro", ".txt",
    ".x3p", ".xyz", ".zmp",
)  # fmt: skip
"""Endings of measured files; what a file really is decides its reader."""
