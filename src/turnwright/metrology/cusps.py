r"""The cusps of a turned profile: their spacing, which is the feed, and their height.

A crest is located by the parabola of best fit around it. In a stretch of constant feed the crests lie on a line over
their number,

.. math:: c_k = c_0 + f\,k + \varepsilon_k,

so :math:`f` is the slope of the line of best fit, and its uncertainty falls with the number of cusps to the power of
3/2. Residuals that hang together, as where the feed wanders, widen it by their correlation from cusp to cusp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.metrology.spectrum import line_psd

if TYPE_CHECKING:
    from turnwright.profile import Profile

__all__ = ["Cusps", "Stretch", "find_cusps"]

NM = 1e6

FORM = 4
"""Degree of the polynomial that is taken off before the spectrum is searched."""

ROUNDING = 64 * float(np.finfo(np.float64).eps)
"""Scatter of the heights over the highest of them, below which they are rounded and no more."""

FEWEST = 3
"""Cusps in a profile, at least."""

POINTS = 4
"""Points in a cusp, at least."""

LOWER = 0.6
"""Height of every second crest over that of the others, below which it is none of a pass."""

CHANCE = 1e-4
"""How likely noise alone may show a period that counts."""

WIDE, LEAST_BINS = 1.5, 24
"""Frequencies among which a period must stand out: to either side by this factor, and upward at least so many."""

STRONGER = 3.0
"""Density of the feed over that of its harmonic, at least; a sawtooth has 4 times that of its second."""

BASE, SMOOTH = 0.5, 0.06
"""Standard deviations of the Gaussians that take off what is longer than a cusp, and the noise, over the feed."""

APART = 0.6
"""Distance of two crests, over the feed, at least."""

PROMINENCE = 0.25
"""Height of a crest above its valleys, over the range of the heights, at least."""

AROUND = 0.1
"""Half the width over which a parabola finds a crest or a valley, over the feed."""

OFF = 0.25
"""Share of the feed by which the spacing of two crests may be off it, and they still be neighbours."""

BY_CHANCE = 1e-3
"""How likely noise may space its crests as evenly as those that count."""

NOISE_NEAR = 0.7
"""Share of the spacings of noise that are off by less than `OFF`, spread evenly; the others count as off by it."""

LOCAL = 15
"""Spacings whose median is the feed at a place."""

SHORTEST = 4
"""Crests of a stretch, at least."""

LOCATED = 5e-3
"""Share of the feed to which a crest is located at best: its tip falls between points."""

PENALTY = 4.0
"""Times log(n): how much better another stretch must fit, in units of the crests' scatter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A stretch of a profile in which the feed does not change.

    Parameters
    ----------
    start, end
        Where its first and its last crest stand. [mm]
    feed, feed_std
        Spacing of its cusps, and its standard uncertainty from the scatter of the crests; that of the instrument's
        lateral scale is not in it. [mm]
    count
        Number of its crests.
    """

    start: float
    end: float
    feed: float
    feed_std: float
    count: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cusps:
    """The cusps of a profile. See `find_cusps`.

    Parameters
    ----------
    crest, crest_z
        Where each crest stands along the profile, and how high. (n,) [mm]
    run
        To which unbroken run of neighbours each crest belongs, from 0. (n,)
    feed, feed_std
        Spacing of the cusps over all runs, and its standard uncertainty; see `Stretch`. [mm]
    stretches
        Where the feed does not change: one for each run, several for one in which it does.
    height_at, height_nm
        Where each crest with a valley on either side stands [mm], and how high above the line between the valleys.
        (m,) [nm]
    axis
        Where the profile crosses the spindle axis. A crest within half a feed of it stands between two sides of one
        pass, and does not count for the feed. [mm]
    """

    crest: Floats
    crest_z: Floats
    run: Ints
    feed: float
    feed_std: float
    stretches: tuple[Stretch, ...]
    height_at: Floats
    height_nm: Floats
    axis: float | None

    @property
    def _spaced(self) -> Bools:
        """Whether each crest and the next one are a feed apart."""
        regular = _off_axis(self.crest, self.run, self.axis)
        return np.asarray((np.diff(self.run) == 0) & regular[:-1] & regular[1:])

    @property
    def spacing(self) -> Floats:
        """From each crest to the next one of its run, but for the crest at the axis. [mm]."""
        return np.asarray(np.diff(self.crest)[self._spaced])

    @property
    def spacing_at(self) -> Floats:
        """Middle of each `spacing`. [mm]."""
        return np.asarray(((self.crest[1:] + self.crest[:-1]) / 2)[self._spaced])

    @property
    def scallop_mean_nm(self) -> float:
        """Mean scallop height. [nm]."""
        return float(self.height_nm.mean()) if self.height_nm.size else float("nan")

    @property
    def scallop_median_nm(self) -> float:
        """Median scallop height. [nm]."""
        return float(np.median(self.height_nm)) if self.height_nm.size else float("nan")

    @property
    def scallop_std_nm(self) -> float:
        """Standard deviation of the scallop heights. [nm]."""
        return float(self.height_nm.std(ddof=1)) if self.height_nm.size > 1 else float("nan")

    def between(self, start: float, end: float) -> Cusps:
        """Return the cusps whose crests stand from one distance to another, with their own feed. [mm].

        Raises
        ------
        InputError
            If fewer than three neighbours stand there.
        """
        chosen = (self.crest >= start) & (self.crest <= end)
        higher = (self.height_at >= start) & (self.height_at <= end)
        return _summed_up(
            self.crest[chosen], self.crest_z[chosen], self.run[chosen], self.height_at[higher], self.height_nm[higher],
            self.axis,
        )  # fmt: skip


def find_cusps(profile: Profile, *, feed: float | None = None, axis: float | None = None) -> Cusps:
    """Find the cusps of a profile across the lay, and measure their spacing and their height.

    The strongest period of the slope's spectrum, among those that stand out of the noise around them, is the first
    guess of the feed; the crests themselves decide. They must be spaced more evenly than those of noise. Crests
    whose spacing is off the median around them by more than a quarter are no neighbours: around the spindle axis, and
    at damage, the run ends.

    Parameters
    ----------
    profile
        On even steps, at least four to a cusp and three cusps long. Missing heights are bridged for the search.
    feed
        First guess instead of that of the spectrum, where another period is stronger. [mm]
    axis
        Where the profile crosses the spindle axis: no run goes across it. [mm]

    Raises
    ------
    InputError
        If the profile is uneven, has too few points, shows fewer than three neighbouring cusps, or only noise.

    >>> from turnwright.profile import Profile
    >>> x = np.arange(2000) * 2e-4
    >>> cut = ((x + 0.005) % 0.010 - 0.005) ** 2 / (2 * 0.5)   # 10 um/rev with a nose of 0.5 mm
    >>> found = find_cusps(Profile(distance=x, z=cut, x=x, y=0 * x))
    >>> round(found.feed, 6), round(found.scallop_median_nm, 1)
    (0.01, 25.0)
    """
    from scipy import ndimage, signal  # noqa: PLC0415 - costly to import

    step = profile.step
    valid = ~np.isnan(profile.z)
    if np.count_nonzero(valid) < POINTS * FEWEST:
        raise InputError(
            f"the profile has {np.count_nonzero(valid)} valid heights, cusps need {POINTS * FEWEST}: measure more of it"
        )
    z = np.interp(profile.distance, profile.distance[valid], profile.z[valid])
    if np.std(_without_form(profile.distance, z)) <= ROUNDING * np.abs(z).max():
        raise InputError("the profile is flat, it shows no cusps: give one across the lay")
    guess = _strongest_period(profile, z, step) if feed is None else positive(feed, "the feed", "mm")
    if guess < POINTS * step or guess * FEWEST > np.ptp(profile.distance):
        raise InputError(
            f"the feed is {guess * 1e3:.3g} um, the limits are {POINTS} steps, {POINTS * step * 1e3:.3g} um, and the "
            f"profile over {FEWEST}, {np.ptp(profile.distance) / FEWEST * 1e3:.3g} um: give another first guess, or "
            "measure with smaller pixels"
        )
    # Where crests and valleys stand is looked for without form and waviness; how high they are is not.
    z = _without_form(profile.distance, z)
    level = z - ndimage.gaussian_filter1d(z, BASE * guess / step)
    flat = ndimage.gaussian_filter1d(level, SMOOTH * guess / step)
    least = PROMINENCE * float(np.ptp(np.percentile(flat, (5, 95))))
    tops, _ = signal.find_peaks(flat, distance=max(int(APART * guess / step), 1), prominence=least)
    places = [int(top) for top in tops[valid[tops]]]
    half = max(int(AROUND * guess / step), 1)
    crest = np.array([_turning_point(profile.distance, level, top, half)[0] for top in places])
    # The tip of a crest is sharp: the highest point near it, not the parabola.
    height = np.array([_turning_point(profile.distance, z, _highest(level, top, half), 1)[1] for top in places])
    run, relative = _runs(crest, guess, axis)
    # Where crests are missed, their neighbours stand whole feeds apart.
    same_side = np.ones(relative.size, dtype=bool) if axis is None else (crest[:-1] >= axis) == (crest[1:] >= axis)
    _require_even((relative - np.maximum(np.rint(relative), 1))[same_side], guess)
    at, heights = _heights(profile.distance, z, level, crest, height, run, half)
    if feed is None and _alternating(crest, run, at, heights):
        return find_cusps(profile, feed=2 * guess, axis=axis)
    return _summed_up(crest, height, run, at, heights, axis)


def _without_form(at: Floats, z: Floats) -> Floats:
    return np.asarray(z - np.polynomial.Legendre.fit(at, z, min(FORM, z.size // 8))(at))


def _require_even(off: Floats, guess: float) -> None:
    """Refuse crests whose spacings are off by as much, over the feed, as those of noise are."""
    if not off.size:
        return
    from scipy import stats  # noqa: PLC0415 - costly to import

    square = float(np.mean(np.minimum(np.abs(off), OFF) ** 2))
    # The means of noise follow a gamma distribution with the mean and the variance of these squares.
    mean = OFF**2 * (1 - NOISE_NEAR * 2 / 3)
    variance = OFF**4 * (1 - NOISE_NEAR * 4 / 5) - mean**2
    shape = off.size * mean**2 / variance
    limit = mean * float(stats.gamma.ppf(BY_CHANCE, shape) / shape)
    if square > limit:
        raise InputError(
            f"{off.size + 1} crests about {1e3 * guess:.3g} um apart scatter by {100 * np.sqrt(square):.2g} % of "
            f"it (at most {100 * OFF:g} % each), as those of noise do; cusps scatter by less than "
            f"{100 * np.sqrt(limit):.2g} %: check the feed if it is given, state it if not, or measure with less noise"
        )


def _alternating(crest: Floats, run: Ints, at: Floats, heights: Floats) -> bool:
    """Return whether every second crest of the longest run is much lower: a wave of the edge within each cusp."""
    longest = crest[run == np.argmax(np.bincount(run))] if run.size else crest
    inside = heights[(at >= longest[0]) & (at <= longest[-1])] if longest.size else heights
    if inside.size < 2 * SHORTEST:
        return False
    low, high = sorted((float(np.median(inside[::2])), float(np.median(inside[1::2]))))
    return low < LOWER * high


def _strongest_period(profile: Profile, z: Floats, step: float) -> float:
    """Return the period of the strongest slopes, between four points and a third of the profile. [mm]."""
    spectrum = line_psd(replace(profile, z=z), form=min(FORM, z.size // 8), window="hann")
    frequency, density = spectrum.frequency, spectrum.density
    allowed = (frequency >= FEWEST / np.ptp(profile.distance)) & (frequency <= 1 / (POINTS * step))
    if not density[allowed].any():
        raise InputError("the profile is flat, it shows no cusps: give one across the lay")
    # Of noise each density is its mean times a number of exponential distribution.
    outstanding = density / np.maximum(_surroundings(density), 1e-300)
    limit = float(np.log(density.size / CHANCE))
    score = np.where(allowed & (outstanding > limit), density * frequency**2, 0.0)
    if not score.any():
        most = int(np.argmax(np.where(allowed, outstanding, 0.0)))
        raise InputError(
            f"no cusps stand out of the profile's noise: its strongest period, {1e3 / frequency[most]:.3g} um, has "
            f"{outstanding[most]:.2g} times the power of those around it, the limit is {limit:.2g}: state the feed, "
            "measure with less noise, or give a profile across the lay"
        )
    top = int(np.argmax(score))
    # Sharp cusps have strong harmonics: where half or a third of the frequency is stronger, that is the feed.
    for part in (3, 2):
        low = top // part
        lower = low - 1 + int(np.argmax(density[low - 1 : low + 3])) if low > 1 else top
        if allowed[lower] and density[lower] > STRONGER * density[top]:
            top = lower
            break
    around = slice(max(top - 1, 0), top + 2)
    weight = np.where(allowed, density * frequency**2, 0.0)[around]
    return float(weight.sum() / (weight @ frequency[around]))


def _surroundings(density: Floats) -> Floats:
    """Return the mean density of the noise around each frequency, from the median: a few lines do not move it."""
    size = density.size
    centres = np.unique(np.rint(np.geomspace(1, size - 1, int(4 * np.log2(size)))).astype(np.int64))
    means = [
        float(np.median(density[max(int(c / WIDE), 1) : max(int(WIDE * c), c + LEAST_BINS) + 1])) / np.log(2)
        for c in centres
    ]
    return np.asarray(np.interp(np.log(np.maximum(np.arange(size), 1)), np.log(centres), means))


def _turning_point(at: Floats, z: Floats, index: int, half: int) -> tuple[float, float]:
    """Return place and height of the vertex of a parabola around a point, or the point where it has none near."""
    around = slice(max(index - half, 0), index + half + 1)
    x = at[around] - at[index]
    if x.size < 3:
        return float(at[index]), float(z[index])
    square, slope, height = np.polyfit(x, z[around], 2)
    place = -slope / (2 * square) if square != 0 else 0.0
    if abs(place) > np.ptp(x) / 2:
        return float(at[index]), float(z[index])
    return float(at[index] + place), float(height + place * slope / 2)


def _highest(z: Floats, index: int, half: int) -> int:
    first = max(index - half, 0)
    return first + int(np.argmax(z[first : index + half + 1]))


def _runs(crest: Floats, guess: float, axis: float | None) -> tuple[Ints, Floats]:
    """Return the run of each crest, and each spacing over those around it.

    Neighbours are about a feed apart, on one side of the axis. (n,), (n - 1,)
    """
    from scipy import ndimage  # noqa: PLC0415 - costly to import

    spacing, middle = np.diff(crest), (crest[1:] + crest[:-1]) / 2
    near = np.abs(spacing / guess - 1) < 2 * OFF
    feed = np.full(spacing.size, guess)
    if near.any():
        feed = np.interp(middle, middle[near], ndimage.median_filter(spacing[near], LOCAL, mode="nearest"))
    relative = spacing / feed
    broken = np.abs(relative - 1) > OFF
    if axis is not None:
        broken |= (crest[:-1] < axis) & (crest[1:] >= axis)
    return np.concatenate([[0], np.cumsum(broken)]).astype(np.int64)[: crest.size], relative


def _heights(
    at: Floats, z: Floats, level: Floats, crest: Floats, top: Floats, run: Ints, half: int
) -> tuple[Floats, Floats]:
    """Return the crests with a valley on either side, and their heights over the line between the valleys. [mm, nm]."""
    valleys = {}
    for k in map(int, np.flatnonzero(np.diff(run) == 0)):
        inside = np.flatnonzero((at > crest[k]) & (at < crest[k + 1]))
        lowest = int(inside[np.argmin(level[inside])])
        place, drop = _turning_point(at, level, lowest, half)
        valleys[k] = place, drop + float(np.interp(place, at, z - level))
    places, heights = [], []
    for k in range(1, crest.size - 1):
        if k - 1 in valleys and k in valleys:
            (before, low), (after, lower) = valleys[k - 1], valleys[k]
            line = low + (lower - low) * (crest[k] - before) / (after - before)
            places.append(crest[k])
            heights.append((top[k] - line) * NM)
    return np.array(places), np.array(heights)


def _off_axis(crest: Floats, run: Ints, axis: float | None) -> Bools:
    """Return which crests are further than half a feed from the axis."""
    spacing = np.diff(crest)[np.diff(run) == 0]
    if axis is None or not spacing.size:
        return np.ones(crest.size, dtype=bool)
    return np.asarray(np.abs(crest - axis) > float(np.median(spacing)) / 2)


def _summed_up(crest: Floats, height: Floats, run: Ints, at: Floats, heights: Floats, axis: float | None) -> Cusps:
    """Return the cusps with the feed of all runs and of each stretch."""
    runs = [np.flatnonzero(run == one) for one in np.unique(run)]
    runs = [members for members in runs if members.size >= FEWEST]
    if not runs:
        raise InputError(
            f"the profile shows {crest.size} crests and no {FEWEST} that are neighbours: give the feed as a first "
            "guess, or a profile across the lay"
        )
    kept = np.concatenate(runs)
    crest, height = crest[kept], height[kept]
    run = np.repeat(np.arange(len(runs)), [members.size for members in runs])
    regular = _off_axis(crest, run, axis)
    lines = [crest[(run == one) & regular] for one in range(len(runs))]
    lines = [line for line in lines if line.size >= FEWEST]
    if not lines:
        raise InputError(f"the profile shows no {FEWEST} neighbouring crests away from its axis: measure a longer one")
    feed, feed_std, _ = _slope(lines)
    # The second difference of positions that scatter by s alone scatters by the root of 6 s².
    second = np.concatenate([np.diff(line, 2) for line in lines])
    scatter = max(1.4826 * float(np.median(np.abs(second))) / np.sqrt(6), LOCATED * feed)
    stretches = [one for line in lines for one in _stretches(line, scatter)]
    return Cusps(
        crest=frozen(crest, "crest"),
        crest_z=frozen(height, "crest_z"),
        run=run,
        feed=feed,
        feed_std=feed_std,
        stretches=tuple(stretches),
        height_at=frozen(at, "height_at"),
        height_nm=frozen(heights, "height_nm"),
        axis=axis,
    )


def _slope(lines: list[Floats]) -> tuple[float, float, float]:
    """Return the common slope of lines over their numbers, its standard uncertainty, and the sum of squares."""
    number = np.concatenate([np.arange(line.size) - (line.size - 1) / 2 for line in lines])
    place = np.concatenate([line - line.mean() for line in lines])
    square = float(number @ number)
    slope = float(number @ place / square)
    residual = place - slope * number
    freedom = place.size - len(lines) - 1
    if freedom < 1:
        return slope, float("nan"), float(residual @ residual)
    variance = float(residual @ residual) / freedom
    before, after = (
        np.concatenate([part[side] for part in np.split(residual, np.cumsum([line.size for line in lines])[:-1])])
        for side in (slice(None, -1), slice(1, None))
    )
    correlation = float(np.clip(before @ after / max(residual @ residual, 1e-300), 0.0, 0.9))
    inflation = (1 + correlation) / (1 - correlation)
    return slope, float(np.sqrt(variance * inflation / square)), float(residual @ residual)


def _stretches(line: Floats, scatter: float) -> list[Stretch]:
    """Part a run where its feed changes: the cheapest parting, each part with a line and a price of its own."""
    size = line.size
    price = PENALTY * np.log(size)
    best: list[float] = [0.0] + [np.inf] * size
    begin = [0] * (size + 1)
    for end in range(1, size + 1):
        for start in range(end):
            count = end - start
            if count < min(SHORTEST, size) or not np.isfinite(best[start]):
                continue
            cost = best[start] + _slope([line[start:end]])[2] / scatter**2 + price
            if cost < best[end]:
                best[end], begin[end] = cost, start
    found = []
    end = size
    while end > 0:
        part = line[begin[end] : end]
        feed, feed_std, _ = _slope([part])
        found.append(
            Stretch(start=float(part[0]), end=float(part[-1]), feed=feed, feed_std=feed_std, count=int(part.size))
        )
        end = begin[end]
    return found[::-1]
