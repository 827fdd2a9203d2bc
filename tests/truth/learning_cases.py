"""Random experiments whose coefficients and limit are known, and how often `learn_material` finds them."""

import numpy as np

from turnwright.cutting.learning import Cuts, learn_material
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
