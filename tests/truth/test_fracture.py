"""RI80 on maps whose share is made."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.cutting.fracture import ri80


def test_a_share_that_was_made_is_found():
    intensity = np.full((100, 200), 50.0)
    intensity[:, :60] = 30.0
    found = ri80(intensity, 50.0)
    assert found.share == pytest.approx(0.7, abs=1e-15)
    assert found.least == 40.0
    assert np.array_equal(found.intact, intensity > 40)


def test_eighty_percent_is_not_exceeded_by_itself():
    found = ri80([[8.0, 8.000001, np.nan, 1.0]], 10.0)
    assert (found.share, found.measured) == (pytest.approx(1 / 3), 0.75)


def test_the_reference_may_be_a_map_and_the_light_may_change():
    random = np.random.default_rng(0)
    part, reference = random.uniform(0, 1, (80, 80)), random.uniform(0.4, 0.6, (40, 40))
    first, second = ri80(part, reference), ri80(7 * part, 7 * reference)
    assert first.share == second.share == pytest.approx((part > 0.8 * reference.mean()).mean(), abs=1e-15)


def test_places_of_a_polar_map_count_by_their_area():
    """Whole within half the radius: a quarter of the disc."""
    radius = (np.arange(400) + 0.5) / 400
    z = np.tile(np.where(radius < 0.5, 1.0, 0.0), (36, 1))
    found = ri80(tw.HeightMap(z=z, radius=radius, angle=np.linspace(0, 6, 36)), 1.0)
    assert found.share == pytest.approx(0.25, abs=1e-12)


def test_the_uncertainty_covers_the_share_of_the_whole_part():
    """Independent tiles, each whole with probability 0.6: the share of all of them is 0.6."""
    inside = 0
    for seed in range(300):
        tiles = np.random.default_rng(seed).uniform(size=(8, 8)) < 0.6
        found = ri80(np.kron(tiles, np.ones((10, 10))), 1.0)
        inside += abs(found.share - 0.6) < 1.96 * found.uncertainty
    assert 0.91 <= inside / 300 <= 0.98
