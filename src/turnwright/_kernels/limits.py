"""Peaks of the divided differences of one axis."""

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
def shortest(time):
    """Return the number of the shortest block (the point it ends at) and its magnitude."""
    at, least = 0, np.inf
    for i in range(1, time.size):
        step = abs(time[i] - time[i - 1])
        if step < least:
            at, least = i, step
    return at, least
