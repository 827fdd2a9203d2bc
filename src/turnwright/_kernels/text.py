"""Program text in bulk: numbers into bytes and bytes into numbers, tens of nanoseconds a block.

Only plain cutting blocks are read here. Anything else (another code, a comment that matters, a fault) is left where
it stands for the patient reader in `turnwright.post`, which is the one authority on grammar and messages.
"""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit

__all__ = ["clock", "feeds", "format_blocks", "parse_blocks", "quantise", "unwrap"]

POWERS = 10.0 ** np.arange(19)
INT_POWERS = 10 ** np.arange(19, dtype=np.int64)
PAIRS = np.array([[48 + i // 10, 48 + i % 10] for i in range(100)], dtype=np.uint8)

# A feed stands for a block's time to this part of it, and a run of blocks shares one feed within twice this much:
# together they stay below the 1e-9 that the header promises.
FEED_ERROR = 2.5e-10
LARGEST = 1e9  # mm or degrees: beyond any machine, and safe in 64 bits at 6 decimals

# Slots of the reader's state.
LINEAR, FEED_MODE, OPEN, INVERSE, LINES, Y_SEEN = range(6)
AT_C, AT_X, AT_Y, AT_Z, FEED = range(5)


@jit
def quantise(values, factor, shift, wrap, rows, column):
    """Write round(values * factor + shift) into a column of rows, modulo ``wrap`` units if that is above 0."""
    for i in range(values.size):
        units = np.int64(np.rint(values[i] * factor + shift))
        if wrap > 0:
            units %= wrap
        rows[i, column] = units


@jit
def check_steps(angle, factor, shift, half_turn, sign):
    """Return the first index whose rounded C step is not strictly inside (0, half a turn) in the given direction."""
    before = np.rint(angle[0] * factor + shift)
    for i in range(1, angle.size):
        here = np.rint(angle[i] * factor + shift)
        step = (here - before) * sign
        if step <= 0 or step >= half_turn:
            return i
        before = here
    return -1


@jit
def shortest(value):
    """Return (mantissa, decimals) of the decimal with the fewest places within FEED_ERROR of ``value``."""
    for places in range(18):
        scaled = value * POWERS[places]
        mantissa = np.rint(scaled)
        if mantissa > 0 and abs(mantissa - scaled) <= FEED_ERROR * scaled:
            return np.int64(mantissa), np.int64(places)
    return np.int64(np.rint(value * POWERS[17])), np.int64(17)


@jit
def feeds(time, start, stop, inverse, every, state, mantissa, places, duration):
    """Choose the feed word of the blocks that end at points ``start`` to ``stop`` - 1 (start >= 1).

    ``state`` carries [end of the run of equal blocks, mantissa, places] from one call to the next. A mantissa of 0 in
    the output is a feed that stays in force and is not written. Returns the first block too short or too long, or -1.
    """
    for i in range(start, stop):
        k = i - start
        span = time[i] - time[i - 1]
        if not 1e-6 <= span <= 1e4:
            return i
        fresh = i >= state[0]
        if fresh:
            # Look ahead: the run's mean is free of the rounding that single differences of a long time carry.
            j = i + 1
            while j < time.size:
                slack = 2 * FEED_ERROR * span + 8 * 2.3e-16 * abs(time[j])
                if abs((time[j] - time[j - 1]) - span) > slack:
                    break
                j += 1
            mean = (time[j - 1] - time[i - 1]) / (j - i)
            digits, shift = shortest(60.0 / mean if inverse else mean)
            fresh = every or digits != state[1] or shift != state[2]
            state[0], state[1], state[2] = j, digits, shift
        written = state[1] / POWERS[state[2]]
        duration[k] = 60.0 / written if inverse else written
        places[k] = state[2]
        mantissa[k] = state[1] if fresh or every else 0
    return -1


@jit
def write_whole(out, at, number):
    """Write a whole number >= 0 without leading zeros; return where it ends."""
    count = 1
    while count < 18 and number >= INT_POWERS[count]:
        count += 1
    end = at + count
    write = end
    while number >= 100:
        rest = number // 100
        pair = number - rest * 100
        write -= 2
        out[write] = PAIRS[pair, 0]
        out[write + 1] = PAIRS[pair, 1]
        number = rest
    if number >= 10:
        out[at] = PAIRS[number, 0]
        out[at + 1] = PAIRS[number, 1]
    else:
        out[at] = 48 + number
    return end


@jit
def write_fixed(out, at, units, places):
    """Write units / 10^places in fixed point; zero has no sign because integers have no negative zero."""
    if units < 0:
        out[at] = 45
        at += 1
        units = -units
    if places == 0:
        return write_whole(out, at, units)
    scale = INT_POWERS[places]
    whole = units // scale
    part = units - whole * scale
    at = write_whole(out, at, whole)
    out[at] = 46
    end = at + 1 + places
    write = end
    for _ in range(places // 2):
        rest = part // 100
        pair = part - rest * 100
        write -= 2
        out[write] = PAIRS[pair, 0]
        out[write + 1] = PAIRS[pair, 1]
        part = rest
    if places % 2:
        out[at + 1] = 48 + part
    return end


@jit
def format_blocks(rows, letters, decimals, prefix, mantissa, places, out):
    """Write one line per row: prefix, one word per letter, and the feed where its mantissa is not 0. Returns bytes."""
    at = 0
    for i in range(rows.shape[0]):
        for k in range(prefix.size):
            out[at] = prefix[k]
            at += 1
        for k in range(letters.size):
            if k > 0:
                out[at] = 32
                at += 1
            out[at] = letters[k]
            at = write_fixed(out, at + 1, rows[i, k], decimals[k])
        if mantissa[i] > 0:
            out[at] = 32
            out[at + 1] = 70
            at = write_fixed(out, at + 2, mantissa[i], places[i])
        out[at] = 10
        at += 1
    return at


@jit
def parse_blocks(data, at, end, whole, real, out):
    """Read plain cutting blocks until something else stands in the way.

    Parameters
    ----------
    data, at, end
        Text, where to begin (at the start of a line), and its end (just after a newline).
    whole, real
        The state of the reader, updated: see the slots above. A position not yet known is nan.
    out
        (rows, 5): C [deg], X, Y, Z [mm], duration [s] of each block read.

    Returns
    -------
    at, count
        Start of the line that was not taken (``end`` if all were), and the number of blocks read.
    """
    n = 0
    limit = out.shape[0]
    new = np.empty(5)
    while at < end and n < limit:
        i = at
        for k in range(5):
            new[k] = real[k]
        moves = False
        y_word = False
        seen = 0
        plain = True
        while True:
            b = data[i]
            if b == 10:
                break
            if b == 32 or 9 <= b <= 13:
                i += 1
                continue
            if b == 59:  # ; comment
                while data[i] != 10:
                    i += 1
                break
            if b == 40:  # ( comment )
                i += 1
                while data[i] == 32:
                    i += 1
                # "PASS:" names the cut that follows; i + 5 stays inside because comparison stops at a newline.
                if (
                    data[i] == 80
                    and data[i + 1] == 65
                    and data[i + 2] == 83
                    and data[i + 3] == 83
                    and data[i + 4] == 58
                ):
                    plain = False
                    break
                while data[i] != 41 and data[i] != 10:
                    i += 1
                if data[i] == 10:
                    plain = False
                    break
                i += 1
                continue
            if b >= 97:
                b -= 32
            if b == 67:
                slot = 0
            elif b == 88:
                slot = 1
            elif b == 89:
                slot = 2
            elif b == 90:
                slot = 3
            elif b == 70:
                slot = 4
            elif b == 71:
                slot = 5
            elif b == 78:
                slot = 6
            else:
                plain = False
                break
            i += 1
            while data[i] == 32:
                i += 1
            negative = False
            if data[i] == 45:
                negative = True
                i += 1
            elif data[i] == 43:
                i += 1
            mantissa = np.int64(0)
            digits = 0
            fraction = 0
            while data[i] >= 48 and data[i] <= 57:
                mantissa = mantissa * 10 + (data[i] - 48)
                digits += 1
                i += 1
                if digits > 17:
                    break
            if data[i] == 46 and digits <= 17:
                i += 1
                while data[i] >= 48 and data[i] <= 57:
                    mantissa = mantissa * 10 + (data[i] - 48)
                    digits += 1
                    fraction += 1
                    i += 1
                    if digits > 17:
                        break
            # A mantissa below 2^53 over a power of ten up to 10^17 < 10^22 is the correctly rounded number.
            if digits == 0 or digits > 17 or mantissa > 9007199254740992:
                plain = False
                break
            value = mantissa / POWERS[fraction]
            if value > LARGEST:
                plain = False
                break
            if negative:
                value = -value
            if slot < 5:
                if (seen >> slot) & 1:
                    plain = False
                    break
                seen |= 1 << slot
                new[slot] = value
                if slot < 4:
                    moves = True
                    if slot == 2:
                        y_word = True
            elif slot == 5 and not (value == 1 and whole[LINEAR] == 1) and value != whole[FEED_MODE] and value != 90:
                plain = False
                break
        if not plain:
            break
        if moves:
            turn = new[AT_C] - real[AT_C]
            feed = new[FEED]
            if whole[OPEN] == 0 or whole[LINEAR] == 0 or turn == 0 or not feed > 0 or (y_word and whole[Y_SEEN] == 0):
                break
            if whole[FEED_MODE] == 93:
                duration = 60.0 / feed if whole[INVERSE] else feed
            else:
                dx = new[AT_X] - real[AT_X]
                dz = new[AT_Z] - real[AT_Z]
                dy = new[AT_Y] - real[AT_Y] if whole[Y_SEEN] else 0.0
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                duration = 60.0 * (length if length > 0 else abs(turn)) / feed
            for k in range(4):
                out[n, k] = new[k]
            out[n, 4] = duration
            n += 1
        for k in range(5):
            real[k] = new[k]
        whole[LINES] += 1
        at = i + 1
    return at, n


@jit
def unwrap(degrees, first):
    """Make C cumulative in place, ``first`` degrees being near its start; return the first unclean step, or -1.

    Every step counts as the one below half a turn, so a C that is cumulative already stays as it is. Whole turns are
    added to the number as written, so that nothing drifts.
    """
    turns = np.rint((first - degrees[0]) / 360.0)
    before = degrees[0]
    degrees[0] = before + 360.0 * turns
    sign = 0.0
    for i in range(1, degrees.size):
        here = degrees[i]
        jump = np.rint((here - before) / 360.0)
        step = (here - before) - 360.0 * jump
        if step == 0 or abs(step) == 180.0 or step * sign < 0:
            return i
        sign = step
        turns -= jump
        degrees[i] = here + 360.0 * turns
        before = here
    return -1


@jit
def clock(duration, time):
    """Sum durations to times; runs of equal ones are multiplied, so that millions of additions do not drift."""
    base = 0.0
    lost = 0.0
    run = 0
    value = 0.0
    time[0] = 0.0
    for i in range(1, duration.size):
        if duration[i] != value:
            # The finished run goes into the base, with the part that the addition loses kept beside it.
            term = run * value - lost
            total = base + term
            lost = (total - base) - term
            base = total
            run = 0
            value = duration[i]
        run += 1
        time[i] = base + (run * value - lost)
