"""Whether 95 % intervals of a diagnosis hold the truth: small maps of blind parts, a single one of each.

What is cut is not the program's own simulation, see `blind_parts`. Only sources that the diagnosis calls
determined count. Where nothing but sources is wrong, or the spindle is tilted, the intervals are wider than they need
be: one map does not show that a part has neither lobes nor drift. They are not where the machine states that it does
not drift.

``python -m tests.proof.proof_intervals [PARTS] [SEED]``, so many of each group, prints one table of figures and fails
if a group of at least 400 intervals is below 90 %, or above 99 % where drift, lobes or all of it are at work.
"""

import sys
import time
from dataclasses import replace

import numpy as np

import turnwright as tw
from tests.proof import proof_loop
from tests.proof.proof_loop import GROUPS, draw, truth

PIXELS = 45
ENOUGH = 400
LEAST, MOST = 0.90, 0.99

NO_DRIFT = {"drift of X": 1e-7, "drift of Z": 1e-7}

CASES = (("modelled, no drift", "modelled", NO_DRIFT), *((group, group, {}) for group in GROUPS))
"""Name, group of parts, and what the machine states."""

WIDE = frozenset({"modelled", "tilt"})
"""Cases whose intervals may hold more often than in 99 of 100."""


def main(parts=140, seed=4):
    """Print one line a case; return the number of those that fail."""
    proof_loop.PIXELS, bad = PIXELS, 0
    print("case                intervals   held   farthest off [standard uncertainties]   s")
    for name, group, stated in CASES:
        random = np.random.default_rng([seed, GROUPS.index(group)])
        hits, off, start = [], [], time.perf_counter()
        for _ in range(parts):
            part = draw(random, group, anew=False)
            heights, job = part.map(0, random), part.job
            machine = job.machine
            machine = replace(machine, plausible={**machine.plausible, **stated})
            found = tw.diagnose(heights, job.part, job.tool, machine, feed=part.feed, waviness=(3, 4))
            for one in found:
                if one.determined:
                    right = truth(part.errors[0], one.name)
                    hits.append(one.interval[0] <= right <= one.interval[1])
                    off.append((one.value - right) / one.standard_uncertainty)
        share = float(np.mean(hits))
        failed = len(hits) >= ENOUGH and not LEAST <= share <= (1.0 if name in WIDE else MOST)
        bad += failed
        print(
            f"{name:18s} {len(hits):10d} {share:6.3f} {np.abs(off).max():10.1f} {time.perf_counter() - start:36.0f}"
            f"{'  FAILED' if failed else ''}",
            flush=True,
        )
    return bad


if __name__ == "__main__":
    sys.exit(min(main(*(int(one) for one in sys.argv[1:])), 1))
