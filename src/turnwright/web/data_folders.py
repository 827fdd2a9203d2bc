"""Folders that the wheel holds next to the server, and a checkout elsewhere."""

from __future__ import annotations

from pathlib import Path

__all__ = ["shipped_folder"]

HERE = Path(__file__).resolve().parent


def shipped_folder(name: str, in_checkout: str) -> Path | None:
    """Return a folder by its name in an installed package or its path in a checkout; ``None`` if neither exists."""
    places = (HERE / name, HERE.parents[2] / in_checkout)
    return next((place for place in places if place.is_dir()), None)
