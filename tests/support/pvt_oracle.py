"""Random PVT motions, and the peaks of their cubics by SciPy: samples, both ends of every block, and roots."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PPoly

import turnwright as tw

TURN = 2 * np.pi
KINDS = ("speed", "acceleration", "jerk")
EACH = 16
"""Samples of each cubic, besides its ends and its own extremes."""


def peaks(time, position, velocity):
    """Return lowest and highest position, and the largest speed, acceleration and jerk, of SciPy's cubics."""
    spline = CubicHermiteSpline(time, position, velocity)
    step = np.diff(time)
    found = []
    for order in range(4):
        curve = PPoly(spline.c, time) if order == 0 else spline.derivative(order)
        coefficients = curve.c
        u = np.concatenate([step * k / EACH for k in range(EACH + 1)]).reshape(EACH + 1, -1)
        values = np.zeros_like(u)
        for row in coefficients:
            values = values * u + row
        if order < 2:  # one more derivative shows where it is extreme inside
            roots = spline.derivative(order + 1).roots(discontinuity=False, extrapolate=False)
            values = np.append(values, curve(roots[np.isfinite(roots)]))
        low, high = values.min(), values.max()
        found.append((low, high))
    return found[0], [max(-low, high) for low, high in found[1:]]


def rounding(time, position, velocity, order):
    """Return what rounding of positions and speeds alone makes of a derivative of the cubics."""
    step = np.diff(time).min()
    speed = np.spacing(np.abs(velocity).max()) + np.spacing(np.abs(position).max()) / step
    return 64 * speed / step ** (order - 1)


def choose(rng, *values):
    return values[rng.integers(len(values))]


def machine_of(rng, *, fast=False):
    """Return a lathe whose controller takes velocities, with limits that bind in turn."""

    def limit(low, high):
        return float(10 ** rng.uniform(low, high)) if rng.random() < 0.6 else None

    def slide():
        return tw.Axis(speed=limit(0, 2.5), acceleration=limit(0, 3), jerk=limit(2.5, 6))

    axes = {"C": tw.Axis(acceleration=limit(0, 2.5), jerk=limit(1.5, 5)), "X": slide(), "Z": slide()}
    if fast:
        axes["W"] = tw.Axis(low=-1.0, high=1.0, speed=limit(1, 3), acceleration=limit(2.5, 6))
        axes["U"] = tw.Axis(low=-1.0, high=1.0, acceleration=limit(2.5, 6))
    return tw.Machine(
        name="lathe", axes=axes, spindle_rpm=float(10 ** rng.uniform(2, 4)),
        block_rate_hz=float(10 ** rng.uniform(2, 4.5)), dialect="pmac",
        controller=tw.Controller(interpolation="hermite", variable_speed=bool(rng.random() < 0.3)),
    )  # fmt: skip


def surface_of(rng, radius):
    high, period = float(10 ** rng.uniform(-4, -2)), float(rng.uniform(0.3, 1.0))
    bend = float(rng.uniform(8, 40)) * choose(rng, 1, -1)
    return choose(
        rng,
        tw.SineGrid(amplitude=(high, high), period=(period, period)),
        tw.Toroid(radius_x=bend, radius_y=1.3 * bend),
        tw.Sphere(radius=bend).placed(shift=(0.6 * radius, 0.0, 0.0)),
        tw.LensArray.hexagonal(pitch=0.4, lenslet=tw.Sphere(radius=bend), rings=4),
        tw.Expression(f"{high}*sin(3*phi)*rho**3"),
    )


def setting(rng):
    """Return a kind of motion, its path, strategy, machine, and speed profile if it has one."""
    radius, tool = 0.5, tw.Tool(nose_radius=0.1, included=np.deg2rad(120))
    part = tw.Part(surface=surface_of(rng, radius), radius=radius)
    shared = {"sense": choose(rng, 1, -1), "inside_out": bool(rng.random() < 0.5)}
    feed = float(rng.uniform(0.01, 0.03))
    ways = (
        {"points_per_rev": choose(rng, 24, 60, 120, 360)},
        {"arc_length": 0.02, "max_step": 0.3},
        {"chord": 5e-5},
    )
    slow = tw.SlowToolServo(feed=feed, **choose(rng, *ways), **shared)
    kind = choose(rng, "slow", "slow", "servo", "steady", "split", "fast", "hybrid", "blocks")
    fast = kind in ("split", "fast", "hybrid", "blocks")
    machine = machine_of(rng, fast=fast)
    servo = slow
    if kind in ("servo", "steady", "split"):
        servo = tw.AdaptiveToolServo(scallop=3e-4, chord=5e-5, interpolation="hermite", x_motion=kind, **shared)
    elif fast:
        slow = replace(slow, points_per_rev=360, arc_length=None, max_step=None, chord=None)
        servo = tw.FastToolServo(plan=slow)
        if kind != "fast":
            blocks = 24 if kind == "blocks" else None
            servo = tw.HybridToolServo(plan=slow, fast=machine.axes["W"], blocks_per_rev=blocks)
    path = tw.place(servo.spiral(part, tool), part, tool)
    profile = None
    if machine.controller.variable_speed and rng.random() < 0.3:
        profile = tw.SpeedProfile(radius=[0.1, 0.4], spindle_rpm=[60.0, 20.0])
    return kind, path, servo, machine, profile


def case(rng):
    """Return a motion at the highest speed within the limits, or at a stated one, and its machine."""
    kind, path, servo, machine, profile = setting(rng)
    return kind, tw.drive(path, servo, machine, profile=profile), machine, profile is None


def top_rpm(motion):
    return np.abs(motion.velocity["C"]).max() * 60 / TURN


def stated(path, servo, machine, rpm):
    """Return whether a stated speed keeps every limit, by SciPy's cubics, and the speed that is reached."""
    try:
        motion = tw.drive(path, replace(servo, spindle_rpm=rpm), machine)
    except tw.LimitError:
        return False, None
    return judge(motion, machine)[1] <= 1 + 1e-9, top_rpm(motion)


def slopes(time, position):
    """Return the slopes of the parabolas through three neighbours each, by NumPy."""
    return np.gradient(position, time, edge_order=2)


def judge(motion, machine):
    """Return by how much `check_limits` is off at most, and the largest share of a limit, both by SciPy's cubics."""
    limits = tw.check_limits(motion, machine)
    worst, used = 0.0, [1 / np.diff(motion.time[motion.blocks]).min() / machine.block_rate_hz]
    for letter in set(motion.axes) - {"W", "U"}:
        time, position = motion.time[motion.blocks], motion.axes[letter][motion.blocks]
        speed = np.array(motion.velocity[letter][motion.blocks] if motion.velocity else slopes(time, position))
        if {"W", "U"} & set(motion.axes) or not motion.velocity:
            speed[[0, -1]] = 0.0  # as the program begins and ends
        travel, tops = peaks(time, position, speed)
        off = np.abs(np.subtract(limits.travel[letter], travel)).max() - 4 * np.spacing(np.abs(travel).max())
        worst = max(worst, off / max(np.ptp(travel), 1e-300))
        for order, (name, top) in enumerate(zip(KINDS, tops, strict=True), 1):
            made = getattr(limits, f"peak_{name}")[letter]
            worst = max(worst, (abs(made - top) - rounding(time, position, speed, order)) / max(top, 1e-300))
            turning = (letter, name) == ("C", "speed")
            limit = machine.spindle_rpm * TURN / 60 if turning else getattr(machine.axes[letter], name)
            if limit is not None:
                used.append(top / limit)
    for letter in {"W", "U"} & set(motion.axes):
        used += [share for name, share in limits.utilisation.items() if name.startswith(letter)]
    return worst, max(used)
