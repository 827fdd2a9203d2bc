"""The stated PV of random jobs against grids: no grid may show more, and one refined around its own extremes is met.

The oracle is the simulator on grids of its own choice, which share no code with the search: grids over the whole part,
over the innermost and the outermost turns, and one that crowds toward the axis, or toward the edge of what a tool off
centre leaves uncut there. Each is refined around its highest and its lowest heights until these move by less than
0.1 %.

    python tests/proof/proof_verdict.py [jobs] [seed] [first]
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import turnwright as tw
from tolerance_jobs import SERVO
from turnwright.job import finishing_motion

TURN = 2 * np.pi
NM = 1e6


def random_job(rng: np.random.Generator, *, largest: float = 2.0) -> dict:
    """Return the table of a job: surface, tool, feed, points, deviations of the tool, with or without servos."""
    radius = rng.uniform(0.3, largest)

    def um(low, high):
        return f"{rng.uniform(low, high):.6g} um"

    def mm(low, high):
        return f"{rng.uniform(low, high) * rng.choice((-1, 1)):.6g} mm"

    surface = [
        {"family": "plane", "slope": [rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02)]},
        {"family": "sphere", "radius": mm(15, 60)},
        {"family": "conic", "radius": mm(15, 60), "conic": rng.uniform(-3, 1)},
        {"family": "toroid", "radius_x": mm(20, 60), "radius_y": mm(20, 60)},
        {"family": "sine grid", "amplitude": [um(0.2, 1), um(0.2, 1)], "period": ["1.3 mm", "1.7 mm"]},
        {"family": "lens array", "layout": "square", "lenslet": {"family": "sphere", "radius": "30 mm"},
         "pitch": f"{rng.uniform(0.4, 1):.3g} mm", "within": "6 mm"},
    ][rng.integers(6)]  # fmt: skip
    if "slope" in surface:
        surface["slope"] = [round(one, 5) for one in surface["slope"]]
    table = {
        "part": {"radius": f"{radius:.6g} mm", "surface": surface},
        "tool": {"nose_radius": f"{rng.uniform(0.1, 1.5):.4g} mm", "included": "100 deg", "clearance": "12 deg"},
        "machine": {"name": "generic"},
        "strategy": {
            "kind": "slow tool servo", "feed": f"{rng.uniform(3, 30):.4g} um/rev", "spindle_speed": "40 rpm",
            **({"points_per_rev": int(rng.integers(48, 400))}, {"arc_length": um(8, 60), "max_step": "4 deg"},
               {"chord": f"{rng.uniform(1, 20):.4g} nm"})[rng.integers(3)],
        },
        "actual": {"tool": {}},
        "accept": ["nose radius", "included angle", "clearance", "rake", "valley", "step", "limits"],
    }  # fmt: skip
    actual = table["actual"]["tool"]
    if rng.random() < 0.3:
        actual["radius_error"] = um(-1, 1)
    if rng.random() < 0.3:
        actual["offset"] = [um(-2, 2), um(-2, 2) if rng.random() < 0.5 else "0 um", um(-0.5, 0.5)]
    if rng.random() < 0.2:
        actual["waviness"] = ["0 um/rad", f"{rng.uniform(-1, 1):.4g} um/rad^2", f"{rng.uniform(-1, 1):.4g} um/rad^3"]
    if rng.random() < 0.15:
        table["tool"]["rake"] = "-15 deg"
    if rng.random() < 0.3:
        table["simulation"] = {"tracking": True}
    return table


def error_of(motion, job, radius, angle, sign):
    """Return ``sign`` times the error on a polar grid, -inf where nothing is cut."""
    made = tw.generate_polar(motion, job.actual_tool, radius=radius, angle=angle, machine=job.actual_machine)
    return np.nan_to_num(sign * made.minus(job.part.surface).z, nan=-np.inf)


def refined(motion, job, radius, angle, sign):
    """Return the highest (of ``sign`` times the error) of a grid, refined around its eight highest places.

    These are of different parts of the grid; each is refined until it moves by less than 0.1 %.
    """
    error = error_of(motion, job, radius, angle, sign)
    tops = []
    for rows in np.array_split(np.arange(angle.size), 6):
        for columns in np.array_split(np.arange(radius.size), 6):
            some = error[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            i, j = np.unravel_index(some.argmax(), some.shape)
            tops.append((some[i, j], rows[0] + i, columns[0] + j))
    tops.sort(reverse=True)
    return max(float(closer(motion, job, radius, angle, sign, *top)) for top in tops[:8])


def closer(motion, job, radius, angle, sign, top, i, j):
    """Return the highest around one place of a grid."""
    before = -np.inf
    while np.isfinite(top) and top - before > 1e-3 * abs(top) and abs(top) > 1e-10:
        before, turned = top, 2 * np.diff(angle).max()
        low, high = radius[max(j - 2, 0)], radius[min(j + 2, radius.size - 1)]
        if high - low < 1e-12:
            break
        radius = np.unique(np.linspace(low, high, 81))
        angle = angle[i] + turned * np.linspace(-1, 1, 41)
        error = error_of(motion, job, radius, angle, sign)
        i, j = np.unravel_index(error.argmax(), error.shape)
        top = max(top, error[i, j])
    return top


def judged(table: dict, rng: np.random.Generator) -> dict[str, float]:
    """Return stated and refined PV [nm], how much a grid shows more [nm], and seconds of the map and of the search."""
    if "simulation" in table:
        with tempfile.TemporaryDirectory() as folder:
            lathe = Path(folder) / "lathe.toml"
            lathe.write_text(SERVO, encoding="utf-8")
            job = tw.Job.read(table | {"machine": {"file": str(lathe)}})
    else:
        job = tw.Job.read(table)
    motion, result = finishing_motion(job)
    prediction = result.predictions[0]
    times = result.timings
    seconds = {"map": times["simulate whole part"], "search": times["highest and lowest point"]}
    part, feed, low, high = job.part, motion.feed, [], []
    near = min(3 * feed, part.radius)
    core = abs(job.actual_tool.offset[1])
    grids = [
        (np.linspace(0, part.radius, int(rng.integers(300, 4000))), np.sort(rng.uniform(0, TURN, 90))),
        (np.linspace(0, part.radius, 801), np.linspace(0, TURN, 720, endpoint=False)),
        (np.unique(np.hypot(core, np.geomspace(1e-8, near, 121))), np.linspace(0, TURN, 90, endpoint=False)),
        (np.linspace(0, near, 181), np.linspace(0, TURN, 180, endpoint=False)),
        (np.linspace(part.radius - near, part.radius, 91), np.linspace(0, TURN, 360, endpoint=False)),
    ]
    for radius, angle in grids:
        high.append(refined(motion, job, radius, angle, 1.0))
        low.append(refined(motion, job, radius, angle, -1.0))
    form = prediction.form
    beyond = max(max(high) - form.highest.error, max(low) + form.lowest.error)
    return {"stated": prediction.pv_nm, "refined": (max(high) + max(low)) * NM, "beyond": beyond * NM, **seconds}


def main(jobs: int = 30, seed: int = 0, first: int = 0) -> int:
    """Judge random jobs from the number ``first`` on and print a table; return 1 if one fails."""
    failed = 0
    print(f"{'job':>4} {'surface':12} {'stated':>10} {'refined':>10} {'beyond':>10} {'map':>6} {'search':>6}  [nm, s]")
    for number in range(first, first + jobs):
        rng = np.random.default_rng([seed, number])
        table = random_job(rng)
        start = time.perf_counter()
        try:
            found = judged(table, rng)
        except tw.InputError as error:
            failed += 1  # every job that is drawn can be cut
            print(f"{number:4} FAILS, refused: {str(error)[:90]}")
            continue
        bad = found["beyond"] > 1e-6 or found["stated"] > 1.01 * found["refined"] + 1e-3
        failed += bad
        family = table["part"]["surface"]["family"] + (" *" if "simulation" in table else "")
        print(
            f"{number:4} {family:12} {found['stated']:10.4f} {found['refined']:10.4f} {found['beyond']:10.2e} "
            f"{found['map']:6.2f} {found['search']:6.2f}{'  FAILS' if bad else ''} {time.perf_counter() - start:.1f}",
            flush=True,
        )
    print(f"{failed} of {jobs} jobs fail; those marked * with the answer of the servos")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:])))
