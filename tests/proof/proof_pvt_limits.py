"""Peaks of random PVT motions against SciPy's cubics, and the limits that `drive` keeps.

Run as ``python -m tests.proof.proof_pvt_limits 1000 1`` (number of cases, seed).
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "truth"))
import pvt_oracle

from turnwright import LimitError


def main(cases: int = 300, seed: int = 1) -> int:
    """Print one table, and return 1 if a figure fails."""
    rows = defaultdict(list)
    refused = 0
    for number in range(cases):
        try:
            kind, motion, machine, sought = pvt_oracle.case(np.random.default_rng((seed, number)))
        except LimitError:  # a path too short for its limits
            refused += 1
            continue
        off, used = pvt_oracle.judge(motion, machine)
        rows[kind].append((number, off, used if sought else 0.0))
    failed = 0
    print(f"{'motion':8} {'cases':>6} {'peaks off by':>13} {'limit used to':>16} {'case':>6}")
    for kind, found in sorted(rows.items()):
        number, _, used = max(found, key=lambda one: one[2])
        off = max(one[1] for one in found)
        failed += off > 1e-9 or used > 1 + 1e-9
        print(f"{kind:8} {len(found):6} {max(off, 0.0):13.1e} {used:16.12f} {number:6}")
    print(f"refused {refused}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:])))
