"""Li et al. 2018, Fig. 15: what Sq makes of nose radius, feed and spindle speed, on a flat and on the sinusoidal grid.

The maps are computed by docs/papers/li2018_fig15/make.py. Oracle: the exact standard deviation of circular arcs of the
nose, a feed wide, at 40 digits; on the grid divided by 1 - κR, where the profile along the radius has the curvature κ.
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mpmath
import numpy as np
import pytest

from turnwright.studies import Study, study

MAPS = Path(__file__).parents[2] / "docs" / "papers" / "li2018_fig15"
NAMES = ("nose-feed", "nose-speed", "feed-speed")
BEND = 0.002 * (2 * np.pi / 2.5) ** 2  # in the troughs of the grid; minus that on its crests


def arc_sq_nm(nose, feed):
    """Standard deviation of z = R - sqrt(R² - u²) over a feed."""
    with mpmath.workdps(40):
        nose, half = mpmath.mpf(float(nose)), mpmath.mpf(float(feed)) / 2
        mean = (half * mpmath.sqrt(nose**2 - half**2) + nose**2 * mpmath.asin(half / nose)) / (2 * half)
        return float(mpmath.sqrt(nose**2 - half**2 / 3 - mean**2)) * 1e6


def settings(found):
    """Nose radius [mm], feed [mm/rev] of every case."""
    names = [one.name for one in found.fields]
    nose = found["tool.nose_radius"] if "tool.nose_radius" in names else np.full(len(found), found.job.tool.nose_radius)
    speed = found["strategy.spindle_speed"] if "strategy.spindle_speed" in names else found.job.strategy.spindle_rpm
    return nose, found["strategy.feed"] / speed


def test_the_arc_is_the_parabola_for_a_small_feed():
    assert arc_sq_nm(0.514, 0.010) == pytest.approx(np.sqrt(4 / 45) * 0.010**2 / (8 * 0.514) * 1e6, rel=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_the_flat_is_the_closed_form_everywhere(name):
    found = Study.load(MAPS / f"flat-{name}")
    exact = [arc_sq_nm(*one) for one in zip(*settings(found), strict=True)]
    assert found.ok.all()
    assert len(found) >= 90
    # 0.5 % is asked for.
    np.testing.assert_allclose(found["sq_nm@askew"], exact, rtol=5e-4)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("place", "bend"), [("trough", BEND), ("crest", -BEND)])
def test_the_grid_is_the_closed_form_with_its_curvature(name, place, bend):
    found = Study.load(MAPS / f"grid-{name}")
    nose, feed = settings(found)
    exact = [arc_sq_nm(*one) for one in zip(nose, feed, strict=True)] / (1 - bend * nose)
    np.testing.assert_allclose(found[f"sq_nm@{place}"], exact, rtol=5e-3)
    # The curvature, which is up to 1.3 %, is seen.
    assert np.median(np.abs(found[f"sq_nm@{place}"] / exact - 1)) < 3e-4


@pytest.mark.parametrize("surface", ["flat", "grid"])
def test_sq_falls_with_nose_and_speed_and_rises_with_feed(surface):
    for name, trends in (("nose-feed", (-1, 1)), ("nose-speed", (-1, -1)), ("feed-speed", (1, -1))):
        found = Study.load(MAPS / f"{surface}-{name}")
        over = [one.name for one in found.fields if one.different.size > 1]
        grid = found.grid("sq_nm@askew", over=tuple(over)).values
        for axis, sign in enumerate(trends):
            assert (sign * np.diff(grid, axis=axis) > 0).all()


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("flat-nose-feed", (0, 89)),
        pytest.param("grid-feed-speed", (98,), marks=pytest.mark.proof),
    ],
)
def test_the_stored_maps_are_what_the_program_computes(name, numbers):
    stored = Study.load(MAPS / name)
    cases = [{one.name: f"{one.values[number].item()!r} {one.unit}" for one in stored.fields} for number in numbers]
    with ThreadPoolExecutor(1) as executor:
        again = study(stored.job, design=cases, measure=[one.name for one in stored.measures], executor=executor)
    for one in stored.measures:
        np.testing.assert_allclose(again[one.name], one.values[list(numbers)], rtol=1e-6)
