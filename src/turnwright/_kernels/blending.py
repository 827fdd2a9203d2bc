"""How LinuxCNC 2.9 plays straight blocks with a rotary axis: one servo cycle after the other, block blended into block.

A block accelerates from rest and would stop at its end. While it slows down, the next one starts, and both movements
add up. See the theory of tracking.
"""

import numpy as np

from turnwright._kernels import jit_exact

SAME_SPEED = 1e-8  # speeds that count as equal [mm/s or deg/s along the block]
AT_END = 1e-12  # distance, and time, that count as none


@jit_exact
def advance(done, speed, length, wanted, acceleration, cycle, period):
    """Move along a block for one cycle.

    Returned are the distance done, the speed, whether it slows down to its end, whether it ends within less than the
    next ``period``, and how long it then takes.
    """
    remaining = length - done
    half = 0.5 * acceleration * cycle
    under = acceleration * (2.0 * remaining - speed * cycle)
    stopping = -half
    if under > 0.0:
        stopping += np.sqrt(under + half * half)
    change = (min(stopping, wanted) - speed) / cycle
    change = min(max(change, -acceleration), acceleration)
    after = speed + change * cycle
    if after < 0.0:
        after = 0.0
        if remaining < speed * cycle:
            done = length
    else:
        done = min(max(done + 0.5 * (speed + after) * cycle, 0.0), length)
    slows = abs(stopping - after) < SAME_SPEED and change < 0.0
    remaining = length - done
    if remaining <= AT_END:
        return length, after, slows, True, 0.0
    mean = 0.5 * after
    if mean <= SAME_SPEED:
        return done, after, slows, False, period
    seconds = remaining / mean
    needed = -after / seconds
    if abs(needed) > acceleration:
        limited = acceleration if needed > 0.0 else -acceleration
        square = (after / limited) ** 2 + 2.0 / limited * remaining
        if square < 0.0:
            return done, after, slows, False, period
        root = np.sqrt(square)
        seconds = -after / limited + (root if limited > 0.0 else -root)
    if seconds < AT_END:
        return length, after, slows, True, 0.0
    if seconds < period:
        return done, after, slows, True, seconds
    return done, after, slows, False, period


@jit_exact
def play(length, wanted, acceleration, period, block, share, next_share):
    """Play all blocks; return the number of cycles.

    ``length``, ``wanted`` speed and ``acceleration`` are those of each block along itself. Filled in for each cycle are
    the block, and which share of it and of the next one is done; arrays of size 0 only count.
    """
    count, last = 0, length.size - 1
    at, done, speed, ends, blends = 0, 0.0, 0.0, False, False
    next_done, next_speed, next_ends, next_cycle = 0.0, 0.0, False, period
    while at <= last:
        ended = ends
        if ends:
            done = length[at]
        else:
            done, speed, slows, ends, _ = advance(done, speed, length[at], wanted[at], acceleration[at], period, period)
            if at < last:
                # The last block has no successor, and half of its length counts for its speed.
                reach = length[at + 1] if at + 1 < last else 0.5 * length[at + 1]
                top = min(np.sqrt(acceleration[at] * length[at]), wanted[at])
                next_top = min(np.sqrt(acceleration[at + 1] * reach), wanted[at + 1])
                speeding = max(top / acceleration[at], next_top / acceleration[at + 1])
                seconds = min(length[at] / top, length[at + 1] / next_top, speeding)
                blends = blends or (slows and speed < min(top, seconds * acceleration[at]))
        if at < last and (ended or blends):
            next_done, next_speed, _, next_ends, next_cycle = advance(
                next_done, next_speed, length[at + 1], wanted[at + 1], acceleration[at + 1],
                next_cycle if next_ends else period, period,
            )  # fmt: skip
        if block.size:
            block[count] = at
            share[count] = done / length[at]
            next_share[count] = next_done / length[at + 1] if at < last else 0.0
        count += 1
        if ended:
            at += 1
            done, speed, ends, blends = next_done, next_speed, next_ends, False
            next_done, next_speed, next_ends, next_cycle = 0.0, 0.0, False, period
    return count
