"""Approach, plunge and retract of random jobs, by a reader and a model of the material that share no code with ours.

``python -m tests.proof.proof_approach [CASES] [SEED]`` prints one table of figures and fails if one of them does.
"""

import math
import re
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

TURN = 2 * math.pi
ROUNDING = 2e-6
"""Twice the last decimal of a program. [mm]"""


# ---------------------------------------------------------------- surfaces, in closed form of their own
def surfaces(random, radius):
    """Yield a table of a job and its height as a function of x and y."""
    kind = random.choice(["plane", "sphere", "sine", "saddle", "steep sphere", "steep waves"])
    if kind == "plane":
        slope = random.uniform(-0.05, 0.05, 2)
        table = {"family": "plane", "slope": [float(one) for one in slope]}
        return table, lambda x, y: slope[0] * x + slope[1] * y
    if kind == "steep waves":
        a, b = (f"{one:.5f}" for one in random.uniform(0.005, 0.025, 2))
        k, m = (int(one) for one in random.integers(5, 10, 2))
        table = {"family": "expression", "units": "mm", "formula": f"{a}*sin({k}*x)+{b}*cos({m}*y)"}
        a, b = float(a), float(b)
        return table, lambda x, y: a * np.sin(k * x) + b * np.cos(m * y)
    if kind in ("sphere", "steep sphere"):
        steep = kind == "steep sphere"
        bend = float(random.choice([-1, 1]) * random.uniform(1.15 if steep else 6, 3 if steep else 60) * radius)
        return {
            "family": "sphere",
            "radius": f"{bend!r} mm",
        }, lambda x, y: (x * x + y * y) / (bend * (1 + np.sqrt(np.maximum(1 - (x * x + y * y) / bend**2, 0.0))))
    if kind == "sine":
        height, period = random.uniform(0.0005, 0.004, 2), random.uniform(0.8, 2.0, 2) * radius
        table = {
            "family": "sine grid", "amplitude": [f"{float(one)!r} mm" for one in height],
            "period": [f"{float(one)!r} mm" for one in period],
        }  # fmt: skip
        return table, lambda x, y: height[0] * np.sin(TURN * x / period[0]) + height[1] * np.sin(TURN * y / period[1])
    a, b = (float(one) for one in random.uniform(-0.02, 0.02, 2) / radius)
    table = {"family": "expression", "formula": f"{a:.12f}*x^2 + {b:.12f}*y^2"}
    a, b = float(f"{a:.12f}"), float(f"{b:.12f}")
    return table, lambda x, y: a * x * x + b * y * y


@dataclass
class Case:
    """A job, and what is known of it without ours."""

    table: dict
    height: object
    radius: float
    stock: float
    blank: float | None
    nose: float
    half: float
    plunge_feed: float
    allowances: list = field(default_factory=list)

    def edge(self, u):
        """Height of a round nose with straight flanks."""
        far = self.nose * math.sin(self.half)
        inside = np.clip(u, -far, far)
        return self.nose - np.sqrt(self.nose**2 - inside**2) + (np.abs(u) - np.abs(inside)) * math.tan(self.half)

    def contact(self, x, theta, rim):
        """Height of the tip in contact at one azimuth, the part going on to a rim: a dense maximum, refined."""
        far = self.nose * math.sin(self.half)
        low, high = max(x - far, -rim), min(x + far, rim)
        for count in (2001, 201, 201):
            rho = np.linspace(low, high, count)
            c, s = np.cos(theta), np.sin(theta)
            z = self.height(rho * c, rho * s) - self.edge(rho - x)
            k = int(z.argmax())
            low, high = rho[max(k - 1, 0)], rho[min(k + 1, count - 1)]
        return float(z.max())

    def top(self, rho, theta):
        """Top of the blank at signed distances from the axis along one azimuth."""
        way = theta + np.where(rho < 0, math.pi, 0.0)
        r = np.abs(rho)
        held = np.minimum(r, self.radius)
        c, s = np.cos(way), np.sin(way)
        z = self.height(held * c, held * s)
        step = 1e-6
        rim = (
            self.height(self.radius * c, self.radius * s)
            - self.height((self.radius - step) * c, (self.radius - step) * s)
        ) / step
        z = z + self.stock + np.where(r > self.radius, np.maximum(rim, 0.0) * (r - self.radius), 0.0)
        if self.blank is not None:
            z = np.where(r > self.blank, -np.inf, z)
        return z


def case_of(random, folder):
    """Draw one job."""
    radius = float(random.uniform(0.5, 2.0))
    surface, height = surfaces(random, radius)
    nose = float(random.uniform(0.2, 1.5))
    included = float(random.uniform(90, 150))
    feed = float(random.uniform(0.02, 0.06)) * (1.0 if random.random() < 0.4 else min(1.0, nose))
    stock = float(random.choice([0.0, random.uniform(0.001, 0.02), random.uniform(0.02, 0.2)]))
    blank = None if random.random() < 0.4 else radius * float(random.uniform(1.0, 1.3))
    dialect = str(random.choice(["generic", "nanotech", "pmac"]))
    machine = {
        "generic": {"name": "generic"},
        "nanotech": {"name": "nanotech-350fg"},
        "pmac": {"file": str(folder / "pmac.toml")},
    }
    plunge = float(random.uniform(0.2, 3.0))
    strategy = {
        "kind": "slow tool servo", "feed": f"{feed!r} mm/rev", "points_per_rev": int(random.integers(24, 90)),
        "spindle_speed": f"{float(random.uniform(20, 300))!r} rpm", "sense": int(random.choice([-1, 1])),
        "inside_out": bool(random.random() < 0.3),
    }  # fmt: skip
    if random.random() < 0.5:
        beyond = 0.0 if blank is None else blank - radius
        strategy["lead_in"] = f"{beyond + float(random.uniform(0.05, 0.9))!r} mm"
    part = {"radius": f"{radius!r} mm", "surface": surface, "stock": f"{stock!r} mm"}
    if blank is not None:
        part["blank"] = {"radius": f"{blank!r} mm"}
    table = {
        "accept": ["limits"], "part": part,
        "tool": {"nose_radius": f"{nose!r} mm", "included": f"{included!r} deg", "clearance": "20 deg"},
        "machine": machine[dialect], "strategy": strategy, "program": {"plunge_feed": f"{plunge!r} mm/min"},
    }  # fmt: skip
    if stock and random.random() < 0.5:
        table["passes"] = [
            {"name": "rough", "allowance": f"{stock * 0.2!r} mm", "depth": f"{stock * 0.45!r} mm"},
            {"name": "finish"},
        ]
    return Case(table, height, radius, stock, blank, nose, math.radians(included / 2), plunge), dialect


# ---------------------------------------------------------------- a reader of programs
@dataclass
class Move:
    """One block: where it ends, how it moves, how long it takes (0 where that depends on F)."""

    kind: str  # rapid, feed, timed
    seconds: float
    feed: float
    end: dict
    rates: dict
    name: str


WORD = re.compile(r"([CXZF])(-?\d+\.?\d*)(?::(-?\d+\.\d+))?")


def moves(path, dialect):  # noqa: C901, PLR0912 - a reader is a list of cases
    """Yield the blocks of a program in the order in which the controller takes them."""
    kind, mode, seconds, feed, name = "feed", 94, 0.0, 0.0, ""
    for raw in path.read_text().splitlines():
        called = re.match(r"M98[(<] ?<?([^)>]+)[)>]", raw)
        if called:
            yield from moves(path.parent / called[1].strip(), dialect)
            continue
        marked = re.search(r"\( PASS: ([^)]*?)(?:, PART.*)? \)", raw)
        name = marked[1] if marked else name
        line = re.sub(r"\(.*?\)", "", raw).replace(";", "").strip()
        if dialect == "pmac":
            if line in ("LINEAR", "RAPID"):
                kind = "feed" if line == "LINEAR" else "rapid"
                continue
            if line.startswith("PVT"):
                kind, seconds = "timed", float(line[3:]) / 1e3
                continue
            if line.startswith(("DWELL", "ABS")):
                continue
        for code in re.findall(r"G(\d+)", line):
            if code in ("93", "94"):
                mode = int(code)
            elif code in ("0", "1"):
                kind = "rapid" if code == "0" else "feed"
        words = WORD.findall(re.sub(r"[GM]\d+(\.\d+)?", "", line))
        end = {letter: float(value) for letter, value, _ in words if letter != "F"}
        for letter, value, _ in words:
            if letter == "F" and mode == 93 and dialect != "pmac":
                seconds = 60 / float(value) if dialect == "generic" else float(value)
            elif letter == "F":
                feed = float(value) * (60 if dialect == "pmac" else 1)
        if end:
            timed = kind == "timed" or (mode == 93 and kind == "feed" and dialect != "pmac")
            rates = {letter: float(rate) for letter, _, rate in words if rate}
            yield Move("timed" if timed else kind, seconds if timed else 0.0, feed, end, rates, name)


@dataclass
class Figures:
    """What is found over all jobs."""

    jobs: int = 0
    refused: int = 0
    passes: int = 0
    plunges: int = 0
    beside: int = 0
    rest: int = 0
    rapid: int = 0
    least: float = np.inf  # gap of a move with C at rest or in rapid to the material [mm]
    fastest: float = 0.0  # plunge over the stated plunge feed
    block: float = 0.0  # plunge of a block against the contact heights of a dense maximum, over the feed
    gouge: float = 0.0  # below what the pass leaves, within the clear aperture [mm]
    unwound: float = 0.0  # longest rapid of C [turns]
    lateral: float = np.inf  # least height of lateral moves above the material [mm]


def left_by(case, cut, theta, rho):
    """Return the material along one azimuth after a pass: points C [rad], X, Z."""
    c, x, z = cut
    low = np.full(rho.size, np.inf)
    sense = 1.0 if c[-1] > c[0] else -1.0
    along = sense * c
    for half in (0.0, math.pi):
        first = math.ceil((along[0] - sense * (theta + half)) / TURN - 1e-9)
        last = math.floor((along[-1] - sense * (theta + half)) / TURN + 1e-9)
        at = sense * (theta + half) + TURN * np.arange(first, last + 1)
        xs, zs = np.interp(at, along, x), np.interp(at, along, z)
        side = rho if half == 0 else -rho
        for one, height in zip(xs, zs, strict=True):
            low = np.minimum(low, height + case.edge(side - one))
    return low


def look(case, place, theta, cut, margin=0.0):
    """Return the least distance along z from the edge at a place to the material at one azimuth."""
    reach = 2 * case.nose + case.radius
    rho = np.concatenate([place["X"] + np.linspace(-reach, reach, 801), place["X"] + np.linspace(-0.05, 0.05, 401)])
    if case.blank is not None:
        rho = np.append(rho, [case.blank, -case.blank])
    material = case.top(rho, theta)
    if cut is not None:
        material = np.minimum(material, left_by(case, cut, theta, rho))
    solid = np.isfinite(material)
    return float((place["Z"] + case.edge(rho - place["X"]) - material)[solid].min(initial=np.inf)) - margin


def judge(case, dialect, path, figures):  # noqa: C901, PLR0912 - a controller too
    """Follow one program."""
    place, rates, before, name = {}, {}, None, ""
    c, x, z, t = [], [], [], 0.0
    entry = []
    degrees = None
    for move in moves(path, dialect):
        end = {**place, **move.end}
        if "C" in move.end:
            angle = move.end["C"]
            if dialect == "nanotech" and degrees is not None:
                angle = degrees + (angle - degrees + 180) % 360 - 180
            end["C"], turned = angle, 0.0 if degrees is None else abs(angle - degrees) / 360
            if move.kind == "rapid":
                figures.unwound = max(figures.unwound, turned if degrees is not None else abs(angle) / 360)
            degrees = angle
        plain = move.name.removesuffix(", ENTRY")
        if plain != name:
            if name and c:
                before = tuple(np.array(one) for one in (c, x, z))
            name, c, x, z = plain, [], [], []
            figures.passes += 1
        if move.kind != "timed":
            entry = []
        if {"X", "Z"} <= place.keys() and {"C", "X", "Z"} <= end.keys():
            begin = {**end, **place}
            if move.kind == "timed" and move.name.endswith(", ENTRY"):
                entry.append((move, begin, end, rates))
                if len(entry) == 1:
                    figures.plunges += 1
            elif move.kind == "timed":
                if not c:
                    figures.beside += not entry
                    close(case, entry, figures, name)
                    c, x, z = [math.radians(begin["C"])], [begin["X"]], [begin["Z"]]
                c.append(math.radians(end["C"]))
                x.append(end["X"])
                z.append(end["Z"])
            else:
                standing(case, move, begin, end, c, x, z, before, figures, known="C" in place)
        place, rates = end, move.rates
        t += move.seconds


def standing(case, move, begin, end, c, x, z, before, figures, *, known):
    """Look at a move with C at rest or in rapid."""
    figures.rapid += move.kind == "rapid"
    figures.rest += move.kind != "rapid"
    cut = tuple(np.array(one) for one in (c, x, z)) if len(c) > 1 else before
    shares = np.linspace(0, 1, 9)
    for share in shares:
        here = {letter: begin[letter] + share * (end[letter] - begin[letter]) for letter in "CXZ"}
        azimuths = [math.radians(here["C"])] if known else np.linspace(0, TURN, 12, endpoint=False)
        for theta in azimuths:
            gap = look(case, here, theta, cut)
            retract = len(c) > 1
            if retract and share == 0:
                continue  # where the pass ends the edge touches what it has just cut
            figures.least = min(figures.least, gap)
            if begin["X"] != end["X"] or begin["C"] != end["C"]:
                figures.lateral = min(figures.lateral, gap)


def close(case, entry, figures, name):
    """Look at a plunge: its feed, from turn to turn at one azimuth, and whether it gouges what the pass leaves."""
    if not entry:
        return
    angle = np.array([math.radians(entry[0][1]["C"]), *(math.radians(end["C"]) for _, _, end, _ in entry)])
    height = np.array([entry[0][1]["Z"], *(end["Z"] for _, _, end, _ in entry)])
    clock = np.concatenate([[0.0], np.cumsum([move.seconds for move, *_ in entry])])
    assert len({end["X"] for _, _, end, _ in entry}) == 1  # at the radius where the pass begins
    steps = np.diff(angle)
    assert (steps > 0).all() or (steps < 0).all()  # C turns all the way
    along = np.abs(angle - angle[0])
    later = along + TURN
    inside = later <= along[-1] + 1e-9
    if inside.any():
        # Points of one turn may lie between those of another: on a curve through them, which passes through them all.
        fall = height[inside] - CubicSpline(along, height)(later[inside])
        span = CubicSpline(along, clock)(later[inside]) - clock[inside]
        assert (fall > -ROUNDING).all()
        figures.fastest = max(figures.fastest, float(((fall - ROUNDING) / span).max()) * 60 / case.plunge_feed)
    else:
        figures.fastest = max(figures.fastest, float((height[0] - height[-1]) / clock[-1]) * 60 / case.plunge_feed)
    allowance, x = case.allowances[name], entry[0][2]["X"]
    last = np.flatnonzero(np.abs(angle - angle[-1]) <= 1.2 * TURN)
    # Between its points the tool follows straight lines, in the plunge as in the pass: looked at are the points.
    for k in last:
        inside = case.contact(x, angle[k], case.radius) + allowance
        figures.gouge = max(figures.gouge, float(inside - height[k]))
    # Where the edge hangs over the rim, the part goes on there if it has one tangent, or ends: either is allowed.
    rims = (max(case.radius, abs(x)), max(case.radius, abs(x)) + case.nose)
    excess = []
    for rim in rims:
        surface = np.array([case.contact(x, one, rim) for one in angle[last]])
        fall = -np.diff(height[last]) + np.diff(surface) - ROUNDING
        excess.append(float((fall / np.diff(clock[last])).max()) * 60 / case.plunge_feed)
    figures.block = max(figures.block, min(excess))


def run(cases, seed, figures):
    """Write the programs of random jobs and follow each."""
    from turnwright.errors import TurnwrightError
    from turnwright.job import Job, Pipeline

    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "pmac.toml").write_text(
            'base = "nanoform"\nname = "with cubics"\ndialect = "pmac"\n[controller]\ninterpolation = "hermite"\n',
            encoding="utf-8",
        )
        while figures.jobs < cases:
            case, dialect = case_of(random, folder)
            try:
                job = Job.read(case.table)
                line = Pipeline(job, out=folder)
                deep = [one.sentence for one in line.depths if not one.ok]
                motions, allowances = {}, {}
                for cut in line.cuts() if not deep else ():
                    motions[cut.name], allowances[cut.name] = cut.motion, cut.allowance
                program = None if deep else line.write(motions)
                error = deep
            except TurnwrightError as refused:
                program, error = None, refused
            if program is None:
                figures.refused += 1
                if figures.refused > 20 * cases + 100:
                    raise AssertionError(f"nearly every job is refused: {error}")
                continue
            case.allowances = allowances
            judge(case, dialect, program.files[0], figures)
            for file in program.files:
                file.unlink()
            figures.jobs += 1


def failures(figures):
    """Name the figures that are not as they must be."""
    wanted = {
        "no move with C at rest or in rapid comes near material": figures.least >= 0.01 - ROUNDING,
        "none laterally either": figures.lateral >= 1.0,
        "no plunge above the stated feed": figures.fastest <= 1 + 1e-6,
        "no block of a plunge above it either": figures.block <= 1 + 1e-6,
        "no plunge below what its pass leaves": figures.gouge <= ROUNDING,
        "C turns less than once in rapid": figures.unwound <= 1.0,
        "jobs plunge, and jobs begin beside the blank": figures.plunges > 0 and figures.beside > 0,
    }
    return [name for name, kept in wanted.items() if not kept]


def main(cases=200, seed=1):
    """Print one table of figures; return the number of those that fail."""
    figures = Figures()
    run(cases, seed, figures)
    print(
        f"{figures.jobs} jobs ({figures.refused} refused), {figures.passes} passes: {figures.plunges} plunge, "
        f"{figures.beside} begin beside the blank\n"
        f"{figures.rest} moves with C at rest, {figures.rapid} rapid ones: least gap to material "
        f"{figures.least * 1e3:.4f} um, {figures.lateral:.3f} mm laterally\n"
        f"fastest plunge {figures.fastest:.6f} of the stated feed, {figures.block:.6f} in one block; deepest below "
        f"what the pass leaves {figures.gouge * 1e6:.3f} nm\nlongest rapid of C {figures.unwound:.3f} turns"
    )
    bad = failures(figures)
    for one in bad:
        print(f"FAILED: {one}")
    return len(bad)


if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:])))
