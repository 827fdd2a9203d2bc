"""What must hold of any call-out: spellings read alike, and the parts of a form error turn, scale and add up."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from laws import examples
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import form_components, read_call_out
from turnwright.outline import Outline

SEEDS = st.integers(0, 2**31)
SIZES = st.integers(1, 10**6).map(lambda size: size / 1000)
RADIUS, ANGLE = np.linspace(0, 3, 40), np.linspace(0, 2 * np.pi, 36, endpoint=False)


@examples(60)
@given(st.lists(SIZES, min_size=6, max_size=6, unique=True), st.floats(0.2, 10), st.data())
def test_spellings_of_a_form_call_out_read_alike(sizes, wavelength, data):
    """The largest to RMSt and B, so that no limit contradicts another; commas, signs, gaps and units are free."""
    total, a, b, irregular, c, uneven = sorted(sizes, reverse=True)
    stated = {"A": a, "B": b, "C": c, "RMSt": total, "RMSi": irregular, "RMSa": uneven}

    def pick(*choices):
        return data.draw(st.sampled_from(choices))

    def number(size, unit):
        size = size / 1000 if unit == " µm" else size
        return f"{size:.6f}".replace(".", pick(".", ",")) + unit

    unit = pick("", " nm", " µm")
    gap = pick("", " ")
    text = f"3/{gap}{number(a, unit)}{gap}({number(b, unit)}{gap}/{gap}{number(c, unit)})"
    for symbol in ("RMSt", "RMSi", "RMSa"):
        text += f"{pick(';', '')} {symbol} {pick('<', '≤', '<=')} {number(stated[symbol], unit)}"
    text += f"; {pick('λ', 'lambda')} = {wavelength:.4f} µm"
    call_out = read_call_out(text)
    assert {limit.symbol for limit in call_out.limits} == stated.keys()
    factor = 1e-6 if unit else round(wavelength, 4) * 1e-3 / 2
    for symbol, value in call_out.limits:
        assert value == pytest.approx(stated[symbol] * factor, rel=1e-5, abs=1e-9 * factor)


@examples(300)
@given(st.text(alphabet="3/ABC()0.5,;<≤=-–λnµmRMStiaSqzPDUslope ø²³", max_size=40))
def test_any_text_is_read_or_refused_in_a_sentence(text):
    message = ""
    try:
        call_out = read_call_out(text)
    except InputError as refusal:
        message = str(refusal)
    else:
        assert all(limit.value > 0 for limit in call_out.limits)
        assert read_call_out(call_out.text) == call_out
    assert len(message) <= 400


def rough(seed):
    rng = np.random.default_rng(seed)
    waves = rng.standard_normal((4, 40)) @ np.cos(np.outer(np.arange(40), RADIUS))
    turned = np.stack([np.cos(k * ANGLE) for k in range(4)])
    return HeightMap(radius=RADIUS, angle=ANGLE, z=1e-5 * turned.T @ waves)


@examples(15)
@given(SEEDS, st.integers(0, 35), st.floats(0.01, 100), st.floats(0.01, 100))
def test_the_parts_of_a_form_error_turn_and_scale(seed, turns, lengths, factor):
    one = rough(seed)
    other = HeightMap(radius=RADIUS * lengths, angle=ANGLE, z=factor * np.roll(one.z, turns, axis=0))
    first, second = form_components(one, Outline(disc=3.0)), form_components(other, Outline(disc=3.0 * lengths))
    for symbol, value in first.values.items():
        assert second.values[symbol] == pytest.approx(value * factor, rel=1e-9), symbol


@examples(15)
@given(SEEDS)
def test_the_parts_of_a_form_error_add_up(seed):
    """Piston and tilt change nothing; sphere and irregularity are the map; rms are never above PV."""
    one = rough(seed)
    x, y = one.points()
    tilted = HeightMap(radius=RADIUS, angle=ANGLE, z=one.z + 1e-3 + 2e-4 * x - 3e-4 * y)
    found, same = (form_components(heights, Outline(disc=3.0)) for heights in (one, tilted))
    for symbol, value in found.values.items():
        assert same.values[symbol] == pytest.approx(value, rel=1e-6), symbol
    assert np.abs(found.sphere.sag(x, y) + found.irregularity.z - one.z).max() < 1e-15
    assert found.rms_asymmetry <= found.rms_irregularity <= min(found.irregularity_pv, found.rms_total)
    assert np.ptp(found.symmetric.z, axis=0).max() < 1e-15
