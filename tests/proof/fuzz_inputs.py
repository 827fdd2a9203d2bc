"""Inputs that a shop, a script or an attacker may hand over: good ones, and what becomes of them by mutation."""

# ruff: noqa: C901, PLR0911, E501 - a choice among many ways is what this is, and its tables are wide

from __future__ import annotations

import copy
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import tomli_w

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))
sys.path.insert(0, str(ROOT / "tests" / "cli"))

import measured_files as maps  # noqa: E402
from job_files import SMALL  # noqa: E402

LONGEST = 400_000
"""Letters of a mutated text: more is a test of the disk."""


@dataclass(frozen=True)
class Case:
    """One input: its files, and what is done with them."""

    door: str
    files: dict[str, bytes]
    options: dict[str, Any] = field(default_factory=dict)


# --- good jobs

SURFACES: list[Any] = [
    {"family": "plane", "slope": [0.01, 0.0]},
    {"family": "sphere", "radius": "50 mm"},
    {"family": "conic", "radius": "-40 mm", "conic": -1.2},
    {"family": "even asphere", "radius": "50 mm", "conic": 0.5, "units": "mm", "terms": {"4": 1e-6, "6": -2e-8}},
    {"family": "toroid", "radius_x": "500 mm", "radius_y": "250 mm"},
    {"family": "biconic", "radius_x": "50 mm", "radius_y": "70 mm", "conic_x": -1.0, "conic_y": 0.3},
    {"family": "xy polynomial", "units": "mm", "terms": {"2,0": 0.01, "0,2": 0.008, "3,1": 1e-4}},
    {"family": "xy polynomial", "terms": {"2,0": "0.01 1/mm", "1,1": "8e-3 1/mm"}},
    {"family": "radial polynomial", "units": "mm", "radial": [-0.01, 1e-4], "slope": [-0.001], "tilt": 0.01},
    {"family": "zernike", "indexing": "fringe", "radius": "1.3 mm", "units": "um", "terms": {"5": 2.0, "11": -0.8}},
    {"family": "forbes", "radius": "40 mm", "conic": -0.5, "norm_radius": "2 mm", "kind": "qbfs", "units": "um",
     "terms": {"0": 1.0, "2": -0.5}},
    {"family": "forbes", "radius": "40 mm", "conic": 0.0, "norm_radius": "2 mm", "kind": "q2d", "units": "um",
     "terms": {"0,2": 1.0, "1,-1": 0.3}},
    {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["0.5 mm", "0.5 mm"]},
    {"family": "lens array", "layout": "hexagonal", "pitch": "0.5 mm", "rings": 2,
     "lenslet": {"family": "sphere", "radius": "5 mm"}},
    {"family": "lens array", "layout": "square", "pitch": "0.4 mm", "rows": 3, "columns": 3, "aperture": "0.1 mm",
     "surround": "0 mm", "lenslet": {"family": "sphere", "radius": "5 mm"}},
    {"family": "expression", "units": "mm", "formula": "x**2/100 + 0.001*sin(3*phi)*rho**3", "constants": {"a": 2.0}},
    {"family": "expression", "units": "mm", "formula": "exp(-((x-a)**2+y**2)/4)/50", "constants": {"a": 0.2}},
    {"family": "gridded", "file": "sag.csv", "units": "mm", "sag_units": "um"},
    [{"family": "conic", "radius": "61.5 mm", "conic": -1.5},
     {"family": "zernike", "indexing": "noll", "radius": "1.5 mm", "units": "um", "terms": {"5": 2.0, "9": 0.3}}],
    {"family": "sphere", "radius": "30 mm", "placed": {"shift": ["5 mm", "0 mm", "0 mm"], "tilt": ["2 deg", "1 deg"],
                                                       "rotation": "30 deg"}},
]  # fmt: skip

STRATEGIES: list[tuple[dict[str, Any], str, dict[str, Any]]] = [
    ({"kind": "slow tool servo", "feed": "20 um/rev", "points_per_rev": 120}, "generic", {}),
    ({"kind": "slow tool servo", "feed": "20 um/rev", "chord": "20 nm", "max_step": "5 deg"}, "nanotech-350fg", {}),
    ({"kind": "slow tool servo", "feed": "20 um/rev", "arc_length": "50 um", "max_step": "9 deg", "overrun": "0.1 mm",
      "along": "normal", "spindle_speeds": [["0 mm", "100 rpm"], ["1 mm", "60 rpm"]]}, "generic", {}),
    ({"kind": "fast tool servo", "feed": "20 um/rev", "points_per_rev": 180, "spindle_speed": "60 rpm"},
     "nanoform-fts-70", {"fast_tool": "position"}),
    ({"kind": "hybrid tool servo", "feed": "20 um/rev", "points_per_rev": 180, "spindle_speed": "60 rpm"},
     "nanoform-fts-70", {"fast_tool": "time", "fast_tool_rate": "20 kHz"}),
    ({"kind": "adaptive tool servo", "scallop": "80 nm", "chord": "10 nm", "spindle_speed": "60 rpm"}, "generic", {}),
    ({"kind": "quasi-elliptical tool servo", "feed": "20 um/rev", "points_per_rev": 120, "short": "skip",
      "shortest": "20 um"}, "generic", {}),
]  # fmt: skip

EXTRAS: list[dict[str, Any]] = [
    {},
    {"part": {"stock": "20 um", "material": "IRG 26"},
     "passes": [{"name": "rough", "allowance": "5 um", "feed": "40 um/rev", "depth": "8 um"}, {"name": "finish"}]},
    {"part": {"material": "copper OFHC", "stock": "5 um"}, "tolerances": {"form_pv": "100 nm", "sq": "5 nm"}},
    {"actual": {"tool": {"radius_error": "1 um", "offset": ["1 um", "2 um", "0 um"], "waviness": ["1 nm/deg"]},
                "machine": {"squareness": "10 urad"}}},
    {"tool": {"waviness_file": "certificate.csv"}, "machine": {"straightness_file": "straightness.csv"}},
    {"part": {"correction": "correction.npz"}, "accept": ["clearance", "limits"]},
]  # fmt: skip


def sag_table() -> bytes:
    nodes = np.linspace(-1.6, 1.6, 9)
    rows = [["", *nodes], *([y, *(x * x + y * y for x in nodes)] for y in nodes)]
    return "\n".join(",".join(map(str, row)) for row in rows).encode()


def correction() -> bytes:
    nodes = np.linspace(-1.6, 1.6, 9)
    x, y = np.meshgrid(nodes, nodes)
    return maps.array_file(None, x=nodes, y=nodes, z=1e-6 * x * y)


TABLES: dict[str, bytes] = {
    "sag.csv": sag_table(),
    "certificate.csv": b"sweep [deg],deviation [nm]\n-50,1\n-20,2\n0,0\n20,3\n50,-1\n",
    "straightness.csv": b"x [mm],error [nm]\n-5,1\n0,0\n5,-3\n",
    "correction.npz": correction(),
    "pmac.toml": b'name = "pmac"\nbase = "generic"\ndialect = "pmac"\n[controller]\ninterpolation = "hermite"\n',
}
"""What jobs name."""


def merged(table: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    for key, value in other.items():
        table[key] = merged(table[key], value) if isinstance(value, dict) and key in table else copy.deepcopy(value)
    return table


def with_surface(surface: Any) -> dict[str, Any]:
    job = copy.deepcopy(SMALL)
    job["part"]["surface"] = copy.deepcopy(surface)
    return job


def good_job(random: Random) -> dict[str, Any]:
    job = with_surface(random.choice(SURFACES))
    strategy, machine, program = random.choice(STRATEGIES) if random.random() < 0.4 else STRATEGIES[0]
    job["strategy"] = copy.deepcopy(strategy)
    job["machine"] = {"name": machine}
    if program:
        job["program"] = dict(program)
    return merged(job, random.choice(EXTRAS) if not program and random.random() < 0.4 else {})


EXAMPLES = [file.read_text(encoding="utf-8") for file in sorted((ROOT / "examples").glob("*.toml"))]

# --- values and texts

UNITS = ("m", "cm", "mm", "um", "nm", "in", "rad", "deg", "turn", "s", "h", "rev", "rpm", "Hz", "kHz", "um/rev",
         "mm/rev", "nm/deg", "1/mm", "mm/s^2", "mm^99", "1/nm^3", "1", "", "furlong", "mm*mm", "rad^-99")  # fmt: skip
NUMBERS: tuple[float, ...] = (
    0, -0.0, 1, -1, 2, 3, 7, 10, 90, 1e3, 1e6, 1e9, 10**18, 10**30, -(10**12), 1e-3, 1e-6, 1e-9, 1e-12, 1e-30, 1e-100,
    1e-300, 5e-324, 1e30, 1e31, 1e100, 1e101, 1e300, 1.7e308, -1e300, float("inf"), float("-inf"), float("nan"), 0.1,
    1.5, -2.5, 1e15, 2**31, 2**63, 2**64,
)  # fmt: skip
DIGITS = ("9" * 400, "1" * 4301, "1" * 5000, "0." + "3" * 5000, "1e" + "9" * 30, "1e-" + "9" * 400, "0x" + "f" * 4400)
WORDS = ("", " ", "x", "\0", "nan", "inf", "../../x", "part", "sphere", "'" * 9, '"""', "µm", "\u202e", "\U0001f600",
         "a" * 5000, "ab " * 20000, "\n" * 300, "__import__('os')", "{}", "%s%n", "=1+1", "(" * 300)  # fmt: skip


def number(random: Random) -> float:
    return random.choice(NUMBERS) if random.random() < 0.6 else random.uniform(-1, 1) * 10 ** random.uniform(-12, 12)


def scaled(value: float, random: Random) -> float:
    try:
        return value * 10 ** random.choice((-9, -6, -3, -2, -1, 1, 2, 3, 6, 9)) * random.choice((1, 1, 1, -1))
    except OverflowError:
        return value


def value(old: object, random: Random) -> Any:
    """Return another value for an old one: near it, of its kind, or anything."""
    kind = random.random()
    quantity = re.fullmatch(r"\s*([-+0-9.eE]+)\s*(.*)", old) if isinstance(old, str) else None
    if kind < 0.45:
        if quantity:
            try:
                near = scaled(float(quantity[1]), random)
            except ValueError:
                near = number(random)
            return f"{near:.12g} {quantity[2]}"
        if isinstance(old, bool):
            return not old
        if isinstance(old, int | float):
            near = scaled(old, random)
            return round(near) if isinstance(old, int) and abs(near) < 1e15 else near
    if kind < 0.7:
        if quantity:
            how = random.random()
            unit = quantity[2] if how < 0.6 else random.choice(UNITS)
            return f"{random.choice(DIGITS) if how < 0.1 else format(number(random), 'g')} {unit}"
        if isinstance(old, str):
            return text(old, random)[:LONGEST]
        if isinstance(old, int | float):
            return number(random)
    if kind < 0.8:
        return number(random)
    if kind < 0.9:
        return random.choice(WORDS)
    return random.choice(([], {}, [1, 2], ["1 mm"] * random.choice((1, 3, 2000)), {"a": 1}, True, [[]], "flat", "1 mm",
                          copy.deepcopy(random.choice(SURFACES))))  # fmt: skip


def in_kind(old: object, random: Random) -> Any:
    """Return a value that the schema lets pass: of the same kind and unit, from near to absurd; None where there is none."""
    quantity = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(\D.*)", old) if isinstance(old, str) else None
    factor = 10 ** random.choice((random.uniform(-1, 1), random.uniform(-3, 3), random.uniform(-12, 12)))
    sign = random.choice((1, 1, 1, 1, -1))
    if quantity:
        return f"{float(quantity[1]) * factor * sign:.9g} {quantity[2]}"
    if isinstance(old, bool):
        return not old
    if isinstance(old, int):
        return round(min(abs(old) * factor, 1e15)) * sign
    if isinstance(old, float):
        return old * factor * sign if random.random() < 0.9 else number(random)
    return None


def mutate_values(job: Any, random: Random) -> Any:
    """Change some numbers of a job within its schema."""
    for _ in range(random.choice((1, 1, 2, 3, 5))):
        *above, last = random.choice(list(leaves(job)))
        table = job
        for key in above:
            table = table[key]
        new = in_kind(table[last], random)
        if new is not None:
            table[last] = new
    return job


def leaves(tree: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, one in pairs:
        yield (*place, key)
        yield from leaves(one, (*place, key))


def mutate_tree(job: Any, random: Random) -> Any:
    """Change some places of a job: its values, its keys, its shape."""
    for _ in range(random.choice((1, 1, 1, 2, 2, 3, 5))):
        places = list(leaves(job))
        if not places:
            return job
        place = random.choice(places)
        table = job
        for key in place[:-1]:
            table = table[key]
        last, how = place[-1], random.random()
        if how < 0.72:
            table[last] = value(table[last], random)
        elif how < 0.80:
            del table[last]
        elif how < 0.86 and isinstance(table, dict):
            table[random.choice((str(last) + "s", str(last)[::-1], random.choice(WORDS), str(last) * 400))] = table.pop(
                last
            )
        elif how < 0.92 and isinstance(table, list):
            table *= random.choice((2, 20, 500))
        elif how < 0.96:
            table[last] = [copy.deepcopy(table[last])] * random.choice((1, 2, 40))
        else:
            nested = copy.deepcopy(table[last])
            for _ in range(random.choice((1, 3, 40))):
                nested = {"family": "sum", "terms": [nested]} if random.random() < 0.5 else {"a": nested}
            table[last] = nested
    return job


TOKENS = (b"nan", b"inf", b"-", b"0", b"9" * 30, b"9" * 4400, b"1e999", b"1e-999", b" ", b" " * 3000, b"\n", b"\r\n", b"\0",
          b"\xff", b"\xef\xbb\xbf", b"(", b")", b"[", b"]", b"[[", b"{", b"}", b'"', b"'", b"=", b",", b";", b"#", b"%", b"/", b"\\",
          b"(" * 2000, b"[" * 2000, b".", b"e", b"E+", b"M98", b"G", b"N", b"P", b"M30", b"G1", b"X1e9", b"C720", b"\xc2\xb5m")  # fmt: skip


def mutate_bytes(data: bytes, random: Random, others: tuple[bytes, ...] = ()) -> bytes:
    """Flip, insert, take out, repeat and splice bytes."""
    for _ in range(random.choice((1, 1, 2, 3, 6, 12))):
        if len(data) > LONGEST:
            return data[:LONGEST]
        start = random.randrange(len(data) + 1)
        stop = min(len(data), start + random.choice((0, 1, 2, 4, 8, 30, 200, 5000)))
        how = random.randrange(9)
        if how == 0 and data:
            at = min(start, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ (1 << random.randrange(8))]) + data[at + 1 :]
        elif how == 1:
            data = data[:start] + random.choice(TOKENS) + data[start:]
        elif how == 2:
            data = data[:start] + random.choice(TOKENS) + data[stop:]
        elif how == 3:
            data = data[:start] + data[stop:]
        elif how == 4:
            data = data[:start] + data[start:stop] * random.choice((2, 3, 50)) + data[stop:]
        elif how == 5:
            data = data[:start] + random.randbytes(stop - start) + data[stop:]
        elif how == 6 and others:
            other = random.choice(others)
            at = random.randrange(len(other) + 1)
            data = data[:start] + other[at : at + 300] + data[start:]
        elif how == 7:
            numbers = list(re.finditer(rb"[0-9][0-9.]*", data[:20000]))
            if numbers:
                found = random.choice(numbers)
                new = random.choice((format(number(random), "g").encode(), random.choice(DIGITS).encode(), b"0", b"-1"))
                data = data[: found.start()] + new + data[found.end() :]
        elif how == 8:
            data = data[:start] if random.random() < 0.5 else data[start:]
    return data[:LONGEST]


def text(old: str, random: Random) -> str:
    return mutate_bytes(old.encode(), random).decode("utf-8", "ignore")


# --- formulas

CALLS = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt")


def formula(random: Random, depth: int = 4) -> str:
    how = random.random()
    if depth == 0 or how < 0.2:
        return random.choice(("x", "y", "rho", "phi", "pi", "a", f"{number(random):g}", "0.1", "3", "1e-3", "2.5"))
    if how < 0.6:
        sign = random.choice(("+", "-", "*", "*", "/", "**"))
        return f"({formula(random, depth - 1)}{sign}{formula(random, depth - 1)})"
    if how < 0.9:
        return f"{random.choice(CALLS)}({formula(random, depth - 1)})"
    return f"{random.choice(('hypot', 'atan2'))}({formula(random, depth - 1)},{formula(random, depth - 1)})"


def wild_formula(random: Random) -> str:
    how = random.randrange(8)
    depth = random.choice((1, 2, 3, 4, 6, 9))
    if how == 0:
        return random.choice("+-*/").join(
            [formula(random, random.choice((0, 1, 2)))] * random.choice((10, 100, 999, 3000))
        )
    if how == 1:
        term = random.choice(
            ("exp(x)", "hypot(x,1)", "atan2(x,2)", "exp(sin(x*y))", "x**y", "1/x", "sin(phi)", "exp(-x**2)", "tan(x)")
        )
        return random.choice("+-*").join([term] * random.choice((30, 300, 1400, 2500)))
    if how == 2:
        name = random.choice((*CALLS, "-", "+"))
        levels = random.choice((5, 40, 60, 500, 5000))
        return f"{name}(" * levels + "x" + ")" * levels
    if how == 3:
        name = random.choice(("hypot", "atan2"))
        levels = random.choice((5, 40, 60, 400))
        return f"{name}(x," * levels + "y" + ")" * levels
    if how == 4:
        return text(formula(random, depth), random)
    if how == 5:
        return f"{formula(random, 2)}+{random.choice(DIGITS)}*x"
    if how == 6:
        return f"{number(random):g}*{formula(random, depth)}"
    return f"0.01*{random.choice(('sin', 'cos', 'tanh', 'atan'))}({formula(random, depth)})"


# --- the doors


def job_case(random: Random) -> Case:
    how = random.random()
    if how < 0.45:
        data = tomli_w.dumps(mutate_values(good_job(random), random)).encode()
    elif how < 0.75:
        data = tomli_w.dumps(_writable(mutate_tree(good_job(random), random))).encode("utf-8", "replace")
    elif how < 0.85:
        data = mutate_bytes(tomli_w.dumps(good_job(random)).encode(), random)
    else:
        data = tomli_w.dumps(_writable(mutate_tree(tomllib.loads(random.choice(EXAMPLES)), random))).encode(
            "utf-8", "replace"
        )
    if random.random() < 0.1:
        data = mutate_bytes(data, random)
    if random.random() < 0.02:
        data += random.choice((b"\n[a" + b".a" * 5000 + b"]\n", b"\nb = [" + b"1," * 100000 + b"]\n",
                               b"\n" + b"".join(b"k%d = 1\n" % i for i in range(20000)), b"\nx = '''" + b"y" * 300000 + b"'''\n",
                               b"\n" * 2_000_000, b"\nx = [0x" + b"f" * 4400 + b"]\n",
                               b"\n" + b"[[q]]\n" * 20000))  # fmt: skip
    tables = dict(TABLES)
    if random.random() < 0.15:
        name = random.choice(list(tables))
        tables[name] = mutate_bytes(tables[name], random, tuple(TABLES.values()))
    return Case(random.choice(("check", "check", "check", "run")), {"job.toml": data, **tables})


def _writable(tree: Any) -> Any:
    """Return a tree without what TOML cannot write."""
    if isinstance(tree, dict):
        return {str(key).replace("\0", "0"): _writable(one) for key, one in tree.items()}
    if isinstance(tree, list):
        return [_writable(one) for one in tree]
    return tree.replace("\0", " ") if isinstance(tree, str) else tree


def formula_case(random: Random) -> Case:
    job = copy.deepcopy(SMALL)
    one: dict[str, Any] = {
        "family": "expression",
        "units": "mm",
        "formula": wild_formula(random),
        "constants": {"a": 0.7},
    }
    if random.random() < 0.3:
        one["feature_size"] = f"{10 ** random.uniform(-6, 3):.3g} mm"
    job["part"]["surface"] = [{"family": "sphere", "radius": "50 mm"}, one] if random.random() < 0.3 else one
    return Case(
        random.choice(("check", "check", "run")), {"job.toml": tomli_w.dumps(_writable(job)).encode("utf-8", "replace")}
    )


MACHINES: dict[str, dict[str, str]] = {
    "generic": {"name": "generic"}, "nanotech": {"name": "nanotech-350fg"}, "pmac": {"file": "pmac.toml"},
}  # fmt: skip
"""A machine for each dialect."""


def program_case(programs: dict[str, dict[str, bytes]]) -> Callable[[Random], Case]:
    """Return what makes cases of programs written beforehand."""

    def make(random: Random) -> Case:
        name = random.choice(list(programs))
        files = dict(programs[name])
        chosen = random.choice([one for one in files if one != "job.toml"])
        files[chosen] = mutate_bytes(files[chosen], random, tuple(files.values()))
        main = "part.nc" if "part.nc" in files else "part.csv"
        if random.random() < 0.05:
            long = random.choice((b"(PASS:" + b" " * 60000, b"M98(" + b" " * 60000, b"N" * 70000, b"G1 " * 30000,
                                  b"(" + b"a" * 60000 + b")", b"X" + b"9" * 5000, b"#1=" + b"[" * 5000))  # fmt: skip
            lines = files[main].split(b"\n")
            lines.insert(random.randrange(len(lines)), long)
            files[main] = b"\n".join(lines)
        return Case("backplot", files, {"program": main})

    return make


def good_maps() -> dict[str, bytes]:
    """Return a map file of each format."""
    x, y = np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 5))
    z = x * x + y * y
    rows = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    lines = "\n".join(" ".join(f"{one:.6g}" for one in row) for row in rows)
    return {
        "a.dat": maps.metropro(), "b.asc": maps.zygo_ascii(), "c.xyz": maps.zygo_xyz(), "d.sur": maps.digital_surf(),
        "e.sur": maps.digital_surf(packed=True), "f.sdf": maps.sdf(), "g.sdf": maps.sdf_text(), "h.x3p": maps.x3p(),
        "i.dat": maps.grid_sag(), "j.npy": maps.array_file(z), "k.npz": correction(), "l.al3d": maps.al3d(),
        "m.xyz": lines.encode(), "n.csv": lines.replace(" ", ",").encode(), "o.txt": lines.encode(),
        "p.csv": sag_table(), "q.datx": maps.datx(),
    }  # fmt: skip


def experiment() -> dict[str, bytes]:
    from test_material_commands import EXPERIMENT, averages, forces

    time, force = forces()
    table = np.column_stack((time, force * 1e3))[::5]
    record = "time [s];Fx [mN];Fy [mN];Fz [mN]\n" + "\n".join(";".join(f"{one:.6f}" for one in row) for row in table)
    return {
        "forces.csv": record.encode(),
        "experiment.toml": EXPERIMENT.format(file="forces.csv").encode(),
        "averages.csv": averages().encode(),
    }


def file_case(good: dict[str, bytes], fitted: dict[str, bytes]) -> Callable[[Random], Case]:
    """Return what makes cases of maps, machines, materials, experiments and tables."""
    machines = {file.name: file.read_bytes() for file in sorted((ROOT / "src/turnwright/machines").glob("*.toml"))}
    materials = {file.name: file.read_bytes() for file in sorted((ROOT / "src/turnwright/materials").glob("*.toml"))}
    plain = [name for name in good if not name.endswith(".datx")]

    def changed_toml(data: bytes, random: Random) -> bytes:
        if random.random() < 0.5:
            return mutate_bytes(data, random)
        return tomli_w.dumps(_writable(mutate_tree(tomllib.loads(data.decode()), random))).encode("utf-8", "replace")

    def make(random: Random) -> Case:
        how = random.random()
        if how < 0.55:
            # HDF5 is read in a process of its own, which takes a second.
            name = random.choice(plain) if random.random() < 0.99 else "q.datx"
            return Case("map", {name: mutate_bytes(good[name], random, tuple(good.values()))}, {"map": name})
        if how < 0.7:
            name = random.choice(list(machines))
            job = with_surface(random.choice(SURFACES))
            job["machine"] = {"file": "machine.toml"}
            return Case(
                "check",
                {
                    "machine.toml": changed_toml(machines[name], random),
                    "job.toml": tomli_w.dumps(job).encode(),
                    **TABLES,
                },
            )
        if how < 0.8:
            name = random.choice(list(materials))
            return Case("material", {"material.toml": changed_toml(materials[name], random)})
        if how < 0.9:
            files = dict(fitted)
            name = random.choice(list(files))
            files[name] = (
                changed_toml(files[name], random) if name.endswith("toml") else mutate_bytes(files[name], random)
            )
            return Case("fit", files, {"data": "averages.csv" if name == "averages.csv" else "experiment.toml"})
        tables = dict(TABLES)
        name = random.choice(list(tables))
        tables[name] = mutate_bytes(tables[name], random, tuple(TABLES.values()))
        job = with_surface(random.choice(SURFACES))
        if name == "sag.csv":
            job["part"]["surface"] = {"family": "gridded", "file": "sag.csv", "units": "mm", "sag_units": "um"}
        elif name == "pmac.toml":
            job["machine"] = {"file": name}
        else:
            job = merged(job, next(one for one in EXTRAS if name in json.dumps(one)))
        return Case("check", {"job.toml": tomli_w.dumps(job).encode(), **tables})

    return make


KINDS_OF_FILE = ("heights", "waviness", "straightness", "correction", "machine", "material", "nonsense")
PATHS = ("/api/about", "/api/schema", "/api/examples", "/api/examples/x", "/api/runs", "/api/runs/0123456789abcdef",
         "/api/measurements/0123456789abcdef", "/", "/index.html", "/api/files", "/api/openapi.json")  # fmt: skip


def upload_case(good: dict[str, bytes]) -> Callable[[Random], Case]:
    """Return what makes requests to the workbench."""

    def make(random: Random) -> Case:
        how = random.random()
        if how < 0.3:
            kind = random.choice(KINDS_OF_FILE)
            pool = {**TABLES, **good} if random.random() < 0.3 else TABLES
            name = random.choice([one for one in pool if not one.endswith(".datx")])
            body = mutate_bytes(pool[name], random, tuple(TABLES.values()))
            return request("POST", "/api/files", body, {"kind": kind, "name": name})
        if how < 0.4:
            job = tomli_w.dumps(good_job(random)).encode()
            packed = maps.archive({"job.toml": mutate_bytes(job, random) if random.random() < 0.5 else job, **TABLES})
            return request(
                "POST", "/api/files/archive", mutate_bytes(packed, random) if random.random() < 0.6 else packed
            )
        if how < 0.55:
            source = tomli_w.dumps(good_job(random)) if random.random() < 0.7 else random.choice(EXAMPLES)
            return request("POST", "/api/job/parse", _json({"toml": text(source, random)}))
        if how < 0.8:
            mutate = mutate_values if random.random() < 0.4 else mutate_tree
            data = mutate(good_job(random), random)
            door = random.choice(("check", "check", "write", "bundle"))
            body = _json(
                {"data": data, **({"toml": text(tomli_w.dumps(good_job(random)), random)} if door != "check" else {})}
            )
            return request("POST", f"/api/job/{door}", mutate_bytes(body, random) if random.random() < 0.1 else body)
        if how < 0.9:
            body = _json(
                {"data": mutate_tree(good_job(random), random), "kind": random.choice(("run", "compare", "x"))}
            )
            return request("POST", "/api/runs", mutate_bytes(body, random))
        path = text(random.choice(PATHS), random) if random.random() < 0.8 else random.choice(PATHS)
        return request(
            random.choice(("GET", "HEAD", "DELETE", "PUT", "POST")), "/" + path.lstrip("/"), random.randbytes(20)
        )

    return make


def request(method: str, path: str, body: bytes, query: dict[str, str] | None = None) -> Case:
    return Case("request", {"body": body}, {"method": method, "path": path, "query": query or {}})


def _json(data: Any) -> bytes:
    return json.dumps(data).encode()
