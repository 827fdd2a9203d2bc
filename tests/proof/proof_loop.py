"""Blind parts cut by brute force, measured, diagnosed, corrected and cut again: none may become worse.

Nothing of what is cut and judged here is the program's own simulation, see `blind_parts`. Every part is
taken as one map, and as two maps of two cuts. In half of the drift parts the drift is drawn again for each cut.

``python -m tests.proof.proof_loop [PARTS] [SEED]``, so many of each group, prints one table of figures and fails if one
of them does.
"""

import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import turnwright as tw
from turnwright.errors import CorrectionError
from turnwright.job import Job, correct, diagnose, measure
from turnwright.placing import touch

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import blind_parts as blind

NM = 1e6
GROUPS = ("modelled", "lobed", "drift", "tilt", "mixture")
PIXELS, SEEN, ACROSS = 71, 0.98, 6
WORSE_NM = 1.0


@dataclass
class Sample:
    """A design, how it is cut, and what is wrong."""

    design: blind.Design
    table: dict
    radius: float
    nose: float
    feed: float
    noise: float
    errors: list  # of each cut, the last of them that after the correction
    phases: np.ndarray
    plausible: dict = field(default_factory=dict)  # sizes of the tool's deviations
    per_rev: int = 1440  # points of the program, by which alone the program sees the part
    pixels: int = PIXELS  # across a map
    job: Job = field(init=False)

    def __post_init__(self):
        self.job = Job.read(
            {
                "part": {"name": self.design.name, "radius": f"{self.radius!r} mm", "surface": self.table},
                "tool": {
                    "nose_radius": f"{self.nose!r} mm", "included": "120 deg", "clearance": "15 deg",
                    "plausible": self.plausible,
                },
                "machine": {"name": "generic"},
                "strategy": {
                    "kind": "slow tool servo", "feed": f"{self.feed!r} mm/rev", "points_per_rev": self.per_rev,
                    "spindle_speed": "20 rpm",
                },
                "measurement": {"waviness": [3, 4]},
            }
        )  # fmt: skip

    def error(self, number, x, y, commanded=None, errors=None):
        """Return cut minus design across a feed around each place. (n, ACROSS) [mm]."""
        cut = blind.Cut(design=self.design, nose=self.nose, feed=self.feed, radius=self.radius, commanded=commanded)
        radius, angle = np.hypot(x, y)[:, None], np.arctan2(y, x)[:, None]
        across = np.abs(radius + self.feed * ((np.arange(ACROSS) + 0.5) / ACROSS - 0.5))
        u, v = (across * np.cos(angle)).ravel(), (across * np.sin(angle)).ravel()
        errors = self.errors[number] if errors is None else errors
        left = blind.left(cut, errors, u, v, passes=5, phase=self.phases[number])
        return (left - self.design.of(u, v)[0]).reshape(across.shape)

    def map(self, number, random):
        """Return what an instrument shows whose pixel is a feed wide."""
        axis = np.linspace(-self.radius, self.radius, self.pixels)
        x, y = np.meshgrid(axis, axis)
        on = np.hypot(x, y) < SEEN * self.radius
        z = np.full(x.shape, np.nan)
        error = self.error(number, x[on], y[on]).mean(axis=1)
        z[on] = np.where(np.isfinite(error), error, np.nan) + self.design.of(x[on], y[on])[0]
        return tw.HeightMap(x=axis, y=axis, z=z + self.noise * random.normal(size=z.shape), name=f"cut {number}")

    def judged(self, commanded=None, errors=None):
        """Return the form error of the last cut, cusps included: rms of the best fit in all directions. [nm]."""
        count = np.arange(2500) + 0.5
        radius, angle = SEEN * self.radius * np.sqrt(count / count.size), np.pi * (1 + np.sqrt(5)) * count
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        error = self.error(-1, x, y, commanded, errors)
        known = np.isfinite(error).all(axis=1) & (radius > 0.05 * self.radius)
        x, y, error = x[known], y[known], error[known]
        _, zx, zy, *_ = self.design.of(x, y)
        rows = np.stack([np.ones_like(x), x, y, zx, zy, y * zx - x * zy], axis=1)
        mean = error.mean(axis=1)
        pose = rows @ np.linalg.lstsq(rows, mean, rcond=1e-9)[0]
        return float(np.sqrt(np.mean((error - pose[:, None]) ** 2))) * NM


def commander(job):
    """Return where the tip is sent by a job: with its tool and machine, at the part that it aims at."""
    aim, tool, slope = job.part.aimed.surface, job.tool, job.machine.squareness

    def height(rho, theta):
        rho, theta = np.broadcast_arrays(rho, theta)
        z = touch(aim, tool, angle=theta.ravel().copy(), radius=rho.ravel().copy(), sense=1).z
        return z.reshape(rho.shape) - slope * rho

    return height


def draw_design(random):
    kind = random.integers(4)
    if kind == 0:
        radius = float(random.choice([-1, 1]) * random.uniform(12, 60))
        return blind.sphere(radius), {"family": "sphere", "radius": f"{radius!r} mm"}
    if kind == 1:
        one, other = (float(radius) for radius in random.uniform(12, 40, 2))
        table = {"family": "toroid", "radius_x": f"{one!r} mm", "radius_y": f"{other!r} mm"}
        return blind.toroid(one, other), table
    if kind == 2:
        slope = float(random.uniform(0.0, 0.03))
        return blind.flat((slope, 0.0)), {"family": "plane", "slope": [slope, 0.0]}
    sizes = {
        (2, 0): (0.005, 0.03), (0, 2): (0.005, 0.03), (3, 0): (-2e-3, 2e-3), (1, 2): (-2e-3, 2e-3),
        (2, 2): (-5e-4, 5e-4),
    }  # fmt: skip
    terms = {powers: float(random.uniform(*limits)) for powers, limits in sizes.items()}
    table = {"family": "xy polynomial", "units": "mm", "terms": {f"{i},{j}": value for (i, j), value in terms.items()}}
    return blind.freeform(terms), table


def draw_errors(random, group):
    wrong = {}
    if group in ("modelled", "mixture"):
        wrong |= {
            "offset": (random.normal() * 4e-3, random.normal() * 3e-3, 0.0),
            "radius": random.normal() * 2e-3,
            "waviness": {3: random.normal() * 2e-3, 4: random.normal() * 4e-3},
            "squareness": random.normal() * 3e-5,
        }
    if group in ("lobed", "mixture"):
        for name, orders, many in (("axial", range(1, 7), 2), ("radial", range(2, 7), 1)):
            chosen = random.choice(orders, many, replace=False)
            wrong[name] = {int(k): tuple(random.normal(size=2) * 40e-6) for k in chosen}
    if group in ("drift", "mixture"):
        z, tau, x = random.normal() * 150e-6, random.uniform(0.1, 0.8), random.normal() * 100e-6
        wrong["drift_z"] = lambda share: z * (1 - np.exp(-share / tau))
        wrong["drift_x"] = lambda share: x * (1 - np.exp(-share / tau))
    if group == "tilt":
        wrong["tilt"] = tuple(random.normal(size=2) * 1e-4)
    return blind.Errors(**wrong)


def draw(random, group, *, anew):
    design, table = draw_design(random)
    first = draw_errors(random, group)
    errors = [first, *(draw_errors(random, group) if anew else first for _ in range(2))]
    return Sample(
        design=design, table=table, radius=float(random.uniform(1.5, 4)), nose=float(random.uniform(0.5, 1.5)),
        feed=float(random.uniform(5e-3, 12e-3)), noise=random.uniform(2, 8) * 1e-6, errors=errors,
        phases=random.random(3),
    )  # fmt: skip


def truth(errors, name):
    known = {
        "offset x": errors.offset[0], "offset y": errors.offset[1], "radius error": errors.radius,
        "squareness": errors.squareness,
    }  # fmt: skip
    return known.get(name, errors.waviness.get(int(name[-1]), 0.0) if name.startswith("waviness") else 0.0)


@dataclass
class Outcome:
    """What became of a part."""

    before: float
    after: float
    clean: float
    written: bool
    stake: float
    anew: bool
    seconds: float


def outcome(sample, maps, found, seconds, *, anew):
    """Correct a part, cut it again, and judge that."""
    before, clean = sample.judged(), sample.judged(errors=blind.Errors())
    with tempfile.TemporaryDirectory() as folder:
        try:
            better = correct(sample.job, found, maps, out=folder)
        except CorrectionError as error:
            return Outcome(before, before, clean, False, 0.0, anew, seconds), str(error)
        after = sample.judged(commander(better.job))
    return Outcome(before, after, clean, True, better.proof.at_stake_nm, anew, seconds), "; ".join(better.sources)


def failures(group, count, outcomes):
    """Name the figures of a group that are not as they must be."""
    bad = []
    for one in outcomes:
        known = WORSE_NM + (one.stake if one.anew and count == 1 else 0.0)
        if one.after > one.before + known:
            bad.append(f"{group}, {count} maps: {one.before:.1f} nm become {one.after:.1f} nm")
    steady = [one for one in outcomes if not one.anew]
    # Of a part that is nearly clean there is no half to be taken off.
    halved = [one.after <= max(0.5 * one.before, 1.3 * one.clean) for one in steady]
    if group in ("lobed", "drift") and np.mean(halved) < 0.9:
        bad.append(f"{group}, {count} maps: fewer than 90 % at most half as far off")
    if group == "modelled" and np.mean([one.after <= 1.3 * one.clean for one in steady]) < 0.9:
        bad.append(f"{group}, {count} maps: fewer than 90 % within 1.3 times the clean part")
    return bad


def main(parts=24, seed=1):
    """Print one table of figures; return the number of those that fail."""
    bad = []
    print("group     maps written   before    after    clean   rise  half  1.3 clean   intervals      s")
    for group in GROUPS:
        random = np.random.default_rng([seed, GROUPS.index(group)])
        outcomes, hits = {1: [], 2: []}, []
        for number in range(parts):
            anew = group == "drift" and number % 2 == 1
            sample = draw(random, group, anew=anew)
            maps = [measure(sample.job, sample.map(k, random)) for k in range(2)]
            for count in (1, 2):
                start = time.perf_counter()
                found = diagnose(maps[:count])
                seconds = time.perf_counter() - start
                one, why = outcome(sample, maps[:count], found, seconds, anew=anew)
                outcomes[count].append(one)
                print(
                    f"  {group}{'*' * anew} {sample.design.name} {count}: {one.before:.2f} -> {one.after:.2f} "
                    f"({one.clean:.2f}) at stake {one.stake:.1f} {'' if one.written else 'refused '}{why}",
                    file=sys.stderr, flush=True,
                )  # fmt: skip
                if count == 1:
                    hits += [
                        found[name].interval[0] <= truth(sample.errors[0], name) <= found[name].interval[1]
                        for name in found.names
                        if found[name].determined
                    ]
        for count, every in outcomes.items():
            before, after, clean = (
                np.array([getattr(one, name) for one in every]) for name in ("before", "after", "clean")
            )
            report = f"{np.mean(hits):.3f} of {len(hits)}" if count == 1 and hits else ""
            print(
                f"{group:9s} {count:4d} {np.mean([one.written for one in every]):7.2f} {np.median(before):8.2f} "
                f"{np.median(after):8.2f} {np.median(clean):8.2f} {np.max(after - before):6.2f} "
                f"{np.mean(after <= 0.5 * before):5.2f} {np.mean(after <= 1.3 * clean):10.2f}  {report:>13s} "
                f"{np.median([one.seconds for one in every]):5.2f}"
            )
            bad += failures(group, count, every)
        if hits and not 0.9 <= np.mean(hits) <= 0.99 and len(hits) >= ENOUGH:
            bad.append(f"{group}: intervals hold {np.mean(hits):.3f} of {len(hits)}")
    for one in bad:
        print(f"FAILED: {one}")
    return len(bad)


ENOUGH = 400
"""Intervals of a group from which their coverage is judged."""

if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:])))
