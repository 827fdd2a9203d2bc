"""The kernels of the simulation, compiled in a second process during the first run on a machine."""

from __future__ import annotations

import numpy as np

from turnwright.generation import generate, generate_polar
from turnwright.job.extremes import find_extremes
from turnwright.machine import Machine
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.progress import cores
from turnwright.surface import Plane
from turnwright.tool import Tool

__all__ = ["compile_simulation", "compile_simulation_ahead"]


def compile_simulation_ahead() -> None:
    """Compile the kernels of the simulation in a second process, if they are not compiled yet and a core is free."""
    from turnwright._kernels.compiling import compile_ahead  # noqa: PLC0415 - numba is costly to import

    if cores() > 1:
        compile_ahead("generation", "from turnwright.job import compile_simulation; compile_simulation()")


def compile_simulation() -> None:
    """Simulate a small flat part in every way that a run does."""
    angle = np.linspace(0.0, 60.0, 400)
    machine, tool = Machine.load("generic"), Tool(nose_radius=0.5, included=2.0)
    axes = {"C": angle, "X": 1.0 - angle / 60.0, "Z": np.zeros(angle.size)}
    motion = Motion(time=angle, axes=axes, machine=machine)
    some = np.linspace(0.1, 0.9, 20)
    generate_polar(motion, tool, radius=some, angle=np.linspace(0.0, 6.0, 20))
    find_extremes(motion, tool, Part(surface=Plane(slope=(0.0, 0.0)), radius=0.9))
    generate(motion, tool, x=some, y=some)
