"""The command of tolerances, its table and page, budgets that cannot be, and a study that goes on where it stopped."""

import csv
import re
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
from typer.testing import CliRunner

import turnwright as tw
from turnwright._signals import Stop
from turnwright.cli.commands import Session, app
from turnwright.errors import InputError, JobError, StudyError
from turnwright.studies import Cluster, ErrorBudget, Spread, Store, draws as _draws, scenes as _scenes

JOB = {
    "part": {"name": "mirror", "radius": "3 mm", "surface": {"family": "sphere", "radius": "40 mm"}},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    # On one sphere a drift of 50 nm passes for an offset of 0.7 um: the shop knows that it drifts less.
    "machine": {"name": "nanotech-350fg", "plausible": {"drift_of_x": "12 nm", "drift_of_z": "12 nm"}},
    "strategy": {"kind": "slow tool servo", "feed": "10 um/rev", "spindle_speed": "200 rpm", "points_per_rev": 90},
    "simulation": {
        "patches": [{"name": "half-way out", "centre": ["1.5 mm", "0 mm"], "size": ["40 um", "40 um"], "pixel": "1 um"}]
    },
    "tolerances": {"form_pv": "100 nm", "sq": "12 nm"},
}

BUDGET = """
name = "of the shop"
noise = "1 nm"
test_parts = ["concave sphere"]
[errors]
"tool offset x" = { spread = "normal(0, 3) um", source = "assumed" }
"drift z" = { spread = "uniform(-20, 20) nm", source = "log of the shop" }
"""


@pytest.fixture
def job():
    return tw.Job.read(JOB)


@pytest.fixture
def few_places(monkeypatch):
    """Measure the test parts of these cases, each of which is diagnosed, at a quarter of the places."""
    monkeypatch.setattr(_scenes, "MIN_RADII", 20)
    monkeypatch.setattr(_scenes, "MIN_ANGLES", 24)


def study_of(job, count=24, **more):
    with ThreadPoolExecutor(2) as executor:
        return tw.studies.tolerance(job, budget=ErrorBudget.read(table()), count=count, executor=executor, **more)


def table(**changed):
    budget = {
        "noise": "1 nm",
        "test_parts": ["concave sphere"],
        "errors": {
            "tool offset x": {"spread": "normal(0, 3) um", "source": "assumed"},
            "drift z": {"spread": "uniform(-20, 20) nm", "source": "assumed"},
        },
    }
    return budget | changed


@pytest.mark.usefixtures("few_places")
def test_a_test_part_is_worth_what_it_finds(job, tmp_path):
    found = study_of(job, 12, store=tmp_path, seed=1)
    assert found.count == 12
    assert not found.reasons
    before, after = found.outcomes["as planned"], found.outcomes["corrected"]
    assert after.probability.value > before.probability.value + 0.5
    assert (found.columns["corrected form_rms_nm"] < found.columns["form_rms_nm"] + 1).all()
    assert before.probability.value == np.mean(
        (found.columns["form_pv_nm"] <= 100) & (found.columns["sq_nm@half-way out"] <= 12)
    )
    assert before.sensitivities[0].group == "tool offset"
    assert before.advice.startswith("tighten tool offset first")
    assert found.percentiles("form_pv_nm")[0.5].value == np.median(found.columns["form_pv_nm"])
    with pytest.raises(InputError, match="there is no measure 'pv' among form_pv_nm"):
        found.percentiles("pv")


def test_a_study_goes_on_where_it_stopped(job, tmp_path, monkeypatch):
    store = Store.open(tmp_path)
    first = study_of(job, 10, store=store, correction=False)
    rows = len(store.keys())
    assert rows == 11  # the cases, and what was planned

    def never(*_):
        raise AssertionError("computed twice")

    monkeypatch.setattr(_draws.CaseContext, "measure", never)
    again = study_of(job, 10, store=store, correction=False)
    assert len(store.keys()) == rows
    assert np.array_equal(first.columns["form_pv_nm"], again.columns["form_pv_nm"])


def test_a_case_that_fails_is_a_reason(job, tmp_path, monkeypatch):
    whole = _draws.CaseContext.measure

    def sometimes(self, real):
        if real.tool.offset[0] > 0.003:
            raise InputError("the tool is off by too much: set it anew")
        return whole(self, real)

    monkeypatch.setattr(_draws.CaseContext, "measure", sometimes)
    found = study_of(job, store=tmp_path, correction=False)
    assert 0 < len(found.reasons) < 12
    assert found.count == 24 - len(found.reasons)
    assert set(found.reasons) == {"the tool is off by too much: set it anew"}
    # They are parts out of tolerance: the best statement is the share of those that could be cut.
    kept = sum(
        all(found.columns[measure][k] <= limit for measure, limit in found.limits.items()) for k in range(found.count)
    )
    assert found.outcomes["as planned"].probability.value == pytest.approx(kept / 24, abs=1e-12)


def test_a_plan_outlives_changes_of_its_files(tmp_path):
    edge = tmp_path / "edge.csv"

    def asked(rise):
        edge.write_text(f"sweep [deg],deviation [um]\n-20,0\n-5,0\n5,0\n20,{rise}\n", encoding="utf-8")
        return tw.Job.read({**JOB, "actual": {"tool": {"waviness_file": "edge.csv"}}}, folder=tmp_path)

    one = study_of(asked(0.1), 10, store=tmp_path / "store", correction=False)
    # Another content of the same file is another study, in the same store.
    two = study_of(asked(0.6), 10, store=tmp_path / "store", correction=False)
    assert (one.columns["form_pv_nm"] != two.columns["form_pv_nm"]).all()
    store = Store.open(tmp_path / "store")
    plans = [row for row in map(store.row, store.keys()) if "cuts" in row]
    edge.unlink()
    benches = [_draws.CaseContext.of(plan, store) for plan in plans]  # as on a machine that does not have the file
    assert sorted(bench.cuts[""].job.actual_tool.deviation(np.deg2rad(20)) for bench in benches) == pytest.approx(
        [0.1e-3, 0.6e-3], rel=1e-9
    )


def test_a_worker_that_does_not_find_the_motion_ends_the_study(job, tmp_path):
    kept = Store.open(tmp_path / "kept")
    shared = _draws.plan_cuts(job, ErrorBudget.read(table()), kept, correction=False)
    case = {"draw": {"tool offset x": 0.0, "drift z": 0.0}, "seed": [0, 0], "correction": False, "study": "elsewhere"}
    with pytest.raises(StudyError, match=r"a worker finds no array 'motion-.*: use a store that"):
        _draws.carry_out(case, shared, Store.open(tmp_path / "elsewhere"))
    assert _draws.carry_out(case, shared, kept)["form_pv_nm"] > 0


@pytest.mark.usefixtures("in_this_process", "few_places")
def test_the_command_writes_a_table_and_a_page(tmp_path):
    (tmp_path / "job.toml").write_text(tomli_w.dumps(JOB))
    (tmp_path / "budget.toml").write_text(BUDGET)
    words = [
        "tolerance", str(tmp_path / "job.toml"), "--budget", str(tmp_path / "budget.toml"), "--cases", "10",
        "--workers", "1", "--confirm", "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    with Stop() as stop:
        result = CliRunner().invoke(app, words, obj=Session(stop), catch_exceptions=False)
    shares = re.findall(r"([0-9.]+)% of 10 parts meet all tolerances", result.output)
    assert result.exit_code == (0 if shares[-1] == "100.0" else 4), result.output
    assert "confirmed: " in result.output
    with (tmp_path / "out" / "cases.csv").open() as lines:
        rows = list(csv.reader(lines))
    assert len(rows) == 11
    assert rows[0][:2] == ["tool offset x [mm]", "drift z [mm]"]
    assert "corrected form_pv [nm]" in rows[0]
    page = (tmp_path / "out" / "report.html").read_text()
    for one in ("tighten tool offset first", "log of the shop", "tolerance 100 nm", "concave sphere", "form error PV"):
        assert one in page
    assert sorted(one.name for one in (tmp_path / "out").iterdir()) == ["cases.csv", "report.html"]


def entry(spread="normal(0, 1) nm", source="a"):
    return {"spread": spread, "source": source}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"errors": {}}, ".*0 errors.*at least 1"),
        ({"errors": 3}, "errors is 3.*a table"),
        ({"error": {}}, "error is not a known key.*'errors'"),
        ({"noise": "1"}, "noise: '1' has no unit.*a length"),
        ({"noise": "-1 nm"}, "noise: '-1 nm' is below 0 mm"),
        ({"settling": "0 s"}, "settling is 0 s.*above 0 s"),
        ({"settling": "3 mm"}, "settling: '3 mm' is a length.*a time"),
        ({"name": 3}, "name is 3.*text"),
        ({"test_parts": "cone"}, "test_parts is 'cone'.*a list"),
        ({"test_parts": ["cone"]}, r"test_parts is \('cone',\).*tilted flat, concave sphere"),
        ({"errors": {"tool ofset x": entry()}}, r"errors\.tool ofset x: .*'tool offset x'"),
        ({"errors": {"drift z": 3}}, r"errors\.drift z is 3.*a table"),
        ({"errors": {"drift z": {"spread": "normal(0, 1) nm"}}}, r"errors\.drift z\.source is missing"),
        ({"errors": {"drift z": entry() | {"sauce": "a"}}}, r"errors\.drift z\.sauce is not a known key.*'source'"),
        ({"errors": {"drift z": entry(3)}}, r"errors\.drift z\.spread is 3.*text"),
        ({"errors": {"drift z": entry("normal(0, -1) nm")}}, r"errors\.drift z: normal\(0, -1e-06\).*above 0"),
        ({"errors": {"drift z": entry("gauss(0, 1) nm")}}, r"errors\.drift z: .*'gauss' is not one of normal, uniform"),
        ({"errors": {"drift z": entry("uniform(0, 1, 2) nm")}}, r"errors\.drift z: uniform has 3 .*2 \(low, high\)"),
        ({"errors": {"drift z": entry("uniform(0, 1) deg")}}, r"errors\.drift z: '0 deg' is an angle.*a length"),
        ({"errors": {"drift z": entry("1 nm")}}, r"errors\.drift z: '1 nm' is not a distribution"),
        ({"errors": {"drift z": entry(source=" ")}}, r"errors\.drift z: normal has no source"),
        ({"errors": {"mounting Z2": entry()}}, "mounting Z2 is piston or tilt.*Z4"),
        (
            {"errors": {"waviness P3": entry(), "waviness c3": entry("normal(0, 1) nm/rad^3")}},
            "waviness has terms P and terms c",
        ),
    ],
)
def test_a_budget_that_cannot_be_is_a_sentence(tmp_path, changed, words):
    file = tmp_path / "shop.toml"
    file.write_text(tomli_w.dumps(table(**changed)))
    with pytest.raises(InputError, match=rf"^budget file '.*shop\.toml': {words}") as caught:
        ErrorBudget.load(file)
    assert "\n" not in str(caught.value)


def test_a_servo_of_an_axis_that_is_not_there_is_a_sentence(job):
    budget = ErrorBudget(errors={"servo Q": Spread.read("normal(0, 0.1)", "1", source="test")}, noise=0.0)
    with pytest.raises(InputError, match=r"servo Q: .* has no axis Q, it has C, X, Z: name one of them"):
        tw.studies.tolerance(job, budget=budget, count=10)
    with pytest.raises(InputError, match=r"it must be a plain number: write it such as '0\.5'"):
        Spread.read("normal(0, 1) um", "1", source="test")


def test_a_budget_file_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        ErrorBudget.load(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("errors = [")
    with pytest.raises(InputError, match=r"bad\.toml.* is not TOML"):
        ErrorBudget.load(tmp_path / "bad.toml")


def test_a_budget_reads_back_what_it_writes(tmp_path):
    typical = ErrorBudget.typical()
    (tmp_path / "again.toml").write_text(tomli_w.dumps(typical.table()))
    assert ErrorBudget.load(tmp_path / "again.toml") == typical
    assert all(one.source for one in typical.errors.values())
    assert set(typical.only("drift").errors) == {"drift x", "drift z"}
    with pytest.raises(InputError, match="no error of the budget is in the groups luck, its groups are tool offset"):
        typical.only("luck")
    # The part's own draws do not depend on whether test parts are drawn too.
    alone, both = (typical.draw(5, seed=2, correction=one) for one in (False, True))
    assert all(np.array_equal(values, both[name]) for name, values in alone.items())
    assert Spread.read("normal(0, 2) um", "mm", source="a").largest == pytest.approx(0.002 * 5.998, rel=1e-3)


def test_a_job_without_tolerances_is_refused(job):
    bare = tw.Job.read({key: value for key, value in JOB.items() if key != "tolerances"})
    with pytest.raises(JobError, match="the job states 0 tolerances that can be evaluated"):
        tw.studies.tolerance(bare, count=20)
    with pytest.raises(InputError, match="the study has 3 cases, it needs at least 10"):
        tw.studies.tolerance(job, count=3)


def test_a_store_in_memory_is_refused_before_planning(job):
    pytest.importorskip("fsspec")
    with pytest.raises(InputError, match="'memory://kept' is in the memory of this process"):
        tw.studies.tolerance(job, count=20, store="memory://kept", workers=1)
    # Workers of a cluster, whose rows would be brought here, would not find the motion either.
    dask = Cluster(SimpleNamespace(get_executor=lambda **_: None))
    with pytest.raises(InputError, match="'memory://kept' is in the memory of this process"):
        tw.studies.tolerance(job, count=20, store="memory://kept", executor=dask)
