"""Work in chunks: every place once, told of in order, and stoppable; a single thread is the caller's own."""

import threading

import pytest

from turnwright.progress import run_chunks


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
