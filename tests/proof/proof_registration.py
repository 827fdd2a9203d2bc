"""Registration by default: random parts, displaced, turned and partly missing, come back at the noise.

Run it as ``python -m tests.proof.proof_registration [parts] [seed]``.

The oracle is the pose that was put in: every height of the map is the root of the moved design along the instrument's
z, plus white noise. At the true pose the residual is the noise; a fit may leave 1.2 times as much, or be ambiguous.
"""

import sys
import time

import numpy as np

import turnwright as tw

LIMIT = 1.2
"""Residual over noise that counts as found."""

SHARE = 0.97
"""Of the parts that must be found; the others must be marked as ambiguous."""

FAMILIES = ("sine grid", "xy polynomial", "zernike", "torus", "conic", "nearly rotational")

VIEWS = ("whole part", "window", "beyond the part")
"""The map moves with the part; it is a window of the instrument's; or the surface goes on beyond the part's radius."""


def part_of(family, rng):
    """Draw a part of a family."""
    a = rng.uniform(3, 8)
    radius = rng.choice([-1, 1]) * rng.uniform(20, 200)
    match family:
        case "sine grid":
            period = rng.uniform(0.3, 0.9, 2) * a
            surface = tw.SineGrid(
                amplitude=tuple(rng.uniform(0.5e-3, 5e-3, 2)), period=tuple(period), phase=tuple(rng.uniform(-3, 3, 2))
            )
        case "xy polynomial":
            powers = [(i, j) for i in range(5) for j in range(5 - i) if i + j >= 2]
            sizes = {2: 50e-3, 3: 20e-3, 4: 5e-3}
            surface = tw.XYPolynomial(
                terms={(i, j): float(rng.normal() * sizes[i + j] / a ** (i + j)) for i, j in powers}
            )
        case "zernike":
            terms = {int(j): float(rng.normal() * 2e-3) for j in rng.choice(np.arange(5, 26), 6, replace=False)}
            surface = tw.Sphere(radius=radius) + tw.Zernike(terms=terms, radius=a, indexing="fringe")
        case "torus":
            surface = tw.Toroid(radius_x=radius, radius_y=radius * rng.uniform(1.1, 2.0))
        case "conic":
            surface = tw.Conic(radius=radius * 0.6, conic=rng.uniform(-3, -0.5))
        case _:
            terms = {int(j): float(rng.normal() * 0.5e-3) for j in rng.choice(np.arange(5, 17), 2, replace=False)}
            base = tw.Conic(radius=radius, conic=rng.uniform(-2, 0.5))
            surface = base + tw.Zernike(terms=terms, radius=a, indexing="fringe")
    return tw.Part(surface=surface, radius=a)


def pose_of(view, radius, rng):
    """Draw a pose; of a window at least half shows the part."""
    far = min(np.exp(rng.uniform(np.log(0.1), np.log(5.0))), 0.8 * radius if view == "window" else 5.0)
    way = rng.uniform(0, 2 * np.pi)
    turn = rng.choice([-1, 1]) * np.deg2rad(rng.uniform(1, 20))
    tilt = np.deg2rad(rng.uniform(-1, 1, 2))
    return tw.Pose(
        shift=(far * np.cos(way), far * np.sin(way), rng.uniform(-0.5, 0.5)), rotation=turn, tilt=tuple(tilt)
    )


def map_of(part, pose, view, noise, rng, side=121):
    """Return what the instrument shows of a part that ``pose`` brings to the frame of the design. Noise in mm."""
    a = part.radius
    margin = 1.15 if view == "beyond the part" else 1.03
    middle = np.zeros(2) if view == "window" else np.array(pose.inverse.apply(0, 0, 0))[:2]
    axis = np.linspace(-margin * a, margin * a, side)
    x, y = np.meshgrid(axis + middle[0], axis + middle[1])
    z = np.zeros(x.shape)
    with np.errstate(all="ignore"):
        for _ in range(30):
            u, v, w = pose.apply(x, y, z)
            z = z - (w - part.surface.evaluate(u.ravel(), v.ravel(), 0)[0].reshape(u.shape))
        u, v, w = pose.apply(x, y, z)
    z[np.hypot(u, v) > a * (margin if view == "beyond the part" else 1.0)] = np.nan
    share, how = rng.uniform(0, 0.4), rng.integers(3)
    known = np.isfinite(z)
    if how == 0:  # dropouts anywhere
        z[rng.random(z.shape) < share] = np.nan
    else:  # a side of the map, or a hole in it
        way = rng.uniform(0, 2 * np.pi)
        along = (x - middle[0]) * np.cos(way) + (y - middle[1]) * np.sin(way)
        if how == 2:
            spot = rng.uniform(-0.6, 0.6, 2) * a
            along = np.hypot(x - middle[0] - spot[0], y - middle[1] - spot[1])
        z[known & (along < np.quantile(along[known], share))] = np.nan
    z += rng.normal(0, noise, z.shape)
    return tw.HeightMap(x=x[0], y=y[:, 0], z=z)


def case(seed, number):
    """Return family, view, part, pose, map and noise [nm] of one case."""
    rng = np.random.default_rng([seed, number])
    family, view = FAMILIES[number % len(FAMILIES)], VIEWS[(number // len(FAMILIES)) % len(VIEWS)]
    part = part_of(family, rng)
    pose = pose_of(view, part.radius, rng)
    noise_nm = rng.uniform(2, 10)
    return family, view, part, pose, map_of(part, pose, view, noise_nm * 1e-6, rng), noise_nm


def main(parts: int = 100, seed: int = 1) -> int:
    """Print how each part was found; return 1 if too few are at the noise, or one that is not is not ambiguous."""
    good = marked = 0
    print(f"{'part':>4s} {'family':18s} {'view':16s} {'off mm':>7s} {'deg':>6s} {'ratio':>8s} {'s':>5s}")
    for k in range(parts):
        family, view, part, pose, heights, noise_nm = case(seed, k)
        begin = time.perf_counter()
        found = tw.register(heights, part)
        ratio, took = found.rms_nm / noise_nm, time.perf_counter() - begin
        good += ratio <= LIMIT
        marked += ratio > LIMIT and found.ambiguous
        words = "" if ratio <= LIMIT else "ambiguous" if found.ambiguous else "WRONG"
        if sys.flags.verbose or words or found.held:
            off = np.hypot(*pose.shift[:2])
            turn = np.rad2deg(pose.rotation)
            print(
                f"{k:4d} {family:18s} {view:16s} {off:7.2f} {turn:6.1f} {ratio:8.2f} {took:5.2f} {words} "
                f"{'held: ' + ', '.join(found.held) if found.held else ''}"
            )
    print(f"{good} of {parts} at most {LIMIT:g} times the noise, {marked} others marked as ambiguous")
    return 0 if good >= SHARE * parts and good + marked == parts else 1


if __name__ == "__main__":
    raise SystemExit(main(*(int(one) for one in sys.argv[1:])))
