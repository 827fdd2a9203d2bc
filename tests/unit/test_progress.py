"""Work in chunks: every place once, told of in order, and stoppable; a single thread is the caller's own."""

import subprocess
import sys
import threading

import pytest

from turnwright.errors import LimitError
from turnwright.part import Part
from turnwright.progress import require_memory, run_chunks
from turnwright.strategy import SlowToolServo
from turnwright.surface import Plane
from turnwright.tool import Tool


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("total", "chunk"), [(0, 3), (1, 3), (10, 3), (12, 3)])
def test_every_place_is_worked_on_once_and_told_of(threads, total, chunk):
    places, told = [], []
    run_chunks(
        lambda start, stop: places.extend(range(start, stop)),
        total,
        chunk,
        lambda *at: told.append(at),
        threads=threads,
    )
    assert sorted(places) == list(range(total))
    assert told == sorted(told)
    assert told[-1:] == [(total, total)] * (total > 0)


def test_a_single_thread_is_the_callers():
    """A thread made for each call would take memory anew each time, a tenth of the time of a case of a study."""
    threads = set()
    run_chunks(lambda _start, _stop: threads.add(threading.get_ident()), 5, 2, threads=1)
    assert threads == {threading.get_ident()}


@pytest.mark.parametrize("threads", [1, 2])
def test_a_stop_ends_the_work_within_a_few_chunks(threads):
    done = []

    def stop(finished, _total):
        if finished >= 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_chunks(lambda start, _stop: done.append(start), 1000, 1, stop, threads=threads)
    assert 3 <= len(done) <= 3 + 4 * threads


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_of_the_work_reaches_the_caller(threads):
    with pytest.raises(ZeroDivisionError):
        run_chunks(lambda start, _stop: 1 / start, 10, 1, threads=threads)


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


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is told by Linux")
def test_the_limit_of_a_process_counts_as_memory():
    """Oracle: the limit that is set, less what the process has."""
    code = (
        "import resource; from turnwright.progress import free_memory_gb as free\n"
        "pages = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (pages + 10**9,) * 2); print(free())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(1.0, abs=0.05)
