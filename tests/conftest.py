"""The order of the tests."""


def pytest_collection_modifyitems(items):
    """Begin with what waits for a browser, a minute in one test: at the end only one process would be at work."""
    items.sort(key=lambda item: item.path.name != "test_web_page.py")
