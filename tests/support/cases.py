"""Which combinations of cases the suite has, and which the proof."""

import itertools

import pytest


def every_second(*names):
    """Return all combinations of names; every second one, as on a chessboard, is left to the proof."""
    return _every(2, names)


def every_third(*names):
    """Return all combinations of names; of three that follow each other in any of them, two are left to the proof."""
    return _every(3, names)


def _every(count, names):
    return [
        pytest.param(*one, marks=[pytest.mark.proof] if sum(numbers) % count else [])
        for one, numbers in zip(
            itertools.product(*names), itertools.product(*(range(len(each)) for each in names)), strict=True
        )
    ]
