"""Motion of the axes in time, and the limits of the machine."""

from turnwright.motion.driving import drive, require_variable
from turnwright.motion.limits import Limits, check_limits
from turnwright.motion.pvt import from_rest_to_rest

__all__ = ["Limits", "check_limits", "drive", "from_rest_to_rest", "require_variable"]
