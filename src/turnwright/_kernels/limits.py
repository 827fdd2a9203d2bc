"""Peaks of the motion of one axis, of its divided differences or of its cubics, and how straight it is."""

import numpy as np

from turnwright._kernels import jit


@jit
def peaks(time, position, value, place):
    """Find the largest speed, acceleration and jerk of an axis, by divided differences over 1, 2 and 3 blocks.

    They are exact where the position is a polynomial of that degree in time, whatever the steps.

    time, position (n,); ``value`` (5,) takes lowest, highest, speed, acceleration and jerk, ``place`` (5,) int64 the
    number of the point each is found at.
    """
    value[0], value[1] = position[0], position[0]
    value[2:] = 0.0
    place[:] = 0
    old_speed, old_acceleration = 0.0, 0.0
    for i in range(time.size):
        if position[i] < value[0]:
            value[0], place[0] = position[i], i
        if position[i] > value[1]:
            value[1], place[1] = position[i], i
        if i == 0:
            continue
        speed = (position[i] - position[i - 1]) / (time[i] - time[i - 1])
        if abs(speed) > value[2]:
            value[2], place[2] = abs(speed), i
        if i > 1:
            acceleration = 2.0 * (speed - old_speed) / (time[i] - time[i - 2])
            if abs(acceleration) > value[3]:
                value[3], place[3] = abs(acceleration), i - 1
            if i > 2:
                jerk = 3.0 * (acceleration - old_acceleration) / (time[i] - time[i - 3])
                if abs(jerk) > value[4]:
                    value[4], place[4] = abs(jerk), i - 1
            old_acceleration = acceleration
        old_speed = speed


@jit
def cubic_peaks(time, position, velocity, value, place):
    """Find the range of an axis that moves by cubics, and its largest speed, acceleration and jerk, in closed form.

    The acceleration of a block is a straight line from ``first`` to ``last``; the speed is largest at an end or where
    that passes zero, the position extreme at an end or where the speed does. Arrays as in `peaks`, velocity (n,).
    """
    low, high, top_speed, top_acceleration, top_jerk = position[0], position[0], abs(velocity[0]), 0.0, 0.0
    place[:] = 0
    for i in range(1, time.size):
        step = time[i] - time[i - 1]
        rate = 1.0 / step  # one division instead of four
        begin, end = velocity[i - 1], velocity[i]
        mean = (position[i] - position[i - 1]) * rate
        first = (6.0 * mean - 4.0 * begin - 2.0 * end) * rate
        last = (2.0 * begin + 4.0 * end - 6.0 * mean) * rate
        jerk = (last - first) * rate
        if position[i] < low:
            low, place[0] = position[i], i
        if position[i] > high:
            high, place[1] = position[i], i
        between = begin
        if first * last < 0.0:
            between = begin + first * first * step / (2.0 * (first - last))
            if abs(between) > top_speed:
                top_speed, place[2] = abs(between), i
        if abs(end) > top_speed:
            top_speed, place[2] = abs(end), i
        if abs(first) > top_acceleration:
            top_acceleration, place[3] = abs(first), i - 1
        if abs(last) > top_acceleration:
            top_acceleration, place[3] = abs(last), i
        if abs(jerk) > top_jerk:
            top_jerk, place[4] = abs(jerk), i
        if begin * end < 0.0 or begin * between < 0.0 or end * between < 0.0:
            inside = first * first - 2.0 * jerk * begin
            if inside <= 0.0:
                continue
            # Both times at which the speed is zero, without a difference of two nearly equal numbers.
            half = -(first + np.copysign(np.sqrt(inside), first))
            for upper, lower in ((half, jerk), (2.0 * begin, half)):
                if lower == 0.0:
                    continue
                at = upper / lower
                if 0.0 < at < step:
                    there = position[i - 1] + at * (begin + at * (first / 2.0 + at * jerk / 6.0))
                    if there < low:
                        low, place[0] = there, i
                    if there > high:
                        high, place[1] = there, i
    value[0], value[1], value[2], value[3], value[4] = low, high, top_speed, top_acceleration, top_jerk


@jit
def shortest(time):
    """Return the number of the shortest block (the point it ends at) and its magnitude."""
    at, least = 0, np.inf
    for i in range(1, time.size):
        step = abs(time[i] - time[i - 1])
        if step < least:
            at, least = i, step
    return at, least


@jit
def stride_error(time, position, stride):
    """Return the largest error of a polyline through every ``stride``-th sample and the last. time, position (n,)."""
    n, most = time.size, 0.0
    for first in range(0, n - 1, stride):
        last = min(first + stride, n - 1)
        slope = (position[last] - position[first]) / (time[last] - time[first])
        for j in range(first + 1, last):
            most = max(most, abs(position[first] + slope * (time[j] - time[first]) - position[j]))
    return most
