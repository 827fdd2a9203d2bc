"""Peaks of random PVT motions against SciPy's cubics, the limits that `drive` keeps, and stated speeds.

The speed that is sought must be the highest: a stated speed above it may not keep every limit, one below it must be
reached exactly, within every limit. A higher speed beyond one that gains nothing is missed, as `drive` says: of some
hundred motions two higher ones may be so.

Run as ``python -m tests.proof.proof_pvt_limits 1000 1`` (number of cases, seed).
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import pvt_oracle
from turnwright import drive
from turnwright.errors import LimitError

MISSED = 0.02
"""Share of the motions for which a stated higher speed may keep every limit."""

HIGHER, LOWER = (1.01, 1.1, 1.3), (0.999999, 0.9, 0.5)
"""Stated speeds, as shares of the one that is sought."""


def misjudged(path, servo, machine, motion):
    """Return how many stated speeds are not judged as they should be: higher, and lower ones."""
    top = pvt_oracle.top_rpm(motion)
    higher = sum(pvt_oracle.stated(path, servo, machine, share * top)[0] for share in HIGHER)
    lower = 0
    for share in LOWER:
        within, reached = pvt_oracle.stated(path, servo, machine, share * top)
        lower += not (within and abs(reached / top / share - 1) < 1e-9)
    return higher, lower


def main(cases: int = 300, seed: int = 1) -> int:
    """Print one table, and return 1 if a figure fails."""
    rows = defaultdict(list)
    refused, sought, higher, lower = 0, 0, 0, 0
    for number in range(cases):
        kind, path, servo, machine, profile = pvt_oracle.setting(np.random.default_rng((seed, number)))
        try:
            motion = drive(path, servo, machine, profile=profile)
        except LimitError:  # a path too short for its limits
            refused += 1
            continue
        off, used = pvt_oracle.judge(motion, machine)
        rows[kind].append((number, off, used if profile is None else 0.0))
        if motion.velocity is not None and motion.velocity["C"][0] == 0 and not machine.controller.variable_speed:
            sought += 1
            above, below = misjudged(path, servo, machine, motion)
            higher, lower = higher + above, lower + below
    failed = lower + (higher > MISSED * sought)
    print(f"{'motion':8} {'cases':>6} {'peaks off by':>13} {'limit used to':>16} {'case':>6}")
    for kind, found in sorted(rows.items()):
        number, _, used = max(found, key=lambda one: one[2])
        off = max(one[1] for one in found)
        failed += off > 1e-9 or used > 1 + 1e-9
        print(f"{kind:8} {len(found):6} {max(off, 0.0):13.1e} {used:16.12f} {number:6}")
    print(f"refused {refused}")
    print(f"of {sought} highest speeds, {higher} stated higher ones keep every limit, {lower} lower ones do not")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:])))
