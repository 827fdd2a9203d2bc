"""Wavefront, point spread and MTF against closed forms and prysm."""

import math

import numpy as np
import pytest
from scipy.special import j1

import turnwright as tw
from turnwright.errors import InputError
from turnwright.optics import wavefront

RED = 633e-6
RADIUS = 5.0


def disc_map(function, count=201):
    """Return a map of a disc of 5 mm: its function takes x and y over the radius."""
    x = np.linspace(-RADIUS, RADIUS, count)
    u, v = np.meshgrid(x / RADIUS, x / RADIUS)
    return tw.HeightMap(x=x, y=x, z=np.where(u * u + v * v <= 1 + 1e-12, function(u, v), np.nan))


def polar_map(function, rings=101, azimuths=64):
    radius, angle = np.linspace(0, RADIUS, rings), np.linspace(0, 2 * np.pi, azimuths, endpoint=False)
    u, v = np.outer(np.cos(angle), radius) / RADIUS, np.outer(np.sin(angle), radius) / RADIUS
    return tw.HeightMap(radius=radius, angle=angle, z=function(u, v))


def flat(u, v):
    return np.zeros_like(u)


def aberrated(u, v):
    """Astigmatism, balanced coma and spherical aberration: orthogonal over the disc. [mm]."""
    s = u * u + v * v
    return 30e-6 * 2 * u * v + 20e-6 * (3 * s - 2) * u + 15e-6 * (6 * s * s - 6 * s + 1)


@pytest.mark.parametrize("made", [disc_map(flat), polar_map(flat)], ids=["rectangular", "polar"])
def test_mtf_of_a_circular_pupil(made):
    light = wavefront(made, wavelength=RED, radius=RADIUS)
    share = np.array([0.0, 1e-4, 0.01, 0.3, 0.77, 0.999, 1.0, 1.5])
    modulation = light.mtf(share * 2 * RADIUS / RED)
    s = np.minimum(share, 1.0)
    ideal = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    assert modulation.x == pytest.approx(ideal, abs=1e-11)
    assert modulation.y == pytest.approx(ideal, abs=1e-11)
    assert modulation.cutoff == pytest.approx(2 * RADIUS / RED)


def test_mtf_of_an_obscured_pupil():
    """Areas of overlapping circles, in closed form."""

    def lens(a, b, d):
        if d <= abs(a - b):
            return math.pi * min(a, b) ** 2
        if d >= a + b:
            return 0.0
        one, other = (d * d + a * a - b * b) / (2 * d), (d * d + b * b - a * a) / (2 * d)
        return (
            a * a * math.acos(one / a) - one * math.sqrt(a * a - one * one)
            + b * b * math.acos(other / b) - other * math.sqrt(b * b - other * other)
        )  # fmt: skip

    ratio, share = 0.35, np.array([0.05, 0.3, 0.5, 0.66, 0.9])
    light = wavefront(polar_map(flat), wavelength=RED, obscuration=ratio)
    ideal = [(lens(1, 1, d) - 2 * lens(1, ratio, d) + lens(ratio, ratio, d)) for d in 2 * share]
    assert light.mtf(share * 2 * RADIUS / RED).x == pytest.approx(
        np.array(ideal) / (math.pi * (1 - ratio**2)), abs=1e-10
    )


@pytest.mark.parametrize("start", [0.0, -math.pi, 1.0, 3.0])
def test_polar_map_may_begin_at_any_azimuth(start):
    """Astigmatism of a mirror, 2 a / sqrt(6): a map that begins elsewhere is the same map."""
    radius, angle = np.linspace(0, RADIUS, 101), start + np.linspace(0, 2 * np.pi, 90, endpoint=False)
    z = 60e-6 * np.cos(2 * angle)[:, None] * (radius / RADIUS) ** 2
    light = wavefront(tw.HeightMap(radius=radius, angle=angle, z=z), wavelength=RED, radius=RADIUS)
    assert light.covered == pytest.approx(1.0)
    assert light.rms == pytest.approx(120e-6 / math.sqrt(6), rel=1e-5)


def annulus(u, v):
    return 50e-6 * (u * u - v * v) + 30e-6 * u * (u * u + v * v)


@pytest.mark.parametrize("azimuths", [96, 97])
def test_hole_of_an_annular_map_stays_empty(azimuths):
    """Against sums over a fine polar grid of the ring itself."""
    radius, angle = np.linspace(1.5, 4, 101), np.linspace(0, 2 * np.pi, azimuths, endpoint=False)
    u, v = np.outer(np.cos(angle), radius) / 4, np.outer(np.sin(angle), radius) / 4
    ring = tw.HeightMap(radius=radius, angle=angle, z=annulus(u, v))
    light = wavefront(ring, wavelength=RED, obscuration=0.375, remove="none")
    node, weight = np.polynomial.legendre.leggauss(60)
    r, turn = 2.75 + 1.25 * node, 2 * np.pi * np.arange(240) / 240
    phase = 4 * np.pi / RED * annulus(np.outer(np.cos(turn), r) / 4, np.outer(np.sin(turn), r) / 4)
    mean = np.average(np.exp(1j * phase), weights=np.broadcast_to(weight * r, phase.shape))
    assert light.strehl == pytest.approx(abs(mean) ** 2, rel=1e-5)
    assert light.covered == pytest.approx(1.0, abs=1e-9)
    assert wavefront(ring, wavelength=RED).covered == pytest.approx(1 - 0.375**2, abs=0.01)


def test_large_map_enters_thinned(monkeypatch):
    monkeypatch.setattr("turnwright.optics.pupil.MOST_HEIGHTS", 60_000)
    small, large = (wavefront(disc_map(aberrated, n), wavelength=RED, radius=RADIUS) for n in (251, 601))
    assert large.strehl == pytest.approx(small.strehl, rel=2e-5)


def test_psf_of_a_circular_pupil_is_airy():
    image = wavefront(polar_map(flat), wavelength=RED).psf(points=65, focal_length=100.0)
    r = np.hypot(image.x, image.y[:, None]) * np.pi * 2 * RADIUS / (RED * 100.0)
    r[32, 32] = 1e-9
    assert image.intensity == pytest.approx((2 * j1(r) / r) ** 2, abs=1e-12)


def test_strehl_of_defocus_is_a_sinc():
    """A mirror with focus a (2 r² - 1): the pupil's mean is sinc(2 k a)."""
    amplitude = 20e-6
    light = wavefront(polar_map(lambda u, v: amplitude * (2 * (u * u + v * v) - 1)), wavelength=RED)
    phase = 4 * math.pi * amplitude / RED
    assert light.strehl == pytest.approx((math.sin(phase) / phase) ** 2, rel=1e-6)
    assert light.rms == pytest.approx(2 * amplitude / math.sqrt(3), rel=1e-6)
    assert light.psf(points=65).intensity.max() == pytest.approx(light.strehl, rel=1e-9)


@pytest.mark.parametrize("make", [disc_map, polar_map])
def test_zernike_decomposition_of_a_wavefront(make):
    light = wavefront(make(aberrated), wavelength=RED, radius=RADIUS)
    terms = light.zernike(16).terms
    expected = {6: -60e-6, 7: -40e-6, 9: -30e-6}  # a mirror: -2
    scale = 1e-8 if make is disc_map else 1e-9
    assert all(value == pytest.approx(expected.get(j, 0.0), abs=scale) for j, value in terms.items())


def test_strehl_and_mtf_of_prysm():
    from prysm.coordinates import cart_to_polar, make_xy_grid
    from prysm.geometry import circle
    from prysm.otf import mtf_from_psf
    from prysm.propagation import Wavefront

    count, focal = 512, 100.0
    x, y = make_xy_grid(count, diameter=2 * RADIUS)
    amplitude = circle(RADIUS, cart_to_polar(x, y)[0]).astype(float)
    z = aberrated(x / RADIUS, y / RADIUS)
    step = 2 * RADIUS / count
    images = [
        Wavefront.from_amp_and_phase(amplitude, phase, RED * 1e3, step).focus(focal, Q=4).intensity
        for phase in (-2e6 * z, 0 * z)
    ]
    light = wavefront(
        tw.HeightMap(x=x[0], y=y[:, 0], z=np.where(amplitude > 0, z, np.nan)), wavelength=RED, radius=RADIUS
    )
    assert light.strehl == pytest.approx(images[0].data.max() / images[1].data.max(), abs=1e-4)
    slices = mtf_from_psf(images[0].data, images[0].dx).slices()
    for (frequency, transfer), name in ((slices.x, "x"), (slices.y, "y")):
        chosen = (frequency >= 0) & (frequency < 157)
        made = light.mtf(frequency[chosen][::60], focal_length=focal)
        assert getattr(made, name) == pytest.approx(transfer[chosen][::60], abs=1e-4)


def test_tilt_and_focus_are_removed_exactly():
    x, y = (0.3, -0.2)
    tilted = polar_map(lambda u, v: 1e-4 + 2e-4 * u - 1e-4 * v + 3e-4 * (u * u + v * v))
    assert wavefront(tilted, wavelength=RED, remove="focus").strehl == pytest.approx(1.0, abs=1e-9)
    assert wavefront(tilted, wavelength=RED, remove="tilt").strehl < 0.5
    moved = tw.HeightMap(
        x=np.linspace(-5, 6, 111), y=np.linspace(-6, 5, 111),
        z=np.full((111, 111), 1e-4) + 1e-4 * np.linspace(-5, 6, 111),
    )  # fmt: skip
    light = wavefront(moved, wavelength=RED, radius=4.0, centre=(x, y))
    assert (light.strehl, light.centre) == (pytest.approx(1.0), (x, y))


def test_rays_of_a_paraboloid_and_a_lens():
    """Collimated light meets a paraboloid at the angle of its slope: path -2 cos² t for each height."""
    bump = polar_map(lambda u, v: 50e-6 * (u * u + v * v) ** 2)
    paraboloid = tw.Conic(radius=10.0, conic=-1.0)
    slope = bump.radius / 10.0
    light = wavefront(bump, wavelength=RED, design=paraboloid, remove="none")
    assert light.opd.z == pytest.approx(-2 * bump.z / (1 + slope**2), rel=1e-12)
    focus = wavefront(bump, wavelength=RED, design=paraboloid, source=5.0, remove="none")
    assert focus.opd.z == pytest.approx(-2 * bump.z / (1 + slope**2), rel=1e-12)  # from its focus: the same angles
    # A plano-convex lens with the light inside it along the axis: n cos t - cos t', t' by Snell.
    lens = wavefront(bump, wavelength=RED, index=1.5, design=tw.Sphere(radius=-30.0), inside=True, remove="none")
    t = np.arcsin(bump.radius / 30.0)
    gain = 1.5 * np.cos(t) - np.cos(np.arcsin(1.5 * np.sin(t)))
    assert lens.opd.z == pytest.approx(bump.z * gain * np.cos(t), rel=1e-10)


@pytest.mark.parametrize(
    ("count", "pixels", "way"),
    [(301, 6, 0), *(pytest.param(*one, marks=pytest.mark.proof) for one in ((301, 6.3, 1), (801, 9, 0))), (801, 5, 1)],
)
def test_strehl_of_a_fine_ripple_is_bessel(count, pixels, way):
    """A mirror with a ripple of amplitude a: J0(2 k a)², on maps that enter by nodes, and by their own points."""
    from scipy.special import j0

    amplitude, period = 50e-6, pixels * 2 * RADIUS / (count - 1) / RADIUS
    made = disc_map(lambda u, v: amplitude * np.sin(2 * np.pi * (v if way else u) / period + 0.3), count)
    light = wavefront(made, wavelength=RED, radius=RADIUS)
    assert light.strehl == pytest.approx(j0(4 * np.pi * amplitude / RED) ** 2, rel=0.01)
    assert light.rms == pytest.approx(2 * amplitude / math.sqrt(2), rel=0.005)


def test_source_may_be_anywhere():
    """A map, its design and its source moved together have the same wavefront; one on the surface is refused."""
    x = np.linspace(-RADIUS, RADIUS, 81)
    square = tw.HeightMap(x=x, y=x, z=50e-6 * (x / RADIUS) ** 2 * np.ones((81, 1)))
    paraboloid = tw.Conic(radius=20.0, conic=-1.0)
    still = wavefront(square, wavelength=RED, design=paraboloid, source=14.0)
    moved = wavefront(
        tw.HeightMap(x=x + 8, y=x - 3, z=square.z), wavelength=RED,
        design=paraboloid.placed(shift=(8.0, -3.0, 1.5)), source=(8.0, -3.0, 15.5),
    )  # fmt: skip
    assert moved.opd.z == pytest.approx(still.opd.z, abs=1e-15)
    with pytest.raises(InputError, match="source"):
        wavefront(polar_map(flat), wavelength=RED, design=paraboloid, source=0.0)


def test_scattered_light_lowers_the_image():
    light = wavefront(polar_map(flat), wavelength=RED, specular=0.9)
    assert light.strehl == pytest.approx(0.9)
    assert light.mtf(np.array([0.0, 100.0])).x == pytest.approx([1.0, 0.9 * (1 - 4 / np.pi * 100 * RED / 10)], rel=1e-6)


def test_bad_pupils_are_refused():
    small = disc_map(flat, 61)
    for changes, named in (
        ({"radius": 6.0}, "covers"),
        ({"wavelength": 0.0}, "wavelength"),
        ({"obscuration": 1.0}, "obscuration"),
        ({"index": 1.0}, "index"),
        ({"source": math.nan, "design": tw.Plane()}, "source"),
        ({"remove": "power"}, "remove"),
    ):
        with pytest.raises(InputError, match=named) as refused:
            wavefront(small, **{"wavelength": RED} | changes)
        assert len(str(refused.value)) <= 400
    points = tw.HeightMap(x=np.arange(9.0), y=np.arange(9.0) ** 2, z=np.zeros(9))
    with pytest.raises(InputError, match="grid"):
        wavefront(points, wavelength=RED)
    with pytest.raises(InputError, match="totally reflected"):
        wavefront(
            polar_map(flat), wavelength=RED, index=1.5, design=tw.Sphere(radius=-6.0), inside=True
        )  # fmt: skip
