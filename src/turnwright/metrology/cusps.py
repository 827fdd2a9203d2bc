"""Cusps of a turned profile: spacing, which is the feed, and height.

In a stretch of constant feed the crests lie on a line over their number, and the feed is its slope. The height of a
scallop is that of the best-fit curves of its two valleys at the crest, above the line between their lowest points;
unlike the highest point, it is not biased by noise or by points that miss the tip. If the edge is wavy, or the
instrument rounds the crests, the curves do not follow the valleys to the crest: the highest and the lowest points are
then used, and their difference from the curves is an uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import legendre

from turnwright._arrays import Bools, Floats, Ints, frozen, robust_scatter
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.metrology.spectrum import line_psd

if TYPE_CHECKING:
    from turnwright.profile import Profile

NM = 1e6

FORM_DEGREE = 4
"""Degree of the polynomial removed before the spectrum is searched."""

ROUNDING_TOL = 64 * float(np.finfo(np.float64).eps)
"""Scatter of the heights, relative to the highest of them, that is rounding only."""

MIN_CUSPS = 3

MIN_PERIODS = 8
"""Least number of cusps in a profile whose feed is not given: fewer cannot be distinguished from waviness."""

MIN_POINTS_PER_CUSP = 4

SPIKE_RATIO = 5.0
"""Height of a spike over the median of five neighbours, relative to the 90th percentile of the height steps."""

ALTERNATION_RATIO = 0.6
"""Ratio of the median heights of odd and even scallops below which they belong to one cusp of twice the period."""

PERIOD_FALSE_ALARM = 1e-4
"""Probability that noise alone shows a period that counts."""

NOISE_BAND_FACTOR, MIN_NOISE_BINS = 1.5, 24
"""Width of the band whose median gives the noise at a frequency: this factor to either side, and at least so many bins
upward."""

FUNDAMENTAL_RATIO = 3.0
"""Least ratio of the power densities of the feed and of its harmonic; a sawtooth has 4 for the second harmonic."""

HIGH_PASS_SIGMA, LOW_PASS_SIGMA = 0.5, 0.06
"""Standard deviations of the Gaussians that remove waves longer than a cusp, and noise, relative to the feed."""

MIN_CREST_DISTANCE = 0.6
"""Least distance of two crests, relative to the feed."""

MIN_PROMINENCE = 0.25
"""Least height of a crest above its valleys, relative to the range of the heights."""

PARABOLA_HALF_WIDTH = 0.1
"""Half the width of the parabola that locates a crest or a valley, relative to the feed."""

SPACING_TOL = 0.25
"""Largest deviation of the spacing of two neighbouring crests from the feed, relative to the feed."""

EVENNESS_FALSE_ALARM = 1e-3
"""Probability that the crests of noise are spaced as evenly as those that count."""

MAX_SPACING_RMS = 0.12
"""Largest rms deviation of the spacings from their median, relative to the feed; noise has 0.18."""

NOISE_NEAR_SHARE = 0.7
"""Share of the spacings of noise that deviate by less than `SPACING_TOL`, uniformly; the others count as that much."""

MAX_STRETCH_SPACING_RMS = 0.10
"""As `MAX_SPACING_RMS`, for part of a profile whose spacings are uneven as a whole."""

SPACING_WINDOW = 15
"""Number of spacings over which the local feed (median) and the local scatter are taken."""

MIN_GAP_FEEDS = 2.0
"""Distance between two crests, or from a crest to the end of the profile, that counts as a gap. [feeds]"""

VALLEY_DEGREES = (2, 3, 4, 6, 8, 10, 12)
"""Degrees tried for the polynomial through a valley; an information criterion selects one."""

MAX_ROUND_DEGREE = 4
"""Largest degree of the polynomial through a valley that still describes a round nose."""

SHAPE_VARIANCE_FACTOR = 15.0
"""Variance of the scallop height from a shape of degree 4, times the number of heights over the variance of one;
the Legendre polynomials of degree 2 and 4 give 45/4 + 225/64."""

CREST_ERROR_FACTOR = 4.0
"""Height added by misplaced crests, relative to the scallop height, times the number of heights in a cusp over the
squared ratio of noise and scallop height; from simulated profiles of 6 to 40 heights a cusp."""

VALLEYS_PER_SHAPE = 16
"""Approximate number of neighbouring valleys that share one shape."""

HUBER_DEVIATIONS = 2.5
"""Mean deviations from the curve of a valley at which the weight of a height begins to fall (Huber)."""

MAX_CROSSING_SHIFT = 0.3
"""Largest distance of the crossing of two valleys from the crest between them, relative to the feed."""

MIN_STRETCH_CRESTS = 4

MIN_CREST_SCATTER = 5e-3
"""Lower bound of the scatter of the crests, relative to the feed: a tip falls between points."""

CREST_CORRELATION = 0.25
"""Correlation of the errors of neighbouring crests, which share a valley. At the ends of a valley the error of its tilt
has 3 times the variance of that of its height; tilt moves both crests the same way, height in opposite ways."""

STRETCH_PENALTY = 4.0
"""Penalty of a further stretch, in units of the variance of the crests; multiplied by log(n)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A stretch of a profile in which the feed does not change.

    Parameters
    ----------
    start, end
        Positions of its first and its last crest. [mm]
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
        Position and height of each crest. (n,) [mm]
    run
        Number, from 0, of the uninterrupted run of neighbours to which each crest belongs. (n,)
    feed, feed_std
        Mean spacing of the cusps, and its standard uncertainty; see `Stretch`. Runs whose spacing deviates by more than
        a quarter from that of the longest are not in it. [mm]
    stretches
        Where the feed does not change: one for each run, several for one in which it does.
    height_at, height_nm
        Position of each crest with a valley on either side [mm], and its height above the line between the lowest
        points of the valleys. (m,) [nm]
    height_bias_nm
        Common uncertainty of these heights from noise and sampling. (m,) [nm]
    axis
        Where the profile crosses the spindle axis. A crest within half a feed of it does not count for the feed. [mm]
    gaps
        Start and end of parts of two feeds or more without cusps. [mm]
    """

    crest: Floats
    crest_z: Floats
    run: Ints
    feed: float
    feed_std: float
    stretches: tuple[Stretch, ...]
    height_at: Floats
    height_nm: Floats
    height_bias_nm: Floats
    axis: float | None
    gaps: tuple[tuple[float, float], ...]

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
        """Standard deviation of the scallop heights; noise of the measurement is in it. [nm]."""
        return float(self.height_nm.std(ddof=1)) if self.height_nm.size > 1 else float("nan")

    @property
    def scallop_mean_std_nm(self) -> float:
        """Standard uncertainty of the mean scallop height. [nm]."""
        return self._mean_std(self.scallop_std_nm)

    @property
    def scallop_median_std_nm(self) -> float:
        """Standard uncertainty of the median scallop height. [nm]."""
        spread = float(np.ptp(np.quantile(self.height_nm, (0.25, 0.75)))) / 1.349 if self.height_nm.size else np.nan
        return float(np.sqrt(np.pi / 2)) * self._mean_std(spread)

    def _mean_std(self, spread: float) -> float:
        """Return the standard uncertainty of a mean of heights of this spread: neighbours share a valley."""
        off = self.height_nm - self.scallop_mean_nm
        if off.size < MIN_CUSPS:
            return float("nan")
        scatter = spread * float(np.sqrt(inflation(off[1:], off[:-1], float(off @ off)) / off.size))
        return float(np.hypot(scatter, self.height_bias_nm.mean()))

    def between(self, start: float, end: float) -> Cusps:
        """Return the cusps with crests between two distances, with their feed. [mm].

        Raises
        ------
        InputError
            If there are fewer than three neighbouring crests.
        """
        chosen = (self.crest >= start) & (self.crest <= end)
        higher = (self.height_at >= start) & (self.height_at <= end)
        crests = _Crests(
            self.crest[chosen], self.crest_z[chosen], self.run[chosen], self.height_at[higher], self.height_nm[higher],
            self.height_bias_nm[higher],
        )  # fmt: skip
        gaps = [(max(low, start), min(high, end)) for low, high in self.gaps if low < end and high > start]
        return _summed_up(crests, self.axis, gaps)


def find_cusps(profile: Profile, *, feed: float | None = None, axis: float | None = None) -> Cusps:
    """Find the cusps of a profile across the lay, and measure their spacing and their height.

    The crests must be spaced more evenly than those of noise. Where a spacing deviates from the local median by more
    than a quarter, as at the spindle axis or at damage, a run ends. Parts without cusps of that feed are searched for
    another feed, unless the first guess is given.

    Parameters
    ----------
    profile
        On even steps, at least four to a cusp, and eight cusps long (three with a first guess of the feed). Missing
        heights and outliers are bridged for the search; a crest in a hole wider than a fifth of the feed does not
        count.
    feed
        First guess instead of that of the spectrum, where another period is stronger or the cusps are few. [mm]
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
    searched = _prepare(profile)
    cusps = _search(searched, feed, axis)
    parts, gaps = [cusps], _gaps(cusps.lines, profile.distance) if feed is None else []
    while gaps:
        # Where the first feed leaves no cusps, there may be another.
        start, end = gaps.pop()
        inside = searched.between(start, end)
        try:
            other = _search(inside, None, axis)
        except InputError:
            continue
        if max(line.size for line in other.lines) < MIN_PERIODS:
            continue
        parts.append(other)
        gaps += _gaps(other.lines, inside.distance)
    joined = _join(parts)
    return _summed_up(joined, axis, sorted(_gaps(joined.lines, profile.distance)))


class _Crests(NamedTuple):
    """Crests, their heights and runs, and the scallops; see `Cusps`."""

    crest: Floats
    crest_z: Floats
    run: Ints
    height_at: Floats
    height_nm: Floats
    bias_nm: Floats  # how far noise and sampling may have moved each height

    def counted(self) -> _Crests:
        """Return the crests of the runs that count."""
        many = np.bincount(self.run)[self.run] >= MIN_CUSPS if self.run.size else np.zeros(0, dtype=bool)
        return self._replace(crest=self.crest[many], crest_z=self.crest_z[many], run=self.run[many])

    @property
    def lines(self) -> list[Floats]:
        """The crests of each run that counts."""
        runs = [self.crest[self.run == one] for one in np.unique(self.run)]
        return [line for line in runs if line.size >= MIN_CUSPS]


def _join(parts: list[_Crests]) -> _Crests:
    parts = [part.counted() for part in parts]
    offset = np.cumsum([0, *(int(part.run.max()) + 1 for part in parts[:-1])])
    runs = np.concatenate([part.run + first for part, first in zip(parts, offset, strict=True)])
    crest, crest_z, _, at, heights, bias = (np.concatenate(values) for values in zip(*parts, strict=True))
    order, higher = np.argsort(crest, kind="stable"), np.argsort(at, kind="stable")
    # Runs do not overlap, so they number themselves in their order.
    number = np.concatenate([[0], np.cumsum(np.diff(runs[order]) != 0)])[: crest.size]
    return _Crests(crest[order], crest_z[order], number, at[higher], heights[higher], bias[higher])


def _gaps(lines: list[Floats], distance: Floats) -> list[tuple[float, float]]:
    """Return where a profile shows no cusps that count."""
    gaps, last, reach = [], float(distance[0]), 0.0
    for line in sorted(lines, key=lambda one: float(one[0])):
        feed = float(np.median(np.diff(line)))
        if line[0] - last > MIN_GAP_FEEDS * max(feed, reach):
            gaps.append((last, float(line[0])))
        last, reach = float(line[-1]), feed
    if distance[-1] - last > MIN_GAP_FEEDS * reach:
        gaps.append((last, float(distance[-1])))
    return gaps


def _prepare(profile: Profile) -> Profile:
    profile.step  # noqa: B018 - refuses uneven distances
    valid, z = _bridged(profile)
    if np.std(_remove_form(profile.distance, z)) <= ROUNDING_TOL * np.abs(z).max():
        raise InputError("the profile is flat, it shows no cusps: give one across the lay")
    return replace(profile, z=np.where(valid & ~spikes(z), profile.z, np.nan))


def _bridged(profile: Profile) -> tuple[Bools, Floats]:
    """Return which heights are valid, and the heights with the missing ones bridged. Each (n,)."""
    valid = ~np.isnan(profile.z)
    if np.count_nonzero(valid) < MIN_POINTS_PER_CUSP * MIN_CUSPS:
        raise InputError(
            f"the profile has {np.count_nonzero(valid)} valid heights, cusps need {MIN_POINTS_PER_CUSP * MIN_CUSPS}: "
            "measure a longer one"
        )
    return valid, np.interp(profile.distance, profile.distance[valid], profile.z[valid])


def spikes(z: Floats) -> Bools:
    """Return which heights stand out of their neighbours far more than those do of theirs. (n,)."""
    from scipy import ndimage  # noqa: PLC0415 - costly to import

    steps = float(np.quantile(np.abs(np.diff(z)), 0.9))
    return np.asarray(np.abs(z - ndimage.median_filter(z, 5, mode="nearest")) > SPIKE_RATIO * steps)


def _search(profile: Profile, feed: float | None, axis: float | None) -> _Crests:
    from scipy import ndimage, signal  # noqa: PLC0415 - costly to import

    step = profile.step
    valid, z = _bridged(profile)
    guess = _strongest_period(profile, z, step) if feed is None else positive(feed, "the feed", "mm")
    if guess < MIN_POINTS_PER_CUSP * step or guess * MIN_CUSPS > np.ptp(profile.distance):
        raise InputError(
            f"the feed must be from {MIN_POINTS_PER_CUSP * step * 1e3:.3g} um ({MIN_POINTS_PER_CUSP} steps) to "
            f"{np.ptp(profile.distance) / MIN_CUSPS * 1e3:.3g} um (a profile of {MIN_CUSPS} cusps), got "
            f"{guess * 1e3:.3g} um: give another first guess, or measure with smaller pixels"
        )
    # Where crests and valleys stand is looked for without form and waviness; how high they are is not.
    z = _remove_form(profile.distance, z)
    level = z - ndimage.gaussian_filter1d(z, HIGH_PASS_SIGMA * guess / step)
    flat = ndimage.gaussian_filter1d(level, LOW_PASS_SIGMA * guess / step)
    least = MIN_PROMINENCE * float(np.ptp(np.percentile(flat, (5, 95))))
    tops, _ = signal.find_peaks(flat, distance=max(int(MIN_CREST_DISTANCE * guess / step), 1), prominence=least)
    half = max(int(PARABOLA_HALF_WIDTH * guess / step), 1)
    tops = tops[_bridge(profile.distance, valid)[tops] <= 2 * PARABOLA_HALF_WIDTH * guess]
    crest = np.array([_turning_point(profile.distance, level, int(top), half)[0] for top in tops])
    run = _runs(crest, guess, axis, given=feed is not None)
    if np.bincount(run, minlength=1).max() < MIN_CUSPS:
        raise InputError(
            f"the profile shows {crest.size} crests and no {MIN_CUSPS} consecutive ones: give the feed as a first "
            "guess, or a profile across the lay"
        )
    scallops = _scallops(profile.distance[valid], level[valid], (z - level)[valid], crest, run, half)
    if feed is None and _alternates(scallops):
        if 2 * guess * MIN_PERIODS > np.ptp(profile.distance):
            raise InputError(
                f"every second crest is lower, so the feed would be {2e3 * guess:.3g} um, too long for {MIN_PERIODS} "
                "cusps: state the feed, or measure a longer profile"
            )
        return _search(profile, 2 * guess, axis)
    return scallops


def _bridge(at: Floats, valid: Bools) -> Floats:
    """Return how far the valid points on either side of each missing point are apart, and 0 of a valid one. [mm]."""
    index = np.arange(at.size)
    before = np.maximum.accumulate(np.where(valid, index, -1))
    after = np.minimum.accumulate(np.where(valid, index, at.size)[::-1])[::-1]
    ends = (before < 0) | (after == at.size)
    return np.where(ends, np.inf, at[np.minimum(after, at.size - 1)] - at[np.maximum(before, 0)])


def _remove_form(at: Floats, z: Floats) -> Floats:
    return np.asarray(z - np.polynomial.Legendre.fit(at, z, min(FORM_DEGREE, z.size // 8))(at))


def _runs(crest: Floats, guess: float, axis: float | None, *, given: bool) -> Ints:
    """Return the run of each crest: neighbours are about a feed apart, on one side of the axis, where all are even."""
    from scipy import ndimage  # noqa: PLC0415 - costly to import

    spacing, middle = np.diff(crest), (crest[1:] + crest[:-1]) / 2
    near = np.abs(spacing / guess - 1) < 2 * SPACING_TOL
    feed = np.full(spacing.size, guess)
    if near.any():
        usual = ndimage.median_filter(spacing[near], SPACING_WINDOW, mode="nearest")
        feed = np.interp(
            middle, middle[near], usual if usual.size > SPACING_WINDOW else np.full_like(usual, np.median(usual))
        )
    relative = spacing / feed
    apart = np.zeros(spacing.size, dtype=bool) if axis is None else (crest[:-1] < axis) & (crest[1:] >= axis)
    even = _regular_spacings(relative, apart, guess, given=given)
    broken = apart | ~even | (np.abs(relative - 1) > SPACING_TOL)
    return np.concatenate([[0], np.cumsum(broken)]).astype(np.int64)[: crest.size]


def _regular_spacings(relative: Floats, apart: Bools, guess: float, *, given: bool) -> Bools:
    """Return which spacings lie where they are more even than those of noise. (n,)."""
    from scipy import ndimage, stats  # noqa: PLC0415 - costly to import

    # Where crests are missed, their neighbours stand whole feeds apart.
    off = np.minimum(np.abs(relative - np.maximum(np.rint(relative), 1)), SPACING_TOL)[~apart]
    if off.size < MIN_CUSPS - 1:
        return np.ones(relative.size, dtype=bool)
    freedom = min(off.size, SPACING_WINDOW) - 1
    square = np.full(off.size, off @ off / freedom)
    if off.size > SPACING_WINDOW:
        square = ndimage.uniform_filter1d(off**2, SPACING_WINDOW, mode="reflect")
    is_even = float(off @ off) <= MAX_SPACING_RMS**2 * freedom * max(off.size / SPACING_WINDOW, 1)
    # Of many stretches of noise one may be even by chance.
    limit = MAX_SPACING_RMS**2 if off.size <= SPACING_WINDOW else MAX_STRETCH_SPACING_RMS**2
    if not given:
        # The means of noise follow a gamma distribution with the mean and the variance of these squares.
        mean = SPACING_TOL**2 * (1 - NOISE_NEAR_SHARE * 2 / 3)
        shape = freedom * mean**2 / (SPACING_TOL**4 * (1 - NOISE_NEAR_SHARE * 4 / 5) - mean**2)
        limit = min(limit, mean * float(stats.gamma.ppf(EVENNESS_FALSE_ALARM, shape) / shape))
    good = square <= limit
    if is_even and (given or off.size > SPACING_WINDOW):
        return np.ones(relative.size, dtype=bool)
    if not good.any():
        raise InputError(
            f"{off.size + 1} crests about {1e3 * guess:.3g} um apart scatter by {100 * np.sqrt(square.min()):.2g} % of "
            f"it (at most {100 * SPACING_TOL:g} % each), like noise; cusps scatter by less than "
            f"{100 * np.sqrt(limit):.2g} %: check the feed if it is given, state it if not, or measure with less noise"
        )
    even = np.ones(relative.size, dtype=bool)
    even[~apart] = ndimage.maximum_filter1d(good, SPACING_WINDOW)
    return even


def _alternates(found: _Crests) -> bool:
    """Return whether every second crest of the longest run is much lower: a wave of the edge within each cusp."""
    longest = found.crest[found.run == np.argmax(np.bincount(found.run))]
    inside = found.height_nm[(found.height_at >= longest[0]) & (found.height_at <= longest[-1])]
    if inside.size < 2 * MIN_STRETCH_CRESTS:
        return False
    low, high = sorted((float(np.median(inside[::2])), float(np.median(inside[1::2]))))
    return low < ALTERNATION_RATIO * high


def _strongest_period(profile: Profile, z: Floats, step: float) -> float:
    """Return the period of the strongest slopes, between four points and an eighth of the profile. [mm]."""
    spectrum = line_psd(replace(profile, z=z), form=min(FORM_DEGREE, z.size // 8), window="hann")
    frequency, density = spectrum.frequency, spectrum.density
    allowed = (frequency >= MIN_PERIODS / np.ptp(profile.distance)) & (frequency <= 1 / (MIN_POINTS_PER_CUSP * step))
    if not density[allowed].any():
        raise InputError("the profile is flat, it shows no cusps: give one across the lay")
    # Of noise each density is its mean times a number of exponential distribution.
    outstanding = density / np.maximum(_surroundings(density), 1e-300)
    limit = float(np.log(density.size / PERIOD_FALSE_ALARM))
    score = np.where(allowed & (outstanding > limit), density * frequency**2, 0.0)
    if not score.any():
        most = int(np.argmax(np.where(allowed, outstanding, 0.0)))
        raise InputError(
            f"no cusps are above the profile's noise: its strongest period, {1e3 / frequency[most]:.3g} um, has "
            f"{outstanding[most]:.2g} times the power of those around it, the limit is {limit:.2g}: state the feed if "
            f"there are fewer than {MIN_PERIODS} cusps, measure with less noise, or give a profile across the lay"
        )
    top = int(np.argmax(score))
    # Sharp cusps have strong harmonics: where half or a third of the frequency is stronger, that is the feed.
    for part in (3, 2):
        low = top // part
        lower = low - 1 + int(np.argmax(density[low - 1 : low + 3])) if low > 1 else top
        if allowed[lower] and density[lower] > FUNDAMENTAL_RATIO * density[top]:
            top = lower
            break
    around = slice(max(top - 1, 0), top + 2)
    weight = np.where(allowed, density * frequency**2, 0.0)[around]
    return float(weight.sum() / (weight @ frequency[around]))


def _surroundings(density: Floats) -> Floats:
    """Return the mean density of the noise around each frequency, from the median: a few lines do not move it."""
    size = density.size
    centres = np.unique(np.rint(np.geomspace(1, size - 1, int(4 * np.log2(size)))).astype(np.int64))
    lows = np.maximum((centres / NOISE_BAND_FACTOR).astype(np.int64), 1)
    highs = np.maximum((NOISE_BAND_FACTOR * centres).astype(np.int64), centres + MIN_NOISE_BINS)
    medians = [np.median(density[low : high + 1]) for low, high in zip(lows, highs, strict=True)]
    means = np.array(medians) / np.log(2)
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


def _scallops(at: Floats, level: Floats, form: Floats, crest: Floats, run: Ints, half: int) -> _Crests:
    """Return the crests where the curves through their valleys cross, and the scallops.

    ``form`` is what was removed from the heights to get their ``level``; ``half`` is the number of points to either
    side of a crest or a valley that belong to it.
    """
    place, fit = crest, _valley_curves(at, level, crest, run, VALLEY_DEGREES)
    # Parabolas cross at the tip of a sharp crest, also in noise; curves through waves of the edge need not.
    crossed = _valley_curves(at, level, crest, run, VALLEY_DEGREES[:1]).crossings(crest)
    refined = _valley_curves(at, level, crossed, run, VALLEY_DEGREES)
    if refined.is_round and refined.misfit < fit.misfit:
        place, fit = crossed, refined
    low_at, low = fit.lowest()
    curved = _heights_over_valleys(place, fit.tops(place), low_at, low + np.interp(low_at, at, form), at, form)
    nearest = _extremes(at, level, place, half)
    extreme = _heights_over_valleys(
        place, nearest[0], nearest[1], nearest[2] + np.interp(nearest[1], at, form), at, form
    )
    heights = curved if fit.is_round else extreme
    chosen = np.isfinite(curved) & np.isfinite(extreme)
    bias = 0.0
    if chosen.any():
        each = float(np.mean(curved[chosen]))
        difference = float(np.mean(extreme[chosen])) - each
        bias = _shared_error(fit, int(np.count_nonzero(chosen)), each) if fit.is_round else abs(difference)
    top = nearest[0] + np.interp(place, at, form)
    return _Crests(place, top, run, place[1:-1][chosen], heights[chosen], np.full(np.count_nonzero(chosen), bias))


def _shared_error(fit: _ValleyCurves, count: int, height: float) -> float:
    """Return how far noise may have moved all scallops together: their shape, and the crests between them. [nm]."""
    noise, points = NM * fit.noise, fit.points / max(count, 1)
    shape = noise * np.sqrt(SHAPE_VARIANCE_FACTOR / max(fit.points, 1))
    return float(np.hypot(shape, CREST_ERROR_FACTOR * noise**2 / (max(height, noise) * max(points, 1.0))))


def _heights_over_valleys(crest: Floats, top: Floats, low_at: Floats, low: Floats, at: Floats, form: Floats) -> Floats:
    """Return how high each inner crest is above the line between the valleys. (n - 2,) [nm]."""
    line = low[:-1] + (low[1:] - low[:-1]) * (crest[1:-1] - low_at[:-1]) / (low_at[1:] - low_at[:-1])
    return np.asarray((top + np.interp(crest, at, form))[1:-1] - line) * NM


def _extremes(at: Floats, level: Floats, crest: Floats, half: int) -> tuple[Floats, Floats, Floats]:
    """Return the height of each crest, and place and height of each valley after one. (n,), (n - 1,), (n - 1,) [mm]."""
    index = np.clip(np.searchsorted(at, crest), 0, at.size - 1)
    # The tip of a crest is sharp: the highest point near it, not the parabola.
    highest = [first + int(np.argmax(level[first : first + 2 * half + 1])) for first in np.maximum(index - half, 0)]
    top = [_turning_point(at, level, one, 1)[1] for one in highest]
    lows = []
    for first, last in pairwise(index):
        lowest = first + int(np.argmin(level[first : max(last, first + 1)]))
        lows.append(_turning_point(at, level, lowest, half))
    return np.array(top), *np.array(lows).reshape(-1, 2).T


class _ValleyCurves(NamedTuple):
    """A polynomial through each valley between neighbouring crests; nan where it has too few points."""

    middle: Floats  # between the crests. (k,) [mm]
    scale: Floats  # half the distance of crests around it. (k,) [mm]
    curve: Floats  # Legendre coefficients. (k, degree + 1) [mm]
    misfit: float = np.inf  # Bayesian information criterion of all valleys
    noise: float = 0.0  # root mean square of what the curves leave, if it is normal [mm]
    points: int = 0

    @property
    def is_round(self) -> bool:
        """Whether the heights bear no other shape than that of a round nose."""
        return bool(self.curve.shape[1] - 1 <= MAX_ROUND_DEGREE)

    def values(self, valley: Ints, place: Floats) -> Floats:
        """Return the heights of valleys at places."""
        scaled = (place - self.middle[valley]) / self.scale[valley]
        basis = legendre.legvander(scaled, self.curve.shape[1] - 1)
        return np.asarray((basis * self.curve[valley]).sum(axis=-1))

    def tops(self, crest: Floats) -> Floats:
        """Return the mean height of the two curves at each crest, or the one at an end of a run. (n,) [mm]."""
        before, after = np.full((2, crest.size), np.nan)
        before[1:] = self.values(np.arange(crest.size - 1), crest[1:])
        after[:-1] = self.values(np.arange(crest.size - 1), crest[:-1])
        return np.where(np.isnan(before), after, np.where(np.isnan(after), before, (before + after) / 2))

    def crossings(self, crest: Floats) -> Floats:
        """Return where the curves on either side of each crest cross, or the crest where they do not. (n,) [mm]."""
        positions = crest.copy()
        inner = np.arange(1, crest.size - 1)
        near = 2 * MAX_CROSSING_SHIFT * np.minimum(self.scale[:-1], self.scale[1:])
        places = crest[inner, None] + near[:, None] * np.linspace(-1, 1, 41)
        before = np.repeat(inner[:, None] - 1, 41, axis=1)
        rise = self.values(before, places) - self.values(before + 1, places)
        up = np.isfinite(rise[:, :1]) & (rise[:, :-1] < 0) & (rise[:, 1:] >= 0)
        first = np.argmin(np.where(up, np.abs(np.arange(40) - 19.5), np.inf), axis=1)
        rows = np.flatnonzero(up.any(axis=1))
        first = first[rows]
        share = -rise[rows, first] / (rise[rows, first + 1] - rise[rows, first])
        positions[inner[rows]] = places[rows, first] + share * (places[rows, first + 1] - places[rows, first])
        return positions

    def lowest(self) -> tuple[Floats, Floats]:
        """Return place and height of the lowest point of each valley. Each (k,) [mm]."""
        share = np.linspace(-1.0, 1.0, 101)
        places = self.middle[:, None] + self.scale[:, None] * share
        rows = np.arange(self.middle.size)
        heights = self.values(np.repeat(rows[:, None], share.size, axis=1), places)
        lowest = np.argmin(np.where(np.isfinite(heights), heights, np.inf), axis=1)
        return places[rows, lowest], heights[rows, lowest]


def _valley_curves(at: Floats, z: Floats, crest: Floats, run: Ints, degrees: tuple[int, ...]) -> _ValleyCurves:
    """Fit the curves of all valleys: of one shape among neighbours, of the degree that the heights bear."""
    count = crest.size - 1
    middle, scale = (crest[1:] + crest[:-1]) / 2, np.full(count, np.nan)
    members = np.flatnonzero(np.diff(run) == 0)
    first, last = np.searchsorted(at, crest[:-1]), np.searchsorted(at, crest[1:])
    blocks = []
    for one in np.unique(run[members]):
        valleys = members[run[members] == one]
        for part in np.array_split(valleys, max(round(valleys.size / VALLEYS_PER_SHAPE), 1)):
            scale[part] = float(np.median(crest[part + 1] - crest[part])) / 2
            blocks.append(part)
    best = _ValleyCurves(middle, scale, np.full((count, 3), np.nan))
    for degree in degrees:
        curve = np.full((count, degree + 1), np.nan)
        deviation, points, parameters = 0.0, 0, 0
        for part in blocks:
            rows = np.concatenate([np.arange(first[k], last[k]) for k in part])
            valley = np.repeat(np.arange(part.size), (last - first)[part])
            basis = legendre.legvander((at[rows] - middle[part][valley]) / scale[part][valley], degree)
            solved = _shape(basis, z[rows], valley, part.size)
            if solved is not None:
                curve[part], residual, number = solved
                deviation += float(np.abs(residual).sum())
                points += rows.size
                parameters += number
        # The Bayesian information criterion chooses between two shapes with different numbers of parameters.
        if points > parameters:
            noise = float(np.sqrt(np.pi / 2)) * deviation / float(np.sqrt(points * (points - parameters)))
            misfit = 2 * points * np.log(max(deviation / points, 1e-300)) + parameters * np.log(points)
            if misfit < best.misfit:
                best = _ValleyCurves(middle, scale, curve, float(misfit), noise, points)
    return best


def _shape(basis: Floats, z: Floats, valley: Ints, count: int) -> tuple[Floats, Floats, int] | None:
    """Return the curve of each valley of a block, the residuals, and how many parameters they took.

    Height and tilt are each valley's own; the rest is that of the block, and may change evenly along it.
    """
    tilt, common = basis[:, 1], basis[:, 2:]
    along = (np.arange(count) - (count - 1) / 2) / max(count - 1, 1)
    if count > MIN_CUSPS:
        common = np.hstack([common, common * along[valley, None]])
    number = common.shape[1] + 2 * count
    starts = np.flatnonzero(np.diff(valley, prepend=-1))
    if z.size <= number or starts.size < count or np.diff(starts, append=z.size).min() < 2:
        return None
    columns = np.column_stack([common, z])
    weight = np.ones(z.size)
    for _ in range(3):
        # Each valley's own line is taken off the shape and off the heights.
        sums = [np.add.reduceat(one, starts) for one in (weight, weight * tilt, weight * tilt * tilt)]
        of_one, of_tilt = (np.add.reduceat((weight * one)[:, None] * columns, starts) for one in (1.0, tilt))
        scale = (sums[0] * sums[2] - sums[1] ** 2)[:, None]
        height = (sums[2][:, None] * of_one - sums[1][:, None] * of_tilt) / scale
        slope = (sums[0][:, None] * of_tilt - sums[1][:, None] * of_one) / scale
        bare = columns - height[valley] - slope[valley] * tilt[:, None]
        weighted = (weight[:, None] * bare[:, :-1]).T
        shape = np.linalg.lstsq(weighted @ bare[:, :-1], weighted @ bare[:, -1], rcond=None)[0]
        residual = bare[:, -1] - bare[:, :-1] @ shape
        far = HUBER_DEVIATIONS * float(np.mean(np.abs(residual)))
        weight = np.minimum(1.0, far / np.maximum(np.abs(residual), 1e-300))
    curve = np.empty((count, basis.shape[1]))
    curve[:, 0] = height[:, -1] - height[:, :-1] @ shape
    curve[:, 1] = slope[:, -1] - slope[:, :-1] @ shape
    parts = shape.reshape(-1, basis.shape[1] - 2)
    curve[:, 2:] = parts[0] + np.outer(along, parts[-1] if len(parts) > 1 else 0 * parts[0])
    return curve, residual, number


def _off_axis(crest: Floats, run: Ints, axis: float | None) -> Bools:
    """Return which crests are further than half a feed from the axis."""
    spacing = np.diff(crest)[np.diff(run) == 0]
    if axis is None or not spacing.size:
        return np.ones(crest.size, dtype=bool)
    return np.asarray(np.abs(crest - axis) > float(np.median(spacing)) / 2)


def _summed_up(found: _Crests, axis: float | None, gaps: list[tuple[float, float]]) -> Cusps:
    """Return the cusps with the feed of all runs and of each stretch."""
    counted = found.counted()
    if not counted.run.size:
        raise InputError(
            f"the profile shows {found.crest.size} crests and no {MIN_CUSPS} consecutive ones: choose more"
        )
    crest, height, at, heights = counted.crest, counted.crest_z, counted.height_at, counted.height_nm
    run = np.unique(counted.run, return_inverse=True)[1].astype(np.int64)
    regular = _off_axis(crest, run, axis)
    lines = [crest[(run == one) & regular] for one in range(int(run[-1]) + 1)]
    lines = [line for line in lines if line.size >= MIN_CUSPS]
    if not lines:
        raise InputError(
            f"the profile shows no {MIN_CUSPS} neighbouring crests away from its axis: measure a longer one"
        )
    # Runs of another feed than that of the longest do not make its mean.
    longest = max(lines, key=lambda line: float(line[-1] - line[0]))
    usual = _slope([longest])[0]
    feed, feed_std, _ = _slope([line for line in lines if abs(_slope([line])[0] / usual - 1) < SPACING_TOL])
    stretches = [one for line in lines for one in _stretches(line, _crest_scatter(line, lines))]
    return Cusps(
        crest=frozen(crest, "crest"),
        crest_z=frozen(height, "crest_z"),
        run=run,
        feed=feed,
        feed_std=feed_std,
        stretches=tuple(stretches),
        height_at=frozen(at, "height_at"),
        height_nm=frozen(heights, "height_nm"),
        height_bias_nm=frozen(found.bias_nm, "height_bias_nm"),
        axis=axis,
        gaps=tuple(gaps),
    )


def _crest_scatter(line: Floats, lines: list[Floats]) -> float:
    """Return how far the crests of a run scatter, by those of all runs of its feed. [mm]."""
    feed = float(np.median(np.diff(line)))
    alike = [one for one in lines if abs(float(np.median(np.diff(one))) / feed - 1) < SPACING_TOL]
    # Of a series with variance s² and the correlation c between neighbours, second differences have (6 - 8 c) s², and
    # means over many (1 + 2 c) s².
    second = np.concatenate([np.diff(one, 2) for one in alike])
    ratio = (1 + 2 * CREST_CORRELATION) / (6 - 8 * CREST_CORRELATION)
    return max(robust_scatter(second) * float(np.sqrt(ratio)), MIN_CREST_SCATTER * feed)


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
    same = np.diff(np.repeat(np.arange(len(lines)), [line.size for line in lines])) == 0
    inflated = variance * inflation(residual[:-1][same], residual[1:][same], float(residual @ residual))
    return slope, float(np.sqrt(inflated / square)), float(residual @ residual)


def inflation(before: Floats, after: Floats, square: float) -> float:
    """Return the factor of the variance of a mean of correlated values, from pairs of neighbours and all squares."""
    correlation = float(np.clip(before @ after / max(square, 1e-300), 0.0, 0.9))
    return (1 + correlation) / (1 - correlation)


def _stretches(line: Floats, scatter: float) -> list[Stretch]:
    """Part a run where its feed changes, by more than its crests scatter about the lines of its parts."""
    parts = _split_run(line, scatter)
    # Crests that share a valley err together, which neighbours do not show: of noise, the parts are then too many.
    square = sum(_slope([part])[2] for part in parts)
    freedom = line.size - 2 * len(parts)
    if len(parts) > 1 and freedom > 0:
        parts = _split_run(line, max(scatter, float(np.sqrt(square / freedom))))
    slopes = [_slope([part]) for part in parts]
    return [
        Stretch(start=float(part[0]), end=float(part[-1]), feed=feed, feed_std=feed_std, count=int(part.size))
        for part, (feed, feed_std, _) in zip(parts, slopes, strict=True)
    ]


def _split_run(line: Floats, scatter: float) -> list[Floats]:
    """Return the cheapest parting of a run, each part with a line and a price of its own."""
    size = line.size
    price = STRETCH_PENALTY * np.log(size)
    number = np.arange(size) - (size - 1) / 2
    off = line - np.polyval(np.polyfit(number, line, 1), number)
    sums = np.array([np.concatenate([[0.0], np.cumsum(one)]) for one in (off, number * off, off * off)])
    best = np.array([0.0] + [np.inf] * size)
    begin = np.zeros(size + 1, dtype=np.int64)
    for end in range(min(MIN_STRETCH_CRESTS, size), size + 1):
        start = np.arange(end - min(MIN_STRETCH_CRESTS, size) + 1)
        count = end - start
        total, moment, square = sums[:, end, None] - sums[:, start]
        middle = number[start] + (count - 1) / 2
        slope_part = (moment - middle * total) ** 2 / (count * (count**2 - 1) / 12)
        residual = np.maximum(square - total**2 / count - slope_part, 0.0)
        cost = best[start] + residual / scatter**2 + price
        begin[end] = int(np.argmin(cost))
        best[end] = cost[begin[end]]
    parts = []
    end = size
    while end > 0:
        parts.append(line[begin[end] : end])
        end = int(begin[end])
    return parts[::-1]
