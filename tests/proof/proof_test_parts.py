"""Two test parts whose maps are off their axis, and the part that is cut after them: 1.5 times a clean part at most.

Oracle: brute-force cutting, see `blind_parts`; nothing of what is cut and judged is the program's own
simulation. A tilted flat and a concave sphere are cut with the errors of the part, their maps are decentred by up to
30 um, and the part is planned with what both show.

``python -m tests.proof.proof_test_parts [PAIRS] [SEED]`` prints one line a pair and fails if one of them does.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.proof.proof_loop import Sample, commander, draw, truth
from turnwright.errors import CorrectionError
from turnwright.job import correct, diagnose, make_test_part, measure

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import blind_parts as blind

OFF = 0.03
WORST = 1.5


def maps_of(part, random):
    """Return the measured test parts of a part, decentred."""
    measured = []
    for kind in ("tilted flat", "concave sphere"):
        job = make_test_part(part.job, kind)
        surface = job.part.surface
        design = blind.flat(surface.slope) if kind == "tilted flat" else blind.sphere(surface.radius)
        cut = Sample(
            design=design, table={"family": "plane", "slope": [0.0, 0.0]}, radius=job.part.radius, nose=part.nose,
            feed=part.feed, noise=part.noise, errors=part.errors, phases=random.random(3),
        )  # fmt: skip
        heights = cut.map(0, random)
        away, angle = OFF * np.sqrt(random.random()), 2 * np.pi * random.random()
        heights = replace(heights, x=heights.x + away * np.cos(angle), y=heights.y + away * np.sin(angle), name=kind)
        measured.append(measure(job, heights))
    return measured


def main(pairs=12, seed=1):
    """Print one line a pair; return the number of those that fail."""
    random, bad = np.random.default_rng(seed), 0
    for number in range(pairs):
        part = draw(random, "modelled", anew=False)
        found = diagnose(maps_of(part, random))
        before, clean, why = part.judged(), part.judged(errors=blind.Errors()), ""
        with tempfile.TemporaryDirectory() as folder:
            try:
                better = correct(part.job, found, out=folder)
                after = part.judged(commander(better.job))
            except CorrectionError as error:
                after, why = before, str(error)
        held = [
            found[name].interval[0] <= truth(part.errors[0], name) <= found[name].interval[1]
            for name in found.names
            if found[name].determined
        ]
        bad += after > WORST * clean
        print(
            f"{number + 1:3d} {part.design.name:9s} {before:7.2f} -> {after:6.2f} nm, clean {clean:5.2f} nm; "
            f"{sum(held)} of {len(held)} intervals hold {'FAILED ' if after > WORST * clean else ''}{why}",
            flush=True,
        )
    print(f"{bad} of {pairs} pairs fail")
    return bad


if __name__ == "__main__":
    sys.exit(min(main(*(int(one) for one in sys.argv[1:])), 1))
