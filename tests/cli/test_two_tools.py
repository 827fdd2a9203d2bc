"""Two tools in one job: each pass is planned, checked and called with its own."""

import re

import numpy as np
import pytest

import turnwright as tw
from turnwright.cli import main
from turnwright.errors import GougeError, JobError, LimitError
from turnwright.generation import generate_polar
from turnwright.job import Pipeline, find_wrong_move, run

ROUGH_TOOL = {"name": "R 1.5 mm", "nose_radius": "1.5 mm", "included": "110 deg", "clearance": "12 deg"}
SLOW = {"kind": "slow tool servo", "feed": "20 um/rev", "spindle_speed": "60 rpm", "points_per_rev": 90}
ROUGH = {"name": "rough", "tool": ROUGH_TOOL, "tool_call": "T0202", "allowance": "10 um", "depth": "25 um"}
PROGRAM = {"tool_call": "T0101", "change_height": "60 mm"}
TABLE = {
    "part": {
        "surface": {"family": "biconic", "radius_x": "20 mm", "radius_y": "-30 mm", "conic_x": 0.0, "conic_y": 0.0},
        "radius": "2 mm", "stock": "60 um",
    },
    "tool": {"name": "R 0.5 mm", "nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
    "machine": {"name": "nanoform"}, "strategy": SLOW, "passes": [ROUGH, {"name": "finish"}], "program": PROGRAM,
}  # fmt: skip


def job_of(**changes):
    return tw.Job.read({**TABLE, **changes})


def with_pass(**changes):
    return {"passes": [{**ROUGH, **changes}, {"name": "finish"}]}


@pytest.mark.parametrize("machine", ["nanoform", "nanotech-350fg"])
def test_each_pass_is_that_of_its_own_tool(tmp_path, machine):
    """Oracle: the same passes, each as the only one of a job with that tool."""
    job = job_of(machine={"name": machine})
    file = Pipeline(job, out=tmp_path).program.files[0]
    alone = {"machine": {"name": machine}, "passes": [{"name": "finish"}], "program": {}}
    for name, tool, lift in (
        ("rough 1", ROUGH_TOOL, 0.035),
        ("rough 2", ROUGH_TOOL, 0.01),
        ("finish", TABLE["tool"], 0.0),
    ):
        one = Pipeline(job_of(**alone, tool=tool)).motion
        again = tw.read_nc(file, job.machine, name=name)
        assert np.abs(again.axes["Z"] - one.axes["Z"] - lift).max() < 1e-6
        assert np.abs(again.axes["X"] - one.axes["X"]).max() < 1e-6


def test_a_program_goes_up_and_calls_the_next_tool(tmp_path):
    job = job_of()
    file = Pipeline(job, out=tmp_path).program.files[0]
    lines = [line for line in file.read_text().splitlines() if not line.startswith("(")]
    calls = [k for k, line in enumerate(lines) if re.match("T0", line)]
    assert [lines[k] for k in calls] == ["T0202", "T0101"]
    up = float(re.search(r"Z([\d.]+)", lines[calls[1] - 1])[1])
    assert up == pytest.approx(60 + max(float(one) for one in re.findall(r"Z([\d.]+) F500 \(CLEAR", file.read_text())))
    # Down again to the clear plane before anything else moves.
    assert lines[calls[1] + 2].startswith("G1 Z")
    assert "( TOOL FROM finish: T0101, R 0.5 mm )" in file.read_text()
    assert find_wrong_move(job, file) == ""


def test_a_job_with_two_tools_runs_and_reports_both(tmp_path, capsys):
    job = job_of(part={**TABLE["part"], "material": "aluminium 6061"})
    job.dump(tmp_path / "job.toml")
    assert tw.Job.load(tmp_path / "job.toml") == job
    assert main(["run", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "report.html").read_text()
    assert "T0202" in page
    assert "R 1.5 mm" in page
    assert main(["backplot", str(tmp_path / "out" / "part.nc"), "--job", str(tmp_path / "job.toml")]) == 0
    capsys.readouterr()


def test_the_plunge_of_the_finish_begins_on_what_the_rough_tool_left():
    """Oracle: the lower envelope of the rough tool's revolutions, which the edge of the other tool touches first.

    Outside the aperture of 2 mm the blank goes on at the slope of the rim where that rises, level where it falls.
    """
    job = job_of(part={**TABLE["part"], "surface": {"family": "sphere", "radius": "-30 mm"}})
    cuts = {cut.name: cut.motion for cut in Pipeline(job).cuts()}
    entry = Pipeline(job).entries(cuts)["finish"]
    radius, angle = np.linspace(0, 3, 3001), np.linspace(0, 2 * np.pi, 180, endpoint=False)
    left = generate_polar(cuts["rough 2"], job.passes[0].tool, radius=radius, angle=angle).z
    c, s, held = np.cos(angle)[:, None], np.sin(angle)[:, None], np.minimum(radius, 2.0)
    zx, zy = job.part.surface.gradient(2.0 * c, 2.0 * s)
    blank = job.part.surface.sag(held * c, held * s) + np.maximum(zx * c + zy * s, 0.0) * (radius - held)
    left = np.fmin(left, blank + 0.06)
    x0, edge = cuts["finish"].axes["X"][0], job.tool.cutting_edge()
    near = np.abs(radius - x0) < 1.0
    contact = (left[:, near] - edge.profile(radius[near] - x0)[0]).max(axis=1)
    depth = (contact - np.interp(angle, *path_of(entry, cuts["finish"]), period=2 * np.pi)).max()
    assert entry.depth == pytest.approx(depth, abs=2e-3)


def path_of(entry, motion):
    angle = motion.axes["C"][0] + np.linspace(0, 2 * np.pi, entry.heights.size)
    return angle, entry.heights + motion.axes["Z"][0] - entry.heights[0]


def test_a_rough_tool_that_does_not_reach_is_refused():
    """Oracle: a concave radius of 2 mm, smaller than the nose of 3 mm."""
    part = {"surface": {"family": "sphere", "radius": "2 mm"}, "radius": "0.9 mm", "stock": "60 um"}
    job = job_of(part=part, **with_pass(tool={**ROUGH_TOOL, "nose_radius": "3 mm"}))
    with pytest.raises(GougeError, match="pass rough: nose_radius is 3 mm, the limit is 2 mm"):
        run(job)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (with_pass(tool_call=""), "states a tool and no tool_call"),
        ({"program": {"change_height": "60 mm"}}, "tool_call"),
        ({"program": {"tool_call": "T0101"}}, "program.change_height is missing"),
        (with_pass(tool_call="T0101"), "each tool needs its own offset"),
        (
            {
                "passes": [
                    ROUGH,
                    {**ROUGH, "name": "semi", "allowance": "5 um", "tool": {**ROUGH_TOOL, "nose_radius": "1 mm"}},
                    {"name": "finish"},
                ],
            },
            "passes[2].tool_call is 'T0202', as that of another tool in passes[1]",
        ),
        ({"passes": [{**ROUGH, "tool": None}, {"name": "finish"}]}, "states no tool and 'T0202' tool_call"),
        (
            {"passes": [{"name": "rough", "allowance": "10 um"}, {**ROUGH, "name": "finish", "allowance": "0 um"}]},
            "the last pass states a tool",
        ),
        (with_pass(tool_call="G1 X0"), "the words T, M6, G43, H and D are allowed"),
    ],
)
def test_tools_that_contradict_each_other_are_refused(changes, message):
    if changes.get("passes", [{}])[0].get("tool", 0) is None:
        del changes["passes"][0]["tool"]
    with pytest.raises(JobError, match=re.escape(message)):
        job_of(**changes)


def test_a_wrong_move_is_judged_with_the_tool_that_is_in_place(tmp_path):
    """Oracle: the shank of the rough tool meets the rim where that of the other tool does not."""
    shank = {"radius": "3 mm", "height": "2 mm"}
    part = {"surface": {"family": "sphere", "radius": "-40 mm"}, "radius": "5 mm", "stock": "60 um"}
    file = tmp_path / "hand.nc"
    dip = "G0 X7.5 Z5\nG0 Z-3\nG0 Z5\n"
    cut = "(PASS: {})\nG0 X5 C0 Z5\nG93\nG1 C10 X4.9 Z0.5 F60\nC20 X4.8 F60\nG94\nG0 Z50\n"
    for first, second, wrong in (("", dip, False), (dip, "", True)):
        file.write_text(
            f"G21 G90\nT0202\nG0 Z5\n{cut.format('rough')}{first}T0101\nG0 Z5\n{second}{cut.format('finish')}M30\n"
        )
        job = job_of(part=part, **with_pass(tool={**ROUGH_TOOL, "shank": shank}))
        assert ("shank" in find_wrong_move(job, file)) == wrong


def test_a_program_that_calls_a_tool_by_its_number_is_judged_with_that_tool(tmp_path):
    """Oracle: only the rough tool, T0202, has a shank, which meets the rim."""
    shank = {"radius": "3 mm", "height": "2 mm"}
    part = {"surface": {"family": "sphere", "radius": "-40 mm"}, "radius": "5 mm", "stock": "60 um"}
    job = job_of(part=part, **with_pass(tool={**ROUGH_TOOL, "shank": shank}))
    file = tmp_path / "hand.nc"
    for call, wrong in (("T0101", False), ("T0202", True)):
        file.write_text(
            f"G21 G90\n{call}\nG0 Z5\nG0 X7.5\nG0 Z-3\nG0 Z5\nG0 X5 C0\nG93\nG1 C10 X4.9 Z0.5 F60\nC20 X4.8 F60\n"
            "G94\nG0 Z50\nM30\n"
        )
        assert ("shank" in find_wrong_move(job, file)) == wrong


def test_a_tool_change_stays_within_the_travel_of_z(tmp_path):
    job = job_of(program={**PROGRAM, "change_height": "600 mm"})
    with pytest.raises(LimitError, match=r"the tool is changed at Z 605\.\d* mm, the travel .* ends at 110 mm"):
        _ = Pipeline(job, out=tmp_path).program


def test_shank_and_holder_can_be_accepted_by_name():
    tool = {**TABLE["tool"], "shank": {"radius": "3 mm", "height": "0.05 mm"}}
    with pytest.raises(GougeError, match=r'accept = \["shank"\]'):
        run(job_of(tool=tool))
    assert "shank" in " ".join(run(job_of(tool=tool, accept=["shank", "gouge"])).warnings)
