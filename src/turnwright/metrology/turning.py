"""The axis of turning in a measured map: from the rings of the spiral, or from the defect at its middle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.metrology._grid import measure, valid_points

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["TurningCentre", "turning_centre"]

TILE = 32
"""Side of the tiles that a wave is looked for in. [pixels]"""

WAVES = 3.0
"""Waves that a tile must hold at least: slower ones are form."""

PROMINENT = 30.0
"""Power of a peak over the median of its tile from which it is a wave and no chance."""

ALIKE = 0.1
"""Share of the wave number by which tiles may differ and still show the same rings."""

FEWEST_TILES = 8
"""Tiles with rings that a centre needs."""

SHARED = 0.5
"""Share of the tiles with waves that must agree on a centre."""

BANDS = 8
"""Annuli that the rings may have an amplitude and a phase of their own in."""

POINTS = 20_000
"""Points that rings are fitted to."""

DEFECT_RADIUS = 12
"""Radius of what may be a defect of the middle, and how far it is looked for. [pixels]"""

LARGEST_DEFECT = 0.2
"""A defect of the middle is no larger: over coarser pixels something else is the same all around. [mm]"""

EXPLAINED = 0.5
"""Share of the variance that a defect turned about its middle must explain."""

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

    The rings of a spiral of feed f about :math:`c` have the phase :math:`\varphi = 2\pi\rho/f - s\theta`, so their wave
    vector k at p keeps :math:`(p - c) \times k = -s`. Tiles of the map give k, least squares c and s; then the phases
    of all points are fitted, with amplitude and phase free in each of eight annuli. A defect of the middle is what is
    the same all around it: its radial mean is fitted about every place.

    Parameters
    ----------
    error
        A rectangular map of what form and pose leave, such as `Registration.error`; form of long wavelength may remain.
    feed
        What the program says; rings of another distance, such as those that too coarse pixels show, then do not count.
        [mm/rev]
    near
        About where the axis is. [mm]

    Returns
    -------
    TurningCentre or None
        ``None`` where neither rings nor a defect of the middle tell it.

    Raises
    ------
    InputError
        If the map is scattered or polar.

    Sources
    -------
    Oracle: rings and spirals made about a known centre.
    """
    if feed is not None:
        positive(feed, "feed", "mm/rev")
    grid = measure(error)
    if error.x is None or error.y is None:
        raise InputError("the map is polar, which has the middle of its rings for an axis: give a rectangular map")
    valid_points(error, TILE, "a turning centre")
    step = float(np.diff(grid.columns).mean()) if grid.columns.size > 1 else 1.0
    found = None
    if min(error.z.shape) >= TILE and (feed is None or 2 * step <= feed):
        found = _from_rings(error, feed, np.array(near, dtype=np.float64))
    return found if found is not None else _from_defect(error, step, near)


def _from_rings(error: HeightMap, feed: float | None, near: Floats) -> TurningCentre | None:
    """Return the centre of the rings, if there are any."""
    places, waves, power = _waves(error)
    if places.shape[0] < FEWEST_TILES:
        return None
    size = np.hypot(*waves.T)
    typical = 2 * np.pi / feed if feed is not None else float(np.median(size))
    alike = np.abs(size / typical - 1) < ALIKE
    if np.count_nonzero(alike) < max(FEWEST_TILES, SHARED * places.shape[0]):
        return None
    places, waves, power = places[alike], waves[alike], power[alike]
    waves = waves * np.where(((places - near) * waves).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    # c x k - s = p x k, linear in c and s; a wave vector of the wrong sign or of something else stands out.
    rows = np.stack([waves[:, 1], -waves[:, 0], -np.ones(len(waves))], axis=1)
    right = places[:, 0] * waves[:, 1] - places[:, 1] * waves[:, 0]
    keep = np.ones(len(waves), dtype=np.bool_)
    solved = np.zeros(3)
    for _ in range(10):
        solved, _, rank, _ = np.linalg.lstsq(rows[keep], right[keep], rcond=1e-6)
        off = np.abs(rows @ solved - right)
        last, keep = keep, off <= max(4 * 1.4826 * float(np.median(off[keep])), 1e-9)
        if rank < 3 or np.count_nonzero(keep) < max(FEWEST_TILES, SHARED * places.shape[0]):
            return None  # as of rings that pixels wider than half of them show elsewhere
        if np.array_equal(last, keep):
            break
    wave = float(np.average(np.hypot(*waves[keep].T), weights=power[keep]))
    turns = int(np.clip(np.rint(solved[2]), -1, 1))
    return _coherent(error, solved[:2], wave, turns)


def _waves(error: HeightMap) -> tuple[Floats, Floats, Floats]:
    """Return where tiles show a wave (n, 2), its wave vector (n, 2) [rad/mm] and its power (n,)."""
    assert error.x is not None and error.y is not None  # noqa: PT018, S101 - a rectangular map
    steps = [float(np.diff(axis).mean()) for axis in (error.x, error.y)]
    side = np.linspace(-1, 1, TILE)
    u, v = np.meshgrid(side, side)
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
    project = terms @ np.linalg.pinv(terms)
    window = np.hanning(TILE)[:, None] * np.hanning(TILE)
    frequency = np.fft.fftfreq(TILE)
    slow = np.hypot(frequency, frequency[:, None]) < WAVES / TILE
    places, waves, power = [], [], []
    for row in range(0, error.z.shape[0] - TILE + 1, TILE // 2):
        for column in range(0, error.z.shape[1] - TILE + 1, TILE // 2):
            tile = error.z[row : row + TILE, column : column + TILE]
            if not np.isfinite(tile).all():
                continue
            flat = (tile.ravel() - project @ tile.ravel()).reshape(tile.shape) * window
            spectrum = np.abs(np.fft.fft2(flat)) ** 2
            spectrum[slow] = 0.0
            i, j = np.unravel_index(int(np.argmax(spectrum)), spectrum.shape)
            if spectrum[i, j] < PROMINENT * float(np.median(spectrum[~slow])) or spectrum[i, j] == 0:
                continue
            along = [
                _between(spectrum[(i + np.arange(-1, 2)) % TILE, j]),
                _between(spectrum[i, (j + np.arange(-1, 2)) % TILE]),
            ]
            ky, kx = (
                2 * np.pi * (frequency[at] + more / TILE) / step
                for at, more, step in zip((i, j), along, steps[::-1], strict=True)
            )
            middle = slice(row, row + TILE), slice(column, column + TILE)
            places.append((float(error.x[middle[1]].mean()), float(error.y[middle[0]].mean())))
            waves.append((kx, ky))
            power.append(float(spectrum[i, j]))
    return np.array(places).reshape(-1, 2), np.array(waves).reshape(-1, 2), np.array(power)


def _between(three: Floats) -> float:
    """Return where between its neighbours a peak has its top: of a Hann window the log of the power is a parabola."""
    low, top, high = np.log(np.maximum(three, 1e-300))
    bend = low - 2 * top + high
    return float(np.clip((low - high) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def _coherent(error: HeightMap, start: Floats, wave: float, turns: int) -> TurningCentre | None:
    """Fit the phase of all points about a centre; None where it is not sure."""
    from scipy.ndimage import gaussian_filter  # noqa: PLC0415 - scipy is costly to import
    from scipy.optimize import least_squares  # noqa: PLC0415

    x, y = error.points()
    known = np.isfinite(error.z)
    filled = np.where(known, error.z, 0.0)
    step = float(np.diff(x[0]).mean())
    width = 2 * np.pi / wave / step / 2
    share = gaussian_filter(known.astype(np.float64), width)
    rough = filled - gaussian_filter(filled, width) / np.maximum(share, 1e-6)
    known &= share > 0.9
    index = np.flatnonzero(known)
    if index.size < 20 * BANDS:
        return None
    index = index[:: -(-index.size // POINTS)]
    x, y, z = x.ravel()[index], y.ravel()[index], rough.ravel()[index]
    z = z / max(float(np.std(z)), 1e-300)
    band = np.minimum(
        (np.hypot(x - start[0], y - start[1]) / np.hypot(x - start[0], y - start[1]).max() * BANDS), BANDS - 1
    )
    band = band.astype(np.int64)

    def left(numbers: Floats) -> Floats:
        u, v = x - numbers[0] / wave, y - numbers[1] / wave
        phase = wave * (1 + numbers[2] * 1e-3) * np.hypot(u, v) - turns * np.arctan2(v, u)
        both = np.stack([np.cos(phase), np.sin(phase)])
        out = z.copy()
        for k in range(BANDS):
            mine = band == k
            if np.count_nonzero(mine) > 4:
                columns = both[:, mine].T
                out[mine] -= columns @ np.linalg.lstsq(columns, z[mine], rcond=1e-9)[0]
        return out

    # Starts a fraction of a wave around: from the next ring it would be a worse fit, but a fit.
    begun = np.array([*(start * wave), 0.0])
    around = [begun + np.array([a, b, 0.0]) for a in (-2.0, 0.0, 2.0) for b in (-2.0, 0.0, 2.0)]
    fits = [least_squares(left, one, diff_step=[1e-6] * 3, max_nfev=30) for one in around]
    best = min(fits, key=lambda one: one.cost)
    explained = 1 - 2 * best.cost / float(z @ z)
    noise = 2 * best.cost / (z.size - 2 * BANDS - 3)
    jacobian = np.asarray(best.jac, dtype=np.float64)
    normal = jacobian.T @ jacobian
    std = np.sqrt(np.maximum(np.diag(np.linalg.pinv(normal)) * noise, 0.0))[:2] / wave
    # By chance two numbers in each annulus explain as much as that.
    if explained < 10 * 2 * BANDS / z.size or float(std.max()) > SURE * 2 * np.pi / wave:
        return None
    feed = 2 * np.pi / (wave * (1 + best.x[2] * 1e-3))
    return TurningCentre(
        x=float(best.x[0] / wave), y=float(best.x[1] / wave), std=(float(std[0]), float(std[1])), source="cusps",
        feed=float(feed), turns=turns,
    )  # fmt: skip


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
    knots = np.arange(DEFECT_RADIUS + 1) * step

    def profile(at: Floats) -> Floats:
        """Return what the mean around a middle leaves."""
        away = np.hypot(x - at[0], y - at[1])
        columns = np.maximum(1 - np.abs(away[:, None] - knots[:-1]) / step, 0.0)
        return np.asarray(z - columns @ np.linalg.lstsq(columns, z, rcond=1e-9)[0])

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
    variance = np.linalg.pinv(jacobian.T @ jacobian) * max(best.fun / max(x.size - knots.size - 2, 1), noise**2)
    std = np.sqrt(np.diag(variance))
    if float(std.max()) > SURE * step:
        return None
    return TurningCentre(
        x=float(best.x[0] + near[0]), y=float(best.x[1] + near[1]), std=(float(std[0]), float(std[1])),
        source="centre defect", feed=float("nan"), turns=0,
    )  # fmt: skip
