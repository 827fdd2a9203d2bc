"""The order of the tests, what several of them need, and what each process of theirs has of the machine."""

import contextlib
import gc
import os
import signal
import sys
from concurrent.futures import Future
from pathlib import Path

import hypothesis
import platformdirs
import pytest

from turnwright.progress import THREADS, cores

if processes := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
    # As a study shares the cores among its processes: more threads than cores wait for each other.
    os.environ.setdefault(THREADS, str(max(cores() // processes, 1)))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if sys.dont_write_bytecode:
    # Hundreds of processes would each compile the whole program: its source stays free of bytecode all the same.
    sys.dont_write_bytecode = False
    sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = platformdirs.user_cache_dir("turnwright-tests")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Half a million objects of the tests themselves live as long as the process: collecting looks at none of them.
gc.disable()

# A busy machine takes its time, which says nothing of the code.
hypothesis.settings.register_profile("turnwright", deadline=None)
hypothesis.settings.load_profile("turnwright")


DRAWN = {"test_report.py", "test_show.py", "test_tolerance_commands.py"}
"""Tests of the command line that look at figures, or print them as well as build them."""

UNPRINTED = Path(__file__).parent / "support" / "unprinted"
"""Has a `sitecustomize`, which leaves out in other processes what fixtures leave out in this one."""

collect_ignore = [str(UNPRINTED)]
"""Debian's Python has a module of that name, and pytest refuses to import a second one."""


@pytest.fixture(scope="module", autouse=True)
def figures_are_built_and_not_printed(request):
    """Leave out the printing of the figures of reports, a third of the time of a small run, here and in processes."""
    if request.path.parent.name not in ("cli", "web") or request.path.name in DRAWN:
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("turnwright.report.figures._print_svg", lambda _canvas: "<svg></svg>")
        patch.setenv("PYTHONPATH", str(UNPRINTED), prepend=os.pathsep)
        yield


@pytest.fixture(scope="module", autouse=True)
def small_server(request):
    """Let a server keep one other process warm, not two, and a correction be proved by a quarter of the next parts.

    A server in this process does not load the kernels of a whole page ahead of the questions that need them.
    """
    if request.path.parent.name != "web":
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("turnwright.web.workers.PLANNERS", 1)
        patch.setattr("turnwright.diagnosis.report.DRAWS", 50)
        patch.setattr(sys, "path", [str(UNPRINTED), *sys.path])  # which a server gives to its runs
        patch.setenv("TURNWRIGHT_SMALL_SERVER", "1")
        with contextlib.suppress(ImportError):  # the workbench is an extra
            patch.setattr("turnwright.web.app.planners", _planner)
        yield


def _planner():
    from turnwright.web import jobs, workers

    return workers.Workers(1, threads=cores(), warm=jobs.warm)


@pytest.fixture
def in_this_process(monkeypatch):
    """Let this process do the work of local workers: each would import the program and load its kernels anew.

    The processes themselves are the subject of other tests.
    """
    from turnwright.studies import LocalPool

    def submit(_pool, function, /, *arguments, **named):
        done = Future()
        try:
            done.set_result(function(*arguments, **named))
        except Exception as error:  # noqa: BLE001 - the future raises it again
            done.set_exception(error)
        return done

    monkeypatch.setattr(LocalPool, "submit", submit)


@pytest.fixture
def signals_heard():
    """Let processes that a test starts hear Ctrl-C and a hangup where its own parent ignores them: nohup, make test &.

    What is ignored stays so in every process that is started, and Python then installs no handler of its own.
    """
    defaults = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}
    ignored = {
        number: handler
        for name, handler in defaults.items()
        if signal.getsignal(number := getattr(signal, name, signal.SIGINT)) is signal.SIG_IGN
    }
    for number, handler in ignored.items():
        signal.signal(number, handler)
    yield
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)


def pytest_collection_modifyitems(items):
    """Begin with what waits for a browser, a minute in one test: at the end only one process would be at work."""
    items.sort(key=lambda item: item.path.name != "test_web_page.py")


def pytest_collection_finish():
    """Collect from now on, and only what the tests make."""
    gc.freeze()
    gc.enable()
