"""Prove that no move of a program, in a cut or outside, brings the tool below what it should leave."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path as File

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.job.approach import blank_heights
from turnwright.job.depths import block_over, chord_over, depth_at_border, depth_at_points
from turnwright.job.programs import read_back
from turnwright.job.schema import Job
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.post import Move, ProgramCut, read_cut_and_moves, read_moves
from turnwright.progress import Progress
from turnwright.tool import Shank, Tool
from turnwright.units import say_length

__all__ = ["find_wrong_move", "read_and_check"]

TOLERANCE_MM = 1e-3
"""Depth below the material up to which a move is not refused; covers the steps of the comparison."""

AZIMUTHS, RADII, PLACES = 360, 2000, 400
"""Lines around the axis, steps along each, and most places along a move where the tool is compared with the part."""

FEW_RADII = 400
"""Steps along a line where the part at rest is compared with shank and holder."""

EDGE_STEPS, MOST_EDGE_PLACES = (16, 200), 5_000_000
"""Fewest and most steps along the edge at a point of a cut, and most places on the edge in all of a cut."""

WIDE_STEPS, FINE_STEP_RAD = 3.0, math.radians(0.5)
"""Step of C, over the median one of a cut, from which its block counts between its points too, and how densely."""

MOST_JUDGED, WIDEST_CUT_STEP_RAD = 200, math.radians(15)
"""Places, the deepest first, that are compared with the chord of their block, and the most that such a block turns."""

TURN = 2 * math.pi
ALL_AROUND = tuple((np.arange(AZIMUTHS) * (TURN / AZIMUTHS)).tolist())


def find_wrong_move(job: Job, file: File, *, block_delete: bool | None = None) -> str:
    """Return a sentence on the first move that brings the tool below the part, or in rapid or at rest into the stock.

    Moves outside the cuts with C as an axis are those of `turnwright.post.read_moves`, as straight lines. The tool is
    the nominal one of each pass: its edge with the flanks, and its shank and holder if they are stated. The part ends
    at its clear aperture, stock at the blank if the job states one.

    In the cuts the edge is compared with the finished surface at every point, and on the borders of an outline or a
    chuck between the points too. Empty if there is none.
    """
    check = _Check(job, is_planned=False)
    moves = read_moves(file, job.machine, inspect=check.inspect if check.is_tip else None, block_delete=block_delete)
    return check.judge(moves)


def read_and_check(job: Job, file: File, name: str, update: Progress | None = None) -> tuple[Motion, Callable[[], str]]:
    """Read a pass of a program that was planned for a job; return it, and a function that finds a wrong move.

    The function returns the sentence of `find_wrong_move`. In the cuts the edge is compared with the finished surface
    on borders, at points only in the plunges.
    """
    check, machine = _Check(job, is_planned=True), job.machine
    inspect = check.inspect if check.is_tip else None
    if job.program.fast_tool is None and not (check.is_tip and check.has_borders):
        motion, moves = read_cut_and_moves(file, machine, name=name, inspect=inspect, progress=update)
        return motion, lambda: check.judge(moves)
    motion = read_back(job, file, name, update)
    return motion, lambda: check.judge(read_moves(file, machine, inspect=inspect))


class _Check:
    """The comparison of the moves of a program with the part."""

    def __init__(self, job: Job, *, is_planned: bool) -> None:
        jobs = [next(group) for _, group in groupby(map(job.for_pass, job.passes), lambda one: one.tool)]
        self.sections = [_Section(job, one.tool) for one in jobs]
        self.called = _called_sections(job, self.sections)
        self.chord = max(getattr(job.servo(one).spiral_strategy, "chord", None) or 0.0 for one in job.passes)
        self.is_planned = is_planned
        # The tip of a fast tool, or in a precorrected program, is not where the program says.
        self.is_tip = not job.program.fast_tool and not job.program.precorrect
        self.has_borders = any(one.part.leaves_air for one in self.sections)
        self.wrong = ""

    def inspect(self, cut: ProgramCut) -> None:
        """Note the deepest place of a cut or plunge, if it is too deep."""
        if not self.wrong:
            section, at_points = self._section(cut), cut.is_entry or not self.is_planned
            self.wrong = _describe_depth(section, cut, self.chord, at_points=at_points)

    def judge(self, moves: Sequence[Move]) -> str:
        """Return a sentence on the first wrong move, or else on the first cut that is too deep."""
        last_cut = max((move.spindle_cut for move in moves), default=0)
        is_cut = False  # whether anything has touched the stock before
        for move in moves:
            section = self._section(move)
            raised = not is_cut and not move.cuts and not move.spindle_cut and (move.is_rapid or not move.turns)
            if move.spindle_cut:
                is_cut = is_cut or section.depth(move, raised=True)[0] > TOLERANCE_MM
                if move.spindle_cut == last_cut:
                    continue
            depth, x, z, body = section.depth(move, raised=raised)
            if depth > TOLERANCE_MM:
                what = (
                    "stock" if raised and section.depth(move, raised=False)[0] <= TOLERANCE_MM else "finished surface"
                )
                how = " in rapid" if move.is_rapid else "" if move.turns else " with the part at rest"
                where = f"X {x:.4g} mm, Z {z:.4g} mm" if math.isfinite(x) else f"Z {z:.4g} mm while X is not known"
                which = (
                    f"{say_length(depth)} below" if not body else f"which brings its {body} {say_length(depth)} into"
                )
                return (
                    f"line {move.line} moves the tool to {where}{how}, {which} the {what}: correct its approach or "
                    "retract"
                )
        return self.wrong

    def _section(self, of: Move | ProgramCut) -> _Section:
        return self.called.get(of.tool, self.sections[min(of.changes, len(self.sections) - 1)])


def _describe_depth(section: _Section, cut: ProgramCut, chord: float, *, at_points: bool) -> str:
    """Return a sentence on the place where a cut is deepest below the finished surface, if that is too deep."""
    part, tool, motion = section.part, section.tool, cut.motion
    most, block, x, y = TOLERANCE_MM + chord, -1, math.nan, math.nan
    judged: list[tuple[float, int, float, float, float]] = []  # depth, block and share of it, and where
    if at_points:
        dense, blocks, shares = _with_wide_blocks(motion)
        steps = int(np.clip(MOST_EDGE_PLACES // dense.time.size, *EDGE_STEPS))
        depths = depth_at_points(part, tool, dense, steps)
        judged += [
            (float(depths.depth[k]), int(blocks[k]), float(shares[k]), float(depths.x[k]), float(depths.y[k]))
            for k in _deepest(depths.depth, most)
        ]
    if part.leaves_air and motion.spindle_mode is None:
        depths = depth_at_border(part, tool, motion)
        for k in _deepest(depths.depth, most):
            at = float(depths.x[k]), float(depths.y[k])
            judged.append((float(depths.depth[k]), *block_over(motion, tool, *at), *at))
    for depth, number, share, at_x, at_y in sorted(judged, reverse=True):
        one, allowed = _nearest_part(part, at_x, at_y), 0.0
        if 0 < share < 1 and abs(np.diff(motion.axes["C"][number : number + 2])[0]) <= WIDEST_CUT_STEP_RAD:
            allowed = max(chord_over(one, tool, motion, number, share), 0.0)
        if depth > most and depth - allowed > TOLERANCE_MM + chord:
            most, block, x, y = depth, number, at_x, at_y
    if block < 0:
        return ""
    where = ", ".join(f"{letter} {motion.axes[letter][block + 1]:.4g} mm" for letter in "XZ")
    return (
        f"line {cut.line(block)} moves the tool to {where}, {say_length(most)} below the finished surface at x = "
        f"{x:.4g} mm, y = {y:.4g} mm: correct the {'plunge' if cut.is_entry else 'cut'}"
    )


def _deepest(depth: Floats, least: float) -> list[int]:
    """Return the deepest places, at most `MOST_JUDGED`, that are deeper than a depth."""
    order = np.argsort(-depth)[:MOST_JUDGED]
    return [int(k) for k in order[depth[order] > least]]


def _with_wide_blocks(motion: Motion) -> tuple[Motion, Ints, Floats]:
    """Return a motion with points between those of blocks that turn far, and of each point the block and its share."""
    steps = np.abs(np.diff(motion.axes["C"]))
    counts = np.where(steps > WIDE_STEPS * np.median(steps), np.ceil(steps / FINE_STEP_RAD), 1).astype(np.int64)
    if motion.spindle_mode is not None:
        counts[:] = 1
    block = np.repeat(np.arange(steps.size), counts)
    share = (np.arange(block.size) - np.repeat(np.cumsum(counts) - counts, counts) + 1) / counts[block]
    ends = np.append(0.0, block + share)
    number = np.arange(motion.time.size)
    axes = {letter: np.interp(ends, number, values) for letter, values in motion.axes.items()}
    dense = replace(motion, time=np.interp(ends, number, motion.time), axes=axes, velocity=None, stated_blocks=None)
    return dense, np.append(0, block), np.append(0.0, share)


def _nearest_part(part: Part, x: float, y: float) -> Part:
    """Return the part of a chuck that is nearest to a point."""
    return min(part.apart, key=lambda one: float(one.border.distance(np.array([x]), np.array([y]))[0]))


class _Section:
    """Lines through the axis of the part, and the edge above them."""

    def __init__(self, job: Job, tool: Tool) -> None:
        self.part, self.tool = job.part.aimed, tool
        self.edge = tool.cutting_edge(job.strategy.sense)
        self.line, self.polar = lru_cache(maxsize=64)(self._line), lru_cache(maxsize=2)(self._polar)

    def _line(self, angles: tuple[float, ...], *, raised: bool) -> tuple[Floats, Floats]:
        """Return places on a line through the axis, and the highest of some azimuths of the finished surface or stock.

        Each (n,) [mm]. Azimuths of the negative side are half a turn on.
        """
        sides = []
        for turn in (0.0, math.pi):
            radius, heights = self._heights(np.asarray(angles) + turn, RADII, raised=raised)
            sides.append(heights.max(axis=0))
        at, height = np.concatenate((-radius[::-1], radius)), np.concatenate((sides[1][::-1], sides[0]))
        border, top = self._border(angles, raised=raised)
        return np.concatenate((border, at)), np.concatenate((top, height))

    def _border(self, angles: tuple[float, ...], *, raised: bool) -> tuple[Floats, Floats]:
        """Return places and heights of the border of an outline, corners included, between some azimuths."""
        if not self.part.leaves_air or len(angles) == 1:
            return np.empty(0), np.empty(0)
        x, y = self.part.border.border()
        radius, low, high = np.hypot(x, y), min(angles), max(angles)
        height = self.part.surface.sag(x, y) + (self.part.stock if raised else 0.0)
        azimuth = np.arctan2(y, x) - low
        sides = []
        for sign, turn in ((1.0, 0.0), (-1.0, math.pi)):
            between = np.mod(azimuth - turn, TURN) <= high - low + (TURN if angles == ALL_AROUND else 0.0)
            sides.append((sign * radius[between], height[between]))
        return np.concatenate([at for at, _ in sides]), np.concatenate([top for _, top in sides])

    def _polar(self, *, raised: bool) -> tuple[Floats, Floats]:
        """Return radii (n,) and the finished surface or stock there at all azimuths, (n_angle, n). [mm]."""
        return self._heights(np.asarray(ALL_AROUND), FEW_RADII, raised=raised)

    def _heights(self, angle: Floats, steps: int, *, raised: bool) -> tuple[Floats, Floats]:
        part = self.part
        radius = np.linspace(0, part.blank.reach if raised and part.blank is not None else part.reach, steps + 1)
        if raised:
            return radius, blank_heights(part, radius, angle, 0.0)
        inside = radius * (1 - 1e-12)
        heights = part.heights(inside * np.cos(angle)[:, None], inside * np.sin(angle)[:, None])
        return radius, np.where(np.isnan(heights), -np.inf, heights)

    def depth(self, move: Move, *, raised: bool) -> tuple[float, float, float, str]:
        """Return the largest depth of the tool below the material in a move, -inf if it is clear of it.

        With X and Z there, and "shank" or "holder" if it is that of one.
        """
        at, height = self.line(_angles(move, self.part.surface.of_revolution), raised=raised)
        around = self.line(ALL_AROUND, raised=raised) if self.tool.bodies else (at, height)
        dx, _, dz = self.tool.offset
        wide = [2 * self.edge.half_width, *(math.hypot(*one.offset) + one.radius for one in self.tool.bodies.values())]
        worst = (-math.inf, math.nan, math.nan, "")
        for x, z in _places(move, float(at[-1]) + max(wide)):
            if not math.isfinite(x):  # anywhere
                worst = max(worst, (float(height.max()) - z, x, z, ""), key=lambda one: one[0])
                continue
            with np.errstate(invalid="ignore"):
                low = self.edge.rake_cos * self.edge.profile(at - x - dx)[0]
                gap = height - low - dz
            worst = max(worst, (float(np.nanmax(gap, initial=-math.inf)) - z, x, z, ""), key=lambda one: one[0])
            for name, one in self.tool.bodies.items():
                far = math.hypot(x + one.offset[0], one.offset[1])
                top = _highest(*around, far - one.radius, far + one.radius) - one.height
                if top - z > max(TOLERANCE_MM, worst[0]) and not move.turns and math.isfinite(move.end[0]):
                    top = self._under(one, x, move.end[0], raised=raised) - one.height
                worst = max(worst, (top - z, x, z, name), key=lambda one: one[0])
        return worst

    def _under(self, body: Shank, x: float, angle: float, *, raised: bool) -> float:
        """Return the highest material under a cylinder, with the part at rest. [mm]."""
        radius, height = self.polar(raised=raised)
        azimuth = np.asarray(ALL_AROUND)[:, None] - angle
        away = np.hypot(
            radius * np.cos(azimuth) - x - body.offset[0], radius * np.sin(azimuth) - body.offset[1]
        )  # fmt: skip
        return float(height.max(where=away <= body.radius + float(radius[1]), initial=-math.inf))


def _called_sections(job: Job, sections: list[_Section]) -> dict[float, _Section]:
    """Return the sections by the numbers of their tools, as far as tool calls state them."""
    calls = {job.tool_of(cut): cut.tool_call or job.program.tool_call for cut in job.passes}
    numbers = {tool: re.search(r"T(\d+)", call) for tool, call in calls.items()}
    return {float(number[1]): one for one in sections if (number := numbers.get(one.tool)) is not None}


def _highest(at: Floats, height: Floats, low: float, high: float) -> float:
    """Return the highest material between two distances from the axis. [mm]."""
    step = float(at[-1] - at[-2])
    within = (np.abs(at) >= low - step) & (np.abs(at) <= high + step)
    return float(height.max(where=within, initial=-math.inf))


def _angles(move: Move, is_alike: bool) -> tuple[float, ...]:
    """Return the azimuths that are under the tool in a move."""
    c0, c1 = move.start[0], move.end[0]
    if is_alike:
        return (0.0,)
    if math.isfinite(c1) and not move.turns:
        return (c1 % TURN,)
    if math.isfinite(c0) and math.isfinite(c1) and abs(c1 - c0) < TURN and c0 != c1:
        return tuple(np.linspace(c0, c1, 1 + math.ceil(abs(c1 - c0) / TURN * AZIMUTHS)).tolist())
    return ALL_AROUND


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
    share = np.linspace(low, high, 2 + math.ceil((high - low) * abs(x1 - x0) / (2 * reach) * PLACES))
    return zip((x0 + share * (x1 - x0)).tolist(), (z0 + share * (z1 - z0)).tolist(), strict=True)
