"""What a job's finishing pass leaves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turnwright.contact import place
from turnwright.generation import generate_points
from turnwright.motion import drive

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.job._schema import Job

__all__ = ["finished"]


def finished(job: Job, real: Job, x: Floats, y: Floats) -> Floats:
    """Return the heights that a job's finishing pass leaves if tool and machine are those of another job. (n,) [mm].

    Parameters
    ----------
    job
        That is planned and driven.
    real
        Whose tool cuts on whose machine.
    x, y
        Points. Each (n,) [mm]
    """
    aim, tool = job.part.aimed, job.tool.tool
    servo = job.servo(job.passes[-1])
    path = place(servo.spiral(aim, tool), aim, tool, along=job.strategy.along)
    motion = drive(path, servo, job.machine.machine, profile=job.strategy.profile(job.passes[-1]))
    return generate_points(motion, real.tool.tool, x=x, y=y, machine=real.machine.machine)
