"""LinuxCNC's interpreter as a witness: positions and block times of programs as it reads them.

Oracle: the interpreter of LinuxCNC, see `linuxcnc`. Without it these tests are skipped.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import linuxcnc
import linuxcnc_planner
import turnwright as tw
from cases import every_second
from turnwright.job import Job, Pipeline
from turnwright.machine import blend_blocks

pytestmark = pytest.mark.skipif(
    linuxcnc.environment() is None, reason="LinuxCNC is not here: tools/unpack_linuxcnc and TURNWRIGHT_LINUXCNC"
)
EXAMPLES = Path(__file__).parents[2] / "examples"
FASTEST = {
    "conic_zernike": ("generic",),
    "mirror_pair": ("linuxcnc",),
    "turned_asphere": ("generic", "linuxcnc"),
}
"""Examples and dialects of the suite: a freeform, a chuck of outlines and one in spindle mode."""
TOOL = tw.Tool(nose_radius=0.5, included=np.deg2rad(120))
PART = tw.Part(
    surface=tw.Sphere(radius=50.0) + tw.XYPolynomial(terms={(1, 0): 1e-3, (0, 2): 2e-3, (1, 2): 5e-4}), radius=2.0
)
TURNED = tw.Part(surface=tw.EvenAsphere(radius=40.0, conic=-0.5, terms={4: 1e-5}), radius=5.0)


def motion_of(servo, part, machine):
    return tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, machine)


def machine_of(dialect):
    return replace(tw.Machine.load("nanoform"), dialect=dialect)


@pytest.mark.parametrize(("dialect", "sense"), every_second(["generic", "linuxcnc"], [1, -1]))
def test_blocks_of_a_freeform_are_those_that_linuxcnc_reads(tmp_path, dialect, sense):
    machine = machine_of(dialect)
    rough = motion_of(tw.SlowToolServo(feed=0.1, points_per_rev=60, spindle_rpm=60, sense=sense), PART, machine)
    finish = motion_of(tw.SlowToolServo(feed=0.03, chord=1e-5, spindle_rpm=77, sense=sense), PART, machine)
    passes = {"rough": replace(rough, axes={**rough.axes, "Z": rough.axes["Z"] + 0.01}), "finish": finish}
    tw.write_nc(passes, machine, tmp_path / "part.nc", depth=0.02)
    cuts = linuxcnc.interpret(tmp_path / "part.nc", tmp_path)
    assert [*cuts] == [*passes]
    for name, (x, _, z, c, time) in cuts.items():
        again = tw.read_nc(tmp_path / "part.nc", machine, name=name)
        assert np.abs(x - again.axes["X"]).max() < 1e-9
        assert np.abs(z - again.axes["Z"]).max() < 1e-9
        degrees = np.rad2deg(again.axes["C"])
        assert np.abs(np.diff(c) - np.diff(degrees)).max() < 1e-9
        assert np.abs(time - again.time).max() < 1e-9 * max(again.time[-1], 1.0)
        assert np.abs(np.diff(time) - np.diff(again.time)).max() < 1e-9


@pytest.mark.parametrize(
    ("dialect", "options"),
    every_second(
        ["generic", "linuxcnc"], [{}, {"feed_mode": "mm/rev"}, {"feed_mode": "mm/rev", "surface_speed": 900.0}]
    ),
)
def test_blocks_in_spindle_mode_are_those_that_linuxcnc_reads(tmp_path, dialect, options):
    machine = machine_of(dialect)
    motion = motion_of(tw.Turning(feed=0.01, spindle_rpm=1000, chord=1e-6, **options), TURNED, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=0.02)
    again = tw.read_nc(tmp_path / "part.nc", machine)
    ((x, _, z, _, time),) = linuxcnc.interpret(tmp_path / "part.nc", tmp_path).values()
    at = again.blocks
    assert np.abs(x - again.axes["X"][at]).max() < 1e-9
    assert np.abs(z - again.axes["Z"][at]).max() < 1e-9
    turns = np.abs(again.axes["C"][at] - again.axes["C"][0]) / (2 * np.pi)
    # Under G95 the interpreter counts minutes as revolutions.
    elapsed = 60 * turns if motion.spindle_mode.per_rev else again.time[at]
    assert np.abs(time - elapsed).max() < 1e-9 * elapsed[-1]


@pytest.mark.parametrize("call", ["T1 M6", "T1 M6 G43", "T12\nM6\nG43 H12"])
def test_a_tool_call_moves_nothing(tmp_path, call):
    machine = machine_of("linuxcnc")
    motion = motion_of(tw.SlowToolServo(feed=0.2, points_per_rev=60, spindle_rpm=60), PART, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=None)
    text = (tmp_path / "part.nc").read_text()
    (tmp_path / "called.nc").write_text(text.replace("\nG21", f"\n{call}\nG21", 1))
    plain, called = (linuxcnc.interpret(tmp_path / f"{name}.nc", tmp_path) for name in ("part", "called"))
    assert [*called] == [*plain]
    for one, other in zip(plain.values(), called.values(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("example", "dialect"),
    [
        pytest.param(
            path, dialect, marks=[] if dialect in FASTEST.get(path.stem, ()) else [pytest.mark.proof],
            id=f"{path.stem}-{dialect}",
        )
        for path in sorted(EXAMPLES.glob("*.toml"))
        for dialect in ("generic", "linuxcnc")
    ],
)  # fmt: skip
def test_every_example_is_read_alike(tmp_path, example, dialect):
    job = Job.load(example)
    if example.stem in FASTEST:
        job = job.replace("strategy.feed", "0.1 mm/rev")
    job = replace(job, machine=replace(job.machine, dialect=dialect))
    if job.strategy.moves_fast_tool:
        pytest.skip("the table of a fast tool is no program")
    job = replace(job, program=replace(job.program, max_lines=10**9))
    program = Pipeline(job, out=tmp_path / "out").program
    cuts = linuxcnc.interpret(program.files[0], tmp_path)
    assert [*cuts] == [one.name for one in program.passes]
    for name, (x, y, z, c, time) in cuts.items():
        again = tw.read_nc(program.files[0], job.machine, name=name)
        at, axes = again.blocks, again.axes
        assert np.abs(x - axes["X"][at]).max() < 1e-9
        assert np.abs(z - axes["Z"][at]).max() < 1e-9
        if again.spindle_mode is None:
            # A C that counts on to millions of degrees has the rounding of such a number.
            rounding = 4 * np.spacing(np.abs(c).max())
            assert np.abs(np.diff(c) - np.diff(np.rad2deg(axes["C"]))).max() < 1e-9 + rounding
        # LinuxCNC moves X and Z by no less than 0.1 mm/min under G93, however long the block is to take.
        slowest = 60 * np.linalg.norm(np.diff([x, y, z]), axis=0) / 0.1
        planned = np.diff(again.time[at])
        floor = np.where((slowest > 0) & (again.spindle_mode is None), np.minimum(planned, slowest), planned)
        assert np.abs(np.diff(time) - floor).max() < 1e-9 * max(1.0, np.diff(time).max())


@pytest.mark.skipif(linuxcnc_planner.player() is None, reason="LinuxCNC is not installed: its planner plays nothing")
def test_the_planner_plays_what_is_promised(tmp_path):
    """Oracle: every servo cycle of LinuxCNC itself."""
    machine = linuxcnc_planner.lathe(2e5, 5000.0)
    motion = motion_of(tw.SlowToolServo(feed=0.2, points_per_rev=83, spindle_rpm=91), PART, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=None)
    again = tw.read_nc(tmp_path / "part.nc", machine)
    rows = linuxcnc_planner.play(tmp_path / "part.nc", machine, linuxcnc_planner.player())
    played, _, more = linuxcnc_planner.cut_of(rows, again, blend_blocks(again.time, again.axes, machine))
    assert abs(more) <= 2  # a block that takes a whole number of cycles is a matter of the last bit
    took = (len(played) - 1) * linuxcnc_planner.PERIOD
    assert tw.check_limits(again, machine).cycle_time_s == pytest.approx(took, rel=1e-3)
    assert motion.time[-1] == pytest.approx(took, rel=0.01)
    made, inner = tw.track(again), slice(20, -20)
    over_c = np.interp(np.deg2rad(played[inner, 5]), made.axes["C"], made.axes["Z"])
    assert np.std(played[inner, 4] - over_c) < 1e-6
