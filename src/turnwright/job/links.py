"""Prove that no move of a program outside its finishing cut brings the tool below what it should leave."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path as File

import numpy as np

from turnwright._arrays import Floats
from turnwright.job.approach import blank_heights
from turnwright.job.schema import Job
from turnwright.post import Move, read_moves
from turnwright.units import say_length

__all__ = ["find_wrong_move"]

TOLERANCE_MM = 1e-3
"""Depth below the material up to which a move is not refused; covers the steps of the comparison."""

AZIMUTHS, RADII, PLACES = 360, 2000, 400
"""Lines around the axis, steps along each, and most places along a move where the tool is compared with the part."""

TURN = 2 * math.pi


def find_wrong_move(job: Job, file: File, *, block_delete: bool | None = None) -> str:
    """Return a sentence on the first move that brings the edge below the part, or in rapid or at rest into the stock.

    The moves are those of `turnwright.post.read_moves` but for the last cut, as straight lines. The edge is that of the
    nominal tool. The part ends at its clear aperture, stock at the blank if the job states one. Empty if there is none.
    """
    section = _Section(job)
    moves = read_moves(file, job.machine, block_delete=block_delete)
    last_cut = max((move.spindle_cut for move in moves), default=0)
    is_cut = False  # whether anything has touched the stock before
    for move in moves:
        raised = not is_cut and not move.cuts and not move.spindle_cut and (move.is_rapid or not move.turns)
        if move.spindle_cut:
            is_cut = is_cut or section.depth(move, raised=True)[0] > TOLERANCE_MM
            if move.spindle_cut == last_cut:
                continue
        depth, x, z = section.depth(move, raised=raised)
        if depth > TOLERANCE_MM:
            what = "stock" if raised and section.depth(move, raised=False)[0] <= TOLERANCE_MM else "finished surface"
            how = " in rapid" if move.is_rapid else "" if move.turns else " with the part at rest"
            where = f"X {x:.4g} mm, Z {z:.4g} mm" if math.isfinite(x) else f"Z {z:.4g} mm while X is not known"
            return (
                f"line {move.line} moves the tool to {where}{how}, {say_length(depth)} below the {what}: correct its "
                "approach or retract"
            )
    return ""


class _Section:
    """Lines through the axis of the part, and the edge above them."""

    def __init__(self, job: Job) -> None:
        self.part, self.tool = job.part.continued, job.tool
        self.edge = job.tool.cutting_edge(job.strategy.sense)
        self.line = lru_cache(maxsize=64)(self._line)

    def _line(self, angles: tuple[float, ...], *, raised: bool) -> tuple[Floats, Floats]:
        """Return places on a line through the axis, and the highest of some azimuths of the finished surface or stock.

        Each (n,) [mm]. Azimuths of the negative side are half a turn on.
        """
        part = self.part
        reach = part.blank.reach if raised and part.blank is not None else part.reach
        radius = np.linspace(0, reach, RADII + 1)
        sides = []
        for turn in (0.0, math.pi):
            around = np.asarray(angles) + turn
            if raised:
                heights = blank_heights(part, radius, around, 0.0)
            else:
                inside = radius * (1 - 1e-12)
                heights = part.heights(inside * np.cos(around)[:, None], inside * np.sin(around)[:, None])
                heights = np.where(np.isnan(heights), -np.inf, heights)
            sides.append(heights.max(axis=0))
        return np.concatenate((-radius[::-1], radius)), np.concatenate((sides[1][::-1], sides[0]))

    def depth(self, move: Move, *, raised: bool) -> tuple[float, float, float]:
        """Return the largest depth of the edge below the material in a move, -inf if it is clear of it, and X and Z."""
        at, height = self.line(_angles(move, self.part.surface.of_revolution), raised=raised)
        dx, _, dz = self.tool.offset
        worst = (-math.inf, math.nan, math.nan)
        for x, z in _places(move, float(at[-1]) + 2 * self.edge.half_width):
            if not math.isfinite(x):  # anywhere
                worst = max(worst, (float(height.max()) - z, x, z), key=lambda one: one[0])
                continue
            with np.errstate(invalid="ignore"):
                low = self.edge.rake_cos * self.edge.profile(at - x - dx)[0]
                gap = height - low - dz
            worst = max(worst, (float(np.nanmax(gap, initial=-math.inf)) - z, x, z), key=lambda one: one[0])
        return worst


def _angles(move: Move, is_alike: bool) -> tuple[float, ...]:
    """Return the azimuths that are under the tool in a move."""
    c0, c1 = move.start[0], move.end[0]
    if is_alike:
        return (0.0,)
    if math.isfinite(c1) and not move.turns:
        return (c1 % TURN,)
    if math.isfinite(c0) and math.isfinite(c1) and abs(c1 - c0) < TURN and c0 != c1:
        return tuple(np.linspace(c0, c1, 1 + math.ceil(abs(c1 - c0) / TURN * AZIMUTHS)).tolist())
    return tuple((np.arange(AZIMUTHS) * (TURN / AZIMUTHS)).tolist())


def _places(move: Move, reach: float) -> Iterable[tuple[float, float]]:
    """Return X and Z of places along a move within reach of the part; X is nan where it is not known."""
    (_, x0, z0), (_, x1, z1) = move.start, move.end
    if not math.isfinite(z1):
        return []
    if not math.isfinite(x1):
        return [(math.nan, z1)]
    if not math.isfinite(x0) or not math.isfinite(z0):
        return [(x1, z1)]
    if x0 == x1:
        return [(x1, min(z0, z1))] if z1 < z0 else [(x1, z1)]
    low, high = sorted(min(max((bound - x0) / (x1 - x0), 0.0), 1.0) for bound in (-reach, reach))
    share = np.linspace(low, high, PLACES)
    return zip((x0 + share * (x1 - x0)).tolist(), (z0 + share * (z1 - z0)).tolist(), strict=True)
