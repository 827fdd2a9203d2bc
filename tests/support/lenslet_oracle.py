"""A lens array as no machine would cut it, known exactly: lenslets moved one by one, each with a form error of its own.

And what an ideal fit makes of one lenslet: SciPy's least squares over the whole aperture of the true surface, by a
quadrature that is exact for polynomials of degree 23.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

import turnwright as tw

R, APERTURE, PITCH, RIM = 10.0, 0.5, 2.0, 7.5
DEPTH = R - np.sqrt(R**2 - APERTURE**2)
BASE = tw.Toroid(radius_x=500.0, radius_y=250.0)
ARRAY = tw.LensArray.square(
    pitch=PITCH,
    within=RIM,
    aperture=APERTURE,
    lenslet=tw.Sphere(radius=R).placed(shift=(0, 0, -DEPTH)),
    surround=0.0,
)
PART = tw.Part(surface=BASE + ARRAY, radius=RIM)


def waves(u, v):
    """Astigmatism, coma, trefoil and spherical aberration over the unit disc, each of rms 1. (8, ...)."""
    r2 = u * u + v * v
    return np.array(
        [
            np.sqrt(6) * (u * u - v * v),
            np.sqrt(6) * 2 * u * v,
            np.sqrt(8) * (3 * r2 - 2) * u,
            np.sqrt(8) * (3 * r2 - 2) * v,
            np.sqrt(8) * (u * u - 3 * v * v) * u,
            np.sqrt(8) * (3 * u * u - v * v) * v,
            np.sqrt(5) * (6 * r2 * r2 - 6 * r2 + 1),
            np.sqrt(3) * (2 * r2 - 1),
        ]
    )


@dataclass(frozen=True)
class MadeArray:
    """The array as it was made."""

    centres: np.ndarray  # (n, 2) [mm]
    radii: np.ndarray  # of curvature (n,) [mm]
    forms: np.ndarray  # of `waves` (n, 8) [mm]

    @classmethod
    def of(cls, rng, dislocation=(0.010, 0.140), form=(0.1e-3, 0.8e-3), spread=0.0):
        """Draw one: every lenslet somewhere else, with another form of a stated rms."""
        n = len(ARRAY.centres)
        way, far = rng.uniform(0, 2 * np.pi, n), rng.uniform(*dislocation, n)
        terms = rng.normal(size=(n, 8)) * [1, 1, 0.4, 0.4, 1, 1, 0.5, 0.3]
        terms *= (rng.uniform(*form, n) / np.sqrt((terms**2).sum(axis=1)))[:, None]
        centres = ARRAY.centres + far[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
        return cls(centres=centres, radii=R * (1 + spread * rng.normal(size=n)), forms=terms)

    def sag(self, x, y):
        """Return the height of the surface as made."""
        z = BASE.sag(x, y)
        for centre, radius, form in zip(self.centres, self.radii, self.forms, strict=True):
            u, v = x - centre[0], y - centre[1]
            lens = u * u + v * v <= APERTURE**2
            z[lens] += self.lens(u[lens], v[lens], radius, form)
        return z

    @staticmethod
    def lens(u, v, radius, form):
        """Return what one lenslet adds to the base, about its own centre."""
        return (
            radius
            - np.sqrt(radius**2 - u * u - v * v)
            - DEPTH
            + np.tensordot(form, waves(u / APERTURE, v / APERTURE), 1)
        )

    def seen(self, pose, rng, side=1000, noise=20e-6, spikes=0.001):
        """Return the map an instrument shows: an even grid in its own frame, with noise and spikes."""
        x = np.linspace(-RIM, RIM, side)
        gx, gy = np.meshgrid(x + pose.inverse.shift[0], x + pose.inverse.shift[1])
        z = np.zeros(gx.shape)
        for _ in range(6):
            px, py, pz = pose.apply(gx, gy, z)
            z += self.sag(px, py) - pz
        z += rng.normal(0, noise, z.shape)
        bad = rng.random(z.shape) < spikes
        z[bad] += rng.choice([-1, 1], bad.sum()) * rng.uniform(0.2e-3, 20e-3, bad.sum())
        px, py, _ = pose.apply(gx, gy, z)
        z[np.hypot(px, py) > RIM] = np.nan
        return tw.HeightMap(x=gx[0], y=gy[:, 0], z=z)

    def ideal(self, k, inner=0.95, design=False, about_own=False):
        """Return centre, radius and rms [nm] of the sphere that fits lenslet k best, of the design's radius or its own.

        The aperture is about the centre that the fit finds; ``about_own`` puts it where the lenslet was cut.
        """
        reach = inner * APERTURE
        found = np.zeros(4)
        for _ in range(12):
            middle = np.zeros(2) if about_own else found[:2].copy()
            node, weight = np.polynomial.legendre.leggauss(12)
            turn = np.linspace(0, 2 * np.pi, 36, endpoint=False)
            away, share = (1 + node) / 2 * reach, np.sqrt(np.repeat(weight * (1 + node) / 72, turn.size))
            u, v = (np.outer(away, way(turn)).ravel() + at for way, at in zip((np.cos, np.sin), middle, strict=True))
            z = self.lens(u, v, self.radii[k], self.forms[k])

            def left(p, u=u, v=v, z=z, share=share):
                radius = R if design else 1 / (1 / R + p[3])
                return (
                    (radius - np.sqrt(radius**2 - (u - p[0]) ** 2 - (v - p[1]) ** 2) - DEPTH + p[2] - z) * share * 1e3
                )

            count = 3 if design else 4
            fit = least_squares(left, found[:count], x_scale=[1e-3, 1e-3, 1e-4, 1e-3][:count], xtol=1e-12)
            moved = np.abs(fit.x - found[:count])[:2].max()
            found[:count] = fit.x
            if moved < 1e-7:
                break
        return self.centres[k] + found[:2], 1 / (1 / R + found[3]), float(np.sqrt(np.sum(fit.fun**2))) * 1e3
