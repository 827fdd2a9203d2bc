"""Strategies: where the tool is sent, and which axes send it there. One way of cutting per file."""

from turnwright.strategy._strategy import Strategy
from turnwright.strategy.slow import SlowToolServo

__all__ = ["SlowToolServo", "Strategy"]
