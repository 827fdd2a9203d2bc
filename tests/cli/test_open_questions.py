"""What a registration leaves open names the keys of ``[measurement]``; written into the job they settle it."""

import tomllib

import numpy as np
import pytest

import turnwright as tw
from job_files import changed
from turnwright.job import Job, measure


def stated(question):
    """Return the keys that a sentence says to write, as TOML reads them."""
    text = question.partition("rite ")[2].partition(" in [measurement]")[0]
    lines, depth, line = [], 0, ""
    for letter in text:
        depth += {"[": 1, "]": -1}.get(letter, 0)
        if letter == "," and depth == 0:
            lines.append(line)
            line = ""
        else:
            line += letter
    return tomllib.loads("\n".join([*lines, line]))


def questions(surface, radius, heights, **keys):
    changes = [("part.surface", surface), ("part.radius", f"{radius} mm"), ("simulation.patches", [])]
    return measure(Job.read(changed(*changes, ("measurement", keys))), heights).open_questions


def grid(function, reach, count=41, *, noise=2e-6):
    axis = np.linspace(-reach, reach, count)
    x, y = np.meshgrid(axis, axis)
    z = function(x, y) + noise * np.random.default_rng(4).normal(size=x.shape)
    return tw.HeightMap(x=axis, y=axis, z=z, name="seen")


def test_warning_names_the_keys_that_fix_a_degree_of_freedom():
    sphere = {"family": "sphere", "radius": "20 mm"}
    heights = grid(tw.Sphere(radius=20.0).sag, 1.4)
    held = [one for one in questions(sphere, 2, heights) if "determined by the fit" in one]
    assert len(held) == 1
    keys = stated(held[0])
    assert keys["free"] == ["z", "tilt_x", "tilt_y"]
    assert keys["rotation"] == "0 deg"
    assert len(keys["shift"]) == 3
    assert not questions(sphere, 2, heights, **keys)


def test_named_keys_single_out_one_of_several_places():
    """Two of the lenses of a row are seen: they are any two neighbours."""
    lens = {"family": "sphere", "radius": "-3 mm"}
    array = {"family": "lens array", "layout": "square", "pitch": "0.8 mm", "rows": 6, "columns": 6, "lenslet": lens}
    made = tw.LensArray.square(pitch=0.8, rows=6, columns=6, lenslet=tw.Sphere(radius=-3.0))
    heights = grid(made.sag, 0.5)
    rivals = [one for one in questions(array, 2, heights) if "nearly as well" in one]
    assert rivals
    keys = stated(rivals[0])
    assert set(keys) >= {"shift", "rotation", "reach"}
    assert not [one for one in questions(array, 2, heights, **keys) if "nearly as well" in one]


def test_a_symmetric_part_is_clocked_by_the_named_keys():
    toroid = {"family": "toroid", "radius_x": "20 mm", "radius_y": "30 mm"}
    heights = grid(tw.Toroid(radius_x=20.0, radius_y=30.0).sag, 1.4)
    turned = [one for one in questions(toroid, 2, heights, clocking="180 deg") if "symmetric" in one]
    assert turned
    keys = stated(turned[0])
    assert keys["clocking"] == "90 deg"
    assert not [one for one in questions(toroid, 2, heights, rotation=keys["rotation"], clocking="80 deg")
                if "symmetric" in one]  # fmt: skip


@pytest.mark.parametrize("method", ["robust", "none"])
def test_what_pulls_at_the_pose_is_left_out_by_keys(method):
    """An object next to the part: a ledge at one edge of the map, a tenth of a millimetre high."""
    toroid = {"family": "toroid", "radius_x": "20 mm", "radius_y": "30 mm"}
    surface = tw.Toroid(radius_x=20.0, radius_y=30.0)
    heights = grid(lambda x, y: surface.sag(x, y) + 0.1 * (x > 1.36), 1.4, 61)
    pulled = [one for one in questions(toroid, 2, heights, outliers=method, reach="0.5 mm") if "bias the pose" in one]
    keys = stated(pulled[0])
    assert keys["trim"] == "0.02 mm"
    assert ("outliers" in keys) == (method == "none")
