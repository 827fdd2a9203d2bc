"""Whole parts at a pixel of micrometres: made tile by tile into a store on disk, looked at and judged from there."""

from turnwright.tiling._generate import generate_tiled, planned_layout
from turnwright.tiling._map import TiledMap

__all__ = ["TiledMap", "generate_tiled", "planned_layout"]
