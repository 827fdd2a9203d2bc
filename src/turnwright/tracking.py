r"""What the controller's interpolator and the servos make of a motion.

A program is points; an axis moves between them as the controller's interpolator says, and answers as its servo lets it:

.. math:: y(s) = H(s)\, e^{-s T}\, u(s)

with u the interpolated command, T the dead time and H the closed loop of the axis. A ratio of polynomials H is split
into its modes :math:`x' = p x + u`; the command is a polynomial between two knots, so every mode has a closed form
there and nothing is discretised. A measured H acts on the spectrum of the command instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turnwright._arrays import Floats, frozen, only_read, rounding, same_length
from turnwright._kernels import tracking as kernel
from turnwright._validate import positive
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
)
from turnwright.path import Motion
from turnwright.progress import Progress

__all__ = ["precorrect", "track"]

APART = 1e-4
"""Poles nearer to each other than this, relatively, are set this far apart: the response changes by its square."""

QUIET_S = 0.5
"""Time beyond both ends over which a measured response dies away, at least. [s]"""

FINER = 8
"""Even samples to a point, at most, that uneven points begin with: their shortest block may be far too short."""

ROUNDS = 4
"""How often samples are set closer together, at most; the second time is the last but for odd motions."""

SETTLING_RAD = 1e-3
"""Angle by which C may swing back where it comes from rest or to rest: a micrometre at a radius of one millimetre."""

MOST_SAMPLES = 300_000_000
"""Beyond this no memory holds the motion."""


def track(
    motion: Motion,
    machine: Machine | None = None,
    *,
    chord: float = 1e-6,
    at: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Motion:
    r"""Return the axes as they really move, which `generate` sweeps like any other motion.

    First the controller: no block is shorter than its block rate allows, and no axis goes faster than it could brake
    within the blocks that the controller looks ahead; there the whole motion slows down. Then its interpolation:

    * "linear": straight lines between the points;
    * "hermite" (PVT): cubics through the points, with the velocities that the motion states, or where it states none
      with the slopes of the parabolas through three neighbours each;
    * "quadratic spline", "cubic spline": B-splines with the points as control points, which pass inside of them.

    A fast tool (axes W and U) has a controller of its own, which keeps its times and goes straight from point to point;
    the blocks of the lathe beside it are those of `Motion.lathe`.

    Last each axis: its dead time and its response. Before the program begins every axis has moved on as straight as it
    begins. Where C comes to rest, its servo may swing past the end and back, and while its dead time lasts it stands;
    there C is taken to creep on evenly, off by no more than that swing.

    Parameters
    ----------
    motion
        Planned here or read back from a program, in time.
    machine
        Whose controller and servos follow it; ``motion.machine`` if not given.
    chord
        Largest distance between the real motion of a sliding axis and the straight lines between the samples that are
        returned, as its second differences show it. [mm]
    at
        Times at which to state the motion, as that of another machine was stated, whatever the chord; evenly spaced
        where a response was measured. (m,) [s]
    progress
        Called with (axes done, axes in all).

    Raises
    ------
    InputError
        If ``chord`` is not positive.
    LimitError
        If the motion would need more samples than any memory holds, or the servo of C turns back by more than 1 mrad.

    Sources
    -------
    The closed form of a mode under a polynomial is the phi functions of exponential integrators [Hochbruck2010]_. The
    B-splines are those that common controllers call spline moves.
    """
    positive(chord, "chord", "mm")
    machine = machine or motion.machine
    time = _paced(motion, machine)
    velocity = _velocities(motion, machine, time)
    blocks = motion.blocks if FAST.keys() & motion.axes.keys() else slice(None)
    uniform = any(
        machine.axes[letter].response is not None and not isinstance(machine.axes[letter].response, RationalResponse)
        for letter in motion.axes
        if letter in machine.axes
    )
    report = progress or (lambda _done, _total: None)
    parts = 1
    asked = None if at is None else frozen(at, "at")
    for rounds in range(1, ROUNDS + 1):
        samples = _samples(time, parts, uniform=uniform) if asked is None else asked
        axes = {}
        for k, letter in enumerate(motion.axes):
            report(k, len(motion.axes))
            own = slice(None) if letter in FAST else blocks
            speed = velocity[letter][own] if letter in velocity else None
            axes[letter] = _follow(letter, motion.axes[letter][own], speed, time[own], machine, samples)
        if asked is not None:
            break
        bulge = max(
            kernel.bulge(only_read(samples), position) for letter, position in axes.items() if letter not in ROTARY
        )
        # The second differences of few points may hide a part of what curves between them, but not that of a corner.
        if bulge <= chord or (parts > 1 and machine.controller.interpolation == "linear") or rounds == ROUNDS:
            break
        parts = math.ceil(parts * math.sqrt(bulge / chord))
    report(len(axes), len(axes))
    axes["C"] = motion.sense * _settling(motion.sense * axes["C"], samples, machine)
    return Motion(time=samples - samples[0], axes=axes, machine=motion.machine)


def precorrect(
    motion: Motion,
    machine: Machine | None = None,
    *,
    bandwidth_hz: float | None = None,
    rounds: int = 2,
    missed: Mapping[str, ArrayLike] | None = None,
    progress: Progress | None = None,
) -> Motion:
    r"""Return the commanded motion whose real axes pass where a motion was meant to pass.

    What the axes miss at the points, :math:`e = r - y`, is found by `track` itself, interpolation, dead time and all,
    and added to the command through the inverse of each axis within its bandwidth, :math:`Q/H`; again and again, since
    points are not a smooth curve. Each round leaves about :math:`1 - Q` of an error, and :math:`1 - Q H_{real}/H` of it
    where the axis is not as the machine file says. A motion that asks for more than the bandwidth keeps that part of
    its error, and the corrected one asks more of the axes: check its limits.

    What a machine really missed, from its own log, can be given in place of what `track` says: then the motion is what
    was commanded when the log was taken, and that much is added to it, once. Each log taken with the command that the
    one before led to leaves :math:`1 - Q H_{real}/H` of what there was, however wrong the model began.

    Parameters
    ----------
    motion
        Where the axes shall pass at the given times.
    machine
        Whose controller and servos follow it; ``motion.machine`` if not given.
    bandwidth_hz
        Where the correction ends, by a smooth low pass without phase. If not given, for each axis the frequency at
        which it answers with half its command or less, and at most a third of the block rate. [Hz]
    rounds
        Corrections, one upon the other.
    missed
        Of each axis that was logged, by letter: where it should have been minus where it was, at the points. Each (n,)
        [mm or rad]
    progress
        Called with (rounds done, rounds in all).

    Raises
    ------
    InputError
        If the bandwidth is not positive, there is no round, or a log does not go with the motion.
    LimitError
        If the controller would slow the motion down, so that its times do not hold.

    Sources
    -------
    Iterative learning control with the inverse model as learning filter [Bristow2006]_.
    """
    machine = machine or motion.machine
    if bandwidth_hz is not None:
        positive(bandwidth_hz, "bandwidth_hz", "Hz")
    if rounds < 1:
        raise InputError(f"rounds is {rounds}, it must be at least 1: give the number of corrections")
    if _paced(motion, machine) is not motion.time:
        raise LimitError(
            f"{machine.name} slows this motion down by its block rate or look-ahead, so the times of its points do not "
            "hold: turn slower, or take fewer points"
        )
    time = motion.time
    axes = dict(motion.axes)
    velocity = _velocities(motion, machine, time)
    logged = None if missed is None else _logged(missed, motion)
    rounds = rounds if logged is None else 1
    for done in range(rounds):
        for letter, wanted in motion.axes.items():
            axis = machine.axes.get(letter)
            if axis is None or (logged is not None and letter not in logged):
                continue
            if logged is None:
                off = wanted - _follow(letter, axes[letter], velocity.get(letter), time, machine, time)
            else:
                off = logged[letter]
            more, faster = _inverted(off, time, axis, bandwidth_hz)
            axes[letter] = axes[letter] + more
            if letter in velocity:
                velocity[letter] = velocity[letter] + faster
        if progress is not None:
            progress(done + 1, rounds)
    return Motion(time=time, axes=axes, machine=motion.machine, velocity=velocity or None)


def _logged(missed: Mapping[str, ArrayLike], motion: Motion) -> dict[str, Floats]:
    """Return a log as arrays, or raise if it does not go with a motion."""
    strange = sorted(set(missed) - set(motion.axes))
    if strange:
        raise InputError(
            f"the log has axis {', '.join(strange)}, the motion has {', '.join(sorted(motion.axes))}: leave it out"
        )
    logged = {letter: frozen(values, f"the log of axis {letter}") for letter, values in missed.items()}
    same_length([("time", motion.time), *logged.items()])
    return logged


def _velocities(motion: Motion, machine: Machine, time: Floats) -> dict[str, Floats]:
    """Return the velocities at the points that the controller is told, at the pace that it keeps; none if it is not."""
    if motion.velocity is None or machine.controller.interpolation != "hermite":
        return {}
    if time is motion.time:
        return dict(motion.velocity)
    # Where two blocks are slowed differently, their mean.
    pace = np.gradient(motion.time) / np.gradient(time)
    return {letter: pace * values for letter, values in motion.velocity.items()}


def _inverted(missed: Floats, time: Floats, axis: Axis, bandwidth_hz: float | None) -> tuple[Floats, Floats]:
    """Return the command within the bandwidth to which an axis answers with what was missed, and its velocity."""
    from scipy import fft, interpolate  # noqa: PLC0415 - costly to import

    # Blocks of many lengths are not sampled as finely as the shortest throughout.
    step = max(float(np.diff(time).min()) + rounding(time), float(time[-1] - time[0]) / (FINER * time.size))
    even = np.linspace(time[0], time[-1], math.ceil((time[-1] - time[0]) / step) + 1)
    step = float(even[1] - even[0])
    uneven = even.size != time.size
    values = interpolate.CubicSpline(time, missed)(even) if uneven else missed
    # Beyond both ends the error goes on as in a mirror and dies out, so that neither end sees the other.
    wing = min(math.ceil(QUIET_S / step), values.size - 1)
    fading = 0.5 * (1 + np.cos(np.pi * np.arange(1, wing + 1) / (wing + 1)))
    right, left = values[-2 : -wing - 2 : -1] * fading, values[1 : wing + 1] * fading
    size = fft.next_fast_len(values.size + 2 * wing, real=True)
    wide = np.zeros(size)
    wide[: values.size] = values
    wide[values.size : values.size + wing] = right
    wide[size - wing :] = left[::-1]
    frequency = fft.rfftfreq(size, step)
    answer = np.ones(frequency.size, dtype=np.complex128)
    if axis.response is not None:
        answer *= axis.response.at(frequency)
    band = bandwidth_hz or _band(axis.response, 1 / step)
    answer *= np.exp(-2j * np.pi * frequency * (axis.dead_time or 0.0))
    spectrum = fft.rfft(wide) / answer / (1 + (frequency / band) ** 16)
    made, rate = (fft.irfft(one, size)[: values.size] for one in (spectrum, 2j * np.pi * frequency * spectrum))
    if uneven:
        made, rate = (interpolate.CubicSpline(even, one)(time) for one in (made, rate))
    return made, rate


def _band(response: Response | None, rate_hz: float) -> float:
    """Return up to where an axis can be corrected. [Hz]."""
    most = rate_hz / 3
    if response is None:
        return most
    asked = most * np.geomspace(1e-4, 1, 2000)
    weak = np.flatnonzero(np.abs(response.at(asked)) <= 0.5)
    return float(asked[weak[0]]) if weak.size else most


def _paced(motion: Motion, machine: Machine) -> Floats:
    """Return when the controller is at each point. (n,) [s]."""
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
    """Return the times at which the motion is stated: the points, each block in parts, or evenly."""
    length = time[-1] - time[0]
    blocks = time.size - 1
    if uniform:
        blocks = min(math.ceil(length / (np.diff(time).min() + rounding(time))), FINER * time.size)
    if blocks * parts > MOST_SAMPLES:
        raise LimitError(
            f"the real motion needs {blocks * parts:.3g} samples, the limit is {MOST_SAMPLES:.3g}: allow a larger chord"
        )
    if uniform:
        return np.linspace(time[0], time[-1], blocks * parts + 1)
    if parts == 1:
        return time
    share = np.arange(parts) / parts
    at = np.empty((time.size - 1) * parts + 1)
    at[:-1].reshape(-1, parts)[:] = time[:-1, None] + np.diff(time)[:, None] * share
    at[-1] = time[-1]
    return at


def _settling(angle: Floats, time: Floats, machine: Machine) -> Floats:
    """Return an angle that grows all the way, or raise if it swings back by more than it may at its ends. (n,)."""
    if (angle[1:] > angle[:-1]).all():
        return angle
    made = angle
    for _ in range(2):  # the end, and then the beginning from behind
        made = -_creeping(made)[::-1]
    back = np.flatnonzero(made[1:] <= made[:-1])
    if back.size:
        most = float(np.maximum.accumulate(angle)[back[0]] - angle[back[0] :].min())
        raise LimitError(
            f"the servo of C on {machine.name} turns back by {most:.3g} rad at {time[back[0]]:.4g} s, the limit is "
            f"{SETTLING_RAD:g} rad, and only from rest and to rest: turn slower, or use a response of C that is faster "
            "or better damped"
        )
    return made


def _creeping(angle: Floats) -> Floats:
    """Return an angle that grows evenly to its end where it swings past that and back. (n,)."""
    back = np.flatnonzero(angle[1:] <= angle[:-1])
    back = back[angle[back] > angle[-1] - SETTLING_RAD]
    if not back.size:
        return angle
    swing = angle[back[0] :]
    low, high = float(swing.min()), float(swing.max())
    first, step = int(back[0]), rounding(angle)
    while first > 0 and (angle[first] >= low or high - angle[first] < step * (angle.size - first)):
        first -= 1
    if high - angle[first] > SETTLING_RAD:
        return angle
    return np.concatenate([angle[:first], np.linspace(angle[first], high, angle.size - first)])


def _follow(
    letter: str, position: Floats, velocity: Floats | None, time: Floats, machine: Machine, at: Floats
) -> Floats:
    """Return where an axis really stands at some times."""
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
    # A spindle turns far: what it turns steadily is kept apart, so that it costs the rest no digits.
    # Splines over uneven blocks do not keep a straight line.
    straight = kind in (kernel.LINEAR, kernel.CUBIC)
    slope = (position[-1] - position[0]) / (time[-1] - time[0]) if straight else 0.0
    line = position[0] + slope * (time - time[0])
    rest = position - line
    if kind == kernel.CUBIC:
        rate -= slope
    out = np.empty(at.size)
    steady = position[0] + slope * (at - delay - time[0])
    if response is None:
        kernel.command(kind, time, rest, rate, delay, at, out)
        out += steady
        return out
    if isinstance(response, RationalResponse):
        poles, residues, direct, lag = _modes(response)
        kernel.respond(kind, time, rest, rate, delay, poles, residues, direct, at, out)
        out += steady - slope * lag
        return out
    step = (at[-1] - at[0]) / (at.size - 1)
    beyond = max(1, math.ceil(max(QUIET_S, 4 / _lowest(response)) / step))
    wide = only_read(at[0] + step * np.arange(-beyond, at.size + beyond))
    out = np.empty(wide.size)
    kernel.command(kind, time, rest, rate, delay, wide, out)
    # The part that runs straight on beyond both ends is thrown away again, once the ends' own answer has died in it.
    out = _filtered(out, step, response)[beyond:-beyond]
    out += steady - slope * _lag(response)
    return out


def _modes(response: RationalResponse) -> tuple[NDArray[np.complex128], NDArray[np.complex128], float, float]:
    """Return poles, residues and direct gain as the kernel takes them, and the lag of a steady motion [s]."""
    above, below = response.polynomials
    above = np.concatenate((np.zeros(below.size - above.size), above)) / below[0]
    below = below / below[0]
    direct = float(above[0])
    poles = _parted(np.roots(below).astype(np.complex128))
    apart = poles[:, None] - poles + np.eye(poles.size)
    residues = np.polyval(above - direct * below, poles) / apart.prod(axis=1)
    # An axis that stands still stands where it was sent, to the last digit.
    if direct != 1.0:
        residues *= (1.0 - direct) / (-(residues / poles).sum()).real
    lag = float((residues / poles**2).sum().real)
    kept = poles.imag >= 0
    return poles[kept], np.where(poles.imag == 0, 0.5, 1.0)[kept] * residues[kept], direct, lag


def _parted(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return poles of which no two coincide, so that each is a mode of its own."""
    parted = poles.copy()
    left = np.ones(poles.size, dtype=bool)
    while left.any():
        first = poles[np.argmax(left)]
        near = left & (np.abs(poles - first) < APART * abs(first))
        left &= ~near
        count = int(near.sum())
        if count > 1:
            middle = poles[near].mean()
            if abs(middle.imag) < APART * abs(middle):
                middle = middle.real
            parted[near] = middle * (1 + APART * (np.arange(count) - (count - 1) / 2))
    return parted


def _lowest(response: Response) -> float:
    """Return the lowest frequency that a response was measured at. [Hz]."""
    return float(response.frequency_hz[0]) if isinstance(response, FrequencyResponse) else math.inf


def _lag(response: Response) -> float:
    """Return how far behind a steady motion an axis is. [s]."""
    small = 1e-3 * min(_lowest(response), 1.0)
    return float(-np.angle(response.at(small))) / (2 * math.pi * small)


def _filtered(values: Floats, step: float, response: Response) -> Floats:
    """Return what a response makes of evenly spaced values, their straight line from first to last kept apart."""
    from scipy import fft  # noqa: PLC0415 - costly to import

    line = np.linspace(values[0], values[-1], values.size)
    slope = (values[-1] - values[0]) / (step * (values.size - 1))
    spectrum = fft.rfft((values - line)[:-1])
    spectrum *= response.at(fft.rfftfreq(values.size - 1, step))
    made = np.append(fft.irfft(spectrum, values.size - 1), 0.0)
    made += line - slope * _lag(response)
    return made
