"""What a diagnosis refuses, and in which words."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw

MACHINE = tw.Machine.load("generic")
TOOL = tw.Tool(nose_radius=1.5, included=np.deg2rad(120))
PART = tw.Part(surface=tw.Sphere(radius=10.0), radius=5.0)
X = np.linspace(-4.8, 4.8, 21)
MAP = tw.HeightMap(x=X, y=X, z=PART.surface.sag(*np.meshgrid(X, X) * np.array(0.7)))


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"error_sources": ("ogive",)}, "'ogive' is not one of offset x"),
        ({"error_sources": ()}, "0 error sources"),
        ({"error_sources": ("offset x", "offset x")}, "2 error sources have 1 different"),
        ({"reference": "sphere"}, "reference is 'sphere'"),
        ({"free": ("shift",)}, "'shift' cannot be free"),
        ({"sense": 0}, "sense is 0"),
        ({"waviness": ()}, r"powers of the waviness are \(\)"),
        ({"waviness": (3, 2)}, "must ascend"),
        ({"waviness": (3, 12)}, "at most 9"),
        ({"straightness": 2}, "is 2 positions"),
        ({"feed": -0.1}, "feed is -0.1"),
        ({"points": 0}, "points is 0"),
    ],
)
def test_requested_error_sources_must_exist(asked, words):
    with pytest.raises(tw.InputError, match=words):
        tw.diagnose(MAP, PART, TOOL, MACHINE, **asked)


def test_tool_and_machine_say_how_large_their_errors_are():
    """What neither says is as `ERROR_SOURCES` has it."""
    tool = replace(TOOL, plausible={"offset x": 1e-3})
    machine = replace(MACHINE, plausible={"squareness": 2e-6, "drift of Z": 1e-5})
    found = tw.diagnose(MAP, PART, tool, machine, error_sources=("offset x", "offset y", "squareness"), straightness=4)
    assert {one.name: one.plausible for one in found} == {"offset x": 1e-3, "offset y": 0.05, "squareness": 2e-6}
    with pytest.raises(tw.InputError, match="plausible has 'offset q'"):
        replace(TOOL, plausible={"offset q": 1e-3})
    with pytest.raises(tw.InputError, match="plausible squareness is -1 rad"):
        replace(MACHINE, plausible={"squareness": -1.0})


def test_maps_and_parts_go_together():
    with pytest.raises(tw.InputError, match="1 maps and 2 parts"):
        tw.diagnose(MAP, [PART, PART], TOOL, MACHINE)
    with pytest.raises(tw.InputError, match="0 maps"):
        tw.diagnose([], PART, TOOL, MACHINE)
    with pytest.raises(tw.InputError, match="no pixel size"):
        tw.diagnose(replace(MAP, calibrated=False), PART, TOOL, MACHINE)


def test_a_map_must_lie_where_the_tool_cuts():
    with pytest.raises(tw.InputError, match=r"0 of 0 points .* register the map first"):
        tw.diagnose(replace(MAP, x=X + 100), PART, TOOL, MACHINE)
    blunt = replace(TOOL, included=np.deg2rad(1))
    steep = replace(MAP, z=np.where(np.hypot(*MAP.points()) > 1.0, MAP.z, np.nan))
    with pytest.raises(tw.InputError, match="use the tool of the plan"):
        tw.diagnose(steep, PART, blunt, MACHINE)


def test_few_points_do_not_carry_many_numbers():
    few = replace(MAP, z=np.where(np.hypot(*MAP.points()) < 1.0, MAP.z, np.nan))
    with pytest.raises(tw.InputError, match="numbers and a pose need at least"):
        tw.diagnose(few, PART, TOOL, MACHINE)


def test_a_cause_of_ones_own_has_a_name_and_heights():
    with pytest.raises(tw.InputError, match="'waviness', it must be new"):
        tw.diagnosis.ErrorSource(name="waviness", signature=lambda cutting: cutting.x, typical=1.0)
    with pytest.raises(tw.InputError, match="typical"):
        tw.diagnosis.ErrorSource(name="drift", signature=lambda cutting: cutting.x, typical=0.0)
    wrong = tw.diagnosis.ErrorSource(name="drift", signature=lambda _cutting: np.zeros(3), typical=1.0)
    with pytest.raises(tw.InputError, match=r"'drift' has the shape \(3,\)"):
        tw.diagnose(MAP, PART, TOOL, MACHINE, error_sources=(wrong,))


def test_findings_go_by_place_and_name():
    found = tw.diagnose(MAP, PART, TOOL, MACHINE, error_sources=("offset x", "radius error"))
    assert len(found) == 2
    assert found["offset x"] in found[:2]
    assert {found[0].name, found[1].name} == {"offset x", "radius error"}
    with pytest.raises(tw.InputError, match="no finding 'ogive' among"):
        found["ogive"]


def test_the_centre_must_be_seen():
    with pytest.raises(tw.InputError, match="measure the centre more finely"):
        tw.diagnosis.centre_defect(MAP, PART, within=0.1)
