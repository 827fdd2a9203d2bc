"""What a user states is equal where its contents are, and can be hashed; whatever differs is not."""

import dataclasses
import math

import numpy as np
import pytest

import turnwright as tw

X = np.linspace(-2, 2, 9)
SCATTER = np.random.default_rng(1).uniform(-1, 1, (2, 300))


def table():
    z = 1e-3 * (X**2 + X[:, None] ** 2)
    z[0, 0] = np.nan
    return tw.Gridded(x=X, y=X, z=z)


def machine():
    axes = {
        "C": tw.Axis(speed=10.0),
        "X": tw.Axis(response=tw.machine.TransferFunction(numerator=[2.0], denominator=[1.0, 2.0])),
        "Z": tw.Axis(response=tw.machine.FrequencyResponse(frequency_hz=[1, 9], magnitude=[1, 0.5], phase=[0, -0.3])),
    }
    return tw.Machine(
        name="m",
        axes=axes,
        spindle_rpm=100.0,
        block_rate_hz=1e3,
        straightness=([0.0, 1.0], [0.0, 1e-6]),
        controller=tw.Controller(other_interpolations={"hermite": "pmac"}),
        sources={"axes": "a manual"},
    )


def tool():
    sweep = np.linspace(-1, 1, 9)
    return tw.Tool(nose_radius=0.5, waviness=tw.WavinessTable(sweep=sweep, deviation=1e-5 * np.sin(sweep)))


def lenses():
    return tw.LensArray.square(pitch=1.0, rows=2, columns=2, lenslet=tw.Sphere(radius=math.inf))


MAKES = {
    "lens array": (lenses, {"aperture": 0.3, "surround": 0.0}),
    "table": (table, {"x": X + 1e-9}),
    "points": (lambda: tw.Scattered(x=SCATTER[0], y=SCATTER[1], z=SCATTER[0] ** 2), {"z": SCATTER[1]}),
    "formula": (lambda: tw.Expression("k*x + a", constants={"k": 0.1, "a": 0.0}), {"constants": {"k": 0.2, "a": 0.0}}),
    "sum": (lambda: sum([lenses(), table(), tw.Plane()]), {"terms": (lenses(),)}),
    "placed": (lambda: table().placed(shift=(0.1, 0, 0)), {"rotation": 0.1}),
    "tool": (tool, {"waviness": ()}),
    "machine": (machine, {"sources": {}}),
    "material": (lambda: tw.Material.load("irg26"), {"notes": "another"}),
    "part": (lambda: tw.Part(surface=table(), radius=1.0), {"surface": lenses()}),
}


@pytest.mark.parametrize(("make", "change"), MAKES.values(), ids=MAKES)
def test_equal_contents_are_equal_and_hash_alike(make, change):
    one, same = make(), make()
    assert one == same
    assert hash(one) == hash(same)
    assert len({one, same}) == 1
    other = dataclasses.replace(one, **change)
    assert one != other
    assert len({one, other}) == 2
    assert one != "something else"


SPIRAL = tw.SlowToolServo(feed=0.05, points_per_rev=24, spindle_rpm=9.0).spiral


def motion():
    part, bare = tw.Part(surface=tw.Plane(), radius=0.5), tw.Tool(nose_radius=0.5)
    path = tw.place(SPIRAL(part, bare), part, bare)
    return tw.drive(path, tw.SlowToolServo(feed=0.05, points_per_rev=24, spindle_rpm=9.0), tw.Machine.load("generic"))


@pytest.mark.parametrize(
    ("make", "change"),
    [
        (lambda: SPIRAL(tw.Part(surface=tw.Plane(), radius=0.5), tool()), {"radius_rate": None}),
        (lambda: tw.HeightMap(x=X, y=X, z=table().z), {"z": np.zeros((9, 9))}),
        (lambda: tw.Profile(distance=X, x=X, y=X, z=X**2), {"z": X**3}),
        (motion, {"machine": tw.Machine.load("nanoform")}),
    ],
    ids=["spiral", "map", "profile", "motion"],
)
def test_large_values_compare_and_are_not_hashed(make, change):
    one, same = make(), make()
    assert one == same
    assert one != dataclasses.replace(one, **change)
    with pytest.raises(TypeError, match="unhashable"):
        hash(one)


def test_jobs_are_equal_where_their_tables_are():
    text = {
        "part": {"surface": {"family": "plane"}, "radius": "0.5 mm"},
        "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
        "machine": {"name": "generic"},
        "strategy": {"kind": "slow tool servo", "feed": "50 um/rev", "points_per_rev": 24, "spindle_speed": "9 rpm"},
    }
    one, same = tw.Job.read(text), tw.Job.read(text)
    assert one == same
    assert hash(one) == hash(same)
    assert one != tw.Job.read(text | {"machine": {"name": "nanoform"}})


def test_signs_of_zero_and_missing_heights_compare_equal():
    one, other = (tw.LensArray(centres=[[nought, 0.0]], lenslet=tw.Plane()) for nought in (0.0, -0.0))
    assert one == other
    assert hash(one) == hash(other)


def test_a_surface_of_no_dataclass_is_equal_to_itself():
    class Own(tw.Surface):
        def evaluate(self, x, y, order):  # noqa: ARG002
            return tuple(np.zeros_like(x) for _ in range((1, 3, 6)[order]))

    one = Own()
    assert one == one  # noqa: PLR0124
    assert one != Own()
    assert hash(one) == hash(one)
