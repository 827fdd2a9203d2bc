"""Which combinations of cases the suite has, and which the proof."""

import itertools

import pytest


def every_second(*names):
    """Return all combinations of names; every second one, as on a chessboard, is left to the proof."""
    return [
        pytest.param(*one, marks=[pytest.mark.proof] if sum(numbers) % 2 else [])
        for one, numbers in zip(
            itertools.product(*names), itertools.product(*(range(len(each)) for each in names)), strict=True
        )
    ]
