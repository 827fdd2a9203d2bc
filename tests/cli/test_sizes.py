"""Sizes that no lathe knows: each is carried out, or refused in a sentence; none is a defect.

Oracle: floating-point numbers end at 1.8e308 and 5e-324, so a square of the largest, and one over the smallest, do not
exist; code that computes with them unasked fails.
"""

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from job_files import written
from turnwright.cli import main
from turnwright.errors import InputError
from turnwright.units import LEAST, MOST, unit

HUGE, TINY, TINIEST = "1e308", "1e-308", "5e-324"

SURFACES = {
    "sphere": ({"family": "sphere", "radius": "50 mm"}, {"radius": "mm"}),
    "grid": (
        {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["1 mm", "1 mm"]},
        {"amplitude": "um", "period": "mm"},
    ),
    "asphere": (
        {"family": "even asphere", "radius": "40 mm", "conic": -0.8, "units": "mm", "terms": {"4": 2e-6}},
        {"conic": None, "terms.4": None},
    ),
    "biconic": (
        {"family": "biconic", "radius_x": "50 mm", "radius_y": "60 mm", "conic_x": 0.1, "conic_y": -1.0},
        {"radius_x": "mm", "radius_y": "mm", "conic_x": None},
    ),
    "zernike": ({"family": "zernike", "units": "um", "terms": {"5": 0.1}, "radius": "2 mm", "indexing": "fringe"},
                {"terms.5": None, "radius": "mm"}),
}  # fmt: skip

FIELDS = {
    "part.radius": "mm",
    "part.stock": "um",
    "tool.nose_radius": "mm",
    "tool.included": "deg",
    "tool.clearance": "deg",
    "tool.rake": "deg",
    "tool.waviness": "nm/rad",
    "actual.tool.radius_error": "um",
    "actual.tool.offset": "um",
    "strategy.feed": "um/rev",
    "strategy.spindle_speed": "rpm",
    "strategy.lead_in": "mm",
    "strategy.overrun": "mm",
    "passes.0.depth": "um",
    "simulation.patches.0.pixel": "um",
}


def checked(folder, capsys, *changes):
    """Return the exit code of ``turnwright check`` and what it says."""
    code = main(["check", str(written(folder, *changes))])
    message = capsys.readouterr()
    return code, " ".join((message.err + message.out).split())


def refused_or_done(report):
    code, message = report
    assert code in (0, 2), message
    assert "defect" not in message
    assert "nan" not in message.replace("nanotech", "")
    assert "RuntimeWarning" not in message
    assert "encountered" not in message  # as NumPy warns


@pytest.mark.parametrize(("place", "value"), every_second(FIELDS, [HUGE, f"-{HUGE}", TINY, TINIEST]))
def test_no_size_of_a_job_is_a_defect(tmp_path, capsys, place, value):
    text = f"{value} {FIELDS[place]}"
    given = {"tool.waviness": [text], "actual.tool.offset": [text, text, text]}.get(place, text)
    more = [("passes", [{"name": "rough", "allowance": "0 mm"}])] if place.startswith("passes") else []
    more += [("part.stock", "5 um")] if place.startswith("passes") else []
    refused_or_done(checked(tmp_path, capsys, *more, (place, given)))


@pytest.mark.parametrize(("family", "value"), every_second(SURFACES, [HUGE, TINY, TINIEST]))
def test_no_size_of_a_surface_is_a_defect(tmp_path, capsys, family, value):
    surface, places = SURFACES[family]
    for place, named in places.items():
        given = float(value) if named is None else f"{value} {named}"
        given = [given, given] if isinstance(surface[place.partition(".")[0]], list) else given
        refused_or_done(checked(tmp_path, capsys, ("part.surface", surface), (f"part.surface.{place}", given)))


def test_the_limit_says_what_how_much_and_the_remedy(tmp_path, capsys):
    code, message = checked(tmp_path, capsys, ("tool.nose_radius", "1e308 mm"))
    assert code == 2
    assert "tool.nose_radius: '1e308 mm' is above 1e+30 mm, the limit for any size: check its exponent" in message
    code, message = checked(tmp_path, capsys, ("strategy.feed", "1e-308 um/rev"))
    assert code == 2
    assert "'1e-308 um/rev' is below 1e-30 mm/rev, the limit for any size" in message
    with pytest.raises(InputError, match=r"nose_radius is 1e\+308 mm, the limits are 1e-30 to 1e\+30 mm: check"):
        tw.Tool(nose_radius=1e308)
    with pytest.raises(InputError, match="feed is 1e-308 mm/rev, the limits are"):
        tw.SlowToolServo(feed=1e-308, spindle_rpm=50, points_per_rev=120)


def test_a_wall_is_no_surface():
    wall = tw.Part(surface=tw.XYPolynomial(terms={(4, 0): 1e30}), radius=1.0)
    with pytest.raises(InputError, match=r"slope of 4e\+30 mm per mm .*, the limit is 1e\+06"):
        tw.check_access(wall, tw.Tool(nose_radius=0.5, clearance=np.deg2rad(10), included=np.deg2rad(60)))


def test_what_a_correction_finds_may_be_next_to_nothing():
    """A length that may be below nothing has no least size: what is left of an offset is 1e-40 mm as well as none."""
    assert unit("mm").read("1e-40 mm") == 1e-40
    assert unit("mm", above=0.0).read(f"{MOST:g} mm") == MOST
    assert unit("mm", above=0.0).read(f"{LEAST:g} mm") == LEAST
