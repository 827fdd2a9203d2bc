"""Placing the tool: bring the real edge into contact with the surface, exactly."""

from turnwright.placing.contact import place, tip_height, touch, touch_down
from turnwright.placing.tangent import Tips, Touch, follow

__all__ = ["Tips", "Touch", "follow", "place", "tip_height", "touch", "touch_down"]
