"""Spacing and height of cusps, against passes placed by hand and the closed form of the cusp."""

from dataclasses import replace

import numpy as np
import pytest
from cusp_profiles import NOSE, as_profile, cut

from turnwright.errors import InputError
from turnwright.metrology import find_cusps

STEP = 0.5e-3


def flat(tips, *, step=STEP, noise=0.0, seed=0):
    at = np.arange(tips.min() + 0.002, tips.max() - 0.002, step)
    z = cut(tips, at)
    return as_profile(at, z + noise * np.random.default_rng(seed).standard_normal(at.size))


@pytest.mark.parametrize("feed", [0.005, 0.010, 0.0273])
@pytest.mark.parametrize("noise", [0.0, 2e-6])
def test_the_feed_is_found_to_a_thousandth(feed, noise):
    found = find_cusps(flat(feed * np.arange(1, 60), step=feed / 12, noise=noise))
    assert found.feed == pytest.approx(feed, rel=1e-3)
    assert abs(found.feed - feed) < 4 * max(found.feed_std, 1e-6 * feed)
    assert len(found.stretches) == 1


def test_the_uncertainty_of_the_feed_holds_the_truth():
    """Crests that scatter: in 95 of 100 draws the feed lies within two standard uncertainties; here 60 draws."""
    random = np.random.default_rng(7)
    inside = 0
    for _ in range(60):
        tips = 0.010 * np.arange(1, 40) + 0.15e-3 * random.standard_normal(39)
        found = find_cusps(flat(tips, noise=1e-6, seed=int(random.integers(1 << 30))))
        inside += abs(found.feed - 0.010) < 2 * found.feed_std
    assert inside >= 51  # 57 expected; fewer than 51 of 60 come by chance once in a hundred


def test_a_scallop_has_its_closed_form():
    feed = 0.010
    found = find_cusps(flat(feed * np.arange(1, 60), step=0.05e-3))
    expected = 1e6 * (NOSE - np.sqrt(NOSE**2 - feed**2 / 4))
    assert found.scallop_mean_nm == pytest.approx(expected, rel=0.005)
    assert found.scallop_median_nm == pytest.approx(expected, rel=0.005)
    assert found.scallop_std_nm < 0.005 * expected
    assert found.height_nm.size == found.crest.size - 2


def test_several_feeds_are_told_apart():
    tips = 0.1 + np.cumsum(np.concatenate([np.full(25, 0.010), np.full(20, 0.0085), np.full(25, 0.010)]))
    found = find_cusps(flat(tips, noise=1e-6))
    assert [round(1e3 * one.feed, 2) for one in found.stretches] == [10.0, 8.5, 10.0]
    assert [one.count for one in found.stretches] == pytest.approx([25, 20, 25], abs=2)
    assert found.stretches[1].start == pytest.approx(tips[25], abs=0.012)
    assert np.median(found.spacing[:20]) == pytest.approx(0.010, rel=2e-3)


def test_cusps_follow_the_contact_and_not_the_tip():
    """On a concave part of curvature k they lie 1 / (1 - k R) further apart than the passes."""
    tips = (np.arange(60) + 0.75) * 0.010
    at = np.arange(-0.4, 0.4, STEP)
    found = find_cusps(as_profile(at, cut(tips, at, bend=0.5)), axis=0.0)
    assert found.feed == pytest.approx(0.010 / (1 - 0.5 * NOSE), rel=2e-3)
    assert len({*found.run}) == 2  # no run goes across the axis
    right = found.between(0.0, 1.0)
    assert right.crest.min() > 0
    assert right.feed == pytest.approx(found.feed, rel=1e-3)


def test_form_noise_and_gaps_do_not_disturb():
    profile = flat(0.010 * np.arange(1, 80), noise=2e-6)
    z = profile.z + 0.03 * profile.distance**2 - 0.004 * profile.distance
    z[300:304] = np.nan
    found = find_cusps(replace(profile, z=z))
    assert found.feed == pytest.approx(0.010, rel=1e-3)
    assert found.scallop_median_nm == pytest.approx(62.5, rel=0.05)


def test_a_first_guess_replaces_the_strongest_period():
    profile = flat(0.010 * np.arange(1, 60))
    wavy = replace(profile, z=profile.z + 1e-4 * np.sin(2 * np.pi * profile.distance / 0.031))
    assert find_cusps(wavy, feed=0.0104).feed == pytest.approx(0.010, rel=0.01)


def test_profiles_without_cusps_are_refused():
    at = STEP * np.arange(400)
    with pytest.raises(InputError, match="flat"):
        find_cusps(as_profile(at, np.zeros(400)))
    with pytest.raises(InputError, match=r"feed is 1 um, the limits are 4 steps, 2 um"):
        find_cusps(flat(0.010 * np.arange(1, 30)), feed=0.001)
    with pytest.raises(InputError, match="uneven"):
        find_cusps(as_profile(np.cumsum(1 + np.arange(100.0)), np.zeros(100)))
    with pytest.raises(InputError, match="valid heights"):
        find_cusps(as_profile(at, np.full(400, np.nan)))
    with pytest.raises(InputError, match="neighbours"):
        find_cusps(flat(0.010 * np.arange(1, 30))).between(0.05, 0.06)


@pytest.mark.parametrize(("step", "noise"), [(0.1e-3, 0.25), (0.1e-3, 0.4), (0.2e-3, 0.4), (0.87e-3, 0.3)])
def test_the_feed_is_found_in_noise_however_fine_the_steps(step, noise):
    """The slopes of white noise outweigh those of the cusps; the cusps stand out among periods near their own."""
    feed = 0.008
    tips = feed * np.arange(1, 54)
    height = NOSE - np.sqrt(NOSE**2 - feed**2 / 4)
    for seed in range(2):
        found = find_cusps(flat(tips, step=step, noise=noise * height, seed=seed))
        assert found.feed == pytest.approx(feed, rel=3e-3)
        assert abs(found.feed - feed) < 4 * found.feed_std


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_not_taken_for_cusps(seed):
    at = 0.27e-3 * np.arange(1481)
    noise = 5e-6 * np.random.default_rng(seed).standard_normal(at.size)
    with pytest.raises(InputError, match="no cusps stand out of the profile's noise"):
        find_cusps(as_profile(at, noise))
    smooth = np.convolve(noise, np.ones(15) / 4, mode="same")
    for z, feed in ((noise, 0.008), (smooth, None), (smooth, 0.008)):
        with pytest.raises(InputError, match=r"as those of noise do|stand out of the profile's noise"):
            find_cusps(as_profile(at, z), feed=feed)


def test_a_straight_line_has_no_cusps():
    at = 0.27e-3 * np.arange(1481)
    with pytest.raises(InputError, match="flat"):
        find_cusps(as_profile(at, 0.01 * at))


def test_a_scratched_stretch_and_missed_crests_do_not_refuse_the_rest():
    profile = flat(0.010 * np.arange(1, 60), noise=1e-6)
    z = profile.z.copy()
    z[300:420] = 1e-4 * np.random.default_rng(0).standard_normal(120)
    assert find_cusps(replace(profile, z=z), feed=0.010).feed == pytest.approx(0.010, rel=2e-3)
