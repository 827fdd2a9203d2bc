"""Time and memory of each stage against its size, over four decades: a log-log picture with the slopes.

    python benchmarks/scaling.py [--quick]

Each size runs in a process of its own. Its memory is the largest resident size of the process during the measured call,
less that before it (Linux). The full run takes ten minutes and writes ``docs/images/scaling.svg`` and
``SCALING.md`` beside this file; ``--quick`` leaves out the largest size and writes nothing.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
from matplotlib.figure import Figure
from run import LENS, TURN, cut, lathe, seconds, spiral

from turnwright.generation import generate, generate_polar
from turnwright.motion import drive
from turnwright.part import Part
from turnwright.placing import place
from turnwright.post import read_nc, write_nc
from turnwright.strategy import SlowToolServo
from turnwright.tool import Tool

HERE = Path(__file__).parent
PICTURE = HERE.parent / "docs/images/scaling.svg"
TOOL = Tool(nose_radius=1.5, included=np.deg2rad(120))
PART = Part(surface=LENS, radius=7.25)


def placing(points):
    plan = spiral(points, max(points // 500, 8), 7.25)
    return lambda: place(plan, PART, TOOL)


def driving(points):
    per_rev = max(points // 500, 8)
    servo = SlowToolServo(feed=7.25 / 500, points_per_rev=per_rev, spindle_rpm=0.1)
    path = place(spiral(points, per_rev, 7.25), PART, TOOL)
    return lambda: drive(path, servo, lathe())


def motion_of(points):
    return driving(points)()


def writing(points):
    motion = motion_of(points)
    return lambda: write_nc(motion, motion.machine, Path(tempfile.mkdtemp()) / "a.nc")


def reading(points):
    motion, folder = motion_of(points), Path(tempfile.mkdtemp())
    write_nc(motion, motion.machine, folder / "a.nc")
    return lambda: read_nc(folder / "a.nc", motion.machine)


def pixels(count):
    motion = cut(LENS, TOOL, radius=5.0, feed=0.005, points_per_rev=720)
    side = 0.0005 * np.arange(round(count**0.5))
    return lambda: generate(motion, TOOL, x=-1.0 + side, y=-1.5 + side)


def samples(count):
    motion = cut(LENS, TOOL, radius=5.0, feed=0.005, points_per_rev=720)
    rows = round(count**0.5)
    radius, angle = np.linspace(0.0, 5.0, rows), np.linspace(0.0, TURN, rows, endpoint=False)
    return lambda: generate_polar(motion, TOOL, radius=radius, angle=angle)


def passes(count):
    motion = cut(LENS, TOOL, radius=5.0, feed=5.0 / count, points_per_rev=60)
    side = 0.0005 * np.arange(500)
    return lambda: generate(motion, TOOL, x=1.0 + side, y=0.5 + side)


CASES = {
    "place, points": (placing, 3),
    "drive, points": (driving, 3),
    "write_nc, points": (writing, 3),
    "read_nc, points": (reading, 3),
    "generate, pixels": (pixels, 4),
    "generate_polar, samples": (samples, 4),
    "generate 250,000 pixels, passes": (passes, 1),
}
"""Case, and the power of ten of its least size."""

DECADES = 4


def memory_mb(key):
    """Return the resident memory of this process, or its peak since it was reset, from Linux."""
    text = Path("/proc/self/status").read_text(encoding="ascii")
    return float(re.search(rf"{key}:\s+(\d+) kB", text)[1]) / 1e3


def measure(name, size):
    """Run one case at one size, once to load its kernels at the least size and twice at its own."""
    prepare, least = CASES[name]
    prepare(10**least)()
    work, taken = prepare(size), []
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins anew
    before = memory_mb("VmRSS")
    for _ in range(2):
        start = perf_counter()
        work()
        taken.append(perf_counter() - start)
    print(json.dumps([min(taken), memory_mb("VmHWM") - before]))


def slope_of(sizes, values):
    """Return the exponent of the larger half of the sizes, where what is constant no longer counts."""
    half = len(sizes) // 2
    return float(np.polyfit(np.log(sizes[half:]), np.log(np.maximum(values[half:], 1e-12)), 1)[0])


def main(quick):
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    time, memory = figure.subplots(1, 2)
    rows = []
    for name, (_, least) in CASES.items():
        sizes = np.array([10 ** (least + k) for k in range(DECADES + (0 if quick else 1))])
        found = []
        for size in sizes.tolist():
            command = [sys.executable, __file__, "--case", name, str(size)]
            found.append(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
            print(f"{name} {size:.0e}: {seconds(found[-1][0])}, {found[-1][1]:.0f} MB", flush=True)
        spent, taken = np.array(found).T
        rows.append([name, f"{sizes[-1]:.0e}", seconds(spent[-1]), f"{slope_of(sizes, spent):.2f}", f"{taken[-1]:.0f}"])
        time.loglog(sizes, spent, "o-", label=name, markersize=3)
        memory.loglog(sizes, np.maximum(taken, 0.1), "o-", markersize=3)
    time.set(xlabel="size", ylabel="time [s]")
    memory.set(xlabel="size", ylabel="memory beyond the input [MB]")
    for axes in (time, memory):
        axes.grid(alpha=0.4)
    figure.legend(*time.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    head = ["stage, size", "largest", "time", "slope of time", "memory beyond the input [MB]"]
    table = "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)) + "\n"
    print(table)
    if not quick:
        figure.savefig(PICTURE, metadata={"Date": None})
        (HERE / "SCALING.md").write_text(table, encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--case"]:
        measure(sys.argv[2], int(sys.argv[3]))
    else:
        main("--quick" in sys.argv[1:])
