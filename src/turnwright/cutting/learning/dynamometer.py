r"""Frequency response of a dynamometer from tap tests, and compensation of force records for it.

The channels are :math:`m = H F`, 3 by 3 at each frequency. Taps give H by the H₁ estimator for several inputs; the
force is reconstructed by a Wiener filter for a noise-to-signal ratio of λ [BendatPiersol2010]_,
:math:`\hat F = w\,(H^* H + \lambda^2)^{-1} H^* m`, with a window w that falls to 0 beyond the bandwidth.
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

STOP_RATIO = 1.2
"""Frequency at which the window of the filter reaches 0, over the bandwidth."""

RESPONSE_RATIO = 1.4
"""Highest frequency of the response that is used for interpolation, over the bandwidth."""

MIN_COHERENCE = 0.8
"""Coherence above which a tap test is used."""

MIN_SINGULAR_RATIO = 1e-6
"""Smallest over largest singular value of the static gain, below which it cannot be inverted."""

SPRING_RATIO = 0.25
"""Frequency up to which the response is that of a spring, over that of the largest response."""

CONTACT_RATIO = 0.02
"""Hammer force below which it is not in contact, over its maximum."""

MAX_TAIL_RATIO = 0.05
"""Largest response in the last tenth of a tap record, over its maximum."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TapTest:
    """Tap of an instrumented hammer on the dynamometer.

    Parameters
    ----------
    hammer
        Hammer force. (n,) [N]
    direction
        Direction of the hammer force in the axes of the dynamometer; it is normalised. (3,)
    response
        Signals of the three channels of the dynamometer. (n, 3) [N]
    rate_hz
        Sampling rate. [Hz]

    Raises
    ------
    InputError
        If the shapes do not match, the direction is zero, or the record ends before the response has decayed.
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
            raise InputError(f"the direction of a tap must be 3 numbers that are not all 0, got {direction.tolist()}")
        object.__setattr__(self, "direction", frozen(direction / length, "the direction of a tap"))
        n = self.hammer.size
        if self.response.shape != (n, AXES) or n < 64:
            raise InputError(
                "a tap test must have at least 64 samples and 3 columns of response, got "
                f"{n} samples of the hammer and a response of shape {self.response.shape}"
            )
        largest = float(np.abs(self.response - np.median(self.response, axis=0)).max())
        tail = float(np.abs(np.diff(self.response[-n // 10 :], axis=0)).max()) / 2
        if not largest > 0 or tail > max(MAX_TAIL_RATIO * largest, 0):
            raise InputError(
                f"the response at the end of a tap record must be at most {MAX_TAIL_RATIO:.0%} of its maximum "
                f"{largest:.3g} N, got {tail:.3g} N: record for longer"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dynamometer:
    """Frequency response of a three-axis dynamometer.

    Parameters
    ----------
    frequency_hz
        Evenly spaced frequencies from 0. (m,) [Hz]
    response
        Channel (row) over force (column). (m, 3, 3) [1]
    coherence
        Coherence of each channel; ``None`` if the responses are stated and not measured. (m, 3) [1]
    static_gain
        Channel (row) over steady force (column). (3, 3) [1]
    gain_uncertainty
        Standard uncertainties of ``static_gain``. (3, 3) [1]

    Raises
    ------
    InputError
        If the shapes do not match, the frequencies are not evenly spaced, or the static gain is singular.
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
                "a dynamometer must have at least 32 frequencies, with 3 by 3 finite responses each, got "
                f"{frequency.size} frequencies and responses of shape {response.shape}"
            )
        step = frequency[1]
        if frequency[0] != 0 or not np.allclose(np.diff(frequency), step, rtol=1e-6):
            raise InputError("frequency_hz of a dynamometer must be evenly spaced from 0 Hz")
        response.flags.writeable = False
        object.__setattr__(self, "response", response)
        for name in ("static_gain", "gain_uncertainty"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, ndim=2))
            if getattr(self, name).shape != (AXES, AXES):
                raise InputError(f"{name} must have the shape (3, 3), got {getattr(self, name).shape}")
        singular = np.linalg.svd(self.static_gain, compute_uv=False)
        if not singular[-1] > MIN_SINGULAR_RATIO * singular[0]:
            raise InputError(
                f"the singular values of static_gain must be above {MIN_SINGULAR_RATIO:g} of the largest, got "
                f"{singular[-1]:.3g} to {singular[0]:.3g}: its channels do not determine 3 forces"
            )

    @classmethod
    def from_taps(cls, taps: Sequence[TapTest], *, flat_hz: float | None = None) -> Dynamometer:
        r"""Estimate the frequency response from taps in at least three directions.

        Below ``flat_hz`` the dynamometer acts as a spring, and each response is fitted by a smooth curve,
        :math:`\mathrm{Re}\,H = s + a f^2 + b f^4`, :math:`\mathrm{Im}\,H = c f + d f^3`.
        The static gain s is thereby estimated from all low frequencies. Its uncertainty is that of the jackknife over
        the taps, widened by Student's t for few taps.

        Parameters
        ----------
        taps
            Tap tests of equal sampling rate and length.
        flat_hz
            Upper frequency of the spring model; by default a quarter of the frequency of the largest response. [Hz]

        Raises
        ------
        InputError
            If there are fewer than 6 taps, they differ in rate or length, or do not cover three directions.

        Sources
        -------
        [BendatPiersol2010]_ chapter 7. Oracle: the closed form of a damped spring with cross-talk.
        """
        if len(taps) < 2 * AXES:
            raise InputError(f"at least 6 taps are needed, two along each axis, got {len(taps)}")
        first = taps[0]
        if any(one.rate_hz != first.rate_hz or one.hammer.size != first.hammer.size for one in taps):
            raise InputError("the taps must have the same sampling rate and length: cut them to equal lengths")
        directions = np.array([one.direction for one in taps])
        if any(np.linalg.svd(np.delete(directions, i, axis=0), compute_uv=False)[-1] < 0.1 for i in range(len(taps))):
            raise InputError(
                "the taps must cover 3 independent directions at least twice: tap twice or more along each axis"
            )
        # The level before the tap is the offset of the amplifiers.
        quiet = max(1, min(int(np.argmax(one.hammer)) for one in taps) // 2)
        force = np.array([np.fft.rfft(_isolate_stroke(one.hammer - one.hammer[:quiet].mean())) for one in taps])
        signal = np.array([np.fft.rfft(one.response - one.response[:quiet].mean(axis=0), axis=0) for one in taps])
        pushed = force[:, :, None] * directions[:, None, :]  # (taps, m, 3)
        across = np.einsum("tmi,tmj->tmij", signal, pushed.conj())
        power = np.einsum("tmi,tmj->tmij", pushed, pushed.conj())
        response = _ratio(across.sum(axis=0), power.sum(axis=0))
        explained = np.einsum("mij,mij->mi", response, across.sum(axis=0).conj()).real
        total = (np.abs(signal) ** 2).sum(axis=0)
        coherence = np.clip(explained / np.maximum(total, np.finfo(np.float64).tiny), 0, 1)
        frequency = np.asarray(first.rate_hz / first.hammer.size * np.arange(force.shape[1]), dtype=np.float64)
        low = _spring(frequency, response, coherence, flat_hz)
        smooth = response.copy()
        smooth[low], gain = _fit_spring(frequency[low], response[low])
        # Jackknife: the gain without each tap in turn.
        without_tap = np.array(
            [
                _fit_spring(
                    frequency[low],
                    _ratio((across.sum(axis=0) - across[i])[low], (power.sum(axis=0) - power[i])[low]),
                )[1]
                for i in range(len(taps))
            ]
        )
        spread = np.sqrt((len(taps) - 1) * without_tap.var(axis=0))
        from scipy.stats import norm, t  # noqa: PLC0415 - costly to import

        widening = float(t.ppf(0.975, max(len(taps) // AXES - 1, 1)) / norm.ppf(0.975))
        return cls(
            frequency_hz=frequency,
            response=smooth,
            coherence=frozen(coherence, "coherence", ndim=2),
            static_gain=gain,
            gain_uncertainty=widening * spread,
        )

    def forces(self, record: ForceRecord, *, bandwidth_hz: float, noise_to_signal: float) -> ForceRecord:
        """Reconstruct the forces from a record of the three channels.

        Parameters
        ----------
        record
            Signals of the three channels, in the order of the columns of the taps.
        bandwidth_hz
            Bandwidth of the reconstructed forces; the taps must excite 1.4 times this. [Hz]
        noise_to_signal
            λ, noise amplitude of a channel over force amplitude, relative to the static gain. It reduces the forces by
            λ² where the response is 1, and by more where it is weaker; see `resolution`. [1]

        Returns
        -------
        ForceRecord
            Forces along the axes of the dynamometer, under the same channel names.

        Raises
        ------
        InputError
            If the record does not have three channels, or the bandwidth exceeds that of the taps.
        """
        if len(record.channels) != AXES:
            raise InputError(f"the record of a dynamometer must have 3 channels, got {len(record.channels)}")
        self._require(bandwidth_hz, record.rate_hz / 2)
        # The padding covers the impulse response of the filter at both ends.
        tail = min(record.samples - 1, int(np.ceil(8 * record.rate_hz / ((STOP_RATIO - 1) * bandwidth_hz))))
        signal = np.pad(record.force, ((tail, tail), (0, 0)), mode="reflect", reflect_type="odd")
        from scipy.fft import irfft, next_fast_len, rfft  # noqa: PLC0415 - costly to import

        size = next_fast_len(signal.shape[0], real=True)
        # Subtract the line between the ends, so that the record is periodic.
        line = signal[0] + np.linspace(0, 1, signal.shape[0])[:, None] * (signal[-1] - signal[0])
        frequency = np.asarray(record.rate_hz / size * np.arange(size // 2 + 1), dtype=np.float64)
        passed = frequency <= STOP_RATIO * bandwidth_hz
        inverse = self._inverse(self._interpolate_response(frequency[passed], bandwidth_hz), noise_to_signal)
        inverse *= _window(frequency[passed], bandwidth_hz, STOP_RATIO * bandwidth_hz)[:, None, None]
        spectrum = np.zeros((frequency.size, AXES), dtype=np.complex128)
        spectrum[passed] = (inverse @ rfft(signal - line, size, axis=0)[passed][:, :, None])[:, :, 0]
        steady = line @ self._inverse(self.static_gain[None].astype(np.complex128), noise_to_signal)[0].real.T
        force = irfft(spectrum, size, axis=0)[: signal.shape[0]] + steady
        return replace(record, force=force[tail : tail + record.samples])

    def resolution(self, frequency_hz: ArrayLike, *, bandwidth_hz: float, noise_to_signal: float) -> Complexes:
        """Compute the transfer matrix of dynamometer and `forces` together.

        It is the identity where forces are fully reconstructed; off-diagonal entries are residual cross-talk.

        Parameters
        ----------
        frequency_hz
            Frequencies, at most 1.2 times the bandwidth. (k,) [Hz]
        bandwidth_hz, noise_to_signal
            As for `forces`.

        Returns
        -------
        Complexes
            Reconstructed force (row) over true force (column). (k, 3, 3) [1]
        """
        at = frozen(frequency_hz, "frequency_hz")
        self._require(bandwidth_hz, np.inf)
        if at.size and not 0 <= at.min() <= at.max() <= STOP_RATIO * bandwidth_hz:
            raise InputError(
                f"frequency_hz must be 0 to {STOP_RATIO * bandwidth_hz:g} Hz (the stop frequency of the filter), "
                f"got up to {at.max():g} Hz"
            )
        response = self._interpolate_response(at, bandwidth_hz)
        window = _window(at, bandwidth_hz, STOP_RATIO * bandwidth_hz)
        return np.asarray(window[:, None, None] * (self._inverse(response, noise_to_signal) @ response))

    def relative_uncertainty(self, force: ArrayLike) -> Floats:
        """Compute the relative standard uncertainty of a steady force due to the static gain.

        Parameters
        ----------
        force
            Steady force. (3,) [N]

        Returns
        -------
        Floats
            Relative standard uncertainty of each component; inf for 0 N. (3,) [1]
        """
        steady = frozen(force, "force")
        spread = np.linalg.inv(self.static_gain)
        variance = (spread**2) @ (self.gain_uncertainty**2) @ steady**2
        size = np.abs(steady)
        return np.asarray(np.divide(np.sqrt(variance), size, out=np.full(AXES, np.inf), where=size > 0))

    def _require(self, bandwidth_hz: float, half: float) -> None:
        positive(bandwidth_hz, "bandwidth_hz", "Hz")
        excited = float(self.frequency_hz[-1])
        if self.coherence is not None:
            # A channel has little signal from a transverse tap, so the best of the three channels counts.
            coherent = self.coherence.max(axis=1) > MIN_COHERENCE
            smooth = np.convolve(coherent, np.ones(9) / 9, mode="same") > 0.5
            smooth[:5] = True
            excited = float(self.frequency_hz[int(np.argmin(smooth)) - 1 if not smooth.all() else -1])
        highest = min(excited / RESPONSE_RATIO, half / STOP_RATIO)
        if bandwidth_hz > highest:
            raise InputError(
                f"bandwidth_hz must be at most {highest:.4g} Hz (by the coherence of the taps, above {MIN_COHERENCE}, "
                f"and the sampling rate of the record), got {bandwidth_hz:.4g} Hz: lower it, or tap with a harder tip"
            )

    def _interpolate_response(self, frequency: Floats, bandwidth_hz: float) -> Complexes:
        """Interpolate the responses to other frequencies through their impulse responses, which keeps resonances."""
        window = _window(self.frequency_hz, STOP_RATIO * bandwidth_hz, RESPONSE_RATIO * bandwidth_hz)
        top = int(np.argmax(window <= 0)) or window.size
        step = float(self.frequency_hz[1])
        size = 2 * (self.frequency_hz.size - 1)
        impulse = np.fft.irfft(self.response * window[:, None, None], size, axis=0)
        # The impulse response of the window starts before the tap, in the last eighth of the periodic record.
        early = size // 8
        impulse = np.concatenate([impulse[-early:], impulse[:-early]])
        # Zero padding by a factor of 16 makes the spectrum smooth enough for cubic interpolation.
        from scipy.fft import rfft  # noqa: PLC0415 - costly to import
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

        fine = 16
        dense = rfft(impulse, fine * size, axis=0)[: fine * top + 1]
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
                f"noise_to_signal must be above 0 where the response of the channels is singular, got "
                f"{noise_to_signal:g}: raise it, or lower the bandwidth"
            ) from error


def _isolate_stroke(hammer: Floats) -> Floats:
    """Return the hammer force, set to 0 outside the contact and its surroundings."""
    peak = int(np.argmax(hammer))
    off = hammer < CONTACT_RATIO * hammer[peak]
    before = np.flatnonzero(off[:peak])
    after = np.flatnonzero(off[peak:])
    first = int(before[-1]) if before.size else 0
    last = peak + int(after[0]) if after.size else hammer.size
    width = last - first
    stroke = np.zeros_like(hammer)
    contact = slice(max(first - width, 0), last + width)
    stroke[contact] = hammer[contact]
    return stroke


def _ratio(across: Complexes, power: Complexes) -> Complexes:
    """Return the responses from the cross-spectra and the power spectra of the forces. (m, 3, 3)."""
    scale = np.trace(power, axis1=1, axis2=2).real
    # Regularise frequencies without excitation; the coherence excludes them.
    floor = 1e-12 * np.maximum(scale, 1e-12 * scale.max())
    return np.asarray(across @ np.linalg.inv(power + floor[:, None, None] * np.eye(AXES)))


def _spring(frequency: Floats, response: Complexes, coherence: Floats, flat_hz: float | None) -> Bools:
    """Return the mask of frequencies, including 0, at which the dynamometer acts as a spring."""
    if flat_hz is None:
        coherent = (coherence > MIN_COHERENCE).any(axis=1)
        strength = np.where(coherent, np.abs(response).max(axis=(1, 2)), 0.0)
        flat_hz = SPRING_RATIO * float(frequency[int(np.argmax(strength))])
    low = frequency <= flat_hz
    if np.count_nonzero(low) < 9:
        raise InputError(
            f"at least 9 frequencies are needed up to flat_hz, {flat_hz:g} Hz, got {np.count_nonzero(low)}: record "
            "each tap for longer, or raise flat_hz"
        )
    return low


def _fit_spring(frequency: Floats, response: Complexes) -> tuple[Complexes, Floats]:
    """Return the spring model fitted to the responses at low frequencies, and its static gain."""
    at = frequency / frequency[-1]
    even, odd = np.vander(at**2, 3, increasing=True), at[:, None] * np.vander(at**2, 2, increasing=True)
    flat = response.reshape(-1, AXES * AXES)
    # The response at frequency 0 is not known, since the offset of the amplifiers was subtracted.
    of_even = np.linalg.lstsq(even[1:], flat.real[1:], rcond=None)[0]
    of_odd = np.linalg.lstsq(odd[1:], flat.imag[1:], rcond=None)[0]
    smooth = (even @ of_even + 1j * (odd @ of_odd)).reshape(-1, AXES, AXES)
    return smooth, of_even[0].reshape(AXES, AXES)


def _window(frequency: Floats, opens: float, closes: float) -> Floats:
    """Return a window that is 1 up to one frequency and 0 from another, with a cosine taper between."""
    share = np.clip((frequency - opens) / (closes - opens), 0, 1)
    return np.asarray(0.5 * (1 + np.cos(np.pi * share)))
