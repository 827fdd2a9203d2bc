"""Whether 95 % intervals of a diagnosis hold the truth: small maps of blind parts, a single one of each.

What is cut is not the program's own simulation, see `tests.loop.blind_parts`. Only sources that the diagnosis calls
determined count. Where nothing but sources is wrong, the intervals are wider than they need be: that a part has neither
lobes nor drift is not known beforehand.

``python -m tests.proof.proof_intervals [PARTS] [SEED]``, so many of each group, prints one table of figures and fails
if a group of at least 400 intervals is not between 90 and 99 %.
"""

import sys
import time

import numpy as np
from tests.proof import proof_loop
from tests.proof.proof_loop import GROUPS, draw, truth

import turnwright as tw

PIXELS = 45
ENOUGH = 400


def main(parts=140, seed=4):
    """Print one line a group; return the number of those that fail."""
    proof_loop.PIXELS, bad = PIXELS, 0
    print("group      intervals   held   farthest off [standard uncertainties]   s")
    for group in GROUPS:
        random = np.random.default_rng([seed, GROUPS.index(group)])
        hits, off, start = [], [], time.perf_counter()
        for _ in range(parts):
            part = draw(random, group, anew=False)
            heights, job = part.map(0, random), part.job
            found = tw.diagnose(
                heights, job.part.part, job.tool.tool, job.machine.machine, feed=part.feed, waviness=(3, 4)
            )
            for one in found:
                if one.determined:
                    right = truth(part.errors[0], one.name)
                    hits.append(one.interval[0] <= right <= one.interval[1])
                    off.append((one.value - right) / one.standard_uncertainty)
        share = float(np.mean(hits))
        failed = len(hits) >= ENOUGH and not 0.90 <= share <= 0.99
        bad += failed
        print(
            f"{group:9s} {len(hits):10d} {share:6.3f} {np.abs(off).max():10.1f} {time.perf_counter() - start:36.0f}"
            f"{'  FAILED' if failed else ''}",
            flush=True,
        )
    return bad


if __name__ == "__main__":
    sys.exit(min(main(*(int(one) for one in sys.argv[1:])), 1))
