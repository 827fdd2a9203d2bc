"""Actual motion of the axes: interpolation by the controller and response of the servos.

A rational response is split into its modes, which answer a polynomial command in closed form, so that nothing is
discretised (see the theory of tracking). A measured response is applied to the spectrum of the command instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turnwright._arrays import Floats, frozen, only_read, rounding, same_length
from turnwright._kernels import tracking as kernel
from turnwright._validate import positive, whole_number
from turnwright.errors import InputError, LimitError
from turnwright.machine import (
    FAST,
    INTERPOLATIONS,
    ROTARY,
    Axis,
    FrequencyResponse,
    Machine,
    RationalResponse,
    Response,
    blend_blocks,
)
from turnwright.path import Motion
from turnwright.progress import Progress

__all__ = ["precorrect", "track"]

MIN_POLE_DISTANCE = 1e-4
"""Relative distance of two poles; closer ones are moved apart, which changes the response by its square."""

MIN_DECAY_S = 0.5
"""Time beyond both ends over which a measured response decays."""

MAX_EVEN_SAMPLES_PER_POINT = 8
"""Evenly spaced samples per point of an unevenly spaced motion, whose shortest block may be much shorter."""

MAX_REFINEMENTS = 4
"""Times that the samples are refined; two are enough for common motions."""

MAX_C_REVERSAL_RAD = 1e-3
"""Angle by which C may swing back at the start or end of a motion: a micrometre at a radius of one millimetre."""

MAX_SAMPLES = 300_000_000


def track(
    motion: Motion,
    machine: Machine | None = None,
    *,
    chord: float = 1e-6,
    at: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Motion:
    r"""Return the actual motion of the axes, which `generate` sweeps like any other motion.

    First the controller limits the speed: no block is shorter than the block rate allows, and no axis is faster than it
    can brake within the look-ahead; there the whole motion slows down. Then it interpolates:

    * "linear": straight lines between the points;
    * "hermite" (PVT): cubics through the points, with the velocities of the motion, or, if it has none, with the slopes
      of parabolas through three neighbouring points;
    * "quadratic spline", "cubic spline": B-splines with the points as control points, which cut corners;
    * "linuxcnc": what LinuxCNC 2.9 makes of straight blocks in which C moves. It blends each block into the next and
      takes its own time; the result has a point for every servo cycle.

    A fast tool (axes W and U) has its own controller, which keeps the times and interpolates linearly; the blocks of
    the lathe are then those of `Motion.lathe`.

    Last, each axis follows with its dead time and response. Before the program begins, every axis is assumed to move
    steadily with its initial velocity. Where C comes to rest, its servo may overshoot and return, and it stands still
    during the dead time; there C is replaced by a slow uniform motion, which deviates by no more than the overshoot.
    In spindle mode the spindle runs steadily.

    Parameters
    ----------
    motion
        A planned motion, or one read from a program.
    machine
        The machine whose controller and servos execute it; ``motion.machine`` if not given.
    chord
        Largest distance between the actual motion of a linear axis and the straight lines between the returned samples,
        estimated from second differences. [mm]
    at
        Times of the returned samples, regardless of the chord; evenly spaced where a response was measured. (m,) [s]
    progress
        Called with (axes done, number of axes).

    Raises
    ------
    InputError
        If ``chord`` is not positive.
    LimitError
        If the motion needs more than 300 million samples, or the servo of C turns back by more than 1 mrad.

    Sources
    -------
    The closed form of a mode under a polynomial is the phi functions of exponential integrators [Hochbruck2010]_. The
    B-splines are those of the spline moves of common controllers.
    """
    positive(chord, "chord", "mm")
    machine = machine or motion.machine
    if machine.controller.interpolation == "linuxcnc":
        machine = replace(machine, controller=replace(machine.controller, interpolation="linear"))
        if motion.spindle_mode is None:
            motion = _blend(motion, machine)
    time = _controller_times(motion, machine)
    velocity = _velocities(motion, machine, time)
    blocks = motion.blocks if FAST.keys() & motion.axes.keys() else slice(None)
    uniform = any(
        machine.axes[letter].response is not None and not isinstance(machine.axes[letter].response, RationalResponse)
        for letter in motion.axes
        if letter in machine.axes
    )
    report = progress or (lambda _done, _total: None)
    parts = 1
    requested = None if at is None else frozen(at, "at")
    for rounds in range(1, MAX_REFINEMENTS + 1):
        samples = _samples(time, parts, uniform=uniform) if requested is None else requested
        axes = {}
        for k, letter in enumerate(motion.axes):
            report(k, len(motion.axes))
            points = slice(None) if letter in FAST else blocks
            speed = velocity[letter][points] if letter in velocity else None
            if letter == "C" and motion.spindle_mode is not None:  # a free spindle runs steadily
                axes[letter] = np.interp(samples, time, motion.axes[letter])
                continue
            axes[letter] = _follow(letter, motion.axes[letter][points], speed, time[points], machine, samples)
        if requested is not None:
            break
        bulge = max(
            kernel.bulge(only_read(samples), position) for letter, position in axes.items() if letter not in ROTARY
        )
        # Second differences of coarse samples underestimate smooth curvature, but not a corner.
        if bulge <= chord or (parts > 1 and machine.controller.interpolation == "linear") or rounds == MAX_REFINEMENTS:
            break
        parts = math.ceil(parts * math.sqrt(bulge / chord))
    report(len(axes), len(axes))
    axes["C"] = motion.sense * _settle_angle(motion.sense * axes["C"], samples, machine)
    return Motion(time=samples - samples[0], axes=axes, machine=motion.machine, spindle_mode=motion.spindle_mode)


def precorrect(
    motion: Motion,
    machine: Machine | None = None,
    *,
    bandwidth_hz: float | None = None,
    rounds: int = 2,
    missed: Mapping[str, ArrayLike] | None = None,
    progress: Progress | None = None,
) -> Motion:
    r"""Return the command for which the actual axes follow a nominal motion.

    The tracking error at the points, :math:`e = r - y`, is predicted by `track`, including interpolation and dead time,
    and added to the command through the inverse of each axis within its bandwidth, :math:`Q/H`. This is repeated, since
    the interpolation between points is not smooth. Each round leaves about the fraction :math:`1 - Q` of the error, or
    :math:`1 - Q H_{real}/H` where the axis differs from the machine file. Errors above the bandwidth remain, and the
    corrected motion demands more of the axes: check its limits.

    A logged tracking error of the machine can be given in place of the prediction, and is added to the command of the
    logged run once. Each further log of a corrected run leaves the same fraction, however wrong the initial model was.

    Parameters
    ----------
    motion
        The nominal motion, or with ``missed`` the command of the logged run.
    machine
        The machine whose controller and servos execute it; ``motion.machine`` if not given.
    bandwidth_hz
        Cutoff of the correction, a smooth zero-phase low pass. If not given, for each axis the frequency at which its
        amplitude has dropped to half the command, and at most a third of the block rate. [Hz]
    rounds
        Number of successive corrections.
    missed
        Logged tracking error by axis letter: nominal minus actual position at the points. Each (n,) [mm or rad]
    progress
        Called with (rounds done, number of rounds).

    Raises
    ------
    InputError
        If the bandwidth is not positive, ``rounds`` is below 1, a log does not fit the motion, or the motion is in
        spindle mode.
    LimitError
        If the controller slows the motion down, so that its times do not hold.

    Sources
    -------
    Iterative learning control with the inverse model as learning filter [Bristow2006]_.
    """
    machine = machine or motion.machine
    if bandwidth_hz is not None:
        positive(bandwidth_hz, "bandwidth_hz", "Hz")
    rounds = whole_number(rounds, "rounds", 1)
    if motion.spindle_mode is not None:
        raise InputError(
            "a cut in spindle mode cannot be precorrected, its points are too far apart: set precorrect = false, or "
            "cut with C as an axis"
        )
    if _controller_times(motion, machine) is not motion.time:
        raise LimitError(
            f"{machine.name} slows this motion down by its block rate or look-ahead, so the times of its points do not "
            "hold: reduce the spindle speed or the number of points"
        )
    time = motion.time
    axes = dict(motion.axes)
    velocity = _velocities(motion, machine, time)
    logged = None if missed is None else _check_log(missed, motion)
    rounds = rounds if logged is None else 1
    for done in range(rounds):
        for letter, nominal in motion.axes.items():
            axis = machine.axes.get(letter)
            if axis is None or (logged is not None and letter not in logged):
                continue
            if logged is None:
                error = nominal - _follow(letter, axes[letter], velocity.get(letter), time, machine, time)
            else:
                error = logged[letter]
            correction, correction_rate = _invert_error(error, time, axis, bandwidth_hz)
            axes[letter] = axes[letter] + correction
            if letter in velocity:
                velocity[letter] = velocity[letter] + correction_rate
        if progress is not None:
            progress(done + 1, rounds)
    return Motion(time=time, axes=axes, machine=motion.machine, velocity=velocity or None)


def _check_log(missed: Mapping[str, ArrayLike], motion: Motion) -> dict[str, Floats]:
    unknown = sorted(set(missed) - set(motion.axes))
    if unknown:
        raise InputError(
            f"the log has axis {', '.join(unknown)}, the motion has {', '.join(sorted(motion.axes))}: remove it"
        )
    logged = {letter: frozen(values, f"the log of axis {letter}") for letter, values in missed.items()}
    same_length([("time", motion.time), *logged.items()])
    return logged


def _blend(motion: Motion, machine: Machine) -> Motion:
    """Return the commands of LinuxCNC to its servos, one for each of its cycles."""
    cycles = blend_blocks(motion.time, motion.axes, machine)
    axes = {}
    for letter in motion.axes:
        planned = cycles.positions(letter)
        # Its interpolator between planner and servos is a uniform cubic B-spline, here without its delay.
        held = np.concatenate((planned[:1], planned, planned[-1:]))
        axes[letter] = (held[:-2] + 4 * held[1:-1] + held[2:]) / 6
    moves = np.append(True, np.abs(np.diff(axes["C"])) > 0)
    return Motion(
        time=cycles.time[moves], axes={letter: one[moves] for letter, one in axes.items()}, machine=motion.machine
    )


def _velocities(motion: Motion, machine: Machine, time: Floats) -> dict[str, Floats]:
    """Return the commanded velocities at the points, scaled to the controller's pace; empty if it does not use them."""
    if motion.velocity is None or machine.controller.interpolation != "hermite":
        return {}
    if time is motion.time:
        return dict(motion.velocity)
    # Where two blocks are slowed differently, the mean.
    pace = np.gradient(motion.time) / np.gradient(time)
    return {letter: pace * values for letter, values in motion.velocity.items()}


def _invert_error(missed: Floats, time: Floats, axis: Axis, bandwidth_hz: float | None) -> tuple[Floats, Floats]:
    """Return the command within the bandwidth that makes an axis move by the missing distance, and its velocity."""
    from scipy import fft, interpolate  # noqa: PLC0415 - costly to import

    # With blocks of different lengths the sampling is not as fine as the shortest block throughout.
    step = max(
        float(np.diff(time).min()) + rounding(time),
        float(time[-1] - time[0]) / (MAX_EVEN_SAMPLES_PER_POINT * time.size),
    )
    even = np.linspace(time[0], time[-1], math.ceil((time[-1] - time[0]) / step) + 1)
    step = float(even[1] - even[0])
    is_resampled = even.size != time.size
    values = interpolate.CubicSpline(time, missed)(even) if is_resampled else missed
    # Beyond both ends the error is mirrored and tapered, so that the ends do not affect each other.
    padding = min(math.ceil(MIN_DECAY_S / step), values.size - 1)
    taper = 0.5 * (1 + np.cos(np.pi * np.arange(1, padding + 1) / (padding + 1)))
    after, before = values[-2 : -padding - 2 : -1] * taper, values[1 : padding + 1] * taper
    size = fft.next_fast_len(values.size + 2 * padding, real=True)
    padded = np.zeros(size)
    padded[: values.size] = values
    padded[values.size : values.size + padding] = after
    padded[size - padding :] = before[::-1]
    frequency = fft.rfftfreq(size, step)
    transfer = np.ones(frequency.size, dtype=np.complex128)
    if axis.response is not None:
        transfer *= axis.response.at(frequency)
    band = bandwidth_hz or _band(axis.response, 1 / step)
    transfer *= np.exp(-2j * np.pi * frequency * (axis.dead_time or 0.0))
    spectrum = fft.rfft(padded) / transfer / (1 + (frequency / band) ** 16)
    command, rate = (fft.irfft(s, size)[: values.size] for s in (spectrum, 2j * np.pi * frequency * spectrum))
    if is_resampled:
        command, rate = (interpolate.CubicSpline(even, samples)(time) for samples in (command, rate))
    return command, rate


def _band(response: Response | None, rate_hz: float) -> float:
    """Return the frequency up to which an axis can be corrected. [Hz]."""
    highest = rate_hz / 3
    if response is None:
        return highest
    frequency = highest * np.geomspace(1e-4, 1, 2000)
    weak = np.flatnonzero(np.abs(response.at(frequency)) <= 0.5)
    return float(frequency[weak[0]]) if weak.size else highest


def _controller_times(motion: Motion, machine: Machine) -> Floats:
    """Return the times at which the controller reaches the points. (n,) [s]."""
    points = motion.blocks
    time = motion.time[points]
    blocks = np.diff(time)
    factor = np.maximum(1.0, (1 - 1e-9) / ((blocks + rounding(time)) * machine.block_rate_hz))
    if machine.controller.look_ahead is not None:
        for letter, position in motion.axes.items():
            limit = getattr(machine.axes.get(letter), "acceleration", None)
            if limit is not None and letter not in FAST:
                kernel.stretch(time, position[points], machine.controller.look_ahead, limit, factor)
    if (factor == 1.0).all():
        return motion.time
    paced = np.concatenate(([0.0], np.cumsum(blocks * factor)))
    return paced if points.size == motion.time.size else np.interp(motion.time, time, paced)


def _samples(time: Floats, parts: int, *, uniform: bool) -> Floats:
    """Return the times of the samples: the points, with each block split into parts, or evenly spaced times."""
    length = time[-1] - time[0]
    blocks = time.size - 1
    if uniform:
        blocks = min(math.ceil(length / (np.diff(time).min() + rounding(time))), MAX_EVEN_SAMPLES_PER_POINT * time.size)
    if blocks * parts > MAX_SAMPLES:
        raise LimitError(
            f"the actual motion needs {blocks * parts:.3g} samples, the limit is {MAX_SAMPLES:.3g}: use a larger chord"
        )
    if uniform:
        return np.linspace(time[0], time[-1], blocks * parts + 1)
    if parts == 1:
        return time
    fraction = np.arange(parts) / parts
    at = np.empty((time.size - 1) * parts + 1)
    at[:-1].reshape(-1, parts)[:] = time[:-1, None] + np.diff(time)[:, None] * fraction
    at[-1] = time[-1]
    return at


def _settle_angle(angle: Floats, time: Floats, machine: Machine) -> Floats:
    """Return a strictly growing angle, or raise if it swings back further than allowed at its ends. (n,)."""
    if (angle[1:] > angle[:-1]).all():
        return angle
    settled = angle
    for _ in range(2):  # the end, then the beginning, reversed
        settled = -_uniform_end(settled)[::-1]
    back = np.flatnonzero(settled[1:] <= settled[:-1])
    if back.size:
        most = float(np.maximum.accumulate(angle)[back[0]] - angle[back[0] :].min())
        raise LimitError(
            f"the servo of C on {machine.name} turns back by {most:.3g} rad at {time[back[0]]:.4g} s, the limit is "
            f"{MAX_C_REVERSAL_RAD:g} rad at the start or end: reduce the spindle speed, or use a response of C that is "
            "faster or better damped"
        )
    return settled


def _uniform_end(angle: Floats) -> Floats:
    """Return an angle that grows uniformly to its end where it overshoots and returns. (n,)."""
    back = np.flatnonzero(angle[1:] <= angle[:-1])
    back = back[angle[back] > angle[-1] - MAX_C_REVERSAL_RAD]
    if not back.size:
        return angle
    swing = angle[back[0] :]
    low, high = float(swing.min()), float(swing.max())
    first, step = int(back[0]), rounding(angle)
    while first > 0 and (angle[first] >= low or high - angle[first] < step * (angle.size - first)):
        first -= 1
    if high - angle[first] > MAX_C_REVERSAL_RAD:
        return angle
    return np.concatenate([angle[:first], np.linspace(angle[first], high, angle.size - first)])


def _follow(
    letter: str, position: Floats, velocity: Floats | None, time: Floats, machine: Machine, at: Floats
) -> Floats:
    time, at = only_read(time), only_read(at)
    axis = machine.axes.get(letter)
    response = axis.response if axis is not None else None
    delay = (axis.dead_time or 0.0) if axis is not None else 0.0
    kind = kernel.LINEAR if letter in FAST else INTERPOLATIONS.index(machine.controller.interpolation)
    rate = np.empty(time.size if kind == kernel.CUBIC else 0)
    if kind == kernel.CUBIC and velocity is not None:
        rate[:] = velocity
    elif kind == kernel.CUBIC:
        kernel.rates(time, only_read(position), rate)
    # The steady part of the motion is handled separately, as the large angle of a spindle would cost digits.
    # Splines over uneven blocks do not preserve a straight line.
    preserves_lines = kind in (kernel.LINEAR, kernel.CUBIC)
    slope = (position[-1] - position[0]) / (time[-1] - time[0]) if preserves_lines else 0.0
    line = position[0] + slope * (time - time[0])
    residual = position - line
    if kind == kernel.CUBIC:
        rate -= slope
    out = np.empty(at.size)
    steady = position[0] + slope * (at - delay - time[0])
    if response is None:
        kernel.command(kind, time, residual, rate, delay, at, out)
        out += steady
        return out
    if isinstance(response, RationalResponse):
        poles, residues, direct, lag = _modes(response)
        kernel.respond(kind, time, residual, rate, delay, poles, residues, direct, at, out)
        out += steady - slope * lag
        return out
    from scipy import fft  # noqa: PLC0415 - costly to import

    step = (at[-1] - at[0]) / (at.size - 1)
    beyond = max(1, math.ceil(max(MIN_DECAY_S, 4 / _lowest(response)) / step))
    # `_filter_values` transforms all values but the last; a number without small factors takes several times as long.
    count = fft.next_fast_len(at.size + 2 * beyond - 1, real=True) + 1
    wide = only_read(at[0] + step * np.arange(-beyond, count - beyond))
    out = np.empty(wide.size)
    kernel.command(kind, time, residual, rate, delay, wide, out)
    # The extensions beyond both ends, in which the response to the ends decays, are dropped.
    out = _filter_values(out, step, response)[beyond : beyond + at.size]
    out += steady - slope * _lag(response)
    return out


def _modes(response: RationalResponse) -> tuple[NDArray[np.complex128], NDArray[np.complex128], float, float]:
    """Return poles, residues and direct gain for the kernel, and the lag of a steady motion [s]."""
    above, below = response.polynomials
    above = np.concatenate((np.zeros(below.size - above.size), above)) / below[0]
    below = below / below[0]
    direct = float(above[0])
    poles = _separate_poles(np.roots(below).astype(np.complex128))
    distances = poles[:, None] - poles + np.eye(poles.size)
    residues = np.polyval(above - direct * below, poles) / distances.prod(axis=1)
    # Make the static gain exactly 1.
    if direct != 1.0:
        residues *= (1.0 - direct) / (-(residues / poles).sum()).real
    lag = float((residues / poles**2).sum().real)
    upper = poles.imag >= 0
    return poles[upper], np.where(poles.imag == 0, 0.5, 1.0)[upper] * residues[upper], direct, lag


def _separate_poles(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return poles of which no two coincide, so that each is a separate mode."""
    separated = poles.copy()
    pending = np.ones(poles.size, dtype=bool)
    while pending.any():
        first = poles[np.argmax(pending)]
        near = pending & (np.abs(poles - first) < MIN_POLE_DISTANCE * abs(first))
        pending &= ~near
        count = int(near.sum())
        if count > 1:
            middle = poles[near].mean()
            if abs(middle.imag) < MIN_POLE_DISTANCE * abs(middle):
                middle = middle.real
            separated[near] = middle * (1 + MIN_POLE_DISTANCE * (np.arange(count) - (count - 1) / 2))
    return separated


def _lowest(response: Response) -> float:
    """Return the lowest frequency of a measured response; infinite for others. [Hz]."""
    return float(response.frequency_hz[0]) if isinstance(response, FrequencyResponse) else math.inf


def _lag(response: Response) -> float:
    """Return the lag of an axis in steady motion. [s]."""
    small = 1e-3 * min(_lowest(response), 1.0)
    return float(-np.angle(response.at(small))) / (2 * math.pi * small)


def _filter_values(values: Floats, step: float, response: Response) -> Floats:
    """Return evenly spaced values filtered by a response; the line from first to last value is only delayed."""
    from scipy import fft  # noqa: PLC0415 - costly to import

    line = np.linspace(values[0], values[-1], values.size)
    slope = (values[-1] - values[0]) / (step * (values.size - 1))
    spectrum = fft.rfft((values - line)[:-1])
    spectrum *= response.at(fft.rfftfreq(values.size - 1, step))
    filtered = np.append(fft.irfft(spectrum, values.size - 1), 0.0)
    filtered += line - slope * _lag(response)
    return filtered
