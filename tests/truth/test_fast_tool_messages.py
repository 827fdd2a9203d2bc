"""Fast and hybrid tool servo: what is refused, in one sentence."""

import numpy as np
import pytest

import turnwright as tw

PLAN = tw.SlowToolServo(feed=0.02, spindle_rpm=60, points_per_rev=90)
TOOL = tw.Tool(nose_radius=0.1, included=np.deg2rad(100))
PART = tw.Part(surface=tw.Sphere(radius=5.0), radius=0.2)
FAST = tw.Axis(low=-0.035, high=0.035)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tw.FastToolServo(plan=0.02), "plan is 0.02, it must be a Strategy"),
        (lambda: tw.HybridToolServo(plan=None, fast=FAST), "plan is None"),
        (lambda: tw.HybridToolServo(plan=PLAN).spiral(PART, TOOL), "split by nothing"),
        (lambda: tw.HybridToolServo(plan=PLAN, tool=TOOL), "split by tool, it needs base and tool"),
        (lambda: tw.HybridToolServo(plan=PLAN, base=tw.Plane()).spiral(PART, TOOL), "split by base, it needs"),
        (lambda: tw.HybridToolServo(plan=PLAN, base=tw.Plane(), tool=TOOL, fast=FAST), "base and tool and fast"),
        (lambda: tw.HybridToolServo(plan=PLAN, base=5.0, tool=TOOL), "base is 5.0, it must be a Surface"),
        (lambda: tw.HybridToolServo(plan=PLAN, fast=0.07), "fast is 0.07, it must be a Axis"),
        (lambda: tw.HybridToolServo(plan=PLAN, fast=tw.Axis(high=0.1)), "travels from None to 0.1 mm"),
        (lambda: tw.HybridToolServo(plan=PLAN, fast=FAST, blocks_per_rev=4), "blocks_per_rev is 4"),
    ],
)
def test_what_cannot_work_is_refused_on_construction(make, words):
    with pytest.raises(tw.InputError) as caught:
        make()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_fast_tool_asks_for_a_steady_x_and_one_tool():
    fast = tw.FastToolServo(plan=PLAN)
    torus = tw.Part(surface=tw.Toroid(radius_x=5.0, radius_y=2.0), radius=0.2)
    normal = tw.place(fast.spiral(torus, TOOL), torus, TOOL, along="normal")
    with pytest.raises(tw.InputError, match="from a steady advance, the limit is 1e-09 mm"):
        fast.axes(normal)
    path = tw.place(fast.spiral(PART, TOOL), PART, TOOL)
    for servo in (tw.FastToolServo(plan=fast), tw.HybridToolServo(plan=fast, fast=FAST)):
        with pytest.raises(tw.InputError, match="which moves W itself"):
            servo.axes(path)


def test_a_machine_without_a_fast_tool_is_refused():
    fast = tw.FastToolServo(plan=PLAN)
    path = tw.place(fast.spiral(PART, TOOL), PART, TOOL)
    with pytest.raises(tw.LimitError, match=r"moves axis W, .* has C, X, Z"):
        tw.drive(path, fast, tw.Machine.load("nanoform"))


def test_both_ends_of_the_stroke_bind_the_slow_share():
    """A tool whose middle is not 0 is used about its own middle."""
    servo = tw.HybridToolServo(plan=PLAN, fast=tw.Axis(low=0.0, high=0.07))
    path = tw.place(servo.spiral(PART, TOOL), PART, TOOL)
    axes = servo.axes(path)
    assert 0.03 < axes["W"].mean() < 0.04
    assert axes["Z"] + axes["W"] == pytest.approx(path.z, abs=1e-15)
    outward = tw.SlowToolServo(feed=0.02, spindle_rpm=60, points_per_rev=90, inside_out=True, sense=-1)
    turned = tw.HybridToolServo(plan=outward, fast=FAST)
    path = tw.place(turned.spiral(PART, TOOL), PART, TOOL)
    axes, rates = turned.axes(path), turned.rates(path)
    differences = (axes["Z"][2:] - axes["Z"][:-2]) / (path.angle[2:] - path.angle[:-2])
    assert rates["Z"][1:-1] == pytest.approx(differences, abs=0.01 * np.abs(differences).max())
