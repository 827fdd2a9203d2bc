"""Error messages of chips, forces and the ductile-mode check."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import InputError


def motion(part, tool):
    servo = tw.SlowToolServo(feed=0.05, points_per_rev=24, spindle_rpm=60, lead_in=0.2)
    return tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, tw.Machine.load("generic"))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tw.cutting.RoundChip(nose_radius=1.0, feed=0.002, depth=2.0), "depth must be below 1 mm"),
        (lambda: tw.cutting.RoundChip(nose_radius=1.0, feed=0.5, depth=0.01), "feed must be below 0.28"),
        (lambda: tw.cutting.RoundChip(nose_radius=-1.0, feed=0.5, depth=0.01), "give a positive value"),
        (
            lambda: tw.cutting.OrthogonalChip(thickness=1e-4, width=0.1, inclination=np.pi / 2),
            "the limits are -1.484 to 1.484 rad (-85 to 85 deg)",
        ),
        (lambda: tw.cutting.SlotMill(radius=1.0, feed_per_tooth=2.0, depth=0.1), "feed_per_tooth must be below 1 mm"),
        (lambda: tw.cutting.SlotMill(radius=1.0, feed_per_tooth=0.1, depth=0.1, teeth=0), "at least 1"),
        (
            lambda: tw.cutting.SlotMill(radius=1.0, feed_per_tooth=0.1, depth=0.1, entry=2.0, exit=1.0),
            "entry must be before exit",
        ),
        (
            lambda: tw.cutting.SlotMill(radius=1.0, feed_per_tooth=0.1, depth=0.1, corner_radius=2.0),
            "the limits are 0 to 1 mm",
        ),
        (
            lambda: tw.cutting.FlyCut(swing=1.0, nose_radius=5.0, feed=0.01, step=0.01, depth=2.0),
            "depth must be below 1 mm",
        ),
        (lambda: tw.material.Lobes(count=0, amplitude=0.1), "lobes count is 0, it must be a whole number, 1 to 24"),
        (lambda: tw.material.Lobes(count=3, amplitude=1.0), "of the mean"),
        (lambda: tw.material.CuttingCoefficient(value=float("nan")), "must be finite"),
        (lambda: tw.material.CuttingCoefficient(value=1.0, uncertainty=-1.0), "at least 0"),
        (lambda: tw.material.CuttingCoefficient(value=1.0, thickness=([0.0, 1.0], [1.0, 1.0])), "begin above 0 mm"),
        (lambda: tw.material.CriticalThickness(value=1e-4, rake=([0.0, -0.4], [1.0, 2.0])), "sort and complete it"),
        (lambda: tw.Material(name="a").coefficients(1e-4), "has no cutting coefficients"),
    ],
)
def test_cutting_values_out_of_range_are_refused(make, words):
    with pytest.raises(InputError) as error:
        make()
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_chip_map_refuses_unusable_inputs():
    part, tool = tw.Part(surface=tw.Sphere(radius=5.0), radius=0.5), tw.Tool(nose_radius=0.5)
    moved = motion(part, tool)
    with pytest.raises(InputError, match="stock must be above 0 mm"):
        tw.cutting.chip_map(moved, tool, part)
    with pytest.raises(InputError, match="points must be 0 to"):
        tw.cutting.chip_map(moved, tool, part, stock=0.004, points=[10**9])
    moving_y = tw.Motion(
        time=moved.time, axes={**moved.axes, "Y": np.full(moved.time.size, 1e-3)}, machine=moved.machine
    )
    with pytest.raises(InputError, match="Y of the motion must be 0 mm"):
        tw.cutting.chip_map(moving_y, tool, part, stock=0.004)
    chips = tw.cutting.chip_map(moved, tool, part, stock=0.004)
    with pytest.raises(InputError, match="states no critical thickness"):
        tw.cutting.check_ductile(chips, tw.Material.load("brass"), tool)


def test_no_points_are_no_chips():
    part, tool = tw.Part(surface=tw.Sphere(radius=5.0), radius=0.5, stock=0.004), tw.Tool(nose_radius=0.5)
    chips = tw.cutting.chip_map(motion(part, tool), tool, part, points=[])
    assert chips.thickness.size == 0
    assert chips.thickest == 0.0
