"""What a study says to fields, values and measures that are wrong, before anything is computed."""

from concurrent.futures import Executor

import numpy as np
import pytest
from scipy import stats

import turnwright as tw
from turnwright.errors import InputError, UnitError
from turnwright.job import Job
from turnwright.studies import study
from turnwright.studies.designs import design_cases, get_job_value, read_varied
from turnwright.studies.fields import apply_changes, find_field, get_job_data
from turnwright.studies.measures import measure_of

DATA = {
    "part": {
        "surface": [
            {"family": "conic", "radius": "50 mm", "conic": -1},
            {"family": "zernike", "terms": {"5": "2 um"}, "radius": "2 mm", "indexing": "fringe"},
        ],
        "radius": "2 mm",
        "stock": "50 um",
    },
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 360},
    "passes": [{"name": "rough", "feed": "20 um/rev", "allowance": "5 um"}, {"name": "finish"}],
    "simulation": {
        "patches": [{"name": "axis", "centre": ["0 mm", "0 mm"], "size": ["0.1 mm", "0.1 mm"], "pixel": "1 um"}],
    },
}


@pytest.fixture(scope="module")
def job():
    return Job.read(DATA)


def with_one(job, name, given):
    varied = read_varied(job, name, given)
    return Job.read(apply_changes(get_job_data(job), [(varied.field, varied.unit, varied.values[0])]))


@pytest.mark.parametrize(
    ("name", "given", "value"),
    [
        ("tool.nose_radius", "0.4 mm", lambda job: job.tool.nose_radius == 0.4),
        ("tool.nose_radius", [0.4], lambda job: job.tool.nose_radius == 0.4),
        ("tool.nose_radius", np.array([0.4]), lambda job: job.tool.nose_radius == 0.4),
        ("tool.waviness[3]", "3e-3 mm/rad^3", lambda job: job.tool.waviness == (0, 0, 3e-3)),
        ("actual.tool.offset[1]", "2 um", lambda job: job.actual.tool.offset == (0.002, 0, 0)),
        ("actual.machine.squareness", "2 um/m", lambda job: job.actual.machine.squareness == 2e-6),
        ("part.surface[1].conic", "-1.1", lambda job: job.part.surface.terms[0].conic == -1.1),
        ("part.surface.terms[1].radius", "40 mm", lambda job: job.part.surface.terms[0].radius == 40),
        (
            "part.surface[2].terms.5",
            "3 um",
            lambda job: dict(job.part.surface.terms[1].terms)[5] == pytest.approx(0.003),
        ),
        (
            "part.surface[2].terms.9",
            "30 nm",
            lambda job: dict(job.part.surface.terms[1].terms)[9] == pytest.approx(3e-5),
        ),
        ("passes.rough.feed", "30 um/rev", lambda job: job.passes[0].feed == 0.03),
        ("passes[2].points_per_rev", "720", lambda job: job.passes[1].points_per_rev == 720),
        ("simulation.patches.axis.centre[2]", "5 um", lambda job: job.simulation.patches[0].centre == (0, 0.005)),
        ("simulation.whole_part.radii", "100", lambda job: job.simulation.whole_part.radii == 100),
        ("strategy.spindle_speed", "70 rpm", lambda job: job.strategy.spindle_rpm == 70),
        ("strategy.sense", "-1", lambda job: job.strategy.sense == -1),
        ("strategy.along", "normal", lambda job: job.strategy.along == "normal"),
        ("strategy.inside_out", "true", lambda job: job.strategy.inside_out),
        ("roughness.form", "3", lambda job: job.roughness.form == 3),
        ("machine.name", "nanoform", lambda job: job.machine == tw.Machine.load("nanoform")),
    ],
)
def test_any_field_of_the_job_can_be_varied(job, name, given, value):
    assert value(with_one(job, name, given))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tool.nosradius", "tool.nosradius is not a field of this job: did you mean tool.nose_radius?"),
        ("strategy.spindle_rpm", "did you mean strategy.spindle_speed?"),
        ("passes.finsh.feed", "did you mean passes.finish?"),
        ("passes[7].feed", "passes has rough, finish, use one of them"),
        ("simulation.patches", "simulation.patches is a list: vary one of its values, such as simulation.patches.axis"),
        ("tool", "tool is a table: vary one of its values, such as tool.nose_radius"),
        ("tool.nose_radius[1]", "has no fields: vary tool.nose_radius itself"),
        ("actual.tool.offset[4]", "actual.tool.offset has [1] to [3], use one of them"),
        ("actual.tool.offset[0]", "actual.tool.offset has [1] to [3], use one of them"),
        ("actual.tool.offset.0", "actual.tool.offset has [1] to [3], use one of them"),
        ("actual.tool.offset[1", "is not a field of this job"),
        ("passes..feed", "is not a field of this job"),
    ],
)
def test_a_field_that_is_not_there_is_named_with_the_nearest(job, name, message):
    with pytest.raises(InputError) as error:
        find_field(job, name)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("tool.nose_radius", "0.1..1 um/rev:3", "'1 um/rev' is a feed per revolution, it must be a length"),
        ("tool.nose_radius", "0.1..1:3", "'1' has no unit, it must be a length"),
        ("tool.nose_radius", "-1..1 mm:3", "tool.nose_radius: '-1.0 mm' is not above 0 mm: give a larger value"),
        ("tool.nose_radius", "0,5 mm", "a comma between digits, which may separate values or be a decimal comma"),
        ("tool.nose_radius", "1 mm..2 um:3", "has two units, 'mm' and 'um': write one, at the end"),
        ("tool.nose_radius", "1..1 mm:3", "has no width: give two different ends"),
        ("tool.nose_radius", "1..2 mm:1", "has 1 values, it needs from 2 to"),
        ("tool.nose_radius", "1..2..3 mm", "is not a range: write it such as '0.1..1 mm:10'"),
        ("tool.nose_radius", "wide", "cannot be 'wide': write one number and one unit"),
        ("tool.nose_radius", "0..1 mm:3 log", "is logarithmic and reaches 0, it must be above 0"),
        ("tool.nose_radius", "normal(0.5, 0) mm", "has no spread: give a deviation above 0"),
        ("tool.nose_radius", "uniform(1, 0.5) mm", "does not ascend between two finite numbers: give the lower"),
        ("tool.nose_radius", "uniform(1, 1e400) mm", "does not ascend between two finite numbers"),
        ("tool.nose_radius", "normal(0.5, 1e400) mm", "has no spread: give a deviation above 0"),
        ("strategy.points_per_rev", "100.2..100.8", "takes whole numbers, 100.2 to 100.8 has none: widen the range"),
        ("tool.nose_radius", [], "is varied over 0 values: give at least 1"),
        ("tool.nose_radius", [None], "cannot be None: give numbers, or texts with a unit"),
        ("strategy.points_per_rev", "100..200:4", "takes whole numbers, '100..200:4' holds 133.333: choose"),
        ("strategy.points_per_rev", "100 mm", "takes a plain number, '100 mm' has the unit 'mm': leave it out"),
        ("strategy.points_per_rev", "-5", "strategy.points_per_rev is -5, it must be at least 1: increase it"),
        ("strategy.along", "z, sideways", "strategy.along is 'sideways', it must be 'z' or 'normal'"),
        ("strategy.along", stats.norm(), "is not a number, so it has no distribution: give a list of its values"),
        ("simulation.tracking", "yes", "simulation.tracking is 'yes', it must be true or false"),
        ("strategy.feed", "-1..1 mm/min:3", "strategy.feed: -1.0 mm/min is not above 0 mm/min: give a larger value"),
    ],
)  # fmt: skip
def test_values_that_are_wrong_are_refused_in_one_sentence(job, name, given, message):
    with pytest.raises(InputError) as error:
        read_varied(job, name, given)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_values_are_those_of_exact_decimals(job):
    assert read_varied(job, "tool.nose_radius", "0.1..1 mm:10").values == (
        0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0,
    )  # fmt: skip
    assert read_varied(job, "strategy.feed", "2, 4 um/rev, 0.01 mm/rev").values == (0.002, 0.004, 0.01)
    np.testing.assert_allclose(
        read_varied(job, "strategy.feed", "1..100 um/rev:3 log").values, (1, 10, 100), rtol=1e-15
    )


def test_value_of_the_job_is_given_in_the_requested_unit(job):
    assert get_job_value(job, read_varied(job, "tool.nose_radius", "400, 500 um")) == 500
    assert get_job_value(job, read_varied(job, "part.surface[2].terms.5", "1, 3 um")) == pytest.approx(2)
    assert get_job_value(job, read_varied(job, "actual.tool.radius_error", "1 um")) is None
    assert get_job_value(
        with_one(job, "strategy.spindle_speed", "50 rpm"), read_varied(job, "strategy.feed", "1 mm/min")
    ) == (pytest.approx(0.5))


def test_feed_per_minute_is_divided_by_the_speed_of_its_case(job):
    names = {"strategy.feed": "0.3, 0.6 mm/min", "strategy.spindle_speed": "50, 150 rpm"}
    fields, rows = design_cases(job, [read_varied(job, name, given) for name, given in names.items()])
    feeds = []
    for row in rows:
        changes = [(one.field, one.unit, token) for one, token in zip(fields, row, strict=True)]
        feeds.append(Job.read(apply_changes(get_job_data(job), changes)).strategy.feed)
    assert feeds == [0.3 / 50, 0.3 / 150, 0.6 / 50, 0.6 / 150]
    with pytest.raises(InputError, match=r"states no single spindle speed to divide it by: state or vary"):
        design_cases(job, [read_varied(job, "strategy.feed", "0.3, 0.6 mm/min")])


@pytest.mark.parametrize("design", ["random", "sobol", "halton", "latin hypercube"])
def test_a_drawn_design_keeps_to_its_ranges_and_distributions(job, design):
    names = {
        "tool.nose_radius": "0.2..0.8 mm", "actual.tool.offset[1]": "normal(1, 0.5) um", "strategy.sense": "1, -1",
        "strategy.points_per_rev": "300..500", "strategy.feed": stats.uniform(0.002, 0.006),
    }  # fmt: skip
    varied = [read_varied(job, name, given) for name, given in names.items()]
    fields, rows = design_cases(job, varied, design=design, count=500, seed=3)
    nose, offset, sense, points, feed = (np.array(values) for values in zip(*rows, strict=True))
    assert len(rows) == 500
    assert (fields[1].name, fields[1].unit) == ("actual.tool.offset[1]", "um")
    assert nose.min() >= 0.2
    assert nose.max() <= 0.8
    # Kolmogorov and Smirnov as the oracle of the distributions: SciPy's.
    assert stats.kstest(nose, stats.uniform(0.2, 0.6).cdf).pvalue > 1e-3
    assert stats.kstest(offset, stats.norm(1, 0.5).cdf).pvalue > 1e-3
    assert stats.kstest(feed, stats.uniform(0.002, 0.006).cdf).pvalue > 1e-3
    assert 200 < np.count_nonzero(sense == 1) < 300
    assert points.dtype.kind == "i"
    assert design_cases(job, varied, design=design, count=500, seed=3)[1] == rows


@pytest.mark.parametrize("design", ["random", "sobol", "halton", "latin hypercube"])
def test_every_whole_number_of_a_range_is_drawn_as_often(job, design):
    _, rows = design_cases(
        job, [read_varied(job, "strategy.points_per_rev", "100..104")], design=design, count=4096, seed=1
    )
    values, often = np.unique([row[0] for row in rows], return_counts=True)
    assert values.tolist() == [100, 101, 102, 103, 104]
    # The chi-squared test as the oracle: SciPy's.
    assert stats.chisquare(often).pvalue > 1e-3
    field = read_varied(job, "strategy.points_per_rev", "100..104")
    assert field.at(np.array([0.0, 1.0])) == [100, 104]


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"design": "sobol"}, "the design 'sobol' needs a number of cases, 1"),
        ({"design": "soboll", "count": 3}, "design is 'soboll', it must be grid, random, sobol"),
        ({"count": 3}, "the values of a grid set the number of its cases, 3 are requested"),
        ({"vary": {"tool.nose_radius": "0.1..1 mm"}}, "has no single values for a grid: write their number"),
        ({"vary": {}}, "nothing is varied: name at least 1 field"),
        (
            {"vary": {"passes[1].feed": "1 um/rev", "passes.rough.feed": "2 um/rev"}},
            "is varied 2 times, the limit is 1",
        ),
        ({"vary": {"strategy.feed": "1..2 um/rev:2000", "tool.nose_radius": "1..2 mm:2000"}}, "4_000_000 cases"),
        (
            {"vary": None, "design": [{"strategy.feed": "1 um/rev"}, {"tool.nose_radius": "1 mm"}]},
            "case 2 of the list has tool.nose",
        ),
        ({"vary": None, "design": []}, "the list of cases is empty"),
        ({"vary": None, "design": [3]}, "case 1 of the list is 3: write a mapping from fields to values"),
        ({"design": [{"tool.nose_radius": "1 mm"}]}, "and strategy.feed is varied as well: leave one out"),
        (
            {"design": "random", "count": 2.5},
            "the number of cases of the design 'random' is 2.5, it must be a whole number, 1 to",
        ),
        ({"design": "halton", "count": 2, "seed": -1}, "the seed is -1, it must be a whole number, at least 0"),
        ({"measure": "sq"}, "'sq' is not a measure: did you mean sq_nm?"),
        ({"measure": []}, "nothing is measured: name at least 1 measure"),
        ({"measure": ["minutes", "minutes"]}, "minutes is measured 2 times"),
        ({"measure": "sq_nm@rim"}, "the job has no patch 'rim', it has whole part, axis"),
        ({"measure": "peak_jerk@Q"}, "has no axis 'Q': use peak_jerk@C or peak_jerk@X or peak_jerk@Z"),
        ({"measure": "peak_jerk"}, "has several axes: use peak_jerk@C or"),
        ({"measure": "minutes@finish"}, "minutes is a measure of the whole job: leave out the part after @"),
        ({"measure": 3}, "a measure is 3, it must be a name or a function"),
    ],
)
def test_impossible_study_is_refused_before_any_case_runs(job, how, message):
    asked = {"vary": {"strategy.feed": "5, 10 um/rev"}, "measure": "minutes", **how}
    with pytest.raises(InputError) as error:
        study(job, executor=Executor(), **asked)  # a call of that executor would fail
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_patch_is_needed_for_what_is_that_of_a_patch(job):
    bare = Job.read({**DATA, "simulation": {}})
    with pytest.raises(InputError, match=r"sq_nm needs a patch, and the job has none"):
        measure_of(bare, "sq_nm")
    assert measure_of(bare, "sq_nm@whole part").stage == "place"


def test_a_unit_of_another_kind_is_a_unit_error(job):
    with pytest.raises(UnitError, match=r"strategy.feed: '5 mm' is a length, it must be a feed per revolution"):
        read_varied(job, "strategy.feed", "5 mm")
