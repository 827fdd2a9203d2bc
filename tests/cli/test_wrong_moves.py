"""Moves of a program outside its cuts: those of Turnwright are safe, a wrong one is refused with its place."""

import re

import pytest

import turnwright as tw
from turnwright.cli import main
from turnwright.job import Pipeline, find_wrong_move

PART = {"surface": {"family": "sphere", "radius": "50 mm"}, "radius": "5 mm", "stock": "50 um"}
TOOL = {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"}
TURNING = {"kind": "turning", "feed": "20 um/rev", "spindle_speed": "1000 rpm", "chord": "10 nm"}
SLOW = {"kind": "slow tool servo", "feed": "50 um/rev", "spindle_speed": "60 rpm", "points_per_rev": 60}
PASSES = [{"name": "rough", "allowance": "10 um", "depth": "20 um"}, {"name": "finish"}]
PARTS = [{}, {"surface": {"family": "sphere", "radius": "-40 mm"}}, {"blank": {"radius": "5.2 mm"}}]


def job_of(strategy, machine="nanoform", **more):
    table = {"part": {**PART, **more}, "tool": TOOL, "machine": {"name": machine}, "strategy": strategy}
    return tw.Job.read({**table, "passes": PASSES})


@pytest.mark.parametrize("machine", ["nanoform", "nanotech-350fg"])
@pytest.mark.parametrize("more", PARTS)
@pytest.mark.parametrize("strategy", [TURNING, SLOW, {**SLOW, "inside_out": True}])
def test_programs_of_turnwright_have_no_wrong_move(tmp_path, strategy, machine, more):
    job = job_of(strategy, machine, **more)
    assert find_wrong_move(job, Pipeline(job, out=tmp_path).program.files[0]) == ""


WRONG = {
    "retract down": (r"G1 Z[\d.]+ F100 \(CLEAR OF THE PART\)\n(?=M05)", r"G1 Z-1 F100\n", "finished surface"),
    "through the part": (r"G1 Z[\d.]+ F500 \(CLEAR OF THE PART\)\n", r"G0 X0 Z-0.3\n", "X 0 mm"),
    "into the stock at rest": (r"(G97[^\n]+\n)(G1 Z)[\d.]+( F100)", r"G1 Z0.27 F100\n\1G1 Z0.4 F100", "stock"),
    "in rapid across": (r"G1 X[\d.]+ F500\n", r"G0 X-8\nG0 Z-0.1\nG0 X5.01\n", "in rapid"),
}


@pytest.mark.parametrize(("old", "new", "place"), WRONG.values(), ids=WRONG)
def test_a_wrong_move_is_refused_with_its_place(tmp_path, capsys, old, new, place):
    job = job_of(TURNING)
    file = Pipeline(job, out=tmp_path).program.files[0]
    text, count = re.subn(old, new, file.read_text(), count=1)
    assert count == 1
    file.write_text(text)
    job.dump(tmp_path / "job.toml")
    assert main(["backplot", str(file), "--job", str(tmp_path / "job.toml")]) == 2
    message = " ".join(capsys.readouterr().err.split())
    assert place in message
    assert re.search(r"line \d+ moves the tool to X", message)
    job.replace("accept", ["gouge"]).dump(tmp_path / "job.toml")
    assert main(["backplot", str(file), "--job", str(tmp_path / "job.toml")]) == 0
    assert "moves the tool to X" in " ".join(capsys.readouterr().err.split())


BALL, DOME = ({"family": "sphere", "radius": f"{r} mm"} for r in (20, -40))
TILT = {"family": "plane", "slope": [0.05, 0.0]}
HEAD = "G21 G90 G18\nG97 S1000 M3\nG94\n"
CUT = "G1 X0 Z0 F10\nG0 Z5\nM5\nM30\n"
REST = "G21 G90\nG0 X5 C180 Z1\nG0 Z-0.05\n"
TURN = "G0 Z5\nG93\nG1 C10 X4.9 F60\nC5 X4.8 F60\nG94\nG0 Z6\nM30\n"
HANDS = {
    # Contact of a nose of 5 mm with a ball of 20 mm at 6.75 mm from the axis: 15 - sqrt(15² - 6.75²).
    "a large nose in contact": (BALL, 9, 5, f"{HEAD}G0 X6.75 Z5\nG1 Z1.6047 F20\n{CUT}", ""),
    "deeper than that": (BALL, 9, 5, f"{HEAD}G0 X6.75 Z5\nG1 Z1.6017 F20\n{CUT}", "line 5 "),
    "a feed move through a dome": (
        DOME,
        5,
        0.5,
        f"{HEAD}G0 X10 Z5\nG0 Z-2\nG1 X0 F500\nG0 Z5\nG0 X5.1\nG1 Z0.5\n{CUT}",
        "line 6 ",
    ),
    "rapid into stock after a feed in air": (DOME, 5, 0.5, f"{HEAD}G1 Z10 F500\nG1 X3 F500\nG0 Z-0.08\n{CUT}", "stock"),
    "a long move through the apex": (DOME, 0.8, 0.1, f"{HEAD}G0 X100 Z5\nG0 Z-0.005\nG0 X-93\n{CUT}", "finished"),
    "X is not known": (DOME, 5, 0.5, f"{HEAD}G0 Z-1\nG0 X5\n{CUT}", "X is not known"),
    "beside the part": (DOME, 5, 0.5, f"{HEAD}G0 X8 Z5\nG0 Z-3\nG0 Z5\nG0 X5.1\nG1 Z-0.3 F9\nG0 Z0.5\n{CUT}", ""),
    "C turns in air": (
        TILT,
        5,
        0.5,
        f"{REST}G0 C178\n{TURN}",
        "",
    ),
    "C turns into the part": (
        TILT,
        5,
        0.5,
        f"{REST}G0 C20\n{TURN}",
        "line 4 ",
    ),
}


@pytest.mark.parametrize(("surface", "radius", "nose", "text", "message"), HANDS.values(), ids=HANDS)
def test_programs_by_hand_are_judged(tmp_path, surface, radius, nose, text, message):
    """Oracle: closed forms of the contact, and what each line does."""
    job = tw.Job.read({
        "part": {"surface": surface, "radius": f"{radius} mm", "stock": "50 um"},
        "tool": {"nose_radius": f"{nose} mm", "included": "120 deg", "clearance": "12 deg"},
        "machine": {"name": "nanoform"}, "strategy": SLOW,
    })  # fmt: skip
    (tmp_path / "hand.nc").write_text(text)
    wrong = find_wrong_move(job, tmp_path / "hand.nc")
    assert message in wrong
    assert bool(wrong) == bool(message)


AT_REST = "G21 G90\nG0 X0.7 C90 Z5\n"
SHANK = {"radius": "3 mm", "height": "2 mm"}
WALL = {"family": "expression", "formula": "1.5*(1 + tanh((x - 3.5)/0.1))", "units": "mm"}
BODIES = {
    # The rim of the dome, 5 mm from the axis, is at -0.314 mm: the shank 3 mm further in than X is at Z + 2 mm.
    "next to the dome": (DOME, f"{HEAD}G0 X8.1 Z5\nG0 Z-3\nG0 Z5\n{CUT}", ""),
    "shank into the rim": (DOME, f"{HEAD}G0 X7.9 Z5\nG0 Z-3\nG0 Z5\n{CUT}", "line 5 "),
    "shank over the rim": (DOME, f"{HEAD}G0 X7.9 Z5\nG0 Z-2.2\nG0 Z5\n{CUT}", ""),
    # A wall that is 2.1 mm high at x = 3.5 + 0.1 atanh(0.4) = 3.54 mm, at rest: the shank reaches X + 3 mm.
    "turned away from the wall": (WALL, f"{AT_REST}G0 X0.7 C180\nG0 Z0.1\n{TURN}", ""),
    "away from the wall": (WALL, f"{AT_REST}G0 X0.4 C0\nG0 Z0.1\n{TURN}", ""),
    "shank into the wall": (WALL, f"{AT_REST}G0 X0.7 C0\nG0 Z0.1\n{TURN}", "line 4 "),
}


@pytest.mark.parametrize(("surface", "text", "message"), BODIES.values(), ids=BODIES)
def test_the_shank_is_part_of_the_tool_in_every_move(tmp_path, surface, text, message):
    """Oracle: distances by hand."""
    job = tw.Job.read({
        "part": {"surface": surface, "radius": "5 mm"}, "tool": {**TOOL, "shank": SHANK},
        "machine": {"name": "nanoform"}, "strategy": SLOW,
    })  # fmt: skip
    (tmp_path / "hand.nc").write_text(text)
    wrong = find_wrong_move(job, tmp_path / "hand.nc")
    assert message in wrong
    assert ("brings its shank" in wrong) == bool(message)


def test_there_is_nothing_between_the_parts_of_a_chuck(tmp_path):
    """Oracle: by hand. Over the empty side of the chuck the shank is 7 mm from both parts."""
    parts = [
        {"name": name, "surface": {"family": "plane"}, "outline": {"disc": f"{radius} mm"},
         "position": [f"{x} mm", "0 mm"], "height": f"{z} mm"}
        for name, x, radius, z in (("low", 6, 2, 0), ("tall", -6, 0.4, 3))
    ]  # fmt: skip
    job = tw.Job.read({
        "part": {"surface": {"family": "chuck", "parts": parts}},
        "tool": {**TOOL, "shank": {"radius": "5 mm", "height": "2 mm"}},
        "machine": {"name": "nanoform"}, "strategy": SLOW,
    })  # fmt: skip
    for c, wrong in ((90, False), (175, True)):
        (tmp_path / "hand.nc").write_text(f"G21 G90\nG0 X5 C{c} Z10\nG0 Z0.5\nG0 Z10\nG0 X8 C0\nG0 Z0.1\n{TURN}")
        assert ("brings its shank" in find_wrong_move(job, tmp_path / "hand.nc")) == wrong
