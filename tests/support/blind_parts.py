"""Parts cut by brute force with errors that are drawn, and measured: nothing of it is the program's own simulation.

A point (r, phi) of the part meets the rake plane of a tool that stands v off the radial line when the spindle is at
theta = phi - asin(v / r). Every pass that can reach it there is tried, and the lowest edge counts:

    h = min over passes of  Z(rho, theta) + errors(rho, theta, t) + e(r cos(phi - theta) - rho - dx)

Z is commanded: the tangent of the planned nose on the design, by Newton's method on closed forms, or what a caller
gives. The edge e is that of the real tool.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

import turnwright as tw

TURN = 2 * np.pi


@dataclass(frozen=True, kw_only=True)
class Design:
    """A surface in closed form: z, first and second derivatives; and the same as a surface of the program."""

    name: str
    of: object  # (x, y) -> z, zx, zy, zxx, zxy, zyy
    surface: tw.Surface


def sphere(radius):
    c = 1 / radius

    def of(x, y):
        root = np.sqrt(1 - c * c * (x * x + y * y))
        z = c * (x * x + y * y) / (1 + root)
        zx, zy = c * x / root, c * y / root
        return z, zx, zy, c / root + c**3 * x * x / root**3, c**3 * x * y / root**3, c / root + c**3 * y * y / root**3

    return Design(name="sphere", of=of, surface=tw.Sphere(radius=radius))


def flat(slope=(0.0, 0.0)):
    def of(x, y):
        zero = np.zeros_like(x)
        return slope[0] * x + slope[1] * y, zero + slope[0], zero + slope[1], zero, zero, zero

    return Design(name="flat", of=of, surface=tw.Plane(slope=slope))


def toroid(radius_x, radius_y):
    """An arc in the xz plane, turned about a line parallel to x."""

    def of(x, y):
        q = np.sqrt(radius_x**2 - x * x)
        g, g1, g2 = x * x / (radius_x + q), x / q, radius_x**2 / q**3
        height = radius_y - g
        s = np.sqrt(height**2 - y * y)
        z = g + y * y / (height + s)
        return (
            z, height * g1 / s, y / s, (height * g2 - g1**2) / s + (height * g1) ** 2 / s**3,
            height * g1 * y / s**3, 1 / s + y * y / s**3,
        )  # fmt: skip

    return Design(name="toroid", of=of, surface=tw.Toroid(radius_x=radius_x, radius_y=radius_y))


def freeform(terms):
    surface = tw.XYPolynomial(terms=terms)

    def of(x, y):
        out = [np.zeros_like(x) for _ in range(6)]
        for (i, j), a in terms.items():

            def power(base, n):
                return base**n if n >= 0 else np.zeros_like(base)

            xi, yj = power(x, i), power(y, j)
            dx, dy = i * power(x, i - 1), j * power(y, j - 1)
            ddx, ddy = i * (i - 1) * power(x, i - 2), j * (j - 1) * power(y, j - 2)
            for k, one in enumerate((xi * yj, dx * yj, xi * dy, ddx * yj, dx * dy, xi * ddy)):
                out[k] = out[k] + a * one
        return tuple(out)

    return Design(name="freeform", of=of, surface=surface)


@dataclass(frozen=True, kw_only=True)
class Errors:
    """What the real tool, machine and cut have beyond the plan. [mm, rad]."""

    offset: tuple = (0.0, 0.0, 0.0)
    radius: float = 0.0
    waviness: dict = field(default_factory=dict)  # power: mm/rad^power
    squareness: float = 0.0
    axial: dict = field(default_factory=dict)  # per revolution: (cos, sin) [mm]
    radial: dict = field(default_factory=dict)  # per revolution: (cos, sin) along X [mm]
    drift_z: object = None  # share of the cut (0 to 1) -> mm
    drift_x: object = None
    tilt: tuple = (0.0, 0.0)  # of the spindle to the Z slide, along X and Y: mm of X, Y per mm of Z


@dataclass(frozen=True, kw_only=True)
class Cut:
    """How the part was planned: nose, feed, clear aperture, sense of rotation."""

    design: Design
    nose: float
    feed: float
    radius: float
    sense: int = 1
    commanded: object = None  # (rho, theta) -> Z of the tip; the tangent of the planned nose where none is given

    def z(self, rho, theta):
        if self.commanded is not None:
            return self.commanded(rho, theta)
        sine, cosine = np.sin(theta), np.cos(theta)
        sweep = np.zeros_like(rho)
        for _ in range(30):
            at = rho + self.nose * np.sin(sweep)
            x, y = at * cosine, at * sine
            _, zx, zy, zxx, zxy, zyy = self.design.of(x, y)
            slope = zx * cosine + zy * sine
            bent = zxx * cosine**2 + 2 * zxy * sine * cosine + zyy * sine**2
            off = np.tan(sweep) - slope
            step = off / (1 / np.cos(sweep) ** 2 - bent * self.nose * np.cos(sweep))
            sweep = sweep - step
            if np.abs(step).max() < 1e-14:
                break
        at = rho + self.nose * np.sin(sweep)
        return self.design.of(at * cosine, at * sine)[0] - 2 * self.nose * np.sin(sweep / 2) ** 2


def edge(u, nose, errors):
    """Return the height of the real edge at a distance from its tip."""
    actual = nose + errors.radius
    ratio = np.clip(u / actual, -0.999, 0.999)
    sweep = np.arcsin(ratio)
    for _ in range(4 if errors.waviness else 0):
        d = sum(c * sweep**p for p, c in errors.waviness.items())
        d1 = sum(c * p * sweep ** (p - 1) for p, c in errors.waviness.items())
        off = (actual + d) * np.sin(sweep) - u
        sweep = sweep - off / ((actual + d) * np.cos(sweep) + d1 * np.sin(sweep))
    d = sum((c * sweep**p for p, c in errors.waviness.items()), np.zeros_like(sweep))
    return 2 * actual * np.sin(sweep / 2) ** 2 - d * np.cos(sweep)


def wave(lobes, theta):
    return sum((a * np.cos(k * theta) + b * np.sin(k * theta) for k, (a, b) in lobes.items()), np.zeros_like(theta))


def left(cut: Cut, errors: Errors, x, y, passes=12, phase=0.0):
    """Return the height that the real tool leaves at points. (n,) [mm]."""
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    number = np.arange(-passes, passes + 1)[:, None]
    rho = np.repeat(r[None], number.size, axis=0)
    theta = np.repeat(phi[None], number.size, axis=0)
    first = None
    for _ in range(4):  # where the spindle is, and where the tip of each pass is then
        share = 1 - rho / cut.radius
        z = cut.z(rho, theta) if errors.tilt != (0.0, 0.0) else 0.0
        v = errors.offset[1] + errors.tilt[1] * z
        theta = phi - np.arcsin(np.clip(v / np.maximum(r, 1e-9), -1, 1))
        moved = errors.offset[0] + wave(errors.radial, theta) + errors.tilt[0] * z
        if errors.drift_x is not None:
            moved = moved + errors.drift_x(share)
        place = np.sqrt(np.maximum(r * r - v * v, 0.0))
        # The tip's place without cusps, then the passes of the spiral around it.
        if first is None:
            _, zx, zy, *_ = cut.design.of(x, y)
            sweep = np.arctan(zx * np.cos(phi) + zy * np.sin(phi))
            first = (r - cut.nose * np.sin(sweep))[None]
        turn = np.mod(cut.sense * theta / TURN + phase, 1.0)
        rho = (np.rint(first / cut.feed + turn) - turn + number) * cut.feed
    u = place - rho - moved
    z = cut.z(rho, theta) + errors.offset[2] + errors.squareness * rho + wave(errors.axial, theta)
    if errors.drift_z is not None:
        z = z + errors.drift_z(1 - rho / cut.radius)
    height = z + edge(u, cut.nose, errors)
    height = np.where((np.abs(u) < 0.9 * cut.nose) & (rho > -cut.feed), height, np.inf)
    best = height.argmin(axis=0)
    assert ((best > 0) & (best < number.size - 1)).mean() > 0.99, "more passes are needed"
    return height.min(axis=0)
