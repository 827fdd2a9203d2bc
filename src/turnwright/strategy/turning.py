"""Turning in spindle mode: the spindle runs freely, X and Z follow the meridian of a surface of revolution."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._kernels import chord as kernel
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.outline import Outline
from turnwright.part import Part
from turnwright.path import POINTS_PER_REV, Path, SpindleMode, Spiral
from turnwright.placing import Tips, touch_down
from turnwright.progress import Progress, require_memory
from turnwright.strategy.base import Strategy, outermost_turn
from turnwright.strategy.ends import check_overrun, find_ends, require_overlap
from turnwright.strategy.sampling import TURN, check_count
from turnwright.surface import RadialTable, Surface
from turnwright.tool import Tool
from turnwright.units import Feed, Flag, Size, Speed, Thickness, unit

__all__ = ["Turning", "find_asymmetry", "revolve"]

MERIDIAN_SAMPLES = 20_000
"""Samples of the meridian for the length of the path."""

BULGE_FRACTION = 0.05
"""Bulge of the path between samples, as a fraction of the chord."""

MAX_CHORD_MM = 0.1
"""Largest chord; larger values are taken for a wrong unit."""

BYTES_PER_POINT = 400
"""Memory for a point of a path with its contact and motion."""

MIN_RINGS, MIN_AZIMUTHS, MAX_SAMPLES = 400, 64, 100_000_000
"""Fewest rings and points around each, and most points, at which a surface is compared with one of revolution."""

SAMPLES_PER_FEATURE = 6
REACH_FACTORS = (1.2, 1.1, 1.05, 1.02)
"""Reach of a surface of revolution made from another, as a multiple of the radius of the clear aperture; the first that
its source allows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turning(Strategy):
    r"""Turning in spindle mode, for surfaces of revolution: X and Z by straight lines, the spindle at a stated speed.

    The tip runs along the meridian by ``feed`` per revolution, measured along its path, so that the cusps of a sphere
    are equal everywhere. The program has the fewest points between which straight lines keep within ``chord``. The
    angle of the spindle is not known: what varies with the azimuth can neither be cut nor corrected.

    The fields of every strategy are those of `Strategy`.

    Parameters
    ----------
    feed
        Advance of the tip along its path per spindle revolution. [mm/rev]
    spindle_rpm
        Spindle speed; with ``surface_speed`` the highest one. [rev/min]
    chord
        Largest height between the exact path and straight lines between the points. [mm]
    surface_speed
        Constant speed of the part under the tip (G96), up to the highest spindle speed; a constant spindle speed if
        left out. It needs a feed per revolution. [mm/s]
    feed_mode
        Feed in the program: "mm/min" (G94) or "mm/rev" (G95).
    symmetric_part
        Cut a surface that is none of revolution at its highest height over the azimuth, as a roughing pass may.
    inside_out
        Cut from the centre to the rim.
    sense
        +1 for M04, where the azimuth of the part under the tool grows; -1 for M03.
    along
        How the tool is placed on the surface: along "z" or along the "normal" of the surface.
    lead_in
        Distance outside the clear aperture at which the tip starts; the least one that cuts the rim if left out. [mm]
    overrun
        Distance beyond the axis at which the tip ends, or starts; at most one feed. [mm]

    Raises
    ------
    InputError
        If a size is not positive, or a surface speed is stated with a feed per minute.

    Sources
    -------
    With equal distances :math:`d` of the passes along the path, neighbouring positions of the nose on a sphere are
    rotated about its centre, and the cusps are the intersections of two circles.

    >>> from turnwright.surface import Sphere
    >>> part, tool = Part(surface=Sphere(radius=50.0), radius=12.5), Tool(nose_radius=0.5)
    >>> spiral = Turning(feed=0.002, spindle_rpm=2000, chord=1e-6).spiral(part, tool)
    >>> round(spiral.turns)
    6319
    """

    kind = "turning"
    example = MappingProxyType({"feed": "2 um/rev", "spindle_speed": "2000 rpm", "chord": "1 nm"})
    ways = ("chord",)
    feed: Feed
    spindle_rpm: Speed
    chord: Size
    surface_speed: Annotated[float, unit("mm/s", above=0.0)] | None = None
    feed_mode: Literal["mm/min", "mm/rev"] = "mm/min"
    symmetric_part: Flag = False
    inside_out: Flag = False
    sense: Literal[1, -1] = 1
    along: Literal["z", "normal"] = "z"
    lead_in: Thickness | None = None
    overrun: Thickness = 0.0

    def __post_init__(self) -> None:
        self._check_fields()
        check_overrun(self.overrun, self.feed)
        if self.chord > MAX_CHORD_MM:
            raise InputError(f"chord is {self.chord:g} mm, the limit is {MAX_CHORD_MM:g} mm: check its unit")
        _ = self.spindle_mode

    @property
    def spindle_mode(self) -> SpindleMode:
        """Feed and speed of the spindle in spindle mode."""
        return SpindleMode(
            feed=self.feed, spindle_rpm=self.spindle_rpm, surface_speed=self.surface_speed,
            per_rev=self.feed_mode == "mm/rev",
        )  # fmt: skip

    def target(self, part: Part) -> Part:
        """Return the part that the tool is placed on: a surface of revolution, with the mean of its correction.

        It reaches around the axis, from the nearest to the farthest point of an outline.
        """
        surface = part.surface
        if part.leaves_air:
            ring = Outline(annulus=(part.reach, part.nearest)) if part.nearest > 0 else None
            part = replace(part, outline=ring, radius=None if ring else part.reach)
        if self.symmetric_part and find_asymmetry(surface, part.reach) > self.chord:
            surface = revolve(surface, part.reach, above=self.chord)
        if part.correction is not None:
            surface = surface + revolve(part.correction, part.reach)
        return replace(part, surface=surface, correction=None)

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral that the tip leaves for a start at azimuth 0, with some points per revolution.

        Raises
        ------
        InputError
            If the surface departs from a surface of revolution by more than the chord.
        """
        self._require_symmetric(part)
        edge = tool.cutting_edge(self.sense)
        require_overlap(edge, self.feed)
        end, start = find_ends(part, edge, self.feed, self.lead_in, self.overrun)
        radius = np.linspace(end, start, MERIDIAN_SAMPLES + 1)
        z, step = self._heights(part, edge, radius), radius[1] - radius[0]
        length = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(radius), np.diff(z)))))
        # Between points so dense the path bulges by a small fraction of the chord only.
        bend = np.abs(np.diff(np.pad(z, 1, mode="edge"), 2)) / step**2
        finest = np.sqrt(np.maximum(bend[1:], bend[:-1]) / (8 * BULGE_FRACTION * self.chord))
        points = np.maximum(np.diff(length) / self.feed * POINTS_PER_REV, step * finest)
        number = np.concatenate(([0.0], np.cumsum(points)))
        check_count(number[-1], "the feed and of the chord")
        require_memory(BYTES_PER_POINT * number[-1], f"a path of {number[-1]:.3g} points", "use a larger feed or chord")
        count = max(math.ceil(number[-1]), 1)
        if progress is not None:
            progress(0, count + 1)
        at = np.linspace(0.0, number[-1], count + 1)
        inner = np.interp(at, number, radius)
        turned = np.interp(inner, radius, length) / self.feed
        if not self.inside_out:
            inner, turned = inner[::-1], turned[-1] - turned[::-1]
        return Spiral(angle=self.sense * TURN * turned, radius=inner)

    def _heights(self, part: Part, edge: Edge, radius: Floats) -> Floats:
        """Return the tip height in contact; for a path along the normal, the surface as a length of the path. (n,)."""
        tips = Tips.at(np.zeros(radius.size), radius)
        return touch_down(part.surface, edge, tips, max(part.reach, float(radius[-1]))).z

    def _require_symmetric(self, part: Part) -> None:
        off = find_asymmetry(part.surface, part.reach)
        if off > self.chord:
            raise InputError(
                f"the surface departs from a surface of revolution by {off * 1e6:.4g} nm, in spindle mode the limit is "
                f"the chord, {self.chord * 1e6:.4g} nm: use a slow tool servo"
            )

    def extent(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> tuple[int, Spiral]:
        """Return the number of points of the program, and the outermost revolution with the point at the other end."""
        edge, spiral = tool.cutting_edge(self.sense), self.spiral(part, tool, progress=progress)
        order = slice(None) if self.inside_out else slice(None, None, -1)
        z = self._heights(part, edge, spiral.radius[order])[order]
        return self._find_blocks(spiral.radius, z).size, outermost_turn(spiral)

    def blocks(self, path: Path) -> Ints:
        """Return the indices of the points of the program: the fewest within the chord. (m,)."""
        return self._find_blocks(path.radius, path.z)

    def _find_blocks(self, x: Floats, z: Floats) -> Ints:
        travelled = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))))
        position = np.abs(x - x[0])
        along = position if (np.diff(position) > 0).all() else travelled
        # Between two points the path bulges by at most a quarter of the step times the change of slope.
        step = np.diff(along)
        bend = np.abs(np.diff(np.diff(z) / step))
        bulge = step * np.maximum(np.append(bend, 0.0), np.append(0.0, bend)) / 4
        slack = np.maximum(self.chord - np.maximum(np.append(bulge, 0.0), np.append(0.0, bulge)), 0.0)
        keep = np.empty(z.size, dtype=np.int64)
        return keep[: kernel.fewest(along, z, slack, travelled[-1], keep)]

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: C the azimuth from any start [rad], X and Z of the tip [mm]."""
        return {"C": path.angle, "X": path.radius, "Z": path.z}


@lru_cache(maxsize=8)  # a job asks for it in every pass, and whenever it is checked
def find_asymmetry(surface: Surface, radius: float) -> float:
    """Return the largest departure of the height from its mean over the azimuth, within a radius. [mm].

    Raises
    ------
    InputError
        If the surface may have structure too fine to be sampled.
    """
    if surface.of_revolution:
        return 0.0
    radii = radius * (1 - 1e-12) * (np.arange(_count_rings(surface, radius)) + 1.0)
    return max(float(np.abs(z - z.mean()).max()) for z in _rings(surface, radii / radii.size))


@lru_cache(maxsize=8)
def revolve(surface: Surface, radius: float, *, above: float | None = None) -> RadialTable:
    """Return a surface of revolution with the mean height of each ring within a radius [mm].

    With ``above`` it lies at least by this height above the highest of each ring. [mm]

    Raises
    ------
    InputError
        If the surface may have structure too fine to be sampled.
    """
    angle = np.linspace(0, TURN, MIN_AZIMUTHS)
    # The edge touches beyond the rim, if the surface goes on there.
    reaches = (radius * factor for factor in REACH_FACTORS)
    reach = next((one for one in reaches if _is_inside(surface, one * np.cos(angle), one * np.sin(angle))), radius)
    count = _count_rings(surface, reach)
    radii = reach * np.arange(count + 1) / count
    rings = _rings(surface, radii * (1 - 1e-12))  # the surface may end at the rim
    heights = np.array([_bound_highest(z) if above is not None else float(z.mean()) for z in rings])
    table = RadialTable(points=tuple(zip(radii.tolist(), heights.tolist(), strict=True)))
    if above is None:
        return table
    # Between rings the highest height may lie above the spline, and is no smooth function.
    rise = float(np.abs(np.diff(heights, 2)).max(initial=0.0)) / 2 + above
    return RadialTable(points=tuple(zip(radii.tolist(), (heights + rise).tolist(), strict=True)))


def _bound_highest(z: Floats) -> float:
    """Return an upper bound of heights around a ring from samples: by the parabola through the highest three."""
    before, after = np.roll(z, 1), np.roll(z, -1)
    return float((z + np.abs(before - 2 * z + after) / 8).max())


def _is_inside(surface: Surface, x: Floats, y: Floats) -> bool:
    inside = surface.inside(x, y)
    return inside is None or bool(inside.all())


def _count_rings(surface: Surface, radius: float) -> int:
    """Return the number of rings that resolve the structure of a surface."""
    size = surface.feature_size
    needed = SAMPLES_PER_FEATURE * radius / size if size > 0 else math.inf
    around = TURN * needed
    if max(needed, MIN_RINGS) * max(around, MIN_AZIMUTHS) > MAX_SAMPLES:
        raise InputError(
            f"the surface has structure of {size:.3g} mm, too fine to find out within {radius:g} mm whether it is one "
            "of revolution: state it as one, such as a formula in rho or a radial table, or use a slow tool servo"
        )
    return math.ceil(max(needed, MIN_RINGS))


def _rings(surface: Surface, radii: Floats) -> Iterator[Floats]:
    """Yield the heights around the axis at some radii."""
    around = SAMPLES_PER_FEATURE * TURN * float(radii.max()) / surface.feature_size
    count = math.ceil(max(MIN_AZIMUTHS, around)) if not surface.of_revolution else 1
    angle = np.arange(count) * (TURN / count)
    cosine, sine = np.cos(angle), np.sin(angle)
    for radius in radii.tolist():
        yield np.asarray(surface.evaluate(radius * cosine, radius * sine, 0)[0])
