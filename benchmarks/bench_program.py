"""Write and read programs, against Python's own formatting and parsing in the same run.

    python benchmarks/bench_program.py [POINTS] [LONG]

Ratios are of the wall time for the same POINTS, file to file, the best of several of each, because short runs
find quiet moments on a busy machine. The yardsticks are plain
loops, ``file.write(... % ...)`` over the points and ``float()`` over the words of every line. Ours also choose feeds,
hash, check the hash and make a `Motion`. LONG is the number of points of a program that only ours writes and reads.
"""

import sys
import tempfile
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from time import perf_counter

import numpy as np

from turnwright.machine import Axis, Machine
from turnwright.path import Motion
from turnwright.post import read_nc, write_nc

FORMATS = {"nanotech": "C%.5f X%.6f Z%.6f\n", "generic": "G1 X%.6f Z%.6f C%.6f F%.0f\n"}


def motion(points, machine):
    """A spiral over a freeform, at 0.1 deg and 1000 blocks a second."""
    angle = np.arange(points) * np.deg2rad(0.1)
    radius = 7.5 * (1 - np.arange(points) / points)
    z = 0.01 * radius**2 + 0.002 * radius * np.cos(angle)
    return Motion(time=np.arange(points) * 0.001, axes={"C": angle, "X": radius, "Z": z}, machine=machine)


def best(work, times):
    """Least seconds of a few runs, and what the last one gave."""
    taken = []
    for _ in range(times):
        result = None  # what an earlier run gave is free before the next one starts
        start = perf_counter()
        result = work()
        taken.append(perf_counter() - start)
    return min(taken), result


def words(cut, dialect):
    """Plain lists of the numbers, in their order."""
    c = np.rad2deg(cut.axes["C"])
    x, z = (cut.axes[letter].tolist() for letter in "XZ")
    return ((c % 360).tolist(), x, z) if dialect == "nanotech" else (x, z, c.tolist(), [60000.0] * len(x))


def python_write(path, table, line):
    """A loop of ``%`` into a file."""
    with path.open("w") as file:
        for row in zip(*table, strict=True):
            file.write(line % row)


def python_read(path):
    """A loop of ``float()`` over a file."""
    numbers = []
    with path.open() as file:
        for line in file:
            for word in line.split():
                if word != "G1":
                    numbers.append(float(word[1:]))  # noqa: PERF401 - the plain loop is the yardstick
    return numbers


def ours(cut, machine, path):
    """Best seconds of writing and of reading, the summary, and the motion read."""
    times = 9 if cut.time.size <= 1_000_000 else 3
    wrote, done = best(lambda: write_nc(cut, machine, path), times)
    took, again = best(lambda: read_nc(path, machine), times)
    for letter, values in cut.axes.items():
        assert np.abs(again.axes[letter] - values).max() < 6e-7
    return (wrote, took), done


def main():
    points = int(float(sys.argv[1])) if len(sys.argv) > 1 else 1_000_000
    long = int(float(sys.argv[2])) if len(sys.argv) > 2 else 13_500_000
    print(f"{'':17}{'points':>12}{'ours s':>9}{'ns/point':>10}{'Python s':>10}{'ratio':>7}")
    for dialect, line in FORMATS.items():
        axes = {letter: Axis() for letter in "CXZ"}
        machine = Machine(name="lathe", axes=axes, spindle_rpm=1000, block_rate_hz=1000, dialect=dialect)
        with tempfile.TemporaryDirectory() as folder:
            path, slow = Path(folder) / "part.nc", Path(folder) / "slow.nc"
            ours(motion(1000, machine), machine, path)  # compile
            cut = motion(points, machine)
            table = words(cut, dialect)
            fast, _ = ours(cut, machine, path)
            python = (
                best(lambda p=slow, t=table, f=line: python_write(p, t, f), 3)[0],
                best(lambda p=slow: python_read(p), 3)[0],
            )
            for k, what in enumerate(("write", "read")):
                print(
                    f"{dialect:10}{what:7}{points:12,}{fast[k]:9.3f}{fast[k] / points * 1e9:10.0f}{python[k]:10.3f}"
                    f"{python[k] / fast[k]:7.1f}"
                )
            del table
            whole, done = ours(motion(long, machine), machine, path)
            for k, what in enumerate(("write", "read")):
                print(f"{dialect:10}{what:7}{long:12,}{whole[k]:9.3f}{whole[k] / long * 1e9:10.0f}")
            print(f"{'':10}{done.bytes / 1e6:.0f} MB in {len(done.files)} files")
    print(f"peak memory {getrusage(RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
