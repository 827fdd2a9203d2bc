"""Requests that schemathesis makes of the server's own OpenAPI schema: nothing breaks, every answer is as it says."""

import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from turnwright.web import create_app, windows as _windows

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]

HOST = {"Host": "127.0.0.1"}


SETTINGS = settings(
    max_examples=3, derandomize=True, database=None, phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)  # fmt: skip


def test_the_server_keeps_its_schema(tmp_path):
    app = create_app(tmp_path)
    try:
        schema = schemathesis.openapi.from_asgi("/api/openapi.json", app, headers=HOST)
        # A stream without end has no whole answer; `test_web_page` listens to it.
        finite = schema.exclude(path="/api/runs/events")
        tried = [_tried(operation.ok()) for operation in finite.get_all_operations()]
    finally:
        app.state.workers.close()
        _windows.close(app)
    assert len(tried) > 20
    assert sum(tried) > 50


def _tried(operation):
    """Let hypothesis make requests of an operation; return how many."""
    count = 0

    @SETTINGS
    @given(case=operation.as_strategy())
    def check(case):
        nonlocal count
        count += 1
        case.call_and_validate(checks=CHECKS, headers=HOST)

    check()
    return count
