"""Processes that work for this one: they leave Ctrl-C to it, and end when it ends, however that is."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any

__all__ = ["Recorded", "start_worker"]

_GRACE_S = 0.7  # a worker ends within a second of its driver process


class _Process(SpawnProcess):
    """A process that never receives Ctrl-C, which Python would report while it starts."""

    needs_script = True

    def start(self) -> None:
        if self.needs_script:
            self._start()
            return
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")  # it has no file, so that none is run again
        try:
            self._start()
        finally:
            sys.modules["__main__"] = script

    def _start(self) -> None:
        if not hasattr(signal, "pthread_sigmask"):  # Windows
            super().start()
            return
        resource_tracker.ensure_running()  # it would unblock the signal
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # a process inherits the mask
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Recorded(SpawnContext):
    """The context of an executor that keeps its processes: executors offer neither their exit codes nor their end.

    Parameters
    ----------
    needs_script
        Whether functions may be of the script that Python runs. Each process then imports it, with what it does there.
    """

    def __init__(self, *, needs_script: bool = True) -> None:
        self.needs_script = needs_script
        self.processes: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802 - there a class
        """Create a process."""
        process = _Process(*args, **kwargs)
        process.needs_script = self.needs_script
        self.processes.append(process)
        return process


def start_worker() -> None:
    """Initialise a process of an executor."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the driver process too, which ends its workers
    threading.Thread(target=_end_with_driver, daemon=True).start()


def _end_with_driver() -> None:
    driver = multiprocessing.parent_process()
    if driver is None:
        return
    wait([driver.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)  # the handler removes incomplete folders
    time.sleep(_GRACE_S)
    os._exit(1)
