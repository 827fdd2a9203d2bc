"""Coverage of the intervals of `learn_material`: which model is chosen, and how often each interval holds the truth.

Run: python tests/proof/proof_learning.py [CASES] [SEED]. Oracle: the coefficients and limits the forces are made of.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import numpy as np

from learning_cases import KC, KINDS, SMOOTH, covered, disturbed, shipped
from turnwright.cutting import learn_material

HELD = 0.90
"""Share of experiments in which a 95 % interval must hold the truth."""

FALSE = 0.02
"""Share of experiments without a transition that may show one."""


RECORDS, WITHIN = 0.93, (0.01, 0.01, 0.03)
"""The same of disturbed records of a ramp, and how far each number, and half of its interval, may be off."""


def main(cases: int = 100, seed: int = 1) -> int:
    """Print a table of coverages; return 1 if one of them is below what 95 % intervals must reach."""
    print(f"{'forces':14}{'found':>8}{'Kc':>8}{'Kt':>8}{'limit':>8}   of {cases} experiments")
    failed = False
    for kind, share in KINDS.items():
        found, *inside = covered(kind, cases, seed)
        print(f"{kind:14}" + "".join(f"{one:8.3f}" for one in (found, *inside)))
        wrong = found > FALSE if share is None else found < 1 or inside[2] < HELD
        failed |= bool(wrong or min(inside[:2]) < HELD)
    for kind in SMOOTH:
        found = covered(kind, cases, seed)[0]
        print(f"{kind:14}{found:8.3f}")
        failed |= found > FALSE
    learned = [learn_material(shipped(one)) for one in range(cases)]
    held = sum(one.cutting.low <= KC <= one.cutting.high for one in learned) / cases
    found = sum(one.critical is not None for one in learned) / cases
    away = max(abs(one.cutting.value / KC - 1) for one in learned)
    bias = sum((one.cutting.value - KC) / (one.cutting.high - one.cutting.low) * 2 for one in learned) / cases
    print(f"{'IRG 26':14}{found:8.3f}{held:8.3f}   Kc off by {away:.2%} at most, {bias:+.2f} half intervals on average")
    off, inside, half = np.moveaxis(disturbed(cases), 2, 0)
    print(f"{'records':14}{'':8}" + "".join(f"{one:8.3f}" for one in inside.mean(axis=0)))
    failed |= bool((inside.mean(axis=0) < RECORDS).any() or (np.maximum(np.abs(off), half).max(axis=0) > WITHIN).any())
    return int(failed or held < HELD or found < 1 or away > 0.03)


if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:3])))
