"""Channels at the end of their range. Oracle: forces that are cut off at a level, and forces that are not."""

import numpy as np
import pytest

from learning_cases import CLIPPED, clipped, plateau, shipped
from turnwright.cutting import Cuts, NoseCuts, learn_material
from turnwright.cutting.learning.signals import ForceRecord
from turnwright.errors import InputError

CHIP = np.linspace(50e-6, 1200e-6, 60)


def forces(seed, noise=0.01):
    random = np.random.default_rng(seed)
    true = np.outer(CHIP * 0.2, [1489.0, 816.0])
    return true + noise * true.max(axis=0) * random.normal(size=true.shape)


def record(seed=0, **more):
    random = np.random.default_rng(seed)
    time = np.arange(20_000) / 10_000
    ramp = np.where((time > 0.3) & (time < 1.7), 0.25 * (time - 0.3), 0.0)
    force = np.column_stack((ramp, 0.5 * ramp)) + 2e-3 * random.normal(size=(time.size, 2))
    for channel, limits in more.items():
        column = ("Fy", "Fz").index(channel)
        force[:, column] = np.clip(force[:, column], *limits)
    return force


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_averages_of_a_saturated_channel_are_refused(which, sign):
    """Unrefused they look like a transition: a critical thickness of 673.6 nm where there is none."""
    force = sign * forces(3)
    level = np.abs(force[:, which]).max() * 0.56
    clipped = int(np.count_nonzero(np.abs(force[:, which]) >= level))
    force[:, which] = np.clip(force[:, which], -level, level)
    names = ("cutting force", "thrust")
    with pytest.raises(InputError, match=f"the {names[which]} is saturated.* in {clipped} of 60 cuts"):
        learn_material(Cuts(thickness=CHIP, width=np.full(60, 0.2), cutting=force[:, 0], thrust=force[:, 1]))


@pytest.mark.parametrize("kind", CLIPPED)
def test_saturated_proportional_channels_are_no_transition(kind):
    """A tenth of the proof in tests/proof/proof_chance.py. Unrefused, both gave 672.8 nm where there is no limit."""
    for seed in range(5):
        with pytest.raises(InputError, match="saturated"):
            learn_material(clipped(kind, np.random.default_rng(seed)))


def test_constant_forces_are_learned_with_a_question():
    """Their noise is that of the other forces, in both channels: the law of the shipped IRG 26."""
    for seed in range(6):
        assert any("ends of the measuring ranges" in one for one in learn_material(shipped(seed)).sentences)
    for seed in range(12):
        learn_material(plateau(np.random.default_rng(seed)))


@pytest.mark.parametrize("levels", [20, 100, 1000])
def test_averages_of_a_coarse_converter_are_not_saturated(levels):
    for seed in range(5):
        force = forces(seed, noise=0.003)
        step = force.max() / levels
        cutting, thrust = (np.round(force / step) * step).T
        learn_material(Cuts(thickness=CHIP, width=np.full(60, 0.2), cutting=cutting, thrust=thrust))


def test_unsaturated_averages_are_learned():
    for noise in (0.01, 0.0):
        cutting, thrust = forces(3, noise).T
        learned = learn_material(Cuts(thickness=CHIP, width=np.full(60, 0.2), cutting=cutting, thrust=thrust))
        assert learned.critical is None


def test_constant_forces_beyond_a_transition_are_no_saturation():
    bears = np.where(CHIP > 600e-6, 300e-6, CHIP)
    cuts = Cuts(thickness=CHIP, width=np.full(60, 0.2), cutting=300 * bears, thrust=160 * bears)
    assert learn_material(cuts).critical.value == pytest.approx(600e-6, rel=0.02)


def test_averages_of_a_round_nose_are_refused_alike():
    feed = np.linspace(0.5e-3, 5e-3, 30)
    axial, cutting = (one * feed * (1 + 0.01 * np.random.default_rng(1).normal(size=30)) for one in (8.0, 15.0))
    given = {"nose_radius": np.full(30, 1.0), "depth": np.full(30, 0.02), "feed": feed, "axial": axial}
    with pytest.raises(InputError, match="the cutting force is saturated"):
        learn_material(NoseCuts(**given, cutting=np.minimum(cutting, 0.04)))


@pytest.mark.parametrize(("channel", "limits"), [("Fy", (-0.2, 0.2)), ("Fz", (-1.0, 0.1)), ("Fy", (-0.001, 1.0))])
def test_a_record_with_a_saturated_channel_is_refused(channel, limits):
    force = record(**{channel: limits})
    column = force[:, ("Fy", "Fz").index(channel)]
    count = int(np.count_nonzero((column == limits[0]) | (column == limits[1])))
    with pytest.raises(InputError, match=f"{count} of 20000 samples of channel '{channel}'"):
        ForceRecord(force=force, rate_hz=1e4, channels=("Fy", "Fz"))


@pytest.mark.parametrize("step", [0.0, 1e-4, 2e-3, 0.01])
def test_a_record_of_a_coarse_converter_is_not_saturated(step):
    for seed in range(5):
        force = record(seed)
        force = np.round(force / step) * step if step else force
        assert ForceRecord(force=force, rate_hz=1e4, channels=("Fy", "Fz")).samples == 20_000
