"""Roughness profiles after ISO 21920, against closed forms and elements counted by hand."""

from dataclasses import replace

import numpy as np
import pytest

from cusp_profiles import as_profile
from turnwright.errors import InputError
from turnwright.metrology import profile_roughness

STEP, WAVE, A = 1e-4, 0.005, 1e-4
X = STEP * np.arange(4800)


def sine(period=WAVE, size=A):
    return as_profile(X, size * np.sin(2 * np.pi * X / period))


def test_a_sine_has_its_closed_form():
    found = profile_roughness(sine(), cutoff=0.08)
    assert found.ra_nm == pytest.approx(2e6 * A / np.pi, rel=2e-3)
    assert found.rq_nm == pytest.approx(1e6 * A / np.sqrt(2), rel=1e-3)
    assert found.rz_nm == pytest.approx(2e6 * A, rel=2e-3)
    assert found.rt_nm == pytest.approx(2e6 * A, rel=2e-3)
    assert found.rsm == pytest.approx(WAVE, rel=1e-6)
    assert found.rsk == pytest.approx(0, abs=1e-6)
    assert found.rku == pytest.approx(1.5, rel=1e-3)
    assert found.sections == 5
    assert found.notes == ()


def test_cusps_have_their_closed_form():
    """A parabolic cusp has Rq = sqrt(4/45) Rz, Ra = 4 / (9 sqrt 3) Rz and Rsk = 2 sqrt(5) / 7."""
    t = X / 0.010 % 1 - 0.5
    found = profile_roughness(as_profile(X, 1e-4 * (2 * t) ** 2), cutoff=0.08)
    assert found.rz_nm == pytest.approx(100, rel=0.01)
    assert found.rq_nm / found.rz_nm == pytest.approx(np.sqrt(4 / 45), rel=5e-3)
    assert found.ra_nm / found.rz_nm == pytest.approx(4 / (9 * np.sqrt(3)), rel=5e-3)
    assert found.rsk == pytest.approx(2 * np.sqrt(5) / 7, rel=0.01)
    assert found.rsm == pytest.approx(0.010, rel=1e-4)


@pytest.mark.parametrize("period", [0.04, 0.08, 0.12])
def test_the_cutoff_takes_its_share_of_a_wave(period):
    """The Gaussian L-filter leaves 1 - 2^-(cutoff/period)² of it: half at the cutoff."""
    found = profile_roughness(sine(period), cutoff=0.08, sections=3)
    middle = 1 - 2.0 ** -((0.08 / period) ** 2)
    assert found.rt_nm == pytest.approx(2e6 * A * middle, rel=0.02)


def test_the_s_filter_takes_off_noise():
    noisy = as_profile(X, sine().z + 2e-5 * np.sin(2 * np.pi * X / 4e-4))
    found = profile_roughness(noisy, cutoff=0.08, short=0.0025)
    passed = 2.0 ** -((0.0025 / WAVE) ** 2)
    assert found.rq_nm == pytest.approx(1e6 * A / np.sqrt(2) * passed, rel=2e-3)
    assert profile_roughness(noisy, cutoff=0.08).rq_nm > found.rq_nm * 1.1


def test_rz_is_a_mean_over_sections_and_rt_is_not():
    """One spike of 300 nm in one of five sections: Rz grows by a fifth of what Rt does."""
    z = sine().z.copy()
    z[2412] = A + 3e-4
    found = profile_roughness(as_profile(X, z), cutoff=0.08)
    assert found.rt_nm == pytest.approx(500, rel=0.01)
    assert found.rz_nm == pytest.approx(200 + 300 / 5, rel=0.01)


def test_small_and_short_excursions_are_no_elements():
    """A ripple of 8 % of Rz about the mean line, and needles shorter than 1 % of the section, do not count."""
    base = A * np.sign(np.sin(2 * np.pi * X / 0.02)) * (np.abs(np.sin(2 * np.pi * X / 0.02)) > 0.4)
    ripple = base + np.where(base == 0, 0.16 * A * np.sin(2 * np.pi * X / 0.0009), 0.0)
    found = profile_roughness(as_profile(X, ripple), cutoff=0.08, sections=5)
    assert found.rsm == pytest.approx(0.02, rel=0.02)
    needles = sine(0.02).z.copy()
    needles[100::200] *= -1  # one point of 0.1 um, cut through the hills
    needles[150::200] *= -1
    assert profile_roughness(as_profile(X, needles), cutoff=0.08).rsm == pytest.approx(0.02, rel=0.02)
    larger = base + np.where(base == 0, 0.9 * A * np.sin(2 * np.pi * X / 0.0018), 0.0)
    assert profile_roughness(as_profile(X, larger), cutoff=0.08).rsm < 0.01


def test_form_and_missing_heights_do_not_count():
    z = sine().z + 3e-3 * X + 0.01
    z[::7] = np.nan
    found = profile_roughness(as_profile(X, z), cutoff=0.08)
    whole = profile_roughness(sine(), cutoff=0.08)
    assert found.rq_nm == pytest.approx(whole.rq_nm, rel=2e-3)
    assert found.rsm == pytest.approx(whole.rsm, rel=1e-3)


def test_fewer_sections_are_reported_and_too_few_refused():
    found = profile_roughness(sine(), cutoff=0.2)
    assert found.sections == 2
    assert "2 sections fit" in found.notes[0]
    with pytest.raises(InputError, match=r"0\.48 mm long, 3 sections of 0\.2 mm"):
        profile_roughness(sine(), cutoff=0.2, sections=3)
    with pytest.raises(InputError, match="S-filter must be below the cutoff"):
        profile_roughness(sine(), cutoff=0.08, short=0.1)
    with pytest.raises(InputError, match="uneven"):
        profile_roughness(replace(sine(), distance=np.cumsum(1 + X)), cutoff=0.08)


@pytest.mark.parametrize("gap", [1, 6, 20, 200, 800])
def test_an_element_that_crosses_a_gap_does_not_count(gap):
    """A sine of 5 um: each whole element is one period, wherever heights are missing, and however many."""
    z = sine().z.copy()
    for first in (1000, 2430):
        z[first : first + gap] = np.nan
    found = profile_roughness(as_profile(X, z), cutoff=0.08)
    assert found.rsm == pytest.approx(WAVE, rel=2e-3)
    assert any("gap" in one for one in found.notes) == (gap >= 8)  # 0.8 um, below which no hill or dale counts


def test_gaps_in_all_elements_leave_no_spacing():
    z = sine().z.copy()
    z[(np.arange(X.size) % 50) < 10] = np.nan
    found = profile_roughness(as_profile(X, z), cutoff=0.08)
    assert np.isnan(found.rsm)
    assert any("no complete profile element" in one for one in found.notes)
