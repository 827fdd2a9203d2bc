"""Prescriptions: one family per file, each a `Surface`."""

from turnwright.surface._surface import Surface

__all__ = ["Surface"]
