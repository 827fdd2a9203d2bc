"""Cuts and plunges that go below the finished surface: ours never do, a wrong one is refused with its place.

Oracle: closed forms of planes and of a round nose, at dense places along each block and at the corners themselves.
"""

import math
import re

import numpy as np
import pytest

import proof_moves
import turnwright as tw
from turnwright.cli import main
from turnwright.job import Pipeline, find_wrong_move

NOSE, HALF = 0.8585, math.radians(62)
TOOL = {"nose_radius": f"{NOSE} mm", "included": "124 deg", "clearance": "25 deg"}
SLOW = {
    "kind": "slow tool servo", "feed": "82.929 um/rev", "points_per_rev": 186, "spindle_speed": "25.222 rpm",
    "sense": -1,
}  # fmt: skip
FOUR = ((2.6478, -0.7943), (1.3239, 2.6478), (-2.1182, 1.5887), (-1.5887, -2.6478))
PAIR = (
    (FOUR, (5.676119869761868, -3.1058905340434837), 0.34827633225748045, 83.4),
    (((0.808, -0.644), (0.808, 0.644), (-0.808, 0.644), (-0.808, -0.644)),
     (-6.387075265815857, 3.4949150235534034), 2.07934589791903, (0.0249, -0.0342)),
)  # fmt: skip
ONE = ((FOUR, (5.676, -3.106), 0.348, (0.033, 0.012)),)


def lengths(*values):
    return [f"{one!r} mm" for one in values]


def surface_of(form):
    """A sphere of that radius, or a plane of that slope."""
    if isinstance(form, float):
        return {"family": "sphere", "radius": f"{form} mm"}
    return {"family": "plane", "slope": form}


def job_of(parts, **more):
    """A chuck of spheres and tilted planes on polygons, with place and rotation; or a plane by its outline."""
    if len(parts) == 1:
        ((corners, place, turned, slope),) = parts
        c, s = math.cos(turned), math.sin(turned)
        x, y = place
        formula = f"{slope[0]}*({c}*(x-{x})+{s}*(y-{y}))+{slope[1]}*({c}*(y-{y})-{s}*(x-{x}))".replace("--", "+")
        part = {
            "surface": {"family": "expression", "formula": formula, "units": "mm"},
            "outline": {"polygon": [lengths(*one) for one in corners], "centre": lengths(*place),
                        "angle": f"{turned} rad"},
        }  # fmt: skip
    else:
        mounted = [
            {"name": f"P{number}", "surface": surface_of(form),
             "outline": {"polygon": [lengths(*one) for one in corners]}, "position": lengths(*place),
             "clocking": f"{turned} rad"}
            for number, (corners, place, turned, form) in enumerate(parts)
        ]  # fmt: skip
        part = {"surface": {"family": "chuck", "parts": mounted}}
    table = {"part": {**part, "stock": "10 um", "air_clearance": "50 um"}, "tool": TOOL, "strategy": SLOW}
    return tw.Job.read({**table, "machine": {"name": "nanoform"}, **more})


def depth_of(parts, x, z, c):
    """Greatest depth of the nose below any part, of tips at X, Z, C; at places 0.2 um apart near a corner."""
    far = NOSE * math.sin(HALF)
    deepest = -np.inf
    for corners, (px, py), turned, form in parts:
        for tip_x, tip_z, angle in zip(x, z, c, strict=True):
            u = np.linspace(-far, far, 4001)
            a, b = (tip_x + u) * math.cos(angle) - px, (tip_x + u) * math.sin(angle) - py
            a, b = math.cos(turned) * a + math.sin(turned) * b, math.cos(turned) * b - math.sin(turned) * a
            on = np.ones(u.size, dtype=bool)
            for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True):
                on &= (x1 - x0) * (b - y0) - (y1 - y0) * (a - x0) >= 0
            if isinstance(form, float):
                height = form - np.sqrt(form**2 - a**2 - b**2)
            else:
                height = form[0] * a + form[1] * b
            below = height - tip_z - NOSE + np.sqrt(NOSE**2 - u**2)
            deepest = max(deepest, float(below.max(where=on, initial=-np.inf)))
    return deepest


def first_turns(text, count=300):
    """X, Z [mm] and C [rad] of the last blocks of the plunge and the first of the pass, 20 to each block."""
    text = text[text.index("\nG93\n") :]
    rows = re.findall(r"X(-?[\d.]+) Z(-?[\d.]+) C(-?[\d.]+)", text)
    last = count + text.partition("( PASS: finish )")[0].count(" C")
    points = np.array(rows[max(last - 2 * count, 0) : last], dtype=float)
    dense = np.arange(20 * (len(points) - 1)) / 20
    x, z, c = (np.interp(dense, np.arange(len(points)), column) for column in points.T)
    return x, z, np.deg2rad(c)


@pytest.mark.parametrize("parts", [PAIR, ONE], ids=["chuck", "outline"])
def test_the_tool_enters_above_every_corner(tmp_path, parts):
    # A corner between two points of the plunge, micrometres in it; the chords of a tilt of 0.035 at 9 mm are 45 nm.
    job = job_of(parts)
    file = Pipeline(job, out=tmp_path).program.files[0]
    assert depth_of(parts, *first_turns(file.read_text())) < 6e-5
    assert find_wrong_move(job, file) == ""


def test_random_programs_stay_above_every_part():
    """Three jobs, one plunges; oracle: an envelope of its own in spindle mode, on outlines and on chucks."""
    figures = proof_moves.Figures()
    proof_moves.run(3, 21, figures)
    assert proof_moves.failures(figures) == []
    assert figures.plunges
    # Each kind of move was looked at.
    assert np.isfinite([figures.depth, figures.resting, figures.stock, figures.body]).all()


def test_the_chord_of_a_coarse_cut_is_no_gouge(tmp_path):
    """Job 192 of the proof: most of its 84 blocks a turn in air, chords of 1.1 um. Oracle: that of the proof."""
    random = np.random.default_rng(1)
    for number in range(192):
        case = proof_moves.case_of(random, ("spindle", "outline", "chuck")[number % 3])
    job = tw.Job.read(case.table)
    file = Pipeline(job, out=tmp_path).program.files[0]
    figures = proof_moves.Figures()
    proof_moves.judge(case, file, figures)
    assert 1e-3 - case.chord < figures.depth <= 0
    assert find_wrong_move(job, file) == ""


CORNER = (((3.0, 0.0), (-1.0, 0.3), (-1.0, -0.3)), (5.0, 0.0), 0.0, (0.0, 0.0))
PLUNGE = "G21 G90\nG0 X8.3 Z5 C0\nG0 C10\nG0 Z0.2\n( PASS: finish, ENTRY )\nG93\n{}( PASS: finish )\n"
CUT = "C-14 X8.3 Z0.5 F60\nC-18 X8.3 Z0.5 F60\nG94\nG0 Z5\nM30\n"
HANDS = {
    # The corner is 0.3 mm inside the tip, the nose there 0.8585 - sqrt(0.8585^2 - 0.3^2) = 0.0541 mm above it.
    "over the corner": (f"{PLUNGE.format('G1 C6 X8.3 Z-.05 F60' + chr(10) + 'C-6 X8.3 Z-.05 F60' + chr(10))}{CUT}", ""),
    "the plunge through the corner": (
        f"{PLUNGE.format('G1 C6 X8.3 Z-.058 F60' + chr(10) + 'C-6 X8.3 Z-.058 F60' + chr(10))}{CUT}", "line 8 ",
    ),
    "the cut through the corner": (
        f"{PLUNGE.format('G1 C6 X8.3 Z.2 F60' + chr(10))}C4 X8.3 Z-.058 F60\nC-4 X8.3 Z-.058 F60\n{CUT}", "line 10 ",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), HANDS.values(), ids=HANDS)
def test_a_corner_between_two_points_is_not_missed(tmp_path, text, message):
    job = tw.Job.read({
        "part": {"surface": {"family": "plane"}, "outline": {
            "polygon": [lengths(*one) for one in CORNER[0]], "centre": lengths(*CORNER[1])}},
        "tool": TOOL, "strategy": SLOW, "machine": {"name": "nanoform"},
    })  # fmt: skip
    (tmp_path / "hand.nc").write_text(text)
    wrong = find_wrong_move(job, tmp_path / "hand.nc")
    assert message in wrong
    assert bool(wrong) == bool(message)
    if wrong:
        assert "3.88 um below the finished surface at x = 8 mm, y = 0 mm" in wrong


def lowered(text, first, count, depth, name="finish"):
    """Lower some blocks of a pass by a depth [mm]; return the text and the numbers of their lines."""
    lines = text.splitlines(keepends=True)
    begin = lines.index(f"( PASS: {name} )\n") + first
    for number in range(begin, begin + count):
        lines[number] = re.sub(r"Z(-?[\d.]+)", lambda z: f"Z{float(z[1]) - depth:.6f}", lines[number])
    return "".join(lines), range(begin + 1, begin + count + 1)


def on_part(text, parts):
    """Return the first block of the finish from which five in a row have their tips on a part."""
    cut = text[text.index("( PASS: finish )\n") :].splitlines()[1:]
    rows = [re.match(r"(?:G1 )?X(-?[\d.]+) Z(-?[\d.]+) C(-?[\d.]+)", line) for line in cut]
    number, run = 0, 0
    while run < 5:
        row = rows[number]
        x, c = (float(row[1]), math.radians(float(row[3]))) if row else (99.0, 0.0)
        run = (
            run + 1
            if any(math.hypot(x * math.cos(c) - px, x * math.sin(c) - py) < 1 for _, (px, py), *_ in parts)
            else 0
        )
        number += 1
    return number - 4


@pytest.mark.parametrize(
    "parts", [pytest.param(PAIR, id="chuck", marks=pytest.mark.proof), pytest.param(ONE, id="outline")]
)
@pytest.mark.filterwarnings("ignore::turnwright.post.ProgramWarning")
def test_backplot_refuses_a_gouge_in_the_finish_with_its_place(tmp_path, capsys, parts):
    job = job_of(parts)
    job.dump(tmp_path / "job.toml")
    file = Pipeline(job, out=tmp_path).program.files[0]
    text, lines = lowered(file.read_text(), on_part(file.read_text(), parts), 4, 0.05)
    file.write_text(text)
    assert main(["backplot", str(file), "--job", str(tmp_path / "job.toml")]) == 2
    message = " ".join(capsys.readouterr().err.split())
    place = re.search(r"line (\d+) moves the tool to X [\d.]+ mm, Z -?[\d.]+ mm, 50 um below .* x = .* y = ", message)
    assert place is not None
    assert int(place[1]) in lines


@pytest.mark.filterwarnings("ignore::turnwright.post.ProgramWarning")
def test_a_crossing_that_is_not_lifted_is_refused(tmp_path):
    """Two tables 1 mm apart in height: the crossing over the higher one stays at the height of the lower one."""
    job = tw.Job.read({
        "part": {"surface": {"family": "chuck", "parts": [
            {"name": name, "surface": {"family": "plane"}, "outline": {"rectangle": ["2 mm", "2 mm"]},
             "position": [f"{x} mm", "0 mm"], "height": height}
            for name, x, height in (("low", 6, "0 mm"), ("high", -6, "1 mm"))]}},
        "tool": TOOL, "strategy": {**SLOW, "feed": "0.3 mm/rev"}, "machine": {"name": "nanoform"},
    })  # fmt: skip
    file = Pipeline(job, out=tmp_path).program.files[0]
    assert find_wrong_move(job, file) == ""
    text = file.read_text()
    file.write_text(re.sub(r"Z1\.\d+( C)", r"Z0.000000\1", text))
    assert re.search(r"line \d+ moves the tool to X .*, 1 mm below the finished surface", find_wrong_move(job, file))
