"""Job files: what they say is what is built; and running one, against closed forms and its own program."""

import csv
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from job_files import changed, written
from turnwright.errors import GougeError, JobError, LimitError, Stopped
from turnwright.job import Job, preview, run
from turnwright.post import read_nc

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.toml"))
X, Y = np.meshgrid(np.linspace(-0.9, 0.9, 13), np.linspace(-0.8, 0.8, 11))
TURN = np.deg2rad(30)

# The table of a family, and the same surface built directly.
FAMILIES = {
    "plane": ({"slope": [0.01, -0.02]}, tw.Plane(slope=(0.01, -0.02))),
    "sphere": ({"radius": "-2 cm"}, tw.Sphere(radius=-20)),
    "conic": ({"radius": "61.5 mm", "conic": -1.5}, tw.Conic(radius=61.5, conic=-1.5)),
    "even asphere": (
        {"radius": "flat", "conic": 0, "terms": {"4": "2e-3 1/mm^3", "6": "-1e-3 mm^-5"}},
        tw.EvenAsphere(radius=math.inf, conic=0, terms={4: 2e-3, 6: -1e-3}),
    ),
    "toroid": ({"radius_x": "10 mm", "radius_y": "flat"}, tw.Toroid(radius_x=10, radius_y=math.inf)),
    "biconic": (
        {"radius_x": "10 mm", "radius_y": "20 mm", "conic_x": 1, "conic_y": -1.0},
        tw.Biconic(radius_x=10, radius_y=20, conic_x=1, conic_y=-1),
    ),
    "xy polynomial": (
        {"units": "um", "terms": {"2,0": 1e-6, "0,0": 3, "1, 1": "2e-3 1/mm"}},
        tw.XYPolynomial(terms={(2, 0): 1e-3, (0, 0): 3e-3, (1, 1): 2e-3}),
    ),
    "radial polynomial": (
        {"units": "mm", "radial": [-3.62e-3, 8.5e-8], "slope": [-1.01e-3], "tilt": 0.0262},
        tw.RadialPolynomial(radial=(-3.62e-3, 8.5e-8), slope=(-1.01e-3,), tilt=0.0262),
    ),
    "zernike": (
        {"indexing": "noll", "radius": "2 mm", "units": "um", "terms": {"4": 20, "11": "3 nm"}},
        tw.Zernike(indexing="noll", radius=2, terms={4: 0.02, 11: 3e-6}),
    ),
    "forbes": (
        {"radius": "30 mm", "conic": 0, "norm_radius": "2 mm", "kind": "q2d", "terms": {"0,2": "1 um", "1,-1": "2 um"}},
        tw.Forbes(radius=30, conic=0, norm_radius=2, kind="q2d", terms={(0, 2): 1e-3, (1, -1): 2e-3}),
    ),
    "sine grid": (
        {"amplitude": ["2 um", "1 um"], "period": ["2.5 mm", "2 mm"], "phase": ["90 deg", "0 deg"]},
        tw.SineGrid(amplitude=(0.002, 0.001), period=(2.5, 2), phase=(math.pi / 2, 0)),
    ),
    "lens array": (
        {"layout": "hexagonal", "pitch": "0.5 mm", "rings": 2, "aperture": "0.2 mm", "surround": "5 um",
         "lenslet": {"family": "sphere", "radius": "3 mm"}},
        tw.LensArray.hexagonal(pitch=0.5, rings=2, aperture=0.2, surround=0.005, lenslet=tw.Sphere(radius=3)),
    ),
    "expression": (
        {"units": "mm", "formula": "a*x**3", "constants": {"a": 0.01}, "feature_size": "1 mm"},
        tw.Expression("a*x**3", constants={"a": 0.01}, feature_size=1.0),
    ),
    "off-axis": (
        {"parent": {"family": "conic", "radius": "100 mm", "conic": -1}, "distance": "40 mm", "azimuth": "30 deg"},
        tw.OffAxis(parent=tw.Conic(radius=100, conic=-1), distance=40, azimuth=TURN),
    ),
    "sum": (
        {"terms": [{"family": "sphere", "radius": "20 mm"}, {"family": "plane", "slope": [0.1, 0]}]},
        tw.Sphere(radius=20) + tw.Plane(slope=(0.1, 0)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("family", FAMILIES)
def test_each_family_is_built_as_its_class_builds_it(family):
    """Oracle: the class itself, with its parameters converted by hand."""
    table, direct = FAMILIES[family]
    placed = {"shift": ["0.1 mm", "0 mm", "3 um"], "rotation": "30 deg"}
    job = Job.read(changed(("part.surface", {"family": family, **table, "placed": placed})))
    moved = direct.placed(shift=(0.1, 0, 0.003), rotation=TURN)
    np.testing.assert_allclose(job.part.surface.sag(X, Y), moved.sag(X, Y), rtol=1e-13, atol=1e-15)
    assert Job.read(tomllib.loads(job.to_toml())) == job


def test_a_list_of_surfaces_is_their_sum():
    job = Job.read(changed(("part.surface", FAMILIES["sum"][0]["terms"])))
    np.testing.assert_allclose(job.part.surface.sag(X, Y), FAMILIES["sum"][1].sag(X, Y), rtol=1e-14)


def test_a_sag_table_is_read_in_its_units(tmp_path):
    nodes = np.linspace(-1500, 1500, 9)
    with (tmp_path / "sag.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["y / x", *nodes])
        rows.writerows([y, *(nodes**2 + y**2)] for y in nodes)
    table = {"family": "gridded", "file": "sag.csv", "units": "um", "sag_units": "nm"}
    job = Job.load(written(tmp_path, ("part.surface", table)))
    # z = (x² + y²) um² read as nm: a quadratic, which a bicubic spline reproduces
    np.testing.assert_allclose(job.part.surface.sag(X, Y), X**2 + Y**2, rtol=1e-12)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_is_a_job_and_survives_being_written(path):
    job = Job.load(path)
    assert Job.read(tomllib.loads(job.to_toml())) == job
    assert path.read_text().startswith("# ")


@pytest.mark.parametrize(
    ("place", "value", "sentence"),
    [
        ("pixel_size", "0 mm", "measurement.pixel_size: '0 mm' is not above 0 mm: "),
        ("pixel_size", "wide", "measurement.pixel_size: 'wide' does not start with a plain number: "),
        ("pixel_size", ["1 um", "0 um"], "measurement.pixel_size[2]: '0 um' is not above 0 mm: "),
        ("pixel_size", ["1 um", "2 um", "3 um"], "measurement.pixel_size has 3 values, the limit is 2: "),
        ("departure_from", "plan", "measurement.departure_from is 'plan', it must be 'design' or a table: "),
        ("departure_from", {"family": "spere"}, "measurement.departure_from has the family 'spere', "),
        ("departure_from", {}, "measurement.departure_from lacks the key family, "),
    ],
)
def test_a_field_of_several_kinds_is_refused_in_one_sentence(place, value, sentence):
    """The kind that the value is nearest to says what is wrong, under the name that the job has for the field."""
    table = changed(("measurement.quantity", "departure"), ("measurement.departure_from", "design"))
    table["measurement"][place] = value
    with pytest.raises(JobError) as refused:
        Job.read(table)
    (message,) = str(refused.value).splitlines()
    assert message.startswith(sentence)


def test_waviness_in_degrees_is_the_polynomial_in_degrees():
    job = Job.read(changed(("tool.waviness", ["2e-5 mm/deg", "1e-6 mm/deg^2", "-3e-8 mm/deg^3"])))
    sweep = np.linspace(-29, 29, 9)
    expected = 2e-5 * sweep + 1e-6 * sweep**2 - 3e-8 * sweep**3
    np.testing.assert_allclose(job.tool.deviation(np.deg2rad(sweep)), expected, rtol=1e-12, atol=1e-18)


def test_certificates_are_read_in_their_units(tmp_path):
    (tmp_path / "edge.csv").write_text("# a certificate\ndeviation [nm],sweep [deg]\n0,-30\n90,0\n0,15\n-20,30\n")
    (tmp_path / "slide.csv").write_text("x [mm],error [nm]\n0,0\n10,-50\n")
    path = written(tmp_path, ("tool.waviness_file", "edge.csv"), ("actual.machine.straightness_file", "slide.csv"))
    job = Job.load(path)
    np.testing.assert_allclose(job.tool.deviation(np.deg2rad([-30, 0, 15])), [0, 9e-5, 0], atol=1e-18)
    np.testing.assert_allclose(job.actual_machine.z_error([0, 5, 10]), [0, -25e-6, -50e-6], atol=1e-18)
    assert job.machine.straightness is None


def test_a_run_leaves_the_cusps_of_its_tool(tmp_path):
    """Oracle: a Z-placed path on a profile of curvature k leaves PV = f²/(8R(1 - kR)) and Sq = PV sqrt(4/45)."""
    stages = []
    result = run(Job.load(written(tmp_path)), out=tmp_path, progress=lambda stage, *_: stages.append(stage))
    pv = 0.02**2 / 8 / 0.5 / (1 - 0.5 / 50) * 1e6
    whole, patch = result.predictions
    assert patch.roughness.sq_nm == pytest.approx(pv * math.sqrt(4 / 45), rel=0.02)
    assert 0.95 * pv < whole.roughness.pv_nm < 1.02 * pv
    assert whole.error.z.min() > -1e-6  # never below the design but for the program's last decimal
    assert result.rounding_nm <= result.rounding_limit_nm < 1
    assert result.rounding_nm > 0.01  # it has been read back, rounded
    assert result.ok
    assert list(dict.fromkeys(stages)) == [
        "access", "depth of cut", "plan", "place", "drive", "limits", "approach", "write program", "read program",
        "compare", "simulate whole part", "roughness", "highest and lowest point", "simulate patch",
        "check moves",
    ]  # fmt: skip
    assert set(result.timings) == set(stages)
    assert 0.01 < result.peak_memory_gb < 4


def test_passes_take_the_stock_down_to_the_part(tmp_path):
    """Oracle: arithmetic. 60 um of stock go in 2 cuts of 20 um, then 16 um, then 4 um."""
    cuts = [
        {"name": "rough", "depth": "20 um", "allowance": "20 um"},
        {"name": "semi", "allowance": "4 um"},
        {"name": "finish"},
    ]
    job = Job.load(written(tmp_path, ("part.stock", "60 um"), ("passes", cuts)))
    result = run(job, out=tmp_path)
    assert [cut.name for cut in result.passes] == ["rough 1", "rough 2", "semi", "finish"]
    np.testing.assert_allclose([cut.depth for cut in result.passes], [0.02, 0.02, 0.016, 0.004], rtol=1e-12)
    program = {cut.name: read_nc(result.program.files[0], result.machine, name=cut.name) for cut in result.passes}
    for name, height in (("rough 1", 0.04), ("rough 2", 0.02), ("semi", 0.004)):
        np.testing.assert_allclose(program[name].axes["Z"] - program["finish"].axes["Z"], height, atol=1.1e-6)
        np.testing.assert_array_equal(program[name].axes["C"], program["finish"].axes["C"])


def test_a_pass_may_state_its_own_feed_and_points():
    cuts = [{"name": "rough", "feed": "40 um/rev", "chord": "50 nm"}, {"name": "finish", "feed": "10 um/rev"}]
    job = Job.read(changed(("passes", cuts)))
    rough, finish = (job.servo(cut) for cut in job.passes)
    assert (rough.feed, rough.chord, rough.points_per_rev) == (0.04, 5e-5, None)
    assert (finish.feed, finish.chord, finish.points_per_rev) == (0.01, None, 120)


def test_a_job_may_run_past_the_axis():
    job = Job.read(changed(("strategy.overrun", "5 um"), ("strategy.inside_out", True)))
    servo = job.servo(job.passes[0])
    assert (servo.overrun, servo.inside_out) == (0.005, True)
    with pytest.raises(tw.JobError, match=r"overrun"):
        Job.read(changed(("strategy.overrun", "-5 um")))


def test_the_actual_tool_leaves_its_own_error(tmp_path):
    """Oracle: a tool that stands 0.2 um too low cuts 200 nm too deep, and squareness tilts a flat into a cone."""
    flat = ("part.surface", {"family": "plane"})
    plan = run(Job.load(written(tmp_path, flat)))
    low = run(Job.load(written(tmp_path, flat, ("actual.tool.offset", ["0 um", "0 um", "-0.2 um"]))))
    np.testing.assert_allclose(low.predictions[0].error.z - plan.predictions[0].error.z, -2e-4, atol=1e-12)
    cone = run(Job.load(written(tmp_path, flat, ("actual.machine.squareness", "-35 um/m"))))
    known = run(Job.load(written(tmp_path, flat, ("machine.squareness", "-35 um/m"))))
    tilted = cone.predictions[0].error.z - plan.predictions[0].error.z
    np.testing.assert_allclose(tilted[:, [5, 20, 35]].mean(axis=0), -35e-6 * np.array([5, 20, 35]) / 40, rtol=0.02)
    np.testing.assert_allclose(known.predictions[0].error.z, plan.predictions[0].error.z, atol=1e-6)


VALLEYS = {"family": "lens array", "layout": "hexagonal", "pitch": "0.5 mm", "rings": 3,
           "lenslet": {"family": "sphere", "radius": "-5 mm"}}  # fmt: skip


def test_findings_end_a_run_unless_the_job_accepts_them(tmp_path):
    with pytest.raises(GougeError, match=r'accept it in the job: accept = \["valley"\]'):
        run(Job.load(written(tmp_path, ("part.surface", VALLEYS))))
    assert preview(Job.load(written(tmp_path, ("part.surface", VALLEYS)))).refused
    result = run(Job.load(written(tmp_path, ("part.surface", VALLEYS), ("accept", ["valley"]))))
    assert any("valley" in warning for warning in result.warnings)
    assert not result.ok


def test_gouges_along_the_normal_and_limits_are_findings_too(tmp_path):
    normal = [("part.surface", VALLEYS), ("strategy.along", "normal"), ("tool.nose_radius", "0.5 mm")]
    with pytest.raises(GougeError, match=r'nm below the surface, the limit is 0 nm: place it along "z"'):
        run(Job.load(written(tmp_path, *normal, ("accept", ["valley"]))))
    result = run(Job.load(written(tmp_path, *normal, ("accept", ["valley", "gouge"]))))
    assert result.least_clearance < -1e-6
    fast = [("strategy.spindle_speed", "490 rpm"), ("strategy.points_per_rev", 720)]
    with pytest.raises(LimitError, match="pass finish: "):
        run(Job.load(written(tmp_path, *fast)))
    assert not run(Job.load(written(tmp_path, *fast, ("accept", ["limits"])))).ok


def test_tolerances_that_are_not_kept_are_reported(tmp_path):
    tight = run(Job.load(written(tmp_path, ("tolerances.sq", "20 nm"), ("tolerances.form_pv", "1 um"))))
    assert [warning for warning in tight.warnings if "tolerance" in warning] == [
        f"patch: Sq is {tight.predictions[1].roughness.sq_nm:.4g} nm, the tolerance is 20 nm"
    ]


def test_a_stop_from_progress_leaves_no_program(tmp_path):
    def stop(stage, done, total):
        if stage == "write program" and done > 1:
            raise Stopped("enough")

    job = Job.load(written(tmp_path))
    with pytest.raises(Stopped):
        run(job, out=tmp_path, progress=stop)
    assert [entry.name for entry in tmp_path.iterdir()] == ["job.toml"]


def test_a_preview_counts_the_points_without_placing():
    """Oracle: turns times points, at the slower of block rate and spindle."""
    seen = preview(Job.read(changed(("strategy.lead_in", "0 mm"))))
    assert seen.points == {"finish": 50 * 120 + 1}
    machine = tw.Machine.load("generic")
    assert seen.shortest_s["finish"] == pytest.approx(max(6000 / machine.block_rate_hz, 50 * 60 / machine.spindle_rpm))
    assert not seen.refused


def test_a_run_without_a_folder_names_no_files_that_are_gone():
    result = run(Job.read(changed(("simulation.patches", []))))
    assert result.program.files == ()
    assert result.program.lines > 0
    assert len(result.program.hash) == 64


def test_a_run_makes_the_folder_that_it_is_given(tmp_path, monkeypatch):
    """A relative folder, two deep; a job that is refused makes none."""
    monkeypatch.chdir(tmp_path)
    result = run(Job.read(changed()), out="new/folder")
    assert [str(file) for file in result.program.files] == ["new/folder/part.nc"]
    assert (tmp_path / "new" / "folder" / "part.nc").is_file()
    with pytest.raises(GougeError):
        run(Job.read(changed(("tool.nose_radius", "60 mm"))), out="other/folder")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(("inside_out", "sense"), every_second([False, True], [1, -1]))
def test_what_decimals_may_change_holds_in_every_direction(tmp_path, sense, inside_out):
    """Where a pass ends on an azimuth that was looked at, a decimal of C took it away: 184 nm were allowed."""
    waves = [
        {"family": "toroid", "radius_x": "50 mm", "radius_y": "25 mm"},
        {"family": "sine grid", "amplitude": ["2 um", "1 um"], "period": ["0.8 mm", "0.8 mm"]},
    ]
    changes = (("part.surface", waves), ("strategy.sense", sense), ("strategy.inside_out", inside_out))
    result = tw.run(Job.read(changed(*changes)), out=tmp_path)
    assert result.rounding_nm < result.rounding_limit_nm < 1.0
