"""read_nc(write_nc(m)) is m to half a unit of the last decimal, and what changes no number changes nothing."""

import re
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

from laws import examples
from turnwright.errors import ProgramError
from turnwright.machine import Axis, Convention, Machine
from turnwright.path import Motion, SpindleMode
from turnwright.post import ProgramHeader, ProgramWarning, inspect_nc, read_nc, write_nc

DECIMALS = {"nanotech": {"C": 5, "X": 6, "Y": 6, "Z": 6}, "generic": {"C": 6, "X": 6, "Y": 6, "Z": 6}}


@st.composite
def machines(draw):
    side = st.sampled_from([1, -1])
    convention = Convention(
        x_side=draw(side), c_sense=draw(side), z_sign=draw(side), clocking=draw(st.floats(-6.2, 6.2))
    )
    return Machine(
        name="lathe",
        axes={letter: Axis() for letter in "CXYZ"},
        spindle_rpm=1000,
        block_rate_hz=1000,
        dialect=draw(st.sampled_from(sorted(DECIMALS))),
        convention=convention,
    )


@st.composite
def motions(draw, machine, *, y=None):
    count = draw(st.integers(2, 300))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    sense = draw(st.sampled_from([1, -1]))
    steps = np.deg2rad(random.uniform(0.001, draw(st.sampled_from([1, 179])), count))
    angle = sense * np.cumsum(steps) + draw(st.sampled_from([0.0, -3e4, 2e5]))
    spans = draw(st.sampled_from([np.full(count, 0.001), 10 ** random.uniform(-5, 2, count)]))
    axes = {"C": angle, "X": np.linspace(8, -0.01, count), "Z": random.normal(0, 2, count)}
    if draw(st.booleans()) if y is None else y:
        axes["Y"] = random.normal(0, 0.1, count)
    return Motion(time=draw(st.sampled_from([0.0, 77.7])) + np.cumsum(spans), axes=axes, machine=machine)


def assert_same(read, written, dialect, reach=0.0):
    """C counts on from pass to pass, so that ``reach``, the largest C of the program [rad], rounds that of each."""
    assert set(read.axes) == set(written.axes)
    for letter, values in written.axes.items():
        half = 0.5 * 10.0 ** -DECIMALS[dialect][letter]
        half = np.deg2rad(half) if letter == "C" else half
        largest = max(np.abs(values).max() + 7, reach if letter == "C" else 0.0)
        assert np.abs(read.axes[letter] - values).max() <= half + 8 * np.spacing(largest)
    elapsed = written.time - written.time[0]
    # F, seconds with 9 decimals or one over minutes with 6, is wrong by up to half of its last one.
    spans = np.diff(elapsed, prepend=0.0)
    rounding = np.full(spans.size, 0.5e-9) if dialect == "nanotech" else 0.5001e-6 * spans**2 / 60
    assert (np.abs(read.time - elapsed) <= np.cumsum(rounding) + 1e-9 * elapsed + 8 * np.spacing(written.time)).all()
    assert read.sense == written.sense


@examples(60)
@given(st.data())
def test_round_trip(tmp_path_factory, data):
    machine = data.draw(machines())
    motion = data.draw(motions(machine))
    path = tmp_path_factory.mktemp("program") / "part.nc"
    done = write_nc(motion, machine, path, max_lines=data.draw(st.sampled_from([100, 137, None])))
    assert_same(read_nc(path, machine), motion, machine.dialect)
    assert sum(file.stat().st_size for file in done.files) == done.bytes
    assert sum(file.read_text().count("\n") for file in done.files) == done.lines
    assert done.minutes == pytest.approx((motion.time[-1] - motion.time[0]) / 60)


@examples(15)
@given(st.data())
def test_every_pass_comes_back_under_its_name(tmp_path_factory, data):
    machine = data.draw(machines())
    y = data.draw(st.booleans())
    passes = {name: data.draw(motions(machine, y=y)) for name in ("rough 1", "rough 2", "semi-finish", "finish")}
    path = tmp_path_factory.mktemp("program") / "part.nc"
    done = write_nc(passes, machine, path, max_lines=data.draw(st.sampled_from([100, None])))
    reach = max(np.abs(motion.axes["C"]).max() for motion in passes.values())
    for name, motion in passes.items():
        assert_same(read_nc(path, machine, name=name), motion, machine.dialect, reach)
    assert_same(read_nc(path, machine), passes["finish"], machine.dialect, reach)
    report = inspect_nc(path)
    assert [one.hash for one in report.passes] == [one.hash for one in done.passes]
    assert [one.name for one in report.passes] == list(passes)
    assert [(one.points, one.sense) for one in report.passes] == [(m.time.size, m.sense) for m in passes.values()]
    minutes = [(m.time[-1] - m.time[0]) / 60 for m in passes.values()]
    assert [one.minutes for one in report.passes] == pytest.approx(minutes, abs=0.00051)


def reformatted(text, random):
    """The same numbers in another person's hand."""
    lines, last = [], {}
    for number, line in enumerate(text.splitlines()):
        if line.startswith(("(", "M98")):
            lines.append(line)
            continue
        if "G93" in line or "G94" in line:
            last = {}
        words = []
        for letter, value in re.findall(r"([A-Z])(-?[\d.]+)", line):
            # Modal axis words that repeat can go, if another word still makes the block move.
            if letter in "XYZ" and last.get(letter) == value and random.random() < 0.5:
                continue
            if letter in "XYZ":
                last[letter] = value
            styles = [f"{letter.lower()}{value}", f"{letter} {value}", f"{letter}{value}00" if "." in value else ""]
            words.append(random.choice([style for style in styles if style]))
        if random.random() < 0.3:
            words.insert(0, f"N{number}")
        if random.random() < 0.1:
            words.insert(random.integers(0, len(words) + 1), "(a word)")
        lines.append(random.choice(["", " ", "\t"]).join(words) + random.choice(["", "  ", " ; note"]))
        if random.random() < 0.05:
            lines.append(random.choice(["", "   ", "( nothing )", "; nothing"]))
    return random.choice(["\n", "\r\n"]).join(lines)


@examples(30)
@given(st.data())
def test_another_hand_reads_the_same(tmp_path_factory, data):
    machine = data.draw(machines())
    motion = data.draw(motions(machine))
    path = tmp_path_factory.mktemp("program") / "part.nc"
    done = write_nc(motion, machine, path)
    before = read_nc(path, machine)
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    for file in done.files:
        head, mark, rest = file.read_text().partition("( PASS: finish )\n")
        if mark:
            file.write_text(head + mark + reformatted(rest, random))
    again = read_nc(path, machine)  # the hash is of numbers: no warning, or pytest fails
    for letter, values in before.axes.items():
        assert (again.axes[letter] == values).all()
    assert (again.time == before.time).all()


def assert_no_digit_is_silent(data, file, places, path, machine):
    """Change one digit of a file at one of some places, and read the program."""
    text = file.read_text()
    digits = [i for i in places if text[i].isdigit() and text[i - 1] != "G"]  # G8 for G1 would change no number
    at = data.draw(st.sampled_from(digits))
    other = data.draw(st.sampled_from([d for d in "0123456789" if d != text[at]]))
    file.write_text(text[:at] + other + text[at + 1 :])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises((ProgramError, ProgramWarning), match=re.escape(str(path.parent))):
            read_nc(path, machine)


@examples(40)
@given(st.data())
def test_one_changed_digit_is_never_silent(tmp_path_factory, data):
    machine = data.draw(machines())
    motion = data.draw(motions(machine))
    path = tmp_path_factory.mktemp("program") / "part.nc"
    done = write_nc(motion, machine, path)
    file = done.files[-1]
    text = file.read_text()
    start = text.rindex("G93\n") + 4
    cut = range(start, text.index("G94", start))
    assert_no_digit_is_silent(data, file, cut, path, machine)


@examples(25)
@given(text=st.text(max_size=300))
def test_whatever_is_written_in_the_header_stays_a_comment(tmp_path_factory, text):
    machine = Machine(name=text, axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=1, block_rate_hz=1, dialect="generic")
    motion = Motion(
        time=np.arange(3.0), axes={"C": np.arange(3.0), "X": np.arange(3.0), "Z": np.zeros(3)}, machine=machine
    )
    path = tmp_path_factory.mktemp("program") / "part.nc"
    write_nc(motion, machine, path, header=ProgramHeader(design=text, tool=text, notes=text, date=text))
    lines = path.read_bytes().decode("ascii").split("\n")
    assert max(map(len, lines[: lines.index("G21 G90 G40 G18")])) < 400
    assert all(re.fullmatch(r"\([^()]*\)", line) for line in lines[: lines.index("G21 G90 G40 G18")])
    assert_same(read_nc(path, machine), motion, "generic")


PIECES = [
    *"CXYZGFNMPT#=[]()<>;/%*+-. \n\r\tabeE\x00µ",
    "\nC",
    "9" * 400,
    "WHILE[",
    "]DO 1",
    "END 1",
    " LT ",
    "( PASS: a )",
]
PIECES += ["C1", "C2.5", "X1", "Z-1", "G0", "G1", "G4", "G52", "G93", "G94", "F1", "1e9", "M98", "M30"]
PIECES += ["#1=", "#1", "0.0001"]


@examples(400)
@given(pieces=st.lists(st.sampled_from(PIECES), max_size=60), dialect=st.sampled_from(sorted(DECIMALS)))
def test_anything_is_read_or_refused(tmp_path_factory, pieces, dialect):
    machine = Machine(name="m", axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=1, block_rate_hz=1, dialect=dialect)
    path = tmp_path_factory.getbasetemp() / "fuzz.nc"
    path.write_text("G93F1X1Z1C0\nC0.5\n" + "".join(pieces), encoding="latin-1", newline="")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s).*it may be truncated", ProgramWarning)
        try:
            assert read_nc(path, machine).time.size >= 2
        except ProgramError as error:
            if str(path) not in str(error):
                raise


@st.composite
def turning(draw, machine):
    """A cut in spindle mode along any polyline whose X falls."""
    count = draw(st.integers(2, 60))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    x = 8 - np.cumsum(random.uniform(1e-3, 0.1, count))
    per_rev = draw(st.booleans())
    mode = SpindleMode(
        feed=draw(st.floats(1e-3, 0.1)), spindle_rpm=draw(st.floats(10, 5000)), per_rev=per_rev,
        surface_speed=draw(st.floats(10, 5000)) if per_rev and machine.dialect == "generic" else None,
    )  # fmt: skip
    return mode.motion(x, random.normal(0, 2, count), machine, sense=draw(st.sampled_from([1, -1])))


@examples(40)
@given(st.data())
def test_cuts_in_spindle_mode_come_back(tmp_path_factory, data):
    machine = data.draw(machines())
    motion = data.draw(turning(machine))
    path = tmp_path_factory.mktemp("program") / "part.nc"
    done = write_nc(motion, machine, path)
    read = read_nc(path, machine)
    assert read.sense == motion.sense
    for letter in "XZ":
        off = read.axes[letter][read.blocks] - motion.axes[letter][motion.blocks]
        assert np.abs(off).max() <= 0.5e-6 + 1e-12
    turns, planned = (np.abs(np.diff(one.axes["C"][one.blocks])) for one in (read, motion))
    length = np.hypot(*(np.diff(motion.axes[letter][motion.blocks]) for letter in "XZ"))
    # Both ends of a block, feed and speed are rounded to six decimals.
    mode = motion.spindle_mode
    feed = mode.feed if mode.per_rev else mode.feed * mode.spindle_rpm
    rounded = 0.5e-6 / feed + 0.5e-6 / mode.spindle_rpm
    assert (np.abs(turns / planned - 1) <= 2e-6 / length + 1.01 * rounded + 1e-9).all()

    file = done.files[-1]
    text = file.read_text()
    # From the start of the spindle on; the tool has come down before the first block of the cut.
    speed, first = (
        re.search(r"S[\d.]+ M0[34]", text[text.index("\n( PASS") :]),
        re.search(r"\nG9[45]\n(?=G1 X)", text).end(),
    )
    start = text.index("\n( PASS") + speed.start()
    cut = [*range(start, start + len(speed[0])), *range(first, text.index("\nG94", first))]
    assert_no_digit_is_silent(data, file, cut, path, machine)
