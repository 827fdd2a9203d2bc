"""Turning axis in a measured map: from the rings of the spiral, or from the centre defect."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Complexes, Floats, robust_scatter
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.metrology.grid import measure, polynomial_terms, valid_points
from turnwright.metrology.least_squares import clustered_covariance

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

TILE_PIXELS = (32, 64)
"""Sides of the tiles in which a wave is searched for; the wider ones are for weak cusps and wide feeds."""

MIN_TILE_WAVES = 3.0
"""Least number of waves in a tile; longer waves are form."""

MIN_PEAK_RATIO = 20.0
"""Power of a peak, relative to the median of its tile, from which it is a wave."""

WAVE_NUMBER_TOL = 0.1
"""Relative difference of the wave numbers of tiles that show the same rings."""

MIN_TILES = 8

MIN_AGREEING_SHARE = 0.5
"""Share of the tiles with waves that must agree on a centre."""

MIN_VALID_SHARE = 0.5
"""Share of its points that a tile or a block must have."""

ANNULI = 8
"""Annuli in each of which the rings have their own amplitude and phase."""

MIN_BLOCK_WAVES, MIN_BLOCK_PIXELS = 2.0, 12
"""Least side of the blocks whose phase is taken."""

MAX_HARMONICS = 3
"""Harmonics of the cusps removed from a block, as far as the pixels resolve them."""

SPIRAL_SENSES = (-1, 0, 1)
"""Change of the phase of the rings with azimuth."""

SEARCH_REACH_STEPS, SEARCH_STEPS_PER_WAVE = 7, 5
"""Steps to each side in the search for the centre, and steps in a wave."""

SECTORS = 16
"""Sectors with independent errors."""

MIN_EXCESS_MISFIT = 36.0
"""Excess of the misfit, in units of its variance, from which an alternative is ruled out."""

MIN_EXPLAINED_RATIO = 10.0
"""Power explained by the rings, relative to the noise that their amplitudes and phases explain."""

MAX_ROUNDS = 5
"""Repetitions of the blocks about an improved centre."""

PHASE_TOL_RAD = 0.03
"""Change of the phase at which the centre has converged."""

DEFECT_RADIUS_PIXELS = 12
"""Radius of a centre defect, and distance within which it is searched for."""

MAX_DEFECT_MM = 0.2
"""Radius beyond which a rotationally symmetric feature is not a centre defect."""

MIN_EXPLAINED_SHARE = 0.5
"""Share of the variance that a radial profile of the defect must explain."""

DEFECT_KNOTS = np.array([*range(DEFECT_RADIUS_PIXELS + 1), 15, 18, 22, 27, 36], dtype=np.float64)
"""Radii between which the profile of a defect is linear; the smooth form is fitted up to the last. [pixels]"""

MAX_DEFECT_STEPS = 20

MAX_ASYMMETRY = 0.05
"""Largest rms deviation of a defect from rotational symmetry beyond the noise, relative to its rms height."""

MIN_BUMP_EXCESS = 0.05
"""Least relative increase of the squared residuals for a bump instead of a radial profile; else it may be dust."""

GRAIN_SIGMA_PIXELS = 1.5
"""Standard deviation of the Gaussian with which grains are searched for."""

MIN_STD_WAVES = 1e-3
"""Lower bound of the standard uncertainty of a centre, from the harmonics of the cusps that remain in the blocks."""

MAX_STD = 0.5
"""Standard uncertainty beyond which no centre is returned, in waves of the rings or in pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningCentre:
    """Position of the turning axis in a map.

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
        Change of the phase of the rings with azimuth: +1 or -1 for a spiral, 0 for closed rings and a centre defect.
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

    The rings of a spiral of feed f about :math:`c` have the phase :math:`\varphi = 2\pi\rho/f - s\theta`. The wave
    vectors in tiles of the map cross near c; least squares of the phase of the cusps in blocks then finds c and f for
    each s of -1, 0 and 1, with amplitude and phase free in each of eight annuli.

    Without rings, a rotationally symmetric centre defect gives the axis: a radial profile and a smooth form of degree 4
    are fitted together, with a free centre. The asymmetry may be at most the noise and 5 %, no other feature of the map
    may be half as high, and no round or oval bump may fit as well, as a grain of dust would.

    Parameters
    ----------
    error
        A rectangular map of what form and pose leave, such as `Registration.error`; form of long wavelength may remain.
    feed
        What the program says; rings of another distance, such as those that too coarse pixels show, then do not count.
        [mm/rev]
    near
        About where a defect of the middle is looked for, within 12 pixels in x and y; rings need no such place. [mm]

    Returns
    -------
    TurningCentre or None
        ``None`` where noise hides the cusps, a pixel is wider than half of the feed, the axis lies outside the map, or
        the sense of the spiral is uncertain, and there is no such defect near; none is seen over pixels above 16.7 um.

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
        raise InputError("the map is polar, so its axis is the centre of its rings: give a rectangular map")
    valid_points(error, TILE_PIXELS[0], "a turning centre")
    step = float(np.diff(grid.columns).mean()) if grid.columns.size > 1 else 1.0
    for side in TILE_PIXELS:
        if min(error.z.shape) >= side and (feed is None or 2 * step <= feed):
            rings = _from_rings(error, feed, side)
            if rings is not None:
                return rings if feed is not None else _fundamental(error, rings)
    return _from_defect(error, step, near)


def _from_rings(error: HeightMap, feed: float | None, side: int) -> TurningCentre | None:
    """Return the centre of the rings that tiles of a side show, if there are any."""
    places, waves, power = _waves(error, side)
    if places.shape[0] < MIN_TILES:
        return None
    size = np.hypot(*waves.T)
    typical = 2 * np.pi / feed if feed is not None else float(np.median(size))
    alike = np.abs(size / typical - 1) < WAVE_NUMBER_TOL
    fewest = max(MIN_TILES, MIN_AGREEING_SHARE * places.shape[0])
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
        last, keep = keep, off <= max(4 * robust_scatter(off[keep]), 1e-9)
        if rank < 2 or np.count_nonzero(keep) < fewest:
            return None  # as of rings that pixels wider than half of them show elsewhere
        if np.array_equal(last, keep):
            break
    return solved, keep


def _waves(error: HeightMap, tile_side: int) -> tuple[Floats, Floats, Floats]:
    """Return where tiles show a wave (n, 2), its wave vector (n, 2) [rad/mm] and its power (n,)."""
    assert error.x is not None and error.y is not None  # noqa: PT018, S101 - a rectangular map
    steps = [float(np.diff(axis).mean()) for axis in (error.x, error.y)]
    u, v = np.meshgrid(*2 * [np.linspace(-1, 1, tile_side)])
    terms = polynomial_terms(u, v, 2).reshape(-1, 6)
    project = np.linalg.pinv(terms)
    window = np.hanning(tile_side)[:, None] * np.hanning(tile_side)
    frequency = np.fft.fftfreq(tile_side)
    slow = np.hypot(frequency, frequency[:, None]) < MIN_TILE_WAVES / tile_side
    places, waves, power = [], [], []
    for row in range(0, error.z.shape[0] - tile_side + 1, tile_side // 2):
        for column in range(0, error.z.shape[1] - tile_side + 1, tile_side // 2):
            tile = error.z[row : row + tile_side, column : column + tile_side]
            valid = np.isfinite(tile).ravel()
            if valid.mean() < MIN_VALID_SHARE:
                continue
            heights = tile.ravel()
            if valid.all():
                flat = heights - terms @ (project @ heights)
            else:
                some = terms * valid[:, None]
                solved = np.linalg.solve(some.T @ some, some.T @ np.where(valid, heights, 0.0))
                flat = np.where(valid, heights - terms @ solved, 0.0)
            flat = flat.reshape(tile.shape) * window
            spectrum = np.abs(np.fft.fft2(flat)) ** 2
            i, j = np.unravel_index(int(np.argmax(np.where(slow, 0.0, spectrum))), spectrum.shape)
            if spectrum[i, j] < MIN_PEAK_RATIO * float(np.median(spectrum[~slow])) or spectrum[i, j] == 0:
                continue
            three = np.arange(-1, 2)
            along = (
                _peak_offset(spectrum[(i + three) % tile_side, j]),
                _peak_offset(spectrum[i, (j + three) % tile_side]),
            )
            ky, kx = (
                2 * np.pi * (frequency[at] + more / tile_side) / step
                for at, more, step in zip((i, j), along, steps[::-1], strict=True)
            )
            middle = slice(row, row + tile_side), slice(column, column + tile_side)
            places.append((float(error.x[middle[1]].mean()), float(error.y[middle[0]].mean())))
            waves.append((kx, ky))
            power.append(float(spectrum[i, j]))
    return np.array(places).reshape(-1, 2), np.array(waves).reshape(-1, 2), np.array(power)


def _peak_offset(three: Floats) -> float:
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


class _Rings(NamedTuple):
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
    for k in range(MAX_ROUNDS):
        blocks = _blocks(error, numbers, turns)
        if blocks is None or not blocks.surround:
            return None
        fits = [one for sense in SPIRAL_SENSES if (one := _fit_rings(blocks, sense, search=k == 0)) is not None]
        if len(fits) < len(SPIRAL_SENSES):
            return None
        best, second = sorted(fits, key=lambda one: one.misfit)[:2]
        moved = np.abs(best.numbers - numbers)[:2].max() * wave
        settled = k > 0 and best.turns == turns and moved < PHASE_TOL_RAD
        numbers, turns = best.numbers, best.turns
        if settled:
            break
    else:
        return None
    feed = float(2 * np.pi / numbers[2])
    std = np.sqrt(np.diag(best.covariance) + (MIN_STD_WAVES * feed) ** 2)
    other_sense = second.misfit - best.misfit < MIN_EXCESS_MISFIT * best.variance
    by_chance = best.explained < MIN_EXPLAINED_RATIO * 2 * ANNULI * best.variance
    if other_sense or by_chance or float(std.max()) > MAX_STD * feed:
        return None
    return TurningCentre(
        x=float(numbers[0]), y=float(numbers[1]), std=(float(std[0]), float(std[1])), source="cusps", feed=feed,
        turns=turns,
    )  # fmt: skip


def _blocks(error: HeightMap, numbers: Floats, turns: int) -> _Blocks | None:
    """Return amplitude and phase of the cusps in blocks, by least squares together with harmonics and form."""
    x, y = error.points()
    step = float(np.diff(x[0]).mean())
    side = max(round(MIN_BLOCK_WAVES * 2 * np.pi / numbers[2] / step), MIN_BLOCK_PIXELS)
    rows, columns = (size // side for size in error.z.shape)

    def blocked(values: Floats) -> Floats:
        cut = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
        return cut.swapaxes(1, 2).reshape(rows * columns, side * side)

    x, y, z = blocked(x), blocked(y), blocked(error.z)
    valid = np.isfinite(z)
    at_x, at_y = x.mean(axis=1), y.mean(axis=1)
    # Across a block that is too close to the centre the rings bend.
    some = (valid.mean(axis=1) > MIN_VALID_SHARE) & (np.hypot(at_x - numbers[0], at_y - numbers[1]) > 1.5 * side * step)
    if np.count_nonzero(some) < 4 * ANNULI:
        return None
    x, y, z, valid, at_x, at_y = x[some], y[some], z[some], valid[some], at_x[some], at_y[some]
    phase = _phase(x, y, numbers, turns)
    u, v = (x - at_x[:, None]) / (side * step), (y - at_y[:, None]) / (side * step)
    harmonics = int(np.clip(0.9 * np.pi / (numbers[2] * step), 1, MAX_HARMONICS))
    waves = [part for k in range(1, harmonics + 1) for part in (np.cos(k * phase), np.sin(k * phase))]
    terms = np.stack([*waves, *np.moveaxis(polynomial_terms(u, v, 2), -1, 0)], axis=1) * valid[:, None]
    normal = terms @ terms.swapaxes(1, 2)
    # A little of the diagonal keeps a block of many missing points from a singular equation.
    normal += 1e-9 * np.eye(normal.shape[1]) * np.trace(normal, axis1=1, axis2=2)[:, None, None]
    inverse = np.linalg.inv(normal)
    solved = (inverse @ (terms @ np.where(valid, z, 0.0)[..., None]))[..., 0]
    return _Blocks(
        x=at_x, y=at_y, amplitude=solved[:, 0] - 1j * solved[:, 1],
        weight=2 / (inverse[:, 0, 0] + inverse[:, 1, 1]), numbers=numbers, turns=turns,
    )  # fmt: skip


def _fit_rings(blocks: _Blocks, turns: int, *, search: bool) -> _Rings | None:
    """Make the phases of the blocks agree in every annulus."""
    numbers, weight = blocks.numbers, blocks.weight
    away = np.hypot(blocks.x - numbers[0], blocks.y - numbers[1])
    near, far = float(away.min()), float(away.max())
    band = np.minimum((away - near) / max(far - near, 1e-300) * ANNULI, ANNULI - 1).astype(np.int64)
    total = np.maximum(np.bincount(band, weight, ANNULI), 1e-300)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(band, weight * values, ANNULI) / total)

    def means(values: Complexes) -> Complexes:
        return np.asarray(mean(values.real) + 1j * mean(values.imag))

    def explained(at: Floats) -> float:
        return float(np.sum(total * np.abs(means(blocks.turned(at, turns))) ** 2))

    if search:
        reach = np.arange(-SEARCH_REACH_STEPS, SEARCH_REACH_STEPS + 1) / SEARCH_STEPS_PER_WAVE * 2 * np.pi / numbers[2]
        tried = [numbers + np.array([a, b, 0.0]) for a in reach for b in reach]
        numbers = max(tried, key=explained)
    for _ in range(20):
        turned = blocks.turned(numbers, turns)
        common = means(turned)[band]
        size = np.abs(common)
        residual = (turned * common.conj()).imag / np.maximum(size, 1e-300)
        u, v = blocks.x - numbers[0], blocks.y - numbers[1]
        rho = np.hypot(u, v)
        ways = -numbers[2] * u / rho - turns * v / rho**2, -numbers[2] * v / rho + turns * u / rho**2, rho
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
    power = float(np.sum(weight * np.abs(turned) ** 2))
    coherent = float(np.sum(total * np.abs(means(turned)) ** 2))
    freedom = len(residual) - ANNULI - 3
    variance = float(np.sum(weight * residual**2)) / freedom
    covariance = _covariance(u, v, design, residual, weight, inverse * variance, 1) / np.outer(scale, scale)
    return _Rings(numbers, covariance[:2, :2], turns, power - coherent, variance, coherent)


def _covariance(
    u: Floats, v: Floats, design: Floats, residual: Floats, weight: Floats, independent: Floats, terms: int
) -> Floats:
    """Return the covariance for independent errors, or for errors common to a sector if that is larger."""
    sector = ((np.arctan2(v, u) / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64) % SECTORS
    common = clustered_covariance(design, residual, weight, sector, terms)
    return common if np.trace(common[:2, :2]) > np.trace(independent[:2, :2]) else independent


def _from_defect(error: HeightMap, step: float, near: tuple[float, float]) -> TurningCentre | None:
    """Return the middle of what is the same all around it, if it stands out alone and is no grain."""
    reach = DEFECT_RADIUS_PIXELS * step
    if reach > MAX_DEFECT_MM:
        return None
    at = _most_alike(error, step, near)
    defect = None
    for _ in range(MAX_ROUNDS):
        last, defect = defect, None if at is None else _Defect.about(error, step, at)
        if defect is None or np.hypot(defect.at[0] - near[0], defect.at[1] - near[1]) > math.sqrt(2) * reach:
            return None
        at = defect.at
        if last is not None and np.abs(last.at - at).max() < 1e-3 * step:
            break
    if defect is None or not defect.is_symmetric or defect.is_grain() or not _is_alone(error, step, defect):
        return None
    std = np.sqrt(np.diag(defect.covariance))
    if float(std.max()) > MAX_STD * step:
        return None
    return TurningCentre(
        x=float(defect.at[0]), y=float(defect.at[1]), std=(float(std[0]), float(std[1])), source="centre defect",
        feed=float("nan"), turns=0,
    )  # fmt: skip


def _most_alike(error: HeightMap, step: float, near: tuple[float, float]) -> Floats | None:
    """Return the place, to a pixel, about which a radial mean explains most of what stands out, if it explains it."""
    reach = DEFECT_RADIUS_PIXELS * step
    x, y = error.points()
    region = np.isfinite(error.z) & (np.hypot(x - near[0], y - near[1]) <= 3 * reach)
    x, y, z = x[region], y[region], error.z[region]
    u, v = x - near[0], y - near[1]
    smooth = polynomial_terms(u / (3 * reach), v / (3 * reach), 2)
    rim = np.hypot(u, v) > 1.5 * reach
    if np.count_nonzero(rim) < 3 * smooth.shape[1] or region.sum() < 4 * DEFECT_RADIUS_PIXELS:
        return None
    z = z - smooth @ np.linalg.lstsq(smooth[rim], z[rim], rcond=1e-12)[0]

    def unexplained(place: Floats) -> float:
        ring = np.minimum(np.rint(np.hypot(x - place[0], y - place[1]) / step).astype(np.int64), DEFECT_RADIUS_PIXELS)
        count, total = (np.bincount(ring, weight, DEFECT_RADIUS_PIXELS + 1) for weight in (np.ones(z.size), z))
        return -float(np.sum(total[:-1] ** 2 / np.maximum(count[:-1], 1)))

    ways = np.linspace(-reach, reach, 2 * DEFECT_RADIUS_PIXELS + 1)
    tried = [np.array([near[0] + a, near[1] + b]) for b in ways for a in ways]
    best = min(tried, key=unexplained)
    core = np.hypot(x - best[0], y - best[1]) < reach
    explained = -unexplained(best) / max(float(np.sum(z[core] ** 2)), 1e-300)
    return best if explained >= MIN_EXPLAINED_SHARE and np.std(z[core]) >= 2 * np.std(z[rim]) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Defect:
    """Heights about a point (n,), fitted by a radial profile about ``at`` and a smooth form."""

    x: Floats
    y: Floats
    z: Floats
    at: Floats
    covariance: Floats
    residual: Floats
    form: Floats  # columns of the form. (n, k)
    step: float

    @classmethod
    def about(cls, error: HeightMap, step: float, start: Floats) -> _Defect | None:
        """Fit heights around a start; None where there are too few, or the middle is not found."""
        extent = DEFECT_KNOTS[-1] * step
        x, y = error.points()
        region = np.isfinite(error.z) & (np.hypot(x - start[0], y - start[1]) <= extent)
        x, y, z = x[region], y[region], error.z[region]
        form = polynomial_terms((x - start[0]) / extent, (y - start[1]) / extent, 4)
        if z.size < 4 * (form.shape[1] + DEFECT_KNOTS.size):
            return None

        def misfit(at: Floats) -> Floats:
            terms = np.hstack([_radial(np.hypot(x - at[0], y - at[1]) / step), form])
            return np.asarray(z - terms @ np.linalg.lstsq(terms, z, rcond=1e-12)[0])

        at, residual, size = start, misfit(start), step / 4
        for _ in range(MAX_DEFECT_STEPS):
            ways = np.stack([(misfit(at + one) - misfit(at - one)) / (2 * size) for one in size * np.eye(2)], axis=1)
            change = -np.linalg.lstsq(ways, residual, rcond=1e-9)[0]
            change *= min(1.0, step / max(float(np.abs(change).max()), 1e-300))
            other = misfit(at + change)
            if other @ other >= residual @ residual:
                break
            at, residual = at + change, other
        normal = np.asarray(np.linalg.pinv(ways.T @ ways), dtype=np.float64)
        u, v = x - at[0], y - at[1]
        core = np.hypot(u, v) < DEFECT_RADIUS_PIXELS * step
        variance = max(float(np.mean(residual[one] ** 2)) for one in (core, ~core))
        covariance = _covariance(u, v, ways, residual, np.ones(z.size), normal * variance, 2)
        return cls(x=x, y=y, z=z, at=at, covariance=covariance, residual=residual, form=form, step=step)

    @property
    def core(self) -> Bools:
        """Which points may belong to it."""
        return np.asarray(np.hypot(self.x - self.at[0], self.y - self.at[1]) < DEFECT_RADIUS_PIXELS * self.step)

    @property
    def noise(self) -> float:
        """Root mean square of the residual outside the core. [mm]."""
        return float(np.sqrt(np.mean(self.residual[~self.core] ** 2)))

    @property
    def is_symmetric(self) -> bool:
        """Whether the core is the same all around but for noise and the steps of its profile."""
        unlike = float(np.mean(self.residual[self.core] ** 2)) - 1.5 * self.noise**2
        profile = _radial(np.hypot(self.x - self.at[0], self.y - self.at[1]) / self.step)
        solved = np.linalg.lstsq(np.hstack([profile, self.form]), self.z, rcond=1e-12)[0]
        above = self.z - self.form @ solved[profile.shape[1] :]
        return unlike < MAX_ASYMMETRY**2 * float(np.mean(above[self.core] ** 2))

    def is_grain(self) -> bool:
        """Whether a round or oval bump explains it as well, such as a grain of dust or a pit shows."""
        from scipy.optimize import least_squares  # noqa: PLC0415 - scipy is costly to import

        u, v = (self.x - self.at[0]) / self.step, (self.y - self.at[1]) / self.step

        def misfit(shape: Floats) -> Floats:
            across, along, shear, p, q, power = shape
            square = (across * (u - p)) ** 2 + (along * (v - q) + shear * (u - p)) ** 2
            bump = np.exp(-((square + 1e-12) ** np.exp(np.clip(power, -1.0, 1.5))))
            terms = np.column_stack([bump, self.form])
            return np.asarray(self.z - terms @ np.linalg.lstsq(terms, self.z, rcond=1e-12)[0])

        best = min(
            float(2 * least_squares(misfit, [1 / width, 1 / width, 0.0, 0.0, 0.0, power], max_nfev=40).cost)
            for width in (DEFECT_RADIUS_PIXELS / 5, DEFECT_RADIUS_PIXELS / 2)
            for power in (0.0, 0.7)
        )
        cost = float(self.residual @ self.residual)
        return best - cost < max(MIN_EXCESS_MISFIT * self.noise**2, MIN_BUMP_EXCESS * cost)


def _radial(away: Floats) -> Floats:
    """Return the hat functions of the knots at distances in pixels. (n, knots - 1); beyond the last it is flat."""
    place = np.interp(away, DEFECT_KNOTS, np.arange(DEFECT_KNOTS.size))
    return np.asarray(np.maximum(1 - np.abs(place[:, None] - np.arange(DEFECT_KNOTS.size - 1)), 0.0))


def _is_alone(error: HeightMap, step: float, defect: _Defect) -> bool:
    """Whether nothing else in the map stands out half as far over its surroundings: where grains lie, it may be one."""
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    x, y = error.points()
    valid = np.isfinite(error.z)
    u, v = (x - x.mean()) / np.ptp(x), (y - y.mean()) / np.ptp(y)
    form = polynomial_terms(u, v, 2)
    flat = error.z - form @ np.linalg.lstsq(form[valid], error.z[valid], rcond=1e-12)[0]

    def smooth(sigma: float) -> tuple[Floats, Floats]:
        weight = ndimage.gaussian_filter(valid.astype(np.float64), sigma, mode="constant")
        return ndimage.gaussian_filter(np.where(valid, flat, 0.0), sigma, mode="constant") / np.maximum(
            weight, 1e-9
        ), weight

    (fine, _), (coarse, weight) = smooth(GRAIN_SIGMA_PIXELS), smooth(DEFECT_RADIUS_PIXELS / 2)
    stands = np.abs(fine - coarse) * (valid & (weight > 0.95))
    away = np.hypot(x - defect.at[0], y - defect.at[1])
    inside, outside = (
        float(stands[one].max(initial=0.0))
        for one in (away < DEFECT_RADIUS_PIXELS * step, away > 2 * DEFECT_RADIUS_PIXELS * step)
    )
    return outside < 0.5 * inside
