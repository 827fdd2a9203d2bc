"""The edge found from cusps, against the known wavy edge of a brute-force minimum over its passes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cusp_profiles import KINDS, NOSE, as_profile, cut, off_edge, random_cut
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.instrument import Instrument
from turnwright.metrology import edge_from_cusps
from turnwright.surface import EvenAsphere
from turnwright.tool import Tool

BEND = 0.091
BOWL = EvenAsphere(radius=np.inf, conic=0.0, terms={2: BEND / 2})
TOOL = Tool(nose_radius=NOSE, included=np.deg2rad(120))
MICROSCOPE = Instrument.load("zygo-nexview-10x")
PIXEL = 0.871e-3
PLACES = as_profile(PIXEL * np.arange(-460, 461), np.zeros(921))


def wave(u):
    return 8e-6 * np.sin(2 * np.pi * u / 0.010)


@cache
def true_surface(feed, step=PIXEL / 10):
    at = np.arange(-0.44, 0.44, step)
    return as_profile(at, cut((np.arange(int(0.48 / feed)) + 0.75) * feed, at, bend=BEND, wave=wave))


def off(found):
    """The edge found minus the true one, without height, tilt and bend, and its uncertainty. Each (n,) [nm]"""
    u = NOSE * np.sin(found.sweep)
    gauge = np.column_stack([np.ones(u.size), u])
    difference = found.deviation + wave(u)  # a higher edge deviates inward
    difference = difference - gauge @ np.linalg.lstsq(gauge, difference, rcond=None)[0]
    return 1e6 * difference, 1e6 * found.deviation_std


def test_the_edge_is_found_from_the_surface_itself():
    found = edge_from_cusps(true_surface(0.040), TOOL, axis=0.0, removed=BOWL, cutoff=2e-3)
    error, std = off(found)
    assert error.std() < 0.4  # of 5.7 nm
    assert found.radius == pytest.approx(NOSE, abs=0.002)
    assert found.reach[0] < -0.018
    assert found.reach[1] > 0.026  # the contact rolls: more than the half feed
    assert (np.abs(error) < 3 * std + 0.3).mean() > 0.95


def test_the_edge_is_found_through_a_microscope():
    noise = 1e-6 * np.random.default_rng(1).standard_normal(PLACES.z.size)
    seen = MICROSCOPE.see(true_surface(0.040), like=PLACES)
    seen = replace(seen, z=seen.z + noise)
    found = edge_from_cusps(seen, TOOL, axis=0.0, removed=BOWL, instrument=MICROSCOPE)
    error, std = off(found)
    assert error.std() < 1.5
    assert (np.abs(error) < 2 * std).mean() > 0.9
    assert abs(found.radius - NOSE) < 3 * found.radius_std
    without = off(edge_from_cusps(seen, TOOL, axis=0.0, removed=BOWL))[0]
    assert without.std() > 5  # what the microscope rounds would be taken for the edge


def test_the_edge_predicts_another_feed():
    """Found at 40 um/rev, it predicts the seen scallops of 10 um/rev within 2 %; the nominal nose is off by 5 %."""
    from turnwright.metrology import find_cusps

    seen = MICROSCOPE.see(true_surface(0.040), like=PLACES)
    found = edge_from_cusps(seen, TOOL, axis=0.0, removed=BOWL, instrument=MICROSCOPE)
    u = NOSE * np.sin(found.sweep)

    def scallops(edge):
        at = np.arange(-0.44, 0.44, PIXEL / 10)
        z = cut((np.arange(48) + 0.75) * 0.010, at, bend=BEND, wave=edge)
        return find_cusps(MICROSCOPE.see(as_profile(at, z), like=PLACES), axis=0.0)

    truth, predicted, nominal = (
        scallops(edge) for edge in (wave, lambda x: np.interp(x, u, -found.deviation), lambda x: 0 * x)
    )
    for low, high in ((-0.36, -0.28), (-0.2, -0.1), (0.1, 0.2), (0.28, 0.36)):
        chosen = [one.between(low, high).scallop_median_nm for one in (truth, predicted, nominal)]
        assert chosen[1] == pytest.approx(chosen[0], rel=0.02)
        assert abs(chosen[2] / chosen[0] - 1) > 0.05


def test_the_edge_is_found_from_a_map():
    at = 1e-3 * np.arange(-180, 181)
    r = np.hypot(at, at[:, None])
    fine = np.arange(0, 0.27, 1e-4)
    heights = np.interp(r, fine, cut((np.arange(9) + 0.75) * 0.040, fine, bend=BEND, wave=wave))
    found = edge_from_cusps(
        HeightMap(x=at + 3, y=at, z=heights), TOOL, axis=(3.0, 0.0), removed=BOWL, feed=0.040, cutoff=3e-3
    )
    error, _ = off(found)
    assert np.abs(error[2:-2]).std() < 1.5
    assert found.valleys > 24


def test_the_edge_is_a_tool():
    found = edge_from_cusps(true_surface(0.040, PIXEL / 4), TOOL, axis=0.0, removed=BOWL, cutoff=2e-3)
    assert found.tool.nose_radius == NOSE
    assert found.tool.deviation(found.sweep) == pytest.approx(found.deviation, abs=1e-12)


def test_what_shows_no_edge_is_refused():
    surface = true_surface(0.040, PIXEL)
    with pytest.raises(InputError, match="valleys between crests"):
        edge_from_cusps(surface.between(0.0, 0.14), TOOL, axis=0.0, feed=0.040)
    with pytest.raises(InputError, match="axis of a map"):
        edge_from_cusps(HeightMap(x=[0.0, 1.0], y=[0.0, 1.0], z=np.zeros((2, 2))), TOOL)
    with pytest.raises(InputError, match="one distance"):
        edge_from_cusps(surface, TOOL, axis=(0.0, 0.0))
    with pytest.raises(InputError, match="from the tip"):
        edge_from_cusps(surface, replace(TOOL, nose_radius=0.02), axis=0.0, removed=BOWL)


@pytest.mark.parametrize(
    "kind", [pytest.param(one, marks=[pytest.mark.proof] * (one not in ("flat", "curved and wavy"))) for one in KINDS]
)
def test_the_uncertainty_of_the_edge_holds_the_true_one(kind):
    """Of places within two standard uncertainties; without the freedom of the valleys 9 to 90 of 100 were."""
    random = np.random.default_rng(5)
    inside = []
    for _ in range(2):
        nose, profile, wave = random_cut(random, kind)
        found = edge_from_cusps(profile, Tool(nose_radius=nose, included=np.deg2rad(130)), axis=0.0)
        inside.append(np.mean(np.abs(off_edge(found, wave, nose)) < 2 * found.deviation_std))
    assert np.mean(inside) > 0.8


def test_spikes_do_not_change_the_edge():
    """One height in 200 off by ten scallops, to either side."""
    random = np.random.default_rng(2)
    nose, profile, wave = random_cut(random, "curved")
    spiked = random.random(profile.z.size) < 1 / 200
    z = profile.z + 1e-3 * spiked * random.choice([-1, 1], profile.z.size)
    tool = Tool(nose_radius=nose, included=np.deg2rad(130))
    clean, found = (edge_from_cusps(one, tool, axis=0.0) for one in (profile, replace(profile, z=z)))
    sweep = clean.sweep[(clean.sweep >= found.sweep[0]) & (clean.sweep <= found.sweep[-1])]
    std = np.interp(sweep, clean.sweep, clean.deviation_std)
    change = found.tool.deviation(sweep) - clean.tool.deviation(sweep)
    gauge = np.column_stack([np.ones(sweep.size), np.sin(sweep)])
    change -= gauge @ np.linalg.lstsq(gauge, change, rcond=None)[0]
    assert np.mean(np.abs(change) < 2 * std) > 0.95
    assert np.mean(np.abs(off_edge(found, wave, nose)) < 2 * found.deviation_std) > 0.9
