"""Placing the tool: bring the real edge into contact with the surface, exactly."""

from turnwright.placing.contact import place, tip_height, touch
from turnwright.placing.tangent import Touch, follow

__all__ = ["Touch", "follow", "place", "tip_height", "touch"]
