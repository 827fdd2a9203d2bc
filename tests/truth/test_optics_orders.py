"""Diffraction orders of cusps and scatter against Fresnel integrals at 40 digits and closed forms."""

import math

import mpmath
import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import InputError
from turnwright.optics import cusp_orders, order_angles, path_factor, profile_orders, scatter, tis

RED = 633e-6


def fresnel_order(phase, order):
    """Return |F(k (1/2 - s)) - F(k (-1/2 - s))|² / k² at 40 digits."""
    with mpmath.workdps(40):
        phase = mpmath.mpf(phase)
        k, s = mpmath.sqrt(8 * phase / mpmath.pi), order * mpmath.pi / (4 * phase)

        def integral(v):
            return mpmath.fresnelc(v) + 1j * mpmath.fresnels(v)

        half = mpmath.mpf(1) / 2
        return float(abs(integral(k * (half - s)) - integral(k * (-half - s))) ** 2 / k**2)


@pytest.mark.parametrize(
    ("radius", "feed", "wavelength", "index"),
    [(0.514, 0.010, RED, None), (0.3, 0.05, RED, None), (5.0, 1e-3, 10.6e-3, None), (0.514, 0.010, 0.01, 2.4)],
)
def test_cusp_orders_of_fresnel_integrals(radius, feed, wavelength, index):
    with mpmath.workdps(40):
        factor = 2 if index is None else mpmath.mpf(index) - 1
        phase = 2 * mpmath.pi * mpmath.mpf(feed) ** 2 / (8 * mpmath.mpf(radius)) * factor / mpmath.mpf(wavelength)
    orders = [0, 1, 2, -3, 7, 30]
    made = cusp_orders(nose_radius=radius, feed=feed, wavelength=wavelength, orders=orders, index=index)
    assert made == pytest.approx([fresnel_order(phase, m) for m in orders], rel=1e-12)


def test_cusp_orders_stated_values():
    made = cusp_orders(nose_radius=0.514, feed=0.010, wavelength=RED, orders=[0, 1, 2])
    assert made == pytest.approx([0.9794648, 9.45632e-3, 6.18738e-4], rel=1e-6)
    assert cusp_orders(nose_radius=0.514, feed=0.010, wavelength=RED, orders=0).shape == ()


def test_cusp_orders_sum_to_one():
    made = cusp_orders(nose_radius=0.1, feed=0.02, wavelength=RED, orders=np.arange(-2000, 2001))
    assert made.sum() == pytest.approx(1.0, abs=1e-6)  # the tail of a slope discontinuity falls with m^-4


def test_cusps_on_a_curved_part():
    """A bowl of curvature 1/(2 R) halves the height of the cusps, f² (1/R - curvature) / 8."""
    flat = cusp_orders(nose_radius=1.0, feed=0.01, wavelength=RED, orders=[0, 1])
    assert cusp_orders(nose_radius=0.5, feed=0.01, wavelength=RED, orders=[0, 1], curvature=1.0) == pytest.approx(flat)


@pytest.mark.parametrize(
    ("index", "wavelengths", "transmitted", "reflected"),
    [
        (1.5, 2.5, 2.49736e-4, 3.96762e-3), (1.5, 4, 1.631830e-3, 2.533235e-2), (1.5, 6, 8.203461e-3, 0.1122783),
        (1.5, 10, 5.933579e-2, 0.2529066), (2.4, 2.5, 1.936670e-3, 3.93588e-3), (2.4, 6, 5.946423e-2, 0.1116239),
        (4.0, 2.5, 8.742676e-3, 3.90931e-3), (4.0, 4, 5.393683e-2, 2.497616e-2),
    ],
)  # fmt: skip
def test_orders_of_rigorous_theory(index, wavelengths, transmitted, reflected):
    """RCWA by meent 0.13.2, R + T = 1 to 1e-6, unpolarised; ``tests/proof/proof_rcwa.py`` computes the table."""
    radius, feed = 0.02, wavelengths * RED
    x = (np.arange(4000) + 0.5) / 4000 * feed - feed / 2
    cusps = radius - np.sqrt(radius**2 - x * x)
    for n, rigorous in ((index, transmitted), (None, reflected)):
        scalar = profile_orders(cusps, wavelength=RED, orders=1, index=n)
        assert float(scalar) == pytest.approx(rigorous, rel=0.0105)


@pytest.fixture(scope="module")
def turned():
    part = tw.Part(surface=tw.Plane(), radius=2.0)
    tool = tw.Tool(nose_radius=0.514, clearance=np.deg2rad(10), included=np.deg2rad(60))
    servo = tw.SlowToolServo(feed=0.010, spindle_rpm=50, points_per_rev=360)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool, along="z"), servo, tw.Machine.load("generic"))
    return motion, tool


def test_orders_of_simulated_cusps(turned):
    """Round cusps: the closed form differs by f²/(8 R²) in the height, these values are from quadrature of a circle."""
    made = tw.generate(*turned, x=1 + np.arange(4000) * 2.5e-6, y=np.array([0.0, 1e-6]))
    orders = profile_orders(made.z[0], wavelength=RED, orders=[0, 1, 2])
    assert orders == pytest.approx([0.9794640, 9.45666e-3, 6.18787e-4], rel=1e-5)
    scattered = 1 - float(orders[0])
    assert scattered == pytest.approx(0.020536, rel=1e-4)
    assert scattered == pytest.approx(float(tis(sq=7.25e-6, wavelength=RED)), rel=2e-3)
    s = 4 * math.pi * 7.25e-6 / RED  # the kurtosis of a cusp adds s^4 / 14
    assert scattered - float(tis(sq=7.25e-6, wavelength=RED)) == pytest.approx(s**4 / 14, rel=0.15)


def test_scatter_of_a_turned_patch(turned):
    """At 1.9 mm from the axis the grooves are nearly straight: orders at 1/feed, as in closed form."""
    patch = tw.generate(*turned, x=1.6 + np.arange(2001) * 0.1e-3, y=-0.01 + np.arange(21) * 1e-3)
    marks = scatter(patch, wavelength=RED)
    first, second, *_ = marks.orders()
    assert {round(abs(one.frequency[0]), 1) for one in (first, second)} == {100.0}
    assert first.angle == pytest.approx(math.asin(RED / 0.010), rel=1e-3)
    assert first.efficiency == pytest.approx(9.45666e-3, rel=2e-3)
    assert marks.tis == pytest.approx(0.020536, rel=2e-3)


def test_scatter_of_a_sine_is_bessel():
    """A sine of amplitude a has the orders J_m(2 k a)²."""
    from scipy.special import jv

    x, period, amplitude = np.arange(2048) * 1e-3, 0.0371, 30e-6
    heights = amplitude * np.sin(2 * np.pi / period * (0.8 * x + 0.6 * x[:128, None]))
    marks = scatter(tw.HeightMap(x=x, y=x[:128], z=heights), wavelength=RED, form="mean")
    depth = 4 * math.pi * amplitude / RED
    assert marks.specular == pytest.approx(jv(0, depth) ** 2, rel=1e-3)
    for one, m in zip(marks.orders(4), (1, 1, 2, 2), strict=True):
        assert one.efficiency == pytest.approx(jv(m, depth) ** 2, rel=1e-3)
        assert math.hypot(*one.frequency) == pytest.approx(m / period, rel=1e-3)
        assert one.frequency[1] / one.frequency[0] == pytest.approx(0.75, abs=0.02)


def test_bsdf_of_a_smooth_random_surface():
    """White heights of rms s below 1/50 wave: 16 pi²/lambda^4 times their PSD, s² over the band's area."""
    random = np.random.default_rng(3)
    pixel, sq = 1e-3, 1e-6
    x = np.arange(512) * pixel
    patch = tw.HeightMap(x=x, y=x, z=sq * random.standard_normal((512, 512)))
    angle, bsdf = scatter(patch, wavelength=RED, form="mean").bsdf(bins=3)
    expected = (4 * math.pi / RED**2) ** 2 * sq**2 * pixel**2
    assert bsdf == pytest.approx(np.full(3, expected), rel=0.03)
    assert angle.max() < math.asin(RED / (2 * pixel))


def test_path_factor_of_snell():
    """Light in reverse crosses with the same gain; at the critical angle the ray grazes."""
    outside = np.linspace(0, 1.4, 8)
    inside = np.arcsin(np.sin(outside) / 1.5)
    assert path_factor(index=1.5, incidence=outside) == pytest.approx(
        path_factor(index=1.5, incidence=inside, inside=True), abs=1e-14
    )
    assert np.isnan(path_factor(index=1.5, incidence=0.8, inside=True))
    assert path_factor(incidence=np.pi / 3) == pytest.approx(-1.0)


def test_order_angles_of_the_grating_equation():
    angle = order_angles(2e-3, wavelength=RED, orders=[-3, 0, 2, 4], index=1.5, incidence=0.2)
    assert 1.5 * np.sin(angle[:3]) == pytest.approx(math.sin(0.2) + np.array([-3, 0, 2]) * RED / 2e-3)
    assert order_angles(2e-3, wavelength=RED, orders=4).item() != order_angles(2e-3, wavelength=RED, orders=4).item()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"wavelength": 633.0}, "wavelength"),
        ({"feed": 2.0}, "feed"),
        ({"orders": [0.5]}, "orders"),
        ({"index": 0.9}, "index"),
        ({"incidence": 45.0}, "incidence"),
        ({"curvature": 3.0}, "curvature"),
    ],
)
def test_cusp_orders_refuse_what_cannot_be(changes, named):
    values = {"nose_radius": 0.514, "feed": 0.01, "wavelength": RED, "orders": [0]} | changes
    with pytest.raises(InputError, match=named) as refused:
        cusp_orders(**values)
    assert len(str(refused.value)) <= 400
