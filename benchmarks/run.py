"""Ratios, each against a yardstick measured in the same run, so that they mean the same on any machine.

    python benchmarks/run.py [--quick] [part ...]

Every measurement is warmed up, then taken in turns with its yardstick; the table states medians, the ratio being that
of the pairs, and the peak of the memory of the process while it was measured, or of the command that was run (Linux
only). Arrays that are timed are reused: fresh memory costs a page fault every 4 KiB on either side, as much as the
heights in it. The full run takes half an hour and writes RESULTS.md next to this file; ``--quick`` takes a fraction of
the sizes and writes nothing, nor does a run of some parts only.
"""

import argparse
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from statistics import median
from time import perf_counter
from unittest.mock import patch

import bench_cases
import bench_program
import bench_workbench
import numpy as np
import thesis_backplotter
from scipy import fft
from scipy.signal import lsim, lti

from turnwright.errors import InputError
from turnwright.generation import generate, generate_polar, require_device
from turnwright.heightmap import HeightMap
from turnwright.job import Job, diagnose
from turnwright.machine import Axis, Machine, SecondOrder
from turnwright.metrology import (
    area_psd,
    best_fit,
    filter_map,
    fit_zernike,
    interferogram,
    register,
    remove_form,
    remove_outliers,
    roughness,
)
from turnwright.motion import check_limits, drive
from turnwright.optics import wavefront
from turnwright.part import Part
from turnwright.path import Motion, Spiral
from turnwright.placing import place
from turnwright.post import read_nc, write_nc
from turnwright.progress import cores
from turnwright.strategy import AdaptiveToolServo, QuasiEllipticalToolServo, SlowToolServo
from turnwright.studies import generate_tiled, local
from turnwright.surface import Conic, LensArray, RadialPolynomial, SineGrid, Sphere, Toroid
from turnwright.tool import Tool
from turnwright.tracking import track

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"
TURN = 2 * np.pi

LENS = RadialPolynomial(
    radial=(-3.62e-3, 8.50e-8, -4.00e-12, 2.88e-16, -1.61e-18, 2.31e-20, -1.31e-22),
    slope=(-1.01e-3, 9.45e-8, -1.78e-11, 4.39e-15, -7.61e-18, 9.49e-20, -5.34e-22),
    tilt=0.0262,
)
"""The freeform infrared lens of Troutman 2016, appendix A.1."""


@dataclass(frozen=True, kw_only=True)
class Row:
    what: str
    ours: list[float]
    yardstick: str = ""
    theirs: list[float] | None = None  # taken in turns with ours, so that a busy moment slows both
    faster: bool = False  # whether the ratio says how many times faster, not how many times the yardstick
    limit: float | None = None
    peak_gb: float | None = None

    @property
    def value(self):
        if self.theirs is None:
            return median(self.ours)
        pairs = zip(self.ours, self.theirs, strict=True)
        return median(theirs / ours if self.faster else ours / theirs for ours, theirs in pairs)

    def cells(self):
        theirs = "" if self.theirs is None else seconds(median(self.theirs))
        ratio = "" if self.theirs is None else f"{self.value:.3g}" + (" times faster" if self.faster else "")
        limit = ""
        if self.limit is not None:
            met = self.value >= self.limit if self.faster else self.value <= self.limit
            limit = f"{'≥' if self.faster else '≤'} {self.limit:g}{' s' if self.theirs is None else ''}"
            limit += ": met" if met else ": **not met**"
        peak = self.peak_gb or getattr(self.ours, "peak_gb", None)
        memory = "" if peak is None else f"{peak:.2f} GB"
        return [self.what, seconds(median(self.ours)), self.yardstick, theirs, ratio, limit, memory]


@dataclass
class Table:
    rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, **row):
        self.rows.append(Row(**row))
        print("  ".join(cell for cell in self.rows[-1].cells() if cell), flush=True)

    def note(self, text):
        self.notes.append(text)
        print(f"  {text}", flush=True)

    def markdown(self):
        head = ["what", "time", "yardstick", "its time", "ratio", "target", "peak memory"]
        lines = [" | ".join(cells) for cells in (head, ["---"] * len(head), *(row.cells() for row in self.rows))]
        return (
            "\n".join(f"| {line} |" for line in lines) + "\n\n" + "\n".join(f"- {note}" for note in self.notes) + "\n"
        )


def seconds(value):
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value / 1e-9:.3g} ns"


class Times(list):
    """Seconds of a work, and the peak of the memory of this process meanwhile. [GB]."""

    peak_gb: float | None = None


def timed(*works: Callable[[], object], times=5):
    """Seconds of each work, several times in turns after one run of each to warm up."""
    taken = [Times() for _ in works]
    for turn in range(times + 1):
        for work, spent in zip(works, taken, strict=True):
            forget_peak()
            start = perf_counter()
            work()
            if turn:
                spent.append(perf_counter() - start)
                spent.peak_gb = peak_gb()
    return taken


def forget_peak():
    """Let the kernel of Linux begin a new peak of the memory of this process."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_gb():
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1e6
    return None


WATCH = """
import resource, subprocess, sys, time
start = time.perf_counter()
failed = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6)
sys.exit(failed)
"""
"""Prints the seconds of a command and the peak of its memory [GB]: a new process counts that of the one it is forked
from too, so a small one starts it."""


def commanded(*arguments, times=3, warm_up=1):
    """Seconds of a command, several times after some runs to warm up, with the peak of its memory."""
    taken = Times()
    command = [sys.executable, "-S", "-c", WATCH, str(Path(sys.executable).with_name("turnwright")), *arguments]
    for turn in range(warm_up + times):
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"turnwright {' '.join(arguments)} failed:\n{done.stderr}")
        spent, peak = (float(one) for one in done.stdout.split())
        if turn >= warm_up:
            taken.append(spent)
            taken.peak_gb = max(taken.peak_gb or 0.0, peak)
    return taken


@contextmanager
def processors(count):
    """Keep this process, and the threads it starts, on so many processors."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(allowed)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def core_counts():
    return [1, cores()] if cores() > 1 else [1]


def plural(count):
    return "1 core" if count == 1 else f"{count} cores"


def lathe(dialect="generic", letters="CXZ"):
    return Machine(
        name="lathe", axes={letter: Axis() for letter in letters}, spindle_rpm=1000, block_rate_hz=1000, dialect=dialect
    )


def spiral(points, points_per_rev, radius):
    """Turns of equal azimuths from ``radius`` to the axis."""
    angle = np.arange(points) * (TURN / points_per_rev)
    return Spiral(angle=angle, radius=radius * (1 - np.arange(points) / (points - 1)))


def cut(surface, tool, *, radius, feed, points_per_rev):
    servo = SlowToolServo(feed=feed, points_per_rev=points_per_rev, spindle_rpm=50)
    part = Part(surface=surface, radius=radius)
    return drive(place(servo.spiral(part, tool), part, tool), servo, lathe())


def square_roots(*shape):
    """Return work that takes the square root of as many numbers, into an existing array."""
    source, target = np.random.default_rng(1).random((2, *shape))
    return lambda: np.sqrt(source, out=target)


def bench_place(table, scale):
    points, points_per_rev = int(1e6 * scale), int(3600 * np.sqrt(scale))
    sphere = {sign: Sphere(radius=8.0 * sign) for sign in (-1, 1)}
    cases = {
        "the infrared lens": (LENS, Tool(nose_radius=1.5, included=np.deg2rad(120)), 7.25),
        "square array, convex lenses": (
            LensArray.square(pitch=1.0, rows=7, columns=7, lenslet=sphere[-1]),
            Tool(nose_radius=0.1, included=np.deg2rad(60)),
            2.5,
        ),
        "square array, concave lenses": (
            LensArray.square(pitch=1.0, rows=7, columns=7, lenslet=sphere[1]),
            Tool(nose_radius=0.1, included=np.deg2rad(60)),
            2.5,
        ),
        "hexagonal array, convex lenses": (
            LensArray.hexagonal(pitch=1.0, rings=3, lenslet=sphere[-1]),
            Tool(nose_radius=0.1, included=np.deg2rad(60)),
            2.5,
        ),
        "hexagonal array, aspheric lenses": (
            LensArray.hexagonal(pitch=1.0, rings=3, lenslet=Conic(radius=-8.0, conic=-0.5)),
            Tool(nose_radius=0.1, included=np.deg2rad(60)),
            2.5,
        ),
    }
    for name, (surface, tool, radius) in cases.items():
        plan, part = spiral(points, points_per_rev, radius), Part(surface=surface, radius=radius)
        path = place(plan, part, tool)
        x, y = path.contact_x, path.contact_y
        for count in core_counts():
            with processors(count):
                ours, sag, jet = timed(
                    lambda plan=plan, part=part, tool=tool: place(plan, part, tool),
                    lambda surface=surface, x=x, y=y: surface.sag(x, y),
                    lambda surface=surface, x=x, y=y: surface.evaluate(x, y, 2),
                )
            table.add(
                what=f"place {points:.0e} points on {name}, {plural(count)}",
                ours=ours, yardstick="`surface.sag` of the same points", theirs=sag,
                limit=(20 if surface is LENS else 15) if count == cores() else None,
            )  # fmt: skip
            if surface is LENS and count == 1:
                table.note(
                    "The floor of placing a smooth surface is two evaluations of height, slopes and curvatures, one "
                    f"to step and one to prove: on the lens {2 * median(jet) / median(sag):.2g} times one sag."
                )
    toric = Part(surface=Toroid(radius_x=40.0, radius_y=60.0).placed(rotation=0.3, tilt=(0.03, 0.0)), radius=5.0)
    plan, upright = spiral(points, points_per_rev, 5.0), Tool(nose_radius=0.5, included=np.deg2rad(120))
    raked = replace(upright, rake=np.deg2rad(-25))
    ours, plain = timed(lambda: place(plan, toric, raked), lambda: place(plan, toric, upright))
    table.add(
        what=f"place {points:.0e} points on a tilted torus, rake of -25 deg, {plural(cores())}",
        ours=ours, yardstick="the same without rake", theirs=plain, limit=2,
    )  # fmt: skip


def bench_polar(table, scale):
    radius, angle = np.linspace(0.0, 5.0, 10000), np.linspace(0, TURN, int(10000 * scale), endpoint=False)
    source, target, out = np.random.default_rng(1).random((3, angle.size, radius.size))
    feed = 0.005  # ten samples from pass to pass
    for nose, included in ((0.05, 60), (0.5, 60), (2.0, 120)):
        tool = Tool(nose_radius=nose, included=np.deg2rad(included))
        reach = 2 * nose * np.sin(np.deg2rad(included / 2)) / feed
        motion = cut(LENS, tool, radius=5.0, feed=feed, points_per_rev=720)
        for count in core_counts():
            with processors(count):
                ours, root = timed(
                    lambda motion=motion, tool=tool: generate_polar(motion, tool, radius=radius, angle=angle, out=out),
                    lambda: np.sqrt(source, out=target),
                    times=3,
                )
            table.add(
                what=f"generate_polar, {out.size:.0e} samples, {reach:.0f} passes in reach, {plural(count)}",
                ours=ours, yardstick="`np.sqrt` into an existing array", theirs=root,
                limit=3 if count == cores() else None,
            )  # fmt: skip
    fresh, root = timed(
        lambda: generate_polar(motion, tool, radius=radius, angle=angle),
        lambda: np.sqrt(source),
        times=3,
    )
    table.note("There are ten samples from pass to pass; the time grows with samples plus passes, not with the reach.")
    table.note(
        "`generate_polar` and `np.sqrt` both write into arrays that exist; into fresh memory the last case takes "
        f"{seconds(median(fresh))} on {plural(cores())} and `np.sqrt` {seconds(median(root))}."
    )


def bench_patch(table, scale):
    tool = Tool(nose_radius=1.5, included=np.deg2rad(120))
    motion = cut(LENS, tool, radius=5.0, feed=0.002, points_per_rev=720)
    pixels = 0.0005 * np.arange(int(2000 * np.sqrt(scale)))
    x, y = 3.0 + pixels, 0.1 + pixels
    ours, root = timed(lambda: generate(motion, tool, x=x, y=y), square_roots(y.size, x.size), times=3)
    table.add(
        what=f"generate, {x.size} x {y.size} pixels of 0.5 um, {2.6 / 0.002:.0f} passes in reach, {plural(cores())}",
        ours=ours, yardstick="`np.sqrt` into an existing array", theirs=root,
    )  # fmt: skip
    table.note(f"`generate` makes {x.size * y.size / median(ours):.2g} pixels a second.")


def bench_moving(table, scale):
    """Maps of lenses that a tool swinging along Y has cut."""
    lenses = LensArray.hexagonal(pitch=0.1, within=2.0, lenslet=Sphere(radius=-0.626))
    part = Part(surface=lenses, radius=1.5)
    servo = QuasiEllipticalToolServo(feed=0.01, points_per_rev=3600, spindle_rpm=15, short="skip", shortest=0.005)
    at = np.arange(int(500 * np.sqrt(scale)))
    for rake in (0.0, -0.2):
        tool = Tool(nose_radius=0.103, included=np.deg2rad(60), rake=rake)
        motion = drive(place(servo.spiral(part, tool), part, tool), servo, lathe(letters="CXYZ"))
        for pixel in (0.0005, 0.002, 0.004):
            x, y = 0.1 + pixel * at, pixel * (at - at.size / 2)
            ours, root = timed(
                lambda motion=motion, tool=tool, x=x, y=y: generate(motion, tool, x=x, y=y),
                square_roots(y.size, x.size),
                times=3,
            )
            what = f"generate, Y swinging, {'a raked' if rake else 'an upright'} tool, pixels of {pixel * 1e3:g} um"
            table.add(
                what=f"{what}, {plural(cores())}", ours=ours, yardstick="`np.sqrt` into an existing array", theirs=root
            )
            table.note(f"{what}: {median(ours) / at.size**2 * 1e6:.2g} us a point, asked for is 1 us.")


def bench_card(table, scale):
    """A map of 1e9 heights on a graphics card against its lower left ninth on processors, nine times."""
    try:
        require_device("cuda")
    except InputError as error:
        table.note(f"`generate` on a graphics card is not measured here: {error}.")
        return
    tool = Tool(nose_radius=1.5, included=np.deg2rad(120))
    motion = cut(LENS, tool, radius=5.0, feed=0.002, points_per_rev=720)
    x = np.linspace(-3.5, 3.5, int(31_623 * np.sqrt(scale)))
    part = x[: x.size // 3]
    card, processors = timed(
        lambda: generate(motion, tool, x=x, y=x, device="cuda"), lambda: generate(motion, tool, x=part, y=part), times=3
    )
    table.add(
        what=f"generate, {x.size} x {x.size} pixels on a graphics card, heights in memory", ours=card,
        yardstick=f"nine times a ninth on {plural(cores())}", theirs=[9 * time for time in processors], faster=True,
    )  # fmt: skip
    maps = [generate(motion, tool, x=part[:2000], y=part[:2000], device=device).z for device in ("cpu", "cuda")]
    table.note(f"Heights of the graphics card are within {abs(maps[0] - maps[1]).max():.1g} mm of those of processors.")


def bench_tiling(table, scale):
    """A map in tiles on disk against the same map in memory, at the pixel of 1e9 heights on this part."""
    job = Job.load(EXAMPLES / "li2018_sine_grid.toml")
    servo, part, tool = job.servo(job.passes[-1]), job.part.aimed, job.tool
    motion = drive(place(servo.spiral(part, tool), part, tool), servo, job.machine)
    pixel = 0.00028
    x = 0.7 + pixel * np.arange(int(5000 * np.sqrt(scale)))
    span = float(x[0]), float(x[-1]) + pixel / 2
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "map"

        def tiled():
            shutil.rmtree(store, ignore_errors=True)
            generate_tiled(motion, tool, pixel=pixel, store=store, x=span, y=span)

        ours, memory = timed(tiled, lambda: generate(motion, tool, x=x, y=x), times=3)
    table.add(
        what=f"generate_tiled, {x.size} x {x.size} pixels of 0.28 um, {plural(cores())}",
        ours=ours, yardstick="`generate` of the same, in memory", theirs=memory,
    )  # fmt: skip
    table.note(
        f"`generate_tiled` makes {x.size**2 / median(ours):.2g} heights a second, `generate` "
        f"{x.size**2 / median(memory):.2g}."
    )


def bench_program_files(table, scale):
    for dialect in bench_program.FORMATS:
        with tempfile.TemporaryDirectory() as folder:
            bench_dialect(table, dialect, int(1e6 * scale), Path(folder))


def bench_dialect(table, dialect, points, folder):
    machine = lathe(dialect)
    motion = bench_program.motion(points, machine)
    ours, plain = folder / "part.nc", folder / "plain.nc"
    words = bench_program.words(motion, dialect)
    line = bench_program.FORMATS[dialect]
    pairs = {
        "write_nc": (
            lambda: write_nc(motion, machine, ours),
            lambda: bench_program.python_write(plain, words, line),
            "`%` in a loop",
        ),
        "read_nc": (
            lambda: read_nc(ours, machine),
            lambda: bench_program.python_read(plain),
            "`float()` in a loop",
        ),
    }
    for what, (work, loop, name) in pairs.items():
        taken, theirs = timed(work, loop)
        table.add(
            what=f"{what}, {dialect}, {points:.0e} points",
            ours=taken, yardstick=name, theirs=theirs, faster=True, limit=10,
        )  # fmt: skip


def bench_planning(table, scale):
    """Whole plans, from the part to a motion within the limits of a machine."""
    part = Part(surface=SineGrid(amplitude=(0.005, 0.005), period=(0.2, 0.2)), radius=3.0 * np.sqrt(scale))
    tool = Tool(nose_radius=0.1)
    machine = Machine.load("nanoform")
    ways = {
        "slow tool servo, points by chord": SlowToolServo(feed=0.00446, chord=1e-5),
        "adaptive tool servo": AdaptiveToolServo(scallop=5e-5, chord=1e-5, interpolation="linear"),
    }
    for name, servo in ways.items():
        found = []

        def whole(servo=servo, found=found):
            path = place(servo.spiral(part, tool), part, tool)
            found[:] = [check_limits(drive(path, servo, machine), machine).points]

        whole()
        x, y = np.random.default_rng(1).uniform(-2, 2, (2, found[0]))
        ours, sag = timed(whole, lambda x=x, y=y: part.surface.sag(x, y), times=3)
        table.add(
            what=f"plan {found[0]:.2g} points by {name}, {plural(cores())}",
            ours=ours, yardstick="`surface.sag` of as many points", theirs=sag,
        )  # fmt: skip
        table.note(f"A million points take the {name} {median(ours) / found[0] * 1e6:.2g} s; published is 52 s.")


def bench_tracking(table, scale):
    """The closed form of a servo against SciPy's simulation of the same."""
    samples = int(1e6 * scale)
    servo = SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1.0)
    axes = {letter: Axis(response=servo if letter == "Z" else None) for letter in "CXZ"}
    machine = Machine(name="lathe", axes=axes, spindle_rpm=1000, block_rate_hz=1e9)
    time = np.arange(samples) * 1e-3
    z = 0.01 * np.sin(TURN * 3 * time)
    motion = Motion(time=time, axes={"C": TURN * time, "X": 10 - 1e-3 * time, "Z": z}, machine=machine)
    above, below = servo.polynomials
    system = lti(np.trim_zeros(above, "f"), below)
    ours, theirs = timed(lambda: track(motion, chord=1.0), lambda: lsim(system, z, time), times=3)
    table.add(
        what=f"track, {samples:.0e} points, one axis with a servo, 1 core",
        ours=ours, yardstick="`scipy.signal.lsim`", theirs=theirs, faster=True,
    )  # fmt: skip


def bench_metrology(table, scale):
    """Cleaning and filters of a measured map: noise, spikes, a round border, one point in a hundred missing."""
    n = int(2000 * np.sqrt(scale))
    rng = np.random.default_rng(1)
    x = 1e-3 * (np.arange(n) - n / 2)
    z = 1e-3 * np.cos(TURN * x / (n * 4e-4)) + rng.normal(0, 2e-5, (n, n))
    z[rng.random(z.shape) < 1e-3] += 1e-3
    z[(rng.random(z.shape) < 0.01) | (np.hypot(x, x[:, None]) > n * 4.9e-4)] = np.nan
    heights, cutoff = HeightMap(x=x, y=x, z=z), n * 4e-5
    whole = rng.normal(size=(n, n))
    works = {
        "remove_outliers": (lambda: remove_outliers(heights), None),
        "filter_map, Gaussian": (lambda: filter_map(heights, cutoff), 1.5),
        "filter_map, Gaussian, cutoff of ten times that": (lambda: filter_map(heights, 10 * cutoff), 1.5),
        "filter_map, robust": (lambda: filter_map(heights, cutoff, kind="robust"), 6.0),
    }
    for name, (work, limit) in works.items():
        ours, floor = timed(work, lambda: fft.irfft2(fft.rfft2(whole, workers=cores()), workers=cores()), times=3)
        table.add(
            what=f"{name}, {n} x {n} points, {plural(cores())}",
            ours=ours, yardstick="`scipy.fft.rfft2` there and back", theirs=floor,
        )  # fmt: skip
        if limit is not None and scale == 1:
            table.note(f"{name}: {seconds(median(ours))}, asked for is {limit:g} s.")


def bench_analysis(table, scale):
    """Form, Zernike terms, spectrum and texture of a round map with missing points."""
    n = int(2000 * np.sqrt(scale))
    rng = np.random.default_rng(1)
    x = np.linspace(-10, 10, n)
    z = 5e-3 * (x**2 + x[:, None] ** 2) + rng.normal(0, 5e-6, (n, n)) + 2e-5 * np.sin(TURN * x / 0.5)
    z[(rng.random(z.shape) < 1e-3) | (np.hypot(x, x[:, None]) > 9.9)] = np.nan
    part = HeightMap(x=x, y=x, z=z)
    error = best_fit(part, "sphere").residual
    works = {
        "remove_form, degree 10": lambda: remove_form(part, 10),
        "best_fit, sphere": lambda: best_fit(part, "sphere"),
        "interferogram": lambda: interferogram(part),
        "fit_zernike, 37 terms": lambda: fit_zernike(error, terms=37, indexing="fringe"),
        "area_psd": lambda: area_psd(error, missing="mask").radial(),
        "roughness": lambda: roughness(error, form=10),
    }
    whole = rng.normal(size=(n, n))
    for name, work in works.items():
        ours, floor = timed(work, lambda: fft.irfft2(fft.rfft2(whole, workers=cores()), workers=cores()), times=3)
        table.add(
            what=f"{name}, {n} x {n} points, {plural(cores())}",
            ours=ours, yardstick="`scipy.fft.rfft2` there and back", theirs=floor,
        )  # fmt: skip
        if name == "remove_form, degree 10" and scale == 1:
            table.note(f"{name}: {seconds(median(ours))}, asked for is 0.3 s.")


def bench_optics(table, scale):
    """Wavefront, MTF along two directions at 33 frequencies, point spread and Zernike terms of a whole part."""
    radius, angle = np.linspace(0, 7.25, 128), np.linspace(0, TURN, 128, endpoint=False)
    x, y = np.outer(np.cos(angle), radius), np.outer(np.sin(angle), radius)
    error = HeightMap(radius=radius, angle=angle, z=1e-7 * (x * x - y * y) + 1e-5 * np.sin(x))

    def work():
        light = wavefront(error, wavelength=10.6e-3, index=2.801)
        return light.strehl, light.mtf(), light.psf(), light.zernike()

    pupil = np.zeros((2048, 2048), dtype=complex)
    pupil[:512, :512] = 1.0
    spectrum = lambda: fft.ifft2(np.abs(fft.fft2(pupil, workers=cores())) ** 2, workers=cores())  # noqa: E731
    ours, floor = timed(work, spectrum, times=3 if scale == 1 else 1)
    table.add(
        what="optics of a whole part", ours=ours, yardstick="FFTs of a pupil of 512 x 512 pixels, for an MTF to 1e-3",
        theirs=floor,
    )  # fmt: skip
    table.note(f"optics of a whole part: {seconds(median(ours))}, asked for is 2 s.")


def bench_doors(table, scale):
    """Whole commands, as a user starts them."""
    table.add(what="turnwright --help", ours=commanded("--help", times=5), limit=0.4)
    commands = {
        "turnwright run, Li's sinusoidal grid, second run": ("run", "li2018_sine_grid", 3),
        "turnwright run, the infrared lens, 13.5 million points in all": ("run", "infrared_lens", 12),
        "turnwright compare, Li's sinusoidal grid, 5 strategies": ("compare", "li2018_sine_grid", None),
        "turnwright compare, a grid for a fast tool, 7 strategies, 13 million points": (
            "compare",
            "zhu2015_sine_grid",
            20,
        ),
        "turnwright compare, lenses on a torus, 7 strategies, 7 million points": ("compare", "kong2019_hybrid", None),
    }
    with tempfile.TemporaryDirectory() as folder:
        for what, (command, example, limit) in commands.items():
            if scale < 1 and example != "li2018_sine_grid":
                continue
            again = (command, str(EXAMPLES / f"{example}.toml"), "--force", "--out", str(Path(folder) / "out"))
            ours = commanded(*again, times=3 if example == "li2018_sine_grid" and scale == 1 else 1)
            table.add(what=what, ours=ours, limit=limit)
        job = str(EXAMPLES / "li2018_sine_grid.toml")
        with patch.dict(os.environ, NUMBA_CACHE_DIR=str(Path(folder) / "kernels")):
            first, second = commanded("run", job, "--force", "--out", str(Path(folder) / "out"), times=2, warm_up=0)
        table.add(
            what="turnwright run, Li's sinusoidal grid, the first on a machine beyond the second",
            ours=[first - second],
            limit=15,
        )


def points_evaluated(surface, work):
    """Count the points at which ``work`` evaluates a surface."""
    kind, sizes = type(surface), []
    plain = kind.evaluate

    def counting(self, x, y, order):
        sizes.append(x.size)
        return plain(self, x, y, order)

    kind.evaluate = counting
    try:
        work()
    finally:
        kind.evaluate = plain
    return sum(sizes)


def bench_measured(table, scale):
    """Registration of a map to a design, and the estimate of error sources."""
    n, rng = int(1129 * np.sqrt(scale)), np.random.default_rng(3)
    x = np.linspace(-5, 5, n)
    part = Part(surface=Conic(radius=80.0, conic=-0.8).placed(shift=(3.0, 1.0, 0.0)), radius=5.0)
    z = part.surface.placed(shift=(0.1, -0.05, 0.002), rotation=0.02).sag(x, x[:, None]) + rng.normal(0, 2e-6, (n, n))
    z[np.hypot(x, x[:, None]) > 4.9] = np.nan
    heights = HeightMap(x=x, y=x, z=z)
    at_x, at_y = heights.points()
    ours, slopes = timed(lambda: register(heights, part), lambda: part.surface.gradient(at_x, at_y), times=3)
    count = np.count_nonzero(np.isfinite(z))
    table.add(
        what=f"register {count:.2g} points", ours=ours,
        yardstick="heights and slopes of the same points", theirs=slopes,
    )  # fmt: skip
    times = points_evaluated(part.surface, lambda: register(heights, part)) / count
    table.note(
        f"Registration evaluates the surface {times:.2g} times at as many points; asked for is at most 10 times."
    )
    tool = Tool(nose_radius=0.5, included=2.0)
    made = cut(Sphere(radius=50.0), tool, radius=5.0, feed=0.005, points_per_rev=24)
    x = np.linspace(-4.96, 4.96, int(141 * np.sqrt(scale)))
    seen = generate(made, replace(tool, offset=(0.005, 0.0, 0.0)), x=x, y=x)
    z = np.where(np.hypot(x, x[:, None]) < 4.96, seen.z, np.nan) + rng.normal(0, 2e-5, seen.z.shape)
    sphere = Part(surface=Sphere(radius=50.0), radius=5.0)
    (ours,) = timed(lambda: diagnose(replace(seen, z=z), sphere, tool, lathe(), feed=0.005), times=3)
    table.add(what=f"diagnose a map of {x.size} x {x.size} points", ours=ours, limit=3)


def bench_execution(table, scale):
    cases = max(100, int(1000 * scale))
    ours, theirs = bench_cases.overhead(cases)
    table.add(what=f"{cases} empty cases, local pool of 2, store on: each", ours=ours, limit=0.02)
    table.add(what="the same", ours=ours, yardstick="the standard pool, no store", theirs=theirs)


def bench_workers(table, scale):
    """The error budget of the freeform infrared lens by two processes, against one."""
    tables = tomllib.loads((EXAMPLES / "infrared_lens.toml").read_text(encoding="utf-8"))
    job = Job.read(tables | {"tolerances": {"form_pv": "300 nm", "sq": "20 nm"}}, folder=EXAMPLES)
    cases = max(10, int(100 * scale))
    executors = [lambda: local(1), lambda: local(2), lambda: bench_cases.dask(2)]
    one, two, dask = bench_cases.lens_cases(job, executors, cases, rounds=2 if scale == 1 else 1)
    for what, ours, limit in (("two local processes", two, 1.8), ("a Dask cluster of two processes", dask, 1.7)):
        table.add(
            what=f"{cases} cases of the lens's error budget, {what}",
            ours=ours, yardstick="one local process", theirs=one, faster=True, limit=limit,
        )  # fmt: skip


def bench_page(table, scale):
    ready, page, surface, check = bench_workbench.start(times=3 if scale == 1 else 1)
    table.add(what="turnwright serve, until a browser may come", ours=ready)
    table.add(what="and until the page has all it needs", ours=page)
    table.add(
        what="and until the surface of the infrared lens is there, counted from there like the next", ours=surface
    )
    table.add(what="and until its first check is there", ours=check)
    small, large = (
        tomllib.loads((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8"))
        for name in ("li2018_sine_grid", "infrared_lens")
    )
    alone, beside, windows, maps, still = bench_workbench.under_load(small, large, asked=10 if scale == 1 else 3)
    table.add(what="check of the infrared lens, warm", ours=alone, limit=0.3)
    table.add(what="the same while two such lenses are run, 13.5 million points each", ours=beside, limit=0.3)
    table.add(what="a window of 200 x 200 pixels of 0.1 um, generated", ours=windows, limit=0.1)
    table.add(what=f"a map, {bench_workbench.CLIENTS} clients at once beside two runs", ours=maps, limit=0.2)
    table.note(
        f"Of {len(maps)} maps beside two runs, of which {still} still went on at the end, the slowest took "
        f"{max(maps):.2g} s."
    )


def exact_bowl(axes, tool, bowl, radius, angle):
    """Heights left on a concave sphere in closed form: the centre of the nose runs on a sphere less by its radius."""
    c, x = axes["C"], axes["X"]
    inner = bowl - tool.nose_radius
    heights = np.full((angle.size, radius.size), np.inf)
    for row, azimuth in zip(heights, angle, strict=True):
        turns = np.arange(np.ceil(c[0] / TURN), np.floor((c[-1] - azimuth) / TURN) + 1)
        tips = np.interp(azimuth + TURN * turns, c, x)[::-1]
        nearest = np.searchsorted(tips, radius * inner / bowl)
        for step in range(-4, 4):
            tip = tips[np.clip(nearest + step, 0, tips.size - 1)]
            u = radius - tip
            # bowl - sqrt(inner² - tip²) is the height of the centre, both without cancellation.
            centre = tool.nose_radius + tip**2 / (inner + np.sqrt(inner**2 - tip**2))
            np.minimum(row, centre - np.sqrt(tool.nose_radius**2 - u**2), out=row)
    return heights


def bench_thesis(table, scale):
    bowl, feed = 60.0, 0.010
    tool = Tool(nose_radius=1.5, included=np.deg2rad(120))
    motion = cut(Sphere(radius=bowl), tool, radius=5.0, feed=feed, points_per_rev=720)
    radius = np.linspace(1.5, 4.8, 6601)
    azimuths = np.arange(720) * (TURN / 720)
    ours_on, theirs_on = (azimuths, azimuths[:: 720 // 6]) if scale == 1 else (azimuths[::4], azimuths[:2])
    out = np.empty((ours_on.size, radius.size))
    whole = thesis_backplotter.tool_table(tool.nose_radius, np.deg2rad(60), 1e-3)
    # The least of the edge that does: to where it touches on this bowl, and two feeds more.
    least = radius[-1] / bowl * tool.nose_radius + 2 * feed
    part = thesis_backplotter.tool_table(tool.nose_radius, np.arcsin(least / tool.nose_radius), 1e-3)
    exact = exact_bowl(motion.axes, tool, bowl, radius, theirs_on)
    made = generate_polar(motion, tool, radius=radius, angle=theirs_on).z
    table.note(f"Off the closed form on a bowl of R {bowl:g} mm: Turnwright {np.abs(made - exact).max() * 1e6:.1g} nm.")
    for name, edge in (("whole edge", whole), ("only what touches", part)):
        peer = thesis_backplotter.backplot(motion.axes, edge, radius, theirs_on)
        table.note(f"The thesis's backplotter, {name}: {np.abs(peer - exact).max() * 1e6:.2g} nm (table every 1 um).")
        with processors(1):
            ours, theirs = timed(
                lambda: generate_polar(motion, tool, radius=radius, angle=ours_on, out=out),
                lambda edge=edge: thesis_backplotter.backplot(motion.axes, edge, radius, theirs_on),
                times=3,
            )
        table.add(
            what=f"generate_polar, an azimuth of {radius.size} samples, 1 core",
            ours=[time / ours_on.size for time in ours], yardstick=f"the thesis's backplotter, {name}",
            theirs=[time / theirs_on.size for time in theirs], faster=True, limit=50,
        )  # fmt: skip


BENCHES = {
    "place": bench_place,
    "polar": bench_polar,
    "patch": bench_patch,
    "moving": bench_moving,
    "card": bench_card,
    "tiling": bench_tiling,
    "files": bench_program_files,
    "planning": bench_planning,
    "tracking": bench_tracking,
    "metrology": bench_metrology,
    "optics": bench_optics,
    "analysis": bench_analysis,
    "measured": bench_measured,
    "overhead": bench_execution,
    "workers": bench_workers,
    "doors": bench_doors,
    "thesis": bench_thesis,
    "page": bench_page,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a fraction of the sizes; nothing is written")
    parser.add_argument("parts", nargs="*", metavar="part", help=f"of {', '.join(BENCHES)}")
    asked = parser.parse_args()
    for name in set(asked.parts) - set(BENCHES):
        parser.error(f"there is no part {name!r}")
    scale = 0.04 if asked.quick else 1
    table = Table()
    table.note(
        f"Measured on {plural(cores())} ({platform.machine()}), Python {platform.python_version()}, NumPy "
        f"{np.__version__}, numba {version('numba')}, Turnwright {version('turnwright')}; other work kept "
        f"{os.getloadavg()[0]:.1f} cores busy."
    )
    for name in asked.parts or BENCHES:
        BENCHES[name](table, scale)
    if scale == 1 and not asked.parts:
        (HERE / "RESULTS.md").write_text(table.markdown(), encoding="utf-8")


if __name__ == "__main__":
    main()
