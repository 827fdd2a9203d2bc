"""A program in positions, velocities and times reads back to half a unit of the last decimal."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.interpolate import CubicHermiteSpline

from laws import examples
from turnwright.errors import ProgramError
from turnwright.machine import Axis, Controller, Convention, Machine
from turnwright.path import Motion
from turnwright.post import ProgramWarning, inspect_nc, read_nc, write_nc
from turnwright.tracking import track

HALF = 0.50001e-6


def lathe(**more):
    return Machine(
        name="lathe", axes=dict.fromkeys("CXYZ", Axis()), spindle_rpm=1000, block_rate_hz=1e6, dialect="pmac",
        controller=Controller(interpolation="hermite"), **more,
    )  # fmt: skip


@st.composite
def machines(draw):
    side = st.sampled_from([1, -1])
    return lathe(
        convention=Convention(
            x_side=draw(side), c_sense=draw(side), z_sign=draw(side), clocking=draw(st.floats(-6.2, 6.2))
        )
    )


@st.composite
def motions(draw, machine, *, y=None):
    count = draw(st.integers(2, 300))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    steps = np.deg2rad(random.uniform(0.001, draw(st.sampled_from([1, 179])), count))
    angle = draw(st.sampled_from([1, -1])) * np.cumsum(steps) + draw(st.sampled_from([0.0, -3e4]))
    spans = draw(st.sampled_from([np.full(count, 0.00025), 10 ** random.uniform(-5, 0.5, count)]))
    axes = {"C": angle, "X": np.linspace(8, -0.01, count), "Z": random.normal(0, 2, count)}
    if draw(st.booleans()) if y is None else y:
        axes["Y"] = random.normal(0, 0.1, count)
    velocity = {letter: random.normal(0, 50, count) for letter in axes}
    return Motion(time=np.cumsum(spans), axes=axes, machine=machine, velocity=velocity)


def assert_same(read, written):
    assert set(read.axes) == set(written.axes)
    for letter, values in written.axes.items():
        unit = np.deg2rad(1) if letter == "C" else 1.0
        assert np.abs(read.axes[letter] - values).max() <= HALF * unit + 8 * np.spacing(np.abs(values).max() + 7)
        speed = written.velocity[letter].copy()
        speed[[0, -1]] = 0
        assert np.abs(read.velocity[letter] - speed).max() <= HALF * unit + 1e-12
    elapsed = written.time - written.time[0]
    # PVT, milliseconds with 6 decimals, is wrong by up to half of its last one.
    rounding = 0.5e-9 * np.arange(elapsed.size)
    assert (np.abs(read.time - elapsed) <= rounding + 1e-9 * elapsed + 8 * np.spacing(written.time)).all()


@examples(40)
@given(st.data())
def test_round_trip(tmp_path_factory, data):
    machine = data.draw(machines())
    motion = data.draw(motions(machine))
    path = tmp_path_factory.mktemp("program") / "part.nc"
    done = write_nc(motion, machine, path)
    assert_same(read_nc(path, machine), motion)
    text = path.read_text()
    assert len(done.files) == 1
    assert text.count("\n") == done.lines
    assert len(text) == done.bytes
    assert inspect_nc(path).passes[0].hash == done.passes[0].hash


@examples(10)
@given(st.data())
def test_every_pass_comes_back_under_its_name(tmp_path_factory, data):
    machine = data.draw(machines())
    passes = {name: data.draw(motions(machine, y=False)) for name in ("rough", "finish")}
    path = tmp_path_factory.mktemp("program") / "part.nc"
    write_nc(passes, machine, path)
    for name, motion in passes.items():
        assert_same(read_nc(path, machine, name=name), motion)


def smooth(machine, points=2001):
    time = np.linspace(0, 1, points)
    return Motion(
        time=time, machine=machine,
        axes={"C": 6 * time, "X": 5 - time, "Z": 0.01 * np.sin(40 * time)},
        velocity={"C": np.full(points, 6.0), "X": np.full(points, -1.0), "Z": 0.4 * np.cos(40 * time)},
    )  # fmt: skip


def test_a_block_is_position_colon_velocity_after_its_time(tmp_path):
    machine = lathe()
    motion = smooth(machine)
    write_nc(motion, machine, tmp_path / "part.nc", depth=None)
    rows = (tmp_path / "part.nc").read_text().splitlines()
    assert all(row.startswith("; (") for row in rows[: rows.index("ABS")])
    first = rows.index("PVT0.5")
    assert rows[first - 1] == "DWELL10"
    assert sum("PVT" in row for row in rows[first:]) == 1  # one time for all
    k = 1000
    message = re.fullmatch(r"C([\d.-]+):([\d.-]+) X([\d.-]+):([\d.-]+) Z([\d.-]+):([\d.-]+)", rows[first + k])
    wanted = [np.rad2deg(3.0), np.rad2deg(6.0), 4.5, -1.0, motion.axes["Z"][k], motion.velocity["Z"][k]]
    assert [float(number) for number in message.groups()] == pytest.approx(wanted, abs=HALF)
    assert rows[first + 2000 + 1] == "LINEAR"
    assert rows[first + 2000].split()[2].endswith(":0.000000")


def test_what_was_read_is_tracked_as_its_cubics(tmp_path):
    machine = lathe()
    motion = smooth(machine, 201)
    write_nc(motion, machine, tmp_path / "part.nc")
    real = track(read_nc(tmp_path / "part.nc", machine), chord=1e-7)
    speed = motion.velocity["Z"].copy()
    speed[[0, -1]] = 0
    spline = CubicHermiteSpline(motion.time, motion.axes["Z"], speed)
    assert np.abs(real.axes["Z"] - spline(real.time)).max() < 1e-6
    # Without its velocities a motion gets those of the parabolas.
    write_nc(replace(motion, velocity=None), machine, tmp_path / "part.nc")
    again = read_nc(tmp_path / "part.nc", machine).velocity["Z"][1:-1]
    assert again == pytest.approx(np.gradient(motion.axes["Z"], motion.time)[1:-1], abs=1e-6)


def test_a_changed_velocity_is_reported(tmp_path):
    machine = lathe()
    write_nc(smooth(machine), machine, tmp_path / "part.nc")
    text = (tmp_path / "part.nc").read_text()
    (tmp_path / "part.nc").write_text(text.replace("X4.500000:-1.000000", "X4.500000:-1.000001"))
    with pytest.warns(ProgramWarning, match="edited or damaged"):
        read_nc(tmp_path / "part.nc", machine)


def test_an_axis_without_a_velocity_stops_there(tmp_path):
    (tmp_path / "other.pmc").write_text(
        "ABS\nLINEAR\nF10\nC0 X2 Z1\nPVT 200 ; slow\nc10:50 X1.9:-.5 Z1\n\nPVT100\nC15:50 X1.8 Z1.0:0.25\nM30\n"
    )
    read = read_nc(tmp_path / "other.pmc", lathe())
    assert read.time == pytest.approx([0, 0.2, 0.3])
    assert read.velocity["X"] == pytest.approx([0, -0.5, 0])
    assert read.velocity["Z"] == pytest.approx([0, 0, 0.25])
    assert np.rad2deg(read.velocity["C"]) == pytest.approx([0, 50, 50])


def test_what_it_cannot_say_is_refused(tmp_path):
    machine = lathe()
    motion = smooth(machine)
    with pytest.raises(ProgramError, match=r"lasts 5 s, the limits are 1e-6 s to 4\.096 s"):
        write_nc(replace(motion, time=10000 * motion.time, velocity=None), machine, tmp_path / "part.nc")
    with pytest.raises(ProgramError, match="has no sub-programs"):
        write_nc(motion, machine, tmp_path / "part.nc", max_lines=1000)
    (tmp_path / "bad.nc").write_text("ABS\nLINEAR\nC0 X2 Z1\nPVT200\nC10:abc X1\n")
    with pytest.raises(ProgramError, match="cannot be read at ':ABC"):
        read_nc(tmp_path / "bad.nc", machine)
    plain = replace(machine, dialect="generic")
    (tmp_path / "bad.nc").write_text("G93\nG1 C0 X2 Z1 F1\nC10:5 X1 F1\n")
    with pytest.raises(ProgramError, match="cannot be read at ':5"):
        read_nc(tmp_path / "bad.nc", plain)
