r"""Forces over time, and what makes numbers of them: drift, filters, engagement, averages that know their uncertainty.

Neighbouring samples of a force hang together, so that n of them say less than n independent ones would. Wherever an
uncertainty is stated here, they count as n/τ, with the integrated correlation time

.. math:: \tau = 1 + 2 \sum_{k=1}^{M} \rho_k

of their own autocorrelation ρ, summed up to the first M of at least 5 τ [Sokal1997]_.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen, robust_scatter
from turnwright._validate import between, check_numbers, positive
from turnwright.cutting.learning.saturation import require_unsaturated, saturated
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
    "in_air",
    "low_pass",
    "remove_drift",
]

WINDOW = 5.0
"""Correlation is summed over this many correlation times."""

HIGHEST_ORDER = 10
"""Order of a low-pass beyond which it rings more than it helps."""

HIGHEST_DRIFT = 6
"""Degree of a drift beyond which it follows the cuts."""

CLEAR = 5.0
"""A force this many times the noise above the level in air is one of cutting."""

ROUGHEST = 2.0
"""Times the noise that what is taken for air may depart from a smooth level; beyond, it is a cut or another drift."""

BELOW = 1e-3
"""Weight of samples above the level in air, against 1 below it, where the level is first looked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceRecord:
    """Forces that were sampled at even steps of time.

    Parameters
    ----------
    force
        A column for each channel. (n, channels) [N]
    rate_hz
        Samples per second. [Hz]
    channels
        What each column is called.
    name
        What was recorded.

    Raises
    ------
    InputError
        If the columns have not as many names, names repeat, a value is not finite, or a channel is saturated.

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
                f"{label} has {self.force.shape[1]} columns and the channels {', '.join(self.channels) or 'none'}: "
                "give each column a name of its own"
            )
        if self.force.shape[0] < 2:
            raise InputError(f"{label} has {self.force.shape[0]} samples, it needs at least 2: record for longer")
        for name, column in zip(self.channels, self.force.T, strict=True):
            require_unsaturated(label, name, column, saturated(column), self.rate_hz)

    @property
    def samples(self) -> int:
        """Samples of each channel."""
        return int(self.force.shape[0])

    @property
    def time(self) -> Floats:
        """Time since the first sample. (n,) [s]."""
        return np.arange(self.samples) / self.rate_hz

    def channel(self, name: str) -> Floats:
        """Return one column, or its negative where a minus stands before its name. (n,) [N]."""
        sign, plain = (-1.0, name[1:]) if name.startswith("-") and name not in self.channels else (1.0, name)
        if plain not in self.channels:
            raise InputError(
                f"the force record {self.name!r} has no channel {plain!r}, it has {', '.join(self.channels)}: name "
                "one of these, with a minus before it to turn it round"
            )
        return sign * self.force[:, self.channels.index(plain)]


def low_pass(record: ForceRecord, cutoff_hz: float, order: int) -> ForceRecord:
    r"""Take fast changes out of a record without moving slow ones in time.

    A Butterworth filter of the stated order runs forth and back, so that phases cancel and gains multiply:

    .. math:: |G(f)| = \frac{1}{1 + (\tan(\pi f/f_s) / \tan(\pi f_c/f_s))^{2n}}

    at the cut-off that is one half, -6 dB.

    Parameters
    ----------
    record
        The forces.
    cutoff_hz
        Frequency of the gain 1/2. [Hz]
    order
        Of the one-way filter, 1 to 10.

    Raises
    ------
    InputError
        If the cut-off is not below half the rate, the order is none, or the record is too short.

    Sources
    -------
    Oracle: the gain of the bilinear Butterworth filter in closed form.
    """
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415 - costly to import

    half = record.rate_hz / 2
    if not 0 < cutoff_hz < half:
        raise InputError(f"cutoff_hz is {cutoff_hz:g} Hz, the limits are 0 and {half:g} Hz, half the rate: lower it")
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= HIGHEST_ORDER:
        raise InputError(f"the order of a low-pass is {order!r}, the limits are 1 to {HIGHEST_ORDER}: give a number")
    # The ends are continued by a turned copy of as many samples as the filter remembers.
    pad = min(record.samples - 1, int(np.ceil(4 * order * record.rate_hz / cutoff_hz)))
    sections = butter(order, cutoff_hz, fs=record.rate_hz, output="sos")
    return replace(record, force=sosfiltfilt(sections, record.force, axis=0, padlen=pad))


def correlation_time(values: ArrayLike) -> float:
    r"""Return the integrated correlation time of evenly sampled values: so many of them say as much as one.

    Parameters
    ----------
    values
        Samples; their mean is taken out. (n,) [any unit]

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
    [Sokal1997]_ section 3; [Wolff2004]_ for what the mean takes. Oracle: (1 + a)/(1 - a) of a first-order
    autoregression.
    """
    series = frozen(values, "values")
    n = series.size
    if n < 2:
        raise InputError(f"{n} values have no correlation, the least is 2: give more")
    centred = series - series.mean()
    padded = 1 << (2 * n - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, padded)) ** 2
    auto = np.fft.irfft(spectrum, padded)[:n]
    if not auto[0] > 0:
        return 1.0
    tau = 2 * np.cumsum(auto / auto[0]) - 1
    enough = np.flatnonzero(np.arange(n) >= WINDOW * tau)
    window = int(enough[0]) if enough.size else int(np.argmax(tau))
    # The mean that was taken out holds a share of what hangs together.
    return float(max(1.0, tau[window] * (1 + (2 * window + 1) / n)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceAverage:
    """Mean force over a stretch of a record.

    Parameters
    ----------
    mean
        Of each channel. (channels,) [N]
    uncertainty
        Standard uncertainty of each mean, from samples that hang together. (channels,) [N]
    samples
        How many were averaged.
    independent
        How many independent ones say as much. (channels,)
    """

    mean: Floats
    uncertainty: Floats
    samples: int
    independent: Floats


def average_force(record: ForceRecord, start: int, stop: int) -> ForceAverage:
    """Average the samples from ``start`` up to, but without, ``stop``.

    Raises
    ------
    InputError
        If that is not a stretch of the record of at least 8 samples.
    """
    if not 0 <= start < stop <= record.samples or stop - start < 8:
        raise InputError(
            f"samples {start} to {stop} are not a stretch of at least 8 out of {record.samples}: take a longer one"
        )
    piece = record.force[start:stop]
    tau = np.array([correlation_time(column) for column in piece.T])
    independent = np.maximum((stop - start) / tau, 1.0)
    spread = piece.std(axis=0)
    # The variance about a mean of m independent values is too small by (m-1)/m.
    uncertainty = spread / np.sqrt(np.maximum(independent - 1, 0.5))
    return ForceAverage(
        mean=frozen(piece.mean(axis=0), "mean"),
        uncertainty=frozen(uncertainty, "uncertainty"),
        samples=stop - start,
        independent=frozen(independent, "independent"),
    )


def _runs(mask: Bools) -> Ints:
    """Return the stretches of true values. (m, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return edges.reshape(-1, 2).astype(np.int64)


def _envelope(values: Floats, basis: Floats) -> Floats:
    """Return the smooth level that lies below nearly all values: least squares that hardly minds what is above."""
    level = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    for _ in range(60):
        weight = np.sqrt(np.where(values > level, BELOW, 1.0))
        after = basis @ np.linalg.lstsq(basis * weight[:, None], values * weight, rcond=None)[0]
        if np.allclose(after, level, rtol=0, atol=1e-9 * np.ptp(values)):
            return after
        level = after
    return level


def engagements(record: ForceRecord, channel: str, *, shortest: float, drift: int = 1, lead: float = 0.0) -> Ints:
    """Find where the tool cuts.

    The level in air is a polynomial in time below the force; what stands clear of it by five times the noise is
    cutting. Each entry and exit is then put where two levels on either side fit best, to the sample.

    Parameters
    ----------
    record
        The forces; the tool must be in air for a part of the time.
    channel
        The one that tells cutting from air best, usually the cutting force; it must be positive in the cut ("-Fy" for
        the negative of "Fy").
    shortest
        What is shorter, in the cut or in air, is taken for noise. [s]
    drift
        Degree of the polynomial.
    lead
        For so long the tool is in air for sure, at the beginning and at the end of the record: a slow ramp then cannot
        be taken for drift. Without it the level in air is the smooth curve below nearly all of the force, which needs
        air here and there. [s]

    Returns
    -------
    Ints
        First sample in the cut and first one after it, in order. (m, 2)

    Raises
    ------
    InputError
        If nothing stands clear, or the tool is never in air.
    """
    force = record.channel(channel)
    least = round(positive(shortest, "shortest", "s") * record.rate_hz)
    block = max(1, least // 8)
    count = record.samples // block
    if least < 8 or count < 32:
        raise InputError(
            f"shortest is {shortest:g} s, that is {least} of {record.samples} samples, the limits are 8 and "
            f"{record.samples // 4}: choose it between, or record faster or longer"
        )
    means = force[: count * block].reshape(count, block).mean(axis=1)
    basis = np.asarray(np.polynomial.legendre.legvander(np.linspace(-1, 1, count), _degree(drift)), dtype=np.float64)
    # Differences of neighbours tell the noise whatever the level.
    noise = robust_scatter(np.diff(means)) / np.sqrt(2)
    noise = max(noise, 1e-9 * float(np.ptp(means)), 1e-12 * float(np.abs(means).max()), np.finfo(np.float64).tiny)
    sure = round(between(lead, "lead", 0.0, record.samples / record.rate_hz / 2, "s") * record.rate_hz) // block
    if sure:
        air = (np.arange(count) < sure) | (np.arange(count) >= count - sure)
    else:
        air = means < _envelope(means, basis) + 2 * CLEAR * noise
    level = means  # where too little air is known to tell the drift
    for _ in range(50):
        if np.count_nonzero(air) < max(8, basis.shape[1] + 2):
            break
        level = basis @ np.linalg.lstsq(basis[air], means[air], rcond=None)[0]
        after = np.abs(means - level) < CLEAR * noise if sure else means < level + CLEAR * noise
        if (after == air).all():
            break
        air = after
    rough = float((means - level)[air].std()) / noise if air.any() else 0.0
    if not sure and rough > ROUGHEST:
        raise InputError(
            f"what was taken for air in channel {channel} of the force record {record.name!r} departs from a drift of "
            f"degree {drift} by {rough:.3g} times the noise, the limit is {ROUGHEST:g}: give lead, for how long the "
            "tool is in air at both ends, another degree of the drift, or the other sign of the channel"
        )
    shape = max(1, least // block)
    # Gaps are closed first: a weak cut falls below the limit here and there.
    cut = _without_short(~_without_short(air, shape), shape)
    found = _runs(cut)
    if not found.size or np.count_nonzero(~cut) < 8:
        state = "is always in air" if not found.size else "is never in air"
        raise InputError(
            f"by channel {channel} of the force record {record.name!r} the tool {state}: record air before and after "
            "the cut, check the sign of the channel, or choose another value of shortest"
        )
    sharp = [(_edge(force, first * block, 4 * block), _edge(force, last * block, 4 * block)) for first, last in found]
    return np.array([pair for pair in sharp if pair[1] - pair[0] >= least // 2], dtype=np.int64).reshape(-1, 2)


def _degree(drift: int) -> int:
    if isinstance(drift, bool) or not isinstance(drift, int) or not 0 <= drift <= HIGHEST_DRIFT:
        raise InputError(f"the degree of the drift is {drift!r}, the limits are 0 to {HIGHEST_DRIFT}: give a number")
    return drift


def _without_short(mask: Bools, least: int) -> Bools:
    kept = mask.copy()
    for first, last in _runs(mask):
        if last - first < least:
            kept[first:last] = False
    return kept


def _edge(force: Floats, near: int, reach: int) -> int:
    """Return the sample within reach at which a step splits its surroundings into two levels best."""
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
    """Return which samples lie in none of the cuts, nor within ``guard`` samples of one. (samples,)."""
    air = np.ones(samples, dtype=np.bool_)
    for first, last in np.asarray(cuts, dtype=np.int64).reshape(-1, 2):
        air[max(first - guard, 0) : last + guard] = False
    return air


def remove_drift(record: ForceRecord, air: Bools, *, degree: int | None) -> ForceRecord:
    """Take out what the forces do in air: the drift of amplifier and temperature.

    Parameters
    ----------
    record
        The forces.
    air
        Which samples are in air, see `in_air`. (n,)
    degree
        Of one polynomial in time through all samples in air; ``None`` for straight lines between the means of the
        stretches in air, held before the first and after the last.

    Raises
    ------
    InputError
        If too few samples are in air to tell the drift.
    """
    air = np.asarray(air, dtype=np.bool_)
    if air.shape != (record.samples,):
        raise InputError(f"air has the shape {air.shape} and the record {record.samples} samples: give one per sample")
    if degree is None:
        stretches = _runs(air)
        if not stretches.size:
            raise InputError("0 samples are in air, at least one stretch is needed: record air beside the cuts")
        middle = (stretches.sum(axis=1) - 1) / 2
        means = np.array([record.force[first:last].mean(axis=0) for first, last in stretches])
        every = np.arange(record.samples)
        level = np.column_stack([np.interp(every, middle, column) for column in means.T])
    else:
        if np.count_nonzero(air) <= _degree(degree) + 1:
            raise InputError(
                f"{np.count_nonzero(air)} samples are in air, a drift of degree {degree} needs more than {degree + 1}: "
                "record air beside the cuts"
            )
        basis = np.polynomial.legendre.legvander(np.linspace(-1, 1, record.samples), degree)
        level = basis @ np.linalg.lstsq(basis[air], record.force[air], rcond=None)[0]
    return replace(record, force=record.force - level)
