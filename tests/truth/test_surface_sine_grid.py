"""The sinusoidal grid against SymPy and mpmath."""

import numpy as np
import sympy as sp

from surface_oracle import X, Y, disc, error
from turnwright.surface import SineGrid


def test_height_and_derivatives_by_mpmath():
    grid = SineGrid(amplitude=(0.002, -0.0035), period=(2.5, 0.75), phase=(0.4, -2.0))
    formula = sum(
        sp.Rational(a) * sp.sin(2 * sp.pi * q / sp.Rational(p) + sp.Rational(f))
        for q, a, p, f in zip((X, Y), grid.amplitude, grid.period, grid.phase, strict=True)
    )
    assert (error(grid, formula, *disc(8.0, count=100)) < 3e-14).all()


def test_far_from_the_axis_the_phase_is_still_right():
    """40 000 periods out the argument itself is rounded to 3e-11 rad, and no more than that may be lost."""
    grid = SineGrid(amplitude=(1.0, 0.0), period=(0.005, 1.0))
    x = np.array([200.0 + 0.005 * k / 16 for k in range(16)])
    formula = sp.sin(2 * sp.pi * X / sp.Rational(0.005)) + 0 * Y
    assert error(grid, formula, x, np.zeros(16))[0] < 1e-10


def test_li_grid_repeats_and_is_odd():
    """[Li2018] Table 2: crests at a quarter period are twice the amplitude high."""
    grid = SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5))
    assert abs(float(grid.sag(0.625, 0.625)) - 0.004) < 1e-18
    assert abs(float(grid.sag(1.875, -0.625)) + 0.004) < 1e-17
    assert grid.feature_size == 2.5 / 8
    assert SineGrid(amplitude=(0.1, 0.0), period=(8.0, 1.0)).feature_size == 1.0
