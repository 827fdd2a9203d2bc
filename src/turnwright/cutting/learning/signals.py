r"""Processing of force records: drift, low-pass, saturation, detection of cuts, and averages with their uncertainty.

Neighbouring samples of a force are correlated. Every uncertainty here counts n samples as n/τ independent ones, where
τ is the integrated correlation time

.. math:: \tau = 1 + 2 \sum_{k=1}^{M} \rho_k

of their autocorrelation ρ, summed up to the first M ≥ 5 τ [Sokal1997]_.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen, robust_scatter
from turnwright._validate import between, check_numbers, positive, whole_number
from turnwright.errors import InputError
from turnwright.units import MOST

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "ForceAverage",
    "ForceRecord",
    "average_force",
    "correlation_time",
    "engagements",
    "find_clipped",
    "find_runs",
    "find_saturated",
    "in_air",
    "low_pass",
    "remove_drift",
    "require_unsaturated",
]

SUM_WINDOW = 5.0
"""Range of the sum of autocorrelations, in correlation times."""

MAX_FILTER_ORDER = 10

MAX_DRIFT_DEGREE = 6
"""A polynomial of higher degree would follow the cuts."""

CUT_SIGMA = 5.0
"""Height of a cutting force above the level in air, in standard deviations of the noise."""

MAX_AIR_RESIDUAL_SIGMA = 2.0
"""Largest residual of the drift in air, in standard deviations of the noise."""

ABOVE_WEIGHT = 1e-3
"""Weight of samples above the level in air, relative to those below, in its first estimate."""

MIN_RUN = 5
"""Length of a run of equal extreme values that counts as saturated."""

NOISELESS_TOL = 1e-9
"""Scatter over force below which forces have no noise except rounding."""

MIN_LEVELS = 6
"""Number of different values that a channel needs to be judged."""

TRIAL_COUNTS = 400
"""Number of trial sizes of a saturated group."""

SIGNIFICANCE = 1e-6
"""Probability below which a group of close extreme values is not explained by noise."""

MIN_FILL = 0.9
"""Fraction of the values between the first and the last saturated one that must be saturated."""

MIN_RUN_RATIO = 2
"""Ratio of the longest run at the extreme to the longest elsewhere; forces without noise have long runs everywhere."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceRecord:
    """Forces sampled at a constant rate.

    Parameters
    ----------
    force
        One column for each channel. (n, channels) [N]
    rate_hz
        Sampling rate. [Hz]
    channels
        Name of each column.
    name
        Name of the record, for messages.

    Raises
    ------
    InputError
        If the number of names differs from that of the columns, names repeat, a value is not finite, or a channel is
        saturated.

    >>> record = ForceRecord(force=[[0.0, 1.0], [2.0, 3.0]], rate_hz=10.0, channels=("Fx", "Fz"))
    >>> record.channel("-Fz").tolist()
    [-1.0, -3.0]
    """

    force: Floats
    rate_hz: float
    channels: tuple[str, ...]
    name: str = ""

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "channels", tuple(self.channels))
        label = f"the force record {self.name!r}" if self.name else "a force record"
        object.__setattr__(self, "force", frozen(self.force, label, ndim=2))
        largest = float(np.abs(self.force).max(initial=0.0))
        if largest > MOST:
            raise InputError(f"{label} holds {largest:.3g} N, the limit is {MOST:g} N: check the unit of its channels")
        object.__setattr__(self, "rate_hz", positive(self.rate_hz, "rate_hz", "Hz"))
        if self.force.shape[1] != len(self.channels) or len(set(self.channels)) != len(self.channels):
            raise InputError(
                f"{label} must have one unique channel name for each column, got {self.force.shape[1]} columns and the "
                f"channels {', '.join(self.channels) or 'none'}"
            )
        if self.force.shape[0] < 2:
            raise InputError(f"{label} must have at least 2 samples, got {self.force.shape[0]}")
        for name, column in zip(self.channels, self.force.T, strict=True):
            require_unsaturated(label, name, column, find_saturated(column), self.rate_hz)

    @property
    def samples(self) -> int:
        """Number of samples of each channel."""
        return int(self.force.shape[0])

    @property
    def time(self) -> Floats:
        """Time since the first sample. (n,) [s]."""
        return np.arange(self.samples) / self.rate_hz

    def channel(self, name: str) -> Floats:
        """Return one column, negated if its name is preceded by a minus sign. (n,) [N]."""
        sign, plain = (-1.0, name[1:]) if name.startswith("-") and name not in self.channels else (1.0, name)
        if plain not in self.channels:
            raise InputError(
                f"the force record {self.name!r} has no channel {plain!r}, it has {', '.join(self.channels)}: choose "
                "one of these, with a minus sign to reverse its direction"
            )
        return sign * self.force[:, self.channels.index(plain)]


def low_pass(record: ForceRecord, cutoff_hz: float, order: int) -> ForceRecord:
    r"""Low-pass a force record without phase shift.

    A Butterworth filter is applied forward and backward, so that its phases cancel and its gains multiply:

    .. math:: |G(f)| = \frac{1}{1 + (\tan(\pi f/f_s) / \tan(\pi f_c/f_s))^{2n}}

    which is 1/2 (-6 dB) at the cut-off frequency.

    Parameters
    ----------
    record
        Force record.
    cutoff_hz
        Cut-off frequency, with a gain of 1/2. [Hz]
    order
        Order n of the one-way filter, 1 to 10.

    Raises
    ------
    InputError
        If the cut-off frequency is not between 0 and half the sampling rate, or the order is out of range.

    Sources
    -------
    Oracle: the gain of the bilinear Butterworth filter in closed form.
    """
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415 - costly to import

    half = record.rate_hz / 2
    if not 0 < cutoff_hz < half:
        raise InputError(f"cutoff_hz must be between 0 and {half:g} Hz (half the sampling rate), got {cutoff_hz:g} Hz")
    order = whole_number(order, "the order of a low-pass", 1, MAX_FILTER_ORDER)
    # The ends are extended by odd reflection over the impulse response of the filter.
    pad = min(record.samples - 1, int(np.ceil(4 * order * record.rate_hz / cutoff_hz)))
    sections = butter(order, cutoff_hz, fs=record.rate_hz, output="sos")
    return replace(record, force=sosfiltfilt(sections, record.force, axis=0, padlen=pad))


def correlation_time(values: ArrayLike) -> float:
    r"""Compute the integrated correlation time of evenly sampled values: the samples per independent value.

    Parameters
    ----------
    values
        Samples; their mean is subtracted. (n,) [any unit]

    Returns
    -------
    float
        At least 1. [samples]

    Raises
    ------
    InputError
        If there are fewer than 2 values.

    Sources
    -------
    [Sokal1997]_ section 3; [Wolff2004]_ for the bias due to the mean. Oracle: (1 + a)/(1 - a) of a first-order
    autoregression.
    """
    series = frozen(values, "values")
    n = series.size
    if n < 2:
        raise InputError(f"a correlation time needs at least 2 values, got {n}")
    centred = series - series.mean()
    padded = 1 << (2 * n - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, padded)) ** 2
    auto = np.fft.irfft(spectrum, padded)[:n]
    if not auto[0] > 0:
        return 1.0
    tau = 2 * np.cumsum(auto / auto[0]) - 1
    enough = np.flatnonzero(np.arange(n) >= SUM_WINDOW * tau)
    window = int(enough[0]) if enough.size else int(np.argmax(tau))
    # Correction for the bias due to the subtracted mean.
    return float(max(1.0, tau[window] * (1 + (2 * window + 1) / n)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceAverage:
    """Mean force over an interval of a record.

    Parameters
    ----------
    mean
        Mean of each channel. (channels,) [N]
    uncertainty
        Standard uncertainty of each mean, including the correlation of samples. (channels,) [N]
    samples
        Number of averaged samples.
    independent
        Equivalent number of independent samples. (channels,)
    """

    mean: Floats
    uncertainty: Floats
    samples: int
    independent: Floats


def average_force(record: ForceRecord, start: int, stop: int) -> ForceAverage:
    """Average the samples from ``start`` up to, but not including, ``stop``.

    Raises
    ------
    InputError
        If this is not an interval of at least 8 samples within the record.
    """
    if not 0 <= start < stop <= record.samples or stop - start < 8:
        raise InputError(f"start and stop must span at least 8 of the {record.samples} samples, got {start} to {stop}")
    piece = record.force[start:stop]
    tau = np.array([correlation_time(column) for column in piece.T])
    independent = np.maximum((stop - start) / tau, 1.0)
    spread = piece.std(axis=0)
    # The variance about the mean of m independent values is biased by (m-1)/m.
    uncertainty = spread / np.sqrt(np.maximum(independent - 1, 0.5))
    return ForceAverage(
        mean=frozen(piece.mean(axis=0), "mean"),
        uncertainty=frozen(uncertainty, "uncertainty"),
        samples=stop - start,
        independent=frozen(independent, "independent"),
    )


def find_runs(mask: Bools) -> Ints:
    """Return the intervals of true values. (m, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return edges.reshape(-1, 2).astype(np.int64)


def _fit_lower_level(values: Floats, basis: Floats) -> Floats:
    """Return a smooth level below nearly all values, by least squares with a small weight for values above it."""
    level = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    for _ in range(60):
        weight = np.sqrt(np.where(values > level, ABOVE_WEIGHT, 1.0))
        after = basis @ np.linalg.lstsq(basis * weight[:, None], values * weight, rcond=None)[0]
        if np.allclose(after, level, rtol=0, atol=1e-9 * np.ptp(values)):
            return after
        level = after
    return level


def engagements(record: ForceRecord, channel: str, *, shortest: float, drift: int = 1, lead: float = 0.0) -> Ints:
    """Find the cuts in a force record.

    The level in air is a polynomial in time below the force. Forces above it by five standard deviations of the noise
    are cuts. Each entry and exit is then located, to the sample, by the best fit of a step.

    Parameters
    ----------
    record
        Force record; the tool must be in air for part of the time.
    channel
        Channel that distinguishes best between cut and air, usually the cutting force. It must be positive in the cut
        ("-Fy" for the negative of "Fy").
    shortest
        Shorter cuts and shorter gaps are treated as noise. [s]
    drift
        Degree of the polynomial.
    lead
        Time in air at the beginning and at the end of the record. It separates a slow ramp from the drift. Without it
        the level in air is a smooth curve below nearly all of the force, which needs air throughout the record. [s]

    Returns
    -------
    Ints
        First sample of each cut and first one after it, in order. (m, 2)

    Raises
    ------
    InputError
        If no cut is found, the tool is never in air, or what is taken for air is not a smooth drift.
    """
    force = record.channel(channel)
    least = round(positive(shortest, "shortest", "s") * record.rate_hz)
    block = max(1, least // 8)
    count = record.samples // block
    if least < 8 or count < 32:
        raise InputError(
            f"shortest must span 8 to {record.samples // 4} samples, got {shortest:g} s, which is {least} of "
            f"{record.samples} samples"
        )
    means = force[: count * block].reshape(count, block).mean(axis=1)
    degree = whole_number(drift, "the degree of the drift", 0, MAX_DRIFT_DEGREE)
    basis = np.asarray(np.polynomial.legendre.legvander(np.linspace(-1, 1, count), degree), dtype=np.float64)
    # Differences of neighbours give the noise independent of the level.
    noise = robust_scatter(np.diff(means)) / np.sqrt(2)
    noise = max(noise, 1e-9 * float(np.ptp(means)), 1e-12 * float(np.abs(means).max()), np.finfo(np.float64).tiny)
    lead_blocks = round(between(lead, "lead", 0.0, record.samples / record.rate_hz / 2, "s") * record.rate_hz) // block
    if lead_blocks:
        air = (np.arange(count) < lead_blocks) | (np.arange(count) >= count - lead_blocks)
    else:
        air = means < _fit_lower_level(means, basis) + 2 * CUT_SIGMA * noise
    level = means  # if there is too little air to fit the drift
    for _ in range(50):
        if np.count_nonzero(air) < max(8, basis.shape[1] + 2):
            break
        level = basis @ np.linalg.lstsq(basis[air], means[air], rcond=None)[0]
        after = np.abs(means - level) < CUT_SIGMA * noise if lead_blocks else means < level + CUT_SIGMA * noise
        if (after == air).all():
            break
        air = after
    residual = float((means - level)[air].std()) / noise if air.any() else 0.0
    if not lead_blocks and residual > MAX_AIR_RESIDUAL_SIGMA:
        raise InputError(
            f"the forces in air of channel {channel} of the force record {record.name!r} deviate from a drift of "
            f"degree {drift} by {residual:.3g} times the noise, the limit is {MAX_AIR_RESIDUAL_SIGMA:g}: state lead "
            "(the time in air at both ends), change the degree of the drift, or reverse the channel"
        )
    shape = max(1, least // block)
    # Gaps are closed first: a weak cut may fall below the limit in places.
    cut = _drop_short_runs(~_drop_short_runs(air, shape), shape)
    runs = find_runs(cut)
    if not runs.size or np.count_nonzero(~cut) < 8:
        state = "is always in air" if not runs.size else "is never in air"
        raise InputError(
            f"according to channel {channel} of the force record {record.name!r} the tool {state}: record air before "
            "and after the cut, check the sign of the channel, or change shortest"
        )
    reach = 4 * block
    spans = [(_find_step(force, first * block, reach), _find_step(force, last * block, reach)) for first, last in runs]
    return np.array([span for span in spans if span[1] - span[0] >= least // 2], dtype=np.int64).reshape(-1, 2)


def _drop_short_runs(mask: Bools, least: int) -> Bools:
    long_runs = mask.copy()
    for first, last in find_runs(mask):
        if last - first < least:
            long_runs[first:last] = False
    return long_runs


def _find_step(force: Floats, near: int, reach: int) -> int:
    """Return the sample, within ``reach`` of ``near``, at which a step between two levels fits best."""
    low, high = max(near - 2 * reach, 0), min(near + 2 * reach, force.size)
    if near <= low + 1 or near >= high - 1:
        return int(np.clip(near, 0, force.size))
    piece = force[low:high] - force[low:high].mean()
    size = piece.size
    before = np.cumsum(piece)[:-1]
    count = np.arange(1, size)
    gain = before**2 * (1 / count + 1 / (size - count))
    gain[np.abs(count + low - near) > reach] = -1.0
    return int(low + 1 + np.argmax(gain))


def in_air(samples: int, cuts: ArrayLike, *, guard: int = 0) -> Bools:
    """Return the mask of samples that are at least ``guard`` samples away from every cut. (samples,)."""
    air = np.ones(samples, dtype=np.bool_)
    for first, last in np.asarray(cuts, dtype=np.int64).reshape(-1, 2):
        air[max(first - guard, 0) : last + guard] = False
    return air


def remove_drift(record: ForceRecord, air: Bools, *, degree: int | None) -> ForceRecord:
    """Subtract the drift of amplifier and temperature, estimated from the forces in air.

    Parameters
    ----------
    record
        Force record.
    air
        Mask of the samples in air, see `in_air`. (n,)
    degree
        Degree of a polynomial in time through all samples in air; ``None`` for linear interpolation between the means
        of the intervals in air, constant before the first and after the last.

    Raises
    ------
    InputError
        If too few samples are in air.
    """
    air = np.asarray(air, dtype=np.bool_)
    if air.shape != (record.samples,):
        raise InputError(f"air must have the shape ({record.samples},) of the samples, got {air.shape}")
    if degree is None:
        intervals = find_runs(air)
        if not intervals.size:
            raise InputError(
                "at least 1 interval in air is needed, got 0 samples: record air before and after the cuts"
            )
        middle = (intervals.sum(axis=1) - 1) / 2
        means = np.array([record.force[first:last].mean(axis=0) for first, last in intervals])
        every = np.arange(record.samples)
        level = np.column_stack([np.interp(every, middle, column) for column in means.T])
    else:
        degree = whole_number(degree, "the degree of the drift", 0, MAX_DRIFT_DEGREE)
        if np.count_nonzero(air) <= degree + 1:
            raise InputError(
                f"a drift of degree {degree} needs more than {degree + 1} samples in air, got {np.count_nonzero(air)}: "
                "record air before and after the cuts"
            )
        basis = np.polynomial.legendre.legvander(np.linspace(-1, 1, record.samples), degree)
        level = basis @ np.linalg.lstsq(basis[air], record.force[air], rcond=None)[0]
    return replace(record, force=record.force - level)


def find_saturated(values: Floats) -> Ints:
    """Return the indices of saturated values: long runs of exactly the largest or the smallest value. (k,).

    Noise makes neighbours differ, so a run at an extreme that is longer than any other run is the end of the range.
    The value 0 is not taken as an end.
    """
    borders = np.concatenate(([0], np.flatnonzero(np.diff(values)) + 1, [values.size]))
    length, level = np.diff(borders), values[borders[:-1]]
    for end in (values.max(initial=0.0), values.min(initial=0.0)):
        inside = level == end
        if end == 0 or inside.all() or not inside.any():
            continue
        longest = int(length[inside].max())
        if longest < MIN_RUN or longest <= MIN_RUN_RATIO * int(length[~inside].max()):
            continue
        if np.unique(level).size >= MIN_LEVELS:
            return np.flatnonzero(values == end)
    return np.zeros(0, dtype=np.int64)


def find_clipped(load: Floats, values: Floats) -> Ints:
    """Return the indices of averages at the end of the measuring range while the load still increases. (k,).

    They are the largest averages, have the largest loads, and are closer together than noise allows: the probability
    that k of n values lie within w standard deviations is at most n k (w / sqrt(2 pi))^(k - 1). Forces that are
    constant beyond a transition keep their noise and are not taken.
    """
    if values.size < 2 * MIN_RUN:
        return np.zeros(0, dtype=np.int64)
    from scipy.special import gammaln  # noqa: PLC0415 - costly to import

    order = np.argsort(load, kind="stable")
    load, forces = load[order], values[order] * (1.0 if np.median(values) >= 0 else -1.0)
    down = np.lexsort((-np.arange(forces.size), -forces))  # of equal values the last comes first
    first, last = np.minimum.accumulate(down), np.maximum.accumulate(down)
    count, least = 0, np.log(SIGNIFICANCE)
    for k in np.unique(np.geomspace(MIN_RUN, values.size - MIN_RUN, TRIAL_COUNTS).astype(np.int64)):
        span = int(last[k - 1] - first[k - 1]) + 1
        if k < MIN_FILL * span or last[k - 1] < MIN_FILL * values.size:
            continue
        noise = _noise(load, forces, int(first[k - 1]))
        if noise <= NOISELESS_TOL * abs(forces[down[0]]):
            continue
        near = max(forces[down[0]] - forces[down[k - 1]], _step(forces[: first[k - 1]]), NOISELESS_TOL * noise) / noise
        ways = gammaln(span + 1) - gammaln(k + 1) - gammaln(span - k + 1)
        chance = np.log(values.size * k) + ways + (k - 1) * np.log(near / np.sqrt(2 * np.pi))
        if chance < least:
            count, least = int(k), chance
    return np.sort(order[down[:count]])


def _step(values: Floats) -> float:
    """Return the quantisation step if values repeat, else 0."""
    levels = np.unique(values)
    return float(np.diff(levels).min(initial=np.inf)) if levels.size < values.size else 0.0


def _noise(load: Floats, forces: Floats, before: int) -> float:
    """Return the scatter of forces about linear interpolation of their neighbours, before a row."""
    load, forces = load[:before], forces[:before]
    if before < MIN_RUN + 1:
        return 0.0
    span = load[2:] - load[:-2]
    part = np.divide(load[1:-1] - load[:-2], span, out=np.full(span.size, 0.5), where=span > 0)
    off = forces[1:-1] - (1 - part) * forces[:-2] - part * forces[2:]
    off = np.abs(off) / np.sqrt(1 + part**2 + (1 - part) ** 2)
    return robust_scatter(off) or float(np.sqrt((off**2).mean()))


def require_unsaturated(label: str, channel: str, values: Floats, at: Ints, rate_hz: float) -> None:
    """Raise if samples of a channel of a record are saturated."""
    if at.size:
        raise InputError(
            f"{label} is saturated: {at.size} of {values.size} samples of channel {channel!r} are at "
            f"{values[at[0]]:.6g} N, between {at[0] / rate_hz:.4g} and {at[-1] / rate_hz:.4g} s: record with a larger "
            "range, or remove that part"
        )
