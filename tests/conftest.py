"""The order of the tests, and what several of them need."""

import signal

import hypothesis
import pytest

# A busy machine takes its time, which says nothing of the code.
hypothesis.settings.register_profile("turnwright", deadline=None)
hypothesis.settings.load_profile("turnwright")


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
