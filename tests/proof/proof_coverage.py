"""Whether intervals of a diagnosis hold the truth where the model itself has cut the part, noise included.

``python -m tests.proof.proof_coverage [TRIALS] [SEED]``, so many of each group from that seed on, prints one table of
figures and fails if a source lies in its interval in less than 90 % of the trials, if the intervals say little, or if
what is left is not the noise.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import model_trials


def main(trials=100, seed=0):
    """Print one line a group; return the number of those that fail."""
    bad = 0
    print("group                 trials   least held   left, worst [nm]   widths")
    for powers in model_trials.POWERS:
        hits, widths, left = model_trials.sources(powers, trials, seed)
        usual, worst = np.median(widths, axis=0), float(left[np.argmax(np.abs(left - 20))])
        narrow = powers != (3, 4, 5) or (usual[:4] < model_trials.NARROW).all()
        failed = bool(hits.min() < 0.9 * trials or abs(worst - 20) > 0.07 * 20 or not narrow)
        bad += failed
        report = " ".join(f"{one:.1e}" for one in usual)
        name = f"waviness {powers}"
        print(f"{name:20s} {trials:7d} {hits.min() / trials:12.3f} {worst:18.2f}   {report}{'  FAILED' * failed}")
    hits, together = model_trials.neighbours(trials, seed)
    usual = float(np.median(together))
    failed = bool(hits < 0.9 * trials or abs(usual / model_trials.AS_ONE - 1) > 0.5)
    bad += failed
    name = "noise that hangs so"
    as_one = f"{usual:.1f} points count as one, {model_trials.AS_ONE:.1f} do"
    print(f"{name:20s} {trials:7d} {hits / trials:12.3f} {'':18s}   {as_one}{'  FAILED' * failed}")
    return bad


if __name__ == "__main__":
    sys.exit(min(main(*(int(one) for one in sys.argv[1:])), 1))
