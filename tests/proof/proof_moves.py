"""Programs of random jobs in spindle mode, on outlines and on chucks, against an envelope of their own.

``python -m tests.proof.proof_moves [CASES] [SEED]`` prints one table of figures and fails if one of them does. A third
of the jobs turns discs in spindle mode, a third cuts one outline, a third a chuck; most tools have a shank, some a
holder.
The oracle shares no code with ours: closed forms of surfaces, outlines and tool, a reader of its own, and at each place
of a part, on its border and in its corners the lowest edge of all blocks that pass over it.
"""

import math
import sys
import tempfile
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from proof_approach import moves
from turnwright.access import check_bodies
from turnwright.errors import TurnwrightError
from turnwright.job import Job, Pipeline, find_wrong_move

TURN = 2 * math.pi
ROUNDING = 3e-6
"""Three times the last decimal of a program. [mm]"""
CHORD = 1e-5
"""Chord of the jobs in spindle mode. [mm]"""
PLACES, BORDER = 900, 240
"""Places on a part and along its border."""


# ------------------------------------------------------- parts and tools, in closed forms of their own
def lengths(*values):
    return [f"{float(one)!r} mm" for one in values]


def surface_of(random, width):
    """Draw a table of a job, and its height as a function of x and y."""
    kind = random.choice(["plane", "sphere", "saddle"])
    if kind == "plane":
        a, b = (float(one) for one in random.uniform(-0.04, 0.04, 2))
        return {"family": "plane", "slope": [a, b]}, lambda x, y: a * x + b * y
    if kind == "sphere":
        bend = float(random.choice([-1, 1]) * random.uniform(8, 40) * width)
        return {"family": "sphere", "radius": f"{bend!r} mm"}, lambda x, y: sag(bend, x * x + y * y)
    a, b = (float(f"{one:.9f}") for one in random.uniform(-0.02, 0.02, 2) / width)
    table = {"family": "expression", "formula": f"{a:.9f}*x**2 + {b:.9f}*y**2", "units": "mm"}
    return table, lambda x, y: a * x * x + b * y * y


def sag(bend, square):
    return square / (bend * (1 + np.sqrt(np.maximum(1 - square / bend**2, 0.0))))


def shifted(height, x, y, a, b):
    return height(x + a, y + b)


def outline_of(random, width):
    """Draw a table of an outline, its mask as a function of x and y, and points along its border with all corners."""
    if random.random() < 0.3:
        angle = np.linspace(0, TURN, BORDER, endpoint=False)
        border = width / 2 * np.stack((np.cos(angle), np.sin(angle)))
        return {"disc": f"{width / 2!r} mm"}, lambda x, y: np.hypot(x, y) <= width / 2, border
    if random.random() < 0.5:
        a, b = width / 2, width / 2 * float(random.uniform(0.2, 0.9))
        corners, table = np.array([(a, b), (-a, b), (-a, -b), (a, -b)]), {"rectangle": lengths(2 * a, 2 * b)}
    else:
        way = np.sort(random.uniform(0, TURN, int(random.integers(3, 6))))
        while np.diff(way, append=way[0] + TURN).max() > 3.0 or np.diff(way).min() < 0.3:
            way = np.sort(random.uniform(0, TURN, way.size))
        corners = np.round(width / 2 * np.stack((np.cos(way), np.sin(way)), axis=1), 4)
        table = {"polygon": [lengths(*one) for one in corners]}
    after = np.roll(corners, -1, axis=0)

    def covers(x, y):
        sides = [(x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) for (x0, y0), (x1, y1) in zip(corners, after, strict=True)]
        return np.minimum.reduce(sides) >= 0

    share = np.arange(BORDER // len(corners)) / (BORDER // len(corners))
    border = corners[:, :, None] + (after - corners)[:, :, None] * share
    return table, covers, border.transpose(1, 0, 2).reshape(2, -1)


@dataclass
class Piece:
    """A part at its place: its height and mask in its own frame, and points of it."""

    height: object
    covers: object
    x: float
    y: float
    turned: float
    z: float
    points: np.ndarray = field(default_factory=lambda: np.empty((3, 0)))

    def at(self, x, y):
        """Height at places of the chuck, -inf off the part."""
        c, s = math.cos(self.turned), math.sin(self.turned)
        a, b = c * (x - self.x) + s * (y - self.y), c * (y - self.y) - s * (x - self.x)
        return np.where(self.covers(a, b), self.height(a, b) + self.z, -np.inf)

    def fill(self, random, width, border):
        """Take places on the part, those of the border first."""
        a, b = random.uniform(-width / 2, width / 2, (2, 4 * PLACES))
        on = self.covers(a, b)
        a, b = np.append(border[0], a[on][:PLACES]), np.append(border[1], b[on][:PLACES])
        c, s = math.cos(self.turned), math.sin(self.turned)
        self.points = np.stack((self.x + c * a - s * b, self.y + s * a + c * b, self.height(a, b) + self.z))

    def bend(self, reach):
        """Largest second derivative around the axis of its height, by differences. [mm/rad²]."""
        x, y, z = self.points
        step = 1e-3
        c, s = math.cos(step), math.sin(step)
        sides = [self.at(c * x - way * s * y, c * y + way * s * x) for way in (-1, 1)]
        with np.errstate(invalid="ignore"):
            second = np.abs(sides[0] + sides[1] - 2 * z) / step**2
        return float(second[np.isfinite(second)].max(initial=0.0)) + 0.02 * reach


@dataclass
class Case:
    """A job, and what the oracle needs of it."""

    kind: str
    table: dict
    pieces: list
    nose: float
    half: float
    bodies: list
    stock: float
    chord: float = CHORD

    def edge(self, u):
        """Height of a round nose with straight flanks."""
        far = self.nose * math.sin(self.half)
        inside = np.clip(u, -far, far)
        return self.nose - np.sqrt(self.nose**2 - inside**2) + (np.abs(u) - np.abs(inside)) * math.tan(self.half)


def tool_of(random):
    nose, included = float(random.uniform(0.3, 1.0)), float(random.uniform(90, 140))
    table = {"nose_radius": f"{nose!r} mm", "included": f"{included!r} deg", "clearance": "25 deg"}
    bodies = []
    for name, chance, radii, heights in (("shank", 0.7, (1.5, 3), (2, 5)), ("holder", 0.4, (4, 8), (8, 15))):
        if random.random() < chance and (name == "shank" or bodies):
            bodies.append((float(random.uniform(*radii)), float(random.uniform(*heights))))
            table[name] = dict(zip(("radius", "height"), lengths(*bodies[-1]), strict=True))
    return table, nose, math.radians(included / 2), bodies


def case_of(random, kind):
    """Draw one job."""
    tool, nose, half, bodies = tool_of(random)
    stock = float(random.choice([0.0, random.uniform(0.005, 0.03), random.uniform(0.05, 0.2)]))
    part = {"stock": f"{stock!r} mm", "air_clearance": str(random.choice(["100 um", "20 um", "5 um"]))}
    strategy = {"sense": int(random.choice([-1, 1])), "inside_out": bool(random.random() < 0.3)}
    if kind == "spindle":
        radius = float(random.uniform(2, 8))
        bend = float(random.choice([-1, 1]) * random.uniform(1.5, 10) * radius)
        piece = Piece(lambda x, y: sag(bend, x * x + y * y), lambda x, y: np.hypot(x, y) <= radius, 0.0, 0.0, 0.0, 0.0)
        part |= {"surface": {"family": "sphere", "radius": f"{bend!r} mm"}, "radius": f"{radius!r} mm"}
        if random.random() < 0.5:
            part["blank"] = {"radius": f"{radius * 1.05!r} mm"}
            strategy["lead_in"] = f"{float(random.uniform(0.1, 1.0)) + radius * 0.05!r} mm"
        strategy |= {"kind": "turning", "feed": f"{float(random.uniform(0.01, 0.03))!r} mm/rev",
                     "spindle_speed": "1500 rpm", "chord": f"{CHORD!r} mm"}  # fmt: skip
        angle = np.linspace(0, TURN, BORDER, endpoint=False)
        piece.fill(random, 2 * radius, radius * (1 - 1e-12) * np.stack((np.cos(angle), np.sin(angle))))
        pieces, chord = [piece], CHORD
    else:
        pieces, mounted = [], []
        count = 1 if kind == "outline" else int(random.integers(2, 4))
        begin = float(random.uniform(0, TURN))
        for number in range(count):
            width, away, way = random.uniform(1.5, 4), random.uniform(3, 5), begin + TURN * number / max(count, 2)
            if kind == "outline" and random.random() < 0.4:  # with the axis on it, so that it plunges from there
                away = float(random.uniform(0, 0.15))
            x, y, z, turned = away * math.cos(way), away * math.sin(way), 0.0, 0.0
            outline, covers, border = outline_of(random, float(width))
            surface, height = surface_of(random, float(width) if kind == "chuck" else 20.0)
            if kind == "chuck":
                z, turned = float(random.choice([0, 0.05, 0.5])), float(random.uniform(-3, 3))
                mounted.append({"name": f"P{number}", "surface": surface, "outline": outline, "height": f"{z!r} mm",
                                "position": lengths(x, y), "clocking": f"{turned!r} rad"})  # fmt: skip
            else:
                part |= {"surface": surface, "outline": {**outline, "centre": lengths(x, y)}}
                height = partial(shifted, height, x, y)
            pieces.append(Piece(height, covers, x, y, turned, z))
            pieces[-1].fill(random, width, border)
        if kind == "chuck":
            part["surface"] = {"family": "chuck", "parts": mounted}
        per_rev = int(random.integers(72, 180))
        strategy |= {"kind": "slow tool servo", "feed": f"{float(random.uniform(0.1, 0.18))!r} mm/rev",
                     "points_per_rev": per_rev, "spindle_speed": f"{float(random.uniform(8, 40))!r} rpm"}  # fmt: skip
        chord = 1.5 * max(one.bend(9.0) for one in pieces) * (TURN / per_rev) ** 2 / 8
    table = {"part": part, "tool": tool, "machine": {"name": str(random.choice(["nanoform", "generic"]))},
             "strategy": strategy}  # fmt: skip
    if stock > 0.01 and random.random() < 0.5:
        table["passes"] = [{"name": "rough", "allowance": f"{stock * 0.3!r} mm"}, {"name": "finish"}]
    return Case(kind, table, pieces, nose, half, bodies, stock, chord)


# --------------------------------------------------------------------- what a program does
@dataclass
class Figures:
    """What is found over all jobs."""

    jobs: int = 0
    refused: int = 0
    blocks: int = 0
    plunges: int = 0
    depth: float = -np.inf  # of the edge below a part, less the chord [mm]
    resting: float = -np.inf  # of the edge below the part in a move with C at rest or unknown [mm]
    stock: float = -np.inf  # below the stock before the first cut, at rest [mm]
    body: float = -np.inf  # of shank and holder below a part [mm]
    wrong: list = field(default_factory=list)  # of our own check


def path_of(file):
    """X, Z [mm], C [rad, nan in spindle mode] after each block, and whether C or the spindle turns in it."""
    place, rows, turning = {"C": math.nan}, [], False
    text = file.read_text()
    spindle = "G97" in text or "G96" in text
    plunges = 0
    for move in moves(file, "generic"):
        known = "C" in place and not math.isnan(place["C"])
        turns = "C" in move.end and known and move.end["C"] != place["C"] and move.kind != "rapid"
        place = {**place, **move.end}
        turning = spindle and move.kind != "rapid"
        if {"X", "Z"} <= place.keys():
            rows.append((place["X"], place["Z"], math.radians(place["C"]), turns or turning))
        plunges += move.name.endswith(", ENTRY") and move.kind == "timed"
    return np.array(rows), plunges


def envelope(case, run, x, y):
    """Lowest height of the edge over points, of consecutive blocks that turn C: X, Z and C of their ends."""
    tip_x, tip_z, c = run
    sense = 1.0 if c[-1] > c[0] else -1.0
    along, low = sense * c, np.full(x.size, np.inf)
    radius, azimuth = np.hypot(x, y), sense * np.arctan2(y, x)
    for side, half in ((1.0, 0.0), (-1.0, math.pi)):
        first = np.ceil((along[0] - azimuth - half) / TURN)
        for turn in range(int((along[-1] - along[0]) / TURN) + 2):
            at = azimuth + half + TURN * (first + turn)
            passed = (at >= along[0]) & (at <= along[-1])
            z = np.interp(at, along, tip_z) + case.edge(side * radius - np.interp(at, along, tip_x))
            low = np.where(passed, np.minimum(low, z), low)
    return low


def judge(case, file, figures):
    """Follow one program."""
    rows, plunges = path_of(file)
    figures.plunges += plunges > 0
    figures.blocks += len(rows)
    x, y, z = np.concatenate([one.points for one in case.pieces], axis=1)
    if case.kind == "spindle":
        profile(case, rows, np.hypot(x, y), z, figures)
    else:
        turns = rows[:, 3] > 0
        runs = np.split(np.arange(len(rows)), np.flatnonzero(np.diff(turns)) + 1)
        for blocks in runs:
            if turns[blocks[0]]:
                below = z - envelope(case, rows[blocks[0] - 1 : blocks[-1] + 1, :3].T, x, y)
                figures.depth = max(figures.depth, float(below.max()) - case.chord)
        standing(case, rows, turns, figures)
    sink(case, rows, (x, y, z), figures)


def profile(case, rows, radius, z, figures):
    """Compare all moves in spindle mode with the profile, whose every point is on both sides of the axis."""
    share = np.linspace(0, 1, 9)[1:, None]
    tip_x, tip_z = ((rows[:-1, k] + share * np.diff(rows[:, k])).ravel() for k in (0, 1))
    height = {float(r): float(one) for r, one in zip(np.round(radius, 9), z, strict=True)}
    r, z = np.array(sorted(height.items())).T[:, :: max(len(height) // 400, 1)]
    for side in (-1.0, 1.0):
        for some in np.array_split(np.arange(tip_x.size), tip_x.size // 2000 + 1):
            low = (tip_z[some, None] + case.edge(side * r - tip_x[some, None])).min(axis=0)
            figures.depth = max(figures.depth, float((z - low).max()) - case.chord)


def standing(case, rows, turns, figures):
    """Compare moves with C at rest, or in rapid, with the parts and, before the first cut, with their stock."""
    reach = case.nose + 3
    u = np.concatenate((np.linspace(-reach, reach, 601), np.linspace(-0.3, 0.3, 401)))
    is_cut = False
    for k in range(1, len(rows)):
        is_cut = is_cut or turns[k]
        if turns[k] or np.isnan(rows[k - 1 : k + 1]).any():
            continue
        for share in np.linspace(0, 1, 9)[1:]:
            tip_x, tip_z, c, _ = rows[k - 1] + share * (rows[k] - rows[k - 1])
            across, up = (tip_x + u) * math.cos(c), (tip_x + u) * math.sin(c)
            top = np.maximum.reduce([one.at(across, up) for one in case.pieces])
            below = float((top - case.edge(u)).max()) - tip_z
            figures.resting = max(figures.resting, below)
            if not is_cut:
                figures.stock = max(figures.stock, below + case.stock)


def sink(case, rows, points, figures):
    """Compare shank and holder with the points of the parts."""
    x, y, z = points
    few = np.unique(np.append(np.arange(0, len(rows), max(len(rows) // 1500, 1)), [1, 2, 3, len(rows) - 1]))
    for radius, height in case.bodies:
        for tip_x, tip_z, c, _ in rows[few[few < len(rows)]]:
            if case.kind == "spindle":
                under = np.abs(np.hypot(x, y) - abs(tip_x)) <= radius
            elif math.isnan(c):
                continue
            else:
                under = np.hypot(x - tip_x * math.cos(c), y - tip_x * math.sin(c)) <= radius
            figures.body = max(figures.body, float((z - tip_z - height).max(where=under, initial=-np.inf)))


def program_of(job, folder):
    """Write the program of a job whose shank and holder are clear of the part, or say why it is refused."""
    line = Pipeline(job, out=folder)
    try:
        # Access to gentle surfaces next to each other takes longer than all else, and matters for the bodies only.
        reasons = [] if job.part.leaves_air else [one.sentence for one in line.findings if not one.ok]
        motions = {cut.name: cut.motion for cut in line.cuts()} if not reasons else {}
        if job.part.leaves_air and job.tool.bodies:
            reasons += [text for one in motions.values() for _, text in check_bodies(job.part.aimed, job.tool, one)]
        return (None, reasons[0]) if reasons else (line.write(motions).files[0], "")
    except TurnwrightError as error:
        return None, str(error)


def run(cases, seed, figures):
    """Write the programs of random jobs and follow each."""
    random = np.random.default_rng(seed)
    while figures.jobs < cases:
        case = case_of(random, ("spindle", "outline", "chuck")[figures.jobs % 3])
        with tempfile.TemporaryDirectory() as place:
            job = Job.read(case.table)
            file, why = program_of(job, Path(place))
            if file is None:
                figures.refused += 1
                if figures.refused > 20 * cases + 100:
                    raise AssertionError(f"nearly every job is refused: {why}")
                continue
            judge(case, file, figures)
            figures.wrong += filter(None, [find_wrong_move(job, file)])
        figures.jobs += 1


def failures(figures):
    """Name the figures that are not as they must be."""
    wanted = {
        "no edge below a part": figures.depth <= ROUNDING,
        "none at rest either": figures.resting <= ROUNDING,
        "none at rest in the stock": figures.stock <= -0.01 + ROUNDING,
        "no shank or holder below a part": figures.body <= ROUNDING,
        "nothing wrong by our own check": not figures.wrong,
    }
    return [name for name, kept in wanted.items() if not kept]


def main(cases=200, seed=1):
    """Print one table of figures; return the number of those that fail."""
    figures = Figures()
    run(cases, seed, figures)
    print(
        f"{figures.jobs} jobs ({figures.refused} refused), {figures.blocks} blocks, {figures.plunges} jobs plunge\n"
        f"deepest below a part {figures.depth * 1e6:.3f} nm beyond the chord, at rest {figures.resting * 1e3:.2f} um; "
        f"in stock at rest {figures.stock * 1e3:.2f} um; shank and holder {figures.body * 1e3:.2f} um"
    )
    bad = [*failures(figures), *figures.wrong]
    for one in bad:
        print(f"FAILED: {one}")
    return len(bad)


if __name__ == "__main__":
    sys.exit(main(*(int(one) for one in sys.argv[1:])))
