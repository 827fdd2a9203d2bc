"""Whatever happens to workers, driver, disk and scheduler: nothing finished is lost or computed twice.

The oracle of the rows is the work itself, called here; that of what was computed is a file that each computation
writes a line into when it begins.
"""

import copy
import errno
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from multiprocessing import get_context
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

import execution_work as ours
import turnwright as tw
from execution_work import answer, begun, cases
from patience import PATIENCE_S
from turnwright.errors import InputError, StudyError
from turnwright.progress import at_most, cores, free_memory_gb
from turnwright.studies import (
    case_key,
    cases as _conduct,
    cluster,
    executors as _executors,
    local,
    program_version,
    run_cases,
)
from turnwright.studies.store import Store

HERE = Path(__file__).parents[1] / "support"


@pytest.fixture(scope="module")
def pool():
    """Two processes that most tests share, so that they start once."""
    with local(2) as made:
        yield made


@pytest.fixture
def store(tmp_path):
    return Store.open(tmp_path / "store")


@pytest.fixture
def log(tmp_path):
    return str(tmp_path / "begun.txt")


def one_sentence(error):
    return "\n" not in str(error.value) and "Traceback" not in str(error.value) and len(str(error.value)) < 400


def alive(pid):
    """Whether a process runs; one that is dead but not yet buried does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return state.rpartition(")")[2].split()[0] != "Z"


def until(true):
    start = time.monotonic()
    while not true():
        assert time.monotonic() - start < PATIENCE_S, "it never came"
        time.sleep(0.01)


def assert_once_but_for(many, count, log):
    """Each of so many cases was computed once, but for what a killed worker had in hand."""
    times = Counter(n for n, _ in begun(log))
    assert sorted(times) == list(range(count))
    assert times.total() <= count + many


def rows_of(store):
    return list((Path(store.place) / "rows").iterdir())


@contextmanager
def threads_of_this():
    with ThreadPoolExecutor(2) as made:
        yield made


@contextmanager
def standard(count=2):
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as made:
        yield made


@pytest.mark.parametrize("kind", ["local", "threads", "standard"])
def test_rows_keep_the_order_of_cases_on_any_executor(kind, pool, store):
    executor = {"local": lambda: nullcontext(pool), "threads": threads_of_this, "standard": standard}[kind]
    report = []
    asked = cases(12)[::-1]
    with executor() as made:
        rows = run_cases(
            ours.plain, asked, executor=made, store=store, progress=lambda done, total: report.append((done, total))
        )
    assert rows == [answer(n) for n in range(12)][::-1]
    assert [store.row(case.key) for case in asked] == rows
    assert report[0] == (0, 12)
    assert report[-1] == (12, 12)
    assert report == sorted(report)


def test_no_executor_is_a_pool_of_this_machine():
    assert run_cases(ours.plain, cases(3)) == [answer(n) for n in range(3)]
    assert run_cases(ours.plain, []) == []


def test_a_finished_case_is_not_computed_again(pool, store, log):
    run_cases(ours.plain, cases(4), shared={"log": log}, executor=pool, store=store)
    rows = run_cases(ours.plain, cases(8), shared={"log": log}, executor=pool, store=store)
    assert rows == [answer(n) for n in range(8)]
    assert sorted(n for n, _ in begun(log)) == list(range(8))


def test_equal_cases_are_computed_once(pool, log):
    rows = run_cases(ours.plain, cases(3) * 4, shared={"log": log}, executor=pool)
    assert rows == [answer(n) for n in range(3)] * 4
    assert len(begun(log)) == 3


def test_a_row_that_the_disk_has_spoiled_is_computed_again(pool, store, log):
    run_cases(ours.plain, cases(3), shared={"log": log}, executor=pool, store=store)
    (Path(store.place) / "rows" / "case-1.json").write_bytes(b'{"n": 1, "squ')
    assert run_cases(ours.plain, cases(3), shared={"log": log}, executor=pool, store=store)[1] == answer(1)
    assert sorted(n for n, _ in begun(log)) == [0, 1, 1, 2]


def test_a_killed_worker_costs_only_the_case_in_its_hand(store, log):
    killed = []

    def kill(done, total):
        if done >= 5 and not killed:
            killed.append(begun(log)[-1])
            os.kill(killed[0][1], signal.SIGKILL)

    with local(2) as made:
        rows = run_cases(
            ours.plain, cases(30), shared={"log": log, "seconds": 0.05}, executor=made, store=store, progress=kill
        )
    assert rows == [answer(n) for n in range(30)]
    assert not alive(killed[0][1])
    assert_once_but_for(1, 30, log)


def test_a_worker_killed_while_it_waits_costs_nothing(log):
    with local(1) as made:
        run_cases(ours.plain, cases(1), shared={"log": log}, executor=made)
        os.kill(begun(log)[0][1], signal.SIGKILL)
        until(lambda: not alive(begun(log)[0][1]))
        assert run_cases(ours.plain, cases(3), shared={"log": log}, executor=made) == [answer(n) for n in range(3)]
    assert len(begun(log)) == 1 + 3


def test_a_case_that_always_kills_is_a_row_and_the_others_finish(store, log):
    with local(2) as made:
        rows = run_cases(ours.deadly, cases(12), shared={"log": log, "killer": 3}, executor=made, store=store)
    reason = rows.pop(3)["reason"]
    assert "died 4 times, the last time with no other case running (SIGKILL, perhaps out of memory)" in reason
    assert rows == [answer(n) for n in range(12) if n != 3]
    assert Counter(n for n, _ in begun(log)) == Counter({n: 4 if n == 3 else 1 for n in range(12)})
    assert begun(log)[-1][0] == 3  # alone, after all others
    assert store.keys() == {f"case-{n}" for n in range(12) if n != 3}


def driver(store, log):
    return subprocess.Popen(
        [sys.executable, str(HERE / "execution_work.py"), store.place, log],
        start_new_session=True, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_killed_driver_keeps_results_and_ends_its_workers(pool, store, log):
    process = driver(store, log)
    until(lambda: len(store.keys()) >= 10)
    process.kill()
    process.communicate()
    workers = {pid for _, pid in begun(log)}
    assert len(workers) == 2
    until(lambda: not any(map(alive, workers)))
    kept = store.keys()
    assert 10 <= len(kept) < 60
    rows = run_cases(ours.plain, cases(60), shared={"log": log}, executor=pool, store=store)
    assert rows == [answer(n) for n in range(60)]
    times = Counter(n for n, _ in begun(log))
    assert all(times[int(key.removeprefix("case-"))] == 1 for key in kept)
    assert max(times.values()) <= 2
    assert sum(times.values()) <= 60 + 2  # what was in two hands at the end


@pytest.mark.usefixtures("signals_heard")
def test_ctrl_c_ends_driver_and_workers_and_keeps_results(pool, store, log):
    process = driver(store, log)
    until(lambda: len(store.keys()) >= 10)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: workers too
    message = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode != 0
    assert message.count("Traceback") == 1  # Python's own of the driver; the workers are quiet
    assert message.splitlines()[-1] == "KeyboardInterrupt"
    assert not any(alive(pid) for _, pid in begun(log))
    rows = run_cases(ours.plain, cases(60), shared={"log": log}, executor=pool, store=store)
    assert rows == [answer(n) for n in range(60)]
    assert len(begun(log)) <= 60 + 2


def test_a_stop_from_progress_comes_through_at_once(store, log):
    def stop(done, total):
        if done >= 4:
            raise tw.errors.Stopped("enough")

    with pytest.raises(tw.errors.Stopped, match="enough"), local(1) as made:
        run_cases(
            ours.plain, cases(1000), shared={"log": log, "seconds": 0.05}, executor=made, store=store, progress=stop
        )
    assert len(begun(log)) < 500
    assert not any(alive(pid) for _, pid in begun(log))


def test_a_case_that_fails_is_a_row_with_its_reason(pool, store, log):
    rows = run_cases(ours.failing, cases(9), shared={"log": log}, executor=pool, store=store)
    assert [row.get("reason") for row in rows] == [
        None,
        "the feed 2 mm is too wide for the tool 0.1 mm: use less",
        "ZeroDivisionError: float division by zero (a defect, please report it)",
        "out of memory (12 GB): use fewer workers or a coarser map",
        "the disk is full (No space left on device) at /somewhere/map.npy",
        "the worker lacks a package (No module named 'zarr')",
        "TypeError: a row holds numbers, texts and None, not set (a defect, please report it)",
        None,
        None,
    ]
    run_cases(ours.failing, cases(9), shared={"log": log}, executor=pool, store=store)
    again = [n for n, times in Counter(n for n, _ in begun(log)).items() if times == 2]
    assert sorted(again) == [3, 4, 5]  # what the machine is to blame for may go well another time


def test_a_full_disk_is_one_sentence_and_what_is_finished_stays(pool, store, log):
    asked = cases(20)
    message = r"is full \(File too large\), finished cases are kept: free"
    with pytest.raises(StudyError, match=message) as error, local(1) as made:
        run_cases(ours.filling, asked, shared={"log": log, "full": 9}, executor=made, store=store)
    assert one_sentence(error)
    assert store.keys() == {f"case-{n}" for n in range(9)}
    assert {file.name for file in rows_of(store)} == {f"case-{n}.json" for n in range(9)}  # and no half
    rows = run_cases(ours.filling, asked, shared={"log": log, "full": None}, executor=pool, store=store)
    assert rows == [answer(n) for n in range(20)]
    assert Counter(n for n, _ in begun(log)) == Counter(range(20)) + Counter([9])


@pytest.mark.parametrize(
    ("number", "sentence"), [(errno.ENOSPC, "is full"), (errno.EDQUOT, "is full"), (errno.EROFS, "cannot be written")]
)
def test_what_the_system_says_of_a_store_is_one_sentence(number, sentence, store, monkeypatch):
    def refuse(*_args):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(StudyError, match=sentence) as error:
        store.put_row("a", {"x": 1})
    assert one_sentence(error)
    assert rows_of(store) == []


def test_a_place_that_cannot_be_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StudyError, match="cannot be written"):
        Store.open(tmp_path / "file")


def test_a_row_is_seen_whole_or_not_at_all(store):
    def fill(stream):
        stream.write(b'{"a": 1')
        stream.flush()
        assert store.keys() == set()
        assert store.row("slow") is None
        stream.write(b"}")

    store._write("rows", "slow.json", fill)
    assert store.row("slow") == {"a": 1}


def test_reading_while_others_write_meets_whole_rows_only(pool, store):
    writer = Thread(target=run_cases, args=(ours.writing, cases(2)), kwargs={"executor": pool, "store": store})
    writer.start()
    seen = set()
    while writer.is_alive():
        for key in store.keys() - seen:
            row = store.row(key)
            assert row == {} if key.startswith("case") else len(row["text"]) == row["length"]
            seen.add(key)
    writer.join()
    assert len(store.keys()) == 202


def test_arrays_travel_through_the_store_and_are_written_once(pool, store):
    heights = np.random.default_rng(1).normal(size=1000)
    name = store.put_array("heights", heights)
    file = Path(store.place) / "arrays" / f"{name}.npy"
    before = file.stat().st_mtime_ns
    assert store.put_array("heights", heights.copy()) == name
    assert file.stat().st_mtime_ns == before
    assert store.put_array("heights", heights + 1e-15) != name
    assert store.put_array("heights", heights.reshape(2, 500)) != name
    read = store.array(name)
    assert isinstance(read, np.memmap)
    assert not read.flags.writeable
    assert read.tobytes() == heights.tobytes()
    rows = run_cases(ours.numbers, cases(3), shared={"heights": name}, executor=pool, store=store)
    assert [row["sum"] for row in rows] == [heights[: n + 1].sum() for n in range(3)]
    assert rows[0]["count"] == 1000
    assert store.row("case-0")["limit"] == math.inf
    with pytest.raises(InputError, match="has no array 'other': store it first"):
        store.array("other")


@pytest.mark.parametrize("name", ["", "../a", ".hidden", "a/b", "a b"])
def test_a_name_cannot_leave_the_store(name, store):
    with pytest.raises(InputError, match="cannot be a name in a store"):
        store.put_row(name, {})


@pytest.mark.parametrize("kind", ["memory", "file"])
def test_a_store_may_be_a_url(kind, tmp_path, pool, log):
    pytest.importorskip("fsspec")
    url = f"memory://{tmp_path.name}/study/" if kind == "memory" else f"file://{tmp_path}/far"
    store = copy.deepcopy(Store.open(url))  # by its fields, as a worker gets it
    heights = np.arange(6.0).reshape(2, 3)
    name = store.put_array("heights", heights)
    assert store.put_array("heights", heights) == name
    read = store.array(name)
    assert read.tolist() == heights.tolist()
    assert not read.flags.writeable
    with pytest.raises(InputError, match="has no array"):
        store.array("none")
    assert store.row("case-0") is None
    with ThreadPoolExecutor(2) as threads:  # the memory is that of one process
        executor = threads if kind == "memory" else pool
        for _ in range(2):
            rows = run_cases(ours.plain, cases(6), shared={"log": log}, executor=executor, store=store)
            assert rows == [answer(n) for n in range(6)]
    assert len(begun(log)) == 6
    assert store.keys() == {f"case-{n}" for n in range(6)}


def test_a_url_without_what_it_needs_is_one_sentence(monkeypatch):
    pytest.importorskip("fsspec")
    with pytest.raises(InputError, match="cannot be used") as error:
        Store.open("nosuch://bucket/study")
    assert one_sentence(error)
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(InputError, match=r"pip install 'turnwright\[cluster\]', or name a folder"):
        Store.open("memory://study")


@pytest.mark.parametrize(
    ("asked", "threads"),
    [
        ({}, 2),
        *(pytest.param(*one, marks=pytest.mark.proof) for one in (({"threads": 3}, 3), ({"workers": 2}, 1))),
        ({"workers": 1, "threads": 2}, 2),
    ],
)
def test_a_worker_uses_its_share_of_the_cores(monkeypatch, asked, threads):
    monkeypatch.setattr(_executors, "cores", lambda: 5)
    monkeypatch.setattr(_executors, "count_workers", lambda _memory_gb: 2)
    before = dict(os.environ)
    with local(**asked) as made:
        rows = run_cases(ours.threads, cases(6), executor=made)
    there = len(os.sched_getaffinity(0))
    assert {(row["cores"], row["omp"]) for row in rows} == {(min(threads, there), str(threads))}
    assert len({row["pid"] for row in rows}) == asked.get("workers", 2)
    assert dict(os.environ) == before


def test_cores_are_those_that_one_was_given(monkeypatch):
    there = len(os.sched_getaffinity(0))
    monkeypatch.delenv("TURNWRIGHT_THREADS", raising=False)
    assert cores() == there
    for report, share in (("1", 1), ("1000", there), ("0", there), ("many", there)):
        monkeypatch.setenv("TURNWRIGHT_THREADS", report)
        assert cores() == share
    monkeypatch.delenv("TURNWRIGHT_THREADS")
    with at_most(1):
        assert cores() == 1
    assert cores() == there


@pytest.mark.parametrize(
    ("free", "need", "workers"), [(7.9, None, 3), (100.0, None, 8), (0.5, None, 1), (7.9, 1.0, 7), (None, 1.0, 8)]
)
def test_the_pool_is_sized_to_cores_and_memory(free, need, workers, monkeypatch):
    monkeypatch.setattr(_executors, "cores", lambda: 8)
    monkeypatch.setattr(_executors, "free_memory_gb", lambda: free)
    with local(memory_gb=need) as made:
        assert made.workers == workers


def test_the_free_memory_is_that_of_the_system():
    free = free_memory_gb()
    assert 0 < free <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9


@pytest.mark.parametrize(
    ("folder", "limit", "used", "cached"),
    [
        ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
        ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ],
)
def test_what_a_container_has_read_is_free_memory(folder, limit, used, cached, tmp_path):
    # The working set of a container, as Kubernetes counts it: its usage less its inactive files.
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc" / "meminfo").write_text("MemTotal: 64000000 kB\nMemAvailable: 50000000 kB\n")
    assert free_memory_gb(tmp_path) == 50.0
    group = tmp_path / folder
    group.mkdir(parents=True)
    (group / limit).write_text("8000000000\n")
    (group / used).write_text("7500000000\n")
    (group / "memory.stat").write_text(f"anon 500000000\n{cached} 6500000000\nactive_file 500000000\n")
    assert free_memory_gb(tmp_path) == 7.0
    (group / limit).write_text("max\n")
    assert free_memory_gb(tmp_path) == 50.0


def test_a_store_that_cannot_be_read_is_one_sentence(store):
    (Path(store.place) / "rows" / "a.json").mkdir()  # root may read whatever is a file
    with pytest.raises(StudyError, match=r"cannot be read \(Is a directory\), finished cases are kept"):
        store.row("a")
    (Path(store.place) / "rows" / "a.json").rmdir()
    (Path(store.place) / "rows").rmdir()
    (Path(store.place) / "rows").write_text("")
    with pytest.raises(StudyError, match=r"cannot be read \(Not a directory\)"):
        store.keys()


@pytest.mark.parametrize("wrong", [{"workers": 0}, {"memory_gb": 0.0}, {"memory_gb": math.nan}, {"threads": 0}])
def test_a_pool_of_nothing_is_refused(wrong):
    with pytest.raises(InputError, match=r"(use|give|increase) "), local(**wrong):
        pass


def test_a_script_that_forgets_its_guard_is_one_sentence(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from execution_work import cases, plain\nfrom turnwright.studies import run_cases, local\n"
        "with local(1) as pool:\n    run_cases(plain, cases(2), executor=pool)\n"
    )
    report = subprocess.run(
        [sys.executable, str(script)], env=os.environ | {"PYTHONPATH": str(HERE)}, capture_output=True, text=True,
        check=False, timeout=PATIENCE_S,
    )  # fmt: skip
    assert report.returncode == 1
    assert report.stderr.splitlines()[-1] == (
        "turnwright.errors.StudyError: no worker process can be started (exit code 1): start the work of a script "
        'below if __name__ == "__main__":, or use fewer workers'
    )


def test_work_that_cannot_travel_is_one_sentence(pool):
    with pytest.raises(StudyError, match="cannot be sent to a worker") as error:
        run_cases(lambda *_: {}, cases(2), executor=pool)
    assert one_sentence(error)
    assert run_cases(ours.plain, cases(2), executor=pool) == [answer(0), answer(1)]  # the pool is as good as before


def test_a_broken_foreign_pool_is_one_sentence(store, log):
    message = r"runs no more cases \(BrokenProcessPool.* finished cases are kept"
    with pytest.raises(StudyError, match=message) as error, standard(1) as made:
        run_cases(ours.deadly, cases(40), shared={"log": log, "killer": 9}, executor=made, store=store)
    assert one_sentence(error)
    assert store.keys()
    assert all(store.row(key) == answer(int(key.removeprefix("case-"))) for key in sorted(store.keys()))


def test_a_worker_of_another_program_is_refused():
    with pytest.raises(StudyError, match="install the same version on all machines"):
        _conduct._carry_out("a", {"n": 1}, ours.plain, {}, None, "0.0.1+abc", None)


def test_the_key_is_that_of_data_program_and_files(tmp_path, monkeypatch):
    data = {"feed": 0.01, "passes": [1, 2], "name": "lens"}
    key = case_key(data)
    assert key == case_key(dict(reversed(data.items())))
    assert len({key, case_key(data | {"feed": 0.01 + 1e-17 + 2e-18}), case_key(data | {"feed": 0.0101})}) == 3
    response = tmp_path / "response.csv"
    machine = tmp_path / "machine.toml"
    response.write_text("1,2\n")
    machine.write_text('base = "generic"\n[axes.Z.response]\nfile = "response.csv"\n')
    keys = [case_key({"machine": str(machine)})]
    machine.write_text(machine.read_text() + "# changed\n")
    keys.append(case_key({"machine": str(machine)}))
    response.write_text("1,30\n")  # named by the file that is named
    keys.append(case_key({"machine": str(machine)}))
    assert len(set(keys)) == 3
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for file in (response, machine):
        (moved / file.name).write_text(file.read_text())
    assert case_key({"machine": str(moved / "machine.toml")}) == keys[-1]
    monkeypatch.setattr(_conduct, "program_version", lambda: "another")
    assert case_key(data) != key
    with pytest.raises(InputError, match="plain data"):
        case_key({"a": {1}})


@pytest.mark.parametrize("text", ['\ufeffbase = "generic"\nname = "{}"\n', "no TOML {}\n", "caf\udce9 {}\n"])
def test_the_key_is_that_of_any_toml_file_as_people_save_it(tmp_path, text):
    """With a byte order mark, and none at all: a changed file is another one."""
    machine = tmp_path / "machine.toml"
    keys = set()
    for name in ("one", "two"):
        machine.write_bytes(text.format(name).encode("utf-8", "surrogateescape"))
        keys.add(case_key({"machine": str(machine)}))
    assert len(keys) == 2


def test_the_program_is_its_own_files():
    assert program_version() == program_version()
    assert program_version().startswith(f"{tw.__version__}+")


def test_a_case_costs_its_driver_less_than_twenty_milliseconds(pool, store):
    run_cases(ours.plain, cases(4), executor=pool)  # both have started
    taken = []
    for first in (0, 100, 200):  # on a machine that does other things too, the fastest counts
        start = time.process_time()
        run_cases(ours.plain, cases(first + 100)[first:], executor=pool, store=store)
        taken.append((time.process_time() - start) / 100)
    assert min(taken) < 0.020


@pytest.mark.parametrize(("listens", "reason"), [(False, "Connection refused"), (True, "no answer")])
def test_an_unreachable_scheduler_is_one_sentence(listens, reason):
    pytest.importorskip("distributed")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        if listens:
            other.listen()
        address = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(StudyError) as error, cluster(address):
            pass
    assert str(error.value).startswith(f"no Dask scheduler answers at {address!r} ({reason}): start one with")
    assert one_sentence(error)


@pytest.mark.parametrize("address", ["", "nonsense", "tcp://127.0.0.1", "http://127.0.0.1:8786"])
def test_a_wrong_address_is_named(address):
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="is not the address of a Dask scheduler: write tcp"), cluster(address):
        pass


def test_a_dask_cluster_computes_each_case_once(pool, store, log, caplog):
    distributed = pytest.importorskip("distributed")
    program_version.cache_clear()  # a program edited while the tests run has another version
    with distributed.LocalCluster(
        host="127.0.0.1", n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as made:
        with cluster(made.scheduler_address) as executor:
            killed = []

            def kill(done, total):
                if done >= 8 and not killed:
                    killed.append(begun(log)[-1])
                    os.kill(killed[0][1], signal.SIGKILL)

            run_cases(ours.plain, cases(5), shared={"log": log}, executor=executor, store=store)
            rows = run_cases(
                ours.plain,
                cases(20),
                shared={"log": log, "seconds": 0.1},
                executor=executor,
                store=store,
                progress=kill,
            )
            assert rows == [answer(n) for n in range(20)]
            assert not alive(killed[0][1])
            until(lambda: executor.workers == 2)  # Dask brings it back
            report = run_cases(ours.threads, cases(12), executor=executor)
            apart = Store.open(f"memory://{os.getpid()}-{id(store)}")  # each process has one of its own
            run_cases(ours.plain, cases(4), executor=executor, store=apart)
            assert [apart.row(f"case-{n}") for n in range(4)] == [answer(n) for n in range(4)]
        assert_once_but_for(1, 20, log)
        assert store.keys() == {f"case-{n}" for n in range(20)}
        assert len({pid for _, pid in begun(log)} - {os.getpid()}) >= 2
        assert {row["cores"] for row in report} == {1}  # two on two cores, not four

        once = len(begun(log))

        def lose(done, total):
            if done >= 24:
                made.close()

        with (
            pytest.raises(StudyError, match="perhaps as the scheduler stopped") as error,
            cluster(made.scheduler_address) as executor,
        ):
            run_cases(
                ours.plain,
                cases(90),
                shared={"log": log, "seconds": 0.05},
                executor=executor,
                store=store,
                progress=lose,
            )
    assert one_sentence(error)
    assert not [record for record in caplog.records if record.name == "distributed.client" and record.exc_info]
    kept, lost = store.keys(), len(begun(log))
    assert len(kept) >= 24
    # What one worker had in hand as it ended Dask may have given to the other.
    assert max(Counter(n for n, _ in begun(log)[once:]).values()) <= 2
    assert lost - once - len({n for n, _ in begun(log)[once:]}) <= 2
    rows = run_cases(ours.plain, cases(90), shared={"log": log}, executor=pool, store=store)
    assert rows == [answer(n) for n in range(90)]
    again = {n for n, _ in begun(log)[lost:]}
    assert not again & {int(key.removeprefix("case-")) for key in kept}


def test_a_cluster_without_its_package_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'turnwright\[cluster\]'"), cluster("tcp://127.0.0.1:9"):
        pass
