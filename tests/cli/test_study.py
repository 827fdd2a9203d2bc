"""Studies from the outside: the command, its files and its page, the table in Python, and going on after an end."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
import tomli_w
from pyarrow import parquet

from patience import PATIENCE_S
from turnwright import Job, cli
from turnwright.errors import InputError, StudyError
from turnwright.job import Pipeline
from turnwright.studies import Store, Study, study

DATA = {
    "part": {"surface": {"family": "plane"}, "radius": "0.5 mm"},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "generic"},
    "strategy": {
        "kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 120, "spindle_speed": "100 rpm",
    },
    "simulation": {
        "whole_part": {"radii": 100, "angles": 12},
        "patches": [
            {"name": "askew", "centre": ["0.3 mm", "0.1 mm"], "size": ["80 um", "80 um"], "pixel": "1.3 um"},
            {"name": "middle", "centre": ["0 mm", "0 mm"], "size": ["40 um", "40 um"], "pixel": "1.3 um"},
        ],
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def job():
    return Job.read(DATA)


@pytest.fixture(scope="module")
def threads():
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.fixture
def job_file(tmp_path):
    file = tmp_path / "job.toml"
    file.write_text(tomli_w.dumps(DATA), encoding="utf-8")
    return file


def deepest(stages):
    return float(stages.prediction("askew").error.z.min() * 1e6)


def counted(stages):
    with open(counted.file, "a", encoding="utf-8") as file:  # noqa: PTH123
        file.write("x")
    return stages.job.tool.nose_radius


@pytest.mark.usefixtures("in_this_process")
def test_the_command_leaves_table_page_and_study(job_file, tmp_path, capsys):
    out = tmp_path / "study"
    code = cli.main([
        "study", str(job_file), "--out", str(out), "--workers", "1",
        "--vary", "tool.nose_radius=0.2..0.6 mm:3", "--vary", "strategy.feed=0.5, 1, 2 mm/min",
        "--measure", "sq_nm", "--measure", "minutes", "--measure", "peak_speed@X", "--measure", "binding",
    ])  # fmt: skip
    message = capsys.readouterr()
    assert code == 0, message.err
    assert sorted(file.name for file in out.iterdir()) == [
        "job.toml", "report.html", "study.csv", "study.json", "study.parquet",
    ]  # fmt: skip
    assert not (tmp_path / "study.cases").exists()
    assert "9 cases, 0 failed" in message.out
    with (out / "study.csv").open(encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    assert head == [
        "case", "tool.nose_radius [mm]", "strategy.feed [mm/min]", "sq_nm", "minutes", "peak_speed@X [mm/s]", "binding",
        "seconds", "reason",
    ]  # fmt: skip
    assert [row[:3] for row in rows[:4]] == [
        ["1", "0.2", "0.5"],
        ["2", "0.2", "1.0"],
        ["3", "0.2", "2.0"],
        ["4", "0.4", "0.5"],
    ]
    # X advances by the feed: the oracle of its speed.
    np.testing.assert_allclose([float(row[5]) for row in rows], [float(row[2]) / 60 for row in rows], rtol=1e-9)

    loaded = Study.load(out)
    table = parquet.read_table(out / "study.parquet")
    assert table.column_names == head
    for heading, column in zip(head[1:-2], loaded.columns, strict=True):
        assert table.column(heading).to_pylist() == column.values.tolist()
    assert loaded.job == Job.load(job_file)
    assert loaded.fields[0].job_value == 0.5
    assert loaded.fields[1].job_value == pytest.approx(1.0)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 6  # a map and profiles of each number
    assert "Best cases by sq_nm" in page
    assert not re.search(r"\bnan\b", page)


def test_the_table_is_indexed_by_name_and_by_number(job, threads):
    found = study(
        job, vary={"tool.nose_radius": "0.2, 0.4 mm", "strategy.feed": [0.005, 0.010, 0.020]},
        measure=["pv_nm@askew", deepest, "form_pv_nm"], executor=threads,
    )  # fmt: skip
    assert len(found) == 6
    assert [one.heading for one in found.columns] == [
        "tool.nose_radius [mm]", "strategy.feed [mm/rev]", "pv_nm@askew", "deepest", "form_pv_nm",
    ]  # fmt: skip
    assert found[4] == {**{name: found[name][4] for name in (one.name for one in found.columns)}, "reason": ""}
    assert [row["strategy.feed"] for row in found] == [0.005, 0.010, 0.020] * 2
    grid = found.grid("pv_nm@askew", over=("strategy.feed", "tool.nose_radius"))
    np.testing.assert_array_equal(grid.values, found["pv_nm@askew"].reshape(2, 3).T)
    assert grid.ok.all()
    assert found.best("pv_nm@askew", 1) == [3]
    assert found.best("pv_nm@askew", 1, largest=True) == [2]
    assert found.is_grid
    # What a case says is what its own job says.
    alone = Pipeline(Job.read({**DATA, "tool": {**DATA["tool"], "nose_radius": "0.4 mm"}}))
    assert found["pv_nm@askew"][4] == alone.prediction("askew").roughness.pv_nm
    assert found["deepest"][4] == deepest(alone)
    assert found["form_pv_nm"][4] == alone.form_pv_nm
    with pytest.raises(InputError, match="the study has no column 'sq', it has"):
        found["sq"]
    with pytest.raises(InputError, match="several cases have the same"):
        found.grid("deepest", over=("strategy.feed", "strategy.feed"))


def test_it_is_saved_and_loaded_to_the_last_bit(job, threads, tmp_path):
    found = study(
        job,
        design=[
            {"strategy.feed": "10 um/rev", "strategy.inside_out": "true", "strategy.points_per_rev": 120},
            {"strategy.feed": "1 mm/rev", "strategy.inside_out": "false", "strategy.points_per_rev": 100},
        ],
        measure=["sq_nm", "sal", "binding", "points"],
        executor=threads,
    )
    found.save(tmp_path)
    again = Study.load(tmp_path)
    assert again.job == job
    assert again.reasons == found.reasons
    assert again.design == "list"
    for one, other in zip(found.columns, again.columns, strict=True):
        assert (one.name, one.unit, one.job_value, one.kind) == (other.name, other.unit, other.job_value, other.kind)
        np.testing.assert_array_equal(one.values, other.values)
    np.testing.assert_array_equal(again.seconds, found.seconds)
    # The second case is no job: its feed is wider than the edge.
    assert found.ok.tolist() == [True, False]
    assert "feed 1 mm per rev is at least the width of the edge" in found.reasons[1]
    assert np.isnan(found["sq_nm"][1])
    assert found["binding"][1] == ""
    with pytest.raises(StudyError, match=r"holds no complete study \(No such file or directory\): name one"):
        Study.load(tmp_path / "nowhere")
    table = tmp_path / "study.csv"
    table.write_text("".join(table.read_text(encoding="utf-8").splitlines(keepends=True)[:-1]), encoding="utf-8")
    with pytest.raises(StudyError, match=r"\(ValueError: 2 cases were written, 1 are there\): name one"):
        Study.load(tmp_path)


def test_what_run_would_refuse_has_its_numbers_and_its_reason(threads):
    bowl = {**DATA, "part": {"surface": {"family": "sphere", "radius": "2 mm"}, "radius": "0.5 mm"}}
    found = study(
        Job.read(bowl), vary={"tool.nose_radius": "0.5, 2.5 mm", "strategy.spindle_speed": "100, 400 rpm"},
        measure=["sq_nm", "minutes"], executor=threads,
    )  # fmt: skip
    assert np.isfinite(found["sq_nm"]).all()
    assert found.ok.tolist() == [True, False, False, False]
    assert "block rate reaches 800 blocks/s" in found.reasons[1]
    assert "nose_radius is 2.5 mm, the limit is 2 mm" in found.reasons[2]
    assert found.best("sq_nm") == [0]
    accepting = Job.read({**bowl, "accept": ["nose radius", "limits"]})
    assert study(accepting, vary={"tool.nose_radius": "0.5, 2.5 mm"}, measure="minutes", executor=threads).ok.all()


def test_finished_cases_are_not_computed_again(job, threads, tmp_path):
    counted.file = tmp_path / "calls"
    store = tmp_path / "cases"
    how = {"measure": counted, "executor": threads, "store": store}
    first = study(job, vary={"tool.nose_radius": "0.3, 0.4 mm"}, **how)
    assert counted.file.read_text() == "xx"
    more = study(job, vary={"tool.nose_radius": "0.3, 0.4, 0.5 mm"}, **how)
    assert counted.file.read_text() == "xxx"
    assert more["counted"].tolist() == [*first["counted"], 0.5]
    study(job, vary={"tool.nose_radius": "0.3, 0.4, 0.5 mm"}, measure="minutes", executor=threads, store=store)
    assert len(Store.open(store).keys()) == 6


def scaled(stages, by=1.0):
    return by * stages.job.tool.nose_radius


def test_another_function_of_the_same_name_is_another_measure(job, threads, tmp_path):
    def holding(by):
        def times(stages):
            return by * stages.job.tool.nose_radius

        return times

    class Times:
        def __init__(self, by):
            self.by = by

        def __call__(self, stages):
            return self.by * stages.job.tool.nose_radius

    for kind in (holding, Times, lambda by: partial(scaled, by=by)):
        for by in (2.0, 3.0):
            found = study(
                job, vary={"tool.nose_radius": "0.3 mm"}, measure=kind(by), executor=threads, store=tmp_path / "cases"
            )
            assert found.measures[0].values.tolist() == [by * 0.3]


def test_a_measure_is_the_same_one_in_every_process(tmp_path):
    text = (
        "LIMIT = 3\n"
        "def helper(x): return x + 1\n"
        "def mine(stages):\n"
        "    known = sum((lambda i: helper(i))(i) for i in range(LIMIT))\n"
        "    return known if stages.job.tool.name in {'a', 'b', 'c', 'd'} else 0\n"
    )
    ask = (
        "import sys; from turnwright.studies.measures import measure_of\n"
        "for folder in sys.argv[1:]:\n"
        "    sys.path.insert(0, folder); from measures_of_mine import mine; print(measure_of(None, mine).sign)\n"
        "    sys.path.remove(folder); del sys.modules['measures_of_mine']"
    )

    def signs(seed, *folders):
        return subprocess.run(
            [sys.executable, "-c", ask, *folders], capture_output=True, text=True, check=True,
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONDONTWRITEBYTECODE": "1"},
        ).stdout.splitlines()  # fmt: skip

    folders = []
    for old, new in (("", ""), ("LIMIT = 3", "LIMIT = 4"), ("x + 1", "x + 2"), ("'d'", "'e'"), ("", "")):
        folders.append(tmp_path / str(len(folders)))
        folders[-1].mkdir()
        (folders[-1] / "measures_of_mine.py").write_text(text.replace(old, new) if old else text)
    first, *others, again = signs("1", *folders)
    assert signs("2", folders[0]) == [first]
    assert again == first
    assert len(others) == 3
    assert first not in others


def test_a_failing_measure_is_reported_to_its_author(job, threads):
    def wrong(_stages):
        return 1 / 0

    found = study(job, vary={"tool.nose_radius": "0.3 mm"}, measure=wrong, executor=threads)
    assert found.reasons == ("the measure wrong fails (ZeroDivisionError: division by zero): correct it",)


def test_an_interrupted_command_goes_on_where_it_was(job_file, tmp_path, capsys, monkeypatch, threads):
    from turnwright.studies import variation as _study

    asked = [
        "study", str(job_file), "--out", str(tmp_path / "out"), "--workers", "1",
        "--vary", "tool.nose_radius=0.2..0.6 mm:3", "--measure", "sq_nm",
    ]  # fmt: skip
    whole = _study.run_cases

    def half(work, cases, **how):
        whole(work, cases[:2], **{**how, "executor": threads})  # faster than a process, which other tests cover
        raise KeyboardInterrupt

    monkeypatch.setattr(_study, "run_cases", half)
    assert cli.main(asked) == 130
    message = capsys.readouterr().err
    kept = tmp_path / "out.cases"
    assert f"interrupted, finished cases are in {kept}: repeat the command to continue" in message
    assert not (tmp_path / "out").exists()
    before = {file.name: file.stat().st_mtime_ns for file in (kept / "rows").iterdir()}
    assert len(before) == 2

    fresh = []

    def counting(work, cases, **how):
        fresh.extend(case.key for case in cases if f"{case.key}.json" not in before)
        return whole(work, cases, **{**how, "executor": threads})

    monkeypatch.setattr(_study, "run_cases", counting)
    assert cli.main(asked) == 0
    assert len(fresh) == 1
    assert len(Study.load(tmp_path / "out")) == 3
    assert not kept.exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--vary", "tool.nose_radius", "--measure", "sq_nm"], "--vary must be FIELD=VALUES"),
        (["--vary", "tool.nos_radius=1 mm", "--measure", "sq_nm"], "did you mean tool.nose_radius?"),
        (["--vary", "tool.nose_radius=1 mm", "--measure", "sq_nmm"], "'sq_nmm' is not a measure: did you mean sq_nm?"),
        (["--vary", "tool.nose_radius=0.1..1 mm", "--measure", "sq_nm"], "has no single values for a grid"),
        (
            ["--vary", "tool.nose_radius=0.1..1 mm", "--measure", "sq_nm", "--design", "sobol"],
            "a number of cases",
        ),
    ],
)
def test_a_wrong_command_is_one_sentence_and_leaves_nothing(job_file, tmp_path, capsys, more, message):
    assert cli.main(["study", str(job_file), "--out", str(tmp_path / "out"), *more]) == 2
    reported = capsys.readouterr().err
    assert message in reported
    assert len(reported.strip().splitlines()) == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["job.toml"]


def test_a_file_that_a_job_names_travels_through_the_store(threads, tmp_path, monkeypatch):
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "edge.csv").write_text("sweep [deg],deviation [um]\n-20,0\n-5,0\n5,0\n20,0.3\n", encoding="utf-8")
    job = Job.read({**DATA, "actual": {"tool": {"waviness_file": "edge.csv"}}}, folder=folder)
    right = study(job, vary={"strategy.feed": "9, 10 um/rev"}, measure=deepest, executor=threads)

    from turnwright.studies import files as _files

    # A machine that does not have the file.
    monkeypatch.setattr(_files, "_is_stored", lambda _path, _digest: False)
    apart = study(job, vary={"strategy.feed": "9, 10 um/rev"}, measure=deepest, executor=threads, store=tmp_path / "s")
    np.testing.assert_array_equal(apart["deepest"], right["deepest"])
    with pytest.raises(StudyError, match=r"does not have 1 of the files that the job names, such as .*: use a store"):
        study(job, vary={"strategy.feed": "9, 10 um/rev"}, measure=deepest, executor=threads)


def test_a_missing_array_is_no_outcome_of_a_case(threads, tmp_path, monkeypatch):
    (tmp_path / "edge.csv").write_text("sweep [deg],deviation [um]\n-20,0\n-5,0\n5,0\n20,0.3\n", encoding="utf-8")
    job = Job.read({**DATA, "actual": {"tool": {"waviness_file": "edge.csv"}}}, folder=tmp_path)
    from turnwright.studies import files as _files

    # A machine that has neither the file nor this folder.
    monkeypatch.setattr(_files, "_is_stored", lambda _path, _digest: False)
    whole = Store.array
    monkeypatch.setattr(Store, "array", lambda _self, name: whole(Store.open(tmp_path / "elsewhere"), name))
    asked = {"vary": {"strategy.feed": "9 um/rev"}, "measure": deepest, "executor": threads, "store": tmp_path / "s"}
    with pytest.raises(StudyError, match=r"a worker finds no array 'file-.*: use a store that"):
        study(job, **asked)
    # Where the store is reached the same study is carried out: nothing was kept as the outcome of a case.
    monkeypatch.undo()
    assert study(job, **asked).reasons == ("",)


def response_files(folder):
    """A machine file that names its base in the same folder, and this by its absolute path a measured response."""
    (folder / "shop").mkdir(parents=True)
    rows = "\n".join(f"{10 * k},{1 / (1 + k / 40)},{-2 * k}" for k in range(1, 40))
    (folder / "z.csv").write_text(f"frequency [Hz],gain,phase [deg]\n{rows}\n", encoding="utf-8")
    (folder / "shop" / "base.toml").write_text(
        f'base = "nanotech-350fg"\n[axes.Z.response]\nfile = "{folder / "z.csv"}"\n', encoding="utf-8"
    )
    # With a byte order mark, as some editors save.
    (folder / "shop" / "lathe.toml").write_text('base = "base.toml"\nname = "ours"\n', encoding="utf-8-sig")
    return str(folder / "shop" / "lathe.toml")


def test_remote_worker_gets_the_files_that_job_files_name(threads, tmp_path, monkeypatch):
    job = Job.read({**DATA, "machine": {"file": response_files(tmp_path / "here")}, "simulation": {
        **DATA["simulation"], "tracking": True}})  # fmt: skip
    asked = {"vary": {"strategy.feed": "9, 10 um/rev"}, "measure": ["sq_nm", "form_pv_nm"]}
    right = study(job, executor=threads, **asked)
    assert right.ok.all(), right.reasons
    (tmp_path / "other").mkdir()

    monkeypatch.chdir(tmp_path / "other")
    monkeypatch.setenv("TMPDIR", str(tmp_path / "other"))

    def gone(_done, _total):
        shutil.rmtree(tmp_path / "here", ignore_errors=True)

    far = study(job, workers=1, store=tmp_path / "store", progress=gone, **asked)
    assert far.ok.all(), far.reasons
    for name in asked["measure"]:
        np.testing.assert_array_equal(far[name], right[name])
    assert not list((tmp_path / "other").iterdir())


def test_a_store_in_memory_is_refused_for_other_processes(job, job_file, tmp_path, capsys, threads):
    pytest.importorskip("fsspec")
    code = cli.main([
        "study", str(job_file), "--out", str(tmp_path / "out"), "--store", "memory://kept", "--workers", "1",
        "--vary", "tool.nose_radius=0.2..0.6 mm:3", "--measure", "sq_nm",
    ])  # fmt: skip
    message = capsys.readouterr().err
    assert code == 2
    assert "the store 'memory://kept' is in the memory of this process" in message
    assert message.strip().endswith("name a folder, or use threads")
    assert len(message.strip().splitlines()) == 1
    asked = {"vary": {"strategy.feed": "9, 10 um/rev"}, "measure": "sq_nm", "store": f"memory://{tmp_path.name}"}
    assert study(job, executor=threads, **asked).ok.all()


@pytest.mark.usefixtures("in_this_process")
def test_a_study_of_refused_cases_keeps_its_rows(job_file, tmp_path, capsys):
    out = tmp_path / "out"
    code = cli.main([
        "study", str(job_file), "--out", str(out), "--workers", "1",
        "--vary", "strategy.spindle_speed=2000, 3000 rpm", "--measure", "sq_nm", "--measure", "minutes",
    ])  # fmt: skip
    message = capsys.readouterr()
    assert code == 2
    assert message.err.splitlines()[-1].startswith("turnwright: all 2 cases failed, the first one: ")
    assert "2 cases, 2 failed" in message.out
    found = Study.load(out)
    assert len(found) == 2
    assert not found.ok.any()
    assert "Failed cases" in (out / "report.html").read_text(encoding="utf-8")
    assert not (tmp_path / "out.cases").exists()


@pytest.mark.usefixtures("signals_heard")
def test_the_next_command_removes_what_a_kill_left(job_file, tmp_path):
    def command(out):
        return [
            sys.executable, "-m", "turnwright", "study", str(job_file), "--out", str(tmp_path / out), "--workers", "1",
            "--vary", "tool.nose_radius=0.2..0.6 mm:400", "--measure", "minutes",
        ]  # fmt: skip

    def hidden():
        return {one.name for one in tmp_path.iterdir() if one.name.startswith((".out-", ".other-", ".third-"))}

    def started(out):
        before, process = hidden(), subprocess.Popen(command(out), stderr=subprocess.DEVNULL)
        until = time.monotonic() + PATIENCE_S
        while not (new := hidden() - before) and time.monotonic() < until:
            time.sleep(0.02)
        return process, new.pop()

    killed, left = started("out")
    running, alive = started("other")
    killed.kill()
    killed.wait()
    (tmp_path / ".out-notes").mkdir()  # of another program
    (tmp_path / ".output-12345678").mkdir()
    assert hidden() == {left, alive, ".out-notes"}
    second = subprocess.run(command("other"), capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert second.returncode == 2
    assert "another run is writing" in second.stderr
    third, new = started("third")
    assert hidden() == {alive, new, ".out-notes"}
    for process in (third, running):
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=PATIENCE_S) == 130
    assert hidden() == {".out-notes"}
    assert (tmp_path / ".output-12345678").is_dir()


def test_a_silent_scheduler_is_one_sentence(job_file, tmp_path, capsys):
    code = cli.main([
        "study", str(job_file), "--out", str(tmp_path / "out"), "--cluster", "tcp://127.0.0.1:9",
        "--vary", "tool.nose_radius=0.2..0.6 mm:3", "--measure", "sq_nm",
    ])  # fmt: skip
    message = capsys.readouterr().err
    assert code == 2
    assert "tcp://127.0.0.1:9" in message
    assert len(message.strip().splitlines()) == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["job.toml"]


@pytest.mark.parametrize(
    ("vary", "design", "pictures"),
    [
        ({"strategy.feed": "5, 10, 20 um/rev"}, {}, 2),
        ({"strategy.sense": "1, -1", "strategy.feed": "5, 10 um/rev"}, {}, 4),
        ({"tool.nose_radius": "0.2..0.6 mm", "strategy.feed": "5..900 um/rev"}, {"design": "halton", "count": 9}, 1),
    ],
)
def test_the_page_draws_any_study(job, threads, tmp_path, vary, design, pictures):
    from turnwright.report import write_study

    found = study(job, vary=vary, measure=["sq_nm", "minutes"], executor=threads, seed=1, **design)
    page = write_study(found, tmp_path).read_text(encoding="utf-8")
    assert page.count("<svg") == pictures
    assert ("Failed cases" in page) == (not found.ok.all())


def test_a_study_of_jobs_as_data_keeps_only_plain_data(job, threads, tmp_path):
    study(job, vary={"strategy.feed": "10 um/rev"}, measure="sq_nm", executor=threads, store=tmp_path)
    (row,) = (json.loads(file.read_text()) for file in (tmp_path / "rows").iterdir())
    assert set(row) == {"sq_nm", "seconds"}
