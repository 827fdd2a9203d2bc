"""Placing on surfaces steeper than the flanks: 1,000 tips on 20 surfaces against brute force over the whole edge.

Run it as ``python -m tests.proof.proof_placing [tips] [seed]``.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from steep_oracle import CASES, errors

LIMIT = 1e-9


def main(tips: int = 1000, seed: int = 1) -> int:
    """Print the largest errors for each surface and tool; return 1 if one is above 1e-9 mm."""
    random, bad = np.random.default_rng(seed), 0
    runs = [(name, tool) for name in CASES for tool in CASES[name].tools]
    print(f"{'surface':22s} {'tool':8s} {'tips':>5s} {'lowest':>10s} {'highest':>10s} {'clearance':>10s} mm, s")
    for k, (name, tool) in enumerate(runs):
        count, begin = (k + 1) * tips // len(runs) - k * tips // len(runs), time.perf_counter()
        both = [errors(name, tool, random, n, way) for n, way in ((count // 2, True), (count - count // 2, False))]
        found = np.concatenate([one for one, _ in both])
        clear = min(one for _, one in both)
        bad += int(np.count_nonzero(np.abs(found) > LIMIT)) + (clear < -LIMIT)
        took = time.perf_counter() - begin
        print(f"{name:22s} {tool:8s} {count:5d} {found.min():10.1e} {found.max():10.1e} {clear:10.1e} {took:5.1f}")
    print(f"{bad} of {tips} tips are off by more than {LIMIT:g} mm")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main(*(int(one) for one in sys.argv[1:])))
