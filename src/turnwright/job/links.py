"""Prove that no move of a program outside its cuts brings the tool below what it should leave."""

from __future__ import annotations

import math
from pathlib import Path as File

import numpy as np

from turnwright._arrays import Floats
from turnwright.job.approach import Material, finished_material
from turnwright.job.schema import Job
from turnwright.post import Move, read_moves
from turnwright.units import say_length

__all__ = ["find_wrong_move"]

MOVE_SAMPLES = 33
"""Places along a move of X where the tool is compared with the part."""

TOLERANCE_MM = 5e-3
"""Depth below the material up to which a move is not refused; covers the steps of the comparison."""

TURN = 2 * math.pi


def find_wrong_move(job: Job, file: File, *, block_delete: bool | None = None) -> str:
    """Return a sentence on the first move that brings the edge below the part, or in rapid or at rest into the stock.

    The edge is that of the nominal tool, moves are straight. Empty if there is none.
    """
    for move in read_moves(file, job.machine, block_delete=block_delete):
        through_air = move.cuts == 0 and (move.is_rapid or not move.turns)
        for x, z in _places(move):
            material = finished_material(job.part, job.tool, x, job.part.stock if through_air else 0.0)
            depth = _contact(material, job, x, move) - z
            if depth > TOLERANCE_MM:
                what = "stock" if through_air and depth <= job.part.stock else "finished surface"
                how = " in rapid" if move.is_rapid else "" if move.turns else " with the part at rest"
                return (
                    f"line {move.line} moves the tool to X {x:.4g} mm, Z {z:.4g} mm{how}, {say_length(depth)} below "
                    f"the {what}: correct its approach or retract"
                )
    return ""


def _places(move: Move) -> list[tuple[float, float]]:
    """Return X and Z of places along a move: its lower end, or several if it moves X; none if they are not known."""
    (_, x0, z0), (_, x1, z1) = move.start, move.end
    if not math.isfinite(x1) or not math.isfinite(z1):
        return []
    if not math.isfinite(x0) or not math.isfinite(z0):
        return [(x1, z1)]
    if x0 == x1:
        return [(x1, min(z0, z1))] if z1 < z0 else [(x1, z1)]
    share = np.linspace(0, 1, MOVE_SAMPLES)
    return list(zip((x0 + share * (x1 - x0)).tolist(), (z0 + share * (z1 - z0)).tolist(), strict=True))


def _contact(material: Material, job: Job, x: float, move: Move) -> float:
    """Return the tip height of first contact at X: anywhere around the axis, or at the azimuth where the part rests."""
    contact: Floats = material.contact_height(job.tool, job.strategy.sense, x, 0.0)
    if move.turns or not math.isfinite(move.end[0]):
        return float(contact.max())
    return float(contact[round(np.mod(move.end[0], TURN) / TURN * contact.size) % contact.size])
