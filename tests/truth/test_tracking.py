"""Oracles: SciPy's splines for the interpolators, its ODE solver for the axes, closed forms for steady motions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline, CubicHermiteSpline

from turnwright import Axis, Controller, Machine, Motion, Part, SlowToolServo, Sphere, Tool, drive, place
from turnwright.errors import InputError, LimitError
from turnwright.machine import FrequencyResponse, SecondOrder, TransferFunction
from turnwright.tracking import precorrect, track

RNG = np.random.default_rng(3)


def machine(interpolation="linear", *, look_ahead=None, block_rate=1e9, **axes):
    return Machine(
        name="test lathe", axes={letter: axes.get(letter, Axis()) for letter in "CXZ"}, spindle_rpm=1000,
        block_rate_hz=block_rate, controller=Controller(interpolation=interpolation, look_ahead=look_ahead),
    )  # fmt: skip


def motion(on, *, points=400, irregular=False, seconds=0.4):
    time = np.linspace(0, seconds, points)
    if irregular:
        time[1:-1] += RNG.uniform(-0.3, 0.3, points - 2) * (time[1] - time[0])
    z = 0.02 * np.sin(2 * np.pi * 12 * time) + 0.005 * np.cos(2 * np.pi * 31 * time + 0.4)
    return Motion(time=time, axes={"C": 7.0 * time, "X": 5 - 0.1 * time, "Z": z}, machine=on)


@pytest.mark.parametrize("irregular", [False, True])
def test_a_perfect_axis_follows_its_interpolation(irregular):
    given = motion(machine(), irregular=irregular)
    t, z = given.time, given.axes["Z"]
    made = track(given, machine("linear"), chord=1e-9)
    assert made.time.size > 2 * t.size - 2 or irregular
    assert np.abs(made.axes["Z"] - np.interp(made.time, t, z)).max() < 1e-15
    assert np.abs(made.axes["C"] - 7.0 * made.time).max() < 1e-13

    slopes = np.gradient(z, t, edge_order=2)
    made = track(given, machine("hermite"), chord=1e-9)
    assert np.abs(made.axes["Z"] - CubicHermiteSpline(t, z, slopes)(made.time)).max() < 1e-15
    assert np.abs(made.axes["X"] - (5 - 0.1 * made.time)).max() < 1e-14


def report(given):
    """The motion of `motion` with the velocities that it really has, at few points."""
    t = given.time
    z_velocity = 0.02 * 24 * np.pi * np.cos(24 * np.pi * t) - 0.005 * 62 * np.pi * np.sin(62 * np.pi * t + 0.4)
    return replace(given, velocity={"C": np.full(t.size, 7.0), "X": np.full(t.size, -0.1), "Z": z_velocity})


@pytest.mark.parametrize("irregular", [False, True])
def test_velocities_that_a_motion_states_are_those_of_its_cubics(irregular):
    given = report(motion(machine(), points=60, irregular=irregular))
    spline = CubicHermiteSpline(given.time, given.axes["Z"], given.velocity["Z"])
    made = track(given, machine("hermite"), chord=1e-8)
    assert np.abs(made.axes["Z"] - spline(made.time)).max() < 1e-14
    between = np.linspace(0, 0.4, 9001)
    assert np.abs(np.interp(between, made.time, made.axes["Z"]) - spline(between)).max() < 1.2e-8
    assert made.velocity is None
    # A controller that takes no velocities does not know them.
    plain = track(replace(given, velocity=None), machine("linear"))
    assert (track(given, machine("linear")).axes["Z"] == plain.axes["Z"]).all()


def test_velocities_slow_down_with_the_motion():
    given = report(motion(machine(), points=60))
    slow = track(given, machine("hermite", block_rate=59 / 0.8), chord=1e-8)
    slower = slow.time[-1] / 0.4
    assert slower == pytest.approx(2, rel=1e-8)
    spline = CubicHermiteSpline(slower * given.time, given.axes["Z"], given.velocity["Z"] / slower)
    assert np.abs(slow.axes["Z"] - spline(slow.time)).max() < 1e-13


@pytest.mark.parametrize("irregular", [False, True])
def test_a_correction_states_its_velocities(irregular):
    lathe = machine("hermite", Z=Axis(response=SecondOrder(frequency_hz=80, damping=0.7, velocity_feedforward=1.0)))
    given = report(motion(lathe, points=120, irregular=irregular))
    spline = CubicHermiteSpline(given.time, given.axes["Z"], given.velocity["Z"])

    def missed(command):
        real = track(command, chord=1e-8)
        inner = (real.time > 0.05) & (real.time < 0.35)  # the ends have no neighbours to correct them with
        return np.abs(real.axes["Z"] - spline(real.time))[inner].max()

    assert missed(precorrect(given, rounds=3)) < 0.02 * missed(given)


@pytest.mark.parametrize(("name", "degree"), [("quadratic spline", 2), ("cubic spline", 3)])
@pytest.mark.parametrize("irregular", [False, True])
def test_spline_moves_are_b_splines_over_the_points(name, degree, irregular):
    given = motion(machine(), irregular=irregular)
    t, z = given.time, given.axes["Z"]
    first, last = t[1] - t[0], t[-1] - t[-2]
    far = np.concatenate((t[0] - first * np.arange(4, 0, -1), t, t[-1] + last * np.arange(1, 5)))
    control = np.concatenate((
        z[0] - (z[1] - z[0]) * np.arange(4, 0, -1), z, z[-1] + (z[-1] - z[-2]) * np.arange(1, 5),
    ))  # fmt: skip
    if degree == 3:
        # The basis of a point has its middle knot there.
        spline = BSpline(far, control[2:-2], 3)
    else:
        middle = 0.5 * (far[1:] + far[:-1])
        spline = BSpline(middle, control[2:-2], 2)
    made = track(given, machine(name), chord=1e-8)
    assert np.abs(made.axes["Z"] - spline(made.time)).max() < 1e-14
    # They pass inside: less than the points by about a sixth, or an eighth, of the second difference.
    inside = 0.5 * np.diff(z, 2) * (1 / 4 if degree == 2 else 1 / 3)
    if not irregular:
        at = np.searchsorted(made.time, t[1:-1] - 1e-9)
        assert np.allclose(made.axes["Z"][at] - z[1:-1], inside, atol=1e-8)


def solved(time, z, above, below, at, interpolation="linear"):
    """Position of an axis by an ODE solver, block by block, from the steady state of its first slope."""
    from scipy.signal import tf2ss

    a, b, c, d = tf2ss(np.trim_zeros(above, "f"), below)
    if interpolation == "linear":

        def command(t):
            return np.interp(t, time, z)
    else:
        command = CubicHermiteSpline(time, z, np.gradient(z, time, edge_order=2))
    slope = (command(time[0] + 1e-9) - command(time[0])) / 1e-9 if interpolation == "linear" else command(time[0], 1)
    # x = m + n t with n' = 0: 0 = a n + b slope, n = a m + b z0.
    n = np.linalg.solve(a, -b[:, 0] * slope)
    state = np.linalg.solve(a, n - b[:, 0] * z[0])
    found = []
    for k in range(time.size - 1):
        here = at[(at >= time[k]) & (at < time[k + 1])]
        one = solve_ivp(
            lambda t, x: a @ x + b[:, 0] * command(t), (time[k], time[k + 1]), state, method="DOP853", rtol=1e-12,
            atol=1e-15 * np.abs(state).max(), t_eval=np.append(here, time[k + 1]),
        )  # fmt: skip
        found += [(c @ one.y[:, i] + d[:, 0] * command(t))[0] for i, t in enumerate(here)]
        state = one.y[:, -1]
    return np.array(found)


RESPONSES = {
    "no feed-forward": SecondOrder(frequency_hz=60, damping=0.7),
    "velocity": SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1),
    "both": SecondOrder(frequency_hz=80, damping=0.3, velocity_feedforward=0.9, acceleration_feedforward=0.8),
    "critical": SecondOrder(frequency_hz=60, damping=1.0, velocity_feedforward=1),
    "third order": TransferFunction(
        numerator=np.array([2.0, 5e4, 9e6]), denominator=np.poly([-150.0, -200 + 140j, -200 - 140j]).real
        * 9e6 / np.poly([-150.0, -200 + 140j, -200 - 140j]).real[-1],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RESPONSES)
@pytest.mark.parametrize("interpolation", ["linear", "hermite"])
def test_an_axis_moves_as_its_differential_equation_says(name, interpolation):
    response = RESPONSES[name]
    given = motion(machine(), points=60, irregular=True, seconds=0.1)
    made = track(given, machine(interpolation, Z=Axis(response=response)), chord=1e-6)
    t, z = given.time, given.axes["Z"]
    oracle = solved(t, z, *response.polynomials, made.time, interpolation)
    lag = np.abs(oracle - np.interp(made.time[: oracle.size], t, z)).max()
    assert np.abs(made.axes["Z"][: oracle.size] - oracle).max() < (1e-6 if name == "critical" else 1e-8) * lag + 1e-13


def test_a_steady_motion_lags_by_the_axis_and_its_dead_time():
    omega = 2 * np.pi * 50
    slow = SecondOrder(frequency_hz=50, damping=0.7)
    given = motion(machine())
    made = track(given, machine(C=Axis(response=slow, dead_time=0.002), X=Axis(dead_time=0.002)))
    assert np.abs(made.axes["C"] - 7.0 * (made.time - 2 * 0.7 / omega - 0.002)).max() < 1e-12
    assert np.abs(made.axes["X"] - (5 - 0.1 * (made.time - 0.002))).max() < 1e-13


def test_a_measured_response_acts_as_its_axis():
    axis = SecondOrder(frequency_hz=90, damping=0.6, velocity_feedforward=1)
    f = np.geomspace(0.05, 5000, 20000)
    measured = FrequencyResponse(frequency_hz=f, magnitude=np.abs(axis.at(f)), phase=np.angle(axis.at(f)))
    given = motion(machine(), points=801, seconds=0.8)
    exact = track(given, machine("hermite", Z=Axis(response=axis, dead_time=0.001)), chord=1e-5)
    made = track(given, machine("hermite", Z=Axis(response=measured, dead_time=0.001)), chord=1e-5)
    z = np.interp(made.time, exact.time, exact.axes["Z"])
    lag = np.abs(exact.axes["Z"] - np.interp(exact.time, given.time, given.axes["Z"])).max()
    middle = (made.time > 0.1) & (made.time < 0.7)
    assert np.abs(made.axes["Z"] - z)[middle].max() < 1e-3 * lag


def test_one_short_block_does_not_ask_for_a_million_samples():
    """A measured response takes even samples; the second-order axis, which takes any, is the oracle."""
    axis = SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1)
    frequency = np.geomspace(0.05, 20_000, 4000)
    answer = axis.at(frequency)
    measured = FrequencyResponse(frequency_hz=frequency, magnitude=np.abs(answer), phase=np.unwrap(np.angle(answer)))
    time = np.insert(np.linspace(0, 0.4, 401), 200, 0.199 + 1e-7)
    z = 0.02 * np.sin(2 * np.pi * 12 * time)
    given = Motion(time=time, axes={"C": 7.0 * time, "X": 5 - 0.1 * time, "Z": z}, machine=machine("hermite"))
    exact = track(given, machine("hermite", Z=Axis(response=axis)), chord=1e-7)
    made = track(given, machine("hermite", Z=Axis(response=measured)), chord=1e-7)
    assert made.time.size < 100_000
    following = np.abs(exact.axes["Z"] - np.interp(exact.time, time, z)).max()
    apart = made.axes["Z"] - np.interp(made.time, exact.time, exact.axes["Z"])
    assert np.abs(apart).max() < 2e-3 * following + 2e-7


def test_lower_block_rate_slows_the_whole_motion():
    given = motion(machine(), points=401)  # 1000 blocks a second
    made = track(given, machine(block_rate=400), chord=1)
    assert made.time[-1] == pytest.approx(0.4 * 2.5, rel=1e-6)
    assert np.abs(made.axes["Z"] - given.axes["Z"]).max() < 1e-16


@pytest.mark.parametrize("begin", [0.0, 1e4, 1e6])
def test_rounding_of_the_clock_slows_nothing_down(begin):
    """A thousand even blocks a second are even, and as many as a machine of a thousand takes, hours from the start."""
    given = motion(machine(), points=401)
    late = Motion(time=begin + given.time, axes=given.axes, machine=machine(block_rate=1000))
    assert track(late, chord=1).time[-1] == pytest.approx(given.time[-1], rel=1e-9)
    assert precorrect(late).axes["Z"] == pytest.approx(precorrect(given, machine()).axes["Z"], abs=1e-9)


def test_a_short_look_ahead_keeps_the_spindle_slow():
    # Two blocks of 0.007 rad each in 1 ms: w^2 / 2a <= 0.014 rad allows w = sqrt(0.028 * 100) rad/s.
    given = motion(machine(), points=401)
    made = track(given, machine(look_ahead=2, C=Axis(acceleration=100.0)), chord=1)
    assert made.time[-1] == pytest.approx(0.4 * 7.0 / np.sqrt(0.028 * 100), rel=1e-6)


@pytest.mark.parametrize("interpolation", ["linear", "hermite", "quadratic spline", "cubic spline"])
def test_a_corrected_command_agrees_with_an_ode_solver(interpolation):
    axis = SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1)
    on = machine(interpolation, Z=Axis(response=axis), C=Axis(response=axis, dead_time=0.002))
    given = motion(on, points=401)
    before = np.abs(track(given, on, chord=1).axes["Z"] - given.axes["Z"])[100:-100].max()
    corrected = precorrect(given, on)
    after = track(corrected, on, chord=1)
    assert before > 1e-4
    assert np.abs(after.axes["Z"] - given.axes["Z"])[100:-100].max() < 1e-4 * before
    assert np.abs(after.axes["C"] - given.axes["C"])[100:-100].max() < 1e-9
    if interpolation in ("linear", "hermite"):
        real = solved(given.time, corrected.axes["Z"], *axis.polynomials, given.time[:-1], interpolation)
        assert np.abs(real - given.axes["Z"][:-1])[100:-100].max() < 1e-4 * before


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_wrong_model_leaves_what_the_ratio_of_the_two_says(factor):
    model = SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1)
    time = np.arange(3001) * 0.001
    z = 0.01 * np.sin(2 * np.pi * 20 * time)
    on = machine("hermite", Z=Axis(response=model))
    given = Motion(time=time, axes={"C": 7 * time, "X": 5 - 0.1 * time, "Z": z}, machine=on)
    real = track(precorrect(given, on), machine("hermite", Z=Axis(response=model.slower(factor))), chord=1)
    left = np.abs(real.axes["Z"] - z)[1000:2000].max()
    assert left == pytest.approx(0.01 * abs(model.slower(factor).at(20) / model.at(20) - 1), rel=2e-3)


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_each_log_leaves_less_of_what_the_model_got_wrong(factor):
    """A sine stays a sine: of its error a log leaves |1 - H_real/H|, whatever command it was taken with."""
    model = SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1)
    time = np.arange(3001) * 0.001
    z = 0.01 * np.sin(2 * np.pi * 30 * time)
    on = machine("hermite", Z=Axis(response=model))
    really = machine("hermite", Z=Axis(response=model.slower(factor)))
    given = Motion(time=time, axes={"C": 7 * time, "X": 5 - 0.1 * time, "Z": z}, machine=on)
    command, left = given, []
    for _ in range(4):
        log = z - track(command, really, chord=1).axes["Z"]
        left.append(np.abs(log[1200:1800]).max())
        command = precorrect(command, on, missed={"Z": log})
        assert (command.axes["X"] == given.axes["X"]).all()
    share = abs(1 - model.slower(factor).at(30) / model.at(30))
    assert share < 0.2
    assert np.array(left[1:]) / left[:-1] == pytest.approx(share, rel=0.02)


def test_uneven_blocks_are_corrected_too():
    axis = SecondOrder(frequency_hz=100, damping=0.7)
    on = machine("hermite", Z=Axis(response=axis))
    given = motion(on, points=801, irregular=True, seconds=0.8)
    before = np.abs(track(given, on, chord=1).axes["Z"] - given.axes["Z"])[200:-200].max()
    after = np.abs(track(precorrect(given, on, rounds=4), on, chord=1).axes["Z"] - given.axes["Z"])[200:-200].max()
    assert after < 0.01 * before


def test_beyond_its_bandwidth_nothing_is_corrected():
    axis = SecondOrder(frequency_hz=100, damping=0.7)
    on = machine("hermite", Z=Axis(response=axis))
    time = np.arange(2001) * 0.001
    given = Motion(
        time=time, axes={"C": 7 * time, "X": 5 - time, "Z": 0.01 * np.sin(2 * np.pi * 40 * time)}, machine=on
    )
    apart = np.abs(precorrect(given, on, bandwidth_hz=10, rounds=1).axes["Z"] - given.axes["Z"])[500:-500].max()
    # What is left comes from the ends of the program, half a second away: the axis misses 5.6e-3 mm of this motion.
    assert apart < 1e-6


def test_what_cannot_be_corrected_is_refused():
    given = motion(machine(), points=401)
    for words, change in (("bandwidth_hz", {"bandwidth_hz": 0.0}), ("rounds", {"rounds": 0})):
        with pytest.raises(InputError, match=words):
            precorrect(given, machine(), **change)
    for words, missed in (("the log has axis Y", {"Y": given.time}), ("time 401, Z 400", {"Z": given.time[1:]})):
        with pytest.raises(InputError, match=words):
            precorrect(given, missed=missed)
    with pytest.raises(LimitError, match="slows this motion down"):
        precorrect(given, machine(block_rate=400))
    with pytest.raises(InputError, match="chord"):
        track(given, chord=0.0)


@pytest.mark.parametrize("dead_time", [None, 0.002])
def test_c_that_swings_as_it_comes_to_rest_is_tracked(dead_time):
    """Oracle: SciPy's ODE solver, which follows the swing back past the end that a spindle angle may not show."""
    axis = Axis(response=SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1), dead_time=dead_time)
    machine = Machine(
        name="swing", axes={"C": axis, "X": Axis(), "Z": Axis()}, spindle_rpm=1000, block_rate_hz=5000,
        controller=Controller(interpolation="hermite"),
    )  # fmt: skip
    part, tool = Part(surface=Sphere(radius=50.0), radius=0.4), Tool(nose_radius=0.5)
    servo = SlowToolServo(feed=0.02, points_per_rev=72, spindle_rpm=600)
    motion = drive(place(servo.spiral(part, tool), part, tool), servo, machine)
    real = track(motion, chord=1e-9)
    assert (np.diff(real.axes["C"]) * motion.sense > 0).all()
    c, late = CubicHermiteSpline(motion.time, motion.axes["C"], motion.velocity["C"]), dead_time or 0.0
    omega, speed = 200 * np.pi, c.derivative()

    def pulls(t, q):
        t = max(t - late, 0.0)
        return q[1], 1.4 * omega * (speed(t) - q[1]) + omega**2 * (c(t) - q[0])

    made = solve_ivp(
        pulls, (0, motion.time[-1]), (c(0.0), 0.0), t_eval=real.time, rtol=1e-10, atol=1e-12, max_step=2e-3
    )
    assert (np.diff(made.y[0]) * motion.sense < 0).any()
    swing = motion.sense * (made.y[0] - made.y[0][-1])
    assert np.abs(made.y[0] - real.axes["C"]).max() < 1.1 * swing.max()


def test_c_that_swings_back_on_its_way_is_refused():
    axis = Axis(response=SecondOrder(frequency_hz=5, damping=0.02))
    machine = Machine(
        name="swing", axes={"C": axis, "X": Axis(), "Z": Axis()}, spindle_rpm=1000, block_rate_hz=5000,
        controller=Controller(interpolation="hermite"),
    )  # fmt: skip
    time = np.linspace(0, 1, 101)
    motion = Motion(
        time=time, axes={"C": 10 * np.minimum(time, 0.3) + 0.01 * time, "X": 5 - time, "Z": 0 * time}, machine=machine
    )
    with pytest.raises(LimitError, match=r"servo of C on swing turns back by .* rad"):
        track(motion)
