"""Write and read a long program, against Python's own formatting and parsing in the same run.

    python benchmarks/bench_program.py [POINTS] [YARDSTICK_POINTS]

The yardsticks are plain loops, ``file.write(... % ...)`` over the points and ``float()`` over the words of every line,
with fewer points because they are slow; ratios are of the time per point. Ours also choose feeds, hash, check the hash,
split into files and make a `Motion`; "in memory" leaves the yardstick's file work out.
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


def timed(work):
    """Seconds, and what the work gave."""
    start = perf_counter()
    result = work()
    return perf_counter() - start, result


def columns(cut, points, dialect):
    """Plain lists of the words, in their order."""
    c = np.rad2deg(cut.axes["C"][:points])
    x, z = (cut.axes[letter][:points].tolist() for letter in "XZ")
    if dialect == "nanotech":
        return (c % 360).tolist(), x, z
    return x, z, c.tolist(), [60000.0] * points


def python_write(path, table, line):
    """A loop of ``%`` into a file."""
    with path.open("w") as file:
        for row in zip(*table, strict=True):
            file.write(line % row)


def python_read(path):
    """A loop of ``float()`` over a file, into one list per word."""
    rows = []
    with path.open() as file:
        for line in file:
            for word in line.split():
                if word != "G1":
                    rows.append(float(word[1:]))  # noqa: PERF401 - the plain loop is the yardstick
    return rows


def in_memory(table, line, lines):
    """Seconds of the same two loops without files, and without keeping what they make."""

    def write():
        for row in zip(*table, strict=True):
            line % row

    def read():
        for text in lines:
            for word in text.split():
                float(word[1:])

    return timed(write)[0], timed(read)[0]


def main():
    points = int(float(sys.argv[1])) if len(sys.argv) > 1 else 13_500_000
    yardstick = min(points, int(float(sys.argv[2])) if len(sys.argv) > 2 else 300_000)
    print("dialect   what        points       s  ns/point   Python loop  ratio   in memory  ratio")
    for dialect, line in FORMATS.items():
        axes = {letter: Axis() for letter in "CXZ"}
        machine = Machine(name="lathe", axes=axes, spindle_rpm=1000, block_rate_hz=1000, dialect=dialect)
        cut = motion(points, machine)
        table = columns(cut, yardstick, dialect)
        with tempfile.TemporaryDirectory() as folder:
            path, slow = Path(folder) / "part.nc", Path(folder) / "slow.nc"
            write_nc(motion(1000, machine), machine, path)  # compile
            read_nc(path, machine)
            python = [
                timed(lambda s=slow, t=table, f=line: python_write(s, t, f))[0],
                timed(lambda s=slow: python_read(s))[0],
            ]
            bare = in_memory(table, line, slow.read_text().splitlines())
            writes = [timed(lambda p=path, c=cut, m=machine: write_nc(c, m, p)) for _ in range(3)]
            reads = [timed(lambda p=path, m=machine: read_nc(p, m)) for _ in range(3)]
        for letter, values in cut.axes.items():
            assert np.abs(reads[0][1].axes[letter] - values).max() < 6e-7
        for k, (what, runs) in enumerate((("write", writes), ("read", reads))):
            best = min(seconds for seconds, _ in runs)
            each, loop, memory = best / points * 1e9, python[k] / yardstick * 1e9, bare[k] / yardstick * 1e9
            print(
                f"{dialect:10}{what:6}{points:12,}{best:8.2f}{each:10.0f}{loop:11.0f} ns{loop / each:7.1f}"
                f"{memory:9.0f} ns{memory / each:7.1f}"
            )
        done = writes[0][1]
        print(f"{'':10}{done.bytes / 1e6:.0f} MB in {len(done.files)} files")
    print(f"peak memory {getrusage(RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
