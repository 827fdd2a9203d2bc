"""What a file states is the class itself: it is written as it is read, and changed by its path."""

import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest
import tomli_w
from hypothesis import given, strategies as st

import turnwright as tw
from job_files import changed, written
from laws import examples
from tests.laws.test_surface_laws import FAMILIES
from turnwright._tables import forget_adapters
from turnwright.errors import InputError, JobError
from turnwright.job import Job, Pipeline
from turnwright.strategy import STRATEGIES
from turnwright.units import Feed, Length, Size, Speed


@examples(60)
@given(st.data())
def test_a_surface_is_stated_to_the_last_bit(data):
    surface = data.draw(data.draw(st.sampled_from(list(FAMILIES.values()))))
    moved = surface.placed(shift=(0.1, -0.2, 1e-3), rotation=0.3)
    table = changed(("part.radius", "0.5 mm"), ("simulation", {}))
    job = Job.read(table)
    job = replace(job, part=replace(job.part, surface=moved + surface))
    assert Job.read(job.table()) == job


@pytest.mark.parametrize(
    ("name", "value", "place", "text"),
    [
        ("strategy.feed", 0.01, "strategy.feed", "10 um/rev"),
        ("strategy.spindle_speed", 100.0, "strategy.spindle_speed", "100 rpm"),
        ("passes.finish.spindle_speed", 100.0, "passes", [{"name": "finish", "spindle_speed": "100 rpm"}]),
        ("tool.offset[2]", 1e-3, "tool.offset", ["0 mm", "1 um", "0 mm"]),
        ("part.surface.radius", 40.0, "part.surface.radius", "40 mm"),
        ("simulation.patches.patch.pixel", 2e-3, "simulation.patches.0.pixel", "2 um"),
        ("simulation.patches[1].pixel", 2e-3, "simulation.patches.0.pixel", "2 um"),
        ("measurement.clocking", 0.0, "measurement.clocking", "0 deg"),
    ],
)
def test_a_field_is_changed_by_its_path_as_the_file_changes_it(name, value, place, text):
    """Oracle: the job of the file with this field changed."""
    job = Job.read(changed()).replace(name, value)
    assert job == Job.read(changed((place, text)))


def _leaves(table, path=""):
    """Every field of a table of a job with its path, as the file writes it."""
    if isinstance(table, dict):
        for key, value in table.items():
            yield from _leaves(value, f"{path}.{key}" if path else key)
    elif isinstance(table, list):
        for number, value in enumerate(table, 1):
            yield from _leaves(value, f"{path}[{number}]")
    else:
        yield path, table


WHOLE = Job.read(
    changed(
        ("measurement.instrument", "zygo-nexview-20x"),
        ("tool.waviness", ["0.1 um/rad", "-0.2 um/rad^2"]),
        ("tool.plausible", {"offset_x": "1 um"}),
        ("part.surface.placed", {"shift": ["0.1 mm", "0 mm", "0 mm"]}),
    )
)
FIELDS = [
    one
    for one in _leaves(WHOLE.table(whole=True))
    if one[0] not in ("machine.name", "measurement.instrument.name", "part.surface.family", "strategy.kind")
]


@pytest.mark.parametrize(("name", "value"), FIELDS)
def test_every_field_is_replaced_by_what_the_file_states_of_it(name, value):
    assert WHOLE.replace(name, value) == WHOLE


@pytest.mark.parametrize(
    "value", [None, "nix", 3, -1e9, True, float("nan"), float("inf"), (), {}, ("nix",), {"nix": 1}, b"nix"], ids=repr
)
def test_a_value_of_any_kind_makes_a_job_or_one_sentence(value):
    """No error of another kind, and no job that could not be written and read again."""
    for name in [name for name, _ in FIELDS] + ["part", "part.surface", "tool", "machine", "passes"]:
        try:
            job = WHOLE.replace(name, value)
        except JobError:
            continue
        assert Job.read(job.table()) == job, name


def test_changed_plan_field_of_a_fast_tool_changes_the_strategy():
    """Oracle: the job of the file with this field changed; its keys stand in one table."""
    fast = {"kind": "hybrid tool servo", "feed": "10 um/rev", "points_per_rev": 360}
    rest = [("machine", {"name": "nanoform-fts-70"}), ("program", {"fast_tool": "position"})]
    job = Job.read(changed(("strategy", fast), *rest))
    assert Job.read(job.table(whole=True)) == job
    for name, value, stated in (("feed", 0.02, "20 um/rev"), ("blocks_per_rev", 32, 32), ("sense", -1, -1)):
        again = Job.read(changed(("strategy", {**fast, name: stated}), *rest))
        assert job.replace(f"strategy.{name}", value) == again
    assert job.replace("strategy.feed", 0.02).strategy.plan == tw.SlowToolServo(feed=0.02, points_per_rev=360)


def test_a_coefficient_is_changed_by_its_key():
    terms = {"family": "xy polynomial", "units": "mm", "terms": {"2,0": 1e-3, "0,2": 2e-3}}
    job = Job.read(changed(("part.surface", terms))).replace("part.surface.terms.0,2", 3e-3)
    assert job.part.surface.terms == (((0, 2), 3e-3), ((2, 0), 1e-3))


def test_what_follows_from_a_changed_field_is_computed_again():
    array = {
        "family": "lens array", "layout": "square", "pitch": "0.5 mm", "rows": 2, "columns": 2,
        "lenslet": {"family": "sphere", "radius": "3 mm"},
    }  # fmt: skip
    job = Job.read(changed(("part.surface", array))).replace("part.surface.pitch", 0.6)
    np.testing.assert_allclose(np.ptp(job.part.surface.centres, axis=0), 0.6)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("strategy.fed", 0.01, "strategy.fed is not a field .*'feed'"),
        ("part.surface.conic", 0.0, "part.surface.conic is not a field"),
        ("tool.nose_radius", -1.0, r"tool\.nose_radius: -1\.0 is not above 0 mm"),
        ("part.stock", -1.0, r"part\.stock: -1\.0 is below 0 mm"),
        ("passes[1].allowance", 1.0, "allowance is 1 mm"),
        ("passes[2].allowance", 0.0, r"\[2\] is none of the 1 entries"),
        ("passes.rough.allowance", 0.0, "rough is none of the 1 entries"),
        ("machine.name", "nanoform", "selects another machine"),
        ("machine.loaded", None, "machine.loaded is not a field"),
        ("machine.dialect", "nix", "dialect 'nix' is not known, Turnwright writes"),
        ("machine.interpolation", "nix", "offers linear"),
        ("strategy.feed", "8 um", r"strategy\.feed: '8 um' is a length"),
        ("strategy.feed", float("nan"), r"strategy\.feed: nan is not a number"),
        ("strategy.feed", True, r"strategy\.feed: True has no unit"),
        ("strategy.kind", "fast tool servo", "strategy.kind cannot change alone: replace the whole strategy"),
        ("part.surface.family", "plane", r"part\.surface\.family cannot change alone: replace the whole part\.surface"),
        ("strategy.spindle_rpm", 100.0, "did you mean 'spindle_speed'"),
        ("roughness.form", "banana", "roughness.form: .* got 'banana'"),
        ("measurement.loss", "cubic", "measurement.loss is 'cubic', it must be 'linear'"),
        ("program.name", "a b", "program.name is 'a b'"),
        ("accept", ("nix",), r"accept\[1\] is 'nix'"),
        ("tool.plausible.nix", 1e-3, "tool.plausible.nix is not a field"),
        ("simulation.patches[1].pixel", 1.0, r"simulation\.patches\[1\]\.pixel: pixel must be at most .* got 1 mm"),
        ("machine.axes.X.speed", -1.0, r"machine\.axes\.X\.speed: .* is -1 mm/s"),
        ("measurement.instrument.pixel", 1e-3, "a table that the job does not state"),
        ("part.radius.inner", 1.0, "part.radius.inner is not a field"),
        ("", 1.0, r"passes\[1\]\.feed, got ''"),
        ("strategy..feed", 1.0, "a field is named like"),
        ("passes.[1].feed", 1.0, "a field is named like"),
    ],
)
def test_a_change_that_cannot_be_is_refused(name, value, words):
    with pytest.raises(InputError, match=words):
        Job.read(changed()).replace(name, value)


def test_a_machine_is_named_by_its_file_though_that_is_gone(tmp_path):
    """A job that was read does not look for its machine again when it is written."""
    shop = tmp_path / "shop"
    shop.mkdir()
    (shop / "lathe.toml").write_text('base = "generic"\nname = "shop"\nsquareness = "2 urad"\n')
    job = Job.load(written(shop, ("machine", {"file": "lathe.toml", "squareness": "5 urad"})))
    shutil.rmtree(shop)
    assert job.table()["machine"] == {"file": str(shop / "lathe.toml"), "squareness": "5 urad"}


def test_what_was_read_from_no_file_is_not_written():
    heights = tw.Gridded(x=np.linspace(-2, 2, 9), y=np.linspace(-2, 2, 9), z=np.zeros((9, 9)))
    job = Job.read(changed())
    with pytest.raises(InputError, match="write its heights to a file"):
        replace(job, part=replace(job.part, surface=heights)).to_toml()
    bent = replace(job.machine, straightness=([0.0, 1.0], [0.0, 1e-4]))
    with pytest.raises(InputError, match=r"a job names a straightness by its file"):
        replace(job, machine=bent).to_toml()
    machine = replace(job.machine, axes={**job.machine.axes, "X": tw.Axis(speed=1.0)})
    with pytest.raises(InputError, match="differs from its file"):
        replace(job, machine=machine).to_toml()


def test_a_family_that_is_added_is_stated_at_once(tmp_path):
    """One class in one file: no other table names its fields."""
    _ = Job.read(changed())

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Trough(tw.Surface):
        family = "trough"
        depth: Length
        width: Size = 1.0

        def evaluate(self, x, y, order):
            half = self.depth / self.width**2
            zero = np.zeros(y.shape)
            return (half * x * x, 2 * half * x, zero, np.full(x.shape, 2 * half), zero, zero)[: (1, 3, 6)[order]]

    try:
        path = tmp_path / "job.toml"
        path.write_text(tomli_w.dumps(changed(("part.surface", {"family": "trough", "depth": "2 um"}))))
        job = Job.load(path)
        assert job.part.surface == Trough(depth=2e-3)
        assert Job.read(job.table()) == job
        with pytest.raises(JobError, match=r"part\.surface\.dept is not a known key: did you mean 'depth'"):
            Job.read(changed(("part.surface", {"family": "trough", "dept": "2 um"})))
    finally:
        del tw.surface.FAMILIES["trough"]
        forget_adapters()


def test_a_strategy_that_is_added_is_stated_at_once():
    """One class in one file: no other table names its fields. Oracle: the slow tool servo at half the feed."""

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Halved(tw.strategy.Strategy):
        kind = "halved"
        pitch: Feed
        spindle_rpm: Speed | None = None

        def spiral(self, part, tool, *, progress=None):
            return tw.SlowToolServo(feed=self.pitch / 2, points_per_rev=120).spiral(part, tool, progress=progress)

        def axes(self, path):
            return {"C": path.angle, "X": path.radius, "Z": path.z}

    try:
        job = Job.read(changed(("strategy", {"kind": "halved", "pitch": "40 um/rev", "spindle_speed": "100 rpm"})))
        assert job.strategy == Halved(pitch=0.04, spindle_rpm=100.0)
        assert Job.read(job.table()) == job
        slow = job.replace("strategy", tw.SlowToolServo(feed=0.02, points_per_rev=120, spindle_rpm=100.0))
        found, wanted = (Pipeline(one).motion for one in (job, slow))
        for one in ("C", "X", "Z"):
            np.testing.assert_allclose(found.axes[one], wanted.axes[one], atol=1e-12)
        with pytest.raises(JobError, match=r"strategy\.pich is not a known key: did you mean 'pitch'"):
            Job.read(changed(("strategy", {"kind": "halved", "pich": "40 um/rev"})))
    finally:
        del STRATEGIES["halved"]
        forget_adapters()
