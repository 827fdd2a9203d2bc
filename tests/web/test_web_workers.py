"""The processes kept warm for a page. Oracle: the operating system's numbers of the processes that answer."""

import asyncio
import os
import threading
import time

import pytest

pytest.importorskip("fastapi", reason="the workbench is an extra: pip install 'turnwright[web]'")

from patience import PATIENCE_S
from turnwright.web import workers as _workers
from turnwright.web.workers import Busy, TooLong, Workers


def carried_out(questions, count=2, **more):
    """What `questions` makes of some workers, which then end."""

    async def ask():
        workers = Workers(count, threads=1, warm=os.getpid, **more)
        try:
            return await asyncio.wait_for(questions(workers), PATIENCE_S)
        finally:
            await asyncio.to_thread(workers.close)

    return asyncio.run(ask())


def test_a_first_request_waits_for_the_warming_process():
    async def two(workers):
        return await asyncio.gather(workers.ask(os.getpid), workers.ask(os.getpid))

    first, second = carried_out(two)
    assert first == second != os.getpid()


def test_a_question_behind_a_long_one_gets_a_process_of_its_own(monkeypatch):
    monkeypatch.setattr(_workers, "START_DELAY_S", 1000.0)
    monkeypatch.setattr(_workers, "MAX_WAIT_S", 0.1)

    async def beside(workers):
        first = await workers.ask(os.getpid)
        long = asyncio.create_task(workers.ask(time.sleep, 1000))
        await asyncio.sleep(0.1)
        second = await workers.ask(os.getpid)
        assert not long.done()
        long.cancel()
        return first, second

    first, second = carried_out(beside)
    assert first != second


def test_later_needs_are_loaded_when_the_page_is_idle(monkeypatch):
    called, loading = [], threading.Event()
    submit = _workers.LocalPool.submit

    def noted(pool, function, *arguments):
        called.append((function, time.monotonic()))
        if function is time.monotonic:
            loading.set()
        return submit(pool, function, *arguments)

    monkeypatch.setattr(_workers.LocalPool, "submit", noted)

    async def three(workers):
        await workers.ask(time.sleep, 0.2)
        await workers.ask(time.sleep, 0.0)
        await asyncio.to_thread(loading.wait, PATIENCE_S)

    carried_out(three, 1, then=(time.monotonic,))
    assert [one for one, _ in called] == [os.getpid, time.sleep, time.sleep, time.monotonic]
    (_, asked), (_, loaded) = called[2:]
    assert loaded - asked >= _workers.IDLE_S


def test_who_hears_that_it_took_too_long_finds_the_process_gone():
    async def long(workers):
        number = await workers.ask(os.getpid)
        with pytest.raises(TooLong):
            await workers.ask(time.sleep, 1000, limit_s=0.2)
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)
        return number, await workers.ask(os.getpid)

    before, after = carried_out(long, 1)
    assert before != after


def test_waiting_clients_get_an_answer_when_the_server_ends():
    async def late(workers):
        waiting = asyncio.create_task(workers.ask(os.getpid))
        await asyncio.sleep(0)
        await asyncio.to_thread(workers.close)
        with pytest.raises(Busy, match="shutting down"):
            await waiting

    carried_out(late)
