"""Random experiments whose coefficients and limit are known, and how often `learn_material` finds them."""

import numpy as np

from force_oracle import learned, ramp_record, tap_tests
from turnwright.cutting import Cuts, learn_material
from turnwright.cutting.learning.straight import StraightRows, _find_drop, _find_slope_change
from turnwright.material import Material

KC, KT = 1489.0, 816.0

KINDS = {"none": None, "slope change": 1.0, "drop to 0.8": 0.8, "drop to 0.5": 0.5}
"""Force beyond the limit over that at it; none for a ductile line throughout."""

SMOOTH = ("edge force", "size effect")
"""Forces that are not in proportion to the chip, without a transition."""


def cuts(kind, random):
    """Return cuts of one random experiment, and the thickness at which its forces leave the line. [mm]."""
    count = int(random.integers(40, 400))
    chip = np.sort(random.uniform(50e-6, 1200e-6, count))
    limit, share = random.uniform(400e-6, 800e-6), KINDS.get(kind)
    width = np.full(count, 0.2)
    bears = chip if share is None else np.where(chip > limit, share * limit, chip)
    if kind == "edge force":
        bears = chip + random.uniform(5e-6, 100e-6)
    elif kind == "size effect":
        bears = chip * (chip / 300e-6) ** -random.uniform(0.05, 0.5)
    noise = 10 ** random.uniform(-3, -2) * KC * 600e-6 * 0.2
    cutting, thrust = (k * bears * width + noise * random.normal(size=count) for k in (KC, KT))
    return Cuts(thickness=chip, width=width, cutting=cutting, thrust=thrust), limit


def shipped(seed):
    """Return cuts of the law in the file of IRG 26, with noise of 1 % of the force at its limit."""
    random = np.random.default_rng(seed)
    glass = Material.load("irg26")
    chip = np.linspace(50e-6, 1200e-6, 60)
    forces = [k * chip * 0.2 for k in glass.coefficients(chip)]
    cutting, thrust = (one + 0.01 * one.max() * random.normal(size=chip.size) for one in forces)
    return Cuts(thickness=chip, width=np.full(chip.size, 0.2), cutting=cutting, thrust=thrust)


def covered(kind, cases, seed):
    """Return the shares of experiments whose transition is found, and whose intervals of Kc, Kt and limit hold."""
    found, holds = 0, np.zeros((0, 3))
    for case in range(cases):
        random = np.random.default_rng([seed, case])
        rows, limit = cuts(kind, random)
        learned = learn_material(rows)
        seen = learned.critical is not None
        found += seen
        inside = [one.low <= true <= one.high for one, true in ((learned.cutting, KC), (learned.thrust, KT))]
        inside.append(learned.critical.low <= limit <= learned.critical.high if seen else np.nan)
        holds = np.vstack((holds, inside))
    critical = holds[:, 2][~np.isnan(holds[:, 2])]
    return found / cases, *holds[:, :2].mean(axis=0), critical.mean() if critical.size else np.nan


def misled(count, seed):
    """Return the least chance of a transition that forces in proportion to the chip are given."""
    random = np.random.default_rng(seed)
    chip = np.linspace(50e-6, 1500e-6, count)
    cutting, thrust = (0.5 * k * chip + 0.01 * random.normal(size=count) for k in (KC, KT))
    rows = StraightRows(Cuts(thickness=chip, width=np.full(count, 0.5), cutting=cutting, thrust=thrust))
    drop, bend = _find_drop(rows, 0.95), _find_slope_change(rows, 0.95)
    return min([1.0, *(one.chance for one in (bend, drop and drop.split) if one is not None)])


CLIPPED = {
    "cutting force, exact": (True, False, 0.0),
    "thrust, exact": (False, True, 0.0),
    "both, exact": (True, True, 0.0),
    "cutting force, 0.001 of noise": (True, False, 0.001),
    "both, 0.03 of the noise": (True, True, 0.03),
    "cutting force, all the noise": (True, False, 1.0),
    "thrust, all the noise": (False, True, 1.0),
}
"""Which channels end, and the noise of the end over that of the forces."""


def clipped(kind, random):
    """Return cuts in proportion to the chip whose channels end at a force."""
    which, share = CLIPPED[kind][:2], CLIPPED[kind][2]
    count = int(random.integers(30, 200))
    chip, limit = np.linspace(50e-6, 1500e-6, count), random.uniform(400e-6, 1000e-6)
    forces = []
    for k, ends in zip((KC, KT), which, strict=True):
        force, noise = 0.5 * k * chip, 0.003 * random.normal(size=(2, count))
        rail = 0.5 * k * limit
        level = np.minimum(force + noise[0], rail) if share < 1 else np.minimum(force, rail)
        forces.append(level + share * noise[1] if ends else force + noise[0])
    return Cuts(thickness=chip, width=np.full(count, 0.5), cutting=forces[0], thrust=forces[1])


def plateau(random):
    """Return cuts whose forces stand still beyond a limit, with the noise that they have below it."""
    count, limit = int(random.integers(12, 200)), random.uniform(300e-6, 1400e-6)
    chip = np.sort(random.uniform(50e-6, 1500e-6, count))
    noise = 10 ** random.uniform(-4, -1.5)
    cutting, thrust = (0.5 * k * np.minimum(chip, limit) + noise * random.normal(size=count) for k in (KC, KT))
    return Cuts(thickness=chip, width=np.full(count, 0.5), cutting=cutting, thrust=thrust)


def disturbed(count):
    """Return what was learned from disturbed records of a ramp, for Kc, Kt and the limit of each. (count, 3, 3).

    The relative error, whether the interval holds the truth, and half of its width over that.
    """
    found = []
    for seed in range(count):
        random = np.random.default_rng(50_000 + seed)
        record, truth = ramp_record(random)
        material = learned(record, tap_tests(random))
        found.append(
            [
                (one.value / true - 1, one.low <= true <= one.high, (one.high - one.low) / 2 / true)
                for one, true in (
                    (material.cutting, truth.cutting),
                    (material.thrust, truth.thrust),
                    (material.critical, truth.critical),
                )
            ]
        )
    return np.array(found)
