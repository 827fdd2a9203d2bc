"""One rule for the numbers of every public class: finite, and whole where they count.

Oracle: the definition. Each number of an otherwise valid instance is replaced in turn, and the class must refuse it.
"""

import dataclasses
import importlib
import inspect
import math
import numbers
import pkgutil
import re
from collections.abc import Mapping

import numpy as np
import pytest

import turnwright as tw
from turnwright.chuck import Assembled
from turnwright.metrology import Nesting
from turnwright.post import Dialect
from turnwright.strategy import Valleys

PLANE, AXIS, X = tw.Plane(), tw.Axis(), np.linspace(0, 1, 5)
LOBES = tw.material.Lobes(count=3, amplitude=0.1, maximum=0.2)
CURVE = ((0.0, 0.1), (1.0, 1.1))
MACHINE = tw.Machine(
    name="t",
    axes=dict.fromkeys("CXYZ", AXIS),
    spindle_rpm=100.0,
    spindle_mode_rpm=2000.0,
    block_rate_hz=1e3,
    squareness=1e-6,
    straightness=((0.0, 1.0), (0.0, 1e-6)),
    plausible={"squareness": 1e-5},
)
TOOL = tw.Tool(
    nose_radius=0.5,
    included=2.0,
    rake=-0.1,
    clearance=0.2,
    waviness=(1e-6, 2e-6),
    radius_error=1e-4,
    offset=(1e-3, 1e-3, 1e-3),
    edge_length=0.1,
    shank=tw.Shank(radius=1.0, height=2.0, offset=(0.1, 0.1)),
    plausible={"offset x": 1e-3},
)
MILL = tw.cutting.SlotMill(radius=1.0, feed_per_tooth=1e-3, depth=0.1, teeth=2, corner_radius=0.5, entry=0.1, exit=1.0)
SLOW = tw.SlowToolServo(feed=0.01, spindle_rpm=50.0, points_per_rev=100, lead_in=0.1, overrun=0.002)
ARC = tw.SlowToolServo(feed=0.01, arc_length=0.1, max_step=0.1)
SWING = {"feed": 0.01, "spindle_rpm": 50.0, "lead_in": 0.1}
ADAPTIVE = tw.AdaptiveToolServo(scallop=1e-5, chord=1e-5, interpolation="linear", spindle_rpm=50.0)
RNG = np.random.default_rng(1)
RING = np.exp(-np.arange(128) / 4)
FAST = tw.Axis(low=-0.1, high=0.1)
JOB = tw.Job.read(
    {
        "part": {"surface": {"family": "plane"}, "radius": "0.5 mm"},
        "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
        "machine": {"name": "generic"},
        "strategy": {"kind": "slow tool servo", "feed": "50 um/rev", "points_per_rev": 24, "spindle_speed": "100 rpm"},
    }
)
SPREAD = tw.studies.Spread(kind="normal", numbers=(0.0, 1e-6), source="assumed")
SPECTRUM = np.linspace(0, 310, 32)

MOUNTED = tw.Mounted(
    name="A",
    surface=PLANE,
    outline=tw.Outline(disc=1.0),
    position=(2.0, 1.0),
    height=0.1,
    clocking=0.2,
    tilt=(0.1, 0.0),
)

EXAMPLES = [
    tw.Instrument(pixel=1e-3, numerical_aperture=0.3, wavelength=5e-4, filling=0.5, stylus_radius=1e-3, noise=1e-6),
    tw.Instrument(resolution=1e-3),
    JOB,
    tw.job.MachineDeviations(squareness=1e-6),
    PLANE,
    TOOL,
    MACHINE,
    LOBES,
    MILL,
    SLOW,
    ADAPTIVE,
    ARC,
    tw.SlowToolServo(feed=0.01, chord=1e-6),
    tw.Turning(
        feed=0.01, spindle_rpm=900.0, chord=1e-6, surface_speed=500.0, feed_mode="mm/rev", lead_in=0.1, overrun=0.002
    ),
    tw.path.SpindleMode(feed=0.01, spindle_rpm=900.0, surface_speed=500.0, per_rev=True),
    tw.surface.RadialTable(points=((0.0, 0.0), (1.0, 0.01), (2.0, 0.04), (3.0, 0.09), (4.0, 0.16))),
    tw.Tool(nose_radius=0.5, waviness=tw.WavinessTable(sweep=[-1, 0, 0.5, 1], deviation=[0, 1e-6, 0, 1e-6])),
    tw.WavinessTable(sweep=[-1, 0, 0.5, 1], deviation=[0, 1e-6, 0, 1e-6]),
    tw.Axis(
        speed=1.0,
        acceleration=1.0,
        jerk=1.0,
        low=0.0,
        high=1.0,
        bandwidth_hz=10.0,
        bandwidth_residual=1e-6,
        dead_time=1e-3,
    ),
    tw.Controller(look_ahead=3),
    tw.machine.Convention(clocking=0.3),
    tw.machine.SecondOrder(frequency_hz=30.0, damping=0.5, velocity_feedforward=0.9, acceleration_feedforward=0.9),
    tw.machine.FrequencyResponse(frequency_hz=[1, 2], magnitude=[1, 0.9], phase=[0, -0.1]),
    tw.machine.TransferFunction(numerator=[1.0], denominator=[1.0, 1.0]),
    tw.Sphere(radius=10.0),
    tw.Conic(radius=10.0, conic=-1.0),
    tw.EvenAsphere(radius=9.0, conic=0.0, terms={4: 1e-4}),
    tw.Toroid(radius_x=9.0, radius_y=8.0, conic=-0.5, terms={4: 1e-4}),
    tw.Biconic(radius_x=9.0, radius_y=8.0, conic_x=-1.0, conic_y=0.0),
    tw.XYPolynomial(terms={(2, 0): 1e-3}),
    tw.Zernike(terms={4: 1e-3}, radius=5.0, indexing="fringe"),
    tw.RadialPolynomial(radial=(1e-3,), slope=(1e-3,), tilt=0.01),
    tw.Forbes(radius=50.0, conic=0.0, norm_radius=5.0, kind="qbfs", terms={0: 1e-4}),
    tw.Forbes(radius=50.0, conic=0.0, norm_radius=5.0, kind="q2d", terms={(1, 1): 1e-4}),
    tw.SineGrid(amplitude=(1e-3, 1e-3), period=(1.0, 1.0), phase=(0.1, 0.1)),
    tw.LensArray(centres=[[0.0, 0.0], [1.0, 0.0]], lenslet=PLANE, aperture=0.3, surround=0.1),
    tw.LensArray.square(lenslet=PLANE, pitch=1.0, rows=2, columns=3, offset=(0.1, 0.1)),
    tw.LensArray.hexagonal(lenslet=PLANE, pitch=1.0, rings=2),
    tw.LensArray.hexagonal(lenslet=PLANE, pitch=1.0, within=4.0),
    tw.Expression("k*x", constants={"k": 1e-3}, feature_size=0.5),
    tw.Gridded(x=np.arange(7.0), y=np.arange(7.0), z=np.zeros((7, 7))),
    tw.Scattered(x=RNG.random(400), y=RNG.random(400), z=np.zeros(400)),
    tw.OffAxis(parent=tw.Conic(radius=10.0, conic=-1.0), distance=1.0, azimuth=0.1),
    tw.surface.Placed(surface=PLANE, shift=(0.1, 0.1, 0.1), rotation=0.1, tilt=(0.1, 0.1)),
    tw.surface.Sum(terms=(PLANE, PLANE)),
    tw.Pose(shift=(0.1, 0.1, 0.1), rotation=0.1, tilt=(0.1, 0.1)),
    tw.Blank(radius=2.0),
    TOOL.shank,
    tw.Outline(disc=2.0, centre=(1.0, 0.5)),
    tw.Outline(annulus=(2.0, 1.0)),
    tw.Outline(rectangle=(3.0, 2.0), angle=0.1),
    tw.Outline(polygon=((0.0, 0.0), (2.0, 0.0), (0.0, 2.0))),
    tw.Part(surface=PLANE, outline=tw.Outline(rectangle=(3.0, 2.0)), air_clearance=0.05),
    tw.Outline(several=(tw.Outline(disc=1.0), tw.Outline(disc=1.0, centre=(3.0, 0.0)))),
    MOUNTED,
    tw.Chuck(parts=(MOUNTED,)),
    Assembled(surfaces=(PLANE,), outlines=(tw.Outline(disc=1.0),), names=("A",)),
    tw.Part(surface=PLANE, radius=1.0, stock=0.1),
    tw.Spiral(angle=X, radius=X, y=X, radius_rate=X, y_rate=X, lift=X),
    tw.Path(
        angle=X,
        radius=X,
        z=X,
        sweep=X,
        contact_x=X,
        contact_y=X,
        contact_z=X,
        clearance=X,
        y=X,
        radius_rate=X,
        y_rate=X,
        z_rate=X,
        lift=X,
        air_height=X,
    ),
    tw.Motion(
        time=X,
        axes=dict.fromkeys("CXZ", X),
        velocity=dict.fromkeys("CXZ", X),
        machine=MACHINE,
        stated_blocks=np.arange(5),
    ),
    tw.SpeedProfile(radius=[0, 1], spindle_rpm=[50, 40]),
    tw.FastToolServo(plan=SLOW),
    tw.HybridToolServo(plan=SLOW, fast=FAST, blocks_per_rev=50),
    tw.QuasiEllipticalToolServo(**SWING, short="slow", y_acceleration=100.0, points_per_rev=100),
    tw.QuasiEllipticalToolServo(**SWING, short="merge", shortest=0.01, arc_length=0.1, max_step=0.1),
    Dialect(
        name="shop",
        decimals={"C": 4, "X": 5, "Z": 6},
        wrapped=False,
        feed="seconds",
        feed_decimals=7,
        feed_every_block=True,
        setup=("G71",),
        max_lines=1000,
        longest_block=10.0,
    ),
    Valleys(
        angle=X, azimuth=X, radius=X, slope_jump=X, residual_jump=X, is_at_rest=np.zeros(5, dtype=bool), stroke=0.1
    ),
    tw.HeightMap(x=X, y=X, z=np.zeros((5, 5))),
    tw.HeightMap(radius=X, angle=X, z=np.zeros((5, 5))),
    tw.Profile(distance=X, z=X, x=X, y=X),
    Nesting(s_filter=0.1, form="plane", l_filter=0.5, order=2),
    tw.material.CriticalThickness(value=1e-4, uncertainty=1e-5, rake=CURVE, lobes=LOBES),
    tw.material.CuttingCoefficient(
        value=1e3,
        uncertainty=10.0,
        exponent=0.1,
        reference_thickness=1e-4,
        thickness=((1e-4, 1e-3), (1.0, 0.9)),
        rake=CURVE,
        lobes=LOBES,
        stated=(1e-5, 1e-3),
    ),
    tw.Material(
        name="m",
        critical=tw.material.CriticalThickness(value=1e-4),
        brittle_plateau=True,
        brittle_force=(0.5, 0.6),
        fracture_ratio=3.0,
    ),
    tw.cutting.OrthogonalChip(thickness=1e-3, width=1.0, inclination=0.1),
    tw.cutting.RoundChip(nose_radius=0.5, feed=0.01, depth=0.01),
    tw.cutting.FlyCut(swing=50.0, nose_radius=1.0, feed=0.01, step=0.1, depth=0.02),
    tw.cutting.Vibration(amplitude=1e-6, frequency_hz=10.0, phase=0.1),
    tw.cutting.MinimumChip(thickness=1e-5, recovery=0.5),
    tw.cutting.Cuts(
        thickness=X,
        width=X + 1,
        cutting=X,
        thrust=X,
        area=X,
        thrust_area=X,
        uncertainty=np.ones((5, 2)),
        time=X,
        spread=X,
        record=np.zeros(5),
    ),
    tw.cutting.NoseCuts(
        nose_radius=X + 1,
        depth=X,
        feed=X,
        axial=X,
        feed_force=X,
        cutting=X,
        uncertainty=np.ones((5, 3)),
        time=X,
        record=np.zeros(5),
    ),
    tw.cutting.InterruptedCuts(
        geometry=(MILL,),
        spindle_rpm=(100.0,),
        components=("x",),
        force=np.zeros((5, 1)),
        begin=X,
        end=X + 1,
        cut=np.zeros(5, dtype=int),
        record=np.zeros(5, dtype=int),
        rate_hz=100.0,
    ),
    tw.cutting.ForceFit(components=("a",), thickness=X, measured=X[:, None], fitted=X[:, None]),
    tw.cutting.ForceHistory(time=X, angle=X, x=X, y=X, z=X, thickness=X, torque=X, speed=1.0),
    tw.cutting.ForceRecord(force=RNG.random((50, 1)), rate_hz=10.0, channels=("Fx",)),
    tw.cutting.TapTest(hammer=RING, direction=[0, 0, 1], response=np.stack([RING] * 3, axis=1), rate_hz=1e3),
    tw.cutting.Dynamometer(
        frequency_hz=SPECTRUM,
        response=np.tile(np.eye(3, dtype=complex), (32, 1, 1)),
        static_gain=np.eye(3),
        gain_uncertainty=np.zeros((3, 3)),
        coherence=np.ones((32, 3)),
    ),
    tw.diagnosis.ErrorSource(name="my own", signature=lambda cut: cut.x, typical=1e-3),
    tw.studies.ErrorBudget(errors={"squareness": SPREAD}, noise=1e-6, settling=3.0),
    SPREAD,
    tw.studies.Study(job=JOB, design="grid", fields=(), measures=(), reasons=("",), seconds=np.ones(1)),
    tw.studies.Store(place="/there"),
    tw.studies.Case(key="a", data={}),
    tw.post.ProgramHeader(design="a", tool="b", date="", notes=""),
]
"""Valid instances of every class that a user states; together they state every optional number."""

MAY = {
    "Path.air_height": ("nan", "where it cuts"),
    **dict.fromkeys(
        (
            "Sphere.radius",
            "Conic.radius",
            "EvenAsphere.radius",
            "Forbes.radius",
            "Toroid.radius_x",
            "Toroid.radius_y",
            "Biconic.radius_x",
            "Biconic.radius_y",
        ),
        ("inf", "a flat has no curvature"),
    ),
    **dict.fromkeys(("HeightMap.z", "Gridded.z", "Profile.z"), ("nan", "a height that was not measured")),
    "Study.seconds": ("nan", "a case that was not carried out"),
}
"""Numbers that may be infinite or missing, and what that means."""

ANSWERS = """
    CuspLight Modulation OpticalPerformance Order PointSpread Scatter Wavefront
    Access AccessFinding Alignment Approach AreaSpectrum Bands Bearing BestFit Candidate CentreDefect ChipMap Column
    Comparison Contribution Correction Cusps CuttingForces Diagnosis DialectCheck DrawnCut Draws DuctileCheck EdgeFit
    Blended CallOut Entry ErrorBreakdown Estimate Experiment FastToolFiles Features Filled Finding Finish ForceAverage
    FormComponents HeightFile IntactShare Bounded Continued LensFile LensPhase LensSide LensSurface
    LearnedMaterial Lenslet Lenslets Limits Measured Move Outcome OutlierRemoval PartShape Pass Plan PoseCandidate
    Prediction Preview ProfileRoughness ProgramFiles ProgramInfo ProgramPass Proof Registration Result Roughness
    Sensitivity Series Slopes Spectrum Stretch Tightening TiledMap ToleranceStudy Trial TurnedEdge TurningCentre
    ProgramStart ToolChange Undetermined Verdict ZernikeFit
"""
"""Classes that only functions make: there nan and infinity say what could not be found."""

NUMERIC = re.compile(
    r"\b(float|int|Floats|Ints|Complexes|Terms|Curve|Angle|Count|Feed|Length|Natural|Number|Radius|Size|Slope|Speed|Step"
    r"|Thickness|Waviness)\b"
)


def public_classes():
    """Return every dataclass that the package or one of its public modules names."""
    found = [getattr(tw, name) for name in tw.__all__]
    for module in pkgutil.iter_modules(tw.__path__, "turnwright."):
        if not module.name.rpartition(".")[2].startswith("_"):
            loaded = importlib.import_module(module.name)
            found += [getattr(loaded, name) for name in getattr(loaded, "__all__", ())]
    return {one.__name__: one for one in found if inspect.isclass(one) and dataclasses.is_dataclass(one)}


def replaced(value, put):
    """Yield copies of a value with one number in each replaced: of every kind of place one."""
    if isinstance(value, bool | str) or value is None:
        return
    if isinstance(value, numbers.Number):
        yield put
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fci" and value.size:
        changed = np.array(value, dtype=np.result_type(value, type(put)))
        changed.flat[value.size // 2] = put
        yield changed
    elif isinstance(value, tuple | list):
        for at, one in enumerate(value):
            for other in replaced(one, put):
                yield type(value)([*value[:at], other, *value[at + 1 :]])
    elif isinstance(value, Mapping):
        for key, one in value.items():
            rest = {name: held for name, held in value.items() if name != key}
            yield from ({**rest, key: other} for other in replaced(one, put))
            yield from ({**rest, other: one} for other in replaced(key, put))


def cases():
    for example in EXAMPLES:
        for field in dataclasses.fields(example):
            if field.init and any(True for _ in replaced(getattr(example, field.name), 1.0)):
                yield pytest.param(example, field, id=f"{type(example).__name__}.{field.name}")


def test_every_public_class_has_an_example():
    classes, stated = public_classes(), {type(one).__name__ for one in EXAMPLES}
    missing = classes.keys() - stated - set(ANSWERS.split())
    assert not missing, f"add an example instance of {sorted(missing)} (or name it among the answers of functions)"
    assert not set(ANSWERS.split()) & stated
    assert set(ANSWERS.split()) <= classes.keys()


def test_examples_state_every_number():
    stated = {}
    for one in EXAMPLES:
        for field in dataclasses.fields(one):
            if field.init and NUMERIC.search(str(field.type)) and "Callable" not in str(field.type):
                has = any(True for _ in replaced(getattr(one, field.name), 1.0))
                name = f"{type(one).__name__}.{field.name}"
                stated[name] = stated.get(name, False) or has
    assert not (missing := [name for name, has in stated.items() if not has]), f"state {missing} in an example"


@pytest.mark.parametrize(("example", "field"), list(cases()))
def test_numbers_that_no_thing_has_are_refused(example, field):
    name = f"{type(example).__name__}.{field.name}"
    value = getattr(example, field.name)
    allowed, _ = MAY.get(name, ("", ""))
    for put in (math.nan, math.inf, -math.inf):
        for bad in replaced(value, put):
            if allowed and allowed in str(put):
                dataclasses.replace(example, **{field.name: bad})
                continue
            with pytest.raises(tw.InputError) as refused:
                dataclasses.replace(example, **{field.name: bad})
            assert len(str(refused.value)) < 400
    if re.match(r"(int|Ints|tuple\[int, \.\.\.\])\b", str(field.type)):
        for bad in replaced(value, 2.5):
            with pytest.raises(tw.InputError, match=r"whole|integers"):
                dataclasses.replace(example, **{field.name: bad})
    if isinstance(value, Mapping | tuple) and "Terms" in str(field.type):
        for key in ((2.5, 0), (0, 2.5)) if isinstance(value[0][0], tuple) else (2.5, math.nan, math.inf):
            with pytest.raises(tw.InputError, match="whole"):
                dataclasses.replace(example, **{field.name: {key: 1e-6}})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["pitch", "within", "offset", "aperture"])
@pytest.mark.parametrize("make", [tw.LensArray.square, tw.LensArray.hexagonal])
def test_lattices_of_such_numbers_are_refused(make, name, bad):
    stated = {"pitch": 1.0, "within": 5.0, "offset": (0.0, 0.0), "aperture": 0.3, "surround": 0.0, "lenslet": PLANE}
    with pytest.raises(tw.InputError):
        make(**{**stated, name: (bad, 0.0) if name == "offset" else bad})


@pytest.mark.parametrize("bad", [2.5, math.nan, math.inf, True, "2"])
def test_lattices_count_in_whole_numbers(bad):
    with pytest.raises(tw.InputError, match="rows"):
        tw.LensArray.square(pitch=1.0, lenslet=PLANE, rows=bad, columns=2)
    with pytest.raises(tw.InputError, match="columns"):
        tw.LensArray.square(pitch=1.0, lenslet=PLANE, rows=2, columns=bad)
    with pytest.raises(tw.InputError, match="rings"):
        tw.LensArray.hexagonal(pitch=1.0, lenslet=PLANE, rings=bad)
