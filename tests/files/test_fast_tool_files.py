"""The files of a fast tool: what stands in them, what comes back, and what is refused."""

import csv
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest

import turnwright as tw
from turnwright.post import sync

TURN = 2 * np.pi


def motion(machine, *, sense=1, turns=4.3, per_turn=90):
    turned = np.arange(round(turns * per_turn) + 1) * (TURN / per_turn)
    axes = {
        "C": 0.7 + sense * turned,
        "X": 1.5 - 0.05 / TURN * turned,
        "Z": 0.2 + 0.001 * np.cos(turned),
        "W": 0.0123456789 * np.cos(5 * turned) - 0.001,
    }
    return tw.Motion(time=3.0 + turned / (10 * TURN), axes=axes, machine=machine)


CONVENTIONS = [tw.machine.Convention(), tw.machine.Convention(x_side=-1, c_sense=-1, z_sign=-1, clocking=1.1)]


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("dialect", ["generic", "nanotech"])
@pytest.mark.parametrize("sense", [1, -1])
def test_by_position_the_rows_are_those_that_python_would_write(tmp_path, convention, dialect, sense):
    machine = replace(tw.Machine.load("nanoform-fts-70"), convention=convention, dialect=dialect)
    made = motion(machine, sense=sense)
    done = tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by="position")
    assert done.table == tmp_path / "part.fast.csv"
    assert done.rows == made.time.size
    assert done.off <= 0.5e-7
    text = done.table.read_text(encoding="ascii").splitlines()
    head = [line for line in text if line.startswith("#")]
    assert f"SHA256 {done.program.hash}" in "".join(head)
    rows = list(csv.DictReader(text[len(head) :]))
    assert len(rows) == done.entry_rows + done.rows
    rows = rows[done.entry_rows :]
    degrees = np.rad2deg(convention.c_sense * made.axes["C"] + convention.clocking)
    places = {"generic": 6, "nanotech": 5}[dialect]
    for row, x, angle, w in zip(rows, made.axes["X"], degrees, made.axes["W"], strict=True):
        assert abs(Decimal(row["radius_mm"]) - Decimal(float(convention.x_side * x))) <= Decimal("0.5000001e-6")
        assert abs(Decimal(row["height_mm"]) - Decimal(float(w))) <= Decimal("0.5000001e-7")
        assert 0 <= float(row["angle_deg"]) < 360
        off = (float(row["angle_deg"]) - angle + 180) % 360 - 180
        assert abs(off) <= 0.50001 * 10.0**-places + 1e-9
        assert len(row["angle_deg"].split(".")[1]) == places


@pytest.mark.parametrize("sense", [1, -1])
def test_a_table_by_position_begins_with_the_turn_of_the_plunge(tmp_path, sense):
    """Its heights are those given less the lathe's, which a cosine states."""
    machine = replace(tw.Machine.load("nanoform-fts-70"), convention=CONVENTIONS[1])
    made = motion(machine, sense=sense)
    turned = np.deg2rad(np.arange(0, 361, 4))
    heights = 0.25 + 0.004 * np.sin(2 * turned)
    done = tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by="position", entry_heights=heights)
    assert done.entry_rows == 90
    lines = done.table.read_text().splitlines()
    assert "# ENTRY ROWS: 90, ONE TURN AT THE RADIUS WHERE THE CUT BEGINS, FOR EVERY TURN OF THE PLUNGE" in lines
    radius, angle, w = np.loadtxt([one for one in lines if one[0] in "-0123456789"], delimiter=",")[:90].T
    assert radius == pytest.approx(np.full(90, -1.5), abs=1e-12)
    wanted = np.rad2deg(-made.axes["C"][0] - sense * turned[:-1] + 1.1)
    assert np.abs((angle - wanted + 180) % 360 - 180).max() < 1e-6
    lathe = 0.2 + 0.001 * np.cos(turned)
    exact = heights - heights[0] + 0.201 + made.axes["W"][0] - lathe
    # The lathe's few blocks are straight within 0.1 nm.
    assert w == pytest.approx(exact[:-1], abs=0.2e-6)
    assert tw.post.read_fast_tool(tmp_path / "part.nc", machine).time.size == made.time.size
    beside = tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by="position", depth=None)
    assert beside.entry_rows == 0
    with pytest.raises(tw.errors.ProgramError, match="entry heights of shape"):
        tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by="position", entry_heights=heights[1:])
    text = beside.table.read_text().replace("ENTRY ROWS: 0", "ENTRY ROWS: x")
    beside.table.write_text(text)
    with pytest.raises(tw.errors.ProgramError, match="how many of its 388 rows"):
        tw.post.read_fast_tool(tmp_path / "part.nc", machine)


@pytest.mark.parametrize("count", [85, 89, 91, 95])
def test_an_edited_number_of_entry_rows_is_refused(tmp_path, count):
    machine = tw.Machine.load("nanoform-fts-70")
    done = tw.post.write_fast_tool(motion(machine), machine, tmp_path / "part.nc", by="position")
    done.table.write_text(done.table.read_text().replace("ENTRY ROWS: 90,", f"ENTRY ROWS: {count},"))
    with pytest.raises(tw.errors.ProgramError, match="its number of entry rows was edited"):
        tw.post.read_fast_tool(tmp_path / "part.nc", machine)


def test_corners_of_z_are_refused_for_a_pvt_controller(tmp_path):
    """Z was computed straight from block to block, 12 nm off the cubics of the program, unnoticed."""
    pmac = replace(
        tw.Machine.load("nanoform-fts-70"), dialect="pmac", controller=tw.machine.Controller(interpolation="hermite")
    )
    turned = np.deg2rad(np.arange(0, 1441.0))
    axes = {"C": turned, "X": 1 - 0.02 / TURN * turned, "W": 0 * turned}
    tip = 0.01 * np.cos(2 * turned)
    corners = np.interp(turned, turned[::8], tip[::8])
    for z, refused in ((tip, False), (corners, True)):
        made = tw.Motion(time=turned / TURN, axes={**axes, "Z": z, "W": tip - z + 0.001}, machine=pmac)
        if not refused:
            tw.post.write_fast_tool(made, pmac, tmp_path / "part.nc", by="position", depth=None)
            continue
        with pytest.raises(tw.errors.ProgramError, match=r"nm between blocks.*blocks_per_rev"):
            tw.post.write_fast_tool(made, pmac, tmp_path / "part.nc", by="position", depth=None)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("by", ["position", "time"])
def test_program_and_table_read_back_are_the_motion(tmp_path, convention, sense, by):
    """X and Z to half a decimal of the program and what its blocks leave out, W to half of its own or by its stream."""
    machine = replace(tw.Machine.load("nanoform-fts-70"), convention=convention)
    made = motion(machine, sense=sense)
    rate = None if by == "position" else 50_000.0
    done = tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by=by, rate_hz=rate)
    again = tw.post.read_fast_tool(tmp_path / "part.nc", machine)
    assert again.sense == made.sense
    begun = made.time - made.time[0]
    assert again.time[[0, -1]] == pytest.approx(begun[[0, -1]], rel=1e-8)
    if by == "position":
        assert again.time.size == made.time.size
        shift = TURN * np.rint((again.axes["C"][0] - made.axes["C"][0]) / TURN)
        assert again.axes["C"] - shift == pytest.approx(made.axes["C"], abs=2e-8)
        assert again.axes["W"] == pytest.approx(made.axes["W"], abs=0.51e-7)
        assert again.time == pytest.approx(begun, abs=1e-7)
    assert "U" not in again.axes
    for letter, tolerance in {"X": 0.7e-6, "Z": 0.7e-6, "W": max(done.off, 0.6e-7) * 1.01}.items():
        assert np.interp(begun, again.time, again.axes[letter]) == pytest.approx(made.axes[letter], abs=tolerance)
    assert done.off < 1e-5


def test_a_stream_holds_the_heights_at_its_times(tmp_path):
    machine = tw.Machine.load("nanoform-fts-70")
    made = motion(machine)
    done = tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by="time", rate_hz=3000)
    heights = [float(line) for line in done.table.read_text().splitlines() if line[0] not in "#h"]
    at = np.arange(done.rows) / 3000
    assert at[-1] >= made.time[-1] - made.time[0] - 1e-9 > at[-2]
    wanted = np.interp(at, made.time - made.time[0], made.axes["W"])
    assert np.abs(np.array(heights) - wanted).max() <= 0.5000001e-7
    again = np.interp(made.time - made.time[0], at, heights)
    assert done.off == pytest.approx(np.abs(again - made.axes["W"]).max(), rel=1e-9)


def test_the_lathe_turns_steadily_with_few_blocks(tmp_path):
    machine = tw.Machine.load("nanoform-fts-70")
    made = motion(machine)
    made = tw.Motion(time=made.time, axes={**made.axes, "Z": np.full(made.time.size, 0.2)}, machine=machine)
    done = tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by="position")
    lathe = tw.read_nc(tmp_path / "part.nc", machine)
    assert "W" not in lathe.axes
    assert lathe.time.size == done.program.passes[0].points < 4.3 * 12
    assert np.abs(np.diff(lathe.axes["C"])).max() < np.pi / 4 + 1e-6
    assert np.ptp(lathe.axes["Z"]) == 0


def test_what_does_not_belong_together_is_refused(tmp_path):
    machine = tw.Machine.load("nanoform-fts-70")
    made = motion(machine)
    file = tmp_path / "part.nc"
    done = tw.post.write_fast_tool(made, machine, file, by="position")
    good = done.table.read_bytes()
    done.table.write_bytes(good.replace(b"0.0113457", b"0.0113458", 1))
    with pytest.raises(tw.errors.ProgramError, match="damaged or edited"):
        tw.post.read_fast_tool(file, machine)
    done.table.write_bytes(good[100:])
    with pytest.raises(tw.errors.ProgramError, match="not a fast-tool table"):
        tw.post.read_fast_tool(file, machine)
    done.table.write_bytes(good)
    other = replace(machine, convention=tw.machine.Convention(clocking=0.5))
    with pytest.raises(tw.errors.ProgramError, match="is written for X SIDE"):
        tw.post.read_fast_tool(file, other)
    tw.write_nc(
        tw.Motion(time=made.time, axes={**made.axes, "X": made.axes["X"] + 1}, machine=machine).lathe(), machine, file
    )
    with pytest.raises(tw.errors.ProgramError, match="belongs to another program"):
        tw.post.read_fast_tool(file, machine)
    done.table.unlink()
    with pytest.raises(tw.errors.ProgramError, match="cannot be read"):
        tw.post.read_fast_tool(file, machine)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"by": "radius"}, '"position" or "time"'),
        ({"by": "time"}, "only a table by time has a rate"),
        ({"by": "position", "rate_hz": 10.0}, "only a table by time has a rate"),
        ({"by": "time", "rate_hz": 1e12}, "lower rate_hz"),
    ],
)
def test_a_wrong_request_is_one_sentence(tmp_path, change, words):
    machine = tw.Machine.load("nanoform-fts-70")
    with pytest.raises(tw.errors.ProgramError) as caught:
        tw.post.write_fast_tool(motion(machine), machine, tmp_path / "part.nc", **change)
    assert words in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_when_the_program_cannot_be_written(tmp_path):
    machine = tw.Machine.load("nanoform-fts-70")
    with pytest.raises(tw.errors.ProgramError, match="clearance"):
        tw.post.write_fast_tool(motion(machine), machine, tmp_path / "part.nc", by="position", clearance=-1)
    assert list(tmp_path.iterdir()) == []
    close = motion(machine, turns=2e-6, per_turn=2_000_000_000)
    with pytest.raises(tw.errors.ProgramError, match="turns C by 0 deg"):
        tw.post.write_fast_tool(close, machine, tmp_path / "part.nc", by="position")
    assert list(tmp_path.iterdir()) == []


def test_the_motions_that_belong_elsewhere(tmp_path):
    machine = tw.Machine.load("nanoform-fts-70")
    with pytest.raises(tw.errors.ProgramError, match=r"use write_fast_tool, or write motion\.lathe"):
        tw.write_nc(motion(machine), machine, tmp_path / "part.nc")
    with pytest.raises(tw.errors.ProgramError, match="a fast tool needs W"):
        tw.post.write_fast_tool(motion(machine).lathe(), machine, tmp_path / "part.nc", by="position")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("by", ["position", "time"])
def test_a_second_axis_has_a_column_of_its_own(tmp_path, by):
    machine = replace(tw.Machine.load("nanoform-fts-70"), convention=tw.machine.Convention(x_side=-1))
    made = motion(machine)
    own = {"U": 0.004 * np.sin(3 * made.axes["C"])}
    made = tw.Motion(time=made.time, axes={**made.axes, **own}, machine=machine)
    rate = 90 * 10.0 if by == "time" else None  # a row at every point
    done = tw.post.write_fast_tool(made, machine, tmp_path / "part.nc", by=by, rate_hz=rate)
    assert done.off < 0.51e-7
    again = tw.post.read_fast_tool(tmp_path / "part.nc", machine)
    begun = made.time - made.time[0]
    for letter in "UW":
        assert np.interp(begun, again.time, again.axes[letter]) == pytest.approx(made.axes[letter], abs=0.6e-7)
    assert np.interp(begun, again.time, again.axes["X"]) == pytest.approx(made.axes["X"], abs=0.7e-6)


def test_stream_needs_no_more_blocks_than_the_lathe_program_has(tmp_path):
    """Oracle: the program of the lathe, read without the stream; X and Z follow decimals, not straight lines."""
    machine = tw.Machine.load("nanoform-fts-70")
    tw.post.write_fast_tool(motion(machine), machine, tmp_path / "part.nc", by="time", rate_hz=20_000)
    again, lathe = tw.post.read_fast_tool(tmp_path / "part.nc", machine), tw.read_nc(tmp_path / "part.nc", machine)
    assert again.time.size > 2 * lathe.time.size, "the heights stand between the blocks"
    assert np.array_equal(again.time[again.blocks], lathe.time)
    assert np.array_equal(again.lathe().axes["Z"], lathe.axes["Z"])
    limits = tw.check_limits(again, machine)
    assert limits.block_rate_hz == tw.check_limits(lathe, machine).block_rate_hz < machine.block_rate_hz
    assert all(one.startswith("W bandwidth") for one in limits.findings), limits.findings
    assert tw.track(again, machine).time[-1] == pytest.approx(lathe.time[-1] - lathe.time[0], rel=1e-12)


def test_rows_are_the_numbers_that_python_reads():
    random = np.random.default_rng(5)
    cells = [f"{value:.{k % 13}f}" for k, value in enumerate(random.normal(0, 1e3, 3000))]
    lines = [",".join(cells[k : k + 3]) for k in range(0, 3000, 3)]
    expected = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    odd = (["1e-3,2,3"], ["1, 2,3"], ["123456789012345678901234567890,0.1234567890123456789012,+.5"], ["-0,1.,.5"])
    for more in ([], *odd):
        body = "\n".join([*lines, *more, ""]).encode()
        table = sync._parse_rows(body, 3)
        assert table[:1000].tobytes() == expected.tobytes()
        assert table[1000:].tolist() == [[float(cell) for cell in line.split(",")] for line in more]
    for wrong in ("1,2\n", "1,2,3,4\n", "1,2,x\n", "1,2,\n", "1,2,3\n4,5,6", "1,2,3\n\n4,5,6\n", ""):
        try:
            expected = sync.rows_of_numbers(wrong.splitlines(), ",")
        except ValueError:
            with pytest.raises(ValueError):  # noqa: PT011 - the reason is NumPy's
                sync._parse_rows(wrong.encode(), 3)
        else:
            assert np.array_equal(sync._parse_rows(wrong.encode(), 3), expected)
