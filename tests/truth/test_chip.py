"""The uncut chip against circle geometry, dense brute force and the volume that is really removed."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

import turnwright as tw
from chip_oracle import brute, edge_of, layer, passes
from turnwright.cutting.chip import OrthogonalChip, RoundChip, chip_map

MACHINE = tw.Machine.load("generic")
CASES = {
    "flat": (tw.Plane(slope=(0.0, 0.0)), {}, {}),
    "tilted": (tw.Plane(slope=(0.1, -0.05)), {}, {}),
    "bowl": (tw.Sphere(radius=4.0), {}, {}),
    "dome": (tw.Sphere(radius=-6.0), {}, {}),
    "waves": (tw.SineGrid(amplitude=(2e-3, 1e-3), period=(1.5, 1.1)), {}, {}),
    "rake": (tw.Sphere(radius=20.0), {"rake": np.deg2rad(-25)}, {}),
    "wavy edge": (tw.Sphere(radius=20.0), {"waviness": (2e-4, 1e-3, -2e-3)}, {}),
    "inside out": (tw.Sphere(radius=20.0), {}, {"inside_out": True}),
    "other sense": (tw.SineGrid(amplitude=(2e-3, 1e-3), period=(1.5, 1.1)), {}, {"sense": -1}),
}


def cut(surface, *, feed=0.02, stock=0.004, tool=None, lift=0.0, radius=0.6, **servo):
    part = tw.Part(surface=surface, radius=radius, stock=stock)
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100), **(tool or {}))
    servo = tw.SlowToolServo(feed=feed, points_per_rev=72, spindle_rpm=60, lead_in=0.2, **servo)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, MACHINE)
    if lift:
        motion = replace(motion, axes={**motion.axes, "Z": motion.axes["Z"] + lift})
    return part, tool, motion


def blank(part, line, angle):
    height = part.surface.evaluate(line * np.cos(angle), line * np.sin(angle), 0)[0] + part.stock
    return np.where(np.abs(line) <= part.radius, height, -np.inf)


@pytest.mark.parametrize("name", CASES)
def test_chips_along_a_path_are_those_of_brute_force(name):
    surface, tool, servo = CASES[name]
    part, tool, motion = cut(surface, tool=tool, **servo)
    c = motion.axes["C"]
    some = np.unique(np.concatenate([np.arange(90, c.size, 397), [c.size - 3, c.size - 40]]))
    found = chip_map(motion, tool, part, points=some)
    line = np.linspace(-0.9, 0.9, 60_001)
    for row in range(0, some.size, max(1, some.size // 3)):
        i = some[row]
        area, thickest = brute(motion, tool, line, c[i], motion.sense * c[i], blank(part, line, c[i]))
        assert found.area[row] == pytest.approx(area, rel=5e-4, abs=6e-8)
        assert found.thickness[row] == pytest.approx(thickest, rel=5e-3, abs=2e-8)


@pytest.mark.parametrize("name", CASES)
def test_what_the_chips_of_a_line_add_up_to_is_what_was_removed(name):
    surface, tool, servo = CASES[name]
    part, tool, motion = cut(surface, tool=tool, **servo)
    along = motion.sense * motion.axes["C"]
    angle = motion.axes["C"][17]
    times = [one[0] for one in passes(motion, angle)]
    at = np.searchsorted(along, np.array(times) - 1e-7)
    # Points of the motion stand on this line, as 72 a turn is even.
    assert np.abs(along[at] - times).max() < 1e-9
    total = chip_map(motion, tool, part, points=at).area.sum()
    removed = removed_area(part, tool, motion, angle)
    assert total == pytest.approx(removed, rel=1e-9)


def removed_area(part, tool, motion, angle):
    """The area between blank and what is left, by Gauss-Legendre quadrature between all corners of both."""
    line = np.linspace(-part.radius, part.radius, 20_001)
    edge, tips = edge_of(tool), passes(motion, angle)
    # Which pass is lowest where: the corners between them by bisection.
    which = np.argmin(np.stack([z + edge(side * (line - p)) for _, p, z, side in tips]), axis=0)
    corners = [-part.radius, part.radius]
    for k in np.flatnonzero(np.diff(which)):
        a, b = line[k], line[k + 1]
        one, other = tips[which[k]], tips[which[k + 1]]
        for _ in range(60):
            m = (a + b) / 2
            if one[2] + edge(one[3] * (m - one[1])) < other[2] + edge(other[3] * (m - other[1])):
                a = m
            else:
                b = m
        corners.append(a)
    corners = np.unique(np.concatenate([corners, np.linspace(-part.radius, part.radius, 401)]))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    middle, half = (corners[1:] + corners[:-1]) / 2, np.diff(corners) / 2
    x = (middle[:, None] + half[:, None] * nodes).ravel()
    over = np.maximum(blank(part, x, angle) - layer(tips, edge, x), 0.0)
    return float((over.reshape(-1, 8) * weights).sum(axis=1) @ half)


def test_a_later_pass_takes_what_the_pass_before_left():
    surface = tw.Sphere(radius=20.0)
    part, tool, rough = cut(surface, feed=0.05, lift=0.002)
    _, _, finish = cut(surface, feed=0.01)
    c = finish.axes["C"]
    line = np.linspace(-0.9, 0.9, 120_001)
    some = np.arange(90, c.size, 311)
    found = chip_map(finish, tool, part, before=rough, points=some)
    edge = edge_of(tool)
    for row in range(0, some.size, max(1, some.size // 5)):
        i = some[row]
        left = layer(passes(rough, c[i]), edge, line)
        left[np.abs(line) > part.radius] = -np.inf
        area, thickest = brute(finish, tool, line, c[i], c[i], left)
        assert found.area[row] == pytest.approx(area, rel=5e-4, abs=6e-8)
        assert found.thickness[row] == pytest.approx(thickest, rel=5e-3, abs=2e-8)
    # And all that the pass before left goes.
    angle = c[17]
    times = [one[0] for one in passes(finish, angle)]
    total = chip_map(finish, tool, part, before=rough, points=np.searchsorted(c, np.array(times) - 1e-7)).area.sum()
    first = removed_area(part, tool, rough, angle)
    both = removed_area(part, tool, finish, angle)
    assert total == pytest.approx(both - first, rel=1e-9)


def test_the_map_of_a_flat_is_the_closed_form():
    part, tool, motion = cut(tw.Plane(slope=(0.0, 0.0)), feed=0.005, radius=0.8)
    x = motion.axes["X"]
    some = np.flatnonzero((x > 0.3) & (x < 0.6))[::50]
    found = chip_map(motion, tool, part, points=some)
    chip = RoundChip(nose_radius=0.5, feed=0.005, depth=0.004)
    np.testing.assert_allclose(found.thickness, chip.thickest, rtol=1e-10)
    np.testing.assert_allclose(found.area, chip.area, rtol=1e-11)
    np.testing.assert_allclose(found.width, chip.width, rtol=1e-10)
    np.testing.assert_allclose(-found.sweep_low, chip.sweep[1], rtol=1e-10)
    np.testing.assert_allclose(found.depth, 0.004, rtol=1e-12)
    np.testing.assert_allclose(found.rake, 0.0, atol=1e-12)


def test_round_chip_is_bounded_by_two_circles_and_the_stock():
    """Oracle: intersection of a ray with both, at 50 digits."""
    chip = RoundChip(nose_radius=1.0, feed=0.02, depth=0.01)
    with mpmath.workdps(50):
        for s in (-0.005, 0.0, 0.05, chip.corner - 1e-3, chip.corner + 1e-3, 0.135):
            at = mpmath.mpf(s)
            n = (mpmath.sin(at), -mpmath.cos(at))
            # From the centre: out of the last circle, centred f behind, and into the stock at depth d.
            f, d = mpmath.mpf(chip.feed), mpmath.mpf(chip.depth)
            last = -f * n[0] + mpmath.sqrt(1 - (f * n[1]) ** 2)
            stock = (1 - d) / mpmath.cos(at)
            exact = max(1 - max(last, stock), mpmath.mpf(0))
            assert float(chip.thickness(s)) == pytest.approx(float(exact), rel=1e-12, abs=1e-17)
        area = mpmath.quad(
            lambda t: (1 - (1 - mpmath.mpf(float(chip.thickness(float(t))))) ** 2) / 2,
            [chip.sweep[0], 0, chip.corner, chip.sweep[1]],
        )
    assert chip.area == pytest.approx(float(area), rel=1e-9)
    assert float(chip.thickness(chip.corner)) == pytest.approx(chip.thickest, rel=1e-13)


def test_the_error_of_the_usual_formula_is_as_stated():
    chip = RoundChip(nose_radius=1.0, feed=0.004, depth=0.01)
    s = np.linspace(0.01, chip.corner - 1e-6, 50)
    left_out = chip.thickness(s) - chip.nominal(s)
    np.testing.assert_allclose(left_out, (chip.feed * np.cos(s)) ** 2 / 2, rtol=1e-4)
    stated = chip.feed**2 * (1 - chip.depth) ** 2 / 2
    assert chip.nominal_thickest - chip.thickest == pytest.approx(stated, rel=0.02)


def test_an_oblique_edge_is_longer_and_its_chip_as_thick():
    chip = OrthogonalChip(thickness=4e-4, width=0.2, inclination=np.deg2rad(30))
    assert chip.edge_length == pytest.approx(0.2 / np.cos(np.deg2rad(30)), rel=1e-15)
    assert chip.area == pytest.approx(8e-5, rel=1e-15)
