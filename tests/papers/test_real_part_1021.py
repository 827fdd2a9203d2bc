"""A foreign program and the part it cut: number 1021 of rbliang's upm_toolpath_waviness (see examples/real_part_1021).

The design is z = 0.091/2 r² mm, 1.03 mm in radius, the nose about 0.2 mm. Oracles: closed forms of the cusps and of the
nose's tangent, a brute-force minimum over the 27 passes, and the slice of the part that a white light interferometer
measured. None of the figures comes from the authors' own simulation.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import find_peaks

from turnwright.generation import generate, generate_points
from turnwright.job import Job
from turnwright.machine import Machine
from turnwright.metrology import fit_edge, read_edge_trace, roughness
from turnwright.placing import tip_height
from turnwright.post import read_table
from turnwright.surface import EvenAsphere
from turnwright.tool import Tool

FOLDER = Path(__file__).parents[2] / "examples" / "real_part_1021"
BEND = 0.091  # second derivative of the design
DESIGN = EvenAsphere(radius=np.inf, conic=0.0, terms={2: BEND / 2})
NOSE = 0.2
TURN = 720  # points
NOMINAL = Tool(nose_radius=NOSE, included=np.deg2rad(120))
AZIMUTH, CENTRE = 150.0, 0.526  # of the slice: where it fits best [deg, mm]


@pytest.fixture(scope="module")
def motion():
    return read_table(FOLDER / "toolpath.csv", Machine.load("nanotech-350fg"), spindle_rpm=20)


@pytest.fixture(scope="module")
def knots(motion):
    """X and Z of the tip at azimuth 0, turn by turn."""
    return motion.axes["X"][::TURN], motion.axes["Z"][::TURN]


@pytest.fixture(scope="module")
def edge():
    u, height = read_edge_trace(FOLDER / "edge_trace.csv")
    return fit_edge(u, height, toward_x=1, cutoff=0.010, nose_radius=NOSE)


def predicted_slice(motion, tool, away):
    """Heights along a line through the axis; ``away`` is the signed distance from it. [mm]"""
    azimuth = np.deg2rad(AZIMUTH)
    return generate_points(motion, tool, x=away * np.cos(azimuth), y=away * np.sin(azimuth))


def measured_slice():
    x_um, z_nm = np.loadtxt(FOLDER / "measured_slice.csv", delimiter=",", skiprows=1).T
    return x_um * 1e-3 - CENTRE, z_nm


def fitted(motion, tool):
    """The predicted slice as the instrument shows it, without form: it removed one, so a parabola is free. [nm]"""
    away, measured = measured_slice()
    predicted = 1e6 * predicted_slice(motion, tool, away)
    form = np.polynomial.legendre.legvander(away / 0.5, 2)
    return predicted + form @ np.linalg.lstsq(form, measured - predicted, rcond=None)[0], measured


def test_feed_and_turns(motion, knots):
    turns = np.diff(motion.axes["C"][[0, -1]])[0] / (2 * np.pi)
    assert turns == pytest.approx(27, abs=1e-12)
    assert motion.sense == 1
    feed = -1e3 * np.diff(knots[0])
    assert feed[:-1].min() == pytest.approx(35.87, abs=0.001)
    assert feed[:-1].max() == pytest.approx(40.138, abs=0.001)
    assert feed[-1] == pytest.approx(15.642, abs=0.001)  # the last turn ends on the axis
    # The feed follows from a planned scallop of 1 um: sqrt(8 R h) is 40 um.
    assert np.median(feed) == pytest.approx(1e3 * np.sqrt(8 * NOSE * 1e-3), rel=0.02)


def test_between_turns_z_is_linear_in_x(motion, knots):
    """Concentric circles were joined: along a turn Z is a chord of the bowl, up to 0.0455/4 feed² = 18 nm too high."""
    x, z = motion.axes["X"], motion.axes["Z"]
    chord = np.interp(x, knots[0][::-1], knots[1][::-1])
    assert np.abs(chord - z).max() < 1.1e-6  # the digits of X and Z allow 0.5 (1 + 0.091 + 1) nm
    middle = np.interp(x, knots[0][::-1], BEND / 2 * knots[0][::-1] ** 2) - BEND / 2 * x * x
    assert 1e6 * middle.max() == pytest.approx(1e6 * BEND / 8 * 0.0401**2, rel=0.02)


def test_compensation_is_that_of_an_edge_with_three_lobes(knots):
    """The slope of Z - design between turns tells where the edge touches: u = (dZ/dX - f'(X)) / f''.

    A round nose would roll, u = R sin(slope) / (1 - ...), from 0 to 19 um. The program dwells at three places.
    """
    x, z = knots
    touch = np.diff(z - BEND / 2 * x * x) / np.diff(x) / BEND * 1e3
    rolling = BEND * NOSE / (1 - BEND * NOSE) * 0.5 * (x[1:] + x[:-1]) * 1e3
    places = [touch[:5], touch[6:19], touch[19:]]
    for place, at in zip(places, (18.7, 9.0, -5.5), strict=True):
        assert np.median(place) == pytest.approx(at, abs=0.3)
        assert np.ptp(place) < 1.8  # rolling over as many turns takes 3.5 to 9 um
    assert np.ptp(rolling[6:19]) > 8


def test_the_compensation_is_not_that_of_a_round_nose(knots):
    """By how much, in nm; the tip height of a round nose on a paraboloid is checked by its tangent."""
    x, z = knots
    round_nose = tip_height(DESIGN, NOMINAL, angle=np.zeros(x.size), radius=x, sense=1)
    contact = x.copy()
    for _ in range(60):
        contact = x + NOSE * np.sin(np.arctan(BEND * contact))
    tangent = BEND / 2 * contact**2 - NOSE * (1 - np.cos(np.arctan(BEND * contact)))
    assert np.abs(round_nose - tangent).max() < 1e-13
    off = 1e6 * (z - round_nose)
    assert off.min() == pytest.approx(-273.6, abs=0.5)
    assert off[-1] == 0
    # Nor with the tip misplaced along X by as much as fits best.
    line = np.column_stack([np.ones(x.size), x])
    left = off - line @ np.linalg.lstsq(line, off, rcond=None)[0]
    assert left.std() == pytest.approx(36, abs=1)


def test_generated_equals_the_lowest_of_all_passes(motion, knots):
    """At azimuth 0 the passes are known exactly, so a minimum over them is too."""
    radius = np.linspace(0.1, 1.0, 3001)  # passes from beyond the axis do not reach here
    lowest = (knots[1] + NOSE - np.sqrt(NOSE**2 - np.clip(radius[:, None] - knots[0], -0.15, 0.15) ** 2)).min(axis=1)
    made = generate_points(motion, NOMINAL, x=radius, y=np.zeros(radius.size))
    assert np.abs(made - lowest).max() < 1e-12


def test_scallops_are_those_of_the_feed(motion, knots):
    """PV = f² / (8 R' (1 - z'' R')), where R' = R cos³ is the edge's radius of curvature seen along Z at the slope."""
    x, _ = knots
    contact = x / (1 - BEND * NOSE)
    feed = x[1:-2] - x[2:-1]

    def above(at):
        r = at + 0.3 * feed[:, None] * np.linspace(-1, 1, 2001)
        made = generate_points(motion, NOMINAL, x=r.ravel(), y=np.zeros(r.size)).reshape(r.shape)
        return made - BEND / 2 * r * r

    valleys = [above(contact[k:][: feed.size, None]).min(axis=1) for k in (1, 2)]
    crest = above(0.5 * (contact[1:-2] + contact[2:-1])[:, None]).max(axis=1)
    height = 1e6 * (crest - 0.5 * (valleys[0] + valleys[1]))
    slope = BEND * 0.5 * (contact[1:-2] + contact[2:-1])
    local = NOSE * np.cos(np.arctan(slope)) ** 3
    expected = 1e6 * feed**2 / (8 * local * (1 - BEND * local))
    # The next term, f⁴ / 128 R³ = 2.5 nm, and unequal valleys, are left out of the formula.
    assert np.abs(height - expected).max() < 4
    assert np.median(height) == pytest.approx(1000, rel=0.01)  # as planned


def test_roughness_of_the_predicted_surface(motion):
    """Cusps of one height have Sq = PV sqrt(4/45) and Sa = 4 / (9 sqrt 3) PV; here PV is 1001 nm at the middle zone."""
    steps = 0.0005 * np.arange(-200, 201)
    patch = generate(motion, NOMINAL, x=0.5 + steps, y=steps)
    rough = roughness(patch, form=2)
    assert rough.sq_nm == pytest.approx(1001 * np.sqrt(4 / 45), rel=0.025)
    assert rough.sa_nm == pytest.approx(1001 * 4 / (9 * np.sqrt(3)), rel=0.025)
    assert rough.ssk == pytest.approx(0.639, abs=0.1)  # of a parabola: 2 sqrt(5) / 7


def test_the_part_as_measured_agrees_with_the_nominal_nose(motion):
    """The strongest oracle: no model, the part itself."""
    predicted, measured = fitted(motion, NOMINAL)
    assert np.corrcoef(predicted, measured)[0, 1] > 0.97
    assert (measured - predicted).std() < 70  # nm, of 302
    heights = []
    for profile in (predicted, measured):
        crests, _ = find_peaks(profile, prominence=500)
        valleys = [profile[a:b].min() for a, b in pairwise(crests)]
        heights.append(np.median(profile[crests[1:-1]] - 0.5 * (np.array(valleys[1:]) + valleys[:-1])))
    assert heights[1] == pytest.approx(heights[0], rel=0.05)


def test_the_edge_as_traced_was_not_the_edge_that_cut(motion, edge):
    """The waviness that the trace has at the tip is not in the part, whichever way round the tool is mounted."""
    assert edge.radius == pytest.approx(0.1935, abs=0.0005)
    assert edge.radius_std == pytest.approx(0.00044, abs=0.0001)
    u, height = read_edge_trace(FOLDER / "edge_trace.csv")
    turned = fit_edge(u, height, toward_x=-1, cutoff=0.010, nose_radius=NOSE)
    for tool in (edge.tool, turned.tool):
        predicted, measured = fitted(motion, tool)
        assert (measured - predicted).std() > 150


def test_the_files_of_the_example_belong_together(edge):
    """The waviness table and the radius error of the job are what the trace gives, to their last digit."""
    job = Job.load(FOLDER / "measured_edge.toml")
    tool = job.actual_tool
    assert tool.radius_error == pytest.approx(edge.tool.radius_error, abs=5e-6)
    assert tool.waviness.sweep == pytest.approx(edge.tool.waviness.sweep, abs=1e-6)
    assert tool.waviness.deviation == pytest.approx(edge.tool.waviness.deviation, abs=1e-7)
    assert Job.load(FOLDER / "nominal.toml").actual_tool.nose_radius == NOSE
