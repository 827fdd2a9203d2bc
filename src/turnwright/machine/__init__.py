"""The lathe: limits, dynamics and geometric errors of its axes, and its controller."""

from turnwright.machine.axes import FAST, ROTARY, Axis
from turnwright.machine.blending import Blended, blend_blocks
from turnwright.machine.controller import INTERPOLATIONS, Controller, Convention
from turnwright.machine.lathe import PLAUSIBLE, ErrorSizes, Machine
from turnwright.machine.responses import FrequencyResponse, RationalResponse, Response, SecondOrder, TransferFunction

__all__ = [
    "FAST",
    "INTERPOLATIONS",
    "PLAUSIBLE",
    "ROTARY",
    "Axis",
    "Blended",
    "Controller",
    "Convention",
    "ErrorSizes",
    "FrequencyResponse",
    "Machine",
    "RationalResponse",
    "Response",
    "SecondOrder",
    "TransferFunction",
    "blend_blocks",
]
