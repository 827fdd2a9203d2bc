"""What programs of other sources have besides straight blocks. Oracles: RS-274/NGC's definitions, worked by hand."""

import time
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cases import every_second
from laws import examples
from turnwright.errors import ProgramError
from turnwright.machine import Axis, Controller, Machine
from turnwright.post import ProgramWarning, inspect_nc, read_nc


def machine(dialect="nanotech"):
    return Machine(
        name="lathe", axes=dict.fromkeys("CXYZ", Axis()), spindle_rpm=1000, block_rate_hz=1000, dialect=dialect,
        controller=Controller(interpolation="hermite" if dialect == "pmac" else "linear"),
    )  # fmt: skip


def read(folder, text, dialect="nanotech", **options):
    path = folder / "foreign.nc"
    path.write_text(text, newline="")
    return read_nc(path, machine(dialect), **options)


# ------------------------------------------------------------------------------------------ setting a coordinate
START = "G94 F100 Z1 X1\nC0\nG93 F0.01\nC1 X1 Z1\n"


def test_g92_at_the_start_says_where_the_program_counts_from(tmp_path):
    cut = read(tmp_path, "G28 X0 Z0\nG92 X0 Z5\nG94 G1 Z1 F100\nC0\nG93 F0.01\nC1 X0.1\nC2 X0.2\nM30\n")
    assert cut.axes["X"] == pytest.approx([0, 0.1, 0.2])
    assert cut.axes["Z"] == pytest.approx([1, 1, 1])


@pytest.mark.parametrize(("word", "shift"), [("X0", 1.0), ("X0.25", 0.75), ("Z-2", 3.0), ("Y1", -0.5)])
def test_g92_keeps_the_tool_where_it_stands(tmp_path, word, shift):
    """RS-274/NGC 3.5.18: the current point gets the coordinates stated; nothing moves."""
    letter, stated = word[0], float(word[1:])
    moves = "".join(f"C{k + 1} {letter}{stated + 0.1 * k:.3f}\n" for k in range(3))
    cut = read(tmp_path, f"G94 F100 Z1 X1 Y0.5\nC0\nG92 {word}\nG93 F0.01\n{moves}M30\n")
    assert cut.axes[letter] == pytest.approx(np.array([0, 0, 0.1, 0.2]) + stated + shift, abs=1e-12)
    for other in set("XYZ") - {letter}:
        assert cut.axes[other] == pytest.approx([{"X": 1, "Y": 0.5, "Z": 1}[other]] * 4)


@pytest.mark.parametrize("code", ["G92.1", "G92.2"])
def test_g92_is_cancelled(tmp_path, code):
    cut = read(tmp_path, f"G94 F100 Z1 X1\nC0\nG92 X0 C90\nX5\n{code}\nX1\nC0\nG93 F0.01\nC1\nC2 X0.9\nM30\n")
    assert np.rad2deg(cut.axes["C"]) == pytest.approx([0, 1, 2])
    assert cut.axes["X"] == pytest.approx([1, 1, 0.9])


@examples(60)
@given(seed=st.integers(0, 2**32), dialect=st.sampled_from(["nanotech", "generic"]))
def test_set_coordinates_do_not_change_the_motion(tmp_path_factory, seed, dialect):
    """The same places, written with and without random G92 before, within and after the cut."""
    random = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("g92")
    points = np.cumsum(random.uniform(1, 90, 12))[:, None] * [1.0, 0, 0, 0]
    points[:, 1:] = np.round(random.normal(0, 1, (12, 3)), 6)
    points[:, 0] = np.round(points[:, 0], 5)
    plain, shifted, shift = ["G94 G1 F100"], ["G94 G1 F100"], np.zeros(4)
    for k, point in enumerate(points):
        if k and random.random() < 0.4:
            words, letters = "", random.random(4) < 0.5
            letters[0] |= not letters.any()
            for j in np.flatnonzero(letters):
                stated = np.round(random.normal(0, 100), 4)
                shift[j] = stated - points[k - 1, j]
                words += f"{'CXYZ'[j]}{stated:.4f} "
            shifted.append(f"G92 {words}")
        for lines, numbers in ((plain, point), (shifted, point + shift)):
            words = " ".join(f"{letter}{value:.6f}" for letter, value in zip("CXYZ", numbers, strict=True))
            lines.append(f"{'G93 ' if k == 1 else ''}G1 {words}" + (f" F{60 + k}" if k else ""))
    motions = [read(folder, "\n".join([*lines, "M30\n"]), dialect) for lines in (plain, shifted)]
    for letter, values in motions[0].axes.items():
        difference = motions[1].axes[letter] - values
        if letter == "C":  # whole turns are a matter of counting
            difference -= 2 * np.pi * np.rint(difference[0] / (2 * np.pi))
        assert np.abs(difference).max() < 2e-6
    assert motions[1].time == pytest.approx(motions[0].time, rel=1e-6)


def test_a_c_that_is_set_back_after_each_turn_goes_on(tmp_path):
    rows = "".join(f"C{90 * k} X{2 - 0.1 * k - turn * 0.4:.3f}\n" + ("G92 C0\n" if k == 4 else "")
                   for turn in range(3) for k in range(1, 5))  # fmt: skip
    cut = read(tmp_path, f"G94 F100 X2 Z0\nC0\nG93 F0.1\n{rows}M30\n")
    assert np.rad2deg(cut.axes["C"]) == pytest.approx(90 * np.arange(13))


REFUSED = {
    "set after a place in machine coordinates": ("G28 X0\nG92 X0\n", "line 6 .*sets X"),
    "two meanings": ("G92 X1 Z1 F0.5\n", "line 5 .*thread"),
    "incremental": ("G92 U1\n", "line 5 has the word U"),
    "G50": ("G50 X0\n", "line 5 .*G50"),
    "local after set": ("G92 X0\nG52 X0\n", "line 6 .*G52"),
    "another work offset": ("G55\n", "line 5 .*G55"),
    "restored": ("G92.3\n", "line 5 has G92.3"),
    "home without words": ("G28\nC2\n", "no cutting block|position of"),
    "home by distances": ("C2\nG28 U0 W0\nG92 X1\n", "line 7 .*sets X"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_leave_the_place_unknown_is_refused(tmp_path, name):
    more, message = REFUSED[name]
    start = "G94 F100 Z1 X1\nC0\nX1.5\nG93 F0.01\n" if name == "home without words" else START
    with pytest.raises(ProgramError, match=message):
        read(tmp_path, start + more + "C5\nC6\nM30\n")


def test_a_speed_limit_is_no_coordinate(tmp_path):
    assert read(tmp_path, "G92 S1500\nG50 S1500\n" + START + "C2\nM30\n").time.size == 3


# ------------------------------------------------------------------------------------------------- block delete
DELETED = "G94 F100 Z1 X1\nC0\nG93 F0.01\nC1 X0.9\n/G1 C2 X0.7\n/2 C2.5\nN7 / C3 X0.6\nC4 X0.5\nM30\n"


def test_block_delete_cuts_or_skips_as_the_switch_says(tmp_path):
    assert read(tmp_path, DELETED, block_delete=True).axes["X"] == pytest.approx([1, 0.9, 0.5])
    assert read(tmp_path, DELETED, block_delete=False).axes["X"] == pytest.approx([1, 0.9, 0.7, 0.7, 0.6, 0.5])
    with pytest.raises(ProgramError, match=r"line 5 .*block_delete"):
        read(tmp_path, DELETED)


def test_a_deleted_call_is_skipped_and_a_bare_slash_is_nothing(tmp_path):
    text = "/\n/ (nothing)\n" + START + "C2\n"
    assert read(tmp_path, text + "M30\n").time.size == 3
    with pytest.raises(ProgramError, match=r"line 8 .*block_delete"):
        read(tmp_path, text + "/M98(gone.nc)\nM30\n")
    assert read(tmp_path, text + "/M98(gone.nc)\nM30\n", block_delete=True).time.size == 3
    with pytest.raises(ProgramError, match=r"line 8 calls gone\.nc"):
        read(tmp_path, text + "/M98(gone.nc)\nM30\n", block_delete=False)


# ---------------------------------------------------------------------------------------------------------- feed
@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
@pytest.mark.parametrize("modes", [("G94", "G93"), ("G93", "G94")])
def test_a_feed_ends_with_its_mode(tmp_path, dialect, modes):
    """RS-274/NGC 3.5.19: minutes of a block and mm per minute are different numbers; none is taken for the other."""
    before, after = modes
    text = f"{before} G1 F100 Z1 X1 C0\n{after}\nC1 X0.9\nC2 X0.8\nM30\n"
    with pytest.raises(ProgramError, match=f"line 3 .*{after}.* F"):
        read(tmp_path, text, dialect)
    stated = text.replace(f"{after}\n", f"{after} F50\n")
    assert read(tmp_path, stated, dialect).time.size == 3


def test_a_feed_stays_within_its_mode(tmp_path):
    cut = read(tmp_path, "G94 G1 F100 Z1 X1 C0\nG93 F0.5\nC1\nG93\nC2\nG93 G1 C3 F0.25\nM30\n")
    assert cut.time == pytest.approx([0, 0.5, 1.0, 1.25])


def test_a_speed_is_stated_again_after_times(tmp_path):
    """LinuxCNC, convert_feed_mode: G94 sets the feed to 0; RS-274/NGC goes on at the speed of the last block."""
    text = "G94 G1 F200 X0.4 C0 Z0\nG93 F0.5\nC4\nC8\nG94\nC12 X0.3\nM30\n"
    with pytest.raises(ProgramError, match=r"line 6 cuts without a feed under G94.*: give an F after G94"):
        read(tmp_path, text)
    stated = read(tmp_path, text.replace("G94\n", "G94 F12\n"))
    assert stated.time == pytest.approx([0, 0.5, 1.0, 1.5])
    assert read(tmp_path, text.replace("C12 X0.3", "Z5")).time.size == 3


def test_f_and_pvt_are_different_numbers(tmp_path):
    """Turbo PMAC: F is units per second of LINEAR moves, PVT the milliseconds of its own."""
    straight = read(tmp_path, "ABS\nLINEAR\nF2\nC0 X2 Z1\nC10 X1\nC20 X0\nM30\n", "pmac")
    assert straight.time == pytest.approx([0, 0.5, 1.0])
    cubic = read(tmp_path, "ABS\nLINEAR\nF2\nC0 X2 Z1\nPVT200\nC10:50 X1.9 F7\nC20:50 X1.8\nM30\n", "pmac")
    assert cubic.time == pytest.approx([0, 0.2, 0.4])
    back = "ABS\nLINEAR\nF2\nC0 X2 Z1\nPVT200\nC10:50 X1\nLINEAR\nC20 X0\nC30 X-1\nM30\n"
    assert read(tmp_path, back, "pmac").time == pytest.approx([0, 0.2, 0.7, 1.2])


# ------------------------------------------------------------------------------------------------ programs cut off
WHOLE = "(somebody's)\nG94 F100 Z1 X1\nC0\nG93 F0.01\nC1 X1 Z1\nC2 X0.9 Z1.25\n"
LOOP = "#1 = 0\nWHILE [#1 LT 1] DO 1\n" + WHOLE + "#1 = 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (WHOLE + "C3 X0.8 Z1.2", "without M30 .*line 7 .*line end"),
        (LOOP, "without M30 .*loop 1 "),
        (WHOLE, "without M30 or M02: it may be truncated"),
        (WHOLE + "  (the end)", "without M30 or M02: it may"),
        (WHOLE + "\n\n \t", "without M30"),
        ("%\n" + WHOLE, "without M30"),
        (LOOP + "END 1\n", "without M30"),
        (LOOP + "C3 X0.8 Z1.", "without M30"),
        (LOOP.replace("1\n", "1\r\n") + "C3", "without M30"),
    ],
)
def test_a_program_that_ends_too_early_is_reported(tmp_path, text, message):
    with pytest.warns(ProgramWarning, match=message):
        assert read(tmp_path, text).time.size >= 3


@pytest.mark.parametrize(
    "text",
    [
        WHOLE + "M30",
        WHOLE + "M02",
        WHOLE + "M2 ",
        WHOLE + "M30\n  (the end, X0 Z0)\n; C1\nEND 1\n\n",
        WHOLE + "M99\n%\n",
        "%\n" + WHOLE + "%",
        "%\nO1\n" + WHOLE + "%\n",
        LOOP + "END 1\nM30\n",
        LOOP + "M30\nEND 1",
    ],
)
def test_a_program_that_may_be_whole_is_read_in_silence(tmp_path, text):
    assert read(tmp_path, text).time.size == 3


def test_a_sub_program_cut_off_is_reported(tmp_path):
    (tmp_path / "sub.nc").write_text(WHOLE + "C3 X0")
    with pytest.warns(ProgramWarning, match=r"sub\.nc ends"):
        read(tmp_path, "M98(sub.nc)\nM30\n")


@pytest.mark.parametrize(("end", "blocks"), every_second(["M30", "M02", "M99"], [1, 200_000]))
def test_blocks_behind_the_end_are_counted(tmp_path, end, blocks):
    """The count is that of the blocks written; 200,000 of them fill several of the pieces that are read at a time."""
    rest = "".join(f"C{k % 360} X0.5\r\n" for k in range(blocks))
    for mark in ("", "\ufeff"):
        with pytest.warns(ProgramWarning, match=f"after the {end} in line 7: {blocks} blocks .* skipped"):
            read(tmp_path, f"{mark}{WHOLE}{end}\n(more X1)\n\n{rest}M30\n%\nC1")


def test_what_stands_behind_the_last_percent_sign_is_not_read(tmp_path):
    assert read(tmp_path, "%\n" + WHOLE + "%\nC4 X3\nrubbish").time.size == 3
    (tmp_path / "sub.nc").write_text("%\n" + WHOLE + "%\n")
    assert read(tmp_path, "%\nG90\nM98(sub.nc)\n%\n").time.size == 3


# ------------------------------------------------------------------------------- time and memory that are bounded
BLANKS = " " * 60_000
SLOW = {
    "call": f"M98({BLANKS}\n",
    "calls": "M98(" * 15_000 + "\n",
    "call of blanks": f"M98{BLANKS}(x{BLANKS[:4000]}\n",
    "m": "M" + BLANKS + "\n",
    "pass": f"(PASS:{BLANKS}\n",
    "passes": "(PASS:" * 10_000 + "\n",
    "pass and parts": "(PASS: a" + ", PART 1" * 7_000 + "\n",
    "pass and letters": f"(PASS: {BLANKS}x{BLANKS[:4000]}\n",
    "comment": "(" * 60_000 + "\n",
    "many": f"M98({BLANKS[:500]}\n" * 2000,
}


@pytest.mark.parametrize("name", SLOW)
@pytest.mark.parametrize("headed", [False, True])
def test_lines_of_blanks_take_no_time(tmp_path, name, headed):
    text = (SLOW[name] if headed else START + SLOW[name]) + "C2\nM30\n"
    started = time.process_time()
    output = ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProgramWarning)
        try:
            read(tmp_path, text)
        except ProgramError as error:
            output = str(error)
    assert len(output.replace(str(tmp_path), "")) < 400
    assert time.process_time() - started < 1.0


DIGITS = "9" * 5000
LONG = {
    "part": f"( PASS: a, PART {DIGITS} OF {DIGITS} )\n" + START + "G2\n",
    "points": "( TURNWRIGHT PROGRAM 1 )\n( DIALECT: nanotech )\n( CONVENTION: X SIDE +1, C SENSE +1, Z SIGN +1, "
    f"CLOCKING 0.000000000 DEG )\n( CUT a: {DIGITS} POINTS, 1.0 MINUTES, FROM C 0.0, SENSE +1, SHA256 {'0' * 64} )\n"
    + START,
    "word": START + f"C2 X{DIGITS}\n",
    "variable": START + f"#{DIGITS} = 1\n",
    "short variable": START + f"#{DIGITS[:500]} = 1\n",
    "loop": START + f"END {DIGITS[:500]}\n",
    "brackets": START + "#1 = " + "[" * 400 + "1" + "]" * 90 + "\n",
    "signs": START + "#1 = " + "-" * 490 + "1\n",
    "condition": START + "WHILE [" + "[" * 400 + " LT 1] DO 1\n",
    "name": START + "M98(" + "n" * 60_000 + ")\n",
    "pass name": "( PASS: " + "n" * 60_000 + " )\n" + START + "C2\nG94 Z5\nZ1\nG93 F1\nC3\nC4\nC5\n",
    "dialect": "( TURNWRIGHT PROGRAM 1 )\n( DIALECT: " + "n" * 60_000 + " )\n( CONVENTION: c )\n",
    "convention": "( TURNWRIGHT PROGRAM 1 )\n( DIALECT: nanotech )\n( CONVENTION: " + "n" * 60_000 + " )\n",
}


@pytest.mark.parametrize("name", LONG)
def test_long_numbers_and_names_get_a_short_sentence(tmp_path, name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProgramWarning)
        with pytest.raises(ProgramError) as error:
            read(tmp_path, LONG[name] + "M30\n")
    assert len(str(error.value).replace(str(tmp_path), "")) < 400


def test_a_header_with_an_endless_number_is_no_defect(tmp_path):
    (tmp_path / "p.nc").write_text(LONG["points"])
    assert inspect_nc(tmp_path / "p.nc").passes == ()


def test_many_names_are_not_all_listed(tmp_path):
    cuts = "".join(f"( PASS: p{k} )\nG94 C0 Z5 F1\nZ1\nG93 F1\nC1\nC2\nG94 Z5\n" for k in range(300))
    with pytest.raises(ProgramError, match=r"p0, .*more") as error:
        read(tmp_path, "X1 Y0\n" + cuts + "M30\n", name="q")
    assert len(str(error.value).replace(str(tmp_path), "")) < 400


def test_calls_of_calls_end(tmp_path):
    """Seven files that each call the next one 200 times would be read 200^7 times."""
    for k in range(6):
        (tmp_path / f"s{k}.nc").write_text(f"M98(s{k + 1}.nc)\n" * 200 + "M99\n")
    (tmp_path / "s6.nc").write_text("M99\n")
    started = time.process_time()
    with pytest.raises(ProgramError, match="times"):
        read(tmp_path, "M98(s0.nc)\n" * 200 + "M30\n")
    assert time.process_time() - started < 20


@pytest.mark.parametrize("name", ["/etc/hostname", "../other.nc", "a/../foreign.nc"])
def test_only_files_next_to_the_program_are_called(tmp_path, name):
    (tmp_path.parent / "other.nc").write_text("M99\n")
    with pytest.raises(ProgramError, match=r"line 5 calls .*in the same folder"):
        read(tmp_path, START + f"M98({name})\nM30\n")


def test_odd_lines_are_read_in_linear_time(tmp_path):
    seconds = []
    read(tmp_path, START + "C2\nM30\n")  # else the first reading loads its kernels
    for count in (10_000, 40_000):
        started = time.process_time()
        read(tmp_path, START + "M8\n" * count + "C2\nM30\n")
        seconds.append(time.process_time() - started)
    assert seconds[1] < 8 * seconds[0] + 0.2


# ----------------------------------------------------------------------------------------------- C that counts on
def degrees(folder, stops, dialect="generic", start=0):
    blocks = "".join(f"C{stop} X{5 - 0.01 * k:.2f} F60\n" for k, stop in enumerate(stops, 1))
    cut = read(folder, f"G90 G94 G1 X5 C{start} Z1 F200\nG93 G1\n{blocks}M30\n", dialect)
    return np.rad2deg(cut.axes["C"])


@pytest.mark.parametrize("dialect", ["generic", "nanotech"])
@pytest.mark.parametrize(
    ("start", "stops"),
    [
        (0, (300, 600, 900)),
        (0, (36010,)),
        (0, (350, 370, 390)),
        (0, (360, 720)),
        (0, (-200, -400, -590)),
        (7200, (7300, 7490)),
    ],
)
def test_a_c_beyond_one_turn_is_taken_as_written(tmp_path, dialect, start, stops):
    """Oracle: G90 positions of an axis that does not roll over are the positions."""
    assert degrees(tmp_path, stops, dialect, start) == pytest.approx([start, *stops], rel=1e-14, abs=1e-11)


def test_c_within_one_turn_follows_the_dialect(tmp_path):
    assert degrees(tmp_path, (200, 350)) == pytest.approx([0, 200, 350])
    assert degrees(tmp_path, (200, 30), "nanotech") == pytest.approx([0, -160, -330])
    for dialect in ("generic", "nanotech"):
        assert degrees(tmp_path, (120, 240, 0, 120), dialect) == pytest.approx([0, 120, 240, 360, 480])
        with pytest.raises(ProgramError, match=r"turns C back.*leaves 0 to 360"):
            degrees(tmp_path, (200, 400, 300), dialect)


# ------------------------------------------------------------------------------------------- calls and comments
CALLER = "G90 G94 G1 X5 C0 Z1 F200\nG93 G1\n"


def called(folder, text):
    (folder / "s.nc").write_text("G1 C10 X4 F60\nC20 X3 F60\nM99\n")
    (folder / "t.nc").write_text("G1 C40 X1 F60\nG92 C0\nM99\n")
    return read(folder, CALLER + text, "generic").axes["X"]


@pytest.mark.parametrize(
    "comment", ["(then M98(s.nc))", "; then M98(s.nc)", "(was M98<s.nc>)", "(see M98(gone.nc))", "(a) ; (M98(s.nc))"]
)
@pytest.mark.parametrize("line", ["C5 X4.5 F60 {}\n", "{}\nC5 X4.5 F60\n"])
def test_a_call_within_a_comment_is_none(tmp_path, comment, line):
    assert called(tmp_path, line.format(comment) + "C30 X2 F60\nM30\n") == pytest.approx([5, 4.5, 2])


def test_a_block_moves_before_it_calls(tmp_path):
    for line in ("C5 X4.5 F60 M98(s.nc)", "C5 X4.5 F60\nN10 M98(s.nc) (again)", "C5 X4.5 F60 m98 <s.nc> L1"):
        assert called(tmp_path, line + "\nC30 X2 F60\nM30\n") == pytest.approx([5, 4.5, 4, 3, 2])


def test_a_call_is_repeated_as_its_l_says(tmp_path):
    assert called(tmp_path, "C5 X4.5 F60\nM98(t.nc) L3\nM30\n") == pytest.approx([5, 4.5, 1, 1, 1])


@pytest.mark.parametrize(
    "line", ["M98(s.nc) P3", "M98(s.nc) L0", "M98(s.nc) X3", "M98(s.nc) M98(s.nc)", "L3 M98(s.nc)", "M98(s.nc) L1.5"]
)
def test_other_words_in_the_block_of_a_call_are_refused(tmp_path, line):
    with pytest.raises(ProgramError, match=r"line 3 calls s\.nc with more words"):
        called(tmp_path, line + "\nM30\n")


@pytest.mark.parametrize("line", ["(a (b) C5)", "C5) F60"])
def test_a_bracket_without_its_partner_is_refused(tmp_path, line):
    with pytest.raises(ProgramError, match="line 3 has an unmatched bracket"):
        called(tmp_path, line + "\nM30\n")


def test_an_f_is_no_axis_and_a_sub_program_ends_with_m99(tmp_path):
    with pytest.raises(ProgramError, match="line 3 gives F two values"):
        called(tmp_path, "C5 F60 F30\nM30\n")
    (tmp_path / "sub.nc").write_text(WHOLE + "C3 X0")
    with pytest.warns(ProgramWarning, match=r"sub\.nc ends without M99"):
        read(tmp_path, "M98(sub.nc)\nM30\n")


# --------------------------------------------------------------------------------------------- nothing left unsaid
@pytest.mark.parametrize(("rest", "blocks"), [(3, 6), (8, 1)])
@pytest.mark.parametrize("line", ["X4.25 F60", "G0 C400\nG1"])
def test_blocks_outside_the_stretch_that_is_read_are_counted(tmp_path, rest, blocks, line):
    rows = [f"C{20 * k} X{5 - 0.1 * k:.1f} F60" for k in range(1, 10)]
    if rest == 3:
        rows.insert(6, line.replace("400", "121"))
    else:
        rows.insert(8, line.replace("400", "161"))
    text = CALLER + "\n".join(rows) + "\nM30\n"
    with pytest.warns(ProgramWarning, match=f"2 unnamed cuts, .* {blocks} of 9 blocks are skipped"):
        read(tmp_path, text, "generic")
    if rest == 3:
        assert read(tmp_path, text, "generic", name="cut 1").time.size == 7


CUT = "C5 X4.9 F60\nC10 X4.8 F60\n"
UNSEEN = {
    "length": ("G43 H2\n", r"line 6 .*position of X, Z"),
    "length, restated": ("G43 H2\nG94 G0 X4.8 Z1\nG93 G1\n", r"line 8 cuts again after line 5 .*H2"),
    "tool": ("T2 M6\n", r"line 6 .*position of X, Z"),
    "tool, restated": ("T0202\nG0 X4.8 Z1\nG1\n", r"line 8 cuts again after line 5 .*T202"),
    "machine": ("G53 X0\n", r"line 6 .*position of X"),
    "home": ("G28 X0\n", r"line 6 .*position of X"),
    "dwell": ("C12 G4 P1\n", "line 5 moves and dwells"),
    "modes": ("G93 G94 C12 X4 F3\n", "line 5 has G93 and G94"),
    "moves": ("G0 G1 C12 X4\n", "line 5 has G0 and G1"),
    "set and unset": ("G92 G92.1 X4\n", "line 5 has G92 and G92.1"),
    "home and set": ("G28 G92 X4\n", "line 5 has G28 and G92"),
    "other label": ("#1=0\nWHILE[#1 LT 1]DO 1\nC12 X4 F60\n#1=1\nEND 2\n", "line 9 ends loop 2, .* open loop is 1"),
    "lone end": ("END 1\n", "line 5 ends loop 1, no loop is open"),
    "no end": ("#1=0\nWHILE[#1 LT 1]DO 1\nC12 X4 F60\n#1=1\n", "within loop 1, which has no END"),
    "twice": ("#1=0\nWHILE[#1 LT 1]DO 1\nWHILE[#1 LT 1]DO 1\n", "line 7 begins loop 1 within itself"),
}  # fmt: skip


@pytest.mark.parametrize("name", UNSEEN)
def test_hidden_or_ambiguous_tool_motion_is_refused(tmp_path, name):
    line, message = UNSEEN[name]
    with pytest.raises(ProgramError, match=message):
        read(tmp_path, CALLER + CUT + line + "C15 X4.7 F60\nC20 X4.6 F60\nM30\n", "generic")


def test_a_tool_before_the_cut_and_its_end_behind_are_no_harm(tmp_path):
    text = (
        "T0101 M6\nG43 H1\nG28 X0 Z0\n"
        + CALLER
        + CUT
        + "T0101\n"
        + CUT.replace("C", "C1")
        + "G94 G49\nG28 U0 W0\nT0100\nM30\n"
    )
    assert read(tmp_path, text, "generic").time.size == 5
