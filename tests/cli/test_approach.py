"""How the tool comes to a pass: by programs that an independent reader follows, and closed forms of the edge."""

import dataclasses
import itertools
import math
import re

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import turnwright as tw
from cases import every_second
from job_files import changed
from proof_approach import Case, Figures, failures, judge, run
from turnwright.errors import GougeError, InputError, JobError, LimitError, ProgramError
from turnwright.job import Job, Pipeline, approach as _approach, preview
from turnwright.post import entry_path, plan_approach

FEW = ("simulation", {"whole_part": {"radii": 11, "angles": 8}})
DOME = (
    FEW, ("part.surface", {"family": "sphere", "radius": "-40 mm"}), ("part.radius", "5 mm"),
    ("strategy.feed", "0.1 mm/rev"), ("strategy.points_per_rev", 36), ("tool.included", "100 deg"),
)  # fmt: skip
BESIDE = (("part.stock", "50 um"), ("part.blank", {"radius": "5.2 mm"}), ("strategy.lead_in", "0.7 mm"))


def carried_out(folder, *changes):
    result = tw.run(Job.read(changed(*DOME, *changes)), out=folder)
    return result, [path.read_text() for path in result.program.files]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.proof)])
def test_random_programs_touch_nothing_at_rest(seed):
    figures = Figures()
    run(6, seed, figures)
    assert failures(figures)[:6] == [] or failures(figures) == ["jobs plunge, and jobs begin beside the blank"]
    assert figures.plunges


def test_a_pvt_plunge_keeps_its_feed_where_c_accelerates(tmp_path):
    """Steep waves in steps of 13.8 deg; oracle: dense contact heights, see `proof_approach`. It was 2.388 once."""
    lathe = 'base = "nanoform"\nname = "m"\ndialect = "pmac"\n[controller]\ninterpolation = "hermite"\n'
    (tmp_path / "pmac.toml").write_text(lathe)
    table = {
        "accept": ["limits"], "machine": {"file": str(tmp_path / "pmac.toml")},
        "part": {"radius": "1.333 mm", "surface": {
            "family": "expression", "units": "mm", "formula": "0.0179*sin(8*x)+0.01178*cos(7*y)"}},
        "tool": {"nose_radius": "0.7125 mm", "included": "146.33 deg", "clearance": "20 deg"},
        "strategy": {"kind": "slow tool servo", "feed": "0.02285 mm/rev", "points_per_rev": 26,
                     "spindle_speed": "93.13 rpm", "sense": -1, "lead_in": "0.671 mm"},
        "program": {"plunge_feed": "0.593 mm/min"},
    }  # fmt: skip
    case = Case(
        table, lambda x, y: 0.0179 * np.sin(8 * x) + 0.01178 * np.cos(7 * y), 1.333, 0.0, None, 0.7125,
        math.radians(146.33 / 2), 0.593, {"finish": 0.0},
    )  # fmt: skip
    figures = Figures()
    judge(case, "pmac", Pipeline(Job.read(table), out=tmp_path).program.files[0], figures)
    assert figures.plunges == 1
    assert figures.block <= 1 + 1e-6
    assert figures.gouge <= 2e-6


@pytest.mark.parametrize(
    ("stock", "included", "inside_out"), [("50 um", "100 deg", False), ("160 um", "120 deg", True)]
)
def test_the_part_turns_before_the_tool_touches_it(tmp_path, stock, included, inside_out):
    """What stood still before: a dome of R 40 mm, its stock taken off in one pass."""
    changes = (("part.stock", stock), ("tool.included", included), ("strategy.inside_out", inside_out))
    result, (text,) = carried_out(tmp_path, *changes)
    thickness = float(stock.split()[0]) / 1e3
    before = text[: text.index("( PASS: finish, ENTRY )")]
    down = float(re.findall(r"^G1 Z(-?[\d.]+) F100", before, re.MULTILINE)[-1])
    first = float(re.findall(r"Z(-?[\d.]+)", text[: text.rindex("\nG93\n")])[-1])
    assert down >= first + thickness + 0.1 - 1e-6
    plunge = text[text.index(", ENTRY )\nG93\n") : text.rindex("\nG93\n")]
    degrees = [float(one) for one in re.findall(r"C(-?[\d.]+)", plunge)]
    assert all(after > before for before, after in itertools.pairwise(degrees))
    # 2 revolutions a second: 36 blocks of 10 deg.
    heights = [float(one) for one in re.findall(r"Z(-?[\d.]+)", plunge)]
    minutes = [1 / float(one) for one in re.findall(r"F([\d.]+)", plunge)]
    assert (heights[0] - heights[-1]) / sum(minutes[1:]) <= 1.8 * (1 + 1e-4)
    assert result.entries["finish"].least_gap >= 0.1 - 1e-9


COARSE = (
    ("part.stock", "30 um"), ("strategy.feed", "50 um/rev"), ("tool.nose_radius", "0.3 mm"),
    ("tool.included", "150 deg"), ("tool.clearance", "40 deg"), ("program", {"plunge_feed": "1.8 mm/min"}),
)  # fmt: skip


def plunge_of(text):
    """Return X, Z, C in degrees and seconds of the blocks of a plunge."""
    entry = text[text.index("( PASS: finish, ENTRY )") : text.rindex("\nG93\n")]
    rows = re.findall(r"X(-?[\d.]+) Z(-?[\d.]+) C(-?[\d.]+) F([\d.]+)", entry)
    x, z, c, rate = np.array(rows, dtype=float).T
    return x, z, c, 60 / rate


def contact(height, x, theta, rim, nose=0.3):
    """Return the height of a round nose in contact by a dense maximum."""
    rho = np.linspace(max(x - 0.28, -rim), min(x + 0.28, rim), 200_001)
    z = height(rho * np.cos(theta), rho * np.sin(theta)) - nose + np.sqrt(nose**2 - (rho - x) ** 2)
    return z.max()


def test_a_plunge_stays_above_a_steep_freeform(tmp_path):
    # 121.5 nm below it once, a block before the pass.
    waves = {"family": "expression", "units": "mm", "formula": "0.02*sin(8*x)+0.02*cos(7*y)"}
    changes = (("part.surface", waves), ("part.radius", "0.8 mm"), ("strategy.inside_out", True))
    _, (text,) = carried_out(tmp_path, *COARSE, *changes)
    x, z, c, seconds = (one[-73:] for one in plunge_of(text))
    surface = [
        contact(lambda x, y: 0.02 * np.sin(8 * x) + 0.02 * np.cos(7 * y), at, np.deg2rad(degrees), 0.8)
        for at, degrees in zip(x, c, strict=True)
    ]
    above = z - surface
    assert above.min() > -0.7e-6
    assert above[-1] == pytest.approx(0, abs=0.7e-6)
    assert (-np.diff(above) / seconds[1:]).max() <= 0.03 + 1e-6 / seconds.min()


@pytest.mark.parametrize(("bend", "radius", "inside_out"), [(-1.2, 1.0, False), (3.0, 2.0, False), (0.8, 0.4, True)])
def test_no_block_of_a_plunge_exceeds_its_feed(tmp_path, bend, radius, inside_out):
    # At one radius of a sphere the centre of the nose stays at one height: 32.27 mm/min once for 1.8.
    changes = (
        ("part.surface", {"family": "sphere", "radius": f"{bend} mm"}), ("part.radius", f"{radius} mm"),
        ("strategy.inside_out", inside_out),
    )  # fmt: skip
    _, (text,) = carried_out(tmp_path, *COARSE, *changes)
    x, z, _, seconds = plunge_of(text)
    assert np.ptp(x) == 0
    assert (-np.diff(z) / seconds[1:]).max() * 60 <= 1.8 * (1 + 1e-3) + 60e-6 / seconds.min()
    apart = bend - 0.3
    assert z.min() >= apart - math.copysign(math.sqrt(apart**2 - x[0] ** 2), apart) - 0.7e-6


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_motion_alone_plunges_without_a_step(tmp_path, inside_out):
    part = tw.Part(surface=tw.Sphere(radius=-1.2), radius=1.0)
    tool = tw.Tool(nose_radius=0.3, included=np.deg2rad(150), clearance=np.deg2rad(40))
    servo = tw.SlowToolServo(feed=0.05, points_per_rev=36, spindle_rpm=500, inside_out=inside_out)
    machine = tw.Machine.load("generic")
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=0.025)
    x, z, _, seconds = plunge_of((tmp_path / "part.nc").read_text())
    assert (-np.diff(z) / seconds[1:]).max() * 60 <= 1.8 * (1 + 1e-3) + 60e-6 / seconds.min()
    lowest = math.sqrt(1.5**2 - x[0] ** 2) - 1.5
    assert z.min() >= lowest - 0.7e-6
    exact = np.full(37, lowest)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=0.025, entry_heights=exact)
    _, z, _, seconds = plunge_of((tmp_path / "part.nc").read_text())
    assert (-np.diff(z) / seconds[1:]).max() * 60 <= 1.8 * (1 + 1e-3) + 60e-6 / seconds.min()
    with pytest.raises(ProgramError, match="entry heights of shape"):
        tw.write_nc(motion, machine, tmp_path / "part.nc", depth=0.025, entry_heights=exact[1:])


@pytest.mark.parametrize("inside_out", [False, pytest.param(True, marks=pytest.mark.proof)])
def test_a_motion_alone_of_a_freeform_keeps_the_feed(tmp_path, inside_out):
    # Heights extrapolated to the radius of the plunge fell faster than the feed beyond the part's.
    part = tw.Part(surface=tw.Expression("0.005*sin(4*x)+0.005*cos(4*y)"), radius=1.0)
    tool = tw.Tool(nose_radius=0.3, included=np.deg2rad(150), clearance=np.deg2rad(40))
    servo = tw.SlowToolServo(feed=0.03, points_per_rev=72, spindle_rpm=100, lead_in=0.0, inside_out=inside_out)
    machine = tw.Machine.load("generic")
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=0.025, plunge_feed=0.6 / 60)
    x, z, c, seconds = (one[-145:] for one in plunge_of((tmp_path / "part.nc").read_text()))
    surface = [
        contact(lambda x, y: 0.005 * np.sin(4 * x) + 0.005 * np.cos(4 * y), at, np.deg2rad(degrees), 1.3)
        for at, degrees in zip(x, c, strict=True)
    ]
    fastest = (-np.diff(z - surface) / seconds[1:]).max() * 60
    assert fastest <= 0.6 * (1 + 1e-3) + 60e-6 / seconds.min()


def test_a_short_pass_of_fine_points_is_closed_by_few(tmp_path):
    # A step of 3e-9 rad made a turn of two thousand million points, and memory ended.
    machine = tw.Machine.load("generic")
    turned = np.arange(1000) * 1e-6
    axes = {"C": turned, "X": 1 - 1e-3 * turned, "Z": 0 * turned}
    motion = tw.Motion(time=0.01 * np.arange(1000.0), axes=axes, machine=machine)
    done = tw.write_nc(motion, machine, tmp_path / "part.nc", depth=0.0)
    plunge = done.approaches["finish"].plunge
    assert plunge.time.size <= 7200 * math.ceil(done.approaches["finish"].turns) + 1


def test_a_plunge_below_the_part_is_refused(tmp_path, monkeypatch):
    """The proof does not rest on the contact that the heights of the plunge are from."""
    exact = _approach.tip_height

    def low_at_one_place(*args, **kwargs):
        z = exact(*args, **kwargs).copy()
        z[-6:-3] -= 0.01
        return z

    monkeypatch.setattr(_approach, "tip_height", low_at_one_place)
    with pytest.raises(GougeError, match="in the plunge the edge comes"):
        carried_out(tmp_path, *COARSE)
    result, _ = carried_out(tmp_path, *COARSE, ("accept", ["gouge"]))
    assert result.program.files


def test_a_spiral_from_outside_the_blank_needs_no_plunge(tmp_path):
    result, (text,) = carried_out(tmp_path, *BESIDE)
    assert result.entries["finish"].depth is None
    assert "ENTRY )" not in text
    assert "BEGINS CLEAR OF THE MATERIAL" in text
    # Where the edge meets the blank's corner, from circle and dome alone: the tool begins farther out than that.
    nose, bend, rim = 0.5, 40.0, 5.0
    axis = 5.7
    fall = math.sqrt(bend**2 - rim**2) - bend
    below = math.sqrt((bend + nose) ** 2 - axis**2) - bend - nose
    assert axis - 5.2 > math.sqrt(nose**2 - (nose - (fall + 0.05 - below)) ** 2)
    shorter, (text,) = carried_out(tmp_path, *BESIDE[:2], ("strategy.lead_in", "0.3 mm"))
    assert shorter.entries["finish"].depth > 0.05
    assert "ENTRY )" in text


def test_without_a_blank_material_is_everywhere(tmp_path):
    result, _ = carried_out(tmp_path, BESIDE[0], BESIDE[2])
    assert result.entries["finish"].depth >= 0.05


@pytest.mark.parametrize("dialect", ["generic", "pmac"])
def test_c_counts_on_from_pass_to_pass(tmp_path, dialect):
    machine = {"name": "generic"}
    if dialect == "pmac":
        (tmp_path / "pmac.toml").write_text(
            'base = "nanoform"\nname = "m"\ndialect = "pmac"\n[controller]\ninterpolation = "hermite"\n'
        )
        machine = {"file": str(tmp_path / "pmac.toml")}
    cuts = [{"name": "rough", "depth": "20 um", "allowance": "10 um"}, {"name": "finish"}]
    result, (text,) = carried_out(tmp_path, ("machine", machine), ("part.stock", "50 um"), ("passes", cuts))
    assert [one.name for one in result.passes] == ["rough 1", "rough 2", "finish"]
    degrees = [float(one) for one in re.findall(r"^(?:G[01] )?(?:X.* )?C(-?[\d.]+)", text, re.MULTILINE)]
    assert 0 <= degrees[0] <= 360
    steps = np.diff(degrees)
    assert (steps >= 0).all()
    assert steps.max() <= 360
    assert degrees[-1] > 3 * 50 * 360
    machine = result.machine
    for one in result.passes:
        again = tw.read_nc(result.program.files[0], machine, name=one.name)
        assert again.time.size == one.points
        assert abs(again.axes["C"][0]) < 1e-9
    assert result.program.links_minutes > 0


@pytest.mark.parametrize("inside_out", [False, True])
def test_cubics_of_a_plunge_are_monotone_within_the_limits(tmp_path, inside_out):
    # Oracle: SciPy's Hermite cubics through the words of the program, block by block.
    base = tw.Machine.load("nanotech-350fg")
    machine = dataclasses.replace(base, dialect="pmac", controller=tw.Controller(interpolation="hermite"))
    part = tw.Part(surface=tw.Sphere(radius=-40.0), radius=1.0, stock=0.02)
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100), clearance=np.deg2rad(12))
    servo = tw.SlowToolServo(feed=0.02, points_per_rev=72, spindle_rpm=60, inside_out=inside_out)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=0.02)
    entry = (tmp_path / "part.nc").read_text().split("DWELL10")[1]
    words = re.findall(r"PVT([\d.]+)|^C(-?[\d.]+):(-?[\d.]+)", entry, re.MULTILINE)
    time, angle, speed, block = [0.0], [0.0], [0.0], 0.0
    for duration, position, velocity in words:
        block = float(duration) / 1e3 if duration else block
        if position:
            time.append(time[-1] + block)
            angle.append(float(position))
            speed.append(float(velocity))
    angle[0] = angle[1] - (angle[2] - angle[1])  # where C was sent before, one even step back
    sense = np.sign(angle[-1] - angle[0])
    curve = CubicHermiteSpline(time, sense * np.array(angle), sense * np.array(speed))
    dense = np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(time)])
    assert curve(dense, 1).min() >= -1e-6
    assert speed[-1] == 0.0
    highest = np.rad2deg(machine.axes["C"].acceleration)
    assert np.abs(curve(dense, 2)).max() <= highest * (1 + 1e-6)


def test_a_feed_word_has_the_decimals_of_its_dialect(tmp_path):
    _, (text,) = carried_out(tmp_path, ("part.stock", "50 um"), ("strategy.spindle_speed", "77.7 rpm"))
    assert max(len(one) for one in re.findall(r" F\d+\.(\d+)", text)) <= 6


@pytest.mark.parametrize("name", ["nanotech-350fg", "generic"])
def test_a_job_with_a_blank_reads_back(tmp_path, name):
    job = Job.read(changed(*DOME, *BESIDE, ("machine.name", name), ("program", {"plunge_feed": "1.2 mm/min"})))
    job.dump(tmp_path / "job.toml")
    again = Job.load(tmp_path / "job.toml")
    assert again == job
    assert again.part.blank == tw.Blank(radius=5.2)
    assert again.program.plunge_feed == 0.02


def test_what_cannot_be_a_blank_or_a_plunge():
    with pytest.raises(InputError, match=r"the blank reaches 4 mm .* clear aperture, 5 mm"):
        tw.Part(surface=tw.Plane(), radius=5.0, blank=tw.Blank(radius=4.0))
    with pytest.raises(InputError, match="blank radius"):
        tw.Blank(radius=0.0)
    with pytest.raises(JobError, match="plunge_feed is 120 mm/min, the limit is 60 mm/min"):
        Job.read(changed(("program", {"plunge_feed": "120 mm/min"})))


def test_sizes_of_a_slip_are_refused_or_warned_of(tmp_path):
    with pytest.raises(tw.TurnwrightError, match="depth of cut of 500 um, the edge allows"):
        carried_out(tmp_path, ("part.stock", "0.5 mm"))
    deep = preview(Job.read(changed(("part.stock", "50 mm"))))
    assert any("depth of cut of 50 mm" in one for one in deep.refused)
    assert any("stock is 50 mm, more than the nose_radius" in one for one in deep.warnings)
    wide = preview(Job.read(changed(("tool.nose_radius", "500 mm"), ("part.surface", {"family": "plane"}))))
    assert any("nose_radius is 500 mm" in one for one in wide.warnings)


def test_a_wall_higher_than_the_edge_is_warned_of(tmp_path):
    deep = (("part.stock", "0.4 mm"), ("tool.included", "120 deg"), ("passes", [{"name": "cut", "depth": "0.1 mm"}]))
    result, _ = carried_out(tmp_path, *deep)
    walls = [one for one in result.warnings if "plunges next to an uncut wall" in one]
    # The outer side of the edge, leaning away from the dome, cuts up to 0.254 mm outside its rim: the last two of four
    # passes of 0.1 mm leave more standing outside.
    assert [one.split(" plunges")[0] for one in walls] == ["pass cut 3", "pass cut 4"]
    beside = (("part.blank", {"radius": "5.2 mm"}), ("strategy.lead_in", "1.2 mm"))
    result, _ = carried_out(tmp_path, *deep, *beside)
    assert not [one for one in result.warnings if "plunges next to an uncut wall" in one]


@pytest.mark.parametrize(("kind", "inside_out"), every_second(["hybrid tool servo", "fast tool servo"], [False, True]))
def test_a_fast_tool_by_position_keeps_the_feed_of_a_plunge(tmp_path, kind, inside_out):
    # Between the radii of its table it was left to its controller: up to 1.3 times the feed against the part.
    bends = ("50 mm", "25 mm") if kind.startswith("hybrid") else ("5 m", "4 m")
    toroid = {"family": "toroid", "radius_x": bends[0], "radius_y": bends[1]}
    waves = {"family": "sine grid", "amplitude": ["2 um", "1 um"], "period": ["0.8 mm", "0.8 mm"]}
    lathe = (("strategy.base", toroid), ("strategy.blocks_per_rev", 90)) if kind.startswith("hybrid") else ()
    changes = (
        FEW, ("part.surface", [toroid, waves]), ("part.stock", "20 um"), ("tool.nose_radius", "0.3 mm"),
        ("tool.included", "120 deg"), ("tool.clearance", "12 deg"), ("machine.name", "nanoform-fts-70"),
        ("strategy.kind", kind), ("strategy.spindle_speed", "100 rpm"), ("strategy.points_per_rev", 360),
        ("strategy.inside_out", inside_out), ("strategy.lead_in", "0 mm"), ("program.fast_tool", "position"), *lathe,
    )  # fmt: skip
    result = tw.run(Job.read(changed(*changes)), out=tmp_path)
    x, z, c, seconds = plunge_of(result.program.files[0].read_text())
    lines = (tmp_path / "part.fast.csv").read_text().splitlines()
    table = np.array([[float(one) for one in line.split(",")] for line in lines if line[0] in "-0123456789"])
    entry = table[: np.flatnonzero(table[:, 0] != table[0, 0])[0]]
    assert len(entry) >= 360
    assert entry[0, 0] == x[-1]
    # At the rows of the table: its heights run straight over the angle, those of the program over that of a block.
    turned = np.rad2deg(np.unwrap(np.deg2rad(c)))
    at = np.linspace(turned[-1] - 360, turned[-1], 361)
    w = np.interp(at, *np.array(sorted(zip(entry[:, 1], entry[:, 2], strict=True))).T, period=360)
    both = np.interp(at, turned, z) + w
    bent = (50.0, 25.0) if kind.startswith("hybrid") else (5e3, 4e3)
    design = tw.Toroid(radius_x=bent[0], radius_y=bent[1]) + tw.SineGrid(amplitude=(2e-3, 1e-3), period=(0.8, 0.8))
    surface = np.array([contact(design.sag, x[0], np.deg2rad(one), 1.3) for one in at])
    above = both - surface
    each = np.diff(np.interp(at, turned, np.append(0, np.cumsum(seconds[1:]))))
    assert above[-1] == pytest.approx(0, abs=1.2e-6)
    assert above.min() > -2e-6
    assert (-np.diff(above) / each).max() <= 0.03 + 1.2e-6 / each.min()


def test_a_fast_tool_keeps_its_travel_in_a_plunge():
    job = Job.read(changed(("machine.name", "nanoform-fts-70")))
    travel = job.machine.axes["W"]
    assert not _approach._beyond_travel(job, "finish", {"W": np.array([travel.low, travel.high])})
    sentence = _approach._beyond_travel(job, "finish", {"W": np.array([travel.low, travel.high + 1e-4])})
    assert sentence.startswith("pass finish: in the plunge W moves from -0.035 to 0.0351 mm, its travel is -0.035")


def test_a_fast_tool_by_time_must_begin_outside_the_blank(tmp_path):
    waves = {"family": "sine grid", "amplitude": ["2 um", "2 um"], "period": ["0.5 mm", "0.5 mm"]}
    fast = (
        FEW, ("part.surface", waves), ("machine.name", "nanoform-fts-70"),
        ("strategy.kind", "fast tool servo"), ("strategy.spindle_speed", "60 rpm"), ("strategy.points_per_rev", 360),
        ("program", {"fast_tool": "time", "fast_tool_rate": "5 kHz"}),
    )  # fmt: skip
    with pytest.raises(LimitError, match=r"state part\.blank and a longer lead_in"):
        tw.run(Job.read(changed(*fast)), out=tmp_path)
    wide = (("part.blank", {"radius": "1.02 mm"}), ("strategy.lead_in", "0.3 mm"))
    result = tw.run(Job.read(changed(*fast, *wide)), out=tmp_path)
    assert result.entries["finish"].depth is None


def test_a_pvt_plunge_has_the_same_points_from_any_number_of_revolutions():
    """Uneven steps, and C that accelerates over the whole pass: which points begin the turn is a matter of the pass."""
    turned = np.append(0, np.cumsum(np.tile([0.4, 0.5, 0.6], 40)))
    speed = 30 + 60 * turned / turned[-1]
    time = np.append(0, np.cumsum(2 * np.diff(turned) / (speed[1:] + speed[:-1])))
    x = 5 - 0.01 * turned / (2 * np.pi)
    axes = {"C": turned, "X": x, "Z": 0.03 * x**2}
    machine = tw.Machine(name="t", axes={letter: tw.Axis() for letter in "CXZ"}, spindle_rpm=3000, block_rate_hz=1000)
    motion = tw.Motion(
        time=time, axes=axes, machine=machine,
        velocity={"C": speed, **{letter: np.gradient(axes[letter], time) for letter in "XZ"}},
    )  # fmt: skip
    angles = [entry_path(motion, most=most)[0] for most in (1, 2, 3)]
    np.testing.assert_array_equal(angles[0], angles[1])
    np.testing.assert_array_equal(angles[0], angles[2])
    assert plan_approach(motion, clearance=1.0, depth=0.01, plunge_feed=0.1, name="a").plunge is not None
