"""Least squares of causes and pose together, and what the residual says of their certainty."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright.diagnosis._causes import Column, Columns
from turnwright.diagnosis._model import Cutting, Deviations, Sweeps, Swept
from turnwright.errors import InputError
from turnwright.pose import Pose

__all__ = ["FREE", "Fit", "Place", "Reduced", "Sight", "choose"]

PLAUSIBLE = 3.0
"""How many times its typical size a number may be while the fit is on its way."""

FREE = ("piston", "tilt", "decentre", "clocking")
"""What registration leaves open, a little."""

SPHERE = ("piston", "sphere")
"""What a departure from the best-fit sphere leaves open."""

CANNOT = 1e-8
"""A mark whose plausible size, less what the pose explains of it, is smaller than this is none. [mm]"""

COLLINEAR = 1e-7
"""Relative size below which a direction among marks is rounding: half the digits, for they are taken as products."""

FLOOR = 1e-8
"""The model is no truer than this. [mm]"""

OUTSIDE = 6.0
"""Points this many standard deviations off, as the median sees it, are left out: beside a seam of the design a chord of
the program or a pixel of the instrument makes micrometres."""

HANGS = 1.5
"""From so many points that count as one on it is no chance of the sample."""

LEVEL = 0.05
"""Chance of calling for a cause that is not there."""

LOOSE = np.array([0.1, 0.1, 1.0, 0.1, 0.01, 0.01, 0.01, 0.01, 1e-3])
"""How far a registered map may still be off its place, one standard deviation: shift x, y, z [mm], rotation and tilts
[rad], slopes [1] and curvature [1/mm] of a sphere. It holds those in place that the surface does not determine."""

SQUARES = ((4, 4), (8, 8), (16, 16))
CELLS = ((48, 1), (1, 64), *SQUARES)
"""Rings and sectors over which residuals are averaged to see how far they hang together."""

MISSED = 0.05
"""Chance that an interval misses the true value."""

NUDGE = (1e-6, 1e-6, 1e-7)
"""Slopes and curvature by which a sphere is changed to see what that does."""

STEPS = 12
"""Gauss-Newton steps at most."""

SETTLED = 1e-2
"""A step that moves the fit by less than this of the noise of a single number is the last."""


@dataclass(slots=True, kw_only=True, eq=False)
class Sight:
    """One measured map as the fit sees it: its points, and where on the nose they were cut.

    ``x``, ``y``, ``z`` are the valid points; of a departure from a sphere, ``sphere`` has that of the design: slopes at
    the axis and curvature (p, q, k).
    """

    x: Floats
    y: Floats
    z: Floats
    swept: Swept
    sweeps: Sweeps
    added: dict[str, Floats]
    usable: Bools  # points that the planned tool cuts
    good: Bools  # those of them that the fit takes
    apart: Bools  # points that stand out of the rest by so much that the fit leaves them
    free: tuple[str, ...]
    reference: str
    where: Bools  # which points of the map these are
    sphere: Floats | None
    stands: Floats | None  # departure along the normal that the points should have, as far as the fit knows it [mm]
    cusp: float  # mean height of the cusps per curvature between the passes [mm²]
    pose: Floats  # shift x, y, z, rotation, tilts [mm, rad]; and (p, q, k) beyond those of the design's sphere
    begun: Floats  # where the pose began

    def moved(self) -> tuple[Floats, Floats, Floats]:
        """Return the points in the frame of the part, as far as the fit knows it."""
        x, y, z = self.x, self.y, self.z
        if self.sphere is not None:
            x, y, z = on_sphere(self.sphere + self.pose[6:], x, y, z, self.stands)
        shift, rotation, tilt = self.pose[:3], self.pose[3], self.pose[4:6]
        return Pose.within_a_turn(shift, rotation, tilt).apply(x, y, z)

    def cut(self, deviations: Deviations) -> tuple[Floats, Cutting]:
        """Return what is measured beyond the height that the deviations leave, and how the points were cut."""
        x, y, z = self.moved()
        # Where the last deviations left no contact, these may have one again.
        lost = self.usable & np.isnan(self.sweeps.cut)
        if lost.any():
            for own, again in zip(self.sweeps, self.swept.guess(x[lost], y[lost]), strict=True):
                own[lost] = again
        cutting = self.swept.heights(x, y, self.sweeps, deviations)
        residual = z - cutting.z - self.cusp * cutting.between
        if self.stands is not None:
            self.stands = self.z - np.nan_to_num(residual) / np.sqrt(1 + cutting.zx**2 + cutting.zy**2)
        return residual, cutting

    def nuisances(self, cutting: Cutting) -> tuple[Floats, list[int]]:
        """Return the derivative of the residual by each free number of the pose (n, j), and which they are."""
        x, y = cutting.x, cutting.y
        # Slopes of the design: those of the errors would let a pose that the design does not determine follow them.
        with np.errstate(all="ignore"):
            z, zx, zy = self.swept.surface.evaluate(x, y, 1)
        rows = {
            0: -zx, 1: -zy, 2: np.ones_like(x), 3: y * zx - x * zy,
            4: y + zy * z, 5: -x - zx * z,
        }  # fmt: skip
        names = {"piston": (2,), "tilt": (4, 5), "decentre": (0, 1), "clocking": (3,)}
        numbers = [number for name in FREE if name in self.free for number in names[name]]
        if self.sphere is not None and "sphere" in self.free:
            shape = self.sphere + self.pose[6:]
            off = self.z if self.stands is None else self.stands  # no noise in the marks
            for k in range(3):
                step = NUDGE[k] * np.eye(3)[k]
                ends = [on_sphere(shape + side * step, self.x, self.y, off, self.stands) for side in (1, -1)]
                by_x, by_y, by_z = ((high - low) / (2 * NUDGE[k]) for high, low in zip(*ends, strict=True))
                rows[6 + k] = by_z - zx * by_x - zy * by_y
            numbers += [6, 7, 8]
        return np.stack([rows[number] for number in numbers], axis=1) if numbers else np.zeros((x.size, 0)), numbers


def sphere_at(shape: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the root and the height of the sphere through the origin with slopes and curvature (p, q, k)."""
    p, q, k = shape
    squares = k / 2 * (x * x + y * y) + p * x + q * y
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1 - 2 * k * squares)
    return root, 2 * squares / (1 + root)


def on_sphere(shape: Floats, x: Floats, y: Floats, off: Floats, stands: Floats | None) -> tuple[Floats, Floats, Floats]:
    """Return the points that stand ``off`` a sphere: along z, or along its normal if it is said where they should.

    Along the normal a point moves aside with its height. It is moved by what it should have, and the rest, mostly
    noise, is taken along z: noise that moved points aside would be found again in the marks.
    """
    p, q, k = shape
    root, height = sphere_at(shape, x, y)
    if stands is None:
        return x, y, height + off
    zx, zy = (k * x + p) / root, (k * y + q) / root
    lean = np.sqrt(1 + zx * zx + zy * zy)
    return x - stands / lean * zx, y - stands / lean * zy, height + stands / lean + (off - stands) * lean


def sphere_of(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return slopes and curvature (p, q, k) of the sphere of best fit in z."""
    shape: Floats = np.zeros(3)
    size = float(np.hypot(x, y).max())
    for _ in range(50):
        root, height = sphere_at(shape, x, y)
        if np.isnan(root).any():
            shape = 0.5 * shape
            continue
        rows = np.stack([x / root, y / root, (x * x + y * y + height**2) / (2 * root), np.ones_like(x)], axis=1)
        units = np.array([size, size, size**2, 1.0])
        step = np.asarray(np.linalg.lstsq(rows / units, z - height, rcond=1e-12)[0] / units, dtype=np.float64)
        shape = shape + step[:3]
        if np.abs(step[:3] * [1, 1, size]).max() < 1e-13:
            break
    return shape


class Look(NamedTuple):
    """One map at the present numbers, in products of its rows.

    The rows are, for each point, the free numbers of the pose in units of `LOOSE`, the marks in plausible units, and
    the residual; the pose is held near where it began by as many further rows.
    """

    rows: Floats  # (n, j + k + 1) [mm]
    held: Floats  # (j, j + k + 1), in units of the noise
    good: Bools
    numbers: list[int]  # of the pose that are free

    @property
    def points(self) -> Floats:
        """Rows of the points that hold."""
        return self.rows[self.good]


Place: TypeAlias = tuple[int, int | None]
"""Which number, of which map or (None) of all."""


class Least(NamedTuple):
    """Numbers by least squares, each held near 0 as if it had been measured to be 0 within its plausible size."""

    values: Floats  # in plausible units
    covariance: Floats
    left: float  # squares of what is left, and of the values


def least(marks: Floats, target: Floats, *, most: float = np.inf) -> Least:
    """Return the numbers that explain a target, in units of the noise, by marks of plausible size.

    Where marks are nearly alike, numbers far beyond what is plausible may cancel each other; they are held to ``most``
    times that by pulling all of them the more toward 0.
    """
    u, s, vt = np.linalg.svd(marks, full_matrices=False)
    s[s < COLLINEAR * s.max(initial=0.0)] = 0.0
    pull = 1.0
    while True:
        values = (vt.T * (s / (s * s + pull))) @ (u.T @ target)
        if np.abs(values).max(initial=0.0) <= most:
            break
        pull *= 4
    off = target - marks @ values
    return Least(values, (vt.T / (s * s + 1)) @ vt, float(off @ off + values @ values))


class Reduced(NamedTuple):
    """All maps in few rows, freed of their poses and in units of their noise."""

    looks: list[Look]
    blocks: list[Floats]  # (k + 1, k + 1) each: marks, and the residual that there would be with all numbers at 0
    residuals: list[Floats]  # (k + 1,) each: the residual as it is
    poses: list[Floats]  # (j, k + 1) each: what pose follows marks and residual
    effective: float  # effective points less numbers of the poses
    typical: Floats

    def marks(self, places: Sequence[Place]) -> Floats:
        """Return the marks of some numbers, one map above the other."""
        out = []
        for m, block in enumerate(self.blocks):
            part = np.zeros((block.shape[0], len(places)))
            for c, (k, own) in enumerate(places):
                if own is None or own == m:
                    part[:, c] = block[:, k]
            out.append(part)
        return np.concatenate(out)

    @property
    def target(self) -> Floats:
        """The residual that there would be with all numbers at 0."""
        return np.concatenate([block[:, -1] for block in self.blocks])

    def least(self, places: Sequence[Place], *, most: float = np.inf) -> Least:
        """Return some numbers by least squares."""
        return least(self.marks(places), self.target, most=most)


@dataclass(slots=True, kw_only=True, eq=False)
class Fit:
    """Maps, causes, and what is known so far."""

    sights: list[Sight]
    columns: Columns
    values: Floats  # (maps, k)
    sense: int
    scale: Floats  # of the noise of each map, so that points count as if they were independent [mm]
    together: Floats  # points of each map that count as one

    @property
    def names(self) -> list[Column]:
        """All numbers."""
        return self.columns.all

    def _look(self, k: int, typical: Floats) -> Look:
        """Take one map at the present numbers."""
        sight, values = self.sights[k], self.values[k]
        residual, cutting = sight.cut(self.columns.deviations(values))
        marks = self.columns.slopes(cutting, sight.added, self.sense, sight.cusp)
        for cause, mark in sight.added.items():
            residual = residual - values[[column.cause == cause for column in self.names]] @ mark
        sight.good = sight.usable & ~sight.apart & np.isfinite(residual) & (cutting.tip_radius >= 0)
        nuisances, numbers = sight.nuisances(cutting)
        loose = LOOSE[numbers]
        points = int(np.count_nonzero(sight.good))
        if points < (needed := len(numbers) + typical.size + 3):
            raise InputError(
                f"{points} points of the map can be used, {typical.size} numbers and a pose need at least {needed}: "
                "measure more of the part, or look for fewer causes"
            )
        held = np.zeros((len(numbers), len(numbers) + typical.size + 1))
        held[:, : len(numbers)] = np.eye(len(numbers))
        held[:, -1] = (sight.pose - sight.begun)[numbers] / loose
        rows = np.column_stack([nuisances * loose, marks * typical, residual])
        if sight.stands is not None:  # the instrument's noise is along the normal
            rows /= np.sqrt(1 + cutting.zx**2 + cutting.zy**2)[:, None]
        return Look(rows, held, sight.good.copy(), numbers)

    def reduce(self, *, measure: bool) -> Reduced:
        """Take all maps at the present numbers; ``measure`` also their noise and how far it hangs together."""
        typical = np.array([column.typical for column in self.names])
        out = Reduced([], [], [], [], 0.0, typical)
        count = 0.0
        for k in range(len(self.sights)):
            look = self._look(k, typical)
            rows, held, pose = _freed(look, self.scale[k])
            if measure:
                x, y = self.sights[k].x[look.good], self.sights[k].y[look.good]
                self.scale[k], self.together[k] = _noise(rows, x, y, len(pose))
                rows, held, pose = _freed(look, self.scale[k])
            root = _root(rows.T @ rows / self.scale[k] ** 2 + held.T @ held)
            residual = root[:, -1].copy()
            root[:, -1] += root[:, :-1] @ (self.values[k] / typical)
            out.looks.append(look)
            out.blocks.append(root)
            out.residuals.append(residual)
            out.poses.append(pose)
            count += rows.shape[0] / self.together[k] - len(pose)
        return out._replace(effective=count)

    def reject(self) -> bool:
        """Leave out points whose residual stands out of the rest; say whether there were new ones."""
        typical = np.array([column.typical for column in self.names])
        new = False
        for k, sight in enumerate(self.sights):
            look = self._look(k, typical)
            residual = look.points[:, -1]
            off = np.abs(residual - np.median(residual))
            out = off > max(OUTSIDE * 1.4826 * float(np.median(off)), OUTSIDE * FLOOR)
            sight.apart[np.flatnonzero(look.good)[out]] = True
            sight.good &= ~sight.apart
            new |= bool(out.any())
        return new

    def move(self, reduced: Reduced, values: Floats) -> float:
        """Take new numbers (maps, k), and the poses that go with them; return how far that led, in noise."""
        step = (values - self.values) / reduced.typical
        for k, (look, pose) in enumerate(zip(reduced.looks, reduced.poses, strict=True)):
            change = pose[:, -1] - pose[:, :-1] @ step[k]
            self.sights[k].pose[look.numbers] -= LOOSE[look.numbers] * change
        self.values = values
        return float(
            np.sqrt(sum(np.sum((root[:, :-1] @ own) ** 2) for root, own in zip(reduced.blocks, step, strict=True)))
        )

    def solve(self, places: Sequence[Place], *, steps: int = STEPS) -> None:
        """Find some of the numbers, and set all others to 0."""
        last = np.inf
        for _ in range(steps):
            reduced = self.reduce(measure=False)
            found = reduced.least(places, most=PLAUSIBLE).values
            values = np.zeros_like(self.values)
            for (k, m), value in zip(places, found, strict=True):
                values[slice(None) if m is None else m, k] = value * reduced.typical[k]
            moved = self.move(reduced, values)
            if moved < SETTLED or moved > last / 2:
                break
            last = moved


def _freed(look: Look, scale: float) -> tuple[Floats, Floats, Floats]:
    """Return marks and residual less what the pose explains, that which holds the pose, and what pose it is.

    (n, k + 1) [mm], (j, k + 1) in units of the noise, (j, k + 1) in those of `LOOSE`.
    """
    j = look.held.shape[0]
    points = look.points
    nuisances, rows, begun = points[:, :j], points[:, j:], look.held[:, j:]
    value, vector = np.linalg.eigh(nuisances.T @ nuisances)
    seen = value > COLLINEAR**2 * value.max(initial=0.0)
    # What the surface does not determine goes back to where it began.
    right = np.where(seen[:, None], vector.T @ (nuisances.T @ rows), 0.0) + scale**2 * (vector.T @ begun)
    pose = vector @ (right / (np.where(seen, value, 0.0) + scale**2)[:, None])
    return rows - nuisances @ pose, begun - pose, pose


def _root(product: Floats) -> Floats:
    """Return a matrix whose own product this is. (k, k)."""
    size = np.sqrt(np.maximum(np.diag(product), 0.0))
    size[size == 0] = 1.0
    value, vector = np.linalg.eigh(product / np.outer(size, size))
    return np.asarray(np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T * size)


def _noise(rows: Floats, x: Floats, y: Floats, poses: int) -> tuple[float, float]:
    """Return the scale of a map's noise as if points were independent [mm], and how many of them count as one.

    If the residual were independent from point to point, means over cells of n points would scatter by 1/sqrt(n); by
    how much more they scatter is how many points count as one. What the fit has taken from them is accounted for.
    """
    marks = rows[:, :-1]
    size = np.sqrt((marks**2).sum(axis=0))
    size[size == 0] = 1.0
    value, vector = np.linalg.eigh(marks.T @ marks / np.outer(size, size))
    kept = value > COLLINEAR**2 * value[-1]
    fitted = marks @ (vector[:, kept] / np.sqrt(value[kept]) / size[:, None])
    residual = rows[:, -1] - fitted @ (fitted.T @ rows[:, -1])
    free = max(residual.size - fitted.shape[1] - poses, 1)
    variance = max(float(residual @ residual) / free, FLOOR**2)
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    order = np.argsort(np.argsort(radius)) / radius.size  # rings of equal numbers of points
    over: dict[tuple[int, int], float] = {}
    for rings, sectors in CELLS:
        cell = np.minimum((order * rings).astype(np.int64), rings - 1) * sectors
        cell += np.minimum(((angle / (2 * np.pi) + 0.5) * sectors).astype(np.int64), sectors - 1)
        number = np.bincount(cell, minlength=rings * sectors)
        filled = number > 3
        weight = np.where(filled, 1 / np.sqrt(np.maximum(number, 1)), 0.0)
        sums = np.bincount(cell, residual, rings * sectors) * weight
        taken = sum(float(((np.bincount(cell, one, rings * sectors) * weight) ** 2).sum()) for one in fitted.T)
        left = np.count_nonzero(filled) - taken
        if left > 4:
            over[rings, sectors] = float(sums @ sums) / left / variance
    together = max(1.0, *over.values()) if over else 1.0
    if together > HANGS:
        # Cells that are not far larger than what hangs together see too little of it, by a share as their outline is
        # to their area: twice as long sides miss half as much.
        for large, small in itertools.pairwise(SQUARES):
            if large in over and small in over:
                together = max(together, 2 * over[large] - over[small])
    together = min(together, residual.size / 4)
    return float(np.sqrt(variance * together)), together


class Choice(NamedTuple):
    """Numbers that explain a map, and others that would do as well."""

    kept: list[int]
    rivals: dict[str, list[str]]  # by cause that was kept, those that could stand for it
    spread: dict[int, tuple[float, float]]  # by number that was kept, the ends of its interval less its value


def _subsets(names: Sequence[Column], usable: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Yield sets of numbers, those of one cause together but powers of the sweep one after the other; few first."""
    groups: dict[str, list[int]] = {}
    for k in usable:
        groups.setdefault(names[k].cause, []).append(k)
    options: list[list[tuple[int, ...]]] = []
    for own in groups.values():
        if names[own[0]].order:
            options.append([tuple(own[:count]) for count in range(len(own) + 1)])
        else:
            options.append([(), tuple(own)])
    every = [tuple(itertools.chain(*parts)) for parts in itertools.product(*options)]
    yield from sorted(every, key=len)


def choose(reduced: Reduced, names: Sequence[Column], usable: Sequence[int]) -> Choice:
    """Return the fewest numbers that explain the maps as well as all of them do, by the F-test.

    Every set of causes is tried. Where several of the smallest size pass, what is not in all of them has rivals. The
    intervals are as wide as those of all sets together that pass and have one number more at most.
    """
    from scipy.special import fdtri, stdtrit  # noqa: PLC0415 - costly to import

    every = [*usable, len(names)]
    rows = _root(
        sum((block[:, every].T @ block[:, every] for block in reduced.blocks), np.zeros((len(every), len(every))))
    )
    place = {k: i for i, k in enumerate(usable)}
    full = least(rows[:, :-1], rows[:, -1]).left
    dof = max(reduced.effective - len(usable), 1.0)
    unit = max(full / dof, 1.0)
    passed: list[tuple[float, tuple[int, ...]]] = []
    for subset in _subsets(names, usable):
        if passed and len(subset) > len(passed[0][1]) + 1:
            break
        more = len(usable) - len(subset)
        excess = least(rows[:, [place[k] for k in subset]], rows[:, -1]).left - full
        if more == 0 or excess <= more * unit * fdtri(more, dof, 1 - LEVEL):
            passed.append((excess, subset))
    size = len(passed[0][1])
    best = min(one for one in passed if len(one[1]) == size)[1]
    causes = {names[k].cause for k in best}
    rivals: dict[str, list[str]] = {}
    for _, other in passed:
        theirs = {names[k].cause for k in other}
        for cause in sorted(causes - theirs) if len(other) == size else ():
            known = rivals.setdefault(cause, [])
            known += sorted(theirs - causes - set(known))
    wide = float(stdtrit(dof, 1 - MISSED / 2))
    at: dict[int, float] = {}
    ends: dict[int, list[float]] = {k: [] for k in best}
    for subset in (best, *(other for _, other in passed)):
        values, covariance, _ = least(rows[:, [place[k] for k in subset]], rows[:, -1])
        for k, value, std in zip(subset, values.tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True):
            if k in ends:
                at.setdefault(k, value)
                ends[k] += [value - wide * std - at[k], value + wide * std - at[k]]
    typical = reduced.typical
    spread = {k: (min(both) * float(typical[k]), max(both) * float(typical[k])) for k, both in ends.items()}
    return Choice(list(best), rivals, spread)
