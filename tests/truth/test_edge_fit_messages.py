"""What is refused of a measured trace, and in which words."""

from pathlib import Path

import numpy as np
import pytest

from turnwright.errors import InputError
from turnwright.metrology import fit_edge, read_edge_trace

SWEEP = np.linspace(-1, 1, 400)
ARC = 0.2 * np.sin(SWEEP), 0.2 * np.cos(SWEEP)
LINE = np.linspace(0, 1, 400), np.linspace(0, 0.3, 400)


def test_too_few_points():
    with pytest.raises(InputError, match=r"a trace has 9 points, it needs at least 50: trace the edge more finely"):
        fit_edge(np.arange(9), np.arange(9), toward_x=1, cutoff=0.01)


def test_lengths_that_differ():
    with pytest.raises(InputError, match=r"lengths of arrays differ \(u 400, height 399\)"):
        fit_edge(ARC[0], ARC[1][1:], toward_x=1, cutoff=0.01)


def test_which_way_round():
    with pytest.raises(InputError, match=r"toward_x is 0, it must be 1 or -1"):
        fit_edge(*ARC, toward_x=0, cutoff=0.01)


def test_no_curvature():
    with pytest.raises(InputError, match=r"shows no arc: .*at least 50.*at least 5 times the scatter"):
        fit_edge(*LINE, toward_x=1, cutoff=0.01)


def test_no_curvature_above_the_noise():
    noise = np.random.default_rng(1).normal(0, 1e-3, LINE[0].size)
    with pytest.raises(InputError, match=r"shows no arc: "):
        fit_edge(LINE[0], LINE[1] + noise, toward_x=1, cutoff=0.01)


def test_all_dust():
    cloud = np.random.default_rng(2).random((2, 600))
    with pytest.raises(InputError, match=r"a trace of 600 points shows no arc: "):
        fit_edge(*cloud, toward_x=1, cutoff=0.01)


def test_a_corner_without_a_nose():
    u = np.linspace(-1, 1, 400)
    with pytest.raises(InputError, match=r"shows no arc: "):
        fit_edge(u, -np.abs(u), toward_x=1, cutoff=0.01)


def test_a_cutoff_longer_than_the_arc():
    with pytest.raises(InputError, match=r"the arc spans 11\d deg and the cutoff 143 deg of it, at least one"):
        fit_edge(*ARC, toward_x=1, cutoff=0.5)


@pytest.mark.parametrize(
    ("key", "value", "report"), [("cutoff", 0.0, "cutoff is 0 mm"), ("tilt", 1.0, "tilt is 1 rad .57.29")]
)
def test_numbers_out_of_range(key, value, report):
    with pytest.raises(InputError, match=report):
        fit_edge(*ARC, **{"toward_x": 1, "cutoff": 0.01, key: value})


def test_one_radius_is_kept_as_nominal():
    fit = fit_edge(*ARC, toward_x=1, cutoff=0.01, nose_radius=0.19)
    assert fit.tool.nose_radius == 0.19
    assert fit.tool.actual_radius == pytest.approx(0.2, abs=1e-9)
    assert np.rad2deg(fit.sweep) == pytest.approx(np.rad2deg([-1, 1]), abs=0.05)  # no flanks: as far as the trace goes


@pytest.mark.parametrize(
    ("text", "report"),
    [
        ("1,2,3\n", "has no line 'X,Y,Z' above its points, and not two columns: export"),
        ("Number of data,661,16\nX,Y,Z\n1,2,3\n", "holds 16 profiles, the limit is 1: give its number"),
        ("X,Y,Z\n1,2,3\n1,two,3\n", "holds something that is not a number"),
        ("X,Y,Z\n", "has 0 rows, it needs rows"),
        ("X,Y,Z\n1\n2\n", "has 2 rows, it needs rows"),
    ],
)
def test_files_that_are_no_trace(tmp_path: Path, text, report):
    path = tmp_path / "trace.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=report):
        read_edge_trace(path)


def test_no_file(tmp_path: Path):
    with pytest.raises(InputError, match=r"none.csv cannot be read \(No such file or directory\): check its name"):
        read_edge_trace(tmp_path / "none.csv")


def test_a_trace_is_read_as_it_stands(tmp_path: Path):
    path = tmp_path / "trace.csv"
    path.write_text("3D_003,24\nNumber of points in Y direction,1\nX,Y,Z\n-0.5,6.5,7\n0.25,6.75,7\n")
    u, height = read_edge_trace(path)
    assert u.tolist() == [-0.5, 0.25]
    assert height.tolist() == [6.5, 6.75]
