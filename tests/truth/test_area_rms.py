"""Root mean squares over the area of polar maps. Oracle: closed forms of Zernike polynomials over the disc."""

import numpy as np
import pytest

from turnwright.heightmap import HeightMap
from turnwright.metrology import area_rms, roughness

RADIUS = 2.0  # [mm]

FORMS = {
    "piston": (0, lambda rho, _angle: 1 + 0 * rho, 1.0),
    "tilt": (1, lambda rho, angle: rho * np.cos(angle), 1 / 2),
    "defocus": (2, lambda rho, _angle: rho**2, 1 / np.sqrt(3)),
    "astigmatism": (2, lambda rho, angle: rho**2 * np.cos(2 * angle), 1 / np.sqrt(6)),
    "trefoil": (3, lambda rho, angle: rho**3 * np.cos(3 * angle), 1 / np.sqrt(8)),
}


def full_turn(count):
    return np.linspace(0, 2 * np.pi, count, endpoint=False)


def ends(count):
    return np.linspace(0, RADIUS, count)


def middles(count):
    return (np.arange(count) + 0.5) * RADIUS / count


def disc(form, radius, angle):
    return HeightMap(z=FORMS[form][1](radius / RADIUS, angle[:, None]) + 0 * angle[:, None], radius=radius, angle=angle)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("radii", [ends, middles])
def test_rms_over_a_disc_converges_to_second_order(form, radii):
    """Five radii are within a tenth; each time the step is halved the error falls to a quarter."""
    power, _, exact = FORMS[form]
    off = [area_rms(disc(form, radii(count), full_turn(24))) / exact - 1 for count in (5, 9, 17, 33, 65)]
    if radii is ends:
        # Squares of a power 2 p between two radii are at most (2 p) (2 p - 1) h² / 8 above or below the straight line.
        steps = np.array([1 / 4, 1 / 8, 1 / 16, 1 / 32, 1 / 64])
        assert (np.abs(off) <= (2 * power) * (2 * power - 1) / 8 * steps**2 * (2 * power + 2) / 2 + 1e-12).all()
    if power:
        assert abs(off[0]) < 0.11
        assert np.abs(off[3] / off[4]) == pytest.approx(4, rel=0.05)
    else:
        assert np.abs(off).max() < 1e-12


@pytest.mark.parametrize("form", FORMS)
def test_sq_of_a_polar_map_is_the_rms_over_its_disc(form):
    found = roughness(disc(form, ends(51), full_turn(24)), form="none")
    assert found.sq_nm == pytest.approx(FORMS[form][2] * 1e6, rel=1e-3)


def test_uneven_radii_weigh_what_lies_between_them():
    """Oracle: the closed form of tilt, on radii that crowd at the rim, to their largest step squared."""
    radius = RADIUS * np.sin(np.linspace(0, np.pi / 2, 101))
    assert area_rms(disc("tilt", radius, full_turn(24))) == pytest.approx(1 / 2, rel=(np.pi / 200) ** 2)


def test_a_ring_counts_from_its_inner_to_its_outer_radius():
    """Oracle: the mean square of r² cos² over a ring from 1 to 2 mm is (2⁴ - 1) / (4 (2² - 1)) mm²."""
    radius, angle = np.linspace(1, 2, 101), full_turn(24)
    found = area_rms(HeightMap(z=radius * np.cos(angle)[:, None], radius=radius, angle=angle))
    assert found == pytest.approx(np.sqrt(15 / 12), rel=1e-4)


def test_an_azimuth_repeated_at_a_full_turn_counts_once():
    """Oracle: tilt over the disc, and the same map without the repeated azimuth."""
    once = area_rms(disc("tilt", ends(65), full_turn(8)))
    again = area_rms(disc("tilt", ends(65), np.linspace(0, 2 * np.pi, 9)))
    assert again == pytest.approx(once, rel=1e-12)


def test_a_sector_counts_from_its_first_to_its_last_azimuth():
    """Oracle: the mean of cos² over an eighth of a turn is 1/2 + 1/π."""
    angle = np.linspace(0, np.pi / 4, 65)
    found = area_rms(HeightMap(z=np.cos(angle)[:, None] * np.ones(3), radius=np.array([1.0, 2.0, 3.0]), angle=angle))
    assert found**2 == pytest.approx(1 / 2 + 1 / np.pi, rel=1e-4)
