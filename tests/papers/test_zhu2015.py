"""Zhu and To 2015: sine grid of 5 um and 0.2 mm, nose 0.1 mm, aperture 6 mm, scallop 50 nm, chord 10 nm.

The tolerances are printed swapped. What the adaptive servo takes itself is counted on the page of the paper.
"""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from turnwright.part import Part
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.surface import SineGrid
from turnwright.tool import Tool

GRID = Part(surface=SineGrid(amplitude=(0.005, 0.005), period=(0.2, 0.2)), radius=3.0)
TOOL = Tool(nose_radius=0.1)
TURNS = 667
FEED = 3.0 / TURNS


def chord(points, part, *, hermite):
    """Largest miss of what a controller makes of the outermost turns at a constant angle, by brute force. [mm]."""
    worst = 0.0
    for start in (part - 0.1, part):
        angle = np.arange(points * 16 + 1) * (2 * np.pi / (points * 16))
        rate = np.full(angle.size, -FEED / (2 * np.pi))
        path = place(Spiral(angle=angle, radius=start + rate * angle, radius_rate=rate), GRID, TOOL)
        at, z = angle[::16], path.z[::16]
        made = CubicHermiteSpline(at, z, path.z_rate[::16])(angle) if hermite else np.interp(angle, at, z)
        worst = max(worst, float(np.abs(made - path.z).max()))
    return worst


@pytest.mark.parametrize(("hermite", "printed"), [(False, 3.15e6), (True, 4.4e5)])
def test_points_at_a_constant_angle(hermite, printed):
    """Oracle: the printed counts within 2 %: as many points keep 10 nm, and 4 % fewer do not."""
    points = round(1.02 * printed / TURNS)
    assert chord(points, 3.0, hermite=hermite) <= 10e-6
    assert chord(round(0.96 * points), 3.0, hermite=hermite) > 10e-6


def test_turns_at_a_constant_feed():
    """Oracle: the step sqrt(8 R h (1 - kappa R)) where the grid is most concave; kappa = A k² in all directions."""
    kappa = 0.005 * (2 * np.pi / 0.2) ** 2
    feed = math.sqrt(8 * 0.1 * 50e-6 * (1 - kappa * 0.1))
    assert 3.0 / feed == pytest.approx(667, rel=0.02)
