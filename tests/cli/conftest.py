"""Reports without their drawings, which take half the time of a short run."""

import pytest

DRAWN = {"test_report", "test_show", "test_tolerance_commands"}
"""Tests that look at figures, or print them as well as build them."""


@pytest.fixture(autouse=True)
def figures_are_built_and_not_printed(request, monkeypatch):
    if request.module.__name__.rpartition(".")[2] not in DRAWN:
        monkeypatch.setattr("turnwright.report.figures._print_svg", lambda _canvas: "<svg></svg>")
