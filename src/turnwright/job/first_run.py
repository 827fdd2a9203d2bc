"""The kernels of the simulation, compiled in a second process during the first run on a machine."""

from __future__ import annotations

import numpy as np

from turnwright.generation import generate, generate_points
from turnwright.machine import Machine
from turnwright.path import Motion
from turnwright.progress import cores
from turnwright.tool import Tool

__all__ = ["compile_simulation", "compile_simulation_ahead"]


def compile_simulation_ahead() -> None:
    """Compile half of the kernels in a second process, if none is compiled yet and a core is free."""
    from turnwright._kernels.compiling import compile_ahead  # noqa: PLC0415 - numba is costly to import

    if cores() > 1:
        code = "from turnwright.job import compile_simulation; compile_simulation()"
        compile_ahead("generation", ("scattered", "grid"), code)


def compile_simulation() -> None:
    """Simulate points and a grid of a flat part, which takes half of the compiler's time; rings take the other half."""
    angle = np.linspace(0.0, 60.0, 400)
    machine, tool = Machine.load("generic"), Tool(nose_radius=0.5, included=2.0)
    axes = {"C": angle, "X": 1.0 - angle / 60.0, "Z": np.zeros(angle.size)}
    motion = Motion(time=angle, axes=axes, machine=machine)
    some = np.linspace(0.1, 0.9, 20)
    generate_points(motion, tool, x=some, y=some)
    generate(motion, tool, x=some, y=some)
