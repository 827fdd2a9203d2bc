"""Forces of round noses, mills and fly-cutters from the shapes that an edge leaves, point by point.

Nothing of Turnwright's own chips or forces is used: along the normal of each element of the edge the end of the
material is found by bisection in space, from what is in stock and what the tool has taken before.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from force_oracle import CHANNELS, RATE, tap_tests, through
from turnwright.cutting import Dynamometer, interrupted_cuts, learn_material, turning_cuts
from turnwright.cutting.forces import FlyCut, SlotMill
from turnwright.cutting.learning.signals import ForceRecord, engagements, in_air, remove_drift

STEPS = 44


@dataclass(frozen=True)
class Glass:
    """Coefficients, the critical thickness, and the share of the force at it that stays beyond, for both."""

    cutting: float
    thrust: float
    critical: float = np.inf
    left: tuple[float, float] = (0.6, 0.7)

    @classmethod
    def random(cls, random, critical=600e-6):
        return cls(1489 * random.uniform(0.8, 1.2), 816 * random.uniform(0.8, 1.2), critical * random.uniform(0.7, 1.3))

    def per_width(self, chip):
        """Force along the cut and along the normal per width of edge."""
        thick = chip > self.critical
        return [
            np.where(thick, share * k * min(self.critical, 1.0), k * chip)
            for k, share in ((self.cutting, self.left[0]), (self.thrust, self.left[1]))
        ]


def thickness(radius, in_stock):
    """How far from the edge at ``radius`` inward the material reaches; ``in_stock`` takes radii. Any shape."""
    outer = np.array(radius, dtype=float)
    inner = outer * (1 - 0.05)  # no chip here is as thick
    cuts = in_stock(outer * (1 - 1e-13))
    for _ in range(STEPS):
        middle = (outer + inner) / 2
        inside = in_stock(middle)
        outer, inner = np.where(inside, middle, outer), np.where(inside, inner, middle)
    return np.where(cuts, radius - outer, 0.0)


def turning(glass, nose, depth, feed, elements=3000):
    """Axial, feed and cutting force of a steady cut, the chip's area and its thickest place."""
    reach = np.arccos(1 - depth / nose)
    ends = np.linspace(-np.arcsin(feed / nose), reach, elements + 1)
    s = (ends[1:] + ends[:-1]) / 2

    def in_stock(r):
        x, z = r * np.sin(s), nose - r * np.cos(s)
        return (z < depth) & (np.hypot(x + feed, z - nose) > nose)

    chip = thickness(np.full(elements, nose), in_stock)
    width = np.diff(ends) * (nose - chip / 2)  # a sector of a ring
    along, normal = (one * width for one in glass.per_width(chip))
    return np.array([normal @ np.cos(s), normal @ np.sin(s), along.sum()]), chip @ width, chip.max()


def slot(glass, radius, feed, depth, corner, phi, elements=60):
    """Force of one tooth on the part at some angles. (n, 3)."""
    center = radius - corner
    ends = np.linspace(0, np.arccos(1 - min(depth / corner, 1.0)), elements + 1) if corner else np.empty(0)
    force = np.zeros((phi.size, 3))
    out = np.stack((-np.cos(phi), np.sin(phi)), axis=-1)
    motion = np.stack((np.sin(phi), np.cos(phi)), axis=-1)

    def add(lean, ring, height, size):
        def in_stock(r):
            at = (center + r * np.sin(lean))[:, None] * out if corner else r[:, None] * out
            z = corner - r * np.cos(lean) if corner and height is None else np.inf
            before = np.hypot(at[:, 0], at[:, 1] + feed)
            tool = radius if not np.ndim(z) else center + np.sqrt(np.maximum(corner**2 - (corner - z) ** 2, 0))
            return before > tool

        chip = thickness(np.full(phi.size, ring), in_stock)
        along, normal = (one * size for one in glass.per_width(chip))
        force[:, :2] += along[:, None] * motion + normal[:, None] * np.sin(lean) * out
        force[:, 2] += normal * np.cos(lean)

    for a, b in pairwise(ends):
        add((a + b) / 2, corner, None, corner * (b - a))
    if depth > corner:
        add(np.pi / 2, corner or radius, 0.0, depth - corner)
    cuts = (phi > 0) & (phi < np.pi)
    return force * cuts[:, None]


def fly(glass, swing, nose, feed, step, depth, phi, elements=400):
    """Force on the part at some angles of the swing: across the lines, along the cut, into the part. (n, 3)."""
    reach = np.arccos(1 - depth / nose)
    ends = np.linspace(-np.arcsin(step / nose), reach, elements + 1)
    s = (ends[1:] + ends[:-1]) / 2
    force = np.zeros((phi.size, 3))
    for i, angle in enumerate(phi):
        # The axis of the spindle is at (y, z) = (0, swing); the edge lies in the plane of the axis, x across.
        def in_stock(r, angle=angle):
            x, long = r * np.sin(s), swing - nose + r * np.cos(s)
            y, z = long * np.sin(angle), swing - long * np.cos(angle)
            before = np.hypot(x, np.hypot(y + feed, z - swing) - (swing - nose)) <= nose  # the swing before
            line = np.hypot(x + step, z - nose) <= nose  # the groove of the line before, of full depth
            return (z < depth) & ~before & ~line

        chip = thickness(np.full(elements, nose), in_stock)
        width = np.diff(ends) * (nose - chip / 2)
        along, normal = (one * width for one in glass.per_width(chip))
        down = normal @ np.cos(s)
        push = along.sum()
        radial, motion = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
        force[i] = normal @ np.sin(s), *(down * radial + push * motion)
    force[:, 2] *= -1  # into the part is down
    return force


def in_time(shape, phi, time, rpm, entry, phase, teeth=1):
    """Forces over time of a cutter whose tooth has ``shape`` at the angles ``phi``. (n, 3)."""
    turned = 2 * np.pi * rpm / 60 * (time - entry) + phase
    force = np.zeros((time.size, 3))
    for tooth in range(teeth):
        at = np.mod(turned - 2 * np.pi * tooth / teeth - phi[0], 2 * np.pi) + phi[0]
        for axis in range(3):
            force[:, axis] += np.interp(at, phi, shape[:, axis], right=0.0)
    return force


def recorded(random, force, *, noise=5e-3):
    """What a dynamometer with resonance and cross-talk says of forces, with noise that hangs together and drift."""
    count = force.shape[0]
    measured = through(force)
    together = np.sqrt(0.75) * lfilter([1], [1, -0.5], random.normal(size=measured.shape), axis=0)
    share = (np.arange(count) / count)[:, None]
    drift = (
        np.array([0.02, -0.05, 0.03]) * share + np.array([0.01, 0.01, -0.02]) * share**2 + 0.1 * random.normal(size=3)
    )
    return measured + noise * together + drift


def turning_record(random, *, noise=5e-3, feeds=None, nose=1.0, depth=0.020, each=0.25, gap=0.03, brittle=True):
    """Cuts of a round nose one after the other, each with its own feed; channels axial, feed, cutting."""
    glass = Glass.random(random)
    glass = glass if brittle else Glass(glass.cutting, glass.thrust)
    feeds = np.linspace(0.5e-3, 5e-3, 12) if feeds is None else feeds
    steady = np.array([turning(glass, nose, depth, feed)[0] for feed in feeds])
    count = int(RATE * (0.1 + feeds.size * (each + gap) + 0.07))
    time = np.arange(count) / RATE
    begin = 0.1 + random.uniform(0, 0.01)
    which = np.floor((time - begin) / (each + gap)).astype(int)
    on = (which >= 0) & (which < feeds.size) & (np.mod(time - begin, each + gap) < each)
    force = np.where(on[:, None], steady[np.clip(which, 0, feeds.size - 1)], 0.0)
    thick = np.array([turning(glass, nose, depth, feed)[2] > glass.critical for feed in feeds])
    shaking = on & thick[np.clip(which, 0, feeds.size - 1)]
    force *= (1 + 0.03 * shaking * lfilter([0.3], [1, -0.954], random.normal(size=count)))[:, None]
    return recorded(random, force, noise=noise), glass, feeds


SLOT = {"radius": 1.0, "feed_per_tooth": 1e-3, "depth": 0.2}
FLY = {"swing": 20.0, "nose_radius": 1.0, "feed": 0.03, "step": 0.05, "depth": 0.02}


def milling_record(random, kind, *, noise=5e-3, brittle=True):
    """One pass from 0.2 s on to 0.2 s before the end; channels x, y, z. Also the geometry and the stated speed."""
    glass = Glass.random(random)
    glass = glass if brittle else Glass(glass.cutting, glass.thrust)
    seconds, rpm = (4.4, 150.0) if kind == "fly" else (1.4, 1200.0)
    time = np.arange(int(RATE * seconds)) / RATE
    if kind == "fly":
        geometry, reach = FlyCut(**FLY), np.arccos(1 - FLY["depth"] / FLY["swing"])
        phi = np.linspace(-reach, reach, 401)
        shape = fly(glass, *FLY.values(), phi)
    else:
        corner, teeth = (0.0, 1) if kind == "square" else (0.1, 2)
        geometry = SlotMill(**SLOT, corner_radius=corner, teeth=teeth)
        phi = np.linspace(0, np.pi, 2001)
        shape = slot(glass, *SLOT.values(), corner, phi)
    true_rpm = rpm * random.uniform(0.995, 1.005)
    force = in_time(shape, phi, time, true_rpm, 0.2, random.uniform(0, 2 * np.pi), getattr(geometry, "teeth", 1))
    force *= ((time > 0.2) & (time < seconds - 0.2))[:, None]
    return recorded(random, force, noise=noise), glass, geometry, rpm


def found_back(random, measured):
    """The forces through the inverse of the dynamometer as taps tell it."""
    sensor = Dynamometer.from_taps(tap_tests(random))
    record = ForceRecord(force=measured, rate_hz=RATE, channels=CHANNELS)
    return sensor, sensor.forces(record, bandwidth_hz=5000.0, noise_to_signal=0.01)


def shares(sensor, true, cuts):
    air = in_air(true.samples, cuts)
    steady = remove_drift(true, air, degree=2).force[~air].mean(axis=0)
    return np.minimum(sensor.relative_uncertainty(steady), 1.0)


def learned_turning(random, *, noise=5e-3, **more):
    measured, glass, feeds = turning_record(random, noise=noise)
    sensor, true = found_back(random, measured)
    cuts = engagements(true, "Fz", shortest=0.02, drift=2, lead=0.08)
    rows = turning_cuts(
        true, cuts, nose_radius=1.0, depth=0.02, feed=feeds, block=2e-3, guard=2e-3,
        axial="Fx", feed_force="Fy", cutting="Fz",
    )  # fmt: skip
    return learn_material(rows, drift=2, calibration=shares(sensor, true, cuts), **more), glass


def learned_milling(random, kind, *, block, brittle=True, **more):
    measured, glass, geometry, rpm = milling_record(random, kind, brittle=brittle)
    sensor, true = found_back(random, measured)
    cuts = [[int(0.2 * RATE), true.samples - int(0.2 * RATE)]]

    def passband(frequency):
        heard = frequency <= 6000
        found = np.zeros((frequency.size, 3, 3), dtype=complex)
        found[heard] = sensor.resolution(frequency[heard], bandwidth_hz=5000.0, noise_to_signal=0.01)
        return found

    rows = interrupted_cuts(
        true, cuts, geometry=geometry, spindle_rpm=rpm, block=block, guard=0.05, x="Fx", y="Fy", z="Fz",
        passband=passband,
    )  # fmt: skip
    return learn_material(rows, drift=2, calibration=shares(sensor, true, cuts), **more), glass
