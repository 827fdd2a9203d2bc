"""Surfaces of motions whose Y moves, against every pass found by dense sampling: 10,000 points, 1e-9 mm."""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import turnwright as tw
from moving_motions import CASES, random_maps, random_points, reach
from pass_oracle import Passes

LIMIT = 1e-9


def compared(passes, x, y, got):
    """Return how many of some heights are not those of the oracle, and the largest error of the rest."""
    expected = np.array([passes.lowest(*point) for point in zip(x, y, strict=True)])
    reached = np.isfinite(expected) & np.isfinite(got)
    off = np.abs(got[reached] - expected[reached])
    return int((np.isfinite(got) != np.isfinite(expected)).sum() + (off > LIMIT).sum()), off.max(initial=0.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("points", type=int, nargs="?", default=10_000)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    given = parser.parse_args()
    random = np.random.default_rng(given.seed)
    count = -(-given.points // len(CASES))
    print(f"{'motion':32} {'points':>7} {'wrong':>6} {'in maps':>8} {'wrong':>6} {'largest error, mm':>18} {'s':>7}")
    total, wrong, worst = 0, 0, 0.0
    for name, (motion, tool) in CASES.items():
        begin = time.perf_counter()
        passes = Passes(motion, tool)
        x, y = random_points(random, count, reach(motion))
        bad, off = compared(passes, x, y, tw.generate_points(motion, tool, x=x, y=y))
        in_maps, bad_in_maps = 0, 0
        for made in random_maps(random, motion, tool).values():
            x, y = (one.ravel() for one in made.points())
            some = random.choice(x.size, min(count // 20 + 1, x.size), replace=False)
            of_map = compared(passes, x[some], y[some], made.z.ravel()[some])
            in_maps, bad_in_maps, off = in_maps + some.size, bad_in_maps + of_map[0], max(off, of_map[1])
        total, wrong, worst = total + count + in_maps, wrong + bad + bad_in_maps, max(worst, off)
        print(
            f"{name:32} {count:7} {bad:6} {in_maps:8} {bad_in_maps:6} {off:18.2e} {time.perf_counter() - begin:7.2f}",
            flush=True,
        )
    print(f"{total} points, {wrong} wrong, largest error {worst:.2e} mm, limit {LIMIT:g} mm")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
