"""`turnwright plan`: from tolerances to a job that keeps them."""

import difflib
import re
import tomllib

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicHermiteSpline

import turnwright as tw
from job_files import written
from turnwright.cli import main
from turnwright.errors import JobError
from turnwright.job import Job, compare, comparison as _compare, plan, planning as _plan, run

TOLERANCES = {"form_pv": "300 nm", "sq": "20 nm"}


def test_a_plan_is_a_job_that_keeps_its_tolerances(tmp_path, capsys):
    """Oracle: `run` on the planned job warns of no tolerance, on the job's own grids."""
    job = written(tmp_path, ("tolerances", TOLERANCES), ("strategy.overrun", "5 um"))
    assert main(["plan", str(job), "--out", str(tmp_path / "planned.toml")]) == 0
    message = capsys.readouterr().out
    planned, asked = Job.load(tmp_path / "planned.toml"), Job.load(job)
    assert planned.strategy.feed != asked.strategy.feed
    assert planned.strategy.points_per_rev is None
    assert (planned.part, planned.tool, planned.machine) == (asked.part, asked.tool, asked.machine)
    for word in ("cusps", "points", "decimals", "servos", "nearest to its limit"):
        assert word in message
    assert main(["run", str(tmp_path / "planned.toml"), "--out", str(tmp_path / "out")]) == 0
    assert "the tolerance is" not in capsys.readouterr().err


WRITTEN_BY_HAND = """\
# Dome for the printer, drawing 4711
accept = []

[tolerances]   # from the drawing
sq = "20 nm"
form_pv = "0.3 um"

[strategy]
# as we always do it
feed = "10000 nm/rev"  # from the last job
kind = "slow tool servo"
points_per_rev = 360
spindle_speed = "100 rpm"

[part]
radius = "0.1 cm"   # clear aperture
surface = {family = "gridded", file = "sag.csv", units = "mm", sag_units = "mm"}

[machine]
name = "generic"

[tool]
nose_radius = '500 um'
included = "60 deg" # certificate
clearance = "0.15 rad"
"""


@pytest.mark.parametrize("elsewhere", [pytest.param(False, marks=pytest.mark.proof), True])
def test_a_plan_keeps_what_a_person_wrote(tmp_path, elsewhere):
    """Oracle: the lines of the file, by difflib, and tomllib."""
    shop, out = tmp_path / "shop", (tmp_path / "plans" if elsewhere else tmp_path / "shop")
    for folder in {shop, out}:
        folder.mkdir()
    axis = np.linspace(-1.2, 1.2, 13)
    table = np.column_stack([axis, (axis**2 + axis[:, None] ** 2) / 80])
    np.savetxt(shop / "sag.csv", table, delimiter=",", header="y/x," + ",".join(map(repr, axis.tolist())), comments="")
    (shop / "job.toml").write_bytes(WRITTEN_BY_HAND.replace("\n", "\r\n").encode())
    assert main(["plan", str(shop / "job.toml"), "--out", str(out / "planned.toml")]) == 0
    text = (out / "planned.toml").read_bytes().decode()
    assert text.count("\n") == text.count("\r\n")
    report = list(difflib.ndiff(WRITTEN_BY_HAND.splitlines(), text.splitlines()))
    lost, new = ([line[2:] for line in report if line[0] == sign] for sign in "-+")
    assert {line.partition(" = ")[0] for line in lost} <= {"feed", "points_per_rev", "spindle_speed", "surface"}
    assert any(line.startswith("surface") for line in lost) == elsewhere
    # The feed keeps its unit and its remark; what sets the points now is a new key.
    assert any(re.fullmatch(r'feed = "[0-9.]+ nm/rev"  # from the last job', line) for line in new)
    job = tomllib.loads(text)
    assert "points_per_rev" not in job["strategy"]
    assert job["strategy"]["chord"]
    assert (job["part"]["surface"]["file"] == "sag.csv") != elsewhere
    assert Job.load(out / "planned.toml").part == Job.load(shop / "job.toml").part


def test_what_is_there_is_kept(tmp_path, capsys):
    job = written(tmp_path, ("tolerances", TOLERANCES))
    before = job.read_bytes()
    assert main(["plan", str(job), "--out", str(job)]) == 2
    assert "already exists" in capsys.readouterr().err
    assert job.read_bytes() == before


def test_a_plan_needs_tolerances(tmp_path, capsys):
    job = written(tmp_path)
    assert main(["plan", str(job), "--out", str(tmp_path / "planned.toml")]) == 2
    assert "tolerances.form_pv and tolerances.sq" in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["job.toml"]


def test_a_tolerance_that_no_plan_keeps_is_one_sentence(tmp_path, capsys):
    job = written(tmp_path, ("tolerances", {"form_pv": "2 nm", "sq": "0.5 nm"}))
    assert main(["plan", str(job), "--out", str(tmp_path / "planned.toml")]) == 2
    message = capsys.readouterr().err.splitlines()
    assert message[-1].startswith("turnwright: ")
    assert "relax" in message[-1] or "smaller nose_radius" in message[-1]


@pytest.mark.parametrize(
    "changes",
    [
        [("strategy", {"kind": "adaptive tool servo", "scallop": "1 um", "chord": "1 um"})],
        [
            ("machine.name", "nanoform-fts-70"),
            ("strategy", {"kind": "fast tool servo", "feed": "1 um/rev", "points_per_rev": 100}),
            ("program", {"fast_tool": "position"}),
        ],
    ],
    ids=["adaptive", "fast"],
)
def test_other_strategies_are_planned_too(changes, tmp_path):
    """Oracle: `run` on the planned job, by its own maps."""
    waves = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["0.5 mm", "0.5 mm"]}
    job = Job.load(written(tmp_path, ("tolerances", TOLERANCES), ("part.surface", waves), ("part.radius", "0.4 mm"),
                           ("simulation", {"whole_part": {"radii": 800, "angles": 60}}), *changes))  # fmt: skip
    chosen = plan(job)
    assert chosen.limits.ok
    assert 15 < chosen.breakdown.sq_nm <= 20
    assert run(chosen.job, out=tmp_path).predictions[0].roughness.pv_nm <= 300


def test_a_strategy_without_a_chord_is_one_sentence(tmp_path):
    swing = {
        "kind": "quasi-elliptical tool servo",
        "feed": "5 um/rev",
        "points_per_rev": 360,
        "short": "skip",
        "shortest": "1 um",
    }
    with pytest.raises(JobError, match="choose another kind"):
        plan(Job.load(written(tmp_path, ("tolerances", TOLERANCES), ("strategy", swing))))


SERVO = """
name = "lathe with servos"
spindle_rpm = 1000
block_rate_hz = {rate}
dialect = "generic"
[controller]
{controller}
[axes.C]
acceleration = "50 rad/s^2"
[axes.X]
acceleration = "1000 mm/s^2"
[axes.Z]
acceleration = "1000 mm/s^2"
[axes.X.response]
frequency = "100 Hz"
damping = 0.7
velocity_feedforward = 1.0
[axes.Z.response]
frequency = "100 Hz"
damping = 0.7
velocity_feedforward = 1.0
"""
WAVES = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["1 mm", "1 mm"]}
CORRECTED = [("program.precorrect", True), ("simulation.tracking", True)]


def lathe(folder, *changes, controller="", rate=1000):
    (folder / "lathe.toml").write_text(SERVO.format(controller=controller, rate=rate), encoding="utf-8")
    return written(
        folder, ("machine", {"file": "lathe.toml"}), ("part.surface", WAVES), ("tolerances", TOLERANCES),
        ("simulation", {"whole_part": {"radii": 1001, "angles": 48}}), *changes,
    )  # fmt: skip


def candidate(job, number, monkeypatch):
    """Return one candidate of a comparison, the only one that is planned."""
    ways = _compare._strategies
    with monkeypatch.context() as patch:
        patch.setattr(_compare, "_strategies", lambda *asked: list(ways(*asked))[number : number + 1])
        (found,) = compare(job).candidates
    return found


@pytest.fixture(scope="module")
def steady(tmp_path_factory):
    """The plan of the job with servos, at one speed, as commanded."""
    return plan(Job.load(lathe(tmp_path_factory.mktemp("steady"))))


def test_the_fastest_offered_interpolation_is_taken(tmp_path, capsys):
    """Oracle: SciPy's cubic Hermite spline through the program read back, against the exact height of the tip."""
    job = lathe(tmp_path, controller='other_interpolations = { hermite = "pmac" }', rate=100)
    assert main(["plan", str(job), "--out", str(tmp_path / "planned.toml")]) == 0
    message = capsys.readouterr().out
    planned = Job.load(tmp_path / "planned.toml")
    assert planned.machine.controller.interpolation == "hermite"
    points = [int(re.search(rf"^{name}: (\d+) points", message, re.MULTILINE)[1]) for name in ("linear", "hermite")]
    assert points[1] < points[0]
    assert main(["run", str(tmp_path / "planned.toml"), "--out", str(tmp_path / "out")]) == 0
    assert "the tolerance is" not in capsys.readouterr().err
    program = tmp_path / "out" / "part.nc"
    assert "PVT" in program.read_text()
    again = tw.read_nc(program, planned.machine)
    # The plan knew how the program comes to speed and to rest.
    assert again.time.size == points[1]
    share = float(re.search(r"points ±(\S+) nm, decimals", message)[1])
    # As closely at both ends, from rest and to rest, as elsewhere.
    first, last = again.time[[0, -1]]
    time = np.unique(
        np.concatenate([np.linspace(first, last, 4001), first + np.linspace(0, 2, 999), last - np.linspace(0, 2, 999)])
    )
    made = {one: CubicHermiteSpline(again.time, again.axes[one], again.velocity[one])(time) for one in "CXZ"}
    spiral = tw.path.Spiral(angle=made["C"], radius=made["X"])
    exact = tw.place(spiral, planned.part, planned.tool)
    off = np.abs(made["Z"] - exact.z).max() * 1e6
    assert 0.3 * share < off < 1.1 * share
    assert main(["backplot", str(program), "--job", str(tmp_path / "planned.toml")]) == 0
    capsys.readouterr()


def test_an_interpolation_by_cubics_is_compared(tmp_path, monkeypatch):
    job = lathe(
        tmp_path, ("part.radius", "0.3 mm"), ("machine.interpolation", "hermite"),
        controller='other_interpolations = { hermite = "pmac" }', rate=100,
    )  # fmt: skip
    assert candidate(Job.load(job), 1, monkeypatch).breakdown.chord_nm > 0


@pytest.mark.proof
def test_the_error_of_points_falls_with_their_spacing(tmp_path):
    """A part whose azimuths are no multiple of those looked at: 161 of them. Oracle: `run` on the planned job."""
    grid = {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["0.5 mm", "0.5 mm"]}
    job = lathe(
        tmp_path, ("part.surface", grid), ("part.radius", "0.4 mm"), ("machine.interpolation", "hermite"),
        ("strategy", {"kind": "slow tool servo", "feed": "10 um/rev", "chord": "10 nm"}),
        ("tolerances", {"form_pv": "100 nm", "sq": "10 nm"}), controller='other_interpolations = { hermite = "pmac" }',
    )  # fmt: skip
    file = tmp_path / "lathe.toml"
    file.write_text(file.read_text().partition("[axes.X.response]")[0], encoding="utf-8")
    found = plan(Job.load(job))
    assert found.limits.points < 40_000
    assert found.breakdown.pv_nm <= 100


def test_error_not_caused_by_the_points_ends_the_search(tmp_path, monkeypatch):
    asked = []

    def stays(_, points):
        asked.append(points.plan.spiral.angle.size)
        return 37e-6

    monkeypatch.setattr(_plan._Search, "_point_error", stays)
    job = lathe(
        tmp_path, ("machine.interpolation", "hermite"), controller='other_interpolations = { hermite = "pmac" }'
    )
    with pytest.raises(tw.LimitError, match=r"cannot follow the path within .* leave 37 nm"):
        plan(Job.load(job))
    assert asked[-1] < 100 * asked[0]
    monkeypatch.setattr(_plan, "MAX_POINTS", 2 * asked[0])
    with pytest.raises(tw.LimitError, match=r"needs .* points, the limit of a plan is"):
        plan(Job.load(job))


def test_a_job_that_asks_for_an_interpolation_gets_it(steady, tmp_path, monkeypatch):
    monkeypatch.setattr(_plan, "_plan_interpolation", lambda *_: steady)
    job = Job.load(
        lathe(tmp_path, ("machine.interpolation", "linear"), controller='other_interpolations = { hermite = "pmac" }')
    )
    assert [one.interpolation for one in plan(job).tried] == ["linear"]


@pytest.mark.parametrize(
    ("controller", "changes", "sentence"),
    [
        ("", {"interpolation": "hermite"}, "the controller of lathe with servos offers linear"),
        ('other_interpolations = { hermite = "generic" }', {"interpolation": "hermite"},
         "linear, which the dialect generic selects"),
        ('other_interpolations = { hermite = "pmac" }', {"dialect": "pmac"}, "has linear"),
        ('other_interpolations = { linear = "pmac" }', {}, "which is the interpolation already"),
        ('other_interpolations = { nurbs = "pmac" }', {}, "it must be one of linear"),
        ('other_interpolations = ["hermite"]', {}, "other_interpolations is"),
    ],
)  # fmt: skip
def test_what_controller_or_dialect_cannot_do_is_one_sentence(controller, changes, sentence, tmp_path):
    with pytest.raises(JobError, match=re.escape(sentence)) as refused:
        Job.load(lathe(tmp_path, *((f"machine.{key}", value) for key, value in changes.items()), controller=controller))
    assert "\n" not in str(refused.value)


def test_a_corrected_plan_is_faster_and_keeps_the_limits(steady, tmp_path):
    """Oracle: `run` on the planned job, by its own maps and by the limits of what it writes."""
    job = Job.load(lathe(tmp_path, *CORRECTED))
    chosen = plan(job)
    assert chosen.limits.cycle_time_s < 0.7 * steady.limits.cycle_time_s
    assert chosen.job.program.precorrect
    made = run(chosen.job, out=tmp_path)
    assert made.limits.ok
    assert made.limits.cycle_time_s == pytest.approx(chosen.limits.cycle_time_s, rel=1e-9)
    (whole,) = made.predictions
    assert whole.roughness.pv_nm <= 300
    assert np.abs(whole.tracking.z).max() * 1e6 <= 1.02 * chosen.breakdown.tracking_nm


@pytest.mark.parametrize(
    "corrected", [pytest.param((), id="commanded", marks=pytest.mark.proof), pytest.param(CORRECTED, id="corrected")]
)
def test_a_speed_over_the_radius_lets_every_ring_use_its_share(corrected, steady, tmp_path, monkeypatch):
    """Oracles: the integral of the stated speeds by SciPy, and `run` by its own maps."""
    job = Job.load(lathe(tmp_path, *corrected, controller="variable_speed = true"))
    chosen = plan(job)
    assert chosen.limits.cycle_time_s < 0.8 * steady.limits.cycle_time_s
    assert chosen.limits.ok
    profile = chosen.job.strategy.spindle_speeds
    radius, rpm = profile.radius, profile.spindle_rpm
    assert rpm[0] > 1.3 * rpm[-1]
    chosen.job.dump(tmp_path / "planned.toml")
    again = Job.load(tmp_path / "planned.toml")
    assert again == chosen.job
    made = run(again, out=tmp_path)
    motion = tw.read_nc(tmp_path / "part.nc", again.machine)
    feed, ends = again.strategy.feed, np.sort(motion.axes["X"][[0, -1]])
    seconds, _ = quad(
        lambda at: 60 / np.sqrt(np.interp(at, radius, rpm**2)) / feed, *ends,
        points=radius[(radius > ends[0]) & (radius < ends[1])], limit=200,
    )  # fmt: skip
    assert made.limits.cycle_time_s == pytest.approx(seconds, rel=1e-3)
    assert made.predictions[0].roughness.pv_nm <= 300
    assert candidate(again, 2, monkeypatch).limits.cycle_time_s == pytest.approx(seconds, rel=1e-3)


def test_speeds_that_cannot_be_are_one_sentence(tmp_path):
    speeds = ("strategy.spindle_speeds", [["0 mm", "300 rpm"], ["1 mm", "200 rpm"]])
    varied = "variable_speed = true"
    for controller, changes, sentence in (
        ("", [speeds], "spindle speed varies over the radius"),
        (varied, [speeds, ("strategy.spindle_speed", "100 rpm")], "are both given"),
        (varied, [(speeds[0], speeds[1][::-1])], "do not ascend"),
        (varied, [(speeds[0], speeds[1][:1])], "needs 2"),
    ):
        with pytest.raises(JobError, match=sentence) as refused:
            Job.load(lathe(tmp_path, *changes, controller=controller))
        assert "\n" not in str(refused.value)
    own = ("passes", [{"name": "finish", "spindle_speed": "120 rpm"}])
    job = Job.load(lathe(tmp_path, speeds, own, controller=varied))
    assert run(job).limits.spindle_rpm == pytest.approx(120, rel=1e-9)
