r"""What a dynamometer makes of a force, from tap tests, and the force that it was told from its record.

A dynamometer on its springs rings, and each of its channels takes in something of the others. Both are in one matrix
of frequency responses, :math:`m(f) = H(f)\,F(f)`, 3 by 3. Taps with a hammer whose force is measured give it
[BendatPiersol2010]_,

.. math:: H = \Bigl(\sum_i M_i F_i^*\Bigr)\Bigl(\sum_i F_i F_i^*\Bigr)^{-1},

the estimator H₁ of several inputs, for which noise of the dynamometer averages out, together with the coherence: the
share of each channel's power that the taps explain. The force is then found back as

.. math:: \hat F = w(f)\,(H^* H + \lambda^2)^{-1} H^* \, m(f),

which is Wiener's filter where noise over signal is λ everywhere, and Tikhonov's regularisation with the weight λ². The
window w is 1 up to the bandwidth and goes smoothly to 0 beyond, and moves nothing in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Complexes, Floats, frozen
from turnwright._validate import between, check_numbers, positive
from turnwright.cutting.learning.signals import ForceRecord
from turnwright.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Dynamometer", "TapTest"]

AXES = 3

CLOSES = 1.2
"""The window of the filter reaches 0 at this many times the bandwidth."""

KNOWN = 1.4
"""So far the frequency response is used, to be carried over to the frequencies of a record, times the bandwidth."""

COHERENT = 0.8
"""Coherence below which a tap test tells nothing."""

APART = 1e-6
"""Smallest singular value of the gain over the largest, below which channels do not tell forces apart."""

FLAT = 0.25
"""The response below this share of the first resonance is that of a spring, and is fitted as one."""

TOUCH = 0.02
"""Share of its largest force below which a hammer counts as off; twice its time on the part more is kept."""

DECAYED = 0.05
"""Share of its largest value that a channel may still have in the last tenth of a tap record."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TapTest:
    """One tap of a hammer on the dynamometer.

    Parameters
    ----------
    hammer
        Its force. (n,) [N]
    direction
        Where it pushes, in the axes of the dynamometer; only the direction counts. (3,)
    response
        What the three channels of the dynamometer say. (n, 3) [N]
    rate_hz
        Samples per second. [Hz]

    Raises
    ------
    InputError
        If the arrays do not fit, the direction is none, or the record ends before the ringing does.
    """

    hammer: Floats
    direction: Floats
    response: Floats
    rate_hz: float

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "hammer", frozen(self.hammer, "the hammer's force"))
        object.__setattr__(self, "response", frozen(self.response, "the response to a tap", ndim=2))
        object.__setattr__(self, "rate_hz", positive(self.rate_hz, "rate_hz of a tap test", "Hz"))
        direction = frozen(self.direction, "the direction of a tap")
        length = float(np.linalg.norm(direction))
        if direction.shape != (AXES,) or not length > 0:
            raise InputError(f"the direction of a tap is {direction.tolist()}: give 3 numbers that are not all 0")
        object.__setattr__(self, "direction", frozen(direction / length, "the direction of a tap"))
        n = self.hammer.size
        if self.response.shape != (n, AXES) or n < 64:
            raise InputError(
                f"a tap test has {n} samples of the hammer and a response of shape {self.response.shape}: give at "
                "least 64 samples, and 3 columns for the dynamometer"
            )
        largest = float(np.abs(self.response - np.median(self.response, axis=0)).max())
        tail = float(np.abs(np.diff(self.response[-n // 10 :], axis=0)).max()) / 2
        if not largest > 0 or tail > max(DECAYED * largest, 0):
            raise InputError(
                f"a tap still rings with {tail:.3g} N at the end of its record, the limit is {DECAYED:.0%} of its "
                f"largest {largest:.3g} N: record for longer"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dynamometer:
    """The frequency responses of a dynamometer with three axes.

    Parameters
    ----------
    frequency_hz
        Even steps from 0. (m,) [Hz]
    response
        Channel (row) over force (column). (m, 3, 3)
    coherence
        Share of the power of each channel that is explained; ``None`` where the responses were stated, not measured.
        (m, 3)
    static_gain
        What the channels say of a steady force. (3, 3)
    gain_uncertainty
        Standard uncertainty of each entry of it. (3, 3)

    Raises
    ------
    InputError
        If the arrays do not fit, the steps are not even, or the channels do not tell three forces apart.
    """

    frequency_hz: Floats
    response: Complexes
    static_gain: Floats
    gain_uncertainty: Floats
    coherence: Floats | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        frequency = frozen(self.frequency_hz, "frequency_hz")
        object.__setattr__(self, "frequency_hz", frequency)
        response = np.ascontiguousarray(self.response, dtype=np.complex128)
        if frequency.size < 32 or response.shape != (frequency.size, AXES, AXES) or not np.isfinite(response).all():
            raise InputError(
                f"a dynamometer has {frequency.size} frequencies and responses of shape {response.shape}: give at "
                "least 32, and 3 by 3 finite numbers for each"
            )
        step = frequency[1]
        if frequency[0] != 0 or not np.allclose(np.diff(frequency), step, rtol=1e-6):
            raise InputError("the frequencies of a dynamometer do not go up in even steps from 0 Hz: give even steps")
        response.flags.writeable = False
        object.__setattr__(self, "response", response)
        for name in ("static_gain", "gain_uncertainty"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, ndim=2))
            if getattr(self, name).shape != (AXES, AXES):
                raise InputError(f"{name} has the shape {getattr(self, name).shape}: give 3 by 3 numbers")
        said = np.linalg.svd(self.static_gain, compute_uv=False)
        if not said[-1] > APART * said[0]:
            raise InputError(
                f"the static_gain of a dynamometer has singular values from {said[-1]:.3g} to {said[0]:.3g}, the limit "
                f"is {APART:g} of the largest: its channels do not tell 3 forces apart, so give those of three axes"
            )

    @classmethod
    def from_taps(cls, taps: Sequence[TapTest], *, flat_hz: float | None = None) -> Dynamometer:
        r"""Estimate the responses from taps in at least three directions.

        Below ``flat_hz`` a dynamometer is a spring and each response a smooth curve, so the estimates of all
        frequencies there are put on one,
        :math:`\mathrm{Re}\,H = s + a f^2 + b f^4`, :math:`\mathrm{Im}\,H = c f + d f^3`,
        which makes the gain s for steady forces much surer than a single frequency could. Its uncertainty is that of
        the jackknife over the taps, widened by Student's t where they are few.

        Parameters
        ----------
        taps
            All of one rate and length.
        flat_hz
            Where the spring ends; a quarter of the frequency of the largest response if not given. [Hz]

        Raises
        ------
        InputError
            If the taps do not fit together, or do not push in three directions.

        Sources
        -------
        [BendatPiersol2010]_ chapter 7. Oracle: the closed form of a damped spring with cross-talk.
        """
        if len(taps) < 2 * AXES:
            raise InputError(f"{len(taps)} taps were given, at least 6 are needed: tap twice or more along each axis")
        first = taps[0]
        if any(one.rate_hz != first.rate_hz or one.hammer.size != first.hammer.size for one in taps):
            raise InputError("the taps differ in rate or length: cut them all to one length, of one rate")
        directions = np.array([one.direction for one in taps])
        if any(np.linalg.svd(np.delete(directions, i, axis=0), compute_uv=False)[-1] < 0.1 for i in range(len(taps))):
            raise InputError(
                "the taps do not push in 3 directions that are clearly apart, each twice: tap twice or more along "
                "each axis"
            )
        # What is there before the tap is the level of the amplifiers.
        quiet = max(1, min(int(np.argmax(one.hammer)) for one in taps) // 2)
        force = np.array([np.fft.rfft(_stroke(one.hammer - one.hammer[:quiet].mean())) for one in taps])
        said = np.array([np.fft.rfft(one.response - one.response[:quiet].mean(axis=0), axis=0) for one in taps])
        pushed = force[:, :, None] * directions[:, None, :]  # (taps, m, 3)
        across = np.einsum("tmi,tmj->tmij", said, pushed.conj())
        power = np.einsum("tmi,tmj->tmij", pushed, pushed.conj())
        response = _ratio(across.sum(axis=0), power.sum(axis=0))
        explained = np.einsum("mij,mij->mi", response, across.sum(axis=0).conj()).real
        whole = (np.abs(said) ** 2).sum(axis=0)
        coherence = np.clip(explained / np.maximum(whole, np.finfo(np.float64).tiny), 0, 1)
        frequency = _even(force.shape[1], first.rate_hz / first.hammer.size)
        low = _spring(frequency, response, coherence, flat_hz)
        smooth = response.copy()
        smooth[low], gain = _straightened(frequency[low], response[low])
        # Each tap left out in turn says what taps differ by, whatever the reason.
        without = np.array(
            [
                _straightened(
                    frequency[low],
                    _ratio((across.sum(axis=0) - across[i])[low], (power.sum(axis=0) - power[i])[low]),
                )[1]
                for i in range(len(taps))
            ]
        )
        spread = np.sqrt((len(taps) - 1) * without.var(axis=0))
        from scipy.stats import norm, t  # noqa: PLC0415 - costly to import

        few = float(t.ppf(0.975, max(len(taps) // AXES - 1, 1)) / norm.ppf(0.975))
        return cls(
            frequency_hz=frequency,
            response=smooth,
            coherence=frozen(coherence, "coherence", ndim=2),
            static_gain=gain,
            gain_uncertainty=few * spread,
        )

    def forces(self, record: ForceRecord, *, bandwidth_hz: float, noise_to_signal: float) -> ForceRecord:
        """Find the forces back that a record was made of.

        Parameters
        ----------
        record
            What the three channels said, in the order of the taps' columns.
        bandwidth_hz
            Up to there forces are found back; 1.4 times this must be heard in the taps. [Hz]
        noise_to_signal
            λ: amplitude of the noise of a channel over that of the force, as a share of the steady gain. It takes
            λ² of what is found back where the response is 1, and more where it is weak; see `resolution`.

        Returns
        -------
        ForceRecord
            Along the axes of the dynamometer, under the same names.

        Raises
        ------
        InputError
            If the record has not three channels, or the bandwidth is beyond what the taps tell.
        """
        if len(record.channels) != AXES:
            raise InputError(f"the record has {len(record.channels)} channels, a dynamometer has 3: give its three")
        self._require(bandwidth_hz, record.rate_hz / 2)
        # Long enough for what the filter remembers at both ends.
        tail = min(record.samples - 1, int(np.ceil(8 * record.rate_hz / ((CLOSES - 1) * bandwidth_hz))))
        said = np.pad(record.force, ((tail, tail), (0, 0)), mode="reflect", reflect_type="odd")
        from scipy.fft import irfft, next_fast_len, rfft  # noqa: PLC0415 - costly to import

        size = next_fast_len(said.shape[0], real=True)
        # A straight line between the ends, so that the record closes on itself.
        line = said[0] + np.linspace(0, 1, said.shape[0])[:, None] * (said[-1] - said[0])
        frequency = _even(size // 2 + 1, record.rate_hz / size)
        kept = frequency <= CLOSES * bandwidth_hz
        inverse = self._inverse(self._carried(frequency[kept], bandwidth_hz), noise_to_signal)
        inverse *= _window(frequency[kept], bandwidth_hz, CLOSES * bandwidth_hz)[:, None, None]
        found = np.zeros((frequency.size, AXES), dtype=np.complex128)
        found[kept] = (inverse @ rfft(said - line, size, axis=0)[kept][:, :, None])[:, :, 0]
        steady = line @ self._inverse(self.static_gain[None].astype(np.complex128), noise_to_signal)[0].real.T
        force = irfft(found, size, axis=0)[: said.shape[0]] + steady
        return replace(record, force=force[tail : tail + record.samples])

    def resolution(self, frequency_hz: ArrayLike, *, bandwidth_hz: float, noise_to_signal: float) -> Complexes:
        """Return what becomes of a force of some frequencies on its way through dynamometer and `forces`.

        The identity where all is found back; what is off its diagonal is cross-talk that is left.

        Parameters
        ----------
        frequency_hz
            At most 1.2 times the bandwidth. (k,) [Hz]
        bandwidth_hz, noise_to_signal
            As in `forces`.

        Returns
        -------
        Complexes
            Force found (row) over force that was (column). (k, 3, 3)
        """
        at = frozen(frequency_hz, "frequency_hz")
        self._require(bandwidth_hz, np.inf)
        if at.size and not 0 <= at.min() <= at.max() <= CLOSES * bandwidth_hz:
            raise InputError(
                f"frequency_hz reaches {at.max():g} Hz, the limits are 0 and {CLOSES * bandwidth_hz:g} Hz, where the "
                "filter has closed: ask below"
            )
        response = self._carried(at, bandwidth_hz)
        window = _window(at, bandwidth_hz, CLOSES * bandwidth_hz)
        return np.asarray(window[:, None, None] * (self._inverse(response, noise_to_signal) @ response))

    def relative_uncertainty(self, force: ArrayLike) -> Floats:
        """Return how uncertain the gain makes each component of a steady force, as a share of it; inf for 0 N. (3,).

        Parameters
        ----------
        force
            The force. (3,) [N]
        """
        steady = frozen(force, "force")
        spread = np.linalg.inv(self.static_gain)
        variance = (spread**2) @ (self.gain_uncertainty**2) @ steady**2
        size = np.abs(steady)
        return np.asarray(np.divide(np.sqrt(variance), size, out=np.full(AXES, np.inf), where=size > 0))

    def _require(self, bandwidth_hz: float, half: float) -> None:
        positive(bandwidth_hz, "bandwidth_hz", "Hz")
        known = float(self.frequency_hz[-1])
        if self.coherence is not None:
            # A channel hardly hears a tap across it; the best of the three says whether the hammer was heard.
            heard = self.coherence.max(axis=1) > COHERENT
            smooth = np.convolve(heard, np.ones(9) / 9, mode="same") > 0.5
            smooth[:5] = True
            known = float(self.frequency_hz[int(np.argmin(smooth)) - 1 if not smooth.all() else -1])
        most = min(known / KNOWN, half / CLOSES)
        if bandwidth_hz > most:
            raise InputError(
                f"bandwidth_hz is {bandwidth_hz:.4g} Hz, the limit is {most:.4g} Hz by what the taps excite (coherence "
                f"above {COHERENT}) and the rate of the record: lower it, or tap with a harder tip"
            )

    def _carried(self, frequency: Floats, bandwidth_hz: float) -> Complexes:
        """Return the responses at other frequencies: those of the same answers in time, followed for longer.

        What has died away within a tap record is known at every frequency, not only at the multiples of one over its
        length; a straight line between those would cut the peak of a resonance.
        """
        window = _window(self.frequency_hz, CLOSES * bandwidth_hz, KNOWN * bandwidth_hz)
        top = int(np.argmax(window <= 0)) or window.size
        step = float(self.frequency_hz[1])
        size = 2 * (self.frequency_hz.size - 1)
        answer = np.fft.irfft(self.response * window[:, None, None], size, axis=0)
        # The window's own answer reaches a little before the tap; the last eighth of the record is that.
        early = size // 8
        answer = np.concatenate([answer[-early:], answer[:-early]])
        # Padded sixteenfold, the answers are so smooth over frequency that cubics between lose nothing.
        from scipy.fft import rfft  # noqa: PLC0415 - costly to import
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

        fine = 16
        dense = rfft(answer, fine * size, axis=0)[: fine * top + 1]
        at = np.arange(dense.shape[0]) * (step / fine)
        dense *= np.exp(2j * np.pi * at * early / (size * step))[:, None, None]
        return np.asarray(CubicSpline(at, dense, axis=0)(np.minimum(frequency, at[-1])))

    def _inverse(self, response: Complexes, noise_to_signal: float) -> Complexes:
        between(noise_to_signal, "noise_to_signal", 0.0, 1.0, "")
        weight = noise_to_signal * float(np.abs(np.diag(self.static_gain)).max())
        turned = response.conj().transpose(0, 2, 1)
        try:
            return np.asarray(np.linalg.solve(turned @ response + weight**2 * np.eye(AXES), turned))
        except np.linalg.LinAlgError as error:
            raise InputError(
                f"at some frequency the channels do not tell 3 forces apart and noise_to_signal is "
                f"{noise_to_signal:g}: state one above 0, or lower the bandwidth"
            ) from error


def _even(count: int, step: float) -> Floats:
    """Return even steps from 0. (count,)."""
    return np.asarray(step * np.arange(count), dtype=np.float64)


def _stroke(hammer: Floats) -> Floats:
    """Return the hammer's force with 0 where it does not touch, so that its noise there says nothing."""
    peak = int(np.argmax(hammer))
    off = hammer < TOUCH * hammer[peak]
    before = np.flatnonzero(off[:peak])
    after = np.flatnonzero(off[peak:])
    first = int(before[-1]) if before.size else 0
    last = peak + int(after[0]) if after.size else hammer.size
    width = last - first
    stroke = np.zeros_like(hammer)
    kept = slice(max(first - width, 0), last + width)
    stroke[kept] = hammer[kept]
    return stroke


def _ratio(across: Complexes, power: Complexes) -> Complexes:
    """Return the estimate of the responses from the spectra between channels and forces. (m, 3, 3)."""
    scale = np.trace(power, axis1=1, axis2=2).real
    # Where no hammer pushes there is nothing to divide by; the coherence says that nothing is known there.
    floor = 1e-12 * np.maximum(scale, 1e-12 * scale.max())
    return np.asarray(across @ np.linalg.inv(power + floor[:, None, None] * np.eye(AXES)))


def _spring(frequency: Floats, response: Complexes, coherence: Floats, flat_hz: float | None) -> Bools:
    """Return which frequencies are so low that the dynamometer is a spring, 0 with them."""
    if flat_hz is None:
        heard = (coherence > COHERENT).any(axis=1)
        strength = np.where(heard, np.abs(response).max(axis=(1, 2)), 0.0)
        flat_hz = FLAT * float(frequency[int(np.argmax(strength))])
    low = frequency <= flat_hz
    if np.count_nonzero(low) < 9:
        raise InputError(
            f"{np.count_nonzero(low)} frequencies lie up to {flat_hz:g} Hz, where the dynamometer is a spring, at "
            "least 9 are needed: record each tap for longer, or give flat_hz"
        )
    return low


def _straightened(frequency: Floats, response: Complexes) -> tuple[Complexes, Floats]:
    """Return the responses of a spring fitted to those of low frequencies, and its gain for steady forces."""
    at = frequency / frequency[-1]
    even, odd = np.vander(at**2, 3, increasing=True), at[:, None] * np.vander(at**2, 2, increasing=True)
    flat = response.reshape(-1, AXES * AXES)
    # At 0 the level of the amplifiers was taken out, so nothing is known.
    of_even = np.linalg.lstsq(even[1:], flat.real[1:], rcond=None)[0]
    of_odd = np.linalg.lstsq(odd[1:], flat.imag[1:], rcond=None)[0]
    smooth = (even @ of_even + 1j * (odd @ of_odd)).reshape(-1, AXES, AXES)
    return smooth, of_even[0].reshape(AXES, AXES)


def _window(frequency: Floats, opens: float, closes: float) -> Floats:
    """Return 1 up to one frequency, 0 from another on, and the fall of a cosine between."""
    share = np.clip((frequency - opens) / (closes - opens), 0, 1)
    return np.asarray(0.5 * (1 + np.cos(np.pi * share)))
