"""How often `learn_material` is misled: by noise, by channels at the end of their range, by forces that stand still.

Run: python tests/proof/proof_chance.py [CASES] [SEED]. Oracles: forces in proportion to the chip, of which a share of
at most p may have a chance of p or less; the same cut off at a level; a plateau with the noise of the rest.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import numpy as np
from scipy import stats

from learning_cases import CLIPPED, clipped, misled, plateau
from turnwright.cutting import learn_material
from turnwright.errors import InputError

LIMITS = (0.05, 0.01, 0.001)

COUNTS = (9, 12, 15, 40, 120)


def refused(rows):
    """Return whether cuts are refused as saturated."""
    try:
        learn_material(rows)
    except InputError as error:
        return "saturated" in str(error)
    return False


def main(cases: int = 2000, seed: int = 1) -> int:
    """Print a table of shares; return 1 if a chance is exceeded beyond what luck makes of it."""
    failed = False
    print(f"{'cuts':>6}" + "".join(f"{f'p = {p:g}':>12}" for p in LIMITS) + f"   of {cases} experiments")
    for count in COUNTS:
        chances = np.array([misled(count, [seed, count, case]) for case in range(cases)])
        shown = [int((chances <= p).sum()) for p in LIMITS]
        print(f"{count:6}" + "".join(f"{one / cases:12.4f}" for one in shown))
        failed |= any(one > stats.binom.ppf(0.999, cases, p) for one, p in zip(shown, LIMITS, strict=True))
    for kind in CLIPPED:
        tried = max(cases // 10, 20)
        share = sum(refused(clipped(kind, np.random.default_rng([seed, case]))) for case in range(tried)) / tried
        print(f"{kind:32}{share:8.3f} refused")
        failed |= share < 0.99
    wrong = sum(refused(plateau(np.random.default_rng([seed, case]))) for case in range(cases)) / cases
    print(f"{'plateau of the material':32}{wrong:8.4f} refused")
    return int(failed or wrong > 0.001)


if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:3])))
