"""Placing the tool: bring the real edge into contact with the surface, exactly."""

from turnwright.placing.contact import place
from turnwright.placing.search import Touch, follow, tip_height, touch

__all__ = ["Touch", "follow", "place", "tip_height", "touch"]
