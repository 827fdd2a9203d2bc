"""How fast the tip rises along its spiral, against closed forms and differences of the exact heights."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

from turnwright.part import Part
from turnwright.path import Spiral
from turnwright.placing import place, tip_height
from turnwright.strategy import SlowToolServo
from turnwright.surface import Biconic, LensArray, Plane, SineGrid, Sphere
from turnwright.tool import Tool

NOSE = Tool(nose_radius=0.5, included=np.deg2rad(120), clearance=np.deg2rad(20))


def spiral_of(sense=1, radius=4.0, feed=0.3, size=400):
    turned = np.linspace(0, 9, size)
    pitch = feed / (2 * np.pi)
    return Spiral(angle=sense * turned, radius=radius - pitch * turned, radius_rate=np.full(size, -sense * pitch))


@pytest.mark.parametrize("climb", [None, 0.02])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_round_nose_on_a_sphere_off_the_axis(sense, climb):
    """The rake plane cuts the sphere in a circle, in which the nose rolls: a closed form, differentiated by mpmath."""
    big, a, b = 30.0, 1.3, -0.7
    part = Part(surface=Sphere(radius=big).placed(shift=(a, b, 0.0)), radius=4.0)
    spiral = spiral_of(sense)
    if climb is not None:
        y = 0.3 + climb * (spiral.angle - spiral.angle[0])
        spiral = replace(spiral, y=y, y_rate=np.full(y.size, climb))
    path = place(spiral, part, NOSE)
    rate = spiral.radius_rate[0]

    def height(angle):
        turned = angle - spiral.angle[0]
        along = a * mpmath.cos(angle) + b * mpmath.sin(angle)
        across = b * mpmath.cos(angle) - a * mpmath.sin(angle) - (0 if climb is None else 0.3 + climb * turned)
        inside = mpmath.sqrt(big**2 - across**2) - NOSE.nose_radius
        return big - mpmath.sqrt(inside**2 - (spiral.radius[0] + rate * turned - along) ** 2) - NOSE.nose_radius

    with mpmath.workdps(40):
        for k in range(0, spiral.angle.size, 37):
            angle = mpmath.mpf(float(spiral.angle[k]))
            assert abs(path.z[k] - float(height(angle))) < 1e-12
            assert path.z_rate[k] == pytest.approx(float(mpmath.diff(height, angle)), abs=1e-11)
    if climb is not None:
        assert place(replace(spiral, y_rate=None), part, NOSE).z_rate is None


def differences(part, tool, spiral, chosen, step=2e-4):
    """Sixth-order differences of the tip's height along the spiral."""
    angle = spiral.angle[chosen, None] + step * np.arange(-3, 4)
    radius = spiral.radius[chosen, None] + spiral.radius_rate[0] * step * np.arange(-3, 4)
    z = tip_height(
        part.surface, tool, angle=angle.ravel(), radius=radius.ravel(), sense=spiral.sense, rim=part.radius + 1.0
    ).reshape(angle.shape)
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60
    lower = np.array([0, 1, -8, 0, 8, -1, 0]) / 12
    return z @ weights / step, np.abs(z @ (weights - lower)) / step


@pytest.mark.parametrize("tool", [NOSE, Tool(
    nose_radius=0.5, included=np.deg2rad(120), rake=np.deg2rad(-15), clearance=np.deg2rad(20),
    waviness=(0.0, 3e-4, 0.0, -2e-4), offset=(0.01, 0.02, 0.0),
)])  # fmt: skip
@pytest.mark.parametrize("radius", [-0.9, 0.9])
def test_on_lenslets_with_ridges_and_with_valleys(radius, tool):
    """Concave lenslets meet in ridges that the edge rides on, convex ones in valleys that it does not reach."""
    part = Part(surface=LensArray.square(lenslet=Sphere(radius=radius), pitch=0.7, rows=16, columns=16), radius=4.5)
    spiral = spiral_of(1, size=900)
    path = place(spiral, part, tool)
    chosen = np.arange(5, 895, 7)
    oracle, doubt = differences(part, tool, spiral, chosen)
    clean = doubt < 1e-8  # elsewhere a contact jumps or comes onto a ridge within the differences
    assert np.count_nonzero(clean) > 60
    across = part.surface.piece(path.contact_x - 1e-7, path.contact_y) != part.surface.piece(
        path.contact_x + 1e-7, path.contact_y
    )
    if radius > 0:
        assert np.count_nonzero(across[chosen][clean]) > 5
    assert np.abs(path.z_rate[chosen] - oracle)[clean].max() < 1e-8


def test_on_the_lip_of_a_step_too():
    """Lenses that stand proud of their surround: the edge rides on their rims, where the surface has no slope."""
    array = LensArray.square(
        lenslet=Sphere(radius=-0.9), pitch=0.7, rows=16, columns=16, aperture=0.3, surround=-0.2,
    )  # fmt: skip
    part, spiral = Part(surface=array, radius=4.5), spiral_of(1, size=3600)
    path = place(spiral, part, NOSE)
    from_centre = np.hypot(*((at / 0.7) % 1.0 - 0.5 for at in (path.contact_x, path.contact_y))) * 0.7
    lip = np.flatnonzero(np.abs(from_centre - 0.3) < 1e-9)
    lip = lip[(lip > 5) & (lip < 3590)]
    oracle, doubt = differences(part, NOSE, spiral, lip)
    smooth = doubt < 1e-6
    assert np.count_nonzero(smooth) > 100
    assert np.median(np.abs(oracle)) > 0.1
    assert np.abs(path.z_rate[lip] - oracle)[smooth].max() < 1e-5


def test_a_slow_tool_servo_states_its_rate():
    part = Part(surface=Plane(slope=(0.05, 0.0)), radius=1.0)
    for outward in (False, True):
        for sense in (1, -1):
            servo = SlowToolServo(feed=0.05, points_per_rev=90, inside_out=outward, sense=sense)
            path = place(servo.spiral(part, NOSE), part, NOSE)
            slope = np.gradient(path.radius, path.angle)
            assert path.radius_rate == pytest.approx(slope, rel=1e-9)
            tilt = 0.05 * (path.radius_rate * np.cos(path.angle) - path.radius * np.sin(path.angle))
            steep = np.sqrt(1 + (0.05 * np.cos(path.angle)) ** 2)
            lift = -0.5 * 0.05**2 * np.cos(path.angle) * np.sin(path.angle) / steep
            assert path.z_rate == pytest.approx(tilt + lift, abs=1e-13)


def test_no_rate_where_the_spiral_gives_none():
    part = Part(surface=Plane(), radius=1.0)
    spiral = Spiral(angle=np.linspace(0, 9, 50), radius=np.linspace(1, 0, 50))
    assert place(spiral, part, NOSE).z_rate is None


ALONG_NORMAL = {
    "sphere off the axis": Sphere(radius=-30.0).placed(shift=(1.3, -0.7, 0.0)),
    "waves on a torus": Biconic(radius_x=40.0, radius_y=-60.0, conic_x=0.3, conic_y=-1.0)
    + SineGrid(amplitude=(0.004, 0.003), period=(2.0, 2.7), phase=(0.4, 1.0)),
}


@pytest.mark.parametrize("climb", [None, 0.02])
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("surface", ALONG_NORMAL.values(), ids=ALONG_NORMAL)
@pytest.mark.parametrize("tool", [NOSE, Tool(
    nose_radius=0.5, included=np.deg2rad(120), rake=np.deg2rad(-15), clearance=np.deg2rad(20),
    waviness=(0.0, 3e-4, 0.0, -2e-4), offset=(0.01, 0.02, 0.003),
)])  # fmt: skip
def test_rates_along_the_normal_are_those_of_the_tips(surface, tool, sense, climb):
    """Against sixth-order differences of radius and height of tips that are placed a little before and behind."""
    part = Part(surface=surface, radius=4.0)
    step = 2e-4
    spiral = spiral_of(sense, radius=3.9, size=60)
    turned = spiral.angle[:, None] + sense * step * np.arange(-3, 4)
    outward = spiral.radius_rate[0]

    def at(angle):
        radius = spiral.radius[0] + outward * (angle - spiral.angle[0])
        y = None if climb is None else 0.3 + climb * (angle - spiral.angle[0])
        return replace(
            spiral, angle=angle, radius=radius, radius_rate=np.full(angle.size, outward), y=y,
            y_rate=None if y is None else np.full(angle.size, climb),
        )  # fmt: skip

    path = place(at(spiral.angle), part, tool, along="normal")
    near = place(at(turned.ravel()), part, tool, along="normal")
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60 / (sense * step)
    for rate, placed in ((path.radius_rate, near.radius), (path.z_rate, near.z)):
        np.testing.assert_allclose(rate, placed.reshape(turned.shape) @ weights, atol=1e-10)
    if climb is not None:
        unstated = place(replace(at(spiral.angle), y_rate=None), part, tool, along="normal")
        assert unstated.radius_rate is None
        assert unstated.z_rate is None


def test_a_nose_that_rolls_on_a_sphere_along_the_normal():
    """A sphere on the axis: the centre of the nose runs on a circle around the centre of the sphere, a closed form."""
    big, nose = -30.0, NOSE.nose_radius
    spiral = spiral_of()
    path = place(spiral, Part(surface=Sphere(radius=big), radius=4.0), NOSE, along="normal")
    assert path.radius_rate == pytest.approx(spiral.radius_rate * (1 - nose / big), rel=1e-12)
    slope = spiral.radius / np.sqrt(big**2 - spiral.radius**2) * np.sign(big)
    np.testing.assert_allclose(path.z_rate, slope * spiral.radius_rate * (1 - nose / big), atol=1e-14)
