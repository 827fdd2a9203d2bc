"""Motions with a moving Y, and their tools: whatever a slow slide, a fast one or a foreign program may do."""

from dataclasses import replace

import numpy as np

import turnwright as tw

DEG = np.pi / 180
TURN = 2 * np.pi
MACHINE = tw.Machine(
    name="test", axes={letter: tw.Axis() for letter in "CXYZ"}, spindle_rpm=3000.0, block_rate_hz=1000.0
)
RIPPLE = np.linspace(-0.9, 0.9, 181)
TABLE = tw.WavinessTable(sweep=RIPPLE, deviation=1e-4 * np.sin(40 * RIPPLE))
ROUND = tw.Tool(nose_radius=0.3, included=100 * DEG)


def bowl(x, y):
    return 0.03 * (x**2 + y**2) + 0.004 * np.sin(3 * x) * np.cos(2 * y) + 0.02 * x


def flat(x, _y):
    return np.zeros_like(x)


def moving(swing, *, radius=1.0, feed=0.03, points=120, height=bowl, sense=1, first=0.0, beyond=0.0, inside_out=False):
    """A spiral whose Y is ``swing(c, x)`` and whose tip keeps the height of its own place."""
    k = np.arange(round((radius + beyond) / feed * points) + 1)
    c = first + sense * TURN * k / points
    x = radius - feed * k / points
    if inside_out:
        x = x[::-1].copy()
    y = swing(c, x)
    z = height(x * np.cos(c) - y * np.sin(c), x * np.sin(c) + y * np.cos(c))
    return tw.Motion(time=0.001 * k, axes={"C": c, "X": x, "Y": y, "Z": z}, machine=MACHINE)


def sine(amplitude, rate, phase=0.0):
    return lambda c, _x: amplitude * np.sin(rate * c + phase)


def walk(step, seed):
    """A Y that no formula knows: anywhere within ``step`` from point to point, drawn back to the centre."""

    def swing(c, _x):
        noise = np.random.default_rng(seed).uniform(-step, step, c.size)
        return np.convolve(noise, 0.97 ** np.arange(200))[: c.size]

    return swing


def tool(**changes):
    return tw.Tool(**{"nose_radius": 0.3, "included": 100 * DEG, **changes})


CASES = {
    "flat, 30 um, 3.53 a radian": (moving(sine(0.05, 3.53), height=flat), ROUND),
    "312 turns, 2 um, 12.3 a radian": (moving(sine(0.002, 12.3), feed=1 / 312, points=60), ROUND),
    "slow": (moving(sine(0.1, 0.31)), ROUND),
    "slow and wide": (moving(sine(0.5, 0.07)), ROUND),
    "as fast as the part": (moving(sine(0.1, 5.0)), ROUND),
    "faster than the part": (moving(sine(0.1, 23.0), points=240), ROUND),
    "40 swings a turn": (moving(sine(0.01, 40.0), points=360), ROUND),
    "wavy edge": (moving(sine(0.03, 3.1)), tool(waviness=(1e-3, 0.01, -0.02), radius_error=0.01)),
    "edge that is not convex": (moving(sine(0.03, 3.1)), tool(waviness=TABLE)),
    "raked": (moving(sine(0.04, 2.7)), tool(rake=-25 * DEG)),
    "raked, height error": (moving(sine(0.04, 2.7), sense=-1), tool(rake=15 * DEG, offset=(0.0, 0.02, 0.0))),
    "raked, wavy, fast": (moving(sine(0.06, 7.7)), tool(rake=-10 * DEG, waviness=(1e-3, 0.01))),
    "inside out": (moving(sine(0.05, 3.53), inside_out=True), ROUND),
    "falling angle": (moving(sine(0.05, 3.53), sense=-1), ROUND),
    "beyond the axis": (moving(sine(0.02, 2.3), beyond=0.2), ROUND),
    "off centre": (moving(sine(0.02, 2.3)), tool(offset=(0.02, -0.03, 0.001))),
    "few points": (moving(sine(0.08, 1.9), points=11), ROUND),
    "thousands of turns before": (moving(sine(0.02, 3.3), first=3e4), ROUND),
    "as many points as a tracked motion": (moving(sine(0.1, 3.3), radius=0.3, feed=0.1, points=9000), ROUND),
    "as many points, raked": (moving(sine(0.1, 3.3), radius=0.3, feed=0.1, points=9000), tool(rake=-25 * DEG)),
    "any walk": (moving(walk(0.004, 1)), ROUND),
    "tip held over an azimuth": (moving(lambda c, x: x * np.tan(0.1 * np.sin(9 * c))), ROUND),
}


def scaled(case, factor):
    """The same with all lengths larger by a factor."""
    motion, edge = case
    axes = {letter: values if letter == "C" else factor * values for letter, values in motion.axes.items()}
    offset = tuple(factor * one for one in edge.offset)
    larger = replace(edge, nose_radius=factor * edge.nose_radius, offset=offset)
    return replace(motion, axes=axes), larger


CASES |= {
    "a thousandth of the size": scaled(CASES["raked, height error"], 1e-3),
    "a hundred times the size": scaled(CASES["off centre"], 100.0),
}


def reach(motion):
    """Largest distance of the tip from the axis, along X."""
    return float(np.abs(motion.axes["X"]).max())


def random_points(random, count, radius):
    """Points over the disc, a fourth of them close to the axis."""
    near = random.uniform(size=count) < 0.25
    r = np.where(near, 0.15, 1.0) * radius * np.sqrt(random.uniform(size=count))
    azimuth = random.uniform(-np.pi, np.pi, count)
    return r * np.cos(azimuth), r * np.sin(azimuth)


def random_maps(random, motion, edge):
    """Fine and coarse maps, rectangular and polar, as (name, map)."""
    size = reach(motion)
    x, y = random_points(random, 1, 0.9 * size)
    window = 0.03 * size * np.linspace(-1, 1, 41)
    disc = np.linspace(-size, size, 31)
    first, angle = random.uniform(0.0, 0.9), random.uniform(-np.pi, np.pi)
    ring = size * (first + 0.05 * np.linspace(0, 1, 41))
    turn = np.linspace(0, 2 * np.pi, 37)
    return {
        "fine": tw.generate(motion, edge, x=x + window, y=y + window),
        "coarse": tw.generate(motion, edge, x=disc, y=disc),
        "fine polar": tw.generate_polar(motion, edge, radius=ring, angle=angle + np.linspace(0, 0.1, 25)),
        "coarse polar": tw.generate_polar(motion, edge, radius=np.linspace(0, size, 33), angle=turn),
    }
