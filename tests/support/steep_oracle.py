"""Surfaces steeper than the flanks of a tool, and where the tool touches them, by brute force.

Nothing of Turnwright's own is used: heights are NumPy formulas written once more, the edge is a circle with straight
flanks in a plane that leans, and all of it that is over the part is sampled, then zoomed in on around every sample that
may be the greatest.
"""

# ruff: noqa: ARG005 - every height is a function of x and y

from dataclasses import dataclass

import numpy as np

import turnwright as tw

RADIUS = 1.5
DENSE = 20_001
EDGES = {
    # nose radius, included angle [deg], rake [deg], height above centre
    "narrow": (0.1, 60, 0, 0.0),
    "wide": (0.2, 90, 0, 0.0),
    "raked": (0.1, 60, -10, 0.0),
    "high": (0.15, 70, 0, 0.02),
    "large": (0.4, 100, 5, -0.01),
}
ALL, UPRIGHT = tuple(EDGES), ("narrow", "wide", "high")


def tool_of(name):
    nose, included, rake, high = EDGES[name]
    return tw.Tool(
        nose_radius=nose, included=np.deg2rad(included), rake=np.deg2rad(rake), clearance=0.2, offset=(0, high, 0)
    )


def square(count, pitch):
    at = (np.arange(count) - (count - 1) / 2) * pitch
    return [(x, y) for y in at for x in at]


def hexagon(rings, pitch):
    return [
        (pitch * (i + j / 2), pitch * j * np.sqrt(0.75))
        for i in range(-rings, rings + 1)
        for j in range(-rings, rings + 1)
        if abs(i + j) <= rings
    ]


def cap(bend, square):
    """Sphere of the radius ``bend`` at the squared distance from its vertex."""
    return bend - np.sign(bend) * np.sqrt(np.maximum(bend**2 - square, 0))


def lenses(centres, bend, aperture, around):
    def height(x, y):
        square = np.min([(x - a) ** 2 + (y - b) ** 2 for a, b in centres], axis=0)
        return np.where(square > aperture**2, around, cap(bend, square))

    return height


@dataclass(frozen=True)
class Case:
    surface: object
    height: object
    tools: tuple = ALL


def array(centres, bend, aperture, around, change=lambda surface: surface, height=lambda plain: plain):
    surface = tw.LensArray(centres=centres, lenslet=tw.Sphere(radius=bend), aperture=aperture, surround=around)
    return Case(change(surface), height(lenses(centres, bend, aperture, around)))


def turned(plain):
    c, s = np.cos(0.3), np.sin(0.3)
    return lambda x, y: plain(c * x + s * y, c * y - s * x)


def formula(text, height, tools=ALL):
    return Case(tw.Expression(text), height, tools)


SQUARE, HEXAGON = square(7, 0.5), hexagon(4, 0.45)
CASES = {
    "sin phi": formula("0.2*sin(phi)", lambda x, y: 0.2 * np.sin(np.arctan2(y, x)), UPRIGHT),
    "cos 3 phi": formula("0.2358*cos(3*phi)", lambda x, y: 0.2358 * np.cos(3 * np.arctan2(y, x)), UPRIGHT),
    "cos 5 phi on a cone": formula(
        "0.05*cos(5*phi)+0.02*rho", lambda x, y: 0.05 * np.cos(5 * np.arctan2(y, x)) + 0.02 * np.hypot(x, y), UPRIGHT
    ),
    "wall across": formula("0.1*atan((y-0.3)/0.002)", lambda x, y: 0.1 * np.arctan((y - 0.3) / 0.002)),
    "sharp wall": formula("-0.05*atan((x+0.5)/0.001)", lambda x, y: -0.05 * np.arctan((x + 0.5) / 0.001)),
    "slanting wall": formula(
        "0.1*atan((y-0.3-0.1*x)/0.001)", lambda x, y: 0.1 * np.arctan((y - 0.3 - 0.1 * x) / 0.001)
    ),
    "ring wall": formula("0.1*tanh((rho-0.7)/0.003)", lambda x, y: 0.1 * np.tanh((np.hypot(x, y) - 0.7) / 0.003)),
    "plateau": formula("-0.1*tanh((rho-0.4)/0.01)", lambda x, y: -0.1 * np.tanh((np.hypot(x, y) - 0.4) / 0.01)),
    "pedestals": array(SQUARE, -2.0, 0.2, -0.2),
    "pits": array(SQUARE, 2.0, 0.2, 0.15),
    "one pedestal": array([(0.4, 0.2)], -1.0, 0.3, -0.3),
    "hexagonal pedestals": array(HEXAGON, 3.0, 0.15, -0.12),
    "pedestals on a slope": array(
        SQUARE, -2.0, 0.2, -0.2, lambda one: one + tw.Plane(slope=(0.05, -0.03)),
        lambda plain: lambda x, y: plain(x, y) + 0.05 * x - 0.03 * y,
    ),
    "pedestals in a bowl": array(
        SQUARE, -2.0, 0.2, -0.2, lambda one: one + tw.Sphere(radius=20.0),
        lambda plain: lambda x, y: plain(x, y) + cap(20.0, x * x + y * y),
    ),
    "turned pedestals": array(SQUARE, -2.0, 0.2, -0.2, lambda one: one.placed(rotation=0.3), turned),
    "deep waves": formula(
        "0.15*sin(2*pi*x/0.5)*exp(-(rho/0.8)**4)",
        lambda x, y: 0.15 * np.sin(2 * np.pi * x / 0.5) * np.exp(-((np.hypot(x, y) / 0.8) ** 4)),
    ),
    "spike": formula(
        "0.3*exp(-((x-0.5)**2+(y-0.2)**2)/0.05**2)",
        lambda x, y: 0.3 * np.exp(-((x - 0.5) ** 2 + (y - 0.2) ** 2) / 0.05**2),
    ),
    "ring ridge": formula(
        "0.2*exp(-((rho-0.8)/0.02)**2)", lambda x, y: 0.2 * np.exp(-(((np.hypot(x, y) - 0.8) / 0.02) ** 2))
    ),
    "jump and wall": formula(
        "0.1*sin(phi)+0.05*atan((x-0.6)/0.003)",
        lambda x, y: 0.1 * np.sin(np.arctan2(y, x)) + 0.05 * np.arctan((x - 0.6) / 0.003),
        UPRIGHT,
    ),
    "trench": formula("-0.2*exp(-((x-0.3)/0.03)**2)", lambda x, y: -0.2 * np.exp(-(((x - 0.3) / 0.03) ** 2))),
}  # fmt: skip


def oracle(case, tool, angle, radius, rim, sense=1):
    """The greatest f - e over the whole edge inside the rim."""
    nose, included, rake, high = EDGES[tool]
    half, c, s = np.deg2rad(included / 2), np.cos(angle), np.sin(angle)
    end = nose * np.sin(half)

    def lift(u):
        w = nose - np.sqrt(nose**2 - np.minimum(np.abs(u), end) ** 2) + (np.abs(u) - end).clip(0) * np.tan(half)
        across = high - sense * np.sin(np.deg2rad(rake)) * w
        x, y = (radius + u) * c - across * s, (radius + u) * s + across * c
        away = np.hypot(x, y)
        with np.errstate(all="ignore"):
            z = case.height(x, y) - np.cos(np.deg2rad(rake)) * w
        return np.where((away <= rim) & (away > 1e-12), z, -np.inf)

    u = np.linspace(-rim - radius, rim - radius, DENSE)
    g = lift(u)
    best = g.max()
    around = np.flatnonzero((g[1:-1] >= g[:-2]) & (g[1:-1] >= g[2:]) & (g[1:-1] > best - 0.02)) + 1
    around = np.union1d(around[np.argsort(g[around])[-24:]], g.argmax())
    for i in around:
        at, wide = u[i], u[1] - u[0]
        for _ in range(12):
            fine = at + np.linspace(-2 * wide, 2 * wide, 201)
            values = lift(fine)
            k = values.argmax()
            at, wide, best = fine[k], wide / 25, max(best, values[k])
            if wide < 1e-16:
                break
    return best


def placed(case, tool, random, count, scattered):
    """Some tips of a path over a case, scattered in azimuth or sharing it: angle, radius, and heights as found."""
    if scattered:
        angle = np.sort(random.uniform(0, 2 * np.pi, count))
        radius = np.where(random.random(count) < 0.3, 0.3, 1.3) * random.random(count)
        spiral = tw.Spiral(angle=angle, radius=radius)
    else:
        turned = np.arange(20 * 90 + 1) * (2 * np.pi / 90)
        spiral = tw.Spiral(angle=turned, radius=1.3 * (1 - turned / turned[-1]))
    path = tw.place(spiral, tw.Part(surface=case.surface, radius=RADIUS), tool_of(tool))
    some = np.arange(count) if scattered else random.choice(spiral.angle.size, count, replace=False)
    return spiral.angle[some], spiral.radius[some], path.z[some], path.clearance


def errors(name, tool, random, count, scattered):
    """How far tips stand above where brute force has them, and the least clearance that the path states. [mm]."""
    case = CASES[name]
    angle, radius, z, clearance = placed(case, tool, random, count, scattered)
    expected = [oracle(case, tool, a, r, RADIUS) for a, r in zip(angle, radius, strict=True)]
    return z - expected, float(clearance.min())
