"""Strategies: where the tool is sent, and which axes send it there. One way of cutting per file."""

from turnwright.strategy.adaptive import AdaptiveToolServo
from turnwright.strategy.base import STRATEGIES, Strategy
from turnwright.strategy.elliptical import QuasiEllipticalToolServo, Valleys
from turnwright.strategy.fast import FastToolServo
from turnwright.strategy.hybrid import HybridToolServo
from turnwright.strategy.slow import SlowToolServo
from turnwright.strategy.turning import Turning, find_asymmetry, revolve

__all__ = [
    "STRATEGIES",
    "AdaptiveToolServo",
    "FastToolServo",
    "HybridToolServo",
    "QuasiEllipticalToolServo",
    "SlowToolServo",
    "Strategy",
    "Turning",
    "Valleys",
    "find_asymmetry",
    "revolve",
]
