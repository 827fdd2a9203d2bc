"""The axis of turning in a measured map: from the rings of the spiral, or from the defect at its middle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Bools, Complexes, Floats
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.metrology.grid import measure, valid_points

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["TurningCentre", "turning_centre"]

TILES = (32, 64)
"""Sides of the tiles that a wave is looked for in: the wider ones for weak cusps and wide feeds. [pixels]"""

WAVES = 3.0
"""Waves that a tile must hold at least: slower ones are form."""

PROMINENT = 20.0
"""Power of a peak over the median of its tile from which it is a wave and no chance."""

ALIKE = 0.1
"""Share of the wave number by which tiles may differ and still show the same rings."""

FEWEST_TILES = 8
"""Tiles with rings that a centre needs."""

SHARED = 0.5
"""Share of the tiles with waves that must agree on a centre."""

KNOWN = 0.5
"""Share of its points that a tile or a block must have."""

BANDS = 8
"""Annuli that the rings may have an amplitude and a phase of their own in."""

BLOCK_WAVES = 2.0
"""Side of the blocks whose phase is taken, at least. [waves]"""

BLOCK_PIXELS = 12
"""Side of the blocks whose phase is taken, at least. [pixels]"""

HARMONICS = 3
"""Harmonics of the cusps that a block is freed of, as far as the pixels show them."""

SPIRALS = (-1, 0, 1)
"""How the phase of the rings may grow with azimuth."""

SEARCH, SEARCH_STEPS = 7, 5
"""Steps to each side by which the centre is searched for, and steps in a wave."""

SECTORS = 16
"""Sectors whose errors are independent of each other."""

CERTAIN = 36.0
"""Excess of the misfit, in units of its noise, from which a way of turning is ruled out."""

CHANCE = 10.0
"""What the rings explain over what their amplitudes and phases explain of noise, from which it is no chance."""

ROUNDS = 5
"""Times that the blocks are taken about a better centre at most."""

SETTLED = 0.03
"""Change of the phase by which a centre may still move. [rad]"""

DEFECT_RADIUS = 12
"""Radius of what may be a defect of the middle, and how far it is looked for. [pixels]"""

LARGEST_DEFECT = 0.2
"""A defect of the middle is no larger: over coarser pixels something else is the same all around. [mm]"""

EXPLAINED = 0.5
"""Share of the variance that a defect turned about its middle must explain."""

SHARPEST = 1e-3
"""Standard uncertainty of a centre from the harmonics of the cusps that blocks keep. [waves]"""

SURE = 0.5
"""Standard uncertainty of a centre, in waves of the rings or in pixels, from which it is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningCentre:
    """Where the axis of turning stands in a map.

    Parameters
    ----------
    x, y
        Its place in the frame of the map. [mm]
    std
        Standard uncertainty of both. (x, y) [mm]
    source
        "cusps", the rings of the spiral, or "centre defect".
    feed
        Distance of the rings; nan of a centre defect. [mm/rev]
    turns
        How the phase of the rings grows with azimuth: +1 or -1 of a spiral, 0 of closed rings and of a centre defect.
    """

    x: float
    y: float
    std: tuple[float, float]
    source: Literal["cusps", "centre defect"]
    feed: float
    turns: int


def turning_centre(
    error: HeightMap, *, feed: float | None = None, near: tuple[float, float] = (0.0, 0.0)
) -> TurningCentre | None:
    r"""Find the axis that a part was turned about, from the cusps where the map resolves them, else from its middle.

    The rings of a spiral of feed f about :math:`c` have the phase :math:`\varphi = 2\pi\rho/f - s\theta`. The spectra
    of tiles show their wave vectors, which cross near c. About it the phase of the cusps is taken in blocks of two
    waves or more, and least squares finds c and f for each s of -1, 0 and 1, with amplitude and phase free in each of
    eight annuli. The blocks are then taken again about the best, until it stays. The uncertainty follows from what the
    phases leave, as that of single blocks or of whole sectors, whichever is larger. A defect of the middle is what is
    the same all around it: its radial mean is fitted about every place.

    Parameters
    ----------
    error
        A rectangular map of what form and pose leave, such as `Registration.error`; form of long wavelength may remain.
    feed
        What the program says; rings of another distance, such as those that too coarse pixels show, then do not count.
        [mm/rev]
    near
        About where a defect of the middle is looked for; rings need no such place. [mm]

    Returns
    -------
    TurningCentre or None
        ``None`` where neither rings nor a defect of the middle show it: where noise hides the cusps, a pixel is wider
        than half of the feed, the axis has no rings on all sides of it (it lies outside the map), or the sense of the
        spiral is uncertain, which would move it.

    Raises
    ------
    InputError
        If the map is scattered or polar.

    Sources
    -------
    Oracle: rings and spirals cut about a known centre by brute force (``tests/proof/proof_turning_centre.py``).
    """
    if feed is not None:
        positive(feed, "feed", "mm/rev")
    grid = measure(error)
    if error.x is None or error.y is None:
        raise InputError("the map is polar, which has the middle of its rings for an axis: give a rectangular map")
    valid_points(error, TILES[0], "a turning centre")
    step = float(np.diff(grid.columns).mean()) if grid.columns.size > 1 else 1.0
    for side in TILES:
        if min(error.z.shape) >= side and (feed is None or 2 * step <= feed):
            rings = _from_rings(error, feed, side)
            if rings is not None:
                return rings if feed is not None else _fundamental(error, rings)
    return _from_defect(error, step, near)


def _from_rings(error: HeightMap, feed: float | None, side: int) -> TurningCentre | None:
    """Return the centre of the rings that tiles of a side show, if there are any."""
    places, waves, power = _waves(error, side)
    if places.shape[0] < FEWEST_TILES:
        return None
    size = np.hypot(*waves.T)
    typical = 2 * np.pi / feed if feed is not None else float(np.median(size))
    alike = np.abs(size / typical - 1) < ALIKE
    fewest = max(FEWEST_TILES, SHARED * places.shape[0])
    if np.count_nonzero(alike) < fewest:
        return None
    places, waves, power = places[alike], waves[alike], power[alike]
    middle = _crossing(places, waves, fewest)
    if middle is None:
        return None
    wave = float(np.average(np.hypot(*waves[middle[1]].T), weights=power[middle[1]]))
    return _coherent(error, middle[0], wave)


def _fundamental(error: HeightMap, rings: TurningCentre) -> TurningCentre:
    """Return rings of twice the distance if they are known better: tiles of few rings may show their harmonic."""
    twice = _coherent(error, np.array([rings.x, rings.y]), np.pi / rings.feed)
    return rings if twice is None or math.hypot(*twice.std) > math.hypot(*rings.std) else twice


def _crossing(places: Floats, waves: Floats, fewest: float) -> tuple[Floats, Bools] | None:
    """Return where lines along the wave vectors cross, and which of them do."""
    rows = np.stack([waves[:, 1], -waves[:, 0]], axis=1)
    right = places[:, 0] * waves[:, 1] - places[:, 1] * waves[:, 0]
    keep = np.ones(len(waves), dtype=np.bool_)
    solved: Floats = np.zeros(2)
    for _ in range(10):
        solution, _, rank, _ = np.linalg.lstsq(rows[keep], right[keep], rcond=1e-6)
        solved = np.asarray(solution, dtype=np.float64)
        off = np.abs(rows @ solved - right)
        last, keep = keep, off <= max(4 * 1.4826 * float(np.median(off[keep])), 1e-9)
        if rank < 2 or np.count_nonzero(keep) < fewest:
            return None  # as of rings that pixels wider than half of them show elsewhere
        if np.array_equal(last, keep):
            break
    return solved, keep


def _waves(error: HeightMap, tile_side: int) -> tuple[Floats, Floats, Floats]:
    """Return where tiles show a wave (n, 2), its wave vector (n, 2) [rad/mm] and its power (n,)."""
    assert error.x is not None and error.y is not None  # noqa: PT018, S101 - a rectangular map
    steps = [float(np.diff(axis).mean()) for axis in (error.x, error.y)]
    side = np.linspace(-1, 1, tile_side)
    u, v = np.meshgrid(side, side)
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
    project = np.linalg.pinv(terms)
    window = np.hanning(tile_side)[:, None] * np.hanning(tile_side)
    frequency = np.fft.fftfreq(tile_side)
    slow = np.hypot(frequency, frequency[:, None]) < WAVES / tile_side
    places, waves, power = [], [], []
    for row in range(0, error.z.shape[0] - tile_side + 1, tile_side // 2):
        for column in range(0, error.z.shape[1] - tile_side + 1, tile_side // 2):
            tile = error.z[row : row + tile_side, column : column + tile_side]
            known = np.isfinite(tile).ravel()
            if known.mean() < KNOWN:
                continue
            heights = tile.ravel()
            if known.all():
                flat = heights - terms @ (project @ heights)
            else:
                some = terms * known[:, None]
                solved = np.linalg.solve(some.T @ some, some.T @ np.where(known, heights, 0.0))
                flat = np.where(known, heights - terms @ solved, 0.0)
            flat = flat.reshape(tile.shape) * window
            spectrum = np.abs(np.fft.fft2(flat)) ** 2
            i, j = np.unravel_index(int(np.argmax(np.where(slow, 0.0, spectrum))), spectrum.shape)
            if spectrum[i, j] < PROMINENT * float(np.median(spectrum[~slow])) or spectrum[i, j] == 0:
                continue
            along = [
                _between(spectrum[(i + np.arange(-1, 2)) % tile_side, j]),
                _between(spectrum[i, (j + np.arange(-1, 2)) % tile_side]),
            ]
            ky, kx = (
                2 * np.pi * (frequency[at] + more / tile_side) / step
                for at, more, step in zip((i, j), along, steps[::-1], strict=True)
            )
            middle = slice(row, row + tile_side), slice(column, column + tile_side)
            places.append((float(error.x[middle[1]].mean()), float(error.y[middle[0]].mean())))
            waves.append((kx, ky))
            power.append(float(spectrum[i, j]))
    return np.array(places).reshape(-1, 2), np.array(waves).reshape(-1, 2), np.array(power)


def _between(three: Floats) -> float:
    """Return where between its neighbours a peak has its top: of a Hann window the log of the power is a parabola."""
    low, top, high = np.log(np.maximum(three, 1e-300))
    bend = low - 2 * top + high
    return float(np.clip((low - high) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Blocks:
    """Cusps in square blocks: places (n,) [mm], complex amplitudes (n,) [mm] and their weights (n,)."""

    x: Floats
    y: Floats
    amplitude: Complexes
    weight: Floats
    numbers: Floats
    turns: int

    @property
    def surround(self) -> bool:
        """Whether blocks lie around the centre of the rings, with no gap of half a revolution."""
        azimuth = np.sort(np.arctan2(self.y - self.numbers[1], self.x - self.numbers[0]))
        return bool(np.diff(azimuth, append=azimuth[0] + 2 * np.pi).max() < np.pi)

    def turned(self, numbers: Floats, turns: int) -> Complexes:
        """Return the amplitudes with the phase of other rings taken off; of the true ones they agree in an annulus."""
        more = _phase(self.x, self.y, numbers, turns) - _phase(self.x, self.y, self.numbers, self.turns)
        return np.asarray(self.amplitude * np.exp(-1j * more))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rings:
    """Rings fitted to blocks: centre and wave number, the covariance of the centre, the misfit and its unit."""

    numbers: Floats
    covariance: Floats
    turns: int
    misfit: float
    variance: float
    explained: float


def _phase(x: Floats, y: Floats, numbers: Floats, turns: int) -> Floats:
    """Return the phase of rings, in rad."""
    u, v = x - numbers[0], y - numbers[1]
    return np.asarray(numbers[2] * np.hypot(u, v) - turns * np.arctan2(v, u))


def _coherent(error: HeightMap, start: Floats, wave: float) -> TurningCentre | None:
    """Fit rings to the phases of blocks, which are taken again about each better centre; None where it is not sure."""
    numbers, turns = np.array([start[0], start[1], wave]), 0
    for k in range(ROUNDS):
        blocks = _blocks(error, numbers, turns)
        if blocks is None or not blocks.surround:
            return None
        fits = [one for sense in SPIRALS if (one := _fitted(blocks, sense, search=k == 0)) is not None]
        if len(fits) < len(SPIRALS):
            return None
        best, second = sorted(fits, key=lambda one: one.misfit)[:2]
        moved = np.abs(best.numbers - numbers)[:2].max() * wave
        settled = k > 0 and best.turns == turns and moved < SETTLED
        numbers, turns = best.numbers, best.turns
        if settled:
            break
    else:
        return None
    feed = float(2 * np.pi / numbers[2])
    std = np.sqrt(np.diag(best.covariance) + (SHARPEST * feed) ** 2)
    other_sense = second.misfit - best.misfit < CERTAIN * best.variance
    by_chance = best.explained < CHANCE * 2 * BANDS * best.variance
    if other_sense or by_chance or float(std.max()) > SURE * feed:
        return None
    return TurningCentre(
        x=float(numbers[0]), y=float(numbers[1]), std=(float(std[0]), float(std[1])), source="cusps", feed=feed,
        turns=turns,
    )  # fmt: skip


def _blocks(error: HeightMap, numbers: Floats, turns: int) -> _Blocks | None:
    """Return amplitude and phase of the cusps in blocks, by least squares beside harmonics and form."""
    x, y = error.points()
    step = float(np.diff(x[0]).mean())
    side = max(round(BLOCK_WAVES * 2 * np.pi / numbers[2] / step), BLOCK_PIXELS)
    rows, columns = (size // side for size in error.z.shape)

    def blocked(values: Floats) -> Floats:
        cut = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
        return cut.swapaxes(1, 2).reshape(rows * columns, side * side)

    x, y, z = blocked(x), blocked(y), blocked(error.z)
    known = np.isfinite(z)
    at_x, at_y = x.mean(axis=1), y.mean(axis=1)
    # Across a block that is too close to the centre the rings bend.
    some = (known.mean(axis=1) > KNOWN) & (np.hypot(at_x - numbers[0], at_y - numbers[1]) > 1.5 * side * step)
    if np.count_nonzero(some) < 4 * BANDS:
        return None
    x, y, z, known, at_x, at_y = x[some], y[some], z[some], known[some], at_x[some], at_y[some]
    phase = _phase(x, y, numbers, turns)
    u, v = (x - at_x[:, None]) / (side * step), (y - at_y[:, None]) / (side * step)
    harmonics = int(np.clip(0.9 * np.pi / (numbers[2] * step), 1, HARMONICS))
    waves = [part for k in range(1, harmonics + 1) for part in (np.cos(k * phase), np.sin(k * phase))]
    terms = np.stack([*waves, np.ones_like(u), u, v, u * u, u * v, v * v], axis=1) * known[:, None]
    normal = terms @ terms.swapaxes(1, 2)
    # A little of the diagonal keeps a block of many missing points from a singular equation.
    normal += 1e-9 * np.eye(normal.shape[1]) * np.trace(normal, axis1=1, axis2=2)[:, None, None]
    inverse = np.linalg.inv(normal)
    solved = (inverse @ (terms @ np.where(known, z, 0.0)[..., None]))[..., 0]
    return _Blocks(
        x=at_x, y=at_y, amplitude=solved[:, 0] - 1j * solved[:, 1],
        weight=2 / (inverse[:, 0, 0] + inverse[:, 1, 1]), numbers=numbers, turns=turns,
    )  # fmt: skip


def _fitted(blocks: _Blocks, turns: int, *, search: bool) -> _Rings | None:
    """Make the phases of the blocks agree in every annulus."""
    numbers, weight = blocks.numbers, blocks.weight
    away = np.hypot(blocks.x - numbers[0], blocks.y - numbers[1])
    near, far = float(away.min()), float(away.max())
    band = np.minimum((away - near) / max(far - near, 1e-300) * BANDS, BANDS - 1).astype(np.int64)
    total = np.maximum(np.bincount(band, weight, BANDS), 1e-300)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(band, weight * values, BANDS) / total)

    def means(values: Complexes) -> Complexes:
        return np.asarray(mean(values.real) + 1j * mean(values.imag))

    def explained(at: Floats) -> float:
        return float(np.sum(total * np.abs(means(blocks.turned(at, turns))) ** 2))

    if search:
        reach = np.arange(-SEARCH, SEARCH + 1) / SEARCH_STEPS * 2 * np.pi / numbers[2]
        tried = [numbers + np.array([a, b, 0.0]) for a in reach for b in reach]
        numbers = max(tried, key=explained)
    for _ in range(20):
        turned = blocks.turned(numbers, turns)
        common = means(turned)[band]
        size = np.abs(common)
        residual = (turned * common.conj()).imag / np.maximum(size, 1e-300)
        u, v = blocks.x - numbers[0], blocks.y - numbers[1]
        rho = np.hypot(u, v)
        ways = [
            -numbers[2] * u / rho - turns * v / rho**2,
            -numbers[2] * v / rho + turns * u / rho**2,
            rho,
        ]
        design = np.stack([size * (way - mean(way)[band]) for way in ways], axis=1)
        scale = np.sqrt(np.sum(weight[:, None] * design**2, axis=0))
        if not np.all(scale > 0):
            return None
        design /= scale
        normal = design.T @ (weight[:, None] * design)
        if np.linalg.cond(normal) > 1e8:
            return None
        inverse = np.linalg.inv(normal)
        change = inverse @ (design.T @ (weight * residual)) / scale
        numbers = numbers + change
        if np.abs(change[:2]).max() * numbers[2] < 1e-6:
            break
    whole = float(np.sum(weight * np.abs(turned) ** 2))
    coherent = float(np.sum(total * np.abs(means(turned)) ** 2))
    freedom = len(residual) - BANDS - 3
    variance = float(np.sum(weight * residual**2)) / freedom
    # Errors that go together over a sector count as one.
    sector = ((np.arctan2(v, u) / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64) % SECTORS
    pulls = np.stack([np.bincount(sector, weight * residual * column, SECTORS) for column in design.T], axis=1)
    apart = inverse @ (pulls.T @ pulls) @ inverse * SECTORS / (SECTORS - 1)
    alone = inverse * variance
    covariance = (apart if np.trace(apart[:2, :2]) > np.trace(alone[:2, :2]) else alone) / np.outer(scale, scale)
    return _Rings(
        numbers=numbers,
        covariance=covariance[:2, :2],
        turns=turns,
        misfit=whole - coherent,
        variance=variance,
        explained=coherent,
    )


def _from_defect(error: HeightMap, step: float, near: tuple[float, float]) -> TurningCentre | None:
    """Return the middle of what is the same all around it, if it stands out."""
    from scipy.optimize import minimize  # noqa: PLC0415 - scipy is costly to import

    reach = DEFECT_RADIUS * step
    if reach > LARGEST_DEFECT:
        return None
    x, y = error.points()
    region = np.isfinite(error.z) & (np.hypot(x - near[0], y - near[1]) <= 3 * reach)
    if np.count_nonzero(region) < 4 * DEFECT_RADIUS:
        return None
    x, y, z = x[region] - near[0], y[region] - near[1], error.z[region]
    smooth = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    rim = np.hypot(x, y) > 1.5 * reach
    if np.count_nonzero(rim) < 3 * smooth.shape[1]:
        return None
    z = z - smooth @ np.linalg.lstsq(smooth[rim], z[rim], rcond=1e-12)[0]
    noise = float(np.std(z[rim]))

    def profile(at: Floats) -> Floats:
        """Return what the mean around a middle leaves, which is linear between knots that are a pixel apart."""
        away = np.hypot(x - at[0], y - at[1]) / step
        knot = np.minimum(away.astype(np.int64), DEFECT_RADIUS)
        share = np.clip(away - knot, 0.0, 1.0)
        size = DEFECT_RADIUS + 2

        def total(values: Floats) -> Floats:
            return np.bincount(knot, values, size).astype(np.float64)

        normal = np.diag(total((1 - share) ** 2) + np.roll(total(share**2), 1))
        between = total(share * (1 - share))[:-1]
        normal += np.diag(between, 1) + np.diag(between, -1)
        right = total((1 - share) * z) + np.roll(total(share * z), 1)
        # Beyond the last knot there is no defect; a knot without points has no height.
        inner = normal[:DEFECT_RADIUS, :DEFECT_RADIUS] + 1e-9 * np.eye(DEFECT_RADIUS)
        heights = np.append(np.linalg.solve(inner, right[:DEFECT_RADIUS]), np.zeros(2))
        return np.asarray(z - (1 - share) * heights[knot] - share * heights[knot + 1])

    def cost(at: Floats) -> float:
        return float(np.sum(profile(at) ** 2))

    places = np.linspace(-reach, reach, 2 * DEFECT_RADIUS + 1)
    tried = np.array([[cost(np.array([a, b])) for a in places] for b in places])
    b, a = np.unravel_index(int(np.argmin(tried)), tried.shape)
    best = minimize(cost, np.array([places[a], places[b]]), method="Nelder-Mead", options={"xatol": step * 1e-3})
    core = np.hypot(x - best.x[0], y - best.x[1]) < reach
    explained = 1 - float(np.sum(profile(best.x)[core] ** 2)) / max(float(np.sum(z[core] ** 2)), 1e-300)
    if explained < EXPLAINED or float(np.std(z[core])) < 2 * noise:
        return None
    size = step / 4
    jacobian = np.stack(
        [(profile(best.x + one) - profile(best.x - one)) / (2 * size) for one in size * np.eye(2)], axis=1
    )
    # What is not the same all around errs together.
    variance = np.linalg.pinv(jacobian.T @ jacobian) * max(best.fun / max(x.size - DEFECT_RADIUS - 3, 1), noise**2)
    std = np.sqrt(np.diag(variance))
    if float(std.max()) > SURE * step:
        return None
    return TurningCentre(
        x=float(best.x[0] + near[0]), y=float(best.x[1] + near[1]), std=(float(std[0]), float(std[1])),
        source="centre defect", feed=float("nan"), turns=0,
    )  # fmt: skip
