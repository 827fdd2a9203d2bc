"""What cannot be written or read is refused in one sentence that names the place and the remedy."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from turnwright.errors import ProgramError
from turnwright.machine import Axis, Convention, Machine
from turnwright.path import Motion
from turnwright.post import ProgramHeader, ProgramWarning, inspect_nc, read_nc, read_table, write_nc


def machine(dialect="nanotech", **convention):
    return Machine(
        name="lathe",
        axes={letter: Axis() for letter in "CXYZ"},
        spindle_rpm=1000,
        block_rate_hz=1000,
        dialect=dialect,
        convention=Convention(**convention),
    )


def motion(c=(0.0, 0.1, 0.2), time=(0.0, 1.0, 2.0), **axes):
    size = len(c)
    axes = {"C": np.array(c), "X": np.linspace(1, 0, size), "Z": np.zeros(size)} | axes
    return Motion(time=np.array(time), axes=axes, machine=machine())


def sentence(error):
    """Return the message, after checking that it is one sentence with a remedy."""
    text = str(error.value)
    assert "\n" not in text
    assert ": " in text
    assert len(text) < 500
    return text


START = "G94 F100 Z1 X1\nC0\nG93 F0.01\nC1 X1 Z1\n"
DAMAGED = {
    "empty": ("", "no cutting block"),
    "only a header": ("( PART )\nG71\nM30\n", "no cutting block"),
    "turning without C": ("G1 X1 Z1 F5\nX2\nX3\n", "no cutting block"),
    "nan": (START + "C2 Xnan\n", "line 5 .*'XNAN'"),
    "inf": (START + "C2 X-inf\n", "line 5 "),
    "exponent": (START + "C2 X1e-3\n", "line 5 has the word E, the axes are C, X, Y and Z in fixed-point"),
    "exponent of nothing": (START + "C2 X1e0\n", "line 5 has the word E"),
    "comma": (START + "C2 X1,5\n", "line 5 cannot be read at ',5'"),
    "two points": (START + "C2 X1.2.3\n", "line 5 cannot be read at '.3'"),
    "no number": (START + "C2 X Z1\n", "line 5 cannot be read at 'X Z1'"),
    "twice": (START + "C2 X1 X2\n", "line 5 gives X two values"),
    "huge": (START + "C2 X99999999999\n", "line 5 has X1e[+]11, the limit is 1e[+]09"),
    "cut off in mid-number": (START + "C2 X1.0 Z-", "line 5 cannot be read at 'Z-'"),
    "open comment": (START + "C2 (what\n", "line 5 has an unmatched bracket"),
    "arc": (START + "G2 C2 X1 I1\n", r"line 5 is an arc \(G2\)"),
    "incremental": ("G91\n" + START, "line 1 selects incremental moves"),
    "inches": ("G20\n" + START, "line 1 selects inches"),
    "diameter": ("G7\n" + START, "line 1 has G7, which"),
    "shifted": (START + "G52 Z-0.01\n", "line 5 shifts the origin"),
    "another axis": (START + "C2 B5\n", "line 5 has the word B, the axes are C, X, Y and Z"),
    "standstill": (START + "C2\nC2\nC3\n", "line 6 does not move within a cut"),
    "back": (START + "C2\nC1.5\nC3\nM30\n", "block 3 of cut 1 turns C back"),
    "half a turn": (START + "C181\nM30\n", "block 2 of cut 1 turns C backwards, not at all or by half a turn"),
    "no feed": ("X1 Z1\nC0\nC1\n", "line 3 cuts without a feed"),
    "feed of zero": (START + "F0\nC2\n", "line 6 cuts with a feed of 0"),
    "missing sub-program": ("M98(gone.nc)\n", "line 1 calls gone.nc, which is not in the same folder"),
    "sub-program by number": ("M98 P1000\n", "line 1 calls sub-program 1000 by number"),
    "calls itself": ("M98(bad.nc)\n", "is called by itself"),
    "unset variable": ("G93 F[#5]\n", "line 1 uses #5, which has no value"),
    "division": ("#1 = 1 / 0\n", "line 1 divides by 0"),
    "formula": ("#1 = 1 + * 2\n", "line 1 has an expression that cannot be read"),
    "rest of a formula": ("#1 = 1 ] 2\n", "line 1 has an expression that cannot be read"),
    "condition": ("WHILE [#1] DO 1\n", "line 1 has a condition that cannot be read"),
    "endless loop": ("#1 = 0\nWHILE [#1 LT 3] DO 1\nG4 P0\nEND 1\n", "line 4 repeats loops more than 10,000 times"),
    "endless loops": (
        "WHILE [1 LT 3] DO 1\nWHILE [1 LT 2] DO 2\nG4 P0\nEND 2\nEND 1\n",
        "repeats loops more than 10,000 times",
    ),
    "no loop": ("#1 = 3\nWHILE [#1 LT 3] DO 1\n" + START, "line 2 begins a loop that runs 0 times"),
    "jump": ("IF [1 EQ 1] GOTO 5\n", "line 1 is a statement that Turnwright does not support"),
    "two cuts of one name": (
        "( PASS: a )\n" + START + "C2\nG94 Z5\nZ1\nG93\nC3\nC4\nG94 Z5\n",
        "ends a second cut in pass a, of 2 blocks after 2",
    ),
    "late Y": (START + "C2 Y1\n", "line 5 moves Y for the first time within a cut"),
    "long line": ("(" + "x" * 70000, "line 1 is longer than 65536 bytes"),
    "many words": ("M1 " * 300 + "\n", "line 1 is longer than 512 characters"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_programs(tmp_path, name):
    text, message = DAMAGED[name]
    path = tmp_path / "bad.nc"
    path.write_text(text)
    with pytest.raises(ProgramError, match=message) as error:
        read_nc(path, machine())
    assert str(path) in sentence(error)


@pytest.mark.parametrize("seed", range(5))
def test_binary_garbage(tmp_path, seed):
    path = tmp_path / "bad.nc"
    path.write_bytes(np.random.default_rng(seed).bytes(200_000))
    with pytest.raises(ProgramError) as error:
        read_nc(path, machine())
    assert str(path) in sentence(error)
    path.write_bytes(bytes(200_000))
    with pytest.raises(ProgramError, match=r"binary data|longer than"):
        read_nc(path, machine())


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("\n", "\r", r"has a carriage return .*LF"),
        ("C20", "C20\r", r"line 5 has a carriage return"),
        ("(a)\n", "; a\r", r"line 1 has a carriage return"),
        ("-0.2", "\u22120.2", r"line 5 cannot be read at 'Z\u22120.2'"),
        ("-0.2", "\u20130.2", r"line 5 cannot be read at 'Z\u20130.2'"),
    ],
)
def test_a_sign_that_looks_like_another_is_shown(tmp_path, old, new, sentence):
    blocks = "(a)\nG90 G94 G21\nG1 C0 X1 Z0 F100\nC10 X0.9 Z-0.1\nC20 X0.8 Z-0.2\nM30\n"
    path = tmp_path / "other.nc"
    path.write_bytes(blocks.replace("\n", "\r\r\n").encode())  # as a transfer in text mode leaves them
    assert read_nc(path, machine()).axes["X"].tolist() == [1.0, 0.9, 0.8]
    path.write_bytes(blocks.replace(old, new, 1 if old != "\n" else -1).encode())
    with pytest.raises(ProgramError, match=sentence):
        read_nc(path, machine())


@pytest.mark.parametrize("read", [read_nc, lambda path, _: inspect_nc(path)])
def test_missing_file_and_folder(tmp_path, read):
    for path in (tmp_path / "gone.nc", tmp_path):
        with pytest.raises(ProgramError, match="cannot be read") as error:
            read(path, machine())
        assert str(path) in sentence(error)


def test_a_pass_that_is_not_there(tmp_path):
    path = tmp_path / "part.nc"
    write_nc({"rough": motion(), "finish": motion()}, machine(), path)
    with pytest.raises(ProgramError, match="no pass 'Finish', it has rough, finish"):
        read_nc(path, machine(), name="Finish")
    path.write_text(START + "C2\nC3\nG94 Z5 F100\nC0\nZ1\nG93 F0.01\nC1\nC2\nM30\n")
    assert read_nc(path, machine(), name="cut 1").time.size == 4
    assert read_nc(path, machine(), name="cut 2").time.size == 3
    with pytest.raises(ProgramError, match="no pass 'cut 3', it has cut 1, cut 2"):
        read_nc(path, machine(), name="cut 3")


def test_another_machines_program(tmp_path):
    path = tmp_path / "part.nc"
    write_nc(motion(), machine(), path)
    with pytest.raises(ProgramError, match="dialect nanotech, machine lathe has generic"):
        read_nc(path, machine("generic"))
    for field, value in (("x_side", -1), ("c_sense", -1), ("z_sign", -1), ("clocking", 0.001)):
        with pytest.raises(ProgramError, match="is written for the convention") as error:
            read_nc(path, machine(**{field: value}))
        sentence(error)


def test_edited_program_is_read_and_reported(tmp_path):
    path = tmp_path / "part.nc"
    write_nc(motion(), machine(), path)
    sub = tmp_path / "part.finish.001.nc"
    sub.write_text(sub.read_text().replace("X0.500000", "X0.500001"))
    with pytest.warns(ProgramWarning, match="pass finish has the hash .* the header states"):
        assert read_nc(path, machine()).axes["X"][1] == 0.500001


def rows(text):
    return text.splitlines(keepends=True)


@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
def test_a_program_unlike_its_header_is_refused(tmp_path, dialect):
    path = tmp_path / "part.nc"
    done = write_nc(motion(np.arange(9) * 0.1, np.arange(9.0)), machine(dialect), path, depth=None)
    cuts, whole = done.files[-1], done.files[-1].read_text()
    less = re.sub(r"\n(G1 X0\.5|C17).*\n", "\n", whole, count=1)
    assert less != whole
    more = re.sub(
        r"\n(G94\nG1 Z\S+ F100)", lambda end: f"\n{'G1 ' * (dialect == 'generic')}C100 X0 Z0 F1\n{end[1]}", whole
    )
    assert more != whole
    for text, count in ((less, 8), (more, 10)):
        cuts.write_text(text)
        with pytest.raises(ProgramError, match=f"has {count} points in pass finish, its header states 9: ") as error:
            read_nc(path, machine(dialect))
        sentence(error)
    cuts.write_text("".join(rows(whole)[:-5]))
    with pytest.raises(ProgramError, match=r"is the last line, a complete file ends with M30 or M99: ") as error:
        read_nc(path, machine(dialect))
    sentence(error)
    cuts.write_text(whole)
    path.write_text(path.read_text().replace("9 POINTS", "3 POINTS"))
    with pytest.raises(ProgramError, match="has 9 points in pass finish, its header states 3: ") as error:
        read_nc(path, machine(dialect))
    sentence(error)


def test_an_empty_sub_program(tmp_path):
    path = tmp_path / "part.nc"
    write_nc(motion(), machine(), path)
    (tmp_path / "part.finish.001.nc").write_text("")
    with pytest.raises(ProgramError, match="has 0 points in pass finish, its header states 3: copy all files") as error:
        read_nc(path, machine())
    sentence(error)


@pytest.mark.parametrize("kept", [1, 3, 7, 12])
def test_a_header_cut_short(tmp_path, kept):
    path = tmp_path / "part.nc"
    write_nc(motion(), machine(), path)
    path.write_text("".join(rows(path.read_text())[:kept]))
    with pytest.raises(ProgramError, match=r"is truncated: copy|names no pass in its header") as error:
        read_nc(path, machine())
    sentence(error)


def test_a_sub_program_alone_knows_its_machine(tmp_path):
    done = write_nc(motion(), machine(), tmp_path / "part.nc")
    assert read_nc(done.files[1], machine()).time.tolist() == [0, 1, 2]
    with pytest.raises(ProgramError, match=r"001.nc is written in the dialect nanotech, machine lathe has generic"):
        read_nc(done.files[1], machine("generic"))
    with pytest.raises(ProgramError, match=r"001.nc is written for the convention"):
        read_nc(done.files[1], machine(x_side=-1))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with a name are a Unix matter")
@pytest.mark.parametrize("read", [read_nc, lambda path, _: inspect_nc(path), read_table])
def test_what_never_ends_is_not_read(tmp_path, read):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path(os.devnull).with_name("zero")):
        options = {"spindle_rpm": 50} if read is read_table else {}
        with pytest.raises(ProgramError, match="is a device or a pipe, it must be a file") as error:
            read(path, machine(), **options)
        sentence(error)


def test_control_characters_of_a_name_stay_out(tmp_path):
    write_nc(motion(), machine(), tmp_path / "part.nc", header=ProgramHeader(design="le\x00ns\x1b[2J \x7f\x9b"))
    assert inspect_nc(tmp_path / "part.nc").header.design == "lens[2J"
    assert not re.search(rb"[^\n\x20-\x7e]", (tmp_path / "part.nc").read_bytes())


def test_an_editor_that_marks_its_files_is_no_matter(tmp_path):
    path = tmp_path / "part.nc"
    write_nc(motion(), machine("generic"), path)
    before = read_nc(path, machine("generic"))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert inspect_nc(path).dialect == "generic"
    after = read_nc(path, machine("generic"))
    assert (after.axes["C"] == before.axes["C"]).all()
    path.write_bytes(path.read_bytes().replace(b"X0.5", b"X0.6"))
    with pytest.warns(ProgramWarning, match="edited"):
        read_nc(path, machine("generic"))


def test_requested_header_is_missing(tmp_path):
    path = tmp_path / "part.nc"
    path.write_text(START)
    with pytest.raises(ProgramError, match="has no Turnwright header") as error:
        inspect_nc(path)
    sentence(error)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (dict, "0 passes"),
        (lambda: {"a(b)": motion()}, "a pass has the name 'a\\(b\\)'"),
        (lambda: {"a b": motion(), "a-b": motion()}, "the same file name"),
        (lambda: {"a": motion(), "b": motion(Y=np.zeros(3))}, "some passes move Y"),
        (lambda: motion(W=np.zeros(3)), "moves axis W"),
        (lambda: motion(X=np.array([0, 1e12, 0])), "axis X of pass finish reaches 1e\\+12"),
        (lambda: motion(c=(0, 1, 4.5)), "block 2 of pass finish turns C by 200.5.* deg, it must be below 180"),
        (lambda: motion(c=(0, 1, 1 + 1e-9)), "block 2 of pass finish turns C by 0 deg"),
        (lambda: motion(time=(0, 1, 1 + 1e-8)), "block 2 of pass finish lasts 1e-08 s"),
        (lambda: motion(time=(0, 1, 1e5)), "block 2 of pass finish lasts 99999 s.* 10000 s: check the spindle"),
    ],
)
@pytest.mark.parametrize("dialect", ["nanotech", "generic"])
def test_motions_that_no_program_can_hold(tmp_path, dialect, what, message):
    with pytest.raises(ProgramError, match=message) as error:
        write_nc(what(), machine(dialect), tmp_path / "part.nc")
    sentence(error)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"clearance": 0.0}, "clearance is 0 mm"),
        ({"clearance": np.nan}, "clearance is nan mm"),
        ({"max_lines": 5}, "max_lines is 5"),
        ({"plunge_feed": 2.0}, "plunge_feed is 120 mm/min, it must be above 0 and at most 60 mm/min"),
        ({"plunge_feed": 1e-9}, "the limit is 5e"),
        ({"depth": np.nan}, "depth of pass finish is nan mm"),
    ],
)
def test_options_that_make_no_sense(tmp_path, options, message):
    with pytest.raises(ProgramError, match=message) as error:
        write_nc(motion(), machine(), tmp_path / "part.nc", **options)
    sentence(error)


def test_unknown_dialect(tmp_path):
    with pytest.raises(
        ProgramError, match="dialect 'klingon' is not known, Turnwright writes diffsys-2d, fanuc-30i, generic, "
    ) as error:
        write_nc(motion(), machine("klingon"), tmp_path / "part.nc")
    sentence(error)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has the columns ''"),
        ("C_deg,X_mm\n1,2\n", "it needs C_deg, X_mm, Z_mm"),
        ("C_deg,X_mm,X_mm,Z_mm\n1,2,3,4\n", "it needs C_deg"),
        ("C_deg,X_mm,Z_mm\n", "has no rows"),
        ("C_deg,X_mm,Z_mm\n1,2,three\n", "not a number"),
        ("C_deg,X_mm,Z_mm\n1,2,3\n2,2\n", "not a number"),
        ("C_deg,X_mm,Z_mm\n1,2,3,4\n", "rows have 4 numbers"),
        ("C_deg,X_mm,Z_mm\n1,2,3\n2,2,nan\n", "line 3 is not finite"),
        ("C_deg,X_mm,Z_mm\n1,2,3\n", "never moves C"),
        ("C_deg,X_mm,Z_mm\n1,2,3\n2,2,3\n2,2,4\n3,2,3\n", "line 4 moves the tool .*while C is at rest"),
        ("C_deg,X_mm,Z_mm\n1,2,3\n2,2,3\n1.5,2,3\n", "line 4 turns C back"),
        ("C_deg,X_mm,Z_mm\n0,2,3\n180,2,3\n270,2,3\n", "line 3 turns C back or by half a turn"),
        (b"\xff\xfe\x00", "not a table of text"),
    ],
)
def test_damaged_tables(tmp_path, text, message):
    path = tmp_path / "table.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ProgramError, match=message) as error:
        read_table(path, machine(), spindle_rpm=50)
    assert str(path) in sentence(error)


@pytest.mark.parametrize(
    "speed", [{}, {"spindle_rpm": 50, "block_rate_hz": 10}, {"spindle_rpm": 0}, {"spindle_rpm": np.nan}]
)
def test_table_needs_one_speed(tmp_path, speed):
    with pytest.raises(ProgramError, match="needs one speed above 0") as error:
        read_table(tmp_path / "table.csv", machine(), **speed)
    sentence(error)
    with pytest.raises(ProgramError, match="cannot be read"):
        read_table(tmp_path / "table.csv", machine(), spindle_rpm=1)


def test_table_with_plunge_repeats_and_wrapped_c(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(
        "Z_mm, C_deg, X_mm\n5,10,4\n1,10,4\n1,10,4\n0.9,5,4\n0.9,5,4\n0.8,359,3.9\n0.7,353,3.8\n5,353,3.8\n"
    )
    with pytest.warns(ProgramWarning, match="2 rows of plunge and retract"):
        read = read_table(path, machine(c_sense=-1, x_side=-1, clocking=0.5), spindle_rpm=10)
    assert np.rad2deg(read.axes["C"] - 0.5) == pytest.approx([-10, -5, 1, 7])
    assert read.axes["X"].tolist() == [-4, -4, -3.9, -3.8]
    assert read.axes["Z"].tolist() == [1, 0.9, 0.8, 0.7]
    assert read.time == pytest.approx([0, 5 / 60, 11 / 60, 17 / 60])  # 10 rev/min is 60 deg/s
