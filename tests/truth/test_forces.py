"""Forces against closed form, mpmath, the published example and brute-force integration of every tooth."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

import turnwright as tw
from turnwright.cutting.chip import OrthogonalChip, RoundChip, chip_map
from turnwright.cutting.forces import FlyCut, SlotMill, chip_forces
from turnwright.errors import InputError
from turnwright.material import CriticalThickness, CuttingCoefficient, Lobes, Material

GLASS = Material.load("irg26")
PLAIN = Material(name="plain", cutting=CuttingCoefficient(value=1489.0), thrust=CuttingCoefficient(value=816.0))


@pytest.mark.parametrize("feed", [0.002, 0.004])
def test_the_published_example_comes_out(feed):
    """Troutman 2016: R 1 mm, depth 10 um, 2 um/rev; twice that at 4 um/rev. Printed to 0.01 mN and 1 nm."""
    chip = RoundChip(nose_radius=1.0, feed=feed, depth=0.010)
    forces, times = chip_forces(chip, GLASS, nominal=True), feed / 0.002
    assert forces.axial * 1e3 == pytest.approx(16.24 * times, abs=0.005 * times)
    assert forces.feed * 1e3 == pytest.approx(1.54 * times, abs=0.005 * times)
    assert forces.cutting * 1e3 == pytest.approx(29.78 * times, abs=0.005 * times)
    assert chip.nominal_thickest * 1e6 == pytest.approx(282 * times, abs=0.5 * times)
    assert forces.cutting_uncertainty == pytest.approx(forces.cutting * 62 / 1489, rel=1e-12)
    # The chip as it is: the same forces but for a cusp, and 2 nm thinner.
    exact = chip_forces(chip, GLASS)
    assert exact.cutting == pytest.approx(forces.cutting, rel=1e-4)
    assert exact.axial == pytest.approx(forces.axial, rel=1e-3)


@pytest.mark.parametrize(("radius", "feed", "depth"), [(1.0, 0.002, 0.01), (0.5, 0.03, 0.02), (3.0, 1e-4, 1e-3)])
def test_forces_of_constant_coefficients_are_the_closed_form(radius, feed, depth):
    chip = RoundChip(nose_radius=radius, feed=feed, depth=depth)
    forces = chip_forces(chip, PLAIN, nominal=True)
    end = np.arccos(1 - depth / radius)
    assert forces.cutting == pytest.approx(1489 * feed * depth, rel=1e-10)
    assert forces.axial == pytest.approx(816 * radius * feed * np.sin(end) ** 2 / 2, rel=1e-10)
    assert forces.feed == pytest.approx(816 * radius * feed * (end - np.sin(end) * np.cos(end)) / 2, rel=1e-10)
    exact = chip_forces(chip, PLAIN)
    assert exact.cutting == pytest.approx(1489 * chip.area, rel=1e-10)
    with mpmath.workdps(30):
        r, f, d = map(mpmath.mpf, (radius, feed, depth))
        reach = mpmath.sqrt(d * (2 * r - d))
        low, corner, high = -mpmath.asin(f / 2 / r), mpmath.atan2(reach - f, r - d), mpmath.atan2(reach, r - d)

        def share(s, part):
            inner = max(-f * mpmath.sin(s) + mpmath.sqrt(r**2 - (f * mpmath.cos(s)) ** 2), (r - d) / mpmath.cos(s))
            return 816 * (r**2 - inner**2) / 2 * part(s)

        axial, along = (
            mpmath.quad(lambda s, part=part: share(s, part), [low, corner, high]) for part in (mpmath.cos, mpmath.sin)
        )
    assert exact.axial == pytest.approx(float(axial), rel=1e-10)
    assert exact.feed == pytest.approx(float(along), rel=1e-10)


def test_forces_of_variable_coefficients_against_mpmath():
    falling = Material(
        name="falling",
        cutting=CuttingCoefficient(value=2000.0, exponent=0.3, reference_thickness=1e-4),
        thrust=CuttingCoefficient(value=900.0, exponent=0.2, reference_thickness=1e-4),
    )
    forces = chip_forces(RoundChip(nose_radius=1.0, feed=0.002, depth=0.01), falling, nominal=True)
    with mpmath.workdps(30):
        end = mpmath.acos(1 - mpmath.mpf("0.01"))
        thick = lambda s: mpmath.mpf("0.002") * mpmath.sin(s)  # noqa: E731
        cutting = mpmath.quad(
            lambda s: 2000 * (thick(s) / mpmath.mpf("1e-4")) ** mpmath.mpf("-0.3") * thick(s), [0, end]
        )
    assert forces.cutting == pytest.approx(float(cutting), rel=1e-5)


def test_beyond_the_critical_thickness_forces_per_width_stay():
    chip = OrthogonalChip(thickness=3e-3, width=0.2)
    assert chip_forces(chip, GLASS).cutting == pytest.approx(1489 * 600e-6 * 0.2, rel=1e-12)
    round_chip = RoundChip(nose_radius=1.5, feed=0.025, depth=0.025)
    s = np.linspace(*round_chip.sweep, 2_000_001)
    t = round_chip.thickness(s)
    brute = np.trapezoid(1489 * np.minimum(1, 600e-6 / np.maximum(t, 1e-12)) * t * (1.5 - t / 2), s)
    assert chip_forces(round_chip, GLASS).cutting == pytest.approx(brute, rel=1e-7)


def test_forces_drop_beyond_the_critical_chip_thickness():
    glass = replace(GLASS, brittle_force=(0.5, 0.3))
    forces = chip_forces(OrthogonalChip(thickness=3e-3, width=0.2), glass)
    assert forces.cutting == pytest.approx(0.5 * 1489 * 600e-6 * 0.2, rel=1e-12)
    assert forces.axial == pytest.approx(0.3 * 816 * 600e-6 * 0.2, rel=1e-12)
    assert chip_forces(OrthogonalChip(thickness=600e-6, width=1), glass).cutting == pytest.approx(1489 * 600e-6)
    chip = RoundChip(nose_radius=1.5, feed=0.025, depth=0.025)
    s = np.linspace(*chip.sweep, 2_000_001)
    t = chip.thickness(s)
    taken = np.where(t > 600e-6, 0.5 * 600e-6 / np.maximum(t, 1e-12), 1.0) * t * (1.5 - t / 2)
    assert chip_forces(chip, glass).cutting == pytest.approx(np.trapezoid(1489 * taken, s), rel=1e-6)
    for wrong in ((0.5,), (0.5, 1.5), (-0.1, 1.0)):
        with pytest.raises(InputError, match="brittle_force"):
            replace(GLASS, brittle_force=wrong)


def test_forces_along_a_path_are_those_of_the_round_chip():
    part = tw.Part(surface=tw.Plane(slope=(0.0, 0.0)), radius=0.8, stock=0.004)
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100))
    servo = tw.SlowToolServo(feed=0.005, points_per_rev=36, spindle_rpm=60, lead_in=0.2)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, tw.Machine.load("generic"))
    x = motion.axes["X"]
    some = np.flatnonzero((x > 0.3) & (x < 0.6))[::50]
    chip = RoundChip(nose_radius=0.5, feed=0.005, depth=0.004)
    # The plateau of the glass bends the integrand within a cell.
    # A drop makes it jump there, which the cells of the map meet with their own width.
    dropped = replace(GLASS, brittle_force=(0.5, 0.3))
    for material, rtol in ((PLAIN, 1e-9), (GLASS, 1e-5), (dropped, 3e-3)):
        found, steady = chip_map(motion, tool, part, material=material, points=some), chip_forces(chip, material)
        np.testing.assert_allclose(found.cutting, steady.cutting, rtol=rtol)
        np.testing.assert_allclose(found.axial, steady.axial, rtol=rtol)
        np.testing.assert_allclose(found.radial, steady.feed, rtol=2 * rtol)


def test_the_published_slot_peaks_at_its_force_across_the_feed():
    """Troutman 2016: 400 nm a tooth, 0.2 mm deep: peak Fx 127.5 mN."""
    record = SlotMill(radius=1.0, feed_per_tooth=400e-6, depth=0.2).forces(PLAIN, spindle_rpm=600)
    assert record.x.max() * 1e3 == pytest.approx(127.5, abs=0.05)
    assert record.x.max() == pytest.approx(400e-6 * 0.2 / 2 * (1489 + np.hypot(1489, 816)), rel=3e-4)
    assert record.engaged == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("corner", [0.0, 0.15, 0.5])
@pytest.mark.parametrize("teeth", [1, 2, 3])
def test_a_milling_record_is_that_of_brute_force(corner, teeth):
    """Oracle: strips of the edge at 4000 heights, whose chip is the distance of two shifted circles along a ray."""
    mill = SlotMill(radius=0.5, feed_per_tooth=0.002, depth=0.3, teeth=teeth, corner_radius=corner, entry=0.4, exit=2.5)
    record = mill.forces(PLAIN, spindle_rpm=60, samples=360)
    height = (np.arange(4000) + 0.5) / 4000 * 0.3
    step = 0.3 / 4000
    sine = np.ones(height.size)
    if corner:
        low = height < corner
        cosine = 1 - height[low] / corner
        sine[low] = np.sqrt(1 - cosine**2)
    for k in range(0, 361, 9):
        fx = fy = 0.0
        for tooth in range(teeth):
            phi = (2 * np.pi * k / 360 - 2 * np.pi * tooth / teeth) % (2 * np.pi)
            if not 0.4 <= phi <= 2.5:
                continue
            # A ray from the centre at phi leaves the circle of the tooth before, centred one feed behind.
            direction, centre = np.array([-np.cos(phi), np.sin(phi)]), np.array([0.0, -0.002])
            b = direction @ centre
            t = (0.5 - (b + np.sqrt(b * b - centre @ centre + 0.25))) * sine
            # Edge per height is 1 / sine; its normal has the radial share sine.
            along = (1489 * t / sine).sum() * step
            outward = (816 * t).sum() * step
            fx += along * np.sin(phi) - outward * np.cos(phi)
            fy += along * np.cos(phi) + outward * np.sin(phi)
        assert record.x[k] == pytest.approx(fx, rel=2e-4, abs=1e-9)
        assert record.y[k] == pytest.approx(fy, rel=2e-4, abs=2e-5)


def test_fly_cutting_removes_feed_times_step_times_depth():
    """Oracle: the volume of one swing in a long cut is feed x step x depth, less the cusps that stay."""
    fly = FlyCut(swing=20.0, nose_radius=1.0, feed=0.005, step=0.02, depth=0.01)
    phi = np.linspace(-0.001, fly.exit, 1501)
    s = np.linspace(-0.02, 0.16, 1501)
    t = fly.thickness(phi[:, None], s)
    volume = np.trapezoid(np.trapezoid(t * (1.0 - t / 2), s, axis=1), phi) * 20.0
    cusps = RoundChip(nose_radius=1.0, feed=0.02, depth=0.01).area
    assert volume == pytest.approx(0.005 * cusps, rel=2e-3)
    record = fly.forces(PLAIN, spindle_rpm=60)
    # Work of the cutting force over one swing is Kc times the volume.
    work = np.trapezoid(record.torque, record.angle)
    assert work == pytest.approx(1489 * volume, rel=2e-3)
    cutting = record.thickness > 0
    assert record.angle[cutting].min() == pytest.approx(np.pi, abs=2e-3)
    # Before the tool comes out of the stock, the groove of the line before has left nothing.
    assert np.pi + fly.exit / 3 < record.angle[cutting].max() < np.pi + fly.exit


def test_resultant_direction_and_power():
    forces = chip_forces(OrthogonalChip(thickness=1e-4, width=0.1), PLAIN)
    assert forces.resultant == pytest.approx(np.hypot(1489, 816) * 1e-5, rel=1e-12)
    assert forces.direction[0] == pytest.approx(np.arctan(816 / 1489), rel=1e-12)
    assert forces.power(1000.0) == pytest.approx(14.89, rel=1e-12)


def test_coefficients_of_a_crystal_go_round_with_it():
    crystal = Material(
        name="crystal",
        cutting=CuttingCoefficient(value=1000.0, lobes=Lobes(count=3, amplitude=0.2)),
        thrust=CuttingCoefficient(value=500.0),
        critical=CriticalThickness(value=1e-4, rake=(np.deg2rad([-40, 0]), [2.0, 1.0])),
    )
    angles = np.linspace(0, 2 * np.pi, 121)
    cutting, thrust = crystal.coefficients(5e-5, angle=angles)
    np.testing.assert_allclose(cutting, 1000 * (1 + 0.2 * np.cos(3 * angles)), rtol=1e-14)
    np.testing.assert_allclose(thrust, 500.0, rtol=1e-15)
    assert float(crystal.critical.at(rake=np.deg2rad(-20))) == pytest.approx(1.5e-4, rel=1e-12)
