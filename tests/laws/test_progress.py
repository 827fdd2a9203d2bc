"""Work in chunks: every place once, reported in order, and stoppable; a single thread is the caller's own."""

import os
import subprocess
import sys
import threading

import pytest

from turnwright.errors import LimitError
from turnwright.part import Part
from turnwright.progress import THREADS, OverallProgress, Step, _Helpers, cores, require_memory, run_chunks
from turnwright.strategy import SlowToolServo
from turnwright.surface import Plane
from turnwright.tool import Tool


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("total", "chunk"), [(0, 3), (1, 3), (10, 3), (12, 3)])
def test_every_place_is_worked_on_once_and_reported(threads, total, chunk):
    places, report = [], []
    run_chunks(
        lambda start, stop: places.extend(range(start, stop)),
        total,
        chunk,
        lambda *at: report.append(at),
        threads=threads,
    )
    assert sorted(places) == list(range(total))
    assert report == sorted(set(report))
    assert report[-1:] == [(total, total)] * (total > 0)


@pytest.mark.parametrize(("chunk", "threads"), [(2, 1), (5, 2)])
def test_a_single_thread_or_chunk_runs_in_the_caller(chunk, threads):
    """A thread made for each call would take memory again each time, a tenth of the time of a case of a study."""
    used = set()
    run_chunks(lambda _start, _stop: used.add(threading.get_ident()), 5, chunk, threads=threads)
    assert used == {threading.get_ident()}


@pytest.mark.parametrize("threads", [1, 2])
def test_a_stop_ends_the_work_within_a_chunk_of_each_thread(threads):
    done, together = [], threading.Barrier(threads)

    def work(start, _stop):
        together.wait()
        done.append(start)

    def stop(finished, _total):
        if finished >= 3:
            together.abort()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_chunks(work, 1000, 1, stop, threads=threads)
    assert 3 <= len(done) <= 3 + threads


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_of_the_work_reaches_the_caller(threads):
    with pytest.raises(ZeroDivisionError):
        run_chunks(lambda start, _stop: 1 / start, 10, 1, threads=threads)


def test_an_error_in_another_thread_reaches_the_caller_and_ends_its_work():
    caller, done, together = threading.get_ident(), [], threading.Barrier(2)

    def work(start, _stop):
        if start < 2:
            together.wait()
        if threading.get_ident() != caller:
            raise IndexError("far")
        done.append(start)

    with pytest.raises(IndexError, match="far"):
        run_chunks(work, 10, 1, threads=2)


def test_work_within_a_chunk_has_one_core_and_needs_no_other_thread():
    """Threads that wait for one another's chunks would wait for ever."""
    inner = []

    def work(start, _stop):
        inner.append(cores())
        run_chunks(lambda a, b: inner.append((start, a, b)), 4, 2, threads=2)

    run_chunks(work, 6, 1, threads=3)
    assert inner.count(1) == 6
    assert sorted(one for one in inner if one != 1) == [(n, a, a + 2) for n in range(6) for a in (0, 2)]


def test_progress_has_all_cores_and_an_interrupt_leaves_them(monkeypatch):
    monkeypatch.setattr("turnwright.progress._count_cores", lambda: 3)
    monkeypatch.delenv(THREADS, raising=False)
    seen = []

    def stop(_finished, _total):
        seen.append(cores())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_chunks(lambda _start, _stop: None, 8, 1, stop, threads=2)
    assert [*seen, cores()] == [3, 3]


def test_an_interrupt_while_threads_are_asked_leaves_no_work(monkeypatch):
    """Oracle: nothing is done after it has reached the caller, whatever the threads had begun."""
    offer, done = _Helpers.offer, []

    def interrupted(self, chunks, helpers):
        offer(self, chunks, helpers)
        raise KeyboardInterrupt

    monkeypatch.setattr(_Helpers, "offer", interrupted)
    for _ in range(20):
        with pytest.raises(KeyboardInterrupt):
            run_chunks(lambda start, _stop: done.append(start), 10_000, 1, threads=2)
        count = len(done)
        run_chunks(lambda _start, _stop: None, 1, 1)
        assert len(done) == count
        done.clear()


def test_a_system_without_threads_works_alone(monkeypatch):
    def refused(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("turnwright.progress._helpers", _Helpers())
    monkeypatch.setattr(threading.Thread, "start", refused)
    done = []
    run_chunks(lambda start, _stop: done.append(start), 5, 1, threads=3)
    assert done == [0, 1, 2, 3, 4]


def test_a_process_does_not_wait_for_work_that_nobody_waits_for():
    code = (
        "import threading, time; from turnwright.progress import run_chunks\n"
        "begun = threading.Barrier(3)\n"
        "def work(a, b): begun.wait(); time.sleep(600)\n"
        "threading.Thread(target=run_chunks, args=(work, 2, 1), kwargs={'threads': 2}, daemon=True).start()\n"
        "begun.wait()"
    )
    subprocess.run([sys.executable, "-c", code], timeout=120, check=True)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_carries_out_its_own_chunks():
    code = (
        "import os; from turnwright.progress import run_chunks\n"
        "def total():\n"
        "    done = []; run_chunks(lambda a, b: done.append(b - a), 10, 3, threads=2); return sum(done)\n"
        "total()\n"
        "child = os.fork()\n"
        "if not child: os._exit(total())\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["10"]


def test_work_that_exceeds_the_memory_is_refused_beforehand(monkeypatch):
    """Oracle: 160 bytes a point, and 1 mm at 0.1 um per rev and 3600 a turn is 36 million."""
    monkeypatch.setattr("turnwright.progress.free_memory_gb", lambda: 1.0)
    require_memory(0.9e9, "a map", "take less")
    with pytest.raises(LimitError, match=r"a map takes about 1\.1 GB of memory, 1 GB are free: take less"):
        require_memory(1.1e9, "a map", "take less")
    servo = SlowToolServo(feed=1e-4, points_per_rev=3600)
    part, tool = Part(surface=Plane(), radius=1.0), Tool(nose_radius=0.5, included=1.0, clearance=0.1)
    with pytest.raises(LimitError, match=r"a path of 3\.\d+e\+07 points takes about 5\.\d+ GB"):
        servo.spiral(part, tool)
    assert servo.extent(part, tool)[0] > 3e7  # which is counted without being made


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is reported by Linux")
def test_the_limit_of_a_process_counts_as_memory():
    """Oracle: the limit that is set, less what the process has."""
    code = (
        "import resource; from turnwright.progress import free_memory_gb as free\n"
        "pages = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (pages + 10**9,) * 2); print(free())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(1.0, abs=0.05)


def overall(*works, clock=None):
    seen = []
    steps = [Step(stage=stage, work=work) for stage, work in works]
    ticks = iter(range(10**6))
    return OverallProgress(steps, seen.append, clock=clock or (lambda: next(ticks))), seen


def test_a_fraction_is_the_work_that_is_done_and_never_falls():
    """Oracle: shares of 1, 2, 1 and 4 s, by hand."""
    whole, seen = overall(("plan", 1.0), ("place", 2.0), ("plan", 1.0), ("place", 4.0))
    for report in (
        ("plan", 0, 1), ("plan", 1, 1), ("plan", 1, 1), ("place", 0, 1), ("place", 1, 2), ("place", 1, 4),
        ("place", 1, 1), ("plan", 0, 1), ("plan", 1, 1), ("place", 0, 1), ("place", 3, 4),
    ):  # fmt: skip
        whole(*report)
    whole.finish()
    assert [one.fraction * 8 for one in seen] == [0, 1, 1, 1, 2, 2, 3, 3, 4, 4, 7, 8]
    assert [one.step for one in seen] == [1, 1, 1, 2, 2, 2, 2, 3, 3, 4, 4, 4]


def test_skipped_steps_count_as_done():
    whole, seen = overall(("plan", 1.0), ("chips", 1.0), ("write", 2.0))
    for report in (("plan", 1, 1), ("dust", 1, 2), ("write", 0, 0)):
        whole(*report)
    assert [(one.stage, one.step, one.fraction) for one in seen] == [
        ("plan", 1, 0.25), ("dust", 1, 0.25), ("write", 3, 0.5),
    ]  # fmt: skip


@pytest.mark.parametrize("pace", [0.2, 1.0, 30.0])
def test_the_time_left_is_that_of_the_pace_so_far(pace):
    """Oracle: a computer that takes so many times the estimate, half-way through 100 s of work."""
    now = [0.0]
    whole, seen = overall(("place", 100.0), clock=lambda: now[0])
    whole("place", 0, 1)
    assert seen[-1].left_s == 100.0  # the estimate, as nothing is known yet
    now[0] = 50 * pace
    whole("place", 1, 2)
    assert seen[-1].left_s == pytest.approx(50 * pace, rel=0.2)


def test_a_run_of_no_steps_ends_at_1():
    whole, seen = overall()
    whole("anything", 1, 2)
    whole.finish()
    assert [(one.fraction, one.left_s) for one in seen] == [(0.0, 0.0), (1.0, 0.0)]
