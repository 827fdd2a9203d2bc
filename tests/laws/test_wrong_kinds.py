"""Arguments of the wrong kind to studies, tolerances, tiles and executors: a sentence, whatever they are."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import InputError
from turnwright.studies import ErrorBudget, Spread, Store, cluster, local, run_cases

WRONG = [
    math.nan, math.inf, -math.inf, -1, 10**400, -1.5, 1e300, "", "x", "1 um", b"x", None, True, [], [1], ["x"],
    (1, 2, 3), {}, {"a": 1}, object(), np.array([1.0, 2.0]),
]  # fmt: skip

JOB = {
    "part": {"surface": {"family": "plane"}, "radius": "0.5 mm"},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {"kind": "slow tool servo", "feed": "50 um/rev", "points_per_rev": 24, "spindle_speed": "100 rpm"},
    "tolerances": {"form_pv": "1 um"},
}


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """A motion, a tool, a job, and what a study and a map made of them."""
    folder = tmp_path_factory.mktemp("there")
    k = np.arange(241)
    machine = tw.Machine(name="t", axes={x: tw.Axis() for x in "CXZ"}, spindle_rpm=3000.0, block_rate_hz=1000.0)
    axes = {"C": 2 * np.pi * k / 24, "X": 0.4 - 0.04 * k / 24, "Z": 0.0 * k}
    motion, tool = tw.Motion(time=1e-3 * k, axes=axes, machine=machine), tw.Tool(nose_radius=0.2, included=1.7)
    job = tw.Job.read(JOB)
    made = tw.studies.generate_tiled(motion, tool, pixel=0.01, radius=0.35, store=folder / "map", tile=64)
    with ThreadPoolExecutor(1) as threads:
        vary = {"strategy.feed": "40, 50 um/rev", "tool.nose_radius": "0.4, 0.5 mm"}
        study = tw.studies.study(job, vary=vary, measure="nose_radius_limit", executor=threads)
        yield {
            "motion": motion, "tool": tool, "job": job, "made": made, "study": study, "threads": threads,
            "store": Store.open(folder / "store"), "map": folder / "map",
        }  # fmt: skip


def row(*_):
    return {}


def tiled(at, **more):
    wanted = {"pixel": 0.01, "radius": 0.35, "store": at["map"], "tile": 64, **more}
    return tw.studies.generate_tiled(wanted.pop("motion", at["motion"]), wanted.pop("tool", at["tool"]), **wanted)


def study(at, **more):
    wanted = {"vary": {"strategy.feed": "50 um/rev"}, "measure": "nose_radius_limit", "executor": at["threads"], **more}
    return tw.studies.study(wanted.pop("job", at["job"]), **wanted)


def tolerance(at, **more):
    wanted = {"correction": False, "count": 10, "executor": at["threads"], "store": "nosuch://there", **more}
    return tw.studies.tolerance(at["job"], **wanted)


CALLS = {
    "pixel": lambda at, it: tiled(at, pixel=it),
    "pixels": lambda at, it: tiled(at, pixel=[it, 0.01]),
    "store": lambda at, it: tiled(at, store=it, radius=math.nan),
    "radius": lambda at, it: tiled(at, radius=it),
    "x": lambda at, it: tiled(at, radius=None, x=it, y=(0, 1)),
    "x0": lambda at, it: tiled(at, radius=None, x=(it, 1), y=(0, 1)),
    "tile": lambda at, it: tiled(at, tile=it),
    "motion": lambda at, it: tiled(at, motion=it),
    "tool": lambda at, it: tiled(at, tool=it),
    "open": lambda _at, it: tw.studies.TiledMap.open(it),
    "level": lambda at, it: at["made"].height_map(it),
    "window": lambda at, it: at["made"].window(x=it, y=(0.0, 0.1)),
    "window pixels": lambda at, it: at["made"].window(x=(0.0, 0.1), y=(0.0, 0.1), pixels=it),
    "vary": lambda at, it: study(at, vary=it),
    "value": lambda at, it: study(at, vary={"tool.nose_radius": it}),
    "field": lambda at, it: study(at, vary={it: "50 um/rev"} if isinstance(it, str | float | int | tuple) else None),
    "measure": lambda at, it: study(at, measure=it),
    "study of": lambda at, it: study(at, job=it),
    "study workers": lambda at, it: study(at, workers=it, vary={}),
    "case or column": lambda at, it: at["study"][it],
    "best": lambda at, it: at["study"].best("nose_radius_limit", it),
    "over": lambda at, it: at["study"].grid("nose_radius_limit", over=it),
    "at": lambda at, it: at["study"].grid("nose_radius_limit", at={"strategy.feed": it}),
    "load": lambda _at, it: tw.studies.Study.load(it),
    "count": lambda at, it: tw.studies.tolerance(at["job"], count=it),
    "seed": lambda at, it: tw.studies.tolerance(at["job"], count=3, seed=it),
    "tolerance of": lambda _at, it: tw.studies.tolerance(it),
    "budget": lambda at, it: tw.studies.tolerance(at["job"], budget=it, count=10, store="nosuch://there"),
    "budget file": lambda _at, it: ErrorBudget.load(it),
    "budget table": lambda _at, it: ErrorBudget.read({"noise": "1 nm", "errors": it}),
    "noise": lambda _at, it: ErrorBudget(errors=ErrorBudget.typical().errors, noise=it),
    "groups": lambda _at, it: ErrorBudget.typical().only(it),
    "draws": lambda _at, it: ErrorBudget.typical().draw(it, seed=0, correction=False),
    "workers": lambda _at, it: local(it, 0.0).__enter__(),
    "memory": lambda _at, it: local(0, it).__enter__(),
    "address": lambda _at, it: cluster(it).__enter__(),
    "key": lambda at, it: at["store"].row(it),
    "array": lambda at, it: at["store"].array(it),
    "place": lambda _at, it: Store(place=it),
    "progress of a study": lambda at, it: study(at, progress=it),
    "progress of a tolerance": lambda at, it: tolerance(at, progress=it),
    "progress of tiles": lambda at, it: tiled(at, progress=it),
    "progress of a roughness": lambda at, it: at["made"].roughness(progress=it),
    "progress of cases": lambda _at, it: run_cases(row, [], executor=ThreadPoolExecutor(1), progress=it),
    "drawn": lambda at, it: study(at, vary={"tool.nose_radius": "0.1..1 mm"}, design="random", count=it),
    "drawn by": lambda at, it: study(at, vary={"tool.nose_radius": "0.1..1 mm"}, design="sobol", count=2, seed=it),
    "design": lambda at, it: study(at, design=it),
    "error": lambda _at, it: ErrorBudget.typical().unit(it),
    "errors": lambda _at, it: ErrorBudget(errors={it: None} if isinstance(it, int | float | str) else it, noise=0.0),
    "test_parts": lambda _at, it: ErrorBudget(errors=ErrorBudget.typical().errors, noise=0.0, test_parts=it),
    "kind": lambda _at, it: Spread(kind=it, numbers=(0.0, 1.0), source="a"),
    "numbers": lambda _at, it: Spread(kind="normal", numbers=it, source="a"),
    "a number": lambda _at, it: Spread(kind="normal", numbers=(0.0, it), source="a"),
    "source": lambda _at, it: Spread(kind="normal", numbers=(0.0, 1.0), source=it),
    "along": lambda at, it: at["made"].line_psd(along=it, segment=16),
    "form": lambda at, it: at["made"].roughness(form=it),
}
"""What is asked, with one argument that each wrong value is put into."""


@pytest.mark.parametrize("name", CALLS)
def test_what_is_of_the_wrong_kind_is_a_sentence(name, there, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    message = []
    for value in WRONG:
        try:
            CALLS[name](there, value)
        except InputError as error:
            message.append(str(error))
    assert len(message) >= 12  # some take None, or a number, or a text
    assert not [one for one in message if "\n" in one or len(one) > 1000]


def test_the_name_of_a_test_part_is_no_list_of_its_letters():
    with pytest.raises(InputError, match="test_parts is 'tilted flat', it must be a list of names"):
        ErrorBudget(errors=ErrorBudget.typical().errors, noise=0.0, test_parts="tilted flat")
    one = ErrorBudget(errors=ErrorBudget.typical().errors, noise=0.0, test_parts=["tilted flat"])
    assert one.test_parts == ("tilted flat",)
