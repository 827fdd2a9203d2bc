"""Program text in bulk: numbers into bytes and bytes into numbers, tens of nanoseconds a block.

Only plain cutting blocks are read here. Anything else (another code, a comment that matters, a fault) is left to the
general reader in `turnwright.post`, which defines grammar and messages.
"""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit

__all__ = ["clock", "count_on", "feeds", "format_blocks", "pack", "parse_blocks", "quantise", "unwrap"]

U = np.uint64
# Places in text are counted without sign: then the compiler need not ask whether an index counts from the end.
ONE, TEN, HUNDRED, TEN_THOUSAND, HUNDRED_MILLION = U(1), U(10), U(100), U(10**4), U(10**8)
ZERO_SIGN, BITS, LONGEST, EXACT = U(48), U(8), U(18), U(2**53)
MARK = np.frombuffer(b"PASS:", dtype=np.uint8)
PVT = np.frombuffer(b"PVT", dtype=np.uint8)
COLON = 58

POWERS = 10.0 ** np.arange(19)
POWERS_U = U(10) ** np.arange(19, dtype=np.uint64)

# A feed with decimals to spare stands for a block's time to this part of it, and a run of blocks shares one feed within
# twice this much: together they stay below 1e-9.
FEED_ERROR = 2.5e-10
HALF = np.int64(0xFFFFFFFF)
BEHIND = 7  # letters behind a text that its reader looks at, for it takes eight at a time
LARGEST = 1e9  # mm or degrees: beyond any machine, and safe in 64 bits at 6 decimals

# What F, or PVT, means: a block's time in seconds, one over its minutes, or its milliseconds.
SECONDS, INVERSE_MINUTES, MILLISECONDS = range(3)

# Slots of the reader's state.
LINEAR, FEED_MODE, OPEN, FEED_UNIT, LINES, Y_SEEN = range(6)
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
def pack(rows, bits, packed):
    """Write what is hashed: each whole number modulo 2^32, then the two halves of the duration's bits combined."""
    last = rows.shape[1]
    for i in range(rows.shape[0]):
        for k in range(last):
            packed[i, k] = np.uint32(rows[i, k] & HALF)
        packed[i, last] = np.uint32((bits[i] ^ (bits[i] >> 32)) & HALF)


@jit
def check_steps(angle, factor, shift, half_turn, sign):
    """Return the first index whose rounded C step is not strictly inside (0, half a turn) in the given direction."""
    before = np.rint(angle[0] * factor + shift)
    for i in range(1, angle.size):
        current = np.rint(angle[i] * factor + shift)
        step = (current - before) * sign
        if step <= 0 or step >= half_turn:
            return i
        before = current
    return -1


@jit
def shortest(value, most):
    """Return (mantissa, decimals) of the decimal with the fewest places within FEED_ERROR of ``value``, or with most.

    ``most`` is below 18.
    """
    for places in range(most):
        scaled = value * POWERS[places]
        mantissa = np.rint(scaled)
        if mantissa > 0 and abs(mantissa - scaled) <= FEED_ERROR * scaled:
            return np.int64(mantissa), np.int64(places)
    return np.int64(np.rint(value * POWERS[most])), np.int64(most)


@jit
def seconds(feed, unit):
    """Return how long a block lasts by its feed word. [s]."""
    if unit == INVERSE_MINUTES:
        return 60.0 / feed
    return feed * 1e-3 if unit == MILLISECONDS else feed


@jit
def feeds(time, start, stop, unit, every, most, state, mantissa, places, duration):
    """Choose the feed word, in its unit, of the blocks that end at points ``start`` to ``stop`` - 1 (start >= 1).

    It has ``most`` decimals at most, and where these are too few it is wrong by up to half of the last.
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
            stated = 60.0 / mean if unit == INVERSE_MINUTES else mean * 1e3 if unit == MILLISECONDS else mean
            digits, shift = shortest(stated, most)
            fresh = every or digits != state[1] or shift != state[2]
            state[0], state[1], state[2] = j, digits, shift
        written = state[1] / POWERS[state[2]]
        duration[k] = seconds(written, unit)
        places[k] = state[2]
        mantissa[k] = state[1] if fresh or every else 0
    return -1


@jit
def write_digits(out, at, end, number):
    """Write a number >= 0 with leading zeros from ``at`` to ``end``; return the end."""
    write = end
    while write > at:
        quotient = number // TEN
        write -= ONE
        out[write] = np.uint8(ZERO_SIGN + (number - quotient * TEN))
        number = quotient
    return end


@jit
def write_whole(out, at, number):
    """Write a whole number >= 0 without leading zeros; return where it ends."""
    count = ONE
    while count < LONGEST and number >= POWERS_U[count]:
        count += ONE
    return write_digits(out, at, at + count, number)


@jit
def eight_digits(number):
    """Return the eight digits of a number below 10^8 as bytes, the first one lowest.

    All digits at once: two lanes of four digits, then four of two, then eight of one; x * 10486 >> 20 is x // 100 for
    x < 10^4, and x * 103 >> 10 is x // 10 for x < 100.
    """
    high = number // TEN_THOUSAND
    lanes = high | ((number - high * TEN_THOUSAND) << U(32))
    upper = ((lanes * U(10486)) >> U(20)) & U(0x0000007F0000007F)
    lanes = upper | ((lanes - upper * HUNDRED) << U(16))
    upper = ((lanes * U(103)) >> U(10)) & U(0x000F000F000F000F)
    return upper | ((lanes - upper * TEN) << BITS) | U(0x3030303030303030)


@jit
def write_eight(out, at, letters):
    """Write eight bytes; written out, so that the compiler makes one store of them."""
    out[at] = np.uint8(letters)
    out[at + ONE] = np.uint8(letters >> U(8))
    out[at + U(2)] = np.uint8(letters >> U(16))
    out[at + U(3)] = np.uint8(letters >> U(24))
    out[at + U(4)] = np.uint8(letters >> U(32))
    out[at + U(5)] = np.uint8(letters >> U(40))
    out[at + U(6)] = np.uint8(letters >> U(48))
    out[at + U(7)] = np.uint8(letters >> U(56))


@jit
def write_fixed(out, at, units, places):
    """Write units / 10^places in fixed point; zero has no sign because integers have no negative zero."""
    if units < 0:
        out[at] = 45
        at += ONE
        units = -units
    number = U(units)
    if places == 0:
        return write_whole(out, at, number)
    scale = POWERS_U[places]
    integer = number // scale
    at = write_whole(out, at, integer)
    out[at] = 46
    at += ONE
    return write_digits(out, at, at + U(places), number - integer * scale)


@jit
def format_blocks(rows, letters, decimals, prefix, leading, mantissa, places, out):
    """Write one line per row: prefix, one word per letter, and the feed where its mantissa is not 0.

    A colon as a letter makes a column the velocity that belongs to the word before it. Letters in ``leading`` are those
    of a feed that has a line of its own, before; otherwise it is an F behind. Returns the number of bytes; ``out``
    needs 7 more.
    """
    at = U(0)
    word, after = U(0), U(0)  # the last feed word: one that repeats is copied
    digits, shift = np.int64(0), np.int64(0)
    for i in range(rows.shape[0]):
        if leading.size > 0 and mantissa[i] > 0:
            for k in range(leading.size):
                out[at] = leading[k]
                at += ONE
            at = write_fixed(out, at, mantissa[i], places[i])
            out[at] = 10
            at += ONE
        for k in range(prefix.size):
            out[at] = prefix[k]
            at += ONE
        for k in range(letters.size):
            if k > 0 and letters[k] != COLON:
                out[at] = 32
                at += ONE
            out[at] = letters[k]
            at += ONE
            units, shown = rows[i, k], decimals[k]
            number = U(abs(units))
            if number >= HUNDRED_MILLION or shown < 5 or shown > 6:
                at = write_fixed(out, at, units, shown)
                continue
            # The common case, in line and eight bytes at a time: the bytes too many are overwritten by what follows.
            out[at] = 45
            at += U(units < 0)
            ascii_digits = eight_digits(number)
            integer_digits = U(8 - shown)  # two or three digits, of which leading zeros are shifted out
            scale = POWERS_U[shown]
            zeros = integer_digits - ONE - U(number >= scale * TEN) - U(number >= scale * HUNDRED)
            write_eight(out, at, ascii_digits >> (zeros * BITS))
            at += integer_digits - zeros
            out[at] = 46
            write_eight(out, at + ONE, ascii_digits >> (integer_digits * BITS))
            at += ONE + U(shown)
        if mantissa[i] > 0 and leading.size == 0:
            if mantissa[i] == digits and places[i] == shift:
                for k in range(after - word):
                    out[at + U(k)] = out[word + U(k)]
                at += after - word
            else:
                digits, shift, word = mantissa[i], places[i], at
                out[at] = 32
                out[at + ONE] = 70
                after = write_fixed(out, at + U(2), digits, shift)
                at = after
        out[at] = 10
        at += ONE
    return np.int64(at)


@jit
def run_of_digits(data, at):
    """Return the number that digits make from ``at`` on, and how many they are: a number only if they are 18 or less.

    Eight letters at a time: each byte's highest bit is set in ``other`` where it is no digit, and what stands before
    the lowest of these is moved up to the end of the word, over zeros.
    """
    number, count = U(0), U(0)
    while True:
        word = (
            U(data[at])
            | U(data[at + ONE]) << U(8)
            | U(data[at + U(2)]) << U(16)
            | U(data[at + U(3)]) << U(24)
            | U(data[at + U(4)]) << U(32)
            | U(data[at + U(5)]) << U(40)
            | U(data[at + U(6)]) << U(48)
            | U(data[at + U(7)]) << U(56)
        ) ^ U(0x3030303030303030)
        other = (((word & U(0x7F7F7F7F7F7F7F7F)) + U(0x7676767676767676)) | word) & U(0x8080808080808080)
        # The ones below the lowest bit of ``other``: one in each byte up to its own.
        below = (((other - ONE) & ~other & U(0x0101010101010101)) * U(0x0101010101010101)) >> U(56)
        digit_count = U(8) if other == U(0) else below - ONE
        if digit_count == U(0):
            return number, count
        word <<= (U(8) - digit_count) * BITS
        word = (word * TEN + (word >> U(8))) & U(0x00FF00FF00FF00FF)
        word = (word * HUNDRED + (word >> U(16))) & U(0x0000FFFF0000FFFF)
        word = (word * TEN_THOUSAND + (word >> U(32))) & U(0xFFFFFFFF)
        number = number * POWERS_U[digit_count] + word
        count += digit_count
        if digit_count < U(8):
            return number, count
        at += U(8)


@jit
def number_at(data, at):
    """Return the fixed-point number that stands at a place, nan if none does, and where it ends."""
    negative = data[at] == 45
    if negative or data[at] == 43:
        at += ONE
    mantissa, digits = run_of_digits(data, at)
    at += digits
    fraction = U(0)
    if data[at] == 46:
        part, fraction = run_of_digits(data, at + ONE)
        at += ONE + fraction
        digits += fraction
        mantissa = mantissa * POWERS_U[min(fraction, U(18))] + part
    if digits == U(0) or digits > U(17) or mantissa > EXACT:
        return np.nan, at
    value = np.float64(np.int64(mantissa)) / POWERS[fraction]
    return -value if negative else value, at


@jit
def parse_rows(data, end, out):
    """Fill ``out`` (rows, columns) with lines of fixed-point numbers between commas; return how many were plain.

    ``data`` is text with BEHIND letters more after its ``end``. The first line that is anything else ends the work.
    """
    rows, columns = out.shape
    at, stop = U(0), U(end)
    for row in range(rows):
        for column in range(columns):
            value, at = number_at(data, at)
            mark = 10 if column == columns - 1 else 44
            if at >= stop or data[at] != mark or np.isnan(value):
                return row
            out[row, column] = value
            at += ONE
    return rows if at == stop else rows - 1


@jit
def parse_blocks(data, at, end, whole, real, out, first):
    """Read plain cutting blocks until something else follows.

    Parameters
    ----------
    data, at, end
        Text, where to begin (at the start of a line), and its end (just after a newline);
        BEHIND letters more follow it.
    whole, real
        The state of the reader, updated: see the slots above. A position not yet known is nan.
    out, first
        (5, rows): C [deg], X, Y, Z [mm], duration [s] of each block read, from column ``first`` on. Y is left alone
        where the program has none. With four rows more, words may state velocities, and these are filled with them, in
        the order of the axes and with 0 where there is none. [deg/s, mm/s]

    Returns
    -------
    at, last
        Start of the line that was not taken (``end`` if all were), and the column after the last one written.
    """
    n = first
    limit = out.shape[1]
    c0, x0, y0, z0, f0 = real[AT_C], real[AT_X], real[AT_Y], real[AT_Z], real[FEED]
    linear, mode, unit, has_y = whole[LINEAR] == 1, whole[FEED_MODE], whole[FEED_UNIT], whole[Y_SEEN] == 1
    fast = out.shape[0] > 5
    cutting = linear and whole[OPEN] == 1
    lines = 0
    line = U(at)
    stop = U(end)
    while line < stop and n < limit:
        i = line
        c, x, y, z, f = c0, x0, y0, z0, f0
        c_rate, x_rate, y_rate, z_rate = 0.0, 0.0, 0.0, 0.0
        seen = 0
        plain = True
        while True:
            b = data[i]
            if b <= 32:
                if b == 10:
                    break
                if b == 32 or 9 <= b <= 12 or (b == 13 and data[i + ONE] == 10):
                    i += ONE
                    continue
                plain = False
                break
            if b >= 97:
                b -= 32
            if b == 67:
                slot = 1
            elif b == 88:
                slot = 2
            elif b == 90:
                slot = 4
            elif b == 70 and not fast:  # with curves that state their own times, F has another meaning
                slot = 8
            elif b == 89:
                slot = 16
            elif b == 71:
                slot = 32
            elif b == 78:
                slot = 64
            elif b == 59:  # ; comment, or one in brackets, which is looked at
                i += ONE
                while data[i] == 32:
                    i += ONE
                if data[i] == 40:
                    continue
                while data[i] != 10:
                    plain = plain and (data[i] != 13 or data[i + ONE] == 10)
                    i += ONE
                break
            elif b == 80 and fast and linear and mode == 93 and seen == 0:
                slot = 8
                for k in range(3):
                    plain = plain and data[i + U(k)] == PVT[k]
                if not plain:
                    break
                i += U(2)
            elif b == 40:  # ( comment )
                i += ONE
                while data[i] == 32:
                    i += ONE
                # "PASS:" names the cut that follows; the comparison stops at a newline and so inside the text.
                named = True
                for k in range(5):
                    if data[i + U(k)] != MARK[k]:
                        named = False
                        break
                while data[i] != 41 and data[i] != 10:
                    i += ONE
                if named or data[i] == 10:
                    plain = False
                    break
                i += ONE
                continue
            else:
                plain = False
                break
            i += ONE
            while data[i] == 32:
                i += ONE
            # As in `number_at`, written out: the call costs a tenth of the time of reading.
            negative = data[i] == 45
            if negative or data[i] == 43:
                i += ONE
            mantissa, digits = run_of_digits(data, i)
            i += digits
            fraction = U(0)
            if data[i] == 46:
                part, fraction = run_of_digits(data, i + ONE)
                i += ONE + fraction
                digits += fraction
                mantissa = mantissa * POWERS_U[min(fraction, U(18))] + part
            # A mantissa up to 2^53 over a power of ten up to 10^17 < 10^22 is the correctly rounded number.
            if digits == U(0) or digits > U(17) or mantissa > EXACT:
                plain = False
                break
            value = np.float64(np.int64(mantissa)) / POWERS[fraction]
            if value > LARGEST:
                plain = False
                break
            if negative:
                value = -value
            if slot <= 16:
                if seen & slot:
                    plain = False
                    break
                seen |= slot
                rate = 0.0
                if data[i] == COLON and fast and slot != 8:
                    rate, i = number_at(data, i + ONE)
                    if not abs(rate) <= LARGEST:
                        plain = False
                        break
                if slot == 1:
                    c, c_rate = value, rate
                elif slot == 2:
                    x, x_rate = value, rate
                elif slot == 4:
                    z, z_rate = value, rate
                elif slot == 8:
                    f = value
                else:
                    y, y_rate = value, rate
            elif slot == 32 and not (value == 1 and linear) and value != mode and value != 90:
                plain = False
                break
        if not plain:
            break
        if seen & 23:  # an axis moves
            turn = c - c0
            if not cutting or turn == 0 or not f > 0 or (seen & 16 and not has_y):
                break
            if mode == 93:
                duration = seconds(f, unit)
            else:
                dx, dy, dz = x - x0, y - y0 if has_y else 0.0, z - z0
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                duration = 60.0 * (length if length > 0 else abs(turn)) / f
            out[0, n] = c
            out[1, n] = x
            if has_y:
                out[2, n] = y
            out[3, n] = z
            out[4, n] = duration
            if fast:
                out[5, n], out[6, n], out[7, n], out[8, n] = c_rate, x_rate, y_rate, z_rate
            n += 1
        c0, x0, y0, z0, f0 = c, x, y, z, f
        lines += 1
        line = i + ONE
    real[AT_C], real[AT_X], real[AT_Y], real[AT_Z], real[FEED] = c0, x0, y0, z0, f0
    whole[LINES] += lines
    return np.int64(line), n


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
        current = degrees[i]
        jump = np.rint((current - before) / 360.0)
        step = (current - before) - 360.0 * jump
        if step == 0 or abs(step) == 180.0 or step * sign < 0:
            return i
        sign = step
        turns -= jump
        degrees[i] = current + 360.0 * turns
        before = current
    return -1


@jit
def count_on(degrees, first):
    """Move a C that counts on by whole turns in place, to near ``first``; return the first unclean step, or -1.

    A step is unclean if it is none or has the other sense; then nothing is moved.
    """
    sign = 0.0
    for i in range(1, degrees.size):
        step = degrees[i] - degrees[i - 1]
        if step == 0 or step * sign < 0:
            return i
        sign = step
    degrees += 360.0 * np.rint((first - degrees[0]) / 360.0)
    return -1


@jit
def clock(duration):
    """Sum durations to times in place; runs of equal ones are multiplied, so that millions of them do not drift."""
    base = 0.0
    lost = 0.0
    run = 0
    value = 0.0
    duration[0] = 0.0
    for i in range(1, duration.size):
        if duration[i] != value:
            # The finished run goes into the base, and the part that the addition loses is accumulated.
            term = run * value - lost
            total = base + term
            lost = (total - base) - term
            base = total
            run = 0
            value = duration[i]
        run += 1
        duration[i] = base + (run * value - lost)
