"""The bulk number kernels. Oracles: decimal and fractions, exact; Python's own float()."""

from decimal import Decimal
from fractions import Fraction
from math import fsum

import numpy as np
import pytest

from turnwright._kernels import text


def formatted(units, places, mantissa=None, feed_places=None):
    """Lines that the kernel writes for one column."""
    rows = np.array(units, dtype=np.int64)[:, None]
    none = np.zeros(len(units), dtype=np.int64)
    out = np.empty(80 * len(units), dtype=np.uint8)
    size = text.format_blocks(
        rows,
        np.array([ord("X")]),
        np.array([places]),
        np.frombuffer(b"G1 ", dtype=np.uint8),
        np.frombuffer(b"", dtype=np.uint8),
        none if mantissa is None else np.array(mantissa, dtype=np.int64),
        none if feed_places is None else np.array(feed_places, dtype=np.int64),
        out,
    )
    return out[:size].tobytes().decode().splitlines()


@pytest.mark.parametrize("places", range(8))
def test_fixed_point_is_what_decimal_writes(places):
    random = np.random.default_rng(places)
    edges = [
        0,
        1,
        -1,
        9,
        10,
        99,
        100,
        101,
        10**places,
        -(10**places),
        10**places - 1,
        1 - 10**places,
        10**15,
        -(10**15),
    ]
    units = [*edges, *(int(v) for v in random.integers(-(10**9), 10**9, 500)), *(10**k for k in range(16))]
    expected = [f"G1 X{Decimal(v).scaleb(-places):.{places}f}" for v in units]
    assert formatted(units, places) == expected


def test_feed_is_fixed_point_and_left_out_where_it_stays():
    lines = formatted([5, 6, 7], 1, [1, 0, 123456], [3, 9, 5])
    assert lines == ["G1 X0.5 F0.001", "G1 X0.6", "G1 X0.7 F1.23456"]


def parse(block_text, *, feed=1.0, mode=93, inverse=False, position=(0.0, 0.0, np.nan, 0.0)):
    data = np.frombuffer(block_text.encode() + bytes(text.BEHIND), dtype=np.uint8)
    whole = np.array([1, mode, 1, inverse, 0, 0], dtype=np.int64)
    real = np.array([*position, feed])
    out = np.full((5, len(data)), np.nan)
    at, count = text.parse_blocks(data, 0, len(block_text), whole, real, out, 0)
    return at, out[:, :count].T, whole, real


def test_numbers_are_read_as_python_reads_them():
    random = np.random.default_rng(1)
    words = []
    for _ in range(3000):
        digits = str(random.integers(1, 10 ** random.integers(1, 16)))
        point = random.integers(0, min(len(digits), 8) + 1)
        number = digits[: len(digits) - point] + ("." + digits[len(digits) - point :] if point else "")
        if abs(float(number)) <= 1e9:
            words.append(random.choice(["", "-", "+"]) + number)
    block = "".join(f"C{k + 1} X{word} z {word}\r\n" for k, word in enumerate(words))
    at, rows, whole, _ = parse(block)
    assert at == len(block)
    assert whole[text.LINES] == len(words)
    assert (rows[:, 1] == [float(word) for word in words]).all()
    assert (rows[:, 3] == rows[:, 1]).all()


@pytest.mark.parametrize(
    "line",
    [
        "C1 X1e3",
        "C1 Xnan",
        "C1 X",
        "C1 X1.2.3",
        "C1 X1 X2",
        "C1 X9999999999",
        "C1 M8",
        "C1 (open",
        "G2 C1",
        "#1=2",
        "( PASS: a )",
        "C1 X--1",
        "C1 A3",
        "\x00",
        "C0",
        "G0 C1",
        "C1 F0",
        "M98(x.nc)",
        "C1 X1.00000000000000000000",
    ],
)
def test_whatever_is_not_a_plain_block_is_left_where_it_stands(line):
    good = "C0.5 X1\n"
    at, rows, _, real = parse(good + line.replace("C0", "C0.5") + "\n")
    assert at == len(good)
    assert len(rows) == 1
    assert real[text.AT_C] == 0.5


def test_comments_numbers_and_modal_words_are_followed():
    block = "n10 g1 c1.0 x2.0 ; first\n\n( a comment ) C2 (between) Z3\nN30G93G90F2.5\n;only\nC3\n"
    at, rows, _, _ = parse(block)
    assert at == len(block)
    assert np.nan_to_num(rows).tolist() == [[1, 2, 0, 0, 1.0], [2, 2, 0, 3, 1.0], [3, 2, 0, 3, 2.5]]


def test_inverse_time_and_length_feeds():
    _, rows, _, _ = parse("C1 F60000\nC2 F30000\n", inverse=True)
    assert rows[:, 4].tolist() == [0.001, 0.002]
    _, rows, _, _ = parse("C1 X3 Z4 F60\nC3\n", mode=94)  # 5 mm at 60 mm/min, then 2 deg at 60 deg/min
    assert rows[:, 4].tolist() == [5.0, 2.0]


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("start", [0.0, 12345.678])
@pytest.mark.parametrize("kind", ["constant", "odd constant", "varying", "two speeds"])
def test_time_rebuilt_from_feeds_is_right_to_1e9(inverse, start, kind):
    random = np.random.default_rng(3)
    count = 4000
    spans = {
        "constant": np.full(count, 0.001),
        "odd constant": np.full(count, 60 / 977.3),
        "varying": 10 ** random.uniform(-4, 1, count),
        "two speeds": np.repeat([0.001, 1 / 300], count // 2),
    }[kind]
    time = start + np.concatenate([[0.0], np.cumsum(spans)])
    mantissa, places = np.empty((2, count), dtype=np.int64)
    duration = np.empty(count)
    state = np.zeros(3, dtype=np.int64)
    for begin in range(1, count + 1, 700):  # in pieces, as the writer does
        stop = min(begin + 700, count + 1)
        part = slice(begin - 1, stop - 1)
        assert (
            text.feeds(time, begin, stop, inverse, False, 17, state, mantissa[part], places[part], duration[part]) == -1
        )
    clock, feed = Fraction(0), None
    for k in range(count):
        if mantissa[k]:
            feed = Fraction(int(mantissa[k]), 10 ** int(places[k]))
        clock += 60 / feed if inverse else feed
        elapsed = Fraction(float(time[k + 1])) - Fraction(float(time[0]))
        assert abs(clock - elapsed) <= Fraction(1, 10**9) * elapsed + Fraction(8 * np.spacing(time[k + 1]))
    written = int(np.count_nonzero(mantissa))
    assert written == {"constant": 1, "odd constant": 1, "two speeds": 2}.get(kind, written)
    if kind == "constant":
        assert (mantissa[0], places[0]) == ((60000, 0) if inverse else (1, 3))


@pytest.mark.parametrize("most", [4, 6, 9])
def test_a_feed_has_no_more_decimals_than_allowed(most):
    spans = np.random.default_rng(5).uniform(0.001, 0.02, 500)
    time = np.concatenate([[0.0], np.cumsum(spans)])
    mantissa, places = np.empty((2, 500), dtype=np.int64)
    duration, state = np.empty(500), np.zeros(3, dtype=np.int64)
    assert text.feeds(time, 1, 501, False, True, most, state, mantissa, places, duration) == -1
    assert places.max() <= most
    assert np.abs(duration - spans).max() <= 0.5001 * 10.0**-most


@pytest.mark.parametrize("span", [1e-7, 2e4, np.nan])
def test_blocks_too_short_or_too_long_are_named(span):
    time = np.array([0.0, 1.0, 1.0 + span])
    blank = np.zeros((2, 2), dtype=np.int64)
    assert text.feeds(time, 1, 3, False, False, 17, np.zeros(3, dtype=np.int64), blank[0], blank[1], np.zeros(2)) == 2


@pytest.mark.parametrize("span", [0.001, 0.1, 1 / 3])
def test_clock_does_not_drift(span):
    duration = np.full(2_000_000, span)
    duration[0] = 0.0
    duration[7::1000] *= 1.5
    time = duration.copy()
    text.clock(time)
    for at in (1, 999_999, 1_999_999):
        assert time[at] == pytest.approx(fsum(duration[: at + 1]), rel=1e-15)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("wrapped", [True, False])
@pytest.mark.parametrize("far", [False, True])
def test_unwrap_gives_back_the_turns(sense, wrapped, far):
    units = sense * np.cumsum(np.random.default_rng(5).integers(1, 17_999_999, 5000)) + 12_345
    degrees = (units % 36_000_000 if wrapped else units) / 1e5
    first = units[0] / 1e5 + (100 * 360 if far else 0)
    assert text.unwrap(degrees, first) == -1
    exact = (units + (100 * 36_000_000 if far else 0)) / 1e5
    assert np.abs(degrees - exact).max() <= 2 * np.spacing(np.abs(exact).max())


@pytest.mark.parametrize(
    ("c", "bad"), [([0, 180], 1), ([0, 1, 1], 2), ([0, 1, 361], 2), ([0, 1, 0.5], 2), ([0, -1, 1], 2)]
)
def test_unwrap_names_the_step_that_has_no_sense(c, bad):
    assert text.unwrap(np.array(c, dtype=float), 0.0) == bad
